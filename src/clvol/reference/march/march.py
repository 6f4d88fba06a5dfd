"""Pictures in float64: rays in world space, the function by eq. (8), colours by the exact transfer function.

It follows the documentation of `clvol.render`, not the kernels: nothing is in single precision, nothing is tabulated, all samples
of all rays are computed at once, and surfaces are found by bisection.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import Array
from clvol.base.checks import one_of
from clvol.base.color import color_of
from clvol.base.errors import OptionError
from clvol.filter.boundary import REGION_BOUNDARY, UNSAID_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.reference.march.colored import colored
from clvol.reference.march.graded import graded, shape_operator
from clvol.reference.march.light import light_of, reflected, shown_as
from clvol.reference.march.missing import continued, is_missing
from clvol.reference.march.rays import Rays, camera_rays, face_normals, kept_parts, rays_towards
from clvol.reference.march.roots import crossings_by, first_crossings
from clvol.reference.march.shadow import light_past
from clvol.reference.spline.points import sample
from clvol.reference.spline.regions import labels_at, lead_gradient
from clvol.scene.camera import Camera, Viewpoint
from clvol.scene.clip import Clip, Cuts, as_clip, cuts_of
from clvol.scene.fit import fitted, usual_camera
from clvol.scene.light import KIT, Light, Material, as_lights, usual_lights
from clvol.scene.mode import (
    DEFAULT_MODE,
    Attenuated,
    Composite,
    Integral,
    Isosurface,
    Mode,
    Regions,
    Surfaces,
    as_mode,
    mode_options,
    opacities_of,
    tolerance_of,
    virtual_samples,
)
from clvol.scene.scene import Medium
from clvol.scene.transfer import TransferFunction
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume, as_volume

__all__ = ["Rays", "boundaries_by", "camera_rays", "facing", "flat_below", "pixel_rays", "planes_across", "render", "shade"]

Bools: TypeAlias = NDArray[np.bool_]

_STEEP = 0.5  # cosine of 60°: rays farther from the axis step along themselves
_ROUNDING = 2.0**-19  # gradients below this share of the value per voxel may be rounding of the kernels' float32
_FACE = 16  # unit distances of matter that are as opaque as the face of a cut
_PAST = 1e-7  # voxels behind a crossing, from where the next is sought
_OFF = 1e-5  # voxels off a surface, from where rays go to lights
_FAINT = 1e-6  # rays through surfaces end where less light is left
_ENCLOSING = 24  # halvings of a step around a boundary of regions
_BISECTIONS = 38  # to 1e-12 of a step; down to the last bit, rounding could cross a jump again


def planes_across(volume: Volume, view: Viewpoint, aspect: float, step: float) -> tuple[int, int]:
    """The axis most parallel to the view, in index space, and K, how many planes across it are sampled.

    A ray at an angle α to the axis advances ``n / (K cos α)`` voxels from plane to plane. The picture's
    corners have the largest α; angles past 60° do not count, for such rays use no planes.
    """
    forward = volume.world_to_index_matrix @ view.forward
    axis = int(np.abs(forward).argmax())
    reach = 0.0 if view.orthographic else view.half_height
    corners = [
        volume.world_to_index_matrix @ (view.forward + reach * (a * aspect * view.right + b * view.up))
        for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1))
    ]
    cosine = min(math.copysign(1, forward[axis]) * d[axis] / np.linalg.norm(d) for d in corners)
    n = volume.size[axis]
    planes = 1
    while n / (planes * max(cosine, _STEEP)) > step * (1 + 1e-9):
        planes += 1
    return axis, planes


def _sample_distances(
    volume: Volume, rays: Rays, begin: Array, axis: int, planes: int, step: float, ends: bool
) -> tuple[Array, Bools, Array]:
    """Distances of the samples in order, (N, M), which of them exist, and each ray's world step, (N,).

    Along an axis of n samples, plane k lies at index ``-1/2 + (k + 1/2) n / K``; of labels, off the faces of voxels. With
    `ends`, the points where a ray enters and leaves are samples too, a thousandth of a step inside; then no other sample lies
    nearer to the edge. Without, a ray that meets no plane has one sample, halfway between where it enters and leaves. Rays too
    oblique to the axis step along themselves from `begin`, (N,).
    """
    n = volume.size[axis]
    start = volume.world_to_index(rays.origin)[:, axis]
    slope = rays.direction @ volume.world_to_index_matrix.T  # voxels a world unit
    length = np.linalg.norm(slope, axis=1)
    steep = np.abs(slope[:, axis]) >= _STEEP * length
    hit = rays.enter <= rays.leave

    along = np.where(steep, slope[:, axis], 1.0)
    odd = 2 * np.arange(planes) + 1
    places = -0.5 + odd * n / (2 * planes)
    if volume.is_labels and (odd * n % (2 * planes) == 0).any():
        places += 0.5 * math.gcd(n, planes) / planes
    t = (places - start[:, None]) / along[:, None]
    t = np.sort(t, axis=1)
    own = step / length
    span = np.where(hit & ~steep, rays.leave - begin, 0.0)
    steps = np.arange(1 + math.floor(float((span / own).max(initial=0.0))))
    with np.errstate(invalid="ignore"):
        oblique = np.where(hit, begin, 0.0)[:, None] + (steps + 0.5) * own[:, None]
    m = max(planes, steps.size)
    every = np.full((t.shape[0], m + 2), math.inf)
    every[steep, 1 : planes + 1] = t[steep]
    every[~steep, 1 : steps.size + 1] = oblique[~steep]
    world_step = np.where(steep, n / planes / np.abs(along), own)
    there = hit[:, None] & (every >= rays.enter[:, None]) & (every <= rays.leave[:, None])
    if ends:
        first, last = rays.enter + 1e-3 * world_step, rays.leave - 1e-3 * world_step
        there &= (every >= first[:, None]) & (every <= last[:, None])
        every[:, 0], every[:, -1] = first, last
        there[:, 0] = there[:, -1] = hit & (first <= last)
    else:
        alone = hit & ~there.any(1)
        every[alone, 0] = (rays.enter[alone] + rays.leave[alone]) / 2
        there[alone, 0] = True
    every = np.where(there, every, math.inf)
    order = np.argsort(every, axis=1, kind="stable")
    return np.take_along_axis(every, order, 1), np.take_along_axis(there, order, 1), world_step


def _stretches(scene: _Scene, rays: Rays, t: Array, there: Bools, step: Array) -> tuple[Array, Array]:
    """Start and end of the stretch of its ray that each sample represents, each (N, M); 0 to 0 without a sample.

    A stretch extends half a step to each side; the first starts at the ray's entry, the last ends at its exit. Where the place a
    step away, or the ray's end, is missing, a stretch ends at the edge in between.
    """
    every = np.isfinite(t)
    near, far = np.where(every, t - step[:, None] / 2, 0.0), np.where(every, t + step[:, None] / 2, 0.0)
    some = np.flatnonzero(every.any(1))
    first = every[some].argmax(1)
    near[some, first] = rays.enter[some]
    far[some, first + every[some].sum(1) - 1] = rays.leave[some]
    which, k = np.nonzero(there)
    here = t[which, k]
    near[which, k] = _to_edge(scene, rays, which, here, np.maximum(here - step[which], rays.enter[which]), near[which, k])
    far[which, k] = _to_edge(scene, rays, which, here, np.minimum(here + step[which], rays.leave[which]), far[which, k])
    return np.where(there, near, 0.0), np.where(there, far, 0.0)


def _to_edge(scene: _Scene, rays: Rays, which: NDArray[np.intp], t: Array, other: Array, end: Array) -> Array:
    """`end`, or where it is missing at `other`, the edge between t and that, by bisection."""
    beyond = scene.missing(rays.at(other, which))
    which, t, other = which[beyond], t[beyond], other[beyond]
    for _ in range(_BISECTIONS):
        middle = (t + other) / 2
        gone = scene.missing(rays.at(middle, which))
        t, other = np.where(gone, t, middle), np.where(gone, middle, other)
    end = end.copy()
    end[beyond] = t
    return end


def shade(
    gradient: Array,
    color: Array,
    direction: Array,
    material: Material,
    lights: Sequence[Light | _Left],
    flat: float | Array,
    *,
    linear: bool = False,
) -> Array:
    """Blinn-Phong: ``color (ka + kd Σ Lᵢ (n·lᵢ)⁺) + ks Σ Lᵢ ((n·hᵢ)⁺)ˢ``, with n towards the viewer.

    ``h`` is halfway between the light and the viewer; there is no highlight if the light is behind the surface. If the gradient is
    no longer than `flat` (`flat_below`) there is no normal, hence full diffuse light and no highlight. Lights are in the world
    (`Light.placed`). With `linear`, colours are light, and ka and kd those of `reflected`.
    """
    ambient, full = reflected(material, linear)
    normal, known = facing(gradient, direction, flat)
    normal = np.where(known[:, None], normal, 0.0)
    viewer = -direction
    diffuse, shine = np.zeros_like(color), np.zeros_like(color)
    for light in lights:
        to = viewer if light.direction is None else np.broadcast_to(np.asarray(light.direction), viewer.shape)
        half = to + viewer
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-10)
        cosine = np.where(known, np.maximum((normal * to).sum(1), 0.0), 1.0)
        highlight = np.maximum((normal * half).sum(1), 0.0) ** material.shininess
        highlight = np.where(known & (cosine > 0), highlight, 0.0)
        diffuse += cosine[:, None] * np.asarray(light.color)
        shine += highlight[:, None] * np.asarray(light.color)
    return np.asarray(color * (ambient + full * diffuse) + material.specular * shine)


def flat_below(volume: Volume, values: Array) -> Array:
    """The longest world gradient that may be just float32 rounding, for these values."""
    return np.asarray(_ROUNDING * np.abs(values) / np.linalg.svd(volume.index_to_world_matrix, compute_uv=False).min())


def facing(gradient: Array, direction: Array, flat: float | Array) -> tuple[Array, Bools]:
    """Unit normals towards the viewer, NaN if the gradient is no longer than `flat`; and a mask of longer ones."""
    length = np.linalg.norm(gradient, axis=-1)
    known = length > flat
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = gradient / np.where(known, length, math.nan)[..., None]
    behind = (normal * direction).sum(-1) > 0
    return np.where(behind[..., None], -normal, normal), known


@dataclass(frozen=True)
class _Part:
    """The samples of a part of each ray between two cuts, in order."""

    rays: Rays
    face: Bools  # whether a face is shown where it begins, (N,)
    t: Array  # (N, M)
    there: Bools
    values: Array
    near: Array  # the stretches of samples
    far: Array


@dataclass(frozen=True)
class _Samples:
    """The samples of all parts of each ray in order, (N, M)."""

    parts: list[_Part]
    rays: Rays  # without cuts
    t: Array
    there: Bools
    values: Array
    near: Array
    far: Array

    @classmethod
    def of(cls, parts: list[_Part], rays: Rays) -> _Samples:
        """Those of these parts."""
        t, values, near, far = (np.concatenate([getattr(p, name) for p in parts], 1) for name in ("t", "values", "near", "far"))
        return cls(parts, rays, t, np.concatenate([part.there for part in parts], 1), values, near, far)


@dataclass(frozen=True)
class _Scene:
    """Inputs of all modes."""

    value: Callable[[Array], Array]
    missing: Callable[[Array], Bools]
    gradient: Callable[[Array], Array]
    hessian: Callable[[Array], Array]
    filter: Filter
    lit: Callable[[Array, Array, Array, Array, Array], Array]  # gradient, values, colour, direction and place to colour
    transfer: Callable[[Array], Array]
    function: TransferFunction  # of which it gives the light
    light: Callable[[Any], Array]  # of a colour of the mode
    unit_distance: float
    volume: Volume
    view: Viewpoint
    height: int  # of the picture in pixels
    colored: Callable[[Array, Array], Array]  # places and own colours to those by another function


class _Left(NamedTuple):
    """What is left of a light."""

    direction: tuple[float, float, float] | None
    color: Array  # at each place


@dataclass(frozen=True)
class _Shadow:
    """How dark a mode's surfaces make each other, as far as cuts keep them, and the domain goes."""

    mode: Mode
    cuts: Cuts
    edge: float
    darkness: float

    def on(self, lights: Sequence[Light], scene: _Scene, gradient: Array, direction: Array, at: Array) -> list[Light | _Left]:
        """What is left of lights on surfaces at these places, with gradients, which rays along directions meet."""
        if not self.darkness:
            return list(lights)
        normal = np.nan_to_num(facing(gradient, direction, 0.0)[0])
        each = [(light, light.direction) for light in lights]
        return [
            _Left(to, np.asarray(light.color) * (1.0 if to is None else self._left(scene, at, normal, np.asarray(to))))
            for light, to in each
        ]

    def _left(self, scene: _Scene, at: Array, normal: Array, to: Array) -> Array:
        values = self.mode.isovalues
        each = [partial(_first_shown, scene, isovalue=value) for value in values]
        rays = rays_towards(scene.volume, at + _OFF * min(scene.volume.spacing) * normal, to, self.edge)
        blocks = (lambda points: scene.value(points) >= values[0]) if self.mode.capped else None
        left = light_past(list(zip(each, opacities_of(self.mode), strict=True)), scene.volume, rays, self.cuts, blocks)
        return np.asarray(1 - self.darkness * (1 - left))[:, None]


