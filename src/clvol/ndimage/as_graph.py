"""Plans evaluated lazily, block by block: the samples and the result are arrays of dask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import dask.array as da
import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, UnsupportedError
from clvol.dask.blocks import (
    Array,
    Chunks,
    Floats,
    Margin,
    OutputBlock,
    Reads,
    Span,
    around,
    as_chunks,
    as_lazy,
    blockwise,
    checked_device,
    located,
    no_memory,
    own_part,
    refused,
    support_along,
    supports_along,
    touches,
)
from clvol.dask.reduced import axis_by_axis, gaussian_radius
from clvol.device import as_device
from clvol.filter.boundary import as_boundary
from clvol.filter.margin import reach
from clvol.interop.dispatch import is_lazy
from clvol.ndimage import engine, in_memory
from clvol.ndimage.antialiasing import nearest_along
from clvol.ndimage.arguments import (
    BOUNDARIES,
    FINITE,
    Spline,
    as_array,
    as_coordinates,
    as_dtype,
    require_coordinates,
    require_finite,
)
from clvol.ndimage.graph_of_points import at_points, margin_of
from clvol.ndimage.in_memory import InMemory
from clvol.ndimage.plan import Affine, Coefficients, Grid, Mapped, Plan, Points, Substrate
from clvol.spline.field import precision_kind

__all__ = ["AsGraph"]

_JUMPS = ("constant", "wrap")
"""Modes in which the function jumps at the outer samples, so that the last bit of a position decides there."""
_ROUNDING = 1e-12
"""Of positions, relative to their size."""


class AsGraph(Substrate):
    """An array of dask; or one in memory, for coordinates of dask. `chunks` are those of the result."""

    def __init__(self, input: Any, chunks: Chunks) -> None:
        self.source: Any = as_lazy(input) if is_lazy(input) else as_array(input)
        self.shape, self.dtype, self.chunks = self.source.shape, self.source.dtype, chunks

    def as_coordinates(self, coordinates: Any, count: int) -> Any:
        """Positions along `count` axes, checked; those of dask stay so."""
        if not is_lazy(coordinates):
            return as_coordinates(coordinates, count)
        at = as_lazy(coordinates, "coordinates", "biuf")
        require_coordinates(at.shape, count)
        return at

    def evaluate(self, plan: Plan) -> Any:
        """The result of a plan, an array of dask."""
        refused(plan.function, progress=plan.spline.progress)
        no_memory(plan.output)
        checked_device(plan.spline.device)
        return plan.on(self)

    def grid(self, plan: Grid) -> Any:
        """The spline on a grid along the axes."""
        dtype, sizes = self._layout(plan, plan.copied)
        if plan.nearest and not plan.copied and self.source.size and all(plan.shape):
            return _nearest(self.source, plan, sizes, dtype)
        return self._along(plan, sizes, dtype)

    def affine(self, plan: Affine) -> Any:
        """The spline on a grid that a matrix places: a block reads the box around its positions, and a margin."""
        dtype, chunks = self._layout(plan)
        source, spline = self.source, plan.spline
        matrix, offset = plan.of_all_axes(self.ndim)
        rows, columns = matrix.shape
        if rows == columns == len(plan.axes) and not (matrix - np.diag(np.diag(matrix))).any():
            positions = [
                None if (step, start, m) == (1, 0, n) else np.arange(m) * step + start
                for step, start, m, n in zip(np.diag(matrix).tolist(), offset.tolist(), plan.shape, self.shape, strict=True)
            ]
            grid = Grid(plan.function, spline, plan.output, plan.shape, positions)
            return self._along(grid, chunks, dtype)
        if not source.size:
            _require_samples(spline, self.shape, plan.shape)
        same = rows == columns and spline.interpolates
        left = [k for k in range(self.ndim) if k not in plan.axes or (same and _is_left(k, matrix, offset, plan.shape, self.shape))]
        moved = [k for k in range(self.ndim) if k not in left]
        in_memory.require_mixable(matrix, moved, columns > rows)
        reads = _boxes(spline, self.shape, matrix, offset, left, margin_of(spline, dtype))
        compute = _Affine(plan, dtype, matrix, offset, left)
        about = [*spline.identity, list(plan.axes), matrix, offset]
        return blockwise(plan.function, source, chunks, dtype, reads, compute, about)

    def points(self, plan: Points) -> Any:
        """The spline at points: see `clvol.ndimage.graph_of_points`."""
        dtype = self._dtype(plan)
        if not self.source.size:
            _require_samples(plan.spline, self.shape, plan.shape)
        return at_points(self.source, plan, self.chunks, dtype)

    def mapped(self, plan: Mapped) -> Any:
        """The spline where a function says. Which chunks a block needs is known once it has been called, so all are looked up."""
        in_memory.require_few(self.ndim)
        _, sizes = self._layout(plan)
        nothing = da.empty((), chunks=())  # positions are computed from indices alone
        about = [plan.mapping, plan.arguments, plan.keywords]
        called = _Called(plan, self.ndim)
        at = blockwise("positions", nothing, ((self.ndim,), *sizes), np.float64, lambda *_: (None, None), called, about)
        points = Points("map_coordinates", plan.spline, plan.output, plan.shape, range(self.ndim), at)
        return AsGraph(self.source, None).evaluate(points)

    def coefficients(self, plan: Coefficients) -> Any:
        """Spline coefficients, in the chunks of the samples."""
        spline, axes = plan.spline, plan.axes
        in_memory.require_global(spline)
        dtype = self._dtype(plan, not axes)
        depth = reach(engine.row_of(spline.order, True), spline.precision) if axes else 0
        rule = as_boundary(engine.FILTERED_AS.get(spline.mode, BOUNDARIES[spline.mode]))
        reads = around(self.shape, [depth if k in axes else 0 for k in range(self.ndim)], rule)
        about = [*spline.identity, list(axes)]
        return blockwise(plan.function, self.source, self.source.chunks, dtype, reads, _Filtered(plan, dtype), about)

    def _dtype(self, plan: Plan, copied: bool = False) -> np.dtype[Any]:
        """The dtype of the result; ``nan="local"`` is refused, which fills missing samples from all around them."""
        if plan.spline.local:
            raise UnsupportedError(
                'nan must be "propagate" or "error" for an array of dask, where missing samples may span blocks; got "local"'
            )
        return as_dtype(plan.output, self.dtype, copied=copied)

    def _layout(self, plan: Plan, copied: bool = False) -> tuple[np.dtype[Any], tuple[Any, ...]]:
        """The dtype and the chunks of the result."""
        dtype, ndim = self._dtype(plan, copied), len(plan.shape)
        alike = range(ndim) if ndim == self.ndim else [None] * ndim
        return dtype, as_chunks(self.chunks, self.source, plan.shape, alike, dtype)

    def _along(self, plan: Grid, chunks: tuple[Any, ...], dtype: np.dtype[Any]) -> Any:
        """The spline on a grid along the axes."""
        source, spline, positions, n = self.source, plan.spline, plan.positions, self.shape
        if not spline.interpolates and not plan.copied:
            positions = [np.arange(m, dtype=np.float64) if p is None else p for p, m in zip(positions, n, strict=True)]
        if not source.size and any(p is not None for p in positions):
            _require_samples(spline, n, plan.shape)
        boundary, depth = spline.boundary, margin_of(spline, dtype)
        supports = [
            supports_along(along, sizes, n[axis], boundary, depth, gaussian_radius(plan.sigma.get(axis, 0.0)))
            for axis, (along, sizes) in enumerate(zip(positions, chunks, strict=True))
        ]
        outside = spline.mode == "constant" and not plan.copied

        def reads(index: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...] | None, Any]:
            row = [along[i] for along, i in zip(supports, index, strict=True)]
            own = [None if one is None else one.positions for one in row]
            if outside and any(_all_outside(p, place, m) for p, place, m in zip(positions, where, n, strict=True)):
                return None, own
            return tuple(place if one is None else one.span for one, place in zip(row, where, strict=True)), own

        about = [*spline.identity, list(positions), plan.sigma, plan.copied]
        compute = _OnGrid(replace(plan, positions=()), dtype)
        return blockwise(plan.function, source, chunks, dtype, reads, compute, about)


def _require_samples(spline: Spline, shape: Sequence[int], result: Sequence[int]) -> None:
    """Refuse an input without samples where the mode does not say what its function is."""
    if all(result) and spline.mode not in ("constant", "grid-constant"):
        raise DataError(f'input must have samples where mode is not "constant" or "grid-constant"; got shape {tuple(shape)}')


def _all_outside(positions: Floats | None, place: Span, n: int) -> bool:
    if positions is None:
        return False
    own = positions[place[0] : place[1]]
    return bool(((own < 0) | (own > n - 1)).all())


def _is_left(k: int, matrix: Floats, offset: Floats, after: Sequence[int], before: Sequence[int]) -> bool:
    """Whether an axis is left as it is."""
    unit = np.zeros(len(matrix))
    unit[k] = 1
    same = bool((matrix[k] == unit).all() and (matrix[:, k] == unit).all())
    return same and offset[k] == 0 and after[k] == before[k]


def _boxes(spline: Spline, shape: tuple[int, ...], matrix: Floats, offset: Floats, left: list[int], depth: Margin) -> Reads:
    """What a block at ``matrix @ i + offset`` reads: the box around its positions, and a margin. Axes `left` are read as they are.

    Whether values are to be mended, since the last bit of a position may decide, is passed on to its computation.
    """
    boundary, moved = spline.boundary, [k for k in range(len(shape)) if k not in left]
    repeats = boundary.outside == "overlap" or (boundary.fold is None and boundary.period is not None)

    def reads(_: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...] | None, Any]:
        corners = np.array(list(product(*((low, high - 1) for low, high in where))), np.float64)
        at = corners @ matrix.T + offset
        low, high = at.min(0), at.max(0)
        slack = _ROUNDING * (np.array(shape) + np.abs(at).max(0))
        within = (low >= slack) & (high <= np.array(shape) - 1 - slack)
        inside = bool(within[moved].all())
        if spline.mode == "constant" and any(high[k] < -slack[k] or low[k] > shape[k] - 1 + slack[k] for k in moved):
            return None, None
        found = []
        for k, n in enumerate(shape):
            if k in left:
                found.append(where[k])
                continue
            span = (0, n)
            if not repeats or within[k]:
                span = support_along(np.array([low[k] - slack[k], high[k] + slack[k]]), n, boundary, depth).span
            if repeats and touches(span, n):  # kernels would fold positions by the length of the part
                span = (0, n)
            found.append(span)
        mended = len(moved) <= in_memory.NATIVE and (spline.order == 0 or (spline.mode in _JUMPS and not inside))
        return tuple(found), mended

    return reads


def _nearest(source: Any, plan: Grid, chunks: tuple[Any, ...], dtype: np.dtype[Any]) -> Any:
    """The least-squares spline on a coarser grid, as `clvol.ndimage.antialiasing.nearest_splines` computes it."""
    spline = plan.spline
    if source.dtype.kind == "c":
        half = np.empty(0, dtype).real.dtype
        parts = [
            _nearest(getattr(source, part), replace(plan, spline=spline.of_part(part, k)), chunks, half)
            for k, part in enumerate(("real", "imag"))
        ]
        return da.map_blocks(_complex, *parts, dtype=dtype, meta=np.empty((0,) * source.ndim, dtype))
    double = spline.precision == "double" or dtype.kind == "b"  # as `clvol.ndimage.engine.kind_for`
    shrunk = {axis: p for axis, p in enumerate(plan.positions) if p is not None}
    # as in one piece: the axis that shrinks most goes first
    order = sorted(shrunk, key=lambda axis: len(shrunk[axis]) / source.shape[axis])
    axes = [(axis, nearest_along(shrunk[axis], source.shape[axis], spline, double)) for axis in order]
    kind, ends, outside = precision_kind(spline.precision), _Ends(spline, dtype), float(spline.cval.real)
    about = [*spline.identity, axes, str(dtype)]
    return axis_by_axis(plan.function, source, chunks, dtype, axes, kind, ends, outside, spline.device, about)


def _complex(real: Array, imag: Array) -> Array:
    made = np.empty(real.shape, np.result_type(real, np.complex64))
    made.real, made.imag = real, imag
    return made


# -- in a worker -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Ends:
    """How sums begin and end."""

    spline: Spline
    dtype: np.dtype[Any]

    def begin(self, samples: Array, block: OutputBlock) -> tuple[type[np.generic], bool]:
        """The type of sums: double precision where single would lose digits of the samples; and whether these lie far from zero."""
        with located(samples, block, FINITE):
            require_finite(samples, self.spline.nan)
        kind = engine.kind_for(self.spline.precision, samples, np.empty(0, self.dtype), as_device(self.spline.device))
        return kind, engine.lies_far(samples)

    def end(self, values: Array, _: OutputBlock) -> Array:
        """In the type of the result."""
        return engine.converted(values, self.dtype)


@dataclass(frozen=True, eq=False)
class _Evaluated:
    """A block of the result: a plan for the samples that it reads, evaluated in memory."""

    plan: Any
    dtype: np.dtype[Any]

    def __call__(self, samples: Array | None, block: OutputBlock) -> Array:
        made = np.empty(block.shape, self.dtype)
        if samples is None:
            made[...] = in_memory.stored(self.plan.spline.cval, self.dtype)
            return made
        with located(samples, block, FINITE):
            require_finite(samples, self.plan.spline.nan)
        return self.into(made, samples, block)

    def into(self, made: Array, samples: Array, block: OutputBlock) -> Array:
        """The block's samples, in `made` or another array."""
        raise NotImplementedError


