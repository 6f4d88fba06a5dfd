"""Other libraries' images, whatever library they are of."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from clvol.base.arrays import as_array
from clvol.base.errors import DataError
from clvol.interop.itk import ITK, SIMPLEITK
from clvol.interop.kinds import Content, Kind
from clvol.interop.napari import NAPARI
from clvol.interop.nibabel import NIBABEL
from clvol.interop.vtk import VTK
from clvol.interop.xarray_images import LABELLED, OWN, in_order

__all__ = ["is_image", "read_array", "read_grid", "read_several"]

_KINDS = (SIMPLEITK, NIBABEL, OWN, VTK, ITK, NAPARI, LABELLED)
_GRIDDED = ("spacing", "origin", "direction", "units", "data")  # of a `Volume`, whose class imports this module
_VOLUME = ("spacing", "origin", "direction", "units", "space", "name", "color", "clim", "labels", "header")


def _kind_of(source: Any) -> Kind | None:
    if isinstance(source, (np.ndarray, list, tuple)):
        return None
    return next((kind for kind in _KINDS if kind.matches(source)), None)


def is_image(source: Any) -> bool:
    """Whether it is another library's image, of one volume or several."""
    return _kind_of(source) is not None


def read_array(source: Any, *, placed: bool = True) -> Content:
    """The samples of one volume, and what its kind of object says of them.

    Parameters
    ----------
    source : object
    placed : bool
        Whether the geometry is wanted; if not, dimensions of xarray keep their order, and coordinates are not read.

    Raises
    ------
    DataError
        Ragged or masked data, data in the memory of a device, an image that holds several volumes or values per voxel, too
        few axes, or the name of a file.
    GeometryError
        The affine of a nibabel image is singular or not finite, or its unit of length unknown; coordinates of xarray are not
        evenly spaced.
    """
    if isinstance(source, (str, os.PathLike)):
        raise DataError(f"data must be an array, an image or a Volume; got {os.fspath(source)!r}: clvol.read(path) reads a file")
    if (leading := getattr(source, "leading", None)) is not None:
        raise DataError(f"data must be one volume; got Volumes of {leading}: take one, as volumes[0], or each of them in turn")
    kind = _kind_of(source)
    if kind is None or (kind in (LABELLED, OWN) and not placed):
        return _read_other(source)
    about = kind.describe(source)
    if "leading" in about:
        counts = " × ".join(f"{n} {axis}s" for axis, n in zip(about["leading"]["axes"], about["leading"]["counts"], strict=True))
        raise DataError(f"data must be one volume; got an image of {counts}: take one as clvol.Volumes(image)[k]")
    return kind.samples(source), about


def read_several(source: Any) -> Content:
    """As `read_array`, and images that hold several volumes; those have the arguments of `Leading` under the key "leading"."""
    kind = _kind_of(source)
    if kind is LABELLED and len(kind.shape(source)) == source.ndim:  # the first of three dimensions may count volumes
        return _read_other(in_order(source))
    if kind is None:
        return _read_other(source)
    about = kind.describe(source)
    return kind.samples(source), about


def _read_other(source: Any) -> Content:
    """Samples of a volume or of an array."""
    if not isinstance(source, np.ndarray) and all(hasattr(source, name) for name in _GRIDDED):  # `data` of an array of dates raises
        return as_array(source.data), {name: getattr(source, name) for name in _VOLUME if hasattr(source, name)}
    return as_array(source), {}


def read_grid(source: Any) -> Content:
    """As `read_array`, and images that hold several volumes too, with zeros that need no memory in place of the samples."""
    kind = _kind_of(source)
    if kind is None:
        return read_array(source)
    about = kind.describe(source)
    about.pop("leading", None)
    return np.broadcast_to(np.float32(0), kind.shape(source)), about
