"""Samples far from zero: values, derivatives, surfaces and pictures, compared with SciPy and independent splines in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol import reference
from clvol.device import Device
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.reference.march.march import render
from tests.cases import MODES

Array = NDArray[np.float64]
SHAPE = (15, 17, 16)
PRESSURE = 101_325.0  # Pa
ORDERS = {"nearest": 0, "linear": 1, "bspline2": 2, "bspline3": 3, "bspline4": 4, "bspline5": 5}


def small(seed: int = 0) -> Array:
    """From -3 to 3."""
    return np.random.default_rng(seed).uniform(-3, 3, SHAPE)


def smooth() -> Array:
    """From -3 to 3 with 20 fractional bits, so that adding 2**17 in float64 is exact."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    values = 3 - 5 * (x**2 + 0.8 * y**2 + 0.6 * z**2) + 0.5 * np.sin(5 * x + 3 * y)
    return np.round(np.clip(values, -3, 3) * 2**20) / 2**20


def inside(count: int = 400, seed: int = 1) -> Array:
    return np.random.default_rng(seed).uniform(0, np.array(SHAPE[::-1]) - 1, (count, 3))


def scipy_values(data: Array, at: Array, order: int) -> Array:
    return np.asarray(ndimage.map_coordinates(data, at[:, ::-1].T, np.float64, order, "mirror"))


def cubic(x: Array) -> tuple[Array, Array, Array]:
    """The cubic B-spline and its first two derivatives."""
    a, s = np.abs(x), np.sign(x)
    inner, outer = a < 1, (a >= 1) & (a < 2)
    return (
        np.where(inner, 2 / 3 - a**2 + a**3 / 2, np.where(outer, (2 - a) ** 3 / 6, 0)),
        s * np.where(inner, -2 * a + 1.5 * a**2, np.where(outer, -((2 - a) ** 2) / 2, 0)),
        np.where(inner, 3 * a - 2, np.where(outer, 2 - a, 0)),
    )


def cubic_derivatives(data: Array, at: Array, orders: tuple[int, int, int]) -> Array:
    """A derivative of the interpolating cubic spline, well inside; `orders` along x, y, z."""
    coefficients = ndimage.spline_filter(data, 3, np.float64, "mirror")
    weights = [cubic(at[:, [axis]] - np.arange(n))[order] for axis, n, order in zip(range(3), SHAPE[::-1], orders, strict=True)]
    return np.asarray(np.einsum("zyx,nx,ny,nz->n", coefficients, *weights))


# -- values ----------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("boundary", ["zero", "grid-constant", "grid-constant(99999.5)"])
@pytest.mark.parametrize("name", ["linear", "bspline3", "bspline3(0.1)", "hybrid"])
def test_a_constant_outside_moves_with_the_samples(device: Device, name: str, boundary: str, precision: Any) -> None:
    """The ringing of the face, of 1e5, is about 10 in the middle, and the float32 error there 1e-6 of it; 0.03 unless moved."""
    if precision == "double" and not device.has_double:
        pytest.skip("the device has no float64")
    data, dice = small() + 1e5, np.random.default_rng(1)
    middle, outside = dice.uniform(6, 8, (200, 3)), dice.uniform(40, 60, (200, 3))
    within = {"single": 1e-4, "double": 1e-9}[precision]
    for shift in (0, 10**9):  # where float32 is 64 apart
        value = 0.0 if boundary in ("zero", "grid-constant") else 99999.5 + shift
        rule = boundary if value == 0 else f"grid-constant({value})"
        with clvol.Field(data + shift, name, rule, device, precision=precision) as field:
            expected = reference.sample(data + shift, middle, name, rule)
            step = abs(1e5 + shift - value)
            assert_allclose(field(middle), expected, rtol=0, atol=within * max(1, step / 1e5) + 32 * np.spacing(float(shift)))
            if value == 0:
                assert_array_equal(field(outside), np.zeros(200))
            else:
                assert_allclose(field(outside), value, rtol=0, atol=1e-6)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("offset", [PRESSURE, -1e12, 1e15], ids=str)
