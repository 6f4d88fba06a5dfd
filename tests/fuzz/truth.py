"""What a file holds according to somebody else: another library, or a strict reading of a few lines.

Each function takes the files of a `Sample` and says what their samples are, raises `Damaged` where they must be rejected,
and gives None where it cannot tell.
"""

from __future__ import annotations

import ast
import base64
import gzip
import io
import itertools
import json
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

__all__ = ["TRUTHS", "Damaged", "Held"]

Files = Mapping[str, bytes]
Array = NDArray[Any]


class Damaged(Exception):  # it says what the file is
    """The file contradicts itself or one of its checksums."""


@dataclass(frozen=True)
class Held:
    """What a file holds.

    Parameters
    ----------
    data : ndarray
        Samples, x last.
    spacing, origin : sequence of float, optional
        Of x, y(, z), where the file says them and they were read here.
    loose : bool
        Whether the order of the axes is a guess: then only the samples count, in any order.
    """

    data: Array
    spacing: tuple[float, ...] | None = None
    origin: tuple[float, ...] | None = None
    loose: bool = False


def _need(condition: object, rule: str) -> None:
    if not condition:
        raise Damaged(rule)


def _shaped(content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], order: str = "C", *, exact: bool = True) -> Array:
    size = math.prod(shape) * dtype.itemsize
    _need(min(shape, default=1) > 0, "an axis is empty")
    _need(len(content) == size if exact else len(content) >= size, f"{len(content)} bytes for {size}")
    return np.frombuffer(content[:size], dtype).reshape(shape, order=order)  # type: ignore[call-overload,no-any-return]


def _gunzip(content: bytes) -> bytes:
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise Damaged(str(error)) from error


# -- NumPy ---------------------------------------------------------------------------------------------------------


def _array(content: bytes) -> Array:
    _need(content[:6] == b"\x93NUMPY", "magic")
    width = {1: "<H", 2: "<I"}.get(content[6])
    _need(width and content[7] == 0, "version")
    assert width
    start = 8 + struct.calcsize(width)
    (length,) = struct.unpack_from(width, content, 8)
    text = content[start : start + length]
    _need(len(text) == length, "header ends too early")
    try:
        head = ast.literal_eval(text.decode("latin-1"))
        shape, dtype, fortran = head["shape"], np.dtype(head["descr"]), head["fortran_order"]
    except Exception as error:
        raise Damaged(str(error)) from error
    _need(set(head) == {"shape", "descr", "fortran_order"} and isinstance(fortran, bool), "keys")
    _need(isinstance(shape, tuple) and all(isinstance(n, int) for n in shape), "shape")
    return _shaped(content[start + length :], dtype, shape, "F" if fortran else "C")


def _npy(files: Files, entry: str, _: object) -> Held:
    data = _array(files[entry])
    return Held(data, loose=data.ndim > 3)


def _members(content: bytes) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _need(len(set(archive.namelist())) == len(archive.namelist()), "a name is there twice")
            return {name: archive.read(name) for name in archive.namelist()}  # checks what each is and its checksum
    except Damaged:
        raise
    except Exception as error:
        raise Damaged(str(error)) from error


def _npz(files: Files, entry: str, _: object) -> Held:
    members = {name.removesuffix(".npy"): content for name, content in _members(files[entry]).items()}
    own = ("spacing", "origin", "direction", "units", "about", "leading")
    names = [name for name in members if name not in own]
    data = _array(members["data" if "data" in members else names[0]])
    spacing = tuple(map(float, np.atleast_1d(_array(members["spacing"])))) if "spacing" in members else None
    return Held(data, spacing, loose=data.ndim > 3)


# -- medical -------------------------------------------------------------------------------------------------------


def _nibabel(files: Files, entry: str, _: object) -> Held:
    import nibabel
    from nibabel.fileholders import FileHolder

    content = files[entry]
    if entry.endswith(".gz"):
        content = _gunzip(content)
    size = {struct.unpack_from(order + "i", content)[0] for order in "<>"}
    large = 540 in size
    if not entry.endswith(".hdr") and not any(content[168:176] if large else content[108:112]):
        raise LookupError("of a vox_offset of 0, nibabel takes the header for samples")
    try:
        if entry.endswith(".hdr"):
            of_analyze = nibabel.Spm2AnalyzeImage.header_class.may_contain_header(content)
            kind = nibabel.Spm2AnalyzeImage if of_analyze else nibabel.Nifti2Pair if large else nibabel.Nifti1Pair
            holders = {"header": content, "image": files[entry.replace(".hdr", ".img")], "mat": b""}
            image = kind.from_file_map({name: FileHolder(fileobj=io.BytesIO(part)) for name, part in holders.items()})
        else:
            image = (nibabel.Nifti2Image if large else nibabel.Nifti1Image).from_bytes(content)
        data = np.asanyarray(image.dataobj)
    except Exception as error:
        if "extension" in str(error):  # which say nothing of the samples
            raise LookupError(str(error)) from error
        raise Damaged(f"nibabel: {error}") from error
    if data.dtype.names:  # colours
        data = np.stack([data[name] for name in data.dtype.names], -1)
        return Held(data.T, loose=True)
    affine = image.affine
    spacing = tuple(float(n) for n in np.linalg.norm(affine[:3, :3], axis=0))
    # metres and micrometres are brought to millimetres; two axes have no third spacing
    plain = "xyzt_units" not in image.header or image.header["xyzt_units"] & 7 in (0, 2)
    plain = plain and image.ndim > 2
    return Held(data.T, spacing if plain else None, (-affine[0, 3], -affine[1, 3], affine[2, 3]) if plain else None)


