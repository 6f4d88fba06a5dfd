"""Evenly spaced samples of a volume: few, of all of it, from which cameras are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from clvol.volume.steepness import steepness_at

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
    def steepness(self) -> NDArray[np.float64]:
        """Magnitudes of gradients per world unit: by neighbours in the grid, or by neighbours among these if no others are here."""
        if not np.may_share_memory(self.data, self.grid.data):
            matrix = self.grid.world_to_index_matrix / np.array(self.steps)[:, None]
            return steepness_at(self.data, [np.arange(n) for n in self.data.shape], matrix)
        places = [np.arange(n)[place] for n, place in zip(self.grid.size, places_of(self.grid.size), strict=True)]
        return steepness_at(self.grid.data, places[::-1], self.grid.world_to_index_matrix)

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
