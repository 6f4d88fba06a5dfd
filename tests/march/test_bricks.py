"""A picture by bricks equals the picture of the whole volume."""

from __future__ import annotations

import itertools
import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import clvol
import clvol.device
from clvol.base.errors import OptionError, OutOfMemoryError
from clvol.bricks.field import BrickedField
from clvol.march.bricks import Pass, level_of
from clvol.march.renderer import Renderer
from clvol.march.window import front_to_back
from clvol.spline.evaluator import DIRECT
from tests.bricks.test_source import Counted

GUIDES = ("rgba", "depth", "normal", "position")
CAMERAS = {
    "aslant": clvol.Camera.orbit(30, 20, fit="volume"),
    "parallel": clvol.Camera.orbit(100, -60, fit="volume", projection="orthographic"),
    "along an axis": clvol.Camera.orbit(0, 0, fit="volume", projection="orthographic"),
    "from within": clvol.Camera.look_at((15.0, 21.0, 18.0), (40.0, 20.0, 10.0), fov=80),
    "from afar": clvol.Camera.orbit(200, 80, distance=900.0, fov=5.0, fit="volume"),
}
MODES: list[tuple[str, dict[str, Any]]] = [
    ("composite", {}),
    ("isosurface", {}),
    ("isosurface", {"method": "stepped"}),
    ("surfaces", {"surfaces": "0.3:tan:0.4,0.5:teal:0.5,0.7:red:0.7"}),
    ("mip", {}),
    ("attenuated", {}),
    ("minip", {}),
    ("mean", {}),
    ("integral", {}),
]
BUMPY = clvol.TransferFunction(((0.2, (0.2, 0.3, 1)), (0.8, (1, 0.8, 0.3))), ((0.35, 0), (0.5, 0.2), (0.9, 0.7)))


def waves(*shape: int) -> Any:
    z, y, x = (np.arange(n) for n in shape)
    return (0.5 + 0.25 * (np.sin(x / 3) + np.cos(y / 4)[:, None] * np.sin(z / 5)[:, None, None])).astype(np.float32)


@pytest.fixture(scope="module")
def volume() -> clvol.Volume:
    return clvol.Volume(waves(35, 44, 51), (1, 0.9, 1.2), (3, -2, 5))


def both(volume: clvol.Volume, filter: str, boundary: str, edge: int, *args: Any, **options: Any) -> tuple[Any, Any]:
    """A picture of the whole volume, and by bricks."""
    with (
        Renderer(volume, filter, boundary) as whole,
        BrickedField(volume, filter, boundary, edge=edge) as field,
        Renderer(field) as bricked,
    ):
        return whole.render(*args, **options), bricked.render(*args, **options)


def same(volume: clvol.Volume, filter: str, boundary: str, edge: int, *args: Any, **options: Any) -> Any:
    """The picture of the whole volume, which by bricks has the same bits, guides included: all share their kernels."""
    whole, bricked = both(volume, filter, boundary, edge, *args, outputs=GUIDES, **options)
    for name in GUIDES:
        np.testing.assert_array_equal(bricked[name], whole[name], err_msg=f"{args}, {boundary}: {name}")
    return whole["rgba"]


@pytest.mark.one_in(320)
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize(("mode", "options"), MODES)
@pytest.mark.parametrize("filter", ["linear", "nearest", "catmull-rom", "bspline3-approx"])
def test_bit_identical_without_a_prefilter(
    volume: clvol.Volume, filter: str, mode: str, options: dict[str, Any], view: str
) -> None:
    options = options | ({"transfer": BUMPY} if mode == "composite" else {})
    assert same(volume, filter, "mirror", 16, CAMERAS[view], mode, (70, 50), **options).max() > 0


