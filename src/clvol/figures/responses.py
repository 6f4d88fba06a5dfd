"""Figure 2 of the paper: frequency responses of direct evaluation, eq. (17), and of the hybrid, eq. (18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from clvol import analysis
from clvol.figures.style import FAINT, GREY, INK, Drawing, colour, legend_above, new_figure, styled, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters

__all__ = ["draw"]

_BESIDE = ("linear", "mitchell")  # for comparison with the hybrid
_REACH = 4  # multiples of pi
_FLOOR = -80.0  # decibels
_NOTHING = 1e-9  # smallest significant difference: near common zeros the sign is rounding


def draw(filters: Sequence[str | Filter] = ("bspline3", "hybrid")) -> Drawing:
    """Figure 2: the responses of `filters`, and those of linear and of Mitchell's filter.

    Parameters
    ----------
    filters : sequence of str or Filter
        Drawn in bold. With two, the frequency is marked at which the one that passes less of the aliases changes, if there is
        exactly one.
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
        turn = _turn(*chosen) if len(chosen) == 2 else None
        if turn is not None:
            names = [title(row.name) for row in (turn[0], turn[1])]
            far.axvline(turn[2] / np.pi, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
            beyond = f" beyond {turn[2] / np.pi:.3f} π"
            for name, where, place, side in ((names[0], "", -0.03, "right"), (names[1], beyond, 0.03, "left")):
                text = f"{name.split(',')[0]}\npasses less{where}"
                far.annotate(text, (turn[2] / np.pi + place, 3), ha=side, va="top", color=INK, fontsize=8.5)
        legend_above(figure, near)
    lines = [
        f"{title(n['filter'])}: error up to {n['passband_error']:.3f} below π/2; passes "
        + (f"up to {n['stopband_peak']:.3f} ({-n['attenuation']:.0f} dB)" if n["attenuation"] is not None else "none")
        + " of its aliases"
        for n in numbers
    ]
    if turn is not None:
        lines.append(f"beyond π, {names[0]} passes less up to {turn[2] / np.pi:.3f} π, {names[1]} from there on")
    return Drawing(figure, numbers, lines)


def _turn(one: Filter, other: Filter) -> tuple[Filter, Filter, float] | None:
    """Beyond Nyquist, the filter that passes less at first, the other, and where they change; None unless they change once."""

    def excess(omega: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """How much more `one` passes."""
        return np.abs(analysis.frequency_response(one, omega)) - np.abs(analysis.frequency_response(other, omega))

    omega = np.linspace(np.pi, _REACH * np.pi, 4001)
    difference = excess(omega)
    clear = np.flatnonzero(np.abs(difference) > _NOTHING)
    turns = clear[:-1][difference[clear[:-1]] * difference[clear[1:]] < 0]
    if turns.size != 1:
        return None
    first = int(turns[0])
    end = int(clear[np.searchsorted(clear, first) + 1])
    at = float(optimize.brentq(lambda w: float(excess(w)), omega[first], omega[end], xtol=1e-12))
    return (other, one, at) if difference[first] > 0 else (one, other, at)
