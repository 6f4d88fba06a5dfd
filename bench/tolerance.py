"""How well pictures keep the `tolerance` of "composite": random transfer functions, against steps of 1/64 voxel.

    python -m bench.tolerance [--quick] [--edges] [--record FILE] [COUNT]

Of each tolerance: the share of pictures within it, the worst ratio of an error to it, the usual ratio where the step is not the
longest, and steps. Volumes are smooth, noisy, or have edges; functions are points, bands and ramps of any opacity; views and light
are random too. Pictures have one ray a pixel, or more on edges. `--record` writes each function's results as a line of JSON, and a
later run with the same file goes on after the last.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import clvol
from clvol.march.tolerance import difference

TOLERANCES = 0.03, 0.01, 0.003
_EDGE = 28
_SIZE = 48, 48
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


def look(volume: clvol.Volume, number: int, edges: bool = False) -> dict[str, Any]:
    """What function `number` of a volume is drawn with, its view and light among it."""
    rng = np.random.default_rng(number)
    camera = clvol.Camera.orbit(float(rng.uniform(0, 360)), float(rng.uniform(-80, 80)))
    transfer = random_transfer(rng, *volume.value_range)
    shading = bool(rng.integers(2))
    return {"camera": camera, "size": _SIZE, "transfer": transfer, "shading": shading, "rays": "auto" if edges else 1}


def measured(renderer: clvol.Renderer, options: dict[str, Any]) -> list[tuple[float, float]]:
    """Error as a part of the tolerance, and step, of each tolerance."""
    fine, found = renderer.render(step=_FINEST, **options), []
    for tolerance in TOLERANCES:
        picture = renderer.render(tolerance=tolerance, **options)
        assert picture.recipe is not None
        found.append((difference(picture, fine, picture.recipe.scene.background) / tolerance, picture.recipe.step))
    return found


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("count", nargs="?", type=int, help=f"transfer functions, {_COUNT} by default")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK} of them")
    parser.add_argument("--edges", action="store_true", help='rays="auto": more on edges, which differ with the step')
    parser.add_argument("--record", type=Path, metavar="FILE", help="lines of JSON to add to, and to go on from")
    given = parser.parse_args()
    count = given.count or (_QUICK if given.quick else _COUNT)
    warnings.simplefilter("ignore", clvol.ClvolWarning)
    rows = [json.loads(line) for line in given.record.read_text().splitlines()] if given.record and given.record.exists() else []
    began, tried = time.process_time(), volumes()
    renderers = {name: clvol.Renderer(volume) for name, volume in tried.items()}
    for number in range(len(rows), count):
        name = list(tried)[number % len(tried)]
        rows.append([name, number, measured(renderers[name], look(tried[name], number, given.edges))])
        if given.record:
            with given.record.open("a") as record:
                record.write(json.dumps(rows[-1]) + "\n")
    print(f"{len(rows)} functions, {time.process_time() - began:.0f} s of processors")
    for k, tolerance in enumerate(TOLERANCES):
        found, step = np.array([row[2][k] for row in rows]).T
        usual = np.median(found[step < 1]) if (step < 1).any() else 0.0
        worst = rows[int(found.argmax())]
        print(
            f"tolerance {tolerance:5g}: {(found <= 1).sum()} of {len(found)} within it ({(found <= 1).mean():.3%}), worst "
            f"{found.max():.2f} times ({worst[0]}, {worst[1]}), usual {usual:.2f} times; step {np.median(step):.2g}, "
            f"{step.min():.2g} to {step.max():g}"
        )


if __name__ == "__main__":
    main()
