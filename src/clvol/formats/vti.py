"""VTK's image data (``.vti``): arrays at the points or in the cells of a grid.

VTK's own reader ends the process on false lengths, and reads missing samples from anywhere. This one follows the description of the
format in VTK's documentation, "VTK XML Formats".
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._choice import Choice, Series, chosen_series
from clvol.formats._files import sample_count, unplaced_by
from clvol.formats._headers import numbers, parsed
from clvol.formats._layout import lay_out
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["read", "series"]

_DTYPES = {f"{kind}{bits}": f"{kind.lower()}{bits}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
_DTYPES |= {"Float32": "float32", "Float64": "float64"}
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_USUAL = {"Spacing": "1 1 1", "Origin": "0 0 0", "Direction": "1 0 0 0 1 0 0 0 1"}
_LENGTHS = {"UInt32": "I", "UInt64": "Q"}
_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor", "vtkLZ4DataCompressor")
_APPENDED = re.compile(rb"<AppendedData\s+encoding\s*=\s*[\"'](raw|base64)[\"']\s*>\s*_")
_END = re.compile(rb"\s*</AppendedData>\s*</VTKFile>\s*\Z")
_MAX_AXIS = 1 << 31  # samples along an axis: extents have 32 bits


@dataclass(frozen=True)
class _Array:
    """An array at points or in cells: whether it is the one that VTK shows, and the slices and elements of its pieces."""

    kind: str
    name: str
    components: int
    names: tuple[str, ...]
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    active: bool
    pieces: list[tuple[tuple[slice, ...], ET.Element]] = field(default_factory=list)

    @property
    def series(self) -> Series:
        parts = (self.dtype.name, f"{self.components} components" * (self.components > 1), "in cells" * (self.kind == "Cell"))
        return Series(self.name, ", ".join(filter(None, parts)), self.shape)


@dataclass(frozen=True)
class _File:
    """The contents of a file: its grid, its arrays, and how samples are encoded."""

    name: str
    spacing: NDArray[np.float64]
    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    extent: tuple[int, ...]
    arrays: list[_Array]
    order: str
    length: str
    compressor: str
    appended: memoryview
    encoded: bool


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """One array at points or in cells, with samples at the cells' centres. Components are channels."""
    file = _parsed(path)
    active = sum(array.active for array in file.arrays)
    listed = [array.series for array in file.arrays]
    array = file.arrays[chosen_series(path.name, listed, series, what="arrays", first=active == 1)]
    channels, names = array.components, array.names
    layout = lay_out(path.name, [*"zyx", "channel"], (*array.shape, channels))
    leading = Leading(
        layout.leading,
        layout.counts,
        {"channel": names} if channels > 1 and all(names) else {},
        vector=channels in (2, 3) and array.dtype.kind == "f",
    )
    data, chosen = layout.chosen(path.name, choose, lambda index: _samples(file, array)[index], leading)
    low = np.array(file.extent[::2])
    first = low + (0.5 * (np.array(file.extent[1::2]) > low) if array.kind == "Cell" else 0.0)
    origin = file.origin + file.direction @ (first * file.spacing)
    known = {"spacing": file.spacing, "origin": origin, "direction": file.direction, "name": array.name}
    return data, known | unplaced_by("its Spacing", file.spacing) | chosen


def series(path: Path) -> tuple[Series, ...]:
    """The arrays of a file: those at points, then those in cells."""
    return tuple(array.series for array in _parsed(path).arrays)


def _parsed(path: Path) -> _File:
    """The file's metadata, from its XML before appended samples."""
    announce(path.name, path.stat().st_size)
    content = path.read_bytes()
    found, end = _APPENDED.search(content), _END.search(content, max(0, len(content) - 1024))
    if found:
        if end is None:
            raise FormatError(f"{path.name} must be a file of VTK's in XML; it is cut short, or something follows its end")
        text, appended = content[: found.start()] + b"</VTKFile>", memoryview(content)[found.end() : end.start()]
    else:
        text, appended = content, memoryview(b"")
    if re.search(rb"<!(DOCTYPE|ENTITY)", text):
        raise FormatError(f"{path.name} must have no declarations of a document type or of entities")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise FormatError(f"{path.name} must be a file of VTK's in XML; it is not, or cut short: {error}") from error
    grid = root.find("ImageData")
    if root.tag != "VTKFile" or root.get("type") != "ImageData" or grid is None:
        raise FormatError(f"{path.name} must be XML image data of VTK (ImageData); it is {root.tag} of {root.get('type')}")
    order, length = _ORDERS.get(root.get("byte_order", "")), _LENGTHS.get(root.get("header_type", "UInt32"))
    compressor = root.get("compressor", "")
    if order is None or length is None or compressor not in _COMPRESSORS:
        found_in = {key: root.get(key) for key in ("byte_order", "header_type", "compressor")}
        raise FormatError(f"{path.name} must be written in a way of {_ORDERS}, {_LENGTHS}, {_COMPRESSORS}; it has {found_in}")
    extent = _extent(path.name, grid.get("WholeExtent", ""))
    spacing, origin, direction = (
        np.array(numbers(path.name, key, grid.get(key, usual), len(usual.split()))) for key, usual in _USUAL.items()
    )
    return _File(
        path.name,
        spacing,
        origin,
        direction.reshape(3, 3),
        extent,
        _arrays(path.name, grid, extent),
        order,
        length,
        compressor,
        appended,
        found is not None and found[1] == b"base64",
    )