@pytest.mark.parametrize("name", ["linear", "bspline3", "bspline5"])
def test_double_precision_far_from_zero(device: Device, name: str, offset: float) -> None:
    """Values to the last digit that float64 has there; gradients, which have no offset, to the last but few."""
    if not device.has_double:
        pytest.skip("the device has no float64")
    data, at, options = small() + offset, inside(), {"device": device, "precision": "double"}
    exact = data - offset  # no rounding
    got = clvol.sample(data, at, name, **options) - offset
    assert_allclose(got, scipy_values(exact, at, ORDERS[name]), rtol=0, atol=np.spacing(abs(offset)) / 2 + 1e-13)
    with clvol.Field(data, name, **options) as far, clvol.Field(exact, name, **options) as near:
        assert_allclose(far.gradient(at), near.gradient(at), rtol=0, atol=1e-12)
    assert_allclose(
        clvol.prefilter(data, name, **options) - offset,
        clvol.prefilter(exact, name, **options),
        rtol=0,
        atol=np.spacing(abs(offset)) / 2 + 1e-11,
    )


@pytest.mark.parametrize("offset", [PRESSURE, -PRESSURE, 273.15, 1e8, 1e12], ids=str)
@pytest.mark.parametrize("name", ORDERS)
def test_values_match_scipy(device: Device, name: str, offset: float) -> None:
    data, at = small() + offset, inside()
    if name == "nearest":
        at = np.round(at) + np.random.default_rng(2).uniform(-0.4, 0.4, at.shape)  # SciPy takes another side at ½
        at = np.clip(at, 0, np.array(SHAPE[::-1]) - 1)
    got = clvol.sample(data, at, name, device=device)
    assert got.dtype == np.float64
    expected = scipy_values(data - offset, at, ORDERS[name])
    # how far float64 itself is off at this offset
    assert_allclose(
        got - offset, expected, rtol=0, atol=(2e-6 if name == "bspline5" else 1e-6) * np.ptp(data) + 3e-16 * abs(offset)
    )


@pytest.mark.parametrize(
    "data",
    [
        (small() + PRESSURE).astype(np.float32),
        (small() + PRESSURE).astype(">f4"),
        (small() + PRESSURE).astype(">f8"),
        (small() + PRESSURE).astype(np.longdouble),
        np.asfortranarray(small() + PRESSURE),
        np.repeat(small() + PRESSURE, 2, 0)[::2],
        (small() + 200).astype(np.float16),
        (1000 * small()).astype(np.int64) + 2**40,
        (1000 * small()).astype(np.int64) - 2**40,
        (1000 * small()).astype(np.int64).astype(np.uint64) + np.uint64(2**50),
        (1000 * small()).astype(">i8") + 2**40,
        (1000 * small()).astype(np.int32) + 2_000_000_000,
        ((1000 * small()) + 60_000).astype(np.uint16),
        (small() + 120).astype(np.int8),
    ],
    ids=lambda a: f"{a.dtype.str}{'' if a.flags.c_contiguous else ' strided'}",
)
def test_every_type_and_layout(device: Device, data: NDArray[Any]) -> None:
    at = inside()
    offset = float(data.flat[0])
    apart = (data.astype(np.float64) - offset) if data.dtype.kind != "u" else data.astype(np.int64).astype(np.float64) - offset
    got = clvol.sample(data, at, device=device) - offset
    assert_allclose(got, scipy_values(apart, at, 3), rtol=0, atol=1e-6 * np.ptp(apart) + 3e-16 * abs(offset))


def test_a_read_only_memory_map(device: Device, tmp_path: Any) -> None:
    np.save(tmp_path / "pressure.npy", small() + PRESSURE)
    data, at = np.load(tmp_path / "pressure.npy", mmap_mode="r"), inside()
    assert_allclose(clvol.sample(data, at, device=device) - PRESSURE, scipy_values(small(), at, 3), rtol=0, atol=6e-6)


@pytest.mark.parametrize("start", [2**53 + 2, 2**60 + 12345, -(2**62) + 7])
def test_differences_of_integers_beyond_float64_are_exact(device: Device, start: int) -> None:
    """float64 cannot represent the samples, but their gradients are small numbers."""
    steps = (100 * small()).astype(np.int64)
    at = inside()
    expected = np.stack([cubic_derivatives(steps.astype(np.float64), at, o) for o in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], -1)
    well = ((at > 3) & (at < np.array(SHAPE[::-1]) - 4)).all(-1)
    for data in [steps + start] if start < 0 else [steps + start, steps.astype(np.uint64) + np.uint64(start + 2**63)]:
        got = clvol.sample(data, at, derivative=1, device=device)
        assert_allclose(got[well], expected[well], rtol=0, atol=1e-5 * np.ptp(steps))


