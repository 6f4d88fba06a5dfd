"""What objects show of themselves in notebooks: tables, slices and curves, as HTML and SVG with every text escaped.

The objects' own ``_repr_html_`` say what is shown; here is how. Nothing here needs a device.
"""

from __future__ import annotations

import base64
import html
import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.show.picture import to_png

__all__ = [
    "Named",
    "beside",
    "curve",
    "facts",
    "histogram",
    "image",
    "in_window",
    "numbers",
    "slices",
    "strip",
    "table",
    "text_table",
]

Row = TypeVar("Row")
_SIDE = 160  # pixels of a slice's longer side
_TAILS = (0.5, 99.5)  # percentiles of what slices show, where no window is known
_WIDTH, _HEIGHT = 360, 120  # of curves
_MARGIN = 14  # around curves, for numbers
_BINS = 90  # of histograms
_COUNTED = 1 << 18  # samples that a histogram is made of, about
_INK = "currentColor"  # of the notebook's theme
_LINE = "#1769c2"
_NUMBER = re.compile(r"[-–]|[-+]?[\d.,]+(e[-+]?\d+)?( ?%)?")  # a dash: there is none
_PLANES = {"LPS": ("axial", "coronal", "sagittal"), "": ("xy", "xz", "yz")}
_DOWN = {"LPS": (1, -1), "image": (1, 1), "": (-1, -1)}  # whether rows of a picture run along y, and along z, or against it


# -- tables --------------------------------------------------------------------------------------------------


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; columns of numbers are aligned to the right."""
    rows = [tuple(row) for row in rows]
    right = [all(_NUMBER.fullmatch(cell) for cell in column) for column in zip(*rows, strict=True)] or [False] * len(header)
    head = "".join(f"<th{_side(right[i])}>{html.escape(cell)}</th>" for i, cell in enumerate(header))
    body = "".join(
        f"<tr>{''.join(f'<td{_side(right[i])}>{html.escape(cell)}</td>' for i, cell in enumerate(row))}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def text_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The same for a terminal."""
    lines = [tuple(header), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


class Named(dict[str, Row]):
    """Rows by name; shown, it is a table."""

    HEADER: ClassVar[tuple[str, ...]]

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of texts a row, in the order of `HEADER`."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return text_table(self.HEADER, self.rows())

    def _repr_html_(self) -> str:
        return table(self.HEADER, self.rows())


def facts(title: str, values: Mapping[str, str]) -> str:
    """What is known of an object, one line each; empty values are left out."""
    rows = "".join(
        f"<tr><th{_side(False)}>{html.escape(key)}</th><td{_side(False)}>{html.escape(value)}</td></tr>"
        for key, value in values.items()
        if value
    )
    return f"<div><strong>{html.escape(title)}</strong><table><tbody>{rows}</tbody></table></div>"


def beside(*parts: str) -> str:
    """Parts side by side, below each other where there is no room."""
    return f'<div style="display:flex;flex-wrap:wrap;gap:12px;align-items:flex-start">{"".join(parts)}</div>'


def numbers(values: Iterable[float], between: str = " × ") -> str:
    """Numbers as people read them."""
    return between.join(f"{v:.6g}" for v in values)


def _side(right: bool) -> str:
    return f' style="text-align:{"right" if right else "left"}"'


# -- pictures ------------------------------------------------------------------------------------------------


def image(picture: ArrayLike, caption: str = "") -> str:
    """A picture and a line beneath it, both in the text of the page."""
    data = base64.b64encode(to_png(picture)).decode("ascii")
    words = html.escape(caption)
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{data}" alt="{words}">'
        f'<figcaption style="text-align:center;font-size:smaller">{words}</figcaption></figure>'
    )


