"""One voxel far brighter than the rest takes no normal and no colour from surfaces far from it, and rounding gives none.

The volume is r² about its centre, which the cubic B-spline reproduces: its normals are known.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import clvol
from clvol import Camera, Light, TransferFunction, Volume
from clvol.device import Device
from clvol.filter.table import filters

SIDE, RADIUS = 64, 10.0
CENTER = (SIDE - 1) / 2
FILTERS = [row.name for row in filters().values() if row.sums_to_one and row.exact]  # polynomials of high degree round more


def ball(hot: float) -> Volume:
    """1 on the sphere of `RADIUS`; one voxel at a corner is `hot`."""
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE] - CENTER
    data = (x * x + y * y + z * z) / RADIUS**2
    data[-1, -1, -1] = hot or data[-1, -1, -1]
    return Volume(data)


SHELL = TransferFunction(((0, "white"), (2, "white")), ((0.95, 0.0), (1.0, 0.95), (1.05, 0.0)))
BOX = ((CENTER - 12,) * 3, (CENTER + 12,) * 3)
LOOK: dict[str, Any] = {
    "camera": Camera.orbit(30, 20, zoom=4.0, fit="volume"),
    "size": (48, 48),
    "rays": 1,
    "clip": BOX,
    "transfer": SHELL,
}
LOOK |= {"lights": [Light((1, -1, 1))], "outputs": ("rgba", "normal", "position")}


@pytest.fixture(scope="module")
def clean(device: Device) -> dict[str, Any]:
    return dict(clvol.render(ball(0), device=device, **LOOK))


@pytest.mark.parametrize("hot", [1e4, 1e8, 1e12, 1e20, 1e30])
def test_a_hot_voxel_far_away_changes_no_normal_and_no_colour(device: Device, clean: dict[str, Any], hot: float) -> None:
    got = clvol.render(ball(hot), device=device, **LOOK)
    hit = np.isfinite(clean["position"][..., 0])
    assert hit.sum() > 300
    p = clean["position"][hit] - CENTER
    truth = p / np.linalg.norm(p, axis=1, keepdims=True)
    assert np.isfinite(got["normal"][hit]).all()
    assert np.abs(np.abs((got["normal"][hit] * truth).sum(1)) - 1).max() < 1e-5
    np.testing.assert_allclose(got["normal"], clean["normal"], atol=1e-5)
    np.testing.assert_allclose(got["rgba"], clean["rgba"], atol=1e-5)


@pytest.mark.parametrize("method", ["exact", "stepped"])
@pytest.mark.parametrize("hot", [1e8, 1e30])
def test_a_hot_voxel_far_away_changes_no_surface(device: Device, hot: float, method: str) -> None:
    options = {**LOOK, "transfer": None, "mode": "isosurface", "isovalue": 1.0, "method": method}
    want, got = (clvol.render(ball(h), device=device, **options) for h in (0, hot))
    np.testing.assert_allclose(got["normal"], want["normal"], atol=1e-4)
    np.testing.assert_allclose(got["rgba"], want["rgba"], atol=1e-3)


@pytest.mark.one_in(17)
@pytest.mark.parametrize(("filter", "gradient"), [*product(FILTERS, ["analytic", "central"])])
def test_rounding_gives_no_normal(device: Device, filter: str, gradient: str) -> None:
    """Constants, and both sides of a step, where it has decayed: prefilters leave a few units in the last place."""
    clear = TransferFunction(((0, "white"), (1, "white")), ((0, 0.2), (1, 0.2)))
    for value, spacing in ((0.1 + 0.2, 1.0), (1 / 3, 1e-3), (-1234.5678, 7.0), (1e30 / 7, 1.0), (3e-20, 1.0), (0.0, 1.0)):
        volume = Volume(np.full((9, 12, 10), value, np.float32), (spacing, spacing, 3 * spacing))
        transfer = TransferFunction(((value - 1, "white"), (value + 1, "white")), ((value - 1, 0.2), (value + 1, 0.2)))
        options: dict[str, Any] = {"transfer": transfer, "gradient": gradient, "rays": 1, "size": (24, 24), "device": device}
        got = clvol.render(volume, filter=filter, outputs="normal", **options)
        assert np.isnan(got).all(), (value, spacing)
    data = np.full((72, 8, 8), 1 / 3, np.float32)
    data[:32] = 1e-3
    box, top = ((-1, -1, 66), (8, 8, 72)), Camera.orbit(10, 75, fit="volume")
    options = {"transfer": clear, "gradient": gradient, "clip": box, "size": (24, 24), "device": device}
    assert np.isnan(clvol.render(data, top, filter=filter, outputs="normal", **options)).all()


def test_a_small_step_beside_a_hot_voxel_has_normals(device: Device) -> None:
    """Small relative to the range is not rounding: the step of 1e-3 has its normals, along z."""
    data = np.ones((24, 24, 24))
    data[12:] += 1e-3
    data[0, 0, 0] = 1e6
    surface = clvol.render(
        data,
        Camera.orbit(0, 70, zoom=2.0, fit="volume"),
        "isosurface",
        filter="linear",
        size=(32, 32),
        isovalue=1.0005,
        clip=((2, 2, 2), (30, 30, 30)),
        device=device,
        outputs="normal",
    )
    there = np.isfinite(surface[..., 0])
    assert there.mean() > 0.2
    np.testing.assert_allclose(np.abs(surface[there]), np.broadcast_to([0.0, 0, 1], (there.sum(), 3)), atol=1e-3)


def test_central_differences_on_the_hybrid_match_the_magnified_volume(device: Device) -> None:
    """As in programs given a volume magnified by SciPy: differences of its voxels, interpolated linearly."""
    spacing = np.array([1.0, 0.8, 1.3])
    data = ndimage.gaussian_filter(np.random.default_rng(8).random((12, 14, 13)), 1.2)
    places = np.meshgrid(*(np.arange(-2, 2 * n + 1) / 2 for n in data.shape), indexing="ij")
    fine = ndimage.map_coordinates(data, places, order=3, mode="mirror")  # two more on either side: differences and the last cell
    differences = np.stack(np.gradient(fine)[::-1], -1) / (spacing / 2)
    seen = clvol.render(
        Volume(data, tuple(spacing)),
        Camera.orbit(25, 35, fit="volume"),
        "isosurface",
        filter="hybrid",
        boundary="mirror",
        size=(40, 40),
        gradient="central",
        isovalue=float(np.median(data)),
        outputs=("normal", "position"),
        device=device,
    )
    there = np.isfinite(seen["normal"]).all(-1)
    assert there.sum() > 300
    at = 2 * (seen["position"][there] / spacing)[:, ::-1].T.astype(float) + 2
    expected = np.stack([ndimage.map_coordinates(differences[..., i], at, order=1) for i in range(3)], -1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    cosine = np.abs((seen["normal"][there] * expected).sum(1))
    assert np.degrees(np.arccos(np.clip(cosine, 0, 1))).max() < 0.05
