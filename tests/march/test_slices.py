"""Slices and slabs beside SciPy's splines and closed forms, by which sides they are seen, and what is refused."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import clvol
from clvol import cli
from clvol.base.errors import ClvolError, GeometryError, OptionError
from clvol.march.slices import axis_directions, section
from clvol.show.picture import to_bytes

pytestmark = pytest.mark.usefixtures("device")

WINDOW = (0.0, 6.0)
RULES = {"mirror": "mirror", "wrap": "grid-wrap", "reflect": "reflect"}


def turned(space: str = "") -> clvol.Volume:
    """Noise on a grid of unequal spacings that is turned about all axes."""
    data = np.random.default_rng(5).normal(size=(9, 11, 13)).astype(np.float32)
    turn = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 1.0, 0.4], [0.2, -0.5, 0.8]]))[0]
    turn *= np.sign(np.diag(turn))
    return clvol.Volume(data, spacing=(0.7, 1.1, 1.9), origin=(10, -20, 30), direction=turn, space=space)


def values(picture: clvol.Picture) -> NDArray[np.float64]:
    """The grey levels as values; NaN outside."""
    assert (picture[..., 0] == picture[..., 1]).all()
    grey = np.asarray(picture[..., 0], np.float64) * WINDOW[1] + WINDOW[0] - WINDOW[1] / 2
    return np.where(picture[..., 3] > 0, grey, np.nan)


def points_of(middle: Any, right: Any, down: Any, spacing: tuple[float, float], size: tuple[int, int]) -> NDArray[np.float64]:
    """The middles of pixels, one by one."""
    width, height = size
    found = np.empty((height, width, 3))
    for y in range(height):
        for x in range(width):
            across, along = (x + 0.5 - width / 2) * spacing[0], (y + 0.5 - height / 2) * spacing[1]
            found[y, x] = np.asarray(middle) + across * np.asarray(right) + along * np.asarray(down)
    return found


def splined(volume: clvol.Volume, points: NDArray[np.float64], rule: str = "mirror") -> NDArray[np.float64]:
    """SciPy's cubic spline at world points; NaN outside of the domain."""
    index = volume.world_to_index(points)
    inside = ((index >= -0.5) & (index <= np.asarray(volume.size) - 0.5)).all(-1)
    data = volume.data.astype(np.float64)
    found = ndimage.map_coordinates(data, np.moveaxis(index[..., ::-1], -1, 0), order=3, mode=RULES[rule], prefilter=True)
    return np.where(inside, found, np.nan)


NORMAL, UP = np.array([1.0, 2.0, -0.5]), np.array([0.3, 0.1, 1.0])


def frame() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Right, down and normal of the oblique plane, by other means: Gram and Schmidt."""
    normal = NORMAL / math.sqrt(5.25)
    up = UP - (UP @ normal) * normal
    up = up / math.sqrt(up @ up)
    return np.cross(-normal, up), -up, normal  # the viewer looks against the normal


@pytest.mark.parametrize("rule", RULES)
def test_an_oblique_slice_is_scipys_spline(rule: str) -> None:
    volume = turned()
    right, down, _ = frame()
    center = volume.center + np.array([0.2, -0.3, 0.1])
    plane, size, spacing = clvol.Plane(tuple(NORMAL), tuple(center)), (40, 31), (0.31, 0.37)
    picture = clvol.slice(
        volume, plane, size=size, spacing=spacing, center=tuple(center), up=tuple(UP), filter="bspline3", boundary=rule,
        window=WINDOW, background=None,
    )  # fmt: skip
    assert picture.shape == (31, 40, 4)
    assert picture.spacing == spacing
    want = splined(volume, points_of(center, right, down, spacing, size), rule)
    assert 0.1 < np.isnan(want).mean() < 0.9
    np.testing.assert_allclose(values(picture), np.clip(want, -3, 3), atol=2e-6)


def test_a_plane_and_an_axis_show_the_same() -> None:
    """From the side that the normal points to; the volume's middle by default, and all of it."""
    for space in ("", "LPS", "image"):
        volume = turned(space)
        for axis, name in enumerate("xyz"):
            right, down = axis_directions(space, axis)
            picture = clvol.slice(volume, name, filter="bspline3", window=WINDOW)
            plane = clvol.Plane(tuple(np.cross(down, right)), tuple(volume.center))
            np.testing.assert_array_equal(picture, clvol.slice(volume, plane, filter="bspline3", window=WINDOW))
            np.testing.assert_array_equal(picture, clvol.slice(volume, axis, filter="bspline3", window=WINDOW))
            assert picture.spacing is not None
            assert max(picture.shape) == 512
            # no part of the slice lies outside of the picture: its border is seen from one pixel farther in
            seen = values(clvol.slice(volume, name, size=(64, 64), window=WINDOW, background=None))
            assert np.isfinite(seen).any(0).all() or np.isfinite(seen).any(1).all()


