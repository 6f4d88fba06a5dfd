"""Launches: how work is split between them, waits that Ctrl-C can interrupt, and memory that outlives the kernels using it."""

from __future__ import annotations

import _thread
import contextlib
import itertools
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from clvol.device.driver import Driver
from clvol.device.opencl import opencl
from clvol.device.program import Variants

__all__ = ["Launches", "Limits", "Task", "Tile"]

T = TypeVar("T")

_SOON = 0.002  # seconds for which a wait polls before it starts a thread


class Tile(NamedTuple):
    """The rays of one work-item of the ray loop.

    Attributes
    ----------
    width, height : int
        Rays across and down.
    lanes : int
        Rays at a time: 1 or 8 (16 where registers are wide enough and `height` is even).
    shared : bool
        Whether the rays share the blended plane under the tile.
    """

    width: int
    height: int
    lanes: int
    shared: bool


@dataclass(frozen=True)
class Limits:
    """How work on a device is split. No result depends on it, except for rounding in pictures by other tiles.

    Parameters
    ----------
    launch_seconds : float
        Longest duration of a launch: between launches the program can be interrupted and reports progress.
    launch_voxels : int
        Voxels per launch of a copy or the prefilter.
    launch_taps : int
        Taps per launch of sampling.
    sorted_bytes : int
        Size of the points that are sorted at a time, in bytes.
    sorting : bool, optional
        Whether points are sorted before they are sampled; None: where it pays.
    tile : Tile, optional
        The rays of a work-item; None: what suits the device.
    evaluator : {"auto", "taps", "paired", "eight-fetch"}
        How the function is evaluated where the caller does not say: see `clvol.spline.evaluator`.
    fetch : {"auto", "buffer", "image"}
        Where coefficients are then read from.
    """

    launch_seconds: float = 0.25
    launch_voxels: int = 1 << 24
    launch_taps: int = 1 << 25
    sorted_bytes: int = 32 << 20
    sorting: bool | None = None
    tile: Tile | None = None
    evaluator: str = "auto"
    fetch: str = "auto"


class Task(Generic[T]):
    """Work in another thread, so that Ctrl-C reaches the thread that waits for it; the work itself continues.

    Ctrl-C within `threading.Thread.start` or `threading.Event.wait` may leave their locks held, and both threads waiting forever.
    Hence a bare thread, and a lock that only wakes those who wait. If no thread can be started, as when the interpreter of
    Python 3.12 shuts down, the work is done at once.
    """

    def __init__(self, work: Callable[[], T]) -> None:
        self._work, self._result = work, None
        self._error: BaseException | None = None
        self.done = False
        self._awake = threading.Lock()
        self._awake.acquire()
        try:
            _thread.start_new_thread(self._run, ())
        except RuntimeError:
            self._run()

    def _run(self) -> None:
        try:
            self._result = self._work()  # type: ignore[assignment]
        except BaseException as error:  # `wait` raises it
            self._error = error
        finally:
            self.done = True
            self._awake.release()

    def wait(self) -> T:
        while not self.done:
            if self._awake.acquire(timeout=0.1):  # without a timeout Ctrl-C would not be seen on Windows
                self._awake.release()  # for other waiting threads
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]


class Launches:
    """Waits for the launches on a device's queue, and keeps memory until their kernels are done with it."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._fresh: set[Variants] = set()  # PoCL may still be compiling these kernels
        self._held: dict[int, tuple[weakref.ref[Any], Any]] = {}  # owner, and memory that kernels may be using
        self._numbers = itertools.count()

    def note(self, variants: Variants) -> None:
        """Record that PoCL may compile a kernel for the next launch."""
        self._fresh.add(variants)

    def finish(self) -> None:
        """Wait for all launches. Ctrl-C ends the wait while the runtime is still compiling a kernel."""
        with self._driver.errors:
            self.settle()
            self._driver.queue.finish()

    def settle(self) -> None:
        """Wait for kernels that the runtime is still compiling: in its own wait, of seconds, Ctrl-C would not be seen."""
        if not self._fresh:
            return
        queue = self._driver.queue
        if threading.current_thread() is threading.main_thread() and not self._soon_done(queue):
            Task(lambda: self._done(queue)).wait()
        else:
            self._done(queue)

    def hold(self, owner: Any, memory: Any) -> int:
        """Keep memory until its owner is gone and all launches are done; returns a number for `let_go`.

        If the owner freed it in its ``__del__``, Ctrl-C at the wrong moment would free it under a running kernel.
        """
        number = next(self._numbers)  # unique: two threads may release the same one
        self._held[number] = weakref.ref(owner, self._sweep), memory
        return number

    def let_go(self, number: int) -> None:
        """Release memory that no kernel uses any more."""
        del self._held[number]

    def end(self) -> None:
        """Wait for all launches before the process exits, and store what PoCL compiled for them."""
        queue = self._driver.__dict__.get("queue")
        with contextlib.suppress(Exception):
            if self._fresh:
                Task(lambda: self._done(queue)).wait()
            if queue is not None:
                queue.finish()

    def _soon_done(self, queue: Any) -> bool:
        """Whether all launches finish before it is worth starting a thread that waits for them."""
        cl = opencl()
        last = cl.enqueue_marker(queue)
        queue.flush()
        end = time.perf_counter() + _SOON
        while last.command_execution_status > cl.command_execution_status.COMPLETE:  # below are errors
            if time.perf_counter() > end:
                return False
            time.sleep(_SOON / 50)
        return True

    def _done(self, queue: Any) -> None:
        """Wait for all launches; then store what was compiled for them, and release memory without an owner."""
        fresh = set(self._fresh)
        left = [number for number, (owner, _) in list(self._held.items()) if owner() is None]
        queue.finish()
        for number in left:
            self._held.pop(number, None)
        for variants in fresh:
            variants.keep()
        self._fresh -= fresh

    def _sweep(self, _: object = None) -> None:
        """Release memory without an owner once kernels are done. Runs in the garbage collector: nobody catches what it raises."""
        try:
            if self._driver.forked:
                return  # the queue of a forked child never finishes
            queue = self._driver.queue
            if self._fresh:
                Task(lambda: self._done(queue))
            else:
                self._done(queue)
        except KeyboardInterrupt:
            _thread.interrupt_main()  # raise it where it can be caught
        except Exception:
            return  # the next sweep tries again
