"""From events of pointer and keys to a new state: pure functions, without a device or a clock.

Events are the dictionaries of rendercanvas: `pointer_down`, `pointer_move`, `pointer_up`, `double_click`, `wheel`, `key_down`,
`key_up`, `resize`; positions are in CSS pixels of the pane that they name. A drag is computed from where it began, so that the
number of events between does not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clvol.base.checks import number
from clvol.base.errors import OptionError
from clvol.scene.camera import Camera
from clvol.scene.mode import modes
from clvol.view import marks
from clvol.view.panes import (
    Pane3D,
    PaneSize,
    SlicePane,
    Vector,
    active_pane,
    bounds,
    camera_of,
    pane_of,
    rotation,
    triple,
    turned_slices,
    vertical,
)
from clvol.view.state import LAYOUTS, MARKS, PANES, ZOOMS, CameraState, State, Triple, name_of
from clvol.volume.volume import Volume

__all__ = ["KEYS", "Context", "Drag", "Inputs", "Reduced", "faces", "reduce", "shows_box"]

KEYS: Mapping[str, str] = {
    "Arrow keys": "turn by 15°; on a slice: the next or previous slice",
    "PageUp, PageDown": "next / previous slice",
    "+, -": "zoom",
    "[, ]": "roll by 15°; on a slice: turn the slices across it",
    "Alt (held)": "drag turns the slices across a slice",
    "Double click": "with the volume and slices: one pane alone, and back",
    "1 to 9": "the mode",
    "x, y, z": "look along an axis; in slices: the slice across it",
    ", and .": "the previous / next of several volumes, along time if there are times",
    "f": "fit",
    "r": "reset",
    "p": "perspective or orthographic",
    "t": "turntable or trackball",
    "l": "the next layout: volume, slice, linked",
    "h": "heat map of the samples visited",
    "i (held)": "drag the isovalue",
    "w (held)": "drag the window: its centre up and down, its width left and right",
    "c (held)": "drag a clip plane, a face of the crop box",
    "Shift (held)": "drag pans; the wheel moves slices five at a time",
    "Control (held)": "drag rolls; the wheel zooms slices",
    "Escape": "drop the tool and the crop box",
    "Control+z, u": "undo",
    "Control+y, Control+Shift+z": "redo",
}
"""Help on keys."""

_CLICK = 4.0  # CSS pixels that a pointer may move in a click
_HANDLE = 12.0  # CSS pixels around the line of the wiper, and around the dot of a clip plane
_STEP = math.radians(15)
_NOTCH = 400.0  # dy of a wheel that doubles the zoom
_PINCH = 60.0  # likewise of a pinch
_SLICE_NOTCH = 100.0  # dy per slice
_HELD = {"i": "isovalue", "w": "window", "c": "crop"}
_THINNEST = 1e-3  # least thickness of the crop box, relative to the volume's
_MODES = ("composite", "isosurface", "mip", "attenuated", "minip", "mean", "surfaces", "regions", "integral")


@dataclass(frozen=True)
class Context:
    """What a reducer depends on beside the state: the volume and the screen."""

    volume: Volume
    placed: Callable[[State, float], Camera]
    """``placed(state, aspect)`` is the camera with its target, as in pictures."""
    sizes: Mapping[str, PaneSize]
    """By pane."""
    isovalue: Callable[[State], float]
    """The one that is drawn."""
    window: Callable[[State, str], tuple[float, float]]
    """``window(state, pane)`` is the (center, width) that is shown."""
    anchor: Callable[[State, float, float], Any | None] = lambda state, x, y: None  # noqa: ARG005
    """``anchor(state, x, y)`` is the world point that the volume's picture shows there, or None."""
    stepped: Callable[[State, int], State] = lambda state, by: state  # noqa: ARG005
    """``stepped(state, by)`` shows another of several volumes."""
    initial: State = field(default_factory=State)
    """What reset goes back to."""

    def size(self, name: str) -> PaneSize:
        """The size of a pane, or that of the whole canvas if it has none of its own."""
        return self.sizes.get(name) or self.sizes.get("") or PaneSize()

    def pane(self, state: State, name: str) -> Pane3D | SlicePane:
        """The pane of a name."""
        size = self.size(name)
        return pane_of(state, name, self.volume, size, self.placed(state, size.width / size.height))

    def pinned(self, state: State) -> State:
        """The same picture with a camera that is no longer fitted: target and radius are numbers."""
        own = state.camera
        if own.target is not None:
            return state
        size = self.size("3d")
        camera = self.placed(state, size.width / size.height)
        radius = camera.radius if camera.radius is not None or own.distance is not None else self.volume.radius
        return replace(state, camera=replace(own, target=camera.target, radius=own.radius or radius))


