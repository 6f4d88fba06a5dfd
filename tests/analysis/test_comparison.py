"""Measured errors: known numbers, several definitions of the truth, and input that cannot be measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from clvol import reference
from clvol.analysis import COMPARED, EXACT_SINC, ErrorTable, compare, error_kernel, ssim
from clvol.analysis.comparison import keeps_range
from clvol.base.errors import ClvolError, DataError, OptionError, OutOfMemoryError
from clvol.device import Device
from clvol.filter.make import from_callable
from clvol.filter.table import as_filter, filters
from clvol.phantoms import marschner_lobb, marschner_lobb_function, marschner_lobb_gradient
from clvol.volume.volume import Volume
from tests.cases import BAD_COUNTS, BAD_DATA, BAD_FILTER_LISTS, BAD_FILTERS, BAD_NUMBERS, BAD_WHOLE, DEGREES, RMSE


def wave(points: np.ndarray) -> np.ndarray:
    return np.sin(3 * points[:, 0]) * np.cos(2 * points[:, 1]) + points[:, -1]


def wave_gradient(points: np.ndarray) -> np.ndarray:
    x, y = points[:, 0], points[:, 1]
    slopes = [3 * np.cos(3 * x) * np.cos(2 * y), -2 * np.sin(3 * x) * np.sin(2 * y)]
    if points.shape[1] == 3:
        return np.stack([*slopes, np.ones_like(x)], -1)
    return np.stack([slopes[0], slopes[1] + 1], -1)


def plane(points: np.ndarray) -> np.ndarray:
    return points @ np.arange(1.0, points.shape[-1] + 1)


@pytest.fixture(scope="module")
def known() -> ErrorTable:
    return compare(marschner_lobb_function, list(RMSE), gradient=marschner_lobb_gradient, timing=False)


@pytest.mark.thorough
@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", RMSE)
def test_rms_on_marschner_lobb_is_the_known_value(known: ErrorTable, name: str) -> None:
    row = next(r for r in known if r.filter == name)
    assert row.rms == pytest.approx(RMSE[name], rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("name", DEGREES)
def test_angle_on_marschner_lobb_is_the_known_value(known: ErrorTable, name: str) -> None:
    row = next(r for r in known if r.filter == name)
    assert row.angle_mean == pytest.approx(DEGREES[name], abs=0.5)


@pytest.mark.thorough
def test_a_table_states_what_was_compared(known: ErrorTable) -> None:
    assert [row.filter for row in known] == list(RMSE)
    assert (known.points, known.boundary, known.evaluated_on, known.timed_on) == (200_000, "mirror", "NumPy, float64", "")
    assert known.samples.shape == (41, 41, 41)
    assert known.value_range == known.samples.value_range
    assert known.against == "the function at 200000 random points"
    assert known.best().filter == known.best("angle_95").filter == known.best("ssim").filter == "bspline5"
    assert known.best("overshoot").overshoot == 0
    assert json.loads(known.to_json())[0]["angle_mean"] is None  # nearest has no gradient
    for key in ("seconds", "filter", "none"):
        with pytest.raises(OptionError):
            known.best(key)


def test_numbers_match_their_definitions() -> None:
    grid = Volume(np.random.default_rng(0).normal(size=(12, 14)), (0.5, 0.25), (1.0, -2.0))
    table = compare(grid, ["catmull-rom"], truth=wave, gradient=wave_gradient, points=5000, margin=2, seed=3, timing=False)
    [row] = table
    points = grid.index_to_world(np.random.default_rng(3).uniform(2, [11, 9], (5000, 2)))
    got, slopes = (reference.sample(grid, points, "catmull-rom", derivative=d) for d in (0, 1))
    error = got - wave(points)
    low, high = grid.data.min(), grid.data.max()
    assert row.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert row.maximum == np.abs(error).max()
    assert row.psnr == pytest.approx(10 * np.log10((high - low) ** 2 / np.mean(error**2)), rel=1e-12)
    assert row.overshoot == max(got.max() - high, low - got.min(), 0)
    assert row.overshoot > 0.01
    true = wave_gradient(points)
    assert row.gradient_rms == pytest.approx(np.sqrt(np.mean(((slopes - true) ** 2).sum(-1))), rel=1e-12)
    angle = np.degrees(np.abs(np.angle((slopes[:, 0] + 1j * slopes[:, 1]) / (true[:, 0] + 1j * true[:, 1]))))
    assert row.angle_mean == pytest.approx(angle.mean(), rel=1e-6)
    assert row.angle_median == pytest.approx(np.median(angle), rel=1e-6)
    assert row.angle_95 == pytest.approx(np.percentile(angle, 95), rel=1e-6)
    y, x = np.meshgrid(np.arange(2, 9.25, 0.5), np.arange(2, 11.25, 0.5), indexing="ij")
    at = grid.index_to_world(np.stack([x, y], -1))
    shown = ssim(reference.sample(grid, at, "catmull-rom"), wave(at.reshape(-1, 2)).reshape(x.shape), high - low)
    assert row.ssim == pytest.approx(shown, rel=1e-12)


def test_a_negligible_true_gradient_has_no_angle() -> None:
    """Ahead of the step the true gradient is 0 or 10⁻⁶ of the maximum; the filter's ringing there has no direction."""

    def ramp(points: np.ndarray) -> np.ndarray:
        return np.maximum(points[:, 0], 0) + 1e-6 * points[:, 1]

    [row] = compare(ramp, ["bspline3"], dimensions=2, size=33, points=4000, timing=False)
    assert row.angle_95 is not None
    assert row.angle_95 < 1
    grid = Volume(np.zeros((33, 33)), (1 / 16,) * 2, (-1.0,) * 2)
    sampled = ramp(grid.index_to_world(np.stack(np.meshgrid(np.arange(33), np.arange(33)), -1)).reshape(-1, 2)).reshape(33, 33)
    ahead = reference.sample(Volume(sampled, grid.spacing, grid.origin), [[-0.05, 0.3]], derivative=1)[0]
    assert np.abs(ahead[0]) > 0.05  # across the true one, which points along y there


