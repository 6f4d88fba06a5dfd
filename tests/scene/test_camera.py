"""Cameras: direction, field of view, and invalid arguments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol.base.errors import ClvolError, GeometryError, OptionError
from clvol.device import Device
from clvol.march.renderer import render
from clvol.scene.camera import Camera
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume
from tests.cases import BAD_NUMBERS, BAD_VECTORS, every

BOX = Volume(np.zeros((20, 30, 40), np.float32), (1.0, 0.5, 2.0), (7, -5, 3))
ANGLES = [(0, 0), (30, 20), (90, 0), (-135, 45), (180, -60), (20, 90), (20, -90), (725, 400)]


@pytest.mark.parametrize(("azimuth", "elevation"), ANGLES)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_views_are_orthonormal_and_look_at_the_target(azimuth: float, elevation: float, projection: Any) -> None:
    view = Camera.orbit(azimuth, elevation, projection=projection).view(BOX, 1.5)
    axes = np.stack([view.right, view.up, -view.forward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)  # right-handed: x right, y up, z back
    to = BOX.center - view.eye
    np.testing.assert_allclose(to / np.linalg.norm(to), view.forward, atol=1e-12)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "forward", "right", "up"),
    [
        (0, 0, (0, 1, 0), (1, 0, 0), (0, 0, 1)),
        (90, 0, (-1, 0, 0), (0, 1, 0), (0, 0, 1)),
        (180, 0, (0, -1, 0), (-1, 0, 0), (0, 0, 1)),
        (0, 90, (0, 0, -1), (1, 0, 0), (0, 1, 0)),
        (0, -90, (0, 0, 1), (1, 0, 0), (0, -1, 0)),
        (90, 90, (0, 0, -1), (0, 1, 0), (-1, 0, 0)),
    ],
)
def test_orbit_angles(azimuth: float, elevation: float, forward: Any, right: Any, up: Any) -> None:
    view = Camera.orbit(azimuth, elevation).view(BOX)
    np.testing.assert_allclose(view.forward, forward, atol=1e-12)
    np.testing.assert_allclose(view.right, right, atol=1e-12)
    np.testing.assert_allclose(view.up, up, atol=1e-12)


def test_a_misspelt_option_of_an_orbit_is_recognized() -> None:
    with pytest.raises(TypeError, match=r"'elevaton'.*elevation"):
        Camera.orbit(elevaton=3)


# where the corner (x, z) = (far, far) of a marked voxel appears when seen from azimuth and elevation: [down, right]
CORNERS = [
    ((9, 0, 9), 0, 0, "top right"),
    ((0, 0, 9), 0, 0, "top left"),
    ((9, 0, 0), 0, 0, "bottom right"),
    ((9, 9, 9), 90, 0, "top right"),  # from +x, +y lies to the right
    ((9, 0, 9), 90, 0, "top left"),
    ((0, 9, 9), 180, 0, "top right"),
    ((9, 9, 9), 0, 90, "top right"),  # from above, +y is up
    ((9, 0, 9), 0, 90, "bottom right"),
    ((9, 0, 0), 0, -90, "top right"),  # from below, +y is down
]


@pytest.mark.parametrize(("corner", "azimuth", "elevation", "where"), CORNERS)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_marked_corner_appears_at_its_position(
    device: Device, corner: tuple[int, int, int], azimuth: float, elevation: float, where: str, projection: Any
) -> None:
    data = np.zeros((10, 10, 10), np.float32)
    data[corner[::-1]] = 1
    camera = Camera.orbit(azimuth, elevation, projection=projection, fit="volume")
    picture = render(data, camera, "mip", filter="nearest", size=(40, 40), transfer=TransferFunction.ramp((0, 1)), device=device)[
        ..., 0
    ]
    down, right = np.argwhere(picture > 0.5).mean(0)
    assert ("bottom" if down > 20 else "top") == where.split()[0]
    assert ("right" if right > 20 else "left") == where.split()[1]


def test_a_stack_of_images_is_seen_as_in_image_viewers(device: Device) -> None:
    """From above, as its array is printed: row 0 at the top, column 0 on the left, slice 0 nearest; without a frame, z is up."""
    data = np.random.default_rng(0).integers(0, 255, (4, 8, 8)).astype(np.uint8)
    above = Camera.orbit(0, 90, projection="orthographic", fit="volume", zoom=(8 * 8 + 4 * 4 + 8 * 8) ** 0.5 / 8)
    options: dict[str, Any] = {"size": (8, 8), "transfer": TransferFunction.ramp((0, 255)), "device": device}
    for space, shown in (("image", data.max(0)), ("", data.max(0)[::-1]), ("LPS", data.max(0)[::-1])):
        volume = Volume(data, space=space)
        np.testing.assert_allclose(render(volume, above, "mip", filter="nearest", **options)[..., 0], shown / 255, atol=1e-5)
        assert (above.view(volume).eye[2] < 0) == (space == "image")


@pytest.mark.parametrize(("azimuth", "elevation"), ANGLES)
def test_other_views_of_a_stack_of_images_are_rotated_about_x(azimuth: float, elevation: float) -> None:
    stack = Volume(BOX.data, BOX.spacing, BOX.origin, space="image")
    mine, plain = (Camera.orbit(azimuth, elevation).view(volume) for volume in (stack, BOX))
    for name in ("right", "up", "forward"):
        np.testing.assert_allclose(getattr(mine, name), getattr(plain, name) * [1, -1, -1], atol=1e-12)
    explicit = Camera.look_at((30, 20, 60), (1, 2, 3))
    np.testing.assert_array_equal(explicit.view(stack).up, explicit.view(BOX).up)


def test_a_patient_is_seen_from_the_front() -> None:
    """In LPS, x runs to the left hand and y to the back."""
    view = Camera.orbit(0, 0).view(Volume(BOX.data, space="LPS"))
    np.testing.assert_allclose([view.forward, view.right, view.up], [[0, 1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_look_at_from_inside() -> None:
    inside = BOX.center + np.array([1.0, 2.0, -1.0])
    camera = Camera.look_at(inside, inside + np.array([9.0, 0.0, 0.0]))
    view = camera.view(BOX)
    np.testing.assert_allclose(view.eye, inside)
    np.testing.assert_allclose(view.forward, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(view.up, [0, 0, 1], atol=1e-12)
    # without a target, towards the centre
    view = Camera.look_at(inside).view(BOX)
    np.testing.assert_allclose(view.forward, -np.array([1, 2, -1]) / np.sqrt(6), atol=1e-12)


def test_looking_along_up_is_valid() -> None:
    for direction in ((0, 0, 1), (0, 0, -1), (0, 0, 1e-300)):
        view = Camera(direction=direction, up=(0, 0, 5)).view(BOX)
        assert np.isfinite(view.right).all()
        assert abs(view.right @ view.forward) < 1e-12


@pytest.mark.parametrize("aspect", [0.1, 0.5, 1.0, 16 / 9, 7.0])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("fov", [5.0, 30.0, 110.0])
def test_a_fitted_picture_contains_the_bounding_sphere(aspect: float, projection: Any, fov: float) -> None:
    view = Camera.orbit(25, 35, projection=projection, fov=fov).view(BOX, aspect)
    radius = np.linalg.norm(BOX.corners - BOX.center, axis=1).max()
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    sphere = BOX.center + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    p = sphere - view.eye
    depth = np.ones(len(p)) if view.orthographic else p @ view.forward
    assert (depth > 0).all()
    a = p @ view.right / (depth * view.half_height * aspect)
    b = p @ view.up / (depth * view.half_height)
    assert max(np.abs(a).max(), np.abs(b).max()) <= 1 + 1e-9
    assert max(np.abs(a).max(), np.abs(b).max()) > 0.97  # and no smaller than needed


def test_zoom_magnifies_about_the_centre() -> None:
    for projection in ("perspective", "orthographic"):
        camera = Camera.orbit(projection=projection)  # type: ignore[arg-type]
        near, far = camera.zoomed(2.5).view(BOX), camera.view(BOX)
        assert far.half_height == pytest.approx(2.5 * near.half_height)
        np.testing.assert_array_equal(near.eye, far.eye)
    assert Camera(zoom=2).zoomed(3).zoom == 6


def test_distance_and_target() -> None:
    view = Camera.orbit(0, 0, distance=12, target=(1, 2, 3)).view(BOX)
    np.testing.assert_allclose(view.eye, [1, -10, 3])


WRONG: dict[str, tuple[Any, type[ClvolError], str]] = {
    "projection": (
        lambda: Camera(projection="fisheye"),
        OptionError,  # type: ignore[arg-type]
        "projection must be one of perspective, orthographic; got 'fisheye'",
    ),
    "no direction": (lambda: Camera(direction=(0, 0, 0)), GeometryError, "direction must not have zero length"),
    "no up": (lambda: Camera(up=(0, 0, 0)), GeometryError, "up must not have zero length"),
    "flat position": (lambda: Camera(position=(1, 2)), GeometryError, r"position must be three numbers \(x, y, z\); got \(1, 2\)"),  # type: ignore[arg-type]
    "NaN target": (lambda: Camera(target=(1, float("nan"), 2)), GeometryError, "target must be finite"),
    "fov 0": (lambda: Camera(fov=0), OptionError, "fov must be a finite number, greater than 0 and less than 180; got 0"),
    "fov 180": (lambda: Camera(fov=180), OptionError, "fov must be a finite number, greater than 0 and less than 180; got 180"),
    "zoom": (lambda: Camera(zoom=-1), OptionError, "zoom must be a finite number, greater than 0"),
    "zoom NaN": (lambda: Camera(zoom=float("nan")), OptionError, "zoom must be a finite number, greater than 0"),
    "distance": (lambda: Camera.orbit(distance=0), OptionError, "distance must be a finite number, greater than 0"),
    "azimuth": (lambda: Camera.orbit(float("inf")), OptionError, "azimuth must be a finite number; got inf"),
    "elevation": (lambda: Camera.orbit(0, "up"), OptionError, "elevation must be a finite number"),  # type: ignore[arg-type]
    "eye on target": (lambda: Camera.look_at((1, 2, 3), (1, 2, 3)), GeometryError, "position and target must differ"),
    "eye on centre": (lambda: Camera.look_at(BOX.center).view(BOX), GeometryError, "position and target must differ"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors(case: str) -> None:
    make, kind, message = WRONG[case]
    with pytest.raises(kind, match=message):
        make()


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        zoom=(lambda v: Camera(zoom=v), (0, *BAD_NUMBERS)),
        zoomed=(lambda v: Camera().zoomed(v), (0, *BAD_NUMBERS)),
        fov=(lambda v: Camera(fov=v), BAD_NUMBERS),
        distance=(lambda v: Camera(distance=v), [v for v in BAD_NUMBERS if v is not None]),
        azimuth=(lambda v: Camera.orbit(v), BAD_NUMBERS),
        elevation=(lambda v: Camera.orbit(0, v), BAD_NUMBERS),
        projection=(lambda v: Camera(projection=v), ("fisheye", None, np.array(["a", "b"]))),
    ),
)
def test_wrong_options_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(OptionError):
        call(bad)


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        up=(lambda v: Camera(up=v), BAD_VECTORS),
        direction=(lambda v: Camera(direction=v), BAD_VECTORS),
        position=(lambda v: Camera(position=v), [v for v in BAD_VECTORS if v is not None]),
        target=(lambda v: Camera(target=v), [v for v in BAD_VECTORS if v is not None]),
        look_at=(Camera.look_at, BAD_VECTORS),
    ),
)
def test_wrong_vectors_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(GeometryError):
        call(bad)


def test_numpy_scalars_are_accepted() -> None:
    camera = Camera(fov=np.float32(40), zoom=np.array(2), distance=np.int64(3), up=np.array([0, 1, 0]))
    assert (camera.fov, camera.zoom, camera.distance, camera.up) == (40, 2, 3, (0, 1, 0))
