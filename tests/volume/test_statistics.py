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
from tests import cases


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
    for mode in sorted(cases.MODES):
        assert as_mode(mode).transfer(small).colors == as_mode(mode).transfer(whole).colors
    for mode in sorted(set(cases.MODES) - {"integral"}):  # presets are of values
        assert look(small, mode, preset="mr-default").opacities == look(whole, mode, preset="mr-default").opacities
    if store.bounds is not None:
        assert store.bounds.filter == clvol.volume.smoothing.settled("bspline3(auto)", whole).name


def test_default_pictures_are_those_of_the_whole(device: Device, pair: tuple[clvol.Volume, clvol.LazyVolume]) -> None:
    """The camera is fitted to the same samples, too: `clvol/samples` of the store."""
    whole, store = pair
    for mode, options in (("composite", {}), ("isosurface", {}), ("isosurface", {"isovalue": "2sigma"}), ("mip", {})):
        pictures = [
            clvol.render(one, None, mode, (60, 50), rays=1, device=device, **options) for one in (whole, store.with_levels(()))
        ]
        np.testing.assert_allclose(pictures[1], pictures[0], atol=2e-5)


def test_labels_have_the_colors_and_the_camera_of_the_whole(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clvol.bricks.source._PREVIEWED", 2_000)
    data = np.zeros((40, 36, 44), np.uint16)
    data[3:20, 4:20, 6:30], data[21:35, 10:30, 20:40], data[25, 3:5, 3:5] = 3, 900, 40  # the last is in no smaller size
    whole = clvol.Volume(data, (1, 1, 1.5), labels=True)
    store = clvol.pyramid(whole, tmp_path / "labels.zarr", chunks=16)
    small = store.preview()
    assert 40 not in small.data
    background, numbers = histogram.label_numbers(small)
    assert (background, numbers.tolist()) == (0, [0, 3, 40, 900])
    pictures = [clvol.render(one, size=(50, 40), rays=1, device=device) for one in (whole, store.with_levels(()))]
    np.testing.assert_array_equal(pictures[1], pictures[0])
    assert store.statistics is not None
    given = json.loads(json.dumps(store.statistics.json()))
    assert given["labels"] == {"background": 0, "runs": [[0, 0], [3, 3], [40, 40], [900, 900]]}
    for wrong in ({"background": 0, "runs": []}, {"background": 0, "runs": [[5, 1]]}, {"background": 0, "runs": [[0, 1e12]]}, {}):
        with pytest.raises(FormatError, match="statistics of the samples must be those"):
            Statistics.from_json(given | {"labels": wrong})


def test_labels_that_are_many_and_scattered_are_not_kept(tmp_path: Path) -> None:
    data = (2 * np.arange(16 * 16 * 16, dtype=np.int32)).reshape(16, 16, 16)
    assert clvol.pyramid(clvol.Volume(data, labels=True), tmp_path / "labels.zarr").statistics is None


def test_samples_of_another_shape_are_refused(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    clvol.pyramid(balls(20), tmp_path / "a.zarr", filter="bspline3")
    root = zarr.open_group(tmp_path / "a.zarr")
    del root["clvol/samples"]
    root.create_array("clvol/samples", shape=(3, 4, 5), dtype="f4")
    with pytest.raises(FormatError, match=r"clvol/samples must hold evenly spaced samples of shape \(20, 20, 20\)"):
        clvol.open(tmp_path / "a.zarr")


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
        {"spread": None},
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
