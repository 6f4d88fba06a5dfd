"""Surfaces between the smooth regions of labels, which share their triangles and vertices: the topology and places of `clvol.mesh`.

VTK's surface nets says how they are joined: a vertex in each cell of the grid whose corners lie in several regions, four of them
around each edge of the grid that leads from one region to another. Where in its cell a vertex lies is then asked of the indicators.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.base.progress import Progress, part_of
from clvol.interfaces.triangles import normals_of
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

_LISTED = 16  # labels in a message
_MOST = 1 << 53  # of numbers that are told apart
_NEAR = 1e-6  # of the smallest spacing: distance from the boundary at which a vertex stays
_FAR = 0.6  # of a cell, from its middle: as far as a vertex moves
_STEPS, _HALVINGS, _FLAT = 6, 30, 1e-2
_SMOOTHED, _WITHIN = 8, 0.9  # iterations that space vertices evenly, and how much of a cell they have for it
_PER_VERTEX = 600  # bytes of a vertex and its triangles, while they are made


class LabelSurfaces(NamedTuple):
    """Triangles, with the label behind and in front of each."""

    vertices: Points
    faces: Indices
    normals: Points
    labels: Indices
    lost: list[int]  # labels that were asked for, and are nowhere the largest


def as_number(label: object, names: Mapping[int, str]) -> int:
    """The number of a label that is given by its number or its name, and is one of these."""
    number = LabelTable(names).number_of(label)
    if number not in names:
        some = ", ".join(map(str, list(names)[:_LISTED])) + (", ..." if len(names) > _LISTED else "")
        raise OptionError(f"the label must be one that occurs: {some or 'none does'}; got {number}")
    return number


def _surface_nets() -> Any:
    try:
        from vtkmodules.vtkFiltersCore import vtkSurfaceNets3D
    except ModuleNotFoundError as error:
        raise MissingDependencyError("meshes need VTK: pip install clvol[mesh]") from error
    return vtkSurfaceNets3D


def label_surfaces(
    volume: Volume, chosen: Indices, how: tuple[Filter, Boundary, Device], closed: bool, progress: Progress | None
) -> LabelSurfaces:
    """The surfaces of some labels of a volume, which ascend.

    Of two labels that were both chosen the smaller one is behind a triangle, else the one that was. In front of triangles in the
    faces of the domain is a number below all labels, and below zero.
    """
    nets = _surface_nets()
    with Regions(volume, *how) as regions:
        low, high = (int(end) for end in volume.limits)
        if not -_MOST < low <= high < _MOST:
            raise OptionError(f"a mesh takes labels between -2**53 and 2**53; got {low} to {high}")
        grid = np.pad(regions.on(Target(np.eye(3), np.zeros(3), volume.shape), part_of(progress, 0, 0.2)), 1)
        numbers, codes = _coded(grid)
        lost = np.setdiff1d(chosen, numbers).tolist()
        numbers = np.concatenate([[min(0, low) - 1], numbers])
        crossings = sum(int(np.count_nonzero(np.diff(plane, axis=axis))) for plane in codes for axis in (0, 1))
        memory.require(crossings * _PER_VERTEX, f"a mesh of about {3 * crossings} triangles")
        points, faces, pairs = _joined(nets, codes, len(numbers) - 1)
        if progress:
            progress(0.5)
        kept = np.isin(numbers, chosen)
        faces, pairs = _kept(faces, pairs, kept, closed)
        met = np.zeros(len(points), bool)
        met[faces] = True
        points, faces = points[met], (np.cumsum(met) - 1)[faces]
        cells = np.floor(points).astype(np.int64)
        nearby = _Nearby(regions, volume, numbers, codes, cells)
        places, slopes = nearby.placed(points.astype(np.float64) - 1, part_of(progress, 0.5, 0.95))
    normals = nearby.ends @ volume.world_to_index_matrix
    exact = (nearby.counts == 2) & ~nearby.ends.any(1)
    normals[exact] = -slopes[exact] @ volume.world_to_index_matrix
    # from the label behind to that in front, which is the smaller one's unless that was not chosen
    behind = np.full(len(points), -1)
    behind[faces] = pairs[:, :1]
    turned = exact & (behind != nearby.corners[:, 0])
    normals[turned] *= -1
    vertices = volume.index_to_world(places)
    if np.linalg.det(volume.index_to_world_matrix) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    sharp = ~(exact | (nearby.counts == 1)) | ~(np.linalg.norm(normals, axis=1) > 0)
    normals[sharp] = normals_of(vertices, faces[sharp[faces].any(1)])[sharp]
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    if progress:
        progress(1.0)
    return LabelSurfaces(vertices, faces, normals, numbers[pairs], lost)


def _coded(grid: NDArray[Any]) -> tuple[Indices, NDArray[Any]]:
    """The numbers in a grid without its outermost samples, which ascend, and the grid of their places, from 1 on; 0 outside."""
    inner = (slice(1, -1),) * 3
    low, high = int(grid[inner].min()), int(grid[inner].max())
    if high - low < grid.size:
        seen = np.zeros(high - low + 1, bool)
        for plane in grid[inner]:
            seen[plane.astype(np.int64) - low] = True
        numbers = np.flatnonzero(seen) + low
        table = np.cumsum(seen).astype(np.min_scalar_type(len(numbers)))
        codes = np.zeros(grid.shape, table.dtype)
        for plane, coded in zip(grid[inner], codes[inner], strict=True):
            coded[...] = table[plane.astype(np.int64) - low]
        return numbers, codes
    numbers = np.unique(grid[inner])
    codes = np.zeros(grid.shape, np.min_scalar_type(len(numbers)))
    codes[inner] = np.searchsorted(numbers, grid[inner]) + 1
    return numbers.astype(np.int64), codes


def _joined(nets: Any, codes: NDArray[Any], count: int) -> tuple[NDArray[np.float32], Indices, Indices]:
    """Points in cells of the grid, x first, their triangles, and the codes behind and in front, of which the smaller is behind."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(*codes.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(codes.ravel()))  # type: ignore[no-untyped-call]
    found = nets()
    found.SetInputData(image)
    found.SetBackgroundLabel(0)
    for code in range(count):
        found.SetLabel(code, code + 1)
    found.SetOutputMeshTypeToTriangles()
    found.SetNumberOfIterations(_SMOOTHED)
    found.AutomaticSmoothingConstraintsOff()
    found.SetConstraintStrategyToConstraintBox()
    found.SetConstraintBox(_WITHIN, _WITHIN, _WITHIN)
    found.Update()
    made = found.GetOutput()
    if not made.GetNumberOfPolys():
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64), np.zeros((0, 2), np.int64)
    points = vtk_to_numpy(made.GetPoints().GetData())  # type: ignore[no-untyped-call]
    faces = vtk_to_numpy(made.GetPolys().GetConnectivityArray()).reshape(-1, 3)  # type: ignore[no-untyped-call]
    pairs = vtk_to_numpy(made.GetCellData().GetArray("BoundaryLabels")).astype(np.int64)  # type: ignore[no-untyped-call]
    # VTK has several points in some cells, and not for all of their faces: surfaces would be open there
    cells = np.ravel_multi_index(tuple(np.floor(points).astype(np.int64).T[::-1]), codes.shape)
    _, first, same = np.unique(cells, return_index=True, return_inverse=True)
    return points[first], same[faces], pairs


