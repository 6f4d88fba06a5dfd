"""The margin that a block needs on each side: how far coefficients depend on samples."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.spline.field import Precision

__all__ = ["LEFT_OUT", "Margin", "margin", "reach", "require_settled"]

Margin: TypeAlias = tuple[int, int]
"""Samples before and after."""

LEFT_OUT = {"single": 2.0**-24, "double": 1e-14}
"""The share of a prefilter's weights that a margin may leave out."""


def reach(filter: str | Filter, precision: Precision = "single") -> int:
    """How many samples on each side of a block its coefficients depend on, so that what lies further out adds less than rounding.

    Parameters
    ----------
    filter : str or Filter
        Whose smoothing, if any, is one number, or one for each axis: then the largest of their reaches.
    precision : {"single", "double"}
        What may be left out: 2⁻²⁴ = 6 · 10⁻⁸ of the sum of the prefilter's weights, or 10⁻¹⁴.

    Raises
    ------
    OptionError
        The filter's smoothing is decided for a volume, or one of the names is unknown.

    Notes
    -----
    Coefficients are samples convolved with ``h``, the inverse of `Filter.undone`, which decays like powers of the largest pole. The
    reach is the smallest d with ``sum of |h[k]| for |k| > d ≤ ε · sum of all |h[k]|``. Let G be the latter sum (3 for
    cubic splines) and R the range of the samples. Where a block ends its recursions by a boundary rule d samples further out,
    the samples that it assumes there differ from the real ones by R at most, and so its coefficients along one axis by ε G R at
    most, along D axes by ``D ε Gᴰ R``. Where a boundary rule puts values of its own outside (0, `cval`), R includes them.
    """
    if precision not in LEFT_OUT:
        raise one_of("precision", precision, LEFT_OUT)
    row = as_filter(filter)
    row = row.magnified_by or row
    require_settled(row)
    count = len(row.smoothing) if isinstance(row.smoothing, tuple) else 1
    return max(_reach(row.along(axis), LEFT_OUT[precision]) for axis in range(count))


def require_settled(row: Filter) -> None:
    """Refuse a filter whose smoothing is decided from samples."""
    if not row.settled:
        raise OptionError(
            f"the smoothing of {row.name!r} is decided from all samples, and blocks are computed before these are known: "
            "give a number, as in 'bspline3(0.1)'; clvol.volume.smoothing.choose(volume) finds one for a part of the data"
        )


def margin(filter: Filter, precision: Precision) -> Margin:
    """How many samples before and after the one before a position its value depends on: its taps, and what these depend on."""
    low, high = _taps(filter)
    row = filter.magnified_by
    if row is not None:  # its taps lie between two samples
        (low, high), more = _taps(row), 1
    else:
        row, more = filter, 0
    depth = reach(row, precision) + more
    return low + depth, high + depth


def _taps(row: Filter) -> Margin:
    return (row.support - 1) // 2, (row.support + 1) // 2


@lru_cache(maxsize=256)
def _reach(row: Filter, left_out: float) -> int:
    poles = row.poles
    if not poles.size:
        return 0
    # powers of the largest pole, and of pairs of poles that lie together, down to where float64 sees nothing
    count = math.ceil(40 / -math.log(float(np.abs(poles).max()))) + 2 * poles.size
    causal = _impulse_response(np.asarray(np.poly(poles).real, np.float64), count)
    weights = np.abs(np.correlate(causal, causal, "full")[count - 1 :])  # at distances 0, 1, 2, ..., but for a factor
    beyond = np.append(np.cumsum(weights[::-1])[::-1], 0.0)  # from a distance on
    allowed = left_out * (2 * beyond[0] - weights[0])
    return int(np.flatnonzero(2 * beyond[1:] <= allowed)[0])


def _impulse_response(denominator: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The impulse response of a recursion, whose weights begin with 1."""
    from scipy import signal

    impulse = np.zeros(count)
    impulse[0] = 1.0
    return np.asarray(signal.lfilter([1.0], denominator, impulse))
