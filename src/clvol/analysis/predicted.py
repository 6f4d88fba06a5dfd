"""The expected error of a filter, from the spectrum of the samples and their noise; no sample is blurred or omitted.

A separable filter with frequency response H reconstructs f from samples with white noise. Averaged over all positions and all
shifts of the grid, its error is ::

    mean squared error = bias² + variance
    bias²    = mean over w of S(w) E(w),   E(w) = 1 - 2 H(w) + A(w),   A(w) = sum over k of |H(w + 2 pi k)|²
    variance = sigma² times the mean over w of A(w), which is the mean over positions of the sum of the squared weights

where S is the spectrum of f, and H and A of a volume are products over its axes (Blu and Unser, *Quantitative Fourier analysis of
approximation techniques*, 1999, in several dimensions and with noise). The spectrum of the samples is S plus sigma², and the error
is linear in it, so each block of the volume gives an estimate, and their spread shows how certain a ranking of filters is. (This is
Mallows' C_p, Stein's unbiased estimate of risk, at all positions instead of the samples.)

The samples show S below the Nyquist frequency. Beyond it f is assumed to be band-limited, except at jumps: steps from one sample to
the next between level samples, which no band-limited function has. The spectrum of a jump is ``height² / w²`` at all frequencies,
so the filter's response beyond Nyquist counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, InitVar, dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from clvol.analysis.comparison import EXACT_SINC, as_compared, settled_compared
from clvol.analysis.table import Table, column
from clvol.analysis.theory import error_kernel
from clvol.base.arrays import Array
from clvol.base.checks import enough_memory, number, warn, whole
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.response import frequency_response
from clvol.noise import Noise, colour_power
from clvol.noise.kinds import of_blocks
from clvol.volume.volume import Volume, as_volume

__all__ = ["PredictedRow", "PredictedTable", "jump_error", "predict", "variance_gain"]

_BLOCK = 16, 32  # fewest and most samples along each axis of a block, otherwise half the axis
_TAPERED = 8  # samples of the shortest axis that is tapered
_LEVEL = 0.05  # of a jump; largest difference of its neighbours,
_QUIET = 3.0  # plus this many standard deviations of the noise
_STANDS_OUT = 12.0  # standard deviations: the least height of a jump
_LOCAL = 5  # samples along each axis whose mean is the level of signal-dependent noise
_NODES = 256  # frequencies in (0, pi), for quantities that are periodic and smooth
_SLOW = 1e-3  # frequency at which a wave is a plane
_ALIASES = 4  # on each side; those of a jump decrease at least with the cube of the frequency
_UNSURE = 0.1  # relative error of the estimated variance of the noise
_LEVEL_UNSURE = 0.5  # the same, if most frequencies agree
_SHELLS = 16  # of frequencies, from 0 to Nyquist
_CHANCE = 2.5  # standard errors
_HANN = 1.94  # samples under Hann's window that count as one
_ROUNDING = 1e-12  # of the squared half range; float32's squared rounding errors about a plane
_FEWEST = 6  # blocks; fewer agree by chance more often than once in forty
_RESAMPLES = 2000
_SURE = 0.975  # share of the resampled volumes


@dataclass(frozen=True)
class PredictedRow:
    """The expected error of one filter: root mean squares in the data's units.

    Attributes
    ----------
    filter : str
        Name of the filter.
    bias : float
        Blur and aliases.
    noise : float
        The remaining noise of the samples.
    rms : float
        The root of the sum of both squares.
    gradient_rms : float or None
        The same for the gradient, per world unit; None if the filter has no gradient.
    """

    filter: str = column("filter")
    bias: float = column("bias", ".3g")
    noise: float = column("noise", ".3g")
    rms: float = column("expected RMS error", ".3g")
    gradient_rms: float | None = column("of the gradient", ".3g")


@dataclass(eq=False, repr=False)
class PredictedTable(Table[PredictedRow]):
    """A row for each filter, in the requested order, and the errors by block that support it.

    Attributes
    ----------
    sigma : float
        Standard deviation of the noise, in the data's units.
    blocks : ndarray of float64, shape (filters, blocks)
        Expected squared errors by block, in squared units of the data, times how much of the volume a block stands for (1 on
        average; more at the border, where blocks overlap less); the row has their mean.
    slopes : ndarray of float64, shape (filters, blocks)
        The same for gradients; NaN for filters without one.
    leverage : ndarray of float64, shape (filters, blocks)
        How much the squared errors grow if the variance of the noise is relatively 1 larger, and detail as much less.
    uncertain : float
        Relative standard error of the variance of the noise; 0 if it is given as a number.
    variance : float
        Mean square, without the noise, of the samples less a plane fitted to each block.
    steepness : float
        Mean square of the gradient, the planes' included, per squared world unit.
    detail : float or None
        Share above half of Nyquist of the mean squared difference between neighbours, without the noise; None if noise explains
        all differences, or there are not `enough` blocks. It does not depend on the volume's size.
    jumps : float
        Share of jumps in the mean squared difference between neighbours.
    apart : int
        Number of blocks that the volume holds without overlap.
    seed : int
        Of the resampling.
    doubt : str
        Why the errors are uncertain (`Noise.doubt`); empty if they are not.
    """

    rows: InitVar[Iterable[PredictedRow]]
    _: KW_ONLY
    sigma: float
    blocks: Array
    slopes: Array
    leverage: Array
    uncertain: float
    variance: float
    steepness: float
    detail: float | None
    jumps: float
    apart: int
    seed: int
    doubt: str = ""

    def row(self, filter: str) -> PredictedRow:
        """The row of a filter; `OptionError` if it has none."""
        return self[self._place(filter)]

    @property
    def enough(self) -> bool:
        """Whether there are enough blocks, six, to distinguish a ranking from chance."""
        return int(self.blocks.shape[1]) >= _FEWEST

    def surely_less(self, filter: str, than: str, times: float = 1.0, key: str = "rms") -> bool:
        """Whether the error of `filter` is less than `times` that of `than` in 97.5 % of resampled volumes.

        A resampled volume has as many blocks as the volume holds without overlap (overlapping ones are not independent), drawn with
        replacement, the same for both filters: Efron's bootstrap. Without `enough` blocks the answer is False.

        Parameters
        ----------
        filter, than : str
            Names of rows.
        times : float
            Positive.
        key : {"rms", "gradient_rms"}

        Raises
        ------
        OptionError
            A filter without a row, or an unknown key.
        """
        if key not in ("rms", "gradient_rms"):
            raise OptionError(f"key must be one of rms, gradient_rms; got {key!r}")
        squares = self.blocks if key == "rms" else self.slopes
        gap = number("times", times, above=0) ** 2 * squares[self._place(than)] - squares[self._place(filter)]
        if not self.enough or not np.isfinite(gap).all() or not gap.any():
            return False
        return float((_draws(gap.size, self.apart, self.seed) @ gap > 0).mean()) >= _SURE

    def risk(self, filter: str, unseen: float = 0.0) -> float:
        """The largest ratio of the expected error of `filter` and the least of all but the exact sinc, for noise within two errors.

        Two standard errors of its variance are meant. Errors below `unseen` count as that much; it is infinite if `unseen` is
        0 and another filter has no error.

        Raises
        ------
        OptionError
            A filter without a row.
        """
        place, ratios = self._place(filter), []
        rest = np.array([row.noise for row in self]) ** 2
        able = [row.filter == filter or row.filter != EXACT_SINC for row in self]
        for change in (-min(1.0, 2 * self.uncertain), 0.0, 2 * self.uncertain):
            squares = np.maximum((self.blocks + change * self.leverage).mean(1), np.maximum((1 + change) * rest, unseen**2))
            least = float(squares[able].min())
            if squares[place] > 0:
                ratios.append(math.sqrt(squares[place] / least) if least > 0 else math.inf)
        return max(ratios, default=1.0)

    def _place(self, filter: str) -> int:
        names = [row.filter for row in self]
        if filter not in names:
            raise OptionError(f"filter must be one of {', '.join(names)}; got {filter!r}")
        return names.index(filter)


@lru_cache(maxsize=4)
def _draws(count: int, apart: int, seed: int) -> Array:
    """How often each of `count` blocks is among `apart` draws, for each resampled volume; (volumes, blocks)."""
    return np.random.default_rng(seed).multinomial(apart, np.full(count, 1 / count), _RESAMPLES).astype(np.float64)


@enough_memory("what is predicted")
def predict(
    volume: Volume | ArrayLike,
    filters: Sequence[str | Filter],
    noise: Noise | float | None = None,
    *,
    blocks: int = 128,
    seed: int = 0,
) -> PredictedTable:
    """Predict the error of each filter on a volume's samples.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    filters : sequence of str or Filter
        One row each; "exact-sinc" is the ideal filter.
    noise : Noise or float, optional
        The samples' noise, or the standard deviation of white noise; default: `Volume.noise`. Samples of a masked or clipped
        background have none.
    blocks : int
        Most blocks of 16 to 32 samples along each axis, which overlap by half; if there are more, a random choice.
    seed : int
        Of this choice and of the resampling.

    Returns
    -------
    PredictedTable

    Raises
    ------
    OptionError
        An unknown name, or a number outside its bounds.
    DataError
        NaN or infinite samples.
    OutOfMemoryError
        The blocks do not fit into memory.

    Examples
    --------
    >>> from clvol import analysis, phantoms
    >>> table = analysis.predict(phantoms.marschner_lobb(32), ["linear", "bspline3"], noise=0.01)
    >>> [row.filter for row in table]
    ['linear', 'bspline3']
    """
    chosen, volume = as_compared(filters), as_volume(volume)
    count, seed = whole("blocks", blocks, 1), whole("seed", seed, 0)
    volume.require_finite()
    chosen = settled_compared(chosen, volume)
    given = volume.noise if noise is None else noise
    known = given if isinstance(given, Noise) else Noise(number("noise", given, minimum=0), "white", colour=(1.0,) * volume.ndim)
    low, high = volume.value_range
    unit = high / 2 - low / 2 or 1.0  # so that no square overflows or underflows
    samples, even = _blocks(volume, count, seed)
    parts = (samples - (low / 2 + high / 2)) / unit
    shape = parts.shape[1:]
    inner = tuple(range(1, parts.ndim))
    # the noise in the powers, under the taper, and that which remains, of all samples alike
    variance, _ = _by_block(samples, known, unit, _taper(shape) ** 2)
    remaining, offset = _by_block(samples, known, unit, even)
    share = _noisy(samples, known, even)
    counts = even.mean(inner)[:, None]
    total = float((even * (parts - (even * parts).mean()) ** 2).mean())
    del samples, even
    if known.doubt:
        warn(f"the predicted errors are uncertain. The samples hold noise, and {known.doubt}")
    omega = [np.asarray(2 * np.pi * np.fft.fftfreq(n), np.float64) for n in shape]
    colours = known.colour[::-1]
    power, white, tilts = _spectra(parts)
    white *= _product([_coloured(ratio, w) for ratio, w in zip(colours, omega, strict=True)])
    uncertain = 0.0
    if isinstance(given, Noise):
        apart = min(volume.data.size, parts.size / _HANN**volume.ndim)
        better, known_to = _refined(counts * power, counts * np.multiply.outer(variance, white), omega, apart)
        variance, remaining, uncertain = (
            variance * better,
            remaining * better,
            known_to if math.isfinite(known_to) else 4 * known.uncertain,
        )
    noisy = counts * np.multiply.outer(variance, white)
    power, tilts, steps = counts * power - noisy, counts * tilts, counts * _steps(parts, np.sqrt(variance))
    # the variance between blocks, and of the planes in them
    slower = max(0.0, total - float((power + noisy).mean(0).sum()))
    sloping = tilts @ np.array([1 / s**2 for s in volume.spacing[::-1]])
    rows, squares, slopes, leverage = [], [], [], []
    for row in chosen:
        along = [row.along(a) if isinstance(row, Filter) else row for a in reversed(range(len(shape)))]  # x is 0
        tables = [_tables(part, w) for part, w in zip(along, omega, strict=True)]
        kernel = _unsmeared(_kernel(tables), shape)
        bias = power @ kernel + sum(steps[:, a] * _beyond(part) + tilts[:, a] * _on_slopes(part) for a, part in enumerate(along))
        flattened = _flattened(along, volume.shape)
        bias += flattened * slower + offset
        left = remaining * math.prod(_gain(part, ratio) for part, ratio in zip(along, colours, strict=True))
        leverage.append(unit**2 * (left - noisy @ kernel))
        squares.append(unit**2 * (bias + left))
        slope, gain = np.full(bias.size, np.nan), math.nan
        if row == EXACT_SINC or (isinstance(row, Filter) and row.has_gradient):
            steepness, gain = _slope_kernel(along, tables, omega, volume.spacing[::-1], colours)
            slope = power @ _unsmeared(steepness, shape) + flattened * sloping
        square, rest = max(0.0, float(bias.mean())), float(left.mean())
        steep = max(0.0, float(slope.mean())) + float(remaining.mean()) * gain
        slopes.append(unit**2 * (slope + remaining * gain))
        rows.append(
            PredictedRow(
                row.name if isinstance(row, Filter) else row,
                unit * math.sqrt(square),
                unit * math.sqrt(rest),
                unit * math.sqrt(square + rest),
                unit * math.sqrt(steep) if math.isfinite(steep) else None,
            )
        )
    slope_power = [(w / step) ** 2 for w, step in zip(omega, volume.spacing[::-1], strict=True)]
    detail, total = _detail(power, noisy, omega)
    return PredictedTable(
        rows,
        sigma=unit * math.sqrt(float(remaining.mean() / share.mean())) if remaining.any() else 0.0,
        blocks=np.array(squares),
        slopes=np.array(slopes),
        leverage=np.array(leverage),
        uncertain=uncertain,
        variance=unit**2 * max(0.0, float(power.mean(0).sum())),
        steepness=unit**2 * max(0.0, float(power.mean(0) @ _summed(slope_power) + sloping.mean())),
        detail=detail,
        jumps=min(1.0, float(steps.sum(1).mean()) / total) if total > 0 else 0.0,
        apart=min(len(parts), round(math.prod(n / m for n, m in zip(volume.shape, shape, strict=True)))),
        seed=seed,
        doubt=known.doubt,
    )


def variance_gain(filter: str | Filter) -> float:
    """The share of the variance of white noise that a filter keeps along one axis, averaged over all positions; 1 for "exact-sinc".

    It is the mean over positions of the sum of the squared weights of samples, the prefilter included: 2/3 for linear
    interpolation, 0.479 for the cubic approximation. For a volume it is the product over its axes.

    Raises
    ------
    OptionError
        Unknown filter.
    """
    return _gain(_one(filter), 1.0)


def jump_error(filter: str | Filter) -> float:
    """The squared error beside a jump of height 1, integrated along one axis and averaged over its position between samples.

    ``1/(2 pi) integral of E(w) / w²``, per sample: 1/4 for nearest, 1/6 for linear interpolation, the least possible with two
    samples, and 2/pi² for the sinc.

    Raises
    ------
    OptionError
        Unknown filter.
    """
    row, w = _one(filter), _middles()
    keeps, passes, _ = _tables(row, w)
    return float(((1 - 2 * keeps + passes) / (4 * np.sin(w / 2) ** 2)).mean()) + _beyond(row)


def _one(filter: str | Filter) -> str | Filter:
    """The filter, or "exact-sinc". `Filter.undone` refuses smoothing that differs between axes."""
    return as_compared([filter])[0]


# -- blocks of the volume ------------------------------------------------------------------------------------


def _blocks(volume: Volume, count: int, seed: int) -> tuple[Array, Array]:
    """Blocks that overlap by half, at most `count`; and weights by which all samples count alike; both (blocks, *shape)."""
    sizes = [min(n, max(_BLOCK[0], min(_BLOCK[1], n // 2))) for n in volume.shape]
    starts = [sorted({*range(0, n - m, max(1, m // 2)), n - m}) for n, m in zip(volume.shape, sizes, strict=True)]
    lines = []
    for m, firsts in zip(sizes, starts, strict=True):
        inside = np.array(firsts)[:, None] + np.arange(m)
        lines.append(dict(zip(firsts, 1 / np.bincount(inside.ravel())[inside], strict=True)))
    places = list(itertools.product(*starts))
    if len(places) > count:
        places = [places[i] for i in np.sort(np.random.default_rng(seed).choice(len(places), count, replace=False))]
    parts = [tuple(slice(a, a + m) for a, m in zip(place, sizes, strict=True)) for place in places]
    even = np.stack([_product([line[a] for a, line in zip(place, lines, strict=True)]).reshape(sizes) for place in places])
    return np.stack([volume.data[part].astype(np.float64) for part in parts]), even / even.mean()


def _taper(shape: Sequence[int]) -> Array:
    """Hann's window, with a mean square of 1."""
    lines = [np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 if n >= _TAPERED else np.ones(n) for n in shape]
    taper = _product(lines).reshape(shape)
    return np.asarray(taper / math.sqrt(float((taper**2).mean())))


