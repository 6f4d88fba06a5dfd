"""Choosing an OpenCL device; every quirk of a device or its runtime is a named predicate here."""

from __future__ import annotations

import contextlib
import ctypes
import math
import mmap
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol import processor, program
from clvol.checks import one_of
from clvol.errors import DeviceError, OutOfMemoryError
from clvol.opencl import INSTALL, opencl
from clvol.program import Defines, Program

__all__ = ["Device", "Limits", "Tile", "as_device", "devices"]

_KINDS = ("cpu", "gpu", "accelerator")
_HUGE_PAGE = 1 << 21
_SAMPLER_POSITIONS = 4097
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
    """How the work on a device is cut into parts; no result depends on it.

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
    """

    launch_seconds: float = 0.25
    launch_voxels: int = 1 << 26
    launch_taps: int = 1 << 25
    sorted_bytes: int = 32 << 20
    sorting: bool | None = None
    tile: Tile | None = None


_LIMITS = Limits()


class Device:
    """One OpenCL device with its context and queue, made once for each process.

    Use `as_device` to get one. Buffers, programs and renderers hold the device they were made on.
    """

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self._process = os.getpid()
        self._lock = threading.RLock()
        self._programs: dict[Any, Program] = {}
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

    @cached_property
    def context(self) -> Any:
        self.require_usable()
        with _errors(self):
            return opencl().Context([self.handle])

    @cached_property
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

    @cached_property
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

    @cached_property
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
    def shares_memory(self) -> bool:
        """Whether mapped buffers are the host's own memory."""
        return bool(self.handle.host_unified_memory)

    def require_usable(self) -> None:
        """Raise `DeviceError` where using the device would hang or abort the process.

        A PoCL context used after a fork hangs; PoCL shells out to the linker for every kernel
        and aborts the process when there is none, or no libgcc and libc for it to link; it cannot
        build for a processor that it has no name for, and is given one.
        """
        _require_unforked(self._process)
        if self.is_pocl and self.kind == "cpu":
            _named(self.handle.int_ptr)
            _require_linker()

    # -- kernels -------------------------------------------------------------------------------

    def build(
        self, name: str, defines: Defines, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None
    ) -> Program:
        """The program of one kernel file (see `program.source`), specialised; built at most once for each set of defines."""
        self.require_usable()
        key = (name, *(tuple(sorted((given or {}).items())) for given in (defines, replacements, generated)))
        with self._lock:
            if key not in self._programs:
                text = program.source(name, replacements, generated, defines)
                with self.errors:
                    self._programs[key] = program.build(self.context, text)
            return self._programs[key]

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

    def require_room(self, size: int) -> None:
        """Raise `OutOfMemoryError` before a runtime would abort: PoCL finds out only when memory is touched."""
        largest, everything = int(self.handle.max_mem_alloc_size), int(self.handle.global_mem_size)
        if size > largest or size > _MEMORY_SHARE * everything:
            raise OutOfMemoryError(
                f"{self.name} allows one allocation of up to {largest / 2**20:.0f} MiB and holds "
                f"{everything / 2**20:.0f} MiB; got {size / 2**20:.0f} MiB"
            )

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
    def lent(self, array: np.ndarray[Any, Any], *, write: bool) -> Iterator[Any]:
        """A contiguous array as a buffer for the time of a block, read or written by kernels.

        No copy where the device shares the host's memory.
        """
        cl = opencl()
        flags = cl.mem_flags.READ_WRITE if write else cl.mem_flags.READ_ONLY
        self.require_room(array.nbytes)
        with _errors(self):
            if self.shares_memory:
                buffer = cl.Buffer(self.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=array)
            elif write:
                buffer = cl.Buffer(self.context, flags, array.nbytes)
            else:
                buffer = cl.Buffer(self.context, flags | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)
            try:
                yield buffer
                if write and self.shares_memory:  # mapping is what makes the host's view complete
                    view, _ = cl.enqueue_map_buffer(self.queue, buffer, cl.map_flags.READ, 0, array.shape, array.dtype)
                    view.base.release(self.queue)
                elif write:
                    cl.enqueue_copy(self.queue, array, buffer)
                self.queue.finish()
            finally:
                with contextlib.suppress(cl.Error):
                    self.queue.finish()  # after an error too: a kernel may still be writing to the array
                buffer.release()

    @contextlib.contextmanager
    def lent_span(self, array: np.ndarray[Any, Any], *, write: bool) -> Iterator[tuple[Any, np.int64, NDArray[np.int64]]]:
        """The memory that an array [z, y, x] of any layout lies in, as `lent`; where it starts there; its strides along x, y, z.

        Where it starts and its strides count elements, and must be whole numbers of them. A device that does not share the host's
        memory writes all of it back, gaps included.
        """
        width = array.itemsize
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
            opencl().enqueue_copy(self.queue, array, buffer)

    @contextlib.contextmanager
    def mapped(
        self, buffer: Any, shape: tuple[int, ...], *, write: bool, kind: type[np.generic] = np.float32
    ) -> Iterator[np.ndarray[Any, Any]]:
        """A buffer of numbers of `kind` as an array: no copy where the device shares the host's memory."""
        cl = opencl()
        flags = cl.map_flags.WRITE if write else cl.map_flags.READ
        with _errors(self):
            array, _ = cl.enqueue_map_buffer(self.queue, buffer, flags, 0, shape, kind, is_blocking=True)
        try:
            yield array
        finally:
            array.base.release(self.queue)

    def finish(self) -> None:
        with _errors(self):
            self.queue.finish()

    @property
    def errors(self) -> contextlib.AbstractContextManager[None]:
        """OpenCL's errors, raised inside, come out as ours."""
        return _errors(self)


