"""Labels of a volume: which there are, how they are called, and the volume with some of them alone."""

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
    """The labels that a volume has, in ascending order, without the background."""
    background, numbers = label_numbers(volume)
    return np.asarray(numbers[numbers != background])


def name_of(volume: Volume, number: int) -> str:
    """What a volume calls a label; "" where it has no name for it."""
    return volume.labels.get(number, "") if isinstance(volume.labels, dict) else ""


def only(volume: Volume | ArrayLike, labels: Iterable[int]) -> Volume:
    """The volume with these labels alone: the others become background.

    The background is 0 where there is a 0, else the commonest label. Labels that the volume does not have change nothing.

    Raises
    ------
    OptionError
        The volume is no label map, or a label is no whole number.
    """
    return _parted(volume, labels, kept=True)


def without(volume: Volume | ArrayLike, labels: Iterable[int]) -> Volume:
    """The volume without these labels, which become background: see `only`."""
    return _parted(volume, labels, kept=False)


def among(numbers: NDArray[Any], values: NDArray[Any]) -> NDArray[np.bool_]:
    """Which values are some of the numbers, which ascend.

    Each value is looked up in them; `numpy.isin` sorts the values first, which takes many times as long where they are samples.
    """
    if not numbers.size:
        return np.zeros(values.shape, bool)
    at = np.searchsorted(numbers, values)
    np.minimum(at, numbers.size - 1, out=at)
    return np.asarray(numbers[at] == values)


def _parted(volume: Volume | ArrayLike, labels: Iterable[int], *, kept: bool) -> Volume:
    volume = as_volume(volume)
    if not volume.is_labels:
        raise OptionError(f"labels are chosen of a label map, which Volume(..., labels=True) says that it is; got {volume!r}")
    dtype = volume.data.dtype.newbyteorder("=")
    chosen = _chosen(labels, dtype)
    background = dtype.type(label_numbers(volume)[0])
    low, high = volume.limits
    # a table that is larger than the volume takes longer to make than to do without
    listed = int(high) + 1 if dtype.kind in "iu" and low >= 0 and high < volume.data.size else 0
    memory.require((volume.data.size + listed) * dtype.itemsize, f"labels of {volume.data.size} samples")
    made = np.empty(volume.shape, dtype)
    if listed:
        chosen = chosen[(chosen >= 0) & (chosen <= high)]
        table = np.full(listed, background, dtype) if kept else np.arange(listed).astype(dtype)
        table[chosen] = chosen if kept else background
        for part, target in zip(volume.data, made, strict=True):
            np.take(table, part, out=target, mode="clip")  # several times as fast as to look each sample up
    else:
        for part, target in zip(volume.data, made, strict=True):
            rounded = np.round(part) if dtype.kind == "f" else part  # as colours take them
            target[...] = np.where(among(chosen, rounded) == kept, part, background)
    # that samples are labels is told from how many different ones there are: with few of them left it could not be told any more
    return replace(volume, data=made, labels=True if volume.labels is None else volume.labels)


def _chosen(labels: Iterable[int], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The labels in ascending order, without those that samples of this kind cannot be."""
    try:
        given = list(labels)
    except TypeError:
        raise OptionError(f"labels must be whole numbers, several of them; got {labels!r}") from None
    numbers = sorted({whole("each label", label) for label in given})
    about: Any = np.finfo(dtype) if dtype.kind == "f" else None if dtype.kind == "b" else np.iinfo(dtype)
    low, high = (0, 1) if about is None else (int(about.min), int(about.max))
    within = [number for number in numbers if low <= number <= high]
    return np.array([number for number in within if int(dtype.type(number)) == number], dtype)
