"""MetaImage (``.mha``; ``.mhd`` with its samples in another file), by SimpleITK."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.base.errors import FormatError
from clvol.formats import _itk
from clvol.formats._choice import Choice
from clvol.formats._files import inflated_size, require_bytes
from clvol.formats._headers import data_files, line, numbers, parsed, samples_each, whole
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

__all__ = ["check", "lazily", "read", "write"]

_IO = "MetaImageIO"
_DTYPES = {
    "MET_CHAR": "int8",
    "MET_UCHAR": "uint8",
    "MET_SHORT": "int16",
    "MET_USHORT": "uint16",
    "MET_INT": "int32",
    "MET_UINT": "uint32",
    "MET_LONG": "int32",
    "MET_ULONG": "uint32",
    "MET_LONG_LONG": "int64",
    "MET_ULONG_LONG": "uint64",
    "MET_FLOAT": "float32",
    "MET_DOUBLE": "float64",
}
_ORDERS = ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
_STEEPEST = 1.01  # largest direction cosine, after rounding
_UNITS = {"?": "mm", "um": "um", "mm": "mm", "cm": "cm"}
# Numbers in a field, as a power of the number of axes: ITK reads beyond a field that is too short.
_NUMBERS = dict.fromkeys(("TransformMatrix", "Rotation", "Orientation"), 2)
_NUMBERS |= dict.fromkeys(("Offset", "Position", "Origin", "CenterOfRotation", "ElementSpacing", "ElementSize"), 1)


def read(path: Path, choose: Choice) -> Content:
    """Samples, scaled as the header says, and geometry in ITK's LPS frame."""
    return _itk.read_image(path, _IO, check(path), choose)


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand; empty if they are compressed."""
    return _itk.open_image(path, _IO, check(path), choose)


def write(volume: Volume | Volumes, path: Path) -> None:
    """Write samples and geometry exactly; ``.mhd`` puts the samples into a ``.raw`` file beside it."""
    _itk.write_image(volume, path, _IO, check)


def check(path: Path) -> _itk.Header:
    """Read the header and count the samples."""
    with path.open("rb") as stream:
        fields = _fields(stream, path.name)
        size, dtype = _layout(fields, path.name)
        file = fields["ElementDataFile"]
        local = file.upper() == "LOCAL"
        places = [path] if local else data_files(path, file, stream, math.prod(size))
        begin = stream.tell() if local else 0
        each = samples_each(path.name, size, len(places))
        expected = math.prod(size) * np.dtype(dtype).itemsize
        stored = sum(place.stat().st_size for place in places)
        for place in places:
            with place.open("rb") as samples:
                samples.seek(begin)
                found = _samples(samples, fields, place, each * np.dtype(dtype).itemsize)
            # -1: the samples end with the file, whatever precedes them
            shape = size[::-1] if len(places) == 1 else (each,)
            require_bytes(place.name, found, shape, dtype, exact=fields.get("HeaderSize") != "-1")
    slope, offset = _intensity(fields, path.name)
    orders = {_flag(fields, key, path.name) for key in _ORDERS if key in fields}
    flat, load = None, None
    if not _flag(fields, "CompressedData", path.name) and len(orders) < 2:  # samples end with the file
        kind = np.dtype(dtype).newbyteorder(">" if True in orders else "<")
        shape = (*size[-2::-1], size[-1])
        if len(places) > 1 or not _binary(fields, path.name):
            load = partial(_loaded, places, begin, _binary(fields, path.name), shape, kind)
        flat = _itk.Flat(places[0], stored - expected, kind, shape, len(size) - 1, load)
    elif len(places) > 1:
        raise FormatError(f"{path.name} must hold samples in several files uncompressed, in one byte order")
    return _itk.Header(size, _unit(fields, path.name), slope=slope, offset=offset, bytes=expected, stored=stored, flat=flat)


def _fields(stream: IO[bytes], name: str) -> dict[str, str]:
    """``key = value`` lines up to ``ElementDataFile``, which ends the header."""
    fields: dict[str, str] = {}
    while "ElementDataFile" not in fields:
        text = line(stream, name)
        match = re.fullmatch(r"\s*(\w+)\s*[=:]\s*(.*?)\s*", text) if text is not None else None
        if match is None:
            raise FormatError(
                f"{name} must have a MetaImage header of lines 'key = value' up to 'ElementDataFile = ...'; "
                f"found {'the end of the file' if text is None else repr(text[:80])}"
            )
        key, value = match.groups()
        if key in fields:
            raise FormatError(f"{name} must give each field once; {key!r} is there twice")
        fields[key] = value
    return fields


def _layout(fields: dict[str, str], name: str) -> tuple[tuple[int, ...], str]:
    """Samples along the axes, then values per voxel; and their dtype. Every number that ITK will read is there."""
    for key in ("NDims", "DimSize", "ElementType"):
        if key not in fields:
            raise FormatError(f"{name} must have a MetaImage header with the field {key!r}; it has {list(fields)}")
    (rank,) = whole(name, "NDims", fields["NDims"], -1)
    if rank not in (2, 3, 4):
        raise FormatError(f"{name} must have 2 to 4 axes; its header says NDims = {rank}")
    size = whole(name, "DimSize", fields["DimSize"], 1, rank)
    if fields["ElementType"] not in _DTYPES:
        raise FormatError(f"{name} must have an ElementType of {', '.join(_DTYPES)}; got {fields['ElementType']!r}")
    channels = whole(name, "ElementNumberOfChannels", fields.get("ElementNumberOfChannels", "1"), 1)
    if not _binary(fields, name) and _flag(fields, "CompressedData", name):
        raise FormatError(f"{name} must compress samples in binary; its header says BinaryData = False")
    for key, power in _NUMBERS.items():
        if key in fields:
            count = max(rank, len(fields[key].split())) if power == 1 else rank**power
            values = numbers(name, key, fields[key], count)
            if power == 1 and count > rank:
                warn(f"{name} gives {count} numbers for {key} of {rank} axes; the first {rank} were read, as by ITK")
            if power == 2 and max(map(abs, values)) > _STEEPEST:  # ITK never returns from a matrix of 1e308
                raise FormatError(f"{name} must give direction cosines for {key!r}; got {fields[key][:80]!r}")
    for key in _ORDERS:
        _flag(fields, key, name)
    return size + channels, _DTYPES[fields["ElementType"]]


def _binary(fields: dict[str, str], name: str) -> bool:
    """Whether samples are not text."""
    return _flag(fields, "BinaryData", name, "True")


def _loaded(places: Sequence[Path], begin: int, binary: bool, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """All samples, of several files or of text, whose lengths were checked."""
    each = math.prod(shape) // len(places)
    data = np.empty(math.prod(shape), kind)
    for number, place in enumerate(places):
        with place.open("rb") as stream:
            stream.seek(begin if not binary else place.stat().st_size - each * kind.itemsize)
            text = stream.read()
        part = np.frombuffer(text, kind) if binary else parsed(place.name, "its text", text, np.dtype(kind.type), each)
        data[number * each : (number + 1) * each] = part
    return data.reshape(shape)


def _samples(stream: IO[bytes], fields: dict[str, str], path: Path, expected: int) -> int:
    """Bytes of samples that follow in `stream`, unpacked."""
    if not _binary(fields, path.name):  # counted when it is parsed
        return expected
    (skip,) = whole(path.name, "HeaderSize", fields.get("HeaderSize", "0"), -1)
    start = stream.tell()
    end = stream.seek(0, 2)
    if 0 < skip < start:  # ITK would take the header's text for samples
        raise FormatError(f"{path.name} must not have samples inside its header of {start} bytes; HeaderSize = {skip}")
    if not _flag(fields, "CompressedData", path.name):
        return end if skip == -1 else end - max(start, skip)
    if skip:
        raise FormatError(f"{path.name} must not skip bytes before compressed samples; HeaderSize = {skip}")
    # Without this number ITK unpacks nothing, and returns uninitialised memory.
    (packed,) = whole(path.name, "CompressedDataSize", fields.get("CompressedDataSize", ""), 1)
    if packed != end - start:
        raise FormatError(f"{path.name} must hold {packed} compressed bytes; found {end - start}")
    stream.seek(start)
    return inflated_size(stream, packed, expected, exact=True)


def _intensity(fields: dict[str, str], name: str) -> tuple[float, float]:
    """Slope and offset from samples to values."""
    slope, offset = (
        numbers(name, key, fields.get(key, default), 1)[0]
        for key, default in (("ElementToIntensityFunctionSlope", "1"), ("ElementToIntensityFunctionOffset", "0"))
    )
    if not slope:
        raise FormatError(f"{name} must scale its samples by a slope that is not 0; its header says {slope}")
    return slope, offset


def _unit(fields: dict[str, str], name: str) -> str:
    """The world unit; mm by default."""
    unit = fields.get("DistanceUnits", "mm")
    if unit not in _UNITS:
        raise FormatError(f"{name} must measure in {', '.join(_UNITS)} (DistanceUnits); its header says {unit!r}")
    return _UNITS[unit]


def _flag(fields: dict[str, str], key: str, name: str, default: str = "False") -> bool:
    """A boolean field; MetaIO reads its first letter only, and anything unknown as False."""
    text = fields.get(key, default)
    if text.lower() not in ("true", "false", "t", "f", "1", "0"):
        raise FormatError(f"{name} must say True or False for {key!r}; got {text[:80]!r}")
    return text[0] in "Tt1"
