"""How far reconstructions are from the truth: filters measured against a known function, or from every n-th sample.

What is decimated has to be low-passed first, and most of what then differs from the original is that low-pass, which is no
filter's fault. So results are compared with what was sampled, the low-passed volume, and what the low-pass took is said apart.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import reference
from clvol.analysis.angle import angle_weights, angles, weighted_quantile
from clvol.analysis.dirichlet import dirichlet_sample, dirichlet_weights
from clvol.analysis.similarity import ssim
from clvol.analysis.table import Table, column
from clvol.analysis.timing import seconds_per_sample
from clvol.base.arrays import reals
from clvol.base.checks import enough_memory, number, one_of, require_room, whole
from clvol.base.errors import ClvolError, DataError, DeviceError, OptionError
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.response import prefilter_response
from clvol.filter.table import as_filter, several_names
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.field import coefficients_of, sample
from clvol.spline.points import sample_coefficients
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume, as_volume

__all__ = ["COMPARED", "EXACT_SINC", "ErrorRow", "ErrorTable", "as_compared", "compare", "require_period", "settled_compared"]

Array: TypeAlias = NDArray[np.float64]
Function: TypeAlias = Callable[[Array], ArrayLike]
_Angles: TypeAlias = tuple[float | None, float | None, float | None]

_LATTICE = 1 << 22  # max positions at which similarity is judged; of more, the middle slices
_MAX_FACTOR = 1024  # of the decimation
_CHUNK = 1 << 20  # positions at a time
_SINC_PRODUCTS = 1 << 34  # of the exact sinc at scattered points: each takes all samples
_SHARE = 0.9  # of the progress: errors, if times are measured too
_SHIFTS = 27  # of a decimated grid by whole samples; of more, so many by chance
_NUMPY = "NumPy, float64"
_DENSE = 512  # samples along an axis for which the inverse of eq. (11) is held
_LARGEST = 1e305  # samples: coefficients of splines through them, and gradients, are up to some hundred times as large

EXACT_SINC: Final = "exact-sinc"
"""The name of the exact sinc, `clvol.analysis.dirichlet_sample`, wherever filters are compared.

Each of its values takes all samples, so for more than 85 000 samples fewer random points are measured.
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
        Root mean square and largest error of the values, in the data's units; of a volume without its truth, against what
        was sampled: the low-passed volume.
    original : float or None
        RMS difference from the original samples: `rms` and what the low-pass took, together. None for a function.
    psnr : float or None
        ``20 log10(range / rms)`` in decibels, with the range of the samples; None for constant data or no error.
    ssim : float or None
        Structural similarity (`ssim`) on a lattice: of half the spacing if the truth is a function, else that of the
        original. Of more than 4 million positions the middle slices count. None for constant data.
    gradient_rms : float or None
        Root mean square length of the gradient's error, per world unit; None if the filter has no gradient.
    angle_mean, angle_median, angle_95 : float or None
        Angle between the gradient and the true one in degrees: mean, median, 95th percentile, where there is a true
        gradient that is more than noise: see `clvol.analysis.mean_angle`.
    overshoot : float
        How far the values leave the range of the samples, in the data's units; 0 if they do not. Of a volume without its
        truth: drawn from all samples of the original, half-way between those where it is likeliest.
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


