"""Samples without a header: the caller says how they are arranged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from clvol.base.checks import one_of
from clvol.base.errors import OptionError
from clvol.bricks.sliced import FlatFile, Window
from clvol.formats._choice import Choice
from clvol.formats._files import require_bytes, sample_count
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["lazily", "read"]

_BYTE_ORDERS = {"little": "<", "big": ">"}


def read(
    path: Path,
    shape: Sequence[int] | None = None,
    dtype: DTypeLike | None = None,
    byte_order: str | None = None,
    offset: int | None = None,
) -> Content:
    """Samples from `offset` to the end of the file, as many as `shape` says.

    They are read, not mapped: if a mapped file shrinks or its disk vanishes, access to the samples ends the process, where reading
    raises an error.
    """
    counts, kind, start = _arranged(path, shape, dtype, byte_order, offset)
    announce(path.name, sample_count(counts) * kind.itemsize)
    if kind.kind == "b":  # any byte but 0 is true, yet NumPy expects 1
        data = np.fromfile(path, np.uint8, sample_count(counts), offset=start) != 0
    else:
        data = np.fromfile(path, kind, sample_count(counts), offset=start)
    return data.reshape(counts), {}


def lazily(
    path: Path,
    choose: Choice,
    shape: Sequence[int] | None = None,
    dtype: DTypeLike | None = None,
    byte_order: str | None = None,
    offset: int | None = None,
) -> list[Content]:
    """As `read`, but samples are read on demand."""
    counts, kind, start = _arranged(path, shape, dtype, byte_order, offset)
    choose(path.name, Leading())  # raises if a volume is chosen
    data: Any = Window(FlatFile(path, counts, kind, start), counts, kind)
    return [(data, {})]


def _arranged(
    path: Path, shape: Sequence[int] | None, dtype: DTypeLike | None, byte_order: str | None, offset: int | None
) -> tuple[tuple[int, ...], np.dtype[np.generic], int]:
    """Shape, dtype and offset, which fit the file."""
    if shape is None or dtype is None:
        raise OptionError("a raw file says nothing about its samples: give shape=(nz, ny, nx) and dtype=")
    counts, kind, start = _shape(shape), _dtype(dtype, byte_order), _offset(0 if offset is None else offset)
    require_bytes(f"{path.name} from offset {start}", path.stat().st_size - start, counts, kind, exact=True)
    return counts, kind, start


def _shape(shape: Sequence[int]) -> tuple[int, ...]:
    try:
        counts = tuple(int(n) for n in shape)
        whole = all(n == m and n > 0 for n, m in zip(counts, shape, strict=True))
    except (TypeError, ValueError, OverflowError):
        counts, whole = (), False
    if not whole or len(counts) not in (2, 3):
        raise OptionError(f"shape must be (nz, ny, nx) or (ny, nx), positive whole numbers; got {shape!r}")
    return counts


def _dtype(dtype: DTypeLike, byte_order: str | None) -> np.dtype[np.generic]:
    try:
        kind = np.dtype(dtype)
    except (TypeError, ValueError) as error:
        raise OptionError(f"dtype must name a type of NumPy; got {dtype!r}") from error
    if kind.kind not in "biuf":
        raise OptionError(f"dtype must be boolean, integer or floating; got {kind}")
    if byte_order is None:
        return kind
    if byte_order not in _BYTE_ORDERS:
        raise one_of("byte_order", byte_order, _BYTE_ORDERS)
    return kind.newbyteorder(_BYTE_ORDERS[byte_order])  # type: ignore[arg-type]  # one of the two above


def _offset(offset: int) -> int:
    if not isinstance(offset, (int, np.integer)) or offset < 0:
        raise OptionError(f"offset must be a whole number of bytes, 0 or more; got {offset!r}")
    return int(offset)
