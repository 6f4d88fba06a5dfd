from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol import DataError, FormatError, OptionError, Volume, phantoms, reports
from clvol.analysis import EXACT_SINC, ErrorRow, ErrorTable
from clvol.boundary import as_boundary
from clvol.device import Device
from clvol.filter import as_filters
from clvol.reports import advice, html, pictures, spectrum

pytest.importorskip("matplotlib")
FEW = ("nearest", "linear", "bspline3")


class Page(HTMLParser):
    """What a page holds: tags, attributes, words."""

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


def test_a_report_is_one_page_that_needs_nothing_else(made: tuple[reports.Report, Page, list[float]]) -> None:
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


def test_a_report_holds_all_sections(made: tuple[reports.Report, Page, list[float]]) -> None:
    done, page, _ = made
    assert page.text.startswith("Which filter for a <b> & c?")
    for heading in ("Errors", "Pictures", "Frequencies", "Error and time"):
        assert heading in page.words
    for sentence in done.advice.sentences:
        assert sentence in page.text
    for row in done.table:
        for number in (f"{row.rms:.3g}", f"{row.maximum:.3g}"):
            assert number in page.words
    for word in ("22 × 26 × 24, float32", "1 × 1 × 1.5", "mirror", "whole", "close-up from every second sample"):
        assert word in page.text
    assert page.tags.count("img") == 5 * len(FEW) + 2


def test_pictures_of_a_report_are_pictures(made: tuple[reports.Report, Page, list[float]]) -> None:
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


def test_the_table_of_a_report_is_that_of_compare(made: tuple[reports.Report, Page, list[float]]) -> None:
    table = made[0].table
    assert [row.filter for row in table] == [*FEW, EXACT_SINC]
    wanted = clvol.analysis.compare(blob(), FEW, timing=False, points=500)
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


def test_a_report_that_cannot_be_written_is_refused_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    for output in (tmp_path / "report", tmp_path / "a.html", tmp_path):
        with pytest.raises(FormatError, match=r"cannot write .*: nothing can be made in .*: Permission denied"):
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


@pytest.mark.parametrize(
    "data",
    [np.full((9, 9, 9), 4.0), np.zeros((1, 1, 1)), np.arange(8.0).reshape(2, 2, 2), np.eye(6)[:, :, None] * np.ones(3)],
    ids=["constant", "one sample", "2³", "thin"],
)
def test_odd_data_give_a_report(tmp_path: Path, device: Device, data: np.ndarray) -> None:
    done = reports.report(Volume(data), tmp_path / "a.html", filters=FEW, pixels=16, device=device)
    page = Page(done.path.read_text(encoding="utf-8"))
    assert not re.search(r"\b(nan|inf)\b", page.text, re.IGNORECASE)
    assert done.advice.filter in FEW
    if np.ptp(data) == 0:
        assert done.advice.filter == "linear"
        assert "constant" in page.text


@pytest.mark.parametrize("value", [0.1, 3.7, -1234.567, 0.0])
def test_of_constant_data_nothing_is_drawn(tmp_path: Path, device: Device, value: float) -> None:
    """What a picture would show is the noise of float32 about the only value there is."""
    done = reports.report(Volume(np.full((13, 12, 11), value)), tmp_path / "a.html", filters=FEW, pixels=16, device=device)
    page = Page(done.path.read_text(encoding="utf-8"))
    assert page.tags.count("img") == 1  # the filters' responses
    assert "All samples have the same value: there is nothing to draw." in page.text
    assert "The data are constant" in page.text
    assert spectrum.high_share(spectrum.spectra(Volume(np.full((13, 12, 11), value)))) is None


def test_what_cannot_be_reported_is_said_first(tmp_path: Path, device: Device) -> None:

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


def test_a_report_takes_filters_that_no_table_knows(tmp_path: Path, device: Device) -> None:
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


