"""Choosing an OpenCL device; every quirk of a device or its runtime is a named predicate here."""

from __future__ import annotations

import _thread
import atexit
import contextlib
import ctypes
import itertools
import math
import mmap
import os
import threading
import time
import warnings
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clvol import cache, processor, program
from clvol.base import memory
from clvol.base.checks import one_of
from clvol.base.errors import ClvolWarning, DeviceError, OutOfMemoryError
from clvol.opencl import INSTALL, built_kernels, kept_out, opencl, why_not
from clvol.program import Defines, Launches, Program

__all__ = ["Device", "Limits", "Tile", "as_device", "devices"]

_KINDS = ("cpu", "gpu", "accelerator")
_HUGE_PAGE = 1 << 21
_SAMPLER_POSITIONS = 4097
_PROGRAMS = 128  # that are kept built: PoCL holds a megabyte and more for each
_SOON = 0.002
_GONE = ("DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE")
_MEMORY_SHARE = 0.9  # of the device's memory: PoCL allocates lazily, and the process aborts if there is none left


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
    """How the work on a device is cut into parts. No result depends on it, but for rounding in pictures by other tiles.

    Parameters
    ----------
    launch_seconds : float
        A launch should not run longer: between launches the program can be interrupted and reports its progress.
    launch_voxels : int
        Voxels that a launch of a copy or the prefilter takes.
    launch_taps : int
        Taps that a launch of sampling takes.
    sorted_bytes : int
        Points that are sorted at a time.
    sorting : bool, optional
        Whether points are sorted before they are sampled; None: where it pays.
    tile : Tile, optional
        The rays of a work-item; None: what suits the device.
    evaluator : {"auto", "taps", "paired", "eight-fetch"}
        How the function is evaluated where a caller leaves that open: see `clvol.spline.evaluator`.
    fetch : {"auto", "buffer", "image"}
        Where coefficients are read from then.
    """

    launch_seconds: float = 0.25
    launch_voxels: int = 1 << 24
    launch_taps: int = 1 << 25
    sorted_bytes: int = 32 << 20
    sorting: bool | None = None
    tile: Tile | None = None
    evaluator: str = "auto"
    fetch: str = "auto"


_LIMITS = Limits()
T = TypeVar("T")


class _Once(cached_property[T]):
    """As `cached_property`, made by one thread alone: since Python 3.12 that has no lock, and two contexts do not go together."""

    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Any:
        if instance is None:
            return self
        with instance._lock:
            if self.attrname in instance.__dict__:
                return instance.__dict__[self.attrname]
            return super().__get__(instance, owner)


