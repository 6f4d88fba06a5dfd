"""A trame page that shows a volume and rotates it: pictures by clvol, and pointer events back.

    pip install trame trame-vuetify "clvol[pocl]"
    python examples/trame_view.py scan.nii.gz        # or without a file: a phantom

trame transports the picture and the events; the session of `clvol.view` renders in its own thread.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
from typing import Any

from trame.app import get_server
from trame.ui.vuetify3 import SinglePageLayout
from trame.widgets import html, vuetify3

import clvol
from clvol.view import View

SIZE = 512  # pixels of the page
POINTER = (
    "({ type: $event.type, x: $event.offsetX, y: $event.offsetY, button: [1, 3, 2, 4, 5][$event.button], buttons: $event.buttons })"
)
WHEEL = "({ type: 'wheel', x: $event.offsetX, y: $event.offsetY, dy: $event.deltaY })"
NAMES = {"pointerdown": "pointer_down", "pointermove": "pointer_move", "pointerup": "pointer_up", "wheel": "wheel"}


class Page:
    """One page for one viewer."""

    def __init__(self, view: View) -> None:
        self.server = get_server(client_type="vue3")
        self.state = self.server.state
        self.state.update({"picture": "", "still": False, "mode": view.state.mode})
        self.loop: asyncio.AbstractEventLoop | None = None
        self.session: Any = None
        self.server.controller.on_server_ready.add(lambda **_: self.connect(view))
        self.state.change("mode")(self.changed)
        self.build()

    def connect(self, view: View) -> None:
        """Start rendering, now that an event loop runs."""
        self.loop = asyncio.get_running_loop()
        self.session = view.session(self.sent)
        self.tell(event_type="resize", width=SIZE, height=SIZE, ratio=1)

    def sent(self, message: dict[str, Any], data: bytes | None) -> None:
        """Handle a message of the session, in its thread: trame's state belongs to the loop."""
        if message["type"] == "frame" and data is not None and self.loop is not None:
            self.loop.call_soon_threadsafe(self.show, message, data)

    def show(self, message: dict[str, Any], data: bytes) -> None:
        with self.state:
            self.state.picture = f"data:image/{message['format']};base64,{base64.b64encode(data).decode()}"
            self.state.still = message["final"]
        self.session.receive({"type": "ack", "frame": message["number"]})

    def tell(self, **event: Any) -> None:
        self.session.receive({"type": "event", "event": event})

    def moved(self, event: dict[str, Any]) -> None:
        """Handle an event of the page."""
        kind = NAMES[event.pop("type")]
        if kind == "pointer_move":  # pressed buttons are a bit mask
            event["buttons"] = [n + 1 for n in range(3) if event["buttons"] >> n & 1]
        else:
            event.pop("buttons", None)
        self.tell(event_type=kind, **event)

    def changed(self, mode: str, **_: Any) -> None:
        if self.session is not None:
            self.session.receive({"type": "set", "changes": {"mode": mode}})

    def build(self) -> None:
        """The page: a picture, and a list of modes."""
        with SinglePageLayout(self.server) as layout:
            layout.title.set_text("clvol")
            with layout.toolbar:
                vuetify3.VSpacer()
                vuetify3.VSelect(v_model=("mode",), items=("modes", list(clvol.modes())), density="compact", hide_details=True)
            with layout.content:
                html.Img(
                    src=("picture",),
                    style=f"width: {SIZE}px; height: {SIZE}px; touch-action: none; user-select: none;",
                    draggable="false",
                    pointerdown=(self.moved, f"[{POINTER}]"),
                    pointermove=(self.moved, f"[{POINTER}]"),
                    pointerup=(self.moved, f"[{POINTER}]"),
                    __events=["pointerdown", "pointermove", "pointerup", ("wheel_prevent", "wheel.prevent")],
                    wheel_prevent=(self.moved, f"[{WHEEL}]"),
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", nargs="?", help="a volume; by default a phantom")
    parser.add_argument("--port", type=int, default=0, help="default: a free one")
    given = parser.parse_args()
    volume = clvol.phantoms.marschner_lobb() if given.file is None else clvol.read(given.file)
    Page(View(volume, mode="isosurface")).server.start(port=given.port, open_browser=False, host="127.0.0.1")


if __name__ == "__main__":
    main()
