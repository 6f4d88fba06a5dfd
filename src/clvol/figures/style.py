"""The style of figures: one colour and one name for each filter. matplotlib is imported only when needed."""

from __future__ import annotations

import colorsys
import io
import math
import os
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.analysis import EXACT_SINC
from clvol.base.checks import as_path
from clvol.base.color import color_of
from clvol.base.errors import OptionError
from clvol.base.files import require_suffix, staged
from clvol.filter.table import as_filter, filters
from clvol.show import picture
from clvol.show.furniture import require_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

__all__ = [
    "FAINT",
    "GAP",
    "GREY",
    "INK",
    "LETTERS",
    "LINE",
    "SUFFIXES",
    "Drawing",
    "colour",
    "folded",
    "label_ends",
    "legend_above",
    "new_figure",
    "placed",
    "plain",
    "plain_digits",
    "require_matplotlib",
    "show",
    "spread",
    "styled",
    "tiles",
    "title",
]


INK, GREY, FAINT = "#222222", "#6f6f6f", "#d9d9d9"
LETTERS = "abcdefghijklmnopqrstuvwxyz"
"""Names of the panels, one for each filter, and so the most filters of a figure."""

LINE, GAP = 27, 8
"""Pixels of the file: height of a line of text, and the gap between pictures (`tiles`)."""

SUFFIXES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".tif", ".tiff")
_DPI = 150
_LETTERS = 0.08  # of a heading above a picture, per pixel of its width
_LEAST_TILE = 160  # pixels of the file; least width of a picture
_RC: Mapping[str, Any] = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": "#9a9a9a",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8e8e8",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "legend.frameon": False,
}

_FILTERS = {  # a colour and a title
    EXACT_SINC: ("#5b5b5b", "sinc, exact"),
    "sinc": ("#8a8a8a", "sinc, cut off at 4 samples"),
    "nearest": ("#b07d4f", "nearest neighbour"),
    "bspline3-approx": ("#2a9d8f", "B-spline approximation"),
    "linear": ("#e9a100", "linear"),
    "mitchell": ("#c2549d", "Mitchell B = C = 1/3"),
    "catmull-rom": ("#58a032", "Catmull–Rom"),
    "hybrid": ("#7a5cc2", "hybrid, ×2 then linear"),
    "omoms3": ("#d1495b", "O-MOMS, cubic"),
    "bspline2": ("#7fb2e5", "bspline2"),
    "bspline3": ("#1769c2", "B-spline interpolation"),
    "bspline3(auto)": ("#d6006c", "bspline3(auto)"),
    "bspline4": ("#12508f", "bspline4"),
    "bspline5": ("#0b2f57", "bspline5"),
    "bspline2-approx": ("#7cc7bc", "bspline2-approx"),
    "bspline4-approx": ("#1d7268", "bspline4-approx"),
    "bspline5-approx": ("#124a43", "bspline5-approx"),
    "lanczos2": ("#e08a76", "lanczos2"),
    "lanczos3": ("#cf6a52", "lanczos3"),
    "lanczos4": ("#b04d36", "lanczos4"),
    "lanczos5": ("#8c3521", "lanczos5"),
    "lanczos3n": ("#9c2f6f", "Lanczos, 3 samples"),
    "sinc4n": ("#6b7a3a", "sinc, 4 samples, normalized"),
    "moms3": ("#8b1e3f", "MOMS, cubic"),
    "linear-quasi": ("#c9b458", "linear, quasi-interpolation"),
    "bspline3-quasi": ("#58c4e8", "B-spline, quasi-interpolation"),
}
_ACROSS = 4  # names in a row of a legend
_GIVEN: dict[str, str] = {}  # colours of other filters
_GOLDEN, _TRIED, _APART = 0.6180339887, 150, 0.22


