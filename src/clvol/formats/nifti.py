"""NIfTI-1 (``.nii``, ``.nii.gz``): read here, written by way of SimpleITK.

ITK looks for a NIfTI image by its name: beside ``x.nii`` it takes the samples of that for ``x.nii.gz``. It also prefers the
qform to a sform that differs, and drops small slopes. Reading follows nibabel instead, and needs no other package.
"""

from __future__ import annotations

import gzip
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

import numpy as np
from numpy.typing import NDArray

from clvol.errors import FormatError
from clvol.formats import _itk
from clvol.formats._files import gunzipped_size, require_bytes, scaled
from clvol.interop import NIFTI_MILLIMETRES, Content, Placement, affine_parts, from_ras
from clvol.volume import Volume

__all__ = ["check", "read", "write"]

_IO = "NiftiImageIO"
_HEADER_BYTES = 348
_FIRST = 352  # where samples may begin: four bytes after the header say whether extensions follow
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
_TRUSTED = 1 << 26  # bytes of samples that are believed of any packed file
_PACKED = 20  # and for every byte of it; beyond, they are counted first, for gzip packs up to 1032 into one
_PLACED = range(1, 6)  # codes of a sform or qform that says where the grid lies; nibabel takes any other for 0, nowhere
_ROUNDING = 3 * float(np.finfo(np.float32).eps)  # of a quaternion's squared length in float32; nibabel's number

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class _Header:
    """What the header says: samples along x, y(, z) with their type, and where they begin; what they mean, and where they lie."""

    size: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int
    slope: float
    offset: float
    geometry: dict[str, Any]

    @property
    def end(self) -> int:
        """Where the samples end."""
        return self.start + math.prod(self.size) * self.dtype.itemsize


def read(path: Path) -> Content:
    """Samples, scaled as the header says, and geometry, turned from NIfTI's RAS to ITK's LPS; both as nibabel has them."""
    with _opened(path) as stream:
        header = _parse(stream.read(_HEADER_BYTES), path.name)
        size = path.stat().st_size
        if header.end > (max(_TRUSTED, _PACKED * size) if _packed(path) else size):
            check(path)  # raises before memory is asked for that the samples do not fill
        raw = np.empty(header.end - header.start, np.uint8)
        stream.seek(header.start)
        found = _fill(raw, stream)
        stream.read(1)  # past the end the checksum is compared
    require_bytes(path.name, found, header.size[::-1], header.dtype)
    data = raw.view(header.dtype).reshape(header.size[::-1])
    if not header.dtype.isnative:
        data = data.byteswap(inplace=True).view(header.dtype.newbyteorder("="))
    return scaled(data, header.slope, header.offset), header.geometry


def write(volume: Volume, path: Path) -> None:
    """Write samples exactly, and geometry in float32, which is what NIfTI keeps."""
    turn = volume.direction
    if not np.allclose(turn.T @ turn, np.eye(volume.ndim), atol=1e-4):
        raise FormatError("NIfTI cannot hold a direction whose columns are not at right angles; .nrrd and .mha can")
    _itk.write_image(volume, path, _IO, check)


def check(path: Path) -> _itk.Header:
    """Read the header, and count the samples."""
    with _opened(path) as stream:
        header = _parse(stream.read(_HEADER_BYTES), path.name)
    if _packed(path):
        with path.open("rb") as file:
            found = gunzipped_size(file, header.end)
    else:
        found = path.stat().st_size
    require_bytes(path.name, max(0, found - header.start), header.size[::-1], header.dtype)
    return _itk.Header(header.size)


def _packed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


def _opened(path: Path) -> BinaryIO:
    return cast(BinaryIO, gzip.open(path)) if _packed(path) else path.open("rb")


def _fill(raw: NDArray[np.uint8], stream: BinaryIO) -> int:
    """Fill `raw` from `stream`; how many bytes there were."""
    room, done = memoryview(raw.data), 0
    while done < raw.size and (n := stream.readinto(room[done:])):  # type: ignore[attr-defined]  # every binary stream has it
        done += n
    return done