@dataclass(frozen=True)
class Drag:
    """A pointer that is down: what it does, where it went down, and the state then."""

    kind: str
    pane: str
    button: int
    x: float
    y: float
    began: State
    face: tuple[int, int] | None = None  # of the crop box: axis, and 0 (low) or 1 (high)
    more: bool = False  # whether it appends to the mark that is being drawn
    moved: bool = False


@dataclass(frozen=True)
class Inputs:
    """The pointer and the keys of one client."""

    drag: Drag | None = None
    keys: frozenset[str] = frozenset()
    marking: bool = False  # whether the last mark takes further points
    anchor: tuple[float, float, str, Triple] | None = None  # of the wheel: x, y, pane, and the world point there


@dataclass(frozen=True)
class Reduced:
    """What follows from an event."""

    state: State
    inputs: Inputs
    effects: tuple[tuple[Any, ...], ...] = ()
    """What only the session can do: ("undo",), ("redo",), ("pick", pane, x, y, moves)."""
    gesture: str | None = None
    """Consecutive changes of one gesture are one step of undo."""


def reduce(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context) -> Reduced:
    """The state after an event."""
    if not isinstance(event, Mapping):
        raise OptionError(f"an event must be an object of JSON; got {event!r:.200}")
    kind = name_of("the type of an event", event.get("event_type", event.get("type")), (*_REDUCERS, *_IGNORED))
    name = event.get("pane")
    name = active_pane(state) if name is None else name_of("pane", name, PANES)
    return Reduced(state, inputs) if kind in _IGNORED else _REDUCERS[kind](state, inputs, event, context, name)


# -- the pointer ---------------------------------------------------------------------------------------------


