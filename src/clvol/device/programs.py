"""Programs of a device, each built once however many threads ask, by a thread that Ctrl-C does not interrupt."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from clvol.device import program
from clvol.device.driver import Driver
from clvol.device.launches import Launches, Task
from clvol.device.opencl import kernel_cache
from clvol.device.program import Defines, Program

__all__ = ["Programs"]

_KEPT = 128  # programs that stay built: PoCL holds a megabyte and more for each


class Programs:
    """Built programs of one device, least recently used first."""

    def __init__(self, driver: Driver, launches: Launches) -> None:
        self._driver, self._launches = driver, launches
        self._built: OrderedDict[Any, Program] = OrderedDict()
        self._building: dict[Any, Task[Program]] = {}
        self._lock = threading.RLock()  # reentrant: the garbage collector and signal handlers may come back here

    def build(
        self, name: str, defines: Defines, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None
    ) -> Program:
        """The program of one kernel file (see `program.source`), specialised; built once for each set of arguments.

        Least recently used programs are evicted. Ctrl-C ends the wait for a program, which is still built for the next call.
        """
        driver = self._driver
        driver.require_usable()
        key = (name, *(tuple(sorted((given or {}).items())) for given in (defines, replacements, generated)))
        with self._lock:
            if key in self._built:
                self._built.move_to_end(key)
                return self._built[key]
            task = self._building.get(key)
        if task is None:
            task = self._task(key, program.source(name, replacements, generated, defines), driver.context)
        with driver.errors:
            return task.wait()

    def wait(self) -> None:
        """Wait for all builds, whatever comes of them."""
        for task in list(self._building.values()):
            with contextlib.suppress(Exception):
                task.wait()

    def _task(self, key: Any, text: str, context: Any) -> Task[Program]:
        """The task that builds a program, started unless another thread has."""

        def build() -> Program:
            try:
                with self._lock:
                    if key in self._built:  # by another thread, since `key` was looked up
                        return self._built[key]
                built = program.build(self._driver.handle, context, text, kernel_cache(), self._launches.note)
                with self._lock:
                    self._built[key] = built
                    if len(self._built) > _KEPT:
                        self._built.popitem(last=False)  # kernels in use keep theirs alive
                return built
            finally:
                with self._lock:
                    self._building.pop(key, None)

        with self._lock:
            task = self._building.get(key)
            if task is None:
                task = Task(build)
                if not task.done:  # if no thread could be started, it is done
                    self._building[key] = task
            return task
