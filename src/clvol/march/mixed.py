"""Pictures of several media, each drawn alone, put together: projections and surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clvol.base.srgb import as_light, as_shown

if TYPE_CHECKING:
    from clvol.march.launch import Picture

__all__ = ["mixed", "nearest"]


def mixed(pictures: Sequence[Picture], rule: Literal["add", "over"]) -> Picture:
    """Projections, (height, width, 4), colours not premultiplied: see `clvol.Scene`."""
    every = np.stack(pictures)
    colors, opacity = every[..., :3] * every[..., 3:], every[..., 3]
    if rule == "add":
        # sums of float64 do not depend on their order, up to a bit that float32 does not have
        return _parted(colors.sum(0, dtype=np.float64), opacity.max(0))
    cover = colors.max(-1)
    through = np.cumprod(np.concatenate([np.ones_like(cover[:1]), 1 - cover[:-1]]), axis=0)
    return _parted((through[..., None] * colors).sum(0), opacity.max(0))


def nearest(pictures: Sequence[Mapping[str, Picture]], *, linear: bool) -> dict[str, Picture]:
    """Surfaces, with their depths: each pixel that of the nearest one, over those behind it as far as it covers the pixel.

    `linear`: colours mix in linear light.
    """
    order = np.argsort(np.stack([one["depth"] for one in pictures]), axis=0, kind="stable")

    def at(name: str, place: int) -> NDArray[Any]:
        every = np.stack([one[name] for one in pictures])
        index = order[place].reshape(1, *order.shape[1:], *(1,) * (every.ndim - 3))
        return np.asarray(np.take_along_axis(every, index, 0)[0])

    total: NDArray[Any] = np.zeros((*order.shape[1:], 3))
    opacity: NDArray[Any] = np.zeros(order.shape[1:])
    for place in range(len(pictures)):
        rgba = at("rgba", place)
        share = (1 - opacity) * rgba[..., 3]
        total = total + share[..., None] * (as_light(rgba[..., :3]) if linear else rgba[..., :3])
        opacity = opacity + share
    together = {name: at(name, 0) for name in pictures[0] if name not in ("rgba", "visited")}
    return {"rgba": _parted(total, opacity, linear=linear), **together}


def _parted(colors: NDArray[Any], opacity: NDArray[Any], *, linear: bool = False) -> Picture:
    """A picture of premultiplied colours, which are light if `linear`."""
    opacity = opacity[..., None]
    plain = np.divide(colors, opacity, out=np.zeros(colors.shape), where=opacity > 0)
    clipped = np.clip(np.concatenate([plain, opacity], -1), 0, 1)
    if linear:
        clipped[..., :3] = as_shown(clipped[..., :3])
    made: Picture = clipped.astype(np.float32)
    return made
