"""The truth for measured errors: a known function, or the samples of a decimated volume."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import reference
from clvol.base.arrays import Array, reals
from clvol.base.checks import one_of, require_room, whole
from clvol.base.errors import ClvolError, OptionError
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.filter.response import prefilter_response
from clvol.filter.table import as_filter
from clvol.volume.volume import Volume

__all__ = [
    "LATTICE",
    "Decimation",
    "Function",
    "Part",
    "Trial",
    "decimated",
    "known",
    "lattice_points",
    "middle",
    "middle_part",
    "prefiltered",
    "root_mean_square",
    "sampled",
]

Function: TypeAlias = Callable[[Array], ArrayLike]

LATTICE = 1 << 22
"""Most positions for the structural similarity; if there are more, only the middle slices."""
_CHUNK = 1 << 20  # positions of one call of a user's function
_SHIFTS = 27  # most shifts of a decimated grid by whole samples; if there are more, a random choice
_DENSE = 512  # most samples along an axis for which the inverse of eq. (11) is computed


@dataclass(frozen=True)
class Part:
    """Samples to reconstruct from, and the truth: at scattered points, and on a lattice."""

    samples: Volume
    points: Array  # in the world, (N, d)
    values: Array | None  # true ones at `points`; None: those on the lattice are compared
    gradients: Array  # true ones at `points`, (N, d)
    axes: list[Array]  # of the lattice, in samples, z first
    lattice: Array  # true values there
    original: Array | None = None  # values there before the low-pass

    def first(self, count: int) -> Part:
        """The first `count` of the points, which are in random order."""
        values = None if self.values is None else self.values[:count]
        return replace(self, points=self.points[:count], values=values, gradients=self.gradients[:count])


@dataclass(frozen=True)
class Trial:
    """The data for measuring filters: one part, or one for each shift of the decimated grid."""

    parts: list[Part]
    against: str  # the truth, in words
    scan: Volume | None = None  # the volume that was decimated
    lost: float = 0.0  # RMS of what the low-pass removed
    sigma: float = 0.0  # of the noise in each component of the true gradients

    @property
    def samples(self) -> Volume:
        return self.parts[0].samples


# -- a function ----------------------------------------------------------------------------------------------


def known(
    volume: Volume, truth: Function, gradient: Function | None, margin: float, points: int, rng: np.random.Generator
) -> Trial:
    """Random points of a volume's world, where the function that it samples is known."""
    require_room("points", points, points)
    low, high = _inside(volume, margin)
    world = volume.index_to_world(rng.uniform(low, high, (points, volume.ndim)))
    values = _ask(truth, world, "the function", 1)
    slopes = _differences(truth, world, min(volume.spacing)) if gradient is None else _ask(gradient, world, "the gradient", 2)
    axes = [np.arange(a, b + 0.25, 0.5) for a, b in zip(low[::-1], high[::-1], strict=True)]
    axes[0] = middle(axes[0], math.prod(a.size for a in axes[1:]), LATTICE)
    fine = _ask(truth, volume.index_to_world(lattice_points(axes)), "the function", 1).reshape([a.size for a in axes])
    return Trial([Part(volume, world, values, slopes, axes, fine)], f"the function at {points} random points")


def sampled(function: Function, size: int | Sequence[int], domain: tuple[float, float], dimensions: int) -> Volume:
    """The samples of a function; the outer ones are on the faces of its domain."""
    d = whole("dimensions", dimensions, 2, 3)
    sizes = [size] * d if isinstance(size, (int, np.integer)) and not isinstance(size, bool) else size
    if not isinstance(sizes, (list, tuple)) or len(sizes) != d:
        raise OptionError(f"size must be a whole number of at least 2, or {d} of them; got {size!r}")
    shape = tuple(whole("size", n, 2) for n in sizes)
    require_room("size", math.prod(shape), size)
    ends = reals("domain", domain)
    if ends.shape != (2,) or not np.isfinite(ends).all() or not ends[0] < ends[1]:
        raise OptionError(f"domain must be two numbers, the lower first; got {domain!r}")
    low, high = float(ends[0]), float(ends[1])
    grid = Volume(np.broadcast_to(0.0, shape), tuple((high - low) / (n - 1) for n in shape[::-1]), (low,) * d)
    points = lattice_points([np.linspace(low, high, n) for n in shape])
    return replace(grid, data=_ask(function, points, "the function", 1).reshape(shape))


