"""`Interpolator` beside SciPy's RegularGridInterpolator and its splines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator, make_interp_spline

import clvol
from clvol import ClvolError, DataError, GeometryError, Interpolator, OptionError
from clvol.device import Device

Array = NDArray[Any]
ALLOWED = {"single": 2e-6, "double": 4e-15}  # of the largest value


def grid_and_points(d: int, seed: int = 0) -> tuple[tuple[Array, ...], Array]:
    """Coordinates with a different spacing per axis, one descending, and points inside."""
    axes = (np.linspace(-2, 5, 9), np.linspace(30, 10, 8), np.linspace(0.1, 0.4, 12))[:d]
    low, high = np.array([min(x[0], x[-1]) for x in axes]), np.array([max(x[0], x[-1]) for x in axes])
    return axes, np.random.default_rng(seed).uniform(low, high, (60, d))


@pytest.mark.one_in(4)
@pytest.mark.parametrize("precision", ALLOWED)
@pytest.mark.parametrize("trailing", [(), (2, 3)])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_linear_matches_scipy(d: int, trailing: tuple[int, ...], precision: Any, device: Device) -> None:
    axes, points = grid_and_points(d)
    values = np.random.default_rng(1).normal(size=tuple(x.size for x in axes) + trailing)
    wanted = RegularGridInterpolator(axes, values)
    with Interpolator(axes, values, "linear", precision=precision, device=device) as at:
        got, allowed = at(points), 4 * ALLOWED[precision]
        assert got.dtype == {"single": np.float32, "double": np.float64}[precision]
        assert got.shape == wanted(points).shape
        np.testing.assert_allclose(got, wanted(points), atol=allowed)
        # the forms in which points may come
        np.testing.assert_allclose(at(points[0]), wanted(points[0]), atol=allowed)
        assert at(points.reshape(6, 10, d)).shape == (6, 10, *trailing)
        several = tuple(np.moveaxis(points.reshape(6, 10, d), -1, 0)) if d > 1 else (points[:, 0],)
        np.testing.assert_allclose(at(several), wanted(several), atol=allowed)


@pytest.mark.one_in(40)
@pytest.mark.parametrize("precision", ALLOWED)
@pytest.mark.parametrize("order", [2, 3, 5])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_periodic_splines_and_derivatives_match_scipy(d: int, order: int, precision: Any, device: Device) -> None:
    """Tensor products of SciPy's splines on closed curves, where both define the same spline."""
    sizes, periods = (9, 8, 11)[:d], (2.0, 30.0, 0.5)[:d]
    axes = [p * np.arange(n) / n for n, p in zip(sizes, periods, strict=True)]
    values = np.random.default_rng(order).normal(size=sizes)
    points = np.random.default_rng(1).uniform(0, periods, (40, d))

    def along(axis: int, nu: int) -> Array:
        """Weights of the samples along an axis at the points; shape (points, samples)."""
        n, knots = sizes[axis], np.append(axes[axis], periods[axis])
        unit = np.vstack([np.eye(n), np.eye(n)[:1]])
        # an even degree has its knots between the samples, which SciPy's periodic splines have not: by Fourier then
        if order % 2:
            return np.asarray(make_interp_spline(knots, unit, k=order, bc_type="periodic")(points[:, axis], nu=nu))
        kernel, step = clvol.bspline(order), periods[axis] / n
        matrix = sum(np.roll(np.eye(n), k, 1) * kernel(float(k)) for k in (-1, 0, 1))
        distance = points[:, axis, None] / step - np.arange(n)
        basis = sum(kernel(distance + shift * n, nu) for shift in (-1, 0, 1)) / step**nu
        return np.asarray(basis @ np.linalg.inv(matrix))

    with Interpolator(axes, values, f"bspline{order}", False, None, boundary="wrap", precision=precision, device=device) as at:
        for nu in np.ndindex((3,) * d):
            if sum(nu) <= 2:
                weights = [along(axis, n) for axis, n in enumerate(nu)]
                wanted = np.einsum(values, range(d), *(v for i, w in enumerate(weights) for v in (w, [d, i])), [d])
                np.testing.assert_allclose(at(points, nu=nu), wanted, atol=20 * ALLOWED[precision] * np.abs(wanted).max())


