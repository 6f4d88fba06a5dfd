"""A device: what it reports, its context and queue, its errors, and the guard against runtimes that hang or abort the process."""

from __future__ import annotations

import atexit
import os
import shutil
import threading
from abc import ABC, abstractmethod
from functools import cached_property
from types import TracebackType
from typing import Any, TypeVar

from clvol.base.errors import ClvolError, DeviceError, OutOfMemoryError
from clvol.device.opencl import kernel_cache, opencl, why_not, works
from clvol.device.runtimes import processor

__all__ = ["Driver", "Once", "require_unforked"]

T = TypeVar("T")

_GONE = ("DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE")
_LINKER = (
    "; install 'binutils' and 'gcc' (Debian, Ubuntu: apt install binutils gcc), or another OpenCL runtime: "
    "'pip install \"clvol[intel]\"' brings one that needs neither"
)


class Once(cached_property[T]):
    """A `cached_property` that one thread computes: since Python 3.12 that has no lock, and two contexts are incompatible."""

    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Any:
        if instance is None:
            return self
        with instance._lock:
            if self.attrname in instance.__dict__:
                return instance.__dict__[self.attrname]
            return super().__get__(instance, owner)


def require_unforked(process: int | None) -> None:
    """Raise `DeviceError` in a fork of `process`: a runtime's threads do not survive it, and even a new context hangs."""
    if process not in (None, os.getpid()):
        raise DeviceError("OpenCL devices cannot be used after a fork; start processes with 'spawn' or 'forkserver'")


class Identity:
    """What an OpenCL device reports about itself; every quirk that needs no context is a named predicate here."""

    def __init__(self, handle: Any) -> None:
        self.handle = handle

    def __repr__(self) -> str:
        return f"<Device {self.name!r} on {self.platform!r}>"

    @cached_property
    def name(self) -> str:
        return str(self.handle.name).strip()

    @cached_property
    def platform(self) -> str:
        return str(self.handle.platform.name).strip()

    @cached_property
    def kind(self) -> str:
        """Kind of device: "cpu", "gpu" or "accelerator"."""
        kinds = opencl().device_type
        return "cpu" if self.handle.type & kinds.CPU else "gpu" if self.handle.type & kinds.GPU else "accelerator"

    @property
    def is_pocl(self) -> bool:
        """Whether it is PoCL's device for the processor, whose kernels work on the host's memory."""
        return self.kind == "cpu" and "portable computing language" in self.platform.lower()

    @property
    def is_llvmpipe(self) -> bool:
        """Whether it is Mesa's rasterizer for the processor, which compiles some kernels for minutes."""
        return self.name.lower().startswith("llvmpipe")

    @cached_property
    def has_double(self) -> bool:
        return "cl_khr_fp64" in str(self.handle.extensions)

    @property
    def shares_memory(self) -> bool:
        """Whether mapped buffers are host memory."""
        return bool(self.handle.host_unified_memory)

    @cached_property
    def units(self) -> int:
        """Number of compute units: the cores of a processor."""
        return int(self.handle.max_compute_units)

    @property
    def largest(self) -> int:
        """Size of the largest buffer, in bytes."""
        return int(self.handle.max_mem_alloc_size)

    @property
    def total(self) -> int:
        """Size of the device's memory, in bytes."""
        return int(self.handle.global_mem_size)

    @cached_property
    def image_limit(self) -> int:
        """Largest extent of a 3-D image along any axis."""
        h = self.handle
        return int(min(h.image3d_max_width, h.image3d_max_height, h.image3d_max_depth))

    def alone(self, dimensions: int) -> tuple[int, ...] | None:
        """Work-group size: one work-item on a processor; elsewhere the runtime chooses.

        PoCL compiles a kernel for each work-group size, and would choose another one for almost every global size.
        """
        return (1,) * dimensions if self.kind == "cpu" else None


class Driver(Identity, ABC):
    """An OpenCL device with its context and queue, both created at first use."""

    def __init__(self, handle: Any) -> None:
        super().__init__(handle)
        self._process = os.getpid()
        self._lock = threading.RLock()
        self._gone = ""

    @Once
    def context(self) -> Any:
        self.require_usable()
        with self.errors:
            context = opencl().Context([self.handle])
        atexit.register(self._end)
        return context

    @Once
    def queue(self) -> Any:
        context = self.context
        with self.errors:
            return opencl().CommandQueue(context)

    @abstractmethod
    def _end(self) -> None:
        """Called when the process exits, if a context was created."""

    @property
    def forked(self) -> bool:
        """Whether this process is a fork of the one that owns the device."""
        return self._process != os.getpid()

    @Once
    def fault(self) -> str:
        """Why a trial in another process found the device unusable; "" if it is usable."""
        why = why_not(self.handle)
        kernels = kernel_cache() if self.is_pocl and shutil.which("ld") is None and works(self.handle) else None
        if kernels is not None:
            kernels.needs_linker = False  # the trial had none
        if not why:
            return ""
        if self.is_pocl:
            # PoCL runs the linker for every kernel, and aborts the process if that fails or a file cannot be written
            try:
                kernels = kernel_cache()
                if kernels is not None:
                    kernels.require_room()
            except DeviceError as error:
                return str(error)
            return f"PoCL cannot build kernels here: a trial of it in another process {why}"
        return f"{self.name} ({self.platform}) cannot be used: a trial of it in another process {why}. 'clvol doctor' tries again"

    @Once
    def compiled_for(self) -> str:
        """Which processor PoCL 3.0 compiles for, in words, and whether clvol had to name it; "" for other runtimes."""
        return processor.name_processor(self.handle)

    def require_usable(self) -> None:
        """Raise `DeviceError` if using the device would hang or abort the process.

        That happens with drivers that failed their trial, and in forked processes. PoCL is given a name for a processor that it
        does not know.
        """
        self.require_present()
        if self.fault:
            linker = "linker" in self.fault or "build kernels here" in self.fault
            raise DeviceError(self.fault + (_LINKER if linker else ""))
        if self.is_pocl:
            self.compiled_for  # noqa: B018  # before the first kernel is built

    @cached_property
    def errors(self) -> Errors:
        """Context manager that translates OpenCL's errors into clvol's."""
        return Errors(self)

    def require_present(self) -> None:
        """Raise `DeviceError` if the device is gone, or in a fork of the process that owns it."""
        require_unforked(self._process)
        if self._gone:
            raise DeviceError(self._gone)

    def translated(self, error: BaseException | None) -> ClvolError | None:
        """The error in place of one of OpenCL's; None for all others."""
        cl = opencl()
        if isinstance(error, cl.MemoryError):
            return OutOfMemoryError(f"{self.name} is out of memory: {error}")
        if not isinstance(error, cl.Error):
            return None
        if any(name in str(error) for name in _GONE):
            self._gone = f"{self.name} is gone, or its driver was restarted ({error}); start the program again to use it"
            return DeviceError(self._gone)
        return DeviceError(f"{self.name} failed: {error}")


class Errors:
    """Translates OpenCL's errors within a ``with`` block; one for each device, for any number of blocks at a time."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def __enter__(self) -> None:
        self._driver.require_present()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if error is not None and (instead := self._driver.translated(error)) is not None:
            raise instead from error
