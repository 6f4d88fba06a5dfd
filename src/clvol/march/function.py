"""The function of a volume that pictures show: its filter, and what continues it where samples are missing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, OptionError
from clvol.filter.table import PICTURE_FILTER
from clvol.spline.field import Field
from clvol.spline.regions import Regions, region_filter, require_labels
from clvol.volume.missing import Missing, extrapolated
from clvol.volume.smoothing import filter_for
from clvol.volume.stored import names_beyond, too_large_names
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.bricks.source import LazyVolume
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter

__all__ = ["extrapolated_samples", "lacks_samples", "regions_of", "row_for", "single"]


def row_for(volume: Volume | LazyVolume, filter: str | Filter | None, usual: str = PICTURE_FILTER) -> str | Filter | None:
    """The filter of all levels of a volume in one picture; None: that of its bounds."""
    if filter is not None or volume.bounds is not None:
        return filter
    return filter_for(volume.part(), None, usual)


class _Shown(Field):
    """A field whose values are NaN where pictures show nothing."""

    def _filled(self, where: NDArray[np.bool_]) -> NDArray[Any]:
        return extrapolated_samples(self.volume, where)

    def _gaps_at(self, where: NDArray[np.bool_]) -> Field:
        row = "nearest" if self.filter.support == 1 else "linear"
        return Field(replace(self.volume, data=where), row, "reflect", self.device)


def lacks_samples(volume: Volume) -> bool:
    """Whether samples are missing: NaN or infinite. `DataError` if all are."""
    if volume.data.dtype.kind != "f" or np.isfinite(volume.limits).all():
        return False
    _ = volume.value_range  # which raises
    return True


def extrapolated_samples(volume: Volume, where: NDArray[np.bool_]) -> NDArray[Any]:
    """The samples, with values in the place of those that are missing."""
    low, high = volume.value_range
    return extrapolated(volume.data, where, low / 2 + high / 2)


def single(volume: Volume, row: Filter, boundary: Boundary, device: Device | str | int | None) -> Field:
    """A field in single precision, as kernels of pictures read; float32 must distinguish the labels."""
    if names_beyond(24, volume, row):
        raise DataError(too_large_names(*map(int, volume.limits)))
    if lacks_samples(volume):
        return _Shown(volume, row, boundary, device, precision="single", nan=Missing("local", most=0.5))
    return Field(volume, row, boundary, device, precision="single")


def regions_of(volume: Any, filter: str | Filter | None, boundary: Boundary, device: Device) -> Regions:
    """The regions of labels as pictures show them; float32 must distinguish the labels."""
    if not isinstance(volume, Volume):
        raise OptionError(
            f"smooth boundaries are of labels in memory: a LazyVolume gives them by whole(), a Field by volume; got {volume!r}"
        )
    if not volume.is_labels:
        raise OptionError("smooth is for labels, and these samples look like none; Volume(..., labels=True) says that they are")
    require_labels(volume)
    return Regions(volume, region_filter(filter), boundary, device)
