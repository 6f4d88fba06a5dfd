"""What any picture must satisfy: symmetries, closed forms, errors and unusual input."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import phantoms
from clvol.base.errors import ClvolError, DataError, GeometryError, OptionError
from clvol.device import Device
from clvol.march.planes import Planes
from clvol.march.renderer import OUTPUTS, Renderer, render
from clvol.reference.spline.points import sample as reference_sample
from clvol.scene.camera import Camera
from clvol.scene.light import Light
from clvol.scene.mode import modes
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import TransferFunction
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume
from tests import cases
from tests.march.looks import TILES, suited

SIZE = (24, 20)
CAMERA = Camera.orbit(33, 21, fit="volume")
DATA = Path(__file__).parents[3] / "shared" / "data"


def noise(shape: tuple[int, int, int] = (10, 9, 8), seed: int = 1) -> Volume:
    data = Volume(np.random.default_rng(seed).random(shape)).gaussian(0.8).data
    return Volume(((data - data.min()) / np.ptp(data)).astype(np.float32))


def turn(axis: tuple[float, float, float], angle: float) -> NDArray[np.float64]:
    """Rotation by Rodrigues' formula; `angle` in degrees."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(angle)
    return np.asarray(np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross)


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[Renderer]:
    with Renderer(noise(), device=device) as made:
        yield made


# -- symmetries ----------------------------------------------------------------------------------------------------


@pytest.mark.one_in(6)
@pytest.mark.parametrize("mode", cases.MODES)
def test_moving_volume_camera_and_light_together_changes_nothing(device: Device, mode: str) -> None:
    still = noise()
    camera = Camera.look_at((-9.0, -17.0, 11.0), (4.0, 3.5, 4.0), (0.1, 0.2, 1.0))
    r, shift = turn((1, 2, -0.5), 71), np.array([30.0, -20.0, 10.0])
    moved = replace(still, direction=r, origin=tuple(shift))

    def carried(p: Any) -> tuple[float, ...]:
        return tuple(r @ np.asarray(p) + shift)

    there = Camera.look_at(carried(camera.position), carried(camera.target), tuple(r @ np.asarray(camera.up)))
    light = np.array([0.3, -1.0, 0.5])
    transfer = TransferFunction.from_cmap("viridis", (0, 1), ((0.2, 0.0), (1.0, 0.6)))
    options = suited(mode, {"transfer": transfer, "isovalue": 0.5})
    lit = [{"lights": [Light(tuple(way))]} if modes()[mode].shaded else {} for way in (light, r @ light)]
    a = render(still, camera, mode, size=SIZE, device=device, **lit[0], **options)
    b = render(moved, there, mode, size=SIZE, device=device, **lit[1], **options)
    difference = np.abs(a - b).max(-1)
    assert np.sqrt((difference**2).mean()) < 1e-3  # an isosurface is drawn to 1e-4 of the range
    assert (difference > 1e-2).mean() <= 0.005
    assert a[..., :3].max() > 0.1


@pytest.mark.one_in(7)
@pytest.mark.parametrize("filter", ["linear", "catmull-rom", "bspline2", "bspline3", "bspline4", "bspline5", "omoms3"])
def test_one_polynomial_on_rotated_grids_gives_one_picture(device: Device, filter: str) -> None:
    """Each filter gets a polynomial that it reproduces on any grid, away from edges (Strang and Fix)."""
    degree = min(clvol.filters()[filter].order - 1, 3)
    rng = np.random.default_rng(5)
    weights = rng.uniform(-1, 1, (4, 4, 4))
    weights[np.add.outer(np.add.outer(range(4), range(4)), range(4)) > degree] = 0  # total degree: turning keeps it
    weights[1, 0, 0] += 2  # the surface is met once
    pictures = []
    for direction in (np.eye(3), turn((1, 1, 0.3), 37), turn((-0.2, 0.5, 1), 118)):
        corner = tuple(direction @ np.full(3, -0.05 * 19.5))
        grid = Volume(np.broadcast_to(np.float32(0), (40,) * 3), (0.05,) * 3, corner, direction)
        index = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), -1)[..., ::-1]
        points = grid.index_to_world(index)
        volume = replace(grid, data=np.polynomial.polynomial.polyval3d(*np.moveaxis(points, -1, 0), weights).astype(np.float32))
        level = float(np.polynomial.polynomial.polyval3d(0, 0, 0, weights))
        camera = Camera(direction=(1, 0.3, -0.2), target=(0, 0, 0), distance=4, fov=14)
        clip = ((-0.4,) * 3, (0.4,) * 3)  # ten samples and more from every edge, whose extension is no polynomial
        pictures.append(
            render(
                volume,
                camera,
                "isosurface",
                filter=filter,
                isovalue=level,
                size=(20, 20),
                clip=clip,
                device=device,
                outputs=OUTPUTS,
            )
        )
    first = pictures[0]
    seen = np.isfinite(first["depth"])
    assert seen.mean() > 0.3
    for other in pictures[1:]:
        both = seen & np.isfinite(other["depth"])
        assert (seen != np.isfinite(other["depth"])).mean() <= 0.01
        np.testing.assert_allclose(other["depth"][both], first["depth"][both], atol=2e-3)
        np.testing.assert_allclose(other["normal"][both], first["normal"][both], atol=5e-3)


