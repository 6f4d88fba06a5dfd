"""Measured errors of surfaces compared with the stated uncertainty, for known surfaces and normals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import Camera, Volume
from clvol.device import Device
from clvol.phantoms import marschner_lobb_function, marschner_lobb_gradient

Array: TypeAlias = NDArray[np.float64]
N = 48
STEP = 2 / (N - 1)
VIEW = Camera.orbit(30, 25, projection="orthographic", fit="volume")


@dataclass(frozen=True)
class Phantom:
    """A function on [-1, 1]³, its gradient, and the isovalue."""

    value: Callable[[Array], Array]
    gradient: Callable[[Array], Array]
    isovalue: float = 0.5

    def distance(self, points: Array) -> Array:
        """From points to the surface, by Newton's method along the gradient, a sample at a time; inf if there is none."""
        at = points.copy()
        for _ in range(12):
            slope = self.gradient(at)
            way = ((self.value(at) - self.isovalue) / np.maximum((slope**2).sum(-1), 1e-12))[:, None] * slope
            at -= way * np.minimum(1, STEP / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12))
        found = np.abs(self.value(at) - self.isovalue) < 1e-6
        return np.where(found, np.linalg.norm(at - points, axis=1), np.inf)


def ball(width: float, radius: float = 0.6) -> Phantom:
    """1 within a sphere, 0 outside; the edge is the given number of samples wide."""
    w = width * STEP

    def value(p: Array) -> Array:
        return np.asarray(0.5 - 0.5 * np.tanh((np.linalg.norm(p, axis=-1) - radius) / w))

    def gradient(p: Array) -> Array:
        r = np.linalg.norm(p, axis=-1, keepdims=True)
        return np.asarray(-0.5 / w / np.cosh(np.clip((r - radius) / w, -50, 50)) ** 2 * p / r)

    return Phantom(value, gradient)


def wave(share: float) -> Phantom:
    """A tilted wave at a fraction of the Nyquist frequency."""
    k = share * np.pi / STEP * np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])
    return Phantom(lambda p: np.sin(p @ k), lambda p: np.cos(p @ k)[..., None] * k, 0.2)


PHANTOMS = {
    "ball": ball(2),
    "soft ball": ball(3),
    "wave": wave(0.35),
    "short wave": wave(0.6),
    "marschner-lobb": Phantom(marschner_lobb_function, marschner_lobb_gradient),
}


def places(n: int = N) -> Array:
    z, y, x = np.meshgrid(*[np.linspace(-1, 1, n)] * 3, indexing="ij")
    return np.stack([x, y, z], -1)


@dataclass(frozen=True)
class Found:
    """For each hit: distance to the true surface, angle to its normal, and the stated uncertainty."""

    off: Array
    angle: Array
    within: Array
    turned: Array

    def coverage(self, deviations: float = 1.96) -> tuple[float, float]:
        share = deviations / 1.96
        return float((self.off <= share * self.within).mean()), float((self.angle <= share * self.turned).mean())

    def sharpness(self) -> tuple[float, float]:
        """Median error over what is stated at the median; 0.34 for a normal error in one dimension."""
        return float(np.median(self.off) / np.median(self.within)), float(np.median(self.angle) / np.median(self.turned))


def measure(volume: Volume, phantom: Phantom, filter: str, device: Device, limit: float = 0.65, **options: Any) -> Found:
    """Measurements in the inner part, where boundary rules do not matter."""
    outputs = ("position", "normal", "uncertainty")
    options = {"size": (128, 128), "isovalue": phantom.isovalue, "clip": ((-limit,) * 3, (limit,) * 3), **options}
    got = clvol.render(volume, VIEW, "isosurface", filter=filter, boundary="reflect", device=device, outputs=outputs, **options)
    hit = (np.abs(got["position"]) < limit - 1e-4).all(-1)  # no end of a ray at the clip box; NaN is none
    assert hit.sum() > 500
    position, normal, stated = (got[name][hit].astype(np.float64) for name in outputs)
    true = phantom.gradient(position)
    true = true / np.linalg.norm(true, axis=1, keepdims=True)
    normal *= np.sign((true * normal).sum(1))[:, None]
    angle = 2 * np.degrees(np.arcsin(np.minimum(np.linalg.norm(true - normal, axis=1) / 2, 1)))
    return Found(phantom.distance(position), angle, stated[:, 0], stated[:, 1])


