"""The middle slices of a volume as thumbnails, pictures embedded in HTML, and volumes as notebooks show them."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import html
from clvol.base.errors import DataError
from clvol.base.frames import SPACES
from clvol.show.picture import to_png

if TYPE_CHECKING:
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Volumes

__all__ = ["html_of_volume", "html_of_volumes", "image", "normalized", "slices"]

_SIDE = 160  # Pixels of a thumbnail's longer side.
_TAILS = (0.5, 99.5)  # Percentiles that become black and white where no `clim` is known.
_PLANES = {"LPS": ("axial", "coronal", "sagittal"), "": ("xy", "xz", "yz")}
_SHOWN = 4  # volumes of several with a slice
_DOWN = {"LPS": (1, -1), "image": (1, 1), "": (-1, -1)}  # sign of y, and of z, down the rows of a picture


def image(picture: ArrayLike, caption: str = "") -> str:
    """A picture with a caption, as HTML."""
    data = base64.b64encode(to_png(picture)).decode("ascii")
    words = html.escape(caption)
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{data}" alt="{words}">'
        f'<figcaption style="text-align:center;font-size:smaller">{words}</figcaption></figure>'
    )


def slices(
    data: NDArray[Any],
    spacing: Sequence[float],
    direction: NDArray[np.float64],
    *,
    space: str = "",
    clim: tuple[float, float] | None = None,
    color: tuple[float, float, float] | None = None,
    blended: bool = True,
    all_planes: bool = True,
) -> list[tuple[str, NDArray[np.uint8]]]:
    """The middle slices of a volume across its axes, each with the name of its plane; for an image, the image.

    `space` sets their orientation: a patient as radiologists see it, a stack of images as microscopes show it, else with y
    and z up. `spacing` sets the aspect ratio of voxels. `clim` is what is black and what is white, by default what all but a
    hundredth of the slices' samples lie between, and `color` replaces white. Labels are not `blended`. Without `all_planes` only
    the first plane, across z, is shown.
    """
    if data.ndim == 2:
        return [("", _sized(_shades([data], clim, color)[0], spacing, blended))]
    axes, signs = _towards_world(direction)
    turned = data.transpose([2 - axes[2], 2 - axes[1], 2 - axes[0]])  # arrays are indexed [z, y, x]
    turned = turned[tuple(slice(None, None, signs[k]) for k in (2, 1, 0))]
    x, y, z = (spacing[k] for k in axes)
    along_y, along_z = (slice(None, None, step) for step in _DOWN[space])
    middle = [n // 2 for n in turned.shape]
    cut = [
        (turned[middle[0]][along_y], (x, y)),
        (turned[:, middle[1]][along_z], (x, z)),
        (turned[:, :, middle[2]][along_z], (y, z)),
    ]
    names = _PLANES.get(space, _PLANES[""])
    shades = _shades([part for part, _ in (cut if all_planes else cut[:1])], clim, color)
    return [(name, _sized(shade, sides, blended)) for name, shade, (_, sides) in zip(names, shades, cut, strict=False)]


def normalized(values: ArrayLike, low: float, high: float) -> NDArray[np.float64]:
    """Values from 0 where they are `low` to 1 where they are `high`; NaN is 0."""
    array = np.nan_to_num(np.asarray(values, np.float64), nan=low, posinf=high, neginf=low)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.clip(np.nan_to_num((array / 2 - low / 2) / (high / 2 - low / 2)), 0, 1))


def _towards_world(direction: NDArray[np.float64]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """For the world's x, y and z: the index axis closest to it, and the sign of its direction."""
    axes = max(itertools.permutations(range(3)), key=lambda p: sum(abs(direction[i, p[i]]) for i in range(3)))
    return axes, tuple(1 if direction[i, axes[i]] >= 0 else -1 for i in range(3))


def _shades(
    parts: Sequence[NDArray[Any]], clim: tuple[float, float] | None, color: tuple[float, float, float] | None
) -> list[NDArray[np.uint8]]:
    """Slices in eight bits, grey or in a colour."""
    if clim is None:
        values = np.concatenate([part.ravel() for part in parts]).astype(np.float64)
        values = values[np.isfinite(values)]
        low, high = (float(v) for v in np.percentile(values, _TAILS)) if values.size else (0.0, 1.0)
        if not low < high and values.size:  # nearly all samples are background
            low, high = float(values.min()), float(values.max())
        clim = (low, high) if low < high else (low - 1, low)
    grey = [normalized(part, *clim) for part in parts]
    shades = grey if color is None else [part[..., None] * np.asarray(color) for part in grey]
    return [np.asarray(np.rint(shade * 255), np.uint8) for shade in shades]


def _sized(picture: NDArray[np.uint8], sides: Sequence[float], blended: bool) -> NDArray[np.uint8]:
    """Resize a slice to square pixels and a fixed longer side; `sides` are those of its voxels, (width, height)."""
    from PIL import Image

    height, width = picture.shape[0] * sides[1], picture.shape[1] * sides[0]
    scale = _SIDE / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    method = Image.Resampling.BICUBIC if blended else Image.Resampling.NEAREST
    return np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize(size, method))


# -- for notebooks; no device is used ----------------------------------------------------------------------


def html_of_volume(volume: Volume) -> str:
    """Three middle slices, facts and the histogram."""
    try:
        low, high = volume.value_range
        values = f"{low:.6g} to {high:.6g}" + ("" if np.isfinite(volume.limits).all() else ", some not finite")
        counts = html.histogram(volume.data, low, high)
    except DataError:
        values, counts = "none is finite", ""
    known = {
        "name": volume.name,
        "samples": _samples(volume) + (", labels" if _are_labels(volume) else ""),
        "spacing": _spacing(volume),
        "origin": html.numbers(volume.origin, ", ") if any(volume.origin) else "",
        "space": _space(volume),
        "values": values,
        "clim": html.numbers(volume.clim, " to ") if volume.clim else "",
    }
    pictures = (image(picture, plane) for plane, picture in _slices(volume))
    return html.beside(*pictures, html.facts("Volume" if volume.ndim == 3 else "Image", known), counts)


def html_of_volumes(volumes: Volumes) -> str:
    """The middle slices of the first few volumes, and facts about all."""
    first = volumes.grid
    known = {
        "volumes": str(volumes.leading),
        "samples of each": _samples(first),
        "spacing": _spacing(first),
        "space": _space(first),
    }
    pictures = [
        image(_slices(volume, all_planes=False)[0][1], f"{number} {volume.name}".strip())
        for number, volume in enumerate(volumes[:_SHOWN])
    ]
    return html.beside(*pictures, html.facts("Volumes", known))


def _samples(volume: Volume) -> str:
    return f"{html.numbers(volume.shape)} {volume.data.dtype}"


def _spacing(volume: Volume) -> str:
    return f"{html.numbers(volume.spacing)} {volume.units}"


def _space(volume: Volume) -> str:
    return f"{volume.space}: {SPACES[volume.space]}" if volume.space else ""


def _are_labels(volume: Volume) -> bool:
    """Whether it says so: nothing is computed to find out."""
    return volume.labels not in (None, False)


def _slices(volume: Volume, *, all_planes: bool = True) -> list[tuple[str, NDArray[Any]]]:
    about: dict[str, Any] = {"space": volume.space, "clim": volume.clim, "color": volume.color, "blended": not _are_labels(volume)}
    return slices(volume.data, volume.spacing, volume.direction, **about, all_planes=all_planes)
