"""Several media in one picture: the reference's, whatever their grids, filters and order."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import clvol
from clvol import Camera, Corner, LazyVolume, Medium, Plane, Scene, TransferFunction, Volume
from clvol.base.errors import ClvolError, ClvolWarning, DataError, GeometryError, OptionError
from clvol.device import Device
from clvol.march.frame import Frame
from clvol.reference.march.media import render_media
from clvol.volume.volumes import Leading
from tests.march.looks import TILES

SIZE = (40, 30)
TURNED = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def blobs(seed: int, *shape: int, **place: Any) -> Volume:
    data = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 2.5)
    return Volume(((data - data.min()) / np.ptp(data)).astype(np.float32), **place)


def soft(color: str, start: float) -> TransferFunction:
    return TransferFunction([(0, "black"), (start, color), (1, "white")], [(start, 0), (1, 0.25)])


FIRST = Medium(blobs(1, 20, 22, 24), soft("red", 0.45), filter="bspline3")
MEDIA = {
    "one grid": Medium(blobs(2, 20, 22, 24), soft("lime", 0.5), filter="mitchell"),
    "other spacings": Medium(blobs(3, 9, 14, 12, spacing=(2.1, 1.7, 2.3), origin=(-4, 1, 2)), soft("blue", 0.4), filter="bspline3"),
    "turned": Medium(
        blobs(4, 18, 12, 22, spacing=(1.1, 1.2, 1.5), origin=(8, 4, 3), direction=TURNED), soft("yellow", 0.45), filter="linear"
    ),
    "a slice": Medium(
        blobs(5, 1, 12, 22, spacing=(1.1, 1.2, 1.1), origin=(8, 4, 9.3), direction=TURNED), soft("white", 0.2), filter="linear"
    ),
}
VIEWS: dict[str, dict[str, Any]] = {
    "perspective": {"azimuth": 30, "elevation": 20},
    "orthographic": {"azimuth": 80, "elevation": 5, "projection": "orthographic"},
    "wide": {"azimuth": 40, "elevation": 60, "fov": 100, "distance": 9.0},  # rays too oblique to share planes
}


def camera(view: str) -> Camera:
    return Camera.orbit(target=(12, 11, 10), radius=19, **VIEWS[view])


def errors(scene: Scene, view: str, device: Device) -> tuple[float, float, float]:
    """Largest and RMS error of colours, and the largest of depths, relative to the mean."""
    want = render_media(scene, camera(view), SIZE, 0.7)
    got = clvol.render(scene, camera(view), size=SIZE, step=0.7, rays=1, termination=0, outputs=("rgba", "depth"), device=device)
    apart = np.abs(got["rgba"] - want["rgba"])
    both = np.isfinite(want["depth"]) & np.isfinite(got["depth"])
    assert (np.isfinite(want["depth"]) != np.isfinite(got["depth"])).sum() <= 1
    deep = np.abs(got["depth"][both] - want["depth"][both]).max() / want["depth"][both].mean()
    return float(apart.max()), float(np.sqrt((apart**2).mean())), float(deep)


@pytest.mark.one_in(12)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("other", MEDIA)
def test_two_media_are_the_references(device: Device, other: str, tile: str) -> None:
    with device.limited(tile=TILES[tile]):
        largest, rms, deep = errors(Scene([FIRST, MEDIA[other]]), "perspective", device)
    assert largest < 1e-5
    assert rms < 1e-6
    assert deep < 1e-5


@pytest.mark.one_in(2)
@pytest.mark.parametrize("clip", [None, Plane((-0.4, -0.7, 0.3), (11, 10, 9))])
def test_opaque_media_have_their_colors(device: Device, clip: Any) -> None:
    opaque = TransferFunction([(0, "black"), (0.5, "red")], [(0.4, 0), (0.5, 1)])
    scene = Scene([replace(FIRST, transfer=opaque), MEDIA["one grid"], replace(MEDIA["turned"], transfer=opaque)], clip=clip)
    largest, rms, deep = errors(scene, "perspective", device)
    assert largest < 1e-4
    assert rms < 1e-5
    assert deep < 1e-4


STEEP = ((0.02, 0.0), (0.08, 1.0))
GRADED = (
    replace(FIRST, gradient_opacity=STEEP),
    replace(MEDIA["one grid"], transfer=clvol.TransferFunction2D(boxes=[((0.3, 0.9), (0.02, math.inf), "teal", 0.3)])),
)


def test_media_with_gradients_are_the_references(device: Device) -> None:
    first, other = GRADED
    assert first.transfer is not None
    seen = first.with_transfer(replace(first.transfer, gradient_opacity=STEEP))
    largest, rms, deep = errors(Scene([seen, other]), "perspective", device)
    assert largest < 1e-4
    assert rms < 1e-6
    assert deep < 1e-4
    look: dict[str, Any] = {"size": SIZE, "step": 0.7, "rays": 1, "termination": 0, "device": device}
    wanted = clvol.render(Scene([seen, other]), camera("perspective"), **look)
    np.testing.assert_array_equal(clvol.render(Scene(GRADED), camera("perspective"), skipping=False, **look), wanted)


@pytest.mark.parametrize("view", ["orthographic", "wide"])
def test_all_media_are_the_references(device: Device, view: str) -> None:
    largest, rms, deep = errors(Scene([FIRST, *MEDIA.values()]), view, device)
    assert largest < 2e-3  # a sample on the face of a turned grid is in or out by rounding
    assert rms < 5e-5
    assert deep < 1e-4


SHELLS = {"surfaces": [(0.35, "bisque", 0.3), (0.6, "teal", 0.5), (0.8, "red", 1.0)], "transfer": None}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("view", ["perspective", "wide"])
def test_surfaces_among_media_are_the_references(device: Device, view: str) -> None:
    """Of the grid that leads, of another, and cut open; a crossing halfway between two samples may count for either."""
    turned = replace(MEDIA["turned"], **SHELLS, filter="bspline3", clip=CUTS["plane"])
    look = {"size": SIZE, "step": 0.7, "rays": 1, "termination": 0, "device": device}
    for media in ([FIRST, replace(MEDIA["one grid"], **SHELLS)], [FIRST, turned], [replace(FIRST, **SHELLS), turned]):
        want = render_media(Scene(media), camera(view), SIZE, 0.7)["rgba"]
        got = clvol.render(Scene(media), camera(view), **look)
        skipped = clvol.render(Scene(media[::-1]), camera(view), skipping=False, **look)
        np.testing.assert_array_equal(got, skipped)
        apart = np.abs(got - want).max(-1)
        assert (apart > 4e-4).sum() <= 4, np.sort(apart.ravel())[-8:]  # grazing rays err most, as on isosurfaces


def test_surfaces_alone_in_a_scene_are_those_of_the_mode(device: Device) -> None:
    clear = replace(MEDIA["other spacings"], transfer=TransferFunction([(0, "white")], [(0, 0)]))
    shells, look = replace(FIRST, **SHELLS), {"size": SIZE, "rays": 1, "device": device}
    want = clvol.render(replace(FIRST, transfer=None), camera("perspective"), "surfaces", surfaces=SHELLS["surfaces"], **look)
    np.testing.assert_array_equal(clvol.render(shells, camera("perspective"), **look), want)
    got = clvol.render(Scene([shells, clear]), camera("perspective"), **look)
    assert (np.abs(got - want).max(-1) > 1e-5).sum() <= 4  # two crossings within a step mix


ORGANS = Volume(5 * np.digitize(blobs(7, 10, 12, 11).data, [0.4, 0.5, 0.6]), spacing=(2.1, 1.7, 2.3), origin=(1, 2, 0), labels=True)
OPAQUE_AND_NOT = [(0, 0), (4, 0), (5, 0.4), (9, 0.4), (10, 0), (14, 0), (15, 1)]  # a label is hidden, too
SMOOTH = Medium(ORGANS, TransferFunction.preset("labels", ORGANS).with_opacity(OPAQUE_AND_NOT), smooth=True)


def test_smooth_regions_among_media_are_the_references(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Colours within 1e-3, RMS 2e-5; of another label map too, cut open with matter and alone, in slabs of any length."""
    look = {"size": (20, 15), "step": 0.9, "rays": 1, "termination": 0, "device": device}
    other = replace(SMOOTH, volume=replace(ORGANS, data=ORGANS.data[::-1, ::-1], direction=TURNED, origin=(3, 8, 1)))
    cut = Scene([FIRST, SMOOTH], clip=Plane((-0.4, -0.7, 0.3), (11, 10, 9)))
    for scene in (cut, Scene([FIRST, replace(SMOOTH, clip=Corner((8, 8, 8), (40, 40, 40))), other])):
        want = render_media(scene, camera("perspective"), (20, 15), 0.9)["rgba"]
        got = clvol.render(scene, camera("perspective"), **look)
        with monkeypatch.context() as slabs:
            slabs.setattr("clvol.march.media._BATCH", 5)
            turned = replace(scene, media=scene.media[::-1])
            np.testing.assert_array_equal(clvol.render(turned, camera("perspective"), skipping=False, **look), got)
        largest, rms = np.abs(got - want).max(), np.sqrt(((got - want) ** 2).mean())
        print(f"largest {largest:.1e}, RMS {rms:.1e}")
        assert largest < 1e-3
        assert rms < 2e-5


