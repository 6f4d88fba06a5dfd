"""A slice's picture with its marks and what they measure, as the page shows them over it: for pictures that are saved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.srgb import over
from clvol.show.furniture import Line, Mark, Stage, Words, drawn
from clvol.show.picture import to_bytes
from clvol.view.events import Context
from clvol.view.marks import shown_marks
from clvol.view.panes import SlicePane
from clvol.view.picking import measured_all
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["marked"]

_LINE = 0.12  # of a letter's height
_DOT = 0.4
_ROUND = 96  # points of an ellipse


def marked(pixels: NDArray[np.uint8], resident: Resident, context: Context, state: State, name: str) -> NDArray[np.uint8]:
    """The picture of a pane with the marks that lie on it."""
    pane, volume = context.pane(state, name), resident.volume
    if not isinstance(pane, SlicePane) or not (shown := shown_marks(state, volume, pane)):
        return pixels
    height, width = pixels.shape[:2]
    stage = Stage(
        view=context.placed(state, width / height).view(volume),  # of which lines and words use nothing
        size=(width, height),
        low=volume.corners.min(0),
        high=volume.corners.max(0),
        focus=volume.center,
        units=volume.units,
        space=volume.space,
        bars=(),
        background=state.background or (0.0, 0.0, 0.0),
        linear=False,
    )
    rows = measured_all(resident, state)["rows"]
    lines: list[Mark] = []
    words: list[Mark] = []
    for one in shown:
        points = _outline(one["kind"], np.array(one["points"]) * (width / pane.size.width))
        lines.append(Line(points, (_DOT if len(one["points"]) == 1 else _LINE) * stage.font))
        x, y = points[points[:, 0].argmax()]
        text = _said(one["number"], rows[one["number"]], volume.units)
        left = min(x + stage.font / 2, max(0.0, width - 0.65 * stage.font * len(text)))
        words.append(Words(left, max(y - stage.font / 2, stage.font), text, stage.font, 0.0, 1.0))
    below = np.concatenate([pixels, np.full((height, width, 4 - pixels.shape[2]), 255, np.uint8)], 2)
    return to_bytes(over(drawn([*lines, *words], stage), below.astype(np.float32) / np.float32(255)))


def _outline(kind: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points of a line around a mark, or along it."""
    if len(points) == 1:
        return points[[0, 0]] + [[-0.5, 0], [0.5, 0]]
    if kind == "area" and len(points) > 2:
        return points[[*range(len(points)), 0]]
    if kind not in ("rectangle", "ellipse"):
        return points
    corner, right, down = points[0], points[1] - points[0], points[2] - points[0]
    if kind == "rectangle":
        return np.array([corner, points[1], points[1] + down, points[2], corner])
    turn = np.linspace(0, 2 * math.pi, _ROUND)[:, None]
    return np.asarray(corner + right * (1 + np.cos(turn)) / 2 + down * (1 + np.sin(turn)) / 2)


def _said(number: int, row: dict[str, Any], units: str) -> str:
    """The number of a mark, from 1, and what the page says of it."""
    told: Sequence[tuple[str, str]] = (("length", f" {units}"), ("angle", "°"), ("area", units and f" {units}²"))
    found = [f"{row[name]:.4g}{unit}".strip() for name, unit in told if name in row]
    return ": ".join([str(number + 1), *found])
