"""A movie of the volume turning about its vertical."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.show.movies import FORMATS, packed, require_encoder
from clvol.show.picture import to_bytes
from clvol.view.events import Context, turned
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["FORMATS", "turntable"]

_MOST_BYTES = 1 << 29


def turntable(
    resident: Resident,
    state: State,
    context: Context,
    size: tuple[int, int],
    frames: int,
    form: str = "gif",
    progress: Callable[[float], bool] = lambda share: True,  # noqa: ARG005
) -> bytes:
    """A full turn about the vertical, as a file in memory.

    Parameters
    ----------
    resident : Resident
    state : State
        The first picture is that of the state.
    context : Context
    size : (width, height)
    frames : int
    form : {"gif", "mp4", "webm", "zip"}
        As of `clvol.show.movies.write`.
    progress : callable
        Called with the fraction that is done; returns whether to continue.
    """
    require_encoder(form)
    if 4 * frames * size[0] * size[1] > _MOST_BYTES:
        raise OptionError(
            f"a movie must take at most {_MOST_BYTES >> 20} MiB before it is packed; got {frames} of {size[0]} × {size[1]}"
        )
    state = context.pinned(replace(state, wiper=None, heat=False))
    upright = replace(state.camera, style="turntable")
    pictures: list[NDArray[np.uint8]] = []
    with resident.renderers.renderer(state.filter, state.boundary, resident.catalog.which(state)) as renderer:
        for i in range(frames):
            camera = turned(upright, context, 2 * math.pi * i / frames, 0.0) if i else state.camera
            given = resident.arguments(replace(state, camera=camera))
            pictures.append(to_bytes(renderer.render(size=size, **given)))
            if not progress((i + 1) / frames):
                raise OptionError("the movie was stopped")
    return packed(pictures, form)
