"""Estimate the noise of a volume from its samples.

Noise is measured in the highest octave along every axis, where a scan has the least signal: in the HHH band of an orthonormal
wavelet (Donoho and Johnstone, 1994: the median of the absolute values over 0.6745), and only where the neighbouring
bands have little power. Edges and texture show in all bands; white noise in these bands is independent of that in HHH, so the
selection does not bias the estimate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError
from clvol.noise.kinds import Cells, Curve, cells_of, classes_of, clipped, magnitude, polynomial
from clvol.noise.wavelet import HIGH, LOW, MEDIAN_SQUARE, Array, bands, error

__all__ = ["MOST_LABELS", "Noise", "estimate"]

MOST_LABELS = 256
"""Largest number of distinct values recognised as labels."""

_SAMPLES = 1 << 20  # samples used; a larger volume contributes blocks
_SHORT = 256  # longest cosine transform computed with a matrix, in samples
_BLOCK = {2: 256, 3: 32}  # samples along each axis of a block
_FLAT = 1e-6  # relative to the range of values: smaller band values are rounding of equal samples
_NEGLIGIBLE = 1e-10  # variance over the squared range
_LEVELS = 8  # classes of the local mean in which the variance is estimated
_CONFIDENT = 4.0  # standard errors by which the variance of signal-dependent noise grows, at least
_GROWS = 1.5  # factor by which it grows between the extreme classes, at least
_COLOURED = 1.5  # ratio of the powers of two octaves above which noise is correlated
_SIGNAL = 8.0  # ratio above which the lower octave shows the signal, unless all cells are alike
_CELLS_ENOUGH = 6  # cells that show how noise depends on the value
_CELLS_ALIKE = 20  # cells whose colour is compared
_CELLS_MANY = 48  # cells from which a model that hardly holds is trusted
_WHITE_SHARE = 0.05  # of the cells, at least, in white noise
_SIMPLER = 1.25  # times the misfit of a more complicated model
_EDGES = 1.6  # likewise, of white noise: edges of bright parts raise their variance, by 1.5 at most; counts by 3 and more
_HARDLY = 1.4  # standard errors: misfit of a model that hardly holds
_HOLDS = 2.2  # standard errors: misfit of a model that holds
_RAYLEIGH = 4.0  # standard deviations from 0, within which magnitudes differ from white noise
_RAYLEIGH_LEAST, _RAYLEIGH_SURE = 1.15, 2.5  # the same, known from a fit; the mean of noise alone is 1.25
_COLOUR = 1.75  # median ratio of the bands of cells in correlated noise, at least
_ALIKE = 2.0  # ratio of the colours of cells
_CLIPPED = 1.4  # times the misfit of a model without limits
_BESIDE = 0.25  # standard deviations from a limit
_COARSE = 0.3  # standard deviations; rounding to larger steps hides clipping
_SPIKE = 1.5  # times the samples beside a limit that are at it if it clips
_AT_LIMIT = 20  # samples at a limit, at least
_SLIGHT = 1e-6  # variance over the squared range that cannot be seen
_STRONG = 2.5  # colour from which noise cannot be told from detail
_OUTLIER = 5.0  # standard deviations from the nearest neighbour
_OUTLIERS = 0.1  # of the variance of the noise, from which they matter
_CUBE = 4  # samples along each axis of a local mean
_MARGIN = 0.1  # of the range of levels, beyond which a variance is extrapolated
_LOST = 0.05  # share of the samples
_EXTRAPOLATED = 0.2  # share of the variance that may be
_TABLE = 129  # levels of `Noise.variances`
_MANY = 20_000  # places from which correlation can be measured, unless all cells are alike
_FEWEST = 100  # places from which a variance can be estimated
_BACKGROUND = 0.05  # share of samples from which the most common value may be a background
_PEAKS = 0.015  # of the samples unlike a neighbour, above or below all neighbours, if they change at random
_MANY_PEAKS = 0.12  # likewise, if edges hide that all bands have the same power
_STEP = 0.4  # steps: weaker noise is that of rounding, which is as it is everywhere
_SPREAD = 5.5  # standard errors between the variances of the noisiest and the quietest part, at most
_PARTS = 4  # along each axis, and of the levels
_STRIPED = 0.1  # of the variance, from which noise that lines or planes share matters
_AVERAGED_OUT = 4.0  # times what white noise leaves in means, at least
_TURNING = 0.7, 1.0  # share of second differences that are extremes; less by this much over the root of their number
_LIKE = 0.25  # of the power of single samples without the noise, that of means, if all share it
_LINE = 12  # samples of the shortest axis along which this is seen
_EVEN = 0.2  # share of samples equal to all their neighbours from which there is no noise
_ROUNDED = 4  # values of rounded smooth data, at least: fewer cannot be told from labels
_EDGES_BEYOND = 0.02  # share of neighbours of different values that may be more than one value apart
_ALONE = 0.1  # share of the samples at edges between labels that may be unlike their neighbours
_CUTS = 2.0  # `Noise.jump` from which a background cuts through objects
_TAPER = 3  # power of the sine that is a block's taper: the higher, the less low frequencies leak to high ones
_AVERAGED = 2, 4  # samples along an axis whose means show low frequencies, and lower ones
_CELLS = 32  # of frequencies along an axis, about
_FILLED = "binary", "labels", "rounded"
_SHARED = "neighbouring samples share their noise, which cannot be told from detail"
_UNKNOWN = "too few samples show whether neighbouring ones share it"
_FEW = "too few places show how strong it is"
_CHANGES = "its strength changes, and too few even places show how"


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power spectrum of a volume's samples and of their noise, in units of the range of their values.

    Parameters
    ----------
    power : ndarray, shape (kz, ky, kx) or (ky, kx)
        Variance of the samples, including noise, per frequency cell; the sum is their variance.
    frequencies : tuple of ndarray
        Mean frequency of the cells along each axis of `power`, in radians per sample.
    noise : tuple of ndarray
        Noise factors of the cells along each axis: the noise power in a cell is their product.
    """

    power: Array
    frequencies: tuple[Array, ...]
    noise: tuple[Array, ...]


