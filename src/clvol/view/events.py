"""Events of pointer and keys to a new state: pure functions, without a device and without a clock.

Events are the dictionaries of rendercanvas: `pointer_down`, `pointer_move`, `pointer_up`, `double_click`, `wheel`, `key_down`,
`key_up`, `resize`; places are in CSS pixels of the pane that they name. A drag is computed from where it began, so that it ends
where it ends however many events there were.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number, one_of
from clvol.base.errors import OptionError
from clvol.scene.camera import Camera
from clvol.scene.mode import modes
from clvol.view.panes import Pane3D, PaneSize, SlicePane, bounds, camera_of, pane_of, rotation, vertical, visible
from clvol.view.state import PANES, CameraState, SliceState, State
from clvol.volume.volume import Volume

__all__ = ["KEYS", "Drag", "Hands", "Place", "Reduced", "faces", "reduce", "shows_box"]

Vector = NDArray[np.float64]

KEYS: Mapping[str, str] = {
    "Arrow keys": "turn by 15°; on a slice: the next or previous slice",
    "PageUp, PageDown": "next / previous slice",
    "+, -": "zoom",
    "[, ]": "roll by 15°",
    "1 to 6": "the mode",
    "x, y, z": "look along an axis; in slices: across it",
    ", and .": "of several volumes the previous / next one, along time if there are times",
    "f": "fit",
    "r": "reset",
    "p": "perspective or orthographic",
    "t": "turntable or trackball",
    "l": "the next layout: volume, slice, linked",
    "h": "heat map of the samples looked at",
    "i (held)": "drag the isovalue",
    "w (held)": "drag the window: up and down its centre, left and right its width",
    "c (held)": "drag a clip plane, a face of the crop box",
    "Shift (held)": "drag pans; the wheel moves slices five at a time",
    "Control (held)": "drag rolls; the wheel zooms slices",
    "Escape": "drop the tool and the crop box",
    "Control+z, u": "undo",
    "Control+y, Control+Shift+z": "redo",
}
"""What keys do, for people."""

_CLICK = 4.0  # CSS pixels: a pointer that moved no farther did not drag
_HANDLE = 12.0  # CSS pixels around the line of the wiper, and around the dot of a clip plane
_STEP = math.radians(15)
_NOTCH = 400.0  # of a wheel's dy that doubles the zoom
_PINCH = 60.0  # likewise of a pinch
_SLICE_NOTCH = 100.0  # of dy a slice
_ZOOM = 0.05, 1000.0
_HELD = {"i": "isovalue", "w": "window", "c": "crop"}
_THINNEST = 1e-3  # of the volume's box: the crop box along each axis
_MODES = ("composite", "isosurface", "mip", "attenuated", "minip", "mean")


@dataclass(frozen=True)
class Place:
    """What a reducer needs to know of the volume and the screen.

    Parameters
    ----------
    volume : Volume
    placed : callable
        ``placed(state, aspect)`` is the camera with its target, as pictures have it.
    sizes : mapping
        By pane.
    isovalue : callable
        Of a state: the isovalue that is drawn.
    window : callable
        Of a state and a pane: (center, width) that is shown.
    anchor : callable, optional
        ``anchor(state, x, y)`` is the world point that the volume's picture shows at a place, or None.
    stepped : callable, optional
        ``stepped(state, by)`` shows another of several volumes.
    initial : State
        What reset goes back to.
    """

    volume: Volume
    placed: Callable[[State, float], Camera]
    sizes: Mapping[str, PaneSize]
    isovalue: Callable[[State], float]
    window: Callable[[State, str], tuple[float, float]]
    anchor: Callable[[State, float, float], Any | None] = lambda state, x, y: None  # noqa: ARG005
    stepped: Callable[[State, int], State] = lambda state, by: state  # noqa: ARG005
    initial: State = field(default_factory=State)

    def size(self, name: str) -> PaneSize:
        """Of a pane; that of the whole canvas where it has none of its own."""
        return self.sizes.get(name) or self.sizes.get("") or PaneSize()

    def pane(self, state: State, name: str) -> Pane3D | SlicePane:
        """The pane of a name."""
        size = self.size(name)
        return pane_of(state, name, self.volume, size, self.placed(state, size.width / size.height))

    def pinned(self, state: State) -> State:
        """The same picture, whose camera no longer follows what is seen: target and radius are numbers."""
        own = state.camera
        if own.target is not None:
            return state
        size = self.size("3d")
        camera = self.placed(state, size.width / size.height)
        radius = camera.radius if camera.radius is not None or own.distance is not None else self.volume.radius
        return replace(state, camera=replace(own, target=camera.target, radius=own.radius or radius))


@dataclass(frozen=True)
class Drag:
    """A pointer that is down: what it does, where it began, and the state then."""

    kind: str
    pane: str
    button: int
    x: float
    y: float
    began: State
    face: tuple[int, int] | None = None  # of the crop box: the axis, and 0 or 1
    moved: bool = False


@dataclass(frozen=True)
class Hands:
    """What the pointer and the keys of one client are at."""

    drag: Drag | None = None
    keys: frozenset[str] = frozenset()
    anchor: tuple[float, float, str, tuple[float, float, float]] | None = None  # of a wheel: x, y, pane, the point under it


@dataclass(frozen=True)
class Reduced:
    """What follows from an event.

    Attributes
    ----------
    state : State
    hands : Hands
    wishes : tuple
        What only the session can do: ("undo",), ("redo",), ("pick", pane, x, y, moves).
    gesture : str or None
        Changes of one gesture, one after the other, are one step of undo.
    """

    state: State
    hands: Hands
    wishes: tuple[tuple[Any, ...], ...] = ()
    gesture: str | None = None


def reduce(state: State, hands: Hands, event: Mapping[str, Any], place: Place) -> Reduced:
    """The state after an event.

    Raises
    ------
    OptionError
        It is no event: no known kind, or a number that is none.
    """
    if not isinstance(event, Mapping):
        raise OptionError(f"an event must be an object of JSON; got {event!r:.200}")
    kind = event.get("event_type", event.get("type"))
    if not isinstance(kind, str) or kind not in _REDUCERS:
        raise one_of("the type of an event", kind, _REDUCERS)
    name = _pane_name(state, event)
    return _REDUCERS[kind](state, hands, event, place, name)


# -- the pointer ---------------------------------------------------------------------------------------------


def _down(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:
    x, y = _place(event)
    button = int(number("button", event.get("button", 1), minimum=0, maximum=16)) or 1
    if hands.drag is not None:  # a second button, or a pointer_up that was lost
        hands = replace(hands, drag=None)
    began = state if state.active == name else replace(state, active=name)  # type: ignore[arg-type]  # a pane's
    face = _grabbed_face(began, hands, event, place, name, (x, y), button)
    kind = "crop" if face is not None else _drag_kind(state, hands, event, place, name, x, button)
    face = _nearest_face(began, place, name, x, y) if kind == "crop" and face is None else face
    pinned = place.pinned(began) if kind in ("orbit", "pan", "roll", "zoom") and name == "3d" else began
    drag = Drag(kind, name, button, x, y, pinned, face)
    moved = _crosshair_at(began, place, name, x, y) if kind == "crosshair" else began
    return Reduced(moved, replace(hands, drag=drag, anchor=None), (), "drag")


def _move(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:  # noqa: ARG001
    drag = hands.drag
    if drag is None:
        return Reduced(state, hands)
    if event.get("buttons") in ((), []) and "buttons" in event:  # it was let go where nobody saw it
        return Reduced(state, replace(hands, drag=None))
    x, y = _place(event)
    moved = drag.moved or math.hypot(x - drag.x, y - drag.y) > _CLICK
    hands = replace(hands, drag=replace(drag, moved=moved))
    if not moved and drag.kind != "crosshair":
        return Reduced(state, hands)
    return Reduced(_DRAGS[drag.kind](drag, place, x, y), hands, (), "drag")


def _up(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:
    drag = hands.drag
    if drag is None:
        return Reduced(state, hands)
    made = _move(state, hands, {key: value for key, value in event.items() if key != "buttons"}, place, name)
    free = replace(made.hands, drag=None)
    assert made.hands.drag is not None  # it was there
    if not made.hands.drag.moved and drag.pane == "3d" and drag.button == 1:
        # a click in the volume moves the crosshair of linked slices
        wishes = (("pick", "3d", drag.x, drag.y, True),) if state.layout == "linked" else ()
        return Reduced(made.state, free, wishes)
    return Reduced(made.state, free, (), "drag")


def _double(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:  # noqa: ARG001
    x, y = _place(event)
    return Reduced(state, replace(hands, drag=None), (("pick", name, x, y, True),))


def _drag_kind(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str, x: float, button: int) -> str:
    modifiers = _modifiers(event)
    if state.wiper is not None and button == 1 and abs(x - state.wiper.at * place.size(name).width) <= _HANDLE:
        return "wiper"
    held = [kind for key, kind in _HELD.items() if key in hands.keys]
    if held:
        return held[0]
    if button == 2:
        return "window" if name != "3d" else "pan"
    if button == 3 or "Shift" in modifiers:
        return "pan"
    if "Control" in modifiers or "Meta" in modifiers:
        return "roll" if name == "3d" else "zoom"
    if state.tool is not None:
        return {"orbit": "crosshair", "roll": "zoom"}.get(state.tool, state.tool) if name != "3d" else _in_volume(state.tool)
    return "orbit" if name == "3d" else "crosshair"


def _in_volume(tool: str) -> str:
    return "orbit" if tool == "crosshair" else tool


# -- drags ---------------------------------------------------------------------------------------------------


def _orbit(drag: Drag, place: Place, x: float, y: float) -> State:
    """The shorter side of the pane is half a turn, and what is in front goes with the pointer."""
    size, began = place.size(drag.pane), drag.began
    scale = math.pi / min(size.width, size.height)
    return replace(began, camera=turned(began.camera, place, (x - drag.x) * scale, (y - drag.y) * scale))


def turned(camera: CameraState, place: Place, right: float, down: float) -> CameraState:
    """A camera for which what is in front has gone by these angles, in radians, to the right and down."""
    view = _view(camera, place)
    if camera.style == "trackball":
        angle = math.hypot(right, down)
        if not angle:
            return camera
        turn = rotation((right * view.up + down * view.right) / angle, -angle)
        return _aimed(camera, turn @ view.forward, turn @ view.up)
    pole = vertical(place.volume)
    level = np.cross(view.forward, pole)
    length = float(np.linalg.norm(level))
    level = level / length if length > 1e-6 else view.right - (view.right @ pole) * pole
    level = level / np.linalg.norm(level)
    if level @ view.right < 0:
        level = -level
    ahead = np.cross(pole, level)  # level: where the camera looks, without its elevation
    below = math.atan2(-float(view.forward @ pole), float(view.forward @ ahead))
    below = min(math.pi / 2, max(-math.pi / 2, below + down))
    around = rotation(pole, -right)
    ahead = around @ ahead
    forward = math.cos(below) * ahead - math.sin(below) * pole
    up = pole if abs(below) < math.pi / 2 - 1e-6 else math.copysign(1, below) * ahead
    return _aimed(camera, forward, up)


def _aimed(camera: CameraState, forward: Vector, up: Vector) -> CameraState:
    return replace(camera, direction=_triple(forward / np.linalg.norm(forward)), up=_triple(up / np.linalg.norm(up)))


def _view(camera: CameraState, place: Place) -> Any:
    return camera_of(State(camera=camera)).view(place.volume)


def _pan(drag: Drag, place: Place, x: float, y: float) -> State:
    """The target's plane goes with the pointer."""
    began = drag.began
    pane = place.pane(began, drag.pane)
    if isinstance(pane, SlicePane):
        by = -((x - drag.x) * pane.right + (y - drag.y) * pane.down) * pane.per_pixel
        return replace(began, slice=replace(began.slice, center=_near(place, pane.middle + by)))
    by = -((x - drag.x) * pane.right + (y - drag.y) * pane.down) * pane.pixel()
    return _moved_by(began, place, by)


