"""The function on another grid: the host side of resample.cl and largest.cl, which work by axes if the grid has the volume's."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.progress import part_of
from clvol.device.program import LANES
from clvol.spline.build import scalar_defines
from clvol.spline.coefficients import Coefficients, axis_taps
from clvol.spline.evaluator import DIRECT
from clvol.spline.grids import no_shear
from clvol.spline.points import NOTHING_GIVEN, Given, Transform, sample_grid

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.device import Device
    from clvol.filter.filter import Filter
    from clvol.spline.build import DefineDict
    from clvol.spline.evaluator import Evaluator

__all__ = ["Largest", "along_axes", "filled", "resample_axes", "resample_coefficients"]

_BLOCK = 16  # rows that resample.cl computes at once
_ITEMS_A_CORE = 16  # work-items for each core, to balance the load
_LONG = 1 << 16  # points along an axis, and coefficients of a row that they read: more are computed in parts
_PART = 1 << 24  # approximate points of such a part
_FEW = 1 << 10  # points along the axes of a grid whose tables are kept
_KEPT = 1 << 20  # bytes of memory for work-items that are kept with them
_SCRATCH = 64 << 20  # bytes for all work-items, unless these would be fewer than cores


@dataclass(frozen=True)
class _Steps:
    """Evenly spaced positions, computed on demand: an axis may have more points than fit in memory."""

    first: float
    step: float
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice, /) -> NDArray[np.float64]:
        return np.asarray(self.first + self.step * np.arange(*part.indices(self.count)))


Positions: TypeAlias = NDArray[np.float64] | _Steps
"""Positions along an axis, in samples."""


def resample_coefficients(
    coefficients: Coefficients,
    evaluator: Evaluator,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    given: Given = NOTHING_GIVEN,
    progress: Progress | None = None,
) -> None:
    """Write values in stored units at index positions ``matrix @ (i, j, k) + offset`` to a buffer, [z, y, x].

    `shape` is the grid's along z, y and x; the buffer holds numbers of the coefficients' type.
    """
    if along_axes(coefficients, evaluator) and no_shear(matrix, shape):
        positions = [_Steps(float(o), float(s), n) for o, s, n in zip(offset, np.diag(matrix), shape[::-1], strict=False)]
        resample_axes(coefficients, positions, buffer, given, progress)
    else:
        sample_grid(coefficients, evaluator, Transform(matrix, offset, np.eye(len(offset))), shape, buffer, given, progress)


def along_axes(coefficients: Coefficients, evaluator: Evaluator) -> bool:
    """Whether `resample_axes` applies: on CPUs, with direct taps."""
    return coefficients.device.kind == "cpu" and evaluator == DIRECT


def resample_axes(
    coefficients: Coefficients,
    positions: Sequence[Positions],
    buffer: Any,
    given: Given = NOTHING_GIVEN,
    progress: Progress | None = None,
) -> None:
    """Write values in stored units on a grid whose axes are the volume's, one axis after the other, on a CPU.

    `positions` are the grid's along x, y and z, in samples, anywhere. Each has an index and a weight for every tap, and
    work-items keep rows of coefficients. So grids with long axes, and grids that skip most of a long row, are computed in parts,
    each in its own memory, and copied.
    """
    device, kind = coefficients.device, coefficients.kind
    counts = [len(along) for along in positions]
    parts = _parts(coefficients, positions, given)
    if len(parts) == 1:
        _resample_part(coefficients, [along[:] for along in positions], buffer, given, progress)
        return
    slices = coefficients.shape[0] if len(counts) < 3 else counts[2]
    shape = (slices, *(*counts, 1)[1::-1])
    with device.buffers.mapped(buffer, shape, write=True, kind=kind) as values:
        for number, part in enumerate(parts):
            place = (..., part[1], part[0]) if len(part) == 2 else (..., part[0]) if len(part) == 1 else part[::-1]
            made = np.empty(values[place].shape, kind)
            report = part_of(progress, number / len(parts), (number + 1) / len(parts))
            with device.buffers.lent(made, write=True) as room:
                _resample_part(coefficients, [along[p] for along, p in zip(positions, part, strict=True)], room, given, report)
            values[place] = made


def _parts(coefficients: Coefficients, positions: Sequence[Positions], given: Given) -> list[tuple[slice, ...]]:
    """The parts of a grid along x, y and z; just one if its axes are short."""
    counts = [len(along) for along in positions]
    rows = list(_short_rows(coefficients, positions[0], given, slice(0, counts[0])))
    if len(rows) == 1 and max(counts[1:], default=1) <= _LONG:
        return [tuple(slice(0, n) for n in counts)]
    longest, others = max(part.stop - part.start for part in rows), []
    left = max(1, _PART // longest)
    for n in counts[1:]:
        step = min(n, _LONG, max(_BLOCK, left))
        others.append([slice(first, min(first + step, n)) for first in range(0, n, step)])
        left = max(1, left // step)
    return list(itertools.product(rows, *others))


def _short_rows(coefficients: Coefficients, along: Positions, given: Given, part: slice) -> Iterator[slice]:
    """Divide a part of a row into short parts that read short rows of coefficients."""
    count = part.stop - part.start
    if count <= _LONG:
        if count == 1 or coefficients.shape[2] <= _LONG:
            yield part
            return
        places, _ = axis_taps(coefficients, 0, along[part], _edge(coefficients, given))
        if places.max() - places.min() < _LONG:
            yield part
            return
    middle = part.start + (count // 2 if count <= _LONG else (count // 2 + _LONG - 1) // _LONG * _LONG)
    yield from _short_rows(coefficients, along, given, slice(part.start, middle))
    yield from _short_rows(coefficients, along, given, slice(middle, part.stop))


def _edge(coefficients: Coefficients, given: Given) -> float:
    return coefficients.boundary.edge if given.edge is None else given.edge


def _resample_part(
    coefficients: Coefficients, positions: Sequence[NDArray[np.float64]], buffer: Any, given: Given, progress: Progress | None
) -> None:
    """`resample_axes` of a grid with short axes."""
    edge = _edge(coefficients, given)
    _by_rows(coefficients, positions, edge, _Kernel("spline/resample.cl", "resample_axes", {}), (buffer,), progress)
    ny, nx = (*(len(along) for along in positions), 1)[1::-1]
    nz = len(positions[2]) if coefficients.ndim == 3 else coefficients.shape[0]
    _put_values(coefficients, positions, (nz, ny, nx), buffer, given, edge)


class Largest:
    """Which of several functions is largest at the points of a grid; only the largest value and its number are kept.

    Parameters
    ----------
    shape
        Of the grid, [z, y, x].
    count
        The number of functions.
    kind
        The type of values.
    nearest
        For each point the function that wins where several are largest, if it is one of them; else the first does.
    """

    def __init__(
        self, shape: tuple[int, ...], count: int, kind: type[np.generic], device: Device, nearest: NDArray[Any] | None = None
    ) -> None:
        self._shape, self._device, self._kind = shape, device, kind
        dtype = np.dtype(np.uint8 if count <= 256 else np.uint16)
        whole = (*shape[:2], -(-shape[2] // LANES) * LANES)
        size = dtype.itemsize * (1 if nearest is None else 2) + np.dtype(kind).itemsize
        memory.require(size * math.prod(whole), f"the largest of {count} functions at {' × '.join(map(str, shape))} points")
        self._numbers, self._values = np.zeros(whole, dtype), np.full(whole, -np.inf, kind)
        self._least = np.full(shape[0] * -(-shape[1] // _BLOCK), -np.inf, kind)
        self._nearest = self._numbers
        if nearest is not None:
            self._nearest = np.zeros(whole, dtype)
            self._nearest[..., : shape[2]] = nearest
        self._by_nearest = nearest is not None

    @property
    def numbers(self) -> NDArray[Any]:
        """The number of the largest function at each point."""
        return self._numbers[..., : self._shape[2]]

    def compare(
        self,
        coefficients: Coefficients,
        positions: Sequence[NDArray[np.float64]],
        number: int,
        limits: NDArray[Any],
        progress: Progress | None = None,
    ) -> None:
        """Compare a function, at positions along x, y and z as of `resample_axes`, with the largest so far.

        Its values are at most its largest coefficient: the weights of its filter are positive. They are clipped to `limits`, of
        shape (slices of the grid, 2).
        """
        device, kind = self._device, coefficients.kind
        with device.buffers.mapped(coefficients.buffer, coefficients.shape, write=False, kind=kind) as held:
            tops = held.max(axis=2)
        defines: DefineDict = {
            "NUMBER": "uchar" if self._numbers.itemsize == 1 else "ushort",
            "BY_NEAREST": int(self._by_nearest),
            "ROUNDING": 32 * (2.0**-52 if kind == np.float64 else 2.0**-23),
        }
        with (
            device.buffers.lent(self._values, write=True, begun=True) as values,
            device.buffers.lent(self._numbers, write=True, begun=True) as numbers,
            device.buffers.lent(self._nearest, write=False) as nearest,
            device.buffers.lent(self._least, write=True, begun=True) as least,
        ):
            arguments = (
                device.buffers.upload(tops),
                np.uint64(tops.shape[1]),
                device.buffers.upload(limits.astype(kind)),
                least,
                np.uint32(number),
                nearest,
                numbers,
                values,
            )
            which = _Kernel("spline/largest.cl", "keep_largest", defines)
            _by_rows(coefficients, positions, coefficients.boundary.edge, which, arguments, progress)


class _Kernel(NamedTuple):
    """A kernel over blocks of rows, and the `#define`s of its own."""

    file: str
    name: str
    defines: DefineDict


class _Rows(NamedTuple):
    """The tables of rows.cl for positions along the axes, and memory for its work-items."""

    grid: NDArray[np.int32]
    blocks: int  # of rows, in a slice
    left: np.int32
    width: np.int32
    tables: list[Any]
    items: int
    scratch: Any
    room: np.uint64

    @classmethod
    def of(cls, coefficients: Coefficients, positions: Sequence[NDArray[np.float64]], edge: float) -> _Rows:
        """For positions along x, y and z."""
        device, taps, d = coefficients.device, coefficients.filter.support, coefficients.ndim
        nx, ny, nz = (*(len(along) for along in positions), 1, 1)[:3]
        nz = nz if d == 3 else coefficients.shape[0]
        whole_vectors = np.pad(positions[0], (0, -nx % LANES), mode="edge")
        axes = [axis_taps(coefficients, axis, x, edge) for axis, x in enumerate([whole_vectors, *positions[1:]])]
        if d == 1:  # the only row
            axes.append((np.zeros((1, taps), np.int64), np.eye(1, taps)))
        places, weights = zip(*axes, strict=True)
        # the used part of a row, in whole vectors, which rows consist of
        left = places[0].min() // LANES * LANES
        width = int(places[0].max() // LANES * LANES + LANES - left)
        places[0][...] = LANES * (places[0] - left)
        blocks, used, first_used = np.zeros((-(-ny // _BLOCK), 2), np.int64), [np.zeros(1, np.int64)], 1
        if d == 3:
            for block, rows in enumerate(np.split(places[1], range(_BLOCK, ny, _BLOCK))):
                distinct, among = np.unique(rows, return_inverse=True)
                rows[...] = among.reshape(rows.shape)
                blocks[block] = first_used, len(distinct)
                used.append(distinct)
                first_used += len(distinct)
        tables = [
            device.buffers.upload(np.concatenate([part.ravel() for part in parts]).astype(kind))
            for parts, kind in ((places, np.int32), (weights, coefficients.kind), ([blocks], np.int32), (used, np.int32))
        ]
        units = nz * len(blocks)
        room = width * (2 * LANES + int(blocks[:, 1].max()))
        items = min(
            units, max(device.units, min(_ITEMS_A_CORE * device.units, _SCRATCH // (np.dtype(coefficients.kind).itemsize * room)))
        )
        scratch = device.buffers.allocate(np.dtype(coefficients.kind).itemsize * items * room)
        grid = np.array([nx, ny, nz, places[0].size], np.int32)
        return cls(grid, len(blocks), np.int32(left), np.int32(width), tables, items, scratch, np.uint64(room))


def _by_rows(
    coefficients: Coefficients,
    positions: Sequence[NDArray[np.float64]],
    edge: float,
    which: _Kernel,
    arguments: tuple[Any, ...],
    progress: Progress | None,
) -> None:
    """Launch a kernel over blocks of rows of a grid, as rows.cl says; `arguments` follow those of the grid."""
    device, taps, d = coefficients.device, coefficients.filter.support, coefficients.ndim
    asked = None
    if sum(len(along) for along in positions) <= _FEW:
        asked = "rows", edge, *(along.tobytes() for along in positions)
    make = partial(_Rows.of, coefficients, positions, edge)
    rows = coefficients.plans.take(asked, make) if asked else make()
    nx, _, nz, _ = rows.grid.tolist()
    units, pitch, area = nz * rows.blocks, int(coefficients.extent[0]), int(coefficients.extent[0]) * int(coefficients.extent[1])
    defines = {"TAPS": taps, "DIMENSIONS": max(2, d), "BLOCK": _BLOCK, "LANES": LANES, "COORD_DOUBLE": 0}
    kernel = device.build(which.file, {**defines, **scalar_defines(coefficients.kind), **which.defines}).kernel(which.name)
    some = max(1, LANES * device.limits.launch_taps // (_BLOCK * nx * (taps + 2) * d))  # writing a value takes as long as two taps
    for first in range(0, units, some):
        count = min(some, units - first)
        with device.errors:
            kernel(
                device.queue,
                (min(rows.items, count),),
                (1,),
                coefficients.argument(DIRECT),
                rows.left,
                np.uint64(pitch),
                np.uint64(area),
                rows.width,
                *rows.tables,
                rows.grid,
                np.int32(first),
                np.int32(count),
                rows.scratch,
                rows.room,
                *arguments,
            )
        device.finish()
        if progress:
            progress((first + count) / units)
    if asked and rows.scratch.size <= _KEPT:
        coefficients.plans.give(asked, rows)
    else:
        rows.scratch.release()


def _put_values(
    coefficients: Coefficients,
    positions: Sequence[NDArray[np.float64]],
    shape: tuple[int, int, int],
    buffer: Any,
    given: Given,
    edge: float,
) -> None:
    """Write the values outside the domain."""
    fill, cval = given.values(coefficients, 0)
    filled, valued = given.fill is not None and not given.missing, coefficients.boundary.outside == "constant"
    writes: list[tuple[int, NDArray[np.bool_], float]] = []  # axis, mask along it, value; the last write wins
    lost = []
    for axis, (x, n) in enumerate(zip(positions, coefficients.size.tolist(), strict=False)):
        finite = np.isfinite(x)
        if (valued or filled) and (outside := finite & ~((x >= -edge) & (x <= n - 1 + edge))).any():
            writes.append((axis, outside, fill if filled else cval))
        if not finite.all():
            lost.append((axis, ~finite, fill if given.missing else math.nan))
    if not writes and not lost:
        return
    with coefficients.device.buffers.mapped(buffer, shape, write=True, kind=coefficients.kind) as values:
        for axis, where, value in writes + lost:
            np.moveaxis(values, 2 - axis, 0)[where] = value


def filled(made: Coefficients, data: NDArray[Any]) -> Coefficients:
    """Fill allocated coefficients from samples [z, y, x]; on an error they are released."""
    try:
        if made.filter.magnified_by is not None:
            _fill_hybrid(made, made.filter.magnified_by, data)
        else:
            made.fill(data)
    except BaseException:
        made.release()
        raise
    return made


def _fill_hybrid(made: Coefficients, by: Filter, data: NDArray[Any]) -> None:
    """Fill the coefficients of a hybrid, halo included, with samples of the spline of `by`."""
    scale, halo, d = made.filter.scale, int(made.extent[3]), made.ndim
    steps = np.eye(d) / scale
    with filled(Coefficients(made.volume, by, made.boundary, made.device, made.stored, made.kind), data) as coarse:
        resample_coefficients(coarse, DIRECT, steps, np.full(d, -halo / scale), made.shape, made.buffer, Given(edge=0.5))
