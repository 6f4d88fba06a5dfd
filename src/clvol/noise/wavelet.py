"""One level of a wavelet transform, and variances from medians of its bands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["HIGH", "LOW", "MEDIAN_SQUARE", "Array", "bands", "error"]

Array: TypeAlias = NDArray[np.float64]

# Daubechies' extremal phase wavelet with four vanishing moments (Ten Lectures on Wavelets, table 6.1): the low-pass
LOW = np.array(
    [
        0.2303778133088964,
        0.7148465705529154,
        0.6308807679298587,
        -0.0279837694168599,
        -0.1870348117190931,
        0.0308413818355607,
        0.0328830116668852,
        -0.0105974017850690,
    ]
)
HIGH = LOW[::-1] * (-1.0) ** np.arange(len(LOW))
MEDIAN_SQUARE = 0.45493642311957283  # median square of a normal variable with variance 1


def error(count: int) -> float:
    """The relative standard error of a variance from the median of `count` squares of a normal variable."""
    return 2.33 / math.sqrt(count)


def bands(
    blocks: NDArray[np.float32], axes: list[int], filters: Sequence[Array] = (LOW, HIGH)
) -> dict[tuple[int, ...], NDArray[np.float32]]:
    """Filter and decimate blocks by 2 along each axis; a key has the index of the filter along each axis.

    The edges of blocks are left out.
    """
    result: dict[tuple[int, ...], NDArray[np.float32]] = {(): blocks}
    for axis in axes:
        count = (blocks.shape[axis] - len(LOW)) // 2 + 1
        split = {}
        for key, band in result.items():
            shifted = [band[(slice(None),) * axis + (slice(j, j + 2 * count - 1, 2),)] for j in range(len(LOW))]
            for half, taps in enumerate(filters):
                total = np.zeros_like(shifted[0])
                for tap, samples in zip(taps, shifted, strict=True):
                    total += np.float32(tap) * samples
                split[(*key, half)] = total
        result = split
    return result
