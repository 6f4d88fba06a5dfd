"""Approximation theory of the filters: how fast the error falls with finer sampling, and how large it is.

T. Blu and M. Unser, *Quantitative Fourier analysis of approximation techniques: Part I*, IEEE Trans. Signal
Processing 47 (1999); T. Möller, R. Machiraju, K. Mueller and R. Yagel, *Evaluation and design of filters using a
Taylor series expansion*, IEEE TVCG 3 (1997), reference [12] of the paper. The sample spacing is T = 1 throughout.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike, NDArray

from clvol.analysis.table import column
from clvol.base.arrays import Array, reals
from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter, Number, Polynomial
from clvol.filter.response import prefilter_response
from clvol.filter.table import as_filter

__all__ = ["Approximation", "approximation", "error_kernel", "taylor_coefficients"]

_MAX_TERMS = 12  # Taylor coefficients; more than the order of any filter of `bspline`
_MAX_OMEGA = 2000
_CHUNK = 1 << 20  # complex numbers in memory at a time


@dataclass(frozen=True)
class Approximation:
    """The leading error of a filter: ``||error|| -> constant T**order ||f^(derivative + order)||`` as T -> 0.

    Attributes
    ----------
    filter : str
        Name of the filter.
    derivative : int
        0 for values, 1 for the derivative along an axis (gradients).
    order : int
        Power of the sample spacing with which the root mean square error falls; 0 if it does not fall, -1 for
        gradients of filters whose weights do not sum to one, which get worse.
    constant : float
        Root mean square over all positions between the samples.
    """

    filter: str = column("filter")
    derivative: int = column("derivative")
    order: int = column("order")
    constant: float = column("constant", ".3e")


def approximation(filter: str | Filter, derivative: int = 0) -> Approximation:
    """Order of approximation and leading error constant, for values or for first derivatives.

    Exact filters are treated in exact fractions, so that linear's constant is ``sqrt(1/120)`` to the last bit.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    derivative : {0, 1}
        0: of the values; 1: of the gradient by the filter's derivative.

    Raises
    ------
    OptionError
        Unknown filter, or another derivative.
    """
    chosen, derivative = as_filter(filter), whole("derivative", derivative, 0, 1)
    slack = 0.0 if _exact(chosen) else max(1e-9, 10 * chosen.fit_error) * float(chosen.degree) ** (2 * derivative)
    for n in range(_MAX_TERMS):
        wanted = int(n == derivative)
        square: Number = Fraction(0)
        for piece in _taylor(chosen, n, derivative):
            error = _plus(piece, [-wanted])
            square += sum((c / (k + 1) for k, c in enumerate(_times(error, error))), Fraction(0))
        constant = math.sqrt(square / chosen.scale)
        if constant > slack:
            return Approximation(chosen.name, derivative, n - derivative, constant)
    raise OptionError(f"filter must have an order below {_MAX_TERMS}; got {chosen.name!r}")


def error_kernel(filter: str | Filter, omega: ArrayLike, derivative: int = 0) -> Array:
    """The Fourier error kernel E(ω) of Blu and Unser.

    ``E(w) = (1 - H(w))² + sum over k != 0 of H(w + 2 pi k)²``, the mean over all positions of the squared error with
    which ``exp(i w x)`` is reconstructed; computed in that form, so that it keeps its digits for small ω. The mean
    squared error of any f, averaged over the phase of the sampling, is ``1/(2 pi) integral |f^(w)|² E(w T) dw``.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    omega : array-like
        Angular frequency in radians per sample, within ±2000.
    derivative : {0, 1}
        1: the mean squared error of the derivative of ``exp(i w x)``, per sample; divide by ω² for the relative one.

    Returns
    -------
    ndarray of float64, the shape of `omega`
        Near 0 it is ``constant² w**(2 order)`` (times w² for the derivative), see `approximation`.

    Raises
    ------
    OptionError
        Unknown filter, frequencies beyond ±2000, or another derivative.

    References
    ----------
    - T. Blu and M. Unser, "Quantitative Fourier analysis of approximation techniques: part I, interpolators and
      projectors", IEEE Transactions on Signal Processing 47(10), 1999, 2783–2795.
    """
    chosen, derivative = as_filter(filter), whole("derivative", derivative, 0, 1)
    w = reals("omega", omega)
    if not np.isfinite(w).all() or np.abs(w).max(initial=0.0) > _MAX_OMEGA:
        raise OptionError(f"omega must lie within ±{_MAX_OMEGA}; got {omega!r}")
    flat = w.ravel()
    nodes, lengths = legendre.leggauss(2 * chosen.degree + 16 + int(np.abs(flat).max(initial=0.0)))
    t = (nodes + 1) / 2
    result = np.empty_like(flat)
    step = max(1, _CHUNK // (t.size * chosen.support))
    for first in range(0, flat.size, step):
        part = flat[first : first + step]
        ideal = (1j * part[:, None]) ** derivative
        errors = [
            np.abs(_of_exponential(chosen, part, t, phase, derivative) - ideal) ** 2 @ lengths for phase in range(chosen.scale)
        ]
        result[first : first + step] = sum(errors) / (2 * chosen.scale)
    return result.reshape(w.shape)


def taylor_coefficients(filter: str | Filter, t: ArrayLike, count: int = 6, derivative: int = 0) -> Array:
    """Möller's Taylor coefficients a_n(t): the reconstruction is ``sum of a_n(t) f^(n)(x) T**n``, x = t between samples 0 and 1.

    An interpolating value filter should have a_0 = 1 and the others 0, a derivative filter a_1 = 1 and the others 0.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    t : array-like
        Positions within a sample, in [0, 1).
    count : int
        Number of coefficients, 1 to 12: n = 0, ..., count - 1.
    derivative : {0, 1}
        1: of the filter's derivative, which reconstructs f'.

    Returns
    -------
    ndarray of float64, shape (count, ...), the rest that of `t`

    Raises
    ------
    OptionError
        Unknown filter, or a number outside its bounds.
    """
    chosen, count, derivative = as_filter(filter), whole("count", count, 1, _MAX_TERMS), whole("derivative", derivative, 0, 1)
    x = reals("t", t)
    if not ((x >= 0) & (x < 1)).all():
        raise OptionError(f"t must lie in [0, 1); got {t!r}")
    u = chosen.scale * x - chosen.support / 2 + 1
    base = np.floor(u)
    result = np.empty((count, *x.shape))
    for n in range(count):
        every = np.array([polynomial.polyval(u - base, [float(c) for c in piece]) for piece in _taylor(chosen, n, derivative)])
        result[n] = np.take_along_axis(every, (base.astype(np.int64) % chosen.scale)[None], 0)[0]
    return result


# -- moments, in exact fractions if the filter has them ----------------------------------------------------


def _exact(filter: Filter) -> bool:
    return filter.exact and (filter.magnified_by is None or filter.magnified_by.exact)


def _taylor(filter: Filter, n: int, derivative: int) -> list[Polynomial]:
    """a_n as a polynomial in the tap position t, for each phase of the finer grid (one without a hybrid).

    With ``m_n(x) = sum over k of (k - x)**n eta(x - k)`` it is ``m_n / n!``, and for the derivative, since the
    derivative of ``(k - x)**n eta`` has two parts, ``(m_n' + n m_(n-1)) / n!``.
    """
    moments = _moments(filter, n)
    if derivative:
        below: list[list[Number]] = _moments(filter, n - 1) if n else [[Fraction(0)]] * filter.scale
        moments = [_plus(_slope(a, filter.scale), _times(b, [n])) for a, b in zip(moments, below, strict=True)]
    return [tuple(c / math.factorial(n) for c in m) for m in moments]


def _moments(filter: Filter, n: int) -> list[list[Number]]:
    """m_n of the whole reconstruction, for each phase of the finer grid."""
    if filter.magnified_by is None:
        return [_mixed(_inverse_moments(filter, n) if filter.prefilter else [int(i == 0) for i in range(n + 1)], filter, n)]
    by, s = filter.magnified_by, filter.scale
    result = []
    for phase in range(s):
        total: list[Number] = [Fraction(0)]
        for i in range(filter.support):
            # (k - x)**n, with the coarse spline's moments about the finer sample j / s that tap i takes
            at = Fraction((phase + i) % s, s)
            distance: list[Number] = [-(Fraction(filter.support, 2) - 1 - i) / s, Fraction(-1, s)]
            for m in range(n + 1):
                known = math.comb(n, m) * _moment_at(by, m, at)
                total = _plus(total, _times(filter.taps[i], _times(_power(distance, n - m), [known])))
        result.append(total)
    return result


def _moment_at(filter: Filter, n: int, x: Fraction) -> Number:
    t = (x - Fraction(filter.support, 2) + 1) % 1
    return _value(_moments(filter, n)[0], t)


def _mixed(inverse: list[Number], filter: Filter, n: int) -> list[Number]:
    """The kernel's moments mixed with those of the prefilter: (k - x)**n by the binomial theorem."""
    total: list[Number] = [Fraction(0)]
    for m in range(n + 1):
        if not inverse[n - m]:
            continue
        for i, weights in enumerate(filter.taps):
            distance: list[Number] = [-(Fraction(filter.support, 2) - 1 - i), Fraction(-1)]
            total = _plus(total, _times(weights, _times(_power(distance, m), [math.comb(n, m) * inverse[n - m]])))
    return total


def _inverse_moments(filter: Filter, n: int) -> list[Number]:
    """Moments ``sum of s_k k**m`` of the prefilter: combined with those of the sequence that it inverts they are 1, 0, 0, ..."""
    half = Fraction(filter.support, 2)
    undone: dict[int, Number] = {int(half - 1 - i + half % 1): _value(w, half % 1) for i, w in enumerate(filter.taps)}
    if filter.undone is not filter.samples:  # there is smoothing: (2 - 2 cos w)**order, expanded
        assert isinstance(filter.smoothing, float)
        order = filter.penalty
        for k in range(-order, order + 1):
            undone[k] = undone.get(k, Fraction(0)) + Fraction(filter.smoothing) * (-1) ** abs(k) * math.comb(2 * order, order + k)
    own = [sum((b * k**m for k, b in undone.items()), Fraction(0)) for m in range(n + 1)]
    result: list[Number] = []
    for m in range(n + 1):
        rest = sum((math.comb(m, j) * own[j] * result[m - j] for j in range(1, m + 1)), Fraction(0))
        result.append((int(m == 0) - rest) / own[0])
    return result


def _value(row: Sequence[Number], t: Number) -> Number:
    return sum((c * t**k for k, c in enumerate(row)), Fraction(0))


def _plus(a: Sequence[Number], b: Sequence[Number]) -> list[Number]:
    return [x + y for x, y in zip_longest(a, b, fillvalue=0)]


def _slope(a: Sequence[Number], scale: int) -> Sequence[Number]:
    return [scale * k * c for k, c in enumerate(a)][1:]


def _times(a: Sequence[Number], b: Sequence[Number]) -> list[Number]:
    product: list[Any] = np.convolve(np.array(a, object), np.array(b, object)).tolist()
    return product


def _power(a: list[Number], n: int) -> list[Number]:
    one: list[Number] = [Fraction(1)]
    return functools.reduce(_times, [a] * n, one)


# -- the reconstruction of a wave --------------------------------------------------------------------------


def _of_exponential(filter: Filter, omega: Array, t: Array, phase: int, derivative: int) -> NDArray[np.complex128]:
    """The reconstruction of ``exp(i w x)`` at tap position t, or its derivative, divided by ``exp(i w x)``; shape (omega, t)."""
    s = filter.scale
    weights = filter.weights(t, derivative) * float(s) ** derivative
    distance = t + filter.support / 2 - 1 - np.arange(filter.support)[:, None]
    terms = np.exp(-1j * omega[:, None, None] * distance / s) * weights
    if filter.magnified_by is not None:
        by = filter.magnified_by
        k = np.arange(-by.support, by.support + 1)
        for i in range(filter.support):
            place = (phase + i) % s / s
            terms[:, i] *= (np.exp(1j * omega[:, None] * (k - place)) @ by(place - k))[:, None]
    return np.asarray(terms.sum(1) * prefilter_response(filter, omega)[:, None])
