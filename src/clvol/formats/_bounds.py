"""What `clvol.pyramid` stores beside OME-Zarr: minima and maxima of the function, and metadata."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.bricks.source import Index
from clvol.formats._files import chunks_in
from clvol.volume.evenly import places_of

__all__ = ["BLOCK", "KEY", "SAMPLES", "VERSION", "StoredBounds", "blocks_of", "bounds_of", "samples_of"]

KEY = "clvol"
"""The attribute of the image's group with the metadata, and the name of the group with the bounds."""

SAMPLES = f"{KEY}/samples"
"""The array of evenly spaced samples, from which cameras are fitted."""

VERSION = 1
BLOCK = 8
"""Cells along an edge of the finest blocks."""

_MAX_BLOCKS = 1 << 15  # to read for one answer; for more, coarser blocks are read
_CACHED = 1 << 6  # chunks of blocks, 256 KiB each


def blocks_of(size: Sequence[int], block: int = BLOCK) -> tuple[int, ...]:
    """Blocks of cells along axes of `size` samples."""
    return tuple(max(1, -(-(n - 1) // block)) for n in size)


class StoredBounds:
    """Bounds in a store, read on demand and cached: `arrays` [z, y, x, 2] of minima and maxima in blocks of `block` cells and more.

    Each array has blocks twice as large as the one before. If `filled`, missing chunks read as zeros, so that a chunk of zeros may
    be missing. Arrays that do not fit the volume, of `size` samples along x, y and z, are a `FormatError`.
    """

    def __init__(
        self,
        arrays: Sequence[Any],
        size: Sequence[int],
        filter: str,
        boundary: str,
        value_range: tuple[float, float],
        block: int = BLOCK,
        filled: bool = False,
    ) -> None:
        for number, array in enumerate(arrays):
            expected = (*blocks_of(size, block << number)[::-1], 2)
            if tuple(array.shape) != expected or array.dtype.kind != "f":
                raise FormatError(
                    f"bounds must be floating and of shape {expected} for {' × '.join(map(str, size))} samples; "
                    f"got {array.dtype} of shape {tuple(array.shape)}"
                )
        low, high = value_range
        if not arrays or not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise FormatError(f"bounds must have a range of values, and blocks; got {value_range} and {len(arrays)} sizes")
        self.filter, self.boundary = filter, boundary
        self.value_range = (float(low), float(high))
        self._arrays, self._size, self._block, self._filled = tuple(arrays), tuple(size), block, filled
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[int, ...], NDArray[Any]] = OrderedDict()

    def __repr__(self) -> str:
        return f"<bounds of {self.filter}, {self.boundary}: samples of {self.value_range[0]:g} to {self.value_range[1]:g}>"

    def within(self, low: Index, high: Index) -> tuple[float, float]:
        """Bounds of the function in the cells between samples `low` and `high`; infinite where a chunk of bounds is missing.

        The outer half cells of the domain belong to the cells beside them.
        """
        for number, array in enumerate(self._arrays):
            edge = self._block << number
            box = []
            for begin, end, n in zip(low, high, array.shape[2::-1], strict=True):
                first = min(max(0, begin // edge), n - 1)
                box.append((first, max(first + 1, min(n, -(-end // edge)))))
            if math.prod(last - first for first, last in box) <= _MAX_BLOCKS or number == len(self._arrays) - 1:
                break
        least, most = math.inf, -math.inf
        for part in self._parts(number, box[::-1]):
            a, b = float(part[..., 0].min()), float(part[..., 1].max())
            least, most = (-math.inf, math.inf) if math.isnan(a) or math.isnan(b) else (min(least, a), max(most, b))
        return least, most

    def _parts(self, number: int, box: Sequence[tuple[int, int]]) -> list[NDArray[Any]]:
        """The blocks in a box, chunk by chunk: [z, y, x, 2] each."""
        array = self._arrays[number]
        chunks = (getattr(array, "chunks", None) or array.shape)[:3]
        found = []
        for at, wanted in chunks_in([range(*ends) for ends in box], chunks):
            first = [i * c for i, c in zip(at, chunks, strict=True)]
            with self._lock:
                part = self._kept.get((number, *at))
            if part is None:
                part = np.asarray(array[tuple(slice(f, f + c) for f, c in zip(first, chunks, strict=True))])
                if self._filled and not part.any():
                    part = np.full_like(part, np.nan)
                with self._lock:
                    self._kept[number, *at] = part
                    while len(self._kept) > _CACHED:
                        self._kept.popitem(last=False)
            found.append(part[tuple(slice(one.start - f, one.stop - f) for one, f in zip(wanted, first, strict=True))])
        return found


def samples_of(group: Any, shape: Sequence[int], wrapped: Any) -> Any:
    """The evenly spaced samples of an image of `shape`, [z, y, x], if they are kept; `wrapped` as of `bounds_of`."""
    if SAMPLES not in group:
        return None
    array, expected = group[SAMPLES], tuple(len(range(*at.indices(n))) for at, n in zip(places_of(shape), shape, strict=True))
    if getattr(array, "shape", None) != expected:
        raise FormatError(f"{SAMPLES} must hold evenly spaced samples of shape {expected}; got {array}")
    return wrapped(array)


def bounds_of(group: Any, about: Mapping[str, Any], path: str, size: Sequence[int], wrapped: Any) -> StoredBounds | None:
    """The bounds of one level of an image that `clvol.pyramid` wrote, else None; `wrapped` adds names to an array's errors."""
    if about.get("version") != VERSION:
        return None
    one = next((level for level in about.get("levels", ()) if level.get("path") == path), None)
    if one is None or not one.get("bounds"):
        return None
    try:
        stored = [group[name] for name in one["bounds"]]
        low, high = one["value_range"]
        filled = any(array.fill_value is not None and not np.isnan(array.fill_value) for array in stored)
        about_them = str(one["filter"]), str(one["boundary"]), (low, high), int(one["block"])
        return StoredBounds([wrapped(array) for array in stored], size, *about_them, filled)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"the bounds of {path} must be what the attribute {KEY!r} says: {error!r}") from error
