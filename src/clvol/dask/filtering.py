"""From samples to coefficients, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.base.checks import whole
from clvol.base.errors import DataError, OptionError, UnsupportedError
from clvol.dask.blocks import Array, Block, Plan, Span, as_lazy, blockwise, checked_device, located, no_memory, refused
from clvol.dask.margins import Margin, margin, reach, require_settled
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.ndimage import engine, interpolation
from clvol.ndimage.arguments import AnyDevice, Spline, as_axis, as_mode, as_order, as_output
from clvol.spline import field
from clvol.spline.field import Precision, precision_kind
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume

__all__ = ["as_volumes", "checked_spline", "prefilter", "settled_row", "spline_filter", "spline_filter1d", "splines_margin"]


def prefilter(
    data: Any,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    device: AnyDevice = None,
    *,
    precision: Precision = "single",
    dimensions: int | None = None,
) -> Any:
    """Spline coefficients of samples, as `clvol.prefilter` gives them, in the chunks of the samples.

    Parameters
    ----------
    data : dask.array.Array
        Of any integer or floating dtype. Chunks may be of any size, but blocks shorter than the prefilter's `reach` read most of
        their neighbours.
    filter, boundary, device, precision
        As of `clvol.prefilter`; a smoothing "auto" is refused, since it is decided from all samples.
    dimensions : int, optional
        How many of the last axes are a volume's, 1 to 3; every index of the others is one of its own. By default all, at most 3.

    Returns
    -------
    dask.array.Array of float32, or of float64 in double precision
        Coefficients along one axis differ from those of the array in one piece by ``2⁻²⁴ G R`` at most, or by ``10⁻¹⁴ G R`` in
        double precision, G being the sum of the prefilter's weights and R the range of the samples (see `reach`), and by rounding.
        The largest that coefficients may be is G times the samples.

    Raises
    ------
    DataError
        The array has no axis or no sample, does not hold real numbers in arrays of NumPy, or has chunks of unknown sizes; when it
        is computed: a sample is NaN or infinite, whose index is told.
    OptionError
        As `clvol.prefilter` raises it.

    Notes
    -----
    Samples that lie far from zero compared with their range are filtered with all their digits, but coefficients of single
    precision are rounded to float32, while `clvol.prefilter` then gives float64.
    """
    kind = precision_kind(precision)
    source, count = as_volumes(data, dimensions, least=1)
    row, rule = as_filter(filter), as_boundary(boundary)
    row = settled_row(row.magnified_by or row, source.shape[-count:])
    compute = _Prefilter(row, rule, precision, checked_device(device), count, np.dtype(kind))
    margins = [0] * (source.ndim - count) + [reach(row.along(axis), precision) for axis in reversed(range(count))]
    plan = _around(source.shape, margins, rule)
    return blockwise("prefilter", source, source.chunks, kind, plan, compute, [row, rule, precision, repr(device), count])


def spline_filter(
    input: Any,
    order: int = 3,
    output: Any = np.float64,
    mode: str = "mirror",
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """The coefficients of an array's spline along all axes, as `clvol.ndimage.spline_filter` gives them, in the array's chunks.

    Parameters
    ----------
    input : dask.array.Array
    order, output, mode, precision, device, nan
        As of `clvol.ndimage.spline_filter`; `output` is a dtype, and `progress` is dask's own. A NaN that is propagated stays
        within the blocks that read it.

    Returns
    -------
    dask.array.Array
        It differs from the result in one piece as `prefilter` does, and whole numbers, which are cut off, by 1 where a coefficient
        lies so near to one.

    Raises
    ------
    ClvolError
        As `clvol.ndimage.spline_filter` raises it, and as `prefilter` for arrays of dask that cannot be read.
    """
    return _filtered("spline_filter", input, as_order(order, minimum=2), None, output, mode, precision, device, nan, progress)


def spline_filter1d(
    input: Any,
    order: int = 3,
    axis: int = -1,
    output: Any = np.float64,
    mode: str = "mirror",
    *,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """The coefficients of an array's spline along one axis, as `clvol.ndimage.spline_filter1d` gives them; see `spline_filter`.

    Parameters
    ----------
    input : dask.array.Array
    order, axis, output, mode, precision, device, nan
        As of `clvol.ndimage.spline_filter1d`.

    Returns
    -------
    dask.array.Array
        In the chunks of `input`.
    """
    return _filtered("spline_filter1d", input, as_order(order), axis, output, mode, precision, device, nan, progress)


def _filtered(
    name: str,
    input: Any,
    order: int,
    axis: int | None,
    output: Any,
    mode: str,
    precision: Precision | None,
    device: AnyDevice,
    nan: str,
    progress: None,
) -> Any:
    refused(name, progress=progress)
    source = as_lazy(input)
    spline, dtype = checked_spline(
        source, output, order, mode, 0.0, True, precision, nan, copied=order < 2 or source.ndim == 0, local=False
    )
    along = list(range(source.ndim)) if axis is None else [as_axis(axis, source.ndim)] if order > 1 else []
    row = engine.row_of(order, True)
    margins = [reach(row, spline.precision) if k in along and order > 1 else 0 for k in range(source.ndim)]
    rule = as_boundary(engine.FILTERED_AS.get(as_mode(mode), engine.BOUNDARIES[mode]))
    compute = _SplineFilter(order, axis, mode, precision, checked_device(device), nan, dtype)
    identity = [order, axis, mode, precision, repr(device), nan]
    return blockwise(name, source, source.chunks, dtype, _around(source.shape, margins, rule), compute, identity)


# -- arguments -------------------------------------------------------------------------------------------------------


def as_volumes(data: Any, dimensions: int | None, least: int) -> tuple[Any, int]:
    """An array of dask of real samples, and how many of its last axes are a volume's."""
    source = as_lazy(data, "data", "biuf")
    if source.ndim < least or not source.size:
        raise DataError(f"data must have at least {least} axes and one sample; got shape {source.shape}")
    if dimensions is None:
        return source, min(source.ndim, 3)
    return source, whole("dimensions", dimensions, least, min(source.ndim, 3))


