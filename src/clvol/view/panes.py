"""Where the pixels of panes lie in the world: pictures of the volume, and slices through it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clvol.march.slices import Sheet, axis_directions
from clvol.scene.camera import Camera, Viewpoint
from clvol.view.state import PANES, SliceState, State, Triple
from clvol.volume.volume import Volume

__all__ = [
    "Pane3D",
    "PaneSize",
    "SlicePane",
    "Vector",
    "active_pane",
    "bounds",
    "camera_of",
    "pane_of",
    "rotation",
    "traces",
    "triple",
    "turned_slices",
    "vertical",
    "visible",
]

Vector: TypeAlias = NDArray[np.float64]
_MARGIN = 1.04
_STRAIGHT = 1e-9  # sine of an angle that is none


class PaneSize(NamedTuple):
    """A pane on the client's screen: CSS pixels, and pixels of the screen per CSS pixel."""

    width: float = 512.0
    height: float = 512.0
    ratio: float = 1.0


def triple(vector: Any) -> Triple:
    """Three numbers as a tuple of floats."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


def vertical(volume: Volume) -> Vector:
    """The world's up: z, or -z for stacks of images, whose slices run away from the viewer."""
    return np.array([0.0, 0.0, -1.0 if volume.space == "image" else 1.0])


def bounds(volume: Volume) -> tuple[Vector, Vector]:
    """The world's bounding box of the volume's domain."""
    return volume.corners.min(0), volume.corners.max(0)


def visible(state: State) -> tuple[str, ...]:
    """The panes that a layout shows."""
    if state.layout == "3d":
        return ("3d",)
    if state.layout == "slice":
        return (state.active if state.active != "3d" else "z",)
    return (state.active,) if state.enlarged else PANES


def active_pane(state: State) -> str:
    """The pane that keys and copies are for: the active one, if the layout shows it."""
    return state.active if state.active in visible(state) else visible(state)[0]


def camera_of(state: State) -> Camera:
    """The camera of the volume's picture."""
    given = dict(vars(state.camera))
    del given["style"]
    return Camera(**given)


@dataclass(frozen=True)
class Pane3D:
    """A picture of the volume by a placed camera."""

    size: PaneSize
    view: Viewpoint
    target: Vector  # the point that the camera looks at

    @classmethod
    def of(cls, camera: Camera, volume: Volume, size: PaneSize) -> Pane3D:
        """The pane of a camera whose target is known, or is the volume's centre."""
        view = camera.view(volume, size.width / size.height)
        return cls(size, view, np.asarray(volume.center if camera.target is None else camera.target, np.float64))

    @property
    def right(self) -> Vector:
        return self.view.right

    @property
    def down(self) -> Vector:
        return -self.view.up

    @property
    def distance(self) -> float:
        """From the eye to the target, along the view."""
        return float((self.target - self.view.eye) @ self.view.forward)

    def pixel(self, depth: float | None = None) -> float:
        """World units per CSS pixel at a distance from the eye's plane; by default the target's."""
        scale = 2 * self.view.half_height / self.size.height
        return scale if self.view.orthographic else scale * (self.distance if depth is None else depth)

    def ray(self, x: float, y: float) -> tuple[Vector, Vector]:
        """Origin and unit direction of the ray through (x, y), in CSS pixels."""
        view, (width, height, _) = self.view, self.size
        scale = 2 * view.half_height / height
        offset = (x - width / 2) * scale * view.right - (y - height / 2) * scale * view.up
        if view.orthographic:
            return view.eye + offset, view.forward
        way = view.forward + offset
        return view.eye, way / np.linalg.norm(way)

    def at_depth(self, x: float, y: float, depth: float) -> Vector:
        """The world point on that ray at a distance from the eye's plane."""
        origin, way = self.ray(x, y)
        return np.asarray(origin + way * (depth / float(way @ self.view.forward)))

    def project(self, point: Any) -> tuple[float, float] | None:
        """The position of a world point, in CSS pixels; None behind the eye."""
        to = np.asarray(point, np.float64) - self.view.eye
        depth = float(to @ self.view.forward)
        if not self.view.orthographic and depth <= 1e-9 * max(1.0, float(np.linalg.norm(to))):
            return None
        scale = self.pixel(depth)
        return (self.size.width / 2 + float(to @ self.view.right) / scale, self.size.height / 2 - float(to @ self.view.up) / scale)

    @property
    def unit_pixels(self) -> float:
        """CSS pixels per world unit at the target."""
        return 1 / self.pixel()


