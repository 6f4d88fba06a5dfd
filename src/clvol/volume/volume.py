"""A volume (or image): samples on a regular grid, and the placement of that grid in the world."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import number, one_of, whole
from clvol.base.color import color_of
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.base.frames import in_frame
from clvol.interop.images import read_array
from clvol.interop.itk import to_simpleitk
from clvol.interop.nibabel import to_nibabel
from clvol.interop.xarray_images import to_xarray
from clvol.noise import MOST_LABELS, Noise, estimate
from clvol.volume.missing import Missing, filled_smoothly
from clvol.volume.pictured import Pictured

__all__ = ["SPACES", "Volume", "array_of", "as_volume", "clim_of"]

SPACES = {
    "LPS": "a patient: x points to the left, y to the back, z to the head",
    "image": "a stack of images: y points down, and z away from the viewer, as in microscopy programs",
    "": "unspecified: z points up",
}
"""Kinds of world. They set the orientation of pictures, and change no number."""

_CACHED = 1 << 18  # samples of a part that fits into the CPU cache
_PREVIEW = 1 << 16  # samples that suffice to see that most data are not labels
_SAME = 0.8  # smallest fraction of equal neighbours in labels
_TINY_DETERMINANT = 1e-12


@dataclass(frozen=True, eq=False)
class Volume(Pictured):
    """Samples on a regular grid in world space.

    Arrays are indexed ``[z, y, x]`` (images ``[y, x]``); all geometry is
    ``(x, y, z)`` in world units, as in ITK. Voxel centres are at integer indices, and
    voxel ``i`` covers ``[i - 1/2, i + 1/2]``.

    Parameters
    ----------
    data : array-like, shape (nz, ny, nx) or (ny, nx)
        Any integer, boolean or floating dtype, any byte order and memory layout; it is
        viewed, not copied, so the caller's array must not change afterwards: earlier results would
        no longer match it. `Volume.data` is read-only. A masked array may have no masked element.
        SimpleITK and nibabel images give their spacing, origin and direction too, in ITK's LPS frame and
        in mm, and what else a NIfTI header says: see `clim`, `labels` and `header`. So do images of ITK, image data of VTK and
        PyVista (the active scalars; those of cells lie in their middles), and Image and Labels layers of napari, with their
        units, contrast limits and colour; of several sizes the first. Arrays of xarray give what their coordinates say, which
        must be evenly spaced. Arrays of Zarr and dask are read whole, if there is memory for them, and say nothing of geometry:
        that of OME-Zarr stands with its group, `clvol.read`.
    spacing : sequence of float, optional
        Distance between neighbouring samples along x, y(, z) in world units; default 1.
    origin : sequence of float, optional
        World position of the sample with index 0; default 0.
    direction : array-like, shape (d, d), optional
        Column ``j`` is the world direction of index axis ``j`` (x first); columns must be
        independent unit vectors. Default identity.
    units : str, optional
        Name of the world unit, ``"mm"`` for example.
    space : {"LPS", "image", ""}, optional
        Kind of world: a patient (medical files), a stack of images (microscopy), or unspecified. It sets the
        orientation of pictures: see `Camera.orbit`.
    name : str, optional
        Name of the samples, for example of a channel.
    color : color, optional
        In which the source shows it, as microscopes give one to each channel.
    clim : (float, float), optional
        The values that the source shows as black and as white (NIfTI's cal_min and cal_max, DICOM's window).
    labels : bool or mapping of int to str, optional
        Whether samples are labels, which are never blended, or a name per label. None: detect it
        (`is_labels`).
    header : mapping, optional
        Other metadata of its file, for writing the same format.

    Raises
    ------
    DataError
        The rank is not 2 or 3, an axis is empty, elements are masked, or the dtype has no real numbers.
    GeometryError
        Spacing is not finite and positive, origin is not finite, or direction is singular.
    OptionError
        `space` is none of these, `color` is no colour, `clim` no pair of finite numbers in ascending order, `labels` no
        mapping from whole numbers to names, `header` no mapping.

    Notes
    -----
    A volume may contain NaN and infinite samples, but they enter no computation: the spline
    prefilter is recursive, so that one NaN would spoil all coefficients. Rendering, sampling
    and prefiltering raise `DataError` with the index of the first one; `filled` replaces them, and sampling
    can leave out the results that they affect (`Missing`).
    """

    data: NDArray[Any]
    spacing: tuple[float, ...] = ()
    origin: tuple[float, ...] = ()
    direction: NDArray[np.float64] = None  # type: ignore[assignment]  # None is replaced below
    units: str = ""
    space: str = ""
    name: str = ""
    color: tuple[float, float, float] | None = None
    clim: tuple[float, float] | None = None
    labels: bool | Mapping[int, str] | None = None
    header: Mapping[str, Any] = field(default_factory=dict, repr=False)

    # shared with LazyVolume; here all samples are in memory, at one level
    levels: ClassVar[tuple[()]] = ()
    bounds: ClassVar[None] = None
    estimated: ClassVar[bool] = False
    in_memory: ClassVar[bool] = True

    def __post_init__(self) -> None:
        data, geometry = read_array(self.data)
        if data.ndim not in (2, 3):
            several = ": take one of several volumes as clvol.Volumes(data)[k]" if data.ndim > 3 else ""
            raise DataError(f"data must have 2 axes [y, x] or 3 axes [z, y, x]; got shape {data.shape}{several}")
        if 0 in data.shape:
            raise DataError(f"every axis of data must hold at least one sample; got shape {data.shape}")
        if data.dtype.kind not in "biuf":
            raise DataError(f"data must be boolean, integer or floating; got dtype {data.dtype}")
        d = data.ndim
        data = data.view()
        data.flags.writeable = False
        spacing = self.spacing if _given(self.spacing) else geometry.get("spacing", (1.0,) * d)
        origin = self.origin if _given(self.origin) else geometry.get("origin", (0.0,) * d)
        direction = self.direction if self.direction is not None else geometry.get("direction", np.eye(d))
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "spacing", _vector("spacing", spacing, d))
        object.__setattr__(self, "origin", _vector("origin", origin, d))
        object.__setattr__(self, "direction", _direction(direction, d))
        for name in ("units", "space", "name", "color", "clim", "labels", "header"):
            value = getattr(self, name)
            if (value is None or isinstance(value, (str, Mapping))) and not value and name in geometry:
                object.__setattr__(self, name, geometry[name])
        for name in ("units", "name"):
            if not isinstance(getattr(self, name), str):
                raise OptionError(f"{name} must be a string; got {getattr(self, name)!r}")
        if not isinstance(self.space, str) or self.space not in SPACES:
            raise one_of("space", self.space, map(repr, SPACES))
        if self.color is not None:
            object.__setattr__(self, "color", color_of("color", self.color))
        if self.clim is not None:
            object.__setattr__(self, "clim", clim_of("clim", self.clim))
        if self.labels is not None:
            object.__setattr__(self, "labels", _labels(self.labels))
        if not isinstance(self.header, Mapping):
            raise OptionError(f"header must be a mapping; got {self.header!r}")
        object.__setattr__(self, "header", dict(self.header))
        if min(self.spacing) <= 0:
            raise GeometryError(f"spacing must be positive along every axis; got {self.spacing}")

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore a pickle or a copy. Its samples are read-only, like those of any volume, to keep cached properties valid."""
        self.__dict__.update(state)
        object.__setattr__(self, "data", self.data.view())
        for array in (self.data, self.direction):
            array.flags.writeable = False

    def __repr__(self) -> str:
        patient = ", space='LPS'" if self.space == "LPS" else ""
        return (
            f"Volume(shape={self.shape}, dtype={self.data.dtype}, spacing={self.spacing}, "
            f"origin={self.origin}, units={self.units!r}{patient})"
        )

    def _repr_html_(self) -> str:
        """For notebooks: three middle slices, facts and the histogram. Uses no device."""
        from clvol.base import html
        from clvol.show import thumbnail

        known = {
            "name": self.name,
            "samples": f"{html.numbers(self.shape)} {self.data.dtype}" + (", labels" if self.labels not in (None, False) else ""),
            "spacing": f"{html.numbers(self.spacing)} {self.units}",
            "origin": f"{html.numbers(self.origin, ', ')}" if any(self.origin) else "",
            "space": f"{self.space}: {SPACES[self.space]}" if self.space else "",
            "values": self._range_in_words(),
            "clim": html.numbers(self.clim, " to ") if self.clim else "",
        }
        blended = self.labels in (None, False)
        middle = thumbnail.slices(
            self.data, self.spacing, self.direction, space=self.space, clim=self.clim, color=self.color, blended=blended
        )
        pictures = (thumbnail.image(picture, plane) for plane, picture in middle)
        try:
            counts = html.histogram(self.data, *self.value_range)
        except DataError:  # nothing is finite
            counts = ""
        return html.beside(*pictures, html.facts("Volume" if self.ndim == 3 else "Image", known), counts)

    def _range_in_words(self) -> str:
        try:
            low, high = self.value_range
        except DataError:  # nothing is finite
            return "none is finite"
        missing = "" if all(np.isfinite(v) for v in self.limits) else ", some not finite"
        return f"{low:.6g} to {high:.6g}{missing}"

    # -- conversions to other libraries --------------------------------------------------------

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The samples, ``np.asarray(volume)``: a read-only view, unless another dtype or a copy is requested."""
        return array_of(self.data, dtype, copy)

    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[Any, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """The samples, for ``torch.from_dlpack(volume)``.

        Libraries that support read-only memory (DLPack 1.0) share the volume's memory, and must not write to it; others,
        and all of them with NumPy older than 2.1, get a copy.

        Raises
        ------
        BufferError
            A copy is necessary but ``copy=False``, or DLPack does not support the dtype.
        """
        requested = {"stream": stream, "max_version": max_version, "dl_device": dl_device, "copy": copy}
        options = {name: value for name, value in requested.items() if value is not None}
        try:
            return self.data.__dlpack__(**options)
        except (BufferError, TypeError) as error:  # TypeError: NumPy 1 lacks the newer options
            if copy is False:
                raise BufferError(f"samples of a volume are read-only and cannot be shared here without a copy: {error}") from None
        options = {name: options[name] for name in ("stream",) if name in options}
        return self.data.astype(self.data.dtype.newbyteorder("=")).__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[Any, int]:
        """Host memory."""
        return self.data.__dlpack_device__()

    def to_sitk(self) -> Any:
        """A SimpleITK image with a copy of the samples, in mm (``pip install clvol[medical]``).

        Raises
        ------
        DataError
            ITK does not support the dtype; bool becomes uint8, and float16 float32.
        GeometryError
            `units` is not a length; no units means mm.
        MissingDependencyError
            SimpleITK is not installed.
        """
        return to_simpleitk(self.data, self)

    def to_nibabel(self) -> Any:
        """A nibabel image (NIfTI) in RAS and mm, with what `header` keeps of a NIfTI file, and `clim` as cal_min and cal_max.

        Its samples are [x, y, z], a view of the volume's (``pip install clvol[medical]``).

        Raises
        ------
        DataError
            NIfTI does not support the dtype; bool becomes uint8, and float16 float32.
        GeometryError
            `units` is not a length (no units means mm), or float32 cannot hold the geometry.
        MissingDependencyError
            nibabel is not installed.
        """
        return to_nibabel(self.data, self)

    def to_xarray(self) -> Any:
        """A DataArray with dimensions z, y, x. It has coordinates in world units if its axes are parallel to the world's.

        Its attributes are "size", "spacing", "origin" and "direction", (x, y, z), "world_units", "space", and "clim" if there
        is one. ``Volume(array)`` comes back, also of a part with coordinates (``pip install clvol[xarray]``).

        Raises
        ------
        MissingDependencyError
            xarray is not installed.
        """
        return to_xarray(self.data, self)

    @property
    def ndim(self) -> int:
        """2 for images, 3 for volumes."""
        return int(self.data.ndim)

    @property
    def shape(self) -> tuple[int, ...]:
        """Samples along each axis, in array order: (nz, ny, nx) or (ny, nx)."""
        return tuple(int(n) for n in self.data.shape)

    @property
    def size(self) -> tuple[int, ...]:
        """Samples along x, y(, z), in the order of the geometry: `shape` reversed."""
        return self.shape[::-1]

    @property
    def grid(self) -> Volume:
        """The grid of the samples: the volume itself."""
        return self

    @property
    def nbytes(self) -> int:
        """Bytes of all samples."""
        return self.data.nbytes

    def preview(self) -> Volume:
        """Samples that default looks are derived from: all of them."""
        return self

    def part(self) -> Volume:
        """Contiguous samples for estimating noise: all of them."""
        return self

    def for_tasks(self) -> Volume:
        """The volume as sent to tasks of a cluster: unchanged."""
        return self

    @cached_property
    def limits(self) -> tuple[Any, Any]:
        """Smallest and largest sample in their own dtype; NaN if a sample is NaN."""
        # both in one pass, while each part is in the CPU cache
        ends = [(part.min(), part.max()) for part in _parts(self.data)]
        return np.min([low for low, _ in ends]), np.max([high for _, high in ends])

    @cached_property
    def value_range(self) -> tuple[float, float]:
        """Smallest and largest finite sample.

        Raises
        ------
        DataError
            No sample is finite.
        """
        low, high = (float(v) for v in self.limits)
        if math.isfinite(low) and math.isfinite(high):
            return low, high
        ends: list[float] = []
        for part in _parts(self.data):
            low, high = float(part.min()), float(part.max())  # far faster than selecting finite samples, which few parts need
            if math.isfinite(low) and math.isfinite(high):
                ends += [low, high]
                continue
            with np.errstate(over="ignore"):  # longdouble has a larger range than float64
                finite = part[np.isfinite(part.astype(np.float64, copy=False))]
            if finite.size:
                ends += [float(finite.min()), float(finite.max())]
        if not ends:
            raise DataError("no sample of the volume is finite")
        return min(ends), max(ends)

    def require_finite(self) -> None:
        """Raise `DataError` if a sample is NaN, infinite, or too large for float64."""
        if self.data.dtype.kind != "f":
            return
        low, high = self.limits
        if np.isfinite(low) and np.isfinite(high):
            with np.errstate(over="ignore"):  # longdouble has a larger range
                held = np.isfinite([float(low), float(high)]).all()
            if not held:
                raise DataError(f"samples must be within ±1.8e308, the range of float64; got {low!s} to {high!s}")
            return
        missing, infinite, first = 0, 0, None
        for part, start in zip(_parts(self.data), _starts(self.data), strict=True):
            bad = ~np.isfinite(part)
            if bad.any():
                at = np.unravel_index(int(np.argmax(bad)), part.shape)
                first = first or [int(i) + s for i, s in zip(at, start, strict=True)]
                nan = int(np.isnan(part).sum())
                missing, infinite = missing + nan, infinite + int(bad.sum()) - nan
        raise DataError(
            f"samples must be finite; got {missing} NaN and {infinite} infinite, the first at index {first}: "
            "replace them with Volume.filled(value)"
        )

    def filled(self, value: float | None = None) -> Volume:
        """A copy with NaN and infinite samples replaced by `value`; by default by the smooth fill of `Missing`."""
        new = None if value is None else number("value", value)
        if self.data.dtype.kind != "f":
            return self
        if new is None:
            where = Missing("local").of(self.data)
            return self if where is None else self._with(filled_smoothly(self.data, where))
        memory.require(self.data.nbytes + self.data.size, f"a copy of {self.data.size} samples")
        with np.errstate(over="ignore"):
            stored = self.data.dtype.type(new)
        if not np.isfinite(stored):
            raise OptionError(
                f"value must be within the range of {self.data.dtype}, ±{np.finfo(self.data.dtype).max!s}; got {value!r}"
            )
        return self._with(np.where(np.isfinite(self.data), self.data, stored))

    # -- geometry: the only conversion between index space and world space -----------------

    @cached_property
    def index_to_world_matrix(self) -> NDArray[np.float64]:
        """``world = M @ index + origin``; shape (d, d), index in (x, y, z)."""
        return np.asarray(self.direction * np.asarray(self.spacing))

    @cached_property
    def world_to_index_matrix(self) -> NDArray[np.float64]:
        """``index = M @ (world - origin)``; shape (d, d)."""
        return np.linalg.inv(self.index_to_world_matrix).astype(np.float64)

    def index_to_world(self, index: ArrayLike, frame: str = "LPS") -> NDArray[np.float64]:
        """World positions of index positions; shape (..., d), both in (x, y, z), the world's in a `frame` of `FRAMES`."""
        with np.errstate(over="ignore", invalid="ignore"):  # positions may be infinite
            world = self._points("index", index) @ self.index_to_world_matrix.T + np.asarray(self.origin)
        return in_frame(world, frame, self.space)

    def world_to_index(self, world: ArrayLike, frame: str = "LPS") -> NDArray[np.float64]:
        """Index positions of world positions; shape (..., d), both in (x, y, z), the world's in a `frame` of `FRAMES`."""
        points = in_frame(self._points("world", world), frame, self.space)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray((points - np.asarray(self.origin)) @ self.world_to_index_matrix.T)

    @property
    def mean_spacing(self) -> float:
        """The mean spacing in world units: the unit of length in kernels."""
        return float(np.mean(self.spacing))

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """World positions of the domain's corners, half a voxel outside the outer samples; (2**d, d)."""
        low, high = -0.5, np.asarray(self.size) - 0.5
        steps = np.stack(np.meshgrid(*[[0.0, 1.0]] * self.ndim, indexing="ij"), -1).reshape(-1, self.ndim)
        return self.index_to_world(low + steps * (high - low))

    @cached_property
    def center(self) -> NDArray[np.float64]:
        """World position of the middle of the domain; shape (d,)."""
        return self.index_to_world((np.asarray(self.size) - 1) / 2)

    @cached_property
    def radius(self) -> float:
        """Radius of the sphere around the domain, in world units."""
        return float(np.linalg.norm(self.corners - self.center, axis=1).max())

    @cached_property
    def is_labels(self) -> bool:
        """Whether samples are labels of regions: `labels` if set, else whether they are few integers that fill regions.

        Labels are never blended: by default the nearest sample is used. Masks with two values do not count as labels
        unless `labels` is set, because their edge is a surface that may be smoothed.
        """
        if self.labels is not None:
            return self.labels is not False
        if self.data.dtype.kind not in "iu" or self.data.size == 0:
            return False
        some = self.data[len(self.data) // 2].ravel()[:_PREVIEW]  # contiguous samples
        if some.size > 1 and (some[1:] == some[:-1]).mean() < _SAME:
            return False
        return self.noise.kind == "labels" or _many_labels(self.data)

    @cached_property
    def noise(self) -> Noise:
        """The estimated noise of the samples, from at most about a million of them; see `clvol.noise.estimate`.

        Raises
        ------
        DataError
            An inspected sample is NaN or infinite.
        """
        return estimate(self.data)

    # -- derived volumes ---------------------------------------------------------------------

    def indicator(self, *labels: float) -> Volume:
        """Indicator of a region of labels: 1 where a sample has one of these values, else 0, in float32. Its surface is at 1/2."""
        if not labels:
            raise OptionError("indicator needs at least one value; got none")
        for label in labels:
            number("each value of indicator", label)
        memory.require(4 * self.data.size, f"a region of {self.data.size} samples")
        inside = np.empty(self.shape, np.float32)
        for part, target in zip(_parts(self.data), _parts(inside), strict=True):
            target[...] = np.isin(part, labels)
        return self._with(inside, labels=None, clim=None)

    def crop(self, low: Sequence[int], high: Sequence[int]) -> Volume:
        """The samples with index ``low <= index < high``, (x, y, z), at the same place in the world."""
        lo, hi = _whole("low", low, self.ndim), _whole("high", high, self.ndim)
        for a, b, n in zip(lo, hi, self.size, strict=True):
            if not 0 <= a < b <= n:
                raise OptionError(f"crop needs 0 <= low < high <= {self.size} along x, y(, z); got {lo} to {hi}")
        part = tuple(slice(a, b) for a, b in zip(lo[::-1], hi[::-1], strict=True))
        return self._with(self.data[part], origin=tuple(self.index_to_world(lo)))

    def gaussian(self, sigma: float | Sequence[float]) -> Volume:
        """Low-pass with a Gaussian of standard deviation `sigma` in world units (section 3 of the paper).

        The kernel is truncated at four standard deviations; edges are mirrored. The result is float32, or float64 for
        float64, longdouble, and integers beyond 2²⁴.
        """
        from scipy import ndimage

        one = np.isscalar(sigma) or (isinstance(sigma, np.ndarray) and sigma.ndim == 0)
        values = [sigma] * self.ndim if one else sigma
        widths = _vector("sigma", values, self.ndim)
        if min(widths) < 0:
            raise OptionError(f"sigma must not be negative; got {sigma!r}")
        memory.require(4 * 2 * self.data.size, f"the low-pass of {self.data.size} samples")  # before the samples are read
        self.require_finite()
        voxels = [w / s for w, s in zip(widths, self.spacing, strict=True)][::-1]
        wide = self.data.dtype.itemsize > 4 if self.data.dtype.kind == "f" else self._beyond_float32()
        kind = np.float64 if wide else np.float32
        memory.require(2 * np.dtype(kind).itemsize * self.data.size, f"the low-pass of {self.data.size} samples")
        return self._with(ndimage.gaussian_filter(self.data.astype(kind), voxels, mode="mirror"), labels=None)

    def downsample(self, n: int) -> Volume:
        """Every `n`-th sample along each axis, from the first; low-pass with `gaussian` first."""
        n = whole("n", n, 1)
        return self._with(self.data[(slice(None, None, n),) * self.ndim], spacing=tuple(s * n for s in self.spacing))

    def _beyond_float32(self) -> bool:
        """Whether there are integers that float32 cannot hold."""
        return self.data.dtype.itemsize > 2 and max(abs(int(v)) for v in self.limits) > 1 << 24

    def placed(self, data: NDArray[Any], grid: Volume) -> Volume:
        """`data` on another grid, with the metadata of this volume; metadata that `grid` lacks come from this volume too."""
        place = {"spacing": grid.spacing, "origin": grid.origin, "direction": grid.direction}
        return self._with(data, **place, units=grid.units or self.units, space=grid.space or self.space)

    def _with(self, data: NDArray[Any], **changes: Any) -> Volume:
        return replace(self, data=data, **changes)

    def _points(self, what: str, points: ArrayLike) -> NDArray[np.float64]:
        array = reals(what, points, f"numbers of shape (..., {self.ndim})")
        if array.ndim == 0 or array.shape[-1] != self.ndim:
            raise OptionError(f"{what} must have shape (..., {self.ndim}); got {array.shape}")
        return array


def array_of(data: NDArray[Any], dtype: Any, copy: bool | None) -> NDArray[Any]:
    """Implementation of ``__array__(dtype, copy)`` for these samples, in NumPy 1 and 2."""
    same = dtype is None or np.dtype(dtype) == data.dtype
    if copy is False and not same:
        raise ValueError(f"{data.dtype} cannot become an array of {np.dtype(dtype)} without a copy")
    return data if same and not copy else np.array(data, dtype)


def as_volume(data: Volume | ArrayLike) -> Volume:
    """`data` itself if it is a `Volume`, else a `Volume` of it."""
    return data if isinstance(data, Volume) else Volume(data)  # type: ignore[arg-type]  # __post_init__ converts


def _places(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Slices of the parts of an array that fit into the CPU cache."""
    row = math.prod(shape[1:])
    if len(shape) > 1 and row > _CACHED:
        for i in range(shape[0]):
            yield from ((slice(i, i + 1), *rest) for rest in _places(shape[1:]))
        return
    step = max(1, _CACHED // row)
    for first in range(0, shape[0], step):
        yield (slice(first, first + step), *(slice(0, n) for n in shape[1:]))


def _parts(data: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Parts of an array, in order, that fit into the CPU cache."""
    return (data[place] for place in _places(data.shape))


def _starts(data: NDArray[Any]) -> Iterator[tuple[int, ...]]:
    """The index of the first sample of each part."""
    return (tuple(along.start for along in place) for place in _places(data.shape))


def _given(value: object) -> bool:
    return value is not None and not (isinstance(value, tuple) and not value)


def _vector(what: str, value: Any, d: int) -> tuple[float, ...]:
    vector = tuple(float(v) for v in reals(what, value, f"{d} numbers", GeometryError).reshape(-1))
    if len(vector) != d:
        raise GeometryError(f"{what} must be {d} numbers, one per axis in the order x, y(, z); got {value!r}")
    if not all(math.isfinite(v) for v in vector):
        raise GeometryError(f"{what} must be finite; got {vector}")
    return vector


def _many_labels(data: NDArray[Any]) -> bool:
    """Whether there are more values than `clvol.noise` accepts as labels, but they fill regions with arbitrary neighbours."""
    shape = data.shape[:-1]
    chosen = np.unravel_index(np.arange(0, math.prod(shape), max(1, data.size >> 20)), shape)
    lines = data[chosen]  # reshape would copy an array that is not in C order
    values, counts = np.unique(lines, return_counts=True)
    if len(values) <= MOST_LABELS:
        return False
    left, right = lines[:, :-1], lines[:, 1:]
    within = (left != (background := values[counts.argmax()])) & (right != background)
    left, right = left[within], right[within]
    if left.size < MOST_LABELS:
        return False
    differ = left != right
    steps = np.abs(left[differ].astype(np.float64) - right[differ])
    return bool(differ.mean() < 1 - _SAME and (not steps.size or np.median(steps) > 1))


def clim_of(name: str, value: Any) -> tuple[float, float]:
    """Two values between which a volume is shown, as floats; `OptionError` where they are none."""
    rule = "two finite numbers, the value shown black below the value shown white"
    ends = reals(name, value, rule)
    if ends.shape != (2,) or not np.isfinite(ends).all() or ends[0] >= ends[1]:
        raise OptionError(f"{name} must be {rule}; got {value!r}")
    return float(ends[0]), float(ends[1])


def _labels(value: Any) -> bool | Mapping[int, str]:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value.values()):
        raise OptionError(f"labels must be True, False, or a mapping from whole numbers to names; got {value!r}")
    return {whole("each label", number): name for number, name in value.items()}


def _whole(what: str, value: Sequence[int], d: int) -> tuple[int, ...]:
    vector = _vector(what, value, d)
    if any(v != int(v) for v in vector):
        raise OptionError(f"{what} must be {d} whole numbers; got {value!r}")
    return tuple(int(v) for v in vector)


def _direction(value: Any, d: int) -> NDArray[np.float64]:
    matrix = reals("direction", value, f"a {d}×{d} matrix of numbers", GeometryError).copy()
    if matrix.size == d * d:
        matrix = matrix.reshape(d, d)  # ITK returns it flat
    if matrix.shape != (d, d):
        raise GeometryError(f"direction must be a {d}×{d} matrix; got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise GeometryError(f"direction must be finite; got {matrix.tolist()}")
    lengths = np.linalg.norm(matrix, axis=0)
    if abs(np.linalg.det(matrix)) < _TINY_DETERMINANT or not np.allclose(lengths, 1, atol=1e-3):
        raise GeometryError(f"direction must have independent unit columns; got {matrix.tolist()}")
    matrix.setflags(write=False)
    return matrix
