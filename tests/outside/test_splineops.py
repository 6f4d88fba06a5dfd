"""Least-squares reduction, compared with EPFL's `splineops`: equal to its projection of equal degree, nearer than its preset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol.device import Device

resizing: Any = pytest.importorskip("splineops.resize.resize")
Array = NDArray[np.float64]

N, M = 192, 96
STEP = (N - 1) / (M - 1)  # splineops keeps the outer samples in place
GRID = clvol.Volume(np.zeros((2, M)), (STEP, 1.0))


def reduced(wave: Array, device: Device) -> dict[str, Array]:
    def theirs(analysis: int) -> Array:
        degrees = {"interp_degree": 3, "analy_degree": analysis, "synthe_degree": 3}
        return np.asarray(resizing.resize_degrees(wave, output_size=(M,), axes=(1,), **degrees))

    ours = clvol.resample(wave, like=GRID, anti_aliasing="least-squares", precision="double", device=device).data
    return {"ours": ours, "projection": theirs(3), "preset": theirs(1), "plain": theirs(-1)}


@pytest.mark.parametrize("frequency", [0.15, 0.2, 0.24, 0.26, 0.3])
def test_waves_near_the_new_nyquist_frequency(device: Device, frequency: float) -> None:
    """The distance of functions is least for us; the distance at samples is least without any anti-aliasing."""
    if not device.has_double:
        pytest.skip("the device has no float64")
    dense = np.linspace(20, N - 20, 1501)
    squares: dict[str, list[Array]] = {}
    for phase in (0.3, 1.4, 2.9, 4.4):

        def wave(x: Array, phase: float = phase) -> Array:
            return np.cos(2 * np.pi * frequency * x + phase)

        results = reduced(np.tile(wave(np.arange(N)), (2, 1)), device)
        np.testing.assert_allclose(results["ours"][:, 12:-12], results["projection"][:, 12:-12], rtol=0, atol=2e-5)
        for name, samples in results.items():
            again = clvol.Volume(samples, (STEP, 1.0))
            values = clvol.sample(again, np.stack([dense, 0 * dense], -1), precision="double", device=device)
            at_samples = (samples[0] - wave(STEP * np.arange(M)))[8:-8]
            squares.setdefault(name, []).append(np.array([np.mean((values - wave(dense)) ** 2), np.mean(at_samples**2)]))
    between, at_samples = np.sqrt(np.stack([np.mean(s, 0) for s in squares.values()], 1))
    names = list(squares)
    assert names[int(between[:3].argmin())] in ("ours", "projection")
    assert between[0] < between[2] < between[3]
    assert at_samples[3] < at_samples[2] < at_samples[0]
