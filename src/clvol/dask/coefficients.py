"""Coefficients of volumes, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.base.checks import whole
from clvol.base.errors import DataError
from clvol.dask.blocks import AnyDevice, Array, OutputBlock, around, as_lazy, blockwise, checked_device, located, own_part
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.margin import reach, require_settled
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline import field
from clvol.spline.field import Precision, precision_kind
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume

__all__ = ["as_volumes", "prefilter", "settled_row"]


def prefilter(
    data: Any,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    device: AnyDevice = None,
    *,
    precision: Precision = "single",
    dimensions: int | None = None,
) -> Any:
    """Spline coefficients of samples, as `clvol.prefilter` computes them, in the chunks of the samples.

    Parameters
    ----------
    data : dask.array.Array
        Of any integer or floating dtype. Chunks may be of any size, but blocks shorter than the prefilter's `reach` read most of
        their neighbours.
    filter, boundary, device, precision
        As for `clvol.prefilter`; smoothing "auto", which depends on all samples, is refused.
    dimensions : int, optional
        The number of last axes that span a volume, 1 to 3; each index of the others is a separate volume. By default all, at
        most 3.

    Returns
    -------
    dask.array.Array of float32, or of float64 in double precision
        Coefficients along one axis differ from those of the array in one piece by ``2⁻²⁴ G R`` at most, or by ``10⁻¹⁴ G R`` in
        double precision, G being the sum of the prefilter's weights and R the range of the samples (see `reach`), and by rounding.
        The largest that coefficients may be is G times the samples.

    Raises
    ------
    DataError
        The array has no axis or no sample, does not hold real numbers in arrays of NumPy, or has chunks of unknown sizes. While it
        is computed: a sample is NaN or infinite; the message has its index.
    OptionError
        As for `clvol.prefilter`.

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
    plan = around(source.shape, margins, rule)
    return blockwise("prefilter", source, source.chunks, kind, plan, compute, [row, rule, precision, repr(device), count])


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
