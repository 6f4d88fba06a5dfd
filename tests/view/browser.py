"""A headless Chromium that looks at a page of this machine, and what tests ask it: pictures, gestures, requests that it made.

Debian's ``chromium`` and ``chromium-driver`` are enough (or those that CHROMIUM and CHROMEDRIVER name), driven by selenium.
Tests are skipped, with the reason, where one of them is missing.
"""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

__all__ = ["SOFTWARE_GL", "Browser", "browser", "open_browser", "why_none"]

# The browser must not check for updates and the like, nor reach another machine.
FLAGS = (
    "--headless",
    "--no-sandbox",  # tests run as root in containers
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-sync",
    "--disable-extensions",
    "--no-proxy-server",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1 , EXCLUDE localhost",
    "--force-device-scale-factor=1",
)
SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Flags of a browser that draws by WebGL without a graphics card."""
_CANVAS = "canvas"


def why_none() -> str:
    """What a browser test lacks here; nothing if all is installed."""
    if not _program("CHROMIUM", "chromium", "chromium-browser", "google-chrome"):
        return "needs Chromium (Debian: apt-get install chromium chromium-driver), which is not installed"
    if not _program("CHROMEDRIVER", "chromedriver"):
        return "needs Chromium's driver (Debian: apt-get install chromium-driver), which is not installed"
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "needs selenium (pip install selenium), which is not installed"
    return ""


def _program(variable: str, *names: str) -> str:
    """The program named by the environment, else the first one found."""
    return os.environ.get(variable) or next(filter(None, map(shutil.which, names)), "")


class Browser:
    """One browser window; `driver` is selenium's, for everything else."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self._log: list[dict[str, Any]] = []

    def open(self, url: str) -> None:
        self.driver.get(url)

    def js(self, code: str, *arguments: Any) -> Any:
        """Run JavaScript and return its result; arguments are ``arguments[0]`` and so on."""
        return self.driver.execute_script(code, *arguments)

    def wait(self, condition: Callable[[], Any] | str, seconds: float = 20, what: str = "") -> Any:
        """The first true result of a function or JavaScript expression; an assertion fails after a timeout."""

        def ask() -> Any:
            return self.js(f"return {condition}") if isinstance(condition, str) else condition()

        until = time.monotonic() + seconds
        while True:
            if found := ask():
                return found
            assert time.monotonic() < until, f"{what or condition} is not so after {seconds} s; the console says {self.console()}"
            time.sleep(0.02)

    def screenshot(self, path: Path | None = None) -> np.ndarray:
        """The page as (height, width, 3) of uint8; saved too if a path is given."""
        import imageio.v3 as iio

        data = self.driver.get_screenshot_as_png()
        if path is not None:
            path.write_bytes(data)
        return np.asarray(iio.imread(io.BytesIO(data)))[..., :3]

    def canvas(self, selector: str = _CANVAS) -> np.ndarray:
        """The pixels of a canvas: (height, width, 4) of uint8."""
        import imageio.v3 as iio

        url = self.js("return document.querySelector(arguments[0]).toDataURL('image/png')", selector)
        return np.asarray(iio.imread(io.BytesIO(base64.b64decode(url.partition(",")[2])), mode="RGBA"))

    def box(self, selector: str = _CANVAS) -> tuple[float, float, float, float]:
        """Left, top, width and height of an element in CSS pixels of the window, into which it is scrolled."""
        code = """const e = document.querySelector(arguments[0]);
            e.scrollIntoView({block: "nearest"});
            const r = e.getBoundingClientRect();
            return [r.left, r.top, r.width, r.height]"""
        found = self.js(code, selector)
        left, top, width, height = map(float, found)
        return left, top, width, height

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event at a position in the window: mouseMoved, mousePressed, mouseReleased, mouseWheel (deltaX, deltaY)."""
        held = {"button": "left", "clickCount": 1} if kind in ("mousePressed", "mouseReleased") else {}
        self.driver.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **held, **more})

    def drag(self, by: tuple[float, float], selector: str = _CANVAS, *, steps: int = 8, **more: Any) -> None:
        """Drag from the centre of an element."""
        left, top, width, height = self.box(selector)
        x, y = left + width / 2, top + height / 2
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, **more)
        for n in range(1, steps + 1):
            self.mouse("mouseMoved", x + by[0] * n / steps, y + by[1] * n / steps, **{"button": "left", "buttons": 1} | more)
        self.mouse("mouseReleased", x + by[0], y + by[1], **more)

    def wheel(self, dy: float, selector: str = _CANVAS, **more: Any) -> None:
        left, top, width, height = self.box(selector)
        self.mouse("mouseWheel", left + width / 2, top + height / 2, deltaX=0, deltaY=dy, **more)

    def key(self, key: str, **more: Any) -> None:
        """Press and release a key, by its name in JavaScript (``"ArrowLeft"``, ``"r"``)."""
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.driver.execute_cdp_cmd(
                "Input.dispatchKeyEvent", {"type": kind, "key": key, **(text if kind == "keyDown" else {}), **more}
            )

    # -- what went over the wire -----------------------------------------------------------------------------

    def log(self) -> list[dict[str, Any]]:
        """All events of the browser's protocol since the start: {"method", "params"}."""
        entries = self.driver.get_log("performance")
        self._log += [json.loads(entry["message"])["message"] for entry in entries]
        return self._log

    def requests(self) -> list[str]:
        """URLs of all requests and websockets so far, except ``blob:`` and the like, and the browser's own pages."""
        urls = []
        for event in self.log():
            if event["method"] == "Network.requestWillBeSent":
                urls.append(event["params"]["request"]["url"])
            elif event["method"] == "Network.webSocketCreated":
                urls.append(event["params"]["url"])
        return [url for url in urls if urlsplit(url).scheme not in ("data", "blob", "about", "chrome", "chrome-untrusted")]

    def console(self) -> list[str]:
        """New console output: errors, and violations of the content security policy."""
        return [f"{entry['level']}: {entry['message']}" for entry in self.driver.get_log("browser")]


@contextmanager
def open_browser(width: int = 1280, height: int = 800, flags: Sequence[str] = ()) -> Iterator[Browser]:
    """A browser with a window of the given size, an empty profile, and further flags."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = _program("CHROMIUM", "chromium", "chromium-browser", "google-chrome")
        for flag in (*FLAGS, *flags, f"--window-size={width},{height}", f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
        driver = webdriver.Chrome(options=options, service=Service(_program("CHROMEDRIVER", "chromedriver")))
        try:
            metrics = {"width": width, "height": height, "deviceScaleFactor": 0, "mobile": False}  # 0: that of the flags
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)  # of the page, not of the window
            yield Browser(driver)
        finally:
            driver.quit()


@pytest.fixture
def browser() -> Iterator[Browser]:
    """A fresh browser of a small window; skips the test if there is none."""
    if why := why_none():
        pytest.skip(why)
    with open_browser(720, 480) as found:
        yield found
