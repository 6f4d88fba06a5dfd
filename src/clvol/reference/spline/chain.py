"""A chain of transforms at points, and its Jacobian: every spline as a sum over its whole grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import Array
from clvol.reference.spline.boundary import extend
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.prefilter import prefilter
from clvol.volume.transform import AffineTransform, BSplineTransform, DisplacementField, as_chain

__all__ = ["map_points"]


def map_points(points: ArrayLike, transform: Any) -> tuple[Array, Array]:
    """Map points from the fixed to the moving world; also returns the derivative of the moving by the fixed positions.

    Parameters
    ----------
    points : array-like, shape (..., d)
        World positions (x, y(, z)).
    transform
        As of `clvol.Field.resample`: the last of a list is applied first.

    Returns
    -------
    ndarray of float64, shapes (..., d) and (..., d, d)
        The Jacobian is [component, with respect to].
    """
    given = np.asarray(points, dtype=np.float64)
    d = given.shape[-1]
    places = given.reshape(-1, d).copy()
    jacobian = np.tile(np.eye(d), (len(places), 1, 1))
    for one in reversed(as_chain(transform, d)):
        if isinstance(one, AffineTransform):
            places, jacobian = places @ one.matrix.T + one.offset, one.matrix @ jacobian
        else:
            shift, slopes = _displacement(one, places)
            places, jacobian = places + shift, jacobian + slopes @ jacobian
    return places.reshape(given.shape), jacobian.reshape(*given.shape, d)


def _displacement(one: DisplacementField | BSplineTransform, places: Array) -> tuple[Array, Array]:
    """A displacement and its derivatives, [point, component, with respect to]; both are 0 outside the grid's domain."""
    d, size = one.ndim, np.asarray(one.grid.size)
    index = one.grid.world_to_index(places)
    if isinstance(one, BSplineTransform):
        coefficients = np.asarray(one.coefficients, dtype=np.float64)
        margin, halo = (one.filter.support - 2) / 2, 0
    else:
        margin, halo = -0.5, 4
        parts = np.moveaxis(np.asarray(one.displacements, dtype=np.float64), -1, 0)
        if one.filter.name == "linear":
            parts = np.pad(parts, [(0, 0)] + [(halo, halo)] * d, mode="edge")
        else:
            parts = np.stack([extend(prefilter(part, one.filter, "mirror"), halo, "mirror") for part in parts])
        coefficients = np.moveaxis(parts, 0, -1)
    inside = np.asarray(((index >= margin) & (index <= size - 1 - margin)).all(axis=-1))
    basis = [
        [kernel(one.filter, index[:, [axis]] + halo - np.arange(coefficients.shape[d - 1 - axis]), order) for order in (0, 1)]
        for axis in range(d)
    ]  # x first

    def total(*orders: int) -> Array:
        sums = coefficients
        sums = np.einsum("nx,...xc->n...c", basis[0][orders[0]], sums)
        sums = np.einsum("ny,n...yc->n...c", basis[1][orders[1]], sums)
        return np.asarray(sums if d == 2 else np.einsum("nz,nzc->nc", basis[2][orders[2]], sums))

    shift = np.where(inside[:, None], total(*[0] * d), 0.0)
    by_index = np.stack([total(*[int(axis == other) for other in range(d)]) for axis in range(d)], axis=-1)
    return shift, np.where(inside[:, None, None], by_index @ one.grid.world_to_index_matrix, 0.0)
