"""The boundary rule in one place: the index map, the matrix of eq. (11), the reference's extension, the FFT's period."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol import reference
from clvol.base.errors import DataError, OptionError
from clvol.device import Device
from clvol.filter.boundary import Boundary, as_boundary, boundaries
from clvol.filter.make import bspline
from clvol.filter.table import as_filter, filters
from clvol.reference.spline.boundary import period as period_of
from clvol.reference.spline.prefilter import kernel_samples
from tests.cases import SMOOTHED

RULES = tuple(name for name, row in boundaries().items() if row.outside == "rule")  # it depends on the index rule alone
PREFILTERED = {row.name: row for row in (*filters().values(), bspline(7), *map(as_filter, SMOOTHED)) if row.prefilter}
LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 40)


def dense(name: str, rule: str, n: int) -> np.ndarray:
    """Eq. (11) written out: row i sums b_k over the samples at i + k, found by walking the rule by hand.

    Smoothing adds λ times the differences of order 2m.
    """
    row = PREFILTERED[name]
    m, b = row.penalty, kernel_samples(row)
    if row.smoothing:
        differences = float(row.smoothing) * np.poly([1] * 2 * m)[m:] * (-1) ** m
        b = np.pad(b, (0, differences.size - b.size)) + differences
    matrix = np.zeros((n, n))
    for i in range(n):
        for k in range(1 - b.size, b.size):
            j = walk(i + k, rule, n)
            if j is not None:
                matrix[i, j] += b[abs(k)]
    return matrix


def walk(i: int, rule: str, n: int) -> int | None:
    """One reflection or step of a period at a time."""
    while not 0 <= i < n:
        if rule == "zero":
            return None
        if rule == "wrap":
            i += n if i < 0 else -n
        elif rule == "reflect":
            i = -1 - i if i < 0 else 2 * n - 1 - i
        elif n == 1:
            i = 0
        else:
            i = -i if i < 0 else 2 * (n - 1) - i
    return i


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("n", LENGTHS)
def test_index_map_matches_the_walk_and_the_extension(rule: str, n: int) -> None:
    width = 3 * n + 4
    i = np.arange(-width, n + width)
    got = as_boundary(rule).index(i, n)
    assert got.tolist() == [-1 if (j := walk(int(k), rule, n)) is None else j for k in i]
    assert reference.extend(np.arange(1, n + 1), width, rule).tolist() == (got + 1).tolist()


@pytest.mark.parametrize("rule", [r for r in RULES if r != "zero"])
@pytest.mark.parametrize("n", LENGTHS)
def test_extension_repeats_with_the_period(rule: str, n: int) -> None:
    period = as_boundary(rule).length(n)
    assert period_of(n, rule) == period
    far = np.array([10**6, -(10**6) - 7, 2**31 + 3])
    np.testing.assert_array_equal(as_boundary(rule).index(far, n), as_boundary(rule).index(far % period, n))


def test_zero_has_no_period() -> None:
    assert as_boundary("zero").length(5) == 0
    assert period_of(5, "zero") is None


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", PREFILTERED)
def test_matrix_and_reference_prefilter_solve_the_dense_system(name: str, rule: str) -> None:
    row, rng = PREFILTERED[name], np.random.default_rng(0)
    for n in LENGTHS:
        matrix = dense(name, rule, n)
        np.testing.assert_allclose(as_boundary(rule).matrix(row.undone, n), matrix, atol=1e-12)
        data = rng.normal(size=(n, 3))
        solved = reference.prefilter(data[:, :1], row, rule)[:, 0]
        # along the axis of length 1 the rule holds as well: undo it
        alone = dense(name, rule, 1)[0, 0]
        np.testing.assert_allclose(solved * alone, np.linalg.solve(matrix, data[:, 0]), atol=1e-10, err_msg=f"length {n}")
        line = reference.prefilter(data[:, 0], row, rule)
        np.testing.assert_allclose(matrix @ line, data[:, 0], atol=1e-11, err_msg=f"length {n}")


@pytest.mark.parametrize("rule", [r for r in (*boundaries(), "grid-constant(2)") if r != "zero"])
@pytest.mark.parametrize("name", PREFILTERED)
def test_prefilter_is_the_division_of_eq_13(name: str, rule: str) -> None:
    rng = np.random.default_rng(1)
    for shape in ((1,), (2,), (3,), (17,), (6, 7), (1, 5), (4, 5, 3)):
        data = rng.normal(size=shape)
        np.testing.assert_allclose(
            reference.prefilter_fft(data, PREFILTERED[name], rule),
            reference.prefilter(data, PREFILTERED[name], rule),
            atol=1e-10,
            err_msg=str(shape),
        )


def test_wrap_is_the_matrix_printed_in_eq_11() -> None:
    wanted = np.diag([4.0] * 6) + np.diag([1.0] * 5, 1) + np.diag([1.0] * 5, -1)
    wanted[0, -1] = wanted[-1, 0] = 1
    np.testing.assert_allclose(as_boundary("wrap").matrix(bspline(3).samples, 6), wanted / 6)


def test_prefilter_of_a_row_without_one_is_the_samples() -> None:
    data = np.random.default_rng(2).integers(0, 9, (3, 4))
    for name in ("linear", "mitchell", "bspline3-approx", "sinc"):
        np.testing.assert_array_equal(reference.prefilter(data, name), data)
        np.testing.assert_array_equal(reference.prefilter_fft(data, name), data)
    np.testing.assert_array_equal(reference.prefilter(data, "hybrid"), reference.prefilter(data, "bspline3"))


@pytest.mark.parametrize("rule", boundaries())
@pytest.mark.parametrize("n", LENGTHS)
def test_positions_are_mapped_to_equivalent_ones(rule: str, n: int) -> None:
    boundary, rng = as_boundary(rule), np.random.default_rng(n)
    x = np.concatenate([rng.uniform(-3 * n - 30, 4 * n + 30, 100), rng.uniform(-50 * n, 50 * n, 50), [1e18, -1e30]])
    got, sign = boundary.position(x, n, 12, 3)
    step = 1e-4
    slope = (boundary.position(x[:-2] + step, n, 12, 3)[0] - boundary.position(x[:-2] - step, n, 12, 3)[0]) / (2 * step)
    smooth = np.abs(np.abs(slope) - 1) < 1e-4  # neither a turn nor a jump in between
    np.testing.assert_allclose(sign[:-2][smooth], slope[smooth], atol=1e-4)
    assert smooth.mean() > 0.9 or n == 1
    if rule in ("zero", "nearest", "grid-constant"):
        beyond = (x < -15) | (x > n - 1 + 15)
        np.testing.assert_array_equal(got[~beyond], x[~beyond])
        assert ((got >= -16) & (got <= n + 15)).all()
        np.testing.assert_allclose(got - np.floor(got), x - np.floor(x), atol=1e-12)
        return
    if rule == "constant":
        np.testing.assert_array_equal(got, x)
        return
    assert ((got >= -1) & (got <= n)).all()
    inside = (x >= 0) & (x <= n - 1)
    np.testing.assert_array_equal(got[inside], x[inside])
    period = max(n - 1, 1) if rule == "overlap" else boundary.length(n)
    near, there = x[:-2], got[:-2]
    if rule == "overlap":
        assert ((there >= 0) & (there <= max(n - 1, 1))).all()

    def whole(difference: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(difference / period - np.round(difference / period)) < 1e-8)

    same = whole(near - there)
    if rule in ("mirror", "reflect"):
        same |= whole(near + there + (0 if rule == "mirror" else 1))
    assert same.all()


def test_as_boundary() -> None:
    rule = as_boundary("wrap")
    assert as_boundary(rule) is rule
    assert isinstance(rule, Boundary)
    for bad in ("clamp", "", None, 3, ["wrap"]):
        with pytest.raises(OptionError, match="boundary must be one of mirror, reflect, wrap, zero, nearest, constant"):
            as_boundary(bad)  # type: ignore[arg-type]


def test_values_outside() -> None:
    rule = as_boundary("constant(-2.5)")
    assert (rule.name, rule.cval, rule.outside) == ("constant(-2.5)", -2.5, "constant")
    assert as_boundary("grid-constant(1e3)").cval == 1000
    assert [as_boundary(name).cval for name in ("constant", "grid-constant")] == [0, 0]
    for bad in ("constant()", "constant(a)", "mirror(3)", "constant(1,2)", "constant(1"):
        with pytest.raises(OptionError, match="bound"):
            as_boundary(bad)


def test_constant_rules_need_a_finite_prefilter() -> None:
    with pytest.raises(OptionError, match="must have a period"):
        Boundary("own", None, None, "", "clamp")
    with pytest.raises(OptionError, match="outside must be one of"):
        Boundary("own", (1, 0), None, "", "edge")  # type: ignore[arg-type]
    for bad in ("5", None, True):
        with pytest.raises(OptionError, match="cval must be a number"):
            Boundary("own", (1, 0), None, "", "constant", bad)  # type: ignore[arg-type]


def test_reference_rejects_bad_input() -> None:
    with pytest.raises(OptionError, match="whose prefilter has a period"):
        reference.prefilter_fft([1.0, 2.0], boundary="zero")
    for bad in (3.0, [], [np.nan], [np.inf], ["a"], [1j]):
        for solve in (reference.prefilter, reference.prefilter_fft):
            with pytest.raises(DataError):
                solve(bad)
    own = Boundary("own", (1, 0), None, "")
    with pytest.raises(OptionError):
        reference.extend(np.ones(3), 1, own)


def says_one_sample(period: tuple[int, int] | None, fold: int | None, n: int) -> bool:
    """Whether every index near an axis of `n` maps to one of its samples, and each sample to itself, by walking the rule."""
    if period is None:
        return fold is None
    length = max(1, period[0] * n + period[1])
    reach = range(-3 * length - 9, 3 * length + 10)
    for i in range(n):
        seen, ahead = {i}, [i]
        while ahead:  # all indices that the rule says are the same
            j = ahead.pop()
            near = [j + length, j - length] + ([] if fold is None else [-fold - j])
            new = {k for k in near if k in reach} - seen
            seen |= new
            ahead += new
        if sum(0 <= j < n for j in seen) != 1:
            return False
    return True


def covers(period: tuple[int, int], fold: int | None, n: int) -> bool:
    """Whether a period consists of samples and their images."""
    length = max(1, period[0] * n + period[1])
    images = {i % length for i in range(n)}
    if fold is not None:
        images |= {(-fold - i) % length for i in range(n)}
    return images == set(range(length))


def test_accepted_rules_map_each_index_to_one_sample() -> None:
    """All small periods and folds, checked on axes of many lengths without the class."""
    for period in [None, *((a, b) for a in range(-1, 5) for b in range(-4, 5))]:
        for fold in (None, *range(-4, 5)):
            wanted = all(says_one_sample(period, fold, n) and (period is None or covers(period, fold, n)) for n in range(1, 13))
            if not wanted:
                with pytest.raises(OptionError, match="must give every index one of the samples"):
                    Boundary("own", period, fold, "")
                continue
            rule = Boundary("own", period, fold, "")
            for n in range(1, 13):
                index = rule.index(np.arange(-50, 60), n)
                assert index.min() >= (0 if period else -1)
                assert index.max() < n
                np.testing.assert_array_equal(index[50 : 50 + n], np.arange(n))


WRONG: list[tuple[Any, Any]] = [((1, 5), None), ((10**30, 0), None), ((2, 0), 10**30), ((2, 0), 1.0), ((2, 0), True), (None, 0)]
WRONG += [(period, None) for period in ((1,), (1, 0, 0), (1.0, 0), "10", 3)]


@pytest.mark.parametrize(("period", "fold"), WRONG)
def test_invalid_rules_are_rejected(period: Any, fold: Any) -> None:
    with pytest.raises(OptionError, match="a boundary's"):
        Boundary("own", period, fold, "")


def test_names_are_strings() -> None:
    with pytest.raises(OptionError, match="a boundary's name must be a string; got 3"):
        Boundary(3, None, None, "")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="a boundary's description must be a string; got None"):
        Boundary("own", None, None, None)  # type: ignore[arg-type]
    assert Boundary("own", [2, np.int64(-1)], np.int32(0), "").period == (2, -1)  # type: ignore[arg-type]


@pytest.mark.one_in(8)
@pytest.mark.parametrize(("period", "fold"), [((2, -1), 0), ((2, -1), 1)])
@pytest.mark.parametrize("filter", ["linear", "bspline3", "bspline5", "hybrid"])
def test_a_rule_that_mirrors_and_reflects_matches_a_longer_axis(device: Device, filter: str, period: Any, fold: int) -> None:
    """Half of an axis that is reflected, or mirrored, as a whole."""
    own = Boundary("own", period, fold, "mirrored at one end, reflected at the other")
    line = np.random.default_rng(3).random((1, 7, 1))
    twice, before = ([6, 5, 4, 3, 2, 1, 0, 1, 2, 3, 4, 5, 6], 6) if fold == 0 else ([0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0], 0)
    points = np.random.default_rng(4).uniform(-20, 27, (200, 3))
    # along x and z lines are constant: there every rule is the same
    got = clvol.sample(np.broadcast_to(line, (6, 7, 5)), points, filter, own, device=device)
    want = clvol.sample(
        np.broadcast_to(line[:, twice], (6, 13, 5)), points + np.array([0, before, 0]), filter, "reflect", device=device
    )
    np.testing.assert_allclose(got, want, atol=3e-6)


def test_linear_in_the_outer_half_voxel(device: Device) -> None:
    """As docs/function.md states: "reflect" equals the clamp of ITK and VTK there; and the difference of "mirror" on noise."""
    data, last = np.random.default_rng(5).random((20, 21, 22)), np.array([21, 20, 19])
    points = np.random.default_rng(6).uniform(-0.5, last + 0.5, (40_000, 3))
    clamped = clvol.sample(data, np.clip(points, 0, last), "linear", device=device)
    np.testing.assert_allclose(clvol.sample(data, points, "linear", "reflect", device=device), clamped, atol=1e-6)
    off = np.abs(clvol.sample(data, points, "linear", "mirror", device=device) - clamped)
    outer = (np.abs(points - last / 2) > last / 2).sum(1)
    assert off[outer == 0].max() < 1e-6
    assert 0.35 < off[outer == 1].max() < 0.5  # half the difference of two samples in 0…1
    assert np.sqrt(np.mean(off[outer > 0] ** 2)) == pytest.approx(0.08, abs=0.005)


@pytest.mark.parametrize("cval", [10**400, np.complex64(1), 1j, [0.0], None], ids=str)
def test_outside_values_beyond_float64_are_rejected(cval: Any) -> None:
    with pytest.raises(OptionError, match="cval must be a number"):
        Boundary("own", (2, -2), 0, "", "constant", cval)