def _extent(name: str, text: str) -> tuple[int, ...]:
    """First and last index along x, y and z."""
    words = text.split()
    values = tuple(map(int, words)) if all(re.fullmatch(r"-?[0-9]{1,10}", word) for word in words) else ()
    if len(values) != 6 or not all(0 <= high - low < _MAX_AXIS for low, high in zip(values[::2], values[1::2], strict=True)):
        raise FormatError(f"{name} must hold at least one sample along each axis; its extent is {text[:80]!r}")
    return values


def _arrays(name: str, grid: ET.Element, whole: tuple[int, ...]) -> list[_Array]:
    """The arrays of numbers, the active ones first."""
    found: dict[tuple[str, str], _Array] = {}
    pieces = grid.findall("Piece")
    for piece in pieces:
        extent = _extent(name, piece.get("Extent", ""))
        if any(a < b for a, b in zip(extent[::2], whole[::2], strict=True)) or any(
            a > b for a, b in zip(extent[1::2], whole[1::2], strict=True)
        ):
            raise FormatError(f"{name} must have pieces within its extent, {whole}; one has {extent}")
        for kind in ("Point", "Cell"):
            section, titles = piece.find(f"{kind}Data"), set[str]()
            for element in section.findall("DataArray") if section is not None else ():
                title, dtype = element.get("Name"), _DTYPES.get(element.get("type", ""))
                if title in (None, "vtkGhostType") or dtype is None or section is None:
                    continue
                array = _array(name, kind, element, np.dtype(dtype), whole, section.get("Scalars") == title)
                array = found.setdefault((kind, title or ""), array)
                if array.name in titles:
                    raise FormatError(f"{name} must hold each array once in each piece; {title!r} is there twice")
                titles.add(array.name)
                array.pieces.append((_box(kind, extent, whole), element))
    if not found:
        raise DataError(f"{name} must hold an array of numbers; it holds none")
    for array in found.values():
        if len(array.pieces) != len(pieces):
            raise FormatError(
                f"{name} must hold its arrays in each of {len(pieces)} pieces; {array.name!r} is in {len(array.pieces)}"
            )
    return sorted(found.values(), key=lambda array: (not array.active, array.kind == "Cell"))


def _array(name: str, kind: str, element: ET.Element, dtype: np.dtype[Any], whole: tuple[int, ...], active: bool) -> _Array:
    text = element.get("NumberOfComponents", "1")
    if not re.fullmatch(r"[1-9][0-9]{0,3}", text):
        raise FormatError(f"{name} must have 1 to 9999 components in {element.get('Name')!r}; it says {text[:80]!r}")
    names = tuple(element.get(f"ComponentName{i}", "") for i in range(int(text)))
    return _Array(kind, element.get("Name", ""), int(text), names, dtype, _size(kind, whole), active)


def _size(kind: str, extent: tuple[int, ...]) -> tuple[int, ...]:
    """Samples along z, y and x; an axis of one point has one cell."""
    points = [high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True)][::-1]
    return tuple(points if kind == "Point" else [max(1, n - 1) for n in points])


def _box(kind: str, extent: tuple[int, ...], whole: tuple[int, ...]) -> tuple[slice, ...]:
    """The slices of a piece in the array."""
    return tuple(
        slice(extent[axis] - whole[axis], extent[axis] - whole[axis] + n)
        for axis, n in zip((4, 2, 0), _size(kind, extent), strict=True)
    )


def _samples(file: _File, array: _Array) -> NDArray[Any]:
    """All samples of an array, [z, y, x, component]."""
    shape = (*array.shape, array.components)
    announce(file.name, sample_count(shape) * array.dtype.itemsize)
    if len(array.pieces) == 1 and array.pieces[0][0] == tuple(slice(0, n) for n in array.shape):
        return _values(file, array.pieces[0][1], sample_count(shape), array.dtype).reshape(shape)
    data, there = np.empty(shape, array.dtype), np.zeros(array.shape, bool)
    for box, element in array.pieces:
        part = data[box]
        data[box] = _values(file, element, part.size, array.dtype).reshape(part.shape)
        there[box] = True
    if not there.all():
        raise FormatError(f"{file.name} must hold pieces that fill its extent; {array.name!r} lacks {int((~there).sum())} samples")
    return data


