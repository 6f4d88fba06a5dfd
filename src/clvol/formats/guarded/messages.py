"""What a child process answers: JSON, and arrays of numbers; never a pickle.

A child that has parsed a hostile file may answer anything, so an answer is data that `unpack` checks. Large arrays are not copied:
the child keeps them in memory files, whose descriptors it hands over. Samples that lie in a file as they are stay there, and the
parent reads them itself.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.bricks.sliced import mapped
from clvol.formats._choice import Series
from clvol.volume.volumes import Leading

__all__ = ["MessageError", "as_stored", "copied", "empty", "receive", "send", "share_samples"]

_LARGE = 1 << 16  # bytes from which on arrays are handed over
_HUGE = 1 << 21  # bytes of a huge page
_STRETCH = 1 << 26  # bytes read at a time, so that Ctrl-C need not wait for all
_MAX_TEXT = 1 << 28  # bytes of JSON
_KINDS = "biufcSU"
_OURS = {kind.__name__: kind for kind in (Leading, Series)}
_HAS_MEMORY_FILES = sys.platform == "linux" and hasattr(os, "memfd_create")

_sharing = False


class MessageError(Exception):
    """The child's answer is malformed."""


# -- memory that can be handed over --------------------------------------------------------------------------------


class _MemoryFile(mmap.mmap):
    """Memory that another process can map; it lives as long as an array views it."""

    fd: int

    def __del__(self) -> None:
        os.close(self.fd)


def share_samples() -> None:
    """From now on, let `empty` return memory that can be handed over."""
    global _sharing
    _sharing = _HAS_MEMORY_FILES


def empty(shape: Sequence[int], dtype: DTypeLike) -> NDArray[Any]:
    """`numpy.empty` for the samples of a file; in a child process, in memory that is handed over without a copy."""
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if _sharing and size >= _LARGE:
        with contextlib.suppress(OSError):  # the system may forbid memory files
            return np.frombuffer(_memory_file(size), kind).reshape(tuple(shape))
    return np.empty(tuple(shape), kind)


def copied(samples: NDArray[Any]) -> NDArray[Any]:
    """A copy in C order, in memory from `empty`."""
    result = empty(samples.shape, samples.dtype)
    np.copyto(result, samples)
    return result


def as_stored(samples: NDArray[Any]) -> NDArray[Any]:
    """A copy of samples of a mapped file, which may change; in a child process they stay there, for the parent to read."""
    return samples if _sharing and _location(samples) else copied(samples)


def _location(array: NDArray[Any]) -> tuple[str, int] | None:
    """The file that a large array is mapped from, and the byte where it begins; None if it is not mapped, or not contiguous."""
    large = array.nbytes >= _LARGE and array.flags.c_contiguous
    return (str(file.path), file.offset) if large and (file := mapped(array)) is not None else None


