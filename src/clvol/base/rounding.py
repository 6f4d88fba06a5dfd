"""Convert results to another type: integers are rounded and clipped, and never wrap around."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base.errors import DataError, OptionError

__all__ = ["as_kind", "below", "in_kind", "limits", "rounded", "wide"]

_AT_ONCE = 1 << 20  # values converted per pass, which bounds the float64 copies


def as_kind(dtype: DTypeLike, same: np.dtype[Any]) -> np.dtype[Any]:
    """The dtype of a name; "same" is `same` in native byte order. `OptionError` for a type without real numbers."""
    if isinstance(dtype, str) and dtype == "same":
        return same.newbyteorder("=")
    try:
        kind = np.dtype(dtype)
    except TypeError:
        kind = np.dtype(object)
    if kind.kind not in "biuf":
        raise OptionError(f"dtype must be 'same' or a boolean, integer or floating type; got {dtype!r}")
    return kind


def in_kind(values: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Convert values to a type. For an integer type, round to nearest, halves to even, and clip; `DataError` for NaN."""
    if values.dtype == kind:
        return values
    result = np.empty(values.shape, kind)
    flat, target = values.reshape(-1), result.reshape(-1)
    for first in range(0, flat.size, _AT_ONCE):
        part = flat[first : first + _AT_ONCE]
        if kind.kind == "f":
            largest = np.finfo(kind).max
            target[first : first + _AT_ONCE] = np.where(np.isfinite(part), np.clip(part, -largest, largest), part)
        elif np.isnan(part).any():
            raise DataError(f"results hold NaN, which {kind} does not: give fill=, or replace missing samples with Volume.filled()")
        else:
            target[first : first + _AT_ONCE] = rounded(part, kind)
    return result


def rounded(values: ArrayLike, kind: np.dtype[Any]) -> NDArray[Any]:
    """Round to the nearest integers that the type holds."""
    low, high = limits(kind)
    return np.clip(np.rint(np.asarray(values, np.float64)), low, below(high)).astype(kind)


def limits(kind: np.dtype[Any]) -> tuple[int, int]:
    """The smallest and the largest integer of a type."""
    return (0, 1) if kind.kind == "b" else (int(np.iinfo(kind).min), int(np.iinfo(kind).max))


def below(whole: int) -> float:
    """The largest float64 that does not exceed an integer."""
    return float(whole) if int(float(whole)) <= whole else float(np.nextafter(float(whole), -np.inf))


def wide(kind: np.dtype[Any]) -> bool:
    """Whether float32 cannot hold all values of a type."""
    return kind.itemsize > (4 if kind.kind == "f" else 2)
