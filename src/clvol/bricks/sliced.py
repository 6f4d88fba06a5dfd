"""Samples of an array that are read when they are asked for, files that are watched meanwhile, and mapped ones that are read."""

from __future__ import annotations

import contextlib
import math
import os
import platform
import threading
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError

__all__ = ["FlatFile", "MappedFile", "Signature", "Watched", "Window", "mapped", "said_of_file", "said_of_folder", "signature"]

Index: TypeAlias = tuple[int | slice, ...]
Signature: TypeAlias = tuple[int, int, int] | None
"""By which a change of a file is noticed: when it was written, its size, and which file it is; None where there is none."""

_SHARE = 4  # rows are read whole where this part of them, or more, is wanted
_ROWS = 1 << 20  # bytes of these that are read at a time


def signature(path: str | os.PathLike[str]) -> Signature:
    """That of a file now."""
    try:
        about = os.stat(path)  # noqa: PTH116  # at each read
    except (FileNotFoundError, NotADirectoryError):
        return None
    return about.st_mtime_ns, about.st_size, about.st_ino


def said_of_file(path: str | os.PathLike[str]) -> str:
    """By what a file is known to be the same, in words: its size, and when it was written."""
    found = signature(path)
    return "gone" if found is None else f"{found[1]} bytes, written {np.datetime64(found[0], 'ns')}"


def said_of_folder(path: Path) -> str:
    """The same of all files in a folder: how many they are, their size, and a checksum of names, sizes and times."""
    count = total = check = 0
    for folder, folders, names in os.walk(path):
        folders.sort()
        for name in sorted(names):
            file = os.path.join(folder, name)  # noqa: PTH118  # thousands of them
            written, size, _ = signature(file) or (0, 0, 0)
            count, total = count + 1, total + size
            check = zlib.crc32(f"{os.path.relpath(file, path)} {size} {written}\n".encode(), check)
    return f"{count} files, {total} bytes, {check:08x}"


