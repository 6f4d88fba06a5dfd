"""The frequencies of the data, beside the responses of the filters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from clvol.analysis import frequency_response
from clvol.base.arrays import Array
from clvol.figures.style import FAINT, GREY, INK, colour, legend_above, new_figure, styled, title
from clvol.filter.filter import Filter
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Spectra", "plot", "spectra"]

Spectra: TypeAlias = list[tuple[str, Array, Array]]
"""Axis, frequencies up to Nyquist in radians per sample, and the variance at each: its sum is 1 (0 for constant data)."""

_FLOOR = -80.0  # decibels
_STYLES = ("-", "--", ":")  # of lines, one for each axis


def spectra(volume: Volume) -> Spectra:
    """Power spectra along each axis of three samples or more, without the mean, and tapered."""
    result: Spectra = []
    low, high = volume.value_range
    span = high - low or math.inf  # constant data give exactly 0, without rounding errors of the mean
    for axis, name in zip(range(volume.ndim), "zyx"[-volume.ndim :], strict=True):
        n = volume.shape[axis]
        if n < 3:
            continue
        lines = np.moveaxis(volume.data.astype(np.float64), axis, -1)
        lines = (lines - lines.mean(-1, keepdims=True)) / span * np.hanning(n + 2)[1:-1]
        power = (np.abs(np.fft.rfft(lines)) ** 2).reshape(-1, n // 2 + 1).mean(0)
        total = float(power[1:].sum())
        result.append((name, np.asarray(2 * np.pi * np.fft.rfftfreq(n)[1:], np.float64), np.asarray(power[1:] / (total or 1.0))))
    return result


def _alike(row: Filter) -> dict[str, str]:
    """Styles of line, and the axes along which a filter has the response drawn in them: none named where it is the same."""
    if not isinstance(row.smoothing, tuple):
        return {"-": ""}
    axes = {
        value: "".join(name for name, own in zip("xyz", row.smoothing, strict=False) if own == value) for value in row.smoothing
    }
    return dict(zip(_STYLES, axes.values(), strict=False))


def plot(found: Spectra, filters: Sequence[Filter]) -> Figure:
    """The filters' responses (left) and the power of the data at each frequency (right)."""
    omega = np.linspace(0, 2 * np.pi, 601)
    shown = [one for one in found if one[2].any()]
    with styled():
        figure = new_figure(11, 4.0)
        left, right = figure.subplots(1, 2)
        left.plot([0, 1, 1, 2], [1, 1, 0, 0], color=FAINT, linewidth=1.2)
        for row in filters:
            for style, axes in _alike(row).items():
                label = title(row.name) + (f", along {' and '.join(axes)}" if axes else "")
                response = frequency_response(row.along("xyz".index(axes[0]) if axes else 0), omega)
                left.plot(omega / np.pi, response, style, color=colour(row.name), label=label, linewidth=1.5)
        left.set(
            xlim=(0, 2),
            ylim=(-0.15, 1.2),
            xlabel="frequency ω / π, where 1 is Nyquist",
            ylabel="response",
            title="what the filters keep (below 1) and let through (above)",
        )
        legend_above(figure, left)
        for (name, w, power), style in zip(shown, _STYLES, strict=False):
            level = 10 * np.log10(np.maximum(power / max(power.max(initial=0), 1e-300), 1e-12))
            right.plot(w / np.pi, np.maximum(level, _FLOOR), style, color=INK, linewidth=1.3, label=f"along {name}")
        if not shown:
            right.annotate("the data are constant", (0.25, 0.5), xycoords="axes fraction", ha="center", fontsize=9, color=GREY)
        right.axvspan(0.5, 1, color="#f4f4f4", zorder=0)
        right.annotate(
            "above half of Nyquist", (0.75, 0.97), xycoords="axes fraction", ha="center", va="top", fontsize=8.5, color=GREY
        )
        right.set(
            xlim=(0, 1),
            ylim=(_FLOOR, 3),
            xlabel="frequency ω / π",
            ylabel="power, decibels relative to the peak",
            title="what the data contain",
        )
        if shown:
            right.legend(fontsize=8, loc="lower left")
    return figure
