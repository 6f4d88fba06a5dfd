"""Noise estimates, on samples with known noise."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft, ndimage

import clvol
from clvol.base.errors import DataError
from clvol.noise import Noise, _cosine_transform, estimate


def gaussian(*shape: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=shape)


def ball(n: int = 48, radius: float = 0.6) -> NDArray[np.bool_]:
    p = np.linspace(-1, 1, n)
    return np.asarray(p[:, None, None] ** 2 + p[:, None] ** 2 + p**2 < radius**2)


def test_a_volume_remembers_its_noise() -> None:
    volume = clvol.Volume(gaussian(20, 21, 22))
    assert volume.noise is volume.noise
    assert volume.noise == estimate(volume.data)
    assert isinstance(volume.noise, Noise)
    assert pickle.loads(pickle.dumps(volume)).noise == volume.noise


@pytest.mark.parametrize("shape", [(40, 44, 48), (150, 170), (9, 60, 60), (3, 100, 90), (70, 1, 80)])
def test_white_noise(shape: tuple[int, ...]) -> None:
    noise = estimate(5 + 0.3 * gaussian(*shape))
    assert noise.kind == "white"
    assert noise.sigma == pytest.approx(0.3, rel=0.1)
    assert (noise.gain, set(noise.colour), noise.background) == (0, {1.0}, None)
    assert len(noise.colour) == len(shape)


@pytest.mark.parametrize("scale", [1.0, -3.0, 1e-6, 1e12])
def test_affine_changes_of_values(scale: float) -> None:
    data = ball() + 0.2 * gaussian(48, 48, 48)
    there, back = estimate(data), estimate(scale * data + 7 * scale)
    assert back.kind == there.kind
    assert back.sigma == pytest.approx(abs(scale) * there.sigma, rel=0.02)


def test_permuted_and_flipped_axes() -> None:
    data = ball() + 0.2 * gaussian(48, 48, 48)
    there = estimate(data)
    for other in (data.transpose(1, 2, 0), data.transpose(2, 1, 0)):
        assert estimate(other).sigma == pytest.approx(there.sigma, rel=1e-3)
    assert estimate(data[::-1, :, ::-1]).sigma == pytest.approx(there.sigma, rel=0.05)


def test_noise_that_grows_with_the_value() -> None:
    ramp = np.broadcast_to(np.linspace(10, 200, 60), (60, 60, 60))
    noise = estimate(np.random.default_rng(1).poisson(ramp))
    assert noise.kind == "signal-dependent"
    assert noise.gain == pytest.approx(1, rel=0.15)
    assert noise.sigma == pytest.approx(np.sqrt(ramp.mean()), rel=0.05)
    assert noise.step == 1
    electrons = estimate(3 * np.random.default_rng(1).poisson(ramp).astype(np.float32) - 100)
    assert electrons.gain == pytest.approx(3 * noise.gain, rel=1e-3)


def test_noise_that_is_correlated_along_an_axis() -> None:
    data = ndimage.gaussian_filter1d(gaussian(72, 72, 72), 0.6, axis=2, mode="wrap")
    noise = estimate(data)
    assert noise.kind == "correlated"
    assert noise.colour[1:] == (1, 1)
    # the power of halves of the band, by the transform itself
    power = (np.abs(fft.fft(data, axis=2)) ** 2).mean((0, 1))
    lower, upper = np.r_[power[:18], power[-17:]].mean(), power[18:55].mean()
    assert noise.colour[0] == pytest.approx(lower / upper, rel=0.3)
    assert noise.sigma == pytest.approx(data.std(), rel=0.1)


def test_the_spectrum_contains_all_variance_and_its_noise() -> None:
    data = 4 * ball() + 0.5 * gaussian(48, 48, 48)
    spectrum = estimate(data).spectrum
    assert spectrum.power.sum() == pytest.approx((data / np.ptp(data)).var(), rel=1e-5)
    assert np.prod([share.sum() for share in spectrum.noise]) == pytest.approx((0.5 / np.ptp(data)) ** 2, rel=0.05)
    assert spectrum.power.shape == tuple(map(len, spectrum.frequencies)) == tuple(map(len, spectrum.noise))
    assert all((np.diff(omega) > 0).all() and 0 == omega[0] < omega[-1] < np.pi for omega in spectrum.frequencies)


@pytest.mark.parametrize("value", [0.0, -1000.0, 3.5])
def test_a_masked_background(value: float) -> None:
    inside = ball()
    noise = estimate(np.where(inside, value + 40 + gaussian(48, 48, 48), value))
    assert noise.masked
    assert noise.background == value
    assert noise.background_share == pytest.approx(1 - inside.mean())
    assert noise.sigma == pytest.approx(1, rel=0.12)
    assert noise.jump > 5


def test_a_gradual_background_is_not_a_mask() -> None:
    x = np.linspace(-1, 1, 64)
    bump = np.exp(-(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) / 0.1)
    cut = (bump - 0.1).clip(0)
    noise = estimate(cut)
    assert noise.background == 0
    assert not noise.masked
    assert noise.clipped[0] == pytest.approx((cut == 0).mean())
    assert noise.sigma < 1e-4


def test_low_photon_counts_are_not_background() -> None:
    assert estimate(np.random.default_rng(0).poisson(3, (40, 40, 40))).background is None


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_two_values(dtype: type) -> None:
    noise = estimate(ball().astype(dtype))
    assert (noise.kind, noise.sigma, noise.distinct) == ("binary", 0, 2)


def test_labels_and_other_data() -> None:
    labels = ball().astype(np.int16) * 7 + ball(radius=0.3) * 20
    assert estimate(labels).kind == "labels"
    averaged = ndimage.zoom(ball(96).astype(float), 0.5, order=1) * 200
    assert estimate(ndimage.uniform_filter(averaged, 2)).kind == "none"
    noisy = np.round(labels + 3 * gaussian(48, 48, 48)).astype(np.int16)
    assert estimate(noisy).kind == "white"
    assert estimate(np.random.default_rng(0).integers(0, 2, (40, 40, 40))).kind == "white"


@pytest.mark.parametrize("shape", [(1, 1), (1, 1, 1), (4, 5, 6), (1, 9, 3)])
def test_too_few_samples_give_no_estimate(shape: tuple[int, ...]) -> None:
    for data in (gaussian(*shape), np.zeros(shape), np.zeros(shape, np.uint8)):
        noise = estimate(data)
        assert (noise.kind, noise.sigma) == ("none", 0)


@pytest.mark.parametrize("dtype", [">f4", "<f8", np.float16, np.longdouble, ">i2", np.uint16, np.int64])
def test_types_of_samples(dtype: Any) -> None:
    data = 1000 + 30 * gaussian(30, 30, 30)
    assert estimate(data.astype(dtype)).sigma == pytest.approx(estimate(data).sigma, rel=0.02)
    assert estimate(np.asfortranarray(data).astype(dtype)[:, ::-1]).sigma == pytest.approx(30, rel=0.1)


@pytest.mark.parametrize("scale", [1.7e308, 1e-310])
def test_ranges_near_the_limits_of_float64(scale: float) -> None:
    data = np.random.default_rng(0).uniform(-1, 1, (24, 24, 24))
    assert estimate(data * scale).sigma == pytest.approx(scale / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_are_left_out(bad: float) -> None:
    data = gaussian(40, 30, 32)
    known = clvol.Volume(data).noise
    data[10:20, 4:25, 5:25] = bad
    noise = clvol.Volume(data).noise
    assert (noise.kind, noise.background, noise.masked) == (known.kind, None, False)
    assert noise.sigma == pytest.approx(known.sigma, rel=0.1)
    with pytest.raises(DataError, match=r"finite.*Volume\.filled"):
        estimate(data)
    with pytest.raises(DataError, match="samples must be finite for their noise"):
        _ = clvol.Volume(np.full_like(data, bad)).noise


def test_large_volumes_are_not_copied(tmp_path: Path) -> None:
    tile = gaussian(96, 96, 96).astype(np.float32)
    endless = np.lib.stride_tricks.as_strided(tile, (3_000_000, 96, 96), (0, *tile.strides[1:]))  # 110 GB, if it were copied
    assert estimate(endless).kind in ("white", "correlated", "none")
    file = np.lib.format.open_memmap(tmp_path / "a.npy", "w+", ">u2", (130, 140, 150))
    file[:] = np.random.default_rng(0).normal(500, 20, file.shape)
    noise = estimate(np.load(tmp_path / "a.npy", mmap_mode="r"))
    assert noise.sigma == pytest.approx(20, rel=0.05)
    assert noise.spectrum.power.size <= 64**3


def test_the_description_is_plain() -> None:
    noise = estimate(gaussian(20, 20, 20))
    assert dataclasses.is_dataclass(noise)
    assert "spectrum" not in repr(noise)
    with pytest.raises(dataclasses.FrozenInstanceError):
        noise.sigma = 1.0  # type: ignore[misc]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("dtype", "offset"), [(np.int64, -50), (np.int64, -(2**63)), (np.int64, 2**62), (np.uint64, 2**63 + 2**62)]
)
def test_integers_far_from_zero_keep_their_noise(dtype: type[np.integer[Any]], offset: int) -> None:
    data = np.rint(50 + 5 * gaussian(24, 24, 24)).astype(np.int64)
    there = estimate(data)
    far = estimate((data.astype(np.uint64) + np.uint64(offset % 2**64)).astype(dtype))  # differences of neighbours round in float64
    assert there.sigma == pytest.approx(5, rel=0.2)
    assert (far.sigma, far.step, far.distinct) == (there.sigma, 1, there.distinct)


def test_waves_longer_than_a_block_are_found_at_their_frequency() -> None:
    """White noise and one wave: its cell has the wave's power, the others the noise's."""
    n, wave, sigma = 192, 6, 0.5
    x = np.cos(np.pi * wave * (np.arange(n) + 0.5) / n)
    data = x[:, None, None] * x[:, None] * x + sigma * gaussian(n, n, n)
    noise = estimate(data.astype(np.float32))
    found = noise.spectrum
    unit = sigma**2 / np.prod([share.sum() for share in found.noise])
    cell = tuple(int(np.argmin(np.abs(omega - np.pi * wave / n))) for omega in found.frequencies)
    assert unit * found.power[cell] == pytest.approx(1 / 8, rel=0.1)
    near = found.power[tuple(slice(max(c - 3, 0), c + 4) for c in cell)].sum() - found.power[cell]
    assert unit * near < 0.002


def test_means_detect_what_blocks_miss() -> None:
    data = gaussian(128, 112, 96).astype(np.float32)
    data[0, 0, 0] = np.nan  # beside the blocks
    with pytest.raises(DataError, match="finite"):
        estimate(data)
    data[0, 0, 0] = 1e30
    assert estimate(data).sigma == pytest.approx(1, rel=0.1)


def test_blocks_represent_a_large_volume() -> None:
    """The fraction of a central object, which blocks crowded there would overestimate, and its photon noise."""
    inside = ball(176)
    data = np.random.default_rng(0).poisson(np.where(inside, 220, 20))
    noise = estimate(data)
    assert noise.sigma**2 == pytest.approx(20 + 200 * inside.mean(), rel=0.2)
    masked = estimate(np.where(inside, data, 0))
    assert masked.background_share == pytest.approx(1 - inside.mean(), abs=0.08)


@pytest.mark.parametrize("levels", [4, 8])
def test_smooth_data_of_few_values_are_not_labels(levels: int) -> None:
    z, y, x = np.mgrid[:40, :40, :40]
    wave = np.sin(x / 4 + y / 7) * np.cos(z / 5)
    rounded = np.round((wave + 1) / 2 * (levels - 1)).astype(np.uint8)
    assert clvol.Volume(rounded).noise.kind == "rounded"
    # the same regions under other names are labels: neighbours then differ by any number
    names = np.random.default_rng(0).permutation(levels).astype(np.uint8)
    assert clvol.Volume(names[rounded]).noise.kind == "labels"


@pytest.mark.parametrize("n", [1, 2, 33, 256, 257])
def test_the_cosine_transform_matches_scipy(n: int) -> None:
    data = np.random.default_rng(n).normal(size=(3, n, 4)).astype(np.float32)
    np.testing.assert_allclose(_cosine_transform(data, 1), fft.dct(data, axis=1, norm="ortho"), rtol=0, atol=1e-5)


def test_estimating_noise_does_not_import_scipy() -> None:
    made = "clvol.Volume(numpy.random.default_rng(0).random((64,) * 3)).noise"
    code = f"import clvol, numpy, sys; {made}; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout == "False\n"