def _mrc(files: Files, entry: str, _: object) -> Held:
    """By mrcfile, which is lenient about axes and does not place samples."""
    import tempfile
    import warnings

    import mrcfile

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        path = Path(folder) / "v.mrc"
        path.write_bytes(files[entry])
        try:
            with mrcfile.open(path, permissive=True) as file:
                _need(file.data is not None, "samples")
                return Held(np.array(file.data), loose=True)
        except ValueError as error:
            raise Damaged(f"mrcfile: {error}") from error


def _mgh(files: Files, entry: str, _: object) -> Held:
    content = files[entry]
    if entry.endswith(".mgz"):
        content = _gunzip(content)
    _need(len(content) >= 284, "header")
    version, *counts, kind, _dof, good = struct.unpack_from(">7ih", content)
    dtype = {0: ">u1", 1: ">i4", 3: ">f4", 4: ">i2"}.get(kind)
    _need(version == 1 and dtype and min(counts) > 0, "version, type or size")
    good = max(good, -good)  # nibabel looks whether it is 0
    data = _shaped(content[284:], np.dtype(dtype), tuple(counts), "F", exact=False)
    delta, turn = np.array((1.0, 1.0, 1.0)), np.eye(3)
    if good > 0:
        delta, turn = (
            np.array(struct.unpack_from(">3f", content, 30)),
            np.array(struct.unpack_from(">9f", content, 42)).reshape(3, 3),
        )
    return Held(data.T, tuple(np.abs(delta) * np.linalg.norm(turn, axis=1)))


_NRRD = {
    "int8": "signed char, int8, int8_t",
    "uint8": "uchar, unsigned char, uint8, uint8_t",
    "int16": "short, short int, signed short, signed short int, int16, int16_t",
    "uint16": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "int32": "int, signed int, int32, int32_t",
    "uint32": "uint, unsigned int, uint32, uint32_t",
    "int64": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
    "uint64": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "float32": "float",
    "float64": "double",
}
_REAL = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def _reals(text: str, *, unknown: bool = False) -> list[float]:
    words = text.split()
    _need(all(_REAL.fullmatch(word) or (unknown and word.lower() == "nan") for word in words), f"numbers {text!r}")
    values = [float(word) for word in words]
    _need(not any(map(math.isinf, values)), f"infinite {text!r}")
    return values


def _nrrd(files: Files, entry: str, _: object) -> Held:
    content = files[entry]
    end = re.search(rb"\r?\n\r?\n", content)
    body = content[end.end() :] if end else b""
    fields = {}
    lines = (content[: end.start()] if end else content.rstrip(b"\n")).decode("utf-8", "surrogateescape").split("\n")
    lines = [line.rstrip("\r") for line in lines]
    _need(re.fullmatch(r"NRRD000[1-5]", lines[0]), "magic")
    for line in lines[1:]:
        if line.startswith("#") or re.match(r"[^:]*:=", line):
            continue
        key, colon, value = line.partition(": ")
        key = {"datafile": "data file", "byteskip": "byte skip", "lineskip": "line skip"}.get(key.lower(), key.lower())
        _need(colon and key not in fields, f"line {line!r}")
        fields[key] = value.strip()
    types = {name: dtype for dtype, names in _NRRD.items() for name in names.split(", ")}
    _need({"type", "dimension", "sizes", "encoding"} <= set(fields), "fields")
    dtype, sizes = types.get(fields["type"].lower()), fields["sizes"].split()
    _need(dtype and all(re.fullmatch(r"\d+", n, re.ASCII) for n in sizes), "type or sizes")
    shape = tuple(int(n) for n in reversed(sizes))
    _need(fields["dimension"].isdecimal() and len(shape) == int(fields["dimension"]), "dimension")
    if "data file" in fields:
        name = fields["data file"].removeprefix("./")
        _need(name in files, f"there is no {name!r}")
        body = files[name]
    for _line in range(int(fields.get("line skip", "0"))):
        body = body.partition(b"\n")[2]
    size = math.prod(shape) * np.dtype(dtype).itemsize
    encoding, skip = fields["encoding"].lower(), int(fields.get("byte skip", "0"))
    _need(encoding in ("raw", "gzip", "gz") and not (skip and encoding != "raw"), "encoding")
    body = _gunzip(body) if encoding != "raw" else body[-size:] if skip == -1 else body[skip:]
    order = {"little": "<", "big": ">", "": "<"}.get(fields.get("endian", "").lower())
    _need(order, "endian")
    assert order is not None
    _need("endian" in fields or np.dtype(dtype).itemsize == 1, "no endian")
    data = _shaped(body, np.dtype(dtype).newbyteorder(order), shape)  # type: ignore[arg-type]
    spacing = None
    kinds = fields.get("kinds", "").split()
    if "spacings" in fields and "space directions" not in fields:
        spacing = tuple(abs(n) for n in _reals(fields["spacings"], unknown=True))
        _need(len(spacing) == len(shape), "spacings")
    for key in ("axis mins", "axis maxs", "thicknesses"):
        _need(len(_reals(fields.get(key, ""), unknown=True)) in (0, len(shape)), key)
    vectors = re.findall(r"none|\([^()]*\)", fields.get("space directions", ""))
    if vectors:
        steps = [_reals(one.strip("()").replace(",", " ")) for one in vectors if one != "none"]
        _need(len(vectors) == len(shape) and len({len(step) for step in steps}) == 1, "space directions")
        spacing = tuple(float(np.linalg.norm(step)) for step in steps)
    if "space origin" in fields:
        _reals(fields["space origin"].strip("()").replace(",", " "))
    plain = not kinds or all(kind in ("domain", "space") for kind in kinds)
    plain = plain and len(shape) <= 3 and not {"units", "space units"} & set(fields)
    return Held(data, spacing if plain else None, loose=len(shape) > 3 or "vector" in kinds)


