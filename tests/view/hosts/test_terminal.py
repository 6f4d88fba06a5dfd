"""Terminal views: output to a pseudo-terminal is decoded to a picture."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

import clvol
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import View
from clvol.view.hosts.local import scaled
from clvol.view.hosts.terminal import _read, ansi, keys_of, show_in_terminal
from tests.view.threads import sessions, wait_for_sessions

_CODE = re.compile(r"\x1b\[(?:(\d+);(\d+)H|([34]8);2;(\d+);(\d+);(\d+)m|0m|\?\d+[hl]|2J)")


def view_of(device: Device) -> View:
    data = np.zeros((16, 16, 16), np.float32)
    data[4:12, 6:9, 2:14] = 1
    return View(clvol.Volume(data, name="bar\x1b[9J"), mode="mip", filter="linear", device=device)


def seen(text: str, columns: int, rows: int) -> tuple[NDArray[Any], list[str]]:
    """The picture that a terminal shows, and its lines of text; only allowed escape sequences are accepted."""
    pixels, lines = np.zeros((2 * rows, columns, 3), int), [[" "] * columns for _ in range(rows)]
    x = y = at = 0
    front, back = (255, 255, 255), (0, 0, 0)
    while at < len(text):
        if text[at] == "\x1b":
            code = _CODE.match(text, at)
            assert code, repr(text[at : at + 20])
            at = code.end()
            if code[1]:
                y, x = int(code[1]) - 1, int(code[2]) - 1
            elif code[3]:
                color = (int(code[4]), int(code[5]), int(code[6]))
                front, back = (color, back) if code[3] == "38" else (front, color)
            continue
        if text[at] in "\r\n":
            x, y = (0, y + 1) if text[at] == "\n" else (x, y)
        else:
            if text[at] == "▀":
                pixels[2 * y, x], pixels[2 * y + 1, x] = front, back
            lines[y][x] = text[at]
            x += 1
        at += 1
    return pixels, ["".join(line) for line in lines]


def test_half_blocks_encode_two_pixels() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (6, 5, 3), np.uint8)
    picture[2:4, 1:4] = 7
    text = ansi(picture)
    assert_array_equal(seen(text, 5, 3)[0], picture)
    assert text.count("▀") == 15
    assert ansi(np.zeros((2, 300, 3), np.uint8)).count("\x1b") == 3  # each colour is set once
    assert_array_equal(seen(ansi(picture[:5]), 5, 3)[0][:5], picture[:5])


@pytest.mark.skipif(sys.platform == "win32", reason="select takes no pipes there")
def test_a_key_that_comes_in_pieces_is_one() -> None:
    reader, writer = os.pipe()
    for pieces, keys in (
        ((b"\x1b", b"[", b"C"), ["ArrowRight"]),
        ((b"\x1b",), ["Escape"]),
        ((b"a\x1bO", b"Bb"), ["a", "ArrowDown", "b"]),
    ):
        late = threading.Thread(target=lambda rest=pieces[1:]: [(time.sleep(0.01), os.write(writer, piece)) for piece in rest])
        os.write(writer, pieces[0])
        late.start()
        assert list(keys_of(_read(reader).decode())) == keys
        late.join()
    os.close(reader)
    os.close(writer)


def test_keys() -> None:
    assert list(keys_of("\x1b[A\x1bOB+q\x1b[6~\x1b[1;5C\x1bx")) == ["ArrowUp", "ArrowDown", "+", "q", "PageDown", "Escape", "x"]
    assert list(keys_of("\x1b")) == ["Escape"]


def test_a_single_still_picture_without_a_tty(device: Device) -> None:
    view, out = view_of(device), io.StringIO()
    show_in_terminal(view, io.StringIO(), out, (40, 12))
    pixels = to_bytes(view.picture((80, 44))).astype(int)
    over_black = (pixels[..., :3] * pixels[..., 3:] // 255).astype(np.uint8)
    assert_array_equal(seen(out.getvalue(), 40, 12)[0][:22], scaled(over_black, (40, 22)))
    assert over_black.max() > 100


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals of POSIX")
def test_arrows_rotate_it_and_q_quits(device: Device) -> None:
    import pty
    import termios

    earlier = sessions()
    ours, theirs = pty.openpty()
    terminal = os.fdopen(theirs, "r+b", buffering=0)
    before = termios.tcgetattr(theirs)
    text, lock = [b""], threading.Lock()

    def read() -> None:
        while True:
            try:
                some = os.read(ours, 1 << 16)
            except OSError:
                return
            with lock:
                text[0] += some

    def shown() -> tuple[NDArray[Any], list[str]]:
        with lock:
            whole = text[0].decode("utf-8", "ignore")  # the last character may be half there
        return seen(re.sub(r"\x1b(\[[^a-zA-Z]*)?$", "", whole), 90, 12)

    def rests() -> NDArray[Any]:
        end, last = time.monotonic() + 60, None
        while time.monotonic() < end:
            picture = shown()[0]
            if last is not None and picture.max() > 60 and np.array_equal(picture, last):
                return picture
            last = picture
            time.sleep(0.7)
        raise AssertionError("nothing came")

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    wrapped = io.TextIOWrapper(terminal, encoding="utf-8", write_through=True)
    output = io.TextIOWrapper(os.fdopen(os.dup(theirs), "wb", buffering=0), encoding="utf-8", write_through=True)
    host = threading.Thread(target=show_in_terminal, args=(view_of(device), wrapped, output, (90, 12)), daemon=True)
    host.start()
    first = rests()
    os.write(ours, b"\x1b[C\x1b[C\x1b[A")
    end = time.monotonic() + 60
    while np.abs(shown()[0] - first).max() < 50:
        assert time.monotonic() < end, "it does not turn"
        time.sleep(0.1)
    assert "q quit" in shown()[1][-1]
    assert r"bar\x1b[9J" in shown()[1][-1]  # the name has no power over the terminal
    os.write(ours, b"q")
    host.join(30)
    assert not host.is_alive()
    assert termios.tcgetattr(theirs) == before
    time.sleep(0.2)
    assert text[0].endswith(b"\x1b[0m\x1b[?25h\x1b[?1049l")
    wait_for_sessions(0, earlier)


def test_the_command() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "clvol", "view", "phantom:box", "--terminal", "--mode", "mip"],
        capture_output=True, timeout=120, check=False, stdin=subprocess.DEVNULL, env=os.environ | {"COLUMNS": "30", "LINES": "10"},
    )  # fmt: skip
    assert shown.returncode == 0, shown.stderr.decode()
    assert seen(shown.stdout.decode(), 30, 10)[0].max() > 100
    both = subprocess.run(
        [sys.executable, "-m", "clvol", "view", "phantom:box", "--terminal", "--desktop"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert both.returncode != 0
    assert "give one of --terminal, --desktop and --serve" in both.stderr
