"""The table of reconstruction filters; everything about a filter is derived from its row.

A filter is a matrix of TAPS rows and DEGREE + 1 columns: row ``i`` holds the polynomial, in the
fractional position ``t``, of the weight of tap ``i``. For a position ``x`` (in samples)::

    u = x - TAPS/2 + 1        base = floor(u)        t = u - base
    f(x) = sum over i of  c[base + i] * sum over k of taps[i][k] * t**k

so tap ``i`` lies at signed distance ``t + TAPS/2 - 1 - i`` from ``x``; one rule for odd and even
tap counts. Entries are exact fractions wherever the filter has them.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from numbers import Rational
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import flag, number, one_of, reals, several, whole
from clvol.base.errors import ClvolError, OptionError
from clvol.show import html as display

__all__ = [
    "DEFAULT_FILTER",
    "MOST_SMOOTHING",
    "PICTURE_FILTER",
    "Filter",
    "FilterTable",
    "as_filter",
    "as_filters",
    "bc",
    "bspline",
    "filters",
    "from_callable",
    "from_pieces",
    "lanczos",
    "moms3",
    "omoms3",
    "quasi",
    "register",
    "several_names",
    "sinc",
    "unregister",
]

Number: TypeAlias = Fraction | float
Polynomial: TypeAlias = tuple[Number, ...]
Smoothing: TypeAlias = float | tuple[float, ...] | Literal["auto"]
Array: TypeAlias = NDArray[np.float64]

DEFAULT_FILTER = "bspline3"
PICTURE_FILTER = "bspline3(auto)"  # of pictures: data that are drawn should not show their noise
MAX_TAPS = 16  # the widest row that one vector load of the device code covers
_MAX_DEGREE = 20
_FIT_TOLERANCE = 1e-10  # of the kernel's peak: its second derivative then errs by about 1e-6
_MISFIT = 0.1  # of the kernel's peak: a fit that errs by more is another kernel
_SINC_DEGREE = 12  # of the fits to sinc and its windowed forms: more would cost derivatives in float32 what the fit gains
_ROUNDING = 1e-9  # floating rows are taken as zero, one or equal within this
_LEAST_SMOOTHING = -0.25  # of quasi-interpolators, which sharpen: linear's prefilter ends to exist there
MOST_SMOOTHING = 1e5  # beyond it poles lie so near to the unit circle that float32 cannot follow


@dataclass(frozen=True)
class Filter:
    """One row of the table.

    Parameters
    ----------
    name : str
        The name by which it is looked up.
    taps : tuple of polynomials
        ``taps[i][k]`` is the coefficient of ``t**k`` for tap ``i``.
    prefilter : bool
        Solve for the coefficients first (eq. 11), so that the result passes through the samples.
    magnify : str, optional
        Magnify the samples by two with this filter first, then reconstruct on the finer grid: the
        paper's hybrid (section 4.3).
    fit_error : float
        Largest absolute error of `taps` to the kernel that they were fitted to; 0 if exact.
    smoothing : float, tuple of float or "auto"
        λ, from 0 to 10⁵, of a smoothing spline, which trades closeness to the samples for smoothness: 0 passes through them. One
        number, or one for each axis, x first. "auto" is decided for each volume (`clvol.volume.smoothing.settled`). A negative one
        sharpens (`quasi`).
    length : float, optional
        Instead of λ, a length ℓ in world units: λ is (ℓ / spacing)²ᵐ along each axis, m being the `penalty`, so that a wave
        of wavelength 2πℓ keeps about half of its height, whatever the spacing.

    Notes
    -----
    A smoothing spline of odd degree 2m - 1 minimises the sum of squared distances to the samples plus λ times the integral of
    its squared m-th derivative, along each axis in turn (Unser, Aldroubi and Eden, 1993); lengths are in samples. Its
    coefficients are those of eq. (13) with B(ω) + λ (2 - 2 cos ω)ᵐ in place of B(ω). For even degrees m is that of the next odd
    one, and the penalty the corresponding sum over coefficients.
    """

    name: str
    taps: tuple[Polynomial, ...]
    prefilter: bool = False
    magnify: str | None = None
    fit_error: float = 0.0
    smoothing: Smoothing = 0.0
    length: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise OptionError(f"a filter's name must be a string that is not empty; got {self.name!r}")
        object.__setattr__(self, "taps", _rows(f"taps of {self.name!r}", self.taps))
        if not 1 <= len(self.taps) <= MAX_TAPS:
            raise OptionError(f"a filter must have 1 to {MAX_TAPS} taps; {self.name!r} has {len(self.taps)}")
        if len({len(row) for row in self.taps}) != 1 or not 1 <= len(self.taps[0]) <= _MAX_DEGREE + 1:
            raise OptionError(f"taps of {self.name!r} must be polynomials of one degree, 0 to {_MAX_DEGREE}")
        number("fit_error", self.fit_error, minimum=0)
        if self.magnify is not None and not isinstance(self.magnify, str):
            raise one_of("magnify", self.magnify, _TABLE)
        if self.magnify is not None:
            as_filter(self.magnify)
        object.__setattr__(self, "smoothing", _smoothing(self.smoothing, _LEAST_SMOOTHING))
        if self.length is not None:
            object.__setattr__(self, "length", number("length", self.length, minimum=0))
            if self.smoothing != 0:
                raise OptionError(f"give smoothing or length, not both; got {self.smoothing!r} and {self.length!r}")
        flag("prefilter", self.prefilter)
        if (self.smoothing != 0 or self.length is not None) and not self.prefilter:
            raise OptionError(f"smoothing takes a filter with a prefilter; {self.name!r} has none")
        if self.prefilter:
            axes = len(self.smoothing) if isinstance(self.smoothing, tuple) else 1
            for axis in range(axes if self.settled else 0):
                self.along(axis)._require_invertible()

    def _repr_html_(self) -> str:
        """For notebooks: its kernel, and its row of the table."""
        header, (row,) = FilterTable.HEADER, FilterTable({self.name: self}).rows()
        return display.beside(display.curve(*self.plot(33)), display.facts(self.name, dict(zip(header[1:], row[1:], strict=True))))

    # -- what follows from the matrix ------------------------------------------------------

    @cached_property
    def _hash(self) -> int:
        return hash((self.name, self.taps, self.prefilter, self.magnify, self.smoothing, self.length))

    def __hash__(self) -> int:
        """Computed once: that of many fractions takes longer than a small array."""
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        """Its fields alone are pickled: what follows from them is computed anew, and hashes of strings differ between processes."""
        return Filter, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def matrix(self) -> Array:
        """The taps as float64, shape (TAPS, DEGREE + 1)."""
        return np.array([[float(c) for c in row] for row in self.taps])

    @property
    def support(self) -> int:
        """Width of the kernel in samples: the number of taps along one axis."""
        return len(self.taps)

    @property
    def degree(self) -> int:
        """Degree of the polynomial pieces."""
        return len(self.taps[0]) - 1

    @property
    def scale(self) -> int:
        """Coefficients per sample along one axis: 2 for a hybrid, else 1."""
        return 2 if self.magnify else 1

    @property
    def exact(self) -> bool:
        """Whether the row is written in exact fractions."""
        return all(isinstance(c, (int, Fraction)) for row in self.taps for c in row)

    @cached_property
    def continuity(self) -> int:
        """The function drawn is Cᵏ; -1 where it jumps."""
        for k in range(self.degree + 1):
            rows = self._derivative(k)
            # past a knot, tap i takes the place of tap i - 1
            starts = [0, *(_evaluate(row, 0) for row in rows)]
            ends = [*(_evaluate(row, 1) for row in rows), 0]
            if any(not _near(a, b, self._slack(k)) for a, b in zip(starts, ends, strict=True)):
                return k - 1
        return self.degree  # one polynomial throughout: only the zero kernel

    @cached_property
    def order(self) -> int:
        """Order of the polynomials reproduced: ``n`` where every degree below ``n`` is exact.

        Strang and Fix: ``sum w_i(t) (x - x_i)**m`` may not depend on ``t``; without a prefilter it
        must also be what a kernel that changes nothing has, 1 for m = 0, else 0.
        """
        first = self.magnified_by.order if self.magnified_by else None
        for m in range(self.degree + 2):
            moment = _moment(self.taps, m)
            constant = all(_near(c, 0, self._slack(0)) for c in moment[1:])
            wanted = int(m == 0)
            if not constant or not (self.prefilter or _near(moment[0], wanted, self._slack(0))):
                return m if first is None else min(m, first)
        return self.degree + 2

    @cached_property
    def sums_to_one(self) -> bool:
        """Whether the weights sum to one at every position, so that constants stay constant."""
        return self.order >= 1

    @cached_property
    def interpolates(self) -> bool:
        """Whether the result passes through the samples (with the prefilter, where it has one)."""
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
        """The kernel at 0, 1, 2, ...: what the prefilter undoes (eqs 11 and 16)."""
        b = self(np.arange((self.support + 1) // 2))
        used = np.flatnonzero(np.abs(b) > _ROUNDING)
        return b[: used[-1] + 1] if used.size else b[:1]

    @property
    def settled(self) -> bool:
        """Whether it is the same for every volume: its smoothing is neither "auto" nor a length."""
        own = self.smoothing != "auto" and self.length is None
        return own and (self.magnified_by is None or self.magnified_by.settled)

    @property
    def penalty(self) -> int:
        """The order m of the derivative that smoothing keeps small: the degree is 2m - 1, or the even one below."""
        return self.degree // 2 + 1

    def smoothed(self, smoothing: Smoothing | Sequence[float]) -> Filter:
        """The same row with other smoothing, named after it: one number, one for each axis, or "auto"."""
        return _smoothed(self, _smoothing(smoothing))

    def along(self, axis: int) -> Filter:
        """What the row does along an axis, 0 being x: itself, but for λ that differs from axis to axis.

        Raises
        ------
        OptionError
            The row has no λ for this axis, or has still to be settled for a volume.
        """
        if not self.settled:
            raise OptionError(
                f"the smoothing of {self.name!r} is decided for a volume: clvol.volume.smoothing.settled(filter, volume)"
            )
        if not isinstance(self.smoothing, tuple):
            return self
        if axis >= len(self.smoothing):
            raise OptionError(f"{self.name!r} has smoothing for {len(self.smoothing)} axes; got axis {axis} (x is 0)")
        return _smoothed(self, self.smoothing[axis])

    @cached_property
    def undone(self) -> Array:
        """What the prefilter undoes, at distances 0, 1, 2, ...: `samples`, and λ times the penalty; 1 without a prefilter.

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

        For the cubic B-spline this is √3 - 2. Complex ones are conjugate pairs.
        """
        if not self.prefilter:
            return np.empty(0)
        inside = self._roots[np.abs(self._roots) < 1]
        real = np.abs(inside.imag) < _ROUNDING
        return np.sort(inside.real if real.all() else np.where(real, inside.real, inside))

    @cached_property
    def magnified_by(self) -> Filter | None:
        """The filter that first magnifies the samples, or None."""
        return as_filter(self.magnify) if self.magnify else None

    @cached_property
    def has_gradient(self) -> bool:
        """Whether the derivative of the function drawn says anything; `nearest` is flat nearly everywhere."""
        return self.degree >= 1

    def pairable(self, derivative: int = 0) -> bool:
        """Whether two taps can be had by one linear fetch: weights of a pair never differ in sign.

        Taps are paired 0-1, 2-3, ...; an odd one is alone.
        """
        t = np.linspace(0, 1, 4097)
        w = self.weights(t, derivative)
        if w.shape[0] % 2:
            w = np.vstack([w, np.zeros_like(t)])
        return bool(np.all(w[0::2] * w[1::2] >= -1e-15))

    def weights(self, t: ArrayLike, derivative: int = 0) -> Array:
        """Tap weights, or their derivatives, at fractional positions `t`; shape (TAPS, ...)."""
        rows = self.matrix
        for _ in range(min(whole("derivative", derivative, 0), self.degree + 1)):
            rows = rows[:, 1:] * np.arange(1, rows.shape[1]) if rows.shape[1] > 1 else np.zeros((self.support, 1))
        return np.asarray(np.polynomial.polynomial.polyval(reals("t", t), rows.T))

    def cell(self, x: ArrayLike) -> tuple[Array, Array]:
        """The first tap's coefficient and the fraction past it for positions `x` in samples: the index rule.

        ``u = x * scale - (TAPS/2 - 1)``, ``base = floor(u)`` and ``t = u - base``; the value at `x` is the sum over tap
        ``i`` of ``c[base + i]`` times its weight at `t`. In kernels cell.cl holds this rule.

        Returns
        -------
        base, t : ndarray of float64, the shape of `x`
            Whole numbers, as floats, for a position may lie far out; and fractions in [0, 1).
        """
        u = np.asarray(x, dtype=np.float64) * self.scale - (self.support / 2 - 1)
        base = np.floor(u)
        return base, u - base

    def __call__(self, x: ArrayLike, derivative: int = 0) -> Array:
        """The kernel, or its derivative, at signed distance `x` in (finer) samples; same shape as `x`."""
        x = reals("x", x)
        x = np.where(np.abs(x) <= self.support, x, self.support)  # the kernel is zero there, as at any distance beyond
        base, t = self.cell(x / self.scale)
        inside = (base <= 0) & (base > -self.support)  # tap -base is that of the coefficient at 0
        tap = np.where(inside, -base, 0).astype(np.int64)
        every = self.weights(np.where(inside, t, 0.0), derivative)
        return np.where(inside, np.take_along_axis(every, tap[None], 0)[0], 0.0)

    def plot(self, points: int = 129) -> tuple[Array, Array]:
        """Distance and kernel value for drawing the kernel: two arrays, `points` for each unit piece."""
        points = whole("points", points, 2)
        half = self.support / 2
        x = np.linspace(-half, half, self.support * (points - 1) + 1)
        return x, self(x)

    # -- inner ---------------------------------------------------------------------------------

    @cached_property
    def _roots(self) -> NDArray[np.complex128]:
        b = self.undone
        return np.roots(np.concatenate([b[:0:-1], b])).astype(np.complex128) if b.size > 1 else np.empty(0, complex)

    def _require_invertible(self) -> None:
        roots = self._roots
        inside = roots[np.abs(roots) < 1]
        at = np.arange(self.support)
        if np.abs(self(at) - self(-at)).max() > _ROUNDING * max(1.0, float(np.abs(self.samples).max())):
            raise OptionError(f"{self.name!r} cannot interpolate: its kernel is not even at the samples")
        if abs(self.samples[0]) < _ROUNDING and self.samples.size == 1:
            raise OptionError(f"{self.name!r} cannot interpolate: its kernel is zero at the samples")
        if 2 * inside.size != roots.size or np.any(np.abs(np.abs(roots) - 1) < 1e-3):
            raise OptionError(f"{self.name!r} cannot interpolate: its prefilter has poles on the unit circle")

    def _derivative(self, order: int) -> list[Polynomial]:
        rows = list(self.taps)
        for _ in range(order):
            rows = [tuple(k * c for k, c in enumerate(row))[1:] or (0,) for row in rows]
        return rows

    def _slack(self, derivative: int) -> float:
        """How far floating rows may miss an identity; exact rows may not at all."""
        if self.exact:
            return 0.0
        return max(_ROUNDING, 10 * self.fit_error) * max(1.0, float(self.degree) ** (2 * derivative))


def _rows(what: str, rows: object) -> tuple[Polynomial, ...]:
    """`rows` as polynomials; `OptionError` unless they are sequences of finite numbers."""
    try:
        polynomials = tuple(tuple(row) for row in rows)  # type: ignore[attr-defined]  # what cannot be iterated is refused
    except TypeError:
        raise OptionError(f"{what} must be sequences of numbers; got {rows!r}") from None
    for c in (c for row in polynomials for c in row):
        number(f"each of the {what}", c)
    return polynomials


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


# -- making rows -----------------------------------------------------------------------------------


def bspline(
    degree: int, *, prefilter: bool = True, smoothing: Smoothing | Sequence[float] = 0, length: float | None = None
) -> Filter:
    """The B-spline of a degree 0 to 9, by the recursion of eqs (3) and (4) on a uniform knot sequence.

    With `prefilter` it interpolates (section 4.2); without, it is the paper's approximation (4.1). Smoothing splines lie between
    the two, and beyond.

    Parameters
    ----------
    degree : int
    prefilter : bool
    smoothing : float, sequence of float, or "auto"
        λ ≥ 0, the same for all axes or one for each, x first; 0 interpolates. "auto" takes it from the noise of the volume.
        See `Filter`. Its name is "bspline3(0.1)", "bspline3(0.1,0.1,0.4)" or "bspline3(auto)".
    length : float, optional
        Instead, a length in world units. Its name is "bspline3(length=0.3)".

    Raises
    ------
    OptionError
        A degree outside 0 to 9; smoothing that is negative or more than 10⁵, which float32 could not follow, or given to a
        filter without a prefilter (degrees 0 and 1 have none).
    """
    degree = whole("degree", degree, 0, 9)
    made = _bspline(degree, flag("prefilter", prefilter) and degree >= 2)  # the first two interpolate as they are
    given = _smoothing(smoothing)
    length = None if length is None else float(number("length", length, minimum=0))
    return made if length is None and given == 0 else _smoothed(made, given, length)


@lru_cache
def _bspline(degree: int, prefilter: bool) -> Filter:
    # On the interval [0, 1), rows[m] is the spline that starts at knot -m.
    rows: list[list[Fraction]] = [[Fraction(1)]]
    for k in range(1, degree + 1):
        rows = [_next_degree(rows, k, m) for m in range(k + 1)]
    name = {0: "nearest", 1: "linear"}.get(degree, f"bspline{degree}" + ("" if prefilter else "-approx"))
    return Filter(name, tuple(tuple(row) for row in reversed(rows)), prefilter=prefilter)


@lru_cache(maxsize=1024)
def _smoothed(filter: Filter, smoothing: Smoothing, length: float | None = None) -> Filter:
    """A row with other smoothing, named after it."""
    name = filter.name.rpartition("(")[0] if filter.smoothing != 0 or filter.length is not None else filter.name
    if length is not None:
        name += f"(length={_shortest(length)})"
    elif smoothing != 0:
        values = smoothing if isinstance(smoothing, tuple) else (smoothing,)
        name += f"({','.join(v if isinstance(v, str) else _shortest(v) for v in values)})"
    return replace(filter, name=name, smoothing=smoothing, length=length)


def _shortest(value: float) -> str:
    """The fewest digits that give the same number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def _smoothing(value: object, least: float = 0.0) -> Smoothing:
    """λ, one for each axis, or "auto", as a filter holds it: the same for all axes is one number."""
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


