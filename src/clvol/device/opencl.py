"""The OpenCL runtime: loaded when first needed, after a trial in another process; it keeps built kernels where clvol says."""

from __future__ import annotations

import platform
import sys
import threading
import warnings
from contextlib import suppress
from functools import lru_cache
from typing import Any

from clvol.base.errors import ClvolWarning, DeviceError
from clvol.base.interrupted import deferred
from clvol.device import probe
from clvol.device.runtimes import intel
from clvol.device.runtimes.pocl import KernelCache, open_cache

__all__ = ["INSTALL", "kept_out", "kernel_cache", "opencl", "why_not", "works"]

_WITHOUT_GPU = {
    "linux": (
        "'pip install \"clvol[intel]\"' brings one that runs on the processor and needs nothing else, "
        "'pip install \"clvol[pocl]\"' a smaller one that needs 'ld' and gcc"
    ),
    "win32": "'pip install \"clvol[intel]\"' brings one that runs on the processor",
}
_X86 = platform.machine() in ("x86_64", "AMD64")
_ADVICE = (_WITHOUT_GPU.get(sys.platform) if _X86 else None) or "install PoCL (apt install pocl-opencl-icd; conda install pocl)"
INSTALL = f"Without a GPU, {_ADVICE}; with a GPU, install its vendor's OpenCL driver"
_lock = threading.RLock()
_module: Any = None
_AGAIN = "'clvol doctor' tries again"


def opencl() -> Any:
    """The module pyopencl; `DeviceError` if it is not installed, or the runtimes that it would load abort the process.

    Which runtimes may be loaded was tried in another process. OpenCL's loader looks for runtimes once in a process: here, unless
    the program used pyopencl before clvol.
    """
    return _module or _loaded()


@lru_cache(maxsize=1)
def kernel_cache() -> KernelCache | None:
    """Where PoCL keeps its kernels; None if clvol does not manage that."""
    return open_cache()


def kept_out() -> dict[str, str]:
    """Vendors' libraries that were not loaded because they abort the process or hang, and what they did in the trial."""
    return _verdict().libraries


@lru_cache(maxsize=1)
def _verdict() -> probe.Verdict:
    return probe.tried()


def why_not(handle: Any) -> str:
    """Why a trial found a device unusable; "" if it is usable."""
    with _lock:
        name = probe.identity(handle)
        if name not in _verdict().devices:
            probe.forget()  # the driver has changed since
            _verdict.cache_clear()
        return _verdict().devices.get(name, "")


def works(handle: Any) -> bool:
    """Whether a kernel of a device gave its result in a trial; False also if there was none."""
    return not why_not(handle) and probe.identity(handle) in _verdict().devices


def _loaded() -> Any:
    global _module
    with _lock:
        _module = _module or _load()  # another thread may have been faster
    return _module


def _load() -> Any:
    kernels = kernel_cache()
    verdict = _verdict()
    if verdict.unloadable:
        raise DeviceError(f"OpenCL's runtimes cannot be loaded: a trial in another process {verdict.unloadable}. {_AGAIN}")
    for library, why in verdict.libraries.items():
        message = f"the OpenCL runtime {library} is left out: a trial of it in another process {why}. {_AGAIN}"
        warnings.warn(message, ClvolWarning, stacklevel=4)
    # Child processes do not inherit these. pyopencl would cache how arguments are set, which gains a millisecond and fails if the
    # folder cannot be written; and programs of runtimes other than PoCL, unchecked: `clvol.device.program` stores those.
    variables = {"PYOPENCL_NO_CACHE": "1", **({"POCL_CACHE_DIR": str(kernels.folder)} if kernels else {})}
    with intel.known_to_the_loader(verdict.libraries), intel.variables(variables):
        try:
            with deferred():
                import pyopencl
        except ImportError as error:
            raise DeviceError(f"pyopencl cannot be imported: {error}. {INSTALL}. 'clvol doctor' says more") from error
        with suppress(pyopencl.Error):  # none found: `devices` reports it
            for found in pyopencl.get_platforms():
                with suppress(pyopencl.Error):
                    found.get_devices()  # PoCL reads its variables at the first query
    return pyopencl
