"""Reduction of an axis by a low-pass or by least squares, as weighted sums of samples; the host side of reduce.cl."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.checks import one_of
from clvol.base.errors import DeviceError, OptionError
from clvol.filter.make import bspline
from clvol.spline.build import scalar_defines
from clvol.volume.smoothing import settled
from clvol.volume.stored import is_far, wide_enough

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.volume.volume import Volume

__all__ = [
    "AntiAliasing",
    "Sums",
    "as_anti_aliasing",
    "gaussian",
    "gaussian_sums",
    "in_order",
    "interpolated",
    "least_squares",
    "lies_far",
    "low_passed",
    "nearest_spline",
    "nearest_sums",
    "smoothed",
    "steps_along",
    "sum_along",
]

Array: TypeAlias = NDArray[np.float64]
AntiAliasing: TypeAlias = Literal["gaussian", "least-squares"] | None

TRUNCATE = 4.0  # standard deviations at which a Gaussian is truncated, as in SciPy
_LEFT_OUT = (1e-8, 1e-15)  # largest tail that is cut from an impulse response, relative to its peak; for float32 and float64
_CIRCLE = 1 << 13  # samples of an impulse response before it is cut
_WIDTH = 32  # lines that reduce.cl processes side by side
_ITEMS_A_CORE = 8
_SLAB = 1 << 20  # samples converted at a time
_NO_STEP = 1e-9  # samples
_NEARLY = 1e-6  # distance from 1 of a sum of weights that is 1 but for what was cut


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums of the `n` samples of an axis, one for each row."""

    n: int
    places: NDArray[np.int32]  # the samples of each sum, shape (m, taps); index `n` is the constant outside the volume
    weights: Array

    @classmethod
    def of(cls, first: NDArray[np.int64], weights: Array, n: int, boundary: Boundary) -> Sums:
        """Sums of adjacent samples from `first` on, which may be outside the axis."""
        places = continued(first[:, None] + np.arange(weights.shape[1]), n, boundary)
        made = cls(n, np.where(places < 0, n, places).astype(np.int32), weights)
        if weights.shape[1] <= n + 1:
            return made
        return cls(n, np.tile(np.arange(n + 1, dtype=np.int32), (len(first), 1)), made.matrix())

    def differences(self, kind: type[np.generic]) -> tuple[NDArray[np.int32], NDArray[Any]]:
        """For each sum the sample of the largest weight, from which others differ little, and the sum of the weights."""
        totals = self.weights.sum(1)
        totals[np.abs(totals - 1) < _NEARLY] = 1
        return np.take_along_axis(self.places, np.abs(self.weights).argmax(1)[:, None], 1)[:, 0], totals.astype(kind)

    def matrix(self) -> Array:
        """As a matrix, shape (m, n + 1); the last column is for the constant outside."""
        result = np.zeros((len(self.places), self.n + 1))
        np.add.at(result, (np.arange(len(self.places))[:, None], self.places), self.weights)
        return result


def continued(i: NDArray[np.int64], n: int, boundary: Boundary) -> NDArray[np.int64]:
    """The sample, of `n`, at index `i` under a boundary rule; -1 for the constant outside."""
    if boundary.outside == "rule":
        return boundary.folded(i, n)
    if boundary.outside == "clamp":
        return np.clip(i, 0, n - 1)
    inside = (i >= 0) & (i < n)
    return np.where(inside, i, i % max(1, n - 1) if boundary.outside == "overlap" else -1)


def as_anti_aliasing(choice: object) -> AntiAliasing:
    """The meaning of `anti_aliasing`: None, "gaussian" (also for True) or "least-squares"."""
    if choice is None or (isinstance(choice, (bool, np.bool_)) and not choice):
        return None
    if isinstance(choice, (bool, np.bool_)):
        return "gaussian"
    if choice == "gaussian" or choice == "least-squares":
        return choice
    raise one_of("anti_aliasing", choice, ["False", "True", "'gaussian'", "'least-squares'"])


# -- the weights -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def gaussian(sigma: float, n: int, boundary: Boundary) -> Sums:
    """A Gaussian of standard deviation `sigma` in samples, truncated as in `scipy.ndimage.gaussian_filter`."""
    radius = int(TRUNCATE * sigma + 0.5)
    memory.require(32 * n * min(2 * radius + 1, n + 1), f"the weights of {2 * radius + 1} samples for each of {n}")
    x = np.arange(-radius, radius + 1)
    kernel = np.exp(-0.5 / max(sigma, 1e-9) ** 2 * x.astype(np.float64) ** 2)
    return Sums.of(np.arange(n) - radius, np.tile(kernel / kernel.sum(), (n, 1)), n, boundary)


