"""A reconstruction filter: a table of numbers, from which all its properties are derived.

A filter is a matrix of TAPS rows and DEGREE + 1 columns: row ``i`` holds the polynomial, in the
fractional position ``t``, of the weight of tap ``i``. For a position ``x`` (in samples)::

    u = x - TAPS/2 + 1        base = floor(u)        t = u - base
    f(x) = sum over i of  c[base + i] * sum over k of taps[i][k] * t**k

so tap ``i`` lies at signed distance ``t + TAPS/2 - 1 - i`` from ``x``, for odd and even
tap counts alike. Entries are exact fractions where possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.checks import flag, instance, number, whole
from clvol.base.errors import OptionError
from clvol.base.shown import Facts, Shown

__all__ = [
    "ALIASES",
    "MAX_DEGREE",
    "MAX_TAPS",
    "MOST_SMOOTHING",
    "Filter",
    "Polynomial",
    "Smoothing",
    "also_called",
    "as_polynomials",
    "as_smoothing",
    "smoothed",
]

Number: TypeAlias = Fraction | float
Polynomial: TypeAlias = tuple[Number, ...]
Smoothing: TypeAlias = float | tuple[float, ...] | Literal["auto"]
Array: TypeAlias = NDArray[np.float64]

MAX_TAPS = 16  # taps per row that one vector load of a kernel covers
MAX_DEGREE = 20
_MOST_WEIGHT = 1e12
_ROUNDING = 1e-9  # tolerance for comparing rows of floats
_LEAST_SMOOTHING = -0.25  # lower limit for quasi-interpolators, which sharpen: the prefilter of linear does not exist below
MOST_SMOOTHING = 1e5  # above it, poles are too close to the unit circle for float32

ALIASES = {
    "box": "nearest",
    "bspline0": "nearest",
    "bspline1": "linear",
    "bilinear": "linear",
    "trilinear": "linear",
    "quadratic": "bspline2",
    "bspline": "bspline3",
    "cubic": "bspline3",
    "tricubic": "bspline3",
    "quintic": "bspline5",
    "keys": "catmull-rom",
    "lanczos": "lanczos3",
}


@dataclass(frozen=True)
class Filter(Shown):
    """One row of the filter table.

    Parameters
    ----------
    name : str
        Its name in the table.
    taps : tuple of polynomials
        ``taps[i][k]`` is the coefficient of ``t**k`` for tap ``i``.
    prefilter : bool
        Solve for coefficients first (eq. 11), so that the result interpolates the samples.
    magnified_by : Filter, optional
        First magnify the samples by two with this filter, then reconstruct on the finer grid: the
        paper's hybrid (section 4.3).
    fit_error : float
        Largest absolute error of `taps` against the kernel they were fitted to; 0 if exact.
    smoothing : float, tuple of float or "auto"
        λ, from 0 to 10⁵, of a smoothing spline, which trades fidelity to the samples for smoothness: 0 interpolates. One
        number, or one per axis, x first. "auto" is chosen for each volume (`clvol.volume.smoothing.settled`). A negative λ
        sharpens (`quasi`).
    length : float, optional
        Instead of λ, a length ℓ in world units: λ is (ℓ / spacing)²ᵐ along each axis, where m is the `penalty`. A wave
        of wavelength 2πℓ keeps about half of its amplitude, whatever the spacing.

    Notes
    -----
    A smoothing spline of odd degree 2m - 1 minimises the sum of squared distances to the samples plus λ times the integral of
    its squared m-th derivative, along each axis in turn (Unser, Aldroubi and Eden, 1993); lengths are in samples. Its
    coefficients follow from eq. (13) with B(ω) + λ (2 - 2 cos ω)ᵐ in place of B(ω). An even degree uses m of the next odd
    degree, and the corresponding sum over coefficients as the penalty.
    """

    name: str
    taps: tuple[Polynomial, ...]
    prefilter: bool = False
    magnified_by: Filter | None = None
    fit_error: float = 0.0
    smoothing: Smoothing = 0.0
    length: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise OptionError(f"a filter's name must be a string that is not empty; got {self.name!r}")
        object.__setattr__(self, "taps", _held(self.name, as_polynomials(f"taps of {self.name!r}", self.taps)))
        if not 1 <= len(self.taps) <= MAX_TAPS:
            raise OptionError(f"a filter must have 1 to {MAX_TAPS} taps; {self.name!r} has {len(self.taps)}")
        if len({len(row) for row in self.taps}) != 1 or not 1 <= len(self.taps[0]) <= MAX_DEGREE + 1:
            raise OptionError(f"taps of {self.name!r} must be polynomials of one degree, 0 to {MAX_DEGREE}")
        number("fit_error", self.fit_error, minimum=0)
        if self.magnified_by is not None:
            instance("magnified_by", self.magnified_by, Filter)
        object.__setattr__(self, "smoothing", as_smoothing(self.smoothing, _LEAST_SMOOTHING))
        if self.length is not None:
            object.__setattr__(self, "length", number("length", self.length, minimum=0))
            if self.smoothing != 0:
                raise OptionError(f"give smoothing or length, not both; got {self.smoothing!r} and {self.length!r}")
        flag("prefilter", self.prefilter)
        if (self.smoothing != 0 or self.length is not None) and not self.prefilter:
            raise OptionError(f"smoothing takes a filter with a prefilter; {self.name!r} has none")
        if self.prefilter and self.settled:
            for row in self.along_axes:
                _require_invertible(row)

    def _facts(self) -> Facts:
        """Facts for notebooks: the properties of the filter beside its kernel."""
        return Facts(self.name, self.properties(), self.plot(33))

    def properties(self) -> dict[str, str]:
        """The derived properties, in words."""
        direct = self.interpolates_directly and not self.magnified_by
        return {
            "support": str(self.support),
            "degree": str(self.degree),
            "continuity": "jumps" if self.continuity < 0 else f"C{self.continuity}",
            "order": str(self.order),
            "interpolates": "no" if not self.interpolates else "yes" if direct else "prefiltered",
            "sums to one": "yes" if self.sums_to_one else "nearly",
            "poles": _poles_in_words(self.magnified_by or self),
            "also called": " ".join(also_called(self.name)),
        }

    # -- derived from the matrix -----------------------------------------------------------

    @cached_property
    def _hash(self) -> int:
        return hash((self.name, self.taps, self.prefilter, self.magnified_by, self.smoothing, self.length))

    def __hash__(self) -> int:
        """Cached: hashing many fractions takes longer than filtering a small array."""
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the fields only: cached properties are recomputed, because string hashes differ between processes."""
        return Filter, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def matrix(self) -> Array:
        """The taps as float64, shape (TAPS, DEGREE + 1)."""
        return np.array([[float(c) for c in row] for row in self.taps])

    @property
    def support(self) -> int:
        """Support of the kernel in samples: the number of taps along one axis."""
        return len(self.taps)

    @property
    def degree(self) -> int:
        """Degree of the polynomial pieces."""
        return len(self.taps[0]) - 1

    @property
    def scale(self) -> int:
        """Coefficients per sample along one axis: 2 for a hybrid, else 1."""
        return 2 if self.magnified_by else 1

    @property
    def exact(self) -> bool:
        """Whether all entries are exact fractions."""
        return all(isinstance(c, (int, Fraction)) for row in self.taps for c in row)

    @cached_property
    def continuity(self) -> int:
        """k, where the reconstructed function is Cᵏ; -1 if it jumps."""
        for k in range(self.degree + 1):
            rows = _derivatives(self.taps, k)
            # across a knot, tap i replaces tap i - 1
            starts = [0, *(_evaluate(row, 0) for row in rows)]
            ends = [*(_evaluate(row, 1) for row in rows), 0]
            if any(not _near(a, b, _slack(self, k)) for a, b in zip(starts, ends, strict=True)):
                return k - 1
        return self.degree  # a single polynomial: only the zero kernel

    @cached_property
    def order(self) -> int:
        """Approximation order: ``n`` if all polynomials of degree below ``n`` are reproduced.

        Strang and Fix: ``sum w_i(t) (x - x_i)**m`` may not depend on ``t``; without a prefilter it
        must also equal that of the identity, 1 for m = 0, else 0.
        """
        first = self.magnified_by.order if self.magnified_by else None
        for m in range(self.degree + 2):
            moment = _moment(self.taps, m)
            constant = all(_near(c, 0, _slack(self, 0)) for c in moment[1:])
            if not constant or not (self.prefilter or _near(moment[0], int(m == 0), _slack(self, 0))):
                return m if first is None else min(m, first)
        return self.degree + 2

    @cached_property
    def sums_to_one(self) -> bool:
        """Whether the weights sum to one at every position, so that constants stay constant."""
        return self.order >= 1

    @cached_property
    def interpolates(self) -> bool:
        """Whether the result interpolates the samples (with the prefilter, if it has one)."""
        if self.magnified_by and not self.magnified_by.interpolates:
            return False
        if self.prefilter:
            return self.smoothing == 0 and not self.length
        return self.interpolates_directly

    @cached_property
    def interpolates_directly(self) -> bool:
        """Whether the kernel itself is 1 at 0 and 0 at the other integers."""
        b = self.samples
        return abs(b[0] - 1) < _ROUNDING and bool(np.all(np.abs(b[1:]) < _ROUNDING))

    @cached_property
    def samples(self) -> Array:
        """The kernel at 0, 1, 2, ...: the prefilter inverts these (eqs 11 and 16)."""
        b = self(np.arange((self.support + 1) // 2))
        used = np.flatnonzero(np.abs(b) > _ROUNDING)
        return b[: used[-1] + 1] if used.size else b[:1]

    @property
    def settled(self) -> bool:
        """Whether it is the same for every volume: its smoothing is a number, not "auto" or a length."""
        fixed = self.smoothing != "auto" and self.length is None
        return fixed and (self.magnified_by is None or self.magnified_by.settled)

    @property
    def penalty(self) -> int:
        """The order m of the derivative that smoothing penalises: the degree is 2m - 1, or the even degree below."""
        return self.degree // 2 + 1

    def smoothed(self, smoothing: Smoothing | Sequence[float]) -> Filter:
        """The filter with other smoothing, and a name that states it: one number, one per axis, or "auto"."""
        return smoothed(self, as_smoothing(smoothing))

    def along(self, axis: int) -> Filter:
        """The filter along one axis, 0 for x: with the λ of that axis.

        Raises
        ------
        OptionError
            The filter has no λ for this axis, or depends on a volume (`settled` is False).
        """
        if not self.settled:
            raise OptionError(
                f"the smoothing of {self.name!r} is decided for a volume: clvol.volume.smoothing.settled(filter, volume)"
            )
        if not isinstance(self.smoothing, tuple):
            return self
        if axis >= len(self.smoothing):
            raise OptionError(f"{self.name!r} has smoothing for {len(self.smoothing)} axes; got axis {axis} (x is 0)")
        return smoothed(self, self.smoothing[axis])

    @property
    def along_axes(self) -> tuple[Filter, ...]:
        """The filters along the axes, x first; a single one if all are the same."""
        return tuple(map(self.along, range(len(self.smoothing) if isinstance(self.smoothing, tuple) else 1)))

    @cached_property
    def undone(self) -> Array:
        """The filter that the prefilter inverts, at distances 0, 1, 2, ...: `samples` + λ · penalty; 1 without a prefilter.

        Its transform is the denominator of eq. (16) plus λ (2 - 2 cos ω)ᵐ.
        """
        if not self.prefilter:
            return np.ones(1)
        if isinstance(self.smoothing, tuple):
            raise OptionError(f"{self.name!r} has another smoothing along each axis: take one, filter.along(axis)")
        smoothing, m = self.along(0).smoothing, self.penalty
        assert isinstance(smoothing, float)
        if abs(smoothing) < _ROUNDING:
            return self.samples
        b = np.zeros(max(self.samples.size, m + 1))
        b[: self.samples.size] = self.samples
        b[: m + 1] += [smoothing * (-1) ** k * math.comb(2 * m, m + k) for k in range(m + 1)]
        return b

    @cached_property
    def poles(self) -> NDArray[Any]:
        """Roots inside the unit circle of ``b0 + sum b_k (z**k + z**-k)``, b being `undone`; empty without a prefilter.

        For the cubic B-spline this is √3 - 2. Complex poles come in conjugate pairs.
        """
        if not self.prefilter:
            return np.empty(0)
        inside = self._roots[np.abs(self._roots) < 1]
        real = np.abs(inside.imag) < _ROUNDING
        return np.sort(inside.real if real.all() else np.where(real, inside.real, inside))

    @cached_property
    def has_gradient(self) -> bool:
        """Whether the function has a useful gradient; that of `nearest` is zero almost everywhere."""
        return self.degree >= 1

    def pairable(self, derivative: int = 0) -> bool:
        """Whether one linear fetch can read two taps: the weights of a pair never differ in sign.

        Taps are paired 0-1, 2-3, ...; an odd last one is single.
        """
        t = np.linspace(0, 1, 4097)
        w = self.weights(t, derivative)
        if w.shape[0] % 2:
            w = np.vstack([w, np.zeros_like(t)])
        return bool(np.all(w[0::2] * w[1::2] >= -1e-15))

    def weights(self, t: ArrayLike, derivative: int = 0) -> Array:
        """Tap weights, or their derivatives, at fractional positions `t`; shape (TAPS, ...)."""
        rows = polynomial.polyder(self.matrix, min(whole("derivative", derivative, 0), self.degree + 1), axis=1)
        return np.asarray(polynomial.polyval(reals("t", t), rows.T))

    def cell(self, x: ArrayLike) -> tuple[Array, Array]:
        """The index rule: the first tap's coefficient and the fraction for positions `x` in samples.

        ``u = x * scale - (TAPS/2 - 1)``, ``base = floor(u)`` and ``t = u - base``; the value at `x` is the sum over tap
        ``i`` of ``c[base + i]`` times its weight at `t`. cell.cl is this rule for kernels.

        Returns
        -------
        base, t : ndarray of float64, the shape of `x`
            Integers, as floats because a position may be far outside, and fractions in [0, 1).
        """
        u = np.asarray(x, dtype=np.float64) * self.scale - (self.support / 2 - 1)
        base = np.floor(u)
        return base, u - base

    def __call__(self, x: ArrayLike, derivative: int = 0) -> Array:
        """The kernel, or its derivative, at signed distance `x` in (finer) samples; same shape as `x`."""
        x = reals("x", x)
        x = np.where(np.abs(x) <= self.support, x, self.support)  # the kernel is zero at this distance and beyond
        base, t = self.cell(x / self.scale)
        inside = (base <= 0) & (base > -self.support)  # tap -base belongs to the coefficient at 0
        tap = np.where(inside, -base, 0).astype(np.int64)
        every = self.weights(np.where(inside, t, 0.0), derivative)
        return np.where(inside, np.take_along_axis(every, tap[None], 0)[0], 0.0)

    def plot(self, points: int = 129) -> tuple[Array, Array]:
        """Distances and kernel values for a plot: two arrays, `points` per unit piece."""
        points = whole("points", points, 2)
        half = self.support / 2
        x = np.linspace(-half, half, self.support * (points - 1) + 1)
        return x, self(x)

    @cached_property
    def _roots(self) -> NDArray[np.complex128]:
        b = self.undone
        return np.roots(np.concatenate([b[:0:-1], b])).astype(np.complex128) if b.size > 1 else np.empty(0, complex)


def as_polynomials(what: str, rows: object) -> tuple[Polynomial, ...]:
    """`rows` as polynomials; `OptionError` unless they are sequences of finite numbers."""
    try:
        polynomials = tuple(tuple(row) for row in rows)  # type: ignore[attr-defined]  # fails if not iterable
    except TypeError:
        raise OptionError(f"{what} must be sequences of numbers; got {rows!r}") from None
    for c in (c for row in polynomials for c in row):
        number(f"each of the {what}", c)
    return polynomials


def _held(name: str, taps: tuple[Polynomial, ...]) -> tuple[Polynomial, ...]:
    """Taps of a filter; `OptionError` if float32 does not hold their products."""
    if too_large := [c for row in taps for c in row if not -_MOST_WEIGHT <= c <= _MOST_WEIGHT]:
        raise OptionError(
            f"weights of {name!r} must be at most {_MOST_WEIGHT:g} in size, so that float32 holds their products along three axes; "
            f"got {Decimal(int(too_large[0])):.3g}"
        )
    return taps


def _require_invertible(row: Filter) -> None:
    inside = np.abs(row._roots) < 1
    at = np.arange(row.support)
    if np.abs(row(at) - row(-at)).max() > _ROUNDING * max(1.0, float(np.abs(row.samples).max())):
        raise OptionError(f"{row.name!r} cannot interpolate: its kernel is not even at the samples")
    if abs(row.samples[0]) < _ROUNDING and row.samples.size == 1:
        raise OptionError(f"{row.name!r} cannot interpolate: its kernel is zero at the samples")
    if 2 * inside.sum() != row._roots.size or np.any(np.abs(np.abs(row._roots) - 1) < 1e-3):
        raise OptionError(f"{row.name!r} cannot interpolate: its prefilter has poles on the unit circle")


def _poles_in_words(row: Filter) -> str:
    if not row.settled:
        return "the volume's"
    return "; ".join(" ".join(f"{p:.4f}" for p in along.poles) or "-" for along in row.along_axes)


def _slack(row: Filter, derivative: int) -> float:
    """Tolerance of an identity: 0 for exact rows."""
    return 0.0 if row.exact else max(_ROUNDING, 10 * row.fit_error) * max(1.0, float(row.degree) ** (2 * derivative))


def _derivatives(rows: Sequence[Polynomial], order: int) -> Sequence[Polynomial]:
    for _ in range(order):
        rows = [tuple(k * c for k, c in enumerate(row))[1:] or (0,) for row in rows]
    return rows


def _evaluate(row: Polynomial, t: int) -> Number:
    return sum((c * t**k for k, c in enumerate(row)), Fraction(0))


def _near(a: Number, b: Number, slack: float) -> bool:
    return abs(float(a - b)) <= slack


def _moment(taps: Sequence[Polynomial], m: int) -> list[Number]:
    """``sum over i of w_i(t) * (t + TAPS/2 - 1 - i)**m`` as a polynomial in t, exact where the taps are."""
    total: list[Number] = [Fraction(0)] * (len(taps[0]) + m)
    for i, row in enumerate(taps):
        shift = Fraction(len(taps), 2) - 1 - i
        for j in range(m + 1):
            factor = math.comb(m, j) * shift ** (m - j)
            for k, c in enumerate(row):
                total[j + k] += c * factor
    return total


@lru_cache(maxsize=1024)
def smoothed(filter: Filter, smoothing: Smoothing, length: float | None = None) -> Filter:
    """A filter with other smoothing, and a name that states it."""
    name = filter.name.rpartition("(")[0] if filter.smoothing != 0 or filter.length is not None else filter.name
    if length is not None:
        name += f"(length={_shortest(length)})"
    elif smoothing != 0:
        values = smoothing if isinstance(smoothing, tuple) else (smoothing,)
        name += f"({','.join(v if isinstance(v, str) else _shortest(v) for v in values)})"
    return replace(filter, name=name, smoothing=smoothing, length=length)


def _shortest(value: float) -> str:
    """The shortest text that gives the same number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def as_smoothing(value: object, least: float = 0.0) -> Smoothing:
    """λ, one per axis, or "auto", normalised for `Filter`: equal λ on all axes become one number."""
    if isinstance(value, str):
        if value == "auto":
            return "auto"
        raise OptionError(f'smoothing must be a number of at least 0, one for each axis, or "auto"; got {value!r}')
    if not isinstance(value, (tuple, list, np.ndarray)):
        return float(number("smoothing", value, minimum=least, maximum=MOST_SMOOTHING))
    values = tuple(float(number("smoothing along each axis", v, minimum=least, maximum=MOST_SMOOTHING)) for v in value)
    if len(values) not in (2, 3):
        raise OptionError(f"smoothing must be one number, or one for each of 2 or 3 axes; got {value!r}")
    return values[0] if len(set(values)) == 1 else values


def also_called(name: str) -> list[str]:
    """Aliases of a filter of the table."""
    return [other for other, row in ALIASES.items() if row == name]
