"""Options of pictures that change in the course of a film, between key frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from clvol.base.checks import number
from clvol.base.color import color_of
from clvol.base.errors import OptionError
from clvol.scene.camera import Camera

__all__ = ["Keyframes", "camera_between"]

_COLORS = ("background", "color")  # options that a name may stand for
_COUNTS = ("rays", "virtual")  # options of whole numbers
_LIKE = ("projection", "fit", "upright")
_OPEN = ("position", "target", "distance", "radius")
_LENGTHS = ("fov", "zoom", "distance", "radius")


@dataclass(frozen=True)
class Keyframes:
    """Options at some moments of a film.

    Parameters
    ----------
    at : mapping of float to mapping
        Options by moment: 0 is the first picture and 1 the last. Between two moments numbers, colours and whatever consists of
        numbers are interpolated linearly, cameras as by `camera_between`; words, switches and counts stay until the next moment.
        Before the first and after the last moment that names it an option stays as it is there.

    Raises
    ------
    OptionError
        There is no moment, one is not a number from 0 to 1, a count is not whole, or two values of one option cannot be
        interpolated.
    """

    at: Mapping[float, Mapping[str, Any]]

    def __post_init__(self) -> None:
        rule = "keyframes must map moments, numbers from 0 (the first picture) to 1 (the last), to options"
        if not isinstance(self.at, Mapping) or not self.at:
            raise OptionError(f"{rule}; got {self.at!r}")
        for moment, options in self.at.items():
            if not isinstance(options, Mapping):
                raise OptionError(f"{rule}, as in {{0: {{'isovalue': 1}}, 1: {{'isovalue': 9}}}}; got {options!r} at {moment!r}")
            for name in options.keys() & set(_COUNTS):
                if isinstance(count := options[name], Real) and not float(count).is_integer():
                    raise OptionError(f"{name} of key frames must be whole numbers; got {count!r} at {moment!r}")
        sorted_out = {number("a moment of keyframes", m, minimum=0, maximum=1): dict(o) for m, o in self.at.items()}
        object.__setattr__(self, "at", dict(sorted(sorted_out.items())))
        for moment in (*self.at, *((a + b) / 2 for a, b in zip(self.at, [*self.at][1:], strict=False))):
            self.options(moment)

    @property
    def names(self) -> tuple[str, ...]:
        """The options that they name."""
        return tuple(dict.fromkeys(name for options in self.at.values() for name in options))

    def options(self, moment: float) -> dict[str, Any]:
        """The options at a moment."""
        found = {}
        for name in self.names:
            moments = [m for m, options in self.at.items() if name in options]
            before = max((m for m in moments if m <= moment), default=moments[0])
            after = min((m for m in moments if m >= moment), default=moments[-1])
            share = (moment - before) / (after - before) if after > before else 0.0
            found[name] = _between(name, self.at[before][name], self.at[after][name], share)
        return found


def _between(name: str, a: Any, b: Any, share: float) -> Any:
    """The value at a share of the way from one value of an option to another."""
    if share in (0, 1):
        return b if share else a
    if isinstance(a, Camera) and isinstance(b, Camera):
        return camera_between(a, b, share)
    if name in _COLORS:
        a, b = (color_of(name, one) if isinstance(one, str) else one for one in (a, b))
    if name in _COUNTS or _is_word(a) or _is_word(b):
        if not (name in _COUNTS or (_is_word(a) and _is_word(b))):
            raise _unlike(name, a, b)
        return a
    if isinstance(a, Real) and isinstance(b, Real):
        return (1 - share) * float(a) + share * float(b)
    if is_dataclass(a) and type(a) is type(b) and not isinstance(a, type):
        own = [field.name for field in fields(a) if field.init]
        return replace(a, **{one: _between(f"{name}.{one}", getattr(a, one), getattr(b, one), share) for one in own})
    if isinstance(a, (Sequence, np.ndarray)) and isinstance(b, (Sequence, np.ndarray)) and len(a) == len(b):
        return tuple(_between(name, x, y, share) for x, y in zip(a, b, strict=True))
    raise _unlike(name, a, b)


def _is_word(value: Any) -> bool:
    """Whether it has no values between it and another."""
    return value is None or value is ... or isinstance(value, (str, bool, np.bool_, type))


def _unlike(name: str, a: Any, b: Any) -> OptionError:
    return OptionError(f"{name} of key frames must be of one kind, with as many numbers in each; got {a!r} and {b!r}")


def camera_between(a: Camera, b: Camera, share: float) -> Camera:
    """A camera on the way from one to another, at a share of it from 0 to 1.

    The view turns about one axis by the shortest way, which is the great circle between both orientations: cameras of
    equal elevation keep it. A half turn goes the way in which `azimuth` grows. Targets, distances, zoom and fields of view are
    interpolated linearly, and so are positions relative to the target.

    Raises
    ------
    OptionError
        Only one of them has a position (or target, distance, radius), one with a position has no target, or they differ in
        projection, fit or frame.
    """
    for what in _LIKE:
        if getattr(a, what) != getattr(b, what):
            raise OptionError(f"cameras of key frames must have one {what}; got {getattr(a, what)!r} and {getattr(b, what)!r}")
    for what in _OPEN:
        if (getattr(a, what) is None) != (getattr(b, what) is None):
            raise OptionError(f"cameras of key frames must both have a {what}, or none; got {a} and {b}")
    if a.position is not None and a.target is None:
        raise OptionError(f"cameras of key frames that have a position must have a target; got {a} and {b}")

    def mixed(x: Any, y: Any) -> Any:
        return None if x is None else (1 - share) * np.asarray(x) + share * np.asarray(y)

    forward, up = _turned(_frame(a), _frame(b), share)
    lengths = {what: None if getattr(a, what) is None else float(mixed(getattr(a, what), getattr(b, what))) for what in _LENGTHS}
    target = mixed(a.target, b.target)
    changes: dict[str, Any] = {"up": tuple(up), "target": None if target is None else tuple(target), **lengths}
    if a.position is None:
        return replace(a, direction=tuple(forward), **changes)
    away = mixed(*(math.dist(one.position, one.target) for one in (a, b)))  # type: ignore[arg-type]  # both have them
    return replace(a, position=tuple(target - away * forward), **changes)


def _frame(camera: Camera) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Unit vectors right, up and forward, as the columns of a matrix."""
    forward = np.asarray(camera.direction if camera.position is None else np.subtract(camera.target, camera.position), np.float64)  # type: ignore[arg-type]
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(camera.up) / math.hypot(*camera.up))
    if np.linalg.norm(right) < 1e-9:  # looking straight along `up`, as in `Camera.view`
        right = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward], 1)


def _turned(a: Any, b: Any, share: float) -> tuple[Any, Any]:
    """The forward and up vectors on the way from one frame to another."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(b @ a.T).as_rotvec()
    if float(np.linalg.norm(turn)) > math.pi - 1e-6 and turn @ a[:, 1] < 0:  # either way is as short
        turn = -turn
    way = Rotation.from_rotvec(share * turn).as_matrix() @ a
    return way[:, 2], way[:, 1]
