"""Labelled arrays: ``import clvol.xarray`` gives xarray's DataArray and Dataset an accessor, ``.clvol``, an extra.

>>> import clvol.xarray
>>> da.clvol.interp(lat=48.2, lon=16.4)                       # as da.interp, by the cubic spline
>>> da.clvol.interp(x=("station", xs), y=("station", ys))     # at points
>>> da.clvol.regrid(spacing={"lat": 0.1, "lon": 0.1})         # onto another grid of the same domain

Coordinates may be uneven, as Gaussian latitudes, pressure levels and months are. Where they are uniform to within a thousandth of a
step, kernels evaluate the spline, with a boundary rule; along others it has its knots at the samples, ends "not-a-knot", as
xarray's ``method="cubic"`` does, and is evaluated by SciPy and NumPy. Dask arrays stay lazy: each block of the result reads the
blocks that it needs, with a margin that follows from the spline's poles, or from its weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import timedelta
from typing import Any, Generic, TypeVar

import numpy as np

from clvol.base.errors import DataError, MissingDependencyError, OptionError
from clvol.device import Device
from clvol.filter.boundary import DEFAULT_BOUNDARY
from clvol.filter.table import DEFAULT_FILTER
from clvol.spline.field import Precision

try:
    import xarray
except ImportError as missing:
    raise MissingDependencyError('clvol.xarray needs xarray: pip install "clvol[xarray]"') from missing

from clvol.xarray.lines import Line, indexer
from clvol.xarray.spline import Spline

__all__ = ["ArrayAccessor", "DatasetAccessor"]

Labelled = TypeVar("Labelled", xarray.DataArray, xarray.Dataset)


class _Accessor(Generic[Labelled]):
    """The methods of arrays and of datasets."""

    def __init__(self, labelled: Labelled) -> None:
        self._labelled: Labelled = labelled

    def interp(
        self,
        coords: Mapping[Any, Any] | None = None,
        filter: str = DEFAULT_FILTER,
        boundary: str = DEFAULT_BOUNDARY,
        *,
        fill: float | None = math.nan,
        nan: str = "error",
        precision: Precision | None = None,
        device: Device | str | int | None = None,
        **coords_kwargs: Any,
    ) -> Labelled:
        """Interpolate at new coordinates, given as for `xarray.DataArray.interp`.

        Numbers drop their dimension; one-dimensional sequences give a grid; DataArrays give their dimensions, and points
        if they share some. Other dimensions are batches: each of their indices is a separate function. Coordinates and
        attributes are kept as in xarray, and other numeric coordinates along the dimensions are interpolated linearly.

        Parameters
        ----------
        coords : mapping of dimension to number, array-like or DataArray, optional
            New coordinates; datetimes if the old ones are. At most 3 dimensions at points, any number on grids.
        filter : {"bspline3", "nearest", "linear", "bspline2", "bspline4", "bspline5"}
        boundary : {"mirror", "reflect", "wrap", "nearest"}
            The boundary rule of uniform dimensions outside the outer samples; it affects values near them, and outside if `fill`
            is None. Splines along uneven dimensions have none, and end "not-a-knot".
        fill : float or None
            The result where a coordinate is NaN or outside the outer samples; None: the boundary rule applies, and along uneven
            dimensions the outermost polynomials go on.
        nan : {"error", "propagate", "local"}
            What NaN and infinite samples do, as in `clvol.Missing`: raise an error; or make results NaN, "propagate" all that the
            prefilter reaches, "local" only those in which such a sample has weight (not of dask arrays).
        precision : {"single", "double"}, optional
            Default: double, except for samples of float32 and float16, whose results are float32.
        device : Device, str or int, optional
            See `clvol.device.as_device`.
        **coords_kwargs
            `coords` as keywords.

        Returns
        -------
        DataArray or Dataset
            Lazy if the samples are dask arrays, in blocks at most as long as theirs. It differs from the result of the same
            array in memory by at most 10⁻¹² of the largest magnitude (10⁻⁶ in single precision), because blocks start the
            prefilter's recursions in a margin of 24 samples (12 in single precision), more for higher orders.

        Raises
        ------
        OptionError
            A dimension, filter or boundary is unknown, indexers need more than 3 dimensions at once, `boundary` is given where all
            dimensions are uneven, or `nan` is "local" for a dask array.
        GeometryError
            The coordinate of a dimension neither ascends nor descends, or holds neither numbers nor datetimes.
        DataError
            A sample is NaN or infinite and `nan` is "error" (raised on compute for dask arrays), or not a number.

        Notes
        -----
        In a Dataset all numeric variables with one of the dimensions are interpolated; xarray handles the others.
        xarray's ``method="cubic"`` ends "not-a-knot" along all dimensions: the two differ near the ends of uniform ones. That end
        needs no slope, and keeps the fourth order of accuracy up to the last sample.
        """
        if coords is not None and coords_kwargs:
            raise OptionError("give coordinates as a mapping or as keywords, not both")
        if coords is not None and not isinstance(coords, Mapping):
            raise OptionError(f"coords must be a mapping from dimensions to coordinates; got {coords!r}")
        return self.interpolated(dict(coords or coords_kwargs), Spline(filter, boundary, fill, precision, device, nan))

    def regrid(
        self,
        shape: Mapping[Any, int] | None = None,
        spacing: Mapping[Any, float | np.timedelta64 | timedelta] | None = None,
        filter: str = DEFAULT_FILTER,
        boundary: str = DEFAULT_BOUNDARY,
        *,
        precision: Precision | None = None,
        device: Device | str | int | None = None,
    ) -> Labelled:
        """Resample to another uniform grid over the same domain, which ends half a step outside the outer samples.

        Like `clvol.resample`, but xarray's ``resample`` groups a time axis. There is no low-pass: smooth before you enlarge steps.

        Parameters
        ----------
        shape : mapping of dimension to int, optional
            New numbers of samples.
        spacing : mapping of dimension to number or timedelta, optional
            New positive steps, timedeltas along time; the domain keeps its centre, and its size to within half a step. Give `shape`
            or `spacing`.
        filter, boundary, precision, device
            As in `interp`.

        Returns
        -------
        DataArray or Dataset, lazy as in `interp`

        Raises
        ------
        OptionError, GeometryError, DataError
            As in `interp`; a coordinate is uneven; both or neither of `shape` and `spacing` are given, or one is not positive.
        """
        given = spacing if shape is None else shape
        if (shape is None) == (spacing is None) or not isinstance(given, Mapping):
            raise OptionError("regrid takes exactly one of shape and spacing, each a mapping from dimensions")
        targets = {dim: Line.of(self._labelled, dim).regridded(value, is_step=shape is None) for dim, value in given.items()}
        return self.interpolated(targets, Spline(filter, boundary, None, precision, device))

    def interpolated(self, coords: Mapping[Any, Any], spline: Spline) -> Labelled:
        raise NotImplementedError


@xarray.register_dataset_accessor("clvol")
class DatasetAccessor(_Accessor[xarray.Dataset]):
    """``ds.clvol``: interpolation of the numeric variables of a Dataset."""

    def interpolated(self, coords: Mapping[Any, Any], spline: Spline) -> xarray.Dataset:
        data = self._labelled
        lines = {dim: Line.of(data, dim) for dim in coords}
        targets = {dim: line.positions(indexer(dim, coords[dim])) for dim, line in lines.items()}
        spline = spline.on({dim: line.knots for dim, line in lines.items()})
        names = [name for name, v in data.data_vars.items() if v.dtype.kind in "iufc" and not targets.keys().isdisjoint(v.dims)]
        # xarray creates the coordinates, from a dataset without the variables interpolated here
        indices = {dim: np.arange(data.sizes[dim]) for dim in lines if dim not in data.coords}
        rest = data.drop_vars(names).assign_coords(indices).interp(coords)
        done = {name: spline(data[name].variable, targets) for name in names}
        result = rest.assign(done)
        kept: xarray.Dataset = result[[name for name in data.data_vars if name in result]]
        return kept


@xarray.register_dataarray_accessor("clvol")
class ArrayAccessor(_Accessor[xarray.DataArray]):
    """``da.clvol``: interpolation of a DataArray."""

    def interpolated(self, coords: Mapping[Any, Any], spline: Spline) -> xarray.DataArray:
        data = self._labelled
        if data.dtype.kind not in "iufc":
            raise DataError(f"samples must be numbers; got dtype {data.dtype}")
        name = "what is interpolated"  # a Dataset has no variable without a name
        return DatasetAccessor(data.to_dataset(name=name)).interpolated(coords, spline)[name].rename(data.name)
