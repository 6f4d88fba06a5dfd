"""Messages between this process and those that read files for it.

A process that has read a hostile file may say anything: what comes from it is JSON, arrays of numbers, and data structures of ours
by name, never a pickle. Large arrays are not sent: they lie in memory that is handed over, sealed, where the system has such.
"""

from __future__ import annotations

import contextlib
import gc
import json
import math
import mmap
import os
import socket
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.formats._choice import Series
from clvol.volume.volumes import Leading

__all__ = ["WireError", "copied", "empty", "pack", "receive", "send", "share_samples", "unpack"]

_LARGE = 1 << 20  # bytes from which on arrays are handed over
_STRETCH = 1 << 26  # bytes that are read at a time: an interrupt waits for no more
_MOST_TEXT = 1 << 28  # bytes of a message but its arrays
_MOST_HANDED = 16
_HEAD = struct.Struct("<QQ")  # bytes of the text, and of the arrays behind it
_KINDS = "biufcSU"
_OURS = {kind.__name__: kind for kind in (Leading, Series)}
_CLOEXEC = getattr(socket, "MSG_CMSG_CLOEXEC", 0)
_HANDED_OVER = sys.platform == "linux" and hasattr(os, "memfd_create")

_sharing = False


class WireError(Exception):
    """What came is no message."""


# -- memory that can be handed over --------------------------------------------------------------------------------


class _Segment(mmap.mmap):
    """Memory that another process can map: it lives as long as an array is a view of it."""

    fd: int

    def __del__(self) -> None:
        os.close(self.fd)


def share_samples() -> None:
    """Let `empty` give memory that can be handed over, from now on in this process."""
    global _sharing
    _sharing = _HANDED_OVER


def empty(shape: Sequence[int], dtype: DTypeLike) -> NDArray[Any]:
    """An array for the samples of a file, as `numpy.empty`; in a process that reads for another, one that costs no copy to send."""
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if _sharing and size >= _LARGE:
        with contextlib.suppress(OSError):  # systems may forbid such memory
            return _segment(size, kind, shape)
    return np.empty(tuple(shape), kind)


def copied(samples: NDArray[Any]) -> NDArray[Any]:
    """A copy in the order of its axes, in memory from `empty`."""
    made = empty(samples.shape, samples.dtype)
    np.copyto(made, samples)
    return made


def as_stored(samples: NDArray[Any]) -> NDArray[Any]:
    """Samples of a file that is mapped into memory, which may change: copied; or left to whom they are sent to, to read."""
    return samples if _sharing and _place_of(samples) else copied(samples)


def _place_of(array: NDArray[Any]) -> tuple[str, int] | None:
    """The file that `array` is mapped from, and where it begins there; None where it is no such, or has its samples elsewhere."""
    base: Any = array
    while isinstance(base, np.ndarray) and not (isinstance(base, np.memmap) and not isinstance(base.base, np.ndarray)):
        base = base.base
    if not isinstance(base, np.memmap) or not array.flags.c_contiguous or array.nbytes < _LARGE:
        return None
    name = getattr(base, "filename", None)
    return (os.fspath(name), base.offset + array.ctypes.data - base.ctypes.data) if name else None


def _segment(size: int, dtype: np.dtype[Any], shape: Sequence[int]) -> NDArray[Any]:
    fd = os.memfd_create("clvol", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, size)
        memory = _Segment(fd, size)
    except BaseException:
        os.close(fd)
        raise
    memory.fd = fd
    with contextlib.suppress(OSError, AttributeError):  # a kernel that has none for such memory
        memory.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(memory, dtype).reshape(tuple(shape))


def _segment_of(array: NDArray[Any]) -> _Segment | None:
    """The memory that can be handed over, if `array` is all of it."""
    base: Any = array
    while isinstance(base, (np.ndarray, memoryview)):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    whole = isinstance(base, _Segment) and array.nbytes == len(base) and array.flags.c_contiguous
    return base if whole else None


