"""The spline of a coarser grid that is nearest to that of the samples: least squares as it is defined, by quadrature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy import linalg

from clvol.base.arrays import Array
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.reference.spline.boundary import extend
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.prefilter import prefilter

__all__ = ["nearest_spline"]

_MARGIN = 45  # coarse samples past the ends: their influence falls by about a half from one to the next


def nearest_spline(
    data: ArrayLike,
    grid: Sequence[tuple[float, float, int] | None],
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
) -> Array:
    """Samples of the nearest spline, the function being continued past the edge by its boundary rule.

    Parameters
    ----------
    data : array-like
        Samples, of any number of axes.
    grid : sequence of (start, step, count) or None
        For each axis the first sample, the step, more than 1, and the number of the new samples, in samples of `data`; None leaves
        the axis alone.
    filter, boundary : str, Filter, Boundary
        As for `clvol.sample`; no hybrid.
    """
    result, chosen = np.asarray(data, np.float64), as_filter(filter)
    for axis, places in enumerate(grid):
        if places is not None:
            lines = np.moveaxis(result, axis, 0)
            made = _reduced(lines.reshape(len(lines), -1), places, chosen, boundary)
            result = np.moveaxis(made.reshape(-1, *lines.shape[1:]), 0, axis)
    return np.ascontiguousarray(result)


def _reduced(lines: Array, places: tuple[float, float, int], filter: Filter, boundary: str | Boundary) -> Array:
    start, step, m = places
    x = start + step * np.arange(-_MARGIN, m + _MARGIN, dtype=np.float64)
    reach = filter.support / 2
    # the fine spline on all that the coarse one covers
    before = int(np.ceil(max(0, -min(x[0], x[-1]) + abs(step) * reach))) + filter.support
    after = int(np.ceil(max(0, max(x[0], x[-1]) + abs(step) * reach - len(lines)))) + filter.support
    coefficients = np.stack([prefilter(line, filter, boundary) for line in lines.T], 1) if filter.prefilter else lines
    widths = [(before, after), (0, 0)]
    fine = extend(coefficients, widths, boundary)
    at, mass = _quadrature(filter, x, abs(step), len(fine), before)
    values = _kernels(filter, at[:, None] + before - np.arange(len(fine))) @ fine
    weight = np.sqrt(mass)[:, None]
    nearest = linalg.lstsq(weight * _kernels(filter, (at[:, None] - x) / abs(step)), weight * values, lapack_driver="gelsy")[0]
    if filter.prefilter:
        nearest = _kernels(filter, np.subtract.outer(np.arange(float(x.size)), np.arange(x.size))) @ nearest
    return np.asarray(nearest[_MARGIN:-_MARGIN])


def _kernels(filter: Filter, distance: Array) -> Array:
    """The kernel at many distances, most of them beyond its support."""
    result, near = np.zeros_like(distance), np.abs(distance) <= filter.support / 2
    result[near] = kernel(filter, distance[near])
    return result


def _quadrature(filter: Filter, x: Array, step: float, n: int, before: int) -> tuple[Array, Array]:
    """Nodes and weights that are exact for products of the two splines, between the coarse ones' outer ends."""
    half = filter.support / 2
    fine = np.arange(-before, n - before) + half
    coarse = np.unique(np.concatenate([x + step * (i - half) for i in range(filter.support + 1)]))
    knots = np.union1d(coarse, fine[(fine > coarse[0]) & (fine < coarse[-1])])
    nodes, shares = legendre.leggauss(filter.degree + 1)
    lengths = np.diff(knots)
    at = knots[:-1, None] + lengths[:, None] * (nodes + 1) / 2
    return at.ravel(), (lengths[:, None] * shares / 2).ravel()
