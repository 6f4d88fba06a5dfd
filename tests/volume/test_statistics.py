"""A store with its pyramid looks as its samples do in memory: what a look follows from is kept beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError
from clvol.device import Device
from clvol.scene.look import look
from clvol.scene.mode import as_mode
from clvol.volume import histogram
from clvol.volume.smoothing import choose
from clvol.volume.statistics import Statistics


def balls(size: int = 72, sigma: float = 0.05, dtype: str = "float32") -> clvol.Volume:
    """Soft balls in noise off the middle: the middle and a reduced copy tell another story."""
    rng = np.random.default_rng(7)
    z, y, x = np.mgrid[:size, :size, :size] / size
    data = np.zeros((size,) * 3)
    for c in rng.uniform(0.1, 0.9, (30, 3)):
        data += 90 / (1 + np.exp(300 * (np.hypot(np.hypot(z - c[0], y - c[1]), x - c[2]) - rng.uniform(0.02, 0.1))))
    return clvol.Volume((data + rng.normal(0, 90 * sigma, data.shape)).astype(dtype), (0.5, 0.5, 1.0))


@pytest.fixture(scope="module", params=["bounds", "plain"])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[clvol.Volume, clvol.LazyVolume]:
    whole = balls()
    path = tmp_path_factory.mktemp("store") / "balls.zarr"
    with pytest.MonkeyPatch.context() as patch:  # as of a volume that is larger than what is looked at
        patch.setattr("clvol.bricks.source._PREVIEWED", 20_000)
        patch.setattr("clvol.bricks.source._PART", 24)
        store = clvol.pyramid(whole, path, bounds=request.param == "bounds", chunks=24)
        assert store.preview().shape != whole.shape != store.part().shape
    return whole, store


def test_isovalue_windows_noise_and_smoothing_are_those_of_the_whole(pair: tuple[clvol.Volume, clvol.LazyVolume]) -> None:
    whole, store = pair
    small = store.preview()
    assert histogram.isovalue_of(small) == histogram.isovalue_of(whole)
    assert histogram.clims_of(small) == histogram.clims_of(whole)
    assert store.limits == whole.value_range
    assert not store.estimated
    assert store.noise == whole.noise
    assert choose(store.part()) == choose(whole)
    for mode in clvol.modes():
        assert as_mode(mode).transfer(small).colors == as_mode(mode).transfer(whole).colors
        assert look(small, mode, preset="mr-default").opacities == look(whole, mode, preset="mr-default").opacities
    if store.bounds is not None:
        assert store.bounds.filter == clvol.volume.smoothing.settled("bspline3(auto)", whole).name


def test_default_pictures_are_those_of_the_whole(device: Device, pair: tuple[clvol.Volume, clvol.LazyVolume]) -> None:
    whole, store = pair
    camera = clvol.Camera.orbit(fit="volume")
    for mode in ("composite", "isosurface", "mip"):
        pictures = [clvol.render(one, camera, mode, (60, 50), rays=1, device=device) for one in (whole, store.with_levels(()))]
        np.testing.assert_allclose(pictures[1], pictures[0], atol=2e-5)


def test_other_writers_are_estimated(pair: tuple[clvol.Volume, clvol.LazyVolume], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.bricks.source._PREVIEWED", 20_000)
    whole, store = pair
    other = clvol.LazyVolume(store.data, store.spacing, levels=[clvol.LazyVolume(one.data, one.spacing) for one in store.levels])
    assert other.statistics is None
    assert other.estimated
    assert histogram.isovalue_of(other.preview()) != histogram.isovalue_of(whole)


def test_they_are_small_and_versioned(pair: tuple[clvol.Volume, clvol.LazyVolume]) -> None:
    _, store = pair
    assert store.statistics is not None
    text = json.dumps(store.statistics.json())
    assert len(text) < 8192
    given = json.loads(text)
    assert Statistics.from_json(given) == store.statistics
    assert Statistics.from_json(given | {"version": 99}) is None
    broken: tuple[dict[str, Any], ...] = (
        {"matter": {}},
        {"clims": {}},
        {"value_range": [0]},
        {"noise": None},
        {"smoothing": {"3": 1}},
    )
    for change in broken:
        with pytest.raises(FormatError, match="statistics of the samples must be those"):
            Statistics.from_json(given | change)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float64"])
def test_of_any_type(tmp_path: Path, dtype: str) -> None:
    whole = balls(40, dtype=dtype)
    store = clvol.pyramid(whole, tmp_path / "a.zarr", chunks=16, filter="bspline3")
    assert histogram.isovalue_of(store.preview()) == histogram.isovalue_of(whole)
    assert store.noise == whole.noise


def test_a_lazy_volume_has_an_origin_and_a_direction() -> None:
    lazy = clvol.LazyVolume(np.zeros((3, 4, 5)), origin=(1, 2, 3))
    assert lazy.origin == (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(lazy.direction, np.eye(3))
