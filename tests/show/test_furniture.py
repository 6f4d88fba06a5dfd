"""What stands around pictures: where it stands, beside VTK's projection; that it is read on any background; what files hold."""

from __future__ import annotations

import re
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import clvol
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.base.srgb import over
from clvol.show.furniture import Area, Furniture, Line, Stage, Strip, Words, letters_of, luminance, marks_of, ticks_of

pytest.importorskip("matplotlib")
SIZE = (240, 180)
SVG = "{http://www.w3.org/2000/svg}"


def volume(space: str = "LPS") -> clvol.Volume:
    """A ball in a grid of unequal spacings, away from the world's origin."""
    z, y, x = np.indices((20, 24, 28)) - np.array((9.5, 11.5, 13.5)).reshape(3, 1, 1, 1)
    ball = 100 * np.clip(1.2 - np.sqrt((x / 12) ** 2 + (y / 10) ** 2 + (z / 8) ** 2), 0, 1)
    return clvol.Volume(ball.astype(np.float32), (1.5, 2.0, 2.5), (-40.0, 10.0, 100.0), units="mm", space=space)


def stage_of(picture: clvol.Picture) -> Stage:
    assert picture.furnished is not None
    return picture.furnished.stage


def marks(picture: clvol.Picture, kind: type) -> list[Any]:
    assert picture.furnished is not None
    return [mark for mark in picture.furnished.marks if isinstance(mark, kind)]


def by_vtk(picture: clvol.Picture, points: np.ndarray) -> np.ndarray:
    """Where VTK's camera sees points: pixels from the upper left corner."""
    vtk = pytest.importorskip("vtkmodules.vtkRenderingCore")
    width, height = SIZE
    camera, made = vtk.vtkCamera(), picture.camera
    assert made is not None
    view = made.view(picture.scene.media[0].volume, width / height)  # type: ignore[union-attr]
    camera.SetPosition(view.eye)
    camera.SetFocalPoint(view.eye + 10 * view.forward)
    camera.SetViewUp(view.up)
    if view.orthographic:
        camera.SetParallelProjection(True)
        camera.SetParallelScale(view.half_height)
    else:
        camera.SetViewAngle(np.degrees(2 * np.arctan(view.half_height)))
    camera.SetClippingRange(0.01, 1e5)
    matrix = camera.GetCompositeProjectionTransformMatrix(width / height, -1, 1)
    array = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
    clip = np.concatenate([points, np.ones((len(points), 1))], 1) @ array.T
    x, y = (clip[:, :2] / clip[:, 3:]).T
    return np.stack([(x + 1) / 2 * width, (1 - y) / 2 * height], -1)


CAMERAS = (
    clvol.Camera.orbit(25, 30),
    clvol.Camera.orbit(200, -15, projection="orthographic"),
    clvol.Camera.look_at((90, -60, 190), (-15, 30, 120), fov=50, zoom=1.3),
)


@pytest.mark.parametrize("camera", CAMERAS, ids=range(3))
def test_a_scale_bar_is_as_long_as_its_length_at_the_target(camera: clvol.Camera) -> None:
    made = clvol.render(volume(), camera, size=SIZE, scale_bar=True)
    (bar,), (words,) = marks(made, Area), marks(made, Words)
    length = float(re.fullmatch(r"([\d.]+) mm", words.text)[1])  # type: ignore[index]
    stage = stage_of(made)
    ends = stage.focus + np.array([[0.0], [length]]) * stage.view.right
    seen = by_vtk(made, ends)
    pixels = float(np.ptp(bar.points[:, 0]))
    assert abs(np.linalg.norm(seen[1] - seen[0]) - pixels) < 0.01
    assert 0.09 * SIZE[0] < pixels <= 0.24 * SIZE[0] + 1e-6
    assert length in {digit * 10.0**power for digit in (1, 2, 5) for power in range(-3, 4)}
    row = np.asarray(made)[int(bar.points[:, 1].mean())]  # and so it is drawn
    lit = row[int(bar.points[:, 0].min()) - 3 :, 0]
    assert abs(float(lit.sum()) - pixels) <= 0.5


