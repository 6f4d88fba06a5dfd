"""The sizes of a pyramid, how an axis is reduced from one to the next, and the samples that a part of a size reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.spline.reduce import Sums, least_squares

if TYPE_CHECKING:
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter

__all__ = [
    "FIXED",
    "GAP",
    "METHODS",
    "ORDER",
    "Level",
    "Method",
    "Rows",
    "Runs",
    "filter_at",
    "gathered",
    "levels_of",
    "require_reducible",
    "runs_of",
    "sums_for",
]

Method: TypeAlias = Literal["least-squares", "average", "nearest"]
METHODS: tuple[Method, ...] = ("least-squares", "average", "nearest")

ORDER = (1, 2, 0)
"""Axes of [z, y, x] in the order of their reduction, the same for every part: sums round alike."""

FIXED = 96 << 20
"""Bytes of the memory limit for what Zarr and the device take uncounted."""

Runs: TypeAlias = tuple[tuple[int, int], ...]
"""Ranges of an axis, as (first, past the last)."""

GAP = 32  # samples; smaller gaps are read too

_ALIKE = 1.5  # times the smallest spacing; axes with a larger one are not reduced yet


@dataclass(frozen=True)
class Level:
    """One size of a pyramid, along x, y and z."""

    size: tuple[int, int, int]
    steps: tuple[int, int, int] = (1, 1, 1)  # samples of the size before per sample, 1 or 2
    factors: tuple[int, int, int] = (1, 1, 1)  # samples of the first size per sample

    @property
    def shape(self) -> tuple[int, int, int]:
        """Along z, y and x."""
        return self.size[2], self.size[1], self.size[0]

    @property
    def offset(self) -> tuple[float, ...]:
        """Position of the first sample, in samples of the first size: the centre of those that it stands for."""
        return tuple((factor - 1) / 2 for factor in self.factors)


def levels_of(size: Sequence[int], spacing: Sequence[float], count: int | None, enough: int) -> list[Level]:
    """The sizes of a pyramid, the volume's first: `count` of them, or until no axis has more than `enough` samples.

    Each halves the axes with the smallest spacing, so that anisotropic volumes become isotropic first.
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
    """The filter of a size: smoothing for the first, interpolating for the others."""
    return filter if number == 0 or not filter.smoothing else filter.smoothed(0.0)


def require_reducible(method: Method, filter: Filter, boundary: Boundary) -> None:
    """Raise `OptionError` for a function without a nearest spline of fewer samples."""
    if method == "least-squares" and (filter.magnified_by is not None or (filter.prefilter and boundary.period is None)):
        raise OptionError(
            f"least-squares reduction takes a filter with one kernel, and a boundary rule that continues the samples; "
            f"got {filter.name!r} and {boundary.name!r}"
        )


def sums_for(method: Method, filter: Filter, boundary: Boundary, step: int, n: int, double: bool) -> Sums | None:
    """The sums that reduce an axis of `n` samples; None if it stays. `filter` is the one along this axis."""
    if step == 1:
        return None
    m = -(-n // step)
    if method == "least-squares":
        return least_squares(filter, (step - 1) / 2, float(step), m, n, boundary, double)
    first = step * np.arange(m)
    if method == "nearest":
        return Sums(n, first[:, None].astype(np.int32), np.ones((m, 1)))
    places = np.minimum(first[:, None] + np.arange(step), n - 1).astype(np.int32)  # of an odd number, the last stands alone
    return Sums(n, places, np.full(places.shape, 1 / step))


@dataclass(frozen=True, eq=False)
class Rows:
    """Some rows of the sums along an axis, or of an unchanged axis, and the samples that they read."""

    first: int
    last: int  # excluded
    runs: Runs
    sums: Sums | None  # the same sums over these samples, concatenated; None for an unchanged axis

    @classmethod
    def of(cls, sums: Sums | None, first: int, last: int, beside: tuple[int, int] = (0, 0)) -> Rows:
        """The rows from `first` to before `last`; their runs also include the range `beside`."""
        if sums is None:
            return cls(first, last, ((first, last),), None)
        places = sums.places[first:last]
        within = np.concatenate([places[places < sums.n], np.arange(*beside)])
        runs = runs_of(within if within.size else np.zeros(1, np.int32))  # sums of just the constant read any sample
        taken = np.concatenate([np.arange(a, b) for a, b in runs])
        local = np.where(places < sums.n, np.searchsorted(taken, places), taken.size).astype(np.int32)
        return cls(first, last, runs, Sums(taken.size, local, sums.weights[first:last]))

    @property
    def count(self) -> int:
        """The number of samples read."""
        return sum(b - a for a, b in self.runs)


def runs_of(places: NDArray[Any]) -> Runs:
    """The ranges that contain `places`, and small gaps between them."""
    sorted_places = np.unique(places)
    ends = np.flatnonzero(np.diff(sorted_places) > GAP)
    firsts, lasts = sorted_places[np.concatenate([[0], ends + 1])], sorted_places[np.append(ends, sorted_places.size - 1)]
    return tuple((int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True))


def gathered(read: Callable[[tuple[slice, slice, slice]], NDArray[Any]], runs: Sequence[Runs]) -> NDArray[Any]:
    """Read the samples in runs along z, y and x into one array."""
    z, y, x = runs
    parts = [
        [
            np.concatenate([read((slice(*k), slice(*j), slice(*i))) for i in x], 2)
            if len(x) > 1
            else read((slice(*k), slice(*j), slice(*x[0])))
            for j in y
        ]
        for k in z
    ]
    rows = [part[0] if len(part) == 1 else np.concatenate(part, 1) for part in parts]
    return rows[0] if len(rows) == 1 else np.concatenate(rows, 0)
