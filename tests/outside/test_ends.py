"""Starts and ends of rays, compared with line integrals in float64 along the same rays, computed by SciPy."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

import clvol
from clvol.device import Device, Tile

Array = NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

TILES = {"planes": Tile(16, 16, 8, shared=True), "eights": Tile(16, 15, 8, shared=True), "rays": Tile(1, 1, 1, shared=False)}
SIZE = (30, 26)
CLIP: Box = ((2.3, 3.17, 1.91), (9.61, 8.83, 9.37))
THROUGH = ((0.0, 0.02), (1.0, 0.5))  # opacities of a smooth function of the value


@lru_cache
def smooth() -> NDArray[np.float32]:
    z, y, x = np.meshgrid(*[np.arange(12.0)] * 3, indexing="ij")
    return (0.5 + 0.3 * np.sin(0.5 * x + 0.3 * z) * np.cos(0.4 * y - 0.2 * x)).astype(np.float32)


EYE = {"perspective": (25.0, -20.0, 14.0), "wide": (9.0, -1.0, 7.0)}
CAMERAS = {
    "perspective": clvol.Camera(position=EYE["perspective"], fov=26),
    "wide": clvol.Camera(position=EYE["wide"], fov=100),  # some rays step along their own direction
}


def rays(camera: str, size: tuple[int, int] = SIZE) -> tuple[Array, Array]:
    """The eye and the unit directions of the rays, (height, width, 3), by the definition of a perspective camera."""
    (width, height), eye = size, np.array(EYE[camera])
    forward = 5.5 - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    h = np.tan(np.radians(CAMERAS[camera].fov) / 2)
    a = (2 * (np.arange(width) + 0.5) / width - 1) * width / height
    b = 1 - 2 * (np.arange(height) + 0.5) / height
    along = forward + h * (a[None, :, None] * right + b[:, None, None] * up)
    return eye, along / np.linalg.norm(along, axis=-1, keepdims=True)


def stretches(eye: Array, along: Array, box: Box) -> tuple[Array, Array]:
    """Where rays enter and leave a box and the domain, -1/2 .. 11 1/2."""
    low, high = np.maximum(box[0], -0.5), np.minimum(box[1], 11.5)
    with np.errstate(divide="ignore"):
        a, b = (low - eye) / along, (high - eye) / along
    return np.maximum(np.minimum(a, b).max(-1), 0), np.maximum(a, b).min(-1)


def along_rays(eye: Array, along: Array, enter: Array, leave: Array, n: int = 600) -> tuple[Array, Array]:
    """Values at Gauss-Legendre nodes of every ray, and the nodes' weights, in units of length; (..., n)."""
    at, weights = np.polynomial.legendre.leggauss(12)
    pieces = n // 12
    share = ((np.arange(pieces)[:, None] + (at + 1) / 2) / pieces).ravel()
    length = np.maximum(leave - enter, 0)[..., None]
    t = enter[..., None] + share * length
    points = eye + t[..., None] * along[..., None, :]
    values = map_coordinates(
        spline_filter(smooth().astype(np.float64), 3, mode="mirror"),
        points[..., ::-1].reshape(-1, 3).T,
        order=3,
        mode="mirror",
        prefilter=False,
    )
    return values.reshape(t.shape), length * np.tile(weights / 2 / pieces, pieces)


def true_picture(camera: str, box: Box) -> dict[str, Array]:
    """Opacity, the distance where half of the light is stopped, and the mean; NaN off the box."""
    eye, along = rays(camera)
    enter, leave = stretches(eye, along, box)
    values, weights = along_rays(eye, along, enter, leave)
    stopped = -np.log1p(-np.interp(values, *np.array(THROUGH).T))
    depth = np.cumsum(stopped * weights, -1)
    hit = leave > enter + 1e-3
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (values * weights).sum(-1) / weights.sum(-1)
    # behind node k about half of its weight is still to come
    middles = depth - stopped * weights / 2
    nodes = enter[..., None] + np.cumsum(weights, -1) - weights / 2
    half = np.array(
        [np.interp(np.log(2), m, t, right=np.inf) for m, t in zip(middles.reshape(-1, 600), nodes.reshape(-1, 600), strict=True)]
    )
    return {
        "opacity": np.where(hit, -np.expm1(-depth[..., -1]), np.nan),
        "depth": np.where(hit, half.reshape(hit.shape), np.nan),
        "mean": np.where(hit, mean, np.nan),
    }


def drawn(device: Device, camera: str, box: Box, step: float, **options: Any) -> dict[str, Array]:
    look: dict[str, Any] = {
        "camera": CAMERAS[camera],
        "size": SIZE,
        "step": step,
        "clip": box,
        "background": None,
        "rays": 1,
        **options,
    }
    transfer = clvol.TransferFunction(((0.0, "black"), (1.0, "white")), THROUGH, 1.0)
    with clvol.Renderer(smooth(), "bspline3", "mirror", device) as renderer:
        light = renderer.render(
            mode="composite", transfer=transfer, outputs=("rgba", "depth"), shading=False, termination=0.0, **look
        )
        mean = renderer.render(mode="mean", transfer=transfer, **look)
    return {
        "opacity": light["rgba"][..., 3].astype(np.float64),
        "depth": light["depth"].astype(np.float64),
        "mean": mean[..., 0].astype(np.float64),
    }


