"""Sample PyTorch tensors, with gradients through samples and points, and radiographs with gradients through poses: an extra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.base.checks import number
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER
from clvol.spline.field import Field, Precision
from clvol.spline.function import fill_value
from clvol.spline.scatter import adjoint, linear
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from torch import Tensor

    from clvol.interfaces.radiograph import Radiograph

__all__ = ["radiograph", "sample"]


def sample(
    values: Tensor,
    points: Tensor,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    spacing: Sequence[float] | float = 1.0,
    origin: Sequence[float] | float = 0.0,
    fill: float | None = None,
    device: Device | str | int | None = None,
) -> Tensor:
    """Evaluate the spline through samples at points, as `clvol.sample` does, differentiable in both.

    Gradients are exact: with respect to points they are those of the spline, with respect to samples the adjoint of sampling
    (`clvol.adjoint`). Both can be differentiated once more, so that a loss may include gradients of the sampled function.
    Results and gradients are reproducible to the last bit.

    Parameters
    ----------
    values : Tensor of float32 or float64, shape (..., ny, nx) or (..., nz, ny, nx)
        Samples, on the host. Leading axes (batches, channels) are separate functions, sampled at the same points.
    points : Tensor of float32 or float64, shape (..., d)
        Positions (x, y) or (x, y, z), on the host; the last `d` axes of `values` are those of the grid. As
        everywhere in clvol, x comes first and belongs to the last axis.
    filter, boundary
        See `clvol.sample`; no hybrid, and no smoothing that depends on a volume ("auto", lengths).
    spacing, origin : float or sequence of float
        Positions of samples: index (i, j[, k]) is at ``origin + (i, j[, k]) * spacing``. By default positions are indices.
    fill : float, optional
        The result outside the domain, which ends half a sample outside the outer ones, and where a position is not finite; its
        gradients are zero. None: the boundary rule applies.
    device : Device, str or int, optional
        OpenCL device; see `as_device`.

    Returns
    -------
    Tensor, shape: the leading axes of `values`, then those of `points` without the last
        The dtype of `values`. float64 is computed in double precision throughout, float32 in single.

    Raises
    ------
    MissingDependencyError
        PyTorch is not installed.
    OptionError
        Tensors have another dtype, are on another device, or have shapes that do not match; the filter or boundary is unknown or
        not linear in the samples.
    DataError
        A sample is not finite.
    DeviceError
        There is no usable OpenCL device; float64 tensors need one with double precision.

    Examples
    --------
    >>> shift = torch.zeros(3, requires_grad=True)
    >>> loss = ((clvol.torch.sample(moving, points + shift) - fixed) ** 2).mean()
    >>> loss.backward()                                              # shift.grad
    """
    torch = _torch()
    for what, tensor in (("values", values), ("points", points)):
        _require_tensor(what, tensor)
    d = points.shape[-1] if points.ndim else 0
    if d not in (2, 3):
        raise OptionError(f"points must have shape (..., 2) or (..., 3); got {tuple(points.shape)}")
    if values.ndim < d:
        raise OptionError(f"values must have at least the {d} axes that points have coordinates; got shape {tuple(values.shape)}")
    precision: Precision = "double" if values.dtype == torch.float64 else "single"
    grid = _Sampling(*linear(filter, boundary), as_device(device), _along(spacing, d), _along(origin, d), precision)
    at, outside = points, fill_value(fill)
    if outside is not None:
        index = (points.detach().double() - torch.tensor(grid.origin)) / torch.tensor(grid.spacing)
        size = torch.tensor(tuple(values.shape[-d:][::-1]))
        inside = ((index >= -0.5) & (index <= size - 0.5)).all(-1)
        # outside, sample a dummy point in the domain, whose result and gradient are discarded
        at = torch.where(inside[..., None], points, torch.tensor(grid.origin, dtype=points.dtype))
    functions = values.reshape(-1, *values.shape[-d:])
    each = [_functions().Value.apply(function, at, grid, _Kept()) for function in functions]
    result = torch.stack(each) if each else values.new_zeros((0, *points.shape[:-1]))
    result = result.reshape(values.shape[:-d] + points.shape[:-1])
    return result if outside is None else torch.where(inside, result, outside)


def radiograph(pose: Tensor, of: Radiograph) -> Tensor:
    """The line integrals of a volume in a pose, differentiable in the pose.

    Parameters
    ----------
    pose : Tensor of float32 or float64, shape (6,)
        A translation along x, y and z, in world units, and a rotation vector in radians about the volume's centre: see
        `clvol.Radiograph`.
    of : Radiograph
        The volume and the camera.

    Returns
    -------
    Tensor of the pose's dtype, shape (height, width)
        If the pose requires a gradient, the derivatives are computed in the same march, at less than three times the time. They
        cannot be differentiated again.

    Raises
    ------
    MissingDependencyError
        PyTorch is not installed.
    OptionError
        The tensor is of another dtype or shape, is on another device, or is not finite.

    Examples
    --------
    >>> pose = torch.zeros(6, requires_grad=True)
    >>> loss = ((clvol.torch.radiograph(pose, radiograph) - fixed) ** 2).mean()
    >>> loss.backward()                                              # pose.grad
    """
    _require_tensor("pose", pose)
    return _functions().Radiograph.apply(pose, of)


def _require_tensor(what: str, tensor: Tensor) -> None:
    torch = _torch()
    if not isinstance(tensor, torch.Tensor) or tensor.dtype not in (torch.float32, torch.float64):
        raise OptionError(f"{what} must be a tensor of float32 or float64; got {getattr(tensor, 'dtype', type(tensor))}")
    if tensor.device.type != "cpu":
        raise OptionError(f"{what} must lie in the host's memory; got a tensor on {tensor.device}: copy it first, tensor.cpu()")


@dataclass(frozen=True)
class _Sampling:
    """What is sampled, but for the samples."""

    filter: Filter
    boundary: Boundary
    device: Device
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    precision: Precision

    def volume(self, data: Any) -> Volume:
        return Volume(data, self.spacing, self.origin)

    def field(self, values: Tensor) -> Field:
        return Field(self.volume(values), self.filter, self.boundary, self.device, precision=self.precision)


class _Kept:
    """Cache of a tensor's field, shared by the gradients of one sampling."""

    field: Field | None = None

    def of(self, grid: _Sampling, values: Tensor) -> Field:
        if self.field is None:
            self.field = grid.field(values)
        return self.field


