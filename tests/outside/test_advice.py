"""The advice is right: on data whose truth is known, what it recommends errs as little as anything it could have recommended.

The truth is a function written here. Every compared filter draws the samples at random places between them, in float64 by
`clvol.reference`, which knows nothing of spectra; the root mean square distance from the truth is what counts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import pytest

from clvol import Volume, phantoms, reference
from clvol.filter.table import as_filter
from clvol.reports.advice import ADVISED, Advice, advise, settled_once

pytest.importorskip("matplotlib")
Function: TypeAlias = Callable[[np.ndarray], np.ndarray]
SIZE = 48
WORDS = {"mitchell", "catmull-rom"}  # which overshoot


def grid(n: int) -> tuple[np.ndarray, Volume]:
    """Positions (n, n, n, 3) of samples on [-1, 1]³, and a volume for values."""
    x = np.linspace(-1, 1, n)
    z, y, x = np.meshgrid(x, x, x, indexing="ij")
    return np.stack([x, y, z], -1), Volume(np.zeros((n,) * 3), (2 / (n - 1),) * 3, (-1.0,) * 3)


def sampled(function: Function, n: int = SIZE, sigma: float = 0.0, seed: int = 0) -> Volume:
    at, empty = grid(n)
    noise = np.random.default_rng(seed).normal(0, sigma, (n,) * 3) if sigma else 0.0
    return Volume((function(at) + noise).astype(np.float32), empty.spacing, empty.origin)


def errors(volume: Volume, truth: Function, filters: Sequence[str] = ADVISED, count: int = 20_000) -> dict[str, float]:
    """RMS error of each filter, as settled for the volume, five samples away from the faces."""
    points = volume.index_to_world(np.random.default_rng(1).uniform(5, np.array(volume.size) - 6, (count, 3)))
    wanted = truth(points)
    rows = settled_once([as_filter(name) for name in filters], volume)
    return {row.name: float(np.sqrt(np.mean((reference.sample(volume, points, row) - wanted) ** 2))) for row in rows}


def loses(advice: Advice, found: dict[str, float], span: float) -> float:
    """The error of the recommendation over the smallest; errors below 10⁻⁴ of the range count as none."""
    return max(found[advice.filter], 1e-4 * span) / max(min(found.values()), 1e-4 * span)


def ball(points: np.ndarray) -> np.ndarray:
    return 0.5 + (0.75**2 - (points**2).sum(-1)) / 1.5


def rings(points: np.ndarray) -> np.ndarray:
    return phantoms.marschner_lobb_function(points)


def zone_plate(points: np.ndarray) -> np.ndarray:
    """Waves that shorten outwards, to 3 samples along an axis at the faces of 48³."""
    return 0.5 + 0.5 * np.cos(np.pi / 3 * (SIZE - 1) / 2 * (points**2).sum(-1))


def edge(points: np.ndarray) -> np.ndarray:
    """A ball with a scanner's edge, blurred by a Gaussian of 0.8 samples."""
    from scipy import special

    return 0.5 - 0.5 * special.erf((np.linalg.norm(points, axis=-1) - 0.6) * (SIZE - 1) / 2 / 0.8 / np.sqrt(2))


def box(shift: Sequence[float], n: int = SIZE) -> Function:
    """0 and 1, with faces shifted by `shift` samples from a centred box."""
    away = np.asarray(shift) * 2 / (n - 1)
    return lambda points: (np.abs(points - away) <= 0.6).all(-1).astype(np.float64)


# -- what is recommended errs least ----------------------------------------------------------------------------------

SMOOTH = [
    # the bend of the ball is the same along all axes, so its blur by them adds up, which spectra know nothing of
    pytest.param(function, sigma, 1.15 if (function, sigma) == (ball, 0.005) else 1.08, id=f"{function.__name__}, noise {sigma:g}")
    for function, levels in {
        ball: (0.0, 0.005, 0.02, 0.05, 0.1, 0.2, 0.5),
        rings: (0.0, 0.01, 0.05, 0.2),
        zone_plate: (0.0, 0.02, 0.1, 0.3),
        edge: (0.0, 0.02, 0.1, 0.3),
    }.items()
    for sigma in levels
]


