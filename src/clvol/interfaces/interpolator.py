"""The spline through values on a uniform grid, evaluated in the grid's coordinates: `Interpolator`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array, reals
from clvol.base.checks import several, suggests_options, whole
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.device import Device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.ndimage.arguments import as_precision
from clvol.spline.field import Field, Precision
from clvol.spline.lease import Lease
from clvol.volume.volume import Volume

__all__ = ["Interpolator"]

Array: TypeAlias = NDArray[np.float64]
_METHODS = {"slinear": "linear", "quadratic": "bspline2", "cubic": "bspline3", "quintic": "bspline5"}
_UNEVEN = 1e-6  # of a step


@suggests_options
class Interpolator:
    """The spline through values on a uniform grid of 1, 2 or 3 axes, like `scipy.interpolate.RegularGridInterpolator`.

    The constructor prefilters the values and keeps the coefficients on a device; a call then costs its points only.

    Parameters
    ----------
    points : sequence of 1 to 3 array-likes, shapes (n_1,), (n_2,), ...
        The grid's coordinates along each axis of `values`, evenly spaced, rising or falling.
    values : array-like, shape (n_1, ..., n_d, ...)
        Real or complex. Trailing axes are interpolated separately.
    filter : str or Filter
        A name in `clvol.filters()`, or a filter of your own; also SciPy's names of methods "slinear", "quadratic", "cubic" and
        "quintic".
    bounds_error : bool
        Refuse points outside the grid, beyond its first or last coordinate.
    fill_value : number or None
        The value outside, if such points are not refused; None: the boundary rule applies.
    boundary : str or Boundary
        The boundary rule, see `clvol.boundaries`. SciPy's "cubic" has not-a-knot conditions instead, which differ within a few
        samples of the ends.
    precision : {"single", "double"}, optional
        Of the coefficients and results; default "single" for values of up to 16 bits, float32 and complex64, else "double".
    device : Device, str or int, optional
        See `clvol.device.as_device`.

    Raises
    ------
    GeometryError
        Coordinates are not finite, not strictly monotonic, or not evenly spaced; the message says where.
    DataError
        `values` is not an array of numbers whose shape begins with the numbers of coordinates, or holds NaN or infinities.
    OptionError
        Another argument is not allowed.
    DeviceError, OutOfMemoryError
        As `clvol.Field` raises them.

    Notes
    -----
    An Interpolator is a context manager: leaving it frees the device's memory, as `close` does.

    Examples
    --------
    >>> with clvol.Interpolator((z, y, x), pressure) as at:
    ...     values = at(stations)                      # (..., 3), in the order z, y, x
    ...     upward = at(stations, nu=(1, 0, 0))        # the derivative along z
    """

    def __init__(
        self,
        points: Sequence[ArrayLike],
        values: ArrayLike,
        filter: str | Filter = DEFAULT_FILTER,
        bounds_error: bool = True,
        fill_value: complex | None = np.nan,
        *,
        boundary: str | Boundary = DEFAULT_BOUNDARY,
        precision: Precision | None = None,
        device: Device | str | int | None = None,
    ) -> None:
        axes = several("points", points, "1 to 3 arrays of coordinates, one for each axis", 3)
        data = as_array(values, "values", rule="an array of numbers")
        if data.dtype.kind not in "biufc":
            raise DataError(f"values must be real or complex numbers; got dtype {data.dtype}")
        self.grid = tuple(_coordinates(i, axis) for i, axis in enumerate(axes))
        shape = tuple(x.size for x in self.grid)
        if data.shape[: len(shape)] != shape or data.size == 0:
            raise DataError(f"values must have a shape that begins with {shape}, the numbers of coordinates; got {data.shape}")
        self.bounds_error = bool(bounds_error)
        self.fill_value = fill_value
        if fill_value is not None and np.asarray(fill_value).dtype.kind not in "biuf" + data.dtype.kind:
            raise OptionError(f"fill_value must be None or a number as values are; got {fill_value!r}")
        chosen_precision = as_precision(precision, data.dtype)
        chosen = _METHODS.get(filter, filter) if isinstance(filter, str) else filter
        row, self.boundary = as_filter(chosen), as_boundary(boundary)
        # rising coordinates, and trailing axes flattened
        falling = tuple(i for i, x in enumerate(self.grid) if x.size > 1 and x[-1] < x[0])
        self.values = data
        flat = np.flip(data, falling).reshape(*shape, -1)
        low = [float(x.min()) for x in self.grid]
        step = [float(x.max() - x.min()) / (x.size - 1) if x.size > 1 else 1.0 for x in self.grid]
        if len(shape) == 1:  # an image of one row
            flat, low, step = flat[None], [0.0, *low], [1.0, *step]
        self._fields: list[tuple[Field, ...]] = []
        self._lease = Lease("the interpolator was closed, and its coefficients were released; make a new one")
        try:
            for i in range(flat.shape[-1]):
                parts = (flat[..., i].real, flat[..., i].imag) if data.dtype.kind == "c" else (flat[..., i],)
                grids = [Volume(part, tuple(step[::-1]), tuple(low[::-1])) for part in parts]
                made = []
                for grid in grids:
                    made.append(Field(grid, row, self.boundary, device, precision=chosen_precision))
                    self._lease.frees(made[-1].close)
                self._fields.append(tuple(made))
        except BaseException:
            self.close()
            raise
        self.filter = self._fields[0][0].filter

    def __repr__(self) -> str:
        shape = " × ".join(str(x.size) for x in self.grid)
        return f"<Interpolator of {shape} values, {self.filter.name}, {self.boundary.name}{', closed' if self.closed else ''}>"

    @property
    def nbytes(self) -> int:
        """Bytes of the coefficients on the device; 0 once closed."""
        return 0 if self.closed else sum(field.nbytes for fields in self._fields for field in fields)

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._lease.closed

    def close(self) -> None:
        """Free the device's memory. Results stay valid; further calls raise `OptionError`.

        Calls in other threads finish first, then the memory is freed.
        """
        self._lease.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments; another process computes the coefficients again, on its device of the same name."""
        with self._lease.held():
            field = self._fields[0][0]
            again = partial(type(self), boundary=self.boundary, precision=field.precision, device=field.device)
            return again, (self.grid, self.values, self.filter, self.bounds_error, self.fill_value)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def __call__(
        self,
        xi: ArrayLike | tuple[ArrayLike, ...],
        *,
        nu: Sequence[int] | int | None = None,
        progress: Callable[[float], Any] | None = None,
    ) -> NDArray[Any]:
        """Values, or partial derivatives, at points.

        Parameters
        ----------
        xi : array-like, shape (..., d), or tuple of d array-likes
            Coordinates in the order of the axes; arrays of a tuple are broadcast. A point of shape (d,) counts as one of shape
            (1, d), and for one axis an array of shape (n,) as n points. A coordinate that is NaN gives NaN.
        nu : sequence of int, optional
            Order of the derivative along each axis, at most 2 in total, and at most the filter's degree along an axis; default 0.
            Derivatives are exact; filters with kinks or jumps have them almost everywhere.
        progress : callable, optional
            Called with the fraction done.

        Returns
        -------
        ndarray, shape (...) and then the trailing axes of `values`
            float32 or float64, as from a `Field` of this precision; complex for complex values.

        Raises
        ------
        OptionError
            A point is outside the grid, or has a NaN coordinate, and `bounds_error` is set; `xi` or `nu` has another shape, or an
            order is too high; the interpolator is closed.
        """
        d = len(self.grid)
        orders = self._orders(nu)
        at = _points(xi, d)
        count, held = at.size // d, 1 if not sum(orders) else max(2, d) ** sum(orders)
        wide = np.result_type(self.values.dtype, np.float64).itemsize * (len(self._fields) + 2)
        memory.require(count * (24 * max(2, d) + 8 * held + wide), f"results at {count} points")
        outside = self._outside(at)
        steps = (0,) * (d == 1) + orders  # of a row's image
        where = np.concatenate([np.zeros((*at.shape[:-1], 1)), at], -1) if d == 1 else at
        where = np.ascontiguousarray(where[..., ::-1])
        each = []
        with self._lease.held():
            for i, fields in enumerate(self._fields):
                drawn = [self._gain(field) * _derivative(field, where, steps[::-1]) for field in fields]
                each.append(drawn[0] if len(drawn) == 1 else drawn[0] + 1j * drawn[1])
                if progress is not None:
                    progress((i + 1) / len(self._fields))
        result = np.stack(each, -1)
        if outside is not None and self.fill_value is not None:
            result[outside] = self.fill_value
        result[np.isnan(at).any(-1)] = np.nan
        return result.reshape(at.shape[:-1] + self.values.shape[d:])

    def _orders(self, nu: Sequence[int] | int | None) -> tuple[int, ...]:
        d = len(self.grid)
        if nu is None:
            return (0,) * d
        given = [nu] if isinstance(nu, (int, np.integer)) else several("nu", nu, f"{d} whole numbers", d)
        orders = tuple(whole("each number of nu", n, 0) for n in given)
        if len(orders) != d:
            raise OptionError(f"nu must be {d} whole numbers, one for each axis; got {nu!r}")
        if sum(orders) > 2 or max(orders) > self.filter.degree:
            raise OptionError(
                f"nu must be orders of at most 2 together, and of at most {self.filter.degree} along an axis, the degree of "
                f"{self.filter.name!r}; got {nu!r}"
            )
        return orders

    def _outside(self, at: Array) -> NDArray[np.bool_] | None:
        """Which points are outside the grid, if that matters."""
        if not self.bounds_error and self.fill_value is None:
            return None
        low, high = (np.array([f(x) for x in self.grid]) for f in (np.min, np.max))
        beyond = ~((at >= low) & (at <= high))
        if self.bounds_error and beyond.any():
            axis = int(np.flatnonzero(beyond.any(tuple(range(beyond.ndim - 1))))[0])
            worst = at[..., axis][beyond[..., axis]][0]
            raise OptionError(
                f"points must be within the grid, along axis {axis} from {low[axis]} to {high[axis]}; got {worst}: "
                "bounds_error=False gives fill_value there"
            )
        return np.asarray(beyond.any(-1))

    def _gain(self, field: Field) -> float:
        """The factor for the missing neighbours of an image of one row: under "zero" they count, and are zero."""
        if len(self.grid) > 1 or self.boundary.period is not None:
            return 1.0
        row = field.filter.along(1)
        return float(row.undone[0] / row.samples[0])


