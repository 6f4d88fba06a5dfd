"""Who uses a device's memory, so that closing frees it when the last use has ended, and never under one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from types import TracebackType
from typing import Any, Self

from clvol.base.errors import DeviceError, OptionError
from clvol.device import Device

__all__ = ["Lease", "Leased", "release"]


class Lease:
    """The uses of something that can be closed, by any number of threads.

    `close` waits for nobody, and so cannot deadlock, not even in a callback of a use: what is being computed goes on to its end,
    the last one to end frees, and whoever comes later is refused.

    Parameters
    ----------
    refusal : str
        What those are told who come after `close`.

    Attributes
    ----------
    closed : bool
        Whether `close` was called.
    """

    def __init__(self, refusal: str) -> None:
        self.closed = False
        self._refusal = refusal
        self._frees = ExitStack()
        self._users: dict[int, int] = {}  # how many uses of each thread are within one another
        # a thread may come again while it holds this: the garbage collector calls what it likes, wherever it likes
        self._lock = threading.RLock()

    def frees(self, free: Callable[[], Any]) -> None:
        """Have this called, once, when the last use has ended after `close`. (Of what holds the lease it would be a cycle.)"""
        with self._lock:
            self._frees.callback(free)

    @contextmanager
    def held(self) -> Iterator[None]:
        """A use: nothing is freed before the block ends. A use within one of the same thread is part of it.

        Raises
        ------
        OptionError
            It was closed.
        """
        thread, within = threading.get_ident(), None
        try:
            with self._lock:
                within = self._users.get(thread, 0)
                self._users[thread] = within + 1  # nothing is called here, so an interrupt comes before both or after
            if self.closed and not within:
                raise OptionError(self._refusal)
            yield
        finally:
            if within is not None:
                with self._lock:
                    self._users[thread] -= 1
                    if not self._users[thread]:
                        del self._users[thread]
            self._freed_if_unused()

    def close(self) -> None:
        """Refuse whoever comes from now on, and free the memory when nobody uses it any more."""
        self.closed = True
        self._freed_if_unused()

    def _freed_if_unused(self) -> None:
        with self._lock:
            if not self.closed or self._users:
                return
            frees = self._frees.pop_all()
        frees.close()


class Leased:
    """Something that keeps memory of a device until it is closed: the part that closes it.

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
        """Free the device's memory. Results stay valid; asking for more raises `OptionError`.

        Work in progress, in other threads or around a callback that calls this, runs to its end; the memory is freed then.
        """
        self._lease.close()

    def in_use(self) -> AbstractContextManager[None]:
        """A context in which `close` frees nothing.

        Raises
        ------
        OptionError
            The field was closed before.
        DeviceError
            This is the child of a fork, where no OpenCL device works.
        """
        self.device.require_usable()
        return self._lease.held()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def release(device: Device, *memory: Any) -> None:
    """Free buffers and images of a device, None among them, when no kernel is at them any more: after an error one may be."""
    held = [one for one in memory if one is not None]
    if held:
        with suppress(DeviceError):  # it failed, or this is the child of a fork: nothing runs there
            device.finish()
    for one in held:
        one.release()
