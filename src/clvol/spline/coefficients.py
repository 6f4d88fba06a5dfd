"""Storage of a volume's coefficients on a device: the host side of coefficients.cl."""

from __future__ import annotations

import math
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DeviceError, OptionError, OutOfMemoryError
from clvol.device.plan import Plans
from clvol.device.program import LANES
from clvol.spline.build import evaluator_defines, filter_defines, row_reach, scalar_defines
from clvol.spline.lease import release
from clvol.spline.prefilter import prefilter_in_place
from clvol.volume.stored import AS_THEY_ARE
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.device.program import Program
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.build import DefineDict
    from clvol.spline.evaluator import Evaluator
    from clvol.volume.stored import Stored

__all__ = ["OPENCL_TYPES", "Coefficients", "Whole", "addressable", "axis_taps", "bundled", "bytes_of", "extent_of", "require_kind"]

OPENCL_TYPES = {  # NumPy to OpenCL
    "b1": "uchar",
    "u1": "uchar",
    "i1": "char",
    "u2": "ushort",
    "i2": "short",
    "u4": "uint",
    "i4": "int",
    "u8": "ulong",
    "i8": "long",
    "f4": "float",
    "f8": "double",
}


def addressable(array: NDArray[Any], device: Device) -> bool:
    """Whether kernels can address the elements of an array: a native OpenCL type, with strides that are multiples of its size."""
    name = OPENCL_TYPES.get(array.dtype.str[1:])
    known = name is not None and array.dtype.isnative and (name != "double" or device.has_double)
    return known and array.flags.aligned and not any(stride % array.itemsize for stride in array.strides)


def require_kind(kind: type[np.generic], device: Device) -> None:
    """Raise `DeviceError` for float64 on a device without it."""
    if kind == np.float64 and not device.has_double:
        raise DeviceError(f"precision 'double' needs a device with float64 (cl_khr_fp64); {device.name} has none: use 'single'")


def bundled(array: NDArray[Any], apart: tuple[int, int]) -> tuple[NDArray[Any], int, tuple[int, int]]:
    """How kernels traverse an array [z, y, x] with row and slice distances `apart` in the other buffer.

    Returns the array and the distances, with y and z swapped if that is faster, and the slices to process together: several if
    slices are closer in memory than successive elements along x.
    """
    z, y, x = (abs(stride) if n > 1 else 1 << 62 for stride, n in zip(array.strides, array.shape, strict=True))
    if y < min(x, z):
        return array.swapaxes(0, 1), _BUNDLE, apart[::-1]
    return array, _BUNDLE if z < x else 1, apart


_BUNDLE = 16
_MOST_ALONG = 1 << 30  # samples along an axis: a period has twice as many, which must fit in OpenCL's int
_AT_ONCE = 1 << 20  # indices of an axis computed at a time
_COPIED = 1 << 22  # samples that NumPy copies at a time, so that Ctrl-C takes effect in between


