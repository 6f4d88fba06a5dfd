"""Work that takes long says so."""

from __future__ import annotations

import time

import numpy as np
import pytest

import clvol
from clvol.base import progress
from clvol.base.errors import ClvolWarning
from clvol.device import Device


def test_long_work_is_announced_once(monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder) -> None:
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    passed: list[float] = []
    report = progress.watched("the picture", passed.append)
    for now, done in ((5.0, 0.001), (20.0, 0.0), (30.0, 0.1), (40.0, 0.12)):
        clock[0] = now
        report(done)
    assert [str(one.message) for one in recwarn] == [
        "the picture will take about 4 minutes more, at this rate: 10 % is done after 30 s"  # 25 s · 0.9 / 0.099 = 227 s
    ]
    assert passed == [0.001, 0.0, 0.1, 0.12]
    quick = progress.watched("the picture")
    for now, done in ((70.0, 0.04), (71.0, 0.5)):  # kernels were compiled
        clock[0] = now
        quick(done)
    assert len(recwarn) == 1


def test_pictures_and_ranges_are_watched(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE", -1.0)
    monkeypatch.setattr(progress, "_LONG", -1.0)
    with pytest.warns(ClvolWarning, match="the picture will take about"):
        clvol.render(clvol.phantoms.sphere(8), size=(16, 12), device=device)
    with pytest.warns(ClvolWarning, match="finding the range of the samples will take about"):
        assert clvol.Volume(np.arange(1 << 21).reshape(2, 1024, 1024)).value_range == (0, (1 << 21) - 1)


def test_repeated_samples_are_read_once() -> None:
    began = time.perf_counter()
    assert clvol.Volume(np.broadcast_to(np.uint8([5, 3, 9]), (400_000, 400_000, 3))).value_range == (3, 9)
    assert time.perf_counter() - began < 5  # 4.8 · 10¹¹ samples take minutes
