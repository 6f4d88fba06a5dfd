"""Triangles alone: how many fit, their normals, whether they are closed, and sheets that touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components

from clvol.base import memory
from clvol.base.checks import warn

__all__ = ["PART", "is_closed", "normals_of", "parted", "require_room"]

Points = NDArray[np.float64]
Indices = NDArray[np.int64]

PART = 1 << 15  # triangles at a time, whose corners stay in a processor's cache
_INNER = 1e-9  # weight of triangles beside others that are seen
_MANY = 100_000_000  # triangles, of which one is told before they are made


def require_room(pairs: int, each: int) -> None:
    """Refuse a mesh that does not fit, of two triangles for each pair, which takes `each` bytes; say that one is very large."""
    memory.require(pairs * each, f"a mesh of about {2 * pairs} triangles")
    if 2 * pairs >= _MANY:
        warn(f"the mesh has about {2 * pairs} triangles, and takes up to {pairs * each / 2**30:.1f} GiB while it is made")


def normals_of(points: Points, faces: Indices, inner: NDArray[np.bool_] | None = None) -> Points:
    """Normals of vertices: the means of those of the triangles around them, weighted by area; zero where there is none.

    Triangles that are `inner` count where all around a vertex are.
    """
    areas = np.empty((len(faces), 3))
    for first in range(0, len(faces), PART):
        a, b, c = (np.take(points, corner, 0) for corner in faces[first : first + PART].T)
        (ax, ay, az), (bx, by, bz) = (b - a).T, (c - a).T
        areas[first : first + PART] = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
    if inner is not None:
        areas[inner] *= _INNER
    starts = np.arange(0, 3 * len(faces) + 1, 3)
    around = csc_array((np.ones(3 * len(faces)), faces.ravel(), starts), shape=(len(points), len(faces)))
    sums: Points = np.asarray(around @ areas)
    sums /= np.maximum(np.linalg.norm(sums, axis=1), np.finfo(float).tiny)[:, None]
    return sums


def is_closed(faces: Indices, of: Indices | None = None) -> bool:
    """Whether each edge belongs to as many triangles one way as the other; if they are `of` several surfaces, in each."""
    ahead = _halves(faces)
    start, end = ahead.T
    n = int(faces.max(initial=0)) + 1
    if of is not None:
        above = n * np.tile(np.unique(of, return_inverse=True)[1], 3)
        start, end = start + above, end + above
    # what exceeds 64 bits wraps on both sides
    return bool(np.array_equal(np.sort(start * n + ahead[:, 1]), np.sort(end * n + ahead[:, 0])))


def parted(faces: Indices) -> tuple[Indices, Indices]:
    """Sheets that touch along an edge or in a vertex, each with vertices of its own.

    Every edge belongs to two triangles then, where it belongs to four now. Which of these belong together is free; where the two
    sheets would still share an edge, because they meet again at both of its ends, the other two do (Wenger, "Isosurfaces", 2013).

    Returns
    -------
    faces : ndarray of int64, shape (m, 3)
    sources : ndarray of int64
        The old vertex of each new one.
    """
    if not len(faces):
        return faces, np.zeros(0, np.int64)
    ahead, m, n = _halves(faces), len(faces), int(faces.max()) + 1
    forth, back = ahead[:, 0] * n + ahead[:, 1], ahead[:, 1] * n + ahead[:, 0]
    rank = _rank(forth)
    _, edge = np.unique(np.minimum(forth, back), return_inverse=True)
    crossed = np.zeros(edge.max() + 1, np.int64)  # of each edge, whether the other triangles belong together
    order = np.argsort(2 * forth + rank)
    sorted_forth = (2 * forth + rank)[order]
    corners = np.arange(3 * m).reshape(3, m)  # of each directed edge, the corner where it starts ...
    ends = corners[[1, 2, 0]].ravel()  # ... and where it ends
    corner_of = np.concatenate([faces[:, 0], faces[:, 1], faces[:, 2]])
    while True:
        wanted = 2 * back + (rank ^ crossed[edge])
        place = np.searchsorted(sorted_forth, wanted).clip(max=3 * m - 1)
        met = np.flatnonzero(sorted_forth[place] == wanted)
        twin = order[place[met]]
        joined = np.concatenate([met, ends[met]]), np.concatenate([ends[twin], twin])
        count, fan = connected_components(
            coo_array((np.ones(len(joined[0]), np.int8), joined), shape=(3 * m, 3 * m)), directed=False
        )
        fan = fan.astype(np.int64)
        shared = _rank(fan * count + fan[ends]) > 0
        if not shared.any():
            sources = np.empty(count, np.int64)
            sources[fan] = corner_of
            return np.ascontiguousarray(fan.reshape(3, m).T), sources
        # only edges that share no vertex: so each parts two fans, and the number of fans grows until none is shared
        bad = np.unique(edge[shared], return_index=True)
        both = ahead[np.flatnonzero(shared)[bad[1]]]
        first = np.full(n, len(both))
        np.minimum.at(first, both.ravel(), np.repeat(np.arange(len(both)), 2))
        alone = (first[both] == np.arange(len(both))[:, None]).all(1)
        crossed[bad[0][alone]] ^= 1


def _halves(faces: Indices) -> Indices:
    """The directed edges of triangles, shape (3 m, 2): the first of all, then the second, then the third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _rank(keys: Indices) -> Indices:
    """How many equal keys come before each."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(keys) else np.zeros(0, np.int64)
    rank = np.empty(len(keys), np.int64)
    rank[order] = np.arange(len(keys)) - np.repeat(starts, np.diff(np.append(starts, len(keys))))
    return rank
