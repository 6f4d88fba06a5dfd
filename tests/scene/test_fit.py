"""Fitting cameras: balls at known positions, noise, boxes, and empty volumes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clvol import Camera, TransferFunction, Volume
from clvol.base.errors import OptionError
from clvol.scene.fit import fitted, sphere_of_matter
from clvol.scene.joint import TransferFunction2D
from clvol.scene.mode import as_mode

TURNED = Rotation.from_euler("xyz", [20, -35, 50], True).as_matrix()
SEEN = TransferFunction(((0.0, "black"), (1.0, "white")), ((0.0, 0.0), (0.0, 0.5)))
GREY = TransferFunction.ramp((0.0, 6.0))
MODES: dict[str, tuple[Any, TransferFunction]] = {
    "isosurface": (as_mode("isosurface", {"isovalue": 0.0}), SEEN),
    "composite": (as_mode("composite"), SEEN),
    "mip": (as_mode("mip"), GREY),
}


def ball(middle: tuple[float, float, float] = (44, 20, 30), radius: float = 9.0, **geometry: Any) -> Volume:
    """How deep samples lie in a ball, in samples; (x, y, z)."""
    z, y, x = np.indices((50, 60, 64))
    depth = radius - np.sqrt((x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - middle[2]) ** 2)
    return Volume(depth.astype(np.float32), **geometry)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "place", [{}, {"spacing": (0.2,) * 3, "origin": (5, -90, 3), "direction": TURNED}], ids=["plain", "turned"]
)
def test_a_ball_is_found(mode: str, place: dict[str, Any]) -> None:
    volume = ball(**place)
    sphere = sphere_of_matter(volume, *MODES[mode])
    unit = volume.spacing[0]
    np.testing.assert_allclose(sphere.center, volume.index_to_world((44, 20, 30)), atol=0.8 * unit)
    assert 9 * unit < sphere.radius < 11.5 * unit


def test_unequal_spacings_make_the_ball_an_ellipsoid() -> None:
    sphere = sphere_of_matter(ball(spacing=(1.0, 1.0, 3.0)), *MODES["isosurface"])
    np.testing.assert_allclose(sphere.center, (44, 20, 90), atol=1.5)
    assert 27 < sphere.radius < 33


def test_a_clip_box_cuts_the_matter() -> None:
    box = ((0.0, 0.0, 0.0), (40.0, 60.0, 50.0))  # leaves the cap beyond x = 4 left of the middle
    sphere = sphere_of_matter(ball(), *MODES["composite"], clip=box)
    cap = math.sqrt(9**2 - 4**2)
    assert cap < sphere.radius < cap + 2
    assert sphere.center[0] < 40
    aside = sphere_of_matter(ball(), *MODES["composite"], clip=((0, 0, 0), (10, 10, 10)))
    assert aside.radius == ball().radius


def test_only_visible_opacities_count() -> None:
    """A haze below 1/50 of the largest opacity does not count as matter."""
    hazy = TransferFunction(((0.0, "white"),), ((-99.0, 0.005), (0.0, 0.005), (0.0, 0.5)))
    assert sphere_of_matter(ball(), as_mode("composite"), hazy).radius < 11.5
    thick = hazy.with_opacity(((-99.0, 0.1), (0.0, 0.1), (0.0, 0.5)))
    assert sphere_of_matter(ball(), as_mode("composite"), thick).radius == ball().radius


@pytest.mark.parametrize("thinned", [False, True])
@pytest.mark.parametrize(
    "edges",
    [
        replace(SEEN, opacities=((0.0, 0.5),), gradient_opacity=((0.3, 0.0), (0.6, 1.0))),
        TransferFunction2D([((-3.0, 3.0), (0.4, None), "white", 0.5)]),
    ],
    ids=["factor", "box"],
)
def test_opacity_by_the_gradient_counts(edges: TransferFunction, *, thinned: bool) -> None:
    """Even matter, inside the ball and around it, is transparent; of a large volume, neighbours of samples say how steep it is."""
    step = np.clip(ball().data, -1, 1)
    volume = Volume(step.repeat(2, 2) if thinned else step, spacing=(0.5 if thinned else 1.0, 1.0, 1.0))
    sphere = sphere_of_matter(volume, as_mode("composite"), edges)
    np.testing.assert_allclose(sphere.center, (44, 20, 30), atol=0.8)
    assert 9 < sphere.radius < 12.5


@pytest.mark.parametrize("mode", MODES)
def test_specks_of_noise_do_not_count(mode: str) -> None:
    volume = ball()
    data = volume.data.copy()
    data[np.random.default_rng(0).random(data.shape) < 5e-4] = 5.0
    assert sphere_of_matter(replace(volume, data=data), *MODES[mode]).radius < 16  # but those next to it, as of 50 with all
    lonely = np.zeros((40, 40, 40), np.float32)
    lonely[30, 20, 10] = 5.0  # the whole volume
    assert sphere_of_matter(Volume(lonely), *MODES["mip"]).radius < 3


def test_large_volumes_are_subsampled() -> None:
    data = np.zeros((130, 200, 260), np.uint8)
    data[60:100, 20:60, 200:240] = 7
    sphere = sphere_of_matter(Volume(data), as_mode("composite"), TransferFunction(SEEN.colors, ((0.5, 0.0), (0.5, 0.5))))
    np.testing.assert_allclose(sphere.center, (219.5, 39.5, 79.5), atol=4)
    corner = 20 * math.sqrt(3)
    assert corner < sphere.radius < corner + 6


@pytest.mark.parametrize("data", [np.zeros((9, 8, 7)), np.ones((1, 1, 1)), np.full((5, 5, 5), 3.0)])
def test_an_invisible_volume_is_fitted_to_its_box(data: np.ndarray) -> None:
    volume = Volume(data)
    for mode in (as_mode("isosurface", {"isovalue": 2.0}), as_mode("composite")):
        sphere = sphere_of_matter(volume, mode, TransferFunction(((0.0, "white"),), ((0.0, 0.0),)))
        assert sphere.radius == volume.radius
        np.testing.assert_allclose(sphere.center, volume.center)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("elevation", [-70, 0, 20, 90])
@pytest.mark.parametrize("aspect", [0.5, 1.5])
def test_orbits_are_steady_and_contain_the_matter(projection: Any, elevation: float, aspect: float) -> None:
    data = np.zeros((40, 40, 40), np.uint8)
    data[5:9, 4:30, 6:34] = data[5:30, 20:26, 30:34] = 1  # a slab with a column on one side
    volume, look = Volume(data), (as_mode("composite"), TransferFunction(SEEN.colors, ((0.5, 0.0), (0.5, 0.5))))
    corners = np.array(
        [[x, y, z] for x in (6, 33) for y in (4, 29) for z in (5, 8)] + [[x, y, 29] for x in (30, 33) for y in (20, 25)]
    )
    seen = []
    for azimuth in range(0, 360, 30):
        view = fitted(Camera.orbit(azimuth, elevation, projection=projection), volume, *look, aspect=aspect).view(volume, aspect)
        away = corners - view.eye
        far = 1.0 if view.orthographic else away @ view.forward
        x, y = (away @ way / far / view.half_height for way in (view.right, view.up))
        assert np.abs(x).max() < aspect
        assert np.abs(y).max() < 1
        seen.append((view.eye[2], view.half_height))
    np.testing.assert_allclose(seen, [seen[0]] * len(seen), rtol=1e-9)


GIVEN = [{"target": (1, 2, 3)}, {"distance": 4.0}, {"position": (9, 9, 9)}, {"radius": 2.0}, {"fit": "volume"}]


@pytest.mark.parametrize("given", GIVEN)
def test_given_options_are_kept(given: dict[str, Any]) -> None:
    camera = Camera(**given)
    assert fitted(camera, ball(), *MODES["isosurface"]) is camera


def test_a_radius_fills_the_picture() -> None:
    volume = ball()
    view = Camera(target=(1, 2, 3), radius=5.0, projection="orthographic").view(volume, 2.0)
    assert view.half_height == 5
    with pytest.raises(OptionError, match="fit must be one of matter, volume; got 'all'"):
        Camera(fit="all")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="radius must be a finite number, greater than 0"):
        Camera(radius=0)
