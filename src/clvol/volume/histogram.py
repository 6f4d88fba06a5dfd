"""Derive from a volume's histogram which values are background, where matter starts, and the display window.

A background that was masked, clipped or never measured is one exact value shared by many samples; in the histogram it stands
out from its neighbours more than any peak of measured values. All other values are matter: on one side of it or, as in
statistical maps, on both. Without such a value, the background is one of the two classes of Otsu's
threshold (1979): the lower, unless nearly all samples on the volume's faces are in the upper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import wraps
from typing import Any, Literal, NamedTuple, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.scaling import exponent_of, scaled, unscaled
from clvol.volume.evenly import evenly
from clvol.volume.steepness import steepness_at
from clvol.volume.volume import Volume, as_volume

__all__ = [
    "Matter",
    "Projection",
    "clims_of",
    "isovalue_of",
    "label_numbers",
    "labels_in",
    "matter_of",
    "may_be_hounsfield",
    "remember",
    "share",
    "slopes_of",
    "spread_in",
    "spread_of",
]

Array = NDArray[np.float64]
Made = TypeVar("Made")
Projection = Literal["max", "min", "mean", "integral"]

_SAMPLE = 1 << 21  # voxels sampled for a histogram: enough for its bins, and fast
_BINS = 512
_ENDS = 0.0005  # fraction of the values left out at either end of a histogram
_NEXT_TO_NOTHING = 1e-12  # relative to the range: a narrower histogram is a single value, and is widened to the whole range
_COMMON = 0.05  # smallest fraction of the samples for a value to be a background ...
_STANDS_OUT = 4.0  # ... if it is this many times as frequent as either of its neighbours
_SOME = 0.02  # smallest fraction of non-background samples on either side in signed data
_AS_FAR = 0.25  # smallest ratio of the median distances on both sides in signed data
_OFF = 0.15  # largest median, relative to the extent, of signed data without an exact background
_NEAR = 0.4  # smallest fraction of those within a quarter of the extent
_MOST, _NEARLY_ALL = (
    0.6,
    0.95,
)  # smallest fractions of all samples, and of those on the faces, in a bright background without exact value
_STEP = 0.05  # relative to the brightest distance: a wider gap beside the background is the step of a mask ...
_LEVELS = 4.0  # ... if it is also this many times the usual distance of neighbouring values
_EVEN = 0.25  # relative to the distance from the background: an object with a smaller spread is uniform
_TWO_CLASSES = 0.8  # smallest fraction of the variance between two distinct Otsu classes; a normal distribution has 0.64
_FEWEST = 0.05  # smallest fraction of samples in the smaller class
_FOOT = 0.35  # fraction of the way from the threshold back to the background where matter starts to show
_AIR = (-1100.0, -900.0)  # CT numbers of air, in Hounsfield units
_NO_MATTER = (-700.0, -500.0)  # CT numbers between lung and fat, in Hounsfield units
_BELL = (1.7, 2.6)  # how much wider four standard deviations of noise are than two of them: 2, if it is normal
_RARE = 5.0  # standard deviations of noise above its median, from where on few samples ...
_FEW_OF_ALL = (1e-4, 0.05)  # ... these fractions of all, are the matter in a volume that noise fills
_CLEAR = 3.0  # and those above its median where matter begins: pictures smooth such noise to less than half
_NOISY = 0.5  # smallest fraction of the spread of such a volume that is noise
_DIM = 0.05  # fraction of the columns of samples that a projection shows black ...
_BRIGHT = 0.98  # ... and fraction of the others that it shows at most white
_LIT = 0.02  # fraction of the way from black to the brightest, without a few outliers, above which a column is lit
_FEW = 8
_GREY = 0.65  # of the way from black to white: what the median of those that are lit should not exceed ...
_DIMMEST = 0.05  # ... while black is no more than this quantile of them ...
_HALF = 0.5  # ... and takes no more than so much of the range
_EVENLY, _STEEPLY = 0.5, 0.95  # quantiles of the magnitudes of gradients in matter
_COUNTED = 1 << 24  # labels that are counted one by one: sorting all samples takes far longer
_COLUMNS_OF = 1 << 22  # voxels that projections are made of


@dataclass(frozen=True)
class Matter:
    """The range of values of a volume's matter; distances are measured from `origin`, in units of ``2**exponent``.

    Parameters
    ----------
    exponent : int
    origin : float
        The exact background value, else about the smallest value, in units of ``2**exponent``.
    ground : float or None
        The exact value of the background.
    sign : 1 or -1
        The side of the origin with matter.
    signed : bool
        Whether matter is on both sides.
    foot, start, middle, top : float
        Distances: below `foot` nothing shows; matter starts at `start`; `middle` is its median, limited to near the start;
        `top` is the brightest.
    isovalue : float
        Isovalue of the surface that shows it, in units of the data.
    reason : str
        Reason for the isovalue, in words.
    """

    exponent: int
    origin: float
    ground: float | None
    sign: int
    signed: bool
    foot: float
    start: float
    middle: float
    top: float
    isovalue: float
    reason: str

    def value(self, distance: float, side: int = 1) -> float:
        """The value at a distance, in units of the data; `side` -1 is the other side of signed data."""
        return unscaled(self.origin + side * self.sign * distance, self.exponent)

    def distance(self, value: float) -> float:
        """The distance of a value, negative on the side without matter."""
        return self.sign * (float(scaled(value, self.exponent)) - self.origin)


def _remembered(make: Callable[[Volume], Made]) -> Callable[[Volume | ArrayLike], Made]:
    """Cache a function of a volume's samples per volume, because they do not change."""

    @wraps(make)
    def found(volume: Volume | ArrayLike) -> Made:
        volume = as_volume(volume)
        known = _KNOWN.setdefault(volume, {})
        if make.__name__ not in known:
            known[make.__name__] = make(volume)
        return cast(Made, known[make.__name__])

    return found


