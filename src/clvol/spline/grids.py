"""Grids on which a function is evaluated: their arguments, and their positions in a volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import one_of
from clvol.base.errors import OptionError
from clvol.volume.volume import Volume
from clvol.volume.volumes import as_grid

if TYPE_CHECKING:
    from clvol.filter.boundary import Boundary
    from clvol.spline.chain import Chain
    from clvol.spline.reduce import AntiAliasing
    from clvol.volume.volumes import Volumes

__all__ = ["Anchor", "Target", "between", "beyond", "described", "grid_for", "no_shear"]

Anchor: TypeAlias = Literal["center", "origin"]
_NO_SHEAR = 1e-9  # samples
_CHANNELS = 4  # most channels of a colour image


@dataclass(frozen=True, eq=False)
class Target:
    """A grid on which a function is evaluated, and how.

    Matrix and offset map the grid's indices, x first, or the points that `chain` maps them to, to indices of the samples.
    """

    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]
    shape: tuple[int, ...]  # of the grid's array
    chain: Chain | None = None  # transforms with displacement grids, applied to the grid's points first
    fill: float | None = None  # the result outside the domain; None: as the boundary rule says
    anti_aliasing: AntiAliasing = None
    kind: np.dtype[Any] | None = None  # type of the result; None: the type in which it is computed


def between(volume: Volume, grid: Volume) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matrix and offset from the indices of a grid, x first, to those of a volume."""
    inverse = volume.world_to_index_matrix
    return inverse @ grid.index_to_world_matrix, inverse @ (np.asarray(grid.origin) - np.asarray(volume.origin))


def beyond(
    matrix: NDArray[np.float64], offset: NDArray[np.float64], shape: tuple[int, ...], results: tuple[int, ...], boundary: Boundary
) -> list[NDArray[np.bool_]]:
    """For each array axis, which points of a grid along a volume's axes are outside its domain."""
    found = []
    for axis, (n, m) in enumerate(zip(shape[::-1], results[::-1], strict=True)):
        x = offset[axis] + matrix[axis, axis] * np.arange(m)
        found.append((x < -boundary.edge) | (x > n - 1 + boundary.edge))
    return found[::-1]


def no_shear(matrix: NDArray[np.float64], shape: tuple[int, ...]) -> bool:
    """Whether the axes of a grid of shape (z, y, x) are the volume's, up to rounding."""
    across = matrix - np.diag(np.diag(matrix))
    return bool((np.abs(across) * np.array(shape[::-1])[: len(matrix)]).max() < _NO_SHEAR)


def described(shape: tuple[int, ...]) -> str:
    """Text for a result of this shape in an error message."""
    return f"a result of {' × '.join(map(str, shape))} numbers"


def grid_for(
    volume: Volume,
    shape: Sequence[int] | None,
    spacing: Sequence[float] | float | None,
    like: Volume | Volumes | ArrayLike | None,
    anchor: str = "center",
) -> Volume:
    """The grid described by `shape`, `spacing` or `like`: a Volume whose samples take no memory."""
    d = volume.ndim
    if anchor not in get_args(Anchor):
        raise one_of("anchor", anchor, get_args(Anchor))
    if sum(v is not None for v in (shape, spacing, like)) != 1:
        raise OptionError("resample takes exactly one of shape, spacing and like")
    if like is not None:
        if anchor != "center":
            raise OptionError(f"anchor is for shape and spacing, and like has an origin of its own; got {anchor!r}")
        grid = as_grid(like)
        if grid.ndim != d:
            raise OptionError(f"like must have {d} axes, as the volume has; got {grid!r}")
        return grid
    extent = np.asarray(volume.size) * np.asarray(volume.spacing)
    if shape is not None:
        if d == 3 and volume.shape[2] <= _CHANNELS and np.shape(shape) == (2,):
            raise OptionError(
                f"shape must be 3 whole numbers, as the volume has {d} axes; got {shape!r}: "
                "for images in colour there is clvol.images.resample"
            )
        size = np.asarray(_sizes(shape, d)[::-1])
        step = extent / size
    else:
        try:
            step = np.broadcast_to(np.asarray(spacing, dtype=np.float64), (d,))
        except (TypeError, ValueError):
            raise OptionError(f"spacing must be a number, or {d} of them; got {spacing!r}") from None
        if not np.isfinite(step).all() or (step <= 0).any():
            raise OptionError(f"spacing must be positive and finite; got {spacing!r}")
        wanted = np.maximum(1, np.round(extent / step))
        if wanted.max() > np.iinfo(np.int32).max:
            raise OptionError(f"spacing {spacing!r} would need {wanted.max():.3g} samples along an axis")
        size = wanted.astype(np.int64)
    origin = volume.center - volume.direction @ (step * (size - 1) / 2) if anchor == "center" else volume.origin
    sizes = tuple(int(n) for n in size)
    return Volume(np.broadcast_to(np.float32(0), sizes[::-1]), tuple(step), tuple(origin), volume.direction, volume.units)


def _sizes(shape: Sequence[int], d: int) -> tuple[int, ...]:
    try:
        sizes = tuple(int(n) for n in shape)
    except (TypeError, ValueError, OverflowError):
        sizes = ()
    if len(sizes) != d or min(sizes) < 1 or any(n != m for n, m in zip(sizes, shape, strict=True)):
        raise OptionError(f"shape must be {d} whole numbers of at least 1; got {shape!r}")
    memory.require_addressable("a result", sizes)
    return sizes
