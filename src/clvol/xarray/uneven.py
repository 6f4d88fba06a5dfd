"""Splines along an axis whose coordinates are uneven: their knots are at the samples, and they end "not-a-knot", as SciPy's do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

__all__ = ["Uneven", "runs"]

Array = NDArray[Any]
Floats = NDArray[np.float64]

_RUN = 64  # positions and samples that a matrix of weights is made for
_MARGIN = 16  # samples around them, which is doubled until the weights outside are small enough


@dataclass(frozen=True, eq=False)
class Uneven:
    """An axis, the coordinates of whose samples ascend, and the degree of splines along it: less where there are few samples.

    Weights up to `left_out` are left out. Without `interpolates`, samples are the coefficients.
    """

    knots: Floats
    degree: int
    left_out: float
    interpolates: bool = True

    def part(self, span: tuple[int, int]) -> Uneven:
        """The axis of some samples, from first to before stop."""
        return replace(self, knots=self.knots[slice(*span)])

    def near(self, at: float) -> tuple[int, int]:
        """The samples, from first to before stop, whose weights at a position are not left out.

        On even axes a weight is a quarter of the one before it, on uneven ones it need not be smaller; so they are looked at.
        """
        knots, margin = self.knots, _MARGIN
        at = min(max(at, 0.0), knots.size - 1.0)
        while True:
            first, stop = max(0, math.floor(at) - margin), min(knots.size, math.ceil(at) + margin + 1)
            ends = np.abs(replace(self, knots=knots[first:stop], interpolates=True)._weights(np.array([at - first])))[0, [0, -1]]
            if (first == 0 or ends[0] <= self.left_out) and (stop == knots.size or ends[1] <= self.left_out):
                return first, stop
            margin *= 2

    def write(self, data: Array, axis: int, at: Floats, output: Array) -> None:
        """Write an array's splines along an axis at positions in samples into `output`.

        Nearby positions have a matrix of weights, with which the samples around them are multiplied.
        """
        order, onto, samples, done = np.argsort(at, kind="stable"), np.moveaxis(output, axis, 0), np.moveaxis(data, axis, 0), 0
        for count in runs(at[order], _RUN):
            positions = order[done : done + count]
            done += count
            first, stop = self.near(at[positions[0]])[0], self.near(at[positions[-1]])[1]
            weights = self.part((first, stop))._weights(at[positions] - first).astype(output.real.dtype)
            onto[positions] = np.tensordot(weights, samples[first:stop].astype(output.dtype, copy=False), 1)

    def taps(self, data: Array, axis: int, at: Floats) -> tuple[Array, Array, Array]:
        """An array's coefficients along an axis, and which have a weight at each position: indices and weights, (taps, points)."""
        spline = self._spline(data, axis)
        rows = BSpline.design_matrix(self._coordinates(at), spline.t, spline.k, extrapolate=True)
        shape = (at.size, spline.k + 1)
        return np.moveaxis(spline.c, 0, axis), rows.indices.reshape(shape).T, rows.data.reshape(shape).T

    def _coordinates(self, at: Floats) -> Floats:
        """The coordinates of positions in samples, between which they are linear; beyond the ends as in the outer steps."""
        cell = np.clip(np.floor(at), 0, self.knots.size - 2).astype(np.intp)
        return np.asarray(self.knots[cell] + (at - cell) * np.diff(self.knots)[cell])

    def _spline(self, values: Array, axis: int = 0) -> BSpline[Any]:
        spline = make_interp_spline(self.knots, values, min(self.degree, self.knots.size - 1), axis=axis, check_finite=False)
        return spline if self.interpolates else BSpline(spline.t, values, spline.k, axis=axis)

    def _weights(self, at: Floats) -> Floats:
        """The weights of all samples at positions; (positions, samples)."""
        return np.asarray(self._spline(np.eye(self.knots.size))(self._coordinates(at)))


def runs(positions: Floats, longest: int) -> tuple[int, ...]:
    """The lengths of runs of successive positions, each of at most `longest` positions and samples."""
    cuts = [0]
    low = high = positions[0] if positions.size else 0.0
    for i, x in enumerate(positions.tolist()):
        low, high = min(low, x), max(high, x)
        if i - cuts[-1] >= longest or (high - low > longest and i > cuts[-1]):
            cuts.append(i)
            low = high = x
    return tuple(np.diff([*cuts, positions.size]).tolist())
