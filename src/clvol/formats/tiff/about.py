"""What OME-XML and ImageJ's text say of an image in a TIFF file."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.units import scale, unit_name

__all__ = ["DTYPES", "WHITE", "About", "imagej", "ome", "ome_color"]

DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
"""Types of samples that OME has."""

WHITE = (1.0, 1.0, 1.0)
Colors = tuple[tuple[float, float, float] | None, ...]

_OME_DTYPES = {name: name for name in DTYPES if not name.startswith("float")} | {"float": "float32", "double": "float64"}
_PLACE = re.compile(r"^\s*((?:[czt]:\d+/\d+\s*)+)(?:-\s*)?")  # the start of ImageJ's labels of slices


@dataclass(frozen=True)
class About:
    """Metadata of one image: spacing by axis, NaN where unknown; channels; slope and offset of samples."""

    spacing: dict[str, float] = field(default_factory=dict)
    units: str = ""
    deep: bool = False  # one slice has a thickness
    names: tuple[str, ...] = ()
    colors: Colors = ()
    clims: tuple[tuple[float, float], ...] = ()
    slope: float = 1.0
    offset: float = 0.0


def ome(description: str, number: int, count: int, dtype: np.dtype[Any] | None) -> About:
    """Metadata of OME-XML for one of the images that have samples, which are of `dtype`."""

    def below(element: ET.Element, tag: str) -> list[ET.Element]:
        return [child for child in element if child.tag.rpartition("}")[2] == tag]

    images = [pixels for image in below(ET.fromstring(description), "Image") for pixels in below(image, "Pixels")]
    with_samples = [pixels for pixels in images if below(pixels, "TiffData")]
    images = images if len(images) == count else with_samples
    if len(images) != count:
        raise FormatError(f"OME-XML must have an element Pixels for each of {count} images; it has {len(images)}")
    pixels = images[number]
    said = pixels.get("Type", "")
    if dtype is not None and said in _OME_DTYPES and dtype.name != _OME_DTYPES[said]:
        raise FormatError(f"OME-XML must have samples of the type that its TIFF file has, {dtype.name}; it says {said}")
    channels = below(pixels, "Channel")
    names = tuple(channel.get("Name", "") for channel in channels)
    colors = tuple(_color(channel.get("Color")) for channel in channels)
    about = About(names=names if any(names) else (), colors=_telling(colors))
    sizes = {axis: pixels.get(f"PhysicalSize{axis.upper()}") for axis in "xyz"}
    if not any(sizes.values()):
        return about
    units = {axis: unit_name(pixels.get(f"PhysicalSize{axis.upper()}Unit", "µm")) for axis in "xyz"}
    spacing = {axis: float(size) * scale(units[axis], units["x"]) if size else math.nan for axis, size in sizes.items()}
    return replace(about, spacing=spacing, units=units["x"], deep=bool(sizes["z"]))


def imagej(file: Any) -> About:
    """Metadata of ImageJ: samples per unit in TIFF's tags; slices, colour tables and labels of channels in text of its own."""
    metadata, tags = file.imagej_metadata or {}, file.pages.first.tags
    spacing = {}
    for axis in "xy":
        samples, unit = tags[tag].value if (tag := f"{axis.upper()}Resolution") in tags else (1, 1)
        spacing[axis] = unit / samples if samples else math.nan
    if "spacing" in metadata:
        spacing["z"] = abs(float(metadata["spacing"]))
    channels = int(metadata.get("channels", 1))
    counts = {what: int(metadata[what]) for what in ("channels", "slices", "frames") if what in metadata}
    if counts and math.prod(counts.values()) < int(metadata.get("images", 1)):
        found = " × ".join(f"{n} {what}" for what, n in counts.items())
        raise FormatError(f"{file.filename} must say of each of its {metadata['images']} images where it belongs; it has {found}")
    slope, offset = 1.0, 0.0
    if metadata.get("cf") == 0:  # linear calibration; signed samples are stored with c0 = -32768
        slope, offset = float(metadata.get("c1", 1)), float(metadata.get("c0", 0))
    ranges = [float(v) for v in metadata.get("Ranges", (metadata.get("min", 0), metadata.get("max", 0)))]
    clims = tuple((slope * a + offset, slope * b + offset) for a, b in zip(ranges[::2], ranges[1::2], strict=False))
    colors = tuple(_top_of(table) for table in metadata.get("LUTs", ()))
    return About(
        spacing,
        unit_name(str(metadata.get("unit", ""))),
        names=_names(metadata.get("Labels", ()), channels),
        colors=_telling(colors),
        clims=clims if all(-math.inf < a < b < math.inf for a, b in clims) else (),
        slope=slope,
        offset=offset,
    )


def _telling(colors: Colors) -> Colors:
    """The colours, or none if all are white, which is the default of programs and means nothing."""
    return colors if any(color not in (None, WHITE) for color in colors) else ()


def _color(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    number = int(text)
    r, g, b = ((number >> shift & 255) / 255 for shift in (24, 16, 8))
    return r, g, b


def ome_color(color: tuple[float, float, float]) -> int:
    """A colour as OME encodes it: RGBA, 8 bits each, in one signed number."""
    r, g, b = (round(255 * part) for part in color)
    return int(np.array((r << 24) | (g << 16) | (b << 8) | 255, np.uint32).view(np.int32))


def _top_of(table: NDArray[Any]) -> tuple[float, float, float] | None:
    """The last colour of a table that is linear from black, as those of channels are; else None."""
    table = np.asarray(table, np.float64)
    if table.shape != (3, 256):
        return None
    top = table[:, -1]
    straight = np.abs(table - top[:, None] * np.linspace(0, 1, 256)).max() <= 2
    r, g, b = top / 255
    return (r, g, b) if straight and top.any() else None


def _names(labels: Sequence[str], channels: int) -> tuple[str, ...]:
    """Names of channels, if all slices of a channel have the same label; channels vary fastest."""
    if channels < 2 or not labels or len(labels) % channels:
        return ()
    cut = [_PLACE.sub("", str(label or "")).strip() for label in labels]
    names = tuple(cut[:channels])
    same = all(cut[i] == names[i % channels] for i in range(len(cut)))
    return names if same and len(set(names)) == channels else ()
