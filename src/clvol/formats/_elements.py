"""The elements of a DICOM file, walked before GDCM reads it: it allocates whatever a length says, and fills what is missing.

Source: DICOM PS3.5, 7 (data sets) and annex A (transfer syntaxes), PS3.10, 7 (the file meta information).
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import IO

from clvol.base.errors import FormatError

__all__ = ["check_samples"]

_META = 0x0002
_SYNTAX = (0x0002, 0x0010)
_PIXELS = (0x7FE0, 0x0010)
_ITEM, _ITEM_END, _SEQUENCE_END = (0xFFFE, 0xE000), (0xFFFE, 0xE00D), (0xFFFE, 0xE0DD)
_UNDEFINED = 0xFFFFFFFF
_IMPLICIT, _BIG, _DEFLATED = "1.2.840.10008.1.2", "1.2.840.10008.1.2.2", "1.2.840.10008.1.2.1.99"
_PLAIN = (_IMPLICIT, "1.2.840.10008.1.2.1", _BIG)
_LONG = (b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV")
_SHARED = (b"YBR_FULL_422", b"YBR_PARTIAL_422", b"YBR_PARTIAL_420")  # colours of which several samples have one
_PHOTOMETRICS = (b"MONOCHROME", b"PALETTE COLOR", b"RGB", b"YBR_", b"HSV", b"ARGB", b"CMYK")  # or how they begin
_KEPT = 64  # bytes of a value that are looked at
_NESTED = 32
_EXPANSION, _UNQUESTIONED = 1000, 1 << 26  # as of compressed samples: times the file, and bytes that any may have

Tag = tuple[int, int]
_SAMPLES, _PHOTOMETRIC, _FRAMES, _ROWS, _COLUMNS, _BITS, _INTERCEPT, _SLOPE = (
    (0x0028, element) for element in (0x0002, 0x0004, 0x0008, 0x0010, 0x0011, 0x0100, 0x1052, 0x1053)
)
_NUMBER = re.compile(rb" *[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)? *")


def check_samples(path: Path) -> None:
    """Raise `FormatError` unless every element lies inside the file, and there are as many samples as its rows and columns say.

    Files that are no DICOM as the standard has it, of which some programs leave out the head, are left to GDCM.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(132)[128:] != b"DICM":
            return
        walk = _Walk(stream, size, path.name)
        syntax, walk.order, walk.implicit = walk.meta()
        if not syntax:
            raise FormatError(f"{path.name} must say how its samples are encoded, in (0002,0010); it is damaged")
        if syntax == _DEFLATED:
            return
        walk.data_set(size)
    values = walk.values
    for tag, what, none in ((_INTERCEPT, "offset", False), (_SLOPE, "slope", True)):
        text = values.get(tag, b"").rstrip(b"\0")
        if text and (not _NUMBER.fullmatch(text) or (none and not float(text))):  # GDCM takes it for 0
            raise FormatError(f"{path.name} must have a number as its {what}; it says {text.decode('latin-1')!r}")
    counts = [walk.number(tag) for tag in (_ROWS, _COLUMNS, _BITS)]
    if None in counts or _PIXELS not in walk.lengths:
        return
    rows, columns, bits = (n or 0 for n in counts)
    frames = values.get(_FRAMES, b"1").strip(b" \0") or b"1"
    samples = walk.number(_SAMPLES)
    photometric = values.get(_PHOTOMETRIC, b"MONOCHROME2").strip(b" \0")
    if not photometric.startswith(_PHOTOMETRICS):  # GDCM would turn black and white round
        raise FormatError(f"{path.name} must say what its samples are (0028,0004); it says {photometric.decode('latin-1')!r}")
    if not frames.isdigit() or photometric in _SHARED:
        return
    needed = -(-rows * columns * (1 if samples is None else samples) * int(frames) * bits // 8)
    told = f"{rows} × {columns} samples of {bits} bits in {int(frames)} frames"
    found = walk.lengths[_PIXELS]
    if syntax not in _PLAIN or found == _UNDEFINED:
        if needed > max(_UNQUESTIONED, _EXPANSION * size):
            raise FormatError(f"{path.name} must hold up to {_EXPANSION} bytes of samples for each of its {size}; it says {told}")
    elif found not in (needed, needed + needed % 2):
        raise FormatError(f"{path.name} must hold {needed} bytes of samples, {told}; it is damaged or cut short: found {found}")


class _Walk:
    """What is found on the way through a file: the beginnings of values, and their lengths, at the top."""

    def __init__(self, stream: IO[bytes], size: int, name: str) -> None:
        self._stream, self._size, self._name = stream, size, name
        self.order, self.implicit = "<", False
        self.values: dict[Tag, bytes] = {}
        self.lengths: dict[Tag, int] = {}

    def number(self, tag: Tag) -> int | None:
        value = self.values.get(tag, b"")
        return struct.unpack(self.order + "H", value[:2])[0] if len(value) >= 2 else None

    def meta(self) -> tuple[str, str, bool]:
        """The transfer syntax, its byte order, and whether types are left out; the stream is behind the file meta information."""
        while (head := self._stream.read(2)) == struct.pack("<H", _META):
            self._stream.seek(-2, 1)
            self._element(self._size, 0)
        self._stream.seek(-len(head), 1)
        syntax = self.values.get(_SYNTAX, b"").decode("latin-1").strip(" \0")
        return syntax, ">" if syntax == _BIG else "<", syntax == _IMPLICIT

    def data_set(self, end: int, depth: int = 0) -> None:
        """Elements up to a place, or to the end of an item or a sequence."""
        if depth > _NESTED:
            raise FormatError(f"{self._name} must have sequences up to {_NESTED} deep")
        while self._stream.tell() < end and self._element(end, depth):
            pass

    def _element(self, end: int, depth: int) -> bool:
        """Pass one element; False for what ends an item or a sequence, and for zeros that fill up a file."""
        left = end - self._stream.tell()
        if depth == 0 and left < 8 and not self._stream.read(left).strip(b"\0"):
            return False
        head = self._read(8, end)
        tag: Tag = struct.unpack(self.order + "HH", head[:4])
        kind = head[4:6]
        if tag[0] == 0xFFFE or self.implicit:
            kind, length = b"", struct.unpack(self.order + "I", head[4:])[0]
        elif kind in _LONG:
            length = struct.unpack(self.order + "I", self._read(4, end))[0]
        else:
            length = struct.unpack(self.order + "H", head[6:])[0]
        if tag in (_ITEM_END, _SEQUENCE_END):
            return False
        if depth == 0:
            if tag in self.lengths:  # of two, readers take either
                raise FormatError(f"{self._name} must give each element once; ({tag[0]:04x},{tag[1]:04x}) is there twice")
            self.lengths[tag] = length
        # Makers write what they like into groups of their own, which have odd numbers.
        looked_into = kind in (b"SQ", b"") and tag[0] % 2 == 0 and tag != _PIXELS
        if length == _UNDEFINED:
            before = self.order, self.implicit
            if kind == b"UN":  # PS3.5, 6.2.2: whatever the file's syntax, a sequence of unknown type has its own
                self.order, self.implicit = "<", True
            self.data_set(end, depth + 1) if tag == _ITEM else self._items(end, depth, tag, looked_into=looked_into)
            self.order, self.implicit = before
            return True
        start = self._stream.tell()
        if length > end - start:
            raise FormatError(
                f"{self._name} must hold its elements; it is damaged or cut short: ({tag[0]:04x},{tag[1]:04x}) has {length} bytes, "
                f"of which {end - start} are there"
            )
        if depth == 0:
            self.values[tag] = self._stream.read(min(length, _KEPT))
        self._stream.seek(start)
        if looked_into and kind == b"SQ":
            self._items(start + length, depth, tag, looked_into=True, bounded=True)
        self._stream.seek(start + length)
        return True

    def _items(self, end: int, depth: int, tag: Tag, *, looked_into: bool, bounded: bool = False) -> None:
        """The items of a sequence, or the parts of compressed samples, up to a mark that ends them, or if `bounded` to `end`.

        Items that say how long they are hold elements that end there, where they are `looked_into`.
        """
        while self._stream.tell() < end:
            head = self._read(8, end)
            inner, length = struct.unpack(self.order + "HH", head[:4]), struct.unpack(self.order + "I", head[4:])[0]
            if inner == _SEQUENCE_END:
                return
            start = self._stream.tell()
            if inner != _ITEM or (length != _UNDEFINED and length > end - start):
                raise FormatError(f"{self._name} must have whole items in ({tag[0]:04x},{tag[1]:04x}); it is damaged or cut short")
            if length == _UNDEFINED:
                self.data_set(end, depth + 1)
            else:
                if looked_into:
                    self.data_set(start + length, depth + 1)
                self._stream.seek(start + length)
        if bounded:
            return
        raise FormatError(f"{self._name} must end the items of ({tag[0]:04x},{tag[1]:04x}); it is damaged or cut short")

    def _read(self, count: int, end: int) -> bytes:
        if count > end - self._stream.tell():
            raise FormatError(f"{self._name} must hold whole elements; it is damaged or cut short")
        return self._stream.read(count)
