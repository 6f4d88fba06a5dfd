"""Colours: three numbers, or a name."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import is_triple, reals
from clvol.base.errors import OptionError
from clvol.base.srgb import as_light

__all__ = ["channel_colors", "color_of", "lab_of"]

Color: TypeAlias = tuple[float, float, float]

_CHANNELS: tuple[Color, ...] = (
    (0.0, 1.0, 0.0),  # green
    (1.0, 0.0, 1.0),  # magenta
    (0.0, 1.0, 1.0),  # cyan
    (1.0, 1.0, 0.0),  # yellow
    (1.0, 0.15, 0.15),  # red
    (0.30, 0.40, 1.0),  # blue
    (1.0, 0.60, 0.0),  # orange
    (1.0, 1.0, 1.0),
)
_APART = 35.0  # smallest distance in CIELAB of a colour of this list to those before it
_LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of red, green and blue, of which further colours are mixed
_LIGHTEST_BLACK = 40.0  # lightness, below which a colour is hardly seen on black
_TO_XYZ = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])  # sRGB, D65
_CUBE = (6 / 29) ** 3


def color_of(what: str, value: Sequence[float] | str) -> tuple[float, float, float]:
    """Red, green and blue, from three numbers or a colour name of the `cmap` package."""
    if isinstance(value, str):
        import cmap

        try:
            rgba = cmap.Color(value)
        except ValueError:
            raise OptionError(f"{what} must be three numbers, or the name or hex code of a colour; got {value!r}") from None
        return float(rgba.rgba.r), float(rgba.rgba.g), float(rgba.rgba.b)
    rule = "three numbers, or the name of a colour"
    rgb = value if is_triple(value) else reals(what, value, rule)
    if np.shape(rgb) != (3,):
        raise OptionError(f"{what} must be {rule}; got {value!r}")
    r, g, b = map(float, rgb)
    if not all(math.isfinite(v) and v >= 0 for v in (r, g, b)):
        raise OptionError(f"{what} must be finite and not negative; got {value!r}")
    return r, g, b


def lab_of(rgb: ArrayLike) -> NDArray[np.float64]:
    """CIELAB coordinates of sRGB colours in 0..1; shape (..., 3)."""
    xyz = as_light(rgb) @ _TO_XYZ.T / _TO_XYZ.sum(1)
    x, y, z = np.moveaxis(np.where(xyz > _CUBE, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def channel_colors(n: int, given: Sequence[Color | None] = ()) -> tuple[Color, ...]:
    """A colour for each of `n` channels: the one given, else one that is distinct from those and from all before it.

    These are green, magenta, cyan, yellow, red, blue, orange and white, without those near to a colour that is given; then the
    colour that is farthest in CIELAB from all others.
    """
    kept = [*given, *[None] * n][:n]
    taken = [lab_of(color) for color in kept if color is not None]
    mixed = np.array([rgb for rgb in itertools.product(_LEVELS, repeat=3) if lab_of(rgb)[0] >= _LIGHTEST_BLACK])
    listed, coordinates = iter(_CHANNELS), lab_of(mixed)

    def distinct() -> Color:
        for color in listed:
            if all(np.linalg.norm(lab_of(color) - other) >= _APART for other in taken):
                return color
        farthest = np.linalg.norm(coordinates[:, None] - np.array(taken), axis=-1).min(1).argmax()
        r, g, b = mixed[farthest].tolist()
        return r, g, b

    result: list[Color] = []
    for color in kept:
        result.append(distinct() if color is None else color)
        if color is None:
            taken.append(lab_of(result[-1]))
    return tuple(result)
