"""Shared by the tests: volumes and points, and tables of arguments that must be rejected."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
import pytest

from clvol.filter.boundary import boundaries
from clvol.filter.table import as_filter
from clvol.march.renderer import Renderer, render
from clvol.scene.mode import modes

__all__ = [
    "BAD_COUNTS",
    "BAD_DATA",
    "BAD_FILTERS",
    "BAD_FILTER_LISTS",
    "BAD_NUMBERS",
    "BAD_REALS",
    "BAD_VECTORS",
    "BAD_WHOLE",
    "DEGREES",
    "MODES",
    "OBLIQUE",
    "RMSE",
    "RULES",
    "SMOOTHED",
    "every",
    "examples",
    "rotation",
]

MODES: Final = [name for name, mode in modes().items() if not mode.regions]
"""Those that draw any volume; the regions of labels are tested in march/test_regions.py."""

MASKED: Final = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])

# -- rejected arguments ------------------------------------------------------------------------------

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
    np.ma.array([[1, 2]], mask=[[False, True]]),
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


def examples(count: int) -> int:
    """A sixth of hypothesis's examples, or all in `make thorough`."""
    return count if os.environ.get("CLVOL_TEST_THOROUGH") else max(4, count // 6)


def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures have 48 × 48 pixels where no size is given: programs that are run for their words say none."""
    for draw in (render, Renderer.render):
        sizes = [(48, 48) if given == (512, 512) else given for given in draw.__defaults__ or ()]
        assert (48, 48) in sizes
        monkeypatch.setattr(draw, "__defaults__", tuple(sizes))


def rotation(d: int = 3, seed: int = 0) -> np.ndarray:
    """A random orthogonal matrix."""
    return np.asarray(np.linalg.qr(np.random.default_rng(seed).normal(size=(d, d)))[0])


OBLIQUE: Final = rotation()

SMOOTHED: Final = ("bspline2(0.02)", "bspline3(0.1)", "bspline5(2)")
"""Smoothing splines, with real poles, complex ones, and both."""

RULES: Final = tuple(f"{name}(0.4)" if row.outside in ("constant", "grid-constant") else name for name, row in boundaries().items())
"""Every boundary rule, with a value outside that shows."""

# -- what is known ---------------------------------------------------------------------------------

# of Marschner-Lobb 41³ at 200 000 random points in [-0.8, 0.8]³, computed in float64 before clvol was written
RMSE = {
    "nearest": 0.0467,
    "bspline3-approx": 0.0439,
    "linear": 0.0315,
    "mitchell": 0.0282,
    "catmull-rom": 0.0218,
    "bspline2": 0.0169,
    "bspline3": 0.0131,
    "bspline4": 0.0099,
    "bspline5": 0.0081,
}
DEGREES = {"bspline3": 9.9, "bspline3-approx": 18.0, "mitchell": 18.2, "catmull-rom": 19.7}