@pytest.mark.one_in(320)
@pytest.mark.parametrize("boundary", ["mirror", "wrap", "nearest", "zero", "constant"])
@pytest.mark.parametrize("filter", ["bspline3", "bspline3(0.1)", "bspline2", "hybrid"])
@pytest.mark.parametrize(("mode", "options"), MODES)
def test_within_a_millionth_with_one(volume: clvol.Volume, filter: str, boundary: str, mode: str, options: dict[str, Any]) -> None:
    options = options | ({"transfer": BUMPY} if mode == "composite" else {})
    whole, bricked = both(volume, filter, boundary, 16, CAMERAS["aslant"], mode, (70, 50), rays=1, **options)
    different = np.abs(bricked - whole).max(-1)
    # the function differs by 1e-6 at most; where it barely misses an isovalue a pixel may still change
    assert (different > 1e-5).sum() <= 2
    assert whole.max() > 0


@pytest.mark.one_in(2)
@pytest.mark.parametrize("edge", [8, 12, 33, 64])
def test_bricks_of_any_size_and_rays_of_any_number(edge: int) -> None:
    volume = clvol.Volume(waves(17, 22, 26), (1, 0.9, 1.2), (3, -2, 5))
    for options in ({"rays": 5, "mode": "composite", "transfer": BUMPY}, {"mode": "isosurface"}, {"mode": "mip", "step": 3.7}):
        same(volume, "linear", "mirror", edge, CAMERAS["aslant"], size=(70, 50), **options)


def test_with_clip_box_and_rotation() -> None:
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    volume = clvol.Volume(waves(40, 30, 36), (0.5, 2, 1), (100, 200, -300), turn)
    clip = (volume.center - 9, volume.center + 7)
    for mode, background in (("isosurface", None), ("composite", "white")):
        camera = clvol.Camera.orbit(70, 10)
        whole = same(volume, "linear", "mirror", 16, camera, mode, (64, 64), clip=clip, background=background)
        assert whole[..., 3].max() > 0


def test_jumps_between_bricks_are_surfaces() -> None:
    """Two halves whose values jump exactly at the end of a brick."""
    data = np.zeros((32, 32, 32), np.uint8)
    data[:, :, 16:] = 200
    for azimuth in (60, -60):
        camera = clvol.Camera.orbit(azimuth, 10, fit="volume")
        whole = same(clvol.Volume(data), "nearest", "mirror", 16, camera, "isosurface", (64, 64), isovalue=100)
        assert whole[..., 3].mean() > 0.2


def test_invisible_bricks_are_not_read() -> None:
    z, y, x = np.ogrid[:128, :128, :128]
    ball = np.clip(60 - np.sqrt((x - 15.0) ** 2 + (y - 15.0) ** 2 + (z - 15.0) ** 2) * 4, 0, 255).astype(np.uint8)
    data = Counted(ball)
    volume = clvol.LazyVolume(data, limits=(0, 60), labels=False, bounds=Known(ball))
    with BrickedField(volume, "linear", edge=32) as field, Renderer(field) as renderer:
        volume.preview()
        before = data.read
        picture = renderer.render(CAMERAS["aslant"], "isosurface", (80, 80), isovalue=20)
        assert field.reads.bricks == 1  # of 64: the ball lies in the first
        assert data.read - before == field.reads.samples
        with Renderer(clvol.Volume(ball), "linear") as whole:
            np.testing.assert_array_equal(picture, whole.render(CAMERAS["aslant"], "isosurface", (80, 80), isovalue=20))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["mip", "minip", "attenuated"])
