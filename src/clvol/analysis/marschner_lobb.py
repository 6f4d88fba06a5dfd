"""The metrics of Marschner and Lobb: smoothing, postaliasing and overshoot of a filter.

S. R. Marschner and R. J. Lobb, *An Evaluation of Reconstruction Filters for Volume Rendering*, Proc. Visualization
1994, pp. 100-107 (reference [9] of the paper), section 4. With H the filter's frequency response and R the Nyquist
region, ``|w| <= pi`` along every axis::

    smoothing      S = 1 - 1/|R| integral over R of |H|²
    postaliasing   P = 1/|R| integral outside R of |H|²
    overshoot      O = the maximum of (unit step * filter), less 1

The ideal filter, 1 in R and 0 outside, has S = P = 0, and O is the constant of Wilbraham and Gibbs, 0.0895.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from clvol.analysis.cardinal import even_filter, pieces
from clvol.analysis.frequency import maximum
from clvol.analysis.table import column
from clvol.base.arrays import Array, reals
from clvol.base.errors import ClvolError, OptionError
from clvol.filter.filter import Filter
from clvol.filter.response import frequency_response

__all__ = ["Metrics", "metrics"]

_PANELS = 64  # of width π, to which the transform of a response is taken
_NODES = 48  # for each panel; exact to float64 for 8 oscillations along it
_REACH = 8.0  # samples on each side of the step that are searched for the overshoot


@dataclass(frozen=True)
class Metrics:
    """Marschner and Lobb's metrics, along one axis and of the separable filter in 3-D; 0 is ideal, except for overshoot.

    Attributes
    ----------
    filter : str
        Name of the filter.
    smoothing, postaliasing : float
        In 1-D. Smoothing is negative if a filter amplifies more than it attenuates.
    overshoot : float
        In 1-D, relative to the step; the same for the separable filter at a step along an axis.
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
    """Smoothing, postaliasing and overshoot of a filter, including prefilter and magnification.

    Parameters
    ----------
    filter : str, Filter or callable
        Any filter of the table; or an even, real frequency response, called with frequencies in radians per sample up to
        64 pi and ignored beyond, such as ``lambda w: (abs(w) <= numpy.pi) * 1.0`` for the ideal filter.

    Raises
    ------
    OptionError
        Unknown filter, one whose kernel is not even, or a response that fails or is not finite.
    """
    if callable(filter) and not isinstance(filter, Filter):
        return _of_response(filter)
    chosen = even_filter(filter)
    omega, widths = _panels(1)
    kept = float(frequency_response(chosen, omega) ** 2 @ widths) / np.pi
    drawn = pieces(chosen)
    # Parseval: the integral of |H|² over all frequencies is 2 pi times the kernel's energy
    return _metrics(chosen.name, 1 - kept, drawn.energy() - kept, drawn.max_integral() - 1)


def _of_response(response: Callable[[Array], Array]) -> Metrics:
    omega, widths = _panels(_PANELS)
    rule = "one finite value for each frequency"
    try:
        given = response(omega.copy())
    except ClvolError:
        raise
    except Exception as error:
        raise OptionError(f"the response must give {rule}; it failed: {error!r}") from error
    h = reals("the response", given, rule)
    if h.shape != omega.shape or not np.isfinite(h).all():
        raise OptionError(f"the response must give {rule}; got shape {h.shape}")
    energy = h**2 * widths / np.pi

    def step(x: Array) -> Array:
        """The unit step after the filter: 1/2 and a sine integral, since H is even."""
        return np.asarray(0.5 * h[0] + np.sin(x[:, None] * omega) @ (h * widths / omega) / np.pi)

    name = getattr(response, "__name__", "response")
    return _metrics(name, 1 - float(energy[:_NODES].sum()), float(energy[_NODES:].sum()), maximum(step, 0, _REACH, 1025) - 1)


def _metrics(name: str, smoothing: float, postaliasing: float, overshoot: float) -> Metrics:
    kept = 1 - smoothing
    return Metrics(name, smoothing, postaliasing, max(0.0, overshoot), 1 - kept**3, (kept + postaliasing) ** 3 - kept**3)


def _panels(count: int) -> tuple[Array, Array]:
    """Gauss–Legendre nodes and widths on [0, count π], panel by panel."""
    nodes, lengths = legendre.leggauss(_NODES)
    omega = (np.arange(count)[:, None] + (nodes + 1) / 2) * np.pi
    return omega.ravel(), np.tile(lengths * np.pi / 2, count)
