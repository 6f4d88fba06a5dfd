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
from clvol.program import LANES, literal

__all__ = ["prefilter_in_place"]

_CHAINS = 4  # vectors of lines that one work-item of a processor filters side by side
_START_ERROR = 1e-9  # what the starting values may leave out, relative to the data


@lru_cache(maxsize=256)
def _starts(filter: Filter, boundary: Boundary, n: int) -> tuple[NDArray[np.float32], int, int]:
    """First values of the recursions of prefilter.cl on an axis of `n` samples, as sums over samples near the ends.

    The coefficients solve the matrix of eq. (11), which the boundary rule determines. Undoing the stages of the later
    poles on them gives what each stage must produce, hence its first value. All of this is linear in the samples, and
    only samples near the ends matter, since the inverse decays like powers of the largest pole.

    Returns
    -------
    weights : ndarray, shape (poles, 2, 2 * ends)
        For each pole the causal and the anticausal sum; of each, weights from the first sample on, then from the last
        one backwards.
    head, tail : int
        How many samples of either end count.
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


def prefilter_in_place(
    device: Device, buffer: Any, filter: Filter, boundary: Boundary, extent: Sequence[int], size: Sequence[int], dimensions: int
) -> None:
    """Turn samples into coefficients where they are stored (section 4.2).

    Parameters
    ----------
    device : Device
        Where the buffer is.
    buffer : Buffer
        float32, [z, y, x], with a halo on every side whose content is lost.
    filter, boundary : Filter, Boundary
        What is solved for. The filter has a prefilter.
    extent : (int, int, int, int)
        Row pitch, a multiple of `LANES`; stored rows; stored slices; halo.
    size : (int, int, int)
        Samples along x, y and z.
    dimensions : int
        The first so many of x, y and z are filtered.
    """
    pitch, area, halo = extent[0], extent[0] * extent[1], extent[3]
    nx, ny, nz = size
    chains = _CHAINS if device.kind == "cpu" else 1  # elsewhere other work-items fill the wait for a product
    starts = [_starts(filter, boundary, n) for n in size]
    built = device.build(
        "spline/prefilter.cl",
        {
            "POLES": filter.poles.size,
            "POLE_VALUES": "{" + ",".join(map(literal, filter.poles.tolist())) + "}",
            "GAIN": float(1 / filter.samples[-1]),
            "ENDS": starts[0][0].shape[2] // 2,
            "CHAINS": chains,
            "LANES": LANES,
            "COORD_DOUBLE": 0,
        },
    )
    along_x, along_y, along_z = ((device.upload(weights), np.int32(head), np.int32(tail)) for weights, head, tail in starts)

    def launch(name: str, groups: int, lines: int, origin: int, stride: int, voxels: int, *arguments: Any) -> None:
        """Launches over `lines` lines or slices, `stride` apart, of so many voxels each."""
        step = max(1, device.limits.launch_voxels // voxels)
        for first in range(0, lines, step):
            built.kernel(name)(
                device.queue,
                (groups, min(step, lines - first)),
                (1, 1) if device.kind == "cpu" else None,
                buffer,
                np.uint64(origin + first * stride),
                *arguments,
            )

    first_row = (halo * area if extent[2] > 1 else 0) + halo * pitch  # its halo is filtered too, in vain
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
