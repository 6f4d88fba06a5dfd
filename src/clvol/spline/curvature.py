"""Principal curvatures of isosurfaces, from first and second derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["principal_curvatures"]


def principal_curvatures(gradients: NDArray[np.float64], hessians: NDArray[np.float64]) -> NDArray[np.float64]:
    """Principal curvatures κ₁ ≥ κ₂ of the isosurfaces through points, per world unit.

    They are the eigenvalues of -H / |∇f| on the tangent plane, H the Hessian: positive where the surface bends away from lower
    values, as that of a ball of high values does (1 / radius). Their mean and product are the mean and the Gaussian curvature.

    Parameters
    ----------
    gradients : ndarray, shape (n, 3)
    hessians : ndarray, shape (n, 3, 3)

    Returns
    -------
    ndarray, shape (n, 2)
        NaN where the gradient is zero, or a derivative is not finite.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.linalg.norm(gradients, axis=1)
        normal = gradients / length[:, None]
        axis = np.eye(3)[np.abs(normal).argmin(1)]  # the furthest from the normal
        first = np.cross(normal, axis)
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(normal, first)
        a, b, c = (
            np.einsum("ni,nij,nj->n", u, hessians, v) / -length for u, v in ((first, first), (first, second), (second, second))
        )
        middle, apart = (a + c) / 2, np.hypot((a - c) / 2, b)
        return np.stack([middle + apart, middle - apart], axis=1)
