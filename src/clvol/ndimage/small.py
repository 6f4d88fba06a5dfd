"""Small calls: what SciPy computes sooner than a kernel starts.

A call goes to SciPy by its size alone, never by a measured time, so that its result is the same on every machine and in every run.
Differences between the two are kept out: axes up to `_SHORT` samples are filtered here, by the matrix of their boundary rule, which
is exact for "reflect" too; whatever SciPy treats in another way (see "What differs" in docs/scipy.md) is left to clvol, and so is
every result that is not finite. What depends on shapes, types and options alone is kept in plans.
"""

from __future__ import annotations

import inspect
import itertools
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from math import cos, isfinite, prod, radians, sin
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import flag, one_of
from clvol.filter.boundary import Boundary, as_boundary
from clvol.ndimage.arguments import BOUNDARIES, Array, as_array, as_shape, finite, per_axis
from clvol.ndimage.engine import FILTERED_AS, row_of
from clvol.ndimage.geometry import diagonal, placed, plane_of, turned
from clvol.ndimage.in_memory import as_rows

__all__ = ["ALL", "BY", "Small", "calls_by_scipy", "coefficients", "count", "originals"]

BY = ("scipy", "opencl")
"""What may compute small calls."""
_OPERATIONS = 6 << 16
"""What SciPy computes in about the time in which kernels start: the weights of each element, and `_SAMPLE` for each sample and
axis that is filtered."""
_LINE = 64
"""Times as many of one axis: kernels share work between cores by rows."""
_POINTS = 32
"""Times fewer of these at given points, which kernels share between cores too."""
_COEFFICIENT = 4
"""Samples of one axis that are filtered in the time of a point."""
_SAMPLE = 2
_CALL = 1 << 10
"""What a call of SciPy's costs, where there is one for each plane."""
_SHORT = 32
"""Samples along an axis up to which it is filtered by a matrix."""
_ALONE = 1 << 13
"""Numbers up to which BLAS starts no threads, which may take longer than all the rest."""
_SINGLE = 12
"""Numbers up to which they are asked about one by one."""
_ANSWERS = 4
"""Positions up to which SciPy asks a function for them."""
_FEW = 64
"""Samples up to which all axes are filtered together, by one matrix."""
_PLANS = 256
ALL = object()
"""All axes."""
_PADDED = ("nearest", "grid-constant")
"""Modes in which SciPy pads the samples before it filters them."""
_PADDING = 12
"""Samples that it pads an end with."""
_DOUBLE = np.dtype(np.float64)
_FLOATS = frozenset({np.dtype(np.float32), _DOUBLE})
_KNOWN = _FLOATS | frozenset(np.dtype(f"{kind}{size}") for kind in "iu" for size in (1, 2, 4)) | {np.dtype("i8")}
"""Native types that both round and clip alike."""
_AS_SCIPY = "scipy", "propagate", None, None, None, None
_ARRAYS = (np.ndarray, list, tuple)
_MOST = 1e300  # of `cval`
_WIDEST = 1 << 60
"""Magnitudes of int64 up to which conversions of float64 cannot overflow."""

_Floats = NDArray[np.float64]
_vdot: Callable[[Array, Array], float] = inspect.unwrap(np.vdot)
"""Without the question whether an argument has an ``__array_function__``, which takes half as long again."""


_here = threading.local()
_counted = False
_functions: dict[str, Callable[..., Any]] = {}


def _by_clvol(how: tuple[Any, ...]) -> bool:
    """Whether a call says how clvol computes it: by `small`, `nan`, `precision`, `device`, `progress`, or one more option."""
    try:
        if how == _AS_SCIPY:
            return False
    except ValueError:  # an array
        pass
    if how[0] not in BY:
        raise one_of("small", how[0], BY)
    return True


def count(on: bool) -> None:
    """Start or end counting the calls that go to SciPy: it would take a twentieth of the smallest ones' time."""
    global _counted
    _counted = on


def calls_by_scipy() -> int:
    """How many calls of this thread went to SciPy while they were counted."""
    return getattr(_here, "calls", 0)


def originals() -> dict[str, Callable[..., Any]]:
    """SciPy's functions. `clvol.ndimage.patched` has them looked up before it replaces them."""
    if not _functions:
        from scipy import ndimage

        _functions.update({name: getattr(ndimage, name) for name in ndimage.__all__})
    return _functions


