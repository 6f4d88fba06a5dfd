"""What a client can ask to be done and answered: undo, pictures, movies, copies, picks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import whole
from clvol.base.errors import ClvolError, OptionError
from clvol.scene.joint import TransferFunction2D
from clvol.scene.scene import MOST_MEDIA
from clvol.show.movies import FORMATS, packed, require_encoder
from clvol.show.picture import to_bytes
from clvol.view import code
from clvol.view.control import Control
from clvol.view.drawing import Drawer, Order, png
from clvol.view.events import turned
from clvol.view.marks import as_csv
from clvol.view.panes import PaneSize, active_pane
from clvol.view.picking import measured_all
from clvol.view.post import Gone
from clvol.view.protocol import Change, Request
from clvol.view.resident import Resident
from clvol.view.state import name_of
from clvol.view.updates import Updates

__all__ = ["Parts", "action_of", "copied", "pixels_of"]

_MOST_PICTURE = 1 << 13  # pixels along an edge of a picture that is saved
_MOVIE = 16, 1920  # pixels along an edge of a movie
_MOST_BYTES = 1 << 29  # of a movie before it is packed
_MOST_PIXELS = 3840 * 2160

Answer: TypeAlias = tuple[dict[str, Any], bytes | None]


@dataclass(frozen=True)
class Parts:
    """The parts of a session that requests work with."""

    resident: Resident
    control: Control
    drawer: Drawer
    updates: Updates
    status: Callable[[str, str], None]
    closed: Callable[[], bool]


def pixels_of(size: PaneSize, most: float = _MOST_PIXELS) -> tuple[int, int]:
    """Pixels of a picture that fills a pane."""
    width, height = size.width * size.ratio, size.height * size.ratio
    shrink = min(1.0, math.sqrt(most / (width * height)))
    return max(1, round(width * shrink)), max(1, round(height * shrink))


def action_of(request: Request) -> Callable[[Parts, Request], Answer]:
    """The function that does it, and returns what is added to the reply, and its bytes."""
    return _TABLE[name_of("what to do", request.what, _TABLE)]


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
    return {"format": "png", "width": width, "height": height, "name": "clvol.png"}, png(pixels)


def _movie(parts: Parts, request: Request) -> Answer:
    """A full turn about the vertical, from the picture that is shown."""
    context, resident = parts.control.context(), parts.resident
    width, height = pixels_of(context.size("3d"))
    width, height = request.size((min(width, 512), min(height, 512)), *_MOVIE)
    frames = whole("frames", request.arguments.get("frames", 60), 2, 360)
    form = name_of("format", request.arguments.get("format", "gif"), FORMATS)
    require_encoder(form)
    if 4 * frames * width * height > _MOST_BYTES:
        raise OptionError(
            f"a movie must take at most {_MOST_BYTES >> 20} MiB before it is packed; got {frames} of {width} × {height}"
        )
    state = context.pinned(replace(parts.control.state, wiper=None, heat=False))
    upright = replace(state.camera, style="turntable")
    pictures: list[NDArray[np.uint8]] = []
    with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
        for i in range(frames):
            camera = turned(upright, context, 2 * math.pi * i / frames, 0.0) if i else state.camera
            given = resident.arguments(replace(state, camera=camera))
            pictures.append(to_bytes(renderer.render(size=(width, height), **given)))
            parts.status(f"drawing the movie: {(i + 1) / frames:.0%}", "busy")
            if parts.closed():
                raise Gone
    data = packed(pictures, form)
    return {"format": form, "name": f"clvol.{form}", "frames": frames}, data


_TABLE: Mapping[str, Callable[[Parts, Request], Answer]] = {
    "undo": _act,
    "redo": _act,
    "reset": _act,
    "fit": _act,
    "save_picture": _picture,
    "copy_python": _copy,
    "copy_toml": _copy,
    "copy_url": _copy,
    "restore": _restore,
    "pick": _pick,
    "heat": _heat,
    "movie": _movie,
    "labels": _labels,
    "joint": _joint,
    "measures_csv": _csv,
    "remove_layer": _remove_layer,
    "curve": _curve,
}
