from __future__ import annotations

import base64
import copy
import io
import pickle
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol.base import html
from clvol.show import thumbnail
from clvol.show.picture import Picture, show, to_bytes, to_png
from clvol.volume.volumes import Leading

VOID = {"img", "meta", "br"}


class Page(HTMLParser):
    """Tags, texts and pictures of an HTML fragment, whose tags must close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.pictures: list[np.ndarray] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        source = dict(attributes).get("src")
        if source:
            self.pictures.append(iio.imread(io.BytesIO(base64.b64decode(source.removeprefix("data:image/png;base64,")))))

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None: ...

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


# -- volumes -------------------------------------------------------------------------------------------------


def marked(space: str = "", **about: Any) -> clvol.Volume:
    """Dark except the centres of its sides at low z (50), low y (100) and low x (200)."""
    data = np.zeros((3, 3, 3), np.uint8)
    data[0, 1, 1], data[1, 0, 1], data[1, 1, 0] = 50, 100, 200  # low z, low y, low x
    return clvol.Volume(data, space=space, clim=(0, 255), **about)


@pytest.mark.parametrize(
    ("space", "y_down", "z_down", "names"),
    [
        ("LPS", True, False, ("axial", "coronal", "sagittal")),
        ("image", True, True, ("xy", "xz", "yz")),
        ("", False, False, ("xy", "xz", "yz")),
    ],
    ids=["patient", "image", "none"],
)
@pytest.mark.parametrize("turned", [False, True], ids=["along", "against"])
def test_slices_are_oriented_as_seen_in_the_world(
    space: str, y_down: bool, z_down: bool, names: tuple[str, ...], turned: bool
) -> None:
    volume = marked(space)
    if turned:  # the same world, its samples stored in another order: x as the slowest axis, y and z reversed
        data = np.ascontiguousarray(volume.data.transpose(2, 1, 0)[:, ::-1, ::-1])
        direction = np.array([[0, 0, 1.0], [0, -1, 0], [-1, 0, 0]])
        volume = clvol.Volume(data, origin=(0, 2, 2), direction=direction, space=space, clim=(0, 255))
    about = {"space": space, "clim": (0, 255), "blended": False}
    found = dict(thumbnail.slices(volume.data, volume.spacing, volume.direction, **about))  # type: ignore[arg-type]  # by name
    assert tuple(found) == names
    first, last = 10, 150  # rows and columns in the first and the last third of 160
    for picture, (across, down), (left, end), runs_down in (
        (found[names[0]], (200, 100), (first, first), y_down),
        (found[names[1]], (200, 50), (first, first), z_down),
        (found[names[2]], (100, 50), (first, first), z_down),
    ):
        assert picture.shape == (160, 160)
        assert picture[80, left] == across
        assert picture[end if runs_down else last, 80] == down


def test_a_volume_shows_its_metadata() -> None:
    page = Page(marked("LPS", spacing=(1, 2, 3), units="mm", name="<b>bold & bright</b>")._repr_html_())
    assert [p.shape[:2] for p in page.pictures] == [(160, 80), (160, 53), (160, 107)]
    assert "<b>bold & bright</b>" in page.texts
    for text in ("3 × 3 × 3 uint8", "1 × 2 × 3 mm", "0 to 200", "0 to 255", "axial"):
        assert text in page.texts
    assert any(text.startswith("LPS: a patient") for text in page.texts)


@pytest.mark.parametrize(
    "data",
    [
        np.full((1, 1, 1), 7, np.int16),
        np.full((2, 2, 2), np.nan),
        np.array([[[1, np.inf], [np.nan, 2.0]]]),
        np.arange(24, dtype=">i4").reshape(2, 3, 4),
        np.array([[[-1.7e308, 1.7e308]]]),
        np.ones((2, 1000, 3), bool),
        np.arange(6.0).reshape(2, 3),
    ],
    ids=["one sample", "NaN", "not finite", "big-endian", "wide", "boolean", "image"],
)
def test_every_volume_shows_itself(data: np.ndarray) -> None:
    page = Page(clvol.Volume(data)._repr_html_())
    assert len(page.pictures) == (1 if data.ndim == 2 else 3)
    if not np.isfinite(data).any():
        assert "none is finite" in page.texts


def bars(page: str) -> list[tuple[float, float]]:
    """Start and height of each histogram bar."""
    path = page.rpartition('<path d="')[2].partition('"')[0]
    return [(float(x), float(h)) for x, h in re.findall(r"M([\d.]+) [\d.]+v-([\d.]+)", path)]


def test_a_volume_shows_its_histogram() -> None:
    data = np.repeat(np.array([3, 4, 6], np.uint8), (1000, 100, 10)).reshape(10, 111, 1)
    found = bars(clvol.Volume(data)._repr_html_())
    assert [x for x, _ in found] == [0, 90, 270]  # a quarter each for 3, 4, 5 and 6
    np.testing.assert_allclose([h for _, h in found], np.log1p([1000, 100, 10]) / np.log1p(1000) * 92, atol=0.1)
    assert len(bars(clvol.Volume(np.full((2, 2, 2), 5.0))._repr_html_())) == 1
    many = bars(clvol.Volume(np.random.default_rng(0).random((200, 200, 200), np.float32))._repr_html_())
    assert len(many) == 90
    np.testing.assert_allclose([h for _, h in many], 92, rtol=0.02)


def test_a_field_shows_its_kernel_and_properties(device: clvol.Device) -> None:
    field = clvol.Field(clvol.Volume(np.ones((3, 4, 5), np.float32)), "bspline3", device=device)
    texts = Page(field._repr_html_()).texts
    for text in ("Field", "3 × 4 × 5 float32", "bspline3", "mirror", device.name):
        assert text in texts
    field.close()
    assert "freed, the field is closed" in Page(field._repr_html_()).texts


def test_volumes_show_the_first_few_in_their_colours() -> None:
    leading = Leading(("time", "channel"), (3, 2), {"channel": ("DAPI", "GFP")}, ((0, 0, 1), (0, 1, 0)), ((0, 1), None))
    page = Page(clvol.Volumes(np.ones((3, 2, 4, 5, 6), np.uint8), leading=leading)._repr_html_())
    assert len(page.pictures) == 4
    assert "3 times × 2 channels (DAPI, GFP)" in page.texts
    assert "0 DAPI" in page.texts
    assert page.pictures[0][50, 50].tolist() == [0, 0, 255]
    assert page.pictures[1][50, 50, [0, 2]].tolist() == [0, 0]


# -- functions and tables ------------------------------------------------------------------------------------


def svg(text: str) -> ET.Element:
    return ET.fromstring(re.search(r"<svg.*?</svg>", text).group())  # type: ignore[union-attr]  # there is one


def test_a_transfer_function_shows_its_curve_over_its_colours() -> None:
    transfer = clvol.TransferFunction(((0, "black"), (50, "red"), (100, "white")), ((20, 0), (60, 0.5), (60, 1)))
    found = svg(transfer._repr_html_())
    space = "{http://www.w3.org/2000/svg}"
    stops = [(s.get("offset"), s.get("stop-color")) for s in found.iter(f"{space}stop")]
    assert stops == [("0.0000", "#000000"), ("0.5000", "#ff0000"), ("1.0000", "#ffffff")]
    line = next(found.iter(f"{space}polyline")).get("points", "")
    points = [tuple(map(float, p.split(","))) for p in line.split()]
    assert [x for x, _ in points] == [0, 72, 216, 216, 360]  # of 360: held at its ends, with a jump
    heights = [(points[0][1] - y) / (points[0][1] - points[-1][1]) for _, y in points]
    assert heights == pytest.approx([0, 0, 0.5, 1, 1])
    one = clvol.TransferFunction(((3, "red"),), ((3, 1),))
    assert svg(one._repr_html_()) is not None


def test_a_filter_shows_its_kernel() -> None:
    text = clvol.filters()["linear"]._repr_html_()
    line = next(svg(text).iter("{http://www.w3.org/2000/svg}polyline")).get("points", "")
    points = np.array([tuple(map(float, p.split(","))) for p in line.split()])
    peak = points[points[:, 1].argmin()]
    assert peak[0] == pytest.approx(180)
    np.testing.assert_allclose(points[:, 1], peak[1] + (points[0, 1] - peak[1]) * np.abs(points[:, 0] - 180) / 180, atol=0.1)
    assert "trilinear" in " ".join(Page(text).texts)


def test_tables_show_themselves() -> None:
    texts = Page(clvol.filters()._repr_html_()).texts
    assert {"bspline3", "catmull-rom", "-0.2679"} <= set(texts)
    assert repr(clvol.filters()) == str(clvol.filters())
    assert re.search(r"^linear +2 .*trilinear$", repr(clvol.filters()), re.MULTILINE)
    assert re.search(r"^wrap +repeated", repr(clvol.boundaries()), re.MULTILINE)
    assert "mirror" in Page(clvol.boundaries()._repr_html_()).texts
    assert re.search(r"^mip +the maximum", repr(clvol.modes()), re.MULTILINE)
    assert re.search(r"^ct-bone +CT: bone", repr(clvol.presets()), re.MULTILINE)
    metrics = clvol.analysis.Table([clvol.analysis.metrics("linear")])
    assert "linear" in Page(metrics._repr_html_() or "").texts
    assert clvol.analysis.Table([])._repr_html_() is None
    assert Page(html.table(["<a>"], [["</table>"]])).texts == ["<a>", "</table>"]


# -- pictures ------------------------------------------------------------------------------------------------


def test_a_picture_is_its_array() -> None:
    array = np.random.default_rng(0).random((6, 8, 4)).astype(np.float32)
    picture = Picture(array)
    assert isinstance(picture, np.ndarray)
    assert np.shares_memory(picture, array)
    assert type(picture[1:3, ::2]) is Picture
    for plain in (picture[0], picture[..., 3], picture + 1, np.sqrt(picture), picture.mean(axis=2), np.asarray(picture)):
        assert type(plain) is np.ndarray
    assert type(picture[0, 0, 0]) is np.float32
    assert type(picture.max()) is np.float32
    np.testing.assert_array_equal(picture + 1, array + 1)
    picture *= 1
    assert type(picture) is Picture
    assert repr(picture) == "Picture(rgba, 8 × 6 pixels, float32): .show(), .save(path)"
    assert str(picture) == str(array)
    assert repr(picture.T) == repr(array.T)


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))], ids=["copy", "deep", "pickle"]
)
def test_a_copied_picture_is_a_picture(again: Any) -> None:
    picture = Picture(np.arange(6.0).reshape(2, 3), "depth")
    other = again(picture)
    assert type(other) is Picture
    assert other.kind == "depth"
    np.testing.assert_array_equal(other, picture)


def test_outputs_are_displayed_by_kind() -> None:
    depth = Picture(np.array([[2.0, 4.0, np.inf]]), "depth")
    np.testing.assert_array_equal(to_bytes(depth), [[[255, 255, 255, 255], [64, 64, 64, 255], [64, 64, 64, 0]]])
    normal = Picture(np.array([[[1.0, 0, -1], [np.nan] * 3]]), "normal")
    np.testing.assert_array_equal(to_bytes(normal), [[[255, 128, 0, 255], [0, 0, 0, 0]]])
    position = Picture(np.array([[[5.0, 7, 9], [6, 7, 5], [np.nan] * 3]]), "position")
    np.testing.assert_array_equal(to_bytes(position), [[[0, 0, 255, 255], [255, 0, 0, 255], [0, 0, 0, 0]]])
    visited = Picture(np.array([[0.0, 1.0]]), "visited")
    np.testing.assert_array_equal(to_bytes(visited), to_bytes(clvol.show.picture.heat(np.array([[0.0, 1.0]]))))
    within = Picture(np.ones((20, 30, 2)), "uncertainty")
    assert to_bytes(within).shape[1:] == (30, 3)
    nothing = Picture(np.full((2, 2), np.inf), "depth")
    assert not to_bytes(nothing)[..., 3].any()
    assert Picture(np.zeros((3, 4, 5)))._repr_png_() is None
    assert Picture(np.zeros((0, 4)))._repr_png_() is None


def test_figures_show_themselves() -> None:
    figure = pytest.importorskip("matplotlib.figure").Figure((1, 1))
    figure.subplots().plot([1, 2])
    assert iio.imread(clvol.figures.Drawing(figure, [])._repr_png_()).shape[:2] == (150, 150)
    np.testing.assert_array_equal(iio.imread(clvol.figures.Drawing(PICTURE, [])._repr_png_()), PICTURE)


@pytest.mark.usefixtures("device")
def test_pictures_are_rendered(tmp_path: Path) -> None:
    found = clvol.render(clvol.phantoms.sphere(8), size=(16, 12), outputs=("rgba", "depth"))
    assert {name: (type(p), p.kind, p.shape, p.dtype) for name, p in found.items()} == {
        "rgba": (Picture, "rgba", (12, 16, 4), np.dtype("f4")),
        "depth": (Picture, "depth", (12, 16), np.dtype("f4")),
    }
    np.testing.assert_array_equal(iio.imread(found["rgba"]._repr_png_() or b""), to_bytes(found["rgba"])[..., :3])
    np.testing.assert_array_equal(iio.imread(found["depth"].save(tmp_path / "depth.png")), to_bytes(found["depth"]))


# -- show ----------------------------------------------------------------------------------------------------


@pytest.fixture
def viewed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a desktop viewer was given."""
    from PIL import ImageShow

    seen: list[Any] = []
    monkeypatch.setattr(ImageShow, "show", lambda image, **_: seen.append(np.asarray(image)) or True)  # type: ignore[func-returns-value]
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    return seen


