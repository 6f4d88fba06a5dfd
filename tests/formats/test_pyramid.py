"""`clvol.pyramid`: correct levels, valid bounds, and a complete store or none."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import clvol
from clvol.base.errors import ClvolError, DataError, FormatError, OptionError
from clvol.bricks.source import Bounds
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filter
from clvol.formats._bounds import StoredBounds, blocks_of
from clvol.formats.pyramid import journal, make
from clvol.spline.levels import levels_of
from clvol.spline.reduce import nearest_spline

zarr = pytest.importorskip("zarr")
pytestmark = pytest.mark.usefixtures("device")

MIB = 1 << 20


def waves(shape: tuple[int, int, int], dtype: str = "uint16", seed: int = 0) -> np.ndarray:
    """Smooth blobs and a few single bright samples, over most of the range of a type."""
    rng = np.random.default_rng(seed)
    z, y, x = np.ogrid[tuple(slice(n) for n in shape)]
    field = np.sin(0.21 * x + 0.4) * np.cos(0.17 * y) + np.sin(0.3 * z + 0.1 * x)
    field = (field - field.min()) / max(np.ptp(field), 1e-9) * 0.8
    field.flat[rng.integers(0, field.size, 5)] = 1.0
    return (field * (0.9 * np.iinfo(dtype).max if np.dtype(dtype).kind in "iu" else 1.0)).astype(dtype)


def scan(shape: tuple[int, int, int] = (50, 90, 70), **about: Any) -> clvol.Volume:
    return clvol.Volume(waves(shape), **({"spacing": (0.5, 0.5, 0.5), "units": "um", "space": "image"} | about))


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a store, read by zarr."""
    return {
        name: np.asarray(one[...]) for name, one in zarr.open_group(path, mode="r").members(max_depth=None) if hasattr(one, "shape")
    }


def same_stores(a: Path, b: Path) -> None:
    one, other = arrays_of(a), arrays_of(b)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)
    assert dict(zarr.open_group(a, mode="r").attrs) == dict(zarr.open_group(b, mode="r").attrs)


# -- sizes -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_other_readers_read_it(tmp_path: Path, version: Any) -> None:
    """The OME-Zarr models, ome-zarr's reader and plain zarr, which do not know bounds."""
    models = pytest.importorskip("ome_zarr_models")
    volume = scan(name="nuclei", clim=(10, 5000), color=(0, 1, 0), origin=(1, 2, 3))
    clvol.pyramid(volume, tmp_path / "v.zarr", levels=3, version=version)
    with warnings.catch_warnings(action="ignore"):
        group = zarr.open_group(tmp_path / "v.zarr", mode="r")
        image = models.open_ome_zarr(group)
        assert type(image).__module__.startswith(f"ome_zarr_models.v{version.replace('.', '')}")
        assert isinstance(image, (models.v04.Image, models.v05.Image))
        about = image.attributes.multiscales if version == "0.4" else image.attributes.ome.multiscales
        assert [axis.unit for axis in about[0].axes] == ["micrometer"] * 3
        (node,) = __import__("ome_zarr.reader").reader.Reader(__import__("ome_zarr.io").io.parse_url(tmp_path / "v.zarr"))()
    assert [tuple(level.shape) for level in node.data] == [(50, 90, 70), (25, 45, 35), (13, 23, 18)]
    np.testing.assert_array_equal(np.asarray(node.data[0]), volume.data)
    whole = clvol.read(tmp_path / "v.zarr")
    assert (whole.spacing, whole.origin, whole.units, whole.name, whole.clim, whole.color) == (
        volume.spacing,
        volume.origin,
        "um",
        "nuclei",
        (10, 5000),
        (0, 1, 0),
    )
    assert clvol.read(tmp_path / "v.zarr", level=1).origin == (1.25, 2.25, 3.25)


def test_levels_match_a_reduction_in_one_piece(tmp_path: Path, device: Device) -> None:
    """The least-squares reduction of the whole volume, up to rounding."""
    volume = scan()
    lazy = clvol.pyramid(volume, tmp_path / "v.zarr", filter="bspline3(0.3)", levels=3, device=device)
    np.testing.assert_array_equal(lazy.whole().data, volume.data)
    before, row = volume, as_filter("bspline3(0.3)")
    for level in lazy.levels:
        whole = nearest_spline(
            before, row, as_boundary("mirror"), np.float32, device, np.diag([2.0] * 3), np.full(3, 0.5), level.shape
        )
        found = level.whole()
        assert np.abs(found.data - np.clip(whole, 0, 65535)).max() < 0.55
        before, row = found, as_filter("bspline3")


@pytest.mark.one_in(3)
@pytest.mark.parametrize("method", ["least-squares", "average", "nearest"])
def test_results_do_not_depend_on_budget_chunks_or_shards(tmp_path: Path, method: Any) -> None:
    volume = scan((70, 150, 130))
    about: dict[str, Any] = {"method": method, "levels": 3, "filter": "bspline3", "boundary": "reflect"}
    first = clvol.pyramid(volume, tmp_path / "a.zarr", **about)
    others = [
        clvol.pyramid(volume, tmp_path / "b.zarr", chunks=16, memory=144 * MIB, compressor="none", **about),
        clvol.pyramid(volume, tmp_path / "c.zarr", chunks=(16, 8, 32), shards=(32, 32, 32), compressor="lz4", **about),
    ]
    for other in others:
        for one, two in zip((first, *first.levels), (other, *other.levels), strict=True):
            np.testing.assert_array_equal(one.whole().data, two.whole().data)
    assert others[1].chunks == (16, 8, 32)