def _values(file: _File, element: ET.Element, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The `count` samples of an element."""
    if element.get("format") == "ascii":
        return parsed(file.name, repr(element.get("Name")), element.text or "", dtype, count)
    raw = b"".join(_blocks(file, element, count * dtype.itemsize))
    if len(raw) != count * dtype.itemsize:
        raise FormatError(f"{file.name} must hold {count * dtype.itemsize} bytes of {element.get('Name')!r}; found {len(raw)}")
    return np.frombuffer(raw, dtype.newbyteorder(file.order)).astype(dtype)  # type: ignore[arg-type]  # one of `_ORDERS`


def _blocks(file: _File, element: ET.Element, expected: int) -> Iterator[bytes | memoryview]:
    """The unpacked blocks of an element, whose lengths stand before them."""
    stored = _stored(file, element)
    word = struct.calcsize(file.length)

    def lengths(n: int) -> tuple[int, ...]:
        return struct.unpack(f"{file.order}{n}{file.length}", stored.take(n * word))

    if not file.compressor:
        (size,) = lengths(1)
        if size != expected:
            raise FormatError(f"{file.name} must hold {expected} bytes of {element.get('Name')!r}; its header says {size}")
        yield stored.take(size)
        stored.finish()
        return
    blocks, size, last = lengths(3)
    total = (blocks - 1) * size + (last or size) if blocks else 0
    if total != expected or blocks * word > len(stored.content):
        raise FormatError(f"{file.name} must hold {expected} bytes of {element.get('Name')!r}; its header says {total}")
    packed = lengths(blocks)
    stored.part()
    for i, length in enumerate(packed):
        unpacked = last if last and i == blocks - 1 else size
        yield _unpacked(file, bytes(stored.take(length)), unpacked)
    stored.finish()


class _Stored:
    """The encoded array: bytes, or base64, whose parts are padded separately."""

    def __init__(self, name: str, content: memoryview, encoded: bool, closed: bool) -> None:
        self.name, self.content, self.encoded, self.closed = name, content, encoded, closed
        self.at, self.ready = 0, memoryview(b"")

    def take(self, count: int) -> memoryview:
        """The next bytes."""
        if not self.encoded:
            self.at += count
            taken = self.content[self.at - count : self.at]
        else:
            if len(self.ready) < count:
                needed = -(-(count - len(self.ready)) // 3) * 4
                text = bytes(self.content[self.at : self.at + needed])
                try:
                    self.ready = memoryview(bytes(self.ready) + base64.b64decode(text, validate=True))
                except binascii.Error as error:
                    raise FormatError(f"{self.name} must hold samples in base64; {error}") from error
                self.at += needed
            taken, self.ready = self.ready[:count], self.ready[count:]
        if len(taken) != count:
            raise FormatError(
                f"{self.name} must hold all samples that its headers say; it ends {count - len(taken)} bytes too early"
            )
        return taken

    def part(self) -> None:
        """End a part of base64."""
        self.ready = memoryview(b"")

    def finish(self) -> None:
        """Raise if anything but other arrays follows."""
        if self.closed and (len(self.ready) or self.at < len(self.content)):
            raise FormatError(f"{self.name} must hold the samples that its headers say; there are more")


def _stored(file: _File, element: ET.Element) -> _Stored:
    if element.get("format") == "binary":
        return _Stored(file.name, memoryview("".join((element.text or "").split()).encode()), True, True)
    offset = element.get("offset", "")
    if element.get("format") != "appended" or not re.fullmatch(r"[0-9]{1,18}", offset) or int(offset) >= len(file.appended):
        found = {key: element.get(key) for key in ("format", "offset")}
        raise FormatError(
            f"{file.name} must hold arrays as ascii, binary, or appended within the file; {element.get('Name')!r} has {found}"
        )
    return _Stored(file.name, file.appended[int(offset) :], file.encoded, False)


def _unpacked(file: _File, packed: bytes, size: int) -> bytes:
    """A block of `size` bytes, unpacked."""
    try:
        if file.compressor == "vtkZLibDataCompressor":
            stream = zlib.decompressobj()
            block, ended = stream.decompress(packed, size + 1), stream.eof
        elif file.compressor == "vtkLZMADataCompressor":
            unpacker = lzma.LZMADecompressor()
            block = unpacker.decompress(packed, size)
            ended = unpacker.eof or not unpacker.decompress(b"", 1)
        else:
            block, ended = _unpacked_lz4(packed, size), True
    except (zlib.error, lzma.LZMAError) as error:
        raise FormatError(f"{file.name} is damaged: {error}") from error
    if len(block) != size or not ended:
        raise FormatError(f"{file.name} must hold blocks of the bytes that their header says, {size}; one has others")
    return block


def _unpacked_lz4(packed: bytes, size: int) -> bytes:
    try:
        from vtkmodules.vtkIOCore import vtkLZ4DataCompressor
    except ImportError as error:
        raise MissingDependencyError('VTK\'s files that are packed by LZ4 need vtk: pip install "clvol[vtk]"') from error
    source: Any = np.frombuffer(packed, np.uint8)
    block: Any = np.empty(size, np.uint8)
    compressor = vtkLZ4DataCompressor()
    shown = compressor.GetGlobalWarningDisplay()
    compressor.SetGlobalWarningDisplay(False)  # an error is raised instead
    try:
        found = compressor.Uncompress(source, len(packed), block, size)
    finally:
        compressor.SetGlobalWarningDisplay(shown)
    return bytes(block[:found].tobytes())
