"""SciPy's functions that interpolate on grids, block by block."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import dask.array as da
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.errors import DataError
from clvol.dask.blocks import (
    Array,
    Block,
    Chunks,
    Floats,
    Span,
    Window,
    as_chunks,
    as_lazy,
    blockwise,
    checked_device,
    located,
    refused,
    spans,
    window_along,
)
from clvol.dask.filtering import checked_spline, splines_margin
from clvol.dask.reduced import Reduction, axis_by_axis, gaussian_radius
from clvol.device import as_device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.make import bspline
from clvol.ndimage import engine, interpolation, passes
from clvol.ndimage.antialiasing import low_passed, widths
from clvol.ndimage.arguments import AnyDevice, Spline, as_shape
from clvol.spline.field import Precision, precision_kind
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing

__all__ = ["Options", "affine_transform", "as_stored", "rotate", "shift", "zoom"]

_JUMPS = ("constant", "wrap")
"""Modes in which the function jumps at the outer samples, so that the last bit of a position decides there."""
_ROUNDING = 1e-12
"""Of positions, relative to their size."""


@dataclass(frozen=True)
class Options:
    """A spline's options as a task carries them: the device is looked for where it is computed."""

    order: int
    mode: str
    cval: complex
    prefilter: bool
    precision: Precision | None
    device: Any
    nan: str

    def of(self, window: Array) -> Spline:
        """The spline of the samples in a window."""
        return Spline.of(window, self.order, self.mode, self.cval, self.prefilter, self.precision, self.device, self.nan, None)

    @property
    def boundary(self) -> Boundary:
        """The boundary rule."""
        return as_boundary(engine.BOUNDARIES[self.mode])

    @property
    def identity(self) -> list[object]:
        """What tells them from others."""
        return [self.order, self.mode, repr(self.cval), self.prefilter, self.precision, repr(self.device), self.nan]


def affine_transform(
    input: Any,
    matrix: ArrayLike,
    offset: float | Sequence[float] | Array = 0.0,
    output_shape: Iterable[int] | None = None,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array on a grid that lies in it in any way, as `clvol.ndimage.affine_transform` gives it.

    A block reads the box around its positions, and the margin around that which the spline needs.

    Parameters
    ----------
    input : dask.array.Array
    matrix, offset, output_shape, output, order, mode, cval, prefilter, precision, device, nan
        As of `clvol.ndimage.affine_transform`; `output` is a dtype, `nan` is not "local", and `progress` is dask's own.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result. By default those of `input`, along axes of another length chunks as long as its longest.

    Returns
    -------
    dask.array.Array
        Without a prefilter (orders 0 and 1, or ``prefilter=False``) it is bit for bit the result in one piece, but for the last
        bits of positions: where a matrix mixes axes, and within a margin of the seam under "grid-wrap". (Samples that lie far from
        zero compared with their range are computed in double precision, and each window decides for itself whether its do.) With
        a prefilter, coefficients differ as those of `clvol.dask.prefilter` do.

    Raises
    ------
    ClvolError
        As `clvol.ndimage.affine_transform` raises it, and for arrays of dask that cannot be read; errors of a block name it.
    """
    refused("affine_transform", progress=progress)
    if not hasattr(input, "dask"):  # the matrix is an array of dask
        return interpolation.affine_transform(input, np.asarray(matrix), offset, output_shape, output, order, mode, cval, prefilter)
    source = as_lazy(input)
    shape = source.shape if output_shape is None else as_shape(output_shape)
    interpolation.require_rank(source.ndim, len(shape))
    spline, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan)
    options = Options(spline.order, mode, cval, spline.prefilter, precision, checked_device(device), nan)
    table, start = interpolation.placed(np.asarray(matrix), offset, source.ndim, len(shape))
    known = len(shape) == source.ndim
    sizes = as_chunks(chunks, source, shape, range(source.ndim) if known else [None] * len(shape), dtype)
    if table.ndim == 1:
        positions = interpolation.diagonal(table, start, source.shape, shape)
        return _along("affine_transform", source, positions, sizes, dtype, spline, options)
    return _affinely("affine_transform", source, list(range(source.ndim)), table, start, sizes, dtype, spline, options)


def shift(
    input: Any,
    shift: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array shifted, as `clvol.ndimage.shift` gives it; see `affine_transform`.

    Parameters
    ----------
    input : dask.array.Array
    shift, output, order, mode, cval, prefilter, precision, device, nan
        As of `clvol.ndimage.shift`.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result; by default those of `input`.

    Returns
    -------
    dask.array.Array
    """
    refused("shift", progress=progress)
    source = as_lazy(input)
    interpolation.require_rank(source.ndim, source.ndim)
    spline, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan)
    options = Options(spline.order, mode, cval, spline.prefilter, precision, checked_device(device), nan)
    sizes = as_chunks(chunks, source, source.shape, range(source.ndim), dtype)
    return _along("shift", source, interpolation.shifted(shift, source.shape), sizes, dtype, spline, options)


