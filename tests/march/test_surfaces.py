"""Surfaces inside each other: against closed forms, and what is refused. Parity with the reference is in test_march, test_clip and
test_missing; bricks, clusters and skipping are in the tests of all modes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolWarning, OptionError
from clvol.device import Device

STRAIGHT = clvol.Camera.orbit(0, 0, projection="orthographic", fit="volume")
SHELLS = [(4.0, "red", 0.25), (6.0, "lime", 0.5), (8.0, "blue", 0.3)]


def radius(n: int = 24) -> clvol.Volume:
    """Squared distance from the middle, over n / 2: a cubic spline but for the faces, whose surfaces are spheres."""
    x = np.arange(n) - (n - 1) / 2
    return clvol.Volume((x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) / (n / 2))


def crossings(volume: clvol.Volume, shown: list[tuple[float, str, float]], **options: Any) -> Any:
    """The picture of the ray through the middle, of its colours alone."""
    look = {"mode": "surfaces", "surfaces": shown, "shading": False, "background": None}
    return clvol.render(volume, STRAIGHT, size=(1, 1), rays=1, **look, **options)[0, 0]


def test_each_crossing_stops_its_share_of_the_light(device: Device) -> None:
    colors = {"red": (1, 0, 0), "lime": (0, 1, 0), "blue": (0, 0, 1)}
    rgb, light = np.zeros(3), 1.0
    for value, name, opacity in sorted(SHELLS, reverse=True) + sorted(SHELLS):  # outside in, and out again
        del value
        rgb += light * opacity * np.array(colors[name])
        light *= 1 - opacity
    for shown in (SHELLS, SHELLS[::-1]):  # the order in which they are listed is nothing
        got = crossings(radius(), shown, device=device)
        np.testing.assert_allclose(got, [*rgb / (1 - light), 1 - light], atol=2e-6)


def test_both_sides_of_a_shell_within_a_cell_are_seen(device: Device) -> None:
    """A ray touches a ball 0.02 voxels deep: two crossings between any samples that it could take."""
    volume = radius()
    (picture,) = (
        clvol.render(
            volume,
            clvol.Camera.look_at((x, 11.5, -90.0), (x, 11.5, 0.0), up=(0, 1, 0), projection="orthographic"),
            "surfaces",
            (1, 1),
            surfaces=[(5.0, "white", 0.5)],
            shading=False,
            background=None,
            rays=1,
            device=device,
        )
        for x in (11.5 + np.sqrt(5.0 * 12) - 1e-5,)
    )
    np.testing.assert_allclose(picture[0, 0, 3], 0.75, atol=1e-6)


def test_one_opaque_surface_is_the_isosurface(device: Device) -> None:
    volume, camera = clvol.phantoms.marschner_lobb(20), clvol.Camera.orbit(20, 30)
    one = clvol.render(volume, camera, "isosurface", (48, 40), isovalue=0.5, color="tan", device=device)
    same = clvol.render(volume, camera, "surfaces", (48, 40), surfaces=[(0.5, "tan")], device=device)
    np.testing.assert_array_equal(one, same)


def test_an_opaque_core_hides_what_is_behind(device: Device) -> None:
    volume = radius()
    outer = {"surfaces": [(8.0, "white", 0.4), (2.0, "red", 1)], "mode": "surfaces", "size": (40, 40), "device": device}
    pictures = clvol.render(volume, STRAIGHT, outputs=("rgba", "depth", "normal", "position"), background=None, **outer)
    assert pictures["rgba"][20, 20, 3] == 1
    core = np.linalg.norm(pictures["position"] - 11.5, axis=-1)
    hit = np.isfinite(pictures["depth"])
    assert 0 < hit.sum() < hit.size  # where two crossings of 0.4 stop more than half of the light, the second one does
    inner = core < 6
    np.testing.assert_allclose(core[hit & inner], np.sqrt(2.0 * 12), atol=5e-4)
    np.testing.assert_allclose(core[hit & ~inner], np.sqrt(8.0 * 12), atol=0.015)
    assert (pictures["normal"][hit] @ STRAIGHT.view(volume).forward <= 0.01).all()


def test_text_and_standard_deviations(device: Device) -> None:
    volume = clvol.phantoms.marschner_lobb(20)
    look: dict[str, Any] = {"mode": "surfaces", "size": (24, 24), "device": device}
    text = clvol.render(volume, surfaces=" 0.3 : bisque : 0.3, 0.6:#ff0000", **look)
    np.testing.assert_array_equal(text, clvol.render(volume, surfaces=[(0.6, (1, 0, 0), 1), (0.3, "bisque", 0.3)], **look))
    settled = clvol.Surfaces("1 sigma:red,0.1:blue:0.5").settled(volume)
    assert settled.isovalues == (0.1, pytest.approx(volume.data.mean(dtype=float) + volume.data.std(dtype=float), rel=1e-6))
    automatic = clvol.Surfaces().settled(volume)
    assert automatic.isovalues[0] == clvol.Isosurface().settled(volume).isovalue < automatic.isovalues[1]


WRONG: dict[str, tuple[Any, str]] = {
    "none": ([], "surfaces must be 1 to 8"),
    "nine": ([(v, "red") for v in range(9)], "surfaces must be 1 to 8"),
    "a number": (3.0, "surfaces must be 1 to 8"),
    "a value alone": ([0.5], "a surface must be"),
    "no colour": ("0.5", "a surface must be"),
    "four": ([(0.5, "red", 1, 1)], "a surface must be"),
    "a colour that is none": ([(0.5, "rouge")], "a surface's color must be"),
    "NaN": ([(float("nan"), "red")], "a surface's isovalue must be"),
    "words": ("half:red", "an isovalue must be a number, or standard deviations"),
    "opacity": ([(0.5, "red", 1.5)], "a surface's opacity must be"),
    "opacity in words": ("0.5:red:much", "a surface's opacity must be"),
    "one twice": ([(0.5, "red"), (0.5, "blue")], "different isovalues; got 0.5 twice"),
}


@pytest.mark.parametrize("case", WRONG)
def test_surfaces_that_are_none(case: str, device: Device) -> None:
    given, words = WRONG[case]
    with pytest.raises(OptionError, match=words):
        clvol.render(clvol.phantoms.marschner_lobb(8), mode="surfaces", surfaces=given, size=(8, 8), device=device)


def test_labels_and_surfaces_outside_the_range(device: Device) -> None:
    labels = clvol.Volume(np.ones((6, 6, 6), np.uint8), labels=True)
    with pytest.raises(OptionError, match="labels are names"):
        clvol.render(labels, mode="surfaces", size=(8, 8), device=device)
    two = clvol.Scene([clvol.Medium(clvol.phantoms.sphere(8)), clvol.Medium(clvol.phantoms.marschner_lobb(8))])
    with pytest.raises(OptionError, match="'surfaces' draws one medium"):
        clvol.render(two, mode="surfaces", size=(8, 8), device=device)
    with pytest.warns(ClvolWarning, match="isovalues 7 and 9 are outside the samples, which are from 0"):
        clvol.render(clvol.phantoms.marschner_lobb(8), mode="surfaces", surfaces="7:red,9:tan", size=(8, 8), device=device)
