"""Every filter of the table passes the same property tests; an optional property is a field of the filter."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from numpy.polynomial import legendre

from clvol import reference
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import bc, bspline, from_callable, from_pieces, lanczos, moms3, omoms3, quasi, sinc, wide
from clvol.filter.table import as_filter, filters, register_filter, unregister_filter
from clvol.reference.spline import filter as reference_filter
from clvol.reference.spline.prefilter import kernel_samples
from clvol.volume.volume import Volume
from tests.cases import SMOOTHED

table = importlib.import_module("clvol.filter.table")
ROWS = {
    row.name: row
    for row in (
        *filters().values(),
        bspline(7),
        bspline(9, prefilter=False),
        wide(2),
        wide(3),
        bc(1, 0),
        bc(0, 0),
        bc(0.2, 0.3),
        moms3(0.03),
        moms3(Fraction(1, 60)),
        sinc(2),
        sinc(8),
        lanczos(8),
        *(sinc(radius, normalized=True) for radius in (1, 2, 7)),
        lanczos(2, normalized=True),
        lanczos(8, normalized=True),
        quasi(5),
        *map(as_filter, SMOOTHED),
    )
}
SPLINES = range(10)


@pytest.fixture(params=list(ROWS))
def row(request: pytest.FixtureRequest) -> Filter:
    return ROWS[request.param]


def positions(row: Filter, seed: int = 0) -> np.ndarray:
    """Distances over the support and beyond, none near a knot."""
    half = row.support / 2
    knots = np.arange(-half - 1, half + 2)
    return (knots[:-1, None] + np.random.default_rng(seed).uniform(0.02, 0.98, (knots.size - 1, 40))).ravel()


# -- properties of every row -------------------------------------------------------------------------------


def test_cell_is_the_index_rule(row: Filter) -> None:
    """The first tap lies TAPS/2 - 1 below, rounded down, and the weights there are the kernel at the taps' distances."""
    x = np.random.default_rng(0).uniform(-20, 20, 200)
    base, t = row.cell(x)
    assert (base == np.floor(base)).all()
    assert ((t >= 0) & (t < 1)).all()
    np.testing.assert_allclose(base + t, x * row.scale - row.support / 2 + 1, atol=1e-12)
    distances = x * row.scale - base - np.arange(row.support)[:, None]
    np.testing.assert_allclose(row.weights(t), row(distances), atol=1e-9 * max(1.0, np.abs(row.matrix).max()))


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_filter_matches_its_closed_form(row: Filter, derivative: int) -> None:
    half = row.support / 2
    x = np.concatenate([positions(row), np.arange(-half - 2, half + 2.5, 0.5)])
    wanted = reference.kernel(row, x, derivative)
    # the derivative of a polynomial on [0, 1] may be 2 n² times as great (Markov), and so may a fit's error
    tolerance = 1e-9 + 2 * row.fit_error * (2 * row.degree**2) ** derivative
    np.testing.assert_allclose(row(x, derivative), wanted, rtol=0, atol=tolerance)


def test_the_reference_does_not_use_the_filter_table(row: Filter) -> None:
    assert reference_filter._closed_form(row) is not None


def test_weights_sum_to_one_if_declared(row: Filter) -> None:
    t = np.linspace(0, 1, 101)
    miss = np.abs(row.weights(t).sum(0) - 1).max()
    if row.sums_to_one:
        assert miss < 1e-9
        np.testing.assert_allclose(row.weights(t, 1).sum(0), 0, atol=1e-7)
    else:
        assert 1e-9 < miss < 0.3


def test_integral_is_one_if_the_weights_sum_to_one(row: Filter) -> None:
    x, w = legendre.leggauss(32)
    integral = (row.weights((x + 1) / 2) @ (w / 2)).sum()
    assert integral == pytest.approx(1, abs=1e-9 if row.sums_to_one else 0.1)


def test_slope_is_the_numeric_derivative(row: Filter) -> None:
    x, h = positions(row), 1e-5
    for derivative in (0, 1):
        numeric = (row(x + h, derivative) - row(x - h, derivative)) / (2 * h)
        np.testing.assert_allclose(row(x, derivative + 1), numeric, atol=2e-8 * max(1, np.abs(numeric).max() * 10))


