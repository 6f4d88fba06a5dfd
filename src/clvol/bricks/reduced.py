"""Volumes larger than memory at fewer samples: sums along their axes, computed for the parts that are read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.spline.levels import GAP, Rows, gathered
from clvol.spline.reduce import in_order, sum_along
from clvol.volume.stored import is_far

if TYPE_CHECKING:
    from clvol.bricks.source import Box, LazyVolume
    from clvol.device import Device
    from clvol.spline.reduce import Sums

__all__ = ["Reduced"]

_EDGES = (512, 256, 128, 64, 32, 16, 8)  # sums along an edge of a block, longest first
_SLAB = 1 << 24  # samples that are read at a time, roughly
_MIB = 1 << 20


class Reduced:
    """Sums along the axes of a volume in place of its samples, as data of a `LazyVolume`.

    Each sum has the same terms in the same order as for the whole volume at once, so it is the same to the last bit.

    Parameters
    ----------
    volume : LazyVolume
    sums : mapping from axes, 0 for z, to Sums
    kind : type
        np.float32 or np.float64, in which they are computed.
    device : Device
    outside : float
        The value of samples where a boundary rule has none.
    read : callable
        Reads the volume, as `LazyVolume.at` does.
    beside : int
        Bytes that reading takes, beside the samples.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
    """

    def __init__(
        self,
        volume: LazyVolume,
        sums: Mapping[int, Sums],
        kind: type[np.generic],
        device: Device,
        outside: float,
        read: Callable[[Box], NDArray[Any]],
        beside: int,
    ) -> None:
        self._volume, self._sums, self._device, self._outside = volume, dict(sums), device, outside
        self._far = kind == np.float64 and is_far(*map(float, volume.limits))
        self._order, self._read, self._beside = list(in_order(sums)), read, beside
        self._counted: dict[int, list[int]] = {}
        self.shape = tuple(len(sums[axis].places) if axis in sums else n for axis, n in enumerate(volume.shape))
        self.dtype = np.dtype(kind)

    def __getitem__(self, index: tuple[slice, ...]) -> NDArray[Any]:
        rows = self._rows(index)
        sums = {axis: own for axis, row in enumerate(rows) if (own := row.sums) is not None}
        if not self._order:
            return np.ascontiguousarray(gathered(self._read, [row.runs for row in rows]), self.dtype)
        *before, last = self._order
        slabs = []  # along the last axis to be summed, all other axes summed already
        for first, past in rows[last].runs:
            for low in range(first, past, self._deep(rows, last)):
                runs = [row.runs for row in rows]
                runs[last] = ((low, min(low + self._deep(rows, last), past)),)
                data = gathered(self._read, runs)
                others = {axis: sums[axis] for axis in before}
                slabs.append(self._summed(data, others) if before else np.ascontiguousarray(data, self.dtype))
        together = slabs[0] if len(slabs) == 1 else np.concatenate(slabs, last)
        del slabs
        return self._summed(together, {last: sums[last]})

    def _summed(self, data: NDArray[Any], sums: Mapping[int, Sums]) -> NDArray[Any]:
        return sum_along(data, sums, self.dtype.type, self._device, self._outside, far=self._far)

    @staticmethod
    def _deep(rows: Sequence[Rows], last: int) -> int:
        """Samples of a slab along the last axis to be summed."""
        return max(1, _SLAB // math.prod(row.count for axis, row in enumerate(rows) if axis != last))

    def _rows(self, index: Sequence[slice]) -> list[Rows]:
        return [Rows.of(self._sums.get(axis), part.start, part.stop) for axis, part in enumerate(index)]

    def blocks(self, budget: int, beside: int = 0) -> Iterator[tuple[tuple[slice, ...], int, float]]:
        """All of it in blocks, each with the bytes that it takes and the fraction done after it.

        Blocks are the largest that can be computed within a budget of bytes, with `beside` bytes to spare if that is possible.

        Raises
        ------
        OptionError
            The budget does not hold the smallest block.
        """
        fits = (edge for room in (budget - beside, budget) for edge in _EDGES if self._fits(edge, room))
        edge = next(fits, None)
        if edge is None:
            least = -(-self._bytes(_EDGES[-1]) // _MIB)
            raise OptionError(
                f"memory must be at least {least} MiB, which a block of {_EDGES[-1]}³ takes; got {budget // _MIB} MiB"
            )
        lines = [[slice(a, min(a + edge, n)) for a in range(0, n, edge)] for n in self.shape]
        count, nbytes = math.prod(map(len, lines)), self._bytes(edge)
        return ((block, nbytes, done / count) for done, block in enumerate(itertools.product(*lines), 1))

    def _fits(self, edge: int, room: int) -> bool:
        """Whether a block with `edge` sums along its edges can be computed in `room` bytes, and in buffers of the device."""
        return self._bytes(edge) <= room and self.dtype.itemsize * max(self._counts(edge)) <= self._device.largest

    def _counts(self, edge: int) -> list[int]:
        """How many numbers there are, at most: of a slab, as read and after each axis but the last; of all slabs."""
        if edge not in self._counted:
            self._counted[edge] = self._count(edge)
        return self._counted[edge]

    def _count(self, edge: int) -> list[int]:
        now = []
        for axis, n in enumerate(self.shape):
            parts = range(0, n, edge)
            now.append(max(Rows.of(self._sums.get(axis), a, min(a + edge, n)).count for a in parts))
        return self._steps(now, [min(edge, n) for n in self.shape])

    def _steps(self, now: list[int], shape: Sequence[int]) -> list[int]:
        """The same, from the samples `now` that a part takes along each axis."""
        if not self._order:
            return [math.prod(now)]
        *before, last = self._order
        whole = now[last]
        now[last] = min(whole, max(1, _SLAB * whole // math.prod(now)))
        counts = [math.prod(now)]
        for axis in before:
            now[axis] = shape[axis]
            counts.append(math.prod(now))
        return [*counts, math.prod(now) // now[last] * whole]

    def _bytes(self, edge: int) -> int:
        return self._bytes_of(self._counts(edge), math.prod(min(edge, n) for n in self.shape))

    def _bytes_of(self, counts: Sequence[int], result: int) -> int:
        """Bytes of a part, at most: a slab as read and from one axis to the next, all slabs twice, and the result twice."""
        *slab, kept = counts
        own, wide = self._volume.dtype.itemsize, self.dtype.itemsize
        if not slab:
            return 2 * own * kept + wide * kept + self._beside
        steps = [own * slab[0] + wide * (before + after) for before, after in itertools.pairwise(slab)]
        return max(2 * own * slab[0] + self._beside, *steps, wide * slab[-1]) + wide * (2 * kept + 2 * result)

    def taken(self, shape: Sequence[int]) -> int:
        """Bytes that reading a part of this shape takes, its own included, wherever it lies.

        There must be as many sums as samples along each axis.
        """
        now = [
            min(n, count + (self._sums[axis].places.shape[1] + GAP if axis in self._sums else 0))
            for axis, (count, n) in enumerate(zip(shape, self.shape, strict=True))
        ]
        return self._bytes_of(self._steps(now, shape), math.prod(shape))
