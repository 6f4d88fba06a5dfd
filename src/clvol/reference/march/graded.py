"""Opacity by more than the value: the gradient there, and how the isosurface bends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates

from clvol.base.arrays import Array
from clvol.scene.joint import TransferFunction2D
from clvol.scene.transfer import TransferFunction

__all__ = ["graded", "shape_operator"]


def graded(
    transfer: TransferFunction,
    values: Array,
    gradient: Callable[[], Array],
    hessian: Callable[[], Array],
    *,
    light: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """Colours, (N, 3), as `light`, and opacities, (N,), with all that they depend on; derivatives of values are per world unit."""
    shades = transfer(values)
    rgb, alpha = light(shades[:, :3]), shades[:, 3]
    if not transfer.graded or not values.size:
        return rgb, alpha
    slope = gradient()
    steep = np.linalg.norm(slope, axis=-1)
    if isinstance(transfer, TransferFunction2D):
        image = transfer.nodes
        low, high = image.values
        place = np.stack([steep / image.steepest, (values - low) / (high - low)])
        at = np.clip(place, 0, 1) * (np.array(image.shape) - 1)[:, None]
        opaque = image.array[..., 3:].astype(np.float64)
        weighted = np.concatenate([light(image.array[..., :3].astype(np.float64)) * opaque, opaque], -1)
        mixed = np.stack([map_coordinates(channel, at, order=1, mode="nearest") for channel in np.moveaxis(weighted, -1, 0)], -1)
        seen = (alpha > 0) & (mixed[:, 3] > 0)
        alpha = np.where(seen, mixed[:, 3], 0.0)
        rgb = np.divide(mixed[:, :3], alpha[:, None], out=np.zeros_like(rgb), where=seen[:, None])
    if transfer.gradient_opacity is not None:
        alpha = alpha * np.interp(steep, *np.array(transfer.gradient_opacity).T)
    if transfer.curvature_opacity is not None:
        bends = np.abs(np.linalg.eigvalsh(shape_operator(slope, hessian())[0])).max(-1)  # with 0 along the normal
        alpha = alpha * np.interp(bends, *np.array(transfer.curvature_opacity).T)
    return rgb, alpha


def shape_operator(gradient: Array, hessian: Array) -> tuple[Array, Array]:
    """-P H P / |∇f|, with P the projection on the tangent plane, (N, 3, 3); and the unit gradient, (N, 3)."""
    length = np.linalg.norm(gradient, axis=1)
    normal = gradient / length[:, None]
    tangent = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    return -tangent @ hessian @ tangent / length[:, None, None], normal
