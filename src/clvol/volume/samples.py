"""What is asked of the array of a volume's samples: their extremes, those that are missing, regions, and copies for libraries."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import DataError, OptionError
from clvol.base.progress import watched
from clvol.noise import MOST_LABELS

__all__ = [
    "array_of",
    "beyond_float32",
    "filled_with",
    "fills_regions",
    "has_many_labels",
    "indicator_of",
    "lent",
    "limits_of",
    "range_of",
    "require_finite",
]

_CACHED = 1 << 18  # samples of a part that fits into the CPU cache
_PREVIEW = 1 << 16  # samples that suffice to see that most data are not labels
_SAME = 0.8  # smallest fraction of equal neighbours in labels


def array_of(data: NDArray[Any], dtype: Any, copy: bool | None) -> NDArray[Any]:
    """Implementation of ``__array__(dtype, copy)`` for these samples, in NumPy 1 and 2."""
    same = dtype is None or np.dtype(dtype) == data.dtype
    if copy is False and not same:
        raise ValueError(f"{data.dtype} cannot become an array of {np.dtype(dtype)} without a copy")
    return data if same and not copy else np.array(data, dtype)


def lent(data: NDArray[Any], requested: Mapping[str, Any]) -> Any:
    """Implementation of ``__dlpack__`` for read-only samples: a copy where they cannot be shared."""
    options = {name: value for name, value in requested.items() if value is not None}
    try:
        return data.__dlpack__(**options)
    except (BufferError, TypeError) as error:  # TypeError: NumPy 1 lacks the newer options
        if options.get("copy") is False:
            raise BufferError(f"samples of a volume are read-only and cannot be shared here without a copy: {error}") from None
    options = {name: options[name] for name in ("stream",) if name in options}
    return data.astype(data.dtype.newbyteorder("=")).__dlpack__(**options)


def limits_of(data: NDArray[Any]) -> tuple[Any, Any]:
    """Smallest and largest sample; NaN if a sample is NaN."""
    once = data[tuple(slice(None) if stride else slice(1) for stride in data.strides)]  # what is repeated
    report, read, ends = watched("finding the range of the samples"), 0, []
    for part in _parts(once):
        ends.append((part.min(), part.max()))  # both in one pass, while the part is in the CPU cache
        read += part.size
        report(read / once.size)
    return np.min([low for low, _ in ends]), np.max([high for _, high in ends])


def range_of(data: NDArray[Any], limits: tuple[Any, Any]) -> tuple[float, float]:
    """Smallest and largest finite sample; `DataError` if none is finite."""
    low, high = (float(v) for v in limits)
    if math.isfinite(low) and math.isfinite(high):
        return low, high
    ends: list[float] = []
    for part in _parts(data):
        low, high = float(part.min()), float(part.max())  # far faster than selecting finite samples, which few parts need
        if math.isfinite(low) and math.isfinite(high):
            ends += [low, high]
            continue
        with np.errstate(over="ignore"):  # longdouble has a larger range than float64
            finite = part[np.isfinite(part.astype(np.float64, copy=False))]
        if finite.size:
            ends += [float(finite.min()), float(finite.max())]
    if not ends:
        raise DataError("no sample of the volume is finite")
    return min(ends), max(ends)


def require_finite(data: NDArray[Any], limits: tuple[Any, Any]) -> None:
    """Raise `DataError` if a floating sample is NaN, infinite, or too large for float64."""
    low, high = limits
    if np.isfinite(low) and np.isfinite(high):
        with np.errstate(over="ignore"):  # longdouble has a larger range
            held = np.isfinite([float(low), float(high)]).all()
        if not held:
            raise DataError(f"samples must be within ±1.8e308, the range of float64; got {low!s} to {high!s}")
        return
    missing, infinite, first = 0, 0, None
    for place in _places(data.shape):
        bad = ~np.isfinite(data[place])
        if bad.any():
            at = np.unravel_index(int(np.argmax(bad)), bad.shape)
            first = first or [int(i) + along.start for i, along in zip(at, place, strict=True)]
            nan = int(np.isnan(data[place]).sum())
            missing, infinite = missing + nan, infinite + int(bad.sum()) - nan
    raise DataError(
        f"samples must be finite; got {missing} NaN and {infinite} infinite, the first at index {first}: "
        "replace them with Volume.filled(value)"
    )


def filled_with(data: NDArray[Any], value: float) -> NDArray[Any]:
    """A copy of floating samples with NaN and infinite ones replaced by a value."""
    memory.require(data.nbytes + data.size, f"a copy of {data.size} samples")
    with np.errstate(over="ignore"):
        stored = data.dtype.type(float(value))
    if not np.isfinite(stored):
        raise OptionError(f"value must be within the range of {data.dtype}, ±{np.finfo(data.dtype).max!s}; got {value!r}")
    return np.where(np.isfinite(data), data, stored)


def indicator_of(data: NDArray[Any], labels: Sequence[float]) -> NDArray[np.float32]:
    """1 where a sample is one of the labels, else 0."""
    inside = np.empty(data.shape, np.float32)
    for place in _places(data.shape):
        inside[place] = np.isin(data[place], labels)
    return inside


def beyond_float32(data: NDArray[Any], limits: tuple[Any, Any]) -> bool:
    """Whether there are integers that float32 cannot hold."""
    return data.dtype.itemsize > 2 and max(abs(int(v)) for v in limits) > 1 << 24


def fills_regions(data: NDArray[Any]) -> bool:
    """Whether integers may be labels: most of some neighbours are equal."""
    if data.dtype.kind not in "iu" or data.size == 0:
        return False
    some = data[len(data) // 2].ravel()[:_PREVIEW]  # contiguous samples
    return bool(some.size <= 1 or (some[1:] == some[:-1]).mean() >= _SAME)


def has_many_labels(data: NDArray[Any]) -> bool:
    """Whether there are more values than `clvol.noise` accepts as labels, but they fill regions with arbitrary neighbours."""
    shape = data.shape[:-1]
    chosen = np.unravel_index(np.arange(0, math.prod(shape), max(1, data.size >> 20)), shape)
    lines = data[chosen]  # reshape would copy an array that is not in C order
    values, counts = np.unique(lines, return_counts=True)
    if len(values) <= MOST_LABELS:
        return False
    left, right = lines[:, :-1], lines[:, 1:]
    within = (left != (background := values[counts.argmax()])) & (right != background)
    left, right = left[within], right[within]
    if left.size < MOST_LABELS:
        return False
    differ = left != right
    steps = np.abs(left[differ].astype(np.float64) - right[differ])
    return bool(differ.mean() < 1 - _SAME and (not steps.size or np.median(steps) > 1))


def _places(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Slices of the parts of an array that fit into the CPU cache."""
    row = math.prod(shape[1:])
    if len(shape) > 1 and row > _CACHED:
        for i in range(shape[0]):
            yield from ((slice(i, i + 1), *rest) for rest in _places(shape[1:]))
        return
    step = max(1, _CACHED // row)
    for first in range(0, shape[0], step):
        yield (slice(first, first + step), *(slice(0, n) for n in shape[1:]))


def _parts(data: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Parts of an array, in order, that fit into the CPU cache."""
    return (data[place] for place in _places(data.shape))