@dataclass(frozen=True)
class Noise:
    """The noise of a volume, and other statistics of its samples.

    Parameters
    ----------
    sigma : float
        Standard deviation of additive noise, in units of the data: the root of the mean variance if it varies, without samples
        of a `background`; before it was clipped or its magnitude was taken. Noise without power in the highest octave, as in a
        magnified scan, is not detected.
    kind : str
        "none"; "white"; "correlated" along an axis (`colour`); "signal-dependent", if it changes with the value (`gain`), as for
        counts; "magnitude" of complex values, as in MR (Rician); "clipped" at the least or the largest value; "uneven", if it
        changes from place to place; "binary", "labels" and "rounded", if few values fill regions without noise: neighbouring
        regions of rounded data differ by one step, those of labels arbitrarily.
    gain : float
        Slope of the variance over the value (for photon counts, the data's units per photon); 0 if none is detected.
    colour : tuple of float
        Ratio of the power in the lower and the upper half of the band along x, y[, z]; 1 for white noise.
    step : float
        Smallest difference between two values of integers or rounded data; 0 for continuous values.
    distinct : int
        Number of distinct values among the samples used.
    background : float or None
        Exact value of a masked or clipped background, if there is one.
    background_share : float
        Fraction of the samples with this value.
    jump : float
        Ratio of the step from the background to an object's outer samples and the next step inside: far above 1 at a mask that
        cuts through an object, 1 or less where objects fade out.
    uncertain : float
        Relative standard error of `sigma`, of white noise of as many samples.
    clipped : (float, float)
        Fractions of the samples at the smallest and at the largest value.
    spectrum : Spectrum
        Spectrum of the samples used and, if there is noise, of local means.
    """

    sigma: float
    kind: str
    gain: float = 0.0
    colour: tuple[float, ...] = ()
    step: float = 0.0
    distinct: int = 0
    background: float | None = None
    background_share: float = 0.0
    jump: float = 0.0
    clipped: tuple[float, float] = (0.0, 0.0)
    levels: tuple[float, ...] = field(default=(), repr=False)
    variances: tuple[float, ...] = field(default=(), repr=False)
    offsets: tuple[float, ...] = field(default=(), repr=False)
    rms: float = 0.0
    uncertain: float = 0.0
    doubt: str = ""
    spectrum: Spectrum = field(default=None, compare=False, repr=False)  # type: ignore[assignment]  # `estimate` always sets it

    @property
    def masked(self) -> bool:
        """Whether there is a background whose edge cuts through objects."""
        return self.background is not None and self.jump >= _CUTS


