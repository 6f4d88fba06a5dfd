"""Reconstruction kernels by their closed forms, as functions of the distance x."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import Array
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import bc, bspline, lanczos, moms3, sinc, wide
from clvol.filter.table import as_filter

__all__ = ["kernel"]

Closed: TypeAlias = Callable[[Array, int], Array]


def kernel(filter: str | Filter, x: ArrayLike, derivative: int = 0) -> Array:
    """The kernel of a filter, or its derivative, at signed distances.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table or of its families. A user's filter has no closed form here: `Filter.__call__` is used, and a
        comparison with it proves nothing.
    x : array-like
        Distances in samples (of the finer grid for a hybrid).
    derivative : {0, 1, 2}
        Derivatives exist almost everywhere; at a jump the value is that from the right, which is t = 0 in
        ``u = x - TAPS/2 + 1, t = u - floor(u)``.

    Returns
    -------
    ndarray of float64, the shape of `x`
    """
    if derivative not in (0, 1, 2):
        raise OptionError(f"derivative must be 0, 1 or 2; got {derivative!r}")
    chosen = as_filter(filter)
    distance = np.asarray(x, dtype=np.float64)
    closed = _closed_form(chosen)
    return chosen(distance, derivative) if closed is None else closed(distance, derivative)


def _closed_form(filter: Filter) -> Closed | None:
    """The closed form of a filter, recognised by its name if the family has exactly these taps."""
    name = filter.name
    made, closed = None, None
    if name in ("nearest", "linear", "linear-quasi", "hybrid") or re.fullmatch(r"bspline[2-9](-approx|-quasi|\(.*\))?", name):
        degree = int(name[7]) if name[0] == "b" else int(name != "nearest")
        made, closed = bspline(degree), _bspline(degree)
    elif name in ("mitchell", "catmull-rom") or name.startswith("bc("):
        b, c = {"mitchell": (Fraction(1, 3), Fraction(1, 3)), "catmull-rom": (Fraction(0), Fraction(1, 2))}.get(name) or (
            Fraction(v) if "/" in v else Fraction(float(v)) for v in name[3:-1].split(",")
        )
        made, closed = bc(b, c), _bc(float(b), float(c))
    elif match := re.fullmatch(r"(o?moms3)(?:\((-?\d+/[1-9]\d*|-?[\d.]+(?:e-?\d+)?)\))?", name):
        value = match[2] or {"omoms3": "1/42", "moms3": "1/56"}[match[1]]
        weight = Fraction(value) if "/" in value else Fraction(float(value))
        made, closed = moms3(weight), _moms3(float(weight))
    elif match := re.fullmatch(r"wide\(([1-4])\)", name):
        made, closed = wide(int(match[1])), _stretched(int(match[1]))
    elif match := re.fullmatch(r"(sinc|lanczos)(\d*)(n?)(?:\((\d+)\))?", name):
        radius = int(match[2] or match[4] or 4)
        if not 1 <= radius <= 8:
            return None
        made = (sinc if match[1] == "sinc" else lanczos)(radius, normalized=bool(match[3]))
        closed = (_sinc if match[1] == "sinc" else _lanczos)(radius)
        closed = _normalized(closed, radius) if match[3] else closed
    return closed if made is not None and made.taps == filter.taps else None


def _power(x: Array, k: int) -> Array:
    """The truncated power ``x**k H(x)``, with the Heaviside step H(0) = 1."""
    return np.where(x >= 0, np.where(x >= 0, x, 1.0) ** k, 0.0)


def _bspline(degree: int) -> Closed:
    def closed(x: Array, derivative: int) -> Array:
        """Eq. (6); differentiated, the power falls by one and so does its factorial."""
        k, left = degree, degree - derivative
        if left < 0:
            return np.zeros_like(x)
        x = np.where(np.abs(x) <= k + 1, x, k + 1.0)  # far outside the powers would cancel
        total = np.zeros_like(x)
        for i in range(k + 2):
            total += (-1) ** i * math.comb(k + 1, i) * _power(x - i + (k + 1) / 2, left)
        return np.where((x >= -(k + 1) / 2) & (x < (k + 1) / 2), total / math.factorial(left), 0.0)

    return closed


def _stretched(width: int) -> Closed:
    narrow = _bspline(3)
    return lambda x, derivative: narrow(x / width, derivative) / width ** (derivative + 1)


def _bc(b: float, c: float) -> Closed:
    near = np.array([6 - 2 * b, 0, -18 + 12 * b + 6 * c, 12 - 9 * b - 6 * c]) / 6
    far = np.array([8 * b + 24 * c, -12 * b - 48 * c, 6 * b + 30 * c, -b - 6 * c]) / 6

    def closed(x: Array, derivative: int) -> Array:
        """Mitchell and Netravali (1988), eq. 8, in |x|; eq. (10) of the paper for B = 1, C = 0."""
        r, chain = np.abs(x), np.where(x < 0, -1.0, 1.0) ** derivative  # d|x|/dx, once a derivative

        def piece(coefficients: Array) -> Array:
            return np.asarray(np.polynomial.Polynomial(coefficients).deriv(derivative)(r))

        inner, outer = (x >= -1) & (x < 1), (x >= -2) & (x < 2)
        return np.asarray(chain * np.where(inner, piece(near), np.where(outer, piece(far), 0.0)))

    return closed


def _moms3(weight: float) -> Closed:
    def closed(x: Array, derivative: int) -> Array:
        """β3 + weight β3'' (Blu, Thévenaz and Unser, 2001)."""
        return _bspline(3)(x, derivative) + weight * _bspline(3)(x, derivative + 2)

    return closed


def _sinc_and_derivatives(x: Array) -> tuple[Array, Array, Array]:
    """sin(πx)/(πx) and its first two derivatives."""
    small = np.abs(x) < 0.1
    safe = np.where(small, 1.0, x)
    s0 = np.sinc(safe)
    s1 = (np.cos(np.pi * safe) - s0) / safe
    s2 = -(np.pi**2) * s0 - 2 * s1 / safe
    # the quotients cancel near 0: there sinc = sum of (-1)^m (πx)^(2m) / (2m + 1)!
    series = np.zeros(17)
    for m in range(9):
        series[2 * m] = (-1) ** m * np.pi ** (2 * m) / math.factorial(2 * m + 1)
    taylor = np.polynomial.Polynomial(series)
    return (np.where(small, taylor(x), s0), np.where(small, taylor.deriv(1)(x), s1), np.where(small, taylor.deriv(2)(x), s2))


def _sinc(radius: int) -> Closed:
    def closed(x: Array, derivative: int) -> Array:
        return np.where((x >= -radius) & (x < radius), _sinc_and_derivatives(x)[derivative], 0.0)

    return closed


def _lanczos(radius: int) -> Closed:
    def closed(x: Array, derivative: int) -> Array:
        """The product of two sincs, by the product rule."""
        s = _sinc_and_derivatives(x)
        w = [v / radius**m for m, v in enumerate(_sinc_and_derivatives(x / radius))]
        product = (s[0] * w[0], s[1] * w[0] + s[0] * w[1], s[2] * w[0] + 2 * s[1] * w[1] + s[0] * w[2])[derivative]
        return np.where((x >= -radius) & (x < radius), product, 0.0)

    return closed


def _normalized(kernel: Closed, radius: int) -> Closed:
    def closed(x: Array, derivative: int) -> Array:
        """The quotient of the kernel and its sum over the samples, by the quotient rule."""
        inside = (x >= -radius) & (x < radius)
        x = np.where(inside, x, 0.0)
        taps = (x - np.floor(x))[..., None] + np.arange(-radius, radius)
        total = [kernel(taps, m).sum(-1) for m in range(derivative + 1)]
        drawn: list[Array] = []
        for m in range(derivative + 1):  # from (drawn total)^(m) = kernel^(m)
            rest = sum((math.comb(m, j) * drawn[j] * total[m - j] for j in range(m)), np.zeros_like(x))
            drawn.append((kernel(x, m) - rest) / total[0])
        return np.where(inside, drawn[derivative], 0.0)

    return closed
