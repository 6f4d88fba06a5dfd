"""Labels with smooth boundaries: the indicator of every label resampled on its own, and the largest taken."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import Array
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.reference.spline.points import sample
from clvol.volume.volume import Volume, as_volume

__all__ = ["labels_at", "lead_gradient"]


def labels_at(
    volume: Volume | ArrayLike, points: ArrayLike, filter: str = "bspline5-approx", boundary: str = DEFAULT_BOUNDARY
) -> tuple[NDArray[Any], Array]:
    """The label at points of the world, and by how much its weight exceeds the next one's.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D labels.
    points : array-like, shape (..., d)
    filter, boundary : str
        As for `clvol.resample` with ``smooth=True``.

    Returns
    -------
    ndarray of the volume's dtype, ndarray of float64, shape (...)
    """
    labels, weights = _weights(as_volume(volume), points, filter, boundary)
    ordered = np.sort(np.concatenate([weights, np.zeros_like(weights[:1])]), axis=0)
    return labels[weights.argmax(0)].astype(as_volume(volume).data.dtype), ordered[-1] - ordered[-2]


def lead_gradient(
    volume: Volume | ArrayLike, points: ArrayLike, filter: str = "bspline5-approx", boundary: str = DEFAULT_BOUNDARY
) -> Array:
    """The gradient, per world unit, of by how much the largest weight at points exceeds the next one; shape (..., d)."""
    _, weights = _weights(as_volume(volume), points, filter, boundary)
    _, slopes = _weights(as_volume(volume), points, filter, boundary, 1)
    first, second = np.argsort(-weights, axis=0, kind="stable")[:2, ..., None]
    chosen = (np.take_along_axis(slopes, which[None], axis=0)[0] for which in (first, second))
    return np.asarray(np.subtract(*chosen))


def _weights(volume: Volume, points: ArrayLike, filter: str, boundary: str, derivative: int = 0) -> tuple[NDArray[Any], Array]:
    """The labels in ascending order, and the weight of each at points, or its derivative."""
    rule = as_boundary(boundary)
    outside = rule if rule.period is not None else as_boundary("grid-constant")  # zeros outside are samples of label 0
    labels = np.union1d(volume.data, [rule.cval] if outside.name.startswith(("constant", "grid-constant")) else [])
    weights = [
        sample(
            replace(volume, data=(volume.data == label).astype(np.float64), labels=None),
            points,
            filter,
            replace(outside, cval=float(label == rule.cval)),
            derivative,
        )
        for label in labels
    ]
    return labels, np.stack(weights)
