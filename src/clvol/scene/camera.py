"""Orthographic and perspective cameras in the world."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import is_triple, reals
from clvol.base.checks import instance, number, one_of, suggests_options, whole
from clvol.base.errors import GeometryError, OptionError
from clvol.base.uniform import FLOAT, INT, REACH, Block, Values
from clvol.base.vectors import cross, length
from clvol.volume.volume import Volume

__all__ = ["Camera", "Viewpoint"]

_PROJECTIONS = ("perspective", "orthographic")
_FITS = ("matter", "volume")
_WORLD = np.eye(3)
_FRAMES = {"image": np.diag([1.0, -1.0, -1.0])}  # from the viewing frame to the world, for worlds not viewed with z up
_FARTHEST = 1e20  # mean spacings from a volume's centre, so that no number for kernels overflows
_ALONG = 16  # ratio of the tolerances of points along their rays and off them
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Viewpoint:
    """A camera fitted to one volume: the rays are computed from it."""

    eye: Vector  # in the world
    right: Vector  # spans the picture with `up`; both are orthonormal with `forward`
    up: Vector
    forward: Vector
    half_height: float  # of the picture in world units; in perspective at distance 1
    orthographic: bool

    BLOCK: ClassVar[Block] = Block(
        "camera_block",
        origin=(FLOAT, 3),
        origin_u=(FLOAT, 3),
        origin_v=(FLOAT, 3),
        direction=(FLOAT, 3),
        direction_u=(FLOAT, 3),
        direction_v=(FLOAT, 3),
        eye=(FLOAT, 3),
        ahead=FLOAT,
        orthographic=INT,
    )

    def reach(self, volume: Volume, aspect: float) -> float:
        """Largest position, in voxels, used to compute rays through the volume; at least its longest axis.

        Positions are rounded to float32, so that the error of points is up to 2⁻²² of this, mostly along their rays if the volume
        is much thinner along the view than across.

        Raises
        ------
        GeometryError
            The error of points would exceed 1/16 of a voxel off their rays, or a voxel along them; or the camera is too far
            away for float32.
        """
        size, inverse, to_center = np.asarray(volume.size), volume.world_to_index_matrix, volume.center - self.eye
        corner = self.half_height * np.hypot(aspect, 1)
        ahead = float(to_center @ self.forward)
        aside = math.hypot(*(to_center - ahead * self.forward))  # does not overflow for any camera
        if not math.hypot(ahead, aside) <= _FARTHEST * volume.mean_spacing:
            raise GeometryError(
                f"the camera must be within {_FARTHEST:g} mean spacings of the volume's centre, the range of float32; "
                f"got {self.eye}"
            )
        if self.orthographic:
            seen = aside - volume.radius <= corner
            spread = 1.0
        else:
            distance = math.hypot(aside, ahead)
            turn = math.asin(min(1.0, volume.radius / distance)) if distance > 0 else math.pi
            seen = math.atan2(aside, ahead) - turn <= math.atan(corner)
            spread = max(abs(ahead), volume.radius)  # directions are rounded as well, and followed through the volume
        longest = float(size.max())
        if not seen:
            return longest
        across = [inverse @ (self.half_height * (a * aspect * self.right + self.up)) for a in (-1, 1)]
        middle = inverse @ (to_center - ahead * self.forward)
        reach = length(middle) + spread * max(map(length, across))
        # Each coordinate is rounded separately, which moves a point off its ray by the sine of its angle to that axis.
        off = self._turns(inverse, aspect)
        astray = length(off * middle) + spread * max(length(off * v) for v in across)
        span = max(astray, reach / _ALONG)
        if not span <= REACH:
            raise GeometryError(
                f"a picture must span at most {REACH} voxels from the volume's centre to its corners, or the error of float32 "
                f"exceeds 1/16 of a voxel (a voxel along rays, which count 1/{_ALONG}); fov and zoom, the camera's position and "
                f"the spacings {volume.spacing} give {span:.3g}"
            )
        return max(longest, reach)

    def corner_rays(self, inverse: Vector, aspect: float) -> list[Vector]:
        """Directions of the rays through the picture's corners, in index space."""
        corner = 0.0 if self.orthographic else self.half_height
        sides = itertools.product((-1, 1), repeat=2)
        return [inverse @ (self.forward + corner * (a * aspect * self.right + b * self.up)) for a, b in sides]

    def _turns(self, inverse: Vector, aspect: float) -> Vector:
        """The sine of the largest angle between any ray and each axis, in index space; (3,)."""
        rays = np.stack(self.corner_rays(inverse, aspect))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        # on one side of an axis, the ray with the largest angle to it is that of a corner
        one_side = (rays > 0).all(0) | (rays < 0).all(0)
        return np.where(one_side, np.linalg.norm(rays[:, [[1, 2], [2, 0], [0, 1]]], axis=-1).max(0), 1.0)

    def eye_in(self, volume: Volume) -> NDArray[np.float32]:
        """The eye in samples, rounded as in kernels, for decisions that must agree on host and device."""
        return volume.world_to_index(self.eye).astype(np.float32)

    def project(self, points: NDArray[np.float64], width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (x, y) from the upper left corner, (n, 2), at which points of the world, (n, 3), are seen, and their depths.

        In perspective, what lies behind the viewer, where depth is negative, has no meaningful pixel.
        """
        away = np.asarray(points, np.float64) - self.eye
        depth = away @ self.forward
        spread = self.half_height * (np.ones_like(depth) if self.orthographic else depth)
        with np.errstate(divide="ignore", invalid="ignore"):
            across, up = (away @ way / spread * height / 2 for way in (self.right, self.up))
        return np.stack([width / 2 + across, height / 2 - up], -1), depth

    def pixels_per_unit(self, point: NDArray[np.float64], height: int) -> float:
        """Pixels that a unit of the world is long, across the view, in the plane through a point that faces the camera."""
        depth = 1.0 if self.orthographic else float((point - self.eye) @ self.forward)
        return height / (2 * self.half_height * depth)

    def block(self, volume: Volume, width: int, height: int, aspect: float | None = None, *, rails: Volume | None = None) -> Values:
        """The block for kernels: rays in index space as linear functions of the pixel, (0, 0) top left.

        Pixels are square unless `aspect` is given: the ``width / height`` of a full picture, from which a smaller one may
        differ by rounding.

        Rays start on the plane through the volume's centre that faces the camera, where float32 is most precise. Lengths are
        in mean spacings, so that none is too large or too small for float32. With `rails`, another volume, both are that one's.
        """
        lead = rails or volume
        aspect = width / height if aspect is None else aspect
        inverse, origin = volume.world_to_index_matrix, np.asarray(volume.origin)
        # picture coordinates: -1 to 1 along `right` and along `up`
        across, down = self.right * self.half_height * aspect, -self.up * self.half_height
        corner, per_x, per_y = -across - down, 2 * across / width, 2 * down / height
        unit = lead.mean_spacing
        ahead = float((lead.center - self.eye) @ self.forward)
        start = inverse @ (self.eye + ahead * self.forward - origin)
        spread = 1.0 if self.orthographic else ahead
        fan = 0.0 if self.orthographic else unit
        return self.BLOCK(
            origin=start + spread * (inverse @ corner),
            origin_u=spread * (inverse @ per_x),
            origin_v=spread * (inverse @ per_y),
            direction=unit * (inverse @ self.forward) + fan * (inverse @ corner),
            direction_u=fan * (inverse @ per_x),
            direction_v=fan * (inverse @ per_y),
            eye=self.eye_in(volume),
            ahead=ahead / unit,
            orthographic=self.orthographic,
        )


@suggests_options
@dataclass(frozen=True)
class Camera:
    """A camera; fields that are None are fitted to the volume on rendering.

    Parameters
    ----------
    position : sequence of float, optional
        World position (x, y, z). None: far enough back along `direction` to see a sphere of `radius` around the target.
    target : sequence of float, optional
        World point that the camera looks at; None: the centre of the fit, or the volume's centre if `position`,
        `distance` or `radius` is given.
    up : sequence of float
        Direction that points up in the picture.
    direction : sequence of float
        Direction of view if `position` is None.
    projection : {"perspective", "orthographic"}
    fov : float
        Vertical field of view of a perspective camera, degrees.
    distance : float, optional
        World distance from the target if `position` is None.
    zoom : float
        Magnification of the picture about its centre.
    radius : float, optional
        World radius of the sphere around the target that just fits into the picture; None: chosen by `fit` if `position`,
        `target` and `distance` are None as well, else that of the volume.
    fit : {"matter", "volume"}
        What a camera without a position is fitted to. "matter": all that the mode and the transfer function of the
        picture show of the volume, within the clip box, rotated about the vertical
        (`clvol.scene.fit`).
        "volume": the sphere around the whole volume. With both, the scale stays constant while a camera orbits.
    upright : bool
        Whether `direction` and `up` are in the viewing frame of the volume, not in its world. The frame of a stack of images
        (`Volume.space` is "image") is rotated by 180° about x, so that -z is up in its pictures, and from above rows
        run down. All others have z up in both, so that it makes no difference.

    Examples
    --------
    >>> import clvol
    >>> camera = clvol.Camera.orbit(azimuth=30, elevation=20, zoom=1.2)
    >>> len(clvol.Camera.turntable(36))
    36
    """

    position: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 1.0, 0.0)
    projection: Literal["perspective", "orthographic"] = "perspective"
    fov: float = 30.0
    distance: float | None = None
    zoom: float = 1.0
    radius: float | None = None
    fit: Literal["matter", "volume"] = "matter"
    upright: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.projection, str) or self.projection not in _PROJECTIONS:
            raise one_of("projection", self.projection, _PROJECTIONS)
        for what in ("position", "target", "up", "direction"):
            value = getattr(self, what)
            if value is not None or what in ("up", "direction"):
                object.__setattr__(self, what, _vector(what, value))
        object.__setattr__(self, "fov", number("fov", self.fov, above=0, below=180))
        object.__setattr__(self, "zoom", number("zoom", self.zoom, above=0))
        for what in ("distance", "radius"):
            if getattr(self, what) is not None:
                object.__setattr__(self, what, number(what, getattr(self, what), above=0))
        if not isinstance(self.fit, str) or self.fit not in _FITS:
            raise one_of("fit", self.fit, _FITS)
        instance("upright", self.upright, bool, np.bool_)
        if self.position is not None:
            plain = {"distance": None, "direction": (0.0, 1.0, 0.0), "fit": "matter"}
            for what in (name for name, value in plain.items() if getattr(self, name) != value):
                raise OptionError(
                    f"{what} changes nothing in a camera with a position: it looks from there at its target; leave it out"
                )
        for what in ("up", "direction"):
            if not any(getattr(self, what)):
                raise GeometryError(f"{what} must not have zero length")

    @classmethod
    @suggests_options
    def orbit(
        cls,
        azimuth: float = 30.0,
        elevation: float = 20.0,
        distance: float | None = None,
        zoom: float = 1.0,
        *,
        target: Sequence[float] | None = None,
        projection: Literal["perspective", "orthographic"] = "perspective",
        fov: float = 30.0,
        radius: float | None = None,
        fit: Literal["matter", "volume"] = "matter",
    ) -> Camera:
        """An upright camera on a sphere around the target.

        Parameters
        ----------
        azimuth : float
            Degrees about the z axis; 0 looks along +y, and 90 from +x along -x. At 0 a patient (`Volume.space` is "LPS") is
            seen from the front, with the right side on the viewer's left.
        elevation : float
            Degrees above the xy plane; 90 looks straight down. A stack of images (`Volume.space` is "image") then looks as
            in Fiji and napari: slice 0 nearest to the viewer, x to the right, y down. Other elevations and
            azimuths rotate it as they rotate others; its z points down, and azimuth 0 looks along -y.
        distance, zoom, target, projection, fov, radius, fit
            See `Camera`.
        """
        a, e = math.radians(number("azimuth", azimuth)), math.radians(number("elevation", elevation))
        return cls(
            target=None if target is None else _vector("target", target),
            up=(-math.sin(a) * math.sin(e), math.cos(a) * math.sin(e), math.cos(e)),
            direction=(-math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), -math.sin(e)),
            projection=projection,
            fov=fov,
            distance=distance,
            zoom=zoom,
            radius=radius,
            fit=fit,
            upright=True,
        )

    @classmethod
    def turntable(cls, frames: int, elevation: float = 20.0, **camera: Any) -> list[Camera]:
        """Cameras on a full turn around the target, at equal angles.

        Parameters
        ----------
        frames : int
            Their number, 1 or more.
        elevation : float
            Degrees.
        **camera
            As of `orbit`; `azimuth` is the first camera's.

        Raises
        ------
        OptionError
            `frames` is no whole number of at least 1, or an argument of `orbit` is refused.
        """
        frames = whole("frames", frames, minimum=1)
        first = camera.pop("azimuth", 0.0)
        return [cls.orbit(first + 360 * i / frames, elevation, **camera) for i in range(frames)]

    @classmethod
    def look_at(
        cls,
        position: Sequence[float],
        target: Sequence[float] | None = None,
        up: Sequence[float] = (0.0, 0.0, 1.0),
        *,
        projection: Literal["perspective", "orthographic"] = "perspective",
        fov: float = 30.0,
        zoom: float = 1.0,
    ) -> Camera:
        """A camera at `position` that looks at `target`, by default the volume's centre."""
        camera = cls(
            position=_vector("position", position),
            target=None if target is None else _vector("target", target),
            up=_vector("up", up),
            projection=projection,
            fov=fov,
            zoom=zoom,
        )
        if camera.position == camera.target:
            raise GeometryError(f"position and target must differ, to define a direction of view; got {position} twice")
        return camera

    def in_world(self, volume: Volume) -> Camera:
        """The same camera with its directions in the world, where they are in the viewing frame of this volume (`upright`)."""
        if not self.upright:
            return self
        frame = _FRAMES.get(volume.space, _WORLD)
        up, direction = (_vector("direction", frame @ np.asarray(way)) for way in (self.up, self.direction))
        return replace(self, up=up, direction=direction, upright=False)

    def zoomed(self, factor: float) -> Camera:
        """A copy with the zoom multiplied by `factor`."""
        return replace(self, zoom=self.zoom * number("factor", factor, above=0))

    def view(self, volume: Volume, aspect: float = 1.0) -> Viewpoint:
        """The camera fitted to a volume and a picture of ``width / height = aspect``.

        A camera without a position sees the volume's bounding sphere; only a picture knows what is visible (`clvol.scene.fit`).

        Raises
        ------
        GeometryError
            The camera is at its target.
        """
        target = volume.center if self.target is None else np.asarray(self.target)
        radius = volume.radius if self.radius is None else self.radius
        upright = _FRAMES.get(volume.space, _WORLD) if self.upright else _WORLD
        if self.position is None:
            forward = upright @ np.asarray(self.direction) / math.hypot(*self.direction)  # hypot avoids underflow
        else:
            with np.errstate(over="ignore"):
                forward = target - np.asarray(self.position)
            if not np.isfinite(forward).all():
                raise GeometryError(f"position must be within 1.8e308 of its target, the range of float64; got {self.position}")
            forward = np.ldexp(forward, -math.frexp(float(np.abs(forward).max()))[1])  # avoids overflow of squares
            away = length(forward)
            if not away:
                raise GeometryError(f"position and target must differ, to define a direction of view; got {self.position} twice")
            forward = forward / away
        right = cross(forward, upright @ np.asarray(self.up) / math.hypot(*self.up))
        if length(right) < 1e-9:  # looking straight along `up`
            right = cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
        right = right / length(right)
        half_angle = math.radians(self.fov) / 2
        narrow = min(1.0, aspect)  # the picture's shorter side must hold the sphere
        fitted = radius / math.sin(math.atan(math.tan(half_angle) * narrow))
        distance = self.distance if self.distance is not None else fitted
        eye = target - distance * forward if self.position is None else np.asarray(self.position)
        orthographic = self.projection == "orthographic"
        half_height = radius / narrow if orthographic else math.tan(half_angle)
        return Viewpoint(eye, right, cross(right, forward), forward, half_height / self.zoom, orthographic)


def _vector(what: str, value: object) -> tuple[float, float, float]:
    if is_triple(value):
        return cast(tuple[float, float, float], value)
    rule = "three numbers (x, y, z)"
    vector = reals(what, value, rule, GeometryError)
    if vector.shape != (3,):
        raise GeometryError(f"{what} must be {rule}; got {value!r}")
    if not np.isfinite(vector).all():
        raise GeometryError(f"{what} must be finite; got {value!r}")
    x, y, z = (float(v) for v in vector)
    return x, y, z