def colour(name: str) -> str:
    """The colour of a filter in every figure, by any of its names: `lanczos(2)` has that of `lanczos2`.

    A filter without a fixed colour gets a new one on the first call, distinct from all others.
    """
    if name in _FILTERS:
        return _FILTERS[name][0]
    try:
        row = as_filter(name)
    except OptionError:  # not in the table
        return _given(name)
    table = filters()
    for other, (code, _) in _FILTERS.items():
        if other in table and replace(table[other], name=row.name) == row:
            return code
    if isinstance(row.smoothing, float) and row.smoothing > 0:  # grey, lighter for more smoothing
        grey = round(np.interp(math.log10(row.smoothing), (-3, 2), (40, 200)))
        return f"#{grey:02x}{grey:02x}{grey:02x}"
    return _given(row.name)


def _given(name: str) -> str:
    """A colour far from all others, if there is one; hues differ by the golden angle, with three lightnesses."""
    if name not in _GIVEN:
        taken = [color_of("colour", code) for code in (*(own for own, _ in _FILTERS.values()), *_GIVEN.values())]
        tried = []
        for k in range(_TRIED):
            rgb = colorsys.hls_to_rgb((0.1 + k * _GOLDEN) % 1, (0.42, 0.6, 0.3)[k % 3], 0.55)
            tried.append((min(math.dist(rgb, other) for other in taken), rgb))
        _, rgb = next((t for t in tried if t[0] > _APART), max(tried))
        _GIVEN[name] = "#" + "".join(f"{round(255 * c):02x}" for c in rgb)
    return _GIVEN[name]


def folded(text: str, width: int) -> str:
    """A heading, in lines that fit above a picture of `width` pixels."""
    return "\n".join(textwrap.wrap(text, int(_LETTERS * width), break_on_hyphens=False)) or text


def title(name: str) -> str:
    """A filter's readable name."""
    of_spline = re.fullmatch(r"bspline3\((.*)\)", name)
    if of_spline:
        return "B-spline, λ from the data" if of_spline[1] == "auto" else f"B-spline, λ = {of_spline[1]}"
    if name == "exact":
        return "the function itself"
    return _FILTERS[name][1] if name in _FILTERS else name


@dataclass(frozen=True)
class Drawing:
    """A figure and its numbers.

    Attributes
    ----------
    figure : matplotlib Figure or ndarray
        The picture: a matplotlib figure, or an RGB array.
    numbers : list of dict
        For programs.
    lines : list of str
        For people.
    """

    figure: Figure | NDArray[np.uint8]
    numbers: list[dict[str, Any]]
    lines: list[str] = field(default_factory=list)

    def _repr_png_(self) -> bytes:
        """For notebooks."""
        if isinstance(self.figure, np.ndarray):
            return picture.to_png(self.figure)
        stream = io.BytesIO()
        with styled():
            self.figure.savefig(stream, dpi=_DPI, format="png")
        return stream.getvalue()

    def save(self, path: str | os.PathLike[str], dpi: int = _DPI) -> Path:
        """Write the figure by suffix, atomically, by renaming a temporary file.

        Raises
        ------
        FormatError
            Unknown suffix, or the file cannot be written.
        """
        if isinstance(self.figure, np.ndarray):
            return picture.save(self.figure, path)
        path, suffix = as_path(path), require_suffix(path, SUFFIXES, "figures")
        with staged(path, suffix) as temporary, styled():
            self.figure.savefig(temporary, dpi=dpi)
        return path


@contextmanager
def styled() -> Iterator[None]:
    """A context with the figures' matplotlib style, independent of the user's settings."""
    mpl = require_matplotlib()
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """A figure of this size in inches, without a window."""
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), **{"layout": "constrained", **options})