class ErrorTable(Table[ErrorRow]):
    """A row for each filter, in the requested order, and what was compared with what.

    Attributes
    ----------
    samples : Volume
        What the filters reconstructed from: samples of the function, or the decimated volume.
    against : str
        The truth, in words: what was low-passed too.
    lost : float
        RMS of what the low-pass took from the original samples that are compared: no filter can bring it back. 0 without.
    shifts : int
        In how many places the decimated grid was put.
    points : int
        Number of compared positions.
    value_range : (float, float)
        Smallest and largest sample: what `psnr`, `ssim` and `overshoot` refer to.
    boundary : str
        The boundary rule.
    evaluated_on : str
        "NumPy, float64", or the name of the device.
    timed_on : str
        The name of the device; empty if nothing was timed.
    filters : list of Filter
        The compared filters; they need not be registered.
    """

    def __init__(
        self,
        rows: Iterable[ErrorRow],
        *,
        samples: Volume,
        against: str,
        points: int,
        boundary: str,
        lost: float = 0.0,
        shifts: int = 1,
        evaluated_on: str,
        timed_on: str,
        filters: Iterable[Filter] = (),
    ) -> None:
        super().__init__(rows)
        self.samples = samples
        self.against = against
        self.points = points
        self.lost = lost
        self.shifts = shifts
        self.value_range = samples.value_range
        self.boundary = boundary
        self.evaluated_on = evaluated_on
        self.timed_on = timed_on
        self.filters = list(filters)

    def filter(self, name: str) -> Filter:
        """The filter that a row of this table names."""
        return next((row for row in self.filters if row.name == name), None) or as_filter(name)

    def best(self, key: str = "rms") -> ErrorRow:
        """The row with the smallest `key` (the largest for "psnr" and "ssim"), of those that have it.

        Raises
        ------
        OptionError
            `key` is none of the numbers of a row, or no row has it.
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
    progress: Callable[[float], Any] | None = None,
    max_samples: int = 1 << 25,
) -> ErrorTable:
    """Measure the error of each filter on data whose truth is known.

    A function, or a volume with its `truth`, is compared at uniform random points of the world. A volume alone is its own
    truth: it is low-passed, as in Figure 4 of the paper, every `factor`-th sample of that is kept, and what is reconstructed from
    these is compared with what was sampled, the low-passed volume, at the places of the original samples. The true gradient is
    that of the quintic spline through the low-passed volume.

    The kept samples begin at each of the first `factor` along every axis in turn, and at places between them, where the
    low-passed volume is taken from its quintic spline: so all distances from a kept sample occur, and no error depends on where
    edges happen to lie. Without a low-pass there is no telling what lies between samples, and only whole shifts are made; then
    "nearest" has two equally near samples half-way, and the hybrid equals there the spline by which it magnifies.

    Parameters
    ----------
    source : callable, Volume or array-like
        A function of positions (N, d), x first, that gives (N,) values; or 2-D or 3-D samples.
    filters : sequence of str or Filter
        One row each; "exact-sinc" is the exact sinc (not under boundary "zero").
    truth : callable, optional
        The function that the volume samples.
    gradient : callable, optional
        Its gradient, (N, d) at (N, d); by default taken from the function by sixth-order differences.
    size, domain, dimensions
        For a function: samples along each axis (or (nz, ny, nx)), of which the outer ones lie on the faces of
        ``[low, high]**dimensions``.
    boundary : str or Boundary
        As for `clvol.sample`.
    factor : int
        Of the decimation, 2 to 1024.
    lowpass : {"gaussian", "none"}
        Before the decimation: a Gaussian of standard deviation ``factor / 2`` samples, or nothing.
    fractional : int
        How many of the shifts of a low-passed volume lie between samples.
    sigma : float, optional
        Standard deviation of the noise of a volume's samples, to tell where its gradients are more than noise; estimated by
        default.
    margin : float
        How many kept samples along each face are left out, because the boundary rule decides there; fewer on axes
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
        How many samples of a decimated volume are compared, over all shifts; of more, each shift compares some slices.

    Returns
    -------
    ErrorTable

    Raises
    ------
    OptionError
        An unknown name, a number outside its bounds, or a function that fails or does not give finite numbers.
    DataError
        NaN or infinite samples, or some beyond ±10³⁰⁵: float64 does not hold the coefficients of splines through them.
    OutOfMemoryError
        More samples or points than fit into memory.
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
        truth, volume = source, _sampled(source, size, domain, dimensions)
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
        trial = _held_back(volume, factor, lowpass, fractional, sigma, margin, points, rule, rng, max_samples)
    else:
        trial = _known(volume, truth, gradient, margin, points, rng)
    report, share = progress or (lambda _: None), 1.0 if clock is None else _SHARE
    rows = []
    for done, row in enumerate(chosen, 1):
        rows.append(_measure(trial, row, rule, on))
        report(share * done / len(chosen))
    ours = [row for row in chosen if isinstance(row, Filter)]
    if clock is not None:
        seconds = iter(seconds_per_sample(trial.samples, ours, rule, clock, lambda done: report(share + (1 - share) * done)))
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
    """The device to time, or None if there is none and none was named."""
    try:
        device = on if named is None and on is not None else as_device(named)
        device.require_usable()
    except DeviceError:
        if named is not None:
            raise
        return None
    return device


def as_compared(filters: Sequence[str | Filter], maximum: int | None = None) -> list[str | Filter]:
    """One or more filters, at most `maximum`; the name of the exact sinc stays a name."""
    chosen = several_names(filters, maximum)
    return [EXACT_SINC if isinstance(f, str) and f.strip().lower() == EXACT_SINC else as_filter(f) for f in chosen]


