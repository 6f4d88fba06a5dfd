"""Stores that zarr reads through, in folders, archives and at addresses; everything read is checked. Importing this needs zarr."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from zarr.storage import FsspecStore, LocalStore, WrapperStore, ZipStore

from clvol.base.errors import ChunkError, ClvolError, FormatError, MissingDependencyError
from clvol.formats.zarr.addresses import IN_EXTRA, name_of, said, shown, split_query
from clvol.formats.zarr.files import Files, inside, is_metadata

__all__ = ["CheckedStore", "open_store"]


class CheckedStore(WrapperStore[Any]):
    """A store in which what is there must be whole, and what is missing must have a value by the format.

    zarr reads zeros for missing chunks of an array without a fill value. `files` is the folder or archive on this machine, None of
    a remote store; `said` gives the message of a library's error, without secrets.
    """

    def __init__(self, store: Any, name: str, files: Files | None = None, said: Callable[[Exception], str] = str) -> None:
        super().__init__(store)
        self.name, self.files, self._said = name, files, said
        self.required: set[str] = set()  # key prefixes of arrays that have no fill value
        self.missing = 0  # reads of missing chunks

    def _with_store(self, store: Any) -> CheckedStore:
        return type(self)(store, self.name, self.files, self._said)

    async def get(self, key: str, prototype: Any = None, byte_range: Any = None) -> Any:
        if self.files is not None:
            self.files.require_same(key)
        try:
            found = await self._store.get(key, prototype, byte_range)
        except (ClvolError, MemoryError):
            raise
        except Exception as error:  # the key is known here, and reading it again may take long
            if self.files is not None:
                raise
            what = key if is_metadata(key) else f"chunk {key}"
            raise FormatError(f"cannot read {what} of {self.name}: {self._said(error)}") from error
        if found is None:
            if not is_metadata(key):
                self._require_fill(key)
            return None
        if not len(found):
            raise ChunkError(f"{self.name} must hold whole chunks; {key} is empty")
        if len(found) > _most(byte_range):  # the whole chunk, which would be decoded as a part
            raise FormatError(
                f"cannot read a part of chunk {key} of {self.name}: the server answers with all of it, and shards need one "
                "that answers requests for ranges"
            )
        return found

    async def get_partial_values(self, prototype: Any, key_ranges: Any) -> Any:
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    def _require_fill(self, key: str) -> None:
        """Raise if a chunk is missing that was there, or has no fill value."""
        self.missing += 1
        if self.files is not None:
            self.files.require_same(key)  # again: it may have vanished meanwhile
            self.files.require_never_there(key)
        if any(key.startswith(array) for array in self.required):
            raise ChunkError(f"{self.name} must hold all chunks of an array without a fill value; {key} is missing")


def open_store(source: Path | str, options: Mapping[str, Any] | None = None, watched: bool = False) -> tuple[CheckedStore, str]:
    """The store of a folder, an archive or an address, and the path of the array or group in it."""
    if isinstance(source, str):
        try:
            place, about = split_query(source, options or {})
            found = FsspecStore.from_url(place, storage_options=about, read_only=True)
        except ImportError as error:
            kind = source.partition("://")[0]
            how = 'pip install "clvol[s3]"' if kind in IN_EXTRA else str(error)  # fsspec names what other schemes need
            raise MissingDependencyError(f"{shown(source)} needs {error.name or 'what reads ' + kind}: {how}") from error
        return CheckedStore(found, name_of(source), said=partial(said, address=source, options=options)), ""
    name = source.name
    if source.is_dir():
        root = source.resolve()  # independent of the working folder and of links
        return CheckedStore(LocalStore(root, read_only=True), name, Files(root, name, watched)), ""
    return CheckedStore(ZipStore(source, mode="r"), name, Files(source.absolute(), name, watched)), inside(source)


def _most(byte_range: Any) -> float:
    """Largest number of bytes in a byte range."""
    start, end, suffix = (getattr(byte_range, name, None) for name in ("start", "end", "suffix"))
    if suffix is not None:
        return int(suffix)
    return math.inf if start is None or end is None else int(end) - int(start)