class Window:
    """Samples of an array at an index, in some order of its axes, none of which is read before it is asked for.

    It is to readers of files what an array is, where these read nothing but what a caller wants: a shape, a dtype, slices.

    Parameters
    ----------
    read : callable
        The samples at an index of the array: a number or a slice, of step one, for each axis. If it has a method `said`, this says
        in words by what the source is known to be the same.
    shape : tuple of int
        Of the array.
    dtype : dtype
        Of the samples.
    chunks : tuple of int, optional
        Samples along each axis of the array that are stored together.
    index : tuple of int or slice, optional
        What it is a window of: whole axes, or a place along them; or the first samples of an axis.
    """

    def __init__(
        self,
        read: Callable[[Index], NDArray[Any]],
        shape: Sequence[int],
        dtype: np.dtype[Any],
        chunks: Sequence[int] | None = None,
        index: Index = (),
    ) -> None:
        self._read = read
        self._index = (*index, *(slice(None) for _ in shape[len(index) :]))
        self._ranges = [range(n)[at] if isinstance(at, slice) else None for n, at in zip(shape, self._index, strict=True)]
        self._kept = [i for i, at in enumerate(self._ranges) if at is not None]
        self._stored = tuple(chunks) if chunks is not None else None
        self._whole = 0  # axes before z, y and x that are always read whole
        self._steps: tuple[Callable[[NDArray[Any]], NDArray[Any]], ...] = ()
        self.dtype = np.dtype(dtype).newbyteorder("=")
        self._itemsize = self.dtype.itemsize  # of what is stored

    def transpose(self, order: Sequence[int]) -> Window:
        """The same with its axes in another order."""
        made = self._copy()
        made._kept = [self._kept[i] for i in order]
        return made

    def mapped(self, function: Callable[[NDArray[Any]], NDArray[Any]], dtype: np.dtype[Any] | None = None) -> Window:
        """What a function makes of the samples, one by one; its results are of `dtype`, or of that which it gives for zeros."""
        made = self._copy()
        made.dtype = np.dtype(dtype if dtype is not None else function(np.zeros((1,) * self.ndim, self.dtype)).dtype)
        made._steps = (*self._steps, lambda part: np.asarray(function(part)).astype(made.dtype, copy=False))
        return made

    def combined(self, function: Callable[[NDArray[Any]], NDArray[Any]], several: int) -> Window:
        """One volume that a function makes of several: those of the first axes."""
        made = self._copy()
        made._whole = several
        result = function(np.zeros((*self.shape[:several], *(1,) * (self.ndim - several)), self.dtype))
        made.dtype = result.dtype
        made._steps = (*self._steps, function)
        return made

    def said(self) -> str | None:
        """By what the source is known to be the same, if its reader says so."""
        words = getattr(self._read, "said", None)
        return None if words is None else str(words())

    @property
    def place(self) -> Path | None:
        """The file or the folder that it is read from, if its reader says so."""
        return getattr(self._read, "place", None)

    def _copy(self) -> Window:
        made = object.__new__(Window)
        made.__dict__.update(self.__dict__)
        return made

    @property
    def shape(self) -> tuple[int, ...]:
        """As the samples would have it as an array."""
        ends = [at for i in self._kept if (at := self._ranges[i]) is not None]
        return tuple(at.stop - at.start for at in ends)[self._whole :]  # len() ends at 2⁶³, which files may say

    @property
    def ndim(self) -> int:
        """Axes."""
        return len(self._kept) - self._whole

    @property
    def stored_in_one(self) -> int:
        """Bytes of a chunk as it is stored, with all that it holds of other axes; 0 where any part is read by itself."""
        return 0 if self._stored is None else math.prod(self._stored) * self._itemsize

    @property
    def chunks(self) -> tuple[int, ...] | None:
        """Samples along each axis that are stored together."""
        if self._stored is None:
            return None
        return tuple(min(self._stored[i], n) for i, n in zip(self._kept[self._whole :], self.shape, strict=True))

    def __getitem__(self, at: Any) -> NDArray[Any]:
        wanted = list(at) if isinstance(at, tuple) else [at]
        if Ellipsis in wanted:
            gap = wanted.index(Ellipsis)
            wanted[gap : gap + 1] = [slice(None)] * (self.ndim - len(wanted) + 1)
        wanted += [slice(None)] * (self.ndim - len(wanted))
        index, after = list(self._index), []
        for i, one, n in zip(self._kept[self._whole :], wanted, self.shape, strict=True):
            taken = range(n)[one] if isinstance(one, slice) else range(n)[one : one + 1 or None]
            if not taken or taken.step < 1:
                raise IndexError(f"slices must hold samples, with a step of 1 or more; got {one} of {n}")
            first = self._ranges[i][0]  # type: ignore[index]  # of a kept axis
            index[i] = slice(first + taken[0], first + taken[-1] + 1)
            after.append(slice(None, None, taken.step) if isinstance(one, slice) else 0)
        left = [i for i, one in enumerate(index) if isinstance(one, slice)]
        part = self._read(tuple(index))
        expected = tuple(one.stop - one.start if one.stop is not None else len(range(n)) for one, n in self._lengths(index))
        if part.shape != expected:
            raise FormatError(f"samples must come in the shape {expected}; got {part.shape}")
        part = part.transpose([left.index(i) for i in self._kept])
        part = part.astype(part.dtype.newbyteorder("="), copy=False)
        for step in self._steps:
            part = step(part)
        return np.asarray(part[tuple(after)])

    def _lengths(self, index: Sequence[int | slice]) -> list[tuple[slice, int]]:
        return [
            (one, len(whole))
            for one, whole in zip(index, self._ranges, strict=True)
            if isinstance(one, slice) and whole is not None
        ]


class Watched:
    """Reads from a file that must stay what it was when this was made.

    Parameters
    ----------
    path : Path
    name : str
        For messages.
    read : callable, optional
        The samples at an index.
    """

    def __init__(self, path: Path, name: str, read: Callable[[Index], NDArray[Any]] | None = None) -> None:
        self._path, self._name, self._samples = path, name, read
        self._signature = signature(path)

    def __call__(self, index: Index) -> NDArray[Any]:
        """The samples at an index: for each axis a number or a slice of step one.

        Raises
        ------
        FormatError
            The file is another than it was.
        """
        self.require_unchanged()
        assert self._samples is not None
        return self._samples(index)

    def require_unchanged(self) -> None:
        """Raise `FormatError` if the file is another than it was."""
        if signature(self._path) != self._signature:
            raise FormatError(f"{self._name} has changed since it was opened; open it again")

    def said(self) -> str:
        """By what it is known to be the same."""
        return said_of_file(self._path)

    @property
    def place(self) -> Path:
        """The file."""
        return self._path


