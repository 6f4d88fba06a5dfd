"""What cuts cost: pictures with planes, corners and caps, beside the plain picture in the same run.

    python -m bench.cuts

Ratios of times, medians over rounds that alternate between both pictures. `grazed`: a plane or a corner that cuts
away one hundredth of the volume, so that rays are cut in vain; `half` and `octant`: through the middle,
facing the viewer. Promised: at most 1.1 for a cut, 1.2 with its faces. An octant that is cut away leaves two parts of some rays.
"""

from __future__ import annotations

import math
import statistics
import time
from typing import Any

import numpy as np

import clvol

_SIZE = 512, 512
_ROUNDS = 9


def scene(edge: int = 192) -> clvol.Volume:
    """A ball with lumps in a noisy ground."""
    z, y, x = np.mgrid[-1 : 1 : edge * 1j, -1 : 1 : edge * 1j, -1 : 1 : edge * 1j]
    radius = np.sqrt(x * x + y * y + z * z)
    lumps = np.sin(9 * x) * np.sin(8 * y + 1) * np.sin(10 * z)
    data = 1000 * (radius < 0.85 + 0.03 * lumps) + 300 * lumps * (radius < 0.6)
    data += np.random.default_rng(0).normal(0, 30, data.shape)
    return clvol.Volume(data.astype(np.float32)).gaussian(1)


def main() -> None:
    """Measure, and print a table."""
    volume = scene()
    camera = clvol.Camera.orbit(40, 30)
    towards = -np.array(camera.view(volume).forward)
    center, inf = volume.center, math.inf
    far = center + 0.45 * np.array(volume.size) * np.sign(towards)
    signs = np.sign(towards)
    octant = [np.where(signs > 0, center, -inf), np.where(signs > 0, inf, center)]
    corner = [np.where(signs > 0, far, -inf), np.where(signs > 0, inf, far)]
    cuts: dict[str, Any] = {
        "plane, grazed": clvol.Plane(towards, center + 0.8 * volume.radius * towards),
        "plane, half": clvol.Plane(towards, center),
        "3 planes, half": [
            clvol.Plane(towards, center),
            *(clvol.Plane(axis, center + 0.4 * volume.size[0]) for axis in np.eye(3)[:2]),
        ],
        "corner, grazed": clvol.Corner(*corner),
        "octant": clvol.Corner(*octant),
    }
    modes: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
        "composite": ("composite", {}, {"cap": False}),
        "composite with slices": ("composite", {}, {}),
        "isosurface": ("isosurface", {}, {}),
        "isosurface with caps": ("isosurface", {}, {"cap": True}),
        "mip": ("mip", {}, {}),
        "mean": ("mean", {}, {}),
    }
    with clvol.Renderer(volume) as renderer:
        print(f"{'':24}", *(f"{name:>16}" for name in cuts))
        for name, (mode, plain, more) in modes.items():
            ratios = []
            for cut in cuts.values():
                pair = ({"mode": mode, **plain}, {"mode": mode, "clip": cut, **plain, **more})
                seconds: tuple[list[float], list[float]] = ([], [])
                for _ in range(_ROUNDS):
                    for options, taken in zip(pair, seconds, strict=True):
                        begun = time.perf_counter()
                        renderer.render(camera, size=_SIZE, rays=1, **options)
                        taken.append(time.perf_counter() - begun)
                ratios.append(statistics.median(seconds[1][1:]) / statistics.median(seconds[0][1:]))
            print(f"{name:24}", *(f"{ratio:16.2f}" for ratio in ratios), flush=True)


if __name__ == "__main__":
    main()
