"""Measures on slices: distances, angles, areas and the values within them; drawn with the pointer, as numbers and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.filter.table import PICTURE_FILTER
from clvol.march.contours import Shown
from clvol.march.slices import SliceOptions, slice_function
from clvol.spline.function import ContinuousFunction
from clvol.spline.regions import Regions
from clvol.view.panes import SlicePane, Vector, triple
from clvol.view.state import MARKS, Mark, State
from clvol.volume.volume import Volume

__all__ = ["as_csv", "clicked", "continues", "dragged", "measured", "measures", "on_pane", "shown_marks"]

_CORNERED = ("rectangle", "ellipse")
_BY_POINTS = ("angle", "area")  # whose points come one after the other
_NEAR = 8.0  # CSS pixels from a point that ends what is drawn
_MOST_AT = 1024  # values along an edge
_COLUMNS = ("number", "kind", "units", "length", "angle", "area", "count", "mean", "sd", "min", "max", "points")
_DIGITS = 9  # in CSV


# -- drawn with the pointer ----------------------------------------------------------------------------------------


def continues(state: State, pane: SlicePane) -> bool:
    """Whether the last mark takes further points on this slice."""
    last = state.marks[-1] if state.marks else None
    return last is not None and last.kind == state.tool and len(last.points) < MARKS[last.kind][1] and on_pane(last, pane, 1e-6)


def dragged(state: State, pane: SlicePane, began: tuple[float, float], now: tuple[float, float], more: bool) -> State:
    """The state with what the tool draws between two positions of a pane; `more` appends the last one to what is drawn already."""
    assert state.tool is not None  # or the drag would do something else
    first, last = pane.point(*began), pane.point(*now)
    if more:
        return _appended(state, last)
    points = [first, last]
    if state.tool in _CORNERED:
        across = ((last - first) @ pane.right) * pane.right
        points = [first, first + across, last - across]
    return replace(state, marks=(*state.marks, Mark(state.tool, tuple(map(triple, points)))))


def clicked(state: State, pane: SlicePane, at: tuple[float, float], more: bool) -> tuple[State, bool]:
    """The state after a click with the tool, and whether what is drawn takes further points."""
    if state.tool not in _BY_POINTS:
        return state, False
    point = pane.point(*at)
    if not more:
        return replace(state, marks=(*state.marks, Mark(state.tool, (triple(point),)))), True
    ends = [pane.project(state.marks[-1].points[k]) for k in (0, -1)]
    if any(math.dist(end, at) <= _NEAR for end in ends):  # a polygon is closed by a click on either end
        return state, False
    state = _appended(state, point)
    return state, continues(state, pane)


def _appended(state: State, point: Vector) -> State:
    *before, last = state.marks
    return replace(state, marks=(*before, replace(last, points=(*last.points, triple(point)))))


def on_pane(mark: Mark, pane: SlicePane, thickness: float) -> bool:
    """Whether a mark lies on the slice, or at most half of a thickness away from it."""
    return bool((np.abs((np.array(mark.points) - pane.middle) @ pane.normal) <= thickness / 2 + 1e-9 * pane.per_pixel).all())


def shown_marks(state: State, volume: Volume, pane: SlicePane) -> list[dict[str, Any]]:
    """The marks that a slice shows: their number, kind and points in CSS pixels."""
    thick = min(volume.spacing)
    shown = [(number, mark) for number, mark in enumerate(state.marks) if on_pane(mark, pane, thick)]
    return [{"number": k, "kind": mark.kind, "points": [list(pane.project(p)) for p in mark.points]} for k, mark in shown]


# -- as numbers ----------------------------------------------------------------------------------------------------


def measured(mark: Mark, volume: Volume | Shown | ArrayLike, **options: Unpack[SliceOptions]) -> dict[str, Any]:
    """What a mark measures in a volume.

    Parameters
    ----------
    mark : Mark
    volume : Volume, Field or array-like, 3-D
    **options
        `filter`, `boundary`, `device` and `smooth`, as of `clvol.slice`.

    Returns
    -------
    dict
        Its "kind", and "length" in world units, "angle" in degrees, or "area" in square units. Of areas, rectangles and ellipses
        also "count", "mean", "sd", "min" and "max" of the function's values at points of a grid in the plane, at most as far apart
        as the closest samples are, as far as they lie within the mark and the volume. `sd` is by their count, not by one less.

    Examples
    --------
    >>> import clvol
    >>> from clvol.view import Mark, measured
    >>> found = measured(Mark("rectangle", ((-0.5, -0.5, 0), (0.5, -0.5, 0), (-0.5, 0.5, 0))), clvol.phantoms.sphere(24))
    >>> found["area"], found["count"]
    (1.0, 144)
    """
    if isinstance(volume, (ContinuousFunction, Regions)):
        return measures(mark, volume)
    with slice_function(volume, PICTURE_FILTER, 0.0, options) as function:
        return measures(mark, function)


def measures(mark: Mark, function: Shown) -> dict[str, Any]:
    """What a mark measures: see `measured`."""
    found: dict[str, Any] = {"kind": mark.kind}
    points = np.array(mark.points)
    if mark.kind == "distance":
        return found | {"length": float(np.linalg.norm(points[1] - points[0]))}
    if mark.kind == "angle":
        return found | ({"angle": _angle(points)} if len(points) == 3 else {})
    if len(points) < 3:
        return found
    places, area = _within(mark.kind, points, min(function.grid.spacing))
    values = np.asarray(function(places, fill=np.nan), np.float64)
    values = values[np.isfinite(values)]
    found |= {"area": area, "count": int(values.size)}
    if values.size:
        statistics = {"mean": values.mean(), "sd": values.std(), "min": values.min(), "max": values.max()}
        found |= {name: float(value) for name, value in statistics.items()}
    return found


def _angle(points: NDArray[np.float64]) -> float:
    one, other = points[0] - points[1], points[2] - points[1]
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))


def _within(kind: str, points: NDArray[np.float64], spacing: float) -> tuple[NDArray[np.float64], float]:
    """Points of a grid within a mark, and its area."""
    if kind in _CORNERED:
        origin, right, down = points[0], points[1] - points[0], points[2] - points[0]
    else:
        origin, right, down = _frame(points)
    edges = [float(np.linalg.norm(way)) for way in (right, down)]
    counts = [min(_MOST_AT, max(1, math.ceil(edge / spacing - 1e-9))) for edge in edges]
    u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts))
    area = edges[0] * edges[1]
    if kind == "ellipse":
        inside, area = (2 * u - 1) ** 2 + (2 * v - 1) ** 2 <= 1, area * math.pi / 4
    elif kind == "area":
        corners = np.stack([(points - origin) @ way / max(float(way @ way), 1e-300) for way in (right, down)], 1)
        inside, area = _in_polygon(corners, u, v), area * _area(corners)
    else:
        inside = np.ones(u.shape, bool)
    return origin + u[inside][:, None] * right + v[inside][:, None] * down, area


def _frame(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A corner and both edges of a rectangle around a polygon in its plane."""
    away = points - points.mean(0)
    ways = np.linalg.svd(away, full_matrices=False)[2][:2]
    low, high = (away @ ways.T).min(0), (away @ ways.T).max(0)
    return points.mean(0) + low @ ways, (high - low)[0] * ways[0], (high - low)[1] * ways[1]


def _area(corners: NDArray[np.float64]) -> float:
    x, y = corners.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _in_polygon(corners: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether points are inside, where edges are crossed an odd number of times on the way out."""
    inside = np.zeros(u.shape, bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
        if y0 != y1:
            inside ^= ((y0 > v) != (y1 > v)) & (u < x0 + (v - y0) * (x1 - x0) / (y1 - y0))
    return inside


def as_csv(marks: Sequence[Mark], rows: Sequence[dict[str, Any]], units: str) -> str:
    """The marks and what they measure as text with commas, a line for each."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, _COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for number, (mark, row) in enumerate(zip(marks, rows, strict=True), 1):
        told = {name: f"{value:.{_DIGITS}g}" if isinstance(value, float) else value for name, value in row.items()}
        points = "; ".join(" ".join(f"{v:.{_DIGITS}g}" for v in point) for point in mark.points)
        writer.writerow(told | {"number": number, "units": units, "points": points})
    return stream.getvalue()
