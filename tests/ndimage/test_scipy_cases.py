"""`clvol.ndimage` beside SciPy: random arrays, types, layouts, modes and orders."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import ndimage as scipy_ndimage

from clvol import ndimage
from clvol.device import Device
from tests.cases import examples
from tests.ndimage.truth import MODES, Array, assert_holds, reflected, tolerance, truth

DTYPES = ("?", "b", "B", "h", ">u2", "i", "I", ">i8", "Q", "e", "f", ">f4", "d", ">f8", "F", "D", ">c16")
OUTPUTS = (None, "f", "d", ">f4", ">f8", "h", "B", "?", "i")
CVALS = (0.0, 2.5, -7.0)

tried = settings(
    max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def samples(seed: int, dtype: Any, shape: tuple[int, ...], layout: str) -> Array:
    """An array of a type and layout, over the range of 8 and 16 bits, or of order 1 for floating types."""
    dtype, rng = np.dtype(dtype), np.random.default_rng(seed)
    wide = tuple(2 * n for n in shape) if layout == "strided" else shape
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        values = rng.integers(max(limits.min, -(2**20)), min(limits.max, 2**20), wide, endpoint=True)
    elif dtype.kind == "c":
        values = rng.standard_normal(wide) + 1j * rng.standard_normal(wide)
    else:
        values = rng.integers(0, 2, wide) if dtype.kind == "b" else rng.standard_normal(wide)
    array = values.astype(dtype)
    if layout == "strided":
        return array[(slice(None, None, -2),) * len(shape)]
    return np.asfortranarray(array) if layout == "fortran" else array


@st.composite
def cases(draw: st.DrawFn, least: int = 1, most: int = 4, longest: int = 17) -> dict[str, Any]:
    """An array and the options that all functions share."""
    ndim = draw(st.integers(least, most))
    shape = tuple(draw(st.integers(1, longest if ndim < 3 else 9 if ndim == 3 else 5)) for _ in range(ndim))
    dtype = draw(st.sampled_from(DTYPES))
    data = samples(draw(st.integers(0, 99)), dtype, shape, draw(st.sampled_from(["c", "fortran", "strided"])))
    cval = draw(st.sampled_from(CVALS))
    return {
        "data": data,
        "order": draw(st.integers(0, 5)),
        "mode": draw(st.sampled_from(MODES)),
        "cval": cval + 1j if data.dtype.kind == "c" else cval,
        "prefilter": draw(st.booleans()) or draw(st.booleans()),
        "output": draw(st.sampled_from(OUTPUTS)),
        "into": draw(st.booleans()),
        "precision": draw(st.sampled_from([None, None, "double", "single"])),
    }


def compare(name: str, device: Device, case: dict[str, Any], *arguments: Any, resampled: int | None = None, **options: Any) -> None:
    """One call, with and without an output array, compared with the truth."""
    data, output, order = case["data"], case["output"], case["order"]
    shared = {key: case[key] for key in ("order", "mode", "cval", "prefilter")}
    exact = truth(name, data, *arguments, **shared, **options)
    dtype = (
        None if output is None else np.result_type(np.dtype(output), np.complex64) if data.dtype.kind == "c" else np.dtype(output)
    )
    given: Any = dtype
    if case["into"] and dtype is not None:
        given = np.full([2 * n for n in exact.shape], 77, dtype)[(slice(None, None, 2),) * exact.ndim]
    result = getattr(ndimage, name)(data, *arguments, output=given, precision=case["precision"], device=device, **shared, **options)
    assert result is given or not isinstance(given, np.ndarray)
    assert result.dtype == (data.dtype.newbyteorder("=") if dtype is None else dtype)
    allowed = tolerance(data, order, case["precision"], data.ndim if resampled is None else resampled, case["cval"])
    assert_holds(result, exact, allowed)
    if case["precision"] is None:  # on no named device, so that SciPy computes what is small and simple
        result = getattr(ndimage, name)(data, *arguments, output=dtype, **shared, **options)
        assert result.dtype == (data.dtype.newbyteorder("=") if dtype is None else dtype)
        assert_holds(result, exact, allowed)


@tried
@given(case=cases(), seed=st.integers(0, 99), points=st.sampled_from([(7,), (2, 3), (1,), (0,), (40, 1)]))
def test_map_coordinates(device: Device, case: dict[str, Any], seed: int, points: tuple[int, ...]) -> None:
    data = case["data"]
    if data.ndim > 3:
        return
    rng = np.random.default_rng(seed)
    reach = np.array(data.shape).reshape(-1, *[1] * len(points))
    at = rng.uniform(-1.5, 2.5, (data.ndim, *points)) * reach
    whole = rng.random(at.shape) < 0.3
    at[whole] = np.round(at[whole])
    kind = ("d", "f", ">f8", "h", "d")[seed % 5]
    compare("map_coordinates", device, case, at.astype(kind))


@tried
@given(case=cases(), zoom=st.lists(st.sampled_from([0.3, 0.5, 0.9, 1, 1, 1.4, 2, 3.1]), min_size=4, max_size=4), grid=st.booleans())
def test_zoom(device: Device, case: dict[str, Any], zoom: list[float], grid: bool) -> None:
    data = case["data"]
    if case["prefilter"] and all(factor == 1 for factor in zoom[: data.ndim]):  # a copy, converted as NumPy does
        output = case["output"] if data.dtype.kind != "c" else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # that NumPy's conversion has no meaning beyond the type's range
            exact = scipy_ndimage.zoom(data, 1, output=None if output is None else np.dtype(output))
            result = ndimage.zoom(data, 1, output=None if output is None else np.dtype(output), device=device)
        assert result.dtype == exact.dtype
        np.testing.assert_array_equal(result, exact)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that grid_mode prefers other modes
        compare("zoom", device, case, zoom[: case["data"].ndim], grid_mode=grid)


@tried
@given(case=cases(), shift=st.lists(st.sampled_from([0, 0, 1, -2.0, 0.5, -0.3, 7.7, 40.2]), min_size=4, max_size=4))
def test_shift(device: Device, case: dict[str, Any], shift: list[float]) -> None:
    compare("shift", device, case, shift[: case["data"].ndim])


@tried
@given(
    case=cases(least=2, longest=12), angle=st.sampled_from([0, 90, -180, 33.3, 12, 400]), seed=st.integers(0, 9), grow=st.booleans()
)
def test_rotate(device: Device, case: dict[str, Any], angle: float, seed: int, grow: bool) -> None:
    axes = np.random.default_rng(seed).permutation(case["data"].ndim)[:2]
    compare("rotate", device, case, angle, tuple(axes.tolist()), grow, resampled=2)


@tried
@given(
    case=cases(), seed=st.integers(0, 999), kind=st.sampled_from(["full", "diagonal", "one axis", "pair", "blocks", "homogeneous"])
)
def test_affine_transform(device: Device, case: dict[str, Any], seed: int, kind: str) -> None:
    data, rng = case["data"], np.random.default_rng(seed)
    n = data.ndim
    matrix, offset = np.eye(n), np.round(rng.uniform(-2, 2, n), 1)
    shape = tuple(rng.integers(1, 7, n).tolist())
    arguments: tuple[Any, ...] = ()
    if kind == "one axis":
        matrix = np.round(rng.uniform(-2, 2, n), 1) + 0.01
    elif kind == "diagonal":
        matrix = np.diag(rng.choice([1, 0.5, -1.5, 0], n))
    elif kind == "pair" and n > 1:  # the other axes stay as they are
        a, b = sorted(rng.permutation(n)[:2])
        matrix[np.ix_([a, b], [a, b])] += rng.uniform(-0.5, 0.5, (2, 2))
        offset[[k for k in range(n) if k not in (a, b)]] = 0
        shape = tuple(m if k in (a, b) else length for k, (m, length) in enumerate(zip(shape, data.shape, strict=True)))
    elif kind == "blocks" and n == 4:
        order = rng.permutation(4)
        for block in (order[:2], order[2:]):
            matrix[np.ix_(block, block)] += rng.uniform(-0.5, 0.5, (2, 2))
    elif n < 4:
        matrix = matrix + rng.uniform(-0.5, 0.5, (n, n))
    if kind == "homogeneous":
        arguments = (np.vstack([np.column_stack([matrix, offset]), [0] * n + [1]]), 99.0, shape)
    else:
        arguments = (matrix, offset, shape)
    compare("affine_transform", device, case, *arguments)


@settings(tried, max_examples=examples(25))
@given(case=cases(most=3, longest=9), seed=st.integers(0, 99))
def test_geometric_transform(device: Device, case: dict[str, Any], seed: int) -> None:
    n, rng = case["data"].ndim, np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 6, rng.integers(1, 4)).tolist())
    mix = rng.uniform(-1, 2, (n, len(shape)))

    def mapping(index: tuple[int, ...], bend: float, *, start: float) -> tuple[float, ...]:
        return tuple(float(np.sin(bend * row @ index) + row @ index + start) for row in mix)

    compare("geometric_transform", device, case, mapping, shape, extra_arguments=(0.3,), extra_keywords={"start": -0.4})


@tried
@given(case=cases())
def test_spline_filter(device: Device, case: dict[str, Any]) -> None:
    data, order, mode, precision = case["data"], max(case["order"], 2), case["mode"], case["precision"]
    parts = [data.real, data.imag] if data.dtype.kind == "c" else [data]
    exact = [
        reflected(part.astype(float), order)
        if mode in ("reflect", "grid-mirror", "nearest")
        else scipy_ndimage.spline_filter(part.astype(float), order, mode=mode)
        for part in parts
    ]
    result = ndimage.spline_filter(data, order, mode=mode, precision=precision, device=device)
    assert result.dtype == (np.complex128 if data.dtype.kind == "c" else np.float64)
    allowed = tolerance(data, order, precision, data.ndim)
    for got, want in zip([result.real, result.imag], exact, strict=False):
        assert_holds(got, want, allowed)


@pytest.mark.parametrize("order", range(6))
@pytest.mark.parametrize("mode", MODES)
def test_spline_filter1d(device: Device, mode: str, order: int) -> None:
    data = samples(order, "d", (3, 8, 4), "strided")
    short = mode in ("reflect", "grid-mirror", "nearest") and order > 1
    for axis in (0, 1, -1):
        exact = reflected(data, order, [axis % 3]) if short else scipy_ndimage.spline_filter1d(data, order, axis, mode=mode)
        result = ndimage.spline_filter1d(data, order, axis, ">f8", mode, device=device)
        assert result.dtype == np.dtype(">f8")
        assert_holds(result, exact, tolerance(data, order, None, 1))


def test_integer_coefficients_are_truncated_after_each_axis_as_in_scipy(device: Device) -> None:
    data = samples(3, "h", (6, 7), "c")
    exact = scipy_ndimage.spline_filter(data, output=np.int32)
    result = ndimage.spline_filter(data, output=np.int32, precision="double", device=device)
    np.testing.assert_array_equal(result, exact)
    assert (exact != np.trunc(scipy_ndimage.spline_filter(data))).any()


@pytest.mark.parametrize("dtype", ["i", "H", "b", "B"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_halves_are_rounded_away_from_zero_and_clipped(device: Device, dtype: str, precision: Any) -> None:
    data = np.array([-300.0, -3, -2, -1, 0, 1, 2, 3, 300, 70000])
    at = [[0.5, 1, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 8, 9, 8.5]]
    exact = scipy_ndimage.map_coordinates(data, at, dtype, order=1)
    np.testing.assert_array_equal(ndimage.map_coordinates(data, at, dtype, order=1, precision=precision, device=device), exact)


@pytest.mark.parametrize("mode", ["constant", "grid-constant"])
@pytest.mark.parametrize("cval", [-300.0, -1.0, -0.6, 0.6, 1.5])
@pytest.mark.parametrize("dtype", [np.bool_, np.int16, np.float64])
def test_results_of_bool_are_those_of_scipy(device: Device, dtype: type[np.generic], cval: float, mode: str) -> None:
    """Negative results and constants, too: anything that does not round towards zero to 0."""
    data = np.array([0, 1, -3, 0, 4, -1, -1]).astype(dtype)
    at = [[0.0, 1, 2, 2.5, 4.5, 5.5, 1.6, -5, 20]]
    for order in (0, 1):
        exact = scipy_ndimage.map_coordinates(data, at, np.bool_, order, mode, cval)
        np.testing.assert_array_equal(ndimage.map_coordinates(data, at, np.bool_, order, mode, cval, device=device), exact)
    shifted = scipy_ndimage.shift(data, 2.3, np.bool_, 1, mode, cval)
    np.testing.assert_array_equal(ndimage.shift(data, 2.3, np.bool_, 1, mode, cval, device=device), shifted)


@pytest.mark.parametrize(("dtype", "cval"), [(np.uint8, -1.0), (np.uint16, -300.0), (np.int16, 0.6), (np.bool_, 3.0)])
def test_a_constant_that_the_input_cannot_hold(device: Device, dtype: type[np.generic], cval: float) -> None:
    """SciPy wraps it to the input's dtype where it prefilters; ours is SciPy's result for the same samples in float64."""
    data, at = np.random.default_rng(0).integers(0, 200, 30).astype(dtype), [np.linspace(-4, 34, 77)]
    for order in (1, 3):
        exact = scipy_ndimage.map_coordinates(data.astype(float), at, np.float64, order, "grid-constant", cval)
        got = ndimage.map_coordinates(data, at, np.float64, order, "grid-constant", cval, precision="double", device=device)
        np.testing.assert_allclose(got, exact, rtol=0, atol=1e-10)
    assert np.abs(scipy_ndimage.map_coordinates(data, at, np.float64, 3, "grid-constant", cval) - exact).max() > 0.1


@pytest.mark.one_in(24)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nonfinite_points_get_cval(device: Device, mode: str, value: float) -> None:
    data = samples(0, "d", (4, 5), "c")
    at = np.array([[1.0, value, 2.0], [1.5, 2.0, value]])
    for order in (0, 1, 3):
        result = ndimage.map_coordinates(data, at, order=order, mode=mode, cval=9.0, device=device)
        np.testing.assert_array_equal(result[1:], [9.0, 9.0])
        exact = truth("map_coordinates", data, at[:, :1], order=order, mode=mode, cval=9.0)
        assert result[0] == pytest.approx(exact[0], abs=1e-11)


def test_a_zoom_hits_or_misses_the_last_sample_as_in_scipy(device: Device) -> None:
    """Under "constant", a last position one rounding error beyond the last sample has another value."""
    missed = 0
    for n in range(2, 12):
        for m in range(2, 60):
            data = np.arange(1.0, n + 1)
            exact = scipy_ndimage.zoom(data, m / n, order=1, cval=-9)
            np.testing.assert_allclose(ndimage.zoom(data, m / n, order=1, cval=-9, device=device), exact, atol=1e-12)
            missed += int(exact[-1] == -9) if len(exact) else 0
    assert missed > 0


@pytest.mark.one_in(3)
@pytest.mark.parametrize("order", [0, 1, 3])
def test_axes_of_points_may_be_named(device: Device, order: int) -> None:
    series = samples(1, "f", (3, 5, 2, 6), "fortran")
    at = np.random.default_rng(0).uniform(0, 4, (2, 9))
    result = ndimage.map_coordinates(series, at, axes=(3, 1), order=order, mode="mirror", device=device)
    assert result.shape == (3, 2, 9)
    for t in range(3):
        for c in range(2):
            exact = truth("map_coordinates", series[t, :, c].T, at, order=order, mode="mirror")
            assert_holds(result[t, c], exact, tolerance(series, order, None, 2))
    one = ndimage.map_coordinates(series, at[:1], axes=-3, order=order, mode="mirror", device=device)
    assert one.shape == (3, 2, 6, 9)


@pytest.mark.one_in(24)
@pytest.mark.parametrize("order", range(6))
@pytest.mark.parametrize("mode", ["mirror", "wrap", "nearest", "grid-constant"])
def test_a_few_points_need_only_their_neighbourhood(device: Device, monkeypatch: pytest.MonkeyPatch, mode: str, order: int) -> None:
    from clvol.ndimage import engine

    seen = []
    evaluate = engine.evaluate
    monkeypatch.setattr(
        engine, "evaluate", lambda data, *rest, **options: (seen.append(data.shape), evaluate(data, *rest, **options))
    )
    data, rng = samples(11, "d", (180, 120, 14), "c"), np.random.default_rng(2)
    at = np.stack([rng.uniform(90, 95, 20), rng.uniform(-5, 60, 20), rng.uniform(3, 9, 20)]).astype(np.float32)
    at[1, 0] = -5
    result = ndimage.map_coordinates(data, at, order=order, mode=mode, cval=2, device=device)
    assert_holds(result, truth("map_coordinates", data, at, order=order, mode=mode, cval=2), tolerance(data, order, None, 3))
    assert [shape[1] for shape in seen] == [120]  # some points are beyond the edge
    assert seen[0][0] <= 7 + 2 * 47
    assert seen[0][2] == 14 or order < 2


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("axis", range(3))
def test_planes_are_independent(device: Device, axis: int, order: int) -> None:
    """Computed one by one, as with a missing sample, or together."""
    data = samples(12, "d", (5, 6, 7), "c")
    hurt = data.copy()
    hurt[2, 2, 2] = np.nan
    plane = tuple(k for k in range(3) if k != axis)
    together = np.moveaxis(ndimage.rotate(data, 25, plane, order=order, device=device), axis, 0)
    one_by_one = np.moveaxis(ndimage.rotate(hurt, 25, plane, order=order, device=device), axis, 0)
    assert np.isnan(one_by_one[2]).any()
    others = [k for k in range(len(together)) if k != 2]
    np.testing.assert_allclose(together[others], one_by_one[others], rtol=0, atol=1e-13)


@pytest.mark.parametrize("output", ["d", ">f8", "h"])
@pytest.mark.parametrize("moved", [(0,), (2,), (1, 3), (0, 1), (2, 3), (0, 1, 2, 3)])
def test_batches_of_one_and_two_axes(device: Device, moved: tuple[int, ...], output: str) -> None:
    """Of any layout, and with a missing sample, which forces one axis at a time."""
    for layout in ("c", "fortran", "strided"):
        data = 20 * samples(13, "d", (4, 3, 6, 5), layout)
        data[1, 2, 3, 4] = np.nan
        by = [0.3 if axis in moved else 0 for axis in range(4)]
        for order in (1, 3):
            exact = truth("shift", data, by, order=order, mode="mirror")
            if len(moved) < 4:  # SciPy takes every axis
                known = ~np.isnan(data).any(moved, keepdims=True)
                exact = truth("shift", np.nan_to_num(data), by, order=order, mode="mirror")
            else:
                known = ~np.isnan(exact)
            result = ndimage.shift(data, by, output, order=order, mode="mirror", device=device)
            chosen = np.broadcast_to(known, data.shape)
            assert_holds(result[chosen], exact[chosen], 1e-10)
            if output != "h" and len(moved) < 4:
                assert np.isnan(result[~chosen]).any()


def test_memory_of_a_batch_does_not_grow_with_the_zoom(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    from clvol.ndimage import engine

    made: list[int] = []
    into = engine._Store.into
    monkeypatch.setattr(engine, "_PART", 1 << 16)
    monkeypatch.setattr(engine._Store, "into", lambda self, output: (made.append(output.size), into(self, output))[1])
    data = samples(14, "B", (30, 8, 8), "c")
    result = ndimage.zoom(data, (1, 8, 8), order=1, device=device)
    assert max(made) * 4 <= 1 << 16
    assert sum(made) == result.size
    assert_holds(result, truth("zoom", data, (1, 8, 8), order=1, mode="constant"), tolerance(data, 1, None, 2))


@pytest.mark.parametrize("shape", [(9, 9), (5, 7, 9), (1, 9, 9)])
@pytest.mark.parametrize("mode", ["constant", "mirror"])
def test_positions_are_rounded_as_in_scipy(device: Device, shape: tuple[int, ...], mode: str) -> None:
    """The order of additions decides which sample is nearest to a point half-way between two."""
    rng, n, halves = np.random.default_rng(3), len(shape), 0
    data = np.arange(float(np.prod(shape))).reshape(shape)
    for _ in range(40):
        matrix, offset = np.round(rng.uniform(-1, 1, (n, n)), 1), np.round(rng.uniform(0, 6, n), 1)
        exact = scipy_ndimage.affine_transform(data, matrix, offset, order=0, mode=mode)
        result = ndimage.affine_transform(data, matrix, offset, order=0, mode=mode, device=device)
        np.testing.assert_array_equal(result, exact)
        at = np.tensordot(matrix, np.indices(shape), 1) + offset.reshape(-1, *[1] * n)
        halves += int((np.abs(at % 1 - 0.5) < 1e-9).sum())
    assert halves > 99


@pytest.mark.parametrize("order", [1, 3])
def test_unchanged_axes_are_exact(device: Device, order: int) -> None:
    """A sample missing in one image is missing in no other."""
    series = samples(2, "d", (4, 6, 7), "c")
    series[1, 3, 3] = np.nan
    moved = ndimage.shift(series, (0, 0.5, 0.25), order=order, mode="mirror", device=device)
    assert np.isnan(moved[1]).any()
    assert not np.isnan(moved[[0, 2, 3]]).any()
    whole = ndimage.zoom(series[0], 1, order=order, device=device)
    np.testing.assert_array_equal(whole, series[0])
    np.testing.assert_array_equal(ndimage.shift(series[0], 0, order=order, device=device), series[0])
    np.testing.assert_array_equal(ndimage.affine_transform(series[0], np.eye(2), order=order, device=device), series[0])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("dtype", ["d", ">f8"])
def test_lines_are_independent(device: Device, dtype: str, axis: int) -> None:
    """When one axis is resampled, a missing sample affects only its own line."""
    data = samples(3, "d", (5, 6, 7), "c").astype(dtype)
    data[2, 3, 4] = np.nan
    shift = np.where(np.arange(3) == axis, 1.25, 0)
    expected = scipy_ndimage.shift(np.nan_to_num(data).astype("d"), shift, mode="mirror")
    line = tuple(slice(None) if k == axis else at for k, at in enumerate((2, 3, 4)))
    expected[line] = np.nan
    np.testing.assert_allclose(ndimage.shift(data, shift, mode="mirror", device=device), expected, atol=1e-12)


@pytest.mark.one_in(16)
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("cval", [0.3, np.nan, np.inf])
def test_five_axes_are_resampled_in_two_passes(device: Device, mode: str, order: int, cval: float) -> None:
    if mode == "grid-constant" and not np.isfinite(cval):
        return  # in SciPy the prefilter spreads it over everything
    data = samples(4, "d", (3, 4, 2, 3, 5), "c")
    shift = (0.4, -0.3, 1.2, 0.7, -1.6)
    exact = truth("shift", data, shift, order=order, mode=mode, cval=cval)
    result = ndimage.shift(data, shift, order=order, mode=mode, cval=cval, device=device)
    np.testing.assert_allclose(result, exact, rtol=0, atol=1e-11 if order > 1 else 1e-13)
    if np.isfinite(cval):
        whole = ndimage.shift(data, shift, np.int16, order=order, mode=mode, cval=cval, device=device)
        assert_holds(whole, exact, 1e-11)


@pytest.mark.one_in(12)
@pytest.mark.parametrize("order", [0, 1, 3])
@pytest.mark.parametrize("mode", MODES)
def test_matrices_that_are_not_square(device: Device, mode: str, order: int) -> None:
    data, rng = samples(5, "d", (6, 5), "c"), np.random.default_rng(1)
    for columns, shape in ((1, (4,)), (3, (4, 3, 2))):
        matrix, offset = rng.uniform(-1, 1.5, (2, columns)), (0.3, -0.2)
        if columns != 3:
            exact = truth("affine_transform", data, matrix, offset, shape, order=order, mode=mode, cval=2)
            result = ndimage.affine_transform(data, matrix, offset, shape, order=order, mode=mode, cval=2, device=device)
        else:  # of two axes, a matrix with three columns is homogeneous
            exact = truth("affine_transform", data[0], matrix[:1], offset[:1], shape, order=order, mode=mode, cval=2)
            result = ndimage.affine_transform(data[0], matrix[:1], offset[:1], shape, order=order, mode=mode, cval=2, device=device)
        assert_holds(result, exact, 1e-11)


def test_a_zero_in_a_one_axis_matrix_is_exact(device: Device) -> None:
    """SciPy divides by it."""
    data = samples(6, "d", (4, 5), "c")
    exact = truth("affine_transform", data, np.diag([0, 0.5]), (1.3, 0.2), (3, 4), order=3, mode="mirror")
    result = ndimage.affine_transform(data, [0, 0.5], (1.3, 0.2), (3, 4), mode="mirror", device=device)
    assert_holds(result, exact, 1e-11)


def test_complex_samples_support_grid_mode(device: Device) -> None:
    data = samples(7, "D", (4, 5), "c")
    result = ndimage.zoom(data, 2, mode="mirror", grid_mode=True, device=device)
    exact = [scipy_ndimage.zoom(part, 2, mode="mirror", grid_mode=True) for part in (data.real, data.imag)]
    assert_holds(result, exact[0] + 1j * exact[1], 1e-11)


@pytest.mark.parametrize("name", ["spline_filter", "shift", "zoom", "affine_transform", "map_coordinates", "rotate"])
def test_input_and_output_may_overlap(device: Device, name: str) -> None:
    store = samples(8, "d", (9, 8), "c")
    data, output = store[:-1], store[1:]
    arguments: dict[str, tuple[Any, ...]] = {
        "shift": (0.4,),
        "zoom": (1.001,),
        "affine_transform": (np.eye(2) + 0.1,),
        "map_coordinates": (np.indices((8, 8)) + 0.3,),
        "rotate": (20, (1, 0), False),
    }
    function = getattr(ndimage, name)
    exact = function(data.copy(), *arguments.get(name, ()), device=device)
    result = function(data, *arguments.get(name, ()), output=output, device=device)
    assert result is output
    np.testing.assert_allclose(result, exact, rtol=0, atol=1e-12)
    at = np.indices((8, 8)) + 0.3
    exact = ndimage.map_coordinates(data.copy(), at, device=device)
    np.testing.assert_allclose(ndimage.map_coordinates(data.copy(), at, output=at[0], device=device), exact, rtol=0, atol=1e-12)


def test_points_are_processed_in_pieces(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    from clvol.ndimage import in_memory

    monkeypatch.setattr(in_memory, "_PIECE", 7)
    data = samples(9, "F", (4, 5), "c")
    seen: list[tuple[int, ...]] = []
    told: list[float] = []

    def mapping(index: tuple[int, ...]) -> list[float]:
        seen.append(index)
        return [index[0] + 0.2, 0.7 * index[1], 99]

    result = ndimage.geometric_transform(data, mapping, (6, 3), order=1, progress=told.append, device=device)  # type: ignore[arg-type]
    assert seen == list(np.ndindex(6, 3))
    assert told == sorted(told)
    assert told[-1] == 1
    exact = truth("geometric_transform", data, lambda i: tuple(mapping(i)), (6, 3), order=1, mode="constant")
    assert_holds(result, exact, tolerance(data, 1, None, 2))


@pytest.mark.parametrize("name", ["zoom", "shift", "affine_transform", "rotate", "map_coordinates", "spline_filter"])
def test_progress_is_reported(device: Device, name: str) -> None:
    data = samples(10, "D", (3, 4, 5, 6), "c")
    arguments: dict[str, tuple[Any, ...]] = {"zoom": (1.5,), "shift": (0.4,), "rotate": (20,)}
    arguments |= {"affine_transform": (np.eye(4) * 0.9,), "map_coordinates": (np.ones((2, 9)),)}
    options: dict[str, Any] = {"axes": (0, 2)} if name == "map_coordinates" else {}
    told: list[float] = []
    getattr(ndimage, name)(data, *arguments.get(name, ()), progress=told.append, **options, device=device)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)
    assert len(told) >= 2


@pytest.mark.parametrize("order", [0, 1, 3])
def test_arrays_without_samples(device: Device, order: int) -> None:
    empty = np.zeros((0, 4))
    assert ndimage.zoom(empty, 2, order=order, device=device).shape == (0, 8)
    assert ndimage.zoom(np.ones((3, 4)), (0.1, 2), order=order, device=device).shape == (0, 8)
    assert ndimage.zoom(np.ones((3, 4)), (0.1, 2), order=order, mode="mirror", grid_mode=True).shape == (0, 8)
    assert ndimage.spline_filter1d(empty, order, device=device).shape == (0, 4)
    assert ndimage.map_coordinates(np.ones((3, 4)), np.zeros((2, 0)), order=order, device=device).shape == (0,)
    assert ndimage.geometric_transform(np.ones((3, 4)), lambda i: i, (0, 3), order=order, device=device).shape == (0, 3)
    for mode in ("constant", "grid-constant"):
        result = ndimage.affine_transform(
            empty, np.eye(2), output_shape=(2, 2), order=order, mode=mode, cval=6.5, output=int, device=device
        )
        np.testing.assert_array_equal(result, 7)
    np.testing.assert_array_equal(ndimage.spline_filter(np.float64(3), device=device), 3)
    assert ndimage.spline_filter1d(np.int16(3), 1, device=device) == 3