_KNOWN: WeakKeyDictionary[Volume, dict[str, Any]] = WeakKeyDictionary()


def share(volume: Volume, other: Volume) -> None:
    """Use for a volume of the same samples what is known of another one, and what will be."""
    _KNOWN[other] = _KNOWN.setdefault(volume, {})


def remember(volume: Volume, **found: Any) -> None:
    """Use for a volume what these functions found in more samples than it has."""
    _KNOWN.setdefault(volume, {}).update(found)


@_remembered
def matter_of(volume: Volume) -> Matter:
    """The values of a volume's matter, from at most about two million samples."""
    low, high = volume.value_range
    exponent = exponent_of(low, high)
    if not low < high:
        origin = float(scaled(low, exponent))
        return Matter(
            exponent, origin, None, 1, signed=False, foot=0, start=0, middle=0, top=0, isovalue=low, reason="the only value"
        )
    values = scaled(_sorted(_some(volume)), exponent)
    ground = _ground(volume, *_distinct(values), exponent)
    if ground is not None and _of_air(_unscaled_all(values, exponent), unscaled(ground, exponent)):
        values, ground = values[values > scaled(_AIR[0], exponent)], None  # drop the padding outside the scan's field of view
    signed = _both_sides(values, ground) if ground is not None else _about_zero(values)
    origin, sign = (0.0 if ground is None else ground), 1
    if not signed and ground is None:
        dark = _dark_in_bright(values, _faces(volume, exponent)) and not -32768 <= low <= -50  # as CT has it
        origin, sign = (_quantile(values, 1 - _ENDS), -1) if dark else (_quantile(values, _ENDS), 1)
    elif not signed:
        sign = 1 if _quantile(values, 0.995) - origin >= origin - _quantile(values, 0.005) else -1
    # signed distances fall, then rise: merge the two sorted parts
    away = np.sort(np.abs(values - origin), kind="stable") if signed else np.maximum(sign * (values - origin), 0)[::sign]
    span = float(scaled(high, exponent) - scaled(low, exponent))
    rare = None if signed or ground is not None else _rare_in_noise(volume, away, exponent)
    return _parted(away, _Axis(exponent, origin, sign), ground, signed=signed, span=span, rare=rare)


@_remembered
def spread_of(volume: Volume) -> tuple[float, float]:
    """Mean and standard deviation of all finite samples."""
    low, high = volume.limits
    return spread_in(volume.data, exponent_of(float(low), float(high)) if np.isfinite((low, high)).all() else 0)


