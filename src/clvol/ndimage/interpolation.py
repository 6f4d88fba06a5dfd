"""The functions of `scipy.ndimage` that interpolate, by their names, signatures and rules."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.errors import RefusedError, UnsupportedError
from clvol.interop.dispatch import is_in_parts, is_lazy, require_lazy
from clvol.ndimage.antialiasing import widths
from clvol.ndimage.arguments import AnyDevice, Array, Nan, Order, Progress, as_axes, as_axis, as_order, as_shape, warn
from clvol.ndimage.geometry import diagonal, magnified, placed, require_rank, shifted, turned, zoomed
from clvol.ndimage.in_memory import InMemory, require_few
from clvol.ndimage.plan import Affine, Coefficients, Grid, Mapped, Points, Substrate
from clvol.ndimage.small import ALL, Small, coefficients
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing

__all__ = [
    "affine_transform",
    "geometric_transform",
    "map_coordinates",
    "rotate",
    "shift",
    "spline_filter",
    "spline_filter1d",
    "zoom",
]


def spline_filter1d(
    input: ArrayLike, order: int = 3, axis: int = -1, output: Any = np.float64, mode: str = "mirror", *,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """The coefficients of an array's spline along one axis: `scipy.ndimage.spline_filter1d`.

    Parameters
    ----------
    input, order, axis, output, mode
        As in SciPy; for the kinds of `input` see `clvol.ndimage`.
    precision : {"single", "double"}, optional
        Of the computation. The default is single for bool, integers of 8 and 16 bits, float16, float32 and complex64, else double.
    device : Device, str or int, optional
        The OpenCL device; see `clvol.Device`.
    nan : {"propagate", "error"}
        "error" refuses samples that are NaN or infinite; "propagate" computes with them, as SciPy does.
    progress : callable, optional
        Called with the fraction done.
    small : {"scipy", "opencl"}
        What computes a small array, as the page on SciPy says: SciPy, which is done before a kernel has started, or the device.

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    RefusedError
        There is no such `order` or `mode`, or `output` has another shape. (A `RuntimeError`, as SciPy's.)
    AxisError
        `input` has no such axis.
    DtypeError
        `input` holds objects, strings, dates or long doubles.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.spline_filter1d(np.ones(5)).round(6)  # B-splines sum to one
    array([1., 1., 1., 1., 1.])
    """
    how = small, nan, precision, device, progress, None
    if (done := coefficients(input, output, order, mode, axis, how)) is not None:
        return done
    on = _substrate(input)
    spline = on.spline(order, mode, 0.0, True, precision, device, nan, progress)
    axes = [as_axis(axis, on.ndim)] if spline.order > 1 else []
    return on.evaluate(Coefficients("spline_filter1d", spline, output, on.shape, axes))


def spline_filter(
    input: ArrayLike, order: int = 3, output: Any = np.float64, mode: str = "mirror", *,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """The coefficients of an array's spline along all axes: `scipy.ndimage.spline_filter`.

    Parameters
    ----------
    input, order, output, mode
        As in SciPy. Between two axes coefficients are cut off to the dtype of `output` where that is an integer one, as in SciPy;
        otherwise axes are filtered three at a time, in `precision`.
    precision, device, nan, progress, small
        As for `spline_filter1d`.

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    RefusedError, DtypeError
        As for `spline_filter1d`; `order` is from 2 to 5.

    References
    ----------
    - M. Unser, A. Aldroubi and M. Eden, "B-spline signal processing", IEEE Transactions on Signal Processing 41(2), 1993,
      821–848.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> array = np.random.default_rng(0).normal(size=(20, 20))
    >>> coefficients = ndimage.spline_filter(array)  # once, for any number of calls
    >>> turned = [ndimage.rotate(coefficients, angle, prefilter=False) for angle in (10, 20)]
    """
    how = small, nan, precision, device, progress, None
    if (done := coefficients(input, output, order, mode, ALL, how)) is not None:
        return done
    on = _substrate(input)
    spline = on.spline(as_order(order, minimum=2), mode, 0.0, True, precision, device, nan, progress)
    return on.evaluate(Coefficients("spline_filter", spline, output, on.shape, range(on.ndim)))


def geometric_transform(
    input: ArrayLike, mapping: Callable[..., Sequence[float]], output_shape: Iterable[int] | None = None,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True,
    extra_arguments: tuple[Any, ...] = (), extra_keywords: Mapping[str, Any] | None = None, *, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array at the positions that a function returns: `scipy.ndimage.geometric_transform`.

    Parameters
    ----------
    input, mapping, output_shape, output, order, mode, cval, prefilter, extra_arguments, extra_keywords
        As in SciPy; `mapping` may return any sequence, and must not be a `scipy.LowLevelCallable`. It is called once for each
        element of the result, in order, also where `input` is complex; about a million positions, or a quarter as many as there
        are samples, are in memory at a time. Calls of Python take most of the time: `map_coordinates` of an array of positions is
        many times as fast. With dask, each block of the result reads every chunk, and `mapping` goes to the workers.
    precision, device, nan, progress, small, chunks
        As for `affine_transform`.

    Returns
    -------
    ndarray
        Of `output_shape`.

    Raises
    ------
    UnsupportedError
        `input` has more than three axes, or `mapping` is a `scipy.LowLevelCallable`.
    OptionTypeError
        `mapping` returns something other than a position.
    RefusedError, NotFiniteError, DtypeError
        As for `map_coordinates`.

    Notes
    -----
    A position that is not finite has the value `cval`, in every mode.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.geometric_transform(np.arange(12.0).reshape(4, 3), lambda at: (at[0] - 0.5, at[1] - 0.5), order=1)
    array([[0., 0., 0.],
           [0., 2., 3.],
           [0., 5., 6.],
           [0., 8., 9.]])
    """
    if not isinstance(extra_arguments, tuple):
        raise RefusedError(f"extra_arguments must be a tuple; got {extra_arguments!r}")
    if not isinstance(extra_keywords, (dict, type(None))):
        raise RefusedError(f"extra_keywords must be a dict; got {extra_keywords!r}")
    if not callable(mapping):
        from scipy import LowLevelCallable

        if isinstance(mapping, LowLevelCallable):
            raise UnsupportedError("mapping must be a function of Python here; got a scipy.LowLevelCallable")
        raise RefusedError(f"mapping must be a function; got {mapping!r}")
    extra = extra_keywords or {}
    call = (lambda index: mapping(index, *extra_arguments, **extra)) if extra_arguments or extra else mapping
    how = small, nan, precision, device, progress, chunks
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    answers: list[Sequence[float]] = []
    if little and (done := little.geometric_transform(call, output_shape, answers)) is not None:
        return done
    if little and (at := little.positions(call, output_shape, answers)) is not None:
        if (done := little.map_coordinates(at)) is not None:
            return done
        return map_coordinates(input, at, output, order, mode, cval, prefilter)
    on = _substrate(input, chunks)
    shape = on.shape if output_shape is None else as_shape(output_shape)
    require_rank(on.ndim, len(shape))
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Mapped("geometric_transform", spline, output, shape, mapping, extra_arguments, extra))


