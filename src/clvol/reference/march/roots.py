"""The first crossing of the function along a ray, by eigenvalues: in every cell it is a polynomial.

The kernels find it by Bernstein coefficients; here each piece is interpolated at Chebyshev nodes, and the roots are the
eigenvalues of the colleague matrix (Good 1961; Boyd, "Solving Transcendental Equations", SIAM 2014, chapter 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.filter.filter import Filter
from clvol.reference.march.rays import Rays
from clvol.volume.volume import Volume

__all__ = ["crossings_by", "first_crossings"]

_LINES = 1 << 11  # lines at a time, to limit memory
_EDGE = 1e-10  # tolerance for roots outside a piece, in half its length
_REAL = 1e-7  # tolerance for imaginary parts, which for double roots are the square root of rounding
_BEHIND = 1e-7  # voxels behind a crossing, from where the next is sought
_NOTHING = 1e-14  # leading coefficients below this share of the largest are rounding errors
_PAST = 1e-9  # voxels past a jump, to its far side


def first_crossings(value: Callable[[Array], Array], volume: Volume, filter: Filter, rays: Rays, isovalue: float) -> Array:
    """T of the first crossing of the isovalue, from below to not below or back, along each ray; infinite if there is none.

    `value` is the function at world positions (N, 3); the volume and the filter determine where its pieces meet, and their degree.
    Directions of the rays need not have unit length.
    """
    t = np.full(rays.enter.shape, math.inf)
    there = np.flatnonzero(rays.enter < rays.leave)
    for part in np.array_split(there, -(-there.size // _LINES)) if there.size else []:
        t[part] = _first(value, volume, filter, rays[part], isovalue)
    return t


def crossings_by(first: Callable[[Rays], Array], volume: Volume, rays: Rays) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """The rays that cross a surface, and at which t: all first crossings, then all second ones, by what finds first ones."""
    on = np.arange(len(rays.enter))
    while True:
        t = first(rays)
        hit = np.flatnonzero(np.isfinite(t))
        if not hit.size:
            return
        on = on[hit]
        yield on, t[hit]
        rays = Rays(rays.origin[hit], rays.direction[hit], t[hit] + _BEHIND * min(volume.spacing), rays.leave[hit])


def _first(value: Callable[[Array], Array], volume: Volume, filter: Filter, rays: Rays, isovalue: float) -> Array:
    ends = np.sort(np.concatenate([rays.enter[:, None], _knots(volume, filter, rays), rays.leave[:, None]], 1), 1)
    low, high = ends[:, :-1], ends[:, 1:]
    line, piece = np.nonzero(high > low)  # in order along each line
    low, high = low[line, piece], high[line, piece]

    degree = 3 * filter.degree
    nodes = chebyshev.chebpts1(degree + 1)
    at = low[:, None] + (nodes + 1) / 2 * (high - low)[:, None]
    points = rays.origin[line][:, None] + at[..., None] * rays.direction[line][:, None]
    values = value(points.reshape(-1, 3)).reshape(at.shape) - isovalue
    coefficients = values @ np.linalg.inv(chebyshev.chebvander(nodes, degree)).T

    # sides of the value: where each piece begins and ends, and where in between it first changes
    below = np.repeat((coefficients[:, :1] < 0), 2, 1)
    found = np.full(line.size, math.inf)
    possible = np.abs(coefficients[:, 0]) <= np.abs(coefficients[:, 1:]).sum(1)
    root, below[possible] = _first_changes(coefficients[possible])
    found[possible] = low[possible] + (root + 1) / 2 * (high - low)[possible]

    jump = (line[1:] == line[:-1]) & (below[1:, 0] != below[:-1, 1])
    past = low[1:] + _PAST * float(min(volume.spacing)) / np.linalg.norm(rays.direction[line[1:]], axis=1)
    found[1:] = np.where(jump, np.minimum(past, found[1:]), found[1:])
    first = np.full(rays.enter.size, math.inf)
    np.minimum.at(first, line, found)
    return first


def _knots(volume: Volume, filter: Filter, rays: Rays) -> Array:
    """Where lines cross the planes between cells, clipped to their ends."""
    start = volume.world_to_index(rays.origin)
    slope = volume.world_to_index(rays.origin + rays.direction) - start
    enter, leave = rays.enter[:, None], rays.leave[:, None]
    knots = []
    for axis, n in enumerate(volume.size):
        shift = filter.support / 2 - 1  # the index rule: u = x scale - shift, and pieces meet where u is whole
        numbers = np.arange(math.floor(-0.5 * filter.scale - shift), math.ceil((n - 0.5) * filter.scale - shift) + 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((numbers + shift) / filter.scale - start[:, axis, None]) / slope[:, axis, None]
        knots.append(np.clip(np.where(np.isfinite(t), t, enter), enter, leave))
    return np.concatenate(knots, 1)


def _first_changes(coefficients: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The first change of sign of each Chebyshev series in -1..1, infinite if none; and whether it begins and ends below zero."""
    roots = _real_roots(coefficients)
    ends = np.concatenate([np.full((len(roots), 1), -1.0), roots, np.ones((len(roots), 1))], 1)
    between = (ends[:, 1:] + ends[:, :-1]) / 2
    values = np.einsum("pnk,pk->pn", chebyshev.chebvander(between, coefficients.shape[1] - 1), coefficients)
    below, long = values < 0, ends[:, 1:] > ends[:, :-1]
    last = below.shape[1] - 1
    for k in range(last - 1, -1, -1):  # empty intervals take the side of the next one, else of the previous one
        below[:, k], long[:, k] = np.where(long[:, k], below[:, k], below[:, k + 1]), long[:, k] | long[:, k + 1]
    for k in range(1, last + 1):
        below[:, k] = np.where(long[:, k], below[:, k], below[:, k - 1])
    changes = below[:, 1:] != below[:, :-1]
    first = np.where(changes, ends[:, 1:-1], math.inf).min(1, initial=math.inf)
    return first, below[:, [0, -1]]


def _real_roots(coefficients: Array) -> Array:
    """The real roots of each Chebyshev series in -1..1, sorted, and 1 in place of all others."""
    every = np.ones((len(coefficients), coefficients.shape[1] - 1))
    size = np.abs(coefficients)
    large = size > _NOTHING * size.max(1, initial=0.0)[:, None]
    degrees = np.where(large.any(1), coefficients.shape[1] - 1 - large[:, ::-1].argmax(1), 0)
    for degree in np.unique(degrees[degrees > 0]):
        which = np.flatnonzero(degrees == degree)
        series = coefficients[which, : degree + 1]
        colleague = np.broadcast_to(chebyshev.chebcompanion([0.0] * degree + [1.0]), (which.size, degree, degree)).copy()
        scale = np.array([1.0, *[math.sqrt(0.5)] * (degree - 1)])
        colleague[:, :, -1] -= (
            series[:, :-1] / series[:, -1:] * (scale / scale[-1]) * 0.5 if degree > 1 else series[:, :1] / series[:, 1:]
        )
        roots = np.linalg.eigvals(colleague)
        real = (np.abs(roots.imag) < _REAL) & (np.abs(roots.real) <= 1 + _EDGE)
        every[which, :degree] = np.where(real, np.clip(roots.real, -1, 1), 1.0)
    return np.sort(every, 1)
