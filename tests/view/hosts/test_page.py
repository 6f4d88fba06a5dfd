"""The page of `clvol view` in a real browser with a real session: gestures, panel, keys, URLs, sizes."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol.device import Device
from clvol.view import Session, State, View
from clvol.view.code import from_url
from tests.view.browser import Browser, open_browser, why_none

pytest.importorskip("aiohttp", reason="needs aiohttp")
from clvol.view.hosts.server import Limits, Serving, serve

pytestmark = pytest.mark.skipif(bool(why_none()), reason=why_none())
SIZE = 700, 700  # of the window: beside the panel a narrow picture, soon drawn
SHOWN = "document.querySelector('.clvol-pane[data-frame]')"
FINAL = "[...document.querySelectorAll('.clvol-pane')].every((pane) => pane.dataset.final === 'true')"
NAME = "(e.getAttribute('aria-label') || e.closest('label')?.textContent || e.textContent)"  # of an element `e`
PANE = ".clvol-pane[data-pane='3d']"


class Watched(View):
    """A view that keeps its sessions."""

    last: Session

    def session(self, send: Any, state: State | None = None) -> Session:
        self.last = super().session(send, state)
        return self.last


def head() -> clvol.Volume:
    """Air, a shell of bone, and an off-centre object inside."""
    z, y, x = (np.mgrid[:24, :24, :24] - 11.5) / 11.5
    r = np.sqrt(x**2 + 1.2 * y**2 + 0.8 * z**2)
    data = np.where(r < 0.85, 40, -1000) + np.where((r > 0.6) & (r < 0.75), 800, 0)
    data[np.sqrt((x - 0.3) ** 2 + y**2 + z**2) < 0.2] = 300
    return clvol.Volume(data.astype(np.int16), spacing=(8, 8, 8), units="mm", space="LPS", name="a head")


class Page:
    """The page, and the session behind it."""

    def __init__(self, browser: Browser, server: Serving, view: Watched) -> None:
        self.browser, self.url, self.view = browser, server.url, view
        self.js, self.wait = browser.js, browser.wait

    @property
    def state(self) -> State:
        return self.view.last.state

    def open(self, fragment: str = "") -> None:
        self.browser.open("about:blank")  # else only the fragment changes
        self.browser.open(self.url + fragment)
        self.wait(f"{SHOWN} && {FINAL}", 60)

    def choose(self, label: str, value: str) -> None:
        """Choose in a list of the panel."""
        code = """const row = [...document.querySelectorAll('.clvol-row')].find((r) => r.firstChild.textContent === arguments[0]);
            const list = row.querySelector('select');
            list.value = arguments[1];
            list.dispatchEvent(new Event('change'));"""
        self.js(code, label, value)

    def type(self, label: str, value: str) -> None:
        """Type into the number beside a slider."""
        code = """const number = document.querySelector(`input[aria-label="${arguments[0]}, as a number"]`);
            number.value = arguments[1];
            number.dispatchEvent(new Event('change'));"""
        self.js(code, label, value)

    def tick(self, label: str) -> None:
        self.js(
            "[...document.querySelectorAll('.clvol-check')].find((c) => c.textContent === arguments[0]).firstChild.click()", label
        )

    def press(self, text: str) -> None:
        self.js("[...document.querySelectorAll('button')].find((b) => b.textContent === arguments[0]).click()", text)

    def told(self) -> str:
        return str(self.js("return document.querySelector('.clvol-status').textContent"))

    def picture(self, pane: str = "3d") -> np.ndarray:
        return self.browser.canvas(f".clvol-pane[data-pane='{pane}'] canvas")

    def becomes(self, what: Any) -> None:
        self.wait(lambda: what(self.state), 20, "the state")

    def presses(self, text: str, what: Any) -> None:
        """Press a button until the state matches."""

        def pressed() -> bool:
            if what(self.state):
                return True
            self.press(text)
            time.sleep(0.3)
            return False

        try:
            self.wait(pressed, 20, f"the state after {text}")
        except AssertionError as error:
            history = self.view.last._history
            error.add_note("\n".join(str(one.camera) for one in (*history.past, history.present, *history.future)))
            raise

    def in_address(self) -> State | None:
        """The state that the page's address has."""
        with suppress(clvol.OptionError):
            return from_url(self.js("return location.href"))
        return None

    def let_go(self) -> State:
        """The state after all pointers are up: the last events of a gesture may still be on their way."""
        self.wait(lambda: self.view.last._control.inputs.drag is None, 20, "the drag's end")
        return self.state