def test_smooth_regions_alone_are_those_of_the_mode(device: Device) -> None:
    """The face of a cut is opaque where its label is: matter behind it is not seen."""
    look: dict[str, Any] = {"size": SIZE, "clip": Plane((0.3, -1, 0.2), ORGANS.center), "device": device}
    want = clvol.render(ORGANS, camera("perspective"), "regions", transfer=SMOOTH.transfer, **look)
    for mode in ("composite", "regions"):
        got = clvol.render(SMOOTH, camera("perspective"), mode, **look)
        np.testing.assert_array_equal(got, want)
        assert got.recipe.mode.name == mode
    mirrored = replace(SMOOTH, boundary="mirror", visible=False)  # another function of the same samples
    np.testing.assert_array_equal(clvol.render(Scene([SMOOTH, mirrored]), camera("perspective"), **look), want)
    opaque = replace(SMOOTH, transfer=TransferFunction.preset("labels", ORGANS).with_opacity([(4, 0), (5, 1)]))
    alone, among = (clvol.render(Scene(media), camera("perspective"), **look) for media in (opaque, [opaque, MEDIA["turned"]]))
    hidden = (np.abs(alone - among).max(-1) < 1e-3) & (alone[..., :3].max(-1) > 0)
    assert hidden.sum() > 200, hidden.sum()


