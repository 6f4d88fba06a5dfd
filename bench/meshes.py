"""Meshes of an isosurface and of labels, beside scikit-image's and VTK's in the same run: time, and how far vertices are off.

    python -m bench.meshes

A ball of 256³ samples with a smooth bump; medians over rounds that alternate. Aimed at: 1 s. "off" is the largest distance of a
vertex from the surface of the cubic spline, to first order, in voxels. scikit-image and VTK place vertices on edges of the grid by
linear interpolation. Those that are not installed are left out.

Then labels: the shapes of `bench.labels`, whose distance functions are known, with how far vertices and normals are from the truth,
and by how much volume and area are, beside PyVista's surface nets, smoothed (`contour_labels`) or not; and 50 Voronoi regions of
random points in 256³. VTK smooths its surface nets by its defaults, and leaves them open at the faces of the volume.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from bench.labels import SHAPES, SPACINGS, Distances, regions, sampled
from clvol.interfaces.triangles import normals_of

_EDGE, _ROUNDS, _LEVEL = 256, 5, 0.0
_ROWS = ("linear", "bspline3-approx", "bspline5-approx", "wide(2)")


def samples() -> NDArray[np.float32]:
    """Values of a bumpy ball."""
    z, y, x = np.mgrid[:_EDGE, :_EDGE, :_EDGE].astype(np.float32) - (_EDGE - 1) / 2
    bump = 3 * np.sin(x / 7) * np.sin(y / 9) * np.sin(z / 8)
    return np.asarray(0.4 * _EDGE - np.sqrt(x * x + y * y + z * z) + bump, np.float32)


def ways(data: NDArray[np.float32]) -> dict[str, Callable[[], NDArray[Any]]]:
    """What makes the vertices, (x, y, z)."""
    volume = clvol.Volume(data)
    found: dict[str, Callable[[], NDArray[Any]]] = {
        "clvol": lambda: clvol.mesh(volume, _LEVEL, filter="bspline3").vertices,
        "clvol, curvature": lambda: clvol.mesh(volume, _LEVEL, filter="bspline3", curvature=True).vertices,
    }
    try:
        from skimage.measure import marching_cubes

        found["scikit-image"] = lambda: marching_cubes(data, _LEVEL)[0][:, ::-1]  # type: ignore[no-untyped-call]  # it has no types
    except ModuleNotFoundError:
        pass
    try:
        import pyvista

        grid = pyvista.wrap(np.asfortranarray(data.T))
        found["VTK, flying edges"] = lambda: np.asarray(grid.contour([_LEVEL], method="flying_edges").points)
    except ModuleNotFoundError:
        pass
    return found


def surface_nets(data: NDArray[Any]) -> Any:
    """VTK's output, smoothed."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkSurfaceNets3D

    nets: Any = vtkSurfaceNets3D
    image, found = vtkImageData(), nets()
    image.SetDimensions(*data.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(data.ravel()))  # type: ignore[no-untyped-call]
    found.SetInputData(image)
    for place, number in enumerate(np.unique(data[data > 0]).tolist()):
        found.SetLabel(place, number)
    found.SetOutputMeshTypeToTriangles()
    found.Update()
    return found.GetOutput()


def mesh_of(made: Any, name: str) -> clvol.Mesh:
    """That output as a mesh with the normals of its triangles."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    points, faces, labels = (
        np.asarray(vtk_to_numpy(array))  # type: ignore[no-untyped-call]
        for array in (made.GetPoints().GetData(), made.GetPolys().GetConnectivityArray(), made.GetCellData().GetArray(name))
    )
    corners = faces.reshape(-1, 3).astype(np.int64)
    normals = normals_of(points.astype(np.float64), corners)
    names = dict.fromkeys(np.unique(labels[labels > 0]).tolist(), "")
    return clvol.Mesh(points.astype(np.float64), corners, normals.astype(np.float32), labels=labels.astype(np.int64), names=names)


def contour_labels(volume: clvol.Volume, smoothing: bool) -> clvol.Mesh:
    """PyVista's, of surface nets."""
    import pyvista

    grid = pyvista.ImageData(dimensions=volume.size, spacing=volume.spacing, origin=volume.origin)
    grid.point_data["labels"] = volume.data.ravel()
    how: dict[str, Any] = {"boundary_style": "all", "pad_background": False, "output_mesh_type": "triangles"}
    made = grid.contour_labels(scalars="labels", smoothing=smoothing, **how)
    return mesh_of(made, "boundary_labels")


