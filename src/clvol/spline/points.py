"""The function at points and on grids of points: the host side of points.cl."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.device import Device
from clvol.program import LANES, Program
from clvol.spline.build import point_defines
from clvol.spline.chain import Chain, Progress
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import DIRECT, Evaluator
from clvol.spline.sort import Sorter, scattered
from clvol.stored import Reals, Stored

__all__ = ["Floats", "Progress", "Reals", "in_units_of_data", "kernel_fill", "sample_coefficients", "sample_grid"]

Floats: TypeAlias = NDArray[np.float32]

_RUN = 512  # points that a work-item of a processor takes, a multiple of LANES
_MIN_LAUNCH = 1 << 10  # points


def sample_coefficients(
    coefficients: Coefficients,
    evaluator: Evaluator,
    points: NDArray[Any],
    derivative: int = 0,
    fill: float | None = None,
    progress: Progress | None = None,
) -> Reals:
    """The function or its derivatives at world positions.

    Parameters
    ----------
    coefficients : Coefficients
        Of the function.
    evaluator : Evaluator
        How it is evaluated. Second derivatives always take direct taps.
    points : ndarray, shape (N, d)
        World positions (x, y[, z]). Those of float32 are computed with as they are, all others as float64 where the
        device has it.
    derivative : {0, 1, 2}
        0 for values, 1 for gradients, 2 for Hessians.
    fill : float, optional
        The result outside the domain; None: the boundary rule goes on.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of float32 or float64, shape (N,), (N, d) or (N, d * d)
        In units of the data, per world unit; float64 where it differs from what is stored.
    """
    device, volume, d = coefficients.device, coefficients.volume, coefficients.volume.ndim
    kind = np.float64 if device.has_double and points.dtype != np.float32 else np.float32
    lanes = _in_lanes(coefficients, evaluator, derivative)
    sorting = lanes and (device.limits.sorting if device.limits.sorting is not None else scattered(coefficients, points))
    sorter = Sorter(coefficients, kind, points.shape[0]) if sorting else None
    built = _build(coefficients, evaluator, derivative, fill, kind, on_grid=False, sorted=sorting)
    inverse = volume.world_to_index_matrix
    transform = _transform(device, inverse, -inverse @ np.asarray(volume.origin), inverse)
    results = np.empty((points.shape[0], d**derivative), np.float32)
    kernel = built.kernel("sample_points")
    source = coefficients.argument(evaluator)
    launch = _launch_points(coefficients, evaluator)
    step = launch if sorter is None else sorter.room
    for first in range(0, points.shape[0], step):
        part = np.ascontiguousarray(points[first : first + step], dtype=kind)
        target = results[first : first + step]
        count = target.shape[0]
        with device.lent(part, write=False) as given, device.lent(target, write=True) as wanted, device.errors:
            ready = given if sorter is None else sorter.sort(given, count, transform)
            for begin in range(0, count, launch):
                some = min(launch, count - begin)
                kernel(
                    device.queue,
                    (-(-some // _RUN),) if lanes else (-(-some // 64) * 64,),
                    (1,) if lanes else (64,),
                    source,
                    coefficients.extent,
                    coefficients.size,
                    coefficients.period,
                    transform,
                    ready,
                    np.uint64(begin + some),
                    kernel_fill(coefficients.stored, derivative, fill),
                    wanted,
                    global_offset=(begin // _RUN if lanes else begin,),
                )
                device.finish()
                if progress:
                    progress((first + begin + some) / points.shape[0])
    return in_units_of_data(coefficients.stored, results[:, 0] if derivative == 0 else results, derivative, fill)


def kernel_fill(stored: Stored, derivative: int, fill: float | None) -> np.float32:
    """What kernels write outside the domain: infinity, which no sample gives, where `fill` would not survive the way back."""
    if fill is None:
        return np.float32(0)
    return np.float32(math.inf if stored.alters(derivative) else fill)


def in_units_of_data(stored: Stored, results: Floats, derivative: int, fill: float | None) -> Reals:
    """Results of kernels in units of the data, and `fill` outside the domain."""
    if not stored.alters(derivative):
        return results
    final = stored.derivatives(results) if derivative else stored.values(results)
    if fill is not None:
        final[np.isinf(results)] = fill
    return final


def sample_grid(
    coefficients: Coefficients,
    evaluator: Evaluator,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None = None,
    progress: Progress | None = None,
    derivative: int = 0,
    chain: Chain | None = None,
) -> None:
    """`resample_coefficients`, or its gradient, point by point; `chain` maps the grid's indices before the matrix does."""
    device = coefficients.device
    staged = chain if chain and chain.stages else None
    built = _build(coefficients, evaluator, derivative, fill, np.float32, on_grid=True, sorted=False, chain=staged)
    transform = _transform(device, matrix, offset, coefficients.volume.world_to_index_matrix)
    kernel = built.kernel("sample_grid")
    nz, ny, nx = shape
    points = _launch_points(coefficients, evaluator)
    rows, slices = max(1, min(ny, points // nx)), max(1, points // (nx * ny))
    items, together = (-(-nx // _RUN), 1) if _in_lanes(coefficients, evaluator, derivative) else (-(-nx // 8) * 8, 8)
    parts = [(z, y) for z in range(0, nz, slices) for y in range(0, ny, rows)]
    for done, (z, y) in enumerate(parts, 1):
        with device.errors:
            kernel(
                device.queue,
                (items, min(rows, ny - y), min(slices, nz - z)),
                (together, 1, 1),
                coefficients.argument(evaluator),
                coefficients.extent,
                coefficients.size,
                coefficients.period,
                transform,
                np.array([nx, ny, y, z], np.int32),
                kernel_fill(coefficients.stored, derivative, fill),
                buffer,
                *(staged.arguments if staged else ()),
            )
        device.finish()
        if progress:
            progress(done / len(parts))


def _transform(device: Device, matrix: NDArray[np.float64], offset: NDArray[np.float64], slopes: NDArray[np.float64]) -> Any:
    """The transform of points.cl: from positions to indices, and from index to world derivatives."""

    def square(m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.pad(m, ((0, 3 - m.shape[0]), (0, 3 - m.shape[1])))

    whole = np.concatenate([square(matrix).ravel(), np.pad(offset, (0, 3 - offset.size)), square(slopes).ravel()])
    return device.upload(whole.astype(np.float64 if device.has_double else np.float32))


def _build(
    coefficients: Coefficients,
    evaluator: Evaluator,
    derivative: int,
    fill: float | None,
    kind: type[np.generic],
    *,
    on_grid: bool,
    sorted: bool,
    chain: Chain | None = None,
) -> Program:
    lanes, run = (LANES, _RUN) if _in_lanes(coefficients, evaluator, derivative) else (1, 1)
    defines = {
        **coefficients.defines(evaluator),
        **point_defines(kind),
        "DERIVATIVE": derivative,
        "FILL": int(fill is not None),
        "LANES": lanes,
        "RUN": run,
        "ON_GRID": int(on_grid),
        "SORTED": int(sorted),
        **(chain.defines() if chain else {}),
    }
    return coefficients.device.build("spline/points.cl", defines)


def _in_lanes(coefficients: Coefficients, evaluator: Evaluator, derivative: int) -> bool:
    """Whether a work-item takes a run of points, LANES at a time: on processors, from buffers by direct taps."""
    rows = int(coefficients.extent[1]) * int(coefficients.extent[2])
    cpu = coefficients.device.kind == "cpu"
    return cpu and evaluator == DIRECT and derivative < 2 and rows <= np.iinfo(np.int32).max


def _launch_points(coefficients: Coefficients, evaluator: Evaluator) -> int:
    """How many points a launch takes, so that it is short whatever the filter; images may be sampled in software."""
    taps = coefficients.device.limits.launch_taps * (1 if evaluator.image else 4)
    return max(_MIN_LAUNCH, taps // int(coefficients.filter.support**coefficients.volume.ndim) // _RUN * _RUN)
