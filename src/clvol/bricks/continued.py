"""What pictures take for a volume that is read by parts and lacks samples: its function goes on to the edge of what is missing."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.bricks.chunks import stored_in_one
from clvol.bricks.source import in_place_of
from clvol.volume.missing import EXTRAPOLATED, extrapolated

if TYPE_CHECKING:
    from clvol.bricks.source import Box, LazyVolume

__all__ = ["Absent", "continued"]


class Absent:
    """Where samples of a volume are missing, read by parts [z, y, x]."""

    def __init__(self, volume: LazyVolume) -> None:
        self._volume, self.shape = volume, volume.shape

    def __getitem__(self, place: tuple[slice, ...]) -> NDArray[np.bool_]:
        return np.asarray(~np.isfinite(self._volume.as_is(place)))  # type: ignore[arg-type]  # three


class _Continued:
    """The samples, those that are missing extrapolated from others within `EXTRAPOLATED`: the same whatever part is read."""

    def __init__(self, volume: LazyVolume, middle: float) -> None:
        self._volume, self._middle = volume, middle
        self.shape, self.dtype = volume.shape, volume.dtype
        self.chunks, self.stored_in_one = getattr(volume.data, "chunks", None), stored_in_one(volume.data)

    def __getitem__(self, place: Box) -> NDArray[Any]:
        part = self._volume.as_is(place)
        if np.isfinite(part).all():
            return part
        around = tuple(
            slice(max(0, one.start - EXTRAPOLATED), min(n, one.stop + EXTRAPOLATED))
            for one, n in zip(place, self.shape, strict=True)
        )
        data = self._volume.as_is(around)  # type: ignore[arg-type]  # three
        inner = tuple(slice(one.start - a.start, one.stop - a.start) for one, a in zip(place, around, strict=True))
        return extrapolated(data, ~np.isfinite(data), self._middle)[inner]


def continued(volume: LazyVolume) -> LazyVolume:
    """The volume without missing samples, and where they were, if those that are looked at show that some are missing."""
    known = volume.dtype.kind != "f" or volume.missing is not None or volume.bounds is not None or volume.statistics is not None
    if known or volume.where is not None:
        return volume
    if all(np.isfinite(some.data).all() for some in (volume.preview(), volume.part())):
        return volume
    low, high = volume.limits
    return in_place_of(volume, partial(_Continued, middle=low / 2 + high / 2), Absent, partial(continued, volume))
