"""Labelled arrays: ``import clvol.xarray`` gives xarray's DataArray and Dataset an accessor, ``.clvol``, an extra.

>>> import clvol.xarray
>>> da.clvol.interp(lat=48.2, lon=16.4)                       # as da.interp, by the cubic spline
>>> da.clvol.interp(x=("station", xs), y=("station", ys))     # at points
>>> da.clvol.regrid(spacing={"lat": 0.1, "lon": 0.1})         # onto another grid of the same domain

Coordinates must be uniform to within a thousandth of a step. Dask arrays stay lazy: each block of the result reads the blocks
that it needs, with a margin that follows from the spline's poles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from datetime import timedelta
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import as_array
from clvol.base.checks import number, one_of, whole
from clvol.base.errors import DataError, GeometryError, MissingDependencyError, OptionError
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.margin import reach
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.interop.dispatch import is_lazy
from clvol.ndimage.arguments import Spline
from clvol.ndimage.engine import Axes, Points, evaluate
from clvol.spline.field import Precision
from clvol.spline.function import fill_value

try:
    import xarray
except ImportError as missing:
    raise MissingDependencyError("clvol.xarray needs xarray: pip install clvol[xarray]") from missing

__all__ = ["ArrayAccessor", "DatasetAccessor"]

Array = NDArray[Any]
Positions = NDArray[np.float64]
Labelled = TypeVar("Labelled", xarray.DataArray, xarray.Dataset)

_ORDERS = {"nearest": 0, "linear": 1, "bspline2": 2, "bspline3": 3, "bspline4": 4, "bspline5": 5}
_MODES = {"mirror": "mirror", "reflect": "reflect", "wrap": "grid-wrap", "nearest": "nearest"}  # SciPy's names
_UNIFORM = 1e-3  # tolerance of coordinates in steps, above the error of float32
_AT_ONCE = 3  # largest number of axes of a kernel
_LEFT_OUT = {"single": 2e-7, "double": 2e-14}  # weight outside a block's margin, which is 12 and 24 samples for cubic splines


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
            The boundary rule outside the outer samples; it affects values near them, and outside if `fill` is None.
        fill : float or None
            The result where a coordinate is NaN or outside the outer samples; None: the boundary rule applies.
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
            A dimension, filter or boundary is unknown, or indexers need more than 3 dimensions at once.
        GeometryError
            The coordinate of a dimension is not uniform, or neither numbers nor datetimes.
        DataError
            A sample is NaN or infinite (raised on compute for dask arrays), or not a number.

        Notes
        -----
        In a Dataset all numeric variables with one of the dimensions are interpolated; xarray handles the others.
        xarray's ``method="cubic"`` builds a spline with other end conditions (not-a-knot), so the two differ near the ends.
        """
        if coords is not None and coords_kwargs:
            raise OptionError("give coordinates as a mapping or as keywords, not both")
        if coords is not None and not isinstance(coords, Mapping):
            raise OptionError(f"coords must be a mapping from dimensions to coordinates; got {coords!r}")
        return self.interpolated(dict(coords or coords_kwargs), _Spline(filter, boundary, fill, precision, device))

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
            As in `interp`; or both or neither of `shape` and `spacing` are given, or one is not positive.
        """
        given = spacing if shape is None else shape
        if (shape is None) == (spacing is None) or not isinstance(given, Mapping):
            raise OptionError("regrid takes exactly one of shape and spacing, each a mapping from dimensions")
        targets = {dim: _Line.of(self._labelled, dim).regridded(value, is_step=shape is None) for dim, value in given.items()}
        return self.interpolated(targets, _Spline(filter, boundary, None, precision, device))

    def interpolated(self, coords: Mapping[Any, Any], spline: _Spline) -> Labelled:
        raise NotImplementedError


@xarray.register_dataset_accessor("clvol")
class DatasetAccessor(_Accessor[xarray.Dataset]):
    """``ds.clvol``: interpolation of the numeric variables of a Dataset."""

    def interpolated(self, coords: Mapping[Any, Any], spline: _Spline) -> xarray.Dataset:
        data = self._labelled
        lines = {dim: _Line.of(data, dim) for dim in coords}
        targets = {dim: line.positions(_indexer(dim, coords[dim])) for dim, line in lines.items()}
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

    def interpolated(self, coords: Mapping[Any, Any], spline: _Spline) -> xarray.DataArray:
        data = self._labelled
        if data.dtype.kind not in "iufc":
            raise DataError(f"samples must be numbers; got dtype {data.dtype}")
        name = "what is interpolated"  # a Dataset has no variable without a name
        return DatasetAccessor(data.to_dataset(name=name)).interpolated(coords, spline)[name].rename(data.name)


# -- coordinates -----------------------------------------------------------------------------------------------------


class _Line:
    """The uniform coordinate of a dimension: ``first + index * step``.

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
        with np.errstate(invalid="ignore", divide="ignore"):
            off = np.abs(from_first / self.step - np.arange(self.size)).max()
        if not off <= _UNIFORM:
            raise GeometryError(
                f"the coordinate {dim!r} must be uniform, to within {_UNIFORM:g} of a step; it is off by up to {off:.3g} steps"
            )
        self._places = np.abs(from_first)

    @classmethod
    def of(cls, data: xarray.DataArray | xarray.Dataset, dim: Hashable) -> _Line:
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
        beyond = ~((away >= 0) & (away <= self._places[-1]))  # true for NaN as well
        return xarray.Variable(indexer.dims, np.where(beyond, away / abs(self.step), at))

    def regridded(self, value: Any, *, is_step: bool) -> Array:
        """Coordinates of `value` samples over the same domain, or of samples at steps of `value`."""
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


