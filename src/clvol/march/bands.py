"""Narrow bands of opacity, which values may cross between two samples of a ray, and the virtual samples that they need."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.scene.mode import MOST_VIRTUAL

if TYPE_CHECKING:
    from clvol.march.options import Fineness, ResolvedLook
    from clvol.march.source import Source
    from clvol.volume.volume import Volume

__all__ = ["narrow_bands", "with_virtual"]

_NARROW = 0.1  # of the range of the samples: wider bands are not looked at
_PAIRS = 1 << 18  # neighbours that are compared along an axis
_PASSES = 8
_IN_BAND = 2  # virtual samples in a band, at least


def with_virtual(look: ResolvedLook, source: Source, fine: Fineness, step: float | None) -> ResolvedLook:
    """A look with the virtual samples that narrow bands need, where all of that is left open, and there can be some.

    `step`: the one that was asked for, if one was.
    """
    left_open = step is None and fine.tolerance is None and getattr(look.mode, "virtual", 0) is None
    if not left_open or source.by_bricks or look.others or look.unsettled or look.central or look.transfer.graded:
        return look
    if not source.filter_of(look.mode).has_gradient:
        return look
    found = look.once(("virtual", fine.step), lambda: _with_virtual(look, fine.step))
    return look if found is None else found.seen_by(look.camera)


def _with_virtual(look: ResolvedLook, step: float) -> ResolvedLook | None:
    missed = max((change / (last - first) for first, last, change in narrow_bands(look, step) if first < last), default=0.0)
    between: dict[str, Any] = {"virtual": min(MOST_VIRTUAL, math.ceil(_IN_BAND * missed))}
    return replace(look, mode=replace(look.mode, **between)) if missed > 1 else None


def narrow_bands(look: ResolvedLook, step: float) -> Iterator[tuple[float, float, float]]:
    """Narrow bands of matter: the values where they begin and end, and by how much values change there from sample to sample."""
    if look.mode.shows != "matter":
        return
    low, high = look.preview.value_range
    apart = look.preview.mean_spacing / look.scene.media[0].volume.mean_spacing
    for first, last in _bands(look.transfer.opacities):
        middle = first / 2 + last / 2
        if last - first <= _NARROW * (high - low) and low < middle < high:
            yield first, last, step * _slope_at(look.preview, middle) / apart


def _bands(opacities: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Where opacity rises and falls again: from half of a maximum to half of it."""
    values, seen = np.array(opacities, np.float64).T
    for k in range(1, len(seen) - 1):
        left, right = np.flatnonzero(seen[:k] <= seen[k] / 2), np.flatnonzero(seen[k + 1 :] <= seen[k] / 2)
        if seen[k] == 0 or not len(left) or not len(right):
            continue
        i, j = int(left[-1]), k + 1 + int(right[0])
        if seen[i : j + 1].max() == seen[k]:
            rise, fall = slice(i, i + 2), slice(j, j - 2 if j > 1 else None, -1)
            yield float(np.interp(seen[k] / 2, seen[rise], values[rise])), float(np.interp(seen[k] / 2, seen[fall], values[fall]))


def _slope_at(volume: Volume, value: float) -> float:
    """The usual change from sample to sample where they pass a value, along the axis where that is largest; 0 if few do."""
    found = [0.0]
    stride = max(1, round((volume.data.size / _PAIRS) ** 0.5))
    for axis in range(3):
        some = tuple(slice(None) if other == axis else slice(None, None, stride) for other in range(3))
        lines = np.moveaxis(volume.data[some], axis, 0).astype(np.float64)
        passes = (lines[1:] > value) != (lines[:-1] > value)
        if np.count_nonzero(passes) >= _PASSES:
            found.append(float(np.median(np.abs(lines[1:] - lines[:-1])[passes])))
    return max(found)
