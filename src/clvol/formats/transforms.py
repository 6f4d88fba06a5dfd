"""Transforms written by registration programs: ITK's and MNI's transform files, and images of displacements."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.checks import as_path, warn
from clvol.base.errors import FormatError, OptionError
from clvol.base.frames import flipped
from clvol.formats import Limits, allowed, called
from clvol.formats._errors import foreign_errors
from clvol.formats._itk import information, quiet, reason
from clvol.formats.guarded.limits import announce
from clvol.interop.itk import simpleitk
from clvol.volume.transform import AffineTransform, BSplineTransform, DisplacementField, Transform, displacements_of, from_simpleitk

__all__ = ["read_transform"]

_TRANSFORMS = (".tfm", ".txt", ".h5", ".hdf5", ".hdf", ".mat", ".xfm")
_IMAGES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")


_MATRIX = (9, 12, 16)  # numbers in a text file that is nothing but a matrix: 3 × 3, 3 × 4, 4 × 4
_LONGEST = 4096  # bytes of such a file
_OF_MATLAB = b"MATLAB "  # the first bytes of a .mat file later than MATLAB 4, which is ITK's
_ITK_FLIPS = 6  # the version from which ITK itself converts .xfm files to LPS
_OF_ITK = "%ITK-XFM writer"  # the comment in an .xfm file
_UNPACKED = 20  # bytes in memory per byte of a file, at most: a displacement of 0 takes two letters and eight bytes


def read_transform(path: str | os.PathLike[str], *, trusted: bool = False, limits: Limits | None = None) -> list[Transform]:
    """Read a transform from a file that ITK, SimpleITK, elastix or ANTs wrote, or an image of displacements.

    SimpleITK reads them (``pip install "clvol[medical]"``).

    Parameters
    ----------
    path : path-like
        ``.tfm .txt .h5 .hdf5 .hdf .mat``: a transform of ITK, composite or not. ``.xfm``: one of MNI, whose numbers are in RAS;
        it is converted to LPS. ``.nii .nii.gz .nrrd .nhdr .mha .mhd``: an image with a displacement per voxel, in ITK's LPS world
        and in mm; it is interpolated linearly.
    trusted, limits : optional
        As of `clvol.read`: untrusted files are read in a child process.

    Returns
    -------
    list of transforms
        As `transform=` of `clvol.resample` takes it: in ITK's order, the last one is applied first.

    Warns
    -----
    ClvolWarning
        ITK wrote an ``.xfm`` file: up to version 5 it did so in LPS, and the numbers are taken as they are.

    Raises
    ------
    FormatError
        The file is missing, of no known format, or damaged; or it is a text matrix, as FSL's FLIRT writes.
    OptionError
        The kind of a transform is not supported; see `clvol.volume.transform.from_simpleitk`.
    DataError
        An image holds no displacements, or values that are not finite.
    GeometryError
        A matrix is singular.
    MissingDependencyError
        SimpleITK is not installed.
    """
    file = as_path(path)
    name = file.name.lower()
    if not name.endswith(_TRANSFORMS + _IMAGES):
        known = " ".join(_TRANSFORMS + _IMAGES)
        raise FormatError(f"the suffix of a transform must be one of {known}; got {file}")
    if not file.is_file():
        raise FormatError(f"cannot read {file}: there is no such file")
    parts = called("transforms", ("SimpleITK",), file, allowed(trusted, limits), _parts, file)
    return [_KINDS[str(kind)](*numbers) for kind, *numbers in parts]


def _parts(file: Path) -> list[tuple[Any, ...]]:
    """Kind and parameters of each transform."""
    sitk = simpleitk()
    with quiet(), foreign_errors(f"read {file}", reason):
        if file.name.lower().endswith(_TRANSFORMS):
            _require_transform(file)
            announce(file.name, _UNPACKED * file.stat().st_size)
            chain = from_simpleitk(sitk.ReadTransform(str(file)))
            if file.suffix.lower() == ".xfm" and sitk.Version.ITKMajorVersion() < _ITK_FLIPS and not _is_of_itk(file):
                chain = [_from_ras(file, one) for one in chain]
            return [_taken_apart(one) for one in chain]
        reader = information(file)
        announce(file.name, math.prod(reader.GetSize()) * reader.GetNumberOfComponents() * 8)
        return [_taken_apart(displacements_of(reader.Execute()))]


def _require_transform(file: Path) -> None:
    """Raise for files of other programs with the suffix of ITK's: ITK would ask for all memory, or say nothing of use."""
    with file.open("rb") as stream:
        head = stream.read(_LONGEST + 1)
    if file.suffix.lower() == ".mat" and head.startswith(_OF_MATLAB):
        version = head[len(_OF_MATLAB) :][:3].decode("ascii", "replace")
        raise FormatError(
            f"{file.name} must be of MATLAB 4, as ITK's transforms are; it is of MATLAB {version}, as SPM's: scipy.io.loadmat or "
            "h5py reads it, and clvol.AffineTransform takes a matrix of the world"
        )
    try:
        numbers = [float(word) for word in head.replace(b",", b" ").split()]
    except ValueError:
        return
    if len(head) <= _LONGEST and len(numbers) in _MATRIX:
        raise FormatError(
            f"{file.name} must be a transform of ITK or MNI; it is a text matrix of {len(numbers)} numbers, as FLIRT of FSL "
            "writes. FLIRT's maps voxels of one image to those of another, times their spacing, and is a map of the world only "
            "with both images: c3d_affine_tool -fsl2ras -oitk converts it. If it is a matrix of the LPS world, "
            "clvol.AffineTransform.from_homogeneous(numpy.loadtxt(file)) is the transform"
        )


def _is_of_itk(file: Path) -> bool:
    """Whether ITK wrote an .xfm file, with a warning: ITK 5 writes LPS there, ITK 6 RAS, and nothing in the file says which."""
    with file.open(encoding="utf-8", errors="replace") as stream:
        found = _OF_ITK in stream.read(_LONGEST)
    if found:
        warn(
            f"{file.name} was written by ITK, which up to version 5 writes its LPS numbers into files whose format is RAS; they "
            "were taken for LPS: if they are RAS, remove the comment 'ITK-XFM writer'"
        )
    return found


def _from_ras(file: Path, one: Transform) -> Transform:
    """The same map, in LPS."""
    if isinstance(one, AffineTransform):
        return AffineTransform(flipped(flipped(one.matrix).T).T, flipped(one.offset))
    if not isinstance(one, DisplacementField):
        raise OptionError(f"{file.name} must hold linear transforms and displacements; it holds a {type(one).__name__}")
    grid, values = one.grid, np.asarray(one.displacements, np.float64)
    return DisplacementField(flipped(values), grid.spacing, flipped(np.asarray(grid.origin)).tolist(), flipped(grid.direction.T).T)


def _taken_apart(one: Transform) -> tuple[Any, ...]:
    if isinstance(one, AffineTransform):
        return "affine", one.matrix, one.offset
    grid = one.grid.spacing, one.grid.origin, one.grid.direction
    if isinstance(one, BSplineTransform):
        return "bspline", one.coefficients, *grid, one.filter.degree
    return "displacements", one.displacements, *grid


_KINDS: dict[str, Callable[..., Transform]] = {
    "affine": AffineTransform,
    "bspline": BSplineTransform,
    "displacements": DisplacementField,
}
