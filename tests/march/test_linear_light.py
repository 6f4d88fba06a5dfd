"""Colours in linear light: the reference's pictures, by every path that mixes colours, and what stays as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Scene
from clvol.base.errors import OptionError
from clvol.base.srgb import as_light, as_shown
from clvol.device import Device
from clvol.reference.march import march as reference
from clvol.reference.march.light import light_of, shown_as
from clvol.reference.march.media import render_media
from tests.march.agreement import CAMERA, SIZE, STEP, TRANSFER, block
from tests.march.test_media import FIRST, MEDIA, camera

SHELLS = [(0.35, "orange", 0.3), (0.6, "teal", 0.6), (0.85, "white", 0.9)]
LOOKS: dict[str, dict[str, Any]] = {
    "composite": {"transfer": TRANSFER, "termination": 0.0},
    "isosurface": {"isovalue": 0.5, "color": "orange", "cap": "teal"},
    "surfaces": {"surfaces": SHELLS},
}


def test_numbers_of_srgb_are_light() -> None:
    """By IEC 61966-2-1: half of white light is shown as 0.735, and middle grey reflects a fifth."""
    assert as_shown([0, 0.5, 1]) == pytest.approx([0, 0.7354, 1], abs=1e-4)
    assert as_light(119 / 255) == pytest.approx(0.184, abs=1e-3)
    each = np.linspace(-0.5, 3, 4001)
    np.testing.assert_allclose(as_shown(as_light(each)), each, atol=2e-7)
    np.testing.assert_allclose(light_of(each), as_light(each), atol=1e-12)
    np.testing.assert_allclose(shown_as(each), as_shown(each), atol=1e-12)


@pytest.mark.parametrize("background", [None, "#305070"])
@pytest.mark.parametrize("mode", LOOKS)
def test_pictures_are_the_references(device: Device, mode: str, background: str | None) -> None:
    """With the default lights, several rays a pixel, and a face that a cut opens."""
    look = LOOKS[mode] | {"background": background, "rays": 3, "linear_light": True, "clip": ((5, -3, 2), (12, 2, 9))}
    got = clvol.render(block(), CAMERA, mode, SIZE, STEP, device=device, filter="bspline3", **look)
    want = reference.render(block(), CAMERA, mode, "bspline3", size=SIZE, step=STEP, **look)
    apart = np.abs(got - want).max(-1)
    assert (apart > 2e-4).sum() <= 1, np.sort(apart.ravel())[-4:]
    assert np.sqrt((apart**2).mean()) < 2e-5
    before = clvol.render(block(), CAMERA, mode, SIZE, STEP, device=device, filter="bspline3", **look | {"linear_light": False})
    assert np.abs(got - before).max() > 0.05


def test_media_are_the_references(device: Device) -> None:
    scene = Scene([FIRST, MEDIA["turned"]], background="navy", linear_light=True)
    got = clvol.render(scene, camera("perspective"), size=SIZE, step=0.7, rays=1, termination=0, device=device)
    want = render_media(scene, camera("perspective"), SIZE, 0.7)["rgba"]
    np.testing.assert_allclose(got, want, atol=4e-4)  # what lies between nodes of a transfer function, as it is shown


def test_bricks_and_more_rays_at_edges_mix_light_too(device: Device) -> None:
    """Surfaces by bricks are those in memory, and what has the colour of the background is not seen."""
    volume, look = block(), {"size": SIZE, "device": device, "linear_light": True, "filter": "bspline3", "mode": "surfaces"}
    lazy = clvol.LazyVolume(volume.data, spacing=volume.spacing, origin=volume.origin)
    want, got = (clvol.render(one, CAMERA, surfaces=SHELLS, rays=2, **look) for one in (volume, lazy))
    np.testing.assert_array_equal(got, want)
    teal = np.float32((0, 128 / 255, 128 / 255))
    picture = clvol.render(volume, CAMERA, surfaces=[(0.5, "teal", 0.5)], shading=False, background="teal", **look)
    np.testing.assert_allclose(picture[..., :3], np.broadcast_to(teal, picture[..., :3].shape), atol=2e-6)


def test_the_background_and_unlit_colours_are_as_they_were(device: Device) -> None:
    """Single values have exactly their colours, an option that would change nothing is refused, and a scene's is not."""
    volume, look = block(), {"size": (12, 9), "device": device, "background": (0.2, 0.4, 0.61)}
    scene = Scene(volume, linear_light=True)
    for mode, own in (("mip", {}), ("mean", {}), ("isosurface", {"shading": False})):
        np.testing.assert_array_equal(clvol.render(scene, mode=mode, **look, **own), clvol.render(volume, mode=mode, **look, **own))
        with pytest.raises(OptionError, match=f"linear_light changes nothing in {mode}: colours are those of single values"):
            clvol.render(volume, mode=mode, **look, **own, linear_light=False)
    corner = clvol.render(scene, **look)[0, 0, :3]
    np.testing.assert_array_equal(corner, np.float32(look["background"]))
    with pytest.raises(OptionError, match="linear_light must be True or False"):
        Scene(volume, linear_light="yes")  # type: ignore[arg-type]


def test_white_is_as_bright_without_light_and_in_full_light(device: Device) -> None:
    """Ambient alone and all light of a material are shown as they were; what lies between is brighter."""
    ball = clvol.phantoms.sphere(24)
    options: dict[str, Any] = {"mode": "isosurface", "isovalue": 0.5, "color": "white", "size": (33, 33), "rays": 1}
    options |= {"camera": clvol.Camera.orbit(0, 0, projection="orthographic", fit="volume"), "device": device}
    for lights, material in ((clvol.Light(), clvol.Material(0.3, 0.7, 0)), (clvol.Light((0, 1, 0)), clvol.Material(0.4, 0.6, 0))):
        plain, linear = (
            clvol.render(ball, lights=lights, material=material, linear_light=on, **options)[..., :3] for on in (False, True)
        )
        np.testing.assert_allclose(linear[16, 16], plain[16, 16], atol=2e-3)
        assert (linear >= plain - 1e-5).all()
