"""Pictures of what planes, boxes and corners leave, with the slice on the faces of the cuts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import dask.array as da
import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import BrickedField, Camera, Composite, Corner, Isosurface, LazyVolume, Plane, Renderer, TransferFunction, Volume
from clvol.base.errors import ClvolWarning, GeometryError, OptionError
from clvol.device import Device
from clvol.reference.march import march as reference
from clvol.scene.clip import Cuts, cuts_of
from tests import cases
from tests.march.looks import TILES

INF = math.inf
SIZE = (40, 36)
TRANSFER = TransferFunction(((0.0, "navy"), (0.5, "orange"), (1.0, "white")), ((0.2, 0.0), (0.5, 0.1), (1.0, 0.9)))
MODES: dict[str, tuple[str, dict[str, Any]]] = {
    "composite": ("composite", {"termination": 0.0, "transfer": TRANSFER}),
    "without faces": ("composite", {"termination": 0.0, "transfer": TRANSFER, "cap": False}),
    "slices, unlit matter": ("composite", {"termination": 0.0, "transfer": TRANSFER, "shading": False, "cap": True}),
    "surface": ("isosurface", {"isovalue": 0.5}),
    "cap of values": ("isosurface", {"isovalue": 0.5, "cap": True, "transfer": TRANSFER}),
    "colored cap": ("isosurface", {"isovalue": 0.5, "cap": "red", "shading": False}),
    "surfaces": ("surfaces", {"surfaces": "0.3:tan:0.4,0.5:teal:0.5,0.7:red:0.7"}),
    "surfaces, capped": ("surfaces", {"surfaces": "0.4:tan:0.4,0.7:red:0.7", "cap": True, "transfer": TRANSFER}),
    "stepped, capped": ("isosurface", {"isovalue": 0.5, "cap": True, "method": "stepped"}),
    "mip": ("mip", {}),
    "minip": ("minip", {}),
    "attenuated": ("attenuated", {}),
    "mean": ("mean", {}),
}
CAMERAS = {
    "across": Camera.orbit(25, 35, fit="volume"),
    "orthographic": Camera.orbit(-62, 13, projection="orthographic", fit="volume"),
    "wide": Camera.orbit(40, -30, fov=120, fit="volume"),  # some rays step along themselves
}


def bumps(n: int = 18, turn: float = 0.3) -> Volume:
    """Smooth lumps in a turned grid of unequal spacing."""
    z, y, x = np.mgrid[:n, : n + 3, : n - 2] / n
    data = (0.5 + 0.3 * np.sin(7 * x + 2 * y) * np.cos(5 * y - z) + 0.2 * np.sin(9 * z)).astype(np.float32)
    c, s = math.cos(turn), math.sin(turn)
    return Volume(data, (1.0, 0.9, 1.2), (3, -2, 5), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


VOLUME = bumps()
X, Y, Z = (float(v) for v in VOLUME.center)
CLIPS: dict[str, Any] = {
    "plane": Plane((1.0, 0.4, 0.7), (X + 1.13, Y, Z)),
    "two planes and a box": [
        Plane((-1, -1, 0), (X - 3.1, Y - 1.2, Z)),
        Plane((0.2, 0, -3), (X, Y, Z - 4.3)),
        ((X - 6.2, -INF, Z - 9), (INF, Y + 6.3, Z + 7.17)),
    ],
    "octant": Corner((X + 0.21, Y - 0.47, Z + 0.33), (INF, INF, INF)),
    "corners that overlap": [
        Corner((X - 3.3, -INF, -INF), (X + 2.9, INF, Z + 2.3)),
        Corner((-INF, Y - 2.2, Z - 3.4), (INF, Y + 3.1, INF)),
    ],
    "everything": [
        Plane((1.0, 0.4, 0.7), (X + 3.13, Y, Z)),
        ((X - 7.2, -INF, Z - 9), (INF, Y + 7.3, Z + 8.17)),
        Corner((X - 1.3, Y - 1.7, -INF), (X + 1.1, Y + 1.4, INF)),
        Corner((X + 2.2, -INF, Z + 1.1), (INF, INF, INF)),
    ],
}


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[Renderer]:
    with Renderer(VOLUME, "bspline3", device=device) as made:
        yield made


def drawn(renderer: Renderer, case: str, view: str, clip: Any, **more: Any) -> Any:
    mode, options = MODES[case]
    return renderer.render(CAMERAS[view], mode, SIZE, clip=clip, rays=1, step=0.37, background=None, **options, **more)


@pytest.mark.one_in(105)
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("case", MODES)
def test_parity_with_the_reference(renderer: Renderer, case: str, clip: str, view: str) -> None:
    """RMS 2e-4 and greatest 3e-3 of premultiplied colours, but for rays that graze the edge of a cut or of a surface: 1 %."""
    mode, options = MODES[case]
    want = reference.render(
        VOLUME,
        CAMERAS[view],
        mode,
        "bspline3",
        size=SIZE,
        step=0.37,
        clip=CLIPS[clip],
        rays=1,
        background=None,
        outputs=("rgba", "normal"),
        **options,
    )
    guides = want["normal"], np.isfinite(want["normal"]).all(-1)
    want = want["rgba"]
    for tile in TILES.values():
        with renderer.device.limited(tile=tile):
            made = drawn(renderer, case, view, CLIPS[clip], outputs=("rgba", "normal"))
        got, turned = np.asarray(made["rgba"], np.float64), np.abs(made["normal"] - guides[0])[guides[1]].max(-1)
        assert (~(turned <= 0.01)).sum() <= 0.02 * turned.size
        off = np.abs(got[..., :3] * got[..., 3:] - want[..., :3] * want[..., 3:]).max(-1) + np.abs(got[..., 3] - want[..., 3])
        near = off <= 3e-3
        assert (~near).mean() <= 0.01, (off.max(), (~near).sum())
        assert np.sqrt((off[near] ** 2).mean()) <= 2e-4
        assert want[..., 3].max() > 0.5


@pytest.mark.one_in(66)
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("case", MODES)
def test_skipping_and_bricks_change_no_bit(device: Device, case: str, clip: str) -> None:
    mode, options = MODES[case]
    outputs = ("rgba", "depth", "normal", "position")
    with (
        Renderer(VOLUME, "linear", device=device) as whole,
        BrickedField(VOLUME, "linear", edge=8, device=device) as field,
        Renderer(field) as bricked,
    ):
        for view in CAMERAS.values():
            look = {"size": SIZE, "clip": CLIPS[clip], "rays": 1, "outputs": outputs, **options}
            want = whole.render(view, mode, **look)
            for got in (whole.render(view, mode, skipping=False, **look), bricked.render(view, mode, **look)):
                for name in outputs:
                    np.testing.assert_array_equal(got[name], want[name], err_msg=name)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("case", ["composite", "cap of values"])
def test_faces_have_holes_where_samples_are_missing(device: Device, case: str) -> None:
    """As in the reference: within 1e-3, but for a pixel at the edge of the hole."""
    data = VOLUME.data.copy()
    z, y, x = np.indices(data.shape)
    data[(x - 8) ** 2 + (y - 9) ** 2 + (z - 9) ** 2 < 16] = np.nan
    holes = replace(VOLUME, data=data)
    mode, options = MODES[case]
    look: dict[str, Any] = {"size": SIZE, "step": 0.37, "clip": CLIPS["everything"], "rays": 1, **options}
    got = np.asarray(clvol.render(holes, CAMERAS["across"], mode, filter="bspline3", device=device, **look), np.float64)
    want = reference.render(holes, CAMERAS["across"], mode, "bspline3", **look)
    assert (np.abs(got - want).max(-1) > 1e-3).sum() <= 1
    whole = clvol.render(VOLUME, CAMERAS["across"], mode, filter="bspline3", device=device, **look)
    assert (np.abs(got - whole).max(-1) > 0.05).sum() > 20


def untouched(view: Camera, clip: Any) -> NDArray[np.bool_]:
    """Pixels whose rays keep everything, by points along them; those whose ray misses the volume too."""
    volume = VOLUME
    rays = reference.camera_rays(volume, view.view(volume, SIZE[0] / SIZE[1]), SIZE)
    t = rays.enter[:, None] + np.linspace(0, 1, 400) * (rays.leave - rays.enter)[:, None]
    points = rays.origin[:, None] + t[..., None] * rays.direction[:, None]
    kept = cuts_of(clip).keep(points).all(1) | (rays.enter > rays.leave)
    return np.asarray(kept.reshape(SIZE[::-1]))


@pytest.mark.one_in(8)
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("clip", CLIPS)
def test_no_other_pixel_changes_by_a_bit(renderer: Renderer, clip: str, view: str) -> None:
    kept = untouched(CAMERAS[view], CLIPS[clip])
    assert kept.any()
    for case in MODES:
        options = {"background": None, "rays": 1} | {name: value for name, value in MODES[case][1].items() if name != "cap"}
        if "transfer" in options and MODES[case][0] in ("isosurface", "surfaces"):
            del options["transfer"]
        plain = renderer.render(CAMERAS[view], MODES[case][0], SIZE, step=0.37, **options)
        cut = drawn(renderer, case, view, CLIPS[clip])
        np.testing.assert_array_equal(cut[kept], plain[kept], err_msg=case)
        assert (cut[~kept] != plain[~kept]).any()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", cases.MODES)
def test_cuts_that_cut_nothing_change_no_bit(renderer: Renderer, mode: str) -> None:
    """Beside the volume, and on its faces, where rounding decides."""
    grid = Volume(VOLUME.data)
    high = tuple(n - 0.5 for n in grid.size)
    clip = [
        Plane((1, 0, 0), (high[0], 0, 0)),
        Plane((-1, -1, -1), (-9, 0, 0)),
        Corner((-9, -9, -9), (-0.5, 99, 99)),
        Corner((-9, high[1], -9), (99, 99, 99)),
        ((-0.5, -0.5, -0.5), high),
    ]
    with Renderer(grid, device=renderer.device) as flat:
        for view in (Camera.orbit(0, 0, projection="orthographic", fit="volume"), Camera.orbit(40, -30, fit="volume")):
            look: dict[str, Any] = {"size": SIZE, "rays": 1}
            capped = {"cap": True} if mode in ("composite", "isosurface", "surfaces") else {}
            want = flat.render(view, mode, **look)
            np.testing.assert_array_equal(flat.render(view, mode, clip=clip, **capped, **look), want)


def test_the_camera_stays_for_planes_and_corners(renderer: Renderer) -> None:
    """Only a box is what the camera is fitted to."""
    plain = renderer.render(mode="isosurface", size=SIZE, rays=1, outputs="position")
    for clip in (CLIPS["plane"], CLIPS["octant"]):
        cut = renderer.render(mode="isosurface", size=SIZE, rays=1, outputs="position", clip=clip)
        same = (cut == plain).all(-1)
        assert same.mean() > 0.05


def distance_from_the_middle(n: int = 32) -> Volume:
    """In voxels, and so a value that every place has in closed form."""
    return Volume(np.linalg.norm(np.mgrid[:n, :n, :n] - (n - 1) / 2, axis=0).astype(np.float32))


def test_the_slice_on_a_face_is_the_value_there(device: Device) -> None:
    """An opaque face has the colour of the distance at each pixel's own place on it, to 1/100 of black to white."""
    volume = distance_from_the_middle()
    x, y, z = volume.center
    view = Camera(direction=(0.3, 1, 0.2), target=volume.center, distance=90, fov=20)
    grey = TransferFunction.ramp((0, 40))
    for normal in ((0, -1, 0), (-0.4, -1, 0.3)):
        face = Plane(normal, (x, y - 2.5, z))
        for mode, cap in (("composite", None), ("isosurface", True)):
            options: dict[str, Any] = {"isovalue": 0.1, "cap": True} if mode == "isosurface" else {}
            shown = clvol.render(
                volume,
                view,
                mode,
                size=(60, 60),
                clip=face,
                transfer=grey,
                device=device,
                outputs=("rgba", "position", "normal"),
                rays=1,
                **options,
            )
            at = shown["position"]
            on = np.abs((at - face.point) @ np.array(face.normal)) < 1e-3
            on &= (np.abs(at - volume.center) < 14).all(-1)  # beside the faces of the volume there is an extension
            assert on.mean() > 0.3, (mode, cap)
            distance = np.linalg.norm(at - volume.center, axis=-1)
            np.testing.assert_allclose(shown["rgba"][on][:, 0], distance[on] / 40, atol=0.01)
            np.testing.assert_allclose(shown["normal"][on], np.broadcast_to(face.normal, (on.sum(), 3)), atol=1e-6)