def estimate(samples: NDArray[Any], missing: NDArray[np.bool_] | None = None) -> Noise:
    """Estimate the noise of a volume or image from at most about a million of its samples; `Volume.noise` caches the result.

    If there is noise, the low frequencies of the spectrum come from means of two and of four samples along each axis, at most about
    a million each.

    Parameters
    ----------
    samples : ndarray, shape (nz, ny, nx) or (ny, nx)
        Integers, booleans or floating numbers in any byte order and layout.
    missing : ndarray of bool, the shape of `samples`, optional
        True where one is not measured: its value, a smooth fill, counts in the spectrum alone.

    Raises
    ------
    DataError
        A sample used is NaN or infinite.

    References
    ----------
    - D. L. Donoho and I. M. Johnstone, "Ideal spatial adaptation by wavelet shrinkage", Biometrika 81(3), 1994, 425–455.
    """
    data = samples
    places = _places(data.shape, (1,) * data.ndim)
    samples = np.stack([data[place] for place in places])
    low, high = samples.min(), samples.max()
    blocks, unit = _normalised(samples, low, high)
    gone = None if missing is None else np.stack([missing[place] for place in places])
    if gone is not None and gone.all():
        gone = None  # none of the samples looked at is measured: they are smooth
    values, counts = np.unique(blocks if gone is None else blocks[~gone], return_counts=True)
    most = int(counts.argmax())
    facts: dict[str, Any] = {
        "distinct": len(values),
        "clipped": (float(counts[0] / counts.sum()), float(counts[-1] / counts.sum())),
        "colour": (1.0,) * (blocks.ndim - 1),
    }
    if len(values) == 1:
        return Noise(0.0, "none", spectrum=_spectrum(_cells(blocks), 0.0, facts["colour"]), **facts)
    if len(values) < blocks.size / 2:
        step = float(np.diff(values.astype(np.float64)).min() * unit)
        facts["step"] = step if samples.dtype.kind == "f" else float(round(step))
    blocks -= values[most]  # so that a background and its bands are exactly 0
    same, alone = _surroundings(blocks, gone)
    common = blocks == 0 if gone is None else (blocks == 0) & ~gone
    background = common & (common.mean() >= _BACKGROUND) & ((same & common).sum() >= common.sum() / 2)
    if background.any():
        facts["background"] = float(samples.flat[int(background.argmax())])
        facts["background_share"] = float(background.mean())
        facts["jump"] = _jump(blocks, background)
    if gone is not None:
        background |= gone
    even = float(same[~background].mean())
    kind, found = "none", _Found(colour=facts["colour"])
    base = float(values[most])
    if len(values) <= MOST_LABELS and alone < _ALONE and _fill_regions(values - values[most], counts, blocks, same):
        kind = "binary" if len(values) == 2 else "rounded" if _by_steps(values - values[most], blocks) else "labels"
    elif even < _EVEN:
        zero = float(-(np.longdouble(low) / unit)) - base if low >= 0 else None
        found = _found(blocks, background, zero, (values.astype(np.float64) - base, counts))
        kind = found.kind
    if kind == "none":
        rough = _rough_places(blocks, same)
        sure = found.doubt or len(values) > MOST_LABELS or rough > _MANY_PEAKS or _flat(blocks)
        found = replace(found, doubt=(found.doubt or _CHANGES) if rough > _PEAKS and sure else "")
    if (
        kind not in _FILLED
        and not found.doubt
        and _striped(blocks, max(found.variance, (_STEP * float(facts.get("step", 0.0) / unit)) ** 2))
    ):
        found = replace(found, doubt=_SHARED)
    variance, colour, curve = found.variance, found.colour, found.curve
    total = variance * math.prod((1 + ratio) / 2 for ratio in colour)
    cells, part = _cells(blocks), variance * (1 - float(background.mean()))
    if max(colour) > _SIGNAL:  # in doubt it is detail, which must not be smoothed away
        colour = facts["colour"]
    for factor in _AVERAGED if part > 0 and len(blocks) > 1 else ():
        factors = [min(factor, max(n // _BLOCK[data.ndim], 1)) for n in data.shape]
        cells = _finer(cells, _averages(data, factors, low, high), factors, part, colour)
    spectrum = _spectrum(cells, part, colour)
    facts |= {"gain": 0.0, "colour": found.colour[::-1], "spectrum": spectrum}
    facts["rms"] = float(math.sqrt(total) * unit)
    if variance > 0:
        places = len(blocks) * math.prod(max(1, (n - len(LOW)) // 2 + 1) for n in blocks.shape[1:] if n >= len(LOW))
        facts["uncertain"] = error(max(1, int(places * (1 - float(background.mean())) / 2))) / 2
    if curve is not None:
        at = np.linspace(curve.levels[0], curve.levels[-1], _TABLE)
        facts["gain"] = float(curve.slope * unit)
        facts["levels"] = tuple((float(low) + (at + base) * float(unit)).tolist())
        facts["variances"] = tuple((curve(at) * float(unit) ** 2).tolist())
        facts["offsets"] = tuple((np.interp(at, curve.levels, curve.offsets) * float(unit)).tolist())
        total = curve.sigma**2 or total
    if found.doubt or facts["rms"] > math.sqrt(_SLIGHT) * unit:  # of correlated noise little is in the highest octave
        lost = same & ((blocks == values[0] - values[most]) | (blocks == values[-1] - values[most]))
        facts["doubt"] = _doubt(found, blocks, float(lost.mean()))
    return Noise(float(math.sqrt(total) * unit), kind, **facts)


def colour_power(ratio: float, omega: Array) -> Array:
    """Power along an axis of noise with `ratio` times the power in the lower half of its band; in the upper half it is 1.

    Its logarithm is proportional to cos ω, with means 2 / π over the lower half and − 2 / π over the upper.
    """
    return np.asarray(ratio ** (np.pi / 4 * np.cos(omega) + 0.5))


# -- inner -------------------------------------------------------------------------------------------


def _places(shape: tuple[int, ...], factors: Sequence[int]) -> list[tuple[slice, ...]]:
    """Evenly spread blocks with at most `_SAMPLES` means of `factors` samples; a single block if there are few samples."""
    most = _SAMPLES * math.prod(factors)
    if math.prod(shape) <= most:
        return [tuple(slice(0, n) for n in shape)]
    edges = [min(n, _BLOCK[len(shape)] * factor) for n, factor in zip(shape, factors, strict=True)]
    counts = [1] * len(shape)
    while True:  # add blocks along the axes with the widest gaps, and equally along equal axes
        gaps = [n / (e * c) for n, e, c in zip(shape, edges, counts, strict=True)]
        more = [c + (gap == max(gaps)) for c, gap in zip(counts, gaps, strict=True)]
        if max(gaps) < 2 or math.prod(more) * math.prod(edges) > most:
            break
        counts = more
    # each in the middle of its part of the axis
    starts = [[int(n * (i + 0.5) / c - e / 2) for i in range(c)] for n, e, c in zip(shape, edges, counts, strict=True)]
    return [tuple(slice(s, s + e) for s, e in zip(at, edges, strict=True)) for at in itertools.product(*starts)]


def _normalised(samples: NDArray[Any], low: Any, high: Any) -> tuple[NDArray[np.float32], np.longdouble]:
    """Samples scaled from 0 at `low` to 1 at `high`, and this range, which may overflow float64."""
    if samples.dtype.kind in "iu" and samples.dtype.itemsize == 8:  # differences of large integers are exact modulo 2**64
        samples = samples.astype(np.uint64) - np.uint64(int(low) % 2**64)
        low, high = np.uint64(0), np.uint64(int(high) - int(low))
    kind = np.result_type(samples.dtype, np.float64)
    wide, low, high = samples.astype(kind), kind.type(low), kind.type(high)
    if not np.isfinite(wide).all():
        raise DataError("samples must be finite for their noise to be estimated: replace them with Volume.filled(value)")
    exponent = int(np.frexp(max(abs(low), abs(high)))[1]) + 1
    wide, low, high = (
        np.ldexp(wide, -exponent),
        np.ldexp(low, -exponent),
        np.ldexp(high, -exponent),
    )  # avoids overflow of differences
    unit = np.ldexp(np.longdouble(high - low), exponent)
    return ((wide - low) / (high - low if low < high else 1)).astype(np.float32), unit


def _averages(data: NDArray[Any], factors: Sequence[int], low: Any, high: Any) -> NDArray[np.float32]:
    """Blocks of the means of `factors` samples along each axis, clipped to the range of the samples used."""
    result = []
    for place in _places(data.shape, factors):
        block = data[place]
        counts = [n // factor for n, factor in zip(block.shape, factors, strict=True)]
        inner = [length for pair in zip(counts[1:], factors[1:], strict=True) for length in pair]
        whole = [slice(c * f) for c, f in zip(counts[1:], factors[1:], strict=True)]
        means = np.empty(counts, np.float32)
        for i in range(counts[0]):  # layer by layer, without a copy of all samples
            layer = block[(slice(factors[0] * i, factors[0] * (i + 1)), *whole)]
            values = _normalised(np.clip(layer, low, high), low, high)[0]
            means[i] = values.mean(0).reshape(inner).mean(tuple(range(1, len(inner), 2)))
        result.append(means)
    return np.stack(result)


@dataclass(frozen=True, eq=False)
class _Cells:
    """The power of blocks per frequency cell: the edges of cells along each axis, and the spacing of frequencies."""

    power: Array
    edges: tuple[Array, ...]
    distance: tuple[float, ...]


def _cells(blocks: NDArray[np.float32]) -> _Cells:
    """The mean spectrum of the blocks minus their means, by cosine transforms."""
    axes = tuple(range(1, blocks.ndim))
    blocks = blocks - blocks.mean(axes, keepdims=True)
    weight = float(blocks[0].size)
    if len(blocks) > 1:  # the volume continues outside a block
        for axis in axes:
            n = blocks.shape[axis]
            taper = (np.sin(np.pi * (np.arange(n) + 0.5) / n) ** _TAPER).astype(np.float32)
            blocks *= taper.reshape([-1 if i == axis else 1 for i in range(blocks.ndim)])
            weight *= float((taper**2).mean())
    for axis in axes:
        blocks = _cosine_transform(blocks, axis)
    power = (blocks**2).mean(0, dtype=np.float64) / weight
    edges = []
    for axis, n in enumerate(power.shape):
        first = np.arange(n)
        if n > _CELLS:  # single frequencies below, wider cells above
            first = np.unique(np.geomspace(_CELLS // 2, n, _CELLS // 2, endpoint=False).astype(int))
            first = np.concatenate([np.arange(_CELLS // 2), first])
        power = np.add.reduceat(power, first, axis)
        edges.append(np.pi / n * np.append(first, n))
    return _Cells(power, tuple(edges), tuple(np.pi / n for n in blocks.shape[1:]))


def _cosine_transform(array: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Orthonormal DCT-II; uses SciPy only along long axes, because its import takes longer than the estimate."""
    n = array.shape[axis]
    if n > _SHORT:
        from scipy import fft

        return np.asarray(fft.dct(array, axis=axis, norm="ortho"))
    waves = np.cos(np.pi / n * np.outer(np.arange(n) + 0.5, np.arange(n))) * np.sqrt(2 / n)
    waves[:, 0] = n**-0.5
    return np.moveaxis(np.moveaxis(array, axis, -1) @ waves.astype(np.float32), -1, axis)


def _finer(
    cells: _Cells, averages: NDArray[np.float32], factors: Sequence[int], variance: float, colour: Sequence[float]
) -> _Cells:
    """Refine cells of low frequencies with averages over larger regions, because blocks smear them over several cells.

    The gain of means of s samples is ``sin(s ω / 2) / (s sin(ω / 2))``, also at the s - 1 aliases ``ω + 2 π k / s``. There the
    signal has little power, and the power of the noise is known.
    """
    wide = _cells(averages)
    low = wide.power
    edges, folded, shares, passed = [], np.ones(()), np.ones(()), np.ones(())
    for axis, (below, above, factor) in enumerate(zip(wide.edges, cells.edges, factors, strict=True)):
        count = int(np.searchsorted(below, np.pi / 2 + 1e-9)) - 1 if factor > 1 else len(below) - 1
        below = below[: count + 1] / factor
        edges.append(np.concatenate([below, above[above > below[-1] + 1e-9]]))
        low = np.take(low, np.arange(count), axis)
        omega = (below[1:] + below[:-1] - wide.distance[axis] / factor) / 2
        aliases = omega + 2 * np.pi / factor * np.arange(factor)[:, None]
        half = np.where(aliases, aliases / 2, 1e-9)
        squares = (np.sin(factor * half) / (factor * np.sin(half))) ** 2
        noise = squares * colour_power(colour[axis], aliases) * np.diff(below) / np.pi
        folded, shares, passed = (
            np.multiply.outer(a, b) for a, b in ((folded, noise.sum(0)), (shares, noise[0]), (passed, squares[0]))
        )
    power = cells.power
    for axis, (old, new) in enumerate(zip(cells.edges, edges, strict=True)):
        overlap = np.minimum(new[1:, None], old[1:]) - np.maximum(new[:-1, None], old[:-1])
        power = np.moveaxis(np.tensordot(overlap.clip(0) / np.diff(old), power, (1, axis)), 0, axis)
    power[tuple(map(slice, low.shape))] = (low - variance * (folded - shares)) / passed
    return _Cells(power, tuple(edges), cells.distance)


def _spectrum(cells: _Cells, variance: float, colour: Sequence[float]) -> Spectrum:
    frequencies, shares = [], []
    for edges, distance, ratio in zip(cells.edges, cells.distance, colour, strict=True):
        frequencies.append((edges[1:] + edges[:-1] - np.minimum(np.diff(edges), distance)) / 2)
        shares.append(np.diff(edges) / np.pi * colour_power(ratio, frequencies[-1]))
    shares[0] = shares[0] * variance
    return Spectrum(cells.power, tuple(frequencies), tuple(shares))


def _pairs(array: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """The first and second samples of all neighbouring pairs along an axis."""
    before, after = [slice(None)] * array.ndim, [slice(None)] * array.ndim
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    return array[tuple(before)], array[tuple(after)]


def _jump(blocks: NDArray[np.float32], background: NDArray[np.bool_]) -> float:
    """`Noise.jump` of blocks whose background is 0."""
    first, second = [], []
    for axis in range(1, blocks.ndim):
        for values, outside in ((blocks, background), (np.flip(blocks, axis), np.flip(background, axis))):
            inside = _pairs(~outside, axis)[1]
            enters = _pairs(_pairs(outside, axis)[0], axis)[0] & _pairs(inside, axis)[0] & _pairs(inside, axis)[1]
            near, far = _pairs(_pairs(values, axis)[1], axis)
            first.append(np.abs(near)[enters])
            second.append(np.abs(far - near)[enters])
    steps = np.concatenate(first)
    if not steps.size:
        return 0.0
    least = np.median(np.abs(blocks[~background])) / 10  # ignore rounding steps
    return float(np.median(steps) / max(np.median(np.concatenate(second)), least))


def _surroundings(blocks: NDArray[np.float32], gone: NDArray[np.bool_] | None) -> tuple[NDArray[np.bool_], float]:
    """Which samples equal all their neighbours, and the fraction of the others that equal at most one; without those gone."""
    equal = np.zeros(blocks.shape, np.int8)
    there = np.zeros(blocks.shape, np.int8)
    for axis in range(1, blocks.ndim):
        same, both = np.equal(*_pairs(blocks, axis)), np.True_
        if gone is not None:
            both = ~np.logical_or(*_pairs(gone, axis))
            same &= both
        for side in _pairs(equal, axis):
            side += same
        for side in _pairs(there, axis):
            side += both
    differs = equal < there
    return ~differs, float((equal[differs] <= 1).mean()) if differs.any() else 0.0


def _fill_regions(values: Array, counts: NDArray[np.int64], blocks: NDArray[np.float32], same: NDArray[np.bool_]) -> bool:
    """Whether the values at edges are those of regions, not means of two of them (partial volume)."""
    between = counts[~np.isin(values, blocks[same])].sum()
    return bool(between < _ALONE * (same.size - same.sum()))


def _by_steps(values: Array, blocks: NDArray[np.float32]) -> bool:
    """Whether neighbours have equal or adjacent values, as in rounded smooth data, unlike labels."""
    if len(values) < _ROUNDED:
        return False
    differs = nexts = 0
    for axis in range(1, blocks.ndim):
        before, after = (np.searchsorted(values, side).astype(np.int64) for side in _pairs(blocks, axis))
        apart = np.abs(before - after)
        differs, nexts = differs + int((apart > 0).sum()), nexts + int((apart == 1).sum())
    return nexts >= (1 - _EDGES_BEYOND) * differs


@dataclass(frozen=True)
class _Found:
    """Noise in units of the range: its kind, mean variance in the highest octave, colour along each axis, and `Curve`."""

    kind: str = "none"
    variance: float = 0.0
    colour: tuple[float, ...] = ()
    gain: float = 0.0
    curve: Curve | None = None
    beyond: float = 0.0  # share of the variance at levels that no white cell has
    doubt: str = ""  # `Noise.doubt`, as far as it is found here


def _found(
    blocks: NDArray[np.float32], background: NDArray[np.bool_], zero: float | None, histogram: tuple[Array, NDArray[np.int64]]
) -> _Found:
    """The noise of blocks; none if there are too few places to measure.

    `zero` is the level of the value 0 if no sample is less; `histogram` has the distinct values and their counts.
    """
    axes = [axis for axis in range(1, blocks.ndim) if blocks.shape[axis] >= len(LOW)]
    white = (1.0,) * (blocks.ndim - 1)
    if not axes:
        return _Found(colour=white, doubt=_FEW)
    split = bands(blocks, axes)
    highest = (1,) * len(axes)
    lowest = (0,) * len(axes)
    del split[lowest]
    # the mean, with the weights of the squared high-pass
    level = bands(blocks, axes, (HIGH**2,))[lowest]
    used = np.logical_or.reduce([np.abs(band) > _FLAT for band in split.values()])
    if background.any():  # exclude places that overlap a background, which has no noise
        used &= bands(background.astype(np.float32), axes, (np.ones(len(LOW)),))[lowest] < 0.5
    if used.sum() < _FEWEST:
        return _Found(colour=white, doubt=_FEW)
    cells = cells_of(split, level, used)
    squares = {key: band**2 for key, band in split.items()}
    around = np.sum(list(squares.values()), 0)  # power of all bands, then summed over neighbours
    for axis in axes:
        n = around.shape[axis]
        before, after = (np.take(around, np.clip(np.arange(n) + i, 0, n - 1), axis) for i in (-1, 1))
        around = before + around + after
    level, around = level[used], around[used]
    squares = {key: square[used] for key, square in squares.items()}
    lowers = [(*highest[:i], 0, *highest[i + 1 :]) for i in range(len(axes))] if len(axes) > 1 else []

    def power(key: tuple[int, ...], places: NDArray[np.int64]) -> float:
        """The noise in a band, from the half of the places with the least power around them, then from half of these, ..."""
        square = squares[key][places]
        others = around[places] - square
        order = np.argsort(others, kind="stable")
        count = max(len(order) // 2, min(len(order), _FEWEST))
        found = float(np.median(square[order[:count]]))
        while count >= 2 * _FEWEST:  # while this lowers the power significantly
            less = float(np.median(square[order[: count // 2]]))
            if less > found * (1 - 2 * error(count // 2)):
                break
            found, count = less, count // 2
        return found / MEDIAN_SQUARE

    # classes of equal width in value, each with nearly constant variance
    least, most = np.quantile(level, (0.005, 0.995))
    number = np.floor(_LEVELS * (level - least) / max(float(most - least), _FLAT)).clip(0, _LEVELS - 1)
    classes: list[NDArray[np.int64]] = []
    few = np.zeros(0, np.int64)
    for n in range(_LEVELS):
        few = np.append(few, np.flatnonzero(number == n))
        if len(few) >= 2 * _FEWEST:
            classes, few = [*classes, few], few[:0]
    classes = [*classes[:-1], np.concatenate([*classes[-1:], few])]
    variances = np.array([power(highest, places) for places in classes])
    counts = np.array([float(len(places)) for places in classes])
    levels = np.array([float(level[places].mean()) for places in classes])
    step = float(np.diff(histogram[0]).min()) if len(histogram[0]) < blocks.size / 2 else 0.0
    mean, colour, few_cells = _middle(variances, counts), list(white), 0.0
    if mean <= _NEGLIGIBLE:
        return _Found(colour=white)
    ratios = [_middle(np.array([power(key, p) for p in classes]) / np.maximum(variances, _FLAT**2), counts) for key in lowers]

    parts: list[NDArray[Any]] = [level, *([] if len(blocks) > 1 else np.nonzero(used)[1:])]
    tested = partial(_tested, ratios=ratios, square=squares[highest], around=around, level=level, parts=parts, step=step)
    plain = cells.white
    alike = cells.lower.size > 0 and len(cells.variance) >= _CELLS_ALIKE and _alike(cells)
    if not alike and len(plain.variance) >= max(_CELLS_ENOUGH, _WHITE_SHARE * len(cells.variance)):
        limits = _limits(*histogram, math.sqrt(float(plain.variance.max())))
        found = _by_value(plain, _local_means(blocks, background), mean, zero, limits, white)
        if found.kind != "signal-dependent" or found.beyond < 1:
            return found if found.kind == "uneven" or len(plain.variance) >= _CELLS_MANY else tested(found)
        few_cells = 1.0  # a model that hardly holds in few cells: that of values alone, in which edges count less, and a doubt
    if len(axes) > 1 and (alike or len(level) >= _MANY):
        for axis, ratio in zip(axes, ratios, strict=True):
            if _COLOURED < ratio < (np.inf if alike else _SIGNAL):
                colour[axis - 1] = ratio
    if max(colour) > 1:
        return _Found("correlated", mean, tuple(colour))
    at, slope = _line(levels, variances, counts)
    first, last = at + slope * levels[0], at + slope * levels[-1]
    if last > _GROWS * first and last - first > _CONFIDENT * mean * error(len(level) // (2 * len(classes))):
        ends = np.array([float(blocks.min()), float(blocks.max())])
        curve = Curve(ends, (at + slope * ends).clip(0), np.zeros(2), slope=slope)
        mean = max(0.0, at + slope * float(blocks[~background].mean()))
        return tested(_Found("signal-dependent", mean, white, slope, curve, few_cells))
    return tested(_Found("white", mean, white))


def _rough_places(blocks: NDArray[np.float32], same: NDArray[np.bool_]) -> float:
    """The share of samples unlike a neighbour that are above or below all neighbours, and visibly; 2/7 in noise of three axes."""
    return int((_beyond(blocks) > math.sqrt(_SLIGHT)).sum()) / max(int((~same).sum()), _FEWEST)


def _flat(blocks: NDArray[np.float32]) -> bool:
    """Whether all bands have the same power, as if samples changed at random: few counts."""
    axes = [axis for axis in range(1, blocks.ndim) if blocks.shape[axis] >= len(LOW)]
    if len(axes) < 2:
        return False
    powers = {key: float((band**2).mean(dtype=np.float64)) for key, band in bands(blocks, axes).items()}
    highest = powers[(1,) * len(axes)]
    return highest > _SLIGHT and max(power for key, power in powers.items() if sum(key) == len(axes) - 1) < _COLOURED * highest


def _tested(
    found: _Found,
    ratios: Sequence[float],
    square: NDArray[np.floating],
    around: NDArray[np.floating],
    level: NDArray[np.floating],
    parts: Sequence[NDArray[Any]],
    step: float,
) -> _Found:
    """With a doubt unless the places themselves show that the noise is white and follows the model."""
    if found.variance <= max(_SLIGHT, (_STEP * step) ** 2):
        return found
    if not ratios:
        return replace(found, doubt=_UNKNOWN)
    if max(ratios) > _COLOURED * (1 + error(max(len(level) // 2, 1))):
        return replace(found, doubt=_SHARED)
    wide = level.astype(np.float64)
    expected = np.full(len(level), found.variance) if found.curve is None else found.curve(wide)
    relative = expected + _SLIGHT * max(float(expected.max()), _NEGLIGIBLE)
    return replace(found, doubt="" if _is_even(square / relative, around / relative, parts) else _CHANGES)


def _is_even(square: Array, around: Array, by: Sequence[NDArray[Any]]) -> bool:
    """Whether the variance is the same in all parts of places by each of several keys, but for chance and edges.

    Edges are left out by taking the half of each part with the least power `around`.
    """
    for key in by:
        found = []
        for part in np.array_split(np.argsort(key, kind="stable"), _PARTS):
            quiet = part[np.argsort(around[part] - square[part], kind="stable")[: max(len(part) // 2, 1)]]
            found.append(float(np.median(square[quiet])))
        if max(found) > min(found) * math.exp(_SPREAD * error(max(len(square) // (2 * _PARTS), 1))):
            return False
    return True


def _striped(blocks: NDArray[np.float32], variance: float) -> bool:
    """Whether lines or planes share noise: means along them change at random, by more than white noise's do."""
    axes = range(1, blocks.ndim)
    for along in itertools.chain.from_iterable(itertools.combinations(axes, count) for count in range(1, len(axes))):
        across = [axis for axis in axes if axis not in along]
        if min(blocks.shape[axis] for axis in across) < _LINE:
            continue
        means = blocks.mean(along, dtype=np.float64)
        shared = _rough(means, range(1, means.ndim))
        left = variance / math.prod(blocks.shape[axis] for axis in along)
        least = max(10 * _SLIGHT, _STRIPED * variance, _AVERAGED_OUT * left, _LIKE * (_rough(blocks, across) - variance))
        if shared > least and _at_random(means):
            return True
    return False


def _rough(values: NDArray[Any], axes: Iterable[int]) -> float:
    """The variance of white noise with the second differences of `values` along each of the axes."""
    for axis in axes:
        values = np.diff(values, 2, axis) / math.sqrt(6)
    return float(np.median(values**2)) / MEDIAN_SQUARE


def _at_random(values: NDArray[Any]) -> bool:
    """Whether the second differences turn as often as those of independent values: at four of five; of smooth ones, seldom."""
    for axis in range(1, values.ndim):
        turns = np.multiply(*_pairs(np.diff(values, 3, axis), axis)) < 0
        if turns.mean() < _TURNING[0] - _TURNING[1] / math.sqrt(turns.size):
            return False
    return True


def _by_value(
    plain: Cells, levels: Array, mean: float, zero: float | None, limits: tuple[float, float], white: tuple[float, ...]
) -> _Found:
    """The simplest model that holds in the white cells `plain`; `levels` are local means, `mean` the variance if white."""
    classes = classes_of(plain)
    if not classes.level.size:
        return _Found("white", mean, white)
    least, most = float(np.nanmin(plain.level)), float(np.nanmax(plain.level))
    margin = _MARGIN * (most - least)

    def of(kind: str, curve: Curve) -> _Found:
        variances = curve(levels)
        beyond = variances[(levels < classes.level[0] - margin) | (levels > classes.level[-1] + margin)].sum() / variances.sum()
        return _Found(
            kind, float(variances.mean()), white, curve.slope, curve, max(float(beyond), float(few and kind == "signal-dependent"))
        )

    curves = [polynomial(classes, degree, least, most) for degree in range(3)]
    left = [curve.misfit(plain) for curve in curves]
    best = next(degree for degree in range(3) if left[degree] <= (_SIMPLER if degree else _EDGES) * min(left))
    few = len(plain.variance) < _CELLS_MANY and left[best] > _HARDLY
    if np.isfinite(limits).any():
        curve = clipped(plain, *limits)
        if curve.misfit(plain) <= _CLIPPED * left[best]:
            return of("clipped", curve)
    if zero is not None and least - zero < _RAYLEIGH * math.sqrt(float(plain.variance.max())):
        away = float(np.quantile(plain.level.mean(1), 0.1)) - zero  # at least the mean of noise alone
        curve = magnitude(plain, zero, away)
        if _RAYLEIGH_LEAST * curve.sigma < away < _RAYLEIGH_SURE * curve.sigma and curve.misfit(plain) <= _SIMPLER * left[best]:
            return of("magnitude", curve)
    if left[best] > _HOLDS:
        return _Found("uneven", float(plain.power.mean()), white, beyond=float(few))
    if best == 0:
        return _Found("white", mean, white)
    return of("signal-dependent", replace(curves[best], slope=curves[1].slope))


def _local_means(blocks: NDArray[np.float32], background: NDArray[np.bool_]) -> Array:
    """Means of cubes of blocks without background."""
    edges = [min(n, _CUBE) for n in blocks.shape[1:]]
    shape = [len(blocks)]
    for n, edge in zip(blocks.shape[1:], edges, strict=True):
        shape += [n // edge, edge]
    part = (slice(None), *(slice(n // e * e) for n, e in zip(blocks.shape[1:], edges, strict=True)))
    inner = tuple(range(2, len(shape), 2))
    means = blocks[part].reshape(shape).mean(inner, dtype=np.float64)
    return np.asarray(means[~background[part].reshape(shape).any(inner)])


def _limits(values: Array, counts: NDArray[np.int64], sigma: float) -> tuple[float, float]:
    """The least and the greatest value, infinite where noise is not clipped: far more samples have it than a value beside it."""

    def spike(away: Array, counts: NDArray[np.int64]) -> bool:
        step = float(away[1]) if len(away) > 1 else 0.0
        if step > _COARSE * sigma:  # few counts
            return False
        beside = int(counts[(away > 0) & (away <= max(step, _BESIDE * sigma))].sum())
        return bool(counts[0] > max(_SPIKE * beside, _AT_LIMIT))

    low, high = float(values[0]), float(values[-1])
    return (low if spike(values - low, counts) else -math.inf, high if spike(high - values[::-1], counts[::-1]) else math.inf)


def _doubt(found: _Found, blocks: NDArray[np.float32], lost: float) -> str:
    """Why errors cannot be predicted from the noise; empty if they can. `lost` is the share of samples in regions at a limit."""
    if found.doubt:
        return found.doubt
    if found.kind == "correlated" and max(found.colour) > _STRONG:
        return _SHARED
    if found.kind == "clipped" and lost > _LOST:
        return f"{lost:.0%} of them lie in regions that are clipped, so that what was there is lost"
    if found.beyond > _EXTRAPOLATED:
        return _CHANGES
    variance = max(found.variance, 0.0 if found.curve is None else float(found.curve.variances.max()))
    beyond = _beyond(blocks)
    outside = beyond[beyond > _OUTLIER * math.sqrt(variance)].astype(np.float64)
    if float((outside**2).sum()) > _OUTLIERS * found.variance * beyond.size:
        return (
            f"{outside.size / beyond.size:.1%} of the samples are far from all their neighbours: remove them, as by a median filter"
        )
    return ""


def _beyond(blocks: NDArray[np.float32]) -> NDArray[np.float32]:
    """How far inner samples are above or below all their neighbours; negative between them."""
    axes = [axis for axis in range(1, blocks.ndim) if blocks.shape[axis] >= 3]
    inner = tuple(slice(1, -1) if axis in axes else slice(None) for axis in range(blocks.ndim))
    middle = blocks[inner]
    highest, lowest = np.full_like(middle, -np.inf), np.full_like(middle, np.inf)
    for axis in axes:
        for side in (slice(0, -2), slice(2, None)):
            other = blocks[(*inner[:axis], side, *inner[axis + 1 :])]
            np.maximum(highest, other, out=highest)
            np.minimum(lowest, other, out=lowest)
    return np.asarray(np.maximum(middle - highest, lowest - middle))


def _alike(cells: Cells) -> bool:
    """Whether all cells have the same colour, not white, as noise has and detail has not."""
    least, low, middle, high = np.quantile(cells.ratios, (0.05, 0.25, 0.5, 0.75))
    return bool(
        middle > _COLOUR and (middle < _ALIKE * least or high < _ALIKE * low)
    )  # edges have less colour than noise, waves more


def _line(levels: Array, variances: Array, counts: Array) -> tuple[float, float]:
    """The variance at level 0 and its slope over the level.

    Uses the lower slopes between classes, not the median slope of Theil and Sen, because edges only increase variances.
    """
    if len(levels) < 2:
        return float(variances[0]), 0.0
    a, b = np.triu_indices(len(levels), 1)
    apart = levels[b] - levels[a]
    slope = _middle((variances[b] - variances[a]) / apart, apart * counts[a] * counts[b], 0.1, 0.5)
    return _middle(variances - slope * levels, counts), slope


def _middle(values: Array, weights: Array, low: float = 0.25, high: float = 0.75) -> float:
    """The weighted mean of the values between two quantiles."""
    order = np.argsort(values, kind="stable")
    shares = weights[order] / weights.sum()
    until = np.cumsum(shares)
    inner = (np.minimum(until, high) - np.maximum(until - shares, low)).clip(0)
    return float(inner @ values[order] / inner.sum())
