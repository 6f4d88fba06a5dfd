"""Image data of VTK and PyVista, read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.errors import DataError
from clvol.interop.kinds import Kind

__all__ = ["VTK"]

_GHOST = "vtkGhostType"  # the array that marks cells of other processes


def _scalars(image: Any) -> tuple[Any, bool]:
    """The active array, or the only one, and whether its values are those of cells."""
    if not (hasattr(image, "GetDirectionMatrix") and hasattr(image, "GetExtent")):
        raise DataError(
            f"data of VTK must be image data, a uniform grid; got {type(image).__name__}: resample it onto a pyvista.ImageData, "
            "or with vtkResampleToImage"
        )
    parts = ((image.GetPointData(), False), (image.GetCellData(), True))
    active = [(part.GetScalars(), cells) for part, cells in parts if part.GetScalars() is not None]
    if len(active) == 2 and (info := getattr(image, "active_scalars_info", None)) is not None:  # PyVista has one for both
        active = active[::-1] if getattr(info.association, "name", "") == "CELL" else active
    if active:
        return active[0]
    found = [
        (array, cells)
        for part, cells in parts
        for array in map(part.GetArray, range(part.GetNumberOfArrays()))
        if array is not None and array.GetName() != _GHOST
    ]
    if len(found) != 1:
        names = ", ".join(str(array.GetName()) for array, _ in found) or "none"
        raise DataError(f"image data must have active scalars, or a single array; its arrays are {names}: SetActiveScalars(name)")
    return found[0]


def _shape(image: Any) -> tuple[int, ...]:
    """Samples along z, y and x; cells have one sample along an axis of one point."""
    extent, (_, cells) = image.GetExtent(), _scalars(image)
    points = [int(high) - int(low) + 1 for low, high in zip(extent[::2], extent[1::2], strict=True)][::-1]
    return tuple(max(1, n - 1) if cells else n for n in points)


def _describe(image: Any) -> dict[str, Any]:
    array, cells = _scalars(image)
    matrix = image.GetDirectionMatrix()
    direction = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    spacing, low = np.array(image.GetSpacing()), np.array(image.GetExtent()[::2])
    several = np.array(image.GetExtent()[1::2]) > low
    first = low + (0.5 * several if cells else 0.0)  # the centres of cells
    about: dict[str, Any] = {
        "spacing": spacing,
        "origin": np.array(image.GetOrigin()) + direction @ (first * spacing),
        "direction": direction,
    }
    if array.GetName():
        about["name"] = str(array.GetName())
    if (channels := int(array.GetNumberOfComponents())) > 1:
        rgb = array.GetDataTypeAsString() == "unsigned char" and channels in (3, 4)
        vector = array.GetDataTypeAsString() in ("float", "double") and channels in (2, 3)
        about["leading"] = {"axes": ("channel",), "counts": (channels,), "rgb": rgb, "vector": vector}
        names = tuple(str(array.GetComponentName(i) or "") for i in range(channels))
        if all(names):
            about["leading"]["names"] = {"channel": names}
    return about


def _samples(image: Any) -> NDArray[Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy  # installed, as the image exists

    array, _ = _scalars(image)
    shape = _shape(image)
    values = as_array(vtk_to_numpy(array))  # type: ignore[no-untyped-call]  # shares the memory, and keeps the array alive
    if len(values) != math.prod(shape):
        raise DataError(
            f"image data must have one value for each of {math.prod(shape)} samples; {array.GetName()} has {len(values)}"
        )
    if values.ndim == 1:
        return values.reshape(shape)
    return np.moveaxis(values.reshape(*shape, -1), -1, 0)


VTK = Kind(lambda source: hasattr(source, "GetPointData") and hasattr(source, "GetCellData"), _describe, _shape, _samples)
