"""The engine of `clvol.ndimage`: coefficients of real arrays, and their spline on grids and at points, as SciPy defines them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.device import Device, as_device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.ndimage.arguments import BOUNDARIES, Array, Spline
from clvol.spline import grids
from clvol.spline.build import DefineDict, scalar_defines
from clvol.spline.coefficients import OPENCL_TYPES, Coefficients, addressable, bundled, bytes_of
from clvol.spline.evaluator import DIRECT
from clvol.spline.field import precision_kind
from clvol.spline.points import Given, Transform, sample_grid, sample_into
from clvol.spline.prefilter import gain_along, prefilter_in_place
from clvol.spline.regions import Regions
from clvol.spline.resample import resample_axes
from clvol.volume.stored import is_far
from clvol.volume.volume import Volume

__all__ = [
    "FILTERED_AS",
    "Affine",
    "Axes",
    "Points",
    "Target",
    "coefficients",
    "converted",
    "evaluate",
    "kind_for",
    "lies_far",
    "row_of",
]

_PART = 1 << 25  # bytes of results converted at a time
_KEPT = 1 << 24  # bytes of coefficients whose storage is kept for the next array of their shape
_PADS = 12  # samples that a boundary rule pads an axis with, at most
_PROBES = 8  # samples along each axis that are inspected
_LEAST, _MOST = 2.0**-90, 2.0**90  # magnitudes that float32 holds through the prefilter and derivatives


@dataclass(frozen=True, eq=False)
class Axes:
    """A grid along the array's axes: for each resampled axis the positions in samples of the input, which may lie anywhere."""

    positions: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True, eq=False)
class Affine:
    """A grid that lies in any way: index ``i`` of the result is at ``matrix @ i + offset`` of the input, in the order of the axes.

    Products are added to the offset from the first axis to the last, each rounded, as SciPy does.
    """

    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Points:
    """Points anywhere, of shape (k, ...): positions in samples of the input, of any real dtype and layout, as SciPy's."""

    coordinates: Array


Target: TypeAlias = Axes | Affine | Points