def settled_compared(chosen: Sequence[str | Filter], volume: Volume) -> list[str | Filter]:
    """What `as_compared` gave, the smoothing of filters settled for a volume."""
    return [settled(row, volume) if isinstance(row, Filter) else row for row in chosen]


def require_period(chosen: Sequence[str | Filter], rule: Boundary) -> None:
    """Raise `OptionError` if the exact sinc is among the compared under a boundary rule that does not repeat the samples."""
    if EXACT_SINC in chosen and not rule.repeats:
        raise OptionError(f"boundary must be mirror, reflect or wrap for {EXACT_SINC!r}; got {rule.name!r}")


# -- the truth ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """Samples to reconstruct from, and the truth: at scattered points, and on a lattice."""

    samples: Volume
    points: Array  # world, (N, d)
    values: Array | None  # true ones at `points`; None: those of the lattice are compared
    gradients: Array  # true ones at `points`, (N, d)
    axes: list[Array]  # of the lattice, in samples, z first
    lattice: Array  # true values there
    original: Array | None = None  # values there before the low-pass

    def first(self, count: int) -> _Part:
        """The first `count` of the points, which are in random order."""
        values = None if self.values is None else self.values[:count]
        return replace(self, points=self.points[:count], values=values, gradients=self.gradients[:count])


@dataclass(frozen=True)
class _Trial:
    """What filters are measured by: one part, or a part for each place of the decimated grid."""

    parts: list[_Part]
    against: str
    scan: Volume | None = None  # the volume that was decimated
    lost: float = 0.0
    sigma: float = 0.0  # of each component of the true gradients

    @property
    def samples(self) -> Volume:
        return self.parts[0].samples


def _known(
    volume: Volume, truth: Function, gradient: Function | None, margin: float, points: int, rng: np.random.Generator
) -> _Trial:
    require_room("points", points, points)
    low, high = _inside(volume, margin)
    world = volume.index_to_world(rng.uniform(low, high, (points, volume.ndim)))
    values = _ask(truth, world, "the function", 1)
    slopes = _differences(truth, world, min(volume.spacing)) if gradient is None else _ask(gradient, world, "the gradient", 2)
    axes = [np.arange(a, b + 0.25, 0.5) for a, b in zip(low[::-1], high[::-1], strict=True)]
    axes[0] = _middle(axes[0], math.prod(a.size for a in axes[1:]), _LATTICE)
    fine = _ask(truth, volume.index_to_world(_lattice_points(axes)), "the function", 1).reshape([a.size for a in axes])
    return _Trial([_Part(volume, world, values, slopes, axes, fine)], f"the function at {points} random points")