def _indexer(dim: Hashable, given: Any) -> xarray.Variable:
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


# -- evaluation ------------------------------------------------------------------------------------------------------


class _Spline:
    """An interpolation of arrays: filter, boundary rule, fill, precision and device."""

    def __init__(
        self, filter: str, boundary: str, fill: float | None, precision: Precision | None, device: Device | str | int | None
    ) -> None:
        self._filter, self._boundary = as_filter(filter), as_boundary(boundary)
        if self._filter.name not in _ORDERS:
            raise one_of("filter", filter, _ORDERS)
        if self._boundary.name not in _MODES:
            raise one_of("boundary", boundary, _MODES)
        if precision not in (None, "single", "double"):
            raise one_of("precision", precision, ("single", "double"))
        self.fill = fill_value(fill)
        self.precision = precision
        self._device = None if device is None else as_device(device)

    def __call__(self, data: xarray.Variable, targets: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        """Interpolate a variable at positions, in samples, along those of the dimensions that it has."""
        wanted = {dim: target for dim, target in targets.items() if dim in data.dims}
        # in xarray's order: the dimensions of an indexer replace the indexed one
        dims = dict.fromkeys(d for dim in data.dims for d in (wanted[dim].dims if dim in wanted else (dim,)))
        return self._interpolated(data, wanted).transpose(*dims)

    def _interpolated(self, data: xarray.Variable, wanted: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        for dim in data.dims:
            if dim not in wanted and any(dim in target.dims for target in wanted.values()):
                # positions depend on another dimension of the samples: interpolate each of its indices separately
                parts = [
                    self._interpolated(data[{dim: i}], {d: t[{dim: i}] if dim in t.dims else t for d, t in wanted.items()})
                    for i in range(data.sizes[dim])
                ]
                joined: xarray.Variable = xarray.Variable.concat(parts, dim)
                return joined
        alone = [group for group in _groups(wanted) if len(group) == 1]
        lines = {dim: wanted[dim] for group in alone for dim in group}
        # process shrinking dimensions first
        order = sorted(lines, key=lambda dim: lines[dim].size / data.sizes[dim])
        for first in range(0, len(order), _AT_ONCE):
            data = self._along_lines(data, {dim: lines[dim] for dim in order[first : first + _AT_ONCE]})
        for group in _groups(wanted):
            if len(group) > _AT_ONCE:
                raise OptionError(f"points may have at most {_AT_ONCE} dimensions; got {', '.join(map(str, group))}")
            if len(group) > 1:
                data = self._at_points(data, {dim: wanted[dim] for dim in group})
        return data

    def _along_lines(self, data: xarray.Variable, lines: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        """Interpolate each dimension at its positions: a grid."""
        axes = data.get_axis_num(list(lines))
        given: list[Positions] = [line.values.ravel() for line in lines.values()]
        result = self._grid(data.data, axes, given)
        shape: list[int] = []
        dims: list[Hashable] = []
        for dim, length in zip(data.dims, result.shape, strict=True):
            dims += lines[dim].dims if dim in lines else (dim,)
            shape += lines[dim].shape if dim in lines else (length,)
        return xarray.Variable(dims, result.reshape(shape), data.attrs)

    def _at_points(self, data: xarray.Variable, at: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        """Interpolate several dimensions at points, whose dimensions come last."""
        like = sum(at.values(), xarray.Variable((), 0.0))
        points = np.stack([target.set_dims(like.sizes).transpose(*like.dims).values.ravel() for target in at.values()])
        kept = [dim for dim in data.dims if dim not in at]
        moved = data.transpose(*kept, *at).data
        result = self._points(moved, points)
        return xarray.Variable([*kept, *like.dims], result.reshape(moved.shape[: len(kept)] + like.shape), data.attrs)

    # -- in memory, or block by block ----------------------------------------------------------------------------

    def _grid(self, data: Any, axes: Sequence[int], positions: Sequence[Positions]) -> Any:
        """Interpolate an array at positions along some of its axes."""

        def spans(some: Sequence[Positions]) -> list[tuple[int, int]]:
            return [self._span(p, data.shape[axis]) for axis, p in zip(axes, some, strict=True)]

        if not is_lazy(data):
            near = spans(positions)
            return self._grid_here(data[_within(data.shape, axes, near)], axes, positions, near, data.shape)
        chunks = list(data.chunks)
        for axis, p in zip(axes, positions, strict=True):
            chunks[axis] = _runs(np.clip(p, 0, data.shape[axis] - 1), max(chunks[axis]))

        def reads(_: Any, where: tuple[tuple[int, int], ...]) -> tuple[tuple[tuple[int, int], ...], Any]:
            some = [p[slice(*where[axis])] for axis, p in zip(axes, positions, strict=True)]
            near = spans(some)
            part = dict(enumerate(where)) | dict(zip(axes, near, strict=True))
            return tuple(part.values()), {"positions": some, "spans": near}

        return self._by_blocks(data, chunks, reads, partial(self._grid_here, axes=axes, shape=data.shape), [axes, positions])

    def _by_blocks(
        self, data: Any, chunks: Sequence[Any], reads: Callable[..., Any], call: Callable[..., Array], about: Any
    ) -> Any:
        """An array of dask whose blocks are calls with the part of the samples that each reads."""
        from clvol.dask.blocks import as_lazy, blockwise

        own = [self._filter, self._boundary, repr(self.fill), self.precision, repr(self._device)]
        compute = partial(_called, call)
        return blockwise("interp", as_lazy(data), tuple(chunks), self._kind(data.dtype), reads, compute, [*own, *about])

    def _grid_here(
        self,
        data: Array,
        axes: Sequence[int],
        positions: Sequence[Positions],
        spans: Sequence[tuple[int, int]],
        shape: tuple[int, ...],
    ) -> Array:
        sizes = list(data.shape)
        for axis, p in zip(axes, positions, strict=True):
            sizes[axis] = p.size
        output = np.empty(sizes, self._kind(data.dtype))
        ranges = [shape[axis] for axis in axes]
        missing = [self._missing(p, n) for p, n in zip(positions, ranges, strict=True)]
        order = np.argsort(axes)
        at = [np.where(m, s[0], p) - s[0] for p, m, s in zip(positions, missing, spans, strict=True)]
        self._evaluate(data, [axes[i] for i in order], Axes(tuple(at[i] for i in order)), output)
        for axis, m in zip(axes, missing, strict=True):
            if m.any():
                np.moveaxis(output, axis, 0)[m] = self.fill
        return output

    def _points(self, data: Any, points: Positions) -> Any:
        """Interpolate an array at points along its last axes."""
        k = len(points)
        axes = range(data.ndim - k, data.ndim)
        shape = data.shape[-k:]
        spans = [self._span(p, n) for p, n in zip(points, shape, strict=True)]
        call = partial(self._points_here, points=points, spans=spans, shape=shape)
        if not is_lazy(data):
            return call(data[_within(data.shape, axes, spans)])
        chunks = (*data.chunks[:-k], (points.shape[1],))
        return self._by_blocks(data, chunks, lambda _, where: ((*where[:-1], *spans), {}), call, [points])

    def _points_here(self, data: Array, points: Positions, spans: Sequence[tuple[int, int]], shape: tuple[int, ...]) -> Array:
        k = len(points)
        output = np.empty((*data.shape[:-k], points.shape[1]), self._kind(data.dtype))
        missing = np.any([self._missing(p, n) for p, n in zip(points, shape, strict=True)], axis=0)
        first = np.array([s[0] for s in spans])[:, None]
        self._evaluate(data, range(data.ndim - k, data.ndim), Points(np.where(missing, first, points) - first), output)
        if missing.any():
            output[..., missing] = self.fill
        return output

    def _evaluate(self, data: Array, axes: Sequence[int], target: Axes | Points, output: Array) -> None:
        if not output.size:
            return
        if not np.isfinite(data).all():
            raise DataError("samples must be finite; got NaN or infinite ones: fill them first, da.fillna(value)")
        order, mode = _ORDERS[self._filter.name], _MODES[self._boundary.name]
        spline = Spline(order, mode, 0.0, True, self._precision(data.dtype), self._device)
        parts = [(data.real, output.real), (data.imag, output.imag)] if data.dtype.kind == "c" else [(data, output)]
        for samples, results in parts:
            evaluate(samples, axes, target, results, spline)

    def _precision(self, kind: np.dtype[Any]) -> Precision:
        if self.precision is not None:
            return self.precision
        return "single" if (kind.kind, kind.itemsize) in (("f", 2), ("f", 4), ("c", 8)) else "double"

    def _kind(self, kind: np.dtype[Any]) -> np.dtype[Any]:
        """The dtype of results."""
        double = self._precision(kind) == "double"
        if kind.kind == "c":
            return np.dtype(np.complex128 if double else np.complex64)
        return np.dtype(np.float64 if double else np.float32)

    def _missing(self, positions: Positions, n: int) -> NDArray[np.bool_]:
        """Which results are `fill`."""
        if self.fill is None:
            if not np.isfinite(positions).all():
                raise OptionError("new coordinates must be finite where fill is None; got NaN or infinite ones")
            return np.zeros(positions.shape, np.bool_)
        return ~((positions >= 0) & (positions <= n - 1))

    def _span(self, positions: Positions, n: int) -> tuple[int, int]:
        """The samples of an axis, from first to before stop, on which values at positions depend by more than rounding."""
        inside = positions[(positions >= 0) & (positions <= n - 1)]
        if self.fill is None and inside.size < positions.size:
            return 0, n
        if not inside.size:
            return 0, 1
        margin = self._filter.support // 2 + 1 + reach(self._filter, self.precision or "double")
        low, high = math.floor(inside.min()) - margin, math.ceil(inside.max()) + margin + 1
        if self._boundary.fold is None and (low < 0 or high > n):
            return 0, n  # the axis is periodic
        return max(low, 0), min(high, n)


def _groups(targets: Mapping[Hashable, xarray.Variable]) -> list[list[Hashable]]:
    """Groups of dimensions whose targets share dimensions, directly or indirectly."""
    groups: list[tuple[list[Hashable], set[Hashable]]] = []
    for dim, target in targets.items():
        members, dims = [dim], set(target.dims)
        for other in [group for group in groups if group[1] & dims]:
            groups.remove(other)
            members, dims = other[0] + members, other[1] | dims
        groups.append((members, dims))
    return [members for members, _ in groups]


def _runs(positions: Positions, longest: int) -> tuple[int, ...]:
    """The lengths of runs of successive positions, each of at most `longest` positions and samples."""
    cuts = [0]
    low = high = positions[0] if positions.size else 0.0
    for i, x in enumerate(positions.tolist()):
        low, high = min(low, x), max(high, x)
        if i - cuts[-1] >= longest or (high - low > longest and i > cuts[-1]):
            cuts.append(i)
            low = high = x
    return tuple(np.diff([*cuts, positions.size]).tolist())


def _within(shape: Sequence[int], axes: Sequence[int], spans: Sequence[tuple[int, int]]) -> tuple[slice, ...]:
    part = [slice(None)] * len(shape)
    for axis, span in zip(axes, spans, strict=True):
        part[axis] = slice(*span)
    return tuple(part)


def _called(call: Callable[..., Array], samples: Array, block: Any) -> Array:
    return call(samples, **block.extra)
