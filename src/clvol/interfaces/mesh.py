"""Meshes of isosurfaces and of labels, whose vertices lie on the continuous function: `mesh` and `Mesh`.

VTK's flying edges says which edges of the grid a surface crosses and how they are joined; it gets nothing but which samples are
inside, so that a value equal to the isovalue leaves no hole. Where the surface lies is then asked of the function.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import as_path, flag, if_image, require_known, several, warn, whole
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.base.files import require_folder, require_suffix, staged
from clvol.base.frames import in_frame
from clvol.base.progress import Progress, part_of, require_callback
from clvol.device import as_device
from clvol.filter.table import PICTURE_FILTER
from clvol.interfaces.label_surfaces import as_number, label_surfaces
from clvol.interfaces.triangles import is_closed, normals_of, parted, require_room
from clvol.interop.dispatch import is_in_parts
from clvol.labels import name_of
from clvol.march.choose import without_masked
from clvol.march.function import row_for
from clvol.scene.mode import Isosurface
from clvol.scene.preset import Color, label_color
from clvol.spline.curvature import principal_curvatures
from clvol.spline.field import opened
from clvol.spline.function import ContinuousFunction, Frame
from clvol.spline.regions import region_boundary, region_filter, require_no_blending
from clvol.volume.histogram import label_numbers
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume, as_volume

if TYPE_CHECKING:
    from clvol.bricks.source import LazyVolume
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.volume.missing import Missing

__all__ = ["MESHES", "Mesh", "MeshOptions", "mesh"]

MESHES = (".stl", ".ply", ".obj", ".glb")
"""Suffixes of the files that `Mesh.save` writes."""

Points: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]

_RIM = 1 / 64  # of a voxel between the last plane of vertices and the face that closes a mesh there
_SLAB = 1 << 24  # samples that are reconstructed at once
_NEAR = 1e-6  # of the smallest spacing: distance from the surface at which a vertex stays
_FAR = 0.6  # voxels that a vertex moves along its gradient at most; then it stays on its edge of the grid
_CLEAR = 0.05  # of an edge between its ends and where a vertex starts, so that those around a sample on the surface stay apart
_STEPS, _HALVINGS = 6, 40
_PER_VERTEX = 400  # bytes of a vertex and its two triangles, while they are made


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles in the world, or all surfaces between the regions of labels.

    Attributes
    ----------
    vertices : ndarray of float64, shape (n, 3)
        World positions (x, y, z).
    faces : ndarray of int64, shape (m, 3)
        The vertices of each triangle, counterclockwise as seen from where values are lower, or from the label in front.
    normals : ndarray of float32, shape (n, 3)
        Unit vectors towards lower values, exactly the function's. Those of labels are means of those of the triangles around, which
        point to the label in front: the slopes of indicators follow the samples' steps more. Where a boundary between two of them
        meets the outer surface they are that one's, which has no dark lines there.
    curvature : ndarray of float32, shape (n, 2), or None
        Principal curvatures κ₁ ≥ κ₂ per world unit; positive where the surface bends away from its normal, as a sphere around
        high values does: 1 / radius. NaN on the faces that close a mesh.
    units, space : str
        Those of the volume.
    labels : ndarray of int64, shape (m, 2), or None
        Of labels: the one behind each triangle, and the one in front. The one behind is in `names`; if both are, it is the smaller
        one. In front of the faces of the domain is a number that is no label: -1, or lower if labels are negative.
    names, colors : mapping of int to str, and to (r, g, b)
        The labels whose surfaces are in the mesh, with their names, which may be "", and colours from 0 to 1.

    Examples
    --------
    >>> import clvol
    >>> ball = clvol.mesh(clvol.phantoms.sphere(32), 0.5)
    >>> ball.is_closed
    True
    """

    vertices: Points
    faces: NDArray[np.int64]
    normals: NDArray[np.float32]
    curvature: NDArray[np.float32] | None = None
    units: str = ""
    space: str = ""
    labels: NDArray[np.int64] | None = None
    names: Mapping[int, str] = dataclasses.field(default_factory=dict)
    colors: Mapping[int, Color] = dataclasses.field(default_factory=dict)

    def __repr__(self) -> str:
        of = "" if self.labels is None else f" of {len(self.names)} labels"
        return f"<Mesh of {len(self.faces)} triangles, {len(self.vertices)} vertices{of}>"

    def of(self, label: int | str) -> Mesh:
        """The surface of one label, by its number or name: closed, if the mesh was made so.

        Where two parts of a region touch along an edge, or in a point, each has vertices of its own.

        Raises
        ------
        OptionError
            The mesh is not of labels, or not of this one.

        Examples
        --------
        >>> import numpy as np, clvol
        >>> halves = np.repeat([[[1, 1, 2, 2]]], 4, 0).repeat(4, 1)
        >>> both = clvol.mesh(clvol.Volume(halves, labels=True), only=[1, 2])
        >>> both.is_closed, both.of(1).is_closed
        (True, True)
        """
        if self.labels is None:
            raise OptionError("of() takes a mesh of labels; got one of an isovalue")
        number = as_number(label, self.names)
        behind, front = (self.labels == number).T
        mine = behind | front
        faces, pairs, turned = self.faces[mine], self.labels[mine], front[mine]
        faces[turned], pairs[turned] = faces[turned, ::-1], pairs[turned, ::-1]
        split, sources = parted(faces)
        vertices = self.vertices[sources]
        normals = normals_of(vertices, split, np.isin(pairs[:, 1], list(self.names))).astype(np.float32)
        one = {"labels": pairs, "names": {number: self.names[number]}, "colors": {number: self.colors[number]}}
        return replace(self, vertices=vertices, faces=split, normals=normals, **one)

    @property
    def area(self) -> float:
        """In world units squared; each triangle counts once."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2

    @property
    def volume(self) -> float:
        """What a closed mesh holds, with all its labels, in world units cubed; negative if it is around lower values."""
        if not self.is_closed:
            raise OptionError("volume takes a closed mesh; got one with open edges: clvol.mesh(..., closed=True)")
        middle = self.vertices.mean(0) if len(self.vertices) else 0.0
        a, b, c = np.moveaxis((self.vertices - middle)[self._outer], 1, 0)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6

    @property
    def is_closed(self) -> bool:
        """Whether each edge belongs to two triangles, which run along it in opposite directions; of labels, in each surface."""
        if self.labels is None:
            return is_closed(self.faces)
        behind, front = self.labels.T
        both = np.isin(front, list(self.names))  # also the surface of the label in front
        return is_closed(np.concatenate([self.faces, self.faces[both, ::-1]]), np.concatenate([behind, front[both]]))

    @property
    def _outer(self) -> NDArray[np.int64]:
        """The triangles without those between two labels of the mesh."""
        return self.faces if self.labels is None else self.faces[~np.isin(self.labels[:, 1], list(self.names))]

    def save(self, path: str | os.PathLike[str], *, frame: Frame = "LPS") -> Path:
        """Write it to a file.

        Parameters
        ----------
        path : str or path-like
            ``.stl`` (triangles alone, in float32), ``.obj``, ``.ply`` or ``.glb`` (with normals; ``.ply`` with curvatures, too).
            Of labels, ``.obj`` and ``.glb`` hold an object for each, with its name and colour, ``.ply`` the triangles as they are,
            with colours, and properties "label" and "front", and ``.stl`` one label alone, as `of` gives it.
            A file that is there is replaced once the new one is whole. No format has units: coordinates are in the volume's.
        frame : {"LPS", "RAS"}
            Of coordinates, for a volume whose space is "LPS". Slicer reads STL, OBJ and PLY as LPS.

        Raises
        ------
        OptionError
            There is no triangle; or several labels for an ``.stl``; or `frame` is neither of these, or "RAS" for a volume that is
            not of a patient.
        FormatError
            Another suffix, or the file cannot be written.
        MissingDependencyError
            trimesh is missing: ``pip install "clvol[mesh]"``.
        """
        suffix, target = require_suffix(path, MESHES, "meshes"), as_path(path)
        require_folder(target)
        if not len(self.faces):
            raise OptionError("a mesh must have a triangle to be written; got none")
        if suffix == ".stl" and len(self.names) > 1:
            raise OptionError(f".stl files have no labels, and the mesh has {len(self.names)}: save each mesh.of(label), or a .ply")
        made = self._objects(frame) if self.labels is not None and suffix in (".obj", ".glb") else self.to_trimesh(frame=frame)
        with staged(target, suffix) as file:
            made.export(file, **({"vertex_normal": True} if suffix == ".ply" else {}))
        return target

    def to_trimesh(self, *, frame: Frame = "LPS") -> Any:
        """A `trimesh.Trimesh` with the same vertices, faces and normals; of labels, with their colours."""
        try:
            import trimesh
        except ModuleNotFoundError as error:
            raise MissingDependencyError('meshes for trimesh, and mesh files, need trimesh: pip install "clvol[mesh]"') from error
        vertices, normals = (in_frame(array, frame, self.space) for array in (self.vertices, self.normals.astype(float)))
        made = trimesh.Trimesh(vertices, self.faces, vertex_normals=normals, process=False)
        if self.curvature is not None:
            made.vertex_attributes |= {"k1": self.curvature[:, 0], "k2": self.curvature[:, 1]}
        if self.labels is not None:
            made.visual = trimesh.visual.ColorVisuals(made, face_colors=self._face_colors)
            kind = np.result_type(np.int32, *map(np.min_scalar_type, (self.labels.min(initial=0), self.labels.max(initial=0))))
            kind = kind if kind == np.int32 else np.dtype(np.float64)  # .ply has no longer integers
            made.face_attributes |= {"label": self.labels[:, 0].astype(kind), "front": self.labels[:, 1].astype(kind)}
        return made

    @property
    def _face_colors(self) -> NDArray[np.uint8]:
        assert self.labels is not None
        numbers, which = np.unique(self.labels[:, 0], return_inverse=True)
        shades: NDArray[np.uint8] = np.rint(255 * np.array([self.colors[n] for n in numbers.tolist()])).astype(np.uint8)
        return shades[which]

    def _objects(self, frame: Frame) -> Any:
        """A scene of trimesh's, of an object for each label."""
        import trimesh

        scene = trimesh.Scene()
        for number, name in self.names.items():
            made = self.of(number)
            if len(made.faces):
                shown = made.to_trimesh(frame=frame)
                shown.visual = trimesh.visual.ColorVisuals(shown, vertex_colors=made._face_colors[:1].repeat(len(made.vertices), 0))
                shown.metadata["name"] = name or f"label {number}"
                scene.add_geometry(shown, geom_name=shown.metadata["name"])
        return scene

    def to_pyvista(self) -> Any:
        """A `pyvista.PolyData` with the same points; "Normals", and "k1" and "k2" of curvature, are arrays of points.

        Of labels, "label", "front" and "colors" are arrays of cells.
        """
        try:
            import pyvista
        except ModuleNotFoundError as error:
            raise MissingDependencyError("to_pyvista needs pyvista: pip install pyvista") from error
        corners: Any = self.faces
        made = pyvista.PolyData.from_regular_faces(self.vertices, corners)
        made.point_data.active_normals = self.normals
        if self.curvature is not None:
            made.point_data["k1"], made.point_data["k2"] = self.curvature.T
        if self.labels is not None:
            made.cell_data["label"], made.cell_data["front"] = self.labels.T
            made.cell_data["colors"] = self._face_colors
        return made


