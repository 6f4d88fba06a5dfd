"""Handle Ctrl-C while the command imports, which takes a second, and while it exits: print one line, as `clvol.cli.main` does.

Import this first. It has no effect unless this process is the command.
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from types import FrameType, TracebackType

__all__ = ["at_the_end", "deferred", "excepthook", "is_the_command", "only_our_lines", "quiet"]


_apart = False  # whether `sys.stderr` writes to a copy of standard error


def is_the_command() -> bool:
    """Whether this process is the command ``clvol``, rather than a program that imports it."""
    started = getattr(sys, "orig_argv", [])
    as_module = any(pair == ("-m", "clvol") for pair in pairwise(started))
    script = started[1].replace("\\", "/").rpartition("/")[2] if len(started) > 1 else ""
    return as_module or script in ("clvol", "clvol.exe", "clvol-script.py")


def excepthook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """`sys.excepthook` of the command: on an interrupt, print one line and exit with code 130."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    _exit()


def at_the_end(code: int | None = None) -> None:
    """Before the command exits: have Ctrl-C end it at once, with one line, or with `code` if it has printed its line."""
    if is_the_command():
        import signal

        signal.signal(signal.SIGINT, _exit if code is None else lambda _, __: os._exit(code))


@contextmanager
def deferred() -> Iterator[None]:
    """A context at whose end Ctrl-C is handled: for native code that drops it, or aborts the process as pyopencl does on import."""
    import signal
    import threading

    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *what: came.append(what))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if came:
            handler(*came[0])


def only_our_lines() -> None:
    """Have the command's own lines go to a copy of standard error, so that `quiet` does not lose them."""
    global _apart
    if is_the_command() and not _apart:
        sys.stderr.flush()
        sys.stderr = open(  # noqa: SIM115  # until the process ends
            os.dup(2), "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors, closefd=False
        )
        _apart = True


@contextmanager
def quiet() -> Iterator[None]:
    """A context in which native libraries print nothing on standard error, if this process is the command.

    Compilers count their warnings there, and what fails when Ctrl-C removes their files.
    """
    if not _apart:
        yield
        return
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    os.close(nothing)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _ignore() -> None:
    import signal  # takes its time, in which there would be no `excepthook` yet

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _exit(number: int = 0, frame: FrameType | None = None) -> None:  # noqa: ARG001  # as handlers have them
    print("clvol: interrupted", file=sys.stderr, flush=True)
    os._exit(130)


if is_the_command():
    sys.excepthook = excepthook
    # it runs last, as it is the first; then the interpreter is taken down, where Python would restore the system's handler
    atexit.register(_ignore)
