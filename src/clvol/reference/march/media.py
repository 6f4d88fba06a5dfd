"""Pictures of several media in float64, by the documentation of `clvol.Scene`: extinctions add at the samples of each ray."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.filter.boundary import REGION_BOUNDARY, is_given
from clvol.filter.table import DEFAULT_FILTER, REGION_FILTER, as_filter
from clvol.reference.march.colored import colored
from clvol.reference.march.graded import graded
from clvol.reference.march.light import light_of, shown_as
from clvol.reference.march.march import boundaries_by, flat_below, planes_across, shade
from clvol.reference.march.rays import Rays, camera_rays, kept_parts
from clvol.reference.march.roots import crossings_by, first_crossings
from clvol.reference.spline.points import sample
from clvol.reference.spline.regions import labels_at, lead_gradient
from clvol.scene.camera import Camera, Viewpoint
from clvol.scene.clip import Cuts, cuts_of
from clvol.scene.light import usual_lights
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import TransferFunction
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume

__all__ = ["render_media"]

_OPAQUE = 1e9  # greatest optical thickness, so that colours of opaque matter have weights
_FACE = 16  # unit distances of matter that are as opaque as the face of a cut
_INSET = 1e-3  # of a step, inside both ends of a ray: the samples of regions there


def render_media(
    scene: Scene, camera: Camera, size: tuple[int, int], step: float = 0.5, *, lead: int = 0, shading: bool = True
) -> dict[str, Array]:
    """The picture of a scene's media in "composite", without termination, and its depth.

    The camera has a target and a radius, or a position; all media have a transfer function, or surfaces with numbers as isovalues,
    each crossing of which is at the place of the nearest sample. A boundary of smooth regions is at that of the sample behind it,
    and where a ray enters their medium it is before its first sample's. The grid of medium number `lead` has
    the planes of the samples, whose stretches are half a step to either side, except from where a ray enters a medium to the first
    of its samples, and from the last to where it leaves. A ray that meets none has a sample in its middle, at the next plane's
    place. A ray that enters at the face of a cut has the slice, unlit, for 16 unit distances, at the place before its first sample.
    """
    width, height = size
    scene = replace(scene, lights=usual_lights(scene.lights, linear=scene.linear_light))
    volume = scene.media[lead].volume
    view = camera.view(volume, width / height)
    t, world_step = _places(scene, volume, view, size, step)
    optical, light = np.zeros(t.shape), np.zeros((*t.shape, 3))

    def add(which: NDArray[np.intp], slot: NDArray[np.intp], thickness: Array, rgb: Array) -> None:
        thickness = np.minimum(thickness, _OPAQUE)
        np.add.at(optical, (which, slot), thickness)
        np.add.at(light, (which, slot), thickness[:, None] * rgb)

    for medium in scene.media:
        whole = camera_rays(medium.volume, view, size, (0.5, 0.5), None, medium.boundary.edge)
        unit = (medium.transfer and medium.transfer.unit_distance) or medium.volume.mean_spacing
        shown: Any = medium.surfaces  # as (isovalue, colour, opacity)
        for rays, face in _kept(whole, scene, medium):
            if shown:
                for value, color, opacity in shown:
                    plain = replace(medium, surfaces=None, transfer=TransferFunction(((0, color),), ((0, 0.5),)))
                    for which, at in crossings_by(partial(_first, medium, isovalue=value), medium.volume, rays):
                        _, rgb = _matter(plain, scene, rays, view, which, at, shading)
                        slot = np.abs(t[which] - at[:, None]).argmin(1)
                        add(which, slot, np.full(which.size, -math.log1p(-opacity) if opacity < 1 else math.inf), rgb)
                continue
            if medium.smooth:
                for entered in _regions(medium, scene, rays, view, t, world_step, shading):
                    add(*entered)
                continue
            which, slot, at, length = _samples(rays, t, world_step)
            stopped, rgb = _matter(medium, scene, rays, view, which, at, shading)
            thickness = np.multiply(stopped, length / unit, out=np.zeros_like(stopped), where=length > 0)
            add(which, slot, thickness, rgb)
            cut = np.flatnonzero(face)
            stopped, rgb = _matter(medium, scene, rays, view, cut, rays.enter[cut], shading=False)
            slot = (t[cut] < rays.enter[cut, None]).sum(1) - 1
            add(cut, slot, _FACE * stopped, rgb)
    opacity = -np.expm1(-optical)
    after = np.cumprod(1 - opacity, axis=1)
    before = np.concatenate([np.ones((len(after), 1)), after[:, :-1]], 1)
    share = before * opacity
    rgb = np.divide(light, optical[..., None], out=np.zeros_like(light), where=optical[..., None] > 0)
    colors, cover = np.einsum("nk,nkc->nc", share, rgb), share.sum(1)
    half = after <= 0.5
    depth = np.full(len(t), math.inf)
    some = np.flatnonzero(half.any(1))
    first = some, half[some].argmax(1)
    depth[some] = t[first] + (np.log(2 * before[first]) / optical[first] - 0.5) * world_step[some]
    if scene.background is None:
        colors = np.divide(colors, cover[:, None], out=np.zeros_like(colors), where=cover[:, None] > 0)
    else:
        behind = light_of(scene.background, scene.linear_light)
        colors, cover = colors + (1 - cover[:, None]) * behind, np.ones_like(cover)
    colors = shown_as(np.clip(colors, 0, 1), scene.linear_light)
    rgba = np.concatenate([colors, np.clip(cover[:, None], 0, 1)], 1)
    return {"rgba": rgba.reshape(height, width, 4), "depth": depth.reshape(height, width)}


def _places(scene: Scene, volume: Volume, view: Viewpoint, size: tuple[int, int], step: float) -> tuple[Array, Array]:
    """Distances of all samples of each ray, in order, (N, M), and each ray's world step, (N,)."""
    axis, planes = planes_across(volume, view, size[0] / size[1], step)
    rays = camera_rays(volume, view, size, (0.5, 0.5), None, 0.5)
    corners = np.concatenate([volume.world_to_index(_corners(medium)) for medium in scene.media])
    low, high = corners.min(0), corners.max(0)
    spacing = volume.size[axis] / planes
    start = volume.world_to_index(rays.origin)
    slope = rays.direction @ volume.world_to_index_matrix.T
    length = np.linalg.norm(slope, axis=1)
    steep = np.abs(slope[:, axis]) >= 0.5 * length
    numbers = np.arange(math.floor((low[axis] + 0.5) / spacing - 1), math.ceil((high[axis] + 0.5) / spacing + 1))
    along = np.where(steep, slope[:, axis], 1.0)
    t = np.sort((-0.5 + (numbers + 0.5) * spacing - start[:, axis, None]) / along[:, None], axis=1)
    own = step / length
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - start) / slope, (high - start) / slope])
    enter = np.fmin(ends[0], ends[1]).max(1)
    if not view.orthographic:
        enter = np.maximum(enter, 0.0)
    count = 1 + math.ceil(float(np.linalg.norm(high - low)) / step)
    oblique = enter[:, None] + (np.arange(count) + 0.5) * own[:, None]
    every = np.full((len(t), 1 + max(len(numbers), count)), math.inf)
    every[:, 0] = -math.inf  # a place before all samples
    every[steep, 1 : 1 + len(numbers)] = t[steep]
    every[~steep, 1 : 1 + count] = oblique[~steep]
    return every, np.where(steep, spacing / np.abs(along), own)


