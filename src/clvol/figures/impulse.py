"""Impulse responses: each filter's reconstruction of one sample among zeros, the prefilter included."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol import analysis
from clvol.figures.style import GREY, LETTERS, Drawing, colour, new_figure, styled, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters

__all__ = ["draw"]

_SHOWN = ("nearest", "linear", "bspline3-approx", "mitchell", "catmull-rom", "bspline3", "hybrid", "lanczos3n")
_REACH = 5.0
_SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹"


def draw(filters: Sequence[str | Filter] = _SHOWN) -> Drawing:
    """A panel for each filter, over the sinc.

    Parameters
    ----------
    filters : sequence of str or Filter
        Filters or their names.
    """
    rows = as_filters(filters, len(LETTERS))
    x = np.linspace(-_REACH, _REACH, 2001)
    numbers: list[dict[str, Any]] = []
    across = min(4, len(rows))
    down = -(-len(rows) // across)
    with styled():
        figure = new_figure(2.75 * across, 2.15 * down + 0.4)
        panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        for axes in panels.flat[len(rows) :]:
            axes.set_axis_off()
        for axes, row in zip(panels.flat, rows, strict=False):
            response = analysis.impulse_response(row, x)
            axes.plot(x, np.sinc(x), color="#c4c4c4", linewidth=1.1)
            axes.plot(x, response, color=colour(row.name))
            axes.fill_between(x, 0, response, color=colour(row.name), alpha=0.15, linewidth=0)
            smooth = "jumps" if row.continuity < 0 else f"C{_SUPERSCRIPTS[min(row.continuity, 9)]}"
            axes.set_title(title(row.name), fontsize=9.5)
            taps = f"{row.support} tap{'s' if row.support > 1 else ''}"
            text = f"{taps}\n{smooth}\norder {row.order}" + ("\nprefilter" if row.prefilter or row.magnified_by else "")
            axes.annotate(text, (0.03, 0.95), xycoords="axes fraction", va="top", fontsize=8, color=GREY)
            axes.set(xlim=(-_REACH, _REACH), ylim=(-0.28, 1.12), xticks=range(-4, 5, 2), yticks=(0, 0.5, 1))
            numbers.append(
                {
                    "filter": row.name,
                    "peak": float(analysis.impulse_response(row, 0.0)),
                    "least": float(response.min()),
                    "taps": row.support,
                    "continuity": row.continuity,
                    "order": row.order,
                }
            )
        figure.supxlabel("distance from the sample, in samples; grey: the sinc", fontsize=9.5)
    lines = [f"{title(n['filter'])}: {n['peak']:.3f} at its own sample, smallest value {n['least']:.3f}" for n in numbers]
    return Drawing(figure, numbers, lines)
