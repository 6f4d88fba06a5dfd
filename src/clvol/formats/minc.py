"""MINC 2, which is HDF5, by h5py; and MINC 1, which is netCDF-3, by SciPy.

Source: the MINC 1 programmer's guide and the MINC 2.0 file format reference (en.wikibooks.org/wiki/MINC). Values and geometry equal
nibabel's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, GeometryError
from clvol.base.frames import affine_parts, from_ras
from clvol.base.units import millimetres, one_unit
from clvol.bricks.sliced import Index, Watched, Window
from clvol.formats import hdf5, netcdf
from clvol.formats._choice import Choice
from clvol.formats._files import bytes_at
from clvol.formats._layout import Layout
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content

__all__ = ["is_file", "lazily", "read"]

_SEARCHED = 1 << 16  # bytes of the header that name the format
_COSINES = {"xspace": (1.0, 0.0, 0.0), "yspace": (0.0, 1.0, 0.0), "zspace": (0.0, 0.0, 1.0)}
_LEADING = {"time": "time", "vector_dimension": "channel"}
_ENDS = ("image-min", "image-max")


@dataclass(frozen=True)
class _Image:
    """The image of a file: its samples as stored, its axes, and the values that samples stand for."""

    samples: Window
    axes: tuple[str, ...]
    attrs: Mapping[str, Any]
    of_axes: Mapping[str, Mapping[str, Any]]  # attributes
    ends: Sequence[NDArray[np.float64]]  # values at both ends of the valid range, along the first axes; empty if unknown


def is_file(path: Path) -> bool:
    """Whether a file says that it is MINC."""
    with path.open("rb") as stream:
        head = stream.read(_SEARCHED)
    return b"MINC standard variable" in head if netcdf.is_file(path) else b"minc-2.0" in head and hdf5.is_file(path)


def read(path: Path, choose: Choice) -> Content:
    """The values that the samples of the chosen volumes stand for, and geometry, converted from MINC's RAS to ITK's LPS."""
    data, about = lazily(path, choose)[0]
    announce(path.name, bytes_at(data.shape, (), data.dtype))
    return data[...], about


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand."""
    image = _of_netcdf(path) if netcdf.is_file(path) else _of_hdf5(path)
    space = [axis for axis in image.axes if axis in _COSINES]
    if len(space) != 3 or not set(image.axes) <= {*_COSINES, *_LEADING} or len(image.axes) != len(image.samples.shape):
        raise DataError(f"{path.name} must have the axes xspace, yspace, zspace, and time or vector_dimension; it has {image.axes}")
    names = tuple(_LEADING.get(axis) or "zyx"[space.index(axis)] for axis in image.axes)
    layout = Layout(names, image.samples.shape)
    values, dtype = _values(path.name, image)
    watched = Watched(path, path.name, values)
    data, known = layout.chosen(
        path.name,
        choose,
        lambda index: Window(watched, layout.shape, dtype, image.samples.chunks, index),
        layout.channels_of(image.samples.dtype),
    )
    return [(data, _placed(path.name, [(axis, image.of_axes[axis]) for axis in space[::-1]]) | known)]


def _of_hdf5(path: Path) -> _Image:
    file = hdf5.opened(path)
    root = hdf5.member(file, "minc-2.0")
    group = hdf5.member(hdf5.member(root, "image"), "0")
    image, dimensions = hdf5.member(group, "image"), hdf5.member(root, "dimensions")
    axes = tuple(_text(image.attrs.get("dimorder", "")).split(","))[: image.ndim]
    of_axes = {axis: dict(hdf5.member(dimensions, axis).attrs) for axis in axes}
    ends = [hdf5.loaded(path.name, hdf5.member(group, name)).astype(np.float64) for name in _ENDS if name in group]
    return _Image(hdf5.part_of(path, path.name, image), axes, dict(image.attrs), of_axes, ends)


def _of_netcdf(path: Path) -> _Image:
    variables = netcdf.variables_of(path)
    if "image" not in variables:
        raise FormatError(f"{path.name} must hold the variable 'image', as MINC does; it holds {', '.join(variables)}")
    image = variables["image"]
    samples = image.window()
    if image.dtype.kind in "iu":
        signed = image.dtype.itemsize > 1 if "signtype" not in image.attrs else image.attrs["signtype"] == "signed__"
        samples = samples.mapped(lambda part: part.view(f"{'i' if signed else 'u'}{part.dtype.itemsize}"))
    of_axes = {axis: variables[axis].attrs if axis in variables else {} for axis in image.dimensions}
    ends = [variables[name].loaded().astype(np.float64) for name in _ENDS if name in variables]
    return _Image(samples, image.dimensions, image.attrs, of_axes, ends)


def _values(name: str, image: _Image) -> tuple[Callable[[Index], NDArray[Any]], np.dtype[Any]]:
    """A reader of the values that samples stand for: integers are mapped from their valid range to that of the image or slice."""
    samples, kind = image.samples, image.samples.dtype
    if kind.kind == "f" or len(image.ends) < 2:
        return samples.__getitem__, kind
    low, high = image.ends
    if low.shape != high.shape or low.shape != samples.shape[: low.ndim]:
        raise FormatError(
            f"{name} must have image-min and image-max along the first of its axes, {samples.shape}; got {low.shape}, {high.shape}"
        )
    all_of = np.iinfo(kind)
    given = image.attrs.get("valid_range", (image.attrs.get("valid_min", all_of.min), image.attrs.get("valid_max", all_of.max)))
    first, last = (float(end) for end in np.sort(np.ravel(given))[[0, -1]])
    if not all_of.min <= first < last <= all_of.max:
        raise FormatError(f"{name} must have a valid range within {all_of.min} to {all_of.max}; got {first:g} to {last:g}")
    slope = (high - low) / (last - first)
    offset = low - first * slope
    if (slope == 1).all() and (offset == 0).all() and (first, last) == (all_of.min, all_of.max):
        return samples.__getitem__, kind

    def read(index: Index) -> NDArray[Any]:
        part = np.clip(samples[index], first, last)
        inner = sum(isinstance(at, slice) for at in index[low.ndim :])  # axes that share a scale
        by, more = (one[index[: low.ndim]][(..., *(None,) * inner)] for one in (slope, offset))
        return np.asarray(part * by + more)

    return read, np.dtype(np.float64)


def _placed(name: str, axes: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Geometry from the attributes of the axes, the fastest first."""
    if uneven := [axis for axis, attrs in axes if _text(attrs.get("spacing", "")) == "irregular"]:
        raise GeometryError(f"{name} must have evenly spaced samples; those along {', '.join(uneven)} are irregular")
    steps = np.array([float(np.ravel(attrs.get("step", 1.0))[0]) for _, attrs in axes])
    starts = np.array([float(np.ravel(attrs.get("start", 0.0))[0]) for _, attrs in axes])
    cosines = np.array([np.ravel(attrs.get("direction_cosines", _COSINES[axis])) for axis, attrs in axes], np.float64).T
    unit = one_unit(name, [_text(attrs.get("units", "")) for _, attrs in axes])
    return from_ras(affine_parts(cosines * steps, cosines @ starts), 3, millimetres(unit))


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)
