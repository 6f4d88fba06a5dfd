"""The function of a volume that is larger than memory: `BrickedField`, whose coefficients come brick by brick.

A brick is a box of cells, with all coefficients that these take. They are computed from the brick's own samples and a margin around
it as wide as the prefilter reaches (`clvol.filter.margin`). At the volume's own faces the boundary rule goes on as it does for the
whole volume.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import if_image, suggests_options, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.memory import require
from clvol.base.rounding import in_kind
from clvol.bricks.bounds import BrickBounds
from clvol.bricks.budget import LEAST, Needs, edge_for, too_small
from clvol.bricks.chunks import stored_in_one
from clvol.bricks.evaluate import ByBricks, ends_of
from clvol.bricks.grid import NEIGHBOURS, BrickGrid
from clvol.bricks.reduced import Reduced
from clvol.bricks.residents import Account
from clvol.bricks.source import LazyVolume, known_of, memory_for, stored_lines
from clvol.bricks.store import Store, require_distinct_labels
from clvol.device import as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.margin import reach
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline.coefficients import Whole, bytes_of, extent_of
from clvol.spline.function import CLOSED, ContinuousFunction, fill_value
from clvol.spline.grids import described
from clvol.spline.lease import Lease
from clvol.spline.reduce import steps_along
from clvol.spline.regions import require_few_digits
from clvol.volume.missing import as_missing
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.bricks.residents import Reads
    from clvol.bricks.store import Part
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.function import Precision
    from clvol.spline.grids import Target
    from clvol.spline.points import Reals
    from clvol.volume.missing import Missing

__all__ = ["BrickedField", "BrickedLabels", "as_lazy", "of_lazy", "require_plain"]

_SHORT = 16  # samples along an edge of bricks, where chunks are damaged


@suggests_options
class BrickedField(ContinuousFunction):
    """The continuous function of a volume that is read brick by brick.

    It answers as a `Field` does, but keeps no more coefficients than `memory` allows: bricks that will be needed last are evicted
    first. Nothing is read before it is needed.

    Parameters
    ----------
    volume : LazyVolume, Volume or array-like, shape (nz, ny, nx)
        What is read: an array of Zarr, HDF5 or dask, a memory map, or a volume in memory whose coefficients do not fit there.
    filter : str or Filter, optional
        As of `Field`; by default that of the volume's bounds, if it has any, else "bspline3". Smoothing that is chosen for the
        volume ("bspline3(auto)") is chosen for its middle.
    boundary : str or Boundary
        As of `Field`.
    device : Device, str or int, optional
        See `as_device`.
    memory : int, optional
        Bytes that bricks may take, on the device and while they are read, with unpacked chunks; by default 2 GiB, or
        half of the available memory if that is less, or more where unpacking a chunk takes as much.
    edge : int, optional
        Samples along an edge of a brick; by default as many as let several bricks fit into the budget, 128 at most, or 256 where
        all of the volume fits, in whole chunks. Where chunks are longer than bricks, such as planes, the budget holds the chunks
        that a layer of bricks reaches into.
    at_once : bool
        Whether a volume in memory is one brick, if it fits and no `edge` is given; a cluster needs several.
    beside : BrickedField, optional
        A field that shares its budget with this one, such as another level of a picture.

    Attributes
    ----------
    volume : LazyVolume
    filter : Filter
    boundary : Boundary
    device : Device
    missing : Missing
        Always "error": a brick with missing samples is refused when it is read.
    memory, edge : int
    reads : Reads
        What was read until now.
    bricks : BrickGrid
        Where bricks lie.
    store : Store
        Reads bricks, and keeps them.
    bounds : BrickBounds
        Between which values the function lies in bricks.
    coefficients : Whole
        Metadata of the whole volume's.

    Raises
    ------
    DataError
        `LazyVolume` does not take `volume`, or float32 does not hold labels that are drawn by "nearest".
    OptionError
        `filter`, `boundary` or `device` is an unknown name; `edge` is no whole number of at least 8; `memory` is smaller than a
        brick, or than unpacking a chunk takes: the message says the least; or `memory` is given with `beside`.
    OutOfMemoryError
        The device allows no buffer that holds a brick.

    Notes
    -----
    Values differ from those of a `Field` by less than 10⁻⁶ of the samples' range where there is a prefilter; pictures with filters
    that have none are the same to the last bit. All is computed in single precision.
    """

    in_parts: ClassVar[bool] = True
    names: ClassVar[bool] = False
    """Whether samples are names, of which the function is never asked for blends."""
    store: Store

    def __init__(
        self,
        volume: LazyVolume | Volume | ArrayLike,
        filter: str | Filter | None = None,
        boundary: str | Boundary | None = None,
        device: Device | str | int | None = None,
        *,
        memory: int | None = None,
        edge: int | None = None,
        at_once: bool = True,
        beside: BrickedField | None = None,
    ) -> None:
        if beside is not None and memory is not None:
            raise OptionError(f"memory must be left to the field beside which this one is; got {memory!r} with it")
        self.volume = volume = as_lazy(volume)
        own = 0 if beside is not None else memory_for(volume, memory)
        kept = volume.bounds
        chosen = kept.filter if filter is None and kept is not None else filter
        if boundary is None:
            boundary = DEFAULT_BOUNDARY if kept is None else kept.boundary
        self._asked = row = filter_for(volume.part(), None, DEFAULT_FILTER) if chosen is None else as_filter(chosen)
        known = row.settled and (row.magnified_by is None or row.magnified_by.settled)
        self.filter = row = settled(row, volume.grid if known else volume.part())
        require_distinct_labels(row, volume, partial(known_of, volume))
        if self.names:
            require_few_digits(known_of(volume))
        self.boundary = rule = as_boundary(boundary)
        self.device, self.missing = as_device(device), as_missing("error")
        account: Account = Account(own) if beside is None else beside.store.account
        self.memory = account.budget
        self.stored = Stored.of(ends_of(volume), row, rule)
        needs = _needs(volume, row, rule)
        self.edge = _edge(needs, edge, self.memory, self.device, volume, at_once=at_once)
        outside = rule.padding((row.magnified_by or row).prefilter, row.support) + rule.reach(row.support)
        self._extent = extent_of(row, 3, tuple(row.scale * n for n in volume.size), row.scale * outside)
        self.bricks = BrickGrid(volume.size, self.edge, needs.margin, needs.wraps, row.support, row.scale, int(self._extent[3]))
        self.store = Store(volume, row, rule, self.device, self.stored, self.bricks, needs, account, names=self.names)
        self.bounds = BrickBounds(self.bricks, self.stored, kept, row, rule, names=self.names)
        self.long_chunks = needs.long_chunks(self.edge)
        self._function = ByBricks(volume, row, rule, self.device, self.stored, self.bricks, self.store)
        self._lease = Lease(CLOSED)
        self._lease.frees(self.store.release)  # not of the field: it would be a cycle

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.volume.shape))
        state = ", closed" if self.closed else ""
        return f"<BrickedField of {shape} samples, {self.filter.name}, {self.boundary.name}, bricks of {self.edge}³{state}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """A pickle holds what the field is made of."""
        again = partial(type(self), memory=self.memory, edge=self.edge)
        return again, (self.volume, self.filter, self.boundary, self.device)

    @property
    def grid(self) -> Volume:
        """Where samples lie, and all that the volume says of itself; it holds none."""
        return self.volume.grid

    @property
    def precision(self) -> Precision:
        """Always "single"."""
        return "single"

    @property
    def nbytes(self) -> int:
        """Bytes of resident bricks, of bricks that are being read, of samples read ahead, and of chunks."""
        return self.store.nbytes

    @property
    def reads(self) -> Reads:
        """What was read until now."""
        return self.store.reads

    @cached_property
    def coefficients(self) -> Whole:
        """Metadata of the whole volume's coefficients, for pictures."""
        return Whole(known_of(self.volume), self.filter, self._extent, self.device, self.stored)

    def drop(self) -> None:
        """Evict all bricks that nobody uses; they are read again when they are needed."""
        self.store.drop()

    def at_samples(
        self, positions: NDArray[np.float64], *, fill: float | None = None, progress: Progress | None = None
    ) -> NDArray[Any]:
        """Values at positions in samples, shape (N, 3), (x, y, z); NaN where one is not finite."""
        with self.in_use():
            return self._function.at(positions, 0, fill_value(fill), progress)[:, 0]

    # -- as a continuous function ------------------------------------------------------------------------------------------

    def _settled(self, filter: str | Filter) -> Filter:
        return settled(filter, self.volume.part())

    def _bytes_at(self, points: int, derivative: int, *, into: bool) -> int:  # noqa: ARG002  # results are never computed there
        results: int = 3**derivative
        return points * (8 * results + 32 * 3)

    def _at(
        self,
        points: NDArray[Any],
        derivative: int,
        fill: float | None,
        progress: Progress | None,
        out: NDArray[Any] | None,  # noqa: ARG002  # results are put there once all bricks were read
    ) -> Reals:
        index = self.grid.world_to_index(np.asarray(points, np.float64))
        return self._function.at(index, derivative, fill, progress)

    def _on(self, target: Target, progress: Progress | None, out: Any) -> NDArray[Any]:
        kind = target.kind or self._function.kind
        if out is None:
            require(math.prod(target.shape) * kind.itemsize, described(target.shape))
        elif np.dtype(out.dtype).kind != "f":
            raise OptionError(f"out must be of floating type; got {out.dtype}: results are rounded with dtype=, and no out")
        elif tuple(getattr(out, "shape", ())) != target.shape:
            raise OptionError(f"out must have the shape of the results, {target.shape}; got {getattr(out, 'shape', None)}")
        data = np.empty(target.shape, kind) if out is None else out
        for place, values, done in self._parts(target):
            data[place] = values if target.kind is None else in_kind(values, target.kind)
            if progress:
                progress(done)
        return data if isinstance(data, np.ndarray) else np.broadcast_to(np.zeros((), kind), target.shape)

    def _parts(self, target: Target) -> Iterator[Part]:
        """The parts of a grid, each with its values and the fraction that is done with it."""
        function, steps = self._function, steps_along(target.matrix)
        if target.anti_aliasing and (found := function.sums_for(target, settled=self._asked.settled)) is not None:
            yield from function.by_sums(target, *found)
        elif target.anti_aliasing == "gaussian" and (steps > 1).any():
            # smoothing that is chosen for a volume is chosen for the low-passed one, as for a volume in memory
            with BrickedField(function.low_passed(steps), self._asked, self.boundary, self.device, beside=self) as smooth:
                yield from smooth._parts(replace(target, anti_aliasing=None))
        else:
            yield from function.parts(target)