@pytest.mark.parametrize("camera", CAMERAS, ids=range(3))
def test_ticks_lie_where_the_camera_sees_their_coordinates(camera: clvol.Camera) -> None:
    made = clvol.render(volume(), camera, size=SIZE, axes=True)
    stage = stage_of(made)
    corners = np.stack([stage.low, stage.high])
    inside = volume().index_to_world(np.array([[-0.5] * 3, [27.5, 23.5, 19.5]]))
    np.testing.assert_allclose(corners, inside)
    assert made.furnished is not None
    drawn, found = [mark for mark in made.furnished.marks if isinstance(mark, Words) or not mark.behind], 0  # type: ignore[union-attr]
    names = [n for n, mark in enumerate(drawn) if isinstance(mark, Words) and mark.text in ("x (mm)", "y (mm)", "z (mm)")]
    assert len(names) == 3
    for n, name in enumerate(names):
        axis = "xyz".index(drawn[name].text[0])  # type: ignore[union-attr]
        others = [k for k in range(3) if k != axis]
        first = names[n - 1] + 1 if n else next(k for k, mark in enumerate(drawn) if isinstance(mark, Words)) - 1
        for line, words in zip(drawn[first:name:2], drawn[first + 1 : name : 2], strict=True):
            assert isinstance(line, Line)
            assert isinstance(words, Words)
            points = np.empty((4, 3))
            points[:, axis] = float(words.text.replace("−", "-"))
            points[:, others] = [(corners[a, others[0]], corners[b, others[1]]) for a in range(2) for b in range(2)]
            assert np.linalg.norm(by_vtk(made, points) - line.points[0], axis=-1).min() < 0.01
            found += 1
    assert found >= 6


def test_edges_at_the_back_lie_behind_the_volume() -> None:
    camera = clvol.Camera.orbit(30, 25)
    made = clvol.render(volume(), camera, size=SIZE, box=True)
    assert sum(line.behind for line in marks(made, Line)) == 3  # of the corner that is farthest away
    plain = clvol.render(volume(), made.camera, size=SIZE, background=None)
    covered = plain[..., 3] > 0.999
    stage = stage_of(made)
    front = [line for line in marks(made, Line) if not line.behind]
    assert covered.any()
    clear = covered.copy()
    for line in front:  # but for the lines in front
        for share in np.linspace(0, 1, 400):
            x, y = line.points[0] + share * (line.points[1] - line.points[0])
            clear[max(0, int(y) - 3) : int(y) + 4, max(0, int(x) - 3) : int(x) + 4] = False
    assert clear.any()
    np.testing.assert_allclose(np.asarray(made)[clear][:, :3], np.asarray(plain)[clear][:, :3], atol=2e-3)
    assert stage.background == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("mode", ["composite", "mip", "minip", "mean", "attenuated"])