@pytest.mark.one_in(6)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("camera", CAMERAS)
def test_the_error_at_clip_planes_is_of_second_order(device: Device, camera: str, tile: str) -> None:
    """It depends on how sample planes meet the box; over many steps it falls quadratically, and is never large."""
    true, steps = true_picture(camera, CLIP), 2.0 ** -np.arange(0, 5.1, 0.5)
    enter, leave = stretches(*rays(camera), CLIP)
    with device.limited(tile=TILES[tile]):
        made = [drawn(device, camera, CLIP, step) for step in steps]
    for name, most in (("opacity", 0.02), ("depth", 0.06), ("mean", 0.04)):
        seen = np.isfinite(true[name]) & (leave - enter > 1)
        assert seen.sum() > 100
        errors = [np.abs(np.where(np.isfinite(one[name]), one[name], 1e3) - true[name])[seen] for one in made]
        for step, error in zip(steps, errors, strict=True):
            assert error.max() < most * step**2 + 2e-5, (name, step, error.max())
        order = np.polyfit(np.log(steps), np.log([np.sqrt(np.square(error).mean()) for error in errors]), 1)[0]
        assert order > 1.7, (name, order)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("tile", TILES)
def test_a_thin_slab_has_its_opacity_wherever_it_lies(device: Device, tile: str) -> None:
    """0.2 voxel of matter that absorbs half of the light per voxel: 1 - 0.5^0.2 = 0.1294."""
    fog = clvol.TransferFunction(((0.0, "white"),), ((0.0, 0.5),), 1.0)
    camera = clvol.Camera(direction=(0, 1, 0), up=(0, 0, 1), projection="orthographic", fit="volume")
    look: dict[str, Any] = {"size": (20, 17), "transfer": fog, "background": None, "outputs": ("rgba", "visited"), "rays": 1}
    with device.limited(tile=TILES[tile]), clvol.Renderer(np.zeros((12, 12, 12), np.float32), device=device) as renderer:
        for at in np.arange(1.0, 3.0, 0.1):
            clip = ((-np.inf, at, -np.inf), (np.inf, at + 0.2, np.inf))
            for skipping in (True, False):
                made = renderer.render(camera, "composite", step=1.0, clip=clip, shading=False, skipping=skipping, **look)
                hit = np.isfinite(made["visited"])
                assert hit.sum() > 60
                np.testing.assert_allclose(made["rgba"][hit][:, 3], 1 - 0.5**0.2, atol=1e-5)
                assert (made["visited"][hit] == 1).all()


@pytest.mark.one_in(2)
@pytest.mark.parametrize("camera", CAMERAS)
def test_a_thin_slab_is_correct_in_every_mode(device: Device, camera: str) -> None:
    """Rays between two planes have one sample, in their middle: value, light and position are correct."""
    box: Box = ((1.0, 1.0, 5.21), (10.0, 10.0, 5.33))
    eye, along = rays(camera)
    enter, leave = stretches(eye, along, box)
    true = true_picture(camera, box)
    made: list[dict[str, Array]] = []
    for tile in TILES.values():
        with device.limited(tile=tile):
            made += [drawn(device, camera, box, 1.0)]
            ramp = clvol.TransferFunction.ramp((0, 1))
            look: dict[str, Any] = {"camera": CAMERAS[camera], "size": SIZE, "step": 1.0, "clip": box, "background": None}
            for mode in ("mip", "minip"):
                picture = clvol.render(smooth(), mode=mode, transfer=ramp, device=device, **look)
                assert (picture[..., 3][leave > enter + 1e-3] == 1).all()
                short = (leave > enter + 1e-3) & (leave - enter < 0.5)
                np.testing.assert_allclose(picture[..., 0][short], true["mean"][short], atol=0.05)
    inside = np.isfinite(true["opacity"]) & (leave - enter < 1)
    assert inside.sum() > 50
    for one in made:
        for name, most in (("opacity", 0.015), ("mean", 0.04)):
            np.testing.assert_allclose(one[name][inside], true[name][inside], atol=most)
    for name in ("opacity", "mean"):
        for one in made[1:]:
            np.testing.assert_allclose(one[name], made[0][name], atol=2e-6)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("tile", TILES)
def test_light_on_a_thin_slab(device: Device, tile: str) -> None:
    """Shading uses the gradient at the middle sample, as anywhere in matter."""
    z, y, x = np.meshgrid(*[np.arange(12.0)] * 3, indexing="ij")
    ramp = (x + 2 * y - z).astype(np.float32)
    transfer = clvol.TransferFunction(((0.0, (0.8, 0.6, 0.4)),), ((0.0, 0.9),), 1.0)
    look: dict[str, Any] = {
        "size": (20, 17),
        "transfer": transfer,
        "background": None,
        "lights": clvol.Light((1, -2, 0.5)),
        "step": 1.0,
    }
    camera = clvol.Camera(direction=(0.1, 1, 0.2), projection="orthographic", fit="volume")
    colors = []
    with device.limited(tile=TILES[tile]), clvol.Renderer(ramp, "linear", device=device) as renderer:
        for at in (5.1, 5.4, 5.6):
            clip = ((2.0, at, 2.0), (9.0, at + 0.2, 9.0))
            made = renderer.render(camera, "composite", clip=clip, **look)
            colors.append(made[made[..., 3] > 0][:, :3])
    for one in colors:
        assert len(one) > 20
        np.testing.assert_allclose(one, np.broadcast_to(colors[0][0], one.shape), atol=1e-5)
