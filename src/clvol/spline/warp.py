"""Resampling through a chain of transforms, for registration: values, gradients and Jacobians together, and series of frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clvol.base import memory
from clvol.base.checks import instance, one_of, several, suggests_options, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.progress import part_of
from clvol.device import as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY
from clvol.filter.table import DEFAULT_FILTER
from clvol.spline.chain import Chain
from clvol.spline.evaluator import DIRECT
from clvol.spline.field import Field, opened, resample
from clvol.spline.function import fill_value
from clvol.spline.points import NOTHING_GIVEN, Given, Transform, sample_grid
from clvol.spline.resample import resample_coefficients
from clvol.volume.smoothing import filter_for
from clvol.volume.transform import as_chain
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Volumes, as_grid

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.field import Precision
    from clvol.spline.points import Reals
    from clvol.volume.missing import Missing
    from clvol.volume.transform import Transforms

__all__ = ["Warped", "resample_series", "warp"]


class Warped(NamedTuple):
    """The result of `warp`: an image in the space of another.

    Attributes
    ----------
    values : Volume
        The moving image on the grid of the fixed one.
    gradient : ndarray, shape (nz, ny, nx, 3) or (ny, nx, 2), or None
        Gradient of the moving image at the mapped points, per world unit.
    jacobian : Volume or None
        Determinants of the derivative of the mapped points with respect to the points.
    """

    values: Volume
    gradient: Reals | None
    jacobian: Volume | None


@suggests_options
def warp(
    volume: Volume | ArrayLike | Field,
    like: Volume | Volumes | ArrayLike,
    transform: Transforms | None = None,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    derivative: int = 0,
    wrt: str = "moving",
    jacobian: bool = False,
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
) -> Warped:
    """A moving image in the space of a fixed one, its gradient there, and the Jacobian of the transform.

    With T the chain of transforms, x the points of `like` and f the moving image's function: the values are f(T(x)), the
    gradient is ∇f at T(x), and the Jacobian is det ∂T/∂x. All are exact derivatives of the function that is evaluated, by the
    product of the stages' derivatives.

    Parameters
    ----------
    volume : Volume, array-like or Field
        The moving image; make a `Field` to warp it repeatedly.
    like : Volume
        The grid of the fixed image.
    transform
        As in `Field.resample`: from the fixed world to the moving one; the last of a list is applied first.
    filter, boundary, device, precision, nan
        As in `clvol.sample`.
    derivative : {0, 1}
        1: also return the gradient.
    wrt : {"moving", "fixed"}
        The world of the gradient. "moving": ∇f at T(x), which the chain rule multiplies by the derivative of T with respect to
        its parameters. "fixed": the gradient of f(T(x)) with respect to x, (∂T/∂x)ᵀ ∇f.
    jacobian : bool
        Whether to return determinants.
    fill, progress
        As in a call of `Field`. Where values are filled, gradients are 0.

    Returns
    -------
    Warped
        ``values, gradient, jacobian``; None for what was not requested.

    Raises
    ------
    OptionError
        `derivative`, `wrt`, `jacobian` or `transform` is invalid, or as `Field.resample` raises it.
    GeometryError
        A transform is singular, or has another number of dimensions.
    DataError, DeviceError, OutOfMemoryError
        As `Field` and `Field.resample` raise them.

    Examples
    --------
    >>> import clvol
    >>> moving, shift = clvol.phantoms.sphere(16), clvol.AffineTransform([[1, 0, 0], [0, 1, 0], [0, 0, 1]], (0.1, 0, 0))
    >>> clvol.warp(moving, moving, shift, jacobian=True).values.shape
    (16, 16, 16)
    """
    derivative = whole("derivative", derivative, minimum=0, maximum=1)
    if wrt not in ("moving", "fixed"):
        raise one_of("wrt", wrt, ("moving", "fixed"))
    instance("jacobian", jacobian, bool, np.bool_)
    fill = fill_value(fill)
    volume = volume if isinstance(volume, Field) else as_volume(volume)
    moving = volume.volume if isinstance(volume, Field) else volume
    like = as_grid(like)
    if like.ndim != moving.ndim:
        raise OptionError(f"like must have {moving.ndim} axes, as the volume has; got {like!r}")
    transforms = as_chain(transform, moving.ndim)
    steps = _steps(progress, 1 + derivative * (wrt == "fixed") + int(jacobian))
    gradient, determinants = None, None
    room = (*like.shape, 1 + 2 * derivative * like.ndim + int(jacobian))
    with opened(volume, filter, boundary, device, precision, nan, results=room) as field, field.in_use():
        assert isinstance(field, Field)  # of a volume in memory
        chain, made, given = Chain(transforms, like, field.device), field.coefficients, Given(fill)
        results = _on_chain(field, chain, derivative, given, next(steps))
        if field.gaps:
            share = _on_chain(field.gaps, chain, 0, Given(None if fill is None else 0.0), None)[..., 0]
            results[share > field.missing.most] = np.nan
        values = given.in_units_of_data(made, results[..., 0], 0)
        if derivative:
            if wrt == "fixed":
                chain.pull_back(results, next(steps))
            gradient = NOTHING_GIVEN.in_units_of_data(made, results[..., 1:], 1)
        if jacobian:
            determinants = chain.determinants(made.kind, next(steps))
    place = (like.spacing, like.origin, like.direction)
    return Warped(
        moving.placed(np.ascontiguousarray(values), like),
        gradient,
        None if determinants is None else Volume(determinants, *place, like.units or moving.units),
    )


def _on_chain(field: Field, chain: Chain, derivative: int, given: Given, progress: Progress | None) -> Reals:
    """Values at the mapped points of a chain's grid, each followed by its gradient with `derivative` 1, in stored units."""
    device, made, grid = field.device, field.coefficients, chain.grid
    matrix, offset = chain.to_indices(field.volume)
    shape = (*grid.shape, 1 + derivative * grid.ndim)
    device.buffers.require_room(np.dtype(made.kind).itemsize * math.prod(shape), held=True)
    memory.require(np.dtype(made.kind).itemsize * (math.prod(shape) + math.prod(grid.shape)), f"a result of {shape} numbers")
    result = np.empty(shape, made.kind)
    last, slices = Transform(matrix, offset, field.volume.world_to_index_matrix), (1, *grid.shape)[-3:]
    with device.buffers.lent(result, write=True) as buffer:
        if derivative or chain.stages:
            sample_grid(made, DIRECT, last, slices, buffer, given, progress, None, derivative, chain)
        else:
            resample_coefficients(made, DIRECT, matrix, offset, slices, buffer, given, progress)
    return result