def test_bricks_that_cannot_exceed_the_extreme_are_not_read(mode: str) -> None:
    """All samples count for extremes, but bounds exclude bricks."""
    z, y, x = np.ogrid[:128, :128, :128]
    ball = 250 * np.exp(-((x - 70.0) ** 2 + (y - 60.0) ** 2 + (z - 64.0) ** 2) / 1800)
    data = (ball if mode != "minip" else 255 - ball).astype(np.float32)  # without plateaus, which any brick may top
    ends = float(data.min()), float(data.max())
    volume = clvol.LazyVolume(Counted(data), limits=ends, labels=False, bounds=Known(data))
    camera = clvol.Camera.orbit(30, 20, zoom=2.5, fit="volume")
    with (
        BrickedField(volume, "linear", edge=16) as field,
        Renderer(field) as renderer,
        Renderer(clvol.Volume(data), "linear") as whole,
    ):
        picture = renderer.render(camera, mode, (64, 64), outputs=GUIDES, transfer=BUMPY)
        expected = whole.render(camera, mode, (64, 64), outputs=GUIDES, transfer=BUMPY)
        for name in GUIDES:
            np.testing.assert_array_equal(picture[name], expected[name], err_msg=name)
        reads = field.reads.bricks
        field.drop()
        renderer.render(camera, mode, (64, 64), transfer=BUMPY, rays=1, skipping=False)
        assert reads < 0.8 * (field.reads.bricks - reads)


def test_later_rays_find_resident_bricks() -> None:
    """If half of a row of bricks fits, at most the other half is read again."""
    data = waves(32, 32, 256)
    along = clvol.Camera.orbit(90, 0, fit="volume", projection="orthographic")
    lazy = clvol.LazyVolume(data, limits=(0, 1), labels=False)
    with BrickedField(lazy, "linear", edge=32) as measured, Renderer(measured) as renderer:
        expected = renderer.render(along, "mean", (16, 16), rays=1)
        assert measured.reads.bricks == 8
        budget = int(measured.nbytes * 4.9 / 8)
    with BrickedField(lazy, "linear", edge=32, memory=budget) as field, Renderer(field) as renderer:
        np.testing.assert_array_equal(renderer.render(along, "mean", (16, 16), rays=1), expected)
        assert field.reads.bricks == 8
        for again in (1, 2):
            renderer.render(along, "mean", (16, 16), rays=1)
            assert field.reads.bricks <= 8 + 5 * again
        assert field.nbytes <= budget


def test_bounds_of_bricks_read_are_tighter_than_stored_bounds() -> None:
    data = np.zeros((32, 32, 32), np.uint8)
    data[:, :, 17:] = 100
    lazy = clvol.LazyVolume(Counted(data), limits=(0, 100), labels=False, bounds=Known(data))
    with BrickedField(lazy, "linear", edge=8) as field, Renderer(field) as renderer:
        brick = field.bricks[1, 1, 1]  # the jump is 1 sample past it, within what bounds are taken of
        before = field.bounds.of(brick)
        renderer.render(CAMERAS["aslant"], "isosurface", (40, 40), isovalue=50)
        found = field.bounds.of(brick)
        assert before is not None
        assert found is not None
        assert before[0] <= found[0] <= found[1] <= before[1]
        with field.store.resident(brick) as own:
            low, high = field.bounds.pyramid(own, DIRECT).extremes()
        assert found == (max(low, before[0]), min(high, before[1]))


class Known:
    """Bounds of linear interpolation: those of the samples."""

    filter, boundary, value_range = "linear", "mirror", (0.0, 60.0)

    def __init__(self, data: Any) -> None:
        self._data = data

    def within(self, low: tuple[int, int, int], high: tuple[int, int, int]) -> tuple[float, float]:
        part = self._data[tuple(slice(a, b + 1) for a, b in zip(low[::-1], high[::-1], strict=True))]
        return float(part.min()), float(part.max())


