"""Eqs (14) to (18) from the filter table, against their closed forms and direct sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import reference
from clvol.base.errors import OptionError
from clvol.filter.make import bspline
from clvol.filter.response import frequency_response, prefilter_response
from clvol.filter.table import as_filter, filters
from clvol.volume.volume import Volume
from tests.cases import BAD_FILTERS, BAD_REALS, SMOOTHED

OMEGA = np.concatenate([np.linspace(-6 * np.pi, 6 * np.pi, 1201), [0.0, 1e-9, 40 * np.pi, 333.3]])


def sinc_of(omega: np.ndarray, power: int) -> np.ndarray:
    return np.sinc(omega / (2 * np.pi)) ** power


@pytest.mark.parametrize("degree", range(10))
def test_approximation_is_eq_15(degree: int) -> None:
    """Degree 0 is eq. (14)."""
    got = frequency_response(bspline(degree, prefilter=False), OMEGA)
    np.testing.assert_allclose(got, sinc_of(OMEGA, degree + 1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", range(2, 8))
def test_prefilter_is_eq_16(degree: int) -> None:
    b = reference.kernel(bspline(degree), np.arange(degree // 2 + 1))
    eq16 = 1 / (b[0] + 2 * sum(b[i] * np.cos(i * OMEGA) for i in range(1, degree // 2 + 1)))
    np.testing.assert_allclose(prefilter_response(bspline(degree), OMEGA), eq16, rtol=1e-12)


@pytest.mark.parametrize("degree", range(2, 6))
def test_the_two_b_k_of_the_paper_are_two_functions(degree: int) -> None:
    """Eq. (15) integrates the kernel; eqs (12), (13) and (16) sum its samples: by Poisson the sum of (15) over all aliases."""
    one, both = frequency_response(bspline(degree, prefilter=False), OMEGA), 1 / prefilter_response(bspline(degree), OMEGA)
    images = OMEGA[:, None] + 2 * np.pi * np.arange(-400, 401)
    np.testing.assert_allclose(both, sinc_of(images, degree + 1).sum(-1), rtol=0, atol=1e-6)
    np.testing.assert_allclose(both, 1 / prefilter_response(bspline(degree), OMEGA + 2 * np.pi), rtol=1e-9)  # periodic
    assert np.abs(one - both).max() > 0.9  # at 2 pi: 0 and 1


def test_cubic_is_eq_17() -> None:
    eq17 = 3 * sinc_of(OMEGA, 4) / (2 + np.cos(OMEGA))
    np.testing.assert_allclose(frequency_response("bspline3", OMEGA), eq17, rtol=0, atol=1e-12)


def test_hybrid_is_eq_18() -> None:
    eq18 = np.sinc(OMEGA / (4 * np.pi)) ** 2 * np.cos(OMEGA / 4) ** 4 * (2 + np.cos(OMEGA / 2)) / (2 + np.cos(OMEGA))
    np.testing.assert_allclose(frequency_response("hybrid", OMEGA), eq18, rtol=0, atol=1e-12)


def test_prefilter_gains_3_at_nyquist_and_1_at_0() -> None:
    np.testing.assert_allclose(prefilter_response("bspline3", [0, np.pi]), [1, 3], rtol=1e-14)
    np.testing.assert_allclose(prefilter_response("hybrid", [0, np.pi]), [1, 3], rtol=1e-14)


@pytest.mark.parametrize("name", [*filters(), *SMOOTHED])
def test_response_at_0_is_1_if_the_weights_sum_to_one(name: str) -> None:
    row = as_filter(name)
    value = float(frequency_response(name, 0.0))
    assert value == pytest.approx(1, abs=1e-9 if row.sums_to_one else 0.1)
    # Strang and Fix: what reproduces constants is zero at the other multiples of 2π
    if row.sums_to_one:
        np.testing.assert_allclose(frequency_response(name, 2 * np.pi * np.arange(1, 6) * row.scale), 0, atol=1e-9)


@pytest.mark.parametrize("name", [*filters(), *SMOOTHED])
def test_response_is_the_transform_of_the_references_impulse(name: str) -> None:
    """An impulse reconstructed by the reference on a fine grid: Fourier integrals to a few digits."""
    n, fine = 65, 64
    data = np.zeros((1, n))
    data[0, n // 2] = 1
    x = (np.arange(n * fine) + 0.5) / fine - 0.5  # midpoints
    drawn = reference.sample(Volume(data), np.stack([x, np.zeros_like(x)], -1), name, "wrap")
    drawn /= reference.sample(Volume([[1.0]]), [[0.0, 0.0]], name, "wrap")  # the single row, where weights miss one
    omega = np.array([0.0, 0.7, 2.0, 3.1, 4.5, 7.7])
    sums = (drawn * np.cos(omega[:, None] * (x - n // 2))).sum(-1) / fine
    np.testing.assert_allclose(frequency_response(name, omega), sums, atol=2e-3)


@pytest.mark.parametrize("name", [n for n, row in filters().items() if not (row.prefilter or row.magnified_by)])
def test_no_prefilter_has_response_1(name: str) -> None:
    assert (prefilter_response(name, OMEGA) == 1).all()


def test_shapes() -> None:
    for response in (frequency_response, prefilter_response):
        assert response("hybrid", 1.0).shape == ()
        assert response("hybrid", np.ones((2, 3))).shape == (2, 3)
        assert response("hybrid", []).shape == (0,)


@pytest.mark.parametrize("response", [frequency_response, prefilter_response])
def test_bad_values_are_rejected(response: Any) -> None:
    for omega in (*BAD_REALS, np.nan, [np.inf]):
        with pytest.raises(OptionError, match="omega must be"):
            response("linear", omega)
    for name in BAD_FILTERS:
        with pytest.raises(OptionError, match="filter"):
            response(name, 1.0)


@pytest.mark.parametrize("omega", [1e9, -2001.0, [0, 1e300]])
def test_frequencies_beyond_the_integration_are_rejected(omega: object) -> None:
    with pytest.raises(OptionError, match="omega must be within ±2000"):
        frequency_response("linear", omega)  # type: ignore[arg-type]
