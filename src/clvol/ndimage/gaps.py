"""Arrays with missing samples: `evaluate` where only results that touch one are missing too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clvol.base.errors import OptionError
from clvol.ndimage import engine
from clvol.ndimage.arguments import Array, Spline
from clvol.volume.missing import Missing, filled_smoothly

__all__ = ["evaluate"]


def evaluate(data: Array, axes: Sequence[int], target: engine.Target, output: Array, spline: Spline) -> None:
    """`engine.evaluate` by the rule "local" of `clvol.Missing`: NaN where a sample that is not finite has weight, and nowhere else.

    A sample has weight where the B-spline of the order, whose weights are positive, is not 0 in float32. All other results are bit
    for bit those of the filled array.
    """
    where = Missing("local").of(data)
    if where is None:
        engine.evaluate(data, axes, target, output, spline)
        return
    if output.dtype.kind != "f":
        raise OptionError(f'output must be floating where nan="local" leaves results missing; got {output.dtype}')
    kept = [axis for axis in range(data.ndim) if axis not in axes]
    filled = data.copy()
    target_of, samples, gaps = (array.transpose((*kept, *axes)) for array in (filled, data, where))
    for index in np.ndindex(target_of.shape[: len(kept)]):
        if gaps[index].any():
            target_of[index] = filled_smoothly(samples[index], gaps[index])

    engine.evaluate(filled, axes, target, output, spline.stage(0, 2))
    share = np.empty(output.shape, np.float32)
    weights = replace(spline.stage(1, 2), cval=0.0, prefilter=False, precision="single")
    engine.evaluate(where.view(np.uint8), axes, target, share, weights)
    output[share != 0] = np.nan
