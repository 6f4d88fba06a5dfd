"""Points of colour and opacity for kinds of data: automatic ones, and those of labels."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.volume.histogram import Matter, label_numbers, matter_of
from clvol.volume.volume import Volume

__all__ = ["Color", "Colors", "Opacities", "automatic", "diverging", "label_color", "of_labels", "shades", "unit_of"]

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
_ACROSS = 110  # smallest diagonal in units of length, as in a cube of 64 samples along each axis
_GOLDEN = 0.6180339887498949  # fraction of the hue circle per label: neighbouring numbers get distant hues, and no two the same
_TONES = ((0.62, 0.98), (0.85, 0.85), (0.42, 0.92))  # saturation and value, in turn


def automatic(volume: Volume, clim: tuple[float, float] | None = None) -> tuple[Colors, Opacities]:
    """What shows the matter of most volumes: see `TransferFunction.automatic`."""
    matter = matter_of(volume)
    least, most = volume.value_range
    if not least < most and clim is None:  # constant data: show it as fog
        return ((least, FOG if volume.color is None else volume.color),), ((least, 0.02),)
    sides = [(1, _FLESH if volume.color is None else shades(volume.color))]
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
    rise = _OF_SIGNED if matter.signed else _rise(start, middle, top)
    places = (foot, start + _RISE * (middle - start), middle, top)
    for side, tones in sides:
        colors += [(matter.value(d, side), c) for d, c in zip(places, tones, strict=True)]
        opacities += [(matter.value(d, side), a) for d, a in zip((foot, start, middle, top), rise, strict=True)]
    return tuple(sorted(colors, key=_by_value)), tuple(sorted(opacities, key=_by_value))


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
    """Each label in its colour, opaque, up to halfway to the next integer; the background is transparent."""
    background, numbers = label_numbers(volume)
    colors: list[tuple[float, Color]] = []
    opacities: list[tuple[float, float]] = []
    for number in numbers.tolist():
        opacity = float(number != background)
        for end in (number - 0.5, number + 0.5):
            colors.append((end, label_color(int(number)) if opacity else BLACK))
            opacities.append((end, opacity))
    return tuple(colors), tuple(opacities)


def label_color(number: int) -> Color:
    """The colour of a label, from its number only; neighbouring numbers have distinct colours."""
    return colorsys.hsv_to_rgb((0.02 + _GOLDEN * (number - 1)) % 1, *_TONES[number % len(_TONES)])


# -- inner -------------------------------------------------------------------------------------------------


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
