"""Chunks that were unpacked are kept for others that reach into them: bricks with margins, and bricks smaller than chunks."""

from __future__ import annotations

import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["UNPACKING", "Chunks", "Place", "Room", "lines_of", "stored_in_one"]

Place: TypeAlias = tuple[int, ...]
"""Which chunk it is, along z, y and x."""
_Box: TypeAlias = tuple[range, ...]
_Part: TypeAlias = tuple[slice, ...]

UNPACKING = 4
"""Times its samples that a chunk takes while it is unpacked, at most: as it is stored, in pieces, these put together, as samples.

As was measured for what packs worst, gzip in Zarr of what cannot be packed; others take two to three times.
"""

_TOGETHER = 64 << 20  # bytes of chunks that are unpacked side by side, at most
_SHARE = 16  # of what may be kept, those
_SMALL = 1 << 16  # bytes: to keep chunks costs as much as to unpack so many
_LONG = 64  # samples along an edge of chunks that are not taken together
_LOOK = 0.1  # seconds: without an end, Windows would not hear Ctrl-C


class Room(Protocol):
    """Whose memory chunks take, together with others."""

    @property
    def lock(self) -> Any:
        """Of all that is counted."""

    def grant(self, nbytes: int, chunks: Chunks) -> bool:
        """Whether there is room for so many bytes more of some chunks; those of them may go that nobody uses."""


