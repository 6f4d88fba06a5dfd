"""Names of axes, which every format and library spells in its own way."""

from __future__ import annotations

__all__ = ["AXES", "meaning"]

AXES = ("volume", "time", "position", "channel")
"""What an axis before z, y and x may count: the volumes of a series (of any meaning), times, positions of the stage, channels."""

_WORDS = {
    "x": ("x", "lon", "longitude", "column", "columns", "easting", "width"),
    "y": ("y", "lat", "latitude", "row", "rows", "northing", "length", "height"),
    "z": ("z", "depth", "lev", "level", "plev", "altitude", "slice", "slices", "plane"),
    "time": ("t", "time", "frame", "frames"),
    "channel": ("c", "ch", "channel", "channels", "band", "s", "sample", "component"),
    "position": ("p", "position", "scene"),
    "volume": ("volume",),
}
_MEANINGS = {word: meaning for meaning, words in _WORDS.items() for word in words}


def meaning(word: str) -> str:
    """What an axis of this name counts: one of `AXES`, "z", "y" or "x"; "" where that is not known."""
    return _MEANINGS.get(word.strip().lower(), "")