def test_the_budget_sets_the_tiles(device: Device) -> None:
    """Many tiles give the same result as one."""
    from clvol.formats.pyramid.reduce import Reduction
    from clvol.spline.levels import sums_for

    data = waves((40, 200, 180))
    finer, coarser = levels_of((180, 200, 40), (1, 1, 1), 2, 64)
    for boundary in ("mirror", "wrap", "nearest"):
        rule, row = as_boundary(boundary), as_filter("bspline3")
        sums = tuple(sums_for("least-squares", row, rule, 2, n, False) for n in finer.size)
        results = []
        for edge, budget in ((1000, 1 << 30), (16, 5 * MIB)):
            copied, made = np.zeros_like(data), np.zeros(coarser.shape, data.dtype)
            reduction = Reduction(
                data.__getitem__,
                finer,
                coarser,
                sums,
                data.dtype,
                np.float32,
                (edge, edge, 8),
                16,
                budget,
                device,  # type: ignore[arg-type]
            )
            assert (len(reduction.tiles()) == 1) == (edge == 1000)
            for tile in reduction.tiles():
                for place, part in reduction.run(tile, reduction.blocks(), copied.__setitem__):
                    made[place] = part
            np.testing.assert_array_equal(copied, data)
            results.append(made)
        np.testing.assert_array_equal(*results)
        whole = nearest_spline(
            clvol.Volume(data), row, rule, np.float32, device, np.diag([2.0] * 3), np.full(3, 0.5), coarser.shape
        )
        assert np.abs(results[0] - np.clip(whole, 0, 65535)).max() < 0.55


def test_each_sample_is_read_about_once(tmp_path: Path) -> None:
    class Counted:
        def __init__(self, data: np.ndarray) -> None:
            self.data, self.shape, self.dtype, self.read = data, data.shape, data.dtype, 0

        def __getitem__(self, at: Any) -> np.ndarray:
            part: np.ndarray = self.data[at]
            self.read += part.size
            return part

    counted = Counted(waves((150, 140, 130)))
    clvol.pyramid(clvol.LazyVolume(counted, labels=False), tmp_path / "v.zarr", filter="bspline3")
    looked_at = 128**3  # the part from which noise and labels are detected
    assert counted.read <= counted.data.size + looked_at


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("budget", "levels", "most"), [(None, None, 27), (None, 1, 27), (122 * MIB, 2, 80)])
def test_dask_chunks_are_computed_about_once(tmp_path: Path, budget: int | None, levels: int | None, most: int) -> None:
    """Small arrays too."""
    da = pytest.importorskip("dask.array")
    data, computed = waves((150, 140, 130)), []

    def count(block: np.ndarray, block_info: Any = None) -> np.ndarray:
        if block_info:
            computed.append(block_info[0]["chunk-location"])
        return block

    chunks = ((50, 70, 30), (50, 50, 40), (1, 79, 50))
    blocks = da.from_array(data, chunks=chunks).map_blocks(count, dtype=data.dtype, meta=np.empty((0, 0, 0), data.dtype))
    about: dict[str, Any] = {"filter": "bspline3", "levels": levels, "bounds": False, "memory": budget}
    made = clvol.pyramid(clvol.LazyVolume(blocks, labels=False), tmp_path / "v.zarr", **about)
    assert len(set(computed)) == 27
    assert len(computed) <= most
    other = clvol.pyramid(clvol.Volume(data, labels=False), tmp_path / "w.zarr", **about)
    for one, two in zip((made, *made.levels), (other, *other.levels), strict=True):
        np.testing.assert_array_equal(one.whole().data, two.whole().data)


