"""The boundary rule is one thing: the index map, the matrix of eq. (11), the reference's extension, the FFT's period."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import reference
from clvol.boundary import Boundary, as_boundary, boundaries
from clvol.errors import DataError, OptionError
from clvol.filter import bspline, filters
from clvol.reference.spline.prefilter import kernel_samples

RULES = tuple(boundaries())
PREFILTERED = {row.name: row for row in (*filters().values(), bspline(7)) if row.prefilter}
LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 40)


def dense(name: str, rule: str, n: int) -> np.ndarray:
    """Eq. (11) written out: row i sums b_k over the samples at i + k, found by walking the rule by hand."""
    b = kernel_samples(PREFILTERED[name])
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
def test_index_map_is_the_walk_and_the_extension(rule: str, n: int) -> None:
    width = 3 * n + 4
    i = np.arange(-width, n + width)
    got = as_boundary(rule).index(i, n)
    assert got.tolist() == [-1 if (j := walk(int(k), rule, n)) is None else j for k in i]
    assert reference.extend(np.arange(1, n + 1), width, rule).tolist() == (got + 1).tolist()


@pytest.mark.parametrize("rule", [r for r in RULES if r != "zero"])
@pytest.mark.parametrize("n", LENGTHS)
def test_extension_repeats_with_the_period(rule: str, n: int) -> None:
    period = as_boundary(rule).length(n)
    assert reference.boundary.period(n, rule) == period
    far = np.array([10**6, -(10**6) - 7, 2**31 + 3])
    np.testing.assert_array_equal(as_boundary(rule).index(far, n), as_boundary(rule).index(far % period, n))


def test_zero_has_no_period() -> None:
    assert as_boundary("zero").length(5) == 0
    assert reference.boundary.period(5, "zero") is None


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", PREFILTERED)
def test_matrix_and_reference_prefilter_solve_the_dense_system(name: str, rule: str) -> None:
    row, rng = PREFILTERED[name], np.random.default_rng(0)
    for n in LENGTHS:
        matrix = dense(name, rule, n)
        np.testing.assert_allclose(as_boundary(rule).matrix(row.samples, n), matrix, atol=1e-12)
        data = rng.normal(size=(n, 3))
        solved = reference.prefilter(data[:, :1], row, rule)[:, 0]
        # along the axis of length 1 the rule holds as well: undo it
        alone = dense(name, rule, 1)[0, 0]
        np.testing.assert_allclose(solved * alone, np.linalg.solve(matrix, data[:, 0]), atol=1e-10, err_msg=f"length {n}")
        line = reference.prefilter(data[:, 0], row, rule)
        np.testing.assert_allclose(matrix @ line, data[:, 0], atol=1e-11, err_msg=f"length {n}")


@pytest.mark.parametrize("rule", [r for r in RULES if r != "zero"])
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


def test_as_boundary() -> None:
    rule = as_boundary("wrap")
    assert as_boundary(rule) is rule
    assert isinstance(rule, Boundary)
    for bad in ("clamp", "", None, 3, ["wrap"]):
        with pytest.raises(OptionError, match="boundary must be one of mirror, reflect, wrap, zero"):
            as_boundary(bad)  # type: ignore[arg-type]


def test_reference_refuses_bad_input() -> None:
    with pytest.raises(OptionError, match="which have a period"):
        reference.prefilter_fft([1.0, 2.0], boundary="zero")
    for bad in (3.0, [], [np.nan], [np.inf], ["a"], [1j]):
        for solve in (reference.prefilter, reference.prefilter_fft):
            with pytest.raises(DataError):
                solve(bad)
    own = Boundary("own", (1, 0), None, "")
    with pytest.raises(OptionError):
        reference.extend(np.ones(3), 1, own)
