"""Labels with smooth boundaries: the indicator of every label resampled on its own, and the largest taken."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import Array
from clvol.filter.boundary import REGION_BOUNDARY, Boundary, as_boundary
from clvol.reference.spline.points import sample
from clvol.volume.volume import Volume, as_volume

__all__ = ["labels_at", "labels_between", "lead_gradient"]


def labels_at(
    volume: Volume | ArrayLike, points: ArrayLike, filter: str = "bspline5-approx", boundary: str = REGION_BOUNDARY
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
    volume: Volume | ArrayLike, points: ArrayLike, filter: str = "bspline5-approx", boundary: str = REGION_BOUNDARY
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
    labels = np.union1d(volume.data, [rule.cval] if rule.name.startswith(("constant", "grid-constant")) else [])
    return labels, np.stack([_indicator(volume, label, points, filter, rule, derivative) for label in labels])


def labels_between(
    volume: Volume | ArrayLike,
    points: ArrayLike,
    pairs: ArrayLike,
    filter: str = "bspline5-approx",
    boundary: str = REGION_BOUNDARY,
) -> tuple[Array, Array]:
    """By how much one label's weight exceeds another's at points of the world, and the gradient of this per world unit.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D labels.
    points : array-like, shape (n, d)
    pairs : array-like, shape (n, 2)
        The two labels at each point.
    filter, boundary : str
        As for `clvol.resample` with ``smooth=True``.

    Returns
    -------
    ndarray of float64, shape (n,), ndarray of float64, shape (n, d)
    """
    volume, rule, places, both = as_volume(volume), as_boundary(boundary), np.asarray(points, np.float64), np.asarray(pairs)
    values, slopes = np.zeros(len(places)), np.zeros(places.shape)
    for label in np.unique(both):
        for column, sign in ((0, 1), (1, -1)):
            here = both[:, column] == label
            values[here] += sign * _indicator(volume, label, places[here], filter, rule, 0)
            slopes[here] += sign * _indicator(volume, label, places[here], filter, rule, 1)
    return values, slopes


def _indicator(volume: Volume, label: float, points: ArrayLike, filter: str, rule: Boundary, derivative: int) -> Array:
    """The weight of a label, or its gradient."""
    outside = rule if rule.period is not None else as_boundary("grid-constant")  # zeros outside are samples of label 0
    data = (volume.data == label).astype(np.float64)
    return sample(
        replace(volume, data=data, labels=None), points, filter, replace(outside, cval=float(label == rule.cval)), derivative
    )
