"""A view in a terminal: two pixels per character, as half blocks in 24-bit colours; keys turn it, ``q`` quits.

Plain ANSI sequences, which work over ssh and need no library. Only rows that changed are written.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clvol.base.printable import printable
from clvol.show.picture import to_bytes
from clvol.view.drawing import opaque
from clvol.view.hosts.local import LocalClient, scaled

if TYPE_CHECKING:
    from clvol.view import View

__all__ = ["ansi", "keys_of", "show_in_terminal"]

_FINER = 2  # pixels drawn for one shown, along each axis
_OPEN, _CLOSE = "\x1b[?1049h\x1b[?25l\x1b[2J", "\x1b[0m\x1b[?25h\x1b[?1049l"  # to the alternate screen without cursor, and back
_HELP = "q quit  arrows turn  +/- zoom  1-7 mode  f fit  u undo"
_KEYS = {
    "\x1b[A": "ArrowUp", "\x1b[B": "ArrowDown", "\x1b[C": "ArrowRight", "\x1b[D": "ArrowLeft",
    "\x1bOA": "ArrowUp", "\x1bOB": "ArrowDown", "\x1bOC": "ArrowRight", "\x1bOD": "ArrowLeft",
    "\x1b[5~": "PageUp", "\x1b[6~": "PageDown", "\x1b": "Escape",
}  # fmt: skip
_SEQUENCE = re.compile(r"\x1b\[[0-9;]*[ -/]*[@-~]|\x1bO.|.", re.DOTALL)
_BEGUN = re.compile(rb"\x1b(\[[0-9;]*[ -/]*|O)?$")
_PIECES = 0.05  # seconds to wait for the rest of a sequence; then it is Escape alone
_QUIT = ("q", "Q", "\x03", "\x04")
_TICK = 0.25  # seconds between checks of the terminal's size
_LONGEST = 400  # characters along an edge


def show_in_terminal(
    view: View, stdin: IO[str] | None = None, stdout: IO[str] | None = None, size: tuple[int, int] | None = None
) -> None:
    """Show a view in the terminal until ``q``; a still picture if stdin or stdout is no terminal, or on Windows.
    By default in the process's own terminal; `size` is (columns, lines).
    """
    stdin, stdout = stdin or sys.stdin, stdout or sys.stdout
    if not _typed(stdin, stdout):
        columns, lines = _size(size)
        # no higher than wide, because it scrolls with the text
        width, height = columns, min(2 * (lines - 1), columns)
        picture = np.asarray(to_bytes(view.picture((_FINER * width, _FINER * height))))
        stdout.write(ansi(scaled(opaque(picture), (width, height))) + "\n")
        stdout.flush()
        return
    _Shown(view, stdin, stdout, size).run()


class _Shown:
    """A view in a terminal with a keyboard."""

    def __init__(self, view: View, stdin: IO[str], stdout: IO[str], size: tuple[int, int] | None) -> None:
        self._stdin, self._stdout, self._given = stdin, stdout, size
        self._reader, self._writer = os.pipe()  # wakes the loop
        os.set_blocking(self._writer, False)
        self._rows: list[str] = []
        self._pipe_lock = threading.Lock()
        self._client = LocalClient(view, self._wake, pointer=False)

    def run(self) -> None:
        """Until ``q``, Ctrl-C, or the terminal is gone."""
        import select

        terminal = self._stdin.fileno()
        try:
            with _raw(terminal), self._screen():
                while True:
                    self._fit()
                    ready, _, _ = select.select([terminal, self._reader], [], [], _TICK)
                    if terminal in ready and not self._typed(_read(terminal)):
                        return
                    if self._reader in ready:
                        os.read(self._reader, 1024)
                        self._show()
                    if self._client.session.closed:
                        return
        except KeyboardInterrupt:
            return
        finally:
            self._client.close()
            with self._pipe_lock:
                os.close(self._reader)
                os.close(self._writer)
                self._writer = -1

    def _wake(self) -> None:
        """From the session's thread."""
        with self._pipe_lock:
            if self._writer >= 0:
                with contextlib.suppress(BlockingIOError):  # it is full: the loop will wake
                    os.write(self._writer, b".")

    @contextmanager
    def _screen(self) -> Iterator[None]:
        try:
            self._write(_OPEN)
            yield
        finally:
            self._write(_CLOSE)

    def _fit(self) -> None:
        columns, lines = _size(self._given)
        width, height = _FINER * columns, _FINER * 2 * (lines - 1)
        if self._client.size != (width, height):
            self._rows = []
            self._client.resize(width, height)

    def _typed(self, typed: bytes) -> bool:
        """Handle keys; returns False to quit."""
        if not typed:
            return False
        for key in keys_of(typed.decode("utf-8", "replace")):
            if key in _QUIT:
                return False
            for kind in ("key_down", "key_up"):  # a terminal does not report releases
                self._client.event({"event_type": kind, "key": key, "modifiers": ()})
        return True

    def _show(self) -> None:
        """Write the rows that changed, and the status line."""
        pixels = self._client.take()
        if not pixels.size:
            return
        columns, lines = pixels.shape[1] // _FINER, pixels.shape[0] // (2 * _FINER)
        rows = ansi(scaled(pixels, (columns, 2 * lines))).split("\n")
        words = self._client.text or f"{_HELP}  {self._client.title}"
        rows.append(f"\x1b[0m{printable(words)[:columns].ljust(columns)}")
        known = self._rows if len(self._rows) == len(rows) else [""] * len(rows)
        self._rows = rows
        self._write("".join(f"\x1b[{i + 1};1H{row}" for i, row in enumerate(rows) if row != known[i]))

    def _write(self, text: str) -> None:
        self._stdout.write(text)
        self._stdout.flush()


