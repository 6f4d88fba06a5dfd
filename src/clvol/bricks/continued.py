"""What pictures take for a volume that is read by parts and lacks samples: its function goes on to the edge of what is missing."""

from __future__ import annotations

import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.bricks.chunks import Place, lines_of, stored_in_one
from clvol.bricks.source import LazyVolume, Sliced, stored_at
from clvol.interop.dispatch import is_in_parts
from clvol.volume.missing import EXTRAPOLATED, extrapolated, require_mask
from clvol.volume.samples import beyond_float32

if TYPE_CHECKING:
    from clvol.bricks.source import Box

__all__ = ["Absent", "continued", "holed", "lacks_some"]

_EDGE = 64  # samples along an edge of what is kept as one, where a volume has no chunks
_BITS = 64 << 20  # bytes of bits that are kept of one volume


class _Masked:
    """The samples of a volume in a floating type, NaN where a mask is True; both are volumes that are read by parts."""

    def __init__(self, volume: LazyVolume, kind: np.dtype[Any], mask: LazyVolume | None) -> None:
        self._volume, self._mask = volume, mask
        self.shape, self.dtype = volume.shape, kind
        self.chunks, self.stored_in_one = getattr(volume.data, "chunks", None), stored_in_one(volume.data)

    def __getitem__(self, place: Box) -> NDArray[Any]:
        volume = self._volume
        part = stored_at(volume, place) if volume.missing is None else volume.at(place)
        part = part.astype(self.dtype)
        if self._mask is not None:
            part[self._mask.at(place)] = np.nan
        return part

    def for_tasks(self) -> _Masked:
        return _Masked(self._volume.for_tasks(), self.dtype, None if self._mask is None else self._mask.for_tasks())


class _Coarser:
    """A mask for a lower resolution of what it masks: True where it is for any of the samples that one of these stands for."""

    def __init__(self, mask: LazyVolume, finest: LazyVolume, coarse: LazyVolume) -> None:
        self._mask, self.shape, self.dtype = mask, coarse.shape, np.dtype(bool)
        first = finest.world_to_index(coarse.origin)
        self._starts = []  # along z, y and x: the first sample of each
        for n, fine, at, step in zip(
            coarse.shape, finest.shape, first[::-1], np.divide(coarse.spacing, finest.spacing)[::-1], strict=True
        ):
            starts = np.ceil(at + (np.arange(n) - 0.5) * step - 1e-6).astype(int)
            self._starts.append(np.append(np.clip(starts, 0, fine - 1), fine))

    def __getitem__(self, place: Box) -> NDArray[np.bool_]:
        lines = [starts[one.start : one.stop + 1] for starts, one in zip(self._starts, place, strict=True)]
        z, y, x = (slice(int(line[0]), max(int(line[-1]), int(line[-2]) + 1)) for line in lines)
        found = self._mask.at((z, y, x))
        for axis, line in enumerate(lines):
            found = np.logical_or.reduceat(found, line[:-1] - line[0], axis)
        return found

    def for_tasks(self) -> _Coarser:
        made: _Coarser = object.__new__(_Coarser)
        vars(made).update(vars(self), _mask=self._mask.for_tasks())
        return made


