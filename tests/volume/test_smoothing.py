"""The choice of λ: its description, its form, and cases that noise does not decide."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol.base.errors import DataError, OptionError
from clvol.volume.smoothing import choose, settled


def noisy(*shape: int, sigma: float = 0.2) -> NDArray[np.float64]:
    """A product of waves, and noise."""
    waves = np.ones(shape)
    for axis, n in enumerate(shape):
        waves *= np.cos(3 * np.linspace(-1, 1, n)).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return waves + sigma * np.random.default_rng(0).normal(size=shape)


def test_the_name_reproduces_the_filter() -> None:
    chosen = choose(noisy(33, 34, 35))
    assert all(value == float(f"{value:.3g}") > 0 for value in chosen.values)
    row = clvol.bspline(3, smoothing=chosen.values)
    assert clvol.filter.table.as_filter(row.name).smoothing == row.smoothing
    assert len(set(chosen.values)) == 1  # the axes do not differ


def test_it_is_reproducible_and_invariant_to_affine_changes() -> None:
    data = noisy(40, 40, 40)
    first = choose(data)
    assert choose(data.copy()) == first
    for scale, offset in ((-2.0, 0.0), (1e5, -3e5), (1e-9, 1.0e-9)):
        assert choose(scale * data + offset).values == pytest.approx(first.values, rel=0.05)
        assert choose(scale * data + offset).sigma == pytest.approx(abs(scale) * first.sigma, rel=0.02)
    assert choose(data.transpose(2, 0, 1)).values == pytest.approx(first.values, rel=0.05)


def test_values_are_in_the_order_of_the_geometry() -> None:
    x = np.linspace(-1, 1, 56)
    data = 0.1 * np.random.default_rng(0).normal(size=(56, 56, 56)) + np.sin(60 * x[:, None, None])  # fast along z
    values = choose(data).values
    assert values[2] < 0.05 < 1 < min(values[:2])
    assert choose(data.transpose(2, 1, 0)).values == pytest.approx(values[::-1], rel=0.05)
    image = choose(data[:, :, 0])
    assert len(image.values) == 2
    assert image.values[1] < 0.1 < image.values[0]


def test_an_axis_of_one_sample_uses_the_others_smoothing() -> None:
    for seed in range(4):
        assert len(set(choose(np.random.default_rng(seed).normal(size=(1, 64, 64))).values)) == 1


@pytest.mark.one_in(4)
@pytest.mark.parametrize("degree", [2, 3, 5, 9])
def test_pure_noise_gets_the_maximum_smoothing(degree: int) -> None:
    volume = clvol.Volume(np.random.default_rng(0).normal(size=(40, 40, 40)))
    row = settled(f"bspline{degree}(auto)", volume)
    drawn = clvol.resample(volume, shape=volume.shape, filter=row).data
    assert float(drawn.std()) < 0.04


@pytest.mark.parametrize(("length", "message"), [(1e300, "at most 17.78 for the spacings"), (18.0, "got 18")])
def test_excessive_smoothing_lengths_are_rejected(length: float, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        settled(clvol.bspline(3, length=length), clvol.Volume(np.zeros((4, 4, 4)), (1, 2, 3)))
    assert max(np.ravel(settled("bspline3(length=17.7)", clvol.Volume(np.zeros((4, 4, 4)), (1, 2, 3))).smoothing)) <= 1e5


@pytest.mark.parametrize("length", ["auto", -1.0, np.nan, (1, 2)])
def test_lengths_are_numbers(length: object) -> None:
    with pytest.raises(OptionError, match="length must be a finite number, at least 0; got"):
        clvol.bspline(3, length=length)  # type: ignore[arg-type]


def test_more_noise_is_smoothed_more() -> None:
    found = [choose(noisy(40, 40, 40, sigma=sigma)).values[0] for sigma in (0.05, 0.2, 0.8)]
    assert 0 < found[0] < found[1] < found[2] <= 1000


@pytest.mark.one_in(4)
@pytest.mark.parametrize("degree", range(2, 10))
def test_degrees_smooth_alike(degree: int) -> None:
    def half(degree: int, value: float) -> float:
        """The frequency with a response of one half."""
        omega = np.linspace(0, np.pi, 20_001)
        row = clvol.bspline(degree, smoothing=value)
        plain = clvol.bspline(degree)
        k, j = np.arange(len(row.undone)), np.arange(len(plain.samples))
        weight = np.where(k > 0, 2, 1) * row.undone
        kept = (np.cos(np.outer(omega, j)) @ (np.where(j > 0, 2, 1) * plain.samples)) / (np.cos(np.outer(omega, k)) @ weight)
        return float(omega[np.argmax(kept < 0.5)])

    labels = (noisy(40, 40, 40, sigma=0) > 0.4).astype(np.uint8)
    assert half(degree, choose(labels, degree).values[0]) == pytest.approx(half(3, 0.5), rel=1e-2)
    truth, volume = noisy(40, 40, 40, sigma=0), clvol.Volume(noisy(40, 40, 40))
    errors = [
        float(np.sqrt(((clvol.resample(volume, shape=volume.shape, filter=f"bspline{n}(auto)").data - truth) ** 2).mean()))
        for n in (3, degree)
    ]
    assert errors[1] < 1.1 * errors[0] < 0.1 * 0.2


@pytest.mark.parametrize("degree", [1, 10, 2.5, "3", None])
def test_other_degrees_are_rejected(degree: object) -> None:
    with pytest.raises(OptionError, match="degree"):
        choose(noisy(9, 9, 9), degree)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("data", "values", "reason"),
    [
        (np.zeros((4, 5)), (0, 0), "no noise"),
        (np.ones((1, 1, 1), np.uint8), (0, 0, 0), "no noise"),
        (noisy(32, 32, 32, sigma=0), (0, 0, 0), "no noise"),
        (noisy(32, 32, 32, sigma=1e-3), (0, 0, 0), "white noise, σ = 0.00"),
        (noisy(48, 48, 48, sigma=0) > 0.5, (0.5, 0.5, 0.5), "two values"),
        ((3 * noisy(64, 64, sigma=0)).round(), (0.5, 0.5), "few values"),
    ],
)
def test_reasons(data: NDArray[np.float64], values: tuple[float, ...], reason: str) -> None:
    chosen = choose(data)
    assert chosen.values == values
    assert chosen.reason.startswith(reason)


def test_a_mask_adds_to_the_smoothing_for_noise() -> None:
    x = np.linspace(-1, 1, 48)
    inside = x[:, None, None] ** 2 + x[:, None] ** 2 + x**2 < 0.5
    little = choose(np.where(inside, 2 + noisy(48, 48, 48, sigma=0.01), 0))
    assert little.values == (0.2, 0.2, 0.2)
    assert "background of exactly 0" in little.reason
    much = choose(np.where(inside, 2 + noisy(48, 48, 48, sigma=2), 0))
    assert min(much.values) > 0.2


def test_samples_that_are_not_finite_are_left_out() -> None:
    noisy = np.random.default_rng(7).normal(10, 1, (32, 32, 32)) + 5 * np.sin(np.indices((32, 32, 32)).sum(0) / 6)
    some = noisy.copy()
    some[:, 20:, :12] = np.nan
    (chosen, *_), (known, *_) = choose(some).values, choose(noisy).values
    assert chosen > 0
    assert chosen == pytest.approx(known, rel=0.3)
    with pytest.raises(DataError, match="finite"):
        choose(np.array([[np.nan, np.nan]]))


def test_indicators_of_labels() -> None:
    labels = np.arange(24).reshape(2, 3, 4) % 5
    volume = clvol.Volume(labels, (1, 2, 3), units="mm")
    found = volume.indicator(1, 4)
    assert found.data.dtype == np.float32
    np.testing.assert_array_equal(found.data, (labels == 1) | (labels == 4))
    assert (found.spacing, found.units) == (volume.spacing, "mm")
    assert not volume.indicator(77).data.any()
    large = clvol.Volume(np.array([[2**63 + 1, 2**63 + 2]], np.uint64))
    np.testing.assert_array_equal(large.indicator(2**63 + 2).data, [[0, 1]])
    for wrong in ((), ("1",), (np.nan,), (True,)):
        with pytest.raises(OptionError, match="indicator"):
            volume.indicator(*wrong)  # type: ignore[arg-type]