def zoom(
    input: Any,
    zoom: float | Sequence[float] | Array,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    grid_mode: bool = False,
    anti_aliasing: AntiAliasing | bool = False,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array on a grid of another density, as `clvol.ndimage.zoom` gives it; see `affine_transform`.

    Parameters
    ----------
    input : dask.array.Array
    zoom, output, order, mode, cval, prefilter, grid_mode, anti_aliasing, precision, device, nan
        As of `clvol.ndimage.zoom`. With anti-aliasing a block reads what the low-pass takes, too.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result. By default, along axes of another length, chunks as long as the longest of `input`.

    Returns
    -------
    dask.array.Array
    """
    refused("zoom", progress=progress)
    source = as_lazy(input)
    shape, unchanged = interpolation.zoomed(zoom, source.shape)
    unchanged = unchanged and bool(prefilter)
    chosen = as_anti_aliasing(anti_aliasing)
    spline, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan, copied=unchanged)
    options = Options(spline.order, mode, cval, spline.prefilter, precision, checked_device(device), nan)
    sizes = as_chunks(chunks, source, shape, range(source.ndim), dtype)
    if grid_mode and mode in ("constant", "wrap"):
        warnings.warn(
            f"It is recommended to use mode = grid-{mode} instead of {mode} when grid_mode is True.", UserWarning, stacklevel=3
        )
    if unchanged:
        return _along("zoom", source, [None] * source.ndim, sizes, dtype, spline, options, copied=True)
    positions = interpolation.magnified(source.shape, shape, grid_mode)
    if chosen == "least-squares" and source.size and math.prod(shape):
        return _nearest(source, positions, sizes, dtype, spline, options)
    sigma = widths(shape, source.shape) if chosen == "gaussian" else {}
    return _along("zoom", source, positions, sizes, dtype, spline, options, sigma)


def rotate(
    input: Any,
    angle: float,
    axes: Sequence[int] = (1, 0),
    reshape: bool = True,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array rotated in the plane of two of its axes, as `clvol.ndimage.rotate` gives it; see `affine_transform`.

    Parameters
    ----------
    input : dask.array.Array
    angle, axes, reshape, output, order, mode, cval, prefilter, precision, device, nan
        As of `clvol.ndimage.rotate`.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result. By default, along axes of another length, chunks as long as the longest of `input`.

    Returns
    -------
    dask.array.Array
    """
    refused("rotate", progress=progress)
    source = as_lazy(input)
    plane, matrix, offset, shape = interpolation.turned(angle, axes, reshape, source.shape)
    spline, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan)
    options = Options(spline.order, mode, cval, spline.prefilter, precision, checked_device(device), nan)
    table, start = np.eye(source.ndim), np.zeros(source.ndim)
    table[np.ix_(plane, plane)], start[plane] = matrix, offset
    sizes = as_chunks(chunks, source, shape, range(source.ndim), dtype)
    return _affinely("rotate", source, plane, table, start, sizes, dtype, spline, options)


