"""nnU-Net's resampling of images, segmentations and logits, and logits straight to labels: `clvol.nnunet`, an extra."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.checks import flag, number, several, whole
from clvol.base.errors import ClvolError, DataError, MissingDependencyError, OptionError
from clvol.base.files import staged
from clvol.base.progress import Progress, part_of
from clvol.device import Device, as_device
from clvol.interfaces.resize import places, resize
from clvol.ndimage.arguments import Spline
from clvol.ndimage.engine import row_of
from clvol.spline.coefficients import Coefficients
from clvol.spline.resample import Largest

__all__ = ["install", "labels_from_logits", "resample_to_shape"]

ANISOTROPIC = 3.0
"""The ratio of spacings from which nnU-Net resamples the axis of low resolution separately."""
_PLANS_FILE = "clvol_resampling.py"
_PLANS_NAME = "clvol_resample_to_shape"


def resample_to_shape(
    data: Any,
    new_shape: Sequence[int],
    current_spacing: Sequence[float],
    new_spacing: Sequence[float],
    is_seg: bool = False,
    order: int = 3,
    order_z: int = 0,
    force_separate_z: bool | None = False,
    separate_z_anisotropy_threshold: float = ANISOTROPIC,
    *,
    device: Device | str | int | None = None,
) -> NDArray[Any]:
    """Resample channels or segmentations to a shape: nnU-Net's `resample_data_or_seg_to_shape`, for its plans files too.

    Parameters
    ----------
    data : array or Tensor, shape (c, x, y, z)
        On the host. float64 is computed in double precision, other types in single.
    new_shape : sequence of int
        Samples along the three axes.
    current_spacing, new_spacing : sequence of float
        Of the samples, before and after. They decide which axis is separate, and nothing else.
    is_seg : bool
        Whether `data` are labels: a sample gets the one whose indicator, resampled, is largest, of several the nearest sample's.
    order, order_z : int
        Of the spline, 0 to 5; `order_z` along a separate axis.
    force_separate_z : bool, optional
        Whether the axis of low resolution is resampled separately, after the other two; None: if its spacing, before or after, is
        more than `separate_z_anisotropy_threshold` times the smallest.
    separate_z_anisotropy_threshold : float
        See `force_separate_z`.
    device : Device, str or int, optional
        OpenCL device; see `as_device`.

    Returns
    -------
    ndarray
        Of the dtype of `data`. Values are within the range of their channel, of their slice where an axis is separate. Where the
        shape does not change they are `data` themselves.

    Raises
    ------
    DataError
        `data` has not four axes, or an empty one.
    OptionError
        `new_shape` is not three whole numbers, spacings are not three numbers above 0, or there is no such order.

    Notes
    -----
    The results of nnU-Net 2.8, which computes in double precision: single precision differs by up to 4e-6 of the range, and in
    labels where the two largest indicators are equal up to rounding.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol.nnunet import resample_to_shape
    >>> resample_to_shape(np.ones((1, 4, 8, 8), np.float32), (8, 16, 16), (2, 2, 2), (1, 1, 1)).shape
    (1, 8, 16, 16)
    """
    array = _as_channels(data)
    shape = _as_shape(new_shape)
    if shape == array.shape[1:]:
        return array
    axis = _separate_axis(force_separate_z, current_spacing, new_spacing, separate_z_anisotropy_threshold)
    whole("order_z", order_z, 0, 5)
    result = memory.empty((len(array), *shape), array.dtype, f"a result of {' × '.join(map(str, (len(array), *shape)))} samples")
    for channel, target in zip(array, result, strict=True):
        if is_seg:
            target[...] = _resampled_labels(channel, shape, axis, order, order_z, device)
        else:
            target[...] = _resampled(channel, shape, axis, order, order_z, device)
    return result


def labels_from_logits(
    logits: Any,
    new_shape: Sequence[int],
    current_spacing: Sequence[float],
    new_spacing: Sequence[float],
    order: int = 1,
    order_z: int = 0,
    force_separate_z: bool | None = None,
    separate_z_anisotropy_threshold: float = ANISOTROPIC,
    *,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> NDArray[Any]:
    """The label map of resampled logits or probabilities, ``resample_to_shape(logits, ...).argmax(0)``, in the memory of one class.

    One class is resampled after the other, and only the largest value so far and its label are kept. Where a class cannot be the
    largest, since its coefficients are smaller than that value, it is not evaluated.

    Parameters
    ----------
    logits : array or Tensor, shape (classes, x, y, z)
        As for `resample_to_shape`; up to 65536 classes. Softmax is not needed: it changes no order.
    new_shape, current_spacing, new_spacing, order, order_z, force_separate_z, separate_z_anisotropy_threshold, device
        As for `resample_to_shape`; the defaults are those of nnU-Net's plans for probabilities.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of uint8 or uint16, of the new shape
        The index of the class; of several that are largest the first.

    Raises
    ------
    DataError, OptionError
        As for `resample_to_shape`.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol.nnunet import labels_from_logits
    >>> logits = np.random.default_rng(0).random((5, 4, 8, 8), np.float32)
    >>> labels_from_logits(logits, (8, 16, 16), (2, 2, 2), (1, 1, 1)).dtype
    dtype('uint8')
    """
    array, shape = _as_channels(logits), _as_shape(new_shape)
    if len(array) > 65536:
        raise DataError(f"logits must have at most 65536 classes; got {len(array)}")
    axis = _separate_axis(force_separate_z, current_spacing, new_spacing, separate_z_anisotropy_threshold)
    whole("order_z", order_z, 0, 5)
    given = device, progress
    if axis is None:
        return _largest(array, shape, None, order, *given)
    plane = _plane(array.shape[1:], shape, axis)
    if plane == shape or order_z == 0:
        return _nearest_slices(_largest(array, plane, axis, order, *given), shape[axis], axis)
    return _largest(_Resampled(array, plane, axis, order, device), shape, None, order_z, *given)


def install() -> Path:
    """Make `resample_to_shape` known to nnU-Net, under the name ``"clvol_resample_to_shape"`` in its plans files.

    nnU-Net looks for resampling functions in a folder of its own package, in every process anew; this writes a file of one line
    there. ``python -m clvol.nnunet`` does the same.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MissingDependencyError
        nnU-Net is not installed.
    FormatError
        The file cannot be written.
    """
    try:
        import nnunetv2.preprocessing.resampling as theirs
    except ImportError as error:
        raise MissingDependencyError('clvol.nnunet.install needs nnU-Net: pip install "clvol[nnunet]"') from error
    path = Path(theirs.__path__[0]) / _PLANS_FILE
    with staged(path, ".py") as file:
        file.write_text(f"from clvol.nnunet import resample_to_shape as {_PLANS_NAME}  # noqa: F401\n", encoding="utf-8")
    return path


def _as_channels(data: Any) -> NDArray[Any]:
    """Channels of a volume, from an array or a Tensor."""
    array = np.asarray(data)
    if array.ndim != 4 or array.dtype.kind not in "biuf" or not array.size:
        rule = "real numbers with four axes, (c, x, y, z), none empty"
        raise DataError(f"data must be {rule}; got {array.dtype} of shape {array.shape}")
    return array


def _as_shape(shape: Sequence[int]) -> tuple[int, ...]:
    three = _three("new_shape", shape, "three whole numbers")
    return tuple(whole("each number of new_shape", n, 1, np.iinfo(np.int32).max) for n in three)


def _as_spacing(what: str, spacing: Sequence[float]) -> list[float]:
    return [number(f"each number of {what}", step, above=0) for step in _three(what, spacing, "three numbers")]


def _three(what: str, value: object, rule: str) -> list[Any]:
    given = several(what, value, rule)
    if len(given) != 3:
        raise OptionError(f"{what} must be {rule}; got {value!r}")
    return given


def _separate_axis(
    force: bool | None, current_spacing: Sequence[float], new_spacing: Sequence[float], threshold: float
) -> int | None:
    """The axis that is resampled separately, if one is: nnU-Net's rule."""
    if force is not None:
        flag("force_separate_z", force)
    given = [_as_spacing("current_spacing", current_spacing), _as_spacing("new_spacing", new_spacing)]
    if force is False:
        return None
    for spacing in given:
        if force or max(spacing) / min(spacing) > threshold:
            coarse = [axis for axis, step in enumerate(spacing) if step == max(spacing)]
            return coarse[0] if len(coarse) == 1 else None
    return None


