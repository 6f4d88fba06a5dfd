"""Factors of opacity: piecewise linear in how steep the function is, or in how its isosurfaces bend, and constant outside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number
from clvol.base.errors import OptionError
from clvol.base.uniform import FLOAT, INT, Block, Values

__all__ = ["FACTORS", "MOST_POINTS", "Factors", "as_factors", "factors_block"]

Factors: TypeAlias = tuple[tuple[float, float], ...]
"""Points of a number and a factor, 0 to 1, in ascending order; two at one number make a jump, which has the later one's factor."""

MOST_POINTS = 16
FACTORS = Block(
    "factors_block",
    count=(INT, 2),  # by the gradient, and by curvature; 0: there is none
    start=(FLOAT, 2 * MOST_POINTS),
    base=(FLOAT, 2 * MOST_POINTS),
    slope=(FLOAT, 2 * MOST_POINTS),  # 0 behind the last point
)
_NARROWEST, _FARTHEST, _STEEPEST = 1e-38, 1e38, 3e38


def as_factors(what: str, points: Sequence[tuple[float, float]]) -> Factors:
    """Points, checked; `OptionError` if they are none."""
    rule = f"1 to {MOST_POINTS} pairs of a number from 0 on and a factor of opacity in 0..1, in ascending order"
    try:
        pairs = [(number(what, at, minimum=0), number(what, factor, minimum=0, maximum=1)) for at, factor in points]
    except (TypeError, ValueError):
        raise OptionError(f"{what} must be {rule}; got {points!r:.200}") from None
    places = [at for at, _ in pairs]
    if not 1 <= len(pairs) <= MOST_POINTS or places != sorted(places):
        raise OptionError(f"{what} must be {rule}; got {points!r:.200}")
    return tuple(pairs)


def factors_block(each: Sequence[tuple[Factors | None, float, int]]) -> Values:
    """The block for kernels: of the factors by gradients and by curvature, each with what its numbers are multiplied by there.

    That is a scale and then ``2**-exponent``, whose product may be out of range.
    """
    values: dict[str, Any] = {name: np.zeros((2, MOST_POINTS)) for name in ("start", "base", "slope")}
    counts = []
    for row, (points, scale, exponent) in enumerate(each):
        counts.append(len(points or ()))
        if points:
            at, factor = np.array(points).T
            with np.errstate(over="ignore", under="ignore"):
                start = _rounded_up(np.minimum(np.ldexp(at, -exponent) * scale, _FARTHEST))
            widths = np.diff(start)
            slopes = np.diff(factor) / np.maximum(widths, _NARROWEST)
            values["start"][row, : len(at)], values["base"][row, : len(at)] = start, factor
            values["slope"][row, : len(widths)] = np.clip(slopes, -_STEEPEST, _STEEPEST)
    return FACTORS(count=counts, **{name: rows.ravel() for name, rows in values.items()})


def _rounded_up(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """The first float32 numbers that are not less."""
    with np.errstate(under="ignore"):
        near = numbers.astype(np.float32)
    return np.where(near < numbers, np.nextafter(near, np.float32(np.inf)), near).astype(np.float64)
