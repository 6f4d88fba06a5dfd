"""Omit every second sample along an axis and predict it from the others: the loss between slices."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, InitVar, dataclass

import numpy as np
from numpy.typing import ArrayLike

from clvol.analysis.comparison import as_compared, lattice_of, require_period, settled_compared
from clvol.analysis.table import Table, column
from clvol.base.arrays import Array
from clvol.base.checks import enough_memory, number
from clvol.base.progress import Progress, counted
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.volume.volume import Volume, as_volume

__all__ = ["LeftOutRow", "LeftOutTable", "leave_out"]

_FEWEST = 8  # samples along an axis


@dataclass(frozen=True)
class LeftOutRow:
    """A filter's RMS error at the samples omitted along each axis, in the data's units, without the noise.

    Attributes
    ----------
    filter : str
        Name of the filter.
    x, y, z : float or None
        None along axes of fewer than eight samples, and along z of an image.
    """

    filter: str = column("filter")
    x: float | None = column("left out along x", ".3g")
    y: float | None = column("along y", ".3g")
    z: float | None = column("along z", ".3g")


@dataclass(eq=False, repr=False)
class LeftOutTable(Table[LeftOutRow]):
    """A row for each filter, in the requested order.

    Attributes
    ----------
    sigma : float
        Standard deviation of the subtracted noise, the mean over all samples.
    spacing : tuple of float
        Of all samples along x, y[, z]; for the kept samples it was doubled along one axis.
    """

    rows: InitVar[Iterable[LeftOutRow]]
    _: KW_ONLY
    sigma: float
    spacing: tuple[float, ...]


@enough_memory("what is left out")
def leave_out(
    volume: Volume | ArrayLike,
    filters: Sequence[str | Filter],
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    sigma: float | None = None,
    margin: float = 4.0,
    progress: Progress | None = None,
) -> LeftOutTable:
    """Predict every second sample along each axis from the others, and vice versa.

    This is the paper's question of slices that are too far apart, and nothing is blurred for it. White noise in the omitted
    samples is independent of the kept ones: the squared difference is the squared error plus the variance of the noise, which is
    the same for every filter, so that filters rank by their errors. The variance is subtracted. (Correlated noise is not
    independent; then nothing is subtracted.) Detail finer than the kept samples can represent is lost, so errors are larger than
    those of a reconstruction from all samples.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    filters : sequence of str or Filter
        One row each; they act along all axes, as for a slice between two others.
    boundary : str or Boundary
        As for `clvol.sample`.
    sigma : float, optional
        Standard deviation of white noise, the root of the mean variance of all samples; default: from `Volume.noise`, with none
        in the background, and 0 for correlated noise.
    margin : float
        Kept samples at each end that are not compared.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    OptionError
        An unknown name, or a number outside its bounds.
    DataError
        NaN or infinite samples.
    OutOfMemoryError
        The volume does not fit into memory as float64.

    Examples
    --------
    >>> from clvol import analysis, phantoms
    >>> table = analysis.leave_out(phantoms.marschner_lobb(32), ["linear", "bspline3"])
    >>> [row.filter for row in table]
    ['linear', 'bspline3']
    """
    chosen, volume, rule = as_compared(filters), as_volume(volume), as_boundary(boundary)
    margin = number("margin", margin, minimum=0)
    require_period(chosen, rule)
    volume.require_finite()
    chosen = settled_compared(chosen, volume)
    if sigma is None:
        noise = volume.noise
        share = 1.0 if noise.background is None else 1 - noise.background_share
        known = 0.0 if max(noise.colour, default=1.0) > 1 else noise.rms * math.sqrt(share)
    else:
        known = number("sigma", sigma, minimum=0)
    unit = max(abs(v) for v in volume.value_range) or 1.0  # so that no square overflows or underflows
    data = volume.data.astype(np.float64) / unit
    rows = []
    for row in counted(chosen, progress):
        errors: dict[str, float | None] = dict.fromkeys("xyz")
        for axis, name in zip(range(data.ndim), "zyx"[-data.ndim :], strict=True):
            if data.shape[axis] >= _FEWEST:
                square = _left_out(data, axis, row, rule, margin)
                errors[name] = unit * math.sqrt(max(0.0, square - (known / unit) ** 2))
        rows.append(LeftOutRow(row.name if isinstance(row, Filter) else row, **errors))
    return LeftOutTable(rows, sigma=known, spacing=volume.spacing)


def _left_out(data: Array, axis: int, row: str | Filter, rule: Boundary, margin: float) -> float:
    """Mean squared difference between samples of each parity and the prediction from the others."""
    total = count = 0.0
    for kept in (0, 1):
        take = [slice(None)] * data.ndim
        take[axis] = slice(kept, None, 2)
        known = data[tuple(take)]
        n = known.shape[axis]
        skipped = min(margin, (n - 1) / 4)
        places = np.arange(n - 1) + 0.5  # kept + 2 (i + 1/2) is the sample between the kept ones i and i + 1
        places = places[(places >= skipped) & (places <= n - 1 - skipped)]
        if not places.size:
            continue
        axes = [np.arange(m, dtype=np.float64) for m in known.shape]
        axes[axis] = places
        truth = np.take(data, (kept + 2 * places).astype(np.int64), axis)
        error = lattice_of(known, axes, row, rule) - truth
        total += float((error**2).sum())
        count += error.size
    return total / count