def test_the_order_changes_no_bit(device: Device) -> None:
    media = [FIRST, *MEDIA.values(), replace(FIRST, volume=MEDIA["one grid"].volume), replace(FIRST, **SHELLS)]
    want = clvol.render(Scene(media), camera("perspective"), size=SIZE, device=device)
    for turn in (1, 3):
        turned = media[turn:] + media[:turn]
        np.testing.assert_array_equal(clvol.render(Scene(turned[::-1]), camera("perspective"), size=SIZE, device=device), want)


def test_no_bit_depends_on_skipping(device: Device) -> None:
    scene = Scene([FIRST, *MEDIA.values()])
    with clvol.Renderer(scene, device=device) as renderer:
        want = renderer.render(camera("perspective"), size=SIZE)
        np.testing.assert_array_equal(renderer.render(camera("perspective"), size=SIZE, skipping=False), want)


@pytest.mark.parametrize("rays", ["auto", 4])
def test_pictures_of_many_areas(device: Device, rays: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene([FIRST, MEDIA["turned"]])
    want = clvol.render(scene, camera("perspective"), size=(70, 50), rays=rays, device=device)
    monkeypatch.setattr("clvol.march.media._ROOM", {"cpu": 1, "gpu": 1})  # a tile at a time
    monkeypatch.setattr("clvol.march.media._BATCH", 5)
    got = clvol.render(scene, camera("perspective"), size=(70, 50), rays=rays, device=device)
    np.testing.assert_allclose(got, want, atol=1e-3)  # what `termination` leaves


def test_media_without_opacity_change_nothing(device: Device) -> None:
    clear = TransferFunction([(0, "white")], [(0, 0)])
    one = replace(FIRST, transfer=soft("red", 0.3))
    want = clvol.render(Scene(one), camera("perspective"), size=SIZE, device=device)
    for other in MEDIA.values():
        if other.volume.mean_spacing > one.volume.mean_spacing:  # whose planes do not lead
            scene = Scene([replace(other, transfer=clear), one])
            np.testing.assert_allclose(clvol.render(scene, camera("perspective"), size=SIZE, device=device), want, atol=2e-6)
    hidden = Scene([one, replace(MEDIA["turned"], visible=False)])
    np.testing.assert_array_equal(clvol.render(hidden, camera("perspective"), size=SIZE, device=device), want)


CUTS = {
    "whole": None,
    "box": ((4, 4, 4), (18, 15, 16)),
    "plane": Plane((-0.4, -0.7, 0.3), (11, 10, 9)),
    "corner": Corner((10, -math.inf, 9), (math.inf, 11, math.inf)),
}


ALIKE: dict[str, Any] = {
    "two": ((FIRST, replace(MEDIA["turned"], filter="bspline3")), None, "auto"),
    "three, cut": (
        (FIRST, *(replace(MEDIA[name], filter="bspline3", clip=CUTS["corner"]) for name in ("one grid", "other spacings"))),
        CUTS["plane"],
        3,
    ),
    "missing": (
        tuple(
            replace(medium, filter="bspline3", mask=np.indices(medium.volume.shape)[0] < 4) for medium in (FIRST, MEDIA["turned"])
        ),
        None,
        1,
    ),
}


@pytest.mark.one_in(10)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("case", ALIKE)
def test_media_of_one_kind_are_drawn_together_to_the_bit(
    device: Device, case: str, tile: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By one kernel, as by kernels of their own."""
    media, clip, rays = ALIKE[case]
    look: dict[str, Any] = {"size": (90, 70), "step": 0.7, "rays": rays, "device": device, "outputs": ("rgba", "depth")}
    with device.limited(tile=TILES[tile]):
        together = clvol.render(Scene(media, clip=clip), camera("perspective"), **look)
        monkeypatch.setattr(Frame, "together", False)
        apart = clvol.render(Scene(media[::-1], clip=clip), camera("perspective"), **look)
    for name, picture in together.items():
        np.testing.assert_array_equal(picture, apart[name])
    assert np.ptp(together["rgba"][..., 0]) > 0.3


@pytest.mark.parametrize("clip", CUTS)
def test_extinctions_add(device: Device, clip: str) -> None:
    """Two media of opacity 1 - sqrt(1 - a) are one of opacity a, on the faces of cuts too."""
    points = np.linspace(0, 1, 129)
    whole = [(v, 0.3 * v**2) for v in points]
    half = [(v, 1 - math.sqrt(1 - a)) for v, a in whole]
    one, two = (replace(FIRST, transfer=TransferFunction([(0, "white")], points)) for points in (whole, half))
    got, want = (
        clvol.render(Scene(media, clip=CUTS[clip]), camera("perspective"), size=SIZE, rays=1, device=device)
        for media in ([two, two], one)
    )
    np.testing.assert_allclose(got, want, atol=2e-5)


OWN: dict[str, Any] = {
    "plane": CUTS["plane"],
    "box": CUTS["box"],
    "all": [Plane((-0.4, -0.7, 0.3), (11, 8, 9)), ((2, 2, 1), (22, 19, 18)), CUTS["corner"]],
}
CUT = Plane((0, -1, 0.2), (0, 6, 0))


@pytest.mark.one_in(27)
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("other", ["one grid", "turned", "a slice"])
@pytest.mark.parametrize("own", OWN)
def test_media_that_are_cut_alone_are_the_references(device: Device, own: str, other: str, view: str) -> None:
    """Within 1e-5; of rays that step along themselves 40 may meet a face of a turned grid by rounding."""
    scene = Scene([replace(FIRST, clip=OWN[own]), replace(MEDIA[other], boundary="constant")], clip=CUT)
    want = render_media(scene, camera(view), SIZE, 0.7)["rgba"]
    look = {"size": SIZE, "step": 0.7, "rays": 1, "device": device}
    for tile in TILES.values():
        with device.limited(tile=tile):
            got = clvol.render(scene, camera(view), termination=0, **look)
            unskipped = clvol.render(scene, camera(view), termination=0, skipping=False, **look)
        np.testing.assert_array_equal(unskipped, got)
        apart = np.abs(got - want).max(-1)
        assert (apart > 1e-5).sum() <= (40 if view == "wide" else 0), apart.max()
        assert apart.max() < 2e-3
    uncut = clvol.render(replace(scene, media=(FIRST, scene.media[1])), camera(view), termination=0, **look)
    assert (np.abs(uncut - want).max(-1) > 0.02).sum() > 30


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
def test_a_cut_of_each_medium_is_one_of_the_scene(device: Device, mode: str) -> None:
    look: dict[str, Any] = {"mode": mode, "size": SIZE, "device": device} | ({"cap": True} if mode == "isosurface" else {})
    for media in ([FIRST], [FIRST, MEDIA["turned"]]):
        want = clvol.render(Scene(media, clip=OWN["all"]), camera("perspective"), **look)
        own = Scene([replace(medium, clip=OWN["all"]) for medium in media])
        np.testing.assert_array_equal(clvol.render(own, camera("perspective"), **look), want)
        half = Scene([replace(medium, clip=OWN["all"][:1]) for medium in media], clip=OWN["all"][1:])
        np.testing.assert_array_equal(clvol.render(half, camera("perspective"), **look), want)


def test_a_shell_is_cut_open_and_what_is_in_it_is_not(device: Device) -> None:
    """The core is seen as without the shell where the plane takes the shell away in front of it; in surfaces too."""
    z, y, x = np.mgrid[:32, :32, :32] - 15.5
    ball = Volume(np.float32(14 - np.sqrt(x**2 + y**2 + z**2)))
    shell = Medium(ball, TransferFunction([(0, "white")], [(0, 0), (1, 1), (3, 1), (4, 0)]))
    core = Medium(ball, TransferFunction([(0, "red")], [(7, 0), (8, 1)]))
    open_ = Plane((0, -1, 0), (15.5, 15.5, 15.5))
    view = Camera.orbit(0, 0, target=(15.5, 15.5, 15.5), radius=16)
    look: dict[str, Any] = {"size": (64, 64), "rays": 1, "outputs": ("rgba", "depth"), "device": device}
    alone = clvol.render(Scene(core, background=None), view, **look)
    together = clvol.render(Scene([replace(shell, clip=open_), core]), view, **look)
    inner = alone["rgba"][..., 3] > 0.99
    assert 150 < inner.sum() < 1500
    np.testing.assert_allclose(together["depth"][inner], alone["depth"][inner], atol=0.5)
    np.testing.assert_allclose(together["rgba"][inner], alone["rgba"][inner], atol=0.02)
    closed = clvol.render(Scene([shell, core]), view, **look)
    assert closed["depth"][32, 32] < together["depth"][32, 32] - 4
    rim = (np.abs(together["rgba"][..., :3] - 1) < 1e-3).all(-1)  # the face of the cut, unlit white
    assert rim.sum() > 100
    cap = {"mode": "isosurface", "isovalue": 1, "cap": "lime", "size": (64, 64), "device": device}
    whole = Medium(Volume(ball.data, origin=(0, 3, 0), color="red"))  # which goes on in front of the cap
    halved = replace(shell, clip=open_)
    half, both = (clvol.render(Scene(media), view, **cap) for media in ([halved], [halved, whole]))
    lime = (half[..., 1] > 0.99) & (half[..., 0] < 0.01)
    assert lime.sum() > 1000
    assert (both[lime][:, 0] > 0.05).mean() > 0.9


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", ["mip", "mean"])
def test_projections_add(device: Device, mode: str) -> None:
    red, green = (Medium(blobs(seed, 20, 22, 24, color=color)) for seed, color in ((1, "red"), (2, "lime")))
    got, *alone = (
        clvol.render(Scene(media), camera("perspective"), mode=mode, size=SIZE, background=None, device=device)
        for media in ([red, green], red, green)
    )
    np.testing.assert_allclose(got[..., :3], np.clip(alone[0][..., :3] + alone[1][..., :3], 0, 1), atol=1e-6)
    over = clvol.render(Scene([red, green], mix="over"), camera("perspective"), mode=mode, size=SIZE, device=device)
    np.testing.assert_allclose(over[..., 1], (1 - alone[0][..., 0]) * alone[1][..., 1], atol=1e-6)


def test_the_nearest_surface_is_seen(device: Device) -> None:
    z, y, x = np.mgrid[:24, :24, :24]
    balls = [Volume(np.float32(8 - np.hypot(np.hypot(x - at, y - 12), z - 12)), color=c) for at, c in ((7, "red"), (15, "lime"))]
    look = {"mode": "isosurface", "size": SIZE, "isovalue": 1.0, "outputs": ("rgba", "depth"), "device": device}
    together = clvol.render(Scene([Medium(ball) for ball in balls]), Camera.orbit(70, 0, target=(11, 12, 12), radius=15), **look)
    alone = [clvol.render(ball, Camera.orbit(70, 0, target=(11, 12, 12), radius=15), **look) for ball in balls]
    nearest = np.fmin(*(one["depth"] for one in alone))
    np.testing.assert_array_equal(together["depth"], nearest)
    assert (np.isfinite(alone[0]["depth"]) & np.isfinite(alone[1]["depth"])).sum() > 50


@pytest.mark.parametrize("mode", ["mip", "composite"])
def test_channels_have_colors(device: Device, mode: str) -> None:
    data = np.stack([blobs(seed, 20, 22, 24).data for seed in (1, 2, 3)])
    volumes = clvol.Volumes(data[None], leading=Leading(("time", "channel"), (1, 3), colors=(None, "red", None)), spacing=(1, 1, 2))
    look: dict[str, Any] = {"mode": mode, "size": SIZE, "device": device}
    colors = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    want = Scene([Medium(Volume(one, (1, 1, 2), color=color), filter="linear") for one, color in zip(data, colors, strict=True)])
    np.testing.assert_array_equal(clvol.render(volumes, filter="linear", **look), clvol.render(want, **look))
    assert clvol.Renderer(volumes).filter.name.startswith("bspline3")


def test_volumes_that_are_no_channels() -> None:
    with pytest.raises(DataError, match="must be one volume or the channels of one; got Volumes of 3 volumes"):
        clvol.render(clvol.Volumes(np.zeros((3, 4, 5, 6)), leading=Leading(("volume",), (3,))))


def test_channels_of_images_and_of_times(device: Device) -> None:
    """An image is a slice; of several times the first is shown, and said."""
    data = np.random.default_rng(3).random((2, 2, 9, 12)).astype(np.float32)
    look: dict[str, Any] = {"mode": "mip", "size": SIZE, "filter": "linear", "device": device}
    flat = clvol.render(clvol.Volumes(data[0], leading=Leading(("channel",), (2,))), **look)
    deep = clvol.render(clvol.Volumes(data[0, :, None], leading=Leading(("channel",), (2,)), space="image"), **look)
    np.testing.assert_array_equal(flat, deep)
    with pytest.warns(ClvolWarning, match="data holds 2 times; the first of them is shown"):
        np.testing.assert_array_equal(clvol.render(clvol.Volumes(data, leading=Leading(("time", "channel"), (2, 2))), **look), flat)


def test_labels_say_where_a_medium_is(device: Device) -> None:
    labels = np.zeros(FIRST.volume.shape, np.uint8)
    labels[:, :, 12:] = 3
    some = Medium(FIRST.volume, FIRST.transfer, filter="bspline3", mask=labels, where=3)
    masked = Medium(FIRST.volume, FIRST.transfer, filter="bspline3", mask=labels != 3)
    look = {"camera": camera("perspective"), "size": SIZE, "device": device}
    want = clvol.render(Scene(masked), **look)
    np.testing.assert_array_equal(clvol.render(Scene(some), **look), want)
    assert not np.array_equal(clvol.render(Scene(FIRST), **look), want)
    two = clvol.render(Scene([some, Medium(FIRST.volume, FIRST.transfer, filter="bspline3", mask=labels, where=[0])]), **look)
    whole = clvol.render(Scene(FIRST), **look)
    assert np.abs(two - whole).mean() < 0.01  # but where the halves meet, which each continues by itself


def test_refined_pictures_end_with_the_whole_one(device: Device) -> None:
    for mode in ("composite", "mip"):
        with clvol.Renderer(Scene([FIRST, MEDIA["turned"]]), device=device) as renderer:
            *_, last = renderer.refine(camera("perspective"), mode, (80, 60))
            np.testing.assert_array_equal(last, renderer.render(camera("perspective"), mode, (80, 60)))


def lazy(medium: Medium, **changes: Any) -> Medium:
    """A medium that is read by bricks."""
    volume: Any = LazyVolume(
        medium.volume.data, **{name: getattr(medium.volume, name) for name in ("spacing", "origin", "direction", "labels")}
    )
    return replace(medium, volume=volume, **changes)


def small_bricks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.bricks.field.edge_for", lambda *_, **_options: 8)


HOLED = np.where(np.random.default_rng(3).random((18, 12, 22)) < 0.02, np.nan, MEDIA["turned"].volume.data)
OPAQUE = {"surfaces": [(0.4, "red", 0.4), (0.55, "white", 1.0)], "transfer": None}
BRICKED: dict[str, tuple[Medium, ...]] = {
    "matter": (replace(FIRST, filter="catmull-rom"), MEDIA["one grid"], MEDIA["turned"]),
    "surfaces": (replace(FIRST, filter="bspline3-approx", **OPAQUE), replace(MEDIA["turned"], filter="nearest", **OPAQUE)),
    "cut, and some missing": (
        replace(FIRST, filter="linear", clip=Corner((8, 8, 8), (40, 40, 40))),
        replace(MEDIA["turned"], volume=replace(MEDIA["turned"].volume, data=HOLED)),
    ),
    "gradients": GRADED,
    "smooth regions": (replace(FIRST, filter="linear"), replace(SMOOTH, clip=Corner((8, 8, 8), (40, 40, 40)))),
}


@pytest.mark.one_in(9)
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("case", BRICKED)
def test_bricks_change_no_bit(case: str, view: str, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    small_bricks(monkeypatch)
    first, *others = BRICKED[case]
    look: dict[str, Any] = {
        "clip": Plane((1, 0.3, 0.2), (16, 11, 10)),
        "rays": "auto",
        "outputs": ("rgba", "depth"),
        "device": device,
    }
    want = clvol.render(Scene([first, *others]), camera(view), size=SIZE, **look)
    for media in ([lazy(first), *others], [first, *map(lazy, others)], [*map(lazy, others[::-1]), lazy(first)]):
        got = clvol.render(Scene(media), camera(view), size=SIZE, **look)
        for name in want:
            np.testing.assert_array_equal(got[name], want[name], name)
    assert want["rgba"].any()


def test_by_bricks_projections_looks_and_pickles(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    small_bricks(monkeypatch)
    media = MEDIA["one grid"], MEDIA["turned"]
    with clvol.Renderer(Scene(list(map(lazy, media))), device=device, memory=1 << 22) as renderer:
        want = clvol.render(Scene(media), camera("wide"), "mip", SIZE, device=device)
        np.testing.assert_array_equal(renderer.render(camera("wide"), "mip", SIZE), want)
        *_, last = renderer.refine(camera("wide"), size=SIZE)
        np.testing.assert_array_equal(last, renderer.render(camera("wide"), size=SIZE, skipping=False))
        hidden = [replace(renderer.scene.media[0], visible=False), lazy_of(renderer, 1)]
        np.testing.assert_array_equal(renderer.render(size=SIZE, media=hidden), clvol.render(media[1], size=SIZE, device=device))
        again = pickle.loads(pickle.dumps(renderer))
        np.testing.assert_array_equal(again.render(camera("wide"), size=SIZE), last)
        again.close()
    alone = lazy(media[1])
    np.testing.assert_array_equal(clvol.render(alone, size=SIZE, device=device), clvol.render(media[1], size=SIZE, device=device))


def lazy_of(renderer: clvol.Renderer, number: int) -> Medium:
    """A medium as it was given, of the volume that is read by bricks."""
    (asked, *_), _ = renderer._source.recipe()
    return asked.media[number]


def test_each_medium_has_a_level_of_its_own(device: Device) -> None:
    fine = Volume(gaussian_filter(np.random.default_rng(4).normal(size=(32, 32, 32)), 2).astype(np.float32))
    coarse = Volume(fine.data[::2, ::2, ::2], (2, 2, 2), (0.5, 0.5, 0.5))
    levels = LazyVolume(fine.data, levels=[LazyVolume(coarse.data, coarse.spacing, coarse.origin)])
    look = TransferFunction([(0, "white")], [(0, 0), (0.1, 0.2)], unit_distance=1.0)
    media = Medium(fine, look, filter="linear"), Medium(levels, look, filter="linear"), Medium(coarse, look, filter="linear")  # type: ignore[arg-type]
    own = Medium(Volume(np.zeros((8, 8, 8), np.float32), spacing=(4, 4, 4)), soft("red", 0.5), filter="linear")
    view = Camera.orbit(target=fine.center, radius=30)  # type: ignore[arg-type]  # three
    fine_one, of_levels, coarse_one = (Scene([medium, own]) for medium in media)
    for lod, want in ((0.0, fine_one), (8.0, coarse_one)):
        got = clvol.render(of_levels, view, size=SIZE, lod=lod, device=device)
        assert np.abs(got - clvol.render(want, view, size=SIZE, device=device)).max() < 1e-6
    with clvol.Renderer(of_levels, device=device) as renderer:
        pictures = list(renderer.refine(view, size=SIZE, lod=0.0))
    assert [picture.final for picture in pictures] == [False, True]


TWO = Scene([FIRST, MEDIA["one grid"]])
REFUSED: dict[str, tuple[Any, str]] = {
    "a transfer function of which": (lambda: clvol.render(TWO, transfer=soft("red", 0.1)), "transfer must be left to the media"),
    "a colour map of which": (lambda: clvol.render(TWO, cmap="bone"), "cmap must be left to the media of a scene"),
    "normals of which": (lambda: clvol.render(TWO, outputs="normal"), "normal of several media in composite would be of which"),
    "the depth of a sum": (lambda: clvol.render(TWO, mode="mip", outputs="depth"), "depth of several media in mip"),
    "nothing visible": (
        lambda: clvol.render(Scene([replace(medium, visible=False) for medium in TWO.media])),
        "none of the scene's 2 is visible",
    ),
    "factors of projections": (
        lambda: clvol.render(replace(FIRST, gradient_opacity=STEEP), mode="mip"),
        "gradient_opacity changes nothing in mip: it is of matter",
    ),
    "a mix of matter": (lambda: clvol.render(replace(TWO, mix="over")), 'mix="over" changes nothing in composite'),
    "surfaces of a projection": (
        lambda: clvol.render(Scene([FIRST, replace(FIRST, **SHELLS)]), mode="mip"),
        "surfaces of a medium change nothing in mip",
    ),
    "surfaces and a transfer function": (lambda: Medium(FIRST.volume, cmap="bone", **SHELLS), "cmap must be left out"),
    "smooth boundaries of a projection": (
        lambda: clvol.render(Scene([FIRST, SMOOTH]), mode="mip"),
        "smooth boundaries of a medium change nothing in mip",
    ),
    "smooth matter": (lambda: clvol.render(replace(FIRST, smooth=True, filter=None)), "takes labels, like smooth=True"),
    "smooth surfaces": (lambda: Medium(ORGANS, smooth=True, color_by=ORGANS, **SHELLS), "takes no surfaces and color_by"),
    "a mask of smooth labels": (lambda: Medium(ORGANS, smooth=True, mask=ORGANS.data, where=5), "takes no mask"),
    "smooth by a prefilter": (lambda: clvol.render(replace(SMOOTH, filter="bspline3")), "without a prefilter: linear"),
    "smooth and central": (
        lambda: clvol.render(Scene([FIRST, SMOOTH]), gradient="central"),
        "gradient changes nothing with smooth",
    ),
    "regions of several": (lambda: clvol.render(Scene([FIRST, SMOOTH]), mode="regions"), r"Medium\(labels, smooth=True\)"),
    "shadows of smooth labels": (lambda: clvol.render(SMOOTH, shadow=0.5), "shadow changes nothing in regions"),
    "caps of smooth labels alone": (lambda: clvol.render(replace(SMOOTH, clip=CUTS["plane"]), cap=False), "cap changes nothing"),
    "a boundary that was none": (
        lambda: clvol.Renderer(SMOOTH).render(media=[replace(SMOOTH, boundary="mirror")]),
        "media must be the scene's",
    ),
    "less smooth": (
        lambda: clvol.render(Scene([FIRST, SMOOTH]), media=[FIRST, replace(SMOOTH, smooth=False)]),
        "media must be the scene's",
    ),
    "surfaces that are none": (lambda: Medium(FIRST.volume, surfaces="0.5"), "a surface must be"),
    "too little memory": (lambda: clvol.Renderer(Scene([lazy(FIRST), FIRST]), memory=1000), "memory must be"),
    "another volume": (lambda: clvol.render(TWO, media=[lazy(FIRST), TWO.media[1]]), "media must be the scene's"),
    "levels of one size": (lambda: clvol.render(Scene([lazy(FIRST), FIRST]), lod=2.0), "lod changes nothing"),
    "a mask for which": (lambda: clvol.Renderer(TWO, mask=np.zeros((20, 22, 24), bool)), "mask must be left to the media"),
    "a cap where nothing is cut": (lambda: clvol.render(TWO, mode="isosurface", cap=True), "nothing is cut away by clip"),
    "uncertainty": (lambda: clvol.render(TWO, mode="isosurface", outputs="uncertainty"), "takes a scene of one medium"),
}


def test_cuts_of_a_medium_count_with_the_scenes() -> None:
    five = [Corner((i, 0, 0), (i + 1, 1, 1)) for i in range(5)]
    with pytest.raises(GeometryError, match=r"up to 64 planes and 8 corners; got 0 and 10"):
        Scene(Medium(np.zeros((4, 4, 4)), clip=five), clip=five)
    with pytest.raises(GeometryError, match="clip must be two corners"):
        Medium(np.zeros((4, 4, 4)), clip=3)


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(case: str) -> None:
    make, message = REFUSED[case]
    with pytest.raises(ClvolError, match=message) as caught:
        make()
    assert isinstance(caught.value, OptionError)


@pytest.mark.parametrize("channels", [3, 4])
def test_colors_of_a_file_are_shown_as_they_are(channels: int, device: Device) -> None:
    """Maxima of red, green and blue, without alpha; of a dim picture too."""
    colored = np.random.default_rng(2).integers(0, 90, (channels, 5, 6, 7)).astype(np.uint8)
    volumes = clvol.Volumes(colored, leading=Leading.of_rgb(channels))
    camera = clvol.Camera(direction=(0, 0, 1), up=(0, -1, 0), projection="orthographic", fit="volume")
    got = clvol.render(volumes, camera, "mip", (70, 60), filter="nearest", device=device, rays=1)
    seen = np.unique(np.round(255 * np.asarray(got[..., :3])).astype(int).reshape(-1, 3), axis=0)
    want = np.unique(colored[:3].max(1).reshape(3, -1).T, axis=0)
    assert {tuple(row) for row in seen.tolist()} - {(0, 0, 0)} == {tuple(row) for row in want.tolist()}


def test_media_that_may_not_be_meant_for_each_other_are_said(device: Device) -> None:
    ball = clvol.phantoms.sphere(8).data
    with pytest.raises(GeometryError, match="must be in one unit; got volumes in mm and um"):
        Scene([Volume(ball, units="mm"), Volume(ball, units="um")])
    with pytest.warns(ClvolWarning, match=r"medium 1 of a scene overlaps no other: it spans \(99.5, -0.5, -0.5\) to"):
        Scene([Volume(ball), Volume(ball, origin=(100, 0, 0))])
    with pytest.warns(ClvolWarning, match="in 2 DICOM frames of reference"):
        Scene([Volume(ball, header={"frame_of_reference": uid}) for uid in ("1.2", "1.3")])
    with pytest.raises(DataError, match="medium 1 of the scene: samples must be finite"):
        clvol.render(Scene([ball, np.full((4, 4, 4), np.nan)]), device=device)
    with pytest.warns(ClvolWarning, match="of a medium of the scene: the picture shows no structure: all samples are 5"):
        clvol.render(Scene([ball, np.full((8, 8, 8), 5.0)]), size=(16, 16), device=device)


def test_words_of_a_medium_are_those_of_a_picture(device: Device) -> None:
    ball = clvol.phantoms.sphere(10)
    words: dict[str, Any] = {"cmap": "magma", "opacity": 0.4, "window": (0.2, 0.5)}
    given: dict[str, Any] = {"size": (20, 16), "device": device}
    for mode in ("composite", "mip"):
        own = words if mode == "composite" else {name: value for name, value in words.items() if name != "opacity"}
        want = clvol.render(ball, None, mode, **given, **own)
        np.testing.assert_array_equal(clvol.render(Medium(ball, **words), None, mode, **given), want)
        other = clvol.render(Medium(ball, **words), None, mode, **given, cmap="viridis")  # in place of all of the medium's
        np.testing.assert_array_equal(other, clvol.render(ball, None, mode, **given, cmap="viridis"))
    transfer = clvol.scene.look.look(ball, "composite", **words)
    both = [Scene([Medium(ball, **look), Medium(ball, preset="mr-default")]) for look in (words, {"transfer": transfer})]
    pictures = [clvol.render(scene, **given) for scene in both]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(clvol.view.View(Medium(ball, **words)).picture((20, 16)), clvol.render(ball, **given, **words))
    with pytest.raises(OptionError, match="transfer must be left out where cmap say what it is"):
        Medium(ball, transfer, cmap="gray")
    with pytest.raises(OptionError, match=r"cmap must be left to the media of a scene of several: Medium\(..., cmap=...\)"):
        clvol.render(both[0], cmap="gray", **given)
