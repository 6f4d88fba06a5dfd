"""Whole pictures by the kernels against `clvol.reference.march`, on every device found.

Each distinct kernel costs up to a second to build, so every filter meets every mode by the path that a device
takes of itself, the other paths meet every mode with the default filter and every filter with some mode, and
what needs no kernel of its own (cameras, steps, boxes, lights) is tried on every mode with one filter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clvol import phantoms
from clvol.base.errors import DeviceError
from clvol.device import Device, Tile
from clvol.filter.table import filters
from clvol.march.planes import Planes
from clvol.march.renderer import OUTPUTS, Renderer
from clvol.reference.march import march as reference
from clvol.scene.camera import Camera
from clvol.scene.joint import TransferFunction2D
from clvol.scene.light import Light, Material
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume
from tests import cases
from tests.cases import RULES
from tests.march.agreement import CAMERA, OPTIONS, SIZE, STEP, TRANSFER, Allowance, allowance, block, both, compare
from tests.march.looks import TILES, suited


@lru_cache
def lobes() -> Volume:
    """A larger volume with large smooth shapes, 16³."""
    z, y, x = np.meshgrid(*[np.linspace(-1, 1, 16)] * 3, indexing="ij")
    data = 0.5 + 0.5 * np.sin(3 * x + 1) * np.cos(2.5 * y - 0.4) * np.cos(2 * z * x + 0.3)
    return Volume(data.astype(np.float32), (0.5, 0.5, 0.5))


@lru_cache
def slope() -> Volume:
    """Rising along every ray, so that a surface is crossed once however far apart the samples are."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in (9, 7, 11)), indexing="ij")
    return Volume((0.5 + 0.2 * x - 0.1 * y + 0.1 * z + 0.08 * x**3 - 0.03 * z * y).astype(np.float32), (1.0, 0.8, 1.3))


@pytest.fixture(scope="module")
def keep() -> Iterator[dict[Any, Renderer]]:
    """Renderers by their arguments."""
    kept: dict[Any, Renderer] = {}
    yield kept
    for renderer in kept.values():
        renderer.close()


def held(keep: dict[Any, Renderer], device: Device, volume: Volume, filter: str, boundary: str = "mirror") -> Renderer:
    key = (id(device), id(volume), filter, boundary)
    if key not in keep:
        keep[key] = Renderer(volume, filter, boundary, device)
    return keep[key]


def clear_of_knots(volume: Volume, camera: Camera, step: float) -> bool:
    """Whether no plane of samples lies where a filter or its slope jumps; there rounding would decide."""
    planes = Planes(volume, camera.view(volume, SIZE[0] / SIZE[1]), SIZE[0] / SIZE[1], step)
    places = -0.5 + (np.arange(planes.count) + 0.5) * planes.spacing
    return bool(np.abs(2 * places - np.round(2 * places)).min() > 1e-3)


def test_no_plane_of_labels_lies_on_the_faces_of_voxels() -> None:
    for n, elevation in product((1, 6, 7, 24, 96, 100), (5, 20, 37, 70)):
        volume = Volume(np.zeros((n, n, n), np.uint8), labels=True)
        planes = Planes(volume, Camera.orbit(10, elevation).view(volume), 1.0, 0.5)
        block = planes.block()
        places = block["first"] + np.arange(planes.count) * planes.spacing
        assert np.abs(places % 1 - 0.5).min() > 0.49 / planes.count, (n, elevation)
        assert places[-1] == pytest.approx(block["last"]), (n, elevation)
        assert -0.5 < places[0] < places[-1] < n - 0.5 or n == 1, (n, elevation)


def check(
    renderer: Renderer,
    camera: Camera,
    mode: str,
    allowed: Allowance | None = None,
    size: tuple[int, int] = SIZE,
    step: float = STEP,
    *,
    ways: dict[str, Any] | None = None,
    **options: Any,
) -> dict[str, NDArray[Any]]:
    """Render both ways and compare; `ways` are limits of the device."""
    got, want = both(renderer, camera, mode, size, step, ways, **options)
    for name in want:
        assert got[name].shape == want[name].shape
        assert got[name].dtype == (np.float64 if name == "position" else np.float32)
    compare(got, want, allowed or Allowance())
    return got


