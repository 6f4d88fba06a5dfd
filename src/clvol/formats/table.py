"""The table of file formats: one row each, found by suffix, by what a file holds, or by what a folder holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any

from clvol.base.errors import FormatError, OptionError
from clvol.formats import (
    analyze,
    bioio,
    dicom,
    hdf5,
    imaris,
    metaimage,
    mgz,
    minc,
    mrc,
    netcdf,
    nifti,
    npy,
    nrrd,
    raw,
    slices,
    tiff,
    vti,
    vtk,
    zarr,
)
from clvol.formats._choice import Series
from clvol.formats._errors import foreign_errors
from clvol.formats._files import Reader, Writer
from clvol.interop.kinds import Content

__all__ = ["FORMATS", "WRITTEN", "Format", "by_suffix", "format_of", "options_of"]


@dataclass(frozen=True)
class Format:
    """A file format: the functions of its module.

    Parameters
    ----------
    name : str
        Shown to users.
    suffixes : tuple of str
        Endings of file names, in lower case; empty if the format is recognised by content.
    read : callable
        Returns the samples and their geometry. Its arguments are the path; `choose`, if a file may hold several volumes; and the
        format's options. It calls `choose`, a `Choice`, with the file's name and `Leading` axes, loads the samples of the resulting
        `Pick`, and adds its `about` to the geometry.
    write : callable or None
        Writes a `Volume` or `Volumes`. None: read only.
    lazily : callable or None
        As `read`, but returns a list of sizes, the largest first, each with a `Window` of its samples; an empty list if this file
        cannot be read in parts. None: no file can.
    series : callable or None
        Lists the images of a file or folder, as a tuple of `Series`, if ``series=`` chooses one.
    file, folder : callable or None
        Recognise a file by its content, where its suffix is unknown or that of another format too; or a folder.
    below : callable or None
        Recognise a folder by the folders below it, where its own files are of no format.
    native : tuple of str
        Modules with native code that read it: in another process, which imports them, unless the file is trusted. Empty: Python
        and NumPy read it in this process.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Reader
    write: Writer | None = None
    lazily: Callable[..., list[Content]] | None = None
    series: Callable[[Path], tuple[Series, ...]] | None = None
    file: Callable[[Path], bool] | None = None
    folder: Callable[[Path], bool] | None = None
    below: Callable[[Path], bool] | None = None
    native: tuple[str, ...] = ()

    @property
    def several(self) -> bool:
        """Whether a file may hold more than one volume."""
        return "choose" in signature(self.read).parameters

    @property
    def options(self) -> frozenset[str]:
        """Arguments of `clvol.read` for this format."""
        return frozenset(signature(self.read).parameters) - {"path", "choose"}


def _of(module: ModuleType, name: str, *suffixes: str, **others: Any) -> Format:
    """The format of a module whose functions are named as the fields."""
    own = {field: getattr(module, field) for field in ("read", "write", "lazily", "series") if hasattr(module, field)}
    return Format(name, suffixes, **own | others)


_ITK = ("SimpleITK",)
_DICOM = ("pydicom.pixels", *_ITK)
_PILLOW = ("imageio.v3", "PIL.Image")

FORMATS = (
    _of(npy, "NumPy array, no geometry", ".npy"),
    Format("NumPy archive", (".npz",), npy.read_archive, npy.write_archive),
    _of(nifti, "NIfTI", ".nii", ".nii.gz"),
    Format("NIfTI in two files", analyze.SUFFIXES, nifti.read_pair, lazily=nifti.lazily_pair),
    _of(analyze, "Analyze 7.5", *analyze.SUFFIXES, file=analyze.is_file, native=("nibabel", "scipy.io")),
    _of(nrrd, "NRRD", ".nrrd", ".nhdr", native=_ITK),
    _of(metaimage, "MetaImage", ".mha", ".mhd", native=_ITK),
    _of(mgz, "FreeSurfer MGH", ".mgh", ".mgz"),
    _of(mrc, "MRC", *(f".{kind}{packed}" for kind in ("mrc", "mrcs", "map", "ccp4") for packed in ("", ".gz")), file=mrc.is_file),
    _of(zarr, "Zarr", ".zarr.zip", ".ozx", ".zip", folder=zarr.is_one, native=("zarr",)),
    Format(
        "DICOM",
        dicom.SUFFIXES,
        dicom.read,
        series=dicom.series_of,
        file=dicom.is_file,
        folder=dicom.is_folder,
        below=dicom.is_above,
        native=_DICOM,
    ),
    _of(tiff, "TIFF stack", ".tif", ".tiff", native=("tifffile",)),
    _of(minc, "MINC", ".mnc", file=minc.is_file, native=("h5py",)),
    _of(hdf5, "HDF5", ".h5", ".hdf5", ".hdf", ".he5", ".nc", ".nc4", ".vtkhdf", file=hdf5.is_file, native=("h5py",)),
    _of(netcdf, "netCDF-3", ".nc", ".cdf", file=netcdf.is_file),
    _of(imaris, "Imaris", ".ims", native=("h5py",)),
    _of(vti, "VTK image data", ".vti", native=("vtkmodules.vtkIOCore",)),
    _of(vtk, "VTK legacy", ".vtk", file=vtk.is_file),
    _of(bioio, "microscope makers' files", *bioio.SUFFIXES, native=("bioio",)),
    _of(slices, "image", *slices.SUFFIXES, native=_PILLOW),
    Format("folder of image slices", (), slices.read_folder, folder=slices.are_in, native=(*_PILLOW, "tifffile")),
    _of(raw, "raw samples", ".raw", ".bin"),
)

