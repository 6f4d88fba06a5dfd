"""Times per sample: filters take turns in every round, and coefficients stay resident only while they fit."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import pytest

from clvol import phantoms
from clvol.analysis import timing
from clvol.analysis.timing import Effort, seconds_per_sample
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters

FILTERS = as_filters(["linear", "bspline3", "hybrid"])


def test_every_filter_takes_its_turn_and_the_shortest_time_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[tuple[str, int]] = []
    now = 0.0

    def holds(_volume: object, filter: Filter, *_: object) -> AbstractContextManager[Filter]:
        return nullcontext(filter)

    def takes(filter: Filter, _evaluator: object, points: Any) -> None:
        nonlocal now
        taken.append((filter.name, len(points)))
        now += 1000 * filter.support + (50 if len(taken) < 8 else 0)  # at first the machine is busy

    monkeypatch.setattr(timing, "coefficients_of", holds)
    monkeypatch.setattr(timing, "choose_evaluator", lambda *_: None)
    monkeypatch.setattr(timing, "sample_coefficients", takes)
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now)
    reported: list[float] = []
    shortest = seconds_per_sample(phantoms.sphere(8), FILTERS, as_boundary("mirror"), None, reported.append)  # type: ignore[arg-type]
    usual = Effort()
    assert taken == [(f.name, n) for n in (64, *[usual.positions] * usual.rounds) for f in FILTERS]
    assert shortest == [1000 * f.support / usual.positions for f in FILTERS]
    assert reported == pytest.approx([(i + 1) / usual.rounds for i in range(usual.rounds)])


@pytest.mark.parametrize(("room", "groups"), [(10, [[0], [1], [2]]), (4096, [[0, 1], [2]]), (5 * 4096, [[0, 1, 2]])])
def test_coefficients_are_resident_while_they_fit(room: int, groups: list[list[int]]) -> None:
    assert list(timing._groups(phantoms.sphere(8), FILTERS, room)) == [[FILTERS[i] for i in group] for group in groups]


def test_times_on_a_device(device: Device) -> None:
    reported: list[float] = []
    little = Effort(positions=500, resident_bytes=10)
    shortest = seconds_per_sample(phantoms.sphere(8), FILTERS, as_boundary("wrap"), device, reported.append, effort=little)
    assert len(shortest) == 3
    assert all(0 < seconds < 1 for seconds in shortest)
    assert reported == sorted(reported)
    assert reported[-1] == 1
