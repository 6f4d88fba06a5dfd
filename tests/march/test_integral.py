"""Line integrals: against closed forms and the reference, in all functions; their derivatives, and registration by them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import Camera, Radiograph, Renderer, TransferFunction, Volume
from clvol.base.errors import DataError, OptionError
from clvol.bricks.field import BrickedField
from clvol.device import Device
from clvol.reference.march.march import render as reference
from clvol.reference.march.rays import camera_rays

SIZE = (24, 20)
CAMERAS = {
    "perspective": Camera.orbit(30, 20, fit="volume"),
    "orthographic": Camera.orbit(-50, 40, projection="orthographic", fit="volume"),
}
SPACING, ORIGIN = (1.0, 1.3, 0.8), (3.0, -2.0, 1.0)


def blobs(n: int = 40, count: int = 12, seed: int = 1, edge: float = 12.0) -> Volume:
    """Gaussians, which vanish at the faces."""
    random, place = np.random.default_rng(seed), np.mgrid[:n, :n, :n][::-1]
    data = np.zeros((n, n, n))
    for _ in range(count):
        center, width = random.uniform(edge, n - 1 - edge, 3), random.uniform(1.8, 3.5)
        data += random.uniform(0.3, 1) * np.exp(-((place - center[:, None, None, None]) ** 2).sum(0) / (2 * width**2))
    return Volume(data.astype(np.float32))


def rough() -> Volume:
    data = np.random.default_rng(2).normal(300, 900, (14, 16, 18)).astype(np.float32)
    return Volume(data, SPACING, ORIGIN)


def distances(volume: Volume, camera: Camera, size: tuple[int, int]) -> NDArray[np.float64]:
    """Of rays from the volume's centre, (height, width)."""
    rays = camera_rays(volume, camera.view(volume, size[0] / size[1]), size, (0.5, 0.5), None)
    away = volume.center - rays.origin
    return np.linalg.norm(np.cross(away, rays.direction), axis=1).reshape(size[::-1])


def moved(volume: Volume, pose: NDArray[np.float64]) -> Volume:
    from scipy.spatial.transform import Rotation

    turn, center = Rotation.from_rotvec(pose[3:]).as_matrix(), volume.center
    origin = turn @ (np.asarray(volume.origin) - center) + center + pose[:3]
    return replace(volume, origin=tuple(origin), direction=turn @ volume.direction)


