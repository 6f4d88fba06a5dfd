"""MRC and CCP4 maps of electron microscopy and crystallography (``.mrc``, ``.map``, ``.ccp4``, also packed by gzip).

Source: MRC2014 (Cheng et al., J. Struct. Biol. 192, 2015), whose header mrcfile reads too, and the flags of IMOD's mrc_format.txt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.base.errors import DataError, FormatError
from clvol.bricks.sliced import FlatFile, Window
from clvol.formats._choice import Choice
from clvol.formats._files import gunzipped_size, packed, require_bytes, sample_count, unpacked
from clvol.formats._layout import Layout
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["is_file", "lazily", "read"]

_BYTES = 1024
_FIELDS = {  # type and offset of those that are read
    "size": ("3i4", 0),
    "mode": ("i4", 12),
    "start": ("3i4", 16),
    "grid": ("3i4", 28),
    "cell": ("3f4", 40),
    "angles": ("3f4", 52),
    "axes": ("3i4", 64),
    "space_group": ("i4", 88),
    "extended": ("i4", 92),
    "exttyp": ("S4", 104),
    "stamp": ("i4", 152),
    "flags": ("i4", 156),
    "origin": ("3f4", 196),
    "magic": ("S4", 208),
    "machine": ("2u1", 212),
    "label_count": ("i4", 220),
    "labels": ("10S80", 224),
}
_HEADER = np.dtype(
    {"names": list(_FIELDS), "formats": [f for f, _ in _FIELDS.values()], "offsets": [o for _, o in _FIELDS.values()],
     "itemsize": _BYTES}
)  # fmt: skip
_DTYPES = {0: "i1", 1: "i2", 2: "f4", 6: "u2", 12: "f2", 16: "u1"}
_COLOURS = 16  # three bytes for each sample
_OTHERS = {3: "complex numbers", 4: "complex numbers", 101: "numbers of four bits"}
_MACHINES = {0x44: "<", 0x11: ">"}
_IMOD, _SIGNED = 1146047817, 1  # IMOD's stamp, and its flag for bytes with a sign
_STACKS = range(401, 631)  # space groups of stacks of volumes
_FAR = 10  # sizes of the grid, beyond which the first index was never set


@dataclass(frozen=True)
class _Header:
    """What a header says: the meaning of the axes, the type and the first byte of the samples, and arguments of `Volume`."""

    layout: Layout
    dtype: np.dtype[Any]
    first: int
    leading: Leading
    about: dict[str, Any]

    @property
    def bytes(self) -> int:
        """Of the samples."""
        return sample_count(self.layout.shape) * self.dtype.itemsize


def is_file(path: Path) -> bool:
    """Whether a file says that it is of MRC's or CCP4's format."""
    with path.open("rb") as stream:
        return stream.read(_BYTES)[208:212] == b"MAP "


def read(path: Path, choose: Choice) -> Content:
    """Samples [z, y, x] of the chosen volumes, whichever axes the file stores first, and geometry in Å."""
    header = _header(path)
    announce(path.name, header.bytes)
    if not packed(path):
        ((data, about),) = _content(path, header, choose)
        return data[...], about
    with unpacked(path) as stream:
        stream.seek(header.first)
        samples = np.frombuffer(stream.read(header.bytes), header.dtype).reshape(header.layout.shape)
    samples = samples.astype(header.dtype.newbyteorder("="), copy=False)
    data, known = header.layout.chosen(path.name, choose, lambda index: samples[index], header.leading)
    return np.ascontiguousarray(data), header.about | known


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand; empty for a packed file, which has no random access."""
    return [] if packed(path) else _content(path, _header(path), choose)


def _content(path: Path, header: _Header, choose: Choice) -> list[Content]:
    shape, dtype = header.layout.shape, header.dtype
    flat = FlatFile(path, shape, dtype, header.first)
    data, known = header.layout.chosen(path.name, choose, lambda index: Window(flat, shape, dtype, None, index), header.leading)
    return [(data, header.about | known)]


def _header(path: Path) -> _Header:
    """The header, and whether all samples are there."""
    with unpacked(path) as stream:
        head = stream.read(_BYTES)
    if len(head) < _BYTES:
        raise FormatError(f"{path.name} must begin with a header of {_BYTES} bytes; found {len(head)}")
    order, fields = _ordered(path.name, head)
    mode, size = int(fields["mode"]), tuple(int(n) for n in fields["size"])
    if mode not in _DTYPES:
        what = _OTHERS.get(mode, "numbers of an unknown type")
        raise DataError(
            f"{path.name} must hold real numbers or colours, of mode {', '.join(map(str, _DTYPES))}; got {what}, of mode {mode}"
        )
    unsigned = mode == 0 and fields["stamp"] == _IMOD and not fields["flags"] & _SIGNED
    dtype = np.dtype("u1" if unsigned else _DTYPES[mode]).newbyteorder(order)  # type: ignore[arg-type]  # one of the two
    layout, leading = _axes(path.name, fields, size)
    header = _Header(layout, dtype, _BYTES + int(fields["extended"]), leading, _about(path.name, fields, len(layout.of({}))))
    if packed(path):
        with path.open("rb") as file:
            found = gunzipped_size(file, header.first + header.bytes) - header.first
    else:
        found = path.stat().st_size - header.first
    require_bytes(path.name, max(0, found), layout.shape, dtype)
    if found > header.bytes:
        warn(f"{path.name} has {found - header.bytes} bytes behind the {header.bytes} of its samples, which were not read")
    return header


