"""How the viewer feels, in a real browser on the machine that draws: seconds from a drag to something new on the screen, pictures a
second, the still picture after rest, and the first picture after the command.

    python -m bench.view [--samples 256] [--size 512] [--rounds 12] [--json FILE]

Needs Chromium with its driver and selenium (tests/view/browser.py). Times are the page's own: from the event's stamp to the first
frame of the screen after the picture was drawn on the canvas. The browser draws without a GPU beside the volume, on the same cores.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np

import clvol
from clvol.view import View
from tests.view.browser import Browser, open_browser, why_none

CANVAS = ".clvol-pane[data-pane='3d'] canvas"
PANE = ".clvol-pane[data-pane='3d']"
_HOOKS = """
    window.benchDrawn = []; window.benchFrames = []; window.benchEvents = [];
    const draw = CanvasRenderingContext2D.prototype.drawImage;
    CanvasRenderingContext2D.prototype.drawImage = function (image, ...rest) {
      const result = draw.call(this, image, ...rest);
      const entry = {width: image.width, height: image.height, drawn: performance.now(), shown: null, epoch: Date.now()};
      window.benchDrawn.push(entry);
      requestAnimationFrame(() => (entry.shown = performance.now()));
      return result;
    };
    const Socket = window.WebSocket;
    window.WebSocket = class extends Socket {
      constructor(...rest) {
        super(...rest);
        this.addEventListener("message", ({ data }) => {
          const message = typeof data === "string" ? JSON.parse(data) : {};
          if (message.type === "frame") window.benchFrames.push({...message, at: performance.now()});
        });
      }
    };
    for (const type of ["pointermove", "pointerup"]) {
      window.addEventListener(type, (e) => window.benchEvents.push({type, at: e.timeStamp, x: e.clientX}), {capture: true});
    }