def test_hidden_bricks_are_not_read() -> None:
    """Nothing behind an opaque front is read, even without bounds; the next picture knows what was visible."""
    data = Counted(np.full((128, 128, 128), 200, np.uint8))
    with (
        BrickedField(clvol.LazyVolume(data, limits=(0, 255), labels=False), "linear", edge=32) as field,
        Renderer(field) as renderer,
    ):
        solid = clvol.TransferFunction(((0, (1, 1, 1)), (255, (1, 1, 1))), ((0, 1.0), (255, 1.0)))
        front = clvol.Camera.orbit(0, 0, fit="volume", projection="orthographic")
        renderer.render(front, "composite", (64, 64), transfer=solid)
        assert field.reads.bricks == 16  # one layer of four
        clear = clvol.TransferFunction(((0, (1, 1, 1)), (255, (1, 1, 1))), ((210, 0.0), (255, 1.0)))
        field.drop()
        renderer.render(front, "composite", (64, 64), transfer=clear)
        reads = field.reads.bricks
        field.drop()
        assert not renderer.render(front, "composite", (64, 64), transfer=clear, background=None).any()
        assert field.reads.bricks == reads


@pytest.mark.one_in(3)
@pytest.mark.parametrize("filter", ["nearest", "bspline2-approx", "linear"])
def test_an_eye_beside_a_face_between_bricks(filter: str) -> None:
    volume = clvol.Volume(np.random.default_rng(3).random((40, 40, 40)).astype(np.float32))
    camera = clvol.Camera.look_at((16.2, 16.3, 16.25), (30, 28, 25), fov=80)
    same(volume, filter, "mirror", 16, camera, "composite", (48, 32), transfer=BUMPY)


def test_an_eye_in_a_face_up_to_rounding() -> None:
    """The first samples of rays lie there, on either side by rounding."""
    rng = np.random.default_rng(0)
    data = rng.random((20, 40, 33)).astype(np.float32)
    for _ in range(12):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        volume = clvol.Volume(data, (1, 1, 1), rng.normal(size=3) * 100, turn)
        eye = volume.index_to_world([16 - 1e-6, 27 - 1e-7, 9 - 1e-7])  # a plane of samples is just ahead
        camera = clvol.Camera.look_at(eye, eye + 10 * turn[:, 0], up=turn[:, 2], fov=20)
        same(volume, "linear", "mirror", 9, camera, "composite", (32, 32), transfer=BUMPY, rays=1)


@pytest.mark.one_in(4)
@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, -90), (180, 90)])
def test_rays_that_lie_in_a_face_between_bricks(azimuth: float, elevation: float) -> None:
    """Rounding of 10⁻⁸ of a sample decides on which side of the face the rays of the middle column or row lie."""
    z, y, x = np.indices((33, 33, 3), np.float32) if azimuth in (90, 270) else np.indices((3, 33, 33), np.float32)
    volume = clvol.Volume(0.5 + 0.5 * np.sin(x / 3 + y / 5) * np.cos(z / 4))
    for projection in ("perspective", "orthographic"):
        camera = clvol.Camera.orbit(azimuth, elevation, fit="volume", projection=projection)
        for mode, more in (("isosurface", {}), ("isosurface", {"method": "stepped"}), ("composite", {"transfer": BUMPY})):
            for boundary in ("zero", "mirror"):
                same(volume, "linear", boundary, 16, camera, mode, (37, 29), **more)


def test_a_jump_before_a_brick_is_seen_by_long_steps() -> None:
    data = np.zeros((32, 32, 32), np.uint8)
    data[:, :, 15:] = 60
    camera = clvol.Camera.orbit(90, 0, fit="volume", projection="orthographic")
    lazy = clvol.LazyVolume(data, limits=(0, 60), labels=False, bounds=Known(data))
    options: dict[str, Any] = {"isovalue": 30, "method": "stepped", "step": 2.7, "outputs": GUIDES}
    with (
        BrickedField(lazy, "linear", edge=16) as field,
        Renderer(field) as bricked,
        Renderer(clvol.Volume(data), "linear") as whole,
    ):
        for azimuth in (90, -90):
            camera = clvol.Camera.orbit(azimuth, 0, fit="volume", projection="orthographic")
            got, want = (one.render(camera, "isosurface", (32, 32), **options) for one in (bricked, whole))
            for name in GUIDES:
                np.testing.assert_array_equal(got[name], want[name], err_msg=name)


