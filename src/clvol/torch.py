"""Sample PyTorch tensors, with gradients through samples and points, and radiographs with gradients through poses: an extra."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from clvol.base.errors import MissingDependencyError, OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER
from clvol.interfaces.differentiable import Sampling, SamplingOptions

if TYPE_CHECKING:
    from torch import Tensor

    from clvol.interfaces.radiograph import Radiograph
    from clvol.spline.field import Precision
    from clvol.spline.vectors import VectorField

__all__ = ["radiograph", "sample"]


def sample(
    values: Tensor,
    points: Tensor,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    **options: Unpack[SamplingOptions],
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
    precision: Precision = "double" if values.dtype == torch.float64 else "single"
    sampling = Sampling.of(tuple(values.shape), tuple(points.shape), precision, filter, boundary, **options)
    d = points.shape[-1]
    flat = _functions().Value.apply(values.reshape(-1, *values.shape[-d:]), points.reshape(-1, d), sampling, _Kept())
    return flat.reshape(values.shape[:-d] + points.shape[:-1])


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


class _Kept:
    """Cache of a tensor's functions, shared by the gradients of one sampling."""

    made = False
    field: VectorField | None

    def at(self, sampling: Sampling, values: Tensor, points: Tensor, derivative: int) -> Any:
        """The functions' values or derivatives as a tensor."""
        if not self.made:
            self.field, self.made = sampling.field(values.detach().numpy()), True
        return _tensor(sampling.at(self.field, points.detach().numpy(), derivative), values)


def _spread(sampling: Sampling, given: Tensor, points: Tensor, shape: tuple[int, ...], derivative: int) -> Any:
    return _tensor(sampling.spread(given.detach().numpy(), points.detach().numpy(), shape[1:], derivative), given)


def _tensor(array: Any, like: Tensor) -> Any:
    return _torch().from_numpy(np.ascontiguousarray(array)).to(like.dtype)


@cache
def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise MissingDependencyError('clvol.torch needs PyTorch: pip install "clvol[torch]"') from error
    return torch


@cache
def _functions() -> SimpleNamespace:
    """The differentiable functions, subclasses of PyTorch's `Function`.

    `Value` and `Gradient` sample, `Spread` is the adjoint of `Value`. The gradients of each use these functions, so that
    they can be differentiated again.
    """
    torch = _torch()

    def along(given: Tensor, gradients: Tensor, points: Tensor) -> Any:
        """Gradients times the numbers given for their functions, summed over these."""
        return torch.einsum("fn,fni->ni", given, gradients).to(points.dtype)

    class Value(torch.autograd.Function):  # type: ignore[misc, name-defined]  # PyTorch is imported late
        """Samples, points → values."""

        @staticmethod
        def forward(ctx: Any, values: Tensor, points: Tensor, sampling: Sampling, kept: _Kept) -> Any:
            ctx.save_for_backward(values, points)
            ctx.sampling, ctx.kept = sampling, kept
            return kept.at(sampling, values, points, 0)

        @staticmethod
        def backward(ctx: Any, given: Tensor) -> Any:
            (values, points), sampling, for_values, for_points = ctx.saved_tensors, ctx.sampling, None, None
            if ctx.needs_input_grad[0]:
                for_values = Spread.apply(given, points, sampling, tuple(values.shape))
            if ctx.needs_input_grad[1]:
                for_points = along(given, Gradient.apply(values, points, sampling, ctx.kept), points)
            return for_values, for_points, None, None

    class Spread(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Values, points → samples: the adjoint of `Value`, linear in the values."""

        @staticmethod
        def forward(ctx: Any, given: Tensor, points: Tensor, sampling: Sampling, shape: tuple[int, ...]) -> Any:
            ctx.save_for_backward(given, points)
            ctx.sampling = sampling.linear
            return _spread(sampling, given, points, shape, 0)

        @staticmethod
        def backward(ctx: Any, samples: Tensor) -> Any:
            (given, points), sampling, kept = ctx.saved_tensors, ctx.sampling, _Kept()
            for_given = for_points = None
            if ctx.needs_input_grad[0]:
                for_given = Value.apply(samples, points, sampling, kept)
            if ctx.needs_input_grad[1]:
                for_points = along(given, Gradient.apply(samples, points, sampling, kept), points)
            return for_given, for_points, None, None

    class Gradient(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Samples, points → gradients of the functions; their gradients cannot be differentiated again."""

        @staticmethod
        def forward(ctx: Any, values: Tensor, points: Tensor, sampling: Sampling, kept: _Kept) -> Any:
            ctx.save_for_backward(values, points)
            ctx.sampling, ctx.kept = sampling, kept
            return kept.at(sampling, values, points, 1)

        @staticmethod
        def _backward(ctx: Any, given: Tensor) -> Any:
            (values, points), sampling, for_values, for_points = ctx.saved_tensors, ctx.sampling, None, None
            if ctx.needs_input_grad[0]:
                for_values = _spread(sampling, given, points, tuple(values.shape), 1)
            if ctx.needs_input_grad[1]:
                hessian = ctx.kept.at(sampling, values, points, 2)
                for_points = torch.einsum("fni,fnij->nj", given, hessian).to(points.dtype)
            return for_values, for_points, None, None

        backward = staticmethod(torch.autograd.function.once_differentiable(_backward))

    class Radiograph(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """Pose → line integrals; their gradients cannot be differentiated again."""

        @staticmethod
        def forward(ctx: Any, pose: Tensor, of: Any) -> Any:
            six = pose.detach().numpy()
            if not ctx.needs_input_grad[0]:
                return _tensor(of(six), pose)
            picture, slopes = of.gradient(six)
            ctx.save_for_backward(_tensor(slopes, pose))
            return _tensor(picture, pose)

        @staticmethod
        def _backward(ctx: Any, given: Tensor) -> Any:
            (slopes,) = ctx.saved_tensors
            return torch.einsum("yx,yxk->k", given, slopes), None

        backward = staticmethod(torch.autograd.function.once_differentiable(_backward))

    return SimpleNamespace(Value=Value, Spread=Spread, Gradient=Gradient, Radiograph=Radiograph)
