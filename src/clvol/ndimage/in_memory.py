"""Plans evaluated on an array in memory: complex parts, axes left as they are, more axes than three, points by pieces."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.errors import DataError, OptionError, OptionTypeError, OutOfMemoryError, UnsupportedError
from clvol.device import as_device
from clvol.filter.make import bspline
from clvol.filter.margin import reach_within
from clvol.ndimage import engine
from clvol.ndimage import plan as plans
from clvol.ndimage.antialiasing import low_passed, nearest_splines
from clvol.ndimage.arguments import Array, Spline, as_array, as_output, require_finite
from clvol.ndimage.engine import Affine, Axes, Points, Target
from clvol.ndimage.plan import Coefficients, Grid, Mapped, Plan, Substrate
from clvol.volume.missing import Missing, filled_smoothly

__all__ = [
    "NATIVE",
    "InMemory",
    "along_axes",
    "as_rows",
    "at_points",
    "evaluate_locally",
    "filtered",
    "require_few",
    "require_global",
    "require_mixable",
    "stored",
]

NATIVE = 3
"""Axes that the engine resamples at a time."""
_PIECE = 1 << 20
"""Points whose positions are in memory at a time, at least."""
_LARGE = 1 << 18
"""Samples from which it pays to cut out those that a few points need."""
_LEFT_OUT = 5e-17
"""Share of the prefilter's weights outside the part that is cut out for a few points: less than float64 resolves."""

_NUMBERS = {float, int, np.float64}
_FEW = 16  # answers that take no longer at once

_Floats = NDArray[np.float64]
_Pass = tuple[list[int], Axes | Affine]


class InMemory(Substrate):
    """An array of numbers, or what can be made into one."""

    def __init__(self, input: ArrayLike) -> None:
        self.data = as_array(input)
        self.shape, self.dtype = self.data.shape, self.data.dtype

    def evaluate(self, plan: Plan) -> Array:
        """The result of a plan; by bricks, with a warning, where memory does not hold the coefficients of the array."""
        spline = plan.spline
        if spline.device is not None:
            plan = replace(plan, spline=replace(spline, device=as_device(spline.device)))
        require_finite(self.data, spline.nan)
        try:
            return plan.on(self)
        except OutOfMemoryError as refused:
            from clvol.ndimage.by_bricks import instead

            try:
                return instead(self.data, plan, refused)
            except (OptionError, DataError, OutOfMemoryError):  # by bricks neither
                raise refused from None

    def grid(self, plan: Grid) -> Array:
        """The spline on a grid along the axes."""
        data, result, spline = self.data, self._result(plan, plan.copied), plan.spline
        if plan.copied:
            result[...] = data
        elif plan.nearest and data.size and result.size:
            nearest_splines(data, {axis: p for axis, p in enumerate(plan.positions) if p is not None}, result, spline)
        else:
            data = low_passed(data, plan.sigma, spline) if plan.sigma else data
            along_axes(data, plan.positions, result, spline)
        return result

    def affine(self, plan: plans.Affine) -> Array:
        """The spline on a grid that a matrix places."""
        result = self._result(plan)
        affinely(self.data, plan.axes, plan.matrix, plan.offset, result, plan.spline)
        return result

    def points(self, plan: plans.Points) -> Array:
        """The spline at points."""
        result = self._result(plan)
        at_points(self.data, plan.axes, plan.coordinates, result, plan.spline)
        return result

    def mapped(self, plan: Mapped) -> Array:
        """The spline where a function of the index says, which is called once for each element of the result, in their order."""
        result, ndim = self._result(plan), self.ndim
        indices = itertools.product(*map(range, plan.shape))

        def positions(first: int, last: int) -> _Floats:
            found = np.empty((last - first, ndim))
            for start in range(0, last - first, 4096):
                rows = found[start : start + 4096]
                rows[...] = as_rows(list(map(plan.at, itertools.islice(indices, len(rows)))), ndim)
            return found.T

        _by_pieces(self.data, result, plan.spline, positions)
        return result

    def coefficients(self, plan: Coefficients) -> Array:
        """Spline coefficients."""
        result = self._result(plan, not plan.axes)
        if plan.axes:
            filtered(self.data, plan.axes, result, plan.spline)
        else:
            result[...] = self.data
        return result

    def _result(self, plan: Plan, copied: bool = False) -> Array:
        return as_output(plan.output, self.dtype, plan.shape, copied=copied)


