"""Name and write files: checks come before any work, and a file appears only when it is complete."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from clvol.base.checks import as_path
from clvol.base.errors import ClvolError, FormatError
from clvol.base.locked import LOCK, locked_folder, remove_abandoned

__all__ = ["MAX_HEADER", "full_disk", "require_empty", "require_folder", "require_suffix", "staged", "staged_folder"]

MAX_HEADER = 1 << 20
"""Largest text header, in bytes. No valid one is longer, and libraries overflow their stack on headers of megabytes."""

_FULL = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the quota of the disk is used up",
    errno.EFBIG: "no file of that size is allowed there",
}
_TRIED = 1 << 16  # bytes that are written to see whether there is room
_HIDDEN = ".clvol-"
_cleared: set[Path] = set()  # folders from which the files of killed processes were removed

_NO_SYNC = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP)  # errors of file systems that cannot sync, such as some network ones


def require_suffix(path: str | os.PathLike[str], allowed: Sequence[str], what: str) -> str:
    """The suffix of `path`, one of `allowed`, in lower case; else `FormatError`, in which `what` is the plural."""
    name = as_path(path).name.lower()
    suffix = max((s for s in allowed if name.endswith(s) and name != s), key=len, default=None)
    if suffix is None:
        raise FormatError(f"{what} are written as {', '.join(allowed)}; got {os.fspath(path)!r}")
    return suffix


def require_folder(target: Path) -> None:
    """Raise `FormatError` before any work if the folder of `target` is missing or not writable."""
    folder, number = _hidden_folder(target)
    _remove(folder, number)


@contextlib.contextmanager
def staged(path: Path, suffix: str) -> Iterator[Path]:
    """A path to write to, in a hidden folder beside `path`. The file moves into place once the block succeeds and it is synced.

    Other files that the writer leaves there (the samples beside a header) move first, the header last. It is a folder, not a
    temporary name, because libraries choose formats by suffix, and headers name their data file. Raises `FormatError` if `path`
    is a folder, its folder is missing, or writing failed with an `OSError` or a `ValueError`; it says so if the disk is full. What
    a killed process left is removed by the next that writes there.
    """
    try:
        target = path.resolve()  # replace the link's target and keep the link
    except (OSError, RuntimeError) as error:  # a cycle of links
        raise FormatError(f"cannot write {path}: {error}") from error
    if target.is_dir():
        raise FormatError(f"cannot write {target}: it is a folder")
    with _hidden(path, target) as folder:
        written = folder / (target.name[: -len(suffix)] + suffix)  # libraries do not know ".NRRD"
        yield written
        data_files = [file for file in folder.iterdir() if file not in (written, folder / LOCK)]
        for file in (*data_files, written):
            _sync(file)
        for file in data_files:
            _refuse_to_overwrite_anothers(target.with_name(file.name), target)
        if data_files:  # if this stops half-way, an old header must not describe new data
            target.unlink(missing_ok=True)
        for file in data_files:
            file.replace(target.with_name(file.name))
        written.replace(target)
        _sync_folder(target.parent)


@contextlib.contextmanager
def staged_folder(path: Path) -> Iterator[Path]:
    """A new folder to write to, in a hidden one beside `path`. It moves into place once the block succeeds; see `require_empty`."""
    target = require_empty(path)
    with _hidden(path, target) as folder:
        written = folder / target.name
        written.mkdir()
        yield written
        for file in written.iterdir():
            _sync(file)
        if target.exists():
            target.rmdir()  # it is empty
        written.rename(target)
        _sync_folder(target.parent)


def require_empty(path: Path) -> Path:
    """The absolute path of a folder that is not there yet, or empty; else `FormatError`."""
    target = path.resolve()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise FormatError(f"cannot write {path}: it must be a new folder, or an empty one")
    return target


@contextlib.contextmanager
def _hidden(path: Path, target: Path) -> Iterator[Path]:
    """A hidden folder beside the target, and errors in it as those of writing to `path`."""
    folder, number = _hidden_folder(target)
    try:
        yield folder
    except (OSError, ValueError) as error:
        if full := full_disk(error, folder):
            raise FormatError(f"cannot write {path}: {full}") from error
        if isinstance(error, ClvolError):
            raise
        raise FormatError(f"cannot write {path}: {str(error) or type(error).__name__}") from error
    finally:
        _remove(folder, number)


def full_disk(error: BaseException | None, folder: Path) -> str:
    """In words that a disk is full, if that is why writing to a folder failed: not all libraries say so."""
    while error is not None and not (isinstance(error, OSError) and error.errno in _FULL):
        error = error.__cause__
    if error is None:
        try:
            with tempfile.TemporaryFile(dir=folder) as stream:
                stream.write(bytes(_TRIED))
        except OSError as found:
            error = found
    number = getattr(error, "errno", None)
    return f"{_FULL[number]} ({os.strerror(number)})" if number in _FULL else ""


def _sync(file: Path) -> None:
    """Sync a file to disk: a disk that is full or failing may report it only now."""
    with file.open("rb+") as stream:  # Windows cannot sync a file opened for reading
        try:
            os.fsync(stream.fileno())
        except OSError as error:
            if error.errno not in _NO_SYNC:
                raise


def _sync_folder(folder: Path) -> None:
    """Sync the new names to disk where folders can be opened; the files are complete without it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _hidden_folder(target: Path) -> tuple[Path, int]:
    """Create a hidden folder beside `target`, and lock it: see `locked_folder`."""
    if not target.parent.is_dir():
        raise FormatError(f"cannot write {target}: the folder {target.parent} does not exist")
    if target.parent not in _cleared:
        remove_abandoned(target.parent, _HIDDEN)
        _cleared.add(target.parent)
    try:
        return locked_folder(target.parent, _HIDDEN)
    except OSError as error:
        raise FormatError(f"cannot write {target}: cannot create files in {target.parent}: {error.strerror}") from error


def _remove(folder: Path, number: int) -> None:
    os.close(number)  # Windows removes no open file
    with contextlib.suppress(OSError):  # an interrupt between two steps makes rmtree close a folder twice
        shutil.rmtree(folder, ignore_errors=True)


def _refuse_to_overwrite_anothers(data_file: Path, header: Path) -> None:
    """Raise if `data_file` exists and the header that is being replaced does not name it."""
    if not data_file.exists():
        return
    if header.is_file():
        with header.open("rb") as stream:
            names_it = rb"[\s=:/\\]" + re.escape(data_file.name.encode()) + rb"\s*$"
            if re.search(names_it, stream.read(MAX_HEADER), re.MULTILINE):
                return
    raise FormatError(
        f"cannot write {header}: its samples would replace {data_file}, which belongs to another file; choose another name"
    )
