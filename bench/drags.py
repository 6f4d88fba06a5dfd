"""What a drag shows: the pixels and steps of its pictures, and how many come a second, in each mode.

    python -m bench.drags FILE [--size 648x520] [--seconds 4] [--modes mip,minip] [--browser]

A real session is dragged by pointer events at 60 a second; each frame is acknowledged at once, or, with --browser, by a page in
Chromium on the same cores. Other programs slow a machine: beside each drag stands what a fixed picture of 324 × 260 by one ray a
pixel takes, drawn before and after it.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import threading
import time
from collections.abc import Mapping
from typing import Any

import clvol
from bench.machine import describe
from clvol.device import as_device
from clvol.view import View
from clvol.view.protocol import Message
from tests.view.browser import open_browser, why_none

MODES = ("composite", "isosurface", "surfaces", "mip", "minip", "mean", "attenuated")
_FIXED = 324, 260
_EVENTS = 60  # a second
_PANE = ".clvol-pane[data-pane='3d']"


class Frames:
    """The frames that a session sends, with their times."""

    def __init__(self) -> None:
        self.came = threading.Condition()
        self.list: list[tuple[float, Message, int]] = []

    def take(self, message: Message, data: bytes | None) -> None:
        """Keep a frame."""
        if message["type"] == "frame" and data is not None:
            with self.came:
                self.list.append((time.perf_counter(), message, len(data)))
                self.came.notify_all()

    def settled(self) -> None:
        """Wait for a final picture; the list is then empty."""
        with self.came:
            assert self.came.wait_for(lambda: bool(self.list) and self.list[-1][1]["final"], 120), "no final picture"
            self.list.clear()


def main() -> None:
    """Drag, and print a table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("file")
    arguments.add_argument("--size", default="648x520", help="of the pane, in pixels")
    arguments.add_argument("--seconds", type=float, default=4.0)
    arguments.add_argument("--modes", default=",".join(MODES))
    arguments.add_argument("--browser", action="store_true")
    given = arguments.parse_args()
    width, height = map(int, given.size.split("x"))
    volume = clvol.read(given.file)
    machine, load = describe(as_device()), os.getloadavg()[0]
    print(f"{machine['processor']}, {machine['cores']} cores, load {load:.1f}; {volume.shape}, pane {width} × {height}")
    print(f"{'mode':12} {'width':>6} {'least':>6} {'step':>5} {'a second':>9} {'ms':>6} {'KiB':>5} {'fixed ms':>9}")
    for mode in given.modes.split(","):
        with clvol.Renderer(volume) as renderer:
            before = fixed(renderer, mode)
            frames = by_browser if given.browser else by_session
            found = frames(View(volume, mode=mode), (width, height), given.seconds)
            report(mode, found, (before, fixed(renderer, mode)))


def fixed(renderer: clvol.Renderer, mode: str) -> float:
    """Seconds of a picture of one size and step."""
    times = []
    for i in range(5):
        began = time.perf_counter()
        renderer.render(clvol.Camera.orbit(30 + 3 * i, 20), mode, _FIXED, rays=1)
        times.append(time.perf_counter() - began)
    return statistics.median(times[1:])


def by_session(view: View, size: tuple[int, int], seconds: float) -> list[tuple[float, Message, int]]:
    """The frames of a drag of a session without a page."""
    frames = Frames()

    def send(message: Mapping[str, Any], data: bytes | None) -> None:
        frames.take({**message}, data)
        if message["type"] == "frame":
            session.receive({"type": "ack", "frame": message["number"]})

    session = view.session(send)
    place = {"pane": "3d", "button": 1, "buttons": [1]}
    session.receive({"type": "event", "event": {"event_type": "resize", "width": size[0], "height": size[1], "ratio": 1}})
    frames.settled()
    session.receive({"type": "event", "event": {"event_type": "pointer_down", "x": 0, "y": size[1] / 2, **place}})
    for x, y in path(size, seconds):
        session.receive({"type": "event", "event": {"event_type": "pointer_move", "x": x, "y": y, **place}})
    result = [*frames.list]
    session.close()
    view.close()
    return result


def by_browser(view: View, size: tuple[int, int], seconds: float) -> list[tuple[float, Message, int]]:
    """The frames of a drag of a page in Chromium."""
    assert not why_none(), why_none()
    frames, session = Frames(), view.session

    def watched(send: Any, *more: Any) -> Any:
        def sent(message: Message, data: bytes | None) -> None:
            frames.take(message, data)
            send(message, data)

        return session(sent, *more)

    view.session = watched  # type: ignore[assignment, method-assign]  # to see what it sends
    with view.serve() as server, open_browser() as browser:
        browser.open(server.url)
        browser.wait(f"document.querySelector({_PANE!r})")
        _, _, width, height = browser.box(_PANE)
        inner = browser.js("return [innerWidth, innerHeight]")
        metrics = {"width": round(inner[0] + size[0] - width), "height": round(inner[1] + size[1] - height)}
        browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {**metrics, "deviceScaleFactor": 1, "mobile": False})
        frames.settled()
        time.sleep(2)
        frames.list.clear()
        left, top, *_ = browser.box(_PANE)
        browser.mouse("mouseMoved", left + 1, top + size[1] / 2)
        browser.mouse("mousePressed", left + 1, top + size[1] / 2, buttons=1)
        for x, y in path(size, seconds):
            browser.mouse("mouseMoved", left + x, top + y, button="left", buttons=1)
        result = [*frames.list]
    view.close()
    return result


def path(size: tuple[int, int], seconds: float) -> Any:
    """Positions of the pointer, at their times: to and fro, and up and down."""
    began = time.perf_counter()
    for i in range(round(seconds * _EVENTS)):
        time.sleep(max(0.0, began + i / _EVENTS - time.perf_counter()))
        turn = i / _EVENTS
        yield size[0] * (0.5 + 0.4 * math.sin(turn)), size[1] * (0.5 + 0.2 * math.sin(1.7 * turn))


def report(mode: str, frames: list[tuple[float, Message, int]], beside: tuple[float, float]) -> None:
    """A line of the table; the first half second does not count."""
    kept = [one for one in frames if one[0] - frames[0][0] > 0.5 and not one[1]["final"]]
    if len(kept) < 2:
        print(f"{mode:12} {len(kept)} of {len(frames)} pictures count: too few, so drag for longer", flush=True)
        return
    widths = [message["width"] for _, message, _ in kept]
    steps = [message.get("step") or math.nan for _, message, _ in kept]
    rate = (len(kept) - 1) / (kept[-1][0] - kept[0][0])
    spent = 1e3 * statistics.median(message["seconds"] for _, message, _ in kept)
    size = statistics.median(size for *_, size in kept) / 1024
    line = f"{mode:12} {statistics.median(widths):6.0f} {min(widths):6} {statistics.median(steps):5.2g} {rate:9.1f} {spent:6.1f}"
    print(line, f"{size:5.0f} {1e3 * beside[0]:4.0f} {1e3 * beside[1]:4.0f}", flush=True)


if __name__ == "__main__":
    main()
