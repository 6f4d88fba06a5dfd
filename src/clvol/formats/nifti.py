"""NIfTI-1 and -2 (``.nii`` and pairs of ``.hdr`` and ``.img``, also packed by gzip): read here, written by nibabel.

ITK finds a NIfTI image by its name: for ``x.nii.gz`` it reads the samples of ``x.nii`` beside it. It also prefers the qform to a
different sform, and drops small slopes. Reading here follows nibabel instead, and needs no other package.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, GeometryError
from clvol.base.frames import Placement, affine_parts, from_ras
from clvol.bricks.sliced import FlatFile, Index, Window
from clvol.formats._choice import Choice
from clvol.formats._files import gunzipped_size, packed, paired, require_bytes, require_default, scaled, unpacked
from clvol.formats._layout import Layout, scaled_part
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.interop.nibabel import CIFTI, NIFTI_MILLIMETRES, NO_VOLUME, describe_nifti, same_place
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["lazily", "lazily_pair", "read", "read_pair", "write"]


_FIELDS = """
    dim          8i2  40   8i8  16
    intent_p1     f4  56    f8  80
    intent_p2     f4  60    f8  88
    intent_p3     f4  64    f8  96
    intent_code   i2  68    i4 504
    datatype      i2  70    i2  12
    pixdim       8f4  76   8f8 104
    vox_offset    f4 108    i8 168
    scl_slope     f4 112    f8 176
    scl_inter     f4 116    f8 184
    xyzt_units    u1 123    i4 500
    cal_max       f4 124    f8 192
    cal_min       f4 128    f8 200
    descrip      S80 148   S80 240
    aux_file     S24 228   S24 320
    qform_code    i2 252    i4 344
    sform_code    i2 254    i4 348
    quaternion   6f4 256   6f8 352
    srow        12f4 280  12f8 400
    intent_name  S16 328   S16 508
    magic         V4 344    V8   4
"""  # those that are read, by nibabel's names: type and offset in NIfTI-1, and in NIfTI-2


def _record(column: int, size: int) -> np.dtype[Any]:
    """A header of `size` bytes, as one of the two columns has it."""
    rows = [line.split() for line in _FIELDS.strip().splitlines()]
    kinds, offsets = [row[column] for row in rows], [int(row[column + 1]) for row in rows]
    return np.dtype({"names": [row[0] for row in rows], "formats": kinds, "offsets": offsets, "itemsize": size})


_HEADERS = {348: _record(1, 348), 540: _record(3, 540)}  # by the length at the start of a header
_MAGIC = {348: (b"n+1\0", b"ni1\0"), 540: (b"n+2\0\r\n\x1a\n", b"ni2\0\r\n\x1a\n")}  # in one file, and in two
_AFTER = 4  # bytes between header and samples in one file, which say whether extensions follow
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
_COLORS = {128: 3, 2304: 4}  # bytes per voxel
_AT_ONCE = 1 << 18  # bytes to unpack at a time
_TRUSTED = 1 << 26  # bytes of samples that any packed file may claim without being counted
_PACKED = 20  # bytes that it may claim for each of its own; gzip packs up to 1032 into one
_PLACED = range(1, 6)  # codes of a valid sform or qform; nibabel treats any other as 0, none
_ROUNDING = 3 * float(np.finfo(np.float32).eps)  # of a quaternion's squared length in float32; nibabel's value

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class _Header:
    """The contents of a header: samples along x, y(, z), number of volumes, dtype, start of the samples, ...

    Colours have interleaved `parts`.
    """

    length: int  # of the header in bytes
    size: tuple[int, ...]
    volumes: int
    parts: int
    dtype: np.dtype[Any]
    start: int
    slope: float
    offset: float
    leading: Leading
    about: dict[str, Any]
    guessed: str = ""

    @property
    def step(self) -> int:
        """Bytes of one volume."""
        return math.prod(self.size) * self.parts * self.dtype.itemsize

    @property
    def end(self) -> int:
        """One past the last byte of the samples."""
        return self.start + self.volumes * self.step


def read(path: Path, choose: Choice) -> Content:
    """Samples of the chosen volumes, scaled as the header says, and geometry, converted from NIfTI's RAS to ITK's LPS.

    Both equal nibabel's. Other volumes are not loaded, but a packed file is unpacked to its end, for its checksum.
    """
    return _read(path, _header(path), choose)


def read_pair(path: Path, choose: Choice) -> Content:
    """As `read`, of a pair of files; `path` is that of either."""
    return _read(_beside(path, ".img"), _header(path, pair=True), choose)


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand; empty for a packed file, which has no random access."""
    return [] if packed(path) else [_lazily(path, _header(path), choose)]