def _kept(rays: Rays, scene: Scene, medium: Medium) -> list[tuple[Rays, NDArray[np.bool_]]]:
    """The parts of a medium's rays that the scene's cuts and its own keep, and which of them begin at a face."""
    cuts, own = cuts_of(scene.clip), cuts_of(medium.clip)
    parts = kept_parts(rays, cuts) if cuts != Cuts() else [(rays, np.zeros(len(rays.enter), np.bool_))]
    if own == Cuts():
        return parts
    return [(each, begins | (face & (each.enter == part.enter))) for part, face in parts for each, begins in kept_parts(part, own)]


def _corners(medium: Medium) -> Array:
    low, high = -medium.boundary.edge, np.asarray(medium.volume.size) - 1 + medium.boundary.edge
    return medium.volume.index_to_world(low + np.array(list(itertools.product((0, 1), repeat=3))) * (high - low))


def _samples(rays: Rays, t: Array, step: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
    """Of each sample of a medium its ray, its place among the ray's, its distance and the length of its stretch."""
    hit = rays.enter <= rays.leave
    inside = hit[:, None] & (t >= rays.enter[:, None]) & (t <= rays.leave[:, None])
    ends = np.where(np.isfinite(t), t, 0.0)
    near, far = ends - step[:, None] / 2, ends + step[:, None] / 2
    some = np.flatnonzero(inside.any(1))
    near[some, inside[some].argmax(1)] = rays.enter[some]
    far[some, inside.shape[1] - 1 - inside[some, ::-1].argmax(1)] = rays.leave[some]
    which, slot = np.nonzero(inside)
    alone = np.flatnonzero(hit & ~inside.any(1))
    following = (t[alone] < rays.enter[alone, None]).sum(1)
    middle = (rays.enter[alone] + rays.leave[alone]) / 2
    return (
        np.concatenate([which, alone]),
        np.concatenate([slot, following]),
        np.concatenate([t[which, slot], middle]),
        np.concatenate([(far - near)[which, slot], rays.leave[alone] - rays.enter[alone]]),
    )


def _regions(
    medium: Medium, scene: Scene, rays: Rays, view: Viewpoint, t: Array, step: Array, shading: bool
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]]:
    """Regions that rays enter: of each the ray, its place among the samples, its optical thickness and its colour."""
    volume, row = medium.volume, as_filter(medium.filter or REGION_FILTER).name
    rule = medium.boundary.name if medium.boundary.edge and is_given(medium.boundary) else REGION_BOUNDARY
    lights = [light.placed(view) for light in scene.lights]
    linear = scene.linear_light

    def shades(labels: Array) -> Array:
        assert medium.transfer is not None
        classified = medium.transfer(labels)
        return np.concatenate([light_of(classified[..., :3], linear), classified[..., 3:]], -1)

    def value(points: Array) -> Array:
        return labels_at(volume, points, row, rule)[0].astype(np.float64)

    first, last = rays.enter + _INSET * step, rays.leave - _INSET * step  # rays have samples at both ends, too
    every = np.concatenate([first[:, None], t, last[:, None]], 1)
    before, behind = (t < rays.enter[:, None]).sum(1) - 1, (t <= rays.leave[:, None]).sum(1)
    slots = np.concatenate([before[:, None], np.broadcast_to(np.arange(t.shape[1]), t.shape), behind[:, None]], 1)
    every = np.where((every >= first[:, None]) & (every <= last[:, None]), every, math.inf)
    order = np.argsort(every, axis=1, kind="stable")
    every, slots = np.take_along_axis(every, order, 1), np.take_along_axis(slots, order, 1)
    there, values = np.isfinite(every), np.zeros(every.shape)
    values[there] = value(rays.at(every[there], np.nonzero(there)[0]))
    begins = np.flatnonzero(there[:, 0])
    with np.errstate(divide="ignore"):
        colors = shades(values[begins, 0])
        yield begins, before[begins], -np.log1p(-colors[:, 3]), colors[:, :3]
        for on, k, at, entered in boundaries_by(value, rays, every, there, values):
            colors = shades(entered)
            if shading:
                points, flat = rays.at(at, on), flat_below(volume, entered)
                gradient = lead_gradient(volume, points, row, rule) * (1 + np.abs(entered[:, None]))  # as its rounding error
                colors[:, :3] = shade(gradient, colors[:, :3], rays.direction[on], medium.material, lights, flat, linear=linear)
            yield on, slots[on, k], -np.log1p(-colors[:, 3]), colors[:, :3]


