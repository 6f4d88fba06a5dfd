"""A client's state and what changes it: pointer and keys, the panel, undo.

No thread, and nothing is sent from here.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

from clvol.march.slices import window_of_slices
from clvol.scene.mode import as_mode
from clvol.view import events, media, picking
from clvol.view.events import Context, Inputs
from clvol.view.panes import PaneSize, SlicePane
from clvol.view.protocol import Change
from clvol.view.resident import Resident
from clvol.view.state import History, State

__all__ = ["Control"]

_PAUSE = 0.1  # seconds after which a pointer that is down counts as resting
_WHEEL_REST = 0.12  # likewise after a wheel's or a slider's last step
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
        self.layers, self.followed = resident.layers, resident.layers.version
        self.left_out = state, ""
        """The last state that was given, and what it lacks of that, in words."""
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
            anchor=lambda state, x, y: picking.anchor(resident, self.context(), state, x, y),
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
        """Apply changes of the panel; nothing has changed if they give no state, or none of this volume.

        A whole state, which may be from before layers came or went, is applied as far as it is of these: see `left_out`.
        """
        given, names, lost = change.changes, self.layers.names, ""
        state = given if isinstance(given, State) else State.from_json(given) if change.whole else self.state.changed(given)
        if change.whole:
            state, lost = media.fitted(self._resident.catalog.media, names, state)
        state = media.named(names, state)
        self.history = self.history.with_state(self._accepted(state, whole=change.whole), change.step)
        self.left_out = self.state, lost
        if change.live:
            self._wheel_at = time.monotonic()
        else:
            self.history = self.history.ended()

    def _accepted(self, new: State, *, whole: bool) -> State:
        """The state, unless only the volume can refuse it; where another volume is shown the camera stays as it was fitted."""
        state, resident = self.state, self._resident
        required = [
            (one.index, one.labels, one.label_rows, one.media, one.furniture, one.slice) for one in (new, state)
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
        """What lies at a position of a pane (`picking.picked`); `moves` moves the crosshair there."""
        found = picking.picked(self._resident, self.context(), self.state, name, x, y)
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
        layers = state.media, self.layers.version
        common = (size, which, state.filter, state.boundary, state.cmap, state.background, state.wiper, layers)
        if name == "3d":
            first = self._resident.initial
            return (*common, replace(state, layout="3d", active="3d", tool=None, slice=first.slice, marks=(), crosshair=None))
        point = state.crosshair or self._resident.volume.center
        smooth = (state.transfer,) if as_mode(state.mode).regions else ()
        pane = SlicePane.of(state, self._resident.volume, "xyz".index(name), size)
        return (*common, *smooth, state.slice, state.slice_window, float(pane.normal @ point))
