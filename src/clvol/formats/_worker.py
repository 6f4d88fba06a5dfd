"""Reading in a process of its own what libraries of native code read, so that no file ends or hangs the caller's.

A process is started when it is first needed, by ``subprocess`` (so that scripts need no ``if __name__ == "__main__"``), and kept
for the next file; it is ended when a file ends it, when it takes too long, on an interrupt, and with this process.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Callable
from multiprocessing.connection import wait as ready
from pathlib import Path
from typing import Any

from clvol.base import errors
from clvol.base.checks import warn
from clvol.base.errors import ClvolWarning, FormatError
from clvol.formats._child import Request
from clvol.formats._limits import MORE, Budget
from clvol.formats._wire import WireError, receive, send

__all__ = ["call", "prepare"]

_STARTING = 120.0  # seconds for Python to start, and to import what the file needs: disks may sleep, networks stall
_TICK = 0.05  # seconds between looks at the clock
_WAITING = 0.1  # share of the time counted in which nothing is computed
_IDLE = 4  # processes that are kept
_ENDING = 2.0  # seconds
# The package without what its __init__ imports: a reader needs none of it.
_PROGRAM = """
import json, sys, types
sys.path[:], folder, modules = json.loads(sys.argv[1])
package = sys.modules["clvol"] = types.ModuleType("clvol")
package.__path__ = [folder]
from clvol.formats._child import serve
serve(modules)
"""

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
    """What `function` returns, called in another process.

    Parameters
    ----------
    function : callable
        Of a module; its arguments and options are pickled, its result is anything of `clvol.formats._wire.pack`.
    what : str
        What is being done, for errors: "read v.nrrd".
    reader : str
        What reads, for errors: "NRRD".
    modules : tuple of str
        That it will import.
    budget : Budget

    Raises
    ------
    FormatError
        The other process crashed, took too long or too much memory, or cannot be started.
    ClvolError
        As `function` raises it.
    """
    request = Request(function, arguments, what, budget, options or {}, modules, _folder())
    while True:
        worker, new = _taken(what)
        try:
            result = worker.ask(request, reader)
        except _EndedError as error:  # before it began
            worker.end()
            if new:
                raise FormatError(str(error)) from None
            continue  # somebody ended it while it waited
        except BaseException:  # an interrupt too
            worker.end()
            raise
        _keep(worker)
        return result()


def prepare(modules: tuple[str, ...]) -> None:
    """Start a process now for the next `call`, which need not wait then until it has imported these modules."""
    with contextlib.suppress(FormatError):  # whoever reads is told
        _keep(_Worker("start a reader", modules))


class _EndedError(Exception):
    """A process ended before it began to read."""


def _folder() -> str:
    try:
        return os.getcwd()  # noqa: PTH109  # a text, as it is sent
    except OSError:
        return ""


def _taken(what: str) -> tuple[_Worker, bool]:
    """A process that waits for work, or a new one, and whether it is."""
    with _lock:
        worker = _idle.pop() if _idle else None
    return (_Worker(what), True) if worker is None else (worker, False)


def _keep(worker: _Worker) -> None:
    with _lock:
        if not worker.spent and len(_idle) < _IDLE:
            _idle.append(worker)
            return
    worker.end()


@atexit.register
def _end_all() -> None:
    while _idle:
        _idle.pop().end()


def _forget_all() -> None:
    """In a forked child: the processes are the parent's."""
    global _lock
    _lock = threading.Lock()
    for worker in _all:
        worker.forget()
    _idle.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)


