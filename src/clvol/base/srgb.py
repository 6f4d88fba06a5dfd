"""Numbers of colours as they are shown, in sRGB, and as light, in which what is computed with light is right."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["as_light", "as_shown"]


def as_light(shown: ArrayLike) -> NDArray[np.float64]:
    """The light of numbers of sRGB, each for itself (IEC 61966-2-1); 0 and 1 stay."""
    given = np.asarray(shown, dtype=np.float64)
    return np.where(given > 0.04045, ((np.maximum(given, 0.0) + 0.055) / 1.055) ** 2.4, given / 12.92)


def as_shown(light: ArrayLike) -> NDArray[np.float64]:
    """The inverse of `as_light`."""
    given = np.asarray(light, dtype=np.float64)
    return np.where(given > 0.0031308, 1.055 * np.maximum(given, 0.0) ** (1 / 2.4) - 0.055, 12.92 * given)
