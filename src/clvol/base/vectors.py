"""Arithmetic on single vectors of three numbers, for which NumPy's functions take ten times as long; the same to the bit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["cross", "length"]

Vector = NDArray[np.float64]


def cross(one: Vector, other: Vector) -> Vector:
    """The vector product."""
    (a, b, c), (x, y, z) = one.tolist(), other.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def length(vector: Vector) -> float:
    """The Euclidean norm."""
    return math.sqrt(vector.dot(vector))
