"""NRRD (``.nrrd``; ``.nhdr`` with its samples in another file), by SimpleITK."""

from __future__ import annotations

import gzip
import math
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.units import one_unit
from clvol.formats import _itk
from clvol.formats._choice import Choice
from clvol.formats._files import gunzipped_size, require_bytes
from clvol.formats._headers import data_files, line, numbers, parsed, samples_each, whole
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["check", "lazily", "read", "write"]

_IO = "NrrdImageIO"
_NAMES = {  # the format's names of types
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
_DTYPES = {alias: dtype for dtype, aliases in _NAMES.items() for alias in aliases.split(", ")}
_VALUES = {  # meaning of an axis of these kinds: values of a voxel, or for a list (of gradients, of times) volumes
    "rgb": "rgb-color, rgba-color, 3-color, 4-color",
    "vector": "vector, covariant-vector, normal, 2-vector, 3-vector, 3-gradient, 3-normal, point",
    "volume": "list",
}
_KINDS = {kind: value for value, kinds in _VALUES.items() for kind in kinds.split(", ")}
_DOMAIN = ("domain", "space", "time", "???", "none")
_PER_AXIS = ("spacings", "thicknesses", "axis mins", "axismins", "axis maxs", "axismaxs")
_VECTORS = ("space directions", "space origin", "measurement frame")
_PART = r"(?:none|\([^()]*\))"
_ENCODINGS = {"raw": "raw", "gzip": "gzip", "gz": "gzip", "ascii": "ascii", "text": "ascii", "txt": "ascii"}
_MAX_FIELD = 500  # bytes; ITK's reader writes a field that it rejects into a buffer of 1024


def read(path: Path, choose: Choice) -> Content:
    """Samples and geometry, converted to ITK's LPS frame from the header's.

    Segmentations of 3D Slicer are labels with names and colours, or if segments overlap, in several layers, a channel for each.
    """
    header, segments = _checked(path)
    if not segments:
        return _itk.read_image(path, _IO, header, choose)
    data, about = _itk.read_image(path, _IO, replace(header, values="volume"), Choice(whole=True))
    about |= _described(segments)
    if about.pop("leading", None) is None:
        if any(segment.layer for segment in segments):
            raise FormatError(f"{path.name} must have a layer for each of its segments' layers; it has one")
        pick = choose(path.name, Leading())
        return pick.finish(data), about | pick.about
    del about["labels"]
    if max(segment.layer for segment in segments) >= len(data):
        raise FormatError(f"{path.name} must have a layer for each of its segments' layers; it has {len(data)}")
    names, colors = tuple(one.name for one in segments), tuple(one.color for one in segments)
    pick = choose(path.name, Leading(("channel",), (len(segments),), {"channel": names}, colors))
    which = np.arange(len(segments))[pick.index[0]]
    announce(path.name, np.size(which) * data[0].size)
    parts = [data[segments[i].layer] == segments[i].label for i in np.ravel(which)]
    masks = np.stack(parts).astype(np.uint8).reshape(*np.shape(which), *data.shape[1:])
    return pick.finish(masks), about | pick.about


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand; empty if they are compressed, or segments overlap."""
    header, segments = _checked(path)
    if not segments:
        return _itk.open_image(path, _IO, header, choose)
    several = any(segment.layer for segment in segments)
    contents = [] if several else _itk.open_image(path, _IO, header, choose)
    return [(data, about | _described(segments)) for data, about in contents]


def write(volume: Volume | Volumes, path: Path) -> None:
    """Write samples and geometry exactly; ``.nhdr`` puts the samples into a ``.raw`` file beside it."""
    _itk.write_image(volume, path, _IO, check)


def check(path: Path) -> _itk.Header:
    """Read the header and count the samples."""
    return _checked(path)[0]


@dataclass(frozen=True)
class _Segment:
    """A segment of a segmentation of 3D Slicer."""

    id: str
    name: str
    label: int
    layer: int
    color: tuple[float, float, float] | None


def _segments(name: str, fields: dict[str, str]) -> list[_Segment]:
    """The segments in the order of the header; those of old files, without labels, are layers."""
    found: list[_Segment] = []
    while f"Segment{len(found)}_ID:=" in fields:
        n = len(found)
        about = {key: fields.get(f"Segment{n}_{key}:=") for key in ("ID", "Name", "LabelValue", "Layer", "Color")}
        (label,) = whole(name, f"Segment{n}_LabelValue", about["LabelValue"] or "1", 0)
        (layer,) = whole(name, f"Segment{n}_Layer", about["Layer"] or str(0 if about["LabelValue"] else n), 0)
        color = None
        if about["Color"]:
            r, g, b = (min(max(0.0, part), 1.0) for part in numbers(name, f"Segment{n}_Color", about["Color"], 3))
            color = r, g, b
        found.append(_Segment(about["ID"] or "", about["Name"] or "", label, layer, color))
    return found


def _described(segments: list[_Segment]) -> dict[str, Any]:
    """Arguments of `Volume` for labels."""
    return {
        "labels": {one.label: (one.name, one.color) for one in segments},
        "header": {"segments": [asdict(one) for one in segments]},
    }


def _checked(path: Path) -> tuple[_itk.Header, list[_Segment]]:
    """The header, and the segments of a segmentation; the samples are counted."""
    if len(os.fsencode(path)) > _MAX_FIELD:
        raise FormatError(f"the path of a NRRD file must have up to {_MAX_FIELD} bytes; got {path}")
    with path.open("rb") as stream:
        fields = _fields(stream, path.name)
        size, dtype = _layout(fields, path.name)
        kind = _order(path.name, fields, dtype)
        expected = math.prod(size) * kind.itemsize
        places = data_files(path, fields["data file"], stream, math.prod(size)) if "data file" in fields else [path]
        begin = stream.tell() if places == [path] else 0
        each = samples_each(path.name, size, len(places))
        stored = sum(place.stat().st_size for place in places)
        for place in places:
            with place.open("rb") as samples:
                samples.seek(begin)
                found = _samples(samples, fields, place.name, each * kind.itemsize)
            # -1: the samples end with the file, whatever precedes them
            require_bytes(
                place.name, found, (each,) if len(places) > 1 else size[::-1], kind, exact=fields.get("byte skip") != "-1"
            )
    _check_numbers(fields, path.name, len(size))
    units = re.findall(r'"([^"]*)"', fields.get("space units", fields.get("units", "")))
    kinds = [*fields.get("kinds", "").lower().split(), *["domain"] * len(size)][: len(size)]
    texts = (fields.get("spacings", "").split(), re.findall(r"none|\(.*?\)", fields.get("space directions", "").lower()))
    domain = [axis for axis, kind in enumerate(kinds) if kind in _DOMAIN][:3]
    known = not any(said[axis].lower() in ("nan", "none") for said in texts for axis in domain if axis < len(said))
    spans = [kind for kind in kinds if kind in _DOMAIN]
    if "time" in spans[:-1]:  # ITK would treat it as an axis of space
        raise FormatError(f"{path.name} must have its axis of time last; its header says kinds: {fields['kinds'][:80]}")
    ranges = [axis for axis, kind in enumerate(kinds) if kind not in _DOMAIN]
    flat, encoding = None, _ENCODINGS[fields["encoding"].lower()]
    if (encoding != "gzip" or len(places) > 1) and len(ranges) < 2:
        load = None
        if encoding == "ascii" or len(places) > 1:
            load = partial(_loaded, places, begin, fields, size[::-1], kind)
        flat = _itk.Flat(places[0], stored - expected, kind, size[::-1], len(size) - 1 - ranges[0] if ranges else None, load)
    values = next((_KINDS.get(kind, "channel") for kind in kinds if kind not in _DOMAIN), "")
    header = _itk.Header(
        size,
        one_unit(path.name, units) or "mm",
        known,
        values=values,
        timed="time" in spans,
        bytes=expected,
        stored=stored,
        flat=flat,
    )
    return header, _segments(path.name, fields)


def _order(name: str, fields: dict[str, str], dtype: str) -> np.dtype[np.generic]:
    """The dtype in the header's byte order, which it must give for samples of several bytes, unless these are text."""
    kind = np.dtype(dtype)
    needless = kind.itemsize == 1 or _ENCODINGS[fields["encoding"].lower()] == "ascii"
    order = fields.get("endian", "little" if needless else "").lower()
    if order not in ("little", "big"):
        raise FormatError(f"{name} must say whether its samples are of endian little or big; got {order[:80]!r}")
    return kind.newbyteorder("<" if order == "little" else ">")


def _fields(stream: IO[bytes], name: str) -> dict[str, str]:
    """``field: value`` lines up to the empty line or the end of the file, and ``key:=value`` lines by "key:="."""
    magic = line(stream, name)
    if magic is None or not re.fullmatch(r"NRRD000[1-5]", magic):
        raise FormatError(f"{name} must begin with NRRD0001 to NRRD0005; found {(magic or '')[:80]!r}")
    fields: dict[str, str] = {}
    while text := line(stream, name):
        if text.startswith("#"):
            continue
        if free := re.match(r"[^:]*:=", text):
            fields[free[0]] = re.sub(r"\\([n\\])", lambda found: "\n" if found[1] == "n" else "\\", text[free.end() :])
            continue
        key, colon, value = text.partition(": ")
        key = {"datafile": "data file", "lineskip": "line skip", "byteskip": "byte skip"}.get(key.lower(), key.lower())
        if not colon or key in fields:
            raise FormatError(f"{name} must have lines 'field: value', each field once; found {text[:80]!r}")
        if (length := len(os.fsencode(text))) > _MAX_FIELD and key != "content":
            raise FormatError(f"{name} must have fields of up to {_MAX_FIELD} bytes; {key[:80]!r} has {length}")
        fields[key] = value.strip()
        if key == "data file" and fields[key].upper().startswith("LIST"):  # file names follow, up to the end
            break
    return fields


def _layout(fields: dict[str, str], name: str) -> tuple[tuple[int, ...], str]:
    """Samples along x, y(, z), and their dtype."""
    for key in ("dimension", "sizes", "type", "encoding"):
        if key not in fields:
            raise FormatError(
                f"{name} must have a NRRD header with the field {key!r}; it has {[one for one in fields if not one.endswith(':=')]}"
            )
    (rank,) = whole(name, "dimension", fields["dimension"], 0)
    if rank not in (2, 3, 4, 5):
        raise FormatError(f"{name} must have 2 to 5 axes; its header says dimension: {rank}")
    size = whole(name, "sizes", fields["sizes"], 1, rank)
    dtype = _DTYPES.get(fields["type"].lower())
    if dtype is None:
        raise FormatError(f"{name} must have samples of type {', '.join(_DTYPES)}; got {fields['type']!r}")
    if fields["encoding"].lower() not in _ENCODINGS:
        raise FormatError(f"{name} must have an encoding of {', '.join(_ENCODINGS)}; got {fields['encoding']!r}")
    return size, dtype


def _check_numbers(fields: dict[str, str], name: str, rank: int) -> None:
    """Raise for malformed numbers: ITK's reader reads "1,5" as 1, and a number that is too large as no spacing."""
    for key in _PER_AXIS:
        if key in fields:
            numbers(name, key, fields[key], rank, nan=True)
    for key in ("old min", "oldmin", "old max", "oldmax"):
        if key in fields:
            numbers(name, key, fields[key], 1, nan=True)
    spaces = {len(_vector(name, key, part)) for key in _VECTORS if key in fields for part in _parts(name, key, fields[key])} - {0}
    declared = whole(name, "space dimension", fields["space dimension"], 1) if "space dimension" in fields else ()
    if len(spaces.union(declared)) > 1:
        raise FormatError(f"{name} must give vectors of one space; some have {' and some '.join(map(str, sorted(spaces)))} numbers")
    if "space directions" in fields and len(parts := _parts(name, "space directions", fields["space directions"])) != rank:
        raise FormatError(f"{name} must give {rank} vectors for 'space directions', one for each axis; got {len(parts)}")


def _parts(name: str, key: str, text: str) -> list[str]:
    """The vectors of a field, or "none" for an axis without one."""
    if not re.fullmatch(rf"\s*{_PART}(\s+{_PART})*\s*", text, re.IGNORECASE):
        raise FormatError(f"{name} must give vectors such as (1,0,0), or none, for {key!r}; got {text[:80]!r}")
    return re.findall(_PART, text, re.IGNORECASE)


def _vector(name: str, key: str, text: str) -> tuple[float, ...]:
    if text.lower() == "none":
        return ()
    words = text.strip("()").split(",")
    return numbers(name, key, " ".join(words), len(words), nan=True)


def _samples(stream: IO[bytes], fields: dict[str, str], name: str, expected: int) -> int:
    """Bytes of samples that follow in `stream`, unpacked."""
    skip = _skipped(stream, fields, name)
    encoding = _ENCODINGS[fields["encoding"].lower()]
    if encoding == "gzip":
        return gunzipped_size(stream, expected)
    if encoding == "ascii":  # counted when it is parsed
        return expected
    start = stream.tell()
    end = stream.seek(0, 2)
    return end - start if skip == -1 else end - start - skip


def _skipped(stream: IO[bytes], fields: dict[str, str], name: str) -> int:
    """Skip lines; the bytes that are to be skipped behind them."""
    (lines,) = whole(name, "line skip", fields.get("line skip", "0"), 0)
    (skip,) = whole(name, "byte skip", fields.get("byte skip", "0"), -1)
    if _ENCODINGS[fields["encoding"].lower()] != "raw" and (lines or skip):
        raise FormatError(f"{name} must not skip lines or bytes before samples that are not raw")
    for done in range(lines):
        while not (part := stream.readline(1 << 20)).endswith(b"\n"):
            if not part:
                raise FormatError(f"{name} must have {lines} lines to skip before its samples; found {done}")
    return skip


def _loaded(
    places: Sequence[Path], begin: int, fields: dict[str, str], shape: tuple[int, ...], kind: np.dtype[Any]
) -> NDArray[Any]:
    """All samples, of several files or of text, whose lengths were checked."""
    encoding, each = _ENCODINGS[fields["encoding"].lower()], math.prod(shape) // len(places)
    data = np.empty(math.prod(shape), kind)
    for number, place in enumerate(places):
        with place.open("rb") as stream:
            stream.seek(begin)
            if encoding == "ascii":
                part = parsed(place.name, "its text", stream.read().replace(b",", b" "), np.dtype(kind.type), each)
            elif encoding == "gzip":
                part = np.frombuffer(gzip.decompress(stream.read()), kind)
            else:
                stream.seek(-each * kind.itemsize, os.SEEK_END)
                part = np.frombuffer(stream.read(), kind)
        data[number * each : (number + 1) * each] = part
    return data.reshape(shape)
