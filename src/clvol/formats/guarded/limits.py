"""Limits on reading a file: time, memory, and how much larger than the file its samples may be."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from clvol.base.checks import number
from clvol.base.errors import FormatError, OutOfMemoryError
from clvol.base.memory import available

__all__ = ["MORE", "Budget", "Limits", "announce", "announce_parts", "is_trusted", "limited", "size_of"]

_MIB = 1 << 20
_GIB = 1 << 30
_BASE_SECONDS = 4.0
_BYTES_PER_SECOND = 5e6  # slower than any codec
_OPENING = 100_000  # bytes that could be read while a file is opened
_BASE_BYTES = 128 * _MIB
_COPIES = 10  # times the size of the stored samples: a byte may become a float64 beside the library's own copies
_PARTS, _MEMBER = 4096, 1024  # chunks that any array may have; bytes of an archive that allow one more
_LISTED = 10_000  # files of a folder that are counted

MORE = "limits=clvol.formats.Limits(...) or trusted=True allows more"
"""The end of messages."""


@dataclass(frozen=True)
class Limits:
    """What reading a file may cost.

    Parameters
    ----------
    seconds : float, optional
        Computing time of native libraries; time that they wait (for a disk) counts a tenth. None: 4, and one more for each 5 MB
        of the file and of its samples.
    bytes : int, optional
        Memory for the samples, and for all that native libraries hold at a time. None: for the samples, the memory available; for
        the libraries, 128 MiB and ten times the size of the samples, as far as that is available.
    expansion : float
        Samples larger than 1 GiB may be at most this many times as large as the file; an array of more than 4096 chunks may have at
        most this many times as many chunks as files.

    Raises
    ------
    OptionError
        A limit is not a positive number.

    Examples
    --------
    >>> volume = clvol.read("slow.ome.tif", limits=clvol.formats.Limits(seconds=3600))
    """

    seconds: float | None = None
    bytes: int | None = None
    expansion: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("seconds", "bytes", "expansion"):
            value = getattr(self, name)
            if value is not None:
                number(name, value, above=0)


@dataclass
class Budget:
    """What one reading may cost."""

    limits: Limits
    stored: int | None  # bytes of the file, or of the files of a folder; None: too many files to count
    room: int  # bytes of memory available
    files: int = 1
    callback: Callable[[int], None] | None = None  # called with the bytes of the samples, before they are allocated
    samples: int = 0  # the most bytes that were announced

    @property
    def seconds(self) -> float:
        """Computing time."""
        if self.limits.seconds is not None:
            return self.limits.seconds
        stored = self.stored if self.stored is not None else _GIB
        return _BASE_SECONDS + (stored + self.files * _OPENING + self.samples) / _BYTES_PER_SECOND

    @property
    def memory(self) -> int:
        """Bytes that a child process may allocate beyond what it had before."""
        if self.limits.bytes is not None:
            return self.limits.bytes
        return min(_BASE_BYTES + _COPIES * self.samples, max(self.room, _BASE_BYTES))


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextlib.contextmanager
def limited(budget: Budget | None) -> Iterator[None]:
    """Apply a budget to what is read in the block; None applies no limit but the memory available."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


def is_trusted() -> bool:
    """Whether no limits apply to what is being read."""
    return _budget.get() is None


def announce(source: str, needed: int, stored: int | None = None) -> None:
    """Check the bytes `needed` for samples of the file `source` (a name) against the limits, before they are allocated.

    Every reader calls it as soon as it knows the size; a child process gets memory and time for it. `stored` are the bytes of the
    file that holds the samples, if it is not the one being read. Samples that exceed the limits are a `FormatError`, those that
    exceed the memory available an `OutOfMemoryError`.
    """
    budget = _budget.get()
    if budget is None:
        room = available()
    else:
        room, limits = budget.room, budget.limits
        if limits.bytes is not None and needed > limits.bytes:
            raise FormatError(
                f"the samples of {source} must take at most {limits.bytes} bytes (Limits.bytes); its header says {needed}; {MORE}"
            )
        held = budget.stored if stored is None else stored
        if held is not None and needed > max(_GIB, limits.expansion * held):
            raise FormatError(
                f"the samples of {source} must be at most {limits.expansion:g} times as large as what is stored, {held} bytes "
                f"(Limits.expansion), if they are more than 1 GiB; its header says {needed} bytes; {MORE}"
            )
    if needed > room:
        raise OutOfMemoryError(
            f"out of memory: the samples of {source} must fit into the {room // _MIB} MiB that are available; "
            f"they take {-(-needed // _MIB)} MiB"
        )
    if budget is not None and needed > budget.samples:
        budget.samples = needed
        if budget.callback is not None:
            budget.callback(needed)


def announce_parts(source: str, parts: int) -> None:
    """Raise if far more chunks would be read than the stored bytes can hold: each takes time, stored or not."""
    budget = _budget.get()
    if budget is None or budget.stored is None:
        return
    held = max(budget.files, budget.stored // _MEMBER)
    if parts > max(_PARTS, budget.limits.expansion * held):
        raise FormatError(
            f"{source} must have at most {budget.limits.expansion:g} times as many chunks as are stored (Limits.expansion), "
            f"if they are more than {_PARTS}; it has {parts}; {MORE}"
        )


def size_of(path: Path) -> tuple[int | None, int]:
    """Bytes and number of files of a file, or of a folder and all below it; None bytes if there are too many files to count."""
    if not path.is_dir():
        return path.stat().st_size, 1
    total, count = 0, 0
    for folder, _, names in os.walk(path):
        for name in names:
            with contextlib.suppress(OSError):
                total += os.stat(os.path.join(folder, name)).st_size  # noqa: PTH116, PTH118  # fast for thousands of files
            count += 1
        if count > _LISTED:
            return None, count
    return total, count
