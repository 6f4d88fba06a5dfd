"""Our side of reading in a child process: no file may end or hang the process that asks for it.

A child is started when it is first needed and kept for the next file. It ends if a file crashes it, if it takes too long, on
Ctrl-C, and with this process. `subprocess` starts it: `multiprocessing` would import the caller's script again, which would then
need ``if __name__ == "__main__"``.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from clvol.base import errors
from clvol.base.checks import warn
from clvol.base.errors import ClvolWarning, FormatError
from clvol.formats.guarded.child import Request
from clvol.formats.guarded.limits import MORE, Budget
from clvol.formats.guarded.messages import MessageError, receive

__all__ = ["call", "prepare"]

_STARTING = 120.0  # seconds for Python to start and import what the file needs: disks may sleep, networks stall
_TICK = 0.05  # seconds from one look at the clock to the next
_WAITING = 0.1  # share of the time without computing that counts
_IDLE = 4  # children kept for the next file
_ENDING = 2.0  # seconds for a child to end
_PROGRAM = """
import json, sys
sys.path[:], modules = json.loads(sys.argv[1])
from clvol.formats.guarded.child import serve
serve(modules)
"""
_CATEGORIES = {kind.__name__: kind for kind in (RuntimeWarning, DeprecationWarning, FutureWarning, ResourceWarning, SyntaxWarning)}
_ERRORS = {name: getattr(errors, name) for name in errors.__all__ if name not in ("AxisError", "ClvolWarning")}

_idle: list[_Worker] = []
_all: weakref.WeakSet[_Worker] = weakref.WeakSet()
_lock = threading.Lock()


def call(
    function: Callable[..., Any],
    *arguments: Any,
    what: str,
    reader: str,
    modules: tuple[str, ...],
    budget: Budget,
    options: dict[str, Any] | None = None,
) -> Any:
    """What `function` of a module returns in a child process that imports `modules` before the clock starts.

    `what` is done ("read v.nrrd"), and by which `reader` ("NRRD"), for errors. Arguments are pickled; the result is anything that
    `messages.pack` takes. A child that crashes, takes too long or too much memory, or cannot be started, is a `FormatError`; errors
    of clvol that `function` raises keep their class.
    """
    request = Request(function, arguments, what, budget, options or {}, modules, _folder())
    while True:
        with _lock:
            worker = _idle.pop() if _idle else None
        new = worker is None
        worker = worker or _Worker(what)
        try:
            answer = worker.ask(request, reader)
        except _EndedError as error:
            worker.end()
            if new:
                raise FormatError(str(error)) from None
            continue  # somebody ended it while it was idle
        except BaseException:  # Ctrl-C too
            worker.end()
            raise
        _keep(worker, bool(answer.get("retire")))
        return _delivered(answer)


def prepare(modules: tuple[str, ...]) -> None:
    """Start a child that imports these modules, so that the next `call` need not wait for that."""
    with contextlib.suppress(FormatError):  # `call` will say it
        _keep(_Worker("start a reader", modules))


def _folder() -> str:
    try:
        return os.getcwd()  # noqa: PTH109  # a str, as it is sent
    except OSError:
        return ""


def _keep(worker: _Worker, retire: bool = False) -> None:
    with _lock:
        if not retire and len(_idle) < _IDLE:
            _idle.append(worker)
            return
    worker.end()


@atexit.register
def _end_all() -> None:
    while _idle:
        _idle.pop().end()


def _disown_all() -> None:
    """After a fork, in the forked process: the children are its parent's."""
    global _lock
    _lock = threading.Lock()
    for worker in _all:
        worker.disown()
    _idle.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown_all)


class _EndedError(Exception):
    """A child ended before it began to read."""


