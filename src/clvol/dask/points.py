"""SciPy's functions that interpolate at points, block by block.

Every point belongs to the chunk of the input that it lies in. Where coordinates are known, a block of the result reads the chunks
that its points lie in; where they are an array of dask, too, every chunk is looked up for every block of points, and computes those
that lie in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph

from clvol.base.errors import DataError, OptionError, OptionTypeError, RefusedError, UnsupportedError
from clvol.dask.blocks import (
    Array,
    Asked,
    Block,
    Chunks,
    Floats,
    Gathering,
    Span,
    as_chunks,
    as_lazy,
    blockwise,
    checked_device,
    gathered,
    located,
    named,
    one_at_a_time,
    refused,
    spans,
    window_along,
)
from clvol.dask.filtering import checked_spline, splines_margin
from clvol.dask.grids import Options, as_stored
from clvol.device import as_device
from clvol.filter.boundary import Boundary
from clvol.interop.dispatch import is_lazy
from clvol.ndimage import engine, interpolation, passes
from clvol.ndimage.arguments import AnyDevice, Spline, as_axes, as_coordinates, as_shape
from clvol.ndimage.arguments import as_array as as_samples
from clvol.spline.field import Precision

__all__ = ["geometric_transform", "map_coordinates"]

_POINTS = 1 << 20
"""Points in a block of the result, where their coordinates are in memory and no chunks are given."""
_PADDED = ("nearest", "grid-constant")
"""Modes whose coefficients go on past the samples: a spline of coefficients alone is another one."""


def map_coordinates(
    input: Any,
    coordinates: Any,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    *,
    axes: int | Sequence[int] | None = None,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array at points, as `clvol.ndimage.map_coordinates` gives it; the input, the coordinates, or both are arrays of dask.

    Parameters
    ----------
    input : dask.array.Array or array-like
    coordinates : dask.array.Array or array-like
        In memory: each block of the result reads the chunks that its points lie in. Of dask: the result has their chunks, and every
        chunk of an `input` of dask is read, one at a time; an input in memory is filtered once.
    output, order, mode, cval, prefilter, axes, precision, device, nan
        As of `clvol.ndimage.map_coordinates`.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the points, where coordinates are in memory; by default about a million.

    Returns
    -------
    dask.array.Array
        It differs from the result in one piece as that of `clvol.dask.affine_transform` does.

    Raises
    ------
    ClvolError
        As `clvol.ndimage.map_coordinates` raises it, and for arrays of dask that cannot be read; errors of a block name it.
    """
    refused("map_coordinates", progress=progress)
    source = as_lazy(input) if is_lazy(input) else as_samples(input)
    along = as_axes(axes, source.ndim)
    at: Any = _lazy_coordinates(coordinates, len(along)) if is_lazy(coordinates) else as_coordinates(coordinates, len(along))
    if along != sorted(along):
        at = at[np.argsort(along).tolist()]
        along = sorted(along)
    kept = [axis for axis in range(source.ndim) if axis not in along]
    shape = (*(source.shape[axis] for axis in kept), *at.shape[1:])
    interpolation.require_rank(source.ndim, len(shape))
    if len(along) > passes.NATIVE:
        raise UnsupportedError(f"points must have coordinates along at most {passes.NATIVE} axes of input; got {len(along)}")
    spline, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan)
    options = Options(spline.order, mode, cval, spline.prefilter, precision, checked_device(device), nan)
    if not source.size and math.prod(shape) and mode not in ("constant", "grid-constant"):
        raise DataError(f'input must have samples where mode is not "constant" or "grid-constant"; got shape {source.shape}')
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
    if not is_lazy(source):
        return _in_memory(source, at, along, kept, dtype, options)
    return _scattered(source, at, along, kept, pieces, dtype, spline, options)


