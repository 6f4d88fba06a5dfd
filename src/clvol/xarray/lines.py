"""The coordinates of dimensions, uniform or not, and new ones as positions in samples."""

from __future__ import annotations

import math
from collections.abc import Hashable
from datetime import timedelta
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.checks import number, one_of, whole
from clvol.base.errors import DataError, GeometryError, OptionError

__all__ = ["Line", "indexer"]

Array = NDArray[Any]
Positions = NDArray[np.float64]

_UNIFORM = 1e-3  # tolerance of coordinates in steps, above the error of float32


class Line:
    """The coordinate of a dimension. Where it is uniform, it is ``first + index * step``, and `knots` is None.

    Datetimes are integer nanoseconds from the first, to keep all digits.
    """

    def __init__(self, dim: Hashable, values: Array) -> None:
        self.dim, self.values, self.size = dim, values, values.size
        if values.dtype.kind not in "iufMm":
            raise GeometryError(f"the coordinate {dim!r} must be numbers or datetime64; got dtype {values.dtype}")
        if not self.size:
            raise DataError(f"the dimension {dim!r} must hold at least one sample; got none")
        from_first = self._from_first(values)
        self.step = float(from_first[-1]) / (self.size - 1) if self.size > 1 else 1.0
        self._places = from_first * math.copysign(1, self.step)
        steps = np.diff(self._places)
        if not (steps > 0).all():
            raise GeometryError(f"the coordinate {dim!r} must ascend or descend from each sample to the next, without NaN")
        self._off = float(np.abs(from_first / self.step - np.arange(self.size)).max())
        self.knots = self._places / abs(self.step) if self._off > _UNIFORM else None
        self._outer = (abs(self.step),) * 2 if self.knots is None else (float(steps[0]), float(steps[-1]))

    @classmethod
    def of(cls, data: xarray.DataArray | xarray.Dataset, dim: Hashable) -> Line:
        """The coordinate of a labelled array's dimension, or its indices if there is none."""
        if dim not in data.dims:
            raise one_of("a dimension to be interpolated", dim, map(str, data.dims))
        return cls(dim, np.asarray(data[dim].values) if dim in data.coords else np.arange(data.sizes[dim]))

    def _from_first(self, values: Array) -> Positions:
        first = self.values[0]
        if self.values.dtype.kind in "Mm":
            kind = f"{self.values.dtype.kind}8[ns]"
            try:
                away = values.astype(kind) - first.astype(kind)
            except (TypeError, ValueError) as error:
                raise OptionError(f"new coordinates of {self.dim!r} must be datetimes, as the old ones are: {error}") from None
            return np.where(np.isnat(away), np.nan, away.astype(np.int64).astype(np.float64))
        if values.dtype.kind not in "iuf":
            raise OptionError(f"new coordinates of {self.dim!r} must be numbers, as the old ones are; got dtype {values.dtype}")
        return values.astype(np.float64) - float(first)

    def positions(self, indexer: xarray.Variable) -> xarray.Variable:
        """Positions of coordinates, in samples; exact integers at the coordinates of samples."""
        away = self._from_first(np.asarray(indexer.values)) * math.copysign(1, self.step)
        at = np.interp(away, self._places, np.arange(self.size, dtype=np.float64))
        last = self._places[-1]
        below, above = away / self._outer[0], self.size - 1 + (away - last) / self._outer[1]
        return xarray.Variable(indexer.dims, np.where(away < 0, below, np.where(away <= last, at, above)))

    def regridded(self, value: Any, *, is_step: bool) -> Array:
        """Coordinates of `value` samples over the same domain, or of samples at steps of `value`."""
        if self.knots is not None:
            raise GeometryError(
                f"the coordinate {self.dim!r} must be uniform for regrid, to within {_UNIFORM:g} of a step; it is off by up to "
                f"{self._off:.3g} steps: give new coordinates to interp"
            )
        if is_step:
            if self.values.dtype.kind in "Mm":
                if not isinstance(value, (np.timedelta64, timedelta)):  # pandas.Timedelta is a timedelta
                    raise OptionError(
                        f"spacing along {self.dim!r} must be a timedelta, as its coordinate is in time; got {value!r}"
                    )
                value = float(np.timedelta64(value).astype("m8[ns]").astype(np.int64))
            ratio = number(f"spacing along {self.dim!r}", value, above=0) / abs(self.step)
            count = max(1, round(self.size / ratio))
        else:
            count = whole(f"shape along {self.dim!r}", value, minimum=1)
            ratio = self.size / count
        index = (self.size - 1) / 2 + ratio * (np.arange(count) - (count - 1) / 2)
        if self.values.dtype.kind in "Mm":
            return np.asarray(self.values[0].astype(f"{self.values.dtype.kind}8[ns]") + np.rint(index * self.step).astype("m8[ns]"))
        return np.asarray(float(self.values[0]) + index * self.step)


def indexer(dim: Hashable, given: Any) -> xarray.Variable:
    """New coordinates with their dimensions; a sequence has dimension `dim`."""
    if isinstance(given, xarray.DataArray):
        return given.variable
    if isinstance(given, (tuple, xarray.Variable)):
        return xarray.as_variable(given)
    values = as_array(given, f"new coordinates of {dim!r}", OptionError)
    if values.ndim > 1:
        raise OptionError(
            f"new coordinates of {dim!r} with several axes must be a DataArray, which names them; got shape {values.shape}"
        )
    return xarray.Variable((dim,) * values.ndim, values)
