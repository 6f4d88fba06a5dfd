"""Labels of a volume: which there are, how they are called, and the volume with some of them alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import memory
from clvol.checks import whole
from clvol.errors import OptionError
from clvol.histogram import label_numbers
from clvol.volume import Volume, as_volume

__all__ = ["name_of", "numbers_of", "only", "without"]

_LISTED = 1 << 24  # numbers of which each is looked up in a table


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


def _parted(volume: Volume | ArrayLike, labels: Iterable[int], *, kept: bool) -> Volume:
    volume = as_volume(volume)
    if not volume.is_labels:
        raise OptionError(f"labels are chosen of a label map, which Volume(..., labels=True) says that it is; got {volume!r}")
    chosen = [whole("each label", label) for label in labels]
    background, _ = label_numbers(volume)
    memory.require(volume.data.nbytes, f"labels of {volume.data.size} samples")
    made = np.empty(volume.shape, volume.data.dtype.newbyteorder("="))

    def seen(values: NDArray[Any]) -> NDArray[Any]:
        rounded = np.round(values) if values.dtype.kind == "f" else values  # as colours take them
        return np.where(np.isin(rounded, chosen) == kept, values, made.dtype.type(background))

    whole_numbers = made.dtype.kind in "iu" and volume.limits[0] >= 0 and volume.limits[1] < _LISTED
    table = seen(np.arange(int(volume.limits[1]) + 1)).astype(made.dtype) if whole_numbers else None
    for part, target in zip(volume.data, made, strict=True):
        if table is None:
            target[...] = seen(part)
        else:
            np.take(table, part, out=target, mode="clip")  # three times as fast
    # of few labels it would no longer be seen that they are some
    return replace(volume, data=made, labels=True if volume.labels is None else volume.labels)
