"""Which sizes a pyramid has, and what becomes of parts of an axis from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import Boundary
from clvol.filter import Filter
from clvol.spline.reduce import Sums, least_squares

__all__ = ["FIXED", "METHODS", "Level", "Method", "Rows", "gathered", "levels_of", "runs_of", "sums_for"]

Method: TypeAlias = Literal["least-squares", "average", "nearest"]
METHODS: tuple[Method, ...] = ("least-squares", "average", "nearest")

FIXED = 96 << 20
"""Bytes of a budget that Zarr and the device take beside what is counted."""

Runs: TypeAlias = tuple[tuple[int, int], ...]
"""Samples of an axis, those from one to before another, and from a third on."""

_ALIKE = 1.5  # times the smallest spacing: axes whose samples lie further apart wait until the others do too
_GAP = 32  # samples that are read with those on both sides


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


@dataclass(frozen=True, eq=False)
class Rows:
    """Some rows of sums along an axis, or of an axis that stays, and what they are sums of.

    Attributes
    ----------
    first, last : int
        Of the rows.
    runs : Runs
        The samples that they take.
    sums : Sums or None
        Of these alone, brought together.
    """

    first: int
    last: int
    runs: Runs
    sums: Sums | None

    @classmethod
    def of(cls, sums: Sums | None, first: int, last: int) -> Rows:
        """Those from `first` to before `last`; their runs hold all samples that they stand for."""
        if sums is None:
            return cls(first, last, ((first, last),), None)
        places, step = sums.places[first:last], -(-sums.n // len(sums.places))
        runs = runs_of(np.concatenate([places[places < sums.n], np.arange(first * step, min(last * step, sums.n))]))
        own = np.concatenate([np.arange(a, b) for a, b in runs])
        local = np.where(places < sums.n, np.searchsorted(own, places), own.size).astype(np.int32)
        return cls(first, last, runs, Sums(own.size, local, sums.weights[first:last]))

    @property
    def count(self) -> int:
        """Samples that are taken."""
        return sum(b - a for a, b in self.runs)


def runs_of(places: NDArray[Any]) -> Runs:
    """The samples at some places, and those in small gaps between them."""
    own = np.unique(places)
    ends = np.flatnonzero(np.diff(own) > _GAP)
    firsts, lasts = own[np.concatenate([[0], ends + 1])], own[np.concatenate([ends, [own.size - 1]])]
    return tuple((int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True))


def gathered(read: Callable[[tuple[slice, slice, slice]], NDArray[Any]], runs: Sequence[Runs]) -> NDArray[Any]:
    """The samples in runs along z, y and x, as one array."""
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