"""
_AIMS = {
    "drag to new": (0.06, "s", "least"),
    "surface": (25.0, "pictures/s", "most"),
    "translucent": (12.0, "pictures/s", "most"),
    "still": (0.3, "s", "least"),
    "first picture": (1.0, "s", "least"),
}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--samples", type=int, default=256, help="along each axis of the volume")
    arguments.add_argument("--size", type=int, default=512, help="pixels along each edge of the pane")
    arguments.add_argument("--rounds", type=int, default=12)
    arguments.add_argument("--json", type=Path, help="a file for the figures")
    options = arguments.parse_args()
    if why := why_none():
        sys.exit(f"bench.view {why}")
    load = os.getloadavg()[0]
    print(f"load {load:.1f} on {os.cpu_count()} cores; volume {options.samples}³, pane {options.size}²")
    volume = clvol.phantoms.marschner_lobb(options.samples)
    found: dict[str, Any] = {"load": load, "samples": options.samples, "size": options.size}
    with open_browser() as browser:
        browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _HOOKS})
        for name, mode in (("surface", "isosurface"), ("translucent", "composite")):
            with View(volume, mode=mode).serve() as server:
                begin(browser, server.url, options.size)
                found[name] = {
                    "drag to new": [drag_to_new(browser) for _ in range(options.rounds)],
                    "still": [drag_to_still(browser) for _ in range(max(3, options.rounds // 3))],
                    **rate(browser, 4.0),
                }
                browser.open("about:blank")
                found[name]["elsewhere"] = elsewhere(server.url, options.size, 4.0)
                report(name, found[name])
        found["first picture"] = first_pictures(browser, volume, 3)
        first, whole = zip(*found["first picture"], strict=True)
        print(f"first picture after the command: {times(first)}, aim {_AIMS['first picture'][0]} s; of all samples {times(whole)}")
    print(f"load at the end {os.getloadavg()[0]:.1f}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


def begin(browser: Browser, url: str, size: int) -> None:
    """The page with a pane of that size, once its still picture is shown."""
    browser.open(url)
    browser.wait(f"document.querySelector({PANE!r})")
    _, _, width, height = browser.box(PANE)
    inner = browser.js("return [innerWidth, innerHeight]")
    metrics = {
        "width": round(inner[0] + size - width),
        "height": round(inner[1] + size - height),
        "deviceScaleFactor": 1,
        "mobile": False,
    }
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    settle(browser)


def settle(browser: Browser) -> None:
    until(browser, "benchFrames.length && benchFrames.at(-1).final && performance.now() - benchFrames.at(-1).at > 500", 120)


def until(browser: Browser, condition: str, seconds: float) -> None:
    """Wait inside the page: polling from outside would take processor time in two more processes."""
    browser.driver.set_script_timeout(seconds + 10)
    found = browser.driver.execute_async_script(
        f"""
        const done = arguments[0], begun = performance.now();
        const timer = setInterval(() => {{
          const found = Boolean({condition}), late = performance.now() - begun > {1000 * seconds};
          if (found || late) {{ clearInterval(timer); done(found); }}
        }}, 10);
        """
    )
    assert found, f"{condition} is not so after {seconds} s"


def press(browser: Browser) -> tuple[float, float]:
    left, top, width, height = browser.box(PANE)
    x, y = left + width / 2, top + height / 2
    browser.mouse("mouseMoved", x, y)
    browser.mouse("mousePressed", x, y, buttons=1)
    return x, y


def drag_to_new(browser: Browser) -> float:
    """Seconds from a mouse move after rest to the first new picture on the screen."""
    settle(browser)
    x, y = press(browser)
    time.sleep(0.6)
    browser.js("benchDrawn.length = 0; benchEvents.length = 0")
    browser.mouse("mouseMoved", x + 25, y + 5, button="left", buttons=1)
    until(browser, "benchDrawn.length && benchDrawn[0].shown !== null", 30)
    took = browser.js("return benchDrawn[0].shown - benchEvents[0].at")
    browser.mouse("mouseReleased", x + 25, y + 5)
    return float(took) / 1000


def drag_to_still(browser: Browser) -> float:
    """Seconds from the mouse's release after a drag to the still picture."""
    settle(browser)
    browser.js("benchFrames.length = 0; benchDrawn.length = 0; benchEvents.length = 0")
    browser.drag((60, 20), CANVAS, buttons=1)
    until(browser, "benchFrames.length && benchFrames.at(-1).final && benchDrawn.at(-1)?.drawn >= benchFrames.at(-1).at", 60)
    took = browser.js("return benchDrawn.at(-1).drawn - benchEvents.findLast((e) => e.type === 'pointerup').at")
    return float(took) / 1000


def rate(browser: Browser, seconds: float) -> dict[str, Any]:
    """Pictures per second while the mouse moves with each screen frame."""
    settle(browser)
    x, y = press(browser)
    done = browser.driver.execute_async_script(
        """
        const [selector, x, y, seconds, done] = arguments, pane = document.querySelector(selector), begun = performance.now();
        benchDrawn.length = 0; let n = 0;
        const move = () => {
          const now = performance.now() - begun;
          if (now > 1000 * seconds) { done([benchDrawn, now]); return; }
          n += 1;
          const at = {clientX: x + 150 * Math.sin(n / 40), clientY: y + 40 * Math.sin(n / 25)};
          const held = {pointerId: 1, pointerType: "mouse", buttons: 1, bubbles: true};
          pane.dispatchEvent(new PointerEvent("pointermove", {...held, ...at}));
          requestAnimationFrame(move);
        };
        move();
        """,
        PANE,
        x,
        y,
        seconds,
    )
    browser.mouse("mouseReleased", x, y)
    drawn, took = done
    pixels = [entry["width"] * entry["height"] for entry in drawn]
    gaps = np.diff([entry["drawn"] for entry in drawn]) / 1000
    return {
        "pictures/s": 1000 * len(drawn) / took,
        "edge": statistics.median(pixels) ** 0.5 if pixels else 0.0,
        "longest gap": float(gaps.max()) if len(gaps) else seconds,
    }


