"""Error against time per sample, all filters on one plot: it answers "which filter should I use"."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol import analysis, phantoms
from clvol.analysis.timing import FULL, Effort, times_per_sample
from clvol.base.progress import Progress, part_of
from clvol.device import Device, as_device
from clvol.figures.style import FAINT, GREY, Drawing, colour, new_figure, plain_digits, styled
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters
from clvol.filter.table import filters as all_filters

__all__ = ["draw", "frontier", "plot"]

_LETTER = 8.5  # points
_GAP = 0.85  # of an em, from a dot's centre to the label beside it
_SHARE = 0.8  # share of the progress for the errors
_PLACES = ((1, 0), (1, 1), (1, -1), (-1, 0), (-1, 1), (-1, -1), (0, 1.4), (0, -1.4), (1, 2.2), (1, -2.2), (-1, 2.2), (-1, -2.2))


def draw(
    filters: Sequence[str | Filter] | None = None,
    samples: int = 41,
    points: int = 20_000,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
    *,
    effort: Effort = FULL,
) -> Drawing:
    """Each filter's error on the Marschner-Lobb function against its time on a device: values left, gradients right.

    Times are medians; half of those measured lie within the bars.

    Parameters
    ----------
    filters : sequence of str or Filter, optional
        Default: those of the table whose weights sum to one.
    samples : int
        Of the function along each axis.
    points : int
        Number of compared random positions.
    device, progress
        As for `clvol.sample`.
    effort : Effort
        How thoroughly times are measured.

    Raises
    ------
    DeviceError
        No device is usable, so there are no times.
    """
    normalized = [row for row in all_filters().values() if row.sums_to_one]
    rows, on = as_filters(normalized if filters is None else filters), as_device(device)
    on.require_usable()
    table = analysis.compare(
        phantoms.marschner_lobb_function,
        rows,
        gradient=phantoms.marschner_lobb_gradient,
        size=samples,
        points=points,
        timing=False,
        progress=part_of(progress, 0, _SHARE),
    )
    timing = part_of(progress, _SHARE, 1)
    times = times_per_sample(table.samples, rows, as_boundary(DEFAULT_BOUNDARY), on, timing, effort=effort)
    numbers: list[dict[str, Any]] = [
        {
            "filter": row.filter,
            "nanoseconds": float(1e9 * np.median(took)),
            "quartiles": [float(1e9 * q) for q in np.quantile(took, (0.25, 0.75))],
            "rms": row.rms,
            "angle_mean": row.angle_mean,
        }
        for row, took in zip(table, times, strict=True)
    ]
    figure = plot(
        numbers,
        "RMS error of the values",
        f"Marschner–Lobb, {samples}³ samples; times on {on.name}, median and quartiles. Line: nothing is both faster and better.",
    )
    best = {name for name, _, _ in frontier([(n["filter"], n["nanoseconds"], n["rms"]) for n in numbers])}
    lines = [
        f"{n['filter']}: RMS error {n['rms']:.4f}, {n['nanoseconds']:.0f} ns per sample "
        f"({n['quartiles'][0]:.0f} to {n['quartiles'][1]:.0f})" + (" *" if n["filter"] in best else "")
        for n in numbers
    ]
    return Drawing(figure, numbers, [*lines, "* nothing is both faster and better"])


def plot(numbers: Sequence[dict[str, Any]], heading: str, note: str) -> Any:
    """A figure of errors ("rms") and angles ("angle_mean") against time ("nanoseconds"), each filter a point.

    Where `numbers` have them, "quartiles" of the time are bars.
    """
    with styled():
        figure = new_figure(12, 5.6)
        left, right = figure.subplots(1, 2)
        figure.suptitle(note, fontsize=9.5, color=GREY)
        both = [(left, "rms", heading), (right, "angle_mean", "mean angle of the gradient, degrees")]
        shown = [_scatter(axes, numbers, key, text) for axes, key, text in both]
        figure.draw_without_rendering()  # fixes the axes' positions
        quartiles = {n["filter"]: n["quartiles"] for n in numbers if "quartiles" in n}
        for (axes, *_), points in zip(both, shown, strict=True):
            _label(axes, points, quartiles)
    return figure


def frontier(rows: Sequence[tuple[str, float, float]]) -> list[tuple[str, float, float]]:
    """The Pareto front of (name, time, error): rows that no other beats in both, fastest first."""
    kept: list[tuple[str, float, float]] = []
    for row in sorted(rows, key=lambda r: (r[1], r[2])):
        if not kept or row[2] < kept[-1][2]:
            kept.append(row)
    return kept


def _scatter(axes: Any, numbers: Sequence[dict[str, Any]], key: str, heading: str) -> list[tuple[str, float, float]]:
    known = [n for n in numbers if n[key] is not None]
    shown = [(n["filter"], n["nanoseconds"], n[key]) for n in known]
    axes.loglog()
    line = frontier(shown)
    axes.step([r[1] for r in line], [r[2] for r in line], where="post", color=FAINT, linewidth=5, solid_joinstyle="round", zorder=1)
    for name, nanoseconds, error in shown:
        axes.plot(nanoseconds, error, "o", color=colour(name), markersize=7, zorder=3)
    for n in known:
        if "quartiles" in n:
            axes.hlines(n[key], *n["quartiles"], color=colour(n["filter"]), linewidth=1.5, zorder=2)
    axes.set(xlabel="time per sample, nanoseconds", title=heading)
    axes.margins(0.16, 0.08)
    for axis in (axes.xaxis, axes.yaxis):
        plain_digits(axis, (1, 2, 5))
    return shown


def _label(axes: Any, shown: Sequence[tuple[str, float, float]], quartiles: dict[str, Sequence[float]]) -> None:
    """A name beside each point, where it overlaps other names, points and bars least."""
    at = {name: axes.transData.transform((x, y)) for name, x, y in shown}
    ends = {name: [axes.transData.transform((end, y))[0] for end in quartiles.get(name, (x, x))] for name, x, y in shown}
    em = axes.figure.dpi * _LETTER / 72
    # a dot is not quite an em wide
    taken = [(p[0] - 0.5 * em, p[1] - 0.5 * em, p[0] + 0.5 * em, p[1] + 0.5 * em) for p in at.values()]
    taken += [(left, at[name][1] - 0.15 * em, right, at[name][1] + 0.15 * em) for name, (left, right) in ends.items()]
    for name, x, y in shown:
        label = axes.annotate(
            name, (x, y), (0, 0), textcoords="offset points", ha="center", va="center", fontsize=_LETTER, color=colour(name)
        )
        label.set_in_layout(False)
        extent = label.get_window_extent()
        width, height = extent.width, extent.height
        boxes = []
        for dx, dy in _PLACES:
            beyond = ends[name][dx > 0] if dx and not dy else at[name][0]  # beside the bar, not on it
            centre = np.array([beyond + dx * (width / 2 + _GAP * em), at[name][1] + dy * height])
            boxes.append((centre[0] - width / 2, centre[1] - height / 2, centre[0] + width / 2, centre[1] + height / 2))
        box = min(boxes, key=lambda b: sum(_overlap(b, other) for other in taken))
        taken.append(box)
        label.set_position(tuple((np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]) - at[name]) * 72 / axes.figure.dpi))


def _overlap(a: Sequence[float], b: Sequence[float]) -> float:
    return float(max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1])))
