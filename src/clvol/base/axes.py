"""Axis names, which every format and library spells differently."""

from __future__ import annotations

__all__ = ["AXES", "meaning"]

AXES = ("volume", "time", "position", "channel")
"""Meanings of the axes before z, y and x: volumes of a series (of any kind), times, stage positions, channels."""

_WORDS = {
    "x": ("x", "lon", "longitude", "column", "columns", "easting", "width"),
    "y": ("y", "lat", "latitude", "row", "rows", "northing", "length", "height"),
    "z": ("z", "depth", "lev", "level", "plev", "altitude", "slice", "slices", "plane"),
    "time": ("t", "time", "frame", "frames"),
    "channel": ("c", "ch", "channel", "channels", "band", "s", "sample", "component", "bands", "rgb", "rgba"),
    "position": ("p", "position", "scene"),
    "volume": ("volume",),
}
_MEANINGS = {word: meaning for meaning, words in _WORDS.items() for word in words}


def meaning(word: str) -> str:
    """The meaning of an axis name: one of `AXES`, "z", "y" or "x"; "" if unknown."""
    return _MEANINGS.get(word.strip().lower(), "")
