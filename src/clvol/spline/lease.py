"""Counting the uses of a device's memory, so that closing frees it after the last use, and never during one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from clvol.base.errors import DeviceError, OptionError

if TYPE_CHECKING:
    from clvol.device import Device

__all__ = ["Lease", "Leased", "release"]


class Lease:
    """The uses of something that can be closed, by any number of threads.

    `close` does not wait, so it cannot deadlock, even in a callback during a use: work in progress runs to its end, the last use
    frees the memory, and later uses are refused with the error message `refusal`.
    """

    def __init__(self, refusal: str) -> None:
        self.closed = False
        self._refusal = refusal
        self._frees = ExitStack()
        self._users: dict[int, int] = {}  # nested uses of each thread
        # reentrant: the garbage collector may run a finalizer in a thread that holds it
        self._lock = threading.RLock()

    def frees(self, free: Callable[[], Any]) -> None:
        """Call `free` once, after `close` and the last use. (A method of the lease's owner would be a reference cycle.)"""
        with self._lock:
            self._frees.callback(free)

    def held(self) -> AbstractContextManager[None]:
        """A use: nothing is freed before the block ends; `OptionError` if it is closed. Nested uses of a thread are one."""
        return _Use(self)

    def close(self) -> None:
        """Refuse further uses, and free the memory after the last one."""
        self.closed = True
        self._freed_if_unused()

    def _freed_if_unused(self) -> None:
        with self._lock:
            if not self.closed or self._users:
                return
            frees = self._frees.pop_all()
        frees.close()


class _Use:
    """A use of a lease, as a class since that takes half the time of a generator."""

    __slots__ = ("_lease", "_thread", "_within")

    def __init__(self, lease: Lease) -> None:
        self._lease, self._within = lease, -1

    def __enter__(self) -> None:
        lease = self._lease
        self._thread = thread = threading.get_ident()
        try:
            with lease._lock:
                self._within = lease._users.get(thread, 0)
                lease._users[thread] = self._within + 1  # no call in between, so an interrupt is before or after both
            if lease.closed and not self._within:
                raise OptionError(lease._refusal)
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        lease, thread = self._lease, self._thread
        if self._within >= 0:
            with lease._lock:
                lease._users[thread] -= 1
                if not lease._users[thread]:
                    del lease._users[thread]
        if lease.closed:
            lease._freed_if_unused()


class Leased:
    """Mixin for objects that hold a device's memory until they are closed.

    Attributes
    ----------
    device : Device
    """

    device: Device
    _lease: Lease

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._lease.closed

    def close(self) -> None:
        """Free the device's memory. Results stay valid; further calls raise `OptionError`.

        Work in progress, in other threads or around a callback that calls this, runs to its end; then the memory is freed.
        """
        self._lease.close()

    def in_use(self) -> AbstractContextManager[None]:
        """A context in which `close` frees nothing.

        Raises
        ------
        OptionError
            It is closed.
        DeviceError
            This is the child of a fork, where OpenCL does not work.
        """
        self.device.require_usable()
        return self._lease.held()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def release(device: Device, *memory: Any) -> None:
    """Free buffers and images of a device, or None, once no kernel uses them: after an error one may still run."""
    held = [one for one in memory if one is not None]
    if held:
        with suppress(DeviceError):  # the device failed, or this is the child of a fork: nothing runs
            device.finish()
    for one in held:
        one.release()