# -- along the axes --------------------------------------------------------------------------------------------------


def _along(
    name: str,
    source: Any,
    positions: Sequence[Floats | None],
    chunks: tuple[Any, ...],
    dtype: np.dtype[Any],
    spline: Spline,
    options: Options,
    sigma: dict[int, float] | None = None,
    *,
    copied: bool = False,
) -> Any:
    """A grid along the axes; positions None are those of the samples."""
    if not spline.interpolates and not copied:
        positions = [np.arange(n, dtype=np.float64) if p is None else p for p, n in zip(positions, source.shape, strict=True)]
    if not source.size:
        _require_samples(source, chunks, spline, positions)
    boundary, reach = options.boundary, splines_margin(spline, dtype)
    radii = {axis: gaussian_radius(s) for axis, s in (sigma or {}).items()}
    windows: list[list[Window | None]] = []  # along each axis of each chunk
    for axis, (along, n, sizes) in enumerate(zip(positions, source.shape, chunks, strict=True)):
        more = radii.get(axis, 0)
        row: list[Window | None] = []
        for low, high in spans(sizes):
            row.append(None if along is None else window_along(along[low:high], n, boundary, reach, more))
            if (made := row[-1]) is not None and more and boundary.outside == "overlap" and _touches(made.span, n):
                # what stands past an edge lies at the other one
                row[-1] = window_along(along[low:high], n, boundary, (n, n)) if along is not None else None
        windows.append(row)
    outside = options.mode == "constant" and not copied

    def plan(index: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...] | None, Any]:
        row = [along[i] for along, i in zip(windows, index, strict=True)]
        own = [None if one is None else one.positions for one in row]
        if outside and any(_all_outside(p, place, n) for p, place, n in zip(positions, where, source.shape, strict=True)):
            return None, own
        return tuple(place if one is None else one.span for one, place in zip(row, where, strict=True)), own

    compute = _Grid(options, dtype, sigma or {}, copied)
    return blockwise(name, source, chunks, dtype, plan, compute, [*options.identity, list(positions), sigma, copied])


def _touches(span: Span, n: int) -> bool:
    return span[0] <= 0 or span[1] >= n


def _all_outside(positions: Floats | None, place: Span, n: int) -> bool:
    if positions is None:
        return False
    own = positions[place[0] : place[1]]
    return bool(((own < 0) | (own > n - 1)).all())


def _require_samples(source: Any, chunks: tuple[Any, ...], spline: Spline, positions: Sequence[Floats | None]) -> None:
    """Refuse an array without samples where values are asked for that only samples have."""
    asked = all(map(sum, chunks)) and any(p is not None for p in positions)
    if asked and spline.mode not in ("constant", "grid-constant"):
        raise DataError(f'input must have samples where mode is not "constant" or "grid-constant"; got shape {source.shape}')


@dataclass(frozen=True, eq=False)
class _Grid:
    options: Options
    dtype: np.dtype[Any]
    sigma: dict[int, float]
    copied: bool

    def __call__(self, window: Array | None, block: Block) -> Array:
        made = np.empty(block.shape, self.dtype)
        if window is None:
            made[...] = as_stored(self.options.cval, self.dtype)
            return made
        with located(window, block, 'with nan="error" all samples must be finite'):
            spline = self.options.of(window)
        if self.copied:
            made[...] = window
            return made
        if self.sigma:
            window = low_passed(window, self.sigma, spline)
        passes.along_axes(window, block.extra, made, spline)
        return made


