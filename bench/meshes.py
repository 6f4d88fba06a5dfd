"""Meshes of an isosurface, beside scikit-image's and VTK's in the same run: time, and how far vertices are from the spline.

    python -m bench.meshes

A ball of 256³ samples with a smooth bump; medians over rounds that alternate. Aimed at: 1 s. "off" is the largest distance of a
vertex from the surface of the cubic spline, to first order, in voxels. scikit-image and VTK place vertices on edges of the grid by
linear interpolation. Those that are not installed are left out.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol

_EDGE, _ROUNDS, _LEVEL = 256, 5, 0.0


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


def main() -> None:
    """Measure, and print a table."""
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


if __name__ == "__main__":
    main()
