"""Surfaces compared with SciPy's spline in float64: no root is missed, and only the first is rendered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import clvol
from bench.roots import SCENES, check
from clvol.device import Device
from clvol.filter.table import as_filter
from clvol.march.frame import BY_RAYS
from clvol.reference.march.march import camera_rays
from clvol.reference.march.roots import first_crossings
from clvol.scene.camera import Camera
from clvol.scene.mode import Isosurface
from clvol.volume.volume import Volume
from tests.march.looks import TILES
from tests.outside import caster


@pytest.mark.one_in(5)
@pytest.mark.parametrize("scene", SCENES)
def test_no_ray_misses_the_first_root(scene: str) -> None:
    """Some thousand random rays here; ``python -m bench.roots`` tests a million."""
    surface = SCENES[scene]()
    count = check(surface, 6000, seed=5, edge=32)
    assert count.wrong == 0
    assert count.rounding < 0.05 * count.rays or scene == "double roots"  # where rounding always decides
    assert count.hits > 500


def test_stepped_surfaces_do_miss_some() -> None:
    """Verifies `check`: it detects this method's fault."""
    count = check(SCENES["noise"](), 4000, edge=32, method="stepped")
    assert count.wrong > 20


def test_the_truth_agrees_with_dense_sampling() -> None:
    data = np.random.default_rng(2).random((8, 9, 7))
    volume, camera, size = Volume(data), Camera.orbit(25, 15, fit="volume"), (24, 24)
    spline = caster.Spline(data)
    view = camera.view(volume, 1.0)
    rays = camera_rays(volume, view, size)
    found = first_crossings(spline, volume, as_filter("bspline3"), rays, 0.5)
    hit = np.isfinite(found)
    assert hit.sum() > 100
    np.testing.assert_allclose(spline(rays.at(found[hit], hit)), 0.5, atol=1e-9)
    share = np.linspace(0, 1, 2001)
    last = np.where(hit, found, rays.leave)[:, None]
    for i in np.flatnonzero(rays.enter < rays.leave):
        t = rays.enter[i] + share * (last[i] - rays.enter[i])
        side = spline(rays.origin[i] + t[:, None] * rays.direction[i]) >= 0.5
        assert (side[1:-1] == side[1]).all()


@pytest.mark.parametrize("thickness", [0.3, 0.1, 0.01])
def test_a_thin_sheet_is_seen_by_every_ray(thickness: float) -> None:
    """A parabola along x, which a cubic spline reproduces: its two roots lie `thickness` apart."""
    x = np.arange(16.0)
    data = np.broadcast_to(-((x - 7.37) ** 2), (8, 8, 16)).astype(np.float64)
    # within the domain's middle SciPy and the parabola agree to what the boundary rule leaves there
    spline = caster.Spline(data)
    at = np.stack([np.linspace(6.5, 8.5, 41), np.full(41, 3.5), np.full(41, 3.5)], -1)
    crest = at[spline(at).argmax(), 0]
    top = float(spline(np.array([[crest, 3.5, 3.5]]))[0])
    isovalue = top - (thickness / 2) ** 2
    camera = Camera.look_at((-30.0, 3.2, 3.9), (7.0, 3.5, 3.5), fov=4)
    depth = clvol.render(Volume(data), camera, "isosurface", size=(24, 24), isovalue=isovalue, outputs="position")
    assert np.isfinite(depth).all()
    assert np.abs(depth[..., 0] - (crest - thickness / 2)).max() < 0.02


@pytest.mark.one_in(6)
@pytest.mark.parametrize("filter", ["nearest", "linear", "bspline3", "catmull-rom", "lanczos3", "hybrid"])
def test_the_picture_does_not_depend_on_how_rays_are_cut(device: Device, filter: str) -> None:
    """Steps, tiles, and skipping: not one bit differs."""
    data = np.random.default_rng(7).random((11, 9, 13)).astype(np.float32)
    options: dict[str, Any] = {"isovalue": 0.55, "outputs": ("rgba", "depth", "normal", "position")}
    with clvol.Renderer(Volume(data, (1.0, 0.7, 1.2)), filter, device=device) as renderer:
        for camera in (
            Camera.orbit(40, 25, fit="volume"),
            Camera.orbit(200, -60, projection="orthographic", fit="volume"),
            Camera.orbit(90, 0, zoom=3, fit="volume"),
        ):
            pictures = [
                renderer.render(camera, "isosurface", (37, 29), step, skipping=skipping, **options)
                for step, skipping in ((0.5, True), (0.5, False), (7.3, True), (0.01, True))
            ]
            for tile in TILES.values():
                if tile == BY_RAYS:
                    continue  # kernels of one lane round in another order: below
                with device.limited(tile=tile):
                    pictures.append(renderer.render(camera, "isosurface", (37, 29), **options))
            assert np.isfinite(pictures[0]["depth"]).mean() > 0.2
            for picture in pictures[1:]:
                for name in picture:
                    np.testing.assert_array_equal(picture[name], pictures[0][name], err_msg=f"{filter} {name}")


