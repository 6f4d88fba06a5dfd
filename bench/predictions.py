"""What `analysis.predict` and `reports.advise` say of noisy phantoms, beside the errors measured against the noise-free truth.

    python -m bench.predictions [--only WORD] [--scan FILE ...] [--size N] [--axes N] [--seed N] [--markdown]

The truth is a function, so that it is known between samples. The noise: white; Poisson's; Poisson's and a camera's; proportional to
the value; uneven; blurred; of a magnitude (Rician); clipped; shared by the samples of a plane or a line.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

import clvol
from clvol.analysis import predict
from clvol.base.errors import ClvolWarning
from clvol.filter.table import as_filters
from clvol.noise import Noise
from clvol.reports.advice import ADVISED, Advice, advise, settled_once

Array: TypeAlias = NDArray[np.float64]
Truth: TypeAlias = Callable[[Array], Array]
"""Values at points in [-1, 1]³, shape (..., 3), x first; from 0 to 1."""
Disturbed: TypeAlias = Callable[[Array, np.random.Generator], Array]
"""Noisy samples of true samples."""

_MARGIN = 4  # samples without measured points at each side
KNOWN = 0.1
"""Of the standard deviation of the noise: smaller errors are not predicted."""


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
    return np.asarray(np.where((x - 0.4) ** 2 + (y - 0.1) ** 2 + (z + 0.1) ** 2 < 0.04, 1.0, total))


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
    """Counts and a camera's noise."""
    return lambda true, rng: rng.poisson(np.maximum(high * true + dark, 0)) + camera * rng.normal(size=true.shape)


def proportional(share: float, floor: float = 0.0) -> Disturbed:
    """σ is a share of the value."""
    return lambda true, rng: np.asarray(true + rng.normal(0, 1, true.shape) * np.hypot(share * true, floor))


def uneven(sigma: float, ratio: float) -> Disturbed:
    """σ grows along x, whatever the value."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        return true + sigma * ratio ** np.linspace(-0.5, 0.5, true.shape[-1]) * rng.normal(0, 1, true.shape)

    return add


def patchy(sigma: float, ratio: float) -> Disturbed:
    """A part of the volume with a larger σ."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        z = np.arange(true.shape[0]).reshape(-1, *[1] * (true.ndim - 1)) < true.shape[0] // 3
        return true + np.where(z, ratio * sigma, sigma) * rng.normal(0, 1, true.shape)

    return add


def blurred(sigma: float, width: float | tuple[float, ...]) -> Disturbed:
    """White noise after a Gaussian of `width` samples."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        widths = width if isinstance(width, float) else width[-true.ndim :]
        noise = ndimage.gaussian_filter(rng.normal(size=true.shape), widths, mode="wrap")
        return np.asarray(true + sigma * noise / noise.std())

    return add


def magnified(sigma: float) -> Disturbed:
    """White noise of half the resolution, as in a scan that was interpolated."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        noise = ndimage.zoom(rng.normal(size=[n // 2 + 1 for n in true.shape]), 2, order=1)[tuple(map(slice, true.shape))]
        return np.asarray(true + sigma * noise / noise.std())

    return add


def rician(sigma: float) -> Disturbed:
    """The magnitude of a complex value with white noise."""
    return lambda true, rng: np.asarray(np.hypot(true + rng.normal(0, sigma, true.shape), rng.normal(0, sigma, true.shape)))


def clipped(sigma: float, low: float = 0.0, high: float = math.inf, counts: float = 0.0) -> Disturbed:
    """Clipped, and with `counts` rounded to integers."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        noisy = (true + rng.normal(0, sigma, true.shape)).clip(low, high)
        return np.rint(counts * noisy).astype(np.int16) if counts else noisy

    return add


def impulses(sigma: float, share: float) -> Disturbed:
    """White noise, and a share of samples of any value."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        noisy = true + rng.normal(0, sigma, true.shape)
        return np.where(rng.random(true.shape) < share, rng.uniform(0, 1, true.shape), noisy)

    return add


def striped(sigma: float, axes: int, white: float = 0.02) -> Disturbed:
    """The same noise all along the last `axes` axes (lines or planes; at least one axis is left), and white noise."""

    def add(true: Array, rng: np.random.Generator) -> Array:
        along = min(axes, true.ndim - 1)
        shape = true.shape[: true.ndim - along] + (1,) * along
        return np.asarray(true + rng.normal(0, sigma, shape) + rng.normal(0, white, true.shape))

    return add


