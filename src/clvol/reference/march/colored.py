"""Colours by another function in float64, by the documentation of `clvol.Medium`."""

from __future__ import annotations

import numpy as np

from clvol.base.arrays import Array
from clvol.filter.table import as_filter
from clvol.reference.march.light import light_of
from clvol.reference.march.missing import continued, is_missing
from clvol.reference.spline.points import sample
from clvol.scene.scene import Medium

__all__ = ["colored"]


def colored(other: Medium, points: Array, rgb: Array, *, linear: bool = False) -> Array:
    """Colours at places of the world, those of a medium's own in `rgb`, where another with a filter and a transfer function covers
    them: as far as that is opaque, inside of its domain and where its samples are not missing. With `linear`, colours are light.
    """
    assert other.filter is not None
    assert other.transfer is not None
    volume, row, rule = other.volume, as_filter(other.filter), other.boundary if other.boundary.edge else "mirror"
    some_missing = not np.isfinite(volume.data).all()
    index, (low, high) = volume.world_to_index(points), other.domain
    inside = np.asarray(((index >= low) & (index <= high)).all(-1))
    if some_missing:
        inside[inside] = ~is_missing(volume, points[inside], row)
    shown = other.transfer(sample(continued(volume) if some_missing else volume, points[inside], row, rule))
    result = rgb.copy()
    result[inside] += shown[:, 3:] * (light_of(shown[:, :3], linear) - rgb[inside])
    return result
