"""Shadow and occlusion: the reference's light, still while the camera moves, and only of what is there and not cut away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Corner, Light, Material, Medium, Plane, Renderer, Scene, TransferFunction, Volume
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.device.buffers import Buffers
from clvol.march.shadow import BEYOND, OPAQUE, Body, Cells, Matter, Shadows
from clvol.march.tracking import tracked
from clvol.reference.march import shadow as reference
from clvol.scene.clip import Cuts, cuts_of
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.minmax import MinMax
from tests.march.agreement import block

SUN = Light((0.0, 0.0, 1.0))
SUNNY: dict[str, Any] = {
    "lights": SUN,
    "material": Material(0.2, 0.8, 0),
    "mode": "isosurface",
    "isovalue": 0.5,
    "color": "white",
    "rays": 1,
}
HAZE = ((0.25, 0.0), (0.5, 0.4), (0.8, 0.1))


def canopy() -> Volume:
    """A floor, and a roof over its middle."""
    data = np.zeros((24, 24, 24), np.float32)
    data[:5], data[9:12, 7:17, 7:17] = 1, 1
    return Volume(data)


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[Renderer]:
    with Renderer(canopy(), "linear", device=device) as made:
        yield made


def floor(renderer: Renderer, camera: Camera, **options: Any) -> tuple[float, float]:
    """How bright the floor is under the middle of the roof, and far from it."""
    found = renderer.render(camera, size=(64, 64), outputs=["rgba", "position"], **{**SUNNY, **options})
    at, red = found["position"], found["rgba"][..., 0]
    flat = np.abs(at[..., 2] - 4.5) < 0.01
    x, y = np.abs(at[..., 0] - 11.5), np.abs(at[..., 1] - 11.5)
    return float(np.median(red[flat & (x < 2) & (y < 2)])), float(np.median(red[flat & ((x > 8) | (y > 8))]))


@pytest.mark.parametrize("way", [(0.3, -0.2, 0.9), (-0.8, 0.3, 0.1)])
def test_light_is_the_references(device: Device, way: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a translucent block in an oblique frame, through cells of other edges than its samples'; in memory that was NaN."""
    monkeypatch.setattr(Buffers, "allocate", lambda self, size: self.upload(np.full(-(-size // 4), np.nan, np.float32)))
    volume, row = block(oblique=True), clvol.filters()["bspline3"]
    transfer, unit = TransferFunction([(0, "white")], HAZE), 1.5 * volume.mean_spacing
    with clvol.Field(volume, row, device=device) as field:
        made, cells = Shadows(field.device), Cells.over([volume])
        body = Body.of(field.coefficients, Matter(HAZE, unit, (), Cuts()))
        got, light = made.extinction(cells, body), made.light(cells, [body], (way,), occlusion=False)[0, ..., 0]
        made.release()
    want = reference.extinction(volume, row, cells.nodes.size, lambda v: -np.log2(1 - transfer(v)[..., 3]) / unit)
    np.testing.assert_allclose(got, want, atol=0.01 * want.max())
    found = reference.light_through_cells(np.pad(got.astype(np.float64), BEYOND), cells.nodes.world_to_index_matrix @ np.array(way))
    np.testing.assert_allclose(light, found, atol=1e-5)


def test_light_is_that_of_the_function(device: Device) -> None:
    """Of soft matter, in places anywhere, though cells are coarse."""
    x, y, z = np.mgrid[-1:1:20j, -1:1:20j, -1:1:20j]
    volume, row, way = Volume(np.exp(-3 * (x**2 + y**2 + z**2))), clvol.filters()["bspline3"], np.array([0.48, -0.6, 0.64])
    transfer = TransferFunction([(0, "white")], [(0.2, 0.0), (1, 0.15)])
    with clvol.Field(volume, row, device=device) as field:
        made, cells = Shadows(field.device), Cells.over([volume])
        body = Body.of(field.coefficients, Matter(transfer.opacities, 1.0, (), Cuts()))
        light = made.light(cells, [body], (tuple(way),), occlusion=False)[0, ..., 0]
        made.release()
    nodes = np.random.default_rng(1).integers(0, cells.nodes.size[0], (200, 3))
    points = cells.nodes.index_to_world(nodes) + way / np.abs(way).max()  # the plane before
    want = reference.light_to(volume, row, lambda v: -np.log2(1 - transfer(v)[..., 3]), points, way, 0.1)
    apart = light[tuple((nodes + BEYOND).T[::-1])] - want
    assert np.sqrt((apart**2).mean()) < 0.005
    assert want.min() < 0.4


@pytest.mark.parametrize(
    "points",
    [
        [(1.0, 0.0), (1.0, 0.5)],
        [(1.0, 0.0), (1.0001, 0.5)],
        [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5)],
        [(-1e6, 0.0), (1.0, 0.0), (1.0, 0.5), (1e6, 0.5)],
    ],
)
def test_a_jump_of_opacity_stops_light_above_it_alone(device: Device, points: list[tuple[float, float]]) -> None:
    """Wherever the function's other points are; the value of the jump has the opacity before it, as in pictures."""
    data = np.ones((12, 12, 12), np.float32)
    data[4:8] = 3
    with clvol.Field(Volume(data), "linear", device=device) as field:
        made, cells = Shadows(field.device), Cells.over([field.volume])
        found = made.extinction(cells, Body.of(field.coefficients, Matter(tuple(points), 1.0, (), Cuts())))
        made.release()
    np.testing.assert_allclose(found[:, 5, 5][[0, 1, 2, 5, 6, 9, 10, 11]], [0, 0, 0, 1, 1, 0, 0, 0], atol=1e-3)


@pytest.mark.parametrize("capped", [False, True])
def test_a_surface_stops_its_share_of_light_of_any_slant_and_a_cap_all(device: Device, capped: bool) -> None:
    data = np.broadcast_to(np.clip(np.arange(24.0) - 11.5, -4, 4)[:, None, None], (24, 24, 24)).astype(np.float32)
    way = np.array([0.6, 0, 0.8])
    with clvol.Field(Volume(data), "linear", device=device) as field:
        made, cells = Shadows(field.device), Cells.over([field.volume])
        cut = cuts_of(Corner((-np.inf,) * 2 + (18.2,), (np.inf,) * 3))
        body = Body.of(field.coefficients, Matter((), 1.0, ((0.0, 0.5),), cut, capped))
        light = made.light(cells, [body], (tuple(way),), occlusion=False)[0, ..., 0]
        made.release()
    node = np.rint(cells.nodes.world_to_index(np.array([[3.0, 12, 4], [3, 12, 14], [3, 12, 21]]))).astype(int) + BEYOND
    above = 2 ** (-OPAQUE / way[2]) if capped else 1.0
    np.testing.assert_allclose(light[tuple(node.T[::-1])], [0.5 * above, above, 1], rtol=0.02)


def test_ratio_tracking_converges_to_the_closed_form(device: Device) -> None:
    """Its mean is exp(-integral) within its standard error, and the same to the bit again; surfaces leave what crossings do."""
    x, y, z = np.mgrid[-1:1:20j, -1:1:20j, -1:1:20j]
    volume = Volume(np.exp(-3 * (x**2 + y**2 + z**2)), (1, 1.2, 0.8))
    row, way = clvol.filters()["bspline3"], np.array([0.48, -0.6, 0.64])
    points = volume.index_to_world(np.random.default_rng(0).uniform(3, 16, (40, 3)))
    transfer = TransferFunction([(0, "white")], [(0.2, 0.0), (0.6, 0.3), (1, 0.1)])
    with clvol.Field(volume, row, device=device) as field:
        pyramid = MinMax(field.coefficients, choose_evaluator(device, row))
        haze, shells = Matter(transfer.opacities, 1.0, (), Cuts()), Matter((), 1.0, ((0.3, 0.2), (0.5, 0.5)), Cuts())
        (mean, error), again = (tracked(pyramid, haze, 2.0, points, way, paths=1024) for _ in range(2))
        crossed, _ = tracked(pyramid, shells, 2.0, points, way)
        x, y, z = (float(v) for v in volume.center)
        cut = cuts_of([((x - 9, y - 2, z - 9), (x + 9, y + 9, z + 3)), Plane((1, 0.4, 0), (x + 1, y, z))])
        opened = tracked(pyramid, haze._replace(cuts=cut), 2.0, points, way, paths=1024)
        with pytest.raises(OptionError, match="tracking takes cuts by a box and planes"):
            tracked(pyramid, haze._replace(cuts=cuts_of(Corner((0, 0, 0), (9, 9, 9)))), 2.0, points, way)
        pyramid.release()
    np.testing.assert_array_equal(mean, again[0])
    for (got, own), cuts in ((mean, error), Cuts()), (opened, cut):
        want = reference.light_to(volume, row, lambda v: -np.log2(1 - transfer(v)[..., 3]), points, way, 0.05, cuts)
        apart = (got - want) / np.maximum(own, 2e-3)
        assert want.min() < 0.4
        assert np.abs(apart).max() < 4
        assert np.sqrt((apart**2).mean()) < 1.3
    left = [0.8**outer * 0.5**inner for outer in range(3) for inner in range(3)]
    assert np.abs(crossed[:, None] - left).min(1).max() < 1e-6


def test_a_shadow_lies_under_what_stops_light_and_stays_there(renderer: Renderer) -> None:
    for camera in (Camera.orbit(30, 25), Camera.orbit(-110, 12)):
        under, apart = floor(renderer, camera, shadow=1)
        assert apart == pytest.approx(1.0, abs=0.01)
        assert under == pytest.approx(0.2 + 0.8 * 2**-OPAQUE, abs=0.02)  # of both sides of the roof, less would be left
        assert floor(renderer, camera, shadow=0.5)[0] == pytest.approx(0.6, abs=0.02)
    cut = Plane((0, 0, 1), (0, 0, 7))
    assert floor(renderer, camera, shadow=1, clip=cut) == pytest.approx((1, 1), abs=0.01)
    under, apart = floor(renderer, camera, occlusion=1)
    assert under < 0.95 < 0.999 < apart + 0.001


def test_lights_share_rows_of_numbers(renderer: Renderer) -> None:
    """Four lights and the light from everywhere are more than one row has."""
    camera = Camera.orbit(30, 25)
    one = renderer.render(camera, size=(32, 32), **SUNNY, shadow=1, occlusion=1)
    four = {**SUNNY, "lights": [replace(SUN, color=(0.25,) * 3)] * 4}
    np.testing.assert_allclose(renderer.render(camera, size=(32, 32), **four, shadow=1, occlusion=1), one, atol=2e-6)


def test_pictures_are_the_same_again_and_without_shadow_as_ever(device: Device) -> None:
    """Also of matter that another volume could colour, whose numbers lie between."""
    volume = block()
    clear = Medium(volume, TransferFunction([(0, "red")], [(0, 0)]))
    scenes = [Medium(volume, filter="bspline3"), Medium(volume, filter="bspline3", color_by=clear)]
    pictures = [clvol.render(one, size=(32, 24), shadow=0.8, occlusion=0.6, device=device) for one in (scenes[0], *scenes)]
    np.testing.assert_array_equal(*pictures[:2])
    np.testing.assert_allclose(pictures[2], pictures[0], atol=2e-6)
    with Renderer(scenes[0], device=device) as renderer:
        plain = renderer.render(size=(32, 24))
        np.testing.assert_array_equal(renderer.render(size=(32, 24), shadow=0, occlusion=0), plain)
        assert np.abs(plain - pictures[0]).max() > 0.02
        made = clvol.render(Scene(scenes[0], shadow=0.8, occlusion=0.6), size=(32, 24), device=device)
        np.testing.assert_array_equal(made, pictures[0])
        assert made.recipe is not None
        np.testing.assert_array_equal(renderer.render(made.recipe.camera, size=(32, 24), **kept(made.recipe.scene)), made)


def kept(scene: Scene) -> dict[str, Any]:
    return {name: getattr(scene, name) for name in ("lights", "shadow", "occlusion")} | {"transfer": scene.media[0].transfer}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shadow": 1, "mode": "mip"}, "shadow changes nothing in mip: nothing is shaded"),
        ({"occlusion": 1, "shading": False}, "occlusion changes nothing in composite: nothing is shaded"),
        ({"shadow": 1, "lights": Light()}, "shadow changes nothing in composite: headlights cast none"),
        ({"shadow": 1.5}, "shadow must be .* 0 .* 1"),
    ],
)
def test_what_changes_nothing_is_refused(renderer: Renderer, options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        renderer.render(size=(8, 8), **options)


def test_media_cast_shadows_on_each_other(device: Device) -> None:
    """A roof of its own grid, turned by a right angle, over a floor: as those of one volume; in any order the same to the bit."""
    data = canopy().data
    floor_of, roof = Volume(np.where(np.arange(24)[:, None, None] < 7, data, 0)), data[7:14, 5:19, 5:19]
    turned = Volume(np.rot90(roof, 1, (1, 2)).copy(), origin=(5, 18, 7), direction=[[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    look: dict[str, Any] = {"surfaces": "0.5:white", "material": SUNNY["material"], "filter": "linear"}
    media = [Medium(floor_of, **look), Medium(turned, **look)]
    camera, how = Camera.orbit(30, 25, target=(11.5, 11.5, 11.5), radius=20), {"shadow": 1, "occlusion": 0.5, "lights": SUN}
    pictures = [
        clvol.render(Scene(list(each)), camera, size=(64, 64), rays=1, device=device, **how)
        for each in ([Medium(canopy(), **look)], media, media[::-1])
    ]
    np.testing.assert_array_equal(pictures[1], pictures[2])
    apart = np.abs(pictures[0] - pictures[1])
    assert np.sqrt((apart**2).mean()) < 0.02
    without = clvol.render(Scene(media), camera, size=(64, 64), rays=1, device=device)
    assert np.abs(without - pictures[1]).max() > 0.3


def test_bricks_cast_those_of_memory(device: Device) -> None:
    volume, how = block(), {"filter": "bspline3", "size": (32, 24), "rays": 1, "shadow": 0.8, "occlusion": 0.6, "device": device}
    whole = clvol.render(volume, **how)
    with clvol.BrickedField(volume, "bspline3", device=device, edge=8) as field, Renderer(field) as renderer:
        parts = renderer.render(size=(32, 24), rays=1, shadow=0.8, occlusion=0.6)
    np.testing.assert_allclose(parts, whole, atol=2e-5)
    lacking = volume.data.copy()
    lacking[:2] = np.nan
    with pytest.raises(OptionError, match="shadow and occlusion must be left out for bricks that lack samples"):
        clvol.render(clvol.LazyVolume(lacking), size=(8, 8), occlusion=1, device=device)


def test_what_is_cut_away_stops_no_light(device: Device) -> None:
    """A homogeneous slab, cut through its middle: light passes the length that is kept, along each direction."""
    slab, opacity = Volume(np.ones((24, 24, 24), np.float32)), 0.05
    each = -float(np.log2(1 - opacity))
    cut = cuts_of(Plane((0.0, 0.0, 1.0), (0.0, 0.0, 11.5)))
    with clvol.Field(slab, "linear", device=device) as field:
        made, cells = Shadows(field.device), Cells.over([slab])
        for way in (0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.0, -1.0):
            body = Body.of(field.coefficients, Matter(((1.0, opacity),), 1.0, (), cut))
            light = made.light(cells, [body], (way,), occlusion=False)[0, ..., 0]
            column = light[BEYOND:-BEYOND, 11 + BEYOND, 5 + BEYOND]
            before = np.arange(24) + np.sign(way[2])  # the plane before, from which light counts
            length = np.clip(11.5 - before if way[2] > 0 else before + 0.5, 0, 12) / abs(way[2])
            np.testing.assert_allclose(-np.log2(column) / each, length, atol=1e-3)
        made.release()


def test_cells_are_a_third_of_large_volumes_and_cuts_take_shares_of_them() -> None:
    assert Cells.over([Volume(np.broadcast_to(np.float32(0), (256,) * 3))]).nodes.size == (80, 80, 80)
    thin = Cells.over([Volume(np.broadcast_to(np.float32(0), (9, 512, 512)), (1, 1, 8))]).nodes
    assert thin.size[2] == 9
    assert np.ptp(thin.spacing) < 5
    share = cuts_of([Plane((1, 0, 0), (0.25, 0, 0)), ((-9, -9, -9), (9, 9, 0))]).kept_share([[0, 0, 0], [1, 0, 0], [0, 0, -1]], 1.0)
    np.testing.assert_allclose(share, [0.375, 0, 0.75])
