"""Constructors of filters: B-splines by their recursion, cubics, MOMS, windowed sinc, and custom kernels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from numbers import Rational

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from clvol.base.arrays import reals
from clvol.base.checks import flag, number, whole
from clvol.base.errors import ClvolError, OptionError
from clvol.filter.filter import MAX_DEGREE, MAX_TAPS, Array, Filter, Number, Smoothing, as_polynomials, as_smoothing, smoothed

__all__ = ["bc", "bspline", "from_callable", "from_pieces", "lanczos", "moms3", "omoms3", "quasi", "sinc", "wide"]

_FIT_TOLERANCE = 1e-10  # relative to the kernel's peak: the error of its second derivative is then about 1e-6
_MISFIT = 0.1  # relative to the kernel's peak: a fit with a larger error is rejected
_DIGITS = 1e16  # numbers in names that are written in full
_SINC_DEGREE = 12  # degree of the fits to sinc and its windowed forms: with more, float32 derivatives lose what the fit gains


def bspline(
    degree: int, *, prefilter: bool = True, smoothing: Smoothing | Sequence[float] = 0, length: float | None = None
) -> Filter:
    """The B-spline of degree 0 to 9, by the recursion of eqs (3) and (4) on a uniform knot sequence.

    With `prefilter` it interpolates (section 4.2); without, it is the paper's approximation (4.1). Smoothing splines are between
    the two and beyond.

    Parameters
    ----------
    degree : int
    prefilter : bool
    smoothing : float, sequence of float, or "auto"
        λ ≥ 0, one for all axes or one per axis, x first; 0 interpolates. "auto" estimates it from the noise of the volume.
        See `Filter`. The name is then "bspline3(0.1)", "bspline3(0.1,0.1,0.4)" or "bspline3(auto)".
    length : float, optional
        Instead of λ, a length in world units. The name is then "bspline3(length=0.3)".

    Raises
    ------
    OptionError
        The degree is outside 0 to 9; smoothing is negative or above 10⁵, the limit of float32, or given for a filter
        without a prefilter (degrees 0 and 1 have none).

    References
    ----------
    - M. Unser, A. Aldroubi and M. Eden, "Fast B-spline transforms for continuous image representation and interpolation",
      IEEE Transactions on Pattern Analysis and Machine Intelligence 13(3), 1991, 277–285: reference [15] of the paper.
    - M. Unser, A. Aldroubi and M. Eden, "B-spline signal processing", parts I and II, IEEE Transactions on Signal
      Processing 41(2), 1993, 821–848.

    Examples
    --------
    >>> import clvol
    >>> clvol.bspline(5).support
    6
    >>> smooth = clvol.bspline(3, smoothing=(0.1, 0.1, 0.4))  # along x, y, z
    """
    degree = whole("degree", degree, 0, 9)
    result = _bspline(degree, flag("prefilter", prefilter) and degree >= 2)  # degrees 0 and 1 interpolate without it
    given = as_smoothing(smoothing)
    length = None if length is None else float(number("length", length, minimum=0))
    return result if length is None and given == 0 else smoothed(result, given, length)


@lru_cache
def _bspline(degree: int, prefilter: bool) -> Filter:
    # On the interval [0, 1), rows[m] is the spline that starts at knot -m.
    rows: list[list[Fraction]] = [[Fraction(1)]]
    for k in range(1, degree + 1):
        rows = [_next_degree(rows, k, m) for m in range(k + 1)]
    name = {0: "nearest", 1: "linear"}.get(degree, f"bspline{degree}" + ("" if prefilter else "-approx"))
    return Filter(name, tuple(tuple(row) for row in reversed(rows)), prefilter=prefilter)


def _next_degree(rows: list[list[Fraction]], k: int, m: int) -> list[Fraction]:
    """Eq. (4): the spline of degree `k` that starts at knot ``-m``, from the splines of degree ``k - 1``."""
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
    """The quasi-interpolating B-spline of degree 1, 3 or 5: it misses the samples slightly, and fits the function better.

    The mean error of interpolation is ``|B_L| / L! T**L f^(L)``, where L = degree + 1 and B_L is Bernoulli's number: 1/12 for
    linear, 1/720 for cubic. A prefilter that removes it leaves the asymptotic error of least squares: 0.41 of that of linear
    interpolation, 0.55 of that of cubic, with the same taps (L. Condat, T. Blu and M. Unser, *Beyond interpolation: optimal
    reconstruction by quasi-interpolation*, ICIP 2005). This is a smoothing spline with negative λ, ``-|B_L| / L!``; the
    prefilter of linear is ``12 / (z + 10 + 1/z)``. It amplifies noise by up to 1.5 along each axis, that of cubic from 3 to 3.2.

    Raises
    ------
    OptionError
        Another degree; for even degrees the mean error is 0.

    References
    ----------
    - L. Condat, T. Blu and M. Unser, "Beyond interpolation: optimal reconstruction by quasi-interpolation", IEEE
      International Conference on Image Processing, 2005.
    """
    bernoulli = {1: Fraction(1, 6), 3: Fraction(1, 30), 5: Fraction(1, 42)}
    if whole("degree", degree, 1, 5) not in bernoulli:
        raise OptionError(f"degree must be 1, 3 or 5; got {degree!r}")
    smoothing = -float(bernoulli[degree] / math.factorial(degree + 1))
    base = bspline(degree)
    return replace(base, name=f"{base.name}-quasi", prefilter=True, smoothing=smoothing)


def from_pieces(name: str, pieces: Sequence[Sequence[Number]], *, prefilter: bool = False) -> Filter:
    """A filter from an even kernel: ``pieces[j]`` are its coefficients of powers of ``|x|`` on [j, j + 1).

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

    Examples
    --------
    >>> import clvol
    >>> tent = clvol.from_pieces("tent", [[1, -1]])  # 1 - t on [0, 1], and mirrored
    >>> tent.support
    2
    """
    pieces = as_polynomials(f"pieces of {name!r}", pieces)
    if not pieces:
        raise OptionError("pieces must hold at least one polynomial; got none")
    size = max(len(piece) for piece in pieces)
    taps = []
    for i in range(2 * len(pieces)):
        d = len(pieces) - 1 - i  # the distance of the tap is t + d
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
        Degree of the Chebyshev fit on each unit piece; by default the smallest with an error of at most
        1e-10 of the peak, up to 20.

    Returns
    -------
    Filter
        `fit_error` is the largest error found between the nodes of the fit.

    Raises
    ------
    OptionError
        The kernel fails, returns values that are not finite, or jumps between the integers (unless `degree` is
        given).
    """
    radius = _radius(radius)
    degree = None if degree is None else whole("degree", degree, 0, MAX_DEGREE)
    if not callable(kernel):
        raise OptionError(f"kernel must be a function of distances; got {kernel!r}")
    t = np.linspace(0, 1, 1001)
    distance = t[None, :] - np.arange(2 * radius)[:, None] + radius - 1
    # two pieces share each end; evaluate just inside, because the kernel may jump there
    wanted = _kernel_at(name, kernel, np.clip(distance, distance[:, :1] + 1e-12, distance[:, -1:] - 1e-12))
    peak = float(np.abs(wanted).max())
    for n in [degree] if degree is not None else range(MAX_DEGREE + 1):
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
    """Coefficients of powers of t for the Chebyshev polynomials of 2t - 1, one row per degree; exact integers."""
    rows = np.zeros((degree + 2, degree + 2))
    rows[0, 0], rows[1, :2] = 1, (-1, 2)
    for k in range(2, degree + 1):
        rows[k] = -2 * rows[k - 1] - rows[k - 2]
        rows[k, 1:] += 4 * rows[k - 1, :-1]
    return rows[: degree + 1, : degree + 1]


