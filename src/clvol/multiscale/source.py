"""By what the source of a pyramid is known to be the same, when an unfinished one is gone on with."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from clvol.chunks import Chunks
from clvol.lazy import LazyVolume
from clvol.sliced import said_of_file, said_of_folder

__all__ = ["said_of"]


def said_of(volume: LazyVolume) -> str:
    """What differs if the samples do: of files their sizes and times, of arrays in memory a checksum of all.

    Of others (dask's, what is far away) the samples in the middle are all that is looked at, and metadata.
    """
    some = zlib.crc32(np.ascontiguousarray(volume.part().data).tobytes())
    source = volume.data.source if isinstance(volume.data, Chunks) else volume.data
    return f"{volume.shape} {volume.dtype} {some:08x}, {_whole(source)}"


def _whole(data: Any) -> str:
    said = getattr(data, "said", None)
    if callable(said):
        return str(said())
    if isinstance(data, np.ndarray):
        mapped = _mapped(data)
        return said_of_file(mapped) if mapped is not None else f"in memory {_checksum(data):08x}"
    file = getattr(getattr(data, "file", None), "filename", None)  # h5py
    if isinstance(file, str) and Path(file).is_file():
        return said_of_file(file)
    place = getattr(data, "store_path", None)  # zarr
    root = getattr(getattr(place, "store", None), "root", None)
    if isinstance(root, Path) and root.is_dir():
        return said_of_folder(root / getattr(place, "path", ""))
    return "the rest not known"


def _mapped(data: Any) -> str | None:
    """The file that an array is a part of."""
    while isinstance(data, np.ndarray):
        if isinstance(data, np.memmap) and data.filename is not None:
            return str(data.filename)
        data = data.base
    return None


def _checksum(data: Any) -> int:
    check = 0
    for plane in data:
        check = zlib.crc32(np.ascontiguousarray(plane).tobytes(), check)
    return check