@pytest.mark.one_in(6)
@pytest.mark.parametrize("mode", cases.MODES)
def test_tiles_are_invisible(renderer: Renderer, mode: str) -> None:
    size = (37, 29)
    for tile in (TILES["planes"], TILES["rays"]):
        calls: list[float] = []
        with renderer.device.limited(tile=tile):
            want = renderer.render(CAMERA, mode, size, outputs=OUTPUTS)
        with renderer.device.limited(tile=tile, launch_seconds=1e-9):
            cut = renderer.render(CAMERA, mode, size, outputs=OUTPUTS, progress=calls.append)
        assert len(calls) >= 3
        for name in OUTPUTS:
            np.testing.assert_array_equal(cut[name], want[name])


def test_no_row_is_added_twice_in_odd_tiles(renderer: Renderer) -> None:
    """Several rays per pixel accumulate; launches must not overlap, whatever the height of a tile."""
    with renderer.device.limited(tile=TILES["eights"]):
        want = renderer.render(CAMERA, "minip", (37, 47), rays=3)
        with renderer.device.limited(launch_seconds=1e-9):
            np.testing.assert_array_equal(renderer.render(CAMERA, "minip", (37, 47), rays=3), want)


def test_pictures_are_reproducible_to_the_last_bit(device: Device, renderer: Renderer) -> None:
    for mode in cases.MODES:
        first = renderer.render(CAMERA, mode, SIZE, rays=2)
        np.testing.assert_array_equal(renderer.render(CAMERA, mode, SIZE, rays=2), first)
        np.testing.assert_array_equal(render(noise(), CAMERA, mode, size=SIZE, rays=2, device=device), first)


# -- closed forms --------------------------------------------------------------------------------------------------


def test_a_sphere_has_its_position(device: Device) -> None:
    radius = 0.75
    volume = phantoms.sphere(64, radius)
    low, high = volume.value_range
    camera = Camera.orbit(40, 25, distance=4.0, fov=24)
    got = render(volume, camera, "isosurface", size=(64, 64), isovalue=0.5, device=device, outputs=OUTPUTS)
    hit = np.isfinite(got["depth"])
    p = got["position"][hit].astype(float)
    r = np.linalg.norm(p, axis=1)
    # the field falls by one a world unit at the sphere
    assert np.abs(r - radius).max() <= 1.2e-4 * (high - low)
    assert np.abs((got["normal"][hit] * p).sum(1) / r - 1).max() < 1e-5
    # the ray through each pixel meets the sphere at the root of |eye + t d|² = r²
    view = camera.view(volume)
    a = (np.arange(64) + 0.5) / 32 - 1
    d = view.forward + view.half_height * (a[None, :, None] * view.right - a[:, None, None] * view.up)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    b = d @ view.eye
    discriminant = b**2 - view.eye @ view.eye + radius**2
    np.testing.assert_array_equal(hit[np.abs(discriminant) > 1e-3], (discriminant > 0)[np.abs(discriminant) > 1e-3])
    steep = hit & (discriminant > 0.05)
    exact = -b[steep] - np.sqrt(discriminant[steep])
    assert np.abs(got["depth"][steep] - exact).max() < 1e-3
    np.testing.assert_allclose(p, (view.eye + got["depth"][..., None] * d)[hit], atol=1e-5)


@pytest.mark.one_in(8)
@pytest.mark.parametrize("filter", ["linear", "bspline3", "mitchell", "hybrid"])
@pytest.mark.parametrize("fov", [30.0, 120.0])
def test_surfaces_lie_within_a_ten_thousandth_of_the_isovalue(device: Device, filter: str, fov: float) -> None:
    volume = replace(noise((16, 14, 15)), spacing=(1.0, 0.7, 1.2))
    options: dict[str, Any] = {"size": (40, 40), "isovalue": 0.45, "device": device}
    got = render(volume, replace(CAMERA, fov=fov), "isosurface", filter=filter, outputs="position", **options)
    places = got[np.isfinite(got[..., 0])]
    assert len(places) > 100
    low, high = volume.value_range
    # positions are rounded to float32, which at this distance is worth a few 1e-6
    assert np.abs(reference_sample(volume, places, filter) - 0.45).max() <= 1.1e-4 * (high - low)


