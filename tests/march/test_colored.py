"""Media coloured by another volume, and surfaces by their distance: the reference's, by bricks, among others, and again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Medium, Renderer, Scene, TransferFunction, Volume
from clvol.base.errors import ClvolWarning, DataError, OptionError
from clvol.device import Device
from clvol.interfaces.again import render_again
from clvol.reference.march import march as reference
from clvol.reference.march.media import render_media
from tests.march.agreement import block
from tests.march.looks import TILES
from tests.march.test_media import FIRST, MEDIA, SIZE, blobs, camera

SHADES = TransferFunction([(0.2, "navy"), (0.5, "lime"), (0.8, "red")], [(0.3, 1), (0.6, 0.4), (0.7, 0)])
OTHER = blobs(7, 9, 8, 11, spacing=(3, 4, 2.5), origin=(-3, -2, -4), direction=np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]))
HOLED = replace(OTHER, data=np.where(np.indices(OTHER.shape)[2] < 5, np.nan, OTHER.data))
LABELS = Volume(np.digitize(OTHER.data, (0.2, 0.35)), OTHER.spacing, OTHER.origin, OTHER.direction, labels={1: "a", 2: "b"})
KINDS: dict[str, tuple[str, str, Volume, str, dict[str, Any]]] = {  # mode, rays of a work-item, what colours it and its filter
    "isosurface": ("isosurface", "planes", HOLED, "bspline3", {"isovalue": 0.5}),
    "surfaces": ("surfaces", "rays", OTHER, "linear", {"surfaces": "0.3:tan:0.4,0.6:red"}),
    "composite": ("composite", "eights", OTHER, "bspline5", {"shading": True}),
    "labels": ("isosurface", "planes", LABELS, "nearest", {"isovalue": 0.5}),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_the_references(device: Device, kind: str) -> None:
    """On another grid, which is smaller than the medium's."""
    mode, tile, volume, row, own = KINDS[kind]
    medium, view = block(oblique=True), Camera.orbit(33, 21, fit="volume")
    place = volume.center - np.asarray(medium.center)
    volume = replace(volume, origin=tuple(np.asarray(volume.origin) - place))
    transfer = SHADES if kind != "labels" else TransferFunction([(0, "navy"), (1, "lime"), (2, "red")], [(0, 0), (1, 1)])
    other = Medium(volume, transfer, filter=row)
    with device.limited(tile=TILES[tile]):
        got = clvol.render(
            Medium(medium, filter="bspline3", color_by=other), view, mode, (40, 30), rays=1, device=device,
            **own, **({"termination": 0} if mode == "composite" else {}),
        )  # fmt: skip
    want: Any = reference.render(medium, view, mode, "bspline3", "mirror", (40, 30), other=other, **own)
    plain: Any = reference.render(medium, view, mode, "bspline3", "mirror", (40, 30), **own)
    apart = np.abs(got - want).max(-1)
    # at the other volume's ends, and between its labels, colours jump: there a place is on either side by rounding
    assert (apart > 2e-4).sum() <= 3, np.sort(apart.ravel())[-8:]
    assert (np.abs(want - plain).max(-1) > 0.05).sum() > 30


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_distances_are_those_behind_the_middle(device: Device, projection: Any) -> None:
    """Along the ray, from the plane that faces the camera."""
    volume = block(oblique=True)
    look = {"mode": "isosurface", "isovalue": 0.5, "shading": False, "rays": 1, "background": None, "device": device}
    gray, view = TransferFunction([(-9, "black"), (9, "white")]), Camera.orbit(33, 21, projection=projection)
    pictures: Any = clvol.render(volume, view, size=(40, 30), color_by="distance", transfer=gray, outputs=("rgba", "depth"), **look)
    hit = np.isfinite(pictures["depth"])
    want: Any = reference.render(volume, pictures["rgba"].camera, "isosurface", "bspline3", "mirror", (40, 30), isovalue=0.5,
                                 color_by="distance", transfer=gray, shading=False, background=None)  # fmt: skip
    np.testing.assert_allclose(pictures["rgba"][hit][:, 0], want[hit][:, 0], atol=1e-4)
    assert np.ptp(want[hit][:, 0]) > 0.1


def test_labels_keep_their_colors_where_nothing_covers_them(device: Device) -> None:
    clear = TransferFunction([(0, "red")], [(0.5, 0), (0.6, 1)])
    look: dict[str, Any] = {"mode": "isosurface", "size": (40, 30), "device": device}
    plain = clvol.render(LABELS, **look)
    left = np.indices(LABELS.shape)[2] < 5
    covered = clvol.render(Medium(LABELS, color_by=Medium(replace(LABELS, data=1.0 * left, labels=None), clear)), **look)
    same = (plain == covered).all(-1)
    assert 0.1 < same[plain[..., :3].any(-1)].mean() < 0.9
    red = covered[~same]
    assert (red[:, 0] >= red[:, 1:3].max(1)).all()