def legend_above(figure: Figure, axes: Axes) -> None:
    """Put the names of the curves in `axes` above the figure, which becomes higher by their rows."""
    handles, labels = axes.get_legend_handles_labels()
    across = min(_ACROSS, len(labels))
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 0.2 * -(-len(labels) // across))
    figure.legend(handles, labels, loc="outside upper center", ncols=across)


def placed(figure: Figure, x: int, y: int, width: int, height: int) -> Axes:
    """Axes with a position from the top left corner and a size in pixels of the file, so that pictures are shown pixel by pixel."""
    across, down = (round(inches * _DPI) for inches in figure.get_size_inches())
    return figure.add_axes((x / across, 1 - (y + height) / down, width / across, height / down))


def tiles(
    rows: int, columns: int, size: tuple[int, int], *, above: int = 0, below: int = 0, between: int = 0, right: int = 0
) -> tuple[Figure, NDArray[Any], int]:
    """A figure, its axes (rows, columns) for pictures of a size (width, height), shown pixel by pixel, and their magnification.

    Pictures narrower than 160 pixels are magnified by a whole number. There is room for lines of text `above` the first row,
    `below` the last one and `between` rows, and for pixels `right` of the last column.
    """
    times = -(-_LEAST_TILE // size[0])
    width, height = (times * n for n in size)
    gap, start = LINE * between + GAP, LINE * above + GAP
    total = start + rows * (height + gap) - gap + LINE * below + GAP
    figure = new_figure((columns * (width + GAP) + GAP + right) / _DPI, total / _DPI, layout=None, dpi=_DPI)
    axes = np.empty((rows, columns), object)
    for i, j in np.ndindex(rows, columns):
        one = axes[i, j] = placed(figure, GAP + j * (width + GAP), start + i * (height + gap), width, height)
        plain(one)
    return figure, axes, times


def show(axes: Axes, pixels: ArrayLike, heading: str, note: str = "", **options: Any) -> Any:
    """A picture with a heading above and a note below; arrays with two axes are shown in grey.

    In axes of its size (`tiles`) it is drawn pixel by pixel, and filtered if the file has fewer pixels.
    """
    array = np.asarray(pixels)
    if array.ndim == 2:
        options.setdefault("cmap", "gray")
    drawn = axes.imshow(array, interpolation="antialiased", **options)
    plain(axes)
    axes.set_title(heading, fontsize=9)
    if note:
        axes.set_xlabel(note, fontsize=9, color=GREY)
    return drawn


def plain(axes: Axes) -> None:
    """No ticks and no frame."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def plain_digits(axis: Axis, subs: Sequence[int]) -> None:
    """Ticks on a logarithmic axis at these multiples of powers of ten, in plain digits."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def spread(places: Sequence[float], gap: float) -> list[float]:
    """Move places as little as possible so that neighbours are at least `gap` apart, in the same order."""
    if gap <= 0:
        raise OptionError(f"gap must be greater than 0; got {gap!r}")
    order = np.argsort(places, kind="stable")
    groups: list[list[float]] = []  # each: sum of wanted starts, and their number
    for rank, at in enumerate(np.asarray(places, float)[order]):
        groups.append([float(at) - rank * gap, 1.0])
        while len(groups) > 1 and groups[-2][0] / groups[-2][1] > groups[-1][0] / groups[-1][1]:
            total, count = groups.pop()
            groups[-1][0] += total
            groups[-1][1] += count
    result, rank = [0.0] * len(order), 0
    for total, count in groups:
        for _ in range(int(count)):
            result[order[rank]] = total / count + rank * gap
            rank += 1
    return result


def label_ends(axes: Axes, ends: Sequence[tuple[str, float, float, str]], gap: float = 0.055) -> None:
    """A label to the right of each curve's end (text, x, y, colour), without overlaps; set the axes' limits first."""
    to_axes = axes.transData + axes.transAxes.inverted()
    at = [to_axes.transform((x, y)) for _, x, y, _ in ends]
    heights = spread([float(p[1]) for p in at], gap)
    right = max(float(p[0]) for p in at)
    for (text, _, _, shade), place, height in zip(ends, at, heights, strict=True):
        axes.annotate(
            text,
            (float(place[0]), float(place[1])),
            (right + 0.025, height),
            "axes fraction",
            "axes fraction",
            color=shade,
            fontsize=9,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": shade, "linewidth": 0.6, "shrinkA": 1, "shrinkB": 0},
        )