def test_kernel_is_zero_outside_its_support(row: Filter) -> None:
    half = row.support / 2
    x = np.concatenate([half + np.linspace(0, 5, 41), -half - np.linspace(1e-9, 5, 41), [1e9, -1e9]])
    for derivative in (0, 1, 2):
        assert not row(x, derivative).any()
        assert not reference.kernel(row, x, derivative).any()


def test_kernel_is_even(row: Filter) -> None:
    x = positions(row)
    np.testing.assert_allclose(row(x), row(-x), rtol=0, atol=1e-12 + 2 * row.fit_error)


def test_continuity_is_exactly_as_declared(row: Filter) -> None:
    half = row.support / 2
    knots = np.arange(-half, half + 1)

    def jump(derivative: int) -> float:
        return float(np.abs(row(knots, derivative) - row(knots - 1e-11, derivative)).max())

    for derivative in range(row.continuity + 1):
        assert jump(derivative) < 1e-8 + 10 * row.fit_error * row.degree ** (2 * derivative)
    if row.continuity < row.degree:
        assert jump(row.continuity + 1) > 1e-3


def test_polynomials_below_the_order_are_reproduced(row: Filter) -> None:
    """Through eq. (11) and eq. (8) of the reference, far from the edges; a constant along y."""
    n = 161
    middle = n // 2
    at = np.linspace(middle - 2, middle + 2, 101)
    points = np.stack([at, np.ones_like(at)], -1)
    for m in range(row.order + 1):
        line = (np.arange(n) - middle) ** float(m)
        got = reference.sample(np.tile(line, (3, 1)), points, row)
        miss = np.abs(got - (at - middle) ** float(m)).max()
        if m < row.order:
            assert miss < 1e-7, f"degree {m}"
        else:
            assert miss > 1e-5, f"degree {m}: the order claims too little"


def test_interpolates_if_declared(row: Filter) -> None:
    data = np.random.default_rng(1).normal(size=(9, 8))
    y, x = np.indices(data.shape)
    got = reference.sample(data, np.stack([x, y], -1), row)
    miss = np.abs(got - data).max()
    assert miss < 1e-9 if row.interpolates else miss > 1e-2
    if row.interpolates_directly:
        np.testing.assert_allclose(kernel_samples(row), [1], atol=1e-12)


def test_poles_are_roots_of_the_samples(row: Filter) -> None:
    if not row.prefilter:
        assert row.poles.size == 0
        return
    b = kernel_samples(row)
    np.testing.assert_allclose(row.samples, b, atol=1e-12)
    assert isinstance(row.smoothing, float)
    if row.smoothing:
        differences = row.smoothing * np.poly([1] * 2 * row.penalty)[row.penalty :] * (-1) ** row.penalty  # of (z - 1)²ᵐ
        b = np.pad(b, (0, differences.size - b.size)) + differences
    assert row.poles.size == b.size - 1
    for z in row.poles:
        assert abs(z) < 1
        assert row.smoothing or -1 < z < 0
        assert b[0] + sum(v * (z**k + z**-k) for k, v in enumerate(b) if k) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("derivative", [0, 1])
def test_pairable_if_and_only_if_no_pair_differs_in_sign(row: Filter, derivative: int) -> None:
    w = row.weights(np.random.default_rng(2).uniform(0, 1, 20_000), derivative)
    if row.support % 2:
        w = np.vstack([w, np.zeros(w.shape[1])])
    assert row.pairable(derivative) == bool((w[::2] * w[1::2] >= -1e-12).all())


def test_plot_covers_the_support(row: Filter) -> None:
    x, y = row.plot(33)
    assert x[0] == -row.support / 2
    assert x[-1] == row.support / 2
    np.testing.assert_allclose(y, row(x))


def test_description_is_consistent(row: Filter) -> None:
    assert row.matrix.shape == (row.support, row.degree + 1)
    assert row.exact == (row.fit_error == 0)
    assert row.has_gradient == (row.degree > 0)
    assert row.scale == (2 if row.magnified_by else 1)


