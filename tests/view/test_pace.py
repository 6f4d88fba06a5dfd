"""The pace of a drag: size and step of its pictures, and how they are sent."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

import clvol
from clvol.device import Device
from clvol.view import State, View
from clvol.view.control import Control
from clvol.view.drawing import Drawer, Order, jpeg
from clvol.view.pace import LEAST_WIDTH, Pace

WHOLE, SECONDS = (640, 512), 0.04


def dragged(time: float, per_pixel: float, power: float = 1.0, count: int = 12) -> tuple[list[int], list[float]]:
    """Widths and steps of the pictures of a drag that take ``time + per_pixel · pixels`` with the finest step."""
    pace, widths, steps = Pace(), [], []
    for _ in range(count):
        size, step = pace.choose("mip", WHOLE, 0.5, 8.0, SECONDS)
        widths.append(size[0])
        steps.append(step)
        pace.took("mip", size, step, (time + per_pixel * size[0] * size[1]) * (0.5 / step) ** power)
    return widths, steps


def test_sizes_and_steps_follow_from_times() -> None:
    assert dragged(1e-4, 1e-8)[0][1:] == [640] * 11  # all pixels, where they are in time
    assert dragged(1e-4, 1e-8)[1][1:] == [0.5] * 11
    for time, per_pixel, power in ((0.045, 1e-8, 0.8), (0.1, 5e-7, 1.0), (0.12, 1e-7, 0.6), (0.02, 1e-6, 0.9)):
        widths, steps = dragged(time, per_pixel, power)
        assert min(widths[3:]) >= 280  # where time does not fall with pixels, steps become longer
        assert len(set(steps[4:])) == 1  # and stay
        assert (time + per_pixel * widths[-1] ** 2 * 0.8) * (0.5 / steps[-1]) ** power < 1.3 * SECONDS
    assert dragged(10.0, 1e-5)[0][-1] == LEAST_WIDTH  # never less, however long it takes
    assert dragged(10.0, 1e-5)[1][-1] == 8.0


def test_the_sizes_of_a_drag_do_not_alternate() -> None:
    """However times vary, by a quarter."""
    pace, shown = Pace(), []
    for i in range(24):
        size, step = pace.choose("mip", WHOLE, 0.5, 8.0, SECONDS)
        shown.append((size, step))
        pace.took("mip", size, step, (0.9, 1.15)[i % 2] * (0.03 + 4e-7 * size[0] * size[1]) * (0.5 / step) ** 0.8)
    assert len(set(shown[4:])) == 1


def test_the_first_goes_by_the_picture_at_rest() -> None:
    pace = Pace()
    pace.rested("mip", WHOLE, 0.5, 0.01)
    assert pace.choose("mip", WHOLE, 0.5, 8.0, SECONDS) == (WHOLE, 0.5)
    pace.rested("mip", WHOLE, 0.5, 100.0)
    assert pace.choose("mip", WHOLE, 0.5, 0.0, SECONDS) == ((LEAST_WIDTH, 160), 0.5)  # and no step longer than of use
    assert pace.choose("mip", (90, 40), 0.5, 0.0, SECONDS)[0] == (90, 40)  # of a narrow pane all


@pytest.mark.parametrize(("mode", "step"), [("minip", 8.0), ("isosurface", 0.5)])
def test_pictures_of_a_drag_are_never_narrow(device: Device, mode: str, step: float) -> None:
    view = View(clvol.phantoms.marschner_lobb(16), device=device)
    state = State(mode=mode)
    drawer, context = Drawer(view.resident), Control(view.resident, state).context()
    order = Order(context, state, "3d", (400, 60), budget=1e-9, coarse=True)
    list(drawer.shots(order._replace(coarse=False)))
    for _ in range(3):
        (shot,) = drawer.shots(order)
        assert (shot.pixels.shape[1], shot.final) == (LEAST_WIDTH, False)
    assert shot.step == pytest.approx(step)


@pytest.mark.parametrize(("size", "halved"), [((200, 300), 1), ((800, 600), 2)])
def test_small_pictures_keep_the_colours_of_each_pixel(size: tuple[int, int], halved: int) -> None:
    with Image.open(io.BytesIO(jpeg(np.zeros((*size, 4), np.uint8), 85))) as image:
        assert image.layer[0][1:3] == (halved, halved)  # type: ignore[attr-defined]  # of JPEG: brightness beside colours
