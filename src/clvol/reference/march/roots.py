"""The first root of the function along a ray, by eigenvalues: in every cell it is a polynomial, known from its values.

The kernels look for it by Bernstein coefficients; here each piece is interpolated at Chebyshev nodes, and the roots are the
eigenvalues of the colleague matrix (Good 1961; Boyd, "Solving Transcendental Equations", SIAM 2014, chapter 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from clvol.filter import Filter
from clvol.volume import Volume

__all__ = ["first_crossings"]

Array = NDArray[np.float64]
_LINES = 1 << 11  # at a time, for the sake of memory
_EDGE = 1e-10  # how far past its piece a root may lie, as a share of half of it
_REAL = 1e-7  # imaginary parts of double roots are the square root of rounding
_NOTHING = 1e-14  # leading coefficients below this share of the largest are rounding
_PAST = 1e-9  # of a voxel: where a jump is, its far side


def first_crossings(
    value: Callable[[Array], Array],
    volume: Volume,
    filter: Filter,
    origin: Array,
    direction: Array,
    enter: Array,
    leave: Array,
    isovalue: float,
) -> Array:
    """Where the function that is drawn first takes a value along each line, from where it enters.

    Parameters
    ----------
    value : callable
        The function: values (N,) at world positions (N, 3).
    volume, filter : Volume, Filter
        What it is made from: they say where its pieces meet, and of what degree they are.
    origin, direction : ndarray, shape (N, 3)
        Lines ``p(t) = origin + t direction`` in the world ...
    enter, leave : ndarray, shape (N,)
        ... for ``enter <= t <= leave``; ``enter > leave`` for those that are nowhere.
    isovalue : float

    Returns
    -------
    ndarray, shape (N,)
        t of the first place where the function equals the value or jumps past it; infinite where there is none.
    """
    t = np.full(enter.shape, math.inf)
    there = np.flatnonzero(enter < leave)
    for part in np.array_split(there, -(-there.size // _LINES)) if there.size else []:
        t[part] = _first(value, volume, filter, origin[part], direction[part], enter[part], leave[part], isovalue)
    return t


def _first(
    value: Callable[[Array], Array],
    volume: Volume,
    filter: Filter,
    origin: Array,
    direction: Array,
    enter: Array,
    leave: Array,
    isovalue: float,
) -> Array:
    ends = np.sort(np.concatenate([enter[:, None], _knots(volume, filter, origin, direction, enter, leave), leave[:, None]], 1), 1)
    low, high = ends[:, :-1], ends[:, 1:]
    line, piece = np.nonzero(high > low)  # in order along each line
    low, high = low[line, piece], high[line, piece]

    degree = 3 * filter.degree
    nodes = chebyshev.chebpts1(degree + 1)
    at = low[:, None] + (nodes + 1) / 2 * (high - low)[:, None]
    points = origin[line][:, None] + at[..., None] * direction[line][:, None]
    values = value(points.reshape(-1, 3)).reshape(at.shape) - isovalue
    coefficients = values @ np.linalg.inv(chebyshev.chebvander(nodes, degree)).T

    found = np.full(line.size, math.inf)  # t of the first root of each piece
    possible = np.abs(coefficients[:, 0]) <= np.abs(coefficients[:, 1:]).sum(1)
    root = _first_roots(coefficients[possible])
    found[possible] = low[possible] + (root + 1) / 2 * (high - low)[possible]

    start, end = coefficients @ (-1.0) ** np.arange(degree + 1), coefficients.sum(1)
    jump = (line[1:] == line[:-1]) & ((start[1:] < 0) != (end[:-1] < 0))
    past = low[1:] + _PAST * float(min(volume.spacing)) / np.linalg.norm(direction[line[1:]], axis=1)
    found[1:] = np.where(jump, np.minimum(past, found[1:]), found[1:])
    first = np.full(enter.size, math.inf)
    np.minimum.at(first, line, found)
    return first


def _knots(volume: Volume, filter: Filter, origin: Array, direction: Array, enter: Array, leave: Array) -> Array:
    """Where lines cross the planes between cells; those past their ends at the ends."""
    start = volume.world_to_index(origin)
    slope = volume.world_to_index(origin + direction) - start
    knots = []
    for axis, n in enumerate(volume.size):
        shift = filter.support / 2 - 1  # the index rule: u = x scale - shift, and pieces meet where u is whole
        numbers = np.arange(math.floor(-0.5 * filter.scale - shift), math.ceil((n - 0.5) * filter.scale - shift) + 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((numbers + shift) / filter.scale - start[:, axis, None]) / slope[:, axis, None]
        knots.append(np.clip(np.where(np.isfinite(t), t, enter[:, None]), enter[:, None], leave[:, None]))
    return np.concatenate(knots, 1)


def _first_roots(coefficients: Array) -> Array:
    """The smallest real root in -1..1 of each Chebyshev series, infinite where there is none."""
    first = np.full(len(coefficients), math.inf)
    size = np.abs(coefficients)
    large = size > _NOTHING * size.max(1, initial=0.0)[:, None]
    degrees = np.where(large.any(1), coefficients.shape[1] - 1 - large[:, ::-1].argmax(1), 0)
    for degree in np.unique(degrees[degrees > 0]):
        which = np.flatnonzero(degrees == degree)
        series = coefficients[which, : degree + 1]
        colleague = np.broadcast_to(chebyshev.chebcompanion([0.0] * degree + [1.0]), (which.size, degree, degree)).copy()
        scale = np.array([1.0, *[math.sqrt(0.5)] * (degree - 1)])
        last = series[:, :-1] / series[:, -1:] * (scale / scale[-1]) * 0.5 if degree > 1 else series[:, :1] / series[:, 1:]
        colleague[:, :, -1] -= last
        roots = np.linalg.eigvals(colleague)
        real = (np.abs(roots.imag) < _REAL) & (np.abs(roots.real) <= 1 + _EDGE)
        first[which] = np.where(real, np.clip(roots.real, -1, 1), math.inf).min(1)
    first[degrees == 0] = np.where(size[degrees == 0, 0] == 0, -1.0, math.inf)
    return first