def test_a_slab_is_a_slice_in_the_scene(device: Device) -> None:
    """Seen from both sides, half of its thickness before and behind the plane."""
    volume = distance_from_the_middle()
    plane, grey = Plane((0.2, 0.1, 1), volume.center + np.array((0, 0, 2.0))), TransferFunction.ramp((0, 40))
    medium = clvol.Medium(volume, grey, clip=plane.slab(0.5))
    for side in (1, -1):
        view = Camera(direction=tuple(-side * v for v in plane.normal), target=volume.center, distance=90, fov=20, up=(0, 1, 0))
        shown = clvol.render(medium, view, size=(40, 40), device=device, outputs=("rgba", "position"), rays=1)
        at = shown["position"]
        on = np.abs((at - plane.point) @ np.array(plane.normal) - 0.25 * side) < 1e-3
        on &= (np.abs(at - volume.center) < 14).all(-1)
        assert on.mean() > 0.3
        np.testing.assert_allclose(shown["rgba"][on][:, 0], np.linalg.norm(at - volume.center, axis=-1)[on] / 40, atol=0.01)
    with pytest.raises(OptionError, match="thickness must be"):
        plane.slab(0)


def test_caps_close_a_surface(device: Device) -> None:
    """A solid ball cut in half shows a disc of one colour, of the sphere's radius, and no inside."""
    z, y, x = np.mgrid[:32, :32, :32] - 15.5
    solid = clvol.Volume((20 - np.sqrt(x * x + y * y + z * z)).astype(np.float32))
    view = Camera(direction=(0, 1, 0), target=solid.center, projection="orthographic", radius=16)
    half = Plane((0, -1, 0), solid.center)
    look: dict[str, Any] = {"size": (64, 64), "isovalue": 10, "rays": 1, "device": device, "background": None}
    for method in ("exact", "stepped"):
        shown = clvol.render(solid, view, "isosurface", clip=half, cap="#00ff00", method=method, **look)
        disc = shown[..., 3] > 0
        assert (shown[disc] == (0, 1, 0, 1)).all()
        assert disc.sum() == pytest.approx(math.pi * 100 * (64 / 32) ** 2, rel=0.02)
        hollow = clvol.render(solid, view, "isosurface", clip=half, method=method, **look)
        assert not (hollow[disc][:, :3] == (0, 1, 0)).all(-1).any()


