"""Shapes and positions of results: the geometry of `affine_transform`, `shift`, `zoom` and `rotate`, rounded as SciPy rounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import flag
from clvol.base.errors import OptionError, OptionTypeError, RefusedError
from clvol.ndimage.arguments import Array, as_matrix, finite, per_axis, require_addressable

__all__ = ["diagonal", "magnified", "placed", "plane_of", "require_rank", "shifted", "turned", "zoomed"]


def require_rank(ndim: int, result: int) -> None:
    """Refuse an input or a result without axes."""
    if ndim < 1 or result < 1:
        raise RefusedError(f"input and the result must have at least one axis; got {ndim} and {result}")


def placed(
    matrix: ArrayLike, offset: float | Sequence[float] | Array, ndim: int, result: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The matrix and offset of `affine_transform`, for `ndim` axes of the input and `result` axes of the result.

    A diagonal matrix may have one axis.
    """
    table = as_matrix(matrix)
    if table.ndim == 2 and table.shape[1] == ndim + 1 and table.shape[0] in (ndim, ndim + 1):
        if len(table) == ndim + 1 and table[ndim].tolist() != [0] * ndim + [1]:
            raise OptionError(f"the last row of a homogeneous matrix must be {[0] * ndim + [1]}; got {table[ndim].tolist()}")
        start = table[:ndim, ndim]
        table = table[:ndim, :ndim]
    else:
        start = np.array(per_axis("offset", offset, ndim), np.float64)
    if len(table) != ndim:
        raise RefusedError(f"matrix must have a row for each of the {ndim} axes of input; got shape {table.shape}")
    if table.shape[-1] != result:
        raise RefusedError(f"matrix must have a column for each of the {result} axes of the result; got shape {table.shape}")
    return table, start


def diagonal(table: Array, start: Array, before: Sequence[int], after: Sequence[int]) -> list[Array | None]:
    """Positions along each axis by a diagonal matrix; None where they are those of the samples."""
    return [
        None if (scale, first, size) == (1, 0, length) else _scaled(size, scale, first)
        for scale, first, size, length in zip(table.tolist(), start.tolist(), after, before, strict=True)
    ]


def shifted(shift: float | Sequence[float] | Array, shape: Sequence[int]) -> list[Array | None]:
    """Positions along each axis of `shift`; None where they are those of the samples."""
    by = per_axis("shift", shift, len(shape))
    _require_positions(max(shape))
    return [None if one == 0 else np.arange(n) - float(one) for one, n in zip(by, shape, strict=True)]


def zoomed(zoom: float | Sequence[float] | Array, shape: Sequence[int]) -> tuple[tuple[int, ...], bool]:
    """The shape after `zoom`, and whether all of its factors are 1."""
    factors = per_axis("zoom", zoom, len(shape))
    after = tuple(round(n * factor) for n, factor in zip(shape, factors, strict=True))
    require_rank(len(shape), len(after))
    if any(n < 0 for n in after):
        raise OptionError(f"zoom must be at least 0; got {zoom!r}")
    require_addressable(after)
    return after, all(factor == 1 for factor in factors)


def magnified(before: Sequence[int], after: Sequence[int], whole: bool) -> list[Array | None]:
    """Positions along each axis of `zoom`; None where they are those of the samples."""
    return [None if m == n else _magnified(n, m, whole) for n, m in zip(before, after, strict=True)]


def plane_of(axes: Sequence[int], ndim: int) -> list[int]:
    """The two axes of `rotate`, in order."""
    if ndim < 2:
        raise OptionError(f"input must have at least two axes; got {ndim}")
    if not np.iterable(axes):
        raise OptionTypeError(f"axes must be two axes of input; got {axes!r}")
    pair = list(axes)
    if len(pair) != 2:
        raise OptionError(f"axes must be exactly two axes of input; got {axes!r}")
    if not all(type(axis) is int or finite("axes", axis).is_integer() for axis in pair):
        raise OptionError(f"axes must be whole numbers; got {axes!r}")
    plane = sorted(int(axis) + ndim if axis < 0 else int(axis) for axis in pair)
    if not 0 <= plane[0] < plane[1] < ndim:
        raise OptionError(f"axes must be two different ones of the {ndim} axes of input; got {axes!r}")
    return plane


def turned(
    angle: float, axes: Sequence[int], reshape: bool, before: Sequence[int]
) -> tuple[list[int], NDArray[np.float64], NDArray[np.float64], tuple[int, ...]]:
    """The plane of `rotate`, the matrix and offset in it, and the shape of the result."""
    from scipy import special

    plane = plane_of(axes, len(before))
    turn = finite("angle", angle)
    c, s = special.cosdg(turn), special.sindg(turn)
    matrix = np.array([[c, s], [-s, c]])
    sides = np.array([before[axis] for axis in plane])
    after = sides
    if flag("reshape", reshape):
        iy, ix = sides
        bounds = matrix @ [[0, 0, iy, iy], [0, ix, 0, ix]]
        after = (np.ptp(bounds, axis=1) + 0.5).astype(int)
    offset = (sides - 1) / 2 - matrix @ ((after - 1) / 2)
    shape = list(before)
    shape[plane[0]], shape[plane[1]] = after.tolist()
    return plane, matrix, offset, tuple(shape)


def _scaled(size: int, scale: float, start: float) -> Array:
    """Positions along an axis of a diagonal matrix."""
    _require_positions(size)
    return (np.arange(size) + start / scale) * scale if scale != 0 else np.full(size, start)


def _require_positions(count: int) -> None:
    memory.require(24 * count, f"the positions of {count} samples along an axis")


def _magnified(n: int, m: int, whole: bool) -> Array:
    """Positions of m samples along n, between the outermost centres, or with `whole` between the edges."""
    _require_positions(m)
    index = np.arange(m)
    if whole:
        return (index + 0.5) * (n / max(m, 1)) - 0.5
    return index * ((n - 1) / (m - 1)) if m != 1 else index.astype(np.float64)