def truth(points: np.ndarray) -> np.ndarray:
    """A function of three octaves; half the samples still resolve the highest."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.asarray(np.sin(0.11 * x) * np.cos(0.13 * y) + 0.5 * np.sin(0.55 * x + 0.4 * z) + 0.25 * np.cos(1.0 * y + 0.3 * z))


def test_least_squares_is_closer_to_the_function_than_averages(tmp_path: Path) -> None:
    """Half the samples, compared with the function itself; docs/stores.md has the figures."""
    n = 64
    grid = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1)[..., ::-1].astype(float)
    volume = clvol.Volume(truth(grid).astype(np.float32))
    points = 12 + 40 * np.random.default_rng(3).random((4000, 3))
    errors = {}
    for method in ("least-squares", "average", "nearest"):
        lazy = clvol.pyramid(volume, tmp_path / f"{method}.zarr", method=method, levels=2, filter="bspline3")  # type: ignore[arg-type]
        small = clvol.Field(lazy.levels[0].whole(), "bspline3")
        errors[method] = float(np.sqrt(np.mean((small(points) - truth(points)) ** 2)))
    assert errors["least-squares"] < 0.25 * errors["average"]
    assert errors["average"] < errors["nearest"]


def test_values_are_rounded_and_clipped_to_their_type(tmp_path: Path) -> None:
    """Rounded to nearest, and clipped where splines overshoot; none wraps around."""
    for dtype in ("uint8", "int16", "float32", "float64", "bool", "int32", "uint64", "float16"):
        data = (waves((20, 24, 22), "float64") > 0.4).astype(dtype)
        if dtype not in ("bool",):
            data = data * (np.iinfo(dtype).max // 3 * 3 if np.dtype(dtype).kind in "iu" and np.dtype(dtype).itemsize < 8 else 200)
            data = data.astype(dtype)
        lazy = clvol.pyramid(
            clvol.Volume(data, labels=False), tmp_path / f"{dtype}.zarr", method="least-squares", levels=2, filter="bspline3"
        )
        assert lazy.dtype == lazy.levels[0].dtype == dtype
        np.testing.assert_array_equal(lazy.whole().data, data)
        small = lazy.levels[0].whole().data.astype(float)
        box = data.astype(float).reshape(10, 2, 12, 2, 11, 2).mean((1, 3, 5))
        assert np.sqrt(np.mean((small - box) ** 2)) < 0.15 * data.astype(float).max()


def test_labels_are_never_blended(tmp_path: Path) -> None:
    data = np.zeros((40, 40, 40), np.uint32)
    data[10:30, 5:20, 8:33], data[20:, 20:, :] = 5, (1 << 31) + 7
    lazy = clvol.pyramid(clvol.Volume(data, labels={5: "liver", (1 << 31) + 7: "lung"}), tmp_path / "v.zarr", levels=3)
    assert lazy.is_labels
    assert lazy.grid.labels == {5: "liver", (1 << 31) + 7: "lung"}
    for level in (lazy, *lazy.levels):
        assert set(np.unique(level.whole().data)) == {0, 5, (1 << 31) + 7}
        assert level.bounds is not None
        assert level.bounds.filter == "nearest"


def test_coarse_axes_are_halved_later(tmp_path: Path) -> None:
    sizes = levels_of((256, 256, 40), (0.5, 0.5, 2.0), None, 32)
    assert [level.size for level in sizes] == [(256, 256, 40), (128, 128, 40), (64, 64, 40), (32, 32, 20)]
    assert sizes[3].factors == (8, 8, 2)
    lazy = clvol.pyramid(scan((9, 80, 80), spacing=(1, 1, 4)), tmp_path / "v.zarr", chunks=32, filter="linear")
    assert [level.spacing for level in lazy.levels] == [(2, 2, 4), (4, 4, 4)]


def test_scans_keep_their_placement(tmp_path: Path) -> None:
    turned = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    volume = scan((30, 32, 34), space="LPS", units="mm", direction=turned, origin=(-40, 20, 5), spacing=(1, 1, 1.2))
    lazy = clvol.pyramid(volume, tmp_path / "v.zarr", levels=2)
    for one in (lazy.grid, clvol.read(tmp_path / "v.zarr")):
        assert (one.space, one.units) == ("LPS", "mm")
        np.testing.assert_allclose(one.corners, volume.corners)
    np.testing.assert_allclose(lazy.levels[0].grid.corners, volume.corners)


# -- bounds ------------------------------------------------------------------------------------------------------------


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    size=st.tuples(*[st.integers(1, 45)] * 3),
    filter=st.sampled_from(["bspline3", "bspline3(0.5)", "linear", "bspline2", "bspline5", "catmull-rom", "nearest"]),
    boundary=st.sampled_from(["mirror", "reflect", "wrap", "nearest"]),
    seed=st.integers(0, 99),
)
def test_bounds_contain_the_function(
    tmp_path_factory: pytest.TempPathFactory, size: Any, filter: str, boundary: str, seed: int
) -> None:
    """Values at points of any box, computed in float64 in one piece, lie within the bounds of the box."""
    rng = np.random.default_rng(seed)
    volume = clvol.Volume((rng.random(size[::-1]) * 60000).astype(np.uint16), labels=False)
    path = tmp_path_factory.mktemp("bounds") / "v.zarr"
    lazy = clvol.pyramid(volume, path, filter=filter, boundary=boundary, levels=2, method="average")
    for level in (lazy, *lazy.levels):
        bounds = level.bounds
        assert isinstance(bounds, Bounds)
        data = level.whole().data
        assert bounds.value_range == level.limits == (data.min(), data.max())
        assert bounds.boundary == boundary
        field = clvol.Field(clvol.Volume(data), bounds.filter, boundary, precision="double")
        for _ in range(12):
            low = [int(rng.integers(0, n)) for n in level.size]
            high = [int(rng.integers(a, n)) for a, n in zip(low, level.size, strict=True)]
            outer = [(a - 0.5 * (a == 0), b + 0.5 * (b == n - 1)) for a, b, n in zip(low, high, level.size, strict=True)]
            values = field(np.stack([rng.uniform(a, b, 200) for a, b in outer], -1))
            least, most = bounds.within(tuple(low), tuple(high))  # type: ignore[arg-type]  # three of them
            assert least <= values.min()
            assert values.max() <= most


def test_bounds_are_tight(tmp_path: Path) -> None:
    """About as tight as the device's own pyramid: blocks away from a ball exclude it."""
    z, y, x = np.ogrid[:80, :80, :80]
    ball = ((x - 40) ** 2 + (y - 40) ** 2 + (z - 40) ** 2 < 15**2) * np.uint8(200)
    lazy = clvol.pyramid(clvol.Volume(ball, labels=False), tmp_path / "v.zarr", filter="bspline3", method="least-squares")
    assert lazy.bounds is not None
    held = sum(
        lazy.bounds.within((8 * i, 8 * j, 8 * k), (8 * i + 8, 8 * j + 8, 8 * k + 8))[1] > 20
        for i in range(10)
        for j in range(10)
        for k in range(10)
    )
    touched = sum(
        bool(ball[max(0, 8 * k - 1) : 8 * k + 10, max(0, 8 * j - 1) : 8 * j + 10, max(0, 8 * i - 1) : 8 * i + 10].any())
        for i in range(10)
        for j in range(10)
        for k in range(10)
    )
    assert 0 < held <= touched < 250
    assert lazy.bounds.within((0, 0, 0), (79, 79, 79))[1] < 2 * 200
    size = sum(one.nbytes for name, one in arrays_of(tmp_path / "v.zarr").items() if "bounds/0" in name)
    assert size < 0.04 * 2 * ball.size


