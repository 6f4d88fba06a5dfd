"""Resizing arrays of any number of axes by scikit-image's rules: `resize`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import one_of, suggests_options, whole
from clvol.base.errors import DataError, OptionError
from clvol.device import Device, as_device
from clvol.interop.images import read_array
from clvol.ndimage.antialiasing import low_passed, nearest_splines, widths
from clvol.ndimage.arguments import Spline, as_cval, as_precision
from clvol.ndimage.in_memory import along_axes
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing

__all__ = ["places", "resize"]

_MODES = {"constant": "grid-constant", "edge": "nearest", "symmetric": "reflect", "reflect": "mirror", "wrap": "grid-wrap"}


@suggests_options
def resize(
    image: ArrayLike,
    output_shape: Iterable[int],
    order: int | None = None,
    mode: str = "reflect",
    cval: float = 0,
    clip: bool = True,
    preserve_range: bool = False,
    anti_aliasing: bool | Literal["gaussian", "least-squares"] | None = None,
    anti_aliasing_sigma: float | Sequence[float] | None = None,
    *,
    channel_axis: int | None = None,
    precision: Precision | None = None,
    device: Device | str | int | None = None,
    progress: Callable[[float], Any] | None = None,
) -> NDArray[Any]:
    """Change the number of samples along the axes of an array: `skimage.transform.resize` of scikit-image 0.26.

    The domain, from edge to edge, stays: sample j of m lies at ``(j + 1/2) n / m - 1/2`` of the given n.

    Parameters
    ----------
    image : array-like
        Real numbers, with any number of axes. Integers are read as they are, without a floating-point copy of the array.
    output_shape : iterable of int
        Samples along each axis. The last axis may be left out and keeps its length; more numbers than axes first append axes of one
        sample.
    order : int, optional
        Order of the spline, 0 to 5; default 0 for booleans, else 1.
    mode : {"reflect", "symmetric", "edge", "wrap", "constant"}
        The values outside, in the terms of `numpy.pad`.
    cval : float
        The value outside with "constant", in units of the result.
    clip : bool
        Keep the result within the range of the image.
    preserve_range : bool
        Keep the units of integers; else they are divided by the largest number of their type, and the smallest of a signed type
        becomes -1.
    anti_aliasing : {None, False, True, "gaussian", "least-squares"}
        True, "gaussian": a low-pass first, where an axis gets f times fewer samples, of standard deviation (f - 1) / 2 samples.
        "least-squares": the spline of the new samples that is nearest to that of the given ones, which keeps more detail and fewer
        aliases; it overshoots at edges as splines do. None: True if an axis gets shorter, but for booleans, and for integers
        of order 0.
    anti_aliasing_sigma : float or sequence of float, optional
        Standard deviation of the Gaussian, in samples, for all axes or each.
    channel_axis : int, optional
        An axis that keeps its length; `output_shape` is then that of the other axes.
    precision : {"single", "double"}, optional
        Of the computation; default "single" for booleans, integers of 8 and 16 bits, float16 and float32, else "double".
    device : Device, str or int, optional
        See `clvol.device.as_device`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray
        The image's type if order is 0; else float32 for float16 and float32, and float64 for all others. It needs memory for the
        result and for one copy of the image.

    Raises
    ------
    DataError
        The image is empty, does not hold real numbers, or holds NaN or infinities, which a spline of order 2 or more, or least
        squares, would spread over the whole image.
    OptionError
        An argument is not allowed; booleans with an order or with anti-aliasing.
    DeviceError
        No usable device, or it lacks double precision.
    OutOfMemoryError
        There is no room for the result.

    Warns
    -----
    UserWarning
        `anti_aliasing_sigma` is above 0 for an axis that does not get shorter.

    Notes
    -----
    It differs from scikit-image: integers of order 0 that are low-passed are rounded once, not truncated after each axis;
    "symmetric" is exact on short axes, too, where SciPy's prefilter errs (by 0.3 % of the range on 3 samples at order 3, by 4 % at
    order 5); NaN and infinities are refused if they would spread; and shapes must be whole numbers.

    Examples
    --------
    >>> half = clvol.resize(photograph, (540, 960), anti_aliasing="least-squares")
    >>> doubled = clvol.resize(ct, [2 * n for n in ct.shape], order=3, preserve_range=True)
    """
    array, shape, spatial = _arguments(image, output_shape, channel_axis)
    given = array.dtype
    shrinks = any(m < n for m, n in zip(shape, array.shape, strict=True))
    if anti_aliasing is None:
        anti_aliasing = given.kind != "b" and not (given.kind in "iu" and order == 0) and shrinks
    chosen = as_anti_aliasing(anti_aliasing)
    if given.kind == "b" and chosen:
        raise OptionError(f"anti_aliasing must be False for booleans; got {anti_aliasing!r}")
    order = _order(order, given)
    if not isinstance(mode, str) or mode not in _MODES:
        raise one_of("mode", mode, _MODES)
    precision = as_precision(precision, given)
    single = given.kind == "f" and given.itemsize <= 4
    kind = np.dtype(np.float32 if single else np.float64) if order > 0 or given.kind == "f" else given.newbyteorder("=")
    scale = 1.0
    if order > 0 and given.kind in "iu" and not preserve_range:
        top = np.iinfo(given).max
        scale = 1.0 / top
        if given.kind == "i" and array.min() < -top:
            array = np.maximum(array, -top, dtype=given)
    if given.kind == "f" and given.itemsize > 8:  # devices cannot compute with wider types
        array = array.astype(kind)
    low, high = _range(array, order > 1 or chosen == "least-squares")
    sigma = _sigma(anti_aliasing_sigma, chosen, array.shape, shape, spatial)
    chosen_device = None if device is None else as_device(device)
    outside = float(as_cval(cval, False).real)
    spline = Spline(order, _MODES[mode], outside / scale, True, precision, chosen_device, progress)
    result = _resized(array, shape, kind, spline, chosen, sigma)
    if scale != 1:
        result *= scale
    if clip:
        _clip(result, low * scale if scale != 1 else low, high * scale if scale != 1 else high, mode, outside)
    return result


def _arguments(
    image: ArrayLike, output_shape: Iterable[int], channel_axis: int | None
) -> tuple[NDArray[Any], tuple[int, ...], list[bool]]:
    """The array, its new shape, and for each axis whether it is not the channels'."""
    array, _ = read_array(image, placed=False)
    if array.dtype.kind not in "biuf":
        raise DataError(f"image must be boolean, integer or floating; got dtype {array.dtype}")
    if array.size == 0 or array.ndim == 0:
        raise DataError(f"image must have one axis or more, and each at least one sample; got shape {array.shape}")
    try:
        numbers = [int(n) if float(n).is_integer() else n for n in output_shape]
    except (TypeError, ValueError, OverflowError):
        raise OptionError(f"output_shape must be whole numbers of at least 1; got {output_shape!r}") from None
    shape = [whole("each number of output_shape", n, 1, np.iinfo(np.int32).max) for n in numbers]
    if channel_axis is None:
        if len(shape) == array.ndim - 1:
            shape.append(array.shape[-1])
        if len(shape) < array.ndim:
            raise OptionError(f"output_shape must have {array.ndim} numbers, or one less to keep the last axis; got {len(shape)}")
        array = array.reshape(array.shape + (1,) * (len(shape) - array.ndim))
        return array, tuple(shape), [True] * len(shape)
    channel = whole("channel_axis", channel_axis, -array.ndim, array.ndim - 1) % array.ndim
    if len(shape) != array.ndim - 1:
        raise OptionError(f"output_shape must have {array.ndim - 1} numbers beside a channel axis; got {len(shape)}")
    shape.insert(channel, array.shape[channel])
    return array, tuple(shape), [axis != channel for axis in range(array.ndim)]


