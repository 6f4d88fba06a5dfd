"""OME-Zarr images (0.4 and 0.5, and older ones), and plain arrays and groups of Zarr 2 and 3, in folders and ``.zip`` files."""

from __future__ import annotations

import itertools
import math
import os
import re
import time
import warnings
import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolError, DataError, FormatError, MissingDependencyError
from clvol.bricks.sliced import FlatFile, Index, Signature, Window, said_of_file, said_of_folder, signature
from clvol.formats._bounds import KEY, bounds_of
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._files import bytes_at, require_members, sample_count
from clvol.formats._layout import Layout, decoded, lay_out, place, shrunk, uniform, unnamed
from clvol.formats.guarded.limits import announce, announce_parts
from clvol.interop.kinds import Content
from clvol.volume.volume import SPACES
from clvol.volume.volumes import Leading

__all__ = ["is_one", "lazily", "read", "said", "series", "shown"]

_METADATA = ("zarr.json", ".zgroup", ".zarray")
_ABOUT = (*_METADATA, ".zattrs", ".zmetadata")
_WATCHED = 1 << 17  # chunks whose files are watched, those that were first read last
_FOLDERS = 1 << 11  # folders of an array that are looked at when it is opened, outer ones first; others when they are read from
_SECONDS = 10.0  # after which it is asked again whether what is far away is what it was
_LARGE = 1 << 24  # bytes of a chunk that is read by parts, if it is stored as it is
_TRIED = 4096  # chunks, in search of one that is damaged
_SECRET = 6  # letters, from which on a word of options is left out of messages
_HTTP = ("http", "https")
_QUERY = re.compile(r"""(://[^\s?'"]*)\?[^\s'"]*""")
_IN_EXTRA = ("s3", "s3a", "http", "https")  # addresses that the extra "s3" is for

Load: TypeAlias = Callable[..., Any]  # from a name, an array and an index to its samples there, or a window of them

_OLD_AXES = "tczyx"  # of OME-Zarr 0.1 and 0.2, which name none


@dataclass(frozen=True)
class _Image:
    """A plain array, or a group with an image in several sizes, which `multiscales` describes."""

    id: str
    node: Any
    multiscales: Mapping[str, Any] | None = None
    labels: bool = False

    def level(self, level: int) -> Any:
        """The array of a size."""
        if self.multiscales is None:
            return self.node
        path = None
        try:
            path = self.multiscales["datasets"][level]["path"]
            array = self.node[path]
        except (IndexError, KeyError, TypeError):
            array = None
        if not hasattr(array, "shape"):  # nor has a group
            name = self.node.store_path.store.name
            raise FormatError(f"{name} must hold an array for each of its sizes; that of size {level} has the path {path!r}")
        return array

    @property
    def series(self) -> Series:
        array = self.level(0)
        words = [str((self.multiscales or {}).get("name") or "")] if self.multiscales else [array.dtype.name]
        return Series(self.id, ", ".join(filter(None, [*words, "labels" * self.labels])), tuple(array.shape))


def shown(address: str) -> str:
    """An address as messages name it: without a user's password, and without a query, which may be a signature."""
    kind, colon, rest = address.partition("://")
    server, slash, place = rest.partition("?")[0].partition("/")
    return f"{kind}{colon}{server.rpartition('@')[2]}{slash}{place}"


def said(error: Exception, address: str, options: Mapping[str, Any] | None) -> str:
    """What an error says, without what nobody else may know: passwords, keys and signatures."""
    text = str(error) or type(error).__name__
    rest = address.partition("://")[2]
    known = [rest.partition("?")[2], rest.partition("/")[0].rpartition("@")[0], *_strings(options or {})]
    for secret in sorted(known, key=len, reverse=True):
        if len(secret) >= _SECRET:
            text = text.replace(secret, "...")
    return _QUERY.sub(r"\1?...", text)  # of an address that was put together anew, which may have other escapes


