"""OME-Zarr metadata (0.1 to 0.5): axes, placement, channels and labels of an image, from the attributes of its group alone."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from clvol.base.errors import FormatError
from clvol.base.frames import SPACES
from clvol.formats._bounds import KEY
from clvol.formats._layout import Layout, lay_out, place
from clvol.volume.volumes import Leading

__all__ = ["described", "labels_of", "metadata_of", "placed"]

_OLD_AXES = "tczyx"  # of OME-Zarr 0.1 and 0.2, which name none


def metadata_of(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """OME metadata of a group: since 0.5 under one key, before among other attributes."""
    return dict(attributes.get("ome", attributes))


def described(
    source: str,
    attributes: Mapping[str, Any],
    multiscales: Mapping[str, Any],
    level: int,
    shape: Sequence[int],
    keep: Collection[str] = (),
) -> tuple[Layout, Leading, dict[str, Any]]:
    """Axes of the array of one size; names, colours and `clim` of its channels; and arguments of `Volume`.

    `attributes` are the group's, `multiscales` is one entry of those. Axes to `keep` stay even if they have one sample. Metadata
    that contradict themselves or the array's `shape` are a `FormatError`.
    """
    ome = metadata_of(attributes)
    given = multiscales.get("axes") or list(_OLD_AXES[-len(shape) :])
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in given]
    words = [axis["type"] if axis.get("type") in ("time", "channel") else axis["name"] for axis in axes]
    channels = ome.get("omero", {}).get("channels", [])
    layout = lay_out(source, words, shape, [*("channel",) * bool(channels), *keep])
    factors, shifts = placed(source, multiscales, level, len(shape))
    lines = {axis: (shift, factor) for axis, factor, shift in zip(layout.axes, factors, shifts, strict=True)}
    units = {axis: str(one.get("unit") or "") for axis, one in zip(layout.axes, axes, strict=True)}
    known: dict[str, Any] = {"space": "image"} | place(source, layout, lines, units)
    if len(channels) == 1 and "channel" not in layout.axes:
        known |= _leading(Layout(("channel",), (1,)), channels).about([0])
    if attributes.get(KEY) and layout.axes == ("z", "y", "x"):  # clvol.pyramid wrote it
        known |= _of_pyramid(attributes[KEY], known)
    return layout, _leading(layout, channels), known


def placed(source: str, multiscales: Mapping[str, Any], level: int, ndim: int) -> tuple[list[float], list[float]]:
    """Spacing and origin along each axis: the transformations of a size, then those of the image, composed."""
    factors, shifts = [1.0] * ndim, [0.0] * ndim
    for step in (
        *multiscales["datasets"][level].get("coordinateTransformations", ()),
        *multiscales.get("coordinateTransformations", ()),
    ):
        kind = step.get("type")
        numbers = step.get(kind)
        valid = isinstance(numbers, list) and len(numbers) == ndim and all(isinstance(n, (int, float)) for n in numbers)
        if kind == "scale" and valid:
            factors = [a * b for a, b in zip(factors, numbers, strict=True)]
            shifts = [a * b for a, b in zip(shifts, numbers, strict=True)]
        elif kind == "translation" and valid:
            shifts = [a + b for a, b in zip(shifts, numbers, strict=True)]
        elif kind != "identity":
            raise FormatError(f"{source} must place its axes by a scale and a translation of {ndim} numbers; got {step}")
    if any(factor < 0 for factor in factors):
        raise FormatError(f"{source} must have scales that are positive; got {factors}")
    return [float(factor) for factor in factors], [float(shift) for shift in shifts]


def labels_of(attributes: Mapping[str, Any]) -> dict[int, Any]:
    """Rows of label values: names, where their properties have one, and colours with opacities."""
    about = metadata_of(attributes).get("image-label", {})
    rows: dict[int, Any] = {}
    for one in about.get("colors", ()):
        if "label-value" in one and _is_rgba(one.get("rgba")):
            *color, opacity = (part / 255 for part in one["rgba"])
            rows[int(one["label-value"])] = None, color, opacity
    for one in about.get("properties", ()):
        name = next((one[key] for key in ("name", "class", "label") if isinstance(one.get(key), str)), None)
        if name is not None and "label-value" in one:
            label = int(one["label-value"])
            rows[label] = name, *rows.get(label, (None,))[1:]
    return rows


def _is_rgba(value: object) -> bool:
    return isinstance(value, (list, tuple)) and len(value) == 4 and all(isinstance(v, int) and 0 <= v <= 255 for v in value)


def _of_pyramid(given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """What OME-Zarr cannot express: the direction of the axes, and their space."""
    about: dict[str, Any] = {"space": given["space"]} if given.get("space") in SPACES else {"space": ""}
    if "direction" in given:
        direction = np.asarray(given["direction"], np.float64)
        about |= {"direction": direction, "origin": (direction @ known["origin"]).tolist()}
    return about


def _leading(layout: Layout, channels: Sequence[Mapping[str, Any]]) -> Leading:
    """The leading axes, with names, colours and `clim` of channels as `omero` has them."""
    if "channel" not in layout.axes or len(channels) != layout.shape[layout.axes.index("channel")]:
        return Leading(layout.leading, layout.counts)
    names = tuple(str(channel.get("label") or "") for channel in channels)
    colors = tuple(_color(channel.get("color")) for channel in channels)
    clims = tuple(_clim(channel.get("window") or {}) for channel in channels)
    return Leading(
        layout.leading,
        layout.counts,
        {"channel": names} if any(names) else {},
        colors if any(color not in (None, (1.0, 1.0, 1.0)) for color in colors) else (),
        clims if any(clims) else (),
    )


def _clim(window: Mapping[str, Any]) -> tuple[float, float] | None:
    low, high = window.get("start"), window.get("end")
    return (float(low), float(high)) if low is not None and high is not None and -math.inf < low < high < math.inf else None


def _color(text: str | None) -> tuple[float, float, float] | None:
    if not isinstance(text, str) or not re.fullmatch(r"#?[0-9a-fA-F]{6}([0-9a-fA-F]{2})?", text):
        return None
    r, g, b = (int(text.removeprefix("#")[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return r, g, b
