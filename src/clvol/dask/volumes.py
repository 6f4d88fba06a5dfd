"""Coefficients of volumes and volumes on other grids, block by block: `clvol.prefilter`, `resample` and `magnify` for dask.

`clvol.interop.dispatch.with_dask` calls these with every argument of the function of the same name, which documents them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol.base.checks import flag, whole
from clvol.base.errors import DataError, OptionError, UnsupportedError
from clvol.base.rounding import as_kind, in_kind, wide
from clvol.dask.blocks import (
    AnyDevice,
    Array,
    Chunks,
    Floats,
    OutputBlock,
    Span,
    around,
    as_chunks,
    as_lazy,
    blockwise,
    checked_device,
    located,
    margin,
    own_part,
    refused,
    supports_along,
)
from clvol.dask.reduced import axis_by_axis, gaussian_radius
from clvol.device import as_device
from clvol.filter.boundary import Boundary, as_boundary, chosen_boundary
from clvol.filter.filter import Filter
from clvol.filter.margin import reach, require_settled
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline import field
from clvol.spline.evaluator import DIRECT, choose_evaluator
from clvol.spline.field import Precision, coefficients_of, precision_kind
from clvol.spline.function import fill_value
from clvol.spline.grids import Anchor, beyond, grid_for
from clvol.spline.points import Given
from clvol.spline.reduce import AntiAliasing, Sums, as_anti_aliasing, least_squares, lies_far, low_passed
from clvol.spline.regions import Regions, as_label, region_boundary, region_filter, require_no_blending
from clvol.spline.resample import along_axes, resample_axes, resample_coefficients
from clvol.volume.smoothing import settled
from clvol.volume.stored import wide_enough
from clvol.volume.volume import Volume

__all__ = ["as_volumes", "magnify", "prefilter", "resample", "settled_row"]


def prefilter(
    data: Any, filter: str | Filter, boundary: str | Boundary, device: AnyDevice, precision: Precision, dimensions: int | None
) -> Any:
    """Coefficients, in the chunks of the samples."""
    kind = precision_kind(precision)
    source, count = as_volumes(data, dimensions, least=1)
    row, rule = as_filter(filter), as_boundary(boundary)
    row = settled_row(row.magnified_by or row, source.shape[-count:])
    compute = _Prefilter(row, rule, precision, checked_device(device), count, np.dtype(kind))
    margins = [0] * (source.ndim - count) + [reach(row.along(axis), precision) for axis in reversed(range(count))]
    plan = around(source.shape, margins, rule)
    return blockwise("prefilter", source, source.chunks, kind, plan, compute, [row, rule, precision, repr(device), count])


def resample(
    volume: Any,
    shape: Sequence[int] | None,
    spacing: Sequence[float] | float | None,
    like: object,
    anchor: Anchor,
    transform: object,
    anti_aliasing: AntiAliasing | bool,
    progress: object,
    out: object,
    chunks: Chunks,
    dimensions: int | None,
    **options: Any,
) -> Any:
    """Volumes on another grid."""
    refused("resample", like=like, transform=transform, progress=progress, out=out)
    source, count = as_volumes(volume, dimensions, least=2)
    own = source.shape[-count:]
    grid = grid_for(Volume(np.broadcast_to(np.float32(0), own)), shape, spacing, None, anchor)
    steps = np.asarray(grid.spacing)[::-1]
    starts = np.asarray(grid.origin)[::-1]
    positions = []
    for start, step, m in zip(starts.tolist(), steps.tolist(), grid.shape, strict=True):
        positions.append(np.asarray(start + step * np.arange(m), np.float64))
    work, low_pass = _Work.of(source, count, **options), as_anti_aliasing(anti_aliasing)
    if work.smooth:
        require_no_blending(anti_aliasing=low_pass)
    return _on_grid("resample", source, positions, steps, low_pass, work, chunks)


def magnify(volume: Any, factor: int, progress: object, chunks: Chunks, dimensions: int | None, **options: Any) -> Any:
    """Volumes with `factor` times the samples along each axis."""
    refused("magnify", progress=progress)
    factor = whole("factor", factor, minimum=1)
    source, count = as_volumes(volume, dimensions, least=2)
    positions = [np.asarray(1 / factor * np.arange(factor * n), np.float64) for n in source.shape[-count:]]
    work = _Work.of(source, count, **options)
    return _on_grid("magnify", source, positions, np.full(count, 1 / factor), None, work, chunks)


def as_volumes(data: Any, dimensions: int | None, least: int) -> tuple[Any, int]:
    """An array of dask of real samples, and the number of its last axes that span a volume."""
    source = as_lazy(data, "data", "biuf")
    if source.ndim < least or not source.size:
        raise DataError(f"data must have at least {least} axes and one sample; got shape {source.shape}")
    if dimensions is None:
        return source, min(source.ndim, 3)
    return source, whole("dimensions", dimensions, least, min(source.ndim, 3))


def settled_row(row: Filter, shape: Sequence[int], spacing: Sequence[float] = ()) -> Filter:
    """The filter for samples at distances of 1, or of `spacing`; smoothing "auto" is refused."""
    for one in (row, row.magnified_by):
        if one is not None and one.smoothing == "auto":
            require_settled(one)
    if len(shape) < 2 and row.settled and not isinstance(row.smoothing, tuple):
        return row
    return settled(row, Volume(np.broadcast_to(np.float32(0), shape if len(shape) > 1 else (1, *shape)), tuple(spacing)))


@dataclass(frozen=True, eq=False)
class _Prefilter:
    filter: Filter
    boundary: Boundary
    precision: Precision
    device: Any
    count: int
    dtype: np.dtype[Any]

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        made = np.empty(block.shape, self.dtype)
        own = own_part(block)[-self.count :]
        with located(samples, block, "samples must be finite"):
            for index in np.ndindex(samples.shape[: -self.count]):
                one = field.prefilter(samples[index], self.filter, self.boundary, self.device, precision=self.precision)
                made[index] = one[own]
        return made


@dataclass(frozen=True, eq=False)
class _Work:
    """Options that all blocks share; `wide`: single precision gives way to double on devices that have it."""

    filter: Filter
    boundary: Boundary
    precision: Precision
    wide: bool
    dtype: np.dtype[Any]
    fill: float | None
    device: Any
    count: int
    smooth: bool

    @classmethod
    def of(
        cls,
        source: Any,
        count: int,
        filter: str | Filter | None,
        boundary: str | Boundary | None,
        device: AnyDevice,
        precision: Precision | None,
        nan: object,
        dtype: DTypeLike | None = None,
        fill: float | None = None,
        smooth: bool = False,
    ) -> _Work:
        """Options, checked; no device is looked up."""
        if flag("smooth", smooth):
            require_no_blending(precision=precision, nan=nan)
            dtype = source.dtype if dtype is None else dtype
            as_label("fill", fill or 0, source.dtype)
        if nan not in (None, "error"):
            raise UnsupportedError(f'nan must be "error" for an array of dask, where missing samples may span blocks; got {nan!r}')
        chosen_filter = region_filter(filter) if smooth else as_filter(DEFAULT_FILTER if filter is None else filter)
        row = settled_row(chosen_filter, source.shape[-count:])
        fill = fill_value(fill)
        kind = None if dtype is None else as_kind(dtype, source.dtype)
        if kind is not None and kind.kind != "f" and fill is not None and np.isnan(fill):
            raise OptionError(f"fill must be a number that {kind} holds; got {fill!r}")
        more = precision is None and kind is not None and wide(kind)
        wider = precision == "double" or (precision is None and wide(source.dtype))
        made = np.dtype(np.float64 if wider else precision_kind(precision or "single"))
        chosen: Precision = "double" if more else precision or "single"
        return cls(
            row,
            region_boundary(boundary) if smooth else chosen_boundary(boundary),
            chosen,
            more,
            made if kind is None else kind,
            fill,
            checked_device(device),
            count,
            smooth,
        )

    def here(self) -> tuple[Any, type[np.generic]]:
        """The device of this process, and the type of the computation."""
        device = as_device(self.device)
        return device, precision_kind("single" if self.wide and not device.has_double else self.precision)

    @property
    def identity(self) -> list[object]:
        """What distinguishes it from others, for keys of tasks."""
        return [self.filter, self.boundary, self.precision, self.wide, repr(self.fill), repr(self.device), self.count, self.smooth]


def _on_grid(
    name: str, source: Any, positions: list[Floats], steps: Floats, low_pass: AntiAliasing, work: _Work, chunks: Chunks
) -> Any:
    """A grid along the axes of volumes, at positions in samples."""
    leading = source.ndim - work.count
    shape = (*source.shape[:leading], *(len(p) for p in positions))
    sizes = as_chunks(chunks, source, shape, range(source.ndim), work.dtype)
    reductions: list[partial[Sums]] = []
    supports: list[list[Any]] = []
    sigma = np.maximum(0, (steps - 1) / 2) if low_pass == "gaussian" else np.zeros(work.count)
    for k, (along, n) in enumerate(zip(positions, source.shape[leading:], strict=True)):
        row = work.filter if work.filter.magnified_by else work.filter.along(work.count - 1 - k)
        if low_pass == "least-squares":
            reductions.append(_reduction(row, along, float(steps[k]), n, work))
            continue
        reach, more = margin(row, work.precision), gaussian_radius(float(sigma[k]))
        supports.append(supports_along(along, sizes[leading + k], n, work.boundary, reach, more))

    def plan(index: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...], Any]:
        row = [along[i] for along, i in zip(supports, index[leading:], strict=True)]
        return (*where[:leading], *(one.span for one in row)), [one.positions for one in row]

    past = None
    if work.fill is not None:
        first = np.array([p[0] for p in positions[::-1]])
        past = beyond(np.diag(steps[::-1]), first, source.shape[leading:], shape[leading:], work.boundary)
    about = [*work.identity, positions, low_pass]
    if not reductions:
        return blockwise(name, source, sizes, work.dtype, plan, _Sampled(work, steps, low_pass == "gaussian", past), about)
    # as in one piece: the axis that shrinks most goes first, x before y and z
    order = sorted(range(work.count - 1, -1, -1), key=lambda k: len(positions[k]) / source.shape[leading + k])
    axes, kind, ends = [(leading + k, reductions[k]) for k in order], precision_kind(work.precision), _LeastSquares(work, past)
    return axis_by_axis(name, source, sizes, work.dtype, axes, kind, ends, work.boundary.cval, work.device, about)


def _reduction(row: Filter, along: Floats, step: float, n: int, work: _Work) -> partial[Sums]:
    if row.prefilter and work.boundary.period is None:
        raise OptionError(f"least-squares reduction takes a boundary rule that continues the samples; got {work.boundary.name!r}")
    if row.magnified_by is not None:
        raise OptionError(f"least-squares reduction takes a filter with one kernel; got the hybrid {row.name!r}")
    return partial(least_squares, row, float(along[0]), step, len(along), n, work.boundary, work.precision == "double")


@dataclass(frozen=True, eq=False)
class _Sampled:
    work: _Work
    steps: Floats
    smooth: bool
    past: list[NDArray[np.bool_]] | None

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        made = np.empty(block.shape, self.work.dtype)
        with located(samples, block, "samples must be finite"):
            for index in np.ndindex(samples.shape[: -self.work.count]):
                values = self._one(samples[index], block.extra)
                _fill(values, self.past, block, self.work)
                made[index] = in_kind(values, self.work.dtype)
        return made

    def _one(self, samples: Array, positions: list[Floats]) -> Array:
        device, kind = self.work.here()
        row, boundary = self.work.filter, self.work.boundary
        volume = Volume(samples)
        if self.work.smooth:
            with Regions(volume, row, boundary, device) as regions:
                return regions.along_axes(positions[::-1])
        if self.smooth:
            volume = low_passed(volume, self.steps[::-1], boundary, kind, device)
        given, shape = Given(), tuple(map(len, positions))
        evaluator = choose_evaluator(device, row, double=kind == np.float64)
        result = np.empty(shape, kind)
        with coefficients_of(volume, row, boundary, device, kind) as made, device.buffers.lent(result, write=True) as buffer:
            if along_axes(made, DIRECT):
                resample_axes(made, positions[::-1], buffer, given)
            else:
                first = np.array([p[0] for p in positions[::-1]])
                resample_coefficients(made, evaluator, np.diag(self.steps[::-1]), first, (1, *shape)[-3:], buffer, given)
            stored = made
        return given.in_units_of_data(stored, result, 0)


@dataclass(frozen=True, eq=False)
class _LeastSquares:
    work: _Work
    past: list[NDArray[np.bool_]] | None

    def begin(self, samples: Array, block: OutputBlock) -> tuple[type[np.generic], bool]:
        """The type of sums: float64 where float32 would lose digits of the samples; and whether some lie far from zero."""
        (_, kind), far = self.work.here(), False
        with located(samples, block, "samples must be finite"):
            for index in np.ndindex(samples.shape[: -self.work.count]):
                volume = Volume(samples[index])
                volume.require_finite()
                kind = wide_enough(kind, volume, self.work.filter, self.work.boundary)
                far |= lies_far(volume)
        return kind, far

    def end(self, values: Array, block: OutputBlock) -> Array:
        """A block of the result."""
        for index in np.ndindex(values.shape[: -self.work.count]):
            _fill(values[index], self.past, block, self.work)
        return in_kind(values, self.work.dtype)


def _fill(values: Array, past: list[NDArray[np.bool_]] | None, block: OutputBlock, work: _Work) -> None:
    """Write `fill` outside the domain, which parts do not know where the rule repeats the samples."""
    for k, along in enumerate(past or []):
        first = block.start[len(block.start) - work.count + k]
        np.moveaxis(values, k, 0)[along[first : first + values.shape[k]]] = work.fill
