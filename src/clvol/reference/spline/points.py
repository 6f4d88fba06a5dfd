"""The reconstructed function and its derivatives anywhere, directly by eq. (8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import Array
from clvol.base.errors import OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.reference.spline.boundary import extend, padding, placed
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.prefilter import padded_coefficients
from clvol.volume.volume import Volume, as_volume

__all__ = ["magnify", "resample", "sample"]

_CHUNK = 1 << 21  # products in memory at a time


def sample(
    volume: Volume | ArrayLike,
    points: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    derivative: int = 0,
) -> Array:
    """The reconstructed function, its gradient or its Hessian at points of the world.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    points : array-like, shape (..., d)
        World positions (x, y(, z)), inside or outside the domain; NaN if a position is not finite.
    filter, boundary : str, Filter, Boundary
        As for `clvol.sample`. A hybrid (section 4.3) is the magnified volume, continued by the boundary rule,
        reconstructed by its second kernel.
    derivative : {0, 1, 2}
        0: values; 1: gradients; 2: Hessians, per world unit.

    Returns
    -------
    ndarray of float64, shape (...), (..., d) or (..., d, d)
    """
    volume, chosen = as_volume(volume), as_filter(filter)
    if derivative not in (0, 1, 2):
        raise OptionError(f"derivative must be 0, 1 or 2; got {derivative!r}")
    d = volume.ndim
    with np.errstate(invalid="ignore"):  # an infinite position has no index
        index = volume.world_to_index(points)
    flat = index.reshape(-1, d)
    finite = np.isfinite(flat).all(-1)
    result = np.full((flat.shape[0], d**derivative), np.nan)
    if finite.any():
        result[finite] = _at_indices(volume.data, flat[finite], chosen, boundary, derivative)
    w = volume.world_to_index_matrix  # index_j = sum over i of w[j, i] world_i
    shaped = result.reshape(index.shape[:-1] + (d,) * derivative)
    if derivative == 1:
        return np.asarray(np.einsum("ji,...j->...i", w, shaped))
    if derivative == 2:
        return np.asarray(np.einsum("ji,lk,...jl->...ik", w, w, shaped))
    return shaped


def resample(
    volume: Volume | ArrayLike,
    shape: Sequence[int] | None = None,
    spacing: Sequence[float] | float | None = None,
    like: Volume | None = None,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
) -> Volume:
    """The volume on another grid: `shape` or `spacing` over the same domain, or the grid of `like`."""
    volume = as_volume(volume)
    if sum(v is not None for v in (shape, spacing, like)) != 1:
        raise OptionError("resample takes exactly one of shape, spacing and like")
    if like is None:
        step = np.array(volume.spacing)
        extent = step * volume.size
        if shape is not None:
            size = np.array(shape[::-1])
            step = extent / size
        else:
            step = np.broadcast_to(np.asarray(spacing, dtype=np.float64), step.shape)
            size = np.maximum(1, np.round(extent / step)).astype(int)
        # the first sample is half a new voxel inside the domain's corner; the grids' centres coincide
        middle = volume.index_to_world((np.array(volume.size) - 1) / 2)
        origin = middle - volume.direction @ ((size - 1) / 2 * step)
        like = Volume(np.zeros(tuple(size[::-1])), tuple(step), tuple(origin), volume.direction, volume.units)
    indices = np.stack(np.meshgrid(*(np.arange(n) for n in like.shape), indexing="ij"), -1)[..., ::-1]
    data = sample(volume, like.index_to_world(indices), filter, boundary)
    return Volume(data, like.spacing, like.origin, like.direction, like.units or volume.units)


def magnify(
    volume: Volume | ArrayLike, factor: int = 2, filter: str | Filter = DEFAULT_FILTER, boundary: str | Boundary = DEFAULT_BOUNDARY
) -> Volume:
    """The volume with `factor` times the samples along each axis; sample j lies at j / factor (section 4.3)."""
    volume = as_volume(volume)
    if isinstance(factor, bool) or not isinstance(factor, (int, np.integer)) or factor < 1:
        raise OptionError(f"factor must be a whole number of at least 1; got {factor!r}")
    fine = Volume(
        np.zeros(tuple(factor * n for n in volume.shape)),
        tuple(s / factor for s in volume.spacing),
        volume.origin,
        volume.direction,
        volume.units,
    )
    return resample(volume, like=fine, filter=filter, boundary=boundary)


def _at_indices(data: NDArray[np.generic], index: Array, filter: Filter, boundary: str | Boundary, derivative: int) -> Array:
    """Derivatives per sample at finite index positions of shape (N, d), x first."""
    d, scale = data.ndim, filter.scale
    by = filter.magnified_by
    margin = math.ceil(filter.support / 2 / scale + (by.support / 2 if by else 0)) + 2
    width = padding(by or filter, boundary)
    past = (by or filter).support // 2 + 1
    axes = [placed(index[:, j], n, past, width, boundary) for j, n in enumerate(data.shape[::-1])]
    near, constant = (np.stack(parts, -1) for parts in zip(*axes, strict=True))
    coefficients = padded_coefficients(data, filter, boundary)
    widths = [
        (math.ceil(max(0.0, margin - width - x.min())), math.ceil(max(0.0, x.max() + margin - n - width + 1)))
        for x, n in zip(near.T, data.shape[::-1], strict=True)
    ][::-1]
    stored = extend(coefficients, widths, boundary)
    first = np.array([-width - before for before, _ in widths])  # index of the first stored coefficient, z first
    if by:
        for axis in range(d):
            stored = _refine(stored, axis, by, scale)
        first = first * scale
    result = _blend(stored, first, near[:, ::-1] * scale, filter, derivative) * float(scale) ** derivative
    result[constant.any(-1)] = as_boundary(boundary).cval if derivative == 0 else 0
    return result


def _refine(coefficients: Array, axis: int, by: Filter, scale: int) -> Array:
    """Values of eq. (8) at steps of ``1 / scale`` samples along one axis."""
    n = coefficients.shape[axis]
    fine = np.arange(scale * (n - 1) + 1) / scale
    basis = kernel(by, fine[:, None] - np.arange(n))
    return np.moveaxis(np.tensordot(basis, coefficients, (1, axis)), 0, axis)


def _blend(stored: Array, first: NDArray[np.int64], at: Array, filter: Filter, derivative: int) -> Array:
    """Eq. (8), a product for each axis: sums of coefficients times kernels at all distances within reach.

    `at` is z first; results are x first.
    """
    d = stored.ndim
    reach = math.ceil(filter.support / 2)
    offsets = np.arange(1 - reach, reach + 1)  # all within reach of a position above 0 and below 1, or at 0
    axes = "zyx"[-d:]
    orders = {
        0: [(0,) * d],
        1: [tuple(int(i == a) for i in range(d)) for a in reversed(range(d))],
        2: [tuple(int(i == a) + int(i == b) for i in range(d)) for a in reversed(range(d)) for b in reversed(range(d))],
    }[derivative]
    result = np.empty((at.shape[0], len(orders)))
    step = max(1, _CHUNK // offsets.size**d)
    for begin in range(0, at.shape[0], step):
        part = at[begin : begin + step]
        index = np.floor(part).astype(np.int64)[:, :, None] + offsets  # (N, d, offsets)
        weights = [kernel(filter, part[:, :, None] - index, m) for m in range(derivative + 1)]
        place = np.clip(index - first[:, None], 0, np.array(stored.shape)[:, None] - 1)  # clipped ones have weight 0
        grids = [place[:, a].reshape(-1, *(offsets.size if i == a else 1 for i in range(d))) for a in range(d)]
        block = stored[tuple(grids)]
        for column, order in enumerate(orders):
            terms = block
            for a in reversed(range(d)):
                terms = np.einsum(f"n{axes[: a + 1]},n{axes[a]}->n{axes[:a]}", terms, weights[order[a]][:, a])
            result[begin : begin + step, column] = terms
    return result
