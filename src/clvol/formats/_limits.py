"""What reading a file may cost: time, memory, and how much larger than the file its samples may be."""

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

__all__ = ["Budget", "Limits", "announce", "announce_parts", "is_trusted", "limited", "size_of"]

_MIB = 1 << 20
_GIB = 1 << 30
_BASE_SECONDS = 4.0
_BYTES_A_SECOND = 5e6  # slower than any codec
_FILE = 100_000  # bytes that count for opening a file
_BASE_BYTES = 128 * _MIB
_COPIES = 10  # of the samples as they are stored: a byte may become a float64 beside what a library holds of it
_PARTS, _MEMBER = 4096, 1024  # chunks that any array may have; bytes of an archive for which it may have another one
_LISTED = 10_000  # files of a folder that are counted


@dataclass(frozen=True)
class Limits:
    """What reading a file may cost.

    Parameters
    ----------
    seconds : float, optional
        Of computing, for the libraries that run in a process of their own; the time that they wait (for a disk) counts a tenth.
        None: 4, and one more for each 5 MB of the file and of its samples.
    bytes : int, optional
        Of memory, for the samples, and for all that those libraries hold at a time. None: what is available, and of it 128 MiB
        and ten times the size of the samples that the header says.
    expansion : float
        How many times as large as the file its samples may be, if they are larger than 1 GiB; and how many times as many chunks as
        files an array may have, if these are more than 4096.

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
    """What is left to the reading that is going on.

    Parameters
    ----------
    limits : Limits
    stored : int or None
        Bytes of the file, or of the files of a folder; None: too many to count.
    room : int
        Bytes of memory that may be taken.
    files : int
        How many there are.
    told : callable, optional
        Is told how many bytes the samples will take, before they are allocated.
    samples : int
        The most that was announced.
    """

    limits: Limits
    stored: int | None
    room: int
    files: int = 1
    told: Callable[[int], None] | None = None
    samples: int = 0

    @property
    def seconds(self) -> float:
        """For which it may compute."""
        if self.limits.seconds is not None:
            return self.limits.seconds
        stored = self.stored if self.stored is not None else _GIB
        return _BASE_SECONDS + (stored + self.files * _FILE + self.samples) / _BYTES_A_SECOND

    @property
    def memory(self) -> int:
        """Bytes that a process which only reads may take, beyond what it had before."""
        if self.limits.bytes is not None:
            return self.limits.bytes
        return min(_BASE_BYTES + _COPIES * self.samples, max(self.room, _BASE_BYTES))


_budget: ContextVar[Budget | None] = ContextVar("budget", default=None)


@contextlib.contextmanager
def limited(budget: Budget | None) -> Iterator[None]:
    """Hold what is read in the block to a budget; None: to no limit but the memory that there is."""
    token = _budget.set(budget)
    try:
        yield
    finally:
        _budget.reset(token)


def is_trusted() -> bool:
    """Whether what is being read is held to no limits."""
    return _budget.get() is None


def announce(source: str, needed: int, stored: int | None = None) -> None:
    """Say how many bytes the samples of a file will take, before they are allocated.

    Every reader calls it once it knows; libraries that run in a process of their own get memory and time by it.

    Parameters
    ----------
    source : str
        The name of the file, for messages.
    needed : int
        Bytes of the samples that will be read.
    stored : int, optional
        Bytes of the file that holds them, if that is not the one that is being read.

    Raises
    ------
    FormatError
        They are more than the limits allow.
    OutOfMemoryError
        They do not fit into the memory that is available.
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
        if budget.told is not None:
            budget.told(needed)


def announce_parts(source: str, parts: int) -> None:
    """Say how many chunks will be asked for, each of which takes its time, stored or not.

    Raises
    ------
    FormatError
        They are many more than what is stored can hold.
    """
    budget = _budget.get()
    if budget is None or budget.stored is None:
        return
    held = max(budget.files, budget.stored // _MEMBER)
    if parts > max(_PARTS, budget.limits.expansion * held):
        raise FormatError(
            f"{source} must have at most {budget.limits.expansion:g} times as many chunks as are stored (Limits.expansion), "
            f"if they are more than {_PARTS}; it has {parts}; {MORE}"
        )


MORE = "limits=clvol.formats.Limits(...) or trusted=True allows more"
"""What messages end with."""


def size_of(path: Path) -> tuple[int | None, int]:
    """Bytes of a file, or of those in a folder and below it; and how many these are. None bytes: too many to count."""
    if not path.is_dir():
        return path.stat().st_size, 1
    total, count = 0, 0
    for folder, _, names in os.walk(path):
        for name in names:
            with contextlib.suppress(OSError):
                total += os.stat(os.path.join(folder, name)).st_size  # noqa: PTH116, PTH118  # thousands of them
            count += 1
        if count > _LISTED:
            return None, count
    return total, count
