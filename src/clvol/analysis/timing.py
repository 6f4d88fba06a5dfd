"""How long a filter takes per sample, measured in rounds."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from clvol.base.arrays import Array
from clvol.base.progress import Progress
from clvol.device import Device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.field import coefficients_of
from clvol.spline.points import sample_coefficients
from clvol.volume.volume import Volume

__all__ = ["FULL", "Effort", "seconds_per_sample", "times_per_sample"]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    positions: int = 1 << 17  # sampled at a time
    rounds: int = 12  # in each of which every filter takes its turn
    resident_bytes: int = 1 << 30  # of coefficients that are resident together; one filter may need more


FULL = Effort()


def seconds_per_sample(
    volume: Volume,
    filters: Sequence[Filter],
    boundary: Boundary,
    device: Device,
    progress: Progress | None = None,
    *,
    effort: Effort = FULL,
) -> list[float]:
    """The shortest of `times_per_sample` of each filter."""
    return [float(times.min()) for times in times_per_sample(volume, filters, boundary, device, progress, effort=effort)]


def times_per_sample(
    volume: Volume,
    filters: Sequence[Filter],
    boundary: Boundary,
    device: Device,
    progress: Progress | None = None,
    *,
    effort: Effort = FULL,
) -> list[Array]:
    """Seconds per sample of each filter at random positions of the volume, without the prefilter, in each round.

    The filters take turns, round by round, so that other load on the machine hits all of them alike.
    """
    last, n = np.array(volume.size) - 1, effort.positions
    points = volume.index_to_world(np.random.default_rng(0).uniform(0, 1, (n, volume.ndim)) * last)
    times: list[Array] = []
    for group in _groups(volume, filters, effort.resident_bytes):
        first, times = len(times), times + [np.empty(effort.rounds) for _ in group]
        with ExitStack() as stack:
            resident = [
                (stack.enter_context(coefficients_of(volume, f, boundary, device)), choose_evaluator(device, f)) for f in group
            ]
            for coefficients, evaluator in resident:
                sample_coefficients(coefficients, evaluator, points[:64])  # builds the kernel
            for turn in range(effort.rounds):
                for i, (coefficients, evaluator) in enumerate(resident, first):
                    started = time.perf_counter()
                    sample_coefficients(coefficients, evaluator, points)
                    times[i][turn] = (time.perf_counter() - started) / n
                if progress is not None:
                    progress((first + len(group) * (turn + 1) / effort.rounds) / len(filters))
    return times


def _groups(volume: Volume, filters: Sequence[Filter], room: int) -> Iterator[list[Filter]]:
    """Filters whose coefficients fit into `room` bytes together."""
    group: list[Filter] = []
    left = room
    for one in filters:
        need = 4 * math.prod(one.scale * n for n in volume.shape)
        if group and need > left:
            yield group
            group, left = [], room
        group.append(one)
        left -= need
    if group:
        yield group