def test_media_of_a_scene_are_colored_and_their_order_does_not_matter(device: Device) -> None:
    other = Medium(OTHER, SHADES, filter="bspline3")
    media = [replace(FIRST, color_by=other), MEDIA["one grid"], replace(MEDIA["turned"], color_by=other)]
    want = render_media(Scene(media), camera("perspective"), SIZE, 0.7)["rgba"]
    look: dict[str, Any] = {"size": SIZE, "step": 0.7, "rays": 1, "termination": 0, "device": device}
    got = clvol.render(Scene(media), camera("perspective"), **look)
    apart = np.abs(got - want).max(-1)
    assert np.quantile(apart, 0.99) < 1e-4
    np.testing.assert_array_equal(got, clvol.render(Scene(media[::-1]), camera("perspective"), **look))


def test_by_bricks_they_are_the_same(device: Device) -> None:
    data, look = np.asarray(clvol.phantoms.marschner_lobb(40).data), {"mode": "isosurface", "size": (60, 50), "color_bar": True}
    other = Volume(np.indices((10, 10, 10)).sum(0), (4, 4, 4), (1.5, 1.5, 1.5))
    medium = Medium(Volume(data), filter="mitchell", color_by=other)
    lazy = Medium(clvol.LazyVolume(data), filter="mitchell", color_by=other)  # type: ignore[arg-type]
    with Renderer(medium, device=device) as whole, Renderer(lazy, device=device) as bricked:
        np.testing.assert_array_equal(bricked.render(**look), whole.render(**look))


def test_functions_and_arrays_are_on_the_grid_of_the_medium() -> None:
    volume = Volume(np.zeros((3, 4, 5)), (1, 2, 3), (10, 20, 30))
    of_points = Medium(volume, color_by=lambda points: points[:, 0] + 100 * points[:, 1] + 1e4 * points[:, 2]).color_by  # type: ignore[arg-type]
    assert of_points is not None
    k, j, i = np.indices(volume.shape)
    np.testing.assert_array_equal(of_points.volume.data, 10 + i + 100 * (20 + 2 * j) + 1e4 * (30 + 3 * k))
    array = Medium(volume, color_by=of_points.volume.data).color_by
    assert array is not None
    for name in ("spacing", "origin"):
        assert getattr(array.volume, name) == getattr(volume, name)
    with pytest.raises(DataError, match=r"must have the medium's shape, \(3, 4, 5\); got \(5, 4, 3\)"):
        Medium(volume, color_by=of_points.volume.data.T)
    with pytest.raises(DataError, match="one value for each of 20 points"):
        Medium(volume, color_by=lambda points: points)  # type: ignore[arg-type]


def test_what_would_change_nothing_is_refused(device: Device) -> None:
    volume = clvol.phantoms.marschner_lobb(8)
    medium = Medium(volume, color_by=volume)  # type: ignore[arg-type]  # it converts
    for mode, options, said in (
        ("mip", {}, "color_by of a medium changes nothing in mip"),
        ("isosurface", {"color_by": "k1"}, "got both"),
        ("isosurface", {"color_by": volume}, "another volume colours a medium"),
    ):
        with pytest.raises(OptionError, match=said):
            clvol.render(medium, mode=mode, size=(8, 8), device=device, **options)
    for other in (medium, Medium(volume, clip=((0, 0, 0), (1, 1, 1))), clvol.LazyVolume(volume.data)):
        with pytest.raises(OptionError, match="color_by takes a"):
            Medium(volume, color_by=other)
    with pytest.warns(ClvolWarning, match="color_by of medium 0 of a scene overlaps no other"):
        Scene((Medium(volume, color_by=replace(volume, origin=(99, 99, 99))),))  # type: ignore[arg-type]  # it converts


def test_a_picture_is_drawn_again(tmp_path: Path, device: Device) -> None:
    clvol.write(clvol.phantoms.marschner_lobb(14), tmp_path / "volume.nrrd")
    clvol.write(clvol.phantoms.sphere(12), tmp_path / "ball.nrrd")
    medium = Medium(clvol.read(tmp_path / "volume.nrrd"), color_by=clvol.read(tmp_path / "ball.nrrd"))  # type: ignore[arg-type]
    first = clvol.render(medium, mode="isosurface", size=(40, 30), color_bar=True, device=device)
    np.testing.assert_array_equal(render_again(first.save(tmp_path / "colored.png"), device=device), first)
    clvol.write(clvol.phantoms.sphere(13), tmp_path / "ball.nrrd")
    with pytest.raises(DataError, match=r"ball\.nrrd, whose values colour .* has changed"):
        render_again(tmp_path / "colored.png")
