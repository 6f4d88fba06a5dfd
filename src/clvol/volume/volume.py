"""A volume (or image): samples on a regular grid, and the placement of that grid in the world."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import number, one_of, suggests_options, whole
from clvol.base.color import color_of
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.base.frames import SPACES
from clvol.interop.images import read_array
from clvol.interop.itk import to_simpleitk
from clvol.interop.nibabel import to_nibabel
from clvol.interop.xarray_images import to_xarray
from clvol.noise import Noise, estimate
from clvol.volume.gridded import Gridded
from clvol.volume.label_table import LabelRow, LabelTable
from clvol.volume.missing import Missing, filled_smoothly
from clvol.volume.samples import (
    array_of,
    beyond_float32,
    filled_with,
    fills_regions,
    has_many_labels,
    indicator_of,
    lent,
    limits_of,
    range_of,
    require_finite,
)

__all__ = ["Volume", "as_volume", "clim_of", "labels_of", "masked", "table_of"]

_ABOUT = ("spacing", "origin", "direction", "units", "space", "name", "color", "clim", "labels", "header")
_TINY_DETERMINANT = 1e-12


@suggests_options
@dataclass(frozen=True, eq=False)
class Volume(Gridded):
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
        must be evenly spaced; dimensions named as axes (x or lon, ...) may have any order. Arrays of Zarr and dask are read whole,
        if there is memory for them, and say nothing of geometry: that of OME-Zarr stands with its group, `clvol.read`.
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
    labels : bool or mapping of int to str or (name, color, opacity), optional
        Whether samples are labels, which are never blended, or a row per label: its name, or also its colour and opacity
        (`clvol.labels.LabelTable`, as which it is kept). None: detect it (`is_labels`).
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
        mapping from whole numbers to such rows, `header` no mapping.

    Notes
    -----
    A volume may contain NaN and infinite samples, but they enter no computation: the spline
    prefilter is recursive, so that one NaN would spoil all coefficients. In pictures they are transparent. Sampling
    and prefiltering raise `DataError` with the index of the first one; `filled` replaces them, and sampling
    can leave out the results that they affect (`Missing`).

    Examples
    --------
    >>> import clvol, numpy as np
    >>> volume = clvol.Volume(np.zeros((20, 30, 40), np.uint8), spacing=(0.5, 0.5, 2))  # samples (z, y, x), spacing (x, y, z)
    >>> volume.shape, volume.spacing
    ((20, 30, 40), (0.5, 0.5, 2.0))
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
    labels: bool | Mapping[int, LabelRow] | None = None
    header: Mapping[str, Any] = field(default_factory=dict, repr=False)

    # shared with LazyVolume; here all samples are in memory, at one level
    levels: ClassVar[tuple[()]] = ()
    bounds: ClassVar[None] = None
    estimated: ClassVar[bool] = False
    in_memory: ClassVar[bool] = True

    def __post_init__(self) -> None:
        data, known = read_array(self.data)
        d = _require_grid(data)
        known = {"spacing": (1.0,) * d, "origin": (0.0,) * d, "direction": np.eye(d)} | known
        about = {name: own if _given(own := getattr(self, name)) else known.get(name, own) for name in _ABOUT}
        data = data.view()
        data.flags.writeable = False
        for name, value in {"data": data, **_checked(about, d)}.items():
            object.__setattr__(self, name, value)

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
        from clvol.show.thumbnail import html_of_volume  # its import takes time

        return html_of_volume(self)

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
        return lent(self.data, {"stream": stream, "max_version": max_version, "dl_device": dl_device, "copy": copy})

    def __dlpack_device__(self) -> tuple[Any, int]:
        """Host memory."""
        return self.data.__dlpack_device__()

    def to_sitk(self) -> Any:
        """A SimpleITK image with a copy of the samples, in mm (``pip install "clvol[medical]"``).

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

        Its samples are [x, y, z], a view of the volume's (``pip install "clvol[medical]"``).

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
        is one. ``Volume(array)`` comes back, also of a part with coordinates (``pip install "clvol[xarray]"``).

        Raises
        ------
        MissingDependencyError
            xarray is not installed.
        """
        return to_xarray(self.data, self)

    @property
    def shape(self) -> tuple[int, ...]:
        """Samples along each axis, in array order: (nz, ny, nx) or (ny, nx)."""
        return self.data.shape

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
        return limits_of(self.data)

    @cached_property
    def value_range(self) -> tuple[float, float]:
        """Smallest and largest finite sample.

        Raises
        ------
        DataError
            No sample is finite.
        """
        return range_of(self.data, self.limits)

    def require_finite(self) -> None:
        """Raise `DataError` if a sample is NaN, infinite, or too large for float64."""
        if self.data.dtype.kind == "f":
            require_finite(self.data, self.limits)

    def filled(self, value: float | None = None) -> Volume:
        """A copy with NaN and infinite samples replaced by `value`; by default by the smooth fill of `Missing`."""
        if value is not None:
            number("value", value)
        if self.data.dtype.kind != "f":
            return self
        if value is not None:
            return self._with(filled_with(self.data, value))
        where = Missing("local").of(self.data)
        return self if where is None else self._with(filled_smoothly(self.data, where))

    @cached_property
    def is_labels(self) -> bool:
        """Whether samples are labels of regions: `labels` if set, else whether they are few integers that fill regions.

        Labels are never blended: by default the nearest sample is used. Masks with two values do not count as labels
        unless `labels` is set, because their edge is a surface that may be smoothed.
        """
        if self.labels is not None:
            return self.labels is not False
        return fills_regions(self.data) and (self.noise.kind == "labels" or has_many_labels(self.data))

    @cached_property
    def noise(self) -> Noise:
        """The estimated noise of the samples that are finite, from at most about a million of them; see `clvol.noise.estimate`."""
        return _noise_of(self)

    def indicator(self, *labels: float) -> Volume:
        """Indicator of a region of labels: 1 where a sample has one of these values, else 0, in float32. Its surface is at 1/2."""
        if not labels:
            raise OptionError("indicator needs at least one value; got none")
        for label in labels:
            number("each value of indicator", label)
        memory.require(4 * self.data.size, f"a region of {self.data.size} samples")
        return self._with(indicator_of(self.data, labels), labels=None, clim=None)

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
        return self._with(_low_passed(self, sigma), labels=None)

    def downsample(self, n: int) -> Volume:
        """Every `n`-th sample along each axis, from the first; low-pass with `gaussian` first."""
        n = whole("n", n, 1)
        return self._with(self.data[(slice(None, None, n),) * self.ndim], spacing=tuple(s * n for s in self.spacing))

    def placed(self, data: NDArray[Any], grid: Volume) -> Volume:
        """`data` on another grid, with the metadata of this volume; metadata that `grid` lacks come from this volume too."""
        place = {"spacing": grid.spacing, "origin": grid.origin, "direction": grid.direction}
        return self._with(data, **place, units=grid.units or self.units, space=grid.space or self.space)

    def _with(self, data: NDArray[Any], **changes: Any) -> Volume:
        return replace(self, data=data, **changes)


def table_of(volume: Volume) -> LabelTable:
    """The table of a volume's labels; without rows if it has none."""
    return volume.labels if isinstance(volume.labels, LabelTable) else LabelTable({})