def test_a_ray_that_starts_behind_a_surface_sees_the_next() -> None:
    data = np.broadcast_to(np.sin(np.arange(32.0) + 0.5), (6, 6, 32))
    whole = clvol.render(
        data, Camera(direction=(1, 0.01, 0.02), fit="volume"), "isosurface", size=(9, 9), isovalue=0.0, outputs="position"
    )
    first = float(whole[4, 4, 0])
    assert first == pytest.approx(math.pi - 0.5, abs=0.05)
    clip = ((first + 0.5, -9, -9), (99, 99, 99))
    behind = clvol.render(
        data,
        Camera(direction=(1, 0.01, 0.02), fit="volume"),
        "isosurface",
        size=(9, 9),
        isovalue=0.0,
        clip=clip,
        outputs="position",
    )
    assert float(behind[4, 4, 0]) == pytest.approx(2 * math.pi - 0.5, abs=0.05)


@pytest.mark.parametrize("size", [9, 33, 65])
def test_rays_on_planes_between_cells_meet_no_spurious_surface(size: int) -> None:
    half = np.zeros((6, 6, 6))
    half[:, :, 3:] = 1
    camera = Camera(
        direction=(0, 1, 0), projection="orthographic", fit="volume"
    )  # the middle column of pixels lies on such a plane
    depth = clvol.render(half, camera, "isosurface", filter="nearest", size=(size, size), isovalue=0.5, outputs="depth")
    assert np.isinf(depth).all()


def test_a_clip_face_that_contains_a_ray_does_not_cut_it() -> None:
    data = np.random.default_rng(3).random((6, 6, 6))
    camera = Camera(direction=(0, 1, 0), projection="orthographic", fit="volume")
    options: dict[str, Any] = {"size": (9, 9), "isovalue": 0.6, "outputs": "depth", "clip": ((2.5, -9, -9), (99, 99, 99))}
    got = clvol.render(data, camera, "isosurface", **options)
    want = clvol.reference.march.march.render(data, camera, "isosurface", **options)
    assert isinstance(want, np.ndarray)
    assert np.isfinite(want[:, 4]).any()
    np.testing.assert_allclose(got, want, atol=1e-4)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 7), (2, 1, 3), (2, 2, 2)])
@pytest.mark.parametrize("filter", ["nearest", "linear", "bspline3", "hybrid"])
def test_small_volumes(filter: str, shape: tuple[int, int, int]) -> None:
    data = np.arange(math.prod(shape), dtype=np.float64).reshape(shape)
    for isovalue in (-1.0, 0.0, 0.5, float(data.max())):
        got = clvol.render(
            data, Camera.orbit(10, 20, fit="volume"), "isosurface", filter=filter, size=(16, 16), isovalue=isovalue, outputs="depth"
        )
        want = clvol.reference.march.march.render(
            data, Camera.orbit(10, 20, fit="volume"), "isosurface", filter, size=(16, 16), isovalue=isovalue, outputs="depth"
        )
        if isovalue not in (0.0, float(data.max())):  # at an extreme rounding decides
            both = np.isfinite(got) & np.isfinite(want)
            assert (np.isfinite(got) != np.isfinite(want)).sum() <= 1  # a root at a face
            np.testing.assert_allclose(got[both], want[both], atol=1e-4)


def test_method_is_checked() -> None:
    with pytest.raises(clvol.OptionError, match="method must be one of exact, stepped; got 'fast'"):
        Isosurface(method="fast")  # type: ignore[arg-type]  # that is what is tested
