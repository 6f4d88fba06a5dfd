"""Positions far from the world's origin, at wide angles and on long axes, against rays and spheres intersected in float64 here."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import clvol
from clvol import Camera, DisplacementField, Volume
from clvol.base.errors import GeometryError
from clvol.device import Device
from clvol.scene.camera import Viewpoint

SIDE, RADIUS = 40, 12.0


def ball(origin: tuple[float, float, float], spacing: float = 1.0) -> Volume:
    """r² about the centre, which the cubic B-spline reproduces there."""
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE] - (SIDE - 1) / 2
    return Volume(x * x + y * y + z * z, (spacing,) * 3, origin)


def rays(view: Viewpoint, size: tuple[int, int]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Origins and unit directions of the rays through the middles of the pixels."""
    width, height = size
    a = 2 * (np.arange(width) + 0.5) / width - 1
    b = 1 - 2 * (np.arange(height) + 0.5) / height
    plane = view.half_height * (a[None, :, None] * width / height * view.right + b[:, None, None] * view.up)
    if view.orthographic:
        return view.eye + plane, np.broadcast_to(view.forward, plane.shape)
    along = view.forward + plane
    return np.broadcast_to(view.eye, plane.shape), along / np.linalg.norm(along, axis=-1, keepdims=True)


def sphere_points(volume: Volume, view: Viewpoint, size: tuple[int, int], radius: float) -> np.ndarray[Any, Any]:
    """Where each ray first meets the sphere, relative to its centre; NaN if it misses."""
    origin, direction = rays(view, size)
    center = np.asarray(volume.origin) + np.asarray(volume.spacing) * (SIDE - 1) / 2
    o = origin - center
    b, c = (o * direction).sum(-1), (o * o).sum(-1) - radius**2
    with np.errstate(invalid="ignore"):
        t = -b - np.sqrt(b * b - c)
    return o + t[..., None] * direction


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("distance", [0.0, 1e6, 1e7, 1e9])
def test_positions_are_as_exact_far_from_the_origin(device: Device, distance: float, projection: Any) -> None:
    volume, size = ball((distance, -3 * distance, 0.7 * distance)), (60, 48)
    camera = Camera.orbit(30, 20, zoom=1.5, projection=projection, fit="volume")
    options: dict[str, Any] = {"isovalue": RADIUS**2, "size": size, "device": device}
    got = clvol.render(volume, camera, "isosurface", outputs="position", **options)
    assert got.dtype == np.float64
    want = sphere_points(volume, camera.view(volume, size[0] / size[1]), size, RADIUS)
    both = np.isfinite(got[..., 0]) & np.isfinite(want[..., 0])
    assert both.sum() > 400
    assert both.sum() > 0.98 * np.isfinite(want[..., 0]).sum()
    p = got[both] - (np.asarray(volume.origin) + (SIDE - 1) / 2)
    _, direction = rays(camera.view(volume, size[0] / size[1]), size)
    rim = np.abs((p * direction[both]).sum(1)) < 0.2 * RADIUS  # grazed: where the ray meets it is ill-defined
    assert np.abs(np.linalg.norm(p, axis=1) - RADIUS).max() < 2e-4
    assert np.abs(p - want[both])[~rim].max() < 1e-3


@pytest.mark.parametrize("distance", [1e6, 1e7])
def test_clip_boxes_and_normals_are_exact_far_from_the_origin(device: Device, distance: float) -> None:
    """Faces of a box in front of the ball: positions lie on them, and the picture equals that at the origin."""
    size, camera = (48, 48), Camera.orbit(30, 20, zoom=1.5, fit="volume")
    near, far = ball((0, 0, 0)), ball((distance, -distance, 2 * distance))
    pictures = []
    for volume in (near, far):
        middle = np.asarray(volume.origin) + (SIDE - 1) / 2
        options: dict[str, Any] = {"isovalue": RADIUS**2, "clip": (middle - 5.3, middle + 15), "size": size, "device": device}
        got = clvol.render(volume, camera, "isosurface", outputs=("rgba", "normal", "position"), **options)
        pictures.append((got, got["position"] - middle))
    np.testing.assert_allclose(pictures[1][0]["rgba"], pictures[0][0]["rgba"], atol=1e-4)
    np.testing.assert_allclose(pictures[1][0]["normal"], pictures[0][0]["normal"], atol=1e-4)
    np.testing.assert_allclose(pictures[1][1], pictures[0][1], atol=2e-4)


WIDE = [(fov, zoom) for fov in (90.0, 150.0, 170.0, 179.0, 179.9) for zoom in (1.0, 0.1, 0.01, 0.001)]


