"""Movies as files: GIF, WebP, MP4, WebM, or PNG files in a zip or a folder. The same pictures give the same bytes."""

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
from clvol.base.interrupted import deferred
from clvol.show.picture import over_black, to_bytes, to_png

__all__ = ["FOLDER", "FORMATS", "PER_SECOND", "SUFFIXES", "form_of", "packed", "rate", "require_encoder", "require_room", "write"]

FORMATS = ("gif", "webp", "mp4", "webm", "zip")
FOLDER = "folder"
"""The format of PNG files in a folder."""
SUFFIXES = tuple(f".{form}" for form in FORMATS)
PER_SECOND = 25
"""Default frame rate, in pictures per second; GIF counts in hundredths of a second, WebP in thousandths."""
_COLORS = 128  # colours of a GIF
_LONGEST = 65_535  # longest time of a GIF frame, in hundredths of a second
_WIDEST = {"gif": 65_535, "webp": 16_383, "mp4": 16_384, "webm": 65_534}  # pixels along an edge
_WEBP = {"quality": 90, "method": 4}
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


def form_of(path: Path) -> str:
    """The format of a movie by its name: one of `FORMATS`, or `FOLDER` for a name without a suffix or a folder that is there."""
    if not path.suffix or path.is_dir():
        return FOLDER
    if path.suffix.lower() not in SUFFIXES:
        raise FormatError(f"movies are written as {', '.join(SUFFIXES)}, or PNG files into a folder (no suffix); got {str(path)!r}")
    return path.suffix.lower().removeprefix(".")


def require_encoder(form: str) -> None:
    """Raise `OptionError` if the format is none of `FORMATS`, or `MissingDependencyError` if its encoder is missing."""
    if form not in (*FORMATS, FOLDER):
        raise OptionError(f"format must be one of {', '.join(FORMATS)}; got {form!r}")
    if form in _ENCODERS and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise MissingDependencyError(
            f'movies as {form} need imageio-ffmpeg: pip install "clvol[movie]" (gif, webp and zip need nothing)'
        )
    if form == "webp" and not _has_webp():
        raise MissingDependencyError("movies as webp need a Pillow that was built with WebP: pip install --upgrade pillow")


def _has_webp() -> bool:
    from PIL import features

    return bool(features.check("webp"))


def write(pictures: Iterable[ArrayLike], path: Path, form: str, per_second: float = PER_SECOND) -> None:
    """Write pictures to a file as they arrive; a GIF keeps all of them in memory, one byte per pixel.

    Parameters
    ----------
    pictures : iterable of array-like, shape (height, width, 3 or 4)
        All of one size. PNG files and WebP keep opacity; the other formats show transparency as black. Videos have an even number
        of pixels along each axis: an odd last row or column is dropped.
    path : Path
        For "folder" one that is there.
    form : {"gif", "webp", "mp4", "webm", "zip", "folder"}
        "mp4" is H.264, "webm" VP9; both need imageio-ffmpeg. "zip" and "folder" hold PNG files.
    per_second : float
        Pictures per second. A GIF rounds the time of a picture to hundredths of a second, WebP to thousandths; PNG files have none.

    Raises
    ------
    OptionError
        The format is unknown, there is no picture, or one has another size than the first.
    MissingDependencyError
        See `require_encoder`.
    """
    require_encoder(form)
    coming = iter(pictures)
    first = next(coming, None)
    if first is None:
        raise OptionError("pictures must be at least one; got none")
    pictures = _of_one_size(itertools.chain((first,), coming), form)
    if form == "zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            for i, picture in enumerate(pictures):
                archive.writestr(zipfile.ZipInfo(f"{i:04d}.png", _STORED_AT), to_png(picture))
    elif form == FOLDER:
        for i, picture in enumerate(pictures):
            (path / f"{i:04d}.png").write_bytes(to_png(picture))
    elif form == "webp":
        _write_webp(map(to_bytes, pictures), path, per_second)
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
    if form == "webp":
        return 1000 / max(1, round(1000 / per_second))
    if form != "gif":
        return per_second
    return 100 / min(max(2, round(100 / per_second)), _LONGEST)  # viewers slow down faster ones


def require_room(form: str, count: int, size: tuple[int, int]) -> None:
    """Raise `OutOfMemoryError`, before any rendering, if the pictures of a GIF or a WebP file do not fit into memory.

    `OptionError` if the format has no pictures of this size.
    """
    if max(size) > _WIDEST.get(form, max(size)) or (form in _ENCODERS and min(size) < 2):
        least = 2 if form in _ENCODERS else 1
        raise OptionError(f"{form} must be {least} to {_WIDEST[form]} pixels wide and high; got {size[0]} × {size[1]}")
    if each := {"gif": 2, "webp": 4}.get(form):
        memory.require(each * count * size[0] * size[1], f"a movie of {count} pictures of {size[0]} × {size[1]} as {form}")


def _of_one_size(pictures: Iterable[ArrayLike], form: str) -> Iterator[ArrayLike]:
    """The pictures; `OptionError` if one has another size than the first."""
    size = None
    for number, picture in enumerate(pictures):
        height, width = np.shape(picture)[:2]
        if size is None:
            size = width, height
            require_room(form, 1, size)
        if (width, height) != size:
            raise OptionError(f"pictures must be of one size, {size[0]} × {size[1]}; got {width} × {height} at number {number}")
        yield picture


def _opaque(pictures: Iterable[ArrayLike]) -> Iterator[NDArray[np.uint8]]:
    return (over_black(to_bytes(picture)) for picture in pictures)


def _write_gif(pictures: Iterator[NDArray[np.uint8]], path: Path, per_second: float) -> None:
    from PIL import Image

    frames = (Image.fromarray(picture).quantize(_COLORS, dither=Image.Dither.NONE) for picture in pictures)
    stream = io.BytesIO()  # Pillow does not report a full disk
    duration = round(1000 / rate("gif", per_second))
    next(frames).save(stream, "GIF", save_all=True, append_images=frames, duration=duration, loop=0)
    path.write_bytes(stream.getbuffer())


def _write_webp(pictures: Iterator[NDArray[np.uint8]], path: Path, per_second: float) -> None:
    from PIL import Image

    frames = map(Image.fromarray, pictures)
    stream = io.BytesIO()
    duration = round(1000 / rate("webp", per_second))
    next(frames).save(stream, "WEBP", save_all=True, append_images=frames, duration=duration, loop=0, **_WEBP)
    path.write_bytes(stream.getbuffer())


def _write_video(pictures: Iterator[NDArray[np.uint8]], path: Path, form: str, per_second: float) -> None:
    import imageio_ffmpeg

    encoder: Any = None
    sent = 0
    codec, options = _ENCODERS[form]
    try:
        for picture in pictures:
            height, width = (n // 2 * 2 for n in picture.shape[:2])
            frame = np.ascontiguousarray(picture[:height, :width])
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
                # Python drops what a handler raises while it forks, and logging stays locked for ever; without a frame the encoder
                # would warn as it is closed
                with deferred():
                    encoder.send(None)
                    encoder.send(frame)
            else:
                encoder.send(frame)
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
