"""Passband and stopband of a filter, from its frequency response (eqs 14 to 18, `clvol.filter.response`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from clvol.analysis.cardinal import even_filter
from clvol.analysis.table import column
from clvol.base.arrays import Array
from clvol.base.checks import number
from clvol.filter.filter import Filter
from clvol.filter.response import frequency_response, prefilter_response

__all__ = ["Bands", "bands", "frequency_response", "maximum", "prefilter_response"]

_FARTHEST = 16 * math.pi  # end of the searched stopband: further out every response is smaller


@dataclass(frozen=True)
class Bands:
    """How well a response H keeps the passband and removes the stopband.

    Attributes
    ----------
    filter : str
        Name of the filter.
    edge : float
        Edge of the passband in radians per sample; its images, the stopband, begin at ``2 pi - edge``.
    cutoff : float or None
        Lowest frequency in radians per sample at which ``|H| = 1 / sqrt 2`` (-3 dB); None if there is none below 2 pi.
    at_nyquist : float
        H(pi); 1/2 for a filter that halves it, as interpolating ones do.
    passband_error : float
        Largest ``|H - 1|`` for frequencies up to `edge`.
    stopband_peak : float
        Largest ``|H|`` from ``2 pi - edge`` on.
    attenuation : float or None
        The same in decibels, positive: ``-20 log10(stopband_peak)``; None if nothing gets through.
    """

    filter: str = column("filter")
    edge: float = column("edge (rad)", ".3f")
    cutoff: float | None = column("−3 dB (rad)", ".3f")
    at_nyquist: float = column("H(π)", ".3f")
    passband_error: float = column("passband error", ".4f")
    stopband_peak: float = column("stopband peak", ".4f")
    attenuation: float | None = column("attenuation (dB)", ".1f")


def bands(filter: str | Filter, edge: float = math.pi / 2) -> Bands:
    """Passband and stopband of a filter.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    edge : float
        The data's highest frequency in radians per sample: above 0 and below pi.

    Raises
    ------
    OptionError
        Unknown filter, one whose kernel is not even, or an edge outside its bounds.
    """
    chosen, edge = even_filter(filter), number("edge", edge, above=0, below=math.pi)
    omega = np.linspace(0, 2 * math.pi, 1025)
    below = np.flatnonzero(np.abs(frequency_response(chosen, omega)) < math.sqrt(0.5))
    cutoff = None
    if below.size and below[0] > 0:
        bracket = omega[below[0] - 1], omega[below[0]]
        cutoff = float(optimize.brentq(lambda w: abs(float(frequency_response(chosen, w))) - math.sqrt(0.5), *bracket))
    peak = maximum(lambda w: np.abs(frequency_response(chosen, w)), 2 * math.pi - edge, _FARTHEST, 4097)
    return Bands(
        chosen.name,
        edge,
        cutoff,
        float(frequency_response(chosen, math.pi)),
        maximum(lambda w: np.abs(frequency_response(chosen, w) - 1), 0.0, edge, 513),
        peak,
        -20 * math.log10(peak) if peak > 0 else None,
    )


def maximum(function: Callable[[Array], Array], low: float, high: float, count: int) -> float:
    """The maximum on [low, high]: the best of `count` positions, refined between its neighbours."""
    x = np.linspace(low, high, count)
    y = function(x)
    best = int(y.argmax())
    around = (x[max(best - 1, 0)], x[min(best + 1, count - 1)])
    peak = optimize.minimize_scalar(lambda at: -float(function(np.array([at]))[0]), bounds=around, method="bounded")
    return float(max(y[best], -peak.fun))
