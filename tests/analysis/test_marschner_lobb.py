"""Marschner and Lobb's metrics against values derived by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from clvol.analysis import WILBRAHAM_GIBBS, Metrics, frequency_response, metrics
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import from_callable
from clvol.filter.table import filters
from tests.cases import BAD_FILTERS


def ideal(omega: np.ndarray) -> np.ndarray:
    return (np.abs(omega) <= np.pi) * 1.0


def kept(name: str) -> float:
    """The fraction of |H|² within the Nyquist region, by another quadrature."""
    return float(integrate.quad(lambda w: float(frequency_response(name, w)) ** 2, 0, np.pi, epsabs=1e-12)[0]) / np.pi


def test_the_ideal_filter_neither_smooths_nor_aliases_and_overshoots_as_gibbs_says() -> None:
    got = metrics(ideal)
    assert (got.smoothing, got.postaliasing, got.smoothing_3d, got.postaliasing_3d) == pytest.approx((0, 0, 0, 0), abs=1e-14)
    assert got.overshoot == pytest.approx(WILBRAHAM_GIBBS, abs=1e-9)
    assert got.filter == "ideal"


def test_wider_sincs_approach_the_ideal() -> None:
    short, long = metrics("sinc(2)"), metrics("sinc(8)")
    assert abs(long.smoothing) < abs(short.smoothing) / 3
    assert long.postaliasing < short.postaliasing / 3


@pytest.mark.parametrize(("name", "energy"), [("nearest", 1), ("linear", 2 / 3), ("bspline3-approx", 151 / 315)])
def test_postaliasing_by_parseval(name: str, energy: float) -> None:
    """The integral of |H|² over all frequencies is 2 pi times the energy of the kernel, known in fractions."""
    got, inside = metrics(name), kept(name)
    assert got.smoothing == pytest.approx(1 - inside, abs=1e-12)
    assert got.postaliasing == pytest.approx(energy - inside, abs=1e-12)
    assert got.smoothing_3d == pytest.approx(1 - inside**3, abs=1e-12)
    assert got.postaliasing_3d == pytest.approx(energy**3 - inside**3, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "overshoot"),
    [
        ("nearest", 0),
        ("linear", 0),
        ("bspline3-approx", 0),
        ("catmull-rom", 1 / 24),  # the integral of (x - 1) (x - 2)² / 2 over [1, 2]
        ("bspline3", (2 - math.sqrt(3)) / 4),  # what is left of the cardinal spline beyond 1: its pole is √3 - 2
    ],
)
def test_overshoot_by_hand(name: str, overshoot: float) -> None:
    assert metrics(name).overshoot == pytest.approx(overshoot, abs=1e-12)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", ["bspline3", "bspline5", "mitchell", "hybrid"])
def test_a_filter_and_its_response_give_the_same(name: str) -> None:
    row, response = metrics(name), metrics(lambda w: frequency_response(name, w))
    for field in ("smoothing", "postaliasing", "overshoot", "smoothing_3d", "postaliasing_3d"):
        assert getattr(row, field) == pytest.approx(getattr(response, field), abs=3e-6)


@pytest.mark.parametrize("name", filters())
def test_every_filter_has_finite_metrics(name: str) -> None:
    got = metrics(name)
    assert all(math.isfinite(v) for k, v in vars(got).items() if k != "filter")
    assert got.postaliasing > 0
    assert 0 <= got.overshoot < 0.13


def test_a_filter_without_a_closed_form() -> None:
    bump = from_callable("bump", lambda x: np.cos(np.pi * x / 4) ** 2 / 2, 2)
    assert isinstance(metrics(bump), Metrics)
    assert metrics(bump).overshoot == pytest.approx(0, abs=1e-9)  # never negative, integral 1


@pytest.mark.parametrize(
    "bad",
    [
        *BAD_FILTERS,
        lambda w: w[:3],
        lambda _: "text",
        lambda w: w * np.nan,
        lambda _: 1 / 0,
        Filter("skew", ((0.0, 1.0), (1.0, -0.5))),
    ],
)
def test_bad_input_is_rejected(bad: object) -> None:
    with pytest.raises(OptionError):
        metrics(bad)  # type: ignore[arg-type]
