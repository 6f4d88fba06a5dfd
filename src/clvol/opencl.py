"""The OpenCL runtime, found when it is first needed, with caches that can be written."""

from __future__ import annotations

import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from clvol.errors import DeviceError

__all__ = ["INSTALL", "opencl"]

INSTALL = (
    "On Linux without a GPU, 'pip install clvol[pocl]' brings one that runs on the processor; "
    "with a GPU, install its vendor's OpenCL driver. 'clvol doctor' says more"
)


@lru_cache(maxsize=1)
def opencl() -> Any:
    """pyopencl, with caches that can be written; imported only when a device is needed."""
    _require_caches()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"pyopencl cannot be imported: {error}. {INSTALL}") from error
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