def test_a_color_bar_has_the_colors_of_the_transfer_function(mode: str) -> None:
    made = clvol.render(volume(), mode=mode, size=SIZE, color_bar=True, cmap="viridis")
    (strip,) = marks(made, Strip)
    transfer = made.scene.media[0].transfer  # type: ignore[union-attr]
    assert transfer is not None
    low, high = transfer.value_range
    rows = len(strip.colors)
    values = high - (np.arange(rows) + 0.5) / rows * (high - low)
    drawn = np.asarray(made)[strip.top : strip.top + rows, strip.left + 1 : strip.left + strip.width - 1, :3]
    inner = slice(2, -2)  # the frame covers the first and the last row
    middle = drawn[inner, drawn.shape[1] // 2]
    np.testing.assert_allclose(middle, transfer(values)[inner, :3], atol=0.5 / 255 + 1e-6)
    assert ("opacity" in [words.text for words in marks(made, Words)]) == (mode == "composite")
    ticks = [(float(w.text.replace("−", "-")), w.y) for w in marks(made, Words) if re.fullmatch(r"−?[\d.]+", w.text)]
    assert len(ticks) >= 3
    for value, y in ticks:
        assert abs(y - (strip.top + (high - value) / (high - low) * rows)) < 1e-6


def test_the_curve_beside_it_is_the_opacity() -> None:
    transfer = clvol.TransferFunction(((0, "black"), (100, "white")), ((20, 0.0), (20, 0.5), (60, 0.9), (100, 0.1)))
    made = clvol.render(volume(), size=SIZE, color_bar=True, transfer=transfer)
    (strip,) = marks(made, Strip)
    curve = max((line for line in marks(made, Line)), key=lambda line: len(line.points)).points
    foot, font = strip.left - 0.25 * stage_of(made).font, stage_of(made).font
    values = 100 - (curve[:, 1] - strip.top) / len(strip.colors) * 100
    opacity = (foot - curve[:, 0]) / (2 * font)
    away = np.abs(values - 20) > 0.01  # where it jumps
    np.testing.assert_allclose(opacity[away], transfer(values[away])[:, 3], atol=1e-4)
    assert {round(v, 3) for v in opacity[~away]} >= {0.0, 0.5}


def test_labels_have_their_names_in_their_colors() -> None:
    data = np.zeros((12, 12, 12), np.uint8)
    data[2:6], data[6:10] = 1, 2
    made = clvol.render(clvol.Volume(data, labels={0: "air", 1: "liver", 2: "a $spleen$"}), size=SIZE, color_bar=True)
    assert [words.text for words in marks(made, Words)] == ["liver", "a $spleen$"]
    transfer = made.scene.media[0].transfer  # type: ignore[union-attr]
    assert transfer is not None
    for label, area in zip((1, 2), marks(made, Area), strict=True):
        x, y = (int(v) for v in area.points.mean(0))
        np.testing.assert_allclose(np.asarray(made)[y, x, :3], transfer(label)[:3], atol=0.5 / 255 + 1e-6)


def test_a_surface_has_one_color_and_no_bar() -> None:
    with pytest.raises(OptionError, match="color_bar changes nothing in isosurface: surfaces have colours of their own"):
        clvol.render(volume(), mode="isosurface", size=SIZE, color_bar=True)


@pytest.mark.parametrize(
    ("direction", "letters"),
    [((1, 0, 0), "L"), ((-1, 0, 0), "R"), ((0, 1, 0), "P"), ((0, 0, 1), "S"), ((0, -0.9, -0.44), "AI"), ((0.3, -0.95, 0), "A")],
)
def test_letters_name_directions_of_a_patient(direction: tuple[float, ...], letters: str) -> None:
    assert letters_of(np.array(direction, float)) == letters


def test_letters_stand_at_the_sides_they_name() -> None:
    made = clvol.render(volume(), clvol.Camera.orbit(0, 0), size=SIZE, letters=True, title="title")
    left, right, top, bottom = marks(made, Words)[1:]
    assert [words.text for words in (left, right, top, bottom)] == ["R", "L", "S", "I"]  # seen from the front
    assert left.x < SIZE[0] / 4 < 3 * SIZE[0] / 4 < right.x
    assert top.y < SIZE[1] / 4 < 3 * SIZE[1] / 4 < bottom.y
    for space in ("", "image"):
        with pytest.raises(OptionError, match=r"letters changes nothing for a volume whose space is .*'LPS'"):
            clvol.render(volume(space), size=SIZE, letters=True)


EVERYTHING: dict[str, Any] = {
    **dict.fromkeys(("color_bar", "scale_bar", "axes", "box", "letters", "cube"), True),
    "title": "Ball & <box>",
    "time_stamp": 2.5,
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("background", ["black", "white", "#808080", "red", None])
def test_everything_is_read_on_every_background(background: str | None) -> None:
    made = clvol.render(volume(), size=SIZE, background=background, **EVERYTHING)
    stage = stage_of(made)
    grounds = [stage.background] if stage.background is not None else [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]
    array = np.asarray(made)
    for ground in grounds:
        shown = array[..., :3] * array[..., 3:] + np.array(ground) * (1 - array[..., 3:])
        bright = np.array([[luminance(pixel) for pixel in row] for row in shown])
        for words in marks(made, Words):  # letters differ from what is around them, as WCAG asks of text
            half = int(0.3 * stage.font * len(words.text)) + 4
            x, y = words.x + (0.5 - words.across) * 2 * half, words.y + (0.5 - words.down) * words.size
            top, left = max(0, int(y - words.size)), max(0, int(x) - half)
            part = bright[top : int(y + words.size), left : int(x) + half]
            assert (part.max() + 0.05) / (part.min() + 0.05) >= 4.5, words.text
    assert (luminance((0.5, 0.5, 0.5)) - 0.2140) < 1e-3


def test_print_is_on_white_unless_a_background_is_given() -> None:
    made = clvol.render(volume(), size=SIZE, theme="print")
    np.testing.assert_array_equal(made, clvol.render(volume(), size=SIZE, background="white"))
    given = clvol.render(volume(), size=SIZE, theme="print", background="red")
    assert given[0, 0].tolist() == [1, 0, 0, 1]


def test_pixels_without_furniture_are_those_of_the_plain_picture() -> None:
    plain = clvol.render(volume(), size=SIZE)
    np.testing.assert_array_equal(clvol.render(volume(), size=SIZE, color_bar=False, title=""), plain)
    made = clvol.render(volume(), size=SIZE, scale_bar=True, title="title", cube=True)
    differ = (np.asarray(made) != np.asarray(plain)).any(-1)
    assert 0 < differ.sum() < 0.2 * differ.size
    assert not differ[60:120, 60:180].any()
    boxed = clvol.render(volume(), clvol.Camera.look_at((0, -200, 120)), size=SIZE, box=True)
    bare = clvol.render(volume(), clvol.Camera.look_at((0, -200, 120)), size=SIZE)
    same = np.isclose(boxed, bare, atol=2e-6).all(-1)
    assert same.mean() > 0.8


def test_one_over_another_is_by_opacity() -> None:
    top, below = (np.array([[pixel]], np.float32) for pixel in ((1, 0, 0, 0.5), (0, 0, 1, 0.5)))
    np.testing.assert_allclose(over(top, below)[0, 0], (2 / 3, 0, 1 / 3, 0.75), atol=1e-6)
    nothing = np.zeros_like(top)
    np.testing.assert_array_equal(over(nothing, below), below)


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0, 100, ["0", "20", "40", "60", "80", "100"]),
        (-1, 1, ["−1.0", "−0.5", "0.0", "0.5", "1.0"]),
        (0.01, 0.03, ["0.010", "0.015", "0.020", "0.025", "0.030"]),
    ],
)
def test_ticks_are_round(low: float, high: float, texts: list[str]) -> None:
    assert [text for _, text in ticks_of(low, high, 5)] == texts
    values = [value for value, _ in ticks_of(1e-7, 3.3e-7, 5)]
    assert all(b > a for a, b in pairwise(values))