@cache
def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise MissingDependencyError("clvol.torch needs PyTorch: pip install clvol[torch]") from error
    return torch


@cache
def _functions() -> SimpleNamespace:
    """The differentiable functions, subclasses of PyTorch's `Function`.

    `Value` and `Gradient` sample, `Spread` is the adjoint of `Value`. The gradients of each use these functions, so that
    they can be differentiated again.
    """
    torch = _torch()

    def tensor(array: Any, like: Tensor) -> Any:
        return torch.from_numpy(np.ascontiguousarray(array)).to(like.dtype)

    class Value(torch.autograd.Function):  # type: ignore[misc, name-defined]  # PyTorch is imported late
        """Samples, points → values."""

        @staticmethod
        def forward(ctx: Any, values: Tensor, points: Tensor, grid: _Sampling, kept: _Kept) -> Any:
            ctx.save_for_backward(values, points)
            ctx.grid, ctx.kept = grid, kept
            return tensor(kept.of(grid, values)(points), values)

        @staticmethod
        def backward(ctx: Any, given: Tensor) -> Any:
            (values, points), grid, for_values, for_points = ctx.saved_tensors, ctx.grid, None, None
            if ctx.needs_input_grad[0]:
                for_values = Spread.apply(given, points, grid, tuple(values.shape))
            if ctx.needs_input_grad[1]:
                for_points = (given[..., None] * Gradient.apply(values, points, grid, ctx.kept)).to(points.dtype)
            return for_values, for_points, None, None

    class Spread(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Values, points → samples: the adjoint of `Value`, linear in the values."""

        @staticmethod
        def forward(ctx: Any, given: Tensor, points: Tensor, grid: _Sampling, shape: tuple[int, ...]) -> Any:
            ctx.save_for_backward(given, points)
            ctx.grid = grid
            return _spread(grid, given, points, shape, 0)

        @staticmethod
        def backward(ctx: Any, samples: Tensor) -> Any:
            (given, points), grid, kept = ctx.saved_tensors, ctx.grid, _Kept()
            for_given = for_points = None
            if ctx.needs_input_grad[0]:
                for_given = Value.apply(samples, points, grid, kept)
            if ctx.needs_input_grad[1]:
                for_points = (given[..., None] * Gradient.apply(samples, points, grid, kept)).to(points.dtype)
            return for_given, for_points, None, None

    class Gradient(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Samples, points → gradients of the function; their gradients cannot be differentiated again."""

        @staticmethod
        def forward(ctx: Any, values: Tensor, points: Tensor, grid: _Sampling, kept: _Kept) -> Any:
            ctx.save_for_backward(values, points)
            ctx.grid, ctx.kept = grid, kept
            return tensor(kept.of(grid, values).gradient(points), values)

        @staticmethod
        def _backward(ctx: Any, given: Tensor) -> Any:
            (values, points), grid, for_values, for_points = ctx.saved_tensors, ctx.grid, None, None
            if ctx.needs_input_grad[0]:
                for_values = _spread(grid, given, points, tuple(values.shape), 1)
            if ctx.needs_input_grad[1]:
                hessian = tensor(ctx.kept.of(grid, values).hessian(points), values)
                for_points = (hessian @ given[..., None])[..., 0].to(points.dtype)
            return for_values, for_points, None, None

        backward = staticmethod(torch.autograd.function.once_differentiable(_backward))

    class Radiograph(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Pose → line integrals; their gradients cannot be differentiated again."""

        @staticmethod
        def forward(ctx: Any, pose: Tensor, of: Any) -> Any:
            six = pose.detach().numpy()
            if not ctx.needs_input_grad[0]:
                return tensor(of(six), pose)
            picture, slopes = of.gradient(six)
            ctx.save_for_backward(tensor(slopes, pose))
            return tensor(picture, pose)

        @staticmethod
        def _backward(ctx: Any, given: Tensor) -> Any:
            (slopes,) = ctx.saved_tensors
            return torch.einsum("yx,yxk->k", given, slopes), None

        backward = staticmethod(torch.autograd.function.once_differentiable(_backward))

    def _spread(grid: _Sampling, given: Tensor, points: Tensor, shape: tuple[int, ...], derivative: int) -> Any:
        like = grid.volume(np.broadcast_to(np.float32(0), shape))
        spread = adjoint(given, points, like, grid.filter, grid.boundary, derivative, device=grid.device, precision=grid.precision)
        return tensor(spread, given)

    return SimpleNamespace(Value=Value, Spread=Spread, Gradient=Gradient, Radiograph=Radiograph)


def _along(value: Sequence[float] | float, d: int) -> tuple[float, ...]:
    """One number per axis; a single number applies to all."""
    return tuple(np.asarray(value).tolist()) if np.ndim(value) == 1 else (number("spacing or origin", value),) * d