def slices(
    data: NDArray[Any],
    spacing: Sequence[float],
    direction: NDArray[np.float64],
    *,
    space: str = "",
    window: tuple[float, float] | None = None,
    color: tuple[float, float, float] | None = None,
    blended: bool = True,
    all_planes: bool = True,
) -> list[tuple[str, NDArray[np.uint8]]]:
    """The middle slices of a volume across its axes, each with the name of its plane; an image itself.

    They are turned as `space` says: a patient's as radiologists see them, stacks of images as microscopes show them, else with y
    and z up. Voxels are as long and wide as `spacing` says.

    Parameters
    ----------
    data : ndarray, shape (nz, ny, nx) or (ny, nx)
        Samples.
    spacing, direction
        As of `Volume`.
    space : str
        As of `Volume`.
    window : (float, float), optional
        What is black and what is white; by default what all but a hundredth of the slices' samples lie between.
    color : (float, float, float), optional
        In place of white.
    blended : bool
        Whether there is something between samples; not so for labels.
    all_planes : bool
        False: only the first, across z.
    """
    if data.ndim == 2:
        return [("", _sized(_shades([data], window, color)[0], spacing, blended))]
    axes, signs = _towards_world(direction)
    turned = data.transpose([2 - axes[2], 2 - axes[1], 2 - axes[0]])  # arrays are indexed [z, y, x]
    turned = turned[tuple(slice(None, None, signs[k]) for k in (2, 1, 0))]
    x, y, z = (spacing[k] for k in axes)
    along_y, along_z = (slice(None, None, step) for step in _DOWN[space])
    middle = [n // 2 for n in turned.shape]
    cut = [
        (turned[middle[0]][along_y], (x, y)),
        (turned[:, middle[1]][along_z], (x, z)),
        (turned[:, :, middle[2]][along_z], (y, z)),
    ]
    names = _PLANES.get(space, _PLANES[""])
    shades = _shades([part for part, _ in (cut if all_planes else cut[:1])], window, color)
    return [(name, _sized(shade, sides, blended)) for name, shade, (_, sides) in zip(names, shades, cut, strict=False)]


def in_window(values: ArrayLike, low: float, high: float) -> NDArray[np.float64]:
    """Values from 0 where they are `low` to 1 where they are `high`; NaN is 0."""
    array = np.nan_to_num(np.asarray(values, np.float64), nan=low, posinf=high, neginf=low)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.clip(np.nan_to_num((array / 2 - low / 2) / (high / 2 - low / 2)), 0, 1))


def _towards_world(direction: NDArray[np.float64]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """For the world's x, y and z: the axis of the samples that runs most along it, and whether with it (1) or against it (-1)."""
    axes = max(itertools.permutations(range(3)), key=lambda p: sum(abs(direction[i, p[i]]) for i in range(3)))
    return axes, tuple(1 if direction[i, axes[i]] >= 0 else -1 for i in range(3))


def _shades(
    parts: Sequence[NDArray[Any]], window: tuple[float, float] | None, color: tuple[float, float, float] | None
) -> list[NDArray[np.uint8]]:
    """Slices in eight bits, grey or in a colour."""
    if window is None:
        values = np.concatenate([part.ravel() for part in parts]).astype(np.float64)
        values = values[np.isfinite(values)]
        low, high = (float(v) for v in np.percentile(values, _TAILS)) if values.size else (0.0, 1.0)
        if not low < high and values.size:  # few samples are not background
            low, high = float(values.min()), float(values.max())
        window = (low, high) if low < high else (low - 1, low)
    grey = [in_window(part, *window) for part in parts]
    shades = grey if color is None else [part[..., None] * np.asarray(color) for part in grey]
    return [np.asarray(np.rint(shade * 255), np.uint8) for shade in shades]


def _sized(picture: NDArray[np.uint8], sides: Sequence[float], blended: bool) -> NDArray[np.uint8]:
    """A slice whose pixels are square, its longer side of one length; `sides` are those of its voxels, (width, height)."""
    from PIL import Image

    height, width = picture.shape[0] * sides[1], picture.shape[1] * sides[0]
    scale = _SIDE / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    method = Image.Resampling.BICUBIC if blended else Image.Resampling.NEAREST
    return np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize(size, method))


# -- curves --------------------------------------------------------------------------------------------------


