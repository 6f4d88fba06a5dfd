"""The metrics of Marschner and Lobb: smoothing, postaliasing and overshoot of a filter.

S. R. Marschner and R. J. Lobb, *An Evaluation of Reconstruction Filters for Volume Rendering*, Proc. Visualization
1994, pp. 100-107 (reference [9] of the paper), section 4. With H the filter's frequency response and R the Nyquist
region, ``|w| <= pi`` along every axis::

    smoothing      S = 1 - 1/|R| integral over R of |H|²
    postaliasing   P = 1/|R| integral outside R of |H|²
    overshoot      O = the greatest value of (unit step * filter), less 1

The ideal filter, 1 in R and 0 outside, has S = P = 0, and O is the constant of Wilbraham and Gibbs, 0.0895.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.analysis.table import column
from clvol.filters import Filter

__all__ = ["Metrics", "metrics"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Metrics:
    """Marschner and Lobb's metrics, along one axis and of the separable filter in 3-D; 0 is ideal for all but overshoot.

    Attributes
    ----------
    filter : str
        Name of the filter.
    smoothing, postaliasing : float
        In 1-D. Smoothing is negative where a filter amplifies more than it attenuates.
    overshoot : float
        In 1-D, relative to the step; the separable filter overshoots a step along an axis as much.
    smoothing_3d, postaliasing_3d : float
        Of the product of three: ``1 - (1 - S)³`` and ``(1 - S + P)³ - (1 - S)³``.
    """

    filter: str = column("filter")
    smoothing: float = column("smoothing", ".4f")
    postaliasing: float = column("postaliasing", ".4f")
    overshoot: float = column("overshoot", ".4f")
    smoothing_3d: float = column("smoothing 3-D", ".4f")
    postaliasing_3d: float = column("postaliasing 3-D", ".4f")


def metrics(filter: str | Filter | Callable[[Array], Array]) -> Metrics:
    """Smoothing, postaliasing and overshoot of a filter, the prefilter and the magnification included.

    Parameters
    ----------
    filter : str, Filter or callable
        Any row of the table; or an even, real frequency response, called with frequencies in radians a sample up to
        64 pi, such as ``lambda w: (abs(w) <= numpy.pi) * 1.0`` for the ideal filter: what lies beyond is left out.

    Raises
    ------
    OptionError
        Unknown filter, or a response that fails or is not finite.
    """
    raise NotImplementedError
