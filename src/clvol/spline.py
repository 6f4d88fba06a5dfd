"""From samples to coefficients on a device, and from coefficients to values and derivatives anywhere.

The host side of prefilter.cl, halo.cl, fetch.cl, sample.cl and points.cl.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import program
from clvol.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.device import Device, _opencl, as_device
from clvol.errors import DataError, DeviceError, OptionError, OutOfMemoryError, one_of, whole
from clvol.filters import DEFAULT_FILTER, Filter, as_filter
from clvol.order import Sorter, point_defines, scattered
from clvol.program import LANES
from clvol.volume import Volume, as_volume, read_array

__all__ = [
    "Coefficients",
    "Path",
    "choose_path",
    "magnify",
    "measure_sampler",
    "prefilter",
    "resample",
    "sample",
    "sample_coefficients",
]

Floats = NDArray[np.float32]
Progress = Callable[[float], None]
Evaluator = Literal["auto", "taps", "eight-fetch"]
Fetch = Literal["auto", "buffer", "image"]

CHAINS = 4  # vectors of lines that are filtered at once where they lie side by side
_START_ERROR = 1e-9  # what the starting values of the prefilter may leave out, relative to the data
_VOXELS_A_LAUNCH = 1 << 26  # of copies and the prefilter, and ...
_TAPS_A_LAUNCH = 1 << 25  # ... of sampling: a launch should not run longer than a quarter of a second
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
_RUN = 512  # points that a work-item takes on a processor, a multiple of LANES
_BLOCK = 16  # rows that separable.cl makes at once
_ITEMS_A_CORE = 16  # ... and among how many work-items it shares them out on each core, so that none waits long for another
_NO_SHEAR = 1e-9  # samples
_CHANNELS = 4  # of an image in colour, at most
_SAMPLE_BITS = 20.0  # of a sampler's fraction, before `sample` and `resample` trust it of themselves


# -- the prefilter ---------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def _starts(filter: Filter, boundary: Boundary, n: int) -> tuple[Floats, int, int]:
    """First values of the recursions of prefilter.cl on an axis of `n`, as sums over samples near the ends.

    Returns weights of shape (poles, 2, 2 * ends) and how many samples count from the first and from the last.

    The coefficients solve the matrix of eq. (11) that the boundary rule makes. Undoing the later poles'
    stages on them gives what each stage must produce, hence what it must start with; all of it is
    linear in the samples, and only samples near the ends matter, since the inverse falls off like the
    greatest pole's powers.
    """
    poles = filter.poles
    reach = math.ceil(math.log(_START_ERROR) / math.log(float(np.abs(poles).max()))) + 2 * poles.size
    m = min(n, 4 * reach)  # a longer axis has the same ends
    inverse = np.linalg.inv(boundary.matrix(filter.samples, m))  # rows: coefficients as sums over samples
    margin = 2 * poles.size
    index = boundary.index(np.arange(-margin, m + margin), m)
    stage = np.where(index[:, None] >= 0, inverse[index], 0.0)  # the coefficients and what lies past the edge
    weights = np.zeros((poles.size, 2, m))
    for p in range(poles.size - 1, -1, -1):
        first = margin - (poles.size - 1 - p)  # where index 0 lies in `stage`, which loses one end a step
        weights[p, 0] = stage[first + 1] - stage[first] / poles[p]
        weights[p, 1] = stage[first + m - 1]
        stage = stage[2:] + stage[:-2] - (poles[p] + 1 / poles[p]) * stage[1:-1]
    head = min(n, reach)
    tail = min(n - head, reach)
    ends = np.zeros((poles.size, 2, 2 * reach), dtype=np.float32)
    ends[:, :, :head] = weights[:, :, :head]
    ends[:, :, reach : reach + tail] = weights[:, :, ::-1][:, :, :tail]
    return ends, head, tail


def _prefilter(
    device: Device, buffer: Any, filter: Filter, boundary: Boundary, extent: Sequence[int], size: Sequence[int], dimensions: int
) -> None:
    """Filter the stored coefficients along the first `dimensions` of x, y and z, in place."""
    pitch, area, halo = extent[0], extent[0] * extent[1], extent[3]
    nx, ny, nz = size
    chains = CHAINS if device.kind == "cpu" else 1  # others have enough work-items to wait for
    starts = [_starts(filter, boundary, n) for n in size]
    built = program.build(
        device,
        "prefilter.cl",
        {
            "POLES": filter.poles.size,
            "POLE_VALUES": "{" + ",".join(f"{p:.9e}f" for p in filter.poles) + "}",
            "GAIN": float(1 / filter.samples[-1]),
            "ENDS": starts[0][0].shape[2] // 2,
            "CHAINS": chains,
            "COORD_DOUBLE": 0,
        },
    )
    along_x, along_y, along_z = ((device.upload(weights), np.int32(head), np.int32(tail)) for weights, head, tail in starts)

    def launch(name: str, groups: int, lines: int, origin: int, stride: int, voxels: int, *arguments: Any) -> None:
        """One launch or more over lines or slices of so many voxels, `stride` apart."""
        step = max(1, _VOXELS_A_LAUNCH // voxels)
        for first in range(0, lines, step):
            built.kernel(name)(
                device.queue,
                (groups, min(step, lines - first)),
                (1, 1) if device.kind == "cpu" else None,
                buffer,
                np.uint64(origin + first * stride),
                *arguments,
            )

    first_row = (halo * area if extent[2] > 1 else 0) + halo * pitch  # the halo's columns in it are filtered too, in vain
    rows = np.int32(nx), np.uint64(pitch), np.int32(ny), np.uint64(area)
    wide = -(-pitch // (LANES * chains))
    with device.errors:
        if device.kind == "cpu" and dimensions > 1 and nz >= 4 * device.units:
            launch("prefilter_slices", 1, nz, first_row + halo, area, area, *rows, np.int32(halo), *along_x, *along_y)
        else:
            launch("prefilter_rows", -(-ny // (2 * LANES)), nz, first_row + halo, area, area, *rows, *along_x)
            if dimensions > 1:
                columns = np.int32(ny), np.uint64(pitch), np.int32(pitch), np.uint64(area)
                launch("prefilter_columns", wide, nz, first_row, area, area, *columns, *along_y)
        if dimensions > 2:
            columns = np.int32(nz), np.uint64(area), np.int32(pitch), np.uint64(pitch)
            launch("prefilter_columns", wide, ny, first_row, pitch, nz * pitch, *columns, *along_z)


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
        built = program.build(device, "halo.cl", {"COORD_DOUBLE": 0})
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
        kernel = program.build(device, "samples.cl", defines).kernel("copy_samples")
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
        scale, halo = self.filter.scale, int(self.extent[3])
        with Coefficients(self.volume, by, self.boundary, self.device) as coarse:
            matrix = np.diag([1 / scale, 1 / scale, 1 / scale if self.volume.ndim == 3 else 0.0])
            offset = np.array([-halo / scale, -halo / scale, -halo / scale if self.volume.ndim == 3 else 0.0])
            _run_lattice(coarse, Path(False, False), matrix, offset, self.shape, self.buffer)

    @property
    def image(self) -> Any:
        """The same as an OpenCL image, made when first asked for."""
        if self._image is None:
            device, cl = self.device, _opencl()
            if max(self.shape) > device.image_limit:
                raise OutOfMemoryError(f"{device.name} holds images up to {device.image_limit} wide; got {self.shape}")
            device.require_room(self.nbytes)
            with device.errors:
                form = cl.ImageFormat(cl.channel_order.R, cl.channel_type.FLOAT)
                make = getattr(cl, "create_image", cl.Image)  # Image() itself is deprecated in favour of it
                self._image = make(device.context, cl.mem_flags.READ_ONLY, form, shape=self.shape[::-1])
                cl.enqueue_copy(device.queue, self._image, self.buffer, offset=0, origin=(0, 0, 0), region=self.shape[::-1]).wait()
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

    def argument(self, path: Path) -> Any:
        """The buffer or image that the kernels of this path read."""
        if self.buffer is None:
            raise OptionError("the coefficients were released; make new ones")
        return self.image if path.image else self.buffer

    def defines(self, path: Path) -> dict[str, str | int | float]:
        """What fetch.cl and sample.cl need to know."""
        eight = path.eight_fetch and self.filter.pairable(0)
        return {
            **program.filter_defines(self.filter),
            **program.boundary_defines(self.boundary),
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
    pitch = -(-(x + 2 * halo + program.row_reach(filter) - filter.support) // LANES) * LANES
    return np.array([pitch, y + 2 * halo, z + 2 * halo if dimensions == 3 else 1, halo], np.int32)


def prefilter(
    data: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    device: Device | str | int | None = None,
) -> Floats:
    """Spline coefficients of samples (section 4.2 of the paper).

    Parameters
    ----------
    data : Volume or array-like, shape (nx,), (ny, nx) or (nz, ny, nx)
        Samples of any integer or floating dtype.
    filter : str or Filter
        A row of the table; one that needs no prefilter gives the samples back.
    boundary : str or Boundary
        "mirror", "reflect", "wrap" or "zero".
    device : Device, str or int, optional
        See `as_device`.

    Returns
    -------
    ndarray of float32, the shape of `data`
        The control points r of eq. (11), for every axis.

    Raises
    ------
    DataError, OptionError, DeviceError
    """
    try:
        array, _ = read_array(data)  # coefficients have no geometry
    except ValueError as error:
        raise DataError(f"data must be a regular array of numbers: {error}") from None
    line = array.ndim == 1
    volume = Volume(array[None] if line else array)
    row, rule, on = as_filter(filter), as_boundary(boundary), as_device(device)
    if row.magnified_by is not None:
        row = row.magnified_by
    if line:  # a single row of an image, filtered along x alone
        return _prefilter_line(volume, row, rule, on)
    with Coefficients(volume, row, rule, on) as held, on.mapped(held.buffer, held.shape, write=False) as stored:
        return np.array(stored[held.inner]).reshape(volume.shape)


def _prefilter_line(volume: Volume, filter: Filter, boundary: Boundary, device: Device) -> Floats:
    volume.require_finite()
    n = volume.size[0]
    pitch = -(-n // LANES) * LANES
    buffer = device.allocate(4 * pitch)
    with device.mapped(buffer, (1, pitch), write=True) as stored:
        np.copyto(stored[:, :n], volume.data, casting="unsafe")
    if filter.poles.size:
        _prefilter(device, buffer, filter, boundary, (pitch, 1, 1, 0), (n, 1, 1), 1)
    with device.mapped(buffer, (1, pitch), write=False) as stored:
        result = np.array(stored[0, :n])
    buffer.release()
    return result


# -- which way a device reads coefficients -----------------------------------------------------------------


@dataclass(frozen=True)
class Path:
    """How a kernel gets at the function: pairs of taps by linear fetches or not, an image or a buffer."""

    eight_fetch: bool
    image: bool

    def __str__(self) -> str:
        return f"{'eight-fetch' if self.eight_fetch else 'taps'} from {'an image' if self.image else 'a buffer'}"


def choose_path(
    device: Device, filter: Filter, evaluator: str = "auto", fetch: str = "auto", *, bits: float = _SAMPLE_BITS
) -> Path:
    """The path to use on a device: as asked, else the one that suits it.

    Processors read buffers by direct taps: they sample images in software. On other devices pairs of
    taps come from the texture unit, if it was measured to interpolate with at least `bits` bits.

    Raises
    ------
    OptionError
        An unknown name.
    DeviceError
        ``fetch="image"`` on a device that has no float images, or whose sampler does not interpolate.
    """
    if evaluator not in ("auto", "taps", "eight-fetch"):
        raise one_of("evaluator", evaluator, ("auto", "taps", "eight-fetch"))
    if fetch not in ("auto", "buffer", "image"):
        raise one_of("fetch", fetch, ("auto", "buffer", "image"))
    if fetch == "image" and not device.has_images:
        raise DeviceError(f"fetch='image' needs 3-D float images; {device.name} has none: use fetch='buffer'")
    image = fetch == "image"
    textures = device.kind != "cpu" and fetch != "buffer" and evaluator != "taps"
    if fetch == "auto" and textures:
        image = filter.pairable(0) and device.has_images and device.sampler_bits >= bits
    eight = evaluator == "eight-fetch" or (evaluator == "auto" and image and device.kind != "cpu")
    eight = eight and filter.pairable(0)
    if eight and image and device.sampler_bits == 0:
        raise DeviceError(f"{device.name} does not interpolate float images; use evaluator='taps' or fetch='buffer'")
    return Path(eight, image)


def measure_sampler(device: Device) -> float:
    """Greatest error of the device's linear sampler between two texels of value 0 and 1.

    Some drivers offer linear filtering of float images and give the nearest texel: an error of 1/2.
    """
    ramp = Volume(np.broadcast_to(np.array([0.0, 1.0], np.float32), (2, 2, 2)))
    points = np.stack(np.broadcast_arrays(np.linspace(0, 1, 4097), 0.0, 0.0), -1)
    with Coefficients(ramp, as_filter("linear"), as_boundary("mirror"), device) as held:
        values = sample_coefficients(held, Path(True, True), points, 0, None)
    return float(np.abs(values - points[:, 0]).max())


# -- sampling --------------------------------------------------------------------------------------------


def _affine(device: Device, matrix: NDArray[np.float64], offset: NDArray[np.float64], slopes: NDArray[np.float64]) -> Any:
    """The transform of points.cl: from positions to indices, and from index to world derivatives."""

    def square(m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.pad(m, ((0, 3 - m.shape[0]), (0, 3 - m.shape[1])))

    whole = np.concatenate([square(matrix).ravel(), np.pad(offset, (0, 3 - offset.size)), square(slopes).ravel()])
    return device.upload(whole.astype(np.float64 if device.has_double else np.float32))


def _points_program(held: Coefficients, path: Path, derivative: int, fill: float | None, **more: str | int) -> program.Program:
    lanes, run = (LANES, _RUN) if _in_groups(held, path, derivative) else (1, 1)
    defines = {**held.defines(path), "DERIVATIVE": derivative, "FILL": int(fill is not None), "LANES": lanes, "RUN": run, **more}
    return program.build(held.device, "points.cl", defines)


def _in_groups(held: Coefficients, path: Path, derivative: int) -> bool:
    """Whether a work-item takes a run of points, eight at a time: on processors, from buffers by direct taps."""
    rows = int(held.extent[1]) * int(held.extent[2])
    return held.device.kind == "cpu" and path == Path(False, False) and derivative < 2 and rows <= np.iinfo(np.int32).max


def sample_coefficients(
    held: Coefficients,
    path: Path,
    points: NDArray[Any],
    derivative: int = 0,
    fill: float | None = None,
    progress: Progress | None = None,
) -> Floats:
    """Results at world positions of shape (N, d): (N,), (N, d) or (N, d * d); `sample` of a volume held on a device."""
    device, volume, d = held.device, held.volume, held.volume.ndim
    kind = np.float64 if device.has_double and points.dtype != np.float32 else np.float32
    groups = _in_groups(held, path, derivative)
    sorter = Sorter(held, kind, points.shape[0]) if groups and scattered(held, points) else None
    built = _points_program(held, path, derivative, fill, LATTICE=0, SORTED=int(sorter is not None), **point_defines(kind))
    inverse = volume.world_to_index_matrix
    transform = _affine(device, inverse, -inverse @ np.asarray(volume.origin), inverse)
    results = np.empty((points.shape[0], d**derivative), np.float32)
    kernel = built.kernel("sample_points")
    coefficients = held.argument(path)
    launch = _launch_points(held.filter, d, path)
    step = launch if sorter is None else sorter.room
    for first in range(0, points.shape[0], step):
        part = np.ascontiguousarray(points[first : first + step], dtype=kind)
        target = results[first : first + step]
        count = target.shape[0]
        with device.lent(part, write=False) as given, device.lent(target, write=True) as wanted, device.errors:
            source = given if sorter is None else sorter.sort(given, count, transform)
            for begin in range(0, count, launch):
                some = min(launch, count - begin)
                kernel(
                    device.queue,
                    (-(-some // _RUN),) if groups else (-(-some // 64) * 64,),
                    (1,) if groups else (64,),
                    coefficients,
                    held.extent,
                    held.size,
                    held.period,
                    transform,
                    source,
                    np.uint64(begin + some),
                    np.float32(0 if fill is None else fill),
                    wanted,
                    global_offset=(begin // _RUN if groups else begin,),
                )
                device.finish()
                if progress:
                    progress((first + begin + some) / points.shape[0])
    return results[:, 0] if derivative == 0 else results


def _fill_value(fill: float | None) -> float | None:
    """A real number, NaN and infinite ones included, or None."""
    if fill is not None and (isinstance(fill, (bool, str)) or not isinstance(fill, (int, float, np.number))):
        raise OptionError(f"fill must be a number or None; got {fill!r}")
    return None if fill is None else float(fill)


def _launch_points(filter: Filter, dimensions: int, path: Path) -> int:
    """How many points a launch takes, so that it is short whatever the filter; images may be sampled in software."""
    taps = _TAPS_A_LAUNCH if path.image else 4 * _TAPS_A_LAUNCH
    return max(1 << 10, taps // int(filter.support**dimensions) // _RUN * _RUN)


def _run_lattice(
    held: Coefficients,
    path: Path,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None = None,
    progress: Progress | None = None,
) -> None:
    """Values at index positions ``matrix @ (i, j, k) + offset`` into a float32 buffer of shape (z, y, x)."""
    device = held.device
    if device.kind == "cpu" and path == Path(False, False) and _along_axes(matrix, shape):
        _run_axes(held, np.diag(matrix), offset, shape, buffer, fill, progress)
        return
    built = _points_program(held, path, 0, fill, LATTICE=1, SORTED=0, **point_defines(np.float32))
    transform = _affine(device, matrix, offset, held.volume.world_to_index_matrix)
    kernel = built.kernel("sample_lattice")
    nz, ny, nx = shape
    points = _launch_points(held.filter, held.volume.ndim, path)
    rows, slices = max(1, min(ny, points // nx)), max(1, points // (nx * ny))
    items, together = (-(-nx // _RUN), 1) if _in_groups(held, path, 0) else (-(-nx // 8) * 8, 8)
    parts = [(z, y) for z in range(0, nz, slices) for y in range(0, ny, rows)]
    for done, (z, y) in enumerate(parts, 1):
        with device.errors:
            kernel(
                device.queue,
                (items, min(rows, ny - y), min(slices, nz - z)),
                (together, 1, 1),
                held.argument(path),
                held.extent,
                held.size,
                held.period,
                transform,
                np.array([nx, ny, y, z], np.int32),
                np.float32(0 if fill is None else fill),
                buffer,
            )
        device.finish()
        if progress:
            progress(done / len(parts))


def _along_axes(matrix: NDArray[np.float64], shape: tuple[int, ...]) -> bool:
    """Whether the axes of a lattice of shape (z, y, x) are the volume's, but for rounding."""
    across = matrix - np.diag(np.diag(matrix))
    return bool((np.abs(across) * np.array(shape[::-1])[: len(matrix)]).max() < _NO_SHEAR)