def as_volume(data: Volume | ArrayLike) -> Volume:
    """`data` itself if it is a `Volume`, else a `Volume` of it."""
    return data if isinstance(data, Volume) else Volume(data)  # type: ignore[arg-type]  # __post_init__ converts


def masked(volume: Volume, mask: ArrayLike) -> Volume:
    """A copy with NaN where a mask is True; integers become float32, or float64 where some exceed 2²⁴, and labels stay labels.

    `DataError` if the mask is not boolean, or of another shape.
    """
    data, where = volume.data, Missing("propagate", mask).of(volume.data)
    floating = data.dtype.kind == "f"
    if where is None or (floating and not np.isfinite(data[where]).any()):
        return volume
    kind = data.dtype if floating else np.dtype(np.float64 if beyond_float32(data, volume.limits) else np.float32)
    memory.require(kind.itemsize * data.size, f"a copy of {data.size} samples")
    copy = data.astype(kind)
    copy[where] = np.nan
    return replace(volume, data=copy, labels=volume.labels if volume.labels is not None or not volume.is_labels else True)


def _noise_of(volume: Volume) -> Noise:
    """The noise of the samples that are finite."""
    try:
        return estimate(volume.data)
    except DataError:  # of those looked at, some are not
        where = Missing("local").of(volume.data)
        if where is None or where.all():
            raise
        return estimate(filled_smoothly(volume.data, where, roughly=True), where)


