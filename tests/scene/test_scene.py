"""Scenes and media: arguments, errors, and the same pictures as volumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Light, Material, Medium, Scene, TransferFunction, Volume
from clvol.base.errors import ClvolError, DataError, GeometryError, OptionError
from clvol.device import Device
from clvol.scene.scene import as_scene

DATA = np.random.default_rng(0).random((7, 6, 5)).astype(np.float32)
RED = TransferFunction(((0.0, "black"), (1.0, "red")), ((0.0, 0.0), (1.0, 0.5)))
CAMERA, SIZE = Camera.orbit(20, 30), (24, 20)


def test_a_scene_renders_as_its_parts_do(device: Device) -> None:
    volume = Volume(DATA, (1.0, 0.8, 1.3))
    matte, light, box = Material(specular=0.0), Light((1, 2, 3)), ((0.5, 0.5, 0.5), (3.0, 3.5, 6.0))
    scene = Scene(Medium(volume, RED, matte, "mitchell", "wrap"), light, "white", box)
    got = clvol.render(scene, CAMERA, size=SIZE, device=device)
    want = clvol.render(
        volume,
        CAMERA,
        "composite",
        filter="mitchell",
        boundary="wrap",
        size=SIZE,
        transfer=RED,
        material=matte,
        lights=light,
        background="white",
        clip=box,
        device=device,
    )
    np.testing.assert_array_equal(got, want)
    assert not np.array_equal(got, clvol.render(volume, CAMERA, size=SIZE, device=device))


def test_explicit_arguments_override_the_scene(device: Device) -> None:
    scene = Scene(Medium(DATA, RED), background="white", clip=((0, 0, 0), (2, 2, 2)))
    with clvol.Renderer(scene, device=device) as renderer:
        plain = renderer.render(CAMERA, size=SIZE, background="black", clip=None, transfer=RED)
        np.testing.assert_array_equal(plain, clvol.render(DATA, CAMERA, size=SIZE, transfer=RED, device=device))
        clear = renderer.render(CAMERA, size=SIZE, background=None)
        assert clear[..., 3].min() == 0
        np.testing.assert_array_equal(renderer.render(CAMERA, size=SIZE), clvol.render(scene, CAMERA, size=SIZE, device=device))


@pytest.mark.parametrize(
    "scene", [DATA, Volume(DATA), Medium(DATA), Scene(DATA), Scene([Medium(DATA)]), Scene([Volume(DATA)]), DATA.tolist()]
)
def test_anything_with_a_volume_is_a_scene(scene: Any) -> None:
    (medium,) = as_scene(scene).media
    np.testing.assert_array_equal(medium.volume.data, DATA)
    assert medium.filter is None  # the mode decides
    assert medium.boundary.name == "mirror"


def test_a_box_cannot_be_changed() -> None:
    scene = Scene(DATA, clip=((0, 0, 0), (2, 2, 2)))
    assert scene.clip is not None
    with pytest.raises(ValueError, match="read-only"):
        scene.clip[0][0] = 1.0  # type: ignore[index]


def test_a_field_is_used_as_is_and_stays_open(device: Device) -> None:
    with clvol.Field(DATA, "mitchell", "wrap", device) as field:
        renderer = clvol.Renderer(field)
        want = clvol.render(DATA, CAMERA, "composite", filter="mitchell", boundary="wrap", size=SIZE, device=device)
        np.testing.assert_array_equal(renderer.render(CAMERA, size=SIZE), want)
        renderer.close()
        with pytest.raises(OptionError, match="closed"):
            renderer.render(CAMERA, size=SIZE)
        np.testing.assert_array_equal(clvol.render(field, CAMERA, size=SIZE), want)
        with pytest.raises(OptionError, match="the field was made with filter 'mitchell'"):
            clvol.Renderer(field, "linear")
    with pytest.raises(OptionError, match="the field was closed"):
        clvol.Renderer(field)


COUNT = "a scene must have 1 to 8 media; got "
LABELS = np.arange(DATA.size).reshape(DATA.shape) % 3
REFUSED: dict[str, tuple[Any, type[ClvolError], str]] = {
    "nine media": (lambda: Scene([DATA] * 9), OptionError, COUNT + "9"),
    "no medium": (lambda: Scene([]), OptionError, COUNT + "0"),
    "two worlds": (
        lambda: Scene([Volume(DATA, space="LPS"), Volume(DATA, space="image")]),
        GeometryError,
        "must be in one world; got volumes in LPS and image",
    ),
    "a way to mix": (lambda: Scene([DATA, DATA], mix="under"), OptionError, "mix must be one of add, over; got 'under'"),
    "where without a mask": (lambda: Medium(DATA, where=3), OptionError, "where names labels of a mask; got where=3 and no mask"),
    "labels without where": (lambda: Medium(DATA, mask=LABELS), OptionError, "a mask of labels takes where="),
    "labels that are not there": (
        lambda: Medium(DATA, mask=LABELS, where=[1, 7]),
        OptionError,
        r"where must name labels of the mask, which has 0, 1, 2; got \[7\]",
    ),
    "a mask of another shape": (lambda: Medium(DATA, mask=LABELS[1:], where=1), DataError, "mask must"),
    "five lights": (lambda: Scene(DATA, lights=[Light()] * 5), OptionError, "there may be up to 4 lights; got 5"),
    "an image": (lambda: Medium(DATA[0]), OptionError, "rendering takes a volume with 3 axes"),
    "a filter": (lambda: Medium(DATA, filter="cubix"), OptionError, "filter must be one of .*; got 'cubix'"),
    "a boundary": (lambda: Medium(DATA, boundary="edge"), OptionError, "boundary must be one of .*; got 'edge'"),
    "a transfer function": (lambda: Medium(DATA, transfer="red"), OptionError, "transfer must be a TransferFunction; got 'red'"),
    "a material": (lambda: Medium(DATA, material=1), OptionError, "material must be a Material; got 1"),
    "spacings": (lambda: Medium(Volume(DATA, (1, 1, 1e7))), GeometryError, "differ by a factor of up to 1e\\+06"),
    "a light": (lambda: Scene(DATA, lights="sun"), OptionError, "lights must be a Light or a sequence of them; got 'sun'"),
    "a background": (lambda: Scene(DATA, background="no colour"), OptionError, "background must be"),
    "a box": (lambda: Scene(DATA, clip=((0, 0, 0), (0, 1, 1))), GeometryError, "clip must be two corners"),
    "half a box": (lambda: Scene(DATA, clip=(0, 1)), GeometryError, "clip must be two corners"),
    "a filter beside a scene": (
        lambda: clvol.Renderer(Scene(DATA), "linear"),
        OptionError,
        "filter must be left to the medium of a scene",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_invalid_scenes_are_rejected(case: str) -> None:
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()


def test_an_image_where_a_volume_is_needed_is_told_where_to_go(tmp_path: Path) -> None:
    image = np.zeros((6, 7), np.float32)
    np.save(tmp_path / "image.npy", image)
    for call in (
        lambda: clvol.render(image),
        lambda: clvol.BrickedField(clvol.Volume(image)),
        lambda: clvol.LazyVolume(image),
        lambda: clvol.pyramid(clvol.Volume(image), tmp_path / "image.zarr"),
        lambda: clvol.reports.report(clvol.Volume(image), tmp_path / "image.html"),
        lambda: clvol.open(tmp_path / "image.npy"),
    ):
        with pytest.raises(ClvolError, match=r"clvol\.images resamples, zooms and rotates images"):
            call()
