"""From samples to coefficients, in place on a device: the host side of prefilter.cl."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import Boundary
from clvol.device import Device
from clvol.filter import Filter
from clvol.program import LANES

Floats = NDArray[np.float32]

__all__ = ["CHAINS"]

CHAINS = 4  # vectors of lines that are filtered at once where they lie side by side
_START_ERROR = 1e-9  # what the starting values of the prefilter may leave out, relative to the data
_VOXELS_A_LAUNCH = 1 << 26  # of copies and the prefilter, and ...


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
    built = device.build(
        "spline/prefilter.cl",
        {
            "POLES": filter.poles.size,
            "POLE_VALUES": "{" + ",".join(f"{p:.9e}f" for p in filter.poles) + "}",
            "GAIN": float(1 / filter.samples[-1]),
            "ENDS": starts[0][0].shape[2] // 2,
            "CHAINS": chains,
            "LANES": LANES,
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
