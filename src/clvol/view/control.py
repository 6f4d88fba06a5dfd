"""A client's state and what changes it: pointer and keys, the panel, undo; and what is picked.

No thread, and nothing is sent from here.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.bricks.field import BrickedField
from clvol.labels import name_of
from clvol.march.renderer import Renderer
from clvol.march.slices import window_of_slices
from clvol.scene.camera import Camera
from clvol.scene.mode import as_mode
from clvol.spline.field import Field
from clvol.spline.regions import Regions
from clvol.view import events
from clvol.view.events import Context, Inputs
from clvol.view.panes import Pane3D, PaneSize, SlicePane, triple
from clvol.view.protocol import Change
from clvol.view.renderers import on_slices
from clvol.view.resident import Resident
from clvol.view.state import History, State
from clvol.volume.histogram import label_numbers
from clvol.volume.volume import Volume

__all__ = ["Control"]

_PAUSE = 0.1  # seconds after which a pointer that is down counts as resting
_WHEEL_REST = 0.12  # likewise after a wheel's or a slider's last step
_PROBES = 17  # of a label, along a step of a ray
_GESTURE = 1.0  # seconds between steps of a wheel or a key that still are one step of undo


class Control:
    """What one client shows, and what its pointer and keys are doing."""

    def __init__(self, resident: Resident, state: State) -> None:
        self._resident = resident
        self.history = History(state)
        self.inputs = Inputs()
        self.sizes: dict[str, PaneSize] = {}
        """By pane; "" for panes that have none of their own."""
        self.released: str | None = None
        """The pane in which a drag has just ended."""
        self._wheel_at = self._moved_at = self._gesture_at = -math.inf

    @property
    def state(self) -> State:
        """What is shown."""
        return self.history.present

    @property
    def focus(self) -> str:
        """The pane that is drawn first."""
        return self.inputs.drag.pane if self.inputs.drag is not None else self.state.active

    @property
    def rests_at(self) -> float:
        """When pictures may be refined, if nothing happens; by `time.monotonic`."""
        return self._moved_at + _PAUSE if self.inputs.drag is not None else self._wheel_at + _WHEEL_REST

    @property
    def moving(self) -> bool:
        """Whether pointer or wheel are in use right now."""
        return time.monotonic() < self.rests_at

    def pause(self) -> None:
        """Count a drag as moving again, as after a picture that failed to come: not again at once."""
        self._moved_at = time.monotonic()

    def context(self) -> Context:
        """What events depend on beside the state."""
        resident = self._resident
        return Context(
            volume=resident.volume,
            placed=resident.placed,
            sizes=self.sizes,
            isovalue=lambda state: float(getattr(resident.mode(state), "isovalue", 0.0) or 0.0),
            window=self._window,
            anchor=lambda state, x, y: _anchor(resident, self.context(), state, x, y),
            stepped=resident.catalog.stepped,
            initial=resident.initial,
        )

    def _window(self, state: State, name: str) -> tuple[float, float]:
        if name != "3d":
            return state.slice_window or window_of_slices(self._resident.catalog.volume_of(state))
        if state.window is not None:
            return state.window
        low, high = self._resident.transfer(replace(state, transfer=None)).value_range
        return low / 2 + high / 2, (high - low) or 1.0

    # -- what changes it ---------------------------------------------------------------------------------------

    def event(self, event: Any) -> tuple[tuple[Any, ...], ...]:
        """Apply an event of pointer or keys; returns what only the session can do (`events.Reduced.effects`)."""
        reduced = events.reduce(self.state, self.inputs, event, self.context())
        now = time.monotonic()
        before, after, changed = self.inputs.drag, reduced.inputs.drag, reduced.state != self.state
        if after is not None and (changed or before is None):
            self._moved_at = now
        if changed and reduced.gesture is not None and reduced.gesture.startswith("wheel"):
            self._wheel_at = now
        paused = reduced.gesture not in (None, "drag") and now - self._gesture_at > _GESTURE
        self._gesture_at = now
        history = self.history.ended() if paused or (before is None and after is not None) else self.history
        self.history = history.with_state(reduced.state, reduced.gesture)
        if before is not None and after is None:
            self.history = self.history.ended()
            self.released = before.pane if changed else None
        self.inputs = reduced.inputs
        return reduced.effects

    def change(self, change: Change) -> None:
        """Apply changes of the panel; nothing has changed if they give no state, or none of this volume."""
        state = State.from_json(change.changes) if change.whole else self.state.changed(change.changes)
        self.history = self.history.with_state(self._accepted(state, whole=change.whole), change.step)
        if change.live:
            self._wheel_at = time.monotonic()
        else:
            self.history = self.history.ended()

    def _accepted(self, new: State, *, whole: bool) -> State:
        """The state, unless only the volume can refuse it; where another volume is shown the camera stays as it was fitted."""
        state, resident = self.state, self._resident
        required = [
            (one.index, one.labels, one.label_rows, one.media, one.furniture) for one in (new, state)
        ]  # all that `require` depends on
        if required[0] != required[1]:
            resident.catalog.require(new)
        if replace(new, index=state.index, labels=state.labels) != state:
            resident.transfer(new)
        if whole or new.camera != state.camera or resident.catalog.which(new) == resident.catalog.which(state):
            return new
        return replace(new, camera=self.context().pinned(state).camera)

    def act(self, what: str) -> None:
        """Do "undo", "redo", "reset", "fit" or "heat" (switch the heat map)."""
        if what == "undo":
            self.history = self.history.undone()
        elif what == "redo":
            self.history = self.history.redone()
        elif what == "reset":
            self.history = self.history.ended().with_state(events.reset(self.state, self.context()))
        elif what == "fit":
            self.history = self.history.ended().with_state(events.fit(self.state))
        else:
            self.history = self.history.with_state(replace(self.state, heat=not self.state.heat))

    def pick(self, name: str, x: float, y: float, *, moves: bool = False) -> dict[str, Any]:
        """What lies at a position of a pane (`_picked`); `moves` moves the crosshair there."""
        found = _picked(self._resident, self.context(), self.state, name, x, y)
        if moves and found["position"] is not None:
            self.history = self.history.with_state(replace(self.state, crosshair=tuple(found["position"])))
        return found

    # -- what a pane shows -------------------------------------------------------------------------------------

    def key(self, name: str) -> object:
        """Everything that the picture of a pane depends on."""
        return self._key(self.state, name)

    def look(self, name: str) -> object:
        """Everything that the time of a pane's picture depends on, but for the direction from which it is seen."""
        state, initial = self.state, self._resident.initial
        camera = replace(state.camera, target=None, direction=initial.camera.direction, up=initial.camera.up)
        return self._key(replace(state, camera=camera, crosshair=None, slice=initial.slice), name)

    def _key(self, state: State, name: str) -> object:
        size, which = self.context().size(name), self._resident.catalog.which(state)
        common = (size, which, state.filter, state.boundary, state.cmap, state.background, state.wiper)
        if name == "3d":
            first = self._resident.initial
            return (*common, replace(state, layout="3d", active="3d", tool=None, slice=first.slice, crosshair=None))
        point = state.crosshair or self._resident.volume.center
        smooth = (state.transfer,) if as_mode(state.mode).regions else ()
        return (*common, *smooth, state.slice, state.slice_window, float(point["xyz".index(name)]))