def render(
    volume: Volume | ArrayLike,
    camera: Camera | None = None,
    mode: str | Mode = DEFAULT_MODE,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = UNSAID_BOUNDARY,
    size: tuple[int, int] = (64, 64),
    step: float = 0.5,
    *,
    transfer: TransferFunction | None = None,
    gradient: Literal["analytic", "central"] = "analytic",
    material: Material | None = None,
    lights: Light | Sequence[Light] = KIT,
    background: Sequence[float] | str | None = (0.0, 0.0, 0.0),
    clip: Clip | None = None,
    rays: int = 1,
    pixel_filter: str | Filter = "linear",
    outputs: str | Sequence[str] = "rgba",
    linear_light: bool = False,
    shadow: float = 0.0,
    other: Medium | None = None,
    **options: Any,
) -> Array | dict[str, Array]:
    """One picture; parameters and results are those of `clvol.Renderer.render`, in float64; `other` is `clvol.Medium.color_by`.

    Differences: `termination` is 0 unless given, and all samples of all rays are in memory at once, so
    this is for small pictures of small volumes.

    Notes
    -----
    ``composite``: with opacity ``a`` a unit distance ``u``, a sample stands for a stretch ``s`` of the ray with
    opacity ``1 - (1 - a)^(s/u)``; colours add up weighted by opacity times the light that gets there. Stretches are as
    long as a step; that of the first sample begins where the ray enters, that of the last ends where it leaves. The depth is
    where half of the light is stopped, if each stretch is of one kind. With `virtual` these are the stretches of virtual samples
    between the ray's, which include its ends (`_between`).

    If the mode is `capped`, a ray that enters at the face of a cut has a first sample there: unlit, for 16 unit distances.

    ``isosurface``: the first root of the function along the ray (`first_crossings`). With ``method="stepped"`` the
    first pair of neighbouring samples on both sides of the isovalue; the root between them by bisection, the end on
    the far side. With a `cap` a ray that enters at the face of a cut ends there if the value is not below the isovalue.

    ``mip``, ``minip``: the extreme sample, the first if several are equal; ``mean``: the mean of all, by the lengths of their
    stretches.

    ``integral``: the sum of all, or of what they are of water's attenuation, times the lengths of their stretches.

    ``regions``: the value of a sample is the label of its region (`labels_at`); boundaries between two samples by bisection.

    Samples that are NaN or infinite are missing: `continued` replaces them, and nothing is shown where `is_missing`.

    With `linear_light`, in modes of light, all colours that are given are light (`light_of`) before anything is computed with them,
    and the picture over its background is shown (`shown_as`) after.

    With a `shadow`, for ``isosurface`` and ``surfaces``, rays from where they are met to the lights find what of these surfaces is
    on the way (`light_past`), as with ``shadow_rays``; lights are in the world.
    """
    volume, row = as_volume(volume), as_filter(filter)
    chosen = _chosen(mode, options).settled(volume)
    if volume.ndim != 3:
        raise OptionError(f"rendering takes a volume with 3 axes; got shape {volume.shape}")
    gather = MODES.get(chosen.name)
    if gather is None:
        raise one_of("mode of the reference", chosen.name, MODES)
    rule = as_boundary(boundary)
    if chosen.regions and not rule.given:
        rule = as_boundary(REGION_BOUNDARY)
    some_missing = not np.isfinite(volume.data).all()
    present = continued(volume) if some_missing else volume
    taken_off = Stored.of(present, row, rule).offset  # kernels round values minus this
    inside = rule if rule.edge else "mirror"  # the same between the outer samples, where rays are clipped, up to rounding
    if transfer is None:
        transfer = chosen.transfer(volume)
    material = material or Material()
    central = gradient == "central" or not row.has_gradient
    linear = linear_light and "linear_light" not in chosen.unheard

    def classified(values: Array) -> Array:
        shades = transfer(values)
        return np.concatenate([light_of(shades[..., :3], linear), shades[..., 3:]], -1)

    value, exact_slope = _function(present, row, as_boundary(inside), regions=chosen.regions)

    def missing(points: Array) -> Bools:
        return is_missing(volume, points, row) if some_missing else np.zeros(points.shape[:-1], np.bool_)

    def solid(labels: Array) -> Bools:
        if chosen.isovalues:
            return labels >= chosen.isovalues[0]
        return np.asarray(transfer(labels)[..., 3] > 0)

    def slope(points: Array) -> Array:
        """Differences of one voxel of the stored grid to each side, or the exact derivative, per world unit. For labels differences
        of whether they are solid, in units of the value, averaged 1 : 2 : 1 across.

        ``df/dw_i = Σ_j df/dx_j dx_j/dw_i`` with index positions x and world positions w.
        """
        if not central:
            return exact_slope(points)
        columns = volume.index_to_world_matrix.T / row.scale  # row j: one voxel along axis j, of the magnified grid if there is one
        if volume.is_labels and not row.has_gradient:
            total = np.zeros(points.shape)
            for step in itertools.product((-1, 0, 1), repeat=3):
                share = math.prod(2 - i * i for i in step) / 32
                total += solid(value(points + np.array(step) @ columns))[..., None] * (share * np.array(step))
            unit = 1 + np.abs(value(points) - taken_off)
            return np.asarray(unit[..., None] * total @ volume.world_to_index_matrix)
        differences = np.stack([(value(points + c) - value(points - c)) / 2 for c in columns], -1) * row.scale
        return np.asarray(differences @ volume.world_to_index_matrix)

    width, height = size
    clip = None if clip is None else as_clip(clip)
    cuts = cuts_of(clip)
    view = fitted(camera or usual_camera(volume), volume, chosen, transfer, clip, width / height).view(volume, width / height)
    lit_by = [light.placed(view) for light in usual_lights(as_lights(lights), linear=linear)]
    dark = _Shadow(chosen, cuts, rule.edge, shadow)

    scene = _Scene(
        value,
        missing,
        slope,
        lambda points: sample(present, points, row, inside, 2),
        row,
        lambda g, v, c, d, p: shade(
            g, c, d, material, dark.on(lit_by, scene, g, d, p), flat_below(volume, v - taken_off), linear=linear
        ),
        classified,
        transfer,
        partial(light_of, linear=linear),
        transfer.unit_distance or float(np.mean(volume.spacing)),
        volume,
        view,
        height,
        lambda points, rgb: rgb if other is None else colored(other, points, rgb, linear=linear),
    )
    axis, planes = planes_across(volume, view, width / height, step)
    total = np.zeros((width * height, 4))
    guides: dict[str, Array] = {}
    for offset, weight in pixel_rays(rays, pixel_filter):
        whole = camera_rays(volume, view, size, offset, None, rule.edge)
        ((convex, _),) = kept_parts(whole, replace(cuts, corners=()))
        parts = []
        for cast, cut in kept_parts(whole, cuts):
            t, there, world_step = _sample_distances(volume, cast, convex.enter, axis, planes, step, chosen.endpoints)
            values = np.full(t.shape, math.nan)
            which, k = np.nonzero(there)
            values[there] = value(cast.at(t[which, k], which))
            if not (chosen.isovalues or virtual_samples(chosen)):
                there[there] = ~missing(cast.at(t[which, k], which))
            face = cut & chosen.capped
            face[face] = ~missing(cast.at(cast.enter[face], face))
            parts.append(_Part(cast, face, t, there, values, *_stretches(scene, cast, t, there, world_step)))
        cast = whole
        rgb, opacity, depth = gather(scene, chosen, _Samples.of(parts, whole))
        total += np.concatenate([rgb, opacity[:, None]], 1) * weight
        if not guides:
            somewhere = np.isfinite(depth)
            place = np.full((depth.size, 3), math.nan)
            place[somewhere] = cast.at(depth[somewhere], somewhere)
            normal = np.full((depth.size, 3), math.nan)
            flat = flat_below(volume, value(place[somewhere]) - taken_off)
            normal[somewhere], _ = facing(slope(place[somewhere]), cast.direction[somewhere], flat)
            for part in parts:
                on = part.face & (depth == part.rays.enter)
                normal[on] = face_normals(place[on], cast.direction[on], cuts)
            guides = {"depth": depth, "normal": normal, "position": place}
    premultiplied, cover = total[:, :3], total[:, 3:]
    if background is None:
        with np.errstate(divide="ignore", invalid="ignore"):
            over = np.where(cover > 0, premultiplied / cover, 0.0)
    else:
        over = premultiplied + (1 - cover) * light_of(color_of("background", background), linear)
        cover = np.ones_like(cover)
    colors = shown_as(np.clip(over, 0, 1), linear)
    pictures = {"rgba": np.concatenate([colors, np.clip(cover, 0, 1)], 1), **guides}
    shaped = {name: array.reshape(height, width, *array.shape[1:]) for name, array in pictures.items()}
    return shaped[outputs] if isinstance(outputs, str) else {name: shaped[name] for name in outputs}


