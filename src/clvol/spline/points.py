"""The function at points and on grids of points: the host side of points.cl."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.progress import Progress
from clvol.device.program import LANES
from clvol.spline.build import boundary_defines, point_defines
from clvol.spline.evaluator import DIRECT
from clvol.spline.sort import Sorter, scattered
from clvol.volume.stored import Reals

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.device.program import Kernel, Program
    from clvol.filter.boundary import Boundary
    from clvol.spline.build import DefineDict
    from clvol.spline.chain import Chain
    from clvol.spline.coefficients import Coefficients
    from clvol.spline.evaluator import Evaluator
    from clvol.volume.volume import Volume

__all__ = ["NOTHING_GIVEN", "Floats", "Given", "Reals", "Transform", "sample_coefficients", "sample_grid", "sample_into"]

Floats: TypeAlias = NDArray[np.float32]

_RUN = 512  # points for each work-item of a CPU, a multiple of LANES
_MIN_LAUNCH = 1 << 10  # points
_CONSTANT = 4  # roundings that the sum of equal coefficients, each times its weight, differs by from them
_POINT_TAPS = 16  # cost of a point besides its taps, in taps


@dataclass(frozen=True)
class Given:
    """What overrides the boundary rule outside the volume's domain; None: as the rule says.

    If `missing`, `fill` applies only to positions that are not finite, which are NaN otherwise, and is also the constant of rules
    that have one.
    """

    fill: float | None = None
    missing: bool = False
    edge: float | None = None  # distance from the outer samples to the edge of the domain

    def defines(self, boundary: Boundary) -> DefineDict:
        """The `#define`s of outside.cl."""
        return {
            "FILL": 0 if self.fill is None else 2 if self.missing else 1,
            "EDGE": boundary.edge if self.edge is None else self.edge,
        }

    def values(self, coefficients: Coefficients, derivative: int) -> NDArray[Any]:
        """The values that kernels write; infinities, as marks, if the conversion to units of the data would change them."""
        stored, cval = coefficients.stored, coefficients.boundary.cval
        if stored.alters(derivative):
            return np.array([math.inf, -math.inf], coefficients.kind)
        with np.errstate(over="ignore"):
            return np.array([0.0 if self.fill is None else self.fill, cval], coefficients.kind)

    def in_units_of_data(self, coefficients: Coefficients, results: Reals, derivative: int) -> Reals:
        """Convert results of kernels to units of the data."""
        stored = coefficients.stored
        if not stored.alters(derivative):
            return results
        final = stored.derivatives(results) if derivative else stored.values(results)
        beyond = coefficients.boundary.beyond
        if beyond is not None and derivative == 0 and stored.offset:  # a constant outside, to the rounding of its weights' sum
            constant = stored(beyond, results.dtype.type)
            final[np.abs(results - constant) <= _CONSTANT * np.finfo(results.dtype).eps * abs(constant)] = beyond
        for value, mark in ((self.fill, math.inf), (coefficients.boundary.cval, -math.inf)):
            if value is not None:
                final[results == mark] = value
        return final


NOTHING_GIVEN = Given()


@dataclass(frozen=True, eq=False)
class Transform:
    """From positions to indices, x first: ``matrix @ position + offset``."""

    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]
    slopes: NDArray[np.float64]  # derivatives per world unit are those per index times this matrix

    @classmethod
    def into(cls, grid: Volume) -> Transform:
        """From the world to a grid's indices."""
        inverse = grid.world_to_index_matrix
        return cls(inverse, -inverse @ np.asarray(grid.origin), inverse)

    def indices(self, positions: NDArray[Any]) -> NDArray[np.float64]:
        """Indices of positions (N, d), on the host in float64: devices without it lose the digits of positions far from zero."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(positions @ self.matrix.T + self.offset)

    @property
    def after_indices(self) -> Transform:
        """What remains for the device after `indices`."""
        return Transform(np.eye(len(self.offset)), np.zeros(len(self.offset)), self.slopes)

    def upload(self, device: Device) -> Any:
        """Upload as the transform of points.cl."""
        d = len(self.offset)
        whole = np.zeros(22)
        for numbers, square in ((self.matrix, whole[:9]), (self.slopes, whole[12:21])):
            square.reshape(3, 3)[:d, :d] = numbers
        whole[9 : 9 + d] = self.offset
        return device.buffers.upload(whole.astype(np.float64 if device.has_double else np.float32))


def sample_coefficients(
    coefficients: Coefficients,
    evaluator: Evaluator,
    points: NDArray[Any],
    derivative: int = 0,
    fill: float | None = None,
    progress: Progress | None = None,
    out: NDArray[Any] | None = None,
) -> Reals:
    """The function or its derivatives at world positions (N, d), in units of the data, per world unit: (N,), (N, d) or (N, d * d).

    Of several functions next to each other (`coefficients.functions`): those of each, (N, n), (N, n * d) or (N, n * d * d).

    float64 if samples are not stored unchanged. Positions in float32 are used as they are, others as float64 if the device
    supports it. Second derivatives always use direct taps. Kernels write into `out`, contiguous and of the coefficients' type; it
    is returned if nothing has to be converted.
    """
    components = coefficients.functions * coefficients.ndim**derivative
    shape = points.shape[:1] + ((components,) if components > 1 else ())
    results = np.empty(shape, coefficients.kind) if out is None else out.reshape(shape)
    given, device = Given(fill), coefficients.device
    if 0 < len(points) <= _RUN and device.has_double and not device.limits.sorting:
        _sample_few(coefficients, evaluator, points, results, derivative, given)
        if progress:
            progress(1.0)
    else:
        sample_into(coefficients, evaluator, points, results, Transform.into(coefficients.volume), derivative, given, progress)
    return given.in_units_of_data(coefficients, results, derivative)


class _Call(NamedTuple):
    """The kernel of points.cl with all arguments but points and results."""

    program: Program
    queue: Any
    in_lanes: bool
    function: tuple[Any, ...]
    values: NDArray[Any]

    @classmethod
    def of(
        cls, program: Program, coefficients: Coefficients, evaluator: Evaluator, derivative: int, given: Given, matrix: Any
    ) -> _Call:
        """For a program of the same function, and a transform on the device."""
        return cls(
            program,
            coefficients.device.queue,
            _in_lanes(coefficients, evaluator, derivative),
            (coefficients.argument(evaluator), coefficients.extent, coefficients.size, coefficients.period, matrix),
            given.values(coefficients, derivative),
        )

    def launch(self, points: Any, planes: int, first: int, count: int, results: Any, kernel: Kernel | None = None) -> None:
        """Launch over `count` points, from number `first` on; by a `kernel` of the caller's, if given."""
        (kernel or self.program.kernel("sample_points"))(
            self.queue,
            *self.sizes(count),
            *self.function,
            points,
            np.uint64(planes),
            np.uint64(first + count),
            self.values,
            results,
            global_offset=(first // _RUN if self.in_lanes else first,),
        )

    def sizes(self, count: int) -> tuple[tuple[int], tuple[int]]:
        """Work-items over `count` points, and those of a group."""
        return ((-(-count // _RUN),), (1,)) if self.in_lanes else ((-(-count // 64) * 64,), (64,))


_COUNT = 7  # the number of `first + count` among the arguments of points.cl


class _Few:
    """What a call at up to `_RUN` points needs besides them; their memory too where kernels work on the host's."""

    def __init__(
        self, coefficients: Coefficients, evaluator: Evaluator, derivative: int, given: Given, kind: type[np.generic]
    ) -> None:
        self._device = device = coefficients.device
        program = _build(coefficients, evaluator, derivative, given, kind, planar=False, sorted=False)
        matrix = Transform.into(coefficients.volume).upload(device)
        self._call = _Call.of(program, coefficients, evaluator, derivative, given, matrix)
        self._kernel, self._kind = program.own_kernel("sample_points"), kind
        self._points = np.empty(_RUN * coefficients.ndim, kind)
        self._results = np.empty(_RUN * coefficients.functions * coefficients.ndim**derivative, coefficients.kind)
        self._in_place = device.is_pocl
        self._wanted = device.buffers.shared(self._results) if self._in_place else device.buffers.allocate(self._results.nbytes)
        self._lent = device.buffers.shared(self._points) if self._in_place else None
        self._launched = False

    def at(self, points: NDArray[Any], results: NDArray[Any]) -> None:
        """The function at points."""
        count = len(points)
        if not self._in_place:  # two copies cost less than to lend the arrays, and an upload less than a write to a buffer
            part = self._device.buffers.upload(np.ascontiguousarray(points, dtype=self._kind))
            with self._device.buffers.kept(part):
                self._call.launch(part, 0, 0, count, self._wanted)
                self._device.buffers.download(self._wanted, results)
            return
        self._points[: points.size].reshape(points.shape)[...] = points
        if self._launched:
            self._kernel.again(self._call.queue, *self._call.sizes(count), _COUNT, np.uint64(count), global_offset=(0,))
        else:
            self._call.launch(self._lent, 0, 0, count, self._wanted, self._kernel)
        self._launched = True
        self._device.finish()
        results[...] = self._results[: results.size].reshape(results.shape)


def _sample_few(
    coefficients: Coefficients, evaluator: Evaluator, points: NDArray[Any], results: NDArray[Any], derivative: int, given: Given
) -> None:
    """`sample_into` at up to `_RUN` points of the world, by a plan."""
    device, plans = coefficients.device, coefficients.plans
    kind = np.float32 if points.dtype == np.float32 else np.float64
    asked = evaluator, derivative, given.fill, kind
    plan: _Few = plans.take(asked, lambda: _Few(coefficients, evaluator, derivative, given, kind))
    with device.buffers.kept((plan, results)), device.errors:
        plan.at(points, results)
    plans.give(asked, plan)


def sample_into(
    coefficients: Coefficients,
    evaluator: Evaluator,
    points: NDArray[Any],
    results: NDArray[Any],
    transform: Transform | None = None,
    derivative: int = 0,
    given: Given = NOTHING_GIVEN,
    progress: Progress | None = None,
) -> None:
    """The function or its derivatives at positions, in stored units; `results` are contiguous and of the coefficients' type.

    With a `transform`, points are positions (N, d), x first. Otherwise they are indices (d, N), in the order of the array's axes.
    """
    device, d, planar = coefficients.device, coefficients.ndim, transform is None
    count = points.shape[1 if planar else 0]
    kind = np.float64 if device.has_double and points.dtype != np.float32 else np.float32
    lanes = _in_lanes(coefficients, evaluator, derivative)
    steps = None if transform is None else transform.matrix
    sorting = lanes and (device.limits.sorting if device.limits.sorting is not None else scattered(coefficients, points, steps))
    sorter = Sorter(coefficients, kind, count, planar=planar) if sorting else None
    built = _build(coefficients, evaluator, derivative, given, kind, planar=planar, sorted=sorting)
    on_host = None if device.has_double else transform  # maps positions to indices before they are rounded
    matrix = (on_host.after_indices if on_host else transform or Transform(np.eye(d), np.zeros(d), np.eye(d))).upload(device)
    call = _Call.of(built, coefficients, evaluator, derivative, given, matrix)
    launch = _launch_points(coefficients, evaluator)
    step = launch if sorter is None else sorter.room
    if planar and points.dtype == kind:
        step = count if sorter is None else step
    flat = results.reshape(count, coefficients.functions * d**derivative)
    for first in range(0, count, step):
        given_part = points[:, first : first + step] if planar else points[first : first + step]
        part = np.ascontiguousarray(on_host.indices(given_part) if on_host else given_part, dtype=kind)
        target = flat[first : first + step]
        some, planes = len(target), part.shape[1] if planar else 0
        with device.buffers.lent(part, write=False) as lent, device.buffers.lent(target, write=True) as wanted, device.errors:
            ready = lent if sorter is None else sorter.sort(lent, planes, some, matrix)
            for begin in range(0, some, launch):
                now = min(launch, some - begin)
                call.launch(ready, planes, begin, now, wanted)
                device.finish()
                if progress:
                    progress((first + begin + now) / count)


def sample_grid(
    coefficients: Coefficients,
    evaluator: Evaluator,
    transform: Transform,
    shape: tuple[int, ...],
    buffer: Any,
    given: Given = NOTHING_GIVEN,
    progress: Progress | None = None,
    part: slice | None = None,
    derivative: int = 0,
    chain: Chain | None = None,
) -> None:
    """`resample_coefficients` point by point, for `part` of the grid along its first axis with more than one point, if given.

    With `derivative` 1 each value is followed by its gradient. A `chain` maps the grid's indices before the transform.
    """
    device = coefficients.device
    built = _build(coefficients, evaluator, derivative, given, None, planar=False, sorted=False, chain=chain)
    matrix = transform.upload(device)
    kernel = built.kernel("sample_grid")
    nz, ny, nx = shape
    y_part, z_part = (slice(0, ny), slice(0, nz)) if part is None else (part, slice(0, 1)) if nz == 1 else (slice(0, ny), part)
    points = _launch_points(coefficients, evaluator)
    rows, slices = max(1, min(ny, points // nx)), max(1, points // (nx * ny))
    lanes = _in_lanes(coefficients, evaluator, derivative)
    items, together = (-(-nx // _RUN), 1) if lanes else (-(-nx // 8) * 8, 8)
    at_once = max(1, _RUN // nx) if lanes else 1  # rows of a work-item
    parts = [(z, y) for z in range(z_part.start, z_part.stop, slices) for y in range(y_part.start, y_part.stop, rows)]
    base = np.uint64((z_part.start * ny + y_part.start) * nx)
    for done, (z, y) in enumerate(parts, 1):
        with device.errors:
            kernel(
                device.queue,
                (items, -(-min(rows, y_part.stop - y) // at_once), min(slices, z_part.stop - z)),
                (together, 1, 1),
                coefficients.argument(evaluator),
                coefficients.extent,
                coefficients.size,
                coefficients.period,
                matrix,
                np.array([nx, ny, y, z], np.int32),
                np.array([at_once, min(y + rows, y_part.stop)], np.int32),
                base,
                given.values(coefficients, 0),
                buffer,
                *(chain.arguments if chain else ()),
            )
        device.finish()
        if progress:
            progress(done / len(parts))


def _build(
    coefficients: Coefficients,
    evaluator: Evaluator,
    derivative: int,
    given: Given,
    kind: type[np.generic] | None,
    *,
    planar: bool,
    sorted: bool,
    chain: Chain | None = None,
) -> Program:
    """Build points.cl for points of this type, or for a grid if `kind` is None."""
    lanes, run = (LANES, _RUN) if _in_lanes(coefficients, evaluator, derivative) else (1, 1)
    defines = {
        **coefficients.defines(evaluator),
        **boundary_defines(coefficients.boundary, coefficients.pad, coefficients.reach),
        **point_defines(kind or np.float32, planar=planar, indices=planar),
        **given.defines(coefficients.boundary),
        "DERIVATIVE": derivative,
        "LANES": lanes,
        "FEW": int(math.prod(coefficients.shape) <= np.iinfo(np.int32).max),
        "RUN": run,
        "ON_GRID": int(kind is None),
        "SORTED": int(sorted),
        "WITH_VALUE": int(kind is None and derivative == 1),
        **(chain.defines() if chain else {}),
    }
    return coefficients.device.build("spline/points.cl", defines)


def _in_lanes(coefficients: Coefficients, evaluator: Evaluator, derivative: int) -> bool:
    """Whether a work-item processes a run of points, LANES at a time: on CPUs, by direct taps from a buffer."""
    rows = int(coefficients.extent[1]) * int(coefficients.extent[2])
    cpu = coefficients.device.kind == "cpu"
    return cpu and evaluator == DIRECT and derivative < 2 and rows <= np.iinfo(np.int32).max


def _launch_points(coefficients: Coefficients, evaluator: Evaluator) -> int:
    """Points for each launch, so that it is short for any filter."""
    device, row = coefficients.device, coefficients.filter
    taps = 4 * device.limits.launch_taps
    if evaluator.image:
        taps //= 32 if device.kind == "cpu" else 4  # CPUs sample images in software
    return max(_MIN_LAUNCH, taps // int(row.support**coefficients.ndim + _POINT_TAPS) // _RUN * _RUN)
