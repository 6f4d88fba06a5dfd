"""Resample grey and colour images with the filters of volumes: the paper's Figure 5."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import number, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.rounding import below, limits, rounded
from clvol.device import Device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.interop.images import read_array
from clvol.spline import field
from clvol.volume.stored import Stored, differences
from clvol.volume.volume import Volume

__all__ = ["resample", "rotate", "zoom"]

_LONGEST = (1 << 31) - 1  # pixels along an axis: the range of OpenCL's int
_FLOAT32_INTEGERS = 1 << 16  # magnitude up to which the float32 error (24 bits) is below 1/2 for all filters


def resample(
    image: ArrayLike,
    shape: Sequence[int],
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    device: Device | str | int | None = None,
) -> NDArray[Any]:
    """Resample an image to another number of rows and columns over the same domain, from edge to edge.

    Parameters
    ----------
    image : array-like, shape (height, width) or (height, width, channels)
        Up to 4 channels, reconstructed separately. For volumes use `clvol.resample`, where three axes are [z, y, x].
    shape : (int, int)
        Height and width of the result.
    filter, boundary, device
        See `clvol.sample`. There is no low-pass.

    Returns
    -------
    ndarray of the image's dtype
        Integers are rounded to nearest and clipped to their type, because filters may overshoot the image's range. Where new
        pixels coincide with old ones, interpolating filters reproduce them exactly; elsewhere a pixel whose exact
        value is close to a half may round the other way. Integers of 32 and 64 bits with magnitudes above 2¹⁶
        (relative to their middle, if they are far from zero) are computed in double precision, which the device must support. If
        they span more than 2⁵³, results have the error of float64. Floats are computed in float32, relative to their middle if they
        are far from zero: the error is about 10⁻⁶ of the image's range.

    Raises
    ------
    DataError
        The image has another shape, is empty, or holds NaN, infinite or other than real numbers.
    OptionError
        An unknown filter or boundary, or a number outside its bounds.
    DeviceError
        No usable device, or it failed; `OutOfMemoryError` if the result does not fit.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> photograph = np.zeros((40, 60, 3), np.uint8)
    >>> clvol.images.resample(photograph, (100, 150)).shape
    (100, 150, 3)
    """
    pixels = _pixels(image)
    height, width = _size(shape)
    spacing = (pixels.shape[1] / width, pixels.shape[0] / height)
    grid = _grid((height, width), spacing, tuple((s - 1) / 2 for s in spacing))
    return _drawn(pixels, grid, filter, boundary, None, device)


def zoom(
    image: ArrayLike,
    factor: float | tuple[float, float],
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    device: Device | str | int | None = None,
) -> NDArray[Any]:
    """Enlarge an image by `factor`, or by (rows, columns) factors, rounded to whole pixels; otherwise like `resample`."""
    pixels = _pixels(image)
    factors = factor if isinstance(factor, (tuple, list)) else (factor, factor)
    if len(factors) != 2:
        raise OptionError(f"factor must be a number, or two of them, of rows and of columns; got {factor!r}")
    shape = [
        max(1, round(number("factor", f, above=0, maximum=_LONGEST / n) * n))
        for f, n in zip(factors, pixels.shape[:2], strict=True)
    ]
    return resample(pixels, shape, filter, boundary, device=device)


def rotate(
    image: ArrayLike,
    degrees: float,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    zoom: float = 1.0,
    shape: Sequence[int] | None = None,
    fill: float | None = 0.0,
    device: Device | str | int | None = None,
) -> NDArray[Any]:
    """Rotate an image about its centre, counter-clockwise as displayed (row 0 on top), and magnify it by `zoom`.

    Parameters
    ----------
    image : array-like, shape (height, width) or (height, width, channels)
        As for `resample`.
    degrees : float
        The angle.
    filter, boundary, device
        As for `resample`.
    zoom : float
        Magnification, greater than 0.
    shape : (int, int), optional
        Height and width of the result, which has the same centre; default: those of the image.
    fill : float or None
        Value of pixels outside the image, not NaN for integers; None: the boundary rule applies.

    Returns
    -------
    ndarray of the image's dtype, as from `resample`

    Raises
    ------
    DataError
        The image has another shape, is empty, or holds NaN, infinite or other than real numbers.
    OptionError
        An unknown filter or boundary, or a number outside its bounds.
    DeviceError
        No usable device, or it failed; `OutOfMemoryError` if the result does not fit.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> clvol.images.rotate(np.zeros((40, 60)), 30, shape=(70, 70)).shape
    (70, 70)
    """
    pixels, angle, step = _pixels(image), number("degrees", degrees), 1 / number("zoom", zoom, above=0)
    height, width = pixels.shape[:2] if shape is None else _size(shape)
    if fill is not None and pixels.dtype.kind != "f":
        number("fill", fill)
    # the picture rotates against the sampling grid; rows go down
    cos, sin = _cos_sin(angle)
    direction = np.array([[cos, -sin], [sin, cos]])
    middle = (np.array(pixels.shape[1::-1]) - 1) / 2
    origin = middle - direction @ (np.array([width - 1, height - 1]) / 2 * step)
    return _drawn(pixels, _grid((height, width), (step, step), tuple(origin), direction), filter, boundary, fill, device)


# -- inner -------------------------------------------------------------------------------------------------


def _pixels(image: ArrayLike) -> NDArray[Any]:
    pixels, _ = read_array(image, placed=False)
    if pixels.ndim not in (2, 3) or 0 in pixels.shape or (pixels.ndim == 3 and pixels.shape[2] > 4):
        raise DataError(
            f"image must have shape (height, width), or (height, width, channels) with up to 4 channels; got {pixels.shape}"
        )
    return pixels


def _size(shape: Sequence[int]) -> tuple[int, int]:
    if not isinstance(shape, (tuple, list)) or len(shape) != 2:
        raise OptionError(f"shape must be two whole numbers, height and width; got {shape!r}")
    return whole("height", shape[0], 1, _LONGEST), whole("width", shape[1], 1, _LONGEST)


def _cos_sin(degrees: float) -> tuple[float, float]:
    """Cosine and sine, exact at quarter turns, so that pixels coincide."""
    turns, rest = divmod(degrees, 90)
    cos, sin = (math.cos(math.radians(rest)), math.sin(math.radians(rest))) if rest else (1.0, 0.0)
    for _ in range(int(turns % 4)):
        cos, sin = -sin, cos
    return cos, sin


def _grid(
    shape: tuple[int, int], spacing: tuple[float, ...], origin: tuple[float, ...], direction: NDArray[np.float64] | None = None
) -> Volume:
    """The grid of the result, in pixels of the image; it uses no memory."""
    return Volume(np.broadcast_to(np.float32(0), shape), spacing, origin, direction)  # type: ignore[arg-type]  # None: not rotated


def _drawn(
    pixels: NDArray[Any],
    grid: Volume,
    filter: str | Filter,
    boundary: str | Boundary,
    fill: float | None,
    device: Device | str | int | None,
) -> NDArray[Any]:
    """Resample each channel to a grid, in the image's dtype."""
    chosen, rule = as_filter(filter), as_boundary(boundary)
    if pixels.dtype.kind != "f":
        number("the value of the boundary", rule.cval)
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    each = 2 * channels * pixels.itemsize + 4 + (0 if pixels.dtype.kind == "f" else 24)  # integers are rounded in float64
    memory.require(each * math.prod(grid.shape), f"an image of {grid.shape} pixels and {channels} channels")
    planes = [pixels] if pixels.ndim == 2 else list(np.moveaxis(pixels, 2, 0))
    drawn = [_channel(plane, grid, chosen, rule, fill, device) for plane in planes]
    return drawn[0] if pixels.ndim == 2 else np.stack(drawn, -1)


