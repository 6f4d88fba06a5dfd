"""Kernels: read from ``cl/``, includes spliced in, specialised by ``#define``; each thread has kernels of its own."""

from __future__ import annotations

import hashlib
import linecache
import os
import re
import threading
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from clvol.base.errors import DeviceError, OptionError
from clvol.base.interrupted import quiet
from clvol.device.cache import Store
from clvol.device.opencl import opencl
from clvol.device.probe import identity
from clvol.device.runtimes.pocl import KernelCache

__all__ = ["LANES", "Defines", "Kernel", "Program", "Variants", "build", "literal", "source"]

LANES = 8
"""Numbers in one vector of the kernels; rows of coefficients are padded to a multiple of it."""

Defines = Mapping[str, str | int | float]
_OPTIONS = ("-cl-std=CL1.2", "-w")  # clang counts its warnings on standard error, as for processors without AVX
_MORE_OPTIONS = {  # by platform
    # Oclgrind knows neither the marks that inlining leaves of `restrict`, nor clang's root
    "Oclgrind": ("-cl-opt-disable", "-D__builtin_sqrtf=sqrt")
}
_POCL = "Portable Computing Language"
# LLVM's own SIGINT handler removes the file it is writing, whoever handles the signal: then the program is built again
_INTERRUPTED = "unable to rename temporary"
_GENERATED = "<generated: 'pyopencl invoker"
_SEEN = 1024  # launch sizes remembered for each program
_building = threading.Lock()  # so that what appears in PoCL's folder belongs to the program being built
_INCLUDE = re.compile(r'^#include "([\w/.]+)"[ \t]*$', re.MULTILINE)