def spread_in(parts: Iterable[NDArray[Any]], exponent: int) -> tuple[float, float]:
    """Mean and standard deviation of all finite samples of the parts; `exponent` is that of the largest."""
    count, mean, squares = 0, 0.0, 0.0
    for part in parts:  # Chan, Golub and LeVeque, 1983
        values = scaled(part, exponent)
        values = values[np.isfinite(values)]
        if n := values.size:
            middle = float(values.mean())
            squares += float(np.square(values - middle).sum()) + (middle - mean) ** 2 * (count * n / (count + n))
            mean += (middle - mean) * (n / (count + n))
            count += n
    return unscaled(mean, exponent), unscaled(math.sqrt(squares / max(1, count)), exponent)


def isovalue_of(volume: Volume | ArrayLike) -> tuple[float, str]:
    """The isovalue of the surface that shows a volume's matter, and the reason in words.

    This is Otsu's threshold, unless it is within the step at the edge of a mask, which is not a surface of the scanned
    object. Then it moves into the values of the object: to their Otsu threshold if they form two classes, else halfway to
    their median; or to the middle of the step if the object is uniform. For labels it is half a label above the
    background.

    Returns
    -------
    (float, str)
        In units of the data; "splits the values in two (Otsu)" or "beyond the mask's step, 0 to 28", for example.
    """
    volume = as_volume(volume)
    if volume.is_labels:
        background, numbers = label_numbers(volume)
        above = bool((numbers > background).any()) or len(numbers) == 1
        return background + (0.5 if above else -0.5), f"between labels and the background, {background:g}"
    found = matter_of(volume)
    return found.isovalue, found.reason


@_remembered
def label_numbers(volume: Volume) -> tuple[float, Array]:
    """The background label, 0 if it occurs, else the most frequent; and all labels in ascending order."""
    return labels_in(volume.data, volume.limits, volume.data.dtype)


def labels_in(parts: Iterable[NDArray[Any]], limits: tuple[float, float], dtype: np.dtype[Any]) -> tuple[float, Array]:
    """As `label_numbers`, of samples that come by parts, whose smallest and largest are known."""
    whole = dtype.kind in "iu"
    low, high = map(int, limits if whole else (0, 0))  # exact, even outside the range of float64
    if whole and high - low < _COUNTED:
        counts = np.zeros(high - low + 1, np.int64)
        for part in parts:  # by parts, to avoid a copy of all samples as int64; modulo 2⁶⁴
            above = part.astype(np.uint64) - np.uint64(low % (1 << 64))
            counts += np.bincount(above.astype(np.int64).ravel(), minlength=counts.size)
        numbers = np.flatnonzero(counts).astype(np.float64) + low
        counts = counts[counts > 0]
    else:
        found = [np.unique(np.round(part[np.isfinite(part)].astype(np.float64)), return_counts=True) for part in parts]
        numbers, places = np.unique(np.concatenate([some for some, _ in found]), return_inverse=True)
        counts = np.bincount(places, np.concatenate([some for _, some in found]), len(numbers)).astype(np.int64)
    background = 0.0 if (numbers == 0).any() else float(numbers[int(counts.argmax())])
    return background, numbers


@_remembered
def slopes_of(volume: Volume) -> tuple[float, float]:
    """How steep even matter is and how steep its boundaries are: magnitudes of gradients, in units of the data per world unit.

    They are the median and a high quantile of those of matter, by differences of neighbouring samples.
    """
    matter = matter_of(volume)
    step = max(1, round((volume.data.size / _SAMPLE) ** (1 / volume.ndim)))
    places = [np.arange(0, n, step) for n in volume.shape]
    steep = steepness_at(volume.data, places, volume.world_to_index_matrix)
    shown = scaled(volume.data[np.ix_(*places)], matter.exponent) - matter.origin
    shown = np.abs(shown) if matter.signed else matter.sign * shown
    steep = steep[np.isfinite(steep) & (shown >= matter.foot)]
    if not steep.size:
        return 0.0, 0.0
    even, edge = np.quantile(steep, (_EVENLY, _STEEPLY))
    return float(even), float(edge)


