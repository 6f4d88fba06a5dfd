"""Down, not only up: arrays on coarser grids without the aliases of what these cannot hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.device import as_device
from clvol.filter.boundary import as_boundary
from clvol.filter.make import bspline
from clvol.ndimage import engine
from clvol.ndimage.arguments import Array, Spline
from clvol.spline.reduce import Sums, gaussian, least_squares, sum_along

__all__ = ["low_passed", "nearest_splines", "nearest_sums", "widths"]


def widths(shape: tuple[int, ...], finer: tuple[int, ...]) -> dict[int, float]:
    """Standard deviations of the Gaussian that goes before a grid of another shape.

    By scikit-image's rule they are (f - 1) / 2 samples along an axis that gets f times fewer.
    """
    return {axis: max(0.0, (n / m - 1) / 2) for axis, (n, m) in enumerate(zip(finer, shape, strict=True)) if m}


def low_passed(data: Array, sigma: Mapping[int, float], spline: Spline) -> Array:
    """An array after a Gaussian, as `scipy.ndimage.gaussian_filter` makes it, in float32 or float64; itself if there is none.

    Parameters
    ----------
    data : ndarray
        Real or complex.
    sigma : mapping from axes to float
        Standard deviations in samples; 0 leaves an axis alone.
    spline : Spline
        Its mode, `cval`, precision and device.
    """
    if data.dtype.kind == "c":
        return low_passed(data.real, sigma, spline.of_part("real", 0)) + 1j * low_passed(
            data.imag, sigma, spline.of_part("imag", 1)
        )
    boundary, device = as_boundary(engine.BOUNDARIES[spline.mode]), as_device(spline.device)
    sums = {axis: gaussian(float(s), data.shape[axis], boundary) for axis, s in sigma.items() if s > 0}
    if not sums or data.size == 0:
        return data
    return sum_along(data, sums, engine.kind_for(spline.precision, data, data, device), device, float(spline.cval.real))


def nearest_splines(data: Array, positions: Mapping[int, NDArray[np.float64]], output: Array, spline: Spline) -> None:
    """The spline of a coarser grid that is nearest to the array's, into `output`: see `clvol.spline.reduce.least_squares`.

    Parameters
    ----------
    data : ndarray
        Real or complex, not empty.
    positions : mapping from axes to ndarray
        Where the new samples lie along each of the axes, in samples, at even distances. A single one stands for all of the axis.
    output : ndarray
    spline : Spline

    Raises
    ------
    OptionError
        Missing samples were to be local; here they reach as far as the prefilter does.
    """
    if spline.local:
        raise OptionError('nan must be "propagate" or "error" with least squares, which spreads missing samples; got "local"')
    if data.dtype.kind == "c":
        nearest_splines(data.real, positions, output.real, spline.of_part("real", 0))
        nearest_splines(data.imag, positions, output.imag, spline.of_part("imag", 1))
        return
    device = as_device(spline.device)
    kind = engine.kind_for(spline.precision, data, output, device)
    made = sum_along(
        data, nearest_sums(data.shape, positions, spline, kind), kind, device, float(spline.cval.real), spline.progress
    )
    output[...] = engine.converted(made, output.dtype)


def nearest_sums(
    shape: tuple[int, ...], positions: Mapping[int, NDArray[np.float64]], spline: Spline, kind: type[np.generic]
) -> dict[int, Sums]:
    """Those of `nearest_splines` for an array of such a shape, by axes, to be made in float32 or float64."""
    boundary, sums = as_boundary(engine.BOUNDARIES[spline.mode]), {}
    for axis, x in positions.items():
        n, m = shape[axis], len(x)
        step = float(x[-1] - x[0]) / (m - 1) if m > 1 else float(n)
        sums[axis] = least_squares(bspline(spline.order), float(x[0]), step, m, n, boundary, kind == np.float64, spline.prefilter)
    return sums
