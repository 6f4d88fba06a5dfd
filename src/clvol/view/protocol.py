"""Messages between a session and its client: JSON objects, some followed by bytes.

From the client:

- `{"type": "event", "event": {...}}`: an event of rendercanvas. Without "pane" it is for the pane that is shown; a `resize`
  without it is for all panes that had none of their own. Its width and height, which may be fractions, times its ratio are the
  pixels of the screen that the pane covers: pictures at rest have as many.
- `{"type": "set", "changes": {...}, "live": true?, "gesture": "..."?, "number": n?, "whole": true?}`: `live` changes are
  one step of undo (a slider that is dragged); one without it ends them, and belongs to the same step if it has the gesture's name.
  The number comes back as "heard" with states that include the change, so that a client that has sent more shows that.
- `{"type": "do", "what": "...", "id": ..., ...}`: answered by a `reply` with that id. `pick` (x, y, pane) what lies there;
  a double click gives such a reply without an id. `restore` (url) shows the state of an address. `curve` (on) has the values at the
  crosshair along a series sent whenever they change. `joint` gives a "transfer" of value and gradient to begin with.
  Files take long: `save_picture` (width, height, pane, measures: with those on a slice) gives a PNG; `movie` (width, height,
  frames, format: "gif", "webp", "mp4", "webm" or "zip" of PNG); `mesh` (format: "ply", "stl", "obj" or "glb", faces?) the
  isosurface, or the surfaces of labels. The reply, with a "name", and a "note" if there is something to know of it, comes when one
  is ready, and pictures meanwhile; `cancel` (file: the id of its request) gives it up, and the reply says "cancelled". One that is
  too large for a socket has a "download" in place of bytes: the page's server gives it once at ``download?name=...``.
- `{"type": "hover", "pane", "x", "y"}`: the pointer rests or moves there, in CSS pixels; without "pane" it has left. Only the last
  counts, it interrupts no picture, and is answered by a `readout`.
- `{"type": "ack", "frame": number}`: the client has shown a frame.
- `{"type": "ping"}`: the page's server answers with `{"type": "pong", "working"}`, the seconds for which the session has shown no
  progress.

To the client:

- `{"type": "state", "state", "heard", "can_undo", "can_redo", "effective"?}`: `effective` is what applies where the state leaves it
  open: "transfer" (as JSON), "window" of slices, "filter" by its full name, "options" of the mode (the isovalue), "crosshair". The
  first may come without, and a second one once that is known.
- `{"type": "frame", "number", "pane", "width", "height", "shown_width", "shown_height", "format", "final", "seconds", "step"?,
  "few"?, "share_visited"?}` and its bytes. A frame with `few` shows few of the samples: coefficients of all are being computed.
- `{"type": "overlay", "pane", "crosshair": [x, y] | null, "lines", "box": [[x, y] | null, ... 8] | null, "faces", "unit_pixels",
  "right", "down"}`: where to draw the crosshair and the crop box, in CSS pixels of the pane (corner ``i`` is at the high end along
  x, y, z where bit 0, 1, 2 of ``i`` is set); `lines` are the directions of both lines of a slice's crosshair; `faces` has
  ``[axis, side, x, y]`` of each clip plane that can be dragged there; CSS pixels per world unit; the world directions that run
  right and down. Sent when one changed.
- `{"type": "measures", "units", "rows"}`: what each of the state's marks measures, as `clvol.view.measured` says. `overlay` has
  "marks", those that lie on the slice: their "number" in the state, "kind", and "points" in CSS pixels.
- `{"type": "readout", "pane", "position", "voxel", "units", "values"}`: what lies under the pointer, at most ten times a second,
  and again when the picture there has changed: world position, the voxel (x, y, z) of the first volume, and for each medium its
  "name", "value" (null outside) and, of label maps, the "label" by name. "pane" alone: there is nothing.
- `{"type": "wiper", "errors": {...} | null}`: the measured error of both filters (`clvol.view.wiper`); null until it is known.
- `{"type": "joint", "values": [low, high], "steepest", "image"}`: how often which value and gradient occur, where the transfer
  function is of both; `image` is a PNG as a data URL, opaque where they are frequent, the steepest at its top.
- `{"type": "curve", "axis", "position", "values": [...]}`, or with a "problem": the values at the crosshair of all volumes along an
  axis, null where samples are not finite.
- `{"type": "job", "id", "name", "doing", "share"}`: how far the file of a request is, from 0 to 1.
- `info`, `stats`, `status` ("text", and "kind": "info", "busy", "warning" or "error") and `reply`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from clvol.base.checks import number, one_of, whole
from clvol.base.errors import OptionError
from clvol.view.panes import PaneSize
from clvol.view.state import PANES, name_of

__all__ = [
    "Change",
    "Message",
    "PointerOrKey",
    "Receiver",
    "Request",
    "Resize",
    "Send",
    "SessionFactory",
    "ends_drag",
    "hovered",
    "parse",
    "replaces",
    "status",
]

Message: TypeAlias = dict[str, Any]
Send: TypeAlias = Callable[[Message, bytes | None], None]

_SMALLEST, _LARGEST = 16.0, 8192.0  # CSS pixels along an edge of a pane
_LEAST_RATIO, _MOST_RATIO = 0.25, 4.0  # pixels of the screen per CSS pixel


class Receiver(Protocol):
    """A session, as hosts use it."""

    def receive(self, message: Mapping[str, Any]) -> None: ...
    def close(self, timeout: float | None = ...) -> None: ...


class SessionFactory(Protocol):
    """A view, as hosts use it."""

    def session(self, send: Send) -> Receiver: ...


@dataclass(frozen=True)
class Resize:
    """The size of a pane, or, with the name "", of all panes that have none of their own."""

    pane: str
    size: PaneSize


@dataclass(frozen=True)
class PointerOrKey:
    """Any other event; `events.reduce` checks it."""

    event: Any


@dataclass(frozen=True)
class Change:
    """Changes of the state, or a whole one; `State` checks them."""

    changes: Any
    whole: bool
    live: bool = False
    gesture: str | None = None
    number: int | None = None
    via: frozenset[int] | None = None
    """Of what other views are linked to: numbers of those from which it came. None: the client did it."""

    @property
    def step(self) -> tuple[str, ...] | None:
        """What changes of one step of undo have in common; None: it is a step of its own."""
        if self.gesture is not None:
            return "set", self.gesture
        return ("set", *sorted(map(str, self.changes))) if self.live else None


@dataclass(frozen=True)
class Request:
    """Something to be done and answered; its arguments are checked as they are used."""

    what: Any
    id: Any
    arguments: Mapping[str, Any]

    def pane(self, default: str) -> str:
        """The pane that it is for."""
        return name_of("pane", self.arguments.get("pane") or default, PANES)

    def size(self, default: tuple[int, int], minimum: int, maximum: int) -> tuple[int, int]:
        """Width and height in pixels."""
        names = zip(("width", "height"), default, strict=True)
        width, height = (whole(name, self.arguments.get(name, usual), minimum, maximum) for name, usual in names)
        return width, height

    def position(self) -> tuple[float, float]:
        """A position in CSS pixels."""
        x, y = (number(axis, self.arguments.get(axis), minimum=-1e6, maximum=1e6) for axis in "xy")
        return x, y


def parse(message: Any) -> Resize | PointerOrKey | Change | Request:
    """The typed message; acknowledgements never come this far."""
    if not isinstance(message, Mapping):
        raise OptionError(f"a message must be an object of JSON; got {message!r:.200}")
    kind = message.get("type")
    if kind == "event":
        event: Any = message.get("event")
        return _resize(event) if _kind_of(event) == "resize" else PointerOrKey(event)
    if kind == "set":
        gesture, count, via = message.get("gesture"), message.get("number"), message.get("via")
        return Change(
            changes=message.get("changes"),
            whole=bool(message.get("whole")),
            live=bool(message.get("live")),
            gesture=gesture if isinstance(gesture, str) else None,
            number=count if isinstance(count, int) else None,
            via=via if isinstance(via, frozenset) else None,  # JSON has none
        )
    if kind == "do":
        return Request(message.get("what"), message.get("id"), message)
    raise one_of("the type of a message", kind, ("event", "set", "do", "hover", "ack"))


def _resize(event: Mapping[str, Any]) -> Resize:
    name = name_of("pane", event.get("pane", ""), ("", *PANES))
    width, height = (number(what, event.get(what), minimum=0, maximum=1e6) for what in ("width", "height"))
    ratio = number("ratio", event.get("ratio", event.get("pixel_ratio", 1)), above=0, maximum=16)
    width, height = (min(max(edge, _SMALLEST), _LARGEST) for edge in (width, height))
    return Resize(name, PaneSize(width, height, min(max(ratio, _LEAST_RATIO), _MOST_RATIO)))


def hovered(message: Mapping[str, Any]) -> tuple[str, float, float] | None:
    """The pane and position of a message "hover"; None if the pointer has left."""
    if message.get("pane") is None:
        return None
    x, y = (number(axis, message.get(axis), minimum=-1e6, maximum=1e6) for axis in "xy")
    return name_of("pane", message["pane"], PANES), x, y


def _kind_of(event: Any) -> Any:
    return event.get("event_type", event.get("type")) if isinstance(event, Mapping) else None


def ends_drag(message: Any) -> bool:
    """Whether a message says that the pointer was let go."""
    return isinstance(message, Mapping) and _kind_of(message.get("event")) == "pointer_up"


def replaces(message: Any, other: Any) -> bool:
    """Whether a message makes the one before it redundant: moves of a pointer, resizes, and live changes of linked views."""
    if isinstance(message, Mapping) and isinstance(other, Mapping) and isinstance(message.get("via"), frozenset):
        return bool(message.get("live")) and all(message.get(key) == other.get(key) for key in ("type", "live", "gesture", "via"))
    if not (isinstance(message, Mapping) and isinstance(other, Mapping) and message.get("type") == other.get("type") == "event"):
        return False
    one, two = message.get("event"), other.get("event")
    if not (isinstance(one, Mapping) and isinstance(two, Mapping)) or one.get("pane") != two.get("pane"):
        return False
    return _kind_of(one) == _kind_of(two) and _kind_of(one) in ("pointer_move", "resize")


def status(text: str, kind: str) -> Message:
    """A line of text for people; `kind` is "info", "busy" or "error"."""
    return {"type": "status", "text": text, "kind": kind}
