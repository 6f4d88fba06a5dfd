"""The values at one place along a series of volumes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from clvol.base.errors import OptionError
from clvol.filter.boundary import as_boundary
from clvol.filter.margin import reach
from clvol.filter.table import as_filter
from clvol.spline.scatter import adjoint
from clvol.view.catalog import series_of
from clvol.view.protocol import Message
from clvol.view.renderers import rule_of
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["curve", "what_curve"]

_DIGITS = 7
_LOCAL = ("mirror", "reflect", "zero")  # boundary rules by which only samples of the same end count


def what_curve(resident: Resident, state: State) -> tuple[Any, ...] | None:
    """All that the curve of a state depends on; None if there is no series."""
    volumes = resident.catalog.volumes
    axis = None if volumes is None else series_of(volumes.leading)
    if axis is None:
        return None
    others = {name: place for name, place in resident.catalog.places(state).items() if name != axis}
    return axis, _place(resident, state), state.filter, state.boundary, state.mode, tuple(others.items())


def _place(resident: Resident, state: State) -> tuple[float, ...]:
    return state.crosshair or tuple(map(float, resident.volume.center))


def curve(resident: Resident, state: State, gone: Callable[[], bool]) -> Message | None:
    """The function of each volume of the series at the crosshair, with the filter as it is settled for the one that is shown.

    The value at one place is linear in the samples: their weights are computed once, by the adjoint of sampling. None where
    samples are not finite; no message once `gone` says that nobody waits for it.

    Raises
    ------
    OptionError
        The crosshair is outside the volume, or filter and boundary rule are not linear there.
    """
    volumes = resident.catalog.volumes
    axis = None if volumes is None else series_of(volumes.leading)
    assert volumes is not None  # the caller asked `what_curve`
    assert axis is not None
    place, row, rule = _place(resident, state), as_filter(resident.filter_name(state, state.filter)), rule_of(state.boundary)
    grid = resident.volume
    index = grid.world_to_index(np.asarray(place))
    if not all(-0.5 <= at <= n - 0.5 for at, n in zip(index, grid.size, strict=True)):
        raise OptionError("the crosshair is outside the volume")
    far = (reach(row) if row.prefilter else 0) + row.support
    low = [max(0, math.floor(at) - far) for at in index]
    high = [min(n, math.floor(at) + far + 2) for at, n in zip(index, grid.size, strict=True)]
    at_ends = [a == 0 or b == n for a, b, n in zip(low, high, grid.size, strict=True)]
    if not any(at_ends):
        rule = as_boundary(_LOCAL[0])  # it makes no difference, and not all are linear
    elif rule.name not in _LOCAL:  # samples of the other end may count, too
        low = [0 if ends else a for a, ends in zip(low, at_ends, strict=True)]
        high = [n if ends else b for b, n, ends in zip(high, grid.size, at_ends, strict=True)]
    weights = adjoint(np.ones(1), np.array([place]), grid.crop(low, high), row, rule, device=resident.device).astype(np.float64)
    part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    samples, leading = np.asarray(volumes), volumes.leading
    places = resident.catalog.places(state)
    values: list[float | None] = []
    for at in range(leading.counts[leading.axes.index(axis)]):
        if gone():
            return None
        where = {**places, axis: at}
        named = [where.get(name, 0) for name in leading.axes]
        block = samples[(*(slice(None) if isinstance(one, str) else one for one in named), *part)]
        block = leading.combined(block, 0) if any(isinstance(one, str) for one in named) else block
        value = float(np.vdot(weights, block.astype(np.float64)))
        values.append(float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None)
    return {"type": "curve", "axis": axis, "position": list(place), "values": values}
