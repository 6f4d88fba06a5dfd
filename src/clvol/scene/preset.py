"""Points of colour and opacity for kinds of data: automatic ones, those of labels, and presets, named looks with one row each.

CT presets are in Hounsfield units: air is -1000, water 0, and bone about 200 and above; that of statistical maps is in units of t
or z. The others are relative to a volume's matter: 0 is where it starts to show, 1 its brightest value (`clvol.volume.histogram`).
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of, warn
from clvol.base.errors import OptionError
from clvol.base.shown import Named
from clvol.volume.histogram import Matter, label_numbers, matter_of, may_be_hounsfield
from clvol.volume.volume import Volume, table_of

__all__ = [
    "Color",
    "Colors",
    "Opacities",
    "Preset",
    "PresetTable",
    "as_preset",
    "automatic",
    "diverging",
    "label_color",
    "of_labels",
    "presets",
    "shades",
    "unit_of",
]

Color: TypeAlias = tuple[float, float, float]
Colors: TypeAlias = tuple[tuple[float, Color], ...]
Opacities: TypeAlias = tuple[tuple[float, float], ...]

BLACK: Color = (0.0, 0.0, 0.0)
FOG: Color = (0.9, 0.85, 0.75)
# at the foot, a seventh of the way up, at the middle and at the top of matter
_FLESH: tuple[Color, ...] = ((0.80, 0.49, 0.37), (0.97, 0.77, 0.63), (1.0, 0.91, 0.77), (1.0, 1.0, 0.97))
_WARM: tuple[Color, ...] = ((0.78, 0.14, 0.08), (0.96, 0.36, 0.16), (1.0, 0.70, 0.28), (1.0, 0.96, 0.66))
_COLD: tuple[Color, ...] = ((0.14, 0.30, 0.82), (0.22, 0.54, 1.0), (0.42, 0.80, 1.0), (0.84, 0.98, 1.0))
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
_DIMMEST = 0.25
_RISE = 0.15
_OPACITIES = (0.0, 0.12, 0.45, 0.88)  # at the foot, the start, the middle and the top of matter
_THIN = (0.0, 0.05, 0.30, 0.80)  # the same, if a small part of matter is much brighter than the rest
_EVEN = 0.15, 0.30  # the middle of matter, relative to its start and top, in that case and otherwise
_OF_SIGNED = (0.0, 0.12, 0.50, 0.90)  # for signed data, where matter is sparse
_T = (3.0, 3.5, 5.0, 8.0)  # t of nothing, of what is just seen, and of the brightest
_BOTH = (-1, _COLD), (1, _WARM)
_ACROSS = 110  # smallest diagonal in units of length, as in a cube of 64 samples along each axis
_GOLDEN = 0.6180339887498949  # fraction of the hue circle per label: neighbouring numbers get distant hues, and no two the same
_TONES = ((0.62, 0.98), (0.85, 0.85), (0.42, 0.92))  # saturation and value, in turn
_NAMED = 8  # labels in a message
_GREEN = (0.25, 0.95, 0.40)
_THIN_STACK = 0.25  # of its narrower side, up to which a stack is thin
_LIT = 0.5  # of the samples, what glows in the dark
_LOOKED_AT, _MANY = 1 << 12, 32  # samples, and distinct values among them; labels and masks have few
_CLEAN = 2e-4  # noise, relative to the range of matter, up to which samples were computed and not measured
_CUBED = 64  # half the edge of the part whose noise is estimated beside a background
_MEDIAN_OF_NORMAL = 0.6745  # of magnitudes, in standard deviations
_VIRIDIS: tuple[Color, ...] = (
    (0.27, 0.00, 0.33),
    (0.28, 0.18, 0.48),
    (0.23, 0.32, 0.55),
    (0.17, 0.45, 0.56),
    (0.13, 0.57, 0.55),
    (0.16, 0.68, 0.50),
    (0.37, 0.79, 0.38),
    (0.68, 0.86, 0.19),
    (0.99, 0.91, 0.14),
)
_HALF = (0.0, 0.005, 0.04, 0.16)  # so that values inside are seen


def automatic(volume: Volume, clim: tuple[float, float] | None = None) -> tuple[Colors, Opacities]:
    """What shows the matter of most volumes: see `TransferFunction.automatic`."""
    matter = matter_of(volume)
    least, most = volume.value_range
    if not least < most and clim is None:  # constant data: show it as fog
        return ((least, FOG if volume.color is None else volume.color),), ((least, 0.02),)
    computed = _is_computed(volume, matter)
    color = _GREEN if volume.color is None and _glows(volume, matter) else volume.color
    sides = [(1, shades(color) if color is not None else _VIRIDIS if computed else _FLESH)]
    if matter.signed:
        sides = [(1, _WARM), (-1, _COLD)]
    foot, start, middle, top = matter.foot, matter.start, matter.middle, matter.top
    if clim is not None:
        ends = sorted(matter.distance(value) for value in clim)
        if matter.signed and ends[0] < 0 < ends[1]:
            top = max(-ends[0], ends[1])
            foot, start, middle = (share * top for share in _spread(matter))
        else:
            if matter.signed and ends[1] <= 0:
                ends, sides = [-ends[1], -ends[0]], sides[1:]
            elif matter.signed:
                sides = sides[:1]
            foot, top = ends
            if matter.ground is not None:  # keep it invisible
                foot, top = (max(foot, 0.0), top) if top > 0 else (matter.foot, matter.start)
            start, middle = foot + 0.1 * (top - foot), foot + 0.5 * (top - foot)
    elif volume.clim is not None:
        foot, start, middle, top = _within(volume.clim, matter)
    colors: list[tuple[float, Color]] = []
    opacities: list[tuple[float, float]] = []
    rise = _OF_SIGNED if matter.signed else _HALF if computed else _rise(start, middle, top)
    places = np.linspace(foot, top, len(_VIRIDIS)).tolist() if computed else (foot, start + _RISE * (middle - start), middle, top)
    for side, tones in sides:
        colors += [(matter.value(d, side), c) for d, c in zip(places, tones, strict=True)]
        opacities += [(matter.value(d, side), a) for d, a in zip((foot, start, middle, top), rise, strict=True)]
    return tuple(sorted(colors, key=_by_value)), tuple(sorted(opacities, key=_by_value))


def _is_computed(volume: Volume, matter: Matter) -> bool:
    """Whether samples are of a simulation: many values without noise, of no patient, stack or channel."""
    if volume.data.dtype.kind != "f" or volume.space or volume.color is not None or volume.clim is not None or matter.signed:
        return False
    if len(np.unique(_some(volume))) < _MANY:
        return False
    sigma = volume.noise.sigma if matter.ground is None else _noise_beside(volume, matter.ground)
    return sigma <= _CLEAN * abs(matter.value(matter.top) - matter.value(0))


def _noise_beside(volume: Volume, ground: float) -> float:
    """The standard deviation of noise where no sample is the background, by second differences; inf if there is none.

    Most samples of a masked scan are its background, and say nothing of noise.
    """
    middle = tuple(slice(max(0, n // 2 - _CUBED), n // 2 + _CUBED) for n in volume.shape)
    data, whole = volume.data[middle].astype(np.float64), np.isfinite(volume.data[middle]) & (volume.data[middle] != ground)
    data[~whole] = 0
    for axis in range(data.ndim):
        data, ends = np.diff(data, 2, axis=axis), np.moveaxis(whole, axis, 0)
        whole = np.moveaxis(ends[2:] & ends[1:-1] & ends[:-2], 0, axis)
    return float(np.median(np.abs(data[whole]))) / (_MEDIAN_OF_NORMAL * 6 ** (data.ndim / 2)) if whole.any() else math.inf


def thinness(volume: Volume) -> float:
    """How thin a stack of images is, from 0 to 1; more for what is no thin stack."""
    if volume.space != "image" or volume.ndim != 3:
        return math.inf
    x, y, z = (n * length for n, length in zip(volume.size, volume.spacing, strict=True))
    return z / min(x, y) / _THIN_STACK


def _glows(volume: Volume, matter: Matter) -> bool:
    """Whether a thin stack of images is of light in the dark, as in a fluorescence microscope."""
    if thinness(volume) > 1 or matter.signed or matter.sign < 0:
        return False
    return float((_some(volume) > matter.value(matter.start)).mean()) < _LIT


def _some(volume: Volume) -> NDArray[Any]:
    step = max(1, round((volume.data.size / _LOOKED_AT) ** (1 / volume.ndim)))
    return volume.data[(slice(None, None, step),) * volume.ndim]


def unit_of(volume: Volume) -> float | None:
    """The world length that opacities refer to: None (the mean spacing), or less if few samples would be too transparent."""
    unit = 2 * volume.radius / _ACROSS
    return unit if unit < volume.mean_spacing else None


def diverging(clim: tuple[float, float], middle: float) -> Colors:
    """Black in the middle, ever brighter above and below, in two colours; as far to either side as `clim` on its wider one."""
    matter = max(clim[1] - middle, middle - clim[0])
    warm = [(middle + share * matter, color) for share, color in zip((0.25, 0.5, 0.75, 1.0), _WARM, strict=True)]
    cold = [(middle - share * matter, color) for share, color in zip((0.25, 0.5, 0.75, 1.0), _COLD, strict=True)]
    return (*reversed(cold), (middle, BLACK), *warm)


def shades(color: Sequence[float]) -> tuple[Color, ...]:
    """Four shades of a colour, from dark to nearly white; pure blue, which hides shadows, is slightly paler."""
    rgb = np.asarray(color, dtype=np.float64)
    luminance = float(rgb @ _LUMINANCE)
    rgb = rgb + max(0.0, (_DIMMEST - luminance) / max(1 - luminance, _DIMMEST)) * (1 - rgb)
    rows: list[NDArray[np.float64]] = [0.6 * rgb, 0.8 * rgb, rgb, rgb + 0.6 * (1 - rgb)]
    return tuple((float(r), float(g), float(b)) for r, g, b in (np.clip(row, 0, 1) for row in rows))


def of_labels(volume: Volume) -> tuple[Colors, Opacities]:
    """Each label in the colour and opacity of its row, up to halfway to the next integer; the background is transparent.

    Without a row it has the colour of `label_color` and is opaque. A warning says so, if the table has more colours than half of
    the labels that occur: fewer are of some that are to stand out.
    """
    background, numbers = label_numbers(volume)
    own = table_of(volume)
    shades, seen = own.colors, own.opacities
    colors: list[tuple[float, Color]] = []
    opacities: list[tuple[float, float]] = []
    missing: list[int] = []
    for label in map(int, numbers.tolist()):
        opacity = 0.0 if label == background else seen.get(label, 1.0)
        if opacity and shades and label not in shades:
            missing.append(label)
        color = shades.get(label) or label_color(label)
        for end in (label - 0.5, label + 0.5):
            colors.append((end, color if opacity else BLACK))
            opacities.append((end, opacity))
    if missing and 2 * len(shades) > len(numbers):
        some = ", ".join(map(str, missing[:_NAMED])) + (", ..." if len(missing) > _NAMED else "")
        warn(f"the table of labels has no color for {len(missing)} of those that occur: {some}; they have colors for their numbers")
    return tuple(colors), tuple(opacities)


def label_color(number: int, volume: Volume | None = None) -> Color:
    """The colour of a label: that of the volume's table, else one for its number; neighbouring numbers have distinct colours."""
    if volume is not None and number in (given := table_of(volume).colors):
        return given[number]
    return colorsys.hsv_to_rgb((0.02 + _GOLDEN * (number - 1)) % 1, *_TONES[number % len(_TONES)])