def _next_degree(rows: list[list[Fraction]], k: int, m: int) -> list[Fraction]:
    """Eq. (4) for the spline of degree `k` that starts at knot ``-m``, given those of degree ``k - 1``."""
    result = [Fraction(0)] * (k + 1)
    if m < k:  # (u - u_i) / k times the spline that starts at the same knot
        for j, c in enumerate(rows[m]):
            result[j] += c * Fraction(m, k)
            result[j + 1] += c / k
    if m > 0:  # (u_{i+k+1} - u) / k times the one that starts a knot later
        for j, c in enumerate(rows[m - 1]):
            result[j] += c * Fraction(k + 1 - m, k)
            result[j + 1] -= c / k
    return result


def quasi(degree: int) -> Filter:
    """The quasi-interpolating B-spline of degree 1, 3 or 5: near the samples instead of through them, and nearer to the function.

    Interpolation errs by ``|B_L| / L! T**L f^(L)`` in the mean, L = degree + 1, with Bernoulli's number B_L: 1/12 for linear,
    1/720 for the cubic. A prefilter that takes it off leaves the asymptotic error of least squares, 0.41 of that of linear
    interpolation, 0.55 of that of the cubic, with the same taps (L. Condat, T. Blu and M. Unser, *Beyond interpolation: optimal
    reconstruction by quasi-interpolation*, ICIP 2005). It is a smoothing spline whose λ is negative, ``-|B_L| / L!``: linear's
    prefilter is ``12 / (z + 10 + 1/z)``. Noise grows by up to 1.5 along each axis, the cubic's 3 to 3.2.

    Raises
    ------
    OptionError
        Another degree: in even ones the mean error is 0.
    """
    bernoulli = {1: Fraction(1, 6), 3: Fraction(1, 30), 5: Fraction(1, 42)}
    if whole("degree", degree, 1, 5) not in bernoulli:
        raise OptionError(f"degree must be 1, 3 or 5; got {degree!r}")
    smoothing = -float(bernoulli[degree] / math.factorial(degree + 1))
    made = bspline(degree)
    return replace(made, name=f"{made.name}-quasi", prefilter=True, smoothing=smoothing)


