"""How often a function has which value and which slope: where boundaries are, for transfer functions of both."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import suggests_options, whole
from clvol.base.errors import DataError, OptionError
from clvol.spline.field import as_field

if TYPE_CHECKING:
    from clvol.bricks.source import LazyVolume
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.function import ContinuousFunction
    from clvol.volume.volume import Volume

__all__ = ["JointHistogram", "joint_histogram"]

_POINTS = 1 << 17
_APART = 1 / 1.2207440846057596 ** np.arange(1, 4)  # Roberts (2018): points of these steps, modulo 1, are spread evenly
_STEEPEST = 0.999  # quantile of the magnitudes of gradients, of which the last row has all larger ones too
_MOST_BINS = 4096


class JointHistogram(NamedTuple):
    """Counts of value and steepness.

    Attributes
    ----------
    counts : ndarray of int64, shape (gradients, values)
    values : ndarray of float64
        Edges of the columns.
    gradients : ndarray of float64
        Edges of the rows: magnitudes of the gradient, in units of the data per world unit. The last row has all that is steeper.
    """

    counts: NDArray[np.int64]
    values: NDArray[np.float64]
    gradients: NDArray[np.float64]


@suggests_options
def joint_histogram(
    volume: Volume | LazyVolume | ContinuousFunction | ArrayLike,
    bins: tuple[int, int] = (128, 256),
    *,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
) -> JointHistogram:
    """Count values of a function together with the magnitudes of its gradient, at 131,072 points spread evenly over a volume.

    Homogeneous matter lies at the bottom, and each boundary between two materials is an arch from the one to the other (Kindlmann
    and Durkin, 1998): what `TransferFunction2D` tells apart.

    Parameters
    ----------
    volume : Volume, array-like, LazyVolume or Field
        Three axes. What a Field with missing samples has no value for is left out.
    bins : (int, int)
        Rows, of gradients, and columns, of values: 1 to 4096 each.
    filter, boundary, device
        As for `clvol.Field`.

    Returns
    -------
    JointHistogram
        Counts, and the edges of values and gradients; values are all of those at the points, gradients up to the .999 quantile.

    Raises
    ------
    OptionError
        `bins` is not as above, or the filter has no slopes.
    DataError
        There are no finite samples, or differences of them are out of the range of float64.
    DataError, DeviceError, OutOfMemoryError
        As `clvol.Field` raises them.

    Examples
    --------
    >>> import clvol
    >>> counts, values, gradients = clvol.joint_histogram(clvol.phantoms.sphere(32))
    >>> counts.shape, int(counts.sum())
    ((128, 256), 131072)
    """
    rule = f"(rows, columns), whole numbers from 1 to {_MOST_BINS}"
    try:
        rows, columns = (whole("each of bins", n, 1, _MOST_BINS) for n in bins)
    except (TypeError, ValueError):
        raise OptionError(f"bins must be {rule}; got {bins!r:.80}") from None
    field = as_field(volume, filter, boundary, device)
    if field.grid.ndim != 3:
        raise DataError(f"a joint histogram takes a volume of 3 axes; got shape {field.grid.shape}")
    if not field.filter.has_gradient:
        raise OptionError(f"a joint histogram takes a filter with slopes, such as bspline3; got {field.filter.name}")
    share = (0.5 + np.arange(_POINTS)[:, None] * _APART) % 1
    points = field.grid.index_to_world(share * (np.array(field.grid.shape[::-1]) - 1))
    values, slopes = np.asarray(field(points), np.float64), np.asarray(field.gradient(points), np.float64)
    largest = float(np.max(np.abs(slopes), initial=0.0, where=np.isfinite(slopes))) or 1.0
    with np.errstate(over="ignore"):
        steep = largest * np.linalg.norm(slopes / largest, axis=-1)
    known = ~(np.isnan(values) | np.isnan(steep))
    if not known.any():
        raise DataError("a joint histogram takes a volume with finite samples; got none")
    values, steep = values[known], steep[known]
    low, high, steepest = float(values.min()), float(values.max()), float(steep.max())
    if not math.isfinite(high - low + steepest):
        raise DataError(
            "a joint histogram takes a volume whose range and gradients are within that of float64; got values from "
            f"{low:g} to {high:g}, and gradients up to {steepest:g}"
        )
    top = float(np.quantile(steep, _STEEPEST)) or 1.0
    span = (low, high) if low < high else (low - 0.5, high + 0.5)
    counts, gradients, edges = np.histogram2d(np.minimum(steep, top), values, (rows, columns), ((0.0, top), span))
    return JointHistogram(counts.astype(np.int64), edges, gradients)