@_remembered
def clims_of(volume: Volume) -> dict[Projection, tuple[float, float]]:
    """Black and white of each projection: of the dimmest of the columns of samples along the axes, and nearly of the brightest.

    If minima hardly differ, as for an object in air, the window of the samples is used.
    """
    low, high = volume.value_range
    exponent = exponent_of(low, high)
    bottom = float(scaled(low, exponent))
    samples = scaled(_thinned(volume, _COLUMNS_OF), exponent)
    finite = np.isfinite(samples)
    if not finite.any():  # a sparse choice has none
        samples, finite = np.full_like(samples, bottom), np.ones_like(finite)
    counts = [np.count_nonzero(finite, axis=axis) for axis in range(volume.ndim)]
    usual = _clim(np.sort(samples[finite]))
    found: dict[Projection, tuple[float, float]] = {}
    ways: dict[Projection, Callable[..., Array]] = {"max": np.max, "min": np.min, "mean": np.mean}
    within: dict[Projection, float] = {"max": -np.inf, "min": np.inf, "mean": 0.0}  # what missing samples count as
    for name, way in ways.items():
        filled = samples if finite.all() else np.where(finite, samples, within[name])
        columns = np.concatenate([way(filled, axis=axis)[count > 0] for axis, count in enumerate(counts)])
        if name == "mean" and not finite.all():  # of those that are there
            sizes = [np.full_like(count, n) for count, n in zip(counts, samples.shape, strict=True)]
            columns *= np.concatenate([size[count > 0] / count[count > 0] for size, count in zip(sizes, counts, strict=True)])
        ends = _clim(np.sort(columns), high=name == "max")
        if ends[1] - ends[0] <= _STEP * (usual[1] - usual[0]):
            ends = usual
        if not ends[0] < ends[1]:  # nearly all values are equal
            ends = bottom, float(scaled(high, exponent))
        found[name] = unscaled(ends[0], exponent), unscaled(ends[1], exponent)
    return found


def integrals_of(volume: Volume, height: Callable[[NDArray[Any]], Array]) -> tuple[float, float]:
    """Black and white of line integrals of `height` of the values: 0, or less, to nearly that of the brightest column of samples.

    The columns are those along the axes, of evenly spaced samples, which stores keep too; missing ones count nothing.
    """
    samples, grid = evenly(volume)
    heights = np.where(np.isfinite(samples), height(samples), 0.0)
    lengths = zip(grid.spacing[::-1], grid.shape, strict=True)
    columns = [(heights.mean(axis) * spacing * n).ravel() for axis, (spacing, n) in enumerate(lengths)]
    low, high = _clim(np.sort(np.concatenate(columns)))
    low, high = min(low, 0.0), max(high, 0.0)
    return (low, high) if low < high else (0.0, 1.0)


def may_be_hounsfield(volume: Volume) -> bool:
    """Whether values may be in Hounsfield units: fat and air below 0, bone well above."""
    low, high = volume.value_range
    return -32768 <= low <= -50 and 50 <= high <= 65535 and not matter_of(volume).signed


# -- inner -------------------------------------------------------------------------------------------------


def _rare_in_noise(volume: Volume, away: Array, exponent: int) -> float | None:
    """Where noise ends that fills a volume with something rare and bright in it, as vessels in angiograms; else None."""
    lowest, low, median, high, highest = (_quantile(away, share) for share in (0.023, 0.159, 0.5, 0.841, 0.977))
    spread = (high - low) / 2
    bright = away[np.searchsorted(away, median + _RARE * spread) :]
    if not spread or not _FEW_OF_ALL[0] <= bright.size / away.size <= _FEW_OF_ALL[1]:
        return None
    split = abs(_otsu(away)[0] - median) <= 1.5 * spread  # noise into two
    if not (split and _BELL[0] <= (highest - lowest) / (high - low) <= _BELL[1]):
        return None
    if volume.noise.rms < _NOISY * unscaled(spread, exponent):
        return None
    return median + _CLEAR * spread


class _Axis(NamedTuple):
    """Distances from an origin, to one side: see `Matter`."""

    exponent: int
    origin: float
    sign: int

    def value(self, distance: float) -> float:
        return unscaled(self.origin + self.sign * distance, self.exponent)