def _low_passed(volume: Volume, sigma: float | Sequence[float]) -> NDArray[Any]:
    from scipy import ndimage

    data = volume.data
    one = np.isscalar(sigma) or (isinstance(sigma, np.ndarray) and sigma.ndim == 0)
    widths = _vector("sigma", [sigma] * volume.ndim if one else sigma, volume.ndim)
    if min(widths) < 0:
        raise OptionError(f"sigma must not be negative; got {sigma!r}")
    memory.require(4 * 2 * data.size, f"the low-pass of {data.size} samples")  # before the samples are read
    volume.require_finite()
    voxels = [w / s for w, s in zip(widths, volume.spacing, strict=True)][::-1]
    wide = data.dtype.itemsize > 4 if data.dtype.kind == "f" else beyond_float32(data, volume.limits)
    kind = np.float64 if wide else np.float32
    memory.require(2 * np.dtype(kind).itemsize * data.size, f"the low-pass of {data.size} samples")
    return np.asarray(ndimage.gaussian_filter(data.astype(kind), voxels, mode="mirror"))


def _require_grid(data: NDArray[Any]) -> int:
    """The number of axes of samples; `DataError` if they cannot be a volume's."""
    if data.ndim not in (2, 3):
        several = ": take one of several volumes as clvol.Volumes(data)[k]" if data.ndim > 3 else ""
        raise DataError(f"data must have 2 axes [y, x] or 3 axes [z, y, x]; got shape {data.shape}{several}")
    if 0 in data.shape:
        raise DataError(f"every axis of data must hold at least one sample; got shape {data.shape}")
    if data.dtype.kind not in "biuf":
        raise DataError(f"data must be boolean, integer or floating; got dtype {data.dtype}")
    return data.ndim


def _given(value: object) -> bool:
    return value is not None and not (isinstance(value, (tuple, str, Mapping)) and not value)


def _checked(about: Mapping[str, Any], d: int) -> dict[str, Any]:
    """The arguments of `Volume` but its samples, as it keeps them."""
    spacing, origin = _vector("spacing", about["spacing"], d), _vector("origin", about["origin"], d)
    direction = _direction(about["direction"], d)
    for name in ("units", "name"):
        if not isinstance(about[name], str):
            raise OptionError(f"{name} must be a string; got {about[name]!r}")
    space, color, clim, labels, header = (about[name] for name in ("space", "color", "clim", "labels", "header"))
    if not isinstance(space, str) or space not in SPACES:
        raise one_of("space", space, map(repr, SPACES))
    color = None if color is None else color_of("color", color)
    clim = None if clim is None else clim_of("clim", clim)
    labels = None if labels is None else labels_of(labels)
    if not isinstance(header, Mapping):
        raise OptionError(f"header must be a mapping; got {header!r}")
    if min(spacing) <= 0:
        raise GeometryError(f"spacing must be positive along every axis; got {spacing}")
    place = {"spacing": spacing, "origin": origin, "direction": direction}
    return {**about, **place, "color": color, "clim": clim, "labels": labels, "header": dict(header)}


def _vector(what: str, value: Any, d: int) -> tuple[float, ...]:
    vector = tuple(float(v) for v in reals(what, value, f"{d} numbers", GeometryError).reshape(-1))
    if len(vector) != d:
        raise GeometryError(f"{what} must be {d} numbers, one per axis in the order x, y(, z); got {value!r}")
    if not all(math.isfinite(v) for v in vector):
        raise GeometryError(f"{what} must be finite; got {vector}")
    return vector


def clim_of(name: str, value: Any) -> tuple[float, float]:
    """Two values between which a volume is shown, as floats; `OptionError` where they are none."""
    rule = "two finite numbers, the value shown black below the value shown white"
    ends = reals(name, value, rule)
    if ends.shape != (2,) or not np.isfinite(ends).all() or ends[0] >= ends[1]:
        raise OptionError(f"{name} must be {rule}; got {value!r}")
    return float(ends[0]), float(ends[1])


def labels_of(value: Any) -> bool | LabelTable:
    """Whether samples are labels, or the table of these, of what `Volume` takes for it; `OptionError` where it takes none."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if not isinstance(value, Mapping):
        raise OptionError(f"labels must be True, False, or a mapping from whole numbers to names; got {value!r}")
    return value if isinstance(value, LabelTable) else LabelTable(value)


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
