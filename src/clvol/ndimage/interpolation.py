"""The functions of `scipy.ndimage` that interpolate, by their names, signatures and rules."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.errors import OptionError, RefusedError, UnsupportedError
from clvol.interop.dispatch import is_in_parts, is_lazy
from clvol.ndimage.antialiasing import widths
from clvol.ndimage.arguments import AnyDevice, Array, Nan, Progress, as_axes, as_axis, as_order, as_shape, warn
from clvol.ndimage.geometry import diagonal, magnified, placed, require_rank, shifted, turned, zoomed
from clvol.ndimage.in_memory import InMemory
from clvol.ndimage.passes import require_few
from clvol.ndimage.plan import Affine, Coefficients, Grid, Mapped, Points, Substrate
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
    on = _substrate(input)
    spline = on.spline(order, mode, 0.0, True, precision, device, nan, progress)
    axes = [as_axis(axis, on.ndim)] if spline.order > 1 else []
    return on.evaluate(Coefficients("spline_filter1d", spline, output, on.shape, axes))


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
    on = _substrate(input)
    spline = on.spline(as_order(order, minimum=2), mode, 0.0, True, precision, device, nan, progress)
    return on.evaluate(Coefficients("spline_filter", spline, output, on.shape, range(on.ndim)))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks)
    shape = on.shape if output_shape is None else as_shape(output_shape)
    require_rank(on.ndim, len(shape))
    if not isinstance(extra_arguments, tuple):
        raise RefusedError(f"extra_arguments must be a tuple; got {extra_arguments!r}")
    if not isinstance(extra_keywords, (dict, type(None))):
        raise RefusedError(f"extra_keywords must be a dict; got {extra_keywords!r}")
    if not callable(mapping):
        from scipy import LowLevelCallable

        if isinstance(mapping, LowLevelCallable):
            raise UnsupportedError("mapping must be a function of Python here; got a scipy.LowLevelCallable")
        raise RefusedError(f"mapping must be a function; got {mapping!r}")
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Mapped("geometric_transform", spline, output, shape, mapping, extra_arguments, extra_keywords or {}))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks, coordinates)
    along = as_axes(axes, on.ndim)
    at = on.as_coordinates(coordinates, len(along)) if on.ndim else np.empty(0)
    shape = (*(n for axis, n in enumerate(on.shape) if axis not in along), *at.shape[1:])
    require_rank(on.ndim, len(shape))
    require_few(len(along))
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    if along != sorted(along):
        at = at[np.argsort(along).tolist()]
    return on.evaluate(Points("map_coordinates", spline, output, shape, sorted(along), at))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks)
    like = output if isinstance(output, np.ndarray) else on
    shape = like.shape if output_shape is None else as_shape(output_shape)
    require_rank(on.ndim, len(shape))
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    table, start = placed(matrix, offset, on.ndim, len(shape))
    if table.ndim == 1:
        return on.evaluate(Grid("affine_transform", spline, output, shape, diagonal(table, start, on.shape, shape)))
    return on.evaluate(Affine("affine_transform", spline, output, shape, range(on.ndim), table, start))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks)
    require_rank(on.ndim, on.ndim)
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Grid("shift", spline, output, on.shape, shifted(shift, on.shape)))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks)
    shape, unchanged = zoomed(zoom, on.shape)
    copied, chosen = unchanged and bool(prefilter), as_anti_aliasing(anti_aliasing)
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    if grid_mode and mode in ("constant", "wrap") and not copied:
        warn(f"It is recommended to use mode = grid-{mode} instead of {mode} when grid_mode is True.")
    positions = magnified(on.shape, shape, grid_mode)
    sigma = widths(shape, on.shape) if chosen == "gaussian" else {}
    return on.evaluate(Grid("zoom", spline, output, shape, positions, sigma, chosen == "least-squares", copied))


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
    chunks: Any = None,
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
    on = _substrate(input, chunks)
    plane, matrix, offset, shape = turned(angle, axes, reshape, on.shape)
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Affine("rotate", spline, output, shape, plane, matrix, offset))


def _substrate(input: Any, chunks: Any = None, coordinates: Any = None) -> Substrate:
    """Where the samples of an input are: the one place that asks."""
    if is_lazy(input) or is_lazy(coordinates):
        from clvol.ndimage.as_graph import AsGraph

        return AsGraph(input, chunks)
    if chunks is not None:
        raise OptionError(f"chunks are those of a result of dask, and input is no array of dask; got {chunks!r}")
    if is_in_parts(input):
        from clvol.ndimage.by_bricks import ByBricks

        return ByBricks(input)
    return InMemory(input)