# -- values --------------------------------------------------------------------------------------------------------


def pack(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """`value` as JSON has it; its arrays go into the list."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, list):
        return [pack(part, arrays) for part in value]
    if isinstance(value, tuple):
        return {"tuple": [pack(part, arrays) for part in value]}
    if isinstance(value, Mapping):
        return {"dict": [[pack(key, arrays), pack(part, arrays)] for key, part in value.items()]}
    if isinstance(value, bytes):
        return {"bytes": value.decode("latin-1")}
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"arrays of {array.dtype} are not sent")
        if _sharing and (place := _place_of(array)):
            return {"stored": [array.dtype.str, list(array.shape), *place]}
        arrays.append(array)
        return {"scalar" if isinstance(value, np.generic) else "array": [array.dtype.str, list(array.shape)]}
    if type(value).__name__ in _OURS:
        return {type(value).__name__: [[f.name, pack(getattr(value, f.name), arrays)] for f in fields(value)]}
    raise TypeError(f"{type(value).__name__} is not sent")


def unpack(value: Any, take: Callable[[np.dtype[Any], tuple[int, ...]], NDArray[Any]]) -> Any:
    """What `pack` was given; `take` gives the next array.

    Raises
    ------
    WireError
        It is nothing that `pack` makes.
    """
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, list):
        return [unpack(part, take) for part in value]
    try:
        ((kind, inner),) = value.items()
        if kind == "tuple":
            return tuple(unpack(part, take) for part in inner)
        if kind == "dict":
            return {unpack(key, take): unpack(part, take) for key, part in inner}
        if kind == "bytes":
            return inner.encode("latin-1")
        if kind in ("array", "scalar", "stored"):
            dtype, shape = np.dtype(str(inner[0])), tuple(int(n) for n in inner[1])
            if dtype.kind not in _KINDS or min(shape, default=0) < 0:
                raise WireError(f"an array of {dtype} and shape {shape}")
            if kind == "stored":
                return _read(Path(inner[2]), int(inner[3]), dtype, shape)
            array = take(dtype, shape)
            return array if kind == "array" else array[()]
        return _OURS[kind](**{str(name): unpack(part, take) for name, part in inner})
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise WireError(f"{type(error).__name__}: {error}") from error


def _read(path: Path, start: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Samples that a file holds as they are."""
    size = math.prod(shape) * dtype.itemsize
    if not path.is_file() or not 0 <= start <= path.stat().st_size - size:
        raise WireError(f"{size} bytes at {start} of {path.name}")
    into = np.empty(size, np.uint8)
    with path.open("rb", buffering=0) as stream:
        stream.seek(start)
        done = 0
        while done < size and (count := stream.readinto(into.data[done : done + _STRETCH])):
            done += count
    if done < size:
        raise WireError(f"{done} bytes at {start} of {path.name}, which must be {size}")
    return into.view(dtype).reshape(shape)


# -- messages ------------------------------------------------------------------------------------------------------


def send(peer: socket.socket, name: str, box: list[Any]) -> None:
    """Send a message: its name, and the one value in `box`, which is taken out: nobody else may hold what is handed over."""
    arrays: list[NDArray[Any]] = []
    packed = pack(box.pop(), arrays)
    handed: list[int] = []
    blobs: list[NDArray[Any]] = []
    places: list[bool] = []
    try:
        while arrays:
            array = arrays.pop(0)
            large = _sharing and array.nbytes >= _LARGE and len(handed) < _MOST_HANDED
            fd = _descriptor(array) if large else None
            places.append(fd is not None)
            if fd is not None:
                handed.append(fd)
            else:
                blobs.append(np.ascontiguousarray(array))
            del array
        for fd in handed:
            _seal(fd)
        text = json.dumps([name, packed, places]).encode()
        head = _HEAD.pack(len(text), sum(blob.nbytes for blob in blobs))
        sent = socket.send_fds(peer, [head], handed) if handed else 0
        peer.sendall(head[sent:] + text)
        for blob in blobs:
            peer.sendall(blob.reshape(-1).view(np.uint8).data)
    finally:
        for fd in handed:
            os.close(fd)


def _descriptor(array: NDArray[Any]) -> int | None:
    """Of memory that holds the samples of an array, and nothing else; None where the system has no such memory."""
    memory = _segment_of(array)
    if memory is None:
        memory = _segment_of(copied(array))
    return None if memory is None else os.dup(memory.fd)


def _seal(fd: int) -> None:
    """Let nobody change or cut the memory any more; the receiver copies it where that fails."""
    import fcntl

    kinds = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE
    try:
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, kinds)
    except OSError:
        gc.collect()  # a view of it is still about
        with contextlib.suppress(OSError):
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, kinds)


