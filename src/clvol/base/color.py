"""Colours: three numbers, or a name."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clvol.base.arrays import reals
from clvol.base.errors import OptionError

__all__ = ["color_of"]


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
    rgb = reals(what, value, rule)
    if rgb.shape != (3,):
        raise OptionError(f"{what} must be {rule}; got {value!r}")
    r, g, b = (float(v) for v in rgb)
    if not all(math.isfinite(v) and v >= 0 for v in (r, g, b)):
        raise OptionError(f"{what} must be finite and not negative; got {value!r}")
    return r, g, b