def elsewhere(url: str, size: int, seconds: float) -> dict[str, float]:
    """Pictures per second during a drag, their size, and seconds from its end to the still picture.

    For a browser on another machine: a client that only acknowledges frames stands for it.
    """

    async def drag() -> tuple[list[tuple[int, float]], float]:
        async with aiohttp.ClientSession() as client, client.ws_connect(url.partition("?")[0] + "ws", max_msg_size=0) as socket:
            await socket.send_json({"type": "hello", "token": url.partition("token=")[2]})

            async def event(kind: str, **more: Any) -> None:
                await socket.send_json({"type": "event", "event": {"event_type": kind, "pane": "3d", **more}})

            async def frames() -> AsyncIterator[dict[str, Any]]:
                async for message in socket:
                    if message.type == aiohttp.WSMsgType.TEXT and (told := json.loads(message.data))["type"] == "frame":
                        await socket.send_json({"type": "ack", "frame": told["number"]})
                        yield told

            await event("resize", width=size, height=size, pixel_ratio=1)
            async for frame in frames():
                if frame["final"]:
                    break
            await event("pointer_down", x=size / 2, y=size / 2, button=1, buttons=[1])
            found, begun, n = [], time.monotonic(), 0
            await event("pointer_move", x=size / 2 + 9, y=size / 2, buttons=[1])
            async for frame in frames():
                found.append((frame["width"] * frame["height"], time.monotonic() - begun))
                if found[-1][1] > seconds:
                    break
                n += 1
                x, y = size / 2 + 150 * math.sin(n / 40), size / 2 + 40 * math.sin(n / 25)
                await event("pointer_move", x=x, y=y, buttons=[1])
            released = time.monotonic()
            await event("pointer_up", x=x, y=y, button=1, buttons=[])
            async for frame in frames():
                if frame["final"]:
                    return found, time.monotonic() - released
        raise RuntimeError("the server ended the connection")

    found, still = asyncio.run(drag())
    edge = statistics.median(pixels for pixels, _ in found) ** 0.5
    return {"pictures/s": len(found) / found[-1][1], "edge": edge, "still": still}


def first_pictures(browser: Browser, volume: clvol.Volume, rounds: int) -> list[list[float]]:
    """Seconds from the start of the command, with built kernels, to the first picture in an open browser.

    And to the first one of all samples; a preview precedes it.
    """
    found = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "volume.nrrd"
        clvol.write(volume, path)
        # as installed, with compiled modules: the first, uncounted round may compile them
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        for _ in range(rounds + 1):
            begun = time.time()
            command = [sys.executable, "-m", "clvol", "view", str(path), "--serve"]
            with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8", env=environment) as process:
                assert process.stdout is not None
                browser.open(process.stdout.readline().strip())
                until(browser, "benchFrames.length && benchFrames.at(-1).final && benchDrawn.length", 60)
                drawn = browser.js("return [benchDrawn[0].epoch, benchDrawn[benchFrames.findIndex((f) => !f.few)]?.epoch]")
                found.append([float(at or "nan") / 1000 - begun for at in drawn])
                process.terminate()
    return found[1:]


def report(name: str, found: dict[str, Any]) -> None:
    print(f"{name}: drag to something new {times(found['drag to new'])}, aim {_AIMS['drag to new'][0]} s")
    print(f"{name}: still picture after rest {times(found['still'])}, aim {_AIMS['still'][0]} s")
    rate = f"{found['pictures/s']:.1f} pictures/s of {found['edge']:.0f}² pixels, longest gap {found['longest gap']:.2f} s"
    print(f"{name}: while dragged {rate}; aim {_AIMS[name][0]:g} pictures/s")
    alone = found["elsewhere"]
    print(
        f"{name}: the browser elsewhere: {alone['pictures/s']:.1f} pictures/s of {alone['edge']:.0f}² pixels, "
        f"still picture after {alone['still']:.3f} s"
    )


def times(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.3f} s ({min(values):.3f} to {max(values):.3f})"


if __name__ == "__main__":
    main()
