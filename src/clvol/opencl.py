"""The OpenCL runtime, found when it is first needed, with caches that can be written."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import threading
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from clvol import intel
from clvol.errors import DeviceError

__all__ = ["INSTALL", "opencl"]

_WITHOUT_GPU = {
    "linux": (
        "'pip install clvol[intel]' brings one that runs on the processor and needs nothing else, "
        "'pip install clvol[pocl]' a smaller one that needs 'ld' and gcc"
    ),
    "win32": "'pip install clvol[intel]' brings one that runs on the processor",
}
_X86 = platform.machine() in ("x86_64", "AMD64")
_ADVICE = (_WITHOUT_GPU.get(sys.platform) if _X86 else None) or "install PoCL (apt install pocl-opencl-icd; conda install pocl)"
INSTALL = f"Without a GPU, {_ADVICE}; with a GPU, install its vendor's OpenCL driver"
_lock = threading.Lock()


@lru_cache(maxsize=1)
def opencl() -> Any:
    """pyopencl, with caches that can be written; imported only when a device is needed.

    Its loader looks for runtimes once in a process, here, unless the program used pyopencl before clvol.
    """
    _require_caches()
    with _lock, intel.known_to_the_loader():
        try:
            import pyopencl
        except ImportError as error:
            raise DeviceError(f"pyopencl cannot be imported: {error}. {INSTALL}. 'clvol doctor' says more") from error
        with suppress(pyopencl.Error):  # it finds none: whoever asks for devices is told
            pyopencl.get_platforms()
    return pyopencl


@lru_cache(maxsize=1)
def _require_caches() -> None:
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME") or "/nonexistent") / ".cache")
    if not _writable(home):
        # PoCL shows no device, or fails without a reason, when it cannot write its cache
        if not os.environ.get("POCL_CACHE_DIR"):
            os.environ["POCL_CACHE_DIR"] = tempfile.mkdtemp(prefix="clvol-pocl-")
        os.environ.setdefault("PYOPENCL_NO_CACHE", "1")


def _writable(folder: Path) -> bool:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:  # asking for permission is not enough: root may write anywhere, yet not in /proc
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
