"""Where clvol keeps what it need not find out twice, and built kernels that are what was written, or are not used.

Runtimes load what lies in their cache as it is: PoCL runs a damaged library of it. So PoCL works in a folder of this process alone,
and what it has built there goes into a store, each file with its digest. From there it comes back into the folder of another
process, if the digest is right; else it is set aside, and built again. No two processes write to one folder of PoCL's, and what a
process that was killed has half written, nobody reads.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

from clvol.base.errors import ClvolWarning, DeviceError

try:
    import fcntl
except ImportError:  # Windows has no PoCL to keep folders for
    fcntl = None  # type: ignore[assignment]

__all__ = ["Shelf", "Store", "folder", "replace", "shelf"]

_DIGEST = hashlib.sha256
_MOST = 256 << 20  # bytes in a store; each program has some hundred thousand
_LOOK = 16 << 20  # bytes that a process writes before it looks again whether there are more
_FORGOTTEN = 30 * 86400.0  # seconds after which a folder of another machine's process is nobody's
_TRIAL = 1 << 20  # bytes that are linked before a kernel is built, which has some hundred thousand


def folder() -> Path | None:
    """The folder for what clvol keeps, made if need be; None where there is none that can be written."""
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no HOME, and no entry of this user in the system's table
        return None
    return base / "clvol" if _fault(base / "clvol") is None else None


def _fault(folder: Path) -> OSError | None:
    """Why a folder cannot be written, or not by us alone; None if it can, and then it is there.

    What lies in it is run: it must be ours or root's, and not open to everybody.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid"):
            about = folder.stat()
            if os.getuid() and about.st_uid not in (0, os.getuid()):
                raise PermissionError(errno.EPERM, f"{folder} belongs to another user")
            if about.st_mode & stat.S_IWOTH:
                raise PermissionError(errno.EPERM, f"everybody may write into {folder}")
        with tempfile.TemporaryFile(dir=folder):  # asking for permission is not enough: root may write anywhere, yet not in /proc
            return None
    except OSError as error:
        return error


def replace(file: Path, data: bytes) -> None:
    """Put `data` into a file that others may be reading: they see all of it or what was there before."""
    number, name = tempfile.mkstemp(dir=file.parent, prefix=".")
    try:
        with os.fdopen(number, "wb") as stream:
            stream.write(data)
        Path(name).replace(file)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