# -- every filter in every mode ------------------------------------------------------------------------------------


# "attenuated" ranks samples as "mip" does, in the same kernel file: it meets each filter's values where mip does
@pytest.mark.one_in(100)
@pytest.mark.parametrize(
    ("mode", "filter"), [*product([mode for mode in cases.MODES if mode != "attenuated"], [*filters(), "bspline3(0.1)"])]
)
def test_every_filter_in_every_mode(device: Device, keep: dict[Any, Renderer], mode: str, filter: str) -> None:
    assert clear_of_knots(block(), CAMERA, STEP)
    check(held(keep, device, block(), filter), CAMERA, mode, allowance(filter, mode, device))


WAYS = [
    {"evaluator": "taps", "fetch": "buffer"},
    {"evaluator": "eight-fetch", "fetch": "buffer"},
    {"evaluator": "eight-fetch", "fetch": "image"},
    {"evaluator": "taps", "fetch": "image"},
]
PAIRWISE = [("bspline3", mode, way) for mode in cases.MODES for way in range(1, len(WAYS))] + [
    (name, cases.MODES[i % len(cases.MODES)], 1 + i % 3 if row.pairable(0) else 3)  # each with one of the ways in turn
    for i, (name, row) in enumerate(filters().items())
    if name != "bspline3"
]


@pytest.mark.one_in(60)
@pytest.mark.parametrize(("filter", "mode", "way"), PAIRWISE, ids=[f"{f}-{m}-{'-'.join(WAYS[w].values())}" for f, m, w in PAIRWISE])
def test_every_path_to_the_coefficients(device: Device, keep: dict[Any, Renderer], filter: str, mode: str, way: int) -> None:
    ways = WAYS[way]
    if ways["fetch"] == "image" and not device.has_images:
        with pytest.raises(DeviceError, match="images"), device.limited(**ways):
            held(keep, device, block(), filter).render(CAMERA, mode, SIZE)
        return
    check(held(keep, device, block(), filter), CAMERA, mode, allowance(filter, mode, device, ways), ways=ways)


# -- cameras, volumes, steps, boxes: one filter, every mode ----------------------------------------------------------


def towards(x: float, y: float, z: float, **more: Any) -> Camera:
    """A view nearly along an axis, tilted so that no ray runs along a face of a cell."""
    return Camera(direction=(x + 0.11, y - 0.07, z + 0.05), up=(0.13, 0.29, 0.94) if abs(z) < 1 else (0.2, 0.9, 0.1), **more)


AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
VIEWS: dict[str, tuple[Volume, Camera, float, dict[str, Any]]] = {}
for _name, _axis in AXES.items():
    VIEWS[f"perspective {_name}"] = (block(), towards(*_axis), STEP, {})
    VIEWS[f"orthographic {_name}"] = (block(), towards(*_axis, projection="orthographic"), STEP, {})
_CENTER = tuple(block().center)
_INSIDE = Camera.look_at(_CENTER + np.array([0.7, -0.4, 0.3]), _CENTER + np.array([3.0, 2.0, 1.1]), fov=70)
_BOX = ((4.63, -2.71, 3.13), (11.37, 0.43, 9.57))
_FAR = (3e4, -2e4, 1e4)
VIEWS |= {
    "wide": (block(), Camera.look_at((5.3, -6.1, 5.2), fov=120), STEP, {}),
    "wide, close": (block(), Camera.look_at((8.4, -3.6, 6.1), (10.4, 0.3, 8.4), fov=120), STEP, {}),
    "inside": (block(), _INSIDE, STEP, {}),
    "inside, behind too": (block(), replace(_INSIDE, fov=150), STEP, {}),
    "orthographic eye inside": (block(), replace(_INSIDE, projection="orthographic"), STEP, {}),
    "diagonal": (block(), Camera(direction=(1.02, 0.97, -0.93), fit="volume"), STEP, {}),
    "skew axes": (block(oblique=True), CAMERA, STEP, {}),
    "skew axes, wide": (block(oblique=True), replace(CAMERA, fov=110), STEP, {}),
    "far origin": (block(oblique=True, origin=_FAR), CAMERA, STEP, {}),
    "far origin, orthographic": (block(oblique=True, origin=_FAR), replace(CAMERA, projection="orthographic"), STEP, {}),
    "box": (block(), CAMERA, STEP, {"clip": _BOX}),
    "box, skew axes": (block(oblique=True), CAMERA, STEP, {"clip": _BOX}),
    "half space": (block(), CAMERA, STEP, {"clip": ((-np.inf, -np.inf, 5.1), (np.inf, np.inf, np.inf))}),
    "zoomed": (block(), CAMERA.zoomed(3.1), STEP, {}),
    "fine": (block(), CAMERA, 0.25, {}),
    "coarse": (block(), CAMERA, 2.0, {}),
    "one plane": (slope(), Camera(direction=(1, -0.4, 0.3), fit="volume"), 1000.0, {}),
    "one plane, wide": (slope(), Camera(direction=(1, -0.4, 0.3), fov=120, fit="volume"), 1000.0, {}),
    "larger": (lobes(), CAMERA, 0.5, {}),
    "three rays a pixel": (block(), CAMERA, STEP, {"rays": 3}),
    "background": (block(), CAMERA, STEP, {"background": (0.2, 0.5, 0.9)}),
    "one row": (block(), CAMERA, STEP, {"size": (31, 1)}),
    "one column": (block(), CAMERA, STEP, {"size": (1, 17)}),
}