class BrickedLabels(BrickedField):
    """The labels of a volume that is read brick by brick, whose regions pictures show with smooth boundaries."""

    names: ClassVar[bool] = True


def _needs(volume: LazyVolume, row: Filter, rule: Boundary) -> Needs:
    """What bricks of a volume need of memory."""
    support = -(-(row.support + 1) // 2 // row.scale)  # half of the taps lie to either side
    coarse = row.magnified_by.support if row.magnified_by else 0
    lines = stored_lines(volume)
    return Needs(
        volume.size,
        volume.dtype.itemsize,
        reach(row) + support + coarse + NEIGHBOURS,
        rule.fold is None and rule.repeats,
        partial(bytes_of, filter=row, boundary=rule, kind=np.float32),
        lines,
        0 if lines is None else stored_in_one(volume.data),
        volume.data.taken if isinstance(volume.data, Reduced) else None,
    )


def _edge(needs: Needs, edge: int | None, budget: int, device: Device, volume: LazyVolume, *, at_once: bool) -> int:
    """The edge of bricks that was asked for, or the longest of which several fit into the budget."""
    if edge is not None:
        edge = whole("edge", edge, 8)
        if needs.read(edge) > budget:
            raise too_small(needs, edge, budget)
        return edge
    in_memory = at_once and isinstance(volume.data, np.ndarray) and not isinstance(volume.data, np.memmap)
    longest = edge_for(needs, budget, device.largest, volume.chunks, in_memory=in_memory)
    if longest is not None and volume.damaged and volume.where is None and volume.chunks is not None:
        # a brick that needs a damaged chunk is an error as a whole
        longest = min(longest, max(_SHORT, min(volume.chunks) // 2))
    if longest is None:
        device.buffers.require_room(needs.buffer(LEAST))
        raise too_small(needs, LEAST, budget)
    return longest


def as_lazy(volume: LazyVolume | Volume | ArrayLike) -> LazyVolume:
    """A LazyVolume as it is; a volume or an array in memory as one."""
    if isinstance(volume, LazyVolume):
        return volume
    if isinstance(volume, Volume):
        if volume.ndim != 3:
            raise DataError(f"bricks are of a volume with 3 axes; got shape {volume.shape}{if_image(volume.shape)}")
        volume.require_finite()
        made = LazyVolume(volume.data, limits=volume.value_range)
        made.grid = replace(volume, data=made.grid.data)  # all that the volume says, but for its samples
        return made
    return LazyVolume(volume)  # type: ignore[arg-type]  # which says what it takes


def of_lazy(
    volume: LazyVolume,
    filter: str | Filter | None,
    boundary: str | Boundary,
    device: Device | str | int | None,
    precision: Precision | None,
    nan: str | Missing | None,
) -> BrickedField:
    """The field that takes the place of `Field` for a LazyVolume, with the filter that a volume in memory has by default."""
    require_plain(precision, nan)
    memory_for(volume, None)  # which refuses chunks that are too large before anything is read
    return BrickedField(volume, filter_for(volume.part(), filter, DEFAULT_FILTER), boundary, device)


def require_plain(precision: Precision | None, nan: str | Missing | None) -> None:
    """Raise `OptionError` for another precision than "single", or another treatment of missing samples than "error"."""
    for name, value, known in (("precision", precision, "single"), ("nan", nan, "error")):
        if value is not None and getattr(value, "rule", value) != known:
            given = f" {value!r}" if isinstance(value, str) else ""
            raise OptionError(
                f"a volume that is read by bricks takes no {name}{given}: volume.whole() has all samples in memory, "
                "and arrays of dask are taken by parts with it"
            )
