"""Rotate an image repeatedly until it is upright: a filter's losses accumulate, and the truth is known without a low-pass.

P. Thévenaz, T. Blu and M. Unser, *Interpolation revisited*, IEEE Trans. Medical Imaging 19 (2000), section V.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, InitVar, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from clvol import reference
from clvol.analysis.comparison import as_compared, require_period, settled_compared
from clvol.analysis.dirichlet import dirichlet_sample
from clvol.analysis.similarity import ssim
from clvol.analysis.table import Table, column
from clvol.analysis.trial import middle_part
from clvol.base.checks import enough_memory, number, whole
from clvol.base.errors import DataError
from clvol.base.progress import Progress
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.volume.volume import Volume, as_volume

__all__ = ["RotationRow", "RotationTable", "rotations"]


@dataclass(frozen=True)
class RotationRow:
    """The error of an image after all turns, for one filter.

    Attributes
    ----------
    filter : str
        Name of the filter.
    rms, maximum : float
        Root mean square and largest difference from the image within the disc, in the data's units.
    ssim : float or None
        Structural similarity (`ssim`) within the square in the disc; None for constant data.
    """

    filter: str = column("filter")
    rms: float = column("RMS error", ".3g")
    maximum: float = column("max error", ".3g")
    ssim: float | None = column("SSIM", ".4f")


@dataclass(eq=False, repr=False)
class RotationTable(Table[RotationRow]):
    """A row for each filter, in the requested order.

    Attributes
    ----------
    image : Volume
        The 2-D image.
    turns : int
        Number of turns, by ``360 / turns`` degrees each.
    pixels : int
        Number of pixels compared.
    boundary : str
        The boundary rule.
    """

    rows: InitVar[Iterable[RotationRow]]
    _: KW_ONLY
    image: Volume
    turns: int
    pixels: int
    boundary: str


@enough_memory("what is turned")
def rotations(
    source: Volume | ArrayLike,
    filters: Sequence[str | Filter],
    turns: int = 9,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    margin: float = 8.0,
    max_pixels: int = 1 << 16,
    progress: Progress | None = None,
) -> RotationTable:
    """Rotate an image about its middle until it is upright again, by each filter, and compare it with itself.

    Every turn resamples the whole image from the last one; nine of 40° are a full circle. The pixels of the disc that never leaves
    the image are compared. Noise counts as part of the image: smoothing it is an error.

    Parameters
    ----------
    source : Volume or array-like
        An image, or a volume, of which the middle slice across its first axis is used.
    filters : sequence of str or Filter
        One row each; "auto" smoothing is chosen for the volume. The time of the exact sinc grows with the square of the number
        of pixels.
    turns : int
        2 to 360.
    boundary : str or Boundary
        How the image continues outside.
    margin : float
        Pixels between the disc and the edges.
    max_pixels : int
        Only the middle of a larger image is used.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    OptionError
        An unknown name, or a number outside its bounds.
    DataError
        NaN or infinite samples, or an image too small for the disc.
    OutOfMemoryError
        The image does not fit into memory.
    """
    chosen, volume, rule = as_compared(filters), as_volume(source), as_boundary(boundary)
    turns, margin = whole("turns", turns, 2, 360), number("margin", margin, minimum=0)
    require_period(chosen, rule)
    image = volume
    if volume.ndim == 3:
        image = Volume(volume.data[volume.shape[0] // 2], volume.spacing[:2], units=volume.units)
    image = middle_part(image, whole("max_pixels", max_pixels, 1))
    image.require_finite()
    chosen = settled_compared(chosen, volume)
    low, high = image.value_range
    unit = max(abs(low), abs(high)) or 1.0  # so that no square overflows or underflows
    start = replace(image, data=image.data.astype(np.float64) / unit)
    height, width = image.shape
    y, x = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    away = image.index_to_world(np.stack([x, y], -1)) - image.center
    least = min((n - 1) / 2 * s for n, s in zip(image.size, image.spacing, strict=True)) - margin * max(image.spacing)
    disc = np.linalg.norm(away, axis=-1) <= least
    if least <= 0 or not disc.any():
        raise DataError(f"an image to be turned must be wider than twice the margin of {margin:g} pixels; got shape {image.shape}")
    angle = 2 * np.pi / turns
    turned = away @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + image.center
    rows_of, columns_of = np.flatnonzero(disc.any(1)), np.flatnonzero(disc.any(0))
    square = np.ix_(rows_of, columns_of)
    report, rows = progress or (lambda _: None), []
    for done, row in enumerate(chosen):
        now, drawer = start, _in_a_slice(row) if isinstance(row, Filter) else None
        for turn in range(turns):
            drawn = dirichlet_sample(now, turned, rule) if drawer is None else reference.sample(now, turned, drawer, rule)
            now = replace(now, data=drawn)
            report((done + (turn + 1) / turns) / len(chosen))
        error = (now.data - start.data)[disc]
        rows.append(
            RotationRow(
                row.name if isinstance(row, Filter) else row,
                unit * float(np.sqrt(np.mean(error**2))),
                unit * float(np.abs(error).max()),
                ssim(now.data[square], start.data[square], (high - low) / unit) if high > low else None,
            )
        )
    return RotationTable(rows, image=image, turns=turns, pixels=int(disc.sum()), boundary=rule.name)


def _in_a_slice(row: Filter) -> Filter:
    """A volume's filter for a slice of it: from λ by axis, those along x and y."""
    return row.smoothed(row.smoothing[:2]) if isinstance(row.smoothing, tuple) else row
