"""What is cut away from a scene: boxes outside of which nothing is rendered, planes, and corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import number
from clvol.base.errors import GeometryError
from clvol.base.uniform import FLOAT, INT, Block, Values
from clvol.volume.volume import Volume

__all__ = ["CLIP", "Box", "Clip", "Corner", "Cuts", "Plane", "as_clip", "clip_block", "cuts_of", "joined", "triple"]

_MAX_PLANES, _MAX_CORNERS = 64, 8  # corners leave up to one more part of a ray, each of which is marched

CLIP = Block(
    "clip_block",
    low=(FLOAT, 3),
    high=(FLOAT, 3),
    plane=(FLOAT, 4 * _MAX_PLANES),  # normal and offset
    corner=(FLOAT, 6 * _MAX_CORNERS),  # low and high
    clipped=INT,
    planes=INT,
    corners=INT,
)

Triple: TypeAlias = tuple[float, float, float]
Vector: TypeAlias = Sequence[float] | NDArray[np.float64]
Box: TypeAlias = tuple[Vector, Vector]


@dataclass(frozen=True)
class Plane:
    """A plane of the world: one that cuts a scene, or that of a slice.

    The half that its normal points to is cut away, and the other is kept; a slice is seen from the side that it points to.

    Planes are a value of `clip` in `clvol.render`, `Renderer.render` and `Scene`, one or several in a list. The camera stays where
    it would be without them, so that only pixels change whose rays meet what is cut away.

    Parameters
    ----------
    normal : three numbers
        Direction (x, y, z) in the world, of any length but 0, towards what is cut away. A plane that faces the viewer with
        its normal opens the volume.
    point : three numbers
        A point of the plane in world coordinates (x, y, z).

    Raises
    ------
    GeometryError
        The normal has no direction, or a number is not finite.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.sphere(32)
    >>> front = clvol.Plane(normal=(0, -1, 0.5), point=volume.center)
    >>> picture = clvol.render(volume, mode="isosurface", clip=front, cap=True)
    """

    normal: Vector
    point: Vector

    def __post_init__(self) -> None:
        normal, point = (_numbers(f"a plane's {name}", getattr(self, name)) for name in ("normal", "point"))
        largest = max(map(abs, normal))
        if not largest > 0:
            raise GeometryError(f"a plane's normal must have a direction, so one of its numbers must not be 0; got {self.normal!r}")
        length = math.hypot(*(v / largest for v in normal))
        if abs(math.hypot(*normal) - 1) > 1e-15:  # normalized again it might differ in the last bit
            normal = tuple(v / largest / length for v in normal)  # type: ignore[assignment]  # three
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "point", point)

    def slab(self, thickness: float) -> tuple[Plane, Plane]:
        """What cuts away all but a slab around this plane, of this thickness in world units: a slice in a scene.

        Both faces show the slice there, where they show something (`cap` of the mode).

        Examples
        --------
        >>> import clvol
        >>> volume = clvol.phantoms.sphere(32)
        >>> slice = clvol.Medium(volume, opacity=[(0, 1)], clip=clvol.Plane((0, 0, 1), volume.center).slab(0.01))
        >>> picture = clvol.render(clvol.Scene([slice, clvol.Medium(volume, surfaces="0.5:tan:0.3")]), size=(64, 64))
        """
        half = number("thickness", thickness, above=0) / 2
        back = Plane(tuple(-v for v in self.normal), self.point)
        front, behind = (
            replace(one, point=tuple(p + half * n for p, n in zip(one.point, one.normal, strict=True))) for one in (self, back)
        )
        return front, behind


@dataclass(frozen=True)
class Corner:
    """A box that is cut away from a scene, such as the corner of a volume that hides what is behind it.

    Corners are a value of `clip`, like `Plane`, one or up to 8 in a list. The camera stays where it would be without them.

    Parameters
    ----------
    low, high : three numbers
        The box's corners in world coordinates (x, y, z), each coordinate of the first less than of the second; infinite ones reach
        beyond the volume, so that an octant is ``Corner(point, (inf, inf, inf))``.

    Raises
    ------
    GeometryError
        The corners are no box.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.sphere(32)
    >>> octant = clvol.Corner(low=volume.center, high=[float("inf")] * 3)
    >>> picture = clvol.render(volume, clvol.Camera.orbit(45, 30), clip=octant)
    """

    low: Vector
    high: Vector

    def __post_init__(self) -> None:
        low, high = _box("a corner", (self.low, self.high))
        object.__setattr__(self, "low", tuple(map(float, low)))
        object.__setattr__(self, "high", tuple(map(float, high)))


Clip: TypeAlias = Box | Plane | Corner | Sequence[Box | Plane | Corner]
"""What is cut away: a box outside of which nothing is rendered, a plane, a corner, or several of them."""


@dataclass(frozen=True)
class Cuts:
    """All that is cut away, sorted by kind: what is kept is inside of the box and of all planes, and in no corner."""

    box: tuple[Triple, Triple] | None = None
    planes: tuple[Plane, ...] = ()
    corners: tuple[Corner, ...] = ()

    def keep(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether world points, shape (..., 3), are kept."""
        at = np.asarray(points, np.float64)
        kept = np.ones(at.shape[:-1], np.bool_)
        if self.box is not None:
            kept &= _within(at, *self.box)
        for plane in self.planes:
            kept &= (at - plane.point) @ np.array(plane.normal) <= 0
        for corner in self.corners:
            kept &= ~_within(at, corner.low, corner.high)
        return kept

    def kept_share(self, points: ArrayLike, width: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """The share that is kept of boxes of this width, one or three, around world points, shape (..., 3), as if cuts were along
        their faces.
        """
        at = np.asarray(points, np.float64)

        def inside(low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
            lengths = np.minimum(at + width / 2, high) - np.maximum(at - width / 2, low)
            return np.asarray(np.prod(np.clip(lengths / width, 0, 1), -1))

        share = np.ones(at.shape[:-1]) if self.box is None else inside(*self.box)
        for plane in self.planes:
            normal = np.array(plane.normal)
            share *= np.clip(0.5 - (at - plane.point) @ normal / np.linalg.norm(normal * width), 0, 1)
        for corner in self.corners:
            share *= 1 - inside(corner.low, corner.high)
        return share


def as_clip(clip: Clip) -> Clip | None:
    """What is cut away, checked: a box alone as two read-only arrays, else the one cut or a tuple of all; None if there is none.

    `GeometryError` if it is neither, or there are more planes or corners than a picture may have.
    """
    if isinstance(clip, Plane | Corner):
        return clip
    if not _is_list(clip):
        return _box("clip", clip)
    cuts = tuple(cut if isinstance(cut, Plane | Corner) else _box("clip", cut) for cut in clip)
    planes, corners = (sum(isinstance(cut, kind) for cut in cuts) for kind in (Plane, Corner))
    if planes > _MAX_PLANES or corners > _MAX_CORNERS:
        raise GeometryError(f"clip may have up to {_MAX_PLANES} planes and {_MAX_CORNERS} corners; got {planes} and {corners}")
    return cuts or None


def joined(one: Clip | None, other: Clip | None) -> Clip | None:
    """All that either of two checked clips cuts away; `GeometryError` if that is more than a picture may have."""
    return as_clip([*_listed(one), *_listed(other)]) if one is not None and other is not None else other if one is None else one


def cuts_of(clip: Clip | None) -> Cuts:
    """The cuts of a checked `clip`, or of a view's box; several boxes have one intersection."""
    cuts = _listed(clip)
    boxes = np.array([cut for cut in cuts if not isinstance(cut, Plane | Corner)], np.float64).reshape(-1, 2, 3)
    box = (triple(boxes[:, 0].max(0)), triple(boxes[:, 1].min(0))) if len(boxes) else None
    if box and any(low >= high for low, high in zip(*box, strict=True)):
        return Cuts(corners=(Corner((-math.inf,) * 3, (math.inf,) * 3),))  # they have nothing in common
    planes = tuple(cut for cut in cuts if isinstance(cut, Plane))
    return Cuts(box, planes, tuple(cut for cut in cuts if isinstance(cut, Corner)))


def clip_block(clip: Clip | None, volume: Volume, unit: float) -> Values:
    """The block of the cuts for kernels: relative to the volume's origin, in their unit of length."""
    return _block(cuts_of(clip), triple(volume.origin), unit)


@lru_cache(maxsize=32)
def _block(cuts: Cuts, origin: Triple, unit: float) -> Values:
    def local(points: ArrayLike) -> NDArray[np.float64]:
        return (np.asarray(points, np.float64) - origin) / unit

    plane, corner = np.zeros((_MAX_PLANES, 4)), np.zeros((_MAX_CORNERS, 2, 3))
    for i, cut in enumerate(cuts.planes):
        plane[i] = *cut.normal, local(cut.point) @ np.array(cut.normal)
    for i, hole in enumerate(cuts.corners):
        corner[i] = local(hole.low), local(hole.high)
    low, high = local(cuts.box or ((-math.inf,) * 3, (math.inf,) * 3))
    return CLIP(
        low=low,
        high=high,
        plane=plane.ravel(),
        corner=corner.ravel(),
        clipped=cuts != Cuts(),
        planes=len(cuts.planes),
        corners=len(cuts.corners),
    )


def _listed(clip: Clip | None) -> Sequence[Any]:
    return () if clip is None else clip if _is_list(clip) else (clip,)


def _is_list(clip: Any) -> TypeGuard[Sequence[Any]]:
    """Whether it is a list of cuts, and not a box, whose corners are numbers."""

    def is_cut(one: Any) -> bool:
        return isinstance(one, Plane | Corner) or np.asarray(one, object).ndim == 2

    return isinstance(clip, list | tuple) and all(map(is_cut, clip))


def _box(what: str, box: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        low, high = (np.array([float(v) for v in corner]) for corner in box)
    except (TypeError, ValueError):
        others = ", a Plane, a Corner, or a list of these" if what == "clip" else ""
        raise GeometryError(f"{what} must be two corners (x, y, z){others}; got {box!r}") from None
    if low.shape != (3,) or high.shape != (3,) or np.isnan(low).any() or np.isnan(high).any() or (low >= high).any():
        raise GeometryError(
            f"{what} must be two corners (x, y, z), each coordinate of the first less than of the second; got {box!r}"
        )
    low.flags.writeable = high.flags.writeable = False
    return low, high


def _numbers(what: str, value: Any) -> Triple:
    try:
        numbers = tuple(float(v) for v in value)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise GeometryError(f"{what} must be three finite numbers (x, y, z); got {value!r}")
    return numbers


def triple(values: Sequence[float] | NDArray[np.float64]) -> Triple:
    """Three numbers."""
    x, y, z = map(float, values)
    return x, y, z


def _within(at: NDArray[np.float64], low: Vector, high: Vector) -> NDArray[np.bool_]:
    return np.asarray(((at >= low) & (at <= high)).all(-1))
