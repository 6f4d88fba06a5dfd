"""Error against time of translucent pictures: points, virtual samples (`Composite.virtual`), steps by `Composite.tolerance`.

    python -m bench.between [SCAN ...]

Of each scan, or else of a smooth and of a noisy translucent volume, shaded and not: the root of the mean square error of colours
where there are any, against samples 1/32 voxel apart, and processor seconds; for steps of 2 to 1/4 voxels and 0 to 4 virtual
samples between two, and for tolerances, with the step that each led to.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator
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


def volumes() -> Iterator[tuple[str, clvol.Volume, dict[str, Any]]]:
    """Name, volume and look of each."""
    for path in sys.argv[1:]:
        yield Path(path).name, clvol.read(path), {}
    if not sys.argv[1:]:
        thin = clvol.TransferFunction(((0.0, (0.1, 0.1, 0.6)), (1.0, (1.0, 0.9, 0.5))), ((0.0, 0.0), (1.0, 0.02)))
        yield "smooth", clvol.phantoms.marschner_lobb(96), {"opacity": 0.5}
        yield "noisy", noisy(), {"transfer": thin}


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
    for name, volume, look in volumes():
        with clvol.Renderer(volume) as renderer:
            for shading in (True, False):
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
                    print(f"{name:16} {'shaded' if shading else 'unshaded':8} {way:15} " + " | ".join(row), flush=True)


if __name__ == "__main__":
    main()
