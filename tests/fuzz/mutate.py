"""Mutants of valid files, reproducible from a seed."""

from __future__ import annotations

import gzip
import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from tests.fuzz.corpus import Sample, zipped

__all__ = ["mutant"]

Field = tuple[int, str]  # offset and type, as `struct` names it

_WHOLE = (0, 1, 2, 3, 4, 5, 7, 8, 9, 16, 17, 255, 256, 1000, 1 << 15, 65535, 1 << 16, 10**6, 1 << 24, (1 << 31) - 1, 1 << 31)
_WHOLE = (*_WHOLE, (1 << 32) - 1, 1 << 32, 10**12, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)
_REAL = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-3,
    1e-45,
    1e-308,
    5e-324,
    1e10,
    3e38,
    1e308,
    float("inf"),
    float("-inf"),
    float("nan"),
    2**31,
)
_TEXTS = (b"0", b"-0", b"1", b"-1", b"2", b"3", b"4", b"5", b"7", b"16", b"255", b"65536", b"1000000", b"2147483647", b"2147483648")
_TEXTS += (
    b"4294967296",
    b"-9223372036854775808",
    b"9223372036854775807",
    b"18446744073709551616",
    b"1" + 30 * b"0",
    b"0x9",
    b"010",
)
_TEXTS += (
    b"0.5",
    b"1,5",
    b"1e308",
    b"-1e308",
    b"1e-308",
    b"1e400",
    b"nan",
    b"NaN",
    b"inf",
    b"-inf",
    b"0.5x9",
    b"",
    b" ",
    b"none",
    b"%d",
)
_TEXTS += (b"true", b"null", b"[]", b"{}", b'""', b"()", b"../x", b"/dev/zero", b"LIST", b"\xff\xfe", "１".encode(), b"A" * 300)
_WORDS = (
    b"raw",
    b"gzip",
    b"zlib",
    b"bzip2",
    b"ascii",
    b"hex",
    b"little",
    b"big",
    b"short",
    b"float",
    b"uchar",
    b"double",
    b"int64",
)
_WORDS += (
    b"MET_UCHAR",
    b"MET_SHORT",
    b"MET_DOUBLE",
    b"True",
    b"False",
    b"uint8",
    b"uint16",
    b"float64",
    b"<i2",
    b">f4",
    b"|b1",
    b"|O",
)
_WORDS += (
    b"UInt8",
    b"Int16",
    b"Float64",
    b"LittleEndian",
    b"BigEndian",
    b"appended",
    b"LOCAL",
    b"zstd",
    b"C",
    b"F",
    b"time",
    b"domain",
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_|<>=][A-Za-z0-9_]+")
_HEAD = 4096  # bytes in which texts are looked for


def mutant(samples: Sequence[Sample], kind: str, seed: int) -> tuple[Sample, Sample]:
    """A mutant of one of `samples`, and which one."""
    dice = random.Random(f"{kind} {seed}")
    sample = dice.choice(samples)
    name = dice.choice(list(sample.files))
    content = _changed(sample.files[name], kind, dice, [other.files[n] for other in samples for n in list(other.files)[:3]])
    files = dict(sample.files) | {name: content}
    if len(files) > 1 and dice.random() < 0.02:
        del files[dice.choice([n for n in files if n != sample.entry] or [name])]
    return replace(sample, files=files), sample


def _changed(content: bytes, kind: str, dice: random.Random, others: list[bytes]) -> bytes:
    """The content with one to three changes; for compressed files half of them before compression, with correct checksums."""
    unpack, pack = _PACKED.get(kind, (None, None)) if dice.random() < 0.6 else (None, None)
    if unpack is not None and pack is not None:
        parts = unpack(content)
        name = dice.choice(list(parts))
        parts[name] = _several(parts[name], _inner(kind, name), dice, [parts[name], *parts.values()])
        return pack(parts)
    return _several(content, kind, dice, others)


