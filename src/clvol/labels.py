"""Labels of a volume: list and name them, keep or remove some of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.volume.histogram import label_numbers
from clvol.volume.volume import Volume, as_volume

__all__ = ["name_of", "numbers_of", "only", "without"]


def numbers_of(volume: Volume | ArrayLike) -> NDArray[np.float64]:
    """The labels in a volume, in ascending order, without the background."""
    background, numbers = label_numbers(volume)
    return np.asarray(numbers[numbers != background])


def name_of(volume: Volume, number: int) -> str:
    """The name of a label in a volume; "" if it has none."""
    return volume.labels.get(number, "") if isinstance(volume.labels, dict) else ""


def only(volume: Volume | ArrayLike, labels: Iterable[int]) -> Volume:
    """Keep only these labels; the others become background.

    The background is 0 if it occurs, else the most frequent label. Labels that do not occur are ignored.

    Raises
    ------
    OptionError
        The volume is not a label map, or a label is not an integer.
    """
    return _parted(volume, labels, kept=True)


def without(volume: Volume | ArrayLike, labels: Iterable[int]) -> Volume:
    """Remove these labels, which become background: see `only`."""
    return _parted(volume, labels, kept=False)


def among(numbers: NDArray[Any], values: NDArray[Any]) -> NDArray[np.bool_]:
    """Which values are in `numbers`, which must ascend.

    Searches `numbers` for each value; `numpy.isin` sorts the values first, which is many times slower for samples.
    """
    if not numbers.size:
        return np.zeros(values.shape, bool)
    at = np.searchsorted(numbers, values)
    np.minimum(at, numbers.size - 1, out=at)
    return np.asarray(numbers[at] == values)


def _parted(volume: Volume | ArrayLike, labels: Iterable[int], *, kept: bool) -> Volume:
    volume = as_volume(volume)
    if not volume.is_labels:
        raise OptionError(f"the volume must be a label map; set Volume(..., labels=True) if it is one; got {volume!r}")
    dtype = volume.data.dtype.newbyteorder("=")
    chosen = _chosen(labels, dtype)
    background = dtype.type(label_numbers(volume)[0])
    low, high = volume.limits
    # a lookup table larger than the volume does not pay
    listed = int(high) + 1 if dtype.kind in "iu" and low >= 0 and high < volume.data.size else 0
    memory.require((volume.data.size + listed) * dtype.itemsize, f"labels of {volume.data.size} samples")
    result = np.empty(volume.shape, dtype)
    if listed:
        chosen = chosen[(chosen >= 0) & (chosen <= high)]
        table = np.full(listed, background, dtype) if kept else np.arange(listed).astype(dtype)
        table[chosen] = chosen if kept else background
        for part, target in zip(volume.data, result, strict=True):
            np.take(table, part, out=target, mode="clip")  # several times faster than a search per sample
    else:
        for part, target in zip(volume.data, result, strict=True):
            rounded = np.round(part) if dtype.kind == "f" else part  # as for colours
            target[...] = np.where(among(chosen, rounded) == kept, part, background)
    # set `labels`, because detection needs several distinct values, and few may remain
    return replace(volume, data=result, labels=True if volume.labels is None else volume.labels)


def _chosen(labels: Iterable[int], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The labels in ascending order, without those that the dtype cannot hold."""
    try:
        given = list(labels)
    except TypeError:
        raise OptionError(f"labels must be a sequence of whole numbers; got {labels!r}") from None
    numbers = sorted({whole("each label", label) for label in given})
    about: Any = np.finfo(dtype) if dtype.kind == "f" else None if dtype.kind == "b" else np.iinfo(dtype)
    low, high = (0, 1) if about is None else (int(about.min), int(about.max))
    within = [number for number in numbers if low <= number <= high]
    return np.array([number for number in within if int(dtype.type(number)) == number], dtype)
