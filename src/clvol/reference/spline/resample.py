"""The reconstructed function on a grid: eq. (8) one axis at a time; `sample` works point by point."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from clvol.base.arrays import Array
from clvol.base.errors import OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.reference.spline.boundary import extend, padding, placed
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.prefilter import padded_coefficients

__all__ = ["lattice"]


def lattice(
    data: ArrayLike,
    axes: Sequence[ArrayLike],
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    orders: Sequence[int] | None = None,
) -> Array:
    """Values, or a partial derivative, at every combination of positions along the axes.

    Parameters
    ----------
    data : array-like
        Samples with any number of axes.
    axes : sequence of array-like
        Positions in samples along each axis of `data`, within half a sample of it.
    filter, boundary : str, Filter, Boundary
        As for `clvol.sample`.
    orders : sequence of {0, 1, 2}, optional
        Order of the derivative along each axis, per sample; 0 by default.

    Returns
    -------
    ndarray of float64, with one value for each combination of positions

    Raises
    ------
    DataError
        Samples that are not finite real numbers.
    OptionError
        Positions outside the domain, a number of axes or orders that does not fit the data, or an unknown name.
    """
    chosen = as_filter(filter)
    shape = np.shape(data)
    orders = [0] * len(shape) if orders is None else orders
    if len(axes) != len(shape) or len(orders) != len(shape):
        raise OptionError(f"axes and orders must be {len(shape)}, one for each axis; got {len(axes)} and {len(orders)}")
    by, margin = chosen.magnified_by, chosen.support + 1
    wide = margin + by.support if by else margin
    width = padding(by or chosen, boundary)
    result = extend(padded_coefficients(data, chosen, boundary), wide, boundary)
    outside = np.zeros((1,) * len(shape), bool)
    for axis, (positions, order, n) in enumerate(zip(axes, orders, shape, strict=True)):
        x = np.asarray(positions, dtype=np.float64)
        if x.ndim != 1 or not ((x >= -0.5) & (x <= n - 0.5)).all():
            raise OptionError(f"positions along an axis of {n} must lie between {-0.5} and {n - 0.5}; got {x}")
        at, constant = placed(x, n, margin, width, boundary)
        matrix = _matrix(n, at, chosen, order, width + wide)
        lines = np.moveaxis(result, axis, 0)
        drawn = matrix @ lines.reshape(lines.shape[0], -1)
        result = np.moveaxis(drawn.reshape(-1, *lines.shape[1:]), 0, axis)
        outside = outside | np.moveaxis(constant.reshape(-1, *[1] * (len(shape) - 1)), 0, axis)
    return np.where(outside, 0.0 if any(orders) else as_boundary(boundary).cval, result)


def _matrix(n: int, x: Array, filter: Filter, order: int, before: int) -> sparse.csr_array:
    """Weights of the coefficients of an axis, `before` of them before the first sample, at positions `x`."""
    if filter.magnified_by is None:
        return _weights(x, filter, order, n, before)
    # a hybrid: the finer samples within reach, each from the coefficients
    scale, by = filter.scale, filter.magnified_by
    reach = before - by.support
    fine = np.arange(-scale * reach, scale * (n + reach)) / scale
    magnified = _weights(fine, by, 0, n, before)
    return sparse.csr_array(_weights(x * scale, filter, order, scale * n, scale * reach) @ magnified * float(scale) ** order)


def _weights(x: Array, filter: Filter, order: int, n: int, margin: int) -> sparse.csr_array:
    """Kernels at all distances within reach, over indices ``-margin`` to ``n + margin - 1``."""
    reach = math.ceil(filter.support / 2)
    index = np.floor(x).astype(np.int64)[:, None] + np.arange(1 - reach, reach + 1)
    values = kernel(filter, x[:, None] - index, order)
    at = np.broadcast_to(np.arange(x.size)[:, None], values.shape)
    used = values != 0
    return sparse.csr_array((values[used], (at[used], index[used] + margin)), shape=(x.size, n + 2 * margin))
