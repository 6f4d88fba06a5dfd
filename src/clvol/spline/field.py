"""The continuous function of a volume: values, derivatives and other grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.checks import whole
from clvol.device import Device, as_device
from clvol.errors import DataError, OptionError
from clvol.filter import DEFAULT_FILTER, Filter, as_filter
from clvol.interop import read_array
from clvol.program import LANES
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import EvaluatorName, FetchName, choose_evaluator
from clvol.spline.points import sample_coefficients
from clvol.spline.prefilter import _prefilter
from clvol.spline.resample import _run_lattice
from clvol.volume import Volume, as_volume

__all__ = ["Floats", "Progress", "magnify", "prefilter", "resample", "sample"]

Floats = NDArray[np.float32]
Progress = Callable[[float], None]
_CHANNELS = 4  # of an image in colour, at most


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


def _fill_value(fill: float | None) -> float | None:
    """A real number, NaN and infinite ones included, or None."""
    if fill is not None and (isinstance(fill, (bool, str)) or not isinstance(fill, (int, float, np.number))):
        raise OptionError(f"fill must be a number or None; got {fill!r}")
    return None if fill is None else float(fill)


def sample(
    volume: Volume | ArrayLike,
    points: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    derivative: int = 0,
    *,
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
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
    path = choose_evaluator(on, row, evaluator, fetch)
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
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
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
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
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
    path = choose_evaluator(on, row, evaluator, fetch)
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