# -- the paper's equations ---------------------------------------------------------------------------------


def cox_de_boor(i: int, k: int, u: np.ndarray) -> np.ndarray:
    """Eqs (3), with its misprint corrected, and (4), on the knots 0, 1, 2, ..."""
    if k == 0:
        return ((u >= i) & (u < i + 1)).astype(float)
    return ((u - i) * cox_de_boor(i, k - 1, u) + (i + k + 1 - u) * cox_de_boor(i + 1, k - 1, u)) / k


@pytest.mark.parametrize("degree", SPLINES)
def test_recursion_eqs_3_4_equals_closed_form_eq_6(degree: int) -> None:
    x = np.linspace(-degree / 2 - 1, degree / 2 + 1, 203)
    wanted = cox_de_boor(0, degree, x + (degree + 1) / 2)
    row = bspline(degree, prefilter=False)
    np.testing.assert_allclose(reference.kernel(row, x), wanted, atol=1e-10)
    np.testing.assert_allclose(row(x), wanted, atol=1e-13)


@pytest.mark.parametrize("degree", SPLINES[1:])
def test_convolution_eq_7_equals_closed_form_eq_6(degree: int) -> None:
    """β_k(x) is the integral of β_(k-1) over [x - 1/2, x + 1/2], which holds one knot."""
    nodes, weights = legendre.leggauss(8)
    lower = bspline(degree - 1, prefilter=False)
    x = np.random.default_rng(degree).uniform(-degree / 2 - 1, degree / 2 + 1, 50)
    knot = np.ceil(x - 0.5 + degree / 2) - degree / 2
    total = np.zeros_like(x)
    for a, b in ((x - 0.5, knot), (knot, x + 0.5)):
        half = (b - a) / 2
        total += half * (reference.kernel(lower, (a + half)[:, None] + half[:, None] * nodes) @ weights)
    np.testing.assert_allclose(reference.kernel(bspline(degree), x), total, atol=1e-10)


