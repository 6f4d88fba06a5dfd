"""Plans: what calls of one kind need besides their data, kept from one for the next."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

__all__ = ["Plans"]

T = TypeVar("T")

_KINDS = 16
_BYTES = 1 << 26


class Plans(Generic[T]):
    """Idle plans, such as buffers and arguments of a kernel, of up to 16 kinds of calls and 64 MiB.

    A call takes a plan and gives it back once its kernels are done, so that no two threads use one at a time. A call that fails
    must not give it back. The owner clears them when it is closed.
    """

    def __init__(self) -> None:
        self._idle: dict[Hashable, list[tuple[T, int]]] = {}

    def take(self, kind: Hashable, make: Callable[[], T]) -> T:
        """An idle plan for a kind of call, else a new one."""
        try:
            return self._idle[kind].pop()[0]
        except LookupError:
            return make()

    def give(self, kind: Hashable, plan: T, nbytes: int = 0) -> None:
        """Keep a plan, of so many bytes if these count, for the next call."""
        idle = self._idle.get(kind)
        if (idle is None and len(self._idle) >= _KINDS) or (nbytes and nbytes + self._held() > _BYTES):
            self.clear()
            idle = None
        if idle is None:
            idle = self._idle.setdefault(kind, [])
        idle.append((plan, nbytes))

    def _held(self) -> int:
        """Bytes of all idle plans."""
        return sum(nbytes for plans in list(self._idle.values()) for _, nbytes in list(plans))

    def clear(self) -> None:
        """Forget all idle plans."""
        self._idle = {}