@lru_cache(maxsize=64)
def least_squares(
    filter: Filter, start: float, step: float, m: int, n: int, boundary: Boundary, double: bool = False, prefilter: bool = True
) -> Sums:
    """The coarser spline that is nearest to the spline of the samples, at its grid points.

    Parameters
    ----------
    filter : Filter
        For the samples and the result; settled for this axis, and not a hybrid. The result is not smoothed again.
    start, step : float
        Sample j of the result is at ``start + step j``, in samples of the input.
    m, n : int
        Number of samples of the result and of the input.
    boundary : Boundary
        How the samples continue outside, where both functions extend without end: by the rule's period, by the outer samples
        with "nearest", or by a constant.
    double : bool
        Whether sums are computed in float64, which sets where impulse responses are cut.
    prefilter : bool
        Whether the input is samples; otherwise coefficients.

    Returns
    -------
    Sums
        For every sample of the result; for a filter without a prefilter, the coefficients of the nearest function.

    Raises
    ------
    OptionError
        The filter is a hybrid, or its kernel's translates are linearly dependent, so that no spline is the nearest.

    Notes
    -----
    With φ the kernel, s the spline of the samples and h = ``|step|``, the function ``sum over j of d_j φ((x - x_j) / h)`` is
    nearest to s in the mean square where its distance from s is orthogonal to every kernel:
    ``sum over l of a(j - l) d_l = ∫ s(x_j + h u) φ(u) du``, with a(k) = ∫ φ(u) φ(u - k) du, for B-splines of degree n the
    B-spline of degree 2n + 1 (M. Unser, A. Aldroubi and M. Eden, *Enlargement or reduction of digital images with minimum loss of
    information*, IEEE Trans. Image Processing 4, 1995; for any h A. Muñoz, T. Blu and M. Unser, *Least-squares image resizing
    using finite differences*, IEEE Trans. Image Processing 10, 2001). The integrals are exact: between knots of either grid the
    integrand is a polynomial. A step of one sample or less is no reduction: the result is s itself.
    """
    if filter.magnified_by is not None:
        raise OptionError(f"least-squares reduction takes a filter with one kernel; got the hybrid {filter.name!r}")
    left_out, h = _LEFT_OUT[double], abs(step)
    wide = filter.support * (math.ceil(h * filter.support) + filter.support + 1)
    memory.require(40 * m * wide * (filter.degree + 1), f"the integrals of {wide} weights for each of {m} samples")
    if h <= 1 + _NO_STEP:
        return interpolated(filter, start + step * np.arange(m, dtype=np.float64), n, boundary, double, prefilter)
    samples = filter.samples if filter.prefilter else np.ones(1)
    response = _impulse_response(samples, _autocorrelation(filter), left_out, filter.name)
    reach = len(response) // 2
    first, weights = _inner_products(filter, start + step * np.arange(-reach, m + reach, dtype=np.float64), h)
    first, weights = _mixed(first, weights, response)
    return _of_samples(filter, first, weights, n, boundary, left_out, prefilter)


def interpolated(filter: Filter, positions: Array, n: int, boundary: Boundary, double: bool, prefilter: bool = True) -> Sums:
    """The spline of `n` samples at `positions`, as sums of samples; parameters as for `least_squares`."""
    base, t = filter.cell(positions)
    return _of_samples(filter, base.astype(np.int64), filter.weights(t).T, n, boundary, _LEFT_OUT[double], prefilter)


def _of_samples(
    filter: Filter, first: NDArray[np.int64], weights: Array, n: int, boundary: Boundary, left_out: float, prefilter: bool
) -> Sums:
    """Convert sums of coefficients from `first` on to sums of samples."""
    if filter.prefilter and prefilter:
        response = _impulse_response(np.ones(1), filter.undone, left_out, filter.name)
        first = first - len(response) // 2
        spread = np.zeros((len(first), weights.shape[1] + len(response) - 1))
        for i, value in enumerate(response):
            spread[:, i : i + weights.shape[1]] += value * weights
        weights = spread
    low, high = _middle(weights, left_out)
    return Sums.of(first + low, np.ascontiguousarray(weights[:, low:high]), n, boundary)


