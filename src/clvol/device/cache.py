"""The user's cache folder, and a store in it whose files are verified before they are used.

Runtimes load cached files unchecked, and PoCL runs a damaged library. So every file is stored with its digest; one that does not
match is set aside, and built again.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
import stat
import tempfile
from pathlib import Path

__all__ = ["ROOM", "Store", "fault", "folder", "has_room", "replace"]

ROOM = 3 << 20
"""Bytes that building a kernel may take: a linked file and what it is made of; some hundred thousand are usual."""

_DIGEST = hashlib.sha256
_MOST = 1 << 30  # bytes in a store; a program takes some hundred thousand
_LOOK = 16 << 20  # bytes that a process writes before it checks the size of the store again


def folder() -> Path | None:
    """Clvol's cache folder, created if need be; None if there is none that can be written."""
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no HOME, and no entry of this user in the system's table
        return None
    return base / "clvol" if fault(base / "clvol") is None else None


def fault(folder: Path) -> OSError | None:
    """Why a folder cannot be written, or can be by others; None if all is well, and then it exists.

    Its content is executed: it must belong to us or root, and not be writable by everybody.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid"):
            about = folder.stat()
            if os.getuid() and about.st_uid not in (0, os.getuid()):
                raise PermissionError(errno.EPERM, f"{folder} belongs to another user")
            if about.st_mode & stat.S_IWOTH:
                raise PermissionError(errno.EPERM, f"everybody may write into {folder}")
        with tempfile.TemporaryFile(dir=folder):  # permissions are not enough: root has them everywhere, yet cannot write to /proc
            return None
    except OSError as error:
        return error


def has_room(folder: Path) -> bool:
    """Whether the disk of a folder has room for what is built in it."""
    return shutil.disk_usage(folder).free >= ROOM


def replace(file: Path, data: bytes) -> None:
    """Write a file atomically: concurrent readers see the old content or the new."""
    number, name = tempfile.mkstemp(dir=file.parent, prefix=".")
    try:
        with os.fdopen(number, "wb") as stream:
            stream.write(data)
        Path(name).replace(file)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


class Store:
    """Files under keys, each with a digest of its key, name and content.

    A file that does not match its digest is renamed to ``damaged``, where the last one remains. When the store grows too large,
    least recently read keys are evicted. Nothing here raises for a folder that cannot be read or written: it is an empty store.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._until_look = 0  # bytes

    def read(self, key: str) -> dict[str, bytes]:
        """Every intact file of a key, by its name."""
        found = {}
        with contextlib.suppress(OSError):
            place = self._place(key)
            os.utime(place)
        with contextlib.suppress(OSError):
            for file in sorted(place.iterdir()):
                name = file.name.replace("+", "/")
                if not name.startswith("."):
                    content = self._content(key, name, file)
                    if content is not None:
                        found[name] = content
        return found

    def write(self, key: str, name: str, content: bytes) -> None:
        """Store a file under a key; `name` may hold slashes, but no plus."""
        with contextlib.suppress(OSError):
            place = self._place(key)
            place.mkdir(parents=True, exist_ok=True)
            replace(place / name.replace("/", "+"), content + self._digest(key, name, content))
            self._until_look -= len(content)
            if self._until_look < 0:
                self._until_look = _LOOK
                self._prune()

    def _prune(self) -> None:
        """Evict least recently read keys until the store is three quarters full."""
        keys, total = [], 0
        for place in self._root.glob("*/*"):
            with contextlib.suppress(OSError):  # another process removes it
                size = sum(file.stat().st_size for file in place.iterdir())
                keys.append((place.stat().st_mtime, size, place))
                total += size
        if total <= _MOST:
            return
        for _, size, place in sorted(keys):
            shutil.rmtree(place, ignore_errors=True)
            total -= size
            if total <= _MOST * 3 // 4:
                return

    def _content(self, key: str, name: str, file: Path) -> bytes | None:
        try:
            data = file.read_bytes()
            size = _DIGEST().digest_size
            if len(data) > size and data[-size:] == self._digest(key, name, data[:-size]):
                return data[:-size]
            file.replace(self._root / "damaged")
        except OSError:  # another process has set it aside
            pass
        return None

    def _digest(self, key: str, name: str, content: bytes) -> bytes:
        return _DIGEST(b"\0".join((key.encode(), name.encode(), content))).digest()

    def _place(self, key: str) -> Path:
        return self._root / key[:2] / key
