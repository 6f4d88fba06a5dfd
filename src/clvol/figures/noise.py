"""Noise: errors of values and normals against its level, from interpolation to approximation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol import phantoms
from clvol.analysis import frequency_response, impulse_response, variance_gain
from clvol.analysis.angle import mean_angle
from clvol.base.arrays import Array
from clvol.base.checks import whole
from clvol.base.progress import Progress, counted, part_of
from clvol.device import Device
from clvol.figures.panels import ISOVALUE
from clvol.figures.style import GREY, INK, Drawing, colour, new_figure, plain_digits, styled, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters
from clvol.spline.field import Field
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume

__all__ = ["BETWEEN", "FILTERS", "LEVELS", "Case", "cases", "draw", "measure"]

LEVELS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3)
"""Standard deviations of the noise, as shares of the data's range."""

BETWEEN = ("bspline3", "bspline3(0.01)", "bspline3(0.1)", "bspline3(1)", "bspline3-approx")
"""Cubic B-splines from interpolation to approximation, and past it."""

FILTERS = ("nearest", "linear", "mitchell", "catmull-rom", "hybrid", *BETWEEN, "bspline3(auto)")
"""The compared filters."""

_WITHIN = 0.8  # share of the faces' distance from the centre
_RADIUS = 0.75  # of the sphere
_SPAN = 1e-4  # of the largest error; smaller ones are not shown
_SURFACE = 8000  # places on the surface at which normals are compared
_NEWTON = 8
_SEED = 1993


@dataclass(frozen=True)
class Case:
    """A phantom whose values and normals are known."""

    name: str
    volume: Volume
    points: Array  # random ones, (N, 3)
    values: Array  # the truth there, (N,)
    surface: Array  # positions on it, (M, 3)
    normals: Array  # the true gradients there, (M, 3)


def cases(samples: int = 41, points: int = 20_000) -> list[Case]:
    """A sphere in a smooth field, and the Marschner-Lobb function: no fine detail, and as much as the samples can represent."""
    random = np.random.default_rng(_SEED)
    within = random.uniform(-_WITHIN, _WITHIN, (points, 3))
    ball = random.normal(size=(_SURFACE, 3))
    ball *= _RADIUS / np.linalg.norm(ball, axis=1, keepdims=True)
    field = 0.5 + (_RADIUS**2 - (within**2).sum(-1)) / (2 * _RADIUS)  # that of `phantoms.sphere`
    waves = random.uniform(-_WITHIN, _WITHIN, (_SURFACE, 3))
    waves[:, 2] = 0
    for _ in range(_NEWTON):  # along z the function falls from 1 to 0, and nearly straight where it is ISOVALUE
        slope = phantoms.marschner_lobb_gradient(waves)[:, 2]
        waves[:, 2] -= (phantoms.marschner_lobb_function(waves) - ISOVALUE) / slope
    return [
        Case("sphere", phantoms.sphere(samples, _RADIUS), within, field, ball, -ball),
        Case(
            "Marschner–Lobb",
            phantoms.marschner_lobb(samples),
            within,
            phantoms.marschner_lobb_function(within),
            waves,
            phantoms.marschner_lobb_gradient(waves),
        ),
    ]