class MeshOptions(TypedDict, total=False):
    """Options of `clvol.mesh`.

    Attributes
    ----------
    only : iterable of int or str
        Of labels: those whose surfaces are made, by number or name; default all but the background (`clvol.labels`).
    closed : bool
        Close the surface where it meets the faces of the domain, by parts of these; default True.
    faces : int
        Triangles at most, by VTK's quadric decimation; remaining vertices are placed on the surface again.
    curvature : bool
        Also compute principal curvatures at the vertices, from the exact second derivatives; default False.
    filter, boundary, device
        As of `clvol.render`: by default the mesh is what the picture shows. Of labels, as of `clvol.resample` with ``smooth=True``.
    nan : str or Missing
        How missing samples are treated, as by `Field`; where values are NaN there is nothing, and the surface ends. By default they
        are an error; "local" with a mask.
    mask : array-like of bool, shape of the volume
        True where a sample is missing, as of `clvol.Renderer`.
    progress : callable
        Called with the fraction done.
    """

    only: Iterable[int | str] | None
    closed: bool
    faces: int | None
    curvature: bool
    filter: str | Filter | None
    boundary: str | Boundary | None
    nan: str | Missing | None
    mask: ArrayLike | None
    device: Device | str | int | None
    progress: Progress | None


def mesh(
    volume: Volume | LazyVolume | ContinuousFunction | ArrayLike,
    isovalue: float | str | None = None,
    **options: Unpack[MeshOptions],
) -> Mesh:
    """The isosurface of a volume's continuous function, or the surfaces of labels, as triangles: to print, model or compute with.

    Parameters
    ----------
    volume : Volume, LazyVolume, Field, BrickedField or array-like, 3-D
        A Field of double precision places vertices of flat slopes more exactly. Labels (`Volume.is_labels`) are in memory.
    isovalue : float or str, optional
        As of `clvol.Isosurface`, which chooses the same if it is None. Labels have none.
    **options
        Those of `clvol.interfaces.mesh.MeshOptions`, which describes them: `closed`, `faces`, `curvature`, `filter`, ...

    Returns
    -------
    Mesh
        Its topology is that of marching cubes on the samples' grid: each edge of the grid whose ends lie on two sides has a vertex.
        Vertices lie on the function's surface within 1e-5 of the spacing, as far as float32 tells values apart; normals and
        curvatures are the function's. A surface without a triangle gives a `ClvolWarning`.

        Of labels: all surfaces between them, of shared triangles, and `Mesh.of` for that of one. A point belongs to the label
        whose indicator, reconstructed by a B-spline without a prefilter, is the largest there (as of `clvol.resample` with
        ``smooth=True``), the smaller one where two are equal. The topology is that of surface nets on these labels at the samples:
        a label that is largest at none of them is told of by a `ClvolWarning`; ``filter="linear"`` loses none. Vertices of cells
        with two labels lie where both are equal within 1e-5 of the spacing; those where more meet, at the place in their cell that
        is nearest to it for all of them, by least squares.

    Raises
    ------
    OptionError
        The volume does not have three axes; an unknown name, or a label that does not occur; `faces` is not at least 4; options of
        values for labels, or `only` for values.
    DataError
        Samples are missing, and `nan` does not say what to do; labels are no whole numbers.
    MissingDependencyError
        VTK is missing, for a volume without labels: ``pip install "clvol[mesh]"``.
    OutOfMemoryError
        The samples or the triangles do not fit; how many they are is known before they are made, and told by a `ClvolWarning` if
        they are 100 million or more.

    References
    ----------
    - W. E. Lorensen and H. E. Cline, "Marching cubes: a high resolution 3D surface construction algorithm", Computer
      Graphics (SIGGRAPH) 21(4), 1987, 163–169: reference [8] of the paper.
    - W. Schroeder, R. Maynard and B. Geveci, "Flying edges: a high-performance scalable isocontouring algorithm", IEEE
      Symposium on Large Data Analysis and Visualization, 2015, 33–40.
    - S. F. F. Gibson, "Constrained elastic surface nets: generating smooth surfaces from binary segmented data", Medical
      Image Computing and Computer-Assisted Intervention, 1998, 888–898.

    Examples
    --------
    >>> import numpy as np, clvol
    >>> ball = clvol.mesh(clvol.phantoms.sphere(32), 0.5, curvature=True)
    >>> bool(abs(ball.normals).max() <= 1)
    True
    """
    require_known("mesh", options, MeshOptions.__annotations__)
    closed, curvature = (flag(name, options.get(name, default)) for name, default in (("closed", True), ("curvature", False)))
    faces, progress, row = options.get("faces"), options.get("progress"), options.get("filter")
    require_callback("progress", progress)
    if faces is not None:
        whole("faces", faces, 4)
    given: Any = volume if isinstance(volume, ContinuousFunction) or is_in_parts(volume) else as_volume(volume)
    given, nan = without_masked(given, options.get("mask")), "error" if options.get("mask") is None else "local"
    known: Volume = getattr(given, "volume", given).preview()
    if known.ndim != 3:
        raise OptionError(f"a mesh is of a volume with 3 axes; got shape {known.shape}{if_image(known.shape)}")
    if known.is_labels:
        require_no_blending(
            isovalue=isovalue,
            faces=faces,
            curvature=curvature or None,
            nan=None if options.get("nan") == "error" else options.get("nan"),
            mask=options.get("mask"),
        )
        if not isinstance(given, Volume):
            raise OptionError(f"a mesh of labels takes them in memory: a LazyVolume's whole(), a Field's volume; got {volume!r}")
        return _of_labels(given, closed, options)
    flying_edges = _vtk()
    if options.get("only") is not None:
        raise OptionError(f"only is for labels: set Volume(..., labels=True) if the volume has some; got {options['only']!r}")
    level = Isosurface(isovalue).settled(known).isovalue
    assert isinstance(level, float)
    if not isinstance(given, ContinuousFunction):
        row = filter_for(given, row, PICTURE_FILTER) if isinstance(given, Volume) else row_for(given, row)
    with opened(given, row, options.get("boundary"), options.get("device"), nan=options.get("nan", nan)) as field:
        return _Surface(field, level, closed).mesh(flying_edges, faces, curvature, progress)


