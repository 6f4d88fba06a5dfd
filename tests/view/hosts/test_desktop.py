"""Windows: rendercanvas canvases show sessions, offscreen and with Qt without a display; and code shared by local hosts."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import clvol
from clvol.base.errors import MissingDependencyError, UnsupportedError
from clvol.device import Device
from clvol.view import View
from clvol.view.hosts import desktop
from clvol.view.hosts.local import LocalClient, decoded, scaled

SIDE = 16


def box() -> clvol.Volume:
    """It looks different when rotated."""
    data = np.zeros((SIDE,) * 3, np.float32)
    data[3:13, 5:9, 2:14] = 1
    data[10:13] *= 0.5
    return clvol.Volume(data)


def view_of(device: Device) -> View:
    return View(box(), mode="mip", filter="linear", device=device)


def until(what: Callable[[], Any], seconds: float = 60) -> Any:
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.01)
    return found


class Settling:
    """Collects pictures until they settle."""

    def __init__(self, client: LocalClient) -> None:
        self.client = client

    def picture(self, before: Any = None) -> Any:
        """The still picture; if a previous one is given, the first that differs."""

        def found() -> Any:
            picture = self.client.take()
            done = self.client.still and (before is None or picture.shape != before.shape or (picture != before).any())
            return (self.client.take(),) if done else None

        return until(found)[0]


# -- a client in this process ----------------------------------------------------------------------------------------


def test_the_final_picture_is_that_of_render(device: Device) -> None:
    view = view_of(device)
    client = LocalClient(view, lambda: None)
    try:
        client.resize(96, 64)
        still = Settling(client).picture()
        assert still.shape == (64, 96, 3)
        from clvol.show.picture import to_bytes

        expected = to_bytes(view.picture((96, 64))).astype(int)
        assert_array_equal(still, expected[..., :3] * expected[..., 3:] // 255)
        assert still.max() > 100
    finally:
        client.close()
    assert client.session.closed


def test_drags_and_keys_rotate_it_and_undo_reverts_them(device: Device) -> None:
    client = LocalClient(view_of(device), lambda: None)
    try:
        client.resize(64, 64)
        settling = Settling(client)
        first = settling.picture()
        direction = client.session.state.camera.direction
        client.event({"event_type": "pointer_down", "x": 32, "y": 32, "button": 1, "buttons": (1,), "modifiers": ()})
        client.event({"event_type": "pointer_move", "x": 52, "y": 36, "button": 0, "buttons": (1,), "modifiers": ()})
        client.event({"event_type": "pointer_up", "x": 52, "y": 36, "button": 1, "buttons": (), "modifiers": ()})
        until(lambda: client.session.state.camera.direction != direction)
        turned = settling.picture(first)
        assert np.abs(turned.astype(int) - first).max() > 50
        client.session.receive({"type": "do", "what": "undo"})
        until(lambda: client.session.state.camera.direction == direction)
        assert_array_equal(settling.picture(turned), first)
    finally:
        client.close()


def test_four_panes_are_in_one_picture(device: Device) -> None:
    client = LocalClient(view_of(device), lambda: None)
    try:
        client.resize(80, 61)
        first = Settling(client).picture()
        client.session.receive({"type": "set", "changes": {"layout": "linked"}})
        until(lambda: len(client._parts) == 4)
        still = Settling(client).picture(first)
        assert still.shape == (61, 80, 3)
        parts = [still[t : t + h, left : left + w] for left, t, w, h in client._parts.values()]
        assert sum(part[..., 0].size for part in parts) == 80 * 61  # they fill it
        assert all(part.max() > 60 for part in parts)
        assert all((part[part.shape[0] // 2].astype(int) @ [1, 0, -1] > 60).any() for part in parts[1:])  # the crosshair, amber
        # a wheel over a slice moves that slice
        before = client.session.state.crosshair
        left, top, width, height = client._parts["z"]
        client.event({"event_type": "wheel", "x": left + width / 2, "y": top + height / 2, "dx": 0, "dy": 100, "modifiers": ()})
        until(lambda: client.session.state.crosshair != before)
        moved = client.session.state.crosshair
        assert moved is not None
        assert moved[2] != box().center[2]
        assert_array_equal(moved[:2], box().center[:2])
    finally:
        client.close()


def test_pictures_are_scaled_by_the_linear_filter() -> None:
    ramp = np.repeat(np.arange(0, 200, 10, dtype=np.uint8)[None, :, None], 3, 2).repeat(6, 0)
    larger = scaled(ramp, (50, 9))
    assert larger.shape == (9, 50, 3)
    truth = np.clip((np.arange(50) + 0.5) * 20 / 50 - 0.5, 0, 19) * 10
    assert np.abs(larger[4, :, 0] - truth).max() <= 1
    assert_array_equal(scaled(ramp, (10, 3))[0, :, 0], np.arange(5, 200, 20))  # means of what is covered
    assert scaled(ramp[:1, :1], (7, 5)).shape == (5, 7, 3)
    assert scaled(ramp, (20, 6)) is not None
    assert_array_equal(scaled(ramp, (20, 6)), ramp)


def test_frames_are_blended_over_black() -> None:
    from clvol.view.drawing import png

    pixels = np.full((4, 5, 4), 200, np.uint8)
    pixels[0, :, 3] = 0
    assert_array_equal(decoded(png(pixels))[:2, 0], [[0, 0, 0], [156, 156, 156]])


# -- canvases ----------------------------------------------------------------------------------------------------------


def test_an_offscreen_canvas(device: Device) -> None:
    offscreen = pytest.importorskip("rendercanvas.offscreen")
    canvas = offscreen.RenderCanvas(size=(60, 40), pixel_ratio=2)
    window = desktop.DesktopWindow(view_of(device), canvas)
    try:
        assert np.asarray(canvas.draw()).shape == (80, 120, 4)

        def rests() -> bool:
            canvas.draw()
            return window.client.still

        until(rests)
        first = np.array(canvas.draw())
        assert first.shape == (80, 120, 4)
        assert first[..., 3].min() == 255
        assert first[..., :3].max() > 100
        canvas.submit_event({"event_type": "key_down", "key": "ArrowLeft", "modifiers": ()})
        canvas._process_events()
        until(lambda: (canvas.draw(), window.client.session.state.camera != view_of(device).state.camera)[1])
        until(lambda: rests() and np.abs(np.array(canvas.draw()).astype(int) - first).max() > 30)
        canvas.set_logical_size(50, 50)
        canvas.draw()
        until(rests)
        assert np.asarray(canvas.draw()).shape == (100, 100, 4)
    finally:
        window.close()
    assert window.client.session.closed
    assert canvas.get_closed()


_IN_QT = """
import sys, threading, time
import numpy as np
import clvol
from clvol.view import View
from clvol.view.hosts import desktop, local
made = []
class Kept(desktop.DesktopWindow):
    def __init__(self, *args):
        super().__init__(*args)
        made.append(self)
