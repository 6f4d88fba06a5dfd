"""`clvol.pyramid`: sizes that are what they should be, bounds that hold, and a store that is there whole or not at all."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import clvol
from clvol.boundary import as_boundary
from clvol.device import Device
from clvol.errors import ClvolError, DataError, FormatError, OptionError
from clvol.filter import as_filter
from clvol.formats._bounds import StoredBounds, blocks_of
from clvol.lazy import Bounds
from clvol.multiscale.levels import levels_of
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
    """All arrays of a store, as zarr reads them."""
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
def test_others_read_it(tmp_path: Path, version: Any) -> None:
    """The models of OME-Zarr, ome-zarr's reader and plain zarr, which do not know of bounds."""
    models = pytest.importorskip("ome_zarr_models")
    volume = scan(name="nuclei", window=(10, 5000), color=(0, 1, 0), origin=(1, 2, 3))
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
    assert (whole.spacing, whole.origin, whole.units, whole.name, whole.window, whole.color) == (
        volume.spacing,
        volume.origin,
        "um",
        "nuclei",
        (10, 5000),
        (0, 1, 0),
    )
    assert clvol.read(tmp_path / "v.zarr", level=1).origin == (1.25, 2.25, 3.25)


def test_sizes_are_those_of_one_piece(tmp_path: Path, device: Device) -> None:
    """The least-squares reduction of the whole volume, but for a rounding that falls on the other side."""
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
def test_no_bit_depends_on_budget_chunks_and_shards(tmp_path: Path, method: Any) -> None:
    volume = scan((70, 150, 130))
    about: dict[str, Any] = {"method": method, "levels": 3, "filter": "bspline3", "boundary": "reflect"}
    first = clvol.pyramid(volume, tmp_path / "a.zarr", **about)
    others = [
        clvol.pyramid(volume, tmp_path / "b.zarr", chunks=16, budget=144 * MIB, compressor="none", **about),
        clvol.pyramid(volume, tmp_path / "c.zarr", chunks=(16, 8, 32), shards=(32, 32, 32), compressor="lz4", **about),
    ]
    for other in others:
        for one, two in zip((first, *first.levels), (other, *other.levels), strict=True):
            np.testing.assert_array_equal(one.whole().data, two.whole().data)
    assert others[1].chunks == (16, 8, 32)


def test_tiles_are_cut_where_the_budget_says(device: Device) -> None:
    """Many tiles of a volume give what one does."""
    from clvol.multiscale.levels import sums_for
    from clvol.multiscale.reduce import Reduction

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
    looked_at = 128**3  # the part from which noise and labels are told
    assert counted.read <= counted.data.size + looked_at


def truth(points: np.ndarray) -> np.ndarray:
    """A function of three octaves, the highest of which half the samples still hold."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.asarray(np.sin(0.11 * x) * np.cos(0.13 * y) + 0.5 * np.sin(0.55 * x + 0.4 * z) + 0.25 * np.cos(1.0 * y + 0.3 * z))


def test_least_squares_is_nearer_to_the_function_than_averages(tmp_path: Path) -> None:
    """Half the samples, against the function itself; docs/stores.md has the figures."""
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


def test_types_keep_what_they_hold(tmp_path: Path) -> None:
    """Rounded to the nearest, and clipped where splines overshoot; none wraps around."""
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


def test_slices_far_apart_wait(tmp_path: Path) -> None:
    sizes = levels_of((256, 256, 40), (0.5, 0.5, 2.0), None, 32)
    assert [level.size for level in sizes] == [(256, 256, 40), (128, 128, 40), (64, 64, 40), (32, 32, 20)]
    assert sizes[3].factors == (8, 8, 2)
    lazy = clvol.pyramid(scan((9, 80, 80), spacing=(1, 1, 4)), tmp_path / "v.zarr", chunks=32, filter="linear")
    assert [level.spacing for level in lazy.levels] == [(2, 2, 4), (4, 4, 4)]


def test_scans_keep_their_place_in_the_world(tmp_path: Path) -> None:
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
def test_bounds_hold_the_function(
    tmp_path_factory: pytest.TempPathFactory, size: Any, filter: str, boundary: str, seed: int
) -> None:
    """The function at points of any box, computed in float64 from one piece, lies within the bounds of the box."""
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


def test_bounds_exclude_what_is_not_there(tmp_path: Path) -> None:
    """They are as narrow as those of the device's own pyramid, about: blocks away from a ball hold nothing of it."""
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