def _ask(function: Function, points: Array, what: str, axes: int) -> Array:
    """Values, shape (N,), or gradients, shape (N, d), of a user's function at points, shape (N, d)."""
    rule = "one finite value for each position" if axes == 1 else "a finite vector for each position"
    shape = points.shape[:axes]
    parts = []
    for first in range(0, points.shape[0], _CHUNK):
        part = points[first : first + _CHUNK]
        try:
            given = function(part.copy())
        except ClvolError:
            raise
        except Exception as error:
            raise OptionError(f"{what} must give {rule}; it failed: {error!r}") from error
        values = reals(f"what {what} gives", given, rule)
        if values.shape != (part.shape[0], *shape[1:]) or not np.isfinite(values).all():
            bad = "" if np.isfinite(values).all() else ", with values that are not finite"
            raise OptionError(f"{what} must give {rule}; got shape {values.shape} for positions {part.shape}{bad}")
        parts.append(values)
    return np.concatenate(parts)


def _differences(function: Function, points: Array, spacing: float) -> Array:
    """The gradient by sixth-order central differences of a hundredth of a sample."""
    h, d = spacing / 100, points.shape[1]
    result = np.zeros_like(points)
    for axis, (k, weight) in itertools.product(range(d), ((1, 45 / 60), (2, -9 / 60), (3, 1 / 60))):
        shift = np.zeros(d)
        shift[axis] = k * h
        ahead, behind = (_ask(function, points + sign * shift, "the function", 1) for sign in (1, -1))
        result[:, axis] += weight * (ahead - behind) / h
    return result


def _inside(volume: Volume, margin: float) -> tuple[Array, Array]:
    """The first and the last compared index, x first."""
    last = np.asarray(volume.size) - 1.0
    skipped = np.minimum(margin, last / 4)
    return skipped, last - skipped


# -- a decimated volume --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Decimation:
    """How a volume is decimated: see `clvol.analysis.compare`."""

    factor: int
    lowpass: Literal["gaussian", "none"]
    fractional: int
    margin: float
    max_samples: int

    def __post_init__(self) -> None:
        if self.lowpass not in ("gaussian", "none"):
            raise one_of("lowpass", self.lowpass, ("gaussian", "none"))

    @property
    def width(self) -> float:
        """Standard deviation of the low-pass, in samples."""
        return self.factor / 2 if self.lowpass == "gaussian" else 0.0


