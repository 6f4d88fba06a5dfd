"""Transforms that registration programs write: ITK's transform files, and images of displacements."""

from __future__ import annotations

import os

from clvol.checks import as_path
from clvol.errors import FormatError
from clvol.foreign import simpleitk
from clvol.formats._files import foreign_errors
from clvol.formats._itk import quiet, reason
from clvol.transform import Transform, displacements_of, from_simpleitk

__all__ = ["read_transform"]

_TRANSFORMS = (".tfm", ".txt", ".h5", ".hdf5", ".hdf", ".mat", ".xfm")
_IMAGES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")


def read_transform(path: str | os.PathLike[str]) -> list[Transform]:
    """Read a transform from a file that ITK, SimpleITK, elastix or ANTs wrote, or an image of displacements.

    SimpleITK reads them (``pip install clvol[medical]``).

    Parameters
    ----------
    path : path-like
        ``.tfm .txt .h5 .hdf5 .hdf .mat .xfm``: a transform, composite or not. ``.nii .nii.gz .nrrd .nhdr .mha .mhd``: an image
        with a displacement in each voxel, in ITK's LPS world and in mm; it is interpolated linearly.

    Returns
    -------
    list of transforms
        As `transform=` of `clvol.resample` takes it: in ITK's order, the last one is applied first.

    Raises
    ------
    FormatError
        The file is missing, of no known format, or damaged.
    OptionError
        It holds a transform of a kind that is not known; see `clvol.transform.from_simpleitk`.
    DataError
        An image is not one of displacements, or holds a value that is not finite.
    GeometryError
        A matrix is singular.
    MissingDependencyError
        SimpleITK is not installed.
    """
    file = as_path(path)
    name, sitk = file.name.lower(), simpleitk()
    if not name.endswith(_TRANSFORMS + _IMAGES):
        known = " ".join(_TRANSFORMS + _IMAGES)
        raise FormatError(f"the suffix of a transform must be one of {known}; got {file}")
    if not file.is_file():
        raise FormatError(f"cannot read {file}: there is no such file")
    with quiet(), foreign_errors(f"read {file}", reason):
        if name.endswith(_TRANSFORMS):
            return from_simpleitk(sitk.ReadTransform(str(file)))
        return [displacements_of(sitk.ReadImage(str(file)))]
