"""Sample JAX arrays, with gradients through samples and points, and radiographs with gradients through poses: an extra."""

from __future__ import annotations

from functools import cache, partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from clvol.base.errors import MissingDependencyError, OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER
from clvol.interfaces.differentiable import Sampling, SamplingOptions

if TYPE_CHECKING:
    from jax import Array

    from clvol.interfaces.radiograph import Radiograph
    from clvol.spline.field import Precision

__all__ = ["radiograph", "sample"]


def sample(
    values: Array,
    points: Array,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    **options: Unpack[SamplingOptions],
) -> Array:
    """Evaluate the spline through samples at points, as `clvol.sample` does, differentiable in both.

    Gradients are exact: with respect to points they are those of the spline, with respect to samples the adjoint of sampling
    (`clvol.adjoint`). Both can be differentiated once more. It works under `jax.jit`, `jax.grad` and `jax.vmap`, where it is a
    callback to this process, but not under `jax.jvp`, which is forward mode.

    Parameters
    ----------
    values : array of float32 or float64, shape (..., ny, nx) or (..., nz, ny, nx)
        Samples. Leading axes (batches, channels) are separate functions, sampled at the same points.
    points : array of float32 or float64, shape (..., d)
        Positions (x, y) or (x, y, z); the last `d` axes of `values` are those of the grid. As everywhere in clvol, x comes first
        and belongs to the last axis. `jax.vmap` over points computes the spline's coefficients once, over values once for each.
    filter, boundary, spacing, origin, fill, device
        As of `clvol.torch.sample`.

    Returns
    -------
    jax.Array, shape: the leading axes of `values`, then those of `points` without the last
        The dtype of `values`. float64 is computed in double precision throughout, float32 in single.

    Raises
    ------
    MissingDependencyError
        JAX is not installed.
    OptionError
        Arrays have another dtype, or shapes that do not match; the filter or boundary is unknown or not linear in the samples.
    DeviceError
        There is no usable OpenCL device.
    jax.errors.JaxRuntimeError
        What is found only when numbers are there, such as a sample that is not finite: it quotes clvol's own error.

    Examples
    --------
    >>> def loss(shift):
    ...     return ((clvol.jax.sample(moving, points + shift) - fixed) ** 2).mean()
    >>> slope = jax.jit(jax.grad(loss))(jax.numpy.zeros(3))
    """
    values, points = (_as_array(what, array) for what, array in (("values", values), ("points", points)))
    precision: Precision = "double" if values.dtype == np.float64 else "single"
    sampling = Sampling.of(values.shape, points.shape, precision, filter, boundary, **options)
    d = points.shape[-1]
    flat = _functions().value(sampling, values.reshape(-1, *values.shape[-d:]), points.reshape(-1, d))
    return flat.reshape(values.shape[:-d] + points.shape[:-1])


def radiograph(pose: Array, of: Radiograph) -> Array:
    """The line integrals of a volume in a pose, differentiable in the pose.

    Parameters
    ----------
    pose : array of float32 or float64, shape (6,)
        A translation along x, y and z, in world units, and a rotation vector in radians about the volume's centre: see
        `clvol.Radiograph`.
    of : Radiograph
        The volume and the camera.

    Returns
    -------
    jax.Array of the pose's dtype, shape (height, width)
        Where it is differentiated, the derivatives are computed in the same march, at less than three times the time. They
        cannot be differentiated again.

    Raises
    ------
    MissingDependencyError
        JAX is not installed.
    OptionError
        The array is of another dtype or shape.
    jax.errors.JaxRuntimeError
        The pose is not finite.

    Examples
    --------
    >>> def loss(pose):
    ...     return ((clvol.jax.radiograph(pose, radiograph) - fixed) ** 2).mean()
    >>> slope = jax.grad(loss)(jax.numpy.zeros(6))
    """
    pose = _as_array("pose", pose)
    if pose.shape != (6,):
        raise OptionError(f"pose must have shape (6,); got {pose.shape}")
    return _functions().radiograph(of, pose)


def _as_array(what: str, array: Any) -> Array:
    converted = _jax().numpy.asarray(array)
    if converted.dtype not in (np.float32, np.float64):
        raise OptionError(f"{what} must be an array of float32 or float64; got {converted.dtype}")
    return converted


@cache
def _jax() -> Any:
    try:
        import jax
    except ImportError as error:
        raise MissingDependencyError('clvol.jax needs JAX: pip install "clvol[jax]"') from error
    return jax