@dataclass(frozen=True)
class SlicePane:
    """A slice across an axis of the world, seen as by radiologists: from the feet, the patient's right on the left.

    Where slices are turned it stands as it would if it had been turned there the shortest way.
    """

    size: PaneSize
    normal: Vector  # a unit vector: the axis that it is across, if slices are not turned
    middle: Vector  # the world point in the middle of the pane
    right: Vector  # world directions in the picture
    down: Vector
    per_pixel: float  # world units per CSS pixel
    words: dict[str, Any]  # of a slab and of contours, as `clvol.slice` takes them

    @classmethod
    def of(cls, state: State, volume: Volume, axis: int, size: PaneSize) -> SlicePane:
        """The pane of a state."""
        frames = [_frame(state.slice, volume.space, i) for i in (range(3) if state.slice.alike else (axis,))]
        fitted = _MARGIN * max(
            max(np.ptp(volume.corners @ right) / size.width, np.ptp(volume.corners @ down) / size.height)
            for _, right, down in frames
        )
        normal, right, down = _frame(state.slice, volume.space, axis)
        middle = np.array(volume.center if state.slice.center is None else state.slice.center, np.float64)
        through = np.asarray(volume.center if state.crosshair is None else state.crosshair, np.float64)
        if state.slice.turn is None:
            middle[axis] = through[axis]
        else:
            middle += ((through - middle) @ normal) * normal
        return cls(size, normal, middle, right, down, float(fitted) / state.slice.zoom, state.slice.words)

    def sheet(self, size: tuple[int, int]) -> Sheet:
        """The points of a picture that fills it, and what its pixels show."""
        return Sheet.of(self.middle, self.right, self.down, self.pixel(size), size, self.words)

    def pixel(self, size: tuple[int, int]) -> tuple[float, float]:
        """World units per pixel of a picture that fills it, along rows and columns."""
        return self.size.width * self.per_pixel / size[0], self.size.height * self.per_pixel / size[1]

    def point(self, x: Any, y: Any) -> Vector:
        """World points at (x, y), in CSS pixels; (..., 3)."""
        u = (np.asarray(x, np.float64) - self.size.width / 2) * self.per_pixel
        v = (np.asarray(y, np.float64) - self.size.height / 2) * self.per_pixel
        return np.asarray(self.middle + u[..., None] * self.right + v[..., None] * self.down)

    def project(self, point: Any) -> tuple[float, float]:
        """The position of a world point's projection onto the slice, in CSS pixels."""
        to = (np.asarray(point, np.float64) - self.middle) / self.per_pixel
        return self.size.width / 2 + float(to @ self.right), self.size.height / 2 + float(to @ self.down)

    @property
    def unit_pixels(self) -> float:
        """CSS pixels per world unit."""
        return 1 / self.per_pixel


def _frame(state: SliceState, space: str, axis: int) -> tuple[Vector, Vector, Vector]:
    """The normal of the slice of an axis, and its directions to the right and down."""
    across, (right, down) = np.eye(3)[axis], axis_directions(space, axis)
    if state.turn is None:
        return across, right, down
    whole = Rotation.from_rotvec(state.turn)
    normal = np.asarray(whole.apply(across))
    about, cosine = np.cross(across, normal), float(across @ normal)
    sine = float(np.linalg.norm(about))
    if sine > _STRAIGHT:  # the shortest way: a plane that turns about its normal stays as it is
        whole = Rotation.from_rotvec(about / sine * math.atan2(sine, cosine))
    elif cosine > 0:
        return normal, right, down
    return normal, np.asarray(whole.apply(right)), np.asarray(whole.apply(down))


def traces(state: State, volume: Volume, name: str, pane: SlicePane) -> list[tuple[float, float]]:
    """Directions, to the right and down, of the lines in which the two other slices cut this one."""
    found = []
    for axis in (i for i in range(3) if "xyz"[i] != name):
        along = np.cross(pane.normal, _frame(state.slice, volume.space, axis)[0])
        found.append((float(along @ pane.right), float(along @ pane.down)))
    return found


def turned_slices(state: SliceState, axis: Vector, angle: float) -> Triple:
    """`SliceState.turn` after the planes have turned further, by an angle in radians, about a unit axis."""
    before = Rotation.from_rotvec((0.0, 0.0, 0.0) if state.turn is None else state.turn)
    return triple((Rotation.from_rotvec(angle * axis) * before).as_rotvec())


def pane_of(state: State, name: str, volume: Volume, size: PaneSize, placed: Camera) -> Pane3D | SlicePane:
    """The pane with this name; `placed` is the camera with its target."""
    return Pane3D.of(placed, volume, size) if name == "3d" else SlicePane.of(state, volume, "xyz".index(name), size)


def rotation(axis: Vector, angle: float) -> Vector:
    """The right-handed rotation by an angle, in radians, about a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(math.cos(angle) * np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * np.outer(axis, axis))
