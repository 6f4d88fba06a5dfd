"""Messages that a client gets without asking, each when its content changes."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

import numpy as np

from clvol.scene.joint import TransferFunction2D
from clvol.scene.mode import as_mode
from clvol.spline.joint import joint_histogram
from clvol.view import events, wiper
from clvol.view.background import Background
from clvol.view.catalog import Which
from clvol.view.control import Control
from clvol.view.curve import curve, what_curve
from clvol.view.drawing import Shot, png, share_visited
from clvol.view.marks import shown_marks
from clvol.view.notices import Notices
from clvol.view.panes import Pane3D, bounds, traces, visible
from clvol.view.picking import measured_all
from clvol.view.protocol import Message, status
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["Updates"]

_SKETCHED = "sketch of few samples: computing the coefficients", "busy"
_COARSER = "reading finer samples", "busy"
_COMPLETE = "", "info"
_GREY = 128  # which is seen on light and on dark pages


class Updates:
    """Compares what a client knows with what is, and sends what differs; `closed` says whether the session has ended."""

    def __init__(
        self,
        resident: Resident,
        control: Control,
        background: Background,
        send: Callable[[Message], None],
        notices: Notices,
        closed: Callable[[], bool],
    ) -> None:
        self._resident, self._control, self._background = resident, control, background
        self._send, self._notices, self._closed = send, notices, closed
        self.heard: int | None = None
        """The number of the last change."""
        self.curves = False
        """Whether the client shows values along a series."""
        self.complete = False
        """Whether the last state was sent with all that follows from the volume."""
        self._state: Any = None
        self._place: object = None
        self._overlays: dict[str, Message] = {}
        self._compared: object = None
        self._measured: object = None

    def state(self, *, again: bool = False) -> None:
        """What is shown; what follows from the volume comes later if it is not known yet: pictures do not wait for it.

        `again` sends it even if it is the same: a page shows a change at once, and must learn that it was refused.
        """
        state, history = self._control.state, self._control.history
        known = self._knows(state)
        telling = (state, self.heard, bool(history.past), bool(history.future))
        if not again and telling == self._state and known == self.complete:
            return
        self._state, self.complete = telling, known
        message = {"type": "state", "state": state.json(), "heard": self.heard, "can_undo": telling[2], "can_redo": telling[3]}
        if known:
            message["effective"] = self._resident.effective(state)
        self._send(message)

    def _knows(self, state: State) -> bool:
        return self._resident.catalog.known(self._resident.catalog.which(state))

    def volume(self) -> None:
        """The description of the volume, first and when another one is shown."""
        place = self._resident.catalog.which(self._control.state).place, self._resident.layers.version
        if place != self._place:
            self._place = place  # what cannot be described is reported once
            self._send(self._resident.info(self._control.state))

    def overlays(self) -> None:
        """Where crosshair and crop box lie; not before the volume's facts are known, which that takes."""
        state, sizes = self._control.state, self._control.sizes
        if not self._knows(state):
            return
        for name in visible(state):
            if name not in sizes and "" not in sizes:
                continue
            message = self._overlay(state, name)
            if self._overlays.get(name) != message:
                self._overlays[name] = message
                self._send(dict(message))

    def _overlay(self, state: State, name: str) -> Message:
        context, volume = self._control.context(), self._resident.volume
        pane = context.pane(state, name)
        point = state.crosshair or tuple(map(float, volume.center))
        box, faces = None, []
        if events.shows_box(state, self._control.inputs):
            faces = [list(face) for face in events.faces(state, context, name)]
            ends = state.clip or bounds(volume)
            box = [pane.project([ends[i >> axis & 1][axis] for axis in range(3)]) for i in range(8)]
        return {
            "type": "overlay",
            "pane": name,
            "crosshair": pane.project(point) if state.layout == "linked" or name != "3d" else None,
            "lines": [] if isinstance(pane, Pane3D) else traces(state, volume, name, pane),
            "box": box,
            "faces": faces,
            "marks": [] if isinstance(pane, Pane3D) else shown_marks(state, volume, pane),
            "unit_pixels": pane.unit_pixels,
            "right": pane.right.tolist(),
            "down": pane.down.tolist(),
        }

    # -- beside pictures ---------------------------------------------------------------------------------------

    def frame(self, shot: Shot) -> None:
        """Say whether the last frame shows all samples."""
        self._notices.put("samples", *(_SKETCHED if shot.few else _COARSER if shot.coarser else _COMPLETE))
        if not self.complete:
            self.find_facts()
        self.measures()  # which may have waited for the coefficients

    def measures(self) -> None:
        """What the marks measure, if that may have changed."""
        state, resident = self._control.state, self._resident
        key = resident.catalog.key(state)
        what = state.marks, key, as_mode(state.mode).regions
        if what != self._measured and (not state.marks or resident.renderers.soon(*key)):
            if state.marks or self._measured is not None:
                self._background.submit(("measures", what), lambda: measured_all(resident, state), lambda why: status(why, "error"))
            self._measured = what

    def curve(self) -> None:
        """The values at the crosshair along a series, if the client wants them and they may have changed."""
        state, resident, background = self._control.state, self._resident, self._background
        if not self.curves or (what := what_curve(resident, state)) is None:
            return
        key = "curve", *what
        background.submit(
            key,
            lambda: curve(resident, state, lambda: self._closed() or not background.asked(key)),
            lambda reason: {"type": "curve", "axis": what[0], "problem": reason},
        )

    @property
    def finding_facts(self) -> bool:
        """Whether the facts of the state's volume were asked for: once per state, which may itself be at fault."""
        return self._background.asked(("facts", self._control.state))

    def find_facts(self) -> None:
        """Compute in the background what follows from the volume."""
        state = self._control.state

        def work() -> None:
            self._resident.effective(state)

        self._background.submit(("facts", state), work)

    def statistics(self, name: str, shot: Shot, fps: float, latency: float) -> None:
        """Statistics of a final picture, and errors of the wiper's filters; what takes long comes later."""
        state, resident = self._control.state, self._resident
        stats = {"type": "stats", "fps": round(fps, 1), "latency_ms": round(1e3 * latency, 1), "visited": shot.visited}
        self._send(stats)
        if name == "3d" and shot.visited is None:
            size = self._control.context().size(name)
            shape = size.width, size.height
            self._background.submit(("visited", state, size), lambda: stats | {"visited": share_visited(resident, state, shape)})
        if name == "3d" and isinstance(state.transfer, TransferFunction2D):
            key = resident.catalog.key(state)
            self._background.submit(("joint", key), lambda: _joint(resident, key))
        if state.wiper is not None:
            names = tuple(resident.filter_name(state, row) for row in (state.filter, state.wiper.filter))
            volume, boundary = resident.catalog.volume_of(state), state.boundary
            self._background.submit(
                ("wiper", names, boundary, resident.catalog.which(state)),
                lambda: _errors(wiper.measured(volume, names, boundary, self._closed)),
                lambda reason: _errors({"problem": reason, "filters": []}),
            )

    def forget_errors(self) -> None:
        """Withdraw errors of filters, once others are compared."""
        state = self._control.state
        compared = None if state.wiper is None else (state.wiper.filter, *self._resident.catalog.key(state))
        if compared != self._compared:
            self._compared = compared
            self._background.forget("wiper")
            self._send(_errors(None))


def _errors(errors: dict[str, Any] | None) -> Message:
    return {"type": "wiper", "errors": errors}


def _joint(resident: Resident, key: tuple[str | None, str, Which]) -> Message:
    """The joint histogram of a function, as a picture."""
    with resident.renderers.renderer(*key) as renderer:
        counts, values, gradients = joint_histogram(renderer.field)
    often = np.log1p(counts[::-1])
    pixels = np.full((*often.shape, 4), _GREY, np.uint8)
    pixels[..., 3] = np.round(often * (255 / often.max()))
    image = "data:image/png;base64," + base64.b64encode(png(pixels)).decode()
    return {"type": "joint", "values": values[[0, -1]].tolist(), "steepest": float(gradients[-1]), "image": image}
