"""Labels of a volume: list and name them, keep or remove some of them, and the table of their names, colours and opacities."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import as_path
from clvol.base.errors import OptionError
from clvol.volume.histogram import label_numbers, share
from clvol.volume.label_table import LabelRow, LabelTable, read_table
from clvol.volume.volume import Volume, as_volume, table_of

__all__ = ["LabelTable", "name_of", "numbers_of", "only", "table", "with_table", "without"]


def numbers_of(volume: Volume | ArrayLike) -> NDArray[np.float64]:
    """The labels in a volume, in ascending order, without the background."""
    background, numbers = label_numbers(volume)
    return np.asarray(numbers[numbers != background])


def name_of(volume: Volume, number: int) -> str:
    """The name of a label in a volume; "" if it has none."""
    return table_of(volume).get(number, "")


def table(source: str | os.PathLike[str] | Mapping[int, LabelRow]) -> LabelTable:
    """The table of labels in a text file of FreeSurfer, 3D Slicer or ITK-SNAP, or of rows.

    Parameters
    ----------
    source : path-like or mapping
        A file, of which the rows say what it is: a color table of FreeSurfer (``FreeSurferColorLUT.txt``, rows of ``number
        name R G B T``, T the transparency) or 3D Slicer (``.ctbl``, ``number name R G B A``, A the opacity; they begin with
        ``# Color table file``, or have 255 there for half of the labels), or label descriptions of ITK-SNAP (``number R G B A
        VIS MSH "name"``; what is not visible has the opacity 0). Or rows, as of `LabelTable`.

    Returns
    -------
    LabelTable
        For ``labels=`` of `Volume`, `clvol.read` and `clvol.open`, and for `with_table`.

    Raises
    ------
    FormatError
        The file is missing or no such text; the message names the line.
    OptionError
        A row is none of a `LabelTable`.

    Examples
    --------
    >>> import clvol
    >>> table = clvol.labels.table("organs.ctbl")
    >>> volume = clvol.read("organs.nii.gz", labels=table)
    """
    if isinstance(source, Mapping):
        return source if isinstance(source, LabelTable) else LabelTable(source)
    return read_table(as_path(source))


def with_table(volume: Volume | ArrayLike, table: LabelTable | Mapping[int, LabelRow]) -> Volume:
    """A label map with the rows of a table; what they leave open, and labels without a row, are as in its own.

    The samples are shared, and what is known of them is not computed again.

    Raises
    ------
    OptionError
        A row is none of a `LabelTable`.

    Examples
    --------
    >>> import numpy as np, clvol
    >>> volume = clvol.Volume(np.ones((4, 4, 4), np.uint8), labels={1: "liver"})
    >>> red = clvol.labels.with_table(volume, {1: (None, "red", 0.5)})
    >>> clvol.labels.name_of(red, 1), red.labels.colors[1]
    ('liver', (1.0, 0.0, 0.0))
    """
    volume = as_volume(volume)
    made = copy.copy(volume)
    vars(made).pop("is_labels", None)
    object.__setattr__(made, "labels", LabelTable(table).over(table_of(volume)))
    share(volume, made)
    return made


def only(volume: Volume | ArrayLike, labels: Iterable[int | str]) -> Volume:
    """Keep only these labels, given by numbers or names; the others become background.

    The background is 0 if it occurs, else the most frequent label. Numbers and names of the table that do not occur are ignored.

    Raises
    ------
    OptionError
        The volume is not a label map, or a label is neither an integer nor a name that one label of its table has.

    Examples
    --------
    >>> import numpy as np, clvol
    >>> volume = clvol.Volume(np.array([[[0, 1, 2]]]), labels={1: "liver", 2: "spleen"})
    >>> clvol.labels.only(volume, ["spleen"]).data.tolist()
    [[[0, 0, 2]]]
    """
    return _parted(volume, labels, kept=True)


def without(volume: Volume | ArrayLike, labels: Iterable[int | str]) -> Volume:
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


def _parted(volume: Volume | ArrayLike, labels: Iterable[int | str], *, kept: bool) -> Volume:
    volume = as_volume(volume)
    if not volume.is_labels:
        raise OptionError(f"the volume must be a label map; set Volume(..., labels=True) if it is one; got {volume!r}")
    dtype = volume.data.dtype.newbyteorder("=")
    chosen = _chosen(labels, table_of(volume), dtype)
    background = dtype.type(label_numbers(volume)[0])
    low, high = volume.limits
    # a lookup table larger than the volume does not pay
    listed = int(high) + 1 if dtype.kind in "iu" and low >= 0 and high < volume.data.size else 0
    memory.require((volume.data.size + listed) * dtype.itemsize, f"labels of {volume.data.size} samples")
    result = np.empty(volume.shape, dtype)
    if listed:
        chosen = chosen[(chosen >= 0) & (chosen <= high)]
        numbers = np.full(listed, background, dtype) if kept else np.arange(listed).astype(dtype)
        numbers[chosen] = chosen if kept else background
        for part, target in zip(volume.data, result, strict=True):
            np.take(numbers, part, out=target, mode="clip")  # several times faster than a search per sample
    else:
        for part, target in zip(volume.data, result, strict=True):
            rounded = np.round(part) if dtype.kind == "f" else part  # as for colours
            target[...] = np.where(among(chosen, rounded) == kept, part, background)
    # set `labels`, because detection needs several distinct values, and few may remain
    return replace(volume, data=result, labels=True if volume.labels is None else volume.labels)


def _chosen(labels: Iterable[int | str], table: LabelTable, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The labels in ascending order, without those that the dtype cannot hold."""
    try:
        given = [labels] if isinstance(labels, str) else list(labels)
    except TypeError:
        raise OptionError(f"labels must be a sequence of whole numbers and names; got {labels!r}") from None
    numbers = sorted({table.number_of(label) for label in given})
    about: Any = np.finfo(dtype) if dtype.kind == "f" else None if dtype.kind == "b" else np.iinfo(dtype)
    low, high = (0, 1) if about is None else (int(about.min), int(about.max))
    within = [number for number in numbers if low <= number <= high]
    return np.array([number for number in within if int(dtype.type(number)) == number], dtype)
