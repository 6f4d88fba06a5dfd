"""Are surfaces exact? ``python -m bench.roots`` compares a million random rays with float64.

The function is SciPy's spline, the truth `clvol.reference.march.roots`: eigenvalues in every cell of every ray. A ray is
correct if its depth is within 1e-4 voxel of the truth. Near a tangent no float32 result can be: such a ray counts as rounding
if its result is the truth for a ray moved by up to 1e-4 voxel, or for an isovalue moved by 3e-6 of the largest coefficient; or
if the function is that close to the isovalue at the result, and crosses it nowhere before. Everything else is wrong: a missed
surface, or one that is not the first.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol.filter.table import as_filter
from clvol.reference.march.rays import Rays, camera_rays
from clvol.reference.march.roots import first_crossings
from clvol.scene.camera import Camera

__all__ = ["DEPTH", "SCENES", "Count", "Surface", "check"]

Array = NDArray[np.float64]
DEPTH = 1e-4  # of a voxel
_SHIFT, _LIFT = 1e-4, 3e-6  # tolerances for rounding: of rays in voxels, of isovalues relative to the largest magnitude
_NEAR = 0.05  # voxels; near a tangent a tiny move of a ray moves the surface far along it
_EDGE = 63  # pixels along the edge of a picture: odd, so that some rays lie on planes of cells
_ORDERS = {"nearest": 0, "linear": 1, "bspline2": 2, "bspline3": 3, "bspline4": 4, "bspline5": 5}


@dataclass(frozen=True, eq=False)
class Surface:
    """A volume, an isovalue, and the function in float64."""

    volume: clvol.Volume
    isovalue: float
    filter: str = "bspline3"

    @cached_property
    def coefficients(self) -> Array:
        """Of SciPy's spline."""
        data, order = np.asarray(self.volume.data, np.float64), _ORDERS[self.filter]
        return np.asarray(ndimage.spline_filter(data, order, mode="mirror")) if order > 1 else data  # type: ignore[call-overload]

    def values(self, points: Array) -> Array:
        """At world positions (N, 3)."""
        at, order = self.volume.world_to_index(points)[:, ::-1].T, _ORDERS[self.filter]
        result = np.empty(at.shape[1])
        ndimage.map_coordinates(self.coefficients, at, result, order, "mirror", prefilter=False)  # type: ignore[call-overload]  # any order
        return result

    def depths(self, rays: Rays, which: Any, shift: Array | float = 0.0, lift: float = 0.0) -> Array:
        """The first crossings of the isovalue by some rays; both optionally moved."""
        some = rays[which]
        moved = replace(some, origin=some.origin + shift)
        return first_crossings(self.values, self.volume, as_filter(self.filter), moved, self.isovalue + lift)


@dataclass
class Count:
    """The outcome for a number of rays."""

    rays: int = 0
    hits: int = 0
    rounding: int = 0
    wrong: int = 0
    worst: float = 0.0  # error of depth of the others, in voxels


def _cube(n: int) -> tuple[Array, Array, Array]:
    z, y, x = np.meshgrid(*[np.linspace(-1, 1, n)] * 3, indexing="ij")
    return x, y, z


def _shell(thickness: float) -> Surface:
    """A smooth ridge with the given number of voxels above the isovalue."""
    x, y, z = _cube(25)
    width = 1.5
    ridge = np.exp(-((np.sqrt(x * x + y * y + z * z) - 0.6) ** 2) * 12**2 / (2 * width**2))
    return Surface(clvol.Volume(ridge), math.exp(-((thickness / 2) ** 2) / (2 * width**2)))


def _touching() -> Surface:
    """A parabola whose lowest samples equal the isovalue: a double root on every ray."""
    x, _, _ = _cube(17)
    return Surface(clvol.Volume(x * x), 0.0)


def _noise(filter: str, shape: tuple[int, int, int] = (15, 17, 16), **placed: Any) -> Surface:
    return Surface(clvol.Volume(np.random.default_rng(1).random(shape), **placed), 0.47, filter)


SCENES: dict[str, Callable[[], Surface]] = {
    "Marschner-Lobb, 25³": lambda: Surface(clvol.phantoms.marschner_lobb(25), 0.5),
    "noise": lambda: _noise("bspline3"),
    "noise, long voxels": lambda: _noise("bspline3", (9, 12, 14), spacing=(1.0, 0.5, 2.2), origin=(3.0, -2.0, 7.0)),
    "a shell 0.1 voxel thin": lambda: _shell(0.1),
    "double roots": _touching,
    **{f"noise, {name}": partial(_noise, name, (9, 10, 11)) for name in ("nearest", "linear", "bspline2", "bspline5")},
}


