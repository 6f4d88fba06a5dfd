"""Figure 2 of the paper: frequency responses of direct evaluation, eq. (17), and of the hybrid, eq. (18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from clvol import analysis
from clvol.figures.style import FAINT, GREY, Drawing, colour, legend_above, new_figure, styled, title
from clvol.filter import Filter, as_filters

__all__ = ["draw"]

_BESIDE = ("linear", "mitchell")  # the hybrid is judged against these
_REACH = 4  # multiples of pi
_FLOOR = -80.0  # decibels


def draw(filters: Sequence[str | Filter] = ("bspline3", "hybrid")) -> Drawing:
    """Figure 2: the responses of `filters`, beside those of linear and of Mitchell's filter.

    Parameters
    ----------
    filters : sequence of str or Filter
        Drawn in bold.
    """
    chosen = as_filters(filters)
    rows = [*(row for row in as_filters(_BESIDE) if row not in chosen), *chosen]
    omega = np.linspace(0, _REACH * np.pi, 1601)
    numbers = []
    with styled():
        figure = new_figure(11, 4.0)
        near, far = figure.subplots(1, 2, width_ratios=(1, 1.15))
        near.fill_between([0, 1], 0, 1, color="#f1f1f1", linewidth=0)
        near.plot([0, 1, 1, 2], [1, 1, 0, 0], color=FAINT, linewidth=1.2)
        far.plot([0, 1, 1], [0, 0, _FLOOR], color=FAINT, linewidth=1.2)
        for row in rows:
            response = analysis.frequency_response(row, omega)
            bold = row in chosen
            look = {"color": colour(row.name), "linewidth": 2.2 if bold else 1.1, "alpha": 1.0 if bold else 0.75}
            near.plot(omega / np.pi, response, label=title(row.name), **look)
            level = 20 * np.log10(np.abs(response) + 1e-12)
            far.plot(omega / np.pi, np.where(level > _FLOOR, level, np.nan), **look)
            numbers.append(asdict(analysis.bands(row)))
        near.set(
            xlim=(0, 2),
            ylim=(-0.15, 1.12),
            xlabel="frequency ω / π, where 1 is Nyquist",
            ylabel="response",
            title="passband and the first band of aliases",
        )
        near.annotate("ideal", (1.03, 0.97), color=GREY, fontsize=9)  # beside its edge, where no curve is
        far.set(
            xlim=(0, _REACH),
            ylim=(_FLOOR, 6),
            xlabel="frequency ω / π",
            ylabel="|response|, decibels",
            title="stopband: the remaining aliases",
        )
        legend_above(figure, near)
    lines = [
        f"{title(n['filter'])}: error up to {n['passband_error']:.3f} below π/2; passes "
        + (f"up to {n['stopband_peak']:.3f} ({-n['attenuation']:.0f} dB)" if n["attenuation"] is not None else "none")
        + " of its aliases"
        for n in numbers
    ]
    return Drawing(figure, numbers, lines)