def settled_row(row: Filter, shape: Sequence[int], spacing: Sequence[float] = ()) -> Filter:
    """A filter whose lengths are numbers, for samples at distances of 1, or of `spacing`; smoothing "auto" is refused."""
    for one in (row, row.magnified_by):
        if one is not None and one.smoothing == "auto":
            require_settled(one)
    if len(shape) < 2 and row.settled and not isinstance(row.smoothing, tuple):
        return row
    return settled(row, Volume(np.broadcast_to(np.float32(0), shape if len(shape) > 1 else (1, *shape)), tuple(spacing)))


def checked_spline(
    source: Any,
    output: Any,
    order: int,
    mode: str,
    cval: complex,
    prefilter: bool,
    precision: Precision | None,
    nan: str,
    *,
    copied: bool = False,
    local: bool = True,
) -> tuple[Spline, np.dtype[Any]]:
    """The options of a function of `clvol.ndimage`, and the dtype of its result; no device is looked for."""
    no_memory(output)
    none = np.empty((0,) * max(source.ndim, 1), source.dtype)
    dtype = as_output(output, none, none.shape, copied=copied).dtype
    spline = Spline.of(none, order, mode, cval, prefilter, precision, None, nan, None)
    if spline.local:
        refused_local(local)
    return spline, dtype


def refused_local(interpolates: bool) -> None:
    """Refuse ``nan="local"``, which fills gaps from all that is around them, across blocks."""
    if not interpolates:
        raise OptionError('nan must be "propagate" or "error" for coefficients, which depend on all samples; got "local"')
    raise UnsupportedError('nan must be "propagate" or "error" for an array of dask, whose gaps may span blocks; got "local"')


def splines_margin(spline: Spline, dtype: np.dtype[Any]) -> Margin:
    """How many samples before and after a position its value depends on; booleans are computed in double precision."""
    precision: Precision = "double" if dtype.kind == "b" else spline.precision
    return margin(engine.row_of(spline.order, spline.prefilter), precision)


# -- blocks ----------------------------------------------------------------------------------------------------------


def _around(shape: Sequence[int], margins: Sequence[int], boundary: Boundary) -> Plan:
    """Each block reads itself and a margin along each axis; a rule that repeats the samples has one at the edges too."""
    repeated = boundary.period is not None and boundary.fold is None

    def along(n: int, margin: int, place: Span) -> Span:
        low, high = place[0] - margin, place[1] + margin
        if place == (0, n) or (repeated and margin and high - low >= n):
            return (0, n)
        return (low, high) if repeated and margin else (max(low, 0), min(high, n))

    def plan(_: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...], None]:
        return tuple(map(along, shape, margins, where)), None

    return plan


def _own(block: Block) -> tuple[slice, ...]:
    """Where a block lies in its window."""
    assert block.spans is not None
    own = []
    for start, length, (low, _) in zip(block.start, block.shape, block.spans, strict=True):
        own.append(slice(start - low, start - low + length))
    return tuple(own)


@dataclass(frozen=True, eq=False)
class _Prefilter:
    filter: Filter
    boundary: Boundary
    precision: Precision
    device: Any
    count: int
    dtype: np.dtype[Any]

    def __call__(self, window: Array, block: Block) -> Array:
        made = np.empty(block.shape, self.dtype)
        own = _own(block)[-self.count :]
        with located(window, block, "samples must be finite"):
            for index in np.ndindex(window.shape[: -self.count]):
                made[index] = field.prefilter(window[index], self.filter, self.boundary, self.device, precision=self.precision)[own]
        return made


@dataclass(frozen=True, eq=False)
class _SplineFilter:
    order: int
    axis: int | None
    mode: str
    precision: Precision | None
    device: Any
    nan: str
    dtype: np.dtype[Any]

    def __call__(self, window: Array, block: Block) -> Array:
        options: dict[str, Any] = {"precision": self.precision, "device": self.device, "nan": self.nan}
        with located(window, block, 'with nan="error" all samples must be finite'):
            if self.axis is None:
                made = interpolation.spline_filter(window, self.order, self.dtype, self.mode, **options)
            else:
                made = interpolation.spline_filter1d(window, self.order, self.axis, self.dtype, self.mode, **options)
        return np.ascontiguousarray(made[_own(block)])