def _parted(away: Array, axis: _Axis, ground: float | None, *, signed: bool, span: float, rare: float | None) -> Matter:
    """Separate background and matter, from sorted distances; `rare` is where matter begins in noise that fills the volume."""
    rest = away[np.searchsorted(away, 0, side="right") :] if ground is not None else away
    threshold, reason = _otsu(rest if signed else away)[0], "splits the values in two (Otsu)"
    if rare is not None:
        threshold, reason = rare, "lies above the noise that fills the volume"
    step = _step_beside(rest) if ground is not None else 0.0
    median = _quantile(rest, 0.5)
    even = ground is not None and _quantile(rest, 0.95) - _quantile(rest, 0.05) <= _EVEN * median
    start = surface = threshold
    value = axis.value

    if even and threshold < _quantile(rest, 0.05):
        start = surface = median / 2
        reason = f"halfway between the background, {value(0):.6g}, and the object, {value(median):.6g}"
    elif step > 0 and (signed or threshold <= 1.1 * step):
        inner, share = _otsu(rest)
        start = step
        if not signed and share >= _TWO_CLASSES and min((rest < inner).mean(), (rest > inner).mean()) >= _FEWEST:
            surface, how = inner, "splits the object's values in two (Otsu)"
        else:
            surface, how = (step + median) / 2, "at the start of the object's values"
        reason = f"{how}, beyond the mask's step, {value(0):.6g} to {value(step):.6g}"
    if signed:
        reason += f"; values have both signs around {value(0):.6g}: this is the surface of the upper side"
    below = (
        away[np.searchsorted(away, 0, side="right") : np.searchsorted(away, start)] if ground is not None else away[away < start]
    )
    usual = _quantile(below, 0.5) if below.size >= _COMMON * away.size else 0.0
    foot = step / 2 if start == step else start - _FOOT * (start - usual)
    inside = away[np.searchsorted(away, start) :]
    top = max(_quantile(inside, 0.995) if inside.size else away[-1], start + 1e-3 * span)
    middle = min(max(_quantile(inside, 0.5) if inside.size else 0.0, start + 0.15 * (top - start)), start + 0.5 * (top - start))
    return Matter(
        axis.exponent,
        axis.origin,
        None if ground is None else value(0),
        axis.sign,
        signed,
        foot,
        start,
        middle,
        top,
        value(surface),
        reason,
    )


def _ground(volume: Volume, distinct: Array, counts: NDArray[np.int64], exponent: int) -> float | None:
    """The exact background value in units of ``2**exponent``, or None.

    Measured values clipped at the top are frequent and exact too, but rarely on the faces of the volume.
    """
    if len(distinct) == 2:
        return float(distinct[0])
    padded = np.pad(counts, 1)
    beside = np.maximum(padded[:-2], padded[2:])
    common = (counts >= _COMMON * counts.sum()) & (counts >= _STANDS_OUT * beside)
    faces = _faces(volume, exponent)
    best, most = None, -1.0
    for place in np.flatnonzero(common):
        value, share = float(distinct[place]), float(counts[place] / counts.sum())
        at_faces = float((faces == value).mean()) if faces.size else 0.0
        if (value in (0.0, distinct[0]) or at_faces >= share / 2) and (at_faces, share) > (most, 0):
            best, most = value, at_faces
    return best


def _faces(volume: Volume, exponent: int) -> Array:
    """Samples on the faces of the volume."""
    ends = [volume.data[(*(slice(None),) * axis, end)].ravel() for axis in range(volume.ndim) for end in (0, -1)]
    faces = scaled(np.concatenate(ends), exponent)
    return faces[np.isfinite(faces)]


def _dark_in_bright(values: Array, faces: Array) -> bool:
    """Whether the upper of two classes of sorted values is the background, as for stained matter in transmitted light."""
    threshold = _otsu(values)[0]
    return bool((values > threshold).mean() >= _MOST and faces.size and (faces > threshold).mean() >= _NEARLY_ALL)


def _of_air(values: Array, ground: float) -> bool:
    """Whether the values are CT numbers that include air, and the ground, which was never measured, is below air."""
    air, none = (((values >= a) & (values <= b)).mean() for a, b in (_AIR, _NO_MATTER))
    return bool(ground < _AIR[0] and air >= _COMMON and air > 2 * none)


def _unscaled_all(values: Array, exponent: int) -> Array:
    with np.errstate(over="ignore"):
        return np.asarray(np.ldexp(values, exponent))


def _both_sides(values: Array, ground: float) -> bool:
    """Whether sorted values are on both sides of the ground, at similar distances."""
    below, above = values[: np.searchsorted(values, ground)], values[np.searchsorted(values, ground, side="right") :]
    if min(below.size, above.size) < max(_SOME * (below.size + above.size), 1):
        return False
    down, up = ground - _quantile(below, 0.5), _quantile(above, 0.5) - ground
    return min(down, up) >= _AS_FAR * max(down, up)


