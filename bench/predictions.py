"""What `analysis.predict` and `reports.advise` say of noisy phantoms, beside the errors measured against the noise-free truth.

    python -m bench.predictions [--only WORD] [--scan FILE ...] [--size N] [--markdown]

The truth is a function, so that it is known between samples. The noise: white; Poisson's; Poisson's and a camera's; proportional to
the value; uneven; blurred; of a magnitude (Rician); clipped.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

import clvol
from clvol import reference
from clvol.analysis import predict
from clvol.noise import Noise
from clvol.reports.advice import ADVISED, Advice, advise, settled_once
from clvol.filter.table import as_filters

Array: TypeAlias = NDArray[np.float64]
Truth: TypeAlias = Callable[[Array], Array]
"""Values at points in [-1, 1]³, shape (..., 3), x first; from 0 to 1."""
Disturbed: TypeAlias = Callable[[Array, np.random.Generator], Array]
"""Noisy samples of true samples."""

_MARGIN = 4  # samples without measured points at each side
_KNOWN = 0.1  # of the standard deviation of the noise; smaller errors are not predicted
_POINTS = 30_000


# -- truths ----------------------------------------------------------------------------------------------------------


def balls(points: Array, count: int = 12, softness: float = 0.05) -> Array:
    """Soft balls."""
    rng = np.random.default_rng(5)
    centres, radii, heights = rng.uniform(-0.7, 0.7, (count, 3)), rng.uniform(0.15, 0.35, count), rng.uniform(0.3, 1, count)
    total = np.zeros(points.shape[:-1])
    for centre, radius, height in zip(centres, radii, heights, strict=True):
        distance = np.sqrt(((points - centre) ** 2).sum(-1))
        total = np.maximum(total, height * 0.5 * special.erfc((distance - radius) / softness))
    return total


def waves(points: Array) -> Array:
    """Marschner and Lobb's test signal."""
    return np.asarray(clvol.phantoms.marschner_lobb_function(points))


def piecewise(points: Array) -> Array:
    """Regions of one value each: nested ellipsoids and boxes."""
    x, y, z = np.moveaxis(points, -1, 0)
    total = np.where(x**2 / 0.8 + y**2 / 0.6 + z**2 / 0.7 < 1, 0.4, 0.0)
    total = np.where((x - 0.1) ** 2 + (y / 0.8) ** 2 + (z / 0.9) ** 2 < 0.3, 0.8, total)
    total = np.where((np.abs(x + 0.3) < 0.21) & (np.abs(y) < 0.33) & (np.abs(z - 0.1) < 0.4), 0.2, total)
    return np.where((x - 0.4) ** 2 + (y - 0.1) ** 2 + (z + 0.1) ** 2 < 0.04, 1.0, total)


def slopes(points: Array) -> Array:
    """A smooth landscape without flat parts."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.asarray(0.5 + 0.2 * np.sin(3 * x + 1) * np.cos(2.5 * y) + 0.3 * np.sin(2 * z - x))


def of_scan(file: Path, size: int) -> Truth:
    """A scan made smooth: the middle of it at half the resolution, between its samples a quintic spline."""
    scan = clvol.read(file)
    data = scan.data.astype(np.float64)
    middle = tuple(slice(max(0, (n - 2 * size) // 2), max(0, (n - 2 * size) // 2) + 2 * size) for n in data.shape)
    part = ndimage.gaussian_filter(data, 1.4)[middle]
    low, high = np.quantile(part, (0.001, 0.999))
    part = (part - low) / (high - low)
    fine = clvol.Volume(part)

    def at(points: Array) -> Array:
        index = (points + 1) / 2 * (np.array(part.shape[::-1]) - 1)
        return np.asarray(clvol.sample(fine, index.astype(np.float32), "bspline5")).astype(np.float64)

    return at


# -- noise -----------------------------------------------------------------------------------------------------------


def white(sigma: float) -> Disturbed:
    return lambda true, rng: true + rng.normal(0, sigma, true.shape)


def poisson(high: float, dark: float, camera: float = 0.0) -> Disturbed:
    return lambda true, rng: rng.poisson(np.maximum(high * true + dark, 0)) + (rng.normal(0, camera, true.shape) if camera else 0.0)


def proportional(share: float, floor: float = 0.0) -> Disturbed:
    return lambda true, rng: true + rng.normal(0, 1, true.shape) * np.hypot(share * true, floor)


def uneven(sigma: float, ratio: float) -> Disturbed:
    """σ grows along x, whatever the value."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        return true + sigma * ratio ** np.linspace(-0.5, 0.5, true.shape[-1]) * rng.normal(0, 1, true.shape)

    return add