def along_axes(data: Array, positions: Sequence[_Floats | None], output: Array, spline: Spline) -> None:
    """The spline on a grid along the axes, into `output`. None are the positions of an axis's samples."""
    if not spline.interpolates:
        positions = [_samples(n) if p is None else p for p, n in zip(positions, data.shape, strict=True)]
    _along({axis: p for axis, p in enumerate(positions) if p is not None}, data, output, spline)


def _along(moved: dict[int, _Floats], data: Array, output: Array, spline: Spline) -> None:
    """The spline on a grid along some axes, the others being left as they are."""
    if moved:
        _grids(data, _separately(moved, data.shape), output, spline)
    elif output.dtype.kind in "fc" or output.dtype == data.dtype:
        output[...] = data
    else:  # the engine rounds
        nearest = replace(spline, order=0)
        _grids(data, [([data.ndim - 1], Axes((_samples(data.shape[-1]),)))], output, nearest)


def affinely(data: Array, axes: Sequence[int], matrix: _Floats, offset: _Floats, output: Array, spline: Spline) -> None:
    """The spline at ``matrix @ i + offset`` for each index of `output` along some axes, the others being left as they are.

    The axes are ascending, as many as the matrix has rows. Where it is not square they are all, and `output` has an axis a column.
    """
    rows, columns = matrix.shape
    if columns > rows:
        _by_pieces(data, output, spline, lambda first, last: _positions(matrix, offset, output.shape, first, last))
        return
    if columns < rows:  # the result gets axes of one sample
        matrix = np.hstack([matrix, np.zeros((rows, rows - columns))])
        output = output[(..., *[np.newaxis] * (rows - columns))]
    number = {axis: k for k, axis in enumerate(axes)}
    table, starts, shape = matrix.tolist(), offset.tolist(), output.shape
    mixed: list[list[int]] = []
    alone: dict[int, _Floats] = {}
    for group in _groups(axes, table):
        axis, k = group[0], number[group[0]]
        if len(group) > 1:
            mixed.append(group)
        elif not (spline.interpolates and (table[k][k], starts[k], shape[axis]) == (1, 0, data.shape[axis])):
            alone[axis] = np.arange(shape[axis]) * table[k][k] + starts[k]
    if not mixed:
        _along(alone, data, output, spline)
        return
    together = sorted([axis for group in mixed for axis in group] + list(alone))
    if len(together) <= NATIVE:
        mixed, alone = [together], {}
    passes: list[_Pass] = []
    for group in mixed:
        at = [number[axis] for axis in group]
        passes.append((group, Affine(matrix[np.ix_(at, at)], offset[at], tuple(shape[axis] for axis in group))))
    _grids(data, passes + _separately(alone, data.shape), output, spline)


def at_points(data: Array, axes: Sequence[int], coordinates: Array, output: Array, spline: Spline) -> None:
    """The spline at points, which have coordinates along some axes, ascending; the other axes come first in `output`."""
    require_few(len(axes))
    if np.may_share_memory(coordinates, output):
        coordinates = coordinates.copy()
    data, coordinates = _around(data, axes, coordinates, spline)
    _in_parts(data, output, spline, lambda *parts: _evaluate(parts[0], axes, Points(coordinates), *parts[1:]))


def filtered(data: Array, axes: Sequence[int], output: Array, spline: Spline) -> None:
    """The coefficients along some axes, into `output`.

    Integers are cut off, not rounded, and after each axis, as in SciPy.
    """
    require_global(spline)
    exact = output.dtype.kind in "fc"
    count = NATIVE if exact else 1
    groups = [list(axes[k : k + count]) for k in range(0, len(axes), count)]

    def compute(source: Array, target: Array, spline: Spline) -> None:
        onto = target if exact else np.empty(target.shape)
        for number, group in enumerate(groups):
            engine.coefficients(source, group, onto, spline.stage(number, len(groups)))
            if not exact:
                with np.errstate(invalid="ignore"):
                    target[...] = np.trunc(onto)
            source = target

    if output.size:
        _in_parts(data, output, spline, compute)