def lazily_pair(path: Path, choose: Choice) -> list[Content]:
    """As `lazily`, of a pair of files; `path` is that of either."""
    samples = _beside(path, ".img")
    return [] if packed(samples) else [_lazily(samples, _header(path, pair=True), choose)]


def _header(path: Path, pair: bool = False) -> _Header:
    with unpacked(_beside(path, ".hdr") if pair else path) as stream:
        header = _parse(stream, path.name, pair)
    return header if header.start or pair else _begun(path, header)


def _begun(path: Path, header: _Header) -> _Header:
    """The header of one file whose vox_offset is 0: samples end with the file, and begin after the header and its extension flag.

    nifti_clib, which ITK and FSL use, takes them to begin right after the header, where some programs put them.
    """
    ends = [replace(header, start=start) for start in (header.length + _AFTER, header.length)]
    found = _stored(path, max(one.end for one in ends))
    chosen = next((one for one in ends if one.end == found), ends[0])
    text = f"its vox_offset is 0, and its samples were taken to begin at byte {chosen.start}"
    return replace(chosen, guessed="; ".join(filter(None, (header.guessed, text))))


def _stored(path: Path, limit: int) -> int:
    """Bytes of a file, unpacked."""
    if not packed(path):
        return path.stat().st_size
    with path.open("rb") as file:
        return gunzipped_size(file, limit)


def _lazily(path: Path, header: _Header, choose: Choice) -> Content:
    _count(path, header)
    colours = header.parts > 1
    before = header.leading.counts[:-1] if colours else header.leading.counts
    shape = (*before, *header.size[::-1], *(header.parts,) * colours)
    flat = FlatFile(path, shape, header.dtype, header.start)
    names = (*header.leading.axes[: len(before)], *"zyx"[-len(header.size) :], *("channel",) * colours)

    def part(index: Index) -> Window:
        stored = Window(flat, shape, header.dtype, None, index)
        return scaled_part(stored, header.slope, header.offset)

    data, about = Layout(names, shape, header.guessed).chosen(path.name, choose, part, header.leading)
    return data, header.about | about


def _beside(path: Path, suffix: str) -> Path:
    file = paired(path, suffix)
    if file is None:
        name = path.with_suffix("").with_suffix(f"{suffix}.gz") if packed(path) else path.with_suffix(suffix)
        raise FormatError(f"{path.name} must have {name.name} beside it, which is not there")
    return file


def _read(path: Path, header: _Header, choose: Choice) -> Content:
    size = path.stat().st_size
    believed = max(_TRUSTED, _PACKED * size)
    if not packed(path) or header.volumes > believed:
        _count(path, header)  # raises if samples are missing, before memory is allocated for them
    pick = choose(path.name, header.leading, header.guessed)
    # colours are interleaved in the file, and separated in memory
    own = len(header.leading.axes) - (header.parts > 1)
    wanted = np.arange(header.volumes).reshape(header.leading.counts[:own])[pick.index[:own]]
    needed = wanted.size * header.step
    announce(path.name, needed)
    if packed(path) and needed > believed:
        _count(path, header)
    raw = np.empty(needed, np.uint8)
    with unpacked(path) as stream:
        found = _fill(raw, stream, header, wanted.ravel())
    shape = header.size[::-1]
    require_bytes(path.name, found, (header.volumes, header.parts, *shape), header.dtype, exact=True)
    data = raw.view(header.dtype).reshape(*wanted.shape, *shape, *((header.parts,) if header.parts > 1 else ()))
    if not header.dtype.isnative:
        data = data.byteswap(inplace=True).view(header.dtype.newbyteorder("="))
    if header.parts > 1:
        data = np.ascontiguousarray(np.moveaxis(data, -1, wanted.ndim)[(slice(None),) * wanted.ndim + (pick.index[-1],)])
    return pick.finish(scaled(data, header.slope, header.offset)), header.about | pick.about


