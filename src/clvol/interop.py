"""Reading other libraries' objects: SimpleITK images, nibabel images, and whatever NumPy can read."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clvol.errors import DataError, GeometryError, MissingDependencyError

__all__ = ["Content", "from_nibabel", "from_simpleitk", "read_array", "simpleitk"]

Content: TypeAlias = tuple[NDArray[Any], dict[str, Any]]
"""Samples [z, y, x], and those keyword arguments of `Volume` that their source knows: spacing, origin, direction, units."""


@runtime_checkable
class _Gridded(Protocol):
    """What a `clvol.Volume` has; the class itself stands on this module."""

    data: NDArray[Any]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    direction: NDArray[np.float64]
    units: str


def read_array(source: Any) -> Content:
    """The samples of `source`, and the geometry that its kind of object carries.

    Raises
    ------
    DataError
        Ragged or masked data, several values per voxel, or a number of axes that the kind of object does not allow.
    GeometryError
        The affine of a nibabel image is singular or not finite.
    """
    if hasattr(source, "GetSpacing") and hasattr(source, "GetDirection"):
        return from_simpleitk(source)
    if hasattr(source, "affine") and hasattr(source, "dataobj"):
        return from_nibabel(source)
    if isinstance(source, _Gridded):
        return np.asarray(source.data), {name: getattr(source, name) for name in ("spacing", "origin", "direction", "units")}
    if np.ma.is_masked(source):
        raise DataError("data must have no masked element; replace them with .filled(value) of the masked array")
    try:
        return np.asarray(source), {}
    except (TypeError, ValueError) as error:
        raise DataError(f"data must be a regular array of numbers: {error}") from None


def from_simpleitk(image: Any, units: str = "") -> Content:
    """Samples, geometry and `units` of a SimpleITK image, without trailing axes of one sample.

    The rule for units: an image in memory has none, because SimpleITK keeps none. A reader of files passes the unit that
    its format or header fixes (millimetres for NIfTI, MetaImage and DICOM).

    Raises
    ------
    DataError
        Several values per voxel, or more than three axes.
    """
    rank, channels, size = image.GetDimension(), image.GetNumberOfComponentsPerPixel(), image.GetSize()
    if channels != 1:
        raise DataError(f"data must have one value per voxel; got {channels}: split the image into its channels")
    if any(n != 1 for n in size[3:]):
        raise DataError(f"data must have 2 or 3 axes; got {size} samples: split the image into its frames")
    d = min(rank, 3)
    data = simpleitk().GetArrayFromImage(image)  # np.asarray would give a flat float64 array
    geometry = {
        "spacing": image.GetSpacing()[:d],
        "origin": image.GetOrigin()[:d],
        "direction": np.reshape(image.GetDirection(), (rank, rank))[:d, :d],
        "units": units,
    }
    return data.reshape(data.shape[rank - d :]), geometry


def from_nibabel(image: Any) -> Content:
    """Samples, geometry and millimetres of a nibabel image: its arrays are [x, y, z] in a RAS world, ours [z, y, x] in LPS.

    Raises
    ------
    DataError
        A number of axes other than 3.
    GeometryError
        The affine is singular or not finite.
    """
    data = np.asanyarray(image.dataobj)
    if data.ndim != 3:
        raise DataError(f"data must have 3 axes; got a nibabel image of shape {data.shape}")
    matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.asarray(image.affine, dtype=np.float64)
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or (spacing == 0).any():
        raise GeometryError(f"the image's affine must be finite and not singular; got {image.affine!r}")
    return data.T, {"spacing": spacing, "origin": matrix[:3, 3], "direction": matrix[:3, :3] / spacing, "units": "mm"}


def simpleitk() -> Any:
    """The SimpleITK module; its import is slow and waits until it is needed.

    Raises
    ------
    MissingDependencyError
        SimpleITK is not installed.
    """
    try:
        import SimpleITK
    except ImportError as error:
        raise MissingDependencyError("medical files need SimpleITK: pip install clvol[medical]") from error
    return SimpleITK