def _axis_taps(held: Coefficients, axis: int, positions: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The stored coefficients along an axis that make the function at `positions` (in samples), and their weights; (N, taps)."""
    row, rule, n = held.filter, held.boundary, int(held.size[axis])
    period, margin, halo = rule.length(n), 2 * row.support + 2, int(held.extent[3])
    if period:  # far out, within one period, where the rule repeats; not near, so that nothing is rounded there
        far = (positions < -n) | (positions > 2 * n)
        x = np.where(far, np.clip(positions - period * np.floor(positions / period), 0, period), positions)
    else:  # to where nothing is left
        x = np.clip(positions, -margin, n + margin)
    u = x * row.scale - (row.support / 2 - 1)
    base = np.floor(u)
    weights = np.asarray(np.polynomial.polynomial.polyval(u - base, row.matrix.T).T, np.float64)
    place = base.astype(np.int64)[:, None] + np.arange(row.support)
    stored = (place >= -halo) & (place < int(held.extent[axis]) - halo)
    if period:  # as boundary_index, which keeps the middle of a fold that lies between samples: it is in the halo
        again = place % (row.scale * period)
        inner = again if rule.fold is None else np.minimum(again, row.scale * (period - rule.fold) - again)
        return np.where(stored, place, inner) + halo, weights
    return np.where(stored, place + halo, 0), np.where(stored, weights, 0.0)


def _run_axes(
    held: Coefficients,
    step: NDArray[np.float64],
    start: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None,
    progress: Progress | None,
) -> None:
    """`_run_lattice` one axis after the other, for a lattice along the volume's axes."""
    device, taps, d = held.device, held.filter.support, held.volume.ndim
    nz, ny, nx = shape
    positions = [start[axis] + step[axis] * np.arange(n) for axis, n in enumerate((nx, ny, nz)[:d])]
    whole_vectors = np.pad(positions[0], (0, -nx % LANES), mode="edge")
    places, weights = zip(*(_axis_taps(held, axis, x) for axis, x in enumerate([whole_vectors, *positions[1:]])), strict=True)
    # what is used of a row, in whole vectors: rows are a whole number of them
    left = places[0].min() // LANES * LANES
    width = int(places[0].max() // LANES * LANES + LANES - left)
    places[0][...] = LANES * (places[0] - left)
    blocks, used = np.zeros((-(-ny // _BLOCK), 2), np.int64), [np.zeros(1, np.int64)]
    if d == 3:
        for block, rows in enumerate(np.split(places[1], range(_BLOCK, ny, _BLOCK))):
            distinct, among = np.unique(rows, return_inverse=True)
            rows[...] = among.reshape(rows.shape)
            blocks[block] = sum(map(np.size, used)), len(distinct)
            used.append(distinct)
    tables = [
        device.upload(np.concatenate([part.ravel() for part in parts]).astype(kind))
        for parts, kind in ((places, np.int32), (weights, np.float32), ([blocks], np.int32), (used, np.int32))
    ]
    units, pitch, area = nz * len(blocks), int(held.extent[0]), int(held.extent[0]) * int(held.extent[1])
    items, room = min(units, _ITEMS_A_CORE * device.units), width * (2 * LANES + int(blocks[:, 1].max()))
    scratch = device.allocate(4 * items * room)
    lattice = np.array([nx, ny, nz, places[0].size], np.int32)
    built = program.build(device, "separable.cl", {"TAPS": taps, "DIMENSIONS": d, "BLOCK": _BLOCK, "COORD_DOUBLE": 0})
    some = max(1, LANES * _TAPS_A_LAUNCH // (_BLOCK * nx * taps * d))
    for first in range(0, units, some):
        count = min(some, units - first)
        with device.errors:
            built.kernel("resample_axes")(
                device.queue,
                (min(items, count),),
                (1,),
                held.buffer,
                np.int32(left),
                np.uint64(pitch),
                np.uint64(area),
                np.int32(width),
                *tables,
                lattice,
                np.int32(first),
                np.int32(count),
                scratch,
                np.uint64(room),
                buffer,
            )
        device.finish()
        if progress:
            progress((first + count) / units)
    scratch.release()
    if fill is not None:
        with device.mapped(buffer, shape, write=True) as values:
            for axis, (x, n) in enumerate(zip(positions, held.volume.size, strict=True)):
                outside = (x < -0.5) | (x > n - 0.5)
                np.moveaxis(values, 2 - axis, 0)[outside] = fill


def sample(
    volume: Volume | ArrayLike,
    points: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    derivative: int = 0,
    *,
    evaluator: Evaluator = "auto",
    fetch: Fetch = "auto",
    fill: float | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Floats:
    """The reconstructed function, its gradient or its Hessian at points of the world.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples; an array has spacing 1 and origin 0.
    points : array-like, shape (..., 2) or (..., 3)
        World positions (x, y, z). A position that is not finite gives NaN.
    filter, boundary : str, Filter, Boundary
        Rows of their tables.
    derivative : {0, 1, 2}
        0 for values, 1 for gradients, 2 for Hessians: the exact derivatives of the function that
        derivative 0 gives, per world unit (almost everywhere, where it has kinks or jumps).
    evaluator : {"auto", "taps", "eight-fetch"}
        Direct taps, or linear fetches that serve two taps an axis. Filters whose weights change sign
        within a pair take direct taps; second derivatives always do.
    fetch : {"auto", "buffer", "image"}
        Where coefficients are read from.
    fill : float, optional
        The result outside the volume's domain; by default the boundary rule goes on there.
    device : Device, str or int, optional
        See `as_device`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of float32, shape (...), (..., d) or (..., d, d)

    Raises
    ------
    OptionError, DataError, DeviceError
    """
    volume = as_volume(volume)
    d = volume.ndim
    try:
        array = np.asarray(points)
    except ValueError as error:
        raise OptionError(f"points must be numbers of shape (..., {d}): {error}") from None
    if array.dtype.kind not in "biuf" or array.ndim == 0 or array.shape[-1] != d:
        raise OptionError(f"points must be numbers of shape (..., {d}); got {array.dtype} of shape {array.shape}")
    derivative = whole("derivative", derivative, least=0, most=2)
    fill = _fill_value(fill)
    on, row, rule = as_device(device), as_filter(filter), as_boundary(boundary)
    path = choose_path(on, row, evaluator, fetch)
    with Coefficients(volume, row, rule, on) as held:
        flat = sample_coefficients(held, path, array.reshape(-1, d), derivative, fill, progress)
    return flat.reshape(array.shape[:-1] + (d,) * derivative)


def resample(
    volume: Volume | ArrayLike,
    shape: Sequence[int] | None = None,
    spacing: Sequence[float] | float | None = None,
    like: Volume | None = None,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    evaluator: Evaluator = "auto",
    fetch: Fetch = "auto",
    fill: float | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Volume:
    """The volume on another grid; give exactly one of `shape`, `spacing` and `like`.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    shape : sequence of int, optional
        Samples along (z, y, x) or (y, x); the domain stays, its voxels become larger or smaller.
    spacing : float or sequence of float, optional
        New spacing along (x, y, z); the domain's centre stays, and its size to within half a voxel.
    like : Volume, optional
        Take the grid of this volume, wherever it lies.
    fill : float, optional
        Value outside the domain of `volume`; by default its boundary rule goes on.
    filter, boundary, evaluator, fetch, device, progress
        As for `sample`. No low-pass is applied: see `Volume.gaussian` before making voxels larger.

    Returns
    -------
    Volume of float32
    """
    volume = as_volume(volume)
    d = volume.ndim
    if sum(v is not None for v in (shape, spacing, like)) != 1:
        raise OptionError("resample takes exactly one of shape, spacing and like")
    extent = np.asarray(volume.size) * np.asarray(volume.spacing)
    if like is not None:
        if not isinstance(like, Volume) or like.ndim != d:
            raise OptionError(f"like must be a Volume of {d} axes, as the volume has; got {like!r}")
        grid = like
    else:
        if shape is not None:
            if d == 3 and volume.shape[2] <= _CHANNELS and np.shape(shape) == (2,):
                raise OptionError(
                    f"shape must be 3 whole numbers, as the volume has {d} axes; got {shape!r}: "
                    "for images in colour there is clvol.images.resample"
                )
            size = np.asarray(_sizes(shape, d)[::-1])
            step = extent / size
        else:
            try:
                step = np.broadcast_to(np.asarray(spacing, dtype=np.float64), (d,))
            except (TypeError, ValueError):
                raise OptionError(f"spacing must be a number, or {d} of them; got {spacing!r}") from None
            if not np.isfinite(step).all() or (step <= 0).any():
                raise OptionError(f"spacing must be positive and finite; got {spacing!r}")
            wanted = np.maximum(1, np.round(extent / step))
            if wanted.max() > np.iinfo(np.int32).max:
                raise OptionError(f"spacing {spacing!r} would need {wanted.max():.3g} samples along an axis")
            size = wanted.astype(np.int64)
        origin = volume.center - volume.direction @ (step * (size - 1) / 2)
        grid = _grid(volume, tuple(int(n) for n in size), tuple(step), tuple(origin))
    inverse = volume.world_to_index_matrix
    matrix = inverse @ grid.index_to_world_matrix
    offset = inverse @ (np.asarray(grid.origin) - np.asarray(volume.origin))
    data = _resampled(volume, matrix, offset, grid.shape, filter, boundary, evaluator, fetch, fill, device, progress)
    return Volume(data, grid.spacing, grid.origin, grid.direction, grid.units or volume.units)


def magnify(
    volume: Volume | ArrayLike,
    factor: int = 2,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    evaluator: Evaluator = "auto",
    fetch: Fetch = "auto",
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Volume:
    """The volume with `factor` times the samples along each axis, the given ones among them (section 4.3).

    Sample ``j`` of the result lies at ``j / factor`` of the given ones, so every `factor`-th is one of
    them; the last ones lie past the last given one, within its voxel or under the boundary rule.
    """
    volume = as_volume(volume)
    factor = whole("factor", factor, least=1)
    d = volume.ndim
    shape = tuple(factor * n for n in volume.shape)
    data = _resampled(volume, np.eye(d) / factor, np.zeros(d), shape, filter, boundary, evaluator, fetch, None, device, progress)
    return Volume(data, tuple(s / factor for s in volume.spacing), volume.origin, volume.direction, volume.units)


def _resampled(
    volume: Volume,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    filter: str | Filter,
    boundary: str | Boundary,
    evaluator: str,
    fetch: str,
    fill: float | None,
    device: Device | str | int | None,
    progress: Progress | None,
) -> Floats:
    on, row, rule = as_device(device), as_filter(filter), as_boundary(boundary)
    path = choose_path(on, row, evaluator, fetch)
    fill = _fill_value(fill)
    on.require_room(4 * math.prod(shape))
    result = np.empty(shape, np.float32)
    with Coefficients(volume, row, rule, on) as held, on.lent(result, write=True) as buffer:
        _run_lattice(held, path, matrix, offset, (1, *shape)[-3:], buffer, fill, progress)
    return result


def _grid(volume: Volume, size: tuple[int, ...], spacing: tuple[float, ...], origin: tuple[float, ...]) -> Volume:
    """An empty grid: its samples take no memory."""
    return Volume(np.broadcast_to(np.float32(0), size[::-1]), spacing, origin, volume.direction, volume.units)


def _sizes(shape: Sequence[int], d: int) -> tuple[int, ...]:
    try:
        sizes = tuple(int(n) for n in shape)
    except (TypeError, ValueError):
        sizes = ()
    if len(sizes) != d or min(sizes) < 1 or any(n != m for n, m in zip(sizes, shape, strict=True)):
        raise OptionError(f"shape must be {d} whole numbers of at least 1; got {shape!r}")
    return sizes
