"""The function of a volume that is larger than memory: coefficients of one brick after the other, the last used ones kept.

A brick is a box of cells, with all coefficients that these take. They come of its own samples and of a margin around it: what the
prefilter takes from further away falls with the powers of the filter's largest pole, and is left out below `LEFT_OUT` of the
samples' range. At the volume's own faces the boundary rule goes on as it does for the whole volume.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_output
from clvol.base.checks import whole
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.base.rounding import in_kind
from clvol.bricks.chunks import UNPACKING, Chunks, stored_in_one
from clvol.bricks.source import Index, LazyVolume, budget_for
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline.build import DefineDict, evaluator_defines, filter_defines
from clvol.spline.chain import Chain
from clvol.spline.coefficients import Coefficients, bytes_of, extent_of
from clvol.spline.evaluator import DIRECT, Evaluator
from clvol.spline.field import (
    RENUMBER,
    Anchor,
    Frame,
    Progress,
    Reals,
    as_points,
    between,
    beyond,
    fill_value,
    filled,
    grid_for,
    names_beyond,
    require_no_transform,
    result_kind,
)
from clvol.spline.lease import Lease
from clvol.spline.minmax import BLOCK, MinMax, bytes_beside
from clvol.spline.points import NOTHING_GIVEN, Transform, sample_into
from clvol.spline.reduce import (
    AntiAliasing,
    Sums,
    as_anti_aliasing,
    gaussian_sums,
    interpolated,
    nearest_sums,
    smoothed,
    steps_along,
    wide_enough,
)
from clvol.spline.reduced import Reduced
from clvol.spline.resample import no_shear, resample_coefficients
from clvol.spline.residents import Account, Reads, Resident, Residents
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.stored import Stored
from clvol.volume.transform import Transforms, as_chain
from clvol.volume.volume import Volume

__all__ = ["LEFT_OUT", "Brick", "BrickedField", "Reads", "Resident", "Whole", "as_lazy", "margin_of"]

LEFT_OUT = 1e-8  # of the samples' range: what coefficients lack of samples beyond a brick's margin
_EDGES = (256, 128, 64, 32)  # samples along those of a brick that are tried, the first of which several fit into the budget
_SEVERAL = 8
_AROUND = 3  # samples that positions may be off by, and that neighbours take for central differences
_FAR = float(1 << 30)  # cells: past any
_ALIGNED = 4  # cells: those of which it is kept together on which side of a value they are
_BLOCKS_OF_RESULTS = (96, 64, 48, 32, 24, 16)  # along an edge, of grids that are not along the volume's axes, that are tried
_OF_A_RESULT = 200  # bytes, on the way to one of these: points in several frames, and where they belong
_RESULTS = 8  # of the budget, one part in so many is for those
_KEPT = 4  # of the budget, one part in so many is for unpacked chunks
_KEPT_LONG = 2  # where chunks reach through many bricks
_CLOSED = "the field was closed, and its coefficients were released; make a new one"


_Part: TypeAlias = tuple[tuple[slice, ...], NDArray[Any], float]
"""Where values of a grid belong, these, and how much is done then."""


@dataclass(frozen=True)
class Brick:
    """Where a brick lies.

    Attributes
    ----------
    at : (int, int, int)
        Which one it is along x, y and z.
    low, high : tuple of float
        The positions, in samples, that are its own: ``low <= position < high``; infinite at the volume's faces.
    first, last : (int, int, int)
        The samples that are read for it: ``first <= index < last``. Under the rule "wrap" they may lie outside.
    """

    at: Index
    low: tuple[float, ...]
    high: tuple[float, ...]
    first: Index
    last: Index


class Whole:
    """What a picture asks of the coefficients of a whole volume, none of which are there.

    Attributes
    ----------
    volume : Volume
        Where samples lie, and what is known of them; its own are none.
    filter, device, stored, size, extent, ndim
        As of `Coefficients`.
    """

    def __init__(self, volume: Volume, filter: Filter, extent: NDArray[np.int32], device: Device, stored: Stored) -> None:
        self.volume, self.filter, self.device, self.stored, self.ndim = volume, filter, device, stored, volume.ndim
        self.size = np.array([*volume.size, 0], np.int32)
        self.extent = extent

    def defines(self, evaluator: Evaluator) -> DefineDict:
        """As of `Coefficients`."""
        return {**filter_defines(self.filter, np.float32), **evaluator_defines(evaluator, self.filter, self.ndim, self.device)}


def margin_of(filter: Filter) -> int:
    """Samples around a brick that its coefficients are computed from: those further away count less than `LEFT_OUT`."""
    own = filter.magnified_by or filter
    if not own.prefilter:
        return 0
    smoothing = own.smoothing if isinstance(own.smoothing, tuple) else (own.smoothing,)
    largest = max(float(np.abs(own.along(axis).poles).max(initial=0.0)) for axis in range(len(smoothing)))
    return max(1, math.ceil(math.log(LEFT_OUT) / math.log(largest))) if largest > 0 else 0


class BrickedField:
    """The continuous function of a volume that is read brick by brick.

    It answers as a `Field` does, but keeps no more of the coefficients than its budget allows: what will be asked for last makes
    room. Nothing is read before it is needed.

    Parameters
    ----------
    volume : LazyVolume, Volume or array-like, shape (nz, ny, nx)
        What is read: an array of Zarr, HDF5 or dask, a memory map, or a volume in memory whose coefficients are not to be.
    filter : str or Filter, optional
        As of `Field`; by default that of the volume's bounds, if it has such, else "bspline3". Smoothing that is found for the
        volume ("bspline3(auto)") is found for its middle.
    boundary : str or Boundary
        As of `Field`.
    device : Device, str or int, optional
        See `as_device`.
    budget : int, optional
        Bytes that bricks may take: on the device, those that are being read, and chunks that are unpacked; by default 2 GiB, or
        half of the memory that is available if that is less, or more where a chunk has to be unpacked that takes as much.
    edge : int, optional
        Samples along an edge of a brick; by default as many as let several fit into the budget, 128 at most, or 256 where all of
        the volume fits, and whole chunks. Of chunks that are longer than bricks, such as planes, so many that the budget holds
        those which a layer of bricks reaches into.
    at_once : bool
        Whether a volume in memory is one brick where nothing is said of `edge`, if it fits; for a cluster it is to be several.
    beside : BrickedField, optional
        A field whose budget is this one's too: together they take no more, such as the levels of a picture.

    Attributes
    ----------
    volume : LazyVolume
    filter : Filter
    boundary : Boundary
    device : Device
    budget, edge : int
    reads : Reads
        What was read until now.

    Raises
    ------
    DataError
        `volume` is none that `LazyVolume` takes, or labels that float32 does not hold are drawn by "nearest".
    OptionError
        `filter`, `boundary` or `device` is the name of none; `edge` is no whole number of at least 8; the budget is smaller than a
        brick, or than unpacking a chunk takes: the message says what the least is; or `budget` is given with `beside`.
    OutOfMemoryError
        The device allows no buffer that holds a brick.

    Notes
    -----
    Values differ from those of a `Field` by less than 10⁻⁶ of the samples' range where there is a prefilter; pictures with filters
    that have none are the same to the last bit. All is computed in single precision.
    """

    def __init__(
        self,
        volume: LazyVolume | Volume | ArrayLike,
        filter: str | Filter | None = None,
        boundary: str | Boundary | None = None,
        device: Device | str | int | None = None,
        *,
        budget: int | None = None,
        edge: int | None = None,
        at_once: bool = True,
        beside: BrickedField | None = None,
    ) -> None:
        if beside is not None and budget is not None:
            raise OptionError(f"budget must be left to the field beside which this one is; got {budget!r} with it")
        self.volume = volume = as_lazy(volume)
        own = 0 if beside is not None else budget_for(volume, budget)
        kept = volume.bounds
        chosen = kept.filter if filter is None and kept is not None else filter
        if boundary is None:
            boundary = DEFAULT_BOUNDARY if kept is None else kept.boundary
        row = filter_for(volume.part(), None, DEFAULT_FILTER) if chosen is None else as_filter(chosen)
        self._asked = row
        known = row.settled and (row.magnified_by is None or row.magnified_by.settled)
        self.filter = settled(row, volume.grid if known else volume.part())
        self._require_names(volume.known)
        self.boundary = as_boundary(boundary)
        self.device = as_device(device)
        self._account: Account = Account(own) if beside is None else beside._account
        self.budget = self._account.budget
        self.reads = Reads()
        self.stored = Stored.of(_ends_of(volume), self.filter, self.boundary)
        self._margin = margin_of(self.filter)
        self._pad = self.boundary.padding((self.filter.magnified_by or self.filter).prefilter, self.filter.support)
        self._reach = self.boundary.reach(self.filter.support)
        past = self.filter.scale * (self._pad + self._reach)
        self._extent = extent_of(self.filter, 3, tuple(self.filter.scale * n for n in volume.size), past)
        self._lines = volume.lines
        self._one = 0 if self._lines is None else stored_in_one(volume.data)
        self.edge = self._edge_for(edge, at_once=at_once)
        self._bounds: dict[Index, tuple[float, float]] = {}
        self._chunks = self._chunks_kept()
        everything = math.prod(self.counts) * self._most(self.edge)
        self._residents = Residents(self._account, self.reads, self._chunks, chunks_first=everything <= self.budget)
        self._lease = Lease(_CLOSED)
        self._lease.frees(self._residents.release)  # not of the field: it would be a cycle

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.volume.shape))
        state = ", closed" if self.closed else ""
        return f"<BrickedField of {shape} samples, {self.filter.name}, {self.boundary.name}, bricks of {self.edge}³{state}>"

    # -- where bricks lie --------------------------------------------------------------------------------------------------

    def _edge_for(self, edge: int | None, *, at_once: bool) -> int:
        """The edge that was asked for, or the largest of which several fit into the budget."""
        if edge is not None:
            edge = whole("edge", edge, 8)
            if self._needed(edge) > self.budget:
                raise self._too_small(edge)
            return edge
        if at_once and self._fits_at_once():
            return max(8, *self.volume.size)
        # of a volume that does not fit as a whole small ones are read more selectively: measured for shells in 1024³
        everything = bytes_of(self.volume.size, self.filter, self.boundary, np.float32)
        edges = _EDGES if everything < self.budget else _EDGES[1:]
        for kept, tried, count in itertools.product((True, False), (_SEVERAL, 2, 1), edges):
            beside = self._layer(count) if kept and any(self._long(count)) else 0
            taken = (tried - 1) * self._most(count) + self._needed(count) + beside
            fits = taken <= self.budget and beside <= self.budget // _KEPT_LONG
            if fits and self._stored_at_most(count) <= self.device.largest:
                return self._whole_chunks(count)
        least = _EDGES[-1]
        self.device.buffers.require_room(self._stored_at_most(least))
        raise self._too_small(least)

    def _too_small(self, edge: int) -> OptionError:
        """What is said of a budget that holds no brick."""
        why = f"a brick of {edge}³ samples takes"
        if self._needed(edge) > self._most(edge):
            why = f"reading {why}" + (f" with its chunk of {self._one} bytes" if self._one else ", low-passed")
        return OptionError(f"budget must be at least {self._needed(edge)} bytes, which {why}; got {self.budget}")

    def _fits_at_once(self) -> bool:
        """Whether one brick may be all of it: samples that are in memory cost nothing to read, and one brick has no margins."""
        data, size = self.volume.data, self.volume.size
        in_memory = isinstance(data, np.ndarray) and not isinstance(data, np.memmap)
        nbytes = bytes_of(size, self.filter, self.boundary, np.float32)
        return in_memory and not self._wraps and nbytes <= self.device.largest and self._most(max(size)) <= self.budget

    def _whole_chunks(self, edge: int) -> int:
        """As many samples that are whole chunks along all axes, if they can be that."""
        common = math.lcm(*(self.volume.chunks or (1,)))
        return edge // common * common or edge

    def _long(self, edge: int) -> tuple[bool, ...]:
        """Along which axes, x first, chunks are longer than bricks."""
        if self._lines is None:
            return False, False, False
        return tuple(int(np.diff(line).max()) > edge for line in self._lines[::-1])

    def _layer(self, edge: int) -> int:
        """Bytes of the chunks, at most, that a layer of bricks reaches into: each is unpacked once if so many are kept.

        The layer lies across an axis along which chunks are no longer than bricks.
        """
        if self._lines is None:
            return 0
        lengths = []
        for line in self._lines[::-1]:
            ends = np.arange(0, line[-1], edge)
            low, high = np.maximum(ends - self._around - _ALIGNED, 0), np.minimum(ends + edge + self._around, line[-1])
            lengths.append(int((line[np.searchsorted(line, high, "left")] - line[np.searchsorted(line, low, "right") - 1]).max()))
        size, nbytes = self.volume.size, self.volume.dtype.itemsize
        across = [axis for axis, long in enumerate(self._long(edge)) if not long] or [0, 1, 2]
        return max(nbytes * math.prod(size) // size[axis] * lengths[axis] for axis in across)

    def _chunks_kept(self) -> Chunks | None:
        """Chunks that were unpacked, for bricks that reach into them too."""
        if self._lines is None:
            return None

        def read(at: tuple[slice, slice, slice]) -> NDArray[Any]:
            z, y, x = at
            return volume.read((x.start, y.start, z.start), (x.stop, y.stop, z.stop))

        volume = self.volume
        if any(self.long_chunks):
            most = min(volume.nbytes, self.budget // _KEPT_LONG)
        else:
            most = min(self._layer(self.edge), self.budget // _KEPT)
        return Chunks(read, self._lines, volume.dtype, most, self._account, one=self._one)

    @property
    def long_chunks(self) -> tuple[bool, ...]:
        """Along which axes, x first, chunks are longer than bricks: those are unpacked once where bricks follow along these."""
        return self._long(self.edge)

    def _most(self, edge: int) -> int:
        """Bytes that a brick takes while it is made, at most."""
        count = math.prod(self._size_at_most(edge))
        return int(self._stored_at_most(edge) * 1.1) + count * (1 + self.volume.dtype.itemsize)

    def _needed(self, edge: int) -> int:
        """The same while it is read, too, with all that this takes beside."""
        size, data = self._size_at_most(edge), self.volume.data
        if isinstance(data, Reduced):
            return max(self._most(edge), data.taken(size[::-1]))
        return max(self._most(edge), math.prod(size) * self.volume.dtype.itemsize + UNPACKING * self._one)

    def _size_at_most(self, edge: int) -> tuple[int, ...]:
        """Samples along the edges of a brick with its margins, at most."""
        beside = 2 * self._around + _ALIGNED
        if self._wraps:  # bricks reach past the volume's faces
            return tuple(min(n, edge) + beside for n in self.volume.size)
        return tuple(min(n, edge + beside) for n in self.volume.size)

    def _stored_at_most(self, edge: int) -> int:
        """Bytes of a brick's coefficients, at most: one buffer."""
        return bytes_of(self._size_at_most(edge), self.filter, self.boundary, np.float32)

    @property
    def _around(self) -> int:
        """Samples past a brick's cells that are read for it."""
        support = -(-(self.filter.support + 1) // 2 // self.filter.scale)  # half of the taps lie to either side
        coarse = self.filter.magnified_by.support if self.filter.magnified_by else 0
        return self._margin + support + coarse + _AROUND

    @cached_property
    def coefficients(self) -> Whole:
        """What pictures ask of the whole volume's."""
        return Whole(self.volume.known(), self.filter, self._extent, self.device, self.stored)

    @cached_property
    def counts(self) -> Index:
        """How many bricks there are along x, y and z."""
        x, y, z = (max(1, -(-n // self.edge)) for n in self.volume.size)
        return x, y, z

    @property
    def away(self) -> float:
        """How far past samples bricks begin: cells of odd supports begin between samples."""
        return 0.0 if self.filter.support % 2 == 0 else 0.5 / self.filter.scale

    def bricks(self) -> Iterator[Brick]:
        """All of them, in the order in which they are stored."""
        x, y, z = map(range, self.counts)
        return (self.brick((i, j, k)) for k in z for j in y for i in x)

    def brick(self, at: Index) -> Brick:
        """Where one of them lies."""
        away = self.away
        low, high, first, last = [], [], [], []
        for i, count, n in zip(at, self.counts, self.volume.size, strict=True):
            a, b = i * self.edge, (i + 1) * self.edge
            low.append(-math.inf if i == 0 else a + away)
            high.append(math.inf if i == count - 1 else b + away)
            wrapped = self._wraps
            begin, end = (a - self._around) // _ALIGNED * _ALIGNED, (min(b, n) if wrapped else b) + self._around
            first.append(begin if wrapped else max(0, begin))
            last.append(end if wrapped else min(n, end))
        return Brick(at, tuple(low), tuple(high), (first[0], first[1], first[2]), (last[0], last[1], last[2]))

    @property
    def _wraps(self) -> bool:
        """Whether samples past one face of the volume are those at the other."""
        return self.boundary.fold is None and self.boundary.repeats

    # -- their coefficients ------------------------------------------------------------------------------------------------

    def read(self, low: Index, high: Index) -> NDArray[Any]:
        """As `LazyVolume.read`, by way of the chunks that are kept."""
        if self._chunks is None:
            return self.volume.read(low, high)
        return self._chunks[tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))]  # type: ignore[index]  # three

    def samples(self, brick: Brick) -> NDArray[Any]:
        """The samples that a brick's coefficients are computed from, [z, y, x].

        Raises
        ------
        FormatError, DataError
            As by `LazyVolume.read`.
        """
        pieces = [_runs(a, b, n) for a, b, n in zip(brick.first, brick.last, self.volume.size, strict=True)]
        self._count(math.prod(b - a for a, b in zip(brick.first, brick.last, strict=True)))
        x, y, z = pieces
        samples = self._gathered(x, y, z)
        self._require_names(lambda: replace(self.volume.known(), data=samples))  # limits may be those of a few samples
        return samples

    def _require_names(self, volume: Callable[[], Volume]) -> None:
        """Refuse labels that float32 does not tell apart."""
        if self.filter.support == 1 and self.volume.dtype.itemsize > 2 and names_beyond(24, found := volume(), self.filter):
            low, high = map(int, found.limits)
            raise DataError(f"labels must be whole numbers that float32 holds, up to 2**24; got {low} to {high}: {RENUMBER}")

    def _gathered(self, x: list[slice], y: list[slice], z: list[slice]) -> NDArray[Any]:
        """The samples at some runs along each axis, put together."""
        rows = [
            np.concatenate(
                [np.concatenate([self.read((i.start, j.start, k.start), (i.stop, j.stop, k.stop)) for i in x], axis=2) for j in y],
                axis=1,
            )
            if len(x) * len(y) > 1
            else self.read((x[0].start, y[0].start, k.start), (x[0].stop, y[0].stop, k.stop))
            for k in z
        ]
        return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=0)

    def _count(self, samples: int) -> None:
        """So many samples are read."""
        with self._residents.lock:
            self.reads.samples += samples

    def _counted(self, low: Index, high: Index) -> NDArray[Any]:
        """As `read`, and counted."""
        self._count(math.prod(b - a for a, b in zip(low, high, strict=True)))
        return self.read(low, high)

    def summed(self, sums: Mapping[int, Sums], kind: type[np.generic], outside: float) -> Reduced:
        """Sums along the axes of the samples, which are computed where they are read: see `Reduced`."""
        beside = 0 if self._chunks is None else self._chunks.unpacking_most
        return Reduced(self.volume, sums, kind, self.device, outside, self._counted, beside)

    def blocks_of(self, sums: Mapping[int, Sums], kind: type[np.generic], outside: float) -> Iterator[_Part]:
        """All of these, block by block, within the budget.

        Raises
        ------
        OptionError
            It does not hold the least block.
        """
        made = self.summed(sums, kind, outside)
        for block, nbytes, done in made.blocks(self.budget, 0 if self._chunks is None else self._chunks.most):
            with self._account.set_aside(nbytes, self._residents):
                values = made[block]
            yield block, values, done

    def resident(self, brick: Brick) -> AbstractContextManager[Resident]:
        """A brick's coefficients, on the device for the time of a block, and longer if there is room.

        Threads read different bricks side by side; one that finds no room waits until another has done with a brick.
        """
        size = tuple(b - a for a, b in zip(brick.first, brick.last, strict=True))
        made = bytes_of(size, self.filter, self._own_boundary, np.float32)
        stored = made // np.dtype(np.float32).itemsize  # cells, and some more
        samples = math.prod(size) * self.volume.dtype.itemsize
        nbytes = max(made + max(samples, bytes_beside((stored,))), samples + self._beside(brick))
        return self._residents.held(brick.at, nbytes, partial(self.samples, brick), partial(self._made, brick))

    def _beside(self, brick: Brick) -> int:
        """Bytes that reading a brick takes beside its samples: chunks, which are unpacked as a whole, and what sums are made of."""
        data = self.volume.data
        if isinstance(data, Reduced):
            size = [b - a for a, b in zip(brick.first, brick.last, strict=True)]
            return data.taken(size[::-1]) - math.prod(size) * data.dtype.itemsize
        if self._chunks is None:
            return 0
        inside = [slice(max(a, 0), min(b, n)) for a, b, n in zip(brick.first, brick.last, self.volume.size, strict=True)]
        return self._chunks.unpacking(inside[::-1])

    @property
    def _own_boundary(self) -> Boundary:
        """The rule at the faces of bricks: samples of one that reaches past the volume's are there."""
        return as_boundary(DEFAULT_BOUNDARY) if self._wraps else self.boundary

    def _made(self, brick: Brick, samples: NDArray[Any]) -> Resident:
        grid = replace(self.volume.grid, data=np.broadcast_to(np.zeros((), self.volume.dtype), samples.shape))
        try:
            made = Coefficients(grid, self.filter, self._own_boundary, self.device, self.stored)
        except OutOfMemoryError:  # others take what the budget allows
            self._residents.make_room()
            made = Coefficients(grid, self.filter, self._own_boundary, self.device, self.stored)
        return Resident(brick.at, filled(made, samples))

    def going_through(self, order: Sequence[Index]) -> None:
        """Bricks will be asked for in this order, and perhaps once more from the first on: by the next rays or picture."""
        self._residents.going_through(order)

    def read_ahead(self, brick: Brick) -> None:
        """Have the samples of a brick read while something else is done, if it is not there, and there is room for them."""
        if not self.volume.ahead:
            return
        nbytes = math.prod(b - a for a, b in zip(brick.first, brick.last, strict=True)) * self.volume.dtype.itemsize
        nbytes += self._beside(brick)
        self._residents.read_ahead(brick.at, nbytes, partial(self.samples, brick))

    def forget_ahead(self) -> None:
        """What was read ahead for this thread is not wanted."""
        self._residents.forget_ahead()

    def pyramid(self, own: Resident, evaluator: Evaluator) -> MinMax:
        """Minima and maxima of a brick's cells."""
        with own.lock:
            if own.minmax is None:
                made = MinMax(own.coefficients, evaluator, self._blocks(own))
                self._bounds[own.at] = self._in_units(made.extremes())
                own.minmax = made
            return own.minmax

    def cells_of(self, brick: Brick) -> tuple[Index, Index]:
        """A brick's own cells, as numbered in the whole volume by their first taps among all that would be stored."""
        halo, left = int(self._extent[3]), self.filter.support / 2 - 1
        ends = [
            tuple(round(min(max(end * self.filter.scale, -_FAR), _FAR) - left) + halo for end in ends)
            for ends in (brick.low, brick.high)
        ]
        return ends[0], ends[1]  # type: ignore[return-value]  # three each

    def _blocks(self, own: Resident) -> tuple[Index, Index]:
        """The cells of a brick's pyramid, by their numbers in the brick: its own, and some beside, which neighbours may ask for."""
        brick, scale, support = self.brick(own.at), self.filter.scale, self.filter.support
        first, past = [], []
        cells = self.cells_of(brick)
        for low, high, begin, n in zip(*cells, brick.first, own.coefficients.shape[::-1], strict=True):
            a = low - begin * scale - BLOCK * scale
            first.append(max(0, a // _ALIGNED * _ALIGNED))
            past.append(min(n - support + 1, high - begin * scale + BLOCK * scale))
        return (first[0], first[1], first[2]), (past[0], past[1], past[2])

    def bounds_of(self, brick: Brick) -> tuple[float, float] | None:
        """Between which values the function lies in a brick and beside it, in units of the data, as far as is known.

        What is stored tells of blocks that reach past the brick; what was found of its own cells, once it was read, is tighter.
        """
        found = self._bounds.get(brick.at)
        kept = self.volume.bounds
        if kept is None or (kept.filter, kept.boundary) != (self.filter.name, self.boundary.name):
            return found
        beside = _AROUND + 1  # rays look so far back
        ends = zip(brick.low, brick.high, self.volume.size, strict=True)
        low, high = zip(*((math.floor(max(a - beside, 0)), math.ceil(min(b + beside + 1, n))) for a, b, n in ends), strict=True)
        stored = kept.within((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        return stored if found is None else (max(stored[0], found[0]), min(stored[1], found[1]))

    def stored_bounds_of(self, brick: Brick) -> tuple[float, float] | None:
        """The same in the numbers that kernels know, rounded outwards."""
        ends = self.bounds_of(brick)
        if ends is None:
            return None
        low, high = (np.float32(value) for value in self.stored(np.array(ends, np.float64)))
        return float(np.nextafter(low, np.float32(-np.inf))), float(np.nextafter(high, np.float32(np.inf)))

    def has(self, brick: Brick) -> bool:
        """Whether a brick's coefficients are on the device."""
        return self._residents.has(brick.at)

    def _in_units(self, stored: tuple[float, float]) -> tuple[float, float]:
        low, high = (float(v) for v in self.stored.values(np.array(stored, np.float32)))
        return low, high

    @property
    def nbytes(self) -> int:
        """Bytes of bricks on the device, of those that are being read, of samples that were read ahead, and of chunks."""
        return self._residents.nbytes

    # -- as a Field ----------------------------------------------------------------------------------------------------------

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._lease.closed

    def close(self) -> None:
        """Free the device's memory. Results stay valid; asking for more raises `OptionError`."""
        self._lease.close()

    def drop(self) -> None:
        """Free the device's memory of all bricks that nobody uses; they are read again when they are needed."""
        self._residents.drop()

    def in_use(self) -> AbstractContextManager[None]:
        """For the time of a block `close` frees nothing; errors as of `Field.in_use`."""
        self.device.require_usable()
        return self._lease.held()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled is what the field is made of."""
        again = partial(type(self), budget=self.budget, edge=self.edge)
        return again, (self.volume, self.filter, self.boundary, self.device)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def __call__(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Values at points of the world, as of a call of `Field`; each brick that some lie in is read once."""
        return self._at(points, 0, frame, fill, progress, out)

    def at_samples(
        self, positions: NDArray[np.float64], *, fill: float | None = None, progress: Progress | None = None
    ) -> NDArray[Any]:
        """Values at positions in samples, shape (N, 3), (x, y, z); NaN where one is not finite."""
        with self.in_use():
            return self._at_indices(positions, 0, fill, progress)[:, 0]

    def gradient(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Gradients at points of the world, as of `Field.gradient`."""
        return self._at(points, 1, frame, fill, progress, out)

    def hessian(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Second derivatives at points of the world, as of `Field.hessian`."""
        return self._at(points, 2, frame, fill, progress, out)

    def _at(
        self, points: ArrayLike, derivative: int, frame: Frame, fill: float | None, progress: Progress | None, out: Any
    ) -> Reals:
        with self.in_use():
            array = as_points(points, frame, self.volume.grid)
            shape = array.shape[:-1] + (3,) * derivative
            target = None if out is None else as_output(out, shape)
            memory.require(8 * math.prod(shape) + 32 * math.prod(array.shape), f"{math.prod(shape)} results")
            flat = self._at_indices(
                self.volume.grid.world_to_index(np.asarray(array, np.float64).reshape(-1, 3)),
                derivative,
                fill_value(fill),
                progress,
            )
            if frame == "RAS" and derivative:
                turn = np.array([-1.0, -1.0, 1.0])
                flat *= (turn if derivative == 1 else np.outer(turn, turn).ravel()).astype(flat.dtype)
            results = flat.reshape(shape)
            if target is None:
                return results
            target[...] = results
            return out  # type: ignore[no-any-return]  # as of whoever gave it

    def _at_indices(
        self, at: NDArray[np.float64], derivative: int, fill: float | None, progress: Progress | None = None
    ) -> NDArray[Any]:
        """Values, or derivatives in the world, at positions in samples, shape (N, 3); (N, 3 ** derivative) but for values."""
        grid, rule = self.volume.grid, self.boundary
        columns = 3**derivative
        results = np.full((len(at), columns), np.nan, np.float32)
        known = np.isfinite(at).all(1)
        with np.errstate(invalid="ignore"):
            inside = ((at >= -rule.edge) & (at <= np.asarray(self.volume.size) - 1 + rule.edge)).all(1)
        places, signs = np.zeros_like(at), np.ones_like(at)
        for axis, n in enumerate(self.volume.size):
            x = np.where(known, at[:, axis], 0.0)
            own = (x >= -rule.edge) & (x <= n - 1 + rule.edge)  # bricks at faces have what these take: folded, ties would be others
            places[:, axis] = np.where(own, x, rule.position(x, n, self._pad, self._reach))
            if derivative and rule.repeats and rule.fold is not None:  # in a mirror slopes run the other way
                signs[:, axis] = np.where(own, 1.0, _way(x, partial(rule.position, n=n, pad=self._pad, reach=self._reach)))
        given = ~known if fill is None else ~known | ~inside
        if rule.outside == "constant":
            given |= ~inside
        wanted = np.flatnonzero(~given)
        if len(wanted):
            self._by_bricks(places, wanted, derivative, results, progress)
        final: NDArray[Any] = NOTHING_GIVEN.in_units_of_data(self._any, results, derivative)
        if derivative and (signs < 0).any():
            flip = signs if derivative == 1 else (signs[:, :, None] * signs[:, None, :]).reshape(-1, 9)
            inverse = grid.world_to_index_matrix
            final = _turned(final, flip, inverse, derivative)
        if rule.outside == "constant":
            final[known & ~inside] = rule.cval if derivative == 0 else 0.0
        if fill is not None:
            final[known & ~inside] = fill
        return final

    def _owners(self, positions: NDArray[np.float64], counts: NDArray[np.int64] | int) -> NDArray[np.int64]:
        """The numbers of the bricks in which positions lie, of so many along their axis."""
        return np.clip(np.floor((positions - self.away) / self.edge), 0, counts - 1).astype(np.int64)

    @property
    def _any(self) -> Any:
        """What says how results of kernels are brought to units of the data."""
        return _Units(self.stored, replace(self.boundary, cval=math.nan))

    def _by_bricks(
        self,
        places: NDArray[np.float64],
        wanted: NDArray[np.intp],
        derivative: int,
        results: NDArray[Any],
        progress: Progress | None,
    ) -> None:
        """The function at the wanted places, brick by brick."""
        owners = self._owners(places[wanted], np.asarray(self.counts))
        nx, ny, _ = self.counts
        number = (owners[:, 2] * ny + owners[:, 1]) * nx + owners[:, 0]
        order = np.argsort(number, kind="stable")
        ends: list[int] = (np.flatnonzero(np.diff(number[order], append=-1)) + 1).tolist()
        runs = list(zip([0, *ends[:-1]], ends, strict=True))
        bricks = [self.brick((int(x), int(y), int(z))) for x, y, z in owners[order[[first for first, _ in runs]]]]
        move = Transform(np.eye(3), np.zeros(3), self.volume.grid.world_to_index_matrix)
        self.going_through([brick.at for brick in bricks])
        try:
            for (first, last), brick, following in zip(runs, bricks, [*bricks[1:], None], strict=True):
                some = wanted[order[first:last]]
                with self.resident(brick) as own:
                    if following is not None:
                        self.read_ahead(following)
                    local = places[some] - np.asarray(brick.first, np.float64)
                    part = np.empty((len(some), results.shape[1]), np.float32)
                    sample_into(own.coefficients, DIRECT, local, part, move, derivative)
                    results[some] = part
                if progress:
                    progress(last / len(wanted))
        finally:
            self.forget_ahead()

    def resample(
        self,
        shape: Sequence[int] | None = None,
        spacing: Sequence[float] | float | None = None,
        like: Any = None,
        *,
        anchor: Anchor = "center",
        transform: Transforms | None = None,
        anti_aliasing: AntiAliasing | bool = False,
        dtype: DTypeLike | None = None,
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Volume:
        """The function on another grid, as of `Field.resample`: a slice, a part, or all of it at another density.

        Through a transform each block of results asks for the bricks in which its points come to lie. With `anti_aliasing` a grid
        along the axes is sums of samples, each of which is read about once: by "least-squares" those of `Field.resample`, to the
        last bit in the same precision. Of another grid, and where smoothing is found for the volume, samples are low-passed as they
        are read.

        `out` may be anything that takes slices, such as a memory map or an array of Zarr, for results larger than memory. Of one of
        NumPy the result's data are a view; of another the result says where they lie and has none, and `out` holds them.

        Raises
        ------
        OptionError, GeometryError, OutOfMemoryError
            As by `Field.resample`.
        """
        grid = grid_for(self.volume.grid, shape, spacing, like, anchor)
        kind = result_kind(dtype, self.volume.grid, self.filter, out, fill)
        if out is not None and np.dtype(out.dtype).kind != "f":
            raise OptionError(f"out must be of floating type; got {out.dtype}: results are rounded with dtype=, and no out")
        outside, stages, low_pass = fill_value(fill), as_chain(transform, 3), as_anti_aliasing(anti_aliasing)
        if low_pass:
            require_no_transform(stages)
        with self.in_use():
            chain = Chain(stages, grid, self.device)
            matrix, offset = chain.to_indices(self.volume.grid) if stages else between(self.volume.grid, grid)
            return self._on_grid(grid, matrix, offset, outside, kind, chain if chain.stages else None, low_pass, progress, out)

    def magnify(self, factor: int = 2, *, progress: Progress | None = None) -> Volume:
        """The volume with `factor` times the samples along each axis, the given ones among them, as of `Field.magnify`.

        Raises
        ------
        OptionError, OutOfMemoryError
            As by `Field.magnify`.
        """
        given, factor = self.volume.grid, whole("factor", factor, minimum=1)
        shape = tuple(factor * n for n in given.shape)
        if math.prod(shape) > np.iinfo(np.intp).max // 16:
            raise OptionError(f"the result must have a size that can be addressed; got shape {shape}")
        spacing = tuple(s / factor for s in given.spacing)
        finer = Volume(np.broadcast_to(np.float32(0), shape), spacing, given.origin, given.direction, given.units)
        kind = result_kind(None, given, self.filter, None, None)
        with self.in_use():  # never by way of the world, whose rounding would tell where samples are that lie on the given ones
            return self._on_grid(finer, np.eye(3) / factor, np.zeros(3), None, kind, progress=progress)

    def _on_grid(
        self,
        grid: Volume,
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
        fill: float | None,
        kind: np.dtype[Any] | None,
        chain: Chain | None = None,
        low_pass: AntiAliasing = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Volume:
        """The function at the samples of a grid, whose indices a matrix and an offset lead to those of the volume."""
        if out is None:
            memory.require(math.prod(grid.shape) * (kind or np.dtype(np.float32)).itemsize, f"a result of shape {grid.shape}")
        elif tuple(getattr(out, "shape", ())) != grid.shape:
            raise OptionError(f"out must have the shape of the results, {grid.shape}; got {getattr(out, 'shape', None)}")
        wide: np.dtype[Any] = np.dtype(np.float64 if self.stored.alters(0) else np.float32)
        data = np.empty(grid.shape, kind or wide) if out is None else out
        for place, values, done in self._parts(matrix, offset, grid.shape, fill, chain, low_pass):
            data[place] = values if kind is None else in_kind(values, kind)
            if progress:
                progress(done)
        held = data if isinstance(data, np.ndarray) else np.broadcast_to(np.zeros((), kind or wide), grid.shape)
        return self.volume.grid.placed(held, grid)

    def _parts(
        self,
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
        shape: tuple[int, ...],
        fill: float | None,
        chain: Chain | None = None,
        low_pass: AntiAliasing = None,
    ) -> Iterator[_Part]:
        """The parts of a grid, each with its values and how much is done then.

        `matrix` and `offset` lead from its indices, or from where a chain brings its points, to those of the volume.
        """
        if low_pass and (found := self._sums_for(matrix, offset, shape, low_pass)) is not None:
            yield from self._by_sums(*found, matrix, offset, shape, fill)
        elif low_pass == "gaussian" and (steps_along(matrix) > 1).any():
            smooth = self._low_passed(steps_along(matrix))
            # smoothing that is found for a volume is found for what is there now, as for a volume in memory
            with BrickedField(smooth, self._asked, self.boundary, self.device, beside=self) as field:
                yield from field._parts(matrix, offset, shape, fill)
        elif chain is None and no_shear(matrix, shape):
            yield from self._along_axes(matrix, offset, shape, fill)
        else:
            yield from self._in_blocks(matrix, offset, shape, fill, chain)

    def _sums_for(
        self, matrix: NDArray[np.float64], offset: NDArray[np.float64], shape: tuple[int, ...], low_pass: AntiAliasing
    ) -> tuple[dict[int, Sums], type[np.generic]] | None:
        """A low-passed grid as sums along the axes, and the type that these are made in; None where it is none."""
        rule = self.boundary
        kind = wide_enough(np.float32, _ends_of(self.volume), self.filter, rule)
        if low_pass == "least-squares":
            return nearest_sums(self.volume.known(), self.filter, rule, kind, matrix, offset, shape)
        continues = rule.period is not None and rule.outside in ("rule", "clamp")
        if not (no_shear(matrix, shape) and continues and self.filter.magnified_by is None and self._asked.settled):
            return None
        made = {}
        for axis, n in enumerate(self.volume.size):
            line = offset[axis] + matrix[axis, axis] * np.arange(shape[2 - axis])
            sums = interpolated(self.filter.along(axis), line, n, rule, kind == np.float64)
            made[2 - axis] = smoothed(sums, (abs(float(matrix[axis, axis])) - 1) / 2, rule)
        return made, kind

    def _by_sums(
        self,
        sums: Mapping[int, Sums],
        kind: type[np.generic],
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
        shape: tuple[int, ...],
        fill: float | None,
    ) -> Iterator[_Part]:
        """Those of a grid that is sums along the axes: blocks."""
        past = None if fill is None else beyond(matrix, offset, self.volume.shape, shape, self.boundary)
        for block, values, done in self.blocks_of(sums, kind, self.boundary.cval):
            for axis, part in enumerate(block):
                if past is not None:
                    np.moveaxis(values, axis, 0)[past[axis][part]] = fill
            yield block, values, done

    def _low_passed(self, steps: NDArray[np.float64]) -> LazyVolume:
        """The volume after the Gaussian that suits a grid of such steps, computed where it is read: see `low_passed`."""
        volume, grid = self.volume, self.volume.grid
        sums = gaussian_sums(volume.shape, steps, self.boundary)
        kind = wide_enough(np.float32, _ends_of(volume), bspline(1), self.boundary)
        return LazyVolume(
            self.summed(sums, kind, self.boundary.cval),
            grid.spacing,
            grid.origin,
            grid.direction,
            labels=False,
            limits=volume.limits,
        )

    def _in_blocks(
        self,
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
        shape: tuple[int, ...],
        fill: float | None,
        chain: Chain | None = None,
    ) -> Iterator[_Part]:
        """Those of a grid that lies anyhow: blocks."""
        room = self.budget // _RESULTS // _OF_A_RESULT
        edge = next((n for n in _BLOCKS_OF_RESULTS if n**3 <= room), _BLOCKS_OF_RESULTS[-1])
        starts = [range(0, n, edge) for n in shape]
        count = math.prod(map(len, starts))
        for done, corner in enumerate(itertools.product(*starts), 1):
            place = tuple(slice(a, min(a + edge, n)) for a, n in zip(corner, shape, strict=True))
            size = [s.stop - s.start for s in place]
            with self._account.set_aside(_OF_A_RESULT * math.prod(size), self._residents):
                if chain is None:
                    z, y, x = np.meshgrid(*(np.arange(s.start, s.stop, dtype=np.float64) for s in place), indexing="ij")
                    points = np.stack([x, y, z], -1).reshape(-1, 3)
                else:
                    points = chain.places(place)
                values = self._at_indices(points @ matrix.T + offset, 0, fill)
            yield place, values.reshape(size), done / count

    def _along_axes(
        self, matrix: NDArray[np.float64], offset: NDArray[np.float64], shape: tuple[int, ...], fill: float | None
    ) -> Iterator[_Part]:
        """Those of a grid along the axes: what of it lies in each brick, axis by axis."""
        lines = [offset[axis] + matrix[axis, axis] * np.arange(n) for axis, n in enumerate(shape[::-1])]
        past = beyond(matrix, offset, self.volume.shape, shape, self.boundary)
        if any(one.any() for one in past):  # rare, and each rule is at home in points
            yield from self._in_blocks(matrix, offset, shape, fill)
            return
        bricks = list(self.bricks())
        self.going_through([brick.at for brick in bricks])
        owners = [self._owners(x, count) for x, count in zip(lines, self.counts, strict=True)]
        for done, brick in enumerate(bricks, 1):
            own = [np.flatnonzero(owner == i) for owner, i in zip(owners, brick.at, strict=True)]
            if not all(map(len, own)):
                continue
            part = tuple(len(places) for places in own[::-1])
            start = np.array([line[places[0]] for line, places in zip(lines, own, strict=True)]) - np.asarray(brick.first)
            values = np.empty(part, np.float32)
            with self.resident(brick) as resident, self.device.buffers.lent(values, write=True) as buffer:
                resample_coefficients(resident.coefficients, DIRECT, np.diag(np.diag(matrix)), start, part, buffer, NOTHING_GIVEN)
            place = tuple(slice(int(places[0]), int(places[-1]) + 1) for places in own[::-1])
            yield place, NOTHING_GIVEN.in_units_of_data(self._any, values, 0), done / len(bricks)


@dataclass(frozen=True)
class _Units:
    """What `Given.in_units_of_data` asks of coefficients."""

    stored: Stored
    boundary: Boundary


def as_lazy(volume: LazyVolume | Volume | ArrayLike) -> LazyVolume:
    """A LazyVolume as it is; of a volume or an array one whose samples are at hand."""
    if isinstance(volume, LazyVolume):
        return volume
    if isinstance(volume, Volume):
        if volume.ndim != 3:
            raise DataError(f"bricks are of a volume with 3 axes; got shape {volume.shape}")
        volume.require_finite()
        made = LazyVolume(volume.data, limits=volume.value_range)
        made.grid = replace(volume, data=made.grid.data)  # all that the volume says, but for its samples
        return made
    return LazyVolume(volume)  # type: ignore[arg-type]  # which says what it takes


def _ends_of(volume: LazyVolume) -> Volume:
    """Two samples: the smallest and the largest one, in the volume's type."""
    low, high = volume.limits
    kind = volume.dtype
    ends = np.array([low, high]) if kind.kind == "f" else np.array([math.floor(low), math.ceil(high)])
    if kind.kind in "iu":
        ends = np.clip(ends, np.iinfo(kind).min, np.iinfo(kind).max)
    return Volume(ends.astype(kind).reshape(1, 1, 2))


def _runs(first: int, last: int, n: int) -> list[slice]:
    """Indices from `first` to `last` of an axis that repeats with period `n`, as runs within it."""
    runs = []
    while first < last:
        begin = first % n
        some = min(last - first, n - begin)
        runs.append(slice(begin, begin + some))
        first += some
    return runs


def _way(x: NDArray[np.float64], position: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """1 where what stands for positions grows with them, -1 where it falls."""
    step = 1e-3
    here = position(x)
    ahead, behind = position(x + step) - here, here - position(x - step)
    smooth = np.abs(np.abs(ahead) - step) < 1e-6 * step * (1 + np.abs(x))  # it neither turns nor jumps on the way
    return np.where(np.where(smooth, ahead, behind) < 0, -1.0, 1.0)


def _turned(derivatives: NDArray[Any], flip: NDArray[np.float64], inverse: NDArray[np.float64], order: int) -> NDArray[Any]:
    """Derivatives per unit of the world whose axes in index space are reversed by `flip`."""
    forward = np.linalg.inv(inverse)
    if order == 1:
        return np.asarray(((derivatives @ forward) * flip) @ inverse, derivatives.dtype)
    square = derivatives.reshape(-1, 3, 3)
    own = forward.T @ square @ forward * flip.reshape(-1, 3, 3)
    return np.asarray(inverse.T @ own @ inverse, derivatives.dtype).reshape(-1, 9)
