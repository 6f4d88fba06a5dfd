"""Error against time of translucent pictures: points, virtual samples (`Composite.virtual`), steps by `Composite.tolerance`.

    python -m bench.between [SCAN ...] [--picture FILE]

Of a smooth and of a noisy translucent volume and of each scan, shaded and not: the root of the mean square error of colours
where there are any, against samples 1/32 voxel apart, and processor seconds; for steps of 2 to 1/4 voxels and 0 to 4 virtual
samples between two, and for tolerances, with the step that each led to. `--picture` draws them, and needs matplotlib.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import clvol

_SIZE = 256, 256
_ROUNDS = 3
_STEPS = 2.0, 1.0, 0.5, 0.25
_VIRTUAL = 0, 1, 2, 3, 4
_TOLERANCES = 0.03, 0.01, 0.003
_FINE = 1 / 32
_EDGE = 192
_DRAWN = "points", "2 virtual samples", "tolerance .03, .01, .003"

_Point = tuple[float, float]  # seconds, error


def noisy() -> clvol.Volume:
    """Balls that blend, and noise of a thirtieth of the range."""
    rng = np.random.default_rng(1)
    axis = np.linspace(-1, 1, _EDGE, dtype=np.float32)
    data = np.zeros((_EDGE,) * 3, np.float32)
    for _ in range(14):
        middle, width, height = rng.uniform(-0.7, 0.7, 3), rng.uniform(0.15, 0.45), rng.uniform(0.4, 1.0)
        x, y, z = (np.exp(-(((axis - at) / width) ** 2)).astype(np.float32) for at in middle)
        data += np.float32(height) * z[:, None, None] * y[:, None] * x
    return clvol.Volume(0.97 * data / data.max() + np.float32(0.03) * rng.random(data.shape, dtype=np.float32))


def volumes(scans: Sequence[Path]) -> Iterator[tuple[str, clvol.Volume, dict[str, Any]]]:
    """Name, volume and look of each."""
    thin = clvol.TransferFunction(((0.0, (0.1, 0.1, 0.6)), (1.0, (1.0, 0.9, 0.5))), ((0.0, 0.0), (1.0, 0.02)))
    yield "smooth", clvol.phantoms.marschner_lobb(96), {"opacity": 0.5}
    yield "noisy", noisy(), {"transfer": thin}
    for path in scans:
        yield path.name.partition(".")[0], clvol.read(path), {}


def drawn(renderer: clvol.Renderer, options: dict[str, Any]) -> tuple[clvol.Picture, float]:
    """A picture, and processor seconds."""
    taken = []
    for _ in range(_ROUNDS):
        begun = time.process_time()
        picture = renderer.render(**options)
        taken.append(time.process_time() - begun)
    return picture, statistics.median(taken)


def main() -> None:
    """Measure, and print a table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scans", nargs="*", type=Path, metavar="SCAN", help="a volume to read")
    arguments.add_argument("--picture", type=Path, metavar="FILE", help="draw error against time")
    given = arguments.parse_args()
    measured: dict[str, dict[str, list[_Point]]] = {}
    for name, volume, look in volumes(given.scans):
        with clvol.Renderer(volume) as renderer:
            for shading in (True, False):
                lines = measured[f"{name}, {'shaded' if shading else 'unshaded'}"] = defaultdict(list)
                options: dict[str, Any] = {"size": _SIZE, "rays": 1, "shading": shading, **look}
                fine = renderer.render(step=_FINE, **options)
                lit = np.abs(fine[..., :3]).max(-1) > 0.01
                ways = {f"step {step:g}": [{"step": step, "virtual": virtual} for virtual in _VIRTUAL] for step in _STEPS}
                ways |= {f"tolerance {tolerance:g}": [{"tolerance": tolerance}] for tolerance in _TOLERANCES}
                for way, each in ways.items():
                    row = []
                    for how in each:
                        picture, seconds = drawn(renderer, options | how)
                        error = float(np.sqrt(((picture - fine)[lit, :3] ** 2).mean()))
                        assert picture.recipe is not None
                        found = f" step {picture.recipe.step:g}" if "tolerance" in how else ""
                        row.append(f"{error:8.5f} {seconds:6.3f}{found}")
                        lines[_line(how)].append((seconds, error))
                    print(f"{name:16} {'shaded' if shading else 'unshaded':8} {way:15} " + " | ".join(row), flush=True)
    if given.picture:
        draw(measured, given.picture)


def _line(how: Mapping[str, float]) -> str:
    """The line of a drawing that a way of drawing belongs to."""
    if "tolerance" in how:
        return "tolerance .03, .01, .003"
    return f"{how['virtual']} virtual samples" if how["virtual"] else "points"


def draw(measured: Mapping[str, Mapping[str, Sequence[_Point]]], path: Path) -> None:
    """Error against time, a panel for each volume, shaded above unshaded."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    figure = Figure((3 * (len(measured) // 2), 6), layout="constrained")
    panels = figure.subplots(2, len(measured) // 2, squeeze=False, sharey=True).T.ravel()
    for panel, (title, lines) in zip(panels, measured.items(), strict=True):
        for label, points in lines.items():
            if label in _DRAWN:
                panel.loglog(*zip(*points, strict=True), "o-", markersize=3, label=label)
        panel.axhline(0.01, color="gray", linewidth=0.5)
        panel.set_title(title, fontsize=9)
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter("")
    for panel in panels[1::2]:
        panel.set_xlabel("processor seconds, 256²")
    for panel in panels[:2]:
        panel.set_ylabel("RMS error")
    panels[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
