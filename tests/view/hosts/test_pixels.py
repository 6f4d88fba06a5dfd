"""What the screen shows of a picture at rest is that picture, bit for bit, whatever the screen's pixels per CSS pixel."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol.view import Session, State, View
from tests.view.browser import Browser, open_browser, why_none

pytest.importorskip("aiohttp", reason="needs aiohttp")
from clvol.view.hosts.server import Serving, serve

pytestmark = pytest.mark.skipif(bool(why_none()), reason=why_none())
WIDTH, HEIGHT = 683, 431  # of the page, in CSS pixels, so that edges lie between the screen's pixels
BARE = ".clvol-overlay, .clvol-wiper, .clvol-status { visibility: hidden } .clvol-pane { outline: none !important }"
DRESS = """const sheet = new CSSStyleSheet();
    sheet.replaceSync(arguments[0]);
    document.adoptedStyleSheets.push(sheet);"""
SHOWN = """return [...document.querySelectorAll(".clvol-pane")].filter((one) => one.checkVisibility()).map((one) => {
    const {left, top, width, height} = one.querySelector("canvas").getBoundingClientRect();
    return [one.dataset.pane, left, top, width, height];
});"""
TWO = """const two = ["33.4%", "41.1%"].map((width) => Object.assign(document.createElement("main"), {style: `width: ${width}`}));
    document.querySelector("main").style.display = "none";
    document.body.append(...two);
    document.body.style.cssText = "display: flex; padding: 3.3px 1.7px; gap: 1.1px";
    import("./clvol.js").then(({page}) => two.forEach(page));"""


class Told(View):
    """A view that keeps the last picture that it sent for each pane, of all its sessions."""

    final: dict[tuple[int, str], np.ndarray]
    count = 0

    def session(self, send: Any, state: State | None = None) -> Session:
        self.count = number = self.count + 1

        def sent(message: dict[str, Any], data: bytes | None) -> None:
            if message["type"] == "frame" and message["final"] and data is not None:
                self.final[number, message["pane"]] = np.asarray(iio.imread(io.BytesIO(data)))[..., :3]
            send(message, data)

        return super().session(sent, state)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Serving, Told]]:
    view = Told(clvol.phantoms.marschner_lobb(24), mode="mip")
    view.final = {}
    with serve(view) as server:
        yield server, view


@pytest.mark.parametrize("ratio", [1, 1.25, 1.5, 2])
def test_the_screen_shows_pictures_bit_for_bit(served: tuple[Serving, Told], ratio: float) -> None:
    server, view = served
    first = view.state
    with open_browser(WIDTH, HEIGHT, [f"--force-device-scale-factor={ratio}"]) as browser:
        for layout, count in (("3d", 1), ("linked", 4), ("3d", 2)):
            view.final.clear()
            view.state = replace(first, layout=layout)  # type: ignore[arg-type]  # one of a layout's
            browser.open(server.url)
            browser.js(DRESS, BARE)
            if count == 2:
                browser.js(TWO)
            assert browser.js("return devicePixelRatio") == ratio
            browser.wait(lambda count=count: _shares(browser, view, ratio) == [0] * count, 30, f"{count} exact pictures")


def _shares(browser: Browser, view: Told, ratio: float) -> list[float]:
    """By pane, the least share of pixels in which the screen differs from a picture that was sent for it."""
    shown, screen, sent = browser.js(SHOWN), browser.screenshot(), list(view.final.items())
    return [
        min((_share(screen, box, picture, ratio) for (_, of), picture in sent if of == name), default=1) for name, *box in shown
    ]


def _share(screen: np.ndarray, box: list[float], picture: np.ndarray, ratio: float) -> float:
    left, top, right, bottom = (math.floor(ratio * edge + 0.501) for edge in (box[0], box[1], box[0] + box[2], box[1] + box[3]))
    part = screen[top:bottom, left:right]
    return 1.0 if part.shape != picture.shape else float((part != picture).any(-1).mean())
