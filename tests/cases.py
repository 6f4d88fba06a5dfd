"""What tests share: volumes and points to compute with, and the tables of what must be refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
import pytest

from clvol.filter import as_filter
from clvol.volume import Volume

__all__ = [
    "BAD_COUNTS",
    "BAD_DATA",
    "BAD_FILTERS",
    "BAD_FILTER_LISTS",
    "BAD_NUMBERS",
    "BAD_REALS",
    "BAD_VECTORS",
    "BAD_WHOLE",
    "OBLIQUE",
    "every",
    "points_within",
    "random_volume",
    "rotation",
]

MASKED: Final = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])

# -- what is refused ------------------------------------------------------------------------------

BAD_WHOLE: Final[tuple[Any, ...]] = ("a", "8", None, True, 2.5, 2.0, 1j, np.nan, np.inf, [2], (2, 2), np.array([2, 3]))
"""No whole number, whatever its bounds."""

BAD_COUNTS: Final[tuple[Any, ...]] = (0, -4, *BAD_WHOLE)
"""No whole number of at least 1."""

BAD_NUMBERS: Final[tuple[Any, ...]] = ("a", "1", None, True, 1j, np.nan, np.inf, -np.inf, 10**400, [1.0], (1.0, 2.0))
"""No finite real number."""

BAD_REALS: Final[tuple[Any, ...]] = ("a", None, ["1", "2", "3"], [1j, 2, 3], [[1], [1, 2]], [1, None, 3], MASKED, [10**400, 1, 2])
"""No array of real numbers, whatever its shape."""

BAD_VECTORS: Final[tuple[Any, ...]] = (*BAD_REALS, 3.0, (1, 2), (1, 2, 3, 4), "123", (1, np.nan, 2), (np.inf, 0, 0))
"""No three finite numbers."""

BAD_DATA: Final[tuple[Any, ...]] = (
    3.0,
    [1.0],
    None,
    "ab",
    [["a"]],
    [["1", "2"]],
    [[1j]],
    [[1], [1, 2]],
    [[10**400, 1]],
    np.array([[1, None]]),
    np.ma.array([[1, 2]], mask=[[0, 1]]),
    np.zeros((2, 2), "V4"),
    np.ones((0, 3)),
    np.ones((1, 1, 1, 1)),
)
"""No samples of a volume or image."""

BAD_FILTERS: Final[tuple[Any, ...]] = ("", "none", "bspline3.0", "sinc(0)", "bc(1)", 3, None, ["linear"])
"""No filter and no name of one."""

BAD_FILTER_LISTS: Final[tuple[Any, ...]] = ("linear", 5, None, (), [], as_filter("linear"))
"""Not one or more filters; a bare name or filter is not taken for a list of it."""


def every(**calls: tuple[Callable[[Any], object], Iterable[Any]]) -> list[Any]:
    """Parameters (call, bad): each of the calls with each of its bad values, named after both.

    >>> @pytest.mark.parametrize(("call", "bad"), every(fov=(lambda v: Camera(fov=v), BAD_NUMBERS)))
    """
    return [pytest.param(call, bad, id=f"{name}={bad!r:.40}") for name, (call, values) in calls.items() for bad in values]


# -- what is computed with ------------------------------------------------------------------------


def rotation(d: int = 3, seed: int = 0) -> np.ndarray:
    """A random orthogonal matrix."""
    return np.asarray(np.linalg.qr(np.random.default_rng(seed).normal(size=(d, d)))[0])


OBLIQUE: Final = rotation()


def random_volume(shape: tuple[int, ...] = (5, 6, 7), seed: int = 0) -> Volume:
    """Noise on an oblique, anisotropic grid away from the origin."""
    d = len(shape)
    return Volume(
        np.random.default_rng(seed).normal(size=shape).astype(np.float32),
        (0.5, 1.5, 2.0)[:d],
        (1.0, -2.0, 3.0)[:d],
        rotation(d, seed),
        "mm",
    )


def points_within(volume: Volume, count: int = 50, seed: int = 1) -> np.ndarray:
    """Random world positions within the volume's samples."""
    index = np.random.default_rng(seed).uniform(0, 1, (count, volume.ndim)) * (np.asarray(volume.size) - 1)
    return volume.index_to_world(index)
