"""Pictures compared with an independent float64 ray caster (caster.py)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import clvol
from clvol.device import Device
from tests.outside import caster

SIZE = (26, 20)
ISOVALUE = 0.55


def blobs() -> np.ndarray:
    """Three smooth blobs; zero at the faces of the grid."""
    z, y, x = np.indices((22, 26, 24)).astype(float)
    hills = [((12, 12, 10), 4.0, 1.0), ((8, 17, 13), 2.5, 0.8), ((16, 9, 8), 2.0, 0.9)]
    return sum(h * np.exp(-((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / (2 * s * s)) for (a, b, c), s, h in hills)


PLACE = {
    "spacing": (0.8, 1.0, 1.3),
    "origin": (-20.0, 7.0, 30.0),
    "direction": Rotation.from_euler("xyz", [20, -35, 50], True).as_matrix(),
}
VOLUME = clvol.Volume(blobs(), **PLACE)
CAMERAS: dict[str, dict[str, Any]] = {
    "perspective": {"position": (-60, -25, 75), "up": (0.1, 0.2, 1.0), "fov": 32.0, "zoom": 1.9},
    "orthographic": {"position": (60, 40, 20), "up": (0.0, 1.0, 0.3), "projection": "orthographic", "zoom": 2.2},
    "aside": {"position": (-10, 60, 60), "target": (-24, 11, 48), "fov": 25.0},
}


def scene(camera: str, order: int) -> tuple[Any, Any, clvol.Camera]:
    spline = caster.Spline(blobs(), **PLACE, order=order)
    return spline, caster.cast(spline, SIZE, **CAMERAS[camera]), clvol.Camera(**CAMERAS[camera])


FILTERS = {1: "linear", 3: "bspline3", 5: "bspline5"}
CASES = [("perspective", 3), ("orthographic", 5), ("aside", 1)]


@pytest.mark.one_in(4)
@pytest.mark.parametrize(("camera", "order"), CASES)
def test_surfaces(device: Device, camera: str, order: int) -> None:
    """Correct hits and misses, with positions within 0.004 of a voxel at a step of 0.1."""
    spline, rays, same = scene(camera, order)
    truth = caster.first_crossings(spline, rays, ISOVALUE, 800)
    pictures = clvol.render(
        VOLUME,
        same,
        "isosurface",
        filter=FILTERS[order],
        boundary="mirror",
        size=SIZE,
        step=0.1,
        isovalue=ISOVALUE,
        outputs=("depth", "position"),
        device=device,
    )
    depth, position = pictures["depth"].ravel(), pictures["position"].reshape(-1, 3)
    doubtful = np.abs(caster.maxima(spline, rays) - ISOVALUE) < 2e-3  # such rays graze the surface
    assert doubtful.mean() < 0.02
    sure = ~doubtful
    np.testing.assert_array_equal(np.isfinite(depth)[sure], np.isfinite(truth)[sure])
    found = sure & np.isfinite(truth)
    assert found.sum() > 50
    np.testing.assert_allclose(depth[found], truth[found], rtol=0, atol=0.004)
    np.testing.assert_allclose(position[found], rays.at(truth)[found], rtol=0, atol=0.004)


@pytest.mark.parametrize(("camera", "order"), CASES)
def test_maxima(device: Device, camera: str, order: int) -> None:
    """The maximum, from below, within 2e-3 of the range at a step of 0.1 voxel."""
    spline, rays, same = scene(camera, order)
    grey = clvol.TransferFunction.ramp((0.0, 1.0))
    picture = clvol.render(
        VOLUME, same, "mip", filter=FILTERS[order], boundary="mirror", size=SIZE, step=0.1, transfer=grey, device=device
    )[..., 0].ravel()
    truth = np.clip(np.nan_to_num(caster.maxima(spline, rays)), 0, 1)
    assert (truth > 0.5).sum() > 50
    below = truth - picture
    assert below.max() < 2e-3
    assert below.min() > -1e-5


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("camera", "order"), CASES)
def test_emission_and_absorption(device: Device, camera: str, order: int) -> None:
    """Colours and opacities of matter that is clear at the faces, within 1e-4 at a step of 0.05."""
    spline, rays, same = scene(camera, order)
    colors = ((0.0, (1.0, 0.2, 0.0)), (0.5, (0.3, 0.9, 0.4)), (1.0, (0.1, 0.3, 1.0)))
    opacities = ((0.125, 0.0), (0.5, 0.25), (1.0, 0.5))
    transfer = clvol.TransferFunction(colors, opacities, unit_distance=1.5)

    def classify(values: np.ndarray) -> np.ndarray:
        at = [v for v, _ in colors]
        shades = [np.interp(values, at, [rgb[i] for _, rgb in colors]) for i in range(3)]
        return np.stack([*shades, np.interp(values, [v for v, _ in opacities], [a for _, a in opacities])], -1)

    color, opacity = caster.integrals(spline, rays, classify, 1.5, 800)
    options = {"transfer": transfer, "background": None, "shading": False, "termination": 0.0}
    picture = clvol.render(
        VOLUME, same, "composite", filter=FILTERS[order], boundary="mirror", size=SIZE, step=0.05, device=device, **options
    ).reshape(-1, 4)
    assert (opacity > 0.5).sum() > 30
    np.testing.assert_allclose(picture[:, 3], opacity, rtol=0, atol=1e-4)
    np.testing.assert_allclose(picture[:, :3] * picture[:, 3:], color, rtol=0, atol=1e-4)


def test_the_caster_itself() -> None:
    """On a plane and a parabola with known results: f = z, and f = 1 - r² by a cubic, which is exact inside."""
    z = np.indices((9, 9, 9))[0].astype(float)
    plane = caster.Spline(z, order=1)
    rays = caster.cast(plane, (3, 3), (4, 4, -10), up=(0, 1, 0), fov=20)
    slanted = 1 / rays.direction[:, 2]
    np.testing.assert_allclose(caster.first_crossings(plane, rays, 3.25), 13.25 * slanted, rtol=1e-12)
    np.testing.assert_allclose(rays.enter[4], 9.5)
    np.testing.assert_allclose(rays.leave[4], 18.5)
    np.testing.assert_allclose(plane.gradient(np.array([[4.2, 3.1, 2.6]])), [[0, 0, 1]], atol=1e-9)
    z, y, x = np.indices((41, 41, 41)) - 20.0
    hill = caster.Spline(1 - (x**2 + y**2 + z**2) / 25, origin=(-20, -20, -20))
    middle = caster.cast(hill, (1, 1), (0, -100, 0), projection="orthographic")
    np.testing.assert_allclose(caster.maxima(hill, middle), 1, atol=1e-8)  # less what the faces let through
    np.testing.assert_allclose(caster.first_crossings(hill, middle, 0.0), 95, atol=1e-6)
    fog = caster.integrals(hill, middle, lambda v: np.stack([*[np.ones_like(v)] * 3, np.full_like(v, 0.1)], -1), 10.0)
    np.testing.assert_allclose(fog[1], 1 - 0.9 ** (41 / 10), rtol=1e-12)
    np.testing.assert_allclose(fog[0][0], fog[1][0], rtol=1e-12)