def _moved_by(state: State, place: Place, by: Vector) -> State:
    own = place.pinned(state).camera
    assert own.target is not None  # it is pinned
    return replace(state, camera=replace(own, target=_near(place, np.asarray(own.target) + by)))


def _near(place: Place, point: Vector) -> tuple[float, float, float]:
    """The point, or the one towards it that is not too far from the volume to come back."""
    volume = place.volume
    away = point - volume.center
    far = float(np.linalg.norm(away)) / (4 * volume.radius)
    return _triple(volume.center + away / max(1.0, far))


def _zoom_drag(drag: Drag, place: Place, x: float, y: float) -> State:  # noqa: ARG001
    """Down is nearer, about the middle."""
    return _zoomed(drag.began, place, drag.pane, _doubled((y - drag.y) / 100), None)


def _roll(drag: Drag, place: Place, x: float, y: float) -> State:
    size, began = place.size(drag.pane), drag.began
    middle = size.width / 2, size.height / 2
    before, now = (math.atan2(b - middle[1], a - middle[0]) for a, b in ((drag.x, drag.y), (x, y)))
    return replace(began, camera=_rolled(began.camera, place, now - before))


def _rolled(camera: CameraState, place: Place, angle: float) -> CameraState:
    """What is seen goes clockwise."""
    view = _view(camera, place)
    return _aimed(camera, view.forward, rotation(view.forward, -angle) @ view.up)


