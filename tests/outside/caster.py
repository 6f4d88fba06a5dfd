"""A ray caster of its own: plain NumPy and SciPy in float64, which shares no line with clvol.

Cameras are what `clvol.Camera` documents, written down again as closed formulas; the function is SciPy's spline; along a ray it is
sampled far more finely than any picture, and then integrated, searched, or solved by Brent's method.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, optimize

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spline:
    """The B-spline through samples on a grid in the world.

    Parameters
    ----------
    data : ndarray, shape (nz, ny, nx)
    spacing, origin : three numbers, (x, y, z)
    direction : ndarray, shape (3, 3)
        Column j is the direction of index axis j, x first.
    order : int
        1 to 5.
    boundary : {"mirror", "reflect", "wrap"}
        As clvol has them.
    """

    data: ArrayLike
    spacing: Sequence[float] = (1.0, 1.0, 1.0)
    origin: Sequence[float] = (0.0, 0.0, 0.0)
    direction: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    order: int = 3
    boundary: str = "mirror"

    @property
    def size(self) -> Array:
        """Samples along x, y, z."""
        return np.array(np.shape(self.data)[::-1], float)

    @property
    def matrix(self) -> Array:
        """From index to world, without the origin."""
        return np.asarray(self.direction, float) * np.asarray(self.spacing, float)

    @cached_property
    def corners(self) -> Array:
        """Of the domain, half a voxel outside the outer samples; (8, 3)."""
        ends = itertools.product(*[(-0.5, n - 0.5) for n in self.size])
        return np.array(list(ends)) @ self.matrix.T + self.origin

    @property
    def center(self) -> Array:
        return self.corners.mean(axis=0)

    @property
    def radius(self) -> float:
        """Of the sphere through the farthest corners."""
        return float(np.linalg.norm(self.corners - self.center, axis=1).max())

    @cached_property
    def _coefficients(self) -> Array:
        data = np.asarray(self.data, float)
        return ndimage.spline_filter(data, self.order, mode=self._mode) if self.order > 1 else data

    @property
    def _mode(self) -> str:
        return {"wrap": "grid-wrap"}.get(self.boundary, self.boundary)

    def index(self, world: Array) -> Array:
        """Index positions (x, y, z) of world positions."""
        return np.linalg.solve(self.matrix, (world - self.origin).reshape(-1, 3).T).T.reshape(world.shape)

    def __call__(self, world: Array) -> Array:
        """Values at world positions; shape (..., 3) to (...)."""
        zyx = np.moveaxis(self.index(world)[..., ::-1], -1, 0)
        return ndimage.map_coordinates(self._coefficients, zyx, order=self.order, mode=self._mode, prefilter=False)

    def gradient(self, world: Array, width: float = 1e-3) -> Array:
        """World gradients by differences of fourth order, `width` of the mean spacing wide; good to about 1e-8 of the range."""
        h = width * float(np.mean(self.spacing))
        slopes = []
        for axis in np.eye(3):
            near = self(world + h * axis) - self(world - h * axis)
            far = self(world + 2 * h * axis) - self(world - 2 * h * axis)
            slopes.append((8 * near - far) / (12 * h))
        return np.stack(slopes, -1)


@dataclass(frozen=True)
class Rays:
    """Rays ``origin + t direction``, ``enter <= t <= leave`` within the domain; ``enter > leave`` where they miss."""

    origin: Array
    direction: Array
    enter: Array
    leave: Array

    @property
    def hit(self) -> NDArray[np.bool_]:
        return self.enter < self.leave

    def at(self, t: Array) -> Array:
        """Positions at distances, shape (rays, ...); (rays, ..., 3)."""
        extra = (1,) * (t.ndim - 1)
        return self.origin.reshape(-1, *extra, 3) + t[..., None] * self.direction.reshape(-1, *extra, 3)

    def middles(self, count: int) -> tuple[Array, Array]:
        """The midpoints of `count` equal parts of every ray, (rays, count), and the length of a part, (rays,)."""
        length = np.where(self.hit, self.leave - self.enter, 0.0) / count
        start = np.where(self.hit, self.enter, 0.0)
        return start[:, None] + (np.arange(count) + 0.5) * length[:, None], length


def cast(
    spline: Spline,
    size: tuple[int, int],
    position: Sequence[float],
    target: Sequence[float] | None = None,
    up: Sequence[float] = (0.0, 0.0, 1.0),
    projection: Literal["perspective", "orthographic"] = "perspective",
    fov: float = 30.0,
    zoom: float = 1.0,
    clip: tuple[Sequence[float], Sequence[float]] | None = None,
    offset: tuple[float, float] = (0.5, 0.5),
) -> Rays:
    """The rays of ``clvol.Camera(position, target, up, ...)``, row by row from the top left, through `offset` of every pixel.

    The picture's half height is tan(fov / 2) at distance 1 in perspective; in parallel projection it is the radius of the
    volume's bounding sphere, or more where the picture is higher than wide. Distances count from the eye, or from the plane
    through it.
    """
    width, height = size
    aspect = width / height
    eye = np.asarray(position, float)
    forward = (spline.center if target is None else np.asarray(target, float)) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, float))
    right /= np.linalg.norm(right)
    above = np.cross(right, forward)
    parallel = projection == "orthographic"
    half = (spline.radius / min(1.0, aspect) if parallel else math.tan(math.radians(fov) / 2)) / zoom
    x, y = np.meshgrid((np.arange(width) + offset[0]) / width, (np.arange(height) + offset[1]) / height)
    plane = (half * aspect * (2 * x - 1))[..., None] * right + (half * (1 - 2 * y))[..., None] * above
    plane = plane.reshape(-1, 3)
    origin = eye + plane if parallel else np.broadcast_to(eye, plane.shape)
    direction = np.broadcast_to(forward, plane.shape) if parallel else forward + plane
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    start = spline.index(origin)
    enter, leave = _within(start, spline.index(origin + direction) - start, np.full(3, -0.5), spline.size - 0.5)
    if clip is not None:
        first, last = _within(origin, direction, np.asarray(clip[0], float), np.asarray(clip[1], float))
        enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    return Rays(origin, direction, enter if parallel else np.maximum(enter, 0), leave)


def _within(start: Array, slope: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The interval of each line inside a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / slope, (high - start) / slope
    beside = (slope == 0) & ((start < low) | (start > high))
    near = np.where(slope == 0, -np.inf, np.minimum(a, b))
    far = np.where(slope == 0, np.inf, np.maximum(a, b))
    near[beside], far[beside] = np.inf, -np.inf
    return near.max(axis=1), far.min(axis=1)


def maxima(spline: Spline, rays: Rays, count: int = 400) -> Array:
    """The largest value along each ray, NaN where it misses: the best of `count` samples, refined between its neighbours."""
    t, length = rays.middles(count)
    values = spline(rays.at(t))
    best = np.full(len(t), np.nan)
    for i in np.flatnonzero(rays.hit):
        k = int(values[i].argmax())
        bounds = max(rays.enter[i], t[i, k] - length[i]), min(rays.leave[i], t[i, k] + length[i])
        found = optimize.minimize_scalar(lambda s, i=i: -_value(spline, rays, i, s), bounds=bounds, method="bounded")
        best[i] = max(values[i, k], -float(found.fun))
    return best


def first_crossings(spline: Spline, rays: Rays, isovalue: float, count: int = 2000) -> Array:
    """Distance to where each ray first meets `isovalue`, inf where it does not; roots to 1e-12 of the distance.

    A ray that meets it twice within one of `count` parts may be taken to miss: `maxima` tells which are in doubt.
    """
    t, _ = rays.middles(count)
    t = np.concatenate([np.where(rays.hit, rays.enter, 0)[:, None], t, np.where(rays.hit, rays.leave, 0)[:, None]], axis=1)
    above = spline(rays.at(t)) >= isovalue
    changes = above[:, 1:] != above[:, :-1]
    distance = np.full(len(t), np.inf)
    for i in np.flatnonzero(rays.hit & changes.any(axis=1)):
        k = int(changes[i].argmax())
        distance[i] = optimize.brentq(lambda s, i=i: _value(spline, rays, i, s) - isovalue, t[i, k], t[i, k + 1], xtol=1e-12)
    return distance


def _value(spline: Spline, rays: Rays, i: int, t: float) -> float:
    return float(spline((rays.origin[i] + t * rays.direction[i])[None])[0])


def integrals(
    spline: Spline, rays: Rays, classify: Callable[[Array], Array], unit_distance: float, count: int = 2000
) -> tuple[Array, Array]:
    """Emission and absorption without light: premultiplied colours (rays, 3) and opacities (rays,).

    ``classify`` gives colour and opacity ``a`` of matter `unit_distance` thick, (..., 4), with ``a < 1``. The extinction is
    ``-ln(1 - a) / unit_distance``; both integrals are taken by the midpoint rule, within whose parts matter is uniform.
    """
    t, length = rays.middles(count)
    matter = classify(spline(rays.at(t)))
    depth = -np.log1p(-matter[..., 3]) / unit_distance * length[:, None]
    before = np.cumsum(depth, axis=1) - depth
    weight = np.exp(-before) * -np.expm1(-depth)
    return (weight[..., None] * matter[..., :3]).sum(axis=1), -np.expm1(-depth.sum(axis=1))