def test_an_svg_holds_the_texts_as_texts(tmp_path: Path) -> None:
    made = clvol.render(volume(), size=SIZE, **EVERYTHING)
    tree = ET.fromstring(made.save(tmp_path / "a.svg").read_text(encoding="utf-8"))
    texts = ["".join(one.itertext()).strip() for one in tree.iter(f"{SVG}text")]
    words = [words.text for words in marks(made, Words)]
    assert {"Ball & <box>", "2.5 s", "opacity", "x (mm)", "20 mm"} <= {*words}
    assert sorted(texts) == sorted(words)
    assert len(list(tree.iter(f"{SVG}image"))) == 2  # the picture, and the colours
    assert tree.attrib["viewBox"].split()[2:] == [f"{n * 72 / 300:g}" for n in SIZE]
    again = made.save(tmp_path / "b.svg").read_bytes()
    assert again == (tmp_path / "a.svg").read_bytes()


@pytest.mark.parametrize("shape", [(8, 9), (8, 9, 1), (8, 9, 3), (8, 9, 4)], ids=str)
@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_plain_pictures_are_written_for_print_too(tmp_path: Path, suffix: str, shape: tuple[int, ...]) -> None:
    path = clvol.save(np.full(shape, 0.5), tmp_path / f"a{suffix}")
    data = path.read_bytes()
    assert data.startswith(b"%PDF" if suffix == ".pdf" else b"<?xml")
    assert b"Width 9" in data if suffix == ".pdf" else b"<image" in data
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"color_bar": "yes"}, "color_bar must be True or False"),
        ({"title": 3}, "title must be a string"),
        ({"time_stamp": None}, "time_stamp, if it is no string, must be a finite number"),
        ({"theme": "paper"}, "theme must be one of screen, print"),
    ],
)
def test_words_are_checked(given: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        Furniture(**given)


def test_furniture_is_for_colors_and_for_whole_pictures() -> None:
    with pytest.raises(OptionError, match='scale_bar changes nothing in composite: it is for the output "rgba"'):
        clvol.render(volume(), size=SIZE, outputs="depth", scale_bar=True)
    made = clvol.render(volume(), size=SIZE, outputs=("rgba", "depth"), scale_bar=True)
    np.testing.assert_array_equal(made["depth"], clvol.render(volume(), size=SIZE, outputs="depth"))
    assert made["rgba"].furnished is not None
    assert made["rgba"][:50].furnished is None


def test_without_matplotlib_an_error_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[figures\]"'):
        clvol.render(volume(), size=SIZE, box=True)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[figures\]"'):
        clvol.save(np.zeros((4, 4)), tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())
    clvol.render(volume(), size=(20, 20)).save(tmp_path / "a.png")


def test_a_viewer_inside_of_the_box_sees_no_outline() -> None:
    made = clvol.render(volume(), clvol.Camera.look_at((-15, 30, 120), (0, 60, 120)), size=SIZE, axes=True, box=True)
    assert np.isfinite(made).all()
    assert all(np.isfinite(line.points).all() for line in marks(made, Line))


def test_a_cube_shows_the_faces_that_face_the_viewer() -> None:
    stage = stage_of(clvol.render(volume(), clvol.Camera.orbit(0, 0), size=SIZE, cube=True))
    faces = [mark.text for mark in marks_of(Furniture(cube=True), stage) if hasattr(mark, "text")]
    assert faces == ["A"]
    stage = stage_of(clvol.render(volume(""), clvol.Camera.orbit(30, 30), size=SIZE, cube=True))
    assert [mark.text for mark in marks_of(Furniture(cube=True), stage) if hasattr(mark, "text")] == ["+x", "−y", "+z"]
