"""Contours of labels on slices: the pixels that lie as near to a boundary as a line is wide."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number
from clvol.base.errors import OptionError

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.volume.volume import Volume

__all__ = ["Shown", "contour_width", "on_contours"]

_WIDEST = 16  # pixels: the work grows with the square
_TOO_THIN = 0.05  # pixels, by which a line may be
_AT_ONCE = 1 << 20  # points


class Shown(Protocol):
    """What slices show: a number at each point of the world."""

    @property
    def grid(self) -> Volume: ...

    def __call__(self, points: NDArray[np.float64], *, fill: float, progress: Progress | None = None) -> NDArray[Any]: ...


def contour_width(value: float, thickness: float) -> float:
    """The width of contours in pixels, checked; 0 is none. They are of slices, which have no thickness."""
    width = number("contour", value, minimum=0, maximum=_WIDEST)
    if 0 < width < 1:
        raise OptionError(f"contour must be 0, where areas are filled, or from 1 to {_WIDEST} pixels; got {value!r}")
    if width and thickness:
        raise OptionError(f"contour is of a plane; leave out the thickness of a slab; got {thickness:g}")
    return width


def on_contours(
    function: Shown, labels: NDArray[Any], points: NDArray[np.float64], axes: NDArray[np.float64], width: float
) -> NDArray[np.bool_]:
    """Whether another label lies within `width` pixels of each pixel's centre; not where the function ends.

    Parameters
    ----------
    function : Shown
        Has labels, or NaN outside.
    labels : (height, width)
        Its values at the pixels' centres.
    points : (height, width, 3)
        These centres in the world.
    axes : (2, 3)
        What a pixel measures in the world, along rows and columns.
    width : float
        At least 1.
    """
    found, near = np.zeros(labels.shape, bool), np.zeros(labels.shape, bool)
    rows, columns = (min(math.floor(width + 1), n - 1) for n in labels.shape)
    for y in range(rows + 1):
        for x in range(-columns if y else 1, columns + 1):
            if x * x + y * y > (width + 1) ** 2:
                continue
            here = np.s_[: len(labels) - y, max(0, -x) : labels.shape[1] - max(0, x)]
            there = np.s_[y:, max(0, x) : labels.shape[1] + min(0, x)]
            differ = (labels[here] < labels[there]) | (labels[here] > labels[there])  # not where one is NaN
            for seen in (found, near) if x * x + y * y <= width * width else (near,):
                seen[here] |= differ
                seen[there] |= differ
    # between the centres of pixels: on a circle around each that may yet be near enough
    count = math.ceil(math.pi * math.sqrt(width / (2 * _TOO_THIN)))
    angles = np.arange(count) * (2 * math.pi / count)
    circle = width * np.stack([np.cos(angles), np.sin(angles)], 1) @ axes
    open_ones = np.argwhere(near & ~found)
    each = max(1, _AT_ONCE // count)
    for first in range(0, len(open_ones), each):
        own = tuple(open_ones[first : first + each].T)
        around = function(points[own][:, None] + circle, fill=np.nan)
        found[own] = ((around < labels[own][:, None]) | (around > labels[own][:, None])).any(1)
    return found