def test_rays_of_wide_pixel_filters_with_tiles_of_one() -> None:
    volume = clvol.Volume(np.random.default_rng(4).random((24, 24, 24)).astype(np.float32))
    options: dict[str, Any] = {"rays": 16, "pixel_filter": "lanczos3", "transfer": BUMPY}
    with clvol.device.as_device(None).limited(tile=(1, 1, 1, False)):
        whole, bricked = both(
            volume, "linear", "mirror", 8, clvol.Camera.orbit(20, 10, zoom=0.3, fit="volume"), "mip", (24, 24), **options
        )
    np.testing.assert_array_equal(bricked, whole)


def test_levels_share_density_and_placement() -> None:
    """Opacities use the whole volume's voxels, and cameras are fitted to it."""
    fine = np.full((40, 40, 40), 0.6, np.float32)
    levels = [clvol.LazyVolume(fine[::2, ::2, ::2], (2, 2, 2), (0.5, 0.5, 0.5), limits=(0, 1))]
    lazy = clvol.LazyVolume(fine, levels=levels, limits=(0, 1), labels=False)
    thin = clvol.TransferFunction(((0, (1, 1, 1)), (1, (1, 1, 1))), ((0, 0.02), (1, 0.02)))
    front = clvol.Camera.orbit(0, 0, fit="volume", projection="orthographic")
    with Renderer(lazy, "linear") as renderer:
        one, other = (renderer.render(front, "composite", (20, 20), transfer=thin, background=None, lod=lod) for lod in (0, 9))
        assert [level.volume.shape for level in renderer.levels] == [(20, 20, 20)]
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-4)
    assert one[10, 10, 3] == pytest.approx(1 - 0.98**40, abs=1e-4)


def test_the_levels_of_a_renderer_share_a_budget() -> None:
    data = waves(48, 48, 48)
    levels = [clvol.LazyVolume(data[::n, ::n, ::n], (n, n, n), limits=(0, 1)) for n in (2, 3)]
    lazy = clvol.LazyVolume(data, levels=levels, limits=(0, 1), labels=False)
    with BrickedField(lazy, "linear", edge=16, memory=700_000) as field, Renderer(field) as renderer:
        for _ in renderer.refine(CAMERAS["aslant"], "mip", (40, 40), lod=0):
            assert field.nbytes + sum(level.nbytes for level in renderer.levels) <= 700_000


def test_levels_rendered_by_several_threads_share_a_budget() -> None:
    """Bricks of one level make room for those of another, or wait until these are released."""
    rng = np.random.default_rng(0)
    data, budget, most, drawn = rng.random((48, 48, 48)).astype(np.float32), 500_000, [0], list[bool]()

    class Watched(Counted):
        def __getitem__(self, index: Any) -> Any:
            look()
            return super().__getitem__(index)

    def look() -> None:
        if drawn:
            with field.store._residents.lock:  # others count meanwhile
                most[0] = max(most[0], field.nbytes + sum(level.nbytes for level in renderer.levels))

    levels = [clvol.LazyVolume(Watched(data[::n, ::n, ::n]), (n, n, n), limits=(0, 1), labels=False) for n in (1, 2)]
    with BrickedField(levels[0].with_levels(levels[1:]), "linear", edge=16, memory=budget) as field, Renderer(field) as renderer:

        def draw(lod: float) -> list[Any]:
            return [renderer.render(mode="mean", size=(32, 32), lod=lod, rays=1) for _ in range(3)]

        alone = [draw(lod)[0] for lod in (0, 100)]
        drawn.append(True)
        assert len(renderer.levels) == 1
        with ThreadPoolExecutor(4) as pool:
            for picture, found in zip([*alone, *alone], pool.map(draw, (0, 100, 0, 100)), strict=True):
                for one in found:
                    np.testing.assert_array_equal(one, picture)
        assert 0 < most[0] <= budget
        assert field.nbytes + renderer.levels[0].nbytes <= budget