def _of_labels(volume: Volume, closed: bool, options: MeshOptions) -> Mesh:
    background, present = label_numbers(volume)
    names = {int(number): name_of(volume, int(number)) for number in present.tolist()}
    only = options.get("only")
    if only is not None:
        only = several("only", [only] if isinstance(only, (str, int, np.integer)) else only, "labels, by number or name")
    chosen = sorted(set(names) - {int(background)} if only is None else {as_number(label, names) for label in only})
    how = (region_filter(options.get("filter")), region_boundary(options.get("boundary")), as_device(options.get("device")))
    made = label_surfaces(volume, chosen, how, closed, options.get("progress"))
    if made.lost:
        some = ", ".join(map(str, made.lost[:8])) + (", ..." if len(made.lost) > 8 else "")
        warn(
            f"the mesh has no surface of {some}: too small for {how[0].name!r}, where other labels are the largest at all samples; "
            'filter="linear" loses none'
        )
    elif not len(made.faces):
        warn(f"the mesh is empty: {'no label was chosen' if not chosen else 'no label meets another one'}")
    kept = [number for number in chosen if number not in made.lost]
    return Mesh(
        made.vertices,
        made.faces,
        normals_of(made.vertices, made.faces, np.isin(made.labels[:, 1], kept)).astype(np.float32),
        units=volume.units,
        space=volume.space,
        labels=made.labels,
        names={number: names[number] for number in kept},
        colors={number: label_color(number, volume) for number in kept},
    )


