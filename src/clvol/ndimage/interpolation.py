"""The functions of `scipy.ndimage` that interpolate, by their names, signatures and rules."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import flag
from clvol.base.errors import OptionError, OptionTypeError, RefusedError, UnsupportedError
from clvol.interop.dispatch import lazily
from clvol.ndimage.antialiasing import low_passed, nearest_splines, widths
from clvol.ndimage.arguments import (
    AnyDevice,
    Array,
    Nan,
    Progress,
    Spline,
    as_array,
    as_axes,
    as_axis,
    as_coordinates,
    as_matrix,
    as_order,
    as_output,
    as_shape,
    finite,
    per_axis,
)
from clvol.ndimage.passes import affinely, along_axes, at_points, filtered, mapped
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing

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


@lazily("input")
def spline_filter1d(
    input: ArrayLike,
    order: int = 3,
    axis: int = -1,
    output: Any = np.float64,
    mode: str = "mirror",
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """The coefficients of an array's spline along one axis: `scipy.ndimage.spline_filter1d`.

    Parameters
    ----------
    input, order, axis, output, mode
        As in SciPy.
    precision : {"single", "double"}, optional
        What is computed in. By default float32 for float16, float32, bool, whole numbers of 8 and 16 bits and complex64,
        float64 for everything else.
    device : Device, str or int, optional
        The OpenCL device; see `clvol.Device`.
    nan : {"propagate", "error"}
        "error" refuses samples that are NaN or infinite; "propagate" computes with them, as SciPy does. Functions that
        interpolate also know "local".
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    RefusedError
        `order` or `mode` is none that there is, or `output` has another shape. (A `RuntimeError`, as SciPy's.)
    AxisError
        `input` has no such axis.
    DtypeError
        `input` holds objects, strings, dates or long doubles.
    """
    number = as_order(order)
    data = as_array(input)
    copied = number < 2
    result = as_output(output, data, data.shape, copied=copied)
    spline = Spline.of(data, number, mode, 0.0, True, precision, device, nan, progress)
    if copied:
        result[...] = data
    else:
        filtered(data, [as_axis(axis, data.ndim)], result, spline)
    return result


@lazily("input")
def spline_filter(
    input: ArrayLike,
    order: int = 3,
    output: Any = np.float64,
    mode: str = "mirror",
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """The coefficients of an array's spline along all axes: `scipy.ndimage.spline_filter`.

    Parameters
    ----------
    input, order, output, mode
        As in SciPy. Between two axes coefficients are rounded to the type of `output` where that is of whole numbers, as in
        SciPy; of floating numbers, axes are filtered three at a time, in `precision`.
    precision, device, nan, progress
        As for `spline_filter1d`.

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    RefusedError, DtypeError
        As for `spline_filter1d`; `order` is from 2 to 5.
    """
    number = as_order(order, minimum=2)
    data = as_array(input)
    result = as_output(output, data, data.shape, copied=data.ndim == 0)
    spline = Spline.of(data, number, mode, 0.0, True, precision, device, nan, progress)
    if data.ndim == 0:
        result[...] = data
    else:
        filtered(data, range(data.ndim), result, spline)
    return result


@lazily("input")
def geometric_transform(
    input: ArrayLike,
    mapping: Callable[..., Sequence[float]],
    output_shape: Iterable[int] | None = None,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    extra_arguments: tuple[Any, ...] = (),
    extra_keywords: Mapping[str, Any] | None = None,
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array at positions that a function gives: `scipy.ndimage.geometric_transform`.

    Parameters
    ----------
    input, mapping, output_shape, output, order, mode, cval, prefilter, extra_arguments, extra_keywords
        As in SciPy; `mapping` may return any sequence, and no `scipy.LowLevelCallable` is taken. It is called once for each
        element of the result, in their order, also where `input` is complex; about a million positions, or as many as a
        quarter of the input's samples, are in memory at a time. The calls of Python take most of the time: where the
        positions can be had as an array, `map_coordinates` is many times as fast.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Of `output_shape`.

    Raises
    ------
    UnsupportedError
        `input` has more than three axes, or `mapping` is a `scipy.LowLevelCallable`.
    OptionTypeError
        `mapping` returns no position.
    RefusedError, NotFiniteError, DtypeError
        As for `map_coordinates`.

    Notes
    -----
    A position that is not finite has the value `cval`, in every mode.
    """
    number = as_order(order)
    data = as_array(input)
    shape = data.shape if output_shape is None else as_shape(output_shape)
    require_rank(data.ndim, len(shape))
    if not isinstance(extra_arguments, tuple):
        raise RefusedError(f"extra_arguments must be a tuple; got {extra_arguments!r}")
    if not isinstance(extra_keywords, (dict, type(None))):
        raise RefusedError(f"extra_keywords must be a dict; got {extra_keywords!r}")
    keywords = extra_keywords or {}
    if not callable(mapping):
        from scipy import LowLevelCallable

        if isinstance(mapping, LowLevelCallable):
            raise UnsupportedError("mapping must be a function of Python here; got a scipy.LowLevelCallable")
        raise RefusedError(f"mapping must be a function; got {mapping!r}")
    result = as_output(output, data, shape)
    spline = Spline.of(data, number, mode, cval, prefilter, precision, device, nan, progress)
    mapped(data, lambda index: mapping(index, *extra_arguments, **keywords), result, spline)
    return result


@lazily("input", "coordinates", instead=True)
def map_coordinates(
    input: ArrayLike,
    coordinates: ArrayLike,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    axes: int | Sequence[int] | None = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array at points: `scipy.ndimage.map_coordinates`.

    Parameters
    ----------
    input, coordinates, output, order, mode, cval, prefilter
        As in SciPy. Coordinates are never rounded to float32; they may be of any type of real numbers, float16 too.
    axes : int or sequence of int, optional
        The axes of `input` that `coordinates` are given for. Every index of the others is computed on its own, and they come
        first in the result: points in each image of a series are ``map_coordinates(series, points, axes=(1, 2, 3))``, of
        shape ``(len(series), *points.shape[1:])``. By default all.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Of shape ``coordinates.shape[1:]``, after those axes that no coordinates are given for.

    Raises
    ------
    RefusedError
        `order` or `mode` is none that there is, `input` or the result would have no axis, `coordinates` or `output` have the
        wrong shape, or `output` the wrong type. (A `RuntimeError`, as SciPy's.)
    OptionTypeError
        Coordinates or `cval` are complex, or an argument is of the wrong type.
    NotFiniteError
        `cval` is too large for float64.
    DtypeError
        `input` holds objects, strings, dates or long doubles.
    UnsupportedError
        There are coordinates along more than three axes.

    Notes
    -----
    A point that has a coordinate that is not finite has the value `cval`, in every mode. A few points in a large array cost no
    more than the samples around them: what lies so far from all of them that float64 does not see it (23 to 47 samples, by the
    order, where `input` is filtered) is not read, and a NaN there spreads nowhere.
    """
    number = as_order(order)
    data = as_array(input)
    along = as_axes(axes, data.ndim)
    at = as_coordinates(coordinates, len(along)) if data.ndim else np.empty(0)
    kept = [n for axis, n in enumerate(data.shape) if axis not in along]
    shape = (*kept, *at.shape[1:])
    require_rank(data.ndim, len(shape))
    result = as_output(output, data, shape)
    spline = Spline.of(data, number, mode, cval, prefilter, precision, device, nan, progress)
    if along != sorted(along):
        at = at[np.argsort(along)]
    at_points(data, sorted(along), at, result, spline)
    return result


@lazily("input", instead=True)
def affine_transform(
    input: ArrayLike,
    matrix: ArrayLike,
    offset: float | Sequence[float] | Array = 0.0,
    output_shape: Iterable[int] | None = None,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array on a grid that lies in it in any way: `scipy.ndimage.affine_transform`.

    Parameters
    ----------
    input, matrix, offset, output_shape, output, order, mode, cval, prefilter
        As in SciPy: the element at index ``o`` of the result has the position ``matrix @ o + offset`` in `input`. Axes whose
        row and column are those of the identity are not interpolated along; each index of them is computed on its own.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Of `output_shape`.

    Raises
    ------
    RefusedError
        `matrix`, `offset`, `output_shape` or `output` has a wrong shape, or as for `map_coordinates`.
    OptionError
        The last row of a homogeneous matrix is not ``[0, ..., 0, 1]``.
    NotFiniteError
        `matrix` or `offset` is not finite. (SciPy gives `cval` everywhere.)
    UnsupportedError
        The matrix mixes more than three axes with each other.

    Notes
    -----
    A matrix of one axis that has a zero means what its documentation says, the position `offset` along this axis; SciPy divides
    by the zero and gives `cval` everywhere.
    """
    number = as_order(order)
    data = as_array(input)
    like = output if isinstance(output, np.ndarray) else data
    shape = like.shape if output_shape is None else as_shape(output_shape)
    require_rank(data.ndim, len(shape))
    result = as_output(output, data, shape)
    spline = Spline.of(data, number, mode, cval, prefilter, precision, device, nan, progress)
    table, start = placed(matrix, offset, data.ndim, len(shape))
    if table.ndim == 1:
        positions = diagonal(table, start, data.shape, shape)
        along_axes(data, positions, result, spline)
    else:
        affinely(data, range(data.ndim), table, start, result, spline)
    return result


@lazily("input", instead=True)
def shift(
    input: ArrayLike,
    shift: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array shifted: `scipy.ndimage.shift`.

    Parameters
    ----------
    input, shift, output, order, mode, cval, prefilter
        As in SciPy. Axes whose shift is 0 are not interpolated along; each index of them is computed on its own.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    NotFiniteError
        `shift` is not finite. (SciPy gives `cval` everywhere.)
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.
    """
    number = as_order(order)
    data = as_array(input)
    require_rank(data.ndim, data.ndim)
    result = as_output(output, data, data.shape)
    spline = Spline.of(data, number, mode, cval, prefilter, precision, device, nan, progress)
    along_axes(data, shifted(shift, data.shape), result, spline)
    return result


@lazily("input", instead=True)
def zoom(
    input: ArrayLike,
    zoom: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    grid_mode: bool = False,
    anti_aliasing: AntiAliasing | bool = False,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array on a grid of another density: `scipy.ndimage.zoom`.

    Parameters
    ----------
    input, zoom, output, order, mode, cval, prefilter, grid_mode
        As in SciPy. Axes whose length stays as it is are not interpolated along; each index of them is computed on its own.
        (SciPy ignores `grid_mode` where `input` is complex.)
    anti_aliasing : {False, True, "gaussian", "least-squares"}
        Where axes get shorter. "gaussian" (and True): a Gaussian first, of standard deviation (n / m - 1) / 2 samples along an
        axis that goes from n samples to m. "least-squares": the spline of the new samples that is nearest to that of `input`.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Each axis has the length ``round(n * zoom)``.

    Raises
    ------
    OptionError
        `zoom` is negative.
    NotFiniteError
        `zoom` is not finite.
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.

    Warns
    -----
    UserWarning
        `grid_mode` is used with a mode whose period or edge is at the centres of the outermost samples.
    """
    number = as_order(order)
    data = as_array(input)
    shape, unchanged = zoomed(zoom, data.shape)
    unchanged = unchanged and bool(prefilter)
    chosen = as_anti_aliasing(anti_aliasing)
    result = as_output(output, data, shape, copied=unchanged)
    spline = Spline.of(data, number, mode, cval, prefilter, precision, device, nan, progress)
    if unchanged:
        result[...] = data
        return result
    if grid_mode and mode in ("constant", "wrap"):
        warnings.warn(
            f"It is recommended to use mode = grid-{mode} instead of {mode} when grid_mode is True.", UserWarning, stacklevel=3
        )
    positions = magnified(data.shape, shape, grid_mode)
    if chosen == "least-squares" and data.size and result.size:
        nearest_splines(data, {axis: p for axis, p in enumerate(positions) if p is not None}, result, spline)
        return result
    if chosen == "gaussian":
        data = low_passed(data, widths(shape, data.shape), spline)
    along_axes(data, positions, result, spline)
    return result


@lazily("input", instead=True)
def rotate(
    input: ArrayLike,
    angle: float,
    axes: Sequence[int] = (1, 0),
    reshape: bool = True,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: Nan = "propagate",
    progress: Progress = None,
) -> Array:
    """An array rotated in the plane of two of its axes: `scipy.ndimage.rotate`.

    Parameters
    ----------
    input, angle, axes, reshape, output, order, mode, cval, prefilter
        As in SciPy; the angle is in degrees.
    precision, device, nan, progress
        As for `spline_filter1d`; ``nan="local"`` leaves those results missing that a missing sample has weight in, and no others
        (see `clvol.Missing`).

    Returns
    -------
    ndarray
        Of the input's shape, or with `reshape` one that the rotated input fits into.

    Raises
    ------
    OptionError
        `input` has fewer than two axes, or `axes` are not two different ones of them.
    NotFiniteError
        `angle` is not finite.
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.
    """
    data = as_array(input)
    plane, matrix, offset, shape = turned(angle, axes, reshape, data.shape)
    result = as_output(output, data, shape)
    spline = Spline.of(data, order, mode, cval, prefilter, precision, device, nan, progress)
    affinely(data, plane, matrix, offset, result, spline)
    return result


# -- arguments in one form, for arrays of dask too -----------------------------------------------------------------------


def require_rank(ndim: int, result: int) -> None:
    """Refuse arrays without axes."""
    if ndim < 1 or result < 1:
        raise RefusedError(f"input and the result must have at least one axis; got {ndim} and {result}")


def placed(
    matrix: ArrayLike, offset: float | Sequence[float] | Array, ndim: int, result: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The matrix and offset of `affine_transform`, for an input and a result of so many axes; a diagonal has one axis."""
    table = as_matrix(matrix)
    if table.ndim == 2 and table.shape[1] == ndim + 1 and table.shape[0] in (ndim, ndim + 1):
        if len(table) == ndim + 1 and table[ndim].tolist() != [0] * ndim + [1]:
            raise OptionError(f"the last row of a homogeneous matrix must be {[0] * ndim + [1]}; got {table[ndim].tolist()}")
        start = table[:ndim, ndim]
        table = table[:ndim, :ndim]
    else:
        start = np.array(per_axis("offset", offset, ndim), np.float64)
    if len(table) != ndim:
        raise RefusedError(f"matrix must have a row for each of the {ndim} axes of input; got shape {table.shape}")
    if table.shape[-1] != result:
        raise RefusedError(f"matrix must have a column for each of the {result} axes of the result; got shape {table.shape}")
    return table, start


def diagonal(table: Array, start: Array, before: Sequence[int], after: Sequence[int]) -> list[Array | None]:
    """Positions along each axis by a diagonal matrix; None where they are those of the samples."""
    return [
        None if (scale, first, size) == (1, 0, length) else _scaled(size, scale, first)
        for scale, first, size, length in zip(table.tolist(), start.tolist(), after, before, strict=True)
    ]


def shifted(shift: float | Sequence[float] | Array, shape: Sequence[int]) -> list[Array | None]:
    """Positions along each axis of `shift`; None where they are those of the samples."""
    by = per_axis("shift", shift, len(shape))
    _require_positions(max(shape))
    return [None if one == 0 else np.arange(n) - float(one) for one, n in zip(by, shape, strict=True)]


def zoomed(zoom: float | Sequence[float] | Array, shape: Sequence[int]) -> tuple[tuple[int, ...], bool]:
    """The shape after `zoom`, and whether all of its factors are 1."""
    factors = per_axis("zoom", zoom, len(shape))
    after = tuple(round(n * factor) for n, factor in zip(shape, factors, strict=True))
    require_rank(len(shape), len(after))
    if any(n < 0 for n in after):
        raise OptionError(f"zoom must be at least 0; got {zoom!r}")
    return after, all(factor == 1 for factor in factors)


def magnified(before: Sequence[int], after: Sequence[int], whole: bool) -> list[Array | None]:
    """Positions along each axis of `zoom`; None where they are those of the samples."""
    return [None if m == n else _magnified(n, m, whole) for n, m in zip(before, after, strict=True)]


def turned(
    angle: float, axes: Sequence[int], reshape: bool, before: Sequence[int]
) -> tuple[list[int], NDArray[np.float64], NDArray[np.float64], list[int]]:
    """The plane of `rotate`, the matrix and offset in it, and the shape of the result."""
    from scipy import special

    n = len(before)
    if n < 2:
        raise OptionError(f"input must have at least two axes; got {n}")
    plane = _plane(axes, n)
    turn = finite("angle", angle)
    c, s = special.cosdg(turn), special.sindg(turn)
    matrix = np.array([[c, s], [-s, c]])
    sides = np.array([before[axis] for axis in plane])
    after = sides
    if flag("reshape", reshape):  # what follows is rounded as in SciPy
        iy, ix = sides
        bounds = matrix @ [[0, 0, iy, iy], [0, ix, 0, ix]]
        after = (np.ptp(bounds, axis=1) + 0.5).astype(int)
    offset = (sides - 1) / 2 - matrix @ ((after - 1) / 2)
    shape = list(before)
    shape[plane[0]], shape[plane[1]] = after.tolist()
    return plane, matrix, offset, shape


def _plane(axes: Sequence[int], ndim: int) -> list[int]:
    if not np.iterable(axes):
        raise OptionTypeError(f"axes must be two axes of input; got {axes!r}")
    pair = list(axes)
    if len(pair) != 2:
        raise OptionError(f"axes must be exactly two axes of input; got {axes!r}")
    if not all(finite("axes", axis).is_integer() for axis in pair):
        raise OptionError(f"axes must be whole numbers; got {axes!r}")
    plane = sorted(int(axis) + ndim if axis < 0 else int(axis) for axis in pair)
    if not 0 <= plane[0] < plane[1] < ndim:
        raise OptionError(f"axes must be two different ones of the {ndim} axes of input; got {axes!r}")
    return plane


def _scaled(size: int, scale: float, start: float) -> Array:
    """Positions along an axis of a diagonal matrix, rounded as SciPy does."""
    _require_positions(size)
    return (np.arange(size) + start / scale) * scale if scale != 0 else np.full(size, start)


def _require_positions(count: int) -> None:
    memory.require(24 * count, f"the positions of {count} samples along an axis")


def _magnified(n: int, m: int, whole: bool) -> Array:
    """Positions of m samples along n, rounded as SciPy does; between the outermost centres, or with `whole` between the edges."""
    _require_positions(m)
    index = np.arange(m)
    if whole:
        return (index + 0.5) * (n / max(m, 1)) - 0.5
    return index * ((n - 1) / (m - 1)) if m != 1 else index.astype(np.float64)