def _plane(before: tuple[int, ...], after: tuple[int, ...], axis: int) -> tuple[int, ...]:
    """The shape once all axes but one are resampled."""
    return tuple(n if k == axis else m for k, (n, m) in enumerate(zip(before, after, strict=True)))


def _nearest_slices(values: NDArray[Any], count: int, axis: int) -> NDArray[Any]:
    """The nearest slice for each of `count` along an axis."""
    n = values.shape[axis]
    return values if n == count else values.take(np.clip(np.floor(places(n, count) + 0.5), 0, n - 1).astype(np.intp), axis)


def _resized(values: NDArray[Any], shape: tuple[int, ...], order: int, device: Any, **options: Any) -> NDArray[Any]:
    return resize(values, shape, order, "edge", anti_aliasing=False, preserve_range=True, device=device, **options)


def _in_planes(channel: NDArray[Any], plane: tuple[int, ...], axis: int, order: int, device: Any) -> NDArray[Any]:
    """Each slice across an axis resampled, and clipped to its range."""
    others = tuple(k for k in range(3) if k != axis)
    values = _resized(channel, tuple(plane[k] for k in others), order, device, channel_axis=axis, clip=False)
    if order > 1:
        np.clip(values, channel.min(others, keepdims=True), channel.max(others, keepdims=True), out=values)
    return values