@pytest.fixture(scope="module")
def shared() -> Iterator[tuple[Browser, Serving, Watched]]:
    view = Watched(head(), layout="3d")
    with serve(view) as server, open_browser(*SIZE) as browser:
        yield browser, server, view


@pytest.fixture
def page(shared: tuple[Browser, Serving, Watched], device: Device) -> Page:  # noqa: ARG001  # sessions use the default one
    made = Page(*shared)
    made.open()
    return made


# -- pictures and gestures -----------------------------------------------------------------------------------


def test_the_still_picture_matches_the_library(page: Page) -> None:
    shown = page.picture()
    height, width = shown.shape[:2]
    from clvol.show.picture import to_bytes

    expected = to_bytes(page.view.picture((width, height)))[..., :3]
    np.testing.assert_array_equal(shown[..., :3], expected)


def test_drag_rotates_wheel_zooms_and_undo_reverts(page: Page) -> None:
    first, before = page.state, page.picture()
    page.browser.drag((120, 40), PANE)
    page.becomes(lambda state: state.camera.direction != first.camera.direction)
    page.wait(lambda: np.abs(page.picture().astype(int) - before).mean() > 1, 20, "the turned picture")
    turned = page.let_go()
    page.browser.wheel(-200, PANE)
    page.becomes(lambda state: state.camera.zoom > 1.2 or state.camera.distance != turned.camera.distance)
    page.wait("!document.querySelector('.clvol-buttons button').disabled")
    # a gesture is one step, unless the machine was so slow that it took as long as two
    page.presses("Undo", lambda state: state.camera.direction == first.camera.direction and state.camera.zoom == first.camera.zoom)
    page.presses("Redo", lambda state: state.camera.direction == turned.camera.direction)


def test_two_fingers_zoom(page: Page) -> None:
    zoom = page.state.camera.zoom
    left, top, width, height = page.browser.box(PANE)
    x, y = left + width / 2, top + height / 2

    def touch(kind: str, apart: float) -> None:
        points = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}] if kind != "touchEnd" else []
        page.browser.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 40)
    for apart in (60, 80, 100, 120):
        touch("touchMove", apart)
    touch("touchEnd", 0)
    page.becomes(lambda state: state.camera.zoom > 1.5 * zoom)


def test_linked_slices_share_a_crosshair(page: Page) -> None:
    page.choose("Layout", "linked")
    page.wait("document.querySelectorAll('.clvol-pane[data-frame]').length === 4")
    page.browser.drag((30, 20), ".clvol-pane[data-pane='z']")
    page.becomes(lambda state: state.crosshair is not None)
    x, y, _ = page.let_go().crosshair or (0, 0, 0)
    assert x > 92
    assert y > 92  # rows of a patient's axial slices run to the back
    page.wait("document.querySelector('.clvol-pane[data-pane=x] .clvol-crosshair')")
    letters = page.js(
        "return [...document.querySelectorAll('.clvol-pane[data-pane=z] .clvol-letter')].map((l) => l.className + l.textContent)"
    )
    assert {"clvol-letter clvol-leftR", "clvol-letter clvol-downP"} <= set(letters)


def test_panes_that_come_back_have_their_pictures(page: Page) -> None:
    quick = """for (const layout of ["slice", "3d"]) {
            const row = [...document.querySelectorAll('.clvol-row')].find((r) => r.firstChild.textContent === 'Layout');
            const list = row.querySelector('select');
            list.value = layout;
            list.dispatchEvent(new Event('change'));
        }"""
    page.js(quick)  # before the session hears of it
    page.wait(f"{SHOWN} && {FINAL}", 20, "the volume's picture")
    page.choose("Layout", "linked")
    finals = "[...document.querySelectorAll('.clvol-pane[data-final=true]')].map((pane) => pane.dataset.pane).join()"
    page.wait(f"{finals} === 'z,3d,y,x'")
    for _ in range(2):  # the second time the crosshair stays, and nothing else has changed
        for panes in ("x", "z,3d,y,x"):
            code = """const pane = document.querySelector(".clvol-pane[data-pane='x']"), box = pane.getBoundingClientRect();
                const at = {clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true};
                pane.dispatchEvent(new MouseEvent('dblclick', at))"""
            page.js(code)
            page.wait(f"{finals} === '{panes}'")


