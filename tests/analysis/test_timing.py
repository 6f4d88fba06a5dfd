"""Times a sample: each filter takes its turn in every round, and holds its coefficients only as long as there is room."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import pytest

from clvol import phantoms
from clvol.analysis import timing
from clvol.boundary import as_boundary
from clvol.device import Device
from clvol.filter import Filter, as_filters

ROWS = as_filters(["linear", "bspline3", "hybrid"])


def test_every_filter_takes_its_turn_and_the_least_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []
    now = 0.0

    def holds(_volume: object, row: Filter, *_: object) -> AbstractContextManager[Filter]:
        return nullcontext(row)

    def takes(row: Filter, _path: object, points: Any) -> None:
        nonlocal now
        asked.append((row.name, len(points)))
        now += 1000 * row.support + (50 if len(asked) < 8 else 0)  # the machine is busy with something else at first

    monkeypatch.setattr(timing, "Coefficients", holds)
    monkeypatch.setattr(timing, "choose_evaluator", lambda *_: None)
    monkeypatch.setattr(timing, "sample_coefficients", takes)
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now)
    told: list[float] = []
    least = timing.seconds_a_sample(phantoms.sphere(8), ROWS, as_boundary("mirror"), None, told.append)  # type: ignore[arg-type]
    names = [row.name for row in ROWS]
    assert asked == [(name, n) for n in (64, *[timing._TIMED] * timing._ROUNDS) for name in names]
    assert least == [1000 * row.support / timing._TIMED for row in ROWS]
    assert told == pytest.approx([(i + 1) / timing._ROUNDS for i in range(timing._ROUNDS)])


@pytest.mark.parametrize(("room", "wanted"), [(10, [[0], [1], [2]]), (4096, [[0, 1], [2]]), (5 * 4096, [[0, 1, 2]])])
def test_coefficients_are_held_while_there_is_room(monkeypatch: pytest.MonkeyPatch, room: int, wanted: list[list[int]]) -> None:
    monkeypatch.setattr(timing, "_HELD", room)
    assert list(timing._together(phantoms.sphere(8), ROWS)) == [[ROWS[i] for i in some] for some in wanted]


def test_times_on_a_device(monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    monkeypatch.setattr(timing, "_TIMED", 500)
    monkeypatch.setattr(timing, "_HELD", 10)
    told: list[float] = []
    least = timing.seconds_a_sample(phantoms.sphere(8), ROWS, as_boundary("wrap"), device, told.append)
    assert len(least) == 3
    assert all(0 < seconds < 1 for seconds in least)
    assert told == sorted(told)
    assert told[-1] == 1
