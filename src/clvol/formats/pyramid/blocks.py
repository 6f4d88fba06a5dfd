"""Minima and maxima of the function in blocks of cells, computed by bricks with margins."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.margin import reach_within
from clvol.formats._bounds import BLOCK, blocks_of
from clvol.spline.evaluator import DIRECT
from clvol.spline.field import coefficients_of
from clvol.spline.levels import FIXED, filter_at, gathered, runs_of
from clvol.spline.minmax import BLOCK as CELLS
from clvol.spline.minmax import Cell, MinMax
from clvol.volume.volume import Volume

__all__ = ["Bricks", "coarser", "outwards", "require_bounded"]

_LEFT_OUT = 5e-10  # share of the prefilter's weights outside a brick's margin
_APART = 1e-6  # difference between the functions of a brick and of the volume, relative to the range
_BYTES = 16  # per sample of a brick: samples and coefficients on the device, and the host's copies
_MIB = 1 << 20


def require_bounded(filter: Filter, boundary: Boundary) -> None:
    """Raise `OptionError` for hybrids, and for boundary rules that do not continue the samples: bricks cannot bound these."""
    if filter.magnified_by is not None:
        raise OptionError(f"bounds are of filters with one kernel; got the hybrid {filter.name!r}")
    if boundary.period is None or boundary.outside not in ("rule", "clamp"):
        raise OptionError(f"bounds need a boundary rule that continues the samples; got {boundary.name!r}")


def margin(filter: Filter) -> int:
    """Samples around a brick that its function depends on, up to `_LEFT_OUT`."""
    return max(reach_within(filter, _LEFT_OUT), filter.support) + filter.support + 1


class Bricks:
    """The bricks of one size of a volume of `size` samples along x, y and z, with edges of `edge` blocks.

    `read` returns samples at three slices, [z, y, x]. `require_bounded` accepts filter and boundary rule. There are `count` blocks
    along x, y and z.
    """

    def __init__(
        self,
        read: Callable[[tuple[slice, slice, slice]], NDArray[Any]],
        size: Sequence[int],
        filter: Filter,
        boundary: Boundary,
        edge: int,
        device: Device,
    ) -> None:
        self._read, self._size, self._filter, self._boundary, self._device = read, tuple(size), filter, boundary, device
        self.edge = edge
        self.count = blocks_of(size)
        # if the filter's cells lie between samples, blocks of `MinMax` begin where our blocks do
        halo = filter.support // 2 + 1 + 1
        self._margin = margin(filter)
        if filter.support % 2 == 0:
            self._margin += -(self._margin + halo - filter.support // 2 + 1) % CELLS

    @staticmethod
    def edge_for(filter: Filter, budget: int) -> int:
        """The largest edge of bricks that fits into a budget: 32, 16 or 8 blocks; `OptionError` if none does."""
        for edge in (32, 16, 8):
            needed = Bricks.bytes_of(filter, edge)
            if needed <= (budget if edge == 8 else budget // 2):  # the other half is for chunks that neighbours share
                return edge
        plain = filter_at(filter, 1)
        least, without = (-(-Bricks.bytes_of(row, edge) // _MIB) + FIXED // _MIB for row in (filter, plain))
        text = f"memory must hold a brick of {8 * BLOCK}³ samples and its margin, {least} MiB; got {(budget + FIXED) // _MIB} MiB"
        if without < least:
            text += f": that of {filter.name} is wide, filter {plain.name} needs {without} MiB"
        raise OptionError(text)

    @staticmethod
    def bytes_of(filter: Filter, edge: int) -> int:
        """Memory of a brick while it is computed."""
        return int(_BYTES * (edge * BLOCK + 2 * margin(filter) + 8) ** 3)

    def places(self) -> Iterator[tuple[tuple[int, int], ...]]:
        """The ranges of blocks of each brick, along x, y and z."""
        spans = [[(a, min(a + self.edge, n)) for a in range(0, n, self.edge)] for n in self.count]
        return ((x, y, z) for z, y, x in itertools.product(*spans[::-1]))

    def bounds(self, place: tuple[tuple[int, int], ...]) -> tuple[NDArray[np.float64], tuple[float, float]]:
        """Minima and maxima in the blocks of a brick, [z, y, x, 2], and of its samples.

        They bound the function as any device evaluates it, by bricks or not. They are not rounded yet: see `outwards`.
        """
        m = self._margin
        own = [(a * BLOCK, min(b * BLOCK + 1, n)) for (a, b), n in zip(place, self._size, strict=True)]
        taken = [self._places(a * BLOCK - m, b * BLOCK + m + 1, n) for (a, b), n in zip(place, self._size, strict=True)]
        runs = [runs_of(one) for one in taken]
        data = gathered(self._read, runs[::-1])
        for axis, (run, places) in enumerate(zip(runs[::-1], taken[::-1], strict=True)):
            at = np.searchsorted(np.concatenate([np.arange(*part) for part in run]), places)
            if not np.array_equal(at, np.arange(data.shape[axis])):
                data = np.take(data, at, axis)
        inside = data[tuple(slice(m, m + b - a) for a, b in own[::-1])]
        value_range = float(inside.min()), float(inside.max())
        volume = Volume(data)
        spread = _APART * (float(data.max()) - float(data.min()))
        with coefficients_of(volume, self._filter, as_boundary("mirror"), self._device) as coefficients:
            halo, stored = int(coefficients.extent[3]), coefficients.stored
            rows = [self._rows(2 - axis, *ends, halo) for axis, ends in enumerate(place[::-1])]  # along z, y and x
            begin, part = self._part(rows, coefficients.shape)
            minmax = MinMax(coefficients, DIRECT, part)
            try:
                x, y, z = minmax.blocks
                found = np.empty((z, y, x, 2), np.float32)
                self._device.buffers.download(minmax.buffer, found)
            finally:
                minmax.release()
        for axis in (2, 1, 0):
            found = _merged(found, axis, [(a - begin[axis], b - begin[axis]) for a, b in rows[axis]])
        values = np.asarray(stored.values(found) if not stored.identity else found, np.float64)
        pad = np.where((found != 0).any(-1), spread, 0.0)  # where all is zero, the function is exactly zero
        values[..., 0] -= pad
        values[..., 1] += pad
        return values, value_range

    def _places(self, first: int, last: int, n: int) -> NDArray[np.int64]:
        """The samples at indices `first` to `last`, of which those outside the volume are folded into it."""
        i = np.arange(first, last)
        return np.clip(i, 0, n - 1) if self._boundary.outside == "clamp" else self._boundary.folded(i, n)

    def _rows(self, axis: int, first: int, last: int, halo: int) -> list[tuple[int, int]]:
        """For each block, the range of blocks of `MinMax` (`CELLS` cells of coefficients) that covers it."""
        n, begin = self._size[axis], first * BLOCK - self._margin
        shift = halo - self._filter.support / 2 + 1  # block b of `MinMax` begins at position CELLS b - shift
        rows = []
        for block in range(first, last):
            low = block * BLOCK - begin - 0.5 * (block == 0)
            high = min((block + 1) * BLOCK, n - 1) - begin + 0.5 * ((block + 1) * BLOCK >= n - 1)
            a, b = max(math.floor((low + shift) / CELLS), 0), math.ceil((high + shift) / CELLS)
            rows.append((a, max(b, a + 1)))
        return rows

    def _part(self, rows: list[list[tuple[int, int]]], shape: tuple[int, ...]) -> tuple[list[int], tuple[Cell, Cell]]:
        """The first of these blocks along z, y and x, and the range of cells of all, for `MinMax`."""
        begin = [row[0][0] for row in rows]
        x, y, z = (CELLS * one for one in begin[::-1])
        i, j, k = (min(CELLS * row[-1][1], n - self._filter.support + 1) for row, n in zip(rows[::-1], shape[::-1], strict=True))
        return begin, ((x, y, z), (i, j, k))


def _merged(found: NDArray[Any], axis: int, rows: list[tuple[int, int]]) -> NDArray[Any]:
    """Bounds of ranges of blocks along an axis."""
    parts = (found[(slice(None),) * axis + (slice(a, b),)] for a, b in rows)
    return np.stack([np.stack([part[..., 0].min(axis), part[..., 1].max(axis)], -1) for part in parts], axis)


def outwards(values: NDArray[np.float64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Bounds in `dtype`: minima rounded down, maxima rounded up."""
    with np.errstate(over="ignore"):
        made = values.astype(dtype)
    low, high = made[..., 0], made[..., 1]
    made[..., 0] = np.where(low > values[..., 0], np.nextafter(low, dtype.type(-np.inf)), low)
    made[..., 1] = np.where(high < values[..., 1], np.nextafter(high, dtype.type(np.inf)), high)
    return made


def coarser(blocks: NDArray[Any]) -> NDArray[Any]:
    """Bounds of blocks twice as large along each axis."""
    for axis in range(3):
        odd = blocks.shape[axis] % 2
        if odd:
            last = blocks[(slice(None),) * axis + (slice(-1, None),)]
            blocks = np.concatenate([blocks, last], axis)
        even, other = (blocks[(slice(None),) * axis + (slice(k, None, 2),)] for k in (0, 1))
        blocks = np.stack([np.minimum(even[..., 0], other[..., 0]), np.maximum(even[..., 1], other[..., 1])], -1)
    return blocks