def test_of_a_large_volume_the_middle_is_measured() -> None:
    volume = Volume(np.arange(20 * 30 * 40, dtype=np.float32).reshape(20, 30, 40), (1, 2, 3))
    middle = reports._middle(volume, 1000)
    assert 700 < middle.data.size <= 1000
    np.testing.assert_allclose(middle.center, volume.center, atol=2)
    assert reports._middle(middle, 1000) is middle


# -- advice ------------------------------------------------------------------------------------------------------


def table(*rows: tuple[str, float, float | None, float | None, float]) -> ErrorTable:
    """Rows of (filter, rms, gradient rms, seconds, overshoot), of data in 0..1."""
    return ErrorTable(
        [ErrorRow(name, rms, rms, 20.0, 0.9, slope, 10.0, 10.0, 10.0, over, took) for name, rms, slope, took, over in rows],
        samples=Volume(np.array([[0.0, 1.0]])),
        against="",
        points=1,
        boundary="mirror",
        evaluated_on="",
        timed_on="",
    )


def test_the_narrowest_of_the_best_is_recommended() -> None:
    given = advice.advise(
        table(
            ("linear", 0.2, 2.0, 0.01, 0),
            ("bspline3", 0.104, 1.0, 0.02, 0.05),
            ("bspline5", 0.1, 1.0, 0.06, 0.05),
            ("hybrid", 0.104, 1.5, 0.015, 0.05),
            (EXACT_SINC, 0.09, 0.9, None, 0.1),
        ),
        high=0.2,
    )
    assert given.filter == "bspline3"
    text = " ".join(given.sentences)
    assert "error is 48 % smaller than that of linear interpolation (RMS 0.104 against 0.2), at 2.0 times the time" in text
    assert "bspline5 has the smallest error, 3.8 % lower, at 3.0 times the time" in text
    assert "error of its gradients, which shade surfaces, is 50 % smaller than with linear" in text
    assert "leaves the range of the samples by up to 5 %; if that must not happen, use linear" in text
    assert "exact sinc, ideal in theory, has a 13 % smaller error than bspline3 on these data" in text
    assert "20 % of their variance lies above half of the Nyquist frequency: they are rich in detail" in text


def test_a_recommendation_is_a_sentence() -> None:
    given = advice.advise(table(("linear", 0.2, 2.0, None, 0), ("mitchell", 0.1, 1.0, None, 0.004)))
    assert given.sentences[0] == "For these data use mitchell (Mitchell B = C = 1/3)."
    assert given.sentences[-1] == "It leaves the range of the samples by no more than 0.4 %."
    given = advice.advise(table(("lanczos3", 0.1, 1.0, None, 1e-9)))
    assert given.sentences == ["For these data use lanczos3.", "It stays within the range of the samples."]


def test_the_best_of_each_column_is_bold() -> None:
    made = table(("linear", 0.2, 2.0, 0.01, 0.0), ("mitchell", 0.1, None, 0.02, 0.0))
    made[1] = replace(made[1], psnr=30.0, ssim=0.5)
    assert html._best(made) == {1: {1}, 2: {1}, 3: {1}, 4: {0}, 5: {0}, 6: {0, 1}, 7: {0, 1}, 8: {0, 1}, 9: {0, 1}, 10: {0}}
    assert "The best of each column is bold: the largest PSNR and SSIM, the smallest of the others." in html._NOTES[-1]


def test_the_exact_sinc_is_measured_where_the_others_are(made: tuple[reports.Report, Page, list[float]]) -> None:
    table = made[0].table
    wanted = clvol.analysis.compare(blob(), [EXACT_SINC], timing=False, points=20_000)
    assert table[-1] == wanted[0]
    assert table.points == wanted.points > 1000