def _window(drag: Drag, place: Place, x: float, y: float) -> State:
    """Down raises the centre, to the right widens it, as radiologists' programs have it."""
    size, began = place.size(drag.pane), drag.began
    center, width = place.window(began, drag.pane)
    low, high = place.volume.value_range
    span = (high - low) or 1.0
    wider = min(max(width * _doubled(4 * (x - drag.x) / size.width), 1e-4 * span), 10 * span)
    center = min(max(center + (y - drag.y) / size.height * max(width, 0.05 * span), low - span), high + span)
    return replace(began, window=(center, wider))


def _isovalue(drag: Drag, place: Place, x: float, y: float) -> State:  # noqa: ARG001
    """The pane's height is the range of values; up is more."""
    began = drag.began
    if began.mode != "isosurface":
        return began
    low, high = place.volume.value_range
    value = place.isovalue(began) - (y - drag.y) / place.size(drag.pane).height * (high - low)
    return replace(began, options={**began.options, "isovalue": min(max(value, low), high)})


def _crop(drag: Drag, place: Place, x: float, y: float) -> State:
    began = drag.began
    if drag.face is None:
        return began
    axis, side = drag.face
    first, last = bounds(place.volume)
    box = [np.array(corner) for corner in (began.clip or (first, last))]
    pane = place.pane(began, drag.pane)
    way = _face_way(pane, box, axis, side)
    if way is None:
        return began
    by = ((x - drag.x) * way[0] + (y - drag.y) * way[1]) / (way[0] ** 2 + way[1] ** 2)
    least = _THINNEST * (last - first)[axis]
    value = box[side][axis] + by
    value = max(value, box[0][axis] + least) if side else min(value, box[1][axis] - least)
    box[side][axis] = min(max(value, first[axis]), last[axis])
    if box[1][axis] - box[0][axis] < least / 2:
        return began
    return replace(began, clip=(_triple(box[0]), _triple(box[1])))


