"""A client in this process, for windows and terminals: it composes the panes of a session into one picture.

The session's thread decodes and scales its frames, so that the host's loop only shows the newest picture.
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.view.drawing import opaque
from clvol.view.panes import visible
from clvol.view.state import State

if TYPE_CHECKING:
    from clvol.view import View

__all__ = ["LocalClient", "decoded", "scaled"]

_MOST_RATIO = 2.0  # pixels per CSS pixel: more are not seen, but take time
_CROSS = 8  # pixels
_MARK = np.array([120, 96, 24], np.uint8)  # half of an amber
_DOT = 4.0, np.array([127, 209, 255], np.uint8)  # of a clip plane: radius in CSS pixels, light blue
_OF_POINTER = ("pointer_down", "pointer_move", "pointer_up", "double_click", "wheel")

Array = NDArray[np.uint8]
Rectangle = tuple[int, int, int, int]


class LocalClient:
    """A session whose panes are composed here.

    `changed` is called from the session's thread when `take` has something new, and must return at once. `pointer` says whether
    there is one, for which clip planes have dots.
    """

    def __init__(self, view: View, changed: Callable[[], Any], state: State | None = None, *, pointer: bool = True) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._state = view.resident.initial if state is None else state
        self._size, self._ratio = (0, 0), 1.0
        self._canvas: Array = np.zeros((0, 0, 3), np.uint8)
        self._parts: dict[str, Rectangle] = {}
        self._shown: list[int] = []
        self._still: set[str] = set()
        self._overlays: dict[str, dict[str, Any]] = {}
        self._pointer = pointer
        self._held: str | None = None
        self.title = ""
        self.text = ""
        self.closed = False
        self.session = view.session(self._take_message, state)

    # -- for the host ----------------------------------------------------------------------------------------------

    def resize(self, width: int, height: int, ratio: float = 1.0) -> None:
        """Set the size of the picture in pixels, and pixels per CSS pixel."""
        with self._lock:
            if ((width, height), ratio) == (self._size, self._ratio) or min(width, height) < 1:
                return
            self._size, self._ratio = (width, height), ratio
            self._lay_out()

    def event(self, event: Mapping[str, Any]) -> None:
        """Pass on an event of rendercanvas, in CSS pixels of the whole picture, to the pane there."""
        kind = event.get("event_type")
        sent = dict(event)
        if kind in _OF_POINTER:
            x, y = float(event.get("x", 0)), float(event.get("y", 0))
            with self._lock:
                name = self._held if self._held in self._parts else self._pane_at(x, y)
                left, top = self._parts.get(name or "", (0, 0, 0, 0))[:2]
            if name is None:
                return
            if kind == "pointer_down":
                self._held = name  # a drag belongs to the pane where it began
            elif kind == "pointer_up":
                self._held = None
            sent |= {"pane": name, "x": x - left / self._ratio, "y": y - top / self._ratio}
        self.session.receive({"type": "event", "event": sent})

    def take(self) -> Array:
        """The newest picture, (height, width, 3) uint8; its frames count as shown."""
        with self._lock:
            picture, shown = self._canvas.copy(), self._shown
            self._shown = []
            for name, (left, top, width, height) in self._parts.items():
                overlay, pane = self._overlays.get(name, {}), picture[top : top + height, left : left + width]
                if overlay.get("crosshair") is not None and len(self._parts) > 1:
                    self._mark(pane, _CROSS if name == "3d" else max(width, height), overlay["crosshair"])
                for _, _, x, y in overlay.get("faces", ()) if self._pointer else ():
                    self._dot(pane, x * self._ratio, y * self._ratio)
        for number in shown:
            self.session.receive({"type": "ack", "frame": number})
        return picture

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self._size

    @property
    def still(self) -> bool:
        """Whether all panes show their final picture."""
        with self._lock:
            return bool(self._parts) and self._still >= self._parts.keys()

    def close(self) -> None:
        """End the session."""
        self.closed = True
        self.session.close()

    # -- from the session's thread ------------------------------------------------------------------------------------

    def _take_message(self, message: dict[str, Any], data: bytes | None) -> None:
        if self.closed:
            raise ConnectionError("the window was closed")
        kind = message["type"]
        if kind == "frame" and data is not None:
            self._take_frame(message, data)
        elif kind == "info":
            self.title = str(message.get("title") or "")
        elif kind == "state":
            with self._lock:
                before = visible(self._state)
                self._state = State.from_json(message["state"])
                if visible(self._state) != before:
                    self._lay_out()
        elif kind == "overlay":
            with self._lock:
                self._overlays[message["pane"]] = message
        elif kind == "status":
            self.text = str(message.get("text") or "")
        elif kind == "reply" and message.get("value") is not None:
            self.text = f"value {message['value']:.6g} at {', '.join(f'{x:.4g}' for x in message.get('position') or ())}"
        else:
            return
        self._changed()

    def _take_frame(self, message: dict[str, Any], data: bytes) -> None:
        name = message["pane"]
        with self._lock:
            part = self._parts.get(name)
        pixels = None if part is None else scaled(decoded(data), (part[2], part[3]))
        with self._lock:
            self._shown.append(message["number"])
            if pixels is None or self._parts.get(name) != part or part is None:
                return  # of a former layout
            left, top, width, height = part
            self._canvas[top : top + height, left : left + width] = pixels
            (self._still.add if message.get("final") else self._still.discard)(name)

    # -- panes -----------------------------------------------------------------------------------------------------

    def _lay_out(self) -> None:
        """Lay out the panes: one fills the picture, four have a quarter each. The old picture stays until there is a new one."""
        width, height = self._size
        names = visible(self._state)
        if not width or not height:
            return
        self._canvas = scaled(self._canvas, self._size) if self._canvas.size else np.zeros((height, width, 3), np.uint8)
        columns = 1 if len(names) == 1 else 2
        rows = -(-len(names) // columns)
        self._still.clear()
        self._parts = {}
        for i, name in enumerate(names):
            left, right = (width * k // columns for k in (i % columns, i % columns + 1))
            top, bottom = (height * k // rows for k in (i // columns, i // columns + 1))
            self._parts[name] = part = (left, top, max(1, right - left), max(1, bottom - top))
            size = {"width": part[2] / self._ratio, "height": part[3] / self._ratio, "ratio": min(self._ratio, _MOST_RATIO)}
            self.session.receive({"type": "event", "event": {"event_type": "resize", "pane": name, **size}})

    def _mark(self, pane: Array, reach: int, at: tuple[float, float]) -> None:
        """Draw the crosshair of linked panes: lines in slices, a small cross in the volume."""
        x, y = (int(v * self._ratio) for v in at)
        height, width = pane.shape[:2]
        for line in (
            pane[y : y + 1, max(0, x - reach) : max(0, x + reach + 1)] if 0 <= y < height else pane[:0],
            pane[max(0, y - reach) : max(0, y + reach + 1), x : x + 1] if 0 <= x < width else pane[:0],
        ):
            line[:] = line // 2 + _MARK

    def _dot(self, pane: Array, x: float, y: float) -> None:
        """Draw the dot that drags a clip plane."""
        radius, color = _DOT[0] * self._ratio, _DOT[1]
        rows, columns = (slice(max(0, int(v - radius)), max(0, int(v + radius) + 1)) for v in (y, x))
        square = pane[rows, columns]
        down, across = np.ogrid[: square.shape[0], : square.shape[1]]
        square[np.hypot(down + rows.start - y, across + columns.start - x) <= radius] = color

    def _pane_at(self, x: float, y: float) -> str | None:
        for name, (left, top, width, height) in self._parts.items():
            if left <= x * self._ratio < left + width and top <= y * self._ratio < top + height:
                return name
        return None


def decoded(data: bytes) -> Array:
    """The picture of a frame, (height, width, 3), over black."""
    from PIL import Image

    pixels = np.asarray(Image.open(io.BytesIO(data)))
    return opaque(np.repeat(pixels[..., None], 3, 2) if pixels.ndim == 2 else pixels)


def scaled(pixels: Array, size: tuple[int, int]) -> Array:
    """A picture scaled to (width, height): by the linear filter, or by means where the size is divided.

    Not on the device: a first picture must not wait for its kernels.
    """
    for axis, count in ((0, size[1]), (1, size[0])):
        n = pixels.shape[axis]
        if n == count:
            continue
        if n % count == 0:
            split = (*pixels.shape[:axis], count, n // count, *pixels.shape[axis + 1 :])
            pixels = np.rint(pixels.reshape(split).mean(axis + 1, dtype=np.float32)).astype(np.uint8)
            continue
        at = np.clip((np.arange(count) + 0.5) * (n / count) - 0.5, 0, n - 1)
        first = np.minimum(at.astype(np.intp), max(0, n - 2))
        share = np.rint(256 * (at - first)).astype(np.uint16)
        share = share.reshape([-1 if k == axis else 1 for k in range(3)])
        low, high = pixels.take(first, axis), pixels.take(np.minimum(first + 1, n - 1), axis)
        pixels = ((low * (256 - share) + high * share + 128) >> 8).astype(np.uint8)
    return np.ascontiguousarray(pixels)