def ansi(pixels: NDArray[np.uint8]) -> str:
    """A picture, (height, width, 3), as lines of text: each character has a pixel above and one below."""
    upper, lower = pixels[::2], pixels[1::2]
    if len(lower) < len(upper):
        lower = np.concatenate([lower, np.zeros_like(upper[:1])])
    lines = []
    for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
        parts, front, back = [], None, None
        for one, two in zip(above, below, strict=True):
            if one != front:
                parts.append(f"\x1b[38;2;{one[0]};{one[1]};{one[2]}m")
            if two != back:
                parts.append(f"\x1b[48;2;{two[0]};{two[1]};{two[2]}m")
            front, back = one, two
            parts.append("▀")
        lines.append("".join(parts) + "\x1b[0m")
    return "\n".join(lines)


def _read(terminal: int) -> bytes:
    """What was typed; a sequence that arrives in pieces is completed."""
    import select

    typed = os.read(terminal, 1024)
    while _BEGUN.search(typed) and select.select([terminal], [], [], _PIECES)[0]:
        more = os.read(terminal, 1024)
        if not more:
            break
        typed += more
    return typed


def keys_of(typed: str) -> Iterator[str]:
    """The keys that a terminal sends, by their names in events; other sequences are dropped."""
    for sequence in _SEQUENCE.findall(typed):
        if sequence in _KEYS:
            yield _KEYS[sequence]
        elif len(sequence) == 1:
            yield sequence


@contextmanager
def _raw(terminal: int) -> Iterator[None]:
    """Read each key at once, without echo; Ctrl-C still interrupts."""
    import termios
    import tty

    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _typed(stdin: IO[str], stdout: IO[str]) -> bool:
    try:
        import termios  # noqa: F401  # Windows has none
    except ImportError:
        return False
    return stdin.isatty() and stdout.isatty()


def _size(given: tuple[int, int] | None) -> tuple[int, int]:
    columns, lines = given or shutil.get_terminal_size()
    return min(_LONGEST, max(8, columns)), min(_LONGEST, max(5, lines))
