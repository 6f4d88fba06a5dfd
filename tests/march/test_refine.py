"""Progressive pictures: the last equals that of `render` to the last bit, whatever happens in between."""

from __future__ import annotations

import contextlib
import copy
import itertools
import pickle
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from clvol.base.errors import GeometryError, OptionError
from clvol.device import Device
from clvol.march import launch, refine
from clvol.march.launch import Drawing, draw
from clvol.march.refine import Rate, Refined
from clvol.march.renderer import Renderer
from clvol.phantoms import marschner_lobb
from clvol.scene.camera import Camera
from clvol.scene.transfer import TransferFunction
from clvol.show.picture import Picture
from clvol.spline.field import Field
from clvol.volume.volume import Volume
from tests import cases
from tests.march.looks import TILES, suited

CAMERA = Camera.orbit(33, 21, fit="volume")
TINY, HUGE = 1e-6, 10.0
SIZE = (70, 50)


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[Renderer]:
    with Renderer(marschner_lobb(20), device=device) as made:
        yield made


def hashed(picture: NDArray[Any]) -> bytes:
    return np.asarray(picture).tobytes()


def checked(pictures: Iterator[Refined], want: Picture) -> list[Refined]:
    """Require increasing resolution, only the last final, and no change of earlier pictures."""
    made, as_made = [], []
    for picture in pictures:
        made.append(picture)
        as_made.append(hashed(picture))
    assert [hashed(picture) for picture in made] == as_made
    assert [picture.final for picture in made] == [False] * (len(made) - 1) + [True]
    np.testing.assert_array_equal(made[-1], want)
    for one, other in itertools.pairwise(made):
        assert one.shape[0] <= other.shape[0]
        assert one.shape[1] <= other.shape[1]
        assert 0 < one.seconds < other.seconds
        assert not np.shares_memory(one, other)
    for picture in made:
        assert isinstance(picture, Refined)
        assert picture.kind == "rgba"
        assert picture.dtype == np.float32
        assert 0 <= picture.min() <= picture.max() <= 1
    return made


# -- the last one is that of render --------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize("rays", [1, "auto", 4])
@pytest.mark.parametrize("mode", cases.MODES)
def test_the_last_is_the_picture_to_the_last_bit(renderer: Renderer, mode: str, rays: Any) -> None:
    want = renderer.render(CAMERA, mode, SIZE, rays=rays)
    soon = checked(renderer.refine(CAMERA, mode, SIZE, rays=rays, seconds=TINY), want)
    assert len(soon) >= 2
    assert soon[0][..., 0].size <= 1100
    assert soon[-1].step == 0.5
    assert len(checked(renderer.refine(CAMERA, mode, SIZE, rays=rays, seconds=HUGE), want)) == 1


@pytest.mark.parametrize("size", [(1, 1), (3, 500), (500, 3), (17, 1), (40, 41)], ids=str)
@pytest.mark.parametrize("budget", [TINY, HUGE])
def test_pictures_of_any_shape(renderer: Renderer, size: tuple[int, int], budget: float) -> None:
    want = renderer.render(CAMERA, size=size)
    for _ in range(2):  # with the rates measured the first time, too
        made = checked(renderer.refine(CAMERA, size=size, seconds=budget), want)
        if budget == HUGE:
            assert len(made) == 1


def test_all_options_of_render(renderer: Renderer) -> None:
    look: dict[str, Any] = {
        "step": 0.3,
        "window": (0.5, 0.6),
        "cmap": "viridis",
        "opacity": 0.5,
        "background": "white",
        "clip": ((-0.5, -1, -1), (1, 1, 0.6)),
        "rays": 3,
        "pixel_filter": "mitchell",
        "skipping": False,
    }
    for more in ({"shading": False}, {"gradient": "central"}):
        wanted = renderer.render(None, "composite", SIZE, **look, **more)
        checked(renderer.refine(None, "composite", SIZE, seconds=TINY, **look, **more), wanted)
    checked(renderer.refine(size=SIZE, seconds=TINY, outputs="rgba"), renderer.render(size=SIZE))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("tile", TILES)