@pytest.mark.one_in(20)
@pytest.mark.parametrize(("function", "sigma", "times"), SMOOTH)
def test_the_recommended_filter_has_the_smallest_error(function: Function, sigma: float, times: float) -> None:
    volume = sampled(function, sigma=sigma)
    given = advise(volume)
    low, high = volume.value_range
    assert loses(given, errors(volume, function), high - low) < times


@pytest.mark.one_in(2)
@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.2])
def test_expected_errors_match_measured_ones(sigma: float) -> None:
    """The noisy ball, with every filter."""
    volume = sampled(ball, sigma=sigma)
    expected, found = advise(volume).expected, errors(volume, ball)
    assert expected is not None
    if not sigma:
        found = {name: error for name, error in found.items() if error > 3e-4}
    assert len(found) >= 4
    for name, error in found.items():
        if "(" not in name:
            assert expected.row(name).rms == pytest.approx(error, rel=0.05 if sigma else 0.4), name


def test_noise_reverses_the_order() -> None:
    clean, noisy = advise(sampled(ball)), advise(sampled(ball, sigma=0.2))
    assert clean.filter == "bspline3"
    assert as_filter(noisy.filter).smoothing != 0
    found = errors(sampled(ball, sigma=0.2), ball)
    assert found["bspline3"] > 1.4 * found["linear"] > 5 * found[noisy.filter]  # 0.164, 0.109, 0.018
    assert "pays not to pass through" in " ".join(noisy.sentences)
    for given in (clean, noisy):
        assert "fine as the samples" not in " ".join(given.sentences)  # which does not describe noise


# -- hard edges, wherever they lie -----------------------------------------------------------------------------------

ALIGNMENTS = [(0, 0, 0), (1, 0, 0), (0, 1, 1), (1, 1, 1), (0.25, 0.5, 0.75), (0.1, 0.1, 0.1), (0.9, 0.35, 0.6)]


def test_the_alignment_of_a_box_does_not_matter() -> None:
    totals: dict[str, float] = {}
    for shift in ALIGNMENTS:
        half = np.asarray(shift, float) / (2 if max(shift) == 1 else 1)
        volume = sampled(box(half), 32)
        given = advise(volume)
        assert given.filter == "linear", shift
        assert "one sample to the next" in " ".join(given.sentences)
        found = errors(volume, box(half, 32))
        assert loses(given, found, 1.0) < 1.15  # each alignment favours another filter
    rng = np.random.default_rng(2)
    for _ in range(8):
        half = rng.uniform(-0.5, 0.5, 3)
        truth = box(half, 32)
        for name, error in errors(sampled(truth, 32), truth, count=4000).items():
            totals[name] = totals.get(name, 0.0) + error**2
    assert np.sqrt(totals["linear"] / min(totals.values())) < 1.02


def test_a_noisy_box_is_not_oversmoothed() -> None:
    truth = box((0.3, 0.1, 0.6))
    for sigma in (0.05, 0.2, 0.5):
        volume = sampled(truth, sigma=sigma)
        assert loses(advise(volume), errors(volume, truth), 1.0) < 1.1


# -- what only names --------------------------------------------------------------------------------------------------


def labels(kind: type[np.generic], n: int = 40) -> Volume:
    """Nine balls with distant label numbers."""
    rng = np.random.default_rng(4)
    z, y, x = np.indices((n, n, n))
    data = np.zeros((n, n, n))
    for label in rng.permutation(np.arange(1, 10)) * 7:
        cz, cy, cx = rng.uniform(8, n - 8, 3)
        data[(z - cz) ** 2 + (y - cy) ** 2 + (x - cx) ** 2 < rng.uniform(4, 9) ** 2] = label
    return Volume(data.astype(kind))


@pytest.mark.parametrize("kind", [np.uint8, np.int32, np.float32])
def test_labels_are_not_blended(kind: type[np.generic]) -> None:
    given = advise(labels(kind))
    assert given.filter == "nearest"
    assert "labels" in given.sentences[0]
    assert "indicator" in given.sentences[1]


