"""A volume's coefficients on a device: the host side of coefficients.cl."""

from __future__ import annotations

import math
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import Boundary
from clvol.device import Device
from clvol.errors import OptionError
from clvol.filter import Filter
from clvol.program import LANES
from clvol.spline.build import boundary_defines, filter_defines, row_reach
from clvol.spline.evaluator import Evaluator
from clvol.spline.prefilter import _VOXELS_A_LAUNCH, _prefilter
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
    """A volume's coefficients on a device: prefiltered, surrounded by a halo, ready to be sampled.

    Parameters
    ----------
    volume : Volume
        2-D or 3-D samples.
    filter, boundary : str, Filter or Boundary
        Decide the prefilter and what the halo holds.
    device : Device
        Where they are held.

    Raises
    ------
    DataError
        A sample is NaN or infinite.
    OutOfMemoryError
        They do not fit on the device.
    """

    def __init__(self, volume: Volume, filter: Filter, boundary: Boundary, device: Device) -> None:
        self.volume = volume
        self.filter = filter
        self.boundary = boundary
        self.device = device
        volume.require_finite()
        sizes = (*volume.size, 1)[:3]
        # samples along (x, y, z), and the period of the boundary rule there, as int4 arguments
        self.size = np.array([*sizes, 0], np.int32)
        self.period = np.array([*(boundary.length(n) for n in sizes), 0], np.int32)
        if filter.magnified_by is None:
            self.extent = _extent(filter, volume.ndim, sizes)
            self.buffer = device.allocate(self.nbytes)
            self._fill(sizes)
        else:
            self.extent = _extent(filter, volume.ndim, tuple(filter.scale * n for n in sizes))
            self.buffer = device.allocate(self.nbytes)
            self._magnify(filter.magnified_by)
        self._image: Any = None

    @property
    def nbytes(self) -> int:
        """Of the buffer."""
        return 4 * (math.prod(self.shape) + LANES)  # vectors may read past the last row

    @property
    def shape(self) -> tuple[int, int, int]:
        """Stored coefficients along z, y, x, the halo included."""
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

    def _fill(self, sizes: tuple[int, ...]) -> None:
        device = self.device
        self._copy_samples(sizes)
        if self.filter.poles.size:
            _prefilter(device, self.buffer, self.filter, self.boundary, self.extent.tolist(), sizes, self.volume.ndim)
        halos = [inside.start for inside in self.inner[::-1]]
        places = [
            np.where((i := self.boundary.index(np.arange(stored) - halo, n)) < 0, -1, i + halo)
            for stored, n, halo in zip(self.shape[::-1], sizes, halos, strict=True)
        ]
        built = device.build("spline/coefficients.cl", {"COORD_DOUBLE": 0})
        with device.errors:
            built.kernel("fill_halo")(
                device.queue,
                self.shape[1::-1],
                None,
                self.buffer,
                self.extent,
                np.int32(sizes[0]),
                device.upload(np.concatenate(places).astype(np.int32)),
            )
        device.finish()

    def _copy_samples(self, sizes: tuple[int, ...]) -> None:
        """The samples to where their coefficients will be; by all cores where they can read them as they are."""
        device, data = self.device, self.volume.data
        named = _SAMPLES.get(data.dtype.str[1:])
        plain = data.flags.c_contiguous and data.dtype.isnative and data.flags.aligned
        if device.kind != "cpu" or not plain or named is None or (named == "double" and not device.has_double):
            with device.mapped(self.buffer, self.shape, write=True) as stored:
                np.copyto(stored[self.inner], data.reshape(sizes[::-1]), casting="unsafe")
            return
        defines: dict[str, str | int | float] = {"SAMPLE": named, "SAMPLE_DOUBLE": int(named == "double"), "COORD_DOUBLE": 0}
        pitch, area = int(self.extent[0]), int(self.extent[0]) * int(self.extent[1])
        origin = sum(inside.start * step for inside, step in zip(self.inner, (area, pitch, 1), strict=True))
        nx, ny, nz = sizes
        kernel = device.build("spline/samples.cl", defines).kernel("copy_samples")
        slices = data.reshape(nz, ny, nx)
        some = max(1, _VOXELS_A_LAUNCH // (nx * ny))
        for first in range(0, nz, some):  # part by part: a wide type may be larger than what a device allows at once
            part = slices[first : first + some]
            with device.lent(part, write=False) as given, device.errors:
                kernel(
                    device.queue,
                    (ny, len(part)),
                    (1, 1),
                    given,
                    self.buffer,
                    np.uint64(origin + first * area),
                    np.int32(nx),
                    np.uint64(pitch),
                    np.uint64(area),
                )

    def _magnify(self, by: Filter) -> None:
        """Samples of the spline on a grid of twice the density, halo included (section 4.3)."""
        from clvol.spline.resample import _run_lattice

        scale, halo = self.filter.scale, int(self.extent[3])
        with Coefficients(self.volume, by, self.boundary, self.device) as coarse:
            matrix = np.diag([1 / scale, 1 / scale, 1 / scale if self.volume.ndim == 3 else 0.0])
            offset = np.array([-halo / scale, -halo / scale, -halo / scale if self.volume.ndim == 3 else 0.0])
            _run_lattice(coarse, Evaluator(False, False), matrix, offset, self.shape, self.buffer)

    @property
    def image(self) -> Any:
        """The same as an OpenCL image, made when first asked for."""
        if self._image is None:
            self._image = self.device.image_of(self.buffer, self.shape)
        return self._image

    def release(self) -> None:
        """Free the device's memory; what was computed stays valid."""
        for memory in (self.buffer, self._image):
            if memory is not None:
                memory.release()
        self.buffer = self._image = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()

    def argument(self, path: Evaluator) -> Any:
        """The buffer or image that the kernels of this path read."""
        if self.buffer is None:
            raise OptionError("the coefficients were released; make new ones")
        return self.image if path.image else self.buffer

    def defines(self, path: Evaluator) -> dict[str, str | int | float]:
        """What fetch.cl and sample.cl need to know."""
        eight = path.eight_fetch and self.filter.pairable(0)
        return {
            **filter_defines(self.filter),
            **boundary_defines(self.boundary),
            "DIMENSIONS": self.volume.ndim,
            "FETCH_IMAGE": int(path.image),
            "EIGHT_FETCH_VALUE": int(eight),
            "EIGHT_FETCH_GRADIENT": int(eight and self.filter.pairable(1)),
            "COORD_DOUBLE": int(self.device.has_double),
        }


def _extent(filter: Filter, dimensions: int, sizes: tuple[int, ...]) -> NDArray[np.int32]:
    """(row pitch, rows, slices, halo) of the stored coefficients.

    The halo covers the taps of every point of the domain and of points a sample beyond it, for central
    differences; rows are longer by what a vector load reads past the last tap.
    """
    halo = filter.support // 2 + 1 + filter.scale
    x, y, z = sizes
    pitch = -(-(x + 2 * halo + row_reach(filter) - filter.support) // LANES) * LANES
    return np.array([pitch, y + 2 * halo, z + 2 * halo if dimensions == 3 else 1, halo], np.int32)