def curve(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    """A function as a line over its axis, with the ends of both."""
    low, high = min(0.0, float(y.min())), max(float(y.max()), 0.0)
    place = _Placed(float(x[0]), float(x[-1]), low, high if high > low else low + 1)
    axis = f'<line x1="0" x2="{_WIDTH}" y1="{place.y(0):.1f}" y2="{place.y(0):.1f}" stroke="{_INK}" stroke-opacity="0.3"/>'
    points = " ".join(f"{place.x(a):.1f},{place.y(b):.1f}" for a, b in zip(x, y, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="{_LINE}" stroke-width="2" stroke-linejoin="round"/>'
    words = _word(4, 10, f"{high:.4g}", "start") + _word(4, _HEIGHT, f"{x[0]:.4g}", "start")
    return _svg(axis + line + words + _word(_WIDTH - 4, _HEIGHT, f"{x[-1]:.4g}", "end"))


def histogram(data: NDArray[Any], low: float, high: float) -> str:
    """How many samples have which value, between the smallest and the largest; of every few samples of a large array.

    Heights are logarithms: the background would leave nothing else to see.
    """
    each = max(1, math.ceil((data.size / _COUNTED) ** (1 / max(1, data.ndim))))
    values = data[(slice(None, None, each),) * data.ndim].astype(np.float64).ravel()
    values = values[np.isfinite(values)]
    discrete = data.dtype.kind in "biu" and high - low < _BINS  # a bar for each value
    bins = int(high - low) + 1 if discrete else _BINS
    first, last = (low - 0.5, high + 0.5) if discrete else (low, high)
    if first < last:
        place = np.clip((values / 2 - first / 2) / (last / 2 - first / 2) * bins, 0, bins - 1).astype(np.int64)
        counts = np.bincount(place, minlength=bins)
    else:
        counts = np.full(1, values.size)
    heights = np.log1p(counts)
    heights = heights / (heights.max() or 1.0) * (_HEIGHT - 2 * _MARGIN)
    wide = _WIDTH / len(counts)
    bars = "".join(
        f"M{i * wide:.1f} {_HEIGHT - _MARGIN}v{-h:.1f}h{wide:.1f}V{_HEIGHT - _MARGIN}z" for i, h in enumerate(heights) if h
    )
    words = _word(0, _HEIGHT, f"{low:.6g}", "start") + _word(_WIDTH, _HEIGHT, f"{high:.6g}", "end")
    return _svg(f'<path d="{bars}" fill="{_LINE}" fill-opacity="0.6"/>{words}')


def strip(values: Sequence[float], colors: Sequence[Sequence[float]], opacities: Sequence[tuple[float, float]]) -> str:
    """A transfer function: its colours from the lowest value to the highest, beneath the curve of its opacity.

    Parameters
    ----------
    values, colors : sequence
        Values in ascending order, and the colour at each, three numbers in 0..1.
    opacities : sequence of (value, opacity)
        Points of the curve, likewise.
    """
    ends = [*values, *(v for v, _ in opacities)]
    low, high = min(ends), max(ends)
    place = _Placed(low, high if high > low else low + 1, 0.0, 1.0)
    stops = "".join(
        f'<stop offset="{place.share(v):.4f}" stop-color="#{"".join(f"{round(255 * c):02x}" for c in color)}"/>'
        for v, color in zip(values, colors, strict=True)
    )
    name = f"clvol-{abs(hash((tuple(values), tuple(map(tuple, colors))))):x}"  # of the page, on which there may be several
    first, last = opacities[0], opacities[-1]
    points = [(low, first[1]), *opacities, (place.high, last[1])]
    line = " ".join(f"{place.x(v):.1f},{place.y(a):.1f}" for v, a in points)
    under = f"0,{place.y(0):.1f} {line} {_WIDTH},{place.y(0):.1f}"
    base = place.y(0) + 2
    return _svg(
        f'<defs><linearGradient id="{name}">{stops}</linearGradient></defs>'
        f'<polygon points="{under}" fill="url(#{name})" fill-opacity="0.75"/>'
        f'<polyline points="{line}" fill="none" stroke="{_INK}" stroke-width="1.5"/>'
        f'<rect x="0" y="{base:.1f}" width="{_WIDTH}" height="12" fill="url(#{name})"/>'
        + _word(0, _HEIGHT + 8, f"{low:.6g}", "start")
        + _word(_WIDTH, _HEIGHT + 8, f"{place.high:.6g}", "end"),
        _HEIGHT + 12,
    )


class _Placed:
    """Where values lie in a curve's picture."""

    def __init__(self, low: float, high: float, bottom: float, top: float) -> None:
        self.low, self.high, self.bottom, self.top = low, high, bottom, top

    def share(self, value: float) -> float:
        return float((value / 2 - self.low / 2) / (self.high / 2 - self.low / 2))

    def x(self, value: float) -> float:
        return _WIDTH * self.share(value)

    def y(self, value: float) -> float:
        return _MARGIN + (_HEIGHT - 2 * _MARGIN) * (self.top - value) / (self.top - self.bottom)


def _word(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="10" fill="{_INK}">{html.escape(text)}</text>'


def _svg(content: str, height: int = _HEIGHT + 2) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}" viewBox="0 0 {_WIDTH} {height}" '
        f'font-family="sans-serif">{content}</svg>'
    )
