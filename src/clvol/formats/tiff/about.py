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

__all__ = ["DTYPES", "WHITE", "About", "check", "imagej", "ome", "ome_color"]

DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
"""Types of samples that OME has."""

WHITE = (1.0, 1.0, 1.0)
Colors = tuple[tuple[float, float, float] | None, ...]

_OME_DTYPES = {name: name for name in DTYPES if not name.startswith("float")} | {"float": "float32", "double": "float64"}
_COUNTED = ("channels", "slices", "frames")
_PLACE = re.compile(r"^\s*((?:[czt]:\d+/\d+\s*)+)(?:-\s*)?")  # the start of ImageJ's labels of slices


@dataclass(frozen=True)
class About:
    """Metadata of one image: spacing by axis, NaN where it is missing among others; channels; slope and offset of samples."""

    spacing: dict[str, float] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)  # as they are spelled
    wrong: dict[str, str] = field(default_factory=dict)  # what was found for a spacing that is no positive number
    deep: bool = False  # one slice has a thickness
    names: tuple[str, ...] = ()
    colors: Colors = ()
    clims: tuple[tuple[float, float], ...] = ()
    slope: float = 1.0
    offset: float = 0.0


def ome(name: str, description: str, number: int, count: int, dtype: np.dtype[Any] | None) -> About:
    """Metadata of the OME-XML of a file for one of the images that have samples, which are of `dtype`."""
    images = _pixels(description)
    with_samples = [pixels for pixels in images if _below(pixels, "TiffData")]
    images = images if len(images) == count else with_samples
    if len(images) != count:
        raise FormatError(f"the OME-XML of {name} must have an element Pixels for each of {count} images; it has {len(images)}")
    pixels = images[number]
    said = pixels.get("Type", "")
    if dtype is not None and said in _OME_DTYPES and dtype.name != _OME_DTYPES[said]:
        raise FormatError(f"the OME-XML of {name} must have samples of the type that its pages have, {dtype.name}; it says {said}")
    channels = _below(pixels, "Channel")
    names = tuple(channel.get("Name", "") for channel in channels)
    colors = tuple(_color(name, channel.get("Color")) for channel in channels)
    about = About(names=names if any(names) else (), colors=_telling(colors))
    sizes = {axis: pixels.get(f"PhysicalSize{axis.upper()}") or "" for axis in "xyz"}
    if not any(sizes.values()):
        return about
    units = {axis: pixels.get(f"PhysicalSize{axis.upper()}Unit", "µm") for axis, size in sizes.items() if size}
    spacing, wrong = _lengths({axis: (f"PhysicalSize{axis.upper()}", size) for axis, size in sizes.items()})
    return replace(about, spacing=spacing, units=units, wrong=wrong, deep=bool(sizes["z"]))


def check(name: str, file: Any) -> None:
    """Raise if the text of OME or ImageJ in a file lacks whole numbers that it must have; tifffile's errors would not name them."""
    description = file.ome_metadata
    if not description:
        for what in ("images", *_COUNTED):
            _whole(f"ImageJ's text in {name}", what, (file.imagej_metadata or {}).get(what, 1), 1)
        return
    try:
        images = _pixels(description)
    except ET.ParseError as error:
        raise FormatError(f"the OME-XML of {name} must be well-formed XML; found {error}") from error
    for pixels in images:
        order = pixels.get("DimensionOrder", "")
        if sorted(order) != sorted("XYZCT"):
            raise FormatError(f"the OME-XML of {name} must give a DimensionOrder of the letters XYZCT; found {order!r}")
        for axis in order:
            _whole(f"the OME-XML of {name}", f"Size{axis}", pixels.get(f"Size{axis}", ""), 1)
        for channel in _below(pixels, "Channel"):
            _whole(f"the OME-XML of {name}", "SamplesPerPixel of a Channel", channel.get("SamplesPerPixel", "1"), 1)
        for data in _below(pixels, "TiffData"):
            for key in ("IFD", "PlaneCount", *(f"First{axis}" for axis in "ZCT")):
                _whole(f"the OME-XML of {name}", f"{key} of a TiffData", data.get(key, "0"), 0)


