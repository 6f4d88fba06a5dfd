"""Low-passes before coarser grids, block by block: sums along one axis after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from clvol.base.rounding import wide
from clvol.dask.blocks import Array, OutputBlock, Span, blockwise
from clvol.device import as_device
from clvol.spline.reduce import TRUNCATE, Sums, sum_along

__all__ = ["axis_by_axis", "gaussian_radius"]


def gaussian_radius(sigma: float) -> int:
    """The radius of a Gaussian in samples."""
    return int(TRUNCATE * sigma + 0.5) if sigma > 0 else 0


Axis: TypeAlias = tuple[int, Callable[[], Sums | None]]
"""An axis, and the sums that replace it; each process computes them once, and caches them."""


class Ends(Protocol):
    """How sums begin, and what becomes of them."""

    def begin(self, samples: Array, block: OutputBlock) -> tuple[type[np.generic], bool]:
        """From the samples that a block reads to the type that sums are made in, and whether they lie far from zero.

        Refuses samples that are not finite.
        """

    def end(self, values: Array, block: OutputBlock) -> Array:
        """From sums along all axes to a block of the result."""


def axis_by_axis(
    name: str,
    source: Any,
    chunks: tuple[Any, ...],
    dtype: np.dtype[Any],
    axes: Sequence[Axis],
    kind: type[np.generic],
    ends: Ends,
    outside: float,
    device: Any,
    identity: Sequence[object],
) -> Any:
    """An array of dask whose axes are replaced by sums, one after the other.

    Sums have so many terms that a block of sums along all axes would read 8 chunks for one of its own. Along one axis it reads the
    row that it lies in, and the next axis has fewer blocks.

    `axes` are in the order in which they are summed up; without any, blocks begin and end as they are. `kind` is that of sums, as
    far as it is known before samples are (between axes float64 holds those of samples that float32 does not); `outside` the samples
    where a boundary rule puts none.
    """
    if not axes:
        return blockwise(name, source, chunks, dtype, lambda _, where: (where, None), _Unsummed(ends), identity)
    made, between = source, np.dtype(np.float64 if wide(source.dtype) else kind)
    for number, (axis, sums) in enumerate(axes, 1):
        last = number == len(axes)
        sizes = chunks if last else (*made.chunks[:axis], chunks[axis], *made.chunks[axis + 1 :])
        stage = _Stage(axis, sums, outside, device, ends, number == 1, last)
        about = [*identity, axis, number, len(axes)]
        made = blockwise(f"{name}-along-{axis}", made, sizes, dtype if last else between, stage.plan, stage, about)
    return made


@dataclass(frozen=True, eq=False)
class _Stage:
    """Sums along one of the axes. The dtype of its result is that of the sums along the next."""

    axis: int
    sums: Callable[[], Sums | None]
    outside: float
    device: Any
    ends: Ends
    first: bool
    last: bool

    def plan(self, _: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...], None]:
        """What a block reads."""
        return (*where[: self.axis], _span_of(self._all(), where[self.axis]), *where[self.axis + 1 :]), None

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        assert block.spans is not None
        wider = self.first or samples.dtype == np.float64
        kind, far = self.ends.begin(samples, block) if wider else (np.float32, False)
        place = block.place[self.axis]
        sums = {self.axis: _sums_within(self._all(), place, block.spans[self.axis])}
        values = sum_along(samples, sums, kind, as_device(self.device), self.outside, far=far)
        return self.ends.end(values, block) if self.last else values

    def _all(self) -> Sums:
        sums = self.sums()
        assert sums is not None  # an axis that gets shorter has some
        return sums


@dataclass(frozen=True, eq=False)
class _Unsummed:
    """A block without sums."""

    ends: Ends

    def __call__(self, samples: Array, block: OutputBlock) -> Array:
        return self.ends.end(np.asarray(samples, self.ends.begin(samples, block)[0]), block)


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
