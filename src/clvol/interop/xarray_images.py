"""Arrays of xarray: those that `to_xarray` makes, and others; dimensions that are named as axes may have any order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.axes import AXES, meaning
from clvol.base.errors import GeometryError, MissingDependencyError
from clvol.base.units import axes_unit
from clvol.interop.kinds import Kind, leading_axes

if TYPE_CHECKING:
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Leading

__all__ = ["LABELLED", "OWN", "in_order", "is_labelled", "to_xarray"]

_PLACE = {"size", "spacing", "origin", "direction"}  # attributes of a DataArray that `to_xarray` made
_UNIFORM = 1e-3  # of a step, by which coordinates may be off: float32 ones are off by less


def to_xarray(data: NDArray[Any], grid: Volume, leading: Leading | None = None) -> Any:
    """A DataArray of samples [..., z, y, x], with coordinates in world units where the axes run along the world's.

    The attributes hold the geometry in any case, x first, and what else the volume says of itself.

    Raises
    ------
    MissingDependencyError
        xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise MissingDependencyError('to_xarray needs xarray: pip install "clvol[xarray]"') from error
    d = len(grid.spacing)
    dims = (*(leading.axes if leading else ()), *"zyx"[3 - d :])
    coords: dict[str, Any] = {axis: list(names) for axis, names in (leading.names if leading else {}).items()}
    if not np.any(grid.direction - np.diag(np.diag(grid.direction))):
        for axis, name in enumerate("xyz"[:d]):
            step = grid.direction[axis, axis] * grid.spacing[axis]
            places = grid.origin[axis] + step * np.arange(data.shape[-1 - axis])
            coords[name] = (name, places, {"units": grid.units} if grid.units else {})
    attrs: dict[str, Any] = {
        "size": list(data.shape[: -1 - d : -1]),
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": grid.direction.tolist(),
        "world_units": grid.units,
        "space": grid.space,
    }
    if grid.clim is not None:
        attrs["clim"] = list(grid.clim)
    return xarray.DataArray(data, coords, dims, name=(grid.name or None) if leading is None else None, attrs=attrs)


def in_order(array: Any) -> Any:
    """The array with its dimensions in the order [..., z, y, x], by their names; the unknown are the missing axes, last first.

    An array with two names for one axis is returned as it is.
    """
    axes = [meaning(str(dim)) for dim in array.dims]
    if axes.count("y") > 1 and "z" not in axes:  # beside latitudes, a height lies along z
        axes = ["z" if str(dim).lower() == "height" else axis for dim, axis in zip(array.dims, axes, strict=True)]
    if any(axes.count(axis) > 1 for axis in "xyz"):
        return array
    unknown = [n for n, axis in enumerate(axes) if not axis]
    for axis in "xyz":
        if axis not in axes and unknown:
            axes[unknown.pop()] = axis
    rank = {"z": 1, "y": 2, "x": 3}
    order = sorted(range(len(axes)), key=lambda n: rank.get(axes[n], 0))
    return array if order == sorted(order) else array.transpose(*(array.dims[n] for n in order))


def _samples(array: Any) -> NDArray[Any]:
    return as_array(in_order(array))


def _is_own(array: Any) -> bool:
    """Whether `to_xarray` made it, or what it was computed from, and it has the dimensions y and x."""
    attrs = getattr(array, "attrs", None)
    return isinstance(attrs, Mapping) and attrs.keys() >= _PLACE and {"x", "y"} <= set(getattr(array, "dims", ()))


def _describe_own(array: Any) -> dict[str, Any]:
    """Arguments of `Volume`; coordinates count before attributes, which a slice of the array keeps as they were.

    Raises
    ------
    GeometryError
        Coordinates that are not evenly spaced; or a slice without coordinates, whose place is not known.
    """
    array = in_order(array)
    d = 3 if array.dims[-3:] == ("z", "y", "x") else 2
    attrs = array.attrs
    spacing, origin, direction = (np.array(attrs[name], np.float64) for name in ("spacing", "origin", "direction"))
    size = array.shape[: -1 - d : -1]
    if not all(name in array.coords for name in "xyz"[:d]):
        if tuple(attrs["size"]) != size:
            raise GeometryError(
                f"the array was cut or joined, and nothing says where it lies; it had {attrs['size']} samples, now {size}"
            )
    else:
        spacing, origin, direction = spacing[:d], origin[:d], np.diag(np.sign(np.diag(direction)[:d]))
        for axis, name in enumerate("xyz"[:d]):
            places = np.asarray(array.coords[name], np.float64)
            origin[axis] = places[0]
            if len(steps := np.diff(places)):
                if not np.allclose(steps, steps.mean(), rtol=1e-4, atol=0):
                    raise GeometryError(
                        f"coordinates must be evenly spaced; those of {name} are {steps.min():g} to {steps.max():g} apart"
                    )
                spacing[axis], direction[axis, axis] = abs(steps.mean()), np.sign(steps.mean())
    about: dict[str, Any] = {
        "spacing": spacing,
        "origin": origin,
        "direction": direction,
        "units": attrs.get("world_units", ""),
        "space": attrs.get("space", ""),
    }
    if "clim" in attrs:
        about["clim"] = tuple(attrs["clim"])
    if array.name:
        about["name"] = str(array.name)
    if axes := array.dims[: array.ndim - d]:
        named = {axis: tuple(map(str, array.coords[axis].values)) for axis in axes if axis in array.coords}
        about["leading"] = {"axes": axes, "counts": array.shape[: array.ndim - d], "names": named}
    return about


def _shape(array: Any) -> tuple[int, ...]:
    return tuple(int(n) for n in in_order(array).shape[-3 if "z" in array.dims else -2 :])


OWN = Kind(_is_own, _describe_own, _shape, _samples)


def is_labelled(source: Any) -> bool:
    """Whether it is an array of xarray."""
    return all(hasattr(source, name) for name in ("dims", "coords", "attrs", "isel", "dtype"))


def _dimensions(array: Any) -> int:
    """How many of the last dimensions of an array in order are space: times, channels and the like are not, by their names."""
    return 2 if array.ndim > 2 and meaning(str(array.dims[-3])) in AXES else min(array.ndim, 3)


def _labelled_shape(array: Any) -> tuple[int, ...]:
    array = in_order(array)
    return tuple(int(n) for n in array.shape[-_dimensions(array) :])


def _describe_labelled(array: Any) -> dict[str, Any]:
    """Coordinates of the dimensions of space are places if they are numbers; other dimensions count from 0."""
    array = in_order(array)
    d = _dimensions(array)
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
        about["units"] = axes_unit(units)
    if array.name is not None:
        about["name"] = str(array.name)
    if lead := array.ndim - d:
        axes, counts = leading_axes([str(dim) for dim in array.dims[:lead]], array.shape[:lead], "an array of xarray")
        about["leading"] = {"axes": axes, "counts": counts}
    return about


LABELLED = Kind(is_labelled, _describe_labelled, _labelled_shape, _samples)
