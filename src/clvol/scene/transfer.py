"""Transfer functions: map values to colours and opacities."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.checks import as_path, number, suggests_options
from clvol.base.color import color_of
from clvol.base.errors import OptionError
from clvol.base.files import require_suffix, staged
from clvol.base.scaling import exponent_of, scaled, unscaled
from clvol.base.srgb import as_light
from clvol.base.uniform import FLOAT, INT, Block, Values
from clvol.interop.dispatch import is_in_parts
from clvol.scene.factor import Factors, as_factors
from clvol.scene.points import points_of
from clvol.scene.preset import as_preset, automatic, unit_of
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume, as_volume

__all__ = ["FACTORS", "WORDS", "TransferFunction", "is_curve", "previewed"]

WORDS = ("preset", "window", "cmap", "opacity")
"""Words by which a transfer function may be given: arguments of `clvol.scene.look.look`."""

FACTORS = ("gradient_opacity", "curvature_opacity")
"""Factors of the opacity of any transfer function: arguments of `clvol.scene.look.graded`."""

_CELLS = 1024  # largest number of cells in a table of equal nodes, and of buckets for looking up pieces
_ON_NODE = 1e-5  # tolerance for a point on a node, relative to a cell
_LOOSE = 1e-7  # tolerance for the float32 start of a table of equal nodes, relative to the range
_NEARLY_OPAQUE = 0.99  # from this opacity on, 1 - opacity loses float32 digits
_FEW = 16  # pieces, up to which a value is compared with all of them ...
_AT_ONCE = 4  # ... this many per step
_FAR = 1.5e38  # largest float32 value whose differences do not overflow
_STEEPEST = 3e38
_CMAP_NODES = 64
_SHADE = 1 / 32
"""Largest difference between neighbouring colours of light: what is linear between them is off by 3.7e-4 of light, and by less than
half a step of 8 bits as it is shown."""


@suggests_options
@dataclass(frozen=True)
class TransferFunction:
    """Colour and opacity, each piecewise linear in the value and constant outside its end points.

    Parameters
    ----------
    colors : sequence of (value, color)
        Colours are three numbers in 0..1 or names ("white", "#ff8800").
    opacities : sequence of (value, opacity)
        Opacity, 0..1, of matter with a thickness of one `unit_distance`.
    unit_distance : float, optional
        World length that opacities refer to; None: the mean spacing of the volume.
    gradient_opacity, curvature_opacity : sequence of (number, factor), optional
        Factors of opacity, 0..1, by how steep the function is at a place (the magnitude of its gradient, in units of the data per
        world unit), and by how its isosurface bends there (the larger magnitude of the principal curvatures, per world unit). Up to
        16 points each, in ascending order. They are for "composite".

    Notes
    -----
    Two points at one value make a jump; the value itself has the colour or opacity of the later one. Devices evaluate the function
    exactly, up to float32 rounding: from a table of equal nodes if all points are on such nodes, else from its pieces, which
    they find by comparing values with the points.

    Examples
    --------
    >>> import clvol
    >>> transfer = clvol.TransferFunction([(0, "black"), (1, "orange")], [(0.2, 0), (1, 0.5)])
    >>> picture = clvol.render(clvol.phantoms.sphere(24), transfer=transfer, size=(48, 48))
    """

    colors: tuple[tuple[float, tuple[float, float, float]], ...]
    opacities: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    unit_distance: float | None = None
    gradient_opacity: Factors | None = None
    curvature_opacity: Factors | None = None

    BLOCK: ClassVar[Block] = Block(
        "transfer_block", low=FLOAT, scale=FLOAT, last=FLOAT, per_unit_distance=FLOAT, pieces=INT, halvings=INT
    )

    def __post_init__(self) -> None:
        colors = tuple((_value(v), color_of("a color", c)) for v, c in _pairs("colors", self.colors))
        opacities = tuple((_value(v), _value(a)) for v, a in _pairs("opacities", self.opacities))
        for what, points in (("colors", colors), ("opacities", opacities)):
            values = [p[0] for p in points]
            if not values or values != sorted(values):
                raise OptionError(f"{what} must be one or more points in ascending order of value; got {values}")
        if not all(0 <= a <= 1 for _, a in opacities):
            raise OptionError(f"opacities must be in 0..1; got {[a for _, a in opacities]}")
        if self.unit_distance is not None:
            object.__setattr__(self, "unit_distance", number("unit_distance", self.unit_distance, above=0))
        for name in FACTORS:
            if (points := getattr(self, name)) is not None:
                object.__setattr__(self, name, as_factors(name, points))
        object.__setattr__(self, "colors", colors)
        object.__setattr__(self, "opacities", opacities)

    def _repr_html_(self) -> str:
        """For notebooks: its colours below the opacity curve."""
        from clvol.base import html

        return html.strip([v for v, _ in self.colors], [c for _, c in self.colors], self.opacities)

    @classmethod
    def from_cmap(
        cls,
        name: str,
        value_range: tuple[float, float],
        opacity: float | Sequence[tuple[float, float]] = 1.0,
        unit_distance: float | None = None,
    ) -> TransferFunction:
        """Spread a colour map of the `cmap` package ("viridis", "bone", ...) over a range of values."""
        import cmap

        low, high = _range(value_range)
        at = np.linspace(0, 1, _CMAP_NODES) if low < high else np.ones(1)
        try:
            chosen = cmap.Colormap(name)
            shades = [tuple(map(float, chosen(float(u)).rgba[:3])) for u in at]
        except Exception:  # cmap raises many kinds for an unknown name
            raise OptionError(
                f"colour map {name!r} is not known to the cmap package; try 'gray', 'viridis', 'bone', 'magma'"
            ) from None
        exponent = exponent_of(low, high)
        bottom, top = scaled((low, high), exponent)
        places = [unscaled(bottom + (top * u - bottom * u), exponent) for u in at]
        colors = tuple(zip(places, shades, strict=True))
        points: Any = opacity
        if not is_curve(opacity):
            points = ((low, number("opacity", opacity, minimum=0, maximum=1)),)
        return TransferFunction(colors, points, unit_distance)  # type: ignore[arg-type]  # three floats each

    @classmethod
    def ramp(cls, value_range: tuple[float, float], color: Sequence[float] | str = "white") -> TransferFunction:
        """For projections: opaque, black at the minimum, white or another colour at the maximum. No black if they are equal."""
        low, high = _range(value_range)
        ends = ((low, (0.0, 0.0, 0.0)), (high, color_of("color", color)))
        return TransferFunction(ends if low < high else ends[1:], ((low, 1.0),))

    @classmethod
    def automatic(cls, volume: Volume | ArrayLike, clim: tuple[float, float] | None = None) -> TransferFunction:
        """One that shows the matter of most volumes, from the histogram.

        The background is invisible: an exact value shared by many samples, as in masked volumes, and values below Otsu's threshold
        between background and matter, or below the step at a mask's edge. Opacity rises from there to the brightest values.
        Colours run from dark red over bone to white; they are shades of the volume's own `color`, if it has one, and of green for
        thin stacks of images of light in the dark. Floating numbers of no patient and no stack, without noise, are taken for those
        of a simulation: their colours are viridis, and half transparent. Where values lie to both
        sides of the background, as in statistical maps, it rises to both, in red and yellow above and blue below. The volume's
        `clim` is where opacity and colours reach their ends, as far as that shows no background; `clim`, (low, high), instead of
        it is where they begin and end.
        """
        volume = previewed(volume)
        return TransferFunction(*automatic(volume, clim), unit_of(volume))

    @classmethod
    def preset(cls, name: str, volume: Volume | ArrayLike) -> TransferFunction:
        """The look of a preset for a volume: see `clvol.presets`.

        Raises
        ------
        OptionError
            The name is unknown.

        Warns
        -----
        ClvolWarning
            The preset is in Hounsfield units, but the data cannot be: its points are then spread over the volume's matter.
        """
        volume = previewed(volume)
        return TransferFunction(*as_preset(name).points(volume), unit_of(volume))

    @property
    def graded(self) -> int:
        """What opacity depends on beside the value, as a sum: 1 the gradient, 2 curvature, 4 value and gradient together."""
        return (self.gradient_opacity is not None) + 2 * (self.curvature_opacity is not None)

    @cached_property
    def value_range(self) -> tuple[float, float]:
        """The smallest and the largest value of all points."""
        values = [p[0] for p in self.colors] + [p[0] for p in self.opacities]
        return min(values), max(values)

    def __call__(self, values: ArrayLike) -> NDArray[np.float64]:
        """Red, green, blue and opacity at `values`, without factors of opacity; shape (..., 4), exact."""
        exponent = exponent_of(*self.value_range)
        v = scaled(reals("values", values), exponent)
        rgb, at = np.array([p[1] for p in self.colors]), scaled([p[0] for p in self.colors], exponent)
        opacity, where = [p[1] for p in self.opacities], scaled([p[0] for p in self.opacities], exponent)
        return np.stack([*(np.interp(v, at, rgb[:, i]) for i in range(3)), np.interp(v, where, opacity)], -1)

    def table(self, stored: Stored = AS_THEY_ARE, *, linear: bool = False) -> NDArray[np.float32]:
        """The table for kernels, in addition to the block, for values stored as in `stored`; `linear`: of colours in linear light.

        Either equal nodes (red, green, blue, opacity), then for each the next node with some opacity; or, if
        the block has a number of pieces, the pieces, in rows of four numbers: colour and opacity at the start, their slopes, and
        (start, 1 - opacity there, its slope, the value up to which all is transparent from here on). A few pieces are followed
        by the starts of all but the first; many, by the piece at the start of each of the equal buckets or, if no
        bucket has two starts, by four numbers per bucket: that piece, its start, the next start, 0.
        """
        return _laid_out(self, stored, linear).table

    def block(self, unit: float, stored: Stored = AS_THEY_ARE, *, linear: bool = False) -> Values:
        """The block for kernels; `unit` is their unit of length in world units (the mean spacing). See `table`."""
        layout = _laid_out(self, stored, linear)
        return self.BLOCK(
            low=layout.low,
            scale=layout.scale,
            last=layout.last,
            per_unit_distance=unit / (self.unit_distance or unit),
            pieces=layout.pieces,
            halvings=layout.halvings,
        )

    def json(self) -> dict[str, Any]:
        """A value for `json.dumps`, as `save` writes it: colours and opacities as points of both."""
        return {"points": points_of(self.colors, self.opacities)} | self._shared_json()

    def _shared_json(self) -> dict[str, Any]:
        given = {name: part for name in FACTORS if (part := getattr(self, name)) is not None}
        unit = {} if self.unit_distance is None else {"unit_distance": self.unit_distance}
        return {name: [list(point) for point in points] for name, points in given.items()} | unit

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it as JSON, which `clvol.read_transfer`, `--transfer` of the shell and the viewer read; returns the path.

        `FormatError` if the file's name does not end in .json, or it cannot be written.
        """
        suffix = require_suffix(path, (".json",), "transfer functions")
        with staged(as_path(path), suffix) as file:
            file.write_text(json.dumps(self.json(), allow_nan=False) + "\n", encoding="utf-8")
        return as_path(path)

    def opacity_within(self, low: float, high: float) -> float:
        """The largest opacity of values from `low` to `high`."""
        at, opacity = (np.array(numbers) for numbers in zip(*self.opacities, strict=True))
        inner = opacity[(at >= low) & (at <= high)]
        return max([*map(float, np.interp([low, high], at, opacity)), *map(float, inner)])

    def with_opacity(self, opacities: Sequence[tuple[float, float]]) -> TransferFunction:
        """A copy with the same colours and other opacities."""
        return replace(self, opacities=opacities)  # type: ignore[arg-type]  # __post_init__ converts


