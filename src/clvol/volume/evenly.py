"""Evenly spaced samples of a volume: few, of all of it, from which cameras are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

from numpy.typing import NDArray

if TYPE_CHECKING:
    from clvol.volume.volume import Volume

__all__ = ["MOST", "Evenly", "evenly", "places_of", "remember_evenly"]

MOST = 64
"""Samples along each axis, at most."""


class Evenly(NamedTuple):
    """Every n-th sample of a grid along each axis, centred."""

    data: NDArray[Any]
    grid: Volume

    @property
    def steps(self) -> list[int]:
        """Samples of the grid from one to the next, along (x, y, z)."""
        return [-(-n // MOST) for n in self.grid.size]

    @property
    def firsts(self) -> list[int]:
        """Indices (x, y, z) of the first."""
        return [place.start for place in places_of(self.grid.size)]


def places_of(size: Sequence[int]) -> list[slice]:
    """Which samples they are along each axis, of a grid of `size`."""
    steps = [-(-n // MOST) for n in size]
    return [slice((n - 1) % step // 2, None, step) for n, step in zip(size, steps, strict=True)]


def evenly(volume: Volume) -> Evenly:
    """A view of the volume's; or those that were found in the larger volume of which it is a preview."""
    return _KNOWN.get(volume) or Evenly(volume.data[tuple(places_of(volume.size)[::-1])], volume)


def remember_evenly(volume: Volume, found: Evenly) -> None:
    """Use for a volume those of another, of which it is a preview."""
    _KNOWN[volume] = found


_KNOWN: WeakKeyDictionary[Volume, Evenly] = WeakKeyDictionary()
