"""What every format module shares: typed errors, counts of bytes, and what a format can hold."""

from __future__ import annotations

import gzip
import math
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.errors import ClvolError, FormatError
from clvol.foreign import Content, held_as
from clvol.volume import Volume

__all__ = [
    "Reader",
    "Writer",
    "foreign_errors",
    "gunzipped_size",
    "inflated_size",
    "require_bytes",
    "require_default",
    "require_expansion",
    "require_members",
    "sample_count",
    "scaled",
    "storable",
]

Reader = Callable[..., Content]
Writer = Callable[[Volume, Path], None]

_CHUNK = 1 << 20
_EXPANSION = 200  # bytes of samples for one of a file; masks that are nearly all zero have more, but not by the gigabyte
_UNQUESTIONED = 1 << 30  # bytes of samples that any file may stand for: arrays of HDF5 and Zarr need not store their zeros


@contextmanager
def foreign_errors(what: str, reason: Callable[[Exception], str] = str) -> Iterator[None]:
    """Turn whatever a library raises into a `FormatError` that says what was being done."""
    try:
        yield
    except (ClvolError, MemoryError):  # sizes are checked first: a MemoryError is a fact of this machine, not of the file
        raise
    except Exception as error:
        raise FormatError(f"cannot {what}: {reason(error) or type(error).__name__}") from error


def storable(data: NDArray[Any], dtypes: Sequence[str]) -> NDArray[Any]:
    """`data` in native byte order and C order, as one of `dtypes` that holds every value."""
    return held_as(data, dtypes, FormatError)


def scaled(data: NDArray[Any], slope: float, offset: float) -> NDArray[Any]:
    """``slope * data + offset`` in float64, or `data` themselves where that is what it means."""
    if slope == 1 and offset == 0:
        return data
    values = data.astype(np.float64)
    values *= slope
    values += offset
    return values


def require_default(volume: Volume, names: Sequence[str], instead: str) -> None:
    """Raise if one of the attributes `names`, which the format cannot hold, would be lost."""
    default = Volume(volume.data)
    lost = [name for name in names if not np.array_equal(getattr(volume, name), getattr(default, name))]
    if lost:
        values = ", ".join(f"{name} {np.asarray(getattr(volume, name)).tolist()}" for name in lost)
        raise FormatError(f"the format cannot hold {values}; {instead} can")


def sample_count(shape: Sequence[int]) -> int:
    """How many samples `shape` has; it never overflows, unlike ``np.prod``."""
    return math.prod(int(n) for n in shape)


def require_bytes(source: object, found: int, shape: Sequence[int], dtype: DTypeLike, *, exact: bool = False) -> None:
    """Raise if `found` bytes do not fit samples of `shape` and `dtype`."""
    expected = sample_count(shape) * np.dtype(dtype).itemsize
    if found < expected or (exact and found != expected):
        raise FormatError(
            f"{source} must hold {expected} bytes of samples for shape {tuple(shape)} and dtype {np.dtype(dtype)}; found {found}"
        )


def require_expansion(source: object, needed: int, stored: int) -> None:
    """Raise before memory is asked for if `stored` bytes stand for an absurd number of bytes of samples."""
    allowed = max(_UNQUESTIONED, _EXPANSION * stored)
    if needed > allowed:
        raise FormatError(
            f"{source} must hold up to {allowed} bytes of samples, {_EXPANSION} for each of its {stored}; its header says {needed}"
        )


def require_members(source: object, archive: zipfile.ZipFile) -> None:
    """Raise before a member of an archive is unpacked: each must have a name of its own, and no absurd size."""
    members = archive.infolist()
    if len({member.filename for member in members}) != len(members):
        raise FormatError(f"{source} must hold members of different names; some have the same")
    for member in members:
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FormatError(f"{source} must be packed by deflate, if at all; {member.filename[:80]!r} is not")
        if member.compress_type == zipfile.ZIP_STORED and member.file_size != member.compress_size:
            raise FormatError(f"{source} must hold what it says; {member.filename[:80]!r} is stored with two sizes")
        require_expansion(f"{source}[{member.filename[:80]}]", member.file_size, member.compress_size)


def gunzipped_size(stream: IO[bytes], limit: int) -> int:
    """How many bytes the gzip `stream` holds; its checksums are checked, for it is read to its end.

    Raises
    ------
    FormatError
        More than `limit` bytes: what has no end is not unpacked.
    """
    with gzip.GzipFile(fileobj=stream) as unpacked:
        found = _count(unpacked.read, limit)
    if found > limit:
        raise FormatError(f"what is packed must have up to {limit} bytes; it has more")
    return found


def inflated_size(stream: IO[bytes], packed: int, limit: int) -> int:
    """How many bytes the next `packed` bytes of `stream` (zlib or gzip) hold, counted up to just past `limit`."""
    inflater = zlib.decompressobj(47)  # 47: either kind of header
    end = stream.tell() + packed

    def read(size: int) -> bytes:
        while not inflater.eof:
            part = inflater.unconsumed_tail or stream.read(min(_CHUNK, end - stream.tell()))
            if chunk := inflater.decompress(part, size):
                return chunk
            if not part:
                raise EOFError("the compressed samples end too early")
        return b""

    return _count(read, limit)


def _count(read: Callable[[int], bytes], limit: int) -> int:
    """Count the bytes that `read` gives without keeping them: libraries fill what is missing with zeros."""
    total = 0
    while total <= limit and (chunk := read(_CHUNK)):
        total += len(chunk)
    return total
