"""Pictures as files, and pictures side by side with labels."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.checks import as_path, number, whole
from clvol.errors import OptionError
from clvol.files import require_suffix, staged

__all__ = ["SUFFIXES", "grid", "heat", "heat_with_scale", "labelled", "save", "to_bytes"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_OPAQUE = (".jpg", ".jpeg", ".bmp")  # these hold no opacity
_INK = (235, 235, 235)
_BAND = (24, 24, 28)


def to_bytes(picture: ArrayLike) -> NDArray[np.uint8]:
    """A picture with values in 0..1 as eight-bit values, rounded, NaN as 0; an eight-bit picture unchanged."""
    try:
        array = np.asarray(picture)
    except (TypeError, ValueError) as error:
        raise OptionError(f"a picture must be a regular array: {error}") from None
    if array.dtype.kind not in "bf" and array.dtype != np.uint8:
        raise OptionError(f"a picture holds floating values in 0..1, or uint8; got dtype {array.dtype}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (1, 3, 4)) or 0 in array.shape:
        raise OptionError(f"a picture has shape (height, width) or (height, width, 1, 3 or 4); got {array.shape}")
    if array.dtype == np.uint8:
        return array
    return np.asarray(np.rint(np.clip(np.nan_to_num(array), 0, 1) * 255), np.uint8)


def save(picture: ArrayLike, path: str | os.PathLike[str]) -> Path:
    """Write a picture with values in 0..1, by suffix: .png, .tif, or .jpg and .bmp, which show transparency as black.

    The file appears when it is complete.

    Raises
    ------
    FormatError
        Unknown suffix, or it cannot be written there.
    """
    import imageio.v3 as iio

    path, suffix = as_path(path), require_suffix(path, SUFFIXES, "pictures")
    data = to_bytes(picture)
    if data.ndim == 3 and data.shape[2] == 1:
        data = data[..., 0]
    if data.ndim == 3 and data.shape[2] == 4 and (suffix in _OPAQUE or data[..., 3].min() == 255):
        data = _opaque(data)
    options: dict[str, Any] = {"quality": 95, "subsampling": 0} if suffix in (".jpg", ".jpeg") else {}
    with staged(path, suffix) as temporary:
        iio.imwrite(temporary, data, plugin="pillow", **options)
    return path


def heat(share: ArrayLike) -> NDArray[np.float32]:
    """Shares in 0..1, of shape (height, width), as colours from black over red to pale yellow; NaN is a grey blue."""
    import cmap

    array = np.asarray(share, np.float32)
    colors = np.asarray(cmap.Colormap("inferno")(np.clip(np.nan_to_num(array), 0, 1)), np.float32)[..., :3]
    colors[np.isnan(array)] = (0.28, 0.33, 0.42)
    return colors


def heat_with_scale(values: ArrayLike, unit: str = "", title: str = "", top: float | None = None) -> NDArray[np.uint8]:
    """Values from 0 up as colours, with their scale in a band beneath; (height + band, width, 3) uint8.

    Parameters
    ----------
    values : array-like, shape (height, width)
        NaN, where there are none, is a grey blue.
    unit, title : str
        What stands behind the numbers of the scale, and beneath it.
    top : float, optional
        The value of the brightest colour, which all above it have too; by default the first of 1, 2 or 5 times a power of ten
        that 95 % of the values do not exceed.
    """
    from PIL import Image, ImageDraw, ImageFont

    array = np.asarray(values, np.float64)
    if array.ndim != 2 or 0 in array.shape:
        raise OptionError(f"values of a heat map have shape (height, width); got {array.shape}")
    top = _round_up(array[np.isfinite(array)]) if top is None else number("top", top, above=0)
    width = array.shape[1]
    size, margin = max(9, round(width / 24)), max(2, width // 12)
    unit = f" {unit}" if unit not in ("", "°") else unit
    font: Any = ImageFont.load_default(size)
    band = np.empty((round(size * (4.2 if title else 2.8)), width, 3), np.uint8)
    band[:] = _BAND
    bar = np.linspace(0, 1, width - 2 * margin)
    band[size // 2 : size // 2 + size, margin : width - margin] = to_bytes(heat(bar[None]))
    image = Image.fromarray(band)
    draw = ImageDraw.Draw(image)
    for share, anchor in ((0.0, "lm"), (0.5, "mm"), (1.0, "rm")):
        at = margin + share * (width - 2 * margin)
        text = f"{share * top:.6g}" + (f"{unit}" if share == 1 else "")
        draw.text((at, 2.1 * size), text, fill=_INK, font=font, anchor=anchor)
    draw.text((width / 2, 3.4 * size), title, fill=_INK, font=font, anchor="mm")
    return np.concatenate([to_bytes(heat(array / top)), np.asarray(image)], 0)


def _round_up(values: NDArray[np.float64]) -> float:
    """The first of 1, 2 or 5 times a power of ten which 95 % of the values do not exceed; 1 if they are zero."""
    most = float(np.quantile(values, 0.95)) if values.size else 0.0
    if not most > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(most))
    return next(float(f"{digit * power:.1g}") for digit in (1, 2, 5, 10) if digit * power >= most * (1 - 1e-6))


def labelled(picture: ArrayLike, text: str) -> NDArray[np.uint8]:
    """A picture with a line or lines of text in a band beneath it; (height + band, width, 3) uint8.

    Transparency is shown as black.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not isinstance(text, str):
        raise OptionError(f"text must be a string; got {text!r}")
    data = to_bytes(picture)
    data = _opaque(data if data.ndim == 3 else data[..., None])
    height, width = data.shape[:2]
    data = np.broadcast_to(data, (height, width, 3))
    size = max(9, round(width / 24))
    font: Any = ImageFont.load_default(size)
    lines = text.split("\n")
    band = Image.new("RGB", (width, round(size * (1.4 * len(lines) + 0.6))), _BAND)
    draw = ImageDraw.Draw(band)
    for i, line in enumerate(lines):
        draw.text((width / 2, size * (1.0 + 1.4 * i)), line, fill=_INK, font=font, anchor="mm")
    return np.concatenate([data, np.asarray(band)], 0)


def _opaque(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Eight-bit RGBA, not premultiplied, over black; anything else unchanged."""
    if data.shape[2] != 4:
        return data
    return np.asarray(np.rint(data[..., :3] * (data[..., 3:] / 255)), np.uint8)


def grid(pictures: Sequence[ArrayLike], columns: int, gap: int = 4) -> NDArray[np.uint8]:
    """Pictures of one size in rows of `columns`, the last row filled with black; as eight-bit values."""
    if not isinstance(pictures, Iterable):
        raise OptionError(f"a grid takes one or more pictures of one shape; got {pictures!r}")
    tiles = [to_bytes(p) for p in pictures]
    if not tiles or len({t.shape for t in tiles}) != 1:
        raise OptionError(f"a grid takes one or more pictures of one shape; got {[t.shape for t in tiles]}")
    columns, gap = whole("columns of a grid", columns, 1), whole("gap of a grid", gap, 0)
    height, width, *channels = tiles[0].shape
    rows = -(-len(tiles) // columns)
    sheet = np.zeros((rows * (height + gap) - gap, columns * (width + gap) - gap, *channels), np.uint8)
    for i, tile in enumerate(tiles):
        y, x = i // columns * (height + gap), i % columns * (width + gap)
        sheet[y : y + height, x : x + width] = tile
    return sheet