class _Worker:
    """A process that reads files for this one.

    Raises
    ------
    FormatError
        It cannot be started.
    """

    def __init__(self, what: str, modules: tuple[str, ...] = ()) -> None:
        ours, theirs = socket.socketpair()
        self._peer = ours
        try:
            if not sys.executable or getattr(sys, "frozen", False):
                raise OSError("this program is no Python that could be started again")
            self._process = subprocess.Popen(_command(modules), env=_environment(), stderr=subprocess.DEVNULL, **_separate(theirs))
            if sys.platform == "win32":
                _share(theirs, self._process)
        except (OSError, ValueError) as error:
            ours.close()
            raise FormatError(
                f"cannot {what}: its reader runs native code, in a process of its own that cannot be started "
                f"({error}); trusted=True reads in this one"
            ) from error
        finally:
            theirs.close()
        self.spent = False
        """Whether it must read no other file."""
        _all.add(self)

    def end(self) -> None:
        """Close and reap the process."""
        self._peer.close()
        with contextlib.suppress(OSError):
            self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDING)

    def forget(self) -> None:
        """Leave the process to whom it belongs."""
        self._peer.close()
        self._process.returncode = 0  # nothing is waited for

    def ask(self, request: Request, reader: str) -> Callable[[], Any]:
        """What gives the result of a request, or raises its error; the process is not needed for that.

        Raises
        ------
        FormatError
            The process ended, or is to be ended, for a limit.
        _EndedError
            It ended before it began.
        """
        clock = _Clock(self._process.pid)
        begun = False

        def wait() -> None:
            """Until something comes; or until the time is up."""
            while not ready([self._peer], _TICK):
                allowed = request.budget.seconds if begun else _STARTING
                if clock.spent(begun) > allowed:
                    raise TimeoutError(allowed)

        told: Any = ()
        try:
            send(self._peer, "request", [pickle.dumps(request)])
            while True:
                name, value = receive(self._peer, wait)
                if name == "begun":
                    clock, begun = _Clock(self._process.pid), True
                elif name == "announced":
                    request.budget.samples = min(int(value), request.budget.room)
                elif name == "told":
                    *told, self.spent = value
                elif name in ("result", "error"):
                    return lambda: _delivered(name, value, told)
        except TimeoutError as error:
            raise FormatError(self._late(request, reader, begun, float(error.args[0]))) from None
        except (EOFError, ConnectionError):
            raise (FormatError if begun else _EndedError)(self._crash(request, reader, begun)) from None
        except (WireError, TypeError, ValueError, MemoryError) as error:
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

    def _crash(self, request: Request, reader: str, begun: bool) -> str:
        try:
            code = self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            code = 0
        how = _ending(code)
        if not begun:
            return f"cannot {request.what}: the process that reads it did not start ({how}); trusted=True reads in this one"
        return f"cannot {request.what}: the reader of {reader} crashed ({how}): the file is damaged or hostile"


class _Clock:
    """How long a process has worked: the time that it waits counts little, so that no sound file fails on a slow disk."""

    def __init__(self, pid: int) -> None:
        self._stat = Path(f"/proc/{pid}/stat")
        self._wall, self._busy = time.monotonic(), self._computed()

    def spent(self, waiting_counts_little: bool) -> float:
        wall, busy = time.monotonic() - self._wall, self._computed()
        if not waiting_counts_little or busy is None or self._busy is None:
            return wall
        worked = min(wall, busy - self._busy)
        return worked + _WAITING * (wall - worked)

    def _computed(self) -> float | None:
        """Seconds on any core."""
        try:
            user, system = self._stat.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[11:13]
            return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError):
            return None


def _delivered(name: str, value: Any, told: Any) -> Any:
    """Warn and log as the other process did, then raise or return as it did."""
    warned, logged = told
    for logger, level, text in logged:
        where = logging.getLogger(str(logger))
        if where.isEnabledFor(level):
            where.handle(where.makeRecord(where.name, level, "", 0, "%s", (text,), None))
    for category, text, file, line in warned:
        if category == ClvolWarning.__name__:
            warn(str(text))
        else:
            kind = _CATEGORIES.get(category, UserWarning)
            warnings.warn_explicit(str(text), kind, str(file), int(line))
    if name == "result":
        return value
    kind, text = value
    raise _ERRORS.get(kind, FormatError)(str(text))


_CATEGORIES = {kind.__name__: kind for kind in (RuntimeWarning, DeprecationWarning, FutureWarning, ResourceWarning, SyntaxWarning)}
_ERRORS = {name: getattr(errors, name) for name in errors.__all__ if name not in ("AxisError", "ClvolWarning")}


def _ending(code: int) -> str:
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{name}, as systems do where memory runs out" if name == "SIGKILL" else name
    return f"exit code {code:#x}" if code > 255 else f"exit code {code}"


# -- starting ------------------------------------------------------------------------------------------------------


def _command(modules: tuple[str, ...]) -> list[str]:
    own = sys.flags
    flags = {"-E": own.ignore_environment, "-s": own.no_user_site, "-S": own.no_site, "-I": own.isolated}
    paths = [path or _folder() for path in sys.path if isinstance(path, str)]
    given = json.dumps([paths, str(Path(__file__).parents[1]), modules])
    return [sys.executable, *(flag for flag, on in flags.items() if on), "-P", "-c", _PROGRAM, given]


def _environment() -> dict[str, str]:
    """That of this process; NumPy's threads for linear algebra, of which a reader has none, would take time and memory."""
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1"}


def _separate(theirs: socket.socket) -> dict[str, Any]:
    """Out of the reach of the terminal's Ctrl-C."""
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
        return {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "creationflags": flags}
    return {"stdin": theirs.fileno(), "stdout": subprocess.DEVNULL, "start_new_session": True}


def _share(theirs: socket.socket, process: subprocess.Popen[bytes]) -> None:
    """Hand a socket to a process of Windows, which inherits none."""
    if sys.platform == "win32" and process.stdin is not None:
        told = theirs.share(process.pid)
        process.stdin.write(len(told).to_bytes(2, "big") + told)
        process.stdin.close()