class _Worker:
    """A child process that reads files."""

    def __init__(self, what: str, modules: tuple[str, ...] = ()) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                if not sys.executable or getattr(sys, "frozen", False):
                    raise OSError("this program is no Python that could be started again")
                self._process = _started(theirs, modules)
            except (OSError, ValueError) as error:
                ours.close()
                raise FormatError(
                    f"cannot {what}: its reader runs native code, in a process of its own that cannot be started "
                    f"({error}); trusted=True reads in this one"
                ) from error
        self._peer = Connection(ours.detach())
        _all.add(self)

    def end(self) -> None:
        """Close the connection; end and reap the process."""
        self._peer.close()
        with contextlib.suppress(OSError):
            self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDING)

    def disown(self) -> None:
        """Leave the process to its parent."""
        self._peer.close()
        self._process.returncode = 0  # never waited for

    def ask(self, request: Request, reader: str) -> dict[str, Any]:
        """The child's answer to a request; `_EndedError` if it ended before it began."""
        clock = _Clock(self._process.pid)
        begun = False

        def wait() -> None:
            while not self._peer.poll(_TICK):
                allowed = request.budget.seconds if begun else _STARTING
                if clock.spent(begun) > allowed:
                    raise TimeoutError(allowed)

        try:
            self._peer.send(request)
            while True:
                name, value = receive(self._peer, wait)
                if name == "begun":
                    clock, begun = _Clock(self._process.pid), True
                elif name == "announced":
                    request.budget.samples = min(int(value), request.budget.room)
                elif name == "done":
                    return dict(value)
        except TimeoutError as error:
            raise FormatError(self._late(request, reader, begun, float(error.args[0]))) from None
        except (EOFError, ConnectionError):
            raise (FormatError if begun else _EndedError)(self._crashed(request, reader, begun)) from None
        except (MessageError, TypeError, ValueError, MemoryError) as error:
            raise FormatError(
                f"cannot {request.what}: the reader of {reader} answered nonsense ({error}): the file is damaged or hostile"
            ) from None

    def _late(self, request: Request, reader: str, begun: bool, allowed: float) -> str:
        if not begun:
            late = f"the process that reads it did not start within {allowed:g} s"
            return f"cannot {request.what}: {late}; trusted=True reads in this one"
        return (
            f"cannot {request.what}: the reader of {reader} must be done within {allowed:.3g} s (Limits.seconds) and was not: "
            f"the file is damaged or hostile; {MORE}"
        )

    def _crashed(self, request: Request, reader: str, begun: bool) -> str:
        try:
            code = self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            code = 0
        how = _described(code)
        if not begun:
            return f"cannot {request.what}: the process that reads it did not start ({how}); trusted=True reads in this one"
        return f"cannot {request.what}: the reader of {reader} crashed ({how}): the file is damaged or hostile"


class _Clock:
    """The time a child has worked. Time that it waits counts little, so that no sound file fails on a slow disk."""

    def __init__(self, pid: int) -> None:
        self._stat = Path(f"/proc/{pid}/stat")
        self._wall, self._busy = time.monotonic(), self._computed()

    def spent(self, discount_waiting: bool) -> float:
        wall, busy = time.monotonic() - self._wall, self._computed()
        if not discount_waiting or busy is None or self._busy is None:
            return wall
        worked = min(wall, busy - self._busy)
        return worked + _WAITING * (wall - worked)

    def _computed(self) -> float | None:
        """CPU seconds on all cores."""
        try:
            user, system = self._stat.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[11:13]
            return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError):
            return None


def _delivered(answer: dict[str, Any]) -> Any:
    """Warn and log as the child did, then return or raise as it did."""
    for logger, level, text in answer["logged"]:
        target = logging.getLogger(str(logger))
        if target.isEnabledFor(level):
            target.handle(target.makeRecord(target.name, level, "", 0, "%s", (text,), None))
    for category, text, file, line in answer["warned"]:
        if category == ClvolWarning.__name__:
            warn(str(text))
        else:
            warnings.warn_explicit(str(text), _CATEGORIES.get(category, UserWarning), str(file), int(line))
    if "error" not in answer:
        return answer["result"]
    kind, text = answer["error"]
    raise _ERRORS.get(kind, FormatError)(str(text))


def _described(code: int) -> str:
    """An exit code, for people."""
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{name}, as systems do where memory runs out" if name == "SIGKILL" else name
    return f"exit code {code:#x}" if code > 255 else f"exit code {code}"


# -- starting ------------------------------------------------------------------------------------------------------


def _started(theirs: socket.socket, modules: tuple[str, ...]) -> subprocess.Popen[bytes]:
    """A child with its end of the socket as standard input, out of reach of the terminal's Ctrl-C."""
    mine = sys.flags
    flags = {"-E": mine.ignore_environment, "-s": mine.no_user_site, "-S": mine.no_site, "-I": mine.isolated}
    paths = [path or _folder() for path in sys.path if isinstance(path, str)]
    program = [*(flag for flag, on in flags.items() if on), "-P", "-c", _PROGRAM, json.dumps([paths, modules])]
    options: dict[str, Any] = {
        "env": {**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # threads that a reader never uses would take time and memory
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    if sys.platform != "win32":
        return subprocess.Popen([sys.executable, *program], stdin=theirs.fileno(), start_new_session=True, **options)
    alone = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    process = subprocess.Popen([sys.executable, *program], stdin=subprocess.PIPE, creationflags=alone, **options)
    assert process.stdin is not None
    shared = theirs.share(process.pid)  # Windows inherits no sockets
    process.stdin.write(len(shared).to_bytes(2, "big") + shared)
    process.stdin.close()
    return process
