"""The maximum of a function of one variable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import optimize

from clvol.base.arrays import Array

__all__ = ["maximum"]


def maximum(function: Callable[[Array], Array], low: float, high: float, count: int) -> float:
    """The maximum on [low, high]: the best of `count` positions, refined between its neighbours."""
    x = np.linspace(low, high, count)
    y = function(x)
    best = int(y.argmax())
    around = (x[max(best - 1, 0)], x[min(best + 1, count - 1)])
    peak = optimize.minimize_scalar(lambda at: -float(function(np.array([at]))[0]), bounds=around, method="bounded")
    return float(max(y[best], -peak.fun))
