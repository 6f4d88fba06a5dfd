"""Labels on slices: smooth boundaries, the same curves as in 3-D, and contours along them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import clvol
from clvol import cli
from clvol.base.errors import DataError, OptionError
from clvol.scene.preset import label_color
from clvol.show.picture import to_bytes

pytestmark = pytest.mark.usefixtures("device")

RADIUS, MIDDLE = 9.4, np.array([12.1, 11.7, 12.3])  # samples; x, y, z


def ball() -> clvol.Volume:
    """Of label 7, in nothing."""
    z, y, x = np.indices((25, 24, 25))
    inside = (x - MIDDLE[0]) ** 2 + (y - MIDDLE[1]) ** 2 + (z - MIDDLE[2]) ** 2 < RADIUS**2
    return clvol.Volume(np.where(inside, 7, 0).astype(np.uint8), labels=True)


def blocks() -> clvol.Volume:
    """Three labels at random and a background, on a grid that is turned and whose samples are no cubes."""
    data = np.kron(np.random.default_rng(3).integers(0, 4, (4, 4, 4)), np.ones((3, 3, 3)))
    turn = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [-0.3, 1.0, 0.4], [0.2, -0.5, 0.8]]))[0]
    return clvol.Volume((5 * data).astype(np.int16), (1, 1.2, 1.7), (3, -4, 5), turn * np.sign(np.diag(turn)), labels=True)


def labels_of(picture: clvol.Picture, numbers: tuple[int, ...]) -> NDArray[np.int64]:
    """The labels whose colours pixels have; 0 where they are transparent."""
    colors = np.array([label_color(number) for number in numbers])
    nearest = np.abs(np.asarray(picture)[..., None, :3] - colors).max(-1)
    assert (nearest.min(-1)[picture[..., 3] > 0] < 1e-6).all()
    return np.where(picture[..., 3] > 0, np.asarray(numbers)[nearest.argmin(-1)], 0)


def test_a_ball_is_a_circle() -> None:
    """Within 0.11 samples (RMS), in slices across each axis and at heights; each line is as wide as it should be, at any zoom."""
    volume, off = ball(), []
    for axis, height in itertools.product(range(3), (-5.2, 0.4, 6.3)):
        radius = np.sqrt(RADIUS**2 - height**2)
        picture = clvol.slice(volume, axis, MIDDLE[axis] + height, spacing=0.1, smooth=True, background=None)
        area = (labels_of(picture, (7,)) == 7).sum() * 0.1**2
        off.append(np.sqrt(area / np.pi) - radius)
    print(f"{np.sqrt(np.mean(np.square(off))):.4f} samples")
    assert np.sqrt(np.mean(np.square(off))) <= 0.11
    for pixel, width in ((0.1, 1), (0.15, 3.5), (0.5, 2)):
        filled, line = (
            clvol.slice(volume, spacing=pixel, smooth=True, contour=contour, background=None)[..., 3] > 0 for contour in (0, width)
        )
        assert not (line & ~filled).any()
        outer, inner = (np.sqrt(seen.sum() / np.pi) for seen in (filled, filled & ~line))
        assert outer - inner == pytest.approx(width, abs=0.1)


def test_pixels_show_the_labels_of_resample() -> None:
    """On a turned grid; and contours are the pixels of which another label lies within the width, found by brute force."""
    volume = blocks()
    plane, size, pixel = clvol.Plane((1.0, 2.0, -0.5), tuple(volume.center)), (60, 50), (0.21, 0.17)
    given: dict[str, Any] = {"size": size, "spacing": pixel, "background": None, "smooth": True}
    picture = clvol.slice(volume, plane, **given)
    down = np.array([0.0, 0, -1]) + np.asarray(plane.normal) * plane.normal[2]
    down /= np.linalg.norm(down)
    right = np.cross(plane.normal, down)
    corner = volume.center - right * pixel[0] * (size[0] - 1) / 2 - down * pixel[1] * (size[1] - 1) / 2
    finer = 5  # places per pixel

    def wanted(times: int) -> NDArray[Any]:
        """Labels at places with pixels' centres among them."""
        shape = (1, times * (size[1] - 1) + 1, times * (size[0] - 1) + 1)
        spacing = (pixel[0] / times, pixel[1] / times, 1.0)
        grid = clvol.Volume(np.zeros(shape, np.uint8), spacing, corner, np.stack([right, down, np.cross(right, down)], 1))
        return clvol.resample(volume, like=grid, smooth=True, fill=-1).data[0]

    want, seen = wanted(1), labels_of(picture, (5, 10, 15))
    np.testing.assert_array_equal(seen, np.maximum(want, 0))
    assert {-1, 0, 5, 10, 15} == set(np.unique(want))
    width = 2
    lines = labels_of(clvol.slice(volume, plane, **given, contour=width), (5, 10, 15))
    fine, y, x = wanted(finer), *(np.arange(n) for n in (size[1], size[0]))
    near = {slack: np.zeros(want.shape, bool) for slack in (-0.3, 0.1)}
    far = finer * width
    for down_by, right_by in itertools.product(range(-far, far + 1), repeat=2):
        at = np.clip(finer * y + down_by, 0, fine.shape[0] - 1)[:, None], np.clip(finer * x + right_by, 0, fine.shape[1] - 1)
        differs = (fine[at] != want) & (fine[at] >= 0) & (want >= 0)
        for slack, found in near.items():
            if down_by**2 + right_by**2 <= ((width + slack) * finer) ** 2:
                found |= differs
    inner = np.s_[width:-width, width:-width]  # the picture's edge is none of the lines'
    assert (lines[inner][near[-0.3][inner]] == seen[inner][near[-0.3][inner]]).all()
    assert not lines[inner][~near[0.1][inner]].any()


