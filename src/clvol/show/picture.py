"""Pictures: arrays that display themselves, picture files, and labelled grids of pictures."""

from __future__ import annotations

import io
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array
from clvol.base.checks import as_path, number, whole
from clvol.base.errors import FormatError, OptionError
from clvol.base.files import require_suffix, staged
from clvol.base.serial import LONGEST
from clvol.show.furniture import VECTORS, Furnished, vectors

if TYPE_CHECKING:
    from clvol.scene.camera import Camera
    from clvol.scene.scene import Scene

__all__ = [
    "RECIPE",
    "SUFFIXES",
    "Picture",
    "as_pictures",
    "grid",
    "heat",
    "heat_with_scale",
    "labelled",
    "read_recipe",
    "save",
    "show",
    "stored",
    "to_bytes",
    "to_png",
]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", *VECTORS)
RECIPE = "clvol"
"""The key of the text of a PNG file that says what made the picture."""
_OPAQUE = (".jpg", ".jpeg", ".bmp")  # formats without opacity
_INK = (235, 235, 235)
_BAND = (24, 24, 28)
_AT_ONCE = 1 << 20  # numbers converted per pass
_FARTHEST = 0.25  # grey of the farthest depth


class Picture(np.ndarray[Any, np.dtype[Any]]):
    """The array of a picture, which displays itself: as the value of a notebook cell, or with `show`.

    It is a full `ndarray`. Results computed from it, and parts that are not pictures, are plain arrays; a part that
    is one, such as ``picture[100:200, 50:150]``, is a `Picture`.

    Parameters
    ----------
    array : array-like, shape (height, width) or (height, width, channels)
        Viewed, not copied.
    kind : str
        Meaning of its numbers, an output of `clvol.render`: "rgba" (colours in 0..1), "depth", "normal", "position", "visited",
        "value", "uncertainty" or "pose". Affects only how it is shown.

    Attributes
    ----------
    kind : str
        Meaning of its numbers.
    camera : Camera or None
        From where it was rendered: with the place that was fitted. None of what `clvol.render` did not make, as of parts.
    scene : Scene or None
        What it shows, with all that was left open decided; it keeps the volume in memory. Of a LazyVolume, or in another process
        than that which rendered it, the volume is its grid alone, of zeros.
    options : dict
        The other arguments with which ``clvol.render(picture.scene, picture.camera, **picture.options)`` renders it again, to the
        bit.
    spacing : (float, float) or None
        World units per pixel along rows and columns, of slices; None of other pictures, and of parts.

    Examples
    --------
    >>> import clvol
    >>> picture = clvol.render(clvol.phantoms.sphere(24), mode="mip", size=(48, 32))
    >>> picture.shape, picture.kind  # rows first
    ((32, 48, 4), 'rgba')
    >>> again = clvol.render(picture.scene, picture.camera, **picture.options)
    >>> bool((again == picture).all())
    True
    """

    kind: str = "rgba"
    spacing: tuple[float, float] | None = None
    recipe: Any = None  # clvol.march.recipe.Recipe
    furnished: Furnished | None = None

    def __new__(cls, array: ArrayLike, kind: str = "rgba") -> Self:
        result = as_array(array, "picture").view(cls)
        result.kind = kind
        return result

    def __array_finalize__(self, other: Any) -> None:
        if isinstance(other, Picture):
            vars(self).update(vars(other))
            if self.shape != other.shape:
                self.recipe = self.furnished = None
            if self.shape[:2] != other.shape[:2]:
                self.spacing = None

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        if array is self:  # computed in place
            return self
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain

    def __getitem__(self, index: Any) -> Any:
        part = super().__getitem__(index)
        if isinstance(part, Picture) and (part.ndim != self.ndim or part.shape[2:] != self.shape[2:]):
            return np.asarray(part)
        if isinstance(part, Picture) and index is not ...:
            part.recipe = part.furnished = None
        return part

    def __reduce__(self) -> Any:
        reduced: Any = super().__reduce__()
        make, arguments, state = reduced
        return make, arguments, (*state, vars(self))

    def __setstate__(self, state: Any) -> None:
        vars(self).update(state[-1])
        super().__setstate__(state[:-1])

    def __repr__(self) -> str:
        if not self._shows:
            return repr(np.asarray(self))
        height, width = self.shape[:2]
        return f"Picture({self.kind}, {width} × {height} pixels, {self.dtype}): .show(), .save(path)"

    def __str__(self) -> str:
        return str(np.asarray(self))

    def _repr_png_(self) -> bytes | None:
        return to_png(self) if self._shows else None

    @property
    def _shows(self) -> bool:
        channels = {"depth": (), "visited": (), "normal": (3,), "position": (3,), "value": (), "uncertainty": (2,)}
        if self.size == 0 or self.dtype.kind not in "fbu":
            return False
        if self.kind in channels:
            return self.ndim >= 2 and self.shape[2:] == channels[self.kind]
        return self.ndim == 2 or (self.ndim == 3 and self.shape[2] in (1, 3, 4))

    @property
    def camera(self) -> Camera | None:
        """From where it was rendered."""
        return None if self.recipe is None else self.recipe.camera

    @property
    def scene(self) -> Scene | None:
        """What it shows."""
        return None if self.recipe is None else self.recipe.scene

    @property
    def options(self) -> dict[str, Any]:
        """How it was rendered otherwise, as arguments of `clvol.render`."""
        return {} if self.recipe is None else self.recipe.options

    def shown(self) -> NDArray[Any]:
        """The colours to display, (height, width, 3 or 4): the array itself if it holds colours.

        Depth is grey, with the nearest white; normals and positions show x, y and z as red, green and blue. Both are transparent
        where the ray hits nothing. Values are grey, the largest white. "visited" and "uncertainty" are heat maps; the latter shows
        distances, with a scale.
        """
        array = np.asarray(self)
        if not self._shows or self.kind not in _SHOWN:
            return array
        colors: NDArray[Any] = _SHOWN[self.kind](array)
        return colors

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the displayed picture, by suffix: see `clvol.save`. (`numpy.save` writes its numbers.)"""
        return save(self, path)

    def show(self) -> None:
        """Display it in a notebook or an image viewer: see `clvol.show`."""
        show(self)


def _depth_shown(depth: NDArray[Any]) -> NDArray[Any]:
    met = np.isfinite(depth)
    near, far = (depth[met].min(), depth[met].max()) if met.any() else (0, 1)
    share = (np.where(met, depth, far) - near) / ((far - near) or 1)
    return np.stack([1 - (1 - _FARTHEST) * share] * 3 + [met], -1)


def _value_shown(value: NDArray[Any]) -> NDArray[Any]:
    met = np.isfinite(value)
    low, high = (value[met].min(), value[met].max()) if met.any() else (0, 1)
    return np.stack([(np.where(met, value, low) - low) / ((high - low) or 1)] * 3 + [met], -1)


def _normal_shown(normal: NDArray[Any]) -> NDArray[Any]:
    met = np.isfinite(normal).all(-1, keepdims=True)
    return np.concatenate([np.where(met, (normal + 1) / 2, 0), met], -1)


def _position_shown(position: NDArray[Any]) -> NDArray[Any]:
    met = np.isfinite(position).all(-1, keepdims=True)
    inside = position[met[..., 0]]
    low, high = (inside.min(0), inside.max(0)) if inside.size else (np.zeros(3), np.ones(3))
    return np.concatenate([np.where(met, (position - low) / np.where(high > low, high - low, 1), 0), met], -1)


def as_pictures(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Picture]:
    """Outputs of a rendering by name, each as a `Picture` of its kind."""
    return {kind: Picture(array, kind) for kind, array in arrays.items()}


def to_bytes(picture: ArrayLike) -> NDArray[np.uint8]:
    """Convert a picture with values in 0..1 to 8 bits, rounded, NaN as 0; an 8-bit picture is unchanged.

    A `Picture` of another kind than colours is converted as displayed.
    """
    try:
        picture = picture.shown() if isinstance(picture, Picture) else picture
        array = np.asarray(picture)
    except (TypeError, ValueError) as error:
        raise OptionError(f"a picture must be a regular array: {error}") from None
    if array.dtype.kind not in "bf" and array.dtype != np.uint8:
        raise OptionError(f"a picture holds floating values in 0..1, or uint8; got dtype {array.dtype}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (1, 3, 4)) or 0 in array.shape:
        raise OptionError(f"a picture has shape (height, width) or (height, width, 1, 3 or 4); got {array.shape}")
    if array.dtype == np.uint8:
        return array
    result = np.empty(array.shape, np.uint8)
    rows = max(1, _AT_ONCE // array[0].size)
    for first in range(0, len(array), rows):
        part = np.s_[first : first + rows]
        result[part] = np.rint(np.clip(np.nan_to_num(array[part]), 0, 1) * 255)
    return result


def save(picture: ArrayLike, path: str | os.PathLike[str]) -> Path:
    """Write a picture with values in 0..1, by suffix: .png, .tif, or .jpg and .bmp, where transparency becomes black; .pdf, .svg.

    The file appears when it is complete. Depth and other outputs of `render` are written as displayed. A PNG file of a picture by
    `clvol.render` says what made it, with the path of the volume's file as seen from its folder: 'clvol render --from' renders it
    again. That of a plain array, ``numpy.array(picture)``, says nothing. In PDF and SVG what stands around a picture is lines and
    letters, over the picture's pixels, 300 to the inch (``pip install "clvol[figures]"``).

    Raises
    ------
    FormatError
        The suffix is unknown, or the file cannot be written.

    Examples
    --------
    >>> import clvol, pathlib, tempfile
    >>> picture = clvol.render(clvol.phantoms.sphere(24), mode="mip", size=(48, 48))
    >>> clvol.save(picture, pathlib.Path(tempfile.mkdtemp()) / "picture.png").exists()
    True
    """
    import imageio.v3 as iio

    path, suffix = as_path(path), require_suffix(path, SUFFIXES, "pictures")
    around = picture.furnished if isinstance(picture, Picture) and suffix in VECTORS else None
    data = stored(picture if around is None else around.bare, opaque=suffix in _OPAQUE)
    with staged(path, suffix) as temporary:
        if suffix in VECTORS:
            temporary.write_bytes(vectors(data, suffix, around))
            return path
        options: dict[str, Any] = {"quality": 95, "subsampling": 0} if suffix in (".jpg", ".jpeg") else {}
        if suffix == ".png" and isinstance(picture, Picture) and picture.recipe is not None:
            options = _with_text(picture.recipe.text(path.absolute().parent))
        stream = io.BytesIO()  # Pillow does not notice where a disk is full
        iio.imwrite(stream, data, extension=suffix, plugin="pillow", **options)
        temporary.write_bytes(stream.getbuffer())
    return path


def _with_text(text: str | None) -> dict[str, Any]:
    """Options of a PNG file with a text."""
    from PIL.PngImagePlugin import PngInfo

    if text is None:
        return {}
    info = PngInfo()
    info.add_text(RECIPE, text)
    return {"pnginfo": info}


def read_recipe(path: str | os.PathLike[str]) -> str:
    """The text in a PNG file that says what made the picture.

    Raises
    ------
    FormatError
        The file is no PNG file, is damaged, has more pixels than Pillow reads, or has no such text, or one that is too long.
    """
    from PIL import Image

    path = as_path(path)
    try:
        with Image.open(path, formats=["PNG"]) as image:
            text = image.info.get(RECIPE)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise FormatError(f"{path} must be a PNG file that clvol wrote: {reason}") from error
    if not isinstance(text, str):
        raise FormatError(
            f"{path} does not say what made it: it must be a PNG file of a picture by clvol.render, with its text {RECIPE!r}, "
            "which other programs leave out"
        )
    if len(text) > LONGEST:
        raise FormatError(f"{path} must say what made it in at most {LONGEST} characters; got {len(text)}")
    return text


def to_png(picture: ArrayLike) -> bytes:
    """A picture as a PNG file in memory."""
    import imageio.v3 as iio

    stream = io.BytesIO()
    iio.imwrite(stream, stored(picture), extension=".png", plugin="pillow")
    return stream.getvalue()


def stored(picture: ArrayLike, opaque: bool = False) -> NDArray[np.uint8]:
    """8-bit values for a file: without a channel axis of length 1, and without opacity if opaque or not supported."""
    data = to_bytes(picture)
    if data.ndim == 3 and data.shape[2] == 1:
        data = data[..., 0]
    if data.ndim == 3 and data.shape[2] == 4 and (opaque or data[..., 3].min() == 255):
        data = over_black(data)
    return data


def show(picture: ArrayLike) -> None:
    """Display a picture: below the cell of a notebook, or in the image viewer of a desktop.

    Without either, save it to a temporary file and print its name.

    Parameters
    ----------
    picture : array-like, shape (height, width) or (height, width, 1, 3 or 4)
        Values in 0..1, or uint8, or an output of `clvol.render`.

    Raises
    ------
    OptionError
        The array is not a picture.
    """
    data = to_png(picture)
    if (display := _notebook()) is not None:
        display({"image/png": data}, raw=True)
    elif not _viewed(data):
        handle, name = tempfile.mkstemp(prefix="clvol-", suffix=".png")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        print(f"clvol: no display is available; the picture is in {name}")


def _notebook() -> Any:
    """IPython's `display` in a notebook, else None."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None or not hasattr(shell, "kernel"):  # plain Python, or IPython on a terminal
        return None
    from IPython.display import display

    return display


