"""Points in no order, sorted by the brick of the volume that they lie in: the host side of order.cl."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.program import LANES

if TYPE_CHECKING:
    from clvol.spline.coefficients import Coefficients

__all__ = ["Sorter", "point_defines", "scattered"]

_CACHED = 4 << 20  # bytes of coefficients that caches hold: points in no order need not be sorted
_LEAST_ROWS = 9  # of taps, a point: ... nor for fewer; and not unless ...
_LEAST_VISITS = 2  # ... this many rows are read for each line of the cache that the coefficients would fill
_SORTED_BYTES = 32 << 20  # of points that are sorted at a time
_BRICKS = 1024  # that the volume is divided into, at most
_PAIRS, _FAR = 1024, 16  # of points that follow each other; samples that lie between them if these are in no order


def point_defines(kind: type[np.generic]) -> dict[str, str | int]:
    """What position.cl needs to know of points of this type."""
    return {"POINT": "double" if kind == np.float64 else "float", "POINT_BITS": 8 * np.dtype(kind).itemsize}


def scattered(held: Coefficients, points: NDArray[Any]) -> bool:
    """Whether points that follow each other mostly lie too far apart to share what a cache holds, and are worth sorting."""
    count, rows = points.shape[0], held.filter.support ** (held.volume.ndim - 1)
    if held.nbytes < _CACHED or rows < _LEAST_ROWS or 64 * count * rows < _LEAST_VISITS * held.nbytes:
        return False
    at = np.linspace(0, count - 2, _PAIRS).astype(np.int64)
    with np.errstate(over="ignore", invalid="ignore"):
        apart = (points[at + 1].astype(np.float64) - points[at]) @ held.volume.world_to_index_matrix.T
        return bool((np.abs(apart).max(axis=1) > _FAR).mean() > 0.5)


class Sorter:
    """Sorts points by the brick of the volume they lie in, `room` of them at a time."""

    def __init__(self, held: Coefficients, kind: type[np.generic], count: int) -> None:
        self._held = held
        device, last = held.device, held.size[:3].astype(np.int64) - 1
        bits = next(b for b in range(32) if math.prod(((last >> b) + 1).tolist()) <= _BRICKS)
        across, down, _ = (last >> bits) + 1
        self._grid = np.array([across, down, bits, 0], np.int32)
        self._items = 8 * device.units
        self._program = device.build(
            "spline/sort.cl",
            {
                "DIMENSIONS": held.volume.ndim,
                "LANES": LANES,
                "BRICKS": _BRICKS,
                "LATTICE": 0,
                "SORTED": 0,
                "COORD_DOUBLE": int(device.has_double),
                **point_defines(kind),
            },
        )
        record = 4 * np.dtype(kind).itemsize
        self.room = min(count, _SORTED_BYTES // record)
        self._sorted = device.allocate(record * self.room)
        self._bricks = device.allocate(2 * self.room)
        self._counts = device.allocate(4 * self._items * _BRICKS)

    def sort(self, points: Any, count: int, transform: Any) -> Any:
        """A buffer of `count` points, `room` at most, as another that each call overwrites."""
        device, number = self._held.device, np.uint64(count)
        launch = device.queue, (self._items,), (1,)
        self._program.kernel("count_bricks")(
            *launch, transform, self._held.size, self._grid, points, number, self._bricks, self._counts
        )
        counts = np.empty((self._items, _BRICKS), np.uint32)
        device.download(self._counts, counts)
        starts = np.cumsum(counts.T).reshape(counts.T.shape) - counts.T
        begins = device.upload(np.ascontiguousarray(starts.T, dtype=np.uint32))
        self._program.kernel("sort_points")(*launch, points, number, self._bricks, begins, self._sorted)
        return self._sorted
