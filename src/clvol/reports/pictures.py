"""The pictures of a report: a view by each filter, a close-up where filters differ, and the same from every second sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import Boundary
from clvol.camera import Camera
from clvol.device import Device
from clvol.figures.panels import fixed, settled
from clvol.filter import Filter, as_filter
from clvol.march.renderer import Renderer
from clvol.mode import as_mode
from clvol.volume import Volume

__all__ = ["Card", "Cards", "cards"]

Picture: TypeAlias = NDArray[np.float32]
_CLOSER = 4.0
_BLUR = 12  # the place where filters differ most is sought with a window of this fraction of the width


@dataclass(frozen=True)
class Card:
    """The pictures of one filter, (height, width, 3), and their differences, (height, width).

    Attributes
    ----------
    filter : str
    whole, closer : ndarray
        From all samples.
    difference : ndarray
        Between the close-up and that of the recommended filter, from all samples.
    fewer : ndarray
        The close-up from every second sample along each axis.
    error : ndarray
        Its difference from the close-up of the recommended filter with all samples.
    """

    filter: str
    whole: Picture
    closer: Picture
    difference: Picture
    fewer: Picture
    error: Picture


@dataclass(frozen=True)
class Cards:
    """A card for each filter, the name of the filter that differences refer to, and the mode."""

    cards: list[Card]
    reference: str
    mode: str


def cards(
    volume: Volume,
    filters: Sequence[Filter],
    best: Filter,
    pixels: int,
    boundary: Boundary,
    factor: int,
    device: Device,
    progress: Callable[[float], Any],
    options: dict[str, Any],
) -> Cards:
    """Draw everything; `options` are those of `Renderer.render`."""
    look = settled(volume, options)  # settled once: the decimated volume has another histogram
    look["background"] = look.get("background") or (1.0, 1.0, 1.0)
    camera: Camera = look.pop("camera")
    few = volume.gaussian([factor / 2 * s for s in volume.spacing]).downsample(factor)
    step = look.pop("step", 0.5)
    done, total = 0, 2 * len(filters) + 2

    def draw(data: Volume, filter: Filter, views: Sequence[Camera], step: float) -> list[Any]:
        nonlocal done
        with Renderer(data, filter, boundary, device) as renderer:
            drawn = [
                renderer.render(fixed(view, volume, data), size=(pixels, pixels), outputs=("rgba", "position"), step=step, **look)
                for view in views
            ]
        done += 1
        progress(min(1.0, done / total))
        return drawn

    (first,) = draw(volume, best, [camera], step)
    (other,) = draw(volume, as_filter("linear"), [camera], step)
    views = [camera, _closer(camera, first, other)]
    truth = _rgb(draw(volume, best, views, step)[1])
    made = []
    for row in filters:
        whole, closer = draw(volume, row, views, step)
        (fewer,) = draw(few, row, views[1:], step / factor)
        made.append(
            Card(
                row.name, _rgb(whole), _rgb(closer), _difference(_rgb(closer), truth), _rgb(fewer), _difference(_rgb(fewer), truth)
            )
        )
    return Cards(made, best.name, as_mode(look["mode"]).name)


def _closer(camera: Camera, a: Any, b: Any) -> Camera:
    """Four times as near, aimed at what two filters draw most differently."""
    from scipy import ndimage

    apart = ndimage.uniform_filter(_difference(_rgb(a), _rgb(b)), max(1, a["rgba"].shape[1] // _BLUR))
    position = a["position"]
    seen = np.isfinite(position).all(-1)
    if not seen.any():
        return camera.zoomed(_CLOSER)
    place = np.unravel_index(int(np.where(seen, apart, -1).argmax()), seen.shape)
    x, y, z = (float(v) for v in position[place])
    return replace(camera, target=(x, y, z)).zoomed(_CLOSER)


def _rgb(drawn: Any) -> Picture:
    return np.asarray(drawn["rgba"][..., :3], np.float32)


def _difference(a: Picture, b: Picture) -> Picture:
    return np.asarray(np.abs(a - b).mean(-1), np.float32)
