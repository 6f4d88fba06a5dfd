"""The functions of `clvol.ndimage` of a LazyVolume: its samples are read by bricks, and the result is in memory.

An array is taken in the same way whose coefficients there is no room for, if these are of single precision.

Values differ by less than 10⁻⁶ of the samples' range (order 5: 4 · 10⁻⁶) from those of the array as a whole; all is computed in
single precision.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.errors import UnsupportedError
from clvol.bricks.field import BrickedField
from clvol.bricks.source import LazyVolume
from clvol.filter.boundary import as_boundary
from clvol.ndimage.antialiasing import nearest_sums, widths
from clvol.ndimage.arguments import (
    AnyDevice,
    Array,
    Progress,
    Spline,
    as_array,
    as_coordinates,
    as_order,
    as_output,
    as_precision,
    as_shape,
)
from clvol.ndimage.engine import BOUNDARIES, converted, row_of
from clvol.ndimage.interpolation import diagonal, magnified, placed, require_rank, shifted, turned, zoomed
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing, gaussian

__all__ = [
    "affine_transform",
    "geometric_transform",
    "map_coordinates",
    "rotate",
    "shift",
    "spline_filter",
    "spline_filter1d",
    "zoom",
]

_BLOCK = 96  # results along an edge of those whose positions are in memory at a time: neighbours are in few bricks
_POINTS = 1 << 22  # positions at a time, where they lie anyhow

_ONLY_WHOLE = (
    "of a volume that is read part by part takes no {}: arrays of dask do (dask.array.from_array(volume.data), "
    "dask.array.from_zarr), and volume.whole().data"
)

_Floats = NDArray[np.float64]


def map_coordinates(
    input: LazyVolume | BrickedField | ArrayLike,
    coordinates: ArrayLike,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    **others: Any,
) -> Array:
    """As `clvol.ndimage.map_coordinates`; positions that are neighbours in space should be so in `coordinates`."""
    field, progress = _Bricks.of("map_coordinates", input, order, mode, cval, prefilter, others, output), others.get("progress")
    at = as_coordinates(coordinates, 3)
    result = as_output(output, field.like, at.shape[1:])
    flat, values = at.reshape(3, -1), np.empty(math.prod(result.shape), result.dtype)
    with field:
        for first in range(0, flat.shape[1], _POINTS):
            some = slice(first, min(first + _POINTS, flat.shape[1]))
            values[some] = converted(field.values(flat[:, some].astype(np.float64)), result.dtype)
            if progress:
                progress(some.stop / flat.shape[1])
    result[...] = values.reshape(result.shape)
    return result


def affine_transform(
    input: LazyVolume | BrickedField | ArrayLike,
    matrix: ArrayLike,
    offset: float | Sequence[float] | Array = 0.0,
    output_shape: Iterable[int] | None = None,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    **others: Any,
) -> Array:
    """As `clvol.ndimage.affine_transform`."""
    field = _Bricks.of("affine_transform", input, order, mode, cval, prefilter, others, output)
    like = output if isinstance(output, np.ndarray) else field.like
    shape = like.shape if output_shape is None else as_shape(output_shape)
    require_rank(3, len(shape))
    table, start = placed(matrix, offset, 3, len(shape))
    result = as_output(output, field.like, shape)
    if table.ndim == 1:
        return field.along(diagonal(table, start, field.like.shape, shape), result, others)
    return field.mixed(table, start, result, others)


def shift(
    input: LazyVolume | BrickedField | ArrayLike,
    shift: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    **others: Any,
) -> Array:
    """As `clvol.ndimage.shift`."""
    field = _Bricks.of("shift", input, order, mode, cval, prefilter, others, output)
    positions = shifted(shift, field.like.shape)
    return field.along(positions, as_output(output, field.like, field.like.shape), others)


def zoom(
    input: LazyVolume | BrickedField | ArrayLike,
    zoom: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    grid_mode: bool = False,
    anti_aliasing: AntiAliasing | bool = False,
    **others: Any,
) -> Array:
    """As `clvol.ndimage.zoom`; sums against aliases are computed for the parts that are read."""
    chosen = as_anti_aliasing(anti_aliasing)
    field = _Bricks.of("zoom", input, order, mode, cval, prefilter, others, output)
    shape, _ = zoomed(zoom, field.like.shape)
    if grid_mode and mode in ("constant", "wrap"):
        warnings.warn(
            f"It is recommended to use mode = grid-{mode} instead of {mode} when grid_mode is True.", UserWarning, stacklevel=3
        )
    positions = magnified(field.like.shape, shape, grid_mode)
    result = as_output(output, field.like, shape)
    if chosen == "least-squares" and result.size:
        return field.nearest({axis: p for axis, p in enumerate(positions) if p is not None}, result, others)
    if chosen == "gaussian":
        field = field.low_passed(widths(shape, field.like.shape))
    return field.along(positions, result, others)


def rotate(
    input: LazyVolume | BrickedField | ArrayLike,
    angle: float,
    axes: Sequence[int] = (1, 0),
    reshape: bool = True,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    **others: Any,
) -> Array:
    """As `clvol.ndimage.rotate`, of samples: coefficients would be interpolated along the axis of rotation too."""
    if as_order(order) > 1 and not prefilter:
        raise UnsupportedError(f"rotate {_ONLY_WHOLE.format('prefilter=False')}")
    field = _Bricks.of("rotate", input, order, mode, cval, prefilter, others, output)
    plane, matrix, offset, shape = turned(angle, axes, reshape, field.like.shape)
    whole, start = np.eye(3), np.zeros(3)
    whole[np.ix_(plane, plane)], start[plane] = matrix, offset
    return field.mixed(whole, start, as_output(output, field.like, shape), others)


def _unsupported(name: str, why: str) -> Callable[..., NoReturn]:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise UnsupportedError(
            f"{name} takes no volume that is read part by part: {why}. Arrays of dask are taken by parts "
            f"(dask.array.from_array(volume.data), dask.array.from_zarr), and volume.whole().data is all of it in memory"
        )

    refuse.__name__ = refuse.__qualname__ = name
    return refuse


geometric_transform = _unsupported("geometric_transform", "map_coordinates does, at the positions that the function gives")
spline_filter = _unsupported("spline_filter", "its coefficients are as many as the samples")
spline_filter1d = _unsupported("spline_filter1d", "its coefficients are as many as the samples")

_OTHERS = {"axes": (None,), "precision": (None, "single"), "nan": ("propagate", "error")}


def _volume_of(function: str, input: LazyVolume | BrickedField | ArrayLike, precision: Any, output: Any) -> LazyVolume:
    """The volume of what is given; an array must be one that would be computed in single precision."""
    if isinstance(input, BrickedField):
        return input.volume
    if isinstance(input, LazyVolume):
        return input
    data = as_array(input)
    if as_precision(precision, data.dtype) != "single" or (output is not None and getattr(output, "dtype", output) == np.bool_):
        raise UnsupportedError(f"{function} by bricks is of single precision")
    if isinstance(output, np.ndarray) and np.may_share_memory(output, data):
        raise UnsupportedError(f"{function} by bricks reads samples after it has written results, which may not lie in their place")
    return LazyVolume(data)


class _Bricks:
    """A volume's spline as SciPy has it.

    Attributes
    ----------
    like : ndarray
        Zeros of no memory in place of the samples.
    """

    def __init__(self, field: BrickedField, spline: Spline, owned: Sequence[BrickedField]) -> None:
        self._field, self._spline, self._owned = field, spline, tuple(owned)
        self.like = field.volume.grid.data

    @classmethod
    def of(
        cls,
        function: str,
        input: LazyVolume | BrickedField | ArrayLike,
        order: int,
        mode: str,
        cval: complex,
        prefilter: bool,
        others: dict[str, Any],
        output: Any = None,
    ) -> _Bricks:
        """Of the arguments that all functions share; `UnsupportedError` for those that bricks do not know."""
        for name, value in others.items():
            if name in ("device", "progress"):
                continue
            if name not in _OTHERS:
                raise TypeError(f"{function}() got an unexpected keyword argument {name!r}")
            if not any(value is one or (isinstance(one, str) and value == one) for one in _OTHERS[name]):
                raise UnsupportedError(f"{function} {_ONLY_WHOLE.format(f'{name}={value!r}')}")
        volume = _volume_of(function, input, others.get("precision"), output)
        device: AnyDevice = others.get("device")
        number, like = as_order(order), volume.grid.data
        spline = Spline.of(like[:0, :0, :0], number, mode, cval, prefilter, "single", device, "propagate", None)
        boundary = as_boundary(BOUNDARIES[spline.mode])
        value = float(spline.cval.real)
        boundary = boundary if value == boundary.cval else replace(boundary, cval=value)
        row = row_of(number, spline.prefilter)
        if not isinstance(input, BrickedField):
            field = BrickedField(volume, row, boundary, spline.device)
            return cls(field, spline, [field])
        if (input.filter.name, input.boundary) != (row.name, boundary):
            raise UnsupportedError(
                f"{function} of a BrickedField takes its own filter and boundary rule, {input.filter.name!r} and "
                f"{input.boundary.name!r}; got order {order} and mode {mode!r}: give its volume"
            )
        return cls(input, spline, [])

    def __enter__(self) -> None:
        return None

    def __exit__(self, *_: object) -> None:
        for field in self._owned:
            field.close()

    def low_passed(self, sigma: Mapping[int, float]) -> _Bricks:
        """That of the samples after a Gaussian: see `clvol.ndimage.antialiasing.low_passed`."""
        own, boundary = self._field, as_boundary(BOUNDARIES[self._spline.mode])
        sums = {axis: gaussian(float(s), self.like.shape[axis], boundary) for axis, s in sigma.items() if s > 0}
        if not sums:
            return self
        smooth = LazyVolume(
            own.store.summed(sums, np.float32, float(self._spline.cval.real)), limits=own.volume.limits, labels=False
        )
        field = BrickedField(smooth, own.filter, own.boundary, own.device, beside=own)
        return type(self)(field, self._spline, [field, *self._owned])

    def nearest(self, positions: Mapping[int, _Floats], result: Array, others: dict[str, Any]) -> Array:
        """The spline of a coarser grid that is nearest to this one: see `clvol.ndimage.antialiasing.nearest_splines`."""
        spline, progress = self._spline, others.get("progress")
        sums = nearest_sums(self.like.shape, positions, spline, np.float32)
        with self:
            for block, values, done in self._field.store.blocks(sums, np.float32, float(spline.cval.real)):
                result[block] = converted(values, result.dtype)
                if progress:
                    progress(done)
        return result

    def values(self, at: _Floats) -> Array:
        """Values at positions [z, y, x], shape (3, N); a position that is not finite has the value `cval`."""
        found = self._field.at_samples(np.ascontiguousarray(at[::-1].T))
        bad = ~np.isfinite(at).all(0)
        if bad.any():
            found[bad] = self._spline.cval.real
        return found

    def along(self, positions: Sequence[_Floats | None], result: Array, others: dict[str, Any]) -> Array:
        """The spline on a grid along the axes; None: at the samples."""
        lines = [np.arange(n, dtype=np.float64) if one is None else one for one, n in zip(positions, result.shape, strict=True)]

        def places(block: tuple[slice, ...]) -> _Floats:
            grid = np.meshgrid(*(line[part] for line, part in zip(lines, block, strict=True)), indexing="ij")
            return np.stack(grid).reshape(3, -1)

        return self._by_blocks(places, result, others.get("progress"))

    def mixed(self, matrix: _Floats, offset: _Floats, result: Array, others: dict[str, Any]) -> Array:
        """The spline on a grid that lies anyhow, of any number of axes."""

        def places(block: tuple[slice, ...]) -> _Floats:
            index = np.meshgrid(*(np.arange(part.start, part.stop, dtype=np.float64) for part in block), indexing="ij")
            flat = np.stack(index).reshape(len(block), -1)
            found = np.repeat(offset[:, None], flat.shape[1], axis=1)
            for column, line in zip(matrix.T, flat, strict=True):  # added up as SciPy does
                found += column[:, None] * line
            return found

        return self._by_blocks(places, result, others.get("progress"))

    def _by_blocks(self, places: Callable[[tuple[slice, ...]], _Floats], result: Array, progress: Progress) -> Array:
        with self:
            blocks = list(itertools.product(*([slice(a, min(a + _BLOCK, n)) for a in range(0, n, _BLOCK)] for n in result.shape)))
            for done, block in enumerate(blocks, 1):
                part = result[block]
                part[...] = converted(self.values(places(block)), result.dtype).reshape(part.shape)
                if progress:
                    progress(done / len(blocks))
        return result