_META = dict(
    zip(
        ["CHAR", "UCHAR", "SHORT", "USHORT", "INT", "UINT", "LONG", "ULONG", "LONG_LONG", "ULONG_LONG", "FLOAT", "DOUBLE"],
        ["i1", "u1", "i2", "u2", "i4", "u4", "i4", "u4", "i8", "u8", "f4", "f8"],
        strict=True,
    )
)


def _metaimage(files: Files, entry: str, _: object) -> Held:
    content, fields = files[entry], {}
    while "ElementDataFile" not in fields:
        line, end, content = content.partition(b"\n")
        match = re.fullmatch(r"\s*(\w+)\s*[=:]\s*(.*?)\s*", line.decode("utf-8", "surrogateescape"))
        _need(match, f"line {line[:60]!r}")
        assert match
        _need(match[1] not in fields, f"{match[1]} is there twice")
        fields[match[1]] = match[2]
        _need(end or "ElementDataFile" in fields, "header ends too early")
    _need({"NDims", "DimSize", "ElementType"} <= set(fields), "fields")
    dtype = np.dtype(_META.get(fields["ElementType"].removeprefix("MET_"), "V1"))
    _need(dtype.kind != "V", "ElementType")
    sizes = fields["DimSize"].split()
    _need(all(re.fullmatch(r"\d+", n, re.ASCII) for n in sizes) and [str(len(sizes))] == fields["NDims"].split(), "sizes")
    shape = tuple(int(n) for n in reversed(sizes))
    channels = int(fields.get("ElementNumberOfChannels", "1"))
    _need(channels > 0, "channels")
    file = fields["ElementDataFile"]
    if file.upper() != "LOCAL":
        _need(file in files, f"there is no {file!r}")
        content = files[file]
    if fields.get("CompressedData", "F")[:1] in "Tt1":
        packed = int(fields.get("CompressedDataSize", "0"))
        _need(0 < packed <= len(content), "CompressedDataSize")
        unpacker = zlib.decompressobj(47)
        try:
            content = unpacker.decompress(content[:packed])
        except zlib.error as error:
            raise Damaged(str(error)) from error
        _need(unpacker.eof, "compressed samples end too early")
        _need(not unpacker.unused_data, "more after the compressed samples")
    else:
        skip = int(fields.get("HeaderSize", "0"))
        size = math.prod(shape) * channels * dtype.itemsize
        if skip == -1:
            content = content[-size:]
        elif skip:
            whole = files[file] if file.upper() != "LOCAL" else files[entry]
            content = whole[skip:]
    large = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "F"))[:1] in "Tt1"
    data = _shaped(content, dtype.newbyteorder(">" if large else "<"), (*shape, channels) if channels > 1 else shape)
    slope, offset = (float(fields.get(f"ElementToIntensityFunction{n}", d)) for n, d in (("Slope", "1"), ("Offset", "0")))
    if (slope, offset) != (1, 0):
        data = data * slope + offset
    spacing = None
    if "ElementSpacing" in fields and fields.get("DistanceUnits", "mm") in ("mm", "?"):
        spacing = tuple(abs(n) for n in _reals(fields["ElementSpacing"])[: len(shape)])
    origin = None
    names = [name for name in ("Offset", "Position", "Origin") if name in fields]
    if len(names) == 1 and spacing is not None:
        origin = tuple(_reals(fields[names[0]])[: len(shape)])
    return Held(data, spacing if len(shape) <= 3 else None, origin if len(shape) <= 3 else None, loose=channels > 1)