# -- the panel -----------------------------------------------------------------------------------------------


def test_the_edge_of_a_pane_tells_what_lies_under_the_pointer(page: Page) -> None:
    said = f"document.querySelector(`{PANE} .clvol-readout`).innerText"
    left, top, width, height = page.browser.box(PANE)
    page.browser.mouse("mouseMoved", left + width / 2, top + height / 2)
    page.wait(said)
    value, voxel, place = page.js(f"return {said}").splitlines()
    picked = page.view.last._control.pick("3d", width / 2, height / 2)
    assert float(value.split()[0]) == pytest.approx(picked["value"], rel=1e-3)
    assert voxel == f"voxel {', '.join(str(int(np.floor(v + 0.5))) for v in picked['index'])}"
    assert place.endswith(" mm")
    page.browser.mouse("mouseMoved", left + width + 100, top + 50)
    page.wait(f"{said} === ''")


def test_a_distance_is_drawn_on_a_slice_listed_and_removed(page: Page) -> None:
    page.choose("Draw", "distance")
    slice_ = ".clvol-pane[data-pane='z']"
    page.wait(f"document.querySelector(`{slice_}`)?.dataset.final === 'true'")
    page.browser.drag((80, 0), slice_)
    page.becomes(lambda state: len(state.marks) == 1)
    listed = "document.querySelector('.clvol-measures')?.textContent ?? ''"
    page.wait(f"({listed}).includes(' mm')")
    one, other = np.array(page.state.marks[0].points)
    assert f"distance · {np.linalg.norm(other - one):.4g} mm" in page.js(f"return {listed}")
    assert page.js(f"return document.querySelector(`{slice_} .clvol-measured`).textContent").startswith("1: ")
    page.press("Remove all")
    page.wait(f"!document.querySelector(`{slice_} .clvol-mark`)")


def test_mode_filter_and_option_are_set(page: Page) -> None:
    page.choose("Mode", "isosurface")
    page.becomes(lambda state: state.mode == "isosurface")
    page.choose("Filter", "linear")
    page.becomes(lambda state: state.filter == "linear")
    page.type("isovalue", "120")
    page.becomes(lambda state: state.options.get("isovalue") == 120)
    page.choose("Mode", "mip")
    page.becomes(lambda state: state.mode == "mip" and not state.options)
    assert page.js("return document.querySelector('input[aria-label=\"isovalue, as a number\"]')") is None