def _strings(options: Any, name: str = "") -> Iterator[str]:
    """All that is a word among options, but the address of a server; of that what it says of a user."""
    if isinstance(options, Mapping):
        for key, value in options.items():
            yield from _strings(value, str(key))
    elif isinstance(options, (list, tuple)):
        for value in options:
            yield from _strings(value, name)
    elif isinstance(options, (str, bytes)):
        word = options.decode("utf-8", "replace") if isinstance(options, bytes) else options
        yield word.partition("://")[2].partition("/")[0].rpartition("@")[0] if name == "endpoint_url" else word


def is_one(path: Path) -> bool:
    """Whether a folder is a Zarr array or group."""
    return any((path / name).is_file() for name in _METADATA)


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """The chunks of one image or array that hold what is chosen; chunks that are not stored have the array's fill value."""
    with _images(path) as images:
        image = _one_of(path.name, images, series)
        if image.multiscales is None:
            chosen_level(path.name, [image.node.shape], level)
            return _plain(path.name, image, choose, _loaded)
        return _multiscale(path.name, image, chosen_level(path.name, _sizes(image), level), choose, _loaded)


def lazily(
    source: Path | str,
    choose: Choice,
    series: int | str | None = None,
    level: int = 0,
    storage_options: Mapping[str, Any] | None = None,
) -> list[Content]:
    """What is chosen of an image in all its sizes from `level` on, the largest first, of which no samples are read yet.

    `source` may be an address (``s3://...``, ``https://...``), which fsspec understands with these `storage_options`.
    """
    store, inner, name = _store(source, storage_options, watched=True)
    try:
        image = _one_of(name, _found(store, inner, name), series)
    except FileNotFoundError as error:
        if store.root is not None:
            raise
        raise FormatError(f"there is no Zarr array or group at {shown(str(source))}, or no such server or bucket") from error

    if image.multiscales is None:
        chosen_level(name, [image.node.shape], level)
        _require_chunks(name, image.node, store)
        return [_plain(name, image, choose, _window)]
    sizes = _sizes(image)
    contents = []
    for number in range(chosen_level(name, sizes, level), len(sizes)):
        _require_chunks(name, image.level(number), store)
        contents.append(_multiscale(name, image, number, choose, _window))
    if not any(one.get("coordinateTransformations") for one in image.multiscales["datasets"]):
        contents = [shrunk(contents[0], content) for content in contents]  # before 0.4 the shapes alone told how far apart
    return contents


def _window(source: str, array: Any, index: Index = ()) -> Window:
    """Of an array in a store that is watched."""
    chunk = sample_count(array.chunks) * array.dtype.itemsize
    in_files = chunk > _LARGE and array.store_path.store.root is not None and array.store_path.store.root.is_dir()
    if in_files and (dtype := _as_stored(array)) is not None:
        return Window(_Unpacked(source, array, array.store_path.store, dtype), array.shape, array.dtype, None, index)
    return Window(_Chunked(source, array, array.store_path.store), array.shape, array.dtype, array.chunks, index)


def _as_stored(array: Any) -> np.dtype[Any] | None:
    """The type of samples that follow each other in the files of chunks as they are, in C's order; None if they do not."""
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


def _one_of(name: str, images: list[_Image], series: int | str | None) -> _Image:
    main = [image for image in images if not image.labels]
    ome = any(image.multiscales for image in main)
    what = "images" if ome else "arrays"
    return images[chosen_series(name, [image.series for image in images], series, what=what, main=len(main), first=ome)]


def _sizes(image: _Image) -> list[tuple[int, ...]]:
    assert image.multiscales is not None
    return [image.level(i).shape for i in range(len(image.multiscales["datasets"]))]


def series(path: Path) -> tuple[Series, ...]:
    """The images and arrays that there are, images before their labels."""
    with _images(path) as images:
        return tuple(image.series for image in images)


@contextmanager
def _images(path: Path) -> Iterator[list[_Image]]:
    store, inner, name = _store(path)
    with closing(store):
        yield _found(store, inner, name)


def _found(store: Any, inner: str, name: str) -> list[_Image]:
    """The images of a store, before their labels."""
    import zarr

    with warnings.catch_warnings():  # what else lies in the folders
        warnings.simplefilter("ignore")
        found = list(_below(zarr.open(store, path=inner, mode="r"), ""))
    if not found:
        raise DataError(f"{name} must hold an array of numbers with two axes or more; it holds none")
    return sorted(found, key=lambda image: image.labels)


