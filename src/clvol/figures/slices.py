"""Interpolation between slices that are farther apart than their pixels, by each filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from clvol import phantoms
from clvol.base.arrays import Array
from clvol.base.checks import require_room, whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress
from clvol.device import Device
from clvol.figures.panels import SIX
from clvol.figures.style import GREY, LETTERS, Drawing, colour, folded, placed, plain_digits, show, styled, tiles, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters
from clvol.spline.field import sample
from clvol.volume.volume import Volume, as_volume

__all__ = ["APART", "draw", "from_function", "from_scan"]

_Errors: TypeAlias = dict[int, dict[str, float]]  # by distance of slices, then by filter
APART = (1, 2, 3, 4, 5, 6)
"""Distances of slices, in pixels."""

_SHOWN = (*SIX[1:], "hybrid", "bspline5")
_WAVES = 2.5  # of the Marschner-Lobb function; slices 3 pixels apart just sample them, 4 pixels do not
_DRAWN = 3  # pixels; distance of slices in the pictures
_POINTS = 40_000
_ZOOM = 3
_SEED = 1999


def from_function(
    filters: Sequence[Filter], size: int, apart: Sequence[int] = APART, device: Device | str | int | None = None
) -> _Errors:
    """RMS errors by distance of slices and filter on the Marschner-Lobb function with its waves across the slices.

    The slices have `size`² pixels on [-1, 1]²; errors are at random points within 0.8 of the centre along each axis.
    """
    points = np.random.default_rng(_SEED).uniform(-0.8, 0.8, (_POINTS, 3))
    truth = _function(points)
    made = {}
    for k in apart:
        volume = _sliced(size, k)
        made[k] = {row.name: _rms(sample(volume, points, row, device=device) - truth) for row in filters}
    return made


def from_scan(
    volume: Volume, filters: Sequence[Filter], apart: Sequence[int] = APART[1:], device: Device | str | int | None = None
) -> _Errors:
    """RMS errors by distance of slices and filter, at the omitted slices: every `k`-th is kept, from each first one in turn.

    Nothing is low-passed, since scanners with gaps between slices do not; so errors include the lost detail, and the noise of
    the omitted slices.
    """
    made = {}
    for k in apart:
        errors: dict[str, list[float]] = {row.name: [] for row in filters}
        for first in range(k):
            kept = volume.data[first::k]
            thin = Volume(kept, (*volume.spacing[:2], k * volume.spacing[2]))
            index = np.random.default_rng(_SEED).integers(0, [*volume.size[:2], (len(kept) - 1) * k], (_POINTS, 3))
            index = index[index[:, 2] % k > 0]  # omitted slices between kept ones
            truth = volume.data[first + index[:, 2], index[:, 1], index[:, 0]]
            for row in filters:
                errors[row.name].append(_rms(sample(thin, index * np.array(volume.spacing), row, device=device) - truth))
        made[k] = {name: float(np.sqrt(np.mean(np.square(each)))) for name, each in errors.items()}
    return made


def draw(
    filters: Sequence[str | Filter] = _SHOWN,
    samples: int = 61,
    scan: Volume | ArrayLike | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Above, errors against the distance of slices; below, a plane across slices 3 pixels apart, by each filter.

    Parameters
    ----------
    filters : sequence of str or Filter
        A curve and a picture each.
    samples : int
        Of the function along each axis of a slice; one more than a multiple of 3.
    scan : Volume or array-like, optional
        A volume whose slices are omitted, in addition to the function.
    device, progress
        As for `clvol.sample`.
    """
    rows, samples = as_filters(filters, len(LETTERS)), whole("samples", samples, 7)
    if (samples - 1) % _DRAWN:
        raise OptionError(f"samples must be one more than a multiple of {_DRAWN}; got {samples}")
    require_room("samples", samples**3, samples)
    apart = [k for k in APART if (samples - 1) % k == 0]
    tables = [("Marschner–Lobb, waves across the slices", from_function(rows, samples, apart, device))]
    if progress is not None:
        progress(0.6 if scan is None else 0.3)
    if scan is not None:
        scan = as_volume(scan)
        if scan.ndim != 3 or scan.shape[0] <= 2 * APART[-1]:
            raise OptionError(f"scan must have 3 axes and more than {2 * APART[-1]} slices; got shape {scan.shape}")
        tables.append(("slices of the scan that were left out", from_scan(scan, rows, device=device)))
    numbers = [
        {"input": what, "apart": k, "filter": name, "rms": error}
        for what, table in tables
        for k, made in table.items()
        for name, error in made.items()
    ]
    with styled():
        figure = _drawn(rows, samples, tables, device)
    if progress is not None:
        progress(1)
    lines = []
    for what, table in tables:
        for k, made in table.items():
            best = min(made, key=lambda name: made[name])
            lines.append(f"{what}, slices {k} pixels apart: smallest RMS error with {title(best)}, {made[best]:.4g}")
    return Drawing(figure, numbers, lines)


