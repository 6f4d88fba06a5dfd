"""Passbands and stopbands; the responses themselves are in test_response."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize

import clvol
from clvol.analysis import Bands, bands, frequency_response
from clvol.errors import OptionError
from clvol.filter import Filter, filters, from_pieces
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


@pytest.mark.parametrize("name", filters())
def test_every_row_has_bands_that_its_response_confirms(name: str) -> None:
    got = bands(name, 1.0)
    assert got.cutoff is not None
    assert frequency_response(name, got.cutoff) == pytest.approx(math.sqrt(0.5), abs=1e-9)
    inside = np.linspace(0, 1, 777)
    assert np.abs(frequency_response(name, inside) - 1).max() <= got.passband_error + 1e-9
    outside = np.linspace(2 * math.pi - 1, 60, 5001)
    assert np.abs(frequency_response(name, outside)).max() == pytest.approx(got.stopband_peak, abs=2e-4)


def test_the_direct_spline_has_the_better_bands_than_the_hybrid() -> None:
    """Section 4.3: what Figure 2 of the paper shows."""
    direct, hybrid = bands("bspline3"), bands("hybrid")
    assert direct.passband_error < hybrid.passband_error / 4
    assert direct.stopband_peak < hybrid.stopband_peak / 4


def test_responses_are_those_of_clvol() -> None:
    assert frequency_response is clvol.frequency_response
    assert clvol.analysis.prefilter_response is clvol.prefilter_response


def test_a_kernel_of_zeros_has_no_bands_but_values() -> None:
    nothing = bands(from_pieces("nothing", [(0.0,)]))
    assert nothing == Bands("nothing", math.pi / 2, None, 0.0, 1.0, 0.0, None)


@pytest.mark.parametrize("edge", [0, -1, math.pi, *BAD_NUMBERS], ids=repr)
def test_a_bad_edge_is_refused(edge: object) -> None:
    with pytest.raises(OptionError, match="edge must be a finite number, greater than 0"):
        bands("linear", edge)  # type: ignore[arg-type]


def test_a_kernel_that_is_not_even_is_refused() -> None:
    with pytest.raises(OptionError, match="even kernel, so that its response is real; got 'skew'"):
        bands(NO_EVEN_KERNEL)
