"""Expected errors: closed forms, and measurements where the truth and the noise are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from clvol import Volume, reference
from clvol.analysis import EXACT_SINC, error_kernel, jump_error, predict, variance_gain
from clvol.base.errors import ClvolError, DataError, OptionError
from clvol.filter.table import as_filter
from clvol.noise import Noise
from tests.cases import BAD_COUNTS, BAD_FILTER_LISTS, BAD_FILTERS

NAMES = (
    "nearest",
    "linear",
    "bspline3-approx",
    "mitchell",
    "catmull-rom",
    "bspline2",
    "bspline3",
    "omoms3",
    "bspline5",
    "bspline3(0.1)",
)


# -- one filter ---------------------------------------------------------------------------------------------------


def test_variance_gains_match_closed_forms() -> None:
    assert variance_gain("nearest") == pytest.approx(1, rel=1e-6)
    assert variance_gain("linear") == pytest.approx(2 / 3, rel=1e-9)  # the mean of (1 - t)² + t²
    assert variance_gain("bspline3-approx") == pytest.approx(151 / 315, rel=1e-9)  # the septic B-spline at 0
    assert variance_gain("bspline2-approx") == pytest.approx(11 / 20, rel=1e-9)  # the quintic one
    assert variance_gain(EXACT_SINC) == 1


@pytest.mark.parametrize("name", NAMES)
def test_a_variance_gain_is_the_mean_of_squared_weights(name: str) -> None:
    """White noise reconstructed at random positions: the gain is the ratio of variances."""
    rng = np.random.default_rng(0)
    drawn = reference.sample(Volume(rng.normal(size=(300, 300))), rng.uniform(10, 289, (40_000, 2)), name)
    assert drawn.std() == pytest.approx(variance_gain(name), rel=0.03)  # a square for two axes, a root for the deviation


def test_errors_at_jumps_match_closed_forms() -> None:
    assert jump_error("nearest") == pytest.approx(1 / 4, rel=1e-3)
    assert jump_error("linear") == pytest.approx(1 / 6, rel=1e-3)
    assert jump_error(EXACT_SINC) == pytest.approx(2 / math.pi**2, rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_the_error_at_jumps_is_that_of_a_step(name: str) -> None:
    """The filter's reconstruction of a step, integrated over all positions of the step between two samples."""
    n, fine = 80, 100
    x = (np.arange((n - 1) * fine) + 0.5) / fine
    drawn = reference.lattice((np.arange(n) < n // 2).astype(float), [x], name, "mirror")
    edges = n // 2 - 1 + (np.arange(fine) + 0.5) / fine
    errors = [float(((drawn - (x < edge)) ** 2).sum()) / fine for edge in edges]
    assert jump_error(name) == pytest.approx(float(np.mean(errors)), rel=0.01)


# -- a volume -----------------------------------------------------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", NAMES)
def test_the_error_of_waves_is_the_error_kernel(name: str) -> None:
    """Waves along x: the expected error is Blu and Unser's kernel at their frequency."""
    omega = 2 * np.pi * 5 / 32  # whole periods in a block, so that nothing leaks
    data = np.cos(omega * np.arange(96))[None, None].repeat(40, 0).repeat(40, 1)
    [row] = predict(data, [name], 0.0)
    keeps_others = as_filter(name).sums_to_one
    assert keeps_others
    assert row.rms == pytest.approx(math.sqrt(float(error_kernel(name, omega)) / 2), rel=0.03)
    assert row.noise == 0


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", [n for n in NAMES if n != "nearest"])
def test_the_gradient_error_of_waves_is_the_error_kernel_of_derivatives(name: str) -> None:
    omega = 2 * np.pi * 5 / 32
    data = Volume(np.cos(omega * np.arange(96))[None, None].repeat(40, 0).repeat(40, 1), (0.5, 1.0, 1.0))
    [row] = predict(data, [name], 0.0)
    assert row.gradient_rms == pytest.approx(2 * math.sqrt(float(error_kernel(name, omega, 1)) / 2), rel=0.05)


@pytest.mark.parametrize("shape", [(48, 50, 46), (120, 130), (6, 60, 60)])
def test_the_error_of_noise_is_what_the_filter_passes(shape: tuple[int, ...]) -> None:
    data = np.random.default_rng(0).normal(5, 2, shape)
    for row in predict(data, [*NAMES, EXACT_SINC], 2.0):
        assert row.noise == pytest.approx(2 * variance_gain(row.filter) ** (len(shape) / 2), rel=1e-9)
        assert row.bias < 0.45 * row.noise + 0.2  # the random error of a sum of few blocks


def test_an_exact_background_has_no_noise() -> None:
    """Half of the volume is exactly 0: it has half of the variance of the noise."""
    data = np.random.default_rng(0).normal(5, 1, (48, 48, 96))
    data[..., :48] = 0
    noise = Noise(1.0, "white", colour=(1.0, 1.0, 1.0), background=0.0, background_share=0.5)
    [row] = predict(data, ["linear"], noise)
    assert row.noise == pytest.approx((2 / 3) ** 1.5 * math.sqrt(0.5), rel=0.05)


def test_an_axis_has_its_own_smoothing() -> None:
    """λ along z changes waves along z alone."""
    omega = 2 * np.pi * 5 / 32
    wave = np.cos(omega * np.arange(64))
    along_z, along_x = wave[:, None, None].repeat(40, 1).repeat(40, 2), wave[None, None].repeat(40, 0).repeat(40, 1)
    smooth, plain = (float(error_kernel(name, omega)) for name in ("bspline3(2)", "bspline3"))
    for data, expected in ((along_z, smooth), (along_x, plain)):
        [row] = predict(data, ["bspline3(0,0,2)"], 0.0)
        assert row.rms == pytest.approx(math.sqrt(expected / 2), rel=0.05)


def test_blocks_decide_what_is_certain() -> None:
    x = np.arange(80)
    data = np.cos(0.9 * x)[:, None, None] + np.cos(1.1 * x)[None, :, None] + np.cos(x)[None, None]
    table = predict(data, ["linear", "bspline3", "bspline5"], 0.0)
    assert table.blocks.shape[1] == table.slopes.shape[1] == 4**3
    assert [row.rms**2 for row in table] == pytest.approx(table.blocks.mean(1), rel=1e-9)
    assert table.surely_less("bspline3", "linear")
    assert table.surely_less("bspline3", "linear", 0.5)
    assert not table.surely_less("linear", "bspline3")
    assert not table.surely_less("linear", "linear")
    assert table.surely_less("bspline5", "linear", key="gradient_rms")
    ratio = table.row("bspline3").rms / table.row("linear").rms
    assert table.surely_less("bspline3", "linear", 1.2 * ratio)
    assert not table.surely_less("bspline3", "linear", 0.8 * ratio)
    with pytest.raises(OptionError, match="filter must be one of linear, bspline3, bspline5; got 'x'"):
        table.row("x")
    with pytest.raises(OptionError, match="key must be one of rms, gradient_rms; got 'psnr'"):
        table.surely_less("linear", "bspline3", key="psnr")
    with pytest.raises(OptionError, match="times must be a finite number, greater than 0"):
        table.surely_less("linear", "bspline3", 0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (2, 2), (3, 5), (1, 1, 1), (2, 3, 4), (1, 20, 20), (9, 9, 9)])
def test_small_data_have_an_expected_error(shape: tuple[int, ...]) -> None:
    data = np.random.default_rng(0).normal(size=shape)
    for row in predict(data, [*NAMES, EXACT_SINC], 0.5):
        for number in (row.bias, row.noise, row.rms, row.gradient_rms or 0.0):
            assert math.isfinite(number)
            assert number >= 0


def test_flattening_of_structures_larger_than_blocks_is_predicted() -> None:
    """A noisy ball with increasing smoothing, in a volume of one or two blocks."""
    n = 24
    field = 0.5 + (0.75**2 - (np.stack(np.meshgrid(*[np.linspace(-1, 1, n)] * 3)) ** 2).sum(0)) / 1.5
    noisy = field + np.random.default_rng(0).normal(0, 0.1, field.shape)
    points = np.random.default_rng(1).uniform(4, n - 5, (20_000, 3))
    truth = reference.sample(Volume(field), points, "bspline5")
    names = ["bspline3(0.3)", "bspline3(2000)", "bspline3(20000)", "bspline3(100000)"]
    expected = [row.rms for row in predict(noisy, names)]
    found = [float(np.sqrt(np.mean((reference.sample(Volume(noisy), points, name) - truth) ** 2))) for name in names]
    assert expected == sorted(expected)
    assert expected[1:] == pytest.approx(found[1:], rel=0.35)
    # and nothing is added where all of a wave passes
    [plain, little] = predict(field, ["bspline3", "bspline3(0.0001)"], 0.0)
    assert little.rms < plain.rms + 1e-4


def test_few_blocks_are_never_certain() -> None:
    data = np.cos(0.9 * np.arange(20))[:, None, None] + np.zeros((1, 20, 12))
    table = predict(data, ["linear", "bspline5"], 0.0)
    assert table.blocks.shape[1] == 4
    assert not table.enough
    assert table.row("bspline5").rms < 0.2 * table.row("linear").rms
    assert not table.surely_less("bspline5", "linear")
    assert table.detail is None


def test_a_random_order_is_seldom_certain() -> None:
    """Detail whose strength varies over the volume: the ratio of the errors varies no less than over all volumes."""
    tables = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        coarse, fine, where = (ndimage.gaussian_filter(rng.normal(size=(40, 40, 40)), s, mode="wrap") for s in (1, 0.5, 6))
        tables.append(predict(coarse + 0.3 * fine * np.exp(where / where.std() / 2), ["linear", "mitchell"], 0.0))
    linear, mitchell = (math.sqrt(np.mean([t.row(name).rms ** 2 for t in tables])) for name in ("linear", "mitchell"))
    wrong = [
        t.surely_less("mitchell", "linear", mitchell / linear) or t.surely_less("linear", "mitchell", linear / mitchell)
        for t in tables
    ]
    assert np.mean(wrong) < 0.2  # 0.05 for many blocks; 0.33 if overlapping ones were treated as independent


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_planes_have_no_detail(kind: type[np.floating]) -> None:
    z, y, x = np.indices((40, 40, 40))
    table = predict(Volume((0.1 + 0.3 * x + 0.7 * y + 0.5 * z).astype(kind), (0.5, 1, 1)), ["linear"], 0.0)
    assert table.detail is None
    assert table.steepness == pytest.approx(0.6**2 + 0.7**2 + 0.5**2, rel=1e-3)


BAD: list[tuple[dict[str, Any], type[ClvolError], str]] = [
    *(({"filters": bad}, OptionError, "filters must be one or more names; got ") for bad in BAD_FILTER_LISTS),
    *(({"filters": [bad]}, OptionError, "filter") for bad in BAD_FILTERS),
    *(({"noise": bad}, OptionError, "noise must be a finite number, at least 0") for bad in (-1, "a", np.nan)),
    *(({"blocks": bad}, OptionError, "blocks must be a whole number, at least 1") for bad in BAD_COUNTS),
    ({"seed": -1}, OptionError, "seed must be"),
    ({"volume": [[1.0, np.inf]]}, DataError, "samples must be finite"),
]


@pytest.mark.parametrize(("arguments", "error", "message"), BAD)
def test_bad_input_is_rejected(arguments: dict[str, Any], error: type[ClvolError], message: str) -> None:
    with pytest.raises(error, match=message):
        predict(**{"volume": np.arange(12.0).reshape(3, 4), "filters": ["linear"], "noise": 0.0, **arguments})


def test_a_filter_with_different_axes_has_no_single_gain() -> None:
    with pytest.raises(OptionError, match="along each axis"):
        variance_gain("bspline3(0.1,0.2,0.3)")