def test_other_tiles_and_devices_that_do_not_share_memory(renderer: Renderer, tile: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for shares in (True, False):
        if not shares:
            monkeypatch.setattr(Device, "shares_memory", property(lambda _: False))
        with renderer.device.limited(tile=TILES[tile], launch_seconds=1e-9):
            for rays in ("auto", 5):
                look: dict[str, Any] = {"mode": "isosurface", "size": SIZE, "rays": rays}
                checked(renderer.refine(CAMERA, seconds=TINY, **look), renderer.render(CAMERA, **look))


def test_a_late_picture_is_continued(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planned as if all were in time, when none is: the coarse picture is shown, and no launch of the final one is repeated."""
    size = (120, 90)
    told: list[float] = []
    monkeypatch.setattr(refine, "_LATE", 0.0)
    launched = Drawing.cast

    def cast(self: Drawing, rays: int, progress: Any = None, until: float = np.inf) -> bool:
        if self.frame.size != size or progress is None:
            return launched(self, rays, progress, until)

        def noted(done: float) -> None:
            told.append(done)
            progress(done)

        return launched(self, rays, noted, until)

    monkeypatch.setattr(Drawing, "cast", cast)
    for camera in CAMERA, Camera.orbit(120, -40, fit="volume"):
        with renderer.device.limited(launch_seconds=1e-9):
            told.clear()
            monkeypatch.setattr(renderer._source, "_rates", {})
            want = renderer.render(camera, "mip", size, progress=lambda _: None)
            launches = told.copy()
            told.clear()
            made = checked(renderer.refine(camera, "mip", size, seconds=HUGE), want)
        assert [picture.shape[:2] == want.shape[:2] for picture in made] == [False, True]
        assert len(launches) > 10
        assert told == launches


def test_a_drawing_resumes_where_it_stopped(renderer: Renderer) -> None:
    for rays in (1, 4):
        seen = captured(renderer, rays)
        (frame,) = {id(drawing.frame): drawing.frame for drawing in seen}.values()
        with renderer.device.limited(launch_seconds=1e-9):
            whole, drawing, stops = draw(frame, rays)["rgba"], Drawing(frame, rays), 0
            while not drawing.cast(rays, until=0.0):
                stops += 1
        assert stops > 10
        np.testing.assert_array_equal(drawing.arrays["rgba"], whole)


def captured(renderer: Renderer, rays: int) -> list[Drawing]:
    """The drawing of a final picture."""
    made: list[Drawing] = []

    class Kept(Drawing):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            if self.frame.size == SIZE:
                made.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refine, "drawing_of", Kept)
        list(renderer.refine(CAMERA, size=SIZE, rays=rays, seconds=HUGE))
    return made


@pytest.mark.parametrize("background", ["teal", None])
def test_a_subset_of_a_pixels_rays_makes_a_picture(device: Device, background: str | None) -> None:
    """In homogeneous fog all rays have one colour: a subset shows what all do."""
    fog = Volume(np.ones((6, 6, 6), np.float32))
    camera = Camera.orbit(0, 0, projection="orthographic", zoom=4)
    transfer = TransferFunction(((0, (1, 0.6, 0)), (2, (1, 0.6, 0))), ((0, 0.1), (2, 0.1)))
    look: dict[str, Any] = {"size": (20, 20), "rays": 9, "transfer": transfer, "shading": False, "background": background}
    with Renderer(fog, device=device) as renderer:
        made = list(renderer.refine(camera, seconds=TINY, **look))
        assert len(made) > 3
        for picture in made:
            np.testing.assert_allclose(picture - made[-1][0, 0], 0, atol=2e-6)
    assert made[-1][0, 0, 3] == 1 if background else 0 < made[-1][0, 0, 3] < 1


def test_coarse_pictures_show_the_same_part_of_the_world(device: Device) -> None:
    z, y, x = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
    blob = Volume(np.exp(-3 * ((x - 0.2) ** 2 + y**2 + (z + 0.3) ** 2)).astype(np.float32))
    with Renderer(blob, device=device) as renderer:
        for size in ((9, 400), (150, 101)):
            first, *_, last = renderer.refine(CAMERA, "mip", size, seconds=TINY)
            assert first.shape[0] < last.shape[0]
            middles = [(np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(first.shape[:2], last.shape[:2], strict=True)]
            there = map_coordinates(np.asarray(last)[..., 0], np.meshgrid(*middles, indexing="ij"), order=1, mode="nearest")
            assert last.max() > 0.9
            assert np.abs(np.asarray(first)[..., 0] - there).max() < 0.05


# -- the budget --------------------------------------------------------------------------------------------------------


def test_steps_are_longer_only_where_all_samples_count(renderer: Renderer) -> None:
    for mode in cases.MODES:
        first, *_, last = renderer.refine(CAMERA, mode, (200, 200), seconds=TINY)
        assert first.step == (2.0 if mode in ("composite", "mean", "integral") else 0.5)
        assert last.step == 0.5
    first, *_ = renderer.refine(CAMERA, size=(200, 200), step=3.0, seconds=TINY)
    assert first.step == 3.0


def test_measured_times_are_remembered(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first picture needs trials; a similar view needs none, and a different one starts coarse."""
    sizes: list[tuple[int, int]] = []

    class Counted(Drawing):
        def __init__(self, frame: Any, *others: Any) -> None:
            sizes.append(frame.size)
            super().__init__(frame, *others)

    monkeypatch.setattr(refine, "drawing_of", Counted)

    def drawn(camera: Camera, **look: Any) -> int:
        sizes.clear()
        list(renderer.refine(camera, size=(64, 64), rays=1, seconds=HUGE, **look))
        return len(sizes)

    with Renderer(marschner_lobb(12), device=device) as renderer:
        assert drawn(Camera.orbit(30, 20)) == 3
        assert drawn(Camera.orbit(32, 20)) == 1
        # a quarter of the time may suffice for the final picture, by the last measurement
        assert drawn(Camera.orbit(33, 20).zoomed(1.02), cmap="magma") in (1, 2)
        assert drawn(Camera.orbit(200, 20), cmap="magma") in (1, 2)
        assert drawn(Camera.orbit(120, 20), mode="mip") == 3
        assert drawn(Camera.orbit(120, 20), mode="mip") == 1


def test_rates() -> None:
    view = np.array([[1.0, 2.0, 3.0]])
    rate = Rate(10_000, 0.5, 0.04, view, ("composite",), power=0.5)
    assert rate.seconds_of(10_000, 0.5) == pytest.approx(0.04)
    assert rate.seconds_of(40_000, 0.5) == pytest.approx(0.08)
    assert rate.seconds_of(10_000, 1.0) == pytest.approx(0.04 * 0.5**0.8)
    for seconds, step in itertools.product((0.001, 0.04, 3.0), (0.25, 0.5, 2.0)):
        assert rate.seconds_of(rate.pixels_in(seconds, step), step) == pytest.approx(seconds)
    assert rate.pixels_in(-1.0, 0.5) == 0
    assert np.isfinite(rate.pixels_in(1e30, 0.5))
    assert rate.sees(view * 1.05, ("composite",))
    assert not rate.sees(view * 1.3, ("composite",))
    assert not rate.sees(view, ("mip",))
    assert rate.grown(90_000, 0.5, 0.36).power == pytest.approx(0.75)  # measured: 1
    assert rate.grown(90_000, 0.5, 1e9).power == pytest.approx(0.75)
    assert rate.grown(20_000, 0.5, 0.08) is rate  # too close to decide
    assert rate.grown(90_000, 1.0, 0.36) is rate  # of another step


# -- that nobody wants any more -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "look", [{"mode": "composite"}, {"mode": "isosurface"}, {"mode": "mip", "rays": 3}], ids=lambda look: look["mode"]
)
def test_cancellation_at_each_check(renderer: Renderer, look: dict[str, Any]) -> None:
    want = renderer.render(CAMERA, size=SIZE, **look)
    counted = asked = last = 0

    def count() -> bool:
        nonlocal counted
        counted += 1
        return False

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked >= last

    with renderer.device.limited(launch_seconds=2e-4):
        checked(renderer.refine(CAMERA, size=SIZE, seconds=TINY, cancelled=count, **look), want)
        assert counted > 10
        for last in {*range(1, 12), *range(12, counted, max(1, counted // 25))}:
            asked = 0
            made = list(renderer.refine(CAMERA, size=SIZE, seconds=TINY, cancelled=stop, **look))
            assert not any(picture.final for picture in made) or asked < last
            assert asked <= last  # the callback is not called again
    np.testing.assert_array_equal(renderer.render(CAMERA, size=SIZE, **look), want)


def test_the_search_for_a_surface_can_be_cancelled(device: Device) -> None:
    """Each new isovalue requires the search for cells that may contain the surface."""
    with Renderer(Volume(np.random.default_rng(1).random((40, 40, 40))), device=device) as renderer:
        list(renderer.refine(mode="isosurface", isovalue=0.4, size=(8, 8)))
        questions = 0

        def stop() -> bool:
            nonlocal questions
            questions += 1
            return questions == 3  # the first two come before

        assert list(renderer.refine(mode="isosurface", isovalue=0.5, size=(8, 8), cancelled=stop)) == []
        (pyramid,) = renderer._source.pyramids.values()
        assert pyramid._sides is None
        want = renderer.render(mode="isosurface", isovalue=0.5, size=(8, 8))
        np.testing.assert_array_equal(list(renderer.refine(mode="isosurface", isovalue=0.5, size=(8, 8)))[-1], want)


def test_edges_are_reported(renderer: Renderer) -> None:
    calls: list[float] = []
    with renderer.device.limited(launch_seconds=1e-9):
        renderer.render(CAMERA, "isosurface", SIZE, progress=calls.append)
    assert calls == sorted(calls)
    assert calls[-1] == 1
    assert sum(done > 0.75 for done in calls) > 2

    def stop(done: float) -> None:
        if done > 0.75:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        renderer.render(CAMERA, "isosurface", SIZE, progress=stop)


# -- whatever happens on the way --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rays", [1, "auto", 4])
@pytest.mark.parametrize("budget", [TINY, HUGE])
def test_progress_covers_the_last_picture(renderer: Renderer, rays: Any, budget: float) -> None:
    told: list[float] = []
    want = renderer.render(CAMERA, "isosurface", SIZE, rays=rays)
    with renderer.device.limited(launch_seconds=1e-9):
        checked(renderer.refine(CAMERA, "isosurface", SIZE, rays=rays, seconds=budget, progress=told.append), want)
    assert len(told) > 10
    assert told == sorted(told)
    assert 0 < told[0] < 0.5
    assert told[-1] == 1


def test_iteration_may_stop_early(renderer: Renderer) -> None:
    want = renderer.render(CAMERA, size=SIZE)
    for count in range(3):
        pictures = renderer.refine(CAMERA, size=SIZE, seconds=TINY)
        for _ in range(count):
            assert not next(pictures).final
        pictures.close()  # type: ignore[attr-defined]  # a generator
        assert list(pictures) == []
    np.testing.assert_array_equal(renderer.render(CAMERA, size=SIZE), want)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_errors_of_the_cancel_callback_propagate(renderer: Renderer, error: type[BaseException]) -> None:
    want = renderer.render(CAMERA, size=SIZE)
    for last in range(1, 12):
        asked = itertools.count(1)

        def fail(asked: Iterator[int] = asked, last: int = last) -> bool:
            if next(asked) == last:
                raise error("enough")
            return False

        pictures = renderer.refine(CAMERA, size=SIZE, seconds=TINY, cancelled=fail)
        with pytest.raises(error, match="enough"):
            list(pictures)
        assert list(pictures) == []
    assert not renderer._lease._users
    np.testing.assert_array_equal(renderer.render(CAMERA, size=SIZE), want)


def test_closing_a_renderer_between_two_pictures(device: Device) -> None:
    renderer = Renderer(marschner_lobb(12), device=device)
    pictures = renderer.refine(size=SIZE, seconds=TINY)
    first = next(pictures)
    before = hashed(first)
    renderer.close()
    assert renderer.field.closed  # merely holding the iterator keeps nothing alive
    with pytest.raises(OptionError, match="the renderer was closed"):
        next(pictures)
    assert list(pictures) == []
    assert hashed(first) == before
    with pytest.raises(OptionError, match="the renderer was closed"):
        renderer.refine(size=SIZE)


def test_closing_a_renderer_while_it_renders(device: Device) -> None:
    """The current picture is completed; the next is rejected."""
    with Renderer(marschner_lobb(12), device=device) as other:
        want = other.render(CAMERA, "mip", SIZE)
    for last in (2, 5, 30):
        renderer, asked = Renderer(marschner_lobb(12), device=device), itertools.count(1)

        def close(renderer: Renderer = renderer, asked: Iterator[int] = asked, last: int = last) -> bool:
            if next(asked) == last:
                renderer.close()
            return False

        made: list[Refined] = []
        with renderer.device.limited(launch_seconds=2e-5), contextlib.suppress(OptionError):
            for picture in renderer.refine(CAMERA, "mip", SIZE, seconds=TINY, cancelled=close):
                made.append(picture)  # an error must not take them
        assert renderer.field.closed
        assert made
        assert made[-1].final == (last == 30)
        if last == 30:
            np.testing.assert_array_equal(made[-1], want)
        with pytest.raises(OptionError, match="the renderer was closed"):
            renderer.refine()


def test_a_given_field_that_was_closed(device: Device) -> None:
    field = Field(marschner_lobb(12), device=device, precision="single")
    renderer = Renderer(field)
    pictures = renderer.refine(size=SIZE, seconds=TINY)
    next(pictures)
    field.close()
    with pytest.raises(OptionError, match="closed"):
        next(pictures)
    renderer.close()


def test_several_threads_refine_with_one_renderer(renderer: Renderer) -> None:
    looks = [("composite", {}), ("isosurface", {"isovalue": 0.4}), ("isosurface", {"isovalue": 0.6}), ("mip", {"rays": 2})]
    want = [renderer.render(CAMERA, mode, SIZE, **options) for mode, options in looks]
    failed: list[BaseException] = []

    def work(i: int) -> None:
        mode, options = looks[i]
        try:
            for _ in range(4):
                checked(renderer.refine(CAMERA, mode, SIZE, seconds=TINY, **options), want[i])
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(looks))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed


def test_several_threads_may_iterate_in_turn(renderer: Renderer) -> None:
    """One thread begins, another continues."""
    pictures = renderer.refine(CAMERA, size=SIZE, seconds=TINY)
    made: list[Refined] = []
    while not made or not made[-1].final:
        thread = threading.Thread(target=lambda: made.append(next(pictures)))
        thread.start()
        thread.join()
    np.testing.assert_array_equal(made[-1], renderer.render(CAMERA, size=SIZE))
    assert not renderer._lease._users


def test_thread_limits_do_not_leak_between_pictures(renderer: Renderer) -> None:
    before = renderer.device.limits
    for _ in renderer.refine(CAMERA, size=SIZE, seconds=TINY):
        assert renderer.device.limits is before


def test_furniture_stands_around_the_last_picture(renderer: Renderer) -> None:
    """Those before it are of the same view, on the same background."""
    around: dict[str, Any] = {"axes": True, "title": "a ball", "theme": "print"}
    *before, last = renderer.refine(size=(160, 120), seconds=1e-3, **around)
    drawn = renderer.render(size=(160, 120), **around)
    assert np.array_equal(last, drawn)
    assert last.recipe is not None
    assert last.recipe.furniture == drawn.recipe.furniture
    bare = renderer.render(drawn.recipe.camera, size=(160, 120), background="white")
    assert before
    assert all(one.furnished is None and (np.asarray(one)[..., 3] == 1).all() for one in before)
    assert np.abs(np.asarray(before[-1])[..., :3].mean((0, 1)) - np.asarray(bare)[..., :3].mean((0, 1))).max() < 0.02


# -- bad input -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("budget", [0, -1, float("nan"), "x", None, (1,), np.array([1, 2])], ids=repr)
def test_seconds_must_be_positive(renderer: Renderer, budget: Any) -> None:
    with pytest.raises(OptionError, match="seconds must be"):
        renderer.refine(size=SIZE, seconds=budget)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "cancelled": ({"cancelled": 3}, "cancelled must be callable; got 3"),
    "outputs": ({"outputs": "depth"}, "refine gives colours alone.*leave out outputs, or use render"),
    "several": ({"outputs": ("rgba", "depth")}, "leave out outputs"),
    "progress": ({"progress": 3}, "progress must be callable; got 3"),
    "sigma": ({"sigma": 1.0, "outputs": "rgba"}, "leave out outputs and sigma"),
    "option": ({"isovalue": 3}, "isovalue"),
    "mode": ({"mode": "compost"}, "composite"),
    "size": ({"size": (0, 4)}, "width must be"),
    "step": ({"step": 0}, "step must be"),
    "rays": ({"rays": 0}, "rays must be"),
    "gradient": ({"gradient": "exact"}, "gradient must be"),
    "camera": ({"camera": 4}, "camera must be"),
    "both": ({"transfer": TransferFunction.ramp((0, 1)), "cmap": "gray"}, "transfer must be left out"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_are_rejected_at_the_call(renderer: Renderer, case: str) -> None:
    options, message = WRONG[case]
    with pytest.raises(OptionError, match=message):
        renderer.refine(**{"size": SIZE, **options})


def test_a_camera_too_far_away_is_rejected_with_the_first_picture(renderer: Renderer) -> None:
    pictures = renderer.refine(Camera(position=(1e30, 0, 0)), size=SIZE)
    with pytest.raises(GeometryError, match="the camera must be within"):
        next(pictures)


# -- what a picture knows ---------------------------------------------------------------------------------------------------


def test_attributes_of_a_refined_picture_survive_copies(renderer: Renderer) -> None:
    first, *_, last = renderer.refine(CAMERA, size=SIZE, seconds=TINY)
    for picture in (first, last):
        for other in (
            pickle.loads(pickle.dumps(picture)),
            copy.copy(picture),
            copy.deepcopy(picture),
            picture.copy(),
            picture[2:9, 3:12],
            picture.view(),
        ):
            assert type(other) is Refined
            assert (other.final, other.step, other.seconds) == (picture.final, picture.step, picture.seconds)
            assert other.kind == "rgba"
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(picture)), picture)
        assert type(picture + 1) is np.ndarray
        assert type(picture[0]) is np.ndarray
        assert picture._repr_png_()
    assert (first.final, last.final) == (False, True)
    plain = np.zeros((2, 2, 4)).view(Refined)
    assert not plain.final
    assert np.isnan(plain.seconds)


def test_options_reach_the_mode(renderer: Renderer) -> None:
    for mode in cases.MODES:
        options = suited(mode, {"isovalue": 0.3, "shading": False, "attenuation": 1.0})
        checked(renderer.refine(CAMERA, mode, SIZE, seconds=TINY, **options), renderer.render(CAMERA, mode, SIZE, **options))


def test_launches_follow_measured_times(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    budget = launch._Budget
    monkeypatch.setattr(launch, "_Budget", lambda *given: made.append(budget(*given)) or made[-1])
    with renderer.device.limited(launch_seconds=0.01):
        renderer.render(Camera.orbit(45, 20), "composite", (16, 16))
    cut = made[0]
    rate, areas = cut._guess / 12, []  # seconds per pixel, over all rays
    for x, y, w, h in cut.tiles(4096, 4096):
        areas.append(w * h)
        cut.spent(w * h, w * h * rate)
        assert x + w <= 4096
        assert y + h <= 4096
    assert sum(areas) == 4096 * 4096
    seconds = np.array(areas) * rate
    assert seconds[:3].max() <= max(0.01, 256 * rate)  # no rate was measured
    whole = seconds[len(seconds) // 2 :]
    assert whole.max() <= max(0.011, 256 * rate)
    assert np.median(whole) >= min(0.005, 256 * rate)
    assert max(areas) * cut._guess <= max(launch._DEAF, 256 * cut._guess)
    tiles = cut.tiles(4096, 4096)
    first = next(tiles)
    cut.spent(256, 0.02)  # a longer time is adopted at once
    assert np.prod(first[2:]) >= np.prod(next(tiles)[2:])
    cut.expect(rate)
    assert cut._per_pixel == pytest.approx(3 * rate)
