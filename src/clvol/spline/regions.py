"""Labels with smooth boundaries on other grids: the host side of regions.cl.

The indicator of a label is 1 at its samples and 0 at others. An unprefiltered B-spline makes of each a smooth function; all are
nowhere negative and sum to one, and a point belongs to the label whose function is largest there. No indicator is stored: kernels
read labels, of which a neighbourhood holds few.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import DataError, OptionError
from clvol.base.rounding import in_kind
from clvol.base.rounding import limits as limits_of_type
from clvol.device.program import LANES
from clvol.filter.boundary import REGION_BOUNDARY, Boundary, as_boundary, is_given
from clvol.filter.table import REGION_FILTER, as_filter
from clvol.spline.build import boundary_defines, filter_defines, point_defines, row_reach, spared_taps
from clvol.spline.coefficients import OPENCL_TYPES, axis_taps, extent_of
from clvol.spline.grids import described, no_shear
from clvol.spline.lease import release
from clvol.spline.points import Given, Transform
from clvol.volume.stored import too_large_names
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.device import Device
    from clvol.device.program import Program
    from clvol.filter.filter import Filter
    from clvol.spline.build import DefineDict
    from clvol.spline.chain import Chain
    from clvol.spline.grids import Target

__all__ = [
    "Regions",
    "as_label",
    "labels_on",
    "region_boundary",
    "region_filter",
    "require_few_digits",
    "require_labels",
    "require_no_blending",
    "require_whole",
]

_RUN = 512  # points for each work-item of a CPU
_ITEMS_A_CORE = 16  # work-items for each core, to balance the load
_EVALUATIONS = 8  # of weights for a place in a cell, about
_MOST = np.iinfo(np.int32).max  # stands for no label in kernels
_PART = 1 << 22  # samples checked or converted at a time
_ABOVE = 1e-6  # by which the weight of samples that decide alone exceeds a half; that of kernels errs by less


def region_filter(choice: str | Filter | None) -> Filter:
    """The filter of smooth boundaries, by default of quintic B-splines.

    Raises
    ------
    OptionError
        It has a prefilter, weights below zero or not of sum one, or one tap.
    """
    row = as_filter(REGION_FILTER if choice is None else choice)
    fine = np.linspace(0, 1, 1025)
    if row.prefilter or row.magnified_by or row.support < 2 or not row.sums_to_one or row.weights(fine).min() < -_ABOVE:
        raise OptionError(
            "smooth boundaries of labels take a filter whose weights are nowhere negative and sum to one, without a prefilter: "
            f"linear, or bspline2-approx to bspline5-approx; got {row.name!r}"
        )
    return row


def region_boundary(choice: str | Boundary | None) -> Boundary:
    """The rule outside labels with smooth boundaries: what was given, else "nearest"."""
    return as_boundary(choice if choice is not None and is_given(choice) else REGION_BOUNDARY)


def require_no_blending(**options: object) -> None:
    """Refuse options of values, which labels have not."""
    for name, value in options.items():
        if value is not None:
            raise OptionError(f"{name} is for values: leave it out, as labels have none; got {value!r}")


def require_whole(data: NDArray[Any]) -> None:
    """Refuse samples that are no whole numbers: `DataError`."""
    for part in _parts(data):
        if not (part == np.rint(part)).all() or not np.isfinite(part).all():
            some = part[~((part == np.rint(part)) & np.isfinite(part))][0]
            raise DataError(
                f"labels must be whole numbers; got {some} among samples of {data.dtype}: "
                "take measured values for what they are, or round them with numpy.rint"
            )


def require_labels(volume: Volume) -> None:
    """Raise `DataError` if samples are no labels that float32 distinguishes."""
    if volume.data.dtype.kind == "f":
        require_whole(volume.data)
    require_few_digits(volume)


def require_few_digits(volume: Volume) -> None:
    """Raise `DataError` if labels are too large for float32 to distinguish."""
    low, high = map(int, volume.limits)
    if max(abs(low), abs(high)) > 1 << 24:
        raise DataError(too_large_names(low, high))


class _Codes(NamedTuple):
    """How labels are stored: in numbers of `kind`, which are the labels, or their places in `labels`."""

    kind: np.dtype[Any]
    labels: NDArray[Any] | None = None

    @classmethod
    def of(cls, volume: Volume, others: Sequence[int]) -> _Codes:
        """Those for a volume of labels, and for other labels of its type."""
        data = volume.data
        if data.dtype.kind == "f":
            require_whole(data)
        elif data.dtype.itemsize <= 2:
            return cls(np.dtype(np.uint8) if data.dtype.kind == "b" else data.dtype.newbyteorder("="))
        low, high = (int(end) for end in volume.limits)
        if min(low, *others) > -_MOST and max(high, *others) < _MOST:
            return cls(np.dtype(np.int32))
        memory.require(2 * data.nbytes, f"a sorted copy of {data.size} labels")
        return cls(np.dtype(np.int32), np.unique(np.append(np.unique(data), np.array(others, data.dtype))))

    def of_labels(self, data: NDArray[Any]) -> NDArray[Any]:
        return data if self.labels is None else np.searchsorted(self.labels, data)

    def of_label(self, label: int) -> int:
        return label if self.labels is None else int(np.searchsorted(self.labels, self.labels.dtype.type(label)))

    def back(self, codes: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
        return codes.astype(kind, copy=False) if self.labels is None else self.labels[codes].astype(kind, copy=False)


class Regions:
    """The labels of a volume on a device, with a halo that the boundary rule fills.

    Parameters
    ----------
    volume : Volume
        Whole numbers of any type.
    filter : Filter
        Of `region_filter`.
    boundary : Boundary
        Its value outside, if it has one, is a label.
    device : Device
    fill : float, optional
        The label outside the volume's domain; None: as the boundary rule says.

    Raises
    ------
    DataError
        A sample is no whole number.
    OptionError
        `fill`, or the value of the boundary rule, is none that the volume's type holds.
    OutOfMemoryError
        The labels do not fit on the device.
    """

    def __init__(self, volume: Volume, filter: Filter, boundary: Boundary, device: Device, fill: float | None = None) -> None:
        self.volume, self.filter, self.boundary, self.device, self.ndim = volume, filter, boundary, device, volume.ndim
        self.dtype = volume.data.dtype.newbyteorder("=")
        outside = as_label("fill", fill or 0, self.dtype), as_label("the value of the boundary", boundary.cval, self.dtype)
        self._codes = _Codes.of(volume, outside)
        self._given, self._filled = [self._codes.of_label(label) for label in outside], fill is not None
        sizes = (*volume.size, 1, 1)[:3]
        self.pad, self.reach = 0, boundary.reach(filter.support)
        self.size = np.array([*sizes, 0], np.int32)
        self._period = np.array([*(boundary.length(n) for n in sizes), 0], np.int32)
        self.extent = np.array(extent_of(filter, self.ndim, sizes, self.reach), np.int32)
        kind = self._codes.kind
        self._buffer: Any = device.buffers.allocate(kind.itemsize * (int(np.prod(self.extent[:3], dtype=np.int64)) + LANES))
        with device.buffers.mapped(self._buffer, tuple(self.extent[2::-1].tolist()), write=True, kind=kind.type) as stored:
            self._fill(stored, volume.data)

    def _fill(self, stored: NDArray[Any], data: NDArray[Any]) -> None:
        halo, stored = int(self.extent[3]), stored if self.ndim == 3 else stored[0]
        inner = [slice(halo, halo + n) for n in data.shape]
        for part, target in zip(data, stored[tuple(inner)], strict=True):
            target[...] = self._codes.of_labels(part)
        constant = self._codes.of_label(0) if self.boundary.period is None else self._given[1]
        for axis, n in enumerate(data.shape):
            lines = np.moveaxis(stored, axis, 0)
            own = (*(slice(None),) * axis, *inner[axis + 1 :])  # of the axes before, the halo too
            for place in (*range(halo), *range(halo + n, len(lines))):
                source = int(self.boundary.index(place - halo, n))
                lines[place][own] = constant if source < 0 else lines[source + halo][own]

    @property
    def _defines(self) -> DefineDict:
        kind = self._codes.kind
        about: DefineDict = {"LABEL": OPENCL_TYPES[kind.str[1:]], "LABEL_BYTES": kind.itemsize, "SPARED": spared_taps(self.filter)}
        return {**filter_defines(self.filter), **about, "DIMENSIONS": self.ndim, "LANES": 1}

    @property
    def grid(self) -> Volume:
        """The volume."""
        return self.volume

    def __call__(
        self, points: NDArray[np.float64], *, fill: float | None = None, progress: Progress | None = None
    ) -> NDArray[np.float64]:
        """The labels at world points (..., d), in float64; `fill` outside the domain, None: as the boundary rule says."""
        index, edge = self.volume.world_to_index(points.reshape(-1, self.ndim)), self.boundary.edge
        found = self.at(index.T[::-1], progress).astype(np.float64)
        if fill is not None:
            found[~((index >= -edge) & (index <= self.size[: self.ndim] - 1 + edge)).all(1)] = fill
        return found.reshape(points.shape[:-1])

    def on(self, target: Target, progress: Progress | None = None) -> NDArray[Any]:
        """The labels on a grid."""
        if self.device.kind == "cpu" and target.chain is None and no_shear(target.matrix, target.shape):
            steps = zip(target.offset, np.diag(target.matrix), target.shape[::-1], strict=True)
            return self.along_axes([start + step * np.arange(n) for start, step, n in steps], progress)
        memory.require(self._codes.kind.itemsize * int(np.prod(target.shape, dtype=np.int64)), described(target.shape))
        result = np.empty(target.shape, self._codes.kind)
        transform = Transform(target.matrix, target.offset, np.eye(self.ndim))
        self._on_grid(transform, result.reshape((1, *result.shape)[-3:]), target.chain, progress)
        return self._codes.back(result, self.dtype)

    def along_axes(self, positions: Sequence[NDArray[np.float64]], progress: Progress | None = None) -> NDArray[Any]:
        """The labels on a grid whose axes are the volume's, at positions along x, y(, z) in samples."""
        device, kind = self.device, self._codes.kind
        shape = tuple(len(along) for along in positions)[::-1]
        memory.require(kind.itemsize * int(np.prod(shape, dtype=np.int64)), described(shape))
        axes = [axis_taps(self, axis, x, self.boundary.edge) for axis, x in enumerate(positions)]
        cores = [_cores(places, weights, 0.5 ** (1 / self.ndim) + _ABOVE) for places, weights in axes]
        more = row_reach(self.filter) - self.filter.support
        tables = [
            device.buffers.upload(np.concatenate(parts).astype(table))
            for parts, table in (
                ([places[:, 0] for places, _ in axes], np.int32),
                (cores, np.int32),
                ([np.pad(weights, ((0, 0), (0, more))) for _, weights in axes], np.float32),
            )
        ]
        result = np.empty(shape, kind)
        width, units = int(cores[0].sum(1).max()), result.size // shape[-1]
        items = min(units, _ITEMS_A_CORE * device.units)
        kernel = device.build("spline/regions.cl", {**self._defines, "ALONG_AXES": 1, "COORD_DOUBLE": 0})
        grid = np.array([shape[-1], shape[-2], units // shape[-2], width], np.int32)
        pitch, area = int(self.extent[0]), int(self.extent[0]) * int(self.extent[1])
        scratch = device.buffers.allocate(kind.itemsize * items * width)
        some = max(1, LANES * device.limits.launch_taps // (shape[-1] * self.filter.support**self.ndim))
        with device.buffers.lent(result, write=True) as buffer:
            for first in range(0, units, some):
                count = min(some, units - first)
                with device.errors:
                    kernel.kernel("regions_along_axes")(
                        device.queue,
                        (min(items, count),),
                        (1,),
                        self._buffer,
                        np.uint64(pitch),
                        np.uint64(area),
                        *tables,
                        grid,
                        np.int32(first),
                        np.int32(count),
                        scratch,
                        buffer,
                    )
                device.finish()
                if progress:
                    progress((first + count) / units)
        scratch.release()
        self._put_outside(result, positions)
        return self._codes.back(result, self.dtype)

    def _put_outside(self, result: NDArray[Any], positions: Sequence[NDArray[np.float64]]) -> None:
        if not self._filled and self.boundary.outside != "constant":
            return
        for axis, (x, n) in enumerate(zip(positions, self.size.tolist(), strict=False)):
            inside = (x >= -self.boundary.edge) & (x <= n - 1 + self.boundary.edge)
            np.moveaxis(result, self.ndim - 1 - axis, 0)[~inside] = self._given[0 if self._filled else 1]

    def at(self, points: NDArray[Any], progress: Progress | None = None) -> NDArray[Any]:
        """The labels at indices (d, N), in the order of the array's axes; outside also where one is not finite."""
        result = np.empty(points.shape[1], self._codes.kind)

        def one(kernel: Any, items: int, lent: Any, own: slice, buffer: Any) -> None:
            where = (lent, np.uint64(own.stop - own.start), np.array(self._given, np.int32), buffer)
            kernel(self.device.queue, (items,), None, self._buffer, self.extent, self.size, self._period, *where)

        self._at_points("regions_at_points", points, result, one, progress)
        return self._codes.back(result, self.dtype)

    def in_cells(
        self, cells: NDArray[np.int32], around: NDArray[Any], numbers: NDArray[Any], spacing: Sequence[float]
    ) -> NDArray[np.float32]:
        """Places in cells of the samples' grid where the labels at their corners weigh the same: offsets (N, 3), in samples.

        Those of more labels than two lie where they weigh most nearly the same.

        Parameters
        ----------
        cells : shape (N, 3)
            First corners (x, y, z), from -1 on: places in cells at the rim lie in the faces of the domain.
        around : shape (N, 8)
            The labels at the corners, along x first, as their places in `numbers`, from 1 on; 0 outside the grid.
        numbers : shape (m,)
            Labels.
        spacing
            Along x, y, z.
        """
        device, edge, count = self.device, self.boundary.edge, len(cells)
        run = _RUN if device.kind == "cpu" else 1
        kernel = device.build("spline/nets.cl", {**self._defines, "COORD_DOUBLE": 0, "RUN": run}).kernel("nets_place")
        known = self._codes.of_labels(numbers.astype(self.dtype))
        corners = np.array([_MOST, *known.tolist()], np.int32)[around]
        result, about = np.empty((count, 3), np.float32), np.array([*spacing, edge], np.float32)
        some = max(run, device.limits.launch_taps // (_EVALUATIONS * self.filter.support**3))
        lent = device.buffers.lent
        with lent(cells, write=False) as first_corners, lent(corners, write=False) as labels, lent(result, write=True) as offsets:
            for first in range(0, count, some):
                last = min(first + some, count)
                where = first_corners, labels, self.size, about, np.uint64(first), np.uint64(last), offsets
                with device.errors:
                    kernel(device.queue, (-(-(last - first) // run),), None, self._buffer, self.extent, *where)
                device.finish()
        return result

    def _at_points(
        self, name: str, points: NDArray[Any], result: NDArray[Any], one: Callable[..., None], progress: Progress | None
    ) -> None:
        """Put results of a kernel at indices (d, N), by as many as a launch takes; `one` launches it."""
        device, count = self.device, points.shape[1]
        kind = np.float64 if device.has_double else np.float32
        run = _RUN if device.kind == "cpu" else 1
        kernel = self._anywhere(run, {**point_defines(kind, planar=True, indices=True), "ON_GRID": 0}).kernel(name)
        some = max(run, device.limits.launch_taps // self.filter.support**self.ndim)
        for first in range(0, count, some):
            own = slice(first, min(first + some, count))
            part, target = np.ascontiguousarray(points[:, own], kind), result[own]
            with device.buffers.lent(part, write=False) as lent, device.buffers.lent(target, write=True) as buffer, device.errors:
                one(kernel, -(-len(target) // run), lent, own, buffer)
                device.finish()
            if progress:
                progress(own.stop / count)

    def _anywhere(self, run: int, more: DefineDict) -> Program:
        """The kernels that look at each point on its own."""
        defines: DefineDict = {
            **self._defines,
            **boundary_defines(self.boundary, self.pad, self.reach),
            **Given(0.0 if self._filled else None).defines(self.boundary),
            "ALONG_AXES": 0,
            "COORD_DOUBLE": int(self.device.has_double),
            "DERIVATIVE": 0,
            "WITH_VALUE": 0,
            "RUN": run,
            **more,
        }
        return self.device.build("spline/regions.cl", defines)

    def _on_grid(self, transform: Transform, result: NDArray[Any], chain: Chain | None, progress: Progress | None) -> None:
        device, (nz, ny, nx) = self.device, result.shape
        run, together = (_RUN, 1) if device.kind == "cpu" else (1, 8)
        more = {**point_defines(np.float32), "ON_GRID": 1, **(chain.defines() if chain else {})}
        kernel = self._anywhere(run, more).kernel("regions_on_grid")
        matrix, points = transform.upload(device), max(1, device.limits.launch_taps // self.filter.support**self.ndim)
        rows, slices = max(1, min(ny, points // nx)), max(1, points // (nx * ny))
        parts = [(z, y) for z in range(0, nz, slices) for y in range(0, ny, rows)]
        items = -(-nx // (run * together)) * together
        with device.buffers.lent(result, write=True) as buffer:
            for done, (z, y) in enumerate(parts, 1):
                with device.errors:
                    kernel(
                        device.queue,
                        (items, min(rows, ny - y), min(slices, nz - z)),
                        (together, 1, 1),
                        self._buffer,
                        self.extent,
                        self.size,
                        self._period,
                        matrix,
                        np.array([nx, ny, y, z], np.int32),
                        np.array(self._given, np.int32),
                        buffer,
                        *(chain.arguments if chain else ()),
                    )
                device.finish()
                if progress:
                    progress(done / len(parts))

    def release(self) -> None:
        """Free the device's memory."""
        buffer, self._buffer = self._buffer, None
        release(self.device, buffer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()


def labels_on(
    target: Target, volume: Volume, filter: Filter, boundary: Boundary, device: Device, progress: Progress | None = None
) -> NDArray[Any]:
    """The labels of a volume on a grid, of the target's type or the volume's."""
    with Regions(volume, filter, boundary, device, target.fill) as regions:
        labels = regions.on(target, progress)
    return labels if target.kind is None else in_kind(labels, target.kind)


def _cores(places: NDArray[np.int64], weights: NDArray[np.float64], least: float) -> NDArray[np.int64]:
    """For each position along an axis the shortest run of taps whose weights sum to `least`: where it begins, and its length."""
    found = np.zeros((len(places), 2), np.int64)
    for count in range(weights.shape[1], 0, -1):
        sums = np.lib.stride_tricks.sliding_window_view(weights, count, axis=1).sum(-1)
        start, enough = sums.argmax(1), sums.max(1) >= least
        found[enough] = np.stack([places[:, 0] + start, np.full(len(places), count)], 1)[enough]
    return found


def as_label(what: str, value: float, kind: np.dtype[Any]) -> int:
    """A label that a type holds; else `OptionError`."""
    low, high = limits_of_type(kind) if kind.kind != "f" else (-(1 << 53), 1 << 53)
    if not float(value).is_integer() or not low <= value <= high:
        raise OptionError(f"{what} must be a label that {kind} holds, a whole number from {low} to {high}; got {value!r}")
    return int(value)


def _parts(data: NDArray[Any]) -> list[NDArray[Any]]:
    step = max(1, _PART * len(data) // data.size)
    return [data[first : first + step] for first in range(0, len(data), step)]
