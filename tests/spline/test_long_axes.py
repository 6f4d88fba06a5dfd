"""Grids with long axes are computed in parts: the same bits, and no tables larger than the result."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.spline import resample as parts

pytestmark = pytest.mark.usefixtures("device")
VOLUME = clvol.Volume(np.random.default_rng(0).random((6, 7, 8), dtype=np.float32))


@pytest.mark.parametrize("shape", [(1, 1, 300), (1, 300, 1), (300, 1, 1), (5, 70, 90), (40, 3, 200), (3, 200)])
@pytest.mark.parametrize("options", [{}, {"boundary": "constant(3)"}, {"fill": -5.0}])
def test_parts_change_no_bit(shape: tuple[int, ...], options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    volume = VOLUME if len(shape) == 3 else clvol.Volume(VOLUME.data[0])
    d = volume.ndim
    spacing = tuple(1.2 * n / m for n, m in zip(volume.size, shape[::-1], strict=True))  # and past both ends
    grid = clvol.Volume(np.broadcast_to(np.float32(0), shape), spacing, (-1.0,) * d)
    whole = clvol.resample(volume, like=grid, **options)
    monkeypatch.setattr(parts, "_LONG", 24)
    monkeypatch.setattr(parts, "_PART", 1 << 10)
    told: list[float] = []
    made = clvol.resample(volume, like=grid, progress=told.append, **options)
    np.testing.assert_array_equal(made.data, whole.data)
    assert len(told) > 2
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)


def test_parts_of_mostly_skipped_long_rows_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.random.default_rng(1).random((3, 5000), dtype=np.float32)
    whole = clvol.resample(image, (4, 37))
    monkeypatch.setattr(parts, "_LONG", 256)
    np.testing.assert_array_equal(clvol.resample(image, (4, 37)).data, whole.data)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("shape", [(1, 1, 2_000_000), (2_000_000, 1, 1), (2, 1, 1_000_000)])
def test_no_table_is_larger_than_the_result(shape: tuple[int, ...]) -> None:
    clvol.resample(VOLUME, (1, 1, 70_000))  # kernels are built, tables of filters made
    tracemalloc.start()
    try:
        made = clvol.resample(VOLUME, shape)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2 * made.data.nbytes + (16 << 20)
    ends = clvol.resample(VOLUME, shape).data.ravel()[[0, -1]]
    np.testing.assert_array_equal(made.data.ravel()[[0, -1]], ends)


def test_points_on_a_long_axis_match_those_on_a_short_one() -> None:
    n = 1_000_003
    long = clvol.resample(VOLUME, (1, 1, n)).data.ravel()
    at = np.r_[0:5, 65_530:65_540, n - 5 : n]
    x = (at + 0.5) * (8 / n) - 0.5
    points = np.stack([x, np.full(x.size, 3.0), np.full(x.size, 2.5)], -1)
    np.testing.assert_allclose(long[at], clvol.sample(VOLUME, points), atol=1e-6)