@dataclass(frozen=True)
class Noisy:
    """How samples get noise: from true values times `factor` plus `offset`; `sigma` is given where it is not the samples' error."""

    add: Disturbed
    factor: float = 1.0
    offset: float = 0.0
    sigma: float | None = None


NOISES = {
    "none": Noisy(white(0)),
    "white .02": Noisy(white(0.02)),
    "white .1": Noisy(white(0.1)),
    "white .3": Noisy(white(0.3)),
    "poisson 30 t + 3": Noisy(poisson(30, 3), 30, 3),
    "poisson 300 t + 3": Noisy(poisson(300, 3), 300, 3),
    "poisson 5 t + .5": Noisy(poisson(5, 0.5), 5, 0.5),
    "poisson 2 t + .1": Noisy(poisson(2, 0.1), 2, 0.1),
    "poisson 100 t + 10, camera 4": Noisy(poisson(100, 10, 4), 100, 10),
    "poisson 100 t": Noisy(poisson(100, 0), 100, 0),
    "proportional .2, .01": Noisy(proportional(0.2, 0.01)),
    "proportional .1": Noisy(proportional(0.1)),
    "uneven .1 × 4": Noisy(uneven(0.1, 4)),
    "uneven .05 × 16": Noisy(uneven(0.05, 16)),
    "patchy .05 × 4": Noisy(patchy(0.05, 4)),
    "blurred .1, .5": Noisy(blurred(0.1, 0.5)),
    "blurred .1, .7": Noisy(blurred(0.1, 0.7)),
    "blurred .1, 1": Noisy(blurred(0.1, 1.0)),
    "blurred .03, .7": Noisy(blurred(0.03, 0.7)),
    "blurred .3, .7": Noisy(blurred(0.3, 0.7)),
    "blurred .1, .6 along x": Noisy(blurred(0.1, (0, 0, 0.6))),
    "blurred .1, 1 in planes": Noisy(blurred(0.1, (0, 1, 1))),
    "magnified .1": Noisy(magnified(0.1)),
    "rician .05": Noisy(rician(0.05), sigma=0.05),
    "rician .1": Noisy(rician(0.1), sigma=0.1),
    "rician .2": Noisy(rician(0.2), sigma=0.2),
    "clipped .1 at 0": Noisy(clipped(0.1), sigma=0.1),
    "clipped .05 at 0 and .7": Noisy(clipped(0.05, 0, 0.7), sigma=0.05),
    "clipped .2 at 0, integers": Noisy(clipped(0.2, 0, math.inf, 200), 200, 0, sigma=40),
    "lines .1": Noisy(striped(0.1, 1)),
    "planes .05": Noisy(striped(0.05, 2)),
    "planes .02": Noisy(striped(0.02, 2)),
    "impulses .02, .02": Noisy(impulses(0.02, 0.02)),
}


