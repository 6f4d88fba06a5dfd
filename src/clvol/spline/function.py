"""The interface of a continuous function, with coefficients in memory or in bricks."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from operator import mul
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array, as_output
from clvol.base.checks import warn, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.frames import flipped, in_frame
from clvol.base.rounding import as_kind, in_kind
from clvol.spline.chain import Chain
from clvol.spline.grids import Target, described, grid_for
from clvol.spline.lease import Leased
from clvol.spline.reduce import as_anti_aliasing
from clvol.volume.stored import RENUMBER, names_beyond
from clvol.volume.transform import as_chain

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.grids import Anchor
    from clvol.spline.points import Reals
    from clvol.spline.reduce import AntiAliasing
    from clvol.volume.missing import Missing
    from clvol.volume.transform import Transforms
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Volumes

__all__ = [
    "CLOSED",
    "ContinuousFunction",
    "Frame",
    "Precision",
    "as_points",
    "as_result",
    "fill_value",
    "points_in_world",
    "put",
    "require_no_transform",
    "result_kind",
]

Frame: TypeAlias = Literal["LPS", "RAS"]
Precision: TypeAlias = Literal["single", "double"]

CLOSED = "the field was closed, and its coefficients were released; make a new one"
_SINGLY = 4  # points that are looked at one by one
_CHECKED = 256  # points that are checked for the order of their coordinates


class ContinuousFunction(Leased, ABC):
    """The continuous function of a volume's samples, for a filter and a boundary rule.

    A subclass implements the function at points (`_at`) and on a grid (`_on`). Arguments, frames, output arrays and result types
    are handled here.

    Attributes
    ----------
    filter : Filter
        Its smoothing is settled for the volume.
    boundary : Boundary
    device : Device
    missing : Missing
        How missing samples are treated.
    """

    filter: Filter
    boundary: Boundary
    device: Device
    missing: Missing

    @property
    @abstractmethod
    def grid(self) -> Volume:
        """The volume, or a stand-in with its geometry and no data."""

    @property
    @abstractmethod
    def precision(self) -> Precision:
        """Precision of coefficients and results: "single" or "double"."""

    @property
    @abstractmethod
    def nbytes(self) -> int:
        """Bytes of the coefficients in memory."""

    @abstractmethod
    def _settled(self, filter: str | Filter) -> Filter:
        """A filter with its smoothing settled for the volume."""

    @abstractmethod
    def _at(
        self, points: NDArray[Any], derivative: int, fill: float | None, progress: Progress | None, out: NDArray[Any] | None
    ) -> Reals:
        """N * d**derivative numbers: derivatives at world points (N, d). Kernels may write directly to `out`, of as many."""

    @abstractmethod
    def _on(self, target: Target, progress: Progress | None, out: Any) -> NDArray[Any]:
        """The function on a grid, in `out` if given."""

    @abstractmethod
    def _bytes_at(self, points: int, derivative: int, *, into: bool) -> int:
        """Bytes of the results at `points` points while they are computed, with an `out` (`into`) or without."""

    # -- at points ---------------------------------------------------------------------------------------------------------

    def __call__(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Values at points of the world.

        Parameters
        ----------
        points : array-like, shape (..., d)
            World positions (x, y) or (x, y, z), with one coordinate for each axis of the volume. A Field uses float32 points
            unchanged, and all others as float64 if the device supports it; without it, positions err by up to 2⁻²⁴ of their
            distance from the world's origin and from the first sample. A position that is not finite gives NaN. Points that are
            outside, but inside in the order (z, y, x), cause a `ClvolWarning`.
        frame : {"LPS", "RAS"}
            The frame of points and derivatives, for a volume whose space is "LPS": that of ITK and DICOM, or that of NIfTI and
            nibabel, where x and y have the opposite sign.
        fill : float, optional
            The result outside the volume's domain, which may be NaN or infinite; None: as the boundary rule says.
        progress : callable, optional
            Called with the fraction done, repeatedly, and with 1 after the last point.
        out : array, optional
            Where results are put, instead of into a new array: a writable one of float32 or float64 and of their shape, with any
            strides, of NumPy or of another library (see `clvol.base.arrays.as_output`). Kernels of a Field write directly into
            contiguous ones of the type of the results. It is what is returned.

        Returns
        -------
        ndarray of float32, shape (...)
            float64 in double precision, and if the samples are far from zero, or very large or small: see the notes of `Field`.

        Raises
        ------
        OptionError
            `points` are not real numbers of shape (..., d); `frame` is neither of the two, or "RAS" for a volume that is not of a
            patient; `fill` is not a number; the field is closed; `out` has another shape or dtype, or is not writable (checked
            before anything is computed); the limits of the device name an unknown evaluator.
        DeviceError
            The limits of the device require images that it does not support, or paired fetches from an image whose sampler does
            not interpolate.
        FormatError, DataError
            As `LazyVolume.read` raises them, if samples are read.
        OutOfMemoryError
            The points do not fit on the device.
        """
        return self._derivatives(points, 0, frame, fill, progress, out)

    def gradient(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Gradients at points of the world: the exact derivative of the function.

        It exists almost everywhere: some filters have kinks or jumps. Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32, shape (..., d)
            Derivatives along (x, y[, z]), per world unit; float64 if the samples are very large or small.
        """
        return self._derivatives(points, 1, frame, fill, progress, out)

    def hessian(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Exact second derivatives at points of the world. Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32, shape (..., d, d)
            Symmetric, [x, y[, z]] twice, per world unit squared; float64 if the samples are very large or small.
        """
        return self._derivatives(points, 2, frame, fill, progress, out)

    def _derivatives(
        self, points: ArrayLike, derivative: int, frame: Frame, fill: float | None, progress: Progress | None, out: Any
    ) -> Reals:
        with self.in_use():
            d = self.grid.ndim
            array = as_points(points, frame, self.grid, outside=fill is not None)
            shape = array.shape[:-1] + (d,) * derivative
            target = None if out is None else as_output(out, shape)
            memory.require(self._bytes_at(math.prod(array.shape[:-1]), derivative, into=out is not None), described(shape))
            direct = None if target is None or np.may_share_memory(target, array) else target
            flat = self._at(array.reshape(-1, d), derivative, fill_value(fill), progress, direct)
            results = flat.reshape(shape)
            if frame == "RAS" and derivative:
                signs = flipped(np.ones(d))
                np.multiply(results, signs if derivative == 1 else np.outer(signs, signs), out=results, casting="same_kind")
            return put(results, target, out)

    # -- on other grids ----------------------------------------------------------------------------------------------------

    def resample(
        self,
        shape: Sequence[int] | None = None,
        spacing: Sequence[float] | float | None = None,
        like: Volume | Volumes | ArrayLike | None = None,
        *,
        anchor: Anchor = "center",
        transform: Transforms | None = None,
        anti_aliasing: AntiAliasing | bool = False,
        dtype: DTypeLike | None = None,
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Volume:
        """The function on another grid; give exactly one of `shape`, `spacing` and `like`.

        Larger voxels cause aliasing of finer details, unless `anti_aliasing` is given.

        Parameters
        ----------
        shape : sequence of int, optional
            Samples along (z, y, x) or (y, x). The domain is unchanged; its voxels become larger or smaller.
        spacing : float or sequence of float, optional
            New spacing along (x, y[, z]) in world units. The domain keeps its centre, and its size to within half a voxel.
        like : Volume, Volumes, or anything that these accept, optional
            Use the grid of this volume or image, which may be anywhere in the world; of a series, the grid of its volumes.
        anchor : {"center", "origin"}
            The fixed point with `shape` and `spacing`: the centre of the domain, or the first sample, as in programs that keep
            ITK's origin; the domain then moves by half the difference of the spacings.
        transform : transform, array, SimpleITK transform, or a list of these, optional
            From points of the grid's world (fixed) to points of this volume's world (moving), where the function is evaluated, as
            in ITK. The last of a list is applied first, as in ITK's CompositeTransform. An array is a homogeneous matrix. See
            `clvol.AffineTransform`, `clvol.DisplacementField`, `clvol.BSplineTransform` and `clvol.read_transform`; `clvol.warp`
            also returns gradients and Jacobians.
        anti_aliasing : {False, True, "gaussian", "least-squares"}
            "gaussian" (or True): the samples are smoothed first by a Gaussian, with a standard deviation of (f - 1) / 2 samples
            along an axis where voxels become f times as large. "least-squares": the result is the spline of the new grid, with the
            same filter, that is nearest to this function in the mean square (`clvol.spline.reduce`), for grids along the volume's
            axes.
        dtype : dtype-like or "same", optional
            Type of the result, or "same" for the volume's: integers are rounded to nearest, halves to even, and clipped to the
            type's range. Default: floating point as in a call, but the volume's type for labels with "nearest".
        fill, progress
            As in a call.
        out : array, optional
            As in a call, of the new grid's shape; the result's data are a view of it. A `BrickedField` accepts anything that is
            writable by slices, such as a Zarr array, for results larger than memory: the returned volume then has the geometry,
            and only `out` has the data.

        Returns
        -------
        Volume of float32, or of float64 as in a call, or of `dtype`

        Raises
        ------
        OptionError
            None or several of `shape`, `spacing` and `like` are given; `shape` is not one whole number of at least 1 for
            each axis; `spacing` is not positive and finite, or needs more than 2³¹ − 1 samples along an axis; `like` is
            not a Volume with the same number of axes; `anchor` is neither of the two, or "origin" with `like`; `dtype` is not a
            real type, is given with `out`, or cannot hold a `fill` of NaN; `transform` is invalid, or given with `anti_aliasing`;
            `anti_aliasing` is none of these, or "least-squares" for a rotated grid, with a hybrid or with the boundary rule
            "zero"; `fill` as in a call; the field is closed.
        DataError
            Results are NaN where samples are missing, and `dtype` cannot hold NaN; or labels, with "nearest", exceed 2⁵³.
        GeometryError
            A transform is singular, or has another number of dimensions.
        FormatError, DeviceError
            As in a call.
        OutOfMemoryError
            The result does not fit on the device.
        """
        volume = self.grid
        grid = grid_for(volume, shape, spacing, like, anchor)
        low_pass, stages = as_anti_aliasing(anti_aliasing), as_chain(transform, volume.ndim)
        kind = result_kind(dtype, volume, self.filter, out, fill)
        if low_pass:
            require_no_transform(stages)
        with self.in_use():
            chain = Chain(stages, grid, self.device)
            matrix, offset = chain.to_indices(volume)
            target = Target(matrix, offset, grid.shape, chain if chain.stages else None, fill_value(fill), low_pass, kind)
            return as_result(volume, self._on(target, progress, out), grid, kind, self.filter)

    def magnify(self, factor: int = 2, *, progress: Progress | None = None) -> Volume:
        """The volume with `factor` times the samples along each axis, the original samples among them (section 4.3).

        Sample ``j`` of the result is at ``j / factor`` in original samples, so every `factor`-th sample is an original one. The
        last samples are past the last original one, within its voxel or outside, where the boundary rule applies.

        Parameters
        ----------
        factor : int
            At least 1.
        progress
            As in a call.

        Returns
        -------
        Volume of float32, or of float64 as in a call; labels with "nearest" keep their type

        Raises
        ------
        OptionError
            `factor` is not a whole number of at least 1; the field is closed.
        FormatError, DataError, DeviceError
            As in a call.
        OutOfMemoryError
            The result does not fit on the device.
        """
        volume, factor = self.grid, whole("factor", factor, minimum=1)
        shape = tuple(factor * n for n in volume.shape)
        memory.require_addressable("a result", shape)
        kind = result_kind(None, volume, self.filter, None, None)
        finer = replace(
            volume, data=np.broadcast_to(np.float32(0), shape), spacing=tuple(s / factor for s in volume.spacing), labels=False
        )
        # by indices, not world positions, whose rounding could move samples to the other side of a jump
        target = Target(np.eye(volume.ndim) / factor, np.zeros(volume.ndim), shape, kind=kind)
        with self.in_use():
            return as_result(volume, self._on(target, progress, None), finer, kind, self.filter)


def as_result(volume: Volume, data: NDArray[Any], grid: Volume, kind: np.dtype[Any] | None, row: Filter) -> Volume:
    """Results on a grid, converted to `kind`, with the volume's metadata; interpolated labels are no longer labels."""
    made = volume.placed(data if kind is None else in_kind(data, kind), grid)
    blended = row.support > 1 and volume.labels not in (None, False)
    return replace(made, labels=None) if blended else made


# -- arguments -------------------------------------------------------------------------------------------------------------


def as_points(points: ArrayLike, frame: Frame, volume: Volume, *, outside: bool = False) -> NDArray[np.generic]:
    """Points of a frame in a volume's world, of any type; warns if their coordinates seem to be in reversed order.

    `outside`: some are expected to lie outside the volume.
    """
    array = points_in_world(points, frame, volume)
    _warn_if_reversed(array.reshape(-1, volume.ndim), volume, 0.999 if outside else 0.5)
    return array


def points_in_world(points: ArrayLike, frame: Frame, volume: Volume) -> NDArray[np.generic]:
    """Points (..., d) of a frame in a volume's world, of any type; LPS points are not converted."""
    d = volume.ndim
    array = as_array(points, "points", OptionError, f"numbers of shape (..., {d})")
    if array.dtype.kind not in "biuf" or array.ndim == 0 or array.shape[-1] != d:
        raise OptionError(f"points must be numbers of shape (..., {d}); got {array.dtype} of shape {array.shape}")
    return array if frame == "LPS" else in_frame(np.asarray(array, np.float64), frame, volume.space)


def _warn_if_reversed(points: NDArray[np.generic], volume: Volume, share: float) -> None:
    """Warn if more than this share of points lie outside the volume that are inside with their coordinates reversed."""
    if len(points) <= _SINGLY and _are_inside(points.tolist(), volume):
        return
    some = np.asarray(points[:: max(1, len(points) // _CHECKED)], np.float64)
    low, high = -0.5, np.asarray(volume.size) - 0.5

    def within(at: NDArray[np.float64]) -> NDArray[np.bool_]:
        with np.errstate(over="ignore", invalid="ignore"):  # positions may be infinite
            index = (at - volume.origin) @ volume.world_to_index_matrix.T
        return (index >= low) & (index <= high)

    if (found := within(some)).all() or not np.isfinite(some).all():
        return
    outside = ~found.all(-1)
    if np.count_nonzero(outside) > share * len(some) and within(some[outside][:, ::-1]).all():
        names = "(x, y)" if volume.ndim == 2 else "(x, y, z)"
        low, high = (end.round(3).tolist() for end in (volume.corners.min(0), volume.corners.max(0)))
        warn(
            f"points are {names} in world units; most of these lie outside the volume, which reaches from {low} to {high}, "
            f"such as {some[outside][0].tolist()}; reversed, all lie in it"
        )


def _are_inside(points: list[list[float]], volume: Volume) -> bool:
    """Whether points lie in the volume's domain, sooner than NumPy finds out of a few."""
    rows, origin, size = volume.world_to_index_matrix.tolist(), volume.origin, volume.size
    for point in points:
        at = [x - first for x, first in zip(point, origin, strict=True)]
        for row, n in zip(rows, size, strict=True):
            if not -0.5 <= sum(map(mul, row, at)) <= n - 0.5:
                return False
    return True


def fill_value(fill: float | None) -> float | None:
    """A real number, possibly NaN or infinite, or None."""
    if fill is not None and (isinstance(fill, (bool, str)) or not isinstance(fill, (int, float, np.number))):
        raise OptionError(f"fill must be a number or None; got {fill!r}")
    return None if fill is None else float(fill)


def result_kind(dtype: DTypeLike | None, volume: Volume, row: Filter, out: Any, fill: float | None) -> np.dtype[Any] | None:
    """The type that results are converted to; None: the type in which they are computed."""
    fill = fill_value(fill)
    if names_beyond(53, volume, row):  # float64 would round them to other labels
        low, high = volume.limits
        raise DataError(
            f"labels must be whole numbers up to 2**53 to be resampled, which float64 holds; got {low} to {high}: {RENUMBER}"
        )
    if dtype is None:
        labels = row.support == 1 and volume.is_labels
        return volume.data.dtype if labels and out is None and (fill is None or not np.isnan(fill)) else None
    if out is not None:
        raise OptionError(f"resample takes dtype or out, whose type is that of the results; got {dtype!r} and out")
    kind = as_kind(dtype, volume.data.dtype)
    if fill is not None and kind.kind != "f" and np.isnan(fill):
        raise OptionError(f"fill must be a number that {kind} holds; got {fill!r}")
    return kind


def require_no_transform(stages: Sequence[object]) -> None:
    """Refuse a low-pass with transforms, which scale voxels differently at different points."""
    if stages:
        raise OptionError("resample takes transform or anti_aliasing, not both: low-pass the volume first, by Volume.gaussian")


def put(results: Reals, target: NDArray[Any] | None, out: Any) -> Reals:
    """Copy results into `target`, a view of `out`, unless they are already there; returns `out`, or the results without one."""
    if target is None:
        return results
    if not np.may_share_memory(results, target):
        target[...] = results
    return out  # type: ignore[no-any-return]  # whatever the caller gave