class _Plan(NamedTuple):
    """What follows from the shape and type of the input and from the options: `kind` of the result, how axes are filtered."""

    kind: np.dtype[Any]
    order: int
    mode: str
    whole: _Floats | None  # the matrix that filters all axes together
    steps: tuple[_Step, ...]  # of what is not filtered so, nor by SciPy
    line: bool  # whether SciPy filters it, of one axis
    filtered: bool
    by_scipy: bool
    most: int  # elements of a result
    coordinates: int  # of given points, at most
    accepts: Callable[[Array], bool] | None  # whether a result is one that clvol would compute too


class _Plans(dict[tuple[Any, ...], _Plan | None]):
    """Plans by what they depend on; None if a call is not for SciPy. They are found sooner than by `lru_cache`."""

    def __init__(self, make: Callable[..., _Plan | None]) -> None:
        self.make = make

    def __missing__(self, key: tuple[Any, ...]) -> _Plan | None:
        if len(self) >= _PLANS:
            self.clear()
        self[key] = plan = self.make(*key)
        return plan


class _Step(NamedTuple):
    """How an axis is filtered: by a matrix, or by SciPy if there is none."""

    axis: int
    inverse: _Floats | None


def coefficients(given: object, output: Any, order: object, mode: object, axis: object, how: tuple[Any, ...]) -> Array | None:
    """The coefficients along an axis, or along `ALL`, as `clvol.ndimage.spline_filter1d`; None if the call is not small.

    `how` are options of clvol's own, as `_by_clvol` takes them.
    """
    if _by_clvol(how) or type(order) is not int or (type(axis) is not int and axis is not ALL):
        return None
    if type(given) is not np.ndarray:
        if not isinstance(given, _ARRAYS):
            return None
        given = as_array(given)
    if type(output) is np.ndarray:
        if output.shape != given.shape or not _writable(output, given):
            return None
        found = coefficients(given, output.dtype, order, mode, axis, how)
        if found is not None:
            output[...] = found
        return found if found is None else output
    try:
        plan = _filters[given.shape, given.dtype, output, order, mode, axis]
    except TypeError:  # what cannot be hashed
        return None
    if plan is None:
        return None
    data = _filtered(given, plan)
    if data is None:
        return None
    if _counted:
        _here.calls = calls_by_scipy() + 1
    return data if plan.kind is _DOUBLE and data is not given else data.astype(plan.kind)