class _OnGrid(_Evaluated):
    def into(self, made: Array, samples: Array, block: OutputBlock) -> Array:
        replace(self.plan, positions=block.extra, shape=block.shape, output=made).on(InMemory(samples))
        return made


class _Filtered(_Evaluated):
    def into(self, _: Array, samples: Array, block: OutputBlock) -> Array:
        found = replace(self.plan, shape=samples.shape, output=self.dtype).on(InMemory(samples))
        return np.ascontiguousarray(found[own_part(block)])


@dataclass(frozen=True, eq=False)
class _Called:
    """Positions by a function of the index, called for one after the other."""

    plan: Mapped
    ndim: int

    def __call__(self, _: Array | None, block: OutputBlock) -> Array:
        ranges = [range(*place) for place in block.place[1:]]
        return in_memory.as_rows(list(map(self.plan.at, product(*ranges))), self.ndim).T.reshape(block.shape)


@dataclass(frozen=True, eq=False)
class _Affine(_Evaluated):
    matrix: Floats
    offset: Floats
    left: list[int]

    def into(self, made: Array, samples: Array, block: OutputBlock) -> Array:
        assert block.spans is not None
        first = np.array([start for start, _ in block.spans], np.float64)
        axes, matrix = list(self.plan.axes), self.matrix
        offset = self.offset + self.matrix @ np.asarray(block.start, np.float64) - first
        if len(axes) < samples.ndim:
            matrix, offset = matrix[np.ix_(axes, axes)], offset[axes]
        replace(self.plan, matrix=matrix, offset=offset, shape=block.shape, output=made).on(InMemory(samples))
        if block.extra:
            self._mend(made, samples, block, first)
        return made

    def _mend(self, made: Array, samples: Array, block: OutputBlock, first: Floats) -> None:
        """Compute anew where the last bit of a position decides, with positions as the whole array has them."""
        spline = self.plan.spline
        columns = [k for k in range(made.ndim) if k not in self.left] if self.left else list(range(made.ndim))
        rows = [k for k in range(samples.ndim) if k not in self.left]
        index = np.ix_(*(np.arange(*block.place[k]) for k in columns))
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
            in_memory.at_points(samples, rows, np.ascontiguousarray(at[:, near]), values, spline)
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
