"""The impulse response of a whole reconstruction, prefilter and magnification included, as piecewise polynomials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike

from clvol.base.arrays import Array, reals
from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter

__all__ = ["Pieces", "even_filter", "impulse_response", "pieces"]

_TAIL = 1e-18  # of the prefilter's impulse response, which decays like powers of its largest pole


@dataclass(frozen=True)
class Pieces:
    """A piecewise polynomial, zero outside: piece j covers ``[start + j step, start + (j + 1) step)``.

    ``rows[j, k]`` belongs to ``t**k``, with t from 0 to 1 along the piece.
    """

    start: float
    step: float
    rows: Array

    def __call__(self, x: Array, derivative: int = 0) -> Array:
        rows = self.rows
        for _ in range(derivative):
            rows = rows[:, 1:] * np.arange(1, rows.shape[1]) / self.step if rows.shape[1] > 1 else np.zeros_like(rows)
        u = (x - self.start) / self.step
        place = np.floor(u)
        inside = (place >= 0) & (place < rows.shape[0])
        j = np.where(inside, place, 0).astype(np.int64)
        t = np.where(inside, u - place, 0.0)
        return np.where(inside, polynomial.polyval(t, np.moveaxis(rows[j], -1, 0), tensor=False), 0.0)

    def energy(self) -> float:
        """The integral of the square."""
        nodes, lengths = legendre.leggauss(self.rows.shape[1])  # exact for the square of each piece
        values = polynomial.polyval((nodes + 1) / 2, self.rows.T)
        return float((values**2 @ lengths).sum() / 2 * self.step)

    def max_integral(self) -> float:
        """The maximum of the integral from the left."""
        integrals = np.pad(self.rows / np.arange(1, self.rows.shape[1] + 1), ((0, 0), (1, 0))) * self.step
        before, largest = 0.0, 0.0
        for row, integral in zip(self.rows, integrals, strict=True):
            roots = polynomial.polyroots(np.trim_zeros(row, "b")) if row.any() else np.empty(0)
            t = np.clip(np.concatenate([[0.0, 1.0], roots.real]), 0, 1)
            values = before + polynomial.polyval(t, integral)
            largest = max(largest, float(values.max()))
            before = float(values[1])
        return largest


def impulse_response(filter: str | Filter, x: ArrayLike, derivative: int = 0) -> Array:
    """The reconstruction, along one axis, of a sample of 1 at 0 among zeros.

    For a filter without a prefilter this is its kernel, eq. (10) for the cubic; with one, the cardinal
    spline ``sum of s_k beta(x - k)``, where s is the impulse response of eq. (16); for a hybrid, the
    cardinal spline at multiples of half a sample, reconstructed by the second kernel (section 4.3).

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    x : array-like
        Signed distance in samples of the given data.
    derivative : {0, 1, 2}
        Order of the derivative, per sample.

    Returns
    -------
    ndarray of float64, the shape of `x`

    Raises
    ------
    OptionError
        Unknown filter, `x` not real or not finite, or another derivative.
    """
    places = reals("x", x)
    if not np.isfinite(places).all():
        raise OptionError("x must be finite")
    return pieces(as_filter(filter))(places, whole("derivative", derivative, 0, 2))


def even_filter(filter: str | Filter) -> Filter:
    """The filter, if its impulse response is even and so its frequency response real; else `OptionError`."""
    chosen = as_filter(filter)
    drawn = pieces(chosen)
    x = np.random.default_rng(0).uniform(0, -drawn.start, 1000)
    if np.abs(drawn(x) - drawn(-x)).max() > 1e-9 + 2 * chosen.fit_error:
        raise OptionError(f"filter must have an even kernel, so that its response is real; got {chosen.name!r}")
    return chosen


@lru_cache(maxsize=64)
def pieces(filter: Filter) -> Pieces:
    """The impulse response of a filter along one axis."""
    kernel = filter.matrix[::-1]  # tap i is at t + TAPS/2 - 1 - i: the last tap is the leftmost piece
    if filter.magnified_by is not None:
        coarse = pieces(filter.magnified_by)
        s = filter.scale
        first = math.ceil(coarse.start * s)
        places = np.arange(first, -first + 1) / s
        return Pieces((first - filter.support / 2) / s, 1 / s, _blend(coarse(places), kernel))
    if not filter.prefilter or not filter.poles.size:
        return Pieces(-filter.support / 2, 1.0, kernel / (filter.samples[0] if filter.prefilter else 1.0))
    s_k = _prefilter_impulse(filter)
    return Pieces(-filter.support / 2 - s_k.size // 2, 1.0, _blend(s_k, kernel))


def _blend(values: Array, kernel: Array) -> Array:
    """Pieces of the sum of the values times copies of the kernel, each shifted by one piece."""
    return np.stack([np.convolve(values, column) for column in kernel.T], -1)


def _prefilter_impulse(filter: Filter) -> Array:
    """The inverse transform of eq. (16) at -K, ..., K: a convolution of one sequence for each pair of poles, z and 1/z.

    ``1 / ((1 - z q) (1 - z / q))`` is the transform of ``z**|k| / (1 - z**2)``. Poles may be equal, or complex.
    """
    reach = math.ceil(math.log(_TAIL) / math.log(float(np.abs(filter.poles).max())))
    k = np.abs(np.arange(-reach, reach + 1))
    total = np.array([1 / filter.undone[-1]])
    for z in filter.poles:
        total = np.convolve(total, -z / (1 - z * z) * z**k, "same")
    return np.asarray(total.real)
