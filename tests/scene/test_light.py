"""Lights, materials and colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import phantoms
from clvol.base.color import color_of
from clvol.base.errors import ClvolError, GeometryError, OptionError
from clvol.device import Device
from clvol.march.renderer import render
from clvol.scene.camera import Camera
from clvol.scene.light import HEADLIGHT, KIT, MAX_LIGHTS, Light, Material


def test_directions_are_normalised() -> None:
    assert Light((0, 3, 4)).direction == pytest.approx((0, 0.6, 0.8))
    assert HEADLIGHT.direction is None
    assert Light(color="red").color == (1, 0, 0)  # type: ignore[arg-type]


def test_colours() -> None:
    assert color_of("c", "white") == (1, 1, 1)
    assert color_of("c", "#ff8000") == pytest.approx((1, 128 / 255, 0))
    assert color_of("c", (0.1, 2, 0)) == (0.1, 2, 0)
    assert color_of("c", np.array([1, 0, 0])) == (1, 0, 0)  # type: ignore[arg-type]


def test_each_component_of_light_on_a_sphere(device: Device) -> None:
    """Ambient everywhere; diffuse towards the light; a highlight halfway between light and viewer."""
    volume, camera = phantoms.sphere(32), Camera.orbit(0, 0, projection="orthographic", fit="volume")
    options: dict[str, Any] = {"camera": camera, "mode": "isosurface", "isovalue": 0.5, "color": "white"}
    options |= {"size": (65, 65), "rays": 1, "device": device}

    def picture(material: Material, light: Light) -> np.ndarray[Any, Any]:
        return np.asarray(render(volume, material=material, lights=[light], outputs=("rgba", "normal"), **options)["rgba"][..., 0])

    normals = render(volume, outputs="normal", **options)
    hit = np.isfinite(normals[..., 0])
    right = Light((1, 0, 0))
    flat = picture(Material(0.5, 0, 0, 1), right)
    np.testing.assert_allclose(flat[hit], 0.5, atol=1e-6)
    diffuse = picture(Material(0, 1, 0, 1), right)
    np.testing.assert_allclose(diffuse[hit], np.maximum(normals[hit][:, 0], 0), atol=1e-5)
    head = picture(Material(0, 1, 0, 1), HEADLIGHT)
    np.testing.assert_allclose(head[hit], -normals[hit][:, 1], atol=1e-5)  # the view runs along +y
    shine = picture(Material(0, 0, 1, 20), right)
    half = normals[hit] @ (np.array([1, -1, 0]) / np.sqrt(2))
    np.testing.assert_allclose(shine[hit], np.where(normals[hit][:, 0] > 1e-4, np.maximum(half, 0) ** 20, shine[hit]), atol=1e-4)
    assert picture(Material(0, 1, 1, 20), Light((0, 1, 0)))[hit].max() < 1e-5  # from behind


def test_lights_add_up(device: Device) -> None:
    volume = phantoms.sphere(16)
    options: dict[str, Any] = {"mode": "isosurface", "isovalue": 0.5, "size": (16, 16), "device": device, "background": None}
    options["rays"] = 1
    colors = [(0.2, 0, 0), (0, 0.3, 0.1), (0.1, 0.1, 0.1), (0.1, 0, 0.2)]
    directions = [(1, -1, 0), (-1, -1, 1), None, (0, -1, 0)]
    lights = [Light(*pair) for pair in zip(directions, colors, strict=True)]
    assert len(lights) == MAX_LIGHTS
    dark = Material(0, 0.5, 0.2, 10)
    alone = sum(render(volume, lights=[light], material=dark, **options)[..., :3] for light in lights)
    np.testing.assert_allclose(render(volume, lights=lights, material=dark, **options)[..., :3], alone, atol=1e-5)


def test_lights_that_move_with_the_camera(device: Device) -> None:
    """Right, up and towards the viewer, in every view."""
    volume, camera = phantoms.sphere(32), Camera.orbit(40, 25, projection="orthographic", fit="volume")
    options: dict[str, Any] = {"camera": camera, "mode": "isosurface", "isovalue": 0.5, "color": "white", "rays": 1}
    options |= {"size": (65, 65), "device": device, "outputs": ("rgba", "normal"), "material": Material(0, 1, 0, 1)}
    view = camera.view(volume)
    for direction, axis in (((2, 0, 0), view.right), ((0, 1, 0), view.up), ((0, 0, 1), -view.forward)):
        got = render(volume, lights=Light(direction, frame="camera"), **options)
        hit = np.isfinite(got["normal"][..., 0])
        np.testing.assert_allclose(got["rgba"][hit][:, 0], np.maximum(got["normal"][hit] @ axis, 0), atol=1e-5)


def test_the_default_lights_reach_all_visible_surfaces_without_overexposure() -> None:
    normals = np.random.default_rng(0).normal(size=(5000, 3))
    normals[:, 2] = np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    placed = [light.placed(Camera(direction=(0, 0, -1), up=(0, 1, 0)).view(phantoms.sphere(8))) for light in KIT]
    light = sum(np.maximum(normals @ np.array(one.direction or (0, 0, 1)), 0) * one.color[0] for one in placed)
    assert 0.95 < light.max() <= 1
    assert light[normals[:, 2] > 0.3].min() > 0.1
    assert light[normals @ [-0.45, 0.55, 0.7] > 0.9].mean() > 1.5 * light[normals @ [0.45, -0.55, 0.7] > 0.9].mean()  # it models


WRONG: dict[str, tuple[Any, type[ClvolError], str]] = {
    "no direction": (lambda: Light((0, 0, 0)), GeometryError, "a light's direction must be three finite numbers, not all zero"),
    "frame": (lambda: Light((1, 0, 0), frame="volume"), OptionError, "a light's frame must be one of world, camera; got 'volume'"),  # type: ignore[arg-type]
    "flat direction": (lambda: Light((1, 0)), GeometryError, "a light's direction"),  # type: ignore[arg-type]
    "NaN direction": (lambda: Light((1, 0, float("nan"))), GeometryError, "a light's direction"),
    "colour": (lambda: Light(color=(1, 2)), OptionError, "a light's color must be three numbers"),  # type: ignore[arg-type]
    "negative colour": (lambda: Light(color=(1, 2, -1)), OptionError, "must be finite and not negative"),
    "ambient": (lambda: Material(ambient=-0.1), OptionError, "ambient must be a finite number, at least 0; got -0.1"),
    "shininess": (lambda: Material(shininess=float("inf")), OptionError, "shininess must be a finite number"),
    "diffuse": (lambda: Material(diffuse="lots"), OptionError, "diffuse must be a finite number"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", WRONG)
def test_errors(case: str) -> None:
    make, kind, message = WRONG[case]
    with pytest.raises(kind, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: Light("abc"), GeometryError),
        (lambda: Light(3), GeometryError),
        (lambda: Light((1, "a", 2)), GeometryError),
        (lambda: Light(color=None), OptionError),
        (lambda: Light(color=3), OptionError),
        (lambda: Light(color=b"abc"), OptionError),
        (lambda: Material(ambient=None), OptionError),
        (lambda: Material(diffuse=True), OptionError),
    ],
)
def test_wrong_types_are_rejected(make: Any, kind: type[ClvolError]) -> None:
    with pytest.raises(kind):
        make()


def test_numpy_scalars_are_accepted() -> None:
    assert Material(np.float32(0.5), np.int64(1), np.array(0.25), 2) == Material(0.5, 1.0, 0.25, 2.0)
    assert Light(np.array([0, 0, 2])).direction == (0, 0, 1)