@pytest.mark.parametrize("step", [0.25, 0.5, 1.0, 3.0])
def test_a_constant_slab_has_the_exact_transmittance(device: Device, step: float) -> None:
    """(1 - a)^(length / unit), at any step: rays meet both faces, so the planes add up to the exact length."""
    volume = Volume(np.ones((6, 60, 60), np.float32), (1.0, 1.0, 0.8))
    fog = TransferFunction(((1.0, "white"),), ((1.0, 0.1),), unit_distance=0.7)
    for projection in ("perspective", "orthographic"):
        camera = Camera(direction=(0.2, 0.1, -1), up=(0, 1, 0), projection=projection, zoom=4, fit="volume")  # type: ignore[arg-type]
        options: dict[str, Any] = {"transfer": fog, "background": None, "termination": 0, "device": device}
        got = render(volume, camera, "composite", size=(9, 7), step=step, **options)
        view = camera.view(volume, 9 / 7)
        a, b = (np.arange(9) + 0.5) / 4.5 - 1, 1 - (np.arange(7) + 0.5) / 3.5
        plane = view.half_height * (a[None, :, None] * 9 / 7 * view.right + b[:, None, None] * view.up)
        d = view.forward + (plane if projection == "perspective" else 0 * plane)
        length = 6 * 0.8 * np.linalg.norm(d, axis=-1) / np.abs(d[..., 2])
        np.testing.assert_allclose(got[..., 3], 1 - 0.9 ** (length / 0.7), atol=2e-6)


def test_the_mean_of_a_ramp(device: Device) -> None:
    n = 12
    ramp = np.arange(n, dtype=np.float32)
    for axis, direction in ((0, (0, 0, 1)), (1, (0, 1, 0)), (2, (1, 0, 0))):
        data = np.broadcast_to(ramp.reshape([n if i == axis else 1 for i in range(3)]), (n, n, n))
        camera = Camera(
            direction=direction, up=(0, 1, 0) if axis == 0 else (0, 0, 1), projection="orthographic", zoom=3, fit="volume"
        )
        grey = TransferFunction.ramp((0, n - 1))
        got = render(data, camera, "mean", filter="linear", size=(5, 5), transfer=grey, device=device)
        # by symmetry the middle of the ramp, the mirrored half voxels at its ends included
        np.testing.assert_allclose(got[..., 0], 0.5, atol=1e-6)
    # across the view, the value of the column itself
    data = np.broadcast_to(ramp, (n, n, n))
    camera = Camera(direction=(0, 0, 1), up=(0, -1, 0), projection="orthographic", zoom=3, fit="volume")
    view = camera.view(Volume(data))
    got = render(data, camera, "mean", filter="bspline3", size=(6, 6), transfer=TransferFunction.ramp((0, n - 1)), device=device)
    x = view.eye[0] + view.half_height * view.right[0] * ((np.arange(6) + 0.5) / 3 - 1)
    np.testing.assert_allclose(got[..., 0], np.broadcast_to(x / (n - 1), (6, 6)), atol=2e-3)  # mirrored ends are no ramp


@pytest.mark.one_in(3)
@pytest.mark.parametrize("filter", ["nearest", "linear", "bspline3-approx"])
def test_projections_are_in_order(device: Device, filter: str) -> None:
    volume = noise((20, 18, 16), 4)
    with Renderer(volume, filter, device=device) as renderer:
        options: dict[str, Any] = {"outputs": ("rgba", "depth"), "transfer": TransferFunction.ramp(volume.value_range)}
        least, mean, most = (renderer.render(CAMERA, mode, (32, 32), 0.3, **options) for mode in ("minip", "mean", "mip"))
    assert (least["rgba"] <= mean["rgba"] + 1e-6).all()
    assert (mean["rgba"] <= most["rgba"] + 1e-6).all()
    assert most["rgba"].max() <= 1
    seen = np.isfinite(most["depth"])
    assert seen.any()
    np.testing.assert_array_equal(seen, np.isfinite(least["depth"]))
    assert not np.isfinite(mean["depth"]).any()


def test_the_maximum_is_found(device: Device) -> None:
    data = np.zeros((9, 9, 9), np.float32)
    data[3, 5, 2] = 1
    camera = Camera(direction=(0, 1, 0), projection="orthographic", fit="volume")
    got = render(data, camera, "mip", filter="nearest", size=(90, 90), device=device, outputs=("rgba", "position"))
    lit = got["rgba"][..., 0] > 0.5
    places = got["position"][lit]
    np.testing.assert_allclose([places[:, 0].mean(), places[:, 2].mean()], [2, 3], atol=0.1)
    assert (np.abs(places - [2, 5, 3]) <= 0.501).all()
    assert (~lit).any()


