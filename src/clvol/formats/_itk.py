"""Files that SimpleITK reads and writes.

SimpleITK crashes, hangs or fills with zeros on damaged files, so each format first checks the header itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError
from clvol.base.interrupted import quiet as silent
from clvol.bricks.sliced import FlatFile, Index, Window
from clvol.formats._choice import Choice
from clvol.formats._errors import foreign_errors
from clvol.formats._files import require_default, scaled
from clvol.formats._layout import Layout, scaled_part
from clvol.formats.guarded.limits import announce
from clvol.formats.guarded.messages import copied
from clvol.interop.itk import describe_simpleitk, from_simpleitk, simpleitk
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["Flat", "Header", "information", "open_image", "quiet", "read_image", "reason", "write_image"]

_TOLERANCE = 1e-12  # relative, between the geometry to write and the one written


@dataclass(frozen=True)
class Flat:
    """Samples that ITK does not read; the last axis varies fastest. They are contiguous in a file, unless `load` returns them."""

    path: Path
    start: int  # offset of the first sample in bytes
    dtype: np.dtype[Any]  # as stored
    shape: tuple[int, ...]
    channels: int | None = None  # the axis of the values of a voxel
    load: Callable[[], NDArray[Any]] | None = None  # of several files, or of text, which ITK reads beyond its end


@dataclass(frozen=True)
class Header:
    """What a format's check found in a file."""

    size: tuple[int, ...]  # samples along the axes of the file, and values per voxel, in any order
    units: str = "mm"
    spacing_known: bool = True  # else ITK would make it 1
    slope: float = 1.0  # values are slope * sample + offset; ITK ignores that
    offset: float = 0.0
    values: str = ""  # what the values of a voxel are: "vector", "rgb", "channel", "volume"; "" if the header does not say
    timed: bool = False  # the fourth axis is time
    bytes: int = 0  # of the samples
    stored: int = 0  # bytes of the file that holds them
    flat: Flat | None = None  # None: compressed


def reason(error: Exception) -> str:
    """The message of an exception of SimpleITK, without source lines and addresses."""
    text = str(error).partition("ITK ERROR:")[2] or str(error).partition("sitk::ERROR:")[2] or str(error)
    return " ".join(re.sub(r"\w+\(0x[0-9a-f]+\):", "", text).split())


@contextmanager
def quiet() -> Iterator[None]:
    """Keep ITK's warnings off the terminal: what matters raises an exception."""
    process = simpleitk().ProcessObject
    shown = process.GetGlobalWarningDisplay()
    process.SetGlobalWarningDisplay(False)
    try:
        yield
    finally:
        process.SetGlobalWarningDisplay(shown)


def information(path: Path, image_io: str = "") -> Any:
    """A reader of SimpleITK that has read the metadata of a file."""
    reader = simpleitk().ImageFileReader()
    reader.SetFileName(str(path))
    reader.SetImageIO(image_io)
    reader.ReadImageInformation()
    return reader


def read_image(path: Path, image_io: str, header: Header, choose: Choice) -> Content:
    """Samples and geometry of the chosen volumes of a file whose header was checked."""
    announce(path.name, header.bytes, header.stored)
    if header.flat is not None and header.flat.load is not None:
        data, about = _open(path, image_io, header, header.flat, choose)
        return data[...], about
    sitk = simpleitk()
    with quiet(), foreign_errors(f"read {path}", reason):
        image = sitk.ReadImage(str(path), imageIO=image_io)
    data, geometry = from_simpleitk(image, header.units, copy=False)
    _require_alike(path, header, data.shape)
    leading, guessed = _leading(geometry, header)
    pick = choose(path.name, leading, guessed)
    chosen = scaled(copied(data[pick.index]), header.slope, header.offset)
    return pick.finish(chosen), geometry | pick.about


def open_image(path: Path, image_io: str, header: Header, choose: Choice) -> list[Content]:
    """As `read_image`, but samples are read on demand. Empty if they are compressed, in several files, or text."""
    flat = header.flat
    return [] if flat is None or flat.load is not None else [_open(path, image_io, header, flat, choose)]


def _open(path: Path, image_io: str, header: Header, flat: Flat, choose: Choice) -> Content:
    """Samples that ITK does not read, and the geometry that it gives."""
    sitk = simpleitk()
    with quiet(), foreign_errors(f"open {path}", reason):
        reader = information(path, image_io)
        about = _Information(reader, sitk.GetPixelIDValueAsString(reader.GetPixelIDValue()))
    geometry = describe_simpleitk(about, header.units)
    _require_alike(path, header, (*about.GetSize()[::-1], about.GetNumberOfComponentsPerPixel()))
    kind = {"u": "unsigned integer", "i": "signed integer", "f": "float"}[flat.dtype.kind]
    if f"{8 * flat.dtype.itemsize}-bit {kind}" not in about.kind:
        raise FormatError(f"cannot open {path}: its header says {flat.dtype}, ITK finds {about.kind}")
    leading, guessed = _leading(geometry, header)
    names, own = [""] * len(flat.shape), [axis for axis in range(len(flat.shape)) if axis != flat.channels]
    for axis, name in zip(own[::-1], ("x", "y", "z", *(one for one in leading.axes if one != "channel")), strict=False):
        names[axis] = name
    if flat.channels is not None and flat.shape[flat.channels] > 1:
        names[flat.channels] = "channel" if "channel" in leading.axes else leading.axes[-1]
    load = flat.load
    samples: Callable[[Index], NDArray[Any]]
    samples = FlatFile(flat.path, flat.shape, flat.dtype, flat.start) if load is None else load().__getitem__

    def part(index: Index) -> Window:
        return scaled_part(Window(samples, flat.shape, flat.dtype, None, index), header.slope, header.offset)

    data, known = Layout(tuple(names), flat.shape, guessed).chosen(path.name, choose, part, leading)
    return data, geometry | known


