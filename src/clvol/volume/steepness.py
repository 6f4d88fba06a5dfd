"""How steep samples are, by differences of their neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["steepness_at"]


def steepness_at(
    data: NDArray[np.generic], places: Sequence[NDArray[np.intp]], to_index: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Magnitudes of gradients per world unit, at the samples whose indices along each axis of `data` are `places`.

    `to_index` is the matrix from the world to indices, (x, y, z).
    """
    ends = [(np.maximum(at - 1, 0), np.minimum(at + 1, n - 1)) for at, n in zip(places, data.shape, strict=True)]
    slopes = np.zeros((data.ndim, *map(len, places)))
    for axis, (before, after) in enumerate(ends):
        one, other = (data[np.ix_(*places[:axis], at, *places[axis + 1 :])].astype(np.float64) for at in (before, after))
        apart = np.maximum(after - before, 1).reshape(-1, *[1] * (data.ndim - 1 - axis))
        slopes[data.ndim - 1 - axis] = (other - one) / apart
    largest = float(np.max(np.abs(slopes), initial=0.0, where=np.isfinite(slopes))) or 1.0
    return np.asarray(largest * np.sqrt((np.tensordot(to_index.T, slopes / largest, 1) ** 2).sum(0)))
