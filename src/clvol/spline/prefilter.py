"""From samples to coefficients, in place on a device: the host side of prefilter.cl."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.device.program import LANES
from clvol.spline.build import scalar_defines

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.build import DefineDict

__all__ = ["gain_along", "prefilter_in_place"]

_CHAINS = 4  # vectors of lines that a work-item of a CPU filters side by side
# error of the starting values, relative to the data
_START_ERRORS: dict[type[np.generic], float] = {np.float32: 1e-9, np.float64: 1e-18}


@dataclass(frozen=True, eq=False)
class _Plan:
    """How the lines of one axis are filtered.

    `sums` are the weights of the starting values of causal and anticausal recursions, for samples from the first on, then from the
    last backwards; shape (stages, 2, order, 2, ends).
    """

    stages: list[tuple[float, float]]  # a1 and a2 of the recursions of each stage
    gain: float  # factor of the samples
    sums: NDArray[np.float64]
    head: int  # number of samples used at this end
    tail: int
    left_out: float  # contribution of the samples further in, relative to the data

    @property
    def split(self) -> bool:
        """Whether causal recursions start from samples near the first one only, and anticausal ones from those near the last."""
        return bool(max(np.abs(self.sums[:, 0, :, 1]).max(), np.abs(self.sums[:, 1, :, 0]).max()) < self.left_out)

    def arguments(self, device: Device, gain: float, sums: float, kind: type[np.generic]) -> tuple[Any, ...]:
        """Arguments of prefilter.cl: samples are multiplied by `gain`, sums by `sums`."""
        numbers = np.concatenate([np.ravel(self.stages), [gain], sums * self.sums.ravel()])
        return (device.buffers.upload(numbers.astype(kind)), *map(np.int32, (self.sums.shape[-1], self.head, self.tail)))


@lru_cache(maxsize=256)
def _plan(row: Filter, boundary: Boundary, n: int, order: int, count: int, left_out: float) -> _Plan:
    """The recursions of `row`, which is the same along all axes, on an axis of `n` samples: `count` stages of `order` poles.

    A stage has a causal recursion ``y[i] = x[i] + a1 y[i-1] + a2 y[i-2]`` and an anticausal one; the first stage multiplies the
    samples by the gain. The starting values are sums over samples near the ends. The coefficients solve the matrix of eq. (11),
    which the boundary rule determines; inverting the later stages on them gives the output of each stage, hence its starting
    values. All of this is linear in the samples, and only samples near the ends matter, since the inverse decays like powers of
    the largest pole.
    """
    poles, b = row.poles, row.undone
    nearest = float(np.abs(poles).max(initial=left_out))
    reach = math.ceil(math.log(left_out) / math.log(nearest)) + 2 * order * count
    m = min(n, 4 * reach)  # longer axes have the same ends
    inverse = np.linalg.inv(boundary.matrix(b, m))  # rows: coefficients as sums over samples
    stages = _stages(poles, order)
    stages += [(0.0, 0.0)] * (count - len(stages))  # stages without effect, if another axis has more poles
    margin = 2 * order * len(stages)
    index = boundary.folded(np.arange(-margin, m + margin), m)
    output = np.where(index[:, None] >= 0, inverse[index], 0.0)  # the coefficients, extended past the ends
    starts = []  # last stage first
    zero = margin  # position of index 0 in `output`
    for a1, a2 in reversed(stages):
        if order == 1:
            causal = output[1:] - output[:-1] / a1  # c[i] = a1 (c[i+1] - y[i])
            starts.append([causal[zero], output[zero + m - 1]])
            break
        causal = output[:-2] - a1 * output[1:-1] - a2 * output[2:]
        starts.append([causal[zero], causal[zero + 1], output[zero + m - 1], output[zero + m - 2]])
        output = causal[2:] - a1 * causal[1:-1] - a2 * causal[:-2]
        zero -= 2
    weights = np.concatenate(starts[::-1])
    head = min(n, reach)
    tail = min(n - head, reach)
    ends = np.zeros((len(weights), 2, reach))
    ends[:, 0, :head] = weights[:, :head]
    ends[:, 1, :tail] = weights[:, ::-1][:, :tail]
    gain = 1 / b[-1] * (1.0 if order == 1 else float(np.prod(-poles).real))  # with two poles, theirs is in the causal recursion
    return _Plan(stages, gain, ends.reshape(count, 2, order, 2, reach), head, tail, left_out)


def _stages(poles: NDArray[Any], order: int) -> list[tuple[float, float]]:
    """(a1, a2) of the recursion of each stage, for one pole, or two that are real or conjugate."""
    if order == 1:
        return [(float(p), 0.0) for p in poles]
    real = [complex(p) for p in poles if p.imag == 0]
    pairs = [(p, p.conjugate()) for p in poles if p.imag > 0]
    pairs += list(zip_longest(real[::2], real[1::2], fillvalue=0j))
    return [(float((p + q).real), float(-(p * q).real)) for p, q in pairs]


def prefilter_in_place(
    device: Device,
    buffer: Any,
    filter: Filter,
    boundary: Boundary,
    extent: Sequence[int],
    size: Sequence[int],
    dimensions: int,
    kind: type[np.generic] = np.float32,
    axes: Sequence[int] | None = None,
) -> None:
    """Convert samples to coefficients in place (section 4.2), with a filter that has a prefilter.

    The buffer holds numbers of `kind`, [z, y, x], with a halo on every side, which is overwritten. `extent` is the row pitch (a
    multiple of `LANES`), stored rows, stored slices and halo; `size` the samples along x, y and z. The first `dimensions` axes
    are filtered, or `axes`, 0 for x: without x, the samples must already be multiplied by `gain_along`.
    """
    pitch, area, halo = extent[0], extent[0] * extent[1], extent[3]
    nx, ny, nz = size
    axes = range(dimensions) if axes is None else axes
    asked = "prefilter", filter, boundary, tuple(size), tuple(axes), kind
    defines, along = device.tables(asked, lambda: _arguments(device, filter, boundary, size, axes, kind))
    built = device.build("spline/prefilter.cl", {**defines, "COORD_DOUBLE": 0})

    def launch(name: str, groups: int, lines: int, origin: int, stride: int, voxels: int, *arguments: Any) -> None:
        """Launch a kernel over `lines` lines or slices, `stride` apart, of `voxels` voxels each."""
        step = max(device.units, device.limits.launch_voxels // voxels)  # at least one for each core
        for first in range(0, lines, step):
            if first:  # a wait for several launches would be long, and Ctrl-C would not interrupt it
                device.finish()
            built.kernel(name)(
                device.queue,
                (groups, min(step, lines - first)),
                (1, 1) if device.kind == "cpu" else None,
                buffer,
                np.uint64(origin + first * stride),
                *arguments,
            )

    # the halo is filtered too, without need
    first_row = (halo * area if dimensions > 2 else 0) + (halo * pitch if dimensions > 1 else 0)
    lines = np.int32(nx), np.uint64(pitch), np.int32(ny), np.uint64(area)
    wide = -(-pitch // (LANES * int(defines["CHAINS"])))
    with device.errors:
        if device.kind == "cpu" and 0 in along and 1 in along and nz >= 4 * device.units:
            launch("prefilter_slices", 1, nz, first_row + halo, area, area, *lines, np.int32(halo), *along[0], *along[1])
        else:
            if 0 in along:
                launch("prefilter_rows", -(-ny // (2 * LANES)), nz, first_row + halo, area, area, *lines, *along[0])
            if 1 in along:
                columns = np.int32(ny), np.uint64(pitch), np.int32(pitch), np.uint64(area)
                launch("prefilter_columns", wide, nz, first_row, area, area, *columns, *along[1])
        if 2 in along:
            columns = np.int32(nz), np.uint64(area), np.int32(pitch), np.uint64(pitch)
            launch("prefilter_columns", wide, ny, first_row, pitch, nz * pitch, *columns, *along[2])


def _arguments(
    device: Device, filter: Filter, boundary: Boundary, size: Sequence[int], axes: Sequence[int], kind: type[np.generic]
) -> tuple[DefineDict, dict[int, tuple[Any, ...]]]:
    """The `#define`s of prefilter.cl, and its arguments for the lines of each axis."""
    order, count, plans = _plans(filter, boundary, size, axes, kind)
    defines: DefineDict = {
        "ORDER": order,
        "STAGES": count,
        "SPLIT": int(all(plan.split for plan in plans.values())),
        "CHAINS": _CHAINS if device.kind == "cpu" else 1,  # on GPUs other work-items hide the latency
        "LANES": LANES,
        **scalar_defines(kind),
    }
    others = math.prod(plan.gain for axis, plan in plans.items() if axis)  # applied by the rows, which are first
    return defines, {
        axis: plan.arguments(device, 1.0, 1 / plan.gain, kind) if axis else plan.arguments(device, plan.gain * others, others, kind)
        for axis, plan in plans.items()
    }


def gain_along(filter: Filter, boundary: Boundary, size: Sequence[int], axes: Sequence[int], kind: type[np.generic]) -> float:
    """The factor for samples if x is not filtered; 1 if it is, since the rows then apply it."""
    _, _, plans = _plans(filter, boundary, size, axes, kind)
    return 1.0 if 0 in plans else math.prod(plan.gain for plan in plans.values())


def _plans(
    filter: Filter, boundary: Boundary, size: Sequence[int], axes: Sequence[int], kind: type[np.generic]
) -> tuple[int, int, dict[int, _Plan]]:
    """Poles of a stage, the number of stages, and the plan of each axis."""
    rows = {axis: filter.along(axis) for axis in axes}
    poles = max((row.poles.size for row in rows.values()), default=0)
    order, count = (1, 1) if poles == 1 else (2, max(1, -(-poles // 2)))  # without poles, a stage only divides
    ends, left_out = boundary.ends, _START_ERRORS[kind]
    return order, count, {axis: _plan(row, ends, size[axis], order, count, left_out) for axis, row in rows.items()}