def _face_middle(box: list[Vector], axis: int, side: int) -> Vector:
    middle = (box[0] + box[1]) / 2
    middle[axis] = box[side][axis]
    return middle


def _face_way(pane: Pane3D | SlicePane, box: list[Vector], axis: int, side: int) -> tuple[float, float] | None:
    """CSS pixels that the middle of a face moves by in the picture, a world unit; None if it moves towards the viewer."""
    small = 1e-3 * float(np.max(box[1] - box[0]))
    middle = _face_middle(box, axis, side)
    step = np.eye(3)[axis] * small
    one, other = pane.project(middle - step), pane.project(middle + step)
    if one is None or other is None:
        return None
    way = (other[0] - one[0]) / (2 * small), (other[1] - one[1]) / (2 * small)
    return way if math.hypot(*way) > 0.05 * pane.unit_pixels else None


def shows_box(state: State, hands: Hands) -> bool:
    """Whether the crop box and the dots of its clip planes lie over the pictures."""
    return state.clip is not None or state.tool == "crop" or "c" in hands.keys


def faces(state: State, place: Place, name: str) -> list[tuple[int, int, float, float]]:
    """The clip planes that can be dragged in a pane: the axis, 0 for the low and 1 for the high one, and where its dot lies."""
    first, last = bounds(place.volume)
    box = [np.array(corner) for corner in (state.clip or (first, last))]
    pane = place.pane(state, name)
    found = []
    for axis in range(3):
        for side in (0, 1):
            at = pane.project(_face_middle(box, axis, side))
            if at is not None and _face_way(pane, box, axis, side) is not None:
                found.append((axis, side, *at))
    return found