def patchy(sigma: float, ratio: float) -> Disturbed:
    """A part of the volume with a larger σ."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        z = np.arange(true.shape[0])[:, None, None] < true.shape[0] // 3
        return true + np.where(z, ratio * sigma, sigma) * rng.normal(0, 1, true.shape)

    return add


def blurred(sigma: float, width: float | tuple[float, ...]) -> Disturbed:
    def add(true: Array, rng: np.random.Generator) -> Array:
        noise = ndimage.gaussian_filter(rng.normal(size=true.shape), width, mode="wrap")
        return true + sigma * noise / noise.std()

    return add


def magnified(sigma: float) -> Disturbed:
    """White noise of half the resolution, as in a scan that was interpolated."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        noise = ndimage.zoom(rng.normal(size=[n // 2 + 1 for n in true.shape]), 2, order=1)[tuple(map(slice, true.shape))]
        return true + sigma * noise / noise.std()

    return add


def rician(sigma: float) -> Disturbed:
    return lambda true, rng: np.hypot(true + rng.normal(0, sigma, true.shape), rng.normal(0, sigma, true.shape))


def clipped(sigma: float, low: float = 0.0, high: float = math.inf, counts: float = 0.0) -> Disturbed:
    """Clipped, and with `counts` rounded to integers."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        noisy = (true + rng.normal(0, sigma, true.shape)).clip(low, high)
        return np.rint(counts * noisy).astype(np.int16) if counts else noisy

    return add


def impulses(sigma: float, share: float) -> Disturbed:
    def add(true: Array, rng: np.random.Generator) -> Array:
        noisy = true + rng.normal(0, sigma, true.shape)
        return np.where(rng.random(true.shape) < share, rng.uniform(0, 1, true.shape), noisy)

    return add


NOISES: dict[str, tuple[Disturbed, float, float]] = {
    # with the factor and the offset of the true values
    "none": (white(0), 1, 0),
    "white .02": (white(0.02), 1, 0),
    "white .1": (white(0.1), 1, 0),
    "white .3": (white(0.3), 1, 0),
    "poisson 30 t + 3": (poisson(30, 3), 30, 3),
    "poisson 300 t + 3": (poisson(300, 3), 300, 3),
    "poisson 5 t + .5": (poisson(5, 0.5), 5, 0.5),
    "poisson 100 t + 10, camera 4": (poisson(100, 10, 4), 100, 10),
    "poisson 100 t": (poisson(100, 0), 100, 0),
    "proportional .2, .01": (proportional(0.2, 0.01), 1, 0),
    "proportional .1": (proportional(0.1), 1, 0),
    "uneven .1 × 4": (uneven(0.1, 4), 1, 0),
    "uneven .05 × 16": (uneven(0.05, 16), 1, 0),
    "patchy .05 × 4": (patchy(0.05, 4), 1, 0),
    "blurred .1, .5": (blurred(0.1, 0.5), 1, 0),
    "blurred .1, .7": (blurred(0.1, 0.7), 1, 0),
    "blurred .1, 1": (blurred(0.1, 1.0), 1, 0),
    "blurred .03, .7": (blurred(0.03, 0.7), 1, 0),
    "blurred .3, .7": (blurred(0.3, 0.7), 1, 0),
    "blurred .1, .6 along x": (blurred(0.1, (0, 0, 0.6)), 1, 0),
    "blurred .1, 1 in planes": (blurred(0.1, (0, 1, 1)), 1, 0),
    "magnified .1": (magnified(0.1), 1, 0),
    "rician .05": (rician(0.05), 1, 0),
    "rician .1": (rician(0.1), 1, 0),
    "rician .2": (rician(0.2), 1, 0),
    "clipped .1 at 0": (clipped(0.1), 1, 0),
    "clipped .05 at 0 and .7": (clipped(0.05, 0, 0.7), 1, 0),
    "clipped .2 at 0, integers": (clipped(0.2, 0, math.inf, 200), 200, 0),
    "impulses .02, .02": (impulses(0.02, 0.02), 1, 0),
}


# -- measurement -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    structure: str
    noise: str
    true: float
    found: Noise
    predicted: dict[str, float]
    measured: dict[str, float]
    advice: Advice
    seconds: float

    @property
    def loses(self) -> float:
        """The error of the advised filter over the least."""
        return self.measured[self.advice.filter] / min(self.measured.values()) if self.advice.filter else math.nan

    @property
    def factor(self) -> float:
        """The largest ratio of predicted and measured errors, of filters within twice the least; both with `_KNOWN` of the noise."""
        least, more = min(self.measured.values()), _KNOWN * self.true
        near = [
            math.log(math.hypot(self.predicted[f], more) / math.hypot(m, more))
            for f, m in self.measured.items()
            if m < 2 * least and self.predicted.get(f)
        ]
        return math.exp(max(near, key=abs, default=math.nan))


def measure(structure: str, noise: str, truth: Truth, size: int = 64, seed: int = 0) -> Case:
    add, factor, offset = NOISES[noise]
    rng = np.random.default_rng(seed)
    axis = np.linspace(-1, 1, size)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")[::-1], -1)
    true = truth(grid)
    volume = clvol.Volume(add(true, rng).astype(np.float32) if noise != "clipped .2 at 0, integers" else add(true, rng))
    points = rng.uniform(_MARGIN, size - 1 - _MARGIN, (_POINTS, 3))
    wanted = factor * truth(points / (size - 1) * 2 - 1) + offset
    whole = factor * true + offset
    spread = float(np.std(volume.data - whole))
    start = time.perf_counter()
    given = advise(volume)
    seconds = time.perf_counter() - start
    rows = settled_once(as_filters(ADVISED), volume)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = given.expected or predict(volume, rows)
    found = {}
    for row in rows:
        values = clvol.sample(volume, points.astype(np.float32), row)
        found[row.name] = float(np.sqrt(np.mean((values - wanted) ** 2)))
    return Case(structure, noise, spread, volume.noise, {r.filter: r.rms for r in expected}, found, given, seconds)


def cases(only: str, scans: list[Path], size: int, seed: int) -> Iterator[Case]:
    truths: dict[str, Truth] = {"balls": balls, "Marschner-Lobb": waves, "piecewise": piecewise, "slopes": slopes}
    truths |= {file.name.partition(".")[0]: of_scan(file, size) for file in scans}
    for structure, truth in truths.items():
        for noise in NOISES:
            if only in f"{structure}: {noise}":
                yield measure(structure, noise, truth, size, seed)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="")
    parser.add_argument("--scan", type=Path, nargs="*", default=[])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for case in cases(options.only, options.scan, options.size, options.seed):
        best = min(case.measured, key=lambda name: case.measured[name])
        name = case.advice.filter
        print(
            f"{case.structure:15}{case.noise:30}true {case.true:8.3g} found {case.found.kind:17}{case.found.sigma:8.3g} "
            f"gain {case.found.gain:6.3g} best {best:24}{case.measured[best]:8.3g} "
            + (
                f"advice {name:24}{case.measured[name]:8.3g} predicted {case.predicted[name]:8.3g} ×{case.factor:5.2f} loses {100 * case.loses - 100:5.1f} %"
                f"{'  WRONG' if case.loses > 1.08 else ''}{'  FAR' if not 1 / 1.5 < case.factor < 1.5 else ''}"
                if name
                else f"silent ×{case.factor:5.2f}: {case.advice.sentences[0]}"
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
