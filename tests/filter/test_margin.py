"""The reach of a prefilter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

import clvol
from clvol.base.errors import OptionError
from clvol.filter.boundary import as_boundary
from clvol.filter.filter import Filter
from clvol.filter.margin import LEFT_OUT, reach
from clvol.filter.table import as_filter

NAMES = (*(name for name, row in clvol.filters().items() if row.settled), "bspline3(0.1)", "bspline3(0.5)", "bspline3(20)")


def weights(row: Filter, n: int = 401) -> np.ndarray:
    """The prefilter's magnitudes at distances 0, 1, 2, ...: the middle column of the inverse of eq. (11)."""
    matrix = as_boundary("wrap").matrix(row.undone, n)
    return np.abs(linalg.inv(matrix)[n // 2, n // 2 :])


@pytest.mark.parametrize("precision", LEFT_OUT)
@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_shortest_within_the_tolerance(name: str, precision: str) -> None:
    row = as_filter(name)
    own = row.magnified_by or row
    found = reach(name, precision)
    if not own.prefilter:
        assert found == 0
        return
    h = weights(own)
    beyond = 2 * np.append(h[:0:-1].cumsum()[::-1], 0.0) / (2 * h.sum() - h[0])  # the share at distances of more than d
    assert beyond[found] <= LEFT_OUT[precision] * 1.01 + 1e-15
    assert beyond[found - 1] > LEFT_OUT[precision] * 0.99 - 1e-15


def test_cubics_reach_14_and_24_samples() -> None:
    assert (reach("bspline3"), reach("bspline3", "double")) == (14, 24)


def test_more_smoothing_reaches_farther() -> None:
    found = [reach(f"bspline3({value})") for value in (1, 10, 100, 1e3, 1e4, 1e5)]
    assert found == sorted(found)
    assert found[-1] > 10 * found[0]
    assert reach("bspline3(0.1, 0.1, 100)") == reach("bspline3(100)")


def test_filters_without_a_reach_are_rejected() -> None:
    with pytest.raises(OptionError, match="decided from all samples"):
        reach("bspline3(auto)")
    with pytest.raises(OptionError, match="precision must be one of single, double; got 'half'"):
        reach("bspline3", "half")