def _slabs(data: NDArray[Any]) -> list[tuple[slice, ...]]:
    """Parts of an array [z, y, x] in the order of its memory, wide enough for whole cache lines."""
    axis = int(np.argmax([abs(stride) if n > 1 else 0 for stride, n in zip(data.strides, data.shape, strict=True)]))
    n = data.shape[axis]
    some = max(_BUNDLE, _COPIED * n // data.size)
    return [(slice(None),) * axis + (slice(first, first + some),) for first in range(0, n, some)]


class Coefficients:
    """Storage on a device for a volume's coefficients and their halo; `clvol.spline.field.coefficients_of` makes one and fills it.

    A tuple of samples along x(, y, z) in place of a volume is one without a position in the world; a `batch` of them, of one or
    two axes, is stored as slices. Coefficients are those of ``(sample - offset) * 2**-exponent``, as `stored` says, in numbers of
    `kind`, np.float32 or np.float64.

    `functions` of them lie next to each other along x: 1, but see `clvol.spline.vectors`.

    `buffer` is [z, y, x], halo included; None once released. Kernels take `extent`: row pitch, rows, slices and halo; `size`:
    samples along (x, y, z), then 0; and `period`, that of the boundary rule along (x, y, z), 0 if it has none. The function is
    constant from `reach` samples past the padding, `pad`, on. `plans` are those of calls that read these coefficients.
    """

    functions = 1

    def __init__(
        self,
        volume: Volume | tuple[int, ...],
        filter: Filter,
        boundary: Boundary,
        device: Device,
        stored: Stored = AS_THEY_ARE,
        kind: type[np.generic] = np.float32,
        batch: int = 1,
    ) -> None:
        require_kind(kind, device)
        self._volume = volume
        size = volume.size if isinstance(volume, Volume) else volume
        self.filter = filter
        self.boundary = boundary
        self.device = device
        self.stored = stored
        self.kind = kind
        self.ndim = len(size)
        sizes = (*size, 1, 1)[:3]
        if filter.scale * max(sizes) > _MOST_ALONG:
            raise OutOfMemoryError(
                f"out of memory: there must be at most {_MOST_ALONG // filter.scale} samples along each axis; got {max(sizes)}"
            )
        prefiltered = (filter.magnified_by or filter).prefilter
        self.pad = boundary.padding(prefiltered, filter.support)
        self.reach = boundary.reach(filter.support)
        self.size = np.array([*sizes, 0], np.int32)
        self.period = np.array([*(boundary.length(n) for n in sizes), 0], np.int32)
        past = filter.scale * (self.pad + self.reach)
        pitch, rows, slices, halo = extent_of(filter, self.ndim, tuple(filter.scale * n for n in sizes), past)
        self.extent = np.array([pitch, rows, slices if self.ndim == 3 else batch, halo], np.int32)
        self.buffer: Any = device.buffers.allocate(self.nbytes)
        device.buffers.clear(self.buffer, math.prod(self.shape), LANES, kind)  # bounds read vectors past the last row
        self._image: Any = None
        self._uploaded: dict[int, Any] = {}
        self.plans: Plans[Any] = Plans()
        self._lock = threading.RLock()  # a signal handler may re-enter

    @property
    def volume(self) -> Volume:
        """The volume."""
        assert isinstance(self._volume, Volume)
        return self._volume

    @property
    def nbytes(self) -> int:
        """Size of the buffer in bytes."""
        return np.dtype(self.kind).itemsize * (math.prod(self.shape) + LANES)  # vectors may read past the last row

    @property
    def shape(self) -> tuple[int, int, int]:
        """Stored coefficients along z (for a batch, its size), y and x, halo included."""
        return int(self.extent[2]), int(self.extent[1]), int(self.extent[0])

    @property
    def inner(self) -> tuple[slice, ...]:
        """Where the coefficients are within the stored array, without the halo: [z, y, x]."""
        return self._within(0)

    @property
    def layout(self) -> tuple[int, int, int]:
        """The buffer offset of the first coefficient of `inner`, and the distances between rows and between slices."""
        pitch, area = int(self.extent[0]), int(self.extent[0]) * int(self.extent[1])
        return sum(inside.start * step for inside, step in zip(self.inner, (area, pitch, 1), strict=True)), pitch, area

    def _within(self, pad: int) -> tuple[slice, ...]:
        """`inner`, and `pad` more on each side."""
        halo, d = int(self.extent[3]), self.ndim
        return tuple(
            slice(halo - pad, halo + self.filter.scale * int(self.size[axis]) + pad)
            if axis < d
            else slice(0, int(self.extent[axis]))
            for axis in (2, 1, 0)
        )

    # -- filling -----------------------------------------------------------------------------------------------

    def fill(self, data: NDArray[Any]) -> None:
        """Compute the coefficients of samples [z, y, x] in any layout: copy, pad, prefilter, fill the halo.

        Each slice of a batch has one or two axes of samples.
        """
        self.copy_samples(data)
        if self.pad:
            self.fill_halo()
        if self.filter.prefilter:
            extent, size = self.extent.copy(), self.size[:3].copy()
            extent[3] -= self.pad
            size[: self.ndim] += 2 * self.pad
            size[2] = size[2] if self.ndim == 3 else self.extent[2]
            prefilter_in_place(
                self.device, self.buffer, self.filter, self.boundary, extent.tolist(), size.tolist(), self.ndim, self.kind
            )
            if self._beyond and self.boundary.period is None:
                self._continue_constant()
        self.fill_halo(self.pad)

    def _continue_constant(self) -> None:
        """Correct prefiltered coefficients for a constant outside that is not 0: the prefilter of "zero" takes it for 0.

        The prefilter is linear, and along each axis it is that of a constant, v, that differs from the constant near the ends.
        """
        from scipy.linalg import solve_banded

        ends = []
        for axis in range(self.ndim):
            b, n = self.filter.along(axis).undone, int(self.size[axis])
            bands = np.repeat(np.concatenate([b[:0:-1], b])[:, None], n, 1)
            ends.append(solve_banded((b.size - 1, b.size - 1), bands, np.ones(n)))
        vx, vy, vz = [*ends, np.ones(1), np.ones(1)][:3]
        rows = np.multiply.outer(vy, vx)
        with self.device.buffers.mapped(self.buffer, self.shape, write=True, kind=self.kind) as room:
            for plane, v in zip(room[self.inner], vz, strict=True):
                np.add(plane, self._beyond * (1 - v * rows), out=plane, casting="same_kind")

    def copy_samples(self, data: NDArray[Any], gain: float = 1.0) -> None:
        """Copy samples [z, y, x], or those of a batch, times `gain`, to where their coefficients will be.

        A kernel on all CPU cores copies if it can read the samples and they are stored unchanged; otherwise NumPy does.
        """
        device = self.device
        data = data[(slice(None),) * (data.ndim - self.ndim) + (None,) * (3 - data.ndim)]  # slices of a batch come first
        if not self._kernels_read(data):
            with device.buffers.mapped(self.buffer, self.shape, write=True, kind=self.kind) as room:
                inner = room[self.inner]
                if not self.stored.identity:  # by slices, since each needs a wider temporary
                    for target, slice_ in zip(inner, data, strict=True):
                        np.copyto(target, self.stored.samples(slice_), casting="unsafe")
                    return
                for slab in _slabs(data):
                    if gain == 1.0:
                        np.copyto(inner[slab], data[slab], casting="unsafe")
                    else:
                        np.multiply(data[slab], self.kind(gain), out=inner[slab], casting="unsafe")
            return
        kernel = self._build(OPENCL_TYPES[data.dtype.str[1:]]).kernel("copy_samples")
        origin, pitch, area = self.layout
        data, bundle, (pitch, area) = bundled(data, (pitch, area))
        nz, ny, nx = data.shape
        some = max(bundle, device.limits.launch_voxels // (nx * ny) // bundle * bundle)
        for first in range(0, nz, some):  # in parts, since samples of a wide type may exceed the largest allocation
            part = data[first : first + some]
            with device.buffers.lent_span(part, write=False) as (samples, start, strides), device.errors:
                kernel(
                    device.queue,
                    (ny, -(-len(part) // bundle)),
                    (1, 1),
                    samples,
                    start,
                    strides,
                    self.buffer,
                    np.uint64(origin + first * area),
                    np.int32(nx),
                    np.int32(len(part)),
                    np.int32(bundle),
                    np.uint64(pitch),
                    np.uint64(area),
                    self.kind(gain),
                )

    def fill_halo(self, kept: int = 0) -> None:
        """Fill the halo by the boundary rule, except for the `kept` coefficients next to the inner ones."""
        device, columns = self.device, self._within(kept)[2]
        with device.errors:
            self._build("float").kernel("fill_halo")(
                device.queue,
                self.shape[1::-1],
                device.alone(2),
                self.buffer,
                self.extent,
                np.int32(columns.start),
                np.int32(columns.stop - columns.start),
                self._places(kept),
                self.kind(self._beyond),
            )
        device.finish()

    def _places(self, kept: int) -> Any:
        """For each stored column, row and slice, the index of the coefficient to copy there."""
        if kept not in self._uploaded:
            halo, sizes = int(self.extent[3]), self.size.tolist()
            places = np.empty(sum(self.shape), np.int32)
            begin = 0
            for axis, stored in enumerate(self.shape[::-1]):
                for first in range(0, stored, _AT_ONCE):
                    index = np.arange(first, min(first + _AT_ONCE, stored))
                    if axis < self.ndim:
                        source = self.boundary.index(index - halo, sizes[axis], kept)
                        index = np.where(source < -kept, -1, source + halo)
                    places[begin + first : begin + first + len(index)] = index
                begin += stored
            self._uploaded[kept] = self.device.buffers.upload(places)
        return self._uploaded[kept]

    def _kernels_read(self, data: NDArray[Any]) -> bool:
        """Whether a kernel on the CPU can copy the samples, and they are stored unchanged."""
        return self.device.kind == "cpu" and self.stored.identity and addressable(data, self.device)

    @property
    def _beyond(self) -> float:
        """The coefficient outside, in stored units, for rules that use a constant."""
        beyond = self.boundary.beyond
        return 0.0 if beyond is None else float(self.stored(beyond, self.kind))

    def _build(self, samples: str) -> Program:
        return self.device.build(
            "spline/coefficients.cl",
            {
                "SAMPLE": samples,
                "COORD_DOUBLE": int(samples == "double"),  # enables fp64
                **scalar_defines(self.kind),
            },
        )

    # -- reading -----------------------------------------------------------------------------------------------

    def argument(self, evaluator: Evaluator) -> Any:
        """The buffer or image that kernels read with this evaluator. The image is made on first use."""
        if self.buffer is None:
            raise OptionError("the coefficients were released; make new ones")
        if not evaluator.image:
            return self.buffer
        with self._lock:
            if self._image is None:
                self._image = self.device.buffers.image_of(self.buffer, self.shape)
            return self._image

    def defines(self, evaluator: Evaluator) -> DefineDict:
        """The `#define`s of every kernel that samples these coefficients; the same for all boundary rules."""
        return {**filter_defines(self.filter, self.kind), **evaluator_defines(evaluator, self.filter, self.ndim, self.device)}

    def release(self) -> None:
        """Free the device's memory. Computed results stay valid."""
        with self._lock:
            memory = self.buffer, self._image
            self.buffer = self._image = None
        release(self.device, *memory)
        self.plans.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()


class Whole:
    """Metadata stand-in for the `Coefficients` of a whole volume of which only bricks are resident; the volume has no data."""

    def __init__(self, volume: Volume, filter: Filter, extent: tuple[int, ...], device: Device, stored: Stored) -> None:
        self.volume, self.filter, self.device, self.stored, self.ndim = volume, filter, device, stored, volume.ndim
        self.size = np.array([*volume.size, 0], np.int32)
        self.extent = np.array(extent, np.int32)

    def defines(self, evaluator: Evaluator) -> DefineDict:
        """As for `Coefficients`."""
        return {**filter_defines(self.filter, np.float32), **evaluator_defines(evaluator, self.filter, self.ndim, self.device)}


def bytes_of(size: tuple[int, ...], filter: Filter, boundary: Boundary, kind: type[np.generic]) -> int:
    """Bytes of the coefficients of `size` samples along x, y(, z), halo included; for a hybrid the peak while it is computed."""
    past = boundary.padding((filter.magnified_by or filter).prefilter, filter.support) + boundary.reach(filter.support)
    sizes = (*(filter.scale * n for n in size), 1, 1)[:3]
    nbytes = np.dtype(kind).itemsize * (math.prod(extent_of(filter, len(size), sizes, filter.scale * past)[:3]) + LANES)
    return nbytes if filter.magnified_by is None else nbytes + bytes_of(size, filter.magnified_by, boundary, kind)


def extent_of(filter: Filter, dimensions: int, sizes: tuple[int, ...], past: int) -> tuple[int, int, int, int]:
    """(row pitch, rows, slices, halo) of the storage for `sizes` coefficients along x, y and z.

    The halo covers the taps of every point of the domain and up to a sample outside, for central differences, and `past` more.
    Rows include what a vector load reads past the last tap.
    """
    halo = filter.support // 2 + 1 + filter.scale + past
    x, y, z = sizes
    pitch = -(-(x + 2 * halo + row_reach(filter) - filter.support) // LANES) * LANES
    return pitch, y + 2 * halo if dimensions > 1 else 1, z + 2 * halo if dimensions > 2 else 1, halo


class Tapped(Protocol):
    """What is stored for each sample, with a halo: see `Coefficients`."""

    filter: Filter
    boundary: Boundary
    size: NDArray[np.int32]
    extent: NDArray[np.int32]
    pad: int
    reach: int


def axis_taps(
    coefficients: Tapped, axis: int, positions: NDArray[np.float64], edge: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The indices of the stored coefficients along an axis for `positions` in samples, and their weights; (N, taps)."""
    boundary, n, row = coefficients.boundary, int(coefficients.size[axis]), coefficients.filter
    past = 1 + coefficients.pad + coefficients.reach  # up to here all taps are stored
    inside = (positions >= -edge) & (positions <= n - 1 + edge)
    if not inside.all():
        brought = np.where(np.isfinite(positions), positions, 0.0)
        brought, _ = boundary.position(brought, n, coefficients.pad, coefficients.reach)
        positions = np.where(inside, positions, np.clip(brought, -past, n - 1 + past))
    base, t = row.cell(positions)
    weights = row.weights(t).T
    return base.astype(np.int64)[:, None] + (np.arange(row.support) + int(coefficients.extent[3])), weights
