"""The function at points: the host side of points.cl."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.device import Device
from clvol.filter import Filter
from clvol.program import LANES, Program
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import Evaluator
from clvol.spline.sort import Sorter, point_defines, scattered

Floats = NDArray[np.float32]
Progress = Callable[[float], None]

__all__ = ["sample_coefficients"]

_TAPS_A_LAUNCH = 1 << 25  # ... of sampling: a launch should not run longer than a quarter of a second
_RUN = 512  # points that a work-item takes on a processor, a multiple of LANES


def _affine(device: Device, matrix: NDArray[np.float64], offset: NDArray[np.float64], slopes: NDArray[np.float64]) -> Any:
    """The transform of points.cl: from positions to indices, and from index to world derivatives."""

    def square(m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.pad(m, ((0, 3 - m.shape[0]), (0, 3 - m.shape[1])))

    whole = np.concatenate([square(matrix).ravel(), np.pad(offset, (0, 3 - offset.size)), square(slopes).ravel()])
    return device.upload(whole.astype(np.float64 if device.has_double else np.float32))


def _points_program(held: Coefficients, path: Evaluator, derivative: int, fill: float | None, **more: str | int) -> Program:
    lanes, run = (LANES, _RUN) if _in_groups(held, path, derivative) else (1, 1)
    defines = {**held.defines(path), "DERIVATIVE": derivative, "FILL": int(fill is not None), "LANES": lanes, "RUN": run, **more}
    return held.device.build("spline/points.cl", defines)


def _in_groups(held: Coefficients, path: Evaluator, derivative: int) -> bool:
    """Whether a work-item takes a run of points, eight at a time: on processors, from buffers by direct taps."""
    rows = int(held.extent[1]) * int(held.extent[2])
    return held.device.kind == "cpu" and path == Evaluator(False, False) and derivative < 2 and rows <= np.iinfo(np.int32).max


def sample_coefficients(
    held: Coefficients,
    path: Evaluator,
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


def _launch_points(filter: Filter, dimensions: int, path: Evaluator) -> int:
    """How many points a launch takes, so that it is short whatever the filter; images may be sampled in software."""
    taps = _TAPS_A_LAUNCH if path.image else 4 * _TAPS_A_LAUNCH
    return max(1 << 10, taps // int(filter.support**dimensions) // _RUN * _RUN)
