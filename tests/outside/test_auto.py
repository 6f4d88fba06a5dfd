"""Estimated noise and the chosen λ, on known functions; splines by SciPy's cosine transform."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft, ndimage, special

import clvol
from clvol.volume.smoothing import choose

Array = NDArray[np.float64]
SCAN = (0.0, *np.geomspace(1e-3, 100, 19))
POINTS = 8000

# -- functions on [-1, 1]^d, of points in the order x, y(, z) -------------------------------------------------


def smooth_sphere(p: Array) -> Array:
    return np.asarray(special.erfc((np.linalg.norm(p, axis=-1) - 0.6) / 0.1) / 2)


def hard_sphere(p: Array) -> Array:
    return (np.linalg.norm(p, axis=-1) < 0.6).astype(float)


def marschner_lobb(p: Array) -> Array:
    if p.shape[-1] == 2:
        p = np.concatenate([p, np.zeros_like(p[..., :1])], -1)
    return clvol.phantoms.marschner_lobb_function(p)


def random_field(p: Array) -> Array:
    r = np.random.default_rng(3)
    waves, phases = r.normal(size=(60, p.shape[-1])) * 10, r.uniform(0, 2 * np.pi, 60)
    return np.asarray(0.5 + sum(np.cos(p @ w + a) for w, a in zip(waves, phases, strict=True)) / 33)


def blobs(p: Array) -> Array:
    r = np.random.default_rng(5)
    total = np.zeros(p.shape[:-1])
    for _ in range(40):
        center, width = r.uniform(-0.8, 0.8, p.shape[-1]), r.uniform(0.05, 0.15)
        total += r.uniform(0.4, 1) * np.exp(-((p - center) ** 2).sum(-1) / (2 * width**2))
    return total


def vessels(p: Array) -> Array:
    r = np.random.default_rng(7)
    found = np.zeros(p.shape[:-1])
    for _ in range(12):
        q, along = p - r.uniform(-0.6, 0.6, p.shape[-1]), r.normal(size=p.shape[-1])
        across = (q**2).sum(-1) - (q @ along) ** 2 / (along @ along)
        found = np.maximum(found, np.exp(-across / (2 * 0.04**2)))
    return found


ELLIPSES = (  # Shepp and Logan (1974), in three dimensions: value, half axes, centre, degrees about z
    (1, 0.69, 0.92, 0.81, 0, 0, 0, 0),
    (-0.8, 0.6624, 0.874, 0.78, 0, -0.0184, 0, 0),
    (-0.2, 0.11, 0.31, 0.22, 0.22, 0, 0, -18),
    (-0.2, 0.16, 0.41, 0.28, -0.22, 0, 0, 18),
    (0.1, 0.21, 0.25, 0.41, 0, 0.35, -0.15, 0),
    (0.1, 0.046, 0.046, 0.05, 0, 0.1, 0.25, 0),
    (0.1, 0.046, 0.046, 0.05, 0, -0.1, 0.25, 0),
    (0.1, 0.046, 0.023, 0.05, -0.08, -0.605, 0, 0),
    (0.1, 0.023, 0.023, 0.02, 0, -0.606, 0, 0),
    (0.1, 0.023, 0.046, 0.02, 0.06, -0.605, 0, 0),
)


def shepp_logan(p: Array) -> Array:
    if p.shape[-1] == 2:
        p = np.concatenate([p, np.zeros_like(p[..., :1])], -1)
    total = np.zeros(p.shape[:-1])
    for value, a, b, c, x, y, z, turned in ELLIPSES:
        q, turn = p - (x, y, z), np.deg2rad(turned)
        u, v = q[..., 0] * np.cos(turn) + q[..., 1] * np.sin(turn), q[..., 1] * np.cos(turn) - q[..., 0] * np.sin(turn)
        total += value * ((u / a) ** 2 + (v / b) ** 2 + (q[..., 2] / c) ** 2 <= 1)
    return total


FUNCTIONS: tuple[Callable[[Array], Array], ...] = (
    smooth_sphere,
    hard_sphere,
    marschner_lobb,
    random_field,
    blobs,
    vessels,
    shepp_logan,
)
functions = pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)


@cache
def samples(function: Callable[[Array], Array], shape: tuple[int, ...]) -> Array:
    positions = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return function(np.stack(positions[::-1], -1))


def noisy(function: Callable[[Array], Array], shape: tuple[int, ...], sigma: float) -> Array:
    return samples(function, shape) + sigma * np.random.default_rng(7).normal(size=shape)


# -- reconstruction, cubic, boundary "reflect" -------------------------------------------------------------------


def coefficients(data: NDArray[Any], smoothing: Sequence[float]) -> Array:
    """Coefficients of the smoothing spline; λ in the order x, y(, z)."""
    c = np.asarray(data, np.float64)
    for axis, value in enumerate(tuple(smoothing)[::-1]):
        w = np.pi * np.arange(c.shape[axis]) / c.shape[axis]
        undone = (4 + 2 * np.cos(w)) / 6 + value * (2 - 2 * np.cos(w)) ** 2
        c = fft.idct(fft.dct(c, axis=axis) / undone.reshape([-1 if i == axis else 1 for i in range(c.ndim)]), axis=axis)
    return c


def drawn(c: Array, index: Array) -> Array:
    """The spline with these coefficients at index positions in the array's axis order."""
    return np.asarray(ndimage.map_coordinates(c, np.moveaxis(index, -1, 0), order=3, prefilter=False, mode="reflect"))


