"""The unfinished store beside its target, and the list of its parts that are on the disk: after a kill, the same call resumes.

That a chunk exists does not say that its part is done: Zarr stores no chunk of zeros, parts depend on the budget, after a power
failure a file may be empty, and the range of the values of a part is stored nowhere else.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from clvol.base.errors import FormatError
from clvol.bricks.chunks import Chunks
from clvol.bricks.sliced import Window, said_of_file, said_of_folder
from clvol.bricks.source import LazyVolume

__all__ = ["Journal", "require_apart", "said_of"]

_SECONDS = 10.0  # from one sync of the disk to the next, at least
_SHARE = 20  # times the duration of a sync, at least


class Journal:
    """A folder beside the target, with the store being written and a list of its parts, which grows whenever the disk is synced.

    The target is what it was, or the whole new store; a kill between two renames leaves nothing there until the next call of any
    command, which first restores what was there.

    `command` is all that decides what is written: another command does not resume what this one began, unless it may `replace`
    that, and what is at the target. The `store` is written; it is `finished` if the same command was killed after it had moved it.

    A `FormatError`: the target exists, another command has begun, another process is at work, or the folder is not writable.
    """

    def __init__(self, target: Path, command: Mapping[str, Any], replace: bool = False) -> None:
        self.target, self._replace = target, replace
        self.folder = target.with_name(f".{target.name}.unfinished")
        self.store, self._old, self._list = (self.folder / name for name in ("store.zarr", "replaced", "journal"))
        self.finished = False
        self._done: dict[str, dict[str, Any]] = {}
        self._unsynced: dict[str, dict[str, Any]] = {}
        self._next_sync = time.monotonic() + _SECONDS
        if not self.folder.exists():
            self._require_free()
        try:
            self.folder.mkdir(exist_ok=True)
            self._stream = self._list.open("a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise FormatError(f"cannot write {target}: nothing can be made in {target.parent}: {error.strerror}") from error
        self._lock()
        try:
            self._resume(json.loads(json.dumps(command, default=str)))
        except BaseException:
            with contextlib.closing(self._stream):
                if not self.store.exists() and not self._old.exists():
                    self._remove_folder()
            raise

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # Windows
            return
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(self._stream.fileno()).st_nlink:
                raise FileNotFoundError("another process has just removed it")
        except OSError as error:
            self._stream.close()
            raise FormatError(f"cannot write {self.target}: another process is at work in {self.folder}") from error

    def _resume(self, command: dict[str, Any]) -> None:
        """Finish or resume what the same command began, or begin anew."""
        begun, *synced = self._read() or [{}]
        same, there = begun.get("command") == command, self.store.exists()
        if self._taken() and not there and self.target.lstat().st_ino == begun.get("store"):  # killed after it was moved
            self.finished = same
            self._remove_old()
            if same:
                self._remove_folder()
                return
        elif self._old.exists() and not self._taken():  # killed between two renames
            self._old.rename(self.target)
        self._require_free()
        if begun and there and not same and not self._replace:
            before = begun["command"]
            keys = [key for key in sorted(before | command) if before.get(key) != command.get(key)]
            differences = ", ".join(f"{key}: {before.get(key)} and not {command.get(key)}" for key in keys)
            raise FormatError(
                f"cannot write {self.target}: {self.folder} holds what another command began ({differences}); "
                "finish it by that command, or begin anew by overwrite=True"
            )
        if same and there and synced:
            for file in self.store.rglob("*"):  # what was written after the last sync may be torn
                if file.name.endswith(".partial") or (file.is_file() and file.stat().st_mtime_ns > synced[-1]["time"]):
                    file.unlink(missing_ok=True)
            for entry in synced:
                self._done |= entry["parts"]
            return
        self._stream.truncate(0)
        os.fsync(self._stream.fileno())  # no list must outlive its store
        shutil.rmtree(self.store, ignore_errors=True)
        self.store.mkdir()
        self._write({"command": command, "store": self.store.stat().st_ino})

    def _read(self) -> list[dict[str, Any]]:
        """What was begun, then what was on the disk at each sync."""
        self._stream.seek(0)
        entries = []
        for line in self._stream:
            with contextlib.suppress(ValueError):  # cut by a kill
                entries.append(json.loads(line))
        return entries if entries and "command" in entries[0] else []

    def _write(self, entry: dict[str, Any]) -> None:
        self._stream.write("\n" + json.dumps(entry) + "\n")  # a kill may have cut the line before
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def _taken(self) -> bool:
        return self.target.exists() or self.target.is_symlink()

    def _require_free(self) -> None:
        if self._taken() and not self._replace:
            raise FormatError(f"cannot write {self.target}: it is there already; overwrite=True replaces it")

    # -- parts -----------------------------------------------------------------------------------------------------------

    def __contains__(self, part: str) -> bool:
        return part in self._done

    def facts(self, prefix: str) -> Iterator[dict[str, Any]]:
        """The facts of the parts whose names begin with `prefix`."""
        return (facts for part, facts in self._done.items() if part.startswith(prefix))

    def done(self, part: str, **facts: Any) -> None:
        """Add a part that is written, and facts about it."""
        self._done[part] = self._unsynced[part] = facts
        if time.monotonic() >= self._next_sync:
            self._sync()

    def _sync(self) -> None:
        begun = time.monotonic()
        if hasattr(os, "sync"):  # not on Windows
            os.sync()
        os.utime(self._list)  # the time, by the clock that stamps the files
        self._write({"time": os.fstat(self._stream.fileno()).st_mtime_ns, "parts": self._unsynced})
        self._unsynced = {}
        now = time.monotonic()
        self._next_sync = now + max(_SECONDS, _SHARE * (now - begun))

    # -- the end ---------------------------------------------------------------------------------------------------------

    def complete(self) -> None:
        """Sync the store, and move it to its target, unless that exists by now and must not be replaced."""
        self._sync()
        if self._taken() and not self._replace:
            raise FormatError(f"cannot write {self.target}: it is there by now; the store is complete in {self.store}")
        try:
            self._move()
        except OSError as error:
            raise FormatError(f"cannot write {self.target}: {error}; the store is complete in {self.store}") from error
        self._remove_old()
        self._remove_folder()

    def _move(self) -> None:
        replaced = self._taken()
        if replaced:
            self._remove_old()
            self.target.rename(self._old)
        try:
            self.store.rename(self.target)
        except OSError:
            if replaced:
                self._old.rename(self.target)
            raise

    def _remove_old(self) -> None:
        """Remove what was replaced, once the disk knows the new store by its name."""
        if self._old.is_dir() and not self._old.is_symlink():
            if hasattr(os, "sync"):
                os.sync()
            shutil.rmtree(self._old, ignore_errors=True)
        else:
            self._old.unlink(missing_ok=True)

    def _remove_folder(self) -> None:
        if os.name == "nt":  # cannot remove open files
            self._stream.close()
        self._list.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # another process has begun there
            self.folder.rmdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.closing(self._stream):
            if kind is not None and not self.finished and not self._done:  # nothing to resume
                shutil.rmtree(self.store, ignore_errors=True)
                self._remove_folder()
            elif self._unsynced:
                with contextlib.suppress(OSError):  # the disk may be full
                    self._sync()


# -- what identifies the source: an unfinished store is resumed from the same samples only ----------------------------


def said_of(volume: LazyVolume) -> str:
    """A text that changes if the samples do: sizes and times of files, a checksum of arrays in memory.

    Of other sources (dask, remote stores) it covers metadata and the samples in the middle only.
    """
    some = zlib.crc32(np.ascontiguousarray(volume.part().data).tobytes())
    source = volume.data.source if isinstance(volume.data, Chunks) else volume.data
    return f"{volume.shape} {volume.dtype} {some:08x}, {_whole(source)}"


def require_apart(volume: LazyVolume, target: Path) -> None:
    """Raise if the target lies in the source, or holds it."""
    place = _place(volume.data)
    place = None if place is None else place.resolve()
    if place is None or place == target:
        return
    if target.is_relative_to(place):
        raise FormatError(f"cannot write {target}: it lies in its own source, {place}; choose a path beside that")
    if place.is_relative_to(target):
        raise FormatError(f"cannot write {target}: it holds its own source, {place}; choose another path")


def _whole(data: Any) -> str:
    said = getattr(data, "said", None)
    if callable(said):
        return str(said())
    place = _place(data)
    if place is not None and place.is_file():
        return said_of_file(place)
    if isinstance(data, np.ndarray):
        return f"in memory {_checksum(data):08x}"
    if place is not None and place.is_dir():
        return said_of_folder(place / getattr(data, "path", ""))
    return "the rest unknown"


def _place(data: Any) -> Path | None:
    """The file or folder with the samples, if known."""
    if isinstance(data, Window):
        return data.place
    if isinstance(data, np.ndarray):
        return _mapped(data)
    file = getattr(getattr(data, "file", None), "filename", None)  # h5py
    if isinstance(file, str):
        return Path(file)
    root = getattr(getattr(getattr(data, "store_path", None), "store", None), "root", None)  # zarr
    return root if isinstance(root, Path) else None


def _mapped(data: Any) -> Path | None:
    """The file that an array is mapped from."""
    while isinstance(data, np.ndarray):
        if isinstance(data, np.memmap) and data.filename is not None:
            return Path(data.filename)
        data = data.base
    return None


def _checksum(data: Any) -> int:
    check = 0
    for plane in data:
        check = zlib.crc32(np.ascontiguousarray(plane).tobytes(), check)
    return check