desktop.DesktopWindow = Kept
data = np.zeros((16, 16, 16), "f4"); data[4:12, 6:9, 2:14] = 1
view = View(clvol.Volume(data, name="bar"), mode="mip", filter="linear")
def drive():
    while not made: time.sleep(0.02)
    window = made[0]; client = window.client
    end = time.monotonic() + 100
    while not client.still and time.monotonic() < end: time.sleep(0.02)
    time.sleep(0.3)
    window._loop.call_soon_threadsafe(grab)
def grab():
    canvas = made[0]._canvas
    picture = canvas.grab().toImage()
    image = picture.convertToFormat(picture.Format.Format_RGB888)
    pixels = np.frombuffer(bytes(image.constBits()), "u1").reshape(image.height(), image.bytesPerLine())
    print("size", image.width(), image.height(), "brightest", pixels.max())
    print("title", canvas.windowTitle())
    picture.save(sys.argv[1])
    canvas.close()
threading.Thread(target=drive, daemon=True).start()
desktop.show_on_desktop(view, (120, 90))
print("closed", made[0].client.session.closed, flush=True)
"""


@pytest.mark.thorough
def test_a_window_of_qt(device: Device, tmp_path: Any) -> None:  # noqa: ARG001  # there is one
    pytest.importorskip("rendercanvas")
    env = os.environ | {"QT_QPA_PLATFORM": "offscreen", "PYTHONUTF8": "1"}
    code = "from PySide6 import QtWidgets"
    if subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, check=False).returncode:
        pytest.skip("PySide6 is not installed, or lacks libraries of the system")
    picture = tmp_path / "window.png"
    done = subprocess.run(
        [sys.executable, "-c", _IN_QT, str(picture)], capture_output=True, encoding="utf-8", timeout=120, check=False, env=env
    )
    assert "closed True" in done.stdout, done.stderr
    words = done.stdout.split()
    assert words[1:3] == ["120", "90"]
    assert int(words[4]) > 100
    assert "bar" in done.stdout


def test_a_missing_display_is_reported_before_qt_aborts(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(UnsupportedError, match="a window needs a display"):
        desktop.show_on_desktop(View(box()))


def test_a_missing_qt_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    for name in ("PySide6", "PySide6.QtWidgets", "PyQt6", "PyQt6.QtWidgets"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[desktop\]"'):
        desktop.show_on_desktop(View(box()))