def _about_zero(values: Array) -> bool:
    """Whether sorted values peak at 0 and extend to both sides by similar distances."""
    low, high = _quantile(values, 0.005), _quantile(values, 0.995)
    far = max(-low, high)
    if low >= 0 or high <= 0 or min(-low, high) < far / 2 or abs(_quantile(values, 0.5)) > _OFF * far:
        return False
    counts, _ = np.histogram(values, 8, (-far, far))
    down, up = counts[3::-1], counts[4:]
    fall = all((side[1:] <= side[:-1]).all() for side in (down, up))
    return bool(fall and down[0] + up[0] >= _NEAR * values.size)


def _step_beside(rest: Array) -> float:
    """The distance of a mask's step, between the background and all other values; 0 if there is none."""
    step = _quantile(rest, 0.005)
    if step < _STEP * _quantile(rest, 0.995):
        return 0.0
    apart = np.diff(_distinct(rest)[0])
    return step if not apart.size or step >= _LEVELS * float(np.median(apart)) else 0.0


def _otsu(distances: Array) -> tuple[float, float]:
    """Otsu's threshold of sorted distances, and the fraction of their variance between the classes."""
    low, high = float(distances[0]), float(distances[-1])
    if not low < high:
        return low, 0.0
    unit = (distances - low) / (high - low)
    top = _quantile(unit, 1 - _ENDS)
    counts, edges = np.histogram(unit, _BINS, (0, top if top > _NEXT_TO_NOTHING else 1))
    middles = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    above = below[-1] - below
    moment = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = below * above * (moment / below - (moment[-1] - moment) / above) ** 2
    between[~np.isfinite(between)] = -1
    if between.max() <= 0:
        return (low + high) / 2, 0.0
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))  # a gap gives a plateau: use its middle
    total = below[-1] * float(counts @ (middles - moment[-1] / below[-1]) ** 2)
    return low + (high - low) * float(edges[1:][best].mean()), float(between.max()) / total


def _clim(values: Array, *, high: bool = False) -> tuple[float, float]:
    """Black and white for sorted values; for those of which most are high, as maxima are, black may be raised."""
    black = _quantile(values, _DIM)
    brightest = float(values[max(min(round(0.999 * values.size), values.size - 1 - _FEW), values.size // 2)])
    lit = values[np.searchsorted(values, black + _LIT * (brightest - black), side="right") :]
    if not lit.size:
        return black, float(values[-1])
    white = _quantile(lit, _BRIGHT)
    if not high:
        return black, white
    grey = (_quantile(lit, 0.5) - _GREY * white) / (1 - _GREY)  # the black that puts the median there
    return max(black, min(grey, _quantile(lit, _DIMMEST), black + _HALF * (white - black))), white


def _quantile(values: Array, share: float) -> float:
    """A quantile of sorted values, one of them; 0 if empty."""
    return float(values[round(share * (values.size - 1))]) if values.size else 0.0


def _thinned(volume: Volume, most: int) -> NDArray[np.generic]:
    step = max(1, round((volume.data.size / most) ** (1 / volume.ndim)))
    return volume.data[(slice(None, None, step),) * volume.ndim]


def _some(volume: Volume) -> NDArray[np.generic]:
    """Evenly spread finite samples in the volume's dtype; all finite ones if a sparse choice has none."""
    for some in (_thinned(volume, _SAMPLE), volume.data):
        with np.errstate(over="ignore"):  # longdouble has a larger range than float64
            values = some.astype(np.float64 if some.itemsize > 8 else some.dtype.newbyteorder("=")).ravel()
        values = values[np.isfinite(values)]
        if values.size:
            break
    return values[:: max(1, values.size // _SAMPLE)]


def _sorted(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Sort before converting to float64, which is twice as slow to sort; integers of up to 16 bits use radix sort."""
    return np.sort(values, kind="stable" if values.dtype.kind in "biu" and values.itemsize <= 2 else None)


def _distinct(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """The distinct values of a sorted array and their counts; `numpy.unique` would sort it again."""
    first = np.flatnonzero(np.concatenate([values[:1] == values[:1], values[1:] != values[:-1]]))
    return values[first], np.diff(first, append=values.size)