@pytest.mark.parametrize("step", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_gaussian_has_its_closed_form(camera: Camera, step: float, device: Device) -> None:
    """∫ exp(-r²/2w²) ds = w √(2π) exp(-d²/2w²), d the ray's distance: to 1e-4 of the largest, with steps of up to two voxels."""
    n, width = 40, 3.0
    away = (np.mgrid[:n, :n, :n] - (n - 1) / 2) * 0.5
    volume = Volume(np.exp(-(away**2).sum(0) / (2 * (0.5 * width) ** 2)).astype(np.float32), (0.5,) * 3)
    got = clvol.render(volume, camera, "integral", SIZE, step, filter="bspline3", outputs="value", device=device)
    most = 0.5 * width * math.sqrt(2 * math.pi)
    want = most * np.exp(-(distances(volume, camera, SIZE) ** 2) / (2 * (0.5 * width) ** 2))
    np.testing.assert_allclose(got, want, atol=1e-4 * most)


def test_a_ball_has_the_length_of_its_chords(device: Device) -> None:
    """2 √(r² - d²), within 1 % of the diameter: its surface is one voxel wide."""
    n, radius = 48, 18.0
    away = np.linalg.norm(np.mgrid[:n, :n, :n] - (n - 1) / 2, axis=0)
    volume = Volume(np.clip(radius + 0.5 - away, 0, 1).astype(np.float32))
    camera = CAMERAS["perspective"]
    got = clvol.render(volume, camera, "integral", SIZE, filter="bspline3", outputs="value", device=device)
    d = distances(volume, camera, SIZE)
    inside = d < 0.9 * radius
    assert inside.sum() > 40
    np.testing.assert_allclose(got[inside], 2 * np.sqrt(radius**2 - d[inside] ** 2), atol=0.3)
    assert not np.asarray(got)[d > radius + 5].round(2).any()


CUTS: dict[str, Any] = {
    "whole": lambda _: None,
    "plane": lambda center: clvol.Plane((1, 0.2, 0.3), center),
    "corner": lambda center: clvol.Corner(center, [np.inf] * 3),
}


@pytest.mark.parametrize("mu_water", [None, 0.02])
@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_numbers_and_colours_are_those_of_the_reference(camera: Camera, cut: str, mu_water: float | None, device: Device) -> None:
    volume = rough()
    own: dict[str, Any] = {} if mu_water is None else {"mu_water": mu_water}
    low, high = (-2e4, 4e4) if mu_water is None else (0.0, 2.0)
    look: dict[str, Any] = {"transfer": TransferFunction.ramp((low, high)), "background": None, "clip": CUTS[cut](volume.center)}
    got = clvol.render(volume, camera, "integral", SIZE, filter="bspline3", outputs=["rgba", "value"], device=device, **look, **own)
    want = reference(volume, camera, "integral", "bspline3", size=SIZE, **look, **own)
    values = np.where(want[..., 3] > 0, low + want[..., 0] * (high - low), 0)
    assert values.max() < high
    np.testing.assert_allclose(got["rgba"], want, atol=2e-6)
    np.testing.assert_allclose(got["value"], values, atol=3e-6 * np.abs(values).max())


def test_what_is_missing_counts_nothing(device: Device) -> None:
    data = np.ones((12, 12, 12), np.float32)
    data[:, :6] = np.nan
    along = Camera.orbit(0, 0, projection="orthographic", fit="volume", zoom=3)  # along y
    got = clvol.render(Volume(data), along, "integral", (5, 5), outputs="value", filter="linear", device=device)
    np.testing.assert_allclose(got, 6, rtol=1e-4)


@pytest.mark.parametrize("own", [{}, {"mu_water": 0.02}])
def test_empty_space_is_skipped_and_no_bit_depends_on_it(own: dict[str, float], device: Device) -> None:
    data = np.full((48, 48, 48), -1000 if own else 0, np.float32)
    data[20:28, 20:28, 20:28] = np.random.default_rng(0).normal(200, 300, (8, 8, 8))
    with Renderer(Volume(data), "linear", device=device) as renderer:
        one, other = (
            renderer.render(mode="integral", size=SIZE, outputs=["rgba", "value", "visited"], skipping=skipping, **own)  # type: ignore[call-overload]
            for skipping in (True, False)
        )
    for name in ("rgba", "value"):
        np.testing.assert_array_equal(one[name], other[name])
    assert np.nanmean(one["visited"]) < 0.7 * np.nanmean(other["visited"])


def test_values_of_projections_are_in_units_of_the_data(device: Device) -> None:
    data = (1e6 + np.random.default_rng(3).normal(0, 1, (12, 12, 12))).astype(np.float32)  # stored without its mean
    along = Camera.orbit(0, 0, projection="orthographic", fit="volume", zoom=3)
    with Renderer(Volume(data), "linear", device=device) as renderer:
        found = {mode: renderer.render(along, mode, (5, 5), 1.0, outputs="value") for mode in ("mip", "mean", "minip", "integral")}
        with pytest.raises(OptionError, match="of projections"):
            renderer.render(mode="composite", size=SIZE, outputs="value")
    assert (found["minip"] < found["mean"]).all()
    assert (found["mean"] < found["mip"]).all()
    assert abs(found["mean"] - 1e6).max() < 2
    assert found["mip"].max() <= data.max()
    np.testing.assert_allclose(found["integral"], 12 * found["mean"], rtol=1e-6)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_derivatives_are_those_of_differences(camera: Camera, device: Device) -> None:
    """To 1e-3 of the largest, and most to 1e-4; in steps of half a voxel, as derivatives are of integrals, not of sums."""
    pose, volume = np.array([1.0, -2.0, 0.5, 0.2, -0.1, 0.3]), blobs()
    with Radiograph(volume, camera, SIZE, 0.5, filter="bspline3", device=device) as radiograph:
        picture, slopes = radiograph.gradient(pose)
        np.testing.assert_array_equal(picture, radiograph(pose))
        for k, step in enumerate((0.02,) * 3 + (0.002,) * 3):
            ahead, behind = (radiograph(pose + way * step * np.eye(6)[k]).astype(np.float64) for way in (1, -1))
            want = (ahead - behind) / (2 * step)
            away = np.abs(slopes[..., k] - want) / np.abs(want).max()
            assert away.max() < 1e-3
            assert np.quantile(away, 0.9) < 1e-4
        with Radiograph(moved(volume, pose), radiograph.camera(), SIZE, 0.5, filter="bspline3", device=device) as other:
            np.testing.assert_allclose(other(), picture, atol=2e-6 * picture.max())


def test_faces_of_the_volume_move_too(device: Device) -> None:
    """The integral through a box of one value is its length there; rays of which none meets an edge of the box."""
    volume, pose = Volume(np.full((16, 16, 16), 3.0, np.float32)), np.array([0.3, 0.0, 0.2, 0.1, 0.2, -0.1])
    with Radiograph(volume, Camera.orbit(0, 0, zoom=4), (6, 6), filter="linear", device=device) as radiograph:
        _, slopes = radiograph.gradient(pose)
        for k in range(6):
            ahead, behind = (radiograph(pose + way * 0.01 * np.eye(6)[k]).astype(np.float64) for way in (1, -1))
            np.testing.assert_allclose(slopes[..., k], (ahead - behind) / 0.02, atol=0.02)


def test_a_pose_is_found_again(device: Device) -> None:
    """5 voxels and 5 degrees away, from two radiographs of another fineness: by Gauss and Newton, in six steps."""
    volume = blobs(48, 14, edge=14.0)
    ways = np.array([3.0, -3.0, 2.6]), np.array([0.6, 0.6, -0.52])
    true = np.concatenate([length * way / np.linalg.norm(way) for length, way in zip((5, math.radians(5)), ways, strict=True)])
    cameras, pose = [Camera.orbit(azimuth, 10) for azimuth in (0, 90)], np.zeros(6)
    views = [Radiograph(volume, camera, (32, 32), filter="bspline3", device=device) for camera in cameras]
    places = [view.camera() for view in views]
    shot = moved(volume, true)
    fixed = [clvol.render(shot, at, "integral", (32, 32), 0.4, filter="bspline3", outputs="value", device=device) for at in places]
    for _ in range(6):
        seen = [view.gradient(pose) for view in views]
        slopes = np.concatenate([slope.reshape(-1, 6) for _, slope in seen])
        away = np.concatenate([(want - picture).ravel() for want, (picture, _) in zip(fixed, seen, strict=True)])
        pose = pose + np.linalg.lstsq(slopes, away, rcond=None)[0]
    for view in views:
        view.close()
    assert np.linalg.norm(pose[:3] - true[:3]) < 0.05
    assert np.degrees(np.linalg.norm(pose[3:] - true[3:])) < 0.05


def test_what_has_no_derivatives_is_refused(device: Device) -> None:
    volume = blobs(16, 2, edge=6.0)
    with Renderer(volume, device=device) as renderer:
        for options, message in (
            ({"mode": "mean"}, "of line integrals"),
            ({"mode": "integral", "clip": ((0, 0, 0), (5, 5, 5))}, "whole volumes"),
        ):
            with pytest.raises(OptionError, match=message):
                renderer.render(size=SIZE, outputs="pose", **options)  # type: ignore[call-overload]
    with pytest.raises(OptionError, match="with slopes"):
        Radiograph(volume, filter="nearest", device=device)
    with pytest.raises(OptionError, match="in memory"):
        Radiograph(replace(volume, data=np.where(volume.data > 0.5, np.nan, volume.data)), device=device)
    with pytest.raises(OptionError, match="one volume"):
        Radiograph(clvol.Scene([volume, volume]), device=device)
    with Radiograph(volume, size=(4, 4), device=device) as radiograph, pytest.raises(OptionError, match="six finite numbers"):
        radiograph((0, 0, 0))


def test_integrals_that_float32_does_not_hold_are_refused(device: Device) -> None:
    with pytest.raises(DataError, match="integrals"):
        clvol.render(np.full((4, 4, 4), 1e37, np.float32) * np.arange(4), mode="integral", size=(4, 4), device=device)
    with pytest.raises(OptionError, match="labels are names"):
        clvol.render(Volume(np.ones((4, 4, 4), np.uint8), labels=True), mode="integral", mu_water=0.02, size=(4, 4), device=device)


@pytest.mark.parametrize("own", [{}, {"mu_water": 0.02}])
def test_by_bricks_numbers_are_the_same(own: dict[str, float], device: Device) -> None:
    """Bricks of air are not read. Sums are added up brick by brick, in another order."""
    data = np.full((40, 40, 40), -1000.0, np.float32)
    data[4:14, 6:16, 20:30] = 300.0 + np.random.default_rng(4).normal(0, 50, (10, 10, 10))
    volume = Volume(data, SPACING, ORIGIN)
    look: dict[str, Any] = {"camera": CAMERAS["perspective"], "mode": "integral", "size": SIZE, "outputs": ["rgba", "value"], **own}
    with BrickedField(volume, "linear", device=device, edge=16) as field, Renderer(field) as renderer:
        got = renderer.render(**look)
        with pytest.raises(OptionError, match="in memory"):
            renderer.render(**{**look, "outputs": "pose"})
    with Renderer(volume, "linear", device=device) as renderer:
        want = renderer.render(**look)
    np.testing.assert_allclose(got["rgba"], want["rgba"], atol=1e-6)
    np.testing.assert_allclose(got["value"], want["value"], atol=1e-6 * float(np.abs(want["value"]).max()))
