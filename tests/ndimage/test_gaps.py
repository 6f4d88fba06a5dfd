"""Missing samples in `clvol.ndimage`: what has weight is missing, everything else as if all were there."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.ndimage import engine, gaps
from clvol.volume.missing import filled_smoothly


@pytest.mark.one_in(18)
@pytest.mark.parametrize("mode", ["mirror", "constant", "nearest"])
@pytest.mark.parametrize("order", [0, 1, 3])
def test_local_leaves_out_what_has_weight(device: Device, order: int, mode: str) -> None:
    """One image of three has a hole; the others are what they are without."""
    rng = np.random.default_rng(0)
    data = rng.normal(size=(3, 15, 16))
    data[1, 7, 8] = np.nan
    points = np.concatenate(
        [rng.uniform(0, 14, (2, 400)), np.stack(np.meshgrid(np.arange(15.0), np.arange(16.0))).reshape(2, -1)], 1
    )
    got, whole = np.empty((2, 3, points.shape[1]))
    rules = {"order": order, "mode": mode, "cval": 2.0, "prefilter": order > 1, "precision": "double", "device": device}
    seen: list[float] = []
    gaps.evaluate(data, (1, 2), engine.Points(points), got, progress=seen.append, **rules)  # type: ignore[arg-type]
    filled = data.copy()
    filled[1] = filled_smoothly(data[1], np.isnan(data[1]))
    engine.evaluate(filled, (1, 2), engine.Points(points), whole, **rules)  # type: ignore[arg-type]
    far = np.abs(points - np.array([[7.0], [8.0]])).max(0)
    missing = np.zeros(got.shape, bool)
    missing[1] = far < (order + 1) / 2
    np.testing.assert_array_equal(np.isnan(got), missing)
    np.testing.assert_array_equal(got[~missing], whole[~missing])
    assert 0 < missing.sum() < missing[1].size
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_whole_numbers_hold_no_nan(device: Device) -> None:
    data, points = np.ones((5, 5)), engine.Points(np.zeros((2, 1)))
    rules = {"order": 1, "mode": "mirror", "cval": 0.0, "prefilter": True, "precision": "double", "device": device}
    output = np.empty(1, np.int16)
    gaps.evaluate(data, (0, 1), points, output, **rules)  # type: ignore[arg-type]
    assert output[0] == 1
    data[0, 0] = np.nan
    with pytest.raises(OptionError, match="output must be floating"):
        gaps.evaluate(data, (0, 1), points, output, **rules)  # type: ignore[arg-type]
