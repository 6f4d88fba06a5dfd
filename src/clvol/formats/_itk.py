"""Between `Volume` and SimpleITK, for the formats that ITK reads and writes.

SimpleITK crashes, hangs or zero-fills on damaged files: each format checks the header
itself, and only what is sound is handed over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clvol.errors import FormatError, GeometryError
from clvol.formats._files import foreign_errors, require_default, scaled, storable
from clvol.interop import Content, from_simpleitk, simpleitk
from clvol.volume import Volume

__all__ = ["Header", "quiet", "read_image", "reason", "write_image"]

_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")
_TOLERANCE = 1e-4  # NIfTI keeps geometry in float32; anything worse was lost, not rounded


@dataclass(frozen=True)
class Header:
    """What a format's own check found in a file.

    Parameters
    ----------
    size : tuple of int
        Samples along x, y(, z), without trailing axes of one sample.
    units : str
        World unit.
    spacing_known : bool
        False where the header says that the spacing is unknown; ITK would make it 1.
    slope, offset : float
        What turns a sample into the value that is meant, ``slope * sample + offset``; ITK passes it over.
    """

    size: tuple[int, ...]
    units: str = "mm"
    spacing_known: bool = True
    slope: float = 1.0
    offset: float = 0.0


def reason(error: Exception) -> str:
    """What an exception of SimpleITK says, without source lines and addresses."""
    text = str(error).partition("ITK ERROR:")[2] or str(error).partition("sitk::ERROR:")[2] or str(error)
    return " ".join(re.sub(r"\w+\(0x[0-9a-f]+\):", "", text).split())


@contextmanager
def quiet() -> Iterator[None]:
    """Keep ITK's warnings from the terminal: what matters becomes an exception."""
    process = simpleitk().ProcessObject
    shown = process.GetGlobalWarningDisplay()
    process.SetGlobalWarningDisplay(False)
    try:
        yield
    finally:
        process.SetGlobalWarningDisplay(shown)


def read_image(path: Path, image_io: str, header: Header) -> Content:
    """Samples and geometry of a file that `header` was found sound for."""
    sitk = simpleitk()
    with quiet(), foreign_errors(f"read {path}", reason):
        image = sitk.ReadImage(str(path), imageIO=image_io)
    data, geometry = from_simpleitk(image, header.units)
    if data.shape[::-1] != header.size:  # two readings of one header disagree: trust neither
        raise FormatError(f"cannot read {path}: its header says {header.size}, ITK finds {data.shape[::-1]} samples")
    if not header.spacing_known:
        geometry["spacing"] = (float("nan"),) * data.ndim
    return scaled(data, header.slope, header.offset), geometry


def write_image(volume: Volume, path: Path, image_io: str, check: Callable[[Path], Header]) -> None:
    """Write `volume` and verify the file: ITK does not notice a full disk."""
    if volume.units != "mm":
        require_default(volume, ["units"], "the format measures in mm; .npz")
    sitk = simpleitk()
    image = sitk.GetImageFromArray(storable(volume.data, _DTYPES))
    image.SetSpacing(volume.spacing)
    image.SetOrigin(volume.origin)
    image.SetDirection(volume.direction.ravel().tolist())
    with quiet(), foreign_errors(f"write {path.name}", reason):
        sitk.WriteImage(image, str(path), imageIO=image_io)
        try:
            header = check(path)
        except FormatError as error:
            raise FormatError(f"what was written could not be read back: {error}") from error
        reader = sitk.ImageFileReader()
        reader.SetFileName(str(path))
        reader.SetImageIO(image_io)
        reader.ReadImageInformation()
    try:
        kept = Volume(
            np.broadcast_to(np.uint8(0), header.size[::-1]),
            reader.GetSpacing(),
            reader.GetOrigin(),
            np.asarray(reader.GetDirection()),
        )
    except GeometryError as error:
        raise FormatError(f"the format cannot hold the geometry: {error}") from error
    for name in ("spacing", "origin", "direction"):
        ours, theirs = np.asarray(getattr(volume, name)), np.asarray(getattr(kept, name))
        if np.abs(ours - theirs).max() > _TOLERANCE * np.abs(ours).max():
            raise FormatError(
                f"the format cannot hold {name} {ours.tolist()}, it would become {theirs.tolist()}; .nrrd and .mha can"
            )
