"""How much smoothing pays for a volume: λ of a smoothing spline, from the volume's own spectrum and noise.

A smoothing spline of samples that are a signal of power P(ω) and noise of power N(ω) errs, in the mean over all points, by

    ∫ P(ω) (1 − 2 h(ω) + v(ω)) + N(ω) v(ω) dω       h = β(ω) / U(ω)    v = A(ω) / U(ω)²    U = B(ω) + λ (2 − 2 cos ω)^m

(Unser, Aldroubi and Eden, B-spline signal processing, 1993; Blu and Unser, Quantitative Fourier analysis of approximation
techniques, 1999). β is the transform of the B-spline, B that of its samples, A that of its autocorrelation's samples; in two and three
dimensions h and v are products over the axes. What is known is the power of the samples, P + N: with P = (P + N) − N the
estimate is without bias (Stein, 1981), and it is exact for a signal without frequencies beyond the samples' Nyquist frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate, optimize

from clvol.checks import whole
from clvol.noise import Noise, Spectrum
from clvol.volume import Volume, as_volume

__all__ = ["PENALTY", "Smoothing", "choose", "predicted_error"]

Array: TypeAlias = NDArray[np.float64]

PENALTY = {2: 2, 3: 2, 4: 3, 5: 3}  # order of the differences that λ weighs, by the degree of the spline
# Measured on voxelised spheres (radius 5 to 18 voxels), tori (tube 2 to 6) and planes whose surface is known, cubic splines: the
# RMS distance to the surface falls from 0.20 voxels (λ = 0) to 0.08-0.12 at λ = 0.5 and rises again, that of the normals from 24° to 4.4°.
_STAIRS = 0.5
# Beside an exact background there is an inside worth keeping: 0.10 voxels and 7° at the edge.
_EDGE = 0.2
_MOST = 100.0
_PAYS = 0.98  # of the error of interpolation: what is gained below is not worth a change
_APART = 0.95  # of the error with one λ: what λ along each axis must bring


@dataclass(frozen=True)
class Smoothing:
    """What was chosen.

    Parameters
    ----------
    values : tuple of float
        λ along x, y[, z], of three significant digits.
    reason : str
        Why, for people.
    sigma : float
        Standard deviation of the noise that was found, in units of the data.
    """

    values: tuple[float, ...]
    reason: str
    sigma: float


def choose(volume: Volume | ArrayLike, degree: int = 3) -> Smoothing:
    """λ of the smoothing spline that errs least for a volume, 0 where interpolation does.

    Noise alone decides, as `Volume.noise` tells of it, but where noise cannot: binary volumes and labels have stairs for surfaces, and
    so has an object cut out by a mask. There λ is at least what removes them (see the source for the measurements).

    Parameters
    ----------
    volume : Volume or array-like
    degree : int
        Of the spline, 2 to 5.

    Raises
    ------
    DataError
        Samples that were looked at are NaN or infinite.
    """
    volume = as_volume(volume)
    degree = whole("degree", degree, 2, 5)
    noise = volume.noise
    d = volume.ndim
    if noise.kind in ("binary", "labels"):
        value = _rounded(_equivalent(_STAIRS, degree))
        return Smoothing((value,) * d, f"{_KINDS[noise.kind]}: stairs are smoothed", 0.0)
    if noise.sigma > 0:
        values, gain = _least(noise.spectrum, degree)
        says = f"{_KINDS[noise.kind]} noise, σ = {noise.sigma:.3g}: "
        says += f"{100 * (1 - gain):.0f} % less error predicted" if any(values) else "smoothing would lose as much as it removes"
    else:
        values, says = (0.0,) * d, "no noise"
    if noise.masked:
        least = _rounded(_equivalent(_EDGE, degree))
        if min(values) < least:
            values = tuple(max(value, least) for value in values)
            says += f"; background of exactly {noise.background:g} beside objects: the stairs of its edge are smoothed"
    return Smoothing(values, says, noise.sigma)


def predicted_error(noise: Noise, degree: int, smoothing: Sequence[float]) -> float:
    """Predicted RMS error of a spline, over the range of the values; λ along x, y[, z]."""
    return math.sqrt(max(_Risk(noise.spectrum, whole("degree", degree, 2, 5))(smoothing[::-1]), 0.0))


# -- inner -------------------------------------------------------------------------------------------

_KINDS = {
    "white": "white",
    "correlated": "correlated",
    "signal-dependent": "signal-dependent",
    "binary": "two values",
    "labels": "few values in even regions",
}


class _Risk:
    """The mean square error of the spline with λ along each axis of the array, predicted."""

    def __init__(self, spectrum: Spectrum, degree: int) -> None:
        self.spectrum = spectrum
        self.axes = [
            (np.sinc(w / (2 * np.pi)) ** (degree + 1), _sampled(degree, w), _sampled(2 * degree + 1, w), _penalty(degree, w))
            for w in spectrum.frequencies
        ]

    def __call__(self, smoothing: Sequence[float]) -> float:
        power, both = self.spectrum.power, self.spectrum.power
        through = every = 1.0  # noise that h lets through, and all of it
        for (kernel, samples, square, penalty), noise, value in zip(
            self.axes[::-1], self.spectrum.noise[::-1], tuple(smoothing)[::-1], strict=True
        ):
            undone = samples + value * penalty
            h = kernel / undone
            power, both = power @ h, both @ (square / undone**2)
            through, every = through * float(noise @ h), every * float(noise.sum())
        return float(self.spectrum.power.sum() - 2 * power + both + 2 * through - every)


def _least(spectrum: Spectrum, degree: int) -> tuple[tuple[float, ...], float]:
    """λ along x, y[, z] of the least predicted error, and its share of that of interpolation."""
    risk = _Risk(spectrum, degree)
    d = len(spectrum.frequencies)
    scale = _equivalent(1.0, degree)  # λ of equal strength
    low, high = math.log(1e-4 * scale), math.log(_equivalent(_MOST, degree))

    def best(of: Callable[[float], float]) -> float:
        grid = np.linspace(low, high, 41)
        found = [of(math.exp(x)) for x in grid]
        i = int(np.argmin(found))
        around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        return math.exp(float(optimize.minimize_scalar(lambda x: of(math.exp(x)), bounds=around, method="bounded").x))

    nothing = risk((0.0,) * d)
    one = best(lambda value: risk((value,) * d))
    values, error = (one,) * d, risk((one,) * d)
    several = list(values)
    for _ in range(2):
        for axis in range(d):
            several[axis] = best(lambda value, axis=axis: risk([*several[:axis], value, *several[axis + 1 :]]))
    if max(risk(several), 0.0) < _APART**2 * error:
        values, error = tuple(several), risk(several)
    if nothing <= 0 or error > _PAYS**2 * nothing:
        return (0.0,) * d, 1.0
    return tuple(_rounded(value) for value in values[::-1]), math.sqrt(max(error, 0.0) / nothing)


def _sampled(degree: int, omega: Array) -> Array:
    """Transform of the samples of a B-spline, the denominator of eq. (16)."""
    half = (degree + 1) / 2
    spline = interpolate.BSpline.basis_element(np.arange(degree + 2) - half, extrapolate=False)
    total = np.full_like(omega, float(spline(0.0)))
    for k in range(1, math.ceil(half)):
        total += 2 * float(spline(k)) * np.cos(k * omega)
    return total


def _penalty(degree: int, omega: Array) -> Array:
    return np.asarray((2 - 2 * np.cos(omega)) ** PENALTY[degree])


def _equivalent(value: float, degree: int) -> float:
    """λ for a degree that halves the same frequency as `value` does for cubic splines."""

    def excess(omega: float) -> float:
        at = np.array([omega])
        return float((value * _penalty(3, at) - _sampled(3, at))[0])

    if degree == 3:
        return value
    at = np.array([optimize.brentq(excess, 1e-3, np.pi)])
    return float((_sampled(degree, at) / _penalty(degree, at))[0])


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
