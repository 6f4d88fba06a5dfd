"""Sampling, its derivatives and its adjoint as functions of NumPy arrays: what clvol.torch and clvol.jax make differentiable."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number, suggests_options
from clvol.base.errors import OptionError
from clvol.device import Device, as_device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.spline.field import Precision
from clvol.spline.function import fill_value
from clvol.spline.scatter import adjoint, linear
from clvol.spline.vectors import VectorField
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

__all__ = ["Sampling", "SamplingOptions"]

Array = NDArray[Any]


class SamplingOptions(TypedDict, total=False):
    """Options of `sample` in clvol.torch and clvol.jax."""

    spacing: Sequence[float] | float
    origin: Sequence[float] | float
    fill: float | None
    device: Device | str | int | None


@dataclass(frozen=True)
class Sampling:
    """How functions are sampled: everything but their samples and the points.

    Samples are those of n functions, (n, ny, nx) or (n, nz, ny, nx); points are (N, d); results have n as their first axis, too.
    """

    filter: Filter
    boundary: Boundary
    device: Device
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    precision: Precision
    fill: float | None

    @classmethod
    @suggests_options
    def of(
        cls,
        values: tuple[int, ...],
        points: tuple[int, ...],
        precision: Precision,
        filter: str | Filter,
        boundary: str | Boundary,
        *,
        spacing: Sequence[float] | float = 1.0,
        origin: Sequence[float] | float = 0.0,
        fill: float | None = None,
        device: Device | str | int | None = None,
    ) -> Sampling:
        """From the shapes of `values` (..., ny, nx) or (..., nz, ny, nx) and `points` (..., d), which it checks, and options."""
        d = points[-1] if points else 0
        if d not in (2, 3):
            raise OptionError(f"points must have shape (..., 2) or (..., 3); got {points}")
        if len(values) < d:
            raise OptionError(f"values must have at least the {d} axes that points have coordinates; got shape {values}")
        places = _along(spacing, d), _along(origin, d)
        return cls(*linear(filter, boundary), as_device(device), *places, precision, fill_value(fill))

    @property
    def linear(self) -> Sampling:
        """The same with nothing but zeros outside, of which `spread` is the adjoint."""
        return replace(self, fill=None if self.fill is None else 0.0)

    def field(self, samples: Any) -> VectorField | None:
        """The functions of samples, which are sampled together; None if there are none."""
        if not len(samples):
            return None
        parts = Volumes(samples, spacing=self.spacing, origin=self.origin)
        return VectorField(parts, self.filter, self.boundary, self.device, precision=self.precision)

    def at(self, field: VectorField | None, points: Array, derivative: int) -> Array:
        """Values, gradients or Hessians of functions at points; (n, N), (n, N, d) or (n, N, d, d)."""
        if field is None:
            return np.empty((0, len(points)) + points.shape[1:] * derivative)
        found = np.moveaxis((field, field.jacobian, field.hessian)[derivative](points), 1, 0)
        if self.fill is not None:
            found[:, ~self._inside(points, field.grid.shape)] = 0.0 if derivative else self.fill
        return found

    def computed(self, derivatives: tuple[int, ...], samples: Array, points: Array) -> list[Array]:
        """`at` for several derivatives, of arrays with more axes in front, over which they are broadcast; so are the results.

        The functions of samples are made once for all points.
        """
        d = points.shape[-1]
        ahead = samples.shape[: -d - 1]
        lead = np.broadcast_shapes(ahead, points.shape[:-2])
        points = np.broadcast_to(points, lead + points.shape[-2:])
        shape = (*lead, samples.shape[-d - 1], points.shape[-2])
        found = [np.empty(shape + (d,) * derivative, samples.dtype) for derivative in derivatives]
        for index in np.ndindex(ahead):
            place = tuple(i if n > 1 else slice(None) for i, n in zip(index, ahead, strict=True))
            some = points[place]
            with self.field(samples[index]) or nullcontext() as field:
                for result, derivative in zip(found, derivatives, strict=True):
                    flat = self.at(field, some.reshape(-1, d), derivative)
                    parts = flat.reshape(len(flat), *some.shape[:-1], *flat.shape[2:])
                    result[place] = np.moveaxis(parts, 0, some.ndim - 2)
        return found

    def spread(self, given: Array, points: Array, shape: tuple[int, ...], derivative: int) -> Array:
        """The adjoint of `at`, to samples on a grid of `shape`: from (n, N), or (n, N, d) for gradients."""
        like = Volume(np.broadcast_to(np.float32(0), shape), self.spacing, self.origin)
        if self.fill is not None:
            points = np.where(self._inside(points, shape)[:, None], points, np.nan)  # which adds nothing
        options: Any = {"device": self.device, "precision": self.precision}
        spread = [adjoint(each, points, like, self.filter, self.boundary, derivative, **options) for each in given]
        return np.stack(spread) if spread else np.empty((0, *shape))

    def _inside(self, points: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        index = (np.asarray(points, np.float64) - self.origin) / self.spacing
        return np.asarray(((index >= -0.5) & (index <= np.array(shape[::-1]) - 0.5)).all(-1))


def _along(value: Sequence[float] | float, d: int) -> tuple[float, ...]:
    """One number per axis; a single number applies to all."""
    return tuple(np.asarray(value).tolist()) if np.ndim(value) == 1 else (number("spacing or origin", value),) * d