def write(what: Volume | Volumes, path: Path) -> None:
    """Write samples exactly, and geometry in float32, as NIfTI-1 stores it, or NIfTI-2 where that would move a sample."""
    grid = what.grid if isinstance(what, Volumes) else what
    if grid.units != "mm":
        require_default(grid, ["units"], "the format measures in mm; .npz")
    turn = grid.direction
    if not np.allclose(turn.T @ turn, np.eye(grid.ndim), atol=1e-4):  # the qform, which ITK prefers, cannot hold it
        raise FormatError("NIfTI cannot hold a direction whose columns are not at right angles; .nrrd and .mha can")
    try:
        image = what.to_nibabel()
    except (DataError, GeometryError) as error:
        raise FormatError(f"{error}; .nrrd, .mha and .npz can") from error
    image.to_filename(path)


def _count(path: Path, header: _Header) -> None:
    found = _stored(path, header.end)
    shape = (header.volumes, header.parts, *header.size[::-1])
    require_bytes(path.name, max(0, found - header.start), shape, header.dtype, exact=True)


def _fill(raw: NDArray[np.uint8], stream: IO[bytes], header: _Header, wanted: NDArray[np.intp]) -> int:
    """Fill `raw` with the `wanted` volumes of a stream. Returns the bytes of all samples in it, and one more if more follow."""
    room = memoryview(raw.data)
    for n, volume in enumerate(wanted):
        stream.seek(header.start + int(volume) * header.step)
        done, end = n * header.step, (n + 1) * header.step
        # gzip unpacks all that one call asks for before it copies
        while done < end and (count := stream.readinto(room[done : min(end, done + _AT_ONCE)])):  # type: ignore[attr-defined]
            done += count
        if done < end:
            return max(0, stream.tell() - header.start)
    stream.seek(header.end)
    surplus = stream.read(1)  # at the end, gzip verifies the checksum
    return stream.tell() - header.start if surplus else max(0, min(stream.tell(), header.end) - header.start)


