"""Boundary rules of the reference compared with SciPy's modes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import ndimage

from clvol import reference
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.filter.table import as_filter

MODES = {
    "mirror": "mirror",
    "reflect": "reflect",
    "wrap": "grid-wrap",
    "nearest": "nearest",
    "constant(2.5)": "constant",
    "grid-constant(2.5)": "grid-constant",
    "overlap": "wrap",
}
# SciPy's prefilter for "reflect" has wrong initial values on short axes: by the largest pole to the power of 2n - 1
SHAPES = {"reflect": ((17, 24), (16, 18, 17)), "": ((6, 7), (1, 5), (2, 3), (5, 6, 7), (1, 2, 4), (20, 3, 17), (1, 1, 1))}


def spline(order: int, prefilter: bool) -> Filter:
    return as_filter(("nearest", "linear")[order]) if order < 2 else bspline(order, prefilter=prefilter)


@pytest.mark.parametrize("rule", MODES)
@pytest.mark.parametrize("order", range(6))
def test_scipys_modes(order: int, rule: str) -> None:
    rng = np.random.default_rng(order)
    for shape, prefilter in itertools.product(SHAPES.get(rule, SHAPES[""]), (True, False) if order > 1 else (False,)):
        data, size = rng.normal(size=shape), np.array(shape[::-1])
        points = np.concatenate(
            [
                rng.uniform(-3 * size - 20, 4 * size + 20, (100, size.size)),
                rng.uniform(-1, size, (100, size.size)),
                # samples, and where SciPy and the index rule agree on the side of the half samples that are knots
                rng.integers(-3 * size, 4 * size, (50, size.size)) + (1e-3 if order % 2 == 0 else 0),
            ]
        )
        wanted = ndimage.map_coordinates(data, points.T[::-1], order=order, mode=MODES[rule], cval=2.5, prefilter=prefilter)
        got = reference.sample(data, points, spline(order, prefilter), rule)
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-11, err_msg=f"{shape} {prefilter}")


@pytest.mark.one_in(4)
@pytest.mark.parametrize("rule", ["nearest", "constant(2.5)", "grid-constant(-1)", "overlap"])
@pytest.mark.parametrize("name", ["nearest", "linear", "bspline3", "bspline5", "mitchell", "lanczos3", "hybrid"])
def test_axis_by_axis_is_point_by_point(name: str, rule: str) -> None:
    """Values and slopes in the domain, its outer half samples included."""
    rng = np.random.default_rng(1)
    data = rng.normal(size=(5, 1, 6))
    axes = [rng.uniform(-0.5, n - 0.5, 30) for n in data.shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij")[::-1], -1)
    np.testing.assert_allclose(
        reference.lattice(data, axes, name, rule), reference.sample(data, points, name, rule), rtol=0, atol=1e-12
    )
    slope = reference.lattice(data, axes, name, rule, (0, 0, 1))
    np.testing.assert_allclose(slope, reference.sample(data, points, name, rule, 1)[..., 0], rtol=0, atol=1e-11)


@pytest.mark.parametrize("rule", ["nearest", "grid-constant(3)", "constant", "overlap"])
@pytest.mark.parametrize("name", ["bspline3", "bspline5"])
def test_slopes_are_differences(name: str, rule: str) -> None:
    """Of the rule's own function, where it exists."""
    rng = np.random.default_rng(2)
    data, h = rng.normal(size=(6, 7)), 1e-5
    points = rng.uniform(-20, 25, (300, 2))
    points = points[(np.abs(points - np.round(points)) > 2 * h).all(-1)]
    gradient = reference.sample(data, points, name, rule, 1)
    for axis in range(2):
        step = h * np.eye(2)[axis]
        rise = reference.sample(data, points + step, name, rule) - reference.sample(data, points - step, name, rule)
        np.testing.assert_allclose(gradient[:, axis], rise / (2 * h), rtol=0, atol=1e-7)
