"""Streamlines: curves that are everywhere along the vectors of a field, integrated all at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import MissingDependencyError

__all__ = ["DIRECTIONS", "Direction", "Steps", "Streamlines", "traced"]

Direction: TypeAlias = Literal["both", "forward", "backward"]
Array: TypeAlias = NDArray[np.float64]

DIRECTIONS: dict[str, tuple[int, ...]] = {"both": (-1, 1), "forward": (1,), "backward": (-1,)}

# Dormand and Prince 1980: the slopes of stages 2 to 7, of which the last is the step of order 5, and its difference from order 4
_STAGES: tuple[tuple[float, ...], ...] = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_MOST, _LEAST = 0.5, 1e-3  # voxels of a chosen step
_TINY = 1e-12
_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 4.0  # of the next step, times the one that the estimate allows, and within these factors


@dataclass(frozen=True, eq=False)
class Streamlines:
    """Curves along a field; as a sequence, the points of each, (n, d).

    Attributes
    ----------
    points : ndarray of float64, shape (N, d)
        World positions of all curves, one after the other, along the field.
    starts : ndarray of int64, shape (m + 1,)
        Curve i, that of seed i, has the points from ``starts[i]`` to ``starts[i + 1]``.
    vectors : ndarray of float32 or float64, shape (N, d)
        The field at the points.
    """

    points: Array
    starts: NDArray[np.int64]
    vectors: NDArray[Any]

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, index: int) -> Array:
        first = range(len(self))[index]  # raises IndexError, as for sequences
        return self.points[self.starts[first] : self.starts[first + 1]]

    def __repr__(self) -> str:
        return f"<Streamlines: {len(self)} of {len(self.points)} points>"

    def to_pyvista(self) -> Any:
        """A `pyvista.PolyData` with a line for each curve of at least two points, and "vectors" at their points.

        Raises
        ------
        MissingDependencyError
            PyVista is not installed.
        """
        try:
            import pyvista
        except ModuleNotFoundError as error:
            raise MissingDependencyError("to_pyvista needs pyvista: pip install pyvista") from error
        ends = zip(self.starts[:-1], self.starts[1:], strict=True)
        lines = [np.r_[stop - start, start:stop] for start, stop in ends if stop - start > 1]
        points, vectors = (np.pad(array, ((0, 0), (0, 3 - array.shape[1]))) for array in (self.points, self.vectors))
        made = pyvista.PolyData(points, lines=np.concatenate(lines) if lines else np.zeros(0, np.int64))
        made["vectors"] = vectors
        return made


@dataclass(frozen=True)
class Steps:
    """How streamlines are integrated.

    Attributes
    ----------
    voxel : float
        What steps and the tolerance are measured by.
    length : float
        The arc length at most.
    fixed : float or None
        A fixed step; None: chosen for the tolerance.
    tolerance : float
        The estimated error of a chosen step, in voxels.
    """

    voxel: float
    length: float
    fixed: float | None
    tolerance: float


def traced(along: Callable[[Array], Array], seeds: Array, steps: Steps, ways: tuple[int, ...]) -> tuple[Array, NDArray[np.int64]]:
    """The points and `starts` of streamlines from seeds (m, d); `along` gives unit vectors at points, NaN where curves end.

    They go along the vectors where a way is 1, and against them where it is -1.
    """
    lines = np.flatnonzero(np.isfinite(along(seeds)).all(1))
    parts = [(lines, np.zeros(lines.size), seeds[lines])]
    for way in ways:
        parts += [(some, way * done, x) for some, done, x in _marched(along, way, lines, seeds[lines], steps)]
    line, place, points = map(np.concatenate, zip(*parts, strict=True))
    order = np.lexsort((place, line))
    return points[order], np.searchsorted(line[order], np.arange(len(seeds) + 1))


def _marched(
    along: Callable[[Array], Array], way: int, line: NDArray[np.int64], x: Array, steps: Steps
) -> Iterator[tuple[NDArray[np.int64], Array, Array]]:
    """After each step the lines that took it, their lengths and their points; all that are left take one at a time."""
    least, most = (steps.fixed,) * 2 if steps.fixed else (_LEAST * steps.voxel, _MOST * steps.voxel)
    slope, done, size = way * along(x), np.zeros(line.size), np.full(line.size, most)
    while line.size:
        h = np.minimum(size, steps.length - done)[:, None]
        slopes, there = [slope], x
        for weights in _STAGES:
            there = x + h * _sum(weights, slopes)
            slopes.append(way * along(there))
        error = np.linalg.norm(h * _sum(_ERROR, slopes), axis=1) / (steps.tolerance * steps.voxel)
        inside = np.isfinite(error)
        taken = inside & ((error <= 1) | (size <= least))
        done = done + np.where(taken, h[:, 0], 0.0)
        x, slope = np.where(taken[:, None], there, x), np.where(taken[:, None], slopes[-1], slope)
        yield line[taken], done[taken], x[taken]
        factor = np.where(inside, np.clip(_SAFETY * np.maximum(error, _TINY) ** -0.2, _SHRINK, _GROW), _SHRINK)
        kept = (inside | (size > least)) & (done < (1 - _TINY) * steps.length)
        size = np.clip(h[:, 0] * factor, least, most)
        line, x, slope, done, size = line[kept], x[kept], slope[kept], done[kept], size[kept]


def _sum(weights: tuple[float, ...], slopes: list[Array]) -> Array:
    return np.tensordot(weights, np.stack(slopes), 1)
