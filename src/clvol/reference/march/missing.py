"""Missing samples in pictures: what continues the function to its edge, and where that is, sample by sample."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.filter.filter import Filter
from clvol.reference.spline.points import sample
from clvol.volume.volume import Volume

__all__ = ["continued", "is_missing"]

_WINDOW, _FLATTER = 3, 1e-3


def continued(volume: Volume) -> Volume:
    """The volume with planes, then means, in place of missing samples; as `clvol.volume.missing.extrapolated` describes it."""
    low, high = volume.value_range
    data = np.where(np.isfinite(volume.data), volume.data, np.nan).astype(np.float64)
    for plane in (True, False, False):
        data = _wider(data, plane=plane)
    return Volume(np.where(np.isnan(data), (low + high) / 2, data), volume.spacing, volume.origin, volume.direction)


def _wider(data: Array, *, plane: bool) -> Array:
    """Fit a plane, or a constant, around each sample that is NaN: the constant is the value there."""
    room = np.pad(data, _WINDOW, constant_values=np.nan)
    away = np.array(list(itertools.product(range(-_WINDOW, _WINDOW + 1), repeat=data.ndim)))
    weight = np.sqrt(np.exp(-(away**2).sum(1) / 2))
    result = data.copy()
    for at in zip(*np.nonzero(np.isnan(data)), strict=True):
        around = room[tuple(slice(i, i + 2 * _WINDOW + 1) for i in at)].ravel()
        there = np.isfinite(around)
        if not there.any():
            continue
        total = (weight[there] ** 2).sum()
        if not plane:
            result[at] = (weight[there] ** 2 * around[there]).sum() / total
            continue
        flat = np.sqrt(_FLATTER * total) * np.eye(data.ndim)  # rows that keep slopes small
        rows = np.block([[weight[there, None], weight[there, None] * away[there]], [np.zeros((data.ndim, 1)), flat]])
        middle = around[there].mean()
        right = np.concatenate([weight[there] * (around[there] - middle), np.zeros(data.ndim)])
        result[at] = middle + np.linalg.lstsq(rows, right, rcond=None)[0][0]
    return result


def is_missing(volume: Volume, points: Array, filter: Filter) -> NDArray[np.bool_]:
    """Whether places of the world are missing: their linearly interpolated mask is over 1/2, or their sample missing."""
    mask = Volume((~np.isfinite(volume.data)).astype(np.float64), volume.spacing, volume.origin, volume.direction)
    return np.asarray(sample(mask, points, "nearest" if filter.support == 1 else "linear", "reflect") > 0.5)