def test_a_clip_box_cuts_at_its_faces(device: Device) -> None:
    volume = Volume(np.ones((20, 20, 20), np.float32), (0.5,) * 3, (10, 20, 30))
    low, high = np.array([12.1, 22.2, 31.3]), np.array([16.4, 27.5, 38.6])
    opaque = TransferFunction(((1.0, "white"),), ((1.0, 1.0),))
    got = render(volume, CAMERA, size=(48, 48), step=0.1, transfer=opaque, clip=(low, high), device=device, outputs="position")
    places = got[np.isfinite(got[..., 0])]
    assert len(places) > 50
    assert (places >= low - 1e-4).all()
    assert (places <= high + 1e-4).all()
    faces = np.minimum(np.abs(places - low), np.abs(places - high)).min(1)
    assert faces.max() < 0.15  # the first sample behind a face


@pytest.mark.parametrize("step", [0.1, 0.5, 1.0, 7.0, 1e9])
def test_no_ray_advances_farther_than_the_step(step: float) -> None:
    volume = Volume(np.zeros((30, 40, 50), np.float32), (0.5, 1.0, 2.0))
    for camera in (CAMERA, replace(CAMERA, projection="orthographic"), replace(CAMERA, fov=60.0)):
        view = camera.view(volume, 1.5)
        planes = Planes(volume, view, 1.5, step)
        assert planes.count * planes.spacing == pytest.approx(volume.size[planes.axis])
        cosines = []
        for a in np.linspace(-1.5, 1.5, 7):
            for b in np.linspace(-1, 1, 7):
                d = view.forward + (0 if view.orthographic else view.half_height) * (a * view.right + b * view.up)
                d = volume.world_to_index_matrix @ d
                cosines.append(abs(d[planes.axis]) / np.linalg.norm(d))
        least = max(min(cosines), 0.5)  # more oblique rays use no planes
        assert planes.spacing / least <= step * (1 + 1e-6)
        assert planes.count == 1 or volume.size[planes.axis] / (planes.count - 1) / least > step  # nor more planes than that


# -- something to see without options ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in phantoms.names() if n != "polynomial"])
@pytest.mark.parametrize("mode", cases.MODES)
def test_phantoms_are_visible(device: Device, name: str, mode: str) -> None:
    got = render(phantoms.by_name(f"{name}:24"), mode=mode, size=(48, 48), device=device)
    assert got.shape == (48, 48, 4)
    assert np.isfinite(got).all()
    assert (got >= 0).all()
    assert (got <= 1).all()
    # minip of a volume whose edge is black may be black; everything else must be seen, and not everywhere the same
    if mode != "minip":
        assert (got[..., :3].max(-1) > 0.1).mean() > 0.05
        assert got[..., :3].std() > 0.02