def _viewed(png: bytes) -> bool:
    """Open a picture in a viewer; returns whether that worked."""
    from PIL import Image, ImageShow

    if sys.platform not in ("win32", "darwin") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return False  # a text viewer would take over the terminal
    return bool(ImageShow.show(Image.open(io.BytesIO(png)), title="clvol"))


def heat(share: ArrayLike) -> NDArray[np.float32]:
    """Colours for values in 0..1, shape (height, width), from black through red to pale yellow; NaN is grey blue."""
    import cmap

    array = np.asarray(share, np.float32)
    colors = np.asarray(cmap.Colormap("inferno")(np.clip(np.nan_to_num(array), 0, 1)), np.float32)[..., :3]
    colors[np.isnan(array)] = (0.28, 0.33, 0.42)
    return colors


def heat_with_scale(values: ArrayLike, unit: str = "", title: str = "", top: float | None = None) -> NDArray[np.uint8]:
    """Colours for values of at least 0, with a scale in a band below; (height + band, width, 3) uint8.

    NaN, where there is no value, is grey blue. `unit` follows the largest number of the scale, and `title` is below it. `top` is
    the value of the brightest colour, to which larger ones are clipped; by default the smallest of 1, 2 or 5 times a power of ten
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


_SHOWN: Mapping[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "depth": _depth_shown,
    "normal": _normal_shown,
    "position": _position_shown,
    "visited": heat,
    "value": _value_shown,
    "uncertainty": lambda within: heat_with_scale(within[..., 0]),
}


def _round_up(values: NDArray[np.float64]) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that 95 % of the values do not exceed; 1 if they are zero."""
    most = float(np.quantile(values, 0.95)) if values.size else 0.0
    if not most > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(most))
    return next(float(f"{digit * power:.1g}") for digit in (1, 2, 5, 10) if digit * power >= most * (1 - 1e-6))