def require_global(spline: Spline) -> None:
    """Refuse ``nan="local"`` for coefficients."""
    if spline.local:
        raise OptionError('nan must be "propagate" or "error" for coefficients, which depend on all samples; got "local"')


def _in_parts(data: Array, output: Array, spline: Spline, compute: Callable[[Array, Array, Spline], None]) -> None:
    """Complex samples as two real arrays; an input that overlaps `output` is copied first."""
    if np.may_share_memory(data, output):
        memory.require(data.nbytes, "a copy of the input, which the result overlaps,")
        data = data.copy()
    if data.dtype.kind == "c":
        for number, part in enumerate(("real", "imag")):
            compute(getattr(data, part), getattr(output, part), spline.of_part(part, number))
    else:
        compute(data, output, spline)


def _evaluate(data: Array, axes: Sequence[int], target: Target, output: Array, spline: Spline) -> None:
    if output.size == 0:
        return
    if data.size == 0:
        if spline.mode not in ("constant", "grid-constant"):
            raise DataError(f'input must have samples where mode is not "constant" or "grid-constant"; got shape {data.shape}')
        output[...] = stored(spline.cval, output.dtype)
        return
    (evaluate_locally if spline.local else engine.evaluate)(data, axes, target, output, spline)


def evaluate_locally(data: Array, axes: Sequence[int], target: engine.Target, output: Array, spline: Spline) -> None:
    """`engine.evaluate` by the rule "local" of `clvol.Missing`: NaN where a sample that is not finite has weight, and nowhere else.

    A sample has weight where the B-spline of the order, whose weights are positive, is not 0 in float32. All other results are bit
    for bit those of the filled array.
    """
    where = Missing("local").of(data)
    if where is None:
        engine.evaluate(data, axes, target, output, spline)
        return
    if output.dtype.kind != "f":
        raise OptionError(f'output must be floating where nan="local" leaves results missing; got {output.dtype}')
    kept = [axis for axis in range(data.ndim) if axis not in axes]
    filled = data.copy()
    target_of, samples, gaps = (array.transpose((*kept, *axes)) for array in (filled, data, where))
    for index in np.ndindex(target_of.shape[: len(kept)]):
        if gaps[index].any():
            target_of[index] = filled_smoothly(samples[index], gaps[index])

    engine.evaluate(filled, axes, target, output, spline.stage(0, 2))
    share = np.empty(output.shape, np.float32)
    weights = replace(spline.stage(1, 2), cval=0.0, prefilter=False, precision="single")
    engine.evaluate(where.view(np.uint8), axes, target, share, weights)
    output[share != 0] = np.nan


def _grids(data: Array, passes: Sequence[_Pass], output: Array, spline: Spline) -> None:
    """One pass after the other, each over some of the axes, whose grids are independent."""
    _require_unmixed(max(passes, key=lambda one: len(one[0]))[0])
    if len(passes) == 1:
        axes, grid = _joined(data, *passes[0], spline)
        _in_parts(data, output, spline, lambda *parts: _evaluate(parts[0], axes, grid, *parts[1:]))
        return
    if spline.labels:
        raise UnsupportedError(f'order "labels" takes an input of up to {NATIVE} axes; got {data.ndim}')

    def compute(source: Array, target: Array, spline: Spline) -> None:
        kind = np.float64 if spline.precision == "double" else np.float32
        between = replace(spline, cval=0.0) if spline.mode == "constant" else spline
        size = data.shape
        for number, (axes, grid) in enumerate(passes):
            size = tuple(target.shape[k] if k in axes else n for k, n in enumerate(size))
            onto = target if number == len(passes) - 1 else _between(size, kind)
            _evaluate(source, axes, grid, onto, between.stage(number, len(passes)))
            source = onto
        if spline.mode == "constant":
            value = stored(spline.cval, target.dtype)
            for axes, grid in passes:
                _beyond(target, axes)[_outside(grid, [data.shape[axis] for axis in axes])] = value

    _in_parts(data, output, spline, compute)