def test_zeros_alone_have_bounds_of_zero(tmp_path: Path) -> None:
    """And are stored, so that the store can be told from one that was not copied."""
    lazy = clvol.pyramid(clvol.Volume(np.zeros((70, 70, 70), np.float32), labels=False), tmp_path / "v.zarr", filter="bspline3")
    assert lazy.bounds is not None
    assert lazy.bounds.within((0, 0, 0), (69, 69, 69)) == lazy.limits == (0, 0)
    assert not lazy.whole().data.any()


def test_values_far_from_zero_have_bounds_of_their_size(tmp_path: Path) -> None:
    data = 1e6 + np.random.default_rng(0).random((20, 20, 20))
    lazy = clvol.pyramid(clvol.Volume(data.astype(np.float64)), tmp_path / "v.zarr", filter="linear", levels=1)
    assert lazy.bounds is not None
    low, high = lazy.bounds.within((0, 0, 0), (19, 19, 19))
    assert 1e6 - 0.01 < low <= data.min()
    assert data.max() <= high < 1e6 + 1.01


def test_bounds_that_do_not_fit_are_refused(tmp_path: Path) -> None:
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


def test_coarse_blocks_answer_for_large_boxes() -> None:
    """The same numbers as of all fine ones."""
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

    def slowly(done):
        print(done, flush=True)
        time.sleep(0.05)

    volume = clvol.Volume(np.load(sys.argv[1]), spacing=(0.5, 0.5, 0.5))
    clvol.pyramid(volume, sys.argv[2], chunks=8, levels=3, filter="bspline3", progress=slowly)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGKILL")
def test_a_killed_process_changes_nothing_but_time(tmp_path: Path) -> None:
    """Killed at several places, the store is the one that was made without; what was done is not done again."""
    np.save(tmp_path / "v.npy", waves((60, 70, 80)))
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


def test_an_interrupt_leaves_no_store_but_what_to_go_on_with(tmp_path: Path) -> None:
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
    assert told[0] > 0.2  # and goes on with its own
    clvol.pyramid(volume, target, chunks=16, overwrite=True)
    assert [one.name for one in tmp_path.iterdir()] == ["v.zarr"]
    np.testing.assert_array_equal(clvol.open(target).whole().data, volume.data)


def test_what_is_there_is_kept_unless_asked_for(tmp_path: Path) -> None:
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


def test_samples_that_cannot_be_used_leave_nothing(tmp_path: Path) -> None:
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
        ({"budget": 1}, "budget must be more than 96 MiB"),
        ({"budget": 97 * MIB}, "budget must hold a brick of 64³ samples and its margin, [0-9]+ MiB; got 97 MiB"),
        ({"budget": 97 * MIB, "bounds": False}, "budget must hold at least one column of chunks, [0-9]+ MiB; got 97 MiB"),
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
def test_bad_options_are_refused_before_anything_is_written(tmp_path: Path, options: dict[str, Any], match: str) -> None:
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


def test_a_file_is_its_source(tmp_path: Path) -> None:
    """Opened, or, where its format has no parts, read."""
    volume = scan((20, 30, 40))
    clvol.write(volume, tmp_path / "v.npz")
    lazy = clvol.pyramid(tmp_path / "v.npz", tmp_path / "a.zarr", levels=2)
    again = clvol.pyramid(tmp_path / "a.zarr", tmp_path / "b.zarr", levels=2)
    np.testing.assert_array_equal(again.whole().data, volume.data)
    np.testing.assert_array_equal(again.levels[0].whole().data, lazy.levels[0].whole().data)