# -- DICOM ---------------------------------------------------------------------------------------------------------

_UNTYPED = b"1.2.840.10008.1.2"
_LONG = (b"OB", b"OW", b"OF", b"OD", b"OL", b"SQ", b"UN", b"UT", b"UC", b"UR")


def _elements(content: bytes, at: int, end: int, depth: int = 0) -> Iterator[tuple[int, bytes]]:
    """Tag and value of little-endian elements, nested ones too; after group 2, types are implicit if it says so."""
    _need(depth < 8, "sequences in sequences")
    typed = True
    while at < end:
        if depth == 0 and at + 8 > end and not content[at:end].strip(b"\0"):
            return  # zeros that fill up a file
        _need(at + 8 <= end, "an element ends too early")
        group, number, kind, size = struct.unpack_from("<HH2sH", content, at)
        if group == 0xFFFE or not (typed or group == 2):
            (size,) = struct.unpack_from("<I", content, at + 4)
        at += 8
        if group != 0xFFFE and (typed or group == 2) and kind in _LONG:
            (size,) = struct.unpack_from("<I", content, at)
            at += 4
        if size == 0xFFFFFFFF:
            raise LookupError("undefined length")
        _need(at + size <= end, "a value ends too early")
        value = content[at : at + size]
        if (group, number) == (2, 0x10):
            typed = value.strip(b"\0 ") != _UNTYPED
        if (group, number) == (0xFFFE, 0xE000) or (typed and group != 0xFFFE and kind == b"SQ"):
            yield from _elements(content, at, at + size, depth + 1)
        elif group != 0xFFFE:
            yield group << 16 | number, value
        at += size


def _slices(content: bytes) -> Array | None:
    """Frames of a file with uncompressed samples."""
    if content[128:132] != b"DICM":
        return None
    found: dict[int, bytes] = {}
    try:
        for tag, value in _elements(content, 132, len(content)):
            found.setdefault(tag, value)
    except LookupError:
        return None
    if found.get(0x00020010, b"").strip(b"\0 ") not in (_UNTYPED, _UNTYPED + b".1"):
        return None
    try:
        rows, columns, bits, stored, high, signed = (
            struct.unpack("<H", found[0x00280000 | t])[0] for t in (0x10, 0x11, 0x100, 0x101, 0x102, 0x103)
        )
        colours = struct.unpack("<H", found.get(0x00280002, b"\1\0"))[0]
        frames = int(found.get(0x00280008, b"1").strip(b"\0 ") or b"1")
        slope, intercept = (float(found.get(tag, d).strip(b"\0 ") or d) for tag, d in ((0x00281053, b"1"), (0x00281052, b"0")))
    except (KeyError, ValueError, struct.error):
        return None
    if found.get(0x00280004, b"").strip(b"\0 ") != b"MONOCHROME2":  # readers turn others round
        return None
    if bits not in (8, 16) or stored != bits or high != bits - 1 or signed > 1 or colours != 1 or not slope:
        return None
    values = found.get(0x7FE00010, b"")
    size = rows * columns * frames * bits // 8
    _need(0 < size <= len(values) <= size + 1, f"{len(values)} bytes of samples for {size}")
    data = np.frombuffer(values[:size], f"<{'ui'[signed]}{bits // 8}").reshape(frames, rows, columns)
    return data if (slope, intercept) == (1, 0) else data * slope + intercept


def _dicom(files: Files, entry: str, _: object) -> Held | None:
    stacks = []
    for name in [entry] if entry else files:
        stack = _slices(files[name])
        if stack is None:
            return None
        stacks.append(stack)
    if len({(stack.shape[1:], stack.dtype) for stack in stacks}) > 1:
        return None
    return Held(np.concatenate(stacks), loose=True)


# -- TIFF ----------------------------------------------------------------------------------------------------------

_TIFF_TYPES = {
    1: "B",
    2: "c",
    3: "H",
    4: "I",
    5: "II",
    6: "b",
    7: "B",
    8: "h",
    9: "i",
    10: "ii",
    11: "f",
    12: "d",
    13: "I",
    16: "Q",
    17: "q",
    18: "Q",
}


_NEEDED = (256, 257, 258, 259, 273, 277, 278, 279, 317, 322, 323, 324, 325, 339)


_MOST = 1 << 13  # values of a tag that are looked at: more than any file of the corpus has room for
_KIND = (256, 257, 258, 259, 262, 266, 277, 278, 284, 317, 322, 323, 339, 32997, 32998)
"""Tags of which a page has others than the first where it belongs to another image."""


