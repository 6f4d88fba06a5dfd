"""Where the bricks of a volume lie: their samples, margins and cells, and which brick owns a position; nothing is read here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clvol.spline.minmax import BLOCK

if TYPE_CHECKING:
    from clvol.bricks.source import Index
    from clvol.spline.levels import Runs

__all__ = ["ALIGNED", "NEIGHBOURS", "Brick", "BrickGrid"]

NEIGHBOURS = 3
"""Samples by which positions may be off, and that neighbours need for central differences."""

ALIGNED = 4
"""Cells for which it is kept together on which side of a value they are."""

_FAR = float(1 << 30)  # cells: more than any volume has


@dataclass(frozen=True)
class Brick:
    """Where a brick lies.

    Attributes
    ----------
    at : (int, int, int)
        Its number along x, y and z.
    low, high : tuple of float
        It owns the positions ``low <= position < high``, in samples; infinite at the volume's faces.
    first, last : (int, int, int)
        The samples that are read for it: ``first <= index < last``. Under the rule "wrap" they may lie outside the volume.
    """

    at: Index
    low: tuple[float, ...]
    high: tuple[float, ...]
    first: Index
    last: Index

    @property
    def size(self) -> Index:
        """Samples along x, y and z that are read for it."""
        x, y, z = (b - a for a, b in zip(self.first, self.last, strict=True))
        return x, y, z

    @property
    def samples(self) -> int:
        """How many samples are read for it."""
        return math.prod(self.size)


@dataclass(frozen=True)
class BrickGrid:
    """The bricks of a volume. Iteration is in the order in which samples are stored, x fastest.

    Attributes
    ----------
    size : tuple of int
        Samples of the volume along x, y and z.
    edge : int
        Samples along an edge of a brick, without margins.
    margin : int
        Samples around a brick that are read for it.
    wraps : bool
        Whether samples outside one face of the volume are those at the opposite one.
    support, scale : int
        Of the filter: taps, and cells to a sample.
    halo : int
        Coefficients that would be stored before the volume's first one.
    """

    size: tuple[int, ...]
    edge: int
    margin: int
    wraps: bool = False
    support: int = 2
    scale: int = 1
    halo: int = 0

    @cached_property
    def counts(self) -> Index:
        """Bricks along x, y and z."""
        x, y, z = (max(1, -(-n // self.edge)) for n in self.size)
        return x, y, z

    def __len__(self) -> int:
        return math.prod(self.counts)

    def __iter__(self) -> Iterator[Brick]:
        x, y, z = map(range, self.counts)
        return (self[i, j, k] for k in z for j in y for i in x)

    def __getitem__(self, at: Index) -> Brick:
        low, high, first, last = [], [], [], []
        for i, count, n in zip(at, self.counts, self.size, strict=True):
            a, b = i * self.edge, (i + 1) * self.edge
            low.append(-math.inf if i == 0 else a + self.offset)
            high.append(math.inf if i == count - 1 else b + self.offset)
            begin, end = (a - self.margin) // ALIGNED * ALIGNED, (min(b, n) if self.wraps else b) + self.margin
            first.append(begin if self.wraps else max(0, begin))
            last.append(end if self.wraps else min(n, end))
        return Brick(at, tuple(low), tuple(high), (first[0], first[1], first[2]), (last[0], last[1], last[2]))

    @property
    def offset(self) -> float:
        """How far after a sample bricks begin: cells of odd supports begin between samples."""
        return 0.0 if self.support % 2 == 0 else 0.5 / self.scale

    def plane(self, at: int) -> float:
        """The position of the plane before the bricks of number `at` along an axis."""
        return at * self.edge + self.offset

    def owners(self, positions: NDArray[np.float64], axis: int) -> NDArray[np.int64]:
        """The numbers along an axis (0 for x) of the bricks that own positions there."""
        return np.clip(np.floor((positions - self.offset) / self.edge), 0, self.counts[axis] - 1).astype(np.int64)

    def runs(self, brick: Brick) -> list[Runs]:
        """The samples of a brick along z, y and x as runs within the volume, from the first to before the second."""
        return [_runs(a, b, n) for a, b, n in zip(brick.first, brick.last, self.size, strict=True)][::-1]

    def cells(self, brick: Brick) -> tuple[Index, Index]:
        """The cells that a brick owns, from the first to before the second, numbered as their first taps in the whole volume."""
        left = self.support / 2 - 1
        ends = [
            tuple(round(min(max(end * self.scale, -_FAR), _FAR) - left) + self.halo for end in ends)
            for ends in (brick.low, brick.high)
        ]
        return ends[0], ends[1]  # type: ignore[return-value]  # three each

    def pyramid_cells(self, brick: Brick, stored: Sequence[int]) -> tuple[Index, Index]:
        """The cells of a brick's pyramid: its own, and some around them for neighbours; numbered within the brick.

        `stored` are the coefficients of the brick along x, y and z.
        """
        first, past = [], []
        for low, high, begin, n in zip(*self.cells(brick), brick.first, stored, strict=True):
            a = low - begin * self.scale - BLOCK * self.scale
            first.append(max(0, a // ALIGNED * ALIGNED))
            past.append(min(n - self.support + 1, high - begin * self.scale + BLOCK * self.scale))
        return (first[0], first[1], first[2]), (past[0], past[1], past[2])

    def seen(self, brick: Brick, more: int = 0) -> tuple[Index, Index]:
        """The samples between which rays look at values of a brick, and `more` beside: from the first to before the second."""
        beside = NEIGHBOURS + 1 + more  # rays look so far back
        x, y, z = (
            (math.floor(max(a - beside, 0)), math.ceil(min(b + beside + 1, n)))
            for a, b, n in zip(brick.low, brick.high, self.size, strict=True)
        )
        return (x[0], y[0], z[0]), (x[1], y[1], z[1])


def _runs(first: int, last: int, n: int) -> Runs:
    """Indices from `first` to before `last` of an axis that repeats with period `n`, as runs within it."""
    runs = []
    while first < last:
        begin = first % n
        some = min(last - first, n - begin)
        runs.append((begin, begin + some))
        first += some
    return tuple(runs)