def test_the_gradient_of_a_function_is_computed_by_differences() -> None:
    options: dict[str, Any] = {"size": 15, "points": 2000, "timing": False}
    [given] = compare(wave, ["bspline3"], gradient=wave_gradient, **options)
    [found] = compare(wave, ["bspline3"], **options)
    assert found.gradient_rms == pytest.approx(given.gradient_rms, abs=1e-9)
    assert found.angle_mean == pytest.approx(given.angle_mean, abs=1e-6)


def test_a_rotated_grid_changes_nothing() -> None:
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(2, 2)))[0]
    empty = Volume(np.zeros((40, 50)), (0.1, 0.2), (3.0, 4.0), rotation)
    lattice = np.stack(np.meshgrid(np.arange(40), np.arange(50), indexing="ij")[::-1], -1)
    volume = Volume(plane(empty.index_to_world(lattice)), empty.spacing, empty.origin, rotation)
    for row in compare(volume, ["linear", "mitchell"], truth=plane, points=500, timing=False):
        assert row.maximum < 1e-9
        assert row.angle_95 is not None
        assert row.angle_95 < 1e-4


# -- held back ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lowpass", ["gaussian", "none"])
def test_decimation_is_low_pass_subsampling_and_reconstruction(lowpass: Any) -> None:
    data = np.random.default_rng(0).normal(size=(11, 12, 13)).cumsum(0).cumsum(1).astype(np.float32)
    volume = Volume(data, (1.0, 2.0, 0.5), (1.0, 2.0, 3.0))
    [row] = table = compare(volume, ["bspline3"], margin=1, lowpass=lowpass, fractional=0, timing=False)
    # in SciPy's words: its Gaussian, and slices
    smooth = ndimage.gaussian_filter(data.astype(float), 1.0, mode="mirror") if lowpass == "gaussian" else data.astype(float)
    np.testing.assert_array_equal(table.samples.data, smooth[::2, ::2, ::2])
    errors, before, lost, slopes = [], [], [], []
    coefficients = Volume(smooth, volume.spacing, volume.origin)
    for first in np.ndindex(2, 2, 2):
        kept = smooth[tuple(slice(i, None, 2) for i in first)]
        axes = [np.arange(i + 2, i + 2 * (n - 1) - 1) for i, n in zip(first, kept.shape, strict=True)]
        positions = np.meshgrid(*[(a - i) / 2 for a, i in zip(axes, first, strict=True)], indexing="ij")
        got = ndimage.map_coordinates(kept, positions, order=3, mode="mirror")
        here = np.ix_(*axes)
        errors.append((got - smooth[here]).ravel())
        before.append((got - data[here]).ravel())
        lost.append((smooth - data)[here].ravel())
        at = volume.index_to_world(np.stack(np.meshgrid(*axes, indexing="ij")[::-1], -1).reshape(-1, 3))
        grid = Volume(kept, (2.0, 4.0, 1.0), tuple(volume.index_to_world(first[::-1])))
        slopes.append(reference.sample(grid, at, derivative=1) - reference.sample(coefficients, at, "bspline5", derivative=1))

    def rms(parts: list[np.ndarray]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    assert row.rms == pytest.approx(rms(errors), rel=1e-9)
    assert row.original == pytest.approx(rms(before), rel=1e-9)
    assert table.lost == pytest.approx(rms(lost), rel=1e-9)
    assert row.gradient_rms == pytest.approx(rms(slopes) * np.sqrt(3), rel=1e-9)
    assert (table.shifts, table.points) == (8, sum(e.size for e in errors))
    wide = " low-passed by a Gaussian of standard deviation 1 sample" if lowpass == "gaussian" else ""
    assert (
        table.against
        == f"{table.points} samples of the volume{wide}, drawn from every second along each axis, beginning in 8 places"
    )


def test_fractional_shifts_cover_all_distances() -> None:
    """A wave along x: the mean squared error over all shifts is the error kernel at the frequency of the kept samples."""
    omega, n = 0.45, 400
    data = np.cos(omega * np.arange(n))[None].repeat(9, 0)
    kept = float(ndimage.gaussian_filter1d(np.cos(omega * np.arange(-200, 201)), 1.0)[200])  # what the low-pass preserves
    for name in ("linear", "mitchell", "bspline3"):
        [row] = compare(data, [name], fractional=120, timing=False)
        assert row.rms**2 == pytest.approx(kept**2 / 2 * float(error_kernel(name, 2 * omega)), rel=0.06), name


def test_the_loss_in_sampling_is_not_a_filters_error() -> None:
    """The low-pass removes nearly all noise; filters then differ several times in what remains, hardly in total."""
    data = np.random.default_rng(0).normal(size=(24, 24, 24))
    linear, cubic = table = compare(data, ["linear", "bspline3"], timing=False)
    assert cubic.rms < 0.8 * linear.rms
    assert cubic.original == pytest.approx(linear.original, rel=0.03)
    assert table.lost > 0.9 * (cubic.original or 0)


def test_overshoot_is_relative_to_the_scan_itself() -> None:
    """A step: SciPy's cubic spline overshoots it by 10.8 %, and the low-pass smooths it."""
    data = np.zeros((40, 41))
    data[:, 20:] = 1
    drawn = ndimage.map_coordinates(data, [np.full(400, 20.0), np.linspace(0, 40, 400)], order=3, mode="mirror")
    rows = {row.filter: row.overshoot for row in compare(data, COMPARED, timing=False)}
    assert rows["bspline3"] == pytest.approx(drawn.max() - 1, rel=0.08)  # half-way between samples, not where it is largest
    assert rows["bspline3"] == pytest.approx(0.108, rel=0.08)
    assert [name for name, over in rows.items() if over == 0] == ["nearest", "bspline3-approx", "linear"]
    assert rows["mitchell"] > 0.02
    assert rows["catmull-rom"] > 0.05


def test_nonnegative_weights_keep_the_range() -> None:
    keeping = {name for name, row in filters().items() if keeps_range(row)}
    assert keeping == {"nearest", "linear", *(f"bspline{n}-approx" for n in (2, 3, 4, 5))}
    assert not keeps_range(as_filter("hybrid"))
    assert not keeps_range(as_filter("bspline3(0.1)"))


def test_decimation_of_smooth_data_orders_the_filters() -> None:
    line = np.cos(2 * np.pi / 30 * np.arange(90))  # of which every third sample has the same period, wherever it begins
    table = compare(line[:, None] * line, COMPARED, factor=3, lowpass="none", boundary="wrap", timing=False)
    rms = {row.filter: row.rms for row in table}
    assert rms["bspline5"] < rms["bspline4"] < rms["bspline3"] < rms["catmull-rom"] < rms["linear"] < rms["nearest"]
    assert rms["linear"] < rms["bspline3-approx"]
    assert table.best().filter == EXACT_SINC


@pytest.mark.parametrize("rule", ["mirror", "reflect", "wrap"])
def test_the_exact_sinc_is_exact_for_band_limited_data(rule: str) -> None:
    n = 24
    phase = {
        "mirror": np.pi * np.arange(n) / (n - 1),
        "reflect": np.pi * (np.arange(n) + 0.5) / n,
        "wrap": 2 * np.pi * np.arange(n) / n,
    }[rule]
    line = np.cos(3 * phase)

    def truth(points: np.ndarray) -> np.ndarray:
        return np.cos(3 * (phase[0] + (phase[1] - phase[0]) * points[:, 0])) * np.cos(
            3 * (phase[0] + (phase[1] - phase[0]) * points[:, 1])
        )

    sinc, linear = compare(line[:, None] * line, [EXACT_SINC, "linear"], truth=truth, boundary=rule, points=500, timing=False)
    assert sinc.maximum < 1e-12
    assert sinc.gradient_rms is not None
    assert sinc.gradient_rms < 1e-9
    assert sinc.ssim == pytest.approx(1, abs=1e-12)
    assert linear.maximum > 1e-2
    # held back: 24 = 2 * 12 samples of a period
    if rule == "wrap":
        [held] = compare(line[:, None] * line, [EXACT_SINC], boundary=rule, lowpass="none", timing=False)
        assert held.maximum < 1e-12


def test_some_slices_of_a_large_volume_are_compared_at_each_shift() -> None:
    data = np.random.default_rng(0).normal(size=(40, 16, 16))
    [row] = table = compare(data, ["linear"], margin=1, lowpass="none", timing=False, max_samples=8 * 2 * 11 * 11)
    assert table.points == 8 * 2 * 11 * 11
    assert table.against.startswith("1936 samples of the volume, drawn from")
    every = compare(data, ["linear"], margin=1, lowpass="none", timing=False)
    assert row.rms == pytest.approx(every[0].rms, rel=0.15)


def test_angles_ignore_empty_space() -> None:
    """A ball in noisy air: the angle is that at its edge, whatever the amount of air."""
    angles = []
    for n in (32, 56):
        z, y, x = np.indices((n, n, n)) - (n - 1) / 2 - 0.2
        ball = 1 / (1 + np.exp((np.sqrt(x**2 + y**2 + z**2) - 8) * 1.5))
        noisy = ball + np.random.default_rng(1).normal(0, 0.1, ball.shape)
        [row] = compare(noisy, ["linear"], sigma=0.1, timing=False, points=60_000)
        angles.append(row.angle_mean)
        [plain] = compare(noisy, ["linear"], sigma=0, timing=False, points=60_000)
        assert plain.angle_mean > 1.5 * row.angle_mean
    assert angles[0] == pytest.approx(angles[1], rel=0.1)


# -- devices ------------------------------------------------------------------------------------------------------


def test_values_from_a_device_and_times(device: Device) -> None:
    names = ["linear", "bspline3", EXACT_SINC]
    for source in (wave, marschner_lobb(24)):
        seen: list[float] = []
        exact = compare(source, names, size=17, points=3000, timing=False)
        got = compare(source, names, size=17, points=3000, device=device, progress=seen.append)
        assert (got.evaluated_on, got.timed_on) == (device.name, device.name)
        assert seen == sorted(seen)
        assert seen[-1] == 1
        assert len(seen) > 5
        for a, b in zip(exact, got, strict=True):
            assert b.rms == pytest.approx(a.rms, abs=2e-5)
            assert b.ssim == pytest.approx(a.ssim, abs=1e-4)
            assert b.gradient_rms == pytest.approx(a.gradient_rms, abs=1e-3)
            assert a.seconds is None
            assert (b.seconds is None) == (b.filter == EXACT_SINC)
            assert b.seconds is None or 0 < b.seconds < 60


def test_only_times_come_from_a_device(device: Device) -> None:
    table = compare(wave, ["linear", EXACT_SINC], size=9, points=30, timing_device=device)
    assert (table.evaluated_on, table.timed_on) == ("NumPy, float64", device.name)
    assert table[0].seconds is not None
    with pytest.raises(OptionError, match="device must be one of"):
        compare(wave, ["linear"], size=9, points=30, timing_device="none")
    with pytest.raises(OptionError, match="device must be one of"):
        compare(wave, ["linear"], size=9, points=30, device="none", timing=False)


WITHOUT_OPENCL = """
import sys
sys.modules["pyopencl"] = None  # importing it raises ImportError
from clvol import analysis, phantoms
table = analysis.compare(phantoms.marschner_lobb(12), ["linear", "exact-sinc"])
print(table.timed_on == "", table[0].seconds, len(table))
"""


def test_it_works_without_opencl() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_OPENCL], capture_output=True, text=True, timeout=120, check=False, env={**os.environ}
    )
    assert (done.stdout.strip(), done.stderr) == ("True None 2", "")