@lru_cache
def folder() -> Path:
    """Folder of the kernel files: inside the package if it was installed from a wheel, in the repository if it is editable."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "cl", package.parents[1] / "cl"):
        if (folder / "base/platform.cl").is_file():
            return folder
    raise DeviceError(f"the kernels (cl/*.cl) are not installed beside {package}; reinstall clvol")


def source(
    name: str,
    replacements: Mapping[str, str] | None = None,
    generated: Mapping[str, str] | None = None,
    defines: Defines | None = None,
) -> str:
    """The text of one kernel file with its includes spliced in, each once, after the `defines`.

    Splicing is done here because PoCL accepts no ``-I`` with a space in it; ``#line`` keeps compiler messages on the right file
    and line. `replacements` maps an included name to another, which is how a render mode plugs into the ray loop; `generated` maps
    one to text.
    """
    seen: set[str] = set()

    def splice(name: str) -> str:
        if name in seen:
            return ""
        seen.add(name)
        try:
            text = (generated or {}).get(name) or (folder() / name).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise OptionError(f"every kernel must have a file in {folder()}; there is no {name}") from None

        def insert(match: re.Match[str]) -> str:
            line = text.count("\n", 0, match.end()) + 2  # of what follows the directive
            inner = splice((replacements or {}).get(match[1], match[1]))
            return f'{inner}\n#line {line} "{name}"' if inner else ""

        return f'#line 1 "{name}"\n' + _INCLUDE.sub(insert, text)

    head = "".join(f"#define {k} {literal(v)}\n" for k, v in sorted((defines or {}).items()))
    return head + splice(name)


class Program:
    """A built program. Each thread has kernels of its own, because a kernel holds its arguments."""

    def __init__(self, handle: Any, variants: Variants) -> None:
        self._handle = handle
        self._variants = variants
        self._kernels = threading.local()

    def kernel(self, name: str) -> Kernel:
        """The kernel of this name; `DeviceError` if the runtime cannot create it."""
        mine = self._kernels.__dict__
        if name not in mine:
            mine[name] = self.own_kernel(name)
        return cast(Kernel, mine[name])

    def own_kernel(self, name: str) -> Kernel:
        """A kernel for one caller, which keeps its arguments; errors as of `kernel`."""
        cl = opencl()
        try:
            kernel = Kernel(cl.Kernel(self._handle, name), name, self._variants)
        except cl.Error as error:
            raise DeviceError(f"the OpenCL runtime cannot create the kernel {name!r}: {error}") from error
        except Exception as error:
            if type(error).__module__ != "sqlite3":
                raise
            # pyopencl was imported before clvol, which would have disabled its cache
            raise DeviceError(f"pyopencl cannot use its cache ({error}); set PYOPENCL_NO_CACHE=1") from error
        _forget_sources()
        return kernel


def _forget_sources() -> None:
    """Drop the source that pyopencl generates to call a kernel: `linecache` would keep it forever, once for each kernel."""
    for name in [name for name in list(linecache.cache) if name.startswith(_GENERATED)]:
        linecache.cache.pop(name, None)  # another thread may have been here


class Kernel:
    """A kernel of one thread, called as pyopencl's: its arguments are memory, NumPy scalars, and arrays for vectors.

    Those of the first call tell the types of all: pyopencl finds out a type that it was not told in 16 µs, for each argument and
    call. Programs are told neither by PoCL nor by stored binaries what their arguments are.
    """

    def __init__(self, handle: Any, name: str, variants: Variants) -> None:
        self._handle, self._name, self._variants = handle, name, variants
        self._typed = False

    def __call__(self, queue: Any, size: Any, local: Any, *arguments: Any, global_offset: Any = None) -> Any:
        size, local, global_offset = self._prepared(size, local, global_offset)
        if not self._typed:
            self._handle.set_scalar_arg_dtypes([_type_of(argument) for argument in arguments])
            _forget_sources()
            self._typed = True
        return self._handle(queue, size, local, *arguments, global_offset=global_offset)

    def again(self, queue: Any, size: Any, local: Any, number: int, argument: Any, *, global_offset: Any = None) -> Any:
        """Launch with the arguments of the last call but one, of this number."""
        size, local, global_offset = self._prepared(size, local, global_offset)
        self._handle.set_arg(number, argument)
        return opencl().enqueue_nd_range_kernel(queue, self._handle, size, local, global_offset)

    def _prepared(self, size: Any, local: Any, global_offset: Any) -> tuple[Any, Any, Any]:
        if global_offset is not None and len(size) < 3:
            # PoCL compiles one kernel for launches without an offset and one for all others: an extra axis of size 1 at offset 1
            # makes all of them others
            size, local, global_offset = (*size, 1), local and (*local, 1), (*global_offset, 1)
        self._variants.prepare(self._name, size, local, global_offset)
        return size, local, global_offset


def _type_of(argument: Any) -> Any:
    """The type of an argument as pyopencl takes it; None for memory."""
    if isinstance(argument, np.ndarray):
        return np.dtype((np.void, argument.nbytes))
    return argument.dtype if isinstance(argument, np.generic) else None


class Variants:
    """Kernels of a program that PoCL compiles at their first launch, in seconds: one for each work-group size.

    `note` is called before the first launch of each size. The program's kernels hold this rather than the program, so that it is
    freed with the last of them.
    """

    def __init__(
        self,
        note: Callable[[Variants], None],
        kernels: KernelCache | None = None,
        key: str = "",
        place: str | None = None,
        stored: set[str] | None = None,
    ) -> None:
        self._note = note
        self._kernels = kernels if place else None  # where PoCL built it
        self._key, self._place = key, place or ""
        self._seen: set[Any] = set()
        self._stored = stored or set()

    def prepare(self, name: str, size: Any, local: Any, offset: Any) -> None:
        """Before a launch; raises `DeviceError` if PoCL would have to compile a kernel and cannot."""
        launch = (name, size, local, offset is not None and any(offset))
        if launch in self._seen:
            return
        if self._kernels and not self._compiled(*launch):
            self._stored |= self._kernels.restore(self._key)  # another process may have compiled it meanwhile
            if not self._compiled(*launch):
                self._kernels.require_room()
        if len(self._seen) >= _SEEN:
            self._seen.clear()
        self._seen.add(launch)
        self._note(self)

    def keep(self) -> None:
        """After launches: store what PoCL has compiled for them."""
        if self._kernels:
            for name in set(self._kernels.files(self._place)) - self._stored:
                with suppress(OSError):
                    self._kernels.store.write(self._key, name, (self._kernels.folder / name).read_bytes())
                self._stored.add(name)

    def _compiled(self, name: str, _: Any, local: Any, offset: bool) -> bool:
        """Whether there is a library of a kernel: for this work-group size, or for any if PoCL chooses it."""
        if self._kernels is None:
            return True
        begin = "".join(f"{n}-" for n in local) if local else ""
        with suppress(OSError):
            variants = [variant.name for variant in (self._kernels.folder / self._place / name).iterdir()]
            return any(variant.startswith(begin) and ("goffs0" in variant) != offset for variant in variants)
        return False


def build(device: Any, context: Any, text: str, kernels: KernelCache | None, note: Callable[[Variants], None]) -> Program:
    """The program of a text (of `source`) in a context, from the store if it was built before; errors are the runtime's.

    `note` is called before launches for which the runtime may have to compile a kernel. Without a `KernelCache` nothing is kept.
    Raises `DeviceError` if PoCL would have to build the program, and has no room to.
    """
    flags = os.environ.get("POCL_EXTRA_BUILD_FLAGS", "")  # PoCL adds them to the options
    key = hashlib.sha256("\0".join((identity(device), *_options(device), flags, text)).encode()).hexdigest()
    with _building, warnings.catch_warnings():
        # Intel's runtime always warns; faults are errors
        warnings.simplefilter("ignore", opencl().CompilerWarning)
        if kernels is None or device.platform.name != _POCL:
            return Program(_built_elsewhere(device, context, text, kernels.store if kernels else None, key), Variants(note))
        kernels.built()  # forget what others in this process have built
        stored = kernels.restore(key)
        if not any(name.endswith(".bc") for name in stored):
            kernels.require_room()
        try:
            handle = _compiled(context, text)
        except opencl().RuntimeError as error:
            if _INTERRUPTED not in str(error):
                raise
            handle = _compiled(context, text)
        variants = Variants(note, kernels, key, kernels.built(), stored)
        variants.keep()
        return Program(handle, variants)


def _options(device: Any) -> list[str]:
    return [*_OPTIONS, *_MORE_OPTIONS.get(device.platform.name, ())]


def _compiled(context: Any, text: str) -> Any:
    with quiet():
        return opencl().Program(context, text).build(options=_options(context.devices[0]))


def _built_elsewhere(device: Any, context: Any, text: str, store: Store | None, key: str) -> Any:
    """A program by a runtime other than PoCL: its binary is stored, unless the driver has a cache of its own."""
    cl = opencl()
    from pyopencl.characterize import has_src_build_cache

    if has_src_build_cache(device):
        store = None
    binary = store.read(key).get("binary") if store else None
    if binary is not None:
        with suppress(cl.Error):  # of another driver
            return cl.Program(context, [device], [binary]).build(options=_options(device))
    handle = _compiled(context, text)
    if store is not None:
        with suppress(cl.Error):
            store.write(key, "binary", handle.get_info(cl.program_info.BINARIES)[0])
    return handle


def literal(value: str | float) -> str:
    """A number as a literal of OpenCL C, floats in single precision; text stays as it is."""
    if not isinstance(value, float):
        return str(value)
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