@pytest.mark.parametrize("name", ["bonsai.nii.gz", "mr_head.nii.gz", "stroke_t1.nii.gz", "tooth.nhdr"])
def test_scans_are_visible(device: Device, name: str) -> None:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"{name} is not at hand")
    volume = clvol.read(path)
    volume = volume.downsample(max(1, max(volume.size) // 64))
    with Renderer(volume, device=device) as renderer:
        for mode in ("composite", "isosurface"):
            got = renderer.render(mode=mode, size=(64, 64))
            assert (got[..., :3].max(-1) > 0.1).mean() > 0.05
            assert got[..., :3].std() > 0.02


# -- errors ------------------------------------------------------------------------------------------------------------

WRONG: dict[str, tuple[dict[str, Any], type[ClvolError], str]] = {
    "step 0": ({"step": 0}, OptionError, "step must be a finite number, greater than 0; got 0"),
    "step negative": ({"step": -1.0}, OptionError, "step must be a finite number, greater than 0"),
    "step NaN": ({"step": float("nan")}, OptionError, "step must be a finite number, greater than 0; got nan"),
    "step text": ({"step": "fine"}, OptionError, "step must be a finite number, greater than 0; got 'fine'"),
    "step too small": ({"step": 1e-9}, OptionError, "no more than 1048576 planes"),
    "size 0": ({"size": (0, 5)}, OptionError, r"width must be a whole number, at least 1 and at most 32768; got 0"),
    "size of one number": ({"size": 64}, OptionError, r"size must be \(width, height\) in pixels; got 64"),
    "size of fractions": ({"size": (6.5, 5)}, OptionError, "width must be a whole number"),
    "size too large": ({"size": (40000, 1)}, OptionError, "32768"),
    "mode": (
        {"mode": "xray"},
        OptionError,
        "mode must be one of composite, isosurface, surfaces, regions, mip, attenuated, minip, mean, integral; got 'xray'",
    ),
    "evaluator": ({"evaluator": "taps"}, OptionError, "evaluator is no option of composite; composite has shading, termination"),
    "gradient": ({"gradient": "sobel"}, OptionError, "gradient must be one of analytic, central; got 'sobel'"),
    "outputs": (
        {"outputs": "z"},
        OptionError,
        "outputs must be one of rgba, depth, normal, position, visited, value, uncertainty, pose; got 'z'",
    ),
    "outputs, one of several": ({"outputs": ("rgba", "z")}, OptionError, "outputs must be one of .*; got 'z'"),
    "clip upside down": ({"clip": ((1, 1, 1), (0, 2, 2))}, GeometryError, "clip must be two corners"),
    "clip flat": ({"clip": ((1, 1, 1), (2, 1, 2))}, GeometryError, "each coordinate of the first less than of the second"),
    "clip NaN": ({"clip": ((1, 1, 1), (2, float("nan"), 2))}, GeometryError, "clip must be"),
    "clip of numbers": ({"clip": (1, 2)}, GeometryError, "clip must be two corners"),
    "isovalue NaN": ({"isovalue": float("nan"), "mode": "isosurface"}, OptionError, "isovalue must be a finite number; got nan"),
    "isovalue infinite": ({"isovalue": float("inf"), "mode": "isosurface"}, OptionError, "isovalue must be a finite number"),
    "five lights": ({"lights": [Light()] * 5}, OptionError, "there may be up to 4 lights; got 5"),
    "no rays": ({"rays": 0}, OptionError, "rays must be a whole number, at least 1 and at most 4096; got 0"),
    "half rays": ({"rays": 1.5}, OptionError, "rays must be a whole number"),
    "termination 1": ({"termination": 1}, OptionError, "termination must be a finite number, at least 0 and less than 1; got 1"),
    "termination NaN": ({"termination": float("nan")}, OptionError, "termination must be"),
    "background": ({"background": "nocolour"}, OptionError, "background must be three numbers, or the name"),
    "color": ({"color": (1, 2), "mode": "isosurface"}, OptionError, "color must be three numbers"),
    "eye on its target": ({"camera": Camera(position=(3.5, 4.0, 4.5))}, GeometryError, "position and target must differ"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors_name_the_rule_and_leave_the_renderer_usable(renderer: Renderer, case: str) -> None:
    options, kind, message = WRONG[case]
    before = renderer.render(CAMERA, size=(12, 12))
    with pytest.raises(kind, match=message) as raised:
        renderer.render(**{"size": (12, 12), **options})
    assert isinstance(raised.value, (ValueError, ClvolError))
    np.testing.assert_array_equal(renderer.render(CAMERA, size=(12, 12)), before)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"evaluator": "magic"}, "evaluator must be one of auto, taps, paired, eight-fetch; got 'magic'"),
        ({"fetch": "disk"}, "fetch must be one of auto, buffer, image; got 'disk'"),
    ],
    ids=["evaluator", "fetch"],
)
def test_invalid_device_limits_are_named(renderer: Renderer, limits: dict[str, Any], message: str) -> None:
    before = renderer.render(CAMERA, size=(12, 12))
    with pytest.raises(OptionError, match=message), renderer.device.limited(**limits):
        renderer.render(CAMERA, size=(12, 12))
    np.testing.assert_array_equal(renderer.render(CAMERA, size=(12, 12)), before)


def test_positional_arguments_have_one_order(device: Device) -> None:
    with Renderer(noise(), "linear", device=device) as renderer:
        expected = renderer.render(CAMERA, "mip", (14, 12), 0.7)
    np.testing.assert_array_equal(render(noise(), CAMERA, "mip", (14, 12), 0.7, filter="linear", device=device), expected)