def test_images(device: Device) -> None:
    picture = small()[0] + PRESSURE
    at = inside()[:, :2]
    got = clvol.sample(picture, at, device=device)
    assert_allclose(got - PRESSURE, scipy_values(picture - PRESSURE, at, 3), rtol=0, atol=1e-6 * np.ptp(picture))
    wider = clvol.images.resample(picture, picture.shape, device=device)
    assert wider.dtype == np.float64
    assert_allclose(wider, picture, rtol=0, atol=1e-6 * np.ptp(picture))


def test_derivatives(device: Device) -> None:
    data, at = small() + PRESSURE, inside()
    at = at[((at > 3) & (at < np.array(SHAPE[::-1]) - 4)).all(-1)]
    with clvol.Field(data, device=device) as field:
        slopes, bends = field.gradient(at), field.hessian(at)
    for axis in range(3):
        orders = np.eye(3, dtype=int)[axis]
        assert_allclose(slopes[:, axis], cubic_derivatives(small(), at, tuple(orders)), rtol=0, atol=3e-6 * 6)
        assert_allclose(bends[:, axis, axis], cubic_derivatives(small(), at, tuple(2 * orders)), rtol=0, atol=1e-5 * 6)


# -- other grids, coefficients ---------------------------------------------------------------------------------------


def test_other_grids(device: Device) -> None:
    data = small() + PRESSURE
    finer = clvol.magnify(data, 2, device=device)
    assert finer.data.dtype == np.float64
    assert_allclose(finer.data[::2, ::2, ::2], data, rtol=0, atol=6e-6)
    same = clvol.resample(data, SHAPE, device=device)
    assert_allclose(same.data, data, rtol=0, atol=6e-6)
    angle = np.deg2rad(20)
    turned = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    grid = clvol.Volume(np.zeros((5, 6, 7)), (1.1, 0.9, 1.3), (4, 3, 5), turned)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), -1)[..., ::-1].reshape(-1, 3)
    at = grid.index_to_world(index)
    got = clvol.resample(data, like=grid, device=device).data.reshape(-1)
    assert_allclose(got - PRESSURE, scipy_values(data - PRESSURE, at, 3), rtol=0, atol=6e-6)


def test_outside_values_are_unchanged(device: Device) -> None:
    data = small() + PRESSURE
    at = np.array([[-5.0, 3, 3], [3, 3, 3], [np.nan, 3, 3], [40, 3, 3]])
    for fill in (0.0, 0.1, -7.0, np.nan, np.inf):
        got = clvol.sample(data, at, fill=fill, device=device)
        assert_array_equal(got[[0, 3]], [fill, fill])
        assert np.isnan(got[2])
        assert abs(got[1] - data[3, 3, 3]) < 6e-6
        assert_array_equal(
            clvol.sample(data, at, derivative=1, fill=fill, device=device)[[0, 3]], np.float32(np.full((2, 3), fill))
        )
    away = clvol.Volume(np.zeros((2, 2, 2)), origin=(-30.0, 0, 0))
    assert_array_equal(clvol.resample(data, like=away, fill=0.1, device=device).data, np.full((2, 2, 2), 0.1))
    beyond = clvol.sample(data, [[-2.25, 3.5, 3.25]], device=device)  # the boundary rule goes on
    assert_allclose(beyond - PRESSURE, reference.sample(data - PRESSURE, [[-2.25, 3.5, 3.25]]), rtol=0, atol=6e-6)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
@pytest.mark.parametrize("mode", ["mirror", "reflect"])
def test_coefficients(device: Device, order: int, mode: str) -> None:
    data = small() + PRESSURE
    got = clvol.prefilter(data, f"bspline{order}", mode, device=device)
    expected = ndimage.spline_filter(data - PRESSURE, order, np.float64, mode)
    assert_allclose(got - PRESSURE, expected, rtol=0, atol=2e-6 * np.ptp(expected))
    line = clvol.prefilter(data[0, 0], f"bspline{order}", mode, device=device)
    assert_allclose(line - PRESSURE, ndimage.spline_filter1d(small()[0, 0], order, -1, np.float64, mode), rtol=0, atol=1e-5)


