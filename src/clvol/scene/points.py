"""The points of a transfer function in one list, as JSON and editors have them."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from typing import Any

__all__ = ["points_of"]


def points_of(colors: Sequence[tuple[float, Any]], opacities: Sequence[tuple[float, float]]) -> list[list[Any]]:
    """Points of colour and opacity merged, ``[value, [r, g, b], opacity]``; two at one value are a jump."""
    shades, seen = _Ends(colors), _Ends(opacities)
    result = []
    for value in sorted({*shades.values, *seen.values}):
        before, after = (
            [value, [float(c) for c in shades.at(value, side)], float(min(1.0, max(0.0, seen.at(value, side))))] for side in (0, 1)
        )
        result += [before, after] if before != after else [after]
    return result


class _Ends:
    """Points of colour, or of opacity: the limits at each value from below and above."""

    def __init__(self, points: Sequence[tuple[float, Any]]) -> None:
        self._ends: dict[float, tuple[Any, Any]] = {}
        for value, part in points:
            self._ends[value] = self._ends.get(value, (part, part))[0], part
        self.values = sorted(self._ends)

    def at(self, value: float, side: int) -> Any:
        """The limit at a value from below (0) or above (1)."""
        if value in self._ends:
            return self._ends[value][side]
        i = bisect(self.values, value)
        if i in (0, len(self.values)):
            return self._ends[self.values[min(i, len(self.values) - 1)]][i > 0]
        a, b = self.values[i - 1 : i + 1]
        one, other = self._ends[a][1], self._ends[b][0]
        share = (value / 2 - a / 2) / (b / 2 - a / 2)
        if isinstance(one, tuple):
            return tuple(p + (q - p) * share for p, q in zip(one, other, strict=True))
        return one + (other - one) * share
