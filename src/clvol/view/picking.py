"""What lies under the pointer: exact values of the functions that are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.bricks.field import BrickedField
from clvol.labels import name_of
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import as_mode
from clvol.scene.transfer import WORDS
from clvol.spline.field import Field
from clvol.spline.regions import Regions
from clvol.view.events import Context
from clvol.view.marks import measures
from clvol.view.panes import Pane3D, SlicePane, triple
from clvol.view.protocol import Message
from clvol.view.renderers import on_slices
from clvol.view.resident import Resident
from clvol.view.state import State
from clvol.volume.histogram import label_numbers
from clvol.volume.volume import Volume

__all__ = ["anchor", "measured_all", "picked"]

_PROBES = 17  # of a label, along a step of a ray


def anchor(resident: Resident, context: Context, state: State, x: float, y: float) -> NDArray[np.float64] | None:
    """The world point that the volume's picture shows at (x, y), in CSS pixels.

    None where there is nothing, if the mode shows no one point ("mean"), or before the coefficients are resident.
    """
    if not resident.renderers.soon(*resident.catalog.key(state)):
        return None
    pane = context.pane(state, "3d")
    assert isinstance(pane, Pane3D)  # by its name
    with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
        return _hit(renderer, pane, x, y, resident.arguments(state, bare=True))


def picked(resident: Resident, context: Context, state: State, name: str, x: float, y: float) -> dict[str, Any]:
    """Position, value and gradient at (x, y) of a pane, in CSS pixels, for JSON; no position where there is nothing.

    In the volume the point is the one that the picture shows: on a surface; where half of the light is stopped; where the
    extreme lies.
    """
    pane = context.pane(state, name)
    key = resident.catalog.key(state)
    if state.wiper is not None and x > state.wiper.at * context.size(name).width:
        key = (state.wiper.filter, *key[1:])
    if not resident.renderers.soon(*key):
        raise OptionError("nothing can be picked before the coefficients are computed")
    with resident.renderers.renderer(*key) as renderer:
        volume, arguments = renderer.volume, resident.arguments(state, bare=True)
        if isinstance(pane, SlicePane):
            point: NDArray[np.float64] | None = pane.point(x, y)
            field = on_slices(renderer, state.mode)
        else:
            point = _hit(renderer, pane, x, y, arguments)
            mode = as_mode(arguments["mode"])
            field = on_slices(renderer, state.mode) if mode.regions else renderer._source.function(mode)
            if point is not None and volume.is_labels:
                point = _in_label(volume, field, point, pane.ray(x, y)[1], state.step * volume.mean_spacing)
        found: dict[str, Any] = {"pane": name, "x": x, "y": y, "units": volume.units, "position": None}
        if point is None or not _within(volume, point):
            return found
        return found | _found(volume, field, point) | {"values": _values(resident, renderer, state.mode, field, point)}


def _values(
    resident: Resident, renderer: Renderer, mode: str, first: Field | BrickedField | Regions, point: NDArray[np.float64]
) -> list[dict[str, Any]]:
    """The value of each medium at a point; None outside its domain, and where samples are missing."""
    functions = [first, *(on_slices(renderer, mode, number) for number in range(1, len(renderer.scene.media)))]
    found = []
    for name, medium, function in zip(resident.layers.names, renderer.scene.media, functions, strict=True):
        value = float(function(point[None], fill=np.nan)[0])
        one: dict[str, Any] = {"name": name, "value": value if np.isfinite(value) else None}
        found.append(one | {"label": name_of(medium.volume, round(value))} if medium.volume.is_labels and value == value else one)
    return found


def _found(volume: Volume, field: Field | BrickedField | Regions, point: NDArray[np.float64]) -> dict[str, Any]:
    """What is at a point; with the gradient of a function that has one."""
    value = float(field(point[None])[0])
    found = {"position": point.tolist(), "index": volume.world_to_index(point).tolist(), "value": value, "gradient": None}
    if not isinstance(field, Regions) and field.filter.has_gradient:
        slope = np.asarray(field.gradient(point[None])[0], np.float64)
        found |= {"gradient": slope.tolist(), "steepness": float(np.linalg.norm(slope))}
    if volume.is_labels:
        found["label"] = name_of(volume, round(value))
    return found


def _hit(renderer: Renderer, pane: Pane3D, x: float, y: float, arguments: dict[str, Any]) -> NDArray[np.float64] | None:
    """What a picture of one pixel shows whose ray is that of (x, y); of projections that are mixed, that of the first medium."""
    origin, way = pane.ray(x, y)
    ahead = origin + way * max(pane.distance, renderer.volume.radius)
    view = pane.view
    camera = Camera(
        position=triple(origin),
        target=triple(ahead),
        up=triple(view.up),
        projection="orthographic" if view.orthographic else "perspective",
    )
    given = {name: value for name, value in arguments.items() if name not in ("pixel_filter", "gradient")} | {
        "camera": camera,
        "rays": 1,
    }
    if len(renderer.scene.media) > 1 and as_mode(given["mode"]).shows not in ("matter", "surface"):
        renderer, given = _alone(renderer, given)
    point = np.asarray(renderer.render(size=(1, 1), outputs="position", **given), np.float64)[0, 0]
    return point if np.isfinite(point).all() else None


def _alone(renderer: Renderer, given: dict[str, Any]) -> tuple[Renderer, dict[str, Any]]:
    """A renderer of the first medium that is seen, which uses the coefficients of the other, and the arguments of its picture."""
    shown = given.pop("media", renderer.scene.media)
    number, medium = next(((k, one) for k, one in enumerate(shown) if one.visible), (0, shown[0]))
    if number:
        given = {name: value for name, value in given.items() if name not in ("transfer", *WORDS)} | medium.words
        given |= {} if medium.transfer is None else {"transfer": medium.transfer}
    return Renderer(renderer._source.part(renderer.scene.media[number])), given


def _in_label(
    volume: Volume, field: Field | BrickedField | Regions, point: NDArray[np.float64], way: NDArray[np.float64], step: float
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


def measured_all(resident: Resident, state: State) -> Message:
    """What the marks of a state measure in the volume that it shows."""
    rows: list[dict[str, Any]] = []
    if state.marks:
        with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
            function = on_slices(renderer, state.mode)
            rows = [measures(mark, function) for mark in state.marks]
    return {"type": "measures", "units": resident.volume.units, "rows": rows}