def error(function: Callable[[Array], Array], data: Array, smoothing: Sequence[float]) -> float:
    points = np.random.default_rng(1).uniform(-1, 1, (POINTS, data.ndim))
    index = (points[:, ::-1] + 1) / 2 * (np.array(data.shape) - 1)
    return float(np.sqrt(np.mean((drawn(coefficients(data, smoothing), index) - function(points)) ** 2)))


def require_good(function: Callable[[Array], Array], data: Array, allowed: float = 1.10) -> clvol.volume.smoothing.Smoothing:
    """The error with the choice is at most 1.10 times that of the best common λ."""
    chosen = choose(clvol.Volume(data))
    best = min((error(function, data, (value,) * data.ndim), value) for value in SCAN)
    assert error(function, data, chosen.values) <= allowed * best[0], (chosen, best)
    return chosen


@pytest.mark.one_in(3)
@functions
@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
def test_volumes(function: Callable[[Array], Array], sigma: float) -> None:
    chosen = require_good(function, noisy(function, (40, 40, 40), sigma))
    if sigma >= 0.1:
        assert chosen.sigma == pytest.approx(sigma, rel=0.1)


@pytest.mark.one_in(2)
@functions
def test_larger_volumes(function: Callable[[Array], Array]) -> None:
    chosen = require_good(function, noisy(function, (72, 64, 80), 0.05))
    assert chosen.sigma == pytest.approx(0.05, rel=0.05)


@pytest.mark.one_in(3)
@functions
@pytest.mark.parametrize("sigma", [0.05, 0.2])
def test_images(function: Callable[[Array], Array], sigma: float) -> None:
    chosen = require_good(function, noisy(function, (160, 144), sigma))
    assert chosen.sigma == pytest.approx(sigma, rel=0.1)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("function", [random_field, vessels, hard_sphere, smooth_sphere], ids=lambda f: f.__name__)
def test_blocks_represent_the_whole_volume(function: Callable[[Array], Array]) -> None:
    data = noisy(function, (112, 96, 128), 0.1)
    assert data.size > 1 << 20
    chosen = choose(clvol.Volume(data))
    best = min(error(function, data, (value,) * 3) for value in (0.1, 0.3, 0.6, 1, 2, 4, 8, 16, 32, 64))
    assert error(function, data, chosen.values) <= 1.1 * best
    assert chosen.sigma == pytest.approx(0.1, rel=0.05)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("function", [smooth_sphere, random_field, blobs], ids=lambda f: f.__name__)
def test_coarse_slices_get_their_own_smoothing(function: Callable[[Array], Array]) -> None:
    data = noisy(function, (14, 56, 56), 0.1)
    chosen = choose(clvol.Volume(data, (1, 1, 4)))
    within, between = (0.03, 0.1, 0.3, 1, 3, 10, 30), (0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    best = min(error(function, data, (a, a, b)) for a in within for b in between)
    same = min(error(function, data, (a, a, a)) for a in (*within, *between))
    assert error(function, data, chosen.values) <= 1.1 * best < same
    assert chosen.values[0] > 4 * chosen.values[2]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("function", [smooth_sphere, hard_sphere, marschner_lobb, blobs], ids=lambda f: f.__name__)
@pytest.mark.parametrize("photons", [30, 300])
def test_counts_of_photons(function: Callable[[Array], Array], photons: int) -> None:
    def expected(p: Array) -> Array:
        return photons * (0.1 + function(p))

    shape = (56, 56, 56)
    mean = samples(expected, shape)
    counts = np.random.default_rng(3).poisson(mean)
    chosen = require_good(expected, counts)
    assert chosen.sigma == pytest.approx(np.sqrt(mean.mean()), rel=0.1)
    noise = clvol.Volume(counts).noise
    assert noise.kind == "signal-dependent"
    assert noise.gain == pytest.approx(1, rel=0.2)


# -- clean data --------------------------------------------------------------------------------------------------


def zone_plate(p: Array) -> Array:
    """Its local frequency reaches 0.9 of the Nyquist limit of 64 samples at the faces."""
    return np.asarray(0.5 + 0.5 * np.cos(0.9 * np.pi / 4 * 63 * (p**2).sum(-1)))


def averaged_box(p: Array) -> Array:
    """A box of voxel means, 64 samples along each axis."""
    return np.asarray(((0.5853 - np.abs(p)) * 63 / 2 + 0.5).clip(0, 1).prod(-1))


@pytest.mark.parametrize("bits", [None, 8, 12, 16])
@pytest.mark.parametrize(
    "function", [smooth_sphere, marschner_lobb, random_field, zone_plate, averaged_box, vessels], ids=lambda f: f.__name__
)
def test_noise_free_data_are_not_smoothed(function: Callable[[Array], Array], bits: int | None) -> None:
    data = samples(function, (64, 64, 64))
    if bits is not None:
        data = np.round((data - data.min()) / np.ptp(data) * (2**bits - 1)).astype(np.uint16)
    chosen = choose(clvol.Volume(data))
    assert max(chosen.values) <= (0 if bits is None else 0.01), chosen  # rounding to 8 bits is noise that may just pay


# -- stairs -----------------------------------------------------------------------------------------------------


def surface(data: Array, smoothing: Sequence[float], center: Array, radius: float) -> tuple[float, float]:
    """RMS distance of the surface at 1/2 to a sphere, in samples, and RMS angle of its normals, in degrees."""
    k = np.arange(800) + 0.5
    polar, turn = np.arccos(1 - 2 * k / 800), np.pi * (1 + 5**0.5) * k
    normals = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], -1)
    c = coefficients(data, smoothing)
    t = np.linspace(-2, 2, 161)
    inside = drawn(c, center + (radius + t[None, :, None]) * normals[:, None]) > 0.5
    crossing = inside[:, :-1] & ~inside[:, 1:]
    middles = (t[1:] + t[:-1]) / 2
    distance = middles[np.argmin(np.where(crossing, np.abs(middles), 9), 1)]
    places, h = center + (radius + distance)[:, None] * normals, 1e-3
    slope = np.stack([drawn(c, places - h * e) - drawn(c, places + h * e) for e in np.eye(3)], -1)
    cosine = (slope * normals).sum(-1) / np.linalg.norm(slope, axis=-1)
    return float(np.sqrt((distance**2).mean())), float(np.degrees(np.sqrt((np.arccos(cosine.clip(-1, 1)) ** 2).mean())))


