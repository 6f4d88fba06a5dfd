"""Images of VTK and PyVista, of ITK's own Python, layers of napari, and labelled arrays of xarray, read with all that they say.

None of these libraries is imported to know their objects: what has their methods is one of them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import DataError, GeometryError
from clvol.foreign import METRES, affine_parts, interleaved

__all__ = ["Kind", "is_labelled", "kind_of"]

_AXES = {"t": "time", "time": "time", "c": "channel", "channel": "channel", "channels": "channel", "p": "position", "s": "position"}
_UNIFORM = 1e-3  # of a step: float32 coordinates are off by less
_MIXED = 1e-9  # of the largest number of a matrix: what is left of zeros when matrices are multiplied
_GHOST = "vtkGhostType"
_LENGTHS = {
    "nanometer": "nm", "nanometre": "nm", "micrometer": "um", "micrometre": "um", "micron": "um", "µm": "um", "μm": "um",
    "millimeter": "mm", "millimetre": "mm", "centimeter": "cm", "centimetre": "cm", "meter": "m", "metre": "m", "in": "inch",
    "pixel": "", "dimensionless": "",
}  # fmt: skip


class Kind(NamedTuple):
    """How one library's images are read.

    Attributes
    ----------
    knows : callable
        Whether an object is one, or one of that library's that is no image, which `says` refuses.
    says : callable
        Those arguments of `Volume` that it knows; those of `Leading` under the key "leading".
    shape : callable
        Samples along z, y, x, or y, x.
    samples : callable
        The array [..., z, y, x].
    """

    knows: Callable[[Any], bool]
    says: Callable[[Any], dict[str, Any]]
    shape: Callable[[Any], tuple[int, ...]]
    samples: Callable[[Any, Callable[[Any], NDArray[Any]]], NDArray[Any]]


def kind_of(source: Any) -> Kind | None:
    """Which of these an object is; None: none of them."""
    if isinstance(source, (np.ndarray, list, tuple)):
        return None
    return next((kind for kind in _KINDS if kind.knows(source)), None)


# -- VTK and PyVista -------------------------------------------------------------------------------------------------


def _is_vtk(source: Any) -> bool:
    return hasattr(source, "GetPointData") and hasattr(source, "GetCellData")


def _scalars(image: Any) -> tuple[Any, bool]:
    """The array of VTK's that programs show, and whether it is one of cells: the active one, else the only one that there is."""
    if not (hasattr(image, "GetDirectionMatrix") and hasattr(image, "GetExtent")):
        raise DataError(
            f"data of VTK must be image data, a uniform grid; got {type(image).__name__}: resample it onto a pyvista.ImageData, "
            "or with vtkResampleToImage"
        )
    parts = ((image.GetPointData(), False), (image.GetCellData(), True))
    active = [(part.GetScalars(), cells) for part, cells in parts if part.GetScalars() is not None]
    if len(active) == 2 and (told := getattr(image, "active_scalars_info", None)) is not None:  # PyVista knows one for both
        active = active[::-1] if getattr(told.association, "name", "") == "CELL" else active
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


def _vtk_shape(image: Any) -> tuple[int, ...]:
    """Samples along z, y and x; an axis of one point has cells all the same."""
    extent, (_, cells) = image.GetExtent(), _scalars(image)
    points = [int(high) - int(low) + 1 for low, high in zip(extent[::2], extent[1::2], strict=True)][::-1]
    return tuple(max(1, n - 1) if cells else n for n in points)


def _vtk_says(image: Any) -> dict[str, Any]:
    array, cells = _scalars(image)
    matrix = image.GetDirectionMatrix()
    direction = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    spacing, low = np.array(image.GetSpacing()), np.array(image.GetExtent()[::2])
    several = np.array(image.GetExtent()[1::2]) > low
    first = low + (0.5 * several if cells else 0.0)  # cells' samples lie in their middles
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