def _nearest(
    source: Any, positions: Sequence[Floats | None], chunks: tuple[Any, ...], dtype: np.dtype[Any], spline: Spline, options: Options
) -> Any:
    """The nearest spline of a coarser grid, as `clvol.ndimage.antialiasing.nearest_splines` gives it; positions as of `_along`."""
    if source.dtype.kind == "c":
        half, cval = np.empty(0, dtype).real.dtype, complex(options.cval)
        parts = ((source.real, cval.real), (source.imag, cval.imag))
        made = [_nearest(part, positions, chunks, half, spline, replace(options, cval=value)) for part, value in parts]
        return da.map_blocks(_complex, *made, dtype=dtype, meta=np.empty((0,) * source.ndim, dtype))
    row, boundary = bspline(options.order), options.boundary
    double = spline.precision == "double" or dtype.kind == "b"  # as `clvol.ndimage.engine.kind_for`
    reductions = {
        axis: Reduction.at(row, p, source.shape[axis], boundary, double, options.prefilter)
        for axis, p in enumerate(positions)
        if p is not None
    }
    # as in one piece: what shrinks most goes first
    axes = sorted(reductions.items(), key=lambda one: one[1].m / one[1].n)
    kind, ends, outside = precision_kind(spline.precision), _Ends(options, dtype), float(options.cval.real)
    about = [*options.identity, axes, str(dtype)]
    return axis_by_axis("zoom", source, chunks, dtype, axes, kind, ends.begin, ends.end, outside, options.device, about)


@dataclass(frozen=True, eq=False)
class _Ends:
    """How sums begin, and what becomes of them."""

    options: Options
    dtype: np.dtype[Any]

    def begin(self, window: Array, block: Block) -> type[np.generic]:
        """The type of sums: that of double precision where single would lose what the samples hold."""
        with located(window, block, 'with nan="error" all samples must be finite'):
            spline = self.options.of(window)
        return engine.kind_for(spline.precision, window, np.empty(0, self.dtype), as_device(spline.device))

    def end(self, values: Array, _: Block) -> Array:
        """In the type of the result."""
        return engine.converted(values, self.dtype)


def _complex(real: Array, imag: Array) -> Array:
    made = np.empty(real.shape, np.result_type(real, np.complex64))
    made.real, made.imag = real, imag
    return made


def as_stored(value: complex, dtype: np.dtype[Any]) -> Any:
    """`cval` as an array of this type holds it."""
    return value if dtype.kind == "c" else passes.stored(value, dtype)


# -- any matrix ------------------------------------------------------------------------------------------------------


def _affinely(
    name: str,
    source: Any,
    axes: list[int],
    matrix: Floats,
    offset: Floats,
    chunks: tuple[Any, ...],
    dtype: np.dtype[Any],
    spline: Spline,
    options: Options,
) -> Any:
    """A grid at ``matrix @ i + offset``; axes that are not among `axes` are left as they are."""
    rows, columns = matrix.shape
    shape = tuple(map(sum, chunks))
    if rows == columns == len(axes) and not (matrix - np.diag(np.diag(matrix))).any():
        steps, starts = np.diag(matrix).tolist(), offset.tolist()
        positions = [
            None if (step, start, m) == (1, 0, n) else np.arange(m) * step + start
            for step, start, m, n in zip(steps, starts, shape, source.shape, strict=True)
        ]
        return _along(name, source, positions, chunks, dtype, spline, options)
    if not source.size:
        _require_samples(source, chunks, spline, [offset])
    same = rows == columns and spline.interpolates
    left = [k for k in range(rows) if k not in axes or (same and _is_left(k, matrix, offset, shape, source.shape))]
    moved = [k for k in range(rows) if k not in left]
    passes.require_mixable(matrix, moved, columns > rows)
    boundary, reach = options.boundary, splines_margin(spline, dtype)
    repeats = boundary.outside == "overlap" or (boundary.fold is None and boundary.period is not None)

    def plan(_: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...] | None, Any]:
        corners = np.array(list(product(*((low, high - 1) for low, high in where))), np.float64)
        at = corners @ matrix.T + offset
        low, high = at.min(0), at.max(0)
        slack = _ROUNDING * (np.array(source.shape) + np.abs(at).max(0))
        within = (low >= slack) & (high <= np.array(source.shape) - 1 - slack)
        inside = bool(within[moved].all())
        if spline.mode == "constant" and any(high[k] < -slack[k] or low[k] > source.shape[k] - 1 + slack[k] for k in moved):
            return None, None
        found = []
        for k, n in enumerate(source.shape):
            if k in left:
                found.append(where[k])
                continue
            span = (0, n)
            if not repeats or within[k]:
                span = window_along(np.array([low[k] - slack[k], high[k] + slack[k]]), n, boundary, reach).span
            if repeats and _touches(span, n):  # kernels would fold positions by the length of the window
                span = (0, n)
            found.append(span)
        mended = len(moved) <= passes.NATIVE and (spline.order == 0 or (spline.mode in _JUMPS and not inside))
        return tuple(found), mended

    compute = _Affine(axes, matrix, offset, left, options, dtype)
    return blockwise(name, source, chunks, dtype, plan, compute, [*options.identity, axes, matrix, offset])


