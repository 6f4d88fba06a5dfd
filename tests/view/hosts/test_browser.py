"""The server in a real browser: what its page gets, and what pages of other origins do not."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest

import clvol
from clvol.device import Device
from tests.view.browser import Browser

pytest.importorskip("aiohttp", reason="needs aiohttp")
from clvol.view import View
from clvol.view.hosts.server import Limits, Serving, serve

CANVAS = ".clvol-pane[data-pane='3d'] canvas"
LAST = "document.querySelector('.clvol-pane[data-pane=\"3d\"]')?.dataset.final === 'true'"


@pytest.fixture
def served(device: Device) -> Iterator[Serving]:
    view = View(clvol.phantoms.sphere(32), device=device, mode="isosurface", name="a sphere of 32³")
    with view.serve() as found:
        yield found


def opened(browser: Browser, server: Serving) -> np.ndarray:
    """The first picture of the page."""
    browser.open(server.url)
    return settled(browser)


def settled(browser: Browser, other_than: np.ndarray | None = None) -> np.ndarray:
    """The last picture, once it no longer changes and differs from the given one.

    A pause is not enough: on a busy machine a coarse picture may rest before the last one arrives.
    """
    last: list[np.ndarray] = []

    def still() -> Any:
        now = browser.canvas(CANVAS) if browser.js("return document.querySelector(arguments[0])?.width > 1", CANVAS) else None
        if now is None or len(np.unique(now[..., :3])) < 8:
            return False
        if not browser.js(f"return {LAST}"):
            last.clear()
            return False
        same = len(last) > 0 and last[-1].shape == now.shape and np.array_equal(last[-1], now)
        last.append(now)
        threading.Event().wait(0.3)
        changed = other_than is None or other_than.shape != now.shape or not np.array_equal(other_than, now)
        return same and changed

    browser.wait(still, 60, "a picture that stays")
    return last[-1]


def test_the_page_responds_to_gestures_and_contacts_no_other_machine(browser: Browser, served: Serving) -> None:
    first = opened(browser, served)
    assert browser.js("return location.search") == ""  # the token has left the address
    assert "a sphere" in browser.js("return document.body.innerText + document.title")
    seen = first[..., :3].astype(int).sum(-1) > 30
    assert 0.05 < seen.mean() < 0.9  # the sphere on its ground

    browser.drag((120, 40), CANVAS)
    dragged = settled(browser, first)
    browser.wheel(-360, CANVAS)
    nearer = settled(browser, dragged)
    assert (nearer[..., :3].astype(int).sum(-1) > 30).mean() > 1.1 * seen.mean()

    origin = served.url.partition("?")[0].removeprefix("http://")
    requests = browser.requests()
    assert len(requests) >= 4  # page, script, style, websocket
    assert [url for url in requests if url.partition("://")[2].partition("/")[0] + "/" != origin] == []
    assert any(url.startswith("ws://") for url in requests)
    assert [line for line in browser.console() if "SEVERE" in line] == []


class Plain(http.server.BaseHTTPRequestHandler):
    """A page of another server on this machine, without a policy."""

    got: ClassVar[list[list[tuple[str, str]]]] = []  # headers

    def do_GET(self) -> None:
        self.got.append(self.headers.items())
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<title>elsewhere</title>")

    def log_message(self, *_: object) -> None: ...


def test_another_page_in_the_same_browser_gets_nothing(browser: Browser, served: Serving) -> None:
    """The origin is rejected, with the right token too; and no request to another port of the machine has a secret."""
    opened(browser, served)
    base = served.url.partition("?")[0]
    ask = """
        const [base, token, done] = arguments, answers = [];
        const told = async (url) => {
          try { answers.push((await fetch(url, {credentials: "include"})).type); } catch { answers.push("refused"); }
        };
        const socket = (url) => new Promise((next) => {
          const ws = new WebSocket(url);
          ws.onopen = () => next(answers.push("open"));
          ws.onerror = () => next(answers.push("refused"));
        });
        (async () => {
          await told(base);
          await told(base + token);
          await socket(base.replace("http", "ws") + "ws");
          await socket(base.replace("http", "ws") + "ws" + token);
          done(answers);
        })();
    """
    own = """
        const [url, done] = arguments, ws = new WebSocket(url);
        ws.onopen = () => done("open");
        ws.onerror = () => done("refused");
    """
    assert browser.driver.execute_async_script(own, base.replace("http", "ws") + "ws") == "open"  # the page itself may
    secret = browser.js("return Object.entries(localStorage).join()")
    assert len(secret) > 43
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Plain) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        browser.open(f"http://127.0.0.1:{other.server_port}/")
        assert browser.driver.execute_async_script(ask, base, "?" + served.url.partition("?")[2]) == ["refused"] * 4
        assert browser.js("return document.cookie + Object.entries(localStorage).join()") == ""
        other.shutdown()
    assert Plain.got
    sent = [header for headers in Plain.got for header in headers]
    assert not [value for name, value in sent if name.lower() == "cookie" or secret.partition(",")[2] in value]
    browser.wait(lambda: served.clients == 0)


def test_a_page_without_the_token_explains_what_to_do(browser: Browser, served: Serving) -> None:
    browser.open(served.url.partition("?")[0])
    browser.wait("document.body.innerText.includes('open the one that was printed where clvol was started')")
    assert served.clients == 0


def test_two_pages_have_independent_views(browser: Browser, served: Serving) -> None:
    first = opened(browser, served)
    browser.js("window.open(location.href)")
    browser.driver.switch_to.window(browser.driver.window_handles[1])
    second = settled(browser)
    browser.drag((120, 40), CANVAS)
    settled(browser, second)
    browser.driver.switch_to.window(browser.driver.window_handles[0])
    np.testing.assert_array_equal(settled(browser), first)


def test_errors_are_shown_in_the_page(browser: Browser) -> None:
    def broken() -> Any:
        raise clvol.FormatError("broken.nii must begin with a header")

    with serve(broken, doing="reading broken.nii") as server:
        browser.open(server.url)
        browser.wait("document.body.innerText.includes('broken.nii must begin with a header')")


def test_an_idle_page_says_so(browser: Browser, device: Device) -> None:
    view = View(clvol.phantoms.sphere(8), device=device)
    with serve(view, limits=Limits(idle=1)) as server:
        browser.open(server.url)
        browser.wait("document.body.innerText.includes('idle for 1 s')")
        browser.wait(lambda: server.clients == 0)


def test_a_page_of_a_viewer_that_has_ended_says_so_and_hands_its_state_over(browser: Browser, device: Device) -> None:
    told = "document.querySelector('.clvol-status').textContent"
    mode = (
        "[...document.querySelectorAll('.clvol-row')].find((row) => row.firstChild.textContent === 'Mode').querySelector('select')"
    )
    with serve(View(clvol.phantoms.sphere(8), device=device)) as first:
        opened(browser, first)
        browser.js(f"const list = {mode}; list.value = 'mip'; list.dispatchEvent(new Event('change'))")
        browser.wait("location.hash !== ''")
        port = int(first.url.split(":")[2].partition("/")[0])
    browser.wait(f"{told}.includes('trying again in')")
    with serve(View(clvol.phantoms.sphere(8), device=device), port=port) as second:
        browser.wait(f"{told}.includes('this viewer has ended; open the address that clvol prints')")
        count = len(browser.requests())
        threading.Event().wait(1.5)
        assert len(browser.requests()) == count  # it does not go on trying
        browser.js("const box = document.querySelector('.clvol-renewal input'); box.value = arguments[0]; box.focus()", second.url)
        browser.key("Enter", windowsVirtualKeyCode=13)
        browser.wait(f"document.querySelector('.clvol-pane') && {mode}.value === 'mip' && {told} === ''")


def test_a_reload_and_another_tab_need_no_token(browser: Browser, served: Serving) -> None:
    first = opened(browser, served)
    browser.driver.refresh()
    np.testing.assert_array_equal(settled(browser), first)
    browser.js("window.open(arguments[0], '_blank', 'noopener')", served.url.partition("?")[0])
    browser.driver.switch_to.window(browser.driver.window_handles[1])
    settled(browser)
    assert served.clients == 2