def test_cubic_is_the_matrix_of_eq_9() -> None:
    eq9 = [[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]  # rows: u**3, u**2, u, 1
    wanted = tuple(tuple(Fraction(eq9[3 - k][tap], 6) for k in range(4)) for tap in range(4))
    assert bspline(3).taps == wanted
    assert bspline(3, prefilter=False).taps == wanted


def test_cubic_is_eq_10_and_bc_of_1_0() -> None:
    assert bc(1, 0).taps == bspline(3).taps
    x = np.linspace(-3, 3, 301)
    r = np.abs(x)
    eq10 = np.where(r < 1, 3 * r**3 - 6 * r**2 + 4, np.where(r < 2, -(r**3) + 6 * r**2 - 12 * r + 8, 0)) / 6
    np.testing.assert_allclose(bspline(3)(x), eq10, atol=1e-15)
    assert bspline(3).taps[1][0] == Fraction(2, 3)  # not the 0.8 and 0.1 of some public kernels
    assert bspline(3).taps[0][0] == Fraction(1, 6)


def test_pole_of_the_cubic_is_root_3_minus_2() -> None:
    assert bspline(3).poles == pytest.approx([math.sqrt(3) - 2], abs=1e-15)
    assert bspline(2).poles == pytest.approx([math.sqrt(8) - 3], abs=1e-15)


def test_convex_hull_of_b_splines() -> None:
    t = np.linspace(0, 1, 1001)
    for degree in SPLINES:
        assert bspline(degree).weights(t).min() >= -1e-15


def test_the_truncated_sinc_sums_to_one_within_008_at_radius_4() -> None:
    miss = np.abs(as_filter("sinc").weights(np.linspace(0, 1, 2001)).sum(0) - 1).max()
    assert 0.06 < miss < 0.08


def test_a_normalized_sinc_is_berrut_s_rational_interpolant() -> None:
    """Berrut (1988): the sines cancel, which leaves ``(-1)**i / (x - x_i)`` over its sum."""
    t = np.random.default_rng(0).uniform(0.001, 0.999, 500)
    for radius in range(1, 9):
        row = sinc(radius, normalized=True)
        nodes = np.arange(2 * radius) - (radius - 1)
        terms = (-1.0) ** nodes[:, None] / (t - nodes[:, None])
        np.testing.assert_allclose(row.weights(t), terms / terms.sum(0), rtol=0, atol=1.5 * row.fit_error + 1e-14)
        assert row.order == 2  # exact for lines, since the nodes are even in number
    np.testing.assert_allclose(sinc(1, normalized=True)([-0.7, 0.0, 0.25]), [0.3, 1, 0.75], atol=1e-12)  # two nodes: linear


@pytest.mark.parametrize("radius", range(1, 9))
def test_normalized_filters_sum_to_one_and_interpolate(radius: int) -> None:
    t = np.linspace(0, 1, 501)
    for make in (sinc, lanczos):
        bare, row = make(radius), make(radius, normalized=True)
        assert row.fit_error < (1e-6 if radius > 1 else 3e-5)
        assert row.interpolates_directly
        assert row.sums_to_one
        np.testing.assert_allclose(row.weights(t).sum(0), 1, rtol=0, atol=1e-11)
        wanted = bare.weights(t) / bare.weights(t).sum(0)
        np.testing.assert_allclose(row.weights(t), wanted, rtol=0, atol=3 * (row.fit_error + bare.fit_error) + 1e-12)


def test_moms3_of_minus_a_sixth_is_the_cubic_of_lagrange() -> None:
    t = np.linspace(0, 1, 101)
    row = moms3(Fraction(-1, 6))
    nodes = (-1, 0, 1, 2)
    wanted = [np.prod([(t - b) / (a - b) for b in nodes if b != a], 0) for a in nodes]
    np.testing.assert_allclose(row.weights(t), wanted, rtol=0, atol=1e-15)
    assert row.interpolates_directly
    assert moms3(0).taps == bspline(3).taps
    assert (moms3().taps, omoms3().taps) == (moms3(Fraction(1, 56)).taps, moms3(Fraction(1, 42)).taps)


def test_quasi_interpolation_is_the_published_filter() -> None:
    """Condat, Blu and Unser (2005): linear's prefilter is 12 / (z + 10 + 1/z); it need not interpolate."""
    row = quasi(1)
    assert row.taps == bspline(1).taps
    np.testing.assert_allclose(row.undone, [10 / 12, 1 / 12], rtol=1e-15)
    assert row.poles == pytest.approx([math.sqrt(24) - 5], rel=1e-12)
    assert not row.interpolates
    x = np.linspace(2.0, 9.0, 29)  # lines stay as they are, far from the ends of 161 samples
    line = np.tile(3 - 0.5 * np.arange(161.0), (2, 1))
    got = reference.sample(line, np.stack([x + 75, np.ones_like(x)], -1), row)
    np.testing.assert_allclose(got, 3 - 0.5 * (x + 75), rtol=0, atol=1e-10)


# -- making and registering rows ---------------------------------------------------------------------------


def test_from_pieces_is_exact() -> None:
    half = Fraction(1, 2)
    row = from_pieces("mine", [(1, 0, Fraction(-5, 2), Fraction(3, 2)), (2, -4, Fraction(5, 2), -half)])
    assert row.exact
    assert row.taps == as_filter("catmull-rom").taps


def test_from_pieces_with_prefilter_is_the_cubic() -> None:
    row = from_pieces("mine", [(2 / 3, 0, -1, 1 / 2), (4 / 3, -2, 1, -1 / 6)], prefilter=True)
    assert row.poles == pytest.approx([math.sqrt(3) - 2])
    assert (row.order, row.continuity, row.interpolates) == (4, 2, True)
    assert not row.exact


def test_from_callable_states_its_error() -> None:
    def kernel(x: np.ndarray) -> np.ndarray:
        return np.cos(np.pi * x / 4) ** 2 / 2

    x = np.random.default_rng(0).uniform(-2, 2, 5000)
    for degree in (2, 4, 8, None):
        row = from_callable("mine", kernel, 2, degree=degree)
        error = np.abs(row(x) - kernel(x)).max()
        assert error <= row.fit_error * 1.2 + 1e-15
        assert row.fit_error <= error * 2 + 1e-14
    assert row.fit_error < 1e-10
    assert row.order == 1
    assert from_callable("mine", kernel, 2, degree=2).fit_error > 1e-4


def test_from_callable_accepts_a_kernel_that_jumps_at_integers() -> None:
    row = from_callable("mine", lambda x: np.where(np.abs(x) < 1, 0.75, 0.25) / 2, 2)
    assert row.fit_error < 1e-12
    assert row.continuity == -1


def test_from_callable_accepts_a_kernel_narrower_than_its_radius() -> None:
    row = from_callable("box", lambda x: (np.abs(x) < 1) * 0.5, 3)
    assert (row.support, row.degree, row.fit_error) == (6, 0, 0)
    np.testing.assert_array_equal(row([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5]), [0, 0, 0.5, 0.5, 0, 0])


@pytest.mark.parametrize("half", [0.5, 0.8, 1.2])
def test_from_callable_requires_a_kernel_smooth_between_integers(half: float) -> None:
    with pytest.raises(OptionError, match=r"kernel of 'box' must be smooth between the integers; .* of degree 20 miss by 0\.\d"):
        from_callable("box", lambda x: (np.abs(x) < half) * 0.5, 3)
    row = from_callable("box", lambda x: (np.abs(x) < half) * 0.5, 3, degree=9)  # its outer pieces are of degree 0
    assert (row.support, row.degree) == (6, 9)
    assert row.fit_error > 0.1
    np.testing.assert_array_equal(row([-2.5, 2.5]), 0)


@pytest.mark.usefixtures("own_table")
def test_a_registered_filter_is_known_everywhere() -> None:
    mine = register_filter(from_pieces("my-Filter.2", [(1, -1)]))
    assert as_filter("my-Filter.2") is mine
    assert "my-Filter.2" in filters()
    x = np.linspace(-2, 2, 41)
    np.testing.assert_array_equal(reference.kernel("my-Filter.2", x), mine(x))  # unknown to the closed forms
    with pytest.raises(OptionError, match="exists; pass replace_existing"):
        register_filter(mine)
    again = register_filter(from_pieces("my-Filter.2", [(1, -1), (0, 0)]), replace_existing=True)
    assert as_filter("my-Filter.2") is again


@pytest.mark.usefixtures("own_table")
def test_a_replaced_filter_is_not_confused_with_its_successor() -> None:
    other = register_filter(from_pieces("mitchell", [(1, -1)]), replace_existing=True)
    x = np.linspace(-2, 2, 41)
    np.testing.assert_array_equal(reference.kernel("mitchell", x), other(x))


@pytest.mark.usefixtures("own_table")
def test_unregistered_filter_is_unknown() -> None:
    linear = as_filter("linear")
    assert unregister_filter("linear") is linear
    for gone in ("linear", "trilinear"):
        with pytest.raises(OptionError, match="filter must be one of"):
            as_filter(gone)
    for unknown in ("linear", "bogus", "trilinear", 3, None):
        with pytest.raises(OptionError, match="filter must be one of"):
            unregister_filter(unknown)  # type: ignore[arg-type]
    assert register_filter(linear) is as_filter("linear")


def test_filters_returns_a_copy() -> None:
    filters().clear()
    assert "bspline3" in filters()


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("BSpline3 ", "bspline3"),
        ("bspline", "bspline3"),
        ("trilinear", "linear"),
        ("cubic", "bspline3"),
        ("Catmull-Rom", "catmull-rom"),
        ("sinc(4)", "sinc"),
        ("lanczos(3)", "lanczos3"),
        ("lanczosn(3)", "lanczos3n"),
        ("SincN(4)", "sinc4n"),
        ("moms3(1/42)", "omoms3"),
        ("moms3( 1/56 )", "moms3"),
    ],
)
def test_names_and_aliases(name: str, wanted: str) -> None:
    assert as_filter(name).taps == filters()[wanted].taps