@pytest.mark.parametrize(("fov", "zoom"), WIDE)
def test_wide_cameras_are_exact_or_rejected(device: Device, fov: float, zoom: float) -> None:
    """Positions lie on the rays within 1/16 voxel, and skipping changes nothing; else an error names the limit."""
    volume, camera, size = ball((0, 0, 0)), Camera(direction=(0.3, 0.8, -0.5), fov=fov, zoom=zoom, fit="volume"), (49, 33)
    corner = np.tan(np.radians(fov / 2)) / zoom
    with clvol.Renderer(volume, "linear", device=device) as renderer:
        if corner * volume.radius > 200_000:
            with pytest.raises(GeometryError, match="must span at most 262144 voxels"):
                renderer.render(camera, "mip", size, outputs=("rgba", "position"))
            return
        got = renderer.render(camera, "mip", size, outputs=("rgba", "position"))
        plain = renderer.render(camera, "mip", size, outputs=("rgba", "position"), skipping=False)
    for name in got:
        np.testing.assert_array_equal(got[name], plain[name])
    origin, direction = rays(camera.view(volume, size[0] / size[1]), size)
    there = np.isfinite(got["position"][..., 0])
    assert there.any()
    q = (got["position"] - origin)[there]
    off = q - (q * direction[there]).sum(-1, keepdims=True) * direction[there]
    assert np.linalg.norm(off, axis=1).max() < 1 / 16


UNEQUAL = [
    (64, (1e-4, 1, 1), "perspective"),
    (64, (1e-4, 1, 1), "orthographic"),
    (16, (1e-5, 1, 1), "perspective"),
    (24, (1, 1e-4, 1), "perspective"),
]


@pytest.mark.parametrize(("side", "spacing", "projection"), UNEQUAL)
def test_unequal_spacings_move_nothing_off_its_ray(
    device: Device, side: int, spacing: tuple[float, float, float], projection: Any
) -> None:
    """By the default camera: positions lie on the rays within 1/16 of a voxel, and within a voxel of the volume.

    (Volumes 10⁴ times as thin along the view as across were rejected for what moves samples along their rays alone.)
    """
    volume, size = Volume(np.ones((side,) * 3, np.float32), spacing), (24, 20)
    camera = Camera.orbit(projection=projection, fit="volume")
    with clvol.Renderer(volume, "linear", device=device) as renderer:
        got = renderer.render(camera, "mip", size, outputs=("rgba", "position"))
        plain = renderer.render(camera, "mip", size, outputs=("rgba", "position"), skipping=False)
    for name in got:
        np.testing.assert_array_equal(got[name], plain[name])
    origin, direction = rays(camera.view(volume, size[0] / size[1]), size)
    there = np.isfinite(got["position"][..., 0])
    assert there.sum() > 15
    q, d = ((a - b)[there] / spacing for a, b in ((got["position"], origin), (direction, np.zeros(3))))
    off = q - (q * d).sum(-1, keepdims=True) / (d * d).sum(-1, keepdims=True) * d
    assert np.linalg.norm(off, axis=1).max() < 1 / 16
    index = got["position"][there] / spacing
    assert (index > -1.5).all()
    assert (index < side + 0.5).all()


def test_spacings_beyond_float32_are_named(device: Device) -> None:
    needle = Volume(np.ones((128, 4, 4), np.float32), (1, 1, 1e4))
    with pytest.raises(GeometryError, match=r"the spacings \(1[.]0, 1[.]0, 10000[.]0\) give"):
        clvol.render(needle, size=(16, 16), device=device)


def test_a_camera_that_sees_nothing_of_the_volume_may_be_anywhere(device: Device) -> None:
    away = Camera.look_at((1e8, 0, 0), (2e8, 1e3, 0))
    got = clvol.render(ball((0, 0, 0)), away, "mip", size=(16, 16), background="red", device=device)
    np.testing.assert_array_equal(got, np.broadcast_to(np.float32([1, 0, 0, 1]), got.shape))


def test_cameras_as_far_as_float64_reaches_are_rejected(device: Device) -> None:
    """(Squares of 1e155 overflow: "cannot convert float NaN to integer".)"""
    for position in ((1e155, 1e155, 0.0), (1e300, -1e300, 1e300), (-1.7e308, 0.0, 0.0)):
        for target in (None, (1.7e308, 0.0, 0.0)):
            with pytest.raises(GeometryError, match=r"must be within"):
                clvol.render(ball((0, 0, 0)), Camera.look_at(position, target), "mip", size=(8, 8), device=device)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_long_axes_are_exact_or_rejected(device: Device, axis: int) -> None:
    """A ramp at the far end of an axis: its surface is at the isovalue within 1/64 voxel."""
    for n, taken in ((1 << 18, True), ((1 << 18) + 1, False), (5_000_000, False)):
        shape = [3, 3, 3]
        shape[2 - axis] = n
        line = np.zeros(n, np.float32)
        line[-64:] = np.arange(64)
        data = np.broadcast_to(line.reshape([-1 if k == 2 - axis else 1 for k in range(3)]), shape)
        target = np.ones(3)
        target[axis] = n - 30
        camera = Camera(tuple(target - [0.5, 2.5, 3.5]), tuple(target), (0.3, 0.1, 1), projection="orthographic", zoom=n / 6)
        options: dict[str, Any] = {"size": (24, 24), "isovalue": 34.25, "device": device}
        if not taken:
            with pytest.raises(GeometryError, match="rendering takes axes of up to 262144 samples"):
                clvol.render(data, camera, "isosurface", filter="linear", outputs="position", **options)
            continue
        got = clvol.render(data, camera, "isosurface", filter="linear", outputs="position", **options)[..., axis]
        there = np.isfinite(got)
        assert there.any()
        assert np.abs(got[there] - (n - 64 + 34.25)).max() < 1 / 64