def geometric_transform(
    input: Any,
    mapping: Callable[..., Sequence[float]],
    output_shape: Iterable[int] | None = None,
    output: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: complex = 0.0,
    prefilter: bool = True,
    extra_arguments: tuple[Any, ...] = (),
    extra_keywords: Mapping[str, Any] | None = None,
    *,
    chunks: Chunks = None,
    precision: Precision | None = None,
    device: AnyDevice = None,
    nan: str = "propagate",
    progress: None = None,
) -> Any:
    """An array at positions that a function gives, as `clvol.ndimage.geometric_transform` gives it.

    Where a block lies is known once the function has been called for it, so each block of the result looks up every chunk.
    Where positions follow from a matrix, `affine_transform` reads only what it needs.

    Parameters
    ----------
    input : dask.array.Array
    mapping, output_shape, output, order, mode, cval, prefilter, extra_arguments, extra_keywords, precision, device, nan
        As of `clvol.ndimage.geometric_transform`; `mapping` goes to the workers.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result. By default those of `input`, along axes of another length chunks as long as its longest.

    Returns
    -------
    dask.array.Array
    """
    refused("geometric_transform", progress=progress)
    source = as_lazy(input)
    shape = source.shape if output_shape is None else as_shape(output_shape)
    interpolation.require_rank(source.ndim, len(shape))
    if not isinstance(extra_arguments, tuple):
        raise RefusedError(f"extra_arguments must be a tuple; got {extra_arguments!r}")
    if not isinstance(extra_keywords, (dict, type(None))):
        raise RefusedError(f"extra_keywords must be a dict; got {extra_keywords!r}")
    if not callable(mapping):
        raise OptionTypeError(f"mapping must be a function of Python; got {mapping!r}")
    _, dtype = checked_spline(source, output, order, mode, cval, prefilter, precision, nan)
    alike = range(source.ndim) if len(shape) == source.ndim else [None] * len(shape)
    sizes = as_chunks(chunks, source, shape, alike, dtype)
    called = _Called(mapping, extra_arguments, dict(extra_keywords or {}), source.ndim)
    nothing = da.empty((), chunks=())  # positions are made of indices alone
    identity = [called.mapping, called.arguments, called.keywords]
    at = blockwise("positions", nothing, ((source.ndim,), *sizes), np.float64, lambda *_: (None, None), called, identity)
    return map_coordinates(source, at, output, order, mode, cval, prefilter, precision=precision, device=device, nan=nan)


@dataclass(frozen=True, eq=False)
class _Called:
    """Positions by a function of the index, called for one after the other."""

    mapping: Callable[..., Sequence[float]]
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]
    ndim: int

    def __call__(self, _: Array | None, block: Block) -> Array:
        ranges = [range(start, start + n) for start, n in zip(block.start[1:], block.shape[1:], strict=True)]
        answers = [self.mapping(index, *self.arguments, **self.keywords) for index in product(*ranges)]
        return passes.as_rows(answers, self.ndim).T.reshape(block.shape)


def _lazy_coordinates(coordinates: Any, count: int) -> Any:
    at = as_lazy(coordinates, "coordinates", "biuf")
    if at.ndim < 2:
        raise RefusedError(f"coordinates must have an axis for the input's axes and at least one more; got shape {at.shape}")
    if at.shape[0] != count:
        raise RefusedError(f"coordinates must be given for {count} axes, along their first; got shape {at.shape}")
    return at


# -- an input in memory ----------------------------------------------------------------------------------------------


def _in_memory(data: Array, at: Any, along: list[int], kept: list[int], dtype: np.dtype[Any], options: Options) -> Any:
    """Blocks of coordinates at an array that every process has: its coefficients, where the mode lets these be had alone."""
    source = da.from_array(data, chunks=-1, name=f"samples-{tokenize(data)}")
    spline = options.of(data)
    held = source
    if spline.prefilter and spline.order > 1 and spline.mode not in _PADDED:
        compute = _Coefficients(along, options)
        kind = np.dtype(np.complex128 if data.dtype.kind == "c" else np.float64)
        held = blockwise(
            "coefficients", source, source.chunks, kind, lambda _, where: (where, None), compute, [*options.identity, along]
        )
    name = f"map_coordinates-{tokenize(held.name, at.name, along, str(dtype), *options.identity)}"
    chunks = (*((data.shape[axis],) for axis in kept), *at.chunks[1:])
    places = [spans(sizes) for sizes in chunks]
    layer: dict[Any, Any] = {}
    for index in np.ndindex(*map(len, chunks)):
        where = [axis[i] for axis, i in zip(places, index, strict=True)]
        shape = tuple(stop - start for start, stop in where)
        block = Block("clvol.dask.map_coordinates", index, tuple(start for start, _ in where), shape, None, data.shape)
        whole = (held.name, *[0] * data.ndim)
        layer[(name, *index)] = (_mapped, block, whole, (at.name, 0, *index[len(kept) :]), along, dtype, options, held is source)
    graph = HighLevelGraph.from_collections(name, layer, dependencies=[held, at])
    return da.Array(graph, name, chunks, dtype=dtype)


