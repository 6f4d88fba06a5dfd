"""What lies under the pointer: its position in the world, and value and gradient of the function that is drawn, exact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.bricks.field import BrickedField
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import as_mode
from clvol.spline.field import Field
from clvol.view.events import Context
from clvol.view.panes import Pane3D, SlicePane, triple
from clvol.view.resident import Resident
from clvol.view.state import State
from clvol.volume.histogram import label_numbers
from clvol.volume.volume import Volume

__all__ = ["anchor", "picked"]

_PROBES = 17  # along a step


def anchor(resident: Resident, context: Context, state: State, x: float, y: float) -> NDArray[np.float64] | None:
    """The world point that the volume's picture shows at (x, y), in CSS pixels.

    None where there is nothing, if the mode shows no one point ("mean"), or before the coefficients are resident.
    """
    which = resident.catalog.which(state)
    if not resident.renderers.soon(state.filter, state.boundary, which):
        return None
    pane = context.pane(state, "3d")
    assert isinstance(pane, Pane3D)  # by its name
    with resident.renderers.renderer(state.filter, state.boundary, which) as renderer:
        return _hit(renderer, pane, x, y, resident.arguments(state))


def picked(resident: Resident, context: Context, state: State, name: str, x: float, y: float) -> dict[str, Any]:
    """Position, value and gradient at (x, y) of a pane, in CSS pixels, for JSON; no position where there is nothing.

    In the volume the point is the one that the picture shows: on a surface; where half of the light is stopped; where the
    extreme lies.
    """
    pane = context.pane(state, name)
    beyond = state.wiper is not None and x > state.wiper.at * context.size(name).width
    chosen = state.wiper.filter if state.wiper is not None and beyond else state.filter
    which = resident.catalog.which(state)
    if not resident.renderers.soon(chosen, state.boundary, which):
        raise OptionError("nothing can be picked before the coefficients are computed")
    with resident.renderers.renderer(chosen, state.boundary, which) as renderer:
        volume, arguments = renderer.volume, resident.arguments(state)
        if isinstance(pane, SlicePane):
            point: NDArray[np.float64] | None = pane.point(x, y)
            field = renderer.field
        else:
            point = _hit(renderer, pane, x, y, arguments)
            field = renderer._source.function(as_mode(arguments["mode"]))
            if point is not None and volume.is_labels:
                point = _in_label(volume, field, point, pane.ray(x, y)[1], arguments["step"] * volume.mean_spacing)
        found: dict[str, Any] = {"pane": name, "x": x, "y": y, "units": volume.units, "position": None}
        return found if point is None or not _within(volume, point) else found | _values(volume, field, point)


def _values(volume: Volume, field: Field | BrickedField, point: NDArray[np.float64]) -> dict[str, Any]:
    value = float(field(point[None])[0])
    found = {"position": point.tolist(), "index": volume.world_to_index(point).tolist(), "value": value, "gradient": None}
    if field.filter.has_gradient:
        slope = np.asarray(field.gradient(point[None])[0], np.float64)
        found |= {"gradient": slope.tolist(), "steepness": float(np.linalg.norm(slope))}
    if isinstance(volume.labels, dict):
        found["label"] = volume.labels.get(round(value), "")
    return found


def _hit(renderer: Renderer, pane: Pane3D, x: float, y: float, arguments: dict[str, Any]) -> NDArray[np.float64] | None:
    """What a picture of one pixel shows whose ray is that of (x, y)."""
    origin, way = pane.ray(x, y)
    ahead = origin + way * max(pane.distance, renderer.volume.radius)
    view = pane.view
    camera = Camera(
        position=triple(origin),
        target=triple(ahead),
        up=triple(view.up),
        projection="orthographic" if view.orthographic else "perspective",
    )
    given = arguments | {"camera": camera, "rays": 1}
    point = np.asarray(renderer.render(size=(1, 1), outputs="position", **given), np.float64)[0, 0]
    return point if np.isfinite(point).all() else None


def _in_label(
    volume: Volume, field: Field | BrickedField, point: NDArray[np.float64], way: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    """The point itself, or the first behind it that is in a label: what a sample shows begins up to a step before it.

    The volume is a parameter because a field by bricks has no resident samples to find labels in.
    """
    ahead = point + np.linspace(0, 1, _PROBES)[:, None] * step * way / np.linalg.norm(way)
    background, _ = label_numbers(volume)
    solid = np.flatnonzero(np.round(field(ahead)) != background)
    return np.asarray(ahead[solid[0]] if solid.size else point)


def _within(volume: Volume, point: NDArray[np.float64]) -> bool:
    index = volume.world_to_index(point)
    slack = 1e-6 * max(volume.size)
    return bool((index >= -0.5 - slack).all() and (index <= np.asarray(volume.size) - 0.5 + slack).all())