def test_families() -> None:
    assert as_filter("bc(1/3, 1/3)").taps == as_filter("mitchell").taps
    assert as_filter("BC(0,0.5)").taps == as_filter("catmull-rom").taps
    assert as_filter("bc(0.2, 0.4)").exact
    assert as_filter("sinc(6)").support == 12
    assert as_filter("sincn(6)") is sinc(6, normalized=True)
    assert as_filter("lanczosn(2)").name == "lanczosn(2)"
    assert as_filter("moms3(0.02)") is moms3(Fraction(1, 50))
    assert as_filter(bspline(7)).support == 8
    assert as_filter("wide(1)").taps == bspline(3, prefilter=False).taps
    assert as_filter("wide(4)").sums_to_one


@pytest.mark.parametrize("degree", range(2, 10))
def test_a_degree_without_smoothing_can_be_named(degree: int) -> None:
    assert as_filter(f"bspline{degree}(0)").name == f"bspline{degree}"
    assert as_filter(f"bspline{degree}") == bspline(degree)


@pytest.mark.parametrize(
    "bad",
    [
        "bspline10",
        "",
        "bc(1)",
        "bc(1,2,3)",
        "bc(a,b)",
        "bc(1/0,1)",
        "sinc(2.5)",
        "sinc(0)",
        "sinc(9)",
        "lanczos(-1)",
        "lanczos()",
        "lanczosn(9)",
        "sincn(1/2)",
        "moms3(1/12)",
        "moms3(a)",
        "moms3(1, 2)",
        "wide(5)",
        "bspline3(1)(2)",
        3,
        None,
        b"linear",
    ],
)
def test_unknown_filter_is_rejected(bad: object) -> None:
    with pytest.raises(OptionError):
        as_filter(bad)  # type: ignore[arg-type]


