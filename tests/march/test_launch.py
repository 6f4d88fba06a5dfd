"""The ray loop in segments: separately marched and merged segments of the rays make the same picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.march.frame import Frame, Subject
from clvol.march.launch import States, draw, finish_states, march_rays, merge_states
from clvol.march.options import ResolvedLook
from clvol.march.renderer import Renderer
from clvol.phantoms import marschner_lobb
from clvol.scene.camera import Camera
from clvol.scene.clip import Clip, Corner
from clvol.scene.mode import as_mode
from clvol.scene.scene import Scene
from clvol.scene.transfer import TransferFunction
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.minmax import MinMax
from tests import cases
from tests.march.looks import TILES, suited

SIZE = (41, 35)
TRANSFER = TransferFunction(((0.0, "navy"), (0.5, "orange"), (1.0, "white")), ((0.2, 0.0), (0.5, 0.25), (1.0, 0.9)))
EXACT = [name for name in cases.MODES if name not in ("composite", "surfaces", "mean", "integral")]  # nothing accumulates
SURFACES = ((0.3, "tan", 0.4), (0.5, "teal", 0.5), (0.7, "red", 1))  # in ascending order, as settled
CAMERAS = {
    "across": Camera.orbit(25, 35, fit="volume"),
    "along an axis": Camera.orbit(0, 0, projection="orthographic", fit="volume"),
    "oblique": Camera.orbit(40, -30, fov=120, fit="volume"),  # some rays step along their own direction
}


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[Renderer]:
    with Renderer(marschner_lobb(24), device=device) as made:
        yield made


def frame_of(
    renderer: Renderer, mode: str, camera: Camera, *, skipping: bool = True, termination: float = 0.0, clip: Clip | None = None
) -> Frame:
    evaluator = choose_evaluator(renderer.device, renderer.filter)
    chosen = as_mode(mode, suited(mode, {"isovalue": 0.5, "surfaces": SURFACES, "termination": termination}))
    scene = Scene(renderer.volume, background=None, clip=clip)
    look = ResolvedLook(camera, chosen, scene, TRANSFER, central=False, skipping=skipping, preview=renderer.volume)
    coefficients = renderer.field.coefficients
    minmax = MinMax(coefficients, evaluator) if skipping and chosen.skips else None
    return Subject(look, coefficients, minmax, evaluator).frame(SIZE, 0.5, guides=True)


def check(got: dict[str, NDArray[Any]], want: dict[str, NDArray[Any]], mode: str, *, carried: bool = False) -> None:
    assert np.isfinite(want["depth"]).any() or mode in ("mean", "integral")
    assert want["rgba"][..., 3].max() == 1 if mode not in ("composite", "surfaces") else want["rgba"][..., 3].max() > 0.5
    for name in ("rgba", "depth", "normal", "position"):
        if mode in EXACT or carried:
            np.testing.assert_array_equal(got[name], want[name], err_msg=name)
    # transparent pixels are divided by their opacity, which magnifies rounding
    seen = want["rgba"][..., 3] > 0.01
    np.testing.assert_allclose(got["rgba"][..., 3], want["rgba"][..., 3], rtol=0, atol=1e-6)
    cover = want["rgba"][..., 3:]
    np.testing.assert_allclose((got["rgba"] * cover)[seen], (want["rgba"] * cover)[seen], rtol=0, atol=1e-6)


@pytest.mark.one_in(16)
@pytest.mark.parametrize(("mode", "tile"), [*product(cases.MODES, ["planes", "rays"])])
def test_two_merged_halves_of_the_rays_make_the_picture(renderer: Renderer, mode: str, tile: str) -> None:
    with renderer.device.limited(tile=TILES[tile]):
        for camera in CAMERAS.values():
            frame = frame_of(renderer, mode, camera)
            whole = draw(frame)
            for middle in (3, frame.planes.count // 2, 10**6):
                with march_rays(frame, last=middle - 1) as front, march_rays(frame, middle) as back:
                    check(finish_states(merge_states(front, back)), whole, mode)


@pytest.mark.one_in(14)
@pytest.mark.parametrize("mode", cases.MODES)
def test_continued_states_make_the_picture_to_the_last_bit(renderer: Renderer, mode: str) -> None:
    """In segments of any length, with and without skipping."""
    for skipping in (True, False):
        frame = frame_of(renderer, mode, CAMERAS["across"], skipping=skipping)
        whole, states, first = draw(frame), None, -np.inf
        for last in (0, 1, 7, 20, np.inf):
            states = march_rays(frame, first, last, states)
            first = last + 1
        assert isinstance(states, States)
        with states:
            check(finish_states(states), whole, mode, carried=True)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["composite", "mean", "mip"])
def test_segmented_rays_of_few_samples_make_the_picture_to_the_last_bit(renderer: Renderer, mode: str) -> None:
    """Rays between two planes have one sample, wherever they are split; others have two ends."""
    x, y, z = renderer.volume.center
    for thick in (0.3, 1.4):
        clip = (x, y, z), (math.inf, y + thick * renderer.volume.spacing[1], math.inf)
        frame = frame_of(renderer, mode, Camera.orbit(10, 70, fit="volume"), clip=clip)
        whole, states, first = draw(frame), None, -np.inf
        assert (whole["rgba"][..., 3] > 0).any()
        for last in (*range(4, 40, 3), np.inf):
            states = march_rays(frame, first, last, states)
            first = last + 1
        assert isinstance(states, States)
        with states:
            for name, picture in finish_states(states).items():
                np.testing.assert_array_equal(picture, whole[name], err_msg=name)


@pytest.mark.one_in(14)
@pytest.mark.parametrize("mode", cases.MODES)
def test_segmented_rays_with_gaps_make_the_picture_to_the_last_bit(renderer: Renderer, mode: str) -> None:
    """Two corners, one thinner than a step, leave three parts of some rays, whose ends share sample numbers."""
    x, y, z = map(float, renderer.volume.center)
    thin, inf = 0.3 * renderer.volume.spacing[1], math.inf
    gaps = [Corner((-inf, y + 0.2, -inf), (inf, y + 0.2 + thin, inf)), Corner((x - 0.4, y - 0.5, -inf), (inf, y - 0.2, z + 0.3))]
    for camera in CAMERAS.values():
        frame = frame_of(renderer, mode, camera, clip=gaps)
        whole, states, first = draw(frame), None, -np.inf
        for last in (*range(2, 40, 3), np.inf):
            states = march_rays(frame, first, last, states)
            first = last + 1
        assert isinstance(states, States)
        with states:
            check(finish_states(states), whole, mode, carried=True)
        with march_rays(frame, last=11) as front, march_rays(frame, 12) as back:
            check(finish_states(merge_states(front, back)), whole, mode)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", cases.MODES)
def test_merging_is_associative(renderer: Renderer, mode: str) -> None:
    """(a b) c and a (b c)."""
    frame = frame_of(renderer, mode, CAMERAS["across"])
    pictures = []
    for left in (True, False):
        a, b, c = march_rays(frame, last=9), march_rays(frame, 10, 19), march_rays(frame, 20)
        merged = merge_states(merge_states(a, b), c) if left else merge_states(a, merge_states(b, c))
        pictures.append(finish_states(merged))
        for states in (a, b, c):
            states.release()
    np.testing.assert_allclose(pictures[0]["rgba"], pictures[1]["rgba"], rtol=0, atol=2e-6)
    if mode in EXACT:
        np.testing.assert_array_equal(pictures[0]["depth"], pictures[1]["depth"])


@pytest.mark.parametrize("termination", [1e-3, 0.1])
def test_merged_light_is_exact_within_early_termination(renderer: Renderer, termination: float) -> None:
    frame = frame_of(renderer, "composite", CAMERAS["across"], termination=termination)
    whole = draw(frame)["rgba"]
    with march_rays(frame, last=9) as front, march_rays(frame, 10) as back:
        merged = finish_states(merge_states(front, back))["rgba"]
    difference = np.abs((merged * merged[..., 3:]) - (whole * whole[..., 3:]))
    assert difference.max() <= 2 * termination + 1e-6  # the colours and the opacity


def test_states_of_another_picture_and_released_ones_are_rejected(renderer: Renderer) -> None:
    frame, other = frame_of(renderer, "mip", CAMERAS["across"]), frame_of(renderer, "minip", CAMERAS["across"])
    with march_rays(frame) as states, march_rays(other) as foreign:
        for call in (lambda: merge_states(states, foreign), lambda: march_rays(other, states=states)):
            with pytest.raises(OptionError, match="states must be of one picture's size, mode and volume"):
                call()
        states.release()
        calls = (
            lambda: merge_states(states, foreign),
            lambda: merge_states(foreign, states),
            lambda: march_rays(frame, states=states),
            lambda: finish_states(states),
        )
        for call in calls:
            with pytest.raises(OptionError, match=r"released|states must be of one"):
                call()


def test_every_sample_is_gathered_once(renderer: Renderer) -> None:
    """The fractions of samples add up; nothing is skipped here."""
    frame = frame_of(renderer, "mean", CAMERAS["across"])
    with march_rays(frame, last=11) as front, march_rays(frame, 12) as back:
        visited = finish_states(merge_states(front, back))["visited"]
    assert np.nanmin(visited) == np.nanmax(visited) == 1


def test_half_of_the_rays_are_half_of_the_picture(renderer: Renderer) -> None:
    """So that the tests above would detect ignored sample numbers."""
    frame = frame_of(renderer, "composite", CAMERAS["across"])
    whole = draw(frame)["rgba"]
    with march_rays(frame, last=frame.planes.count // 2) as front:
        half = finish_states(front)["rgba"]
    assert (half[..., 3] <= whole[..., 3] + 1e-6).all()
    assert np.abs(half - whole).max() > 0.1
