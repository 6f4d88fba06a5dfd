"""Colours as light and as they are shown, by IEC 61966-2-1; and the light that a material reflects of what is shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import Array
from clvol.scene.light import Material

__all__ = ["light_of", "reflected", "shown_as"]


def light_of(color: ArrayLike, linear: bool = True) -> Array:
    """Linear light of sRGB numbers; the numbers themselves if not `linear`."""
    v = np.asarray(color, np.float64)
    return np.where(v <= 0.04045, v / 12.92, (np.maximum(v + 0.055, 0) / 1.055) ** 2.4) if linear else v


def shown_as(light: ArrayLike, linear: bool = True) -> Array:
    """Numbers of sRGB for linear light; the numbers themselves if not `linear`."""
    v = np.asarray(light, np.float64)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 0) ** (1 / 2.4) - 0.055) if linear else v


def reflected(material: Material, linear: bool) -> tuple[float, float]:
    """How much a material reflects without light, and how much more in full light: shown, these are ka and ka + kd."""
    dark, full = (float(light_of(v, linear)) for v in (material.ambient, material.ambient + material.diffuse))
    return dark, full - dark