class Chunks:
    """Reads parts of an array that is stored by chunks; each chunk is unpacked once, if what comes in between fits.

    Several threads may read: what one is unpacking, another waits for. Small chunks are kept several together.

    Parameters
    ----------
    read : callable
        The samples at three slices, [z, y, x].
    lines : sequence of ndarray
        Where chunks begin along each axis, and where the last one ends: as of `lines_of`.
    dtype : dtype
        Of the samples.
    most : int
        Bytes to keep, at most.
    room : Room, optional
        Asked before chunks are kept.
    one : int
        Bytes of a chunk as it is unpacked, `stored_in_one`.
    together : int, optional
        Bytes of chunks that are unpacked side by side; by default a share of `most`.
    source : object
        Whose chunks they are.

    Attributes
    ----------
    shape : tuple of int
        Of all samples.
    dtype : dtype
    chunksize : tuple of int
        The largest of what is kept together.
    nbytes : int
        Of the chunks that are kept, or are being unpacked to be.
    together : int
        Bytes of chunks that are unpacked side by side, at most, unless a single one has more.
    """

    def __init__(
        self,
        read: Callable[[tuple[slice, slice, slice]], NDArray[Any]],
        lines: Sequence[NDArray[np.int64]],
        dtype: DTypeLike,
        most: int,
        room: Room | None = None,
        *,
        one: int = 0,
        together: int | None = None,
        source: object = None,
    ) -> None:
        self._read, self.dtype, self.most, self.room = read, np.dtype(dtype), most, room
        self._lines = _several(lines, self.dtype)
        self._one, self.source = one, source
        self.shape = tuple(int(line[-1]) for line in self._lines)
        self.chunksize = tuple(int(np.diff(line).max()) for line in self._lines)
        self._own_lock = threading.RLock()  # a handler of signals may come back here
        self._kept: OrderedDict[Place, _Chunk] = OrderedDict()  # the one used last is last
        self.largest = math.prod(self.chunksize) * self.dtype.itemsize
        self.together = max(self.largest, min(_TOGETHER, most // _SHARE) if together is None else together)
        self.nbytes = 0

    def __getitem__(self, at: tuple[slice, slice, slice]) -> NDArray[Any]:
        """The samples at three slices, [z, y, x]."""
        spans = self._spans(at)
        result = np.empty([one.stop - one.start for one in at], self.dtype)
        with self._lock:
            for place in itertools.product(*spans):  # what is wanted makes no room for what else is
                if place in self._kept:
                    self._kept.move_to_end(place)
        for box in self._batches(spans):
            self._fill(result, at, box)
        return result

    def parts(self, at: _Part) -> Iterator[_Part]:
        """A part in parts, each of as many chunks as are unpacked side by side."""
        return (_both(at, self._slices(box)) for box in self._batches(self._spans(at)))

    def touched(self, at: Sequence[slice]) -> int:
        """Bytes of the chunks that a part reaches into."""
        ends = ((line[span[0]], line[span[-1] + 1]) for line, span in zip(self._lines, self._spans(at), strict=True))
        return int(math.prod(int(b - a) for a, b in ends)) * self.dtype.itemsize

    def unpacking(self, at: Sequence[slice]) -> int:
        """Bytes that it takes to read a part, beside the result and what is kept: chunks as they are unpacked, and together."""
        return max(2 * min(self.together, self.touched(at)), self.unpacking_of_one)

    @property
    def unpacking_most(self) -> int:
        """The same of any part."""
        return max(2 * self.together, self.unpacking_of_one)

    @property
    def unpacking_of_one(self) -> int:
        """The same of one that is unpacked for some of its samples."""
        return UNPACKING * self._one

    # -- what makes room ---------------------------------------------------------------------------------------------------

    @property
    def idle(self) -> int:
        """Bytes that `evict` can free. The lock is held."""
        return sum(one.nbytes for one in self._kept.values() if not one.users)

    def evict(self, nbytes: int | None = None) -> int:
        """Evict unused chunks, least recently used first, until `nbytes` are freed, or all. Returns the bytes freed. Lock held."""
        freed = 0
        for place in [place for place, one in self._kept.items() if not one.users]:
            if nbytes is not None and freed >= nbytes:
                break
            freed += self._kept.pop(place).nbytes
        self.nbytes -= freed
        return freed

    def close(self) -> None:
        """Keep nothing any more."""
        with self._lock:
            self.most = 0
            self.evict()

    # -- reading -----------------------------------------------------------------------------------------------------------

    @property
    def _lock(self) -> Any:
        return self._own_lock if self.room is None else self.room.lock

    def _spans(self, at: Sequence[slice]) -> _Box:
        return tuple(
            range(int(np.searchsorted(line, one.start, "right")) - 1, int(np.searchsorted(line, one.stop, "left")))
            for line, one in zip(self._lines, at, strict=True)
        )

    def _batches(self, spans: _Box) -> Iterator[_Box]:
        """The chunks of a box, few enough at a time: whole rows, and whole planes, where these are."""
        left, steps = max(1, self.together // self.largest), []
        for span in spans[::-1]:
            steps.append(min(len(span), left))
            left = max(1, left // len(span)) if steps[-1] == len(span) else 1
        cuts = [[span[a : a + step] for a in range(0, len(span), step)] for span, step in zip(spans, steps[::-1], strict=True)]
        return itertools.product(*cuts)

    def _slices(self, box: _Box) -> _Part:
        return tuple(slice(int(line[one[0]]), int(line[one[-1] + 1])) for line, one in zip(self._lines, box, strict=True))

    def _fill(self, result: NDArray[Any], at: _Part, box: _Box) -> None:
        """What lies in some chunks, into the result."""
        me, used, own, coming, direct = threading.get_ident(), [], [], [], []
        try:
            with self._lock:
                missing = []
                for place in itertools.product(*box):
                    one = self._kept.get(place)
                    if one is None:
                        missing.append(place)
                    elif one.samples is None and one.thread == me:  # a handler of signals came back here
                        direct.append(place)
                    else:
                        one.users += 1
                        used.append(one)
                if missing and self._granted(sum(map(self._bytes, missing))):
                    for place in missing:
                        one = self._kept[place] = _Chunk(place, self._bytes(place), me)
                        self.nbytes += one.nbytes
                        own.append(one)
                else:
                    direct += missing
            coming = list(own)
            for part in _boxes(one.place for one in own):
                whole = self._read(self._slices(part))  # type: ignore[arg-type]  # three
                for one in [one for one in own if all(k in span for k, span in zip(one.place, part, strict=True))]:
                    inside = self._slices(tuple(range(k, k + 1) for k in one.place))
                    one.samples = np.ascontiguousarray(whole[_from(inside, self._slices(part))])
                    coming.remove(one)
                    one.done.set()
                del whole
            for part in _boxes(direct):
                self._put(result, at, self._slices(part))
            for one in [*own, *used]:
                self._copy(result, at, one)
        finally:
            with self._lock:
                for one in coming:  # they failed
                    if self._kept.get(one.place) is one:
                        del self._kept[one.place]
                        self.nbytes -= one.nbytes
                    one.done.set()
                for one in [*own, *used]:
                    one.users -= 1

    def _granted(self, nbytes: int) -> bool:
        """Whether so many bytes more can be kept. The lock is held."""
        over = max(0, self.nbytes + nbytes - self.most)
        if nbytes > self.most or (over and self.idle < over):
            return False
        if self.room is not None and not self.room.grant(nbytes - over, self):
            return False
        self.evict(max(0, self.nbytes + nbytes - self.most))  # of what room may have left
        return True

    def _bytes(self, place: Place) -> int:
        return math.prod(int(line[k + 1] - line[k]) for line, k in zip(self._lines, place, strict=True)) * self.dtype.itemsize

    def _copy(self, result: NDArray[Any], at: _Part, one: _Chunk) -> None:
        """What a chunk has of a part; one that another thread is unpacking is waited for."""
        while not one.done.wait(_LOOK):
            pass
        inside = self._slices(tuple(range(k, k + 1) for k in one.place))
        if one.samples is None:  # it failed there
            self._put(result, at, inside)
            return
        both = _both(at, inside)
        result[_from(both, at)] = one.samples[_from(both, inside)]

    def _put(self, result: NDArray[Any], at: _Part, inside: _Part) -> None:
        """What a part has of some chunks, read once more."""
        both = _both(at, inside)
        result[_from(both, at)] = self._read(both)  # type: ignore[arg-type]  # three


class _Chunk:
    """A chunk that is kept, or will be once it is unpacked, and how many threads are at it."""

    def __init__(self, place: Place, nbytes: int, thread: int) -> None:
        self.place, self.nbytes, self.thread = place, nbytes, thread
        self.users = 1
        self.samples: NDArray[Any] | None = None
        self.done = threading.Event()


def lines_of(data: Any) -> tuple[NDArray[np.int64], ...] | None:
    """Where chunks of an array of Zarr, HDF5 or dask begin along each axis, and where the last one ends; None if it has none."""
    chunks = getattr(data, "chunks", None)
    if not isinstance(chunks, (tuple, list)) or len(chunks) != len(data.shape):
        return None
    lines = []
    for n, stored in zip(data.shape, chunks, strict=True):
        if isinstance(stored, (int, np.integer)) and stored > 0:
            lines.append(np.append(np.arange(0, n, stored), n).astype(np.int64))
        elif isinstance(stored, (tuple, list)) and sum(stored) == n and min(stored) >= 0:  # dask's are as long as they like
            lines.append(np.unique(np.cumsum([0, *stored], dtype=np.int64)))
        else:
            return None
    return tuple(lines)


def stored_in_one(data: Any) -> int:
    """Bytes of the largest chunk of an array, which is unpacked as a whole however little of it is wanted; 0 if it has none."""
    own = getattr(data, "stored_in_one", None)
    if isinstance(own, int):
        return own
    lines = lines_of(data)
    if lines is None:
        return 0
    longest = (n if isinstance(n, (int, np.integer)) else max(n) for n in data.chunks)
    return math.prod(int(n) for n in longest) * int(np.dtype(data.dtype).itemsize)


def _several(lines: Sequence[NDArray[np.int64]], dtype: np.dtype[Any]) -> tuple[NDArray[np.int64], ...]:
    """The same with so many chunks together that they are worth being kept: along the axis along which they are shortest."""
    found = list(lines)
    while True:
        longest = [int(np.diff(line).max()) for line in found]
        short = [axis for axis, line in enumerate(found) if len(line) > 2 and longest[axis] < _LONG]
        if not short or math.prod(longest) * dtype.itemsize >= _SMALL:
            return tuple(found)
        axis = min(short, key=lambda axis: longest[axis])
        found[axis] = np.append(found[axis][:-1:2], found[axis][-1])


def _boxes(places: Iterable[Place]) -> list[_Box]:
    """Chunks as boxes, each of which can be read at once: rows of neighbours, then equal rows, then equal planes."""
    boxes = [tuple(range(k, k + 1) for k in place) for place in places]
    for axis in (2, 1, 0):
        others = [other for other in range(3) if other != axis]
        boxes.sort(key=lambda box: ([(box[i].start, box[i].stop) for i in others], box[axis].start))
        merged: list[_Box] = []
        for box in boxes:
            last = merged[-1] if merged else None
            if last is not None and last[axis].stop == box[axis].start and all(last[i] == box[i] for i in others):
                merged[-1] = tuple(range(last[i].start, box[i].stop) for i in range(3))
            else:
                merged.append(box)
        boxes = merged
    return boxes


def _both(at: _Part, inside: _Part) -> _Part:
    return tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(at, inside, strict=True))


def _from(part: _Part, whole: _Part) -> _Part:
    """A part of a whole, counted from where that begins."""
    return tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(part, whole, strict=True))