@pytest.mark.one_in(12)
@pytest.mark.parametrize("mode", cases.MODES)
@pytest.mark.parametrize("view", VIEWS)
def test_every_view(device: Device, keep: dict[Any, Renderer], view: str, mode: str) -> None:
    volume, camera, step, options = VIEWS[view]
    allowed = allowance("bspline3", mode, device)
    away = float(np.abs(volume.origin).max())
    allowed = replace(allowed, position=allowed.position + away * 1.2e-7)  # what float32 holds of a position
    if options.get("rays") or view == "larger":  # its crests are grazed, where rounding turns the normal
        allowed = replace(allowed, pixels=2 * allowed.pixels)
    check(
        held(keep, device, volume, "bspline3"),
        camera,
        mode,
        allowed,
        options.get("size", SIZE),
        step,
        **{k: v for k, v in options.items() if k != "size"},
    )


@pytest.mark.one_in(8)
@pytest.mark.parametrize("mode", ["composite", "isosurface"])
@pytest.mark.parametrize("boundary", RULES)
def test_every_boundary(device: Device, keep: dict[Any, Renderer], boundary: str, mode: str) -> None:
    for name in ("nearest", "bspline3"):
        check(held(keep, device, block(), name, boundary), CAMERA, mode, allowance(name, mode, device))


@pytest.mark.one_in(6)
@pytest.mark.parametrize("mode", ["composite", "isosurface"])
@pytest.mark.parametrize("filter", ["linear", "bspline3", "hybrid"])
def test_central_differences(device: Device, keep: dict[Any, Renderer], filter: str, mode: str) -> None:
    check(held(keep, device, block(oblique=True), filter), CAMERA, mode, allowance("bspline3", mode, device), gradient="central")


@pytest.mark.one_in(6)
@pytest.mark.parametrize("filter", ["nearest", "linear", "mitchell", "bspline3", "hybrid", "sinc"])
def test_stepped_surfaces(device: Device, keep: dict[Any, Renderer], filter: str) -> None:
    """Within rounding, not 10⁻⁴ of the difference between two samples."""
    allowed = allowance(filter, "isosurface", device)
    check(held(keep, device, block(), filter), CAMERA, "isosurface", allowed, method="stepped", tolerance=0.0)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", ["composite", "isosurface"])
def test_without_shading(device: Device, keep: dict[Any, Renderer], mode: str) -> None:
    check(held(keep, device, block(), "bspline3"), CAMERA, mode, allowance("bspline3", mode, device), shading=False)


