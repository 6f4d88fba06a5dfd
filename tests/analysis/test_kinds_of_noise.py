"""Predictions and advice for noise that is not white, on phantoms whose truth is a function."""

from __future__ import annotations

import numpy as np
import pytest

from bench.predictions import TRUTHS, Case, measure
from clvol.analysis import predict

SILENT = {"blurred .1, .7", "blurred .1, 1", "impulses .02, .02", "lines .1", "planes .02", "poisson 2 t + .1"}
KINDS = {
    "white .1": "white",
    "poisson 30 t + 3": "signal-dependent",
    "uneven .1 × 4": "uneven",
    "uneven .05 × 16": "uneven",
    "rician .1": "magnitude",
    "clipped .1 at 0": "clipped",
    "blurred .1, .7": "correlated",
    "blurred .1, 1": "correlated",
    "lines .1": "correlated",
    "planes .02": "",
    "poisson 2 t + .1": "",
    "impulses .02, .02": "",
}


@pytest.mark.one_in(12)
@pytest.mark.parametrize("noise", KINDS)
def test_advice_is_right_or_silent(noise: str) -> None:
    case = measure("balls", noise, TRUTHS["balls"], points=8000)
    assert not KINDS[noise] or case.found.kind == KINDS[noise]
    if noise in SILENT:
        assert case.advice.filter is None
        assert case.found.doubt in case.advice.sentences[0]
    else:
        name = case.advice.filter
        assert name is not None
        assert case.loses < 1.05
        assert 0.85 < case.predicted[name] / case.measured[name] < 1.15
        if case.found.kind in ("magnitude", "clipped"):
            assert case.found.sigma == pytest.approx(case.true, rel=0.1)
    assert not np.isnan(case.found.sigma)


SMALL = ["white .1", "poisson 30 t + 3", "poisson 2 t + .1", "rician .1", "clipped .1 at 0", "uneven .1 × 4", "blurred .1, .5"]
SMALL += ["blurred .1, .7", "planes .05", "lines .1"]
DOUBTED = {"uneven .1 × 4", "blurred .1, .5", "blurred .1, .7", "planes .05", "lines .1"}


def of_size(noise: str, structure: str, size: int, axes: int, seed: int = 0) -> Case:
    return measure(structure, noise, TRUTHS[structure], size, seed, points=3000, axes=axes)


@pytest.mark.one_in(17)
@pytest.mark.parametrize("noise", SMALL)
@pytest.mark.parametrize(("size", "axes", "seed"), [(24, 3, 0), (24, 3, 1), (32, 3, 0), (64, 2, 0), (64, 2, 1)])
def test_advice_for_few_samples_is_right_or_silent(noise: str, size: int, axes: int, seed: int) -> None:
    for structure in ("balls", "slopes"):
        case = of_size(noise, structure, size, axes, seed)
        assert case.advice.filter is None or case.loses <= 1.1, structure
        assert case.advice.filter is None or noise not in DOUBTED, structure


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("size", "axes"), [(32, 3), (48, 3), (64, 2)])
def test_white_noise_is_found_and_advised_on(size: int, axes: int) -> None:
    for noise in ("white .1", "white .3"):
        for structure in ("balls", "slopes"):
            case = of_size(noise, structure, size, axes)
            assert (case.found.kind, case.found.doubt) == ("white", "")
            assert case.found.sigma == pytest.approx(case.true, rel=0.1)
            assert case.advice.filter is not None


@pytest.mark.parametrize(("structure", "size", "axes"), [("slopes", 32, 3), ("slopes", 64, 2), ("Marschner-Lobb", 32, 3)])
def test_smooth_data_are_not_called_noisy(structure: str, size: int, axes: int) -> None:
    case = of_size("none", structure, size, axes)
    assert case.found.sigma < 1e-3 * case.span
    assert case.found.doubt == ""
    assert case.advice.filter is not None


def test_the_risk_grows_with_what_is_not_known_of_the_noise() -> None:
    """With its variance given there is only the ratio of the two expected errors."""
    rng = np.random.default_rng(0)
    samples = TRUTHS["balls"](np.stack(np.meshgrid(*[np.linspace(-1, 1, 32)] * 3, indexing="ij")[::-1], -1))
    samples = (samples + rng.normal(0, 0.1, samples.shape)).astype(np.float32)
    given, found = (predict(samples, ["bspline3", "bspline3-approx"], noise) for noise in (0.1, None))
    assert given.uncertain == 0 < found.uncertain
    rms = {row.filter: row.rms for row in given}
    assert given.risk("bspline3") == pytest.approx(max(1, rms["bspline3"] / rms["bspline3-approx"]))
    assert found.risk("bspline3", unseen=10.0) == 1
    worst = 1.0
    for change in (-2 * found.uncertain, 0, 2 * found.uncertain):
        squares = (found.blocks + change * found.leverage).mean(1)
        passed = [(1 + change) * row.noise**2 for row in found]  # there is at least this noise
        worst = max(worst, (max(squares[0], passed[0]) / max(squares[1], passed[1])) ** 0.5)
    assert found.risk("bspline3") == pytest.approx(worst)
    assert worst > found[0].rms / found[1].rms
    with_sinc = predict(samples, ["bspline3", "bspline3-approx", "exact-sinc"])
    assert with_sinc.risk("bspline3-approx") == found.risk("bspline3-approx")  # the sinc is no choice