def _chosen(mode: str | Mode, options: dict[str, Any]) -> Mode:
    """A mode, whose rays end nowhere early unless it says so, and whose steps are given."""
    chosen = as_mode(mode, options)
    if tolerance_of(chosen) is not None:
        raise OptionError("tolerance must be left out of the reference, which has steps: the recipe of a picture says which")
    return as_mode(chosen, {"termination": 0.0}) if "termination" in mode_options(chosen).keys() - options.keys() else chosen


def _function(
    volume: Volume, row: Filter, rule: Boundary, *, regions: bool
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """The value at points, and its gradient; of `regions` their labels, and by how much they lead."""
    if regions:
        return (
            lambda points: labels_at(volume, points, row.name, rule.name)[0].astype(np.float64),
            lambda points: lead_gradient(volume, points, row.name, rule.name),
        )
    return lambda points: sample(volume, points, row, rule), lambda points: sample(volume, points, row, rule, 1)


def pixel_rays(count: int, filter: str | Filter) -> list[tuple[tuple[float, float], float]]:
    """Offset in the pixel and weight of each of its rays, that through the middle first, which may count nothing.

    Along each axis the magnitude of the filter is cut into strips of equal weight. Counted from the middle of all, strip
    ``k`` along x meets the strip along y whose rank is that of ``frac(1/2 + k g)``, g the golden section. A ray lies where
    half of its strip's weight is on either side, and counts what the filter itself has in both strips.
    """
    row = as_filter(filter)
    x = np.linspace(-row.support / 2, row.support / 2, 1 + 30_000 * row.support)
    pieces = row((x[1:] + x[:-1]) / 2)
    below = np.concatenate([[0], np.cumsum(np.abs(pieces))]) / np.abs(pieces).sum()

    def until(share: float) -> float:
        return float(np.interp(share, below, x))

    def within(low: float, high: float) -> float:
        return float(np.interp(high, x[1:], np.cumsum(pieces), left=0) - np.interp(low, x[1:], np.cumsum(pieces), left=0))

    place = [until((i + 0.5) / count) for i in range(count)]
    share = [within(until(i / count), until((i + 1) / count)) for i in range(count)]
    along = [math.fmod(count + 0.5 + (i - (count - 1) / 2) * (math.sqrt(5) - 1) / 2, 1) for i in range(count)]
    rank = [sum(other < mine for other in along) for mine in along]
    total = sum(share[i] * share[rank[i]] for i in range(count))
    rays = [((0.5 + place[i], 0.5 + place[rank[i]]), share[i] * share[rank[i]] / total) for i in range(count)]
    if count % 2 == 0:
        return [((0.5, 0.5), 0.0), *rays]
    return [((0.5, 0.5), rays[count // 2][1]), *rays[: count // 2], *rays[count // 2 + 1 :]]


# -- the modes: premultiplied colour, opacity and depth of each ray ------------------------------------------------

_Gathered: TypeAlias = tuple[Array, Array, Array]


def _with_faces(scene: _Scene, part: _Part) -> _Part:
    """The same with a first sample for the face at which it begins, or none."""
    at = np.where(part.face, part.rays.enter, 0.0)[:, None]
    value = np.full(at.shape, math.nan)
    value[part.face, 0] = scene.value(part.rays.at(at[part.face, 0], part.face))

    def first(column: Array, rest: Array) -> Array:
        return np.concatenate([column, rest], 1)

    there = np.concatenate([part.face[:, None], part.there], 1)
    return replace(
        part, t=first(at, part.t), there=there, values=first(value, part.values), near=first(at, part.near), far=first(at, part.far)
    )


def _between(scene: _Scene, count: int, part: _Part) -> tuple[_Part, Array]:
    """Virtual samples between those of a part, and their gradients, (N, M, 3).

    Between two samples values are Hermite's; where neither is visible they stay between both. Gradients are interpolated by the
    quadratic through those of both and of the sample before, if there is one, and then have Hermite's slope along the ray.
    """
    rays, t, there = part.rays, np.where(part.there, part.t, 0.0), part.there
    known = np.zeros((*t.shape, 3))
    known[there] = scene.gradient(rays.at(t[there], np.nonzero(there)[0]))
    values, ahead = np.where(there, part.values, 0.0), rays.direction[:, None]
    both = there[:, 1:]  # samples come first
    first, last, length = values[:, :-1], values[:, 1:], np.where(both, np.diff(t), 0.0)
    slope = (known * ahead).sum(-1) * np.ones_like(t)
    visible = there & (scene.transfer(values)[..., 3] > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = np.diff(known, axis=1) / length[..., None]
        bent = np.diff(steep, axis=1) / (length[:, 1:] + length[:, :-1])[..., None]
    bend = np.zeros_like(steep)
    bend[:, 1:] = np.where(both[:, 1:, None], np.nan_to_num(bent, posinf=0, neginf=0), 0.0)
    columns: list[tuple[Array, ...]] = []
    for i in range(count):
        w = (i + 0.5) / count
        u = length * (1 - w)
        own = first * (1 + 2 * w) * (1 - w) ** 2 + last * w**2 * (3 - 2 * w)
        own += length * (slope[:, :-1] * w * (1 - w) ** 2 - slope[:, 1:] * w**2 * (1 - w))
        hidden = ~(visible[:, :-1] | visible[:, 1:])
        own = np.where(hidden, np.clip(own, np.minimum(first, last), np.maximum(first, last)), own)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.nan_to_num(6 * w * (1 - w) * (last - first) / length, posinf=0, neginf=0)
        along += slope[:, :-1] * (1 - w) * (1 - 3 * w) - slope[:, 1:] * w * (2 - 3 * w)
        near = known[:, :-1] * (1 - w) + known[:, 1:] * w - bend * (u * w * length)[..., None]
        near += (along - (near * ahead).sum(-1))[..., None] * ahead
        begin = t[:, :-1] + length * i / count
        columns.append((begin + length / (2 * count), own, begin, begin + length / count, near))
    place, value, begin, end, gradient = (
        np.stack(each, 2).reshape(t.shape[0], -1, *each[0].shape[2:]) for each in zip(*columns, strict=True)
    )
    shown = np.repeat(both, count, axis=1)
    shown[shown] = ~scene.missing(rays.at(place[shown], np.nonzero(shown)[0]))
    return replace(
        part, t=place, there=shown, values=value, near=np.where(shown, begin, 0.0), far=np.where(shown, end, 0.0)
    ), gradient


def _composite(scene: _Scene, mode: Composite, samples: _Samples) -> _Gathered:
    virtual = [_between(scene, mode.virtual, part) for part in samples.parts] if mode.virtual else []
    parts = [part for part, _ in virtual] or samples.parts
    samples = _Samples.of([_with_faces(scene, part) for part in parts], samples.rays)
    rays, t, there, values, near, far = (*(samples.rays, samples.t, samples.there, samples.values), *(samples.near, samples.far))
    firsts = np.cumsum([0, *(part.t.shape[1] for part in samples.parts[:-1])])
    face = np.zeros(t.shape, np.bool_)
    face[:, firsts] = True
    classified = scene.transfer(np.where(there, values, 0.0))
    rgb, alpha = classified[..., :3], np.where(there, classified[..., 3], 0.0)
    which, k = np.nonzero(alpha > 0)
    points = rays.at(t[which, k], which)
    slopes = partial(scene.gradient, points), partial(scene.hessian, points)
    rgb[which, k], alpha[which, k] = graded(scene.function, values[which, k], *slopes, light=scene.light)
    which, k = np.nonzero(alpha > 0)
    rgb[which, k] = scene.colored(rays.at(t[which, k], which), rgb[which, k])
    if mode.shading:
        which, k = np.nonzero((alpha > 0) & ~face)
        if mode.virtual:  # nothing is known on faces
            gradient = np.concatenate([np.pad(slopes, ((0, 0), (1, 0), (0, 0))) for _, slopes in virtual], 1)[which, k]
        else:
            gradient = scene.gradient(rays.at(t[which, k], which))
        rgb[which, k] = scene.lit(gradient, values[which, k], rgb[which, k], rays.direction[which], rays.at(t[which, k], which))
    with np.errstate(divide="ignore"):
        stopped = -np.log1p(-alpha)  # a unit distance: inf in opaque matter
    thickness = np.where(face, _FACE, (far - near) / scene.unit_distance)
    optical = np.multiply(stopped, thickness, out=np.zeros_like(stopped), where=thickness > 0)
    opacity = -np.expm1(-optical)
    after = np.cumprod(1 - opacity, axis=1)
    before = np.concatenate([np.ones((after.shape[0], 1)), after[:, :-1]], 1)
    # the sample at which transmittance falls to `termination` is the last
    seen = (before > mode.termination) if mode.termination > 0 else np.ones_like(there)
    share = np.where(seen, before * opacity, 0.0)
    half = seen & (after <= 0.5)
    depth = np.full(t.shape[0], math.inf)
    halved = np.flatnonzero(half.any(1))
    at = halved, half[halved].argmax(1)
    depth[halved] = near[at] + np.log(2 * before[at]) / optical[at] * (far - near)[at]
    return np.einsum("nk,nkc->nc", share, rgb), share.sum(1), depth


def _isosurface(scene: _Scene, mode: Isosurface, samples: _Samples) -> _Gathered:
    assert isinstance(mode.isovalue, float)  # it is settled
    rays, depth = samples.rays, np.full(samples.t.shape[0], math.inf)
    capped = np.zeros(depth.shape, np.bool_)
    for part in samples.parts:
        new = ~np.isfinite(depth)
        if mode.method == "exact":
            own = _first_shown(scene, part.rays, mode.isovalue)
        else:
            own = _stepped(scene, mode.isovalue, part.rays, part.t, part.there, part.values)
        cap = part.face.copy()
        cap[cap] = scene.value(part.rays.at(part.rays.enter[cap], cap)) >= mode.isovalue
        depth = np.where(new, np.where(cap, part.rays.enter, own), depth)
        capped |= new & cap
    hit = np.flatnonzero(np.isfinite(depth))
    rgb = np.zeros((depth.size, 3))
    rgb[hit] = scene.light(mode.color)
    if mode.color_by == "label" and not scene.filter.has_gradient:
        rgb[hit] = scene.transfer(scene.value(rays.at(depth[hit] + 100 * _PAST, hit)))[:, :3]
    elif mode.color_by and mode.color_by != "label":
        rgb[hit] = scene.transfer(_shown_at(scene, mode.color_by, rays.at(depth[hit], hit), rays.direction[hit]))[:, :3]
    rgb[hit] = scene.colored(rays.at(depth[hit], hit), rgb[hit])
    if mode.shading:
        at = rays.at(depth[hit], hit)
        gradient = scene.gradient(at)
        rgb[hit] = scene.lit(gradient, np.full(hit.size, mode.isovalue), rgb[hit], rays.direction[hit], at)
    if mode.outline:
        rgb[hit] *= _outlined(scene, mode.outline, rays.at(depth[hit], hit), rays.direction[hit])
    rgb[capped] = scene.transfer(scene.value(rays.at(depth[capped], capped)))[:, :3] if mode.cap is True else scene.light(mode.cap)
    return rgb, np.isfinite(depth).astype(float), depth


def _surfaces(scene: _Scene, mode: Surfaces, samples: _Samples) -> _Gathered:
    """All crossings of each isovalue, one after the other; then those of a ray in the order of t."""
    assert isinstance(mode.surfaces, tuple)  # it is settled
    n = samples.t.shape[0]
    rgb, light, depth = np.zeros((n, 3)), np.ones(n), np.full(n, math.inf)
    for part in samples.parts:
        crossings: list[tuple[Any, ...]] = []  # (ray, t, rank among those of one jump, colour, opacity)
        for k, (value, color, opacity) in enumerate(mode.surfaces):
            for on, t in crossings_by(partial(_first_shown, scene, isovalue=value), scene.volume, part.rays):
                at = part.rays.at(t, on)
                colors = np.tile(scene.light(color), (on.size, 1))
                if mode.color_by:
                    colors = scene.transfer(_shown_at(scene, mode.color_by, at, part.rays.direction[on]))[:, :3]
                colors = scene.colored(at, colors)
                if mode.shading:
                    colors = scene.lit(scene.gradient(at), np.full(on.size, value), colors, part.rays.direction[on], at)
                if mode.outline:
                    colors = colors * _outlined(scene, mode.outline, at, part.rays.direction[on])
                falling = scene.value(part.rays.at(t - 100 * _PAST, on)) >= value
                crossings += zip(on, t, np.where(falling, -k, k), colors, [opacity] * on.size, strict=True)
        cap = part.face.copy()
        cap[cap] = scene.value(part.rays.at(part.rays.enter[cap], cap)) >= mode.isovalues[0]
        for ray in np.flatnonzero(cap):
            value = scene.value(part.rays.at(part.rays.enter[ray : ray + 1], np.array([ray])))
            color = scene.transfer(value)[0, :3] if mode.cap is True else scene.light(mode.cap)
            crossings.append((ray, part.rays.enter[ray], 0, color, 1.0))
        for ray, t, _, color, opacity in sorted(crossings, key=lambda crossing: crossing[1:3]):
            if light[ray] < _FAINT:
                continue
            rgb[ray] += light[ray] * opacity * color
            left = light[ray] * (1 - opacity)
            if left <= 0.5 < light[ray]:
                depth[ray] = t
            light[ray] = left
    return rgb, 1 - light, depth


def boundaries_by(
    value: Callable[[Array], Array], rays: Rays, t: Array, there: Bools, values: Array
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]]:
    """Boundaries of regions between successive samples, by bisection: the first ones, those behind them, and so on.

    Of each the ray, the number of the sample behind it, its place, and the label that is entered.
    """
    on, k = np.nonzero(there[:, 1:] & there[:, :-1] & (values[:, 1:] != values[:, :-1]))
    near, label, end, last = t[on, k], values[on, k], t[on, k + 1], values[on, k + 1]
    while on.size:
        far, entered = end, last
        for _ in range(_ENCLOSING):
            middle = (near + far) / 2
            inside = value(rays.at(middle, on))
            near, far = np.where(inside == label, middle, near), np.where(inside == label, far, middle)
            entered = np.where(inside == label, entered, inside)
        yield on, k + 1, far, entered
        more = entered != last
        on, k, near, label, end, last = (each[more] for each in (on, k, far, entered, end, last))


def _regions(scene: _Scene, mode: Regions, samples: _Samples) -> _Gathered:
    """Each region that is entered: where a part of a ray begins, and between samples, one boundary after the other."""
    n = samples.t.shape[0]
    rgb, light, depth = np.zeros((n, 3)), np.ones(n), np.full(n, math.inf)
    for part in samples.parts:
        begins = np.flatnonzero(part.there.any(1))
        first = part.there[begins].argmax(1)
        entries = [(begins, part.rays.enter[begins], scene.transfer(part.values[begins, first]))]
        for on, _, far, entered in boundaries_by(scene.value, part.rays, part.t, part.there, part.values):
            colors = scene.transfer(entered)
            if mode.shading:
                at = part.rays.at(far, on)
                gradient = scene.gradient(at) * (1 + np.abs(entered[:, None]))
                colors[:, :3] = scene.lit(gradient, entered, colors[:, :3], part.rays.direction[on], at)
            entries.append((on, far, colors))
        rays, places, looks = (np.concatenate(each) for each in zip(*entries, strict=True))
        for i in np.lexsort((places, rays)):
            ray, opacity = rays[i], looks[i, 3]
            if light[ray] < _FAINT:
                continue
            rgb[ray] += light[ray] * opacity * looks[i, :3]
            left = light[ray] * (1 - opacity)
            if left <= 0.5 < light[ray]:
                depth[ray] = places[i]
            light[ray] = left
    return rgb, 1 - light, depth


def _shape(scene: _Scene, points: Array) -> tuple[Array, Array]:
    return shape_operator(scene.gradient(points), scene.hessian(points))


def _outlined(scene: _Scene, thickness: float, points: Array, direction: Array) -> Array:
    """What an outline leaves of colours, (N, 1): by the angle of which the cosine is that between ray and normal."""
    shape, normal = _shape(scene, points)
    facing = np.einsum("nk,nk->n", normal, direction)
    turned = np.arccos(np.clip(np.abs(facing), 0, 1))  # from the middle of the circle to its rim
    along = direction - facing[:, None] * normal
    bent = np.sign(facing) * np.einsum("nj,njk,nk->n", along, shape, along) / np.maximum(np.einsum("nk,nk->n", along, along), 1e-12)
    depth = 1.0 if scene.view.orthographic else (points - scene.view.eye) @ scene.view.forward
    pixel = 2 * scene.view.half_height * depth / scene.height
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.where(bent > 0, (1 - np.sin(turned)) / (bent * pixel), math.inf)
    return 1 - np.clip(thickness + 0.5 - pixels, 0, 1)[:, None]


def _shown_at(scene: _Scene, which: str, points: Array, direction: Array) -> Array:
    """Distances along rays behind the plane through the volume's centre that faces the camera; or curvatures, by the invariants of
    the shape operator.
    """
    if which == "distance":
        return np.asarray(((points - scene.volume.center) @ scene.view.forward) / (direction @ scene.view.forward))
    shape, _ = _shape(scene, points)
    mean = np.trace(shape, axis1=1, axis2=2) / 2
    product = (4 * mean**2 - np.trace(shape @ shape, axis1=1, axis2=2)) / 2
    apart = np.sqrt(np.maximum(mean**2 - product, 0))
    each: dict[str, Array] = {"k1": mean + apart, "k2": mean - apart, "mean curvature": mean, "gaussian curvature": product}
    return each[which]


def _first_shown(scene: _Scene, rays: Rays, isovalue: float) -> Array:
    """The first crossing that is not at a missing place."""
    depth = first_crossings(scene.value, scene.volume, scene.filter, rays, isovalue)
    while True:
        hit = np.flatnonzero(np.isfinite(depth))
        hidden = hit[scene.missing(rays.at(depth[hit], hit))]
        if not hidden.size:
            return depth
        behind = Rays(
            rays.origin[hidden], rays.direction[hidden], depth[hidden] + _PAST * min(scene.volume.spacing), rays.leave[hidden]
        )
        depth[hidden] = first_crossings(scene.value, scene.volume, scene.filter, behind, isovalue)


def _stepped(scene: _Scene, isovalue: float, rays: Rays, t: Array, there: Bools, values: Array) -> Array:
    """The first crossing between samples that is not at a missing place: the far end of a bisection."""
    above = values >= isovalue
    crossing = there[:, 1:] & there[:, :-1] & (above[:, 1:] != above[:, :-1])
    hit, first = np.nonzero(crossing)
    near, far, side = t[hit, first], t[hit, first + 1], above[hit, first]
    for _ in range(_BISECTIONS):
        middle = (near + far) / 2
        same = (scene.value(rays.at(middle, hit)) >= isovalue) == side
        near, far = np.where(same, middle, near), np.where(same, far, middle)
    shown = ~scene.missing(rays.at(far, hit))
    depth = np.full(t.shape[0], math.inf)
    np.minimum.at(depth, hit[shown], far[shown])
    return depth


def _extreme(scene: _Scene, samples: _Samples, ranked: Array, values: Array) -> _Gathered:
    t, there = samples.t, samples.there
    best = np.where(there, ranked, -math.inf).argmax(1)[:, None]
    some: Bools = np.asarray(there.any(1))
    color = scene.transfer(np.where(some, np.take_along_axis(values, best, 1)[:, 0], 0.0))[:, :3]
    depth = np.where(some, np.take_along_axis(t, best, 1)[:, 0], math.inf)
    return color * some[:, None], some.astype(float), depth


def _mip(scene: _Scene, mode: Mode, samples: _Samples) -> _Gathered:  # noqa: ARG001
    return _extreme(scene, samples, samples.values, samples.values)


def _attenuated(scene: _Scene, mode: Attenuated, samples: _Samples) -> _Gathered:
    """A ray is half of the sphere's diameter deep where it crosses the plane through the centre that faces the camera."""
    rays, t = samples.rays, samples.t
    bottom, forward, center = scene.function.value_range[0], scene.view.forward, scene.volume.center
    diameter = 2 * np.linalg.norm(scene.volume.corners - center, axis=1).max()
    middle = ((center - rays.origin) @ forward) / (rays.direction @ forward)
    fading = np.exp(-mode.attenuation * np.maximum(0.5 + (t - middle[:, None]) / diameter, 0.0))
    heights = np.maximum(samples.values - bottom, 0.0) * np.where(samples.there, fading, 0.0)
    return _extreme(scene, samples, heights, bottom + heights)


def _minip(scene: _Scene, mode: Mode, samples: _Samples) -> _Gathered:  # noqa: ARG001
    return _extreme(scene, samples, -samples.values, samples.values)


def _mean(scene: _Scene, mode: Mode, samples: _Samples) -> _Gathered:  # noqa: ARG001
    lengths = samples.far - samples.near
    length = lengths.sum(1)
    some: Bools = np.asarray(length > 0)
    mean = (np.where(samples.there, samples.values, 0.0) * lengths).sum(1) / np.where(some, length, 1.0)
    color = scene.transfer(mean)[:, :3]
    return color * some[:, None], some.astype(float), np.full(length.size, math.inf)


def _integral(scene: _Scene, mode: Integral, samples: _Samples) -> _Gathered:
    lengths = samples.far - samples.near
    heights = np.where(samples.there, samples.values, 0.0)
    if mode.mu_water is not None:
        heights = np.maximum(mode.mu_water * (1 + heights / 1000), 0)
    integral = (heights * lengths).sum(1)
    some = np.any([part.rays.enter <= part.rays.leave for part in samples.parts], axis=0)
    color = scene.transfer(integral)[:, :3]
    return color * some[:, None], some.astype(float), np.full(integral.size, math.inf)


MODES: dict[str, Callable[[_Scene, Any, _Samples], _Gathered]] = {
    "composite": _composite,
    "isosurface": _isosurface,
    "surfaces": _surfaces,
    "regions": _regions,
    "mip": _mip,
    "attenuated": _attenuated,
    "minip": _minip,
    "mean": _mean,
    "integral": _integral,
}