def _resampled(
    channel: NDArray[Any], shape: tuple[int, ...], axis: int | None, order: int, order_z: int, device: Any
) -> NDArray[Any]:
    if axis is None:
        return _resized(channel, shape, order, device)
    values = _in_planes(channel, _plane(channel.shape, shape, axis), axis, order, device)
    return _nearest_slices(values, shape[axis], axis) if order_z == 0 else _resized(values, shape, order_z, device, clip=False)


def _resampled_labels(
    channel: NDArray[Any], shape: tuple[int, ...], axis: int | None, order: int, order_z: int, device: Any
) -> NDArray[Any]:
    plane = shape if axis is None else _plane(channel.shape, shape, axis)
    nearest = _resized(channel, plane, 0, device)
    labels = np.unique(channel)
    if order > 0:
        ties = np.searchsorted(labels, nearest)
        nearest = labels[_largest(_Indicators(channel, labels), plane, axis, order, device, nearest=ties)]
    if axis is None or order_z == 0 or plane == shape:
        return nearest if axis is None else _nearest_slices(nearest, shape[axis], axis)
    result = np.zeros(shape, channel.dtype)
    for label in labels:  # a later one wins, and 0 where none is above a half, as in nnU-Net
        result[_resized((nearest == label).astype(np.float64), shape, order_z, device, clip=False) > 0.5] = label
    return result


class _Indicators(Sequence[NDArray[Any]]):
    """For each label where it is."""

    def __init__(self, channel: NDArray[Any], labels: NDArray[Any]) -> None:
        self._channel, self._labels = channel, labels

    def __len__(self) -> int:
        return len(self._labels)

    def __getitem__(self, number: Any) -> Any:
        return self._channel == self._labels[number]


class _Resampled(Sequence[NDArray[Any]]):
    """Channels, each resampled in its slices once it is asked for."""

    def __init__(self, channels: NDArray[Any], *how: Any) -> None:
        self._channels, self._how = channels, how

    def __len__(self) -> int:
        return len(self._channels)

    def __getitem__(self, number: Any) -> Any:
        return _in_planes(self._channels[number], *self._how)


def _largest(
    channels: Sequence[NDArray[Any]] | NDArray[Any],
    shape: tuple[int, ...],
    axis: int | None,
    order: int,
    device: Device | str | int | None,
    progress: Progress | None = None,
    nearest: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """The number of the channel whose spline, clipped to its range, is largest at each sample of a new shape.

    An `axis` that is separate does not change, and its slices have splines and ranges of their own.
    """
    order, chosen = whole("order", order, 0, 5), as_device(device)
    turned = (0, 1, 2) if axis is None else (axis, *(k for k in range(3) if k != axis))
    first = channels[0]
    kind: type[np.generic] = np.float64 if first.dtype == np.float64 and chosen.has_double else np.float32
    before, after = (tuple(sizes[k] for k in turned) for sizes in (first.shape, shape))
    separate = 0 if axis is None else 1
    positions = [places(n, m) for n, m in zip(before[separate:], after[separate:], strict=True)][::-1]
    largest = Largest(after, len(channels), kind, chosen, None if nearest is None else nearest.transpose(turned))
    boundary = Spline(order, "nearest", 0.0, True, "single").boundary
    size = before[separate:][::-1]
    with Coefficients(size, row_of(order, True), boundary, chosen, kind=kind, batch=before[0] if separate else 1) as made:
        for number in range(len(channels)):
            samples = channels[number].transpose(turned)
            if samples.dtype == np.float16:  # kernels do not read it
                samples = samples.astype(np.float32)
            limits = np.tile(np.array([-math.inf, math.inf]), (after[0], 1))
            if order > 1 and not isinstance(channels, _Resampled):  # nnU-Net clips no values along a separate axis
                over = (1, 2) if separate else None
                limits[:, 0], limits[:, 1] = samples.min(over), samples.max(over)
            made.fill(samples)
            part = part_of(progress, number / len(channels), (number + 1) / len(channels))
            largest.compare(made, positions, number, limits, part)
    return np.ascontiguousarray(largest.numbers.transpose(np.argsort(turned)))


if __name__ == "__main__":
    try:
        print(install())
    except ClvolError as error:
        sys.exit(f"python -m clvol.nnunet: {error}")
