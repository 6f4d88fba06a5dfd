"""Arrays of dask, block by block: what a block of the result reads, the graph that gathers it, and errors that name the block."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from itertools import pairwise, product
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

from clvol.base.errors import ClvolError, DataError, DtypeError, OptionError, OptionTypeError, UnsupportedError
from clvol.device import Device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.filter.margin import reach
from clvol.spline.function import Precision

__all__ = [
    "AnyDevice",
    "Array",
    "Asked",
    "Chunks",
    "Floats",
    "Gathering",
    "Margin",
    "OutputBlock",
    "Reads",
    "Span",
    "around",
    "as_chunks",
    "as_lazy",
    "blocks_of",
    "blockwise",
    "checked_device",
    "gathered",
    "located",
    "margin",
    "named",
    "no_memory",
    "own_part",
    "refused",
    "spans",
    "support_along",
    "supports_along",
    "touches",
    "turn",
]

AnyDevice: TypeAlias = Device | str | int | None
Array: TypeAlias = NDArray[Any]
Floats: TypeAlias = NDArray[np.float64]
Chunks: TypeAlias = Any  # whatever dask.array.normalize_chunks takes
Span: TypeAlias = tuple[int, int]
"""From which to before which index along an axis. Under a periodic rule it may begin before 0 and end past the last one."""


# -- arguments -------------------------------------------------------------------------------------------------------


def as_lazy(source: Any, what: str = "input", kinds: str = "biufc") -> Any:
    """An array of dask of NumPy arrays of numbers, in chunks of known sizes; others are refused."""
    meta = source._meta
    if not isinstance(meta, np.ndarray) or isinstance(meta, np.ma.MaskedArray):
        kind = f"{type(meta).__module__}.{type(meta).__qualname__}"
        raise DataError(f"{what} must be an array of dask made of arrays of NumPy; got one of {kind}")
    if source.dtype.kind not in kinds or source.dtype.char in "gG":
        allowed = "bool, integers, float16, float32, float64" + (", complex64 or complex128" if "c" in kinds else "")
        raise DtypeError(f"{what} must be an array of {allowed}; got {source.dtype}")
    if any(math.isnan(n) for sizes in source.chunks for n in sizes):
        raise DataError(f"{what} must have a known shape; got {source.shape}: compute_chunk_sizes() of the dask array finds it")
    return source


def checked_device(choice: object) -> Any:
    """A device, or its name, which each process looks up: the process that makes the graph may have no device."""
    if choice is None or (isinstance(choice, (Device, str, int)) and not isinstance(choice, bool)):
        return choice
    raise OptionError(f"device must be a Device, a name or a number; got {choice!r}")


def refused(name: str, **options: object) -> None:
    """Refuse options that have no meaning for arrays of dask."""
    reasons = {
        "progress": "dask shows its own: dask.diagnostics.ProgressBar",
        "out": "store() of the dask array writes it",
        "like": "an array of dask lies nowhere: give shape or spacing",
        "transform": "affine_transform and map_coordinates take arrays of dask through one",
    }
    for option, value in options.items():
        if value is not None and not (isinstance(value, (list, tuple)) and not value):
            raise UnsupportedError(f"{name} takes no {option} for an array of dask: {reasons[option]}")


def no_memory(output: object) -> None:
    """Refuse an array as `output`."""
    if output is not None and not isinstance(output, (type, np.dtype, str)):
        raise OptionTypeError(f"output must be a dtype for an array of dask; got {type(output).__qualname__}")


def as_chunks(chunks: Chunks, source: Any, shape: Sequence[int], alike: Sequence[int | None], dtype: Any) -> tuple[Any, ...]:
    """The chunks of a result of a shape and dtype, as given, or by default as those of `source`.

    Those are the same along axes of the same length, and as long as the longest along others. `alike` has for each axis of the
    result the one of `source` that it follows, if any.
    """
    if chunks is None:
        chunks = []
        for n, axis in zip(shape, alike, strict=True):
            same = axis is not None and n == source.shape[axis]
            longest = max(max(sizes) for sizes in (source.chunks if axis is None else source.chunks[axis : axis + 1]))
            chunks.append(source.chunks[axis] if same else min(max(longest, 1), n))
        chunks = tuple(chunks)
    try:
        known: tuple[Any, ...] = da.core.normalize_chunks(chunks, tuple(shape), dtype=dtype)
    except (TypeError, ValueError, NotImplementedError) as error:
        raise OptionError(f"chunks must fit a result of shape {tuple(shape)}; got {chunks!r}: {error}") from None
    return known


# -- what a block reads ----------------------------------------------------------------------------------------------


def spans(sizes: Sequence[int]) -> list[Span]:
    """Where the chunks of an axis lie."""
    ends = np.cumsum([0, *sizes]).tolist()
    return list(pairwise(ends))


@dataclass(frozen=True, eq=False)
class Support:
    """The samples that positions along an axis need; the positions count from the span's start."""

    span: Span
    positions: Floats


