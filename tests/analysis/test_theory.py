"""Orders, error constants, Fourier error kernel and Taylor coefficients, against closed forms and brute force."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import optimize, special

from clvol import reference
from clvol.analysis import approximation, error_kernel, frequency_response, impulse_response, taylor_coefficients
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import bspline, from_callable, from_pieces, moms3, quasi
from clvol.filter.table import as_filter, filters
from tests.cases import BAD_COUNTS, BAD_FILTERS, BAD_REALS, BAD_WHOLE, SMOOTHED, every

NAMES = (*filters(), *SMOOTHED)


def zeta_constant(degree: int) -> float:
    """Of interpolating B-splines (Blu and Unser 1999): ``((sum)² + sum of squares) of 1/(2 pi k)**L`` over k != 0."""
    order = degree + 1
    cross = 2 * special.zeta(order) if order % 2 == 0 else 0.0
    return math.sqrt(cross**2 + 2 * special.zeta(2 * order)) / (2 * math.pi) ** order


@pytest.mark.parametrize("degree", range(1, 10))
def test_constants_of_interpolating_splines(degree: int) -> None:
    got = approximation(bspline(degree))
    assert (got.order, got.derivative) == (degree + 1, 0)
    assert got.constant == pytest.approx(zeta_constant(degree), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "derivative", "order", "constant"),
    [
        ("nearest", 0, 1, math.sqrt(1 / 12)),  # the mean square of t within ±1/2
        ("linear", 0, 2, math.sqrt(1 / 120)),  # of t (1 - t) / 2
        ("bspline3-approx", 0, 2, 1 / 6),  # half the variance of the kernel, 1/3
        ("bspline5-approx", 0, 2, 1 / 4),
        ("mitchell", 0, 2, 1 / 18),  # B / 6
        ("bspline3-approx", 1, 2, 1 / 6),
        ("nearest", 1, 0, 1),  # no slope at all
        ("linear", 1, 1, math.sqrt(1 / 12)),
        ("catmull-rom", 1, 2, math.sqrt(1 / 180)),
    ],
)
def test_constants_by_hand(name: str, derivative: int, order: int, constant: float) -> None:
    got = approximation(name, derivative)
    assert (got.filter, got.order) == (name, order)
    assert got.constant == pytest.approx(constant, rel=1e-14)


def spread(name: str | Filter, order: int) -> float:
    """The asymptotic constant of least squares: that of interpolation without its mean over t."""
    nodes, lengths = np.polynomial.legendre.leggauss(24)
    halves = [(nodes + 1) / 4, (nodes + 3) / 4]  # where taps change at t = 1/2, too
    a = np.stack([taylor_coefficients(name, t, order + 1)[order] for t in halves])
    mean = (a @ lengths).mean() / 2
    return math.sqrt(((a - mean) ** 2 @ lengths).mean() / 2)


@pytest.mark.parametrize("degree", range(9))
def test_least_squares_constants_of_splines_are_the_published_ones(degree: int) -> None:
    """Blu and Unser (1999): ``sqrt(|B_2L| / (2L)!)`` with Bernoulli's numbers; linear's is ``1 / (12 sqrt 5)``."""
    order = degree + 1
    wanted = math.sqrt(abs(special.bernoulli(2 * order)[-1]) / math.factorial(2 * order))
    assert spread(bspline(degree), order) == pytest.approx(wanted, rel=1e-7)


def test_constants_of_cubics_of_maximal_order_are_the_published_ones() -> None:
    """Blu, Thévenaz and Unser (2001): the least of least squares is ``L! / ((2L)! sqrt(2L + 1))``, that of O-MOMS."""
    least = math.factorial(4) / (math.factorial(8) * 3)
    assert spread("omoms3", 4) == pytest.approx(least, rel=1e-7)
    assert all(spread(moms3(w), 4) > 1.001 * least for w in (0.02, 1 / 56, 0.027, 0.04))
    assert spread("bspline3", 4) / least == pytest.approx(math.sqrt(21), rel=1e-7)


def test_the_least_error_of_interpolation_is_that_of_moms3() -> None:
    """From the spectrum alone: near 2 pi k the kernel with weight w is ``(1 - w (2 pi k)²) (omega / 2 pi k)⁴``."""
    k = 2 * np.pi * np.arange(1, 20_001)

    def constant(w: float) -> float:
        images = (1 - w * k**2) / k**4
        return math.sqrt(4 * images.sum() ** 2 + 2 * (images**2).sum())

    for w in (-1 / 6, 0, 0.01, 1 / 60, 1 / 56, 1 / 42, 0.05):
        assert approximation(moms3(w)).constant == pytest.approx(constant(w), rel=1e-3)
    best = optimize.minimize_scalar(constant, bounds=(0, 0.05), options={"xatol": 1e-9})
    assert best.x == pytest.approx(1 / 56, rel=1e-3)
    assert approximation("moms3").constant == pytest.approx(best.fun, rel=1e-3)
    assert approximation("moms3").constant == pytest.approx(3.14e-4, abs=5e-7)
    assert approximation("omoms3").constant / approximation("moms3").constant == pytest.approx(2, rel=1e-3)


@pytest.mark.parametrize("smoothing", [1e-3, 0.1, 2.0])
def test_smoothing_adds_its_own_mean_error(smoothing: float) -> None:
    """Cubic: λ times the fourth derivative, in addition to the 1/720 of interpolation; the gradient's order is unchanged."""
    row = bspline(3, smoothing=smoothing)
    wanted = math.sqrt((1 / 720 + smoothing) ** 2 + 1 / 1_209_600)
    assert (approximation(row).order, approximation(row).constant) == (4, pytest.approx(wanted, rel=1e-12))
    assert approximation(row, 1).constant == approximation("bspline3", 1).constant


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_quasi_interpolation_reaches_the_constant_of_least_squares(degree: int) -> None:
    order = degree + 1
    wanted = math.sqrt(abs(special.bernoulli(2 * order)[-1]) / math.factorial(2 * order))
    got = approximation(quasi(degree))
    assert (got.order, got.constant) == (order, pytest.approx(wanted, rel=1e-9))


