"""How many pixels, and how long steps, the pictures of a drag have: as many and as short as their time allows.

A picture takes ``a + b · pixels``, and longer steps take less. Rays that lie far apart share less, so that the time hardly falls
below some 300 × 250 pixels: `a` is taken as the time of so many pixels, whatever is drawn. One number is left to be known, which
each picture tells; the first one of a drag goes by the picture at rest.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Hashable
from typing import TypeAlias

__all__ = ["LEAST_WIDTH", "Pace"]

Size: TypeAlias = tuple[int, int]

LEAST_WIDTH = 200  # pixels; a pane may be narrower
_GOOD_WIDTH = 320  # pixels, below which steps become longer
_FIRST = 4  # times the finest step: that of the first picture, of which nothing is known
_CONSTANT = 300 * 250  # pixels that take as long as what does not depend on their number
_SHORTER = 0.8  # the power of the number of samples on a ray by which its time grows
_KEPT = 4  # pictures that count, but for the longest, which may have waited for other programs
_WORTH = 2.0  # a shorter step must leave this many times as many pixels as are good, or steps would alternate
_NEAR = 0.8, 1.25  # as many pixels, relative to those of the last picture, are as many: or edges would shimmer
_EDGES = 2.0  # the time of a picture with smooth edges, relative to one ray a pixel


class Pace:
    """Of one session; times are kept for each kind of picture, such as a mode with a filter."""

    def __init__(self) -> None:
        self._units: dict[Hashable, deque[float]] = {}  # the latest last
        self._last: dict[Hashable, tuple[float, int]] = {}  # the step of the last picture, and its pixels

    def choose(self, kind: Hashable, whole: Size, finest: float, longest: float, seconds: float) -> tuple[Size, float]:
        """Size and step of a picture that takes about `seconds`.

        It is no larger than `whole`, and its step between that of the picture at rest and the longest that is of use.
        """
        most, least, good = whole[0] * whole[1], _pixels(whole, LEAST_WIDTH), _pixels(whole, _GOOD_WIDTH)
        known = self._units.get(kind)
        if not known:
            return _size(whole, good), min(_FIRST * finest, max(longest, finest))
        unit, (step, before) = statistics.fmean(sorted(known)[: max(1, len(known) - 1)]), self._last.get(kind, (finest, 0))
        step = min(max(step, finest), max(longest, finest))
        while step / 2 >= finest and _pixels_in(seconds, unit, step / 2) >= min(most, _WORTH * good):
            step /= 2
        while 2 * step <= longest and _pixels_in(seconds, unit, step) < _NEAR[0] * good:
            step *= 2
        pixels = min(max(_pixels_in(seconds, unit, step), least), most)
        if before and _NEAR[0] <= pixels / before <= _NEAR[1]:
            pixels = min(before, most)
        return _size(whole, pixels), step

    def took(self, kind: Hashable, size: Size, step: float, seconds: float) -> None:
        """A picture of a drag was drawn."""
        known = self._units.setdefault(kind, deque(maxlen=_KEPT))
        if len(known) == 1 and kind not in self._last:
            known.clear()  # a guess, from the picture at rest
        known.append(_unit(size, step, seconds))
        self._last[kind] = step, size[0] * size[1]

    def rested(self, kind: Hashable, size: Size, step: float, seconds: float) -> None:
        """A picture at rest was drawn; it counts until one of a drag is."""
        if kind not in self._last:
            self._units[kind] = deque([_unit(size, step, seconds / _EDGES)], maxlen=_KEPT)


def _unit(size: Size, step: float, seconds: float) -> float:
    """Seconds for a pixel of a step of one voxel."""
    return float(seconds / (size[0] * size[1] + _CONSTANT) * step**_SHORTER)


def _pixels_in(seconds: float, unit: float, step: float) -> float:
    return float(seconds / (unit * step**-_SHORTER) - _CONSTANT)


def _pixels(whole: Size, wide: int) -> int:
    """Pixels of a picture so wide."""
    width = min(wide, whole[0])
    return width * max(1, round(width * whole[1] / whole[0]))


def _size(whole: Size, pixels: float) -> Size:
    scale = min(1.0, math.sqrt(pixels / (whole[0] * whole[1])))
    return max(1, round(scale * whole[0])), max(1, round(scale * whole[1]))