def test_coefficients_of_a_kernel_that_does_not_sum_to_one(device: Device) -> None:
    """Twice the cubic B-spline: along three axes the coefficients of the same spline are an eighth."""
    double = Filter("double", tuple(tuple(2 * c for c in row) for row in bspline(3).taps), prefilter=True)
    data, at = small() + PRESSURE, inside()
    assert_allclose(clvol.sample(data, at, double, device=device) - PRESSURE, scipy_values(small(), at, 3), rtol=0, atol=6e-6)
    eighth = ndimage.spline_filter(small(), 3, np.float64, "mirror") / 8
    assert_allclose(clvol.prefilter(data, double, device=device) - PRESSURE / 8, eighth, rtol=0, atol=2e-6 * np.ptp(eighth))


@pytest.mark.parametrize("name", ["hybrid", "mitchell", "catmull-rom", "bspline3-approx", "omoms3"])
def test_other_filters_whose_weights_sum_to_one(device: Device, name: str) -> None:
    """An offset passes through unchanged. (Other tests compare values without it with the reference.)"""
    data, at = small() + PRESSURE, inside()
    got = clvol.sample(data, at, name, device=device) - PRESSURE
    assert_allclose(got, reference.sample(data - PRESSURE, at, name), rtol=0, atol=1e-5)


def test_filters_that_change_constants_get_no_offset(device: Device) -> None:
    data, at = small() + PRESSURE, inside()
    got = clvol.sample(data, at, "lanczos3", device=device)
    assert got.dtype == np.float32
    assert_allclose(got, reference.sample(data, at, "lanczos3"), rtol=1e-6)


def test_constants(device: Device) -> None:
    at = inside()
    assert_array_equal(clvol.sample(np.full(SHAPE, 0.1), at, device=device), np.full(len(at), 0.1))
    assert_array_equal(clvol.sample(np.full(SHAPE, 2**40 + 1), at, device=device), np.full(len(at), 2.0**40 + 1))
    assert clvol.sample(np.full(SHAPE, 7.0), at, device=device).dtype == np.float32


def test_ordinary_data_are_stored_unchanged(device: Device) -> None:
    for data in (small(), small() + 20, small().astype(np.float32), (100 * small()).astype(np.int16), np.zeros(SHAPE), small() > 0):
        with clvol.Field(data, device=device) as field:
            assert field.coefficients.stored.identity
            assert field(inside()).dtype == np.float32
            inner = field.volume.data
        with (
            clvol.Field(data, "linear", device=device) as field,
            device.buffers.mapped(field.coefficients.buffer, field.coefficients.shape, write=False) as room,
        ):
            assert_array_equal(room[field.coefficients.inner], inner.astype(np.float32))


def test_ordinary_integers_need_no_extra_pass(device: Device) -> None:
    volume = clvol.Volume((100 * small()).astype(np.int16))
    clvol.Field(volume, device=device).close()
    assert "limits" not in vars(volume)


def test_low_pass(device: Device) -> None:
    steps = (100 * small()).astype(np.int64)
    volume = clvol.Volume(steps + 2**40).gaussian(1.5)
    expected = ndimage.gaussian_filter(steps.astype(np.float64), 1.5, mode="mirror")
    assert_allclose(volume.data - 2.0**40, expected, rtol=0, atol=1e-3)  # float64 has 2.4e-4 there
    at = inside()
    assert_allclose(clvol.sample(volume, at, device=device) - 2.0**40, scipy_values(expected, at, 3), rtol=0, atol=2e-3)


# -- large integers in pictures --------------------------------------------------------------------------------------


