"""Errors of reconstructions: filters measured against a known function, or from every n-th sample of a volume.

A volume is low-passed before it is decimated, and most of the difference from the original is then due to the low-pass, not the
filter. So results are compared with the low-passed volume, and the loss from the low-pass is reported separately.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, InitVar, dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from clvol import reference
from clvol.analysis.angle import angle_weights, angles, weighted_quantile
from clvol.analysis.dirichlet import dirichlet_sample, dirichlet_weights
from clvol.analysis.similarity import ssim
from clvol.analysis.table import Table, column
from clvol.analysis.timing import seconds_per_sample
from clvol.analysis.trial import (
    LATTICE,
    Decimation,
    Function,
    Part,
    Trial,
    decimated,
    known,
    lattice_points,
    middle,
    prefiltered,
    root_mean_square,
    sampled,
)
from clvol.base.arrays import Array
from clvol.base.checks import enough_memory, number, one_of, whole
from clvol.base.errors import DataError, DeviceError, OptionError
from clvol.base.progress import Progress, part_of
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter, several_names
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.field import coefficients_of, sample
from clvol.spline.points import sample_coefficients
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume, as_volume

__all__ = ["COMPARED", "EXACT_SINC", "ErrorRow", "ErrorTable", "as_compared", "compare", "require_period", "settled_compared"]

_Angles: TypeAlias = tuple[float | None, float | None, float | None]

_CHUNK = 1 << 20  # positions at a time
_MAX_FACTOR = 1024  # of the decimation
_SINC_PRODUCTS = 1 << 34  # samples × points of the exact sinc, at most
_SHARE = 0.9  # share of the progress for the errors, if times are measured too
_NUMPY = "NumPy, float64"
_LARGEST = 1e305  # largest sample; spline coefficients and gradients are up to some hundred times as large


EXACT_SINC: Final = "exact-sinc"
"""The name of the exact sinc (`clvol.analysis.dirichlet_sample`) wherever filters are compared.