def _derivative(field: Field, at: Array, orders: tuple[int, ...]) -> NDArray[Any]:
    """One partial derivative of a Field at world points; `orders` for x, y(, z)."""
    axes = [axis for axis, order in enumerate(orders) for _ in range(order)]
    if not axes:
        return field(at)
    if len(axes) == 1:
        return field.gradient(at)[..., axes[0]]
    return field.hessian(at)[..., axes[0], axes[1]]


def _coordinates(axis: int, given: ArrayLike) -> Array:
    """Coordinates along an axis, strictly monotonic and evenly spaced."""
    kept = np.asarray(given)
    x = reals(f"points of axis {axis}", kept, "an array of coordinates", GeometryError)
    if x.ndim != 1 or x.size == 0:
        raise GeometryError(f"points of axis {axis} must be a non-empty array of one axis; got shape {x.shape}")
    if not (known := np.isfinite(x)).all():
        first = int(np.argmin(known))
        raise GeometryError(f"points of axis {axis} must be finite; got {x[first]} at index {first}")
    rise = np.diff(x)
    if not ((rise > 0).all() or (rise < 0).all()):
        raise GeometryError(f"points of axis {axis} must rise or fall strictly; got {x!r}")
    if x.size > 1:
        even = x[0] + (x[-1] - x[0]) / (x.size - 1) * np.arange(x.size)
        rounding = 4 * float(np.finfo(kept.dtype if kept.dtype.kind == "f" else np.float64).eps) * float(np.abs(x).max())
        away = np.abs(x - even)
        if away.max() > _UNEVEN * abs(even[1] - even[0]) + rounding:
            i = int(away.argmax())
            raise GeometryError(
                f"points of axis {axis} must be evenly spaced; got {x[i]} at index {i}, expected {even[i]}: "
                "SciPy's RegularGridInterpolator takes uneven spacing"
            )
    return x


def _points(xi: ArrayLike | tuple[ArrayLike, ...], d: int) -> Array:
    """Points of shape (..., d) in float64."""
    if isinstance(xi, tuple) and len(xi) == 1:
        xi = xi[0]
    if isinstance(xi, tuple):
        try:
            at: Array = np.stack(np.broadcast_arrays(*(reals("xi", x) for x in xi)), -1)
        except ValueError as error:
            raise OptionError(f"xi must be arrays that can be broadcast to one shape; got {error}") from None
    else:
        at = reals("xi", xi, f"real numbers of shape (..., {d})")
        if at.ndim <= 1 and at.size % d == 0:
            at = at.reshape(-1, d)
    if at.ndim == 0 or at.shape[-1] != d:
        raise OptionError(f"xi must have shape (..., {d}), one coordinate for each axis; got {at.shape}")
    return at
