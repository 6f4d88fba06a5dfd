"""Copies and pickles of volumes equal their originals, and stay read-only, so that cached facts remain true."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol

WAYS: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{f"pickle {n}": lambda what, n=n: pickle.loads(pickle.dumps(what, n)) for n in (2, pickle.HIGHEST_PROTOCOL)},
}


@pytest.fixture(params=WAYS)
def again(request: pytest.FixtureRequest) -> Callable[[Any], Any]:
    return WAYS[request.param]


def a_volume() -> clvol.Volume:
    data = np.random.default_rng(0).random((5, 6, 7), dtype=np.float32)
    direction = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    return clvol.Volume(data, (1, 2, 3), (4, 5, 6), direction, "mm", "LPS", "CT", "red", (0, 1), header={"a": 1})


def test_samples_stay_read_only(again: Callable[[Any], Any]) -> None:
    volume = a_volume()
    known = volume.value_range, volume.noise
    other = again(volume)
    assert (other.value_range, other.noise) == known
    for array in (other.data, other.direction):
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5
    np.testing.assert_array_equal(other.data, volume.data)
    for name in ("spacing", "origin", "units", "space", "name", "color", "clim", "header"):
        assert getattr(other, name) == getattr(volume, name)


def test_a_pickle_of_a_writable_volume_is_read_only(again: Callable[[Any], Any]) -> None:
    data = np.zeros((2, 3, 4))
    volume = clvol.Volume(data)
    assert volume.value_range == (0, 0)
    other = again(volume)
    with pytest.raises(ValueError, match="read-only"):
        other.data[0, 0, 0] = 9
    assert data.flags.writeable  # the caller's own
    assert other.value_range == (other.data.min(), other.data.max())


def test_volumes_stay_read_only_and_store_their_samples_once(again: Callable[[Any], Any]) -> None:
    volumes = clvol.Volumes(np.arange(4 * 60.0).reshape(4, 3, 4, 5), spacing=(1, 2, 3), units="mm")
    other = again(volumes)
    assert (other.shape, other.axes, other.grid.spacing, other.grid.units) == ((4, 3, 4, 5), ("volume",), (1, 2, 3), "mm")
    for volume, same in zip(volumes, other, strict=True):
        np.testing.assert_array_equal(volume.data, same.data)
        assert not same.data.flags.writeable
    assert not np.asarray(other).flags.writeable
    assert np.shares_memory(other.grid.data, np.asarray(other))
    assert len(pickle.dumps(volumes)) < np.asarray(volumes).nbytes + 2000


def test_a_mapped_file_is_pickled_by_its_samples(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(60.0).reshape(3, 4, 5))
    volume = clvol.Volume(np.load(tmp_path / "a.npy", mmap_mode="r+"))
    other = pickle.loads(pickle.dumps(volume))
    assert other.value_range == (0, 59)
    assert not other.data.flags.writeable
    assert not volume.data.flags.writeable
