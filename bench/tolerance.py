"""How well pictures keep the `tolerance` of "composite": random transfer functions, against steps of 1/64 voxel.

    python -m bench.tolerance [--quick] [--edges] [COUNT]

Of each tolerance: the share of pictures within it, the worst ratio of an error to it, the usual ratio where the step is not the
longest, and steps. Volumes are smooth, noisy, or have edges; functions are points, bands and ramps of any opacity; views and light
are random too. Pictures have one ray a pixel, or more on edges.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import numpy as np

import clvol
from clvol.march.tolerance import difference

TOLERANCES = 0.03, 0.01, 0.003
_EDGE = 28
_SIZE = 64, 64
_COUNT, _QUICK = 3000, 60
_FINEST = 1 / 64


def volumes() -> dict[str, clvol.Volume]:
    """A smooth one, a noisy one, and one with edges."""
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, _EDGE, dtype=np.float32)] * 3, indexing="ij")
    around = np.sqrt(x * x + y * y + z * z)
    noise = np.random.default_rng(1).standard_normal(x.shape, np.float32)
    edges = 0.6 * (around < 0.7) + 0.4 * ((np.abs(x) < 0.3) & (np.abs(y) < 0.5))
    return {
        "smooth": clvol.phantoms.marschner_lobb(_EDGE),
        "noisy": clvol.Volume(np.exp(-3 * around**2) + np.float32(0.05) * noise),
        "edges": clvol.Volume(edges.astype(np.float32)),
    }


def random_transfer(rng: np.random.Generator, low: float, high: float) -> clvol.TransferFunction:
    """A transfer function for values from `low` to `high`."""
    most, wide = 10 ** rng.uniform(-1.5, 0), (high - low) * 10 ** rng.uniform(-2.5, -0.7)
    seen: list[tuple[float, float]] = []
    match rng.integers(3):
        case 0:
            values = np.sort(rng.uniform(low, high, rng.integers(2, 9)))
            some = most * rng.uniform(0, 1, len(values)) * (rng.uniform(size=len(values)) < 0.6)
            some[rng.integers(len(values))] = most
            seen = list(zip(values.tolist(), some.tolist(), strict=True))
        case 1:
            for middle in np.sort(rng.uniform(low, high, rng.integers(1, 5))).tolist():
                if not seen or middle - wide > seen[-1][0]:
                    seen += [(middle - wide, 0.0), (middle, most), (middle + wide, 0.0)]
        case _:
            first = rng.uniform(low, high)
            seen = [(first, 0.0), (first + wide, most)]
    values = np.sort(rng.uniform(low, high, rng.integers(2, 6)))
    colors = [(value, tuple(rng.uniform(0, 1, 3).tolist())) for value in values.tolist()]
    return clvol.TransferFunction(tuple(colors), tuple(seen))


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("count", nargs="?", type=int, help=f"transfer functions, {_COUNT} by default")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK} of them")
    parser.add_argument("--edges", action="store_true", help='rays="auto": more on edges, which differ with the step')
    given = parser.parse_args()
    count = given.count or (_QUICK if given.quick else _COUNT)
    warnings.simplefilter("ignore", clvol.ClvolWarning)
    ratios: dict[float, list[float]] = {tolerance: [] for tolerance in TOLERANCES}
    steps: dict[float, list[float]] = {tolerance: [] for tolerance in TOLERANCES}
    began = time.process_time()
    for number, (name, volume) in enumerate(volumes().items()):
        rng, own = np.random.default_rng(number), count // 3 + (number < count % 3)
        with clvol.Renderer(volume) as renderer:
            for _ in range(own):
                camera = clvol.Camera.orbit(float(rng.uniform(0, 360)), float(rng.uniform(-80, 80)))
                look: dict[str, Any] = {"transfer": random_transfer(rng, *volume.value_range), "shading": bool(rng.integers(2))}
                look["rays"] = "auto" if given.edges else 1
                fine = renderer.render(camera, size=_SIZE, step=_FINEST, **look)
                for tolerance in TOLERANCES:
                    picture = renderer.render(camera, size=_SIZE, tolerance=tolerance, **look)
                    assert picture.recipe is not None
                    ratios[tolerance].append(difference(picture, fine, picture.recipe.scene.background) / tolerance)
                    steps[tolerance].append(picture.recipe.step)
        print(f"{name}: {own} functions, {time.process_time() - began:.0f} s of processors so far", flush=True)
    for tolerance in TOLERANCES:
        found, step = np.array(ratios[tolerance]), np.array(steps[tolerance])
        usual = np.median(found[step < 1]) if (step < 1).any() else 0.0
        print(
            f"tolerance {tolerance:5g}: {(found <= 1).mean():8.3%} of {len(found)} within it, worst {found.max():.2f} times, "
            f"usual {usual:.2f} times; step {np.median(step):.2g}, {step.min():.2g} to {step.max():g}"
        )


if __name__ == "__main__":
    main()