def from_pieces(name: str, pieces: Sequence[Sequence[Number]], *, prefilter: bool = False) -> Filter:
    """A filter from an even kernel: ``pieces[j]`` are its coefficients in powers of ``|x|`` on [j, j + 1).

    Parameters
    ----------
    name : str
        Name of the new row.
    pieces : sequence of sequences of number
        Fractions and integers keep the row exact.
    prefilter : bool
        Make it interpolate by solving eq. (11) for its kernel.

    Raises
    ------
    OptionError
        More than eight pieces, or a prefilter that does not exist.
    """
    pieces = _rows(f"pieces of {name!r}", pieces)
    if not pieces:
        raise OptionError("pieces must hold at least one polynomial; got none")
    size = max(len(piece) for piece in pieces)
    taps = []
    for i in range(2 * len(pieces)):
        d = len(pieces) - 1 - i  # the tap lies at distance t + d
        piece, offset, sign = (pieces[d], d, 1) if d >= 0 else (pieces[-d - 1], -d, -1)  # |x| = offset + sign t
        row: list[Number] = [Fraction(0)] * size
        for k, c in enumerate(piece):
            exact = Fraction(c) if isinstance(c, (int, Fraction)) else float(c)
            for j in range(k + 1):
                row[j] += exact * math.comb(k, j) * offset ** (k - j) * sign**j
        taps.append(tuple(row))
    return Filter(name, tuple(taps), prefilter=prefilter)