def _directories(content: bytes) -> Iterator[dict[int, tuple[Any, ...]]]:
    order = {b"II": "<", b"MM": ">"}.get(content[:2])
    _need(order and len(content) >= 16, "byte order")
    assert order
    (version,) = struct.unpack_from(order + "H", content, 2)
    _need(version in (42, 43), "version")
    count, word, entry, start = ("Q", "Q", 20, 8) if version == 43 else ("H", "I", 12, 4)
    seen: set[int] = set()
    try:
        (at,) = struct.unpack_from(order + word, content, start)
        while at:
            _need(at not in seen, "directories go in a circle")
            seen.add(at)
            (entries,) = struct.unpack_from(order + count, content, at)
            first, tags = at + struct.calcsize(count), {}
            for k in range(entries):
                here = first + entry * k
                tag, kind = struct.unpack_from(order + "HH", content, here)
                (number,) = struct.unpack_from(order + word, content, here + 4)
                if kind not in _TIFF_TYPES:
                    continue
                letters = _TIFF_TYPES[kind]  # with a count: `struct` keeps what it was told, thousands of letters too
                code = f"{order}{min(number, _MOST) * len(letters)}{letters[0]}"
                value = here + 4 + struct.calcsize(word)
                if struct.calcsize(code) > struct.calcsize(word):
                    (value,) = struct.unpack_from(order + word, content, value)
                if tag not in tags:
                    try:
                        tags[tag] = struct.unpack_from(code, content, value)
                    except (struct.error, OverflowError):
                        if tag in _NEEDED:
                            raise
            yield tags
            (at,) = struct.unpack_from(order + word, content, first + entry * entries)
    except (struct.error, OverflowError) as error:
        raise Damaged(str(error)) from error