@pytest.mark.parametrize("radius", [6.0, 11.0, 17.0])
def test_binary_spheres_lose_their_stairs(radius: float) -> None:
    center = np.array([23.3, 23.7, 23.1])
    data = (((np.stack(np.indices((47, 47, 47)), -1) - center) ** 2).sum(-1) < radius**2).astype(np.uint8)
    chosen = choose(clvol.Volume(data))
    assert set(chosen.values) == {0.5}
    stairs, slopes = surface(data, (0, 0, 0), center, radius)
    distance, angle = surface(data, chosen.values, center, radius)
    best = min(surface(data, (value,) * 3, center, radius)[0] for value in (0.1, 0.2, 0.3, 0.7, 1, 2))
    assert distance < 0.7 * stairs
    assert distance < 1.2 * best
    assert angle < 6 < 20 < slopes


def test_masked_objects_lose_most_of_theirs() -> None:
    center, radius = np.array([27.3, 27.7, 27.1]), 20.0
    inside = ((np.stack(np.indices((55, 55, 55)), -1) - center) ** 2).sum(-1) < radius**2
    texture = 1 + 0.2 * (samples(random_field, (55, 55, 55)) - 0.5)
    data = np.where(inside, texture, 0.0)
    volume = clvol.Volume(data)
    chosen = choose(volume)
    assert volume.noise.masked
    assert volume.noise.background == 0
    assert volume.noise.background_share == pytest.approx(1 - inside.mean())
    assert "background" in chosen.reason
    stairs, slopes = surface(data, (0, 0, 0), center, radius)
    distance, angle = surface(data, chosen.values, center, radius)
    assert distance < 0.65 * stairs
    assert angle < 9 < 20 < slopes
    deep = np.random.default_rng(2).uniform(-9, 9, (2000, 3)) + center  # inside the texture keeps its shape
    truth = 1 + 0.2 * (random_field(2 * deep[:, ::-1] / 54 - 1) - 0.5)
    lost = drawn(coefficients(data, chosen.values), deep) - truth
    assert np.sqrt((lost**2).mean()) < 0.15 * truth.std()


def test_thin_vessels_lose_their_peaks() -> None:
    """Why modes that show extremes do not smooth; `choose` documents the numbers."""
    center = np.array([19.5, 19.3, 19.7])
    q = np.stack(np.indices((40, 40, 40)), -1) - center
    kept: dict[float, list[float]] = {0.0: [], 0.02: [], 0.1: [], 0.5: []}
    for direction in ((1, 0.13, 0.07), (1, 0.7, 0.2), (1, 0.9, 0.8)):
        along = np.array(direction) / np.linalg.norm(direction)
        data = np.exp(-((q**2).sum(-1) - (q @ along) ** 2) / 2)
        axis = center + np.linspace(-12, 12, 400)[:, None] * along
        for value, peaks in kept.items():
            peaks.append(float(drawn(coefficients(data, (value,) * 3), axis).mean()))
    assert {value: round(float(np.mean(peaks)), 2) for value, peaks in kept.items()} == {0: 0.99, 0.02: 0.92, 0.1: 0.79, 0.5: 0.58}