class Absent:
    """Where samples of a volume are NaN, read by parts [z, y, x]; what was found is kept, a bit for each sample."""

    def __init__(self, volume: LazyVolume) -> None:
        self.volume, self.shape = volume, volume.shape
        self._lines = lines_of(volume.data) or tuple(np.append(np.arange(0, n, _EDGE), n) for n in volume.shape)
        self._known: OrderedDict[Place, NDArray[np.uint8] | bool] = OrderedDict()  # the one used last is last
        self._kept = 0  # bytes
        self._lock = threading.RLock()  # a handler of signals may come back here

    def __reduce__(self) -> tuple[Any, ...]:
        return Absent, (self.volume,)

    def __getitem__(self, place: tuple[slice, ...]) -> NDArray[np.bool_]:
        result = np.empty([one.stop - one.start for one in place], bool)
        for at, box in self._blocks(place):
            both = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(place, box, strict=True))
            result[_from(both, place)] = self._of(at, box)[_from(both, box)]
        return result

    def read(self, place: Box) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The samples, and where they are missing."""
        part = self.volume.at(place)
        missing = ~np.isfinite(part)
        for at, box in self._blocks(place):
            if all(a.start <= b.start and b.stop <= a.stop for a, b in zip(place, box, strict=True)):
                self._keep(at, missing[_from(box, place)])
        return part, missing

    def _blocks(self, place: tuple[slice, ...]) -> Iterator[tuple[Place, Box]]:
        """What is kept as one of a part: its numbers along z, y and x, and where it lies."""
        spans = [
            range(int(np.searchsorted(line, one.start, "right")) - 1, int(np.searchsorted(line, one.stop, "left")))
            for line, one in zip(self._lines, place, strict=True)
        ]
        for at in itertools.product(*spans):
            z, y, x = (slice(int(line[k]), int(line[k + 1])) for line, k in zip(self._lines, at, strict=True))
            yield at, (z, y, x)

    def _of(self, at: Place, box: Box) -> NDArray[np.bool_]:
        shape = [one.stop - one.start for one in box]
        with self._lock:
            known = self._known.get(at)
            if known is not None:
                self._known.move_to_end(at)
        if known is None:
            return self.read(box)[1]
        if isinstance(known, bool):
            return np.broadcast_to(np.bool_(known), shape)
        return np.unpackbits(known, count=math.prod(shape)).view(bool).reshape(shape)

    def _keep(self, at: Place, missing: NDArray[np.bool_]) -> None:
        some, every = bool(missing.any()), bool(missing.all())
        found = every if some == every else np.packbits(missing)
        with self._lock:
            if at in self._known:
                return
            self._known[at] = found
            self._kept += np.asarray(found).nbytes
            while self._kept > _BITS and len(self._known) > 1:
                self._kept -= np.asarray(self._known.popitem(last=False)[1]).nbytes


class _Continued:
    """The samples, those that are missing extrapolated from others within `EXTRAPOLATED`: the same whatever part is read."""

    def __init__(self, absent: Absent, middle: float) -> None:
        self.absent, self._middle = absent, middle
        volume = absent.volume
        self.shape, self.dtype = volume.shape, volume.dtype
        self.chunks, self.stored_in_one = getattr(volume.data, "chunks", None), stored_in_one(volume.data)

    def __getitem__(self, place: Box) -> NDArray[Any]:
        part, missing = self.absent.read(place)
        if not missing.any():
            return part
        z, y, x = (_grown(one, n, missing, axis) for axis, (one, n) in enumerate(zip(place, self.shape, strict=True)))
        if (z, y, x) != place:
            part, missing = self.absent.read((z, y, x))
        return extrapolated(part, missing, self._middle)[_from(place, (z, y, x))]

    def for_tasks(self) -> _Continued:
        return _Continued(Absent(self.absent.volume.for_tasks()), self._middle)


def _grown(one: slice, n: int, missing: NDArray[np.bool_], axis: int) -> slice:
    """A part along an axis, and what those of its samples that are missing are extrapolated from."""
    where = np.flatnonzero(missing.any(tuple(other for other in range(3) if other != axis))) + one.start
    return slice(max(0, min(one.start, int(where[0]) - EXTRAPOLATED)), min(n, max(one.stop, int(where[-1]) + 1 + EXTRAPOLATED)))


def _from(part: tuple[slice, ...], whole: tuple[slice, ...]) -> tuple[slice, ...]:
    """A part of a whole, counted from where that begins."""
    return tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(part, whole, strict=True))


def lacks_some(volume: LazyVolume) -> bool:
    """Whether samples are missing, of those that are looked at."""
    if volume.where is not None or volume.missing is not None:
        return volume.missing is not None and math.isnan(volume.missing)
    known = volume.bounds is not None or volume.statistics is not None
    return volume.damaged or not (known or all(np.isfinite(some.data).all() for some in (volume.preview(), volume.part())))


def holed(volume: LazyVolume, mask: ArrayLike | LazyVolume | None = None) -> LazyVolume:
    """The volume with NaN where samples are missing: not finite, in a damaged chunk, or where a mask is True.

    Integers become floating, as by `masked`. `DataError` if the mask is not boolean, or of another shape.
    """
    volume = getattr(volume.where, "volume", volume)
    if mask is None:
        return _holed(volume, None)
    given: Any = mask if is_in_parts(mask) or isinstance(mask, Sliced) else np.asarray(mask)
    require_mask(given.dtype, given.shape, volume.shape)
    return _holed(volume, given if is_in_parts(given) else LazyVolume(given))


def _holed(volume: LazyVolume, mask: LazyVolume | None) -> LazyVolume:
    masks = [None if mask is None else LazyVolume(_Coarser(mask, volume, level)) for level in volume.levels]
    made = volume.with_levels(list(map(_holed, volume.levels, masks)))
    floating = volume.dtype.kind == "f"
    if mask is not None or not floating:
        wide = not floating and volume.dtype.itemsize > 2 and (volume.estimated or beyond_float32(volume.grid.data, volume.limits))
        kind = volume.dtype if floating else np.dtype(np.float64 if wide else np.float32)
        labels = volume.grid.labels if floating or volume.grid.labels is not None else volume.is_labels
        made.data = _Masked(volume, kind, mask)
        made.grid = replace(volume.grid, data=np.broadcast_to(np.zeros((), kind), volume.shape), labels=labels)
    if mask is None:
        made._preview, made._limits = volume.preview(), volume.limits
    else:
        made._part, made._limits, made._given, made.bounds, made.statistics = None, None, False, None, None
    made.missing = math.nan
    made._again = None if volume._again is None else partial(_holed, volume, mask)
    return made


def continued(volume: LazyVolume, mask: ArrayLike | LazyVolume | None = None) -> LazyVolume:
    """The volume without missing samples, and where they were: not finite, in a damaged chunk, or where a mask is True."""
    given = holed(volume, mask)
    low, high = given.limits
    made = _continued(given, low / 2 + high / 2)
    made._again = partial(continued, volume, mask)
    return made


def _continued(given: LazyVolume, middle: float) -> LazyVolume:
    made = given.with_levels([_continued(level, middle) for level in given.levels])
    made.where = Absent(given)
    made.data, made.missing, made.bounds, made._again = _Continued(made.where, middle), None, None, None
    made._preview, made._part, made._limits = given.preview(), given.part(), given.limits
    return made
