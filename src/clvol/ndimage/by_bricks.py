"""Plans evaluated brick by brick: the samples are those of a `LazyVolume`, the result is in memory.

Values differ by less than 10⁻⁶ of the samples' range (order 5: 4 · 10⁻⁶) from those of the array in memory. All is computed in
single precision.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolWarning, OutOfMemoryError, UnsupportedError
from clvol.bricks.field import BrickedField
from clvol.bricks.source import LazyVolume
from clvol.ndimage.antialiasing import nearest_sums
from clvol.ndimage.arguments import Array, Spline, as_dtype, as_output, warn
from clvol.ndimage.engine import converted, row_of
from clvol.ndimage.plan import Affine, Coefficients, Grid, Mapped, Plan, Points, Substrate
from clvol.spline.reduce import gaussian

__all__ = ["ByBricks", "instead"]

_BLOCK = 96  # results along an edge of a block, whose positions are in memory at a time: neighbours share bricks
_POINTS = 1 << 22  # points at a time

_INSTEAD = (
    "arrays of dask are evaluated block by block (dask.array.from_array(volume.data), dask.array.from_zarr), and "
    "volume.whole().data is all of it in memory"
)

_Floats = NDArray[np.float64]


def instead(data: Array, plan: Plan, refused: OutOfMemoryError) -> Array:
    """The result of a plan whose array has no room in memory, with a warning; refused where bricks would give other values."""
    if as_dtype(plan.output, data.dtype).kind == "b":
        raise UnsupportedError("booleans are computed in double precision")
    if isinstance(plan.output, np.ndarray) and np.may_share_memory(plan.output, data):
        raise UnsupportedError("bricks are read after results are written, so output must not overlap input")
    return ByBricks(LazyVolume(data), refused).evaluate(plan)


class ByBricks(Substrate):
    """A volume that is read part by part. A field is used as it is, and stays open.

    A warning says `because` of what the caller's array is not evaluated in memory, before the first brick is read.
    """

    precision = "single"

    def __init__(self, input: LazyVolume | BrickedField, because: OutOfMemoryError | None = None) -> None:
        self._given: BrickedField | None
        self._given, self._volume = (input, input.volume) if isinstance(input, BrickedField) else (None, input)
        self._because = because
        stand_in = self._volume.grid.data  # zeros that take no memory
        self.shape, self.dtype = stand_in.shape, stand_in.dtype

    def evaluate(self, plan: Plan) -> Array:
        """The result of a plan."""
        spline = plan.spline
        if spline.precision != self.precision:
            self._refuse(plan, f"precision={spline.precision!r}")
        if spline.local:
            self._refuse(plan, "nan='local'")
        if spline.labels:
            self._refuse(plan, "order='labels'")
        return plan.on(self)

    def grid(self, plan: Grid) -> Array:
        """The spline on a grid along the axes."""
        lines = [np.arange(n, dtype=np.float64) if p is None else p for p, n in zip(plan.positions, plan.shape, strict=True)]

        def places(block: tuple[slice, ...]) -> _Floats:
            at = np.meshgrid(*(line[part] for line, part in zip(lines, block, strict=True)), indexing="ij")
            return np.stack(at).reshape(3, -1)

        result = self._result(plan)
        with self._field(plan) as field:
            if plan.nearest and result.size:
                return self._nearest(field, plan, result)
            with self._low_passed(field, plan) as smooth:
                return _by_blocks(smooth, places, result, plan.spline)

    def affine(self, plan: Affine) -> Array:
        """The spline on a grid that a matrix places."""
        if len(plan.axes) < self.ndim and not plan.spline.interpolates:  # coefficients would be blended along the other axes too
            self._refuse(plan, "prefilter=False")
        matrix, offset = plan.of_all_axes(self.ndim)

        def places(block: tuple[slice, ...]) -> _Floats:
            index = np.meshgrid(*(np.arange(part.start, part.stop, dtype=np.float64) for part in block), indexing="ij")
            flat = np.stack(index).reshape(len(block), -1)
            found = np.repeat(offset[:, None], flat.shape[1], axis=1)
            for column, line in zip(matrix.T, flat, strict=True):  # summed in SciPy's order
                found += column[:, None] * line
            return found

        result = self._result(plan)
        with self._field(plan) as field:
            return _by_blocks(field, places, result, plan.spline)

    def points(self, plan: Points) -> Array:
        """The spline at points. Points that are neighbours in space should be neighbours in `coordinates`."""
        if len(plan.axes) < self.ndim:
            self._refuse(plan, f"axes={list(plan.axes)}")
        spline, result = plan.spline, self._result(plan)
        with self._field(plan) as field:
            flat, values = plan.coordinates.reshape(3, -1), np.empty(math.prod(result.shape), result.dtype)
            for first in range(0, flat.shape[1], _POINTS):
                some = slice(first, min(first + _POINTS, flat.shape[1]))
                values[some] = converted(_values(field, flat[:, some].astype(np.float64), spline), result.dtype)
                if spline.progress:
                    spline.progress(some.stop / flat.shape[1])
            result[...] = values.reshape(result.shape)
        return result

    def mapped(self, plan: Mapped) -> NoReturn:
        """Refused."""
        self._refuse_all(plan, "map_coordinates does, at the positions that the function gives")

    def coefficients(self, plan: Coefficients) -> NoReturn:
        """Refused."""
        self._refuse_all(plan, "its coefficients are as many as the samples")

    def _refuse(self, plan: Plan, option: str) -> NoReturn:
        raise UnsupportedError(f"{plan.function} of a volume that is read part by part takes no {option}: {_INSTEAD}")

    def _refuse_all(self, plan: Plan, why: str) -> NoReturn:
        raise UnsupportedError(f"{plan.function} takes no volume that is read part by part: {why}; {_INSTEAD}")

    def _result(self, plan: Plan) -> Array:
        """The array for the result; warns where the caller did not ask for bricks."""
        result = as_output(plan.output, self.dtype, plan.shape)
        if self._because is not None:
            warn(
                f"{plan.function} goes by bricks, since not all fits in memory ({self._because}): values differ by less than 1e-6 "
                "of the samples' range (order 5: 4e-6) from those computed in memory",
                ClvolWarning,
            )
        return result

    def _field(self, plan: Plan) -> AbstractContextManager[BrickedField]:
        """The field for the time of a call."""
        spline, given = plan.spline, self._given
        row, boundary = row_of(spline.order, spline.prefilter), spline.boundary_with_cval
        if given is None:
            return BrickedField(self._volume, row, boundary, spline.device)
        if (given.filter.name, given.boundary) != (row.name, boundary):
            raise UnsupportedError(
                f"{plan.function} of a BrickedField takes its own filter and boundary rule, {given.filter.name!r} and "
                f"{given.boundary.name!r}; got order {spline.order} and mode {spline.mode!r}: give its volume"
            )
        return nullcontext(given)

    def _low_passed(self, field: BrickedField, plan: Grid) -> AbstractContextManager[BrickedField]:
        """The field of the samples after a Gaussian: see `clvol.ndimage.antialiasing.low_passed`."""
        boundary = plan.spline.boundary
        sums = {axis: gaussian(float(s), self.shape[axis], boundary) for axis, s in plan.sigma.items() if s > 0}
        if not sums:
            return nullcontext(field)
        samples = field.store.summed(sums, np.float32, float(plan.spline.cval.real))
        smooth = LazyVolume(samples, limits=self._volume.limits, labels=False)
        return BrickedField(smooth, field.filter, field.boundary, field.device, beside=field)

    def _nearest(self, field: BrickedField, plan: Grid, result: Array) -> Array:
        """The least-squares spline on a coarser grid: see `clvol.ndimage.antialiasing.nearest_splines`."""
        spline, positions = plan.spline, {axis: p for axis, p in enumerate(plan.positions) if p is not None}
        sums = nearest_sums(self.shape, positions, spline, np.float32)
        for block, values, done in field.store.blocks(sums, np.float32, float(spline.cval.real)):
            result[block] = converted(values, result.dtype)
            if spline.progress:
                spline.progress(done)
        return result


def _values(field: BrickedField, at: _Floats, spline: Spline) -> Array:
    """Values at positions [z, y, x], shape (3, N); a position that is not finite has the value `cval`."""
    found = field.at_samples(np.ascontiguousarray(at[::-1].T))
    bad = ~np.isfinite(at).all(0)
    if bad.any():
        found[bad] = spline.cval.real
    return found


def _by_blocks(field: BrickedField, places: Callable[[tuple[slice, ...]], _Floats], result: Array, spline: Spline) -> Array:
    """Write the values at the positions of each block of the result."""
    blocks = list(itertools.product(*([slice(a, min(a + _BLOCK, n)) for a in range(0, n, _BLOCK)] for n in result.shape)))
    for done, block in enumerate(blocks, 1):
        part = result[block]
        part[...] = converted(_values(field, places(block), spline), result.dtype).reshape(part.shape)
        if spline.progress:
            spline.progress(done / len(blocks))
    return result
