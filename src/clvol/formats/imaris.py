"""Imaris 5.5 files (``.ims``), which are HDF5: an array for each level, time and channel, padded to whole chunks."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.units import unit_name
from clvol.bricks.sliced import Index, Window
from clvol.formats._choice import Choice, chosen_level
from clvol.formats._files import unplaced_by
from clvol.formats._layout import Layout
from clvol.formats.hdf5 import loaded, member, opened, part_of
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["lazily", "read"]


def read(path: Path, choose: Choice, level: int = 0) -> Content:
    """The chosen times and channels, in Imaris's geometry."""
    with opened(path) as file:
        return _content(path, file, choose, level, _load)


def lazily(path: Path, choose: Choice, level: int = 0) -> list[Content]:
    """As `read`, in all levels from `level` on, but samples are read on demand."""
    file = opened(path)

    def load(times: list[Any], size: tuple[int, ...], index: Index) -> Window:
        at_time, at_channel, *_ = index
        if not (isinstance(at_time, int) and isinstance(at_channel, int)):
            raise FormatError(f"{path.name} is read part by part one volume at a time")
        stored = member(_numbered(times[at_time], "Channel")[at_channel], "Data")
        return part_of(path, path.name, stored, tuple(slice(0, n) for n in size))

    first = _content(path, file, choose, level, load)
    count = len(_numbered(member(file, "DataSet"), "ResolutionLevel"))
    return [first, *(_content(path, file, choose, number, load) for number in range(level + 1, count))]


def _content(path: Path, file: Any, choose: Choice, level: int, load: Callable[..., Any]) -> Content:
    """One level; `load` returns its samples."""
    if "DataSet" not in file or "DataSetInfo/Image" not in file:
        raise FormatError(f"{path.name} must be of Imaris 5.5 or later, which has the groups DataSet and DataSetInfo")
    levels = _numbered(member(file, "DataSet"), "ResolutionLevel")
    sizes = [_size(_numbered(_numbered(one, "TimePoint")[0], "Channel")[0]) for one in levels]
    number = chosen_level(path.name, sizes, level)
    times, size = _numbered(levels[number], "TimePoint"), sizes[number]
    channels = len(_numbered(times[0], "Channel"))
    layout = Layout(("time" * (len(times) > 1), "channel", "z", "y", "x"), (len(times), channels, *size))
    data, chosen = layout.chosen(path.name, choose, lambda index: load(times, size, index), _leading(file, layout))
    about = member(member(file, "DataSetInfo"), "Image")
    low, high = (np.array([float(_text(about, f"Ext{end}{i}")) for i in range(3)]) for end in ("Min", "Max"))
    unit = unit_name(_text(about, "Unit", "um"))
    spacing = (high - low) / size[::-1]  # from edge to edge
    known = {"spacing": spacing, "origin": low + spacing / 2, "units": unit, "space": "image"}
    return data, known | unplaced_by("ExtMax less ExtMin, of an image's extent,", high - low) | chosen


def _numbered(group: Any, word: str) -> list[Any]:
    """The members "word 0", "word 1", ..."""
    found = [member(group, name) for name in (f"{word} {i}" for i in range(len(group))) if name in group]
    if not found:
        raise FormatError(f"{group.name} must hold {word!r} 0 and so on; it holds none")
    return found


def _size(channel: Any) -> tuple[int, int, int]:
    """Samples along z, y and x, without padding."""
    stored = member(channel, "Data").shape
    z, y, x = (int(_text(channel, f"ImageSize{axis}", str(n))) for axis, n in zip("ZYX", stored, strict=True))
    if not all(0 < n <= m for n, m in zip((z, y, x), stored, strict=True)):
        raise FormatError(f"{channel.name} must hold {z} × {y} × {x} samples; its array has the shape {stored}")
    return z, y, x


def _load(times: list[Any], size: tuple[int, ...], index: tuple[int | slice, ...]) -> NDArray[Any]:
    at_time, at_channel, *grid = index
    box = tuple(slice(0, n) for n in size)

    def some(nodes: list[Any], at: int | slice) -> list[Any]:
        return nodes[at] if isinstance(at, slice) else [nodes[at]]

    taken = [
        [loaded(channel.name, member(channel, "Data"), box) for channel in some(_numbered(time, "Channel"), at_channel)]
        for time in some(times, at_time)
    ]
    kept = tuple(slice(None) if isinstance(at, slice) else 0 for at in (at_time, at_channel))
    return np.asarray(np.asarray(taken)[(*kept, *grid)])


def _leading(file: Any, layout: Layout) -> Leading:
    """The leading axes, with names, colours and `clim` of channels."""
    infos = [file.get(f"DataSetInfo/Channel {i}") for i in range(layout.shape[1])]
    texts = [{key: "" if one is None else _text(one, key, "") for key in ("Name", "Color", "ColorRange")} for one in infos]
    names = tuple(text["Name"] for text in texts)
    colors, clims = [], []
    for text in texts:
        color = [float(part) for part in text["Color"].split()]
        clim = [float(part) for part in text["ColorRange"].split()]
        colors.append((color[0], color[1], color[2]) if len(color) == 3 and all(0 <= c <= 1 for c in color) else None)
        clims.append((clim[0], clim[1]) if len(clim) == 2 and -math.inf < clim[0] < clim[1] < math.inf else None)
    return Leading(layout.leading, layout.counts, {"channel": names} if any(names) else {}, tuple(colors), tuple(clims))


def _text(node: Any, key: str, default: str | None = None) -> str:
    """A text attribute, which Imaris stores as an array of letters."""
    if key not in node.attrs:
        if default is not None:
            return default
        raise FormatError(f"{node.name} must have the attribute {key!r}; it has none")
    value = node.attrs[key]
    return value if isinstance(value, str) else np.asarray(value).tobytes().decode("utf-8", "replace").strip("\0 ")
