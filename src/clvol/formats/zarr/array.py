"""Arrays of a checked store: read whole, or part by part as `Window`s that name the chunk they cannot read."""

from __future__ import annotations

import time
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ChunkError, ClvolError, DataError, FormatError
from clvol.bricks.sliced import FlatFile, Index, Window, said_of_file, said_of_folder
from clvol.formats._files import bytes_at, chunks_in, damaged_chunk, sample_count, spans
from clvol.formats.guarded.limits import announce, announce_parts
from clvol.formats.zarr.files import has_chunks

if TYPE_CHECKING:
    from clvol.formats.zarr._store import CheckedStore

__all__ = ["loaded", "part_of", "require_chunks"]

_SECONDS = 10.0  # after which a remote store's metadata are compared again
_LARGE = 1 << 24  # bytes of a chunk that is read by parts, if it is not compressed


def loaded(source: str, array: Any, index: Index = ()) -> NDArray[Any]:
    """Samples of an array. Missing chunks have its fill value, as in zarr; others must be whole."""
    chunk = sample_count(array.shards or array.chunks) * array.dtype.itemsize
    announce(source, max(chunk, bytes_at(array.shape, index, array.dtype)))
    _require_fill(array)
    taken = [len(range(n)[at]) if isinstance(at, slice) else 1 for n, at in zip(array.shape, index, strict=False)]
    counts = [*taken, *array.shape[len(taken) :]]
    announce_parts(source, sample_count([-(-n // m) for n, m in zip(counts, array.shards or array.chunks, strict=True)]))
    try:
        return np.asarray(array[index])
    except (ClvolError, MemoryError):
        raise
    except Exception as error:
        raise _damaged(source, array, index, error) from error


def part_of(source: str, array: Any, index: Index = ()) -> Window:
    """A part of an array in a watched store."""
    files = array.store_path.store.files
    chunk = sample_count(array.chunks) * array.dtype.itemsize
    if chunk > _LARGE and files is not None and files.root.is_dir() and (dtype := _uncompressed(array)) is not None:
        return Window(_Uncompressed(source, array, dtype), array.shape, array.dtype, None, index)
    return Window(_Chunked(source, array), array.shape, array.dtype, array.chunks, index)


def require_chunks(name: str, array: Any) -> None:
    """Raise if an array in a folder has no chunks at all, or empty ones: it was copied incompletely, or never written."""
    if not all(array.chunks) or not all(array.shards or (1,)):
        raise FormatError(f"{name} must have chunks that hold samples; those of {array.path or '.'} have the shape {array.chunks}")
    if array.dtype.kind not in "biuf" or 0 in array.shape:
        raise DataError(f"{name} must hold real numbers; {array.path or '.'} holds {array.dtype} of shape {array.shape}")
    announce(name, sample_count(array.chunks) * array.dtype.itemsize)
    files = array.store_path.store.files
    if files is not None and files.in_folder and not has_chunks(files.root / array.path):
        raise FormatError(
            f"{name} must hold samples; {array.path or '.'} has none of its chunks (clvol.read reads its fill value "
            f"{array.fill_value} for all of them)"
        )


class _Chunked:
    """Reads parts of an array."""

    def __init__(self, source: str, array: Any) -> None:
        self._source, self._array = source, array
        self._store: CheckedStore = array.store_path.store
        self._asked = time.monotonic()
        _require_fill(array)
        if self._store.files is not None:
            self._store.files.require_same(self._metadata)  # it may be unread: consolidated metadata of a group may hold the same
            self._store.files.note_folders(array)

    def __call__(self, index: Index) -> NDArray[Any]:
        self._require_the_same()
        missing = self._store.missing
        try:
            found = np.asarray(self._array[index])
        except (ClvolError, MemoryError):
            raise
        except Exception as error:
            raise _damaged(self._source, self._array, index, error) from error
        if self._store.missing != missing:  # all chunks are, of a store that has vanished
            self._require_the_same(now=True)
        return found

    def said(self) -> str:
        """Fingerprint of the array: of all files of a folder; of a remote store of the metadata alone."""
        files = self._store.files
        if files is None:
            return f"metadata {zlib.crc32(repr(self._array.metadata).encode()):08x}"
        return said_of_folder(files.root / self._array.path) if files.in_folder else said_of_file(files.root)

    @property
    def place(self) -> Path | None:
        """The folder or archive of the store, if it is on this machine."""
        files = self._store.files
        return None if files is None else files.root

    @property
    def _metadata(self) -> str:
        """Key of the array's metadata."""
        return _key(self._array, "zarr.json" if self._array.metadata.zarr_format == 3 else ".zarray")

    def _require_the_same(self, *, now: bool = False) -> None:
        """Raise if the array's metadata have changed: checked at each read of a file, and now and then of a remote store."""
        array, store = self._array, self._store
        if store.files is not None:
            store.files.require_same(self._metadata)
            return
        begun = time.monotonic()
        if begun - self._asked < _SECONDS and not now:
            return
        import zarr

        try:
            found = zarr.open_array(store, path=array.path, mode="r", zarr_format=array.metadata.zarr_format)
        except Exception as error:
            raise FormatError(f"cannot read {self._source} any more: {str(error) or type(error).__name__}") from error
        if found.metadata != array.metadata:
            raise FormatError(f"{self._source} has changed since it was opened ({array.path or '.'}); open it again")
        self._asked = begun


class _Uncompressed(_Chunked):
    """Reads parts of uncompressed chunks, and nothing else of them: zarr would read whole chunks."""

    def __init__(self, source: str, array: Any, dtype: np.dtype[Any]) -> None:
        super().__init__(source, array)
        self._dtype = dtype

    def __call__(self, index: Index) -> NDArray[Any]:
        self._require_the_same()
        array = self._array
        box = spans(array.shape, index)
        result = np.empty([len(part) for part in box], array.dtype)
        for chunk, parts in chunks_in(box, array.chunks):
            inside = tuple(slice(p.start - i * n, p.stop - i * n) for p, i, n in zip(parts, chunk, array.chunks, strict=True))
            target = tuple(slice(p.start - whole[0], p.stop - whole[0]) for p, whole in zip(parts, box, strict=True))
            result[target] = self._of_chunk(chunk, inside)
        self._require_the_same()  # of a store that has vanished all chunks are missing
        return result[tuple(slice(None) if isinstance(at, slice) else 0 for at in index)]

    def _of_chunk(self, chunk: tuple[int, ...], inside: tuple[slice, ...]) -> Any:
        """Some samples of a chunk, or the fill value if it is missing."""
        array, files = self._array, self._store.files
        assert files is not None
        key = _key(array, array.metadata.encode_chunk_key(chunk))
        files.require_same(key)
        file = files.root / key
        if not file.exists():
            files.require_same(key)  # again: it may have vanished meanwhile
            files.require_never_there(key)
            if array.metadata.fill_value is None:
                raise ChunkError(f"{self._source} must hold all chunks of an array without a fill value; {key} is missing")
            return array.metadata.fill_value
        whole = sample_count(array.chunks) * array.dtype.itemsize
        if (found := file.stat().st_size) != whole:
            raise ChunkError(f"cannot read chunk {key} of {self._source}: it must have {whole} bytes; it has {found}")
        return FlatFile(file, array.chunks, self._dtype, 0)(inside)


def _key(array: Any, name: str) -> str:
    return f"{array.path}/{name}".lstrip("/")


def _damaged(source: str, array: Any, index: Index, error: Exception) -> ChunkError:
    """The error that names the first chunk (or shard) at an index that cannot be read."""
    at = damaged_chunk(array, index, array.shards or array.chunks)
    name = f"{array.path or '.'} (one of several)" if at is None else _key(array, array.metadata.encode_chunk_key(at))
    return ChunkError(f"cannot read chunk {name} of {source}: {str(error) or type(error).__name__}")


def _uncompressed(array: Any) -> np.dtype[Any] | None:
    """The dtype of samples that chunks' files hold as they are, in C order; None if they are encoded."""
    about = array.metadata
    if about.zarr_format == 2:
        if about.compressor is not None or about.filters or about.order != "C":
            return None
        native: np.dtype[Any] = about.dtype.to_native_dtype()
        return native
    (codec, *others) = about.codecs
    if others or type(codec).__name__ != "BytesCodec":
        return None
    order = getattr(codec.endian, "value", codec.endian)
    stored: np.dtype[Any] = np.dtype(array.dtype).newbyteorder(">" if order == "big" else "<")
    return stored


def _require_fill(array: Any) -> None:
    """Have the store refuse missing chunks if the array, of Zarr 2, has no fill value."""
    if array.metadata.fill_value is None:
        array.store_path.store.required.add(f"{array.path}/" if array.path else "")
