"""The child process: `serve` reads files for its parent (`worker`) until that is gone.

A library may end this process, or never return: neither harms the parent.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from clvol.base import errors
from clvol.base.errors import ClvolError, FormatError
from clvol.formats._errors import foreign_errors
from clvol.formats.guarded.limits import MORE, Budget, limited
from clvol.formats.guarded.messages import send, share_samples

__all__ = ["Request", "serve"]

_ALLOCATION = ("alloc", "memory")  # words of a library that is refused memory
_GIVEN_UP = (RuntimeError, MemoryError)  # what native code raises when it gives up
_MIB = 1 << 20
_STACK = 2 * _MIB


@dataclass
class Request:
    """What to read, and how: a function of a module, with what it is called with."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    what: str  # is being done, for errors: "read v.nrrd"
    budget: Budget
    options: dict[str, Any] = field(default_factory=dict)  # of the function
    modules: tuple[str, ...] = ()  # to import before the clock starts
    folder: str = ""  # the caller's working folder, for relative names


def serve(modules: Sequence[str] = ()) -> None:
    """Import modules, then answer requests that arrive by standard input, a socket, until it closes."""
    peer = _peer()
    _isolate()
    share_samples()
    _import(modules)
    while True:
        try:
            request = peer.recv()  # unpickled: the parent may say anything
        except (EOFError, OSError):
            os._exit(0)
        _answer(peer, request)


def _answer(peer: Connection, request: Request) -> None:
    """Send "begun", "announced" whenever samples are announced, and "done" with warnings, log records, and result or error."""
    with contextlib.suppress(OSError):  # if the folder is gone, so are the files
        os.chdir(request.folder)
    _import(request.modules)
    before, budget, records = _data(), request.budget, _Records()

    def announced(needed: int) -> None:
        _limit_memory(before + budget.memory)
        send(peer, "announced", needed)

    budget.callback = announced
    send(peer, "begun", None)
    _limit_memory(before + budget.memory)
    logging.getLogger().addHandler(records)
    answer: dict[str, Any] = {"retire": False}
    with warnings.catch_warnings(record=True) as warned, _dying_with(peer):
        warnings.simplefilter("always")
        try:
            with limited(budget), foreign_errors(request.what):
                answer["result"] = request.function(*request.arguments, **request.options)
        except BaseException as error:
            answer["error"] = _described(error, request)
            # the next file must not meet what a library that gave up has left behind
            answer["retire"] = isinstance(error, _GIVEN_UP) or isinstance(error.__cause__, _GIVEN_UP)
    logging.getLogger().removeHandler(records)
    _limit_memory(None)
    os.chdir(os.sep)  # hold no folder that somebody may want to unmount or remove
    answer["warned"] = [(one.category.__name__, str(one.message), one.filename, one.lineno) for one in warned]
    answer["logged"] = records.kept
    send(peer, "done", answer)


def _import(modules: Sequence[str]) -> None:
    for module in modules:
        with contextlib.suppress(Exception):  # the reader that needs it says what is missing
            import_module(module)


class _Records(logging.Handler):
    """Log records of libraries, for the parent to log."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.kept: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.kept.append((record.name, record.levelno, record.getMessage()))


def _described(error: BaseException, request: Request) -> tuple[str, str]:
    """Class and text of the error that the parent will raise."""
    text = str(error)
    cause = f"{error.__cause__}".lower()
    foreign = not isinstance(error, ClvolError)
    if (isinstance(error, MemoryError) and foreign) or (
        isinstance(error, FormatError) and any(word in cause for word in _ALLOCATION)
    ):
        text = (
            f"cannot {request.what}: its reader must take at most {request.budget.memory // _MIB} MiB of memory, "
            f"for {request.budget.samples} bytes of samples, and asked for more: the file is damaged or hostile; {MORE}"
        )
        return FormatError.__name__, text
    if foreign:
        return FormatError.__name__, f"cannot {request.what}: {text or type(error).__name__}"
    return next(kind.__name__ for kind in type(error).__mro__ if kind.__name__ in errors.__all__), text


# -- the process ---------------------------------------------------------------------------------------------------


def _peer() -> Connection:
    """The connection to the parent: standard input; on Windows, the socket that is described there."""
    if sys.platform == "win32":
        length = int.from_bytes(sys.stdin.buffer.read(2), "big")
        return Connection(socket.fromshare(sys.stdin.buffer.read(length)).detach())
    return Connection(os.dup(0))


def _isolate() -> None:
    """Leave the terminal alone, in both directions, and volunteer to be killed first if the system runs out of memory.

    Small stacks let libraries have many threads within the limit on memory, whatever ``ulimit -s`` says.
    """
    threading.stack_size(_STACK)
    null = os.open(os.devnull, os.O_RDWR)
    for fd in (0, 1, 2):
        os.dup2(null, fd)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def _data() -> int:
    """Bytes of private memory of this process; 0 if the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def _limit_memory(nbytes: int | None) -> None:
    """Limit the private memory of this process, on Linux; None lifts the limit."""
    if sys.platform != "linux":
        return
    import resource

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    unlimited = resource.RLIM_INFINITY
    soft = hard if nbytes is None else nbytes if hard == unlimited else min(nbytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@contextlib.contextmanager
def _dying_with(peer: Connection) -> Iterator[None]:
    """Have the system end this process when the parent's end of the socket closes, whatever a library is doing."""
    if sys.platform != "linux":
        yield
        return
    import fcntl

    fd = peer.fileno()
    flags = fcntl.fcntl(fd, fcntl.F_GETFL)
    fcntl.fcntl(fd, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(fd, fcntl.F_SETFL, flags | os.O_ASYNC)  # SIGIO ends a process
    try:
        yield
    finally:
        fcntl.fcntl(fd, fcntl.F_SETFL, flags)