def _several(content: bytes, kind: str, dice: random.Random, others: list[bytes]) -> bytes:
    for _ in range(dice.choice((1, 1, 1, 2, 3))):
        if not content:
            return content
        structured = _FIELDS.get(kind)
        way = dice.random()
        if structured is not None and way < 0.45:
            content = _field(content, list(structured(content)), dice)
        elif way < 0.6:
            content = _text(content, dice)
        elif way < 0.65 and kind == "png":
            content = _chunk(content, dice)
        else:
            content = dice.choice(_BLIND)(content, dice, others)
    return content


# -- changes that know the format ---------------------------------------------------------------------------------


def _field(content: bytes, fields: list[Field], dice: random.Random) -> bytes:
    if not fields:
        return content
    at, kind = dice.choice(fields)
    size = struct.calcsize(kind)
    if at < 0 or at + size > len(content):
        return content
    if kind[-1] in "fd":
        value = dice.choice((*_REAL, dice.uniform(-100, 100)))
        if kind[-1] == "f" and abs(value) > 3.4e38 and value - value == 0:
            value = 3e38
        return _put(content, at, struct.pack(kind, value))
    (old,) = struct.unpack_from(kind, content, at)
    value = dice.choice((*_WHOLE, *_WHOLE, len(content), len(content) - at, old + 1, old - 1, old * 2, -old, -1))
    return _put(content, at, (value % (1 << 8 * size)).to_bytes(size, "big" if kind[0] == ">" else "little"))


def _put(content: bytes, at: int, part: bytes) -> bytes:
    return content[:at] + part + content[at + len(part) :]


def _nifti_fields(content: bytes) -> Iterator[Field]:
    if len(content) < 348:
        return
    order = "<" if struct.unpack_from("<i", content)[0] in (348, 540) else ">"
    if struct.unpack_from(order + "i", content)[0] == 540:
        yield from ((16 + 8 * k, order + "q") for k in range(8))
        yield from ((104 + 8 * k, order + "d") for k in range(8))
        yield from ((at, order + "d") for at in (176, 184, 192, 200, *range(352, 496, 8)))
        yield from ((at, order + "i") for at in (0, 344, 348, 500, 504))
        yield from ((12, order + "h"), (14, order + "h"), (168, order + "q"))
        return
    yield from ((40 + 2 * k, order + "h") for k in range(8))
    yield from ((76 + 4 * k, order + "f") for k in range(12))
    yield from ((at, order + "f") for at in (124, 128, *range(256, 328, 4)))
    yield from ((at, order + "h") for at in (68, 70, 72, 252, 254))
    yield from ((0, order + "i"), (123, order + "B"), (344, order + "I"), (348, order + "I"))


def _mgh_fields(content: bytes) -> Iterator[Field]:  # noqa: ARG001  # all files have the same
    yield from ((4 * k, ">i") for k in range(7))
    yield (28, ">h")
    yield from ((30 + 4 * k, ">f") for k in range(15))


def _tiff_fields(content: bytes) -> Iterator[Field]:
    """Everything in the directories, and the numbers that they point to."""
    order = "<" if content[:2] == b"II" else ">"
    large = content[2:4] in (b"\x2b\0", b"\0\x2b")
    count, word, entry, start = ("Q", "Q", 20, 8) if large else ("H", "I", 12, 4)
    yield from ((2, order + "H"), (start, order + word))
    try:
        (at,) = struct.unpack_from(order + word, content, start)
        for _ in range(8):
            (entries,) = struct.unpack_from(order + count, content, at)
            yield at, order + count
            first = at + struct.calcsize(count)
            for k in range(min(entries, 40)):
                here = first + entry * k
                yield from ((here, order + "H"), (here + 2, order + "H"), (here + 4, order + word))
                value = here + entry - struct.calcsize(word)
                (kind,) = struct.unpack_from(order + "H", content, here + 2)
                yield from ((value, order + ("H" if kind == 3 else word)), (value, order + word))
                (there,) = struct.unpack_from(order + word, content, value)
                if there + 8 < len(content):
                    yield there, order + "I"
            yield first + entry * entries, order + word
            (at,) = struct.unpack_from(order + word, content, first + entry * entries)
            if not at:
                return
    except (struct.error, OverflowError):
        return


