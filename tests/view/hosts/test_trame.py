"""The trame example: its page shows a picture and rotates it. Skipped where trame or Chromium is not installed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from tests.view.browser import Browser

SCRIPT = Path(__file__).resolve().parents[3] / "examples" / "trame_view.py"


def test_a_page_of_trame_shows_pictures_and_drags(browser: Browser, tmp_path: Path) -> None:
    python = os.environ.get("CLVOL_TEST_TRAME", sys.executable)
    if subprocess.run([python, "-c", "import trame_vuetify, trame"], capture_output=True, timeout=60, check=False).returncode:
        pytest.skip("trame and trame-vuetify are not installed")
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    command = [python, str(SCRIPT), "--port", str(port)]
    with (tmp_path / "log").open("w") as log, subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log) as page:
        try:
            end = time.monotonic() + 60
            while True:
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5).close()
                    break
                except OSError:
                    assert page.poll() is None, (tmp_path / "log").read_text()
                    assert time.monotonic() < end
                    time.sleep(0.2)
            browser.open(f"http://127.0.0.1:{port}/")
            src = "(document.querySelector('img')||{}).src || ''"
            browser.wait(f"({src}).startsWith('data:image/png')", 90, "a still picture")
            first = browser.js(f"return {src}")
            browser.screenshot(tmp_path / "first.png")
            assert browser.js("return document.querySelector('img').naturalWidth") == 512
            browser.drag((120, 30), "img")
            browser.wait(lambda: (now := browser.js(f"return {src}")) != first and now.startswith("data:image/png"), 60, "a drag")
            browser.screenshot(tmp_path / "second.png")
            turned = browser.js(f"return {src}")
            browser.wheel(-300, "img")
            browser.wait(lambda: (now := browser.js(f"return {src}")) != turned and now.startswith("data:image/png"), 60, "a wheel")
        finally:
            page.terminate()
            page.wait(30)
