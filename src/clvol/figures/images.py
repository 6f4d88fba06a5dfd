"""Figure 5 of the paper: the six reconstructions in 2-D."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.analysis import EXACT_SINC, dirichlet_magnify
from clvol.analysis.comparison import as_compared
from clvol.checks import require_room, whole
from clvol.device import Device
from clvol.figures.inputs import photograph, zone_plate
from clvol.figures.panels import FIGURE_6
from clvol.figures.style import LETTERS, Drawing, folded, new_figure, show, styled, title
from clvol.filter import Filter
from clvol.spline.field import sample
from clvol.volume import Volume

__all__ = ["draw", "finer"]

Array: TypeAlias = NDArray[np.float64]
_FACTOR = 4


def finer(image: Volume, factor: int, filter: str | Filter, device: Device | str | int | None = None) -> Array:
    """An image at every 1 / `factor` of a sample, from the first to the last; "exact-sinc" is the exact sinc."""
    if filter == EXACT_SINC:
        return dirichlet_magnify(image.data, factor)
    axes = [np.arange(factor * (n - 1) + 1) / factor for n in image.shape]
    index = np.stack(np.meshgrid(*axes, indexing="ij")[::-1], -1)
    return sample(image, image.index_to_world(index), filter, device=device).astype(np.float64)


def draw(
    filters: Sequence[str | Filter] = FIGURE_6,
    samples: int = 65,
    device: Device | str | int | None = None,
    progress: Callable[[float], Any] | None = None,
) -> Drawing:
    """Figure 5: a photograph and a zone plate of few samples, magnified four times by each filter.

    Parameters
    ----------
    filters : sequence of str or Filter
        A column each.
    samples : int
        Of each image along each axis.
    device, progress
        As for `clvol.sample`.
    """
    samples, chosen = whole("samples", samples, 8), as_compared(filters, len(LETTERS))
    require_room("samples", (_FACTOR * samples) ** 2, samples)
    size = _FACTOR * (samples - 1) + 1
    original, what = photograph(size)
    plate = Volume(zone_plate(_square(size), samples))
    # the photograph is low-passed before it is decimated, as a camera would; the plate holds nothing beyond Nyquist
    coarse = [original.gaussian(_FACTOR / 2).downsample(_FACTOR), plate.downsample(_FACTOR)]
    inner = (slice(2 * _FACTOR, -2 * _FACTOR),) * 2
    numbers: list[dict[str, Any]] = []
    with styled():
        figure = new_figure(2.05 * (len(chosen) + 1), 4.9)
        panels = figure.subplots(2, len(chosen) + 1)
        for column, drawer in enumerate(chosen):
            name = drawer.name if isinstance(drawer, Filter) else drawer
            for row, (kind, truth, few) in enumerate(((what, original, coarse[0]), ("zone plate", plate, coarse[1]))):
                drawn = finer(few, _FACTOR, drawer, device)
                rms = float(np.sqrt(np.mean((drawn[inner] - truth.data[inner]) ** 2)))
                numbers.append({"input": kind, "filter": name, "rms": rms})
                heading = folded(f"{LETTERS[column]})  {title(name)}") if row == 0 else ""
                show(panels[row, column], drawn, heading, f"RMS {rms:.4f}", vmin=0, vmax=1)
            if progress is not None:
                progress((column + 1) / len(chosen))
        show(panels[0, -1], original.data, f"the {what}", f"{size}², given as {samples}²", vmin=0, vmax=1)
        show(panels[1, -1], plate.data, "", "the zone plate itself", vmin=0, vmax=1)
    lines = [f"{n['input']}, {title(n['filter'])}: RMS error {n['rms']:.4f}" for n in numbers]
    return Drawing(figure, numbers, lines)


def _square(size: int) -> Array:
    x = np.linspace(-1, 1, size)
    return np.stack(np.meshgrid(x, x), -1)
