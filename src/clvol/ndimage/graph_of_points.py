"""Points of arrays of dask, block by block.

Each point belongs to the chunk of the input that it lies in. Where coordinates are in memory, a block of the result reads only the
chunks of its points. Where they are an array of dask, every chunk is read for each block of points, and evaluates those in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph

from clvol.base.errors import OptionError
from clvol.dask.blocks import (
    Array,
    Asked,
    Chunks,
    Floats,
    Gathering,
    Margin,
    OutputBlock,
    Span,
    blocks_of,
    blockwise,
    gathered,
    located,
    margin,
    named,
    spans,
    support_along,
    turn,
)
from clvol.device import as_device
from clvol.filter.boundary import Boundary
from clvol.interop.dispatch import is_lazy
from clvol.ndimage import engine, in_memory
from clvol.ndimage.arguments import FINITE, Spline, require_finite
from clvol.ndimage.plan import Points
from clvol.spline.field import Precision

__all__ = ["at_points", "margin_of"]

_POINTS = 1 << 20
"""Points in a block of the result, where coordinates are in memory and no chunks are given."""
_PADDED = ("nearest", "grid-constant")
"""Modes whose coefficients go on past the samples: a spline of coefficients alone is another one."""

_Some: TypeAlias = tuple[Array, Floats]
"""The numbers of points in a block, and their positions."""


def at_points(source: Any, plan: Points, chunks: Chunks, dtype: np.dtype[Any]) -> Any:
    """The spline at points; the source, the coordinates, or both are arrays of dask."""
    at = plan.coordinates
    if is_lazy(at):
        if chunks is not None:
            raise OptionError(f"chunks are those of the coordinates, which are an array of dask; got {chunks!r}")
        at = at.rechunk({0: -1})
        pieces = at.chunks[1:]
    else:
        given = "auto" if chunks is None else chunks
        limit = _POINTS * dtype.itemsize if chunks is None else None
        try:
            pieces = da.core.normalize_chunks(given, at.shape[1:], limit=limit, dtype=dtype)
        except (TypeError, ValueError, NotImplementedError) as error:
            raise OptionError(f"chunks must fit points of shape {at.shape[1:]}; got {chunks!r}: {error}") from None
    work = _Work(list(plan.axes), plan.spline, dtype)
    return work.of_chunks(source, at, pieces) if is_lazy(source) else work.of_array(source, at)


def margin_of(spline: Spline, dtype: np.dtype[Any]) -> Margin:
    """How many samples before and after a position its value depends on; booleans are computed in double precision."""
    precision: Precision = "double" if dtype.kind == "b" else spline.precision
    return margin(engine.row_of(spline.order, spline.prefilter), precision)


@dataclass(frozen=True, eq=False)
class _Work:
    """What all tasks have in common: axes that points have coordinates for, options, and the dtype of the result."""

    along: list[int]
    spline: Spline
    dtype: np.dtype[Any]

    def name(self, *of: object) -> str:
        """The key of the result."""
        return f"map_coordinates-{tokenize(*of, self.along, str(self.dtype), *self.spline.identity)}"

    def of_array(self, data: Array, at: Any) -> Any:
        """Blocks of coordinates at an array that every process gets: its coefficients, where the mode does without samples."""
        spline = self.spline
        require_finite(data, spline.nan)
        source = held = da.from_array(data, chunks=-1, name=f"samples-{tokenize(data)}")
        work = replace(self, spline=replace(spline, nan="propagate"))
        if spline.prefilter and spline.order > 1 and spline.mode not in _PADDED:
            kind = np.dtype(np.complex128 if data.dtype.kind == "c" else np.float64)
            about = [*spline.identity, self.along]
            held = blockwise("coefficients", source, source.chunks, kind, lambda _, where: (where, None), work.coefficients, about)
            work = replace(work, spline=replace(work.spline, prefilter=False))
        name = self.name(held.name, at.name)
        kept = [n for axis, n in enumerate(data.shape) if axis not in self.along]
        chunks = (*((n,) for n in kept), *at.chunks[1:])
        layer: dict[Any, Any] = {}
        for block in blocks_of("map_coordinates", chunks, data.shape):
            points = (at.name, 0, *block.index[len(kept) :])
            layer[(name, *block.index)] = (_at_array, work, block, (held.name, *[0] * data.ndim), points, held is not source)
        graph = HighLevelGraph.from_collections(name, layer, dependencies=[held, at])
        return da.Array(graph, name, chunks, dtype=self.dtype)

    def coefficients(self, samples: Array, _: OutputBlock) -> Array:
        """Coefficients of an array, in the type that they are computed in."""
        spline, part = self.spline, samples.real if samples.dtype.kind == "c" else samples
        kind = np.dtype(engine.kind_for(spline.precision, part, np.empty(0), as_device(spline.device)))
        made = np.empty(samples.shape, np.result_type(kind, np.complex64) if samples.dtype.kind == "c" else kind)
        in_memory.filtered(samples, self.along, made, spline)
        return made

    def of_chunks(self, source: Any, at: Any, pieces: tuple[Any, ...]) -> Any:
        """Points of a block go to the chunks that they lie in, whose values are put together."""
        known, chunks = not is_lazy(at), _Chunks(source, self.along, self.spline.boundary)
        name = self.name(source.name, at if known else at.name, pieces)
        reads = _Reads(name, source, self)
        layer: dict[Any, Any] = {}
        everywhere = list(product(*(numbers.tolist() for numbers in chunks.numbers))) if source.size else []
        kept = [axis for axis in range(source.ndim) if axis not in self.along]
        result = (*(source.chunks[axis] for axis in kept), *pieces)
        partitions: dict[tuple[int, ...], Any] = {}
        for block in blocks_of("map_coordinates", result, source.shape):
            index = block.index
            batch, piece = index[: len(kept)], index[len(kept) :]
            if piece not in partitions:
                if known:
                    own = at[(slice(None), *(slice(*place) for place in block.place[len(kept) :]))]
                    partitions[piece] = chunks.parted(own)
                else:
                    partitions[piece] = (f"{name}-parted", *piece)
                    layer[partitions[piece]] = (chunks.parted, (at.name, 0, *piece))
            parted, parts = partitions[piece], []
            if all(block.shape):
                for chunk in sorted(parted) if known else everywhere:
                    key, own_spans = reads.part(dict(zip([*kept, *self.along], batch + chunk, strict=True)))
                    task = _Part(self, replace(block, spans=own_spans), chunk, parted[chunk] if known else None)
                    parts.append((f"{name}-part", *index, *chunk))
                    layer[parts[-1]] = (task, key, None if known else parted)
            layer[(name, *index)] = (_joined, self, block, len(kept), parts)
        layer.update(reads.tasks())
        graph = HighLevelGraph.from_collections(name, layer, dependencies=[source] if known else [source, at])
        return da.Array(graph, name, result, dtype=self.dtype)


class _Reads:
    """The chunks that points lie in, each with its margin."""

    def __init__(self, name: str, source: Any, work: _Work) -> None:
        self._name, self._source, self._work = name, source, work
        self._margin, self._places = margin_of(work.spline, work.dtype), [spans(sizes) for sizes in source.chunks]
        self._gathering = Gathering(source, "map_coordinates-read-")
        self._asked: dict[Any, Asked] = {}
        self._spans: dict[tuple[int, ...], tuple[Span, ...]] = {}

    def part(self, chunk: dict[int, int]) -> tuple[Any, tuple[Span, ...]]:
        """The key and the spans of a chunk, whose number is given for each axis."""
        numbers = tuple(chunk[axis] for axis in range(self._source.ndim))
        key = (f"{self._name}-samples", *numbers)
        if key not in self._asked:
            self._spans[numbers] = tuple(self._span(axis, i) for axis, i in enumerate(numbers))
            self._asked[key] = self._gathering.ask(self._spans[numbers])
        return key, self._spans[numbers]

    def _span(self, axis: int, i: int) -> Span:
        low, high = self._places[axis][i]
        if axis not in self._work.along:
            return low, high
        boundary, n = self._work.spline.boundary, self._source.shape[axis]
        # a point that belongs to the last sample of a chunk lies before the first one of the next
        last = high - 0.5 if boundary.outside == "rule" else min(high - 0.5, n - 1)
        return support_along(np.array([low, last], np.float64), n, boundary, self._margin).span

    def tasks(self) -> dict[Any, Any]:
        """The tasks that gather the parts."""
        layer = self._gathering.settled()
        return layer | {key: (gathered, *self._gathering.layout(asked)) for key, asked in self._asked.items()}


class _Chunks:
    """The chunks of an input along the axes that points have coordinates for; `numbers`: of those that are not empty."""

    def __init__(self, source: Any, along: Sequence[int], boundary: Boundary) -> None:
        places = [spans(source.chunks[axis]) for axis in along]
        filled = [[(i, low) for i, (low, high) in enumerate(axis) if high > low] for axis in places]
        self.numbers = [np.array([i for i, _ in axis], np.int64) for axis in filled]
        self._starts = [np.array([low for _, low in axis], np.float64) for axis in filled]
        self._sizes, self._boundary = tuple(source.shape[axis] for axis in along), boundary
        self._empty = not source.size

    def parted(self, at: Array) -> dict[tuple[int, ...], _Some]:
        """By chunk, the points that lie in it: their positions are folded as kernels fold them."""
        if not at.size or self._empty:
            return {}
        at = np.asarray(at, np.float64).reshape(len(self._sizes), -1)
        known: Array = np.logical_and.reduce(np.isfinite(at))
        placed = np.empty_like(at)
        owner = np.empty(at.shape, np.int64)
        for k, (x, n) in enumerate(zip(at, self._sizes, strict=True)):
            placed[k], known = self._folded(x, n, known)
            within = np.clip(np.floor(np.where(known, placed[k], 0.0)), 0, n - 1)
            owner[k] = self.numbers[k][np.searchsorted(self._starts[k], within, "right") - 1]
        which = np.flatnonzero(known)
        if not which.size:
            return {}
        own = owner[:, which]
        order = np.lexsort(own[::-1])
        own, which = own[:, order], which[order]
        cuts = np.flatnonzero((own[:, 1:] != own[:, :-1]).any(0)) + 1
        parts = zip(np.split(which, cuts), own[:, [0, *cuts.tolist()]].T.tolist(), strict=True)
        return {tuple(chunk): (some, placed[:, some]) for some, chunk in parts}

    def _folded(self, x: Floats, n: int, known: Array) -> tuple[Floats, Array]:
        """Positions along an axis within the samples, as far as the rule brings them there, and which of them have a value."""
        rule, inside = self._boundary, (x >= 0) & (x <= n - 1)
        if rule.outside == "constant":
            known = known & inside
        if rule.outside == "overlap" or (rule.outside == "rule" and rule.period is not None):
            beyond = ~inside if rule.fold is None or rule.outside == "overlap" else ~((x >= -0.5) & (x <= n - 0.5))
            x = np.where(beyond & known, rule.position(np.where(known, x, 0.0), n)[0], x)
            if rule.fold is None and rule.outside == "rule":  # before the first sample is behind the last, where parts reach
                x = np.where(x < 0, np.minimum(x + n, np.nextafter(n, 0)), x)
        return x, known


# -- in a worker -----------------------------------------------------------------------------------------------------


def _at_array(work: _Work, block: OutputBlock, held: Array, at: Array, filtered: bool) -> Array:
    """Points of one block at an array, or at its coefficients, whose type says what is computed in."""
    made = np.empty(block.shape, work.dtype)
    if made.size:
        spline = work.spline
        if filtered:
            spline = replace(spline, precision="single" if held.dtype in (np.float32, np.complex64) else "double")
        with named(block), turn():
            in_memory.at_points(held, work.along, at, made, spline)
    return made


@dataclass(frozen=True, eq=False)
class _Part:
    """The points of a block that lie in one chunk: they are `known` where coordinates are in memory.

    The spans of the block are those of the chunk with its margin.
    """

    work: _Work
    block: OutputBlock
    chunk: tuple[int, ...]
    known: _Some | None

    def __call__(self, samples: Array, parted: Any) -> _Some | None:
        points = parted.get(self.chunk) if self.known is None else self.known
        if points is None:
            return None
        (which, at), work, block = points, self.work, self.block
        assert block.spans is not None
        kept = [n for axis, n in enumerate(samples.shape) if axis not in work.along]
        values = np.empty((*kept, which.size), work.dtype)
        first = np.array([[block.spans[axis][0]] for axis in work.along], np.float64)
        with named(block), turn():
            with located(samples, block, FINITE):
                require_finite(samples, work.spline.nan)
            in_memory.at_points(samples, work.along, at - first, values, work.spline)
        return which, values


def _joined(work: _Work, block: OutputBlock, kept: int, parts: Sequence[_Some | None]) -> Array:
    """A block of the result: the values of its points, and the constant where they lie in no chunk."""
    made = np.empty((*block.shape[:kept], math.prod(block.shape[kept:])), work.dtype)
    made[...] = in_memory.stored(work.spline.cval, work.dtype)
    for part in parts:
        if part is not None:
            which, values = part
            made[..., which] = values
    return made.reshape(block.shape)