def _down(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:
    x, y = _position(event)
    button = int(number("button", event.get("button", 1), minimum=0, maximum=16)) or 1
    began = state if state.active == name else replace(state, active=name)  # type: ignore[arg-type]  # a pane's
    face = None
    if button == 1 and not inputs.keys and not _modifiers(event) and shows_box(began, inputs):  # else it does something else
        face = _nearest_face(began, context, name, x, y, within=_HANDLE)
    kind = "crop" if face is not None else _drag_kind(state, inputs, event, context, name, x, button)
    face = _nearest_face(began, context, name, x, y) if kind == "crop" and face is None else face
    pinned = context.pinned(began) if kind in ("orbit", "pan", "roll", "zoom") and name == "3d" else began
    pane = context.pane(began, name) if kind == "mark" else None
    more = inputs.marking and isinstance(pane, SlicePane) and marks.continues(began, pane)
    drag = Drag(kind, name, button, x, y, pinned, face, more)
    moved = _crosshair_at(began, context, name, x, y) if kind == "crosshair" else began
    return Reduced(moved, replace(inputs, drag=drag, anchor=None), (), "drag")


def _move(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:  # noqa: ARG001
    drag = inputs.drag
    if drag is None:
        return Reduced(state, inputs)
    if event.get("buttons") in ((), []):  # it was released outside
        return Reduced(state, replace(inputs, drag=None))
    x, y = _position(event)
    moved = drag.moved or math.hypot(x - drag.x, y - drag.y) > _CLICK
    inputs = replace(inputs, drag=replace(drag, moved=moved))
    if not moved and drag.kind != "crosshair":
        return Reduced(state, inputs)
    return Reduced(_DRAGS[drag.kind](drag, context, x, y), inputs, (), "drag")


def _up(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:
    drag = inputs.drag
    if drag is None:
        return Reduced(state, inputs)
    result = _move(state, inputs, {key: value for key, value in event.items() if key != "buttons"}, context, name)
    free = replace(result.inputs, drag=None)
    assert result.inputs.drag is not None  # it was there
    if drag.kind == "mark":
        return _marked(drag, result, free, context)
    if not result.inputs.drag.moved and drag.pane == "3d" and drag.button == 1:
        # a click in the volume moves the crosshair of linked slices
        effects = (("pick", "3d", drag.x, drag.y, True),) if state.layout == "linked" else ()
        return Reduced(result.state, free, effects)
    return Reduced(result.state, free, (), "drag")


def _marked(drag: Drag, result: Reduced, free: Inputs, context: Context) -> Reduced:
    """After a drag or a click that draws a mark."""
    pane = context.pane(drag.began, drag.pane)
    assert isinstance(pane, SlicePane)  # or it would turn the volume
    assert result.inputs.drag is not None  # it was there
    if result.inputs.drag.moved:
        state, marking = result.state, marks.continues(result.state, pane)
    else:
        state, marking = marks.clicked(drag.began, pane, (drag.x, drag.y), drag.more)
    return Reduced(state, replace(free, marking=marking), (), "drag")


def _mark(drag: Drag, context: Context, x: float, y: float) -> State:
    pane = context.pane(drag.began, drag.pane)
    assert isinstance(pane, SlicePane)  # or it would turn the volume
    return marks.dragged(drag.began, pane, (drag.x, drag.y), (x, y), drag.more)


def _double(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:  # noqa: ARG001
    x, y = _position(event)
    if state.tool in MARKS and name != "3d":  # its clicks drew
        return Reduced(state, replace(inputs, drag=None, marking=False))
    if state.layout == "linked":
        larger = replace(state, active=name, enlarged=not state.enlarged)  # type: ignore[arg-type]  # a pane's
        return Reduced(larger, replace(inputs, drag=None), (("pick", name, x, y, False),))  # the clicks have moved the crosshair
    return Reduced(state, replace(inputs, drag=None), (("pick", name, x, y, True),))


def _drag_kind(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str, x: float, button: int) -> str:
    modifiers = _modifiers(event)
    if state.wiper is not None and button == 1 and abs(x - state.wiper.at * context.size(name).width) <= _HANDLE:
        return "wiper"
    held = [kind for key, kind in _HELD.items() if key in inputs.keys]
    if held:
        return held[0]
    if button == 2:
        return "window" if name != "3d" else "pan"
    if button == 3 or "Shift" in modifiers:
        return "pan"
    if "Alt" in modifiers and name != "3d":
        return "turn"
    if "Control" in modifiers or "Meta" in modifiers:
        return "roll" if name == "3d" else "zoom"
    if state.tool is not None:
        if state.tool in MARKS:
            return "orbit" if name == "3d" else "mark"
        elsewhere = {"crosshair": "orbit"} if name == "3d" else {"orbit": "crosshair", "roll": "turn"}
        return elsewhere.get(state.tool, state.tool)
    return "orbit" if name == "3d" else "crosshair"


# -- drags ---------------------------------------------------------------------------------------------------


def _orbit(drag: Drag, context: Context, x: float, y: float) -> State:
    """The shorter side of the pane is half a turn; the front follows the pointer."""
    size, began = context.size(drag.pane), drag.began
    scale = math.pi / min(size.width, size.height)
    return replace(began, camera=turned(began.camera, context, (x - drag.x) * scale, (y - drag.y) * scale))


def turned(camera: CameraState, context: Context, right: float, down: float) -> CameraState:
    """The camera after the front has turned by these angles, in radians, to the right and down."""
    view = _view(camera, context)
    if camera.style == "trackball":
        angle = math.hypot(right, down)
        if not angle:
            return camera
        turn = rotation((right * view.up + down * view.right) / angle, -angle)
        return _aimed(camera, turn @ view.forward, turn @ view.up)
    pole = vertical(context.volume)
    level = np.cross(view.forward, pole)
    length = float(np.linalg.norm(level))
    level = level / length if length > 1e-6 else view.right - (view.right @ pole) * pole
    level = level / np.linalg.norm(level)
    if level @ view.right < 0:
        level = -level
    ahead = np.cross(pole, level)  # the direction of view without its elevation
    below = math.atan2(-float(view.forward @ pole), float(view.forward @ ahead))
    below = min(math.pi / 2, max(-math.pi / 2, below + down))
    around = rotation(pole, -right)
    ahead = around @ ahead
    forward = math.cos(below) * ahead - math.sin(below) * pole
    up = pole if abs(below) < math.pi / 2 - 1e-6 else math.copysign(1, below) * ahead
    return _aimed(camera, forward, up)


def _aimed(camera: CameraState, forward: Vector, up: Vector) -> CameraState:
    return replace(camera, direction=triple(forward / np.linalg.norm(forward)), up=triple(up / np.linalg.norm(up)))


def _view(camera: CameraState, context: Context) -> Any:
    return camera_of(State(camera=camera)).view(context.volume)


def _pan(drag: Drag, context: Context, x: float, y: float) -> State:
    """The target's plane follows the pointer."""
    began = drag.began
    pane = context.pane(began, drag.pane)
    if isinstance(pane, SlicePane):
        by = -((x - drag.x) * pane.right + (y - drag.y) * pane.down) * pane.per_pixel
        return replace(began, slice=replace(began.slice, center=_near(context, pane.middle + by)))
    by = -((x - drag.x) * pane.right + (y - drag.y) * pane.down) * pane.pixel()
    return _moved_by(began, context, by)


def _moved_by(state: State, context: Context, by: Vector) -> State:
    own = context.pinned(state).camera
    assert own.target is not None  # it is pinned
    return replace(state, camera=replace(own, target=_near(context, np.asarray(own.target) + by)))


def _near(context: Context, point: Vector) -> Triple:
    """The point, moved towards the volume if it is so far away that one could not find back."""
    volume = context.volume
    away = point - volume.center
    far = float(np.linalg.norm(away)) / (4 * volume.radius)
    return triple(volume.center + away / max(1.0, far))


def _zoom_drag(drag: Drag, context: Context, x: float, y: float) -> State:  # noqa: ARG001
    """Down zooms in, about the middle."""
    return _zoomed(drag.began, context, drag.pane, _doubled((y - drag.y) / 100), None)


def _roll(drag: Drag, context: Context, x: float, y: float) -> State:
    size, began = context.size(drag.pane), drag.began
    middle = size.width / 2, size.height / 2
    before, now = (math.atan2(b - middle[1], a - middle[0]) for a, b in ((drag.x, drag.y), (x, y)))
    return replace(began, camera=_rolled(began.camera, context, now - before))


def _turn(drag: Drag, context: Context, x: float, y: float) -> State:
    """The slices across this one turn about the crosshair, with the pointer."""
    began = drag.began
    pane = context.pane(began, drag.pane)
    assert isinstance(pane, SlicePane)  # not of the volume
    middle = pane.project(context.volume.center if began.crosshair is None else began.crosshair)
    before, now = (math.atan2(b - middle[1], a - middle[0]) for a, b in ((drag.x, drag.y), (x, y)))
    return _turned_about(began, pane, now - before)


def _turned_about(state: State, pane: SlicePane, angle: float) -> State:
    """Turn the slices across this one clockwise, as it is seen."""
    turn = turned_slices(state.slice, np.cross(pane.right, pane.down), angle)
    return replace(state, slice=replace(state.slice, turn=turn))


def _rolled(camera: CameraState, context: Context, angle: float) -> CameraState:
    """Turn the picture clockwise."""
    view = _view(camera, context)
    return _aimed(camera, view.forward, rotation(view.forward, -angle) @ view.up)


def _window(drag: Drag, context: Context, x: float, y: float) -> State:
    """Down raises the centre, right widens it, as in radiologists' programs; slices have a window of their own."""
    size, began = context.size(drag.pane), drag.began
    center, width = context.window(began, drag.pane)
    low, high = context.volume.value_range
    span = (high - low) or 1.0
    wider = min(max(width * _doubled(4 * (x - drag.x) / size.width), 1e-4 * span), 10 * span)
    center = min(max(center + (y - drag.y) / size.height * max(width, 0.05 * span), low - span), high + span)
    if drag.pane == "3d":
        return replace(began, window=(center, wider))
    return replace(began, slice=replace(began.slice, window=(center, wider)))


def _isovalue(drag: Drag, context: Context, x: float, y: float) -> State:  # noqa: ARG001
    """The pane's height is the range of values; up is more."""
    began = drag.began
    if began.mode != "isosurface":
        return began
    low, high = context.volume.value_range
    value = context.isovalue(began) - (y - drag.y) / context.size(drag.pane).height * (high - low)
    return replace(began, options={**began.options, "isovalue": min(max(value, low), high)})


def _crop(drag: Drag, context: Context, x: float, y: float) -> State:
    began = drag.began
    if drag.face is None:
        return began
    axis, side = drag.face
    first, last = bounds(context.volume)
    box = _box(began, context)
    pane = context.pane(began, drag.pane)
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
    return replace(began, clip=(triple(box[0]), triple(box[1])))


def _box(state: State, context: Context) -> list[Vector]:
    """Both corners of the crop box, or of the volume."""
    return [np.array(corner) for corner in (state.clip or bounds(context.volume))]


def _face_middle(box: list[Vector], axis: int, side: int) -> Vector:
    middle = (box[0] + box[1]) / 2
    middle[axis] = box[side][axis]
    return middle


def _face_way(pane: Pane3D | SlicePane, box: list[Vector], axis: int, side: int) -> tuple[float, float] | None:
    """CSS pixels by which the middle of a face moves per world unit; None if it moves towards the viewer."""
    small = 1e-3 * float(np.max(box[1] - box[0]))
    middle = _face_middle(box, axis, side)
    step = np.eye(3)[axis] * small
    one, other = pane.project(middle - step), pane.project(middle + step)
    if one is None or other is None:
        return None
    way = (other[0] - one[0]) / (2 * small), (other[1] - one[1]) / (2 * small)
    return way if math.hypot(*way) > 0.05 * pane.unit_pixels else None


def shows_box(state: State, inputs: Inputs) -> bool:
    """Whether the crop box and the dots of its clip planes are drawn over the pictures."""
    return state.clip is not None or state.tool == "crop" or "c" in inputs.keys


def faces(state: State, context: Context, name: str) -> list[tuple[int, int, float, float]]:
    """The clip planes that can be dragged in a pane: axis, 0 (low) or 1 (high), and the position of the dot."""
    box, pane = _box(state, context), context.pane(state, name)
    found = []
    for axis in range(3):
        for side in (0, 1):
            at = pane.project(_face_middle(box, axis, side))
            if at is not None and _face_way(pane, box, axis, side) is not None:
                found.append((axis, side, *at))
    return found


def _nearest_face(
    state: State, context: Context, name: str, x: float, y: float, within: float = math.inf
) -> tuple[int, int] | None:
    """The clip plane with the nearest dot, at most `within` CSS pixels away."""
    far = [(math.hypot(u - x, v - y), (axis, side)) for axis, side, u, v in faces(state, context, name)]
    distance, nearest = min(far, default=(math.inf, None))
    return nearest if distance <= within else None


def _crosshair_at(state: State, context: Context, name: str, x: float, y: float) -> State:
    pane = context.pane(state, name)
    if not isinstance(pane, SlicePane):
        return state
    return replace(state, crosshair=_inside(context, pane.point(x, y)))


def _wiper(drag: Drag, context: Context, x: float, y: float) -> State:  # noqa: ARG001
    began = drag.began
    if began.wiper is None:
        return began
    return replace(began, wiper=replace(began.wiper, at=min(max(x / context.size(drag.pane).width, 0.0), 1.0)))


_DRAGS: Mapping[str, Callable[[Drag, Context, float, float], State]] = {
    "orbit": _orbit,
    "pan": _pan,
    "zoom": _zoom_drag,
    "roll": _roll,
    "turn": _turn,
    "window": _window,
    "isovalue": _isovalue,
    "crop": _crop,
    "crosshair": lambda drag, context, x, y: _crosshair_at(drag.began, context, drag.pane, x, y),
    "wiper": _wiper,
    "mark": _mark,
}


# -- the wheel -----------------------------------------------------------------------------------------------


def _wheel(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:
    if inputs.drag is not None:
        return Reduced(state, inputs)
    x, y = _position(event)
    dy = number("dy", event.get("dy", 0), minimum=-1e5, maximum=1e5)
    modifiers = _modifiers(event)
    pinch = "Pinch" in modifiers
    if name != "3d" and not pinch and "Control" not in modifiers:
        return Reduced(
            _sliced(state, context, name, dy / _SLICE_NOTCH * (5 if "Shift" in modifiers else 1)), inputs, (), "wheel slice"
        )
    factor = _doubled(-dy / (_PINCH if pinch else _NOTCH))
    if name != "3d":
        return Reduced(_zoomed(state, context, name, factor, (x, y)), inputs, (), "wheel zoom")
    state = context.pinned(state)
    known = inputs.anchor
    if known is None or known[:3] != (x, y, name):
        pane = context.pane(state, name)
        assert isinstance(pane, Pane3D)  # of the volume
        point = context.anchor(state, x, y)
        if point is None:
            point = pane.at_depth(x, y, pane.distance) if pane.distance > 0 else pane.target
        known = x, y, name, triple(np.asarray(point, np.float64))
    result = _zoomed(state, context, name, factor, (x, y), np.array(known[3]))
    return Reduced(result, replace(inputs, anchor=known), (), "wheel zoom")


def _doubled(times: float) -> float:
    """2 to this power, limited so that no event makes it overflow."""
    return float(2.0 ** min(max(times, -32.0), 32.0))


def _zoomed(
    state: State, context: Context, name: str, factor: float, at: tuple[float, float] | None, point: Vector | None = None
) -> State:
    """Magnified about the position `at`: there `point` of the volume, or of the slice, stays where it is."""
    if name != "3d":
        zoom = min(max(state.slice.zoom * factor, ZOOMS[0]), ZOOMS[1])
        factor = zoom / state.slice.zoom
        pane = context.pane(state, name)
        assert isinstance(pane, SlicePane)
        center = pane.middle if at is None else pane.middle + (1 - 1 / factor) * (pane.point(*at) - pane.middle)
        return replace(state, slice=replace(state.slice, zoom=zoom, center=_near(context, center)))
    zoom = min(max(state.camera.zoom * factor, ZOOMS[0]), ZOOMS[1])
    factor = zoom / state.camera.zoom
    if at is None or point is None:
        return replace(state, camera=replace(state.camera, zoom=zoom))
    pane = context.pane(state, name)
    assert isinstance(pane, Pane3D)
    to = point - pane.view.eye
    aside = to - (to @ pane.view.forward) * pane.view.forward
    result = _moved_by(state, context, (1 - 1 / factor) * aside)
    return replace(result, camera=replace(result.camera, zoom=zoom))


def _sliced(state: State, context: Context, name: str, slices: float) -> State:
    """The crosshair moved across slices, which are a voxel thick."""
    volume, pane = context.volume, context.pane(state, name)
    assert isinstance(pane, SlicePane)  # not of the volume
    along = np.abs(pane.normal @ volume.direction)
    thick = volume.spacing[int(along.argmax())]
    point = np.array(volume.center if state.crosshair is None else state.crosshair, np.float64)
    point += slices * thick * pane.normal
    return replace(state, crosshair=_inside(context, point))


def _inside(context: Context, point: Vector) -> Triple:
    return triple(np.clip(point, *bounds(context.volume)))


# -- keys ----------------------------------------------------------------------------------------------------


def _key(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:
    key = event.get("key")
    if not isinstance(key, str) or len(key) > 40:
        raise OptionError(f"key must be the name of a key; got {key!r:.80}")
    modifiers = _modifiers(event)
    low = key.lower() if len(key) == 1 else key
    if modifiers & {"Control", "Meta"}:
        again = low == "y" or (low == "z" and "Shift" in modifiers)
        effects = (("redo",),) if again else (("undo",),) if low == "z" else ()
        return Reduced(state, inputs, effects)
    if low in _HELD:
        return Reduced(state, replace(inputs, keys=inputs.keys | {low}))
    if low == "u":
        return Reduced(state, inputs, (("undo",),))
    if low in _TURNS and name == "3d":
        pinned = context.pinned(state)
        return Reduced(replace(pinned, camera=turned(pinned.camera, context, *_TURNS[low])), inputs, (), f"key {low}")
    if low in _SLICES and name != "3d":
        return Reduced(_sliced(state, context, name, _SLICES[low]), inputs, (), "key slice")
    if low in ("+", "=", "-"):
        return Reduced(_zoomed(state, context, name, 0.8 if low == "-" else 1.25, None), inputs, (), "key zoom")
    if low in ("[", "]") and name == "3d":
        pinned = context.pinned(state)
        rolled = _rolled(pinned.camera, context, _STEP if low == "]" else -_STEP)
        return Reduced(replace(pinned, camera=rolled), inputs, (), "key roll")
    if low in ("[", "]"):
        pane = context.pane(state, name)
        assert isinstance(pane, SlicePane)  # not of the volume
        return Reduced(_turned_about(state, pane, _STEP if low == "]" else -_STEP), inputs, (), "key turn")
    if low in (",", "."):
        result = context.stepped(state, 1 if low == "." else -1)
        return Reduced(state if result == state else replace(context.pinned(state), index=result.index), inputs, (), "key volume")
    if low in "xyz" and len(low) == 1:
        return Reduced(_along(state, context, name, low), inputs)
    if low.isdecimal() and 1 <= int(low) <= len(_MODES):
        return Reduced(state.changed({"mode": _MODES[int(low) - 1]}), inputs)
    act = _KEYS.get(low)
    return Reduced(state if act is None else act(state, context), inputs)


def _key_up(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:  # noqa: ARG001
    key = event.get("key")
    low = key.lower() if isinstance(key, str) else ""
    return Reduced(state, replace(inputs, keys=inputs.keys - {low}))


def _along(state: State, context: Context, name: str, axis: str) -> State:
    if name != "3d":
        return replace(state, active=axis)  # type: ignore[arg-type]  # a pane's
    forward = np.eye(3)["xyz".index(axis)] * (-1 if axis in "xz" else 1)
    pole = vertical(context.volume)
    up = np.array([0.0, 1.0, 0.0]) * pole[2] if axis == "z" else pole
    if axis == "z" and context.volume.space in ("LPS", "image"):  # rows run down, and a patient's right is on the left
        forward, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    return replace(state, camera=_aimed(state.camera, forward, up))


def fit(state: State, context: Context | None = None) -> State:  # noqa: ARG001
    """Fit what can be seen again, in the volume and in slices; directions stay."""
    camera = replace(state.camera, target=None, distance=None, radius=None, zoom=1.0)
    return replace(state, camera=camera, slice=replace(state.slice, zoom=1.0, center=None))


def reset(state: State, context: Context) -> State:  # noqa: ARG001
    """The first state."""
    return context.initial


def _next_layout(state: State, context: Context) -> State:  # noqa: ARG001
    layout: Any = LAYOUTS[(LAYOUTS.index(state.layout) + 1) % 3]
    active: Any = "z" if layout == "slice" and state.active == "3d" else "3d" if layout == "3d" else state.active
    return replace(state, layout=layout, active=active)


def _other_projection(state: State, context: Context) -> State:
    """The target's plane keeps its size in the picture."""
    own = context.pinned(state).camera
    other: Any = "orthographic" if own.projection == "perspective" else "perspective"
    return replace(state, camera=replace(own, projection=other, distance=None))


def _other_style(state: State, context: Context) -> State:
    style: Any = "trackball" if state.camera.style == "turntable" else "turntable"
    return replace(state, camera=turned(replace(state.camera, style=style), context, 0.0, 0.0))


_KEYS: Mapping[str, Callable[[State, Context], State]] = {
    "f": fit,
    "Home": fit,
    "r": reset,
    "p": _other_projection,
    "t": _other_style,
    "l": _next_layout,
    "h": lambda state, context: replace(state, heat=not state.heat),  # noqa: ARG005
    "Escape": lambda state, context: replace(state, tool=None, clip=None),  # noqa: ARG005
}
_TURNS = {"ArrowLeft": (-_STEP, 0.0), "ArrowRight": (_STEP, 0.0), "ArrowUp": (0.0, -_STEP), "ArrowDown": (0.0, _STEP)}
_SLICES = {"ArrowUp": 1.0, "PageUp": 1.0, "ArrowRight": 1.0, "ArrowDown": -1.0, "PageDown": -1.0, "ArrowLeft": -1.0}
assert set(_MODES) == set(modes())  # a number for each


# -- fields of events ----------------------------------------------------------------------------------------


def _left(state: State, inputs: Inputs, event: Mapping[str, Any], context: Context, name: str) -> Reduced:  # noqa: ARG001
    """The focus is elsewhere, so that releases of keys are not seen."""
    return Reduced(state, replace(inputs, keys=frozenset()))


_REDUCERS: Mapping[str, Callable[[State, Inputs, Mapping[str, Any], Context, str], Reduced]] = {
    "pointer_down": _down,
    "pointer_move": _move,
    "pointer_up": _up,
    "double_click": _double,
    "wheel": _wheel,
    "key_down": _key,
    "key_up": _key_up,
    "blur": _left,
}
_IGNORED = ("pointer_enter", "pointer_leave", "char", "close", "before_draw", "animate")


def _position(event: Mapping[str, Any]) -> tuple[float, float]:
    x, y = (number(f"{axis} of an event", event.get(axis), minimum=-1e6, maximum=1e6) for axis in "xy")
    return x, y


def _modifiers(event: Mapping[str, Any]) -> frozenset[str]:
    given = event.get("modifiers", ())
    if not isinstance(given, (list, tuple)) or not all(isinstance(word, str) for word in given):
        raise OptionError(f"modifiers must be a list of names of keys; got {given!r:.200}")
    return frozenset("Control" if word == "Ctrl" else word for word in given)
