"""Reduction: compared with the definition of least squares and known results."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import make_interp_spline

import clvol
from clvol import DataError, DeviceError, OptionError, Volume, reference
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filter
from clvol.spline.reduce import Sums, gaussian, least_squares, sum_along

Array = NDArray[np.float64]
FILTERS = (
    "nearest",
    "linear",
    "bspline2",
    "bspline3",
    "bspline4",
    "bspline5",
    "bspline3-approx",
    "bspline3(0.1)",
    "mitchell",
    "omoms3",
)
GRIDS = ((17, 8, 0.3, 2.0), (23, 7, 1.2, 3.37), (9, 5, 7.9, -1.7), (4, 1, 1.5, 4.0), (1, 1, 0.0, 1.5))  # samples, of them, from, by
ALLOWED = {"bspline4": 1e-9, "bspline5": 1e-7, "omoms3": 1e-10}  # the margin of the reference, whose influence falls slowest there


def matrix(filter: str, boundary: str, n: int, m: int, start: float, step: float, kind: type[np.generic] = np.float64) -> Array:
    return least_squares(as_filter(filter), start, step, m, n, as_boundary(boundary), kind == np.float64).matrix()[:, :n]


# -- the weights -------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(11)
@pytest.mark.parametrize("boundary", ["mirror", "reflect", "wrap"])
@pytest.mark.parametrize("filter", FILTERS)
def test_the_result_is_the_least_squares_solution(filter: str, boundary: str) -> None:
    random = np.random.default_rng(5)
    for n, m, start, step in GRIDS:
        samples = random.normal(size=n)
        wanted = reference.nearest_spline(samples, [(start, step, m)], filter, boundary)
        np.testing.assert_allclose(matrix(filter, boundary, n, m, start, step) @ samples, wanted, atol=ALLOWED.get(filter, 1e-12))


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_the_residual_is_orthogonal_to_the_coarse_space(degree: int) -> None:
    """Pythagoras: on a closed curve, with SciPy's splines."""
    n, m = 30, 12
    samples = np.random.default_rng(degree).normal(size=n)
    few = matrix("linear" if degree == 1 else f"bspline{degree}", "wrap", n, m, 0.0, n / m) @ samples

    def periodic(values: Array, step: float) -> object:
        return make_interp_spline(step * np.arange(values.size + 1), np.append(values, values[0]), k=degree, bc_type="periodic")

    nodes, shares = legendre.leggauss(degree + 1)
    knots = np.union1d(np.arange(n + 1.0), n / m * np.arange(m + 1))
    lengths = np.diff(knots)[:, None]
    at, mass = (knots[:-1, None] + lengths * (nodes + 1) / 2).ravel(), (lengths * shares / 2).ravel()
    fine, coarse = periodic(samples, 1.0)(at), periodic(few, n / m)(at)  # type: ignore[operator]
    for j in range(m):
        basis = periodic(np.eye(m)[j], n / m)(at)  # type: ignore[operator]
        assert abs(mass @ ((fine - coarse) * basis)) < 1e-12
    assert mass @ fine**2 == pytest.approx(mass @ coarse**2 + mass @ (fine - coarse) ** 2, rel=1e-12)
    assert mass @ (fine - coarse) ** 2 > 0.1  # noise does not fit


@pytest.mark.parametrize(
    ("filter", "start"), [("nearest", 0.5), ("linear", 0.0), ("bspline2", 0.5), ("bspline3", 0.0), ("bspline5", 1.0)]
)
def test_a_spline_of_the_coarse_grid_is_reproduced(filter: str, start: float) -> None:
    """Its knots are knots of the fine grid, so the fine interpolating spline equals it."""
    m, n = 11, 22
    few = np.random.default_rng(2).normal(size=m)
    at = ((np.arange(n) - start) / 2 + 0.5) % m - 0.5
    samples = reference.lattice(few, [at], filter, "wrap")
    np.testing.assert_allclose(matrix(filter, "wrap", n, m, start, 2.0) @ samples, few, atol=1e-12)


