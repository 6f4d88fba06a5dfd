"""Tables, facts and curves as HTML and SVG, every text escaped; and the texts of pages."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.printable import printable

__all__ = ["beside", "curve", "escape", "facts", "histogram", "numbers", "static", "strip", "table", "text_table"]

_WIDTH, _HEIGHT = 360, 120  # size of a curve, in pixels
_MARGIN = 14  # pixels around a curve, for its numbers
_BINS = 90  # bins of a histogram
_COUNTED = 1 << 18  # approximate number of samples that a histogram counts
_INK = "currentColor"  # follows the notebook's theme
_LINE = "#1769c2"
_NUMBER = re.compile(r"[-–]|[-+]?[\d.,]+(e[-+]?\d+)?( ?%)?")  # a dash means no value


def escape(text: str) -> str:
    """A text for HTML, without control characters."""
    return html.escape(printable(text))


def static(package: str, *names: str) -> str:
    """Files of the folder ``static`` of a package, joined to one text."""
    folder = resources.files(package) / "static"
    return "\n".join((folder / name).read_text(encoding="utf-8") for name in names)


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; columns of numbers are right-aligned."""
    rows = [tuple(row) for row in rows]
    right = [all(_NUMBER.fullmatch(cell) for cell in column) for column in zip(*rows, strict=True)] or [False] * len(header)
    head = "".join(f"<th{_side(right[i])}>{escape(cell)}</th>" for i, cell in enumerate(header))
    body = "".join(f"<tr>{''.join(f'<td{_side(right[i])}>{escape(cell)}</td>' for i, cell in enumerate(row))}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def text_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for the terminal."""
    lines = [tuple(map(printable, row)) for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def facts(title: str, values: Mapping[str, str]) -> str:
    """Facts about an object, one per line; empty values are left out."""
    rows = "".join(
        f"<tr><th{_side(False)}>{escape(key)}</th><td{_side(False)}>{escape(value)}</td></tr>"
        for key, value in values.items()
        if value
    )
    return f"<div><strong>{escape(title)}</strong><table><tbody>{rows}</tbody></table></div>"


def beside(*parts: str) -> str:
    """Parts side by side; they wrap where the page is narrow."""
    return f'<div style="display:flex;flex-wrap:wrap;gap:12px;align-items:flex-start">{"".join(parts)}</div>'


def numbers(values: Iterable[float], between: str = " × ") -> str:
    """Format numbers for people."""
    return between.join(f"{v:.6g}" for v in values)


def _side(right: bool) -> str:
    return f' style="text-align:{"right" if right else "left"}"'


def curve(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    """The plot of a function, labelled with the limits of both axes."""
    low, high = min(0.0, float(y.min())), max(float(y.max()), 0.0)
    place = _Placed(float(x[0]), float(x[-1]), low, high if high > low else low + 1)
    axis = f'<line x1="0" x2="{_WIDTH}" y1="{place.y(0):.1f}" y2="{place.y(0):.1f}" stroke="{_INK}" stroke-opacity="0.3"/>'
    points = " ".join(f"{place.x(a):.1f},{place.y(b):.1f}" for a, b in zip(x, y, strict=True))
    line = f'<polyline points="{points}" fill="none" stroke="{_LINE}" stroke-width="2" stroke-linejoin="round"/>'
    words = _word(4, 10, f"{high:.4g}", "start") + _word(4, _HEIGHT, f"{x[0]:.4g}", "start")
    return _svg(axis + line + words + _word(_WIDTH - 4, _HEIGHT, f"{x[-1]:.4g}", "end"))


def histogram(data: NDArray[Any], low: float, high: float) -> str:
    """The histogram of samples between the smallest and the largest; subsamples a large array.

    Heights are logarithmic, because the background would dwarf everything else.
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
    """A transfer function: a strip of its colours from the lowest value to the highest, and the curve of its opacity.

    Each of the ascending `values` has a colour, three numbers in 0..1; `opacities` are the points (value, opacity) of the curve.
    """
    ends = [*values, *(v for v, _ in opacities)]
    low, high = min(ends), max(ends)
    place = _Placed(low, high if high > low else low + 1, 0.0, 1.0)
    stops = "".join(
        f'<stop offset="{place.share(v):.4f}" stop-color="#{"".join(f"{round(255 * c):02x}" for c in color)}"/>'
        for v, color in zip(values, colors, strict=True)
    )
    name = f"clvol-{abs(hash((tuple(values), tuple(map(tuple, colors))))):x}"  # ids must be unique on the page
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
    """Maps values to pixels of a curve's plot."""

    def __init__(self, low: float, high: float, bottom: float, top: float) -> None:
        self.low, self.high, self.bottom, self.top = low, high, bottom, top

    def share(self, value: float) -> float:
        return float((value / 2 - self.low / 2) / (self.high / 2 - self.low / 2))

    def x(self, value: float) -> float:
        return _WIDTH * self.share(value)

    def y(self, value: float) -> float:
        return _MARGIN + (_HEIGHT - 2 * _MARGIN) * (self.top - value) / (self.top - self.bottom)


def _word(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="10" fill="{_INK}">{escape(text)}</text>'


def _svg(content: str, height: int = _HEIGHT + 2) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}" viewBox="0 0 {_WIDTH} {height}" '
        f'font-family="sans-serif">{content}</svg>'
    )
