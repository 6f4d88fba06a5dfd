"""What format modules share: errors, byte counts, dtypes that a format can hold."""

from __future__ import annotations

import gzip
import itertools
import math
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.base.errors import DataError, FormatError
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content, held_as
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

__all__ = [
    "Reader",
    "Writer",
    "bytes_at",
    "chunks_in",
    "damaged_chunk",
    "gunzipped_size",
    "inflated_size",
    "packed",
    "paired",
    "require_bytes",
    "require_default",
    "require_members",
    "sample_count",
    "scaled",
    "spans",
    "storable",
    "unpacked",
    "unplaced_by",
    "xz_size",
]

Reader = Callable[..., Content]
Writer = Callable[[Volume | Volumes, Path], None]

_CHUNK = 1 << 20
_TRIED = 4096  # chunks to try, in search of a damaged one
_GZIP_RESERVED = 0xE0  # flags of a member that must be 0
_XZ, _XZ_FOOTER, _XZ_BITS = b"\xfd7zXZ\0", 12, 63  # magic bytes; bytes of the footer; bits of a number


def storable(data: NDArray[Any], dtypes: Sequence[str]) -> NDArray[Any]:
    """`data` in native byte order and C order, as one of `dtypes` that holds every value."""
    return held_as(data, dtypes, FormatError)


def scaled(data: NDArray[Any], slope: float, offset: float) -> NDArray[Any]:
    """``slope * data + offset`` in float64; `data` itself for a slope of 1 and an offset of 0."""
    if slope == 1 and offset == 0:
        return data
    values = data.astype(np.float64)
    try:
        with np.errstate(over="raise"):
            values *= slope
            values += offset
    except FloatingPointError as error:
        raise DataError(
            f"samples must be finite when they are scaled; {slope:g} times {data.dtype} and {offset:g} are not"
        ) from error
    return values


def require_default(volume: Volume, names: Sequence[str], instead: str) -> None:
    """Raise if one of the attributes `names`, which the format cannot hold, is not the default."""
    default = Volume(volume.data)
    lost = [name for name in names if not np.array_equal(getattr(volume, name), getattr(default, name))]
    if lost:
        values = ", ".join(f"{name} {np.asarray(getattr(volume, name)).tolist()}" for name in lost)
        raise FormatError(f"the format cannot hold {values}; {instead} can")


def unplaced_by(what: str, spacing: Any) -> dict[str, str]:
    """What is said of a spacing that is not positive and finite, under the key that readers use; `what` is its name in the file."""
    lengths = np.asarray(spacing, np.float64).ravel()
    if bool(((lengths > 0) & (lengths < np.inf)).all()):
        return {}
    return {"unplaced": f"{what} must be positive and finite along each axis; found {lengths.tolist()}"}


def sample_count(shape: Sequence[int]) -> int:
    """Number of samples of `shape`; unlike ``np.prod``, it never overflows."""
    return math.prod(int(n) for n in shape)


def require_bytes(source: object, found: int, shape: Sequence[int], dtype: DTypeLike, *, exact: bool = False) -> None:
    """Raise if `found` bytes do not fit samples of `shape` and `dtype`."""
    expected = sample_count(shape) * np.dtype(dtype).itemsize
    if found < expected or (exact and found != expected):
        raise FormatError(
            f"{source} must hold {expected} bytes of samples for shape {tuple(shape)} and dtype {np.dtype(dtype)}; found {found}"
        )


def bytes_at(shape: Sequence[int], index: Sequence[int | slice], dtype: np.dtype[Any]) -> int:
    """Bytes of the samples at an index of an array; the index may omit last axes."""
    taken = (len(range(n)[at]) for n, at in zip(shape, index, strict=False) if isinstance(at, slice))
    return sample_count([*taken, *shape[len(index) :]]) * dtype.itemsize


def spans(shape: Sequence[int], index: Sequence[int | slice]) -> list[range]:
    """The samples that an index takes along each axis."""
    return [range(n)[at] if isinstance(at, slice) else range(at, at + 1) for n, at in zip(shape, index, strict=True)]