def _vtk() -> Any:
    try:
        from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D
    except ModuleNotFoundError as error:
        raise MissingDependencyError('meshes need VTK: pip install "clvol[mesh]"') from error
    return vtkFlyingEdges3D


class _Surface:
    """A function's isosurface, and the grid on which it is looked for: samples, and planes at the faces of the domain.

    Places are indices (x, y, z) of samples; `planes` are the grid's along each axis. The first and the last of a closed surface
    have no values: everything there is outside.
    """

    def __init__(self, field: ContinuousFunction, level: float, closed: bool) -> None:
        self.field, self.level, self.closed, self.volume = field, level, closed, field.grid
        self.planes = [_planes(n, field.boundary.edge, closed) for n in self.volume.size]
        self.near = _NEAR * min(self.volume.spacing)

    def mesh(self, flying_edges: Any, most: int | None, curvature: bool, progress: Progress | None) -> Mesh:
        """Steps of `mesh`."""
        values = self._values(part_of(progress, 0, 0.4))
        inside = values >= self.level  # not where it is NaN
        crossings = sum(int(np.count_nonzero(part)) for plane in _pairs(inside) for part in plane)
        require_room(crossings, _PER_VERTEX)
        edges, faces = _joined(flying_edges, inside)
        if not len(faces):
            known = values[np.isfinite(values)]
            seen = f"values are from {known.min():g} to {known.max():g}" if len(known) else "no value is finite"
            warn(f"the mesh is empty: no surface of {self.level:g}, where {seen}")
        points = self._on_surface(edges, values, part_of(progress, 0.4, 0.9))
        del values, inside
        if most is not None and len(faces) > most:
            points, faces = _decimated(points, faces, most)
            points = self._along_gradients(points, (self._ends(points) == 0).all(1), None)[0]
        gradients = self.field.gradient(points).astype(np.float64)
        normals, ends = -gradients, self._ends(points)
        cap = ends.any(1)
        normals[cap] = ends[cap] @ self.volume.world_to_index_matrix
        if np.linalg.det(self.volume.index_to_world_matrix) < 0:
            faces = np.ascontiguousarray(faces[:, ::-1])
        flat = ~(np.linalg.norm(normals, axis=1) > 0)
        if flat.any():
            normals[flat] = normals_of(points, faces)[flat]
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        bent = None
        if curvature:
            bent = principal_curvatures(gradients, self.field.hessian(points).astype(np.float64)).astype(np.float32)
            bent[cap | flat] = np.nan
        if progress:
            progress(1.0)
        return Mesh(points, faces, normals.astype(np.float32), bent, self.volume.units, self.volume.space)

    def _values(self, progress: Progress | None) -> NDArray[Any]:
        """The function on the grid, [z, y, x]: by resampling at the samples, and at points on the planes between."""
        shape = tuple(len(planes) for planes in reversed(self.planes))
        values = memory.empty(shape, np.float64 if self.field.precision == "double" else np.float32, "the values on a mesh's grid")
        values[...] = -math.inf
        x, y, z = (np.flatnonzero(planes == np.rint(planes)) for planes in self.planes)
        if self.closed:
            x, y, z = ((k[(k > 0) & (k < len(planes) - 1)]) for k, planes in zip((x, y, z), self.planes, strict=True))
        if len(x) and len(y) and len(z):
            low = np.array([planes[k[0]] for k, planes in zip((x, y, z), self.planes, strict=True)])
            deep = max(1, _SLAB // (len(x) * len(y)))
            for k in range(0, len(z), deep):
                some = z[k : k + deep]
                grid = replace(
                    self.volume,
                    data=np.broadcast_to(np.uint8(0), (len(some), len(y), len(x))),
                    origin=tuple(self.volume.index_to_world(low + np.array([0, 0, k]))),
                )
                part = self.field.resample(like=grid, progress=part_of(progress, 0.9 * k / len(z), 0.9 * (k + len(some)) / len(z)))
                values[some[0] : some[-1] + 1, y[0] : y[-1] + 1, x[0] : x[-1] + 1] = part.data
        inner = [np.arange(self.closed, len(planes) - self.closed) for planes in self.planes]
        for axis, samples in enumerate((x, y, z)):
            for k in np.setdiff1d(inner[axis], samples):
                places = [np.array([k]) if other == axis else planes for other, planes in enumerate(inner)]
                at = np.stack(np.meshgrid(*(p[q] for p, q in zip(self.planes, places, strict=True)), indexing="ij"), axis=-1)
                values[np.ix_(*places[::-1])] = self.field(self.volume.index_to_world(at)).T
        return values

    def _on_surface(self, edges: NDArray[np.int64], values: NDArray[Any], progress: Progress | None) -> Points:
        """World positions of vertices, which lie on the grid's edges (n, 2, 3) from one plane to the next."""
        ends = np.stack([planes[edges[..., axis]] for axis, planes in enumerate(self.planes)], axis=-1)
        there = values[edges[..., 2], edges[..., 1], edges[..., 0]] - self.level
        ends[there[:, 0] < 0] = ends[there[:, 0] < 0, ::-1]  # from inside to outside
        ends[np.isnan(there[:, 0])] = ends[np.isnan(there[:, 0]), ::-1]
        above, below = np.nanmax(there, axis=1), np.where(np.isnan(there).any(1), np.nan, there.min(1))
        with np.errstate(invalid="ignore"):
            share = np.where(np.isinf(below), 1.0, above / (above - below))
        share[np.isnan(share)] = 0.5
        free = np.isfinite(below)
        share[free] = share[free].clip(_CLEAR, 1 - _CLEAR)
        points = self.volume.index_to_world(ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0]))
        last = np.array([len(planes) - 1 for planes in self.planes])
        rim = np.any(
            ((edges <= self.closed) | (edges >= last - self.closed)).all(1), axis=1
        )  # along a face of the domain, or out of it
        points, placed = self._along_gradients(points, ~rim & free, part_of(progress, 0, 0.8))
        self._along_edges(points, ends, np.flatnonzero(~placed & ~np.isinf(below)), part_of(progress, 0.8, 1))
        return points

    def _along_gradients(self, points: Points, moved: Flags, progress: Progress | None) -> tuple[Points, Flags]:
        """Newton's method along gradients: the points, of which those that were `moved` and lie on the surface now are true."""
        result, placed = points.copy(), np.zeros(len(points), bool)
        who = np.flatnonzero(moved)
        for step in range(_STEPS + 1):
            if not len(who):
                break
            error = self.field(result[who]).astype(np.float64) - self.level
            slope = self.field.gradient(result[who]).astype(np.float64)
            with np.errstate(invalid="ignore", divide="ignore"):
                move = slope * (error / (slope**2).sum(1))[:, None]
            away = np.linalg.norm(move, axis=1)
            goal = self.near if step < _STEPS else 10 * self.near
            placed[who] = away <= goal
            there = result[who] - move
            far = np.abs((there - points[who]) @ self.volume.world_to_index_matrix.T).max(1)
            goes = (away > goal) & (far <= _FAR)
            if step < _STEPS:
                result[who[goes]] = there[goes]
            who = who[goes]
            if progress:
                progress((step + 1) / (_STEPS + 1))
        result[moved & ~placed] = points[moved & ~placed]
        return result, placed

    def _along_edges(self, points: Points, ends: Points, who: NDArray[np.intp], progress: Progress | None) -> None:
        """Halve the edges of these vertices until their ends are on the surface."""
        inner, outer = ends[who, 0], ends[who, 1]
        for step in range(_HALVINGS if len(who) else 0):
            middle = (inner + outer) / 2
            is_inside = self.field(self.volume.index_to_world(middle)) >= self.level
            inner, outer = np.where(is_inside[:, None], middle, inner), np.where(is_inside[:, None], outer, middle)
            if progress:
                progress((step + 1) / _HALVINGS)
        points[who] = self.volume.index_to_world((inner + outer) / 2)

    def _ends(self, points: Points) -> Points:
        """Of which faces of the domain points are that close the mesh: -1, 0 or 1 along each axis."""
        if not self.closed:
            return np.zeros_like(points)
        places = self.volume.world_to_index(points)
        first, last = (np.array([planes[k] for planes in self.planes]) for k in (0, -1))
        return (places > last - _RIM / 2).astype(np.float64) - (places < first + _RIM / 2)