@pytest.mark.one_in(6)
@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.int64, np.uint64], ids=lambda k: k.__name__)
@pytest.mark.parametrize("name", ["nearest", "linear", "bspline3", "bspline5", "catmull-rom", "lanczos3", "hybrid"])
def test_integer_images_round_trip(device: Device, kind: type[np.generic], name: str) -> None:
    rng = np.random.default_rng(3)
    low, high = (0 if np.iinfo(kind).min == 0 else -(2**31)), 2**31 - 1  # type: ignore[type-var]
    picture = rng.integers(low, high, (40, 31)).astype(kind)
    for got in (
        clvol.images.resample(picture, picture.shape, name, device=device),
        clvol.images.rotate(picture, 0, name, device=device),
        np.rot90(clvol.images.rotate(picture, 90, name, shape=(31, 40), device=device), -1),
        clvol.images.zoom(picture, 3, name, device=device)[1::3, 1::3],
    ):
        assert got.dtype == kind
        assert_array_equal(got, picture)


@pytest.mark.parametrize(
    ("kind", "start"),
    [(np.int32, 2**31 - 7), (np.int64, 2**60 + 1), (np.int64, -(2**63) + 6), (np.uint64, 2**63 + 5), (np.uint64, 2**64 - 7)],
    ids=str,
)
def test_integer_images_far_from_zero_round_trip(device: Device, kind: type[np.generic], start: int) -> None:
    steps = np.random.default_rng(4).integers(-6, 7, (30, 31))
    picture = np.array([[start + int(v) for v in row] for row in steps], dtype=kind)
    assert_array_equal(clvol.images.resample(picture, picture.shape, device=device), picture)
    turned = clvol.images.rotate(picture, 45, shape=(61, 61), fill=3, device=device)
    assert_array_equal(turned[[0, 0, -1, -1], [0, -1, 0, -1]], [3] * 4)
    finer = clvol.images.zoom(picture, 2, device=device)
    differences = np.array([[int(v) - start for v in row] for row in finer])
    smooth = ndimage.zoom(steps.astype(np.float64), 2, order=3, mode="mirror", grid_mode=True)
    lowest, highest = int(np.iinfo(kind).min) - start, int(np.iinfo(kind).max) - start  # type: ignore[type-var]
    at = np.clip(np.rint(smooth), lowest, highest)[4:-4, 4:-4]
    assert np.abs(differences[4:-4, 4:-4] - at).max() <= 1  # a half may be rounded to either side
    assert (differences[4:-4, 4:-4] == at).mean() > 0.99


