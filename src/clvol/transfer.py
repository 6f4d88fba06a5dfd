"""Transfer functions: from a value to a colour and an opacity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import Any, ClassVar, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.checks import number, reals
from clvol.color import color_of
from clvol.errors import OptionError
from clvol.stored import Stored
from clvol.uniform import FLOAT, Block, Values
from clvol.volume import Volume, as_volume

__all__ = ["TABLE_SIZE", "TransferFunction", "otsu_threshold"]

Made = TypeVar("Made")

TABLE_SIZE = 1025  # nodes of the table that devices read, with linear interpolation between them
_CMAP_NODES = 64
_BINS = 512
_MIN_TOP = 1e-12  # of the range: what lies below is one value, and the histogram covers all
_BINS_SAMPLE = 1 << 21  # voxels that a histogram is made of: enough for 512 bins, and fast


@dataclass(frozen=True)
class TransferFunction:
    """Colour and opacity, each piecewise linear in the value and constant beyond its end points.

    Parameters
    ----------
    colors : sequence of (value, color)
        Colours are three numbers in 0..1 or names ("white", "#ff8800").
    opacities : sequence of (value, opacity)
        Opacity, 0..1, of matter one `unit_distance` thick.
    unit_distance : float, optional
        World length to which opacities refer; None: the mean spacing of the volume.

    Notes
    -----
    Devices read both from one table of 1025 nodes, linear in between: points that lie between nodes
    are moved by up to half a 1024th of the range from the first point to the last.
    """

    colors: tuple[tuple[float, tuple[float, float, float]], ...]
    opacities: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    unit_distance: float | None = None

    BLOCK: ClassVar[Block] = Block("transfer_block", low=FLOAT, scale=FLOAT, per_unit_distance=FLOAT)

    def __post_init__(self) -> None:
        colors = tuple((_value(v), color_of("a color", c)) for v, c in _pairs("colors", self.colors))
        opacities = tuple((_value(v), _value(a)) for v, a in _pairs("opacities", self.opacities))
        for what, points in (("colors", colors), ("opacities", opacities)):
            values = [p[0] for p in points]
            if not values or values != sorted(values):
                raise OptionError(f"{what} must be one or more points in ascending order of value; got {values}")
        if not all(0 <= a <= 1 for _, a in opacities):
            raise OptionError(f"opacities must lie in 0..1; got {[a for _, a in opacities]}")
        if self.unit_distance is not None:
            object.__setattr__(self, "unit_distance", number("unit_distance", self.unit_distance, above=0))
        object.__setattr__(self, "colors", colors)
        object.__setattr__(self, "opacities", opacities)

    @classmethod
    def from_cmap(
        cls,
        name: str,
        value_range: tuple[float, float],
        opacity: float | Sequence[tuple[float, float]] = 1.0,
        unit_distance: float | None = None,
    ) -> TransferFunction:
        """Colours of a map of the `cmap` package ("viridis", "bone", ...) spread over a range of values."""
        import cmap

        low, high = _range(value_range)
        at = np.linspace(0, 1, _CMAP_NODES)
        try:
            chosen = cmap.Colormap(name)
            shades = [tuple(map(float, chosen(float(u)).rgba[:3])) for u in at]
        except Exception:  # of many kinds, for what is no name
            raise OptionError(
                f"colour map {name!r} is not known to the cmap package; try 'gray', 'viridis', 'bone', 'magma'"
            ) from None
        colors = tuple((low + (high * float(u) - low * float(u)), shade) for u, shade in zip(at, shades, strict=True))
        points: Any = opacity
        if np.ndim(np.asarray(opacity, dtype=object)) == 0:  # one number, or nothing that is a sequence
            points = ((low, number("opacity", opacity, minimum=0, maximum=1)),)
        return cls(colors, points, unit_distance)  # type: ignore[arg-type]  # three floats each

    @classmethod
    def ramp(cls, value_range: tuple[float, float]) -> TransferFunction:
        """Black at the minimum, white at the maximum, opaque: for projections."""
        low, high = _range(value_range)
        return cls(((low, (0.0, 0.0, 0.0)), (high, (1.0, 1.0, 1.0))), ((low, 1.0),))

    @classmethod
    def automatic(cls, volume: Volume | ArrayLike) -> TransferFunction:
        """One that shows the matter of most volumes, from the histogram.

        Nothing below Otsu's threshold between background and matter is seen; opacity then rises to
        the brightest values. Colours run from dark red over bone to white.
        """
        return _automatic(volume)

    @cached_property
    def value_range(self) -> tuple[float, float]:
        """The smallest and the largest value of any point."""
        values = [p[0] for p in self.colors] + [p[0] for p in self.opacities]
        return min(values), max(values)

    def __call__(self, values: ArrayLike) -> NDArray[np.float64]:
        """Red, green, blue and opacity at `values`; shape (..., 4), exact."""
        exponent = _exponent(*self.value_range)
        v = _scaled(reals("values", values), exponent)
        rgb, at = np.array([p[1] for p in self.colors]), _scaled([p[0] for p in self.colors], exponent)
        opacity, where = [p[1] for p in self.opacities], _scaled([p[0] for p in self.opacities], exponent)
        return np.stack([*(np.interp(v, at, rgb[:, i]) for i in range(3)), np.interp(v, where, opacity)], -1)

    def table(self, offset: float = 0.0, exponent: int = 0) -> NDArray[np.float32]:
        """The function at `TABLE_SIZE` equally spaced values of `value_range`, as far as float32 holds them; shape (TABLE_SIZE, 4).

        Values are stored as ``(value - offset) * 2**-exponent``.
        """
        ends = tuple(Stored(offset, exponent).held(self.value_range).tolist())
        exponent = _exponent(*ends)
        low, high = _scaled(ends, exponent)
        return self(np.ldexp(np.linspace(low, high, TABLE_SIZE), exponent)).astype(np.float32)

    def block(self, unit: float, offset: float = 0.0, exponent: int = 0) -> Values:
        """What kernels read, given how many world units one of their units of length has (the mean spacing); see `table`."""
        low, high = Stored(offset, exponent)(self.value_range)
        scale = min((TABLE_SIZE - 1) / (high - low), 1e38) if high > low else 0.0
        return self.BLOCK(low=low, scale=scale, per_unit_distance=unit / (self.unit_distance or unit))

    def with_opacity(self, opacities: Sequence[tuple[float, float]]) -> TransferFunction:
        """The same colours under other opacities."""
        return replace(self, opacities=opacities)  # type: ignore[arg-type]  # __post_init__ converts


def _remembered(make: Callable[[Volume], Made]) -> Callable[[Volume | ArrayLike], Made]:
    """What is derived from a volume's histogram, once a volume: its samples do not change."""
    known: WeakKeyDictionary[Volume, Made] = WeakKeyDictionary()

    @wraps(make)
    def found(volume: Volume | ArrayLike) -> Made:
        volume = as_volume(volume)
        if volume not in known:
            known[volume] = make(volume)
        return known[volume]

    return found