def _middle(weights: Array, left_out: float) -> tuple[int, int]:
    """The range of taps without the outer ones, whose weights add up to less than `left_out` of a row.

    Each impulse response was cut alone; the convolution of two has tails of tails, a third of all taps.
    """
    sizes = np.abs(weights)
    least = left_out / 2 * sizes.sum(1).min()
    low = int(np.searchsorted(np.cumsum(sizes, axis=1).max(0), least, "right"))
    after = int(np.searchsorted(np.cumsum(sizes[:, ::-1], axis=1).max(0), least, "right"))
    return low, max(weights.shape[1] - after, low + 1)


def _autocorrelation(filter: Filter) -> Array:
    """∫ φ(u) φ(u - k) du at k = 0, 1, 2, ..."""
    nodes, lengths = legendre.leggauss(filter.degree + 1)
    w = filter.weights((nodes + 1) / 2)
    return np.array([(w[k:] * w[: len(w) - k] @ lengths).sum() / 2 for k in range(filter.support)])


def _impulse_response(numerator: Array, denominator: Array, left_out: float, name: str) -> Array:
    """The impulse response of a quotient of symmetric sequences, each given from its middle on; cut at `left_out`."""
    omega = 2 * np.pi * np.fft.rfftfreq(_CIRCLE)
    above, below = (2 * np.cos(np.outer(omega, np.arange(b.size))) @ b - b[0] for b in (numerator, denominator))
    if np.abs(below).min() < 1e-6 * np.abs(below).max():
        raise OptionError(f"least-squares reduction needs a kernel whose translates differ; those of {name!r} do not")
    half = np.fft.irfft(above / below, _CIRCLE)[: _CIRCLE // 2]
    half = half[: int(np.flatnonzero(np.abs(half) > left_out * np.abs(half).max())[-1]) + 1]
    return np.concatenate([half[:0:-1], half])


def _inner_products(filter: Filter, x: Array, h: float) -> tuple[NDArray[np.int64], Array]:
    """∫ s(x_j + h u) φ(u) du as sums over coefficients of s: the first coefficients (m,) and the weights (m, taps)."""
    half = filter.support / 2
    left = x - h * half
    knot = np.ceil(left - half) + half  # the knots of s are at integers, or halfway between
    wide = math.ceil(h * filter.support) + 1
    ends = [left[:, None] + h * np.arange(filter.support + 1), np.minimum(knot[:, None] + np.arange(wide), (x + h * half)[:, None])]
    knots = np.sort(np.concatenate(ends, 1), 1)
    lengths = np.diff(knots, axis=1)
    nodes, shares = legendre.leggauss(filter.degree + 1)
    at = knots[:, :-1, None] + lengths[..., None] * ((nodes + 1) / 2)
    mass = lengths[..., None] * shares / 2 * filter((at - x[:, None, None]) / h) / h
    base, t = filter.cell(at)
    first = base.min((1, 2)).astype(np.int64)
    place = (base.astype(np.int64) - first[:, None, None])[..., None] + np.arange(filter.support)
    taps = int(place.max()) + 1
    flat = (np.arange(x.size)[:, None, None, None] * taps + place).ravel()
    terms = (mass[..., None] * np.moveaxis(filter.weights(t), 0, -1)).ravel()
    return first, np.bincount(flat, terms, x.size * taps).astype(np.float64).reshape(x.size, taps)


def _mixed(first: NDArray[np.int64], weights: Array, response: Array) -> tuple[NDArray[np.int64], Array]:
    """Row j of the result is the sum of rows j, j + 1, ..., weighted by `response`."""
    m, taps = len(first) - len(response) + 1, weights.shape[1]
    rows = np.arange(m)
    lowest = np.min([first[i : i + m] for i in (0, len(response) - 1)], 0)
    wide = int(max((first[i : i + m] - lowest).max() for i in (0, len(response) - 1))) + taps
    result = np.zeros((m, wide))
    for i, value in enumerate(response):
        columns = (first[i : i + m] - lowest)[:, None] + np.arange(taps)
        result[rows[:, None], columns] += value * weights[i : i + m]
    return lowest, result


# -- of volumes --------------------------------------------------------------------------------------------------------


def low_passed(volume: Volume, steps: Array, boundary: Boundary, kind: type[np.generic], device: Device) -> Volume:
    """A volume low-passed by a Gaussian for a grid with `steps` samples between points along its axes, x first.

    Along an axis with a step of more than one, the standard deviation is (step - 1) / 2 samples, as in scikit-image.
    """
    volume.require_finite()
    sums = in_order(gaussian_sums(volume.shape, steps, boundary))
    if not sums:
        return volume
    kind, far = wide_enough(kind, volume, bspline(1), boundary), lies_far(volume)
    made = sum_along(volume.data, sums, kind, device, boundary.cval, far=far)
    return replace(volume, data=made)


def smoothed(sums: Sums, sigma: float, boundary: Boundary) -> Sums:
    """The same sums of samples that a Gaussian smoothed first, as sums of the original samples."""
    if sigma <= 0:
        return sums
    from scipy import sparse

    blurred = gaussian(sigma, sums.n, boundary)
    n = sums.n

    def matrix(one: Sums) -> Any:
        """Sums by samples, a sparse matrix; the last column is for the constant outside."""
        rows = np.repeat(np.arange(len(one.places)), one.places.shape[1])
        return sparse.csr_array((one.weights.ravel(), (rows, one.places.ravel())), (len(one.places), n + 1))

    constant = sparse.csr_array(([1.0], ([0], [n])), (1, n + 1))  # does not change
    made = sparse.csr_array(matrix(sums) @ sparse.vstack([matrix(blurred), constant]))
    made.sum_duplicates()
    counts = np.diff(made.indptr)
    at = np.arange(int(counts.max(initial=1)))
    taken = np.minimum(made.indptr[:-1, None] + at, made.indptr[1:, None] - 1)  # shorter rows repeat their last sample, times 0
    return Sums(n, made.indices[taken].astype(np.int32), np.where(at < counts[:, None], made.data[taken], 0.0))


def gaussian_sums(shape: tuple[int, ...], steps: Array, boundary: Boundary) -> dict[int, Sums]:
    """The sums of `low_passed`, by array axis."""
    sigma = np.maximum(0, (steps[::-1] - 1) / 2)
    return {axis: gaussian(float(s), shape[axis], boundary) for axis, s in enumerate(sigma) if s > 0}


def nearest_spline(
    volume: Volume,
    filter: Filter,
    boundary: Boundary,
    kind: type[np.generic],
    device: Device,
    matrix: Array,
    offset: Array,
    shape: tuple[int, ...],
    progress: Callable[[float], Any] | None = None,
) -> NDArray[Any]:
    """Samples of the spline on a grid along the volume's axes that is nearest to the volume's spline; `least_squares` by axis.

    `matrix` and `offset` map the grid's indices, x first, to the volume's. Sums are in float64 if `kind` is, or if float32 would
    lose digits of the samples.
    """
    volume.require_finite()
    sums, kind = nearest_sums(volume, settled(filter, volume), boundary, kind, matrix, offset, shape)
    return sum_along(volume.data, in_order(sums), kind, device, boundary.cval, progress, far=lies_far(volume))


def nearest_sums(
    volume: Volume, filter: Filter, boundary: Boundary, kind: type[np.generic], matrix: Array, offset: Array, shape: tuple[int, ...]
) -> tuple[dict[int, Sums], type[np.generic]]:
    """The sums of `nearest_spline` by array axis, and the type that they are computed in; `filter` is settled."""
    d = volume.ndim
    if (np.abs(matrix - np.diag(np.diag(matrix))) * shape[::-1]).max() >= _NO_STEP:
        raise OptionError(
            "least-squares reduction takes a grid along the volume's axes, and this one is turned: "
            "resample along them first, or take anti_aliasing='gaussian'"
        )
    if filter.prefilter and boundary.period is None:
        raise OptionError(f"least-squares reduction takes a boundary rule that continues the samples; got {boundary.name!r}")
    kind = wide_enough(kind, volume, filter, boundary)
    sums = {
        d - 1 - axis: least_squares(
            filter.along(axis), float(offset[axis]), float(matrix[axis, axis]), shape[d - 1 - axis], n, boundary, kind == np.float64
        )
        for axis, n in enumerate(volume.size)
    }
    return sums, kind


def lies_far(volume: Volume) -> bool:
    """Whether sums of samples are made of their differences, for all samples lie far from zero compared with their range."""
    return is_far(*map(float, volume.limits))


def steps_along(matrix: Array) -> Array:
    """The distance of a grid's points along each axis of a volume, in samples; the root sum of squares for a rotated grid."""
    return np.asarray(np.linalg.norm(matrix, axis=1))


# -- adding up ---------------------------------------------------------------------------------------------------------


def sum_along(
    data: NDArray[Any],
    sums: Mapping[int, Sums],
    kind: type[np.generic],
    device: Device,
    outside: float = 0.0,
    progress: Callable[[float], Any] | None = None,
    *,
    far: bool = False,
) -> NDArray[Any]:
    """Replace axes of an array, of any layout, by sums along them; `kind` is the type of the result and of what is between.

    `outside` is the constant outside. Axes are summed in the order of `sums`: sums of a part are those of the whole to the last bit
    if it is the same; see `in_order`. Where samples lie `far` from zero, and `kind` is float64, each sum is that of differences.
    """
    far = far and kind == np.float64
    if kind == np.float64 and not device.has_double:
        raise DeviceError(f"sums of float64 need a device with double precision; got {device.name!r}, which has none")
    shape, counts = list(data.shape), []
    for axis in sums:
        shape[axis] = len(sums[axis].places)
        counts.append(math.prod(shape))
    most = max((a + b for a, b in itertools.pairwise([0, *counts])), default=data.size)  # two arrays exist at a time
    memory.require(np.dtype(kind).itemsize * most, f"a result of {' × '.join(map(str, shape))} sums")
    for done, axis in enumerate(sums, 1):
        # in place: the kernel gathers lines into scratch first
        if done > 1 and device.shares_memory and len(sums[axis].places) == sums[axis].n:
            _launch(data, axis, data, sums[axis], outside, device, far)
        else:
            data = _sum_axis(data, axis, sums[axis], kind, outside, device, far)
        if progress is not None:
            progress(done / len(sums))
    return np.ascontiguousarray(data, kind)


def in_order(sums: Mapping[int, Sums]) -> dict[int, Sums]:
    """The order in which axes are summed: the axis that shrinks most is first."""
    return dict(sorted(sums.items(), key=lambda one: len(one[1].places) / one[1].n))


def _sum_axis(
    data: NDArray[Any], axis: int, sums: Sums, kind: type[np.generic], outside: float, device: Device, far: bool
) -> NDArray[Any]:
    m = len(sums.places)
    result = np.empty((*data.shape[:axis], m, *data.shape[axis + 1 :]), kind)
    if data.dtype == kind and data.flags.c_contiguous:
        _launch(data, axis, result, sums, outside, device, far)
        return result
    # converted in parts, without a second array of the input's size
    across = next((i for i in range(data.ndim) if i != axis and data.shape[i] > 1), None)
    if across is None:
        _launch(np.ascontiguousarray(data, kind), axis, result, sums, outside, device, far)
        return result
    some = max(1, _SLAB * data.shape[across] // max(1, data.size))
    for start in range(0, data.shape[across], some):
        slab = (slice(None),) * across + (slice(start, start + some),)
        part = np.ascontiguousarray(data[slab], kind)
        made = np.empty((*part.shape[:axis], m, *part.shape[axis + 1 :]), kind)
        _launch(part, axis, made, sums, outside, device, far)
        result[slab] = made
    return result


def _launch(data: NDArray[Any], axis: int, result: NDArray[Any], sums: Sums, outside: float, device: Device, far: bool) -> None:
    """Run the kernel on a contiguous array; `result` may be the same array if it has as many sums as samples."""
    if not result.size:
        return
    kind: type[np.generic] = result.dtype.type
    m, taps = sums.places.shape
    n, outer, inner = sums.n, math.prod(data.shape[:axis]), math.prod(data.shape[axis + 1 :])
    units = -(-outer // _WIDTH) if inner == 1 else outer * -(-inner // _WIDTH)
    items = min(units, _ITEMS_A_CORE * device.units)
    scratch = device.buffers.allocate(data.dtype.itemsize * items * (n + 1) * _WIDTH)
    tables = device.buffers.upload(sums.places), device.buffers.upload(sums.weights.astype(kind))
    uploaded = [device.buffers.upload(one) for one in sums.differences(kind)] if far else []
    defines = {"ALONG": int(inner == 1), "FAR": int(far), "WIDTH": _WIDTH, "COORD_DOUBLE": 0, **scalar_defines(kind)}
    kernel = device.build("spline/reduce.cl", defines).kernel("sum_along_axis")
    some = max(1, device.limits.launch_taps * 32 // (m * taps * _WIDTH))
    try:
        with ExitStack() as lent:
            made = lent.enter_context(device.buffers.lent(result, write=True))
            given = made if result is data else lent.enter_context(device.buffers.lent(data, write=False))
            for first in range(0, units, some):
                count = min(some, units - first)
                with device.errors:
                    kernel(
                        device.queue,
                        (min(items, count),),
                        (1,),
                        given,
                        *map(np.int32, (outer, n, inner, m, taps)),
                        *tables,
                        kind(outside),
                        np.int32(first),
                        np.int32(count),
                        scratch,
                        made,
                        *uploaded,
                    )
                device.finish()
    finally:
        scratch.release()
