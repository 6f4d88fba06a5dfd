"""TIFF files as tifffile opens them: warnings are errors, and directories, files they name, strips and tiles are checked before.

tifffile would give zeros or other numbers for damaged ones.
"""

from __future__ import annotations

import html
import io
import logging
import operator
import re
import struct
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from clvol.base.errors import ClvolError, ClvolWarning, FormatError, MissingDependencyError
from clvol.formats._files import inflated_size, xz_size
from clvol.formats.guarded.limits import announce
from clvol.formats.tiff.about import check

__all__ = ["check_order", "check_samples", "decoding", "explained", "opened", "strict", "tifffile"]

_DECLARED = re.compile(r"<!(DOCTYPE|ENTITY)")
_NAMED = re.compile(r"""FileName\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_listening = threading.local()


def tifffile() -> Any:
    try:
        import tifffile
    except ImportError as error:
        raise MissingDependencyError('TIFF files need tifffile: pip install "clvol[microscopy]"') from error
    return tifffile


@contextmanager
def opened(path: Path, stay: bool = False) -> Iterator[Any]:
    """The file, opened by tifffile once its directories are checked; warnings that tifffile logs are raised. It may `stay` open."""
    library = tifffile()
    _directories_of(path)
    with strict(path.name):
        with explained(f"{path.name} must have directories and fields that tifffile reads"):
            file = library.TiffFile(path)
        with nullcontext() if stay else file:
            _require_own_files(path, file)
            with explained(f"{path.name} must describe its images as its pages are", partial(check, path.name, file)):
                _ = file.series
            with explained(f"{path.name} must be a sound TIFF file"):
                yield file


@contextmanager
def explained(rule: str, cause: Callable[[], None] | None = None) -> Iterator[None]:
    """Turn what tifffile and its codecs raise, or log, into a `FormatError` of the rule, unless `cause` raises a better one."""
    try:
        yield
    except MemoryError:
        raise
    except (ClvolError, ClvolWarning):
        if cause is not None:
            cause()
        raise
    except Exception as error:
        if cause is not None:
            cause()
        said = f"says: {error}" if isinstance(error, ValueError) else f"stops with a {type(error).__name__}"
        raise FormatError(f"{rule}; tifffile {said}") from error


def _require_own_files(path: Path, file: Any) -> None:
    """Raise before tifffile opens files named in OME-XML: it would block on a pipe, and read any file."""
    text = file.ome_metadata or ""
    if _DECLARED.search(text):
        raise FormatError(f"{path.name} must have OME-XML without declarations of a document type or of entities")
    for name in (html.unescape(a or b) for a, b in _NAMED.findall(text)):  # escaped ones too, as &#47;
        if re.search(r"[/\\]", name) or name in ("", ".."):
            raise FormatError(f"{path.name} must name the other files of its set, beside it; got {name[:80]!r}")
        other = path.with_name(name)
        if other.exists() and (not other.is_file() or other.resolve().parent != path.resolve().parent):
            raise FormatError(f"{path.name} must name files that lie beside it; {name[:80]!r} is elsewhere, or no file")


class _Overheard:
    """Mixed into a `logging.Logger`: raises warnings in threads that listen, however the program has configured logging."""

    def isEnabledFor(self, level: int) -> bool:  # a name of logging
        heard = getattr(_listening, "heard", None) is not None and level >= logging.WARNING
        return heard or super().isEnabledFor(level)  # type: ignore[misc]  # of the logger

    def handle(self, record: logging.LogRecord) -> None:
        heard: list[FormatError] | None = getattr(_listening, "heard", None)
        if heard is None:
            super().handle(record)  # type: ignore[misc]
        elif record.levelno >= logging.WARNING:
            text = re.sub(r"^<tifffile\.TiffFile '.*?'> ", "", record.getMessage())
            error = FormatError(
                f"{_listening.name} is damaged or unusual, says tifffile: {text}; "
                "if you trust what tifffile makes of it, give its array to clvol.Volume"
            )
            heard.append(error)
            raise error


@contextmanager
def strict(name: str) -> Iterator[None]:
    """Raise warnings that tifffile logs of the file `name`: it continues after damage, and omits slices or zeroes them."""
    logger = logging.getLogger("tifffile")
    if not isinstance(logger, _Overheard):  # permanently: other threads may be listening
        logger.__class__ = type("Overheard", (_Overheard, type(logger)), {})
    before = getattr(_listening, "heard", None), getattr(_listening, "name", "")
    heard: list[FormatError] = []
    _listening.heard, _listening.name = heard, name
    try:
        yield
    finally:
        _listening.heard, _listening.name = before
    if heard:  # tifffile caught it
        raise heard[0]


# -- directories, one per page, chained by offsets --------------------------------------------------------------------


_WIDTH, _LENGTH, _BITS, _COMPRESSION, _COLOR, _SAMPLES, _PLANES = 256, 257, 258, 259, 262, 277, 284
_CHILDREN = 330  # offsets of child directories
_ROWS, _TILE_WIDTH, _TILE_LENGTH, _DEPTH, _TILE_DEPTH = 278, 322, 323, 32997, 32998
_SUBSAMPLED = 6  # colours may be stored for every other pixel only
_DEFAULTS: dict[int, tuple[int, ...]] = {  # how samples are stored, by default
    _WIDTH: (),
    _LENGTH: (),
    _BITS: (1,),
    _COMPRESSION: (1,),
    _COLOR: (),
    266: (1,),  # order of the bits of a byte
    _SAMPLES: (1,),  # per pixel
    _PLANES: (1,),  # samples interleaved, or in separate planes
    317: (1,),  # predictor
    339: (1,),  # unsigned, signed or floating
    _ROWS: (),
    _TILE_WIDTH: (),
    _TILE_LENGTH: (),
    _DEPTH: (1,),
    _TILE_DEPTH: (1,),
}
_SINGLE = (_WIDTH, _LENGTH, _COMPRESSION, _COLOR, _SAMPLES, _PLANES, 317, _ROWS, _TILE_WIDTH, _TILE_LENGTH)
_READ = {*_DEFAULTS, _CHILDREN}
_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}  # of a type
_PLACES = (273, 279, 324, 325)  # offsets and lengths of strips and of tiles
_NOT_WHOLE = (2, 5, 7, 10, 11, 12)  # text, fractions, bytes, floating numbers
_WHOLE = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_MAX_VALUES = 1 << 16  # of a field that says how samples are stored

Directory = Mapping[int, tuple[int, ...]]
"""How the samples of a page are stored: values by tag."""


def _directories_of(path: Path) -> dict[int, Directory]:
    with path.open("rb") as stream:
        return _directories(stream, path.stat().st_size, path.name)


def _directories(stream: IO[bytes], size: int, name: str) -> dict[int, Directory]:
    """The directories of a file of `size` bytes, by offset; pages that are stored alike share one object."""
    head = stream.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
    version = struct.unpack(order + "H", head[2:4])[0] if order and len(head) >= 8 else 0
    big = version == 43
    if version != 42 and not (big and len(head) == 16 and struct.unpack(order + "HH", head[4:8]) == (8, 0)):
        raise FormatError(f"{name} must begin as a TIFF or BigTIFF file does; found {head[:8]!r}")
    pointer = struct.Struct(order + ("Q" if big else "I"))
    number, field = struct.Struct(order + ("Q" if big else "H")), struct.Struct(order + ("HHQ8s" if big else "HHI4s"))
    room = pointer.size
    found: dict[int, Directory] = {}
    alike: dict[tuple[tuple[int, ...], ...], Directory] = {}
    waiting = [pointer.unpack_from(head, 8 if big else 4)[0]]
    while waiting:
        at = waiting.pop()
        if at == 0:
            continue
        if at in found:
            raise FormatError(f"{name} must have directories in a row; one at {at} is reached twice")
        start = _at(stream, at, number.size)
        fields = number.unpack(start)[0] if len(start) == number.size else 0
        if fields < 1 or at + number.size + fields * field.size + room > size:
            raise FormatError(f"{name} must have directories of one field or more before its end, {size}; one at {at} has {fields}")
        table = stream.read(fields * field.size + room)
        directory = dict(_DEFAULTS)
        for tag, kind, count, value in field.iter_unpack(table[:-room]):
            length = count * _BYTES.get(kind, 0)
            if length > room and pointer.unpack(value)[0] + length > size:
                raise FormatError(f"{name} must hold the values of every field; {count} of tag {tag} end past its end, {size}")
            if tag in _PLACES and kind in _NOT_WHOLE:
                raise FormatError(
                    f"{name} must give whole numbers for tag {tag}, of strips or tiles; it has numbers of type {kind}"
                )
            if tag in _SINGLE and count != 1:
                raise FormatError(f"{name} must give one number for tag {tag}; it has {count}")
            if tag not in _READ:
                continue
            if kind not in _WHOLE or count > _MAX_VALUES:
                raise FormatError(
                    f"{name} must have up to {_MAX_VALUES} whole numbers for tag {tag}; it has {count} of type {kind}"
                )
            content = value[:length] if length <= room else _at(stream, pointer.unpack(value)[0], length)
            values = struct.unpack(f"{order}{count}{_WHOLE[kind]}", content)
            if tag == _CHILDREN:
                waiting += values
            else:
                directory[tag] = values
        found[at] = alike.setdefault(tuple(directory.values()), directory)
        waiting.append(pointer.unpack(table[-room:])[0])
    if not found:
        raise FormatError(f"{name} must hold an image; it holds none")
    return found


def _at(stream: IO[bytes], offset: int, length: int) -> bytes:
    stream.seek(offset)
    return stream.read(length)


def _segments(page: Directory) -> tuple[int, int, int, int] | None:
    """Strips or tiles per plane, planes, unpacked bytes of a segment and of the last one; None if samples are not contiguous."""
    width, length, samples, planes = ((page[tag] or (0,))[0] for tag in (_WIDTH, _LENGTH, _SAMPLES, _PLANES))
    bits = set(page[_BITS])
    if len(bits) != 1 or page[_COLOR] == (_SUBSAMPLED,) or page[_DEPTH] != (1,):
        return None
    beside, planes = (1, samples) if planes == 2 else (samples, 1)
    across = page[_TILE_WIDTH][0] if page[_TILE_WIDTH] else width
    row = -(-across * beside * min(bits) // 8)
    if page[_TILE_WIDTH] and page[_TILE_LENGTH]:
        down = page[_TILE_LENGTH][0]
        count = -(-width // max(1, across)) * -(-length // max(1, down))
        return count, planes, down * row, down * row
    rows = max(1, min(page[_ROWS][0] if page[_ROWS] else length, length))
    count = -(-length // rows)
    return count, planes, rows * row, (length - (count - 1) * rows) * row


# -- strips and tiles -------------------------------------------------------------------------------------------------


_DEFLATED = (8, 32946)
_LZMA = (34925, 34926)
_LOSSLESS = (*_DEFLATED, 5, 32773, 50000)  # and LZW, PackBits, Zstandard
_MOST_STORED, _HEAD = 2, 4096  # bytes that a codec needs at most for one of samples, and for its header
_HEADER = 8  # bytes before anything else in a file; tifffile uses the offset 0 for a segment that is not stored


def check_samples(name: str, pages: Sequence[Any], keyframe: Any, count: int, read: int | None = None) -> None:
    """Raise if samples lie past the end of the file, or a slice is missing or stored in another way than tifffile assumes.

    Nothing is allocated before that. Of `count` samples only `read` may be read at a time.
    """
    files = {page.parent.filehandle.path: page.parent.filehandle.size for page in pages if page is not None}
    walked = {file: _directories_of(Path(file)) for file in files}
    first = walked.get(keyframe.parent.filehandle.path, {}).get(keyframe.offset)
    sizes = _segments(first) if first is not None and not keyframe.parent.is_stk else None  # a page of STK holds several slices
    for page in pages:
        if page is None:
            raise FormatError(f"{name} must hold all of its slices; some are missing")
        handle = page.parent.filehandle
        if len(page.dataoffsets) != len(page.databytecounts):
            found = f"{len(page.dataoffsets)} places and {len(page.databytecounts)} lengths"
            raise FormatError(f"{name} must have a place and a length for each strip or tile; one page has {found}")
        ends = map(operator.add, page.dataoffsets, page.databytecounts)
        if max(ends, default=sys.maxsize) > handle.size or min(page.databytecounts) < 1 or min(page.dataoffsets) < _HEADER:
            raise FormatError(f"{name} must hold the samples of every slice; some lie before or past the samples of the file")
        own = walked[handle.path].get(page.offset, first)  # pages of ImageJ and others may have no directory
        if own is not first and first is not None and own is not None and own != first:
            found = ", ".join(f"tag {tag}: {first[tag]} and {own[tag]}" for tag in own if own[tag] != first[tag])
            raise FormatError(f"{name} must have pages of one shape and type; it has {found}")
        if sizes is not None:
            _check_lengths(name, page.databytecounts, sizes, keyframe.compression != 1)
    stored = sum(files.values())
    if keyframe.compression == 1 and count * int(np.min(keyframe.bitspersample)) > 8 * stored:
        raise FormatError(f"{name} must hold {count} samples of {keyframe.dtype}; it has {stored} bytes")
    announce(name, (count if read is None else read) * keyframe.dtype.itemsize, stored)
    if sizes is not None and keyframe.compression in _LOSSLESS:
        with decoding(name, [keyframe]):
            _check_unpacked(name, keyframe, sizes)
    if sizes is not None and keyframe.compression in _LZMA:
        for page in pages:
            _check_ends(name, page, sizes)


@contextmanager
def decoding(name: str, pages: Sequence[Any]) -> Iterator[None]:
    """Turn what codecs raise into a `FormatError` that names the first strip or tile that is damaged."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            yield
    except (ClvolError, ClvolWarning, MemoryError):
        raise
    except Exception as error:
        raise FormatError(f"cannot read {_first_damaged(pages)} of {name}: it is damaged, its codec says: {error}") from error


def _first_damaged(pages: Sequence[Any]) -> str:
    for page in pages:
        number = 0
        try:
            for number, _ in enumerate(page.segments(maxworkers=1), 1):  # noqa: B007
                pass
        except Exception:
            return f"{'tile' if page.keyframe.is_tiled else 'strip'} {number} of page {page.index}"
    return "the samples"


def check_order(name: str, image: Any) -> None:
    """Raise if an image is read contiguously, as ImageJ's are, but the directories of its pages have other offsets."""
    if image.dataoffset is None:
        return
    for number, page in enumerate(image):
        expected = image.dataoffset + number * image.keyframe.nbytes
        if page is not None and page.dataoffsets and page.dataoffsets[0] != expected:
            raise FormatError(
                f"{name} must have slices that follow each other; slice {number} is at {page.dataoffsets[0]}, not at {expected}"
            )


def _check_lengths(name: str, lengths: Sequence[int], sizes: tuple[int, int, int, int], packed: bool) -> None:
    """Raise if strips or tiles of a page have other lengths than the fields of its directory imply."""
    per_plane, planes, full, last = sizes
    if len(lengths) != per_plane * planes:
        raise FormatError(f"{name} must have {per_plane * planes} strips or tiles in each page; one has {len(lengths)}")
    if packed:
        wrong = [found for found in lengths if found > _MOST_STORED * full + _HEAD]
    else:  # the last strip may be padded
        wrong = [found for i, found in enumerate(lengths) if found != full and (found != last or (i + 1) % per_plane)]
    if wrong:
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; one has {wrong[0]}")


def _check_unpacked(name: str, keyframe: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if the first segment decodes to another length than its fields imply: tifffile would drop the excess."""
    per_plane, _, full, last = sizes
    handle = keyframe.parent.filehandle
    handle.seek(keyframe.dataoffsets[0])
    content = handle.read(keyframe.databytecounts[0])
    if keyframe.compression in _DEFLATED:
        found = inflated_size(io.BytesIO(content), len(content), full)
    else:
        found = len(tifffile().TIFF.DECOMPRESSORS[keyframe.compression](content))
    if found not in ((full, last) if per_plane == 1 else (full,)):
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; found {found}")


def _check_ends(name: str, page: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if a segment in XZ is truncated or declares another length: its checksum is not read once all samples are decoded."""
    per_plane, _, full, last = sizes
    for number, (offset, length) in enumerate(zip(page.dataoffsets, page.databytecounts, strict=True), 1):
        found = xz_size(page.parent.filehandle, offset, length)
        if found != full and (found != last or number % per_plane):
            raise FormatError(
                f"{name} must hold {full} bytes of samples in each strip or tile; one in XZ says that it holds {found}"
            )
