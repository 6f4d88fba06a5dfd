"""Structural similarity against its definition, window by window."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clvol.analysis import ssim
from clvol.base.errors import DataError, OptionError
from tests.cases import BAD_NUMBERS

RNG = np.random.default_rng(0)
IMAGE = RNG.uniform(10, 200, (14, 13))
NOISY = IMAGE + RNG.normal(0, 30, IMAGE.shape)


def by_definition(a: np.ndarray, b: np.ndarray, span: float) -> float:
    """Eqs 13 to 17 of Wang et al. wherever the window of 11 samples lies within the data."""
    g = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    window = np.ones(())
    for _ in range(a.ndim):
        window = window[..., None] * g
    window = window / window.sum()
    c1, c2 = (0.01 * span) ** 2, (0.03 * span) ** 2
    values = []
    for corner in itertools.product(*(range(n - 10) for n in a.shape)):
        part = tuple(slice(c, c + 11) for c in corner)
        x, y = a[part], b[part]
        mx, my = (window * x).sum(), (window * y).sum()
        vx, vy, cov = (window * (x - mx) ** 2).sum(), (window * (y - my) ** 2).sum(), (window * (x - mx) * (y - my)).sum()
        values.append((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))
    return float(np.mean(values))


def test_it_matches_its_definition() -> None:
    assert ssim(NOISY, IMAGE, 255) == pytest.approx(by_definition(NOISY, IMAGE, 255), abs=1e-12)
    a, b = RNG.uniform(size=(2, 12, 11, 13))
    assert ssim(a, b) == pytest.approx(by_definition(a, b, float(np.ptp(b))), abs=1e-12)
    assert ssim(a[0, 0], b[0, 0], 1.0) == pytest.approx(by_definition(a[0, 0], b[0, 0], 1.0), abs=1e-12)


def test_equal_images_give_one_and_different_ones_less() -> None:
    assert ssim(IMAGE, IMAGE) == pytest.approx(1, abs=1e-12)
    assert ssim(IMAGE.astype(np.float32), IMAGE.astype(int), 200) < 1
    assert 0 < ssim(NOISY, IMAGE) < ssim(IMAGE + 10, IMAGE) < 1


def test_constants_by_hand() -> None:
    """Only the luminance term remains: (2 a b + c1) / (a² + b² + c1)."""
    got = ssim(np.full((20, 20), 3.0), np.full((20, 20), 5.0), 10)
    assert got == pytest.approx((30 + 0.01) / (34 + 0.01), abs=1e-12)


@pytest.mark.parametrize("unit", [1e-320, 1e-200, 1e-81, 1e100, 1e200, 1e305])
def test_units_change_nothing(unit: float) -> None:
    scaled = ssim(NOISY * unit, IMAGE * unit)
    assert scaled == pytest.approx(ssim(NOISY, IMAGE), abs=1e-9 if unit > 1e-300 else 0.1)  # few digits remain of the smallest
    assert -1 <= ssim(NOISY * unit, IMAGE * unit, 1.0) <= 1
    assert ssim(IMAGE * unit, IMAGE * unit, 1e-300) == pytest.approx(1)


def test_data_smaller_than_the_window() -> None:
    assert ssim([[3.0]], [[3.0]], 1.0) == pytest.approx(1)
    small = ssim(NOISY[:3, :2], IMAGE[:3, :2])
    assert -1 < small < 1


@pytest.mark.parametrize(
    ("a", "b", "options", "error"),
    [
        (IMAGE, IMAGE[1:], {}, DataError),
        (3.0, 3.0, {}, DataError),
        (np.ones((2, 2, 2, 2)),) * 2 + ({}, DataError),
        (IMAGE * np.nan, IMAGE, {}, DataError),
        (IMAGE, IMAGE * np.inf, {}, DataError),
        ("a", "b", {}, DataError),
        (np.empty((0, 3)),) * 2 + ({}, DataError),
        (IMAGE, np.ones_like(IMAGE), {}, OptionError),
        *((IMAGE, IMAGE, {"data_range": bad}, OptionError) for bad in (0, *BAD_NUMBERS) if bad is not None),
        *((IMAGE, IMAGE, {"sigma": bad}, OptionError) for bad in (-1, *BAD_NUMBERS)),
        (IMAGE, IMAGE, {"sigma": 1e12}, OptionError),
    ],
)
def test_bad_input_is_rejected(a, b, options, error) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(error):
        ssim(a, b, **options)
