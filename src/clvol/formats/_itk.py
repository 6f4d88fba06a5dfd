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
from typing import Any

import numpy as np

from clvol.errors import DataError, FormatError
from clvol.foreign import Content, from_simpleitk, simpleitk
from clvol.formats._choice import Choice
from clvol.formats._files import foreign_errors, require_default, scaled
from clvol.formats._limits import announce
from clvol.formats._wire import copied
from clvol.volume import Volume
from clvol.volumes import Leading, Volumes

__all__ = ["Header", "quiet", "read_image", "reason", "write_image"]

_TOLERANCE = 1e-12  # of what was to be written, to what was


@dataclass(frozen=True)
class Header:
    """What a format's own check found in a file.

    Parameters
    ----------
    size : tuple of int
        Samples along the axes of the file, and values per voxel, in any order.
    units : str
        World unit.
    spacing_known : bool
        False where the header says that the spacing is unknown; ITK would make it 1.
    slope, offset : float
        What turns a sample into the value that is meant, ``slope * sample + offset``; ITK passes it over.
    values : {"", "vector", "rgb", "channel", "volume"}
        What the values of a voxel are; "": the header does not say.
    timed : bool
        Whether the fourth axis is time.
    bytes : int
        Of the samples.
    stored : int
        Bytes of the file that holds them.
    """

    size: tuple[int, ...]
    units: str = "mm"
    spacing_known: bool = True
    slope: float = 1.0
    offset: float = 0.0
    values: str = ""
    timed: bool = False
    bytes: int = 0
    stored: int = 0


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


def read_image(path: Path, image_io: str, header: Header, choose: Choice) -> Content:
    """Samples and geometry of what is chosen of a file that `header` was found sound for."""
    sitk = simpleitk()
    announce(path.name, header.bytes, header.stored)
    with quiet(), foreign_errors(f"read {path}", reason):
        image = sitk.ReadImage(str(path), imageIO=image_io)
    data, geometry = from_simpleitk(image, header.units, copy=False)
    if sorted(n for n in data.shape if n > 1) != sorted(
        n for n in header.size if n > 1
    ):  # two readings of one header: trust neither
        raise FormatError(f"cannot read {path}: its header says {header.size}, ITK finds {data.shape[::-1]} samples")
    if not header.spacing_known:
        geometry["spacing"] = (float("nan"),) * len(geometry["spacing"])
    leading, guessed = _leading(geometry.pop("leading", {}), header)
    pick = choose(path.name, leading, guessed)
    chosen = scaled(copied(data[pick.index]), header.slope, header.offset)
    return pick.finish(chosen), geometry | pick.about


def _leading(found: dict[str, Any], header: Header) -> tuple[Leading, str]:
    """The leading axes that ITK finds, as the header explains them; and how they were understood where it does not."""
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
    """Write one volume or several, and verify the file: ITK does not notice a full disk."""
    volume = what.grid if isinstance(what, Volumes) else what
    if volume.units != "mm":
        require_default(volume, ["units"], "the format measures in mm; .npz")
    sitk = simpleitk()
    try:
        image = what.to_sitk()
    except DataError as error:
        raise FormatError(str(error)) from error
    with quiet(), foreign_errors(f"write {path.name}", reason):
        if path.suffix == ".nhdr":
            _write_detached(sitk, image, path)
        else:
            sitk.WriteImage(image, str(path), imageIO=image_io)
        try:
            check(path)
        except FormatError as error:
            raise FormatError(f"what was written could not be read back: {error}") from error
        reader = sitk.ImageFileReader()
        reader.SetFileName(str(path))
        reader.SetImageIO(image_io)
        reader.ReadImageInformation()
    for name in ("Size", "Spacing", "Origin", "Direction"):
        ours, theirs = (np.asarray(getattr(one, f"Get{name}")()) for one in (image, reader))
        if ours.shape != theirs.shape or np.abs(ours - theirs).max() > _TOLERANCE * np.abs(ours).max():
            raise FormatError(f"the format cannot hold {name.lower()} {ours.tolist()}, it would become {theirs.tolist()}; .npz can")


def _write_detached(sitk: Any, image: Any, path: Path) -> None:
    """Write a NRRD header, and the samples beside it: ITK would keep their file open for good where the disk is full.

    The header is that of an image of one sample on the same grid, with the sizes of this one.
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