def _vtk_samples(image: Any, as_array: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy  # it is there, as the image is

    array, _ = _scalars(image)
    shape = _vtk_shape(image)
    values = as_array(vtk_to_numpy(array))  # type: ignore[no-untyped-call]  # shares the memory, and keeps the array alive
    if len(values) != math.prod(shape):
        raise DataError(
            f"image data must have one value for each of {math.prod(shape)} samples; {array.GetName()} has {len(values)}"
        )
    if values.ndim == 1:
        return values.reshape(shape)
    return np.moveaxis(values.reshape(*shape, -1), -1, 0)


# -- ITK -------------------------------------------------------------------------------------------------------------


def _is_itk(source: Any) -> bool:
    return hasattr(source, "GetImageDimension") and hasattr(source, "GetBufferedRegion") and hasattr(source, "GetDirection")


def _itk_size(image: Any) -> list[int]:
    size = image.GetBufferedRegion().GetSize()
    return [int(size[i]) for i in range(int(image.GetImageDimension()))]


def _itk_says(image: Any) -> dict[str, Any]:
    """As of SimpleITK's images: lengths in millimetres, in LPS."""
    size = _itk_size(image)
    if 0 in size:
        raise DataError("an image of ITK must be loaded; its buffer is empty: call Update() of the filter that makes it")
    rank, index = len(size), image.GetBufferedRegion().GetIndex()
    if rank < 2:
        raise DataError(f"data must have 2 or 3 axes; got an image of ITK with {rank}")
    d = min(rank, 3)
    spacing = [float(image.GetSpacing()[i]) for i in range(rank)]
    first = image.TransformIndexToPhysicalPoint([int(index[i]) for i in range(rank)])  # a part of an image begins elsewhere
    direction = np.array([[float(image.GetDirection()(i, j)) for j in range(rank)] for i in range(rank)])
    about: dict[str, Any] = {
        "spacing": spacing[:d],
        "origin": [float(first[i]) for i in range(d)],
        "direction": direction[:d, :d],
        "units": "mm",
        "space": "LPS",
    }
    frames, channels = math.prod(size[3:]), int(image.GetNumberOfComponentsPerPixel())
    axes, counts = (("volume",), (frames,)) if frames > 1 else ((), ())
    if channels > 1:
        kind = {"uint8": "8-bit unsigned", "float32": "float", "float64": "float"}.get(np.dtype(image.dtype).name, "")
        about["leading"] = interleaved(channels, kind, d, axes, counts)
    elif axes:
        about["leading"] = {"axes": axes, "counts": counts}
    return about


def _itk_shape(image: Any) -> tuple[int, ...]:
    return tuple(_itk_size(image)[:3][::-1])


def _itk_samples(image: Any, as_array: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    """A copy: ITK's own views of an image do not keep it alive."""
    about, shape = _itk_says(image), _itk_shape(image)
    channels = int(image.GetNumberOfComponentsPerPixel())
    memory.require(math.prod(_itk_size(image)) * channels * np.dtype(image.dtype).itemsize, "a copy of an image of ITK")
    itk = sys.modules.get(type(image).__module__.partition(".")[0])
    data = as_array(image) if itk is None else itk.array_from_image(image)
    if channels > 1:
        data = np.moveaxis(data, -1, data.ndim - 1 - len(shape))
    counts = about["leading"]["counts"] if "leading" in about else ()
    return data.reshape(*counts, *shape)


# -- napari ----------------------------------------------------------------------------------------------------------


def _is_napari(source: Any) -> bool:
    return hasattr(source, "data_to_world") and hasattr(source, "world_to_data") and hasattr(source, "translate")


def _layer_data(layer: Any) -> Any:
    """The samples; of several sizes the first, which the layer's coordinates count."""
    if not (hasattr(layer, "multiscale") and hasattr(layer, "rendering")):
        raise DataError(f"a layer of napari must be one of Image or Labels; got {type(layer).__name__}")
    return layer.data[0] if layer.multiscale else layer.data


def _layer_shape(layer: Any) -> tuple[int, ...]:
    shape = tuple(int(n) for n in _layer_data(layer).shape)
    shape = shape[:-1] if getattr(layer, "rgb", False) else shape
    return shape[-3:]


def _layer_says(layer: Any) -> dict[str, Any]:
    """Where the layer's own coordinates have the samples: scale, translate, rotate, shear and affine in one."""
    rgb = bool(getattr(layer, "rgb", False))
    sizes = tuple(int(n) for n in _layer_data(layer).shape)
    channels, sizes = (sizes[-1], sizes[:-1]) if rgb else (0, sizes)
    rank = len(sizes)
    d = min(rank, 3)
    origin = np.array(layer.data_to_world((0.0,) * rank), np.float64)
    matrix = np.stack([np.array(layer.data_to_world(row), np.float64) - origin for row in np.eye(rank)], axis=1)
    lead = rank - d
    if lead and max(np.abs(matrix[lead:, :lead]).max(), np.abs(matrix[:lead, lead:]).max()) > _MIXED * np.abs(matrix).max():
        raise GeometryError(
            "a layer's volumes must lie at one place; its affine moves them along the axes before: slice the layer's data"
        )
    spacing, _, direction = affine_parts(matrix[lead:, lead:][::-1, ::-1], origin[lead:][::-1])
    about: dict[str, Any] = {
        "spacing": spacing,
        "origin": origin[lead:][::-1],
        "direction": direction,
        "units": _one_unit([str(unit) for unit in getattr(layer, "units", ("",) * rank)][lead:]),
        "space": "image",
        "name": str(layer.name),
    }
    limits = getattr(layer, "contrast_limits", None)
    if hasattr(layer, "brush_size"):  # of labels alone
        about["labels"] = True
    elif limits is not None and limits[0] < limits[1] and not rgb:
        about["window"] = (float(limits[0]), float(limits[1]))
        if (color := _layer_color(layer)) is not None:
            about["color"] = color
    labels = [str(name) for name in getattr(layer, "axis_labels", ("",) * rank)][:lead]
    axes, counts = _leading(labels, sizes[:lead], "a layer of napari")
    if rgb:
        axes, counts = (*axes, "channel"), (*counts, channels)
    if axes:
        about["leading"] = {"axes": axes, "counts": counts, "rgb": rgb}
    return about


def _layer_color(layer: Any) -> tuple[float, float, float] | None:
    """That of a colour map from black to one colour; greys and maps of many colours have none."""
    colors = np.asarray(getattr(getattr(layer, "colormap", None), "colors", np.empty(0)), np.float64)
    if colors.shape != (2, 4) or colors[0, :3].any() or np.ptp(colors[1, :3]) == 0:
        return None
    return float(colors[1, 0]), float(colors[1, 1]), float(colors[1, 2])


def _layer_samples(layer: Any, as_array: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    data = as_array(_layer_data(layer))
    return np.moveaxis(data, -1, max(0, data.ndim - 4)) if getattr(layer, "rgb", False) else data


# -- xarray ----------------------------------------------------------------------------------------------------------


def is_labelled(source: Any) -> bool:
    """Whether it is an array of xarray whose dimensions are [..., z, y, x]; of transposed ones only samples are read."""
    if not all(hasattr(source, name) for name in ("dims", "coords", "attrs", "isel", "dtype")):
        return False
    named = [dim for dim in source.dims if dim in ("x", "y", "z")]
    return named == sorted(named, reverse=True)


def _labelled_says(array: Any) -> dict[str, Any]:
    """Where the coordinates of the last three dimensions, or two, are numbers, they are places; others count from 0."""
    d = min(array.ndim, 3)
    spacing, origin, direction, units = np.ones(d), np.zeros(d), np.eye(d), []
    for axis, dim in enumerate(array.dims[: -1 - d : -1]):
        if dim not in array.coords or array.coords[dim].dtype.kind not in "iuf":
            continue
        places = np.asarray(array.coords[dim].values, np.float64)
        units.append(str(array.coords[dim].attrs.get("units", "")))
        if not np.isfinite(places).all():
            raise GeometryError(f"coordinates must be finite; those of {dim} are not")
        origin[axis] = places[0] if places.size else 0.0
        if places.size < 2:
            continue
        step = (places[-1] - places[0]) / (places.size - 1)
        off = np.abs(places - places[0] - step * np.arange(places.size)).max()
        if step == 0 or off > _UNIFORM * abs(step):
            raise GeometryError(
                f"coordinates must be evenly spaced, to within {_UNIFORM:g} of a step; those of {dim} are "
                f"{np.diff(places).min():g} to {np.diff(places).max():g} apart: array.interp puts the array onto even ones, "
                "array.values has none"
            )
        spacing[axis], direction[axis, axis] = abs(step), math.copysign(1, step)
    about: dict[str, Any] = {"spacing": spacing, "origin": origin, "direction": direction}
    if len(units) == d:
        about["units"] = _one_unit(units)
    if array.name is not None:
        about["name"] = str(array.name)
    if lead := array.ndim - d:
        axes, counts = _leading([str(dim) for dim in array.dims[:lead]], array.shape[:lead], "an array of xarray")
        about["leading"] = {"axes": axes, "counts": counts}
    return about


# -- what they share -------------------------------------------------------------------------------------------------


def _one_unit(units: Sequence[str]) -> str:
    """The unit of all axes by clvol's name; none where they differ and one is no length.

    Raises
    ------
    GeometryError
        The axes measure in different units of length.
    """
    known = {_LENGTHS.get(unit.lower(), unit) for unit in units}
    if len(known) > 1 and known <= METRES.keys():
        raise GeometryError(f"all axes must be in one unit of length; got {', '.join(units)}")
    return known.pop() if len(known) == 1 else ""


def _leading(names: Sequence[str], counts: Sequence[int], what: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """What leading axes count, by their names."""
    axes = tuple(_AXES.get(name.lower(), "volume") for name in names)
    if len(set(axes)) != len(axes):
        raise DataError(f"{what} must have axes before z, y and x that are told apart (time, channel); got {tuple(names)}")
    return axes, tuple(int(n) for n in counts)


_KINDS = (
    Kind(_is_vtk, _vtk_says, _vtk_shape, _vtk_samples),
    Kind(_is_itk, _itk_says, _itk_shape, _itk_samples),
    Kind(_is_napari, _layer_says, _layer_shape, _layer_samples),
    Kind(
        is_labelled, _labelled_says, lambda array: tuple(int(n) for n in array.shape[-3:]), lambda array, as_array: as_array(array)
    ),
)
