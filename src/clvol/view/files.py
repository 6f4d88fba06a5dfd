"""The files that a client can have made: pictures, movies, meshes."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress
from clvol.interfaces.mesh import MESHES, mesh
from clvol.show.furniture import require_matplotlib
from clvol.show.movies import FORMATS, packed, require_encoder
from clvol.show.picture import to_bytes
from clvol.view.actions import Parts, pixels_of
from clvol.view.drawing import Drawer, Order, png
from clvol.view.events import turned
from clvol.view.jobs import Answer, Cancelled, Reins, Task
from clvol.view.marked import marked
from clvol.view.panes import PaneSize, active_pane
from clvol.view.protocol import Request
from clvol.view.resident import stem
from clvol.view.state import State, name_of

__all__ = ["FILES"]

_MOST_PICTURE = 1 << 13  # pixels along an edge of a picture that is saved
_MOVIE = 16, 1920  # pixels along an edge of a movie
_MOST_BYTES = 1 << 29  # of a movie before it is packed
_MOST_FACES = 100_000_000
_DRAWN = 0.9  # the share of a movie's time that it takes to draw it


def _picture(parts: Parts, request: Request) -> Task:
    """The final picture of a pane, seen as high as it is shown."""
    control, context, state = parts.control, parts.control.context(), parts.control.state
    name = request.pane(active_pane(state))
    own = context.size(name)
    width, height = request.size(pixels_of(own), 1, _MOST_PICTURE)
    fitted = PaneSize(own.height * width / height, own.height, own.ratio)
    context = replace(context, sizes={**control.sizes, name: fitted})
    measures = bool(request.arguments.get("measures") and state.marks and name != "3d")
    if measures:
        require_matplotlib("pictures with measures need")

    def work(reins: Reins) -> Answer:
        drawer = Drawer(parts.resident)
        try:
            order = Order(context, state, name, (width, height), stop=reins.stopped, progress=reins.progress)
            pixels = drawer.still(order)
        finally:
            drawer.give_up()
        if pixels is None:
            raise Cancelled
        if measures:
            pixels = marked(pixels, parts.resident, context, state, name)
        return {"format": "png", "width": width, "height": height}, png(pixels)

    return Task("drawing the picture", f"{stem(parts.resident.name)}.png", work)


def _movie(parts: Parts, request: Request) -> Task:
    """A full turn about the vertical, from the picture that is shown."""
    context, resident = parts.control.context(), parts.resident
    width, height = pixels_of(context.size("3d"))
    width, height = request.size((min(width, 512), min(height, 512)), *_MOVIE)
    frames = whole("frames", request.arguments.get("frames", 60), 2, 360)
    form = name_of("format", request.arguments.get("format", "gif"), FORMATS)
    require_encoder(form)
    if 4 * frames * width * height > _MOST_BYTES:
        raise OptionError(
            f"a movie must take at most {_MOST_BYTES >> 20} MiB before it is packed; got {frames} of {width} × {height}"
        )
    context = replace(context, sizes=dict(context.sizes))
    state = replace(parts.control.state, wiper=None, heat=False)

    def work(reins: Reins) -> Answer:
        shown = context.pinned(state)
        upright = replace(shown.camera, style="turntable")
        key = resident.catalog.key(shown)

        def drawn(state: State, progress: Progress) -> NDArray[np.uint8]:
            with resident.renderers.renderer(*key) as renderer:  # not longer: what is dragged may need its memory
                return to_bytes(renderer.render(size=(width, height), progress=progress, **resident.arguments(state)))

        pictures = []
        for i in range(frames):
            camera = turned(upright, context, 2 * math.pi * i / frames, 0.0) if i else shown.camera
            pictures.append(reins.alone(partial(drawn, replace(shown, camera=camera))))
            reins.progress(_DRAWN * (i + 1) / frames)
        return {"format": form, "frames": frames}, packed(pictures, form)

    return Task("drawing the movie", f"{stem(resident.name)}.{form}", work)


def _mesh(parts: Parts, request: Request) -> Task:
    """The isosurface of the volume as it is reconstructed, or the surfaces of labels that are seen."""
    resident, state = parts.resident, parts.control.state
    form = name_of("format", request.arguments.get("format", "ply"), [suffix[1:] for suffix in MESHES])
    faces = request.arguments.get("faces")
    options: dict[str, Any] = {} if faces is None else {"faces": whole("faces", faces, 4, _MOST_FACES)}

    def work(reins: Reins) -> Answer:
        with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
            if renderer.volume.is_labels:
                made = mesh(renderer.volume, progress=reins.progress, device=renderer.device, **options)
            else:
                level = getattr(resident.mode(state), "isovalue", None)
                made = mesh(renderer.field, level, progress=reins.progress, **options)
        with tempfile.TemporaryDirectory() as folder:
            data = made.save(Path(folder) / f"mesh.{form}").read_bytes()
        cut = {"note": "it is whole: clip planes cut no mesh"} if state.clip is not None or state.cuts else {}
        return {"format": form, "faces": len(made.faces)} | cut, data

    return Task("making the mesh", f"{stem(resident.name)}.{form}", work)


FILES: Mapping[str, Callable[[Parts, Request], Task]] = {"save_picture": _picture, "movie": _movie, "mesh": _mesh}
"""By what is asked for: what checks a request, and makes the task from what is shown now."""