def _store(source: Path | str, options: Mapping[str, Any] | None = None, watched: bool = False) -> tuple[Any, str, str]:
    """What zarr reads, the place in it of the array or group, and its name for messages."""
    try:
        import zarr  # noqa: F401  # and not only what may have been imported of it
        from zarr.storage import FsspecStore, LocalStore, ZipStore
    except ImportError as error:
        raise MissingDependencyError("Zarr needs zarr: pip install clvol[microscopy]") from error
    checked = _checked()
    if isinstance(source, str):
        name = shown(source).rstrip("/").rpartition("/")[2] or shown(source)
        try:
            place, about = _for_all_keys(source, options or {})
            found = FsspecStore.from_url(place, storage_options=about, read_only=True)
        except ImportError as error:
            kind = source.partition("://")[0]
            how = "pip install clvol[s3]" if kind in _IN_EXTRA else str(error)  # fsspec names what the others need
            raise MissingDependencyError(f"{shown(source)} needs {error.name or 'what reads ' + kind}: {how}") from error
        return checked(found, None, name, watched, partial(said, address=source, options=options)), "", name
    if source.is_dir():
        root = source.resolve()  # whatever becomes of the working folder, and of links
        return checked(LocalStore(root, read_only=True), root, source.name, watched), "", source.name
    return checked(ZipStore(source, mode="r"), source.absolute(), source.name, watched), _inside(source), source.name


def _most(byte_range: Any) -> float:
    """Bytes that a part of a value has, at most."""
    start, end, suffix = (getattr(byte_range, name, None) for name in ("start", "end", "suffix"))
    if suffix is not None:
        return int(suffix)
    return math.inf if start is None or end is None else int(end) - int(start)


