"""Filters whose smoothing is decided for a volume."""

from __future__ import annotations

from dataclasses import replace

from clvol.errors import OptionError
from clvol.filter import Filter, as_filter
from clvol.volume import Volume

__all__ = ["settled"]


def settled(filter: str | Filter, volume: Volume) -> Filter:
    """A row as it is for a volume: one whose smoothing is "auto" or a length has numbers instead, and its name says them.

    Raises
    ------
    OptionError
        Its smoothing has another number of axes than the volume, or is too much for float32.
    """
    row = as_filter(filter)
    if row.magnified_by is not None and not row.magnified_by.settled:
        row = replace(row, magnify=settled(row.magnified_by, volume).name)
    if isinstance(row.smoothing, tuple) and len(row.smoothing) != volume.ndim:
        raise OptionError(f"smoothing must be one number, or {volume.ndim} for a volume of {volume.ndim} axes; got {row.name!r}")
    if row.settled:
        return row
    if row.length is not None:
        length = row.length
        return row.smoothed([float(f"{(length / s) ** (2 * row.penalty):.6g}") for s in volume.spacing])
    from clvol.smoothing import choose

    return row.smoothed(choose(volume, row.degree).values)
