"""The arguments of the functions of `clvol.ndimage`, checked and in one form; refused with the exceptions that SciPy raises."""

from __future__ import annotations

import math
import operator
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import arrays, memory
from clvol.base.checks import enough_memory, one_of
from clvol.base.errors import (
    AxisError,
    DataError,
    DtypeError,
    NotFiniteError,
    OptionError,
    OptionTypeError,
    OutOfMemoryError,
    RefusedError,
    UnsupportedError,
)
from clvol.base.progress import part_of
from clvol.device import Device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.spline.field import Precision

__all__ = [
    "BOUNDARIES",
    "FINITE",
    "MODES",
    "NAN",
    "AnyDevice",
    "Array",
    "Nan",
    "Order",
    "Progress",
    "Spline",
    "as_array",
    "as_axes",
    "as_axis",
    "as_coordinates",
    "as_cval",
    "as_dtype",
    "as_matrix",
    "as_mode",
    "as_order",
    "as_output",
    "as_precision",
    "as_shape",
    "finite",
    "per_axis",
    "require_addressable",
    "require_coordinates",
    "require_finite",
    "require_of_labels",
    "warn",
]

Array: TypeAlias = NDArray[Any]
AnyDevice: TypeAlias = Device | str | int | None
Progress: TypeAlias = Callable[[float], None] | None
Nan: TypeAlias = str
Order: TypeAlias = int | Literal["labels"]

BOUNDARIES = {
    "mirror": "mirror",
    "reflect": "reflect",
    "grid-mirror": "reflect",
    "wrap": "overlap",
    "grid-wrap": "wrap",
    "nearest": "nearest",
    "constant": "constant",
    "grid-constant": "grid-constant",
}
"""The boundary rule of each of SciPy's modes."""
MODES = tuple(BOUNDARIES)
FINITE = 'with nan="error" all samples must be finite'
NAN = ("propagate", "error", "local")
_REAL = "?bBhHiIlLqQefd"  # NumPy's type codes; no long double
_COMPLEX = "FD"
_SINGLE = "?bBhHefF"  # types that float32 holds exactly
_KNOWN = "bool, integers, float16, float32, float64, complex64 or complex128"


@dataclass(frozen=True, slots=True)
class Spline:
    """How an array is interpolated: the options that all functions share. It can be pickled, for tasks of dask.

    `cval` is complex for complex arrays only; `device` is as `as_device` takes it, `nan` as `affine_transform` does. Where `labels`
    is set, the label whose unprefiltered spline is largest is taken.
    """

    order: int
    mode: str
    cval: float | complex
    prefilter: bool
    precision: Precision
    device: AnyDevice = None
    progress: Progress = None
    nan: Nan = "propagate"
    labels: bool = False

    @property
    def local(self) -> bool:
        """Whether exactly those results are NaN in which a missing sample has weight."""
        return self.nan == "local"

    @property
    def boundary(self) -> Boundary:
        """The boundary rule, with its default value outside."""
        return as_boundary(BOUNDARIES[self.mode])

    @property
    def boundary_with_cval(self) -> Boundary:
        """The boundary rule for real samples, with `cval` outside."""
        rule, value = self.boundary, float(self.cval.real)
        return rule if value == rule.cval else replace(rule, cval=value)

    @property
    def interpolates(self) -> bool:
        """Whether the spline passes through the samples."""
        return self.prefilter or self.order < 2

    @property
    def identity(self) -> list[object]:
        """What distinguishes it from others, for keys of tasks."""
        return [self.order, self.mode, repr(self.cval), self.prefilter, self.precision, repr(self.device), self.nan, self.labels]

    def of_part(self, part: str, number: int) -> Spline:
        """For the real or the imaginary part of complex samples; each is half of the work."""
        return replace(self.stage(number, 2), cval=getattr(self.cval, part))

    def stage(self, number: int, count: int) -> Spline:
        """For one of `count` passes, which reports its share of the progress."""
        return replace(self, progress=part_of(self.progress, number / count, (number + 1) / count))