def bc(B: Number, C: Number) -> Filter:
    """The cubic of Mitchell and Netravali with parameters B and C (reference [10] of the paper).

    (1, 0) is the cubic B-spline without prefilter, (1/3, 1/3) their choice, (0, 1/2) Catmull-Rom.

    References
    ----------
    - D. P. Mitchell and A. N. Netravali, "Reconstruction filters in computer graphics", Computer Graphics (SIGGRAPH) 22(4),
      1988, 221–228.

    Examples
    --------
    >>> import clvol
    >>> clvol.bc(0.2, 0.4).support  # between Mitchell's and Catmull-Rom's
    4
    """
    b, c = _exact("B and C", B), _exact("B and C", C)
    texts = (str(v) if -_DIGITS < v < _DIGITS else f"{float(v):g}" for v in (b, c))
    return _bc(f"bc({','.join(texts)})", Fraction(b), Fraction(c))


def _exact(what: str, value: object) -> Number:
    """`value` as a fraction if it is rational, else as a float."""
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

    As in the paper, the weights do not sum to one (off by up to 0.08 at radius 4), so that the effect of truncation shows.
    With `normalized` they are divided by their sum, as programs do; the result is Berrut's rational interpolant of the
    nearest ``2 radius`` samples (Computers & Mathematics with Applications 15, 1988).

    References
    ----------
    - J.-P. Berrut, "Rational functions for guaranteed and experimentally well-conditioned global interpolation", Computers
      & Mathematics with Applications 15(1), 1988, 1–16.
    """
    return _sinc(_radius(radius), flag("normalized", normalized))


@lru_cache
def _sinc(radius: int, normalized: bool) -> Filter:
    if normalized:
        return _normalized("sinc4n" if radius == 4 else f"sincn({radius})", np.sinc, radius, 2)
    return from_callable("sinc" if radius == 4 else f"sinc({radius})", np.sinc, radius, degree=_SINC_DEGREE)


def lanczos(radius: int, *, normalized: bool = False) -> Filter:
    """Sinc windowed by sinc(x / radius), radius 1 to 8.

    The weights sum to one only approximately; with `normalized` they are divided by their sum.

    References
    ----------
    - C. E. Duchon, "Lanczos filtering in one and two dimensions", Journal of Applied Meteorology 18(8), 1979, 1016–1022.
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
    """The filter of a kernel, 1 at 0 and 0 at the other integers, with weights divided by their sum.

    The fits satisfy the identities of the quotients only approximately. Adding a line to each makes it exact at the
    samples, and the smallest change of the weights restores the polynomials below `order`.
    """
    shifts = radius - 1.0 - np.arange(2 * radius)  # the distance of tap i is t + shifts[i]

    def divided(x: Array) -> Array:
        return np.asarray(kernel(x) / kernel((x - np.floor(x))[..., None] + shifts).sum(-1))

    row = from_callable(name, divided, radius, degree=_SINC_DEGREE)
    rows = row.matrix.copy()
    rows[:, 0] = shifts == 0
    rows[:, 1] += (shifts == -1) - rows.sum(1)
    powers = np.vander(shifts, order, increasing=True).T
    wanted = np.zeros((order, rows.shape[1]))  # the sum of w_i(t) (t + shifts[i])**m is zero for m > 0
    wanted[range(order), range(order)] = (-1.0) ** np.arange(order)
    rows += np.linalg.pinv(powers) @ (wanted - powers @ rows)
    row = replace(row, taps=tuple(map(tuple, rows.tolist())))
    t = np.linspace(0, 1, 1001)[1:-1]
    return replace(row, fit_error=float(np.abs(row.weights(t) - divided(t + shifts[:, None])).max()))


