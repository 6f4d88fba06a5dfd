"""The spline of a labelled array at positions in samples: dimension by dimension or at points, in memory or block by block."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import DataError, OptionError
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.margin import LEFT_OUT, reach
from clvol.filter.table import as_filter
from clvol.interop.dispatch import is_lazy
from clvol.ndimage import arguments, engine
from clvol.spline.field import Precision
from clvol.spline.function import fill_value
from clvol.volume.missing import filled_smoothly
from clvol.xarray.uneven import Uneven, runs

__all__ = ["Spline"]

Array = NDArray[Any]
Positions = NDArray[np.float64]
Axes = Sequence[Uneven | None]

_ORDERS = {"nearest": 0, "linear": 1, "bspline2": 2, "bspline3": 3, "bspline4": 4, "bspline5": 5}
_MODES = {"mirror": "mirror", "reflect": "reflect", "wrap": "grid-wrap", "nearest": "nearest"}  # SciPy's names
_AT_ONCE = 3  # largest number of axes of a kernel


@dataclass(frozen=True, eq=False)
class Spline:
    """How arrays are interpolated; arguments are those of `interp`.

    `knots` has the coordinates of uneven dimensions, where that matters: nearest and linear interpolation depend on positions in
    samples alone. Without `interpolates`, samples are the coefficients.
    """

    filter: str
    boundary: str
    fill: float | None
    precision: Precision | None
    device: Device | str | int | None
    nan: str = "error"
    knots: Mapping[Hashable, Positions] = field(default_factory=dict)
    interpolates: bool = True

    def __post_init__(self) -> None:
        for what, name, names in (
            ("filter", as_filter(self.filter).name, _ORDERS),
            ("boundary", as_boundary(self.boundary).name, _MODES),
        ):
            if name not in names:
                raise one_of(what, getattr(self, what), names)
            object.__setattr__(self, what, name)
        if self.precision not in (None, "single", "double"):
            raise one_of("precision", self.precision, ("single", "double"))
        if self.nan not in arguments.NAN:
            raise one_of("nan", self.nan, arguments.NAN)
        object.__setattr__(self, "fill", fill_value(self.fill))
        object.__setattr__(self, "device", None if self.device is None else as_device(self.device))

    def on(self, knots: Mapping[Hashable, Positions | None]) -> Spline:
        """The same along dimensions of which some are uneven."""
        if _ORDERS[self.filter] < 2:
            return self
        uneven = {dim: places for dim, places in knots.items() if places is not None}
        if len(uneven) == len(knots) > 0 and self.boundary != DEFAULT_BOUNDARY:
            raise OptionError(
                f"boundary is of dimensions with uniform coordinates, and {', '.join(map(str, knots))} are uneven: leave it out; "
                f"got {self.boundary!r}"
            )
        return replace(self, knots=uneven)

    def __call__(self, data: xarray.Variable, targets: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        """Interpolate a variable at positions, in samples, along those of the dimensions that it has."""
        wanted = {dim: target for dim, target in targets.items() if dim in data.dims}
        # in xarray's order: the dimensions of an indexer replace the indexed one
        dims = dict.fromkeys(d for dim in data.dims for d in (wanted[dim].dims if dim in wanted else (dim,)))
        result = (self._locally if self.nan == "local" else self._interpolated)(data, wanted)
        return result.transpose(*dims)

    def _locally(self, data: xarray.Variable, wanted: Mapping[Hashable, xarray.Variable]) -> xarray.Variable:
        """By the rule "local" of `clvol.Missing`: NaN where a missing sample has weight, else as of the filled array."""
        if is_lazy(data.data):
            raise OptionError(
                'nan must be "propagate" or "error" for an array of dask, where missing samples may span blocks; got "local"'
            )
        filled = data.transpose(..., *wanted).copy()
        missing = ~np.isfinite(filled.values)
        if not missing.any():
            return self._interpolated(data, wanted)
        for index in np.ndindex(filled.shape[: filled.ndim - len(wanted)]):
            if missing[index].any():
                for part in _real_parts(filled.values):
                    part[index] = filled_smoothly(part[index], missing[index])
        result = self._interpolated(filled, wanted)
        weights = replace(self, fill=0.0, precision="single", interpolates=False)
        share = weights._interpolated(xarray.Variable(filled.dims, missing.astype(np.uint8)), wanted)
        result.values[share.transpose(*result.dims).values != 0] = np.nan
        return result

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
        # process shrinking dimensions first
        order = sorted((dim for group in alone for dim in group), key=lambda dim: wanted[dim].size / data.sizes[dim])
        for together in _passes(order, self.knots):
            data = self._along_lines(data, {dim: wanted[dim] for dim in together})
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
        result = self._grid(data.data, axes, given, [self._uneven(dim, data.dtype) for dim in lines])
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
        result = self._points(moved, points, [self._uneven(dim, data.dtype) for dim in at])
        return xarray.Variable([*kept, *like.dims], result.reshape(moved.shape[: len(kept)] + like.shape), data.attrs)

    # -- in memory, or block by block ----------------------------------------------------------------------------

    def _grid(self, data: Any, axes: Sequence[int], positions: Sequence[Positions], uneven: Axes) -> Any:
        """Interpolate an array at positions along some of its axes."""

        def spans(some: Sequence[Positions]) -> list[tuple[int, int]]:
            return [self._span(p, data.shape[axis], one) for axis, p, one in zip(axes, some, uneven, strict=True)]

        if not is_lazy(data):
            near = spans(positions)
            return self._grid_here(data[_within(data.shape, axes, near)], axes, positions, near, data.shape, uneven)
        chunks = list(data.chunks)
        for axis, p in zip(axes, positions, strict=True):
            chunks[axis] = runs(np.clip(p, 0, data.shape[axis] - 1), max(chunks[axis]))

        def reads(_: Any, where: tuple[tuple[int, int], ...]) -> tuple[tuple[tuple[int, int], ...], Any]:
            some = [p[slice(*where[axis])] for axis, p in zip(axes, positions, strict=True)]
            near = spans(some)
            part = dict(enumerate(where)) | dict(zip(axes, near, strict=True))
            return tuple(part.values()), {"positions": some, "spans": near}

        call = partial(self._grid_here, axes=axes, shape=data.shape, uneven=uneven)
        return self._by_blocks(data, chunks, reads, call, [axes, positions, uneven])

    def _by_blocks(
        self, data: Any, chunks: Sequence[Any], reads: Callable[..., Any], call: Callable[..., Array], about: Any
    ) -> Any:
        """An array of dask whose blocks are calls with the part of the samples that each reads."""
        from clvol.dask.blocks import as_lazy, blockwise

        own = [self.filter, self.boundary, repr(self.fill), self.precision, repr(self.device), self.nan]
        compute = partial(_called, call)
        return blockwise("interp", as_lazy(data), tuple(chunks), self._kind(data.dtype), reads, compute, [*own, *about])

    def _grid_here(
        self,
        data: Array,
        axes: Sequence[int],
        positions: Sequence[Positions],
        spans: Sequence[tuple[int, int]],
        shape: tuple[int, ...],
        uneven: Axes,
    ) -> Array:
        sizes = list(data.shape)
        for axis, p in zip(axes, positions, strict=True):
            sizes[axis] = p.size
        output = np.empty(sizes, self._kind(data.dtype))
        missing = [self._missing(p, shape[axis]) for axis, p in zip(axes, positions, strict=True)]
        at = [np.where(m, s[0], p) - s[0] for p, m, s in zip(positions, missing, spans, strict=True)]
        self._require_finite(data)
        if uneven[0] is not None:
            uneven[0].part(spans[0]).write(data, axes[0], at[0], output)
        elif output.size:
            order = np.argsort(axes)
            target = engine.Axes(tuple(at[i] for i in order))
            for samples, results in zip(_real_parts(data), _real_parts(output), strict=True):
                engine.evaluate(samples, [axes[i] for i in order], target, results, self._of(data))
        for axis, m in zip(axes, missing, strict=True):
            if m.any():
                np.moveaxis(output, axis, 0)[m] = self.fill
        return output

    def _points(self, data: Any, points: Positions, uneven: Axes) -> Any:
        """Interpolate an array at points along its last axes."""
        k = len(points)
        shape = data.shape[-k:]
        spans = [self._span(p, n, one) for p, n, one in zip(points, shape, uneven, strict=True)]
        call = partial(self._points_here, points=points, spans=spans, shape=shape, uneven=uneven)
        if not is_lazy(data):
            return call(data[_within(data.shape, range(data.ndim - k, data.ndim), spans)])
        chunks = (*data.chunks[:-k], (points.shape[1],))
        return self._by_blocks(data, chunks, lambda _, where: ((*where[:-1], *spans), {}), call, [points, uneven])

    def _points_here(
        self, data: Array, points: Positions, spans: Sequence[tuple[int, int]], shape: tuple[int, ...], uneven: Axes
    ) -> Array:
        k = len(points)
        output = np.empty((*data.shape[:-k], points.shape[1]), self._kind(data.dtype))
        missing = np.any([self._missing(p, n) for p, n in zip(points, shape, strict=True)], axis=0)
        first = np.array([s[0] for s in spans])[:, None]
        at = np.where(missing, first, points) - first
        self._require_finite(data)
        near = [None if axis is None else axis.part(span) for axis, span in zip(uneven, spans, strict=True)]
        if output.size:
            for samples, results in zip(_real_parts(data), _real_parts(output), strict=True):
                if any(uneven):
                    self._add_taps(samples, at, near, results)
                else:
                    engine.evaluate(samples, range(data.ndim - k, data.ndim), engine.Points(at), results, self._of(data))
        if missing.any():
            output[..., missing] = self.fill
        return output

    def _add_taps(self, data: Array, points: Positions, uneven: Axes, output: Array) -> None:
        """Evaluate at points along the last axes, of which some are uneven: the sum of products of weights along each axis."""
        first = data.ndim - len(points)
        row, rule, spline = engine.row_of(self._order, self.interpolates), as_boundary(self.boundary), self._of(data)
        even = [axis for axis, one in enumerate(uneven, first) if one is None]
        pad = rule.padding(row.prefilter, row.support) if even else 0
        coefficients = np.pad(data, [(pad, pad) if axis in even else (0, 0) for axis in range(data.ndim)], "edge")
        coefficients = coefficients.astype(output.dtype, copy=False)
        if even and row.prefilter:
            engine.coefficients(coefficients, even, coefficients, spline)
        taps = []
        for axis, (at, one) in enumerate(zip(points, uneven, strict=True), first):
            if one is None:
                base, t = row.cell(at)
                index = np.stack([rule.index(base + i, data.shape[axis], pad) + pad for i in range(row.support)])
                weights = row.weights(t)
            else:
                coefficients, index, weights = one.taps(coefficients, axis, at)
            taps.append(list(zip(index, weights, strict=True)))
        output[...] = 0
        for corner in itertools.product(*taps):
            output += coefficients[(..., *(index for index, _ in corner))] * math.prod(weight for _, weight in corner)

    def _require_finite(self, data: Array) -> None:
        if self.nan == "error" and not np.isfinite(data).all():
            raise DataError(
                "samples must be finite; got NaN or infinite ones: fill them first, da.fillna(value), or let nan= be "
                '"local" or "propagate"'
            )

    def _uneven(self, dim: Hashable, kind: np.dtype[Any]) -> Uneven | None:
        """A dimension of samples of a dtype, if it is uneven."""
        knots = self.knots.get(dim)
        return None if knots is None else Uneven(knots, self._order, LEFT_OUT[self._precision(kind)], self.interpolates)

    @property
    def _order(self) -> int:
        return _ORDERS[self.filter]

    def _of(self, data: Array) -> arguments.Spline:
        """The spline of an array's real or imaginary part."""
        return arguments.Spline(
            self._order, _MODES[self.boundary], 0.0, self.interpolates, self._precision(data.dtype), self.device
        )

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

    def _span(self, positions: Positions, n: int, uneven: Uneven | None) -> tuple[int, int]:
        """The samples of an axis, from first to before stop, on which values at positions depend by more than rounding."""
        inside = positions[(positions >= 0) & (positions <= n - 1)]
        if self.fill is None and inside.size < positions.size:
            return 0, n
        if not inside.size:
            return 0, 1
        low, high = float(inside.min()), float(inside.max())
        if uneven is not None:
            return uneven.near(low)[0], uneven.near(high)[1]
        row = as_filter(self.filter)
        margin = row.support // 2 + 1 + reach(row, self.precision or "double")
        first, stop = math.floor(low) - margin, math.ceil(high) + margin + 1
        if as_boundary(self.boundary).fold is None and (first < 0 or stop > n):
            return 0, n  # the axis is periodic
        return max(first, 0), min(stop, n)


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


def _passes(dims: Sequence[Hashable], knots: Mapping[Hashable, Positions]) -> list[Sequence[Hashable]]:
    """Which dimensions are interpolated together: uniform ones up to three at a time, uneven ones alone."""
    even = [dim for dim in dims if dim not in knots]
    passes = [[dim] for dim in dims if dim in knots] + [even[i : i + _AT_ONCE] for i in range(0, len(even), _AT_ONCE)]
    return sorted(passes, key=lambda group: dims.index(group[0]))


def _real_parts(array: Array) -> list[Array]:
    """Complex numbers as two real arrays; views."""
    return [array.real, array.imag] if array.dtype.kind == "c" else [array]


def _within(shape: Sequence[int], axes: Sequence[int], spans: Sequence[tuple[int, int]]) -> tuple[slice, ...]:
    part = [slice(None)] * len(shape)
    for axis, span in zip(axes, spans, strict=True):
        part[axis] = slice(*span)
    return tuple(part)


def _called(call: Callable[..., Array], samples: Array, block: Any) -> Array:
    return call(samples, **block.extra)