def _rise(start: float, middle: float, top: float) -> tuple[float, ...]:
    """Opacities at the foot, the start, the middle and the top; higher if values are spread evenly."""
    share = float(np.interp((middle - start) / (top - start), _EVEN, (0.0, 1.0))) if top > start else 1.0
    return tuple((1 - share) * thin + share * dense for thin, dense in zip(_THIN, _OPACITIES, strict=True))


def _spread(matter: Matter) -> tuple[float, float, float]:
    """The foot, the start and the middle, relative to the top."""
    return matter.foot / matter.top, matter.start / matter.top, matter.middle / matter.top


def _within(clim: tuple[float, float], matter: Matter) -> tuple[float, float, float, float]:
    """Foot, start, middle and top for the `clim` of the source: background stays unseen."""
    low, high = sorted(matter.distance(value) for value in clim)
    if matter.signed:
        if low < 0:
            low, high = 0.0, max(-low, high)
        start = max(low, matter.start * min(high / matter.top, 1.0)) if low == 0 else low
        foot = matter.foot / matter.start * start
    elif high <= matter.start or low >= matter.top:  # no matter is within the window
        return matter.foot, matter.start, matter.middle, matter.top
    else:
        start, foot = max(low, matter.start), max(low, matter.foot)
    return foot, start, min(max(matter.middle, start), (start + high) / 2), high