_FOLDERS = "DICOM files, itself or in folders below it, image slices (.tif .png .jpg .bmp) or a Zarr array or group"
_SAMPLED = "clvol.Volume(pyvista.ImageData(...).sample(pyvista.read(path)))"
_ROUTES = {
    "clvol.Volume(nibabel.load(path))": ".par .rec .head .brik .brik.gz .nii.bz2 .nii.zst .img.bz2 .mnc.gz .mgh.gz",
    "clvol.Volume(SimpleITK.ReadImage(path))": ".gipl .gipl.gz",
    "clvol.Volume(pyvista.read(path))": ".pvti .slc",
    _SAMPLED: ".vtr .vts .vtu .vtp .pvtr .pvts .pvtu .pvtp .ply .stl",
    "clvol.Volume(xarray.open_dataset(path)[name])": ".grib .grb .grib2 .grb2",
}
"""Files that other libraries read, and how their images become volumes."""

_LISTED = 5  # kinds of files that a message lists

WRITTEN = tuple(suffix for f in FORMATS if f.write for suffix in f.suffixes)
"""Suffixes that `write` knows."""


def format_of(path: Path) -> Format:
    """The format of a file by its name, of a folder by its content."""
    with foreign_errors(f"read {path}"):
        if not path.exists():
            raise FormatError(f"cannot read {path}: there is no such file or folder")
        if path.is_dir():
            found = next((f for f in FORMATS if f.folder is not None and f.folder(path)), None)
            found = found or next((f for f in FORMATS if f.below is not None and f.below(path)), None)
            if found is None:
                raise FormatError(f"cannot read {path}: a folder must hold {_FOLDERS}; this one holds {_holdings(path)}")
            return found
        if not path.is_file():
            raise FormatError(f"cannot read {path}: it is neither a file nor a folder")
        named = [row for row in FORMATS if path.name.lower().endswith(row.suffixes)]
        if not named or any(row.file for row in named):  # what a file holds comes before what it is called
            found = next((row for row in FORMATS if row.file is not None and row.file(path)), None)
            if found is not None:
                return found
        return by_suffix(path)[0]


def by_suffix(path: Path, written: bool = False) -> tuple[Format, str]:
    """The format of a file name, and its suffix: the longest match, as .nii.gz."""
    name = path.name.lower()
    rows = [row for row in FORMATS if row.write or not written]
    found = [(suffix, row) for row in FORMATS for suffix in row.suffixes if name.endswith(suffix)]
    if not found:
        known = " ".join(dict.fromkeys(suffix for row in rows for suffix in row.suffixes))
        rule = "write" if written else "read"
        also = "" if written else f"; a folder may hold {_FOLDERS}"
        if not written and (way := next((way for way, ends in _ROUTES.items() if name.endswith(tuple(ends.split()))), "")):
            also = f": {way} reads this one"
        raise FormatError(f"cannot {rule} {path}: its suffix must be one of {known}{also}")
    suffix, row = max(found, key=lambda pair: len(pair[0]))
    return row, suffix


def options_of(chosen: Format, path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are not None; `OptionError` for one that does not apply to this format."""
    options = {name: value for name, value in given.items() if value is not None}
    for name in options:
        if name not in chosen.options:
            having = ", ".join(f.name for f in FORMATS if name in f.options)
            raise OptionError(f"{name} is only for: {having}; {path} is read as: {chosen.name}")
    return options


def _holdings(path: Path) -> str:
    """A summary of a folder for messages."""
    entries = [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    folders = sorted(entry.name for entry in entries if entry.is_dir())
    kinds = Counter(entry.suffix.lower() or "without a suffix" for entry in entries if not entry.is_dir())
    parts = [f"{n} file{'s' if n > 1 else ''} {kind}" for kind, n in kinds.most_common(_LISTED)]
    if len(kinds) > _LISTED:
        parts.append("others")
    if folders:
        names = ", ".join(folders[:_LISTED]) + (", …" if len(folders) > _LISTED else "")
        parts.append(f"{len(folders)} folder{'s' if len(folders) > 1 else ''} ({names}): give one of them")
    return ", ".join(parts) or "nothing"