def _below(element: ET.Element, tag: str) -> list[ET.Element]:
    return [child for child in element if child.tag.rpartition("}")[2] == tag]


def _pixels(description: str) -> list[ET.Element]:
    return [pixels for image in _below(ET.fromstring(description), "Image") for pixels in _below(image, "Pixels")]


def _whole(source: str, key: str, value: object, low: int = -(1 << 63)) -> int:
    try:
        number = int(str(value))
    except ValueError:
        number = low - 1
    if number < low:
        raise FormatError(f"{source} must give a whole number{f' of at least {low}' * (low >= 0)} for {key}; found {value!r}")
    return number


def _lengths(said: dict[str, tuple[str, str]]) -> tuple[dict[str, float], dict[str, str]]:
    """Spacing by axis from the name of a field and its text: NaN if there is none, 0 if it is no positive number; what is wrong."""
    spacing, wrong = {}, {}
    for axis, (key, text) in said.items():
        try:
            spacing[axis] = float(text) if text else math.nan
        except ValueError:
            spacing[axis] = 0.0
        if text and not 0 < spacing[axis] < math.inf:
            spacing[axis], wrong[axis] = 0.0, f"{key} must be a positive finite number; found {text!r}"
    return spacing, wrong


def imagej(name: str, file: Any) -> About:
    """Metadata of ImageJ: samples per unit in TIFF's tags; slices, colour tables and labels of channels in text of its own."""
    metadata, tags = file.imagej_metadata or {}, file.pages.first.tags
    text = f"ImageJ's text in {name}"
    said = {}
    for axis in "xy":
        samples, unit = tags[tag].value if (tag := f"{axis.upper()}Resolution") in tags else (1, 1)
        said[axis] = (tag, repr(unit / samples) if samples else "")
    if "spacing" in metadata:
        said["z"] = ("spacing", str(metadata["spacing"]).removeprefix("-"))
    spacing, wrong = _lengths(said)
    unit = str(metadata.get("unit", "")) or "pixel"
    counts = {what: _whole(text, what, metadata[what]) for what in _COUNTED if what in metadata}
    if counts and math.prod(counts.values()) < _whole(text, "images", metadata.get("images", 1)):
        found = " × ".join(f"{n} {what}" for what, n in counts.items())
        raise FormatError(f"{name} must say of each of its {metadata['images']} images where it belongs; it has {found}")
    slope, offset = 1.0, 0.0
    if metadata.get("cf") == 0:  # linear calibration; signed samples are stored with c0 = -32768
        slope, offset = (_real(text, key, metadata.get(key, usual)) for key, usual in (("c1", 1), ("c0", 0)))
    ranges = [_real(text, "min and max", v) for v in metadata.get("Ranges", (metadata.get("min", 0), metadata.get("max", 0)))]
    clims = tuple((slope * a + offset, slope * b + offset) for a, b in zip(ranges[::2], ranges[1::2], strict=False))
    colors = tuple(_top_of(table) for table in metadata.get("LUTs", ()))
    return About(
        spacing,
        {axis: str(metadata.get(f"{axis}unit", unit)) for axis in "xyz"},
        wrong,
        names=_names(metadata.get("Labels", ()), counts.get("channels", 1)),
        colors=_telling(colors),
        clims=clims if all(-math.inf < a < b < math.inf for a, b in clims) else (),
        slope=slope,
        offset=offset,
    )


def _real(source: str, key: str, value: object) -> float:
    try:
        return float(str(value))
    except ValueError as error:
        raise FormatError(f"{source} must give a number for {key}; found {value!r}") from error


def _telling(colors: Colors) -> Colors:
    """The colours, or none if all are white, which is the default of programs and means nothing."""
    return colors if any(color not in (None, WHITE) for color in colors) else ()


def _color(name: str, text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    number = _whole(f"the OME-XML of {name}", "Color of a Channel", text)
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
