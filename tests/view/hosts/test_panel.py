"""The panel's labels, channels and times in a real browser: by pointer and keys, in light and dark themes, on a phone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clvol import TransferFunction2D, Volume, Volumes, phantoms
from clvol.device import Device
from clvol.view import Session, State, View
from clvol.view.drawing import Drawer
from clvol.volume.volumes import Leading
from tests.view.browser import Browser, open_browser, why_none

pytest.importorskip("aiohttp", reason="needs aiohttp")
from clvol.view.hosts.server import serve

pytestmark = pytest.mark.skipif(bool(why_none()), reason=why_none())
SIZE = 700, 700  # of the window: a narrow picture, soon drawn
FINAL = "document.querySelector('.clvol-pane[data-frame]')?.dataset.final === 'true'"
ROWS = "[...document.querySelectorAll('.clvol-labels li')].filter((row) => row.checkVisibility())"
NOTE = "document.querySelector('.clvol-labels + .clvol-note').textContent"


class Watched(View):
    """A view that keeps its last session."""

    last: Session

    def session(self, send: Any, state: State | None = None) -> Session:
        self.last = super().session(send, state)
        return self.last


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser(*SIZE) as found:
        yield found


@pytest.fixture
def organs(browser: Browser, device: Device) -> Iterator[Watched]:  # noqa: ARG001  # sessions use the default one
    """Three organs, two of which have names."""
    data = np.zeros((20, 20, 36), np.uint8)
    for number, at in ((1, 4), (2, 14), (7, 24)):
        data[5:15, 5:15, at : at + 8] = number
    yield from shown(browser, Watched(Volume(data, labels={1: "liver", 2: "left kidney"})))


@pytest.fixture
def many(browser: Browser, device: Device) -> Iterator[Watched]:  # noqa: ARG001
    data = np.arange(600, dtype=np.uint16).reshape(5, 10, 12).repeat(2, 2)
    yield from shown(browser, Watched(Volume(data, labels={555: "Hippocampus"})))


@pytest.fixture
def cells(browser: Browser, device: Device) -> Iterator[Watched]:  # noqa: ARG001
    """A moving ball, in two channels."""
    z, y, x = np.mgrid[:16, :16, :24]
    frames = [
        [100 * (1 + 9 * c) * np.exp(-((x - 6 - t) ** 2 + (y - 8) ** 2 + (z - 8) ** 2) / 9) for c in range(2)] for t in range(9)
    ]
    leading = Leading(("time", "channel"), (9, 2), {"channel": ("DAPI", "GFP")})
    yield from shown(browser, Watched(Volumes(np.array(frames, np.float32), leading=leading)))


def shown(browser: Browser, view: Watched) -> Iterator[Watched]:
    with serve(view) as server:
        browser.open(server.url)
        browser.wait(FINAL, 60)
        browser.console()  # left by other tests
        yield view
        browser.open("about:blank")  # else the page goes on asking a server that has ended
    view.close()


def labels_of(view: Watched) -> Any:
    return view.last.state.json()["labels"]


def click(browser: Browser, found: str) -> None:
    browser.js(f"({found}).click()")


def picture(browser: Browser) -> np.ndarray:
    return browser.canvas()[..., :3].astype(int)


def test_labels_are_hidden_and_shown_again(browser: Browser, organs: Watched) -> None:
    assert browser.js(f"return {ROWS}.map((row) => row.querySelector('label').textContent)") == ["liver", "left kidney", "7"]
    colors = browser.js(f"return {ROWS}.map((row) => row.querySelector('.clvol-swatch').value)")
    assert len(set(colors)) == 3
    all_of_them = picture(browser)
    click(browser, f"{ROWS}[1].querySelector('input')")
    browser.wait(lambda: labels_of(organs) == {"hidden": [2]})
    browser.wait(lambda: browser.js(f"return {FINAL}") and (picture(browser) != all_of_them).any())
    assert browser.js(f"return {NOTE}") == "2 of 3 shown"
    click(browser, f"{ROWS}[2].querySelector('button')")
    browser.wait(lambda: labels_of(organs) == {"shown": [7]})
    browser.wait(f"{ROWS}.map((row) => row.querySelector('input').checked).join() === 'false,false,true'")
    click(browser, f"{ROWS}[0].querySelector('input')")
    browser.wait(lambda: labels_of(organs) == {"shown": [1, 7]})
    click(browser, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'None')")
    browser.wait(lambda: labels_of(organs) == {"shown": []})
    browser.wait(lambda: not picture(browser).any())
    for labels in ({"shown": [1, 7]}, {"shown": [7]}, {"hidden": [2]}):
        browser.wait(lambda: not browser.js("return document.querySelector('.clvol-buttons button').disabled"))
        click(browser, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'Undo')")
        browser.wait(lambda labels=labels: labels_of(organs) == labels)  # type: ignore[misc]
    click(browser, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'All')")
    browser.wait(lambda: labels_of(organs) is None)
    browser.wait(lambda: (picture(browser) == all_of_them).all(), 30)  # the camera stayed
    assert not browser.console()


def test_labels_get_other_colours_and_opacities(browser: Browser, organs: Watched) -> None:
    as_given = picture(browser)
    bars = "[...document.querySelectorAll('.clvol-graph [data-label]')].map((bar) => [bar.dataset.label, bar.getAttribute('fill')])"
    swatches = f"{ROWS}.map((row) => row.querySelector('.clvol-swatch').value)"
    own = browser.js(f"return {swatches}")
    assert browser.js(f"return {bars}") == [[number, color] for number, color in zip("127", own, strict=True)]

    def put(control: str, value: str) -> None:
        events = "for (const e of ['input', 'change']) c.dispatchEvent(new Event(e, { bubbles: true }))"
        browser.js(f"const c = {ROWS}[0].querySelector('{control}'); c.value = '{value}'; {events}")

    put(".clvol-swatch", "#0000ff")
    browser.wait(lambda: browser.js(f"return {bars}") == [["1", "#0000ff"], ["2", own[1]], ["7", own[2]]])
    put("input[type=range]", "0.25")
    changed = ("label_colors", {"1": [0, 0, 1]}), ("label_opacities", {"1": 0.25})
    browser.wait(lambda: all(organs.last.state.json()[word] == value for word, value in changed))
    browser.wait(lambda: browser.js(f"return {FINAL}") and (picture(browser) != as_given).any())
    click(browser, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'Undo')")
    browser.wait(lambda: organs.last.state.label_rows == {1: (None, (0, 0, 1), None)})
    browser.wait(f"{ROWS}[0].querySelector('input[type=range]').value === '1'")
    click(browser, "[...document.querySelectorAll('button')].find((b) => b.textContent === 'Reset')")
    browser.wait(lambda: not organs.last.state.label_rows)
    browser.wait(lambda: (picture(browser) == as_given).all(), 30)
    assert not browser.console()


def test_labels_are_reached_by_keys(browser: Browser, organs: Watched) -> None:
    """The whole section by Tab; Space hides or isolates a label."""
    browser.js("[...document.querySelectorAll('summary')].find((s) => s.textContent === 'Labels').focus()")
    name = "e.getAttribute('aria-label') || e.closest('label')?.textContent || e.textContent"
    met = []
    for _ in range(15):
        browser.key("Tab", windowsVirtualKeyCode=9)
        met.append(browser.js(f"const e = document.activeElement; return {name}"))
    rows = ((name, f"colour of {name}", f"opacity of {name}", f"show only {name}") for name in ("liver", "left kidney", "7"))
    assert met == ["All", "None", "Reset", *(control for row in rows for control in row)]
    browser.key(" ", windowsVirtualKeyCode=32, code="Space")
    browser.wait(lambda: labels_of(organs) == {"shown": [7]})
    browser.js(f"{ROWS}[0].querySelector('input').focus()")
    browser.key(" ", windowsVirtualKeyCode=32, code="Space")
    browser.wait(lambda: labels_of(organs) == {"shown": [1, 7]})
    assert browser.js("return document.activeElement.closest('label').textContent") == "liver"  # rows are not recreated


def test_the_search_finds_labels_beyond_the_list(browser: Browser, many: Watched) -> None:
    assert browser.js(f"return {ROWS}.length") == 200
    assert browser.js(f"return {NOTE}") == "599 of 599 shown; the first 200 of them are listed"
    fills = "[...document.querySelectorAll('.clvol-graph [data-label]')].map((bar) => bar.getAttribute('fill'))"
    assert len(browser.js(f"return {fills}")) == 256  # each that of one of the two or three labels in it
    search = "document.querySelector('.clvol-panel input[type=search]')"
    assert browser.js(f"return {search}.checkVisibility()")

    def look_for(words: str) -> None:
        browser.js(f"const box = {search}; box.value = arguments[0]; box.dispatchEvent(new Event('input'))", words)

    look_for("hippo")
    browser.wait(f"{ROWS}.length === 1 && {ROWS}[0].textContent.startsWith('Hippocampus')")
    assert browser.js(f"return {NOTE}") == "599 of 599 shown; 1 found"
    click(browser, f"{ROWS}[0].querySelector('input')")
    browser.wait(lambda: labels_of(many) == {"hidden": [555]})
    look_for("59")
    browser.wait(f"{ROWS}.length === 16 && {ROWS}[0].textContent.startsWith('59')")
    look_for("nothing of that name")
    browser.wait(f"{ROWS}.length === 0 && {NOTE} === '598 of 599 shown; 0 found'")
    look_for("")
    browser.wait(f"{ROWS}.length === 200")


def test_channels_are_a_list_and_times_a_slider(browser: Browser, cells: Watched) -> None:
    row = "[...document.querySelectorAll('.clvol-row')].find((r) => r.firstChild.textContent === '%s')"
    channels = f"({row % 'channel'}).querySelector('select')"
    assert browser.js(f"return [...{channels}.options].map((o) => o.textContent)") == ["DAPI", "GFP"]
    first = cells.last.state
    top = browser.js("return document.querySelector('.clvol-ends').textContent")
    browser.js(f"const list = {channels}; list.value = '1'; list.dispatchEvent(new Event('change'))")
    browser.wait(lambda: cells.last.state.index == {"channel": 1})
    browser.wait(lambda: browser.js("return document.querySelector('.clvol-ends').textContent") != top)  # its own histogram
    before = picture(browser)
    browser.js(f"const s = ({row % 'time'}).querySelector('input[type=range]'); s.focus()")
    for _ in range(3):
        browser.key("ArrowRight", windowsVirtualKeyCode=39)
    browser.wait(lambda: cells.last.state.index == {"time": 3, "channel": 1})
    browser.wait(lambda: browser.js(f"return {FINAL}") and np.abs(picture(browser) - before).max() > 30)
    browser.js("document.querySelector('.clvol-pane').focus()")
    browser.key(".")
    browser.wait(lambda: cells.last.state.index["time"] == 4)
    browser.wait(f"({row % 'time'}).querySelector('input[type=number]').value === '4'")
    camera = cells.last.state.camera
    assert (camera.direction, camera.zoom) == (first.camera.direction, first.camera.zoom)
    assert not browser.js("return document.querySelector('.clvol-labels').checkVisibility()")
    assert not browser.console()


def test_times_are_played_one_after_the_other(browser: Browser, cells: Watched) -> None:
    """Each once it is shown, in a ring; all of it is one step of undo."""
    played: list[int] = []
    cells.on_change(lambda state: played.append(int(state.index.get("time", 0))))
    draw = Drawer.shots

    def slow(drawer: Drawer, *given: Any) -> Any:
        time.sleep(0.1)
        return draw(drawer, *given)

    button = "document.querySelector('[aria-label=\"volumes a second\"]').previousSibling"
    rate = "document.querySelector('[aria-label=\"volumes a second\"]')"
    browser.js(f"{rate}.value = '30'; {rate}.dispatchEvent(new Event('change'))")
    assert browser.js(f"return {rate}.nextSibling.textContent") == "9 in 0.3 s"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Drawer, "shots", slow)
        click(browser, button)
        browser.wait(lambda: len(played) > 11)
        told = browser.js(f"return {rate}.nextSibling.textContent")
        click(browser, button)
    assert 0 < float(told.removeprefix("9 in 0.3 s, ").removesuffix(" a second reached")) < 11
    browser.wait(f"{button}.textContent === 'Play' && {FINAL}")
    assert played[:11] == [*range(1, 9), 0, 1, 2]
    click(browser, "document.querySelector('.clvol-buttons button')")
    browser.wait(lambda: cells.last.state.index == {}, what="the state before")
    assert not browser.console()


def test_the_curve_of_the_crosshair_follows_it_and_is_clicked(browser: Browser, cells: Watched) -> None:
    plot, caption = ".clvol-series", "document.querySelector('.clvol-series + .clvol-note').textContent"
    click(browser, "document.querySelector('.clvol-more summary')")
    browser.wait(lambda: browser.js(f"return {caption}").startswith("time 0: "), what="the curve")
    path = "document.querySelector('.clvol-series path').getAttribute('d')"
    first = browser.js(f"return {path}")
    assert first.count("L") == 8
    cells.state = replace(cells.state, crosshair=(4.0, 8.0, 8.0))  # the ball comes from there
    browser.wait(lambda: browser.js(f"return {path}") != first, what="another curve")
    left, top, width, height = browser.box(plot)
    browser.mouse("mousePressed", left + 0.75 * width, top + height / 2)
    browser.mouse("mouseReleased", left + 0.75 * width, top + height / 2)
    browser.wait(lambda: cells.last.state.index.get("time") == 6)
    browser.wait(lambda: browser.js(f"return {caption}").startswith("time 6: "))
    assert not browser.console()


@pytest.mark.parametrize("dark", [False, True])
def test_on_a_phone_rows_fit_and_are_readable(browser: Browser, organs: Watched, *, dark: bool) -> None:  # noqa: ARG001
    driver = browser.driver
    features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 375, "height": 812, "deviceScaleFactor": 1, "mobile": False}
    )
    try:
        browser.wait("document.documentElement.clientWidth === 375")
        assert browser.js("return document.documentElement.scrollWidth") == 375
        right, height = browser.js(
            f"const b = {ROWS}[1].querySelector('button').getBoundingClientRect(); return [b.right, b.height]"
        )
        assert right <= 375
        assert height >= 36  # for a finger
        ink, back = (
            browser.js(f"return getComputedStyle({ROWS}[0].querySelector('span:last-child')).color"),
            browser.js("return getComputedStyle(document.querySelector('.clvol')).backgroundColor"),
        )
        light = [luminance(color) for color in (ink, back)]
        assert (light[0] > light[1]) == dark
        assert (max(light) + 0.05) / (min(light) + 0.05) >= 7  # WCAG's contrast, AAA
        bar, text = "document.querySelector('.clvol-scale')", "getBoundingClientRect().right"
        browser.js(f"{bar}.style.width = '5px'; {bar}.firstChild.textContent = '0.002 mm'")
        assert browser.js(f"return {bar}.{text} - {bar}.firstChild.{text}") >= 0  # what is longer than the bar is not cut off
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
        driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False}
        )


def luminance(color: str) -> float:
    """Of WCAG, of a colour such as "rgb(28, 33, 39)"."""
    shares = np.array([int(c) for c in color.strip("rgba()").split(",")[:3]]) / 255
    return float(np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722))


@pytest.fixture
def waves(browser: Browser, device: Device) -> Iterator[Watched]:  # noqa: ARG001
    yield from shown(browser, Watched(phantoms.marschner_lobb(20), mode="surfaces", color_by="k1"))


def test_surfaces_as_text_and_what_colors_them(browser: Browser, waves: Watched) -> None:
    box = "document.querySelector('input[aria-label=surfaces]')"
    assert browser.js(f"return {box}.value").count(":") == 4  # the two that are chosen from the samples
    before = picture(browser)
    browser.js(f"{box}.value = '0.3:#ffe4c4:0.4, 0.7:#ff0000'; {box}.dispatchEvent(new Event('change'))")
    browser.wait(f"{FINAL} && {box}.value === '0.3:#ffe4c4:0.4, 0.7:#ff0000:1'", 30)
    assert waves.last.state.options["surfaces"][1][0] == 0.7
    by = "[...document.querySelectorAll('.clvol-body select')].find((list) => [...list.options].some((o) => o.value === 'k2'))"
    assert browser.js(f"return {by}.value") == "k1"
    browser.js(f"{by}.value = 'none'; {by}.dispatchEvent(new Event('change'))")
    browser.wait(lambda: waves.last.state.options["color_by"] is None, 30)
    browser.wait(
        lambda: browser.js(f"return {FINAL}") and (picture(browser) != before).any(), 60
    )  # its kernels are built meanwhile


@pytest.fixture
def shell(browser: Browser, device: Device) -> Iterator[Watched]:  # noqa: ARG001
    shapes = TransferFunction2D([((0.2, 0.8), (0.01, None), "gold", 0.5)], [((0, 1), 0.2, "navy", 0.1)], unit_distance=3)
    yield from shown(browser, Watched(phantoms.sphere(16), transfer=shapes))


def test_functions_of_value_and_gradient_are_edited(browser: Browser, shell: Watched) -> None:
    box, corner = ".clvol-shape[aria-label^=box]", ".clvol-graph .clvol-dot[aria-label='upper left corner']"
    browser.wait("document.querySelector('.clvol-joint').getAttribute('href')", 60)
    first, last = shell.last.state.transfer, lambda: shell.last.state.json()["transfer"]
    before = picture(browser)
    browser.drag((20, 30), corner)
    browser.wait(lambda: 0.2 < last()["boxes"][0][0][0] < 0.7 and last()["boxes"][0][1][1] is not None)
    browser.js(f"document.querySelector('{box}').focus()")
    low = last()["boxes"][0][0][0]
    browser.key("ArrowRight")
    browser.wait(lambda: last()["boxes"][0][0][0] > low)
    browser.key("+", text="+")
    browser.wait(lambda: len(last()["boxes"]) == 2)
    browser.key("Delete")
    browser.wait(lambda: len(last()["boxes"]) == 1)
    assert last()["unit_distance"] == 3
    browser.wait(lambda: browser.js(f"return {FINAL}") and (picture(browser) != before).any(), 30)
    for _ in range(4):
        browser.wait(lambda: not browser.js("return document.querySelector('.clvol-buttons button').disabled"))
        click(browser, "document.querySelector('.clvol-buttons button')")
    browser.wait(lambda: shell.last.state.transfer == first)
    graded = "[...document.querySelectorAll('.clvol-check')].find((e) => e.textContent === 'By the gradient too').firstChild"
    click(browser, graded)
    browser.wait(lambda: shell.last.state.transfer is None)
    click(browser, graded)
    browser.wait(lambda: isinstance(shell.last.state.transfer, TransferFunction2D))
    assert not browser.console()
