"""Missing samples in `clvol.ndimage`: results with a weight on them are missing, all others unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.ndimage import engine
from clvol.ndimage.arguments import Spline
from clvol.ndimage.in_memory import evaluate_locally
from clvol.volume.missing import filled_smoothly


@pytest.mark.one_in(18)
@pytest.mark.parametrize("mode", ["mirror", "constant", "nearest"])
@pytest.mark.parametrize("order", [0, 1, 3])
def test_local_omits_results_with_weight_on_missing_samples(device: Device, order: int, mode: str) -> None:
    """One of three images has a hole; the others are unchanged."""
    rng = np.random.default_rng(0)
    data = rng.normal(size=(3, 15, 16))
    data[1, 7, 8] = np.nan
    points = np.concatenate(
        [rng.uniform(0, 14, (2, 400)), np.stack(np.meshgrid(np.arange(15.0), np.arange(16.0))).reshape(2, -1)], 1
    )
    got, whole = np.empty((2, 3, points.shape[1]))
    seen: list[float] = []
    spline = Spline(order, mode, 2.0, order > 1, "double", device, seen.append, "local")
    evaluate_locally(data, (1, 2), engine.Points(points), got, spline)
    filled = data.copy()
    filled[1] = filled_smoothly(data[1], np.isnan(data[1]))
    engine.evaluate(filled, (1, 2), engine.Points(points), whole, replace(spline, progress=None))
    far = np.abs(points - np.array([[7.0], [8.0]])).max(0)
    missing = np.zeros(got.shape, bool)
    missing[1] = far < (order + 1) / 2
    np.testing.assert_array_equal(np.isnan(got), missing)
    np.testing.assert_array_equal(got[~missing], whole[~missing])
    assert 0 < missing.sum() < missing[1].size
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_integers_cannot_store_nan(device: Device) -> None:
    data, points = np.ones((5, 5)), engine.Points(np.zeros((2, 1)))
    spline = Spline(1, "mirror", 0.0, True, "double", device, nan="local")
    output = np.empty(1, np.int16)
    evaluate_locally(data, (0, 1), points, output, spline)
    assert output[0] == 1
    data[0, 0] = np.nan
    with pytest.raises(OptionError, match="output must be floating"):
        evaluate_locally(data, (0, 1), points, output, spline)
