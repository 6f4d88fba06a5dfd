"""Error against sampling rate: on log-log axes a line with the order of approximation as slope, beside the theory's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol import analysis
from clvol.base.arrays import Array
from clvol.base.checks import several, whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress, counted
from clvol.figures.style import GREY, Drawing, colour, label_ends, new_figure, styled
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters

__all__ = ["draw"]

_SHOWN = (
    "nearest",
    "linear",
    "bspline3-approx",
    "mitchell",
    "catmull-rom",
    "bspline2",
    "bspline3",
    "omoms3",
    "moms3",
    "bspline4",
    "bspline5",
)
_SIZES = (25, 37, 55, 81, 121, 181, 271)
_WAVES = 2.0  # periods of the test function along each axis of [-1, 1]; an integer, so that it is even about the faces
_OMEGA = np.pi * _WAVES
_FITTED = 3  # finest grids, from which a slope is measured


def _waves(points: Array) -> Array:
    """A function that the mirror rule continues exactly: it is even about the faces."""
    return np.asarray(np.prod(np.cos(_OMEGA * points), -1))


def _slopes(points: Array) -> Array:
    a, b = np.moveaxis(_OMEGA * points, -1, 0)
    return np.asarray(-_OMEGA * np.stack([np.sin(a) * np.cos(b), np.cos(a) * np.sin(b)], -1))


def draw(
    filters: Sequence[str | Filter] = _SHOWN, sizes: Sequence[int] = _SIZES, points: int = 20_000, progress: Progress | None = None
) -> Drawing:
    """RMS error of values (left) and of gradients (right) of a smooth function on ever finer grids.

    A dashed line beside each measured curve shows the theory, `clvol.analysis.approximation`.

    Parameters
    ----------
    filters : sequence of str or Filter
        Filters or their names.
    sizes : sequence of int
        Samples along each axis of [-1, 1]², ascending, at least two grids of 17 or more.
    points : int
        Number of compared random positions.
    progress : callable, optional
        Called with the fraction done.
    """
    rule = "two or more whole numbers in ascending order"
    counts = [whole("each of sizes", n, 17) for n in several("sizes", sizes, rule)]
    if len(counts) < 2 or counts != sorted(set(counts)):
        raise OptionError(f"sizes must be {rule}; got {sizes!r}")
    rows = as_filters(filters)
    tables = []
    for n in counted(counts, progress):
        tables.append(analysis.compare(_waves, rows, gradient=_slopes, size=n, dimensions=2, points=points, margin=0, timing=False))
    spacing = 2 / (np.array(counts, float) - 1)
    numbers: list[dict[str, Any]] = []
    for i, row in enumerate(rows):
        values = [t[i].rms for t in tables]
        gradients = [t[i].gradient_rms or 0.0 for t in tables] if row.has_gradient else None
        theory, gradient_theory = _leading(row, spacing)
        numbers.append(
            {
                "filter": row.name,
                "order": row.order,
                "sizes": counts,
                "rms": values,
                "gradient_rms": gradients,
                "theory": theory.tolist(),
                "gradient_theory": None if gradients is None else gradient_theory.tolist(),
                "slope": _slope(spacing, values),
                "gradient_slope": None if gradients is None else _slope(spacing, gradients),
            }
        )
    with styled():
        figure = new_figure(12, 5.2)
        left, right = figure.subplots(1, 2)
        rate = 2 / _WAVES / spacing
        _curves(left, rate, numbers, ("rms", "theory", "slope"), "RMS error of the values")
        _curves(right, rate, numbers, ("gradient_rms", "gradient_theory", "gradient_slope"), "RMS error of the gradient")
    lines = [f"{n['filter']}: the error falls with power {n['slope']:.2f} of the spacing; order {n['order']}" for n in numbers]
    return Drawing(figure, numbers, lines)


def _leading(row: Filter, spacing: Array) -> tuple[Array, Array]:
    """Leading terms of the RMS errors of the values and of the gradients, by approximation theory.

    The test function is a sum of four waves, each of which is reconstructed with a relative error e(t) along each axis. The
    mean square of e tends to ``constant² (omega T)**(2 order)`` and its mean to that of the Taylor coefficient a_order. Those
    along the two axes add: ``<|e + e'|²> = 2 <e²> + 2 <e>²``, and for a slope along x ``<|e_x' / omega + e|²>`` likewise.
    """
    value, slope = analysis.approximation(row), analysis.approximation(row, 1)
    t = (np.arange(256) + 0.5) / 256
    mean = float(np.mean(analysis.taylor_coefficients(row, t, value.order + 1)[value.order])) - (value.order == 0)
    along = (_OMEGA * spacing) ** value.order
    square, squared_mean = (value.constant * along) ** 2, (mean * along) ** 2
    slope_square = (slope.constant * (_OMEGA * spacing) ** slope.order) ** 2
    height = 1 / 4  # mean square of the function; and of each slope, over omega²
    return np.sqrt(height * 2 * (square + squared_mean)), _OMEGA * np.sqrt(height * 2 * (slope_square + square + 2 * squared_mean))


def _curves(axes: Any, rate: Array, numbers: list[dict[str, Any]], keys: tuple[str, str, str], heading: str) -> None:
    measured, theory, slope = keys
    shown = [n for n in numbers if n[measured] is not None]
    for n in shown:
        axes.loglog(rate, n[measured], "o", color=colour(n["filter"]), markersize=3.6)
    low, high = axes.get_ylim()
    for n in shown:
        axes.loglog(rate, n[theory], "--", color=colour(n["filter"]), linewidth=1.1)
    axes.set_ylim(low, high)
    axes.set(xlabel="samples a period", title=heading)
    axes.set_xlim(rate[0] * 0.92, rate[-1] * 1.04)
    ticks = [float(r) for r in rate]
    axes.set_xticks(ticks, [f"{r:.3g}" for r in ticks])
    axes.set_xticks([], minor=True)
    note = "points: measured; dashed: theory\nnumber at each label: measured slope"
    axes.annotate(note, (0.02, 0.02), xycoords="axes fraction", fontsize=8.5, color=GREY)
    label_ends(axes, [(f"{n['filter']}  {n[slope]:.1f}", rate[-1], n[measured][-1], colour(n["filter"])) for n in shown], 0.05)


def _slope(spacing: Array, errors: Sequence[float]) -> float:
    """The power of the spacing with which the error falls on the finest grids."""
    x, y = np.log(spacing[-_FITTED:]), np.log(np.maximum(errors[-_FITTED:], 1e-300))
    return float(np.polyfit(x, y, 1)[0])
