"""Memory of a device: buffers, images, and host arrays that kernels read and write in place."""

from __future__ import annotations

import contextlib
import ctypes
import math
import mmap
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import OutOfMemoryError
from clvol.device.driver import Driver
from clvol.device.launches import Launches
from clvol.device.opencl import opencl

__all__ = ["Buffers", "float_format"]

_HUGE_PAGE = 1 << 21  # bytes
_MEMORY_SHARE = 0.9  # of the device's memory: PoCL allocates lazily, and the process aborts when there is none left


class _Loan:
    """Lives as long as the `with` block that borrows memory, however that ends."""

    __slots__ = ("__weakref__",)


class _Kept:
    """See `Buffers.kept`; a class, since that takes half the time of a generator."""

    __slots__ = ("_launches", "_memory")

    def __init__(self, launches: Launches, memory: Any) -> None:
        self._launches, self._memory = launches, memory

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._launches.hold(_Loan(), self._memory)


class _Pages(np.ndarray[Any, np.dtype[np.uint8]]):
    """Owner of memory that kernels use: the base of all its views."""


def float_format() -> Any:
    """Image format of one float32 per texel."""
    cl = opencl()
    return cl.ImageFormat(cl.channel_order.R, cl.channel_type.FLOAT)


class Buffers:
    """Buffers and images on one device."""

    def __init__(self, driver: Driver, launches: Launches) -> None:
        self._driver = driver
        self._launches = launches

    def allocate(self, size: int) -> Any:
        """A read-write buffer of `size` bytes."""
        cl, driver = opencl(), self._driver
        size = max(int(size), 4)
        self.require_room(size)
        with driver.errors:
            if driver.kind == "cpu" and size >= 2 * _HUGE_PAGE and hasattr(mmap, "MADV_HUGEPAGE"):
                pages = self._huge_pages(size)
                return cl.Buffer(driver.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=pages)
            return cl.Buffer(driver.context, cl.mem_flags.READ_WRITE, size)

    def require_room(self, size: int, *, held: bool = False) -> None:
        """Raise `OutOfMemoryError` before a runtime would abort: PoCL notices only when memory is touched.

        A processor's buffers are memory of this process, of which a container may have less than the device reports. `held` means
        that the memory is allocated already.
        """
        driver = self._driver
        largest, total = driver.largest, driver.total
        if size > largest or size > _MEMORY_SHARE * total:
            raise OutOfMemoryError(
                f"{driver.name} allows one allocation of up to {largest / 2**20:.0f} MiB and holds "
                f"{total / 2**20:.0f} MiB; got {size / 2**20:.0f} MiB"
            )
        if driver.kind == "cpu" and not held:
            memory.require(size, f"a buffer of {driver.name}")

    def upload(self, array: np.ndarray[Any, Any]) -> Any:
        """A read-only buffer with a copy of `array`."""
        cl, driver = opencl(), self._driver
        array = np.ascontiguousarray(array)
        self.require_room(array.nbytes)
        with driver.errors:
            return cl.Buffer(driver.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def shared(self, array: np.ndarray[Any, Any]) -> Any:
        """A contiguous array as a buffer that kernels of PoCL read and write in place, for longer than a block."""
        cl, driver = opencl(), self._driver
        with driver.errors:
            return cl.Buffer(driver.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=array)

    def download(self, buffer: Any, array: np.ndarray[Any, Any]) -> None:
        """Copy the start of `buffer` into a contiguous `array`."""
        driver = self._driver
        with driver.errors:
            self._launches.settle()
            opencl().enqueue_copy(driver.queue, array, buffer)

    def kept(self, memory: Any) -> contextlib.AbstractContextManager[None]:
        """Keep memory for kernels that may still be using it when the block raises; at its end they must be done."""
        return _Kept(self._launches, memory)

    def copy(self, source: Any, target: Any, size: int) -> None:
        """Copy the first bytes of a buffer to another."""
        driver = self._driver
        with driver.errors:
            opencl().enqueue_copy(driver.queue, target, source, byte_count=size)

    def clear(self, buffer: Any, first: int, count: int, kind: type[np.generic] = np.float32) -> None:
        """Set `count` numbers of a buffer, from number `first` on, to zero."""
        driver = self._driver
        width = np.dtype(kind).itemsize
        with driver.errors:
            opencl().enqueue_fill_buffer(driver.queue, buffer, np.float32(0), width * first, width * count)

    @contextlib.contextmanager
    def mapped(
        self, buffer: Any, shape: tuple[int, ...], *, write: bool, kind: type[np.generic] = np.float32
    ) -> Iterator[np.ndarray[Any, Any]]:
        """A buffer of numbers of `kind` as an array; no copy if the device shares host memory."""
        cl, driver = opencl(), self._driver
        flags = cl.map_flags.WRITE if write else cl.map_flags.READ
        with driver.errors:
            self._launches.settle()
            array, _ = cl.enqueue_map_buffer(driver.queue, buffer, flags, 0, shape, kind, is_blocking=True)
        try:
            yield array
        finally:
            array.base.release(driver.queue)

    @contextlib.contextmanager
    def lent(self, array: np.ndarray[Any, Any], *, write: bool, begun: bool = False) -> Iterator[Any]:
        """A contiguous array as a buffer for the duration of a block, read or written by kernels.

        No copy if the device shares host memory. Otherwise kernels that write find the array's values in it only if `begun`.
        """
        cl, driver = opencl(), self._driver
        shares_memory = driver.shares_memory
        flags = cl.mem_flags.READ_WRITE if write else cl.mem_flags.READ_ONLY
        self.require_room(array.nbytes, held=shares_memory)
        with driver.errors:
            if shares_memory:
                buffer = cl.Buffer(driver.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=array)
            elif write and not begun:
                buffer = cl.Buffer(driver.context, flags, array.nbytes)
            else:
                buffer = cl.Buffer(driver.context, flags | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)
            held = self._launches.hold(loan := _Loan(), (buffer, array))  # after an error kernels may still be writing to it
            yield buffer
            self._launches.settle()
            queue = driver.queue
            if write and shares_memory:  # mapping makes the host's view complete
                view, _ = cl.enqueue_map_buffer(queue, buffer, cl.map_flags.READ, 0, array.shape, array.dtype)
                view.base.release(queue)
            elif write:
                cl.enqueue_copy(queue, array, buffer)
            queue.finish()
            self._launches.let_go(held)
            del loan
            buffer.release()

    @contextlib.contextmanager
    def lent_span(self, array: np.ndarray[Any, Any], *, write: bool) -> Iterator[tuple[Any, np.int64, NDArray[np.int64]]]:
        """The memory spanned by an array [z, y, x] of any layout, as `lent`; the offset of its first element; its x, y, z strides.

        Offset and strides count elements; the array's strides must be multiples of the element size. A device that does not share
        host memory writes the whole span back, gaps included.
        """
        driver = self._driver
        width = array.itemsize
        if not write and array.size:  # the span of a view of a large array may exceed the device's limit, and costs more to copy
            span_bytes = width + sum((n - 1) * abs(stride) for n, stride in zip(array.shape, array.strides, strict=True))
            if span_bytes > (driver.largest if driver.shares_memory else min(driver.largest, 2 * array.nbytes)):
                array = np.ascontiguousarray(array)
        reaches = [(n - 1) * stride for n, stride in zip(array.shape, array.strides, strict=True)]
        before = -sum(reach for reach in reaches if reach < 0)
        length = (before + sum(reach for reach in reaches if reach > 0)) // width + 1
        lowest = array[tuple(slice(-1, None) if reach < 0 else slice(0, 1) for reach in reaches)]
        span = np.lib.stride_tricks.as_strided(lowest, (length,), (width,))
        # Intel's runtime copies memory that is not aligned to its vectors, so the span starts earlier, on the same page
        more = lowest.ctypes.data % (driver.handle.mem_base_addr_align // 8)
        if write or not driver.shares_memory or more % width:
            more = 0
        if more:
            start = (ctypes.c_byte * (more + span.nbytes)).from_address(lowest.ctypes.data - more)
            span = np.frombuffer(start, array.dtype)
        with self.lent(span, write=write) as buffer:
            strides = [stride // width for stride in array.strides[::-1]]
            yield buffer, np.int64((more + before) // width), np.array([*strides, 0], np.int64)

    def image_of(self, buffer: Any, shape: tuple[int, int, int]) -> Any:
        """A float image of shape (z, y, x) with the first numbers of `buffer`."""
        cl, driver = opencl(), self._driver
        if max(shape) > driver.image_limit:
            raise OutOfMemoryError(f"{driver.name} holds images up to {driver.image_limit} wide; got {shape}")
        self.require_room(4 * math.prod(shape))
        with driver.errors:
            create = getattr(cl, "create_image", cl.Image)  # replaces Image(), which is deprecated
            image = create(driver.context, cl.mem_flags.READ_ONLY, float_format(), shape=shape[::-1])
            cl.enqueue_copy(driver.queue, image, buffer, offset=0, origin=(0, 0, 0), region=shape[::-1]).wait()
        return image

    def _huge_pages(self, size: int) -> NDArray[np.uint8]:
        """Zeroed memory in pages of 2 MiB where the system has them; Linux only.

        With pages of 4 KiB every row of a volume lies on another page: page walks then dominate sampling, and page faults uploads.
        """
        try:
            area = mmap.mmap(-1, size + _HUGE_PAGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        except OSError as error:
            raise OutOfMemoryError(f"there is no room for {size / 2**20:.0f} MiB: {error}") from error
        with contextlib.suppress(OSError):  # a kernel without huge pages
            area.madvise(mmap.MADV_HUGEPAGE)
        pages = np.frombuffer(area, np.uint8).view(_Pages)
        self._launches.hold(pages, area)  # after an interrupt some kernels may still be running
        skip = -pages.ctypes.data % _HUGE_PAGE
        return pages[skip : skip + size].view(np.ndarray)
