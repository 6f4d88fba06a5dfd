"""Overshoot and ringing at a step: of a sharp low-pass against a Gaussian one, and of every filter (section 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from clvol.analysis.table import column, unlisted
from clvol.filters import Filter

__all__ = ["WILBRAHAM_GIBBS", "StepResponse", "lowpass_step", "step_response"]

Array: TypeAlias = NDArray[np.float64]

WILBRAHAM_GIBBS: Final = float(special.sici(np.pi)[0] / np.pi - 0.5)
"""How far a Fourier series overshoots a step of 1, on each side: 0.0895 (Si(π)/π - 1/2), the paper's 8.949 %."""


@dataclass(frozen=True)
class StepResponse:
    """What becomes of a step from 0 to 1.

    Attributes
    ----------
    name : str
        Of the filter or low-pass.
    overshoot, undershoot : float
        How far it goes above 1 and below 0, in steps.
    ringing : float
        Total variation less that of a monotone curve, 1: 0 if nothing rings.
    rise : float
        Distance in samples over which it goes from 10 % to 90 %.
    x : ndarray of float64, shape (N,)
        Positions in samples; the step lies at 0.
    values : ndarray of float64, shape (N,)
    """

    name: str = column("name")
    overshoot: float = column("overshoot", ".2%")
    undershoot: float = column("undershoot", ".2%")
    ringing: float = column("ringing", ".4f")
    rise: float = column("rise (samples)", ".2f")
    x: Array = unlisted()
    values: Array = unlisted()


def step_response(filter: str | Filter) -> StepResponse:
    """A step of the samples, 0 up to and 1 after position 0 half-way between two of them, as the filter draws it.

    Raises
    ------
    OptionError
        Unknown filter.
    """
    raise NotImplementedError


def lowpass_step(
    kind: Literal["ideal", "gaussian"] = "ideal", cutoff: float = np.pi / 8, sigma: float | None = None
) -> StepResponse:
    """A finely sampled step after a low-pass, measured.

    Parameters
    ----------
    kind : {"ideal", "gaussian"}
        A box in the frequency domain: it overshoots by 8.949 % of the step whatever its cutoff. Or a Gaussian, which
        never leaves [0, 1].
    cutoff : float
        Of the ideal filter, in radians a sample: above 0 and at most pi / 8 (the step must be sampled finely).
    sigma : float, optional
        Standard deviation of the Gaussian in samples; by default its response is 1/2 at `cutoff`.

    Raises
    ------
    OptionError
    """
    raise NotImplementedError
