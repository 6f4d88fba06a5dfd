"""Cameras and options between key frames, beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.scene.keyframes import Keyframes, camera_between

VOLUME = clvol.phantoms.sphere(8)


@pytest.mark.parametrize(
    ("first", "last"),
    [((0, 20), (90, 20)), ((10, 0), (10, 80)), ((30, 25), (210, 25)), ((0, 90), (0, 0)), ((300, -10), (350, -10))],
)
def test_cameras_of_an_orbit_stay_on_it(first: tuple[float, float], last: tuple[float, float]) -> None:
    """Between two azimuths at one elevation, or two elevations at one azimuth, and over half a turn the way azimuth grows."""
    a, b = (clvol.Camera.orbit(*at, zoom=2, distance=9) for at in (first, last))
    for share in (0.25, 0.5, 0.9):
        azimuth, elevation = ((1 - share) * x + share * y for x, y in zip(first, last, strict=True))
        got, want = (one.view(VOLUME) for one in (camera_between(a, b, share), clvol.Camera.orbit(azimuth, elevation, 9, 2)))
        for what in ("eye", "right", "up", "forward"):
            np.testing.assert_allclose(getattr(got, what), getattr(want, what), atol=1e-12)
        assert got.half_height == want.half_height


def test_cameras_turn_evenly_about_one_axis() -> None:
    """The angle between two orientations along the way is its share of the whole."""
    a, b = clvol.Camera.orbit(10, 60), clvol.Camera.orbit(140, -30)
    views = [camera_between(a, b, share).view(VOLUME) for share in np.linspace(0, 1, 6)]
    frames = [np.stack([view.right, view.up, view.forward]) for view in views]
    angles = [np.degrees(np.arccos((np.trace(one @ frames[0].T) - 1) / 2)) for one in frames[1:]]
    np.testing.assert_allclose(angles, angles[-1] * np.linspace(0.2, 1, 5), rtol=1e-6)


def test_placed_cameras_move_around_their_targets() -> None:
    a = clvol.Camera.look_at((10, 0, 0), (0, 0, 0))
    b = clvol.Camera.look_at((0, 20, 4), (0, 0, 4))
    middle = camera_between(a, b, 0.5)
    assert middle.target == (0, 0, 2)
    np.testing.assert_allclose(middle.position, (15 * np.sqrt(0.5), 15 * np.sqrt(0.5), 2), atol=1e-12)


@pytest.mark.parametrize(
    ("first", "last", "middle"),
    [
        (2, 4, 3.0),
        ((0, 2), (4, 3), (2.0, 2.5)),
        ([(0, 0), (10, 1)], [(2, 0), (20, 0.5)], ((1.0, 0.0), (15.0, 0.75))),
        (clvol.Plane((0, 0, 1), (0, 0, 0)), clvol.Plane((0, 1, 0), (0, 0, 4)), clvol.Plane((0, 1, 1), (0, 0, 2))),
        ("magma", "viridis", "magma"),
        (True, False, True),
    ],
)
def test_values_between_key_frames(first: object, last: object, middle: object) -> None:
    keys = Keyframes({0.25: {"some": first}, 0.75: {"some": last}})
    assert keys.options(0.5)["some"] == middle
    assert keys.options(0.1)["some"] == keys.options(0.25)["some"] == first
    assert keys.options(0.75)["some"] == keys.options(1)["some"] == last


def test_colours_and_counts() -> None:
    keys = Keyframes({0: {"background": "white", "rays": 1}, 1: {"background": (0, 0, 0), "rays": 9}})
    assert keys.options(0.25) == {"background": (0.75, 0.75, 0.75), "rays": 1}
    assert Keyframes({0: {"virtual": 2}, 1: {"virtual": 3.0}}).options(0.5) == {"virtual": 2}
    with pytest.raises(OptionError, match=r"virtual of key frames must be whole numbers; got 2.5 at 1"):
        Keyframes({0: {"virtual": 2}, 1: {"virtual": 2.5}})


@pytest.mark.parametrize(
    ("first", "last", "says"),
    [
        (1, None, "some of key frames must be of one kind, with as many numbers in each; got 1 and None"),
        ((1, 2), (1, 2, 3), "as many numbers"),
        (1, (2, 3), "of one kind"),
        (clvol.Camera.orbit(), clvol.Camera.orbit(distance=3), "must both have a distance, or none"),
        (clvol.Camera.orbit(), clvol.Camera.orbit(projection="orthographic"), "must have one projection"),
        (clvol.Camera(position=(1, 2, 3)), clvol.Camera(position=(2, 2, 3)), "must have a target"),
    ],
    ids=str,
)
def test_values_that_have_nothing_between_them(first: object, last: object, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        Keyframes({0: {"some": first}, 1: {"some": last}})