class Small:
    """The input and the options of a call that both would compute; its methods return None where the call is not small."""

    __slots__ = ("cval", "data", "output", "plan")
    data: Array
    output: Array | np.dtype[Any]
    cval: float
    plan: _Plan

    @classmethod
    def of(
        cls, given: object, output: Any, order: object, mode: object, cval: object, prefilter: object, how: tuple[Any, ...]
    ) -> Small | None:
        """None if the input is large or anything is not of the simplest kind; `how` is as for `coefficients`."""
        if _by_clvol(how) or type(order) is not int:
            return None
        if (type(cval) is not float and not isinstance(cval, (float, int))) or not -_MOST < cval < _MOST:
            return None
        if type(given) is not np.ndarray:
            if not isinstance(given, _ARRAYS):
                return None
            given = as_array(given)
        kind = output
        if type(output) is np.ndarray:
            if not _writable(output, given):
                return None
            kind = output.dtype
        try:
            plan = _interpolations[given.shape, given.dtype, kind, order, mode, prefilter]
        except TypeError:  # what cannot be hashed
            return None
        if plan is None:
            return None
        call = cls()  # whose attributes are set sooner here than by a method
        call.data, call.cval, call.plan = given, cval, plan
        call.output = plan.kind if kind is output else output
        return call

    def map_coordinates(self, coordinates: Any) -> Array | None:
        """As `clvol.ndimage.map_coordinates`."""
        if type(coordinates) is not np.ndarray:
            if not isinstance(coordinates, (list, tuple)):
                return None
            try:
                coordinates = np.asarray(coordinates)
            except ValueError:
                return None
        dtype = coordinates.dtype
        if (dtype is not _DOUBLE and dtype not in _KNOWN) or coordinates.ndim < 2 or len(coordinates) != self.data.ndim:
            return None
        if not 0 < coordinates.size <= self.plan.coordinates or not _finite(coordinates):
            return None
        if type(self.output) is np.ndarray and np.may_share_memory(coordinates, self.output):
            return None
        return self._by("map_coordinates", coordinates)

    def geometric_transform(
        self, mapping: Callable[..., Sequence[float]], output_shape: Any, answers: list[Sequence[float]]
    ) -> Array | None:
        """As `clvol.ndimage.geometric_transform`, of a few elements; of more `positions` are sooner there.

        `answers` are filled, for those if an answer is not as SciPy needs it.
        """
        shape, ndim = self.data.shape if output_shape is None else as_shape(output_shape), self.data.ndim
        if not shape or prod(shape) > _ANSWERS or not 0 < prod(shape) * ndim <= self.plan.coordinates:
            return None

        def sound(index: tuple[int, ...]) -> Sequence[float]:
            answers.append(at := mapping(index))
            if type(at) is not tuple or len(at) != ndim or not isfinite(sum(at)):
                raise ValueError
            return at

        return self._by("geometric_transform", sound, None, shape)

    def positions(
        self, mapping: Callable[..., Sequence[float]], output_shape: Any, answers: list[Sequence[float]]
    ) -> _Floats | None:
        """Where a function of the index says, as `map_coordinates` takes them; its first `answers` are there."""
        shape, ndim = self.data.shape if output_shape is None else as_shape(output_shape), self.data.ndim
        if not shape or not 0 < prod(shape) * ndim <= self.plan.coordinates:
            return None
        rest = itertools.islice(itertools.product(*map(range, shape)), len(answers), None)
        return as_rows([*answers, *map(mapping, rest)], ndim).T.reshape(ndim, *shape)

    def affine_transform(self, matrix: Any, offset: Any, output_shape: Any) -> Array | None:
        """As `clvol.ndimage.affine_transform`."""
        data = self.data
        like = self.output if type(self.output) is np.ndarray else data
        shape = like.shape if output_shape is None else as_shape(output_shape)
        if len(shape) != data.ndim or not 0 < prod(shape) <= self.plan.most:
            return None
        simple = type(matrix) is np.ndarray and matrix.shape == (data.ndim,) * 2 and matrix.dtype in _FLOATS
        if simple and _finite(matrix) and type(offset) is float and isfinite(offset):
            return self._by("affine_transform", matrix, offset, shape)
        table, start = placed(matrix, offset, data.ndim, len(shape))
        if table.ndim == 2:
            return self._by("affine_transform", table, start, shape)
        along = diagonal(table, start, data.shape, shape)  # SciPy would warn of such a matrix
        at = [np.arange(n, dtype=np.float64) if one is None else one for one, n in zip(along, shape, strict=True)]
        return self.map_coordinates(np.array(np.meshgrid(*at, indexing="ij")))

    def shift(self, shift: Any) -> Array | None:
        """As `clvol.ndimage.shift`."""
        if self.data.size > self.plan.most:
            return None
        return self._by("shift", per_axis("shift", shift, self.data.ndim))

    def zoom(self, zoom: Any, grid_mode: object) -> Array | None:
        """As `clvol.ndimage.zoom`."""
        if grid_mode and self.plan.mode in ("constant", "wrap"):  # which warns, of the caller's line
            return None
        shape = self.data.shape
        factors = per_axis("zoom", zoom, len(shape))
        if min(factors) < 0 or factors.count(1) == len(shape):
            return None
        if not 0 < prod(map(round, map(mul, shape, factors))) <= self.plan.most:
            return None
        return self._by(partial(originals()["zoom"], grid_mode=True) if grid_mode else "zoom", factors)

    def rotate(self, angle: Any, axes: Any, reshape: Any) -> Array | None:
        """As `clvol.ndimage.rotate`: planes one after the other, as SciPy, or together where that has fewer operations."""
        data, plan, shape = self.data, self.plan, list(self.data.shape)
        if data.ndim < 3:
            if data.size > plan.most:
                return None
            _, matrix, start, size = turned(angle, axes, reshape, data.shape)
            return self._by("affine_transform", matrix, start, size) if 0 < prod(size) <= plan.most else None
        plane, turn = plane_of(axes, data.ndim), finite("angle", angle)
        if flag("reshape", reshape):
            height, width = (shape[axis] for axis in plane)
            c, s = abs(cos(radians(turn))), abs(sin(radians(turn)))
            shape[plane[0]], shape[plane[1]] = round(c * height + s * width), round(s * height + c * width)
        count, taps = prod(shape), plan.order + 1
        left = 3 - sum(plane)
        by_planes, together = count * taps**2 + _CALL * shape[left], count * taps**3 + _CALL
        if data.size * taps**2 > _OPERATIONS or by_planes >= _OPERATIONS:
            return None
        if plan.by_scipy:  # which filters the padding too
            wide = [n + 2 * _PADDING for n in data.shape]
            together += 3 * _SAMPLE * prod(wide)
            by_planes += 2 * _SAMPLE * prod(wide) // wide[left] * shape[left]
        if by_planes >= together and (plan.order < 2 or plan.filtered):
            plane, matrix, start, size = turned(turn, axes, reshape, data.shape)
            turning, offset = np.eye(data.ndim), np.zeros(data.ndim)
            turning[np.ix_(plane, plane)], offset[plane] = matrix, start
            return self._by("affine_transform", turning, offset, size)
        if plan.filtered and not plan.by_scipy:
            along = _plane_plan(data.shape, plan.kind, plan.order, plan.mode, tuple(plane))
            if along is None:
                return None
            self.plan = along
        return self._by("rotate", turn, plane, reshape)

    def _by(
        self, function: str | Callable[..., Array], at: Any, offset: Any = None, shape: tuple[int, ...] | bool | None = None
    ) -> Array | None:
        """The result of a function of SciPy's; what it refuses is left to clvol, whose error tells more."""
        plan, data = self.plan, self.data
        if plan.by_scipy:
            data = data.astype(np.float64, copy=False)  # which holds every `cval`
        elif plan.filtered:
            filtered = _filtered(data, plan)
            if filtered is None:
                return None
            data = filtered
        call = (_functions or originals())[function] if isinstance(function, str) else function
        try:  # with its arguments one by one: a tuple of them would take a tenth of the smallest calls' time
            if shape is None:
                result: Array = call(data, at, self.output, plan.order, plan.mode, self.cval, plan.by_scipy)
            elif offset is None:
                result = call(data, at, shape, self.output, plan.order, plan.mode, self.cval, plan.by_scipy)
            else:
                result = call(data, at, offset, shape, self.output, plan.order, plan.mode, self.cval, plan.by_scipy)
        except (RuntimeError, ValueError, TypeError):
            return None
        if plan.accepts is not None and not plan.accepts(result):
            return None
        if _counted:
            _here.calls = calls_by_scipy() + 1
        return result


