"""The reconstructed function on a grid: eq. (8) an axis at a time, where `sample` goes point by point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from clvol.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.errors import OptionError
from clvol.filter import DEFAULT_FILTER, Filter, as_filter
from clvol.reference.spline.boundary import extend
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.prefilter import prefilter

__all__ = ["lattice"]

Array: TypeAlias = NDArray[np.float64]


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
        Samples, of any number of axes.
    axes : sequence of array-like
        Positions in samples along each axis of `data`, within half a sample of it.
    filter, boundary : str, Filter, Boundary
        As for `clvol.sample`.
    orders : sequence of {0, 1, 2}, optional
        Of the derivative along each axis, per sample; 0 by default.

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
    result = prefilter(data, chosen, boundary)
    orders = [0] * result.ndim if orders is None else orders
    if len(axes) != result.ndim or len(orders) != result.ndim:
        raise OptionError(f"axes and orders must be {result.ndim}, one for each axis; got {len(axes)} and {len(orders)}")
    for axis, (positions, order) in enumerate(zip(axes, orders, strict=True)):
        lines = np.moveaxis(result, axis, 0)
        matrix = _matrix(lines.shape[0], np.asarray(positions, dtype=np.float64), chosen, boundary, order)
        drawn = matrix @ lines.reshape(lines.shape[0], -1)
        result = np.moveaxis(drawn.reshape(-1, *lines.shape[1:]), 0, axis)
    return np.ascontiguousarray(result)


def _matrix(n: int, x: Array, filter: Filter, boundary: str | Boundary, order: int) -> sparse.csr_array:
    """Weights of the coefficients of an axis at positions `x`; shape (x.size, n)."""
    if x.ndim != 1 or not ((x >= -0.5) & (x <= n - 0.5)).all():
        raise OptionError(f"positions along an axis of {n} must lie between {-0.5} and {n - 0.5}; got {x}")
    margin = filter.support + 1
    if filter.magnified_by is None:
        return sparse.csr_array(_weights(x, filter, order, n, margin) @ _continued(n, margin, boundary))
    # a hybrid: the finer samples within reach, each from the coefficients
    by, scale = filter.magnified_by, filter.scale
    fine = np.arange(-scale * margin, scale * (n + margin)) / scale
    wider = margin + by.support
    magnified = _weights(fine, by, 0, n, wider) @ _continued(n, wider, boundary)
    drawn = _weights(x * scale, filter, order, scale * n, scale * margin) * float(scale) ** order
    return sparse.csr_array(drawn @ magnified)


def _weights(x: Array, filter: Filter, order: int, n: int, margin: int) -> sparse.csr_array:
    """Kernels at all distances within reach, over indices ``-margin`` to ``n + margin - 1``."""
    reach = math.ceil(filter.support / 2)
    index = np.floor(x).astype(np.int64)[:, None] + np.arange(1 - reach, reach + 1)
    values = kernel(filter, x[:, None] - index, order)
    at = np.broadcast_to(np.arange(x.size)[:, None], values.shape)
    used = values != 0
    return sparse.csr_array((values[used], (at[used], index[used] + margin)), shape=(x.size, n + 2 * margin))


def _continued(n: int, margin: int, boundary: str | Boundary) -> sparse.csr_array:
    """Which coefficient stands at each index from ``-margin`` to ``n + margin - 1``."""
    stands = extend(np.arange(1, n + 1), margin, boundary) - 1  # -1: none
    known = np.flatnonzero(stands >= 0)
    return sparse.csr_array((np.ones(known.size), (known, stands[known])), shape=(stands.size, n))