def _drawn(rows: Sequence[Filter], samples: int, tables: Sequence[tuple[str, _Errors]], device: Device | str | int | None) -> Any:
    size, high = _ZOOM * (samples - 1) + 1, 620
    wide = (len(rows) + 1) * max(size, 160)
    figure, panels, times = tiles(1, len(rows) + 1, (size, size), above=25, below=1, right=max(0, 330 + 450 * len(tables) - wide))
    x = np.linspace(-1, 1, size)
    plane = np.stack([*np.meshgrid(x, x), np.zeros((size, size))], -1)[..., [0, 2, 1]]  # x across, z up
    truth, thin = _function(plane.reshape(-1, 3)).reshape(size, size), _sliced(samples, _DRAWN)
    low, upper = float(truth.min()), float(truth.max())
    for i, row in enumerate(rows):
        drawn = sample(thin, plane, row, device=device)
        heading = folded(f"{LETTERS[i]})  {title(row.name)}", times * size)
        show(panels[0, i], drawn, heading, f"RMS {_rms(drawn - truth):.4f}", vmin=low, vmax=upper, origin="lower")
    show(panels[0, -1], truth, folded(title("exact"), times * size), "", vmin=low, vmax=upper, origin="lower")
    width = round(figure.dpi * figure.get_size_inches()[0])
    share = (width - 330) // len(tables)
    for i, (what, table) in enumerate(tables):
        axes = placed(figure, 130 + i * share, 40, share - 140, high - 130)
        apart = list(table)
        for row in rows:
            axes.plot(apart, [table[k][row.name] for k in apart], "o-", color=colour(row.name), markersize=4, label=title(row.name))
        axes.set_yscale("log")
        plain_digits(axes.yaxis, (1, 2, 5) if i else (1,))
        axes.set(xlabel="pixels from slice to slice", ylabel="RMS error", xticks=apart)
        axes.set_title(what)
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    caption = f"a plane across slices that are {_DRAWN} pixels apart; they lie level:"
    figure.text(0.006, 1 - (high - 5) / (figure.dpi * figure.get_size_inches()[1]), caption, color=GREY, fontsize=9)
    return figure


def _function(points: Array) -> Array:
    """The Marschner-Lobb function with its axis along y, so that its waves also cross slices."""
    return phantoms.marschner_lobb_function(points[:, [0, 2, 1]], f_m=_WAVES)


def _sliced(size: int, apart: int) -> Volume:
    """Samples of it, `size` along x and y, and every `apart`-th slice."""
    x, z = np.linspace(-1, 1, size), np.linspace(-1, 1, (size - 1) // apart + 1)
    grid = np.stack(np.meshgrid(z, x, x, indexing="ij")[::-1], -1)
    data = _function(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    return Volume(data, (x[1] - x[0], x[1] - x[0], z[1] - z[0]), (-1.0, -1.0, -1.0))


def _rms(differences: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(differences, np.float64)))))
