"""The properties that section 4.1 of the paper names, and those that every reconstruction has, for whatever data.

Rows one by one are in test_filters; here hypothesis looks for data, positions, filters and edges that break a property.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from clvol import reference
from clvol.filter.boundary import as_boundary
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.filter.table import as_filter, filters
from tests.cases import RULES, SMOOTHED, examples

MAX_EXAMPLES = examples(60)

NAMES = (*filters(), *SMOOTHED)
names, rules = st.sampled_from(NAMES), st.sampled_from(RULES)
degrees = st.integers(0, 5)
levels = st.integers(-100, 100).map(float)  # exact in float64, and no two of them nearly equal
data = arrays(np.float64, array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=6), elements=levels)


def somewhere(shape: tuple[int, ...], seed: int, beyond: float = 0.5, count: int = 20) -> np.ndarray:
    """Positions (x, y(, z)) in the domain, or as far beyond the outer samples; none of them where a kernel may jump."""
    size = np.array(shape[::-1])
    return np.random.default_rng(seed).uniform(-beyond, size - 1 + beyond, (count, size.size))


def largest(samples: np.ndarray, name: str | Filter, rule: str) -> float:
    """The scale of rounding errors."""
    return 1 + float(np.abs(reference.prefilter(samples, name, rule)).max())


# -- section 4.1 ---------------------------------------------------------------------------------------------------


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, degrees, rules, st.integers(0, 2**32 - 1))
def test_convex_hull(coefficients: np.ndarray, degree: int, rule: str, seed: int) -> None:
    """A value lies within the k + 1 nearby coefficients along each axis, including those of the boundary rule."""
    moves = as_boundary(rule).outside in ("constant", "overlap")  # positions past the outer samples are others, or none
    points = somewhere(coefficients.shape, seed, 0 if moves else 0.5)
    values = reference.sample(coefficients, points, bspline(degree, prefilter=False), rule)
    margin = degree + 2
    near = reference.extend(coefficients, margin, rule)
    first = np.floor(points[:, ::-1] - (degree + 1) / 2 + 1).astype(int) + margin
    for start, value in zip(first, values, strict=True):
        some = near[tuple(slice(a, a + degree + 1) for a in start)]
        assert some.shape == (degree + 1,) * coefficients.ndim
        assert some.min() - 1e-11 <= value <= some.max() + 1e-11


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(arrays(np.float64, st.integers(2, 12), elements=levels), st.integers(1, 5), st.integers(-9, 9), st.integers(-9, 9))
def test_variation_diminishing(polygon: np.ndarray, degree: int, above: int, slope: int) -> None:
    """No straight line crosses the curve more often than it crosses the control polygon."""
    height = float(polygon[-1]) + above / 3  # where filters that overshoot cross it
    n = polygon.size
    padded = np.pad(polygon, 8, mode="edge")
    x = np.linspace(8 - (degree + 1) / 2, 8 + n - 1 + (degree + 1) / 2, 400)
    weights = reference.kernel(bspline(degree, prefilter=False), x[:, None] - np.arange(padded.size))
    away = weights @ padded - (height + slope / 7 * x)
    assert changes(away) <= changes(padded - (height + slope / 7 * np.arange(padded.size)))


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, st.integers(1, 5), rules, st.integers(0, 2**32 - 1), st.integers(-9, 9))
def test_variation_diminishing_along_lines_of_a_volume(
    coefficients: np.ndarray, degree: int, rule: str, seed: int, above: int
) -> None:
    """Along an axis, the function crosses a value no more often than the control points blended across do."""
    n, row = coefficients.shape[-1], bspline(degree, prefilter=False)
    across = somewhere(coefficients.shape, seed, 0.5, 1)[0, 1:]
    x = np.linspace(0, n - 1, 200)
    values = reference.sample(coefficients, np.stack([x, *(np.full_like(x, p) for p in across)], -1), row, rule)
    blended = [reference.lattice(part, [[p] for p in across[::-1]], row, rule).item() for part in np.moveaxis(coefficients, -1, 0)]
    polygon = reference.extend(np.array(blended), degree + 1, rule)
    height = blended[-1] + above / 3
    assert changes(values - height) <= changes(polygon - height)


def changes(values: np.ndarray) -> int:
    """Sign changes; those within rounding do not count."""
    signs = np.sign(values[np.abs(values) > 1e-9])
    return int((signs[1:] != signs[:-1]).sum())


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, degrees, st.data())
def test_local_control(coefficients: np.ndarray, degree: int, draw: Any) -> None:
    """A control point moves the function only within (k + 1)/2 samples of itself."""
    at = tuple(draw.draw(st.integers(0, n - 1)) for n in coefficients.shape)
    moved = coefficients.copy()
    moved[at] += 1
    row, points = bspline(degree, prefilter=False), somewhere(coefficients.shape, 0, 0.5, 60)
    change = reference.sample(moved, points, row, "zero") - reference.sample(coefficients, points, row, "zero")
    far = (np.abs(points - np.array(at[::-1])) > (degree + 1) / 2).any(-1)
    assert (change[far] == 0).all()
    assert (change >= -1e-12).all()


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(arrays(np.float64, st.integers(4, 9), elements=levels), st.floats(0, 1, exclude_max=True))
def test_a_cubic_curve_is_the_same_by_eqs_4_6_7_9_and_10(control: np.ndarray, u: float) -> None:
    i = control.size // 2  # the segment between control points i - 1 and i
    near = control[i - 2 : i + 2]
    x = i - 1 + u
    distance = x - np.arange(control.size)
    matrix = np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]) / 6
    by_9 = np.array([u**3, u**2, u, 1]) @ matrix @ near

    def recursion(k: int, at: float) -> float:
        """Eqs (3) and (4) on the knots 0, 1, 2, ..."""
        if k == 0:
            return float(0 <= at < 1)
        return (at * recursion(k - 1, at) + (k + 1 - at) * recursion(k - 1, at - 1)) / k

    by_4 = sum(c * recursion(3, d + 2) for c, d in zip(control, distance, strict=True))
    powers = [[(-1) ** j * math.comb(4, j) * max(d - j + 2, 0) ** 3 / 6 for j in range(5)] for d in distance]
    by_6 = control @ np.sum(powers, 1)
    nodes, lengths = np.polynomial.legendre.leggauss(3)
    by_7 = 0.0
    for c, d in zip(control, distance, strict=True):  # the integral of the quadratic over [d - 1/2, d + 1/2], which holds a knot
        knot = math.floor(d) + 0.5
        for a, b in ((d - 0.5, knot), (knot, d + 0.5)):
            by_7 += c * (b - a) / 2 * float(lengths @ bspline(2, prefilter=False)((a + b) / 2 + (b - a) / 2 * nodes))
    r = np.abs(distance)
    by_10 = control @ (np.where(r < 1, 3 * r**3 - 6 * r**2 + 4, np.where(r < 2, -(r**3) + 6 * r**2 - 12 * r + 8, 0)) / 6)
    np.testing.assert_allclose([by_4, by_6, by_7, by_10], by_9, rtol=0, atol=1e-10)
    drawn = reference.sample(np.tile(control, (2, 1)), [[x, 0.5]], "bspline3-approx")
    np.testing.assert_allclose(drawn, by_9, rtol=0, atol=1e-10)


# -- every reconstruction --------------------------------------------------------------------------------------------


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(
    array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=6),
    names,
    st.sampled_from(["mirror", "reflect", "wrap"]),
    levels,
    st.integers(0, 2**32 - 1),
)
def test_partition_of_unity(shape: tuple[int, ...], name: str, rule: str, level: float, seed: int) -> None:
    """Constants stay constant, inside and out, for every filter whose weights sum to one."""
    values = reference.sample(np.full(shape, level), somewhere(shape, seed, 20), name, rule)
    if as_filter(name).sums_to_one:
        np.testing.assert_allclose(values, level, rtol=0, atol=1e-10 * (1 + abs(level)))
    else:
        assert np.abs(values - level).max() < 0.4 * abs(level) + 1e-12


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(st.sampled_from([name for name in NAMES if as_filter(name).order]), st.integers(0, 2**32 - 1))
def test_polynomials_of_the_stated_degree_are_reproduced(name: str, seed: int) -> None:
    """Of each degree below the order along each axis, at once."""
    order = as_filter(name).order
    rng = np.random.default_rng(seed)
    polynomial = rng.uniform(-1, 1, (order, order))
    n, middle = 81, 40
    axis = (np.arange(n) - middle) / 10
    samples = np.polynomial.polynomial.polygrid2d(axis, axis, polynomial)
    at = rng.uniform(-2, 2, (20, 2))
    got = reference.sample(samples.T, at + middle, name)
    wanted = np.polynomial.polynomial.polyval2d(at[:, 0] / 10, at[:, 1] / 10, polynomial)
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9 * (1 + np.abs(samples).max()))


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, st.sampled_from([name for name in NAMES if as_filter(name).interpolates]), rules)
def test_interpolation_at_the_samples(samples: np.ndarray, name: str, rule: str) -> None:
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in samples.shape), indexing="ij")[::-1], -1)
    slack = 1e-9 * largest(samples, name, rule)
    np.testing.assert_allclose(reference.sample(samples, lattice, name, rule), samples, rtol=0, atol=slack)


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, names, st.data(), st.integers(0, 2**32 - 1))
def test_shifted_samples_give_the_shifted_function(samples: np.ndarray, name: str, draw: Any, seed: int) -> None:
    shift = [draw.draw(st.integers(-9, 9)) for _ in samples.shape]
    points = somewhere(samples.shape, seed, 2)
    moved = reference.sample(np.roll(samples, shift, range(samples.ndim)), points + shift[::-1], name, "wrap")
    slack = 1e-9 * largest(samples, name, "wrap")
    np.testing.assert_allclose(moved, reference.sample(samples, points, name, "wrap"), rtol=0, atol=slack)


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, names, rules, st.integers(0, 2**32 - 1))
def test_rotated_samples_give_the_rotated_function(samples: np.ndarray, name: str, rule: str, seed: int) -> None:
    """By 90° in the xy plane; the gradient rotates too."""
    points, height = somewhere(samples.shape, seed), samples.shape[-1]
    turned = np.rot90(samples, axes=(-2, -1))  # what lay at x lies at row width - 1 - x
    there = points.copy()
    there[:, 0], there[:, 1] = points[:, 1], height - 1 - points[:, 0]
    slack = 1e-9 * largest(samples, name, rule) * 100
    np.testing.assert_allclose(
        reference.sample(turned, there, name, rule), reference.sample(samples, points, name, rule), rtol=0, atol=slack
    )
    before, after = (reference.sample(*at, name, rule, derivative=1) for at in ((samples, points), (turned, there)))
    np.testing.assert_allclose(after[:, 0], before[:, 1], rtol=0, atol=slack)
    np.testing.assert_allclose(after[:, 1], -before[:, 0], rtol=0, atol=slack)


@settings(max_examples=MAX_EXAMPLES, deadline=None)
@given(data, names, rules, levels, levels, st.integers(0, 2), st.integers(0, 2**32 - 1))
def test_linearity(samples: np.ndarray, name: str, rule: str, a: float, b: float, derivative: int, seed: int) -> None:
    others = np.random.default_rng(seed).normal(size=samples.shape)
    rule = rule.partition("(")[0]  # without a value of its own outside
    points = somewhere(samples.shape, seed, 3)
    one, other, both = (reference.sample(v, points, name, rule, derivative) for v in (samples, others, a * samples + b * others))
    slack = 1e-11 * (abs(a) * largest(samples, name, rule) + abs(b) * largest(others, name, rule) + 1) * 100
    np.testing.assert_allclose(both, a * one + b * other, rtol=0, atol=slack)
