"""Movies as files: GIF, MP4, WebM, or PNG files in a zip. The same pictures give the same bytes."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import itertools
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.errors import FormatError, MissingDependencyError, OptionError
from clvol.show.picture import over_black, to_bytes, to_png

__all__ = ["FORMATS", "PER_SECOND", "SUFFIXES", "packed", "rate", "require_encoder", "require_room", "write"]

FORMATS = ("gif", "mp4", "webm", "zip")
SUFFIXES = tuple(f".{form}" for form in FORMATS)
PER_SECOND = 25
"""Default frame rate, in pictures per second; GIF counts in hundredths of a second."""
_COLORS = 128  # colours of a GIF
_LONGEST = 65_535  # longest time of a GIF frame, in hundredths of a second
_STORED_AT = (1980, 1, 1, 0, 0, 0)  # earliest date of a zip; a fixed date makes its bytes reproducible
_ENCODERS = {
    "mp4": ("libx264", ["-crf", "20", "-movflags", "+faststart"]),
    "webm": ("libvpx-vp9", ["-crf", "30", "-b:v", "0", "-deadline", "good", "-cpu-used", "4"]),
}
# no version, no date, and a fixed number of threads, so that the bytes are reproducible
_EXACT = ["-threads", "4", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]


# players assume this colour space for large videos, but need the tags for small ones
_TAGGED = ["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-color_range", "tv"]
_TAGGED += ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]


def require_encoder(form: str) -> None:
    """Raise `OptionError` if the format is none of `FORMATS`, or `MissingDependencyError` if a video's encoder is missing."""
    if form not in FORMATS:
        raise OptionError(f"format must be one of {', '.join(FORMATS)}; got {form!r}")
    if form in _ENCODERS and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise MissingDependencyError(f"movies as {form} need imageio-ffmpeg: pip install clvol[movie] (gif and zip need nothing)")


def write(pictures: Iterable[ArrayLike], path: Path, form: str, per_second: float = PER_SECOND) -> None:
    """Write pictures to a file as they arrive; a GIF keeps all of them in memory, one byte per pixel.

    Parameters
    ----------
    pictures : iterable of array-like, shape (height, width, 3 or 4)
        All of one size. A zip keeps opacity; the other formats show transparency as black. Videos have an even number of pixels
        along each axis: an odd last row or column is dropped.
    path : Path
    form : {"gif", "mp4", "webm", "zip"}
        "mp4" is H.264, "webm" VP9; both need imageio-ffmpeg.
    per_second : float
        Pictures per second. A GIF rounds the time of a picture to hundredths of a second; a zip ignores it.

    Raises
    ------
    OptionError
        The format is unknown, or there is no picture.
    MissingDependencyError
        See `require_encoder`.
    """
    require_encoder(form)
    coming = iter(pictures)
    first = next(coming, None)
    if first is None:
        raise OptionError("pictures must be at least one; got none")
    pictures = itertools.chain((first,), coming)
    if form == "zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            for i, picture in enumerate(pictures):
                archive.writestr(zipfile.ZipInfo(f"{i:04d}.png", _STORED_AT), to_png(picture))
    elif form == "gif":
        _write_gif(_opaque(pictures), path, per_second)
    else:
        _write_video(_opaque(pictures), path, form, per_second)


def packed(pictures: Iterable[ArrayLike], form: str, per_second: float = PER_SECOND) -> bytes:
    """The file of `write` in memory."""
    with tempfile.TemporaryDirectory(prefix="clvol-") as folder:
        path = Path(folder) / f"movie.{form}"
        write(pictures, path, form, per_second)
        return path.read_bytes()


def rate(form: str, per_second: float) -> float:
    """Frame rate that this format can store, nearest to `per_second`."""
    if form != "gif":
        return per_second
    return 100 / min(max(2, round(100 / per_second)), _LONGEST)  # viewers slow down faster ones


def require_room(form: str, count: int, size: tuple[int, int]) -> None:
    """Raise `OutOfMemoryError`, before any rendering, if the pictures of a GIF do not fit into memory."""
    if form == "gif":
        memory.require(2 * count * size[0] * size[1], f"a GIF of {count} pictures of {size[0]} × {size[1]}")


def _opaque(pictures: Iterable[ArrayLike]) -> Iterator[NDArray[np.uint8]]:
    return (over_black(to_bytes(picture)) for picture in pictures)


def _write_gif(pictures: Iterator[NDArray[np.uint8]], path: Path, per_second: float) -> None:
    from PIL import Image

    frames = (Image.fromarray(picture).quantize(_COLORS, dither=Image.Dither.NONE) for picture in pictures)
    stream = io.BytesIO()  # Pillow does not report a full disk
    duration = round(1000 / rate("gif", per_second))
    next(frames).save(stream, "GIF", save_all=True, append_images=frames, duration=duration, loop=0)
    path.write_bytes(stream.getbuffer())


def _write_video(pictures: Iterator[NDArray[np.uint8]], path: Path, form: str, per_second: float) -> None:
    import imageio_ffmpeg

    encoder: Any = None
    sent = 0
    codec, options = _ENCODERS[form]
    try:
        for picture in pictures:
            height, width = (n // 2 * 2 for n in picture.shape[:2])
            if encoder is None:
                encoder = imageio_ffmpeg.write_frames(
                    str(path),
                    (width, height),
                    fps=per_second,
                    codec=codec,
                    quality=None,
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                    output_params=[*options, *_TAGGED, *_EXACT],
                )
                encoder.send(None)
            encoder.send(np.ascontiguousarray(picture[:height, :width]))
            sent += 1
    except OSError as error:  # the encoder exited
        raise FormatError(f"cannot write {path.name}: {error}") from error
    finally:
        if encoder is not None:
            with contextlib.suppress(StopIteration):
                encoder.close()
    try:
        written = imageio_ffmpeg.count_frames_and_secs(str(path))[0] if path.exists() else 0
    except RuntimeError:  # the file is truncated
        written = 0
    if written != sent:  # a failure after the last picture, such as a full disk, is not reported otherwise
        raise FormatError(f"cannot write {path.name}: its encoder kept {written} of {sent} pictures; is the disk full?")