def _order(order: int | None, kind: np.dtype[Any]) -> int:
    if order is None:
        return 0 if kind.kind == "b" else 1
    order = whole("order", order, 0, 5)
    if kind.kind == "b" and order != 0:
        raise OptionError(f"order must be 0 for booleans: convert them to numbers first; got {order!r}")
    return order


def _range(array: NDArray[Any], spreads: bool) -> tuple[Any, Any]:
    """Smallest and largest sample; NaN are ignored, unless they would spread."""
    low, high = array.min(), array.max()
    if array.dtype.kind == "f" and not (np.isfinite(low) and np.isfinite(high)):
        if spreads:
            bad = ~np.isfinite(array)
            first = [int(i) for i in np.unravel_index(int(np.argmax(bad)), array.shape)]
            raise DataError(
                f"image must be finite, since a spline would spread other values; got {int(bad.sum())} NaN or infinite, "
                f"the first at index {first}: replace them, or use order 0 or 1"
            )
        known = array[~np.isnan(array)]
        low, high = (known.min(), known.max()) if known.size else (low, high)
    return low, high


def _sigma(
    given: float | Sequence[float] | None, chosen: AntiAliasing, old: tuple[int, ...], new: tuple[int, ...], spatial: list[bool]
) -> dict[int, float]:
    """Standard deviation of the Gaussian along each axis; none without one."""
    if chosen != "gaussian":
        if chosen and given is not None:
            raise OptionError(f"anti_aliasing_sigma is for the Gaussian, not for least squares; got {given!r}")
        return {}
    if given is None:
        return widths(new, old)
    values = np.atleast_1d(reals("anti_aliasing_sigma", given))
    axes = [axis for axis, own in enumerate(spatial) if own]
    if values.shape not in ((1,), (len(axes),)) or not np.isfinite(values).all() or (values < 0).any():
        raise OptionError(
            f"anti_aliasing_sigma must be a number of at least 0, or {len(axes)} of them, one for each axis; got {given!r}"
        )
    sigma = dict(zip(axes, np.broadcast_to(values, (len(axes),)).tolist(), strict=True))
    if any(s > 0 and old[axis] <= new[axis] for axis, s in sigma.items()):
        warnings.warn("anti_aliasing_sigma is greater than zero along an axis that does not get shorter", UserWarning, stacklevel=3)
    return sigma