def test_errors_in_the_scene(device: Device) -> None:
    ones = np.ones((4, 5, 6), np.float32)
    with pytest.raises(OptionError, match=r"rendering takes a volume with 3 axes; got shape \(5, 6\)"):
        Renderer(ones[0], device=device)
    with pytest.raises(DataError, match="data must have 2 axes"):
        Renderer(ones[None], device=device)
    with pytest.raises(OptionError, match=r"filter must be one of .*; got 'cubix'"):
        Renderer(ones, "cubix", device=device)
    with pytest.raises(OptionError, match=r"boundary must be one of mirror, .*, overlap; got 'clamp'"):
        Renderer(ones, boundary="clamp", device=device)
    with pytest.raises(OptionError, match="device must be one of"):
        Renderer(ones, device="abacus")
    with pytest.raises(
        OptionError, match=r"stepp is no option of composite \(did you mean step\?\); composite has shading, termination"
    ):
        render(ones, stepp=1, device=device)
    with pytest.raises(OptionError, match=r"clim is no option of mip \(did you mean window=\(center, width\), or the clim"):
        render(ones, mode="mip", clim=(0, 1), device=device)
    with pytest.raises(OptionError, match=r"colormap is no option of mip \(did you mean cmap\?\)"):
        render(ones, mode="mip", colormap="gray", device=device)
    with pytest.raises(OptionError, match="memory must be a whole number"):
        render(ones, memory="1G", device=device)  # type: ignore[arg-type]


def test_a_closed_renderer_says_so(device: Device) -> None:
    with Renderer(noise(), device=device) as renderer:
        renderer.render(size=(8, 8))
    for fetch in ("buffer", "image") if device.has_images else ("buffer",):
        with pytest.raises(OptionError, match="released"), device.limited(fetch=fetch):
            renderer.render(size=(8, 8))
    renderer.close()  # closing twice is allowed


def test_progress_rises_to_one(renderer: Renderer) -> None:
    calls: list[float] = []
    with renderer.device.limited(launch_seconds=1e-9):
        renderer.render(CAMERA, size=(40, 30), rays=3, progress=calls.append)
    assert len(calls) > 10
    assert calls == sorted(calls)
    assert calls[-1] == pytest.approx(1)
    assert 0 < calls[0] < 0.5


def test_an_interrupt_leaves_the_renderer_usable(renderer: Renderer) -> None:
    before = renderer.render(CAMERA, size=(40, 30))

    def stop(done: float) -> None:
        if done > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), renderer.device.limited(launch_seconds=1e-9):
        renderer.render(CAMERA, size=(40, 30), progress=stop)
    np.testing.assert_array_equal(renderer.render(CAMERA, size=(40, 30)), before)


# -- odd input -----------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(4)
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 9), (9, 1, 9), (9, 9, 1), (1, 1, 40), (2, 2, 2), (3, 1, 2)])
@pytest.mark.parametrize("mode", cases.MODES)
def test_thin_volumes(device: Device, shape: tuple[int, int, int], mode: str) -> None:
    data = np.random.default_rng(2).random(shape).astype(np.float32)
    # `color` tells lit pixels from background even if the value is the least
    options = suited(mode, {"isovalue": 0.5, "background": None})
    got = render(data, CAMERA, mode, size=(24, 24), device=device, outputs=("rgba", "depth"), **options)
    assert np.isfinite(got["rgba"]).all()
    if mode in ("mip", "minip", "mean"):
        assert (got["rgba"][..., 3] > 0).any()


def test_a_single_voxel_fills_its_cube(device: Device) -> None:
    camera = Camera(direction=(0, 1, 0), projection="orthographic", fit="volume")
    grey = TransferFunction(((7.0, (0.5, 0.5, 0.5)),))
    options: dict[str, Any] = {"size": (64, 64), "transfer": grey, "device": device, "background": None}
    for name in ("nearest", "linear", "bspline3", "bspline5", "hybrid", "sinc"):
        got = render(np.full((1, 1, 1), 7, np.int16), camera, "mip", filter=name, **options)
        lit = got[..., 3] > 0
        assert lit.mean() == pytest.approx(1 / 3, abs=0.02)  # a side of 1 in a picture of √3
        np.testing.assert_allclose(got[lit], np.broadcast_to([0.5, 0.5, 0.5, 1], (lit.sum(), 4)), atol=1e-6)


def test_any_dtype_and_layout(device: Device) -> None:
    data = (noise().data * 200).astype(np.uint8)
    options: dict[str, Any] = {"size": SIZE, "mode": "mip", "transfer": TransferFunction.ramp((0, 200)), "device": device}
    want = render(data.astype(np.float32), CAMERA, **options)
    frozen = data.copy()
    frozen.setflags(write=False)
    backwards, sparse = data[::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1], np.repeat(data, 2, 2)[:, :, ::2]
    forms = [data, frozen, np.asfortranarray(data), backwards, sparse]
    forms += [data.astype(kind) for kind in ("<i2", ">i2", ">u4", "<i8", ">f4", "<f8", ">f8", "f2")]
    for form in forms:
        np.testing.assert_array_equal(render(form, CAMERA, **options), want)
    np.testing.assert_array_equal(render(data.tolist(), CAMERA, **options), want)
    options["transfer"] = None
    want = render((data > 100).astype(np.float32), CAMERA, **options)
    np.testing.assert_array_equal(render(data > 100, CAMERA, **options), want)