def chunks_in(box: Sequence[range], chunks: Sequence[int]) -> Iterator[tuple[tuple[int, ...], list[range]]]:
    """The chunks that a box meets, and the samples in both."""
    for at in itertools.product(*(range(part[0] // n, part[-1] // n + 1) for part, n in zip(box, chunks, strict=True))):
        yield at, [range(max(p[0], i * n), min(p[-1] + 1, (i + 1) * n)) for p, i, n in zip(box, at, chunks, strict=True)]


def damaged_chunk(array: Any, index: Sequence[int | slice], chunks: Sequence[int]) -> tuple[int, ...] | None:
    """The first chunk at an index of an array that cannot be read; None if none is found."""
    for at, part in itertools.islice(chunks_in(spans(array.shape, index), chunks), _TRIED):
        try:
            array[tuple(slice(one.start, one.stop) for one in part)]
        except Exception:  # of whatever library
            return at
    return None


def require_members(source: object, archive: zipfile.ZipFile, *, replaced: bool = False) -> None:
    """Check an archive before any member is unpacked: names must be unique, and sizes plausible.

    If `replaced`, members may be replaced by later ones of the same name, as zarr does when attributes change.
    """
    members = archive.infolist()
    if replaced:
        for member in members:  # a member hidden by another's damaged name is not replaced
            if member.compress_type == zipfile.ZIP_STORED:
                archive.open(member).close()
        members = list({member.filename: member for member in members}.values())
    if len({member.filename for member in members}) != len(members):
        raise FormatError(f"{source} must hold members of different names; some have the same")
    for member in members:
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FormatError(f"{source} must be packed by deflate, if at all; {member.filename[:80]!r} is not")
        if member.compress_type == zipfile.ZIP_STORED and member.file_size != member.compress_size:
            raise FormatError(f"{source} must hold what it says; {member.filename[:80]!r} is stored with two sizes")
        announce(f"{source}[{member.filename[:80]}]", member.file_size, member.compress_size)
        with archive.open(member):  # compares the name with the directory's
            pass


def packed(path: Path) -> bool:
    """Whether a whole file is packed by gzip, by its name."""
    return path.suffix.lower() in (".gz", ".mgz")


def paired(path: Path, suffix: str) -> Path | None:
    """The file of a pair that ends in `suffix` (".hdr", ".img"), which may be packed, like the other; `path` is that of either."""
    plain = path.with_suffix("") if packed(path) else path
    names = (plain.with_suffix(suffix), plain.with_suffix(suffix.upper()))
    found = [file for name in names for file in (name, name.with_name(f"{name.name}.gz")) if file.is_file()]
    return min(found, key=lambda file: packed(file) != packed(path), default=None)


def unpacked(path: Path) -> IO[bytes]:
    """A file, opened to read what it holds once unpacked."""
    return cast(IO[bytes], gzip.open(path)) if packed(path) else path.open("rb")


def gunzipped_size(stream: IO[bytes], limit: int) -> int:
    """Unpacked bytes of a gzip stream, read to its end, where checksums are verified; more than `limit` are a `FormatError`."""
    start = stream.tell()
    head = stream.read(4)
    stream.seek(start)
    if len(head) == 4 and head[3] & _GZIP_RESERVED:  # RFC 1952, 2.3.1.2; SimpleITK refuses it too, but leaves the file open
        raise FormatError(f"what is packed by gzip must be so as its standard has it; its flags are {head[3]:#04x}")
    with gzip.GzipFile(fileobj=stream) as unpacked:
        found = _count(unpacked.read, limit)
    if found > limit:
        raise FormatError(f"what is packed must have up to {limit} bytes; it has more")
    return found


def inflated_size(stream: IO[bytes], packed: int, limit: int, *, exact: bool = False) -> int:
    """Unpacked bytes of the next `packed` bytes of `stream` (zlib or gzip), counted up to just past `limit`.

    If `exact`, nothing may follow the compressed samples.
    """
    inflater = zlib.decompressobj(47)  # a header of zlib or of gzip
    end = stream.tell() + packed

    def read(size: int) -> bytes:
        while not inflater.eof:
            part = inflater.unconsumed_tail or stream.read(min(_CHUNK, end - stream.tell()))
            if chunk := inflater.decompress(part, size):
                return chunk
            if not part:
                raise EOFError("the compressed samples end too early")
        if exact and (inflater.unused_data or stream.tell() < end):
            raise FormatError(f"the compressed samples must end where the file does; {len(inflater.unused_data)} bytes follow them")
        return b""

    return _count(read, limit)


def xz_size(stream: IO[bytes], start: int, length: int) -> int:
    """Unpacked bytes of an XZ stream of `length` bytes, from the index at its end, whose checksums are verified.

    Source: The .xz File Format, version 1.2.1, 2.1.2 (the footer) and 4 (the index).
    """
    stream.seek(start)
    whole = stream.read(len(_XZ)) == _XZ and length > 2 * _XZ_FOOTER
    stream.seek(start + length - _XZ_FOOTER if whole else start)
    footer = stream.read(_XZ_FOOTER)
    if not whole or footer[-2:] != b"YZ" or footer[:4] != zlib.crc32(footer[4:-2]).to_bytes(4, "little"):
        raise FormatError("what is packed as XZ must begin and end so; it is damaged or cut short")
    size = 4 * (int.from_bytes(footer[4:8], "little") + 1)
    if size > length - 2 * _XZ_FOOTER:
        raise FormatError("what is packed as XZ must hold its index; it is damaged or cut short")
    stream.seek(start + length - _XZ_FOOTER - size)
    index = stream.read(size)
    if index[-4:] != zlib.crc32(index[:-4]).to_bytes(4, "little"):
        raise FormatError("the index of what is packed as XZ must have the checksum that it says; it is damaged")
    numbers, value, shift = [], 0, 0
    for byte in index[1:-4]:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            numbers.append(value)
            value = shift = 0
        elif shift > _XZ_BITS:
            raise FormatError(f"numbers in what is packed as XZ must have up to {_XZ_BITS} bits; it is damaged")
    return sum(numbers[2 : 1 + 2 * numbers[0] : 2])  # the number of blocks, then for each its packed and unpacked bytes


def _count(read: Callable[[int], bytes], limit: int) -> int:
    """Count the bytes that `read` returns, for libraries fill missing ones with zeros."""
    total = 0
    while total <= limit and (chunk := read(_CHUNK)):
        total += len(chunk)
    return total
