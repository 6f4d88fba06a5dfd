"""`clvol.dask` and the eager functions over random chunkings: equal within the stated bounds, lazy, with clear errors."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
import scipy.ndimage
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import clvol
from clvol import ClvolError, DataError, OptionError, ndimage
from clvol.base.errors import DtypeError, OptionTypeError, RefusedError, UnsupportedError
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.margin import LEFT_OUT
from clvol.filter.table import as_filter, filters
from clvol.ndimage.arguments import MODES
from clvol.ndimage.interpolation import __all__ as SCIPYS

dask = pytest.importorskip("dask")
da = pytest.importorskip("dask.array")
lazy = pytest.importorskip("clvol.dask")

Array = NDArray[Any]
EPSILON = LEFT_OUT
ROUNDING = {"single": 4e-7, "double": 1e-15}  # of the largest magnitude; of samples, through a prefilter of three axes


def weights_of(filter: Any, count: int = 2000) -> Array:
    """The prefilter's response to an impulse, at distances 0, 1, 2, ...: the middle row of the inverse of eq. (11)."""
    b = as_filter(filter).undone
    spectrum = b[0] + 2 * np.cos(np.outer(2 * np.pi * np.arange(count) / count, np.arange(1, b.size))) @ b[1:]
    return np.asarray(np.fft.ifft(1 / spectrum).real[: count // 2])


def gain(filter: Any) -> float:
    h = np.abs(weights_of(filter))
    return float(2 * h.sum() - h[0])


def chunkings(shape: tuple[int, ...], fewest: int = 1) -> st.SearchStrategy[tuple[tuple[int, ...], ...]]:
    """Chunks of any sizes along each axis, empty ones included."""

    def along(n: int) -> st.SearchStrategy[tuple[int, ...]]:
        cuts = st.lists(st.integers(0, n), max_size=4).map(sorted)
        return cuts.map(lambda at: tuple(np.diff([0, *at, n]).tolist()))

    return st.tuples(*(along(n) if n >= fewest else st.just((n,)) for n in shape))


def samples(shape: tuple[int, ...], kind: str = "f8", seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    if np.dtype(kind).kind in "iu":
        return rng.integers(0, 200, shape).astype(kind)
    made = rng.uniform(-1, 1, shape)
    return (made + 1j * rng.uniform(-1, 1, shape) if np.dtype(kind).kind == "c" else made).astype(kind)


def test_scipys_functions_match_ndimage() -> None:
    assert all(getattr(lazy, name) is getattr(ndimage, name) for name in SCIPYS)
    assert set(SCIPYS) < set(lazy.__all__)
    with pytest.raises(OptionError, match="chunks must be None where input is no array of dask; got 3"):
        ndimage.zoom(samples((5, 5)), 2, chunks=3)


def test_functions_of_volumes_are_those_of_clvol() -> None:
    assert (lazy.prefilter, lazy.resample, lazy.magnify) == (clvol.prefilter, clvol.resample, clvol.magnify)
    with pytest.raises(OptionError, match="chunks must be None where volume is no array of dask; got 3"):
        clvol.resample(samples((5, 5)), spacing=2.0, chunks=3)
    for function in (clvol.prefilter, clvol.magnify):
        with pytest.raises(OptionError, match=r"dimensions must be None where .* is no array of dask; got 2"):
            function(samples((5, 5)), dimensions=2)


# -- the margin --------------------------------------------------------------------------------------------------------


def test_cubics_reach_14_and_24_samples() -> None:
    assert (lazy.reach("bspline3"), lazy.reach("bspline3", "double")) == (14, 24)


@pytest.mark.parametrize("name", [*(name for name, row in filters().items() if row.settled), "bspline3(0.1)", "bspline5(0.1)"])
def test_the_reach_is_the_shortest_within_the_tolerance(name: str) -> None:
    row = as_filter(name)
    for precision, allowed in (("single", EPSILON["single"]), ("double", EPSILON["double"])):
        reach = lazy.reach(name, precision)
        h = np.abs(weights_of(row.magnified_by or row, 512))  # of more, the rounding adds up
        beyond = 2 * h[:0:-1].cumsum()[::-1] / gain(row.magnified_by or row)  # [d]: at distances of more than d
        assert beyond[reach] <= allowed * 1.01 + 1e-14
        assert reach == 0 or beyond[reach - 1] > allowed * 0.99 - 1e-14


def test_more_smoothing_reaches_further() -> None:
    reaches = [lazy.reach(f"bspline3({value})") for value in (1, 10, 100, 1e3, 1e4, 1e5)]
    assert reaches == sorted(reaches)
    assert reaches[-1] > 10 * reaches[0]
    assert lazy.reach("bspline3(0.1, 0.1, 100)") == lazy.reach("bspline3(100)")


# -- coefficients ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["single", "double"])
@given(data=st.data())
@settings(max_examples=6, deadline=None)
def test_coefficients_match_the_whole_array(precision: Any, data: st.DataObject) -> None:
    shape = tuple(data.draw(st.lists(st.integers(1, 40), min_size=1, max_size=3)))
    name = data.draw(st.sampled_from(["bspline3", "bspline2", "bspline5", "omoms3", "linear", "bspline3(0.5)", "bspline3(1000)"]))
    rule = data.draw(st.sampled_from([*clvol.boundaries(), "constant(2)", "grid-constant(-1)"]))
    whole = samples(shape, data.draw(st.sampled_from(["f8", "f4", "u1", "i2"])))
    blocks = da.from_array(whole, chunks=data.draw(chunkings(shape)))
    made = clvol.prefilter(blocks, name, rule, precision=precision)
    assert made.chunks == blocks.chunks
    assert made.dtype == {"single": np.float32, "double": np.float64}[precision]
    wanted = clvol.prefilter(whole, name, rule, precision=precision)
    got = made.compute()
    assert (got.dtype, got.shape) == (made.dtype, shape)
    # values outside, from "zero" and constants, count too
    span = 2 * max(float(np.abs(whole.astype(float)).max()), abs(as_boundary(rule).cval), 1e-9)
    d, largest = whole.ndim, gain(name) ** whole.ndim * span
    np.testing.assert_allclose(got, wanted, rtol=0, atol=(d * EPSILON[precision] + ROUNDING[precision]) * largest)


def test_the_stated_bound_is_tight() -> None:
    """For samples with the worst signs."""
    n, cut = 200, 100
    h = weights_of("bspline3")
    reach = lazy.reach("bspline3", "double")
    whole = np.ones(n)
    # past the margin, what is assumed (a mirror) has the other sign than what is there, as the weights want it
    for k in range(1, 30):
        whole[cut + reach - 1 + k] = np.sign(h[reach + k])
        whole[cut + reach - 1 - k] = -np.sign(h[reach + k])
    got = lazy.prefilter(da.from_array(whole, chunks=cut), precision="double").compute()
    error = np.abs(got - clvol.prefilter(whole, precision="double")).max()
    bound = EPSILON["double"] * gain("bspline3") * 2
    assert bound / 10 < error < bound + 1e-15


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("order", [2, 3, 5])
def test_coefficients_match_scipy(mode: str, order: int) -> None:
    whole = samples((61, 90))
    blocks = da.from_array(whole, chunks=((1, 20, 40), (13, 0, 60, 17)))
    made = ndimage.spline_filter(blocks, order, mode=mode)
    wanted = scipy.ndimage.spline_filter(whole, order, mode=mode)
    bound = 2 * EPSILON["double"] * gain(f"bspline{order}") ** 2 * 2
    np.testing.assert_allclose(made.compute(), wanted, rtol=0, atol=bound + 1e-14 * np.abs(wanted).max())
    for axis in (0, -1):
        line = ndimage.spline_filter1d(blocks, order, axis, mode=mode)
        assert line.chunks == blocks.chunks
        wanted = scipy.ndimage.spline_filter1d(whole, order, axis, mode=mode)
        np.testing.assert_allclose(line.compute(), wanted, rtol=0, atol=bound + 1e-14 * np.abs(wanted).max())


@pytest.mark.one_in(2)
@pytest.mark.parametrize("shape", [(2, 3, 20, 21, 22), (3, 30, 31)])
def test_leading_axes_are_separate_volumes(shape: tuple[int, ...]) -> None:
    whole = samples(shape, "f4")
    dimensions = None if len(shape) > 3 else 2
    blocks = da.from_array(whole, chunks=(1, *[7] * (len(shape) - 1)))
    count = dimensions or 3
    series = whole.reshape(-1, *shape[-count:])
    for name, call in (
        ("prefilter", lambda a, **o: clvol.prefilter(a, **o)),
        ("resample", lambda a, **o: clvol.resample(a, spacing=1.7, **o)),
        ("magnify", lambda a, **o: clvol.magnify(a, **o)),
    ):
        got = call(blocks, **({"dimensions": dimensions} if dimensions else {}))
        one = [np.asarray(call(volume)) for volume in series]
        assert got.shape == (*shape[:-count], *one[0].shape), name
        assert got.chunks[0] == blocks.chunks[0]
        np.testing.assert_allclose(got.compute().reshape(-1, *one[0].shape), one, atol=2e-5)


# -- grids -------------------------------------------------------------------------------------------------------------

TURN = np.array([[0.9, 0.2, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.1, 1.1]])
CALLS: dict[str, Any] = {
    "zoom 0.6": lambda a, **o: ndimage.zoom(a, 0.6, **o),
    "zoom 2": lambda a, **o: ndimage.zoom(a, 2, **o),
    "zoom on cells": lambda a, **o: ndimage.zoom(a, 0.7, grid_mode=True, **o),
    "zoom gaussian": lambda a, **o: ndimage.zoom(a, 0.4, anti_aliasing=True, **o),
    "zoom least-squares": lambda a, **o: ndimage.zoom(a, 0.4, anti_aliasing="least-squares", **o),
    "zoom by 1": lambda a, **o: ndimage.zoom(a, 1, **o),
    "shift": lambda a, **o: ndimage.shift(a, (3.3, 0, -17.5)[: a.ndim], **o),
    "shift far": lambda a, **o: ndimage.shift(a, 70.25, **o),
    "scaled": lambda a, **o: ndimage.affine_transform(a, [0.1, 2, 1][: a.ndim], [3, -5, 0][: a.ndim], **o),
    "turned": lambda a, **o: ndimage.affine_transform(a, TURN[: a.ndim, : a.ndim], [3, -5, 2][: a.ndim], **o),
    "diagonal": lambda a, **o: ndimage.affine_transform(a, 0.1 * np.eye(a.ndim), output_shape=(23,) * a.ndim, **o),
    "homogeneous": lambda a, **o: ndimage.affine_transform(a, np.column_stack([TURN, [3, -5, 2]])[: a.ndim, -a.ndim - 1 :], **o),
    "fewer axes": lambda a, **o: ndimage.affine_transform(a, TURN[: a.ndim, : a.ndim - 1], output_shape=(31,) * (a.ndim - 1), **o),
    "rotate": lambda a, **o: ndimage.rotate(a, 33, **o),
    "quarter": lambda a, **o: ndimage.rotate(a, 90, (0, a.ndim - 1), reshape=False, **o),
    "points": lambda a, **o: ndimage.map_coordinates(
        a, np.random.default_rng(3).uniform(-40, 80, (a.ndim, 7, 30)).astype("f4"), **o
    ),
    "points and infinities": lambda a, **o: ndimage.map_coordinates(a, [[1.5, np.nan, 3, np.inf, 0, 29]] * a.ndim, **o),
}


@pytest.mark.one_in(68)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", CALLS)
@given(data=st.data())
@settings(max_examples=3, deadline=None)
def test_grids_and_points_match_the_whole_array(name: str, mode: str, data: st.DataObject) -> None:
    shape = tuple(data.draw(st.lists(st.integers(2, 40), min_size=2, max_size=3)))
    kind = data.draw(st.sampled_from(["f8", "f8", "f4", "u1", "c16"]))
    order = data.draw(st.sampled_from([0, 1, 2, 3, 5]))
    options: dict[str, Any] = {"order": order, "mode": mode, "cval": 1.5, "prefilter": data.draw(st.booleans())}
    if name == "zoom least-squares" and order == 0:
        options["order"] = 1
    whole = samples(shape, kind)
    blocks = da.from_array(whole, chunks=data.draw(chunkings(shape)))
    with pytest.warns() if name == "zoom on cells" and mode in ("constant", "wrap") else dask.config.set({}):
        wanted, made = CALLS[name](whole, **options), CALLS[name](blocks, **options)
    assert (made.shape, made.dtype) == (wanted.shape, wanted.dtype)
    got = made.compute()
    assert (got.shape, got.dtype) == (wanted.shape, wanted.dtype)
    if kind == "u1":  # halves may round either way, as each window is computed in float32 or float64
        assert np.abs(got.astype(int) - wanted.astype(int)).max(initial=0) <= 1
        assert np.count_nonzero(got != wanted) <= max(9, 0.01 * got.size)
        return
    allowed = 2e-5 if kind == "f4" else 3e-11
    np.testing.assert_allclose(got, wanted, rtol=0, atol=allowed)


def test_points_past_a_last_chunk_of_one_sample_read_what_they_are_mirrored_to() -> None:
    whole, at = samples((2, 14)), [[0.8], [13.9]]
    made = ndimage.map_coordinates(da.from_array(whole, chunks=(2, 13)), at, order=0, mode="mirror")
    np.testing.assert_array_equal(made.compute(), ndimage.map_coordinates(whole, at, order=0, mode="mirror"))


@pytest.mark.one_in(14)
@pytest.mark.parametrize("mode", [mode for mode in MODES if mode != "grid-wrap"])
@pytest.mark.parametrize("order", [0, 1])
def test_without_a_prefilter_results_are_identical(order: int, mode: str) -> None:
    whole = samples((50, 41, 33))
    blocks = da.from_array(whole, chunks=(13, 8, 33))
    for name in ("zoom 0.6", "zoom 2", "zoom gaussian", "shift", "shift far", "scaled", "diagonal", "points and infinities"):
        wanted = CALLS[name](whole, order=order, mode=mode)
        np.testing.assert_array_equal(CALLS[name](blocks, order=order, mode=mode).compute(), wanted, err_msg=name)
    if order == 0:  # where the last bit of a position decides, it is the same
        for name in ("turned", "rotate", "quarter", "homogeneous"):
            wanted = CALLS[name](whole, order=order, mode=mode)
            np.testing.assert_array_equal(CALLS[name](blocks, order=order, mode=mode).compute(), wanted, err_msg=name)


def test_booleans_are_computed_in_double_precision() -> None:
    """Results are truncated: they differ only where the function is 1 to the last digits."""
    whole = scipy.ndimage.gaussian_filter(np.random.default_rng(0).random((40, 44, 48)), 2) > 0.5
    blocks = da.from_array(whole, chunks=(16, 20, 48))
    for order in (2, 3):
        wanted = ndimage.shift(whole, (1.5, 0, 0), order=order, mode="reflect")
        got = ndimage.shift(blocks, (1.5, 0, 0), order=order, mode="reflect").compute()
        exact = ndimage.shift(whole.astype(np.float64), (1.5, 0, 0), order=order, mode="reflect")
        assert np.abs(exact[got != wanted] - 1).max(initial=0) < 1e-12


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", ["constant", "wrap"])
def test_jumps_at_edges_keep_their_positions(mode: str) -> None:
    """Grids whose points lie on the outer samples, up to rounding."""
    whole = 1 + samples((31, 31, 8)) ** 2
    blocks = da.from_array(whole, chunks=(9, 7, 8))
    table = 0.1 * np.array([[1, 1, 0], [1, -1, 0], [0, 0, 10]])
    offset = [0.0, 15.0, 0.0]
    for order in (0, 1, 3):
        options: dict[str, Any] = {"output_shape": (151, 151, 8), "order": order, "mode": mode, "cval": -9.0}
        wanted = ndimage.affine_transform(whole, table, offset, **options)
        got = ndimage.affine_transform(blocks, table, offset, chunks=(40, 33, 8), **options).compute()
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("low_pass", [False, "gaussian", "least-squares"])
@given(data=st.data())
@settings(max_examples=5, deadline=None)
def test_resampled_volumes_match_the_whole_array(low_pass: Any, data: st.DataObject) -> None:
    shape = tuple(data.draw(st.lists(st.integers(2, 40), min_size=2, max_size=3)))
    name = data.draw(
        st.sampled_from(["bspline3", "linear", "nearest", "mitchell", "bspline5", "hybrid", "bspline3(0.5)", "lanczos3n"])
    )
    rule = data.draw(st.sampled_from(list(clvol.boundaries())))
    if low_pass == "least-squares":
        name = name if name in ("bspline3", "linear", "bspline5", "bspline3(0.5)") else "bspline2"
        rule = rule if rule != "zero" else "mirror"
    options: dict[str, Any] = {"filter": name, "boundary": rule, "anti_aliasing": low_pass}
    options["fill"] = data.draw(st.sampled_from([None, 7.0]))
    kind = data.draw(st.sampled_from(["f8", "f4", "u1", "i2"]))
    options["dtype"] = data.draw(st.sampled_from([None, "same", "f8"]))
    if options["dtype"] is None:
        options["precision"] = data.draw(st.sampled_from(["single", "double"]))
    if data.draw(st.booleans()):
        options["shape"] = tuple(data.draw(st.integers(1, 2 * n)) for n in shape)
    else:
        options |= {
            "spacing": data.draw(st.sampled_from([0.7, 1.0, 2.0, 3.3])),
            "anchor": data.draw(st.sampled_from(["center", "origin"])),
        }
    whole = samples(shape, kind)
    blocks = da.from_array(whole, chunks=data.draw(chunkings(shape)))
    wanted = clvol.resample(whole, **options).data
    made = clvol.resample(blocks, **options)
    assert (made.shape, made.dtype) == (wanted.shape, wanted.dtype)
    got = made.compute()
    largest = float(np.abs(whole.astype(float)).max()) + 1e-9
    if made.dtype.kind in "iu":
        assert np.abs(got.astype(int) - wanted.astype(int)).max(initial=0) <= 1
        assert np.count_nonzero(got != wanted) <= max(9, 0.01 * got.size)
    else:
        np.testing.assert_allclose(got, wanted, rtol=0, atol=largest * (2e-5 if options.get("precision") != "double" else 1e-11))


@pytest.mark.one_in(25)
@pytest.mark.parametrize("name", ["linear", "nearest", "mitchell", "catmull-rom", "bspline3-approx"])
@pytest.mark.parametrize("rule", ["mirror", "reflect", "zero", "nearest", "constant"])
def test_without_a_prefilter_volumes_are_identical(name: str, rule: str) -> None:
    whole = samples((40, 33, 27), "f4")
    blocks = da.from_array(whole, chunks=(11, 9, 27))
    for options in ({"shape": (17, 50, 9)}, {"spacing": 2.0}, {"spacing": 0.3, "fill": 4.0, "anchor": "origin"}):
        wanted = clvol.resample(whole, filter=name, boundary=rule, **options).data
        np.testing.assert_array_equal(clvol.resample(blocks, filter=name, boundary=rule, **options).compute(), wanted)
    np.testing.assert_array_equal(clvol.magnify(blocks, 3, name, rule).compute(), clvol.magnify(whole, 3, name, rule).data)


@pytest.mark.parametrize("rule", ["mirror", "wrap", "constant"])
def test_least_squares_is_bit_identical(rule: str) -> None:
    """Axes are summed in a fixed order, even if a block's window suggests another."""
    whole = samples((40, 90, 61), "f4")
    for shape in ((20, 45, 31), (11, 80, 20)):
        wanted = clvol.resample(whole, shape, boundary=rule, anti_aliasing="least-squares")
        for chunks in (16, (40, 9, 61), ((3, 37), 45, (60, 1))):
            made = lazy.resample(
                da.from_array(whole, chunks=chunks), shape, boundary=rule, anti_aliasing="least-squares", chunks=13
            )
            np.testing.assert_array_equal(made.compute(), wanted)


@pytest.mark.parametrize("kind", ["f4", "f8", "u1", "c8"])
def test_zoomed_least_squares_is_bit_identical(kind: str) -> None:
    whole = samples((40, 50, 61), kind)
    blocks = da.from_array(whole, chunks=(16, 50, 23))
    for options in (
        {"zoom": 0.5, "mode": "mirror"},
        {"zoom": (0.3, 1, 0.7), "mode": "constant", "cval": 1.5 - 2j if kind == "c8" else 1.5},
        {"zoom": 0.4, "mode": "grid-wrap", "grid_mode": True, "output": None if kind == "c8" else "i2"},
        {"zoom": 1, "prefilter": False, "output": None if kind == "c8" else "i2"},  # no axis is summed
    ):
        wanted = ndimage.zoom(whole, anti_aliasing="least-squares", **options)
        got = ndimage.zoom(blocks, anti_aliasing="least-squares", **options)
        assert got.dtype == wanted.dtype
        np.testing.assert_array_equal(got.compute(), wanted)


# -- pyramids ----------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("kind", "shape", "about"),
    [
        ("u2", (50, 90, 70), {"filter": "bspline3(0.3)"}),
        ("u1", (21, 64, 33), {"boundary": "wrap", "method": "average"}),
        ("f4", (9, 80, 80), {"filter": "bspline2", "boundary": "reflect", "spacing": (1, 1, 4)}),
        ("f8", (40, 20, 30), {"filter": "linear", "boundary": "nearest"}),
        ("u4", (30, 40, 20), {"method": "nearest"}),
    ],
)
def test_pyramids_match_stored_ones(tmp_path: Any, kind: str, shape: Any, about: dict[str, Any]) -> None:
    """To the last bit, whatever the chunks."""
    pytest.importorskip("zarr")
    whole, options = samples(shape, kind), {"filter": "bspline3", "boundary": "mirror"} | about
    volume = clvol.Volume(whole, spacing=options.pop("spacing", (1, 1, 1)), labels=False)
    method = options.pop("method", "least-squares")
    stored = clvol.pyramid(volume, tmp_path / "v.zarr", method=method, levels=3, bounds=False, **options)
    for chunks, into in ((32, None), ((13, 40, 80), (5, 40, 9))):
        blocks = da.from_array(whole, chunks=chunks)
        made = lazy.pyramid(blocks, 3, method=method, spacing=volume.spacing, chunks=into, **options)
        assert made[0] is blocks
        assert [one.shape for one in made[1:]] == [one.shape for one in stored.levels]
        for one, other in zip(made[1:], stored.levels, strict=True):
            assert one.dtype == whole.dtype
            np.testing.assert_array_equal(one.compute(), other.whole().data)


def test_pyramids_of_series_and_images() -> None:
    frames = da.from_array(samples((2, 3, 40, 50), "u2"), chunks=(1, 2, 20, 25))
    made = lazy.pyramid(frames, dimensions=2)
    assert [one.shape for one in made] == [(2, 3, 40, 50), (2, 3, 20, 25)]
    assert made[1].chunks == ((1, 1), (2, 1), (20,), (25,))
    one = lazy.pyramid(frames[1, 2], 2, chunks=7)[1]
    np.testing.assert_array_equal(made[1][1, 2].compute(), one.compute())
    volumes = lazy.pyramid(frames, 2)
    assert volumes[1].shape == (2, 2, 20, 25)
    assert [one.shape for one in lazy.pyramid(frames, 9, spacing=(1, 1, 2))][:3] == [(2, 3, 40, 50), (2, 3, 20, 25), (2, 2, 10, 13)]
    assert [one.name for one in lazy.pyramid(frames, 3)] == [one.name for one in lazy.pyramid(frames, 3)]
    broken = samples((20, 20, 20))
    broken[0, 3, 4] = np.nan
    halved = lazy.pyramid(da.from_array(broken, chunks=10), 2)[1]
    with pytest.raises(DataError, match=r"nan at \(0, 3, 4\) \(in block \(0, 0, 0\) of clvol.dask.pyramid"):
        halved.compute()


def test_integers_are_rounded_as_in_one_piece() -> None:
    whole = samples((40, 30, 20), "u1")
    blocks = da.from_array(whole, chunks=9)
    np.testing.assert_array_equal(  # halves away from zero, in SciPy's functions
        ndimage.zoom(blocks, 0.5, order=1, mode="mirror").compute(),
        ndimage.zoom(whole, 0.5, order=1, mode="mirror", small="opencl"),
    )
    halves = clvol.resample(whole, spacing=2.0, filter="linear", dtype="same").data  # and to even, in clvol's
    np.testing.assert_array_equal(clvol.resample(blocks, spacing=2.0, filter="linear", dtype="same").compute(), halves)


# -- points ------------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(12)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("where", ["input", "coordinates", "both"])
def test_points_may_be_either_array_type(where: str, mode: str) -> None:
    whole, at = samples((30, 25, 41)), np.random.default_rng(1).uniform(-60, 90, (3, 9, 40))
    data = whole if where == "coordinates" else da.from_array(whole, chunks=(30, 9, 17))
    points = at if where == "input" else da.from_array(at, chunks=(2, 4, 40))
    for order in (0, 1, 3):
        wanted = ndimage.map_coordinates(whole, at, order=order, mode=mode, cval=3.0)
        made = ndimage.map_coordinates(data, points, order=order, mode=mode, cval=3.0)
        assert made.chunks == (((9,), (40,)) if where == "input" else ((4, 4, 1), (40,)))
        np.testing.assert_allclose(made.compute(), wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [0, 1, 3])
def test_points_between_the_last_and_the_first_sample_of_every_period(order: int) -> None:
    whole = samples((25, 41))
    at = np.array([(x, y) for x in (-25.78, -0.78, -1e-18, -25.0, 24.5, 49.22, -51.0) for y in (-41.06, -0.06, 40.94, 81.9, 3.0)]).T
    wanted = scipy.ndimage.map_coordinates(whole, at, order=order, mode="grid-wrap")
    made = ndimage.map_coordinates(da.from_array(whole, chunks=(9, 17)), at, order=order, mode="grid-wrap")
    np.testing.assert_allclose(made.compute(), wanted, rtol=0, atol=1e-11)


def test_points_in_each_volume_of_a_series() -> None:
    whole, at = samples((4, 20, 22), "f4"), np.random.default_rng(1).uniform(0, 19, (2, 50))
    wanted = ndimage.map_coordinates(whole, at, axes=(2, 1))
    blocks = da.from_array(whole, chunks=(3, 7, 22))
    for points in (at, da.from_array(at, chunks=(2, 30))):
        made = ndimage.map_coordinates(blocks, points, axes=(2, 1))
        assert made.chunks[0] == (3, 1)
        np.testing.assert_allclose(made.compute(), wanted, atol=1e-5)
        np.testing.assert_allclose(
            lazy.map_coordinates(whole, da.from_array(at, chunks=(2, 30)), axes=(2, 1)).compute(), wanted, atol=1e-5
        )


def test_chunks_of_points_and_of_complex_samples() -> None:
    whole, at = samples((25, 30), "c16"), np.random.default_rng(1).uniform(0, 24, (2, 50))
    made = lazy.map_coordinates(da.from_array(whole, chunks=10), at, chunks=20)
    assert made.chunks == ((20, 20, 10),)
    np.testing.assert_allclose(made.compute(), ndimage.map_coordinates(whole, at), atol=1e-12)
    both = lazy.map_coordinates(whole, da.from_array(at, chunks=20), mode="grid-wrap")
    np.testing.assert_allclose(both.compute(), ndimage.map_coordinates(whole, at, mode="grid-wrap"), atol=1e-12)


def swirl(index: tuple[int, ...], by: float, *, center: float) -> tuple[float, ...]:
    return index[0] + by * (index[1] - center), index[1] * 0.5


def test_positions_by_a_function() -> None:
    whole = samples((30, 26))
    options: dict[str, Any] = {
        "output_shape": (20, 31),
        "extra_arguments": (0.3,),
        "extra_keywords": {"center": 7.0},
        "mode": "nearest",
    }
    made = ndimage.geometric_transform(da.from_array(whole, chunks=11), swirl, **options)
    assert made.chunks == ((11, 9), (11, 11, 9))
    np.testing.assert_allclose(made.compute(), ndimage.geometric_transform(whole, swirl, **options), atol=1e-12)
    with pytest.raises(
        OptionTypeError, match=r"mapping must return 2 real numbers.*in block \(0, \d, \d\) of clvol.dask.positions"
    ):
        ndimage.geometric_transform(da.from_array(whole, chunks=11), lambda index: index[0]).compute()


# -- laziness ----------------------------------------------------------------------------------------------------------


def recorded(shape: tuple[int, ...], chunks: int, dtype: str = "f4") -> tuple[Any, set[tuple[int, ...]]]:
    """A dask array, and the set of chunks that were read."""
    read: set[tuple[int, ...]] = set()

    def block(block_info: Any = None) -> Array:
        read.add(tuple(block_info[None]["chunk-location"]))
        return np.ones(block_info[None]["chunk-shape"], dtype)

    sizes = tuple(da.core.normalize_chunks(chunks, shape))
    return da.map_blocks(block, chunks=sizes, dtype=dtype, meta=np.empty((0,) * len(shape), dtype)), read


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", [*CALLS, "prefilter", "resample", "magnify", "spline_filter", "geometric_transform"])
def test_nothing_is_read_before_compute(name: str) -> None:
    data, read = recorded((40, 40, 40), 8)
    more: dict[str, Any] = {
        "prefilter": clvol.prefilter,
        "resample": lambda a: clvol.resample(a, spacing=2.0),
        "magnify": clvol.magnify,
        "spline_filter": ndimage.spline_filter,
        "geometric_transform": lambda a: ndimage.geometric_transform(a, lambda index: index),
    }
    made = {**CALLS, **more}[name](data)
    assert dask.is_dask_collection(made)
    assert read == set()
    assert made._meta.dtype == made.dtype
    assert sum(map(len, made.chunks)) > 3 or name.startswith("points")


def test_a_block_reads_only_what_it_needs() -> None:
    data, read = recorded((200, 200), 20)
    cases = [
        (clvol.prefilter(data).blocks[5, 5], {4, 5, 6}, {4, 5, 6}),  # 12 samples around 100:120
        (clvol.resample(data, spacing=0.5).blocks[10, 0], {4, 5, 6}, {0, 1}),  # 14 around 100:110; 0:10
        (clvol.resample(data, spacing=2.0, filter="linear").blocks[2, 2], {4, 5}, {4, 5}),  # 80.5 to 118.5
        (ndimage.shift(data, (40, 0), order=1).blocks[5, 5], {2, 3, 4}, {5}),  # 60 to 79, and their taps
        (ndimage.zoom(data, 2, order=1, mode="mirror").blocks[0, 0], {0}, {0}),
        (ndimage.rotate(data, 90, reshape=False, order=1).blocks[1, 4], {3, 4, 5}, {7, 8, 9}),
        (ndimage.map_coordinates(data, [[105.5], [30.2]], order=1), {5, 6}, {1, 2}),  # 100 to 120
        (ndimage.shift(data, 200, cval=1), set(), set()),  # all of it lies outside
    ]
    for number, (block, rows, columns) in enumerate(cases):
        read.clear()
        block.compute()
        extra = read - {(i, j) for i in rows for j in columns}
        assert not extra, (number, sorted(read))
    assert read == set()


def test_neighbours_take_few_tasks_and_little_traffic() -> None:
    """One task per neighbour would be 26 per block, most of a scheduler's work; whole neighbours would be 27 times the samples."""
    data = da.zeros((5 * 96,) * 3, chunks=96, dtype="uint8")
    made = clvol.prefilter(data)
    cut = {key: task for key, task in made.dask.items() if "-read-" in key[0]}
    assert len(cut) <= 6 * data.npartitions
    keys = list(dask.core.keys_in_tasks(set(made.dask), [made.dask[(made.name, 2, 2, 2)]]))
    assert len(keys) == 27
    passed = sum(sum(part.nbytes for part in one) if isinstance(one, list) else one.nbytes for one in dask.get(made.dask, keys))
    window = (96 + 2 * clvol.dask.reach("bspline3")) ** 3
    assert window <= passed <= 7 * 96**3  # 6.8 for margins of 14
    # windows of small chunks overlap: where they take more of a chunk than it has, it is passed on itself
    part = data[:80, :80, :80].rechunk(16)
    small = clvol.prefilter(part)
    cut = {key: task for key, task in small.dask.items() if "-read-" in key[0]}
    assert all(sum(piece.nbytes for piece in one) <= 16**3 for one in dask.get(small.dask, list(cut)))
    assert (part.name, 1, 2, 2) in dask.core.keys_in_tasks(set(small.dask), [small.dask[(small.name, 2, 2, 2)]])


def test_sums_process_one_axis_at_a_time() -> None:
    """A block reads its row, not its whole neighbourhood."""
    data = da.zeros((5 * 96,) * 3, chunks=96, dtype="uint8")
    for made in (
        clvol.resample(data, spacing=2.0, anti_aliasing="least-squares"),
        clvol.dask.pyramid(data, 2)[1],
        ndimage.zoom(data, 0.5, mode="mirror", anti_aliasing="least-squares"),
    ):
        for name, layer in made.dask.layers.items():
            rows = [set(dask.core.keys_in_tasks(set(made.dask), [task])) for key, task in layer.items() if "-read-" not in key[0]]
            assert "-along-" in name or name == data.name
            assert max(map(len, rows)) <= 5


def test_equal_calls_have_equal_keys() -> None:
    data = da.ones((20, 20), chunks=10)
    assert ndimage.zoom(data, 2).name == ndimage.zoom(data, 2).name != ndimage.zoom(data, 3).name
    assert clvol.prefilter(data).name == clvol.prefilter(data).name != clvol.prefilter(data, "bspline5").name
    assert clvol.resample(data, spacing=2.0, fill=0.0).name != clvol.resample(data, spacing=2.0).name


def test_only_required_blocks_are_computed() -> None:
    whole = samples((60, 60), "f4")
    part = clvol.prefilter(da.from_array(whole, chunks=20))[25:35, 5:15]
    np.testing.assert_allclose(part.compute(), clvol.prefilter(whole)[25:35, 5:15], atol=1e-5)


def test_chunks_of_results_match_those_of_the_input() -> None:
    data = da.zeros((100, 64), chunks=((30, 30, 40), (16,) * 4))
    assert ndimage.zoom(data, (2, 1)).chunks == ((40,) * 5, (16,) * 4)
    assert clvol.resample(data, spacing=(1, 2)).chunks == ((40, 10), (16,) * 4)
    assert clvol.resample(data, spacing=(1, 2), chunks=(25, 64)).chunks == ((25, 25), (64,))
    with pytest.raises(OptionError, match="chunks must fit a result of shape"):
        ndimage.shift(data, 1, chunks=((3, 3), (64,)))


# -- errors ------------------------------------------------------------------------------------------------------------


def test_a_missing_sample_is_reported_with_its_position_and_block() -> None:
    whole = samples((60, 60), "f4")
    whole[47, 3] = np.nan
    blocks = da.from_array(whole, chunks=20)
    with pytest.raises(
        DataError, match=r"finite; got nan at \(47, 3\) \(in block \(2, 0\) of clvol.dask.prefilter, which is \[40:60"
    ):
        clvol.prefilter(blocks).blocks[2, 0].compute()
    with pytest.raises(DataError, match=r"nan at \(47, 3\).*of clvol.dask.resample, which is \[20:30, 0:20\]"):
        clvol.resample(blocks, spacing=2.0).blocks[1, 0].compute()
    with pytest.raises(DataError, match=r'with nan="error".* nan at \(47, 3\)'):
        ndimage.shift(blocks, 1.5, nan="error").compute()
    with pytest.raises(DataError, match=r'with nan="error".* nan at \(47, 3\)'):
        ndimage.map_coordinates(blocks, [[40.5], [3.0]], nan="error").compute()
    got = ndimage.shift(blocks, 1.5, order=1).compute()  # it is passed on, as far as it has weight
    np.testing.assert_array_equal(np.isnan(got), np.isnan(ndimage.shift(whole, 1.5, order=1)))


def test_a_failing_block_is_named() -> None:
    data = da.ones((40, 40), chunks=20)
    with pytest.raises(
        OptionError, match=r"device must be one of .*\(in block \(\d, \d\) of clvol.dask.zoom, which is \[\d+:\d+, "
    ):
        ndimage.zoom(data, 2, device="no such device").compute(scheduler="sync")
    lies = da.map_blocks(lambda: np.ones((3, 3)), chunks=((20, 20), (20,)), dtype="f8", meta=np.empty((0, 0)))
    with pytest.raises(DataError, match=r"a chunk of an array of dask must have the shape that the array says, .*got \(3, 3\)"):
        clvol.prefilter(lies).compute()

    def broken(_: tuple[int, ...]) -> tuple[float, ...]:
        raise ZeroDivisionError("by the caller")

    with pytest.raises(ZeroDivisionError) as caught:
        ndimage.geometric_transform(data, broken).compute(scheduler="sync")
    assert any("of clvol.dask.positions, which is [0:2, " in note for note in caught.value.__notes__)


@pytest.mark.parametrize(
    ("call", "error", "rule"),
    [
        (lambda d: clvol.prefilter(d[d > 0]), DataError, "known shape"),
        (lambda d: ndimage.zoom(d[d[:, 0] > 0], 2), DataError, "known shape"),
        (lambda d: clvol.prefilter(d.astype(object)), DtypeError, "must be an array of"),
        (lambda d: clvol.resample(d.astype("c8"), spacing=2), DtypeError, "got complex64"),
        (lambda d: ndimage.zoom(d.astype("M8[s]"), 2), DtypeError, "datetime64"),
        (lambda d: ndimage.zoom(d.map_blocks(np.ma.asarray), 2), DataError, "made of arrays of NumPy"),
        (lambda d: clvol.resample(d[0], spacing=2), DataError, "at least 2 axes"),
        (lambda d: clvol.prefilter(d[0, 0]), DataError, "at least 1 axes"),
        (lambda d: clvol.prefilter(d[:0]), DataError, "one sample; got shape"),
        (lambda d: ndimage.zoom(d[0, 0], 2), RefusedError, "at least one axis"),
        (lambda d: ndimage.zoom(d, (2, 2, 2)), RefusedError, "one for each of the 2 axes"),
        (lambda d: ndimage.zoom(d, 2, order=9), RefusedError, "order"),
        (lambda d: ndimage.zoom(d, 2, mode="around"), RefusedError, "mode must be one of"),
        (lambda d: ndimage.zoom(d, 2, output=np.zeros((80, 80))), OptionTypeError, "output must be a dtype"),
        (lambda d: ndimage.zoom(d, 2, nan="local"), UnsupportedError, "may span blocks"),
        (lambda d: ndimage.spline_filter(d, nan="local"), OptionError, "depend on all samples"),
        (lambda d: ndimage.zoom(d, 2, progress=print), UnsupportedError, "ProgressBar"),
        (lambda d: ndimage.zoom(d, 2, device=3.5), OptionError, "device must be"),
        (lambda d: ndimage.rotate(d, np.nan), OptionError, "angle must be finite"),
        (lambda d: ndimage.affine_transform(d, np.eye(3)[:, :2]), RefusedError, "row"),
        (lambda d: ndimage.affine_transform(d[None, None], np.ones((4, 4))), UnsupportedError, "mix more than 3"),
        (lambda d: ndimage.map_coordinates(d, np.zeros((3, 5))), RefusedError, "2 axes"),
        (lambda d: ndimage.map_coordinates(d, da.zeros((3, 5))), RefusedError, "2 axes"),
        (lambda d: ndimage.map_coordinates(d, da.zeros((2, 5), dtype="c8")), DtypeError, "coordinates must be"),
        (lambda d: ndimage.map_coordinates(d[:0], np.zeros((2, 5)), mode="mirror"), DataError, "must have samples"),
        (lambda d: ndimage.zoom(d[:0], (1, 2), mode="mirror"), None, ""),
        (lambda d: clvol.resample(d, like=np.zeros((3, 3))), UnsupportedError, "no like"),
        (lambda d: clvol.resample(d, spacing=2, transform=np.eye(3)), UnsupportedError, "no transform"),
        (lambda d: clvol.resample(d), OptionError, "exactly one of"),
        (lambda d: clvol.resample(d, spacing=2, nan="local"), UnsupportedError, "nan must be"),
        (lambda d: clvol.resample(d, spacing=2, dtype="u1", fill=np.nan), OptionError, "fill must be"),
        (lambda d: clvol.resample(d, spacing=2, anti_aliasing="box"), OptionError, "anti_aliasing must be"),
        (lambda d: clvol.resample(d, spacing=2, filter="hybrid", anti_aliasing="least-squares"), OptionError, "hybrid"),
        (lambda d: clvol.prefilter(d, "bspline3(auto)"), OptionError, "decided from all samples"),
        (lambda d: clvol.prefilter(d, "bspline3(1, 2, 3)"), OptionError, "smoothing must be one number, or 2"),
        (lambda d: lazy.prefilter(d, dimensions=3), OptionError, "dimensions"),
        (lambda d: clvol.magnify(d, 0), OptionError, "factor"),
        (lambda d: lazy.pyramid(d, 0), OptionError, "levels"),
        (lambda d: lazy.pyramid(d, method="median"), OptionError, "method must be one of"),
        (lambda d: lazy.pyramid(d, filter="bspline3(auto)"), OptionError, "decided from all samples"),
        (lambda d: lazy.pyramid(d, filter="hybrid"), OptionError, "one kernel"),
        (lambda d: lazy.pyramid(d, boundary="zero"), OptionError, "continues the samples"),
        (lambda d: lazy.pyramid(d, spacing=(1, 2, 3)), ClvolError, "spacing"),
        (lambda d: lazy.pyramid(d, spacing=-1), ClvolError, "spacing"),
        (lambda d: lazy.pyramid(d, precision="half"), OptionError, "precision"),
        (lambda d: lazy.pyramid(d, device=3.5), OptionError, "device must be"),
    ],
)
def test_impossible_arguments_are_rejected_before_anything_is_read(call: Any, error: type[ClvolError] | None, rule: str) -> None:
    data, read = recorded((40, 40), 20)
    if error is None:
        assert call(data).compute().shape[0] == 0
    else:
        with pytest.raises(error, match=rule):
            call(data)
    assert read == set()


def test_arrays_without_samples() -> None:
    none = da.zeros((0, 30), chunks=(5, 10))
    assert ndimage.spline_filter(none).compute().shape == (0, 30)
    assert ndimage.shift(none, 1).compute().shape == (0, 30)
    made = ndimage.affine_transform(none, np.eye(2), output_shape=(3, 4), cval=5)
    np.testing.assert_array_equal(made.compute(), np.full((3, 4), 5.0))
    points = ndimage.map_coordinates(none, np.zeros((2, 6)), cval=5)
    np.testing.assert_array_equal(points.compute(), np.full(6, 5.0))
    assert ndimage.map_coordinates(da.ones((9, 9), chunks=4), np.zeros((2, 0))).compute().shape == (0,)


def test_eager_functions_still_read_the_array() -> None:
    whole = samples((20, 20, 20), "f4")
    blocks = da.from_array(whole, chunks=7)
    values = clvol.sample(blocks, [[3.0, 4.0, 5.0]])
    assert isinstance(values, np.ndarray)
    np.testing.assert_array_equal(clvol.Volume(blocks).data, whole)
    assert isinstance(clvol.resample(clvol.Volume(blocks), spacing=2.0), clvol.Volume)
    with ndimage.patched():  # as SciPy's own functions do
        assert isinstance(scipy.ndimage.zoom(blocks, 2), np.ndarray)


# -- workers -----------------------------------------------------------------------------------------------------------


def test_threads_compute_the_same(device: Device) -> None:
    whole = samples((64, 64, 64), "f4")
    made = clvol.prefilter(da.from_array(whole, chunks=16), device=device)
    one, many = made.compute(scheduler="sync"), made.compute(scheduler="threads", num_workers=8)
    np.testing.assert_array_equal(one, many)


def test_graphs_run_in_other_processes(device: Device) -> None:
    whole = samples((40, 40), "f4")
    made = clvol.resample(da.from_array(whole, chunks=20), spacing=2.0, device=device)
    back = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(back.compute(scheduler="sync"), made.compute(scheduler="sync"))


SPAWNED = """
import numpy as np, dask, dask.array as da, clvol
from clvol import ndimage

def main():
    whole = np.random.default_rng(0).normal(size=(48, 48, 48)).astype("f4")
    blocks = da.from_array(whole, chunks=24)
    wanted = clvol.prefilter(whole)
    with dask.config.set(scheduler="processes", num_workers=2, **{"multiprocessing.context": "spawn"}):
        print(np.abs(clvol.prefilter(blocks).compute() - wanted).max() < 2e-5)
        print(np.abs(ndimage.zoom(blocks, 0.5).compute() - ndimage.zoom(whole, 0.5)).max() < 2e-5)
    with dask.config.set(scheduler="processes", num_workers=2, **{"multiprocessing.context": "fork"}):
        try:  # this process has used OpenCL
            clvol.prefilter(blocks).compute()
        except clvol.DeviceError as error:
            print(error)

if __name__ == "__main__":
    main()
"""


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
def test_spawned_processes_compute_and_forked_ones_raise(tmp_path: Any) -> None:
    script = tmp_path / "spawned.py"
    script.write_text(SPAWNED, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, encoding="utf-8", timeout=240, check=False)
    lines = done.stdout.splitlines()
    assert lines[:2] == ["True", "True"], done.stderr
    assert "cannot be used after a fork; start processes with 'spawn'" in lines[2]
    assert "clvol.dask.prefilter" in lines[2]


def test_a_local_cluster(tmp_path: Any) -> None:
    distributed = pytest.importorskip("distributed")
    whole = samples((40, 48, 56), "f4")
    blocks = da.from_array(whole, chunks=24)
    with (
        dask.config.set({"temporary-directory": str(tmp_path), "distributed.worker.use-file-locking": False}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        seen = client.run(os.getpid)
        assert len(set(seen.values()) - {os.getpid()}) == 2
        assert not any(client.run(lambda: "pyopencl" in sys.modules).values())  # no device has been searched for yet
        np.testing.assert_allclose(clvol.prefilter(blocks).compute(), clvol.prefilter(whole), atol=2e-5)
        wanted = ndimage.rotate(whole, 20, mode="mirror")
        np.testing.assert_allclose(ndimage.rotate(blocks, 20, mode="mirror").compute(), wanted, atol=2e-5)
        whole[39, 0, 0] = np.inf
        with pytest.raises(DataError, match=r"got inf at \(39, 0, 0\) \(in block "):
            clvol.prefilter(da.from_array(whole, chunks=24)).compute()


def test_a_graph_is_built_without_opencl() -> None:
    code = (
        "import sys, dask.array as da, clvol; from clvol import ndimage\n"
        "d = da.zeros((64, 64, 64), chunks=16)\n"
        "clvol.prefilter(d), clvol.resample(d, spacing=2.0), clvol.magnify(d), ndimage.rotate(d, 20, nan='error')\n"
        "ndimage.map_coordinates(d, [[1.5]] * 3), ndimage.zoom(d, 0.5, anti_aliasing='least-squares')\n"
        "print([m for m in sys.modules if m == 'distributed'], clvol.device.choose._devices)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=120, check=False)
    assert done.stdout.split() == ["[]", "{}"], done.stderr


def test_blocks_take_turns_on_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels use all cores, and device memory of only one block is allocated at a time."""
    from clvol.spline import field

    inside, most, lock = 0, 0, threading.Lock()
    original = field.prefilter

    def counted(*arguments: Any, **options: Any) -> Any:
        nonlocal inside, most
        with lock:
            inside += 1
            most = max(most, inside)
        try:
            return original(*arguments, **options)
        finally:
            with lock:
                inside -= 1

    monkeypatch.setattr(field, "prefilter", counted)
    lazy.prefilter(da.ones((64, 64), chunks=8)).compute(scheduler="threads", num_workers=8)
    assert most == 1
