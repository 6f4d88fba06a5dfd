"""A chain of transforms as kernels apply it, point by point: the host side of chain.cl, jacobian.cl and places.cl."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.device.program import LANES
from clvol.filter.boundary import as_boundary
from clvol.spline.build import scalar_defines
from clvol.spline.prefilter import prefilter_in_place
from clvol.volume.transform import AffineTransform, BSplineTransform, split_at_grids

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.device import Device
    from clvol.spline.build import DefineDict
    from clvol.volume.stored import Reals
    from clvol.volume.transform import DisplacementField, Transform
    from clvol.volume.volume import Volume

__all__ = ["Chain"]


_MOST_TAPS = 6  # of chain.cl
_RUN = 512  # points for each work-item of a CPU
_POINTS = 1 << 20  # points for each launch
_EDGE = {np.float64: 1e-9, np.float32: 1e-4}  # cells; positions this far past the domain are rounding errors, not outside


class Chain:
    """A chain of transforms (of `as_chain`: the last is applied first) of the points of a grid, in the layout that kernels read.

    Adjacent affine maps are joined, and the first one includes the map from the grid's indices to the world. `stages` counts the
    displacement grids, and `end` is the affine map after them: all there is of a chain without grids, which needs no extra
    kernel.
    """

    def __init__(self, transforms: Sequence[Transform], grid: Volume, device: Device) -> None:
        affine, grids = split_at_grids(transforms, grid.ndim)
        affine[0] = affine[0].after(AffineTransform.unchecked(grid.index_to_world_matrix, np.asarray(grid.origin)))
        still = np.eye(grid.ndim)
        # float32 loses digits far from zero, so the points of a stage are then relative to its grid's origin
        near = [np.zeros(grid.ndim) if device.has_double else np.asarray(one.grid.origin) for one in grids]
        for n, origin in enumerate(near):
            affine[n] = AffineTransform.unchecked(still, -origin).after(affine[n])
            affine[n + 1] = affine[n + 1].after(AffineTransform.unchecked(still, origin))
        self.grid, self.device, self.end, self.stages = grid, device, affine[-1], len(grids)
        self._rows = list(zip(affine[:-1], grids, near, strict=True))
        self._coord = np.float64 if device.has_double else np.float32

    def defines(self) -> DefineDict:
        """The `#define`s of chain.cl."""
        return {"CHAIN": 1, "CHAIN_TAPS": sum({1 << one.filter.support for _, one, _ in self._rows})}

    @cached_property
    def arguments(self) -> tuple[Any, ...]:
        """CHAIN_ARGUMENTS of a kernel, uploaded on first use."""
        device, kind, edge, rows = self.device, self._coord, _EDGE[self._coord], max(1, self.stages)
        weights, tables = np.zeros((rows, _MOST_TAPS**2), kind), np.zeros((rows, 5), np.int64)
        maps: list[NDArray[np.float64]] = []
        places, first = [], 0
        for n, (before, one, near) in enumerate(self._rows):
            taps, halo, inverse = one.filter.support, _halo(one), one.grid.world_to_index_matrix
            shift = halo - (taps / 2 - 1)  # a position's first tap is the whole part of its index plus this
            origin = np.asarray(one.grid.origin) - near
            maps += [*self._map(before.matrix, before.offset), *self._map(inverse, shift - inverse @ origin)]
            low, high = one.domain
            maps += [self._padded(low + shift - edge), self._padded(high + shift + edge)]
            polynomials = one.filter.matrix  # of a degree below the number of taps
            weights[n, : taps * taps] = np.pad(polynomials, ((0, 0), (0, taps - polynomials.shape[1]))).ravel()
            shape = *(size + 2 * halo for size in one.grid.shape), one.ndim
            tables[n] = taps, *(*shape[-2::-1], 1)[:3], first
            places.append((one, first, shape))
            first += math.prod(shape)
        count = first + 1  # vectors of three are loaded as four
        values = device.buffers.allocate(count * np.dtype(kind).itemsize)
        with device.buffers.mapped(values, (count,), write=True, kind=kind) as room:
            for one, first, shape in places:
                _fill(room[first : first + math.prod(shape)].reshape(shape), one, device)
            room[-1] = 0
        uploaded = [device.buffers.upload(table) for table in (np.array(maps or [np.zeros(1)], kind), tables, weights)]
        return (*uploaded, values, np.int32(self.stages))

    def to_indices(self, moving: Volume) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The map from the last stage to a volume's indices: matrix and offset."""
        inverse = moving.world_to_index_matrix
        return inverse @ self.end.matrix, inverse @ (self.end.offset - np.asarray(moving.origin))

    def places(self, part: tuple[slice, ...]) -> NDArray[np.float64]:
        """The points of a part [z, y, x] of a 3-D grid after the stages, before `end`; (N, 3)."""
        device, size = self.device, tuple(one.stop - one.start for one in part[::-1])
        results = np.empty((*size[::-1], 3), self._coord)
        defines = {**self.defines(), "DIMENSIONS": 3, "COORD_DOUBLE": int(device.has_double), **scalar_defines(np.float32)}
        kernel = device.build("spline/places.cl", defines).kernel("chain_places")
        corner = np.array([*(one.start for one in part[::-1]), 0], np.int32)
        with device.buffers.lent(results, write=True) as target, device.errors:
            kernel(device.queue, size, device.alone(3), np.array([*size, 0], np.int32), corner, target, *self.arguments)
            device.finish()
        return np.asarray(results.reshape(-1, 3), np.float64)

    def determinants(self, kind: type[Any], progress: Progress | None = None) -> Reals:
        """Jacobian determinants of the chain, moving by fixed positions, at the points of the grid; [z, y, x], of type `kind`."""
        results = np.empty(self.grid.shape, kind)
        self._jacobian(results, progress, pull_back=False)
        return results

    def pull_back(self, results: Reals, progress: Progress | None = None) -> None:
        """Convert gradients from the moving to the fixed world, in place.

        `results` are [z, y, x, component], a value followed by its gradient.
        """
        self._jacobian(results, progress, pull_back=True)

    def _jacobian(self, results: Reals, progress: Progress | None, *, pull_back: bool) -> None:
        device, d = self.device, self.grid.ndim
        nz, ny, nx = (1, *self.grid.shape)[-3:]
        ends = self._map(self.grid.world_to_index_matrix, np.zeros(d)) + self._map(self.end.matrix, np.zeros(d))
        run = _RUN if device.kind == "cpu" else 1
        built = device.build(
            "spline/jacobian.cl",
            {
                **self.defines(),
                "DIMENSIONS": d,
                "COORD_DOUBLE": int(device.has_double),
                **scalar_defines(results.dtype.type),
                "PULL_BACK": int(pull_back),
                "RUN": run,
            },
        )
        kernel, uploaded = built.kernel("jacobian_grid"), device.buffers.upload(np.array(ends, self._coord))
        rows, slices = max(1, min(ny, _POINTS // nx)), max(1, _POINTS // (nx * ny))
        with device.buffers.lent(results, write=True) as target:
            for z in range(0, nz, slices):
                for y in range(0, ny, rows):
                    size = (-(-nx // run), min(rows, ny - y), min(slices, nz - z))
                    with device.errors:
                        kernel(
                            device.queue,
                            size,
                            device.alone(3),
                            uploaded,
                            np.array([nx, ny, y, z], np.int32),
                            target,
                            *self.arguments,
                        )
                    device.finish()
                if progress:
                    progress(min(1.0, (z + slices) / nz))

    def _map(self, matrix: NDArray[np.float64], offset: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The columns of a map and its offset."""
        return [self._padded(column) for column in (*matrix.T, offset)]

    def _padded(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """Padded to the vectors of chain.cl: three numbers take the space of four."""
        return np.pad(vector, (0, vector.size - 2))


def _halo(one: DisplacementField | BSplineTransform) -> int:
    """Coefficients before the first along each axis: 0 for a B-spline grid, which already has all that its domain needs."""
    return 0 if isinstance(one, BSplineTransform) else one.filter.support // 2 + 1


def _fill(room: NDArray[Any], one: DisplacementField | BSplineTransform, device: Device) -> None:
    """Write coefficients in the layout of chain.cl, [z, y, x, component].

    A displacement field extends half a voxel past its samples: a linear one repeats the outer samples, as ITK does; others are
    reflected about them.
    """
    if isinstance(one, BSplineTransform):
        room[...] = one.coefficients
        return
    halo, mirror = _halo(one), as_boundary("mirror")
    inner = room[(slice(halo, -halo),) * one.ndim]
    if one.filter.prefilter:
        for component in range(one.ndim):
            _prefilter(one.displacements[..., component], inner[..., component], one, device)
    else:
        inner[...] = one.displacements
    for axis, n in enumerate(one.grid.shape):
        layers = np.moveaxis(room, axis, 0)
        for place in (*range(-halo, 0), *range(n, n + halo)):
            source = np.clip(place, 0, n - 1) if one.filter.name == "linear" else mirror.index(place, n)
            layers[place + halo] = layers[source + halo]


def _prefilter(samples: NDArray[Any], coefficients: NDArray[Any], one: DisplacementField, device: Device) -> None:
    nx, ny, nz = (*samples.shape[::-1], 1)[:3]
    pitch, kind = -(-nx // LANES) * LANES, coefficients.dtype.type
    shape = (nz, ny, pitch)
    buffer = device.buffers.allocate(math.prod(shape) * coefficients.itemsize)
    with device.buffers.mapped(buffer, shape, write=True, kind=kind) as room:
        room[..., :nx] = samples.reshape(nz, ny, nx)
        room[..., nx:] = 0
    prefilter_in_place(device, buffer, one.filter, as_boundary("mirror"), (pitch, ny, nz, 0), (nx, ny, nz), one.ndim, kind)
    with device.buffers.mapped(buffer, shape, write=False, kind=kind) as room:
        coefficients[...] = room[..., :nx].reshape(samples.shape)
    buffer.release()
