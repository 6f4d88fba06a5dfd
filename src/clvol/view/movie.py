"""A movie of the volume turning about its vertical."""

from __future__ import annotations

import importlib.util
import io
import math
import zipfile
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clvol.errors import MissingDependencyError, OptionError
from clvol.picture import to_bytes
from clvol.view.encode import png
from clvol.view.events import Place, turned
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["FORMATS", "turntable"]

FORMATS = ("gif", "mp4", "zip")
_PER_SECOND = 24
_MOST_BYTES = 1 << 29


def turntable(
    resident: Resident,
    state: State,
    place: Place,
    size: tuple[int, int],
    frames: int,
    form: str = "gif",
    progress: Callable[[float], bool] = lambda share: True,  # noqa: ARG005
) -> bytes:
    """A whole turn about the vertical, as a file in memory.

    Parameters
    ----------
    resident : Resident
    state : State
        What is turned; the first picture is the state's own.
    place : Place
    size : (width, height)
    frames : int
    form : {"gif", "mp4", "zip"}
        "zip" holds the pictures as PNG. "mp4" needs imageio's FFMPEG plugin.
    progress : callable
        Called with the share that is done; it says whether to go on.
    """
    if form not in FORMATS:
        raise OptionError(f"format must be one of {', '.join(FORMATS)}; got {form!r}")
    if (4 if form == "zip" else 3) * frames * size[0] * size[1] > _MOST_BYTES:
        raise OptionError(
            f"a movie must take at most {_MOST_BYTES >> 20} MiB before it is packed; got {frames} of {size[0]} × {size[1]}"
        )
    state = place.pinned(replace(state, wiper=None, heat=False))
    upright = replace(state.camera, style="turntable")
    pictures: list[NDArray[np.uint8]] = []
    with resident.renderer(state.filter, state.boundary) as renderer:
        for i in range(frames):
            camera = turned(upright, place, 2 * math.pi * i / frames, 0.0) if i else state.camera
            given = resident.arguments(replace(state, camera=camera))
            picture = to_bytes(renderer.render(size=size, **given))
            pictures.append(
                np.asarray(np.rint(picture[..., :3] * (picture[..., 3:] / 255)), np.uint8) if form != "zip" else picture
            )
            if not progress((i + 1) / frames):
                raise OptionError("the movie was stopped")
    return _packed(pictures, form)


def _packed(pictures: list[NDArray[np.uint8]], form: str) -> bytes:
    stream = io.BytesIO()
    if form == "zip":
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
            for i, picture in enumerate(pictures):
                archive.writestr(f"{i:04d}.png", png(picture))
        return stream.getvalue()
    if form == "gif":
        from PIL import Image

        first, *rest = [Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE) for picture in pictures]
        first.save(stream, "GIF", save_all=True, append_images=rest, duration=round(1000 / _PER_SECOND), loop=0)
        return stream.getvalue()
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise MissingDependencyError("movies as mp4 need imageio-ffmpeg: pip install clvol[movie] (gif and zip need nothing)")
    import imageio.v3 as iio

    even = [picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2] for picture in pictures]
    iio.imwrite(stream, np.stack(even), extension=".mp4", plugin="FFMPEG", fps=_PER_SECOND)
    return stream.getvalue()