def moms3(weight: Number = Fraction(1, 56)) -> Filter:
    """The cubic B-spline plus `weight` of its second derivative: order 4 on support 4, prefiltered.

    Blu, Thévenaz and Unser (*MOMS: maximal-order interpolation of minimal support*, IEEE Trans. Image Processing 10, 2001).
    These are all even kernels of that order and support: 0 is the cubic B-spline, -1/6 the cubic Lagrange
    interpolant. As the spacing T goes to 0, the RMS error of interpolation is `constant` times ``T**4 f^(4)``, where::

        constant**2 = (1/720 - weight/12)**2 + 1/1209600 - weight/15120 + weight**2/720

    The default, 1/56, minimises it: 0.19 of the B-spline's.

    Parameters
    ----------
    weight : number
        Less than 1/12; the prefilter does not exist above.

    References
    ----------
    - T. Blu, P. Thévenaz and M. Unser, "MOMS: maximal-order interpolation of minimal support", IEEE Transactions on Image
      Processing 10(7), 2001, 1069–1080.
    """
    w = _exact("weight", weight)
    return _moms3("moms3" if w == Fraction(1, 56) else f"moms3({w})", Fraction(w))


@lru_cache
def _moms3(name: str, weight: Fraction) -> Filter:
    taps = tuple((a + 2 * c * weight, b + 6 * d * weight, c, d) for a, b, c, d in bspline(3).taps)
    return Filter(name, taps, prefilter=True)


def omoms3() -> Filter:
    """`moms3` with 1/42, the best for least squares, where coefficients are fitted to the function itself.

    Its asymptotic error is then 0.22 of the cubic B-spline's (Blu, Thévenaz and Unser, 2001). Here it interpolates
    samples, where its error is 0.38 of the B-spline's, twice that of `moms3`.
    """
    return replace(moms3(Fraction(1, 42)), name="omoms3")


def wide(width: int = 2) -> Filter:
    """The cubic B-spline stretched by a whole number of samples, without a prefilter: smoother boundaries of labels.

    By the two-scale relation of B-splines it is what the cubic B-spline is of samples that are averaged over `width` of them, four
    times: weights are nowhere negative and sum to one. Its standard deviation is ``width / 3**0.5`` samples, that of
    "bspline5-approx" 0.71.

    Parameters
    ----------
    width : int
        1 to 4 samples; the filter has ``4 * width`` taps.

    Raises
    ------
    OptionError
        Another width.

    Examples
    --------
    >>> import clvol
    >>> clvol.wide(2).support
    8
    """
    n = Fraction(whole("width", width, 1, MAX_TAPS // 4))
    near = Fraction(2, 3) / n, 0, -1 / n**3, Fraction(1, 2) / n**4
    far = Fraction(4, 3) / n, -2 / n**2, 1 / n**3, Fraction(-1, 6) / n**4
    return from_pieces(f"wide({n})", [near] * int(n) + [far] * int(n))
