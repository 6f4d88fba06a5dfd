"""An OpenCL runtime for tests: clang compiles the kernels, sanitized, for the host, which runs one work-item after the other.

`install` puts it in the place of pyopencl, so that all of clvol runs on it. Every buffer is memory of its own, exactly as long as
it was asked for, in which nothing was written yet: what a kernel reads or writes outside of it, and what its arithmetic
leaves undefined, ends the process with a report that names the line of the kernel. The address sanitizer must be in the process
before Python is: `environment` says how.
"""

# ruff: noqa: ARG001, ARG002  (signatures are pyopencl's)

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as real
from numpy.typing import NDArray

from clvol.device import cache, opencl, probe

HERE = Path(__file__).parent
VERSIONS = ("", *(f"-{n}" for n in range(14, 23)))  # of clang
FLAGS = ("-cl-std=CL1.2", "-Xclang", "-finclude-default-header", "-target", "x86_64-pc-linux-gnu")
# a mode or filter may not use what others need; and vectors are wider than the oldest processors' registers
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wno-unused-function", "-Wno-psabi")
SANITIZED = ("-O0", "-g1", "-fPIC", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-shared-libasan")
FILLED = 0x7F  # the bytes of new buffers: large numbers, and no whole number that is an index

ALIGNMENT = 128  # of buffers, in bytes
_LIBRARY = ctypes.CDLL(None)

POINTER, VALUE, IMAGE = range(3)  # kinds of arguments


def clang() -> str | None:
    """The compiler, if it is installed with its sanitizers."""
    for version in VERSIONS:
        found = shutil.which(f"clang{version}")
        if found and _asan(found):
            return found
    return None


def _asan(compiler: str) -> str | None:
    name = f"libclang_rt.asan-{os.uname().machine}.so"
    for each in (name, "libclang_rt.asan.so"):
        path = subprocess.run(
            [compiler, f"-print-file-name={each}"], capture_output=True, encoding="utf-8", check=True
        ).stdout.strip()
        if Path(path).is_file():
            return path
    return None


def environment(compiler: str) -> dict[str, str]:
    """The environment of a process that runs sanitized kernels."""
    return {
        **os.environ,
        "LD_PRELOAD": _asan(compiler) or "",
        # Python itself leaks, and handles its own faults; memory of gigabytes stays untouched
        "ASAN_OPTIONS": f"detect_leaks=0:max_malloc_fill_size={1 << 24}:malloc_fill_byte={FILLED}:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }


def _poison(start: int, size: int) -> None:
    _LIBRARY["__asan_poison_memory_region"](ctypes.c_void_p(start), ctypes.c_size_t(size))


class Buffer:
    """Separate memory, even with USE_HOST_PTR: mapping copies between the two."""

    _start = 0

    def __init__(self, context: Any, flags: int, size: int = 0, hostbuf: NDArray[Any] | None = None) -> None:
        self.size = size if hostbuf is None else hostbuf.nbytes
        self._host = hostbuf if flags & real.mem_flags.USE_HOST_PTR else None
        # aligned as a runtime aligns its own memory, or as the host's array is
        before = 0 if self._host is None else self._host.ctypes.data % ALIGNMENT
        self._start = _LIBRARY.memalign(ALIGNMENT, before + self.size)
        if not self._start:
            raise real.MemoryError(f"{self.size} bytes")
        _poison(self._start, before)
        self.address = self._start + before
        if hostbuf is not None:
            ctypes.memmove(self.address, hostbuf.ctypes.data, self.size)

    def view(self, first: int, size: int) -> NDArray[np.uint8]:
        return np.frombuffer((ctypes.c_uint8 * size).from_address(self.address + first), np.uint8)

    def to_host(self) -> None:
        if self._host is not None and self._host.flags.writeable:
            ctypes.memmove(self._host.ctypes.data, self.address, self.size)

    def release(self) -> None:
        if self._start:
            _LIBRARY.free(self._start)
            self._start = 0

    def __del__(self) -> None:
        self.release()


class Mapped:
    """The base of an array in a buffer's memory."""

    def __init__(self, buffer: Buffer, offset: int, shape: Sequence[int], kind: np.dtype[Any]) -> None:
        self._buffer = buffer
        self.__array_interface__ = {
            "shape": tuple(int(n) for n in shape),
            "typestr": kind.str,
            "data": (buffer.address + offset, False),
            "version": 3,
        }

    def release(self, queue: Any) -> None: ...


class Image:
    """A float image of a few texels."""

    def __init__(self, context: Any, flags: int, format: Any, shape: tuple[int, ...]) -> None:
        self.texels = Buffer(context, 0, 4 * int(np.prod(shape)))
        self.record = np.array([self.texels.address, *np.array([*shape, 0], np.int32).view(np.int64)], np.int64)

    def release(self) -> None:
        self.texels.release()


class Program:
    """One compiled kernel file; each text is compiled once per machine."""

    def __init__(self, context: Any, text: str) -> None:
        self.text = text

    def build(self, options: Sequence[str] = ()) -> Program:
        compiler = clang()
        assert compiler
        extra = os.environ.get("CLVOL_SANITIZED_FLAGS", "").split()
        parts = [
            self.text,
            *WARNINGS,
            *SANITIZED,
            *extra,
            *(path.read_text() for path in sorted(HERE.glob("*.[ch]*"))),
            Path(__file__).read_text(),
        ]
        name = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]
        folder = Path(os.environ.get("CLVOL_SANITIZED_CACHE") or Path(tempfile.gettempdir()) / "clvol-sanitized")
        made = folder / f"{name}.so"
        plain = {key: value for key, value in os.environ.items() if key != "LD_PRELOAD"}

        def run(*arguments: str, given: str) -> str:
            done = subprocess.run(
                [compiler, *arguments], input=given, capture_output=True, encoding="utf-8", env=plain, check=False
            )
            if done.returncode:
                raise real.RuntimeError(done.stderr)
            return done.stdout

        expanded = run("-x", "cl", *FLAGS, *extra, "-w", "-E", "-P", "-", given=self.text)
        self.kernels = {
            match[1]: [_parameter(p) for p in match[2].split(",")]
            for match in re.finditer(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(([^)]*)\)\s*{", expanded)
        }
        if not made.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            temporary = folder / f"{name}.{os.getpid()}.so"
            text = f'#include "{HERE}/hostile.h"\n' + self.text + "".join(_runner(k, p) for k, p in self.kernels.items())
            compiled = Path(f"{temporary}.o")
            run("-x", "cl", *FLAGS, *WARNINGS, *SANITIZED, *extra, "-c", "-o", str(compiled), "-", given=text)
            run(
                "-shared",
                "-w",
                "-Wl,-z,defs",
                *SANITIZED,
                "-o",
                str(temporary),
                str(compiled),
                str(HERE / "builtins.c"),
                "-lm",
                given="",
            )
            compiled.unlink()
            temporary.replace(made)
        self.library = ctypes.CDLL(str(made))
        self.library.clvol_launch.argtypes = [ctypes.c_void_p] * 5
        return self


def _parameter(text: str) -> tuple[int, str]:
    words = re.sub(r"\b(?:restrict|__restrict|const|__const)\b", "", text).replace("*", " * ").split()[:-1]
    if "image3d_t" in words:
        return IMAGE, "read_only image3d_t"
    return (POINTER if words[-1] == "*" else VALUE), " ".join(words)


def _runner(name: str, parameters: list[tuple[int, str]]) -> str:
    """A function that calls a kernel with the table's arguments: pointers, and addresses of values."""
    given = [
        "image" if how == IMAGE else f"({kind})(size_t)table[{i}]" if how == POINTER else f"*(global {kind} *)(size_t)table[{i}]"
        for i, (how, kind) in enumerate(parameters)
    ]
    image = ", read_only image3d_t image" if "image" in given else ""
    widths = ", ".join(f"sizeof({kind})" if how == VALUE else "0" for how, kind in parameters)
    return (
        f"\nvoid clvol_run_{name}(global ulong *table{image}) {{ {name}({', '.join(given)}); }}"
        f"\nint clvol_width_{name}(int i) {{ const int widths[] = {{ {widths} }}; return widths[i]; }}\n"
    )


class Kernel:
    def __init__(self, program: Program, name: str) -> None:
        if name not in program.kernels:
            raise real.LogicError(f"no kernel {name}")
        self._library, self._parameters = program.library, program.kernels[name]
        self._run, self._width = (getattr(program.library, f"clvol_{what}_{name}") for what in ("run", "width"))

    def set_scalar_arg_dtypes(self, types: Sequence[Any]) -> None:
        """As of pyopencl, for the number of arguments; their types are those of the source."""
        if len(types) != len(self._parameters):
            raise real.LogicError(f"{len(self._parameters)} arguments; got {len(types)}")

    def __call__(
        self, queue: Any, sizes: Sequence[int], local: Sequence[int] | None, *given: Any, global_offset: Sequence[int] | None = None
    ) -> Any:
        if len(given) != len(self._parameters):
            raise real.LogicError(f"{len(self._parameters)} arguments; got {len(given)}")
        table, kept, image = np.zeros(max(1, len(given)), np.uint64), [], 0
        for i, (argument, (how, kind)) in enumerate(zip(given, self._parameters, strict=True)):
            if isinstance(argument, Image):
                kept.append(argument.record)
                image = argument.record.ctypes.data
            elif isinstance(argument, Buffer):
                assert how == POINTER, kind
                table[i] = argument.address
            elif argument is not None:
                assert how == VALUE, kind
                value = np.asarray(argument)
                width = self._width(i)
                if value.nbytes != width:
                    raise real.LogicError(f"argument {i}, {kind}, has {width} bytes; got {value.nbytes}")
                room = np.zeros(64 + 128, np.uint8)
                first = -room.ctypes.data % 64
                room[first : first + value.nbytes] = np.frombuffer(value.tobytes(), np.uint8)
                kept.append(room)
                table[i] = room.ctypes.data + first
        n = len(sizes)
        numbers = np.array([*sizes, *[1] * (3 - n), *(global_offset or [0] * n), *[0] * (3 - n)], np.uint64)
        self._library.clvol_launch(self._run, table.ctypes.data, image, numbers[:3].ctypes.data, numbers[3:].ctypes.data)
        return enqueue_marker(queue)


def enqueue_copy(queue: Any, to: Any, source: Any, **where: Any) -> Any:
    if isinstance(to, Image):
        ctypes.memmove(to.texels.address, source.address + where["offset"], to.texels.size)
    elif isinstance(to, Buffer):
        to.view(0, source.nbytes)[:] = source.reshape(-1).view(np.uint8)
    else:
        ctypes.memmove(to.ctypes.data, source.address, to.nbytes)
    return SimpleNamespace(wait=lambda: None)


def enqueue_fill_buffer(queue: Any, buffer: Buffer, pattern: Any, offset: int, size: int) -> None:
    buffer.view(offset, size)[:] = np.resize(np.asarray(pattern).reshape(-1).view(np.uint8), size)


def enqueue_map_buffer(
    queue: Any, buffer: Buffer, flags: int, offset: int, shape: Sequence[int], dtype: Any, **_: Any
) -> tuple[NDArray[Any], None]:
    buffer.to_host()
    return np.asarray(Mapped(buffer, offset, shape, np.dtype(dtype))), None


def enqueue_marker(queue: Any) -> Any:
    return SimpleNamespace(command_execution_status=real.command_execution_status.COMPLETE)  # launches end before they return


class Queue:
    def __init__(self, context: Any) -> None: ...

    def flush(self) -> None: ...

    def finish(self) -> None: ...


class _Module(ModuleType):
    def __getattr__(self, name: str) -> Any:
        return getattr(real, name)


PLATFORM = SimpleNamespace(name="Sanitized host", vendor="clvol's tests", version="OpenCL 1.2")
DEVICE = SimpleNamespace(
    name="sanitized",
    vendor="clvol's tests",
    version="OpenCL 1.2",
    driver_version="1",
    platform=PLATFORM,
    type=real.device_type.CPU,
    int_ptr=1,
    available=True,
    compiler_available=True,
    extensions="cl_khr_fp64",
    image_support=True,
    image3d_max_width=2048,
    image3d_max_height=2048,
    image3d_max_depth=2048,
    max_compute_units=2,
    max_work_group_size=4096,
    host_unified_memory=True,
    max_mem_alloc_size=1 << 40,
    global_mem_size=1 << 41,
    mem_base_addr_align=8,
    local_mem_size=1 << 16,
)
PLATFORM.get_devices = lambda *_: [DEVICE]


def module() -> ModuleType:
    """The module that clvol imports as pyopencl."""
    made = _Module("pyopencl")
    mine = (Buffer, Program, Kernel, enqueue_copy, enqueue_fill_buffer, enqueue_map_buffer, enqueue_marker)
    made.__dict__.update({each.__name__: each for each in mine})
    made.__dict__.update(
        get_platforms=lambda: [PLATFORM],
        Context=lambda devices: SimpleNamespace(devices=devices),
        CommandQueue=Queue,
        create_image=Image,
        get_supported_image_formats=lambda *_: [real.ImageFormat(real.channel_order.R, real.channel_type.FLOAT)],
    )
    return made


def install() -> None:
    """Make clvol compute on this runtime only."""
    _LIBRARY.memalign.restype = ctypes.c_void_p
    _LIBRARY.memalign.argtypes = [ctypes.c_size_t, ctypes.c_size_t]
    _LIBRARY.free.argtypes = [ctypes.c_void_p]
    runtime = module()
    opencl._loaded = lambda: runtime  # type: ignore[assignment]
    opencl.open_cache = lambda: None
    cache.folder = lambda: None  # its device is not to be noted as this user's default
    probe.tried = lambda: probe.Verdict(devices={probe.identity(DEVICE): ""})