def _page(content: bytes, tags: Mapping[int, tuple[Any, ...]], order: str) -> Array | None:
    """The samples of a page, or None for kinds not read here."""

    def one(tag: int, default: int) -> int:
        return int((tags.get(tag) or (default,))[0])

    width, height, parts = one(256, 0), one(257, 0), one(277, 1)
    bits, formats = set(tags.get(258, (1,))), set(tags.get(339, (1,)))
    _need(width > 0 and height > 0, "size")
    if len(bits) != 1 or len(formats) != 1 or one(284, 1) != 1 or one(266, 1) != 1 or one(32997, 1) != 1:
        return None
    name = {
        (1, 8): "u1",
        (1, 16): "u2",
        (1, 32): "u4",
        (1, 64): "u8",
        (2, 8): "i1",
        (2, 16): "i2",
        (2, 32): "i4",
        (2, 64): "i8",
        (3, 16): "f2",
        (3, 32): "f4",
        (3, 64): "f8",
    }.get((formats.pop(), bits.pop()))
    if name is None:
        return None
    dtype = np.dtype(order + name)
    tiled = 322 in tags
    rows, columns = (one(323, 0), one(322, 0)) if tiled else (min(one(278, height) or height, height), width)
    starts, sizes = (tags.get(324, ()), tags.get(325, ())) if tiled else (tags.get(273, ()), tags.get(279, ()))
    _need(rows > 0 and columns > 0, "tiles")
    grid = -(-height // rows), -(-width // columns)
    _need(len(starts) == len(sizes) == math.prod(grid), "strips")
    size = grid[0] * rows * grid[1] * columns * parts * dtype.itemsize
    _need(size <= 1000 * len(content), "more samples than the file can hold")  # no codec packs better
    whole = np.zeros((grid[0] * rows, grid[1] * columns, parts), dtype)
    for (i, j), start, size in zip(itertools.product(*map(range, grid)), starts, sizes, strict=True):
        _need(size > 0 and start + size <= len(content), "a strip lies past the end")
        high = rows if tiled else min(rows, height - i * rows)
        expected = high * columns * parts * dtype.itemsize
        part = _unpacked(content[start : start + size], one(259, 1), expected)
        if part is None:
            return None
        _need(len(part) >= expected, f"{len(part)} bytes in a strip of {expected}")
        block = np.frombuffer(part[:expected], dtype).reshape(high, columns, parts)
        if one(317, 1) == 2 and one(259, 1) != 1:
            if dtype.kind == "f":
                return None
            block = np.cumsum(block, axis=1, dtype=dtype.newbyteorder("="))
        elif one(317, 1) != 1 and one(259, 1) != 1:
            return None
        whole[i * rows : i * rows + high, j * columns : (j + 1) * columns] = block
    return whole[:height, :width].squeeze(-1) if parts == 1 else whole[:height, :width]


def _unpacked(part: bytes, compression: int, expected: int) -> bytes | None:
    import imagecodecs

    decoders: Mapping[int, Callable[[bytes], bytes]] = {
        8: zlib.decompress,
        32946: zlib.decompress,
        5: lambda packed: _unlzw(packed, expected),
        32773: imagecodecs.packbits_decode,
        50000: imagecodecs.zstd_decode,
        34925: imagecodecs.lzma_decode,
    }
    if compression == 1:
        return part
    if compression not in decoders:
        return None
    try:
        return decoders[compression](part)
    except Exception as error:
        raise Damaged(f"a strip of {expected} bytes: {error}") from error


def _unlzw(part: bytes, expected: int) -> bytes:
    """LZW as in section 13 of TIFF 6.0; bytes after the last sample do not matter."""
    bits, count, at, width = 0, 0, 0, 9
    table: list[bytes] = []
    last, found = b"", bytearray()
    while len(found) < expected:
        while count < width:
            _need(at < len(part), "codes end too early")
            bits, count, at = bits << 8 | part[at], count + 8, at + 1
        count -= width
        code = bits >> count & (1 << width) - 1
        bits &= (1 << count) - 1
        if code == 256:
            table, last, width = [bytes([k]) for k in range(256)] + [b"", b""], b"", 9
            continue
        _need(table and code != 257, "codes begin without a table, or end too early")
        _need(code < len(table) or (code == len(table) and last), "a code that stands for nothing")
        _need(len(table) < 4096, "a table of more than 4096 codes")
        if last:
            table.append(last + (table[code] if code < len(table) else last)[:1])
        last = table[code]
        found += last
        width = min(12, (len(table) + 1).bit_length())
    return bytes(found)


def _tiff(files: Files, entry: str, _: object) -> Held | None:
    content = files[entry]
    tags = list(_directories(content))
    _need(tags, "no image")
    order = "<" if content[:2] == b"II" else ">"
    text = b"".join(tags[0].get(270, ())) if all(isinstance(c, bytes) for c in tags[0].get(270, ())) else b""
    if b"ImageJ=" in text and (count := re.search(rb"images=(\d+)", text)) and len(tags) == 1:
        page = _page(content, tags[0], order)
        if page is None:
            return None
        start = int(tags[0][273][0])
        whole = content[start : start + int(count[1]) * page.nbytes]
        _need(len(whole) == int(count[1]) * page.nbytes > 0, "images")
        return Held(np.frombuffer(whole, page.dtype).reshape(-1, *page.shape), loose=True)
    if text.startswith(b"{") and len(tags) == 1:  # tifffile's own stacks
        return None
    pages = []
    for one in tags:
        try:
            pages.append(_page(content, one, order))
        except Damaged:  # what is said once, for the first page, may be believed of the others
            if any(one.get(tag) != tags[0].get(tag) for tag in _KIND):
                return None  # another image, of which nothing is read
            pages.append(_page(content, tags[0] | {tag: one[tag] for tag in (273, 279, 324, 325) if tag in one}, order))
    if any(page is None for page in pages):
        return None
    known = [page for page in pages if page is not None]
    if len({(page.shape, page.dtype) for page in known}) > 1:
        return None
    return Held(np.stack(known), loose=True)


# -- pictures ------------------------------------------------------------------------------------------------------


def _png(files: Files, entry: str, _: object) -> Held | None:
    return _decoded(files, entry, "png_decode", _sound_png)


def _jpg(files: Files, entry: str, _: object) -> Held | None:
    return _decoded(files, entry, "jpeg8_decode", None)


def _bmp(files: Files, entry: str, _: object) -> Held | None:
    return _decoded(files, entry, "bmp_decode", None)


def _decoded(files: Files, entry: str, decoder: str, check: Callable[[bytes], None] | None) -> Held | None:
    import imagecodecs

    images = []
    for name in [entry] if entry else sorted(files, key=lambda name: int(name.partition(".")[0])):
        if check is not None:
            check(files[name])
        try:
            images.append(getattr(imagecodecs, decoder)(files[name]))
        except Exception as error:
            if decoder == "bmp_decode":
                return None
            raise Damaged(f"{decoder}: {error}") from error
    if len({image.shape for image in images}) > 1:
        return None
    return Held(np.stack(images) if len(images) > 1 else images[0], loose=images[0].ndim > 2)


def _sound_png(content: bytes) -> None:
    _need(content[:8] == b"\x89PNG\r\n\x1a\n", "signature")
    at, packed = 8, b""
    while True:
        _need(at + 12 <= len(content), "a chunk ends too early")
        size, kind = struct.unpack_from(">I4s", content, at)
        part = content[at + 4 : at + 8 + size]
        _need(len(part) == size + 4 and at + 12 + size <= len(content), "a chunk ends too early")
        _need(
            kind[0] & 32 or content[at + 8 + size : at + 12 + size] == struct.pack(">I", zlib.crc32(part)), f"checksum of {kind!r}"
        )
        packed += part[4:] if kind == b"IDAT" else b""
        at += 12 + size
        if kind == b"IEND":
            break
    unpacker = zlib.decompressobj()
    try:
        unpacker.decompress(packed)
    except zlib.error as error:
        raise Damaged(str(error)) from error
    _need(unpacker.eof, "samples end too early")


# -- others --------------------------------------------------------------------------------------------------------


def _hdf5(files: Files, entry: str, _: object) -> Held | None:
    """The one numeric array of two or more axes, read by h5py: the same library, which is trusted."""
    import h5py

    found: list[Any] = []
    with h5py.File(io.BytesIO(files[entry]), "r") as file:
        file.visititems(lambda _, node: found.append(_scaled(node)) if isinstance(node, h5py.Dataset) and node.ndim > 1 else None)
    return Held(found[0], loose=True) if len(found) == 1 else None


def _scaled(array: Any) -> Array:
    """Scaled by the netCDF conventions."""
    data, about = array[()], array.attrs
    slope, offset, missing = (np.ravel(about[n])[0] if n in about else None for n in ("scale_factor", "add_offset", "_FillValue"))
    if slope is None and offset is None and missing is None:
        return np.asarray(data)
    values = np.where(data == missing, np.nan, data) if missing is not None and (data == missing).any() else data
    if (slope or 1, offset or 0) == (1, 0):
        return np.asarray(values)
    return np.asarray(values, np.float64) * (1 if slope is None else slope) + (offset or 0)


def _vti(files: Files, entry: str, _: object) -> Held | None:
    content = files[entry]
    appended = re.search(rb"<AppendedData encoding=\"(raw|base64)\"\s*>\s*_", content)
    tail = b""
    if appended:
        tail = content[appended.end() :]
        end = tail.rfind(b"</AppendedData>")
        _need(end >= 0, "appended data do not end")
        content, tail = content[: appended.end()] + tail[end:], tail[:end]
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise Damaged(str(error)) from error
    image = root.find("ImageData")
    pieces = [] if image is None else image.findall("Piece")
    arrays = [array for piece in pieces for array in piece.iter("DataArray")]
    if image is None or len(pieces) != 1 or len(arrays) != 1 or arrays[0].get("NumberOfComponents", "1") != "1":
        return None
    array, extent = arrays[0], [int(n) for n in image.get("WholeExtent", "").split()]
    if len(extent) != 6 or pieces[0].get("Extent", "").split() != image.get("WholeExtent", "").split():
        return None
    if pieces[0].find("PointData/DataArray") is None:
        return None
    shape = tuple(extent[k + 1] - extent[k] + 1 for k in (4, 2, 0))
    order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.get("byte_order", ""))
    if order is None or not re.fullmatch(r"(UI|I)nt(8|16|32|64)|Float(32|64)", array.get("type", "")):
        return None
    dtype = np.dtype(array.get("type", "").lower()).newbyteorder(order)  # type: ignore[arg-type]
    spacing = tuple(_reals(image.get("Spacing", "1 1 1")))
    _need(len(spacing) == 3, "Spacing")
    way = array.get("format")
    if way == "ascii":
        words = (array.text or "").split()
        _need(len(words) == math.prod(shape), f"{len(words)} samples for {math.prod(shape)}")
        try:
            return Held(
                np.array([float(word) if dtype.kind == "f" else int(word) for word in words]).astype(dtype).reshape(shape), spacing
            )
        except (ValueError, OverflowError) as error:
            raise Damaged(str(error)) from error
    if way not in ("binary", "appended") or root.get("compressor", "vtkZLibDataCompressor") != "vtkZLibDataCompressor":
        return None
    coded = way == "binary" or (appended is not None and appended[1] == b"base64")
    source = (array.text or "").strip().encode() if way == "binary" else tail[int(array.get("offset", "0")) :]
    word = np.dtype({"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"), "u4")).newbyteorder(order)  # type: ignore[arg-type]

    def bytes_at(start: int, count: int) -> bytes:
        """Bytes from `start` on; base64 restarts there."""
        if not coded:
            part = source[start : start + count]
        else:
            try:
                part = base64.b64decode(source[start : start + -(-count // 3) * 4], validate=True)[:count]
            except ValueError as error:
                raise Damaged(str(error)) from error
        _need(len(part) == count, "samples end too early")
        return part

    def far(count: int) -> int:
        return -(-count // 3) * 4 if coded else count

    if root.get("compressor") is None:
        (size,) = np.frombuffer(bytes_at(0, word.itemsize), word).tolist()
        whole = bytes_at(0, word.itemsize + size)[word.itemsize :] if coded else bytes_at(word.itemsize, size)
        return Held(_shaped(whole, dtype, shape), spacing)
    blocks, size, rest = np.frombuffer(bytes_at(0, 3 * word.itemsize), word).tolist()
    _need(blocks < 1000, "blocks")
    packed = np.frombuffer(bytes_at(0, (3 + blocks) * word.itemsize), word)[3:].tolist()
    whole = bytes_at(far((3 + blocks) * word.itemsize), sum(packed))
    parts, at = [], 0
    try:
        for length in packed:
            parts.append(zlib.decompress(whole[at : at + length]))
            at += length
    except zlib.error as error:
        raise Damaged(str(error)) from error
    del size, rest
    return Held(_shaped(b"".join(parts), dtype, shape), spacing)


def _zarr(files: Files, entry: str, _: object) -> Held | None:
    if entry.endswith(".zip"):
        parts = _members(files[entry])
    else:
        parts = {name.removeprefix(f"{entry}/"): content for name, content in files.items()}
    try:
        for name in parts:
            if name.rpartition("/")[2] in ("zarr.json", ".zarray"):
                about = json.loads(parts[name])
                if "shape" in about:
                    return _zarr_array(parts, name.rpartition("/")[0], about)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise LookupError(str(error)) from error
    return None


def _zarr_array(parts: Files, folder: str, about: Mapping[str, Any]) -> Held | None:
    shape = tuple(about["shape"])
    if about["zarr_format"] == 3:
        chunks, dtype = tuple(about["chunk_grid"]["configuration"]["chunk_shape"]), np.dtype(about["data_type"])
        joint, prefix = about["chunk_key_encoding"]["configuration"].get("separator", "/"), "c"
        steps = [(step["name"], step.get("configuration", {})) for step in about["codecs"]]
        fortran = False
        orders = [how.get("endian", "little") for name, how in steps if name == "bytes"]
        if len(orders) != 1 or {name for name, _ in steps} - {"bytes", "gzip", "zstd", "crc32c"}:
            return None
        dtype = dtype.newbyteorder({"little": "<", "big": ">"}[orders[0]])  # type: ignore[arg-type]
    else:
        chunks, dtype, fortran = tuple(about["chunks"]), np.dtype(about["dtype"]), about["order"] == "F"
        joint, prefix = about.get("dimension_separator", "."), ""
        if about.get("filters") or (about["compressor"] or {"id": ""})["id"] not in ("", "zlib"):
            return None
        steps = [(about["compressor"]["id"], {})] if about["compressor"] else []
    data = np.full(shape, about["fill_value"] or 0, dtype)
    for place in itertools.product(*(range(-(-n // m)) for n, m in zip(shape, chunks, strict=True))):
        words = joint.join(map(str, place))
        name = f"{folder}/{prefix}{joint if prefix else ''}{words}".lstrip("/")
        if name not in parts:
            continue
        part: Any = parts[name]
        for step, _ in reversed(steps):
            part = _zarr_step(step, part)
        block = _shaped(bytes(part), dtype, chunks, "F" if fortran else "C")
        box = tuple(slice(i * m, min((i + 1) * m, n)) for i, m, n in zip(place, chunks, shape, strict=True))
        data[box] = block[tuple(slice(0, s.stop - s.start) for s in box)]
    return Held(data, loose=True)


def _zarr_step(step: str, part: bytes) -> bytes:
    import imagecodecs

    try:
        if step == "gzip":
            return gzip.decompress(part)
        if step == "zlib":
            return zlib.decompress(part)
        if step == "zstd":
            return bytes(imagecodecs.zstd_decode(part))
        if step == "crc32c":
            import google_crc32c

            _need(google_crc32c.value(part[:-4]) == int.from_bytes(part[-4:], "little"), "checksum of a chunk")
            return part[:-4]
    except Damaged:
        raise
    except Exception as error:
        raise Damaged(f"{step}: {error}") from error
    return part


def _raw(files: Files, entry: str, options: Any) -> Held:
    dtype = np.dtype(options["dtype"])
    content = files[entry][options.get("offset", 0) :]
    data = _shaped(content, np.dtype("u1") if dtype.kind == "b" else dtype, options["shape"])
    return Held(data != 0 if dtype.kind == "b" else data)


TRUTHS: Mapping[str, Callable[[Files, str, Any], Held | None]] = {
    "npy": _npy,
    "npz": _npz,
    "nii": _nibabel,
    "nii.gz": _nibabel,
    "hdr": _nibabel,
    "mgh": _mgh,
    "mgz": _mgh,
    "nrrd": _nrrd,
    "nhdr": _nrrd,
    "mha": _metaimage,
    "mhd": _metaimage,
    "dcm": _dicom,
    "tiff": _tiff,
    "tiff-packed": _tiff,
    "png": _png,
    "jpg": _jpg,
    "bmp": _bmp,
    "h5": _hdf5,
    "nc": _hdf5,
    "ims": lambda *_: None,
    "vti": _vti,
    "zarr": _zarr,
    "zarr.zip": _zarr,
    "czi": lambda *_: None,
    "raw": _raw,
    "mrc": _mrc,
    "nc3": lambda *_: None,
    "mnc": lambda *_: None,
    "img": _nibabel,
    "vtk": lambda *_: None,
}
"""For each format of the corpus: who else says what a file holds."""
