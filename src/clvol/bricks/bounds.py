"""Bounds of a function's values in bricks: those kept beside the samples, and tighter ones once a brick was read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.spline.minmax import MinMax

if TYPE_CHECKING:
    from clvol.bricks.grid import Brick, BrickGrid
    from clvol.bricks.residents import Resident
    from clvol.bricks.source import Bounds, Index
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.evaluator import Evaluator
    from clvol.volume.stored import Stored

__all__ = ["BrickBounds"]


class BrickBounds:
    """The smallest and the largest value in bricks, as far as these are known.

    Parameters
    ----------
    grid : BrickGrid
    stored : Stored
        How values are stored on the device.
    kept : Bounds, optional
        Those kept beside the samples, used if they are of this function, or of the samples where they bound names.
    filter, boundary
        Of the function.
    names : bool
        Whether samples are names, which are never blended: then bounds are of those among the taps, exactly.
    """

    def __init__(
        self, grid: BrickGrid, stored: Stored, kept: Bounds | None, filter: Filter, boundary: Boundary, *, names: bool = False
    ) -> None:
        own = kept is not None and (kept.filter, kept.boundary) == (filter.name, boundary.name)
        if names:  # none come from elsewhere than from near by
            own = kept is not None and kept.filter == "nearest" and boundary.fold is not None and boundary.beyond is None
        self._grid, self._stored, self._kept, self._names = grid, stored, kept if own else None, names
        self._taps = filter.support // 2 + 1 if names else 0  # to either side of a place, and one for half a sample
        self._found: dict[Index, tuple[float, float]] = {}

    def of(self, brick: Brick) -> tuple[float, float] | None:
        """Bounds in a brick and around it, in units of the data; None if nothing is known.

        Kept bounds are of blocks that reach outside the brick; those found in a brick that was read are of its own cells.
        """
        found = self._found.get(brick.at)
        if self._kept is None:
            return found
        kept = self._kept.within(*self._grid.seen(brick, self._taps))
        return kept if found is None else (max(kept[0], found[0]), min(kept[1], found[1]))

    def stored(self, brick: Brick) -> tuple[float, float] | None:
        """The same in stored values, rounded outwards; names are exact."""
        ends = self.of(brick)
        if ends is None:
            return None
        low, high = (np.float32(value) for value in self._stored(np.array(ends, np.float64)))
        if self._names:
            return float(low), float(high)
        return float(np.nextafter(low, np.float32(-np.inf))), float(np.nextafter(high, np.float32(np.inf)))

    def pyramid(self, brick: Resident, evaluator: Evaluator) -> MinMax:
        """Minima and maxima of the cells of a resident brick."""
        with brick.lock:
            if brick.minmax is None:
                cells = self._grid.pyramid_cells(self._grid[brick.at], brick.coefficients.shape[::-1])
                made = MinMax(brick.coefficients, evaluator, cells, names=self._names)
                low, high = (float(value) for value in self._stored.values(np.array(made.extremes(), np.float32)))
                self._found[brick.at] = low, high
                brick.minmax = made
            return brick.minmax
