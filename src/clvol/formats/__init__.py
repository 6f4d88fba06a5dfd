"""Reading and writing volumes: one module a file format, found by suffix.

A new format is one module with ``read(path) -> (samples, geometry)`` and, where it can,
``write(volume, path)``, and one row of `FORMATS`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import ArrayLike, DTypeLike

from clvol.checks import as_path
from clvol.errors import DataError, FormatError, GeometryError, OptionError
from clvol.files import staged
from clvol.formats import dicom, metaimage, nifti, npy, nrrd, raw, tiff
from clvol.formats._files import Reader, Writer, foreign_errors
from clvol.volume import Volume, as_volume

__all__ = ["FORMATS", "WRITTEN", "Format", "read", "write"]


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name : str
        Its name for users.
    suffixes : tuple of str
        Endings of file names, in lower case; empty for a folder of files.
    read : callable
        Gives the samples and what the file says of their geometry.
    write : callable or None
        None where the format is only read.
    options : frozenset of str
        Arguments of `clvol.read` that are for this format.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Reader
    write: Writer | None = None
    options: frozenset[str] = frozenset()


FORMATS = (
    Format("NumPy array, no geometry", (".npy",), npy.read, npy.write),
    Format("NumPy archive", (".npz",), npy.read_archive, npy.write_archive),
    Format("NIfTI", (".nii", ".nii.gz"), nifti.read, nifti.write),
    Format("NRRD", (".nrrd", ".nhdr"), nrrd.read, nrrd.write),
    Format("MetaImage", (".mha", ".mhd"), metaimage.read, metaimage.write),
    Format("TIFF stack", (".tif", ".tiff"), tiff.read, tiff.write),
    Format("raw samples", (".raw", ".bin"), raw.read, None, frozenset({"shape", "dtype", "byte_order", "offset"})),
    Format("DICOM folder", (), dicom.read, None, frozenset({"series"})),
)

WRITTEN = tuple(suffix for f in FORMATS if f.write for suffix in f.suffixes)
"""Suffixes of the files that `write` writes."""


def read(
    path: str | os.PathLike[str],
    *,
    shape: Sequence[int] | None = None,
    dtype: DTypeLike | None = None,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    byte_order: str | None = None,
    offset: int = 0,
    series: str | None = None,
) -> Volume:
    """Read a volume (or image) from a file, or from a folder of DICOM slices.

    Parameters
    ----------
    path : path-like
        ``.npy .npz .nii .nii.gz .nrrd .nhdr .mha .mhd .tif .tiff .raw .bin``, in upper or lower
        case, or a folder with one series of DICOM files.
    shape : sequence of int, optional
        Raw files only, and needed there: samples along the axes of the array, (nz, ny, nx) or
        (ny, nx).
    dtype : dtype-like, optional
        Raw files only, and needed there: type of the samples.
    spacing, origin, direction : optional
        As of `Volume`, in place of what the file says; any format.
    byte_order : {"little", "big"}, optional
        Raw files only: overrides the byte order of `dtype`.
    offset : int, optional
        Raw files only: bytes before the first sample.
    series : str, optional
        DICOM folders only: the series to read, where there are several.

    Returns
    -------
    Volume
        Medical formats: in ITK's LPS frame, in mm (NRRD and MetaImage: in the unit of the header, if
        it has one). Samples that the header scales are float64. NIfTI files are read as nibabel
        reads them: placed by the sform, else the qform, else the spacing about the middle. TIFF: in
        the unit of the file. 4-D files are accepted if the last axis has one sample.

    Raises
    ------
    FormatError
        The file is missing, of no known format, damaged, or shorter than its header says.
    DataError
        The file holds channels, times, complex numbers or objects.
    GeometryError
        The file's geometry is invalid or unknown; `spacing`, `origin` or `direction` mend it.
    OptionError
        An argument is invalid, or is not for this format.
    MissingDependencyError
        The format needs ``clvol[medical]`` or ``clvol[microscopy]``.
    MemoryError
        The file is sound but does not fit into memory.

    Examples
    --------
    >>> volume = clvol.read("head.nii.gz")
    >>> volume = clvol.read("engine.raw", shape=(128, 256, 256), dtype="uint8", spacing=(1, 1, 2))
    """
    path = as_path(path)
    with foreign_errors(f"read {path}"):
        if not path.exists():
            raise FormatError(f"cannot read {path}: there is no such file or folder")
        if not path.is_dir() and not path.is_file():
            raise FormatError(f"cannot read {path}: it is neither a file nor a folder")
    chosen = next(f for f in FORMATS if not f.suffixes) if path.is_dir() else _by_suffix(path)[0]
    given = {"shape": shape, "dtype": dtype, "byte_order": byte_order, "offset": offset or None, "series": series}
    options = {name: value for name, value in given.items() if value is not None}
    for name in options:
        if name not in chosen.options:
            where = next(f.name for f in FORMATS if name in f.options)
            raise OptionError(f"{name} is only for: {where}; {path} is read as: {chosen.name}")
    replaced = {"spacing": spacing, "origin": origin, "direction": direction}
    with foreign_errors(f"read {path}"):
        data, geometry = chosen.read(path, **options)
        geometry |= {name: value for name, value in replaced.items() if value is not None}
        try:
            return Volume(data, **geometry)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error
        except GeometryError as error:
            mend = "spacing=, origin= or direction= replace what the file says"
            raise GeometryError(f"{path}: {error}; {mend}") from error


def write(volume: Volume | ArrayLike, path: str | os.PathLike[str]) -> None:
    """Write a volume (or image) to a file.

    The file appears when it is complete: on any failure, what was at `path` is left as it was.
    Nothing is lost silently. What a format cannot hold is refused; boolean samples become
    uint8 and float16 becomes float32 where the format has no such type.

    Parameters
    ----------
    volume : Volume or array-like
        What to write.
    path : path-like
        ``.npz``: everything, exactly. ``.nrrd .nhdr .mha .mhd``: everything, in mm. ``.nii .nii.gz``:
        the same, with the geometry in float32. ``.tif .tiff`` (OME): spacing and units. ``.npy``:
        samples only. ``.nhdr`` and ``.mhd`` put the samples beside the header, into a ``.raw`` file.

    Raises
    ------
    FormatError
        The suffix is of no format that is written, the format cannot hold the volume, or
        writing failed.
    MissingDependencyError
        The format needs ``clvol[medical]`` or ``clvol[microscopy]``.
    """
    volume, path = as_volume(volume), as_path(path)
    chosen, suffix = _by_suffix(path)
    if chosen.write is None:
        raise FormatError(
            f"cannot write {path}: a {suffix} file does not say how its samples are arranged; .mhd or .nhdr writes "
            "a .raw file and a header that does"
        )
    with foreign_errors(f"write {path}"), staged(path, suffix) as file:
        chosen.write(volume, file)


def _by_suffix(path: Path) -> tuple[Format, str]:
    """The format of a file name and its suffix, the longest that fits, as in .nii.gz."""
    name = path.name.lower()
    found = [(suffix, row) for row in FORMATS for suffix in row.suffixes if name.endswith(suffix)]
    if not found:
        known = " ".join(suffix for row in FORMATS for suffix in row.suffixes)
        raise FormatError(f"the suffix of a file must be one of {known} (or a folder of DICOM slices); got {path}")
    suffix, row = max(found, key=lambda pair: len(pair[0]))
    return row, suffix
