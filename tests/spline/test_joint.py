"""Joint histograms of functions whose gradient is known."""

from __future__ import annotations

import numpy as np
import pytest

import clvol
from clvol.base.errors import DataError, OptionError
from clvol.device import Device


def test_a_ramp_is_one_row_over_all_its_values(device: Device) -> None:
    ramp = np.broadcast_to(np.arange(12.0) * 3, (5, 6, 12))
    volume = clvol.Volume(ramp, (0.5, 1, 2), direction=[[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    counts, values, gradients = clvol.joint_histogram(volume, (4, 11), filter="linear", device=device)
    assert counts.shape == (4, 11)
    np.testing.assert_allclose(values, np.arange(12) * 3, atol=2e-3)
    np.testing.assert_allclose(gradients, [0, 1.5, 3, 4.5, 6], rtol=1e-5)  # 3 per 0.5 of the world
    assert not counts[:3].any()
    np.testing.assert_allclose(counts[3], (1 << 17) / 11, rtol=1e-3)  # points are spread evenly


def test_what_has_no_slopes_is_refused(device: Device) -> None:
    with pytest.raises(OptionError, match="a filter with slopes, such as bspline3; got nearest"):
        clvol.joint_histogram(np.zeros((4, 4, 4)), filter="nearest", device=device)
    with pytest.raises(DataError, match="3 axes; got shape"):
        clvol.joint_histogram(np.zeros((4, 4)), device=device)
    with pytest.raises(OptionError, match="bins must be"):
        clvol.joint_histogram(np.zeros((4, 4, 4)), 7, device=device)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="range and gradients are within that of float64; got values from"):
        clvol.joint_histogram(1.7e308 * np.random.default_rng(0).uniform(-1, 1, (6, 6, 6)), device=device)