def test_a_cut_in_3d_shows_the_slice() -> None:
    """The face of a plane that cuts regions open has the colours of the slice there, but of pixels on a boundary."""
    volume = blocks()
    opaque = clvol.TransferFunction([(0, "white"), (2, "white"), (3, "red"), (7, "red"), (8, "lime"), (12, "lime"), (13, "blue")])
    plane, (width, height) = clvol.Plane((0.4, 1.0, -0.3), tuple(volume.center)), (64, 48)
    above = tuple(volume.center + 50 * np.asarray(plane.normal))
    camera = clvol.Camera(position=above, target=tuple(volume.center), up=(0, 0, 1), zoom=2, projection="orthographic")
    pixel = 2 * camera.view(volume, width / height).half_height / height
    face = clvol.render(volume, camera, "regions", (width, height), clip=plane, transfer=opaque, rays=1)
    given: dict[str, Any] = {"size": (width, height), "spacing": pixel, "center": tuple(volume.center), "smooth": True}
    cut = clvol.slice(clvol.Medium(volume, opaque), plane, **given)
    differ = (np.abs(np.asarray(face) - cut) > 2e-3).any(-1)
    assert differ.mean() < 0.005
    edges = np.asarray(clvol.slice(volume, plane, **given, contour=1, transfer=opaque, background=None))[..., 3] > 0
    assert not (differ & ~edges).any()


def test_in_scenes_hidden_labels_show_what_is_under_them() -> None:
    """Lines in the labels' colours over a scan, which stays what it was elsewhere; slices beside mode regions are smooth."""
    volume = ball()
    scan = clvol.Volume(np.random.default_rng(1).random(volume.shape, np.float32))
    look = clvol.TransferFunction.preset("labels", volume)
    size: dict[str, Any] = {"size": (84, 84), "mode": "mip"}  # panes of 40 × 40
    plain = clvol.orthogonal(scan, filter="linear", **size)
    medium, panes = clvol.Medium(scan, filter="linear"), (np.s_[:40, :40], np.s_[44:, :40], np.s_[44:, 44:])
    pictures = {}
    for name, transfer, contour in (("area", look, 0), ("line", look, 2), ("hidden", look.with_opacity([(0, 0)]), 0)):
        scene = clvol.Scene([medium, clvol.Medium(volume, transfer)])
        pictures[name] = clvol.orthogonal(scene, smooth=True, contour=contour, **size)
    alone = clvol.orthogonal(volume, mode="regions", size=(84, 84), background=None)
    for pane in panes:
        covered = {name: (picture[pane] != plain[pane]).any(-1) for name, picture in pictures.items()}
        assert not covered["hidden"].any()
        assert (covered["area"] >= covered["line"]).all()
        assert 0 < covered["line"].sum() < covered["area"].sum() / 2
        assert np.abs(pictures["line"][pane][covered["line"]] - [*label_color(7), 1]).max() < 1e-6
        np.testing.assert_array_equal(alone[pane][..., 3] > 0, covered["area"])


def test_refusals(tmp_path: Path) -> None:
    labels, scan = ball(), clvol.phantoms.marschner_lobb(8)
    cases: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (clvol.Volume(scan.data, labels=False), {"smooth": True}, "smooth is for labels"),
        (scan, {"contour": 1}, "contour is for labels"),
        (labels, {"contour": 0.5}, "or from 1 to 16 pixels; got 0.5"),
        (labels, {"contour": 17}, "contour must be"),
        (labels, {"contour": 2, "thickness": 2, "mode": "mip"}, "contour is of a plane"),
        (labels, {"smooth": "yes"}, "smooth must be True or False"),
        (labels, {"smooth": True, "filter": "bspline3"}, "without a prefilter"),
        (labels, {"transfer": clvol.TransferFunction([(0, "red")]), "cmap": "viridis"}, "transfer must be left out"),
        (clvol.LazyVolume(labels.data, labels=True), {"smooth": True}, "labels in memory"),
        (clvol.Medium(scan, smooth=True), {}, "samples look like none"),
    )
    for volume, options, says in cases:
        with pytest.raises(OptionError, match=says):
            clvol.slice(volume, size=(8, 8), **options)
    with pytest.raises(DataError, match="labels must be whole numbers"):
        clvol.slice(scan, smooth=True)
    with pytest.raises(OptionError, match="contour is for labels"):
        clvol.orthogonal(scan, size=(20, 20), contour=2)
    over = clvol.Scene([scan, clvol.Medium(labels, smooth=True)])
    for more in ({"contour": 17}, {"contour": 2, "thickness": 1, "slab": "mip"}):
        with pytest.raises(OptionError, match=r"contour (must be|is of a plane)"):
            clvol.orthogonal(over, size=(20, 20), **more)
    with pytest.raises(OptionError, match="smooth=False shows its samples"):
        clvol.orthogonal(clvol.LazyVolume(labels.data, labels=True), size=(20, 20), mode="regions")
    path = tmp_path / "labels.nrrd"
    clvol.write(labels, path)
    with pytest.raises(SystemExit) as end:
        cli.main(["slice", str(path), "-o", str(tmp_path / "lines.png"), "--smooth", "--contour", "2", "--size", "40", "40"])
    assert end.value.code == 0
    want = to_bytes(clvol.slice(clvol.read(path), size=(40, 40), smooth=True, contour=2))[..., :3]
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "lines.png")), want)
