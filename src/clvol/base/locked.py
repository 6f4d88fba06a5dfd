"""Folders that a process locks while it works in them: the next process removes those of one that was killed."""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import tempfile
import time
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nothing is locked, and nothing removed
    fcntl = None  # type: ignore[assignment]

__all__ = ["LOCK", "locked_folder", "remove_abandoned"]

LOCK = "lock"
"""The file in a folder that is locked."""

_FORGOTTEN = 30 * 86400.0  # seconds after which the folder of another machine's process may be removed


def locked_folder(parent: Path, prefix: str = "") -> tuple[Path, int]:
    """A new folder, and the descriptor that keeps it locked until it is closed.

    Its name has the host's: locks may be invisible to other hosts.
    """
    while True:
        folder = Path(tempfile.mkdtemp(dir=parent, prefix=f"{prefix}{platform.node()}-"))
        try:
            number = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o600)
        except BaseException:
            folder.rmdir()
            raise
        with contextlib.suppress(OSError, AttributeError):  # on a file system without locks nobody else gets one either
            fcntl.flock(number, fcntl.LOCK_EX)
        if folder.exists():  # else another process removed it before it was locked
            return folder, number
        os.close(number)


def remove_abandoned(parent: Path, prefix: str = "") -> None:
    """Remove the locked folders of processes that have ended."""
    if fcntl is None:
        return
    for lock in parent.glob(f"{prefix}*/{LOCK}"):
        with contextlib.suppress(OSError):
            if not lock.parent.name.startswith(f"{prefix}{platform.node()}-") and time.time() - lock.stat().st_mtime < _FORGOTTEN:
                continue
            number = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(lock.parent, ignore_errors=True)
            finally:
                os.close(number)
