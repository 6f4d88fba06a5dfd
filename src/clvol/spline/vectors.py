"""`VectorField`, the continuous function of several components on one grid: velocities, displacements, colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array
from clvol.base.checks import number, one_of, suggests_options
from clvol.base.errors import DataError, OptionError
from clvol.device import as_device
from clvol.device.program import LANES
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline.build import filter_defines
from clvol.spline.coefficients import Coefficients, bytes_of
from clvol.spline.evaluator import DIRECT, require_direct
from clvol.spline.field import precision_kind
from clvol.spline.function import CLOSED, as_points, fill_value
from clvol.spline.grids import described
from clvol.spline.lease import Lease, Leased, release
from clvol.spline.points import sample_coefficients
from clvol.spline.resample import filled
from clvol.spline.streamlines import DIRECTIONS, Steps, Streamlines, traced
from clvol.volume.smoothing import settled
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.field import Precision
    from clvol.spline.points import Reals
    from clvol.spline.streamlines import Direction

__all__ = ["VectorField"]

_TOGETHER = 16  # functions that are sampled together: kernels of a hundred take many seconds to compile
_STILL = 1e-6  # of the largest component, the speed below which streamlines end


class _Interleaved(Coefficients):
    """Coefficients of several functions: for each sample those of all functions, next to each other along x.

    Three take the room of four, so that vectors of them are aligned: it takes a fifth less time.
    """

    def __init__(
        self, parts: Sequence[Volume], filter: Filter, boundary: Boundary, device: Device, stored: Stored, kind: type[np.generic]
    ) -> None:
        functions, grid = len(parts), parts[0]
        self._apart = apart = functions + (functions == 3)
        device.buffers.require_room((apart + 1) * bytes_of(grid.size, filter, boundary, kind))
        super().__init__(grid, filter, boundary, device, stored, kind)
        if functions == 1:
            filled(self, parts[0].data)
            return
        count, one = math.prod(self.shape), self.buffer
        joined = device.buffers.allocate(np.dtype(kind).itemsize * (apart * count + LANES))
        try:
            device.buffers.clear(joined, 0, apart * count + LANES, kind)
            for number, part in enumerate(parts):
                filled(self, part.data)
                with device.errors:
                    self._build("float").kernel("interleave")(
                        device.queue, (count,), device.alone(1), one, joined, np.int32(apart), np.int32(number)
                    )
                device.finish()
        except BaseException:
            release(device, joined)
            raise
        self.functions, self.buffer = functions, joined
        self.extent[0] *= apart
        release(device, one)

    def defines(self, evaluator: Any) -> Any:
        """With the number of functions."""
        rows = filter_defines(self.filter, self.kind, self._apart)
        return {**super().defines(evaluator), **rows, "FUNCTIONS": self.functions, "APART": self._apart}


class VectorField(Leased):
    """The continuous function of several components on one grid, with its coefficients on a device.

    Each component is the function that `clvol.Field` is of it; all are sampled together, with the same weights and addresses.

    Parameters
    ----------
    components : array-like, shape (ny, nx, n) or (nz, ny, nx, n), Volumes, or sequence of Volume
        Samples, all finite. An array has its components in the last axis, spacing 1 and origin 0. Components of a velocity or a
        displacement are along x, y(, z) of the world, whatever the grid's direction is.
    filter : str or Filter, optional
        A name in `clvol.filters()`, or a custom filter; default "bspline3". Smoothing that depends on the samples is that of the
        first component.
    boundary, device, precision
        As of `clvol.Field`; default "single". Single precision is relative to the range of all components together.

    Attributes
    ----------
    grid : Volume
        The first component, whose grid is that of all.
    filter : Filter
    boundary : Boundary
    device : Device
    components : int
        How many there are.

    Raises
    ------
    DataError
        The components are not finite real numbers of such a shape.
    GeometryError
        Volumes are on different grids.
    OptionError, DeviceError, OutOfMemoryError
        As `Field` raises them.

    Notes
    -----
    A VectorField is a context manager: on exit it frees the device's memory, as `close` does. Several threads may share one. It
    samples by direct taps from buffers.

    References
    ----------
    - J. R. Dormand and P. J. Prince, "A family of embedded Runge-Kutta formulae", Journal of Computational and Applied
      Mathematics 6(1), 1980, 19–26: `streamlines`.

    Examples
    --------
    A rigid rotation, its curl, and a streamline, which is a circle:

    >>> import clvol, numpy as np
    >>> z, y, x = np.mgrid[-4:5, -4:5, -4:5].astype("f4")
    >>> with clvol.VectorField(np.stack([-y, x, 0 * z], -1)) as field:
    ...     curl = field.curl((4.0, 4.0, 4.0))
    ...     lines = field.streamlines([(6.0, 4.0, 4.0)], length=2 * np.pi * 2, direction="forward")
    """

    @suggests_options
    def __init__(
        self,
        components: ArrayLike | Volumes | Sequence[Volume],
        filter: str | Filter = DEFAULT_FILTER,
        boundary: str | Boundary = DEFAULT_BOUNDARY,
        device: Device | str | int | None = None,
        *,
        precision: Precision = "single",
    ) -> None:
        parts = _as_volumes(components)
        self.grid, self.components = parts.grid, len(parts)
        self.boundary, self.device = as_boundary(boundary), as_device(device)
        require_direct(self.device, "components are")
        self.filter = settled(as_filter(filter), self.grid)
        for part in parts:
            part.require_finite()
        self._kind = precision_kind(precision)
        together = Volume(np.asarray(parts).reshape(-1, *parts.shape[-2:]))
        stored = Stored.of(together, self.filter, self.boundary, self._kind)
        each = list(parts)
        self._groups = [
            _Interleaved(each[first : first + _TOGETHER], self.filter, self.boundary, self.device, stored, self._kind)
            for first in range(0, len(each), _TOGETHER)
        ]
        self._slowest = _STILL * max(abs(float(end)) for part in parts for end in part.limits)
        self._lease = Lease(CLOSED)
        for group in self._groups:
            self._lease.frees(group.release)

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.grid.shape))
        state = ", closed" if self.closed else ""
        return (
            f"<VectorField of {shape} samples of {self.components} components, {self.filter.name}, {self.boundary.name}, "
            f"on {self.device.name!r}{state}>"
        )

    def __call__(self, points: ArrayLike, *, fill: float | None = None) -> Reals:
        """All components at points of the world.

        Parameters
        ----------
        points : array-like, shape (..., d)
            World positions (x, y) or (x, y, z), as of a call of `Field`.
        fill : float, optional
            The result outside the volume's domain; None: as the boundary rule says.

        Returns
        -------
        ndarray of float32, shape (..., n)
            float64 in double precision, and if samples are far from zero, or very large or small: see the notes of `Field`.

        Raises
        ------
        OptionError
            `points` are not real numbers of shape (..., d); `fill` is not a number; the field is closed.
        """
        return self._derivatives(points, 0, fill)

    def jacobian(self, points: ArrayLike, *, fill: float | None = None) -> Reals:
        """Exact first derivatives at points of the world: [..., i, j] is that of component i along axis j of (x, y[, z]).

        Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32 or float64, shape (..., n, d)
            Per world unit.
        """
        return self._derivatives(points, 1, fill)

    def hessian(self, points: ArrayLike, *, fill: float | None = None) -> Reals:
        """Exact second derivatives of each component at points of the world. Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32 or float64, shape (..., n, d, d)
            Per world unit squared.
        """
        return self._derivatives(points, 2, fill)

    def divergence(self, points: ArrayLike, *, fill: float | None = None) -> Reals:
        """The divergence at points of the world, of a field of d components: the sum of ∂uᵢ/∂xᵢ.

        Parameters and errors are those of a call; `OptionError` also if there are not d components.

        Returns
        -------
        ndarray of float32 or float64, shape (...)
        """
        self._require_vectors("divergence")
        return np.asarray(np.trace(self.jacobian(points, fill=fill), axis1=-2, axis2=-1))

    def curl(self, points: ArrayLike, *, fill: float | None = None) -> Reals:
        """The curl (vorticity) at points of the world, of a field of d components.

        Parameters and errors are those of a call; `OptionError` also if there are not d components.

        Returns
        -------
        ndarray of float32 or float64, shape (..., 3); in two dimensions (...), ∂u_y/∂x - ∂u_x/∂y
        """
        self._require_vectors("curl")
        slopes = self.jacobian(points, fill=fill)
        turns = slopes.swapaxes(-2, -1) - slopes
        return np.stack([turns[..., 1, 2], turns[..., 2, 0], turns[..., 0, 1]], -1) if self.grid.ndim == 3 else turns[..., 0, 1]

    def streamlines(
        self,
        seeds: ArrayLike,
        *,
        step: float | None = None,
        tolerance: float = 1e-4,
        length: float | None = None,
        direction: Direction = "both",
    ) -> Streamlines:
        """Curves through points that are everywhere along the vectors of a field of d components.

        They are integrated by arc length with the Runge-Kutta method of order 5 of Dormand and Prince, all at once. One ends where
        it leaves the volume's domain, reaches `length`, or comes to a point where the vector is zero or nearly so (10⁻⁶ of the
        largest component).

        Parameters
        ----------
        seeds : array-like, shape (m, d)
            World positions (x, y) or (x, y, z). One outside the domain is a curve of no points.
        step : float, optional
            A fixed step in world units; a line ends up to one of them inside the domain. By default steps are chosen for the
            tolerance, up to half a voxel.
        tolerance : float
            The estimated error of a chosen step, in voxels (of the smallest spacing).
        length : float, optional
            The length at most, in world units, in each direction; default four times the diagonal of the domain.
        direction : {"both", "forward", "backward"}
            From the seed along the vectors, against them, or both ways.

        Returns
        -------
        Streamlines

        Raises
        ------
        OptionError
            An argument is invalid; there are not d components; the field is closed.
        """
        self._require_vectors("streamlines")
        if direction not in DIRECTIONS:
            raise one_of("direction", direction, DIRECTIONS)
        d, spacing, size = self.grid.ndim, np.asarray(self.grid.spacing), np.asarray(self.grid.size)
        most = 4 * float(np.linalg.norm(spacing * size)) if length is None else number("length", length, above=0)
        fixed = None if step is None else number("step", step, above=0)
        steps = Steps(float(spacing.min()), most, fixed, number("tolerance", tolerance, above=0))

        def at(points: NDArray[np.float64]) -> Reals:
            return sample_coefficients(self._groups[0], DIRECT, points, 0, np.nan).reshape(-1, d)

        def along(points: NDArray[np.float64]) -> NDArray[np.float64]:
            vectors = at(points).astype(np.float64)
            speeds = np.linalg.norm(vectors, axis=1, keepdims=True)
            return vectors / np.where(speeds > self._slowest, speeds, np.nan)

        with self.in_use():
            begin = np.asarray(as_points(seeds, "LPS", self.grid), np.float64).reshape(-1, d)
            points, starts = traced(along, begin, steps, DIRECTIONS[direction])
            return Streamlines(points, starts, at(points))

    def _require_vectors(self, what: str) -> None:
        if self.components != self.grid.ndim:
            raise OptionError(f"{what} needs as many components as axes, {self.grid.ndim}; got {self.components}")

    def _derivatives(self, points: ArrayLike, derivative: int, fill: float | None) -> Reals:
        with self.in_use():
            d, outside = self.grid.ndim, fill_value(fill)
            array = as_points(points, "LPS", self.grid, outside=fill is not None)
            shape = (*array.shape[:-1], self.components) + (d,) * derivative
            memory.require(np.dtype(self._kind).itemsize * math.prod(shape), described(shape))
            flat = array.reshape(-1, d)
            found = [
                sample_coefficients(group, DIRECT, flat, derivative, outside).reshape(len(flat), group.functions * d**derivative)
                for group in self._groups
            ]
            return (found[0] if len(found) == 1 else np.concatenate(found, 1)).reshape(shape)


def _as_volumes(components: Any) -> Volumes:
    """Components on one grid."""
    if isinstance(components, Volumes):
        return components
    if isinstance(components, (list, tuple)) and components and isinstance(components[0], Volume):
        return Volumes(components)
    rule = "real numbers of shape (ny, nx, n) or (nz, ny, nx, n)"
    array: NDArray[Any] = as_array(components, "components", DataError, rule)
    if array.ndim not in (3, 4) or not array.shape[-1]:
        raise DataError(f"components must be {rule}; got {array.dtype} of shape {array.shape}")
    return Volumes(np.moveaxis(array, -1, 0))