def test_a_corner_leaves_two_parts_of_a_ray(device: Device) -> None:
    """A slab of fog with a gap: the light that both parts absorb, in closed form."""
    fog = TransferFunction(((0.0, "white"),), ((0.0, 0.1),), 1.0)
    volume = Volume(np.zeros((16, 16, 16), np.float32))
    view = Camera(direction=(0, 1, 0), projection="orthographic", fit="volume")
    for low, high, length in ((4.2, 9.7, 16 - 5.5), (-5, 7.5, 8.0), (7.3, 40, 7.8)):
        gap = Corner((-INF, low, -INF), (INF, high, INF))
        got = clvol.render(volume, view, transfer=fog, clip=gap, shading=False, size=(9, 9), background=None, rays=1, device=device)
        np.testing.assert_allclose(got[4, 4, 3], 1 - 0.9**length, atol=1e-5)


def test_a_part_shorter_than_a_step_counts_in_a_mean_as_much_as_it_is_long(device: Device) -> None:
    """1.1 voxels of zeros in front of a gap, and 6.4 of ones behind it, in memory and by bricks."""
    volume = Volume(np.repeat(np.float32([0, 1]), 8)[:, None] * np.ones((16, 1, 16), np.float32))
    view = Camera(direction=(0, 1, 0), projection="orthographic", fit="volume")
    look: dict[str, Any] = {"clip": Corner((-INF, 0.6, -INF), (INF, 9.1, INF)), "transfer": TransferFunction.ramp((0, 1))}
    for field in (clvol.Field(volume, "linear", device=device), BrickedField(volume, "linear", edge=8, device=device)):
        with field, Renderer(field) as made:
            got = made.render(view, "mean", (9, 9), step=16 / 6, rays=1, **look)
        np.testing.assert_allclose(got[4, 4, 0], 6.4 / 7.5, rtol=1e-5)


