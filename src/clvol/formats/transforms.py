"""Transforms written by registration programs: ITK's transform files, and images of displacements."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clvol.base.checks import as_path
from clvol.base.errors import FormatError
from clvol.formats import Limits, allowed, called
from clvol.formats._errors import foreign_errors
from clvol.formats._itk import information, quiet, reason
from clvol.formats.guarded.limits import announce
from clvol.interop.itk import simpleitk
from clvol.volume.transform import AffineTransform, BSplineTransform, DisplacementField, Transform, displacements_of, from_simpleitk

__all__ = ["read_transform"]

_TRANSFORMS = (".tfm", ".txt", ".h5", ".hdf5", ".hdf", ".mat", ".xfm")
_IMAGES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")


_UNPACKED = 20  # bytes in memory per byte of a file, at most: a displacement of 0 takes two letters and eight bytes


def read_transform(path: str | os.PathLike[str], *, trusted: bool = False, limits: Limits | None = None) -> list[Transform]:
    """Read a transform from a file that ITK, SimpleITK, elastix or ANTs wrote, or an image of displacements.

    SimpleITK reads them (``pip install clvol[medical]``).

    Parameters
    ----------
    path : path-like
        ``.tfm .txt .h5 .hdf5 .hdf .mat .xfm``: a transform, composite or not. ``.nii .nii.gz .nrrd .nhdr .mha .mhd``: an image
        with a displacement per voxel, in ITK's LPS world and in mm; it is interpolated linearly.
    trusted, limits : optional
        As of `clvol.read`: untrusted files are read in a child process.

    Returns
    -------
    list of transforms
        As `transform=` of `clvol.resample` takes it: in ITK's order, the last one is applied first.

    Raises
    ------
    FormatError
        The file is missing, of no known format, or damaged.
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
            announce(file.name, _UNPACKED * file.stat().st_size)
            return [_taken_apart(one) for one in from_simpleitk(sitk.ReadTransform(str(file)))]
        reader = information(file)
        announce(file.name, math.prod(reader.GetSize()) * reader.GetNumberOfComponents() * 8)
        return [_taken_apart(displacements_of(reader.Execute()))]


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