class _Information:
    """The metadata of an `ImageFileReader`, with the methods of an image."""

    def __init__(self, reader: Any, kind: str) -> None:
        self.kind = kind
        self.GetSize, self.GetSpacing, self.GetOrigin = reader.GetSize, reader.GetSpacing, reader.GetOrigin
        self.GetDirection, self.GetDimension = reader.GetDirection, reader.GetDimension
        self.GetNumberOfComponentsPerPixel = reader.GetNumberOfComponents

    def GetPixelIDTypeAsString(self) -> str:
        return self.kind


def _require_alike(path: Path, header: Header, shape: Sequence[int]) -> None:
    """Raise if ITK and our check understand the header differently."""
    if sorted(n for n in shape if n > 1) != sorted(n for n in header.size if n > 1):
        raise FormatError(f"cannot read {path}: its header says {header.size}, ITK finds {tuple(shape[::-1])} samples")


def _leading(geometry: dict[str, Any], header: Header) -> tuple[Leading, str]:
    """The leading axes that ITK finds, with the header's meaning; and how they were interpreted if it has none.

    They are taken out of `geometry`, and so is a spacing that the header does not know.
    """
    if not header.spacing_known:
        geometry["spacing"] = (float("nan"),) * len(geometry["spacing"])
        geometry["unplaced"] = "its header must say how far apart the samples of each axis lie; it says nan or none"
    found = geometry.pop("leading", {})
    axes, counts, values = found.get("axes", ()), found.get("counts", ()), header.values
    if header.timed:
        axes = tuple("time" if axis == "volume" else axis for axis in axes)
    if "channel" not in axes:
        return Leading(axes, counts), ""
    if values == "volume" and len(axes) == 1:
        return Leading(("volume",), counts), ""
    if values:
        return Leading(axes, counts, vector=values == "vector", rgb=values == "rgb" and counts[-1] in (3, 4)), ""
    leading = Leading(axes, counts, vector=found["vector"], rgb=found["rgb"])
    taken = "a colour" if leading.rgb else "the components of a vector" if leading.vector else ""
    return leading, f"the {counts[-1]} values of each voxel were taken for {taken}" if taken else ""


def write_image(what: Volume | Volumes, path: Path, image_io: str, check: Callable[[Path], Header]) -> None:
    """Write one volume or several, and verify the file: ITK does not report a full disk."""
    volume = what.grid if isinstance(what, Volumes) else what
    if volume.units != "mm":
        require_default(volume, ["units"], "the format measures in mm; .npz")
    sitk = simpleitk()
    try:
        image = what.to_sitk()
    except DataError as error:
        raise FormatError(str(error)) from error
    with silent(), quiet(), foreign_errors(f"write {path.name}", reason):
        if path.suffix == ".nhdr":
            _write_detached(sitk, image, path)
        else:
            sitk.WriteImage(image, str(path), imageIO=image_io)
        try:
            check(path)
        except FormatError as error:
            raise FormatError(f"what was written could not be read back: {error}") from error
        reader = information(path, image_io)
    for name in ("Size", "Spacing", "Origin", "Direction"):
        ours, theirs = (np.asarray(getattr(one, f"Get{name}")()) for one in (image, reader))
        if ours.shape != theirs.shape or np.abs(ours - theirs).max() > _TOLERANCE * np.abs(ours).max():
            raise FormatError(f"the format cannot hold {name.lower()} {ours.tolist()}, it would become {theirs.tolist()}; .npz can")


def _write_detached(sitk: Any, image: Any, path: Path) -> None:
    """Write a NRRD header, and the samples beside it; ITK would never close their file if the disk is full.

    The header is that of an image of one sample on the same grid, with the sizes replaced.
    """
    one = sitk.Image([1] * image.GetDimension(), image.GetPixelID(), image.GetNumberOfComponentsPerPixel())
    one.SetSpacing(image.GetSpacing())
    one.SetOrigin(image.GetOrigin())
    one.SetDirection(image.GetDirection())
    samples, whole = path.with_suffix(".raw"), path.with_suffix(".nrrd")
    sitk.WriteImage(one, str(whole), imageIO="NrrdImageIO")
    head = whole.read_bytes().partition(b"\n\n")[0]
    whole.unlink()
    data = sitk.GetArrayViewFromImage(image)
    sizes = f"sizes: {' '.join(map(str, data.shape[::-1]))}".encode()
    path.write_bytes(re.sub(rb"(?m)^sizes: .*$", sizes, head) + f"\ndata file: {samples.name}\n".encode())
    with samples.open("wb") as stream:
        data.tofile(stream)