def receive(peer: socket.socket, wait: Callable[[], None]) -> tuple[str, Any]:
    """The name and the value of the next message; `wait` returns when there is something to receive.

    Raises
    ------
    EOFError
        The other side is gone.
    WireError
        What it said is no message.
    """
    handed: list[int] = []
    try:
        head = bytearray()
        while len(head) < _HEAD.size:
            wait()
            if _HANDED_OVER:
                part, fds, *_ = socket.recv_fds(peer, _HEAD.size - len(head), _MOST_HANDED, _CLOEXEC)
                handed += fds
            else:
                part = peer.recv(_HEAD.size - len(head))
            head += part
            if not part:
                raise EOFError
        length, rest = _HEAD.unpack(head)
        if length > _MOST_TEXT:
            raise WireError(f"a message of {length} bytes")
        try:
            name, packed, places = json.loads(bytes(_received(peer, np.empty(length, np.uint8), wait)))
        except (TypeError, ValueError, RecursionError) as error:
            raise WireError(f"{type(error).__name__}: {error}") from error
        if not isinstance(places, list):
            raise WireError("no list of places")
        turn = iter(places)

        def take(dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
            nonlocal rest
            size = math.prod(shape) * dtype.itemsize
            if next(turn):
                return _mapped(handed.pop(0), size, dtype, shape)
            rest -= size
            if rest < 0:
                raise WireError(f"an array of {size} bytes that were not sent")
            return _received(peer, np.empty(size, np.uint8), wait).view(dtype).reshape(shape)

        try:
            value = unpack(packed, take)
        except (StopIteration, RecursionError) as error:
            raise WireError("arrays that were not sent") from error
        if rest or not isinstance(name, str):
            raise WireError(f"{rest} bytes too many")
        return name, value
    finally:
        for fd in handed:
            os.close(fd)


def _received(peer: socket.socket, into: NDArray[np.uint8], wait: Callable[[], None]) -> NDArray[Any]:
    view, done = into.data, 0
    while done < len(view):
        wait()
        count = peer.recv_into(view[done:])
        if not count:
            raise EOFError
        done += count
    return into


def _mapped(fd: int, size: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Memory that was handed over: mapped if it is sealed, for whoever can cut it can end this process; else copied."""
    import fcntl

    try:
        if os.fstat(fd).st_size != size:
            raise WireError(f"{os.fstat(fd).st_size} bytes for an array of {size}")
        kinds = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_WRITE
        if fcntl.fcntl(fd, fcntl.F_GET_SEALS) & kinds == kinds:
            memory: Any = mmap.mmap(fd, size, access=mmap.ACCESS_COPY)
        else:
            memory = np.empty(size, np.uint8)
            view, done = memoryview(memory), 0
            while done < size and (count := os.preadv(fd, [view[done:]], done)):
                done += count
            if done < size:
                raise WireError(f"{done} bytes for an array of {size}")
        return np.frombuffer(memory, dtype).reshape(shape)
    except (OSError, ValueError) as error:
        raise WireError(str(error)) from error
    finally:
        os.close(fd)
