"""A window: any canvas of rendercanvas shows a session (``pip install "clvol[desktop]"``). It needs no GPU and no OpenGL.

rendercanvas draws and receives events on its event loop, which here only shows what the session's thread has drawn.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.base.errors import MissingDependencyError, UnsupportedError
from clvol.view.hosts.local import LocalClient

if TYPE_CHECKING:
    from clvol.view import View
    from clvol.view.state import State

__all__ = ["DesktopWindow", "require_display", "show_on_desktop"]

_EVENTS = ("pointer_down", "pointer_move", "pointer_up", "double_click", "wheel", "key_down", "key_up")
_SIZE = 900, 700


class DesktopWindow:
    """A session in a canvas of rendercanvas (of Qt, offscreen, ...): any that shows bitmaps.

    `loop` is woken for new pictures. Without one, the canvas's ``draw`` gives the newest.
    """

    def __init__(self, view: View, canvas: Any, loop: Any = None, state: State | None = None) -> None:
        self._canvas, self._loop = canvas, loop
        self._context = canvas.get_bitmap_context()
        self._title = ""
        self.client = LocalClient(view, self._wake, state)
        canvas.add_event_handler(self._resized, "resize")
        canvas.add_event_handler(self._closed, "close")
        canvas.add_event_handler(self.client.event, *_EVENTS)
        self._resized({})
        canvas.request_draw(self._draw)

    def close(self) -> None:
        """End the session, and close the canvas."""
        self.client.close()
        if not self._canvas.get_closed():
            self._canvas.close()

    def _wake(self) -> None:
        """From the session's thread; only the loop may use the canvas."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._request)

    def _request(self) -> None:
        if self.client.closed or self._canvas.get_closed():
            return
        words = " – ".join(word for word in ("clvol", self.client.title, self.client.text) if word)
        if words != self._title:
            self._title = words
            self._canvas.set_title(words)
        self._canvas.request_draw()

    def _resized(self, _: Mapping[str, Any]) -> None:
        width, height = self._canvas.get_physical_size()
        self.client.resize(width, height, self._canvas.get_pixel_ratio())

    def _closed(self, _: Mapping[str, Any]) -> None:
        self.client.close()

    def _draw(self) -> None:
        self._resized({})  # some canvases send no event of their first size
        pixels = self.client.take()
        opaque = np.full((*pixels.shape[:2], 4), 255, np.uint8)
        opaque[..., :3] = pixels
        self._context.set_bitmap(opaque)


def show_on_desktop(view: View, size: tuple[int, int] = _SIZE, state: State | None = None) -> None:
    """Show a view in a Qt window, and wait until it is closed.

    Raises
    ------
    MissingDependencyError
        rendercanvas, or both PySide6 and PyQt6, are not installed.
    UnsupportedError
        There is no display.
    """
    require_display()
    library = _qt()
    canvas = library.RenderCanvas(size=size, title="clvol", max_fps=60)
    window = DesktopWindow(view, canvas, library.loop, state)
    try:
        library.loop.run()
    finally:
        window.close()


def require_display() -> None:
    """Raise `UnsupportedError` if there is no display: Qt would abort the process."""
    if sys.platform in ("win32", "darwin") or os.environ.get("QT_QPA_PLATFORM"):
        return
    if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
        raise UnsupportedError(
            "a window needs a display; DISPLAY and WAYLAND_DISPLAY name none: take `clvol view --serve`, a page that other "
            "machines show, or --terminal"
        )


def _qt() -> Any:
    """The rendercanvas for an installed Qt, preferably one that is already imported."""
    from importlib import import_module

    names = sorted(("PySide6", "PyQt6"), key=lambda name: name not in sys.modules)
    for name in names:
        try:
            import_module(f"{name}.QtWidgets")
            return import_module(f"rendercanvas.{name.lower()}")
        except ImportError:
            continue
    raise MissingDependencyError('a window needs rendercanvas and PySide6: pip install "clvol[desktop]"')
