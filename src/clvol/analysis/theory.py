"""How fast the error falls as the sampling gets finer, and how large it is: approximation theory of the filters.

T. Blu and M. Unser, *Quantitative Fourier analysis of approximation techniques: Part I*, IEEE Trans. Signal
Processing 47 (1999); T. Möller, R. Machiraju, K. Mueller and R. Yagel, *Evaluation and design of filters using a
Taylor series expansion*, IEEE TVCG 3 (1997), reference [12] of the paper. The sample spacing is T = 1 throughout.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.analysis.table import column
from clvol.filters import Filter

__all__ = ["Approximation", "approximation", "error_kernel", "taylor_coefficients"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Approximation:
    """The leading error of a filter: ``||error|| -> constant T**order ||f^(derivative + order)||`` as T -> 0.

    Attributes
    ----------
    filter : str
        Name of the filter.
    derivative : int
        0 for values, 1 for the derivative along an axis (gradients).
    order : int
        Power of the sample spacing with which the root mean square error falls; 0 where it does not fall, -1 for
        gradients of filters whose weights do not sum to one: they get worse.
    constant : float
        Root mean square over all positions between the samples.
    """

    filter: str = column("filter")
    derivative: int = column("derivative")
    order: int = column("order")
    constant: float = column("constant", ".3e")


def approximation(filter: str | Filter, derivative: int = 0) -> Approximation:
    """Order of approximation and leading error constant, for values or for first derivatives.

    Exact rows are treated in exact fractions, so that linear's constant is ``sqrt(1/120)`` to the last bit.

    Parameters
    ----------
    filter : str or Filter
        Any row of the table.
    derivative : {0, 1}
        0: of the values; 1: of the gradient that the filter's own derivative gives.

    Raises
    ------
    OptionError
    """
    raise NotImplementedError


def error_kernel(filter: str | Filter, omega: ArrayLike, derivative: int = 0) -> Array:
    """The Fourier error kernel E(ω) of Blu and Unser.

    ``E(w) = (1 - H(w))² + sum over k != 0 of H(w + 2 pi k)²``, the mean over all positions of the squared error with
    which ``exp(i w x)`` is reconstructed; computed in that form, so that it keeps its digits for small ω. The mean
    squared error of any f, averaged over the phase of the sampling, is ``1/(2 pi) integral |f^(w)|² E(w T) dw``.

    Parameters
    ----------
    filter : str or Filter
        Any row of the table.
    omega : array-like
        Angular frequency in radians a sample, within ±2000.
    derivative : {0, 1}
        1: the mean squared error of the derivative of ``exp(i w x)``, per sample; divide by ω² for the relative one.

    Returns
    -------
    ndarray of float64, the shape of `omega`
        Near 0 it is ``constant² w**(2 order)`` (times w² for the derivative), see `approximation`.

    Raises
    ------
    OptionError
    """
    raise NotImplementedError


def taylor_coefficients(filter: str | Filter, t: ArrayLike, count: int = 6, derivative: int = 0) -> Array:
    """Möller's Taylor coefficients a_n(t): what is reconstructed is ``sum of a_n(t) f^(n)(x) T**n``, x = t between samples 0 and 1.

    An interpolating value filter should have a_0 = 1 and the others 0, a derivative filter a_1 = 1 and the others 0.

    Parameters
    ----------
    filter : str or Filter
        Any row of the table.
    t : array-like
        Positions within a sample, in [0, 1).
    count : int
        How many coefficients, 1 to 12: n = 0, ..., count - 1.
    derivative : {0, 1}
        1: of the filter's derivative, which reconstructs f'.

    Returns
    -------
    ndarray of float64, shape (count, *t.shape)

    Raises
    ------
    OptionError
    """
    raise NotImplementedError