@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.int64, np.uint64], ids=lambda k: k.__name__)
def test_constant_integer_images_stay_constant(device: Device, kind: type[np.generic]) -> None:
    limits = np.iinfo(kind)  # type: ignore[type-var]
    for value in (limits.min, limits.max, limits.max // 2 + 1, limits.max - 1):
        picture = np.full((9, 7), value, kind)
        for name in ("bspline3", "bspline5", "linear"):
            assert (clvol.images.zoom(picture, 2.3, name, device=device) == value).all()
        turned = clvol.images.rotate(picture, 30, shape=(21, 21), fill=3, device=device)
        assert set(turned.ravel().tolist()) == {value, 3} or value == 3


@pytest.mark.parametrize(("kind", "start"), [(np.uint64, 2**63), (np.int64, 2**61), (np.int64, -(2**62))], ids=str)
def test_the_range_of_integer_images_sets_their_accuracy(device: Device, kind: type[np.generic], start: int) -> None:
    """A range of 2⁴⁰ needs 40 bits of float64, wherever it lies."""
    steps = np.random.default_rng(6).integers(-(2**39), 2**39, (30, 31))
    picture = np.array([[start + int(v) for v in row] for row in steps], dtype=kind)
    finer = clvol.images.zoom(picture, 2, device=device)
    smooth = ndimage.zoom(steps.astype(np.float64), 2, order=3, mode="mirror", grid_mode=True)
    differences = np.array([[int(v) - start for v in row] for row in finer])
    assert np.abs(differences - np.rint(smooth))[4:-4, 4:-4].max() <= 1
    assert_array_equal(clvol.images.zoom(picture, 3, device=device)[1::3, 1::3], picture)


@pytest.mark.parametrize("low", [0, 5 - 2**62, -(2**63)], ids=str)
def test_images_of_the_full_range_do_not_wrap(device: Device, low: int) -> None:
    """From one end of the type to the other, and beyond both by a spline's overshoot."""
    kind, high = (np.uint64, 2**64 - 1) if low == 0 else (np.int64, 2**63 - 1)
    picture = np.array([[low] * 6 + [high] * 6] * 8, dtype=kind)
    for got in (clvol.images.zoom(picture, 3, device=device), clvol.images.zoom(picture[:, ::-1], 3, device=device)[:, ::-1]):
        rows = [[int(v) for v in row] for row in got]
        assert all(v - low < (high - low) // 4 for row in rows for v in row[:16])
        assert all(high - v < (high - low) // 4 for row in rows for v in row[-16:])
        off = [abs(int(v) - int(w)) for v, w in zip(got[1::3, 1::3].flat, picture.flat, strict=True)]
        assert max(off) < 2**16  # of 2⁶⁴, from rounding of positions


@pytest.mark.parametrize("kind", [np.uint16, np.int16, np.int32], ids=lambda k: k.__name__)
def test_integers_between_pixels_are_within_one(device: Device, kind: type[np.generic]) -> None:
    """float32 decides how values close to a half are rounded."""
    low, high = (-(2**15), 2**15) if kind is np.int32 else (np.iinfo(kind).min, np.iinfo(kind).max)  # type: ignore[type-var]
    picture = np.random.default_rng(7).integers(low, high, (60, 61)).astype(kind)
    got = clvol.images.zoom(picture, 1.7, device=device).astype(np.int64)
    rows, columns = (((np.arange(m) + 0.5) * n / m - 0.5)[4:-4] for m, n in zip(got.shape, picture.shape, strict=True))
    at = np.stack(np.meshgrid(rows, columns, indexing="ij"))
    limits = np.iinfo(kind)  # type: ignore[type-var]
    truth = np.clip(ndimage.map_coordinates(picture.astype(np.float64), at, order=3, mode="mirror"), limits.min, limits.max)
    assert np.abs(got[4:-4, 4:-4] - truth).max() < 0.52
    assert (got[4:-4, 4:-4] == np.rint(truth)).mean() > 0.98


def test_rotated_images_of_large_integers_match_scipy(device: Device) -> None:
    picture = np.random.default_rng(5).integers(-(2**31), 2**31, (40, 31)).astype(np.int32)
    got = clvol.images.rotate(picture, 30, "linear", fill=17, device=device)
    rows, columns = (np.array(picture.shape) - 1) / 2
    y, x = np.indices(picture.shape)
    cos, sin = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
    u, v = columns + cos * (x - columns) - sin * (y - rows), rows + sin * (x - columns) + cos * (y - rows)
    expected = ndimage.map_coordinates(picture.astype(np.float64), [v, u], order=1, mode="mirror")
    expected[(u < -0.5) | (u > 30.5) | (v < -0.5) | (v > 39.5)] = 17
    assert_allclose(got, expected, rtol=0, atol=0.51)


# -- pictures --------------------------------------------------------------------------------------------------------

FAR = 2.0**17
OUTPUTS = ("rgba", "depth", "normal", "position", "visited")


def looks(shift: float) -> dict[str, dict[str, Any]]:
    fog = clvol.TransferFunction(
        ((shift - 3, "black"), (shift + 3, "white")), ((shift - 1, 0.0), (shift + 0.5, 0.2), (shift + 3, 0.9))
    )
    ramp = clvol.TransferFunction.ramp((shift - 3, shift + 3))
    return {
        "isosurface": {"isovalue": shift + 0.25},
        "composite": {"transfer": fog},
        "mip": {"transfer": ramp},
        "minip": {"transfer": ramp},
        "mean": {"transfer": ramp},
        "attenuated": {"transfer": ramp},
    }


@pytest.mark.one_in(3)
@pytest.mark.parametrize("filter", ["bspline3", "linear", "hybrid"])
def test_pictures_do_not_depend_on_the_offset(device: Device, filter: str) -> None:
    options: dict[str, Any] = {"size": (41, 37), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume"), "outputs": OUTPUTS}
    with clvol.Renderer(smooth(), filter, device=device) as near, clvol.Renderer(smooth() + FAR, filter, device=device) as far:
        for (mode, plain), moved in zip(looks(0.0).items(), looks(FAR).values(), strict=True):
            one, other = near.render(mode=mode, **plain, **options), far.render(mode=mode, **moved, **options)
            for name in OUTPUTS:
                assert_allclose(other[name], one[name], rtol=0, atol=2e-6 if mode == "composite" else 0, err_msg=f"{mode} {name}")


def test_default_looks_do_not_depend_on_the_offset(device: Device) -> None:
    options: dict[str, Any] = {"size": (41, 37), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume")}
    with clvol.Renderer(smooth(), device=device) as near, clvol.Renderer(smooth() + FAR, device=device) as far:
        for mode in sorted(set(MODES) - {"integral"}):  # integrals of the offset are seen
            assert_allclose(far.render(mode=mode, **options), near.render(mode=mode, **options), rtol=0, atol=1e-5, err_msg=mode)


def test_the_surface_lies_at_the_isovalue(device: Device) -> None:
    data = smooth() + PRESSURE
    drawn = clvol.render(
        data,
        clvol.Camera.orbit(30, 20, fit="volume"),
        "isosurface",
        size=(41, 37),
        rays=1,
        isovalue=PRESSURE + 0.25,
        outputs=OUTPUTS,
        device=device,
    )
    at = drawn["position"].reshape(-1, 3).astype(np.float64)
    at = at[np.isfinite(at).all(-1)]
    assert len(at) > 150
    away = ((at >= 0) & (at <= np.array(SHAPE[::-1]) - 1)).all(-1)
    # 1e-4 of the range is the mode's tolerance
    assert_allclose(scipy_values(data - PRESSURE, at[away], 3), 0.25, rtol=0, atol=1e-3)
    assert np.isfinite(drawn["normal"][np.isfinite(drawn["depth"])]).all()


@pytest.mark.parametrize("name", ["linear", "bspline3"])
@pytest.mark.parametrize("boundary", ["zero", "grid-constant"])
def test_the_surface_with_a_constant_outside(device: Device, boundary: str, name: str) -> None:
    """Values of the float64 reference at positions of the surface, whose samples float32 rounds by 0.004."""
    data, high = smooth() + PRESSURE, np.array(SHAPE[::-1]) - 1
    clip = (np.full(3, 4.5), high - 4.5)  # the step at the faces rings
    look: dict[str, Any] = {"isovalue": PRESSURE + 2.2, "clip": clip, "size": (41, 37), "rays": 1, "outputs": "position"}
    camera = clvol.Camera.orbit(30, 20, fit="volume")
    for field in clvol.Field(data, name, boundary, device), clvol.BrickedField(data, name, boundary, device, edge=8):
        drawn = clvol.render(field, camera, "isosurface", **look)
        at = drawn.reshape(-1, 3).astype(np.float64)
        at = at[np.isfinite(at).all(-1)]
        at = at[((at > 4.6) & (at < high - 4.6)).all(-1)]
        assert len(at) > 20
        assert_allclose(reference.sample(data, at, name, boundary) - PRESSURE, 2.2, rtol=0, atol=1e-3)


def test_pictures_of_a_field_and_in_float32(device: Device) -> None:
    look: dict[str, Any] = {"mode": "isosurface", "size": (41, 37), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume")}
    plain = clvol.render(smooth(), isovalue=0.25, device=device, **look)
    with clvol.Field(smooth() + FAR, device=device) as field:
        assert_array_equal(clvol.render(field, isovalue=FAR + 0.25, **look), plain)
    quarters = np.round(smooth() * 4) / 4
    plain = clvol.render(quarters, isovalue=0.2, device=device, **look)
    moved = clvol.Scene((clvol.Medium((quarters + FAR).astype(np.float32)),))
    assert_array_equal(clvol.render(moved, isovalue=FAR + 0.2, device=device, **look), plain)


def test_skipping_changes_nothing(device: Device) -> None:
    options: dict[str, Any] = {"size": (41, 37), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume")}
    with clvol.Renderer(small() + PRESSURE, device=device) as renderer:
        for mode, look in looks(PRESSURE).items():
            pictures = [renderer.render(mode=mode, skipping=on, **look, **options) for on in (True, False)]
            assert_array_equal(*pictures, err_msg=mode)


def test_the_reference_renders_the_same(device: Device) -> None:
    data = smooth()[::2, ::2, ::2] + PRESSURE
    options: dict[str, Any] = {"size": (17, 15), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume")}
    for mode, look in looks(PRESSURE).items():
        got = clvol.render(data, mode=mode, device=device, **look, **options)
        expected = render(data, mode=mode, **look, **options)
        assert_allclose(got, expected["rgba"] if isinstance(expected, dict) else expected, rtol=0, atol=2e-3, err_msg=mode)


@pytest.mark.parametrize("how", ["gaussian", "least-squares"])
def test_sums_far_from_zero_keep_every_digit_that_samples_have(device: Device, how: Any) -> None:
    """Samples of 1e12 have 13 binary digits of a range of 1, and sums along an axis round once."""
    if not device.has_double:
        pytest.skip("needs doubles")
    above = np.random.default_rng(5).integers(0, 2**13, (20, 22, 24)) / 2.0**13
    far, shape = 1e12 + above, (10, 11, 12)
    grid = tuple((0.0, 2.0, n) for n in shape)
    if how == "gaussian":
        exact = ndimage.gaussian_filter(above, 0.5, mode="mirror")[::2, ::2, ::2]
        parts = ndimage.gaussian_filter(above, 0.5, mode="mirror")
        zoomed = np.asarray(ndimage.zoom(parts, 0.5, order=1, mode="mirror", grid_mode=False))
    else:
        exact = zoomed = reference.nearest_spline(above, grid, "linear", "mirror")
    options: Any = {"filter": "linear", "boundary": "mirror", "anti_aliasing": how}
    allowed = 4 * 2.0**-14  # four roundings
    made = clvol.resample(far, spacing=2.0, anchor="origin", device=device, **options).data
    assert_allclose(made - 1e12, exact, rtol=0, atol=allowed)
    bricks = clvol.resample(clvol.LazyVolume(far), spacing=2.0, anchor="origin", device=device, **options).data
    assert_allclose(bricks - 1e12, exact, rtol=0, atol=allowed)
    if how == "gaussian":
        found = clvol.ndimage.zoom(far, 0.5, order=1, mode="mirror", anti_aliasing="gaussian", device=device)
        assert_allclose(found - 1e12, zoomed, rtol=0, atol=allowed)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("how", [None, "gaussian", "least-squares"])
@pytest.mark.parametrize(("offset", "scale"), [(1e12, 1.0), (0.0, 1e300), (0.0, 1e-300), (3e9, None), (0.0, 1.0)])
def test_arrays_of_dask_keep_what_one_array_keeps(device: Device, how: Any, offset: float, scale: float | None) -> None:
    """By default, and of types that float32 does not hold; otherwise as stated. `scale` None: 64-bit integers."""
    da = pytest.importorskip("dask.array")
    if not device.has_double:
        pytest.skip("needs doubles")
    data: NDArray[Any] = np.random.default_rng(6).normal(size=(20, 18, 22))
    data = (1000 * data + offset).astype(np.int64) if scale is None else data * scale + offset
    options: Any = {"spacing": 2.0 if how else 0.7, "anti_aliasing": how or False, "boundary": "mirror", "device": device}
    exact = clvol.resample(data, precision="double", **options).data
    made = clvol.resample(da.from_array(data, chunks=9), **options)
    got = made.compute()
    assert made.dtype == got.dtype == np.float64
    assert_allclose(got, exact, rtol=0, atol=1e-6 * float(np.ptp(data)) + 2 * np.spacing(offset))
    if not how:
        finer = clvol.magnify(da.from_array(data, chunks=9), 2, boundary="mirror", device=device)
        sizes = clvol.magnify(data, 2, boundary="mirror", device=device).data
        assert_allclose(finer.compute(), sizes, rtol=0, atol=1e-6 * float(np.ptp(data)) + 2 * np.spacing(offset))


def test_zooms_of_dask_by_least_squares_keep_far_samples(device: Device) -> None:
    da = pytest.importorskip("dask.array")
    if not device.has_double:
        pytest.skip("needs doubles")
    above = np.random.default_rng(7).integers(0, 2**13, (20, 18, 22)) / 2.0**13
    made = clvol.ndimage.zoom(
        da.from_array(1e12 + above, chunks=9), 0.5, mode="mirror", anti_aliasing="least-squares", device=device
    )
    exact = clvol.ndimage.zoom(above, 0.5, mode="mirror", anti_aliasing="least-squares", precision="double", device=device)
    assert_allclose(made.compute() - 1e12, exact, rtol=0, atol=3 * 2.0**-14)