def _planes(n: int, edge: float, closed: bool) -> NDArray[np.float64]:
    """Planes of the grid along an axis of n samples, whose domain ends `edge` outside the outer ones."""
    first, last, samples = -edge, n - 1 + edge, np.arange(n, dtype=np.float64)
    if not closed:
        return np.union1d(samples, [first, last])
    inner = samples[(samples > first + _RIM) & (samples < last - _RIM)]
    return np.unique([first, first + _RIM, *inner, last - _RIM, last]) if last > first else np.array([first, last])


def _pairs(inside: Flags) -> Iterator[tuple[Flags, ...]]:
    """Where neighbours differ, plane by plane."""
    for k, plane in enumerate(inside):
        yield np.diff(plane, axis=0), np.diff(plane, axis=1), np.diff(inside[k : k + 2], axis=0)


def _joined(flying_edges: Any, inside: Flags) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The grid's edges that cross the surface, shape (n, 2, 3), and the triangles of their vertices."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(*inside.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(inside.view(np.uint8).ravel()))  # type: ignore[no-untyped-call]
    found = flying_edges()
    found.SetInputData(image)
    found.SetValue(0, 0.5)
    found.ComputeNormalsOff()
    found.ComputeGradientsOff()
    found.ComputeScalarsOff()
    found.Update()
    made = found.GetOutput()
    if not made.GetNumberOfPolys():
        return np.zeros((0, 2, 3), np.int64), np.zeros((0, 3), np.int64)
    doubled = np.rint(2 * vtk_to_numpy(made.GetPoints().GetData())).astype(np.int64)  # type: ignore[no-untyped-call]
    lower = doubled // 2  # all lie in the middle of an edge
    faces = vtk_to_numpy(made.GetPolys().GetConnectivityArray())  # type: ignore[no-untyped-call]
    return np.stack([lower, lower + doubled % 2], axis=1), faces.reshape(-1, 3).astype(np.int64)


def _decimated(points: Points, faces: NDArray[np.int64], most: int) -> tuple[Points, NDArray[np.int64]]:
    """A mesh of at most as many triangles, near the same surface."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkFiltersCore import vtkQuadricDecimation

    given, places, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    places.SetDataTypeToDouble()
    places.SetData(numpy_to_vtk(points))  # type: ignore[no-untyped-call]
    cells.SetData(3, numpy_to_vtkIdTypeArray(faces.ravel()))  # type: ignore[no-untyped-call]
    given.SetPoints(places)
    given.SetPolys(cells)
    fewer = vtkQuadricDecimation()
    fewer.SetInputData(given)
    fewer.SetTargetReduction(1 - most / len(faces))
    fewer.VolumePreservationOn()
    fewer.Update()
    made = fewer.GetOutput()
    left = vtk_to_numpy(made.GetPolys().GetConnectivityArray()).reshape(-1, 3)  # type: ignore[no-untyped-call]
    used, faces = np.unique(left, return_inverse=True)
    return vtk_to_numpy(made.GetPoints().GetData())[used].astype(np.float64), faces.reshape(-1, 3)  # type: ignore[no-untyped-call]