def measure(
    case: Case,
    filters: Sequence[Filter],
    levels: Sequence[float] = LEVELS,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Errors of each filter at each level of noise, which is the same noise at all levels except for its scale.

    "rms" is a share of the data's range, "angle" the `mean_angle` on the surface.
    """
    low, high = case.volume.value_range
    noise = np.random.default_rng(_SEED + 1).normal(size=case.volume.shape)
    numbers = []
    for level in counted(levels, progress):
        noisy = Volume(case.volume.data + level * (high - low) * noise, case.volume.spacing, case.volume.origin)
        for row in filters:
            own = settled(row, noisy)
            with Field(noisy, own, device=device) as field:
                error = field(case.points) - case.values
                angle = None
                if own.has_gradient:
                    angle = mean_angle(field.gradient(case.surface), case.normals)
            numbers.append(
                {
                    "input": case.name,
                    "noise": level,
                    "filter": row.name,
                    "smoothing": own.smoothing,
                    "rms": float(np.sqrt(np.mean(error**2))) / (high - low),
                    "angle": angle,
                }
            )
    return numbers


def draw(
    filters: Sequence[str | Filter] = FILTERS,
    samples: int = 41,
    points: int = 20_000,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Errors of values (above) and normals (below) against the noise of two phantoms, and responses of the smoothing splines.

    The bar at the bottom of each plot has the colour of the filter with the smallest error.

    Parameters
    ----------
    filters : sequence of str or Filter
        A curve each.
    samples : int
        Of the phantoms along each axis.
    points : int
        Random positions at which values are compared.
    device, progress
        As for `clvol.sample`.
    """
    rows, samples, points = as_filters(filters), whole("samples", samples, 8), whole("points", points, 1)
    known = cases(samples, points)
    numbers: list[dict[str, Any]] = []
    for i, case in enumerate(known):
        numbers += measure(case, rows, LEVELS, device, part_of(progress, i / len(known), (i + 1) / len(known)))
    with styled():
        figure = new_figure(13.2, 7.6)
        panels = figure.subplots(2, 3, width_ratios=(1, 1, 0.9))
        for column, case in enumerate(known):
            mine = [n for n in numbers if n["input"] == case.name]
            _curves(panels[0, column], mine, "rms", f"{case.name}: RMS error")
            _curves(panels[1, column], mine, "angle", f"{case.name}: normals, mean angle")
        panels[0, 0].set_ylabel("share of the range")
        panels[1, 0].set_ylabel("degrees")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6)
        _responses(*panels[:, 2])
    gains = {row.name: variance_gain(row) for row in rows if row.settled and not isinstance(row.smoothing, tuple)}
    lines = [f"{title(name)}: keeps {g:.3f} of the noise's variance along an axis, {g**3:.3f} in 3-D" for name, g in gains.items()]
    for case in known:
        for level in LEVELS:
            mine = [n for n in numbers if (n["input"], n["noise"]) == (case.name, level)]
            best = min(mine, key=lambda n: n["rms"])
            lines.append(
                f"{case.name}, noise {level:g}: least RMS error with {title(best['filter'])}, {best['rms']:.2g} of the range"
            )
    kept: list[dict[str, Any]] = [{"filter": name, "variance_gain": gain} for name, gain in gains.items()]
    return Drawing(figure, numbers + kept, lines)


def _curves(axes: Any, numbers: Sequence[dict[str, Any]], key: str, heading: str) -> None:
    """A curve for each filter; levels are equally spaced, and the first is no noise."""
    names = list(dict.fromkeys(n["filter"] for n in numbers if n[key] is not None))
    errors = {name: [n[key] for n in numbers if n["filter"] == name] for name in names}
    for name in names:
        bold = name.endswith("(auto)")
        axes.plot(
            errors[name],
            "-" if "(" not in name or bold else "--",
            color=colour(name),
            label=title(name),
            linewidth=3 if bold else 1.5,
            zorder=3 if bold else 2,
        )
    most = max(v for each in errors.values() for v in each)
    least = min(v for each in errors.values() for v in each if v > most * _SPAN)
    axes.set_yscale("log")
    axes.set_ylim(least / 2, most * 1.3)
    plain_digits(axes.yaxis, (1,) if most > 100 * least else (1, 2, 5))
    for level in range(len(LEVELS)):
        best = min(names, key=lambda name: errors[name][level])
        axes.hlines(0.012, level - 0.5, level + 0.5, color=colour(best), linewidth=7, transform=axes.get_xaxis_transform())
    axes.set_xticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
    axes.set_xlim(-0.5, len(LEVELS) - 0.5)
    axes.set_xlabel("noise, as a share of the range")
    axes.set_title(heading)


def _responses(above: Any, below: Any) -> None:
    omega, x = np.linspace(0, 2 * np.pi, 401), np.linspace(-4, 4, 801)
    for name in BETWEEN:
        look = {"color": colour(name), "linestyle": "--" if "(" in name else "-", "linewidth": 1.5}
        above.plot(omega / np.pi, frequency_response(name, omega), **look)
        below.plot(x, impulse_response(name, x), **look)
    above.plot([0, 1, 1, 2], [1, 1, 0, 0], color=GREY, linewidth=0.8, zorder=1)
    above.set(xlabel="frequency, π = Nyquist", xlim=(0, 2))
    above.set_title("frequency responses, from λ = 0 to 1")
    below.set(xlabel="samples", xlim=(-4, 4))
    below.axhline(0, color=INK, linewidth=0.6)
    below.set_title("impulse responses")