def evaluate(data: Array, axes: Sequence[int], target: Target, output: Array, spline: Spline) -> None:
    """Evaluate the spline of an array at a target, into `output`.

    `data` holds real numbers and is not empty. 1 to 3 `axes` are resampled, ascending; all others are batch axes, each index of
    which is computed separately. `output` has the batch axes and those of a grid where they are in `data`; for points, the batch
    axes and then those of the points. Integers are rounded, halves away from zero, and clipped to their type, as in SciPy. Of
    `cval` the real part counts; `nan` is ignored.
    """
    chosen, cval, progress = as_device(spline.device), float(spline.cval.real), spline.progress
    axes = tuple(axes)
    kept = tuple(axis for axis in range(data.ndim) if axis not in axes)
    onto = output if isinstance(target, Points) else output.transpose(kept + axes)
    if isinstance(target, Affine) and len(axes) == 1:
        target = Axes((np.arange(target.shape[0]) * target.matrix[0, 0] + target.offset[0],))
    if isinstance(target, Axes) and len(axes) > 1:  # rows of coefficients along the axis that is closest in memory
        closest = sorted(range(len(axes)), key=lambda i: -abs(data.strides[axes[i]]))
        axes = tuple(axes[i] for i in closest)
        target = Axes(tuple(target.positions[i] for i in closest))
        onto = onto.transpose((*range(len(kept)), *(len(kept) + i for i in closest)))
    moved, batch = data.transpose(kept + axes), len(kept)
    if spline.labels:
        for index in np.ndindex(moved.shape[:batch]):
            onto[index] = _labels_at(moved[index], target, spline)
        return
    outer = batch  # axes whose indices are computed one after the other
    if batch and len(axes) < 3 and not isinstance(target, Points):  # of one axis all are done at once: the longest
        moved, onto = _merged(moved, onto, batch)
        batch = moved.ndim - len(axes)
        longest, outer = max(range(batch), key=lambda i: moved.shape[i]), batch - 1
        moved, onto = np.moveaxis(moved, longest, outer), np.moveaxis(onto, longest, outer)
    size = moved.shape[batch:][::-1]
    kind, boundary = kind_for(spline.precision, data, output, chosen), spline.boundary_with_cval
    given, store, row = Given(cval, missing=True, edge=0.0), _Store(chosen, kind), row_of(spline.order, spline.prefilter)
    length = moved.shape[outer] if outer < batch else 1
    room = max(math.prod(n + 2 * (row.support + _PADS) for n in size), math.prod(onto.shape[batch:])) * np.dtype(kind).itemsize
    some = max(1, min(length, _PART // room))
    tasks = [
        (index, slice(first, min(first + some, length)))
        for index in np.ndindex(moved.shape[:outer])
        for first in range(0, length, some)
    ]
    for count, some_tasks in itertools.groupby(enumerate(tasks), lambda task: task[1][1].stop - task[1][1].start):
        with _storage(size, row, boundary, chosen, kind, count) as made:
            for number, (index, part) in some_tasks:
                at = index if outer == batch else (*index, part)
                made.fill(moved[at])
                for done in _evaluated(made, target, onto[at], store, given):
                    if progress:
                        progress((number + done) / len(tasks))


@contextmanager
def _storage(
    size: tuple[int, ...], row: Filter, boundary: Boundary, device: Device, kind: type[np.generic], batch: int = 1
) -> Iterator[Coefficients]:
    """Storage for coefficients, with any numbers in it; if it is small it serves the next call of its kind too.

    To allocate it anew, and the tables of the grids that it was evaluated on, takes longer than 74³ samples do.
    """
    make = partial(Coefficients, size, row, boundary, device, kind=kind, batch=batch)
    kept = bytes_of(size, row, boundary, kind) * batch <= _KEPT
    asked = size, row, boundary, kind, batch
    made = device.plans.take(asked, make) if kept else make()
    try:
        yield made
    except BaseException:
        made.release()
        raise
    if kept:
        device.plans.give(asked, made, made.nbytes)
    else:
        made.release()


def _labels_at(data: Array, target: Target, spline: Spline) -> Array:
    """The labels of one volume at a target; a line is an image of one row."""
    line = data.ndim == 1
    volume = Volume(data[np.newaxis] if line else data)
    with Regions(volume, row_of(5, False), spline.boundary_with_cval, as_device(spline.device)) as regions:
        if isinstance(target, Axes):
            rows = (np.zeros(1),) if line else ()
            labels = regions.along_axes((*target.positions[::-1], *rows), spline.progress)
            return labels[0] if line else labels
        if isinstance(target, Affine):
            place = grids.Target(target.matrix[::-1, ::-1], target.offset[::-1], target.shape)
            return regions.on(place, spline.progress)
        planes = target.coordinates.reshape(data.ndim, -1)
        labels = regions.at(np.concatenate([np.zeros_like(planes), planes]) if line else planes, spline.progress)
        labels[~np.isfinite(planes).all(0)] = spline.cval.real
        return labels.reshape(target.coordinates.shape[1:])


def _merged(moved: Array, onto: Array, count: int) -> tuple[Array, Array]:
    """Two arrays, with those of their first `count` axes merged that are contiguous in both."""
    for axis in range(count - 1, 0, -1):
        if all(
            1 in one.shape[axis - 1 : axis + 1] or one.strides[axis - 1] == one.shape[axis] * one.strides[axis]
            for one in (moved, onto)
        ):
            moved, onto = (one.reshape(*one.shape[: axis - 1], -1, *one.shape[axis + 1 :]) for one in (moved, onto))
    return moved, onto


def _evaluated(made: Coefficients, target: Target, output: Array, store: _Store, given: Given) -> Iterator[float]:
    """Write one volume's values at a target, part by part; the fraction done after each."""
    if isinstance(target, Points):
        planes = target.coordinates.reshape(made.ndim, -1)
        if planes.dtype not in (np.float32, np.float64) or not planes.dtype.isnative:
            planes = planes.astype(np.float64)
        count = planes.shape[1]
        plain = output.flags.c_contiguous  # else results are not in the order of the points, and all are computed at once
        for part in store.parts(output.reshape(-1)) if plain else [slice(0, count)]:
            with store.into(output.reshape(-1)[part] if plain else output) as results:
                sample_into(made, DIRECT, planes[:, part], results.reshape(-1), given=given)
            yield part.stop / max(1, count)
        return
    batch = output.ndim > made.ndim
    for part in [slice(0, len(output))] if batch else store.parts(output):
        with store.into(output[part]) as results, made.device.buffers.lent(results, write=True) as buffer:
            if isinstance(target, Axes):
                first = target.positions[0] if batch else target.positions[0][part]
                resample_axes(made, (first, *target.positions[1:])[::-1], buffer, given)
            else:
                transform = Transform(target.matrix[::-1, ::-1], target.offset[::-1], np.eye(made.ndim))
                rows = None if batch or (len(target.shape) == 3 and target.shape[0] == 1) else part  # of the first that has several
                shape = (made.shape[0], *target.shape) if batch else (1, *target.shape)[-3:]
                sample_grid(made, DIRECT, transform, shape, buffer, given, part=rows)
        yield part.stop / max(1, len(output))


def kind_for(precision: str, data: Array, output: Array, device: Device) -> type[np.generic]:
    """The type of coefficients.

    float64 also where float32 would lose digits of the samples (a few are inspected): if they lie far from zero compared with their
    range, or are very large or small; and for results of bool, which are cut off.
    """
    if precision == "single" and device.has_double and (output.dtype.kind == "b" or _beyond_float32(data)):
        return np.float64
    return precision_kind(precision)


def lies_far(data: Array) -> bool:
    """Whether samples, of which a few are inspected, lie far from zero compared with their range."""
    return is_far(*_ends(data))


def _ends(data: Array) -> tuple[float, float]:
    some = data[tuple(slice(None, None, max(1, n // _PROBES)) for n in data.shape)]
    return float(some.min()), float(some.max())


def _beyond_float32(data: Array) -> bool:
    low, high = _ends(data)
    most = max(-low, high)
    if not math.isfinite(most) or most == 0 or data.dtype.kind == "b":
        return False
    return is_far(low, high) or not _LEAST < most < _MOST


@lru_cache
def row_of(order: int, prefilter: bool) -> Filter:
    """The filter of an order of SciPy's."""
    return as_filter({0: "nearest", 1: "linear"}.get(order, f"bspline{order}" if prefilter else f"bspline{order}-approx"))


def coefficients(data: Array, axes: Sequence[int], output: Array, spline: Spline) -> None:
    """Write the spline coefficients of an array along some of its axes, up to three, into `output` (which may be `data`).

    Parameters are those of `evaluate`; `output` has the shape of `data` and any real dtype. An axis of one sample stays as it is.
    """
    chosen, row, mode = as_device(spline.device), row_of(spline.order, True), spline.mode
    kind = kind_for(spline.precision, data, output, chosen)
    boundary = as_boundary(FILTERED_AS.get(mode, BOUNDARIES[mode])).ends
    filtered = [axis for axis in axes if data.shape[axis] > 1]
    others = sorted((axis for axis in range(data.ndim) if axis not in filtered), key=lambda axis: -data.shape[axis])
    held = sorted(filtered + others[: 3 - len(filtered)], key=lambda axis: -abs(data.strides[axis]))
    kept = tuple(axis for axis in range(data.ndim) if axis not in held)
    moved, onto = data.transpose((*kept, *held)), output.transpose((*kept, *held))
    size = moved.shape[len(kept) :][::-1]
    along = sorted(len(held) - 1 - held.index(axis) for axis in filtered)
    gain = gain_along(row, boundary, size, along, kind) if row.prefilter and along else 1.0
    store, batch = _Store(chosen, kind), moved.shape[: len(kept)]
    with _storage(size, row, boundary, chosen, kind) as made:
        extent = made.extent.tolist()
        for number, index in enumerate(np.ndindex(batch), 1):
            made.copy_samples(moved[index], gain)
            if row.prefilter and along:
                prefilter_in_place(chosen, made.buffer, row, boundary, extent, made.size[:3].tolist(), made.ndim, kind, along)
            store.inner(made, onto[index])
            if spline.progress:
                spline.progress(number / math.prod(batch))


FILTERED_AS = {"nearest": "reflect", "constant": "mirror", "grid-constant": "mirror", "wrap": "mirror"}
"""The rules by which SciPy's prefilter ends where its mode has none; interpolation pads the samples instead."""


class _Store:
    """Writes results of kernels, of `kind`, into arrays of any dtype and layout, integers rounded as SciPy rounds them."""

    def __init__(self, device: Device, kind: type[np.generic]) -> None:
        self._device, self._kind = device, kind
        self._scratch = np.empty(0, kind)

    def parts(self, output: Array) -> list[slice]:
        """The parts of an array, along its first axis, computed at a time: the largest possible where nothing is converted."""
        length, row = len(output), np.dtype(self._kind).itemsize * math.prod(output.shape[1:])
        if not output.size:
            return []
        step = max(1, (self._device.largest if self._direct(output) else _PART) // row)
        return [slice(first, min(first + step, length)) for first in range(0, length, step)]

    @contextmanager
    def into(self, output: Array) -> Iterator[Array]:
        """A contiguous array for results, which are written into `output` at the end of the ``with`` block."""
        if self._direct(output):
            yield output
            return
        if self._scratch.size < output.size:
            memory.require(
                np.dtype(self._kind).itemsize * output.size, f"results of shape {output.shape} before they are converted"
            )
            self._scratch = np.empty(output.size, self._kind)
        results = self._scratch[: output.size].reshape(output.shape)
        yield results
        if output.ndim > 3 or not self._by_kernel(output):
            output[...] = converted(results, output.dtype)
            return
        with self._device.buffers.lent(results, write=False) as buffer:
            sizes = (1, 1, *output.shape)[-3:]
            self._convert(buffer, 0, sizes[2], sizes[1] * sizes[2], output)

    def inner(self, made: Coefficients, output: Array) -> None:
        """Coefficients proper into an array of their shape."""
        if self._by_kernel(output):
            self._convert(made.buffer, *made.layout, output)
            return
        with self._device.buffers.mapped(made.buffer, made.shape, write=False, kind=self._kind) as held:
            output[...] = converted(held[made.inner].reshape(output.shape), output.dtype)

    def _direct(self, output: Array) -> bool:
        return output.dtype == self._kind and output.dtype.isnative and output.flags.c_contiguous and output.flags.aligned

    def _by_kernel(self, output: Array) -> bool:
        return self._device.shares_memory and addressable(output, self._device)

    def _convert(self, buffer: Any, origin: int, pitch: int, area: int, output: Array) -> None:
        device, kind = self._device, output.dtype
        output, bundle, (pitch, area) = bundled(output[(None,) * (3 - output.ndim)], (pitch, area))
        name = OPENCL_TYPES[kind.str[1:]]
        low, high = (0.0, 0.0) if kind.kind == "f" else _limits(kind, self._kind)
        defines: DefineDict = {"RESULT": name, "WHOLE": {"f": 0, "b": 2}.get(kind.kind, 1), "COORD_DOUBLE": int(name == "double")}
        kernel = device.build("spline/store.cl", {**defines, **scalar_defines(self._kind)}).kernel("store_results")
        nz, ny, nx = output.shape
        with device.buffers.lent_span(output, write=True) as (array, first, strides), device.errors:
            kernel(
                device.queue,
                (ny, -(-nz // bundle)),
                (1, 1),
                buffer,
                *map(np.uint64, (origin, pitch, area)),
                np.int32(nx),
                np.int32(nz),
                np.int32(bundle),
                array,
                first,
                strides,
                self._kind(low),
                self._kind(high),
            )


def _limits(kind: np.dtype[Any], held: type[np.generic]) -> tuple[float, float]:
    """The smallest and the largest number of an integer dtype that float32 or float64 holds."""
    if kind.kind == "b":
        return 0.0, 1.0
    low, high = int(np.iinfo(kind).min), int(np.iinfo(kind).max)
    below = held(high)
    return float(low), float(below if int(below) <= high else np.nextafter(below, held(0)))


def converted(values: Array, kind: np.dtype[Any]) -> Array:
    """Values of kernels in a dtype; integers are rounded, halves away from zero, and clipped, as in SciPy; bool is whether a
    magnitude is at least 1.
    """
    if kind.kind not in "biu":
        with np.errstate(over="ignore"):
            return values.astype(kind)
    wide = np.abs(values.astype(np.float64)) if kind.kind == "b" else values + np.copysign(0.5, values)
    low, high = _limits(kind, values.dtype.type)
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(wide), low, np.clip(np.trunc(wide), low, high)).astype(kind)
