"""Surfaces between the smooth regions of labels, which share their triangles and vertices: the topology and places of `clvol.mesh`.

Surface nets say how they are joined: a vertex in each cell of the grid whose corners lie in several regions, and a quadrangle for
each edge of the grid that leads from one region to another, with the four vertices around it (Gibson, "Constrained elastic surface
nets", 1998). Where in its cell a vertex lies is asked of the indicators.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.base.progress import Progress, part_of
from clvol.interfaces.triangles import PART, require_room
from clvol.spline.grids import Target
from clvol.spline.regions import Regions
from clvol.volume.label_table import LabelTable

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.volume.volume import Volume

__all__ = ["LabelSurfaces", "as_number", "label_surfaces"]

Points = NDArray[np.float64]
Indices = NDArray[np.int64]
Quads = NDArray[np.int32]

_LISTED = 16  # labels in a message
_MOST = 1 << 53  # of numbers that are told apart
_PER_QUAD = 300  # bytes of a quadrangle and its vertex, while they are made


class LabelSurfaces(NamedTuple):
    """Triangles, with the label behind and in front of each."""

    vertices: Points
    faces: Indices
    labels: Indices
    lost: list[int]  # labels that were asked for, and are nowhere the largest


class _Net(NamedTuple):
    """Vertices, each in a cell of the grid, and the quadrangles that join them.

    Attributes
    ----------
    cells : ndarray of int32, shape (n, 3)
        First corners of the cells, as indices (x, y, z) of samples, from -1 on.
    around : ndarray of integers, shape (n, 8)
        The codes at the corners of the cells, along x first.
    quads : ndarray of int32, shape (m, 4)
        Counterclockwise as seen from the region in front.
    pairs : ndarray of integers, shape (m, 2)
        The codes behind and in front of these.
    """

    cells: NDArray[np.int32]
    around: NDArray[Any]
    quads: Quads
    pairs: NDArray[Any]


def as_number(label: object, names: Mapping[int, str]) -> int:
    """The number of a label that is given by its number or its name, and is one of these."""
    number = LabelTable(names).number_of(label)
    if number not in names:
        some = ", ".join(map(str, list(names)[:_LISTED])) + (", ..." if len(names) > _LISTED else "")
        raise OptionError(f"the label must be one that occurs: {some or 'none does'}; got {number}")
    return number


def label_surfaces(
    volume: Volume, chosen: Sequence[int], how: tuple[Filter, Boundary, Device], closed: bool, progress: Progress | None
) -> LabelSurfaces:
    """The surfaces of some labels of a volume, which ascend.

    Of two labels that were both chosen the smaller one is behind a triangle, else the one that was. In front of triangles in the
    faces of the domain is a number below all labels, and below zero.
    """
    low, high = volume.limits
    if max(abs(float(low)), abs(float(high))) >= _MOST:
        raise OptionError(f"a mesh takes labels between -2**53 and 2**53; got {low} to {high}")
    with Regions(volume, *how) as regions:
        numbers, codes = _coded(regions.on(Target(np.eye(3), np.zeros(3), volume.shape), part_of(progress, 0, 0.3)))
        crossings = sum(int(np.count_nonzero(part)) for plane in _crossed(codes) for part in plane)
        require_room(crossings, _PER_QUAD)
        cells, around, quads, pairs = _joined(codes, np.append(False, np.isin(numbers, chosen)))
        if not closed:
            inner = (pairs != 0).all(1)
            quads, pairs = quads[inner], pairs[inner]
        if progress:
            progress(0.5)
        offsets = regions.in_cells(cells, around, numbers, volume.spacing)
    if progress:
        progress(0.8)
    met = np.zeros(len(offsets), bool)
    met[quads] = True
    if not met.all():
        cells, offsets, quads = cells[met], offsets[met], (np.cumsum(met, dtype=np.int32) - 1)[quads]
    faces = _halved((cells + offsets) * np.array(volume.spacing, np.float32), quads)
    if np.linalg.det(volume.index_to_world_matrix) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    vertices = volume.index_to_world(cells + offsets.astype(np.float64))
    labels = np.append(min(0, int(low)) - 1, numbers)[pairs].repeat(2, 0)
    if progress:
        progress(1.0)
    return LabelSurfaces(vertices, faces, labels, np.setdiff1d(chosen, numbers).tolist())


def _coded(grid: NDArray[Any]) -> tuple[Indices, NDArray[Any]]:
    """The numbers in a grid, which ascend, and their places among these, from 1 on, within a rim of zeros."""
    low, high = int(grid.min()), int(grid.max())
    known, first = high - low < grid.size, np.int64(low)
    if known:
        seen = np.zeros(high - low + 1, bool)
        for plane in grid:
            seen[plane.astype(np.int64) - first] = True
        numbers = np.flatnonzero(seen) + first
        table = np.cumsum(seen).astype(np.min_scalar_type(len(numbers)))
    else:
        numbers = np.unique(grid).astype(np.int64)
    codes = np.zeros([n + 2 for n in grid.shape], np.min_scalar_type(len(numbers)))
    for plane, coded in zip(grid, codes[1:-1, 1:-1, 1:-1], strict=True):
        coded[...] = table[plane.astype(np.int64) - first] if known else np.searchsorted(numbers, plane) + 1
    return numbers, codes


def _crossed(codes: NDArray[Any]) -> Iterator[list[NDArray[np.bool_]]]:
    """Of each plane of samples: where neighbors differ along x, along y, and along z from the plane before."""
    before = codes[0]
    for plane in codes:
        yield [plane[:, 1:] != plane[:, :-1], plane[1:] != plane[:-1], plane != before]
        before = plane


def _joined(codes: NDArray[Any], kept: NDArray[np.bool_]) -> _Net:
    """Each edge of the grid whose ends differ has a quadrangle, whose corners are the vertices of the four cells around it.

    Those without a code that is `kept` are left out.
    """
    count, n, wide = 0, codes.shape[2], codes.shape[2] - 1  # samples and cells in a row
    cells, around = [np.zeros((0, 3), np.int32)], [np.zeros((0, 8), codes.dtype)]
    made = [(np.zeros((0, 4), np.int32), np.zeros((0, 2), codes.dtype))]
    before = np.empty((codes.shape[1] - 1) * wide, np.int32)  # the vertices of a layer of cells, by their places in it
    steps = _crossed(codes)
    along_x, along_y, _ = next(steps)
    for k, (next_x, next_y, along_z) in enumerate(steps):
        plane, following = codes[k].ravel(), codes[k + 1].ravel()
        in_y = along_x | next_x
        in_x = along_y | next_y | along_z[1:] | along_z[:-1]
        some = np.flatnonzero(in_y[1:] | in_y[:-1] | in_x[:, 1:] | in_x[:, :-1])
        numbered = np.empty_like(before)
        numbered[some] = np.arange(count, count + len(some))
        count += len(some)
        y, x = np.divmod(some, wide)
        cells.append(np.stack([x - 1, y - 1, np.full_like(x, k - 1)], axis=1).astype(np.int32))
        around.append(np.stack([one[some + y + more] for one in (plane, following) for more in (0, 1, n, n + 1)], axis=1))

        at = np.flatnonzero(along_x)
        start = at + at // wide
        ring = before[at - wide], before[at], numbered[at], numbered[at - wide]
        made.append(_kept(ring, (plane[start], plane[start + 1]), kept))
        start = np.flatnonzero(along_y)
        at = start - start // n
        ring = before[at - 1], numbered[at - 1], numbered[at], before[at]
        made.append(_kept(ring, (plane[start], plane[start + n]), kept))
        start = np.flatnonzero(along_z)
        at = start - start // n
        ring = numbered[at - n], numbered[at - wide], numbered[at], numbered[at - 1]
        made.append(_kept(ring, (plane[start], following[start]), kept))
        before, along_x, along_y = numbered, next_x, next_y
    return _Net(*map(np.concatenate, (cells, around, *zip(*made, strict=True))))


def _kept(ring: tuple[Quads, ...], ends: tuple[NDArray[Any], ...], kept: NDArray[np.bool_]) -> tuple[Quads, NDArray[Any]]:
    """Quadrangles with a label that is kept behind each, the smaller one of two; and the codes behind and in front."""
    first, second = ends
    a, b, c, d = ring
    turned = kept[second] & ~(kept[first] & (first < second))
    quads = np.stack([a, np.where(turned, d, b), c, np.where(turned, b, d)], axis=1)
    pairs = np.stack([np.where(turned, second, first), np.where(turned, first, second)], axis=1)
    some = kept[pairs[:, 0]]
    return (quads, pairs) if some.all() else (quads[some], pairs[some])


def _halved(places: NDArray[np.float32], quads: Quads) -> Indices:
    """Two triangles for each quadrangle, along its shorter diagonal."""
    faces = np.empty((len(quads), 6), np.int64)
    for first in range(0, len(quads), PART):
        own = quads[first : first + PART]
        a, b, c, d = (np.take(places, corner, 0) for corner in own.T)
        turned = ((a - c) ** 2).sum(1) > ((b - d) ** 2).sum(1)
        own[turned] = np.roll(own[turned], 1, axis=1)
        faces[first : first + PART] = np.take(own, [0, 1, 2, 0, 2, 3], 1)
    return faces.reshape(-1, 3)