def from_callable(
    name: str, kernel: Callable[[Array], ArrayLike], radius: int, *, prefilter: bool = False, degree: int | None = None
) -> Filter:
    """A filter fitted to an even kernel that is smooth between the integers.

    Parameters
    ----------
    name : str
        Name of the new row.
    kernel : callable
        Kernel values at an array of distances; called within ``[-radius, radius]``.
    radius : int
        Half the support, 1 to 8.
    prefilter : bool
        Make it interpolate by solving eq. (11) for its kernel.
    degree : int, optional
        Degree of the Chebyshev fit on each unit piece; by default the smallest that errs by no more
        than 1e-10 of the peak, at most 20.

    Returns
    -------
    Filter
        Its `fit_error` is the largest error found between the nodes of the fit.

    Raises
    ------
    OptionError
        A kernel that fails or gives other than finite numbers, or that jumps between the integers, unless `degree` is
        given.
    """
    radius = _radius(radius)
    degree = None if degree is None else whole("degree", degree, 0, _MAX_DEGREE)
    if not callable(kernel):
        raise OptionError(f"kernel must be a function of distances; got {kernel!r}")
    t = np.linspace(0, 1, 1001)
    distance = t[None, :] - np.arange(2 * radius)[:, None] + radius - 1
    # the ends of a piece belong to two pieces; a kernel that jumps there is evaluated just inside
    wanted = _kernel_at(name, kernel, np.clip(distance, distance[:, :1] + 1e-12, distance[:, -1:] - 1e-12))
    peak = float(np.abs(wanted).max())
    for n in [degree] if degree is not None else range(_MAX_DEGREE + 1):
        nodes = chebyshev.chebpts1(n + 1)
        at = (nodes + 1) / 2 - np.arange(2 * radius)[:, None] + radius - 1
        fits = chebyshev.chebfit(nodes, _kernel_at(name, kernel, at).T, n).T @ _chebyshev_powers(n)
        error = float(np.abs(np.polynomial.polynomial.polyval(t, fits.T) - wanted).max())
        if error <= _FIT_TOLERANCE * peak:
            break
    if degree is None and error > _MISFIT * peak:
        raise OptionError(
            f"the kernel of {name!r} must be smooth between the integers; "
            f"got one that polynomials of degree {n} miss by {error:.2g}"
        )
    return Filter(name, tuple(tuple(map(float, row)) for row in fits), prefilter=prefilter, fit_error=error)