# -- measurement -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Of one phantom: the true and the estimated noise, and the errors by filter.

    `spread` is the root mean square of the samples' errors, `true` the standard deviation of the noise.
    """

    structure: str
    noise: str
    true: float
    spread: float
    span: float
    found: Noise
    predicted: dict[str, float]
    measured: dict[str, float]
    advice: Advice

    @property
    def best(self) -> str:
        return min(self.measured, key=lambda name: self.measured[name])

    @property
    def loses(self) -> float:
        """The error of the advised filter over the least; errors below 10⁻⁴ of the range count as none."""
        if self.advice.filter is None:
            return math.nan
        seen = 1e-4 * self.span
        return max(self.measured[self.advice.filter], seen) / max(self.measured[self.best], seen)

    @property
    def factor(self) -> float:
        """The ratio of predicted and measured errors farthest from 1, of filters within twice the least error.

        To both errors is added `KNOWN` of the noise, which is as well as a spectrum can be known.
        """
        least, more = self.measured[self.best], KNOWN * self.spread
        near = [
            math.log(math.hypot(self.predicted[name], more) / math.hypot(error, more))
            for name, error in self.measured.items()
            if error < 2 * least and self.predicted[name]
        ]
        return math.exp(max(near, key=abs, default=math.nan))


def measure(structure: str, noise: str, truth: Truth, size: int = 64, seed: int = 0, points: int = 30_000, axes: int = 3) -> Case:
    """A phantom of `size` samples along each axis, its prediction, and errors at random points; of 2 axes, the slice z = 0."""
    how = NOISES[noise]
    rng = np.random.default_rng(seed)

    def of(places: Array) -> Array:
        return truth(np.pad(places, [(0, 0)] * (places.ndim - 1) + [(0, 3 - axes)]))

    true = of(np.stack(np.meshgrid(*[np.linspace(-1, 1, size)] * axes, indexing="ij")[::-1], -1))
    samples = how.add(true, rng)
    volume = clvol.Volume(samples if samples.dtype.kind == "i" else samples.astype(np.float32))
    spread = float(np.std(samples - (how.factor * true + how.offset)))
    at = rng.uniform(_MARGIN, size - 1 - _MARGIN, (points, axes))
    wanted = how.factor * of(at / (size - 1) * 2 - 1) + how.offset
    given = advise(volume)
    rows = settled_once(as_filters(ADVISED), volume)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClvolWarning)  # where there is no advice
        expected = given.expected or predict(volume, rows)
    found = {row.name: float(np.sqrt(np.mean((clvol.sample(volume, at.astype(np.float32), row) - wanted) ** 2))) for row in rows}
    predicted = {row.filter: row.rms for row in expected}
    sigma, span = spread if how.sigma is None else how.sigma, float(np.ptp(volume.data))
    return Case(structure, noise, sigma, spread, span, volume.noise, predicted, found, given)


TRUTHS: dict[str, Truth] = {"balls": balls, "Marschner-Lobb": waves, "regions": piecewise, "slopes": slopes}


def cases(only: str, scans: list[Path], size: int, seed: int, axes: int = 3) -> Iterator[Case]:
    truths = TRUTHS | {file.name.partition(".")[0]: of_scan(file, size) for file in scans}
    for structure, truth in truths.items():
        for noise in NOISES:
            if only in f"{structure}: {noise}":
                yield measure(structure, noise, truth, size, seed, axes=axes)


def line(case: Case) -> str:
    """All about a case, as text."""
    best, name, found = case.best, case.advice.filter, case.found
    says = f"{case.structure:15}{case.noise:30}σ {case.true:<8.3g} {found.kind:17}{found.sigma:<9.3g}gain {found.gain:<8.3g}"
    says += f"best {best:32}{case.measured[best]:<9.3g} predicted / measured {case.factor:5.2f}  "
    if name is None:
        return f"{says}silent: {case.advice.sentences[0].partition('noise, and ')[2]}"
    return f"{says}advised {name:32}{case.measured[name]:<9.3g}{f'WRONG, {case.loses:.2f} times' if case.loses > 1.08 else ''}"


def markdown(found: list[Case]) -> str:
    """A row for each noise: of the first structure, and the worst of all."""
    lines = [
        "| noise | found | σ true | σ found | predicted | measured | predicted / measured | advised | worst of all |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for noise in NOISES:
        rows = [case for case in found if case.noise == noise]
        if not rows:
            continue
        case = rows[0]
        name = case.advice.filter
        kind = case.found.kind + (f", gain {case.found.gain:.3g}" if case.found.gain else "")
        silent = sum(row.advice.filter is None for row in rows)
        worst = max((row.loses - 1 for row in rows if row.advice.filter is not None), default=0.0)
        of_all = ([f"{100 * worst:.1f} %"] if silent < len(rows) else []) + (
            [f"silent in {silent} of {len(rows)}"] if silent else []
        )
        shown = name or case.best
        numbers = (case.true, case.found.sigma, case.predicted[shown], case.measured[shown])
        texts = [f"{number:.3g}" for number in numbers]
        texts.append(f"{numbers[2] / numbers[3]:.2f}")
        if name is None:
            texts[2] = texts[4] = "–"
        lines.append(f"| {noise} | {kind} | {' | '.join(texts)} | {name or 'nothing'} | {', '.join(of_all)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", help="a word of the structure or the noise")
    parser.add_argument("--scan", type=Path, nargs="*", default=[], help="scans used as structures, low-passed")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--axes", type=int, default=3, choices=(2, 3))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--markdown", action="store_true", help="print the table of docs/how-to/noise.md")
    options = parser.parse_args()
    found = []
    for case in cases(options.only, options.scan, options.size, options.seed, options.axes):
        found.append(case)
        if not options.markdown:
            print(line(case), flush=True)
    if options.markdown:
        print(markdown(found))


if __name__ == "__main__":
    main()
