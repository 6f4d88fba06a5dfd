"""What surfaces in surfaces cost, beside the first surface alone in the same run.

    python -m bench.surfaces

Medians over rounds in which all take turns. A translucent surface lets rays on: through what is inside, to its other side.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

import clvol

_SIZE = 512, 512
_ROUNDS = 9


def main() -> None:
    """Measure, and print a table."""
    z, y, x = np.mgrid[-0.5:0.5:128j, -0.5:0.5:128j, -0.5:0.5:128j]
    middles = (-0.2, 0, -0.1), (0.2, 0.05, -0.07), (0, -0.05, 0.22)
    lumps = sum(np.exp(-20 * ((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2)) for a, b, c in middles)
    noise = np.random.default_rng(0).normal(0, 0.02, lumps.shape)
    shown: dict[str, list[tuple[float, str, float]]] = {
        "one, opaque": [(0.3, "tan", 1)],
        "one, translucent": [(0.3, "tan", 0.3)],
        "two, opaque inside": [(0.3, "tan", 0.3), (0.6, "red", 1)],
        "two, translucent": [(0.3, "tan", 0.3), (0.6, "red", 0.3)],
        "three, opaque inside": [(0.3, "tan", 0.3), (0.6, "red", 0.3), (0.9, "white", 1)],
    }
    looks: dict[str, dict[str, Any]] = {"isosurface": {"mode": "isosurface", "isovalue": 0.3}}
    looks |= {name: {"mode": "surfaces", "surfaces": surfaces} for name, surfaces in shown.items()}
    looks["isosurface by curvature"] = {"mode": "isosurface", "isovalue": 0.3, "color_by": "mean curvature"}
    looks["isosurface with an outline"] = {"mode": "isosurface", "isovalue": 0.3, "outline": 2}
    camera = clvol.Camera.orbit(30, 20)
    for kind, data in (("smooth", lumps), ("noisy", lumps + noise)):
        taken: dict[str, list[float]] = {name: [] for name in looks}
        with clvol.Renderer(clvol.Volume(data.astype(np.float32)), "bspline3") as renderer:
            for _ in range(_ROUNDS):
                for name, look in looks.items():
                    begun = time.perf_counter()
                    renderer.render(camera, size=_SIZE, rays=1, **look)
                    taken[name].append(time.perf_counter() - begun)
        medians = {name: statistics.median(seconds[1:]) for name, seconds in taken.items()}
        print(f"{kind}: the isosurface takes {1e3 * medians['isosurface']:.1f} ms of 128 samples cubed, 512 by 512 pixels")
        for name, seconds in medians.items():
            print(f"    {name:28}{seconds / medians['isosurface']:6.2f}", flush=True)


if __name__ == "__main__":
    main()