def previewed(volume: Volume | ArrayLike) -> Volume:
    """The volume whose samples automatic functions are of: the preview of one that is read by parts."""
    whole: Any = volume
    return whole.preview() if is_in_parts(whole) else as_volume(volume)


def is_curve(opacity: object) -> bool:
    """Whether an opacity is a sequence, of pairs of value and opacity; else it is one number, or nothing that is allowed."""
    return np.ndim(np.asarray(opacity, dtype=object)) > 0


class _Layout(NamedTuple):
    """The function in the layout for kernels."""

    low: float
    scale: float  # cells or buckets per unit of value
    last: float  # index of the last node or bucket
    pieces: int  # 0 for equal nodes
    halvings: int  # steps of binary search within a bucket; 0 without buckets
    table: NDArray[np.float32]


@lru_cache(maxsize=64)
def _laid_out(transfer: TransferFunction, stored: Stored, linear: bool) -> _Layout:
    """See `TransferFunction.table`."""
    colors, opacities = (  # not `stored(...)`, because points may be outside the range of float32
        scaled([p[0] for p in points], stored.exponent) - math.ldexp(stored.offset, -stored.exponent)
        for points in (transfer.colors, transfer.opacities)
    )
    at = np.unique(np.concatenate([colors, opacities]))
    jumps = len(np.unique(colors)) < len(colors) or len(np.unique(opacities)) < len(opacities)
    faint = any(_NEARLY_OPAQUE < a < 1 for _, a in transfer.opacities)
    cells = 0 if jumps or faint else _equal_cells(at)
    if cells:
        nodes = _nodes(transfer, at, opacities, cells)
        if not linear:
            return _of_nodes(nodes, at)
        if np.abs(np.diff(nodes[:, :3], axis=0)).max() <= _SHADE:
            nodes[:, :3] = as_light(nodes[:, :3])
            return _of_nodes(nodes, at)
    shades = np.array([p[1] for p in transfer.colors])
    if linear:
        colors, shades = _between(colors, shades)
        shades = as_light(shades)
    return _of_pieces(colors, shades, opacities, np.array([p[1] for p in transfer.opacities]))


