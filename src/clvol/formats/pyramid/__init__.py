"""Pyramids: OME-Zarr stores with a volume in several sizes, and bounds of its function; written brick by brick.

| module    | what                                                            |
|-----------|-----------------------------------------------------------------|
| `reduce`  | the next size, streamed along z                                 |
| `blocks`  | minima and maxima of the function in blocks of cells, by bricks |
| `journal` | the unfinished store, its source, and which parts are done      |
| `make`    | `pyramid`                                                       |
"""

from __future__ import annotations

from clvol.formats.pyramid.make import pyramid as pyramid

__all__ = ["pyramid"]