@pytest.mark.parametrize(("filter", "degree"), [("nearest", 0), ("linear", 1), ("bspline2", 2), ("bspline3", 3), ("bspline5", 5)])
@pytest.mark.parametrize("step", [2.0, 2.7])
def test_polynomials_are_reproduced_far_from_the_ends(filter: str, degree: int, step: float) -> None:
    n, m = 1200, 5
    start = 0.5 * (n - 1) - 0.5 * step * (m - 1)
    x = (np.arange(n) - 0.5 * (n - 1)) / 100
    wanted = (start + step * np.arange(m) - 0.5 * (n - 1)) / 100
    got = matrix(filter, "mirror", n, m, start, step) @ x**degree
    np.testing.assert_allclose(got, wanted**degree, atol=1e-10)


def test_boxes_are_means_of_blocks() -> None:
    samples = np.random.default_rng(0).normal(size=24)
    np.testing.assert_allclose(matrix("nearest", "reflect", 24, 8, 1.0, 3.0) @ samples, samples.reshape(8, 3).mean(1), atol=1e-14)


def test_without_reduction_it_is_the_spline_itself() -> None:
    samples, at = np.random.default_rng(1).normal(size=13), np.linspace(0, 12, 29)
    for name in ("linear", "bspline3", "bspline5"):
        got = matrix(name, "reflect", 13, 29, 0.0, at[1]) @ samples
        np.testing.assert_allclose(got, reference.lattice(samples, [at], name, "reflect"), atol=1e-12)


def test_the_gaussian_matches_scipy() -> None:
    samples = np.random.default_rng(3).normal(size=9)
    for mode, boundary in {"mirror": "mirror", "reflect": "reflect", "wrap": "wrap", "nearest": "nearest"}.items():
        for sigma in (0.1, 0.5, 1.3, 7.0):
            got = gaussian(sigma, 9, as_boundary(boundary)).matrix()[:, :9] @ samples
            np.testing.assert_allclose(got, ndimage.gaussian_filter1d(samples, sigma, mode=mode), atol=1e-14)
    constant = gaussian(1.3, 9, as_boundary("grid-constant")).matrix() @ np.append(samples, 2.5)
    np.testing.assert_allclose(constant, ndimage.gaussian_filter1d(samples, 1.3, mode="constant", cval=2.5), atol=1e-14)


def test_single_precision_truncates_within_float32() -> None:
    """For any samples within ±1: the sum of the omitted weights of a row."""
    for name in ("linear", "bspline3", "bspline5"):
        short, long = (matrix(name, "reflect", 200, 71, 0.9, 2.8, kind) for kind in (np.float32, np.float64))
        assert np.abs(short - long).sum(1).max() < 2e-7


def test_filters_without_a_least_squares_spline_are_rejected() -> None:
    with pytest.raises(OptionError, match="hybrid"):
        matrix("hybrid", "mirror", 9, 4, 0.0, 2.0)


# -- adding up ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(
    "shape", [(1,), (5,), (200,), (3, 70), (70, 3), (1, 9, 1), (4, 33, 65), (5, 32, 31), (2, 3, 4, 5), (33, 1, 40, 1)]
)
def test_sums_equal_matrix_products(shape: tuple[int, ...], kind: type[np.generic], device: Device) -> None:
    if kind == np.float64 and not device.has_double:
        pytest.skip("no double precision")
    random = np.random.default_rng(sum(shape))
    for axis, n in enumerate(shape):
        data = random.normal(size=shape)
        m, taps = int(random.integers(1, 9)), int(random.integers(1, 7))
        sums = Sums(n, random.integers(0, n + 1, (m, taps)).astype(np.int32), random.normal(size=(m, taps)))
        got = sum_along(data, {axis: sums}, kind, device, outside=1.5)
        moved = np.concatenate([np.moveaxis(data, axis, 0), np.full((1, *np.delete(shape, axis)), 1.5)])
        wanted = np.moveaxis(np.tensordot(sums.matrix(), moved, 1), 0, axis)
        assert got.dtype == kind
        np.testing.assert_allclose(got, wanted, atol=1e-13 if kind == np.float64 else 1e-5)


