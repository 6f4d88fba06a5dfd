"""The arguments of the functions of `clvol.ndimage`, checked and in one form; refused with the exceptions that SciPy raises."""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import arrays, memory
from clvol.base.checks import enough_memory, one_of
from clvol.base.errors import AxisError, DataError, DtypeError, NotFiniteError, OptionError, OptionTypeError, RefusedError
from clvol.device import Device, as_device
from clvol.spline.field import Precision

__all__ = [
    "MODES",
    "AnyDevice",
    "Array",
    "Nan",
    "Progress",
    "Spline",
    "as_array",
    "as_axes",
    "as_axis",
    "as_coordinates",
    "as_cval",
    "as_matrix",
    "as_mode",
    "as_order",
    "as_output",
    "as_precision",
    "as_shape",
    "finite",
    "look_for_nan",
    "per_axis",
]

Array: TypeAlias = NDArray[Any]
AnyDevice: TypeAlias = Device | str | int | None
Progress: TypeAlias = Callable[[float], None] | None
Nan: TypeAlias = str

MODES = ("mirror", "reflect", "grid-mirror", "wrap", "grid-wrap", "nearest", "constant", "grid-constant")
_NAN = ("propagate", "error", "local")
_REAL = "?bBhHiIlLqQefd"  # NumPy's letters of the types that are computed with; no long double
_COMPLEX = "FD"
_SINGLE = "?bBhHefF"  # what float32 holds
_KNOWN = "bool, integers, float16, float32, float64, complex64 or complex128"


@dataclass(frozen=True, slots=True)
class Spline:
    """How an array is interpolated: the options that all functions share.

    Attributes
    ----------
    order : int
    mode : str
    cval : float or complex
        Complex for complex arrays alone.
    prefilter : bool
    precision : {"single", "double"}
    device : Device or None
    progress : callable or None
    local : bool
        Whether results that a missing sample has weight in, and no others, are missing.
    """

    order: int
    mode: str
    cval: float | complex
    prefilter: bool
    precision: Precision
    device: Device | None
    progress: Progress
    local: bool = False

    @classmethod
    def of(
        cls,
        data: Array,
        order: int,
        mode: str,
        cval: complex,
        prefilter: bool,
        precision: Precision | None,
        device: AnyDevice,
        nan: Nan,
        progress: Progress,
    ) -> Spline:
        """The options for an array, checked; `nan` is dealt with here."""
        spline = cls(
            as_order(order),
            as_mode(mode),
            as_cval(cval, data.dtype.kind == "c"),
            bool(prefilter),
            as_precision(precision, data.dtype),
            None if device is None else as_device(device),
            progress,
            local=nan == "local",
        )
        look_for_nan(data, nan)
        return spline

    @property
    def interpolates(self) -> bool:
        """Whether the spline has the array's own values at whole positions."""
        return self.prefilter or self.order < 2

    def of_part(self, part: str, number: int) -> Spline:
        """For the real or the imaginary part of complex samples, the first and second half of the work."""
        return replace(self.stage(number, 2), cval=getattr(self.cval, part))

    def stage(self, number: int, count: int) -> Spline:
        """For one of several passes over the data, which reports its share of the work."""
        whole = self.progress
        return self if whole is None else replace(self, progress=lambda done: whole((number + done) / count))


def as_array(value: ArrayLike) -> Array:
    """The input as an array of numbers, not copied where it is one."""
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


def as_mode(mode: object) -> str:
    """The name of the rule beyond the edge, one for all axes, as SciPy takes one."""
    if not isinstance(mode, str) or mode not in MODES:
        raise RefusedError(str(one_of("mode", mode, MODES)))
    return mode


def as_precision(precision: object, dtype: np.dtype[Any]) -> Precision:
    """What is computed in: float32 where the samples are of no more than 16 bits or float32, else float64."""
    if precision is None:
        return "single" if dtype.char in _SINGLE else "double"
    if precision not in get_args(Precision):
        raise one_of("precision", precision, ("single", "double", "None"))
    chosen: Precision = precision  # type: ignore[assignment]  # it is one of them
    return chosen


