"""Surfaces of a known function, rendered without samples or a filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.filter.filter import Filter
from clvol.reference.march.light import light_of, shown_as
from clvol.reference.march.march import camera_rays, pixel_rays, shade
from clvol.scene.camera import Viewpoint
from clvol.scene.light import Light, Material
from clvol.volume.volume import Volume

__all__ = ["draw_function"]

Function = Callable[[Array], Array]
_RAYS = 1 << 13  # rays at a time, to limit memory
_BISECTIONS = 45


def draw_function(
    function: Function,
    gradient: Function,
    volume: Volume,
    view: Viewpoint,
    size: tuple[int, int],
    *,
    isovalue: float,
    color: Sequence[float],
    lights: Sequence[Light],
    material: Material,
    background: Sequence[float],
    clip: tuple[Sequence[float], Sequence[float]] | None = None,
    rays: int = 1,
    pixel_filter: str | Filter = "linear",
    steps: int = 240,
    linear_light: bool = False,
) -> tuple[Array, NDArray[np.float32]]:
    """The first surface of a function within the domain of a volume, whose samples are ignored, and its picture in float32.

    `function` and `gradient` are called with world positions (N, 3); `steps` intervals of a ray are searched for a change of sign.
    The points of the surface, (N, 3), are those of the rays through the middle of a pixel.
    """
    width, height = size
    picture, points = np.zeros((height * width, 3)), []
    lit_by = [light.placed(view) for light in lights]
    for k, (offset, weight) in enumerate(pixel_rays(rays, pixel_filter)):
        cast = camera_rays(volume, view, size, offset, clip)
        crossing = np.flatnonzero(cast.enter < cast.leave)
        drawn = np.broadcast_to(light_of(background, linear_light), picture.shape).copy()
        for part in np.array_split(crossing, -(-crossing.size // _RAYS)) if crossing.size else []:
            hit, t = _first_crossing(
                lambda p: function(p) - isovalue, cast.origin[part], cast.direction[part], cast.enter[part], cast.leave[part], steps
            )
            at = cast.at(t, part[hit])
            colors = np.broadcast_to(light_of(color, linear_light), at.shape)
            drawn[part[hit]] = shade(gradient(at), colors, cast.direction[part[hit]], material, lit_by, 0.0, linear=linear_light)
            if k == 0:
                points.append(at)
        picture += drawn * weight
    opaque = np.concatenate([shown_as(np.clip(picture, 0, 1), linear_light), np.ones((height * width, 1))], -1)
    return np.concatenate(points or [np.empty((0, 3))]), opaque.reshape(height, width, 4).astype(np.float32)


def _first_crossing(
    function: Function, origin: Array, direction: Array, enter: Array, leave: Array, steps: int
) -> tuple[NDArray[np.int64], Array]:
    """Which rays meet a zero of `function` between `enter` and `leave`, and at which t, by bisection."""

    def along(t: Array, rays: NDArray[np.int64] | slice) -> Array:
        at = origin[rays][:, None] + t[..., None] * direction[rays][:, None]
        return function(at.reshape(-1, 3)).reshape(t.shape)

    t = enter[:, None] + np.linspace(0, 1, steps + 1) * (leave - enter)[:, None]
    negative = along(t, slice(None)) < 0
    changes = negative[:, 1:] != negative[:, :-1]
    hit = np.flatnonzero(changes.any(1))
    first = changes[hit].argmax(1)
    low, high, before = t[hit, first], t[hit, first + 1], negative[hit, first]
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        same = (along(middle[:, None], hit)[:, 0] < 0) == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return hit, (low + high) / 2
