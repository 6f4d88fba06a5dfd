"""The next size of a pyramid, tile by tile, streamed along z.

A least-squares sum takes some 114 samples along each axis, so blocks with margins on all sides would read several times what they
write. Instead a tile moves through the volume along z: planes are reduced along x and y as they are read, and kept until no sum
along z needs them. Each sum has the same terms in the same order as without tiles: there are no seams.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.base.rounding import in_kind
from clvol.device import Device
from clvol.spline.levels import FIXED, ORDER, Level, Rows, gathered
from clvol.spline.reduce import Sums, sum_along

__all__ = ["Reduction", "Tile"]

_MIB = 1 << 20


@dataclass(frozen=True)
class Tile:
    """A column of the next size: its first sample along x and y, and one past its last."""

    x: tuple[int, int]
    y: tuple[int, int]


class Reduction:
    """From one size to the next.

    `read` returns samples of the finer size at three slices, [z, y, x]; `sums` are along x, y and z, of type `kind`. Tiles
    consist of whole chunks, or shards, of `units` coarser samples along x, y and z; `deep` planes of the finer size are read at a
    time. A `budget` (bytes) too small for one column of chunks is an `OptionError`, whose message counts the bytes `beside`.
    """

    def __init__(
        self,
        read: Callable[[tuple[slice, slice, slice]], NDArray[Any]],
        finer: Level,
        coarser: Level,
        sums: tuple[Sums | None, Sums | None, Sums | None],
        dtype: np.dtype[Any],
        kind: type[np.generic],
        units: tuple[int, int, int],
        deep: int,
        budget: int,
        device: Device,
        cval: float = 0.0,
        beside: int = 0,
    ) -> None:
        self._read, self.finer, self.coarser, self._sums = read, finer, coarser, sums
        self._dtype, self._kind, self._device, self._cval = dtype, kind, device, cval
        self.units = units
        self.deep = deep
        self.edges = self._fitting(budget, FIXED + beside)

    def _fitting(self, budget: int, beside: int) -> tuple[int, int]:
        """The largest edges of tiles along x and y that fit into the budget."""
        x, y, _ = (min(-(-n // unit) * unit, n) for n, unit in zip(self.coarser.size, self.units, strict=True))
        while self._bytes(x, y) > budget:
            wide = [(n, axis) for axis, n in enumerate((x, y)) if n > self.units[axis]]
            if not wide:
                least = -(-(self._bytes(x, y) + beside) // _MIB)
                raise OptionError(
                    f"memory must hold at least one column of chunks, {least} MiB; got {(budget + beside) // _MIB} MiB"
                )
            edge, axis = max(wide)
            half = -(-edge // (2 * self.units[axis])) * self.units[axis]
            x, y = (half, y) if axis == 0 else (x, half)
        return x, y

    def _bytes(self, x: int, y: int) -> int:
        """The most memory that a tile of these edges takes."""
        rows = [self._widest(axis, edge) for axis, edge in enumerate((x, y))]
        item, wide = self._dtype.itemsize, np.dtype(self._kind).itemsize
        planes = self._widest(2, min(self.units[2], self.coarser.size[2]))
        raw = rows[0] * rows[1] * min(self.deep, self.finer.size[2])
        return (
            2 * item * raw  # as read, and a copy
            + wide * raw // 2  # reduced along one axis
            + wide * x * y * (2 * planes + 2 * self.deep)  # kept, and concatenated
            + (2 * wide + item) * x * y * self.units[2]
        )

    def _widest(self, axis: int, edge: int) -> int:
        """The most samples that `edge` rows take."""
        sums, n = self._sums[axis], self.coarser.size[axis]
        if sums is None:
            return edge
        return max(self._rows(axis, first, min(first + edge, n)).count for first in range(0, n, edge))

    def _rows(self, axis: int, first: int, last: int) -> Rows:
        """The rows of sums along an axis; they read what they sum up, and the samples that they stand for, which may be copied."""
        step = self.coarser.steps[axis]
        return Rows.of(self._sums[axis], first, last, (first * step, min(last * step, self.finer.size[axis])))

    def tiles(self) -> list[Tile]:
        """All tiles."""
        x, y = ([(a, min(a + edge, n)) for a in range(0, n, edge)] for edge, n in zip(self.edges, self.coarser.size, strict=False))
        return [Tile(i, j) for j, i in itertools.product(y, x)]

    def blocks(self) -> list[tuple[int, int]]:
        """Ranges of samples along z that are written at a time."""
        return [(a, min(a + self.units[2], self.coarser.size[2])) for a in range(0, self.coarser.size[2], self.units[2])]

    def run(
        self,
        tile: Tile,
        blocks: list[tuple[int, int]],
        copy: Callable[[tuple[slice, slice, slice], NDArray[Any]], object] | None = None,
    ) -> Iterator[tuple[tuple[slice, slice, slice], NDArray[Any]]]:
        """Slices and samples of the coarser size, block by block along z; each finer sample is read about once.

        `copy` is called with slices and samples of the finer size, as they are read.
        """
        rows = [self._rows(axis, *ends) for axis, ends in enumerate((tile.x, tile.y))]
        n = self.finer.size[2]
        kept: dict[int, NDArray[Any]] = {}
        begun = min((first for first, _ in blocks), default=0) * self.coarser.steps[2] // self.deep
        copied = set(range(begun))  # with the blocks before
        for first, last in blocks:
            along = self._rows(2, first, last)
            needed = {k for a, b in along.runs for k in range(a // self.deep, -(-b // self.deep))}
            own = set(range(-(-min(last * self.coarser.steps[2], n) // self.deep))) if copy is not None else set()
            for k in kept.keys() - needed:
                del kept[k]
            for k in sorted((own - copied) | (needed - kept.keys())):
                span = (k * self.deep, min((k + 1) * self.deep, n))
                read = gathered(self._read, ((span,), rows[1].runs, rows[0].runs))
                if copy is not None and k not in copied:
                    place, inside = self._own(tile, rows, span)
                    copy(place, read[inside])
                    copied.add(k)
                if k in needed:
                    kept[k] = self._flat(read, rows)
                del read
            yield self._made(kept, along, tile, rows)

    def _own(self, tile: Tile, rows: list[Rows], span: tuple[int, int]) -> tuple[tuple[slice, slice, slice], tuple[slice, ...]]:
        """Slices of the finer samples that the tile stands for: in the finer size, and in what was read."""
        place, inside = [slice(*span)], [slice(None)]
        for axis, ends in ((1, tile.y), (0, tile.x)):
            step = self.coarser.steps[axis]
            a, b = ends[0] * step, min(ends[1] * step, self.finer.size[axis])
            before = 0
            for low, high in rows[axis].runs:
                if low <= a and b <= high:
                    inside.append(slice(before + a - low, before + b - low))
                before += high - low
            place.append(slice(a, b))
        return (place[0], place[1], place[2]), tuple(inside)

    def _flat(self, read: NDArray[Any], rows: list[Rows]) -> NDArray[Any]:
        """Planes reduced along y and x."""
        sums = {axis: own for axis in ORDER if axis and (own := rows[2 - axis].sums) is not None}
        if not sums:
            return read.astype(self._kind)
        return sum_along(read, sums, self._kind, self._device, self._cval)

    def _made(
        self, kept: dict[int, NDArray[Any]], along: Rows, tile: Tile, rows: list[Rows]
    ) -> tuple[tuple[slice, slice, slice], NDArray[Any]]:
        planes = np.empty((along.count, rows[1].last - rows[1].first, rows[0].last - rows[0].first), self._kind)
        at = 0
        for low, high in along.runs:
            for k in range(low // self.deep, -(-high // self.deep)):
                a, b = max(low, k * self.deep), min(high, (k + 1) * self.deep)
                planes[at : at + b - a] = kept[k][a - k * self.deep : b - k * self.deep]
                at += b - a
        made = planes if along.sums is None else sum_along(planes, {0: along.sums}, self._kind, self._device, self._cval)
        return (slice(along.first, along.last), slice(*tile.y), slice(*tile.x)), in_kind(made, self._dtype)