PICTURE = np.arange(12, dtype=np.uint8).reshape(3, 4)


def test_without_a_screen_a_picture_is_saved(viewed: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    show(PICTURE)
    assert viewed == []
    name = capsys.readouterr().out.strip().rpartition(" ")[2]
    np.testing.assert_array_equal(iio.imread(name), PICTURE)
    Path(name).unlink()


def test_on_a_desktop_a_viewer_shows_it(
    viewed: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    Picture(PICTURE).show()
    np.testing.assert_array_equal(viewed, [PICTURE])
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("kernel", [True, False], ids=["notebook", "terminal"])
def test_in_a_notebook_it_appears_below_the_cell(viewed: list[Any], monkeypatch: pytest.MonkeyPatch, kernel: bool) -> None:
    shell = SimpleNamespace(kernel=None) if kernel else SimpleNamespace()
    told: list[Any] = []
    ipython, shows = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: shell  # type: ignore[attr-defined]
    shows.display = lambda data, raw: told.append((data, raw))  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", shows)
    monkeypatch.setenv("DISPLAY", ":0")
    show(PICTURE)
    assert told == ([({"image/png": to_png(PICTURE)}, True)] if kernel else [])
    assert len(viewed) == (0 if kernel else 1)


def test_arrays_that_are_not_pictures_are_not_shown() -> None:
    with pytest.raises(clvol.OptionError, match="a picture has shape"):
        show(np.zeros((2, 3, 5)))


# -- the package ---------------------------------------------------------------------------------------------


def test_heavy_modules_are_imported_on_first_use() -> None:
    code = """
import sys, clvol
late = ("analysis", "figures", "reference", "reports")
assert not [name for name in late if f"clvol.{name}" in sys.modules]
assert set(late) <= set(dir(clvol)) and "render" in dir(clvol)
assert clvol.figures.FIGURES and clvol.reports.page and clvol.analysis.metrics and clvol.reference.sample
assert not hasattr(clvol, "xarray") and not hasattr(clvol, "no_such_name")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=60, check=False)
    assert done.returncode == 0, done.stderr
