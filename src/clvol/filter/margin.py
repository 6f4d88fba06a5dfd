"""The reach of a prefilter: the margin of samples around a part of a volume that the part's coefficients depend on."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter

__all__ = ["LEFT_OUT", "reach", "reach_within", "require_settled"]

LEFT_OUT = {"single": 1e-8, "double": 1e-14}
"""Fraction of a prefilter's weights outside the margin, by precision."""


def reach(filter: str | Filter, precision: str = "single") -> int:
    """Margin in samples on each side of a part; samples further out change its coefficients by less than rounding.

    Parameters
    ----------
    filter : str or Filter
        If its smoothing differs between axes, the result is the largest reach.
    precision : {"single", "double"}
        The margin leaves out 10⁻⁸ ("single") or 10⁻¹⁴ ("double") of the sum of the prefilter's weights.

    Raises
    ------
    OptionError
        The filter's smoothing depends on the samples, or a name is unknown.

    Notes
    -----
    Coefficients are samples convolved with ``h``, the inverse of `Filter.undone`, which decays like powers of the largest pole.
    The reach is the smallest d with ``sum of |h[k]| for |k| > d ≤ ε · sum of all |h[k]|``: 14 and 24 samples for cubic splines.
    Let G be the latter sum (3 for cubic splines) and R the range of the samples. If the recursions of a part end with a
    boundary rule d samples further out, the samples that the rule assumes there differ from the real ones by at most R. So the
    error of coefficients is at most ε G R along one axis, and ``D ε Gᴰ R`` along D axes. If the boundary rule has a constant
    outside (0, `cval`), R includes it.
    """
    if precision not in LEFT_OUT:
        raise one_of("precision", precision, LEFT_OUT)
    return reach_within(filter, LEFT_OUT[precision])


def reach_within(filter: str | Filter, left_out: float) -> int:
    """`reach` for a margin that may leave out this share of the sum of the prefilter's weights, at least 1e-17."""
    row = as_filter(filter)
    row = row.magnified_by or row
    require_settled(row)
    return max(_reach(along, left_out) for along in row.along_axes)


def require_settled(row: Filter) -> None:
    """Raise `OptionError` for a filter whose smoothing depends on the samples."""
    if not row.settled:
        raise OptionError(
            f"the smoothing of {row.name!r} is decided from all samples, and parts are computed before these are known: "
            "give a number, as in 'bspline3(0.1)'; clvol.volume.smoothing.choose(volume) finds one for a part of the data"
        )


@lru_cache(maxsize=256)
def _reach(row: Filter, left_out: float) -> int:
    if not row.prefilter or not row.poles.size:
        return 0
    # powers of the largest pole, and of close pairs of poles, until they vanish in float64
    count = math.ceil(40 / -math.log(float(np.abs(row.poles).max()))) + 2 * row.poles.size
    causal = _impulse_response(np.asarray(np.poly(row.poles).real, np.float64), count)
    weights = np.abs(np.correlate(causal, causal, "full")[count - 1 :])  # at distances 0, 1, 2, ..., up to a constant factor
    beyond = np.append(np.cumsum(weights[::-1])[::-1], 0.0)  # the sum of weights from each distance on
    allowed = left_out * (2 * beyond[0] - weights[0])
    return int(np.flatnonzero(2 * beyond[1:] <= allowed)[0])


def _impulse_response(denominator: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The first `count` values of ``1 / denominator``, a polynomial in the delay whose first coefficient is 1."""
    order = len(denominator) - 1
    recursion = -denominator[:0:-1]
    response = np.zeros(order + count)
    response[order] = 1.0
    for n in range(order + 1, order + count):
        response[n] = recursion @ response[n - order : n]
    return response[order:]