class FlatFile(Watched):
    """An array whose samples follow each other in a file, read by its parts.

    They are read and not mapped: should a mapped file shrink, or its disk vanish, touching the samples would kill the process where
    reading raises an error; and what is mapped counts against limits of memory.

    Parameters
    ----------
    path : Path
    shape : tuple of int
        Of the array, the last axis (the first, if `transposed`) varies fastest.
    dtype : dtype
        As stored.
    offset : int or sequence of int
        Bytes before the first sample; or before each of several pieces of equal size, such as pages, that follow each other in the
        array.
    transposed : bool
        Whether the array is in Fortran's order.
    """

    def __init__(
        self, path: Path, shape: Sequence[int], dtype: np.dtype[Any], offset: int | Sequence[int], transposed: bool = False
    ) -> None:
        super().__init__(path, path.name)
        self._shape = tuple(shape)[::-1] if transposed else tuple(shape)
        self._transposed = transposed
        self._dtype = np.dtype(dtype)
        self._offsets = [offset] if isinstance(offset, int) else list(offset)
        self._piece = math.prod(self._shape) // len(self._offsets)  # samples
        self._lock = threading.Lock()
        self._stream = path.open("rb", buffering=0)

    def __call__(self, index: Index) -> NDArray[Any]:
        """The samples at an index, of a file that is what it was."""
        self.require_unchanged()
        index = index[::-1] if self._transposed else index
        box = [range(n)[at] if isinstance(at, slice) else range(at, at + 1) for n, at in zip(self._shape, index, strict=True)]
        result = np.empty([len(part) for part in box], self._dtype)
        self._fill(result, box, 0, 0)
        result = result[tuple(slice(None) if isinstance(at, slice) else 0 for at in index)]
        found = result.T if self._transposed else result
        return found != 0 if self._dtype.kind == "b" else found  # any byte but 0 is true, yet NumPy expects 1

    def _fill(self, into: NDArray[Any], box: list[range], axis: int, before: int) -> None:
        """Read the part `box` of all axes from `axis` on; `before` samples lie before those of the axes before."""
        inner = 1
        for n in self._shape[axis + 1 :]:
            inner *= n
        whole = all(len(part) == n for part, n in zip(box[axis + 1 :], self._shape[axis + 1 :], strict=True))
        wanted = into.size // max(1, into.shape[0]) if into.ndim else 1
        if axis == len(self._shape) - 1 or whole:
            self._read(into, before + box[axis][0] * inner)
        elif (
            wanted * _SHARE >= inner and inner * self._dtype.itemsize <= _ROWS and self._has(before + (box[axis][-1] + 1) * inner)
        ):  # reads of more than is wanted
            some = _ROWS // (inner * self._dtype.itemsize)
            within = tuple(slice(part[0], part[-1] + 1) for part in box[axis + 1 :])
            for k in range(0, len(box[axis]), some):
                rows = np.empty((min(some, len(box[axis]) - k), *self._shape[axis + 1 :]), self._dtype)
                self._read(rows, before + (box[axis][0] + k) * inner)
                into[k : k + some] = rows[(slice(None), *within)]
        else:
            for k, i in enumerate(box[axis]):
                self._fill(into[k], box, axis + 1, before + i * inner)

    def _has(self, count: int) -> bool:
        """Whether so many samples lie in the file: an array may be a part of one, which ends before its last row does."""
        if len(self._offsets) > 1:
            return count <= self._piece * len(self._offsets)
        return self._signature is not None and self._offsets[0] + count * self._dtype.itemsize <= self._signature[1]

    def _read(self, into: NDArray[Any], first: int) -> None:
        made = into if into.flags.c_contiguous else np.empty(into.shape, into.dtype)
        view = memoryview(made.reshape(-1).view(np.uint8))  # type: ignore[arg-type]  # an array is one
        if len(self._offsets) == 1:
            self._read_bytes(view, self._offsets[0] + first * self._dtype.itemsize)
        else:
            self._read_pieces(view, first)
        if made is not into:
            into[...] = made

    def _read_pieces(self, view: memoryview, first: int) -> None:
        """Samples from `first` on, out of the pieces in which they lie."""
        size, done = self._dtype.itemsize, 0
        while done < len(view):
            piece, within = divmod(first + done // size, self._piece)
            count = min(len(view) - done, (self._piece - within) * size)
            self._read_bytes(view[done : done + count], self._offsets[piece] + within * size)
            done += count

    def _read_bytes(self, view: memoryview, at: int) -> None:
        done = 0
        while done < len(view):
            if hasattr(os, "preadv"):
                count = os.preadv(self._stream.fileno(), [view[done:]], at + done)
            else:
                with self._lock:
                    self._stream.seek(at + done)
                    count = self._stream.readinto(view[done:]) or 0
            if not count:
                raise FormatError(f"{self._path.name} ends before byte {at + len(view)}, where samples should be")
            done += count

    def __del__(self) -> None:
        with contextlib.suppress(AttributeError, OSError):
            self._stream.close()


@dataclass
class MappedFile:
    """Samples of a file that another process has mapped: it is found by its name, and read as it is by `FlatFile`.

    Attributes
    ----------
    path : Path
        Absolute.
    signature : (int, int, int)
        Of the file when this was made.
    host : str
        Where that was.
    offset : int
        Bytes before the first sample.
    stored, counts : tuple of int
        The array in the order in which it is stored, and how many samples of it are taken along each axis, the first ones.
    order : tuple of int
        Of these axes, as the samples have them.
    dtype : dtype
        As stored.
    """

    path: Path
    signature: tuple[int, int, int]
    host: str
    offset: int
    stored: tuple[int, ...]
    counts: tuple[int, ...]
    order: tuple[int, ...]
    dtype: np.dtype[Any]
    _opened: Window | None = field(default=None, init=False, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_opened": None}

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the samples."""
        return tuple(self.counts[i] for i in self.order)

    def __getitem__(self, index: Any) -> NDArray[Any]:
        if self._opened is None:
            self._require_same()
            file = FlatFile(self.path, self.stored, self.dtype, self.offset)
            index_of_all = tuple(slice(0, n) for n in self.counts)
            self._opened = Window(file, self.stored, self.dtype, index=index_of_all).transpose(self.order)
        return self._opened[index]

    def _require_same(self) -> None:
        """Raise `FormatError` unless the file is here, and is what it was."""
        now = None
        with contextlib.suppress(FileNotFoundError), self.path.open("rb"):  # NFS asks its server at this, not at each look
            now = signature(self.path)
        written, nbytes, number = self.signature
        if now is None or now[1] != nbytes:
            there = "there is none" if now is None else f"it has {now[1]} bytes"
            raise FormatError(f"{self.path}, which was mapped, must be here as well, with its {nbytes} bytes; {there}")
        # The time tells of what was written to the file, its number of another file that was put in its place, even within one
        # tick of the clock. Other hosts may give a file other numbers (SMB, containers), so these count on one host alone.
        if not _same_time(now[0], written) or (platform.node() == self.host and now[2] != number):
            raise FormatError(f"{self.path}, which was mapped, has changed since it was opened; open it again")


def _same_time(one: int, other: int) -> bool:
    """Whether two times of a file, in nanoseconds, may be one that two hosts see: some have it cut to 100 ns, 1 µs, 1 s, or 2 s."""
    step = next(step for step in (2 * 10**9, 10**9, 1000, 100, 1) if one % step == 0 or other % step == 0)
    return one // step == other // step


def mapped(array: Any, *, flushed: bool = False) -> MappedFile | None:
    """The file of an array that is mapped into memory, or a part of one; `flushed`: with all that was written to the map.

    None of one that is not, whose file has no name any more, that holds changes which its file does not (mode "c"), or of every
    second sample and the like.
    """
    root = array
    while isinstance(root, np.ndarray) and not (isinstance(root, np.memmap) and not isinstance(root.base, np.ndarray)):
        root = root.base
    if not isinstance(root, np.memmap) or root.filename is None or root.mode == "c" or 0 in array.shape:
        return None
    path, first = Path(root.filename), root.offset + array.ctypes.data - root.ctypes.data
    strides = [0 if n == 1 else stride for n, stride in zip(array.shape, array.strides, strict=True)]
    order = sorted(range(array.ndim), key=lambda i: -strides[i])  # axes of one sample are the innermost
    stored: list[int] = []
    step = array.itemsize
    for i in reversed(order):
        n = array.shape[i]
        if n > 1 and stored:
            within, rest = divmod(strides[i], step)
            if rest or within < stored[0]:
                return None
            step, stored[0] = strides[i], within
        elif n > 1 and strides[i] != step:
            return None
        stored.insert(0, n)
    if flushed and root.mode != "r":
        root.flush()  # which may set the time of the file
    now = signature(path)
    if now is None or first + array.itemsize > now[1]:
        return None
    inverse = tuple(order.index(i) for i in range(array.ndim))
    counts = tuple(array.shape[i] for i in order)
    return MappedFile(path.absolute(), now, platform.node(), first, tuple(stored), counts, inverse, array.dtype)