def _for_all_keys(address: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """An address, and options, with which the query of one of HTTP (a token) goes with each key; it ended the address of none."""
    place, _, query = address.partition("?")
    if not query or address.partition("://")[0] not in _HTTP:
        return address, dict(options)
    return place, {**options, "params": [*parse_qsl(query, keep_blank_values=True), *dict(options.get("params", {})).items()]}


@cache
def _checked() -> Any:
    """The class of stores that zarr reads, which look at what is read; zarr is imported for it."""
    from zarr.storage import WrapperStore

    class Checked(WrapperStore[Any]):
        """A store in which what is there must be whole, and what is not there must have a value by the format.

        zarr takes what is no file for a chunk that is not stored, and waits for pipes; it takes zeros for chunks that are not there
        and have no fill value. Where it is `watched`, what is read twice must be the same twice, and what is read once, or missing,
        must not have changed since the array was opened, as far as its folder tells.

        Parameters
        ----------
        store : zarr.abc.store.Store
        root : Path or None
            The folder or the archive; None: it is far away.
        name : str
            For messages.
        watched : bool
        said : callable
            What the error of a library says that others may know.

        Attributes
        ----------
        folder : bool
            Whether the root was a folder when it was opened.
        missing : int
            How many chunks were answered to be missing.
        """

        def __init__(
            self,
            store: Any,
            root: Path | None = None,
            name: str = "",
            watched: bool = False,
            said: Callable[[Exception], str] = str,
        ) -> None:
            super().__init__(store)
            self.root, self.name, self.watched, self.said = root, name, watched, said
            self.folder = root is not None and root.is_dir()
            self.required: set[str] = set()  # arrays whose chunks have no other value
            self.missing = 0
            self._seen: OrderedDict[str, Signature] = OrderedDict()  # the one seen first is first
            self._folders: dict[str, int | None] = {}  # when their entries changed last, those of chunks that are watched
            self._dated = root is not None and self.folder and watched and _keeps_times(root)

        def _with_store(self, store: Any) -> Checked:
            return type(self)(store, self.root, self.name, self.watched, self.said)

        async def get(self, key: str, prototype: Any = None, byte_range: Any = None) -> Any:
            if self.root is not None:
                self.look(key)
            try:
                found = await self._store.get(key, prototype, byte_range)
            except (ClvolError, MemoryError):
                raise
            except Exception as error:  # it is known here what was asked for, and to ask again may take long
                if self.root is not None:
                    raise
                what = key if key.rpartition("/")[2] in _ABOUT else f"chunk {key}"
                raise FormatError(f"cannot read {what} of {self.name}: {self.said(error)}") from error
            if found is not None and not len(found):
                raise FormatError(f"{self.name} must hold whole chunks; {key} is empty")
            if found is not None and len(found) > _most(byte_range):  # all of it, which would be decoded as a part
                raise FormatError(
                    f"cannot read a part of chunk {key} of {self.name}: the server answers with all of it, and shards need one "
                    "that answers requests for ranges"
                )
            if found is None and key.rpartition("/")[2] not in _ABOUT:
                self.missing += 1
                if self.root is not None:
                    self.look(key)  # once more: it may have gone meanwhile
                    self.require_never_there(key)
                array = next((one for one in self.required if key.startswith(one)), None)
                if array is not None:
                    raise FormatError(f"{self.name} must hold all chunks of an array without a fill value; {key} is missing")
            return found

        async def get_partial_values(self, prototype: Any, key_ranges: Any) -> Any:
            return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

        def look(self, key: str) -> None:
            """Raise if a file is none of its own, or another than it was."""
            assert self.root is not None
            if self.folder:
                _require_own_file(self.root, key)
                file = self.root / key
            else:
                file, key = self.root, ""
            if not self.watched:
                return
            now = signature(file)
            if now is not None and self.folder and not self._dated:
                now = (*now[:2], 0)  # what is mounted may number a file anew each time that it is looked at
            if key not in self._seen:
                self._require_older(key, now)
                self._seen[key] = now
                if len(self._seen) > _WATCHED:
                    first, was = self._seen.popitem(last=False)  # at once: other threads look, too
                    if first.rpartition("/")[2] in _ABOUT:
                        self._seen[first] = was
            elif self._seen[key] != now:
                what = key or "the archive"
                raise self._changed(f"{what} is gone" if now is None else what)

        def note_folders(self, array: Any) -> None:
            """Remember when the folders of an array's chunks changed last: by their own clock, whatever this machine's says."""
            if self._dated:
                for folder in itertools.islice(_folders_of(array), _FOLDERS):
                    self._folders.setdefault(folder, self._time_of(folder))

        def _require_older(self, key: str, now: Signature) -> None:
            """Raise if a chunk that is read for the first time was put into its folder after this was looked at first.

            Whoever renames files into their place, as zarr does, changes the folder's time with them: what is older than that was
            there. What was written in place may be younger, so the folder must have changed since, too.
            """
            if now is None or not self._dated or key.rpartition("/")[2] in _ABOUT:
                return
            folder = key.rpartition("/")[0]
            if folder not in self._folders:
                self._folders[folder] = self._time_of(folder)
            noted = self._folders[folder]
            if noted is None or (now[0] > noted and self._time_of(folder) != noted):
                raise self._changed(key)

        def require_never_there(self, key: str) -> None:
            """Raise if entries of the folder that would hold a missing chunk have changed: it may have been one of them."""
            folder, known = key, not self._dated
            while folder and not known:
                folder = folder.rpartition("/")[0]
                known, now = folder in self._folders, self._time_of(folder)
                if self._folders.setdefault(folder, now) != now:
                    raise self._changed(f"the folder of {key}, which is missing")

        def _time_of(self, folder: str) -> int | None:
            """When entries of a folder changed last; None where there is none. Not which it is: networks number files anew."""
            found = signature(os.path.join(str(self.root), folder))  # noqa: PTH118  # thousands of them
            return None if found is None else found[0]

        def _changed(self, what: str) -> FormatError:
            return FormatError(f"{self.name} has changed since it was opened ({what}); open it again")

    return Checked


class _Chunked:
    """Reads parts of an array, and names the chunk that cannot be read."""

    def __init__(self, source: str, array: Any, store: Any) -> None:
        self._source, self._array, self._store = source, array, store
        self._asked = time.monotonic()
        _require_fill(array)
        if store.root is not None:
            store.look(self._about)  # it may not have been read: that of a group may hold what it says
            store.note_folders(array)

    def __call__(self, index: Index) -> NDArray[Any]:
        self._require_the_same()
        missing = self._store.missing
        try:
            found = np.asarray(self._array[index])
        except (ClvolError, MemoryError):
            raise
        except Exception as error:
            message = str(error) or type(error).__name__
            raise FormatError(f"cannot read chunk {self._key_of_damaged(index)} of {self._source}: {message}") from error
        if self._store.missing != missing:  # in a store that has gone all are
            self._require_the_same(now=True)
        return found

    def said(self) -> str:
        """By what the array is known to be the same: of a folder all its files, of what is far away the metadata alone."""
        root = self._store.root
        if root is None:
            return f"metadata {zlib.crc32(repr(self._array.metadata).encode()):08x}"
        return said_of_folder(root / self._array.path) if self._store.folder else said_of_file(root)

    @property
    def _about(self) -> str:
        """The key of the array's metadata."""
        return f"{self._array.path}/{'zarr.json' if self._array.metadata.zarr_format == 3 else '.zarray'}".lstrip("/")

    @property
    def place(self) -> Path | None:
        """The folder or the archive of the store, if it is here."""
        root: Path | None = self._store.root
        return root

    def _require_the_same(self, *, now: bool = False) -> None:
        """Raise if the array's metadata are others by now: at each read of a folder, at times of what is far away."""
        array, store = self._array, self._store
        if store.root is not None:
            store.look(self._about)
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

    def _key_of_damaged(self, index: Index) -> str:
        """The key of the first chunk (of shards: of the shard) among those at an index that cannot be read by itself."""
        array = self._array
        box = [range(n)[at] if isinstance(at, slice) else range(at, at + 1) for n, at in zip(array.shape, index, strict=True)]
        stored = array.shards or array.chunks
        places = [range(part[0] // n, part[-1] // n + 1) for part, n in zip(box, stored, strict=True)]
        for at in itertools.islice(itertools.product(*places), _TRIED):
            one = tuple(
                slice(max(part[0], i * n), min(part[-1] + 1, (i + 1) * n)) for part, i, n in zip(box, at, stored, strict=True)
            )
            try:
                array[one]
            except Exception:
                return f"{array.path}/{array.metadata.encode_chunk_key(at)}".lstrip("/")
        return f"{array.path or '.'} (one of several)"


class _Unpacked(_Chunked):
    """Reads parts of chunks that are stored as they are, without what else is in these: zarr would read them as a whole."""

    def __init__(self, source: str, array: Any, store: Any, dtype: np.dtype[Any]) -> None:
        super().__init__(source, array, store)
        self._dtype = dtype

    def __call__(self, index: Index) -> NDArray[Any]:
        self._require_the_same()
        array = self._array
        box = [range(n)[at] if isinstance(at, slice) else range(at, at + 1) for n, at in zip(array.shape, index, strict=True)]
        result = np.empty([len(part) for part in box], array.dtype)
        places = [range(part[0] // n, part[-1] // n + 1) for part, n in zip(box, array.chunks, strict=True)]
        for chunk in itertools.product(*places):
            inside, target = [], []
            for part, i, n in zip(box, chunk, array.chunks, strict=True):
                low, high = max(part[0], i * n), min(part[-1] + 1, (i + 1) * n)
                inside.append(slice(low - i * n, high - i * n))
                target.append(slice(low - part[0], high - part[0]))
            result[tuple(target)] = self._of_chunk(chunk, tuple(inside))
        self._require_the_same()  # in a store that has gone all chunks are missing
        return result[tuple(slice(None) if isinstance(at, slice) else 0 for at in index)]

    def _of_chunk(self, chunk: tuple[int, ...], inside: tuple[slice, ...]) -> Any:
        """Some samples of a chunk, or the value of one that is not stored."""
        array = self._array
        key = f"{array.path}/{array.metadata.encode_chunk_key(chunk)}".lstrip("/")
        self._store.look(key)
        file = self._store.root / key
        if not file.exists():
            self._store.look(key)  # once more: it may have gone meanwhile
            self._store.require_never_there(key)
            if array.metadata.fill_value is None:
                raise FormatError(f"{self._source} must hold all chunks of an array without a fill value; {key} is missing")
            return array.metadata.fill_value
        whole = sample_count(array.chunks) * array.dtype.itemsize
        if (found := file.stat().st_size) != whole:
            raise FormatError(f"cannot read chunk {key} of {self._source}: it must have {whole} bytes; it has {found}")
        return FlatFile(file, array.chunks, self._dtype, 0)(inside)


def _require_fill(array: Any) -> None:
    """Have the store raise for chunks that are missing, if the array, of Zarr 2, has no value for them."""
    if array.metadata.fill_value is None:
        array.store_path.store.required.add(f"{array.path}/" if array.path else "")


def _require_chunks(name: str, array: Any, store: Any) -> None:
    """Raise if an array in a folder has no chunk at all, or chunks of nothing: it was not copied whole, or never written."""
    if not all(array.chunks) or not all(array.shards or (1,)):
        raise FormatError(f"{name} must have chunks that hold samples; those of {array.path or '.'} have the shape {array.chunks}")
    if array.dtype.kind not in "biuf" or 0 in array.shape:
        raise DataError(f"{name} must hold real numbers; {array.path or '.'} holds {array.dtype} of shape {array.shape}")
    announce(name, sample_count(array.chunks) * array.dtype.itemsize)
    if not store.folder:
        return
    if not _has_chunks(store.root / array.path):
        raise FormatError(
            f"{name} must hold samples; {array.path or '.'} has none of its chunks (clvol.read reads its fill value "
            f"{array.fill_value} for all of them)"
        )


def _has_chunks(folder: str | os.PathLike[str]) -> bool:
    """Whether there is anything but metadata and empty folders: those of nested chunks are made before these."""
    with os.scandir(folder) as entries:
        others = (entry for entry in entries if entry.name not in _ABOUT and not entry.name.startswith("."))
        return any(not entry.is_dir(follow_symlinks=False) or _has_chunks(entry.path) for entry in others)


def _require_own_file(root: Path, key: str) -> None:
    """Raise if what the store would read for a key is there, but is no file of its own with something in it."""
    file = root / key
    if not file.exists() and not file.is_symlink():
        return
    if not file.is_file() or not file.resolve().is_relative_to(root):
        raise FormatError(f"{root.name} must hold files of its own; {key} is none, or leads elsewhere")
    if file.stat().st_size == 0:
        raise FormatError(f"{root.name} must hold whole chunks; {key} is empty")


def _folders_of(array: Any) -> Iterator[str]:
    """Those that hold an array's chunks, or would, and those that hold these; outer ones first."""
    grid = [-(-n // m) for n, m in zip(array.shape, array.shards or array.chunks, strict=True)]
    path = array.path.split("/") if array.path else []
    yield array.path
    depth = len(array.metadata.encode_chunk_key((0,) * array.ndim).split("/")) - array.ndim  # of what all chunks have in common
    for axes in range(array.ndim) if depth >= 0 else ():
        for at in itertools.product(*(range(min(n, _FOLDERS)) for n in grid[:axes])):  # metadata may list any number
            key = array.metadata.encode_chunk_key((*at, *(0,) * (array.ndim - axes)))
            yield "/".join([*path, *key.split("/")[: depth + axes]])


def _keeps_times(root: Path) -> bool:
    """Whether folders have times of their own: those of an object store that is mounted (FUSE) may have any, another each time."""
    try:
        device = root.stat().st_dev
        lines = Path("/proc/self/mountinfo").read_text(errors="replace").splitlines()
    except OSError:  # not Linux
        return True
    mounts = ((line.split()[2], line.partition(" - ")[2].split()[0]) for line in lines)
    place = f"{os.major(device)}:{os.minor(device)}"
    return not any(kind.partition(".")[0] == "fuse" for at, kind in mounts if at == place)


def _inside(path: Path) -> str:
    """Where an archive has its array or group: at its root, or in a folder that was packed."""
    with zipfile.ZipFile(path) as archive:
        require_members(path.name, archive, replaced=True)
        found = [name for name in archive.namelist() if name.rpartition("/")[2] in _METADATA]
    if not found:
        raise FormatError(f"{path.name} must hold a Zarr array or group; unpack archives of other files, and read what they hold")
    return min(found, key=lambda name: name.count("/")).rpartition("/")[0]


def _below(node: Any, path: str, labels: bool = False) -> Iterator[_Image]:
    """The images in `node` and the groups below, in the natural order of their names."""
    if hasattr(node, "shape"):
        if node.ndim >= 2 and node.dtype.kind in "biuf":
            yield _Image(path or ".", node, None, labels)
        return
    about = _ome(node)
    multiscales = about.get("multiscales")
    if multiscales:
        yield _Image(path or ".", node, multiscales[0], labels or "image-label" in about)
        if "labels" in node:
            yield from _below(node["labels"], f"{path}/labels".lstrip("/"), labels=True)
        return
    for name, member in sorted(node.members(), key=lambda pair: _natural(pair[0])):
        yield from _below(member, f"{path}/{name}".lstrip("/"), labels)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _ome(node: Any) -> dict[str, Any]:
    """The metadata of OME: in 0.5 below a key of their own, before among others."""
    attributes: dict[str, Any] = dict(node.attrs)
    return dict(attributes.get("ome", attributes))


def _multiscale(source: str, image: _Image, level: int, choose: Choice, load: Load) -> Content:
    multiscales = image.multiscales
    assert multiscales is not None
    array, about = image.level(level), _ome(image.node)
    given = multiscales.get("axes") or list(_OLD_AXES[-array.ndim :])
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in given]
    words = [axis["type"] if axis.get("type") in ("time", "channel") else axis["name"] for axis in axes]
    channels = about.get("omero", {}).get("channels", [])
    keep = [*("channel",) * bool(channels), *("z",) * (load is not _loaded)]  # what is read part by part has three axes
    layout = lay_out(source, words, array.shape, keep)
    factors, shifts = [1.0] * array.ndim, [0.0] * array.ndim
    for step in (
        *multiscales["datasets"][level].get("coordinateTransformations", ()),
        *multiscales.get("coordinateTransformations", ()),
    ):
        kind = step.get("type")
        numbers = step.get(kind)
        given = isinstance(numbers, list) and len(numbers) == array.ndim and all(isinstance(n, (int, float)) for n in numbers)
        if kind == "scale" and given:
            factors = [a * b for a, b in zip(factors, numbers, strict=True)]
            shifts = [a * b for a, b in zip(shifts, numbers, strict=True)]
        elif kind == "translation" and given:
            shifts = [a + b for a, b in zip(shifts, numbers, strict=True)]
        elif kind != "identity":
            raise FormatError(f"{source} must place its axes by a scale and a translation of {array.ndim} numbers; got {step}")
    if any(factor < 0 for factor in factors):
        raise FormatError(f"{source} must have scales that are positive; got {factors}")
    lines = {axis: (float(shift), float(factor)) for axis, factor, shift in zip(layout.axes, factors, shifts, strict=True)}
    units = {axis: str(one.get("unit") or "") for axis, one in zip(layout.axes, axes, strict=True)}
    known: dict[str, Any] = {"space": "image"} | place(layout, lines, units)
    if len(channels) == 1 and "channel" not in layout.axes:
        known |= _leading(Layout(("channel",), (1,)), channels).about([0])
    own = dict(image.node.attrs).get(KEY, {})
    if own and layout.axes == ("z", "y", "x"):  # clvol.pyramid wrote it
        known |= _of_pyramid(own, known)
        if load is not _loaded:
            known["bounds"] = bounds_of(
                image.node, own, multiscales["datasets"][level]["path"], array.shape[::-1], lambda one: _window(source, one)
            )
    if image.labels:
        known["labels"] = _labels(about) or True
    data, chosen = layout.chosen(source, choose, lambda index: load(source, array, index), _leading(layout, channels))
    return data, known | chosen


def _of_pyramid(own: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """What OME-Zarr has no place for: which way the axes go, and of what space they are."""
    about: dict[str, Any] = {"space": own["space"]} if own.get("space") in SPACES else {"space": ""}
    if "direction" in own:
        direction = np.asarray(own["direction"], np.float64)
        about |= {"direction": direction, "origin": (direction @ known["origin"]).tolist()}
    return about


def _leading(layout: Layout, channels: list[Mapping[str, Any]]) -> Leading:
    """With what `omero` says of the channels: names, colours in hexadecimal, and windows."""
    if "channel" not in layout.axes or len(channels) != layout.shape[layout.axes.index("channel")]:
        return Leading(layout.leading, layout.counts)
    names = tuple(str(channel.get("label") or "") for channel in channels)
    colors = tuple(_color(channel.get("color")) for channel in channels)
    ends = [(window.get("start"), window.get("end")) for window in (channel.get("window") or {} for channel in channels)]
    windows = tuple(
        (float(a), float(b)) if a is not None and b is not None and -math.inf < a < b < math.inf else None for a, b in ends
    )
    return Leading(
        layout.leading,
        layout.counts,
        {"channel": names} if any(names) else {},
        colors if any(color not in (None, (1.0, 1.0, 1.0)) for color in colors) else (),
        windows if any(windows) else (),
    )


def _color(text: str | None) -> tuple[float, float, float] | None:
    if not isinstance(text, str) or not re.fullmatch(r"#?[0-9a-fA-F]{6}([0-9a-fA-F]{2})?", text):
        return None
    r, g, b = (int(text.removeprefix("#")[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return r, g, b


def _loaded(source: str, array: Any, index: tuple[int | slice, ...] = ()) -> NDArray[Any]:
    """Samples of an array. Chunks that are not stored have its fill value, as Zarr has it; those that are must be whole."""
    chunk = sample_count(array.shards or array.chunks) * array.dtype.itemsize
    announce(source, max(chunk, bytes_at(array.shape, index, array.dtype)))
    _require_fill(array)
    taken = [len(range(n)[at]) if isinstance(at, slice) else 1 for n, at in zip(array.shape, index, strict=False)]
    counts = [*taken, *array.shape[len(taken) :]]
    announce_parts(source, sample_count([-(-n // m) for n, m in zip(counts, array.shards or array.chunks, strict=True)]))
    return np.asarray(array[index])


def _labels(about: Mapping[str, Any]) -> dict[int, str]:
    """What the label values stand for, where their properties have a name."""
    names = {}
    for one in about.get("image-label", {}).get("properties", ()):
        name = next((one[key] for key in ("name", "class", "label") if isinstance(one.get(key), str)), None)
        if name is not None and "label-value" in one:
            names[int(one["label-value"])] = name
    return names


def _plain(source: str, image: _Image, choose: Choice, load: Load) -> Content:
    """An array as it is; its axes by names, if it has them, and their coordinates, as xarray stores these."""
    array = image.node
    words = [str(name or "") for name in _dimensions(array)]
    named = any(words)
    words = words if named else unnamed(array.shape, array.dtype)
    layout = lay_out(source, words, array.shape, asked=choose.given)
    lines, units = {}, {}
    for axis, word in zip(layout.axes, words, strict=True):
        values = _beside(image, word) if axis in ("x", "y", "z") and word else None
        if values is not None and values.shape == (layout.shape[layout.axes.index(axis)],):
            lines[axis] = uniform(_loaded(source, values)) or (0.0, float("nan") if values.shape[0] > 1 else 1.0)
            units[axis] = str(values.attrs.get("units", ""))
    leading = layout.channels_of(array.dtype) if words[-1:] == ["channel"] and not named else None
    data, chosen = layout.chosen(source, choose, lambda index: decoded(load(source, array, index), dict(array.attrs)), leading)
    return data, {"name": image.id.rpartition("/")[2].strip(".")} | place(layout, lines, units) | chosen


def _dimensions(array: Any) -> list[str]:
    """Names of the axes, which Zarr 3 has, and xarray gave those of Zarr 2."""
    names = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    return list(names) if names is not None and len(names) == array.ndim else [""] * array.ndim


def _beside(image: _Image, name: str) -> Any:
    """The array of this name that lies beside an image: the coordinates of an axis."""
    import zarr

    parent = image.node.store_path.store, image.node.path.rpartition("/")[0]
    try:
        return zarr.open_array(parent[0], path=f"{parent[1]}/{name}".lstrip("/"), mode="r")
    except (FileNotFoundError, KeyError):
        return None
