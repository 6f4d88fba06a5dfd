"""Choose λ of a smoothing spline for a volume, from its spectrum and noise.

At the samples, the gain of a smoothing spline is ``G(ω) = B(ω) / (B(ω) + λ (2 − 2 cos ω)^m)``, where B is the
transform of the B-spline's samples (Unser, Aldroubi and Eden, B-spline signal processing, 1993); in two and three dimensions it is
the product over the axes. For samples of power P(ω) that include noise of power N(ω), its mean square error is

    ∫ (P(ω) − N(ω)) (1 − G(ω))² + N(ω) G(ω)² dω  =  ∫ P (1 − G)² + 2 N G − N dω

The right-hand side has no unknowns: it is Stein's unbiased estimate (1981), and it is minimised here. Generalised cross-validation
minimises the first term over the square of the mean of 1 − G: it needs no N, but treats all that it cannot predict as noise,
including stairs and edges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.filter.filter import MOST_SMOOTHING, Filter
from clvol.filter.make import bspline
from clvol.filter.table import REGION_FILTER, as_filter
from clvol.noise import Spectrum
from clvol.volume.volume import Volume, as_volume

__all__ = ["Smoothing", "choice", "choose", "filter_for", "remember_smoothing", "settled"]

Array: TypeAlias = NDArray[np.float64]

# Measured with cubic splines on voxelised spheres (radius 5 to 18 voxels), tori (tube 3 to 6) and planes: the RMS distance to the
# true surface falls from 0.20 voxels at λ = 0 to 0.08-0.12 at λ = 0.5, and then rises; the error of normals is 24° and 4.4°.
_STAIRS = 0.5
# An object beside an exact background has detail inside that must be kept: 0.10 voxels and 7° at the edge.
_EDGE = 0.2
_GRID = 1e-4, 1e3, 176  # candidates of λ: from, to (for cubic splines), count
_UNSEEN = 0.01  # relative to the samples' standard deviation: smaller noise is invisible (8-bit rounding causes half of it)
_PAYS = 0.98  # relative to the error of interpolation: smoothing must reduce the error to this
# Factor on the λ of least error: near its minimum the error hardly changes, but gradients improve, and so do steps between
# regions, which a spectrum cannot distinguish from waves.
_MORE = 1.2
_APART = 0.9  # relative to the error with one λ: one λ per axis must reduce the error to this


@dataclass(frozen=True)
class Smoothing:
    """The chosen smoothing.

    Parameters
    ----------
    values : tuple of float
        λ along x, y[, z], to three significant digits.
    reason : str
        Reason for the choice, in words.
    sigma : float
        Standard deviation of the estimated noise, in units of the data.
    """

    values: tuple[float, ...]
    reason: str
    sigma: float


def choose(volume: Volume | ArrayLike, degree: int = 3) -> Smoothing:
    """λ of the smoothing spline with the least error for a volume; 0 if interpolation is as good.

    The noise decides (see `Volume.noise`), except where more than noise needs smoothing: surfaces of binary volumes,
    of labels and of masked objects are stairs. There λ is at least large enough to remove the stairs.

    Parameters
    ----------
    volume : Volume or array-like
    degree : int
        Degree of the spline, 2 to 9.

    Notes
    -----
    λ is 1.2 times that of the least predicted error, the same along all axes unless one per axis reduces the error by a tenth; 0
    if it would gain less than 2 %, or the noise is below a hundredth of the samples' standard deviation. For cubic splines it
    is 0.5 for stairs, and at least 0.2 for masks; other degrees use the λ that halves the same frequency.

    Modes that show extremes should use λ = 0: the peak of a vessel whose profile is a Gaussian of σ = 1 sample keeps 0.99 of
    its height with λ = 0, 0.92 with 0.02, 0.79 with 0.1, 0.58 with 0.5.

    Samples that are NaN or infinite are left out.
    """
    volume = as_volume(volume)
    degree = whole("degree", degree, 2, 9)
    known = _CHOSEN.setdefault(volume, {})
    if degree not in known:
        known[degree] = choice(volume, degree)
    return known[degree]


def remember_smoothing(volume: Volume, chosen: Mapping[int, Smoothing]) -> None:
    """Use for a volume what was chosen, by degree, from more samples than it has."""
    _CHOSEN.setdefault(volume, {}).update(chosen)


def choice(volume: Volume, degree: int) -> Smoothing:
    """As `choose`, of checked arguments; nothing is cached."""
    noise = volume.noise
    d = volume.ndim
    if noise.kind in ("binary", "labels", "rounded"):
        value = _rounded(_equivalent(_STAIRS, degree))
        return Smoothing((value,) * d, f"{_KINDS[noise.kind]}: stairs are smoothed", 0.0)
    if noise.sigma > 0:
        values = _least(noise.spectrum, degree)
        says = f"{_KINDS[noise.kind]} noise, σ = {noise.sigma:.3g}"
        says += "" if any(values) else ": too little for smoothing to pay"
    else:
        values, says = (0.0,) * d, "no noise"
    if noise.masked:
        least = _rounded(_equivalent(_EDGE, degree))
        if min(values) < least:
            values = tuple(max(value, least) for value in values)
            says += f"; background of exactly {noise.background:g} beside objects: the stairs of its edge are smoothed"
    return Smoothing(values, says, noise.sigma)


def filter_for(volume: Volume, filter: str | Filter | None, otherwise: str) -> Filter:
    """The given filter; if None `otherwise`, but "nearest" for labels, which no filter blends but one of their indicators."""
    blended = volume.is_labels and otherwise != REGION_FILTER
    return as_filter(filter if filter is not None else "nearest" if blended else otherwise)


def settled(filter: str | Filter, volume: Volume) -> Filter:
    """The filter for a volume: smoothing of "auto" or a length becomes numbers, which its name states.

    Raises
    ------
    OptionError
        The number of axes of its smoothing differs from the volume's, or its length is too large for float32.
    """
    row = as_filter(filter)
    if row.magnified_by is not None and not row.magnified_by.settled:
        row = replace(row, magnified_by=settled(row.magnified_by, volume))
    if isinstance(row.smoothing, tuple) and len(row.smoothing) != volume.ndim:
        raise OptionError(f"smoothing must be one number, or {volume.ndim} for a volume of {volume.ndim} axes; got {row.name!r}")
    if row.settled:
        return row
    if row.length is not None:
        length, power = row.length, 2 * row.penalty
        most = MOST_SMOOTHING ** (1 / power) * min(volume.spacing)
        if length > most:
            raise OptionError(
                f"the length of {row.name!r} must be at most {most:.4g} for the spacings of this volume, "
                f"where λ is {MOST_SMOOTHING:g}; got {length:g}"
            )
        return row.smoothed([min(float(f"{(length / s) ** power:.6g}"), MOST_SMOOTHING) for s in volume.spacing])
    return row.smoothed(choose(volume, row.degree).values)


# -- inner -------------------------------------------------------------------------------------------

_CHOSEN: WeakKeyDictionary[Volume, dict[int, Smoothing]] = WeakKeyDictionary()

_KINDS = {
    "white": "white",
    "correlated": "correlated",
    "signal-dependent": "signal-dependent",
    "magnitude": "Rician",
    "clipped": "clipped",
    "uneven": "uneven",
    "binary": "two values",
    "labels": "few values in even regions",
    "rounded": "few values, one beside the next",
}


class _Risk:
    """Predicted mean square error at the samples, with λ along each axis of the array; the range of the values is 1."""

    def __init__(self, spectrum: Spectrum, degree: int) -> None:
        self.spectrum = spectrum
        self.axes = [_passing(degree, omega) for omega in spectrum.frequencies]

    def __call__(self, smoothing: Sequence[float]) -> float:
        return float(self.along(0, smoothing, smoothing[:1])[0])

    def along(self, axis: int, smoothing: Sequence[float], values: ArrayLike) -> Array:
        """The error for each of `values` along one axis, and `smoothing` along the others."""
        passed = squared = self.spectrum.power
        through = every = 1.0  # noise after the filter, and before
        for i in reversed(range(len(smoothing))):  # the last first, so that earlier axes keep their positions
            if i != axis:
                g, noise = self._passes(i, smoothing[i]), self.spectrum.noise[i]
                passed, squared = np.tensordot(passed, g, (i, 0)), np.tensordot(squared, g**2, (i, 0))
                through, every = through * float(noise @ g), every * float(noise.sum())
        g, noise = self._passes(axis, values), self.spectrum.noise[axis]
        total = float(self.spectrum.power.sum()) - every * float(noise.sum())
        return np.asarray(total - 2 * g @ passed + g**2 @ squared + 2 * through * (g @ noise))

    def _passes(self, axis: int, values: ArrayLike) -> Array:
        """The gain of each frequency along an axis, for each λ."""
        sampled, penalty = self.axes[axis]
        return np.asarray(sampled / (sampled + np.multiply.outer(values, penalty)))


def _least(spectrum: Spectrum, degree: int) -> tuple[float, ...]:
    """λ along x, y[, z] of the least predicted error; 0 if interpolation is nearly as good."""
    d = len(spectrum.frequencies)
    if math.prod(float(share.sum()) for share in spectrum.noise) < _UNSEEN**2 * float(spectrum.power.sum()):
        return (0.0,) * d
    risk = _Risk(spectrum, degree)
    grid = np.geomspace(_GRID[0], min(_equivalent(_GRID[1], degree), MOST_SMOOTHING), _GRID[2])

    rough = 4 * int(np.argmin([risk((value,) * d) for value in grid[::4]]))
    least, one = min((risk((value,) * d), value) for value in grid[max(rough - 3, 0) : rough + 4].tolist())
    several, apart = [one] * d, least  # the estimate may be below 0 near 0
    for axis in [axis for axis in range(d) if len(spectrum.frequencies[axis]) > 1] * 2:
        errors = risk.along(axis, several, grid)
        several[axis], apart = float(grid[errors.argmin()]), float(errors.min())
    differ = apart < _APART**2 * max(least, 0) and max(several) > 2 * min(several)
    if min(least, apart) > _PAYS**2 * risk((0.0,) * d):
        return (0.0,) * d
    return tuple(_rounded(min(_MORE * value, float(grid[-1]))) for value in (several[::-1] if differ else [one] * d))


def _passing(degree: int, omega: Array) -> tuple[Array, Array]:
    """B(ω) and (2 − 2 cos ω)^m."""
    row = bspline(degree)
    b = row.samples
    return b[0] + 2 * np.cos(np.outer(omega, np.arange(1, len(b)))) @ b[1:], (2 - 2 * np.cos(omega)) ** row.penalty


def _equivalent(value: float, degree: int) -> float:
    """λ of a degree that halves the same frequency as `value` for cubic splines."""
    if degree == 3:
        return value
    omega = np.linspace(1e-3, np.pi, 4096)
    sampled, penalty = _passing(3, omega)
    half = int(np.argmin(np.abs(sampled - value * penalty)))
    sampled, penalty = _passing(degree, omega[half : half + 1])
    return float((sampled / penalty)[0])


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
