"""The pictures of a report: a view by each filter, a close-up where filters differ, and both from every second sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.progress import Progress
from clvol.device import Device
from clvol.figures.panels import fixed, for_filter, settled
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.march.options import step_times
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import as_mode
from clvol.volume.volume import Volume

__all__ = ["Card", "Cards", "cards"]

Picture: TypeAlias = NDArray[np.float32]
_CLOSER = 4.0
_STEEP = 1.5  # depth over width; surfaces at more than about 56° are grazing


@dataclass(frozen=True)
class Card:
    """The pictures of one filter, (height, width, 3), and their differences, (height, width)."""

    filter: str
    whole: Picture  # from all samples, as the next two
    closer: Picture
    difference: Picture  # between the close-up and that of the recommended filter
    fewer: Picture  # the close-up from every second sample along each axis
    error: Picture  # its difference from the close-up of the recommended filter with all samples


@dataclass(frozen=True)
class Cards:
    """A card for each filter."""

    cards: list[Card]
    reference: str  # the filter that differences refer to
    mode: str


def cards(
    volume: Volume,
    filters: Sequence[Filter],
    best: Filter,
    pixels: int,
    boundary: Boundary,
    factor: int,
    device: Device,
    progress: Progress | None,
    options: dict[str, Any],
) -> Cards:
    """Draw everything; `options` are those of `Renderer.render`."""
    look = settled(volume, options)  # settled once: the decimated volume has another histogram
    look["background"] = look.get("background") or (1.0, 1.0, 1.0)
    camera: Camera = look.pop("camera")
    few = volume.gaussian([factor / 2 * s for s in volume.spacing]).downsample(factor)
    step = look.pop("step", None)
    linear = as_filter("linear")
    done, total = 0, 2 * len(filters) + len({best.name, linear.name})

    def draw(data: Volume, filter: Filter, views: Sequence[Camera], step: float | None) -> list[Any]:
        nonlocal done
        shown = for_filter(look, filter)
        with Renderer(data, filter, boundary, device) as renderer:
            drawn = [
                renderer.render(fixed(view, volume, data), size=(pixels, pixels), outputs=("rgba", "position"), step=step, **shown)
                for view in views
            ]
        done += 1
        if progress is not None:
            progress(min(1.0, done / total))
        return drawn

    drawn = {row.name: draw(volume, row, [camera], step) for row in (best, linear)}
    near = _closer(camera, volume, drawn[best.name][0], drawn[linear.name][0])
    made: dict[str, Card] = {}
    for row in sorted(filters, key=lambda row: row.name != best.name):  # the others differ from it
        first = drawn.get(row.name, [])
        whole, closer = [_rgb(one) for one in first + draw(volume, row, [camera, near][len(first) :], step)]
        fewer = _rgb(draw(few, row, [near], step_times(step, 1 / factor, look["mode"]))[0])
        truth = made[best.name].closer if made else closer
        made[row.name] = Card(row.name, whole, closer, _difference(closer, truth), fewer, _difference(fewer, truth))
    return Cards([made[row.name] for row in filters], best.name, as_mode(look["mode"]).name)


def _closer(camera: Camera, volume: Volume, a: Any, b: Any) -> Camera:
    """A camera four times as near, where two filters differ most on surfaces that face it; at silhouettes all filters differ."""
    from scipy import ndimage

    position = a["position"]
    seen = np.isfinite(position).all(-1)
    if not seen.any():
        return camera.zoomed(_CLOSER)
    facing = seen & (_slope(position, camera, volume) < _STEEP)
    side = max(1, round(seen.shape[1] / _CLOSER))
    apart = np.where(facing if facing.any() else seen, _difference(_rgb(a), _rgb(b)), 0)
    within = ndimage.uniform_filter(apart, side, mode="constant")
    place = np.unravel_index(int(np.where(facing if facing.any() else seen, within, -1).argmax()), seen.shape)
    x, y, z = (float(v) for v in position[place])
    return replace(camera, target=(x, y, z)).zoomed(_CLOSER)


def _slope(position: Picture, camera: Camera, volume: Volume) -> Picture:
    """Depth over width of the visible surface from pixel to pixel; infinite next to the background."""
    view = camera.view(volume)
    away = position.astype(np.float64) - view.eye
    depth, across, up = away @ view.forward, away @ view.right, away @ view.up
    steep = np.zeros(depth.shape)
    for axis, along in ((0, up), (1, across)):
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.abs(np.diff(depth, axis=axis) / np.diff(along, axis=axis))
        ratio = np.where(np.isfinite(ratio), ratio, np.inf)
        for pad in ((0, 1), (1, 0)):  # before and after
            steep = np.maximum(steep, np.pad(ratio, [pad if a == axis else (0, 0) for a in (0, 1)]))
    return np.asarray(steep, np.float32)


def _rgb(drawn: Any) -> Picture:
    return np.asarray(drawn["rgba"][..., :3], np.float32)


def _difference(a: Picture, b: Picture) -> Picture:
    return np.asarray(np.abs(a - b).mean(-1), np.float32)
