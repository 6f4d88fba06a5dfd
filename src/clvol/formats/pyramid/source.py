"""What identifies the source of a pyramid, so that an unfinished one is resumed from the same samples only."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.errors import FormatError
from clvol.bricks.chunks import Chunks
from clvol.bricks.sliced import Window, said_of_file, said_of_folder
from clvol.bricks.source import LazyVolume

__all__ = ["require_apart", "said_of"]


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