def test_polynomials_have_their_derivatives(device: Device) -> None:
    """A cubic of three coordinates, in the middle of a grid so long that its ends do not matter."""
    axes = (np.linspace(-1, 1, 61), np.linspace(2, 0, 61), np.linspace(-0.5, 0.5, 61))
    z, y, x = np.meshgrid(*axes, indexing="ij")
    points = np.random.default_rng(0).uniform([-0.3, 0.7, -0.2], [0.3, 1.3, 0.2], (50, 3))
    a, b, c = points.T
    with Interpolator(axes, z**3 * y - 2 * x**2 * z + y, device=device) as at:
        for nu, wanted in (
            ((0, 0, 0), a**3 * b - 2 * c**2 * a + b),
            ((1, 0, 0), 3 * a**2 * b - 2 * c**2),
            ((0, 1, 0), a**3 + 1),
            ((0, 0, 1), -4 * c * a),
            ((2, 0, 0), 6 * a * b),
            ((1, 1, 0), 3 * a**2),
            ((1, 0, 1), -4 * c),
            ((0, 0, 2), -4 * a),
        ):
            np.testing.assert_allclose(at(points, nu=nu), wanted, atol=1e-12 * 60 ** sum(nu))


def test_complex_values_are_processed_by_parts(device: Device) -> None:
    axes, points = grid_and_points(2)
    random = np.random.default_rng(0)
    values = random.normal(size=(9, 8, 2)) + 1j * random.normal(size=(9, 8, 2))
    with (
        Interpolator(axes, values, device=device) as at,
        Interpolator(axes, values.real, device=device) as real,
        Interpolator(axes, values.imag, device=device) as imaginary,
    ):
        assert at(points).dtype.kind == "c"
        np.testing.assert_array_equal(at(points), real(points) + 1j * imaginary(points))
        np.testing.assert_array_equal(at(points, nu=(1, 0)), real(points, nu=(1, 0)) + 1j * imaginary(points, nu=(1, 0)))
        wanted = RegularGridInterpolator(axes, values)(points)
    np.testing.assert_allclose(Interpolator(axes, values, "slinear", device=device)(points), wanted, atol=1e-13)


def test_points_outside_are_rejected_filled_or_extrapolated(device: Device) -> None:
    x, values = np.linspace(0, 4, 5), np.array([1.0, 2.0, 4.0, 3.0, 0.0])
    points = np.array([-0.25, 0.0, 4.0, 4.5, np.nan, np.inf])
    with pytest.raises(OptionError, match=r"axis 0 from 0\.0 to 4\.0; got -0\.25"):
        Interpolator((x,), values, device=device)(points)
    with pytest.raises(ValueError, match="within the grid"):
        Interpolator((x,), values, device=device)([np.nan])  # as SciPy does
    for fill in (np.nan, -7.0):
        with np.errstate(invalid="ignore"):
            wanted = RegularGridInterpolator((x,), values, bounds_error=False, fill_value=fill)(points)
        got = Interpolator((x,), values, "linear", False, fill, device=device)(points)
        np.testing.assert_allclose(got, wanted, atol=1e-14)
    beyond = Interpolator((x,), values, "linear", False, None, boundary="mirror", device=device)(points[:5])
    np.testing.assert_allclose(beyond, [1.25, 1.0, 0.0, 1.5, np.nan], atol=1e-14)


@pytest.mark.one_in(6)
@pytest.mark.parametrize("boundary", ["mirror", "reflect", "wrap", "zero"])
@pytest.mark.parametrize("filter", ["nearest", "linear", "bspline3", "bspline5", "lanczos3"])
def test_a_single_axis_goes_through_its_values(filter: str, boundary: str, device: Device) -> None:
    values = np.array([3, -1, 4, 1, -5, 9])
    with Interpolator(([10, 8, 6, 4, 2, 0],), values, filter, boundary=boundary, device=device) as at:
        np.testing.assert_allclose(at([10, 8, 6, 4, 2, 0]), values, atol=1e-9)


def test_without_a_prefilter_a_single_axis_is_the_sum_of_kernels(device: Device) -> None:
    values, x = np.array([3.0, -1, 4, 1]), np.linspace(0, 3, 7)
    wanted = clvol.bspline(3)(x[:, None] - np.arange(4)) @ values
    with Interpolator((np.arange(4),), values, "bspline3-approx", boundary="zero", device=device) as at:
        np.testing.assert_allclose(at(x), wanted, atol=1e-14)


def test_unusual_valid_input(device: Device) -> None:
    values = np.arange(12, dtype=">i2").reshape(3, 4)
    values.flags.writeable = False
    with Interpolator(([0, 1, 2], [0, 1, 2, 3]), values, "linear", device=device) as at:
        np.testing.assert_allclose(at([[1.5, 2.5]]), [8.5], atol=1e-12)
    single = np.linspace(0, 1, 11, dtype=np.float32)  # whose steps differ by their rounding
    assert Interpolator((single + np.float32(100),), np.ones(11), device=device)([100.5])[0] == pytest.approx(1)
    with Interpolator(([5.0], [0, 1]), [[2.0, 4.0]], "linear", device=device) as at:  # an axis of one sample
        np.testing.assert_allclose(at([5.0, 0.25]), [2.5], atol=1e-12)
    assert Interpolator(([0, 1],), [1.0, 2.0], device=device)(np.empty((0, 1))).shape == (0,)


