"""Surfaces that are coloured by their curvature: against closed forms, the reference, and the curvatures of points."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Renderer, Volume
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.reference.march import march as reference
from clvol.spline.curvature import principal_curvatures
from tests.march.agreement import block
from tests.march.looks import TILES

KINDS = ("k1", "k2", "mean curvature", "gaussian curvature")


def grid(*shape: int, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[Any, dict[str, Any]]:
    """World coordinates around the middle, and where they lie."""
    axes = [h * (np.arange(n) - (n - 1) / 2) for n, h in zip(shape, spacing[::-1], strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return (x, y, z), {"spacing": spacing, "origin": tuple(float(axis[0]) for axis in axes[::-1])}


def shown(volume: Volume, kind: str, device: Device, most: float, **options: Any) -> tuple[Any, Any]:
    """The curvatures that a picture of them shows, from -most to most, and where."""
    camera = Camera.orbit(25, 50, fit="volume")
    gray = clvol.TransferFunction(((-most, "black"), (most, "white")))
    look: dict[str, Any] = {"shading": False, "transfer": gray, "background": None, "rays": 1, "device": device}
    look |= {"filter": "bspline3", "outputs": ("rgba", "position")}
    pictures: Any = clvol.render(volume, camera, "isosurface", (64, 56), color_by=kind, **look, **options)
    hit = pictures["rgba"][..., 3] > 0
    assert hit.sum() > 100
    return most * (2 * pictures["rgba"][hit][:, 0].astype(float) - 1), pictures["position"][hit]


def kinds(first: Any, second: Any) -> dict[str, Any]:
    high, low = np.maximum(first, second), np.minimum(first, second)
    return {"k1": high, "k2": low, "mean curvature": (high + low) / 2, "gaussian curvature": high * low}


@pytest.mark.parametrize("kind", KINDS)
def test_a_sphere(device: Device, kind: str) -> None:
    """On unequal spacings; a quadratic function is its own spline, but near the faces."""
    (x, y, z), place = grid(36, 50, 56, spacing=(0.9, 1.0, 1.5))
    got, _ = shown(Volume(-(x**2 + y**2 + z**2), **place), kind, device, 0.2, isovalue=-(12.0**2))
    np.testing.assert_allclose(got, 1 / 12 if kind != "gaussian curvature" else 1 / 144, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_torus(device: Device, kind: str) -> None:
    (x, y, z), place = grid(48, 96, 96)
    ring, tube = 28.0, 12.0
    across = np.hypot(x, y) - ring
    volume = Volume(-np.where(across > -26, across**2 + z**2, 26**2 + z**2), **place)
    got, at = shown(volume, kind, device, 0.12, isovalue=-(tube**2))
    out = np.hypot(at[:, 0], at[:, 1])
    want = kinds(np.full(len(at), 1 / tube), (out - ring) / (tube * out))[kind]
    assert want.min() < 0.0 or kind in ("k1", "mean curvature")
    np.testing.assert_allclose(got, want, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_saddle(device: Device, kind: str) -> None:
    """z = (x² - y²) / 2R: a function of degree 2."""
    (x, y, z), place = grid(40, 48, 48)
    bend = 20.0
    volume = Volume((x**2 - y**2) / (2 * bend) - z, **place)
    box = ((-12.0, -12.0, -9.0), (12.0, 12.0, 9.0))
    got, at = shown(volume, kind, device, 0.1, isovalue=0.0, clip=box)
    x, y, _ = at.T
    slope = np.stack([x / bend, -y / bend, -np.ones(len(at))], 1)
    hessian = np.broadcast_to(np.diag([1 / bend, -1 / bend, 0.0]), (len(at), 3, 3))
    want = kinds(*principal_curvatures(slope, hessian).T)[kind]
    np.testing.assert_allclose(got, want, atol=1e-4)


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("filter", "tile"), [("bspline3", "planes"), ("bspline5", "rays"), ("bspline2", "eights"), ("mitchell", "rays")]
)
def test_pictures_are_the_references(device: Device, filter: str, tile: str) -> None:
    """Lit, of both modes, on an oblique grid; beside a cap of one colour."""
    volume, camera = block(oblique=True), Camera.orbit(33, 21, fit="volume")
    looks: tuple[tuple[str, dict[str, Any]], ...] = (
        ("isosurface", {"isovalue": 0.5}),
        ("surfaces", {"surfaces": "0.3:tan:0.4,0.6:red"}),
    )
    for (mode, own), kind in itertools.product(looks, ("k1", "gaussian curvature")):
        options: dict[str, Any] = {
            **own,
            "color_by": kind,
            "rays": 1,
            "clip": clvol.Plane((1, 0.3, 0.2), volume.center),
            "cap": "lime",
        }
        with device.limited(tile=TILES[tile]), Renderer(volume, filter, device=device) as renderer:
            got = renderer.render(camera, mode, (24, 20), **options)
        want: Any = reference.render(volume, camera, mode, filter, "mirror", (24, 20), **options)
        apart = np.abs(got - want).max(-1)
        # the colour map has 255 steps, and curvatures are steep where gradients are small
        assert (apart > 0.01).sum() <= 3, np.sort(apart.ravel())[-8:]


def test_by_bricks_lit_and_outlined_they_are_the_same(device: Device) -> None:
    data = np.asarray(clvol.phantoms.marschner_lobb(24).data)
    look: dict[str, Any] = {"mode": "surfaces", "surfaces": "0.4:tan:0.5,0.6:red", "size": (60, 50), "outline": 1.5}
    look |= {"color_by": "mean curvature"}
    with (
        Renderer(Volume(data), "mitchell", device=device) as whole,
        clvol.BrickedField(Volume(data), "mitchell", device=device, edge=16) as field,
        Renderer(field) as bricked,
    ):
        np.testing.assert_array_equal(bricked.render(**look), whole.render(**look))


OUTLINED: dict[str, tuple[str, Any, dict[str, Any]]] = {
    "isosurface": ("planes", "perspective", {"isovalue": 0.5}),
    "surfaces": ("rays", "orthographic", {"surfaces": "0.3:tan:0.4,0.6:red"}),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", OUTLINED)
def test_outlines_are_the_references(device: Device, mode: str) -> None:
    tile, projection, own = OUTLINED[mode]
    volume, camera = block(oblique=True), Camera.orbit(33, 21, fit="volume", projection=projection)
    with device.limited(tile=TILES[tile]), Renderer(volume, "bspline3", device=device) as renderer:
        got = renderer.render(camera, mode, (40, 30), outline=2.0, rays=1, **own)
    want: Any = reference.render(volume, camera, mode, "bspline3", "mirror", (40, 30), outline=2.0, **own)
    plain: Any = reference.render(volume, camera, mode, "bspline3", "mirror", (40, 30), **own)
    assert np.abs(got - want).max() < 2e-3
    assert (np.abs(want - plain).max(-1) > 0.1).sum() > 20


@pytest.mark.parametrize(("radius", "thickness"), [(6.0, 4.0), (14.0, 1.5), (14.0, 4.0)])
def test_outlines_are_as_thick_everywhere(device: Device, radius: float, thickness: float) -> None:
    """The ring of a ball, whatever its size, on unequal spacings."""
    (x, y, z), place = grid(30, 42, 44, spacing=(0.9, 1.0, 1.4))
    ball = Volume(-(x**2 + y**2 + z**2), **place)
    camera = Camera.orbit(20, 30, projection="orthographic", target=(0, 0, 0), radius=16)
    look: dict[str, Any] = {"isovalue": -(radius**2), "shading": False, "color": "white", "rays": 1, "device": device}
    picture = clvol.render(ball, camera, "isosurface", (300, 300), filter="bspline3", outline=thickness, background="white", **look)
    dark = float((1 - picture[..., 0]).sum())  # in pixels
    rim = 300 / 32 * radius
    assert dark / (2 * np.pi * (rim - thickness / 2)) == pytest.approx(thickness, abs=0.06)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "a name": ({"color_by": "curvature"}, "color_by must be one of k1, k2, mean curvature, gaussian curvature"),
    "the colour it has not": ({"color_by": "k1", "color": "red"}, "color changes nothing in isosurface: color_by chooses"),
    "two transfer functions": ({"color_by": "k1", "cap": True}, "give the cap a color"),
    "a filter with kinks": ({"color_by": "k1", "filter": "linear"}, "takes a filter with continuous slopes"),
    "an outline of a filter with kinks": ({"outline": 2, "filter": "linear"}, "outline takes a filter with continuous slopes"),
    "no thickness": ({"outline": -1}, "outline must be"),
    "a preset": ({"color_by": "k1", "preset": "ct-bone"}, "preset changes nothing"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_makes_no_sense(case: str, device: Device) -> None:
    options, words = WRONG[case]
    with pytest.raises(OptionError, match=words):
        clvol.render(clvol.phantoms.marschner_lobb(8), mode="isosurface", size=(8, 8), device=device, **options)
