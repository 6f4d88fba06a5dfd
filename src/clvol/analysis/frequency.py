"""Passband and stopband of a filter, from its frequency response (eqs 14 to 18, `clvol.response`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clvol.analysis.table import column
from clvol.filters import Filter
from clvol.response import frequency_response, prefilter_response

__all__ = ["Bands", "bands", "frequency_response", "prefilter_response"]


@dataclass(frozen=True)
class Bands:
    """How a response H keeps what it should keep and removes what it should remove.

    Attributes
    ----------
    filter : str
        Name of the filter.
    edge : float
        Edge of the passband in radians a sample; its images, the stopband, begin at ``2 pi - edge``.
    cutoff : float or None
        Lowest frequency in radians a sample at which ``|H| = 1 / sqrt 2`` (-3 dB); None if there is none below 2 pi.
    at_nyquist : float
        H(pi); 1/2 for a filter that halves it, as interpolating ones do.
    passband_error : float
        Greatest ``|H - 1|`` for frequencies up to `edge`.
    stopband_peak : float
        Greatest ``|H|`` from ``2 pi - edge`` on.
    attenuation : float
        The same in decibels, positive: ``-20 log10(stopband_peak)``.
    """

    filter: str = column("filter")
    edge: float = column("edge (rad)", ".3f")
    cutoff: float | None = column("−3 dB (rad)", ".3f")
    at_nyquist: float = column("H(π)", ".3f")
    passband_error: float = column("passband error", ".4f")
    stopband_peak: float = column("stopband peak", ".4f")
    attenuation: float = column("attenuation (dB)", ".1f")


def bands(filter: str | Filter, edge: float = math.pi / 2) -> Bands:
    """Passband and stopband of a filter.

    Parameters
    ----------
    filter : str or Filter
        Any row of the table.
    edge : float
        Up to which frequency, in radians a sample, the data hold anything: above 0 and below pi.

    Raises
    ------
    OptionError
    """
    raise NotImplementedError
