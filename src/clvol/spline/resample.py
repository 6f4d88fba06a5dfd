"""The function on another grid: the host side of resample.cl, which goes axis by axis where the grid's axes are the volume's."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.program import LANES
from clvol.spline.chain import Chain
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import DIRECT, Evaluator
from clvol.spline.points import Progress, kernel_fill, sample_grid

__all__ = ["resample_coefficients"]

_BLOCK = 16  # rows that resample.cl makes at once
_ITEMS_A_CORE = 16  # work-items for each core, so that no core waits long for another
_NO_SHEAR = 1e-9  # samples


def resample_coefficients(
    coefficients: Coefficients,
    evaluator: Evaluator,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None = None,
    progress: Progress | None = None,
    chain: Chain | None = None,
) -> None:
    """Values in stored units at index positions ``matrix @ (i, j, k) + offset`` into a float32 buffer.

    Parameters
    ----------
    coefficients : Coefficients
        Of the function.
    evaluator : Evaluator
        How it is evaluated.
    matrix, offset : ndarray of float64, shapes (d, d) and (d,)
        From the grid's indices, x first, to those of the volume.
    shape : (int, int, int)
        Points of the grid along z, y and x.
    buffer : Buffer
        Where the values go, [z, y, x].
    fill : float, optional
        What belongs outside the domain, where `kernel_fill` of it is written; None: the boundary rule goes on.
    progress : callable, optional
        Called with the fraction done.
    chain : Chain, optional
        What maps the grid's indices before the matrix does.
    """
    straight = not (chain and chain.stages) and _along_axes(matrix, shape)
    if coefficients.device.kind == "cpu" and evaluator == DIRECT and straight:
        _resample_axes(coefficients, np.diag(matrix), offset, shape, buffer, fill, progress)
    else:
        sample_grid(coefficients, evaluator, matrix, offset, shape, buffer, fill, progress, chain=chain)


def _along_axes(matrix: NDArray[np.float64], shape: tuple[int, ...]) -> bool:
    """Whether the axes of a grid of shape (z, y, x) are the volume's, but for rounding."""
    across = matrix - np.diag(np.diag(matrix))
    return bool((np.abs(across) * np.array(shape[::-1])[: len(matrix)]).max() < _NO_SHEAR)


def _axis_taps(
    coefficients: Coefficients, axis: int, positions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The stored coefficients along an axis that make the function at `positions` in samples, and their weights; (N, taps)."""
    boundary, n = coefficients.boundary, int(coefficients.size[axis])
    taps, scale = coefficients.filter.support, coefficients.filter.scale
    halo, end = int(coefficients.extent[3]), int(coefficients.extent[axis])
    base, t = coefficients.filter.cell(boundary.position(positions, n, 2 * taps + 2))
    weights = coefficients.filter.weights(t).T
    place = base.astype(np.int64)[:, None] + np.arange(taps)
    stored = (place >= -halo) & (place < end - halo)
    if boundary.period:
        return np.where(stored, place, boundary.folded(place, n, scale)) + halo, weights
    return np.where(stored, place + halo, 0), np.where(stored, weights, 0.0)


def _resample_axes(
    coefficients: Coefficients,
    step: NDArray[np.float64],
    start: NDArray[np.float64],
    shape: tuple[int, ...],
    buffer: Any,
    fill: float | None,
    progress: Progress | None,
) -> None:
    """`resample_coefficients` one axis after the other, for a grid along the volume's axes."""
    device, taps, d = coefficients.device, coefficients.filter.support, coefficients.volume.ndim
    nz, ny, nx = shape
    positions = [start[axis] + step[axis] * np.arange(n) for axis, n in enumerate((nx, ny, nz)[:d])]
    whole_vectors = np.pad(positions[0], (0, -nx % LANES), mode="edge")
    axes = [_axis_taps(coefficients, axis, x) for axis, x in enumerate([whole_vectors, *positions[1:]])]
    places, weights = zip(*axes, strict=True)
    # the part of a row that is used, in whole vectors: rows are a whole number of them
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
    units, pitch, area = nz * len(blocks), int(coefficients.extent[0]), int(coefficients.extent[0]) * int(coefficients.extent[1])
    items, room = min(units, _ITEMS_A_CORE * device.units), width * (2 * LANES + int(blocks[:, 1].max()))
    scratch = device.allocate(4 * items * room)
    grid = np.array([nx, ny, nz, places[0].size], np.int32)
    built = device.build("spline/resample.cl", {"TAPS": taps, "DIMENSIONS": d, "BLOCK": _BLOCK, "LANES": LANES, "COORD_DOUBLE": 0})
    some = max(1, LANES * device.limits.launch_taps // (_BLOCK * nx * taps * d))
    for first in range(0, units, some):
        count = min(some, units - first)
        with device.errors:
            built.kernel("resample_axes")(
                device.queue,
                (min(items, count),),
                (1,),
                coefficients.argument(DIRECT),
                np.int32(left),
                np.uint64(pitch),
                np.uint64(area),
                np.int32(width),
                *tables,
                grid,
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
            for axis, (x, n) in enumerate(zip(positions, coefficients.volume.size, strict=True)):
                outside = (x < -0.5) | (x > n - 0.5)
                np.moveaxis(values, 2 - axis, 0)[outside] = kernel_fill(coefficients.stored, 0, fill)
