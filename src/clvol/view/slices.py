"""Pictures of slices: the function that is drawn, at the middle of every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.bricks.source import LazyVolume
from clvol.device import Device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import PICTURE_FILTER
from clvol.march.bricks import level_within
from clvol.march.renderer import Renderer
from clvol.march.source import row_for, single
from clvol.scene.transfer import TransferFunction
from clvol.show.picture import Picture
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume, as_volume

__all__ = ["plane_points", "section", "shaded", "window_of_slices"]

_SAMPLED = 1 << 20
_ENDS = 0.002, 0.998  # quantiles of the samples that are black and white by default


def section(
    volume: Volume | LazyVolume | Any,
    middle: Sequence[float],
    right: Sequence[float],
    down: Sequence[float],
    pixel: tuple[float, float],
    size: tuple[int, int],
    *,
    filter: str | Filter | None = None,
    boundary: str | Boundary = "mirror",
    window: tuple[float, float] | None = None,
    cmap: str | None = None,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    device: Device | str | int | None = None,
) -> Picture:
    """A picture of the plane through a world point: what `View` shows as a slice, bit for bit.

    Parameters
    ----------
    volume : Volume, LazyVolume or array-like
        Of a LazyVolume the coarsest level whose voxels are at most a pixel long is read, where the plane lies.
    middle : (x, y, z)
        The world point in the middle of the picture.
    right, down : (x, y, z)
        Unit vectors of the world along rows and columns of the picture.
    pixel : (float, float)
        World units per pixel, along rows and columns.
    size : (width, height)
        In pixels.
    filter, boundary, device
        As for `clvol.render`.
    window : (center, width), optional
        Values from black to white; by default those of `Volume.clim`, or nearly all of its values.
    cmap : str, optional
        The name of a colour map.
    background : three numbers or None
        Outside the volume, and where its samples are missing (see `Renderer`); None is transparent.
    """
    points = plane_points(middle, right, down, pixel, size)
    if isinstance(volume, LazyVolume):
        with Renderer(volume, row_for(volume, filter), boundary, device) as renderer:
            values = renderer.field_of_level(level_within(volume, max(pixel)))(points, fill=np.nan)
        return shaded(values, volume.preview(), window, cmap, background)
    volume = as_volume(volume)
    with single(volume, filter_for(volume, filter, PICTURE_FILTER), as_boundary(boundary), device) as field:
        return shaded(field(points, fill=np.nan), volume, window, cmap, background)


def plane_points(
    middle: Sequence[float] | NDArray[np.float64],
    right: Sequence[float] | NDArray[np.float64],
    down: Sequence[float] | NDArray[np.float64],
    pixel: tuple[float, float],
    size: tuple[int, int],
) -> NDArray[np.float64]:
    """World points at the centres of pixels; (height, width, 3)."""
    width, height = whole("width", size[0], 1, 1 << 15), whole("height", size[1], 1, 1 << 15)
    u = (np.arange(width) + 0.5 - width / 2) * pixel[0]
    v = (np.arange(height) + 0.5 - height / 2) * pixel[1]
    return np.asarray(
        np.asarray(middle) + v[:, None, None] * np.asarray(down, np.float64) + u[None, :, None] * np.asarray(right, np.float64)
    )


def shaded(
    values: NDArray[Any], volume: Volume, window: tuple[float, float] | None, cmap: str | None, background: Sequence[float] | None
) -> Picture:
    """Values in colours, (height, width, 4) float32; NaN is background."""
    if volume.is_labels and window is None and cmap is None:
        colors = _of_labels(values, volume)
    else:
        center, width = window_of_slices(volume) if window is None else window
        low = center - width / 2
        if not width > 0:
            raise OptionError(f"window must be (center, width), the width positive; got {window!r}")
        with np.errstate(invalid="ignore"):
            share = np.clip((values - low) / width, 0, 1)
        share = np.nan_to_num(share, nan=0.0)
        if cmap is None:
            colors = np.repeat(share[..., None], 3, -1)
        else:
            table = TransferFunction.from_cmap(cmap, (0.0, 1.0))(np.linspace(0, 1, 1024))[:, :3]
            colors = table[np.rint(share * 1023).astype(np.intp)]
    picture = np.ones((*values.shape, 4), np.float32)
    picture[..., :3] = colors
    outside = np.isnan(values)
    if outside.any():
        picture[outside] = (0, 0, 0, 0) if background is None else (*background, 1)
    return Picture(picture)


def _of_labels(values: NDArray[Any], volume: Volume) -> NDArray[np.float64]:
    numbers, inverse = np.unique(np.nan_to_num(values), return_inverse=True)
    look = TransferFunction.preset("labels", volume)(numbers)
    colors = look[:, :3] * (look[:, 3:] > 0)
    return np.asarray(colors[inverse.reshape(values.shape)])


def window_of_slices(volume: Volume) -> tuple[float, float]:
    """The default window of slices: (center, width)."""
    if volume in _WINDOWS:
        return _WINDOWS[volume]
    if volume.clim is not None:
        low, high = volume.clim
    else:
        step = max(1, -(-volume.data.size // _SAMPLED))
        each = max(1, round(step ** (1 / 3)))
        some = volume.data[::each, ::each, ::each].astype(np.float64)
        low, high = np.quantile(some[np.isfinite(some)], _ENDS).tolist()
        if not low < high:
            low, high = volume.value_range
    if not low < high:
        low, high = low - 0.5, high + 0.5
    _WINDOWS[volume] = found = float(low / 2 + high / 2), float(high - low)
    return found


_WINDOWS: WeakKeyDictionary[Volume, tuple[float, float]] = WeakKeyDictionary()