def sampled(phantom: Phantom, sigma: float = 0.0, n: int = N) -> Volume:
    noise = sigma * np.random.default_rng(5).standard_normal((n, n, n))
    return Volume((phantom.value(places(n)) + noise).astype(np.float32), (2 / (n - 1),) * 3, (-1,) * 3)


FILTERS = ["linear", "bspline3", "bspline3-approx", "bspline3(0.1)", "mitchell", "catmull-rom"]


@pytest.mark.one_in(6)
@pytest.mark.parametrize("filter", FILTERS)
def test_the_filters_error_is_covered(device: Device, filter: str) -> None:
    """Without noise. The bound may be several times the minimum: neighbouring places have errors of all sizes."""
    for name, phantom in PHANTOMS.items():
        found = measure(sampled(phantom), phantom, filter, device, sigma=0.0)
        covered, sharp = found.coverage(), found.sharpness()
        assert min(covered) >= 0.85, (name, covered)
        assert sharp[0] > 0.12, (name, sharp)
        assert sharp[1] > 0.04, (name, sharp)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("filter", ["bspline4", "bspline5"])
def test_high_degrees_are_covered_for_well_sampled_functions(device: Device, filter: str) -> None:
    for name in ("soft ball", "short wave", "marschner-lobb"):
        phantom = PHANTOMS[name]
        covered = measure(
            sampled(phantom), phantom, filter, device, limit=0.55 if name != "soft ball" else 0.65, sigma=0.0
        ).coverage()
        assert min(covered) >= 0.85, (name, covered)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("filter", [*FILTERS, "bspline5"])
def test_noise_is_covered(device: Device, filter: str) -> None:
    """95 % and 68 % of the errors lie within 1.96 and 1 stated deviations."""
    for name, sigma in (("ball", 0.02), ("soft ball", 0.02), ("wave", 0.1), ("marschner-lobb", 0.02)):
        phantom = PHANTOMS[name]
        found = measure(sampled(phantom, sigma), phantom, filter, device, sigma=sigma)
        assert min(found.coverage()) >= 0.85, (name, found.coverage())
        assert found.coverage(1.0)[0] >= 0.58, (name, found.coverage(1.0))
        assert found.sharpness()[0] > 0.12, (name, found.sharpness())


@pytest.mark.parametrize("filter", ["linear", "bspline3", "bspline3-approx", "bspline3(1)", "bspline5", "hybrid"])
def test_noise_on_a_plane(device: Device, filter: str) -> None:
    """Filters of order 2 reproduce a plane, whose errors are then those of the noise alone, which is normal.

    Filters that err much for waves as short as the noise state up to a fourth more: noise may be taken for detail.
    """
    sigma, normal = 0.05, np.array([0.3, -0.4, 0.8])
    plane = Phantom(lambda p: p @ normal / STEP, lambda p: np.broadcast_to(normal / STEP, p.shape), 0.3)
    found = measure(sampled(plane, sigma), plane, filter, device, limit=0.8, sigma=sigma)
    deviations = np.sqrt(((1.96 * found.off / found.within) ** 2).mean())
    assert (0.92 if filter in ("bspline3", "bspline5", "hybrid") else 0.78) <= deviations <= 1.06
    assert 0.93 <= found.coverage()[0] <= 0.995
    assert found.coverage()[1] >= 0.93


def test_neither_noise_nor_smoothing_need_be_known(device: Device) -> None:
    """The default: sigma and smoothing are estimated from the samples."""
    for name, sigma in (("ball", 0.02), ("soft ball", 0.05), ("wave", 0.1), ("marschner-lobb", 0.02)):
        phantom = PHANTOMS[name]
        for filter_name in ("bspline3", "bspline3(auto)"):
            found = measure(sampled(phantom, sigma), phantom, filter_name, device)
            assert min(found.coverage()) >= 0.85, (name, filter_name, found.coverage())
            assert found.sharpness()[0] > 0.12, (name, filter_name, found.sharpness())


