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

__all__ = ["labels_at"]


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
    volume, rule = as_volume(volume), as_boundary(boundary)
    outside = rule if rule.period is not None else as_boundary("grid-constant")  # zeros outside are samples of label 0
    labels = np.union1d(volume.data, [rule.cval] if outside.name.startswith(("constant", "grid-constant")) else [])
    weights = np.stack(
        [
            sample(
                replace(volume, data=(volume.data == label).astype(np.float64), labels=None),
                points,
                filter,
                replace(outside, cval=float(label == rule.cval)),
            )
            for label in labels
        ]
    )
    ordered = np.sort(np.concatenate([weights, np.zeros_like(weights[:1])]), axis=0)
    return labels[weights.argmax(0)].astype(volume.data.dtype), ordered[-1] - ordered[-2]