def _require_unmixed(axes: Sequence[int]) -> None:
    if len(axes) > NATIVE:
        raise UnsupportedError(
            f"a matrix must not mix more than {NATIVE} axes of input with each other; got one that mixes axes {axes}"
        )


def require_mixable(matrix: _Floats, axes: Sequence[int], pieces: bool) -> None:
    """Refuse a matrix that `affinely` cannot take: `pieces`: whether it has more columns than rows."""
    if pieces:
        require_few(len(axes))
        return
    rows, columns = matrix.shape
    square = np.hstack([matrix, np.zeros((rows, rows - columns))])[np.ix_(axes, axes)].tolist()
    _require_unmixed(max(_groups(axes, square), key=len))


def _between(size: tuple[int, ...], kind: type[np.generic]) -> Array:
    """An array for the result of a pass that is not the last."""
    return memory.empty(size, kind, f"an intermediate result of {size} samples")


def _joined(data: Array, axes: list[int], grid: Axes | Affine, spline: Spline) -> _Pass:
    """A pass over one axis, together with the one or two that are left alone, at their samples, where that is faster.

    Not where a sample is not finite, which would spread along them.
    """
    others = [axis for axis, n in enumerate(data.shape) if axis not in axes and n > 1]
    if not isinstance(grid, Axes) or len(axes) != 1 or not 0 < len(others) < NATIVE or not spline.interpolates:
        return axes, grid
    with np.errstate(all="ignore"):
        if not np.isfinite(data.sum()):
            return axes, grid
    together = sorted(axes + others)
    positions = [grid.positions[0] if axis in axes else _samples(data.shape[axis]) for axis in together]
    return together, Axes(tuple(positions))


def _around(data: Array, axes: Sequence[int], coordinates: Array, spline: Spline) -> tuple[Array, Array]:
    """The part of a large array that a few points need: along each axis the samples around them, where these do not reach an edge.

    The prefilter's response decays like powers of its largest pole; what is cut off is less than float64 resolves.
    """
    if data.size < _LARGE or coordinates.size > data.size // 8 or not coordinates.size:
        return data, coordinates
    margin = spline.order // 2 + 1 + (reach_within(bspline(spline.order), _LEFT_OUT) if spline.prefilter else 0)
    inner, starts = [slice(None)] * data.ndim, np.zeros((len(coordinates), *[1] * (coordinates.ndim - 1)))
    for number, (axis, along) in enumerate(zip(axes, coordinates, strict=True)):
        low, high = float(along.min()), float(along.max())
        if math.isfinite(low) and math.isfinite(high) and low >= margin and high <= data.shape[axis] - 1 - margin:
            inner[axis] = slice(math.floor(low) - margin, math.ceil(high) + margin + 1)
            starts[number] = math.floor(low) - margin
    return data[tuple(inner)], coordinates - starts


def require_few(count: int) -> None:
    if count > NATIVE:
        raise UnsupportedError(
            f"points must have coordinates along at most {NATIVE} axes of input; got {count}. "
            "map_coordinates(..., axes=...) leaves the other axes as they are"
        )


