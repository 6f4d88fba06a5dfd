"""Smoothing splines compared with SciPy's, with the functional that they minimise, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, interpolate, signal

import clvol
from clvol import Volume, reference
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import bspline, from_pieces
from clvol.filter.table import as_filter
from clvol.volume.smoothing import settled


def noisy(n: int, seed: int = 0) -> np.ndarray:
    x = np.arange(n)
    return np.asarray(np.sin(x / 9) + 0.3 * np.random.default_rng(seed).normal(size=n))


@pytest.mark.parametrize("smoothing", [1e-3, 0.1, 1.0, 20.0])
def test_the_cubic_matches_scipys_smoothing_spline_far_from_the_ends(device: clvol.Device, smoothing: float) -> None:
    """SciPy's has natural ends, clvol's the boundary rule; their influence decays within the reach of the poles."""
    data = noisy(400)
    theirs = interpolate.make_smoothing_spline(np.arange(400), data, lam=smoothing)
    x = np.linspace(150, 250, 777)
    points = np.stack([x, np.zeros_like(x)], -1)
    # a single row: along y the prefilter divides by the sum of its samples, 1
    ours = clvol.sample(data[None], points, bspline(3, smoothing=smoothing), device=device)
    np.testing.assert_allclose(ours, theirs(x), atol=3e-6)
    slopes = clvol.sample(data[None], points, bspline(3, smoothing=smoothing), derivative=1, device=device)
    np.testing.assert_allclose(slopes[:, 0], theirs(x, 1), atol=1e-5)


@pytest.mark.parametrize(("degree", "m"), [(3, 2), (5, 3)])
def test_odd_degrees_minimise_distance_plus_bending(degree: int, m: int) -> None:
    """Σ (f - s)² + λ ∫ (s⁽ᵐ⁾)² over a period: other coefficients increase it, and its gradient is zero."""
    n, smoothing = 16, 0.37
    data = noisy(n)
    b = interpolate.BSpline.basis_element(np.arange(degree + 2) - (degree + 1) / 2, extrapolate=False)

    def periodic(coefficients: np.ndarray, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        shifts = np.arange(-n, 2 * n)
        kernel = np.nan_to_num(b.derivative(derivative)(x[:, None] - shifts) if derivative else b(x[:, None] - shifts))
        return np.asarray(kernel @ coefficients[shifts % n])

    nodes, lengths = np.polynomial.legendre.leggauss(8)
    x = (np.arange(2 * n)[:, None] / 2 + (nodes + 1) / 4).ravel()  # no piece of an even or odd spline is cut
    weights = np.tile(lengths / 4, 2 * n)

    def energy(coefficients: np.ndarray) -> float:
        misses = data - periodic(coefficients, np.arange(n))
        return float((misses**2).sum() + smoothing * (weights * periodic(coefficients, x, m) ** 2).sum())

    found = reference.prefilter(data, bspline(degree, smoothing=smoothing), "wrap")
    least = energy(found)
    rng = np.random.default_rng(1)
    for _ in range(20):
        step = rng.normal(size=n)
        ahead, behind = energy(found + 1e-4 * step), energy(found - 1e-4 * step)
        assert ahead > least
        assert behind > least
        assert abs(ahead - behind) < 1e-9  # twice the slope


def test_signal_cspline_agrees() -> None:
    """scipy.signal.cspline1d implements smoothing cubics: its coefficients (mirror), for λ with complex poles."""
    data = noisy(120)
    for smoothing in (0.1, 1.0, 5.0):
        theirs = signal.cspline1d(data, smoothing)
        ours = reference.prefilter(data, bspline(3, smoothing=smoothing), "mirror")
        np.testing.assert_allclose(ours[30:-30], theirs[30:-30], atol=1e-6)


def test_no_smoothing_is_interpolation() -> None:
    for name in ("bspline3(0)", "bspline3(0,0,0)", "bspline3( 0.0 )"):
        assert as_filter(name) is as_filter("bspline3") or as_filter(name) == as_filter("bspline3")
    assert bspline(3, smoothing=0) == bspline(3)
    assert not bspline(3, smoothing=1e-3).interpolates
    assert as_filter("bspline3(1e-7)").order == 4


@pytest.mark.parametrize("name", ["bspline2(0.3)", "bspline3(0.1)", "bspline4(7)", "bspline5(1)"])
def test_polynomials_below_twice_the_penalty_are_preserved(name: str) -> None:
    """Their m-th differences, taken twice, vanish."""
    row, x = as_filter(name), np.arange(200.0)
    at = np.linspace(90, 110, 41)
    for degree in range(min(row.degree, 2 * row.penalty - 1) + 1):
        data = ((x - 100) / 10) ** degree
        got = reference.sample(Volume(data[None]), np.stack([at, 0 * at], -1), row)
        np.testing.assert_allclose(got, ((at - 100) / 10) ** degree, atol=1e-9)


def test_noise_falls_by_the_variance_gain_of_the_response(device: clvol.Device) -> None:
    """The mean variance of the function is that of the samples times the cube of the integral of |H|² over all frequencies."""
    data = np.random.default_rng(0).normal(size=(64, 64, 64)).astype(np.float32)
    points = np.random.default_rng(1).uniform(8, 55, (200_000, 3))
    for name in ("bspline3", "bspline3(0.1)", "bspline3(2)"):
        omega = np.linspace(0, 40 * np.pi, 40_001)
        gain = integrate.simpson(clvol.frequency_response(name, omega) ** 2, x=omega) / np.pi
        got = clvol.sample(data, points, name, device=device).var()
        assert got == pytest.approx(gain**3, rel=0.03)


def test_smoothing_along_one_axis_keeps_the_others() -> None:
    data = np.random.default_rng(2).normal(size=(9, 10, 11))
    volume = Volume(data)
    nodes = np.stack(np.meshgrid(*map(np.arange, (9, 10, 11)), indexing="ij")[::-1], -1).astype(float)
    for axis in range(3):
        values = [0.0, 0.0, 0.0]
        values[axis] = 0.7
        both = clvol.sample(volume, nodes, bspline(3, smoothing=values))
        alone = reference.prefilter(data, "bspline3(0.7)")  # of all axes; take the lines of one
        lines = np.moveaxis(data, 2 - axis, -1)
        one = np.stack([reference.prefilter(line, "bspline3(0.7)") for line in lines.reshape(-1, lines.shape[-1])])
        padded = np.pad(one, ((0, 0), (1, 1)), mode="reflect")
        values_there = (padded[:, :-2] + 4 * padded[:, 1:-1] + padded[:, 2:]) / 6
        np.testing.assert_allclose(both, np.moveaxis(values_there.reshape(lines.shape), -1, 2 - axis), atol=5e-6)
        assert np.abs(alone).max() > 0


def test_lengths_are_in_world_units() -> None:
    volume = Volume(np.zeros((4, 5, 6)), (0.5, 1.0, 2.0))
    row = settled("bspline3(length=1)", volume)
    assert row.smoothing == (16.0, 1.0, 0.0625)
    assert row.name == "bspline3(16,1,0.0625)"
    assert as_filter(row.name) == row
    assert clvol.Field(volume, "bspline3(length=1)").filter == row
    # half of a wave of wavelength 2πℓ is left, at any spacing that resolves it
    for spacing in (0.25, 0.5):
        name = settled("bspline3(length=1)", Volume(np.zeros((4, 4)), (spacing, spacing))).name
        assert float(clvol.frequency_response(name, spacing)) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: bspline(3, smoothing=-0.1), "at least 0"),
        (lambda: bspline(3, smoothing="much"), "auto"),
        (lambda: bspline(3, smoothing=(1, 2, 3, 4)), "2 or 3 axes"),
        (lambda: bspline(3, smoothing=float("nan")), "finite"),
        (lambda: bspline(3, smoothing=1e9), "at most 100000"),
        (lambda: bspline(3, smoothing=0.1, length=1), "not both"),
        (lambda: bspline(1, smoothing=0.1), "prefilter"),
        (lambda: bspline(3, prefilter=False, smoothing=0.1), "prefilter"),
        (lambda: as_filter("bspline3()"), "wrong parameters"),
        (lambda: as_filter("bspline3(1;2)"), "wrong parameters"),
        (lambda: as_filter("bspline3(length=-1)"), "wrong parameters"),
        (lambda: clvol.frequency_response("bspline3(auto)", 1.0), "decided for a volume"),
        (lambda: clvol.frequency_response("bspline3(0.1,0.2)", 1.0), "along"),
        (lambda: reference.prefilter(np.ones(4), "bspline3(length=2)"), "decided for a volume"),
        (lambda: clvol.sample(np.ones((3, 3)), [[0, 0]], "bspline3(1,2,3)"), "2 for a volume of 2 axes"),
        (lambda: clvol.Field(Volume(np.ones((3, 3)), (1e-3, 1)), "bspline3(length=1)"), "must be at most 0.01778 .* λ is 100000"),
    ],
)
def test_invalid_smoothing_is_rejected(call: object, says: str) -> None:
    assert callable(call)
    with pytest.raises(OptionError, match=says):
        call()


def test_names_reproduce_the_filter() -> None:
    for row in (
        bspline(3, smoothing=1 / 3),
        bspline(2, smoothing=(0.1, 0.2)),
        bspline(5, smoothing="auto"),
        bspline(4, length=0.25),
    ):
        assert as_filter(row.name) == row
    assert as_filter("cubic(0.1)") == as_filter("BSpline3( 1/10 )") == bspline(3, smoothing=0.1)


def test_other_filters_with_a_prefilter_can_smooth(device: clvol.Device) -> None:
    row = Filter("mine", bspline(3).taps, prefilter=True, smoothing=0.1)
    data = np.random.default_rng(4).normal(size=(7, 9))
    np.testing.assert_array_equal(clvol.prefilter(data, row, device=device), clvol.prefilter(data, "bspline3(0.1)", device=device))


def test_a_scaled_kernel_is_divided(device: clvol.Device) -> None:
    """A prefilter without poles: twice the triangle interpolates half the samples."""
    row = from_pieces("high", [(2, -2)], prefilter=True)
    data = np.random.default_rng(5).normal(size=(5, 6)).astype(np.float32)
    nodes = np.stack(np.meshgrid(np.arange(5), np.arange(6), indexing="ij")[::-1], -1).astype(float)
    np.testing.assert_allclose(clvol.sample(data, nodes, row, device=device), data, atol=1e-6)