# -- bad input ----------------------------------------------------------------------------------------------------


def finite(table: ErrorTable) -> bool:
    return all(v is None or isinstance(v, str) or np.isfinite(v) for row in table for v in vars(row).values())


@pytest.mark.one_in(2)
@pytest.mark.parametrize("source", [np.full((9, 9, 9), 3.0), np.zeros((20, 20)), lambda p: np.full(p.shape[0], 2.5)])
def test_constant_data_give_values(source: Any) -> None:
    table = compare(source, [*filters(), EXACT_SINC], size=9, points=100, timing=False)
    assert finite(table)
    for row in table:
        assert (row.psnr, row.ssim, row.angle_mean, row.angle_median, row.angle_95) == (None,) * 5
        sums_to_one = row.filter == EXACT_SINC or as_filter(row.filter).sums_to_one
        assert row.rms < (1e-12 if sums_to_one else 1)
    assert "nan" not in table.to_csv() + table.to_json() + table.to_markdown()


@pytest.mark.one_in(4)
@pytest.mark.parametrize("unit", [1e-300, 1e-200, 1e-81, 1e-20, 1e34, 1e200, 1e300])
def test_units_of_the_data_change_nothing(unit: float) -> None:
    data = np.random.default_rng(0).normal(size=(14, 15)).cumsum(0)
    for scaled, plain in zip(*(compare(data * u, COMPARED, margin=1, timing=False) for u in (unit, 1.0)), strict=True):
        for key in ("rms", "maximum", "gradient_rms", "overshoot"):
            one = getattr(plain, key)
            assert getattr(scaled, key) == (None if one is None else pytest.approx(unit * one, rel=1e-6, abs=1e-12 * unit))
        for key in ("psnr", "ssim", "angle_mean", "angle_95"):
            one = getattr(plain, key)
            assert getattr(scaled, key) == (None if one is None else pytest.approx(one, rel=1e-6))