# -- what lies under the pointer: exact values of the function that is drawn -----------------------------------


def _anchor(resident: Resident, context: Context, state: State, x: float, y: float) -> NDArray[np.float64] | None:
    """The world point that the volume's picture shows at (x, y), in CSS pixels.

    None where there is nothing, if the mode shows no one point ("mean"), or before the coefficients are resident.
    """
    if not resident.renderers.soon(*resident.catalog.key(state)):
        return None
    pane = context.pane(state, "3d")
    assert isinstance(pane, Pane3D)  # by its name
    with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
        return _hit(renderer, pane, x, y, resident.arguments(state, bare=True))


def _picked(resident: Resident, context: Context, state: State, name: str, x: float, y: float) -> dict[str, Any]:
    """Position, value and gradient at (x, y) of a pane, in CSS pixels, for JSON; no position where there is nothing.

    In the volume the point is the one that the picture shows: on a surface; where half of the light is stopped; where the
    extreme lies.
    """
    pane = context.pane(state, name)
    key = resident.catalog.key(state)
    if state.wiper is not None and x > state.wiper.at * context.size(name).width:
        key = (state.wiper.filter, *key[1:])
    if not resident.renderers.soon(*key):
        raise OptionError("nothing can be picked before the coefficients are computed")
    with resident.renderers.renderer(*key) as renderer:
        volume, arguments = renderer.volume, resident.arguments(state, bare=True)
        if isinstance(pane, SlicePane):
            point: NDArray[np.float64] | None = pane.point(x, y)
            field = on_slices(renderer, state.mode)
        else:
            point = _hit(renderer, pane, x, y, arguments)
            mode = as_mode(arguments["mode"])
            field = on_slices(renderer, state.mode) if mode.regions else renderer._source.function(mode)
            if point is not None and volume.is_labels:
                point = _in_label(volume, field, point, pane.ray(x, y)[1], state.step * volume.mean_spacing)
        found: dict[str, Any] = {"pane": name, "x": x, "y": y, "units": volume.units, "position": None}
        return found if point is None or not _within(volume, point) else found | _found(volume, field, point)


