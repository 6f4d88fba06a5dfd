"""How much memory this process may still allocate; larger requests fail before they allocate any.

Linux overcommits memory and kills the process that touches too much; in a container at its limit, even if the machine has
memory free. So large requests are checked here first, against the smallest of the machine's available memory, the limits of
the process's control groups (cgroup v1 and v2, with all ancestors) and its own limits (``ulimit -v``, ``-d``).
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.base.errors import OutOfMemoryError

__all__ = ["Room", "available", "empty", "require", "require_addressable", "room"]

ROOT = Path("/")
"""Root of ``proc`` and ``sys``; tests replace it."""

_MIB = 1 << 20
_SMALL = 64 * _MIB  # bytes; smaller requests are not checked, because a check takes 0.5 ms
_KEPT = 32 * _MIB  # bytes reserved for small allocations that are not checked
_SECONDS = 0.1  # seconds for which a measurement is cached
_ADDRESSABLE = (1 << 31) - 1  # samples along an axis: the range of OpenCL's int
_UNLIMITED = sys.maxsize
_WIDEST = 16  # bytes of the widest sample


class Room(NamedTuple):
    """Memory that may still be allocated, in bytes, and what sets the limit, for messages."""

    nbytes: int
    limit: str


_TOUCHED = 1.0  # seconds after which a result's memory is in use, or its work has started

_lock = threading.RLock()  # a signal handler may re-enter
_waiting: list[tuple[weakref.ref[NDArray[Any]], float]] = []
_answer: tuple[float, Path, Room] | None = None


def available() -> int:
    """Bytes that this process may still allocate under its smallest limit."""
    return room().nbytes


def room() -> Room:
    """The `available` memory and the limit that sets it, measured now."""
    return min(_rooms(), default=Room(_UNLIMITED, "no known limit"))


def require(nbytes: int, what: str) -> None:
    """Raise `OutOfMemoryError` if `what` needs more bytes, at its peak, than this process may allocate. Allocates nothing.

    A measurement is cached for a tenth of a second, minus the bytes granted since; a refusal always measures again.
    """
    global _answer
    if nbytes < _SMALL:
        return
    now, root = time.monotonic(), ROOT
    with _lock:
        _waiting[:] = [(one, since) for one, since in _waiting if one() is not None and now - since < _TOUCHED]
        requested = nbytes
        nbytes += sum(array.nbytes for one, _ in _waiting if (array := one()) is not None)
        if _answer is None or now - _answer[0] > _SECONDS or _answer[1] != root or nbytes > _answer[2].nbytes - _KEPT:
            _answer = now, root, room()
        then, _, left = _answer
        if nbytes <= left.nbytes - _KEPT:
            _answer = then, root, Room(left.nbytes - requested, left.limit)
            return
    raise OutOfMemoryError(
        f"out of memory: {what} must fit into the {max(0, left.nbytes - _KEPT) // _MIB} MiB that are available ({left.limit}); "
        f"got {-(-nbytes // _MIB)} MiB"
    )


def empty(shape: tuple[int, ...], dtype: DTypeLike, what: str) -> NDArray[Any]:
    """An array for results. Counts as used for a second, because the system counts it only when it is written."""
    require(math.prod(shape) * np.dtype(dtype).itemsize, what)
    array: NDArray[Any] = np.empty(shape, dtype)
    if array.nbytes >= _SMALL:
        with _lock:
            _waiting.append((weakref.ref(array), time.monotonic()))
    return array


def require_addressable(what: str, shape: tuple[int, ...]) -> None:
    """Raise `OutOfMemoryError` for more samples along an axis than kernels can count, or more in all than can be addressed."""
    if max(shape, default=0) > _ADDRESSABLE or math.prod(shape) > _UNLIMITED // _WIDEST:
        raise OutOfMemoryError(
            f"out of memory: {what} must have at most {_ADDRESSABLE} samples along each axis, and {_UNLIMITED // _WIDEST} in all; "
            f"got shape {shape}"
        )


# -- limits --------------------------------------------------------------------------------------------------------


def _rooms() -> Iterator[Room]:
    if sys.platform == "win32":
        yield from _of_windows()
    elif sys.platform == "darwin":
        yield from _of_macos()
    else:
        yield from _of_linux(ROOT)
        yield from _of_groups(ROOT)
        yield from _of_process(ROOT)


def _of_linux(root: Path) -> Iterator[Room]:
    """Memory available without swapping, plus free swap space."""
    values = _table(root / "proc/meminfo")
    if "MemAvailable:" in values:
        yield Room((values["MemAvailable:"] + values.get("SwapFree:", 0)) * 1024, "all of the machine's")


def _of_groups(root: Path) -> Iterator[Room]:
    """Limits of the process's control groups, from its own up to the mounted root."""
    for folder, top, version in _groups(root):
        limit, usage = ("memory.max", "memory.current") if version == 2 else ("memory.limit_in_bytes", "memory.usage_in_bytes")
        for group in (folder, *folder.parents):
            most, used = _number(group / limit), _number(group / usage)
            if most is not None and used is not None:
                kept = _table(group / "memory.stat")
                prefix = "" if version == 2 else "total_"
                # the kernel drops cached files before it kills
                cached = sum(kept.get(f"{prefix}{kind}_file", 0) for kind in ("active", "inactive"))
                yield Room(max(0, most - max(0, used - cached)), f"the container's limit is {most // _MIB} MiB")
            if group == top:
                break