def places(n: int, m: int) -> NDArray[np.float64]:
    """The positions of m samples in those of an axis of n."""
    return np.asarray((np.arange(m) + 0.5) * (n / m) - 0.5)


def _resized(
    array: NDArray[Any], shape: tuple[int, ...], kind: np.dtype[Any], spline: Spline, chosen: AntiAliasing, sigma: dict[int, float]
) -> NDArray[Any]:
    """Values in the array's units."""
    memory.require(24 * max(shape), f"the positions of {max(shape)} samples along an axis")
    positions = {axis: places(n, m) for axis, (n, m) in enumerate(zip(array.shape, shape, strict=True)) if n != m}
    result = memory.empty(shape, kind, f"a result of {' × '.join(map(str, shape))} samples")
    if chosen == "least-squares" and positions:
        nearest_splines(array, positions, result, spline)
    else:
        along_axes(low_passed(array, sigma, spline), [positions.get(axis) for axis in range(array.ndim)], result, spline)
    return result


def _clip(result: NDArray[Any], low: Any, high: Any, mode: str, cval: float) -> None:
    """Clip to the range of the image, widened to `cval` if that is outside and reaches the result."""
    if mode == "constant" and not low <= cval <= high and np.nanmin(result) <= cval <= np.nanmax(result):
        low, high = min(low, cval), max(high, cval)
    if not math.isnan(low):
        np.clip(result, low, high, out=result)
