"""SciPy's functions of lazy volumes, compared with SciPy itself."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest
import scipy.ndimage

import clvol
from clvol import LazyVolume, ndimage
from clvol.base.errors import ClvolWarning, OptionError, OutOfMemoryError, UnsupportedError
from clvol.device import Device
from tests.bricks.test_chunks import Stored
from tests.bricks.test_source import Counted
from tests.ndimage.truth import MODES, SINGLE, truth

DATA = np.random.default_rng(1).random((30, 34, 41)).astype(np.float32)
AT = np.random.default_rng(2).uniform(-4, 40, (3, 20, 25))
MATRIX = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0] * 1.1
CALLS: dict[str, tuple[Any, ...]] = {
    "points": ("map_coordinates", AT),
    "a grid": ("affine_transform", MATRIX, (3, 25, 20), (20, 24, 28)),
    "a diagonal": ("affine_transform", (0.7, 1, 1.3), (-3, 0, 2.5)),
    "a plane": ("affine_transform", MATRIX[:, :2], (3, 9, 20), (20, 24)),
    "shift": ("shift", (3.3, 0, -50)),
    "zoom": ("zoom", (0.5, 1.3, 1)),
    "rotate": ("rotate", 33, (0, 2)),
}


@pytest.mark.one_in(28)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("call", CALLS)
def test_results_match_scipy(call: str, mode: str) -> None:
    name, *arguments = CALLS[call]
    lazy = LazyVolume(Counted(DATA), (2, 3, 4), (5, 6, 7), limits=(0, 1))  # a geometry has no say
    for order, prefilter in ((0, True), (1, True), (3, True), (3, False), (5, True)):
        if name == "rotate" and not prefilter:
            continue
        about: dict[str, Any] = {"order": order, "mode": mode, "cval": 0.4, "prefilter": prefilter}
        exact = truth(name, DATA, *arguments, **about)
        found = getattr(ndimage, name)(lazy, *arguments, **about)
        assert found.dtype == np.float32
        assert found.shape == exact.shape
        off = np.abs(found - exact) > 4 * SINGLE
        assert off.mean() <= (2e-3 if order == 0 else 0), f"order {order}"  # of order 0: positions halfway between two samples


def test_integers_are_rounded_and_output_is_filled() -> None:
    data = (DATA * 60000).astype(np.uint16)
    lazy = LazyVolume(data, limits=(0, 60000))
    exact = scipy.ndimage.zoom(data, 0.5)
    assert np.abs(ndimage.zoom(lazy, 0.5).astype(int) - exact).max() <= 1
    out = np.empty((2, *exact.shape), np.float64)[:, ::-1]
    assert ndimage.zoom(lazy, 0.5, out[1]) is not None
    np.testing.assert_allclose(out[1], scipy.ndimage.zoom(data.astype(np.float64), 0.5), rtol=0, atol=60000 * SINGLE)
    odd = AT.copy()
    odd[1, 3, 4] = np.nan
    assert ndimage.map_coordinates(lazy, odd, cval=7)[3, 4] == 7


def test_by_bricks_within_a_budget() -> None:
    """A given field is used, with its budget, and stays open."""
    lazy = LazyVolume(Counted(DATA), limits=(0, 1))
    told: list[float] = []
    with clvol.BrickedField(lazy, "bspline3", clvol.boundaries()["constant"], edge=8, memory=1 << 20) as field:
        found = ndimage.map_coordinates(field, AT, progress=told.append)
        assert field.reads.bricks > 1
        assert field.nbytes <= 1 << 20
        assert not field.closed
        with pytest.raises(UnsupportedError, match="its own filter and boundary rule"):
            ndimage.map_coordinates(field, AT, order=1)
    np.testing.assert_allclose(found, scipy.ndimage.map_coordinates(DATA.astype(np.float64), AT), rtol=0, atol=4 * SINGLE)
    assert told[-1] == 1


@pytest.mark.parametrize("mode", ["mirror", "grid-wrap", "nearest", "constant"])
@pytest.mark.parametrize("chosen", ["gaussian", "least-squares"])
def test_antialiased_reduction(chosen: Any, mode: str) -> None:
    """As for the whole array, and for least squares to the last bit."""
    for order, prefilter, zoom in ((3, True, (0.4, 0.7, 1.5)), (1, True, 0.5), (0, True, (1, 0.5, 0.3)), (3, False, 0.6)):
        about: dict[str, Any] = {"order": order, "mode": mode, "cval": 0.4, "prefilter": prefilter, "anti_aliasing": chosen}
        whole = ndimage.zoom(DATA, zoom, **about)
        told: list[float] = []
        found = ndimage.zoom(LazyVolume(Stored(DATA, (1, 34, 41)), limits=(0, 1)), zoom, progress=told.append, **about)
        assert (found.dtype, told[-1]) == (whole.dtype, 1)
        np.testing.assert_allclose(found, whole, rtol=0, atol=0 if chosen == "least-squares" else 4e-6)
    counts = (DATA * 60000).astype(np.uint16)
    whole = ndimage.zoom(counts, 0.5, mode=mode, anti_aliasing=chosen)
    found = ndimage.zoom(LazyVolume(counts, limits=(0, 60000)), 0.5, mode=mode, anti_aliasing=chosen)
    assert found.dtype == np.uint16
    assert np.abs(found.astype(int) - whole).max() <= 1


ROOM = 4 << 20  # bytes of a buffer: some bricks with their margins, but not the coefficients of all
LARGE = np.random.default_rng(5).random((400, 70, 60)).astype(np.float32)
LARGE_AT = np.random.default_rng(2).uniform(-4, 74, (3, 200)) * [[5], [1], [1]]
INSTEAD: dict[str, Any] = {
    "points": lambda data: ndimage.map_coordinates(data, LARGE_AT, mode="reflect"),
    "a grid": lambda data: ndimage.affine_transform(data, MATRIX, (3, 25, 20), (20, 24, 28), mode="reflect"),
    "shift": lambda data: ndimage.shift(data, (3.3, 0, -50), order=1, mode="mirror"),
    "zoom": lambda data: ndimage.zoom(data, 0.3, mode="mirror"),
    "fewer": lambda data: ndimage.zoom(data, 0.5, mode="mirror", anti_aliasing="least-squares"),
    "low-passed": lambda data: ndimage.zoom(data, 0.5, mode="mirror", anti_aliasing="gaussian"),
    "rotate": lambda data: ndimage.rotate(data, 33, (0, 2), False, order=1, mode="grid-wrap"),
    "resample": lambda data: clvol.resample(data, (30, 30, 30)).data,
    "sample": lambda data: clvol.sample(data, LARGE_AT[::-1].T),
    "a picture": lambda data: clvol.render(data, mode="mip", filter="linear", size=(24, 24), rays=1),
}


def with_buffers_of(monkeypatch: pytest.MonkeyPatch, nbytes: int) -> None:
    """Limit the device's buffers; allocations beyond raise an error."""
    monkeypatch.setattr(Device, "largest", property(lambda _: nbytes))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("call", INSTEAD)