def test_a_volume_of_zeros_has_zero_bounds(tmp_path: Path) -> None:
    """They are stored, so that an incomplete copy can be detected."""
    lazy = clvol.pyramid(clvol.Volume(np.zeros((70, 70, 70), np.float32), labels=False), tmp_path / "v.zarr", filter="bspline3")
    assert lazy.bounds is not None
    assert lazy.bounds.within((0, 0, 0), (69, 69, 69)) == lazy.limits == (0, 0)
    assert not lazy.whole().data.any()


@pytest.mark.parametrize("version", ["0.4", "0.5"])
@pytest.mark.parametrize("filled", [False, True])
def test_a_missing_chunk_of_bounds_means_unknown_bounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: Any, filled: bool
) -> None:
    """Nothing is skipped there; in older stores too, whose missing chunks read as zeros."""
    if filled:
        array = make._Writing._array
        monkeypatch.setattr(make._Writing, "_array", lambda *given, **more: array(*given, **(more | {"fill": 0})))
    data = np.zeros((300, 24, 24), np.uint8)
    data[270:290, 6:18, 6:18] = 200
    path = tmp_path / "v.zarr"
    clvol.pyramid(clvol.Volume(data, labels=False), path, filter="linear", levels=1, version=version)
    whole = clvol.open(path, trusted=True)
    assert whole.bounds is not None
    view = {"camera": clvol.Camera.orbit(30, 10, fit="volume"), "mode": "isosurface", "size": (24, 24), "isovalue": 100}
    picture = np.asarray(clvol.render(whole, memory=2 * MIB, **view))
    known = (-math.inf, math.inf) if filled else (0, 0)  # its first chunk is of zeros, which were not stored
    assert whole.bounds.within((0, 0, 0), (23, 23, 255)) == known
    least, most = whole.bounds.within((0, 0, 256), (23, 23, 299))
    assert (least, most) == (pytest.approx(0, abs=0.1), pytest.approx(200, abs=0.1))
    finest = path / "clvol" / "bounds" / "0" / "0"
    chunk = finest / ("1/0/0/0" if version == "0.4" else "c/1/0/0/0")
    chunk.unlink()
    opened = clvol.open(path, trusted=True)
    assert opened.bounds is not None
    assert opened.bounds.within((0, 0, 256), (23, 23, 299)) == (-math.inf, math.inf)
    assert opened.limits == (0, 200)
    np.testing.assert_array_equal(np.asarray(clvol.render(opened, memory=2 * MIB, **view)), picture)


def test_bounds_of_values_far_from_zero_are_tight(tmp_path: Path) -> None:
    data = 1e6 + np.random.default_rng(0).random((20, 20, 20))
    lazy = clvol.pyramid(clvol.Volume(data.astype(np.float64)), tmp_path / "v.zarr", filter="linear", levels=1)
    assert lazy.bounds is not None
    low, high = lazy.bounds.within((0, 0, 0), (19, 19, 19))
    assert 1e6 - 0.01 < low <= data.min()
    assert data.max() <= high < 1e6 + 1.01


def test_bounds_that_do_not_fit_are_rejected(tmp_path: Path) -> None:
    clvol.pyramid(scan(), tmp_path / "v.zarr", levels=1)
    group = zarr.open_group(tmp_path / "v.zarr", mode="r+")
    own = dict(group.attrs["clvol"])
    one = own["levels"][0]
    for changes in (
        {"bounds": ["clvol/bounds/0/9"]},
        {"block": 4},
        {"value_range": [3, 1]},
        {"value_range": None},
        {"bounds": ["0"]},
    ):
        group.attrs["clvol"] = own | {"levels": [one | changes]}
        with pytest.raises(ClvolError, match="bounds"):
            clvol.open(tmp_path / "v.zarr", trusted=True)
    group.attrs["clvol"] = own | {"version": 99}  # of a later clvol: it may be anything
    assert clvol.open(tmp_path / "v.zarr", trusted=True).bounds is None