def test_a_patient_is_seen_as_by_radiologists() -> None:
    """Right (-x) on the left from the front and from the feet, the front (-y) on the left from the side; the head (+z) is up."""
    z, y, x = np.meshgrid(np.arange(8), np.arange(8), np.arange(8), indexing="ij")
    for data, ends in (
        (x, {"axial": "left", "coronal": "left"}),
        (y, {"axial": "top", "sagittal": "left"}),
        (7 - z, {"coronal": "top", "sagittal": "top"}),
    ):
        volume = clvol.Volume(data.astype(np.float32), space="LPS")
        for plane, end in ends.items():
            picture = clvol.slice(volume, plane, window=(3.5, 7), size=(8, 8))[..., 0]
            dark = {"left": picture[:, 0], "top": picture[0]}[end]
            np.testing.assert_allclose(dark, 0, atol=1e-3)


def test_a_picture_takes_its_size_from_pixels_or_pixels_from_its_size() -> None:
    volume = clvol.Volume(np.ones((10, 20, 40), np.float32), spacing=(1, 1, 2))
    assert clvol.slice(volume, "z", spacing=0.5).shape == (40, 80, 4)
    assert clvol.slice(volume, "y", spacing=(0.5, 0.25)).shape == (80, 80, 4)
    fitted = clvol.slice(volume, "x", size=(30, 60), window=(0, 2))  # 20 × 20 into 30 × 60
    assert fitted.spacing == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert (fitted[15:45] > 0.99).all()
    assert (fitted[[14, 45], :, :3] == 0).all()
    default = clvol.slice(volume)
    assert (default.shape, default.spacing) == ((256, 512, 4), (pytest.approx(40 / 512), pytest.approx(40 / 512)))
    oblique = clvol.slice(volume, clvol.Plane((0, 0, 1), tuple(volume.center)), spacing=0.5, up=(1, 1, 0))
    assert oblique.shape[0] == pytest.approx(60 / math.sqrt(2) / 0.5, abs=1)
    assert fitted[::2].spacing is None


# -- slabs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["mean", "mip", "minip"])
def test_a_slab_is_that_of_scipys_splines(mode: Any) -> None:
    """At 1 + ⌈2 t / s⌉ points from face to face, the mean by trapezia; those outside do not count."""
    volume = turned()
    right, down, normal = frame()
    center, size, spacing, thickness = volume.center, (24, 20), (0.5, 0.6), 3.1
    plane = clvol.Plane(tuple(NORMAL), tuple(center))
    picture = clvol.slice(
        volume, plane, size=size, spacing=spacing, center=tuple(center), up=tuple(UP), thickness=thickness, mode=mode,
        filter="bspline3", window=WINDOW, background=None,
    )  # fmt: skip
    count = 10  # 1 + ⌈6.2 / 0.7⌉
    at = points_of(center, right, down, spacing, size)
    layers = np.stack([splined(volume, at + (k / (count - 1) - 0.5) * thickness * normal) for k in range(count)])
    there = np.isfinite(layers)
    assert (there.any(0) & ~there.all(0)).any()  # some pixels have a part outside
    want = np.full(at.shape[:2], np.nan)
    for y, x in np.argwhere(there.any(0)):
        own, line = there[:, y, x], layers[:, y, x]
        weights = np.where(np.arange(count) % (count - 1) == 0, 0.5, 1.0)[own]
        want[y, x] = {"mean": (line[own] * weights).sum() / weights.sum(), "mip": line[own].max(), "minip": line[own].min()}[mode]
    np.testing.assert_allclose(values(picture), np.clip(want, -3, 3), atol=2e-6)


