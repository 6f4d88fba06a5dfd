"""Overshoot and ringing at a step, of a sharp and a Gaussian low-pass, and of every filter (section 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from scipy import special

from clvol.analysis.cardinal import pieces
from clvol.analysis.table import UNLISTED, column
from clvol.base.arrays import Array
from clvol.base.checks import number, one_of
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter

__all__ = ["WILBRAHAM_GIBBS", "StepResponse", "lowpass_step", "step_response"]


WILBRAHAM_GIBBS: Final = float(special.sici(np.pi)[0] / np.pi - 0.5)
"""Overshoot of a Fourier series at a step of 1, on each side: 0.0895 (Si(π)/π - 1/2), the paper's 8.949 %."""

_PERIOD = 1 << 16  # samples of the square wave whose steps are low-passed
_FINE = 64  # positions per sample at which a step is evaluated
_REACH = 16  # samples on either side of the step


@dataclass(frozen=True, kw_only=True)
class StepResponse:
    """The response to a step from 0 to 1.

    Attributes
    ----------
    name : str
        Of the filter or low-pass.
    overshoot, undershoot : float
        The largest excess above 1 and below 0, relative to the step.
    ringing : float
        Total variation minus that of a monotone curve, 1: 0 without ringing.
    rise : float
        Distance in samples from 10 % to 90 %.
    x : ndarray of float64, shape (N,)
        Positions in samples; the step is at 0.
    values : ndarray of float64, shape (N,)
    """

    name: str = column("name")
    overshoot: float = column("overshoot", ".2%")
    undershoot: float = column("undershoot", ".2%")
    ringing: float = column("ringing", ".4f")
    rise: float = column("rise (samples)", ".2f")
    x: Array = field(repr=False, compare=False, metadata=UNLISTED)
    values: Array = field(repr=False, compare=False, metadata=UNLISTED)


def step_response(filter: str | Filter) -> StepResponse:
    """The filter's reconstruction of a step at position 0, half-way between two samples: 0 before, 1 after.

    Raises
    ------
    OptionError
        Unknown filter.
    """
    chosen = as_filter(filter)
    x: Array = np.arange(-_REACH * _FINE, _REACH * _FINE + 1) / np.float64(_FINE)
    drawn = pieces(chosen)
    reach = int(np.ceil(_REACH - drawn.start)) + 1
    values = np.zeros_like(x)
    for k in range(reach):  # the sample at k + 1/2
        values += drawn(x - k - 0.5)
    return _measured(chosen.name, x, values)


def lowpass_step(
    kind: Literal["ideal", "gaussian"] = "ideal", cutoff: float = np.pi / 128, sigma: float | None = None
) -> StepResponse:
    """The response to a finely sampled step after a low-pass.

    Parameters
    ----------
    kind : {"ideal", "gaussian"}
        A box in the frequency domain: it overshoots by 8.949 % of the step whatever its cutoff, within its bounds to 0.01 %.
        Or a Gaussian, which never leaves [0, 1].
    cutoff : float
        Of the ideal filter, in radians per sample: at most pi / 32, so that the step is sampled
        finely, and at least pi / 512, so that the next step is far.
    sigma : float, optional
        Standard deviation of the Gaussian in samples; by default its response is 1/2 at `cutoff`.

    Raises
    ------
    OptionError
        Another kind, or a number outside its bounds.
    """
    if kind not in ("ideal", "gaussian"):
        raise one_of("kind", kind, ("ideal", "gaussian"))
    cutoff = number("cutoff", cutoff, minimum=np.pi / 512, maximum=np.pi / 32)
    width = np.sqrt(2 * np.log(2)) / cutoff if sigma is None else number("sigma", sigma, minimum=1, maximum=_PERIOD / 64)
    omega = 2 * np.pi * np.fft.rfftfreq(_PERIOD)
    response = (omega <= cutoff) * 1.0 if kind == "ideal" else np.exp(-((omega * width) ** 2) / 2)
    wave = np.where((np.arange(_PERIOD) - _PERIOD // 4) % _PERIOD < _PERIOD // 2, 1.0, 0.0)
    values: Array = np.fft.irfft(np.fft.rfft(wave) * response, _PERIOD).astype(np.float64)
    # the middle of the wave's first step, with half of each of its levels; it lies between two samples
    x: Array = np.arange(_PERIOD // 2, dtype=np.float64) - (_PERIOD // 4 - 0.5)
    return _measured(kind, x, values[: _PERIOD // 2])


def _measured(name: str, x: Array, values: Array) -> StepResponse:
    above, below = max(0.0, float(values.max()) - 1), max(0.0, -float(values.min()))
    first, last = np.flatnonzero(values < 0.1)[-1], np.flatnonzero(values > 0.9)[0]
    if last > first:  # monotone between: the crossings by linear interpolation
        between = slice(int(first), int(last) + 1)
        rise = float(np.diff(np.interp([0.1, 0.9], values[between], x[between]))[0])
    else:
        rise = 0.0
    variation = float(np.abs(np.diff(values)).sum())
    return StepResponse(name=name, overshoot=above, undershoot=below, ringing=variation - 1, rise=rise, x=x, values=values)
