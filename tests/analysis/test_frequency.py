"""Passbands and stopbands; the responses themselves are in test_response."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize

import clvol
from clvol.analysis import Bands, bands, frequency_response
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import from_pieces
from clvol.filter.table import filters
from tests.cases import BAD_NUMBERS

NO_EVEN_KERNEL = Filter("skew", ((0.0, 1.0), (1.0, -0.5)))


def sinc_of(omega: float) -> float:
    return float(np.sinc(omega / (2 * math.pi)))


def test_linear_by_its_closed_form() -> None:
    got = bands("linear")
    assert got.cutoff == pytest.approx(optimize.brentq(lambda w: sinc_of(w) ** 2 - math.sqrt(0.5), 1, 3), abs=1e-9)
    assert got.at_nyquist == pytest.approx(4 / math.pi**2, rel=1e-12)
    assert got.passband_error == pytest.approx(1 - sinc_of(math.pi / 2) ** 2, rel=1e-9)
    assert got.stopband_peak == pytest.approx(sinc_of(3 * math.pi / 2) ** 2, rel=1e-9)
    assert got.attenuation == pytest.approx(-40 * math.log10(abs(sinc_of(3 * math.pi / 2))), rel=1e-9)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", filters())
def test_every_filter_has_bands_that_its_response_confirms(name: str) -> None:
    got = bands(name, 1.0)
    assert got.cutoff is not None
    assert frequency_response(name, got.cutoff) == pytest.approx(math.sqrt(0.5), abs=1e-9)
    inside = np.linspace(0, 1, 777)
    assert np.abs(frequency_response(name, inside) - 1).max() <= got.passband_error + 1e-9
    outside = np.linspace(2 * math.pi - 1, 60, 5001)
    assert np.abs(frequency_response(name, outside)).max() == pytest.approx(got.stopband_peak, abs=2e-4)


def direct_by_eq_17(omega: np.ndarray) -> np.ndarray:
    return 3 * np.sinc(omega / (2 * np.pi)) ** 4 / (2 + np.cos(omega))


def hybrid_by_eq_18(omega: np.ndarray) -> np.ndarray:
    return np.sinc(omega / (4 * np.pi)) ** 2 * np.cos(omega / 4) ** 4 * (2 + np.cos(omega / 2)) / (2 + np.cos(omega))


def test_direct_has_the_better_passband_but_not_the_better_stopband() -> None:
    """Section 4.3, of Figure 2: in the passband, yes; but beyond Nyquist the hybrid lets less through, up to 2.157 pi.

    Computed from the paper's equations alone; test_response compares these with clvol's.
    """

    def more(omega: np.ndarray) -> np.ndarray:
        return np.abs(hybrid_by_eq_18(omega)) - np.abs(direct_by_eq_17(omega))

    edge = optimize.brentq(more, 2.1 * np.pi, 2.3 * np.pi, xtol=1e-12)
    assert edge / np.pi == pytest.approx(2.1565, abs=1e-5)
    passband = np.linspace(0.01, np.pi, 4000)
    assert (hybrid_by_eq_18(passband) < direct_by_eq_17(passband)).all()
    assert (direct_by_eq_17(passband) < 1).all()
    below = np.linspace(np.pi, edge - 1e-3, 4001)
    above = np.linspace(edge + 1e-3, 60 * np.pi, 200_001)
    apart_from_zeros = 1e-12  # at multiples of 2 pi both are 0
    assert (more(below)[np.abs(direct_by_eq_17(below)) > apart_from_zeros] < 0).all()
    assert (more(above)[np.abs(hybrid_by_eq_18(above)) > apart_from_zeros] > 0).all()
    assert more(below).min() < -0.08  # not by rounding: 0.405 against 0.493 at Nyquist
    assert more(above).max() > 0.04


def test_the_largest_response_to_aliases_matches_the_equations() -> None:
    """For data below half of Nyquist, aliases begin at 3 pi / 2: there direct peaks, the hybrid at 3.1 pi."""
    direct, hybrid = bands("bspline3"), bands("hybrid")
    omega = np.linspace(1.5 * np.pi, 16 * np.pi, 400_001)
    for got, response in ((direct, direct_by_eq_17), (hybrid, hybrid_by_eq_18)):
        assert got.stopband_peak == pytest.approx(np.abs(response(omega)).max(), rel=1e-6)
        assert got.passband_error == pytest.approx(1 - response(np.float64(np.pi / 2)), rel=1e-9)
    assert direct.stopband_peak == pytest.approx(direct_by_eq_17(np.float64(1.5 * np.pi)), rel=1e-9)
    assert hybrid_by_eq_18(np.float64(1.5 * np.pi)) < 0.71 * direct.stopband_peak < 0.25 * hybrid.stopband_peak


def test_responses_match_clvols() -> None:
    assert frequency_response is clvol.frequency_response
    assert clvol.analysis.prefilter_response is clvol.prefilter_response


def test_a_kernel_of_zeros_has_values_but_no_bands() -> None:
    nothing = bands(from_pieces("nothing", [(0.0,)]))
    assert nothing == Bands("nothing", math.pi / 2, None, 0.0, 1.0, 0.0, None)


@pytest.mark.parametrize("edge", [0, -1, math.pi, *BAD_NUMBERS], ids=repr)
def test_a_bad_edge_is_rejected(edge: object) -> None:
    with pytest.raises(OptionError, match="edge must be a finite number, greater than 0"):
        bands("linear", edge)  # type: ignore[arg-type]


def test_a_kernel_that_is_not_even_is_rejected() -> None:
    with pytest.raises(OptionError, match="even kernel, so that its response is real; got 'skew'"):
        bands(NO_EVEN_KERNEL)