@pytest.mark.parametrize("filter", ["linear", "bspline3", "bspline3(0.1)"])
def test_correlated_noise(device: Device, filter: str) -> None:
    """Blurred along x and y, as by a scanner's filter: a smoothing spline averages it less than white noise."""
    n = 64  # enough places to detect the correlation
    step, normal = 2 / (n - 1), np.array([0.3, -0.4, 0.8])
    plane = Phantom(lambda p: p @ normal / step, lambda p: np.broadcast_to(normal / step, p.shape), 0.3)
    noise = np.random.default_rng(4).standard_normal((n, n, n))
    for axis in (1, 2):
        noise = (noise + 0.25 * (np.roll(noise, 1, axis) + np.roll(noise, -1, axis))) / np.sqrt(1.125)
    volume = Volume((plane.value(places(n)) + 0.05 * noise).astype(np.float32), (step,) * 3, (-1,) * 3)
    assert volume.noise.kind == "correlated"
    known = measure(volume, plane, filter, device, limit=0.8)
    white = measure(volume, plane, filter, device, limit=0.8, sigma=0.05)
    assert 0.85 <= known.coverage()[0] <= 0.995
    assert known.coverage()[1] >= 0.85
    assert abs(known.coverage(1.0)[0] - 0.68) < 0.1
    assert known.coverage()[0] > white.coverage()[0] + 0.015


def test_anisotropic_and_rotated_grids(device: Device) -> None:
    """Slices twice as far apart as pixels, rotated in the world."""
    a, b = np.radians((25, 40))
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    turn = turn @ np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    phantom, sigma = ball(3), 0.02
    grid = Volume(np.zeros((30, 60, 60), np.float32), (STEP, STEP, 2 * STEP), direction=turn)
    grid = Volume(grid.data, grid.spacing, tuple(-grid.center), turn)
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij")[::-1], -1)
    data = phantom.value(grid.index_to_world(index)) + sigma * np.random.default_rng(2).standard_normal(grid.shape)
    volume = Volume(data.astype(np.float32), grid.spacing, grid.origin, turn)
    for name in ("bspline3", "bspline3(0.1,0.1,0.02)", "linear"):
        found = measure(volume, phantom, name, device, 0.7, sigma=sigma)
        assert min(found.coverage()) >= 0.85, (name, found.coverage())
        assert found.coverage(1.0)[0] >= 0.58, (name, found.coverage(1.0))
        assert found.sharpness()[0] > 0.15, (name, found.sharpness())


def test_rounding_to_integers_counts_as_noise(device: Device) -> None:
    phantom = ball(4)
    data = np.rint(40 * phantom.value(places())).astype(np.uint8)
    grey = Phantom(lambda p: 40 * phantom.value(p), lambda p: 40 * phantom.gradient(p), 20.0)
    found = measure(Volume(data, (STEP,) * 3, (-1,) * 3), grey, "bspline3", device, sigma=0.0)
    assert min(found.coverage()) >= 0.85
    assert found.sharpness()[0] > 0.2


def test_the_uncertainty_falls_as_fast_as_the_error(device: Device) -> None:
    """With the fourth power of the sampling for cubic B-splines, with the second for linear interpolation."""
    radius, w = 0.6, 0.16
    phantom = ball(w / STEP, radius)
    for name, order in (("bspline3", 4), ("linear", 2)):
        stated = [np.median(measure(sampled(phantom, n=n), phantom, name, device, sigma=0.0).within) for n in (33, 65)]
        assert np.log2(stated[0] / stated[1]) == pytest.approx(order, abs=0.35), name


def test_central_differences_increase_the_error_of_normals(device: Device) -> None:
    phantom = PHANTOMS["short wave"]
    found = measure(sampled(phantom), phantom, "bspline3", device, sigma=0.0, gradient="central")
    assert found.coverage()[1] >= 0.85
    exact = measure(sampled(phantom), phantom, "bspline3", device, sigma=0.0)
    assert np.median(found.turned) > 2 * np.median(exact.turned)
    np.testing.assert_allclose(found.within, exact.within)
