"""Runs every measurement, prints a table, and writes it down with the machine and the versions.

    python -m bench [--quick] [--output FILE] [--only WORD]

Each row is timed beside its peers in turn (ours, theirs, ours, ...), after one warm-up that also builds the
kernels; medians are compared.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import ndimage

import clvol
from clvol.boundary import as_boundary
from clvol.device import as_device
from clvol.figures import figure6
from clvol.filters import as_filter
from clvol.spline import Coefficients, choose_path, sample_coefficients

RESULTS = Path(__file__).parent / "results"


@dataclass
class Case:
    """One kind of work: ours, the same by others, and how much of it there is."""

    name: str
    ours: Callable[[], Any]
    peers: dict[str, Callable[[], Any]] = field(default_factory=dict)
    amount: float = 0.0  # of `unit`, for a rate
    unit: str = ""
    repeats: int = 5

    def measure(self) -> dict[str, Any]:
        work = {"clvol": self.ours, **self.peers}
        times: dict[str, list[float]] = {name: [] for name in work}
        self.ours()
        for i in range(self.repeats):
            for name, action in work.items():
                if name != "clvol" and i >= 3:  # the peers are slow, and steady
                    continue
                started = time.perf_counter()
                action()
                times[name].append(time.perf_counter() - started)
        seconds = {name: statistics.median(t) for name, t in times.items()}
        ratios = {name: seconds[name] / seconds["clvol"] for name in self.peers}
        rate = self.amount / seconds["clvol"] if self.amount else None
        return {
            "name": self.name, "seconds": seconds, "spread": [min(times["clvol"]), max(times["clvol"])],
            "rate": rate, "unit": self.unit, "times_faster_than": ratios,
        }  # fmt: skip


def cases(quick: bool) -> list[Case]:
    n = 128 if quick else 256
    rng = np.random.default_rng(0)
    data = rng.standard_normal((n, n, n)).astype(np.float32)
    volume = clvol.Volume(data)
    device, row, rule = as_device(), as_filter("bspline3"), as_boundary("mirror")
    held = Coefficients(volume, row, rule, device)
    path = choose_path(device, row)
    coefficients = ndimage.spline_filter(data, 3, output=np.float32, mode="mirror")
    points = _along_rays(n, 1 << (18 if quick else 22))
    fewer = points[: 1 << 20]  # enough for scipy, which runs on one thread
    turned = np.ascontiguousarray(fewer[:, ::-1].T)
    smooth = clvol.Volume(ndimage.gaussian_filter(data, 4))
    renderer = clvol.Renderer(smooth)
    size = (256, 256) if quick else (512, 512)

    def theirs() -> Any:
        return ndimage.map_coordinates(coefficients, turned, order=3, mode="mirror", prefilter=False)

    def ours(derivative: int, at: np.ndarray[Any, Any] = fewer) -> Any:
        return sample_coefficients(held, path, at, derivative)

    frames = [
        Case(f"frame {size[0]}² {mode}, {n}³", partial(renderer.render, mode=mode, size=size), repeats=3) for mode in clvol.modes()
    ]
    small = data[: n // 2, : n // 2, : n // 2]
    return [
        Case(
            f"prefilter {n}³, array to array", lambda: clvol.prefilter(data),
            {"scipy spline_filter": lambda: ndimage.spline_filter(data, 3, output=np.float32, mode="mirror")},
            n**3 / 1e6, "Mvoxel/s",
        ),
        Case("prefilter and upload", lambda: Coefficients(volume, row, rule, device).release(), {}, n**3 / 1e6, "Mvoxel/s"),
        Case("cubic along rays, beside scipy", lambda: ours(0), {"scipy map_coordinates": theirs}, len(fewer) / 1e6, "Msample/s"),
        Case("cubic along rays", lambda: ours(0, points), {}, len(points) / 1e6, "Msample/s"),
        Case("cubic along rays, gradient", lambda: ours(1, points), {}, len(points) / 1e6, "Msample/s"),
        Case("magnify ×2, prefilter included", lambda: clvol.magnify(small, 2),
             {"scipy zoom": lambda: ndimage.zoom(small, 2, order=3, mode="mirror")}, n**3 / 1e6, "Mvoxel/s", 3),
        *frames,
        *([] if quick else [Case("figure 6, six panels 512²", lambda: figure6(), repeats=1)]),
    ]  # fmt: skip


def _along_rays(n: int, count: int) -> np.ndarray[Any, Any]:
    """Points along oblique rays through a volume of side `n`, one ray after the other."""
    per_ray = 256
    side = int(np.sqrt(count // per_ray))
    a, b = np.meshgrid(np.linspace(0.1, 0.8, side), np.linspace(0.1, 0.8, side))
    t = np.linspace(0.05, 0.95, per_ray)
    x = a.ravel()[:, None] + 0.1 * t
    y = b.ravel()[:, None] + 0.07 * t
    return np.stack([x, y, np.broadcast_to(t, x.shape)], -1).reshape(-1, 3) * (n - 1)


def machine() -> dict[str, Any]:
    device = as_device()
    return {
        "processor": device.name, "cores": os.cpu_count(), "opencl": str(device.handle.platform.version),
        "python": platform.python_version(), "load": os.getloadavg()[0],
        **{name: version(name) for name in ("clvol", "numpy", "scipy", "pyopencl")},
    }  # fmt: skip


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: a check that all of it runs")
    arguments.add_argument("--only", default="", help="only measurements whose name holds this")
    arguments.add_argument("--output", type=Path, help="default: bench/results/<date>.json; not written with --quick or --only")
    options = arguments.parse_args()
    console = Console(width=130)
    rows = []
    for case in cases(options.quick):
        if options.only in case.name:
            console.print(f"[dim]{case.name}[/dim]")
            rows.append(case.measure())
    table = Table("work", "clvol, s", "rate", "times faster than", box=None)
    for row in rows:
        rate = f"{row['rate']:.1f} {row['unit']}" if row["rate"] else ""
        ratios = ", ".join(f"{name} {ratio:.1f}×" for name, ratio in row["times_faster_than"].items())
        table.add_row(row["name"], f"{row['seconds']['clvol']:.4f}", rate, ratios)
    console.print(table)
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    output = options.output or (None if options.quick or options.only else RESULTS / f"{today}.json")
    if output:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps({"date": today, "machine": machine(), "results": rows}, indent=1) + "\n", encoding="utf-8")
        console.print(f"written: {output}")


if __name__ == "__main__":
    main()
