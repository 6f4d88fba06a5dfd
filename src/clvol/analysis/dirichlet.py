"""The exact sinc: for periodic samples it is a finite sum, the Dirichlet kernel, and the FFT computes it.

Samples are extended by the boundary rule to one period, and interpolated by the trigonometric polynomial of lowest degree. The
Nyquist term of an even period is split between ±π, which keeps results real: it is ``cos(pi x)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from clvol import reference
from clvol.base.arrays import Array, reals
from clvol.base.checks import enough_memory, require_room, whole
from clvol.base.errors import DataError, OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.volume.volume import Volume, as_volume

__all__ = [
    "SincVolume",
    "dirichlet_kernel",
    "dirichlet_magnify",
    "dirichlet_sample",
    "dirichlet_weights",
    "periodic",
    "sinc_volume",
]

_CHUNK = 1 << 22  # numbers in memory at a time
_NEAR = 0.1  # samples
_LONGEST = 1 << 31  # samples; the longest period
_SEED = 1999


@dataclass(frozen=True)
class SincVolume:
    """A volume magnified by the exact sinc, and how far a spline through it is from the exact sinc.

    Attributes
    ----------
    volume : Volume
        float64; pass it to `clvol.render` or `clvol.sample` with `filter` and `boundary`.
    filter, boundary : str
        Those with which the residual was measured.
    rms, maximum : float
        Difference between the spline and the exact sinc at random points of the domain, in the data's units.
    """

    volume: Volume
    filter: str
    boundary: str
    rms: float
    maximum: float


@enough_memory("the Dirichlet kernel")
def dirichlet_kernel(x: ArrayLike, n: int, derivative: int = 0) -> Array:
    """The periodic sinc of period `n`: ``sin(pi x) / (n sin(pi x / n))`` for odd n, ``/ (n tan(pi x / n))`` for even.

    Parameters
    ----------
    x : array-like
        Distance in samples.
    n : int
        Period in samples, 1 to 2³¹.
    derivative : {0, 1}

    Returns
    -------
    ndarray of float64, the shape of `x`
    """
    d, n, derivative = reals("x", x), whole("n", n, 1, _LONGEST), whole("derivative", derivative, 0, 1)
    if not np.isfinite(d).all():
        raise OptionError("x must be finite")
    flat = np.mod(d.ravel() + n / 2, n) - n / 2
    near = np.abs(flat) < _NEAR
    safe = np.where(near, 0.5, flat) if n > 1 else np.full(flat.size, 0.5)
    a, b = np.pi * safe, np.pi * safe / n
    below = np.sin(b) if n % 2 else np.tan(b)
    result: Array = np.sin(a) / (n * below)
    if derivative:  # by the quotient rule
        slope = np.cos(b) if n % 2 else 1 + below**2
        result = np.pi * (np.cos(a) / n - result * slope / n) / below
    result[near] = _cosines(flat[near], n, derivative)
    return result.reshape(d.shape)


def _cosines(x: Array, n: int, derivative: int) -> Array:
    """The same as an explicit sum, where the quotient loses digits: all frequencies with equal weight, Nyquist's halved."""
    k = np.arange(1, (n - 1) // 2 + 1)
    frequencies = 2 * np.pi / n * np.append(k, n / 2)
    heights = np.append(np.full(k.size, 2 / n), (n % 2 == 0) / n)
    if derivative:
        return np.asarray(-np.sin(x[:, None] * frequencies) @ (heights * frequencies))
    return np.asarray(1 / n + np.cos(x[:, None] * frequencies) @ heights)


def dirichlet_weights(positions: ArrayLike, n: int, boundary: str | Boundary = DEFAULT_BOUNDARY, derivative: int = 0) -> Array:
    """Weights of all samples of an axis at each position in samples; shape (positions, n).

    The sum over one period of the boundary rule, in which a sample may occur twice.
    """
    rule = periodic(boundary)
    period = rule.length(n)
    every = dirichlet_kernel(np.asarray(positions, dtype=np.float64)[:, None] - np.arange(period), period, derivative)
    weights = every[:, :n].copy()
    weights[:, rule.index(np.arange(n, period), n)] += every[:, n:]  # no index occurs twice here
    return weights


@enough_memory("a magnified volume")
def dirichlet_magnify(data: ArrayLike, factor: int = 2, boundary: str | Boundary = DEFAULT_BOUNDARY) -> Array:
    """Samples of the exact sinc on a finer grid, by the FFT.

    Parameters
    ----------
    data : array-like, 1 to 3 axes
        Finite samples.
    factor : int
        At least 1.
    boundary : str or Boundary
        "wrap": sample j of ``factor n`` lies at ``j / factor``. "mirror": so does sample j of ``factor (n - 1) + 1``,
        the last on the last. "reflect": sample j of ``factor n`` lies at ``(j + 1/2) / factor - 1/2``. Thus the finer
        grid continues under the same rule.

    Returns
    -------
    ndarray of float64

    Raises
    ------
    DataError
        Samples that are not finite real numbers, or not 1 to 3 axes.
    OptionError
        `factor` is not a whole number of at least 1, or the boundary has no period ("zero").
    OutOfMemoryError
        The result does not fit into memory.
    """
    array, factor, rule = _samples(data), whole("factor", factor, 1, _LONGEST), periodic(boundary)
    require_room("factor", array.size * factor**array.ndim, factor)
    for axis in range(array.ndim):
        lines = np.moveaxis(array, axis, -1)
        n = lines.shape[-1]
        period = rule.length(n)
        spectrum = np.fft.rfft(lines[..., rule.index(np.arange(period), n)])
        count = factor * period
        if rule.name == "reflect":  # the finer samples lie about the same faces
            spectrum *= np.exp(1j * np.pi / period * np.arange(spectrum.shape[-1]) * (1 / factor - 1))
        if period % 2 == 0 and factor > 1:
            spectrum[..., -1] /= 2  # the Nyquist term, which the finer grid distinguishes from its opposite
        fine = np.fft.irfft(spectrum * factor, count)
        wanted = factor * (n - 1) + 1 if rule.name == "mirror" else factor * n
        array = np.moveaxis(fine[..., :wanted], -1, axis)
    return np.ascontiguousarray(array)


@enough_memory("what is sampled")
def dirichlet_sample(
    volume: Volume | ArrayLike, points: ArrayLike, boundary: str | Boundary = DEFAULT_BOUNDARY, derivative: int = 0
) -> Array:
    """The exact sinc, or its gradient, at any points: a slow reference, since each point takes all samples.

    Parameters
    ----------
    volume : Volume or array-like
        1, 2 or 3 axes; an array has spacing 1 and origin 0.
    points : array-like, shape (..., d)
        World positions (x, y, z).
    boundary : str or Boundary
        "mirror", "reflect" or "wrap".
    derivative : {0, 1}

    Returns
    -------
    ndarray of float64, shape (...) or (..., d)

    Raises
    ------
    DataError
        Samples that are not finite real numbers, or not 1 to 3 axes.
    OptionError
        Points of another shape or not finite, a boundary without a period, or another derivative.
    OutOfMemoryError
        The result does not fit into memory.
    """
    rule, derivative = periodic(boundary), whole("derivative", derivative, 0, 1)
    if isinstance(volume, Volume) or np.ndim(volume) > 1:
        volume = as_volume(volume)
        data, index, slopes = _samples(volume.data), volume.world_to_index(points), volume.world_to_index_matrix
    else:
        data, index, slopes = _samples(volume), reals("points", points), np.eye(1)
    d = data.ndim
    if index.ndim == 0 or index.shape[-1] != d or not np.isfinite(index).all():
        raise OptionError(f"points must be finite, of shape (..., {d}); got shape {index.shape}")
    flat = index.reshape(-1, d)[:, ::-1]
    orders = [(0,) * d] if derivative == 0 else [tuple(int(i == a) for i in range(d)) for a in reversed(range(d))]
    result = np.empty((flat.shape[0], len(orders)))
    step = max(1, _CHUNK // max(1, data.size // data.shape[0]))
    for first in range(0, flat.shape[0], step):
        part = flat[first : first + step]
        weights = [[dirichlet_weights(part[:, a], n, rule, m) for m in range(derivative + 1)] for a, n in enumerate(data.shape)]
        sums: dict[tuple[int, ...], Array] = {(m,): np.tensordot(w, data, 1) for m, w in enumerate(weights[0])}
        for a in range(1, d):
            sums = {
                (*order, m): np.einsum("cy,cy...->c...", w, block)
                for order, block in sums.items()
                for m, w in enumerate(weights[a])
                if sum(order) + m <= derivative
            }
        for column, order in enumerate(orders):
            result[first : first + step, column] = sums[order]
    if derivative:
        return np.asarray(result @ slopes).reshape(index.shape)
    return result[:, 0].reshape(index.shape[:-1])


@enough_memory("a magnified volume")
def sinc_volume(
    volume: Volume | ArrayLike,
    factor: int = 4,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    points: int = 2000,
) -> SincVolume:
    """The exact sinc as a volume that can be rendered: FFT magnification, to be followed by spline interpolation.

    Panel a) of Figure 6. The spline's error is stated: it falls with ``factor**4`` for ``bspline3``.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    factor : int
        Of the magnification: at least 1; memory grows with its cube.
    filter, boundary : str, Filter, Boundary
        For rendering the result.
    points : int
        Number of random points of the domain at which the residual is measured.

    Raises
    ------
    DataError
        Samples that are not finite real numbers, or not 2 or 3 axes.
    OptionError
        An unknown filter, a boundary without a period, or a number outside its bounds.
    OutOfMemoryError
        The magnified volume does not fit into memory.
    """
    volume, chosen, rule = as_volume(volume), as_filter(filter), periodic(boundary)
    factor, points = whole("factor", factor, 1), whole("points", points, 1)
    require_room("points", points, points)
    data = dirichlet_magnify(volume.data, factor, rule)
    shift = np.full(volume.ndim, 0.5 / factor - 0.5 if rule.name == "reflect" else 0.0)
    fine = Volume(
        data, tuple(s / factor for s in volume.spacing), tuple(volume.index_to_world(shift)), volume.direction, volume.units
    )
    places = np.random.default_rng(_SEED).uniform(0, 1, (points, volume.ndim)) * (np.array(volume.size) - 1)
    world = volume.index_to_world(places)
    difference = reference.sample(fine, world, chosen, rule) - dirichlet_sample(volume, world, rule)
    return SincVolume(fine, chosen.name, rule.name, float(np.sqrt(np.mean(difference**2))), float(np.abs(difference).max()))


def periodic(boundary: str | Boundary) -> Boundary:
    """The boundary rule, if it has a period, which the exact sinc needs."""
    rule = as_boundary(boundary)
    if not rule.repeats:
        raise OptionError(f"boundary must be mirror, reflect or wrap, which have a period; got {rule.name!r}")
    return rule


def _samples(data: ArrayLike) -> Array:
    array = reals("data", data, "numbers along 1 to 3 axes", DataError)
    if not 1 <= array.ndim <= 3 or array.size == 0:
        raise DataError(f"data must be numbers along 1 to 3 axes; got shape {array.shape}")
    if not np.isfinite(array).all():
        raise DataError("samples must be finite")
    return array