Each value takes all samples, so for more than 85 000 samples fewer random points are measured.
"""

COMPARED: Final = (
    EXACT_SINC,
    "nearest",
    "bspline3-approx",
    "linear",
    "mitchell",
    "catmull-rom",
    "bspline2",
    "bspline3",
    "omoms3",
    "bspline4",
    "bspline5",
    "hybrid",
)
"""The default filters of `compare`."""


@dataclass(frozen=True)
class ErrorRow:
    """The errors of one filter; None where a number does not exist.

    Attributes
    ----------
    filter : str
        Name of the filter.
    rms, maximum : float
        Root mean square and largest error of the values, in the data's units; for a volume without its truth, against the
        low-passed volume.
    original : float or None
        RMS difference from the original samples: `rms` and the loss from the low-pass together. None for a function.
    psnr : float or None
        ``20 log10(range / rms)`` in decibels, with the range of the samples; None for constant data or no error.
    ssim : float or None
        Structural similarity (`ssim`) on a lattice: of half the spacing if the truth is a function, else that of the
        original. Beyond 4 million positions only the middle slices count. None for constant data.
    gradient_rms : float or None
        Root mean square length of the gradient's error, per world unit; None if the filter has no gradient.
    angle_mean, angle_median, angle_95 : float or None
        Angle between the gradient and the true one in degrees: mean, median, 95th percentile, where there is a true
        gradient that is more than noise: see `clvol.analysis.mean_angle`.
    overshoot : float
        Largest excess of values over the range of the samples, in the data's units; 0 if they stay within it. For a volume
        without its truth it is for all samples of the original, half-way between them, where it is likeliest.
    seconds : float or None
        Time per million samples on a device, without the prefilter; None for the exact sinc, without a device, or
        without `timing`.
    """

    filter: str = column("filter")
    rms: float = column("RMS error", ".3g")
    original: float | None = column("and low-pass", ".3g")
    maximum: float = column("max error", ".3g")
    psnr: float | None = column("PSNR (dB)", ".2f")
    ssim: float | None = column("SSIM", ".4f")
    gradient_rms: float | None = column("gradient RMS", ".3g")
    angle_mean: float | None = column("mean angle (°)", ".2f")
    angle_median: float | None = column("median angle (°)", ".2f")
    angle_95: float | None = column("95 % angle (°)", ".2f")
    overshoot: float = column("overshoot", ".3g")
    seconds: float | None = column("s / million", ".3g")


@dataclass(eq=False, repr=False)
class ErrorTable(Table[ErrorRow]):
    """A row for each filter, in the requested order, and what was compared.

    Attributes
    ----------
    samples : Volume
        The input of the filters: samples of the function, or the decimated volume.
    against : str
        The truth in words, and its low-pass.
    lost : float
        RMS loss of the compared original samples from the low-pass, which no filter can restore; 0 without a low-pass.
    shifts : int
        Number of shifts of the decimated grid.
    points : int
        Number of compared positions.
    value_range : (float, float)
        Smallest and largest sample, for `psnr`, `ssim` and `overshoot`.
    boundary : str
        The boundary rule.
    evaluated_on : str
        "NumPy, float64", or the name of the device.
    timed_on : str
        The name of the device; empty if nothing was timed.
    filters : list of Filter
        The compared filters; they need not be registered.
    """

    rows: InitVar[Iterable[ErrorRow]]
    _: KW_ONLY
    samples: Volume
    against: str
    points: int
    boundary: str
    lost: float
    shifts: int
    evaluated_on: str
    timed_on: str
    filters: list[Filter]

    @property
    def value_range(self) -> tuple[float, float]:
        return self.samples.value_range

    def filter(self, name: str) -> Filter:
        """The filter of a row of this table."""
        return next((row for row in self.filters if row.name == name), None) or as_filter(name)

    def best(self, key: str = "rms") -> ErrorRow:
        """The row with the smallest `key` (the largest for "psnr" and "ssim"), of those that have it.

        Raises
        ------
        OptionError
            `key` is not a number of a row, or no row has it.
        """
        names = [f.name for f in self._columns()][1:]
        if key not in names:
            raise one_of("key", key, names)
        having = [row for row in self if getattr(row, key) is not None]
        if not having:
            raise OptionError(f"key must be a number that some row has; got {key!r}, which none has")
        sign = -1 if key in ("psnr", "ssim") else 1
        return min(having, key=lambda row: sign * getattr(row, key))


@enough_memory("what is compared")
def compare(
    source: Volume | ArrayLike | Function,
    filters: Sequence[str | Filter] = COMPARED,
    *,
    truth: Function | None = None,
    gradient: Function | None = None,
    size: int | Sequence[int] = 41,
    domain: tuple[float, float] = (-1.0, 1.0),
    dimensions: int = 3,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    factor: int = 2,
    lowpass: Literal["gaussian", "none"] = "gaussian",
    fractional: int = 4,
    sigma: float | None = None,
    margin: float = 4.0,
    points: int = 200_000,
    seed: int = 0,
    timing: bool = True,
    device: Device | str | int | None = None,
    timing_device: Device | str | int | None = None,
    progress: Progress | None = None,
    max_samples: int = 1 << 25,
) -> ErrorTable:
    """Measure the error of each filter on data with a known truth.

    A function, or a volume with its `truth`, is compared at uniform random points of the world. A volume alone is its own
    truth: it is low-passed, as in Figure 4 of the paper, every `factor`-th sample is kept, and the reconstruction from these is
    compared with the low-passed volume at the original samples. The true gradient is that of the quintic spline through the
    low-passed volume.

    The decimated grid is shifted: it begins at each of the first `factor` samples along every axis in turn, and at positions
    between samples, with values of the low-passed volume's quintic spline. So all distances from a kept sample occur, and no error
    depends on the positions of edges. Without a low-pass the truth between samples is unknown, and only whole shifts are used; then
    "nearest" has two equally near samples half-way, and the hybrid equals there the spline that magnifies.

    Parameters
    ----------
    source : callable, Volume or array-like
        A function of positions (N, d), x first, that returns (N,) values; or 2-D or 3-D samples.
    filters : sequence of str or Filter
        One row each; "exact-sinc" is the exact sinc (not under boundary "zero").
    truth : callable, optional
        The function that the volume samples.
    gradient : callable, optional
        Its gradient, (N, d) at (N, d); by default taken from the function by sixth-order differences.
    size, domain, dimensions
        For a function: samples along each axis (or (nz, ny, nx)); the outer ones are on the faces of
        ``[low, high]**dimensions``.
    boundary : str or Boundary
        As for `clvol.sample`.
    factor : int
        Of the decimation, 2 to 1024.
    lowpass : {"gaussian", "none"}
        Before the decimation: a Gaussian of standard deviation ``factor / 2`` samples, or nothing.
    fractional : int
        Number of shifts of a low-passed volume that lie between samples.
    sigma : float, optional
        Standard deviation of the noise of a volume's samples, to select gradients above the noise; estimated by default.
    margin : float
        Number of kept samples along each face that are not compared, since the boundary rule affects them; fewer on axes
        shorter than four times the margin.
    points : int
        Number of random positions, or of random gradients of a decimated volume.
    seed : int
        Of the random positions.
    timing : bool
        Measure the time per million samples at random positions, if there is a device.
    device : Device, str or int, optional
        Compute the values on this device, in float32; default: in float64 by `clvol.reference`.
    timing_device : Device, str or int, optional
        Where times are measured; default: `device`, or the default device.
    progress : callable, optional
        Called with the fraction done.
    max_samples : int
        Number of compared samples of a decimated volume, over all shifts; of more, each shift compares some slices.

    Returns
    -------
    ErrorTable

    Raises
    ------
    OptionError
        An unknown name, a number outside its bounds, or a function that fails or returns numbers that are not finite.
    DataError
        NaN or infinite samples, or some beyond ±10³⁰⁵, whose spline coefficients may overflow.
    OutOfMemoryError
        More samples or points than fit into memory.

    Examples
    --------
    >>> from clvol import analysis, phantoms
    >>> table = analysis.compare(phantoms.marschner_lobb_function, ["linear", "bspline3"], points=2000, timing=False)
    >>> table.best("rms").filter
    'bspline3'
    """
    chosen, rule = as_compared(filters), as_boundary(boundary)
    points, factor = whole("points", points, 1), whole("factor", factor, 2, _MAX_FACTOR)
    rng = np.random.default_rng(whole("seed", seed, 0))
    fractional = whole("fractional", fractional, 0)
    sigma = None if sigma is None else number("sigma", sigma, minimum=0)
    margin, max_samples = number("margin", margin, minimum=0), whole("max_samples", max_samples, 1)
    on = None if device is None else as_device(device)
    clock = _clock(timing_device, on) if timing else None
    require_period(chosen, rule)
    if callable(source):
        if truth is not None:
            raise OptionError("truth must be given with a volume only; got it with a function, which is its own")
        truth, volume = source, sampled(source, size, domain, dimensions)
    else:
        volume = as_volume(source)
        volume.require_finite()
        volume = replace(volume, data=volume.data.astype(np.float64))
    low, high = volume.value_range
    if max(-low, high) > _LARGEST:
        raise DataError(f"samples must lie within ±{_LARGEST:g}, to leave room for splines; got {low:g} to {high:g}")
    chosen = settled_compared(chosen, volume)
    if truth is None:
        if gradient is not None:
            raise OptionError("gradient must be that of a function; got it with a volume without its truth")
        sigma = volume.noise.sigma if sigma is None else sigma
        trial = decimated(volume, Decimation(factor, lowpass, fractional, margin, max_samples), sigma, points, rule, rng)
    else:
        trial = known(volume, truth, gradient, margin, points, rng)
    report, share = progress or (lambda _: None), 1.0 if clock is None else _SHARE
    rows = []
    for done, row in enumerate(chosen, 1):
        rows.append(_measure(trial, row, rule, on))
        report(share * done / len(chosen))
    ours = [row for row in chosen if isinstance(row, Filter)]
    if clock is not None:
        seconds = iter(seconds_per_sample(trial.samples, ours, rule, clock, part_of(report, share, 1)))
        for i, row in enumerate(chosen):
            if isinstance(row, Filter):
                rows[i] = replace(rows[i], seconds=1e6 * next(seconds))
        report(1.0)
    return ErrorTable(
        rows,
        samples=trial.samples,
        against=trial.against,
        points=sum(part.points.shape[0] for part in trial.parts),
        boundary=rule.name,
        lost=trial.lost,
        shifts=len(trial.parts),
        evaluated_on=_NUMPY if on is None else on.name,
        timed_on="" if clock is None else clock.name,
        filters=ours,
    )


def _clock(named: Device | str | int | None, on: Device | None) -> Device | None:
    """The device to time; None if none is usable and none was named."""
    try:
        device = on if named is None and on is not None else as_device(named)
        device.require_usable()
    except DeviceError:
        if named is not None:
            raise
        return None
    return device


def as_compared(filters: Sequence[str | Filter], maximum: int | None = None) -> list[str | Filter]:
    """One or more filters, at most `maximum`; the exact sinc, which is not a `Filter`, remains a name."""
    chosen = several_names(filters, maximum)
    return [EXACT_SINC if isinstance(f, str) and f.strip().lower() == EXACT_SINC else as_filter(f) for f in chosen]


def settled_compared(chosen: Sequence[str | Filter], volume: Volume) -> list[str | Filter]:
    """The filters of `as_compared`, with smoothing settled for a volume."""
    return [settled(row, volume) if isinstance(row, Filter) else row for row in chosen]


def require_period(chosen: Sequence[str | Filter], rule: Boundary) -> None:
    """`OptionError` if the exact sinc is compared under a boundary rule that does not repeat the samples."""
    if EXACT_SINC in chosen and not rule.repeats:
        raise OptionError(f"boundary must be mirror, reflect or wrap for {EXACT_SINC!r}; got {rule.name!r}")


# -- the errors ----------------------------------------------------------------------------------------------


def _measure(trial: Trial, row: str | Filter, rule: Boundary, on: Device | None) -> ErrorRow:
    low, high = trial.samples.value_range
    span = high - low
    errors, before, similar, slopes, leaving = [], [], [], [], 0.0
    for part in trial.parts:
        if row == EXACT_SINC:
            part = part.first(max(1, _SINC_PRODUCTS // (part.samples.data.size * len(trial.parts))))
        drawn = row
        if on is None and isinstance(row, Filter):
            coefficients, drawn = prefiltered(part.samples.data, row, rule)
            part = replace(part, samples=replace(part.samples, data=coefficients))
        fine = _on_lattice(part, drawn, rule, on)
        if part.values is None:
            got, true = fine, part.lattice
        else:
            got, true = _at_points(part, drawn, rule, on, 0), part.values
            leaving = max(0.0, float(got.max()) - high, low - float(got.min()))
        errors.append((got - true).ravel())
        if part.original is not None:
            before.append((got - part.original).ravel())
        if span > 0:
            similar.append((ssim(_middle_of(fine), _middle_of(part.lattice), span), fine.size))
        if row == EXACT_SINC or as_filter(row).has_gradient:
            slopes.append((part.gradients, _at_points(part, drawn, rule, on, 1)))
    if trial.scan is not None:
        leaving = overshoot(trial.scan, row, rule)
    error = np.concatenate(errors)
    rms = root_mean_square(error)
    slope_rms: float | None = None
    between: _Angles = (None, None, None)
    if slopes:
        slope_rms, between = _gradient_errors(trial, *(np.concatenate(both) for both in zip(*slopes, strict=True)))
    return ErrorRow(
        row.name if isinstance(row, Filter) else row,
        rms,
        root_mean_square(np.concatenate(before)) if before else None,
        float(np.abs(error).max()),
        20 * (math.log10(span) - math.log10(rms)) if span > 0 and rms > 0 else None,
        sum(value * n for value, n in similar) / sum(n for _, n in similar) if similar else None,
        slope_rms,
        *between,
        leaving,
        None,
    )


def _middle_of(lattice: Array) -> Array:
    """The middle slices on which similarity is judged."""
    return np.asarray(lattice[middle(np.arange(lattice.shape[0]), lattice[0].size, LATTICE)])


def overshoot(volume: Volume, row: str | Filter, rule: Boundary) -> float:
    """The largest excess of a reconstruction over the range of its samples, in their units; 0 if it stays within it.

    It is evaluated half-way between samples along one axis, two or three, where filters ring most.
    """
    low, high = volume.value_range
    if low == high or (isinstance(row, Filter) and keeps_range(row)):
        return 0.0
    if isinstance(row, Filter) and row.magnified_by is not None and row.interpolates_directly:
        return overshoot(volume, row.magnified_by, rule)  # half-way between samples they are equal
    data: Array = volume.data.astype(np.float64)
    if isinstance(row, Filter):
        data, row = prefiltered(data, row, rule)
    least, most = low, high
    thickness = max(1, _CHUNK // (data.size // data.shape[0]))
    for shift in itertools.product((0.0, 0.5), repeat=data.ndim):
        axes = [np.arange(n - 1 if s else n) + s for n, s in zip(data.shape, shift, strict=True)]
        if not all(axis.size for axis in axes):
            continue
        for first in range(0, axes[0].size, thickness):
            part = lattice_of(data, [axes[0][first : first + thickness], *axes[1:]], row, rule)
            least, most = min(least, float(part.min())), max(most, float(part.max()))
    return max(low - least, most - high)


def keeps_range(row: Filter) -> bool:
    """Whether values always stay within the range of the samples: its weights, none negative, sum to one."""
    if row.magnified_by is not None and not keeps_range(row.magnified_by):
        return False
    return not row.prefilter and row.sums_to_one and bool((row.weights(np.linspace(0, 1, 257)) >= -1e-12).all())


def _at_points(part: Part, row: str | Filter, rule: Boundary, on: Device | None, derivative: int) -> Array:
    if not isinstance(row, Filter):
        return dirichlet_sample(part.samples, part.points, rule, derivative)
    if on is None:
        return reference.sample(part.samples, part.points, row, rule, derivative)
    return sample(part.samples, part.points, row, rule, derivative, device=on).astype(np.float64)


def _on_lattice(part: Part, row: str | Filter, rule: Boundary, on: Device | None) -> Array:
    if on is None or not isinstance(row, Filter):
        return lattice_of(part.samples.data, part.axes, row, rule)
    result = np.empty([a.size for a in part.axes])
    evaluator = choose_evaluator(on, row)
    thickness = max(1, _CHUNK // (result.size // result.shape[0]))
    with coefficients_of(part.samples, row, rule, on) as resident:
        for first in range(0, result.shape[0], thickness):
            axes = [part.axes[0][first : first + thickness], *part.axes[1:]]
            world = part.samples.index_to_world(lattice_points(axes))
            values = sample_coefficients(resident, evaluator, world)
            result[first : first + thickness] = values.reshape([a.size for a in axes])
    return result


def lattice_of(data: Array, axes: Sequence[Array], row: str | Filter, rule: Boundary) -> Array:
    """Values at all combinations of positions, z first, in float64."""
    if isinstance(row, Filter):
        data, row = prefiltered(data, row, rule)
        return reference.lattice(data, axes, row, rule)
    for axis, positions in enumerate(axes):
        weights = dirichlet_weights(positions, data.shape[axis], rule)
        data = np.moveaxis(np.tensordot(weights, data, (1, axis)), 0, axis)
    return np.ascontiguousarray(data)


def _gradient_errors(trial: Trial, true: Array, got: Array) -> tuple[float, _Angles]:
    """The RMS length of the error, and the mean, median and 95th percentile of the angle in degrees."""
    rms = root_mean_square(got - true) * math.sqrt(true.shape[-1])
    low, high = trial.samples.value_range
    weights = angle_weights(true, trial.sigma)
    weights[np.abs(true).max(-1) < 1e-9 * (high - low) / min(trial.samples.spacing)] = 0  # rounding errors
    total = float(weights.sum())
    if high == low or total == 0:
        return rms, (None, None, None)
    between = angles(got, true)
    median, most = (weighted_quantile(between, weights, share) for share in (0.5, 0.95))
    return rms, (float((weights * between).sum()) / total, median, most)