def test_a_mask_gets_surfaces_without_stairs() -> None:
    z, y, x = np.indices((40, 40, 40)) - 19.7
    given = advise((x**2 + y**2 + z**2 < 13**2).astype(np.uint8))
    assert "two values. For surfaces without stairs draw them at the mean of the two by bspline3(auto)" in " ".join(given.sentences)


# -- nothing at all ---------------------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_is_reported_as_noise(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(3, 1, (40, 44, 48))
    given = advise(noise)
    assert given.sentences[0].startswith("These data are noise: a standard deviation of")
    assert "fine as the samples" not in " ".join(given.sentences)
    found = errors(Volume(noise), lambda points: np.full(len(points), 3.0))
    assert found[given.filter] == min(found.values())


@pytest.mark.parametrize("value", [0.0, 0.1, -1234.567])
def test_constant_data_need_no_advice(value: float) -> None:
    given = advise(np.full((9, 9, 9), value))
    assert given.filter == "linear"
    assert "constant" in given.sentences[0]


# -- what must not matter, and what must not be said -----------------------------------------------------------------


def test_the_length_of_a_volume_does_not_affect_its_sampling_quality() -> None:
    """Waves of 8 samples in 40 and in 160 slices, on a slope over all of them."""
    details = []
    for n in (40, 160):
        z, y, x = np.indices((n, 40, 40))
        waves = np.cos(np.pi / 4 * x) + np.cos(np.pi / 4 * y) + np.cos(np.pi / 4 * z) + 20 * z / n
        given = advise(waves)
        assert given.expected is not None
        assert given.expected.detail is not None
        details.append((given.filter, given.expected.detail, given.sentences[-1]))
    assert details[0][0] == details[1][0]
    assert details[0][1] == pytest.approx(details[1][1], abs=0.01)
    assert details[0][2].rpartition(":")[2] == details[1][2].rpartition(":")[2]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("function", [box((0.3, 0.1, 0.6)), edge, zone_plate], ids=["box", "edge", "zone plate"])
def test_overshooting_data_get_no_advice_on_range(function: Function) -> None:
    volume = sampled(function)
    low, high = volume.value_range
    points = volume.index_to_world(np.random.default_rng(5).uniform(0, SIZE - 1, (100_000, 3)))
    given = advise(volume, [name for name in ADVISED if name not in ("linear", "nearest")] + ["linear"])
    [says] = [sentence for sentence in given.sentences if "range" in sentence and "noise" not in sentence] or [""]
    if "must not happen" in says:
        named = [name for name in ADVISED if name in says.partition("must not happen, ")[2].replace(",", " ").split()]
        assert "linear" in named
        assert not WORDS & set(named)
        for name in named:
            drawn = reference.sample(volume, points, name)
            assert low - 1e-9 <= drawn.min() <= drawn.max() <= high + 1e-9
    drawn = reference.sample(volume, points, given.filter)
    left = max(low - drawn.min(), drawn.max() - high) / (high - low)
    if "cannot leave" in says:
        assert left < 1e-9
    else:  # told as large as it is on the scan itself, where any place between samples leaves the range
        told = float(says.partition("up to ")[2].partition(" %")[0]) / 100 if "up to" in says else 0.0
        assert told >= 0.7 * left - 1e-3


def test_only_certain_statements_are_made() -> None:
    """In pure noise, no filter is claimed to gain over one that passes as much."""
    rng = np.random.default_rng(6)
    told = 0
    for _ in range(10):
        volume = Volume(rng.normal(0, 1, (40, 40, 40)).cumsum(0).cumsum(1).cumsum(2))
        expected = advise(volume, ["omoms3", "bspline5", "linear"], noise=0.0).expected
        assert expected is not None
        assert expected.surely_less("bspline5", "linear")
        assert not expected.surely_less("linear", "bspline5")
        told += expected.surely_less("bspline5", "bspline5")
    assert told == 0


