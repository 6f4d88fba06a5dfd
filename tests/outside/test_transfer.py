"""Rendered transfer functions compared with `numpy.interp` in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol.device import Device, Tile

# a voxel a pixel, more or less, seen along y; each is one unit distance thick
VIEW = clvol.Camera(direction=(0, 1, 0), up=(0, 0, 1), projection="orthographic", fit="volume")
TILES = {"wide": Tile(16, 16, 8, shared=True), "eights": Tile(16, 15, 8, shared=True), "rays": Tile(1, 1, 1, shared=False)}
COMPOSITE: dict[str, Any] = {"mode": "composite", "shading": False, "termination": 0.0}


def drawn(device: Device, values: NDArray[Any], transfer: clvol.TransferFunction) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values (N,), and their colours and opacities in the picture of a slab of such voxels, (N, 4)."""
    slab = values.reshape(24, 1, 24)
    with clvol.Renderer(slab, "nearest", device=device) as renderer:
        look: dict[str, Any] = {"camera": VIEW, "size": (61, 61), "rays": 1, "step": 1.0, "transfer": transfer, "background": None}
        place = renderer.render(mode="mip", outputs="position", **look).reshape(-1, 3).astype(np.float64)
        colors = renderer.render(mode="mip", **look).reshape(-1, 4)[:, :3]
        both = {skip: renderer.render(**look, **COMPOSITE, skipping=skip).reshape(-1, 4) for skip in (True, False)}
    np.testing.assert_array_equal(both[True], both[False])
    hit = np.isfinite(place).all(1)
    inside = hit & (np.abs(place - np.round(place))[:, [0, 2]].max(1, where=hit[:, None], initial=0) < 0.49)
    at = np.round(place[inside]).astype(int)
    assert inside.sum() > 1000
    return slab[at[:, 2], 0, at[:, 0]].astype(np.float64), np.column_stack([colors, both[True][:, 3]])[inside]


def interpolated(values: NDArray[Any], points: Any) -> NDArray[np.float64]:
    at, what = np.array([p[0] for p in points], float), np.array([p[1] for p in points], float)
    return np.stack([np.interp(values, at, column) for column in what.reshape(len(at), -1).T], -1)


def check(device: Device, values: NDArray[Any], colors: Any, opacities: Any, tolerance: float = 3e-7, tile: str = "wide") -> None:
    with device.limited(tile=TILES[tile]):
        at, got = drawn(device, values.astype(np.float32), clvol.TransferFunction(colors, opacities, 1.0))
    np.testing.assert_allclose(got[:, :3], interpolated(at, colors), rtol=0, atol=tolerance)
    np.testing.assert_allclose(got[:, 3:], interpolated(at, opacities), rtol=2e-6, atol=tolerance)


FUNCTIONS: dict[str, tuple[Any, Any, tuple[float, float]]] = {
    "end points far away": (
        ((-1e5, (0, 0, 0)), (40, (1, 0, 0)), (80, (0, 1, 0)), (1e5, (1, 1, 1))),
        ((-1e5, 0), (40, 0), (80, 0.9), (1e5, 0.9)),
        (20, 100),
    ),
    "a window of 40 in 31,000": (
        ((-1000, (0, 0, 0)), (1020, (0.2, 0.1, 0)), (1060, (0.9, 0.8, 1)), (30000, (1, 1, 1))),
        ((1020, 0.0), (1060, 0.7)),
        (990, 1090),
    ),
    "1 wide within 1000": (
        ((-1000, (0, 0, 1)), (1000, (1, 0, 0))),
        ((-1000, 0), (123.4, 0), (123.9, 0.8), (124.4, 0), (1000, 0)),
        (123, 125),
    ),
    "jumps": (
        ((0, (1, 0, 0)), (0.3, (0, 1, 0)), (0.3, (0, 0, 1)), (1, (1, 1, 1))),
        ((0, 0), (0.25, 0.5), (0.25, 0), (0.75, 0), (0.75, 0.4), (1, 0.2)),
        (-0.5, 1.5),
    ),
    "64 equal stops": (
        tuple((k / 63, ((k * 37 % 64) / 64, (k * 11 % 64) / 64, (k * 5 % 64) / 64)) for k in range(64)),
        ((0.0, 0.4),),
        (-0.1, 1.1),
    ),
    "many points": (
        tuple((k * k / 1600, ((k * 37 % 64) / 64, (k * 11 % 64) / 64, (k * 5 % 64) / 64)) for k in range(41)),
        ((0.111, 0.0), (0.1234567, 0.3), (0.7654321, 0.3), (0.8, 0.0)),
        (-0.1, 1.1),
    ),
    "one point": (((5, (0.1, 0.2, 0.3)),), ((7, 0.625),), (0, 10)),
}