def _channel(
    plane: NDArray[Any], grid: Volume, filter: Filter, boundary: Boundary, fill: float | None, device: Device | str | int | None
) -> NDArray[Any]:
    if plane.dtype.kind in "biu" and plane.dtype.itemsize > 2:
        return _wide_integers(plane, grid, filter, boundary, fill, device)
    values = field.resample(plane, like=grid, filter=filter, boundary=boundary, fill=fill, device=device).data
    return values.astype(plane.dtype) if plane.dtype.kind == "f" else rounded(values, plane.dtype)


def _wide_integers(
    plane: NDArray[Any], grid: Volume, filter: Filter, boundary: Boundary, fill: float | None, device: Device | str | int | None
) -> NDArray[Any]:
    """Resample a channel of 32- or 64-bit integers, minus an integer offset that is added back to the rounded result."""
    image = Volume(plane)
    low, high = (int(v) for v in image.limits)
    offset = 0 if boundary.period is None else int(Stored.of(image, filter, boundary).offset)  # "zero" has no value to move
    if max(high - offset, offset - low) > _FLOAT32_INTEGERS and filter.sums_to_one and boundary.period is not None:
        offset = low + (high - low + 1) // 2  # float64 cannot hold all of them; differences from here fit into int64
    moved = differences(plane, offset) if offset else plane
    rule = replace(boundary, cval=boundary.cval - offset)
    outside = None if fill is None else np.nan if offset else fill
    precision: field.Precision = "double" if max(high - offset, offset - low) > _FLOAT32_INTEGERS else "single"
    values: NDArray[Any] = field.resample(
        moved, like=grid, filter=filter, boundary=rule, fill=outside, device=device, precision=precision
    ).data
    if not offset:
        return rounded(values, plane.dtype)
    filled = np.isnan(values)
    result = _moved(np.where(filled, 0, values), plane.dtype, offset)
    result[filled] = rounded(np.float64(fill or 0), plane.dtype)
    return result


def _moved(values: NDArray[Any], kind: np.dtype[Any], offset: int) -> NDArray[Any]:
    """Round values plus an offset to the nearest integers of a type."""
    low, high = (end - offset for end in limits(kind))
    least, most = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    whole = np.clip(np.rint(values.astype(np.float64)), -below(-max(low, int(least))), below(min(high, int(most))))
    return np.asarray((whole.astype(np.int64).view(np.uint64) + np.uint64(offset % (1 << 64))).astype(kind))  # modulo 2⁶⁴