@pytest.mark.parametrize("value", [0, 5.5, -1e30])
@pytest.mark.parametrize("mode", cases.MODES)
def test_constant_data(device: Device, mode: str, value: float) -> None:
    got = render(np.full((5, 6, 7), value, np.float32), CAMERA, mode, size=(16, 16), device=device, outputs=("rgba", "normal"))
    assert np.isfinite(got["rgba"]).all()
    assert np.isnan(got["normal"]).all()  # there is no gradient


@pytest.mark.parametrize("scale", [1e-30, 1e-20, 1e20, 1e30])
@pytest.mark.parametrize("mode", ["composite", "isosurface"])
def test_units_of_the_values_do_not_matter(device: Device, mode: str, scale: float) -> None:
    pictures = []
    for s in (1.0, scale):
        transfer = TransferFunction.from_cmap("viridis", (0, s), ((0.2 * s, 0.0), (s, 0.6)))
        data = (noise().data.astype(float) * s).astype(np.float32)
        options = suited(mode, {"transfer": transfer, "isovalue": 0.5 * s})
        pictures.append(render(data, CAMERA, mode, size=SIZE, device=device, **options))
    difference = np.abs(pictures[0] - pictures[1]).max(-1)
    assert (difference > 5e-3).mean() <= 0.005
    assert np.sqrt((difference**2).mean()) < 1e-3


def test_isovalues_outside_the_data_show_nothing(renderer: Renderer) -> None:
    for value in (-5.0, 7.0, 1e30):
        got = renderer.render(CAMERA, "isosurface", SIZE, isovalue=value, background=None, outputs=OUTPUTS)
        assert not got["rgba"].any()
        assert np.isinf(got["depth"]).all()
        assert np.isnan(got["normal"]).all()
        assert np.isnan(got["position"]).all()


@pytest.mark.parametrize("mode", cases.MODES)
def test_a_camera_inside_sees_only_what_is_ahead(renderer: Renderer, mode: str) -> None:
    camera = Camera.look_at((3.6, 4.1, 4.4), (3.6, 9.0, 4.6), fov=90)
    for step in (0.5, 50.0):
        got = renderer.render(camera, mode, SIZE, step, outputs=OUTPUTS, **suited(mode, {"isovalue": 0.5}))
        hit = np.isfinite(got["depth"])
        assert (got["depth"][hit] >= 0).all()
        assert (got["position"][hit][:, 1] >= 4.1 - 1e-4).all()
    assert np.isfinite(got["rgba"]).all()


def test_a_camera_that_looks_away_sees_the_background(renderer: Renderer) -> None:
    got = renderer.render(Camera.look_at((50, 50, 50), (100, 100, 100)), "mip", SIZE, background="red")
    np.testing.assert_array_equal(got, np.broadcast_to(np.float32([1, 0, 0, 1]), got.shape))


def test_requested_outputs_are_returned(renderer: Renderer) -> None:
    assert isinstance(renderer.render(CAMERA, size=SIZE), np.ndarray)
    assert renderer.render(CAMERA, size=SIZE, outputs="depth").shape == (20, 24)
    got = renderer.render(CAMERA, size=SIZE, outputs=["normal", "rgba"])
    assert list(got) == ["normal", "rgba"]
    np.testing.assert_array_equal(got["rgba"], renderer.render(CAMERA, size=SIZE))
    clear = renderer.render(CAMERA, size=SIZE, background=None, shading=False)
    over = clear[..., :3] * clear[..., 3:] + (1 - clear[..., 3:]) * np.float32([0, 0, 1])
    np.testing.assert_allclose(renderer.render(CAMERA, size=SIZE, background="blue", shading=False)[..., :3], over, atol=1e-6)


# -- far away, very small, very large ------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e12, 1e30])
def test_world_units_of_any_size(device: Device, scale: float) -> None:
    """The picture is the same to the last bit; depths scale with the unit."""
    data = phantoms.sphere(14).data
    options: dict[str, Any] = {"mode": "isosurface", "size": (24, 20), "outputs": ("rgba", "depth"), "device": device}
    want = render(Volume(data), CAMERA, **options)
    got = render(Volume(data, (scale,) * 3), CAMERA, **options)
    np.testing.assert_allclose(got["rgba"], want["rgba"], atol=1e-5)
    np.testing.assert_allclose(got["depth"] / scale, want["depth"], rtol=1e-5)