@pytest.mark.one_in(24)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_it_is_linear_between_its_points(device: Device, name: str, tile: str) -> None:
    colors, opacities, (low, high) = FUNCTIONS[name]
    points = [p[0] for p in (*colors, *opacities) if low <= p[0] <= high][:200]
    values = np.random.default_rng(0).uniform(low, high, 576)
    values[: len(points)] = points  # where pieces meet
    # many steep pieces: a value's own rounding counts
    check(device, values, colors, opacities, 1e-5 if len(colors) > 20 else 2e-6, tile)


# points, and the values drawn: between the inner points, which lie near to one another beside the ends
NEAR = float(np.nextafter(0.5, 1.0))
FAR_ENDS: dict[str, tuple[Any, tuple[float, float]]] = {
    "0 to 0.4 within 1e5": (((-1e5, 0.0), (0.0, 0.0), (0.4, 1.0), (1e5, 1.0)), (-0.5, 1.0)),
    "0 to 4 within 1e6": (((-1e6, 0.0), (0.0, 0.0), (4.0, 0.9), (1e6, 0.9)), (-1.0, 7.0)),
    "0.2 wide at 1e9": (((0.0, 0.0), (5e8, 0.0), (1e9 + 0.2, 0.0), (1e9 + 0.4, 0.9), (2e9, 0.9)), (1e9, 1e9 + 1)),
    "as good as a jump": (((0.5, 0.1), (NEAR, 0.8), (0.7, 0.3)), (0.4999, 0.5003)),
}


@pytest.mark.parametrize("name", FAR_ENDS)
def test_close_points_with_distant_ends(device: Device, name: str) -> None:
    """(Points of a cell as wide as the volume's range fell on one of its ends together: opacities erred by 0.5 to 0.999.)"""
    opacities, (low, high) = FAR_ENDS[name]
    colors = tuple((v, (a, 1 - a, 0.5)) for v, a in opacities)
    values = np.random.default_rng(0).uniform(low, high, 576)
    if high < 100:  # else float32 does not hold them
        values = values.astype(np.float32).astype(np.float64)
    at, got = drawn(device, values, clvol.TransferFunction(colors, opacities, 1.0))
    np.testing.assert_allclose(got[:, :3], interpolated(at, colors), rtol=0, atol=2e-6)
    np.testing.assert_allclose(got[:, 3:], interpolated(at, opacities), rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize("seed", range(12))
def test_random_points(device: Device, seed: int) -> None:
    """From 1 to 60 points, spread over many magnitudes, with jumps."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 60 if seed % 2 else 6, 2)
    spread = 10.0 ** rng.uniform(-3, 5)

    def places(n: int) -> NDArray[Any]:
        at = np.sort(np.where(rng.random(n) < 0.2, spread, 1.0) * rng.uniform(-1, 1, n)).astype(np.float32).astype(np.float64)
        at[1:] = np.where(rng.random(n - 1) < 0.15, at[:-1], at[1:])
        return np.sort(at)

    colors = [(float(x), tuple(map(float, rng.random(3)))) for x in places(int(n))]
    opacities = [(float(x), float(a)) for x, a in zip(places(int(m)), rng.random(m) * (rng.random(m) > 0.4), strict=True)]
    values = rng.uniform(-1.2, 1.2, 576)
    values[:100] = rng.choice([p[0] for p in (*colors, *opacities)], 100)
    steepest = max(
        (abs(b[0] - a[0]) or np.inf) ** -1
        for points in (colors, opacities)
        for a, b in zip(points, points[1:] + points[-1:], strict=True)
    )
    check(device, values, colors, opacities, 1e-6 + 2e-7 * steepest)


def test_a_narrow_window_is_visible_wherever_it_lies(device: Device) -> None:
    values = np.linspace(-1000, 1000, 576)
    for center in values[7::83]:
        at, got = drawn(
            device,
            values.astype(np.float32),
            clvol.TransferFunction(
                ((-1000, "blue"), (1000, "red")), ((-1000, 0), (center - 0.5, 0), (center, 0.8), (center + 0.5, 0), (1000, 0)), 1.0
            ),
        )
        seen = np.abs(at - center) < 1e-3
        assert seen.any()
        np.testing.assert_allclose(got[seen, 3], 0.8, atol=1e-3)
        assert (got[~seen, 3] == 0).all()
