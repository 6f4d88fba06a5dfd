"""What a client can ask to be done and answered: undo, pictures, movies, copies, picks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from clvol.base.checks import one_of, whole
from clvol.view import code, movie
from clvol.view.control import Control
from clvol.view.drawing import Drawer, Order
from clvol.view.encode import png
from clvol.view.panes import PaneSize, active_pane
from clvol.view.protocol import Request
from clvol.view.resident import Resident

__all__ = ["Gone", "Parts", "action_of", "copied", "pixels_of"]

_MOST_PICTURE = 1 << 13  # pixels along an edge of a picture that is saved
_MOVIE = 16, 1920  # pixels along an edge of a movie
_MOST_PIXELS = 3840 * 2160

Answer: TypeAlias = tuple[dict[str, Any], bytes | None]


class Gone(Exception):  # nothing went wrong
    """The client is no longer there, or the session was closed."""


@dataclass(frozen=True)
class Parts:
    """The parts of a session that requests work with."""

    resident: Resident
    control: Control
    drawer: Drawer
    status: Callable[[str, str], None]
    closed: Callable[[], bool]


def pixels_of(size: PaneSize, most: float = _MOST_PIXELS) -> tuple[int, int]:
    """Pixels of a picture that fills a pane."""
    width, height = size.width * size.ratio, size.height * size.ratio
    shrink = min(1.0, math.sqrt(most / (width * height)))
    return max(1, round(width * shrink)), max(1, round(height * shrink))


def action_of(request: Request) -> Callable[[Parts, Request], Answer]:
    """The function that does it, and returns what is added to the reply, and its bytes.

    Raises
    ------
    OptionError
        There is no such thing to do.
    """
    if not isinstance(request.what, str) or request.what not in _TABLE:
        raise one_of("what to do", request.what, tuple(_TABLE))
    return _TABLE[request.what]


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


def _picture(parts: Parts, request: Request) -> Answer:
    """The final picture of a pane, seen as high as it is shown."""
    control, context = parts.control, parts.control.context()
    name = request.pane(active_pane(control.state))
    own = context.size(name)
    width, height = request.size(pixels_of(own), 1, _MOST_PICTURE)
    parts.status("drawing the picture", "busy")
    fitted = PaneSize(own.height * width / height, own.height, own.ratio)
    context = replace(context, sizes={**control.sizes, name: fitted})
    pixels = parts.drawer.still(Order(context, control.state, name, (width, height), stop=parts.closed))
    if pixels is None:
        raise Gone
    parts.status("", "info")
    return {"format": "png", "width": width, "height": height, "name": "clvol.png"}, png(pixels)


def _movie(parts: Parts, request: Request) -> Answer:
    context = parts.control.context()
    width, height = pixels_of(context.size("3d"))
    size = request.size((min(width, 512), min(height, 512)), *_MOVIE)
    frames = whole("frames", request.arguments.get("frames", 60), 2, 360)
    wanted = request.arguments.get("format", "gif")
    if wanted not in movie.FORMATS:
        raise one_of("format", wanted, movie.FORMATS)

    def progress(share: float) -> bool:
        parts.status(f"drawing the movie: {share:.0%}", "busy")
        return not parts.closed()

    data = movie.turntable(parts.resident, parts.control.state, context, size, frames, str(wanted), progress)
    parts.status("", "info")
    return {"format": wanted, "name": f"clvol.{wanted}", "frames": frames}, data


_TABLE: Mapping[str, Callable[[Parts, Request], Answer]] = {
    "undo": _act,
    "redo": _act,
    "reset": _act,
    "fit": _act,
    "save_picture": _picture,
    "copy_python": _copy,
    "copy_toml": _copy,
    "copy_url": _copy,
    "pick": _pick,
    "heat": _heat,
    "movie": _movie,
    "labels": _labels,
}