def test_a_mean_converges_to_the_integral() -> None:
    """∫ of a ball's chord: f is linear along the normal, so the mean is the middle's value, exactly, whatever the thickness."""
    z, y, x = np.meshgrid(np.arange(16.0), np.arange(16.0), np.arange(16.0), indexing="ij")
    ramp = clvol.Volume((x + 2 * y - z).astype(np.float32))
    plane = clvol.Plane((1, 2, -1), tuple(ramp.center))
    for thickness in (0.5, 2.0, 3.7):
        picture = clvol.slice(
            ramp, plane, thickness=thickness, size=(8, 8), spacing=0.2, filter="linear", window=(15, 100), background=None
        )
        np.testing.assert_allclose(np.asarray(picture[..., 0]), 0.5, atol=1e-6)
    wave = clvol.Volume(np.sin(2 * np.pi * x / 16).astype(np.float32))
    slab = clvol.slice(wave, "x", 7.5, thickness=8, size=(4, 4), filter="bspline3", boundary="wrap", window=(0, 4))
    # the mean of sin over the half wave about 7.5, where the samples are: sin(2π (7.5 + t) / 16)
    exact = np.mean(np.sin(2 * np.pi * (7.5 + np.linspace(-4, 4, 200001)) / 16))
    assert float(slab[0, 0, 0]) * 4 - 2 == pytest.approx(exact, abs=2e-3)


def test_missing_samples_do_not_count_in_slabs() -> None:
    data = np.ones((12, 12, 12), np.float32)
    data[:6] = np.nan
    volume = clvol.Volume(data)
    both = clvol.slice(volume, "z", 5.5, thickness=4, window=(1, 2), size=(6, 6), background=None)
    np.testing.assert_allclose(both, np.broadcast_to(np.float32([0.5, 0.5, 0.5, 1]), (6, 6, 4)), atol=1e-6)
    none = clvol.slice(volume, "z", 2, thickness=2, window=(1, 2), size=(6, 6), background=None)
    assert (none == 0).all()


# -- by bricks, and with a function --------------------------------------------------------------------------------


def test_bricks_and_fields_give_the_same_slices() -> None:
    """By bricks within the rounding of their coefficients; from the volume's own field to the bit."""
    volume = turned()
    lazy = clvol.bricks.field.as_lazy(volume)
    plane = clvol.Plane(tuple(NORMAL), tuple(volume.center))
    for more in ({}, {"thickness": 2.0, "mode": "mip"}, {"thickness": 2.0}):
        given: dict[str, Any] = {"size": (33, 20), "filter": "bspline3", "window": WINDOW} | more
        whole = clvol.slice(volume, plane, **given)
        np.testing.assert_allclose(clvol.slice(lazy, plane, **given), whole, atol=1e-6)
        del given["filter"]
        with clvol.Field(volume, "bspline3") as field:
            np.testing.assert_array_equal(clvol.slice(field, plane, **given), whole)
            with pytest.raises(OptionError, match="linear"):
                clvol.slice(field, plane, filter="linear")


def test_an_array_of_dask_is_read_by_bricks() -> None:
    dask = pytest.importorskip("dask.array")
    data = np.random.default_rng(0).normal(size=(20, 24, 28)).astype(np.float32)
    lazy = clvol.LazyVolume(dask.from_array(data, chunks=(10, 12, 14)))
    given: dict[str, Any] = {"filter": "bspline3", "window": WINDOW, "size": (30, 30), "thickness": 3, "mode": "minip"}
    whole = clvol.slice(clvol.Volume(data), "y", 9.2, **given)
    np.testing.assert_allclose(clvol.slice(lazy, "y", 9.2, **given), whole, atol=1e-6)


