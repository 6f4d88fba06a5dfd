"""How often the first picture of `Renderer.refine` is in time, and how quickly it stops when cancelled.

    python -m bench.refine [--quick] [--cameras N] [--seconds SECONDS] [--output FILE]

Cameras are random, each different from the one before, or orbit in steps of 3°. A cancelled iterator stops after the running
launch: that delay is measured, and the longest time between two calls of the `cancelled` callback.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import clvol
from bench import scene
from bench.machine import describe
from clvol.device import as_device

SIZE = (512, 512)
_PATIENCE = 2.0  # seconds within which iterators are cancelled
Look = dict[str, Any]


def looks() -> dict[str, Look]:
    """The measured looks; first pictures are timed for the first two."""
    ramp = clvol.TransferFunction.ramp((0.0, 2300.0))
    translucent: Look = {"mode": "composite", "transfer": scene.TRANSLUCENT}
    return {
        "translucent": translucent,
        "surface": {"mode": "isosurface", "isovalue": scene.BONE},
        "mip": {"mode": "mip", "transfer": ramp},
        "translucent, gradient='central'": {**translucent, "gradient": "central"},
        "translucent, rays=16": {**translucent, "rays": 16},
        "translucent, step=0.1": {**translucent, "step": 0.1},
    }


def anywhere(count: int, seed: int = 1) -> Iterator[clvol.Camera]:
    """From all sides, as near as five times the picture's height or as far as half of it, in both projections."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        azimuth, elevation = random.uniform(0, 360), float(np.degrees(np.arcsin(random.uniform(-1, 1))))
        projection: Any = random.choice(["perspective", "orthographic"])
        yield clvol.Camera.orbit(azimuth, elevation, zoom=float(np.exp(random.uniform(-0.7, 1.6))), projection=projection)


def around(count: int) -> Iterator[clvol.Camera]:
    """Steps of 3°, at the zoom of other frames."""
    return (clvol.Camera.orbit(3 * i, 15 + 10 * np.sin(i / 10), zoom=1.8, fit="volume") for i in range(count))


def kept(
    renderer: clvol.Renderer, cameras: Iterable[clvol.Camera], size: tuple[int, int], seconds: float, look: Look
) -> dict[str, Any]:
    """Times of first pictures, as fractions of the limit, and their sizes. The very first does not count."""
    next(renderer.refine(size=size, seconds=seconds, **look))  # builds kernels and measures a rate
    shares, pixels, long = [], [], 0
    for camera in cameras:
        started = time.perf_counter()
        first = next(renderer.refine(camera, size=size, seconds=seconds, **look))
        shares.append((time.perf_counter() - started) / seconds)
        pixels.append(first[..., 0].size)
        long += first.step > 0.5
    return {
        "kept": float(np.mean(np.array(shares) <= 1)),
        "median": float(np.median(shares)),
        "percentile_95": float(np.percentile(shares, 95)),
        "worst": max(shares),
        "side": float(np.sqrt(np.median(pixels))),
        "longer_steps": long / len(shares),
    }


def questions(renderer: clvol.Renderer, size: tuple[int, int], seconds: float, look: Look, cancels: int) -> dict[str, Any]:
    """The longest time between two calls of `cancelled`, and from cancellation to the end, in ms; and the cost of refining."""
    camera = clvol.Camera.orbit(30, 15, zoom=1.8, fit="volume")
    renderer.render(camera, size=(16, 16), **look)  # compute cached data first
    started = time.perf_counter()
    want = renderer.render(camera, size=size, **look)
    alone = time.perf_counter() - started
    asked: list[float] = []

    def note() -> bool:
        asked.append(time.perf_counter())
        return False

    started, count, last = time.perf_counter(), 0, want
    asked.append(started)
    for count, last in enumerate(renderer.refine(camera, size=size, seconds=seconds, cancelled=note, **look), 1):  # noqa: B007
        pass
    whole = time.perf_counter() - started
    asked.append(started + whole)
    if not np.array_equal(last, want):
        raise AssertionError("the last picture must be that of render")
    ends, random = [], np.random.default_rng(2)
    for _ in range(cancels):
        flag, at = threading.Event(), [0.0]

        def stop(flag: threading.Event = flag, at: list[float] = at) -> None:
            at[0] = time.perf_counter()
            flag.set()

        timer = threading.Timer(random.uniform(0, min(whole, _PATIENCE)), stop)
        timer.start()
        finals = [picture.final for picture in renderer.refine(camera, size=size, seconds=seconds, cancelled=flag.is_set, **look)]
        ended = time.perf_counter()
        timer.cancel()
        timer.join()
        if at[0] and not any(finals):
            ends.append(1000 * (ended - at[0]))
    gaps = 1000 * np.diff(asked)
    return {
        "pictures": count,
        "render": alone,
        "refine": whole,
        "between_99": float(np.percentile(gaps, 99)),
        "between": float(gaps.max()),
        "cancelled": len(ends),
        "to_end_median": float(np.median(ends)) if ends else None,
        "to_end": max(ends, default=None),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="small work: a check that all of it runs")
    arguments.add_argument("--cameras", type=int, default=200, metavar="N")
    arguments.add_argument("--cancels", type=int, default=20, metavar="N", help="of each kind of picture")
    arguments.add_argument("--seconds", type=float, default=0.05, metavar="SECONDS")
    arguments.add_argument("--output", type=Path, metavar="FILE")
    options = arguments.parse_args()
    side, size = (32, (96, 96)) if options.quick else (256, SIZE)
    cameras, cancels = (3, 2) if options.quick else (options.cameras, options.cancels)
    console, load = Console(width=150), os.getloadavg()[0]
    report: dict[str, Any] = {
        "machine": {**describe(as_device()), "load": load},
        "seconds": options.seconds,
        "kept": {},
        "asked": {},
    }
    with clvol.Renderer(scene.head(side, as_device(), "float32"), "bspline3") as renderer:
        paths = {"random": anywhere, "moving": around}
        firsts = Table("first pictures", "in time", "median", "95 %", "worst", "side", "longer steps", box=None)
        for (path, where), (name, look) in itertools.product(paths.items(), list(looks().items())[:2]):
            row = report["kept"][f"{name}, {path}"] = kept(renderer, where(cameras), size, options.seconds, look)
            shares = (f"{1000 * options.seconds * row[key]:.0f} ms" for key in ("median", "percentile_95", "worst"))
            firsts.add_row(f"{name}, {path}", f"{row['kept']:.0%}", *shares, f"{row['side']:.0f}", f"{row['longer_steps']:.0%}")
        asked = Table(
            "cancelled", "render", "refine", "pictures", "between questions, 99 %", "longest", "to the end", "longest", box=None
        )
        for name, look in looks().items():
            row = report["asked"][name] = questions(renderer, size, options.seconds, look, cancels)
            times = (
                "-" if row[key] is None else f"{row[key]:.1f} ms" for key in ("between_99", "between", "to_end_median", "to_end")
            )
            asked.add_row(name, f"{row['render']:.3f} s", f"{row['refine']:.3f} s", str(row["pictures"]), *times)
    console.print(firsts, asked, sep="\n\n")
    console.print(f"[dim]load {load:.1f} before, {os.getloadavg()[0]:.1f} at the end[/dim]")
    if options.output:
        options.output.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