@pytest.mark.parametrize("name", ["bspline3(auto)", "bspline3(length=1)", "bspline3(0.1, 0.2)"])
def test_smoothing_that_is_not_a_single_number_is_rejected(name: str) -> None:
    for call in (approximation, lambda n: error_kernel(n, 1.0), lambda n: taylor_coefficients(n, 0.5)):
        with pytest.raises(OptionError, match=r"decided for a volume|filter\.along\(axis\)"):
            call(name)


@pytest.mark.parametrize("name", NAMES)
def test_order_is_the_filters_order(name: str) -> None:
    assert approximation(name).order == as_filter(name).order


@pytest.mark.parametrize("name", ["bspline2", "bspline3", "bspline4", "bspline5"])
def test_the_gradient_of_an_interpolating_spline_has_the_constant_of_the_spline_below(name: str) -> None:
    """For odd degrees exactly: its leading term is that spline's Bernoulli polynomial."""
    degree = int(name[-1])
    got = approximation(name, 1)
    assert got.order == degree
    if degree % 2:
        assert got.constant == pytest.approx(zeta_constant(degree - 1), rel=1e-12)


@pytest.mark.parametrize("name", ["sinc", "lanczos3"])
def test_weights_that_do_not_sum_to_one_leave_a_constant_error(name: str) -> None:
    miss = as_filter(name).weights((np.arange(20_000) + 0.5) / 20_000).sum(0) - 1
    assert approximation(name).order == 0
    assert approximation(name).constant == pytest.approx(np.sqrt(np.mean(miss**2)), rel=1e-6)
    assert approximation(name, 1).order == -1


@pytest.mark.parametrize("name", [*NAMES, "bc(0.2,0.4)"])
def test_error_kernel_is_the_sum_over_aliases(name: str) -> None:
    omega = np.array([0.0, 0.3, 1.0, 2.5, np.pi, 4.0, -1.0, 9.0])
    images = 2 * np.pi * np.concatenate([np.arange(-12, 0), np.arange(1, 13)])
    wanted = (1 - frequency_response(name, omega)) ** 2 + (frequency_response(name, omega[:, None] + images) ** 2).sum(-1)
    # the remainder beyond the summed aliases falls like 1/omega² if a kernel jumps, else faster
    tolerance = 2e-2 if as_filter(name).continuity < 0 else 1e-5
    np.testing.assert_allclose(error_kernel(name, omega), wanted, rtol=0, atol=tolerance)
    assert error_kernel(name, 1.0).shape == ()
    assert error_kernel(name, [[1.0, 2.0]]).shape == (1, 2)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("name", [n for n in NAMES if as_filter(n).order])
