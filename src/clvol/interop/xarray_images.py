"""Arrays of xarray: those that `to_xarray` makes, and others whose dimensions are [..., z, y, x]."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.errors import GeometryError, MissingDependencyError
from clvol.base.units import axes_unit
from clvol.interop.kinds import Kind, leading_axes

if TYPE_CHECKING:
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Leading

__all__ = ["LABELLED", "OWN", "to_xarray"]

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
        raise MissingDependencyError("to_xarray needs xarray: pip install clvol[xarray]") from error
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


def _is_own(array: Any) -> bool:
    """Whether `to_xarray` made it, or what it was computed from, and its last dimensions are y and x."""
    attrs = getattr(array, "attrs", None)
    return isinstance(attrs, Mapping) and attrs.keys() >= _PLACE and getattr(array, "dims", ())[-2:] == ("y", "x")


def _describe_own(array: Any) -> dict[str, Any]:
    """Arguments of `Volume`; coordinates count before attributes, which a slice of the array keeps as they were.

    Raises
    ------
    GeometryError
        Coordinates that are not evenly spaced; or a slice without coordinates, whose place is not known.
    """
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
    return tuple(int(n) for n in array.shape[-3 if array.dims[-3:] == ("z", "y", "x") else -2 :])


OWN = Kind(_is_own, _describe_own, _shape, as_array)


def _is_labelled(source: Any) -> bool:
    """Whether it is an array of xarray whose dimensions are [..., z, y, x]; of transposed ones only the samples are read."""
    if not all(hasattr(source, name) for name in ("dims", "coords", "attrs", "isel", "dtype")):
        return False
    named = [dim for dim in source.dims if dim in ("x", "y", "z")]
    return named == sorted(named, reverse=True)


def _describe_labelled(array: Any) -> dict[str, Any]:
    """Coordinates of the last two or three dimensions are places if they are numbers; other dimensions count from 0."""
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
        about["units"] = axes_unit(units)
    if array.name is not None:
        about["name"] = str(array.name)
    if lead := array.ndim - d:
        axes, counts = leading_axes([str(dim) for dim in array.dims[:lead]], array.shape[:lead], "an array of xarray")
        about["leading"] = {"axes": axes, "counts": counts}
    return about


LABELLED = Kind(_is_labelled, _describe_labelled, lambda array: tuple(int(n) for n in array.shape[-3:]), as_array)
