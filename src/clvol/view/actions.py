"""What a client can ask to be done and answered at once: undo, copies, picks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from clvol.base.checks import whole
from clvol.base.errors import ClvolError, OptionError
from clvol.scene.joint import TransferFunction2D
from clvol.scene.scene import MOST_MEDIA
from clvol.view import code
from clvol.view.control import Control
from clvol.view.jobs import Answer, Jobs
from clvol.view.marks import as_csv
from clvol.view.panes import PaneSize, active_pane
from clvol.view.picking import measured_all
from clvol.view.protocol import Change, Request
from clvol.view.resident import Resident
from clvol.view.state import name_of
from clvol.view.updates import Updates

__all__ = ["MOST_PIXELS", "Parts", "action_of", "copied", "pixels_of"]

MOST_PIXELS = 3840 * 2160
"""Of a picture of a pane."""


@dataclass(frozen=True)
class Parts:
    """The parts of a session that requests work with."""

    resident: Resident
    control: Control
    updates: Updates
    jobs: Jobs


def pixels_of(size: PaneSize, most: float = MOST_PIXELS) -> tuple[int, int]:
    """Pixels of a picture that fills a pane."""
    width, height = size.width * size.ratio, size.height * size.ratio
    shrink = min(1.0, math.sqrt(most / (width * height)))
    return max(1, round(width * shrink)), max(1, round(height * shrink))


def action_of(request: Request, files: Iterable[str]) -> Callable[[Parts, Request], Answer] | None:
    """The function that does it, and returns what is added to the reply, and its bytes; None for one of the `files`."""
    return _TABLE.get(name_of("what to do", request.what, [*_TABLE, *files]))


def _act(parts: Parts, request: Request) -> Answer:
    parts.control.act(request.what)
    return {}, None


def _heat(parts: Parts, request: Request) -> Answer:
    parts.control.act(request.what)
    return {"heat": parts.control.state.heat}, None


def _pick(parts: Parts, request: Request) -> Answer:
    return parts.control.pick(request.pane(active_pane(parts.control.state)), *request.position()), None


def _labels(parts: Parts, request: Request) -> Answer:
    rows, count = parts.resident.catalog.labels(parts.control.state, request.arguments.get("words", ""))
    return {"rows": rows, "count": count}, None


def _joint(parts: Parts, request: Request) -> Answer:  # noqa: ARG001  # it takes no arguments
    """A transfer function of value and gradient to begin with."""
    volume = parts.resident.catalog.volume_of(parts.control.state)
    return {"transfer": TransferFunction2D.automatic(volume).json()}, None


def _csv(parts: Parts, request: Request) -> Answer:  # noqa: ARG001  # it takes no arguments
    state = parts.control.state
    told = measured_all(parts.resident, state)
    return {"text": as_csv(state.marks, told["rows"], told["units"])}, None


def _remove_layer(parts: Parts, request: Request) -> Answer:
    parts.resident.layers.remove(whole("layer", request.arguments.get("layer"), 1, MOST_MEDIA))
    return {}, None


def _curve(parts: Parts, request: Request) -> Answer:
    """From now on, or no longer, the values at the crosshair along a series."""
    parts.updates.curves = bool(request.arguments.get("on"))
    return {}, None


def _cancel(parts: Parts, request: Request) -> Answer:
    """Give up a file that is being made."""
    parts.jobs.cancel(request.arguments.get("file"))
    return {}, None


def copied(parts: Parts, what: str) -> str:
    """The state as text: "python", "toml" or "url"."""
    state, name = parts.control.state, active_pane(parts.control.state)
    if what == "url":
        return code.to_url(state)
    size = parts.control.context().size(name)
    write = code.python if what == "python" else code.toml
    return write(parts.resident, state, name, size, pixels_of(size))


def _copy(parts: Parts, request: Request) -> Answer:
    return {"text": copied(parts, request.what.removeprefix("copy_"))}, None


def _restore(parts: Parts, request: Request) -> Answer:
    """Show the state of an address."""
    try:
        parts.control.change(Change(code.from_url(request.arguments.get("url", "")), whole=True))
    except ClvolError as error:
        raise OptionError(f"the state in this page's address cannot be read: {error}") from None
    return {}, None


_TABLE: Mapping[str, Callable[[Parts, Request], Answer]] = {
    "undo": _act,
    "redo": _act,
    "reset": _act,
    "fit": _act,
    "copy_python": _copy,
    "copy_toml": _copy,
    "copy_url": _copy,
    "restore": _restore,
    "pick": _pick,
    "heat": _heat,
    "labels": _labels,
    "joint": _joint,
    "measures_csv": _csv,
    "remove_layer": _remove_layer,
    "curve": _curve,
    "cancel": _cancel,
}
