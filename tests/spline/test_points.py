"""Points sampled eight at a time by a processor, sorted or not: each result is independent of the others."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from clvol import reference
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filter, filters
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.field import coefficients_of, resample, sample
from clvol.spline.points import sample_coefficients
from clvol.spline.sort import scattered
from clvol.volume.volume import Volume
from tests.cases import RULES

ROWS = (*filters(), "sinc(3)")


def volume_of(d: int, seed: int = 0) -> Volume:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    return Volume(rng.normal(size=(9, 11, 13)[:d]).astype(np.float32), (0.7, 1.3, 2.1)[:d], (3.0, -5.0, 7.0)[:d], turn)


def points_of(volume: Volume, count: int, seed: int = 0, dtype: type = np.float64) -> np.ndarray:
    """Most inside, one in eight outside, and one in sixteen not finite."""
    rng, size, d = np.random.default_rng(seed), np.array(volume.size), volume.ndim
    index = rng.uniform(-0.5, size - 0.5, (count, d))
    index[5::8] = rng.uniform(-2 * size, 3 * size, index[5::8].shape)
    points = volume.index_to_world(index).astype(dtype)
    points[7::32, 0], points[9::32, -1], points[24::64] = np.nan, np.inf, -np.inf
    return points


@pytest.mark.one_in(72)
@pytest.mark.parametrize(("name", "derivative", "d"), [*product(ROWS, [0, 1], [2, 3])])
def test_a_result_does_not_depend_on_its_index(device: Device, name: str, derivative: int, d: int) -> None:
    volume = volume_of(d)
    points = points_of(volume, 600 + 5)
    rule = RULES[len(name) % len(RULES)]
    with coefficients_of(volume, as_filter(name), as_boundary(rule), device) as held:
        path = choose_evaluator(device, held.filter)

        def at(some: np.ndarray) -> np.ndarray:
            return sample_coefficients(held, path, some, derivative)

        everything = at(points)
        for first, last in ((0, 1), (3, 10), (8, 16), (1, 17), (30, 63), (93, 605), (512, 605), (604, 605)):
            np.testing.assert_array_equal(at(points[first:last]), everything[first:last])
        for n in (5, 7, 9, 24):  # alone: outside, or not finite
            np.testing.assert_array_equal(at(points[n : n + 1]), everything[n : n + 1])
        order = np.random.default_rng(1).permutation(len(points))
        np.testing.assert_array_equal(at(points[order]), everything[order])


@pytest.mark.one_in(3)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("fill", [None, 7.5, np.nan])
@pytest.mark.parametrize("derivative", [0, 1])
def test_a_group_half_outside(device: Device, derivative: int, fill: float | None, d: int) -> None:
    volume = volume_of(d)
    size = np.array(volume.size)
    for axis in range(d):
        index = np.tile(0.5 * (size - 1.0), (24, 1))
        index[:, axis] = np.linspace(-2.9, 2.8, 24)
        index[12:, axis] += size[axis] - 1
        points = volume.index_to_world(index)
        outside = (index[:, axis] < -0.5) | (index[:, axis] > size[axis] - 0.5)
        got = sample(volume, points, derivative=derivative, fill=fill, device=device)
        wanted = reference.sample(volume, points, derivative=derivative)
        if fill is not None:
            wanted[outside] = fill
        np.testing.assert_allclose(got, wanted, rtol=0, atol=2e-5)


@pytest.mark.parametrize("derivative", [0, 1])
def test_no_points_and_few(device: Device, derivative: int) -> None:
    volume = volume_of(3)
    points = points_of(volume, 9)
    everything = sample(volume, points, derivative=derivative, device=device)
    for count in range(9):
        got = sample(volume, points[:count], derivative=derivative, device=device)
        assert got.shape == (count,) + (3,) * derivative
        np.testing.assert_array_equal(got, everything[:count])


@pytest.mark.parametrize("shape", [(3, 2, 1030), (5, 7, 3), (1, 1, 1)])
def test_a_rotated_grid_equals_its_points(device: Device, shape: tuple[int, ...]) -> None:
    volume = volume_of(3)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    grid = Volume(np.broadcast_to(np.float32(0), shape), (0.01, 0.9, 0.7), volume.center - 3.0, turn)
    k, j, i = np.indices(shape)
    points = grid.index_to_world(np.stack([i, j, k], -1).astype(float))
    got = resample(volume, like=grid, device=device).data
    np.testing.assert_allclose(got, sample(volume, points, device=device), rtol=0, atol=1e-5)
    filled = resample(volume, like=grid, fill=9.0, device=device).data
    index = volume.world_to_index(points)
    outside = ((index < -0.5) | (index > np.array(volume.size) - 0.5)).any(-1)
    np.testing.assert_array_equal(filled, np.where(outside, 9.0, got))


# -- sorted ----------------------------------------------------------------------------------------------------


@pytest.mark.one_in(14)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, ">f4", ">f8", "i4"])
@pytest.mark.parametrize("derivative", [0, 1])
def test_sorting_changes_nothing(device: Device, derivative: int, dtype: type | str, d: int) -> None:
    volume = volume_of(d)
    points = points_of(volume, 3000)
    if dtype == "i4":
        points = np.where(np.isfinite(points), points, 0)
    points = points.astype(dtype)
    points.setflags(write=False)
    with device.limited(sorting=False):
        wanted = sample(volume, points, derivative=derivative, device=device)
    with device.limited(sorting=True):
        np.testing.assert_array_equal(sample(volume, points, derivative=derivative, device=device), wanted)
        with device.limited(launch_taps=1):  # several launches, of 1024 points
            np.testing.assert_array_equal(sample(volume, points, derivative=derivative, device=device), wanted)
    with device.limited(sorting=True, sorted_bytes=32 * 700):  # in several parts
        done: list[float] = []
        got = sample(volume, points, derivative=derivative, device=device, progress=done.append)
        np.testing.assert_array_equal(got, wanted)
        assert done == sorted(done)
        assert done[-1] == 1
        for count in (1, 9):
            some = sample(volume, points[:count], derivative=derivative, device=device)
            np.testing.assert_array_equal(some, wanted[:count])
    with device.limited(sorting=True, sorted_bytes=1):  # one by one
        np.testing.assert_array_equal(sample(volume, points[:5], derivative=derivative, device=device), wanted[:5])


def test_an_interrupt_while_points_are_sorted_does_no_harm(device: Device) -> None:
    volume = volume_of(3)
    points = points_of(volume, 3000)
    wanted = sample(volume, points, device=device)

    def stop(done: float) -> None:
        raise KeyboardInterrupt(done)

    with device.limited(sorting=True, sorted_bytes=32 * 700), pytest.raises(KeyboardInterrupt):
        sample(volume, points, device=device, progress=stop)
    np.testing.assert_array_equal(sample(volume, points, device=device), wanted)


@pytest.mark.one_in(12)
@pytest.mark.parametrize("name", ["nearest", "linear", "bspline5", "lanczos5", "hybrid"])
def test_sorted_points_and_other_filters(device: Device, name: str) -> None:
    volume = volume_of(3)
    points = points_of(volume, 2000)
    for fill in (None, 4.0):
        with device.limited(sorting=False):
            wanted = sample(volume, points, name, fill=fill, device=device)
        with device.limited(sorting=True):
            np.testing.assert_array_equal(sample(volume, points, name, fill=fill, device=device), wanted)


def test_which_points_are_sorted(device: Device) -> None:
    """Many distant points, in a volume larger than caches, for a filter of many taps."""
    count = 1 << 17
    points = np.random.default_rng(0).uniform(0, 127, (count, 3))
    ordered = points[np.argsort(points[:, 2])]
    ordered[:, :2] = 64.0
    data = np.broadcast_to(np.float32(0), (128, 128, 128))
    with coefficients_of(Volume(data), as_filter("bspline3"), as_boundary("mirror"), device) as held:
        assert scattered(held, points, held.volume.world_to_index_matrix)
        assert scattered(held, points.T, None)  # indices, axis by axis
        assert not scattered(held, ordered.T, None)
        assert scattered(held, points.astype(">f4"), held.volume.world_to_index_matrix)
        assert not scattered(held, ordered, held.volume.world_to_index_matrix)
        assert not scattered(held, points[:100], held.volume.world_to_index_matrix)
        assert not scattered(held, np.full_like(points, np.nan), held.volume.world_to_index_matrix)
        assert not scattered(held, points[:0], held.volume.world_to_index_matrix)
    with coefficients_of(Volume(data, (50.0, 50.0, 50.0)), as_filter("bspline3"), as_boundary("mirror"), device) as held:
        assert not scattered(held, points, held.volume.world_to_index_matrix)  # in samples these are near
    with coefficients_of(Volume(data), as_filter("linear"), as_boundary("mirror"), device) as held:
        assert not scattered(held, points, held.volume.world_to_index_matrix)
    with coefficients_of(Volume(data[:32]), as_filter("bspline3"), as_boundary("mirror"), device) as held:
        assert not scattered(held, points, held.volume.world_to_index_matrix)