def test_unknown_filter_lists_known_ones() -> None:
    with pytest.raises(
        OptionError, match=r"^filter must be one of nearest \(box.*hybrid, .*bc\(B, C\).*; got 'bicubic' \(did you mean cubic\?\)$"
    ):
        as_filter("bicubic")


@pytest.mark.parametrize(
    "make",
    [
        lambda: Filter("x", ()),
        lambda: Filter("x", ((1.0,),) * 17),
        lambda: Filter("x", ((1.0,), (1.0, 2.0))),
        lambda: Filter("x", ((math.nan,),)),
        lambda: Filter("x", ((1.0,) * 22,)),
        lambda: Filter("x", bspline(3).taps[:3], prefilter=True),
        lambda: from_pieces("x", [(0, 1), (1, -1)], prefilter=True),
        lambda: from_pieces("x", [(1, 0), (1, 0)], prefilter=True),
        lambda: from_pieces("x", []),
        lambda: from_callable("x", np.sinc, 0),
        lambda: from_callable("x", np.sinc, 9),
        lambda: from_callable("x", np.sinc, 2, degree=21),
        lambda: from_callable("x", lambda x: x * np.nan, 2),
        lambda: from_callable("x", lambda _: 1.0, 2),
        lambda: bspline(10),
        lambda: bspline(-1),
        lambda: bc(math.inf, 0),
        lambda: bc("1", 0),
        lambda: register_filter("bspline3"),
        lambda: register_filter(Filter("a b", bspline(1).taps)),
        lambda: register_filter(Filter("trilinear", bspline(1).taps)),
        lambda: bspline(3).weights(0.5, -1),
        lambda: reference.kernel("linear", 0.0, 3),
        *(lambda bad=bad: sinc(bad) for bad in (1.5, True, "a", [], None, 0, 9)),
        *(lambda bad=bad: lanczos(bad) for bad in (2.5, True, "a", [], None, 2.0)),
        *(lambda bad=bad: moms3(bad) for bad in (Fraction(1, 12), 0.5, "a", None, True, math.nan)),
        *(lambda bad=bad: quasi(bad) for bad in (0, 2, 7, 3.0, "a", None, True)),
        lambda: bspline(3, smoothing=-1 / 720),
        lambda: Filter("x", bspline(1).taps, prefilter=True, smoothing=-0.25),
        *(lambda bad=bad: bspline(bad) for bad in (3.0, 2.5, "a", None, True)),
        *(lambda bad=bad: bc(bad, 1) for bad in ([], None, True, "a", 1j, 1e308)),
        *(lambda bad=bad: from_pieces("x", bad) for bad in (3, "ab", [1], [("a",)], [(None,)], [(1j,)], None)),
        *(lambda bad=bad: from_callable("x", np.sinc, bad) for bad in (1.5, "a", None, True)),
        *(lambda bad=bad: from_callable("x", np.sinc, 2, degree=bad) for bad in (1.5, "a", True)),
        *(
            lambda bad=bad: from_callable("x", bad, 2)
            for bad in (3, None, "sinc", lambda _: "text", lambda x: x + 1j, lambda _: 1 / 0)
        ),
        lambda: Filter("a", 3),
        lambda: Filter("a", ("b",)),
        lambda: Filter("a", ((True,),)),
        lambda: Filter(3, bspline(1).taps),
        lambda: Filter("", bspline(1).taps),
        lambda: Filter("a", bspline(1).taps, magnified_by="x"),
        lambda: Filter("a", bspline(1).taps, magnified_by=3),
        lambda: Filter("a", bspline(1).taps, fit_error="a"),
        lambda: bspline(3).weights("a"),
        lambda: bspline(3).weights(0.5, "a"),
        lambda: bspline(3).weights(0.5, 1.0),
        lambda: bspline(3)("a"),
        lambda: bspline(3).plot(0),
        lambda: bspline(3).plot("a"),
    ],
)
def test_bad_filters_are_rejected(make) -> None:  # type: ignore[no-untyped-def]
    before = dict(table._TABLE)
    with pytest.raises(OptionError):
        make()
    assert before == table._TABLE


