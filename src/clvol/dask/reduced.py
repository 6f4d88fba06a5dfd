"""Low-passes before coarser grids, block by block: sums along one axis after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from clvol.dask.blocks import Array, Floats, OutputBlock, Span, blockwise
from clvol.device import as_device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.spline.reduce import TRUNCATE, Sums, least_squares, sum_along

__all__ = ["Reduction", "Summed", "axis_by_axis", "gaussian_radius"]


def gaussian_radius(sigma: float) -> int:
    """The radius of a Gaussian in samples."""
    return int(TRUNCATE * sigma + 0.5) if sigma > 0 else 0


@dataclass(frozen=True)
class Reduction:
    """The arguments of `clvol.spline.reduce.least_squares` for an axis; each process computes the sums once, and caches them."""

    filter: Filter
    start: float
    step: float
    m: int
    n: int
    boundary: Boundary
    double: bool
    prefilter: bool

    @classmethod
    def at(cls, filter: Filter, positions: Floats, n: int, boundary: Boundary, double: bool, prefilter: bool = True) -> Reduction:
        """For evenly spaced samples; a single one stands for the whole axis."""
        m = len(positions)
        step = float(positions[-1] - positions[0]) / (m - 1) if m > 1 else float(n)
        return cls(filter, float(positions[0]), step, m, n, boundary, double, prefilter)

    @property
    def sums(self) -> Sums:
        """Of all of the axis."""
        return least_squares(self.filter, self.start, self.step, self.m, self.n, self.boundary, self.double, self.prefilter)


# -- one axis after the other ----------------------------------------------------------------------------------------


class Summed(Protocol):
    """An axis that is replaced by sums along it."""

    @property
    def sums(self) -> Sums:
        """Of all of the axis."""


Begin: TypeAlias = Callable[[Array, OutputBlock], type[np.generic]]
"""From the samples that a block reads to the type that sums are made in; refuses samples that are not finite."""
End: TypeAlias = Callable[[Array, OutputBlock], Array]
"""From sums along all axes to a block of the result."""


def axis_by_axis(
    name: str,
    source: Any,
    chunks: tuple[Any, ...],
    dtype: np.dtype[Any],
    axes: Sequence[tuple[int, Summed]],
    kind: type[np.generic],
    begin: Begin,
    end: End,
    outside: float,
    device: Any,
    identity: Sequence[object],
) -> Any:
    """An array of dask whose axes are replaced by sums, one after the other.

    Sums have so many terms that a block of sums along all axes would read 8 chunks for one of its own. Along one axis it reads the
    row that it lies in, and the next axis has fewer blocks.

    `axes` are in the order in which they are summed up; without any, blocks begin and end as they are. `kind` is that of sums, as
    far as it is known before samples are; `outside` the samples where a boundary rule puts none.
    """
    if not axes:
        return blockwise(name, source, chunks, dtype, lambda _, where: (where, None), _Unsummed(begin, end), identity)
    made = source
    for number, (axis, own) in enumerate(axes, 1):
        first, last = number == 1, number == len(axes)
        sizes = chunks if last else (*made.chunks[:axis], chunks[axis], *made.chunks[axis + 1 :])
        stage = _Stage(axis, own, outside, device, begin if first else None, end if last else None)
        about = [*identity, axis, number, len(axes)]
        made = blockwise(f"{name}-along-{axis}", made, sizes, dtype if last else np.dtype(kind), stage.plan, stage, about)
    return made


@dataclass(frozen=True, eq=False)
class _Stage:
    """Sums along one of the axes. The dtype of its result is that of the sums along the next."""

    axis: int
    own: Summed
    outside: float
    device: Any
    begin: Begin | None
    end: End | None

    def plan(self, _: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...], None]:
        """What a block reads."""
        return (*where[: self.axis], _span_of(self.own.sums, where[self.axis]), *where[self.axis + 1 :]), None

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        assert block.spans is not None
        kind = samples.dtype.type if self.begin is None else self.begin(samples, block)
        place = block.place[self.axis]
        sums = {self.axis: _sums_within(self.own.sums, place, block.spans[self.axis])}
        values = sum_along(samples, sums, kind, as_device(self.device), self.outside)
        return values if self.end is None else self.end(values, block)


@dataclass(frozen=True, eq=False)
class _Unsummed:
    """A block without sums."""

    begin: Begin
    end: End

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        return self.end(np.asarray(samples, self.begin(samples, block)), block)


def _span_of(sums: Sums, place: Span) -> Span:
    """The samples that some sums have as terms."""
    places = sums.places[place[0] : place[1]]
    within = places[places < sums.n]
    return (int(within.min()), int(within.max()) + 1) if within.size else (0, 1)


def _sums_within(sums: Sums, place: Span, span: Span) -> Sums:
    """Some of the sums, with samples counted from the start of a span."""
    rows, length = slice(*place), span[1] - span[0]
    places = np.where(sums.places[rows] == sums.n, length, sums.places[rows] - span[0])
    return Sums(length, places.astype(np.int32), np.ascontiguousarray(sums.weights[rows]))
