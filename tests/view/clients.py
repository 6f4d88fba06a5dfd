"""A session client for tests, and random states."""

from __future__ import annotations

import io
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clvol.view import State, View
from tests import cases

__all__ = ["Client", "at_rest", "decoded", "random_changes", "random_event"]


def decoded(data: bytes | None) -> NDArray[np.uint8]:
    assert data is not None
    return np.asarray(Image.open(io.BytesIO(data)))


class Client:
    """Records what a session sends; acknowledges frames unless disabled."""

    def __init__(self, view: View, state: State | None = None, *, acknowledges: bool = True) -> None:
        self.got: list[tuple[dict[str, Any], bytes | None]] = []
        self.condition = threading.Condition()
        self.acknowledges = acknowledges
        self.session = view.session(self.send, state)

    def send(self, message: dict[str, Any], data: bytes | None) -> None:
        with self.condition:
            self.got.append((message, data))
            self.condition.notify_all()
        if message["type"] == "frame" and self.acknowledges:
            self.session.receive({"type": "ack", "frame": message["number"]})

    def event(self, kind: str, **more: Any) -> None:
        self.session.receive({"type": "event", "event": {"event_type": kind, **more}})

    def resize(self, width: float = 96, height: float = 72, **more: Any) -> None:
        self.event("resize", width=width, height=height, ratio=more.pop("ratio", 1), **more)

    def set(self, **changes: Any) -> None:
        self.session.receive({"type": "set", "changes": {name.replace("__", "."): value for name, value in changes.items()}})

    def forget(self) -> None:
        with self.condition:
            self.got.clear()

    def of(self, kind: str) -> list[dict[str, Any]]:
        with self.condition:
            return [message for message, _ in self.got if message["type"] == kind]

    def wait(self, wanted: Callable[[dict[str, Any]], bool], seconds: float = 60) -> tuple[dict[str, Any], bytes | None]:
        """The last of the requested messages, once there is one."""
        with self.condition:
            came = self.condition.wait_for(lambda: any(wanted(message) for message, _ in self.got), seconds)
            assert came, [message for message, _ in self.got[-4:]]
            return next((message, data) for message, data in reversed(self.got) if wanted(message))

    def still(self, pane: str = "3d") -> tuple[dict[str, Any], NDArray[np.uint8]]:
        message, data = self.wait(lambda m: m["type"] == "frame" and m["final"] and m["pane"] == pane)
        return message, decoded(data)

    def close(self) -> None:
        self.session.close()


@contextmanager
def at_rest(view: View, size: tuple[float, float]) -> Iterator[Client]:
    """A client with a pane of the given size that has its still picture; earlier messages are dropped."""
    made = Client(view)
    made.resize(*size)
    made.still()
    made.forget()
    yield made
    made.close()


def random_changes(chance: random.Random) -> dict[str, Any]:
    """Consistent changes of several fields."""

    def vector(size: float = 2.0) -> list[float]:
        return [chance.uniform(-size, size) for _ in range(3)]

    def shares(count: int) -> list[float]:
        return [chance.random() for _ in range(count)]

    mode = chance.choice(cases.MODES)
    values = sorted(chance.uniform(-1000, 3000) for _ in range(chance.randint(1, 6)))
    low = vector()
    made: dict[str, Any] = {
        "layout": chance.choice(["3d", "slice", "linked"]),
        "active": chance.choice(["3d", "x", "y", "z"]),
        "tool": chance.choice([None, "pan", "window", "crop", "rectangle", "area"]),
        "camera.direction": vector(),
        "camera.up": vector(),
        "camera.zoom": chance.uniform(0.1, 50),
        "camera.target": chance.choice([None, vector()]),
        "camera.style": chance.choice(["turntable", "trackball"]),
        "camera.projection": chance.choice(["perspective", "orthographic"]),
        "slice.zoom": chance.uniform(0.1, 50),
        "slice.window": chance.choice([None, [chance.uniform(-100, 100), chance.uniform(1, 500)]]),
        "mode": mode,
        "filter": chance.choice([None, "linear", "bspline3", "bspline3(0.5)", "catmull-rom"]),
        "boundary": chance.choice(["mirror", "nearest", "constant(5)"]),
        "step": chance.uniform(0.1, 2),
        "transfer": chance.choice([None, {"points": [[value, shares(3), chance.random()] for value in values]}]),
        "preset": chance.choice([None, "ct-bone"]),
        "window": chance.choice([None, [chance.uniform(-100, 100), chance.uniform(1, 500)]]),
        "cmap": chance.choice([None, "viridis"]),
        "opacity": chance.choice([None, chance.random()]),
        "lights": chance.choice([None, [{"direction": vector(), "color": shares(3), "frame": "camera"}, {"direction": None}]]),
        "background": chance.choice([None, shares(3)]),
        "clip": chance.choice([None, {"low": low, "high": [v + chance.uniform(0.1, 2) for v in low]}]),
        "crosshair": chance.choice([None, vector()]),
        "wiper": chance.choice([None, {"filter": "linear", "at": chance.random()}]),
        "heat": chance.choice([True, False]),
    }
    if mode == "isosurface":
        made["options.isovalue"] = chance.uniform(-5, 5)
        made["options.color"] = shares(3)
    if mode == "composite":
        made["options.shading"] = chance.choice([True, False])
    return made


def random_event(chance: random.Random, width: float, height: float) -> dict[str, Any]:
    """A random user event."""
    kind = chance.choice(["pointer_down", *["pointer_move"] * 4, "pointer_up", "wheel", "key_down", "key_up", "double_click"])
    modifiers = [name for name in ("Shift", "Control", "Alt", "Pinch") if chance.random() < 0.1]
    made: dict[str, Any] = {"event_type": kind, "modifiers": modifiers}
    if kind.startswith("key"):
        keys = ["ArrowLeft", "ArrowUp", "PageDown", "Escape", "Home", "Shift", *"+-[],.xyzfrptlhiwcu123456q"]
        return made | {"key": chance.choice(keys)}
    made |= {"x": chance.uniform(-0.2, 1.2) * width, "y": chance.uniform(-0.2, 1.2) * height}
    if kind == "wheel":
        return made | {"dx": 0, "dy": chance.choice([-1, 1]) * chance.choice([3, 100, 2000])}
    if kind != "double_click":
        made |= {"button": chance.choice([1, 1, 2, 3])}
    return made
