"""The local error of a rendered surface and its normal: the host side of uncertainty.cl.

There are two sources of error.

*Between the samples* the filter's error for a wave ``exp(i w x)`` is known at every position (the error kernel of Blu and Unser,
1999, is its mean square). Along an axis it is split into its mean over all positions, which adds to those along the other axes,
and the deviations from the mean: of the value, and of the slope in phase with the wave and out of phase. For each there is a
stencil whose response is that error; applied to the samples of the rendered function it gives the error at every position, without
any higher-degree spline.

*Noise* that is white with standard deviation sigma in the samples has the variance ``sigma² sum of eta(x - k)²`` in values, with
eta the impulse response of the whole reconstruction, and likewise with its derivative in slopes; these sums depend on the position
between samples. They are computed as integrals over frequencies, weighted by the power spectrum of the noise. The response of the
stencils to noise alone is subtracted from their squares.

To first order, the distance to the true surface is the error of the value divided by the slope, and the angle of the normal is the
error of the slope across the normal divided by the slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number
from clvol.base.uniform import FLOAT, Block
from clvol.filter.make import bspline
from clvol.noise import Noise, colour_power
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import DIRECT

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.filter.filter import Filter
    from clvol.spline.field import Field
    from clvol.volume.volume import Volume

__all__ = ["COVERAGE", "Uncertainty", "in_words", "noise_of"]

Array: TypeAlias = NDArray[np.float64]

COVERAGE = 0.95
"""The share of places whose error should be within the stated bound."""

_DEVIATIONS = 1.96  # standard deviations of a normal distribution for that share
_REACH = 6  # samples on each side of a stencil
_TERMS = 4  # most terms of a stencil's polynomial
_PLACES = 64  # positions between two samples at which errors are tabulated
_OMEGA = np.pi * (np.arange(64) + 0.5) / 64
_BETWEEN = (np.arange(_PLACES) + 0.5) / _PLACES
_NOTHING = 1e-12  # share of a wave; float64's rounding error
_FITTED = (0.05 * np.pi, 0.9 * np.pi)  # beyond, a wave and its alias coincide
_ROUGH = np.pi * (np.arange(24) + 0.5) / 24  # frequencies along each of three axes
_KEPT = 1 / 3  # least share of a wave that smoothing is assumed to keep
_LEAST_SLOPE = 0.1  # least share of the rendered slope that is assumed to be real, whatever the noise
_MOST_NOISE = 2.0**40  # in units of the largest magnitude: its square fits in float32
_ROUNDING = 2.0**-20  # error of float32, relative to the values nearby
_PLACED = 2.0**-22  # rounding error of positions, relative to the volume's radius
_WHITE = 1.0, 1.0, 1.0
_ROOM = bspline(9, prefilter=False)  # a filter whose halo is wide enough for the stencils


def in_words(uncertainty: NDArray[np.floating[Any]], units: str = "") -> str:
    """A summary of a picture's uncertainty in one line.

    Parameters
    ----------
    uncertainty : ndarray, shape (..., 2)
        As from `Renderer.render`.
    units : str
        Of the world.
    """
    there = uncertainty[~np.isnan(uncertainty[..., 0])]
    if not len(there):
        return "no surface"
    unit = f" {units}" if units else ""
    (far, turned), (farther, more) = np.quantile(there, (0.5, 0.95), axis=0, method="nearest")
    return (
        f"half of the surface lies within ± {far:.2g}{unit} of the true one, its normals within ± {turned:.2g}°; "
        f"95 % of it within ± {farther:.2g}{unit} and ± {more:.2g}°"
    )


UNCERTAINTY = Block(
    "uncertainty_t",
    stencils=(FLOAT, 12 * (2 * _REACH + 1)),
    squares=(FLOAT, 3 * _PLACES),
    slopes=(FLOAT, 3 * _PLACES),
    noise=(FLOAT, 7),
    to_index=(FLOAT, 9),
    center=(FLOAT, 3),
    steepest=FLOAT,
    gain=FLOAT,
    power=FLOAT,
    rounding=FLOAT,
    placed=FLOAT,
    least=FLOAT,
    distance=FLOAT,
    degrees=FLOAT,
)


def noise_of(volume: Volume, sigma: float | None) -> Noise:
    """The noise of the samples, white if its standard deviation is given; integers have at least their rounding error."""
    sigma = None if sigma is None else number("sigma", sigma, minimum=0)
    noise = volume.noise if sigma is None else Noise(sigma, "white")
    rounding = math.sqrt(1 / 12) if volume.data.dtype.kind in "iu" else 0.0
    return noise if noise.sigma >= rounding else Noise(rounding, "white")


class Uncertainty:
    """The errors of surfaces of a 3-D field of a filter that has a gradient; it must stay open.

    Raises
    ------
    OutOfMemoryError
        Another copy of the volume does not fit on the device.
    """

    def __init__(self, field: Field) -> None:
        made = field.coefficients
        volume = made.volume  # where samples are missing, filled
        drawn = volume if field.filter.interpolates else field.resample(shape=volume.shape).filled()
        self._field = field
        self._magnitude = float(np.abs(made.stored(np.array(volume.limits, np.float64))).max()) or 1.0  # in stored units
        self._samples = Coefficients(drawn, _ROOM, field.boundary, field.device, made.stored)
        try:
            self._samples.copy_samples(drawn.data)
            self._samples.fill_halo()
        except BaseException:
            self._samples.release()
            raise

    def release(self) -> None:
        """Free the device's memory."""
        self._samples.release()

    def __call__(self, positions: NDArray[np.floating[Any]], noise: Noise, *, central: bool = False) -> NDArray[np.float32]:
        """Bounds of the distance to the true surface, and of the angle to its normal, at each position.

        Positions, shape (..., 3), are in the world, and NaN where there is no surface. With `central`, normals are those of central
        differences. The result, shape (..., 2), is the world distance along the normal, and degrees, at most 180; NaN where there
        is no surface.
        """
        device, made, samples = self._field.device, self._field.coefficients, self._samples
        defines = {**made.defines(DIRECT), "LANES": 1, "STORED": 2 * _REACH + 1, "PLACES": _PLACES}
        errors = _errors(self._field.filter, central, noise.colour or _WHITE)
        defines |= errors.defines
        generated = {"uncertainty.h": "// generated\n" + UNCERTAINTY.declaration()}
        kernel = device.build("march/uncertainty.cl", defines, generated=generated).kernel("uncertainty")
        block = device.buffers.upload(self._block(errors, noise.sigma)[None])
        points = np.empty((positions.size // 3, 3), np.float32)
        np.subtract(positions.reshape(-1, 3), self._field.volume.center, out=points, casting="same_kind")
        points /= self._field.volume.mean_spacing
        results = np.empty((len(points), 2), np.float32)
        step = max(64, device.limits.launch_taps // (24 * (2 * _REACH + 1) + made.filter.support**3) // 64 * 64)
        with device.buffers.lent(points, write=False) as given, device.buffers.lent(results, write=True) as wanted, device.errors:
            for first in range(0, len(points), step):
                count = min(len(points), first + step)
                kernel(
                    device.queue,
                    (-(-(count - first) // 64) * 64,),
                    (64,),
                    made.argument(DIRECT),
                    made.extent,
                    samples.buffer,
                    samples.extent,
                    samples.size,
                    block,
                    given,
                    np.int32(count),
                    wanted,
                    global_offset=(first,),
                )
                device.finish()
        return results.reshape(*positions.shape[:-1], 2)

    def _block(self, errors: _Errors, sigma: float) -> Values:
        """The kernels' parameters: lengths in mean spacings, values in units of the largest magnitude."""
        volume = self._field.volume
        unit, spacing = math.ldexp(self._magnitude, self._field.coefficients.stored.exponent), volume.mean_spacing
        to_index = volume.world_to_index_matrix * spacing
        return UNCERTAINTY(
            stencils=errors.stencils.ravel() / self._magnitude,
            squares=errors.squares.ravel(),
            slopes=errors.slopes.ravel(),
            noise=errors.noise,
            to_index=to_index.ravel(),
            center=(np.asarray(volume.size) - 1) / 2,
            steepest=(to_index**2).sum(),
            gain=1 / self._magnitude,
            power=min(sigma / unit, _MOST_NOISE) ** 2,
            rounding=_ROUNDING**2,
            placed=(_PLACED * volume.radius / spacing) ** 2,
            least=_LEAST_SLOPE**2,
            distance=_DEVIATIONS * spacing,
            degrees=math.degrees(_DEVIATIONS),
        )


# -- errors of a filter ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Errors:
    """Of a filter, along x, y and z."""

    stencils: Array  # (3, 4, 2 REACH + 1): of the mean error, the deviation of the value, and the slope in phase and out of phase
    noise: Array  # (7,): the mean squares that uncertainty.cl computes from noise of variance 1
    squares: Array  # (3, PLACES): the sums of eta² between two samples, weighted by the noise's spectrum
    slopes: Array  # the same of eta'²

    @cached_property
    def defines(self) -> dict[str, int]:
        """The `#define`s for the stencils."""
        used = np.flatnonzero(self.stencils.any((0, 1)))
        value = self.stencils[:, 1]
        odd = bool(np.abs(value + value[:, ::-1]).max() < np.abs(value - value[:, ::-1]).max())
        return {"REACH": int(np.abs(used - _REACH).max(initial=0)), "VALUE_IS_ODD": int(odd)}


@lru_cache(maxsize=64)
def _errors(filter: Filter, central: bool = False, colour: tuple[float, ...] = _WHITE) -> _Errors:
    parity = _order(_varying(_wave(filter, 0, _BETWEEN, _OMEGA))) % 2  # the same along all axes, whatever the smoothing
    along = [_along(filter, axis, central, parity, colour[axis]) for axis in range(3)]
    stencils, at_samples, squares, slopes = (np.array(parts) for parts in zip(*along, strict=True))
    return _Errors(stencils, _noise(stencils, at_samples), squares, slopes)


def _along(filter: Filter, axis: int, central: bool, parity: int, colour: float) -> tuple[Array, Array, Array, Array]:
    """Along an axis: the stencils, the response at samples for the rough frequencies, and the variances between samples."""
    value, slope = (_wave(filter, axis, _BETWEEN, _OMEGA, derivative) for derivative in (0, 1))
    if central:
        slope = 1j * np.sin(_OMEGA)[:, None] * value
    mean = value.mean(1).real
    error = slope - 1j * (_OMEGA * mean)[:, None]
    kept = np.maximum(_wave(filter, axis, np.zeros(1), _OMEGA)[:, 0].real, _KEPT)
    missing, varying = (1 - mean) / kept, _varying(value) / kept
    even, odd = (np.sqrt((part**2).mean(1)) / kept for part in (error.real, error.imag))
    off, turned = np.hypot(missing, varying), np.hypot(even, odd)
    stencils = [_stencil(missing, off, 0), _stencil(varying, off, parity), _stencil(even, turned, 0), _stencil(odd, turned, 1)]
    power, rough = (colour_power(colour, omega) / colour_power(colour, omega).mean() for omega in (_OMEGA, _ROUGH))
    at_sample = _wave(filter, axis, np.zeros(1), _ROUGH)[:, 0].real * np.sqrt(rough)
    return np.array(stencils), at_sample, power @ np.abs(value) ** 2 / power.size, power @ np.abs(slope) ** 2 / power.size


def _varying(value: NDArray[np.complex128]) -> Array:
    """Root mean square, over all positions, of the deviation of reconstructed waves from their mean."""
    return np.asarray(np.sqrt((np.abs(value - value.mean(1, keepdims=True).real) ** 2).mean(1)))


def _wave(filter: Filter, axis: int, x: Array, omega: Array, derivative: int = 0) -> NDArray[np.complex128]:
    """The reconstruction of ``exp(i w k)`` at positions x, or its derivative, divided by ``exp(i w x)``; shape (omega, x)."""
    base, t = filter.cell(x)
    weights = filter.weights(t, derivative) * float(filter.scale) ** derivative
    at = (base + np.arange(filter.support)[:, None]) / filter.scale  # of the taps; (taps, x)
    terms = weights * np.exp(1j * omega[:, None, None] * (at - x))
    if filter.magnified_by is not None:
        fractions = np.arange(filter.scale) / filter.scale
        coarse = _wave(filter.magnified_by, axis, fractions, omega)
        terms *= coarse[:, np.rint((at % 1) * filter.scale).astype(np.int64) % filter.scale]
    else:
        b = filter.along(axis).undone
        terms /= (b[0] + 2 * np.cos(omega[:, None] * np.arange(1, b.size)) @ b[1:])[:, None, None]
    return np.asarray(terms.sum(1))


def _stencil(response: Array, scale: Array, parity: int) -> Array:
    """Weights at -REACH, ..., REACH whose response has this magnitude, fitted with errors relative to `scale`.

    The response is ``u**(n / 2)`` times a polynomial in ``u = 4 sin²(w / 2)``, with n the order of the response at 0, or the next
    one of this parity. For an odd order one root of u is replaced by ``sin(w)``, so that weights are at samples.
    """
    fitted = slice(*np.searchsorted(_OMEGA, _FITTED))
    taps = np.zeros(2 * _REACH + 1)
    if (np.abs(response) < _NOTHING).all():
        return taps
    order = _order(response)
    order = min(order + (order + parity) % 2, 2 * _REACH - parity)
    u = 4 * np.sin(_OMEGA / 2) ** 2
    first = np.sin(_OMEGA) if order % 2 else np.ones_like(u)
    terms = min(_TERMS, _REACH + 1 - (order + 1) // 2)
    columns = np.stack([first * u ** (order // 2 + j) for j in range(terms)], 1)
    found = np.linalg.lstsq(columns[fitted] / scale[fitted, None], response[fitted] / scale[fitted], rcond=None)[0]
    bend = np.array([-1.0, 2.0, -1.0])
    power = np.array([0.5, 0.0, -0.5]) if order % 2 else np.ones(1)
    for _ in range(order // 2):
        power = np.convolve(power, bend)
    for weight in found:
        half = power.size // 2
        taps[_REACH - half : _REACH + half + 1] += weight * power
        power = np.convolve(power, bend)
    return taps


def _order(response: Array) -> int:
    """The leading power of the frequency in a response near 0."""
    low = int(np.argmax(np.abs(response[: _OMEGA.size // 2]) > _NOTHING))
    high = 2 * low + 1
    growth = abs(response[high]) / max(abs(response[low]), _NOTHING)
    return max(0, round(math.log(max(growth, _NOTHING)) / math.log(_OMEGA[high] / _OMEGA[low])))


def _noise(stencils: Array, at_sample: Array) -> Array:
    """The mean squares that uncertainty.cl computes from the function of noise of variance 1."""
    k = np.arange(-_REACH, _REACH + 1)
    waves = np.exp(1j * _ROUGH[:, None] * k)
    shapes = [[-1 if b == a else 1 for b in range(3)] for a in range(3)]
    mean, value, even, odd = ([(waves @ stencils[a, which]).reshape(shapes[a]) for a in range(3)] for which in range(4))
    bend = [(4 * np.sin(_ROUGH / 2) ** 2).reshape(shape) for shape in shapes]  # of differences, squared
    blend = [((2 + np.cos(_ROUGH)) / 3).reshape(shape) for shape in shapes]  # of linear interpolation, squared
    x, y, z = ((at_sample[a] ** 2).reshape(shapes[a]) for a in range(3))
    drawn, total = x * y * z, np.abs(mean[0] + mean[1] + mean[2]) ** 2
    varying = [np.abs(v) ** 2 for v in value]
    own = [np.abs(even[a]) ** 2 + np.abs(odd[a]) ** 2 + bend[a] * sum(varying[b] for b in range(3) if b != a) for a in range(3)]
    steep = [bend[a] * total * math.prod(blend[b] for b in range(3) if b != a) for a in range(3)]
    return np.array([float((drawn * found).mean()) for found in (total + sum(varying), *own, *steep)])
