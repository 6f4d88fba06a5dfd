"""Values, gradients and Hessians from the device against those of the float64 reference.

A filter, a boundary rule, a derivative, a path and the number of axes make one program, built in about
a third of a second. Every combination of filter, derivative, path and axes is run; the boundary rule turns
with them such that each meets every value of every other (a test says so). ``CLVOL_PARITY=all`` runs all.
"""

from __future__ import annotations

import itertools
import os

import numpy as np
import pytest
from scipy import ndimage

from clvol import reference
from clvol.device import Device
from clvol.filter.table import as_filter, filters
from clvol.spline.field import sample
from clvol.volume.volume import Volume
from tests.cases import RULES, SMOOTHED
from tests.spline.agreement import VALUES, allowed, errors, points_of, volume_of

PATHS = (("taps", "buffer"), ("eight-fetch", "buffer"), ("eight-fetch", "image"), ("taps", "image"))
ROWS = (*filters(), "bc(0.2,0.4)", "sinc(8)", *SMOOTHED)


def combinations() -> list[tuple[str, str, int, tuple[str, str], int]]:
    every, whole = [], os.environ.get("CLVOL_PARITY") == "all"
    for (f, name), derivative, (p, path), d in itertools.product(enumerate(ROWS), (0, 1, 2), enumerate(PATHS), (3, 2)):
        if (f + derivative + p + d) % 2 and not whole:
            continue  # half of them, in which every two of the five still meet in every pair of values
        rules = RULES if whole else (RULES[(f // 2 + 3 * (f % 2) + p + 4 * d) % len(RULES)],)
        every += [(name, rule, derivative, path, d) for rule in rules]
    return every


COMBINATIONS = combinations()


def test_every_pair_of_values_is_covered() -> None:
    for a, b in itertools.combinations(range(5), 2):
        pairs = {(c[a], c[b]) for c in COMBINATIONS}
        assert len(pairs) == len({c[a] for c in COMBINATIONS}) * len({c[b] for c in COMBINATIONS})


def parity(
    device: Device, volume: Volume, points: np.ndarray, name: str, rule: str, derivative: int, path: tuple[str, str]
) -> None:
    assert errors(device, volume, points, name, rule, derivative, path).max() <= allowed(device, name, path, derivative)


def skip_without_images(device: Device, path: tuple[str, str]) -> None:
    if path[1] == "image" and not device.has_images:
        pytest.skip(f"{device.name} has no images")
    if path == ("eight-fetch", "image") and device.sampler_bits == 0:
        pytest.skip(f"the sampler of {device.name} does not interpolate")


@pytest.mark.one_in(128)
@pytest.mark.parametrize(
    ("name", "rule", "derivative", "path", "d"),
    COMBINATIONS,
    ids=[f"{n}-{r}-d{k}-{p[0]}-{p[1]}-{d}D" for n, r, k, p, d in COMBINATIONS],
)
def test_parity(device: Device, name: str, rule: str, derivative: int, path: tuple[str, str], d: int) -> None:
    skip_without_images(device, path)
    shapes = {3: [(5, 6, 7), (1, 2, 4), (3, 1, 1), (1, 1, 1)], 2: [(6, 7), (1, 5), (4, 1), (1, 1)]}[d]
    for seed, shape in enumerate(shapes):
        volume = volume_of(shape, seed)
        parity(device, volume, volume.index_to_world(points_of(volume, seed)), name, rule, derivative, path)


# -- places of their own ------------------------------------------------------------------------------------

PLACES = [(n, r) for n in ("nearest", "linear", "bspline2", "bspline3", "lanczos2", "hybrid") for r in RULES]


@pytest.mark.one_in(24)
@pytest.mark.parametrize(("name", "rule"), PLACES)
def test_exactly_at_samples_halves_and_faces(device: Device, name: str, rule: str) -> None:
    """Knots of the filters; with spacing 1 and origin 0 both sides hit them exactly and take the same side."""
    data = np.random.default_rng(1).normal(size=(4, 5, 6)).astype(np.float32)
    z, y, x = np.meshgrid(*(np.arange(-3, n + 3, 0.5) for n in data.shape), indexing="ij")
    points = np.stack([x, y, z], -1)
    if name == "nearest" and rule in ("mirror", "reflect"):
        # it jumps at halves, where a folded position has its sides the other way round: outside as SciPy has it
        points = points[((points < -0.5) | (points > np.array([5.5, 4.5, 3.5]))).all(-1)]
        wanted = ndimage.map_coordinates(data, points.T[::-1], order=0, mode=rule)
        np.testing.assert_array_equal(sample(data, points, name, rule, device=device), wanted)
        return
    for derivative in (0, 1):
        if derivative and as_filter(name).continuity < 1:
            continue  # a slope that jumps may be taken from either side where the boundary folds the position
        parity(device, Volume(data), points, name, rule, derivative, ("taps", "buffer"))


@pytest.mark.one_in(16)
@pytest.mark.parametrize(("name", "rule"), PLACES)
def test_a_million_samples_away(device: Device, name: str, rule: str) -> None:
    data = np.random.default_rng(2).normal(size=(4, 5, 6)).astype(np.float32)
    far = np.random.default_rng(3).choice([-1e6, 1e6, 3.0], (60, 3)) + np.random.default_rng(4).uniform(0.1, 0.4, (60, 3))
    parity(device, Volume(data), far, name, rule, 0, ("taps", "buffer"))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_nonfinite_positions_give_nan(device: Device, derivative: int, d: int) -> None:
    points = np.zeros((4, d))
    points[0, 0], points[1, 1], points[2, -1] = np.nan, np.inf, -np.inf
    got = sample(np.ones((3,) * d), points, derivative=derivative, device=device).reshape(4, -1)
    assert np.isnan(got[:3]).all()
    assert np.isfinite(got[3]).all()
    wanted = reference.sample(np.ones((3,) * d), points, derivative=derivative).reshape(4, -1)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))


def test_positions_beyond_any_index_give_finite_values(device: Device) -> None:
    points = np.array([[1e18, 0, 0], [0, -1e30, 0], [0, 0, 1e300]])
    for rule in RULES:
        assert np.isfinite(sample(np.ones((3, 3, 3)), points, "linear", rule, device=device)).all()


def test_interpolating_filters_pass_through_the_samples(device: Device) -> None:
    volume = volume_of((4, 5, 6))
    z, y, x = np.indices(volume.shape)
    points = volume.index_to_world(np.stack([x, y, z], -1) + 0.0)
    for name, row in filters().items():
        if row.interpolates and name != "nearest":
            got = sample(volume, points, name, device=device)
            largest = np.abs(reference.prefilter(volume.data, name)).max()
            np.testing.assert_allclose(got, volume.data, rtol=0, atol=VALUES * largest, err_msg=name)


@pytest.mark.parametrize(("name", "most"), [("lanczos3n", 6e-9), ("sinc4n", 4e-8), ("lanczos3", 1e-11), ("sinc", 1e-11)])
def test_the_stated_error_of_windowed_sinc_in_double_precision(device: Device, name: str, most: float) -> None:
    """Against the closed form; `Field` states these errors."""
    if not device.has_double:
        pytest.skip("the device has no float64")
    row = as_filter(name)
    assert row.fit_error < most
    reach, dice = row.support // 2, np.random.default_rng(0)
    data, x = dice.uniform(-1, 1, (1, 30)), dice.uniform(9, 20, 300)
    apart = x[:, None] - np.arange(30)
    kernel = np.sinc(apart) * (np.abs(apart) < reach) * (np.sinc(apart / reach) if "lanczos" in name else 1)
    weights = kernel / kernel.sum(1, keepdims=True) if name.endswith("n") else kernel
    got = sample(data, np.stack([x, 0 * x], -1), name, precision="double", device=device)
    assert np.abs(got - weights @ data[0]).max() < row.support * most