@pytest.mark.one_in(4)
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 2), (3, 5), (1, 1, 1), (1, 7, 2), (2, 3, 4)])
def test_data_smaller_than_the_filter_give_values(shape: tuple[int, ...]) -> None:
    data = np.random.default_rng(0).normal(size=shape)
    for factor in (2, 3, 50):
        assert finite(compare(data, COMPARED, factor=factor, timing=False))
    assert finite(compare(data, COMPARED, truth=plane, points=50, timing=False))


def test_missing_memory_is_a_clvol_error() -> None:
    def full(_: float) -> None:
        raise MemoryError("Unable to allocate 29.8 GiB")

    with pytest.raises(OutOfMemoryError, match=r"what is compared must fit into it; got Unable to allocate 29\.8 GiB"):
        compare(wave, ["linear"], size=5, points=5, timing=False, progress=full)


def test_names_may_be_any_sequence() -> None:
    for names in (np.array(["linear", "Exact-Sinc "]), ("linear", EXACT_SINC), iter(["linear", EXACT_SINC])):
        table = compare(wave, names, size=5, points=5, timing=False)  # type: ignore[arg-type]
        assert [row.filter for row in table] == ["linear", EXACT_SINC]


def test_custom_filters_are_compared() -> None:
    bump = from_callable("bump", lambda x: np.cos(np.pi * x / 4) ** 2 / 2, 2)
    assert compare(wave, [bump], size=9, points=100, timing=False)[0].filter == "bump"