def labelled(picture: ArrayLike, text: str) -> NDArray[np.uint8]:
    """A picture with one or more lines of text in a band below; (height + band, width, 3) uint8.

    Transparency becomes black.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not isinstance(text, str):
        raise OptionError(f"text must be a string; got {text!r}")
    data = to_bytes(picture)
    data = over_black(data if data.ndim == 3 else data[..., None])
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


def over_black(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Composite 8-bit RGBA, not premultiplied, over black; return anything else unchanged."""
    if data.shape[2] != 4:
        return data
    return np.asarray(np.rint(data[..., :3] * (data[..., 3:] / 255)), np.uint8)


def grid(pictures: Sequence[ArrayLike], columns: int, gap: int = 4) -> NDArray[np.uint8]:
    """Arrange pictures of one size in rows of `columns`, the last row padded with black; 8-bit values."""
    if not isinstance(pictures, Iterable):
        raise OptionError(f"a grid takes one or more pictures of one shape; got {pictures!r}")
    tiles = [to_bytes(p) for p in pictures]
    if not tiles or len({t.shape for t in tiles}) != 1:
        raise OptionError(f"a grid takes one or more pictures of one shape; got {[t.shape for t in tiles]}")
    columns, gap = whole("columns of a grid", columns, 1), whole("gap of a grid", gap, 0)
    height, width, *channels = tiles[0].shape
    rows = -(-len(tiles) // columns)
    count = rows * (height + gap) * columns * (width + gap) * math.prod(channels)
    memory.require(count, f"a sheet of {rows} × {columns} pictures")
    sheet = np.zeros((rows * (height + gap) - gap, columns * (width + gap) - gap, *channels), np.uint8)
    for i, tile in enumerate(tiles):
        y, x = i // columns * (height + gap), i % columns * (width + gap)
        sheet[y : y + height, x : x + width] = tile
    return sheet