def test_a_field_may_be_closed_while_one_with_the_same_budget_renders() -> None:
    """They count each other's bricks."""
    data = np.random.default_rng(0).random((40, 40, 40)).astype(np.float32)
    points = np.random.default_rng(1).uniform(0, 39, (200, 3))
    with BrickedField(data, "linear", edge=12, memory=400_000) as one, ThreadPoolExecutor(1) as pool:
        truth = one(points)

        def slowly(own: Any) -> int:  # the other field is closed meanwhile
            time.sleep(0.0005)
            return int(own.coefficients.nbytes)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "clvol.bricks.residents.Resident.nbytes", property(lambda own: time.sleep(0.0005) or own.coefficients.nbytes)
            )
            for _ in range(2):
                other = BrickedField(data, "nearest", edge=12, beside=one)
                other(points[:40])
                found = pool.submit(one, points)
                time.sleep(0.01)
                other.close()
                np.testing.assert_array_equal(found.result(60), truth)


def test_fields_that_share_a_budget_have_none_of_their_own(volume: clvol.Volume) -> None:
    with BrickedField(volume, "linear", edge=16, memory=1 << 20) as one:
        with BrickedField(volume, "nearest", edge=16, beside=one) as other:
            assert other.memory == one.memory
            other([[9.0, 9.0, 9.0]])
            one([[9.0, 9.0, 9.0]])
            assert other.nbytes + one.nbytes <= 1 << 20
        assert other.nbytes == 0
        with pytest.raises(OptionError, match="memory must be left to the field beside which this one is; got 3 with it"):
            BrickedField(volume, memory=3, beside=one)