def _ordered(name: str, head: bytes) -> tuple[str, Any]:
    """The byte order, and the fields in it: that of the machine stamp, or of a header that makes sense."""
    stamped = _MACHINES.get(head[212], "<")
    for order in (stamped, "><"["><".index(stamped) - 1]):
        fields = np.frombuffer(head, _HEADER.newbyteorder(order), 1)[0]  # type: ignore[arg-type]  # one of the two
        axes = sorted(int(axis) for axis in fields["axes"])
        if min(fields["size"]) > 0 and 0 <= fields["mode"] < 128 and axes in ([1, 2, 3], [0, 0, 0]) and fields["extended"] >= 0:
            return order, fields
    raise FormatError(f"{name} must have a header of MRC or CCP4, with sizes above 0, a mode, and axes 1, 2 and 3; it has none")


def _axes(name: str, fields: Any, size: tuple[int, ...]) -> tuple[Layout, Leading]:
    """The meaning of the axes: sections, rows and columns; before them volumes of a stack, behind them colours."""
    order = [int(axis) - 1 for axis in fields["axes"]] if fields["axes"].any() else [0, 1, 2]
    names, shape = ["xyz"[axis] for axis in order[::-1]], list(size[::-1])
    depth = int(fields["grid"][2])
    if fields["space_group"] in _STACKS and shape[0] != depth:
        if depth < 1 or shape[0] % depth:
            raise FormatError(f"{name} must be a stack of volumes of MZ = {depth} sections each; it has {shape[0]} sections")
        names, shape = ["volume", *names], [shape[0] // depth, depth, *shape[1:]]
    elif shape[0] == 1 and fields["space_group"] == 0 and names[0] == "z":  # an image
        names[0] = ""
    if fields["mode"] == _COLOURS:
        names, shape = [*names, "channel"], [*shape, 3]
    layout = Layout(tuple(names), tuple(shape))
    return layout, layout.channels_of(np.dtype("u1")) if "channel" in names else Leading(layout.leading, layout.counts)


def _about(name: str, fields: Any, d: int) -> dict[str, Any]:
    """Geometry in Å: the axes of the unit cell, and the first sample, which lies at ORIGIN, or if that is 0 at NXSTART, ..."""
    cell, grid = fields["cell"].astype(np.float64), fields["grid"].astype(np.float64)
    known = (cell > 0) & (grid > 0) & np.isfinite(cell)
    spacing = np.divide(cell, grid, out=np.ones(3), where=known)
    if known.any() and not known[:d].all():
        without = "".join(axis for axis, there in zip("xyz", known, strict=True) if not there)
        warn(f"{name} does not say how far apart its samples are along {without}; 1 Å was taken: spacing= replaces it")
    direction = _cell_axes(name, fields["angles"].astype(np.float64))
    order = [int(axis) - 1 for axis in fields["axes"]] if fields["axes"].any() else [0, 1, 2]
    start = np.zeros(3)
    start[order] = fields["start"]
    origin = fields["origin"].astype(np.float64)
    if fields["magic"][:3] != b"MAP" or not origin.any() or not np.isfinite(origin).all():  # older files have other numbers there
        far = _FAR * int(max(*fields["size"], *fields["grid"]))
        origin = direction @ (start * spacing) if np.abs(start).max() <= far else np.zeros(3)
    labels = [bytes(text).decode("latin-1").strip() for text in fields["labels"][: max(0, int(fields["label_count"]))]]
    kept: dict[str, Any] = {"labels": tuple(filter(None, labels)), "space_group": int(fields["space_group"])}
    if fields["extended"]:
        kept |= {"exttyp": bytes(fields["exttyp"]).decode("latin-1").strip(), "extended_bytes": int(fields["extended"])}
    return {
        "spacing": spacing[:d],
        "origin": origin[:d],
        "direction": direction[:d, :d],
        "units": "angstrom" if known.any() else "",
        "header": kept,
    }


def _cell_axes(name: str, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors along the axes of a unit cell, as columns: the first along x, the second in the xy plane."""
    if not angles.any() or (angles == 90).all():  # of old files, which leave them out
        return np.eye(3)
    (ca, cb, cg), sg = np.cos(np.radians(angles)), math.sin(math.radians(angles[2]))
    with np.errstate(invalid="ignore", divide="ignore"):
        y = np.float64(ca - cb * cg) / sg
        axes = np.array([[1, cg, cb], [0, sg, y], [0, 0, np.sqrt(1 - cb * cb - y * y)]])
    if not np.isfinite(axes).all() or min(axes[1, 1], axes[2, 2]) <= 0:
        raise FormatError(f"{name} must have a unit cell with three independent axes; its angles are {angles.tolist()}")
    return axes