def map_coordinates(
    input: ArrayLike, coordinates: ArrayLike,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True, *,
    axes: int | Sequence[int] | None = None, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array at points: `scipy.ndimage.map_coordinates`.

    Parameters
    ----------
    input, coordinates, output, order, mode, cval, prefilter
        As in SciPy. Coordinates may be of any real dtype, and are never rounded to float32; they may be an array of dask, too. In a
        volume by bricks, points that follow each other should be close to each other in space.
    axes : int or sequence of int, optional
        The axes of `input` that `coordinates` are along; all by default. Each index of the others is computed separately, and they
        come first in the result: points in each image of a series are ``map_coordinates(series, points, axes=(1, 2, 3))``, of
        shape ``(len(series), *points.shape[1:])``.
    precision, device, nan, progress, small
        As for `affine_transform`.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the points, where `input` is an array of dask and `coordinates` are not; by default about a million.

    Returns
    -------
    ndarray
        Of shape ``coordinates.shape[1:]``, after the axes without coordinates.

    Raises
    ------
    RefusedError
        There is no such `order` or `mode`, `input` or the result has no axis, or `coordinates` or `output` have the wrong shape or
        dtype. (A `RuntimeError`, as SciPy's.)
    OptionTypeError
        Coordinates or `cval` are complex, or an argument is of the wrong type.
    NotFiniteError
        `cval` is too large for float64.
    DtypeError
        `input` holds objects, strings, dates or long doubles.
    UnsupportedError
        There are coordinates along more than three axes.

    Notes
    -----
    A point with a coordinate that is not finite has the value `cval`, in every mode. A few points in a large array cost no more
    than the samples around them: samples too far away to count in float64 (23 to 47, depending on the order, where `input` is
    filtered) are not read, and a NaN there does not spread.

    References
    ----------
    - P. Thévenaz, T. Blu and M. Unser, "Interpolation revisited", IEEE Transactions on Medical Imaging 19(7), 2000,
      739–758.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.map_coordinates(np.arange(12.0).reshape(4, 3), [[0.5, 2], [0.5, 1]], order=1)  # at (0.5, 0.5) and (2, 1)
    array([2., 7.])
    """
    how = small, nan, precision, device, progress, chunks if axes is None else axes
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    if little and (done := little.map_coordinates(coordinates)) is not None:
        return done
    on = _substrate(input, chunks, coordinates)
    along = as_axes(axes, on.ndim)
    at = on.as_coordinates(coordinates, len(along)) if on.ndim else np.empty(0)
    shape = (*(n for axis, n in enumerate(on.shape) if axis not in along), *at.shape[1:])
    require_rank(on.ndim, len(shape))
    require_few(len(along))
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    if along != sorted(along):
        at = at[np.argsort(along).tolist()]
    return on.evaluate(Points("map_coordinates", spline, output, shape, sorted(along), at))


def affine_transform(
    input: ArrayLike, matrix: ArrayLike, offset: float | Sequence[float] | Array = 0.0, output_shape: Iterable[int] | None = None,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True,
    *, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array on a grid that a matrix places: `scipy.ndimage.affine_transform`.

    Parameters
    ----------
    input, matrix, offset, output_shape, output, order, mode, cval, prefilter
        As in SciPy: the element at index ``o`` of the result has the position ``matrix @ o + offset`` in `input`. Axes whose
        row and column are those of the identity are not interpolated along; each index of them is computed separately.
    precision, device, progress, small
        As for `spline_filter1d`.
    nan : {"propagate", "error", "local"}
        As for `spline_filter1d`; "local": exactly those results are NaN in which a missing sample has weight (see `clvol.Missing`).
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result, where `input` is an array of dask. By default those of `input`, along axes of another length chunks as long
        as its longest.

    Returns
    -------
    ndarray
        Of `output_shape`.

    Raises
    ------
    RefusedError
        `matrix`, `offset`, `output_shape` or `output` has a wrong shape, or as for `map_coordinates`.
    OptionError
        The last row of a homogeneous matrix is not ``[0, ..., 0, 1]``.
    NotFiniteError
        `matrix` or `offset` is not finite. (SciPy gives `cval` everywhere.)
    UnsupportedError
        The matrix mixes more than three axes with each other.

    Notes
    -----
    A zero in a matrix of one axis means what SciPy's documentation says, the position `offset` along this axis; SciPy divides by it
    and gives `cval` everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> image = np.arange(12.0).reshape(4, 3)
    >>> ndimage.affine_transform(image, [[0, 1], [1, 0]], output_shape=(3, 4)).round(6).tolist() == image.T.tolist()
    True
    """
    how = small, nan, precision, device, progress, chunks
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    if little and (done := little.affine_transform(matrix, offset, output_shape)) is not None:
        return done
    on = _substrate(input, chunks)
    like = output if isinstance(output, np.ndarray) else on
    shape = like.shape if output_shape is None else as_shape(output_shape)
    require_rank(on.ndim, len(shape))
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    table, start = placed(matrix, offset, on.ndim, len(shape))
    if table.ndim == 1:
        return on.evaluate(Grid("affine_transform", spline, output, shape, diagonal(table, start, on.shape, shape)))
    return on.evaluate(Affine("affine_transform", spline, output, shape, range(on.ndim), table, start))


def shift(
    input: ArrayLike, shift: float | Sequence[float] | Array,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True,
    *, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array shifted: `scipy.ndimage.shift`.

    Parameters
    ----------
    input, shift, output, order, mode, cval, prefilter
        As in SciPy. Axes whose shift is 0 are not interpolated along; each index of them is computed separately.
    precision, device, nan, progress, small, chunks
        As for `affine_transform`.

    Returns
    -------
    ndarray
        Of the input's shape.

    Raises
    ------
    NotFiniteError
        `shift` is not finite. (SciPy gives `cval` everywhere.)
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.shift(np.array([0.0, 1, 2, 3]), 0.5, order=1, mode="nearest")
    array([0. , 0.5, 1.5, 2.5])
    """
    how = small, nan, precision, device, progress, chunks
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    if little and (done := little.shift(shift)) is not None:
        return done
    on = _substrate(input, chunks)
    require_rank(on.ndim, on.ndim)
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Grid("shift", spline, output, on.shape, shifted(shift, on.shape)))


def zoom(
    input: ArrayLike, zoom: float | Sequence[float] | Array,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True, *,
    grid_mode: bool = False, anti_aliasing: AntiAliasing | bool = False, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array on a grid of another density: `scipy.ndimage.zoom`.

    Parameters
    ----------
    input, zoom, output, order, mode, cval, prefilter, grid_mode
        As in SciPy. Axes whose length does not change are not interpolated along; each index of them is computed separately.
        (SciPy ignores `grid_mode` where `input` is complex.)
    anti_aliasing : {False, True, "gaussian", "least-squares"}
        Where axes get shorter. "gaussian" (and True): after a Gaussian of standard deviation (n / m - 1) / 2 samples along an axis
        that goes from n samples to m. "least-squares": the spline on the new grid that is nearest to that of `input`.
    precision, device, nan, progress, small, chunks
        As for `affine_transform`.

    Returns
    -------
    ndarray
        Each axis has the length ``round(n * zoom)``.

    Raises
    ------
    OptionError
        `zoom` is negative.
    NotFiniteError
        `zoom` is not finite.
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.

    Warns
    -----
    UserWarning
        `grid_mode` is used with a mode whose period or edge is at the centres of the outermost samples.

    References
    ----------
    - M. Unser, A. Aldroubi and M. Eden, "Enlargement or reduction of digital images with minimum loss of information", IEEE
      Transactions on Image Processing 4(3), 1995, 247–258: "least-squares".

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.zoom(np.zeros((20, 30, 40), np.float32), 1.5).shape
    (30, 45, 60)
    >>> ndimage.zoom(np.zeros((64, 64)), 0.5, anti_aliasing="least-squares").shape
    (32, 32)
    """
    how = small, nan, precision, device, progress, anti_aliasing or chunks
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    if little and (done := little.zoom(zoom, grid_mode)) is not None:
        return done
    on = _substrate(input, chunks)
    shape, unchanged = zoomed(zoom, on.shape)
    spline, chosen = on.spline(order, mode, cval, prefilter, precision, device, nan, progress), as_anti_aliasing(anti_aliasing)
    if chosen and spline.labels:
        raise UnsupportedError(f'anti_aliasing is for values, not for order "labels"; got {anti_aliasing!r}')
    copied = unchanged and spline.prefilter
    if grid_mode and mode in ("constant", "wrap") and not copied:
        warn(f"It is recommended to use mode = grid-{mode} instead of {mode} when grid_mode is True.")
    positions = magnified(on.shape, shape, grid_mode)
    sigma = widths(shape, on.shape) if chosen == "gaussian" else {}
    return on.evaluate(Grid("zoom", spline, output, shape, positions, sigma, chosen == "least-squares", copied))


def rotate(
    input: ArrayLike, angle: float, axes: Sequence[int] = (1, 0), reshape: bool = True,
    output: Any = None, order: Order = 3, mode: str = "constant", cval: complex = 0.0, prefilter: bool = True,
    *, chunks: Any = None,
    precision: Precision | None = None, device: AnyDevice = None, nan: Nan = "propagate", progress: Progress = None,
    small: str = "scipy",
) -> Array:  # fmt: skip
    """An array rotated in the plane of two of its axes: `scipy.ndimage.rotate`.

    Parameters
    ----------
    input, angle, axes, reshape, output, order, mode, cval, prefilter
        As in SciPy; the angle is in degrees.
    precision, device, nan, progress, small, chunks
        As for `affine_transform`.

    Returns
    -------
    ndarray
        Of the input's shape, or with `reshape` of one that the rotated input fits into.

    Raises
    ------
    OptionError
        `input` has fewer than two axes, or `axes` are not two different ones of them.
    NotFiniteError
        `angle` is not finite.
    RefusedError, OptionTypeError, DtypeError
        As for `map_coordinates`.

    Examples
    --------
    >>> import numpy as np
    >>> from clvol import ndimage
    >>> ndimage.rotate(np.zeros((40, 60)), 90).shape
    (60, 40)
    >>> ndimage.rotate(np.zeros((40, 60)), 30, reshape=False).shape
    (40, 60)
    """
    how = small, nan, precision, device, progress, chunks
    little = Small.of(input, output, order, mode, cval, prefilter, how)
    if little and (done := little.rotate(angle, axes, reshape)) is not None:
        return done
    on = _substrate(input, chunks)
    plane, matrix, offset, shape = turned(angle, axes, reshape, on.shape)
    spline = on.spline(order, mode, cval, prefilter, precision, device, nan, progress)
    return on.evaluate(Affine("rotate", spline, output, shape, plane, matrix, offset))


def _substrate(input: Any, chunks: Any = None, coordinates: Any = None) -> Substrate:
    """The substrate of an input. This is the only place that asks what the input is."""
    if is_lazy(input) or is_lazy(coordinates):
        from clvol.ndimage.as_graph import AsGraph

        return AsGraph(input, chunks)
    require_lazy("input", chunks=chunks)
    if is_in_parts(input):
        from clvol.ndimage.by_bricks import ByBricks

        return ByBricks(input)
    return InMemory(input)
