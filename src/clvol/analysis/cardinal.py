"""The impulse response of a whole reconstruction, prefilter and magnification included, as polynomials piece by piece."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.filters import Filter

__all__ = ["impulse_response"]

Array: TypeAlias = NDArray[np.float64]


def impulse_response(filter: str | Filter, x: ArrayLike, derivative: int = 0) -> Array:
    """What the filter makes, along one axis, of a sample of 1 at 0 among zeros.

    For a filter without a prefilter this is its kernel, eq. (10) for the cubic; with one, the cardinal
    spline ``sum of s_k beta(x - k)``, where s is the impulse response of eq. (16); for a hybrid, the
    cardinal spline at multiples of half a sample, drawn through the second kernel (section 4.3).

    Parameters
    ----------
    filter : str or Filter
        Any row of the table.
    x : array-like
        Signed distance in samples of the given data.
    derivative : {0, 1, 2}
        Order of the derivative, per sample.

    Returns
    -------
    ndarray of float64, the shape of `x`

    Raises
    ------
    OptionError
        Unknown filter, `x` not real, or another derivative.
    """
    raise NotImplementedError