def _found(volume: Volume, field: Field | BrickedField | Regions, point: NDArray[np.float64]) -> dict[str, Any]:
    """What is at a point; with the gradient of a function that has one."""
    value = float(field(point[None])[0])
    found = {"position": point.tolist(), "index": volume.world_to_index(point).tolist(), "value": value, "gradient": None}
    if not isinstance(field, Regions) and field.filter.has_gradient:
        slope = np.asarray(field.gradient(point[None])[0], np.float64)
        found |= {"gradient": slope.tolist(), "steepness": float(np.linalg.norm(slope))}
    if volume.is_labels:
        found["label"] = name_of(volume, round(value))
    return found


def _hit(renderer: Renderer, pane: Pane3D, x: float, y: float, arguments: dict[str, Any]) -> NDArray[np.float64] | None:
    """What a picture of one pixel shows whose ray is that of (x, y)."""
    origin, way = pane.ray(x, y)
    ahead = origin + way * max(pane.distance, renderer.volume.radius)
    view = pane.view
    camera = Camera(
        position=triple(origin),
        target=triple(ahead),
        up=triple(view.up),
        projection="orthographic" if view.orthographic else "perspective",
    )
    given = {name: value for name, value in arguments.items() if name not in ("pixel_filter", "gradient")} | {
        "camera": camera,
        "rays": 1,
    }
    point = np.asarray(renderer.render(size=(1, 1), outputs="position", **given), np.float64)[0, 0]
    return point if np.isfinite(point).all() else None


def _in_label(
    volume: Volume, field: Field | BrickedField | Regions, point: NDArray[np.float64], way: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    """The point itself, or the first behind it that is in a label: what a sample shows begins up to a step before it.

    The volume is a parameter because a field by bricks has no resident samples to find labels in.
    """
    ahead = point + np.linspace(0, 1, _PROBES)[:, None] * step * way / np.linalg.norm(way)
    background, _ = label_numbers(volume)
    solid = np.flatnonzero(np.round(field(ahead)) != background)
    return np.asarray(ahead[solid[0]] if solid.size else point)


def _within(volume: Volume, point: NDArray[np.float64]) -> bool:
    index = volume.world_to_index(point)
    slack = 1e-6 * max(volume.size)
    return bool((index >= -0.5 - slack).all() and (index <= np.asarray(volume.size) - 0.5 + slack).all())
