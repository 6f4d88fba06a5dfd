"""A/B: two filters side by side along a line, and the error of each at samples that it was not given."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolError
from clvol.filter.filter import Filter
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume

__all__ = ["MEANING", "joined", "measured"]

MEANING = (
    "Left out: RMS error of predicting every second sample along each axis from the others, less the samples' noise; measured, at "
    "twice the spacing. Expected: RMS error at the samples' own spacing, from their spectrum and noise"
)
"""An explanation of the errors."""

_BLOCK = 32  # samples along each edge of a block
_BLOCKS = 3
_PREDICTED = 24  # blocks of `predict`


def joined(left: NDArray[np.uint8] | None, right: NDArray[np.uint8] | None, at: float) -> NDArray[np.uint8]:
    """The left picture up to a fraction of the width, and the right one beyond."""
    if left is None or right is None:
        found = right if left is None else left
        assert found is not None  # one of them is there
        return found
    height, width = max(left.shape[:2], right.shape[:2])
    left, right = _grown(left, (height, width)), _grown(right, (height, width))
    edge = round(at * width)
    return np.concatenate([left[:, :edge], right[:, edge:]], axis=1)


def _grown(pixels: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Scaled up: previews of two filters may differ in size."""
    if pixels.shape[:2] == shape:
        return pixels
    from PIL import Image

    return np.asarray(Image.fromarray(pixels).resize((shape[1], shape[0]), Image.Resampling.BILINEAR))


def measured(
    volume: Volume, filters: Sequence[str], boundary: str = "mirror", stop: Callable[[], bool] = lambda: False
) -> dict[str, Any]:
    """The error of each filter on the volume, as `clvol.analysis.leave_out` measures it, on blocks with the most variation.

    `stop` is asked between blocks; once it says so, the result is empty. Else it has "meaning" (text), "span" of the values,
    "blocks" (their number), and "filters": for each its "filter", its "rms" over all blocks and axes, in units of the data, its
    "share" of the span, and "x", "y", "z" by axis; and the "expected" error at the samples' own spacing (`clvol.analysis.predict`).
    """
    from clvol.analysis.left_out import leave_out  # they import SciPy, which takes as long as all the rest
    from clvol.analysis.predicted import predict

    rows: list[Filter] = [settled(name, volume) for name in filters]
    noise = volume.noise
    sigma = 0.0 if max(noise.colour, default=1.0) > 1 else noise.rms
    squares: list[dict[str, list[float]]] = [{axis: [] for axis in "xyz"} for _ in rows]
    used = 0
    for part in _blocks(volume):
        if stop():
            return {}
        try:
            table = leave_out(Volume(part, volume.spacing), rows, boundary, sigma=sigma)
        except ClvolError as error:
            return {"meaning": MEANING, "problem": str(error), "filters": []}
        used += 1
        for square, row in zip(squares, table, strict=True):
            for axis in "xyz":
                if (error_along := getattr(row, axis)) is not None:
                    square[axis].append(error_along**2)
    if stop():
        return {}
    expected: list[float | None] = [None] * len(rows)
    if not noise.doubt:
        with suppress(ClvolError):  # of volumes that are too small
            expected = [row.rms for row in predict(volume, rows, blocks=_PREDICTED)]
    low, high = volume.value_range
    span = (high - low) or 1.0
    measures = []
    for name, square, least in zip(filters, squares, expected, strict=True):
        along = {axis: math.sqrt(float(np.mean(values))) if values else None for axis, values in square.items()}
        known = [value**2 for value in along.values() if value is not None]
        rms = math.sqrt(float(np.mean(known))) if known else None
        measures.append({"filter": name, "rms": rms, "share": None if rms is None else rms / span, **along, "expected": least})
    return {"meaning": MEANING, "span": span, "blocks": used, "filters": measures}


def _blocks(volume: Volume) -> list[NDArray[Any]]:
    """The blocks with the largest standard deviation: uniform background does not tell filters apart."""
    sizes = [min(n, _BLOCK) for n in volume.shape]
    starts = [range(0, n - m + 1, m) for n, m in zip(volume.shape, sizes, strict=True)]
    parts = [volume.data[tuple(slice(a, a + m) for a, m in zip(at, sizes, strict=True))] for at in itertools.product(*starts)]
    spread = [float(part[::3, ::3, ::3].astype(np.float64).std()) for part in parts]
    chosen = sorted(range(len(parts)), key=lambda i: -spread[i])[:_BLOCKS]
    return [parts[i] for i in chosen]
