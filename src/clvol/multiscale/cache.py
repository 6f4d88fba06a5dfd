"""Chunks that were unpacked are kept for neighbours whose margins reach into them."""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["ChunkCache"]


class ChunkCache:
    """Reads parts of an array of Zarr; each chunk once, if what comes in between fits.

    Parameters
    ----------
    array : zarr.Array
        With three axes.
    nbytes : int
        To keep, at most.
    """

    def __init__(self, array: Any, nbytes: int) -> None:
        self._array, self._edges = array, tuple(array.chunks)
        self._room = nbytes // (math.prod(self._edges) * array.dtype.itemsize)
        self._kept: OrderedDict[tuple[int, ...], NDArray[Any]] = OrderedDict()

    def __call__(self, at: tuple[slice, slice, slice]) -> NDArray[Any]:
        """The samples at three slices, [z, y, x]."""
        spans = [range(one.start // edge, -(-one.stop // edge)) for one, edge in zip(at, self._edges, strict=True)]
        if math.prod(map(len, spans)) > self._room:
            return np.asarray(self._array[at])
        wanted = list(itertools.product(*spans))
        missing = [place for place in wanted if place not in self._kept]
        if missing:
            self._load([range(min(places), max(places) + 1) for places in zip(*missing, strict=True)])
        result = np.empty([one.stop - one.start for one in at], self._array.dtype)
        for place in wanted:
            chunk = self._kept[place]
            self._kept.move_to_end(place)
            into, part = [], []
            for one, k, edge, n in zip(at, place, self._edges, chunk.shape, strict=True):
                first, last = max(one.start, k * edge), min(one.stop, k * edge + n)
                into.append(slice(first - one.start, last - one.start))
                part.append(slice(first - k * edge, last - k * edge))
            result[tuple(into)] = chunk[tuple(part)]
        while len(self._kept) > self._room:
            self._kept.popitem(last=False)
        return result

    def _load(self, spans: list[range]) -> None:
        """All chunks of a box, unpacked side by side."""
        box = [slice(span[0] * edge, (span[-1] + 1) * edge) for span, edge in zip(spans, self._edges, strict=True)]
        read = np.asarray(self._array[tuple(box)])
        for place in itertools.product(*spans):
            inside = tuple(
                slice((k - span[0]) * edge, (k - span[0] + 1) * edge)
                for k, span, edge in zip(place, spans, self._edges, strict=True)
            )
            self._kept[place] = np.ascontiguousarray(read[inside])