def look_for_nan(data: Array, nan: Nan) -> None:
    """What is done about missing samples before anything is computed."""
    if nan not in _NAN:
        raise one_of("nan", nan, _NAN)
    if nan == "error" and data.dtype.kind in "fc" and not (known := np.isfinite(data)).all():
        where = tuple(map(int, np.unravel_index(np.argmin(known), data.shape)))
        raise DataError(f'with nan="error" all samples must be finite; got {data[where]} at {where}')


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
    """Several axes of an array, each once, in the order they are given; None are all."""
    if axes is None:
        return list(range(ndim))
    found = [as_axis(axis, ndim) for axis in (axes if np.iterable(axes) else [axes])]
    if len(set(found)) != len(found):
        raise OptionError(f"axes must be different axes; got {axes!r}")
    return found


def finite(what: str, value: object) -> float:
    """A finite real number."""
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
    """One finite number for each axis, as it was given, or the same for all."""
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
    if not np.isfinite(array).all():
        raise NotFiniteError(f"matrix must be finite; got {array.tolist()}")
    return array


def as_coordinates(coordinates: ArrayLike, count: int) -> Array:
    """Positions along so many axes, of any type of real numbers; not copied where they are an array."""
    array = arrays.as_array(coordinates, "coordinates", OptionError, "an array of real numbers")
    if array.dtype.kind == "c":
        raise OptionTypeError(f"coordinates must be real numbers; got {array.dtype}")
    if array.dtype.char not in _REAL:
        raise RefusedError(f"coordinates must be bool, integers, float16, float32 or float64; got {array.dtype}")
    if array.ndim < 2:
        raise RefusedError(f"coordinates must have an axis for the input's axes and at least one more; got shape {array.shape}")
    if array.shape[0] != count:
        raise RefusedError(f"coordinates must be given for {count} axes, along their first; got shape {array.shape}")
    return array


def as_output(output: Any, data: Array, shape: Sequence[int], *, copied: bool = False) -> Array:
    """Where the result is written: a new array, or the one that was given.

    Parameters
    ----------
    output : None, dtype, str or array
    data : ndarray
        The input, whose type the result has by default.
    shape : sequence of int
        Of the result.
    copied : bool
        Whether the samples will be copied as they are; then complex results of real samples are possible.
    """
    shape = tuple(shape)
    if output is None:
        return _empty(shape, data.dtype.newbyteorder("="))
    if isinstance(output, (type, np.dtype, str)):
        return _empty(shape, _as_dtype(output, data, copied))
    try:
        array = arrays.memory_of(output, "output")
    except ValueError as error:
        raise OptionTypeError(f"output must be an array or a dtype; got {error}") from error
    if array.shape != shape:
        raise RefusedError(f"output must have the shape of the result, {shape}; got {array.shape}")
    _require_kind(array.dtype, data, copied)
    if not array.flags.writeable:
        raise OptionError("output must be an array that can be written to; got one that is read-only")
    return array


def _as_dtype(output: Any, data: Array, copied: bool) -> np.dtype[Any]:
    try:
        dtype: np.dtype[Any] = np.dtype(output)
    except TypeError:
        raise OptionTypeError(f"output must be an array or a dtype; got {output!r}") from None
    if isinstance(output, str):
        if data.dtype.kind != "c" and dtype.kind not in "iufc":
            raise RefusedError(f"output must be a numeric dtype where it is a string; got {output!r}")
    elif data.dtype.kind == "c" and dtype.char in _REAL:
        warnings.warn("promoting specified output dtype to complex", stacklevel=5)
        dtype = np.promote_types(dtype, np.complex64)
    _require_kind(dtype, data, copied)
    return dtype


def _require_kind(dtype: np.dtype[Any], data: Array, copied: bool) -> None:
    if data.dtype.kind == "c":
        if dtype.char not in _COMPLEX:
            raise RefusedError(f"output must be complex64 or complex128 for complex input; got {dtype}")
    elif dtype.char not in _REAL and not (copied and dtype.char in _COMPLEX):
        raise RefusedError(f"output must be bool, integers, float16, float32 or float64 for real input; got {dtype}")


def _empty(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    if math.prod(shape) * dtype.itemsize > np.iinfo(np.intp).max:
        raise OptionError(f"the result must have a size that can be addressed; got shape {shape}")
    what = f"a result of {' × '.join(map(str, shape))} samples of {dtype}"
    with enough_memory(what):
        return memory.empty(shape, dtype, what)


def as_cval(cval: Any, complex_: bool) -> float | complex:
    """The value beyond the edge, complex for complex samples alone; it may be NaN or infinite."""
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
