"""Pyramids of volumes in Zarr stores, made brick by brick: smaller sizes, bounds of the function.

| module    | what                                                                             |
|-----------|----------------------------------------------------------------------------------|
| `levels`  | which sizes there are, and sums along axes for parts of them                       |
| `reduce`  | the next size, streamed along z                                                   |
| `blocks`  | minima and maxima of the function in blocks of cells, by bricks |
| `cache`   | chunks that were unpacked                                                          |
| `journal` | the unfinished store, and what of it is done                                      |
| `make`    | `pyramid`                                                                         |
"""

from __future__ import annotations

from clvol.formats.pyramid.make import pyramid as pyramid

__all__ = ["pyramid"]