@dataclass(frozen=True, eq=False)
class _Coefficients:
    along: list[int]
    options: Options

    def __call__(self, window: Array, block: Block) -> Array:  # noqa: ARG002  # the block is all of it
        spline = self.options.of(window)
        device = as_device(spline.device)
        part = window.real if window.dtype.kind == "c" else window
        kind = np.dtype(engine.kind_for(spline.precision, part, np.empty(0), device))
        made = np.empty(window.shape, np.result_type(kind, np.complex64) if window.dtype.kind == "c" else kind)
        passes.filtered(window, self.along, made, spline)
        return made


def _mapped(block: Block, held: Array, at: Array, along: list[int], dtype: np.dtype[Any], options: Options, samples: bool) -> Array:
    """Points of one block at an array, or at its coefficients, whose type says what is computed in."""
    made = np.empty(block.shape, dtype)
    if made.size:
        with named(block), one_at_a_time():
            spline = options.of(held)
            if not samples:
                single = held.dtype in (np.float32, np.complex64)
                spline = Spline.of(
                    held,
                    spline.order,
                    spline.mode,
                    spline.cval,
                    False,
                    "single" if single else "double",
                    options.device,
                    "propagate",
                    None,
                )
            passes.at_points(held, along, at, made, spline)
    return made


# -- an input of dask ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Chunks:
    """The chunks of an input along the axes that points have coordinates for.

    Attributes
    ----------
    starts : list of ndarray
        Of the chunks that are not empty, along each axis.
    numbers : list of ndarray
        Which chunks these are.
    sizes : tuple of int
        Of the axes.
    boundary : Boundary
    """

    starts: list[Floats]
    numbers: list[Array]
    sizes: tuple[int, ...]
    boundary: Boundary

    def parted(self, at: Array) -> dict[tuple[int, ...], tuple[Array, Floats]]:
        """By chunk, which points lie in it, and where: brought to where the samples are, as kernels would bring them."""
        rule = self.boundary
        at = np.asarray(at, np.float64).reshape(len(self.sizes), -1)
        known = np.isfinite(at).all(0)
        placed = np.empty_like(at)
        owner = np.empty(at.shape, np.int64)
        for k, (x, n) in enumerate(zip(at, self.sizes, strict=True)):
            inside = (x >= 0) & (x <= n - 1)
            if rule.outside == "constant":
                known &= inside
            if rule.outside == "overlap" or (rule.outside == "rule" and rule.period is not None):
                beyond = ~inside if rule.fold is None or rule.outside == "overlap" else ~((x >= -0.5) & (x <= n - 0.5))
                x = np.where(beyond & known, rule.position(np.where(known, x, 0.0), n)[0], x)
                if rule.fold is None and rule.outside == "rule":  # before the first sample is behind the last, where windows reach
                    x = np.where(x < 0, np.minimum(x + n, np.nextafter(n, 0)), x)
            placed[k] = x
            within = np.clip(np.floor(np.where(known, x, 0.0)), 0, n - 1)
            owner[k] = self.numbers[k][np.searchsorted(self.starts[k], within, "right") - 1]
        which = np.flatnonzero(known)
        if not which.size:
            return {}
        own = owner[:, which]
        order = np.lexsort(own[::-1])
        own, which = own[:, order], which[order]
        cuts = np.flatnonzero((own[:, 1:] != own[:, :-1]).any(0)) + 1
        parts = zip(np.split(which, cuts), own[:, [0, *cuts.tolist()]].T.tolist(), strict=True)
        return {tuple(chunk): (some, placed[:, some]) for some, chunk in parts}


