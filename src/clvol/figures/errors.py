"""Figure 4 of the paper: mean square errors of the six reconstructions, in 2-D and in 3-D."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol import phantoms
from clvol.analysis import ErrorTable, compare
from clvol.analysis.comparison import as_compared
from clvol.base.checks import require_room, whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress, counted
from clvol.figures.inputs import photograph, rings, zone_plate
from clvol.figures.panels import FIGURE_6
from clvol.figures.style import FAINT, GREY, INK, Drawing, colour, new_figure, styled, title
from clvol.filter.boundary import DEFAULT_BOUNDARY
from clvol.filter.filter import Filter
from clvol.volume.volume import Volume, as_volume

__all__ = ["Case", "draw", "mean_square", "measure"]

_GRADIENTS = 64  # few positions, since the gradients' errors are not shown


@dataclass(frozen=True)
class Case:
    """One input, scaled to 0..1, and the mean square error of each filter on it."""

    name: str
    how: str  # the truth is known
    dimensions: int
    errors: dict[str, float]  # by filter

    def numbers(self) -> dict[str, Any]:
        """For programs."""
        return {"input": self.name, "dimensions": self.dimensions, "against": self.how, "mean_square_error": self.errors}


def measure(
    filters: Sequence[str | Filter] = FIGURE_6,
    samples: int = 41,
    points: int = 20_000,
    scan: Volume | ArrayLike | None = None,
    progress: Progress | None = None,
) -> list[Case]:
    """Errors on inputs with a known truth, 2-D first; parameters as for `draw`."""
    samples, filters = whole("samples", samples, 4), as_compared(filters)
    require_room("samples", (12 * samples) ** 3, samples)
    table = partial(compare, filters=filters, boundary=DEFAULT_BOUNDARY, timing=False)
    held_back = partial(table, points=_GRADIENTS)  # for every first kept sample, and positions between
    photo, what = photograph(max(16, 12 * samples))
    known: list[tuple[str, int, Callable[[], list[ErrorTable]]]] = [
        ("Marschner–Lobb, z = 0", 2, lambda: [table(rings, size=samples, dimensions=2, points=points)]),
        ("zone plate", 2, lambda: [table(partial(zone_plate, size=samples), size=samples, dimensions=2, points=points)]),
        (f"{what}, low-passed", 2, lambda: [held_back(photo)]),
        ("Marschner–Lobb", 3, lambda: [table(phantoms.marschner_lobb_function, size=samples, points=points)]),
        ("zone plate", 3, lambda: [table(partial(zone_plate, size=samples), size=samples, points=points)]),
        ("box, hard edges", 3, lambda: [held_back(phantoms.box(2 * samples), lowpass="none")]),
    ]
    if scan is not None:
        scan = as_volume(scan)
        if scan.ndim != 3:
            raise OptionError(f"scan must have 3 axes; got shape {scan.shape}")
        volume, middle = scan, Volume(scan.data[scan.shape[0] // 2], scan.spacing[:2])
        known.insert(3, ("slice of the scan, low-passed", 2, lambda: [held_back(middle)]))
        known.append(("scan, low-passed", 3, lambda: [held_back(volume)]))
    cases = []
    for name, dimensions, make in counted(known, progress):
        tables = make()
        how = "function" if tables[0].against.startswith("the function") else "samples left out"
        cases.append(Case(name, how, dimensions, mean_square(tables)))
    return cases


def mean_square(tables: Sequence[ErrorTable]) -> dict[str, float]:
    """Mean square errors by filter over all tables, of data scaled to 0..1."""
    spans = [t.value_range[1] - t.value_range[0] or 1.0 for t in tables]
    return {
        rows[0].filter: float(np.mean([(row.rms / span) ** 2 for row, span in zip(rows, spans, strict=True)]))
        for rows in zip(*tables, strict=True)
    }


def draw(
    filters: Sequence[str | Filter] = FIGURE_6,
    samples: int = 41,
    points: int = 20_000,
    scan: Volume | ArrayLike | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Figure 4: a dot for each filter on a logarithmic axis, a panel for each input.

    Parameters
    ----------
    filters : sequence of str or Filter
        Filters or their names, and "exact-sinc".
    samples : int
        Of the functions along each axis; the photograph and the box have more, and are decimated.
    points : int
        Number of random positions at which functions are compared.
    scan : Volume or array-like, optional
        One more input, and its middle slice. These, the photograph and the box are decimated by two, beginning at each of the
        first two samples along every axis. All except the box are first low-passed by a Gaussian of one sample along each axis,
        and compared with the result, also from positions between samples: see `clvol.analysis.compare`.
    progress : callable, optional
        Called with the fraction done.
    """
    cases = measure(filters, samples, points, scan, progress)
    positive = [error for case in cases for error in case.errors.values() if error > 0]
    least, most = (min(positive), max(positive)) if positive else (0.1, 1.0)
    with styled():
        across = len(cases) // 2
        figure = new_figure(3.1 * across + 1.4, 0.34 * 2 * len(cases[0].errors) + 2.1)
        panels = figure.subplots(2, across, sharex=True, sharey=True)
        for axes, case in zip(panels.flat, cases, strict=True):
            _dots(axes, case, least / 2)
        panels[0, 0].set_xlim(least / 2, most * 8)  # room for the numbers
        figure.suptitle("mean square error of the reconstruction, data scaled to 0…1; smallest in bold", fontsize=10, color=GREY)
    lines = []
    for case in cases:
        best = min(case.errors, key=lambda name: case.errors[name])
        lines.append(f"{case.name}, {case.dimensions}-D: smallest with {title(best)}, {case.errors[best]:.3g}")
    return Drawing(figure, [case.numbers() for case in cases], lines)


def _dots(axes: Any, case: Case, least: float) -> None:
    """A dot for each filter on a logarithmic axis; an error of 0 is at its end."""
    names, errors = list(case.errors), np.array(list(case.errors.values()))
    places = np.arange(len(names))[::-1]
    shown = np.maximum(errors, least)
    axes.set_xscale("log")
    axes.hlines(places, least, shown, color=FAINT, linewidth=1)
    for name, place, at, error in zip(names, places, shown, errors, strict=True):
        axes.plot(at, place, "o", color=colour(name), markersize=7)
        weight = "bold" if error == errors.min() else "normal"
        axes.annotate(
            f"{error:.3g}", (at, place), (7, 0), textcoords="offset points", va="center", fontsize=8.5, color=INK, fontweight=weight
        )
    axes.set(xlabel=f"against the {case.how}", ylim=(-0.6, len(names) - 0.4))
    axes.set_yticks(places, [title(n) for n in names])
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", which="minor", length=0)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.set_title(f"{case.dimensions}-D  {case.name}")
