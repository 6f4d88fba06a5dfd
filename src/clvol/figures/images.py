"""Figure 5 of the paper: the six reconstructions in 2-D, and close-ups of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol.analysis import EXACT_SINC, dirichlet_magnify
from clvol.analysis.comparison import as_compared
from clvol.base.arrays import Array
from clvol.base.checks import require_room, whole
from clvol.base.progress import Progress, counted
from clvol.device import Device
from clvol.figures.inputs import photograph, zone_plate, zone_plate_image
from clvol.figures.panels import FIGURE_6
from clvol.figures.style import LETTERS, Drawing, folded, show, styled, tiles, title
from clvol.filter.filter import Filter
from clvol.spline.field import sample
from clvol.volume.volume import Volume

__all__ = ["draw", "finer"]

_FACTOR, _NEAR = 4, 16  # pixels for each sample, in pictures and in close-ups
_COLLAR, _CORNER = (0.36, 0.73), (0.06, 0.06)  # start of the close-ups, along x and y of the picture


def finer(
    image: Volume,
    factor: int,
    filter: str | Filter,
    device: Device | str | int | None = None,
    first: tuple[int, int] = (0, 0),
    count: tuple[int, int] | None = None,
) -> Array:
    """An image at steps of 1 / `factor` samples from sample `first` (x, y) on; "exact-sinc" is the exact sinc.

    `count` positions along x and y; by default up to the last sample.
    """
    (x, y), (width, height) = first, count or tuple(factor * (n - 1 - f) + 1 for n, f in zip(image.size, first, strict=True))
    if filter == EXACT_SINC:
        return dirichlet_magnify(image.data, factor)[factor * y : factor * y + height, factor * x : factor * x + width]
    index = np.stack(np.meshgrid(x + np.arange(width) / factor, y + np.arange(height) / factor), -1)
    return sample(image, image.index_to_world(index), filter, device=device).astype(np.float64)


def draw(
    filters: Sequence[str | Filter] = FIGURE_6,
    samples: int = 49,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Figure 5: a photograph and a zone plate of few samples, magnified 4 times by each filter, and parts of them 16 times.

    The photograph is low-passed by a Gaussian before it is decimated, as in a camera. Errors are relative to the low-passed one.

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
    require_room("samples", (_NEAR * samples) ** 2, samples)
    size = _FACTOR * (samples - 1) + 1
    photo, what = photograph(2 * size)
    # at full sharpness, then low-passed for fewer pixels
    original = photo.gaussian(1).downsample(2)
    soft, plate = original.gaussian(_FACTOR), Volume(zone_plate_image(size, samples))
    starts = [(int(x * samples), int(y * samples)) for x, y in (_COLLAR, _CORNER)]
    x, y = starts[0]
    collar = finer(soft, _NEAR // _FACTOR, "bspline3", device, (_FACTOR * x, _FACTOR * y), (size, size))
    x, y = starts[1]
    corner = np.stack(np.meshgrid(*(2 * (first + np.arange(size) / _NEAR) / (samples - 1) - 1 for first in (x, y))), -1)
    inputs = [  # name, input, its samples, start of the close-up, the truth in it
        (what, soft.data, soft.downsample(_FACTOR), starts[0], collar),
        ("zone plate", plate.data, plate.downsample(_FACTOR), starts[1], zone_plate(corner, samples)),
    ]
    inner = (slice(2 * _FACTOR, -2 * _FACTOR),) * 2
    numbers: list[dict[str, Any]] = []
    with styled():
        figure, panels, times = tiles(4, len(chosen) + 1, (size, size), above=2, between=1)
        for column, drawer in enumerate(counted(chosen, progress)):
            name = drawer.name if isinstance(drawer, Filter) else drawer
            for row, (kind, truth, few, start, _) in enumerate(inputs):
                drawn = finer(few, _FACTOR, drawer, device)
                rms = float(np.sqrt(np.mean((drawn[inner] - truth[inner]) ** 2)))
                numbers.append({"input": kind, "filter": name, "rms": rms})
                heading = folded(f"{LETTERS[column]})  {title(name)}", times * size) if row == 0 else ""
                show(panels[2 * row, column], drawn, heading, f"RMS {rms:.4f}", vmin=0, vmax=1)
                show(panels[2 * row + 1, column], finer(few, _NEAR, drawer, device, start, (size, size)), "", vmin=0, vmax=1)
        headings = [folded(f"{what}, low-passed", times * size), ""]
        notes = [f"{size}², given {samples}²", "the function itself"]
        for row, (_, truth, _, _, close) in enumerate(inputs):
            show(panels[2 * row, -1], truth, headings[row], notes[row], vmin=0, vmax=1)
            show(panels[2 * row + 1, -1], close, "", vmin=0, vmax=1)
    lines = [f"{n['input']}, {title(n['filter'])}: RMS error {n['rms']:.4f}" for n in numbers]
    return Drawing(figure, numbers, lines)