def _finite(numbers: Array) -> bool:
    """Whether all numbers are finite, and of some also their sum or their squares, which is faster to ask."""
    if numbers.size <= _SINGLE:
        return isfinite(sum(numbers.ravel().tolist()))
    if numbers.size > _ALONE:
        return bool(np.isfinite(numbers).all())
    return isfinite(_vdot(numbers, numbers))  # which, other than `dot`, does not warn


def _narrow(numbers: Array) -> bool:
    """Whether all whole numbers are such that a conversion of float64 cannot have overflowed."""
    return bool(numbers.min() > -_WIDEST and numbers.max() < _WIDEST)


def _check(kind: np.dtype[Any], order: int) -> Callable[[Array], bool] | None:
    """What is to be asked about results of a type: those of order 0 are samples, whatever these are."""
    return _narrow if kind.kind in "iu" and kind.itemsize == 8 else _finite if kind in _FLOATS and order else None


def _writable(output: Array, input: Array) -> bool:
    return output.flags.writeable and not np.may_share_memory(input, output)


def _make(shape: tuple[int, ...], dtype: np.dtype[Any], output: Any, order: int, mode: object, prefilter: object) -> _Plan | None:
    """The plan of an interpolation; None if it is not for SciPy."""
    if dtype not in _KNOWN or not 0 < len(shape) <= 3 or not prod(shape):
        return None
    if not 0 <= order <= 5 or type(mode) is not str or mode not in BOUNDARIES:
        return None
    kind = dtype if output is None else np.dtype(output)
    if kind not in _FLOATS and (kind not in _KNOWN or dtype in _FLOATS):  # NaN as an integer is not the same by both
        return None
    filtered = order > 1 and bool(prefilter)
    left = _most(len(shape)) - (_SAMPLE * len(shape) * prod(shape) if filtered else 0)
    if left < 0:
        return None
    by_scipy = filtered and mode in _PADDED
    most = left // (order + 1) ** len(shape)
    points = most if len(shape) > 1 else most // _POINTS - (prod(shape) // _COEFFICIENT if filtered else 0)
    plan = _Plan(kind, order, mode, None, (), False, filtered, by_scipy, most, points * len(shape), _check(kind, order))
    return _filtering(plan, shape, range(len(shape))) if filtered and not by_scipy else plan