def test_cut_open_by_dask_and_as_listed_rays(device: Device) -> None:
    """A lazy volume, and rays on edges, which are listed: as in memory."""
    lazy = LazyVolume(da.from_array(VOLUME.data, 9), VOLUME.spacing, VOLUME.origin, VOLUME.direction)
    for rays in ("auto", 4):
        for case in ("composite", "cap of values"):
            mode, options = MODES[case]
            look: dict[str, Any] = {"size": SIZE, "clip": CLIPS["everything"], "rays": rays, "filter": "linear", "device": device}
            want = clvol.render(VOLUME, CAMERAS["across"], mode, **look, **options)
            np.testing.assert_array_equal(clvol.render(lazy, CAMERAS["across"], mode, **look, **options), want)


def test_noise_on_a_face_is_not_lit(device: Device) -> None:
    """Noise of 1 % of the values moves the colours of a slice by about as much; lit, they are sandpaper."""
    rng = np.random.default_rng(3)
    noisy = Volume((100 + rng.normal(0, 1, (24, 24, 24))).astype(np.float32))
    look: dict[str, Any] = {
        "transfer": TransferFunction(((0, "black"), (200, "white")), ((0, 0.5),)),
        "clip": Plane((0, -1, 0), noisy.center),
        "size": (48, 48),
        "device": device,
        "filter": "bspline3",
    }
    view = Camera(direction=(0, 1, 0), target=noisy.center, distance=60, fov=15)
    lit, slice_ = (np.asarray(clvol.render(noisy, view, cap=cap, **look))[16:32, 16:32, 0].std() for cap in (False, None))
    assert slice_ < 0.01
    assert lit > 10 * slice_


