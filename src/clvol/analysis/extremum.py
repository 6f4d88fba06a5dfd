"""Where a function of one variable is greatest."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

__all__ = ["greatest"]

Array: TypeAlias = NDArray[np.float64]


def greatest(function: Callable[[Array], Array], low: float, high: float, count: int) -> float:
    """The greatest value on [low, high]: the best of `count` places, then the peak between its neighbours."""
    x = np.linspace(low, high, count)
    y = function(x)
    best = int(y.argmax())
    around = (x[max(best - 1, 0)], x[min(best + 1, count - 1)])
    peak = optimize.minimize_scalar(lambda at: -float(function(np.array([at]))[0]), bounds=around, method="bounded")
    return float(max(y[best], -peak.fun))
