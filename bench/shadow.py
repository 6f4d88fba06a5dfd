"""What shadow and occlusion cost: sweeps of light, and pictures that read what they leave, beside those without in the same run.

    python -m bench.shadow

Frames of 512² of 256³ samples, medians over rounds that alternate, as a ratio (aimed at: 1.3); and once for each transfer function,
lights and cuts the sweeps of all lights and of the light from everywhere (0.3 s on two cores). Processor seconds say the same on a
machine that has other work.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import clvol
from clvol.march.shadow import Body, Cells, Matter, Shadows
from clvol.scene.clip import Cuts
from clvol.scene.light import KIT

_SIZE = 512, 512
_ROUNDS = 7
_EDGE = 256
_LOOKS: dict[str, dict[str, Any]] = {
    "opaque": {"mode": "composite"},
    "translucent": {"mode": "composite", "opacity": 0.05},
    "isosurface": {"mode": "isosurface"},
}


def taken(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds, and those of all cores."""
    begun, before = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - before


def main() -> None:
    """Measure, and print a table."""
    x, y, z = np.mgrid[-1 : 1 : _EDGE * 1j, -1 : 1 : _EDGE * 1j, -1 : 1 : _EDGE * 1j].astype(np.float32)
    folds = np.sin(9 * x) * np.sin(8 * y) * np.sin(10 * z)
    volume = clvol.Volume(1 - np.sqrt(x**2 + y**2 + z**2) + 0.2 * folds)
    with clvol.Renderer(volume, "bspline3") as renderer:

        def picture(dark: int, look: dict[str, Any]) -> None:
            renderer.render(size=_SIZE, rays=1, shadow=dark, occlusion=dark, **look)

        for name, look in _LOOKS.items():
            rounds = [[taken(partial(picture, dark, look)) for dark in (0, 1)] for _ in range(_ROUNDS + 1)][1:]
            for kind, what in enumerate(("s", "processor s")):
                plain, shadowed = (statistics.median(one[dark][kind] for one in rounds) for dark in (0, 1))
                print(f"{name:12} {plain:8.3f} {shadowed:8.3f} {what:12} {shadowed / plain:6.2f}")
    with clvol.Field(volume, "bspline3") as field:
        shadows, cells = Shadows(field.device), Cells.over([volume])
        ways = tuple(light.direction for light in KIT if light.direction is not None)
        body = Body.of(field.coefficients, Matter(((0.2, 0.0), (0.5, 0.3)), 1.0, (), Cuts()))
        for what, rounds_of in (("first", 1), ("again", _ROUNDS)):
            sweeps = [taken(partial(shadows.light, cells, [body], ways, occlusion=True)) for _ in range(rounds_of)]
            wall, processor = map(statistics.median, zip(*sweeps, strict=True))
            print(f"{what:12} {wall:8.3f} s {processor:8.3f} processor s")
        shadows.release()


if __name__ == "__main__":
    main()