def _is_left(k: int, matrix: Floats, offset: Floats, after: Sequence[int], before: Sequence[int]) -> bool:
    """Whether an axis is left as it is."""
    unit = np.zeros(len(matrix))
    unit[k] = 1
    same = bool((matrix[k] == unit).all() and (matrix[:, k] == unit).all())
    return same and offset[k] == 0 and after[k] == before[k]


@dataclass(frozen=True, eq=False)
class _Affine:
    axes: list[int]
    matrix: Floats
    offset: Floats
    left: list[int]
    options: Options
    dtype: np.dtype[Any]

    def __call__(self, window: Array | None, block: Block) -> Array:
        made = np.empty(block.shape, self.dtype)
        if window is None:
            made[...] = as_stored(self.options.cval, self.dtype)
            return made
        with located(window, block, 'with nan="error" all samples must be finite'):
            spline = self.options.of(window)
        assert block.spans is not None
        first = np.array([start for start, _ in block.spans], np.float64)
        start = np.asarray(block.start, np.float64)
        matrix, offset = self.matrix, self.offset + self.matrix @ start - first
        if len(self.axes) < window.ndim:
            matrix, offset = matrix[np.ix_(self.axes, self.axes)], offset[self.axes]
        passes.affinely(window, self.axes, matrix, offset, made, spline)
        if block.extra:
            self._mend(window, block, first, made, spline)
        return made

    def _mend(self, window: Array, block: Block, first: Floats, made: Array, spline: Spline) -> None:
        """Compute anew where the last bit of a position decides, with positions as the whole array has them."""
        columns = [k for k in range(made.ndim) if k not in self.left] if self.left else list(range(made.ndim))
        rows = [k for k in range(window.ndim) if k not in self.left]
        index = np.ix_(*(np.arange(block.start[k], block.start[k] + block.shape[k]) for k in columns))
        at = np.empty((len(rows), *(block.shape[k] for k in columns)))
        near = np.zeros(at.shape[1:], np.bool_)
        for along, k in zip(at, rows, strict=True):
            along[...] = self.offset[k]
            for column, number in zip(columns, index, strict=True):
                along += number * self.matrix[k, column]
            near |= _decides(along, block.limits[k], spline)
            along -= first[k]
        if near.any():
            values = np.empty((*(made.shape[k] for k in self.left), np.count_nonzero(near)), made.dtype)
            passes.at_points(window, rows, np.ascontiguousarray(at[:, near]), values, spline)
            made.transpose([*self.left, *columns])[..., near] = values


def _decides(positions: Floats, n: int, spline: Spline) -> NDArray[np.bool_]:
    """Where the function jumps within rounding of a position: at the outer samples, and halfway between samples in order 0."""
    slack = _ROUNDING * (n + np.abs(positions))
    near = np.zeros(positions.shape, np.bool_)
    if spline.order == 0:
        near |= np.abs(positions - np.floor(positions) - 0.5) <= slack
    if spline.mode == "constant":
        near |= (np.abs(positions) <= slack) | (np.abs(positions - (n - 1)) <= slack)
    elif spline.mode == "wrap":
        near |= np.abs(positions - np.rint(positions / max(n - 1, 1)) * max(n - 1, 1)) <= slack
    return near
