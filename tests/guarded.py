"""Runs kernels at the edges of their memory with every buffer between pages that nobody may touch.

`python guarded.py start|end [all]` draws, samples and resamples (edges.py). A kernel that reads or writes even a byte before the
start, or past the end, of its buffers ends the process; test_guarded.py runs this. `python guarded.py past N` shows that it does:
its kernel reads the four bytes that end N bytes past the end.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clvol.device import as_device
from clvol.device.buffers import Buffers
from clvol.device.driver import Driver

sys.path.append(str(Path(__file__).parents[1]))
from tests import edges
from tests.declared import declare_few

GUARD = 64 << 20  # bytes before and after
_READ_PAST = """kernel void read_past(global const float *given, const int at, global float *got) { got[0] = given[at]; }"""


def guarded(size: int, side: str) -> NDArray[np.uint8]:
    """Zeros that start, or end, to the byte, where memory that can be used does. Kept until `let_go`.

    At the end their address is a multiple of the size of the numbers in them and of nothing more: kernels may not count on more.
    """
    library = _library()
    library.mmap.restype = ctypes.c_void_p
    library.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
    library.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    room = -(-size // mmap.PAGESIZE) * mmap.PAGESIZE
    start = library.mmap(None, room + 2 * GUARD, 0, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, -1, 0)
    if start in (None, ctypes.c_void_p(-1).value) or library.mprotect(start + GUARD, room, mmap.PROT_READ | mmap.PROT_WRITE):
        raise OSError(ctypes.get_errno(), "guarded memory")
    past = room - size if side == "end" else 0
    return np.frombuffer((ctypes.c_uint8 * size).from_address(start + GUARD + past), np.uint8)


def let_go(memory: NDArray[np.uint8]) -> None:
    """Free the memory of `guarded` once no device uses it: a process may have 65,530 maps."""
    first = memory.ctypes.data // mmap.PAGESIZE * mmap.PAGESIZE - GUARD
    room = -(-memory.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
    _library().munmap(ctypes.c_void_p(first), ctypes.c_size_t(room + 2 * GUARD))


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def guard(side: str) -> None:
    """Make every buffer of every device a guarded one."""

    gone: list[NDArray[np.uint8]] = []  # of buffers that are gone

    class Guarded(cl.Buffer):
        def __init__(self, device: Driver, memory: NDArray[np.uint8]) -> None:
            super().__init__(device.context, cl.mem_flags.USE_HOST_PTR, hostbuf=memory)
            self.memory = memory

        def __del__(self) -> None:
            gone.append(self.memory)

    def allocate(self: Buffers, size: int) -> Any:
        return Guarded(self._driver, guarded(max(int(size), 4), side))

    def upload(self: Buffers, array: NDArray[Any]) -> Any:
        memory = guarded(-(-max(array.nbytes, 4) // 16) * 16, side)  # tables are read as float4, which are aligned
        memory[: array.nbytes] = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        return Guarded(self._driver, memory)

    @contextmanager
    def lent(self: Buffers, array: NDArray[Any], *, write: bool, begun: bool = False) -> Iterator[Any]:  # noqa: ARG001  # as in Buffers
        memory = guarded(array.nbytes, side)
        memory[:] = array.reshape(-1).view(np.uint8)
        buffer = cl.Buffer(self._driver.context, cl.mem_flags.USE_HOST_PTR, hostbuf=memory)
        yield buffer
        self._driver.queue.finish()
        if write:
            array.reshape(-1).view(np.uint8)[:] = memory
        buffer.release()
        let_go(memory)
        while gone:  # no kernel is under way
            let_go(gone.pop())

    for name, method in {"allocate": allocate, "upload": upload, "lent": lent}.items():
        setattr(Buffers, name, method)


def read_past(bytes: int) -> None:
    """The four bytes that end the given distance past buffers of several lengths; 0 is the last number itself."""
    device = as_device()
    kernel = cl.Kernel(cl.Program(device.context, _READ_PAST).build(), "read_past")
    got = device.buffers.allocate(4)
    for count in (1, 1000):
        kernel(device.queue, (1,), None, device.buffers.upload(np.ones(count, np.float32)), np.int32(count - 1 + bytes // 4), got)
        device.finish()


def main(side: str, *more: str) -> None:
    if side == "past":
        guard("end")
        read_past(int(more[0]))
    else:
        guard(side)
        declare_few()
        edges.run(edges.ALL if more else edges.GUARDED)
    print("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