def _unsmeared(kernel: Array, shape: Sequence[int]) -> Array:
    """Weights of tapered blocks' power that give the sum of `kernel` times their spectrum.

    Hann's window smears each frequency over its neighbours, 1/6, 2/3, 1/6, which matters for strong smoothing. The kernel
    is multiplied by the inverse: along each axis a division by ``2/3 + 1/3 cos(2 pi lag / n)``.
    """
    smear = _product([2 / 3 + np.cos(2 * np.pi * np.arange(n) / n) / 3 if n >= _TAPERED else np.ones(n) for n in shape]).reshape(
        shape
    )
    return np.asarray(np.fft.fftn(np.fft.ifftn(kernel.reshape(shape)) / smear).real.ravel())


def _spectra(parts: Array) -> tuple[Array, Array, Array]:
    """The power of each block less a fitted plane, the power of noise of variance 1, and the squared slopes of the plane.

    Shapes (blocks, frequencies), (frequencies,) and (blocks, axes). The powers of a block add up to the mean square of the tapered
    block. The plane would leak to all frequencies.
    """
    shape = parts.shape[1:]
    taper = _taper(shape)
    ones = np.ones(shape)
    bases = [ones, *(g - (n - 1) / 2 for g, n in zip(np.indices(shape, np.float64), shape, strict=True))]
    lengths = np.array([math.sqrt(float(((taper * b) ** 2).sum())) or 1.0 for b in bases])
    tapered = np.array([taper * b / length for b, length in zip(bases, lengths, strict=True)]).reshape(len(bases), -1)
    flat = (parts * taper).reshape(len(parts), -1)
    fitted = flat @ tapered.T
    flat -= fitted @ tapered
    axes, size = tuple(range(1, parts.ndim)), flat.shape[1]
    power = np.abs(np.fft.fftn(flat.reshape(parts.shape), axes=axes)) ** 2 / size**2
    # samples of white noise are independent, and have the variances taper² when tapered; the fit removes their projection on
    # the tapered bases
    variances = taper.ravel() ** 2
    of_bases = np.fft.fftn(tapered.reshape(-1, *shape), axes=axes).reshape(len(bases), -1)
    crossed = np.fft.fftn((tapered * variances).reshape(-1, *shape), axes=axes).reshape(len(bases), -1)
    shared = (tapered * variances) @ tapered.T
    white = variances.sum() - 2 * (of_bases.conj() * crossed).real.sum(0)
    white = white + np.einsum("iw,ij,jw->w", of_bases.conj(), shared, of_bases).real
    return power.reshape(len(parts), -1), white / size**2, (fitted[:, 1:] / lengths[1:]) ** 2


