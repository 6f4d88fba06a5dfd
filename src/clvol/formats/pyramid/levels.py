"""Which sizes a pyramid has, and what becomes of an axis from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from clvol.base.errors import OptionError
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.spline.reduce import Sums, least_squares

__all__ = ["FIXED", "METHODS", "ORDER", "Level", "Method", "filter_at", "levels_of", "require_reducible", "sums_for"]

Method: TypeAlias = Literal["least-squares", "average", "nearest"]
METHODS: tuple[Method, ...] = ("least-squares", "average", "nearest")

ORDER = (1, 2, 0)
"""In which [z, y, x] are reduced, one after the other, whatever part is made: sums round alike."""

FIXED = 96 << 20
"""Bytes of a budget that Zarr and the device take beside what is counted."""

_ALIKE = 1.5  # times the smallest spacing: axes whose samples lie further apart wait until the others do too


@dataclass(frozen=True)
class Level:
    """One size of a pyramid.

    Parameters
    ----------
    size : tuple of int
        Samples along x, y and z.
    steps : tuple of int
        Samples of the size before, 1 or 2, for one of its own, along x, y and z.
    factors : tuple of int
        Those of the first.
    """

    size: tuple[int, int, int]
    steps: tuple[int, int, int] = (1, 1, 1)
    factors: tuple[int, int, int] = (1, 1, 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """As an array has it."""
        return self.size[2], self.size[1], self.size[0]

    @property
    def offset(self) -> tuple[float, ...]:
        """Where the first sample lies, in samples of the first size: in the middle of those that it stands for."""
        return tuple((factor - 1) / 2 for factor in self.factors)


def levels_of(size: Sequence[int], spacing: Sequence[float], count: int | None, enough: int) -> list[Level]:
    """The sizes of a pyramid, the volume's own first: `count` of them, or until no axis has more than `enough` samples.

    Each halves those axes whose samples lie nearest to each other: slices far apart are first reached by the others.
    """
    x, y, z = size
    found = [Level((x, y, z))]
    while (len(found) < count) if count is not None else (max(found[-1].size) > enough):
        last = found[-1]
        apart = [s * f for s, f in zip(spacing, last.factors, strict=True)]
        nearest = min((s for s, n in zip(apart, last.size, strict=True) if n > 1), default=0.0)
        steps = [2 if n > 1 and s <= _ALIKE * nearest else 1 for s, n in zip(apart, last.size, strict=True)]
        if max(steps) == 1:
            break
        sizes = [-(-n // step) for n, step in zip(last.size, steps, strict=True)]
        factors = [f * step for f, step in zip(last.factors, steps, strict=True)]
        found.append(Level(_three(sizes), _three(steps), _three(factors)))
    return found


def _three(numbers: Sequence[int]) -> tuple[int, int, int]:
    x, y, z = numbers
    return x, y, z


def filter_at(filter: Filter, number: int) -> Filter:
    """That of a size: smoothed the first, interpolating those after it."""
    return filter if number == 0 or not filter.smoothing else filter.smoothed(0.0)


def require_reducible(method: Method, filter: Filter, boundary: Boundary) -> None:
    """Raise `OptionError` for a function to which no spline of fewer samples is nearest."""
    if method == "least-squares" and (filter.magnified_by is not None or (filter.prefilter and boundary.period is None)):
        raise OptionError(
            f"least-squares reduction takes a filter with one kernel, and a boundary rule that continues the samples; "
            f"got {filter.name!r} and {boundary.name!r}"
        )


def sums_for(method: Method, filter: Filter, boundary: Boundary, step: int, n: int, double: bool) -> Sums | None:
    """What becomes of an axis of `n` samples; None where it stays. `filter` is what it is along this axis."""
    if step == 1:
        return None
    m = -(-n // step)
    if method == "least-squares":
        return least_squares(filter, (step - 1) / 2, float(step), m, n, boundary, double)
    first = step * np.arange(m)
    if method == "nearest":
        return Sums(n, first[:, None].astype(np.int32), np.ones((m, 1)))
    places = np.minimum(first[:, None] + np.arange(step), n - 1).astype(np.int32)  # the last of an odd number stands alone
    return Sums(n, places, np.full(places.shape, 1 / step))
