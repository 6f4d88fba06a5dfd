"""Overshoot of low-passes and filters at a step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol import reference
from clvol.analysis import WILBRAHAM_GIBBS, lowpass_step, step_response
from clvol.base.errors import OptionError
from clvol.filter.table import filters


def test_a_sharp_low_pass_overshoots_by_8_949_percent_whatever_its_cutoff() -> None:
    assert abs(WILBRAHAM_GIBBS - 0.08949) < 5e-6
    for cutoff in (math.pi / 32, math.pi / 64, math.pi / 128, math.pi / 256, math.pi / 512):  # all that is allowed
        got = lowpass_step("ideal", cutoff)
        assert got.overshoot == pytest.approx(WILBRAHAM_GIBBS, abs=1e-4)
        assert got.undershoot == pytest.approx(WILBRAHAM_GIBBS, abs=1e-4)
        assert got.ringing > 1


def test_a_gaussian_low_pass_does_not_ring() -> None:
    for options in ({}, {"sigma": 5.0}, {"cutoff": math.pi / 300}):
        got = lowpass_step("gaussian", **options)
        assert max(got.overshoot, got.undershoot) < 1e-12
        assert abs(got.ringing) < 1e-9
    # from 10 % to 90 % of the error function: 2 * 1.28155 standard deviations
    assert lowpass_step("gaussian", sigma=40.0).rise == pytest.approx(2 * 1.2815516 * 40, rel=1e-4)


@pytest.mark.parametrize("name", filters())
def test_the_step_response_matches_the_reference(name: str) -> None:
    got = step_response(name)
    n = 240
    samples = np.zeros((1, n))
    samples[0, n // 2 :] = 1
    x = got.x[5::97]
    drawn = reference.sample(samples, np.stack([x + n / 2 - 0.5, np.zeros_like(x)], -1), name, "mirror")
    drawn /= reference.sample([[1.0]], [[0.0, 0.0]], name)
    np.testing.assert_allclose(got.values[5::97], drawn, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "overshoot", "ringing"),
    [
        ("nearest", 0, 0),
        ("linear", 0, 0),
        ("bspline3-approx", 0, 0),
        ("catmull-rom", 2 / 27, 8 / 27),  # next to the step 1 + t (1 - t)² / 2, greatest at 1/3; up and down on both sides
    ],
)
def test_overshoot_and_ringing_by_hand(name: str, overshoot: float, ringing: float) -> None:
    got = step_response(name)
    assert got.overshoot == pytest.approx(overshoot, abs=1e-4)
    assert got.undershoot == pytest.approx(overshoot, abs=1e-4)
    assert got.ringing == pytest.approx(ringing, abs=3e-4)


def test_rise_of_linear_is_eight_tenths() -> None:
    assert step_response("linear").rise == pytest.approx(0.8, abs=1e-9)
    assert step_response("bspline3-approx").rise > step_response("mitchell").rise > step_response("bspline3").rise


@pytest.mark.parametrize(
    "call",
    [
        lambda: step_response("none"),
        lambda: lowpass_step("box"),
        lambda: lowpass_step(None),
        lambda: lowpass_step("ideal", 1.0),
        lambda: lowpass_step("ideal", 0.0),
        lambda: lowpass_step("gaussian", sigma=0),
        lambda: lowpass_step("gaussian", sigma="a"),
    ],
)
def test_bad_input_is_rejected(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(OptionError):
        call()
