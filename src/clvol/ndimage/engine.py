"""What the functions of `clvol.ndimage` stand on: coefficients of arrays, and their spline on grids and at points, by SciPy's rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.device import Device

__all__ = ["Affine", "Axes", "Points", "Precision", "Target", "coefficients", "evaluate"]

Array: TypeAlias = NDArray[Any]
Precision: TypeAlias = Literal["single", "double"]


@dataclass(frozen=True, eq=False)
class Axes:
    """A grid along the array's axes.

    Attributes
    ----------
    positions : tuple of ndarray of float64
        For each resampled axis the positions in samples of the input; they may lie anywhere.
    """

    positions: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True, eq=False)
class Affine:
    """A grid that lies in any way: index ``i`` of the result is at ``matrix @ i + offset`` of the input, in the order of the axes.

    Attributes
    ----------
    matrix, offset : ndarray of float64, shapes (k, k) and (k,)
        Products are added up from the first axis to the last, then the offset, each rounded, as SciPy does.
    shape : tuple of int
        Of the result, for each resampled axis.
    """

    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Points:
    """Points anywhere.

    Attributes
    ----------
    coordinates : ndarray, shape (k, ...)
        Positions in samples of the input, real numbers of any dtype and layout, as SciPy's.
    """

    coordinates: Array


Target: TypeAlias = Axes | Affine | Points


def evaluate(
    data: Array,
    axes: Sequence[int],
    target: Target,
    output: Array,
    *,
    order: int,
    mode: str,
    cval: float,
    prefilter: bool,
    precision: Precision,
    device: Device | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """The spline of an array at a target, into `output`.

    Parameters
    ----------
    data : ndarray of real numbers
        Of any layout and byte order; not empty.
    axes : sequence of int
        Those that are resampled, 1 to 3 of them, ascending. All others are batch axes: every index of them is computed on its own.
    target : Axes, Affine or Points
    output : ndarray
        Of any real dtype and layout; written whole. Its axes are the batch axes and those of a grid where they are in `data`; for
        points, the batch axes and then those of the points. Whole numbers are rounded as SciPy rounds, halves away from zero,
        and clipped to their type.
    order : int
        0 to 5.
    mode : str
        One of SciPy's.
    cval : float
        For "constant" and "grid-constant".
    prefilter : bool
        Whether `data` are samples; else they are coefficients.
    precision : {"single", "double"}
    device : Device, optional
    progress : callable, optional
        Called with the fraction done.
    """
    import itertools

    from scipy import ndimage

    data, axes = np.asarray(data), list(axes)
    kept = [axis for axis in range(data.ndim) if axis not in axes]
    moved = data.transpose(kept + axes)
    if isinstance(target, Axes):
        at: Array = np.stack(np.meshgrid(*target.positions, indexing="ij"))
    elif isinstance(target, Affine):
        index = np.indices(target.shape, np.float64)
        at = np.stack(
            [sum(m * i for m, i in zip(row, index, strict=True)) + o for row, o in zip(target.matrix, target.offset, strict=True)]
        )
    else:
        at = target.coordinates
    onto = output if isinstance(target, Points) else output.transpose(kept + axes)
    for index in itertools.product(*(range(data.shape[axis]) for axis in kept)):
        part = onto[index]
        part[...] = ndimage.map_coordinates(moved[index], at, output.dtype, order, mode, cval, prefilter)


def coefficients(
    data: Array,
    axes: Sequence[int],
    output: Array,
    *,
    order: int,
    mode: str,
    precision: Precision,
    device: Device | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """The spline coefficients of an array along some of its axes, up to three, into `output` (which may be `data`).

    Parameters are those of `evaluate`; `output` has the shape of `data` and any real dtype.
    """
    from scipy import ndimage

    result = np.asarray(data)
    for axis in axes:
        result = ndimage.spline_filter1d(result, order, axis, np.float64, mode)
    output[...] = result.astype(output.dtype)
