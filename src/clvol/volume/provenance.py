"""Where volumes are from, so that a picture can say what it shows: a path with options of `clvol.read`, and a sum of samples."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from clvol.volume.volume import Volume

__all__ = ["Provenance", "facts_of", "note", "note_masked", "provenance_of", "recognise", "sum_of"]

Provenance: TypeAlias = Mapping[str, Any]
"""Its "path", and options with which it was read; of a masked one that of its "mask", with the labels "where" it is seen."""

_SUMMED = 1 << 11  # samples along each axis, at most, that enter a sum
_NOT_NOTED = ("trusted", "limits", "storage_options")  # whoever reads it again decides


def note(volume: Any, path: object, options: Mapping[str, Any]) -> None:
    """Note from where a Volume or LazyVolume was read. A part or a changed copy is another volume, of which nothing is known."""
    given = {
        name: str(np.dtype(value)) if name == "dtype" else str(value) if isinstance(value, os.PathLike) else value
        for name, value in options.items()
        if value is not None and name not in _NOT_NOTED and name != "path" and (name, value) != ("offset", 0)
        if not isinstance(value, Mapping)  # a table of labels, whose colours a picture has
    }
    vars(volume)["_provenance"] = {"path": str(path), **given}


def note_masked(masked: Any, volume: Any, mask: object, where: object) -> None:
    """Note from where a volume and a mask are, of which another was made; nothing, unless both are known."""
    known = provenance_of(volume)
    labels = provenance_of(mask) if isinstance(mask, Volume) else None
    if known is not None and labels is not None and masked is not volume:
        seen = None if where is None else np.atleast_1d(np.asarray(where)).tolist()
        vars(masked)["_provenance"] = {**known, "mask": dict(labels), "where": seen}


def provenance_of(volume: Any) -> Provenance | None:
    """What was noted of a volume."""
    known: Provenance | None = vars(volume).get("_provenance")
    return known


def facts_of(volume: Volume, preview: Volume) -> dict[str, Any]:
    """By which a volume is recognised: its grid, and a sum of samples of its preview."""
    names = ("shape", "spacing", "origin", "direction", "units", "space")
    known = {name: getattr(volume, name) for name in names}
    return known | {"dtype": volume.data.dtype.newbyteorder("=").str[1:], "sum": sum_of(preview)}


def recognise(known: Volume, preview: Volume, given: object) -> None:
    """Let what is known of a volume that is read by parts be recognised as it is: by its preview, and where it came from."""
    vars(known)["_sum"] = sum_of(preview)
    if (source := provenance_of(given)) is not None:
        vars(known)["_provenance"] = source


def sum_of(volume: Volume) -> int:
    """The CRC-32 of evenly spaced samples, the same in any byte order."""
    if "_sum" not in vars(volume):
        some = volume.data[tuple(slice(None, None, -(-n // _SUMMED)) for n in volume.shape)]
        total = 0
        for part in some:
            total = zlib.crc32(np.ascontiguousarray(part, part.dtype.newbyteorder("<")).view(np.uint8).data, total)
        vars(volume)["_sum"] = total
    return int(vars(volume)["_sum"])
