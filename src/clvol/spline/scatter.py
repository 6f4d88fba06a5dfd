"""The adjoint of sampling, from values at points to samples: the host side of scatter.cl, and the prefilter's transpose."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array
from clvol.base.checks import several, whole
from clvol.base.errors import OptionError
from clvol.device import as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary, boundaries
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.spline.build import boundary_defines, filter_defines, point_defines
from clvol.spline.coefficients import require_kind
from clvol.spline.field import precision_kind, prefilter
from clvol.spline.function import points_in_world
from clvol.spline.points import Transform
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.field import Precision
    from clvol.volume.stored import Reals

__all__ = ["adjoint", "linear"]

Samples: TypeAlias = NDArray[Any]

_BRICK = 8  # coefficients along a brick, at least
_MOST_POINTS = np.iinfo(np.int32).max


def adjoint(
    values: ArrayLike,
    points: ArrayLike,
    like: Volume | Sequence[int],
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    derivative: int = 0,
    *,
    device: Device | str | int | None = None,
    precision: Precision = "single",
) -> Reals:
    """The adjoint of `clvol.sample`: spreads values at points onto a grid of samples.

    Sampling is linear in the samples: ``sample(v, points) = A v``. This is ``Aᵀ values``, the gradient of ``sum(values *
    sample(v, points))`` with respect to `v`: each value is added to the coefficients of its point's taps, times their weights
    ("push" in SPM and torch-interpol, "spreading" in non-uniform Fourier transforms), coefficients outside are folded back by the
    boundary rule, and the transpose of the prefilter is applied.

    Parameters
    ----------
    values : array-like, shape (...), or (..., d) for gradients
        A finite number for each point, or for each component of its gradient.
    points : array-like, shape (..., d)
        World positions (x, y) or (x, y, z). Positions that are not finite add nothing.
    like : Volume or sequence of int
        The grid of the result: the grid of a volume, whose samples are ignored; or a shape, with spacing 1 and origin 0.
    filter, boundary
        As for `clvol.sample`, but without hybrids and smoothing that depends on the volume ("auto", lengths), where sampling is
        not one linear map.
    derivative : {0, 1}
        Of the sampling: 0 for values, 1 for gradients.
    device : Device, str or int, optional
        See `as_device`.
    precision : {"single", "double"}
        Precision of results: float32, or float64 on devices that support it.

    Returns
    -------
    ndarray of float32 or float64, of the shape of `like`

    Raises
    ------
    OptionError
        `values` are not finite real numbers, or do not match the shape of `points`; `points`, `like`, `filter`, `boundary` or
        `derivative` is not one of the above.
    DeviceError, OutOfMemoryError
        As for `clvol.sample`.

    Notes
    -----
    The result is the same to the last bit on every run on a device. The prefilter solves ``K c = v`` along each axis (eq. 11).
    With m the number of times that the boundary rule repeats an index in a period, ``diag(m) K`` is symmetric, so that
    ``K⁻ᵀ = diag(m) K⁻¹ diag(1/m)``.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> spread = clvol.adjoint(np.ones(2), [(1, 1, 1), (2.5, 2, 2)], like=(4, 4, 4))
    >>> spread.shape
    (4, 4, 4)
    """
    derivative = whole("derivative", derivative, minimum=0, maximum=1)
    grid = like if isinstance(like, Volume) else _grid(like)
    d = grid.ndim
    at = points_in_world(points, "LPS", grid)
    added = as_array(values, "values", OptionError, "real numbers")
    expected = at.shape[:-1] + (d,) * derivative
    if added.dtype.kind not in "biuf" or added.shape != expected:
        raise OptionError(
            f"values must be real numbers of shape {expected}, as points are; got {added.dtype} of shape {added.shape}"
        )
    memory.require(at.size // d * (4 * (2 * d + d**derivative) + 40), f"the sorted taps of {at.size // d} points")
    if not np.isfinite(added).all():
        raise OptionError("values must be finite; got NaN or infinite ones")
    (row, rule), kind, chosen = linear(filter, boundary), precision_kind(precision), as_device(device)
    require_kind(kind, chosen)
    stored = _scattered(added.reshape(-1, d**derivative), at.reshape(-1, d), grid, row, rule, kind, chosen)
    for axis, n in enumerate(grid.shape):
        stored = _brought_back(stored, axis, n, row.support + 1, rule)
    if not row.prefilter:
        return stored
    _scale_folds(stored, rule, 2.0)
    result = prefilter(stored, row, rule, chosen, precision=precision)
    _scale_folds(result, rule, 0.5)
    return result.astype(stored.dtype, copy=False)


def _grid(shape: Sequence[int]) -> Volume:
    """A grid with spacing 1 and origin 0: a Volume whose samples take no memory."""
    rule = "a Volume, or 2 or 3 whole numbers"
    sizes = [whole("each number of a shape", n, minimum=1) for n in several("like", shape, rule, 3)]
    if len(sizes) == 1:
        raise OptionError(f"like must be {rule}; got {shape!r}")
    memory.require_addressable("a grid", tuple(sizes))
    return Volume(np.broadcast_to(np.float32(0), sizes))


def linear(filter: str | Filter, boundary: str | Boundary) -> tuple[Filter, Boundary]:
    """The filter and the boundary rule; raises `OptionError` unless sampling with them is one linear map on one grid."""
    row, rule = as_filter(filter), as_boundary(boundary)
    if row.magnified_by is not None:
        raise OptionError(f"the adjoint needs a filter on the samples' own grid; got the hybrid {row.name!r}")
    if not row.settled:
        raise OptionError(f"the adjoint needs a filter that no volume decides on: smoothing must be numbers; got {row.name!r}")
    if rule.outside != "rule":
        known = [name for name, one in boundaries().items() if one.outside == "rule"]
        raise OptionError(f"the adjoint needs a boundary rule that extends coefficients: {', '.join(known)}; got {rule.name!r}")
    return row, rule


def _scattered(
    added: Samples, points: Samples, grid: Volume, row: Filter, rule: Boundary, scalar: type[np.generic], device: Device
) -> Samples:
    """Values or gradients times the weights of their points' taps, on a grid with a margin of taps + 1 (scatter.cl)."""
    from scipy import sparse

    taps, d, (count, components) = row.support, grid.ndim, added.shape
    margin = taps + 1
    if count > _MOST_POINTS:
        raise OptionError(f"points must be at most {_MOST_POINTS}; got {count}")
    brick = max(_BRICK, taps)
    stored = np.array([*(n + 2 * margin for n in grid.size), 1, 0][:4], np.int32)
    bricks = np.array([*(-(-n // brick) for n in stored[:d].tolist()), 1, 0][:4], np.int32)
    size = np.array([*grid.size, 1, 0][:4], np.int32)
    period = np.array([*(rule.length(n) for n in grid.size), 0, 0][:4], np.int32)
    kind = np.float64 if device.has_double and points.dtype != np.float32 else np.float32
    shape = tuple(n + 2 * margin for n in grid.shape)
    taken = np.dtype(scalar).itemsize * (2 * math.prod(shape) + count * (2 * d + components)) + count * 40
    memory.require(taken, f"{count} points on a grid of {' × '.join(map(str, grid.shape))} samples")
    result = np.zeros(shape, scalar)
    if count == 0:
        return result
    built = device.build(
        "spline/scatter.cl",
        {
            **filter_defines(row, scalar),
            **boundary_defines(rule, 0, rule.reach(taps)),
            **point_defines(kind),
            "DIMENSIONS": d,
            "DERIVATIVE": int(components > 1),
            "BRICK": brick,
            "LANES": 1,
            "COORD_DOUBLE": int(device.has_double),
        },
    )
    transform = Transform.into(grid)
    if not device.has_double:
        points, transform = transform.indices(points), transform.after_indices
    matrix = transform.upload(device)
    item = np.dtype(scalar).itemsize
    places, fractions, weights = (device.buffers.allocate(n * count) for n in (8, item * d, item * components))
    brick_of = np.empty(count, np.uint32)
    with (
        device.buffers.lent(np.ascontiguousarray(points, kind), write=False) as given,
        device.buffers.lent(np.ascontiguousarray(added, scalar), write=False) as wanted,
        device.buffers.lent(brick_of, write=True) as numbers,
        device.errors,
    ):
        built.kernel("locate_points")(
            device.queue,
            (-(-count // 64) * 64,),
            (64,),
            size,
            period,
            stored,
            bricks,
            matrix,
            given,
            wanted,
            np.uint64(count),
            places,
            fractions,
            weights,
            numbers,
        )
        device.finish()
    total = math.prod(bricks[:3].tolist())
    # a sparse matrix is a stable counting sort: its rows list the points of each brick in their order
    (finite,) = np.nonzero(brick_of < total)
    lists = sparse.coo_array((np.ones(finite.size, np.int8), (brick_of[finite].astype(np.int32), finite)), (total, count))
    rows = lists.tocsr()
    order, starts = device.buffers.upload(rows.indices.astype(np.int32)), device.buffers.upload(rows.indptr.astype(np.int32))
    with device.buffers.lent(result, write=True) as buffer:
        for z, y, x in itertools.product(*(range(2 if n > 1 else 1) for n in bricks[2::-1].tolist())):
            with device.errors:
                built.kernel("scatter_points")(
                    device.queue,
                    tuple(-(-n // 2) for n in bricks[:3].tolist()),
                    device.alone(3),
                    stored,
                    bricks,
                    np.array([x, y, z, 0], np.int32),
                    places,
                    fractions,
                    weights,
                    order,
                    starts,
                    buffer,
                )
            device.finish()
    return result


def _brought_back(stored: Samples, axis: int, n: int, margin: int, rule: Boundary) -> Samples:
    """Remove the margins of an axis, and add their values to the coefficients that the boundary rule puts there."""
    lines = np.moveaxis(stored, axis, 0)
    inner = lines[margin : margin + n]
    outer = np.r_[-margin:0, n : n + margin]
    for index, place in zip(outer, rule.index(outer, n), strict=True):
        if place >= 0:
            inner[place] += lines[index + margin]
    return np.moveaxis(inner, 0, axis)


def _scale_folds(data: Samples, rule: Boundary, factor: float) -> None:
    """Multiply samples on which the boundary rule folds by `factor` along each axis: a period has them once, all others twice."""
    if rule.period is None or rule.fold is None:
        return
    for axis, n in enumerate(data.shape):
        times = np.bincount(rule.index(np.arange(rule.length(n)), n), minlength=n)
        np.moveaxis(data, axis, 0)[times == 1] *= factor