@pytest.mark.parametrize("kind", ["?", "u1", ">i2", "<u4", ">f4", "<f8", "f2", "longdouble"])
def test_any_type_and_layout_is_summed(kind: str, device: Device) -> None:
    random = np.random.default_rng(0)
    data = np.asarray(random.integers(0, 2 if kind == "?" else 200, (7, 12, 10)), kind)
    sums = {axis: gaussian(1.1, data.shape[axis], as_boundary("reflect")) for axis in range(3)}
    wanted = ndimage.gaussian_filter(data.astype(np.float64), 1.1, mode="reflect")
    np.testing.assert_allclose(sum_along(data, sums, np.float32, device), wanted, atol=1e-4)
    turned = np.asfortranarray(data[::-1])
    turned.flags.writeable = False
    np.testing.assert_allclose(sum_along(turned, sums, np.float32, device), wanted[::-1], atol=1e-4)


def test_results_do_not_depend_on_launches(device: Device) -> None:
    data = np.random.default_rng(0).random((20, 40, 50), np.float32)
    sums = {axis: gaussian(0.8, n, as_boundary("wrap")) for axis, n in enumerate(data.shape)}
    whole = sum_along(data, sums, np.float32, device)
    told: list[float] = []
    with device.limited(launch_taps=1):
        np.testing.assert_array_equal(sum_along(data, sums, np.float32, device, progress=told.append), whole)
    assert told[-1] == 1
    assert told == sorted(told)


def test_double_precision_is_rejected_where_it_is_unsupported(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(device.__dict__, "has_double", False)
    with pytest.raises(DeviceError, match="double"):
        sum_along(np.zeros(3), {0: gaussian(1.0, 3, as_boundary("nearest"))}, np.float64, device)


# -- volumes -----------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kind", ["u1", ">i2", "f4", ">f8"])
@pytest.mark.parametrize("filter", ["linear", "bspline3"])
def test_a_volume_is_reduced_along_each_axis(filter: str, kind: str, device: Device) -> None:
    random = np.random.default_rng(8)
    data = random.integers(0, 100, (9, 12, 17)).astype(kind)
    data.flags.writeable = False
    volume = Volume(data, (0.5, 0.7, 2.0), (3.0, -2.0, 1.0), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]), "mm")
    shape = (9, 5, 6)
    got = clvol.resample(volume, shape, filter=filter, boundary="reflect", device=device, anti_aliasing="least-squares")
    grid = [((n / m - 1) / 2, n / m, m) if m < n else None for n, m in zip(volume.shape, shape, strict=True)]
    wanted = reference.nearest_spline(data, grid, filter, "reflect")
    assert got.data.dtype == np.float32
    np.testing.assert_allclose(got.data, wanted, atol=2e-4)
    same = clvol.resample(volume, shape, filter=filter, device=device)
    assert (got.spacing, got.origin, got.units) == (same.spacing, same.origin, "mm")
    np.testing.assert_array_equal(got.direction, same.direction)
    with clvol.Field(volume, filter, "reflect", device) as field:
        np.testing.assert_array_equal(field.resample(shape, anti_aliasing="least-squares").data, got.data)


def test_samples_far_from_zero_keep_their_digits(device: Device) -> None:
    data = 101_325 + np.random.default_rng(0).random((12, 14))
    got = clvol.resample(data, (5, 7), device=device, anti_aliasing="least-squares").data
    wanted = reference.nearest_spline(data, [(0.7, 2.4, 5), (0.5, 2.0, 7)])
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, wanted, atol=1e-9)


def test_the_gaussian_comes_first(device: Device) -> None:
    data = np.random.default_rng(0).random((20, 24, 30), np.float32)
    got = clvol.resample(data, (5, 12, 30), device=device, anti_aliasing=True).data
    soft = ndimage.gaussian_filter(data.astype(np.float64), (1.5, 0.5, 0), mode="mirror")
    wanted = reference.lattice(soft, [np.arange(5) * 4 + 1.5, np.arange(12) * 2 + 0.5, np.arange(30)])
    np.testing.assert_allclose(got, wanted, atol=3e-6)


