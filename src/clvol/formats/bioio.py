"""Microscope vendors' files (CZI, LIF, ND2, ...), by bioio and its plug-ins, one per vendor."""

from __future__ import annotations

import logging
import math
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._files import bytes_at
from clvol.formats._layout import lay_out
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["SUFFIXES", "read", "series"]

_JAVA = "bioio-bioformats"  # reads almost all, in Java
_PLUGINS = {
    ".czi": "bioio-czi",
    ".lif": "bioio-lif",
    ".nd2": "bioio-nd2",
    ".dv": "bioio-dv",
    ".r3d": "bioio-dv",
    ".sldy": "bioio-sldy",
    ".lsm": _JAVA,
    ".oib": _JAVA,
    ".oif": _JAVA,
    ".vsi": _JAVA,
}

_BLUE_FIRST = (".czi",)  # files with colours blue, green, red, which the plug-in returns in that order

SUFFIXES = tuple(_PLUGINS)
"""Suffixes of the files that are read, if the plug-in is installed."""


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """The chosen planes of one scene, in micrometres."""
    image = _opened(path)
    listed = _scenes(image)
    number = chosen_series(path.name, listed, series, what="scenes")
    image.set_scene(number)
    levels = sorted(image.resolution_levels)
    sizes = []
    for each in levels:
        image.set_resolution_level(each)
        sizes.append(tuple(image.shape))
    image.set_resolution_level(levels[chosen_level(path.name, sizes, level)])
    if image.dtype.kind not in "biuf":
        raise DataError(f"{path.name} must hold real numbers; got dtype {image.dtype}")
    order, shape = image.dims.order, tuple(image.shape)
    names = tuple(str(name or "") for name in image.channel_names or ())
    words = ["" if axis == "C" and "S" in order and n == 1 else axis for axis, n in zip(order, shape, strict=True)]
    sizes_um = {axis: getattr(image.physical_pixel_sizes, axis.upper()) for axis in "xyz"}
    spacing = {axis: float(size or math.nan) for axis, size in sizes_um.items()} if any(sizes_um.values()) else {}
    layout = lay_out(path.name, words, shape, ("channel",) if any(names) else ()).saying_where_spacing_is_missing(spacing)
    channels = layout.shape[layout.axes.index("channel")] if "channel" in layout.axes else 0
    leading = Leading(layout.leading, layout.counts, {"channel": names} if any(names) and len(names) == channels else {})
    if "S" in order and channels in (3, 4):
        leading = layout.in_colour

    def load(index: tuple[int | slice, ...]) -> NDArray[Any]:
        whole = (slice(None),) * len(shape)
        announce(path.name, bytes_at(shape, whole if "S" in order else index, image.dtype))
        if "S" not in order:
            return np.asarray(image.dask_data[index])
        samples = image.data  # bioio-czi 3.0 returns one colour for all three when it reads parts
        return np.asarray((samples[..., ::-1] if path.suffix.lower() in _BLUE_FIRST else samples)[index])

    data, chosen = layout.chosen(path.name, choose, load, leading)
    known: dict[str, Any] = {"space": "image", "name": listed[number].id if len(listed) > 1 else ""}
    if spacing:
        known |= {"spacing": layout.of({axis: 1.0 if math.isnan(size) else size for axis, size in spacing.items()}), "units": "um"}
    return data, known | chosen


def series(path: Path) -> tuple[Series, ...]:
    """The scenes of a file."""
    return _scenes(_opened(path))


def _scenes(image: Any) -> tuple[Series, ...]:
    found = []
    for number, name in enumerate(image.scenes):
        image.set_scene(number)
        found.append(Series(str(name), image.dims.order, tuple(image.shape)))
    return tuple(found)


def _opened(path: Path) -> Any:
    """The image as bioio opens it. The plug-in is given explicitly, for bioio's own search does not report what failed."""
    suffix = path.suffix.lower()
    plugin = _PLUGINS[suffix]
    module = plugin.replace("-", "_")
    missing = [name for name in ("bioio", module) if find_spec(name) is None]
    if missing:
        extra = '"clvol[bioio]"' if plugin == "bioio-czi" else f'"clvol[bioio]" {plugin}'
        raise MissingDependencyError(f"{suffix} files need bioio and its plug-in {plugin}: pip install {extra}")
    logger = logging.getLogger("bioio.bio_image")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)  # it logs what it raises
    try:
        return import_module("bioio").BioImage(path, reader=import_module(module).Reader)
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[-1].strip(" -")
        raise FormatError(f"{path.name} is damaged or unusual, says {plugin}: {reason}") from error
    finally:
        logger.setLevel(level)
