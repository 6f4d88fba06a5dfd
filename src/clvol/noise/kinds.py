"""How the variance of noise depends on the value, on the place, and on the frequency, from cells of the highest octave.

In a cell of a few hundred wavelet coefficients, noise of independent samples has the same power in the bands that are low along one
axis as in the band that is high along all: the cell is *white*, and shows the variance at its mean value (Foi, Trimeche, Katkovnik
and Egiazarian, *Practical Poissonian-Gaussian noise modeling and fitting for single-image raw-data*, 2008). Models of the variance
over the value are compared by what they leave:

- a polynomial of degree 0 (white noise), 1 (counts and a camera's noise), 2 (noise that is proportional to the value);
- the magnitude of a complex value with white noise (Gudbjartsson and Patz, *The Rician distribution of noisy MRI data*, 1995),
  whose mean exceeds the true value; inverted as by Koay and Basser (*Analytically exact correction scheme for signal extraction
  from noisy magnitude MR signals*, 2006);
- white noise, clipped at a limit, which also changes the mean.

If no model holds, the noise is *uneven*: its variance depends on the place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from clvol.noise.wavelet import LOW, MEDIAN_SQUARE, Array, bands, error

__all__ = ["Cells", "Classes", "Curve", "cells_of", "classes_of", "clipped", "magnitude", "of_blocks", "polynomial"]

_PLACES = {1: 128, 2: 16, 3: 6}  # least coefficients along each axis of a cell, by number of axes
_WHITE = 1.6  # largest ratio of the powers of bands of a white cell, and its inverse; four standard errors
_QUIET = 1e-3  # of the strongest noise; less counts as that much
_TURNS = 12  # of reweighting
_MOST = 6.0  # standard errors; larger residuals count as that much
_AS_GOOD = 1.2  # times a misfit
_SOME = 0.05  # of the cells
_ALONE = 0.1  # relative difference from the mean of noise alone
_NOTHING = 1e-30
_CLOSE = 0.02  # relative error of a model, beside that of its data
_CLASSES = 24
_FEWEST = 150  # places of a class
_POINTS = 65  # of a polynomial
_NODES = 96  # of integrals over noise
_CURVE = 200  # true values of a curve
_FAR = 8.0  # standard deviations from a limit, where it changes nothing


@dataclass(frozen=True, eq=False)
class Cells:
    """Of the highest octave.

    Parameters
    ----------
    square, level : ndarray, shape (cells, places)
        Squares in the band that is high along all axes, NaN where they are not used, and the samples' local means.
    variance : ndarray, shape (cells,)
        From the median of the squares, which ignores edges.
    power : ndarray, shape (cells,)
        The mean of the squares if it is the same in all bands, as of noise whose variance differs within a cell; else `variance`.
    lower : ndarray, shape (axes, cells)
        The same of the bands that are low along one axis.
    """

    square: Array
    level: Array
    variance: Array
    power: Array
    lower: Array

    @property
    def error(self) -> float:
        """The relative standard error of a variance."""
        return error(self.square.shape[1])

    @cached_property
    def floor(self) -> float:
        """A variance that is negligible beside the noise of other cells."""
        noise = self.variance[_balanced(self.variance, self.lower, _NOTHING) & (self.variance > _NOTHING)]
        many = len(noise) > _SOME * len(self.variance)  # edges are seldom white
        return max(_QUIET * float(np.quantile(noise, 0.75)), _NOTHING) if many else _NOTHING

    @cached_property
    def is_white(self) -> NDArray[np.bool_]:
        """Whether a cell has the same power in all bands, or neither noise nor detail."""
        return _balanced(self.variance, self.lower, self.floor)

    @property
    def ratios(self) -> Array:
        """The largest ratio of a lower band's variance to the highest's."""
        return np.asarray((self.lower / np.maximum(self.variance, _NOTHING)).max(0, initial=0))

    @property
    def white(self) -> Cells:
        """The white cells."""
        chosen = self.is_white
        return Cells(self.square[chosen], self.level[chosen], self.variance[chosen], self.power[chosen], self.lower[:, chosen])


@dataclass(frozen=True, eq=False)
class Classes:
    """The variance of places of similar level, with its relative standard error; arrays of shape (classes,)."""

    level: Array
    variance: Array
    error: Array

    @property
    def floor(self) -> float:
        """A variance that is negligible beside those of other classes."""
        return max(_QUIET * float(self.variance.max()), _NOTHING)


@dataclass(frozen=True, eq=False)
class Curve:
    """The variance of noise over the mean value, and how far the mean is above the true value; constant outside its levels."""

    levels: Array
    variances: Array
    offsets: Array
    sigma: float = 0.0
    slope: float = 0.0

    def __call__(self, level: Array) -> Array:
        return np.interp(level, self.levels, self.variances)

    def relative(self, cells: Cells) -> Array:
        """The variance of each cell over what the curve expects."""
        floor = max(_QUIET * float(self.variances.max()), _NOTHING)
        return np.asarray(np.nanmedian(cells.square / (self(cells.level) + floor), 1)) / MEDIAN_SQUARE

    def misfit(self, cells: Cells) -> float:
        """Root mean square deviation of the cells, in standard errors: about 1 if the variance depends on the value alone."""
        noisy = cells.variance > cells.floor
        left = (self.relative(cells)[noisy] - 1) / cells.error
        return float(np.sqrt(np.mean(np.clip(left, -_MOST, _MOST) ** 2))) if noisy.any() else 0.0


def cells_of(split: dict[tuple[int, ...], NDArray[np.float32]], level: NDArray[np.float32], used: NDArray[np.bool_]) -> Cells:
    """The cells of wavelet bands of which at least half is `used`."""
    count = len(next(iter(split)))
    highest = (1,) * count
    keys = [(*highest[:i], 0, *highest[i + 1 :]) for i in range(count)] if count > 1 else []
    there = _divided(used, count)
    enough = there.mean(1) >= 0.5
    there = there[enough]

    def squares(key: tuple[int, ...]) -> Array:
        square = _divided(split[key], count)[enough].astype(np.float64) ** 2
        return np.asarray(np.where(there, square, np.nan))

    every = [squares(key) for key in (highest, *keys)]
    if not len(there):
        none = np.zeros(0)
        return Cells(every[0], every[0], none, none, np.zeros((len(keys), 0)))
    variances = np.array([np.nanmedian(square, 1) for square in every]) / MEDIAN_SQUARE
    means = np.array([np.nanmean(square, 1) for square in every])
    power = np.where(_balanced(means[0], means[1:], _NOTHING), means[0], variances[0])
    return Cells(every[0], _divided(level, count)[enough].astype(np.float64), variances[0], power, variances[1:])


def _balanced(high: Array, lower: Array, floor: float) -> NDArray[np.bool_]:
    """Whether bands have the same power, or less than `floor`."""
    ratios = (lower + floor) / (high + floor)
    return np.asarray((ratios.max(0, initial=0) < _WHITE) & (ratios.min(0, initial=np.inf) > 1 / _WHITE))


def of_blocks(blocks: NDArray[np.float32]) -> Array:
    """The variance of uneven noise in each block, from its white cells; NaN where there are none."""
    axes = [axis for axis in range(1, blocks.ndim) if blocks.shape[axis] >= len(LOW)]
    split = bands(blocks, axes)
    level = split.pop((0,) * len(axes))
    cells = cells_of(split, level, np.ones(level.shape, bool))
    owner = np.repeat(np.arange(len(blocks)), len(cells.variance) // len(blocks))[cells.is_white]
    count = np.bincount(owner, minlength=len(blocks))
    total = np.bincount(owner, cells.power[cells.is_white], len(blocks))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _divided(array: NDArray[np.generic], count: int) -> NDArray[np.generic]:
    """Places of cells, (cells, places); the last places along an axis are left out."""
    shape: list[int] = [array.shape[0]]
    keep: list[slice] = [slice(None)]
    for n in array.shape[1:]:
        parts = max(1, n // _PLACES[count])
        shape += [parts, n // parts]
        keep.append(slice(0, n // parts * parts))
    order = [0, *range(1, len(shape), 2), *range(2, len(shape), 2)]
    cells = math.prod(shape[:1] + shape[1::2])
    return np.asarray(array[tuple(keep)].reshape(shape).transpose(order).reshape(cells, -1))


def classes_of(cells: Cells) -> Classes:
    """Classes of equal width in level, wider where there are few places."""
    used = ~np.isnan(cells.square)
    square, level = cells.square[used], cells.level[used]
    least, most = np.quantile(level, (0.001, 0.999))
    number = np.floor(_CLASSES * (level - least) / max(float(most - least), 1e-9)).clip(0, _CLASSES - 1).astype(np.int64)
    order = np.argsort(number, kind="stable")
    ends = np.cumsum(np.bincount(number, minlength=_CLASSES))
    groups, start = [], 0
    for end in ends:
        if end - start >= _FEWEST:
            groups.append(order[start:end])
            start = int(end)
    if groups:
        groups[-1] = np.concatenate([groups[-1], order[start:]])
    levels = np.array([level[g].mean() for g in groups])
    variances = np.array([np.median(square[g]) / MEDIAN_SQUARE for g in groups])
    return Classes(levels, variances, np.array([error(len(g)) for g in groups]))


# -- models ----------------------------------------------------------------------------------------------------------


def polynomial(classes: Classes, degree: int, low: float, high: float) -> Curve:
    """The variance as a polynomial of the level between `low` and `high`, by least squares that discount outliers."""
    middle, half = (low + high) / 2, max((high - low) / 2, _NOTHING)
    noisy = classes.variance > classes.floor
    variance, close = classes.variance[noisy], np.hypot(classes.error, _CLOSE)[noisy]
    columns = np.vander((classes.level[noisy] - middle) / half, degree + 1, increasing=True)
    found = np.full(variance.size, float(np.median(variance)))
    terms = np.zeros(degree + 1)
    for _ in range(_TURNS):
        scale = close * np.maximum(found, classes.floor)
        left = np.abs(variance - found) / scale
        weights = np.minimum(1, 2 / np.maximum(left, 1e-9)) ** 0.5 / scale
        terms = np.linalg.lstsq(columns * weights[:, None], variance * weights, rcond=None)[0]
        found = (columns @ terms).clip(0)
    at = np.linspace(low, high, _POINTS)
    values = (np.vander((at - middle) / half, degree + 1, increasing=True) @ terms).clip(0)
    quiet = classes.level[: int(np.argmax(noisy))]  # below, where there is no noise
    values[at <= quiet.max(initial=-np.inf)] = 0
    return Curve(at, values, np.zeros(_POINTS), slope=float(terms[1] / half) if degree == 1 else 0.0)


def magnitude(cells: Cells, zero: float, least: float) -> Curve:
    """The Rician noise that fits white cells best; `zero` is the level of magnitude 0, `least` the lowest magnitude.

    If that is close to the mean of noise alone, it is a more accurate measure of σ than variances.
    """
    mean, variance = _rician()
    true = np.linspace(0, _FAR, _CURVE)

    def at(sigma: float) -> Curve:
        return Curve(zero + sigma * mean, sigma**2 * variance, sigma * (mean - true), sigma)

    best = _fitted(at, cells)
    alone = at(least / mean[0])
    near = abs(alone.sigma / best.sigma - 1) < _ALONE
    return alone if near and alone.misfit(cells) < _AS_GOOD * best.misfit(cells) else best


def clipped(cells: Cells, low: float, high: float) -> Curve:
    """The white noise, clipped at two limits (infinite where there is none), that fits white cells best."""
    nodes = _nodes(8 * _NODES)

    def at(sigma: float) -> Curve:
        ends = [x for limit in (low, high) if math.isfinite(limit) for x in (limit - 4 * sigma, limit + 4 * sigma)]
        true = np.linspace(min(ends), max(ends), _CURVE)
        values = (true[:, None] + sigma * nodes).clip(low, high)
        mean = values.mean(1)
        return Curve(mean, values.var(1), mean - true, sigma)

    return _fitted(at, cells)


def _fitted(at: Callable[[float], Curve], cells: Cells) -> Curve:
    """The curve of least misfit over the standard deviation: of steps of a seventh, then of a fiftieth."""
    most = math.sqrt(float(np.quantile(cells.variance, 0.98)))
    best = min((at(most * 1.14**i) for i in range(-6, 7)), key=lambda curve: curve.misfit(cells))
    return min((at(best.sigma * 1.02**i) for i in range(-7, 8)), key=lambda curve: curve.misfit(cells))


@lru_cache(maxsize=1)
def _rician() -> tuple[Array, Array]:
    """Mean and variance of the magnitude of a true value from 0 to `_FAR` with noise of variance 1."""
    true = np.linspace(0, _FAR, _CURVE)
    radius = np.sqrt(-2 * np.log1p(-(np.arange(_NODES) + 0.5) / _NODES))
    angle = np.pi * (np.arange(_NODES) + 0.5) / _NODES
    mean = np.hypot(true[:, None, None] + radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)).mean((1, 2))
    return mean, true**2 + 2 - mean**2


@lru_cache(maxsize=1)
def _nodes(count: int) -> Array:
    """Quantiles of the normal distribution."""
    return np.array([NormalDist().inv_cdf((i + 0.5) / count) for i in range(count)])
