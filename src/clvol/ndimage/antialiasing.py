"""Arrays on coarser grids without aliases."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.device import as_device
from clvol.filter.make import bspline
from clvol.ndimage import engine
from clvol.ndimage.arguments import Array, Spline
from clvol.spline.reduce import Sums, gaussian, in_order, least_squares, sum_along

__all__ = ["low_passed", "nearest_along", "nearest_splines", "nearest_sums", "widths"]


def widths(shape: tuple[int, ...], finer: tuple[int, ...]) -> dict[int, float]:
    """Standard deviations of a Gaussian, by scikit-image's rule: (f - 1) / 2 samples along an axis that is reduced f times."""
    return {axis: max(0.0, (n / m - 1) / 2) for axis, (n, m) in enumerate(zip(finer, shape, strict=True)) if m}


def low_passed(data: Array, sigma: Mapping[int, float], spline: Spline) -> Array:
    """An array after a Gaussian, as `scipy.ndimage.gaussian_filter` computes it, in float32 or float64; `data` without one."""
    if data.dtype.kind == "c":
        return low_passed(data.real, sigma, spline.of_part("real", 0)) + 1j * low_passed(
            data.imag, sigma, spline.of_part("imag", 1)
        )
    boundary, device = spline.boundary, as_device(spline.device)
    sums = {axis: gaussian(float(s), data.shape[axis], boundary) for axis, s in sigma.items() if s > 0}
    if not sums or data.size == 0:
        return data
    kind = engine.kind_for(spline.precision, data, data, device)
    return sum_along(data, in_order(sums), kind, device, float(spline.cval.real), far=engine.lies_far(data))


def nearest_splines(data: Array, positions: Mapping[int, NDArray[np.float64]], output: Array, spline: Spline) -> None:
    """Write the least-squares spline on a coarser grid into `output`: see `clvol.spline.reduce.least_squares`.

    `positions` are evenly spaced along each axis, in samples; a single one stands for the whole axis.
    """
    if spline.local:
        raise OptionError('nan must be "propagate" or "error" with least squares, which spreads missing samples; got "local"')
    if data.dtype.kind == "c":
        nearest_splines(data.real, positions, output.real, spline.of_part("real", 0))
        nearest_splines(data.imag, positions, output.imag, spline.of_part("imag", 1))
        return
    device = as_device(spline.device)
    kind = engine.kind_for(spline.precision, data, output, device)
    sums, outside = in_order(nearest_sums(data.shape, positions, spline, kind)), float(spline.cval.real)
    made = sum_along(data, sums, kind, device, outside, spline.progress, far=engine.lies_far(data))
    output[...] = engine.converted(made, output.dtype)


def nearest_sums(
    shape: tuple[int, ...], positions: Mapping[int, NDArray[np.float64]], spline: Spline, kind: type[np.generic]
) -> dict[int, Sums]:
    """The sums of `nearest_splines` along each axis of an array of a shape, in float32 or float64."""
    return {axis: nearest_along(x, shape[axis], spline, kind == np.float64)() for axis, x in positions.items()}


def nearest_along(x: NDArray[np.float64], n: int, spline: Spline, double: bool) -> partial[Sums]:
    """What computes the sums of `nearest_splines` along an axis of `n` samples."""
    m = len(x)
    step = float(x[-1] - x[0]) / (m - 1) if m > 1 else float(n)
    return partial(least_squares, bspline(spline.order), float(x[0]), step, m, n, spline.boundary, double, spline.prefilter)
