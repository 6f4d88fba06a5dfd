"""Arrays with missing samples: `evaluate` where only results that touch one are missing too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.ndimage import engine
from clvol.spline.field import Precision
from clvol.volume.missing import Missing, filled_smoothly

__all__ = ["evaluate"]


def evaluate(
    data: NDArray[Any],
    axes: Sequence[int],
    target: engine.Target,
    output: NDArray[Any],
    *,
    order: int,
    mode: str,
    cval: float,
    prefilter: bool,
    precision: Precision,
    device: Device | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """`engine.evaluate` by the rule "local" of `clvol.Missing`: NaN where a sample that is not finite has weight, and nowhere else.

    Parameters are those of `engine.evaluate`. What has weight is told by the B-spline of the order, whose weights are positive,
    in float32. All other results are bit for bit those of the filled array.

    Raises
    ------
    OptionError
        `output` cannot hold NaN, and samples are missing.
    """
    rules: dict[str, Any] = {"order": order, "mode": mode, "device": device}
    where = Missing("local").of(data)
    if where is None:
        engine.evaluate(data, axes, target, output, cval=cval, prefilter=prefilter, precision=precision, progress=progress, **rules)
        return
    if output.dtype.kind != "f":
        raise OptionError(f'output must be floating where nan="local" leaves results missing; got {output.dtype}')
    kept = [axis for axis in range(data.ndim) if axis not in axes]
    filled = data.copy()
    target_of, samples, gaps = (array.transpose((*kept, *axes)) for array in (filled, data, where))
    for index in np.ndindex(target_of.shape[: len(kept)]):
        if gaps[index].any():
            target_of[index] = filled_smoothly(samples[index], gaps[index])

    def half(start: float) -> Callable[[float], None] | None:
        return None if progress is None else lambda done: progress(start + done / 2)

    engine.evaluate(filled, axes, target, output, cval=cval, prefilter=prefilter, precision=precision, progress=half(0.0), **rules)
    share = np.empty(output.shape, np.float32)
    engine.evaluate(
        where.view(np.uint8), axes, target, share, cval=0.0, prefilter=False, precision="single", progress=half(0.5), **rules
    )
    output[share != 0] = np.nan