def _separately(positions: dict[int, _Floats], shape: Sequence[int]) -> list[_Pass]:
    """Passes for independent axes; those that shrink the data most come first.

    Each pass has as many as possible, since an axis alone takes longest.
    """
    ordered = sorted(positions, key=lambda axis: len(positions[axis]) / max(shape[axis], 1))
    count = -(-len(ordered) // NATIVE)
    groups = [sorted(ordered[k * len(ordered) // count : (k + 1) * len(ordered) // count]) for k in range(count)]
    return [(group, Axes(tuple(positions[axis] for axis in group))) for group in groups]


def _groups(axes: Sequence[int], matrix: Sequence[Sequence[float]]) -> list[list[int]]:
    """The axes in groups that the matrix does not mix with each other."""
    label = {axis: axis for axis in axes}
    for axis, row in zip(axes, matrix, strict=True):
        for other, entry in zip(axes, row, strict=True):
            if entry != 0 and label[other] != label[axis]:
                old, new = label[axis], label[other]
                label = {key: new if value == old else value for key, value in label.items()}
    return [[axis for axis in axes if label[axis] == one] for one in dict.fromkeys(label.values())]


def _outside(grid: Axes | Affine, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Where a grid lies outside the samples along any of its axes."""
    if isinstance(grid, Axes):
        at = np.ix_(*grid.positions)
    else:
        size = math.prod(grid.shape)
        at = tuple(row.reshape(grid.shape) for row in _positions(grid.matrix, grid.offset, grid.shape, 0, size))
    inside: NDArray[np.bool_] = np.ones((), bool)
    for along, n in zip(at, shape, strict=True):
        inside = inside & (along >= 0) & (along <= n - 1)
    return ~inside


def _beyond(output: Array, axes: Sequence[int]) -> Array:
    """`output` with some axes first."""
    return output.transpose([*axes, *(axis for axis in range(output.ndim) if axis not in axes)])


def _by_pieces(data: Array, output: Array, spline: Spline, positions: Callable[[int, int], _Floats]) -> None:
    """The spline at positions that are computed piece by piece, of shape (k, n) for n elements of `output` in order.

    They may come from a function of the user's, so nothing is written before the last one is known.
    """
    require_few(data.ndim)
    size = output.size
    piece = max(_PIECE, data.size // 4)
    count = max(1, -(-size // piece))
    memory.require(output.nbytes + 32 * min(piece, size) * data.ndim, "a result, until all of its positions are known,")
    result = np.empty(size, output.dtype)
    for number, first in enumerate(range(0, size, piece)):
        last = min(first + piece, size)
        axes = range(data.ndim)
        at_points(data, axes, positions(first, last), result[first:last], spline.stage(number, count))
    output[...] = result.reshape(output.shape)


def _positions(matrix: _Floats, offset: _Floats, shape: Sequence[int], first: int, last: int) -> _Floats:
    """Positions of elements of the result, summed in SciPy's order: the offset, then from the first axis to the last."""
    index = np.unravel_index(np.arange(first, last), tuple(shape))
    found = np.repeat(offset[:, np.newaxis], last - first, axis=1)
    for along, row in zip(found, matrix, strict=True):
        for entry, number in zip(row, index, strict=True):
            along += number * entry
    return found


def as_rows(answers: list[Any], count: int) -> _Floats:
    """The positions that a function returned, as rows."""
    if len(answers) > _FEW and set(map(type, answers)) == {tuple} and set(map(len, answers)) == {count}:
        numbers = list(itertools.chain.from_iterable(answers))
        if set(map(type, numbers)) <= _NUMBERS:  # a tenth of the time below
            return np.array(numbers, np.float64).reshape(-1, count)
    try:
        rows = np.array(answers, np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] < count:
        wrong = next((one for one in answers if not _is_point(one, count)), answers[0])
        raise OptionTypeError(f"mapping must return {count} real numbers, one for each axis of input; got {wrong!r}")
    return rows[:, :count]


def _is_point(answer: Any, count: int) -> bool:
    try:
        return np.array(answer, np.float64).ndim == 1 and len(answer) >= count
    except (TypeError, ValueError):
        return False


def _samples(n: int) -> _Floats:
    return np.arange(n, dtype=np.float64)


def stored(value: complex, dtype: np.dtype[Any]) -> Any:
    """A number as the engine writes it: integers are rounded, halves away from zero, and clipped to their type."""
    if dtype.kind == "c":
        return value
    number = float(value.real)
    if dtype.kind == "b":
        return abs(number) >= 1  # not NaN
    if dtype.kind not in "iu" or math.isnan(number):
        return 0 if dtype.kind in "iu" else number
    limits = np.iinfo(dtype)
    if math.isinf(number):
        return limits.max if number > 0 else limits.min
    return min(max(int(number + math.copysign(0.5, number)), int(limits.min)), int(limits.max))
