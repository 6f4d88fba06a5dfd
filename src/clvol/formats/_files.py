"""What every format module shares: typed errors, safe writing, and what a format can hold."""

from __future__ import annotations

import gzip
import math
import re
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.errors import ClvolError, FormatError
from clvol.volume import Volume

__all__ = [
    "MAX_HEADER",
    "Content",
    "Reader",
    "Writer",
    "foreign_errors",
    "gunzipped_size",
    "inflated_size",
    "require_bytes",
    "require_default",
    "require_folder",
    "sample_count",
    "staged",
    "storable",
]

Content = tuple[NDArray[Any], dict[str, Any]]
"""Samples [z, y, x], and the keyword arguments of `Volume` that the file tells."""

Reader = Callable[..., Content]
Writer = Callable[[Volume, Path], None]

MAX_HEADER = 1 << 20
"""No honest text header is longer; libraries overrun their stack on headers of megabytes."""

_CHUNK = 1 << 20
_WIDER = {"bool": "uint8", "float16": "float32"}  # the next type that holds every value


@contextmanager
def foreign_errors(what: str, reason: Callable[[Exception], str] = str) -> Iterator[None]:
    """Turn whatever a library raises into a `FormatError` that says what was being done."""
    try:
        yield
    except (ClvolError, MemoryError):  # sizes are checked first: a MemoryError is about this machine, not the file
        raise
    except Exception as error:
        raise FormatError(f"cannot {what}: {reason(error) or type(error).__name__}") from error


@contextmanager
def staged(target: Path, suffix: str) -> Iterator[Path]:
    """A path to write to, in a hidden folder beside `target`; moved into place when the block succeeds.

    Data files that the writer leaves beside its header move along, before the header. A folder,
    not a temporary name: libraries choose formats by suffix, and headers name their data file.
    """
    target = target.resolve()  # what a link points to is replaced, the link stays
    if target.is_dir():
        raise FormatError(f"cannot write {target}: it is a folder")
    folder = _hidden_folder(target)
    try:
        written = folder / (target.name[: -len(suffix)] + suffix)  # libraries do not know ".NRRD"
        yield written
        data_files = [file for file in folder.iterdir() if file != written]
        for file in data_files:
            _refuse_to_overwrite_anothers(target.with_name(file.name), target)
        if data_files:  # stopped half-way, an old header must not describe new data
            target.unlink(missing_ok=True)
        for file in data_files:
            file.replace(target.with_name(file.name))
        written.replace(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def require_folder(target: Path) -> None:
    """Raise before hours of work if the folder of `target` does not exist or cannot be written to."""
    _hidden_folder(target).rmdir()


def _hidden_folder(target: Path) -> Path:
    """A new one beside `target`."""
    if not target.parent.is_dir():
        raise FormatError(f"cannot write {target}: the folder {target.parent} does not exist")
    try:
        return Path(tempfile.mkdtemp(dir=target.parent, prefix=".clvol-"))
    except OSError as error:
        raise FormatError(f"cannot write {target}: nothing can be made in {target.parent}: {error.strerror}") from error


def _refuse_to_overwrite_anothers(data_file: Path, header: Path) -> None:
    """Raise if `data_file` exists and the header that is being replaced does not speak of it."""
    if not data_file.exists():
        return
    if header.is_file():
        with header.open("rb") as stream:
            names_it = rb"[\s=:/\\]" + re.escape(data_file.name.encode()) + rb"\s*$"
            if re.search(names_it, stream.read(MAX_HEADER), re.MULTILINE):
                return
    raise FormatError(f"cannot write {header}: its samples would replace {data_file}, which is not its own; choose another name")


def storable(data: NDArray[Any], dtypes: Sequence[str]) -> NDArray[Any]:
    """`data` in native byte order and C order, as one of `dtypes` that holds every value."""
    name = data.dtype.name
    name = name if name in dtypes else _WIDER.get(name, name)
    if name not in dtypes:
        raise FormatError(f"samples must be {', '.join(dtypes)} here; got {data.dtype}: convert them or write .npz")
    return np.ascontiguousarray(data, dtype=name)


def require_default(volume: Volume, names: Sequence[str], instead: str) -> None:
    """Raise if one of the attributes `names`, which the format cannot hold, would be lost."""
    default = Volume(volume.data)
    lost = [name for name in names if not np.array_equal(getattr(volume, name), getattr(default, name))]
    if lost:
        values = ", ".join(f"{name} {np.asarray(getattr(volume, name)).tolist()}" for name in lost)
        raise FormatError(f"the format cannot hold {values}; {instead} can")


def sample_count(shape: Sequence[int]) -> int:
    """How many samples `shape` has; a whole number of any size, unlike ``np.prod``."""
    return math.prod(int(n) for n in shape)


def require_bytes(source: object, found: int, shape: Sequence[int], dtype: DTypeLike, *, exact: bool = False) -> None:
    """Raise if `found` bytes are not what samples of `shape` and `dtype` take."""
    expected = sample_count(shape) * np.dtype(dtype).itemsize
    if found < expected or (exact and found != expected):
        raise FormatError(
            f"{source} must hold {expected} bytes of samples for shape {tuple(shape)} and dtype {np.dtype(dtype)}; found {found}"
        )


def gunzipped_size(stream: IO[bytes], limit: int) -> int:
    """How many bytes the gzip `stream` holds, counted up to just past `limit`; checks its checksum."""
    with gzip.GzipFile(fileobj=stream) as unpacked:
        return _count(unpacked.read, limit)


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
    """Count what `read` gives, without keeping it: libraries fill what is missing with zeros."""
    total = 0
    while total <= limit and (chunk := read(_CHUNK)):
        total += len(chunk)
    return total
