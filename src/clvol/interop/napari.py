"""Layers of napari, read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.errors import DataError, GeometryError
from clvol.base.frames import affine_parts
from clvol.base.units import axes_unit
from clvol.interop.kinds import Kind, leading_axes

__all__ = ["NAPARI"]

_MIXED = 1e-9  # of a matrix's largest element: rounding in products of matrices


def _data(layer: Any) -> Any:
    """The samples; those of the first of several sizes, to which the layer's coordinates refer."""
    if not (hasattr(layer, "multiscale") and hasattr(layer, "rendering")):
        raise DataError(f"a layer of napari must be one of Image or Labels; got {type(layer).__name__}")
    return layer.data[0] if layer.multiscale else layer.data


def _shape(layer: Any) -> tuple[int, ...]:
    shape = tuple(int(n) for n in _data(layer).shape)
    shape = shape[:-1] if getattr(layer, "rgb", False) else shape
    return shape[-3:]


def _describe(layer: Any) -> dict[str, Any]:
    """The layer's transform (scale, translate, rotate, shear and affine in one) as a geometry, its look and its axes."""
    rgb = bool(getattr(layer, "rgb", False))
    sizes = tuple(int(n) for n in _data(layer).shape)
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
        "units": axes_unit([str(unit) for unit in getattr(layer, "units", ("",) * rank)][lead:]),
        "space": "image",
        "name": str(layer.name),
    }
    limits = getattr(layer, "contrast_limits", None)
    if hasattr(layer, "brush_size"):  # layers of labels only
        about["labels"] = True
    elif limits is not None and limits[0] < limits[1] and not rgb:
        about["clim"] = (float(limits[0]), float(limits[1]))
        if (color := _color(layer)) is not None:
            about["color"] = color
    labels = [str(name) for name in getattr(layer, "axis_labels", ("",) * rank)][:lead]
    axes, counts = leading_axes(labels, sizes[:lead], "a layer of napari")
    if rgb:
        axes, counts = (*axes, "channel"), (*counts, channels)
    if axes:
        about["leading"] = {"axes": axes, "counts": counts, "rgb": rgb}
    return about


def _color(layer: Any) -> tuple[float, float, float] | None:
    """The colour of a colour map from black to one colour; None for greys and other maps."""
    colors = np.asarray(getattr(getattr(layer, "colormap", None), "colors", np.empty(0)), np.float64)
    if colors.shape != (2, 4) or colors[0, :3].any() or np.ptp(colors[1, :3]) == 0:
        return None
    return float(colors[1, 0]), float(colors[1, 1]), float(colors[1, 2])


def _samples(layer: Any) -> NDArray[Any]:
    data = as_array(_data(layer))
    return np.moveaxis(data, -1, max(0, data.ndim - 4)) if getattr(layer, "rgb", False) else data


NAPARI = Kind(
    lambda source: hasattr(source, "data_to_world") and hasattr(source, "world_to_data") and hasattr(source, "translate"),
    _describe,
    _shape,
    _samples,
)