def as_array(value: ArrayLike) -> Array:
    """The input as an array of numbers; an array is not copied."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise DataError(
            "input must have no masked samples; got a masked array: fill it, or put NaN there and choose what nan= does"
        )
    array = arrays.as_array(value, "input", DataError, "an array of numbers")
    if array.dtype.char not in _REAL and array.dtype.char not in _COMPLEX:
        raise DtypeError(f"input must be an array of {_KNOWN}; got {array.dtype}")
    return array


def as_order(order: object, minimum: int = 0) -> int:
    """The order of the spline."""
    try:
        number = operator.index(order)  # type: ignore[arg-type]  # that is the question
    except TypeError:
        raise OptionTypeError(f"order must be a whole number from {minimum} to 5; got {order!r}") from None
    if not minimum <= number <= 5:
        raise RefusedError(f"order must be a whole number from {minimum} to 5; got {number}")
    return number


def require_of_labels(dtype: np.dtype[Any], precision: object, nan: object) -> None:
    """Refuse what order "labels" has no use for."""
    if dtype.kind == "c":
        raise UnsupportedError(f'order "labels" takes whole numbers; got {dtype}')
    if precision is not None or nan != "propagate":
        raise OptionError(f'precision and nan are for values: leave them out with order "labels"; got {precision!r} and {nan!r}')


def as_mode(mode: object) -> str:
    """The name of a mode, the same for all axes as in SciPy."""
    if not isinstance(mode, str) or mode not in MODES:
        raise RefusedError(str(one_of("mode", mode, MODES)))
    return mode


def as_precision(precision: object, dtype: np.dtype[Any]) -> Precision:
    """The precision of the computation; by default single where float32 holds the samples exactly."""
    if precision is None:
        return "single" if dtype.char in _SINGLE else "double"
    if precision not in get_args(Precision):
        raise one_of("precision", precision, ("single", "double", "None"))
    chosen: Precision = precision  # type: ignore[assignment]  # it is one of them
    return chosen


def require_finite(data: Array, nan: Nan) -> None:
    """With ``nan="error"``, refuse samples that are NaN or infinite."""
    if nan == "error" and data.dtype.kind in "fc" and not (known := np.isfinite(data)).all():
        where = tuple(map(int, np.unravel_index(np.argmin(known), data.shape)))
        raise DataError(f"{FINITE}; got {data[where]} at {where}")


def as_shape(shape: Iterable[Any]) -> tuple[int, ...]:
    """The shape of a result."""
    try:
        result = tuple(map(operator.index, shape))
    except TypeError:
        raise OptionTypeError(f"output_shape must be whole numbers, one for each axis; got {shape!r}") from None
    if any(n < 0 for n in result):
        raise OptionError(f"output_shape must be whole numbers of at least 0; got {result}")
    return result


def as_axis(axis: object, ndim: int) -> int:
    """An axis of an array, counted from the front."""
    try:
        number = operator.index(axis)  # type: ignore[arg-type]  # that is the question
    except TypeError:
        raise OptionTypeError(f"axis must be a whole number; got {axis!r}") from None
    if not -ndim <= number < ndim:
        raise AxisError(f"axis must be one of the array's {ndim}, from {-ndim} to {ndim - 1}; got {number}")
    return number % ndim


def as_axes(axes: object, ndim: int) -> list[int]:
    """Distinct axes of an array, in the order given; None means all."""
    if axes is None:
        return list(range(ndim))
    found = [as_axis(axis, ndim) for axis in (axes if np.iterable(axes) else [axes])]
    if len(set(found)) != len(found):
        raise OptionError(f"axes must be different axes; got {axes!r}")
    return found


def finite(what: str, value: object) -> float:
    """A finite real number."""
    if isinstance(value, float) and math.isfinite(value):
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if not isinstance(value, (Real, np.bool_)) or isinstance(value, np.timedelta64):
        raise OptionTypeError(f"{what} must be a real number, or one for each axis; got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise NotFiniteError(f"{what} must be finite; got {value!r}")
    return number


def per_axis(what: str, value: object, ndim: int) -> list[Any]:
    """One finite number for each axis, of the type given, or the same number for all."""
    if isinstance(value, float):
        return [finite(what, value)] * ndim
    alone = isinstance(value, (str, bytes)) or not np.iterable(value)
    values: list[Any] = [value] * ndim if alone else list(value)  # type: ignore[call-overload]  # it can be iterated
    if len(values) != ndim:
        raise RefusedError(f"{what} must be a number, or one for each of the {ndim} axes of input; got {len(values)}")
    for one in values:
        finite(what, one)
    return values


def as_matrix(matrix: ArrayLike) -> NDArray[np.float64]:
    """The matrix of an affine transformation, of one or two axes."""
    try:
        given = np.asarray(matrix)
        if given.dtype.kind == "c":
            raise OptionTypeError(f"matrix must be real numbers; got {given.dtype}")
        array = given.astype(np.float64)
    except OverflowError as error:
        raise NotFiniteError(f"matrix must be finite; got {matrix!r}") from error
    except (TypeError, ValueError) as error:
        if isinstance(error, OptionError):
            raise
        raise OptionTypeError(f"matrix must be real numbers; got {matrix!r}") from error
    if array.ndim not in (1, 2) or array.shape[0] < 1:
        raise RefusedError(f"matrix must have one or two axes, and not be empty; got shape {array.shape}")
    if not (math.isfinite(np.vdot(array, array)) or np.isfinite(array).all()):
        raise NotFiniteError(f"matrix must be finite; got {array.tolist()}")
    return array


def as_coordinates(coordinates: ArrayLike, count: int) -> Array:
    """Positions along `count` axes, of any real dtype; an array is not copied."""
    array = arrays.as_array(coordinates, "coordinates", OptionError, "an array of real numbers")
    if array.dtype.kind == "c":
        raise OptionTypeError(f"coordinates must be real numbers; got {array.dtype}")
    if array.dtype.char not in _REAL:
        raise RefusedError(f"coordinates must be bool, integers, float16, float32 or float64; got {array.dtype}")
    require_coordinates(array.shape, count)
    return array


def require_coordinates(shape: Sequence[int], count: int) -> None:
    """Refuse coordinates of a shape that does not fit `count` axes."""
    if len(shape) < 2:
        raise RefusedError(f"coordinates must have an axis for the input's axes and at least one more; got shape {shape}")
    if shape[0] != count:
        raise RefusedError(f"coordinates must be given for {count} axes, along their first; got shape {shape}")


def as_output(output: Any, dtype: np.dtype[Any], shape: Sequence[int], *, copied: bool = False) -> Array:
    """The array that results of a shape are written into, for an input of a dtype: a new one, or `output`.

    Real samples that are copied unchanged may have complex results.
    """
    shape = tuple(shape)
    if output is None or isinstance(output, (type, np.dtype, str)):
        return _empty(shape, as_dtype(output, dtype, copied=copied))
    try:
        array = arrays.memory_of(output, "output")
    except ValueError as error:
        raise OptionTypeError(f"output must be an array or a dtype; got {error}") from error
    if array.shape != shape:
        raise RefusedError(f"output must have the shape of the result, {shape}; got {array.shape}")
    _require_kind(array.dtype, dtype, copied)
    if not array.flags.writeable:
        raise OptionError("output must be an array that can be written to; got one that is read-only")
    return array


def as_dtype(output: Any, given: np.dtype[Any], *, copied: bool = False) -> np.dtype[Any]:
    """The dtype of the result for an input of dtype `given`, which is the default."""
    if output is None:
        return given.newbyteorder("=")
    try:
        dtype: np.dtype[Any] = np.dtype(output)
    except TypeError:
        raise OptionTypeError(f"output must be an array or a dtype; got {output!r}") from None
    if isinstance(output, str):
        if given.kind != "c" and dtype.kind not in "iufc":
            raise RefusedError(f"output must be a numeric dtype where it is a string; got {output!r}")
    elif given.kind == "c" and dtype.char in _REAL:
        warn("promoting specified output dtype to complex")
        dtype = np.promote_types(dtype, np.complex64)
    _require_kind(dtype, given, copied)
    return dtype


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn about the line outside clvol that made the call."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("clvol."):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def _require_kind(dtype: np.dtype[Any], given: np.dtype[Any], copied: bool) -> None:
    if given.kind == "c":
        if dtype.char not in _COMPLEX:
            raise RefusedError(f"output must be complex64 or complex128 for complex input; got {dtype}")
    elif dtype.char not in _REAL and not (copied and dtype.char in _COMPLEX):
        raise RefusedError(f"output must be bool, integers, float16, float32 or float64 for real input; got {dtype}")


def require_addressable(shape: Sequence[int], itemsize: int = 1) -> None:
    """Refuse a result of more bytes than an index can count."""
    if math.prod(shape) * itemsize > sys.maxsize:
        raise OutOfMemoryError(f"out of memory: the result must have a size that can be addressed; got shape {shape}")


def _empty(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    require_addressable(shape, dtype.itemsize)
    what = f"a result of {' × '.join(map(str, shape))} samples of {dtype}"
    with enough_memory(what):
        return memory.empty(shape, dtype, what)


def as_cval(cval: Any, complex_: bool) -> float | complex:
    """The value outside, complex only for complex samples; it may be NaN or infinite."""
    if isinstance(cval, np.ndarray) and cval.ndim == 0:
        cval = cval[()]
    refused = isinstance(cval, (str, bytes, np.ndarray)) or (isinstance(cval, np.complexfloating) and not complex_)
    try:
        if not refused:
            return complex(cval) if complex_ else float(cval)
    except OverflowError:
        raise NotFiniteError(f"cval must be a number that float64 can hold; got {cval!r}") from None
    except TypeError:
        pass
    allowed = "a number" if complex_ else "a real number, as the input is"
    raise OptionTypeError(f"cval must be {allowed}; got {cval!r}")