def _cameras(volume: clvol.Volume, rng: np.random.Generator) -> Iterator[Camera]:
    """Along the axes through samples and faces of cells, from outside, and from inside."""
    for azimuth, zoom in ((0.0, 1.0), (90.0, 1.7), (180.0, 1.0)):
        yield Camera.orbit(azimuth, 0, projection="orthographic", zoom=zoom, fit="volume")
    size = np.asarray(volume.spacing) * np.asarray(volume.size)
    for kind in itertools.cycle(range(3)):
        azimuth, elevation = rng.uniform(0, 360), rng.uniform(-85, 85)
        if kind == 0:
            yield Camera.orbit(azimuth, elevation, zoom=rng.uniform(0.8, 4), fit="volume")
        elif kind == 1:
            yield Camera.orbit(azimuth, elevation, projection="orthographic", zoom=rng.uniform(0.8, 3), fit="volume")
        else:
            eye = volume.center + (rng.random(3) - 0.5) * 0.8 * size
            yield Camera.look_at(eye, volume.center + rng.normal(size=3) * size)


def _box(volume: clvol.Volume, rng: np.random.Generator) -> tuple[Any, Any]:
    """A part of the domain, sometimes thin."""
    low, high = volume.corners.min(0), volume.corners.max(0)
    ends = np.sort(low + rng.random((2, 3)) * (high - low), 0)
    return ends[0], ends[1]


def check(surface: Surface, rays: int, seed: int = 0, edge: int = _EDGE, **options: Any) -> Count:
    """Compare pictures of a surface with the truth, for at least the given number of random rays; `options` are the renderer's."""
    count, rng, voxel = Count(), np.random.default_rng(seed), float(np.mean(surface.volume.spacing))
    largest = float(np.abs(surface.coefficients).max())
    with clvol.Renderer(surface.volume, surface.filter) as renderer:
        for camera in _cameras(surface.volume, rng):
            if count.rays >= rays:
                return count
            clip = _box(surface.volume, rng) if rng.random() < 0.25 else None
            shown: dict[str, Any] = {"isovalue": surface.isovalue, "outputs": "depth", "clip": clip, **options}
            got = renderer.render(camera, "isosurface", (edge, edge), **shown).reshape(-1).astype(np.float64)
            lines = camera_rays(surface.volume, camera.view(surface.volume, 1.0), (edge, edge), clip=clip)
            truth = surface.depths(lines, slice(None))
            count.rays += got.size
            count.hits += int(np.isfinite(truth).sum())
            error = _apart(got, truth) / voxel
            count.worst = max(count.worst, float(error[error <= DEPTH].max(initial=0.0)))
            off = np.flatnonzero(error > DEPTH)
            explained = _explained(surface, lines, off, got[off], voxel, largest)
            count.rounding += int(explained.sum())
            count.wrong += int((~explained).sum())
    return count


def _apart(a: Array, b: Array) -> Array:
    """The difference of two depths: zero if both are infinite, infinite if one is."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(a) & np.isinf(b), 0.0, np.abs(a - b))


def _explained(
    surface: Surface, rays: Rays, which: NDArray[np.int64], got: Array, voxel: float, largest: float
) -> NDArray[np.bool_]:
    """Whether the result is the truth for a slightly moved ray and isovalue."""
    across = np.cross(rays.direction[which], np.eye(3)[np.abs(rays.direction[which]).argmin(1)])
    sides = across, np.cross(rays.direction[which], across)
    explained = np.zeros(which.size, bool)
    moves = [(0, 0.0), *itertools.product((0, 1), (-1.0, 1.0, -0.3, 0.3))]
    for lift, (side, share) in itertools.product((0.0, -1.0, 1.0, -0.3, 0.3), moves):
        left = np.flatnonzero(~explained)
        depths = surface.depths(rays, which[left], share * _SHIFT * voxel * sides[side][left], lift * _LIFT * largest)
        explained[left] = _apart(got[left], depths) <= _NEAR * voxel
    # along a tangent plane the function stays within rounding of the isovalue: any place is right if nothing lies before it
    left = np.flatnonzero(~explained & np.isfinite(got))
    lift = _LIFT * largest
    there = np.abs(surface.values(rays.at(got[left], which[left])) - surface.isovalue) <= lift
    before = [surface.depths(rays, which[left], lift=sign * lift) < got[left] - _NEAR * voxel for sign in (-1.0, 1.0)]
    explained[left] = there & ~(before[0] & before[1])
    return explained


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=int, default=1_000_000, help="in all (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    wrong = 0
    for name, scene in SCENES.items():
        started = time.perf_counter()
        count = check(scene(), chosen.rays // len(SCENES), chosen.seed)
        wrong += count.wrong
        print(
            f"{name:24} {count.rays:9} rays  {count.hits:9} hits  {count.wrong:3} wrong  {count.rounding:5} rounding"
            f"  others within {count.worst:.1e} voxel  {time.perf_counter() - started:5.0f} s",
            flush=True,
        )
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