def test_nearest_takes_the_upper_sample_half_way() -> None:
    assert as_filter("nearest")([-0.5, 0.0, 0.5]).tolist() == [1, 1, 0]
    assert reference.kernel("nearest", [-0.5, 0.0, 0.5]).tolist() == [1, 1, 0]
    assert reference.sample(Volume([[1.0, 2.0, 3.0]]), [[0.5, 0.0], [1.5, 0.0]], "nearest").tolist() == [2, 3]


@pytest.mark.filterwarnings("error")
def test_numbers_of_any_kind() -> None:
    assert bc(np.float32(0.25), 0.3).taps == bc(0.25, 0.3).taps
    assert bc(np.int64(1), 0) == bc(1, 0.0) == bc(Fraction(1), np.array(0))
    assert (sinc(np.int64(3)), bspline(np.uint8(3)), lanczos(np.array(3))) == (sinc(3), bspline(3), lanczos(3))
    assert hash(Filter("x", [[1, 2], [3, 4]])) == hash(Filter("x", ((1, 2), (3, 4))))  # type: ignore[arg-type]
    assert bspline(3)([np.inf, -np.inf, 99]).tolist() == [0, 0, 0]
    assert not bspline(3).weights(0.5, 10**12).any()


@pytest.mark.usefixtures("own_table")
@pytest.mark.parametrize(
    "row",
    [bc(0, 1), bc(Fraction(1, 5), 0.25), bc(-0.1, 1e-9), sinc(6), sinc(6, normalized=True), moms3(-0.01)],
    ids=lambda row: row.name,
)
def test_names_of_families_can_be_registered(row: Filter) -> None:
    assert as_filter(register_filter(row).name) is row


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: bc(1e300, 0), "bc(1e+300,0)"),
        (lambda: bc(0, 10**300), "bc(0,1e+300)"),
        (lambda: as_filter("bc(1e39, 0)"), "bc(1e+39,0)"),
        (lambda: from_pieces("mine", [(1e20, -1e20)]), "mine"),
        (lambda: from_callable("peak", lambda x: 1e30 * np.maximum(0, 1 - np.abs(x)), 1), "peak"),
        (lambda: Filter("own", ((1e13,),)), "own"),
    ],
)
def test_weights_beyond_float32_are_rejected_by_the_filter_s_name(make: Callable[[], Filter], name: str) -> None:
    """The compiler of kernels rejected them, in a log of its own."""
    with pytest.raises(OptionError, match=rf"{re.escape(name)}' must be at most 1e\+12") as caught:
        make()
    assert len(str(caught.value)) < 400
    assert Filter("largest", ((10**12,),)).matrix.max() == 1e12
