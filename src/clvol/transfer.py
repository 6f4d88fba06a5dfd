"""Transfer functions: from a value to a colour and an opacity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.errors import OptionError
from clvol.light import color_of
from clvol.volume import Volume

__all__ = ["TABLE_SIZE", "TransferFunction", "otsu_threshold"]

TABLE_SIZE = 1025  # nodes of the table that devices read, with linear interpolation between them
_CMAP_NODES = 64
_BINS = 512
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

    def __post_init__(self) -> None:
        colors = tuple((_value(v), color_of("a color", c)) for v, c in _pairs("colors", self.colors))
        opacities = tuple((_value(v), _value(a)) for v, a in _pairs("opacities", self.opacities))
        for what, points in (("colors", colors), ("opacities", opacities)):
            values = [p[0] for p in points]
            if not values or values != sorted(values):
                raise OptionError(f"{what} must be one or more points in ascending order of value; got {values}")
        if not all(0 <= a <= 1 for _, a in opacities):
            raise OptionError(f"opacities must lie in 0..1; got {[a for _, a in opacities]}")
        if self.unit_distance is not None and not (math.isfinite(self.unit_distance) and self.unit_distance > 0):
            raise OptionError(f"unit_distance must be positive; got {self.unit_distance!r}")
        object.__setattr__(self, "colors", colors)
        object.__setattr__(self, "opacities", opacities)

    @classmethod
    def from_cmap(
        cls, name: str, value_range: tuple[float, float], opacity: float | Sequence[tuple[float, float]] = 1.0,
        unit_distance: float | None = None,
    ) -> TransferFunction:  # fmt: skip
        """Colours of a map of the `cmap` package ("viridis", "bone", ...) spread over a range of values."""
        import cmap

        low, high = (_value(v) for v in value_range)
        if not low <= high:
            raise OptionError(f"value_range must be (least, greatest); got {value_range}")
        try:
            chosen = cmap.Colormap(name)
        except (ValueError, TypeError, KeyError, FileNotFoundError):
            raise OptionError(
                f"colour map {name!r} is not known to the cmap package; try 'gray', 'viridis', 'bone', 'magma'"
            ) from None
        at = np.linspace(0, 1, _CMAP_NODES)
        colors = tuple((low + (high - low) * float(u), tuple(map(float, chosen(float(u)).rgba[:3]))) for u in at)
        points = ((low, float(opacity)),) if isinstance(opacity, (int, float)) else tuple(opacity)
        return cls(colors, points, unit_distance)  # type: ignore[arg-type]  # three floats each

    @classmethod
    def ramp(cls, value_range: tuple[float, float]) -> TransferFunction:
        """Black at the least value, white at the greatest, opaque: for projections."""
        low, high = value_range
        return cls(((low, (0.0, 0.0, 0.0)), (high, (1.0, 1.0, 1.0))), ((low, 1.0),))

    @classmethod
    def automatic(cls, volume: Volume) -> TransferFunction:
        """One that shows the matter of most volumes, from the histogram.

        Nothing below Otsu's threshold between background and matter is seen; opacity then rises to
        the brightest values. Colours run from dark red over bone to white.
        """
        low, high = volume.value_range
        values = _some_values(volume)
        start = otsu_threshold(volume)
        inside = values[values > start]
        top = float(np.quantile(inside, 0.995)) if inside.size else high
        top = max(top, start + 1e-3 * (high - low))
        if not low < high:  # constant data: show it as fog
            return cls(((low, (0.9, 0.85, 0.75)),), ((low, 0.02),))

        def at(share: float) -> float:
            return start + share * (top - start)

        soft = start - 0.35 * (start - low)
        return cls(
            (
                (soft, (0.42, 0.16, 0.10)),
                (at(0.15), (0.78, 0.45, 0.30)),
                (at(0.5), (0.95, 0.84, 0.66)),
                (at(1.0), (1.0, 1.0, 0.97)),
            ),
            ((soft, 0.0), (start, 0.05), (at(0.4), 0.30), (at(1.0), 0.80)),
        )

    @cached_property
    def value_range(self) -> tuple[float, float]:
        """Least and greatest value of any point."""
        values = [p[0] for p in self.colors] + [p[0] for p in self.opacities]
        return min(values), max(values)

    def __call__(self, values: ArrayLike) -> NDArray[np.float64]:
        """Red, green, blue and opacity at `values`; shape (..., 4), exact."""
        v = np.asarray(values, dtype=np.float64)
        at, rgb = [p[0] for p in self.colors], np.array([p[1] for p in self.colors])
        columns = [np.interp(v, at, rgb[:, i]) for i in range(3)]
        return np.stack([*columns, np.interp(v, *np.array(self.opacities).T)], -1)

    def table(self) -> NDArray[np.float32]:
        """The function at `TABLE_SIZE` equally spaced values of `value_range`; shape (TABLE_SIZE, 4)."""
        return self(np.linspace(*self.value_range, TABLE_SIZE)).astype(np.float32)

    def with_opacity(self, opacities: Sequence[tuple[float, float]]) -> TransferFunction:
        """The same colours under other opacities."""
        return replace(self, opacities=tuple(opacities))


def otsu_threshold(volume: Volume) -> float:
    """The value that best parts the histogram in two (Otsu, 1979); the middle of the range for few values."""
    low, high = volume.value_range
    if not low < high:
        return low
    values = _some_values(volume)
    counts, edges = np.histogram(values, _BINS, (low, float(np.quantile(values, 0.9995)) or high))
    middles = (edges[1:] + edges[:-1]) / 2
    below = np.cumsum(counts)
    above = below[-1] - below
    moment = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = below * above * (moment / below - (moment[-1] - moment) / above) ** 2
    between[~np.isfinite(between)] = -1
    if between.max() <= 0:
        return (low + high) / 2
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))  # a gap makes a plateau: take its middle
    return float(edges[1:][best].mean())


def _some_values(volume: Volume) -> NDArray[np.float64]:
    flat = volume.data[
        tuple(slice(None, None, max(1, round((volume.data.size / _BINS_SAMPLE) ** (1 / volume.ndim)))) for _ in volume.shape)
    ]
    values = flat.astype(np.float64).ravel()
    return values[np.isfinite(values)]


def _pairs(what: str, points: Sequence[tuple[float, Any]]) -> list[tuple[float, Any]]:
    try:
        return [(v, c) for v, c in points]
    except (TypeError, ValueError):
        raise OptionError(f"{what} must be pairs of a value and what belongs to it; got {points!r}") from None


def _value(value: object) -> float:
    if isinstance(value, (int, float, np.number)) and math.isfinite(float(value)):
        return float(value)
    raise OptionError(f"values and opacities must be finite numbers; got {value!r}")
