"""Shadows by rays from surfaces to the lights: the reference's, those of closed forms, and no light lost on what is not hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Corner, Light, Material, Medium, Plane, Scene, Volume
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.reference.march import march as reference
from tests.march.agreement import block

LIGHTS = [Light((0.5, -0.4, 0.7)), Light((-0.8, 0.1, 0.3), (0.5, 0.3, 0.2))]
SHELLS = [(0.35, "bisque", 0.3), (0.5, "tomato", 0.4), (0.65, "white", 0.8)]
MODES: dict[str, dict[str, Any]] = {"isosurface": {"isovalue": 0.5, "cap": True}, "surfaces": {"surfaces": SHELLS, "cap": True}}


def cuts(volume: Volume) -> list[Any]:
    """A plane, and a corner that rays leave and enter again."""
    x, y, z = (float(v) for v in volume.center)
    return [Plane((1, 0.3, 0), (x + 2, y, z)), Corner((x - 1.5, y - 9, z - 1.0), (x + 0.5, y + 9, z + 9))]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", MODES)
def test_it_is_the_references(device: Device, mode: str) -> None:
    """Of translucent and opaque surfaces, cut open, in an oblique frame; but for pixels on the edges of shadows."""
    volume = block(oblique=True)
    how: dict[str, Any] = {"mode": mode, "size": (40, 30), "rays": 1, "lights": LIGHTS, "clip": cuts(volume), **MODES[mode]}
    got = clvol.render(volume, filter="bspline3", shadow=0.8, shadow_rays=True, device=device, **how)
    want = reference.render(volume, filter="bspline3", shadow=0.8, **how)
    plain = reference.render(volume, filter="bspline3", **how)
    assert (np.abs(plain - want).max(-1) > 0.02).mean() > 0.05
    apart = np.abs(got - want).max(-1)
    assert (apart > 2e-3).mean() < 0.01
    assert np.median(apart) < 1e-5


def test_shadows_of_no_darkness_change_no_bit(device: Device) -> None:
    """Rays that stop for light at each surface, and go on, meet the same surfaces as those that do not."""
    volume = block(oblique=True)
    how: dict[str, Any] = {"mode": "surfaces", "size": (40, 30), "lights": LIGHTS, "clip": cuts(volume), **MODES["surfaces"]}
    outputs = ["rgba", "depth", "normal"]
    with clvol.Renderer(volume, "bspline3", device=device) as renderer:
        plain = renderer.render(outputs=outputs, **how)
        dark = renderer.render(outputs=outputs, shadow=1e-30, shadow_rays=True, **how)
    for name in outputs:
        np.testing.assert_array_equal(dark[name], plain[name])


def test_a_ball_over_a_floor_has_the_shadow_of_a_cylinder(device: Device) -> None:
    """Both are quadratic, so splines are exact: what is lit is 1 and what is hidden 0, to the edge; the same to the bit again."""
    z, y, x = np.indices((48, 40, 40)).astype(np.float64)
    middle, radius, way = np.array([18.0, 20.0, 33.0]), 7.0, np.array([0.3, 0.2, 0.933])
    away = radius**2 - ((np.stack([x, y, z], -1) - middle) ** 2).sum(-1)
    volume = Volume(np.where(z < 19, 30 * (8 - z), away).astype(np.float32))
    sun, chalk = Light((0.3, 0.2, 0.933)), Material(0, 1, 0)
    how: dict[str, Any] = {"mode": "isosurface", "isovalue": 0.0, "color": "white", "lights": sun, "material": chalk, "rays": 1}
    with clvol.Renderer(volume, "bspline3", device=device) as renderer:
        camera, outputs = Camera.orbit(25, 35), ["rgba", "position", "normal"]
        found = renderer.render(camera, size=(160, 120), shadow=1, shadow_rays=True, outputs=outputs, **how)
        again = renderer.render(camera, size=(160, 120), shadow=1, shadow_rays=True, **how)
    np.testing.assert_array_equal(again, found["rgba"])
    way = way / np.linalg.norm(way)
    seen = np.isfinite(found["position"]).all(-1)
    at, lit, cosine = found["position"][seen], found["rgba"][seen][:, 0], found["normal"][seen] @ way
    on_floor = np.abs(at[:, 2] - 8) < 0.01
    from_axis = np.linalg.norm(np.cross(at - middle, way), axis=-1)
    near_edge = on_floor & (np.abs(from_axis - radius) < 0.01)
    hidden = on_floor & (from_axis < radius)
    assert hidden.sum() > 300
    assert (~on_floor & (cosine > 0)).sum() > 500
    want = np.where(hidden, 0, np.clip(cosine, 0, 1))[~near_edge]
    np.testing.assert_allclose(lit[~near_edge], want, atol=1e-5)


def test_it_is_refused_where_it_changes_nothing_or_is_not_there() -> None:
    volume = block()
    exact: dict[str, Any] = {"shadow": 1, "shadow_rays": True, "size": (8, 8)}
    with pytest.raises(OptionError, match="shadow_rays changes nothing in composite: rays are of exact surfaces"):
        clvol.render(volume, **exact)
    with pytest.raises(OptionError, match="shadow_rays changes nothing in isosurface: rays are of exact surfaces"):
        clvol.render(volume, mode="isosurface", method="stepped", **exact)
    with pytest.raises(OptionError, match="shadow_rays changes nothing without shadow"):
        clvol.render(volume, mode="isosurface", shadow_rays=True, size=(8, 8))
    with pytest.raises(OptionError, match="shadow_rays must be left out in a scene of several media"):
        clvol.render(Scene([Medium(volume), Medium(block())]), mode="isosurface", **exact)
    with pytest.raises(OptionError, match="shadow_rays must be left out for a volume that is read by bricks"):
        clvol.render(clvol.LazyVolume(volume.data), mode="isosurface", **exact)


def test_they_go_with_the_shadows_of_a_scene(device: Device) -> None:
    """A picture that leaves out a scene's shadows is that of a scene without any."""
    how: dict[str, Any] = {"mode": "isosurface", "size": (8, 8), "device": device}
    scene = Scene([Medium(block())], shadow=0.5, shadow_rays=True)
    assert np.array_equal(clvol.render(scene, shadow=0, **how), clvol.render(block(), **how))