def _steps(progress: Progress | None, count: int) -> Iterator[Progress | None]:
    """A callback for each of `count` equal parts of the work."""
    return (part_of(progress, done / count, (done + 1) / count) for done in range(count))


@suggests_options
def resample_series(
    series: ArrayLike | Volumes | Sequence[Volume],
    transforms: Sequence[Transforms | None],
    like: Volume | Volumes | ArrayLike | None = None,
    filter: str | Filter | None = None,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision = "single",
    nan: str | Missing = "error",
    progress: Progress | None = None,
) -> Reals:
    """The frames of a series, each through its transform, on one grid: motion correction in one interpolation.

    Works frame by frame, with one frame on the device at a time; it can be interrupted between frames.

    Parameters
    ----------
    series : array-like, shape (t, nz, ny, nx) or (t, ny, nx), Volumes, or sequence of Volume
        The moving frames.
    transforms : sequence
        One for each frame, as `transform` of `Field.resample`; None is the identity.
    like : Volume, optional
        The grid of the results; default: the first frame's.
    filter, boundary, fill, device, precision, nan
        As in `clvol.resample`.
    spacing, origin, direction : optional
        Geometry of the frames of an array, as for `Volume`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of float32, shape (t, nz, ny, nx) or (t, ny, nx)
        float64 in double precision, or if a frame's results are float64; see the notes of `Field`.

    Raises
    ------
    DataError
        `series` has no frames, an invalid frame, or a value that is not finite.
    OptionError
        There is not one transform for each frame; a geometry is given for Volumes, which already have one; or as
        `Field.resample` raises it.
    GeometryError, DeviceError, OutOfMemoryError
        As `Field.resample` raises them.

    Examples
    --------
    >>> still = clvol.resample_series(bold, motion, spacing=(2, 2, 2))   # (t, z, y, x), one transform a frame
    """
    geometry: dict[str, Any] = {"spacing": spacing, "origin": origin, "direction": direction}
    given = {name: value for name, value in geometry.items() if value is not None}
    if isinstance(series, Volumes) or (isinstance(series, (list, tuple)) and any(isinstance(frame, Volume) for frame in series)):
        if given:
            raise OptionError(f"frames that are Volumes have a geometry; got {', '.join(given)} too")
        frames = [as_volume(frame) for frame in series]
    else:
        data = np.asarray(series)
        if data.ndim not in (3, 4):
            raise DataError(f"a series must have shape (t, nz, ny, nx) or (t, ny, nx); got {data.shape}")
        frames = [Volume(frame, **given) for frame in data]
    if not frames:
        raise DataError("a series must hold at least one frame; got none")
    entries = several("transforms", transforms, "a transform, or None, for each frame")
    if len(entries) != len(frames):
        raise OptionError(f"transforms must be as many as there are frames, {len(frames)}; got {len(entries)}")
    grid = frames[0] if like is None else as_grid(like)
    chains = [as_chain(entry, frame.ndim) for entry, frame in zip(entries, frames, strict=True)]
    chosen, row = as_device(device), filter_for(frames[0], filter, DEFAULT_FILTER)
    steps = _steps(progress, len(frames))
    result: Reals | None = None
    for n, (frame, chain) in enumerate(zip(frames, chains, strict=True)):
        made = resample(
            frame,
            like=grid,
            filter=row,
            boundary=boundary,
            transform=chain,
            fill=fill,
            device=chosen,
            precision=precision,
            nan=nan,
            progress=next(steps),
        )
        if result is None:
            shape = len(frames), *grid.shape
            memory.require(made.data.itemsize * math.prod(shape), f"a series of {shape} samples")
            result = np.empty(shape, made.data.dtype)
        if (kind := np.result_type(made.data.dtype, result.dtype)) != result.dtype:
            wider = np.empty(result.shape, kind)
            wider[:n] = result[:n]  # the rest is uninitialized: some bit patterns do not convert
            result = wider
        result[n] = made.data
    assert result is not None  # there is a frame
    return result