def test_memory_is_freed(device: Device) -> None:
    with Interpolator((np.arange(4), np.arange(5)), np.ones((4, 5, 2)), device=device) as at:
        assert at.nbytes > 0
        assert "4 × 5" in repr(at)
    assert at.closed
    assert at.nbytes == 0
    with pytest.raises(OptionError, match="released"):
        at([1.0, 1.0])


def test_progress_is_reported(device: Device) -> None:
    told: list[float] = []
    Interpolator((np.arange(4),), np.ones((4, 3)), device=device)([1.0], progress=told.append)
    assert told == pytest.approx([1 / 3, 2 / 3, 1])


GRID = (np.arange(4.0), np.arange(5.0))
REFUSED: list[tuple[type[ClvolError], str, tuple[Any, ...]]] = [
    (GeometryError, "evenly spaced; got 3.0 at index 2", (([0, 1, 3, 4], GRID[1]), np.ones((4, 5)))),
    (GeometryError, "rise or fall strictly", (([0, 1, 1, 2], GRID[1]), np.ones((4, 5)))),
    (GeometryError, "axis 1 must be finite; got nan at index 2", ((GRID[0], [0, 1, np.nan, 3, 4]), np.ones((4, 5)))),
    (GeometryError, "axis 0 must be a non-empty array of one axis", ((np.ones((2, 2)), GRID[1]), np.ones((4, 5)))),
    (GeometryError, "axis 0 must be an array of coordinates", ((["a", "b"], GRID[1]), np.ones((2, 5)))),
    (OptionError, "1 to 3 arrays", ((GRID[0],) * 4, np.ones((4, 4, 4, 4)))),
    (DataError, r"begins with \(4, 5\)", (GRID, np.ones((5, 4)))),
    (DataError, "real or complex", (GRID, np.full((4, 5), "a"))),
    (DataError, r"first at index \[1, 2\]", (GRID, np.where(np.arange(20).reshape(4, 5) == 7, np.nan, 1.0))),
    (OptionError, "filter must be one of", (GRID, np.ones((4, 5)), "pchip")),
    (OptionError, "fill_value", (GRID, np.ones((4, 5)), "linear", False, "x")),
    (OptionError, "fill_value", (GRID, np.ones((4, 5)), "linear", False, 1j)),
]


@pytest.mark.parametrize(("error", "rule", "arguments"), REFUSED, ids=[rule for _, rule, _ in REFUSED])
def test_bad_grids_are_rejected(error: type[ClvolError], rule: str, arguments: tuple[Any, ...], device: Device) -> None:
    with pytest.raises(error, match=rule):
        Interpolator(*arguments, device=device)


@pytest.mark.parametrize("nu", [(1,), (1, 1, 0), (3, 0), (2, 1), (-1, 0), (0.5, 0), "1", (True, 0)])
def test_bad_derivatives_are_rejected(nu: Any, device: Device) -> None:
    with Interpolator(GRID, np.ones((4, 5)), device=device) as at, pytest.raises(OptionError, match="nu"):
        at([1.0, 1.0], nu=nu)


def test_a_filter_without_slopes_has_none(device: Device) -> None:
    for name, nu in (("nearest", (1, 0)), ("linear", (2, 0))):
        with Interpolator(GRID, np.ones((4, 5)), name, device=device) as at, pytest.raises(OptionError, match="degree"):
            at([1.0, 1.0], nu=nu)
    with Interpolator(GRID, np.ones((4, 5)), "linear", device=device) as at:
        assert at([1.5, 1.5], nu=(1, 1))[0] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("xi", [1.0, [1.0], [[1.0, 2.0, 3.0]], "a", (np.ones(2), np.ones(3)), [[1j, 0]]])
def test_bad_points_are_rejected(xi: Any, device: Device) -> None:
    with Interpolator(GRID, np.ones((4, 5)), device=device) as at, pytest.raises(OptionError, match="xi"):
        at(xi)


def test_values_that_are_not_a_numeric_array() -> None:
    for wrong in ([[1], [2, 3], 4], np.ma.masked_greater([3.0, 1.0, 2.0], 2)):
        with pytest.raises(DataError, match="values must be an array of numbers"):
            clvol.Interpolator(([0, 1, 2],), wrong)


def test_one_derivative_is_a_number_of_any_integer_type(device: Device) -> None:
    with clvol.Interpolator(([0, 1, 2, 3],), [0.0, 2, 4, 6], "linear", device=device) as line:
        np.testing.assert_allclose(line([1.5], nu=np.int64(1)), 2)