@pytest.mark.parametrize("mode", cases.MODES)
@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9])
def test_a_camera_far_away_sees_what_an_orthographic_one_does(device: Device, mode: str, distance: float) -> None:
    volume = phantoms.sphere(14)
    flat = replace(CAMERA, projection="orthographic", zoom=1.0)
    half = flat.view(volume, 1.2).half_height
    far = replace(CAMERA, distance=distance, zoom=distance * math.tan(math.radians(CAMERA.fov / 2)) / half)
    want = render(volume, flat, mode, size=(24, 20), device=device)
    got = render(volume, far, mode, size=(24, 20), device=device)
    off = np.abs(got - want).max(-1) > 0.05 + 100 / distance  # silhouettes
    assert off.mean() < 0.02


def test_spacings_beyond_float32_are_rejected(device: Device) -> None:
    for spacing in ((1e-7, 1, 1), (1e300, 1, 1), (1e-300,) * 3):
        with pytest.raises(GeometryError, match="differ by a factor"):
            render(Volume(np.ones((3, 4, 5)), spacing), size=(8, 8), device=device)


# -- the filter that nobody chose ----------------------------------------------------------------------------------


def noisy_ball() -> Volume:
    noise = np.random.default_rng(0).normal(0, 0.2, (24, 24, 24))
    return Volume((phantoms.sphere(24).data + noise).astype(np.float32))


def test_pictures_smooth_the_noise_of_the_volume_unless_a_filter_is_given(device: Device) -> None:
    volume = noisy_ball()
    options: dict[str, Any] = {"size": (24, 20), "device": device}
    row = settled("bspline3(auto)", volume)
    assert not row.interpolates
    for mode in ("composite", "isosurface", "mean"):
        np.testing.assert_array_equal(render(volume, mode=mode, **options), render(volume, mode=mode, filter=row, **options))
    for scene in (Medium(volume), Scene(volume)):
        np.testing.assert_array_equal(render(scene, **options), render(volume, filter="bspline3(auto)", **options))
    assert (render(volume, **options) != render(volume, filter="bspline3", **options)).any()


def test_pictures_of_extremes_do_not_smooth_by_default(device: Device) -> None:
    volume = noisy_ball()
    options: dict[str, Any] = {"size": (24, 20), "device": device}
    for mode in ("mip", "minip", "attenuated"):
        plain = render(volume, mode=mode, filter="bspline3", **options)
        np.testing.assert_array_equal(render(volume, mode=mode, **options), plain)
        np.testing.assert_array_equal(render(Medium(volume), mode=mode, **options), plain)
        assert (render(volume, mode=mode, filter="bspline3(auto)", **options) != plain).any()


def test_one_renderer_renders_both(device: Device) -> None:
    volume = noisy_ball()
    with Renderer(volume, device=device) as renderer:
        assert renderer.filter == settled("bspline3(auto)", volume)
        assert renderer.filter_of("mip").name == "bspline3"
        assert renderer.filter_of("composite") == renderer.filter
        for mode in ("composite", "mip", "composite", "mip"):
            got = renderer.render(mode=mode, size=(20, 20))
            np.testing.assert_array_equal(got, render(volume, mode=mode, size=(20, 20), device=device))
    with pytest.raises(OptionError, match="closed"):
        renderer.render(mode="mip")
    with Renderer(volume, "bspline3(0.3)", device=device) as renderer:
        assert {renderer.filter_of(mode).name for mode in cases.MODES} == {"bspline3(0.3)"}


def test_noise_free_volumes_are_interpolated(device: Device) -> None:
    with Renderer(phantoms.marschner_lobb(24), device=device) as renderer:
        assert renderer.filter.name == "bspline3"


def test_labels_indistinguishable_in_float32_are_rejected(device: Device) -> None:
    data = np.zeros((4, 4, 4), np.int32)
    data[1:3] = 2**24 + 1
    with pytest.raises(DataError, match=r"2\*\*24.*renumber"):
        render(Volume(data, labels=True), device=device)


def test_a_volume_renders_and_plots_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    data, camera = np.random.default_rng(3).random((9, 10, 11)).astype(np.float32), clvol.Camera.orbit(40, 10)
    shown: list[Any] = []
    monkeypatch.setattr("clvol.show.picture.show", shown.append)
    for volume in (clvol.Volume(data), clvol.LazyVolume(data, labels=False)):
        want = clvol.render(volume, camera, "mip", (20, 15), filter="linear")
        np.testing.assert_array_equal(volume.render(camera, "mip", (20, 15), filter="linear"), want)
        volume.plot(camera, "mip", (20, 15), filter="linear")
        np.testing.assert_array_equal(shown.pop(), want)
        with pytest.raises(OptionError, match="colour is no option of mip"):
            volume.render(mode="mip", colour="red")
        with pytest.raises(OptionError, match="colour is no option of mip"):
            volume.plot(mode="mip", colour="red")
    assert not shown
