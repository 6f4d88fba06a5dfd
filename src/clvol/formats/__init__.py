"""Reading and writing volumes: one module a file format, found by suffix.

A new format is one module with ``read(path) -> (samples, geometry)`` and, where it can, ``write(volume, path)``, and one row of
`FORMATS`.
"""

from __future__ import annotations

from clvol.formats._choice import Series
from clvol.formats.guarded.limits import Limits
from clvol.formats.reading import allowed, begin_to_read, called, leading_of, read, read_all, series_of
from clvol.formats.table import FORMATS, WRITTEN, Format, format_of, options_of
from clvol.formats.writing import write

__all__ = [
    "FORMATS",
    "WRITTEN",
    "Format",
    "Limits",
    "Series",
    "allowed",
    "begin_to_read",
    "called",
    "format_of",
    "leading_of",
    "options_of",
    "read",
    "read_all",
    "series_of",
    "write",
]