def test_the_advice_is_the_same_every_time() -> None:
    volume = sampled(edge, 40, sigma=0.05)
    first, again = advise(volume), advise(volume)
    assert (first.filter, first.sentences) == (again.filter, again.sentences)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("unit", [1e-200, 1e-20, 1e6, 1e150])
def test_the_unit_of_the_data_does_not_matter(unit: float) -> None:
    at, empty = grid(40)
    values = edge(at) + np.random.default_rng(7).normal(0, 0.05, at.shape[:-1])
    plain, scaled = (advise(Volume(values * u, empty.spacing)) for u in (1.0, unit))
    assert scaled.filter == plain.filter
    assert scaled.expected is not None
    assert plain.expected is not None
    for a, b in zip(scaled.expected, plain.expected, strict=True):
        assert a.rms == pytest.approx(unit * b.rms, rel=1e-3)


def test_few_samples_give_no_order() -> None:
    """Noise of 8³ and 16³ samples: one block, whose resamplings all have the same order."""
    for n in (8, 16):
        given = advise(np.random.default_rng(n).normal(size=(n, n, n)))
        said = " ".join(given.sentences)
        assert not re.search("smaller than|errs less|errs still less|pays|fine as the samples", said)
        assert "too few" in said or "These data are noise" in said


@pytest.mark.parametrize("slopes", [(1, 0, 0), (0.1, 10, 3)])
def test_planes_need_no_more_than_linear_interpolation(slopes: tuple[float, float, float]) -> None:
    given = advise((np.tensordot(slopes, np.indices((32, 32, 32)), 1) + 0.1).astype(np.float32))
    assert given.filter == "linear"
    assert given.sentences[1:] == ["It cannot leave the range of the samples."]


def test_clean_data_have_no_noise() -> None:
    """Sharp analytic ellipsoids: their highest octave is not noise."""
    from scipy import special

    def ellipsoids(points: np.ndarray) -> np.ndarray:
        total = np.zeros(points.shape[:-1])
        for height, axes in ((1.0, (0.55, 0.7, 0.83)), (-0.8, (0.5, 0.62, 0.77)), (0.3, (0.17, 0.12, 0.21))):
            total += height * special.erfc((np.linalg.norm(points / axes, axis=-1) - 1) * min(axes) * 20) / 2
        return total

    volume = sampled(ellipsoids)
    given = advise(volume)
    assert not re.search("hold noise|pays", " ".join(given.sentences))
    assert loses(given, errors(volume, ellipsoids), 1.0) < 1.08


def test_an_undetectable_error_is_not_reported_as_zero() -> None:
    z, y, x = np.indices((48, 48, 48))
    given = advise(np.sin(0.7 * z) * np.sin(0.5 * y) + 0 * x)
    said = " ".join(given.sentences)
    assert "more than 99 % smaller than that of linear" in said
    assert "100 % smaller" not in said
    assert "by 100 %" not in said


def test_flattening_filters_are_not_recommended() -> None:
    names = ["linear", "bspline3(auto)", "bspline3(20000)"]
    volume = sampled(ball, 24, 0.1)
    assert loses(advise(volume, names), errors(volume, ball, names), 1.0) == 1


def test_smooth_data_of_few_values_get_smoothing() -> None:
    """Nearest, which suits labels, has several times the error."""

    def wave(points: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(points, -1, 0)
        return np.asarray(3.5 * (1 + np.sin(x / 4 + y / 7) * np.cos(z / 5)))

    index = np.stack(np.meshgrid(*[np.arange(32.0)] * 3, indexing="ij")[::-1], -1)
    volume = Volume(np.round(wave(index)).astype(np.uint8))
    points = np.random.default_rng(0).uniform(4, 27, (20_000, 3))
    errors = {
        name: float(np.sqrt(np.mean((reference.sample(volume, points, name) - wave(points)) ** 2)))
        for name in ("nearest", "linear", "bspline3", advise(volume).filter)
    }
    assert errors[advise(volume).filter] < 0.5 * min(errors["nearest"], errors["linear"], errors["bspline3"])