def _kernel_at(name: str, kernel: Callable[[Array], ArrayLike], distance: Array) -> Array:
    rule = "one finite value for each distance"
    try:
        values = kernel(distance)
    except ClvolError:
        raise
    except Exception as error:
        raise OptionError(f"the kernel of {name!r} must give {rule}; it failed: {error!r}") from error
    array = reals(f"the values of the kernel of {name!r}", values, rule)
    if array.shape != distance.shape or not np.isfinite(array).all():
        raise OptionError(f"the kernel of {name!r} must give {rule}")
    return array


def _radius(radius: object) -> int:
    return whole("radius", radius, 1, MAX_TAPS // 2)


@lru_cache
def _chebyshev_powers(degree: int) -> Array:
    """Coefficients in powers of t, one row each, of the Chebyshev polynomials of 2t - 1 up to a degree: whole numbers, exact."""
    rows = np.zeros((degree + 2, degree + 2))
    rows[0, 0], rows[1, :2] = 1, (-1, 2)
    for k in range(2, degree + 1):
        rows[k] = -2 * rows[k - 1] - rows[k - 2]
        rows[k, 1:] += 4 * rows[k - 1, :-1]
    return rows[: degree + 1, : degree + 1]


def bc(B: Number, C: Number) -> Filter:
    """The cubic of Mitchell and Netravali with parameters B and C (reference [10] of the paper).

    (1, 0) is the cubic B-spline without prefilter, (1/3, 1/3) theirs, (0, 1/2) Catmull-Rom.
    """
    b, c = _exact("B and C", B), _exact("B and C", C)
    return _bc(f"bc({b},{c})", Fraction(b), Fraction(c))


def _exact(what: str, value: object) -> Number:
    """`value` as a fraction where it is one or a whole number, else as a float."""
    real = number(what, value)
    if isinstance(value, Rational):
        return Fraction(int(value.numerator), int(value.denominator))
    return Fraction(real) if real.is_integer() else real


@lru_cache
def _bc(name: str, b: Fraction, c: Fraction) -> Filter:
    return from_pieces(
        name,
        [
            ((6 - 2 * b) / 6, 0, (-18 + 12 * b + 6 * c) / 6, (12 - 9 * b - 6 * c) / 6),
            ((8 * b + 24 * c) / 6, (-12 * b - 48 * c) / 6, (6 * b + 30 * c) / 6, (-b - 6 * c) / 6),
        ],
    )


def sinc(radius: int = 4, *, normalized: bool = False) -> Filter:
    """The ideal filter cut off at `radius` samples, 1 to 8.

    As the paper has it, the weights miss one by up to 0.08 at radius 4: what truncation does is to be seen. With
    `normalized` they are divided by their sum, which is how programs use it; that is Berrut's rational interpolant of the
    nearest ``2 radius`` samples (Computers & Mathematics with Applications 15, 1988).
    """
    return _sinc(_radius(radius), flag("normalized", normalized))


@lru_cache
def _sinc(radius: int, normalized: bool) -> Filter:
    if normalized:
        return _normalized("sinc4n" if radius == 4 else f"sincn({radius})", np.sinc, radius, 2)
    return from_callable("sinc" if radius == 4 else f"sinc({radius})", np.sinc, radius, degree=_SINC_DEGREE)


def lanczos(radius: int, *, normalized: bool = False) -> Filter:
    """Sinc under the window sinc(x / radius), radius 1 to 8.

    Its weights sum to one only nearly; with `normalized` they are divided by their sum.
    """
    return _lanczos(_radius(radius), flag("normalized", normalized))


@lru_cache
def _lanczos(radius: int, normalized: bool) -> Filter:
    def kernel(x: Array) -> Array:
        return np.asarray(np.sinc(x) * np.sinc(x / radius))

    if normalized:
        return _normalized("lanczos3n" if radius == 3 else f"lanczosn({radius})", kernel, radius, 1)
    return from_callable(f"lanczos{radius}", kernel, radius, degree=_SINC_DEGREE)


def _normalized(name: str, kernel: Callable[[Array], Array], radius: int, order: int) -> Filter:
    """The row of a kernel, 1 at 0 and 0 at the other integers, whose weights are divided by their sum.

    What holds of the quotients and only nearly of the fits is restored: a line added to each makes it exact at the
    samples, and the smallest change of the weights brings back the polynomials below `order`.
    """
    shifts = radius - 1.0 - np.arange(2 * radius)  # tap i lies at t + shifts[i]

    def divided(x: Array) -> Array:
        return np.asarray(kernel(x) / kernel((x - np.floor(x))[..., None] + shifts).sum(-1))

    row = from_callable(name, divided, radius, degree=_SINC_DEGREE)
    rows = row.matrix.copy()
    rows[:, 0] = shifts == 0
    rows[:, 1] += (shifts == -1) - rows.sum(1)
    powers = np.vander(shifts, order, increasing=True).T
    wanted = np.zeros((order, rows.shape[1]))  # the sum of w_i(t) (t + shifts[i])**m is that of m = 0 alone
    wanted[range(order), range(order)] = (-1.0) ** np.arange(order)
    rows += np.linalg.pinv(powers) @ (wanted - powers @ rows)
    row = replace(row, taps=tuple(map(tuple, rows.tolist())))
    t = np.linspace(0, 1, 1001)[1:-1]
    return replace(row, fit_error=float(np.abs(row.weights(t) - divided(t + shifts[:, None])).max()))


def moms3(weight: Number = Fraction(1, 56)) -> Filter:
    """The cubic B-spline plus `weight` of its second derivative: order 4 on support 4, prefiltered.

    Blu, Thévenaz and Unser (*MOMS: maximal-order interpolation of minimal support*, IEEE Trans. Image Processing 10, 2001).
    All even kernels of that order and support are among these: 0 is the cubic B-spline, -1/6 the cubic Lagrange
    interpolant. With samples ever finer, the RMS error of interpolation is `constant` times that of ``T**4 f^(4)``, where::

        constant**2 = (1/720 - weight/12)**2 + 1/1209600 - weight/15120 + weight**2/720

    1/56, the default, makes it the smallest: 0.19 of the B-spline's.

    Parameters
    ----------
    weight : number
        Below 1/12, where the prefilter ceases to exist.
    """
    w = _exact("weight", weight)
    return _moms3("moms3" if w == Fraction(1, 56) else f"moms3({w})", Fraction(w))


@lru_cache
def _moms3(name: str, weight: Fraction) -> Filter:
    taps = tuple((a + 2 * c * weight, b + 6 * d * weight, c, d) for a, b, c, d in bspline(3).taps)
    return Filter(name, taps, prefilter=True)


def omoms3() -> Filter:
    """`moms3` of 1/42, the best of them for least squares: where coefficients are fitted to the function itself.

    Its asymptotic error is then 0.22 of that of the cubic B-spline (Blu, Thévenaz and Unser, 2001). As it is used here,
    through samples, it is 0.38 of it, and twice that of `moms3`.
    """
    return replace(moms3(Fraction(1, 42)), name="omoms3")


# -- the table -------------------------------------------------------------------------------------

_TABLE: dict[str, Filter] = {}
_ALIASES = {
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
_FAMILIES: dict[str, tuple[str, Callable[..., Filter]]] = {
    "bc": ("B, C", bc),
    "moms3": ("weight", moms3),
    "sinc": ("radius", lambda radius: sinc(_whole(radius))),
    "sincn": ("radius", lambda radius: sinc(_whole(radius), normalized=True)),
    "lanczos": ("radius", lambda radius: lanczos(_whole(radius))),
    "lanczosn": ("radius", lambda radius: lanczos(_whole(radius), normalized=True)),
}
_SMOOTHED = "bspline3(0.1), bspline3(auto), bspline3(length=0.5)"


def register(new: Filter, *, replace_existing: bool = False) -> Filter:
    """Add a filter to the table, so that its name can be given wherever a filter is expected; returns it."""
    if not isinstance(new, Filter):
        raise OptionError(f"register takes a Filter; got {new!r}")
    if not re.fullmatch(r"[a-zA-Z][\w.+-]*(\([\w.+/,-]*\))?", new.name):
        raise OptionError(
            "a filter's name must be a letter, then letters, digits, '-', '+', '.' or '_', and perhaps "
            f"parameters in parentheses; got {new.name!r}"
        )
    if (new.name in _TABLE or new.name in _ALIASES) and not replace_existing:
        raise OptionError(f"a filter named {new.name!r} exists; pass replace_existing=True to replace it")
    _TABLE[new.name] = new
    return new


def unregister(name: str) -> Filter:
    """Remove a filter from the table and return it; `OptionError` if there is none of that name.

    The filters that clvol comes with may be removed, too; ``register(unregister("linear"))`` puts one back.
    """
    if not isinstance(name, str) or name not in _TABLE:
        raise one_of("filter", name, _TABLE)
    return _TABLE.pop(name)


class FilterTable(display.Named[Filter]):
    """Every filter by name; shown, it is a table."""

    HEADER = ("filter", "support", "degree", "continuity", "order", "interpolates", "sums to one", "poles", "also called")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of texts a filter, in the order of `HEADER`."""
        return [
            (
                name,
                str(f.support),
                str(f.degree),
                "jumps" if f.continuity < 0 else f"C{f.continuity}",
                str(f.order),
                "no" if not f.interpolates else "yes" if f.interpolates_directly and not f.magnify else "prefiltered",
                "yes" if f.sums_to_one else "nearly",
                _poles_in_words(f.magnified_by or f),
                " ".join(_also(name)) if f is _TABLE.get(name) else "",
            )
            for name, f in self.items()
        ]


def _also(name: str) -> list[str]:
    """What else a row of the table is called."""
    return [other for other, row in _ALIASES.items() if row == name]


def _poles_in_words(filter: Filter) -> str:
    if not filter.settled:
        return "the volume's"
    if isinstance(filter.smoothing, tuple):
        return "; ".join(_poles_in_words(filter.along(axis)) for axis in range(len(filter.smoothing)))
    return " ".join(f"{p:.4f}" for p in filter.poles) or "-"


def filters() -> FilterTable:
    """The table: every filter by name, in order; shown, it says what each has, and what else it is called."""
    return FilterTable(_TABLE)


def as_filter(choice: str | Filter) -> Filter:
    """The row for a name, an alias, or a family with its parameters, such as ``"bc(0, 1/2)"``, ``"sinc(6)"``, ``"bspline3(0.1)"``,
    ``"bspline3(0.1, 0.1, 0.4)"``, ``"bspline3(auto)"`` or ``"bspline3(length=0.5)"``.
    """
    if isinstance(choice, Filter):
        return choice
    if not isinstance(choice, str):
        raise one_of("filter", choice, _TABLE)
    name = choice.strip().lower()
    name = _ALIASES.get(name, name)
    if name in _TABLE:
        return _TABLE[name]
    if choice in _TABLE:
        return _TABLE[choice]
    written = [f"{family}({parameters})" for family, (parameters, _) in _FAMILIES.items()]
    if (match := re.fullmatch(r"(\w+)\(([^()]*)\)", name)) and match[1] in _FAMILIES:
        try:
            return _FAMILIES[match[1]][1](*(Fraction(v.strip()) for v in match[2].split(",")))
        except (ValueError, TypeError, ZeroDivisionError):
            raise OptionError(f"filter {choice!r} has wrong parameters; write {', '.join(written[:-1])} or {written[-1]}") from None
    if match := re.fullmatch(r"bspline([6-9])", name):  # what one that smooths is called where there is nothing to smooth
        return bspline(int(match[1]))
    if match := re.fullmatch(r"(?:bspline|cubic)\(([^()]*)\)|bspline(\d)\(([^()]*)\)", name):
        return _smoothed_by_name(choice, int(match[2] or 3), match[1] or match[3] or "")
    near = difflib.get_close_matches(name, [*_TABLE, *_ALIASES], 1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    known = [f"{row} ({', '.join(_also(row))})" if _also(row) else row for row in _TABLE]
    raise OptionError(
        f"filter must be one of {', '.join([*known, *written, 'bspline3(λ)', 'bspline3(auto)'])}; got {choice!r}{hint}"
    )


def _smoothed_by_name(choice: str, degree: int, text: str) -> Filter:
    try:
        if text.strip() == "auto":
            return bspline(degree, smoothing="auto")
        key, given, value = text.partition("=")
        if given and key.strip() == "length":
            return bspline(degree, length=float(Fraction(value.strip())))
        values = [float(Fraction(v.strip())) for v in text.split(",")]
        return bspline(degree, smoothing=values[0] if len(values) == 1 else tuple(values))
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        reason = f": {error}" if isinstance(error, OptionError) else ""
        raise OptionError(f"filter {choice!r} has wrong parameters; write it as one of {_SMOOTHED}{reason}") from None


def as_filters(choices: Sequence[str | Filter], maximum: int | None = None) -> list[Filter]:
    """The filters of one or more names, at most `maximum`."""
    return [as_filter(choice) for choice in several_names(choices, maximum)]


def several_names(choices: object, maximum: int | None = None) -> list[Any]:
    """The one or more names or rows that `filters` says, not yet looked up."""
    if isinstance(choices, Filter):
        raise OptionError(f"filters must be one or more names; got {choices!r}")
    return several("filters", choices, "one or more names", maximum)


def _whole(value: Fraction) -> int:
    if value.denominator != 1:
        raise ValueError
    return int(value)


for _row in (
    bspline(0),
    bspline(1),
    *(bspline(degree) for degree in (2, 3, 4, 5)),
    *(bspline(degree, prefilter=False) for degree in (2, 3, 4, 5)),
    replace(bc(Fraction(1, 3), Fraction(1, 3)), name="mitchell"),
    replace(bc(0, Fraction(1, 2)), name="catmull-rom"),
    omoms3(),
    moms3(),
    quasi(1),
    quasi(3),
    *(lanczos(radius) for radius in (2, 3, 4, 5)),
    lanczos(3, normalized=True),
    sinc(),
    sinc(normalized=True),
):
    register(_row)
register(replace(bspline(1), name="hybrid", magnify="bspline3"))
