"""How long a filter takes for a sample, measured in rounds."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from clvol.boundary import Boundary
from clvol.device import Device
from clvol.filter import Filter
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.field import coefficients_of
from clvol.spline.points import sample_coefficients
from clvol.volume import Volume

__all__ = ["seconds_a_sample"]

_TIMED = 1 << 17  # positions
_ROUNDS = 12
_HELD = 1 << 30  # bytes of coefficients that are held at once, unless one filter needs more


def seconds_a_sample(
    volume: Volume, rows: Sequence[Filter], boundary: Boundary, device: Device, progress: Callable[[float], Any] | None = None
) -> list[float]:
    """The least time a sample of each filter at random positions of the volume, without the prefilter.

    In rounds, in which each filter takes its turn, so that what else the machine does falls on all alike.

    Parameters
    ----------
    volume : Volume
        2-D or 3-D samples.
    rows : sequence of Filter
    boundary : Boundary
    device : Device
        One that is usable.
    progress : callable, optional
        Called with the fraction done.
    """
    last = np.array(volume.size) - 1
    points = volume.index_to_world(np.random.default_rng(0).uniform(0, 1, (_TIMED, volume.ndim)) * last)
    least: list[float] = []
    for some in _together(volume, rows):
        first, least = len(least), least + [np.inf] * len(some)
        with ExitStack() as stack:
            held = [
                (stack.enter_context(coefficients_of(volume, row, boundary, device)), choose_evaluator(device, row)) for row in some
            ]
            for coefficients, path in held:
                sample_coefficients(coefficients, path, points[:64])  # builds the kernel
            for done in range(1, _ROUNDS + 1):
                for i, (coefficients, path) in enumerate(held, first):
                    started = time.perf_counter()
                    sample_coefficients(coefficients, path, points)
                    least[i] = min(least[i], (time.perf_counter() - started) / _TIMED)
                if progress is not None:
                    progress((first + len(some) * done / _ROUNDS) / len(rows))
    return least


def _together(volume: Volume, rows: Sequence[Filter]) -> Iterator[list[Filter]]:
    """Rows whose coefficients are held at once."""
    some: list[Filter] = []
    room = _HELD
    for row in rows:
        need = 4 * math.prod(row.scale * n for n in volume.shape)
        if some and need > room:
            yield some
            some, room = [], _HELD
        some.append(row)
        room -= need
    if some:
        yield some