def test_arrays_whose_coefficients_exceed_the_largest_buffer(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bricks are automatic, and a warning says that the last bits depend on them."""
    whole, made = INSTEAD[call](LARGE), []
    with_buffers_of(monkeypatch, ROOM)
    monkeypatch.setattr("clvol.ndimage.by_bricks._BLOCK", 32)  # of positions, which need buffers too
    begin = clvol.BrickedField.__init__
    monkeypatch.setattr(
        clvol.BrickedField, "__init__", lambda self, *args, **given: made.append(self) or begin(self, *args, **given)
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = INSTEAD[call](LARGE)
    assert made, "it is not by bricks"
    if call not in ("resample", "sample", "a picture"):
        assert [(one.category, one.filename) for one in told] == [(ClvolWarning, __file__)]
        assert re.search(r"goes by bricks.*allows one allocation of up to 4 MiB.*less than 1e-6", str(told[0].message))
    assert (found.dtype, found.shape) == (whole.dtype, whole.shape)
    np.testing.assert_allclose(found, whole, rtol=0, atol=4e-6)


def test_results_that_exceed_the_largest_buffer_are_computed_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    small = LARGE[:8, :8, :8]
    whole = ndimage.zoom(small, 8)
    with_buffers_of(monkeypatch, whole.nbytes // 3)
    np.testing.assert_array_equal(ndimage.zoom(small, 8), whole)


def test_results_that_bricks_would_change_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    with_buffers_of(monkeypatch, 1 << 20)
    missing = LARGE.copy()
    missing[3, 4, 5] = np.nan
    for call in (
        lambda: ndimage.shift(LARGE.astype(np.float64), 0.5),
        lambda: ndimage.shift(LARGE, 0.5, precision="double"),
        lambda: ndimage.shift(LARGE, 0.5, output=bool),
        lambda: ndimage.shift(LARGE + 1j, 0.5),
        lambda: ndimage.shift(missing, 0.5),
        lambda: ndimage.shift(LARGE, 0.5, nan="local"),
        lambda: ndimage.shift(data := LARGE.copy(), 0.5, output=data),
        lambda: ndimage.zoom(LARGE, 0.5, precision="double"),
    ):
        with pytest.raises(OutOfMemoryError, match="allows one allocation of up to 1 MiB"):
            call()


def test_unsupported_options_are_rejected_with_alternatives() -> None:
    lazy = LazyVolume(DATA, limits=(0, 1))
    for call in (
        lambda: ndimage.spline_filter(lazy),
        lambda: ndimage.spline_filter1d(lazy),
        lambda: ndimage.geometric_transform(lazy, lambda i: i),
        lambda: ndimage.zoom(lazy, 0.5, precision="double"),
        lambda: ndimage.shift(lazy, 0.5, nan="local"),
        lambda: ndimage.map_coordinates(lazy, AT[:2], axes=(1, 2)),
        lambda: ndimage.rotate(lazy, 33, prefilter=False),
    ):
        with pytest.raises(UnsupportedError, match=r"part by part.*dask.*volume\.whole\(\)\.data"):
            call()
    for wrong in ({"order": 7}, {"mode": "far"}, {"cval": "x"}):
        with pytest.raises(OptionError):
            ndimage.shift(lazy, 0.5, **wrong)