GOOD: dict[str, Any] = {"source": wave, "filters": ["linear"], "size": 5, "points": 10, "timing": False}
VOLUME = {**GOOD, "source": np.arange(12.0).reshape(3, 4)}
BAD: list[tuple[dict[str, Any], type[ClvolError], str]] = [
    ({**GOOD, "source": lambda _: 1 / 0}, OptionError, "function must give one finite value for each position; it failed: Z"),
    ({**GOOD, "source": lambda p: p}, OptionError, r"got shape \(125, 3\) for positions \(125, 3\)"),
    ({**GOOD, "source": lambda p: p[:, 0] * np.nan}, OptionError, "with values that are not finite"),
    ({**GOOD, "source": lambda p: np.sign(p[:, 0]) * 1e308}, DataError, r"must lie within ±1e\+305.*got -1e\+308 to 1e\+308"),
    ({**GOOD, "source": np.random.default_rng(0).uniform(-1e307, 1e307, (24, 24, 24))}, DataError, r"must lie within ±1e\+305"),
    ({**GOOD, "source": lambda _: "text"}, OptionError, "what the function gives must be one finite value"),
    ({**GOOD, "source": lambda _: None}, OptionError, "what the function gives must be one finite value"),
    ({**GOOD, "gradient": lambda p: p[:, :2]}, OptionError, "the gradient must give a finite vector for each position"),
    ({**GOOD, "gradient": lambda _: 1 / 0}, OptionError, "the gradient must give a finite vector for each position; it failed"),
    ({**GOOD, "truth": wave}, OptionError, "truth must be given with a volume only"),
    ({**VOLUME, "gradient": wave}, OptionError, "gradient must be that of a function"),
    *(({**GOOD, "filters": bad}, OptionError, "filters must be one or more names; got ") for bad in BAD_FILTER_LISTS),
    *(({**GOOD, "filters": [bad]}, OptionError, "filter") for bad in BAD_FILTERS),
    ({**GOOD, "points": 10**12}, OutOfMemoryError, "points must give at most 68719476736 samples; got 1000000000000"),
    ({**GOOD, "size": 10**6}, OutOfMemoryError, "size must give at most 68719476736 samples; got 1000000"),
    ({**GOOD, "size": 10**30}, OutOfMemoryError, "size must give at most 68719476736 samples"),
    ({**VOLUME, "factor": 10**9}, OptionError, "factor must be a whole number, at least 2 and at most 1024; got 1000000000"),
    ({**VOLUME, "factor": 10**30}, OptionError, "factor must be a whole number, at least 2 and at most 1024"),
    ({**GOOD, "filters": [EXACT_SINC], "boundary": "zero"}, OptionError, "must be mirror, reflect or wrap for 'exact-sinc'"),
    ({**GOOD, "boundary": "none"}, OptionError, "boundary must be one of"),
    ({**GOOD, "size": 1}, OptionError, "size must be a whole number, at least 2"),
    ({**GOOD, "size": (3, 4)}, OptionError, "size must be a whole number of at least 2, or 3 of them"),
    ({**GOOD, "size": "a"}, OptionError, "size must be"),
    ({**GOOD, "dimensions": 4}, OptionError, "dimensions must be a whole number, at least 2 and at most 3"),
    ({**GOOD, "domain": (1, 1)}, OptionError, "domain must be two numbers, the lower first"),
    ({**GOOD, "domain": (0, np.inf)}, OptionError, "domain must be two numbers"),
    *(({**GOOD, "points": bad}, OptionError, "points must be a whole number, at least 1") for bad in BAD_COUNTS),
    *(({**VOLUME, "max_samples": bad}, OptionError, "max_samples must be a whole number, at least 1") for bad in BAD_COUNTS),
    *(({**VOLUME, "fractional": bad}, OptionError, "fractional must be a whole number") for bad in (-1, *BAD_WHOLE)),
    *(({**VOLUME, "sigma": bad}, OptionError, "sigma must be a finite number, at least 0") for bad in (-1, "a", np.nan)),
    *(({**GOOD, "seed": bad}, OptionError, "seed must be") for bad in (-1, *BAD_WHOLE)),
    *(({**GOOD, "margin": bad}, OptionError, "margin must be") for bad in (-1, *BAD_NUMBERS)),
    ({**GOOD, "device": "none"}, OptionError, "device must be one of"),
    ({**VOLUME, "factor": 1}, OptionError, "factor must be a whole number, at least 2"),
    ({**VOLUME, "lowpass": "box"}, OptionError, "lowpass must be one of gaussian, none; got 'box'"),
    ({**VOLUME, "source": [[1.0, np.nan]]}, DataError, "samples must be finite; got 1 NaN"),
    *(({**VOLUME, "source": bad}, DataError, "data must|of data must") for bad in BAD_DATA),
]


@pytest.mark.parametrize(("arguments", "error", "message"), BAD, ids=[m[:40] for _, _, m in BAD])
def test_bad_input_is_rejected(arguments: dict[str, Any], error: type[ClvolError], message: str) -> None:
    with pytest.raises(error, match=message):
        compare(**arguments)
