"""Images, grey or in colour, through the same filters as volumes: the paper's Figure 5."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike, NDArray

from clvol.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.device import Device
from clvol.filters import DEFAULT_FILTER, Filter

__all__ = ["resample", "rotate", "zoom"]


def resample(
    image: ArrayLike, shape: Sequence[int], filter: str | Filter = DEFAULT_FILTER, boundary: str | Boundary = DEFAULT_BOUNDARY, *,
    device: Device | str | int | None = None,
) -> NDArray[Any]:  # fmt: skip
    """The image with other numbers of rows and columns; its domain, from edge to edge, stays.

    Parameters
    ----------
    image : array-like, shape (height, width) or (height, width, channels)
        Up to 4 channels, each of which is reconstructed on its own. Volumes are for `clvol.resample`, which would take
        three axes for [z, y, x].
    shape : (int, int)
        Height and width of the result.
    filter, boundary, device
        As for `clvol.sample`. No low-pass is applied.

    Returns
    -------
    ndarray of the image's dtype
        Integers are rounded and cut to the range of their type, since filters may leave that of the image; floats are
        computed in float32.

    Raises
    ------
    DataError, OptionError, DeviceError
    """
    raise NotImplementedError


def zoom(
    image: ArrayLike, factor: float | tuple[float, float], filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY, *, device: Device | str | int | None = None,
) -> NDArray[Any]:  # fmt: skip
    """The image `factor` times as high and wide, or (rows, columns) times, rounded to whole pixels; else as `resample`."""
    raise NotImplementedError


def rotate(
    image: ArrayLike, degrees: float, filter: str | Filter = DEFAULT_FILTER, boundary: str | Boundary = DEFAULT_BOUNDARY, *,
    zoom: float = 1.0, shape: Sequence[int] | None = None, fill: float | None = 0.0, device: Device | str | int | None = None,
) -> NDArray[Any]:  # fmt: skip
    """The image turned about its middle, counter-clockwise as it is shown (row 0 on top), and magnified by `zoom`.

    Parameters
    ----------
    shape : (int, int), optional
        Height and width of the result, whose middle shows the image's middle; default: those of the image.
    fill : float or None
        Value of pixels outside the image; None: the boundary rule goes on.
    image, filter, boundary, device
        As for `resample`.

    Returns
    -------
    ndarray of the image's dtype
    """
    raise NotImplementedError
