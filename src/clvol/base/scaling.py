"""Arithmetic on any float64 values: divided by a power of two, no difference or quotient overflows or underflows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["exponent_of", "scaled", "share_of", "unscaled"]

_LARGEST = float(np.finfo(np.float64).max)


def exponent_of(low: float, high: float) -> int:
    """Exponent of the power of two that scales a range into -1..1."""
    return math.frexp(max(abs(low), abs(high)))[1]


def scaled(values: ArrayLike, exponent: int) -> NDArray[np.float64]:
    """Exactly ``values / 2**exponent``."""
    with np.errstate(over="ignore"):
        return np.asarray(np.ldexp(np.asarray(values, dtype=np.float64), -exponent))


def unscaled(value: float, exponent: int) -> float:
    """``value * 2**exponent``, clipped to the range of float64."""
    with np.errstate(over="ignore"):
        return float(np.clip(np.ldexp(value, exponent), -_LARGEST, _LARGEST))


def share_of(low: float, high: float, share: float) -> float:
    """``low + share (high - low)``, even if the difference overflows float64."""
    exponent = exponent_of(low, high)
    bottom, top = scaled((low, high), exponent)
    return unscaled(bottom + share * (top - bottom), exponent)