@cache
def _functions() -> SimpleNamespace:
    """The differentiable functions.

    `value` and `both` sample, `spread` is the adjoint of `value`. The gradients of `value` and `spread` use these functions, so
    that they can be differentiated again; those of `both` cannot.
    """
    jax = _jax()
    differentiable = partial(jax.custom_vjp, nondiff_argnums=(0,))

    def at(sampling: Sampling, derivatives: tuple[int, ...], values: Array, points: Array) -> Any:
        d = points.shape[1]
        shape = len(values), len(points)
        made = [jax.ShapeDtypeStruct(shape + (d,) * derivative, values.dtype) for derivative in derivatives]
        compute = partial(_computed, sampling, derivatives)
        return jax.pure_callback(compute, made, values, points, vmap_method="expand_dims")

    def spread_by(sampling: Sampling, derivative: int, shape: tuple[int, ...], given: Array, points: Array) -> Any:
        made = jax.ShapeDtypeStruct((len(given), *shape), given.dtype)
        compute = partial(_spread, sampling, derivative, shape)
        return jax.pure_callback(compute, made, given, points, vmap_method="sequential")

    def along(given: Array, gradients: Array, points: Array) -> Array:
        """Gradients times the numbers given for their functions, summed over these."""
        return jax.numpy.einsum("fn,fni->ni", given, gradients).astype(points.dtype)

    @differentiable
    def value(sampling: Sampling, values: Array, points: Array) -> Any:
        """Samples, points → values."""
        return at(sampling, (0,), values, points)[0]

    def value_forward(sampling: Sampling, values: Any, points: Any) -> Any:
        given = values.value, points.value
        found, gradients = both(sampling, *given) if points.perturbed else (value(sampling, *given), None)
        return found, (values.value if values.perturbed else None, points.value, gradients)

    def value_backward(sampling: Sampling, kept: Any, given: Array) -> Any:
        values, points, gradients = kept
        shape = None if values is None else values.shape[1:]
        return (
            None if shape is None else spread((sampling, shape), given, points),
            None if gradients is None else along(given, gradients, points),
        )

    value.defvjp(value_forward, value_backward, symbolic_zeros=True)

    @differentiable
    def both(sampling: Sampling, values: Array, points: Array) -> Any:
        """Samples, points → values and gradients."""
        return at(sampling, (0, 1), values, points)

    def both_forward(sampling: Sampling, values: Array, points: Array) -> Any:
        found = both(sampling, values, points)
        return found, (values, points, found[1])

    def both_backward(sampling: Sampling, kept: Any, given: Any) -> Any:
        (values, points, gradients), (for_value, for_gradient), shape = kept, given, kept[0].shape[1:]
        (hessian,) = at(sampling, (2,), values, points)
        bent = jax.numpy.einsum("fni,fnij->nj", for_gradient, hessian).astype(points.dtype)
        by_value, by_gradient = (
            spread_by(sampling, 0, shape, for_value, points),
            spread_by(sampling, 1, shape, for_gradient, points),
        )
        return by_value + by_gradient, along(for_value, gradients, points) + bent

    both.defvjp(both_forward, both_backward)

    @differentiable
    def spread(how: tuple[Sampling, tuple[int, ...]], given: Array, points: Array) -> Any:
        """Values, points → samples: the adjoint of `value`, linear in the values."""
        sampling, shape = how
        return spread_by(sampling, 0, shape, given, points)

    def spread_forward(how: Any, given: Array, points: Array) -> Any:
        return spread(how, given, points), (given, points)

    def spread_backward(how: Any, kept: Any, samples: Array) -> Any:
        given, points = kept
        found, gradients = both(how[0].linear, samples, points)
        return found, along(given, gradients, points)

    spread.defvjp(spread_forward, spread_backward)

    @differentiable
    def radiograph(of: Radiograph, pose: Array) -> Any:
        """Pose → line integrals; their gradients cannot be differentiated again."""
        made = jax.ShapeDtypeStruct(of.size[::-1], pose.dtype)
        return jax.pure_callback(lambda six: np.asarray(of(np.asarray(six)), made.dtype), made, pose, vmap_method="sequential")

    def radiograph_forward(of: Radiograph, pose: Array) -> Any:
        made = [jax.ShapeDtypeStruct(of.size[::-1] + more, pose.dtype) for more in ((), (6,))]
        compute = lambda six: [np.asarray(array, pose.dtype) for array in of.gradient(np.asarray(six))]  # noqa: E731
        return jax.pure_callback(compute, made, pose, vmap_method="sequential")

    def radiograph_backward(_: Radiograph, slopes: Array, given: Array) -> Any:
        return (jax.numpy.einsum("yx,yxk->k", given, slopes),)

    radiograph.defvjp(radiograph_forward, radiograph_backward)
    return SimpleNamespace(value=value, radiograph=radiograph)


def _computed(sampling: Sampling, derivatives: tuple[int, ...], values: Array, points: Array) -> Any:
    return sampling.computed(derivatives, np.asarray(values), np.asarray(points))


def _spread(sampling: Sampling, derivative: int, shape: tuple[int, ...], given: Array, points: Array) -> Any:
    return sampling.spread(np.asarray(given), np.asarray(points), shape, derivative).astype(given.dtype)
