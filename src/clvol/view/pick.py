"""What lies under the pointer: its place in the world, and value and gradient of the function that is drawn, exact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.bricks.field import BrickedField
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import as_mode
from clvol.spline.field import Field
from clvol.view.panes import Pane3D, SlicePane
from clvol.volume.histogram import label_numbers
from clvol.volume.volume import Volume

__all__ = ["hit", "picked"]

_PROBES = 17  # along a step


def hit(renderer: Renderer, pane: Pane3D, x: float, y: float, arguments: dict[str, Any]) -> NDArray[np.float64] | None:
    """The world point that the volume's picture shows at a place: that of a picture of one pixel, whose ray is the place's.

    None where there is nothing, or the mode shows no one point ("mean").

    Parameters
    ----------
    renderer : Renderer
    pane : Pane3D
    x, y : float
        CSS pixels.
    arguments : dict
        Of the picture: `Renderer.render`'s.
    """
    origin, way = pane.ray(x, y)
    ahead = origin + way * max(pane.distance, renderer.volume.radius)
    view = pane.view
    camera = Camera(
        position=tuple(map(float, origin)),  # type: ignore[arg-type]  # three
        target=tuple(map(float, ahead)),  # type: ignore[arg-type]
        up=tuple(map(float, view.up)),  # type: ignore[arg-type]
        projection="orthographic" if view.orthographic else "perspective",
    )
    given = arguments | {"camera": camera, "samples": 1}
    point = np.asarray(renderer.render(size=(1, 1), outputs="position", **given), np.float64)[0, 0]
    return point if np.isfinite(point).all() else None


def picked(
    renderer: Renderer, pane: Pane3D | SlicePane, name: str, x: float, y: float, arguments: dict[str, Any]
) -> dict[str, Any]:
    """Position, value and gradient under a place, for JSON; no position where there is nothing.

    In the volume the point is the one that the picture shows: on a surface; where half of the light is stopped; where the
    extreme lies.
    """
    volume = renderer.volume
    if isinstance(pane, SlicePane):
        point: NDArray[np.float64] | None = pane.point(x, y)
        field = renderer.field
    else:
        point = hit(renderer, pane, x, y, arguments)
        field = renderer._source.function(as_mode(arguments["mode"]))
        if point is not None and volume.is_labels:
            point = _in_label(volume, field, point, pane.ray(x, y)[1], arguments["step"] * volume.mean_spacing)
    found: dict[str, Any] = {"pane": name, "x": x, "y": y, "units": volume.units, "position": None}
    if point is None or not _within(volume, point):
        return found
    found["position"] = point.tolist()
    found["index"] = volume.world_to_index(point).tolist()
    found["value"] = float(field(point[None])[0])
    found["gradient"] = None
    if field.filter.has_gradient:
        slope = np.asarray(field.gradient(point[None])[0], np.float64)
        found["gradient"], found["steepness"] = slope.tolist(), float(np.linalg.norm(slope))
    labels = volume.labels
    if isinstance(labels, dict):
        found["label"] = labels.get(round(found["value"]), "")
    return found


def _in_label(
    volume: Volume, field: Field | BrickedField, point: NDArray[np.float64], way: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    """The point itself, or the first behind it that is in a label: what a sample shows begins up to a step before it.

    The volume is given beside the field, because a field that is read by bricks has no samples at hand to find labels in.
    """
    ahead = point + np.linspace(0, 1, _PROBES)[:, None] * step * way / np.linalg.norm(way)
    background, _ = label_numbers(volume)
    solid = np.flatnonzero(np.round(field(ahead)) != background)
    return np.asarray(ahead[solid[0]] if solid.size else point)


def _within(volume: Volume, point: NDArray[np.float64]) -> bool:
    index = volume.world_to_index(point)
    slack = 1e-6 * max(volume.size)
    return bool((index >= -0.5 - slack).all() and (index <= np.asarray(volume.size) - 0.5 + slack).all())