@_remembered
def otsu_threshold(volume: Volume) -> float:
    """The value that best parts the histogram in two (Otsu, 1979); the middle of the range for few values."""
    low, high = volume.value_range
    if not low < high:
        return low
    exponent = _exponent(low, high)
    bottom, top_value = _scaled((low, high), exponent)
    values = (_scaled(_some_values(volume), exponent) - bottom) / (top_value - bottom)  # 0..1
    top = float(np.quantile(values, 0.9995))
    counts, edges = np.histogram(values, _BINS, (0, top if top > _MIN_TOP else 1))
    middles = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    above = below[-1] - below
    moment = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = below * above * (moment / below - (moment[-1] - moment) / above) ** 2
    between[~np.isfinite(between)] = -1
    if between.max() <= 0:
        return low / 2 + high / 2
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))  # a gap makes a plateau: take its middle
    return math.ldexp(float(bottom + (top_value - bottom) * edges[1:][best].mean()), exponent)


@_remembered
def _automatic(volume: Volume) -> TransferFunction:
    """See `TransferFunction.automatic`."""
    low, high = volume.value_range
    values = _some_values(volume)
    start = otsu_threshold(volume)
    inside = values[values > start]
    top = float(np.quantile(inside, 0.995)) if inside.size else high
    top = max(top, start + (1e-3 * high - 1e-3 * low))  # no difference here may overflow
    if not low < high:  # constant data: show it as fog
        return TransferFunction(((low, (0.9, 0.85, 0.75)),), ((low, 0.02),))

    def at(share: float) -> float:
        return start + (share * top - share * start)

    soft = start - (0.35 * start - 0.35 * low)
    return TransferFunction(
        ((soft, (0.42, 0.16, 0.10)), (at(0.15), (0.78, 0.45, 0.30)), (at(0.5), (0.95, 0.84, 0.66)), (at(1.0), (1.0, 1.0, 0.97))),
        ((soft, 0.0), (start, 0.05), (at(0.4), 0.30), (at(1.0), 0.80)),
    )


def _some_values(volume: Volume) -> NDArray[np.float64]:
    flat = volume.data[
        tuple(slice(None, None, max(1, round((volume.data.size / _BINS_SAMPLE) ** (1 / volume.ndim)))) for _ in volume.shape)
    ]
    for some in (flat, volume.data):  # all, where no voxel of a sparse choice is finite
        with np.errstate(over="ignore"):
            values = some.astype(np.float64).ravel()
        values = values[np.isfinite(values)]
        if values.size:
            break
    return values


def _exponent(low: float, high: float) -> int:
    """A power of two that brings a range into -1..1, so that no difference or quotient over- or underflows."""
    return math.frexp(max(abs(low), abs(high)))[1]


def _scaled(values: ArrayLike, exponent: int) -> NDArray[np.float64]:
    """``values / 2**exponent``, exact."""
    with np.errstate(over="ignore"):
        return np.asarray(np.ldexp(np.asarray(values, dtype=np.float64), -exponent))


def _range(value_range: object) -> tuple[float, float]:
    rule = "two finite numbers, (minimum, maximum)"
    values = reals("value_range", value_range, rule)
    if values.shape != (2,) or not np.isfinite(values).all() or values[0] > values[1]:
        raise OptionError(f"value_range must be {rule}; got {value_range!r}")
    return float(values[0]), float(values[1])


def _pairs(what: str, points: Sequence[tuple[float, Any]]) -> list[tuple[float, Any]]:
    try:
        return [(v, c) for v, c in points]
    except (TypeError, ValueError):
        raise OptionError(f"{what} must be pairs of a value and what belongs to it; got {points!r}") from None


def _value(value: object) -> float:
    return number("each value and opacity", value)