def _parse(stream: IO[bytes], name: str, pair: bool = False) -> _Header:
    head = stream.read(max(_HEADERS))
    lengths = {struct.unpack(order + "i", head[:4])[0]: order for order in "<>"} if len(head) >= 4 else {}
    length = next((n for n in lengths if n in _HEADERS), min(_HEADERS))
    if len(head) < length:
        raise FormatError(f"{name} must begin with a NIfTI header of {length} bytes; found {len(head)}")
    kind = _HEADERS[length].newbyteorder(lengths.get(length, "<"))  # type: ignore[arg-type]  # one of the two above
    fields = np.frombuffer(head, kind, 1)[0]
    if length not in lengths or bytes(fields["magic"]) != _MAGIC[length][pair]:
        where = "in a file beside it (magic ni1 or ni2)" if pair else "in the same file (magic n+1 or n+2)"
        raise FormatError(f"{name} must be a NIfTI-1 or NIfTI-2 file with its samples {where}; it is not")
    rank, *counts = (int(n) for n in fields["dim"])
    if not 2 <= rank <= 7 or min(counts[:rank]) < 1:
        raise FormatError(f"{name} must have 2 to 7 axes of at least one sample; its header says {rank} axes {counts}")
    code, start = int(fields["datatype"]), float(fields["vox_offset"])
    slope, offset = float(fields["scl_slope"]), float(fields["scl_inter"])
    if code not in _DTYPES and code not in _COLORS:
        raise FormatError(f"{name} must hold real numbers or colours of bytes; its header says datatype {code}")
    first = 0 if pair else length + _AFTER
    if not (math.isfinite(start) and start == int(start) and (start >= first or start == 0)):
        raise FormatError(f"{name} must say where its samples begin, at byte {first} or later; its header says {start:g}")
    if slope == 0 or not math.isfinite(slope):  # the format's way of saying: no scale, and no offset
        slope, offset = 1.0, 0.0
    if not math.isfinite(offset):
        raise FormatError(f"{name} must scale its samples by finite numbers; its header says scl_slope {slope}, scl_inter {offset}")
    size, parts = tuple(counts[: min(rank, 3)]), _COLORS.get(code, 1)
    unit = int(fields["xyzt_units"]) & 7
    if unit not in NIFTI_MILLIMETRES:
        raise FormatError(f"{name} must measure in m, mm or µm (xyzt_units 1, 2 or 3, or 0 for none); its header says {unit}")
    if int(fields["intent_code"]) in CIFTI:
        raise FormatError(f"{name} {NO_VOLUME}")
    placed, alike = _placed(name, fields, size)
    about = from_ras(placed, len(size), NIFTI_MILLIMETRES[unit]) | describe_nifti(fields, counts[:rank], parts if parts > 1 else 0)
    if not (placed[0][: len(size)] > 0).all():  # `spacing=` may replace it
        by = "srow" if int(fields["sform_code"]) in _PLACED else "pixdim"
        what = f"its {'sform (srow)' if by == 'srow' else by} must give each axis a finite length that is not 0"
        about["unplaced"] = f"{what}; its header says {np.array(fields[by]).tolist()}"
    if not alike:
        about["header"]["qform_code"] = int(fields["sform_code"])
    dtype = np.dtype(_DTYPES.get(code, "uint8")).newbyteorder(lengths[length])  # type: ignore[arg-type]
    leading = Leading(**about.pop("leading", {}))
    guessed = f"its axes 4 to {rank} were taken for one, of volumes" if math.prod(counts[5:rank]) > 1 else ""
    return _Header(length, size, math.prod(counts[3:rank]), parts, dtype, int(start), slope, offset, leading, about, guessed)


# -- spacing, origin and direction in the RAS world, by the first of three methods that the header provides -----------------------


def _placed(name: str, fields: Any, size: tuple[int, ...]) -> tuple[Placement, bool]:
    """The placement; and False if there are sform and qform, and they differ."""
    pixdim, rows, numbers = (np.asarray(fields[key], np.float64) for key in ("pixdim", "srow", "quaternion"))
    has_qform = int(fields["qform_code"]) in _PLACED
    if int(fields["sform_code"]) not in _PLACED:
        if has_qform:
            return _by_qform(name, numbers, np.abs(pixdim[1:4]), pixdim[0]), True
        return _by_pixdim(np.abs(pixdim[1:4]), (*size, 1)[:3]), True
    rows = rows.reshape(3, 4)
    _require_finite(name, "srow", rows)
    sform = affine_parts(rows[:, :3], rows[:, 3])  # pixdim is ignored
    if not has_qform:
        return sform, True
    try:
        return sform, same_place(sform, _by_qform(name, numbers, np.abs(pixdim[1:4]), pixdim[0]))
    except FormatError:  # the qform is not in use
        return sform, False


def _by_qform(name: str, numbers: Vector, pixdim: Vector, qfac: float) -> Placement:
    """By a unit quaternion, of which three components are stored, and an offset."""
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
    """By the spacing alone: nibabel centres the grid at the origin, with x from right to left."""
    flip = np.array([-1.0, 1.0, 1.0])
    known = np.where(np.isfinite(pixdim), pixdim, 0)  # an unknown spacing is refused later, unless the caller gives one
    return pixdim, -flip * known * (np.array(size) - 1) / 2, np.diag(flip)


def _require_finite(name: str, what: str, numbers: Vector) -> None:
    if not np.isfinite(numbers).all():
        raise FormatError(f"{name} must be placed by finite numbers; its header says {what} {numbers.tolist()}")