def _first(medium: Medium, rays: Rays, isovalue: float) -> Array:
    """Where rays cross a surface first."""
    row = as_filter(medium.filter or DEFAULT_FILTER)
    rule = medium.boundary if medium.boundary.edge else "mirror"
    return first_crossings(lambda p: sample(medium.volume, p, row, rule), medium.volume, row, rays, isovalue)


def _matter(
    medium: Medium, scene: Scene, rays: Rays, view: Viewpoint, which: NDArray[np.intp], t: Array, shading: bool
) -> tuple[Array, Array]:
    """The extinction of a unit distance of a medium at samples, and its colour."""
    volume, row = medium.volume, as_filter(medium.filter or DEFAULT_FILTER)
    rule = medium.boundary if medium.boundary.edge else "mirror"
    points = rays.at(t, which)
    values = sample(volume, points, row, rule)
    assert medium.transfer is not None
    linear = scene.linear_light
    slopes = (partial(sample, volume, points, row, rule, order) for order in (1, 2))
    rgb, opacity = graded(medium.transfer, values, *slopes, light=partial(light_of, linear=linear))
    seen = opacity > 0
    if medium.color_by is not None:
        rgb[seen] = colored(medium.color_by, points[seen], rgb[seen], linear=linear)
    if shading:
        flat = flat_below(volume, values[seen] - Stored.of(volume, row, medium.boundary).offset)
        lights = [light.placed(view) for light in scene.lights]
        gradient = sample(volume, points[seen], row, rule, 1)
        rgb[seen] = shade(gradient, rgb[seen], rays.direction[which[seen]], medium.material, lights, flat, linear=linear)
    with np.errstate(divide="ignore"):
        return -np.log1p(-opacity), rgb