@pytest.mark.one_in(2)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_samples_are_exact_on_axes_that_pictures_reject(device: Device, axis: int) -> None:
    n, shape = 2_000_000, [2, 2, 2]
    shape[2 - axis] = n
    line = np.zeros(n, np.float32)
    line[-64:] = np.arange(64)
    data = np.broadcast_to(line.reshape([-1 if k == 2 - axis else 1 for k in range(3)]), shape)
    points = np.random.default_rng(axis).uniform(0, 1, (500, 3))
    points[:, axis] = n - 60 + 50 * points[:, axis]
    bound = 1e-4 if device.has_double else 1.0  # rounded to float32, positions err by up to an eighth of a voxel
    assert np.abs(clvol.sample(data, points, "linear", device=device) - (points[:, axis] - (n - 64))).max() < bound


# -- devices without float64 ---------------------------------------------------------------------------------------------

DISTANT = (1e6, -2e6, 3e6)


@pytest.fixture
def single(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device as one without float64."""
    monkeypatch.setattr(type(device), "has_double", property(lambda _: False))
    return device


def distant(origin: tuple[float, float, float]) -> Volume:
    return Volume(np.random.default_rng(0).normal(size=(13, 15, 17)), (0.1, 0.2, 0.15), origin)


@pytest.mark.parametrize("sorting", [False, True])
def test_points_far_from_the_origin_without_double_precision(single: Device, sorting: bool) -> None:
    """Against SciPy at the indices that the positions were made of."""
    volume = distant(DISTANT)
    at = np.random.default_rng(1).uniform(2, 10, (300, 3))
    points = volume.index_to_world(at)
    expected = ndimage.map_coordinates(volume.data, at[:, ::-1].T, order=3, mode="mirror")
    field, near = clvol.Field(volume, device=single), clvol.Field(volume.data, device=single)
    with single.limited(sorting=sorting), field, near:
        np.testing.assert_allclose(field(points), expected, rtol=0, atol=1e-5 * np.ptp(volume.data))
        np.testing.assert_allclose(field.gradient(points), near.gradient(at) / volume.spacing, rtol=0, atol=1e-3)
        # float32 points are already rounded: what they say is what is sampled
        coarse = ((points * 2).round() / 2).astype(np.float32)
        np.testing.assert_allclose(field(coarse), field(coarse.astype(np.float64)), rtol=0, atol=1e-5 * np.ptp(volume.data))


def test_scattering_far_from_the_origin_without_double_precision(single: Device) -> None:
    """The sums at distant points are those at the same indices near the origin."""
    volume, dice = distant(DISTANT), np.random.default_rng(2)
    at, values = dice.uniform(2, 10, (50, 3)), dice.normal(size=50)
    far = clvol.adjoint(values, volume.index_to_world(at), volume, device=single)
    near = clvol.adjoint(values, at, volume.data.shape, device=single)
    np.testing.assert_allclose(far, near, rtol=0, atol=1e-5 * np.abs(near).max())


def test_transforms_far_from_the_origin_without_double_precision(single: Device) -> None:
    """Displacements and an affine map about the volume's centre change nothing but the place, wherever that is."""
    pictures = []
    for origin in ((0.0, 0.0, 0.0), DISTANT):
        volume = distant(origin)
        shifts = 0.2 * np.random.default_rng(3).normal(size=(4, 4, 4, 3))
        bend = DisplacementField(shifts, spacing=(0.5, 0.9, 0.6), origin=origin)
        turn = clvol.AffineTransform(np.eye(3) + 0.05, np.zeros(3), volume.center)
        result = clvol.warp(volume, volume, [turn, bend, turn, bend], derivative=1, jacobian=True, device=single)
        assert result.gradient is not None
        assert result.jacobian is not None
        pictures.append((result.values.data, result.gradient, result.jacobian.data))
    for near, far in zip(*pictures, strict=True):
        np.testing.assert_allclose(far, near, rtol=0, atol=1e-4 * np.abs(near).max())