def _noisy(samples: Array, noise: Noise, weights: Array) -> Array:
    """The share of each block that has noise: all except the background."""
    noisy = weights if noise.background is None else (samples != noise.background) * weights
    return np.asarray(np.broadcast_to(noisy, samples.shape).reshape(len(samples), -1).mean(1))


def _by_block(samples: Array, noise: Noise, unit: float, weights: Array) -> tuple[Array, Array]:
    """The variance of each block's noise, and the mean square of the distance of its mean from the truth; in squared units.

    `weights` are those of samples, of shape (blocks, *shape) or (*shape).
    """
    share = _noisy(samples, noise, weights)
    nothing = np.zeros(len(samples))
    if noise.kind == "uneven":
        low = float(samples.min())
        found = of_blocks(((samples - low) / unit).astype(np.float32))
        return np.where(np.isnan(found), np.nanmean(found), found) * share, nothing
    if not noise.levels:
        return (noise.sigma / unit) ** 2 * share, nothing
    at = samples
    for axis in range(1, samples.ndim):
        at = _mean_along(at, axis)
    weights = weights * (1.0 if noise.background is None else samples != noise.background)
    axes = tuple(range(1, samples.ndim))
    variances, offsets = (np.interp(at, noise.levels, values) for values in (noise.variances, noise.offsets))
    return (variances / unit**2 * weights).mean(axes), ((offsets / unit) ** 2 * weights).mean(axes)