def _by_value(point: tuple[float, object]) -> float:
    return point[0]


# -- presets ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Preset:
    """A named look.

    Parameters
    ----------
    name, description : str
    unit : {"HU", "t", "matter", "labels"}
        Unit of the values below: Hounsfield units, t or z, relative to the volume's matter, or "labels", which has no values.
    colors, opacities : tuple of (value, color), tuple of (value, opacity)
        Without colours they are shades of the volume's own `color`, or of green.
    clim : (float, float)
        What projections show from black to white.
    """

    name: str
    description: str
    unit: Literal["HU", "t", "matter", "labels"]
    colors: Colors = ()
    opacities: Opacities = ()
    clim: tuple[float, float] = (0.0, 1.0)

    def points(self, volume: Volume, clim: tuple[float, float] | None = None) -> tuple[Colors, Opacities]:
        """The colours and opacities for a volume, in units of its data; moved from its own `clim` to the one given, if any.

        Raises
        ------
        OptionError
            `clim` is given for labels.

        Warns
        -----
        ClvolWarning
            The preset is in Hounsfield units, but the data cannot be: its points are then spread over the volume's matter.
        """
        if self.unit == "labels":
            if clim is not None:
                given = (clim[0] + clim[1]) / 2, clim[1] - clim[0]
                raise OptionError(f"window must not be given for the preset 'labels', whose colours are one for each; got {given}")
            if not volume.is_labels:
                warn("preset 'labels' is for labels, and the samples look like none: each is taken for the label nearest to it")
            return of_labels(volume)
        colors = self.colors
        if not colors:
            own = shades(_GREEN if volume.color is None else volume.color)
            colors = tuple((i / (len(own) - 1), color) for i, color in enumerate(own))
        first, last = self._placed(volume, clim)
        low, high = self.clim

        def value(point: float) -> float:
            return first + (last - first) * (point - low) / (high - low)

        ends = slice(None, None, 1 if first < last else -1)
        opacities = tuple((value(p), a) for p, a in self.opacities)[ends]
        least, most = volume.value_range
        at, seen = zip(*opacities, strict=True)
        if clim is None and not np.interp([least, most, *np.clip(at, least, most)], at, seen).any():
            shown = " and ".join(f"{p:g}" for p in sorted((p for p, a in opacities if a > 0), key=abs)[: 1 + (at[0] < 0 < at[-1])])
            warn(
                f"preset {self.name!r} shows values from about {shown} on, and samples are from {least:g} to {most:g}: "
                "nothing is seen; window=(center, width) sets the range"
            )
        return tuple((value(p), c) for p, c in colors)[ends], opacities

    def span(self, volume: Volume) -> tuple[float, float]:
        """Its `clim` for a volume, in units of the data and in ascending order; warns as `points` does."""
        first, last = sorted(self._placed(volume, None))
        return first, last

    def _placed(self, volume: Volume, clim: tuple[float, float] | None) -> tuple[float, float]:
        """Where the ends of its `clim` lie."""
        if clim is not None:
            return clim
        if self.unit == "t" or (self.unit == "HU" and may_be_hounsfield(volume)):
            return self.clim
        matter = matter_of(volume)
        low, high = self.clim
        if self.unit == "HU":
            least, most = volume.value_range
            warn(
                f"preset {self.name!r} is in Hounsfield units, in which air is -1000 and water 0, and samples from {least:g} to "
                f"{most:g} are not: its points were spread over the matter; window=(center, width) sets the range"
            )
            low, high = 0.0, 1.0
        foot, top = (matter.foot, matter.top) if matter.top > matter.foot else (matter.foot - 0.5, matter.foot + 0.5)
        return matter.value(foot + low * (top - foot)), matter.value(foot + high * (top - foot))