def _dicom_fields(content: bytes) -> Iterator[Field]:
    """Tags, types, lengths and numbers of explicit elements, in sequences too."""
    for match in re.finditer(rb"(?=(..)(..)([A-Z]{2})(..))", content[132:], re.DOTALL):
        at = 132 + match.start()
        yield from ((at, "<H"), (at + 2, "<H"), (at + 4, "<H"))
        if match[3] in (b"OB", b"OW", b"SQ", b"UN", b"UT"):
            yield at + 8, "<I"
        else:
            yield from ((at + 6, "<H"), (at + 8, "<H"))


def _png_fields(content: bytes) -> Iterator[Field]:
    at = 8
    while at + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        yield from ((at, ">I"), (at + 4, ">I"), (at + 8, ">I"), (at + 12, ">I"), (at + 16, ">B"))
        at += 12 + size


def _bmp_fields(content: bytes) -> Iterator[Field]:  # noqa: ARG001
    yield from ((at, "<I") for at in (2, 10, 14, 18, 22, 30, 34, 38, 46, 50))
    yield from ((26, "<H"), (28, "<H"))


def _hdf5_fields(content: bytes) -> Iterator[Field]:
    """Nonzero bytes at even offsets: the library's structures are aligned to them."""
    yield from ((at, kind) for at in range(0, len(content) - 8, 2) if content[at] for kind in ("<B", "<H", "<I", "<Q"))


def _zip_fields(content: bytes) -> Iterator[Field]:
    for magic, longs, shorts in ((b"PK\1\2", (16, 20, 24, 42), (8, 10, 28, 30)), (b"PK\3\4", (14, 18, 22), (6, 8, 26, 28))):
        for match in re.finditer(re.escape(magic), content):
            yield from ((match.start() + k, "<I") for k in longs)
            yield from ((match.start() + k, "<H") for k in shorts)
    end = content.rfind(b"PK\5\6")
    yield from ((end + k, kind) for k, kind in ((8, "<H"), (10, "<H"), (12, "<I"), (16, "<I")))


def _czi_fields(content: bytes) -> Iterator[Field]:
    """Sizes and positions of segments, and the first bytes of each."""
    for match in re.finditer(rb"ZISRAW[A-Z]+", content):
        yield from ((match.start() + k, "<Q") for k in (16, 24, 32, 40, 48, 64, 80))
        yield from ((match.start() + k, "<I") for k in range(32, 200, 4))


def _npy_fields(content: bytes) -> Iterator[Field]:  # noqa: ARG001
    yield from ((6, "<B"), (7, "<B"), (8, "<H"), (8, "<I"))


def _chunk(content: bytes, dice: random.Random) -> bytes:
    """Change a byte of a PNG chunk, with a matching checksum."""
    spans, at = [], 8
    while at + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        spans.append((at + 8, size))
        at += 12 + size
    spans = [(start, size) for start, size in spans if size and start + size + 4 <= len(content)]
    if not spans:
        return content
    start, size = dice.choice(spans)
    content = _put(content, start + dice.randrange(size), bytes([dice.randrange(256)]))
    return _put(content, start + size, struct.pack(">I", zlib.crc32(content[start - 4 : start + size])))


_FIELDS: Mapping[str, Callable[[bytes], Iterator[Field]]] = {
    "npy": _npy_fields,
    "npz": _zip_fields,
    "nii": _nifti_fields,
    "hdr": _nifti_fields,
    "mgh": _mgh_fields,
    "dcm": _dicom_fields,
    "tiff": _tiff_fields,
    "tiff-packed": _tiff_fields,
    "png": _png_fields,
    "bmp": _bmp_fields,
    "h5": _hdf5_fields,
    "nc": _hdf5_fields,
    "ims": _hdf5_fields,
    "zarr.zip": _zip_fields,
    "czi": _czi_fields,
}


