"""The exact sinc: as a finite Fourier sum, as the FFT's magnification, and as a volume to render."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import reference
from clvol.analysis import dirichlet_kernel, dirichlet_magnify, dirichlet_sample, sinc_volume
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.phantoms import marschner_lobb
from clvol.volume.volume import Volume
from tests.cases import BAD_COUNTS, BAD_FILTERS, BAD_REALS, every

RULES = ("mirror", "reflect", "wrap")
RNG = np.random.default_rng(0)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 40, 41])
def test_kernel_is_its_fourier_sum_with_half_the_nyquist_term_on_each_side(n: int, derivative: int) -> None:
    x = np.concatenate([RNG.uniform(-3 * n, 3 * n, 300), [0, 1, n, -n, 0.5, 1e-9, -1e-5, 0.09, 0.11, n / 2]])
    k = np.arange(-(n // 2), n // 2 + 1)
    weight = np.where((n % 2 == 0) & (np.abs(k) == n // 2), 0.5, 1.0) / n
    wanted = (np.exp(2j * np.pi * x[:, None] * k / n) * (2j * np.pi * k / n) ** derivative) @ weight
    got = dirichlet_kernel(x, n, derivative)
    np.testing.assert_allclose(wanted.imag, 0, atol=1e-13)
    np.testing.assert_allclose(got, wanted.real, rtol=0, atol=1e-13)


def test_kernel_is_one_at_its_sample_and_approaches_the_sinc() -> None:
    np.testing.assert_allclose(dirichlet_kernel(np.arange(8), 8), np.eye(8)[0], atol=1e-15)
    x = np.linspace(-5, 5, 101)
    np.testing.assert_allclose(dirichlet_kernel(x, 4001), np.sinc(x), atol=1e-5)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (8,), (5, 6), (1, 3), (3, 4, 5)])
@pytest.mark.parametrize("factor", [1, 2, 3])
def test_magnification_is_sampling_on_the_finer_grid(rule: str, shape: tuple[int, ...], factor: int) -> None:
    data = RNG.normal(size=shape)
    fine = dirichlet_magnify(data, factor, rule)
    axes = [(np.arange(n) + 0.5) / factor - 0.5 if rule == "reflect" else np.arange(n) / factor for n in fine.shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij")[::-1], -1)
    np.testing.assert_allclose(fine, dirichlet_sample(data, points, rule), atol=1e-12)
    assert fine.shape == tuple(factor * (n - 1) + 1 if rule == "mirror" else factor * n for n in shape)
    if rule != "reflect" or factor % 2:
        keep = (slice(factor // 2 if rule == "reflect" else 0, None, factor),) * data.ndim
        np.testing.assert_allclose(fine[keep], data, atol=1e-13)


@pytest.mark.parametrize("n", [9, 10])
def test_band_limited_data_and_slopes_are_exact(n: int) -> None:
    omega = 2 * np.pi * np.arange(1, 5) / n
    x = RNG.uniform(-n, 2 * n, 50)
    samples = sum(np.cos(w * np.arange(n) + k) for k, w in enumerate(omega))
    np.testing.assert_allclose(
        dirichlet_sample(samples, x[:, None], "wrap"), sum(np.cos(w * x + k) for k, w in enumerate(omega)), atol=1e-12
    )
    slope = sum(-w * np.sin(w * x + k) for k, w in enumerate(omega))
    np.testing.assert_allclose(dirichlet_sample(samples, x[:, None], "wrap", 1)[:, 0], slope, atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_gradients_match_numeric_ones_in_the_world(rule: str) -> None:
    rotation = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    volume = Volume(RNG.normal(size=(4, 5, 6)), (0.7, 1.3, 2.1), (3.0, -5.0, 7.0), rotation)
    points = volume.index_to_world(RNG.uniform(0, 3, (20, 3)))
    h = 1e-5
    ahead, behind = (
        np.stack([dirichlet_sample(volume, points + sign * step, rule) for step in h * np.eye(3)], -1) for sign in (1, -1)
    )
    numeric = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(dirichlet_sample(volume, points, rule, 1), numeric, atol=1e-7)
    assert dirichlet_sample(volume, points[0], rule).shape == ()
    assert dirichlet_sample(volume, points[None], rule, 1).shape == (1, 20, 3)


def test_the_residual_of_the_spline_is_stated_and_falls_with_the_fourth_power() -> None:
    volume = marschner_lobb(21)
    stated = [sinc_volume(volume, factor) for factor in (2, 4)]
    assert stated[1].rms < stated[0].rms / 12
    assert stated[1].rms < stated[1].maximum < stated[0].maximum
    points = RNG.uniform(-1, 1, (4000, 3))
    difference = reference.sample(stated[1].volume, points) - dirichlet_sample(volume, points)
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(stated[1].rms, rel=0.3)


@pytest.mark.parametrize("rule", RULES)
def test_the_volume_keeps_its_placement(rule: str) -> None:
    rotation = np.linalg.qr(RNG.normal(size=(2, 2)))[0]
    volume = Volume(RNG.normal(size=(6, 7)), (0.5, 2.0), (1.0, -3.0), rotation, "mm")
    got = sinc_volume(volume, 3, "bspline5", rule)
    assert (got.filter, got.boundary, got.volume.units, got.volume.data.dtype) == ("bspline5", rule, "mm", np.float64)
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in got.volume.shape), indexing="ij")[::-1], -1)
    wanted = dirichlet_sample(volume, got.volume.index_to_world(lattice), rule)
    np.testing.assert_allclose(got.volume.data, wanted, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: dirichlet_kernel(0.0, 0), OptionError),
        (lambda: dirichlet_kernel(np.nan, 3), OptionError),
        (lambda: dirichlet_kernel(0.5, 10**12), OptionError),
        (lambda: dirichlet_magnify(np.ones((9, 9)), 10**9), OutOfMemoryError),
        (lambda: sinc_volume([[1.0]], 2, points=10**13), OutOfMemoryError),
        (lambda: dirichlet_kernel(0.0, 3, 2), OptionError),
        (lambda: dirichlet_magnify([1.0], 2, "zero"), OptionError),
        (lambda: dirichlet_magnify([np.nan], 2), DataError),
        (lambda: dirichlet_magnify(["a"], 2), DataError),
        (lambda: dirichlet_magnify([], 2), DataError),
        (lambda: dirichlet_magnify(np.ones((1,) * 4), 2), DataError),
        (lambda: dirichlet_sample([1.0], [[0.0, 0.0]]), OptionError),
        (lambda: dirichlet_sample([1.0], 0.0), OptionError),
        (lambda: dirichlet_sample([1.0], [[np.inf]]), OptionError),
        (lambda: dirichlet_sample([[1.0]], [[0.0]]), OptionError),
        (lambda: dirichlet_sample([1.0], [[0.0]], "mirror", 2), OptionError),
        (lambda: dirichlet_sample([[1.0]], [[0.0, 0.0]], "zero"), OptionError),
        (lambda: sinc_volume([[1.0]], 2, boundary="zero"), OptionError),
        (lambda: sinc_volume([1.0]), DataError),
        (lambda: sinc_volume([[np.inf]]), DataError),
    ],
)
def test_bad_input_is_rejected(call, error) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(error):
        call()


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        x=(lambda v: dirichlet_kernel(v, 3), BAD_REALS),
        n=(lambda v: dirichlet_kernel(0.0, v), BAD_COUNTS),
        factor=(lambda v: dirichlet_magnify([1.0], v), BAD_COUNTS),
        points=(lambda v: sinc_volume([[1.0]], points=v), BAD_COUNTS),
        magnification=(lambda v: sinc_volume([[1.0]], v), BAD_COUNTS),
        filter=(lambda v: sinc_volume([[1.0]], 2, v), BAD_FILTERS),
    ),
)
def test_bad_values_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(OptionError):
        call(bad)
