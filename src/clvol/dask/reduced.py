"""Low-passes before coarser grids, block by block: the sums of an axis, of which a block takes its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.boundary import Boundary
from clvol.dask.blocks import Floats, Span
from clvol.filter import Filter
from clvol.spline.reduce import TRUNCATE, Sums, least_squares

__all__ = ["Reduction", "gaussian_radius"]


def gaussian_radius(sigma: float) -> int:
    """How many samples to either side a Gaussian takes."""
    return int(TRUNCATE * sigma + 0.5) if sigma > 0 else 0


@dataclass(frozen=True)
class Reduction:
    """What `clvol.spline.reduce.least_squares` needs for an axis; its sums are made once in each process, which caches them."""

    filter: Filter
    start: float
    step: float
    m: int
    n: int
    boundary: Boundary
    double: bool
    prefilter: bool

    @classmethod
    def at(cls, filter: Filter, positions: Floats, n: int, boundary: Boundary, double: bool, prefilter: bool = True) -> Reduction:
        """For samples at even distances; a single one stands for all of the axis."""
        m = len(positions)
        step = float(positions[-1] - positions[0]) / (m - 1) if m > 1 else float(n)
        return cls(filter, float(positions[0]), step, m, n, boundary, double, prefilter)

    @property
    def sums(self) -> Sums:
        """Of all of the axis."""
        return least_squares(self.filter, self.start, self.step, self.m, self.n, self.boundary, self.double, self.prefilter)

    def span(self, place: Span) -> Span:
        """Which samples a part of the result is made of."""
        places = self.sums.places[place[0] : place[1]]
        within = places[places < self.n]
        return (int(within.min()), int(within.max()) + 1) if within.size else (0, 1)

    def within(self, place: Span, span: Span) -> Sums:
        """The sums of a part of the result, of samples counted from the start of what it reads."""
        sums, rows, length = self.sums, slice(*place), span[1] - span[0]
        places = np.where(sums.places[rows] == self.n, length, sums.places[rows] - span[0])
        return Sums(length, places.astype(np.int32), np.ascontiguousarray(sums.weights[rows]))