def _parse(head: bytes, name: str) -> _Header:
    if len(head) < _HEADER_BYTES:
        raise FormatError(f"{name} must begin with a NIfTI header of {_HEADER_BYTES} bytes; found {len(head)}")
    order: Literal["<", ">"] = "<" if head[:4] == struct.pack("<i", _HEADER_BYTES) else ">"

    def field(offset: int, kind: str) -> tuple[Any, ...]:
        return struct.unpack_from(order + kind, head, offset)

    if field(0, "i") != (_HEADER_BYTES,) or head[344:348] != b"n+1\0":
        raise FormatError(f"{name} must be a NIfTI-1 file with its samples in the same file (magic n+1); it is not")
    rank, *counts = field(40, "8h")
    code, start, slope, offset = *field(70, "h"), *field(108, "3f")
    if not 2 <= rank <= 7 or min(counts[:rank]) < 1:
        raise FormatError(f"{name} must have 2 or 3 axes of at least one sample; its header says {rank} axes {counts}")
    if any(n != 1 for n in counts[3:rank]):
        raise FormatError(f"{name} must hold one volume; its header says {counts[:rank]} samples: write them as separate files")
    if code not in _DTYPES:
        raise FormatError(f"{name} must hold real numbers, one per voxel; its header says datatype {code}")
    if not (math.isfinite(start) and start == int(start) and start >= _FIRST):
        raise FormatError(f"{name} must say where its samples begin, at byte {_FIRST} or later; its header says {start:g}")
    if slope == 0 or not math.isfinite(slope):  # the format's way of saying that there is no scale, and no offset either
        slope, offset = 1.0, 0.0
    if not math.isfinite(offset):
        raise FormatError(f"{name} must scale its samples by finite numbers; its header says scl_slope {slope}, scl_inter {offset}")
    size = tuple(counts[: min(rank, 3)])
    qform, sform = field(252, "2h")
    qfac, *pixdim = field(76, "4f")
    if sform in _PLACED:
        placed = _by_sform(name, np.reshape(field(280, "12f"), (3, 4)))
    elif qform in _PLACED:
        placed = _by_qform(name, np.array(field(256, "6f")), np.abs(pixdim), qfac)
    else:
        placed = _by_pixdim(np.abs(pixdim), (*size, 1)[:3])
    unit = head[123] & 7
    if unit not in NIFTI_MILLIMETRES:
        raise FormatError(f"{name} must measure in m, mm or µm (xyzt_units 1, 2 or 3, or 0 for none); its header says {unit}")
    geometry = from_ras(placed, len(size), NIFTI_MILLIMETRES[unit])
    return _Header(size, np.dtype(_DTYPES[code]).newbyteorder(order), int(start), slope, offset, geometry)


# -- where the grid lies: spacing, origin and direction in the RAS world, by the first of three ways that the header has ----------


def _by_sform(name: str, rows: Vector) -> Placement:
    """By an affine matrix; pixdim has no say."""
    _require_finite(name, "srow", rows)
    return affine_parts(rows[:, :3], rows[:, 3])


def _by_qform(name: str, numbers: Vector, pixdim: Vector, qfac: float) -> Placement:
    """By a unit quaternion, of which three parts are kept, and an offset."""
    _require_finite(name, "quatern and qoffset", numbers)
    axis, offset = numbers[:3], numbers[3:]
    rest = 1 - float(axis @ axis)
    if rest <= -_ROUNDING:
        raise FormatError(f"{name} must be turned by a unit quaternion; its header says {axis.tolist()}, longer than 1")
    quaternion = np.array([math.sqrt(rest) if rest >= _ROUNDING else 0.0, *axis])
    a, b, c, d = quaternion / np.linalg.norm(quaternion)
    cross = np.array([[0, -d, c], [d, 0, -b], [-c, b, 0]])
    direction = np.eye(3) + 2 * a * cross + 2 * cross @ cross
    direction[:, 2] *= -1 if qfac == -1 else 1
    return pixdim, offset, direction


def _by_pixdim(pixdim: Vector, size: tuple[int, ...]) -> Placement:
    """By the spacing alone: nibabel puts the world's origin into the middle, and takes x to run from right to left."""
    flip = np.array([-1.0, 1.0, 1.0])
    known = np.where(np.isfinite(pixdim), pixdim, 0)  # an unknown spacing is refused, unless the caller gives it
    return pixdim, -flip * known * (np.array(size) - 1) / 2, np.diag(flip)


def _require_finite(name: str, what: str, numbers: Vector) -> None:
    if not np.isfinite(numbers).all():
        raise FormatError(f"{name} must be placed by finite numbers; its header says {what} {numbers.tolist()}")
