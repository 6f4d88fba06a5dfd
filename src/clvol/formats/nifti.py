"""NIfTI-1 (``.nii``, ``.nii.gz``), by way of SimpleITK."""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path

import numpy as np

from clvol.errors import FormatError
from clvol.formats import _itk
from clvol.formats._files import gunzipped_size, require_bytes
from clvol.interop import Content
from clvol.volume import Volume

__all__ = ["check", "read", "write"]

_IO = "NiftiImageIO"
_HEADER_BYTES = 348
_DTYPES = {
    2: "uint8",
    4: "int16",
    8: "int32",
    16: "float32",
    64: "float64",
    256: "int8",
    512: "uint16",
    768: "uint32",
    1024: "int64",
    1280: "uint64",
}


def read(path: Path) -> Content:
    """Samples (scaled as the header says) and geometry, turned from NIfTI's RAS to ITK's LPS."""
    return _itk.read_image(path, _IO, check(path))


def write(volume: Volume, path: Path) -> None:
    """Write samples exactly, and geometry in float32, which is what NIfTI keeps."""
    turn = volume.direction
    if not np.allclose(turn.T @ turn, np.eye(volume.ndim), atol=1e-4):
        raise FormatError("NIfTI cannot hold a direction whose columns are not at right angles; .nrrd and .mha can")
    _itk.write_image(volume, path, _IO, check)


def check(path: Path) -> _itk.Header:
    """Read the header, and count the samples: ITK fills with zeros what a truncated file lacks."""
    packed = path.suffix.lower() == ".gz"
    with path.open("rb") as stream:
        if packed:
            with gzip.GzipFile(fileobj=stream) as unpacked:
                head = unpacked.read(_HEADER_BYTES)
        else:
            head = stream.read(_HEADER_BYTES)
        size, dtype, start = _parse(head, path.name)
        end = start + math.prod(size) * np.dtype(dtype).itemsize
        stream.seek(0)
        found = gunzipped_size(stream, end) if packed else path.stat().st_size
    require_bytes(path.name, found - start, size[::-1], dtype)
    return _itk.Header(size)


def _parse(head: bytes, name: str) -> tuple[tuple[int, ...], str, int]:
    """Samples along x, y(, z), their dtype, and where they begin."""
    if len(head) < _HEADER_BYTES:
        raise FormatError(f"{name} must begin with a NIfTI header of {_HEADER_BYTES} bytes; found {len(head)}")
    order = "<" if head[:4] == struct.pack("<i", _HEADER_BYTES) else ">"
    (length,) = struct.unpack(f"{order}i", head[:4])
    if length != _HEADER_BYTES or head[344:348] != b"n+1\0":
        raise FormatError(f"{name} must be a NIfTI-1 file with its samples in the same file (magic n+1); it is not")
    rank, *counts = struct.unpack(f"{order}8h", head[40:56])
    code = struct.unpack(f"{order}h", head[70:72])[0]
    (start,) = struct.unpack(f"{order}f", head[108:112])
    if not 2 <= rank <= 7 or min(counts[:rank]) < 1:
        raise FormatError(f"{name} must have 2 or 3 axes of at least one sample; its header says {rank} axes {counts}")
    if any(n != 1 for n in counts[3:rank]):
        raise FormatError(f"{name} must hold one volume; its header says {counts[:rank]} samples: write them as separate files")
    if code not in _DTYPES:
        raise FormatError(f"{name} must hold real numbers, one per voxel; its header says datatype {code}")
    if not (math.isfinite(start) and start == int(start) and start >= _HEADER_BYTES):
        raise FormatError(f"{name} must say where its samples begin, after the header; it says {start}")
    placement = struct.unpack(f"{order}18f", head[256:328])  # quaternion, offset, affine rows
    if not all(math.isfinite(v) for v in placement):
        raise FormatError(f"{name} must be placed by finite numbers; its header says {placement}")
    return tuple(counts[: min(rank, 3)]), _DTYPES[code], int(start)
