"""What several media cost: pictures of two and of four, beside that of one in the same run.

    python -m bench.media

Ratios of times, medians over rounds that alternate. "grid": another medium of the same grid; "coarse": one of a grid with voxels
twice as large, along the same axes; "turned": one of a grid turned by 30°. Aimed at: four channels of one grid at most 2.5, a
second grid 2.2. "cut": "grid", whose first medium alone is cut open by a plane, relative to "grid" (at most 1.1).
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

import clvol
from clvol import Medium, Scene, TransferFunction, Volume

_SIZE = 512, 512
_ROUNDS = 9
_EDGE = 192


def channel(seed: int, color: str) -> Medium:
    """Soft spots."""
    spots = np.zeros((_EDGE,) * 3, np.float32)
    spots[tuple(np.random.default_rng(seed).integers(20, _EDGE - 20, (60, 3)).T)] = 1
    data = gaussian_filter(spots, 6)
    return Medium(
        Volume(data / data.max()),
        TransferFunction.ramp((0, 0), color).with_opacity([(0.25, 0), (0.8, 0.4)]),
        filter=clvol.filters()["bspline3"],
    )


def main() -> None:
    """Measure, and print a table."""
    channels = [channel(seed, color) for seed, color in enumerate(("red", "lime", "blue", "yellow"))]
    first, second = channels[0], channels[1]
    assert second.transfer is not None
    coarse = Volume(second.volume.data[::2, ::2, ::2], (2, 2, 2), (0.5, 0.5, 0.5))
    cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turned = Volume(second.volume.data, (1, 1, 1), (40, -30, 0), np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]))
    scenes = {
        "one": [first],
        "grid": channels[:2],
        "cut": [replace(first, clip=clvol.Plane((0, 0, 1), first.volume.center)), second],
        "four": channels,
        "coarse": [first, Medium(coarse, second.transfer, filter=clvol.filters()["bspline3"])],
        "turned": [first, Medium(turned, second.transfer, filter=clvol.filters()["bspline3"])],
    }
    camera = clvol.Camera.orbit(target=list(first.volume.center), radius=0.8 * first.volume.radius)
    renderers = {name: clvol.Renderer(Scene(tuple(media))) for name, media in scenes.items()}
    seconds: dict[str, list[float]] = {name: [] for name in scenes}
    for _ in range(_ROUNDS):
        for name, renderer in renderers.items():
            begun = time.perf_counter()
            renderer.render(camera, size=_SIZE, rays=1)
            seconds[name].append(time.perf_counter() - begun)
    for name, taken in seconds.items():
        plain = statistics.median(seconds["grid" if name == "cut" else "one"][1:])
        print(f"{name:8} {1000 * statistics.median(taken[1:]):8.1f} ms {statistics.median(taken[1:]) / plain:8.2f}")


if __name__ == "__main__":
    main()
