"""Slices and the 3-D picture of scenes, in one picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.bricks.field import as_lazy

pytestmark = pytest.mark.usefixtures("device")

SIZE: dict[str, Any] = {"size": (84, 84), "mode": "mip"}  # panes of 40 × 40


def test_media_lie_over_the_slices_of_the_first_as_far_as_they_are_opaque() -> None:
    ball = clvol.phantoms.sphere(16)
    half = clvol.Volume(ball.data[8:], ball.spacing, (*ball.origin[:2], ball.origin[2] + 8 * ball.spacing[2]))
    red = clvol.TransferFunction([(0, "red")], [(0, 0.25)])
    scene = clvol.Scene([clvol.Medium(ball, filter="linear"), clvol.Medium(half, red)])
    plain, both = clvol.orthogonal(ball, filter="linear", **SIZE), clvol.orthogonal(scene, **SIZE)
    np.testing.assert_array_equal(both[:40, 44:], clvol.render(scene, size=(40, 40), mode="mip"))
    for name, left in (("y", 0), ("x", 44)):
        gray, mixed = (np.asarray(picture[44:, left : left + 40]) for picture in (plain, both))
        upper = slice(4, 18)  # where z is above the middle, in the volume and in its margin
        inside = gray[upper, :, 0] > 0
        np.testing.assert_allclose(mixed[upper][inside], 0.75 * gray[upper][inside] + (0.25, 0, 0, 0.25), atol=1e-6, err_msg=name)
        np.testing.assert_array_equal(mixed[22:], gray[22:])
    lazy = clvol.Scene([clvol.Medium(as_lazy(one.volume), one.transfer, filter=one.filter) for one in scene.media])
    np.testing.assert_allclose(clvol.orthogonal(lazy, **SIZE), both, atol=1e-6)


def test_a_slice_is_of_one_medium() -> None:
    ball = clvol.phantoms.sphere(16)
    left_out = np.arange(16) < 8
    medium = clvol.Medium(ball, filter="linear", boundary="reflect", mask=np.broadcast_to(left_out, ball.shape))
    masked = clvol.slice(ball, "y", size=(20, 20), filter="linear", boundary="reflect", mask=np.broadcast_to(left_out, ball.shape))
    np.testing.assert_array_equal(clvol.slice(medium, "y", size=(20, 20)), masked)
    with pytest.raises(OptionError, match="filter must be left to the medium"):
        clvol.slice(medium, "y", filter="linear")
    with pytest.raises(OptionError, match=r"a slice is of one medium; got a scene of 2: give one of scene.media"):
        clvol.slice(clvol.Scene([ball, ball]), "y")