def test_coarse_blocks_bound_large_boxes() -> None:
    """The same numbers as all fine blocks."""
    rng = np.random.default_rng(0)
    size = (8 * 64 + 1,) * 3
    low = rng.random(blocks_of(size))
    arrays = [np.stack([low, low + rng.random(low.shape)], -1)]
    while arrays[-1].shape[0] > 1:
        a = arrays[-1].reshape(*(k for n in arrays[-1].shape[:3] for k in (n // 2, 2)), 2)
        arrays.append(np.stack([a[..., 0].min((1, 3, 5)), a[..., 1].max((1, 3, 5))], -1))
    bounds = StoredBounds(arrays, size, "linear", "mirror", (0, 2))
    assert bounds.within((0, 0, 0), (512, 512, 512)) == (arrays[0][..., 0].min(), arrays[0][..., 1].max())
    inside = arrays[0][2:10, 4:5, 0:64]
    assert bounds.within((0, 32, 16), (512, 40, 80)) == (inside[..., 0].min(), inside[..., 1].max())
    assert bounds.within((7, 8, 9), (7, 8, 9)) == tuple(arrays[0][1, 1, 0])


# -- whole or not at all -----------------------------------------------------------------------------------------------

SLOWLY = """
    import sys, time
    import numpy as np
    import clvol
    from clvol.formats.pyramid import journal

    journal._SECONDS = journal._SHARE = 0  # sync after each part

    def slowly(done):
        print(done, flush=True)
        time.sleep(0.05)

    volume = clvol.Volume(np.load(sys.argv[1]), spacing=(0.5, 0.5, 0.5))
    clvol.pyramid(volume, sys.argv[2], chunks=8, levels=3, filter="bspline3", progress=slowly)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGKILL")
def test_a_killed_process_costs_only_time(tmp_path: Path) -> None:
    """Killed at several points, the resumed store is identical; finished work is not repeated."""
    np.save(tmp_path / "v.npy", waves((36, 40, 44)))
    volume = clvol.Volume(np.load(tmp_path / "v.npy"), spacing=(0.5, 0.5, 0.5))
    about: dict[str, Any] = {"chunks": 8, "levels": 3, "filter": "bspline3"}
    told: list[float] = []
    clvol.pyramid(volume, tmp_path / "whole.zarr", progress=told.append, **about)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)
    target, started = tmp_path / "v.zarr", []
    for wanted in (1, 3):
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(SLOWLY), tmp_path / "v.npy", target], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            started.append(float(process.stdout.readline()))
            for _ in range(wanted):
                process.stdout.readline()
            process.send_signal(signal.SIGKILL)
        assert not target.exists()
        assert (tmp_path / ".v.zarr.unfinished").is_dir()
    with pytest.raises(FormatError, match=r"another command began \(filter: bspline3 and not linear\)"):
        clvol.pyramid(volume, target, **(about | {"filter": "linear"}))
    told.clear()
    clvol.pyramid(volume, target, progress=told.append, **about)
    assert told[0] > started[0]
    same_stores(target, tmp_path / "whole.zarr")
    assert not (tmp_path / ".v.zarr.unfinished").exists()


class Killed(BaseException):
    """Simulates SIGKILL: from the n-th change of the disk on, none happens."""


def killing(monkeypatch: pytest.MonkeyPatch, after: int) -> list[int]:
    """Count the journal's changes, and simulate a kill at one of them."""
    made = [0]

    def watched(function: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            made[0] += 1
            if made[0] > after:
                raise Killed
            return function(*arguments, **options)

        return call

    for name in ("rename", "unlink", "rmdir", "mkdir", "sync", "fsync", "utime"):
        monkeypatch.setattr(os, name, watched((lambda *_: None) if name.endswith("sync") else getattr(os, name)))
    monkeypatch.setattr(journal.Journal, "_write", watched(journal.Journal._write))
    return made


def rename_fails(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    calls, rename = [0], os.rename

    def call(*arguments: Any) -> None:
        calls[0] += 1
        if calls[0] == number:
            raise PermissionError("not now")
        rename(*arguments)

    monkeypatch.setattr(os, "rename", call)


TINY: dict[str, Any] = {"filter": "linear", "levels": 1, "bounds": False, "compressor": "none"}


def tiny(seed: int) -> clvol.Volume:
    return clvol.Volume(np.random.default_rng(seed).integers(1, 100, (4, 5, 6)).astype(np.uint8), labels=False)


def sum_at(target: Path) -> int | None:
    """The sum of all samples of the present store."""
    return int(clvol.open(target, trusted=True).whole().data.sum()) if target.exists() else None


@pytest.mark.skipif(sys.platform == "win32", reason="renames otherwise")
@pytest.mark.parametrize(
    ("old", "then"),
    [
        (True, "the same, replacing"),
        (False, "the same"),
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in itertools.product((True, False), ("another", "another, replacing"))
        ),
        pytest.param(True, "the same", marks=pytest.mark.thorough),
        pytest.param(False, "the same, replacing", marks=pytest.mark.thorough),
    ],
)
def test_a_kill_between_any_two_changes_of_the_disk_loses_no_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: bool, then: str
) -> None:
    """The old store remains, or the new one is complete, or the next call restores one."""
    before, new, other = (int(tiny(seed).data.sum()) for seed in (0, 1, 2))
    about = TINY | {"overwrite": old}
    ends = set()
    monkeypatch.setattr(os, "sync", lambda: None)  # takes long where others write
    if old:
        clvol.pyramid(tiny(0), tmp_path / "old.zarr", **TINY)
    for after in range(100):
        target = tmp_path / str(after) / "v.zarr"
        target.parent.mkdir()
        if old:
            shutil.copytree(tmp_path / "old.zarr", target)
        with monkeypatch.context() as patch:
            killing(patch, after)
            try:
                clvol.pyramid(tiny(1), target, **about)
            except Killed:
                killed = True
            else:
                killed = False
        found = sum_at(target)
        assert found in (None, before if old else new, new)
        ends.add(found)
        replacing = then.endswith("replacing")
        source, wanted = (tiny(2), other) if then.startswith("another") else (tiny(1), new)
        said = ""
        try:
            clvol.pyramid(source, target, **(TINY | {"overwrite": replacing}))
        except FormatError as error:
            said = str(error)
        if said:  # the target exists, or another call's unfinished store
            kept = sum_at(target)
            assert not replacing
            assert ("there already" in said) == (kept is not None)
            assert kept is not None or (not old and "another command began" in said)
            assert kept in (found, new) or found is None
            clvol.pyramid(source, target, **(TINY | {"overwrite": True}))
        assert sum_at(target) == wanted
        assert [one.name for one in target.parent.iterdir()] == ["v.zarr"]
        if not killed:
            assert after > 9
            break
    assert ends == ({None, before, new} if old else {None, new})


@pytest.mark.skipif(sys.platform == "win32", reason="renames otherwise")
@pytest.mark.parametrize("number", [1, 2])
def test_a_failed_rename_keeps_the_old_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    target = tmp_path / "v.zarr"
    clvol.pyramid(tiny(0), target, **TINY)
    with monkeypatch.context() as patch:
        rename_fails(patch, number)
        with pytest.raises(FormatError, match=r"not now; the store is complete in .*unfinished"):
            clvol.pyramid(tiny(1), target, overwrite=True, **TINY)
    assert sum_at(target) == tiny(0).data.sum()
    told: list[float] = []
    clvol.pyramid(tiny(1), target, overwrite=True, progress=told.append, **TINY)
    assert told == [1.0]
    assert sum_at(target) == tiny(1).data.sum()


def test_a_journal_without_its_store_is_ignored(tmp_path: Path) -> None:
    """The store was deleted, or moved away, and the journal was not."""

    def interrupted(done: float) -> None:
        if done > 0.6:
            raise KeyboardInterrupt

    target = tmp_path / "v.zarr"
    with pytest.raises(KeyboardInterrupt):
        clvol.pyramid(scan(), target, chunks=16, progress=interrupted)
    shutil.rmtree(tmp_path / ".v.zarr.unfinished" / "store.zarr")
    np.testing.assert_array_equal(clvol.pyramid(scan(), target, chunks=16).whole().data, scan().data)


@pytest.mark.skipif(not hasattr(os, "sync"), reason="has no sync")
def test_after_a_power_failure_only_synced_data_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks written after the last sync are lost or torn, and so is an array's metadata."""
    target, about = tmp_path / "v.zarr", {"chunks": 8, "levels": 2, "filter": "linear"}
    volume, folder = scan((40, 30, 34)), tmp_path / ".v.zarr.unfinished"
    told: list[float] = []

    def interrupted(done: float) -> None:
        told.append(done)
        time.sleep(0.02)  # a file's time is that of the last tick
        monkeypatch.setattr(journal, "_SECONDS", 0.0 if done < 0.1 else 1e9)
        if done > 0.25:
            raise KeyboardInterrupt

    monkeypatch.setattr(journal, "_SECONDS", 0.0)
    monkeypatch.setattr(journal, "_SHARE", 0)
    monkeypatch.setattr(journal.Journal, "__exit__", lambda self, *_: self._stream.close())  # nothing is synced at the end
    with pytest.raises(KeyboardInterrupt):
        clvol.pyramid(volume, target, progress=interrupted, **about)
    entries = [json.loads(line) for line in (folder / "journal").read_text().split("\n") if line]
    synced = max(entry["time"] for entry in entries if "time" in entry)
    lost = [file for file in folder.rglob("*") if file.is_file() and file.name != "journal" and file.stat().st_mtime_ns > synced]
    assert len(lost) > 4
    for file in lost:
        file.write_bytes(b"")
    told.clear()
    with pytest.raises(KeyboardInterrupt):  # and it happens again
        clvol.pyramid(volume, target, progress=interrupted, **about)
    assert 0.05 < told[0] < 0.25  # the previous store counts
    clvol.pyramid(volume, target, **about)
    monkeypatch.undo()
    clvol.pyramid(volume, tmp_path / "whole.zarr", **about)
    same_stores(target, tmp_path / "whole.zarr")


AT_ITS_END = """
    import os, signal, sys
    import numpy as np
    import clvol
    from clvol.formats.pyramid import journal

    journal._SECONDS = journal._SHARE = 0  # sync after each part

    def end(*_):
        os.kill(os.getpid(), signal.SIGKILL)

    if sys.argv[3] == "bounds":
        progress = lambda done: end() if done > 0.7 else None
    else:
        import shutil
        removed, progress = shutil.rmtree, None
        shutil.rmtree = lambda path, **more: end() if path.name == "replaced" else removed(path, **more)
    clvol.pyramid(clvol.Volume(np.load(sys.argv[1])), sys.argv[2], chunks=16, levels=2, filter="linear", overwrite=True,
                  progress=progress)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGKILL")
def test_a_process_killed_at_its_end_loses_nothing(tmp_path: Path) -> None:
    """During its bounds, and while it removes the replaced store."""
    np.save(tmp_path / "v.npy", waves((60, 70, 80)))
    volume, target = clvol.Volume(np.load(tmp_path / "v.npy")), tmp_path / "v.zarr"
    about: dict[str, Any] = {"chunks": 16, "levels": 2, "filter": "linear"}
    clvol.pyramid(volume, tmp_path / "whole.zarr", **about)
    clvol.pyramid(tiny(0), target, **TINY)
    told: list[float] = []
    for where, least in (("bounds", 0.3), ("end", 1.0)):
        command = [sys.executable, "-c", textwrap.dedent(AT_ITS_END), tmp_path / "v.npy", target, where]
        assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
        assert sum_at(target) == (tiny(0).data.sum() if where == "bounds" else volume.data.sum())
        told.clear()
        clvol.pyramid(volume, target, overwrite=True, progress=told.append, **about)
        assert told[0] >= least
        same_stores(target, tmp_path / "whole.zarr")
        assert not (tmp_path / ".v.zarr.unfinished").exists()


def test_missing_groups_are_created_on_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zarr creates an array and its groups in steps: a kill may leave the array alone."""
    volume = scan((20, 30, 40))  # so small that no coarser bounds make the groups
    about: dict[str, Any] = {"chunks": 16, "levels": 2, "filter": "linear"}
    whole = clvol.pyramid(volume, tmp_path / "whole.zarr", **about)

    async def ended(_store: Any, key: str, _value: Any) -> None:
        if key.startswith("clvol"):
            await asyncio.sleep(0.2)
            raise OSError("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(zarr.storage.LocalStore, "set_if_not_exists", ended)
        with contextlib.suppress(FormatError):  # zarr may create them differently
            clvol.pyramid(volume, tmp_path / "v.zarr", **about)
    again = clvol.pyramid(volume, tmp_path / "v.zarr", **about)
    same_stores(tmp_path / "v.zarr", tmp_path / "whole.zarr")
    files = [{one.relative_to(path) for one in path.rglob("*")} for path in (tmp_path / "v.zarr", tmp_path / "whole.zarr")]
    assert files[0] == files[1]
    assert again.bounds.within((0, 0, 0), (8, 8, 8)) == whole.bounds.within((0, 0, 0), (8, 8, 8))


def test_an_interrupt_leaves_only_data_to_resume_from(tmp_path: Path) -> None:
    def interrupted(done: float) -> None:
        if done > 0.4:
            raise KeyboardInterrupt

    volume, target = scan(), tmp_path / "v.zarr"
    with pytest.raises(KeyboardInterrupt):
        clvol.pyramid(volume, target, chunks=16, progress=interrupted)
    assert [one.name for one in tmp_path.iterdir()] == [".v.zarr.unfinished"]
    other = clvol.Volume(waves((50, 90, 70), seed=1), spacing=volume.spacing, units="um", space="image")
    with pytest.raises(FormatError, match="another command began"):
        clvol.pyramid(other, target, chunks=16)
    with pytest.raises(KeyboardInterrupt):  # another command that may replace what it finds
        clvol.pyramid(other, target, chunks=16, overwrite=True, progress=interrupted)
    with pytest.raises(FormatError, match="another command began"):
        clvol.pyramid(volume, target, chunks=16)
    told: list[float] = []
    clvol.pyramid(other, target, chunks=16, overwrite=True, progress=told.append)
    assert told[0] > 0.2  # and resumes its own
    clvol.pyramid(volume, target, chunks=16, overwrite=True)
    assert [one.name for one in tmp_path.iterdir()] == ["v.zarr"]
    np.testing.assert_array_equal(clvol.open(target).whole().data, volume.data)


SOURCES: dict[str, Any] = {
    "npy": clvol.open,
    "path": lambda path: path,
    "memory": np.load,
    "map": lambda path: clvol.LazyVolume(np.load(path, mmap_mode="r")[:, ::2], labels=False),
    "folder": lambda path: clvol.open(path.with_suffix(".zarr"), trusted=True),
    "array": lambda path: clvol.LazyVolume(zarr.open_array(path.with_suffix(".zarr"), mode="r"), labels=False),
    "h5": lambda path: clvol.open(path.with_suffix(".h5"), trusted=True),
    "h5py": lambda path: clvol.LazyVolume(__import__("h5py").File(path.with_suffix(".h5"))["v"], labels=False),
}


def put(path: Path, data: np.ndarray) -> None:
    np.save(path, data)
    chunked = zarr.create_array(path.with_suffix(".zarr"), shape=data.shape, chunks=(16,) * 3, dtype=data.dtype, overwrite=True)
    chunked[...] = data
    with __import__("h5py").File(path.with_suffix(".h5"), "w") as file:
        file["v"] = data


@pytest.mark.parametrize("name", SOURCES)
def test_a_changed_source_is_a_different_source(tmp_path: Path, name: str) -> None:
    """Even if only its first sample changed, among more samples than are compared."""
    pytest.importorskip("h5py")
    data = np.random.default_rng(0).integers(0, 200, (20, 20, 150), np.uint8)
    put(tmp_path / "v.npy", data)
    about: dict[str, Any] = {"filter": "linear", "levels": 1, "bounds": True}

    def interrupted(_: float) -> None:
        raise KeyboardInterrupt

    target = tmp_path / "made.zarr"
    for _ in range(2):  # the second resumes
        with pytest.raises(KeyboardInterrupt):
            clvol.pyramid(SOURCES[name](tmp_path / "v.npy"), target, progress=interrupted, **about)
    data[0, 0, 0] += 1
    time.sleep(0.02)
    put(tmp_path / "v.npy", data)
    with pytest.raises(FormatError, match=r"another command began \(source: .* and not .*\)"):
        clvol.pyramid(SOURCES[name](tmp_path / "v.npy"), target, **about)


def test_an_existing_store_is_kept_unless_overwrite_is_set(tmp_path: Path) -> None:
    target = tmp_path / "v.zarr"
    clvol.pyramid(scan(), target, levels=1)
    with pytest.raises(FormatError, match="there already; overwrite=True"):
        clvol.pyramid(scan((20, 20, 20)), target)
    clvol.pyramid(scan((20, 20, 20)), target, overwrite=True)
    assert clvol.open(target).shape == (20, 20, 20)
    assert [one.name for one in tmp_path.iterdir()] == ["v.zarr"]


def test_two_processes_do_not_write_one_store(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")

    def again(_: float) -> None:
        with pytest.raises(FormatError, match="another process is at work"):
            clvol.pyramid(scan(), tmp_path / "v.zarr", levels=1)

    clvol.pyramid(scan(), tmp_path / "v.zarr", levels=1, progress=again)


def test_invalid_samples_leave_nothing(tmp_path: Path) -> None:
    data = np.ones((20, 20, 20), np.float32)
    data[3, 4, 5] = np.nan
    with pytest.raises(DataError, match=r"NaN.*\[3, 4, 5\]"):
        clvol.pyramid(clvol.LazyVolume(data, labels=False), tmp_path / "v.zarr")
    assert not list(tmp_path.iterdir())
    filled = clvol.pyramid(clvol.LazyVolume(data, labels=False, missing=2), tmp_path / "v.zarr", filter="linear")
    assert filled.whole().data[3, 4, 5] == 2


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"memory": 1}, "memory must be more than 96 MiB"),
        ({"memory": 97 * MIB}, "memory must hold a brick of 64³ samples and its margin, [0-9]+ MiB; got 97 MiB$"),
        (
            {"memory": 110 * MIB, "filter": "bspline3(10000)"},
            r"its margin, [0-9]{3,} MiB; got 110 MiB: that of bspline3\(10000\) is wide, filter bspline3 needs 119 MiB",
        ),
        ({"memory": 97 * MIB, "bounds": False}, "memory must hold at least one column of chunks, [0-9]+ MiB; got 97 MiB"),
        ({"method": "median"}, "method must be one of"),
        ({"compressor": "zip"}, "compressor must be one of"),
        ({"version": "0.6"}, "version must be one of"),
        ({"chunks": 0}, "chunks must be"),
        ({"chunks": (1, 2)}, "chunks must be"),
        ({"chunks": 16, "shards": 40}, "shards must be whole numbers of chunks"),
        ({"shards": 64, "version": "0.4"}, "shards must be whole numbers of chunks"),
        ({"levels": 0}, "levels must be"),
        ({"filter": "hybrid"}, "hybrid|one kernel|filter must be"),
        ({"boundary": "zero"}, "continues the samples"),
        ({"boundary": "constant"}, "continues the samples"),
    ],
)
def test_bad_options_are_rejected_before_anything_is_written(tmp_path: Path, options: dict[str, Any], match: str) -> None:
    with pytest.raises(OptionError, match=match):
        clvol.pyramid(scan((70, 200, 200)), tmp_path / "v.zarr", **options)
    assert not list(tmp_path.iterdir())


def test_bad_sources_and_targets(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"\.zarr"):
        clvol.pyramid(scan(), tmp_path / "v.tif")
    with pytest.raises(FormatError, match="nothing can be made"):
        clvol.pyramid(scan(), tmp_path / "gone" / "v.zarr")
    with pytest.raises(DataError, match="3 axes"):
        clvol.pyramid(np.zeros((4, 4)), tmp_path / "v.zarr")
    with pytest.raises(FormatError, match="no such file"):
        clvol.pyramid(tmp_path / "gone.tif", tmp_path / "v.zarr")


def test_a_source_and_its_pyramid_must_be_separate(tmp_path: Path) -> None:
    store = tmp_path / "a.zarr"
    made = clvol.pyramid(scan((20, 30, 40)), store, levels=2, filter="linear")
    before = sorted(store.rglob("*"))
    (tmp_path / "link").symlink_to(store)
    zarr = pytest.importorskip("zarr")
    for source in (store, made, zarr.open(store)["0"], tmp_path / "link"):
        for target in (store / "b.zarr", store / "0" / "b.zarr", tmp_path / "link" / "b.zarr"):
            with pytest.raises(FormatError, match=r"lies in its own source.*choose a path beside"):
                clvol.pyramid(source, target, filter="linear")
    np.save(store / "v.npy", np.zeros((4, 4, 4)))
    for inner in (store / "0", store / "v.npy", np.load(store / "v.npy", mmap_mode="r")):
        with pytest.raises(FormatError, match=r"holds its own source.*choose another path"):
            clvol.pyramid(inner, store, filter="linear", overwrite=True)
    assert sorted(store.rglob("*")) == sorted([*before, store / "v.npy"])
    again = clvol.pyramid(
        store, store, levels=1, filter="linear", overwrite=True
    )  # it takes the place of its source once it is whole
    np.testing.assert_array_equal(again.whole().data, scan((20, 30, 40)).data)


def test_a_file_may_be_the_source(tmp_path: Path) -> None:
    """Opened, or read where the format has no partial reads."""
    volume = scan((20, 30, 40))
    clvol.write(volume, tmp_path / "v.npz")
    lazy = clvol.pyramid(tmp_path / "v.npz", tmp_path / "a.zarr", levels=2)
    again = clvol.pyramid(tmp_path / "a.zarr", tmp_path / "b.zarr", levels=2)
    np.testing.assert_array_equal(again.whole().data, volume.data)
    np.testing.assert_array_equal(again.levels[0].whole().data, lazy.levels[0].whole().data)


GROWS = """
    import sys
    from pathlib import Path
    import numpy as np
    import clvol

    class Formula:
        shape, dtype = (int(sys.argv[2]), 384, 512), np.dtype(np.uint16)

        def __getitem__(self, at):
            z, y, x = (np.arange(one.start, one.stop, dtype=np.uint16) for one in at)
            return (z[:, None, None] & 31) + (y[:, None] & 15) * (x & 7)

    def peak():
        return int(next(line for line in Path("/proc/self/status").open() if line.startswith("VmHWM")).split()[1]) << 10

    about = {"method": "average", "levels": 2, "bounds": False, "filter": "linear", "compressor": "none"}
    clvol.pyramid(clvol.Volume(np.zeros((70, 70, 70), np.uint16), labels=False), sys.argv[1] + "/a.zarr", **about)
    before, budget = peak(), 120 << 20
    volume = clvol.LazyVolume(Formula(), labels=False)
    assert volume.nbytes > 1.5 * budget
    volume = clvol.pyramid(volume, sys.argv[1] + "/b.zarr", memory=budget, **about)
    print(peak() - before, budget)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="read from /proc")
@pytest.mark.parametrize("deep", [512, pytest.param(1536, marks=pytest.mark.thorough)])
def test_memory_stays_within_the_budget(tmp_path: Path, deep: int) -> None:
    """For a larger volume: eight times the budget that remains beside Zarr and the device, or 24 times."""
    command = [sys.executable, "-c", textwrap.dedent(GROWS), tmp_path, str(deep)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    grown, budget = map(int, done.stdout.split())
    assert grown < budget


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_told_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """It said "[Errno 28] No space left on device" as the store's fault."""
    from zarr.storage import LocalStore

    set_chunk = LocalStore.set

    async def full(self: Any, key: str, value: Any) -> None:
        if "/c/" in key:
            raise OSError(number, os.strerror(number))
        await set_chunk(self, key, value)

    monkeypatch.setattr(LocalStore, "set", full)
    words = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the quota of the disk is used up"}[number]
    with pytest.raises(FormatError, match=f"cannot write .*v.zarr: {words}"):
        clvol.pyramid(scan(), tmp_path / "v.zarr")
