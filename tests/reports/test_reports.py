from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol import DataError, FormatError, OptionError, Volume, phantoms, reports
from clvol.analysis import EXACT_SINC, LeftOutRow, LeftOutTable
from clvol.analysis.trial import middle_part
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filters
from clvol.reports import html, pictures, spectrum

pytest.importorskip("matplotlib")
FEW = ("nearest", "linear", "bspline3")


class Page(HTMLParser):
    """The content of a page: tags, attributes, words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("img", "meta", "br"):
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag  # what is opened is closed, in order

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def blob(n: int = 24) -> Volume:
    rng = np.random.default_rng(0)
    noise = Volume(rng.normal(0, 1, (n, n + 2, n - 2)).astype(np.float32), (1.0, 1.0, 1.5)).gaussian(1.5)
    return Volume(noise.data + 0.2 * phantoms.sphere((n, n + 2, n - 2)).data, noise.spacing)


@pytest.fixture(scope="module")
def made(device: Device, tmp_path_factory: pytest.TempPathFactory) -> tuple[reports.Report, Page, list[float]]:
    reported: list[float] = []
    done = reports.report(
        blob(),
        tmp_path_factory.mktemp("out") / "report",
        "a <b> & c",
        FEW,
        32,
        device=device,
        progress=reported.append,
        camera=clvol.Camera.orbit(20, 30),
        mode="isosurface",
    )
    return done, Page(done.path.read_text(encoding="utf-8")), reported


def test_a_report_is_one_self_contained_page(made: tuple[reports.Report, Page, list[float]]) -> None:
    done, page, _ = made
    assert done.path.name == "index.html"
    assert list(done.path.parent.iterdir()) == [done.path]
    text = done.path.read_text(encoding="utf-8")
    outside = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"(?:https?:)?//\w|@import|url\(", outside)
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert page.open == []
    assert page.links
    assert all(link.startswith("data:image/png;base64,") for link in page.links)


def test_a_report_contains_all_sections(made: tuple[reports.Report, Page, list[float]]) -> None:
    done, page, _ = made
    assert page.text.startswith("Which filter for a <b> & c?")
    for heading in (
        "Errors to expect",
        "Pictures",
        "Measured: from every second sample",
        "Measured: slices left out",
        "Measured: turned in a circle",
        "Frequencies",
        "Error and time",
    ):
        assert heading in page.words
    for sentence in done.advice.sentences:
        assert sentence in page.text
    for row in done.table:
        for number in (f"{row.rms:.3g}", f"{row.maximum:.3g}"):
            assert number in page.words
    assert done.turned is not None
    for row in (*done.advice.expected, *done.turned):
        assert f"{row.rms:.3g}" in page.words
    for row in done.left_out:
        assert f"{row.z:.3g}" in page.words
    for word in (
        "22 × 26 × 24, float32",
        "1 × 1 × 1.5",
        "mirror",
        "whole",
        "low-passed by a Gaussian of standard deviation 1",
        "close-up from every second sample",
    ):
        assert word in page.text
    assert page.tags.count("img") == 5 * len(FEW) + 2


def test_images_of_a_report_are_valid(made: tuple[reports.Report, Page, list[float]]) -> None:
    _, page, _ = made
    arrays = [iio.imread(io.BytesIO(base64.b64decode(link.partition(",")[2]))) for link in page.links]
    for cells in (arrays[i : i + 5] for i in (0, 5, 10)):
        for picture in cells:
            assert picture.shape == (32, 32, 3)
        assert all(picture.std() > 5 for picture in cells[:2])
    chosen = FEW.index(made[0].advice.filter)
    assert (arrays[5 * chosen + 2] == 255).all()  # the recommended one does not differ from itself
    assert not (arrays[2] == 255).all()


def test_progress_of_a_report_rises_to_one(made: tuple[reports.Report, Page, list[float]]) -> None:
    reported = made[2]
    assert reported == sorted(reported)
    assert reported[-1] == 1
    assert len(reported) > 8


def test_the_table_of_a_report_matches_compare(made: tuple[reports.Report, Page, list[float]]) -> None:
    table = made[0].table
    assert [row.filter for row in table] == [*FEW, EXACT_SINC]
    wanted = clvol.analysis.compare(blob(), FEW, timing=False, points=20_000, max_samples=reports._COMPARED)
    assert [row.rms for row in table][:3] == [pytest.approx(row.rms) for row in wanted]


# -- where it goes -----------------------------------------------------------------------------------------------


def test_a_report_goes_to_a_folder_or_a_file(tmp_path: Path) -> None:
    assert reports.page(tmp_path / "report") == tmp_path / "report" / "index.html"
    assert reports.page(f"{tmp_path}/report/") == tmp_path / "report" / "index.html"
    assert reports.page(tmp_path / "a.HTML") == tmp_path / "a.HTML"
    (tmp_path / "taken").write_text("x")
    with pytest.raises(FormatError, match=r"to a folder, or to a file that ends in \.html"):
        reports.page(tmp_path / "taken")
    for bad in (tmp_path / "none" / "report", tmp_path / "none" / "a.html"):
        with pytest.raises(FormatError, match="does not exist"):
            reports.page(bad)


def test_unwritable_reports_are_rejected_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    for output in (tmp_path / "report", tmp_path / "a.html", tmp_path):
        with pytest.raises(FormatError, match=r"cannot write .*: cannot create files in .*: Permission denied"):
            reports.page(output)


def test_an_interrupted_report_leaves_nothing(tmp_path: Path, device: Device) -> None:
    def interrupt(done: float) -> None:
        if done > 0.7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reports.report(phantoms.sphere(8), tmp_path / "report", filters=("linear",), pixels=16, device=device, progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_report_replaces_an_old_one(tmp_path: Path, device: Device) -> None:
    (tmp_path / "a.html").write_text("old")
    done = reports.report(phantoms.sphere(8), tmp_path / "a.html", filters=("linear",), pixels=16, device=device)
    assert done.path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert list(tmp_path.iterdir()) == [tmp_path / "a.html"]


# -- data of any kind ----------------------------------------------------------------------------------------------


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    "data",
    [np.full((9, 9, 9), 4.0), np.zeros((1, 1, 1)), np.arange(8.0).reshape(2, 2, 2), np.eye(6)[:, :, None] * np.ones(3)],
    ids=["constant", "one sample", "2³", "thin"],
)
def test_unusual_data_give_a_report(tmp_path: Path, device: Device, data: np.ndarray) -> None:
    done = reports.report(Volume(data), tmp_path / "a.html", filters=FEW, pixels=16, device=device)
    page = Page(done.path.read_text(encoding="utf-8"))
    assert not re.search(r"\b(nan|inf)\b", page.text, re.IGNORECASE)
    if data.shape == (2, 2, 2):  # too few samples to tell noise from detail
        assert done.advice.filter is None
    else:
        assert done.advice.filter in FEW
    if np.ptp(data) == 0:
        assert done.advice.filter == "linear"
        assert "constant" in page.text


@pytest.mark.one_in(4)
@pytest.mark.parametrize("value", [0.1, 3.7, -1234.567, 0.0])
def test_constant_data_are_not_rendered(tmp_path: Path, device: Device, value: float) -> None:
    """A picture would show the noise of float32 about the only value."""
    done = reports.report(Volume(np.full((13, 12, 11), value)), tmp_path / "a.html", filters=FEW, pixels=16, device=device)
    page = Page(done.path.read_text(encoding="utf-8"))
    assert page.tags.count("img") == 1  # the filters' responses
    assert "All samples have the same value: there is nothing to draw." in page.text
    assert "The data are constant" in page.text


def test_unreportable_input_is_rejected_first(tmp_path: Path, device: Device) -> None:

    def nothing(done: float) -> None:
        pytest.fail(f"{done} of the work was done")

    bad = np.zeros((5, 5, 5))
    bad[1, 2, 3] = np.nan
    cases: list[tuple[Any, dict[str, Any], type[Exception], str]] = [
        (Volume(bad), {}, DataError, "finite"),
        (Volume(np.zeros((5, 5))), {}, OptionError, r"3 axes; got shape \(5, 5\)"),
        (phantoms.sphere(5), {"filters": "linear"}, OptionError, "one or more names"),
        (phantoms.sphere(5), {"filters": ()}, OptionError, "one or more names"),
        (phantoms.sphere(5), {"filters": ("bogus",)}, OptionError, "bogus"),
        (phantoms.sphere(5), {"filters": (EXACT_SINC,)}, OptionError, "must name one to be drawn beside 'exact-sinc'"),
        (phantoms.sphere(5), {"pixels": 4}, OptionError, "pixels"),
        (phantoms.sphere(5), {"boundary": "none"}, OptionError, "boundary"),
    ]
    for volume, options, error, words in cases:
        with pytest.raises(error, match=words):
            reports.report(volume, tmp_path / "a.html", device=device, progress=nothing, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
def test_a_report_accepts_custom_filters(tmp_path: Path, device: Device) -> None:
    wide = clvol.from_callable("wide tent", lambda x: np.maximum(1 - np.abs(x) / 2, 0) / 2, 2)
    for filters in ((clvol.bspline(7), wide), (wide,)):
        done = reports.report(phantoms.marschner_lobb(16), tmp_path / "a.html", filters=filters, pixels=16, device=device)
        assert [row.filter for row in done.table] == [*(f.name for f in filters), EXACT_SINC]
        assert done.table.filters == list(filters)
        assert done.advice.filter in [f.name for f in filters]
        page = Page(done.path.read_text(encoding="utf-8"))
        assert "wide tent" in page.text
        assert page.tags.count("img") == 5 * len(filters) + 2


def test_without_a_period_there_is_no_exact_sinc(tmp_path: Path, device: Device) -> None:
    done = reports.report(
        phantoms.sphere(10), tmp_path / "a.html", filters=("linear",), pixels=16, boundary="zero", device=device, mode="mip"
    )
    assert [row.filter for row in done.table] == ["linear"]
    with pytest.raises(OptionError, match="boundary must be mirror, reflect or wrap for 'exact-sinc'; got 'zero'"):
        reports.report(phantoms.sphere(5), tmp_path / "b.html", filters=("linear", EXACT_SINC), boundary="zero", device=device)
    done = reports.report(phantoms.sphere(5), tmp_path / "b.html", filters=(EXACT_SINC, "linear"), pixels=16, device=device)
    assert [row.filter for row in done.table] == ["linear", EXACT_SINC]


def test_the_middle_of_a_large_volume_is_measured() -> None:
    volume = Volume(np.arange(20 * 30 * 40, dtype=np.float32).reshape(20, 30, 40), (1, 2, 3))
    middle = middle_part(volume, 1000)
    assert 700 < middle.data.size <= 1000
    np.testing.assert_allclose(middle.center, volume.center, atol=2)
    assert middle_part(middle, 1000) is middle


# -- tables --------------------------------------------------------------------------------------------------------


def test_the_best_of_each_column_is_bold() -> None:
    records = [
        {"filter": "linear", "rms": 0.2, "psnr": None, "ssim": 0.9, "seconds": 0.01},
        {"filter": "mitchell", "rms": 0.1, "psnr": 30.0, "ssim": 0.9, "seconds": None},
    ]
    assert html._best(records) == [set(), {1}, {1}, {0, 1}, {0}]
    assert "The best of each column is bold." in html._BEST


def test_the_two_sincs_have_two_names() -> None:
    rows = [LeftOutRow(name, 1.5, 1.0, 2.5) for name in ("sinc", EXACT_SINC)]
    named = re.findall(r"</span>([^<]+)<br>", html._table(LeftOutTable(rows, sigma=0.0, spacing=(1, 1, 1)), "sinc"))
    assert named == ["sinc", EXACT_SINC]


def test_empty_columns_are_omitted() -> None:
    rows = LeftOutTable([LeftOutRow("linear", 1.5, None, 2.5)], sigma=0.0, spacing=(1, 1, 1))
    text = html._table(rows, "linear")
    assert "along z" in text
    assert "along y" not in text


def test_the_exact_sinc_is_measured_in_the_same_region(made: tuple[reports.Report, Page, list[float]]) -> None:
    table = made[0].table
    assert table[-1].filter == EXACT_SINC
    wanted = clvol.analysis.compare(blob(), [EXACT_SINC], timing=False, points=20_000, max_samples=reports._COMPARED)
    assert table[-1] == wanted[0]
    assert table.points == wanted.points > 1000


def test_the_loss_from_the_low_pass_is_stated(made: tuple[reports.Report, Page, list[float]]) -> None:
    done, page, _ = made
    assert done.table.lost > 0
    assert f"The low-pass itself removed {done.table.lost:.3g} (RMS) from the samples" in page.text


def test_the_advice_of_a_report_matches_advise(made: tuple[reports.Report, Page, list[float]]) -> None:
    given = reports.advise(blob(), [*FEW, EXACT_SINC])
    assert (made[0].advice.filter, made[0].advice.sentences) == (given.filter, given.sentences)


def test_automatic_smoothing_is_settled_once(tmp_path: Path, device: Device) -> None:
    noisy = Volume(phantoms.sphere(24).data + np.random.default_rng(0).normal(0, 0.1, (24, 24, 24)).astype(np.float32))
    names = ("linear", "bspline3", "bspline3(auto)")
    done = reports.report(noisy, tmp_path / "a.html", filters=names, pixels=16, device=device)
    settled = clvol.volume.smoothing.settled("bspline3(auto)", noisy).name
    assert settled != "bspline3"
    assert [row.filter for row in done.table] == ["linear", "bspline3", settled, EXACT_SINC]
    assert done.advice.filter == settled
    done = reports.report(phantoms.sphere(24), tmp_path / "b.html", filters=names, pixels=16, device=device)
    assert [row.filter for row in done.table] == ["linear", "bspline3", EXACT_SINC]  # λ is 0 there: one row


def test_smoothing_may_differ_per_axis(tmp_path: Path, device: Device) -> None:
    """A noisy plate: smoothed along it, and hardly across it."""
    z = np.arange(32.0)[:, None, None]
    noise = np.random.default_rng(0).normal(0, 0.1, (32, 32, 32))
    plate = Volume((np.exp(-((z - 15.3) ** 2)) + noise).astype(np.float32))
    done = reports.report(plate, tmp_path / "a.html", filters=("linear", "bspline3(auto)"), pixels=16, device=device)
    row = done.table.filters[1]
    assert isinstance(row.smoothing, tuple)
    assert len(set(row.smoothing)) > 1
    assert done.advice.filter == row.name
    assert done.turned is not None
    assert [turned.filter for turned in done.turned] == ["linear", row.name]
    drawn = spectrum.plot([], [row, as_filters(["linear"])[0]]).axes[0].get_lines()[1:]
    assert len(drawn) == len(set(row.smoothing)) + 1
    assert "along z" in drawn[-2].get_label()
    assert "along" not in drawn[-1].get_label()


# -- spectra and pictures ------------------------------------------------------------------------------------------


def test_spectra_show_a_wave_at_its_frequency() -> None:
    x = np.arange(64)
    data = np.broadcast_to(np.cos(np.pi * 0.75 * x), (5, 2, 64))
    found = spectrum.spectra(Volume(data.copy()))
    assert [name for name, _, _ in found] == ["z", "x"]  # y has two samples
    omega, power = found[1][1:]
    assert omega[-1] == pytest.approx(np.pi)
    assert omega[power.argmax()] == pytest.approx(0.75 * np.pi, abs=2 * np.pi / 64)
    assert power.sum() == pytest.approx(1)


def test_pictures_of_decimated_volumes_are_as_opaque(device: Device) -> None:
    """Opacity refers to a length in the world, not to a sample."""
    x = np.linspace(-1, 1, 41)
    volume = Volume((2 - x**2 - x[:, None] ** 2 - x[:, None, None] ** 2).astype(np.float32))
    fog = clvol.TransferFunction(((0.0, "white"),), ((0.0, 0.0), (2.0, 0.05)))
    (row,) = as_filters(["bspline3"])
    drawn = pictures.cards(
        volume, [row], row, 32, as_boundary("mirror"), 2, device, lambda _: None, {"mode": "composite", "transfer": fog}
    )
    (card,) = drawn.cards
    assert card.closer.std() > 0.01
    assert np.median(card.error) < 0.01


def plane(slope: float, n: int = 48) -> np.ndarray:
    """Positions on a plane that a camera looking along +y sees at (x, z) of [-1, 1]², receding by `slope` to the right."""
    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(1, -1, n))
    return np.stack([x, slope * x, z], -1).astype(np.float32)


def test_close_ups_show_the_largest_difference() -> None:
    volume = Volume(np.zeros((9, 9, 9)), (0.25,) * 3, (-1.0,) * 3)
    rgba, position = np.zeros((48, 48, 4), np.float32), plane(0.2)
    position[:4] = np.nan
    other = rgba.copy()
    other[10:16, 30:36] = 1
    camera = clvol.Camera(projection="orthographic")
    closer = pictures._closer(camera, volume, {"rgba": rgba, "position": position}, {"rgba": other, "position": position})
    assert closer.target == pytest.approx((0.38, 0.08, 0.46), abs=0.15)
    assert closer.zoom == 4
    nothing = {"rgba": rgba, "position": np.full_like(position, np.nan)}
    assert pictures._closer(camera, volume, nothing, {**nothing, "rgba": other}) == camera.zoomed(4)


def test_close_ups_avoid_a_grazing_edge() -> None:
    """The left half faces the camera and differs little; the right half is seen at 84° and differs most."""
    volume = Volume(np.zeros((9, 9, 9)), (0.25,) * 3, (-1.0,) * 3)
    position = plane(0.2)
    position[:, 24:] = plane(10.0)[:, 24:]
    rgba = np.zeros((48, 48, 4), np.float32)
    other = rgba.copy()
    other[20:26, 8:14] = 0.1
    other[20:26, 34:40] = 1
    camera = clvol.Camera(projection="orthographic")
    closer = pictures._closer(camera, volume, {"rgba": rgba, "position": position}, {"rgba": other, "position": position})
    assert closer.target is not None
    assert closer.target[0] < -0.2


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_visible_matter_fills_the_pictures(device: Device, projection: Any) -> None:
    """A small ball in a corner of the volume."""
    z, y, x = np.indices((40, 40, 40))
    volume = Volume((5 - np.sqrt((x - 30) ** 2 + (y - 12) ** 2 + (z - 27) ** 2)).astype(np.float32))
    (row,) = as_filters(["linear"])
    look = {"mode": "isosurface", "isovalue": 0.0}
    shown = {}
    for fit in ("volume", "matter"):
        camera = clvol.Camera.orbit(20, 10, projection=projection, fit=fit)  # type: ignore[arg-type]
        drawn = pictures.cards(volume, [row], row, 64, as_boundary("mirror"), 2, device, lambda _: None, {**look, "camera": camera})
        seen = (drawn.cards[0].whole < 0.99).any(-1)
        assert (drawn.cards[0].whole[0, 0] == 1).all()  # on white
        shown[fit] = (np.ptp(np.flatnonzero(seen.any(0))) + 1, np.ptp(np.flatnonzero(seen.any(1))) + 1)
    assert max(shown["volume"]) < 25
    assert 48 <= max(shown["matter"]) <= 63


def test_differences_are_heat() -> None:
    colours = html._heat([[0.0, 0.5, 1.0, 2.0]], 1.0)
    np.testing.assert_allclose(colours[0, 0], 1)
    np.testing.assert_allclose(colours[0, 2], colours[0, 3])
    assert colours[0, 1].tolist() == list(html._WHITE_TO_RED[1])