def test_a_rotated_grid_supports_only_the_gaussian(device: Device) -> None:
    volume, angle = Volume(np.random.default_rng(0).random((24, 24), np.float32)), np.pi / 6
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    grid = Volume(np.zeros((6, 6)), (3.0, 3.0), tuple(volume.center - turn @ [7.5, 7.5]), turn)
    with pytest.raises(OptionError, match="turned"):
        clvol.resample(volume, like=grid, device=device, anti_aliasing="least-squares")
    soft = Volume(ndimage.gaussian_filter(volume.data, 1.0, mode="mirror"))
    got = clvol.resample(volume, like=grid, device=device, anti_aliasing="gaussian").data
    np.testing.assert_allclose(got, clvol.resample(soft, like=grid, device=device).data, atol=2e-6)


def test_grids_that_run_backwards_or_past_the_edge(device: Device) -> None:
    data = np.random.default_rng(4).random((16, 10), np.float32)
    grid = Volume(np.zeros((8, 5)), (2.0, 2.5), (8.0, -3.0), np.diag([-1.0, 1.0]))
    got = clvol.resample(data, like=grid, boundary="wrap", device=device, anti_aliasing="least-squares", fill=-7.0).data
    wanted = reference.nearest_spline(data, [(-3.0, 2.5, 8), (8.0, -2.0, 5)], "bspline3", "wrap")
    wanted[0] = -7  # y = -3; the others lie from -1/2 on
    np.testing.assert_allclose(got, wanted, atol=3e-6)


def test_invalid_reductions_are_rejected(device: Device) -> None:
    data = np.ones((8, 8), np.float32)
    for options, rule in (
        ({"anti_aliasing": "fourier"}, "anti_aliasing must be one of"),
        ({"anti_aliasing": 1}, "anti_aliasing must be one of"),
        ({"anti_aliasing": "least-squares", "boundary": "zero"}, "zero"),
        ({"anti_aliasing": "least-squares", "filter": "hybrid"}, "hybrid"),
    ):
        with pytest.raises(OptionError, match=rule):
            clvol.resample(data, (4, 4), device=device, **options)  # type: ignore[arg-type]
    data[2, 3] = np.nan
    for chosen in ("gaussian", "least-squares"):
        with pytest.raises(DataError, match=r"first at index \[2, 3\]"):
            clvol.resample(data, (4, 4), device=device, anti_aliasing=chosen)  # type: ignore[arg-type]
    field = clvol.Field(np.ones((4, 4)), device=device)
    field.close()
    with pytest.raises(OptionError, match="released"):
        field.resample((2, 2), anti_aliasing="least-squares")


def test_zero_is_allowed_for_filters_whose_coefficients_are_samples(device: Device) -> None:
    data = np.random.default_rng(0).random((9, 9))
    got = clvol.resample(data, (4, 4), filter="linear", boundary="zero", device=device, anti_aliasing="least-squares").data
    np.testing.assert_allclose(got, reference.nearest_spline(data, [(0.625, 2.25, 4)] * 2, "linear", "zero"), atol=1e-6)


def test_it_preserves_more_than_a_gaussian_and_aliases_less(device: Device) -> None:
    """Waves on a closed line of 96 samples, to 32 and back: representable waves must stay, others must vanish."""
    n, m = 96, 32
    x = np.arange(n)
    kept, let_through = {}, {}
    for chosen in ("gaussian", "least-squares"):
        for waves, told in ((8, kept), (28, let_through)):  # the coarse grid holds fewer than 16
            wave = np.tile(np.cos(2 * np.pi * waves * x / n), (n, 1)).astype(np.float32)
            few = clvol.resample(wave, (n, m), boundary="wrap", device=device, anti_aliasing=chosen)  # type: ignore[arg-type]
            told[chosen] = float(np.sqrt(2) * few.data[0].std())
    assert kept["least-squares"] > 0.97 > kept["gaussian"] + 0.05
    assert let_through["least-squares"] < let_through["gaussian"] / 2
