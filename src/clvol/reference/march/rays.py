"""Rays of a camera in the world, and their intersections with a volume, in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.scene.camera import Viewpoint
from clvol.scene.clip import Cuts
from clvol.volume.volume import Volume

__all__ = ["Rays", "camera_rays", "face_normals", "kept_parts", "rays_towards"]


@dataclass(frozen=True)
class Rays:
    """Rays in the world: ``p(t) = origin + t direction`` for ``enter <= t <= leave``.

    This is the interval inside the volume's domain and the clip box, and in front of a perspective eye; ``enter > leave`` for rays
    that miss.
    """

    origin: Array  # (N, 3)
    direction: Array  # of unit length, (N, 3)
    enter: Array  # (N,)
    leave: Array  # (N,)

    def at(self, t: Array, which: NDArray[Any] | slice = slice(None)) -> Array:
        """World positions at distances `t` of the rays `which`; (..., 3)."""
        return np.asarray(self.origin[which] + t[..., None] * self.direction[which])

    def __getitem__(self, which: NDArray[Any] | slice) -> Self:
        """Some of the rays."""
        return type(self)(self.origin[which], self.direction[which], self.enter[which], self.leave[which])


def camera_rays(
    volume: Volume,
    view: Viewpoint,
    size: tuple[int, int],
    offset: Sequence[float] = (0.5, 0.5),
    clip: tuple[Sequence[float], Sequence[float]] | None = None,
    edge: float = 0.5,
) -> Rays:
    """One ray a pixel, row by row from the top, `offset` of a pixel from its upper left corner.

    They are inside the domain as far as `edge` samples past the outer ones.

    With ``a = 2 (x + ox) / width - 1`` and ``b = 1 - 2 (y + oy) / height``, a pixel lies at
    ``h (a aspect right + b up)``. Perspective rays start at the eye along forward plus that;
    orthographic ones start at the eye plus that, along forward, and may run back.
    """
    width, height = size
    a = 2 * (np.arange(width) + offset[0]) / width - 1
    b = 1 - 2 * (np.arange(height) + offset[1]) / height
    plane = view.half_height * ((a * width / height)[None, :, None] * view.right + b[:, None, None] * view.up).reshape(-1, 3)
    if view.orthographic:
        origin, direction, nearest = view.eye + plane, np.broadcast_to(view.forward, plane.shape), -math.inf
    else:
        origin, direction, nearest = np.broadcast_to(view.eye, plane.shape), view.forward + plane, 0.0
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    enter, leave = _domain(volume, origin, direction, edge)
    if clip is not None:
        other_enter, other_leave = _slabs(origin, direction, np.asarray(clip[0], float), np.asarray(clip[1], float))
        enter, leave = np.maximum(enter, other_enter), np.minimum(leave, other_leave)
    return Rays(origin, direction, np.maximum(enter, nearest), leave)


def rays_towards(volume: Volume, points: Array, direction: Array, edge: float = 0.5) -> Rays:
    """Rays from world points, (N, 3), along a unit direction, as far as the domain goes."""
    along = np.broadcast_to(direction, points.shape)
    enter, leave = _domain(volume, points, along, edge)
    return Rays(points, along, np.maximum(enter, 0.0), leave)


def kept_parts(rays: Rays, cuts: Cuts) -> list[tuple[Rays, NDArray[np.bool_]]]:
    """The parts of rays that cuts keep, in order, and which of these begin at the face of a cut.

    A ray crosses the planes of all faces; between two successive crossings everything is kept, or nothing: that in the middle
    decides.
    """
    planes = _planes_of(cuts)
    met = rays.enter <= rays.leave
    enter, leave = np.where(met, rays.enter, 0.0), np.where(met, rays.leave, 0.0)
    crossings = [enter, leave]
    for normal, point in planes:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (point - rays.origin) @ normal / (rays.direction @ normal)
        crossings.append(np.clip(np.where(np.isnan(t), enter, t), enter, leave))
    t = np.sort(np.stack(crossings, 1), axis=1)
    middle = (t[:, 1:] + t[:, :-1])[..., None] / 2
    kept = cuts.keep(rays.origin[:, None] + middle * rays.direction[:, None])
    parts = [(np.ones_like(enter), np.zeros_like(enter)) for _ in range(len(cuts.corners) + 1)]  # where there is none, they miss
    number, inside = np.zeros(len(enter), int), np.zeros(len(enter), np.bool_)
    for j in range(t.shape[1] - 1):
        some = t[:, j + 1] > t[:, j]
        for i, (begin, end) in enumerate(parts):
            mine = some & kept[:, j] & (number == i)
            begin[mine & ~inside] = t[mine & ~inside, j]
            end[mine] = t[mine, j + 1]
        number += some & inside & ~kept[:, j]
        inside = np.where(some, kept[:, j], inside)
    return [(replace(rays, enter=begin, leave=end), (begin <= end) & (begin > rays.enter)) for begin, end in parts]


def face_normals(points: Array, direction: Array, cuts: Cuts) -> Array:
    """The unit normals of the faces of cuts on which points lie, (N, 3), against the rays' directions.

    A plane through a point is a face there if cuts keep one side of it only.
    """
    normals = np.full(points.shape, math.nan)
    for normal, point in _planes_of(cuts):
        aside = 1e-6 * normal * (1 + np.abs(points).max(initial=0))
        on = np.abs((points - point) @ normal) <= np.linalg.norm(aside)
        face = on & (cuts.keep(points - 10 * aside) != cuts.keep(points + 10 * aside))
        normals[face] = normal
    return np.asarray(np.where(((normals * direction).sum(-1) > 0)[:, None], -normals, normals))


def _planes_of(cuts: Cuts) -> list[tuple[Array, Array]]:
    """The normal and a point of the plane of each face."""
    planes = [(np.array(plane.normal), np.array(plane.point)) for plane in cuts.planes]
    for low, high in (*([cuts.box] if cuts.box else []), *((corner.low, corner.high) for corner in cuts.corners)):
        planes += [
            (axis, end * axis) for ends in (low, high) for axis, end in zip(np.eye(3), ends, strict=True) if math.isfinite(end)
        ]
    return planes


def _domain(volume: Volume, origin: Array, direction: Array, edge: float) -> tuple[Array, Array]:
    """The interval of lines inside the domain: a box in index space, to which the map from the world is affine."""
    start = volume.world_to_index(origin)
    slope = volume.world_to_index(origin + direction) - start
    return _slabs(start, slope, np.full(3, -edge), np.array(volume.size) - 1 + edge)


def _slabs(origin: Array, direction: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The interval of lines inside a box: the intersection of three intervals."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    parallel = direction == 0
    inside = (origin >= low) & (origin <= high)
    near = np.where(parallel, np.where(inside, -math.inf, math.inf), np.minimum(a, b))
    far = np.where(parallel, np.where(inside, math.inf, -math.inf), np.maximum(a, b))
    return near.max(-1), far.min(-1)
