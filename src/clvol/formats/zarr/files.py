"""Files of a store on this machine: intact, its own, and unchanged since the store was opened."""

from __future__ import annotations

import itertools
import os
import zipfile
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from clvol.base.errors import FormatError
from clvol.bricks.sliced import Signature, signature
from clvol.formats._files import require_members

__all__ = ["Files", "has_chunks", "inside", "is_metadata", "is_one"]

_ROOTS = ("zarr.json", ".zgroup", ".zarray")
_METADATA = (*_ROOTS, ".zattrs", ".zmetadata")
_WATCHED = 1 << 17  # chunks whose files are watched, those first read last
_FOLDERS = 1 << 11  # folders of an array whose times are noted when it is opened, outer ones first; others when they are read


def is_one(path: Path) -> bool:
    """Whether a folder is a Zarr array or group."""
    return any((path / name).is_file() for name in _ROOTS)


def is_metadata(key: str) -> bool:
    """Whether a key is of metadata, not of a chunk."""
    return key.rpartition("/")[2] in _METADATA


def inside(path: Path) -> str:
    """Path of the array or group in an archive: its root, or a folder that was packed."""
    with zipfile.ZipFile(path) as archive:
        require_members(path.name, archive, replaced=True)
        found = [name for name in archive.namelist() if name.rpartition("/")[2] in _ROOTS]
    if not found:
        raise FormatError(f"{path.name} must hold a Zarr array or group; unpack archives of other files, and read what they hold")
    return min(found, key=lambda name: name.count("/")).rpartition("/")[0]


def has_chunks(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder holds more than metadata and empty folders: zarr creates those of nested chunks first."""
    with os.scandir(folder) as entries:
        others = (entry for entry in entries if entry.name not in _METADATA and not entry.name.startswith("."))
        return any(not entry.is_dir(follow_symlinks=False) or has_chunks(entry.path) for entry in others)


class Files:
    """The folder or archive of a store.

    zarr treats anything that is not a regular file as a chunk that is not stored, and blocks on pipes. If the files are `watched`,
    a file that is read twice must be the same twice, and one that is read once, or is missing, must not have changed since the
    array was opened, as far as the times of its folder tell.
    """

    def __init__(self, root: Path, name: str, watched: bool) -> None:
        self.root, self.name, self._watched = root, name, watched
        self.in_folder = root.is_dir()  # as the store is opened
        self._seen: OrderedDict[str, Signature] = OrderedDict()  # first seen first
        self._folders: dict[str, int | None] = {}  # times at which the entries of watched folders last changed
        self._dated = self.in_folder and watched and _keeps_times(root)

    def require_same(self, key: str) -> None:
        """Raise if a file is not a regular one of this store, is empty, or has changed."""
        if self.in_folder:
            self._require_intact(key)
            file = self.root / key
        else:
            file, key = self.root, ""
        if not self._watched:
            return
        now = signature(file)
        if now is not None and self.in_folder and not self._dated:
            now = (*now[:2], 0)  # a mounted object store may give a file another inode at each look
        if key not in self._seen:
            self._require_older(key, now)
            self._seen[key] = now
            if len(self._seen) > _WATCHED:
                first, was = self._seen.popitem(last=False)  # in one step: other threads look, too
                if is_metadata(first):
                    self._seen[first] = was
        elif self._seen[key] != now:
            what = key or "the archive"
            raise self._changed(f"{what} is gone" if now is None else what)

    def require_never_there(self, key: str) -> None:
        """Raise if the folder of a missing chunk has changed: the chunk may have been removed."""
        folder, known = key, not self._dated
        while folder and not known:
            folder = folder.rpartition("/")[0]
            known, now = folder in self._folders, self._time_of(folder)
            if self._folders.setdefault(folder, now) != now:
                raise self._changed(f"the folder of {key}, which is missing")

    def note_folders(self, array: Any) -> None:
        """Note when the folders of an array's chunks last changed: by their own clock, whatever this machine's says."""
        if self._dated:
            for folder in itertools.islice(_folders_of(array), _FOLDERS):
                self._folders.setdefault(folder, self._time_of(folder))

    def _require_intact(self, key: str) -> None:
        file = self.root / key
        if not file.exists() and not file.is_symlink():
            return
        if not file.is_file() or not file.resolve().is_relative_to(self.root):
            raise FormatError(f"{self.root.name} must hold files of its own; {key} is none, or leads elsewhere")
        if file.stat().st_size == 0:
            raise FormatError(f"{self.root.name} must hold whole chunks; {key} is empty")

    def _require_older(self, key: str, now: Signature) -> None:
        """Raise if a chunk, read for the first time, was put into its folder after the folder's time was noted.

        Renaming a file into place, as zarr does, changes the folder's time as well: a file older than that was there. A file that
        was written in place may be younger, so the folder must have changed, too.
        """
        if now is None or not self._dated or is_metadata(key):
            return
        folder = key.rpartition("/")[0]
        if folder not in self._folders:
            self._folders[folder] = self._time_of(folder)
        noted = self._folders[folder]
        if noted is None or (now[0] > noted and self._time_of(folder) != noted):
            raise self._changed(key)

    def _time_of(self, folder: str) -> int | None:
        """Time at which the entries of a folder last changed; None if there is none. Network drives renumber files."""
        found = signature(os.path.join(str(self.root), folder))  # noqa: PTH118  # thousands of them
        return None if found is None else found[0]

    def _changed(self, what: str) -> FormatError:
        return FormatError(f"{self.name} has changed since it was opened ({what}); open it again")


def _folders_of(array: Any) -> Iterator[str]:
    """Folders that hold an array's chunks, or would, and their parents; outer ones first."""
    grid = [-(-n // m) for n, m in zip(array.shape, array.shards or array.chunks, strict=True)]
    path = array.path.split("/") if array.path else []
    yield array.path
    depth = len(array.metadata.encode_chunk_key((0,) * array.ndim).split("/")) - array.ndim  # of the prefix common to all chunks
    for axes in range(array.ndim) if depth >= 0 else ():
        for at in itertools.product(*(range(min(n, _FOLDERS)) for n in grid[:axes])):  # untrusted metadata may imply any number
            key = array.metadata.encode_chunk_key((*at, *(0,) * (array.ndim - axes)))
            yield "/".join([*path, *key.split("/")[: depth + axes]])


def _keeps_times(root: Path) -> bool:
    """Whether times of folders can be relied on: on a mounted object store (FUSE) they may differ at each look."""
    try:
        device = root.stat().st_dev
        lines = Path("/proc/self/mountinfo").read_text(errors="replace").splitlines()
    except OSError:  # not Linux
        return True
    mounts = ((line.split()[2], line.partition(" - ")[2].split()[0]) for line in lines)
    place = f"{os.major(device)}:{os.minor(device)}"
    return not any(kind.partition(".")[0] == "fuse" for at, kind in mounts if at == place)