def support_along(positions: Floats, n: int, boundary: Boundary, margin: tuple[int, int], more: int = 0) -> Support:
    """The samples that positions along an axis of `n` samples need, so that the boundary rule means the same in them.

    They extend by `margin` and `more` samples before and after the outermost positions, and end at an edge of the array where these
    come near it or lie outside. Positions that are reflected at an edge are within. Positions are shifted by integers, so their
    fractions do not change.
    """
    if not positions.size or not n:
        return Support((0, 0), positions)
    before, after = margin[0] + more, margin[1] + more
    if boundary.fold is None and boundary.period is not None:
        return _around_the_seam(positions, n, boundary, before, after)
    if boundary.outside == "overlap":
        outside = (positions < 0) | (positions > n - 1)
        positions = np.where(outside, boundary.position(positions, n)[0], positions)
    low, high = float(positions.min()), float(positions.max())
    start, stop = min(max(low, 0.0), n - 1), max(min(high, n - 1), 0.0)
    if boundary.outside == "rule" and boundary.fold is not None:
        if low < 1 - n or high > 2 * (n - 1):  # reflected at both ends
            return Support((0, n), positions)
        if low < 0:
            start, stop = 0, max(stop, -low)
        if high > n - 1:
            start, stop = min(start, 2 * (n - 1) - high), n - 1
    span = max(math.floor(start) - before, 0), min(math.floor(stop) + after + 1, n)
    return Support(span, positions - span[0])


Margin: TypeAlias = tuple[int, int]
"""Samples before and after."""


def margin(filter: Filter, precision: Precision) -> Margin:
    """How many samples before and after the one before a position its value depends on: its taps, and what these depend on."""
    low, high = _taps(filter)
    row = filter.magnified_by
    if row is not None:  # its taps lie between two samples
        (low, high), more = _taps(row), 1
    else:
        row, more = filter, 0
    depth = reach(row, precision) + more
    return low + depth, high + depth


def _taps(row: Filter) -> Margin:
    return (row.support - 1) // 2, (row.support + 1) // 2


def supports_along(
    positions: Floats | None, sizes: Sequence[int], n: int, boundary: Boundary, margin: tuple[int, int], more: int = 0
) -> list[Support | None]:
    """The samples that each chunk of positions needs, with `more` samples for a low-pass; None: the chunks of the samples."""
    if positions is None:
        return [None] * len(sizes)
    supports: list[Support | None] = []
    for low, high in spans(sizes):
        one = support_along(positions[low:high], n, boundary, margin, more)
        if more and boundary.outside == "overlap" and touches(one.span, n):
            one = support_along(positions[low:high], n, boundary, (n, n))  # samples past an edge are those at the other one
        supports.append(one)
    return supports


def touches(span: Span, n: int) -> bool:
    """Whether a span reaches an end of an axis."""
    return span[0] <= 0 or span[1] >= n


