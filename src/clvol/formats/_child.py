"""What runs in a process that reads files for another: `serve`, until the other one is gone.

Its parent is `clvol.formats._worker`. A library may end this process, or never return: neither harms the parent.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from clvol.base import errors
from clvol.base.errors import ClvolError, FormatError
from clvol.formats._files import foreign_errors
from clvol.formats._limits import MORE, Budget, limited
from clvol.formats._wire import receive, send, share_samples

__all__ = ["Request", "serve"]

_ALLOCATION = ("alloc", "memory")  # in what libraries say where they get none
_GIVEN_UP = (RuntimeError, MemoryError)  # with which native code says so
_MIB = 1 << 20
_STACK = 2 * _MIB


@dataclass
class Request:
    """What is to be read, and how.

    Parameters
    ----------
    function : callable
        A function of a module, which this process imports.
    arguments : tuple
    options : dict
        Of `function`.
    what : str
        What is being done, for errors: "read v.nrrd".
    modules : tuple of str
        That it will import: before the clock runs.
    folder : str
        The working folder of the caller, for names that are relative to it.
    budget : Budget
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    what: str
    budget: Budget
    options: dict[str, Any] = field(default_factory=dict)
    modules: tuple[str, ...] = ()
    folder: str = ""


def serve(modules: Sequence[str] = ()) -> None:
    """Answer requests that come by standard input, a socket, until it closes; these modules are imported before."""
    peer = _peer()
    _harmless()
    share_samples()
    _import(modules)
    while True:
        try:
            _, request = receive(peer, lambda: None)
        except (EOFError, OSError):
            os._exit(0)
        _answer(peer, pickle.loads(request))  # of our parent, which may say anything


def _answer(peer: socket.socket, request: Request) -> None:
    """Do what is asked, and tell how it ended: what it warned of and logged, and whether to go on; the result or the error."""
    with contextlib.suppress(OSError):  # it is gone: names that are relative to it are too
        os.chdir(request.folder)
    _import(request.modules)
    before, budget, records = _data(), request.budget, _Records()

    def announced(needed: int) -> None:
        _hold(before + budget.memory)
        send(peer, "announced", [needed])

    budget.told = announced
    send(peer, "begun", [None])
    _hold(before + budget.memory)
    logging.getLogger().addHandler(records)
    with warnings.catch_warnings(record=True) as told, _dying_with(peer):
        warnings.simplefilter("always")
        try:
            with limited(budget), foreign_errors(request.what):
                name, box = "result", [request.function(*request.arguments, **request.options)]
            retire = False
        except BaseException as error:
            name, box = "error", [_told(error, request)]
            retire = isinstance(error, _GIVEN_UP) or isinstance(error.__cause__, _GIVEN_UP)
    logging.getLogger().removeHandler(records)
    _hold(None)
    os.chdir(os.sep)  # nobody need wait for this process to unmount a disk, or to remove a folder
    # whatever a library that gave up on a file has left behind must not touch the next
    send(peer, "told", [(_listed(told), records.kept, retire)])
    send(peer, name, box)


def _import(modules: Sequence[str]) -> None:
    for module in modules:
        with contextlib.suppress(Exception):  # whoever needs it says what is missing
            import_module(module)


def _listed(told: Sequence[warnings.WarningMessage]) -> list[tuple[str, str, str, int]]:
    return [(one.category.__name__, str(one.message), one.filename, one.lineno) for one in told]


class _Records(logging.Handler):
    """What libraries log, as the parent will log it."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.kept: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.kept.append((record.name, record.levelno, record.getMessage()))


def _told(error: BaseException, request: Request) -> tuple[str, str]:
    """The name and the text of an error, as the parent will raise it."""
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


def _peer() -> socket.socket:
    """The socket to the parent: standard input, or, where that cannot be one, what the parent writes there tells it."""
    if sys.platform == "win32":
        length = int.from_bytes(sys.stdin.buffer.read(2), "big")
        return socket.fromshare(sys.stdin.buffer.read(length))
    return socket.socket(fileno=os.dup(0))


def _harmless() -> None:
    """Leave the terminal alone, in both directions, and be what the system ends first where memory runs out.

    Threads get a stack that many of them can have at a time within the limit on memory, whatever ``ulimit -s`` says.
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
    """Bytes of memory that this process has to itself, 0 where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def _hold(most: int | None) -> None:
    """Let this process have so many bytes of memory to itself, if the system can; None: as many as it was born with."""
    if sys.platform != "linux":
        return
    import resource

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    unlimited = resource.RLIM_INFINITY
    soft = hard if most is None else most if hard == unlimited else min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@contextlib.contextmanager
def _dying_with(peer: socket.socket) -> Iterator[None]:
    """Let the system end this process when the parent's end of the socket closes, whatever a library is doing meanwhile."""
    if sys.platform != "linux":
        yield
        return
    import fcntl

    flags = fcntl.fcntl(peer, fcntl.F_GETFL)
    fcntl.fcntl(peer, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(peer, fcntl.F_SETFL, flags | os.O_ASYNC)  # SIGIO ends a process
    try:
        yield
    finally:
        fcntl.fcntl(peer, fcntl.F_SETFL, flags)