GRADED = {
    "factors": replace(TRANSFER, gradient_opacity=((0.02, 0.1), (0.3, 1.0)), curvature_opacity=((0.1, 1.0), (0.9, 0.2))),
    "shapes": TransferFunction2D(
        boxes=(((0.2, 0.5), (0.05, math.inf), (1.0, 0.0, 0.0), 0.4),),
        arches=(((0.3, 1.0), 0.4, (0.0, 0.5, 0.5), 0.8),),
        gradient_opacity=((0.0, 0.5), (0.4, 1.0)),
    ),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("graded", GRADED)
def test_opacity_by_more_than_the_value(device: Device, keep: dict[Any, Renderer], graded: str) -> None:
    allowed = replace(allowance("bspline3", "composite", device), rgba=5e-4, rms=3e-5)  # nodes are steep
    renderer = held(keep, device, block(oblique=graded == "shapes"), "bspline3")
    check(renderer, CAMERA, "composite", allowed, transfer=GRADED[graded])


LIGHTS = {
    "none": (),
    "from the right": (Light((1, -0.3, 0.4)),),
    "from behind": (Light((0.5, 1, 0)),),
    "four colours": (
        Light(None, (0.3, 0.3, 0.3)),
        Light((1, -1, 0.5), (0.9, 0.1, 0.1)),
        Light((-1, -1, 1), (0.1, 0.8, 0.1)),
        Light((0, -1, -2), (0.1, 0.2, 0.9)),
    ),
}


@pytest.mark.parametrize("mode", ["composite", "isosurface"])
@pytest.mark.parametrize("lights", LIGHTS)
def test_lights(device: Device, keep: dict[Any, Renderer], lights: str, mode: str) -> None:
    material = Material(ambient=0.1, diffuse=0.6, specular=0.4, shininess=12)
    check(
        held(keep, device, block(), "bspline3"),
        CAMERA,
        mode,
        allowance("bspline3", mode, device),
        lights=LIGHTS[lights],
        material=material,
        color=(0.3, 0.7, 0.5),
    )


@pytest.mark.parametrize("value", [0.0, 0.3, -1234.5])
def test_lit_matter_without_a_gradient(device: Device, value: float) -> None:
    """Full diffuse light, no highlight, no normal."""
    with Renderer(Volume(np.full((6, 5, 7), value, np.float32)), device=device) as renderer:
        transfer = TransferFunction(((value, "red"),), ((value, 0.3),))
        got = check(renderer, CAMERA, "composite", step=0.4, lights=LIGHTS["four colours"], transfer=transfer)
    assert np.isnan(got["normal"]).all()
    assert np.isfinite(got["depth"]).any()


def test_opaque_matter(device: Device, keep: dict[Any, Renderer]) -> None:
    """Opacity 1 stays 1 at any step."""
    solid = TRANSFER.with_opacity(((0.0, 0.0), (0.5, 0.0), (0.5 + 64 / 1024, 1.0), (1.0, 1.0)))
    renderer = held(keep, device, block(), "bspline3")
    for step in (0.25, STEP, 1.0):
        check(renderer, CAMERA, "composite", Allowance(rgba=2e-4, rms=2e-5), step=step, transfer=solid)


def test_opacities_per_world_length(device: Device, keep: dict[Any, Renderer]) -> None:
    check(held(keep, device, block(), "bspline3"), CAMERA, "composite", transfer=replace(TRANSFER, unit_distance=2.7))


@pytest.mark.parametrize("mode", cases.MODES)
def test_the_default_look_matches_the_reference(device: Device, mode: str) -> None:
    """No options: each chooses transfer function, isovalue, colour, lights and background."""
    with Renderer(block(), device=device) as renderer:
        got = renderer.render(CAMERA, mode, SIZE, STEP, outputs=OUTPUTS[:-1], rays=1)
    want = reference.render(block(), CAMERA, mode, size=SIZE, step=STEP, outputs=OUTPUTS[:-1])
    assert isinstance(want, dict)
    # light that early termination leaves out
    difference = np.abs(got["rgba"] - want["rgba"]).max(-1)
    assert np.sqrt((difference**2).mean()) < 3e-3
    assert np.quantile(difference, 0.99) < 5e-3
    assert want["rgba"][..., :3].max() > 0.3


# -- what the picture may not depend on ------------------------------------------------------------------------------


@pytest.mark.one_in(14)
@pytest.mark.parametrize("mode", cases.MODES)
def test_tiles_of_rays_render_the_same(device: Device, keep: dict[Any, Renderer], mode: str) -> None:
    """One ray per work-item, eight at once, and tiles that share planes."""
    renderer = held(keep, device, block(), "bspline3")
    views = [
        Camera.orbit(azimuth, elevation, fit="volume") for azimuth, elevation in ((100, 10), (20, -75), (200, 5))
    ]  # each axis, backwards
    for camera in (CAMERA, replace(CAMERA, fov=120), *views):
        for size in (SIZE, (21, 7)):  # a width that eight does not divide
            options = suited(mode, OPTIONS)
            with device.limited(tile=TILES["rays"]):
                one = renderer.render(camera, mode, size, STEP, **options)
            for tile in (Tile(8, 1, 8, shared=False), TILES["eights"], TILES["planes"]):
                with device.limited(tile=tile):
                    many = renderer.render(camera, mode, size, STEP, **options)
                compare(many, one, replace(allowance("bspline3", mode, device), pixels=0.005))


@pytest.mark.parametrize("termination", [1e-3, 0.03, 0.3])
def test_early_termination_is_exact_within_its_threshold(device: Device, keep: dict[Any, Renderer], termination: float) -> None:
    renderer = held(keep, device, block(), "bspline3")
    dense = TRANSFER.with_opacity(((0.0, 0.5), (1.0, 0.9)))
    check(renderer, CAMERA, "composite", transfer=dense, termination=termination)
    options = {**OPTIONS, "transfer": dense, "background": "black", "outputs": "rgba", "shading": False}
    options = suited("composite", options)
    whole = renderer.render(CAMERA, "composite", SIZE, STEP, **options)
    short = renderer.render(CAMERA, "composite", SIZE, STEP, **{**options, "termination": termination})
    difference = np.abs(whole - short).max()
    assert difference <= termination + 1e-6
    assert difference > 0 or termination < 0.01  # rays do end early


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", ["composite", "isosurface"])
def test_touching_labels_have_no_seam(mode: str, device: Device) -> None:
    """Labels are shaded by the surface of the solid, whatever their numbers."""
    one = np.zeros((12, 12, 12), np.uint8)
    one[3:9, 3:9, 3:9] = 1
    several = one.copy()
    several[3:9, 3:9, 6:9], several[3:9, 6:9, 3:9] = 200, 7
    pictures = [
        Renderer(Volume(labels, labels=True), "nearest", device=device).render(mode=mode, size=(32, 32), outputs="normal")
        for labels in (one, several)
    ]
    assert np.isfinite(pictures[0]).any()
    np.testing.assert_allclose(pictures[1], pictures[0], atol=1e-6)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("shading", [True, False])
def test_virtual_samples(keep: dict[Any, Renderer], device: Device, *, shading: bool) -> None:
    options: Any = {"transfer": TRANSFER, "virtual": 3, "shading": shading}
    renderer = held(keep, device, block(), "bspline3")
    check(renderer, CAMERA, "composite", Allowance(rgba=2e-4, rms=2e-5, depth=2e-4, position=2e-4), step=0.8, **options)
    plain = renderer.render(CAMERA, "composite", SIZE, 0.8, skipping=False, **options)
    np.testing.assert_array_equal(renderer.render(CAMERA, "composite", SIZE, 0.8, **options), plain)


def test_nothing_lies_between_two_samples_of_one_place(device: Device) -> None:
    """Where a plane is at a ray's entry: the slope between such samples is no number."""
    with Renderer(phantoms.marschner_lobb(96), device=device) as renderer:
        points, between = (renderer.render(size=(128, 128), rays=1, virtual=n) for n in (0, 1))
    assert np.abs(between - points).max() < 0.15


def test_thin_shells_are_smooth_with_virtual_samples(device: Device) -> None:
    x, y, z = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
    bands = [(v + e, o) for v in (0.3, 0.5, 0.7) for e, o in ((-0.011, 0.0), (-0.01, 0.9), (0.01, 0.9), (0.011, 0.0))]
    options: Any = {"transfer": TransferFunction(((0, (1, 1, 1)),), tuple(bands)), "shading": False, "rays": 1}
    with Renderer(Volume(np.sqrt(x**2 + y**2 + z**2)), device=device) as renderer:
        fine = renderer.render(CAMERA, size=SIZE, step=1 / 64, **options)
        points, between = (renderer.render(CAMERA, size=SIZE, virtual=n, **options) - fine for n in (0, 12))
    assert np.sqrt((between**2).mean()) < 0.25 * np.sqrt((points**2).mean())
