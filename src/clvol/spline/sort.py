"""Unordered points, sorted by the brick of the volume that contains them: the host side of sort.cl."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.device.program import LANES
from clvol.spline.build import point_defines

if TYPE_CHECKING:
    from clvol.spline.coefficients import Coefficients

__all__ = ["Sorter", "scattered"]

_CACHED = 4 << 20  # bytes of coefficients that fit in caches, where order does not matter
_MIN_ROWS = 9  # rows of taps for each point, from which sorting pays
_MIN_VISITS = 2  # reads of each cache line of coefficients, from which sorting pays
_BRICKS = 1024  # most bricks of a volume
_PAIRS = 1024  # pairs of successive points that are checked
_FAR = 16  # samples between two points that share no cache lines


def scattered(coefficients: Coefficients, points: NDArray[Any], matrix: NDArray[np.float64] | None) -> bool:
    """Whether most successive points are too far apart to share cache lines, so that sorting pays.

    They are positions (N, d), which `matrix` maps to indices, or indices (d, N).
    """
    count, rows = points.shape[0 if matrix is not None else 1], coefficients.filter.support ** (coefficients.ndim - 1)
    nbytes = coefficients.nbytes
    if nbytes < _CACHED or rows < _MIN_ROWS or 64 * count * rows < _MIN_VISITS * nbytes:
        return False
    at = np.linspace(0, count - 2, _PAIRS).astype(np.int64)
    with np.errstate(over="ignore", invalid="ignore"):
        if matrix is None:
            apart = points[:, at + 1].astype(np.float64) - points[:, at]
            return bool((np.abs(apart).max(axis=0) > _FAR).mean() > 0.5)
        apart = (points[at + 1].astype(np.float64) - points[at]) @ matrix.T
        return bool((np.abs(apart).max(axis=1) > _FAR).mean() > 0.5)


class Sorter:
    """Sorts points by the brick of the volume that contains them, `room` at a time: `Limits.sorted_bytes` of them."""

    def __init__(self, coefficients: Coefficients, kind: type[np.generic], count: int, *, planar: bool) -> None:
        self._device, self._size = coefficients.device, coefficients.size
        device, last = self._device, self._size[:3].astype(np.int64) - 1
        bits = next(b for b in range(32) if math.prod(((last >> b) + 1).tolist()) <= _BRICKS)
        across, down, _ = (last >> bits) + 1
        self._grid = np.array([across, down, bits, 0], np.int32)
        self._items = 8 * device.units
        self._program = device.build(
            "spline/sort.cl",
            {
                "DIMENSIONS": coefficients.ndim,
                "LANES": LANES,
                "BRICKS": _BRICKS,
                "ON_GRID": 0,
                "SORTED": 0,
                "COORD_DOUBLE": int(device.has_double),
                **point_defines(kind, planar=planar, indices=planar),
            },
        )
        record = 4 * np.dtype(kind).itemsize
        self.room = max(1, min(count, device.limits.sorted_bytes // record))
        self._sorted = device.buffers.allocate(record * self.room)
        self._bricks = device.buffers.allocate(2 * self.room)
        self._counts = device.buffers.allocate(4 * self._items * _BRICKS)

    def sort(self, points: Any, planes: int, count: int, transform: Any) -> Any:
        """Sort a buffer of `count` points, at most `room`, into another buffer, which the next call overwrites."""
        device, number, apart = self._device, np.uint64(count), np.uint64(planes)
        launch = device.queue, (self._items,), (1,)
        with device.errors:
            self._program.kernel("count_bricks")(
                *launch, transform, self._size, self._grid, points, apart, number, self._bricks, self._counts
            )
        counts = np.empty((self._items, _BRICKS), np.uint32)
        device.buffers.download(self._counts, counts)
        starts = np.cumsum(counts.T).reshape(counts.T.shape) - counts.T
        begins = device.buffers.upload(np.ascontiguousarray(starts.T, dtype=np.uint32))
        with device.errors:
            self._program.kernel("sort_points")(*launch, points, apart, number, self._bricks, begins, self._sorted)
        return self._sorted