def test_keys_move_a_slider_however_late_the_session_answers(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer to the first key arrives between the second and the third: the slider must not jump back."""
    hear = Session._set

    def slow(session: Session, message: Any) -> None:
        time.sleep(0.4)
        hear(session, message)

    page.choose("Mode", "isosurface")
    page.becomes(lambda state: state.mode == "isosurface")
    page.wait(FINAL)
    slider = "document.querySelector('input[type=range][aria-label=isovalue]')"
    page.type("isovalue", "120")
    page.becomes(lambda state: state.options.get("isovalue") == 120)
    first, step = (float(page.js(f"return {slider}.{what}")) for what in ("value", "step"))
    monkeypatch.setattr(Session, "_set", slow)
    page.js(f"{slider}.focus()")
    shown = []
    for _ in range(3):
        page.browser.key("ArrowRight", windowsVirtualKeyCode=39)
        time.sleep(0.25)
        shown.append(float(page.js(f"return {slider}.value")))
    np.testing.assert_allclose(shown, first + step * np.arange(1, 4), rtol=1e-5)
    page.becomes(lambda state: abs(state.options["isovalue"] - shown[-1]) < step / 100)
    page.wait("document.querySelector('.clvol-status').dataset.kind !== 'error'")
    assert float(page.js(f"return {slider}.value")) == shown[-1]


def test_a_point_of_the_transfer_function_is_dragged_as_one_step(page: Page) -> None:
    page.choose("Preset", "ct-bone")
    page.becomes(lambda state: state.preset == "ct-bone")
    page.wait("document.querySelectorAll('.clvol-dot').length > 2")
    page.browser.drag((0, -30), ".clvol-dot:nth-child(2)")
    page.becomes(lambda state: state.transfer is not None)
    page.wait("[...document.querySelectorAll('select')].some((s) => s.selectedOptions[0]?.textContent === 'edited')")
    page.press("Undo")
    page.becomes(lambda state: state.transfer is None and state.preset == "ct-bone")


def test_points_are_added_coloured_and_deleted(page: Page) -> None:
    count = page.js("return document.querySelectorAll('.clvol-dot').length")
    left, top, width, _ = page.browser.box(".clvol-transfer .clvol-graph")
    for clicks in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            page.browser.mouse(kind, left + 0.9 * width, top + 60, clickCount=clicks)
    page.becomes(lambda state: state.transfer is not None)
    assert page.js("return document.querySelectorAll('.clvol-dot').length") == count + 1
    color = "const box = document.querySelector('.clvol-point input[type=color]'); box.value = '#00ff00';"
    page.js(color + "box.dispatchEvent(new Event('change'))")
    page.becomes(lambda state: any(color == (0, 1, 0) for _, color in state.transfer.colors))
    page.press("Delete")
    page.becomes(lambda state: not any(color == (0, 1, 0) for _, color in state.transfer.colors))
    assert page.js("return document.querySelectorAll('.clvol-dot').length") == count


def test_the_isovalue_is_dragged_in_the_histogram(page: Page) -> None:
    """By its line, as one undo step; by keys; and the copied program includes it."""
    grip = "[aria-label='isovalue in the histogram']"
    assert page.js("return document.querySelector(arguments[0]).getClientRects().length", grip) == 0  # only where there is one
    page.choose("Mode", "isosurface")
    page.wait(f'document.querySelector("{grip}").getClientRects().length')
    first = float(page.js("return document.querySelector(arguments[0]).getAttribute('aria-valuenow')", grip))
    width = page.browser.box(".clvol-bars")[2]
    page.browser.drag((50, 0), ".clvol-beside", buttons=1)
    page.becomes(lambda state: "isovalue" in state.options)
    low, high = page.view.volume.value_range
    wanted = first + 50 * (high - low) / width
    page.becomes(lambda state: abs(state.options["isovalue"] - wanted) < 3 * (high - low) / width)
    page.wait(FINAL)
    told = page.js("return document.querySelector(arguments[0]).getAttribute('aria-valuetext')", grip)
    assert float(told) == pytest.approx(page.state.options["isovalue"], rel=1e-3)
    assert page.js("return document.activeElement === document.querySelector(arguments[0])", grip)
    dragged = page.state.options["isovalue"]
    page.browser.key("ArrowLeft")
    page.becomes(lambda state: state.options["isovalue"] == pytest.approx(dragged - (high - low) / 200))
    page.browser.key("End")
    page.becomes(lambda state: state.options["isovalue"] == high)
    for expected in (dragged - (high - low) / 200, dragged, None):
        page.press("Undo")
        page.becomes(lambda state, expected=expected: state.options.get("isovalue") == (expected and pytest.approx(expected)))


def test_a_clip_plane_is_dragged_by_its_handle(page: Page) -> None:
    page.choose("Mode", "isosurface")
    page.tick("Crop to a box")
    page.wait(f"document.querySelectorAll('.clvol-face').length && {FINAL}")
    before, first = page.picture(), page.state
    left, top, _, _ = page.browser.box(PANE)
    code = "return [...document.querySelectorAll('.clvol-face')].map((c) => [c.cx.baseVal.value, c.cy.baseVal.value])"
    x, y = max(page.js(code))  # the one farthest to the right
    middle = page.browser.box(PANE)[2] / 2
    page.browser.mouse("mouseMoved", left + x, top + y)
    page.wait("document.querySelector('.clvol-plane') && document.querySelector('.clvol-grasp')", what="the plane is shown")
    page.browser.mouse("mousePressed", left + x, top + y, buttons=1)
    for n in range(1, 6):
        page.browser.mouse("mouseMoved", left + x + (middle - x) * n / 10, top + y, button="left", buttons=1)
    page.browser.mouse("mouseReleased", left + x + (middle - x) / 2, top + y)
    page.becomes(lambda state: state.clip != first.clip)
    page.wait(FINAL)
    assert page.state.camera == first.camera
    moved = np.subtract(page.state.clip, first.clip)
    assert np.count_nonzero(moved) == 1
    page.wait(lambda: np.abs(page.picture().astype(int) - before).mean() > 1, 20, "the cut")
    page.press("Undo")
    page.becomes(lambda state: state == first)


def test_two_filters_are_compared_and_the_bar_is_dragged(page: Page) -> None:
    page.tick("Compare with")
    page.becomes(lambda state: state.wiper is not None and state.wiper.at == 0.5)
    page.wait("document.querySelector('.clvol-wiper-right')?.textContent.includes('error')", 60)
    page.browser.drag((-100, 0), ".clvol-wiper")
    page.becomes(lambda state: state.wiper is not None and 0.2 < state.wiper.at < 0.45)
    assert page.state.camera.direction == page.view.resident.initial.camera.direction  # the bar, not the volume


def test_a_crop_box_a_light_and_the_heat_map_are_set(page: Page) -> None:
    page.js("for (const s of document.querySelectorAll('details')) s.open = true")
    before = page.picture()
    page.tick("Crop to a box")
    page.becomes(lambda state: state.clip is not None)
    page.type("x to", "90")
    page.becomes(lambda state: state.clip is not None and state.clip[1][0] == 90)
    page.wait(f"document.querySelector('.clvol-box') && {FINAL}")
    page.wait(lambda: np.abs(page.picture().astype(int) - before).mean() > 1, 20, "the cropped picture")
    assert page.told() == ""
    page.choose("Lights", "from above")
    page.becomes(lambda state: state.lights is not None and len(state.lights) == 1)
    page.tick("Show visited samples")
    page.becomes(lambda state: state.heat)


def test_errors_are_reported_and_nothing_changes(page: Page) -> None:
    before = page.state
    page.type("Step", "-1")
    page.wait(lambda: "step must be" in page.told(), 20, "the error")
    assert page.state == before
    page.wait(
        "document.querySelector('input[aria-label=\"Step, as a number\"]').value === '0.5'", what="the old value is shown again"
    )


# -- out of it -----------------------------------------------------------------------------------------------


def test_the_copied_url_shows_the_same_elsewhere(page: Page) -> None:
    page.js("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    page.choose("Mode", "mip")
    page.browser.drag((60, 30), PANE)
    page.becomes(lambda state: state.mode == "mip" and state.camera.target is not None)
    page.press("URL")
    url = page.wait("window.copied")
    wanted = page.state
    assert from_url(url) == wanted
    page.view.resident.initial = replace(page.view.resident.initial, step=0.7)  # the address knows nothing of it
    try:
        page.open(url[url.index("#") :])
        page.becomes(lambda state: state == wanted)
    finally:
        page.view.resident.initial = replace(page.view.resident.initial, step=0.5)


def test_the_saved_picture_is_the_still_one(page: Page) -> None:
    page.js(
        "URL.createObjectURL = (b) => { b.arrayBuffer().then((a) => { window.saved = [...new Uint8Array(a)]; }); return 'data:,'; }"
    )
    page.js("HTMLAnchorElement.prototype.click = function () { window.named = this.download; }")
    page.press("Save picture")
    data = bytes(page.wait("window.saved"))
    assert page.js("return window.named") == "a-head.png"
    np.testing.assert_array_equal(iio.imread(io.BytesIO(data))[..., :3], page.picture()[..., :3])


def test_a_file_that_is_being_made_can_be_cancelled(page: Page) -> None:
    page.js("document.querySelector('[aria-label=\"size of the picture\"]').value = '4'")
    page.type("Step", "0.02")  # so that it takes long
    page.press("Save picture")
    page.wait("document.querySelector('.clvol-files progress')?.value > 0", what="its progress")
    assert page.js("const said = document.querySelector('.clvol-files span'); return said.scrollWidth <= said.clientWidth"), (
        "cut off"
    )
    page.browser.drag((60, 0), PANE)
    page.becomes(lambda state: state.camera.target is not None)  # meanwhile
    page.press("Cancel")
    page.wait("document.querySelectorAll('.clvol-files li').length === 0", what="the row is gone")
    page.wait(lambda: page.told() in ("", "cancelled"), 20, "nothing is left of it")


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("kind", "head"), [("gif", b"GIF8"), ("mp4", b"ftyp"), ("webm", b"\x1aE\xdf\xa3")])
def test_a_movie_is_saved_in_the_chosen_format(page: Page, kind: str, head: bytes) -> None:
    """Without the video package the page says how to install it."""
    page.js(
        """URL.createObjectURL = (b) => { b.arrayBuffer().then((a) => { window.saved = [...new Uint8Array(a)].slice(0, 12); });
            window.kind = b.type; return 'data:,'; };
        const ask = WebSocket.prototype.send, more = '"what":"movie","frames":2';
        WebSocket.prototype.send = function (text) { return ask.call(this, text.replace('"what":"movie"', more)); };
        document.querySelector('[aria-label="movie format"]').value = arguments[0];""",
        kind,
    )
    page.press("Save movie")
    if kind in ("mp4", "webm") and find_spec("imageio_ffmpeg") is None:
        page.wait(lambda: 'pip install "clvol[movie]"' in page.told(), 30, "what is missing")
        return
    assert head in bytes(page.wait("window.saved", 30))
    assert page.js("return window.kind") == ("image/gif" if kind == "gif" else f"video/{kind}")


def test_what_is_too_large_for_the_socket_is_saved(shared: tuple[Browser, Serving, Watched]) -> None:
    browser, _, view = shared
    with serve(view, limits=Limits(waiting=1 << 18)) as server:
        page = Page(browser, server, view)
        page.open()
        page.js(
            """const taken = (b, bytes) => { window.saved = [bytes.length, b.type, ...bytes.slice(0, 4)]; };
            URL.createObjectURL = (b) => { b.arrayBuffer().then((a) => taken(b, new Uint8Array(a))); return 'data:,'; };
            document.querySelector('[aria-label="size of the picture"]').value = 4;"""
        )
        page.press("Save picture")
        length, kind, *head = page.wait("window.saved", 30)
        page.wait(lambda: page.told().startswith("saved as"))
    assert length > 1 << 17
    assert (kind, bytes(head)) == ("image/png", b"\x89PNG")


def test_a_server_that_hangs_is_said_within_a_second(page: Page, shared: tuple[Browser, Serving, Watched]) -> None:
    loop = shared[1]._loop
    assert loop is not None  # it runs
    loop.call_soon_threadsafe(time.sleep, 4)
    began = time.monotonic()
    page.wait(lambda: page.told() == "clvol does not answer", 4)
    assert time.monotonic() - began < 3  # a second, and what a busy machine adds
    page.wait(lambda: page.told() == "")


def test_a_session_that_does_not_get_on_is_said(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    for seconds, says in ((3.0, "still computing"), (60.0, "no progress for a minute"), (0.0, "")):
        monkeypatch.setattr(Session, "working", seconds)
        page.wait(lambda says=says: says in page.told() and bool(says) == bool(page.told()))  # type: ignore[misc]  # bound at once


def test_keys_are_listed_and_the_cube_turns_the_volume(page: Page) -> None:
    page.browser.key("?")
    page.wait("document.querySelector('dialog').open")
    assert "Alt (held)" in page.js("return document.querySelector('dialog').textContent")
    page.press("Close")
    page.js("""const left = [...document.querySelectorAll('.clvol-side')].find((side) => side.textContent.includes('left'));
        left.dispatchEvent(new PointerEvent('pointerdown', {bubbles: true}));""")
    page.becomes(lambda state: state.camera.direction == (-1.0, 0.0, 0.0))
    page.press("Superior")
    page.becomes(lambda state: (state.camera.direction, state.camera.up) == ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)))


def test_copied_python_is_shown_if_the_clipboard_is_blocked(page: Page) -> None:
    page.js("navigator.clipboard.writeText = async () => { throw new Error('no'); }; document.execCommand = () => false")
    page.press("Python")
    text = page.wait("document.querySelector('.clvol-text:not([hidden])')?.value")
    compile(text, "copied", "exec")
    assert "clvol.render(" in text


def test_a_reload_keeps_the_state_which_the_address_has(page: Page) -> None:
    assert page.js("return location.hash") == ""
    page.choose("Mode", "mip")
    page.browser.drag((60, 30), PANE)
    page.becomes(lambda state: state.mode == "mip" and state.camera.target is not None)
    wanted = page.let_go()
    page.wait(lambda: page.in_address() == wanted, what="its address")
    old, entries = page.view.last, page.js("return history.length")
    page.browser.driver.refresh()
    page.wait(lambda: page.view.last is not old and page.state == wanted, what="the state after a reload")
    assert page.js("return history.length") == entries
    page.press("Undo")
    page.wait("location.hash === ''", what="the first state, which has no fragment")


@pytest.mark.parametrize(("fragment", "why"), [("eyJ2", "must be JSON"), ("eyJtb2RlIjoieCJ9", "mode must be")])
def test_a_wrong_address_is_reported_until_something_is_done(page: Page, fragment: str, why: str) -> None:
    page.open(f"#s={fragment}")
    page.wait(lambda: "address cannot be read" in page.told() and why in page.told(), 20, "the error")
    assert page.state == page.view.resident.initial
    page.choose("Mode", "mip")
    page.browser.wheel(-10, PANE)
    page.browser.mouse("mousePressed", 20, 20)
    page.browser.mouse("mouseReleased", 20, 20)
    page.wait(lambda: not page.told() and page.in_address() == page.state, what="another address")


def test_a_lost_connection_is_restored_with_its_state(page: Page) -> None:
    kept = "const W = WebSocket; window.WebSocket = class extends W { constructor(url) { super(url); window.socket = this; } };"
    added = page.browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": kept})
    try:
        page.open()
    finally:
        page.browser.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)
    page.choose("Mode", "minip")
    page.becomes(lambda state: state.mode == "minip")
    old = page.view.last
    page.js("window.socket.close()")
    page.wait(lambda: "trying again in 0.5 s" in page.told(), 20, "the lost connection")
    page.wait(lambda: page.view.last is not old, 20, "a new session")
    page.becomes(lambda state: state.mode == "minip")
    page.wait(lambda: page.told() == "", 20, "no complaint is left")


# -- for everybody -------------------------------------------------------------------------------------------


def test_it_can_be_used_by_keyboard_alone(page: Page) -> None:
    first = page.state
    page.js("document.activeElement.blur()")
    page.browser.key("Tab")
    assert page.js("return document.activeElement.dataset.pane") == "3d"
    page.browser.key("ArrowLeft")
    page.becomes(lambda state: state.camera.direction != first.camera.direction)
    page.browser.key("z", modifiers=2)
    page.becomes(lambda state: state.camera.direction == first.camera.direction)
    reached = set()
    for _ in range(60):
        page.browser.key("Tab")
        reached.add(page.js(f"const e = document.activeElement; return {NAME}"))
        if page.js("return document.activeElement.classList.contains('clvol-dot')"):
            break
    assert {"Settings", "Fit"} <= reached
    page.browser.key("ArrowUp")
    page.becomes(lambda state: state.transfer is not None)


def test_keys_work_beside_every_control_and_take_none_of_its_own(page: Page) -> None:
    page.js("for (const s of document.querySelectorAll('details')) s.open = true")
    focused = "document.activeElement.closest('.clvol-pane')?.dataset.pane"
    page.js(f"document.querySelector({PANE!r}).focus()")
    for layout, pane in (("slice", "z"), ("linked", "z"), ("3d", "3d")):  # the pane that has the focus stays, or another has it
        page.browser.key("l")
        page.becomes(lambda state, layout=layout: state.layout == layout)
        page.wait(f"{focused} === {pane!r}")
    for control, own in (
        ("[aria-label='Step']", "ArrowRight"),
        (".clvol-dot", "ArrowUp"),
        (".clvol-check input", " "),
        (".clvol-button[title^='show or hide']", " "),
    ):
        page.js("document.querySelector(arguments[0]).focus()", control)
        before = page.state.camera
        page.browser.key("t")
        page.becomes(lambda state, before=before: state.camera.style != before.style)
        turned = page.state.camera
        page.browser.key(own, windowsVirtualKeyCode=39 if own == "ArrowRight" else 32 if own == " " else 38)
        page.browser.key("]")
        page.becomes(lambda state, turned=turned: state.camera.up != turned.up)
        assert page.state.camera.direction == turned.direction
    assert page.state.step != State().step  # the slider and the point have moved
    assert page.state.transfer is not None
    page.press("Settings")  # a space has hidden them
    page.js("document.querySelector('input[type=number]').focus()")
    before = page.state
    page.browser.key("t")
    page.browser.key("]")
    page.js("document.activeElement.blur()")  # nothing has the focus
    page.browser.key("p")
    page.becomes(lambda state: state.camera.projection == "orthographic")
    assert (page.state.camera.style, page.state.camera.up) == (before.camera.style, before.camera.up)


def test_every_control_has_a_name(page: Page) -> None:
    page.js("for (const s of document.querySelectorAll('details')) s.open = true")
    unnamed = f"""return [...document.querySelectorAll('input, select, textarea, button, [tabindex="0"]')]
        .filter((e) => !{NAME}.trim()).map((e) => e.outerHTML)"""
    assert page.js(unnamed) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_contrast_is_sufficient(page: Page, scheme: str) -> None:
    """WCAG AA: 4.5 to 1."""
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    page.browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    code = """for (const s of document.querySelectorAll('details')) s.open = true;
        return [...document.querySelectorAll('.clvol-panel *, .clvol-foot *')].filter((e) => !e.disabled && e.checkVisibility()
            && (e.value || [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()))).map((e) => {
          let behind = e;
          const back = () => getComputedStyle(behind).backgroundColor;
          while (back() === 'rgba(0, 0, 0, 0)' && behind.parentElement) behind = behind.parentElement;
          return [e.textContent.slice(0, 40), getComputedStyle(e).color, back()];
        });"""
    rows = page.js(code)
    assert len(rows) > 40
    ratios = {text: contrast(ink, back) for text, ink, back in rows}
    assert {text: ratio for text, ratio in ratios.items() if ratio < 4.5} == {}


def contrast(one: str, two: str) -> float:
    """Of two colours as `getComputedStyle` gives them, by WCAG 2."""

    def luminance(text: str) -> float:
        shares = [float(c) / 255 for c in text[text.index("(") + 1 : -1].split(",")[:3]]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shares]
        return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))

    low, high = sorted((luminance(one), luminance(two)))
    return (high + 0.05) / (low + 0.05)


def test_on_a_phone_the_panel_is_below_and_nothing_overflows(page: Page) -> None:
    metrics = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    page.browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        page.wait(f"{FINAL} && document.querySelector('canvas').width === 780")
        pane, panel = page.browser.box(PANE), page.browser.box(".clvol-panel")
        assert pane[1] + pane[3] <= panel[1]
        assert pane[3] > 844 * 0.4
        assert page.js("return document.documentElement.scrollWidth") <= 390
        assert page.js("const p = document.querySelector('.clvol-panel'); return p.scrollWidth - p.clientWidth") <= 0
        page.press("Settings")
        page.wait("document.querySelector('canvas').height > 1500")
    finally:
        metrics = {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False}
        page.browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def test_no_request_leaves_and_the_console_is_clean(page: Page) -> None:
    page.choose("Layout", "linked")
    page.wait(f"document.querySelectorAll('.clvol-pane[data-frame]').length === 4 && {FINAL}", 30)
    address = page.url.partition("?")[0]
    assert [url for url in page.browser.requests() if not url.replace("ws:", "http:").startswith(address)] == []
    assert page.browser.console() == []