@pytest.mark.parametrize("mode", ["composite", "mip"])
def test_the_next_brick_is_read_while_rays_traverse_one(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In access order, each once: rays leave a brick only after the next read has begun, or a timeout."""
    data = waves(16, 16, 80)
    reads: list[tuple[int, bool]] = []
    changed = threading.Condition()

    class Seen(Counted):
        def __getitem__(self, index: Any) -> Any:
            with changed:
                reads.append((index[2].start, threading.current_thread() is not threading.main_thread()))
                changed.notify_all()
            return super().__getitem__(index)

    march, marched = Pass.march, []

    def watched(self: Any, own: Any, *rest: Any) -> None:
        marched.append(own.at)
        march(self, own, *rest)
        with changed:
            assert changed.wait_for(lambda: len(reads) > min(len(marched), 4), 20), "nothing is read meanwhile"

    source = Seen(data)
    volume = clvol.LazyVolume(source, limits=(0, 1), labels=False)
    with BrickedField(volume, "linear", edge=16) as field, Renderer(field) as renderer:
        assert field.bricks.counts == (5, 1, 1)
        along = clvol.Camera.look_at((-200.0, 8.0, 8.0), (40.0, 8.0, 8.0), fov=10)
        renderer.render(along, mode, (8, 8), rays=1)  # bounds and looks are cached by then
        field.drop()
        until = time.monotonic() + 60
        while field.store._residents._ahead:  # a brick prefetched for that picture may still be loading
            assert time.monotonic() < until
            time.sleep(0.01)
        reads.clear()
        source.read, field.reads.samples, field.reads.bricks = 0, 0, 0
        monkeypatch.setattr(Pass, "march", watched)
        clear = clvol.TransferFunction(((0, (1, 1, 1)),), ((0, 0.01), (1, 0.01)))
        renderer.render(along, mode, (8, 8), rays=1, transfer=clear, skipping=False)
    assert [at[0] for at in marched] == [0, 1, 2, 3, 4]
    assert [first for first, _ in reads] == sorted({first for first, _ in reads})
    assert [by_another for _, by_another in reads] == [False, True, True, True, True]
    assert field.reads.bricks == 5
    assert source.read == field.reads.samples


def test_pickled_renderers_reread_their_bricks() -> None:
    data = waves(20, 20, 20)
    with Renderer(clvol.LazyVolume(data, limits=(0, 1), labels=False), "linear") as renderer:
        packed = pickle.dumps(renderer)
        with pickle.loads(packed) as again:
            picture = again.render(CAMERAS["parallel"], "mip", (16, 16))
            np.testing.assert_array_equal(picture, renderer.render(CAMERAS["parallel"], "mip", (16, 16)))
    assert picture.max() > 0
    assert len(packed) < 2 * data.nbytes


def test_the_picture_does_not_depend_on_the_budget(volume: clvol.Volume) -> None:
    pictures = []
    for budget in (1 << 20, 1 << 30):
        with BrickedField(volume, "linear", edge=16, memory=budget) as field, Renderer(field) as renderer:
            pictures.append(renderer.render(CAMERAS["aslant"], "composite", (64, 64), transfer=BUMPY, rays=4))
            assert field.nbytes <= budget
    np.testing.assert_array_equal(*pictures)


@pytest.mark.one_in(5)
@pytest.mark.parametrize("filter", ["linear", "nearest"])
@pytest.mark.parametrize("view", CAMERAS)
def test_no_brick_hides_one_in_front_of_it(volume: clvol.Volume, view: str, filter: str) -> None:
    camera = CAMERAS[view].view(volume)
    with BrickedField(volume, filter, edge=10) as field:
        order = {brick.at: i for i, brick in enumerate(front_to_back(field, camera))}
        assert len(order) == np.prod(field.bricks.counts)
        rng = np.random.default_rng(0)
        for _ in range(300):  # along a ray bricks are ordered
            start = camera.eye if not camera.orthographic else None
            inner = volume.index_to_world(rng.uniform(-0.5, np.asarray(volume.size) - 0.5))
            way = camera.forward if start is None else inner - start
            at = inner - way if start is None else start
            t = np.linspace(0 if start is not None else -200, 300 if start is None else 3, 4000)
            index = volume.world_to_index(at + t[:, None] * way)
            inside = ((index > -0.5) & (index < np.asarray(volume.size) - 0.5)).all(1)
            bricks = np.stack([field.bricks.owners(index[inside, axis], axis) for axis in range(3)], axis=1)
            passed = [order[at] for at, _ in itertools.groupby(map(tuple, bricks.tolist()))]
            assert passed == sorted(passed)


def test_opacities_of_ranges() -> None:
    steps = clvol.TransferFunction(((0, (1, 1, 1)), (1, (1, 1, 1))), ((0.2, 0), (0.4, 0.5), (0.4, 0.9), (0.6, 0)))
    assert steps.opacity_within(-5, 0.2) == 0
    assert steps.opacity_within(0.6, 9) == 0
    assert steps.opacity_within(0.25, 0.3) == pytest.approx(0.25)
    assert steps.opacity_within(0.3, 0.5) == 0.9
    assert steps.opacity_within(-1, 2) == 0.9


def test_levels_are_chosen_by_voxels_per_pixel() -> None:
    data = waves(64, 64, 64)
    levels = [clvol.LazyVolume(data[::n, ::n, ::n], (n, n, n), ((n - 1) / 2,) * 3, limits=(0, 1)) for n in (2, 4, 8)]
    lazy = clvol.LazyVolume(data, levels=levels, limits=(0, 1), labels=False)
    front = clvol.Camera.orbit(0, 0, fit="volume", projection="orthographic").view(lazy.grid)
    world_height = 2 * front.half_height
    for pixels, expected in ((10, 3), (world_height / 7, 2), (world_height / 3, 1), (world_height / 1.5, 0), (10000, 0)):
        assert level_of(lazy, front, (10, int(pixels)), 1.0) == expected, pixels
    assert level_of(lazy, front, (10, 10), 0.0) == 0
    with Renderer(lazy, "linear") as renderer:
        fine, coarse = (renderer.render(CAMERAS["aslant"], "mip", (40, 40), lod=lod) for lod in (0, 3.5))
        with Renderer(clvol.Volume(data), "linear") as whole:
            np.testing.assert_array_equal(fine, whole.render(CAMERAS["aslant"], "mip", (40, 40), transfer=renderer_look(renderer)))
        assert np.abs(coarse - fine).max() > 0
        pictures = list(renderer.refine(CAMERAS["aslant"], "mip", (40, 40), lod=0))
        assert [picture.final for picture in pictures] == [False, False, False, True]
        np.testing.assert_array_equal(pictures[-1], fine)
        assert not list(renderer.refine(CAMERAS["aslant"], "mip", (40, 40), cancelled=lambda: True))
        for wrong in ("fine", -1, None):
            with pytest.raises(OptionError, match="lod must be"):
                renderer.render(lod=wrong)  # type: ignore[arg-type]


def renderer_look(renderer: Renderer) -> clvol.TransferFunction:
    """The transfer function of a lazy volume's preview."""
    return clvol.modes()["mip"].transfer(renderer.field.volume.preview())  # type: ignore[union-attr]


def test_a_volume_that_does_not_fit_is_rendered_by_bricks(volume: clvol.Volume, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = clvol.render(volume, CAMERAS["aslant"], "mip", filter="linear", size=(40, 40))

    def no_room(*_: object, **__: object) -> None:
        raise OutOfMemoryError("out of memory")

    monkeypatch.setattr("clvol.march.source.single", no_room)
    np.testing.assert_array_equal(clvol.render(volume, CAMERAS["aslant"], "mip", filter="linear", size=(40, 40)), expected)


def test_bad_input(volume: clvol.Volume) -> None:
    with BrickedField(volume, "linear", edge=16) as field, Renderer(field) as renderer:
        with pytest.raises(OptionError, match="step must be at most 3 for stepped surfaces"):
            renderer.render(mode="isosurface", method="stepped", step=4)
        with pytest.raises(OptionError, match="step must be at most 3 for the depth and normals of matter"):
            renderer.render(mode="composite", outputs="normal", step=4)
        with pytest.raises(OptionError, match="takes a volume that is in memory"):
            renderer.render(mode="isosurface", outputs="uncertainty")
        with pytest.raises(OptionError, match="bricks are read by direct taps"), field.device.limited(fetch="image"):
            renderer.render()
        with (
            pytest.raises(OptionError, match="evaluator must be one of auto, taps, paired, eight-fetch; got 'direct'"),
            field.device.limited(evaluator="direct"),
        ):
            renderer.render()
        with pytest.raises(OptionError, match="must be left to the field"):
            Renderer(field, "linear")
    with pytest.raises(OptionError, match="the field was closed"):
        Renderer(field)


def test_bricks_that_are_just_transparent_are_so_in_the_whole_picture(device: clvol.device.Device) -> None:
    """Opacity begins at 0.41, a point between two samples of a table, where rounding gave it 1e-16, and the values before some."""
    look = clvol.TransferFunction(((0.0, "black"), (1.0, "white")), ((0.0, 0.0), (0.41, 0.0), (1.0, 1.0)))
    data = np.full((9, 9, 9), 0.4097, np.float32)
    options: dict[str, Any] = {"transfer": look, "size": (9, 9), "rays": 1, "background": None}
    with clvol.Renderer(clvol.BrickedField(data, "linear", device=device, edge=8)) as renderer:
        for skipping in (False, True, True):  # the bounds of bricks are known from the second picture on
            assert not np.any(renderer.render(mode="composite", skipping=skipping, **options))
    assert not np.any(clvol.render(data, mode="composite", filter="linear", device=device, **options))