def _scattered(
    source: Any,
    at: Any,
    along: list[int],
    kept: list[int],
    pieces: tuple[Any, ...],
    dtype: np.dtype[Any],
    spline: Spline,
    options: Options,
) -> Any:
    """Points in an array of dask: those of a block go to the chunks that they lie in, whose values are put together."""
    known = not is_lazy(at)
    name = f"map_coordinates-{tokenize(source.name, at if known else at.name, along, pieces, str(dtype), *options.identity)}"
    boundary, reach = options.boundary, splines_margin(spline, dtype)
    places = [spans(sizes) for sizes in source.chunks]
    filled = [[i for i, (low, high) in enumerate(axis) if high > low] for axis in places]
    chunks = _Chunks(
        [np.array([places[axis][i][0] for i in filled[axis]], np.float64) for axis in along],
        [np.array(filled[axis], np.int64) for axis in along],
        tuple(source.shape[axis] for axis in along),
        boundary,
    )
    gathering = Gathering(source, "map_coordinates-read-")
    windows: dict[Any, Asked] = {}
    layer: dict[Any, Any] = {}
    made: dict[tuple[int, ...], tuple[Any, tuple[Span, ...]]] = {}

    def window(batch: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[Any, tuple[Span, ...]]:
        """The key and the spans of a chunk with its margin."""
        if (batch + chunk) not in made:
            own: list[Span] = [(0, 0)] * source.ndim
            for axis, i in zip(kept, batch, strict=True):
                own[axis] = places[axis][i]
            for axis, i in zip(along, chunk, strict=True):
                low, high = places[axis][i]
                # a point that belongs to the last sample of a chunk lies before the first one of the next
                last = high - 0.5 if boundary.name == "wrap" else min(high - 0.5, source.shape[axis] - 1)
                own[axis] = window_along(np.array([low, last], np.float64), source.shape[axis], boundary, reach).span
            key = (f"{name}-window", *batch, *chunk)
            windows[key] = gathering.ask(own)
            made[batch + chunk] = (key, tuple(own))
        return made[batch + chunk]

    everywhere = list(product(*(filled[axis] for axis in along))) if source.size else []
    result = (*(source.chunks[axis] for axis in kept), *pieces)
    rooms = [spans(sizes) for sizes in result]
    partitions: dict[tuple[int, ...], Any] = {}
    for index in np.ndindex(*map(len, result)):
        where = [axis[i] for axis, i in zip(rooms, index, strict=True)]
        batch, piece = index[: len(kept)], index[len(kept) :]
        shape = tuple(stop - start for start, stop in where)
        block = Block("clvol.dask.map_coordinates", index, tuple(start for start, _ in where), shape, None, source.shape)
        if piece not in partitions:
            if known:
                own = at[(slice(None), *(slice(*span) for span in where[len(kept) :]))]
                partitions[piece] = chunks.parted(own) if math.prod(own.shape) and source.size else {}
            else:
                partitions[piece] = (f"{name}-parted", *piece)
                layer[partitions[piece]] = (_parted, chunks, (at.name, 0, *piece))
        parted, parts = partitions[piece], []
        if all(shape):
            for chunk in sorted(parted) if known else everywhere:
                key, own_spans = window(batch, chunk)
                task = _Part(block, own_spans, along, chunk, dtype, options, _Some(parted[chunk]) if known else None)
                parts.append((f"{name}-part", *index, *chunk))
                layer[parts[-1]] = (_evaluated, task, key, None if known else parted)
        layer[(name, *index)] = (_joined, block, dtype, options, len(kept), parts)
    layer.update(gathering.settled())
    for key, asked in windows.items():
        layer[key] = (gathered, *gathering.layout(asked))
    graph = HighLevelGraph.from_collections(name, layer, dependencies=[source] if known else [source, at])
    return da.Array(graph, name, result, dtype=dtype)


@dataclass(frozen=True, eq=False)
class _Some:
    """Points of a block that lie in one chunk: their numbers and positions."""

    points: tuple[Array, Floats]


@dataclass(frozen=True, eq=False)
class _Part:
    block: Block
    spans: tuple[Span, ...]
    along: list[int]
    chunk: tuple[int, ...]
    dtype: np.dtype[Any]
    options: Options
    known: _Some | None


def _parted(chunks: _Chunks, at: Array) -> dict[tuple[int, ...], tuple[Array, Floats]]:
    return chunks.parted(at) if at.size and all(chunks.sizes) else {}


def _evaluated(task: _Part, window: Array, parted: Any) -> tuple[Array, Array] | None:
    """What a chunk makes of the points that lie in it."""
    points = task.known.points if task.known is not None else parted.get(task.chunk)
    if points is None:
        return None
    which, at = points
    kept = [n for axis, n in enumerate(window.shape) if axis not in task.along]
    values = np.empty((*kept, which.size), task.dtype)
    limits = task.block.limits
    block = Block(task.block.name, task.block.index, task.block.start, task.block.shape, task.spans, limits)
    with named(block), located(window, block, 'with nan="error" all samples must be finite'), one_at_a_time():
        first = np.array([[task.spans[axis][0]] for axis in task.along], np.float64)
        passes.at_points(window, task.along, at - first, values, task.options.of(window))
    return which, values


def _joined(block: Block, dtype: np.dtype[Any], options: Options, kept: int, parts: Sequence[tuple[Array, Array] | None]) -> Array:
    """A block of the result: what chunks made of its points, and the constant where they lie in none."""
    made = np.empty((*block.shape[:kept], math.prod(block.shape[kept:])), dtype)
    made[...] = as_stored(options.cval, dtype)
    for part in parts:
        if part is not None:
            which, values = part
            made[..., which] = values
    return made.reshape(block.shape)