def test_where_little_is_gained_it_is_said() -> None:
    given = advice.advise(table(("linear", 0.104, 1.0, 0.01, 0), ("bspline3", 0.1, 0.99, 0.02, 0.0)), high=0.001)
    assert given.filter == "linear"
    text = " ".join(given.sentences)
    assert "bspline3 has the smallest error, 3.8 % lower" in text
    assert text.startswith("For these data use linear. bspline3 has the smallest")
    assert "It stays within the range of the samples. " in text
    assert "very smooth" in text
    given = advice.advise(table(("linear", 0.104, 1.2, 0.01, 0), ("bspline3", 0.1, 0.99, 0.02, 0.0)))
    assert given.filter == "bspline3"  # by its gradients
    assert "The choice matters little here: its error is 3.8 % smaller" in " ".join(given.sentences)


def test_of_equals_the_smoothest_is_recommended() -> None:
    given = advice.advise(
        table(("omoms3", 0.1, 1.0, 0.020, 0), ("bspline3", 0.102, 1.0, 0.023, 0), ("bspline5", 0.1, 1.0, 0.01, 0))
    )
    assert given.filter == "bspline3"  # omoms3 has creases; bspline5 is wider, and times are chance


def test_without_times_and_gradients_there_is_advice() -> None:
    given = advice.advise(
        table(("bspline5", 0.1, 1.0, None, 0), ("bspline3", 0.101, 1.0, None, 0), ("nearest", 0.102, None, None, 0))
    )
    assert given.filter == "bspline3"  # nearest has no gradient
    assert "time" not in " ".join(given.sentences)
    assert advice.advise(table(("nearest", 0.1, None, None, 0))).filter == "nearest"


def test_a_perfect_filter_is_recommended_without_dividing_by_nothing() -> None:
    given = advice.advise(table(("linear", 0.0, 0.0, 0.01, 0), ("nearest", 0.1, None, 0.01, 0), (EXACT_SINC, 0.1, 1.0, None, 0)))
    assert given.filter == "linear"
    assert "inf" not in " ".join(given.sentences)


# -- spectra and pictures ------------------------------------------------------------------------------------------


def test_spectra_find_a_wave_where_it_is() -> None:
    x = np.arange(64)
    data = np.broadcast_to(np.cos(np.pi * 0.75 * x), (5, 2, 64))
    found = spectrum.spectra(Volume(data.copy()))
    assert [name for name, _, _ in found] == ["z", "x"]  # y has two samples
    omega, power = found[1][1:]
    assert omega[-1] == pytest.approx(np.pi)
    assert omega[power.argmax()] == pytest.approx(0.75 * np.pi, abs=2 * np.pi / 64)
    assert power.sum() == pytest.approx(1)
    assert spectrum.high_share(found[1:]) > 0.95
    assert spectrum.high_share(spectrum.spectra(Volume(np.ones((4, 4, 4))))) is None


def test_pictures_of_fewer_samples_are_as_opaque(device: Device) -> None:
    """Opacity is that of a length in the world, not of a sample, of which the decimated volume has fewer."""
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


def test_close_ups_look_at_what_differs() -> None:
    rgba, position = np.zeros((24, 24, 4), np.float32), np.full((24, 24, 3), np.nan, np.float32)
    other = rgba.copy()
    other[5:8, 15:18] = 1
    position[2:22, 2:22] = np.stack(np.meshgrid(np.arange(20), np.arange(20), [0.0]), -1)[:, :, 0]
    camera = clvol.Camera.orbit(10, 20)
    closer = pictures._closer(camera, {"rgba": rgba, "position": position}, {"rgba": other, "position": position})
    assert closer.target == pytest.approx((14.0, 4.0, 0.0), abs=1.01)
    assert closer.zoom == 4
    nothing = {"rgba": rgba, "position": np.full_like(position, np.nan)}
    assert pictures._closer(camera, nothing, {**nothing, "rgba": other}) == camera.zoomed(4)


def test_differences_are_heat() -> None:
    colours = html._heat([[0.0, 0.5, 1.0, 2.0]], 1.0)
    np.testing.assert_allclose(colours[0, 0], 1)
    np.testing.assert_allclose(colours[0, 2], colours[0, 3])
    assert colours[0, 1].tolist() == list(html._WHITE_TO_RED[1])