def _around_the_seam(positions: Floats, n: int, boundary: Boundary, before: int, after: int) -> Support:
    """The support under a rule that repeats the samples; its span is one of the repeated axis."""
    inside = (positions >= 0) & (positions < n)
    if not inside.all():
        turns = np.where(inside, 0, np.floor(positions / n))
        turns -= turns.min()
        positions = np.where(inside, positions, boundary.position(positions, n)[0]) + n * turns
    low, high = math.floor(positions.min()) - before, math.floor(positions.max()) + after + 1
    if high - low >= n:
        return Support((0, n), positions)
    return Support((low, high), positions - low)


def around(shape: Sequence[int], margins: Sequence[int], boundary: Boundary) -> Reads:
    """Each block reads itself and a margin along each axis; under a rule that repeats the samples, also past the edges."""
    repeated = boundary.period is not None and boundary.fold is None

    def along(n: int, margin: int, place: Span) -> Span:
        low, high = place[0] - margin, place[1] + margin
        if place == (0, n) or (repeated and margin and high - low >= n):
            return (0, n)
        return (low, high) if repeated and margin else (max(low, 0), min(high, n))

    def plan(_: tuple[int, ...], where: tuple[Span, ...]) -> tuple[tuple[Span, ...], None]:
        return tuple(map(along, shape, margins, where)), None

    return plan


def own_part(block: OutputBlock) -> tuple[slice, ...]:
    """Where a block lies in the part that it reads."""
    assert block.spans is not None
    own = []
    for start, length, (low, _) in zip(block.start, block.shape, block.spans, strict=True):
        own.append(slice(start - low, start - low + length))
    return tuple(own)


# -- the graph -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OutputBlock:
    """One block of a result, of the function `name`, and where it lies in that.

    It reads the part `spans` (None: nothing) of axes as long as `limits`; `extra` is other input of its computation.
    """

    name: str
    index: tuple[int, ...]
    start: tuple[int, ...]
    shape: tuple[int, ...]
    spans: tuple[Span, ...] | None
    limits: tuple[int, ...]
    extra: Any = None

    @property
    def place(self) -> tuple[Span, ...]:
        """Where it lies in the result."""
        return tuple((first, first + n) for first, n in zip(self.start, self.shape, strict=True))

    def __str__(self) -> str:
        ranges = ", ".join(f"{first}:{stop}" for first, stop in self.place)
        return f"in block {self.index} of {self.name}, which is [{ranges}] of the result"


Compute: TypeAlias = Callable[[Any, OutputBlock], Array]
Reads: TypeAlias = Callable[[tuple[int, ...], tuple[Span, ...]], tuple[tuple[Span, ...] | None, Any]]


def blocks_of(name: str, chunks: Sequence[Sequence[int]], limits: tuple[int, ...]) -> Iterator[OutputBlock]:
    """The blocks of a result, which read nothing yet."""
    places = [spans(sizes) for sizes in chunks]
    for index in np.ndindex(*map(len, places)):
        where = [axis[i] for axis, i in zip(places, index, strict=True)]
        start, shape = tuple(low for low, _ in where), tuple(high - low for low, high in where)
        yield OutputBlock(f"clvol.dask.{name}", index, start, shape, None, limits)


def blockwise(
    name: str, source: Any, chunks: tuple[Any, ...], dtype: Any, plan: Reads, compute: Compute, identity: Sequence[object]
) -> Any:
    """An array of dask whose blocks are computed from parts of another.

    `plan` goes from the index of a block and its place in the result to the part that it reads (None: nothing) and its `extra`;
    `compute` from this part (None where nothing is read) and the `OutputBlock` to its samples. `name`, for keys and errors, is the
    function's. `identity` is all else that determines the result: equal calls have equal keys.
    """
    gathering = Gathering(source, f"{name}-read-")
    tasks: list[tuple[OutputBlock, Asked | None]] = []
    for block in blocks_of(name, chunks, source.shape):
        wanted, extra = plan(block.index, block.place) if all(block.shape) else (None, None)
        tasks.append((replace(block, spans=wanted, extra=extra), None if wanted is None else gathering.ask(wanted)))
    own = f"{name}-{tokenize(name, source.name, chunks, str(dtype), *identity)}"
    layer = gathering.settled()
    for block, asked in tasks:
        layout, keys = (None, []) if asked is None else gathering.layout(asked)
        layer[(own, *block.index)] = (_computed, compute, block, np.dtype(dtype), layout, keys)
    graph = HighLevelGraph.from_collections(own, layer, dependencies=[source])
    return da.Array(graph, own, chunks, dtype=dtype)