def _float_format() -> Any:
    cl = opencl()
    return cl.ImageFormat(cl.channel_order.R, cl.channel_type.FLOAT)


class _Pages(mmap.mmap):
    """Memory that kernels work in. It goes when they are done: after an interrupt some may still be running."""

    device: Device | None = None

    def __del__(self) -> None:
        if self.device is not None:
            with contextlib.suppress(Exception):
                self.device.finish()


def _huge_pages(size: int, device: Device) -> NDArray[np.uint8]:
    """Fresh memory, zero, in pages of 2 MiB where the system has them; Linux only.

    Rows of a volume lie in pages of their own if these have 4 KiB: most of a sample's time then goes to finding
    pages, and most of an upload's to getting them.
    """
    try:
        area = _Pages(-1, size + _HUGE_PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise OutOfMemoryError(f"there is no room for {size / 2**20:.0f} MiB: {error}") from error
    area.device = device
    with contextlib.suppress(OSError):  # a kernel built without them
        area.madvise(mmap.MADV_HUGEPAGE)
    memory = np.frombuffer(area, np.uint8)
    skip = -memory.ctypes.data % _HUGE_PAGE
    return memory[skip : skip + size]


@contextlib.contextmanager
def _errors(device: Device) -> Iterator[None]:
    _require_unforked(device._process)
    cl = opencl()
    try:
        yield
    except cl.MemoryError as error:
        raise OutOfMemoryError(f"{device.name} is out of memory: {error}") from error
    except cl.Error as error:
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

    Of several runtimes for the processor PoCL comes first, the fastest; but last where it cannot link its kernels.
    """
    global _process
    _require_unforked(_process)
    cl = opencl()
    _process = os.getpid()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports an error where it finds no platform
        platforms = []
    found = []
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:
            continue
        for handle in handles:
            if handle.available and handle.compiler_available:
                with _lock:
                    found.append(_devices.setdefault(handle.int_ptr, Device(handle)))
    several = sum(d.kind == "cpu" for d in found) > 1

    def rank(device: Device) -> tuple[int, int]:
        pocl = several and device.is_pocl and device.kind == "cpu"
        return ("gpu", "cpu", "accelerator").index(device.kind), 1 if not pocl else 2 if why_pocl_fails() else 0

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
    if choice is None:
        choice = os.environ.get("CLVOL_DEVICE") or 0
    found = devices()
    if not found:
        raise DeviceError(f"no OpenCL device was found. {INSTALL}. 'clvol doctor' says more")
    text = str(choice).strip().lower()
    if text.isdigit():
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


# -- PoCL and the linker ---------------------------------------------------------------------------------

_PROBE = """
import runpy, pyopencl as cl
for p in cl.get_platforms():
    if "portable computing language" in p.name.lower():
        d = p.get_devices()[0]
        kept = runpy.run_path(%r)
        kept["name_processor"](d.int_ptr)
        c = cl.Context([d]); q = cl.CommandQueue(c)
        k = cl.Program(c, "kernel void probe_%s(global int *a) { a[0] = 1; }").build()
        cl.Kernel(k, "probe_%s")(q, (1,), None, cl.Buffer(c, cl.mem_flags.READ_WRITE, 4)); q.finish()
"""


_named = lru_cache(processor.name_processor)


def _require_linker() -> None:
    reason = why_pocl_fails()
    if reason:
        raise DeviceError(
            f"{reason}; install 'binutils' and 'gcc' (Debian, Ubuntu: apt install binutils gcc), or another OpenCL runtime: "
            "'pip install clvol[intel]' brings one that needs neither"
        )


@lru_cache(maxsize=1)
def why_pocl_fails() -> str:
    """Why PoCL cannot build kernels here; "" if it can.

    PoCL links each kernel with ``ld`` against libc and libgcc; without them the process aborts. So another process tries first;
    that it worked is noted in clvol's cache for the next time.
    """
    linker = shutil.which("ld")
    if linker is None:
        return "PoCL needs the linker 'ld' to finish a kernel, and there is none on PATH"
    import pyopencl

    stamp = f"{linker} {Path(linker).stat().st_mtime_ns} {os.environ.get('POCL_CACHE_DIR', '')} {pyopencl.VERSION_TEXT}"
    mark = _cache_folder() / "pocl-links"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if mark.read_text(encoding="utf-8") == stamp:
            return ""
    name = os.urandom(4).hex()  # a kernel that no cache knows
    environment = {**os.environ, "PYOPENCL_NO_CACHE": "1"}
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _PROBE % (processor.__file__, name, name)],
            capture_output=True,
            env=environment,
            timeout=120,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"PoCL could not be tried: {error}"
    if trial.returncode != 0:
        last = trial.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        return f"PoCL cannot build kernels here ({last[0]})"
    with contextlib.suppress(OSError):
        mark.parent.mkdir(parents=True, exist_ok=True)
        temporary = mark.with_name(f"{mark.name}.{os.getpid()}")
        temporary.write_text(stamp, encoding="utf-8")
        temporary.replace(mark)
    return ""


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clvol"