class Store:
    """Files under keys, each with a digest of its name and content: what comes out is what was put in.

    A file that is not is renamed to ``damaged`` (the last one remains to be looked at). Where there is more in store than there may
    be, keys go that were not read for the longest time. Nothing here raises for a folder that cannot be read or written: then there
    is nothing in store.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._until_look = 0  # bytes

    def read(self, key: str) -> dict[str, bytes]:
        """Every sound file of a key, by its name."""
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
        """Keep a file under a key; `name` may hold slashes, and no plus."""
        with contextlib.suppress(OSError):
            place = self._place(key)
            place.mkdir(parents=True, exist_ok=True)
            replace(place / name.replace("/", "+"), content + self._digest(key, name, content))
            self._until_look -= len(content)
            if self._until_look < 0:
                self._until_look = _LOOK
                self._prune()

    def _prune(self) -> None:
        """Remove the keys that were not read for the longest time, to three quarters of what may be in store."""
        keys, everything = [], 0
        for place in self._root.glob("*/*"):
            with contextlib.suppress(OSError):  # another process removes it
                size = sum(file.stat().st_size for file in place.iterdir())
                keys.append((place.stat().st_mtime, size, place))
                everything += size
        if everything <= _MOST:
            return
        for _, size, place in sorted(keys):
            shutil.rmtree(place, ignore_errors=True)
            everything -= size
            if everything <= _MOST * 3 // 4:
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


class Shelf:
    """The store of built kernels, and the folder of this process in which PoCL builds.

    Attributes
    ----------
    store : Store
        What other processes have built, and will use.
    folder : Path
        What ``POCL_CACHE_DIR`` must be when PoCL first looks for devices. It goes when the process ends; one that a killed process
        left goes when the next one starts.
    """

    def __init__(self, root: Path, *, temporary: bool = False) -> None:
        self.store = Store(root / "store")
        running = root / "running"
        running.mkdir(parents=True, exist_ok=True)
        _clear(running)
        self.folder = _locked(running)
        self._gone = root if temporary else self.folder
        self._process = os.getpid()
        atexit.register(self._close)

    def _close(self) -> None:
        if self._process == os.getpid():  # else this is a fork, and the folder its parent's
            shutil.rmtree(self._gone, ignore_errors=True)

    def restore(self, key: str) -> set[str]:
        """Put what is in store under a key where PoCL looks for it; the names of the files."""
        files = self.store.read(key)
        for name, content in files.items():
            file = self.folder / name
            if not file.exists():  # what is there was put there by this process, and may be in use
                with contextlib.suppress(OSError):
                    file.parent.mkdir(parents=True, exist_ok=True)
                    replace(file, content)
                    file.chmod(0o700)
        return set(files)

    def built(self) -> str | None:
        """The folder in `folder` of the program that PoCL has built since this was last asked; None if it works elsewhere."""
        place = None
        # PoCL touches it in each build, and needs it for nothing else; its folders have two letters, and others may go meanwhile
        for mark in self.folder.glob("??/*/last_accessed"):
            place = mark.parent.relative_to(self.folder).as_posix()
            mark.unlink()
        return place

    def files(self, place: str) -> list[str]:
        """The program and kernels in the folder of a program."""
        found = Path(self.folder, place)
        files = [*found.glob("program.bc"), *found.glob("*/*/*.so")]
        return [file.relative_to(self.folder).as_posix() for file in files]

    def require_room(self) -> None:
        """Raise `DeviceError` where PoCL would abort the process: its folder cannot be written, or the linker fails."""
        linker = shutil.which("ld")
        if linker is None:
            raise DeviceError("PoCL needs the linker 'ld' to finish a kernel, and there is none on PATH")
        done = None
        try:
            with tempfile.TemporaryDirectory(dir=self.folder, prefix="trial-", ignore_cleanup_errors=True) as trial:
                blob = Path(trial, "blob")
                with blob.open("wb") as stream:
                    stream.write(bytes(3 * _TRIAL))  # for what is linked, too
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


def shelf() -> Shelf | None:
    """A new shelf where ``POCL_CACHE_DIR`` says, or in clvol's folder; None where PoCL is to keep nothing, or there is no PoCL.

    Raises
    ------
    DeviceError
        Not even a temporary folder can be written.
    """
    if fcntl is None or os.environ.get("POCL_KERNEL_CACHE") == "0":
        return None
    given, own = os.environ.get("POCL_CACHE_DIR"), folder()
    for root in (Path(given) / "clvol" if given else None, own / "kernels" if own else None):
        if root is not None:
            fault = _fault(root)
            if fault is None:
                with contextlib.suppress(OSError):
                    return Shelf(root)
            elif given and root.parent == Path(given):
                warnings.warn(
                    f"POCL_CACHE_DIR names {given}, which cannot be written ({fault.strerror}); kernels are kept elsewhere",
                    ClvolWarning,
                    stacklevel=2,
                )
    try:
        return Shelf(Path(tempfile.mkdtemp(prefix="clvol-kernels-")), temporary=True)
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
    """A new folder with a lock that ends with the process. Its name begins with the machine's, which alone may know of the lock."""
    while True:
        folder = Path(tempfile.mkdtemp(dir=running, prefix=f"{platform.node()}-"))
        number = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o600)
        with contextlib.suppress(OSError):  # a file system without locks: then nobody else gets one either
            fcntl.flock(number, fcntl.LOCK_EX)
        if folder.exists():  # else another process took it for a dead one's before it was locked
            return folder
        os.close(number)


def _clear(running: Path) -> None:
    """Remove the folders of processes that are gone."""
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
