"""The adjoint of sampling: matrices whose columns are SciPy's splines of unit impulses, and <A v, y> = <v, Aᵀ y>."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.filter.table import as_filter

Array = NDArray[np.float64]
ORDERS = {"nearest": 0, "linear": 1, "bspline2": 2, "bspline3": 3, "bspline4": 4, "bspline5": 5}
MODES = {"mirror": "mirror", "reflect": "reflect", "wrap": "grid-wrap"}
EXACT = 1e-12
# all rules with one filter, and all kinds of filters with one rule or another: each pair is compiled
PAIRS = [
    *(("bspline3", rule) for rule in ("mirror", "reflect", "wrap", "zero")),
    ("nearest", "wrap"),
    ("linear", "zero"),
    ("bspline4", "reflect"),
    ("bspline3(0.5)", "mirror"),
    ("mitchell", "reflect"),
    ("lanczos3", "mirror"),
]
SHAPES = [(4, 5, 6), (1, 2, 7), (7, 5), (1, 1)]


def scipy_matrix(shape: tuple[int, ...], at: Array, order: int, mode: str) -> Array:
    """The contribution of each sample to the spline at points (x first)."""
    impulses = np.eye(int(np.prod(shape))).reshape(-1, *shape)
    where = at[:, ::-1].T
    if mode == "reflect":  # SciPy's is rough on short axes: reflected by hand
        where = (where + 0.5) % (2 * np.array(shape)[:, None]) - 0.5 + 40
        impulses = np.pad(impulses, ((0, 0), *((40, 60),) * len(shape)), "symmetric")
    return np.stack([ndimage.map_coordinates(one, where, order=order, mode=mode) for one in impulses], 1)


@pytest.mark.one_in(36)
@pytest.mark.parametrize(("name", "boundary"), [*(("bspline3", rule) for rule in MODES), *((name, "mirror") for name in ORDERS)])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_it_is_the_transpose_of_scipys_spline(device: Device, name: str, boundary: str, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    at, y = rng.uniform(-9, 14, (60, len(shape))), rng.normal(size=60)
    expected = (scipy_matrix(shape, at, ORDERS[name], MODES[boundary]).T @ y).reshape(shape)
    got = clvol.adjoint(y, at, shape, name, boundary, device=device, precision="double")
    assert_allclose(got, expected, rtol=0, atol=EXACT * np.abs(expected).max())


@pytest.mark.one_in(20)
@pytest.mark.parametrize(("name", "boundary", "derivative"), [(*pair, d) for pair in PAIRS for d in (0, 1)])
def test_the_inner_products_are_equal(device: Device, name: str, boundary: str, derivative: int) -> None:
    if derivative and not as_filter(name).has_gradient:
        pytest.skip("it has no gradient")
    rng = np.random.default_rng(1)
    for shape in SHAPES:
        d = len(shape)
        turned, _ = np.linalg.qr(rng.normal(size=(d, d)))
        v = clvol.Volume(rng.normal(size=shape), rng.uniform(0.5, 2, d), rng.normal(size=d), turned)
        at = v.index_to_world(rng.uniform(-5, 12, (300, d)))
        y = rng.normal(size=(300, *(d,) * derivative))
        forward = (clvol.sample(v, at, name, boundary, derivative, device=device, precision="double") * y).sum()
        back = clvol.adjoint(y, at, v, name, boundary, derivative, device=device, precision="double")
        assert back.dtype == np.float64
        assert abs(forward - (back * v.data).sum()) <= EXACT * np.linalg.norm(y) * np.linalg.norm(v.data)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", ["linear", "bspline3", "bspline5"])
def test_single_precision_is_that_of_float32(device: Device, name: str) -> None:
    rng = np.random.default_rng(4)
    at, y = rng.uniform(-2, 12, (5000, 3)), rng.normal(size=5000)
    got, exact = (clvol.adjoint(y, at, (9, 10, 11), name, device=device, precision=p) for p in ("single", "double"))
    assert got.dtype == np.float32
    assert_allclose(got, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_results_are_reproducible(device: Device) -> None:
    rng = np.random.default_rng(2)
    at, y = rng.uniform(-3, 43, (200_000, 3)), rng.normal(size=200_000)
    once = clvol.adjoint(y, at, (40, 41, 42), device=device)
    for _ in range(3):
        assert_array_equal(clvol.adjoint(y, at, (40, 41, 42), device=device), once)


def test_counts_of_points_per_sample(device: Device) -> None:
    # the weights of a point sum to one: so does what a 1 at each point adds; and in the middle of many each sample has its share
    grid = np.stack(np.meshgrid(*[np.arange(0, 20, 0.25)] * 2, indexing="ij"), -1) - 0.375
    share = clvol.adjoint(np.ones(grid.shape[:2]), grid, (20, 20), "bspline3-approx", "reflect", device=device)
    assert_allclose(share, 16, rtol=1e-6)


def test_jumps_match_those_of_sampling(device: Device) -> None:
    # a turned grid whose points lie half way between samples, but for rounding
    angle = np.deg2rad(30)
    v = clvol.Volume(
        np.arange(81.0).reshape(9, 9), (0.1, 0.1), (0.3, 0.7), [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    )
    at = v.index_to_world(np.stack(np.meshgrid(*[np.arange(0.5, 8, 1)] * 2, indexing="ij"), -1).reshape(-1, 2))
    taken = clvol.sample(v, at, "nearest", device=device)
    for n, value in enumerate(taken):
        given = clvol.adjoint([1.0], at[[n]], v, "nearest", device=device)
        assert v.data[given == 1].tolist() == [value]


def test_points_without_a_contribution(device: Device) -> None:
    at = np.array([[np.nan, 1], [1, np.inf], [-np.inf, 2], [2, 2]])
    got = clvol.adjoint([1, 2, 3, 4], at, (5, 5), "linear", device=device)
    assert got[2, 2] == 4
    assert got.sum() == 4
    far = [[1e30, 2], [-1e300, 2], [2, -40.0]]
    assert (clvol.adjoint([1, 2, 3], far, (5, 5), "linear", "zero", device=device) == 0).all()
    for name in ("nearest", "linear", "bspline2", "bspline3", "bspline5"):
        assert (clvol.adjoint([1, 2, 3, 4], [*far, [9e9, 9e9]], (5, 5), name, "zero", device=device) == 0).all()
    assert (clvol.adjoint(np.empty(0), np.empty((0, 3)), (2, 3, 4), device=device) == np.zeros((2, 3, 4))).all()


def test_shapes_and_kinds_of_arguments(device: Device) -> None:
    at = np.random.default_rng(3).uniform(0, 3, (2, 3, 2)).astype(np.float32)
    one = clvol.adjoint(np.ones((2, 3), np.int8), at, clvol.Volume(np.zeros((4, 5))), device=device)
    assert one.shape == (4, 5)
    assert_array_equal(one, clvol.adjoint(np.ones(6), at.reshape(6, 2), np.array([4, 5]), device=device))


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"values": np.ones(3)}, r"values must be real numbers of shape \(2,\)"),
        ({"values": [1j, 2]}, "values must be real numbers"),
        ({"values": [1, np.nan]}, "values must be finite"),
        ({"points": np.ones((2, 2))}, r"points must be numbers of shape \(\.\.\., 3\)"),
        ({"like": (2, 3, 4, 5)}, "at most 3"),
        ({"like": (2, 0, 4)}, "at least 1"),
        ({"like": (2.5, 3, 4)}, "whole number"),
        ({"like": (5,)}, "2 or 3"),
        ({"like": None}, "a Volume, or 2 or 3 whole numbers"),
        ({"filter": "hybrid"}, "got the hybrid 'hybrid'"),
        ({"filter": "bspline3(auto)"}, "no volume decides on.*bspline3"),
        ({"filter": "quartz"}, "filter must be one of"),
        ({"boundary": "nearest"}, "extends coefficients: mirror, reflect, wrap, zero; got 'nearest'"),
        ({"precision": "half"}, "precision must be one of"),
        ({"boundary": "clamp"}, "boundary must be one of"),
        ({"derivative": 2}, "derivative must be a whole number"),
    ],
    ids=str,
)
def test_arguments_that_are_rejected(change: dict[str, Any], rule: str) -> None:
    arguments: dict[str, Any] = {"values": np.ones(2), "points": np.ones((2, 3)), "like": (4, 5, 6)} | change
    with pytest.raises(OptionError, match=rule):
        clvol.adjoint(**arguments)