_ROWS = (
    Preset(
        "ct-bone",
        "CT: bone, and metal",
        "HU",
        ((150, (0.58, 0.25, 0.15)), (300, (0.86, 0.62, 0.42)), (600, (0.96, 0.88, 0.74)), (1500, (1.0, 1.0, 0.98))),
        ((150, 0.0), (300, 0.15), (600, 0.50), (1500, 0.90)),
        (150, 1500),
    ),
    Preset(
        "ct-soft-tissue",
        "CT: muscle and organs behind faint fat, and bone",
        "HU",
        (
            (-160, (0.80, 0.62, 0.34)),
            (-60, (0.94, 0.80, 0.52)),
            (20, (0.80, 0.36, 0.28)),
            (90, (0.90, 0.50, 0.38)),
            (240, (0.99, 0.93, 0.83)),
        ),
        ((-160, 0.0), (-60, 0.01), (20, 0.10), (90, 0.25), (240, 0.70)),
        (-160, 240),
    ),
    Preset(
        "ct-lung",
        "CT: the surface of lungs and airways",
        "HU",
        ((-900, (0.35, 0.55, 0.80)), (-700, (0.62, 0.76, 0.92)), (-450, (0.97, 0.80, 0.74)), (-300, (1.0, 0.94, 0.90))),
        ((-900, 0.0), (-700, 0.06), (-550, 0.35), (-400, 0.35), (-300, 0.0)),
        (-1350, 150),
    ),
    Preset(
        "ct-skin",
        "CT: the skin, against the air",
        "HU",
        ((-500, (0.70, 0.42, 0.32)), (-200, (0.90, 0.66, 0.54)), (100, (0.98, 0.84, 0.74)), (1000, (1.0, 1.0, 0.98))),
        ((-500, 0.0), (-300, 0.20), (-100, 0.80), (100, 0.95)),
        (-500, 500),
    ),
    Preset(
        "ct-angiography",
        "CT: vessels with contrast medium, and bone",
        "HU",
        ((100, (0.55, 0.08, 0.06)), (250, (0.90, 0.28, 0.16)), (400, (0.99, 0.72, 0.48)), (700, (1.0, 0.96, 0.88))),
        ((100, 0.0), (180, 0.12), (300, 0.55), (700, 0.85)),
        (0, 600),
    ),
    Preset(
        "mr-default",
        "MR: all tissue in neutral tones",
        "matter",
        ((0.0, (0.48, 0.42, 0.40)), (0.2, (0.74, 0.66, 0.61)), (0.5, (0.92, 0.88, 0.84)), (1.0, (1.0, 1.0, 1.0))),
        ((0.0, 0.0), (0.15, 0.05), (0.4, 0.30), (1.0, 0.80)),
    ),
    Preset(
        "mr-angiography",
        "MR: the brightest, such as flowing blood; also for the mode mip",
        "matter",
        ((0.35, (0.60, 0.10, 0.07)), (0.6, (0.95, 0.40, 0.22)), (1.0, (1.0, 0.95, 0.85))),
        ((0.35, 0.0), (0.55, 0.15), (0.75, 0.60), (1.0, 0.95)),
        (0.1, 1.0),
    ),
    Preset(
        "fluorescence",
        "microscopy: light that adds up, in the channel's colour",
        "matter",
        (),
        ((0.0, 0.0), (0.15, 0.06), (0.5, 0.30), (1.0, 0.80)),
    ),
    Preset(
        "x-ray",
        "transparent throughout; also for the mode mean",
        "matter",
        ((0.0, (0.55, 0.62, 0.70)), (1.0, (1.0, 1.0, 1.0))),
        ((0.0, 0.0), (0.3, 0.01), (1.0, 0.08)),
    ),
    Preset(
        "stat-map",
        "statistical maps: t or z beyond 3, warm above and cold below",
        "t",
        tuple((sign * at, color) for sign, row in _BOTH for at, color in zip(_T[::sign], row[::sign], strict=True)),
        tuple((sign * at, a) for sign, _ in _BOTH for at, a in zip(_T[::sign], _OF_SIGNED[::sign], strict=True)),
        (0, 8),
    ),
    Preset("labels", "each label in its colour, opaque; nothing for the background", "labels"),
)
_TABLE = {row.name: row for row in _ROWS}


class PresetTable(Named[Preset]):
    """Presets by name, shown as a table."""

    HEADER = ("preset", "for", "unit")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per preset, in the order of `HEADER`."""
        return [(name, row.description, row.unit) for name, row in self.items()]


def presets() -> PresetTable:
    """The presets by name, with their uses when shown.

    Examples
    --------
    >>> import clvol
    >>> "ct-bone" in clvol.presets()
    True
    """
    return PresetTable(_TABLE)


def as_preset(name: str) -> Preset:
    """The preset of a name."""
    if not isinstance(name, str) or name not in _TABLE:
        raise one_of("preset", name, _TABLE)
    return _TABLE[name]
