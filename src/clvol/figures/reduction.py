"""Fewer samples: a volume after decimation, after a Gaussian and decimation, and after least-squares reduction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from clvol import phantoms
from clvol.base.arrays import Array
from clvol.base.checks import number, require_room, several, whole
from clvol.base.progress import Progress, counted
from clvol.device import Device
from clvol.figures.inputs import zone_plate_image
from clvol.figures.style import LETTERS, Drawing, placed, show, styled, tiles
from clvol.spline.field import resample
from clvol.spline.reduce import AntiAliasing
from clvol.volume.volume import Volume

__all__ = ["FACTORS", "METHODS", "Case", "cases", "draw", "there_and_back"]

FACTORS = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0)
"""Reduction factors along each axis."""

METHODS: dict[str, AntiAliasing] = {"decimated": None, "Gaussian first": "gaussian", "least squares": "least-squares"}
"""By their names in the figure."""

_COLOURS = dict(zip(METHODS, ("#8a8a8a", "#e9a100", "#1769c2"), strict=True))
_DRAWN = 2.5  # reduction factor of the zone plate in the pictures
_ACROSS = 4  # pixels of the plate for each sample of the volumes
_NOISE = 0.1  # of the range
_SEED = 1995
_HIGH, _LEFT, _BETWEEN = 430, 100, 90  # pixels of the file: height of the plots, left margin, gap


class Case(NamedTuple):
    """An input of the reduction."""

    name: str
    volume: Volume
    truth: Array  # the samples without noise


def cases(samples: int) -> list[Case]:
    """Inputs with more detail than fewer samples can represent, with as much as half of them can, and with less plus noise."""
    plate = zone_plate_image(_ACROSS * samples, _ACROSS * samples)
    waves, ball = phantoms.marschner_lobb(samples), phantoms.sphere(samples)
    low, high = ball.value_range
    noise = np.random.default_rng(_SEED).normal(size=ball.shape) * _NOISE * (high - low)
    return [
        Case("zone plate", Volume(plate), plate),
        Case("Marschner–Lobb", waves, waves.data.astype(np.float64)),
        Case(f"ball, noise {_NOISE:g}", Volume(ball.data + noise, ball.spacing, ball.origin), ball.data.astype(np.float64)),
    ]


def there_and_back(volume: Volume, factor: float, method: AntiAliasing, device: Device | str | int | None = None) -> Array:
    """The volume reduced by `factor` along each axis and resampled back to its grid, by cubic splines."""
    shape = [max(1, round(n / factor)) for n in volume.shape]
    few = resample(volume, shape, boundary="reflect", anti_aliasing=method or False, device=device)
    return resample(few, like=volume, boundary="reflect", device=device).data.astype(np.float64)


def draw(
    factors: Sequence[float] = FACTORS,
    samples: int = 64,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """A zone plate reduced by 2.5 and enlarged again, by each method; below, RMS errors against the factor.

    Parameters
    ----------
    factors : sequence of float
        Reduction factors along each axis.
    samples : int
        Of the volumes along each axis; the zone plate has four times as many.
    device, progress
        As for `clvol.sample`.
    """
    samples = whole("samples", samples, 8)
    require_room("samples", samples**3, samples)
    given = [number("each factor", f, minimum=1) for f in several("factors", factors, "numbers of at least 1")]
    known = cases(samples)
    numbers: list[dict[str, Any]] = []
    for case in counted(known, progress):
        low, high = float(case.truth.min()), float(case.truth.max())
        for name, method in METHODS.items():
            for factor in given:
                error = there_and_back(case.volume, factor, method, device) - case.truth
                rms = float(np.sqrt(np.mean(error**2))) / (high - low)
                numbers.append({"input": case.name, "method": name, "factor": factor, "rms": rms})
    with styled():
        figure = _drawn(known, given, numbers, device)
    lines = []
    for case in known:
        for factor in given:
            mine = {n["method"]: n["rms"] for n in numbers if (n["input"], n["factor"]) == (case.name, factor)}
            errors = ", ".join(f"{name} {rms:.4f}" for name, rms in mine.items())
            lines.append(f"{case.name}, {factor:g} times fewer samples: RMS error {errors}")
    return Drawing(figure, numbers, lines)


def _drawn(
    known: Sequence[Case], factors: Sequence[float], numbers: Sequence[dict[str, Any]], device: Device | str | int | None
) -> Any:
    plate = known[0]
    size = plate.volume.size
    figure, panels, _ = tiles(1, len(METHODS) + 1, (size[0], size[1]), above=1, below=1 + -(-_HIGH // 27))
    show(
        panels[0, 0],
        plate.truth,
        f"{LETTERS[0]})  zone plate, {size[0]}²",
        f"its mean alone: RMS {plate.truth.std():.3f}",
        vmin=0,
        vmax=1,
    )
    for i, (name, method) in enumerate(METHODS.items(), 1):
        back = there_and_back(plate.volume, _DRAWN, method, device)
        rms = float(np.sqrt(np.mean((back - plate.truth) ** 2)))
        heading = f"{LETTERS[i]})  {name}, {round(size[0] / _DRAWN)}²"
        show(panels[0, i], back, heading, f"enlarged again: RMS {rms:.3f}", vmin=0, vmax=1)
    width, height = (round(figure.dpi * inches) for inches in figure.get_size_inches())
    share = (width - _LEFT) // len(known)
    for i, case in enumerate(known):
        axes = placed(figure, _LEFT + i * share, height - _HIGH + 60, share - _BETWEEN, _HIGH - 140)
        for name in METHODS:
            errors = [n["rms"] for n in numbers if (n["input"], n["method"]) == (case.name, name)]
            axes.plot(factors, errors, "o-", color=_COLOURS[name], markersize=4, label=name)
        axes.set_ylim(bottom=0)
        axes.set(xlabel="times fewer samples", ylabel="RMS error, of the range" if i == 0 else "")
        axes.set_title(case.name)
        axes.set_xticks([1, 2, 3, 4] if max(factors) <= 4 else sorted(set(factors)))
        if i == 0:
            axes.legend(loc="lower right", fontsize=8, handlelength=1.2, borderaxespad=0.2)
    return figure