def _held_back(
    original: Volume,
    factor: int,
    lowpass: str,
    fractional: int,
    sigma: float,
    margin: float,
    points: int,
    rule: Boundary,
    rng: np.random.Generator,
    max_samples: int,
) -> _Trial:
    if lowpass not in ("gaussian", "none"):
        raise one_of("lowpass", lowpass, ("gaussian", "none"))
    width = factor / 2 if lowpass == "gaussian" else 0.0
    smooth = original.gaussian([width * s for s in original.spacing]) if width else original
    shifts = _shifts(original.size, factor, fractional if width else 0, rng)
    quintic, drawn = _prefiltered(smooth.data, as_filter("bspline5"), rule)
    coefficients = replace(smooth, data=quintic)
    grids = [(shift, _decimated(smooth, quintic, drawn, factor, shift, rule)) for shift in shifts]
    places = [_compared(samples, shift, factor, original.shape, margin) for shift, samples in grids]
    parts, lost = [], []
    for i, ((shift, samples), kept) in enumerate(zip(grids, places, strict=True)):
        if not all(k.size for k in kept):
            continue
        kept[0] = _slab(kept[0], math.prod(k.size for k in kept[1:]), max_samples // len(grids), i / max(1, len(grids) - 1))
        count = math.prod(k.size for k in kept)
        some = rng.choice(count, min(math.ceil(points / len(grids)), count), replace=False)
        index = np.stack([k[j] for k, j in zip(kept, np.unravel_index(some, [k.size for k in kept]), strict=True)][::-1], -1)
        world = original.index_to_world(index)
        slopes = reference.sample(coefficients, world, drawn, rule, derivative=1)
        axes = [(k - s) / factor for k, s in zip(kept, shift[::-1], strict=True)]
        sampled, before = smooth.data[np.ix_(*kept)], original.data[np.ix_(*kept)]
        lost.append((before - sampled).ravel())
        parts.append(_Part(samples, world, None, slopes, axes, sampled, before))
    wide = "1 sample" if width == 1 else f"{width:g} samples"
    what = f"the volume low-passed by a Gaussian of standard deviation {wide}" if width else "the volume"
    count = sum(part.lattice.size for part in parts)
    return _Trial(
        parts,
        f"{count} samples of {what}, drawn from every {_ordinal(factor)} along each axis, beginning in {len(parts)} places",
        original,
        _root_mean_square(np.concatenate(lost)),
        _slope_noise(sigma, width, original.spacing),
    )


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


def _shifts(size: Sequence[int], factor: int, fractional: int, rng: np.random.Generator) -> list[Array]:
    """Where the kept samples begin, in samples, x first: at whole ones, the first of all first, and between them."""
    every = [range(min(factor, n)) for n in size]
    count = math.prod(len(e) for e in every)
    chosen: NDArray[Any] = np.arange(count)
    if count > _SHIFTS:
        chosen = np.concatenate([[0], 1 + np.sort(rng.choice(count - 1, _SHIFTS - 1, replace=False))])
    whole_ones = np.stack(np.unravel_index(chosen, [len(e) for e in every][::-1])[::-1], -1).astype(np.float64)
    between = rng.uniform(0, 1, (fractional, len(size))) * [min(factor, n - 1) for n in size]
    return [*whole_ones, *between]


def _decimated(smooth: Volume, quintic: Array, drawn: Filter, factor: int, shift: Array, rule: Boundary) -> Volume:
    """Every `factor`-th sample, or value of the quintic spline with such coefficients, from `shift` on."""
    axes = [np.arange(s, n - 1 + 1e-9, factor) for s, n in zip(shift[::-1], smooth.shape, strict=True)]
    if all(s == int(s) for s in shift):
        data = smooth.data[np.ix_(*(a.astype(np.int64) for a in axes))]
    else:
        data = reference.lattice(quintic, axes, drawn, rule)
    origin = tuple(smooth.index_to_world(shift))
    return replace(smooth, data=data, spacing=tuple(s * factor for s in smooth.spacing), origin=origin)


def _compared(samples: Volume, shift: Array, factor: int, shape: Sequence[int], margin: float) -> list[NDArray[np.int64]]:
    """Indices of the original samples that are compared, z first."""
    low, high = (bound * factor + shift for bound in _inside(samples, margin))
    return [
        np.arange(math.ceil(a - 1e-9), min(math.floor(b + 1e-9), n - 1) + 1)
        for a, b, n in zip(low[::-1], high[::-1], shape, strict=True)
    ]


def _slab(positions: NDArray[Any], others: int, room: int, share: float) -> NDArray[Any]:
    """As many neighbouring positions as give at most `room` with `others` along the other axes, `share` of the way along."""
    count = min(positions.size, max(1, room // others))
    first = round((positions.size - count) * share)
    return positions[first : first + count]


def _slope_noise(sigma: float, width: float, spacing: Sequence[float]) -> float:
    """What white noise is in a component of the quintic spline's gradient, after a Gaussian of `width` samples."""
    w = (np.arange(256) + 0.5) * np.pi / 256
    row = as_filter("bspline5")
    slope = sum(2 * abs(float(row(float(k), 1))) * np.sin(k * w) for k in (1, 2)) * prefilter_response(row, w)
    passed = np.exp(-((width * w) ** 2))
    gain = float((slope**2 * passed).mean()) * float(passed.mean()) ** (len(spacing) - 1)
    return sigma * math.sqrt(gain * float(np.mean([1 / s**2 for s in spacing])))


def _sampled(function: Function, size: int | Sequence[int], domain: tuple[float, float], dimensions: int) -> Volume:
    d = whole("dimensions", dimensions, 2, 3)
    sizes = [size] * d if isinstance(size, (int, np.integer)) and not isinstance(size, bool) else size
    if not isinstance(sizes, (list, tuple)) or len(sizes) != d:
        raise OptionError(f"size must be a whole number of at least 2, or {d} of them; got {size!r}")
    shape = tuple(whole("size", n, 2) for n in sizes)
    require_room("size", math.prod(shape), size)
    ends = reals("domain", domain)
    if ends.shape != (2,) or not np.isfinite(ends).all() or not ends[0] < ends[1]:
        raise OptionError(f"domain must be two numbers, the lower first; got {domain!r}")
    low, high = float(ends[0]), float(ends[1])
    grid = Volume(np.broadcast_to(0.0, shape), tuple((high - low) / (n - 1) for n in shape[::-1]), (low,) * d)
    points = _lattice_points([np.linspace(low, high, n) for n in shape])
    return replace(grid, data=_ask(function, points, "the function", 1).reshape(shape))


def _ask(function: Function, points: Array, what: str, axes: int) -> Array:
    """Values (N,) or gradients (N, d) of a user's function at points (N, d)."""
    rule = "one finite value for each position" if axes == 1 else "a finite vector for each position"
    shape = points.shape[:axes]
    parts = []
    for first in range(0, points.shape[0], _CHUNK):
        part = points[first : first + _CHUNK]
        try:
            given = function(part.copy())
        except ClvolError:
            raise
        except Exception as error:
            raise OptionError(f"{what} must give {rule}; it failed: {error!r}") from error
        values = reals(f"what {what} gives", given, rule)
        if values.shape != (part.shape[0], *shape[1:]) or not np.isfinite(values).all():
            bad = "" if np.isfinite(values).all() else ", with values that are not finite"
            raise OptionError(f"{what} must give {rule}; got shape {values.shape} for positions {part.shape}{bad}")
        parts.append(values)
    return np.concatenate(parts)


def _differences(function: Function, points: Array, spacing: float) -> Array:
    """The gradient by sixth-order central differences, a hundredth of a sample apart."""
    h, d = spacing / 100, points.shape[1]
    result = np.zeros_like(points)
    for axis, (k, weight) in itertools.product(range(d), ((1, 45 / 60), (2, -9 / 60), (3, 1 / 60))):
        shift = np.zeros(d)
        shift[axis] = k * h
        ahead, behind = (_ask(function, points + sign * shift, "the function", 1) for sign in (1, -1))
        result[:, axis] += weight * (ahead - behind) / h
    return result


def _inside(volume: Volume, margin: float) -> tuple[Array, Array]:
    """First and last index that is compared, x first."""
    last = np.asarray(volume.size) - 1.0
    skipped = np.minimum(margin, last / 4)
    return skipped, last - skipped


def _middle(positions: NDArray[Any], others: int, room: int) -> NDArray[Any]:
    """The middle positions, as many as give at most `room` together with `others` along the other axes."""
    count = min(positions.size, max(1, room // others))
    first = (positions.size - count) // 2
    return positions[first : first + count]


def _middle_of(lattice: Array) -> Array:
    """The middle slices on which similarity is judged."""
    return np.asarray(lattice[_middle(np.arange(lattice.shape[0]), lattice[0].size, _LATTICE)])


def _lattice_points(axes: Sequence[Array]) -> Array:
    """All combinations, x first; shape (N, d)."""
    return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")][::-1], -1)


# -- the errors ----------------------------------------------------------------------------------------------


def _measure(trial: _Trial, row: str | Filter, rule: Boundary, on: Device | None) -> ErrorRow:
    low, high = trial.samples.value_range
    span = high - low
    errors, before, similar, slopes, leaving = [], [], [], [], 0.0
    for part in trial.parts:
        if row == EXACT_SINC:
            part = part.first(max(1, _SINC_PRODUCTS // (part.samples.data.size * len(trial.parts))))
        drawn = row
        if on is None and isinstance(row, Filter):
            coefficients, drawn = _prefiltered(part.samples.data, row, rule)
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
    rms = _root_mean_square(error)
    slope_rms: float | None = None
    between: _Angles = (None, None, None)
    if slopes:
        slope_rms, between = _gradient_errors(trial, *(np.concatenate(both) for both in zip(*slopes, strict=True)))
    return ErrorRow(
        row.name if isinstance(row, Filter) else row,
        rms,
        _root_mean_square(np.concatenate(before)) if before else None,
        float(np.abs(error).max()),
        20 * (math.log10(span) - math.log10(rms)) if span > 0 and rms > 0 else None,
        sum(value * n for value, n in similar) / sum(n for _, n in similar) if similar else None,
        slope_rms,
        *between,
        leaving,
        None,
    )


def overshoot(volume: Volume, row: str | Filter, rule: Boundary) -> float:
    """How far a reconstruction leaves the range of its samples, in their units: 0 if it does not.

    Looked for half-way between samples along one axis, two or three, where filters ring most.

    Parameters
    ----------
    volume : Volume
        2-D or 3-D, finite samples.
    row : Filter, or "exact-sinc"
    rule : Boundary
    """
    low, high = volume.value_range
    if low == high or (isinstance(row, Filter) and keeps_range(row)):
        return 0.0
    if isinstance(row, Filter) and row.magnified_by is not None and row.interpolates_directly:
        return overshoot(volume, row.magnified_by, rule)  # half-way between samples they are equal
    data: Array = volume.data.astype(np.float64)
    if isinstance(row, Filter):
        data, row = _prefiltered(data, row, rule)
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
    """Whether values can never leave the range of the samples.

    So it is where weights of the samples themselves sum to one and none is negative: every value is a mean of samples then.
    """
    if row.magnified_by is not None and not keeps_range(row.magnified_by):
        return False
    return not row.prefilter and row.sums_to_one and bool((row.weights(np.linspace(0, 1, 257)) >= -1e-12).all())


def _at_points(trial: _Part, row: str | Filter, rule: Boundary, on: Device | None, derivative: int) -> Array:
    if not isinstance(row, Filter):
        return dirichlet_sample(trial.samples, trial.points, rule, derivative)
    if on is None:
        return reference.sample(trial.samples, trial.points, row, rule, derivative)
    return sample(trial.samples, trial.points, row, rule, derivative, device=on).astype(np.float64)


def _on_lattice(trial: _Part, row: str | Filter, rule: Boundary, on: Device | None) -> Array:
    if on is None or not isinstance(row, Filter):
        return lattice_of(trial.samples.data, trial.axes, row, rule)
    result = np.empty([a.size for a in trial.axes])
    evaluator = choose_evaluator(on, row)
    thickness = max(1, _CHUNK // (result.size // result.shape[0]))
    with coefficients_of(trial.samples, row, rule, on) as resident:
        for first in range(0, result.shape[0], thickness):
            axes = [trial.axes[0][first : first + thickness], *trial.axes[1:]]
            world = trial.samples.index_to_world(_lattice_points(axes))
            values = sample_coefficients(resident, evaluator, world)
            result[first : first + thickness] = values.reshape([a.size for a in axes])
    return result


def lattice_of(data: Array, axes: Sequence[Array], row: str | Filter, rule: Boundary) -> Array:
    """Values at all combinations of positions, in float64."""
    if isinstance(row, Filter):
        data, row = _prefiltered(data, row, rule)
        return reference.lattice(data, axes, row, rule)
    for axis, positions in enumerate(axes):
        weights = dirichlet_weights(positions, data.shape[axis], rule)
        data = np.moveaxis(np.tensordot(weights, data, (1, axis)), 0, axis)
    return np.ascontiguousarray(data)


def _prefiltered(data: Array, row: Filter, rule: Boundary) -> tuple[Array, Filter]:
    """Coefficients, and the filter that draws them as they are: solved for once, however often it draws."""
    if not row.prefilter:
        return data, row
    if max(data.shape) > _DENSE:
        return reference.prefilter(data, row, rule), replace(row, prefilter=False, smoothing=0.0)
    for axis, n in enumerate(data.shape):
        inverse = _inverse(row.along(data.ndim - 1 - axis), n, rule)
        data = np.moveaxis(np.tensordot(inverse, data, (1, axis)), 0, axis)
    return np.ascontiguousarray(data), replace(row, prefilter=False, smoothing=0.0)


@lru_cache(maxsize=128)
def _inverse(row: Filter, n: int, rule: Boundary) -> Array:
    """That of the matrix of eq. (11): as one product of matrices it is several times as fast as solving line by line."""
    return np.asarray(np.linalg.inv(rule.matrix(row.undone, n)), np.float64)


def _gradient_errors(trial: _Trial, true: Array, got: Array) -> tuple[float, _Angles]:
    """RMS length of the error; mean, median and 95th percentile of the angle in degrees."""
    rms = _root_mean_square(got - true) * math.sqrt(true.shape[-1])
    low, high = trial.samples.value_range
    weights = angle_weights(true, trial.sigma)
    weights[np.abs(true).max(-1) < 1e-9 * (high - low) / min(trial.samples.spacing)] = 0  # rounding errors
    total = float(weights.sum())
    if high == low or total == 0:
        return rms, (None, None, None)
    between = angles(got, true)
    median, most = (weighted_quantile(between, weights, share) for share in (0.5, 0.95))
    return rms, (float((weights * between).sum()) / total, median, most)


def _root_mean_square(values: Array) -> float:
    """Root mean square, even of numbers whose squares over- or underflow."""
    unit = float(np.abs(values).max()) or 1.0
    return unit * math.sqrt(float(np.mean((values / unit) ** 2)))