def decimated(original: Volume, how: Decimation, sigma: float, points: int, rule: Boundary, rng: np.random.Generator) -> Trial:
    """The decimated volume at each shift of its grid, the original samples, and `points` random gradients of these."""
    factor, width = how.factor, how.width
    smooth = original.gaussian([width * s for s in original.spacing]) if width else original
    shifts = _shifts(original.size, factor, how.fractional if width else 0, rng)
    quintic, drawn = prefiltered(smooth.data, as_filter("bspline5"), rule)
    coefficients = replace(smooth, data=quintic)
    grids = [(shift, _kept(smooth, quintic, drawn, factor, shift, rule)) for shift in shifts]
    places = [_compared(samples, shift, factor, original.shape, how.margin) for shift, samples in grids]
    parts, lost = [], []
    for i, ((shift, samples), kept) in enumerate(zip(grids, places, strict=True)):
        if not all(k.size for k in kept):
            continue
        kept[0] = _slab(kept[0], math.prod(k.size for k in kept[1:]), how.max_samples // len(grids), i / max(1, len(grids) - 1))
        count = math.prod(k.size for k in kept)
        some = rng.choice(count, min(math.ceil(points / len(grids)), count), replace=False)
        index = np.stack([k[j] for k, j in zip(kept, np.unravel_index(some, [k.size for k in kept]), strict=True)][::-1], -1)
        world = original.index_to_world(index)
        slopes = reference.sample(coefficients, world, drawn, rule, derivative=1)
        axes = [(k - s) / factor for k, s in zip(kept, shift[::-1], strict=True)]
        sampled, before = smooth.data[np.ix_(*kept)], original.data[np.ix_(*kept)]
        lost.append((before - sampled).ravel())
        parts.append(Part(samples, world, None, slopes, axes, sampled, before))
    wide = "1 sample" if width == 1 else f"{width:g} samples"
    what = f"the volume low-passed by a Gaussian of standard deviation {wide}" if width else "the volume"
    count = sum(part.lattice.size for part in parts)
    return Trial(
        parts,
        f"{count} samples of {what}, drawn from every {_ordinal(factor)} along each axis, beginning in {len(parts)} places",
        original,
        root_mean_square(np.concatenate(lost)),
        _slope_noise(sigma, width, original.spacing),
    )


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


def _shifts(size: Sequence[int], factor: int, fractional: int, rng: np.random.Generator) -> list[Array]:
    """The shifts of the decimated grid in samples, x first: whole ones, starting with 0, and fractional ones."""
    every = [range(min(factor, n)) for n in size]
    count = math.prod(len(e) for e in every)
    chosen: NDArray[Any] = np.arange(count)
    if count > _SHIFTS:
        chosen = np.concatenate([[0], 1 + np.sort(rng.choice(count - 1, _SHIFTS - 1, replace=False))])
    whole_ones = np.stack(np.unravel_index(chosen, [len(e) for e in every][::-1])[::-1], -1).astype(np.float64)
    between = rng.uniform(0, 1, (fractional, len(size))) * [min(factor, n - 1) for n in size]
    return [*whole_ones, *between]


def _kept(smooth: Volume, quintic: Array, drawn: Filter, factor: int, shift: Array, rule: Boundary) -> Volume:
    """Every `factor`-th sample from `shift` on; between samples, values of the spline with the coefficients `quintic`."""
    axes = [np.arange(s, n - 1 + 1e-9, factor) for s, n in zip(shift[::-1], smooth.shape, strict=True)]
    if all(s == int(s) for s in shift):
        data = smooth.data[np.ix_(*(a.astype(np.int64) for a in axes))]
    else:
        data = reference.lattice(quintic, axes, drawn, rule)
    origin = tuple(smooth.index_to_world(shift))
    return replace(smooth, data=data, spacing=tuple(s * factor for s in smooth.spacing), origin=origin)


def _compared(samples: Volume, shift: Array, factor: int, shape: Sequence[int], margin: float) -> list[NDArray[np.int64]]:
    """The indices of the compared original samples, z first."""
    low, high = (bound * factor + shift for bound in _inside(samples, margin))
    return [
        np.arange(math.ceil(a - 1e-9), min(math.floor(b + 1e-9), n - 1) + 1)
        for a, b, n in zip(low[::-1], high[::-1], shape, strict=True)
    ]


def _slab(positions: NDArray[Any], others: int, room: int, share: float) -> NDArray[Any]:
    """Neighbouring positions, at most `room` with `others` along the other axes, from `share` of the axis on."""
    count = min(positions.size, max(1, room // others))
    first = round((positions.size - count) * share)
    return positions[first : first + count]


def _slope_noise(sigma: float, width: float, spacing: Sequence[float]) -> float:
    """Standard deviation of white noise in a component of the quintic spline's gradient, after a Gaussian of `width` samples."""
    w = (np.arange(256) + 0.5) * np.pi / 256
    row = as_filter("bspline5")
    slope = sum(2 * abs(float(row(float(k), 1))) * np.sin(k * w) for k in (1, 2)) * prefilter_response(row, w)
    passed = np.exp(-((width * w) ** 2))
    gain = float((slope**2 * passed).mean()) * float(passed.mean()) ** (len(spacing) - 1)
    return sigma * math.sqrt(gain * float(np.mean([1 / s**2 for s in spacing])))


# -- shared --------------------------------------------------------------------------------------------------


def prefiltered(data: Array, row: Filter, rule: Boundary) -> tuple[Array, Filter]:
    """Coefficients, and the filter without prefilter that reconstructs from them."""
    if not row.prefilter:
        return data, row
    if max(data.shape) > _DENSE:
        return reference.prefilter(data, row, rule), replace(row, prefilter=False, smoothing=0.0)
    for axis, n in enumerate(data.shape):
        inverse = _inverse(row.along(data.ndim - 1 - axis), n, rule)
        data = np.moveaxis(np.tensordot(inverse, data, (1, axis)), 0, axis)
    return np.ascontiguousarray(data), replace(row, prefilter=False, smoothing=0.0)


@lru_cache(maxsize=128)
def _inverse(row: Filter, n: int, rule: Boundary) -> Array:
    """The inverse of the matrix of eq. (11): a product of matrices is several times as fast as solving by lines."""
    return np.asarray(np.linalg.inv(rule.matrix(row.undone, n)), np.float64)


def lattice_points(axes: Sequence[Array]) -> Array:
    """All combinations of positions, x first; shape (N, d)."""
    return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")][::-1], -1)


def middle(positions: NDArray[Any], others: int, room: int) -> NDArray[Any]:
    """The middle positions, at most `room` together with `others` along the other axes."""
    count = min(positions.size, max(1, room // others))
    first = (positions.size - count) // 2
    return positions[first : first + count]


def middle_part(volume: Volume, max_samples: int) -> Volume:
    """The middle of a volume or an image with at most `max_samples` samples, every axis cropped in the same proportion."""
    if volume.data.size <= max_samples:
        return volume
    share = (max_samples / volume.data.size) ** (1 / volume.ndim)
    sizes = [max(1, int(n * share)) for n in volume.size]
    low = [(n - m) // 2 for n, m in zip(volume.size, sizes, strict=True)]
    return volume.crop(low, [a + m for a, m in zip(low, sizes, strict=True)])


def root_mean_square(values: Array) -> float:
    """The root mean square, also of numbers whose squares overflow or underflow."""
    unit = float(np.abs(values).max()) or 1.0
    return unit * math.sqrt(float(np.mean((values / unit) ** 2)))
