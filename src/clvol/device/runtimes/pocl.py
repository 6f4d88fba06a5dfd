"""Kernels that PoCL has built: no two processes write to one of its cache folders, and nobody reads half-written files.

PoCL works in a folder of this process. What it has built there goes into a store, from which other processes restore it into
their own folders.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import platform
import shutil
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

from clvol.base.errors import ClvolWarning, DeviceError
from clvol.device import cache
from clvol.device.cache import Store

try:
    import fcntl
except ImportError:  # Windows, for which there is no PoCL
    fcntl = None  # type: ignore[assignment]

__all__ = ["KernelCache", "open_cache"]

_FORGOTTEN = 30 * 86400.0  # seconds after which the folder of another machine's process may be removed
_TRIAL = 1 << 20  # bytes linked on trial before a kernel is built, which has some hundred thousand


class KernelCache:
    """The store of built kernels, shared between processes, and the folder of this process in which PoCL builds.

    The folder is the value of ``POCL_CACHE_DIR`` when PoCL first looks for devices. It is removed when the process ends; the next
    process removes the folder of one that was killed.
    """

    def __init__(self, root: Path, *, temporary: bool = False) -> None:
        self.store = Store(root / "store")
        running = root / "running"
        running.mkdir(parents=True, exist_ok=True)
        _clear(running)
        self.folder = _locked(running)
        self._removed = root if temporary else self.folder
        self._process = os.getpid()
        atexit.register(self._close)

    def _close(self) -> None:
        if self._process == os.getpid():  # else this is a fork, and the folder its parent's
            shutil.rmtree(self._removed, ignore_errors=True)

    def restore(self, key: str) -> set[str]:
        """Copy the stored files of a key to where PoCL looks for them; returns their names."""
        files = self.store.read(key)
        for name, content in files.items():
            file = self.folder / name
            if not file.exists():  # else this process has put it there, and may be using it
                with contextlib.suppress(OSError):
                    file.parent.mkdir(parents=True, exist_ok=True)
                    cache.replace(file, content)
                    file.chmod(0o700)
        return set(files)

    def built(self) -> str | None:
        """Subfolder of the program that PoCL has built since the last call; None if it works elsewhere."""
        place = None
        # PoCL touches this file in each build, and never reads it; its folders have two letters, and others may vanish meanwhile
        for mark in self.folder.glob("??/*/last_accessed"):
            place = mark.parent.relative_to(self.folder).as_posix()
            mark.unlink()
        return place

    def files(self, place: str) -> list[str]:
        """The program and kernels in the subfolder of a program."""
        found = Path(self.folder, place)
        files = [*found.glob("program.bc"), *found.glob("*/*/*.so")]
        return [file.relative_to(self.folder).as_posix() for file in files]

    def require_room(self) -> None:
        """Raise `DeviceError` if PoCL would abort the process: its folder cannot be written, or the linker fails."""
        linker = shutil.which("ld")
        if linker is None:
            raise DeviceError("PoCL needs the linker 'ld' to finish a kernel, and there is none on PATH")
        done = None
        try:
            with tempfile.TemporaryDirectory(dir=self.folder, prefix="trial-", ignore_cleanup_errors=True) as trial:
                blob = Path(trial, "blob")
                with blob.open("wb") as stream:
                    stream.write(bytes(3 * _TRIAL))  # room for the linked file, too
                    stream.truncate(_TRIAL)
                command = [linker, "-shared", "-o", f"{trial}/linked", "-b", "binary", str(blob)]
                with contextlib.suppress(subprocess.TimeoutExpired):
                    done = _run(command)
        except OSError as error:
            raise DeviceError(
                f"kernels are built in {self.folder}, where there is no room for {3 * _TRIAL >> 20} MiB ({error.strerror}); "
                "make room, or let POCL_CACHE_DIR name another folder"
            ) from error
        if done is None:
            raise DeviceError(f"PoCL needs the linker to finish a kernel, and {linker} does not end")
        if done.returncode != 0:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
            raise DeviceError(f"PoCL needs the linker to finish a kernel, and {linker} fails in {self.folder} ({last[0]})")


def open_cache() -> KernelCache | None:
    """A cache where ``POCL_CACHE_DIR`` says, or in clvol's folder; None if PoCL is to keep nothing, or there is no PoCL.

    `DeviceError` if not even a temporary folder can be written.
    """
    if fcntl is None or os.environ.get("POCL_KERNEL_CACHE") == "0":
        return None
    given, ours = os.environ.get("POCL_CACHE_DIR"), cache.folder()
    for root in (Path(given) / "clvol" if given else None, ours / "kernels" if ours else None):
        if root is not None:
            fault = cache.fault(root)
            if fault is None:
                with contextlib.suppress(OSError):
                    return KernelCache(root)
            elif given and root.parent == Path(given):
                warnings.warn(
                    f"POCL_CACHE_DIR names {given}, which cannot be written ({fault.strerror}); kernels are kept elsewhere",
                    ClvolWarning,
                    stacklevel=2,
                )
    try:
        return KernelCache(Path(tempfile.mkdtemp(prefix="clvol-kernels-")), temporary=True)
    except OSError as error:
        raise DeviceError(
            f"no folder can be written to build kernels in, not even a temporary one ({error}); make room, or let "
            "POCL_CACHE_DIR or TMPDIR name a folder"
        ) from error


def _run(command: list[str]) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(command, capture_output=True, check=False, timeout=60)
    except OSError as error:
        raise DeviceError(f"PoCL needs the linker to finish a kernel, and {command[0]} cannot be run: {error}") from error


def _locked(running: Path) -> Path:
    """A new folder, locked until the process ends. Its name begins with the host's: locks may be invisible to other hosts."""
    while True:
        folder = Path(tempfile.mkdtemp(dir=running, prefix=f"{platform.node()}-"))
        number = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o600)
        with contextlib.suppress(OSError):  # on a file system without locks nobody else gets one either
            fcntl.flock(number, fcntl.LOCK_EX)
        if folder.exists():  # else another process removed it before it was locked
            return folder
        os.close(number)


def _clear(running: Path) -> None:
    """Remove the folders of processes that have ended."""
    for lock in running.glob("*/lock"):
        with contextlib.suppress(OSError):
            if not lock.parent.name.startswith(f"{platform.node()}-") and time.time() - lock.stat().st_mtime < _FORGOTTEN:
                continue
            number = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(lock.parent, ignore_errors=True)
            finally:
                os.close(number)
