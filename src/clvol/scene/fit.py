"""Fit a camera to the visible part of a volume: its bounding sphere, and the space it sweeps as the camera orbits.

The sphere depends only on the volume, the mode, the transfer function and the clip box, not on the view or other cuts. At most 64
samples along each axis are read. The sphere is slightly larger than the visible samples, and never larger than that of the
volume, which is used if nothing is visible. The visible samples are rotated about the vertical through the sphere's centre, so
that an orbiting camera keeps its distance, and they stay near the middle.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from clvol.scene.camera import Camera
from clvol.scene.clip import Clip, cuts_of
from clvol.scene.joint import opacity_at
from clvol.scene.mode import Mode
from clvol.scene.preset import thinness
from clvol.scene.transfer import TransferFunction
from clvol.volume.evenly import evenly
from clvol.volume.volume import Volume

__all__ = ["Seen", "Sphere", "box_around", "fitted", "sphere_of_matter", "usual_camera"]

Bools: TypeAlias = NDArray[np.bool_]
Seen: TypeAlias = tuple[Volume, Mode, TransferFunction, Clip | None]
"""A volume, with the mode and the transfer function that show it, and what is cut away of it."""

_FAINT = 0.02  # relative to the largest opacity: less is barely visible
_DARK = 0.05  # relative to the brightest colour: less is barely visible
_BESIDE = 1e-6  # offset around a transfer function's points, relative to their range
_BLOCK = 8  # samples along each edge of a block
_SPECKS = 4, 16  # visible samples in a block, of matter and of surfaces: fewer are noise
_MARGIN = 1.04
_DIRECTIONS = 128  # directions in which the outermost samples are found
_STEPS = 256  # iterations for the smallest sphere around these
_KEPT = 64  # cached spheres per volume
_TURNS = 24  # rotations of the outermost samples about the vertical


@dataclass(frozen=True)
class Sphere:
    """A sphere in the world."""

    center: tuple[float, float, float]
    radius: float
    outer: NDArray[np.float64] | None = field(default=None, compare=False, repr=False)
    """Vectors from the centre to the outermost visible samples, (n, 3); None for the sphere of the volume."""

    @cached_property
    def upright(self) -> NDArray[np.float64]:
        """`outer` rotated around the vertical: see `_swept`."""
        assert self.outer is not None  # the volume's is not rotated
        return _swept(self.outer, np.array([0.0, 0.0, 1.0]))

    @cached_property
    def furthest(self) -> float:
        """Length of the longest vector of `outer`."""
        assert self.outer is not None
        return float(np.linalg.norm(self.outer, axis=1).max())


def usual_camera(volume: Volume) -> Camera:
    """The camera where none is given: `Camera.orbit`, but of thin stacks of images from above, the thinner the steeper."""
    thin = thinness(volume)
    return Camera.orbit() if thin > 1 else Camera.orbit(30 * thin, 90 - 35 * thin)


def box_around(seen: Iterable[tuple[Volume, Clip | None]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The corners of the box, along the world's axes, around volumes: of each the part in its clip box, if there is any."""
    boxes = list(itertools.starmap(_own_box, seen))
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def _own_box(volume: Volume, clip: Clip | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = volume.corners.min(0), volume.corners.max(0)
    if (box := cuts_of(clip).box) is not None:
        inside = np.maximum(low, box[0]), np.minimum(high, box[1])
        low, high = inside if (inside[0] < inside[1]).all() else (low, high)
    return low, high


def fitted(
    camera: Camera,
    volume: Volume,
    mode: Mode,
    transfer: TransferFunction,
    clip: Clip | None = None,
    aspect: float = 1.0,
    *,
    others: Sequence[Seen] = (),
) -> Camera:
    """The camera with target and radius, if it must be fitted to visible matter: see `Camera`. Modes must be settled.

    `aspect` is the picture's width over its height; `others` are the other volumes of the picture. A camera that is not fitted to
    matter sees one volume as its `Camera.view` says, and several as the sphere around them all.
    """
    seen, given = ((volume, mode, transfer, clip), *others), (camera.position, camera.target, camera.distance, camera.radius)
    if camera.fit != "matter" or any(value is not None for value in given):
        if not others or (camera.target is not None and camera.radius is not None):
            return camera
        corners = np.concatenate([one.corners for one, *_ in seen])
        middle = corners.min(0) / 2 + corners.max(0) / 2
        radius = float(np.linalg.norm(corners - middle, axis=1).max())
        return replace(camera, target=camera.target or tuple(map(float, middle)), radius=camera.radius or radius)  # type: ignore[arg-type]  # three
    sphere = _around([sphere_of_matter(*one) for one in seen])
    center, radius = np.asarray(sphere.center), sphere.radius
    if sphere.outer is not None:
        view = camera.view(volume, aspect)
        swept = sphere.upright if camera.upright else _swept(sphere.outer, np.asarray(camera.up) / math.hypot(*camera.up))
        # distance from the centre to the planes through the eye and the picture's edges, for each rotation
        half = 0.0 if view.orthographic else math.atan(math.tan(math.radians(camera.fov) / 2) * min(1.0, aspect))
        depth = math.sin(half) * (swept @ view.forward)
        right, up = (math.cos(half) * (swept @ way) for way in (view.right, view.up))
        above, below = (up - depth).max(1), (-up - depth).max(1)
        beside = float((np.abs(right) - depth).max())
        reach = max(float(above.max() + below.max()) / 2, beside)
        shift = np.clip((above - below).mean() / 2, above.max() - reach, reach - below.max())
        center = center + shift / math.cos(half) * view.up
        if sphere.furthest > 0:  # a single sample shows as its whole voxel
            radius *= min(1.0, reach / sphere.furthest)
    x, y, z = (float(v) for v in center)
    return replace(camera, target=(x, y, z), radius=radius)


def _around(spheres: list[Sphere]) -> Sphere:
    """A sphere around spheres."""
    if len(spheres) == 1:
        return spheres[0]
    whole = any(sphere.outer is None for sphere in spheres)
    points = np.concatenate([np.asarray(one.center) + (_ends(one) if one.outer is None else one.outer) for one in spheres])
    center = _middle(points)
    radius = max(math.dist(one.center, center) + one.radius for one in spheres)
    return Sphere(tuple(map(float, center)), radius, None if whole else points - center)  # type: ignore[arg-type]  # three


def _ends(sphere: Sphere) -> NDArray[np.float64]:
    return sphere.radius * np.concatenate([np.eye(3), -np.eye(3)])


def _middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centre of the smallest sphere around points."""
    center: NDArray[np.float64] = points.mean(0)
    for i in range(1, _STEPS):  # Badoiu and Clarkson, 2003
        center += (points[((points - center) ** 2).sum(1).argmax()] - center) / (i + 1)
    return center


def _swept(points: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points, rotated around an axis; shape (turns, number, 3)."""
    along = np.outer(points @ axis, axis)
    off = points - along
    across = np.cross(axis, off)
    turns = np.arange(_TURNS) * (2 * math.pi / _TURNS)
    return np.asarray(along + np.cos(turns)[:, None, None] * off + np.sin(turns)[:, None, None] * across)


def sphere_of_matter(volume: Volume, mode: Mode, transfer: TransferFunction, clip: Clip | None = None) -> Sphere:
    """The sphere around the visible part of a 3-D volume in a settled mode; samples outside the box of `clip` do not count.

    Surfaces are where neighbouring samples are on both sides of the isovalue. Matter is visible where its opacity, by the gradient
    too (of differences of samples), is more than 2 % of the transfer function's largest; in projections, where colour times opacity
    is more than 5 % of the brightest. A few isolated visible samples are noise, and do not count.
    """
    if mode.shows == "integral":  # to which all matter counts
        return Sphere(tuple(map(float, volume.center)), volume.radius)  # type: ignore[arg-type]  # three
    known = _known.setdefault(volume, {})
    box = cuts_of(clip).box
    key = (mode.isovalues, None, box) if mode.isovalues else (mode.shows == "matter", transfer, box)
    found = known.get(key)
    if found is None:
        found = _sphere(volume, mode, transfer, box)
        if len(known) >= _KEPT:  # other threads may clear it as well
            known.clear()
        known[key] = found
    return found


_known: WeakKeyDictionary[Volume, dict[Any, Sphere]] = WeakKeyDictionary()


def _sphere(
    volume: Volume, mode: Mode, transfer: TransferFunction, box: tuple[tuple[float, ...], tuple[float, ...]] | None
) -> Sphere:
    found = evenly(volume)
    some, volume = found
    whole = Sphere(tuple(map(float, volume.center)), volume.radius)  # type: ignore[arg-type]  # three
    some = np.ascontiguousarray(some, some.dtype.newbyteorder("="))
    surface = bool(mode.isovalues)
    present = np.isfinite(some)
    if surface:
        seen = np.logical_or.reduce([_crossed(some >= v, present) for v in mode.isovalues])
    elif transfer.graded & 5:
        opacity = opacity_at(transfer, some, found.steepness)
        largest = max(seen for _, seen in transfer.opacities) * max(factor for _, factor in transfer.gradient_opacity or ((0, 1),))
        seen = opacity > _FAINT * largest
    else:
        seen = _shown(some, mode, transfer)
    seen &= present

    unit = volume.mean_spacing  # relative to the volume's centre, so that no square overflows
    matrix = volume.index_to_world_matrix / unit
    start = matrix @ (np.array(found.firsts) - (np.asarray(volume.size) - 1) / 2)
    matrix = matrix * np.array(found.steps)
    if box is not None:
        seen &= _inside(seen.shape, matrix, start, [(np.asarray(corner) - volume.center) / unit for corner in box])
    seen = _without_specks(seen, _SPECKS[surface])
    rows = seen.any(2)
    if not rows.any():
        return whole
    z, y = np.nonzero(rows)
    lines = seen[z, y]
    ends = lines.argmax(1), lines.shape[1] - 1 - lines[:, ::-1].argmax(1)  # samples between them are inside any sphere around them
    points = np.concatenate([np.stack([x, y, z], 1) for x in ends]) @ matrix.T + start
    outer = points[np.unique((points @ _sphere_directions()).argmax(0))]
    center = _middle(outer)
    beyond = 0.0 if surface else float(np.linalg.norm(matrix, axis=0).max()) / 2  # surfaces are between the samples on both sides
    radius = _MARGIN * unit * (math.sqrt(float(((points - center) ** 2).sum(1).max())) + beyond)
    if not radius < volume.radius:
        return whole
    middle = volume.center + unit * center
    return Sphere(tuple(map(float, middle)), radius, unit * (outer - center))  # type: ignore[arg-type]  # three


def _crossed(above: Bools, present: Bools) -> Bools:
    """Samples with a neighbour on the other side; both are present."""
    crossed = np.zeros_like(above)
    for axis in range(3):
        one, other, there = (np.moveaxis(array, axis, 0) for array in (above, crossed, present))
        change = (one[1:] != one[:-1]) & there[1:] & there[:-1]
        other[1:] |= change
        other[:-1] |= change
    return crossed


def _shown(values: NDArray[Any], mode: Mode, transfer: TransferFunction) -> Bools:
    """Which values a mode shows with a transfer function, which is linear between all its points."""
    points = np.unique([point[0] for point in (*transfer.colors, *transfer.opacities)])
    beside = max(_BESIDE * (points[-1] / 2 - points[0] / 2), 4 * float(np.spacing(np.abs(points).max())))  # it may jump at a point
    at = np.unique([points - beside, points, points + beside])
    shades = transfer(at)
    matter = mode.shows == "matter"
    weight = shades[:, 3] if matter else shades[:, :3].max(1) * shades[:, 3]
    least = float(weight.max()) * (_FAINT if matter else _DARK)
    over = weight - least
    changes = np.flatnonzero((over[1:] > 0) != (over[:-1] > 0))
    with np.errstate(over="ignore"):
        share = over[changes] / (over[changes] - over[changes + 1])
        edges = at[changes] * (1 - share) + at[changes + 1] * share
    shown = np.full(values.shape, bool(over[0] > 0))
    if len(edges) > _BLOCK:
        return np.asarray(shown ^ (np.searchsorted(edges, values.astype(np.float64)) % 2 > 0))
    for edge in edges:
        shown ^= values > edge
    return shown


def _inside(
    shape: tuple[int, ...], matrix: NDArray[np.float64], start: NDArray[np.float64], box: list[NDArray[np.float64]]
) -> Bools:
    """Which samples are in a box."""
    z, y, x = (np.arange(n, dtype=np.float64) for n in shape)
    inside = np.ones(shape, np.bool_)
    for row, first, low, high in zip(matrix, start, *box, strict=True):
        place = first + row[0] * x + (row[1] * y)[:, None] + (row[2] * z)[:, None, None]
        inside &= (place >= low) & (place <= high)
    return inside


def _without_specks(seen: Bools, least: int) -> Bools:
    """Remove visible samples in blocks with fewer than `least`, unless nothing would remain."""
    padded = np.pad(seen, [(0, -n % _BLOCK) for n in seen.shape])
    z, y, x = (n // _BLOCK for n in padded.shape)
    blocks = padded.reshape(z, _BLOCK, y, _BLOCK, x, _BLOCK)
    counts = blocks.sum((1, 3, 5), dtype=np.int32, keepdims=True)
    kept = (blocks & (counts >= least)).reshape(padded.shape)[tuple(slice(n) for n in seen.shape)]
    return kept if kept.any() else seen


def _sphere_directions() -> NDArray[np.float64]:
    """Directions over the sphere, in a golden-angle spiral; shape (3, number)."""
    z = 1 - (2 * np.arange(_DIRECTIONS) + 1) / _DIRECTIONS
    turn = np.arange(_DIRECTIONS) * math.pi * (3 - math.sqrt(5))
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
