"""A volume's coefficients as a device stores them: the host side of coefficients.cl."""

from __future__ import annotations

import math
import threading
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import Boundary
from clvol.device import Device
from clvol.errors import OptionError
from clvol.filter import Filter
from clvol.program import LANES, Program
from clvol.spline.build import DefineDict, boundary_defines, evaluator_defines, filter_defines, row_reach
from clvol.spline.evaluator import Evaluator
from clvol.stored import AS_THEY_ARE, Stored
from clvol.volume import Volume

__all__ = ["Coefficients"]

_SAMPLES = {  # OpenCL's names of NumPy's types
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


class Coefficients:
    """Room on a device for a volume's coefficients and the halo around them.

    This class is storage alone: a new one holds nothing yet. `clvol.spline.field.coefficients_of` makes one and fills it.

    Parameters
    ----------
    volume : Volume
        2-D or 3-D samples.
    filter, boundary : Filter, Boundary
        They determine how wide the halo is and what belongs into it.
    device : Device
        Where the coefficients are stored.
    stored : Stored
        What stands for the volume's values: the coefficients are those of ``(sample - offset) * 2**-exponent``.

    Attributes
    ----------
    buffer : Buffer
        float32, [z, y, x], halo included; None once released.
    extent : ndarray of int32, shape (4,)
        Row pitch, rows, slices and halo: the argument of every kernel that reads coefficients.
    size : ndarray of int32, shape (4,)
        Samples along (x, y, z), then 0.
    period : ndarray of int32, shape (4,)
        The period of the boundary rule along (x, y, z), 0 where it has none, then 0.

    Raises
    ------
    OutOfMemoryError
        The device has no room for them.
    """

    def __init__(self, volume: Volume, filter: Filter, boundary: Boundary, device: Device, stored: Stored = AS_THEY_ARE) -> None:
        self.volume = volume
        self.filter = filter
        self.boundary = boundary
        self.device = device
        self.stored = stored
        sizes = (*volume.size, 1)[:3]
        self.size = np.array([*sizes, 0], np.int32)
        self.period = np.array([*(boundary.length(n) for n in sizes), 0], np.int32)
        self.extent = _extent(filter, volume.ndim, tuple(filter.scale * n for n in sizes))
        self.buffer: Any = device.allocate(self.nbytes)
        device.clear(self.buffer, math.prod(self.shape), LANES)  # vectors past the last row enter bounds
        self._image: Any = None
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Size of the buffer in bytes."""
        return 4 * (math.prod(self.shape) + LANES)  # vectors may read past the last row

    @property
    def shape(self) -> tuple[int, int, int]:
        """Stored coefficients along z, y, x, halo included."""
        return int(self.extent[2]), int(self.extent[1]), int(self.extent[0])

    @property
    def inner(self) -> tuple[slice, ...]:
        """Where the coefficients proper lie among those stored: [z, y, x]."""
        halo = int(self.extent[3])
        flat = self.volume.ndim < 3
        return tuple(
            slice(0, 1) if axis == 2 and flat else slice(halo, halo + self.filter.scale * int(self.size[axis]))
            for axis in (2, 1, 0)
        )

    # -- filling -----------------------------------------------------------------------------------------------

    def copy_samples(self) -> None:
        """Put the volume's samples where their coefficients will be.

        All cores of a processor copy if kernels can read the samples and store them as they are; otherwise NumPy does.
        """
        device, data, sizes = self.device, self.volume.data, self.size[:3].tolist()
        kind = _SAMPLES.get(data.dtype.str[1:])
        plain = data.flags.c_contiguous and data.dtype.isnative and data.flags.aligned
        readable = plain and kind is not None and (kind != "double" or device.has_double)
        if device.kind != "cpu" or not readable or not self.stored.identity:
            with device.mapped(self.buffer, self.shape, write=True) as room:
                samples, inner = data.reshape(sizes[::-1]), room[self.inner]
                if self.stored.identity:
                    np.copyto(inner, samples, casting="unsafe")
                else:  # slice by slice, for each is made anew and wider
                    for target, slice_ in zip(inner, samples, strict=True):
                        np.copyto(target, self.stored.samples(slice_), casting="unsafe")
            return
        assert kind is not None  # it is readable
        kernel = self._build(kind).kernel("copy_samples")
        pitch, area = int(self.extent[0]), int(self.extent[0]) * int(self.extent[1])
        origin = sum(inside.start * step for inside, step in zip(self.inner, (area, pitch, 1), strict=True))
        nx, ny, nz = sizes
        slices = data.reshape(nz, ny, nx)
        some = max(1, device.limits.launch_voxels // (nx * ny))
        for first in range(0, nz, some):  # in parts, for samples of a wide type may exceed the largest allocation
            part = slices[first : first + some]
            with device.lent(part, write=False) as samples, device.errors:
                kernel(
                    device.queue,
                    (ny, len(part)),
                    (1, 1),
                    samples,
                    self.buffer,
                    np.uint64(origin + first * area),
                    np.int32(nx),
                    np.uint64(pitch),
                    np.uint64(area),
                )

    def fill_halo(self) -> None:
        """Surround the coefficients by what the boundary rule says lies there."""
        device, sizes = self.device, self.size[:3].tolist()
        halos = [inside.start for inside in self.inner[::-1]]
        places = [
            np.where((i := self.boundary.index(np.arange(stored) - halo, n)) < 0, -1, i + halo)
            for stored, n, halo in zip(self.shape[::-1], sizes, halos, strict=True)
        ]
        with device.errors:
            self._build("float").kernel("fill_halo")(
                device.queue,
                self.shape[1::-1],
                None,
                self.buffer,
                self.extent,
                np.int32(sizes[0]),
                device.upload(np.concatenate(places).astype(np.int32)),
            )
        device.finish()

    def _build(self, samples: str) -> Program:
        return self.device.build(
            "spline/coefficients.cl", {"SAMPLE": samples, "SAMPLE_DOUBLE": int(samples == "double"), "COORD_DOUBLE": 0}
        )

    # -- reading -----------------------------------------------------------------------------------------------

    @property
    def image(self) -> Any:
        """The coefficients as an OpenCL image, made at the first use."""
        with self._lock:
            if self._image is None:
                self._image = self.device.image_of(self.buffer, self.shape)
            return self._image

    def argument(self, evaluator: Evaluator) -> Any:
        """The buffer or image that kernels read with this evaluator.

        Raises
        ------
        OptionError
            The coefficients were released.
        OutOfMemoryError
            An image of this shape, or another copy, is more than the device holds.
        """
        if self.buffer is None:
            raise OptionError("the coefficients were released; make new ones")
        return self.image if evaluator.image else self.buffer

    def defines(self, evaluator: Evaluator) -> DefineDict:
        """What every kernel that samples these coefficients needs to know."""
        return {
            **filter_defines(self.filter),
            **boundary_defines(self.boundary),
            **evaluator_defines(evaluator, self.filter, self.volume.ndim, self.device),
        }

    def release(self) -> None:
        """Free the device's memory. Results that were computed stay valid."""
        for memory in (self.buffer, self._image):
            if memory is not None:
                memory.release()
        self.buffer = self._image = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()


def _extent(filter: Filter, dimensions: int, sizes: tuple[int, ...]) -> NDArray[np.int32]:
    """(row pitch, rows, slices, halo) of what is stored for so many coefficients along x, y and z.

    The halo covers the taps of every point of the domain, and of points a sample beyond it, for central differences.
    Rows are longer by what a vector load reads past the last tap.
    """
    halo = filter.support // 2 + 1 + filter.scale
    x, y, z = sizes
    pitch = -(-(x + 2 * halo + row_reach(filter) - filter.support) // LANES) * LANES
    return np.array([pitch, y + 2 * halo, z + 2 * halo if dimensions == 3 else 1, halo], np.int32)