def _make_filter(shape: tuple[int, ...], dtype: np.dtype[Any], output: Any, order: int, mode: object, axis: object) -> _Plan | None:
    """The plan of a filter along an axis, or along all of them."""
    plan = _make(shape, dtype, output, order, mode, False)
    ndim = len(shape)
    if plan is None or plan.kind not in _FLOATS:
        return None
    if axis is ALL:
        axes = list(range(ndim))
    elif type(axis) is int and -ndim <= axis < ndim:
        axes = [axis % ndim]
    else:
        return None
    if _SAMPLE * len(axes) * prod(shape) > _most(ndim) or (axis is ALL and plan.order < 2):
        return None
    return _filtering(plan, shape, axes) if plan.order > 1 else plan


_interpolations, _filters = _Plans(_make), _Plans(_make_filter)


@lru_cache(maxsize=_PLANS)
def _plane_plan(shape: tuple[int, ...], kind: np.dtype[Any], order: int, mode: str, plane: tuple[int, ...]) -> _Plan | None:
    """The plan of an interpolation in planes."""
    return _filtering(_Plan(kind, order, mode, None, (), False, True, False, 0, 0, _check(kind, order)), shape, plane)


def _most(ndim: int) -> int:
    """Operations of a small call."""
    return _OPERATIONS * _LINE if ndim == 1 else _OPERATIONS


def _filtering(plan: _Plan, shape: Sequence[int], axes: Sequence[int]) -> _Plan | None:
    """A plan that filters some axes; None if SciPy would, inexactly."""
    order, mode = plan.order, plan.mode
    if 1 < prod(shape) <= _FEW:
        whole: Array = np.ones((1, 1))
        for axis, n in enumerate(shape):
            whole = np.kron(whole, _inverse(order, mode, n) if axis in axes and n > 1 else np.eye(n))
        return plan._replace(whole=whole)
    alone = prod(shape) <= _ALONE
    if not alone and _rule(mode).name == "reflect" and any(1 < shape[axis] <= _SHORT for axis in axes):
        return None
    steps = [
        _Step(axis, _inverse(order, mode, shape[axis]) if alone and shape[axis] <= _SHORT else None)
        for axis in axes
        if shape[axis] > 1
    ]
    return plan._replace(steps=tuple(steps), line=len(shape) == 1 and any(step.inverse is None for step in steps))


def _rule(mode: str) -> Boundary:
    """The boundary rule by which a mode filters."""
    return as_boundary(FILTERED_AS.get(mode, BOUNDARIES[mode]))


def _filtered(data: Array, plan: _Plan) -> Array | None:
    """The coefficients of an array, along the axes of a plan; None if they may not be finite: a matrix times infinity warns."""
    if plan.line:  # along which one sample that is not finite makes all coefficients NaN, and every result that they have a part in
        line: Array = (_functions or originals())["spline_filter1d"](data, plan.order, 0, _DOUBLE, plan.mode)
        return line
    if plan.order < 2 and plan.kind is _DOUBLE:
        return data
    if not _finite(data):
        return None
    if plan.whole is not None:
        filtered: Array = plan.whole.dot(data) if data.ndim == 1 else plan.whole.dot(data.ravel()).reshape(data.shape)
        return filtered
    for axis, inverse in plan.steps:
        if inverse is None:
            data = originals()["spline_filter1d"](data, plan.order, axis, np.float64, plan.mode)
        elif axis == 0:
            data = inverse.dot(data.reshape(len(data), -1)).reshape(data.shape)
        elif axis < data.ndim - 1:
            data = inverse @ data
        elif axis == 1:
            data = data.dot(inverse.T)
        else:  # `dot` is by BLAS for two axes only, and sooner than `@`
            data = data.reshape(-1, data.shape[-1]).dot(inverse.T).reshape(data.shape)
    return data


@lru_cache(maxsize=_PLANS)
def _inverse(order: int, mode: str, n: int) -> _Floats:
    """The matrix that turns `n` samples into coefficients: the inverse of eq. (11) of the paper, by the rule of a mode."""
    return np.asarray(np.linalg.inv(_rule(mode).ends.matrix(row_of(order, True).undone, n)), np.float64)