def _memory_file(size: int) -> _MemoryFile:
    import fcntl

    fd = os.memfd_create("clvol", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(fd, size)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
        memory = _MemoryFile(fd, size)
    except BaseException:
        os.close(fd)
        raise
    memory.fd = fd
    if size >= _HUGE:
        with contextlib.suppress(OSError, AttributeError):  # not every kernel has huge pages for memory files
            memory.madvise(mmap.MADV_HUGEPAGE)
    return memory


def _shared(array: NDArray[Any]) -> _MemoryFile | None:
    """A memory file with the samples of an array and nothing else; None if the array is small, or there are no memory files."""
    if not _sharing or array.nbytes < _LARGE:
        return None
    return _memory_file_of(array) or _memory_file_of(copied(array))


def _memory_file_of(array: NDArray[Any]) -> _MemoryFile | None:
    """The memory file of which `array` is a view, if it views all of it."""
    base: Any = array
    while isinstance(base, (np.ndarray, memoryview)):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    whole = isinstance(base, _MemoryFile) and array.nbytes == len(base) and array.flags.c_contiguous
    return base if whole else None


def _mapped(fd: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """An array in a memory file that was handed over. It must not shrink: reading past its end would kill this process."""
    import fcntl

    try:
        size = math.prod(shape) * dtype.itemsize
        found, sealed = os.fstat(fd).st_size, fcntl.fcntl(fd, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK
        if found != size or not sealed:
            raise MessageError(f"{found} bytes of memory for an array of {size}{'' if sealed else ', which may shrink'}")
        return np.ndarray(shape, dtype, mmap.mmap(fd, size, access=mmap.ACCESS_COPY))
    except OSError as error:
        raise MessageError(str(error)) from error
    finally:
        os.close(fd)


# -- values --------------------------------------------------------------------------------------------------------


def pack(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """`value` as JSON can hold it; its arrays are appended to the list."""
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"arrays of {array.dtype} are not sent")
        if _sharing and (location := _location(array)):
            return {"stored": [array.dtype.str, list(array.shape), *location]}
        arrays.append(array)
        return {"scalar" if isinstance(value, np.generic) else "array": [array.dtype.str, list(array.shape)]}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, list):
        return [pack(part, arrays) for part in value]
    if isinstance(value, tuple):
        return {"tuple": [pack(part, arrays) for part in value]}
    if isinstance(value, Mapping):
        return {"dict": [[pack(key, arrays), pack(part, arrays)] for key, part in value.items()]}
    if isinstance(value, bytes):
        return {"bytes": value.decode("latin-1")}
    if type(value).__name__ in _OURS:
        return {type(value).__name__: [[f.name, pack(getattr(value, f.name), arrays)] for f in fields(value)]}
    raise TypeError(f"{type(value).__name__} is not sent")


def unpack(value: Any, take: Callable[[np.dtype[Any], tuple[int, ...]], NDArray[Any]]) -> Any:
    """What `pack` was given, else a `MessageError`; `take` returns the next array."""
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
                raise MessageError(f"an array of {dtype} and shape {shape}")
            if kind == "stored":
                return _read(Path(inner[2]), int(inner[3]), dtype, shape)
            array = take(dtype, shape)
            return array if kind == "array" else array[()]
        return _OURS[kind](**{str(name): unpack(part, take) for name, part in inner})
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise MessageError(f"{type(error).__name__}: {error}") from error


def _read(path: Path, start: int, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Samples that lie in a file as they are."""
    size = math.prod(shape) * dtype.itemsize
    if not path.is_file() or not 0 <= start <= path.stat().st_size - size:
        raise MessageError(f"{size} bytes at {start} of {path.name}")
    into, done = np.empty(size, np.uint8), 0
    with path.open("rb", buffering=0) as stream:
        stream.seek(start)
        while done < size and (count := stream.readinto(into.data[done : done + _STRETCH])):
            done += count
    if done < size:
        raise MessageError(f"{done} bytes at {start} of {path.name}, which must be {size}")
    return into.view(dtype).reshape(shape)


# -- messages ------------------------------------------------------------------------------------------------------


def send(peer: Connection, name: str, value: Any) -> None:
    """Send a message to the parent: its name, its value, then the arrays of that."""
    arrays: list[NDArray[Any]] = []
    packed = pack(value, arrays)
    shared = [_shared(array) for array in arrays]
    peer.send_bytes(json.dumps([name, packed, [memory is not None for memory in shared]]).encode())
    for array, memory in zip(arrays, shared, strict=True):
        if memory is not None:
            send_handle(peer, memory.fd, 0)
        else:
            peer.send_bytes(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)


def receive(peer: Connection, wait: Callable[[], None]) -> tuple[str, Any]:
    """The name and the value of the child's next message; `wait` returns once there is something to receive.

    `EOFError` if the child is gone, `MessageError` if the message is malformed.
    """

    def take(dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
        wait()
        if next(shared):
            return _mapped(recv_handle(peer), dtype, shape)
        size = math.prod(shape) * dtype.itemsize
        return np.ndarray(shape, dtype, bytearray(peer.recv_bytes(size)))

    try:
        wait()
        name, packed, handed = json.loads(peer.recv_bytes(_MAX_TEXT))
        shared = iter(handed)
        value = unpack(packed, take)
    except (EOFError, ConnectionError, TimeoutError):
        raise
    except (TypeError, ValueError, RuntimeError, StopIteration, AssertionError, OSError) as error:
        raise MessageError(f"{type(error).__name__}: {error}") from error
    if not isinstance(name, str):
        raise MessageError("a message without a name")
    return name, value
