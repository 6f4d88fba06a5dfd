"""Down, not only up: arrays on coarser grids without the aliases of what these cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import as_boundary
from clvol.device import Device, as_device
from clvol.errors import OptionError
from clvol.filter import bspline
from clvol.ndimage import engine
from clvol.ndimage.engine import Affine, Axes, Target
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing, gaussian, least_squares, sum_along

__all__ = ["evaluate", "low_passed", "steps_of"]

_UNEVEN = 1e-6  # of a step


def evaluate(
    data: NDArray[Any],
    axes: Sequence[int],
    target: Target,
    output: NDArray[Any],
    *,
    order: int,
    mode: str,
    cval: float,
    prefilter: bool,
    precision: Precision,
    device: Device | str | int | None = None,
    progress: Callable[[float], None] | None = None,
    anti_aliasing: AntiAliasing | bool = False,
    sigma: Sequence[float] | None = None,
) -> None:
    """`engine.evaluate`, after a low-pass or by least squares where the target is coarser than the array.

    Parameters
    ----------
    data, axes, target, output, order, mode, cval, prefilter, precision, device, progress
        As of `engine.evaluate`.
    anti_aliasing : {False, True, "gaussian", "least-squares"}
        "gaussian" (and True): a Gaussian first, of standard deviation (f - 1) / 2 along an axis whose samples come to lie f of the
        array's apart, cut off at four of them; scikit-image's rule. "least-squares": the spline of the target's grid that is
        nearest to that of the array in the mean square (`clvol.spline.reduce.least_squares`), for grids along the axes.
    sigma : sequence of float, optional
        Standard deviations of the Gaussian in samples, one for each of `axes`.

    Raises
    ------
    OptionError
        Least squares for a grid that does not lie along the axes at even distances, or with a `sigma`; points.
    """
    chosen = as_anti_aliasing(anti_aliasing)
    if chosen is None:
        return engine.evaluate(
            data,
            axes,
            target,
            output,
            order=order,
            mode=mode,
            cval=cval,
            prefilter=prefilter,
            precision=precision,
            device=None if device is None else as_device(device),
            progress=progress,
        )
    if chosen == "least-squares":
        if sigma is not None:
            raise OptionError(f"sigma is for the Gaussian, least squares has none; got {sigma!r}")
        if not isinstance(target, Axes):
            raise OptionError("least-squares reduction takes a grid along the array's axes: turn afterwards, or take 'gaussian'")
        boundary, own, sums = as_boundary(engine._BOUNDARIES[mode]), as_device(device), {}
        kind = engine._kind(precision, data, output, own)
        for axis, x in zip(axes, target.positions, strict=True):
            n = data.shape[axis]
            step = _even_step(x, n)
            sums[axis] = least_squares(bspline(order), float(x[0]), step, x.size, n, boundary, kind, prefilter=bool(prefilter))
        output[...] = engine._converted(sum_along(data, sums, kind, own, cval, progress), output.dtype)
        return None
    if sigma is None:
        sigma = [max(0.0, (step - 1) / 2) for step in steps_of(data.shape, axes, target)]
    smooth = low_passed(data, dict(zip(axes, sigma, strict=True)), mode=mode, cval=cval, precision=precision, device=device)
    return evaluate(
        smooth,
        axes,
        target,
        output,
        order=order,
        mode=mode,
        cval=cval,
        prefilter=prefilter,
        precision=precision,
        device=device,
        progress=progress,
    )


def low_passed(
    data: NDArray[Any],
    sigma: Mapping[int, float],
    *,
    mode: str,
    cval: float,
    precision: Precision,
    device: Device | str | int | None = None,
) -> NDArray[Any]:
    """An array after a Gaussian, as `scipy.ndimage.gaussian_filter` makes it, in float32 or float64; itself if there is none.

    Parameters
    ----------
    data : ndarray
    sigma : mapping from axes to float
        Standard deviations in samples; 0 leaves an axis alone.
    mode, cval, precision, device
        As of `engine.evaluate`.
    """
    boundary, own = as_boundary(engine._BOUNDARIES[mode]), as_device(device)
    sums = {axis: gaussian(float(s), data.shape[axis], boundary) for axis, s in sigma.items() if s > 0}
    return sum_along(data, sums, engine._kind(precision, data, data, own), own, cval) if sums else data


def steps_of(shape: Sequence[int], axes: Sequence[int], target: Target) -> list[float]:
    """How many samples of the array the target's samples lie apart along each axis; of a turned grid the root sum of squares.

    A single sample stands for all of its axis.
    """
    if isinstance(target, Axes):
        return [abs(_even_step(x, shape[axis])) for axis, x in zip(axes, target.positions, strict=True)]
    if isinstance(target, Affine):
        return [float(step) for step in np.linalg.norm(target.matrix, axis=1)]
    raise OptionError("anti_aliasing takes a grid, whose samples lie at even distances; got points")


def _even_step(x: NDArray[np.float64], n: int) -> float:
    if x.size < 2:
        return float(n)
    step = float(x[-1] - x[0]) / (x.size - 1)
    if not np.abs(np.diff(x) - step).max() <= _UNEVEN * max(1.0, abs(step)):
        raise OptionError("anti_aliasing takes a grid whose samples lie at even distances")
    return step
