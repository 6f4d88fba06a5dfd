"""A function that comes brick by brick, at points and on grids: each part of the work takes the bricks that it needs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clvol.bricks.source import LazyVolume, known_of
from clvol.filter.make import bspline
from clvol.spline.evaluator import DIRECT
from clvol.spline.grids import beyond, no_shear
from clvol.spline.points import NOTHING_GIVEN, Transform, sample_into
from clvol.spline.reduce import gaussian_sums, interpolated, nearest_sums, smoothed
from clvol.spline.resample import resample_coefficients
from clvol.volume.stored import wide_enough
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.bricks.grid import BrickGrid
    from clvol.bricks.store import Part, Store
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.grids import Target
    from clvol.spline.reduce import Sums
    from clvol.volume.stored import Stored

__all__ = ["ByBricks", "ends_of"]

_EDGES = (96, 64, 48, 32, 24, 16)  # points along an edge of blocks of grids that are not along the volume's axes, longest first
_OF_A_POINT = 200  # bytes that a point of such a block takes: positions in several frames, and where they belong
_BLOCKS = 8  # these blocks take at most 1 / _BLOCKS of the budget


@dataclass(frozen=True)
class _Units:
    """What `Given.in_units_of_data` asks of coefficients."""

    stored: Stored
    boundary: Boundary


class ByBricks:
    """The function of a volume, evaluated brick by brick.

    Parameters
    ----------
    volume : LazyVolume
    filter, boundary, device, stored
        Of the coefficients.
    grid : BrickGrid
    store : Store
        Where bricks come from.
    """

    def __init__(
        self, volume: LazyVolume, filter: Filter, boundary: Boundary, device: Device, stored: Stored, grid: BrickGrid, store: Store
    ) -> None:
        self._volume, self._filter, self._boundary, self._device = volume, filter, boundary, device
        self._grid, self._store, self._wide = grid, store, stored.alters(0)
        self._units: Any = _Units(stored, replace(boundary, cval=math.nan) if boundary.outside == "constant" else boundary)
        self._pad = boundary.padding((filter.magnified_by or filter).prefilter, filter.support)
        self._reach = boundary.reach(filter.support)

    # -- at points ---------------------------------------------------------------------------------------------------------

    def at(
        self, positions: NDArray[np.float64], derivative: int, fill: float | None, progress: Progress | None = None
    ) -> NDArray[Any]:
        """Values, or derivatives in the world, at positions in samples, shape (N, 3); the result has shape (N, 3**derivative).

        Results are NaN where a position is not finite.
        """
        rule, size = self._boundary, self._volume.size
        results = np.full((len(positions), 3**derivative), np.nan, np.float32)
        finite = np.isfinite(positions).all(1)
        with np.errstate(invalid="ignore"):
            inside = ((positions >= -rule.edge) & (positions <= np.asarray(size) - 1 + rule.edge)).all(1)
        places, signs = np.zeros_like(positions), np.ones_like(positions)
        for axis, n in enumerate(size):
            x = np.where(finite, positions[:, axis], 0.0)
            own = (x >= -rule.edge) & (x <= n - 1 + rule.edge)  # bricks at faces hold these taps; folded, ties break otherwise
            brought, sign = rule.position(x, n, self._pad, self._reach)
            places[:, axis] = np.where(own, x, brought)
            if derivative:
                signs[:, axis] = np.where(own, 1.0, sign)
        given = ~finite if fill is None else ~finite | ~inside
        if rule.outside == "constant":
            given |= ~inside
        wanted = np.flatnonzero(~given)
        if len(wanted):
            self._sample(places, wanted, derivative, results, progress)
        final: NDArray[Any] = NOTHING_GIVEN.in_units_of_data(self._units, results, derivative)
        if derivative and (signs < 0).any():
            flip = signs if derivative == 1 else (signs[:, :, None] * signs[:, None, :]).reshape(-1, 9)
            final = _reflected(final, flip, self._volume.grid.world_to_index_matrix, derivative)
        if rule.outside == "constant":
            final[finite & ~inside] = rule.cval if derivative == 0 else 0.0
        if fill is not None:
            final[finite & ~inside] = fill
        return final

    def _sample(
        self,
        places: NDArray[np.float64],
        wanted: NDArray[np.intp],
        derivative: int,
        results: NDArray[Any],
        progress: Progress | None,
    ) -> None:
        """The function at the wanted places, brick by brick."""
        grid, store = self._grid, self._store
        owners = np.stack([grid.owners(places[wanted, axis], axis) for axis in range(3)], axis=1)
        nx, ny, _ = grid.counts
        number = (owners[:, 2] * ny + owners[:, 1]) * nx + owners[:, 0]
        order = np.argsort(number, kind="stable")
        ends: list[int] = (np.flatnonzero(np.diff(number[order], append=-1)) + 1).tolist()
        runs = list(zip([0, *ends[:-1]], ends, strict=True))
        bricks = [grid[int(x), int(y), int(z)] for x, y, z in owners[order[[first for first, _ in runs]]]]
        move = Transform(np.eye(3), np.zeros(3), self._volume.grid.world_to_index_matrix)
        store.expect(bricks)
        try:
            for (first, last), brick, following in zip(runs, bricks, [*bricks[1:], None], strict=True):
                some = wanted[order[first:last]]
                with store.resident(brick) as own:
                    if following is not None:
                        store.read_ahead(following)
                    local = places[some] - np.asarray(brick.first, np.float64)
                    part = np.empty((len(some), results.shape[1]), np.float32)
                    sample_into(own.coefficients, DIRECT, local, part, move, derivative)
                    results[some] = part
                    results[some[self._absent(places[some])]] = np.nan
                if progress:
                    progress(last / len(wanted))
        finally:
            store.forget_ahead()

    def _absent(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether places in one brick are missing, as in pictures."""
        where = self._volume.where
        if where is None:
            return np.zeros(len(places), bool)
        from scipy import ndimage

        places = np.clip(places, 0, np.asarray(self._volume.size) - 1)
        first, last = np.floor(places.min(0)).astype(int), np.ceil(places.max(0)).astype(int)
        x, y, z = (slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))
        mask = where[z, y, x].astype(np.float32)
        order: Literal[0, 1] = 0 if self._filter.support == 1 else 1
        return np.asarray(ndimage.map_coordinates(mask, list((places - first).T[::-1]), order=order, mode="nearest") > 0.5)

    # -- on grids ----------------------------------------------------------------------------------------------------------

    @property
    def kind(self) -> np.dtype[Any]:
        """The type in which values are computed."""
        return np.dtype(np.float64 if self._wide else np.float32)

    def parts(self, target: Target) -> Iterator[Part]:
        """The parts of a grid, without anti-aliasing."""
        if target.chain is None and self._volume.where is None and no_shear(target.matrix, target.shape):
            yield from self._along_axes(target)
        else:
            yield from self._in_blocks(target)

    def _along_axes(self, target: Target) -> Iterator[Part]:
        """The parts of a grid along the axes that lie in each brick, evaluated axis by axis."""
        matrix, offset, shape = target.matrix, target.offset, target.shape
        if any(line.any() for line in beyond(matrix, offset, self._volume.shape, shape, self._boundary)):
            yield from self._in_blocks(target)  # rare, and each boundary rule is at home in points
            return
        grid, store = self._grid, self._store
        lines = [offset[axis] + matrix[axis, axis] * np.arange(n) for axis, n in enumerate(shape[::-1])]
        bricks = list(grid)
        store.expect(bricks)
        owners = [grid.owners(line, axis) for axis, line in enumerate(lines)]
        for done, brick in enumerate(bricks, 1):
            own = [np.flatnonzero(owner == i) for owner, i in zip(owners, brick.at, strict=True)]
            if not all(map(len, own)):
                continue
            part = tuple(len(places) for places in own[::-1])
            start = np.array([line[places[0]] for line, places in zip(lines, own, strict=True)]) - np.asarray(brick.first)
            values = np.empty(part, np.float32)
            with store.resident(brick) as resident, self._device.buffers.lent(values, write=True) as buffer:
                resample_coefficients(resident.coefficients, DIRECT, np.diag(np.diag(matrix)), start, part, buffer, NOTHING_GIVEN)
            place = tuple(slice(int(places[0]), int(places[-1]) + 1) for places in own[::-1])
            yield place, NOTHING_GIVEN.in_units_of_data(self._units, values, 0), done / len(bricks)

    def _in_blocks(self, target: Target) -> Iterator[Part]:
        """Blocks of any grid, evaluated at points."""
        shape, room = target.shape, self._store.account.budget // _BLOCKS // _OF_A_POINT
        edge = next((n for n in _EDGES if n**3 <= room), _EDGES[-1])
        starts = [range(0, n, edge) for n in shape]
        count = math.prod(map(len, starts))
        for done, corner in enumerate(itertools.product(*starts), 1):
            place = tuple(slice(a, min(a + edge, n)) for a, n in zip(corner, shape, strict=True))
            size = [part.stop - part.start for part in place]
            with self._store.set_aside(_OF_A_POINT * math.prod(size)):
                if target.chain is None:
                    z, y, x = np.meshgrid(*(np.arange(part.start, part.stop, dtype=np.float64) for part in place), indexing="ij")
                    points = np.stack([x, y, z], -1).reshape(-1, 3)
                else:
                    points = target.chain.places(place)
                values = self.at(points @ target.matrix.T + target.offset, 0, target.fill)
            yield place, values.reshape(size), done / count

    def sums_for(self, target: Target, *, settled: bool) -> tuple[dict[int, Sums], type[np.generic]] | None:
        """A low-passed grid as sums along the axes, and the type in which they are computed; None where it is none."""
        volume, rule, matrix, offset = self._volume, self._boundary, target.matrix, target.offset
        kind = wide_enough(np.float32, ends_of(volume), self._filter, rule)
        if target.anti_aliasing == "least-squares":
            return nearest_sums(known_of(volume), self._filter, rule, kind, matrix, offset, target.shape)
        continues = rule.period is not None and rule.outside in ("rule", "clamp")
        if not (no_shear(matrix, target.shape) and continues and self._filter.magnified_by is None and settled):
            return None
        made = {}
        for axis, n in enumerate(volume.size):
            line = offset[axis] + matrix[axis, axis] * np.arange(target.shape[2 - axis])
            sums = interpolated(self._filter.along(axis), line, n, rule, kind == np.float64)
            made[2 - axis] = smoothed(sums, (abs(float(matrix[axis, axis])) - 1) / 2, rule)
        return made, kind

    def by_sums(self, target: Target, sums: dict[int, Sums], kind: type[np.generic]) -> Iterator[Part]:
        """Blocks of a grid that is sums along the axes."""
        rule = self._boundary
        outside = None if target.fill is None else beyond(target.matrix, target.offset, self._volume.shape, target.shape, rule)
        for block, values, done in self._store.blocks(sums, kind, rule.cval):
            for axis, part in enumerate(block):
                if outside is not None:
                    np.moveaxis(values, axis, 0)[outside[axis][part]] = target.fill
            yield block, values, done

    def low_passed(self, steps: NDArray[np.float64]) -> LazyVolume:
        """The volume after the Gaussian that suits a grid of such steps, computed where it is read: see `low_passed`."""
        volume, rule, grid = self._volume, self._boundary, self._volume.grid
        kind = wide_enough(np.float32, ends_of(volume), bspline(1), rule)
        smooth = self._store.summed(gaussian_sums(volume.shape, steps, rule), kind, rule.cval)
        return LazyVolume(smooth, grid.spacing, grid.origin, grid.direction, labels=False, limits=volume.limits)


def ends_of(volume: LazyVolume) -> Volume:
    """Two samples: the smallest and the largest one, in the volume's type."""
    low, high = volume.limits
    kind = volume.dtype
    ends = np.array([low, high]) if kind.kind == "f" else np.array([math.floor(low), math.ceil(high)])
    if kind.kind in "iu":
        ends = np.clip(ends, np.iinfo(kind).min, np.iinfo(kind).max)
    return Volume(ends.astype(kind).reshape(1, 1, 2))


def _reflected(derivatives: NDArray[Any], flip: NDArray[np.float64], inverse: NDArray[np.float64], order: int) -> NDArray[Any]:
    """Derivatives per unit of the world whose axes in index space are reversed by `flip`."""
    forward = np.linalg.inv(inverse)
    if order == 1:
        return np.asarray(((derivatives @ forward) * flip) @ inverse, derivatives.dtype)
    square = derivatives.reshape(-1, 3, 3)
    own = forward.T @ square @ forward * flip.reshape(-1, 3, 3)
    return np.asarray(inverse.T @ own @ inverse, derivatives.dtype).reshape(-1, 9)
