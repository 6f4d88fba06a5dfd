"""The function on a grid of points: the host side of resample.cl, and of points.cl for grids that are turned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.program import LANES
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import Evaluator
from clvol.spline.points import _RUN, _TAPS_A_LAUNCH, _affine, _in_groups, _launch_points, _points_program
from clvol.spline.sort import point_defines

Floats = NDArray[np.float32]
Progress = Callable[[float], None]

__all__: list[str] = []

_BLOCK = 16  # rows that separable.cl makes at once
_ITEMS_A_CORE = 16  # ... and among how many work-items it shares them out on each core, so that none waits long for another
_NO_SHEAR = 1e-9  # samples


def _run_lattice(
    held: Coefficients,
    path: Evaluator,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None = None,
    progress: Progress | None = None,
) -> None:
    """Values at index positions ``matrix @ (i, j, k) + offset`` into a float32 buffer of shape (z, y, x)."""
    device = held.device
    if device.kind == "cpu" and path == Evaluator(False, False) and _along_axes(matrix, shape):
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
    built = device.build("spline/resample.cl", {"TAPS": taps, "DIMENSIONS": d, "BLOCK": _BLOCK, "LANES": LANES, "COORD_DOUBLE": 0})
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
