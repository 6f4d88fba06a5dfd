"""The sizes of a pyramid, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from clvol.base.arrays import reals
from clvol.base.checks import one_of, whole
from clvol.base.rounding import in_kind, wide
from clvol.dask.blocks import AnyDevice, Array, Chunks, OutputBlock, as_chunks, checked_device, located
from clvol.dask.reduced import axis_by_axis
from clvol.dask.volumes import as_volumes, settled_row
from clvol.device import as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline.field import Precision, precision_kind
from clvol.spline.levels import METHODS, ORDER, Method, filter_at, levels_of, require_reducible, sums_for
from clvol.volume.volume import Volume

__all__ = ["pyramid"]


def pyramid(
    volume: Any,
    levels: int | None = None,
    *,
    filter: str | Filter | None = None,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    spacing: Sequence[float] | float | None = None,
    method: Method | None = None,
    device: AnyDevice = None,
    precision: Precision | None = None,
    chunks: Chunks = None,
    dimensions: int | None = None,
) -> list[Any]:
    """Volumes in several sizes, each half of that before, as `clvol.pyramid` stores them, as arrays of dask.

    Parameters
    ----------
    volume : dask.array.Array
    levels : int, optional
        Sizes, the volume's own included; by default until none has more samples along an axis than the longest chunk of `volume`.
    filter : str or Filter, optional
        Of the function that the smaller sizes are nearest to. Default "bspline3"; its smoothing is not "auto", which depends on the
        samples.
    boundary : str or Boundary
        The extension past the outer samples.
    spacing : float or sequence of float, optional
        Between samples along x, y and z, by default 1: axes along which they lie far apart wait until the others do too, and a
        filter's lengths are in its unit.
    method : {"least-squares", "average", "nearest"}, optional
        As of `clvol.pyramid`; "least-squares" is the default, "nearest" for labels, which are never blended.
    device : Device, str or int, optional
        See `as_device`; looked up by each process.
    precision : {"single", "double"}, optional
        In which sums are made; by default single, and double for types with more digits, where the device has it.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of each smaller size. By default as long as the longest of the size before.
    dimensions : int, optional
        The number of last axes that span a volume, 2 or 3; each index of the others is a separate volume. By default all, at
        most 3.

    Returns
    -------
    list of dask.array.Array, of the volume's dtype
        `volume` first. Whole numbers are rounded, and clipped. Sample i of a size lies at ``step * i + (step - 1) / 2`` in samples
        of that before, where `step` is 2, or 1 along axes that wait. By default they are those that `clvol.pyramid` stores to the
        last bit, whatever the chunks.

    Raises
    ------
    DataError
        As `clvol.prefilter` raises it.
    GeometryError, OptionError
        As `clvol.pyramid` raises them.

    Examples
    --------
    >>> for number, level in enumerate(clvol.dask.pyramid(volume, 4)):
    ...     level.to_zarr(f"scan.zarr/{number}")
    """
    source, count = as_volumes(volume, dimensions, least=2)
    own = source.shape[-count:]
    given = np.ravel(reals("spacing", 1.0 if spacing is None else spacing, "a number, or one for each axis"))
    apart = Volume(np.broadcast_to(np.float32(0), own), tuple(given.tolist()) * (count if given.size == 1 else 1)).spacing
    row = settled_row(as_filter(DEFAULT_FILTER if filter is None else filter), own, apart)
    rule, how = as_boundary(boundary), method or "least-squares"
    if how not in METHODS:
        raise one_of("method", method, METHODS)
    require_reducible(how, row, rule)
    longest = max(max(sizes) for sizes in source.chunks[-count:])
    missing = (1,) * (3 - count)  # of an image the axis along z
    sizes = levels_of((*own[::-1], *missing), (*apart, *missing), None if levels is None else whole("levels", levels, 1), longest)
    more = precision is None and wide(source.dtype)
    chosen: Precision = "double" if more else precision or "single"
    precision_kind(chosen)
    found = [source]
    for number, level in enumerate(sizes[1:]):
        before = found[-1]
        steps, leading = level.steps[:count][::-1], before.ndim - count
        made = filter_at(row, number)
        shape = (*before.shape[:leading], *level.shape[3 - count :])
        into = as_chunks(chunks, before, shape, range(before.ndim), before.dtype)
        axes = []
        for axis in ORDER:
            k = axis - (3 - count)
            if k >= 0 and steps[k] > 1:
                n = before.shape[leading + k]
                axes.append((leading + k, partial(sums_for, how, made.along(count - 1 - k), rule, steps[k], n, chosen == "double")))
        ends = _Ends(count, chosen, more, checked_device(device), before.dtype)
        about = [axes, chosen, more, repr(device)]
        kind, outside = precision_kind(chosen), rule.cval
        found.append(axis_by_axis("pyramid", before, into, before.dtype, axes, kind, ends, outside, ends.device, about))
    return found


@dataclass(frozen=True, eq=False)
class _Ends:
    """How sums begin, and what becomes of them."""

    count: int
    precision: Precision
    wide: bool
    device: Any
    dtype: np.dtype[Any]

    def begin(self, samples: Array, block: OutputBlock) -> tuple[type[np.generic], bool]:
        """The type of sums, as `clvol.pyramid` makes them."""
        with located(samples, block, "samples must be finite"):
            for index in np.ndindex(samples.shape[: -self.count]):
                Volume(samples[index]).require_finite()
        return precision_kind("single" if self.wide and not as_device(self.device).has_double else self.precision), False

    def end(self, values: Array, _: OutputBlock) -> Array:
        """Rounded to the volume's type."""
        return in_kind(values, self.dtype)
