"""Progress callbacks. They receive the fraction of the work that is done, and may raise to cancel it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias, TypeVar

from clvol.base.checks import warn
from clvol.base.errors import OptionError

__all__ = ["Progress", "counted", "part_of", "require_callback", "watched"]

_PATIENCE = 10.0  # seconds before anything is said ...
_LONG = 60.0  # ... of work that takes this much longer

Progress: TypeAlias = Callable[[float], None]
Item = TypeVar("Item")


def counted(items: Sequence[Item], progress: Progress | None) -> Iterator[Item]:
    """The items in turn; `progress` gets the fraction done after each."""
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            progress(done / len(items))


def part_of(progress: Progress | None, start: float, end: float) -> Progress | None:
    """A callback for one part of the work, between two fractions of the whole; None if `progress` is None.

    Examples
    --------
    >>> seen = []
    >>> second_half = part_of(seen.append, 0.5, 1.0)
    >>> second_half(0.0), second_half(0.5), second_half(1.0)
    (None, None, None)
    >>> seen
    [0.5, 0.75, 1.0]
    """
    if progress is None:
        return None

    def report(done: float) -> None:
        progress(start * (1 - done) + end * done)  # exact at both ends

    return report


def watched(what: str, progress: Progress | None = None) -> Progress:
    """A callback that passes the fraction on, and warns once if work that took ten seconds will take a minute more.

    The first part of the work says nothing about the rest: kernels are compiled, and volumes read, before it.
    """
    began, told, first = time.monotonic(), False, None

    def report(done: float) -> None:
        nonlocal told, first
        if progress is not None:
            progress(done)
        now = time.monotonic()
        spent, (since, before) = now - began, (first := first or (now, done))
        if not told and done > before and spent > _PATIENCE and (left := (now - since) * (1 - done) / (done - before)) > _LONG:
            told = True
            warn(f"{what} will take about {_in_words(left)} more, at this rate: {100 * done:.2g} % is done after {spent:.0f} s")

    return report


def _in_words(seconds: float) -> str:
    """About how long that is."""
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.0f} hours"


def require_callback(name: str, callback: object) -> None:
    """Raise `OptionError` unless a callback is None or callable."""
    if callback is not None and not callable(callback):
        raise OptionError(f"{name} must be callable; got {callback!r}")
