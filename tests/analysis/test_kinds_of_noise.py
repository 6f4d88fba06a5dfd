"""Predictions and advice for noise that is not white, on phantoms whose truth is a function."""

from __future__ import annotations

import numpy as np
import pytest

from bench.predictions import TRUTHS, measure

SILENT = {"blurred .1, .7", "blurred .1, 1", "impulses .02, .02"}
KINDS = {
    "poisson 30 t + 3": "signal-dependent",
    "uneven .1 × 4": "uneven",
    "rician .1": "magnitude",
    "clipped .1 at 0": "clipped",
    "blurred .1, .7": "correlated",
    "blurred .1, 1": "correlated",
    "impulses .02, .02": "",
}


@pytest.mark.parametrize("noise", KINDS)
def test_advice_is_right_or_silent(noise: str) -> None:
    case = measure("balls", noise, TRUTHS["balls"], points=8000)
    assert not KINDS[noise] or case.found.kind == KINDS[noise]
    if noise in SILENT:
        assert case.advice.filter is None
        assert case.found.doubt in case.advice.sentences[0]
    else:
        assert case.loses < 1.05
        assert 0.5 < case.factor < 1.6
        if case.found.kind in ("magnitude", "clipped"):
            assert case.found.sigma == pytest.approx(case.true, rel=0.1)
    assert not np.isnan(case.found.sigma)
