"""A device to compute on: its buffers, its programs, and how work on it is split."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.base.kept import Kept
from clvol.device import program
from clvol.device.buffers import Buffers, float_format
from clvol.device.driver import Driver, Once
from clvol.device.launches import Launches, Limits, Task
from clvol.device.opencl import kernel_cache, opencl
from clvol.device.plan import Plans
from clvol.device.program import Defines, Program

__all__ = ["Device"]

_SAMPLER_POSITIONS = 4097


class _Limited(threading.local):
    """The limits of each thread."""

    limits = Limits()


_KEPT = 128  # programs that stay built: PoCL holds a megabyte and more for each


class Programs:
    """Programs of one device, each built once however many threads ask, by a thread that Ctrl-C does not interrupt."""

    def __init__(self, driver: Driver, launches: Launches) -> None:
        self._driver, self._launches = driver, launches
        self._built: OrderedDict[Any, Program] = OrderedDict()  # least recently used first
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


class Device(Driver):
    """An OpenCL device with its context, queue, buffers and programs; one object for each device of a process.

    Use `as_device` to get one. Buffers, programs and renderers hold the device they were created on.

    Attributes
    ----------
    buffers : Buffers
    launches : Launches
    programs : Programs
    plans : Plans
        Those of calls that keep nothing else.
    tables : Kept
        Tables of kernels, by what they are of.
    """

    def __init__(self, handle: Any) -> None:
        super().__init__(handle)
        self.launches = Launches(self)
        self.buffers = Buffers(self, self.launches)
        self.programs = Programs(self, self.launches)
        self.plans: Plans[Any] = Plans()
        self.tables: Kept[Any] = Kept(64)
        self._limited = _Limited()

    @Once
    def has_images(self) -> bool:
        """Whether volumes can be stored as images and read with the linear sampler.

        PoCL on CUDA and some AMD devices have no images; a few drivers lack the float format.
        """
        if not self.handle.image_support:
            return False
        cl = opencl()
        with self.errors:
            formats = cl.get_supported_image_formats(self.context, cl.mem_flags.READ_ONLY, cl.mem_object_type.IMAGE3D)
        return float_format() in formats

    @Once
    def sampler_bits(self) -> float:
        """Bits of the linear sampler's fraction, measured once; 0 if it does not interpolate.

        Texture units of GPUs have 8; samplers in software have 20 or more.
        """
        if not self.has_images:
            return 0.0
        measured = np.empty(_SAMPLER_POSITIONS, np.float32)
        ramp = self.buffers.image_of(self.buffers.upload(np.tile(np.array([0, 1], np.float32), (2, 2, 1))), (2, 2, 2))
        with self.buffers.lent(measured, write=True) as values, self.errors:
            kernel = self.build("base/sampler.cl", {"COORD_DOUBLE": 0}).kernel("sample_ramp")
            kernel(self.queue, measured.shape, None, ramp, np.float32(1 / (_SAMPLER_POSITIONS - 1)), values)
        error = float(np.abs(measured - np.linspace(0, 1, _SAMPLER_POSITIONS)).max())
        return 0.0 if error > 0.1 else float(-np.log2(2 * max(error, 2.0**-25)))

    def build(
        self, name: str, defines: Defines, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None
    ) -> Program:
        """The program of one kernel file, see `Programs.build`."""
        return self.programs.build(name, defines, replacements, generated)

    @property
    def limits(self) -> Limits:
        """How this thread's work on the device is split."""
        return self._limited.limits

    @contextlib.contextmanager
    def limited(self, **changes: Any) -> Iterator[None]:
        """Other `limits` for this thread, for the duration of a block."""
        before = self.limits
        self._limited.limits = replace(before, **changes)
        try:
            yield
        finally:
            self._limited.limits = before

    def finish(self) -> None:
        """Wait for all launches, see `Launches.finish`."""
        self.launches.finish()

    def _end(self) -> None:
        """At the end of the process: a runtime does not survive it while it compiles."""
        if self.forked:
            return
        try:
            self.programs.wait()
            self.launches.end()
        except KeyboardInterrupt:
            os._exit(130)  # an interrupted user does not wait