def _between(at: NDArray[np.float64], shades: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of the same function whose neighbours differ by `_SHADE` at most, but for jumps."""
    parts = np.where(at[1:] > at[:-1], np.ceil(np.abs(np.diff(shades, axis=0)).max(1) / _SHADE), 1).astype(np.int64)
    places = np.concatenate([k + np.arange(n) / n for k, n in enumerate(np.maximum(parts, 1))] + [np.array([len(at) - 1.0])])
    nodes = np.arange(len(at))
    halves = np.interp(places, nodes, at / 2)  # differences of points may overflow
    return 2 * halves, np.stack([np.interp(places, nodes, shade) for shade in shades.T], -1)


def _equal_cells(at: NDArray[np.float64]) -> int:
    """The largest number of equal cells whose edges include all points, at distinct edges; 0 if none, or beyond float32."""
    low, high = at[0], at[-1]
    if low == high:
        return _CELLS
    half = high / 2 - low / 2
    if not 1e-30 < half < _FAR / 2 or abs(np.float64(np.float32(low)) - low) / 2 > _LOOSE * half:
        return 0
    shares = (at / 2 - low / 2) / half
    cells = np.arange(_CELLS, 0, -1)
    places = shares[:, None] * cells
    nodes = np.round(places)
    # with distant end points, a few cells are so wide that several points between are close to one node
    fits = (np.abs(places - nodes).max(0) <= _ON_NODE) & (np.diff(nodes, axis=0).min(0) >= 1)
    return int(cells[fits.argmax()]) if fits.any() else 0


def _nodes(transfer: TransferFunction, at: NDArray[np.float64], opacities: NDArray[np.float64], cells: int) -> NDArray[np.float32]:
    """Colour and opacity at the edges of equal cells, shape (cells + 1, 4)."""
    exponent = exponent_of(*transfer.value_range)
    low, high = scaled(transfer.value_range, exponent)
    nodes = transfer(np.ldexp(np.linspace(low, high, cells + 1), exponent)).astype(np.float32)
    if (
        at[-1] > at[0]
    ):  # nodes are rounded, but what is transparent up to a point is so up to its node: bricks are skipped by points
        on = np.round((opacities / 2 - at[0] / 2) / (at[-1] / 2 - at[0] / 2) * cells).astype(np.int64)
        nodes[[n for n, (_, opacity) in zip(on, transfer.opacities, strict=True) if opacity == 0], 3] = 0
    return nodes


def _of_nodes(nodes: NDArray[np.float32], at: NDArray[np.float64]) -> _Layout:
    cells = len(nodes) - 1
    seen = np.where(nodes[:, 3] > 0, np.arange(len(nodes), dtype=np.float32), np.float32(np.inf))
    following = np.minimum.accumulate(seen[::-1])[::-1]
    scale = cells / (at[-1] - at[0]) if at[-1] > at[0] else 0.0
    return _Layout(float(at[0]), float(scale), float(cells), 0, 0, np.concatenate([nodes.ravel(), following]))


def _of_pieces(
    colors: NDArray[np.float64], shades: NDArray[np.float64], opacities: NDArray[np.float64], seen: NDArray[np.float64]
) -> _Layout:
    at = np.unique(np.clip(np.concatenate([colors, opacities]), -_FAR, _FAR))
    curves = [*((colors, shade) for shade in shades.T), (opacities, seen), (opacities, 1 - seen)]
    up_to = np.stack([_limit(at, *curve, -1) for curve in curves], -1)  # red, green, blue, opacity, 1 - opacity
    since = np.stack([_limit(at, *curve, 1) for curve in curves], -1)
    # a piece starts at the first float32 number that is not less than its point
    with np.errstate(under="ignore"):
        starts = at.astype(np.float32)
    starts = np.where(starts < at, np.nextafter(starts, np.float32(np.inf)), starts)
    slopes = np.zeros_like(since)
    with np.errstate(over="ignore"):
        slopes[:-1] = np.clip((up_to[1:] - since[:-1]) / np.diff(at)[:, None], -_STEEPEST, _STEEPEST)
    ends = np.concatenate([up_to[1:], since[-1:]])
    bases = np.clip(since + slopes * (starts - at)[:, None], np.minimum(since, ends), np.maximum(since, ends))
    some = np.maximum(since, ends)[:, 3] > 0
    clear_at = (since[:, 3] == 0) & (starts == at)  # transparent at the start itself
    # before the first point the function is constant; pieces between two successive float32 numbers have no value
    kept = np.append(starts[1:] > starts[:-1], True)
    starts, slopes, bases, some, clear_at = (
        np.concatenate([first, rest[kept]])
        for first, rest in (
            (starts[:1], starts),
            (np.zeros((1, 5)), slopes),
            (up_to[:1], bases),
            (up_to[:1, 3] > 0, some),
            (np.array([False]), clear_at),
        )
    )
    until = np.where(clear_at, starts, np.nextafter(starts, np.float32(-np.inf)))
    until[0] = np.finfo(np.float32).min
    count = len(starts)
    following = np.minimum.accumulate(np.where(some, np.arange(count), count)[::-1])[::-1]
    until = np.append(until, np.finfo(np.float32).max)[following]
    rows = np.stack([bases[:, :4], slopes[:, :4], np.stack([starts, bases[:, 4], slopes[:, 4], until], -1)], axis=1).astype(
        np.float32
    )
    low = np.float32(starts[0])
    if count <= _FEW:
        # no comparison with NaN is true, even for the infinities of bounds and of finished rays
        padded = np.append(starts[1:], [math.nan] * (-(count - 1) % _AT_ONCE)).astype(np.float32)
        return _Layout(float(low), 0.0, 0.0, count, 0, np.concatenate([rows.ravel(), padded]))
    last = np.float32(_CELLS - 1)
    scale = np.float32(min(_CELLS / (float(starts[-1]) - float(low)), _STEEPEST / 10))
    with np.errstate(over="ignore"):  # in float32, like kernels
        buckets = np.minimum((starts[1:] - low) * scale, last).astype(np.int64)
    first = np.searchsorted(buckets, np.arange(_CELLS), side="left")
    halvings = int(np.bincount(buckets).max()).bit_length()
    tail = first.astype(np.float32)
    if halvings == 1:
        following = np.append(starts, math.nan).astype(np.float32)[first + 1]
        tail = np.stack([tail, starts[first].astype(np.float32), following, np.zeros_like(following)], 1)
    return _Layout(float(low), float(scale), float(last), count, halvings, np.concatenate([rows.ravel(), tail.ravel()]))


def _limit(x: NDArray[np.float64], at: NDArray[np.float64], values: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """The piecewise linear function through points, at x from above (side 1) or from below (-1)."""
    exponent = exponent_of(at[0], at[-1])
    x, at = scaled(x, exponent), scaled(at, exponent)  # avoids overflow of differences
    return np.interp(x, at, values) if side > 0 else np.interp(-x, -at[::-1], values[::-1])


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
        raise OptionError(f"{what} must be pairs of a value and its color or opacity; got {points!r}") from None


def _value(value: object) -> float:
    return number("each value and opacity", value)
