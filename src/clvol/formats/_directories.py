"""The directories of a TIFF file, checked before a library reads them: one per page, chained by offsets."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import IO

from clvol.base.errors import FormatError

__all__ = ["Directory", "directories", "segments"]

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
_READ = {*_DEFAULTS, _CHILDREN}
_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}  # of a type
_WHOLE = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_MAX_VALUES = 1 << 16  # of a field that says how samples are stored

Directory = Mapping[int, tuple[int, ...]]
"""How the samples of a page are stored: values by tag."""


def directories(stream: IO[bytes], size: int, name: str) -> dict[int, Directory]:
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


def segments(page: Directory) -> tuple[int, int, int, int] | None:
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