class _Task(Generic[T]):
    """Work in a thread of its own, so that Ctrl-C is heard by the thread that waits for it; the work goes on.

    Ctrl-C within `threading.Thread.start` or `threading.Event.wait` may leave their locks taken, and both threads waiting for ever;
    so there is a bare thread here, and a lock that only wakes who waits. Where there can be no thread more, as at the end of the
    interpreter in Python 3.12, the work is done at once.
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
        except BaseException as error:  # whoever waits is told
            self._error = error
        finally:
            self.done = True
            self._awake.release()

    def wait(self) -> T:
        while not self.done:
            if self._awake.acquire(timeout=0.1):  # without an end, Windows would not hear Ctrl-C
                self._awake.release()  # for others who wait
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]


class _Block:
    """Lives as long as the block that memory was lent to, however it ends."""

    __slots__ = ("__weakref__",)


class Device:
    """One OpenCL device with its context and queue, made once for each process.

    Use `as_device` to get one. Buffers, programs and renderers hold the device they were made on.
    """

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self._process = os.getpid()
        self._lock = threading.RLock()
        self._programs: OrderedDict[Any, Program] = OrderedDict()  # the one used last is last
        self._building: dict[Any, _Task[Program]] = {}
        self._programs_lock = threading.RLock()  # the garbage collector may come back here, and so may a handler of signals
        self._fresh: set[Launches] = set()  # of kernels that PoCL may be finishing
        self._held: dict[int, tuple[weakref.ref[Any], Any]] = {}  # memory that kernels may be using, and who else wants it
        self._numbers = itertools.count()
        self._gone = ""
        self._limited = threading.local()

    def __repr__(self) -> str:
        return f"<Device {self.name!r} on {self.platform!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process finds the device by its name; of several of one name by which of them it is."""
        alike = [other for other in devices() if repr(other) == repr(self)]
        return _found_again, (self.platform, self.name, alike.index(self) if self in alike else 0)

    @cached_property
    def name(self) -> str:
        return str(self.handle.name).strip()

    @cached_property
    def platform(self) -> str:
        return str(self.handle.platform.name).strip()

    @cached_property
    def kind(self) -> str:
        """Which kind it is: "cpu", "gpu" or "accelerator"."""
        kinds = opencl().device_type
        return "cpu" if self.handle.type & kinds.CPU else "gpu" if self.handle.type & kinds.GPU else "accelerator"

    @_Once
    def context(self) -> Any:
        self.require_usable()
        with _errors(self):
            context = opencl().Context([self.handle])
        atexit.register(self._end)
        return context

    @_Once
    def queue(self) -> Any:
        context = self.context
        with _errors(self):
            return opencl().CommandQueue(context)

    # -- quirks --------------------------------------------------------------------------------

    @property
    def is_pocl(self) -> bool:
        return "portable computing language" in self.platform.lower()

    @cached_property
    def has_double(self) -> bool:
        return "cl_khr_fp64" in str(self.handle.extensions)

    @_Once
    def has_images(self) -> bool:
        """Whether volumes can be stored as images and read with the linear sampler.

        PoCL on CUDA and some AMD devices have no images; a few drivers lack the float format.
        """
        if not self.handle.image_support:
            return False
        cl = opencl()
        with _errors(self):
            formats = cl.get_supported_image_formats(self.context, cl.mem_flags.READ_ONLY, cl.mem_object_type.IMAGE3D)
        return _float_format() in formats

    @cached_property
    def image_limit(self) -> int:
        """Largest extent of an image along any axis."""
        h = self.handle
        return int(min(h.image3d_max_width, h.image3d_max_height, h.image3d_max_depth))

    @_Once
    def sampler_bits(self) -> float:
        """Bits of the linear sampler's fraction, measured once; 0 if it does not interpolate.

        Texture units of GPUs have 8; samplers in software have 20 or more.
        """
        if not self.has_images:
            return 0.0
        measured = np.empty(_SAMPLER_POSITIONS, np.float32)
        ramp = self.image_of(self.upload(np.tile(np.array([0, 1], np.float32), (2, 2, 1))), (2, 2, 2))
        with self.lent(measured, write=True) as values, self.errors:
            kernel = self.build("base/sampler.cl", {"COORD_DOUBLE": 0}).kernel("sample_ramp")
            kernel(self.queue, measured.shape, None, ramp, np.float32(1 / (_SAMPLER_POSITIONS - 1)), values)
        error = float(np.abs(measured - np.linspace(0, 1, _SAMPLER_POSITIONS)).max())
        return 0.0 if error > 0.1 else float(-np.log2(2 * max(error, 2.0**-25)))

    @cached_property
    def units(self) -> int:
        """Compute units: the cores of a processor."""
        return int(self.handle.max_compute_units)

    @property
    def largest(self) -> int:
        """Bytes of the largest buffer."""
        return int(self.handle.max_mem_alloc_size)

    @property
    def shares_memory(self) -> bool:
        """Whether mapped buffers are the host's own memory."""
        return bool(self.handle.host_unified_memory)

    @_Once
    def fault(self) -> str:
        """Why it cannot be used, as a trial in another process has shown; "" if it can."""
        why = why_not(self.handle)
        if not why:
            return ""
        if self.is_pocl and self.kind == "cpu":
            # PoCL shells out to the linker for every kernel, and aborts the process where that or a file cannot be written
            try:
                kernels = built_kernels()
                if kernels is not None:
                    kernels.require_room()
            except DeviceError as error:
                return str(error)
            return f"PoCL cannot build kernels here: a trial of it in another process {why}"
        return f"{self.name} ({self.platform}) cannot be used: a trial of it in another process {why}. 'clvol doctor' tries again"

    def require_usable(self) -> None:
        """Raise `DeviceError` where using the device would hang or abort the process.

        Its driver does so in a trial; a PoCL context used after a fork hangs. PoCL cannot build for a processor that it has no
        name for, and is given one.
        """
        _require_unforked(self._process)
        if self._gone:
            raise DeviceError(self._gone)
        if self.fault:
            linker = "linker" in self.fault or "build kernels here" in self.fault
            raise DeviceError(self.fault + (_LINKER if linker else ""))
        if self.is_pocl and self.kind == "cpu":
            _named(self.handle.int_ptr)

    # -- kernels -------------------------------------------------------------------------------

    def build(
        self, name: str, defines: Defines, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None
    ) -> Program:
        """The program of one kernel file (see `program.source`), specialised; built once for each set of defines.

        Those that were not used for the longest time are built anew if many others were built since. Ctrl-C ends the wait for a
        program, which is then there for the next time.
        """
        self.require_usable()
        key = (name, *(tuple(sorted((given or {}).items())) for given in (defines, replacements, generated)))
        with self._programs_lock:
            if key in self._programs:
                self._programs.move_to_end(key)
                return self._programs[key]
            task = self._building.get(key)
        if task is None:
            text, context = program.source(name, replacements, generated, defines), self.context

            def work() -> Program:
                try:
                    built = program.build(self.handle, context, text, built_kernels(), self._fresh.add)
                    with self._programs_lock:
                        self._programs[key] = built
                        if len(self._programs) > _PROGRAMS:
                            self._programs.popitem(last=False)  # its kernels go with whoever still uses them
                    return built
                finally:
                    with self._programs_lock:
                        self._building.pop(key, None)

            with self._programs_lock:
                if key in self._programs:
                    return self._programs[key]
                task = self._building.get(key)
                if task is None:
                    task = _Task(work)
                    if not task.done:  # else it was done here
                        self._building[key] = task
        with self.errors:
            return task.wait()

    @property
    def limits(self) -> Limits:
        """How this thread's work on the device is cut into parts."""
        return getattr(self._limited, "limits", _LIMITS)

    @contextlib.contextmanager
    def limited(self, **changes: Any) -> Iterator[None]:
        """Other `limits` for this thread, for the time of a block."""
        before = self.limits
        self._limited.limits = replace(before, **changes)
        try:
            yield
        finally:
            self._limited.limits = before

    # -- memory --------------------------------------------------------------------------------

    def allocate(self, size: int) -> Any:
        """A read-write buffer of `size` bytes."""
        cl = opencl()
        size = max(int(size), 4)
        self.require_room(size)
        with _errors(self):
            if self.kind == "cpu" and size >= 2 * _HUGE_PAGE and hasattr(mmap, "MADV_HUGEPAGE"):
                return cl.Buffer(self.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=_huge_pages(size, self))
            return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size)

    def require_room(self, size: int, *, held: bool = False) -> None:
        """Raise `OutOfMemoryError` before a runtime would abort: PoCL finds out only when memory is touched.

        What a processor allocates is this process's memory, of which a container may have less than the device says; `held`:
        it has been allocated.
        """
        largest, everything = self.largest, int(self.handle.global_mem_size)
        if size > largest or size > _MEMORY_SHARE * everything:
            raise OutOfMemoryError(
                f"{self.name} allows one allocation of up to {largest / 2**20:.0f} MiB and holds "
                f"{everything / 2**20:.0f} MiB; got {size / 2**20:.0f} MiB"
            )
        if self.kind == "cpu" and not held:
            memory.require(size, f"a buffer of {self.name}")

    def upload(self, array: np.ndarray[Any, Any]) -> Any:
        """A read-only buffer with a copy of `array`."""
        cl = opencl()
        array = np.ascontiguousarray(array)
        self.require_room(array.nbytes)
        with _errors(self):
            return cl.Buffer(self.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def clear(self, buffer: Any, first: int, count: int, kind: type[np.generic] = np.float32) -> None:
        """Set `count` numbers of a buffer, from number `first` on, to zero."""
        width = np.dtype(kind).itemsize
        with _errors(self):
            opencl().enqueue_fill_buffer(self.queue, buffer, np.float32(0), width * first, width * count)

    @contextlib.contextmanager
    def lent(self, array: np.ndarray[Any, Any], *, write: bool, begun: bool = False) -> Iterator[Any]:
        """A contiguous array as a buffer for the time of a block, read or written by kernels.

        No copy where the device shares the host's memory. Elsewhere kernels that write find in it what it holds only if `begun`.
        """
        cl = opencl()
        flags = cl.mem_flags.READ_WRITE if write else cl.mem_flags.READ_ONLY
        self.require_room(array.nbytes, held=self.shares_memory)
        with _errors(self):
            if self.shares_memory:
                buffer = cl.Buffer(self.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=array)
            elif write and not begun:
                buffer = cl.Buffer(self.context, flags, array.nbytes)
            else:
                buffer = cl.Buffer(self.context, flags | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)
            held = self._hold(block := _Block(), (buffer, array))  # kernels may still be writing to it after an error
            yield buffer
            self._settle()
            if write and self.shares_memory:  # mapping is what makes the host's view complete
                view, _ = cl.enqueue_map_buffer(self.queue, buffer, cl.map_flags.READ, 0, array.shape, array.dtype)
                view.base.release(self.queue)
            elif write:
                cl.enqueue_copy(self.queue, array, buffer)
            self.queue.finish()
            del self._held[held], block
            buffer.release()

    @contextlib.contextmanager
    def lent_span(self, array: np.ndarray[Any, Any], *, write: bool) -> Iterator[tuple[Any, np.int64, NDArray[np.int64]]]:
        """The memory that an array [z, y, x] of any layout lies in, as `lent`; where it starts there; its strides along x, y, z.

        Where it starts and its strides count elements, and must be whole numbers of them. A device that does not share the host's
        memory writes all of it back, gaps included.
        """
        width = array.itemsize
        if not write and array.size:  # of part of a large array the span may be more than a device takes, and is more to send
            span_bytes = width + sum((n - 1) * abs(stride) for n, stride in zip(array.shape, array.strides, strict=True))
            if span_bytes > (self.largest if self.shares_memory else min(self.largest, 2 * array.nbytes)):
                array = np.ascontiguousarray(array)
        reaches = [(n - 1) * stride for n, stride in zip(array.shape, array.strides, strict=True)]
        before = -sum(reach for reach in reaches if reach < 0)
        length = (before + sum(reach for reach in reaches if reach > 0)) // width + 1
        lowest = array[tuple(slice(-1, None) if reach < 0 else slice(0, 1) for reach in reaches)]
        span = np.lib.stride_tricks.as_strided(lowest, (length,), (width,))
        # Intel's runtime copies memory that does not begin where its vectors may; what lies before, on the same page, is lent too
        more = lowest.ctypes.data % (self.handle.mem_base_addr_align // 8)
        if write or not self.shares_memory or more % width:
            more = 0
        if more:
            memory = (ctypes.c_byte * (more + span.nbytes)).from_address(lowest.ctypes.data - more)
            span = np.frombuffer(memory, array.dtype)
        with self.lent(span, write=write) as buffer:
            strides = [stride // width for stride in array.strides[::-1]]
            yield buffer, np.int64((more + before) // width), np.array([*strides, 0], np.int64)

    def image_of(self, buffer: Any, shape: tuple[int, int, int]) -> Any:
        """A float image with the first numbers of `buffer`, of shape (z, y, x)."""
        cl = opencl()
        if max(shape) > self.image_limit:
            raise OutOfMemoryError(f"{self.name} holds images up to {self.image_limit} wide; got {shape}")
        self.require_room(4 * math.prod(shape))
        with self.errors:
            make = getattr(cl, "create_image", cl.Image)  # Image() itself is deprecated in favour of it
            image = make(self.context, cl.mem_flags.READ_ONLY, _float_format(), shape=shape[::-1])
            cl.enqueue_copy(self.queue, image, buffer, offset=0, origin=(0, 0, 0), region=shape[::-1]).wait()
        return image

    def download(self, buffer: Any, array: np.ndarray[Any, Any]) -> None:
        """Copy the start of `buffer` into a contiguous `array`."""
        with _errors(self):
            self._settle()
            opencl().enqueue_copy(self.queue, array, buffer)

    @contextlib.contextmanager
    def mapped(
        self, buffer: Any, shape: tuple[int, ...], *, write: bool, kind: type[np.generic] = np.float32
    ) -> Iterator[np.ndarray[Any, Any]]:
        """A buffer of numbers of `kind` as an array: no copy where the device shares the host's memory."""
        cl = opencl()
        flags = cl.map_flags.WRITE if write else cl.map_flags.READ
        with _errors(self):
            self._settle()
            array, _ = cl.enqueue_map_buffer(self.queue, buffer, flags, 0, shape, kind, is_blocking=True)
        try:
            yield array
        finally:
            array.base.release(self.queue)

    def finish(self) -> None:
        """Wait until all that was launched is done. Ctrl-C ends the wait where the runtime is still finishing a kernel."""
        with _errors(self):
            self._settle()
            self.queue.finish()

    def _settle(self) -> None:
        """Wait for kernels that the runtime is finishing, in seconds that a wait of its own would not hear Ctrl-C in."""
        if not self._fresh:
            return
        queue = self.queue
        if threading.current_thread() is threading.main_thread() and not self._soon_done(queue):
            _Task(lambda: self._done(queue)).wait()
        else:
            self._done(queue)

    def _soon_done(self, queue: Any) -> bool:
        """Whether all that was launched is done before a thread that waits for it would be worth its while."""
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
        """When all that was launched is done: keep what was built for it, let memory go that nobody wants any more."""
        fresh = set(self._fresh)
        left = [number for number, (owner, _) in list(self._held.items()) if owner() is None]
        queue.finish()
        for number in left:
            self._held.pop(number, None)
        for launches in fresh:
            launches.keep()
        self._fresh -= fresh

    def _hold(self, owner: Any, memory: Any) -> int:
        """Keep memory until its owner is gone, and kernels are done with it; what it is held under.

        An owner that took the memory with it in its own ``__del__`` would free it under a kernel where Ctrl-C comes just then.
        """
        number = next(self._numbers)  # never given twice: two threads may let go of the same one
        self._held[number] = weakref.ref(owner, self._sweep), memory
        return number

    def _sweep(self, _: object = None) -> None:
        """Let memory go that nobody wants any more, when kernels are done with it; for what raises here there is no caller."""
        try:
            if self._process != os.getpid():
                return  # the queue of a forked child never ends
            queue = self.queue
            if self._fresh:
                _Task(lambda: self._done(queue))
            else:
                self._done(queue)
        except KeyboardInterrupt:
            _thread.interrupt_main()  # to be raised where somebody hears it
        except Exception:
            return  # it is tried again when more is to go

    def _end(self) -> None:
        """At the end of the process: a runtime does not survive it while it compiles."""
        if self._process != os.getpid():
            return
        queue = self.__dict__.get("queue")
        try:
            for task in list(self._building.values()):
                with contextlib.suppress(Exception):
                    task.wait()
            with contextlib.suppress(Exception):
                if self._fresh:
                    _Task(lambda: self._done(queue)).wait()  # what was built is kept for the next process
                if queue is not None:
                    queue.finish()
        except KeyboardInterrupt:
            os._exit(130)  # who cannot wait for it need not

    def alone(self, dimensions: int) -> tuple[int, ...] | None:
        """One work-item a group on processors; elsewhere the runtime chooses.

        PoCL builds a kernel for each size of its groups; left to itself it takes another for almost each size of the work.
        """
        return (1,) * dimensions if self.kind == "cpu" else None

    @property
    def errors(self) -> contextlib.AbstractContextManager[None]:
        """OpenCL's errors, raised inside, come out as ours."""
        return _errors(self)


def _float_format() -> Any:
    cl = opencl()
    return cl.ImageFormat(cl.channel_order.R, cl.channel_type.FLOAT)


class _Pages(np.ndarray[Any, np.dtype[np.uint8]]):
    """What owns memory that kernels work in: the base of all its views."""


def _huge_pages(size: int, device: Device) -> NDArray[np.uint8]:
    """Fresh memory, zero, in pages of 2 MiB where the system has them; Linux only.

    Rows of a volume lie in pages of their own if these have 4 KiB: most of a sample's time then goes to finding
    pages, and most of an upload's to getting them.
    """
    try:
        area = mmap.mmap(-1, size + _HUGE_PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise OutOfMemoryError(f"there is no room for {size / 2**20:.0f} MiB: {error}") from error
    with contextlib.suppress(OSError):  # a kernel built without them
        area.madvise(mmap.MADV_HUGEPAGE)
    memory = np.frombuffer(area, np.uint8).view(_Pages)
    device._hold(memory, area)  # after an interrupt some kernels may still be running
    skip = -memory.ctypes.data % _HUGE_PAGE
    return memory[skip : skip + size].view(np.ndarray)


@contextlib.contextmanager
def _errors(device: Device) -> Iterator[None]:
    _require_unforked(device._process)
    if device._gone:
        raise DeviceError(device._gone)
    cl = opencl()
    try:
        yield
    except cl.MemoryError as error:
        raise OutOfMemoryError(f"{device.name} is out of memory: {error}") from error
    except cl.Error as error:
        if any(name in str(error) for name in _GONE):
            device._gone = f"{device.name} is gone, or its driver was started anew ({error}); start the program again to use it"
            raise DeviceError(device._gone) from error
        raise DeviceError(f"{device.name} failed: {error}") from error


# -- choosing ------------------------------------------------------------------------------------------

_lock = threading.Lock()
_devices: dict[int, Device] = {}
_process: int | None = None  # the one that first queried OpenCL for its devices


def _require_unforked(process: int | None) -> None:
    """A runtime's threads do not live on in a forked child: even a context made there hangs."""
    if process not in (None, os.getpid()):
        raise DeviceError("OpenCL devices cannot be used after a fork; start processes with 'spawn' or 'forkserver'")


def devices() -> list[Device]:
    """Every OpenCL device found, the one used by default first: GPUs, then the processor.

    Of several runtimes for the processor PoCL comes first, the fastest. Those that would end the process are last.
    """
    global _process
    _require_unforked(_process)
    cl = opencl()
    _process = os.getpid()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports an error where it finds no platform
        platforms = []
    found: list[Device] = []
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:
            continue
        for handle in handles:
            if handle.available and handle.compiler_available:
                with _lock:
                    found.append(_devices.setdefault(handle.int_ptr, Device(handle)))

    def rank(device: Device) -> tuple[bool, int, bool]:
        pocl = device.is_pocl and device.kind == "cpu"
        return len(found) > 1 and bool(device.fault), ("gpu", "cpu", "accelerator").index(device.kind), not pocl

    return sorted(found, key=rank)


def as_device(choice: Device | str | int | None = None) -> Device:
    """The device to compute on.

    Parameters
    ----------
    choice : Device, str, int or None
        A device; its number in ``clvol devices``; "cpu" or "gpu"; or a part of its name or its
        platform's. None takes the environment variable ``CLVOL_DEVICE``, else the first.

    Raises
    ------
    DeviceError
        No OpenCL platform or device, or it cannot be used; the message says what to install.
    OptionError
        No device is called so.
    """
    if isinstance(choice, Device):
        return choice
    default = False
    if choice is None:
        choice = os.environ.get("CLVOL_DEVICE") or 0
        default = choice == 0
    found = devices()
    if not found:
        faults = "".join(f"; {library} is left out, a trial of it {why}" for library, why in kept_out().items())
        raise DeviceError(f"no OpenCL device was found{faults}. {INSTALL}. 'clvol doctor' says more")
    if default:
        _tell_change(found)
    text = str(choice).strip().lower()
    if text.isdecimal() and len(text) < 10:  # "²" is a digit, but no number
        if int(text) < len(found):
            return found[int(text)]
    else:
        for device in found:
            if text == device.kind or (text not in _KINDS and text in f"{device.platform} {device.name}".lower()):
                return device
    names = [f"{i} ({d.kind}: {d.name}, {d.platform})" for i, d in enumerate(found)]
    raise one_of("device", choice, ["'cpu', 'gpu', or a part of a name", *names])


def _found_again(platform: str, name: str, number: int) -> Device:
    """The device that was pickled in another process; `OptionError` where there is none of that name."""
    alike = [device for device in devices() if (device.platform, device.name) == (platform, name)]
    return alike[min(number, len(alike) - 1)] if alike else as_device(f"{platform} {name}")


@lru_cache(maxsize=1)
def _last_default() -> str:
    """The default device when it was last used, in any process; "" if that is not known."""
    folder = cache.folder()
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return (folder / "default-device").read_text(encoding="utf-8") if folder else ""
    return ""


def _tell_change(found: list[Device]) -> None:
    """Warn where the default is another device than in the process before, as when a platform was installed; note it."""
    names = [f"{device.name} ({device.platform})" for device in found]
    last = _last_default()
    if names[0] == last:
        return
    if last:
        rest = "gone"
        if last in names:
            number = names.index(last)
            rest = f"number {number} now; CLVOL_DEVICE={found[number].name!r} chooses it"
        message = f"devices are numbered anew, and the default is {names[0]}: {last}, the default before, is {rest}"
        warnings.warn(message, ClvolWarning, stacklevel=3)
    folder = cache.folder()
    if folder:
        with contextlib.suppress(OSError):
            cache.replace(folder / "default-device", names[0].encode())
    _last_default.cache_clear()


# -- PoCL ------------------------------------------------------------------------------------------------

_named = lru_cache(processor.name_processor)
_LINKER = (
    "; install 'binutils' and 'gcc' (Debian, Ubuntu: apt install binutils gcc), or another OpenCL runtime: "
    "'pip install clvol[intel]' brings one that needs neither"
)