def _groups(root: Path) -> Iterator[tuple[Path, Path, int]]:
    """For each control group that may limit memory: its folder, the topmost visible folder, and the cgroup version."""
    inside: dict[int, str] = {}
    for line in _lines(root / "proc/self/cgroup"):
        number, controllers, path = (*line.split(":", 2), "", "")[:3]
        if number == "0" and not controllers:
            inside[2] = path
        elif "memory" in controllers.split(","):
            inside[1] = path
    for line in _lines(root / "proc/self/mountinfo"):
        fields, _, rest = line.partition(" - ")
        place, kind = fields.split(), rest.split()
        if len(place) < 5 or not kind:
            continue
        version = 2 if kind[0] == "cgroup2" else 1 if kind[0] == "cgroup" and "memory" in kind[-1].split(",") else 0
        if version not in inside:
            continue
        top = root / _unescaped(place[4]).lstrip("/")
        with contextlib.suppress(ValueError):  # the process's group is outside the mount: only the mount is visible
            group = top / PurePosixPath(inside[version]).relative_to(_unescaped(place[3]))
            if ".." not in group.parts and group.is_dir():
                yield group, top, version
                continue
        yield top, top, version


def _of_process(root: Path) -> Iterator[Room]:
    """Resource limits, as a shell sets them."""
    try:
        import resource

        pages = [int(word) * os.sysconf("SC_PAGE_SIZE") for word in _lines(root / "proc/self/statm")[0].split()]
        kinds = ((resource.RLIMIT_AS, pages[0], "ulimit -v"), (resource.RLIMIT_DATA, pages[5], "ulimit -d"))
    except (ImportError, IndexError, ValueError):
        return
    for kind, used, name in kinds:
        most = resource.getrlimit(kind)[0]
        if most != resource.RLIM_INFINITY:
            yield Room(max(0, most - used), f"{name} is {most // _MIB} MiB")


def _of_windows() -> Iterator[Room]:
    """The commit limit, which Windows never exceeds."""

    class Status(ctypes.Structure):  # MEMORYSTATUSEX
        _fields_ = (
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            *(
                (name, ctypes.c_ulonglong)
                for name in ("physical", "free", "page_file", "commit", "virtual", "addresses", "extended")
            ),
        )

    status = Status(length=ctypes.sizeof(Status))
    with contextlib.suppress(AttributeError, OSError):
        if ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):  # type: ignore[attr-defined,unused-ignore]
            yield Room(min(status.commit, status.addresses), "all of the machine's, its page file included")


def _of_macos() -> Iterator[Room]:
    """Memory that applications do not use, counted as in Activity Monitor: all but wired, compressed and anonymous pages."""
    with contextlib.suppress(AttributeError, OSError, ValueError):
        words = (ctypes.c_uint32 * 38)()  # vm_statistics64
        count = ctypes.c_uint32(len(words))
        library = ctypes.CDLL(None)
        library.mach_host_self.restype = ctypes.c_uint32
        if library.host_statistics64(ctypes.c_uint32(library.mach_host_self()), 4, words, ctypes.byref(count)) == 0:
            wired, purgeable, compressed, internal = (int(words[i]) for i in (3, 22, 32, 35))
            used = wired + compressed + max(0, internal - purgeable)
            left = max(0, os.sysconf("SC_PHYS_PAGES") - used)
            yield Room(left * os.sysconf("SC_PAGE_SIZE"), "all of the machine's")


# -- reading -------------------------------------------------------------------------------------------------------


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []


def _table(path: Path) -> dict[str, int]:
    """The numbers of a file by name."""
    rows = (line.split() for line in _lines(path))
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdecimal()}


def _number(path: Path) -> int | None:
    """The single number of a file; None for "max" or a missing file."""
    text = "".join(_lines(path)).strip()
    return int(text) if text.isdecimal() else None


def _unescaped(text: str) -> str:
    """A path of mountinfo, which writes spaces in octal."""
    return text.encode().decode("unicode_escape", errors="replace") if "\\" in text else text