def _nearest_face(state: State, place: Place, name: str, x: float, y: float, within: float = math.inf) -> tuple[int, int] | None:
    """The clip plane whose dot lies nearest to a place, if it is no farther than so many CSS pixels."""
    far = [(math.hypot(u - x, v - y), (axis, side)) for axis, side, u, v in faces(state, place, name)]
    nearest = min(far, default=None)
    return nearest[1] if nearest is not None and nearest[0] <= within else None


def _grabbed_face(
    state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str, at: tuple[float, float], button: int
) -> tuple[int, int] | None:
    """The clip plane whose dot the first button takes hold of, where dots are shown; with a key it means something else."""
    if button != 1 or hands.keys or _modifiers(event) or not shows_box(state, hands):
        return None
    return _nearest_face(state, place, name, *at, within=_HANDLE)


def _crosshair(drag: Drag, place: Place, x: float, y: float) -> State:
    return _crosshair_at(drag.began, place, drag.pane, x, y)


def _crosshair_at(state: State, place: Place, name: str, x: float, y: float) -> State:
    pane = place.pane(state, name)
    if not isinstance(pane, SlicePane):
        return state
    return replace(state, crosshair=_inside(place, pane.point(x, y)))


def _wiper(drag: Drag, place: Place, x: float, y: float) -> State:  # noqa: ARG001
    began = drag.began
    if began.wiper is None:
        return began
    return replace(began, wiper=replace(began.wiper, at=min(max(x / place.size(drag.pane).width, 0.0), 1.0)))


_DRAGS: Mapping[str, Callable[[Drag, Place, float, float], State]] = {
    "orbit": _orbit,
    "pan": _pan,
    "zoom": _zoom_drag,
    "roll": _roll,
    "window": _window,
    "isovalue": _isovalue,
    "crop": _crop,
    "crosshair": _crosshair,
    "wiper": _wiper,
}


# -- the wheel -----------------------------------------------------------------------------------------------