def _text(content: bytes, dice: random.Random) -> bytes:
    """Change a number or a word of a text, or delete, duplicate or move a line."""
    head = content[:_HEAD]
    way = dice.random()
    if way < 0.8:
        found = list((_NUMBER if way < 0.55 else _WORD).finditer(head))
        if not found:
            return content
        match = dice.choice(found)
        new = dice.choice(
            (*_TEXTS, *_TEXTS, *_WORDS, dice.choice(found)[0]) if way < 0.55 else (*_WORDS, dice.choice(found)[0], b"")
        )
        return content[: match.start()] + new + content[match.end() :]
    lines = head.splitlines(keepends=True)
    i, j = dice.randrange(len(lines)), dice.randrange(len(lines))
    if way < 0.86:
        del lines[i]
    elif way < 0.93:
        lines.insert(j, lines[i])
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"".join(lines) + content[_HEAD:]


# -- blind changes -------------------------------------------------------------------------------------------------


def _place(content: bytes, dice: random.Random) -> int:
    """An offset, more often near the beginning."""
    return dice.randrange(min(len(content), dice.choice((16, 64, 512, len(content), len(content)))))


def _bit(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    at = _place(content, dice)
    return _put(content, at, bytes([content[at] ^ 1 << dice.randrange(8)]))


def _byte(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    return _put(content, _place(content, dice), bytes([dice.choice((0, 1, 127, 128, 255, dice.randrange(256)))]))


def _number(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    kind = dice.choice("BHIQHIQfd")
    size = struct.calcsize(kind)
    at = _place(content, dice) // size * size
    return _field(content, [(at, dice.choice("<>") + kind)], dice)


def _truncated(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    return content[: dice.choice((dice.randrange(len(content)), len(content) - 1 - dice.randrange(min(16, len(content)))))]


def _inserted(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    at = _place(content, dice)
    return content[:at] + dice.randbytes(dice.choice((1, 1, 2, 4, 16, 100))) + content[at:]


def _deleted(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    at = _place(content, dice)
    return content[:at] + content[at + dice.choice((1, 1, 2, 4, 16, 100)) :]


def _doubled(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    at, end = sorted((_place(content, dice), _place(content, dice)))
    return content[:end] + content[at:end] + content[end:]


def _spliced(content: bytes, dice: random.Random, others: list[bytes]) -> bytes:
    other = dice.choice(others)
    return content[: _place(content, dice)] + other[dice.randrange(len(other) + 1) :]


def _zeroed(content: bytes, dice: random.Random, _: list[bytes]) -> bytes:
    at = _place(content, dice)
    return _put(content, at, bytes(min(dice.choice((1, 4, 16, 64)), len(content) - at)))


def _appended(content: bytes, dice: random.Random, others: list[bytes]) -> bytes:
    return content + dice.choice(
        (bytes(dice.choice((1, 100))), dice.randbytes(dice.choice((1, 2, 4, 8, 100))), dice.choice(others))
    )


_BLIND = (_bit, _bit, _byte, _byte, _number, _number, _truncated, _inserted, _deleted, _doubled, _spliced, _zeroed, _appended)


# -- what is packed ------------------------------------------------------------------------------------------------


def _gunzipped(content: bytes) -> dict[str, bytes]:
    return {"": gzip.decompress(content)}


def _gzipped(parts: Mapping[str, bytes]) -> bytes:
    return gzip.compress(parts[""], 1, mtime=0)


def _unzipped(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _inner(kind: str, name: str) -> str:
    """The format of the compressed content."""
    return "npy" if name.endswith(".npy") else {"nii.gz": "nii", "mgz": "mgh"}.get(kind, "")


_PACKED: Mapping[str, tuple[Callable[[bytes], dict[str, bytes]], Callable[[Mapping[str, bytes]], bytes]]] = {
    "nii.gz": (_gunzipped, _gzipped),
    "mgz": (_gunzipped, _gzipped),
    "npz": (_unzipped, zipped),
    "zarr.zip": (_unzipped, zipped),
}