def of_shapes(spacing: tuple[float, float, float]) -> None:
    """Measure the shapes of `bench.labels` with one spacing."""
    closed_forms = {
        "ball of radius 9.4": (4 / 3 * np.pi * 9.4**3, 4 * np.pi * 9.4**2),
        "ball of radius 14": (4 / 3 * np.pi * 14**3, 4 * np.pi * 14**2),
        "torus, 11.2 and 4.7": (2 * np.pi**2 * 11.2 * 4.7**2, 4 * np.pi**2 * 11.2 * 4.7),
        "two balls that touch": (8 / 3 * np.pi * 8**3, 8 * np.pi * 8**2),
    }
    print(f"\nspacing {spacing}: off, RMS in the smallest spacing, largest in voxels; normals, RMS; volume and area")
    for shape, distances_at in SHAPES.items():
        volume = sampled(distances_at, spacing)
        made = {row: clvol.mesh(volume, filter=row, closed=False) for row in _ROWS}
        if find_spec("pyvista"):
            made |= {"surface nets": contour_labels(volume, False), "contour_labels": contour_labels(volume, True)}
        print(f"  {shape}")
        for name, one in made.items():
            index = volume.world_to_index(one.vertices)
            rim = 0 if shape in closed_forms else 1  # samples
            inner = ((index >= rim) & (index <= np.array(volume.size) - 1 - rim)).all(1)
            off, slopes = _nearest(distances_at, one.vertices[inner])
            angles = np.degrees(np.arccos(np.abs((one.normals[inner] * slopes).sum(1)).clip(0, 1)))
            voxels = off / np.linalg.norm(slopes * spacing, axis=1)
            cells = f"{_rms(off) / min(spacing):.3f} {voxels.max():5.2f} {_rms(angles):5.1f}°"
            if shape in closed_forms and one.is_closed:
                held, area = closed_forms[shape]
                cells += f"  {one.volume / held - 1:+.2%} {one.area / area - 1:+.2%}"
            print(f"    {name:16} {cells}")


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


def of_labels() -> None:
    """Measure labels, and print the tables."""
    for spacing in SPACINGS:
        of_shapes(spacing)
    data = regions(_EDGE, 50)
    regions_of_points = clvol.Volume(data, labels=True)
    ways: dict[str, Callable[[], Any]] = {
        "clvol": lambda: clvol.mesh(regions_of_points),
        "VTK, smoothed": lambda: surface_nets(data),
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(_ROUNDS):
        for name, make in ways.items():
            begun = time.perf_counter()
            make()
            seconds[name].append(time.perf_counter() - begun)
    for name, taken in seconds.items():
        print(f"50 labels of {_EDGE}³, {name:14} {statistics.median(taken[1:]):5.2f} s")


def _nearest(distances: Distances, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far points are from the nearest surface, and the normals there."""
    found = np.stack(distances(points))
    nearest = np.abs(found).argmin(0)[None]
    step = 1e-5
    slopes = [np.stack(distances(points + step * axis)) - np.stack(distances(points - step * axis)) for axis in np.eye(3)]
    there = np.stack([np.take_along_axis(slope, nearest, 0)[0] for slope in slopes], axis=-1)
    return np.abs(np.take_along_axis(found, nearest, 0)[0]), there / np.linalg.norm(there, axis=1)[:, None]


def main() -> None:
    """Measure, and print the tables."""
    data = samples()
    makers = ways(data)
    seconds: dict[str, list[float]] = {name: [] for name in makers}
    vertices: dict[str, NDArray[Any]] = {}
    for _ in range(_ROUNDS):
        for name, make in makers.items():
            begun = time.perf_counter()
            vertices[name] = make()
            seconds[name].append(time.perf_counter() - begun)
    with clvol.Field(data, "bspline3", precision="double") as field:
        for name, taken in seconds.items():
            at = vertices[name].astype(np.float64)
            off = np.abs(field(at) - _LEVEL) / np.linalg.norm(field.gradient(at), axis=1)
            print(f"{name:20} {1000 * statistics.median(taken[1:]):7.0f} ms  {len(at):8} vertices  off {off.max():.1e}")
    of_labels()


if __name__ == "__main__":
    main()