def _mean_along(array: Array, axis: int) -> Array:
    """Means of `_LOCAL` samples along an axis, fewer at its ends."""
    n = array.shape[axis]
    sums = np.concatenate([np.zeros_like(np.take(array, [0], axis)), np.cumsum(array, axis)], axis)
    first, last = (np.arange(n) - _LOCAL // 2).clip(0), (np.arange(n) + _LOCAL // 2 + 1).clip(None, n)
    shape = [-1 if i == axis else 1 for i in range(array.ndim)]
    return np.asarray((np.take(sums, last, axis) - np.take(sums, first, axis)) / (last - first).reshape(shape))


def _steps(parts: Array, sigma: Array) -> Array:
    """The mean square along each axis of the differences that are jumps, given each block's noise; (blocks, axes)."""
    weights = _taper(parts.shape[1:]) ** 2
    noise = sigma.reshape(-1, *[1] * (parts.ndim - 1))
    result = np.zeros((len(parts), parts.ndim - 1))
    for axis in range(parts.ndim - 1):
        if parts.shape[axis + 1] < 4:
            continue
        change = np.abs(np.diff(np.moveaxis(parts, axis + 1, -1)))
        middle = change[..., 1:-1]
        beside = np.maximum(change[..., :-2], change[..., 2:])
        jumps = (middle > 0) & (middle >= _STANDS_OUT * noise) & (beside <= _LEVEL * middle + _QUIET * noise)
        along = np.moveaxis(weights, axis, -1)
        result[:, axis] = (np.where(jumps, middle**2, 0) * (along[..., 1:-2] + along[..., 2:-1]) / 2).reshape(len(parts), -1).sum(1)
    return np.asarray(result / parts[0].size)


def _refined(power: Array, noise: Array, omega: Sequence[Array], apart: float) -> tuple[float, float]:
    """The correction, a factor, of the variance of the noise, and its standard error, infinite without a correction.

    `apart` is the number of independent samples.

    Noise is clearest where all frequencies are high. All of the power there is taken as noise, and that of lower frequencies down
    to the first that have more or less of it than chance explains: this mean is more accurate than the estimate. If it differs by
    more than a tenth, most frequencies must agree.
    """
    corner = _product([np.where((np.abs(w) > np.pi / 2) | (w.size < _TAPERED), 1.0, 0.0) for w in omega]) > 0
    radius = _SHELLS * np.sqrt(_summed([w**2 for w in omega])) / np.pi
    shells = [corner, *((radius.astype(int) == n) & ~corner for n in range(int(radius.max()), -1, -1))]
    seen, expected = (np.array([float(of.sum(0)[shell].sum()) for shell in shells]) for of in (power, noise))
    counts = np.array([shell.sum() for shell in shells])
    blocks = noise.sum(1)
    apart = apart * float(blocks.mean() ** 2 / max(float((blocks**2).mean()), 1e-300))  # where noise is strong decides
    agree = 0  # shells
    while agree < len(shells) and expected[0] > 0:
        error = _CHANCE * math.sqrt(2 * corner.size / apart * (1 / max(counts[agree], 1) + 1 / max(counts[:agree].sum(), 1)))
        ratio = seen[:agree].sum() / expected[:agree].sum() if agree else 1.0
        if agree and abs(seen[agree] / ratio - expected[agree]) > error * expected[agree]:
            break
        agree += 1
    ratio = float(seen[:agree].sum() / expected[:agree].sum()) if agree else 1.0
    if not agree or abs(ratio - 1) >= (_UNSURE if 2 * counts[:agree].sum() < corner.size else _LEVEL_UNSURE):
        return 1.0, math.inf
    return ratio, math.sqrt(2 * corner.size / apart / counts[:agree].sum())


def _detail(power: Array, noise: Array, omega: Sequence[Array]) -> tuple[float | None, float]:
    """The share above half of Nyquist of the mean squared difference between neighbours, and this mean square."""

    def squares(least: float) -> tuple[Array, float]:
        weights = _summed([np.where(np.abs(w) > least, 2 - 2 * np.cos(w), 0.0) for w in omega])
        return np.asarray(power @ weights), float((noise @ weights).mean())

    (every, hidden), (high, _) = squares(0.0), squares(np.pi / 2)
    total, doubt = float(every.mean()), 2 * float(every.std()) / math.sqrt(len(power))
    if len(power) < _FEWEST or total <= max(doubt, _UNSURE * hidden, _ROUNDING):
        return None, max(total, 0.0)
    return min(1.0, max(0.0, float(high.mean()) / total)), total


# -- filters at frequencies ----------------------------------------------------------------------------------


def _tables(row: str | Filter, omega: Array) -> tuple[Array, Array, Array]:
    """H(w), A(w), and A(w) of the derivative, the sum of |(w + 2 pi k) H(w + 2 pi k)|²."""
    if not isinstance(row, Filter):
        return np.ones_like(omega), np.ones_like(omega), omega**2
    keeps = frequency_response(row, omega)
    passes = error_kernel(row, omega) - 1 + 2 * keeps
    if not row.has_gradient:
        return keeps, passes, np.zeros_like(omega)
    return keeps, passes, error_kernel(row, omega, 1) - omega**2 + 2 * omega**2 * keeps


def _product(lines: Sequence[Array]) -> Array:
    result = lines[0]
    for line in lines[1:]:
        result = np.multiply.outer(result, line)
    return np.asarray(result.ravel())


def _summed(lines: Sequence[Array]) -> Array:
    """The sum of terms that depend on the frequency along one axis each, at all combinations of frequencies."""
    ones = [np.ones_like(line) for line in lines]
    return np.asarray(sum(_product([*ones[:a], line, *ones[a + 1 :]]) for a, line in enumerate(lines)))


def _kernel(tables: Sequence[tuple[Array, Array, Array]]) -> Array:
    """E(w) of a volume at all combinations of frequencies."""
    return np.asarray(1 - 2 * _product([t[0] for t in tables]) + _product([t[1] for t in tables]))


def _slope_kernel(
    along: Sequence[str | Filter],
    tables: Sequence[tuple[Array, Array, Array]],
    omega: Sequence[Array],
    spacing: Sequence[float],
    colours: Sequence[float],
) -> tuple[Array, float]:
    """E(w) of the gradient per world unit, and the gradient's variance from noise of variance 1."""
    keeps = _product([t[0] for t in tables])
    total, gain = np.zeros(keeps.size), 0.0
    for axis, step in enumerate(spacing):
        squares = _product([w**2 if a == axis else np.ones_like(w) for a, w in enumerate(omega)])
        passes = _product([t[2] if a == axis else t[1] for a, t in enumerate(tables)])
        total += (squares * (1 - 2 * keeps) + passes) / step**2
        gains = (_gain(row, ratio, int(a == axis)) for a, (row, ratio) in enumerate(zip(along, colours, strict=True)))
        gain += math.prod(gains) / step**2
    return total, gain


def _flattened(along: Sequence[str | Filter], shape: Sequence[int]) -> float:
    """The squared error of the slowest wave in a volume, half a period; 0 without smoothing.

    A spline with a large λ flattens waves longer than a block, which blocks do not contain.
    """
    if not any(isinstance(row, Filter) and row.smoothing for row in along):
        return 0.0
    keeps = math.prod(float(frequency_response(row, np.pi / n)) for row, n in zip(along, shape, strict=True) if n > 1)
    return (1 - keeps) ** 2


def _coloured(ratio: float, omega: Array) -> Array:
    """The power of noise of variance 1 along an axis; see `clvol.noise.colour_power`."""
    return np.asarray(colour_power(ratio, omega) / float(colour_power(ratio, _middles()).mean()))


def _middles() -> Array:
    """Midpoints of equal intervals of (0, pi)."""
    return np.asarray((np.arange(_NODES) + 0.5) * np.pi / _NODES)


@lru_cache(maxsize=256)
def _gain(row: str | Filter, ratio: float, derivative: int = 0) -> float:
    """The variance of a filter's values along an axis, or of their derivative, from noise of variance 1."""
    return float((_tables(row, _middles())[1 + derivative] * _coloured(ratio, _middles())).mean())


@lru_cache(maxsize=256)
def _on_slopes(row: str | Filter) -> float:
    """The squared error on a plane with slope 1 per sample: 1/12 for nearest, 0 for filters that reproduce planes."""
    return 0.0 if not isinstance(row, Filter) or row.order >= 2 else float(error_kernel(row, _SLOW)) / _SLOW**2


@lru_cache(maxsize=256)
def _beyond(row: str | Filter) -> float:
    """The additional squared error at a jump of height 1, beyond that of a band-limited function with the same samples.

    Only the ``-2 H`` of E differs: A is periodic, and the aliases of ``1 / w²`` add up to the samples' ``1 / (4 sin²(w / 2))``.
    """
    w = _middles()
    if not isinstance(row, Filter):
        return float((1 / (2 * np.sin(w / 2) ** 2) - 2 / w**2).mean())
    seen = frequency_response(row, w) / (4 * np.sin(w / 2) ** 2)
    for k in range(-_ALIASES, _ALIASES + 1):
        at = w + 2 * np.pi * k
        seen -= frequency_response(row, at) / at**2
    return float(2 * seen.mean())