REFUSED: dict[str, tuple[Any, type[Exception], str]] = {
    "no normal": (lambda: Plane((0, 0, 0), (1, 2, 3)), GeometryError, "a plane's normal must have a direction"),
    "a normal of NaN": (lambda: Plane((0, math.nan, 0), (1, 2, 3)), GeometryError, "normal must be three finite numbers .*nan"),
    "an infinite point": (lambda: Plane((0, 1, 0), (1, INF, 3)), GeometryError, "point must be three finite numbers"),
    "two numbers": (lambda: Plane((0, 1), (1, 2, 3)), GeometryError, r"three finite numbers \(x, y, z\); got \(0, 1\)"),
    "an empty corner": (lambda: Corner((0, 0, 0), (0, 1, 1)), GeometryError, "a corner must be two corners"),
    "too many planes": (
        lambda: clvol.Scene(VOLUME, clip=[CLIPS["plane"]] * 65),
        GeometryError,
        "up to 64 planes and 8 corners; got 65 and 0",
    ),
    "too many corners": (
        lambda: clvol.Scene(VOLUME, clip=[CLIPS["octant"]] * 9),
        GeometryError,
        "up to 64 planes and 8 corners; got 0 and 9",
    ),
    "no cut": (lambda: clvol.Scene(VOLUME, clip=[CLIPS["plane"], 3]), GeometryError, "a Plane, a Corner, or a list of these"),
    "caps of projections": (
        lambda: clvol.render(VOLUME, mode="mip", cap=True),
        OptionError,
        "cap is no option of mip, but of composite, iso",
    ),
    "a cap of no colour": (lambda: Isosurface(cap="reddish"), OptionError, "cap must be three numbers, or the name"),
    "a coloured slice": (lambda: Composite(cap="red"), OptionError, "cap must be True or False"),
    "colours without a cap": (
        lambda: clvol.render(VOLUME, mode="isosurface", cap="red", cmap="bone"),
        OptionError,
        "cmap changes nothing",
    ),
    "a cap of nothing": (
        lambda: clvol.render(VOLUME, mode="isosurface", cap=True),
        OptionError,
        "cap changes nothing in iso.*: nothing is cut",
    ),
    "opacity of a cap": (
        lambda: clvol.render(VOLUME, mode="isosurface", cap=True, opacity=0.5),
        OptionError,
        "opacity changes nothing",
    ),
    "the error of a cap": (
        lambda: clvol.render(VOLUME, mode="isosurface", cap=True, clip=CLIPS["plane"], outputs="uncertainty"),
        OptionError,
        "cap must be False",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case: str) -> None:
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()


def test_a_volume_that_is_cut_away_is_said(device: Device) -> None:
    x, y, z = VOLUME.center
    for clip in (
        Plane((0, 0, 1), (0, 0, -99)),
        [Plane((1, 0, 0), (x, y, z)), Plane((-1, 0, 0), (x + 1, y, z))],
        Corner((-99, -99, -99), (99, 99, 99)),
        [((x, -INF, -INF), (x + 3, INF, INF)), ((x + 4, -INF, -INF), (x + 9, INF, INF))],
    ):
        with pytest.warns(ClvolWarning, match="nothing is seen: clip cuts away the whole volume, which spans"):
            clvol.render(VOLUME, mode="mip", size=(16, 16), clip=clip, device=device)


def test_words_choose_the_colors_of_a_cap(device: Device) -> None:
    look: dict[str, Any] = {"clip": CLIPS["plane"], "cap": True, "isovalue": 0.5, "size": SIZE, "device": device, "rays": 1}
    grey, bone, wide = (
        clvol.render(VOLUME, mode="isosurface", **look, **words) for words in ({}, {"cmap": "magma"}, {"window": (0.5, 9.0)})
    )
    changed = (grey != bone).any(-1)
    assert 0.02 < changed.mean() < 0.6
    np.testing.assert_array_equal((grey != wide).any(-1), changed)  # no pixel but those of the cap


def test_cuts_keep_points() -> None:
    cuts = cuts_of([Plane((0, 0, 2), (0, 0, 1)), ((-1, -1, -1), (5, 5, 5)), ((0, -9, -9), (9, 9, 9)), Corner((1, 1, 0), (2, 2, 9))])
    assert cuts.box == ((0, -1, -1), (5, 5, 5))
    points = [(0.5, 0, 0), (0.5, 0, 1.1), (-0.5, 0, 0), (1.5, 1.5, 0.5), (1.5, 1.5, -0.5)]
    assert cuts.keep(points).tolist() == [True, False, False, False, True]
    assert cuts_of(None) == Cuts()
