"""Numbers of colours as they are shown, in sRGB, and as light, in which what is computed with light is right; one over another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["as_light", "as_shown", "on", "over"]


def as_light(shown: ArrayLike) -> NDArray[np.float64]:
    """The light of numbers of sRGB, each for itself (IEC 61966-2-1); 0 and 1 stay."""
    given = np.asarray(shown, dtype=np.float64)
    return np.where(given > 0.04045, ((np.maximum(given, 0.0) + 0.055) / 1.055) ** 2.4, given / 12.92)


def as_shown(light: ArrayLike) -> NDArray[np.float64]:
    """The inverse of `as_light`."""
    given = np.asarray(light, dtype=np.float64)
    return np.where(given > 0.0031308, 1.055 * np.maximum(given, 0.0) ** (1 / 2.4) - 0.055, 12.92 * given)


def on(background: tuple[float, float, float] | None, picture: NDArray[np.float32], *, linear: bool = False) -> NDArray[np.float32]:
    """A picture over its background."""
    if background is None:
        return picture
    ground = np.empty_like(picture)
    ground[...] = (*np.clip(background, 0, 1), 1)
    return over(picture, ground, linear=linear)


def over(top: NDArray[np.float32], below: NDArray[np.float32], *, linear: bool = False) -> NDArray[np.float32]:
    """One picture over another, neither premultiplied; where nothing is on top, it is the lower one to the bit.

    `linear`: their colours mix in linear light.
    """
    upper, lower = (as_light(colors) if linear else colors for colors in (top[..., :3], below[..., :3]))
    share = top[..., 3:]
    rest = (1 - share) * below[..., 3:]
    opacity = share + rest
    with np.errstate(invalid="ignore", divide="ignore"):
        colors = (upper * share + lower * rest) / opacity
    colors = np.where(opacity > 0, colors, 0)
    made = np.concatenate([as_shown(colors) if linear else colors, opacity], -1).astype(np.float32)
    return np.asarray(np.where(share > 0, made, below))
