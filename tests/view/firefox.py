"""Firefox, as `tests.view.browser` has Chromium: by WebDriver BiDi, which needs no driver.

Its screen is Xvfb's: without one it has no WebGL in software.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.view.browser import Browser

__all__ = ["Firefox", "open_firefox", "why_no_firefox"]

_NAMES = "firefox-esr", "firefox"


def why_no_firefox() -> str:
    """What a test in Firefox lacks here; nothing if all is installed."""
    if not any(map(shutil.which, _NAMES)) or not shutil.which("Xvfb"):
        return "needs Firefox and Xvfb (Debian: apt-get install firefox-esr xvfb), which are not installed"
    try:
        import websocket  # noqa: F401
    except ImportError:
        return "needs websocket-client (pip install selenium), which is not installed"
    return ""


class Firefox(Browser):
    """One window; of `Browser` it has `open`, `js`, `wait`, `canvas` and `console`, and what `act` does."""

    def __init__(self, connection: Any) -> None:
        super().__init__(None)
        self._connection, self._sent, self._events = connection, 0, list[dict[str, Any]]()
        self._ask("session.new", capabilities={})
        self._window = self._ask("browsingContext.getTree")["contexts"][0]["context"]
        self._ask("session.subscribe", events=["log.entryAdded", "network.beforeRequestSent"])

    def _ask(self, method: str, **parameters: Any) -> Any:
        self._sent += 1
        self._connection.send(json.dumps({"id": self._sent, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._connection.recv())
            if answer.get("id") == self._sent:
                assert answer["type"] == "success", answer
                return answer["result"]
            self._events.append(answer)

    def open(self, url: str) -> None:
        self._ask("browsingContext.navigate", context=self._window, url=url, wait="complete")

    def js(self, code: str, *arguments: Any) -> Any:
        given = [{"type": "string", "value": json.dumps(one)} for one in arguments]
        text = f"(...texts) => JSON.stringify((function () {{ {code} }})(...texts.map((one) => JSON.parse(one))))"
        answer = self._ask(
            "script.callFunction", functionDeclaration=text, arguments=given, awaitPromise=False, target={"context": self._window}
        )
        assert answer["type"] == "success", answer
        return json.loads(answer["result"].get("value", "null"))

    def act(self, kind: str, *actions: dict[str, Any]) -> None:
        """Actions of a "pointer" or a "key", as WebDriver has them."""
        self._ask("input.performActions", context=self._window, actions=[{"type": kind, "id": kind, "actions": list(actions)}])

    def requests(self) -> list[str]:
        return [one["params"]["request"]["url"] for one in self._events if one.get("method") == "network.beforeRequestSent"]

    def console(self) -> list[str]:
        entries = [one["params"] for one in self._events if one.get("method") == "log.entryAdded"]
        return [f"{entry['level'].upper()}: {entry['text']}" for entry in entries]


@contextmanager
def open_firefox(width: int, height: int) -> Iterator[Firefox]:
    """A window of the given size with an empty profile, which draws by WebGL without a graphics card."""
    import websocket

    program = next(filter(None, map(shutil.which, _NAMES)))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile, socket.socket() as free:
        (Path(profile) / "user.js").write_text('user_pref("webgl.force-enabled", true);\n')
        screen = subprocess.Popen(
            ["Xvfb", "-displayfd", "1", "-nolisten", "tcp"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert screen.stdout is not None
        started = [screen]
        try:
            here = os.environ | {"DISPLAY": f":{screen.stdout.readline().strip()}", "MOZ_ENABLE_WAYLAND": "0"}
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
            free.close()
            size = "--width", str(width), "--height", str(height)
            command = [program, "--no-remote", "--profile", profile, *size, "--remote-debugging-port", str(port)]
            started.append(subprocess.Popen(command, env=here, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            until = time.monotonic() + 60
            while True:
                try:
                    connection = websocket.create_connection(f"ws://127.0.0.1:{port}/session", timeout=60, suppress_origin=True)
                    break
                except OSError:
                    assert time.monotonic() < until, "Firefox does not listen after 60 s"
                    time.sleep(0.05)
            yield Firefox(connection)
            connection.close()
        finally:
            for one in reversed(started):
                one.terminate()
                one.wait(20)
