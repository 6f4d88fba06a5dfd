"""Kernels that PoCL has built: no two processes write to one of its cache folders, and nobody reads half-written files.

PoCL works in a folder of this process. What it has built there goes into a store, from which other processes restore it into
their own folders.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

from clvol.base.errors import ClvolWarning, DeviceError
from clvol.base.locked import locked_folder, remove_abandoned
from clvol.device import cache
from clvol.device.cache import Store

__all__ = ["KernelCache", "open_cache"]


class KernelCache:
    """The store of built kernels, shared between processes, and the folder of this process in which PoCL builds.

    The folder is the value of ``POCL_CACHE_DIR`` when PoCL first looks for devices. It is removed when the process ends; the next
    process removes the folder of one that was killed. `temporary`: a folder for it elsewhere, removed with it.
    """

    def __init__(self, root: Path, *, temporary: Path | None = None) -> None:
        self.store = Store(root / "store")
        running = (temporary or root) / "running"
        running.mkdir(parents=True, exist_ok=True)
        remove_abandoned(running)
        self.folder, _ = locked_folder(running)
        self._removed = temporary or self.folder
        self._process = os.getpid()
        self.needs_linker = True  # False for PoCL that links in its own process
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
        if linker is None and self.needs_linker:
            raise DeviceError("PoCL needs the linker 'ld' to finish a kernel, and there is none on PATH")
        done = None
        try:
            with tempfile.TemporaryDirectory(dir=self.folder, prefix="trial-", ignore_cleanup_errors=True) as trial:
                blob = Path(trial, "blob")
                with blob.open("wb") as stream:
                    stream.write(bytes(cache.ROOM))
                    stream.truncate(cache.ROOM // 3)
                if linker is None:
                    return
                command = [linker, "-shared", "-o", f"{trial}/linked", "-b", "binary", str(blob)]
                with contextlib.suppress(subprocess.TimeoutExpired):
                    done = _run(command)
        except OSError as error:
            raise DeviceError(
                f"kernels are built in {self.folder}, where there is no room for {cache.ROOM >> 20} MiB ({error.strerror}); "
                "make room, or let POCL_CACHE_DIR name another folder"
            ) from error
        if done is None:
            raise DeviceError(f"PoCL needs the linker to finish a kernel, and {linker} does not end")
        if done.returncode != 0:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
            raise DeviceError(f"PoCL needs the linker to finish a kernel, and {linker} fails in {self.folder} ({last[0]})")


def open_cache() -> KernelCache | None:
    """A cache where ``POCL_CACHE_DIR`` says, or in clvol's folder; None if PoCL is to keep nothing, or there is no PoCL.

    Kernels are built in a temporary folder where these are full. `DeviceError` if there is no room there either.
    """
    if sys.platform == "win32" or os.environ.get("POCL_KERNEL_CACHE") == "0":  # for Windows there is no PoCL
        return None
    given, ours = os.environ.get("POCL_CACHE_DIR"), cache.folder()
    full: list[Path] = []
    for root in (Path(given) / "clvol" if given else None, ours / "kernels" if ours else None):
        if root is not None:
            fault = cache.fault(root)
            if fault is None and cache.has_room(root):
                with contextlib.suppress(OSError):
                    return KernelCache(root)
            full += [root] if fault is None else []
            if given and root.parent == Path(given):
                why = "whose disk is full" if fault is None else f"which cannot be written ({fault.strerror})"
                _warn(f"POCL_CACHE_DIR names {given}, {why}; kernels are kept elsewhere")
    try:
        temporary = Path(tempfile.mkdtemp(prefix="clvol-kernels-"))
        if cache.has_room(temporary):
            if full:
                _warn(f"the disk of {full[0]} is full: kernels are built in {temporary}, and not kept")
            return KernelCache(full[0] if full else temporary, temporary=temporary)
        temporary.rmdir()
        places = " and ".join(str(place) for place in (*full, temporary.parent))
        why = f"the disk of {places} is full (kernels take {cache.ROOM >> 20} MiB)"
    except OSError as error:
        why = f"not even a temporary one ({error})"
    raise DeviceError(
        f"no folder can be written to build kernels in: {why}; make room, or let POCL_CACHE_DIR or TMPDIR name a folder"
    )


def _warn(message: str) -> None:
    warnings.warn(message, ClvolWarning, stacklevel=3)


def _run(command: list[str]) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(command, capture_output=True, check=False, timeout=60)
    except OSError as error:
        raise DeviceError(f"PoCL needs the linker to finish a kernel, and {command[0]} cannot be run: {error}") from error