Cuts: TypeAlias = tuple[Span, ...]
"""The part of a chunk along each axis."""
Piece: TypeAlias = tuple[tuple[int, ...], Cuts]
"""The index of a chunk, and a part of it."""


@dataclass(frozen=True, eq=False)
class Asked:
    """A part, its pieces of chunks, and where each of them goes."""

    shape: tuple[int, ...]
    pieces: list[Piece]
    targets: list[tuple[slice, ...]]


@dataclass(frozen=True, eq=False)
class Layout:
    """How a part is assembled: for each piece the number of its array, how it is cut out, and where it goes.

    An array is a chunk, of which a part is cut out, or several pieces of one, of which a part has a number.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    parts: list[tuple[int, Cuts | int, tuple[slice, ...]]]
    sizes: list[tuple[int, ...] | None]


class Gathering:
    """The pieces of chunks that parts read.

    A task a piece would be one for each of a chunk's 26 neighbours, and a scheduler takes as long for each as for reading a
    chunk. So those pieces that go to the same side, along the first axis that they go along, are cut out by one task: six a chunk.
    Where they would be more than the chunk, that itself is passed on.
    """

    def __init__(self, source: Any, prefix: str) -> None:
        self._source, self._prefix = source, f"{prefix}{source.name}"
        self._places = [spans(sizes) for sizes in source.chunks]
        self._wanted: dict[tuple[Any, ...], dict[Cuts, None]] = {}
        self._found: dict[Piece, tuple[Any, Cuts | int]] = {}

    def ask(self, part: Sequence[Span]) -> Asked:
        """The pieces of a part."""
        along = [self._segments(places, n, span) for places, n, span in zip(self._places, self._source.shape, part, strict=True)]
        asked = Asked(tuple(stop - start for start, stop in part), [], [])
        for parts in product(*along):
            index, cuts = tuple(i for i, _, _ in parts), tuple(cut for _, cut, _ in parts)
            asked.targets.append(tuple(target for _, _, target in parts))
            asked.pieces.append((index, cuts))
            side = next(
                ((axis, cut) for axis, (cut, n) in enumerate(zip(cuts, self._sizes(index), strict=True)) if cut != (0, n)), None
            )
            if side is not None:
                self._wanted.setdefault((index, *side), {})[cuts] = None
        return asked

    def settled(self) -> dict[Any, Any]:
        """The tasks that cut out the pieces of all parts; call it after the last `ask`."""
        tasks: dict[Any, Any] = {}
        for (index, *_), wanted in self._wanted.items():
            key, sizes = (self._source.name, *index), self._sizes(index)
            if sum(math.prod(b - a for a, b in cuts) for cuts in wanted) > math.prod(sizes):
                self._found.update({(index, cuts): (key, cuts) for cuts in wanted})
                continue
            several = list(wanted)
            made = (f"{self._prefix}-{blake2b(repr(several).encode(), digest_size=8).hexdigest()}", *index)
            tasks[made] = (partial(_cut, several, sizes), key)
            self._found.update({(index, cuts): (made, number) for number, cuts in enumerate(several)})
        return tasks

    def layout(self, asked: Asked) -> tuple[Layout, list[Any]]:
        """How a part is assembled, and the keys of its arrays."""
        numbers: dict[Any, int] = {}
        parts: list[tuple[int, Cuts | int, tuple[slice, ...]]] = []
        sizes: list[tuple[int, ...] | None] = []
        for (index, cuts), target in zip(asked.pieces, asked.targets, strict=True):
            key, how = self._found.get((index, cuts), ((self._source.name, *index), cuts))
            if key not in numbers:
                numbers[key] = len(numbers)
                sizes.append(None if isinstance(how, int) else self._sizes(index))
            parts.append((numbers[key], how, target))
        return Layout(asked.shape, self._source.dtype, parts, sizes), list(numbers)

    def _sizes(self, index: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(self._source.chunks[axis][i] for axis, i in enumerate(index))

    @staticmethod
    def _segments(places: list[Span], n: int, span: Span) -> list[tuple[int, Span, slice]]:
        """The chunks along an axis that hold a span, which part of each, and where that goes."""
        found = []
        at = span[0]
        starts = [start for start, _ in places]
        while at < span[1]:
            index = at % n
            i = int(np.searchsorted(starts, index, "right")) - 1  # the last of those that start there: it is not empty
            start, stop = places[i]
            count = min(stop - index, span[1] - at)
            found.append((i, (index - start, index - start + count), slice(at - span[0], at - span[0] + count)))
            at += count
        return found


def _cut(pieces: list[Cuts], sizes: tuple[int, ...], chunk: Array) -> list[Array]:
    """Copies of parts of a chunk, so that the chunk can be freed."""
    _require_shape(chunk, sizes)
    return [np.ascontiguousarray(chunk[tuple(slice(*span) for span in cuts)]) for cuts in pieces]


def _require_shape(chunk: Any, shape: tuple[int, ...]) -> None:
    if np.shape(chunk) != shape:
        raise DataError(f"a chunk of an array of dask must have the shape that the array says, {shape}; got {np.shape(chunk)}")


def gathered(layout: Layout, arrays: Sequence[Any]) -> Array:
    """Assemble a part."""
    for array, sizes in zip(arrays, layout.sizes, strict=True):
        if sizes is not None:
            _require_shape(array, sizes)
    parts = [
        (arrays[number][how] if isinstance(how, int) else arrays[number][tuple(slice(*span) for span in how)], target)
        for number, how, target in layout.parts
    ]
    if len(parts) == 1:
        return np.asarray(parts[0][0])
    # intermediate results may be float64 in some blocks
    whole = np.empty(layout.shape, np.result_type(layout.dtype, *{part.dtype for part, _ in parts}))
    for part, target in parts:
        whole[target] = part
    return whole


# -- in a worker -----------------------------------------------------------------------------------------------------

_turn = threading.Lock()
"""Kernels use all cores: a process computes one block at a time, while other threads read and gather the next ones."""


def _new_turn() -> None:
    global _turn
    _turn = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_new_turn)  # the thread that had it is not there


def turn() -> threading.Lock:
    """The lock to hold while a block is computed on the device."""
    return _turn


def _computed(compute: Compute, block: OutputBlock, dtype: np.dtype[Any], layout: Layout | None, parts: Sequence[Array]) -> Array:
    """The task of a block."""
    if not all(block.shape):
        return np.empty(block.shape, dtype)
    with named(block):
        samples = None if layout is None else gathered(layout, parts)
        with turn():
            return compute(samples, block)


@contextmanager
def named(block: OutputBlock) -> Iterator[None]:
    """Add the block to the message of an error."""
    try:
        yield
    except ClvolError as error:
        raise type(error)(f"{error} ({block})") from error
    except Exception as error:
        error.add_note(str(block))
        raise


@contextmanager
def located(samples: Array, block: OutputBlock, rule: str) -> Iterator[None]:
    """Add to an error about samples that are not finite where in the array the first of them is."""
    try:
        yield
    except DataError:
        if samples.dtype.kind not in "fc" or (known := np.isfinite(samples)).all() or block.spans is None:
            raise
        here = np.unravel_index(int(np.argmin(known)), samples.shape)
        at = tuple((int(i) + start) % n for i, (start, _), n in zip(here, block.spans, block.limits, strict=True))
        raise DataError(f"{rule}; got {samples[here]} at {at}") from None