def test_progress_ends_at_one_and_may_stop_it() -> None:
    told: list[float] = []
    clvol.slice(turned(), "z", thickness=4, size=(300, 300), progress=told.append)
    assert told[-1] == 1
    assert all(a <= b for a, b in pairwise(told))

    def stop(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clvol.slice(turned(), "z", size=(30, 30), progress=stop)


def test_a_section_is_the_slice_of_the_same_frame() -> None:
    volume = turned()
    right, down, _ = frame()
    plane = clvol.Plane(tuple(NORMAL), tuple(volume.center))
    given: dict[str, Any] = {"window": WINDOW, "cmap": "magma", "background": "white"}
    one = clvol.slice(volume, plane, size=(20, 30), spacing=(0.3, 0.4), center=tuple(volume.center), up=tuple(UP), **given)
    np.testing.assert_allclose(section(volume, volume.center, right, down, (0.3, 0.4), (20, 30), **given), one, atol=2e-6)


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"plane": "w"}, OptionError, "plane must be one of x, y, z, a number from 0 to 2, or a clvol.Plane; got 'w'"),
        ({"plane": 3}, OptionError, "plane must be"),
        ({"plane": "axial"}, OptionError, "axial is of a patient, whose space is 'LPS', not ''"),
        ({"position": 99}, GeometryError, r"which lies from .* along its normal \(0, 0, 1\); got a plane at 99"),
        ({"position": math.nan}, OptionError, "position"),
        ({"plane": clvol.Plane((1, 0, 0), (99, 0, 0))}, GeometryError, "must meet the volume"),
        ({"plane": clvol.Plane((1, 0, 0), (10, -20, 30)), "position": 1}, OptionError, "a Plane has its point"),
        ({"mode": "mip"}, OptionError, "mode changes nothing in a slice without a thickness"),
        ({"mode": "max", "thickness": 1}, OptionError, "mode of a slice must be one of mean, mip, minip; got 'max'"),
        ({"thickness": -1}, OptionError, "thickness must be a finite number, at least 0; got -1"),
        ({"up": (0, 0, 2)}, GeometryError, "up must have a direction that is not along the normal"),
        ({"up": (0, 0, 0)}, GeometryError, "up must have a direction"),
        ({"center": (1, 2)}, GeometryError, "center must be three finite numbers"),
        ({"spacing": 0}, OptionError, "spacing must be one positive number, or two"),
        ({"size": 3}, OptionError, r"size must be \(width, height\) in pixels"),
        ({"size": (0, 3)}, OptionError, "width"),
        ({"thick": 3}, OptionError, "thick is no option of slice .did you mean thickness.."),
        ({"cmap": "gry"}, OptionError, "gry"),
        ({"background": "whit"}, OptionError, "background"),
        ({"window": (1, 0)}, OptionError, "window"),
        ({"progress": 3}, OptionError, "progress must be callable"),
    ],
    ids=str,
)
def test_invalid_slices_are_refused(options: dict[str, Any], error: type[ClvolError], says: str) -> None:
    with pytest.raises(error, match=says):
        clvol.slice(turned(), **options)


def test_a_plane_has_a_direction_and_a_volume_three_axes() -> None:
    with pytest.raises(GeometryError, match="normal must have a direction"):
        clvol.Plane((0, 0, 0), (1, 2, 3))
    with pytest.raises(GeometryError, match="three finite numbers"):
        clvol.Plane((0, 0, 1), (1, 2, math.inf))
    with pytest.raises(OptionError, match=r"3 axes; got shape \(4, 5\)"):
        clvol.slice(np.zeros((4, 5), np.float32))
    labels = clvol.Volume(np.arange(64, dtype=np.uint8).reshape(4, 4, 4) % 3, labels=True)
    with pytest.raises(OptionError, match="the mean of two labels is a third"):
        clvol.slice(labels, thickness=2)
    assert clvol.slice(labels, thickness=2, mode="mip", size=(4, 4)).shape == (4, 4, 4)


# -- in the shell --------------------------------------------------------------------------------------------------


def test_the_command_writes_the_same_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    volume = clvol.phantoms.marschner_lobb(24)
    words = "--normal 1 2 -0.5 --thickness 0.4 --mode mip --size 40 30 --window 0.5 1 --cmap magma --background white --up 0 1 0"
    assert shell("slice", "phantom:marschner-lobb:24", "-o", str(tmp_path / "a.png"), *words.split(), "--json") == 0
    said = json.loads(capsys.readouterr().out)
    plane = clvol.Plane((1, 2, -0.5), tuple(volume.center))
    want = clvol.slice(
        volume, plane, size=(40, 30), up=(0, 1, 0), thickness=0.4, mode="mip", window=(0.5, 1), cmap="magma", background="white"
    )
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), to_bytes(want)[..., :3])
    assert want.spacing is not None
    assert (said["size"], said["pixel"]) == ([40, 30], want.spacing[0])
    assert (
        shell("slice", "phantom:marschner-lobb:24", "-o", str(tmp_path / "b.png"), "--plane", "x", "--at", "0.3", "--pixel", "0.1")
        == 0
    )
    np.testing.assert_array_equal(
        np.asarray(Image.open(tmp_path / "b.png")), to_bytes(clvol.slice(volume, "x", 0.3, spacing=0.1))[..., :3]
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--point 1 2 3", "--point is of an oblique slice"),
        ("--normal 1 2 3 --at 0", "leave out --plane and --at"),
        ("--normal 1 2 3 --plane z", "leave out --plane and --at"),
        ("--plane axial", "axial is of a patient"),
        ("--at 9", "must meet the volume"),
        ("--mode mip", "without a thickness"),
        ("-o a.xyz", "pictures are written as"),
    ],
)
def test_invalid_commands_write_nothing(words: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["-o", str(tmp_path / "a.png"), *words.split()] if "-o" not in words else words.split()
    assert shell("slice", "phantom:sphere:8", *given) == 1
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def shell(*words: str) -> object:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    return end.value.code