def _wheel(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:
    if hands.drag is not None:
        return Reduced(state, hands)
    x, y = _place(event)
    dy = number("dy", event.get("dy", 0), minimum=-1e5, maximum=1e5)
    modifiers = _modifiers(event)
    pinch = "Pinch" in modifiers
    if name != "3d" and not pinch and "Control" not in modifiers:
        return Reduced(
            _sliced(state, place, name, dy / _SLICE_NOTCH * (5 if "Shift" in modifiers else 1)), hands, (), "wheel slice"
        )
    factor = _doubled(-dy / (_PINCH if pinch else _NOTCH))
    if name != "3d":
        return Reduced(_zoomed(state, place, name, factor, (x, y)), hands, (), "wheel zoom")
    state = place.pinned(state)
    known = hands.anchor
    if known is None or known[:3] != (x, y, name):
        pane = place.pane(state, name)
        assert isinstance(pane, Pane3D)  # of the volume
        point = place.anchor(state, x, y)
        if point is None:
            point = pane.at_depth(x, y, pane.distance) if pane.distance > 0 else pane.target
        known = x, y, name, _triple(np.asarray(point, np.float64))
    made = _zoomed(state, place, name, factor, (x, y), np.array(known[3]))
    return Reduced(made, replace(hands, anchor=known), (), "wheel zoom")


def _doubled(times: float) -> float:
    """2 to this power, which no event makes overflow."""
    return float(2.0 ** min(max(times, -32.0), 32.0))


def _zoomed(
    state: State, place: Place, name: str, factor: float, at: tuple[float, float] | None, point: Vector | None = None
) -> State:
    """Magnified so that what lies under a place stays there: `point` in the volume, or the slice's own."""
    if name != "3d":
        zoom = min(max(state.slice.zoom * factor, _ZOOM[0]), _ZOOM[1])
        factor = zoom / state.slice.zoom
        pane = place.pane(state, name)
        assert isinstance(pane, SlicePane)
        center = pane.middle if at is None else pane.middle + (1 - 1 / factor) * (pane.point(*at) - pane.middle)
        return replace(state, slice=SliceState(zoom, _near(place, center)))
    zoom = min(max(state.camera.zoom * factor, _ZOOM[0]), _ZOOM[1])
    factor = zoom / state.camera.zoom
    if at is None or point is None:
        return replace(state, camera=replace(state.camera, zoom=zoom))
    pane = place.pane(state, name)
    assert isinstance(pane, Pane3D)
    to = point - pane.view.eye
    aside = to - (to @ pane.view.forward) * pane.view.forward
    made = _moved_by(state, place, (1 - 1 / factor) * aside)
    return replace(made, camera=replace(made.camera, zoom=zoom))


def _sliced(state: State, place: Place, name: str, slices: float) -> State:
    """The crosshair, moved across the slices of a pane; they are a voxel thick."""
    axis = "xyz".index(name)
    volume = place.volume
    along = np.abs(volume.direction[axis])
    thick = volume.spacing[int(along.argmax())]
    point = np.array(volume.center if state.crosshair is None else state.crosshair, np.float64)
    point[axis] += slices * thick
    return replace(state, crosshair=_inside(place, point))


def _inside(place: Place, point: Vector) -> tuple[float, float, float]:
    return _triple(np.clip(point, *bounds(place.volume)))


# -- keys ----------------------------------------------------------------------------------------------------


def _key(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:
    key = event.get("key")
    if not isinstance(key, str) or len(key) > 40:
        raise OptionError(f"key must be the name of a key; got {key!r:.80}")
    modifiers = _modifiers(event)
    low = key.lower() if len(key) == 1 else key
    if "Control" in modifiers or "Meta" in modifiers:
        again = low == "y" or (low == "z" and "Shift" in modifiers)
        wishes = (("redo",),) if again else (("undo",),) if low == "z" else ()
        return Reduced(state, hands, wishes)
    if low in _HELD:
        return Reduced(state, replace(hands, keys=hands.keys | {low}))
    if low == "u":
        return Reduced(state, hands, (("undo",),))
    if low in _TURNS and name == "3d":
        pinned = place.pinned(state)
        right, down = _TURNS[low]
        return Reduced(replace(pinned, camera=turned(pinned.camera, place, right, down)), hands, (), f"key {low}")
    if low in _SLICES and name != "3d":
        return Reduced(_sliced(state, place, name, _SLICES[low]), hands, (), "key slice")
    if low in ("+", "=", "-"):
        factor = 1.25 if low != "-" else 0.8
        return Reduced(_zoomed(state, place, name, factor, None), hands, (), "key zoom")
    if low in ("[", "]") and name == "3d":
        pinned = place.pinned(state)
        return Reduced(
            replace(pinned, camera=_rolled(pinned.camera, place, _STEP if low == "]" else -_STEP)), hands, (), "key roll"
        )
    if low in (",", "."):
        made = place.stepped(state, 1 if low == "." else -1)
        return Reduced(state if made == state else replace(place.pinned(state), index=made.index), hands, (), "key volume")
    if low in "xyz" and len(low) == 1:
        return Reduced(_along(state, place, name, low), hands)
    if low.isdecimal() and 1 <= int(low) <= len(_MODES):
        return Reduced(state.changed({"mode": _MODES[int(low) - 1]}), hands)
    act = _KEYS.get(low)
    return Reduced(state if act is None else act(state, place), hands)


def _key_up(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:  # noqa: ARG001
    key = event.get("key")
    low = key.lower() if isinstance(key, str) else ""
    return Reduced(state, replace(hands, keys=hands.keys - {low}))


def _along(state: State, place: Place, name: str, axis: str) -> State:
    if name != "3d":
        return replace(state, active=axis)  # type: ignore[arg-type]  # a pane's
    forward = np.eye(3)["xyz".index(axis)] * (-1 if axis in "xz" else 1)
    pole = vertical(place.volume)
    up = np.array([0.0, 1.0, 0.0]) * pole[2] if axis == "z" else pole
    if axis == "z" and place.volume.space in ("LPS", "image"):  # rows run down, and a patient's right is on the left
        forward, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    return replace(state, camera=_aimed(state.camera, forward, up))


def fit(state: State, place: Place | None = None) -> State:  # noqa: ARG001
    """The whole of what can be seen in the middle again, in the volume and in slices; directions stay."""
    camera = replace(state.camera, target=None, distance=None, radius=None, zoom=1.0)
    return replace(state, camera=camera, slice=SliceState())


def reset(state: State, place: Place) -> State:  # noqa: ARG001
    """As it was at first."""
    return place.initial


def _next_layout(state: State, place: Place) -> State:  # noqa: ARG001
    layouts = ("3d", "slice", "linked")
    layout: Any = layouts[(layouts.index(state.layout) + 1) % 3]
    active: Any = "z" if layout == "slice" and state.active == "3d" else "3d" if layout == "3d" else state.active
    return replace(state, layout=layout, active=active)


def _other_projection(state: State, place: Place) -> State:
    """The target's plane keeps its size."""
    own = place.pinned(state).camera
    other: Any = "orthographic" if own.projection == "perspective" else "perspective"
    return replace(state, camera=replace(own, projection=other, distance=None))


def _other_style(state: State, place: Place) -> State:
    style: Any = "trackball" if state.camera.style == "turntable" else "turntable"
    return replace(state, camera=turned(replace(state.camera, style=style), place, 0.0, 0.0))


_KEYS: Mapping[str, Callable[[State, Place], State]] = {
    "f": fit,
    "Home": fit,
    "r": reset,
    "p": _other_projection,
    "t": _other_style,
    "l": _next_layout,
    "h": lambda state, place: replace(state, heat=not state.heat),  # noqa: ARG005
    "Escape": lambda state, place: replace(state, tool=None, clip=None),  # noqa: ARG005
}
_TURNS = {"ArrowLeft": (-_STEP, 0.0), "ArrowRight": (_STEP, 0.0), "ArrowUp": (0.0, -_STEP), "ArrowDown": (0.0, _STEP)}
_SLICES = {"ArrowUp": 1.0, "PageUp": 1.0, "ArrowRight": 1.0, "ArrowDown": -1.0, "PageDown": -1.0, "ArrowLeft": -1.0}
assert set(_MODES) == set(modes())  # a number for each


# -- what events say -----------------------------------------------------------------------------------------


def _ignored(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:  # noqa: ARG001
    return Reduced(state, hands)


def _left(state: State, hands: Hands, event: Mapping[str, Any], place: Place, name: str) -> Reduced:  # noqa: ARG001
    """The pointer or the focus is elsewhere: keys that are let go there are not seen."""
    return Reduced(state, replace(hands, keys=frozenset()))


_REDUCERS: Mapping[str, Callable[[State, Hands, Mapping[str, Any], Place, str], Reduced]] = {
    "pointer_down": _down,
    "pointer_move": _move,
    "pointer_up": _up,
    "double_click": _double,
    "wheel": _wheel,
    "key_down": _key,
    "key_up": _key_up,
    "pointer_enter": _ignored,
    "pointer_leave": _ignored,
    "char": _ignored,
    "blur": _left,
    "close": _ignored,
    "before_draw": _ignored,
    "animate": _ignored,
}


def _place(event: Mapping[str, Any]) -> tuple[float, float]:
    return (
        number("x of an event", event.get("x"), minimum=-1e6, maximum=1e6),
        number("y of an event", event.get("y"), minimum=-1e6, maximum=1e6),
    )


def _modifiers(event: Mapping[str, Any]) -> frozenset[str]:
    given = event.get("modifiers", ())
    if not isinstance(given, (list, tuple)) or not all(isinstance(word, str) for word in given):
        raise OptionError(f"modifiers must be a list of names of keys; got {given!r:.200}")
    return frozenset("Control" if word == "Ctrl" else word for word in given)


def _pane_name(state: State, event: Mapping[str, Any]) -> str:
    """The pane that an event names, or the one that is shown."""
    name = event.get("pane")
    if name is None:
        shown = visible(state)
        return state.active if state.active in shown else shown[0]
    if not isinstance(name, str) or name not in PANES:
        raise one_of("pane", name, PANES)
    return name


def _triple(vector: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z
