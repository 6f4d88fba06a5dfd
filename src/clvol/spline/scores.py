"""Scores of classes, such as a network's logits, on another grid, where the largest names the label."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array
from clvol.base.checks import require_known, suggests_options
from clvol.base.errors import DataError, OptionError
from clvol.base.progress import Progress, part_of
from clvol.filter.table import DEFAULT_FILTER
from clvol.interop.dispatch import is_in_parts, is_lazy
from clvol.spline.field import resample
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

__all__ = ["resample_scores"]

_OPTIONS = ("spacing", "like", "filter", "boundary", "anchor", "transform", "anti_aliasing", "fill", "device", "precision")
_MOST = 1 << 16  # classes


@suggests_options
def resample_scores(
    scores: ArrayLike | Volumes | Sequence[Volume],
    shape: Sequence[int] | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Volume:
    """The label whose score is largest at each point of another grid, from scores of each class: a network's logits.

    The scores are resampled class by class and compared as they come, so memory holds the largest ones and those of one class on
    the new grid, not those of all; an array that is mapped from a file is read class by class, too. Boundaries are smooth, as they
    lie where continuous functions are equal.

    Parameters
    ----------
    scores : array-like, shape (C, nz, ny, nx) or (C, ny, nx), Volumes, or sequence of Volume
        Of C classes, at most 65,536; the largest wins. Torch's tensors on the CPU are taken as they are.
    shape
        As in `clvol.resample`, as are the options `spacing` or `like` instead.
    progress : callable, optional
        Called with the fraction done.
    **options
        `filter` (by default "bspline3"), `boundary`, `anchor`, `transform`, `anti_aliasing`, `device` and `precision` of
        `clvol.resample`; and `fill`: the label outside the domain is then 0.

    Returns
    -------
    Volume of uint8, or of uint16 for more than 256 classes
        Places in `scores`; equal scores give the smaller one.

    Raises
    ------
    DataError
        `scores` have another number of axes, no class, or a value that is not finite.
    OptionError
        An unknown option, or as `clvol.resample` raises it.
    GeometryError, DeviceError, OutOfMemoryError
        As `clvol.resample` raises them.

    Examples
    --------
    >>> labels = clvol.resample_scores(logits, like=scan)   # (C, z, y, x) of any spacing, on the grid of the scan
    """
    require_known("resample_scores", options, _OPTIONS)
    classes = _classes(scores)
    options["filter"] = options.get("filter") or DEFAULT_FILTER  # scores that are nearly labels are no labels
    labels: NDArray[Any] | None = None
    most: NDArray[Any] | None = None
    for number, volume in enumerate(classes):
        part = part_of(progress, number / len(classes), (number + 1) / len(classes))
        made = resample(volume, shape, progress=part, **options)
        where, space = (made.spacing, made.origin, made.direction, made.units), made.space
        if labels is None or most is None:
            most, kind = np.array(made.data), np.uint8 if len(classes) <= 256 else np.uint16
            labels = memory.empty(made.shape, kind, f"labels of {made.data.size} points")
            labels[...] = 0
        else:
            _compare(made.data, number, most, labels)
        del made  # before the next class needs as much memory
    assert labels is not None
    return Volume(labels, *where, labels=True, space=space)


def _compare(scores: NDArray[Any], number: int, most: NDArray[Any], labels: NDArray[Any]) -> None:
    """Put scores into the largest ones, and the class's number into labels, where they exceed these."""
    for values, highest, label in zip(scores, most, labels, strict=True):  # by slices, since each needs a mask
        higher = values > highest
        np.copyto(highest, values, where=higher, casting="same_kind")
        label[higher] = number


def _classes(scores: ArrayLike | Volumes | Sequence[Volume]) -> Sequence[Volume]:
    """The scores of each class, in the memory that they are in."""
    if is_in_parts(scores) or is_lazy(scores):
        raise OptionError(f"scores must be in memory; got {type(scores).__name__}")
    if isinstance(scores, Volumes) or (isinstance(scores, (list, tuple)) and any(isinstance(one, Volume) for one in scores)):
        classes: Sequence[Volume] = scores
    else:
        data = as_array(scores, "scores", DataError, "numbers of shape (C, nz, ny, nx) or (C, ny, nx)")
        if data.ndim not in (3, 4):
            raise DataError(f"scores must have shape (C, nz, ny, nx) or (C, ny, nx); got {data.shape}")
        classes = [Volume(one) for one in data]
    if not 1 <= len(classes) <= _MOST:
        raise DataError(f"there must be scores of 1 to {_MOST} classes; got {len(classes)}")
    return classes