def _kept(faces: Indices, pairs: Indices, kept: NDArray[np.bool_], closed: bool) -> tuple[Indices, Indices]:
    """The triangles of labels that were chosen, with such a one behind each."""
    some = kept[pairs].any(1) & (closed | (pairs != 0).all(1))
    faces, pairs = faces[some], pairs[some]
    turned = ~kept[pairs[:, 0]]
    faces[turned], pairs[turned] = faces[turned, ::-1], pairs[turned, ::-1]
    return faces, pairs


class _Nearby:
    """The labels at the corners of cells, and where in its cell each vertex lies.

    Places are indices (x, y, z) of samples. `ends` says in which faces of the domain a vertex lies, -1, 0 or 1 along each axis:
    there it moves along the face alone.
    """

    def __init__(self, regions: Regions, volume: Volume, numbers: Indices, codes: NDArray[Any], cells: Indices) -> None:
        self.regions, self.numbers, self.spacing = regions, numbers, np.asarray(volume.spacing)
        x, y, z = cells.T
        around = [codes[z + k, y + j, x + i].astype(np.int64) for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        self.around = np.stack(around, axis=1) if len(cells) else np.zeros((0, 8), np.int64)
        ordered = np.sort(self.around, axis=1)
        fresh = np.concatenate([ordered[:, :1] > 0, (np.diff(ordered, axis=1) > 0)], axis=1)
        self.counts = fresh.sum(1)
        self.corners = np.sort(np.where(fresh, ordered, np.iinfo(np.int64).max), axis=1)  # the labels once each, then none
        self.low = cells - 1
        last = np.asarray(volume.size) - 1
        self.ends = (self.low == last).astype(np.float64) - (self.low == -1)
        edge = regions.boundary.edge
        self.faces = np.where(self.ends > 0, last + edge, -edge)

    def placed(self, places: Points, progress: Progress | None) -> tuple[Points, Points]:
        """Where vertices lie, that start there; and the slopes between the two labels of those that have two."""
        places = np.where(self.ends != 0, self.faces, places)
        slopes = np.zeros_like(places)
        two = np.flatnonzero(self.counts == 2)
        placed, there = self._between_two(places, two, slopes, part_of(progress, 0, 0.7))
        left = two[~there & ~self.ends[two].any(1)]
        placed[left] = self._halved(places[left], left)
        if len(left):
            slopes[left] = self._differences(placed, left, 1)[:, 1:]
        self._where_more_meet(placed, np.flatnonzero(self.counts > 2))
        return placed, slopes

    def _differences(self, places: Points, who: NDArray[np.intp], other: int) -> NDArray[np.float64]:
        """Of the first label of cells and another one of theirs: by how much it outweighs that, and the slopes of this."""
        pairs = self.numbers[self.corners[who][:, [0, other]]]
        return self.regions.between(places[who].T[::-1], pairs).astype(np.float64)

    def _between_two(
        self, places: Points, who: NDArray[np.intp], slopes: Points, progress: Progress | None
    ) -> tuple[Points, NDArray[np.bool_]]:
        """Newton's method along gradients: the places, and which of `who` lie on the boundary now."""
        result, there, left = places.copy(), np.zeros(len(who), bool), np.arange(len(who))
        near = _NEAR * self.spacing.min()
        for step in range(_STEPS + 1):
            if not len(left):
                break
            mine = who[left]
            found = self._differences(result, mine, 1)
            slopes[mine] = found[:, 1:]
            along = np.where(self.ends[mine] == 0, found[:, 1:], 0) / self.spacing**2
            with np.errstate(invalid="ignore", divide="ignore"):
                move = -along * (found[:, 0] / (along * found[:, 1:]).sum(1))[:, None]
            away = np.linalg.norm(move * self.spacing, axis=1)
            goal = near if step < _STEPS else 10 * near
            there[left] = away <= goal
            goes = (away > goal) & self._is_within(result[mine] + move, mine)
            result[mine[goes]] += move[goes]
            left = left[goes]
            if progress:
                progress((step + 1) / (_STEPS + 1))
        result[who[~there]] = places[who[~there]]
        return result, there

    def _is_within(self, places: Points, who: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether places are in or near their cells, and in the domain."""
        off = np.where(self.ends[who] == 0, np.abs(places - self.low[who] - 0.5), 0)
        return np.asarray((off <= _FAR).all(1) & self._in_domain(places))

    def _in_domain(self, places: Points) -> NDArray[np.bool_]:
        edge = self.regions.boundary.edge
        return np.asarray(((places >= -edge) & (places <= self.regions.size[:3] - 1 + edge)).all(1))

    def _halved(self, places: Points, who: NDArray[np.intp]) -> Points:
        """On the boundary, between these places and the nearest corner of the cell that lies in the other region."""
        start, end = places.copy(), places.copy()
        own = self._signs(start, who)
        offsets = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
        corners = self.low[who][:, None] + offsets
        distant = (((corners - start[:, None]) * self.spacing) ** 2).sum(-1)
        distant[(self.around[who] == self.corners[who][:, :1]) == own[:, None]] = np.inf
        end = np.take_along_axis(corners, distant.argmin(1)[:, None, None], axis=1)[:, 0].astype(np.float64)
        for _ in range(_HALVINGS if len(who) else 0):
            middle = (start + end) / 2
            same = (self._signs(middle, who) == own)[:, None]
            start, end = np.where(same, middle, start), np.where(same, end, middle)
        return (start + end) / 2

    def _signs(self, places: Points, who: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether places lie in the region of the first label of their cells, which ties belong to."""
        pairs = self.numbers[self.corners[who][:, :2]]
        return self.regions.between(places.T[::-1], pairs)[:, 0] >= 0

    def _where_more_meet(self, places: Points, who: NDArray[np.intp]) -> None:
        """Move vertices to where all labels of their cells weigh the same, by least squares (Gauss and Newton), in their cells."""
        low = np.where(self.ends[who] != 0, self.faces[who], self.low[who])
        high = np.where(self.ends[who] != 0, self.faces[who], self.low[who] + 1)
        for _ in range(_STEPS if len(who) else 0):
            square, right = np.zeros((len(who), 3, 3)), np.zeros((len(who), 3))
            for other in range(1, self.corners.shape[1]):
                some = np.flatnonzero(self.counts[who] > other)
                if len(some):
                    found = self._differences(places, who[some], other)
                    slope = np.where(self.ends[who[some]] == 0, found[:, 1:], 0) / self.spacing
                    square[some] += slope[:, :, None] * slope[:, None]
                    right[some] += slope * found[:, :1]
            moves = np.einsum("nij,nj->ni", np.linalg.pinv(square, _FLAT, hermitian=True), right) / self.spacing
            places[who] = (places[who] - moves).clip(low, high)