def test_error_kernel_near_0_is_the_leading_term(name: str, derivative: int) -> None:
    leading = approximation(name, derivative)
    got = error_kernel(name, 0.05, derivative) / 0.05 ** (2 * derivative)
    assert got == pytest.approx(leading.constant**2 * 0.05 ** (2 * leading.order), rel=0.01)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize(
    "name", ["nearest", "linear", "mitchell", "bspline2", "bspline3", "omoms3", "sinc", "sinc4n", "hybrid", *SMOOTHED]
)
def test_error_kernel_is_the_measured_error_of_a_wave(name: str, derivative: int) -> None:
    n, turns = 40, 7
    omega = 2 * np.pi * turns / n
    x = (np.arange(n * 200) + 0.5) / 200
    points = np.stack([x, np.zeros_like(x)], -1)
    got = reference.sample(np.cos(omega * np.arange(n))[None], points, name, "wrap", derivative)
    across = reference.sample([[1.0]], [[0.0, 0.0]], name, "wrap")  # the single row, where weights miss one
    got = (got[:, 0] if derivative else got) / across
    true = -omega * np.sin(omega * x) if derivative else np.cos(omega * x)
    assert np.mean((got - true) ** 2) == pytest.approx(error_kernel(name, omega, derivative) / 2, rel=1e-3)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("name", NAMES)
def test_taylor_coefficients_are_moments_of_the_impulse_response(name: str, derivative: int) -> None:
    t = np.array([0.013, 0.2, 0.4999, 0.51, 0.77])
    k = np.arange(-200, 202)
    response = impulse_response(name, t[:, None] - k, derivative)
    got = taylor_coefficients(name, t, 7, derivative)
    for n in range(7):
        wanted = ((k - t[:, None]) ** n * response).sum(-1) / math.factorial(n)
        np.testing.assert_allclose(got[n], wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_taylor_coefficients_below_the_order_are_exact(name: str) -> None:
    order = as_filter(name).order
    got = taylor_coefficients(name, np.linspace(0, 0.99, 34), order + 1)
    np.testing.assert_allclose(got[:order], np.eye(order, 1)[:, 0, None] * np.ones(34), atol=1e-13)
    assert np.abs(got[order] - (order == 0)).max() > 1e-5
    assert taylor_coefficients(name, 0.5).shape == (6,)


def test_filters_in_floating_point() -> None:
    row = from_pieces("mine", [(2 / 3, 0.0, -1.0, 0.5), (4 / 3, -2.0, 1.0, -1 / 6)], prefilter=True)
    for derivative in (0, 1):
        mine, theirs = approximation(row, derivative), approximation("bspline3", derivative)
        assert mine.order == theirs.order
        assert mine.constant == pytest.approx(theirs.constant, rel=1e-9)
    bump = from_callable("bump", lambda x: np.cos(np.pi * x / 4) ** 2 / 2, 2)
    assert approximation(bump).order == bump.order == 1


@pytest.mark.parametrize(
    "call",
    [
        lambda: approximation("linear", 2),
        lambda: error_kernel("linear", np.nan),
        lambda: error_kernel("linear", 2001),
        lambda: error_kernel("linear", 1.0, 2),
        lambda: taylor_coefficients("linear", 1.0),
        lambda: taylor_coefficients("linear", -0.1),
        lambda: taylor_coefficients("linear", np.nan),
        lambda: taylor_coefficients("linear", 0.5, 13),
        lambda: taylor_coefficients("linear", 0.5, 3, 2),
    ],
)
def test_bad_input_is_rejected(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(OptionError):
        call()


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        approximation=(approximation, BAD_FILTERS),
        error_kernel=(lambda v: error_kernel(v, 1.0), BAD_FILTERS),
        taylor=(lambda v: taylor_coefficients(v, 0.5), BAD_FILTERS),
        derivative=(lambda v: approximation("linear", v), BAD_WHOLE),
        omega=(lambda v: error_kernel("linear", v), BAD_REALS),
        terms=(lambda v: taylor_coefficients("linear", 0.5, v), BAD_COUNTS),
    ),
)
def test_bad_values_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(OptionError):
        call(bad)
