"""Background values, the automatic isovalue, and display windows of projections."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clvol.scene.preset import automatic
from clvol.scene.transfer import TransferFunction
from clvol.volume import histogram
from clvol.volume.histogram import clims_of, isovalue_of, label_numbers, matter_of
from clvol.volume.volume import Volume

RNG = np.random.default_rng(1)
SHAPE = (24, 24, 24)
Z, Y, X = np.indices(SHAPE)
FAR = np.hypot(np.hypot(X - 11.5, Y - 11.5), Z - 11.5)
BALL, CORE = FAR < 9, FAR < 5

OUTSIDE: dict[str, tuple[NDArray[Any], float]] = {
    "zeros about a ball": (np.where(BALL, 100 + 20 * CORE + RNG.normal(0, 3, SHAPE), 0), 0.0),
    "another value": (np.where(BALL, 100 + 20 * CORE + RNG.normal(0, 3, SHAPE), -37.5), -37.5),
    "white about dark": (np.where(BALL, 100 - 20 * CORE + RNG.normal(0, 3, SHAPE), 255), 255.0),
    "a thresholded map": (np.where(np.abs(t := RNG.normal(0, 2, SHAPE)) > 2.3, t, 0), 0.0),
    "a masked map": (np.where(BALL, RNG.normal(0, 1, SHAPE), 0), 0.0),
    "cut off at both ends": (np.clip(np.where(BALL, 150 + 200 * CORE, -20) + RNG.normal(0, 10, SHAPE), 0, 255).round(), 0.0),
    "two values": (np.where(BALL, 7, 3), 3.0),
    "mostly matter": (np.where(FAR < 18, 5, 2), 2.0),
}


@pytest.mark.parametrize("case", OUTSIDE)
def test_the_exact_background_is_invisible(case: str) -> None:
    data, background = OUTSIDE[case]
    volume = Volume(data)
    assert matter_of(volume).ground == background
    for clim in (None, tuple(np.quantile(data, (0.0, 0.9)) - (10, 0))):
        assert TransferFunction(*automatic(volume, clim))(background)[3] == 0, clim
    assert TransferFunction.automatic(volume)(data[BALL])[..., 3].max() > 0.3
    assert isovalue_of(volume)[0] != background


def test_measured_values_are_not_exact_background() -> None:
    """Peaks of few integers are common, but so are their neighbours; clipped values lie inside."""
    narrow = (np.where(BALL, 120, 10) + RNG.normal(0, 2, SHAPE)).astype(np.uint8)
    assert matter_of(Volume(narrow)).ground is None
    bright = np.minimum(np.where(CORE, 300, np.where(BALL, 150, 30)) + RNG.normal(0, 8, SHAPE), 255)
    assert matter_of(Volume(bright)).ground is None
    assert matter_of(Volume(bright)).sign == 1


def test_noise_of_air_is_invisible() -> None:
    data = np.where(BALL, 100, 20) + RNG.normal(0, 5, SHAPE)
    data[0, 0, 0] = -5000  # a single voxel is no evidence
    seen = TransferFunction.automatic(data)(data)[..., 3]
    assert (seen[~BALL] > 0).mean() < 0.01
    assert (seen[BALL] > 0).mean() > 0.99


@pytest.mark.parametrize("kind", ["white", "magnitude"])
def test_vessels_are_the_matter_of_noise_that_fills_a_volume(kind: str) -> None:
    vessel, rng = np.hypot(X - 8, Y - 6 - Z / 4) < 1.5, np.random.default_rng(3)
    real, other = 60.0 + 160 * vessel + rng.normal(0, 20, SHAPE), rng.normal(0, 20, SHAPE)
    found = matter_of(Volume(np.hypot(real, other) if kind == "magnitude" else real))
    assert 110 < found.isovalue < 150
    assert found.value(found.foot) > 90
    for plain in (60 + other, 60 + other + 60 * BALL, 60 + other / 20 + 160 * vessel):  # only noise; much matter; without noise
        assert "fills" not in matter_of(Volume(plain)).reason


def test_a_bright_background_is_recognised_at_the_faces() -> None:
    data = np.where(BALL, 80, 200) + RNG.normal(0, 8, SHAPE)
    assert matter_of(Volume(data)).sign == -1
    seen = TransferFunction.automatic(data)(data)[..., 3]
    assert (seen[~BALL] > 0).mean() < 0.01
    assert (seen[BALL] > 0).mean() > 0.99
    assert matter_of(Volume(data[6:18, 6:18, 6:18])).sign == 1  # the background is unknown


def test_padding_below_air_does_not_hide_air_as_background() -> None:
    """In CT, the padding around the field of view has a value below air, which is background too."""
    data = np.where(BALL, 40.0, -1000.0) + RNG.normal(0, 20, SHAPE)
    data[:, np.hypot(X, Y)[0] < 12] = -2000
    volume = Volume(data.round())
    assert -800 < isovalue_of(volume)[0] < -100
    assert (TransferFunction.automatic(volume)([-2000, -1000])[:, 3] == 0).all()


def test_signed_data_get_opacity_on_both_sides() -> None:
    for data in (OUTSIDE["a thresholded map"][0], OUTSIDE["a masked map"][0], RNG.normal(0, 1, SHAPE)):
        assert matter_of(Volume(data)).signed
        most = float(np.abs(data).max())
        both = TransferFunction.automatic(data)([-most, most])
        np.testing.assert_allclose(both[:, 3], both[0, 3])
        assert both[0, 3] > 0.5
        assert both[0, 2] > both[0, 0]  # blue below
        assert both[1, 0] > both[1, 2]  # red above
    for data in (RNG.exponential(1, SHAPE), RNG.uniform(-1, 1, SHAPE), np.where(BALL, RNG.normal(50, 25, SHAPE), 0)):
        assert not matter_of(Volume(data)).signed


STEPS: dict[str, tuple[NDArray[Any], float, float]] = {  # samples, and between what the isovalue lies
    "two classes inside": (np.where(BALL, 100 + 60 * CORE + RNG.normal(0, 3, SHAPE), 0), 110, 150),
    "one class, thresholded": (np.where((one := np.where(BALL, 60, 5) + RNG.normal(0, 12, SHAPE)) > 28, one, 0), 28, 60),
    "one even value": (np.where(BALL, 100 + RNG.normal(0, 2, SHAPE), 0), 49, 51),
    "two values": (np.where(BALL, 7.0, 3.0), 5, 5),
    "signed": (OUTSIDE["a thresholded map"][0], 2.3, 4),
    "no step": (np.where(BALL, 100.0, 10.0) + RNG.normal(0, 5, SHAPE), 30, 80),
}


@pytest.mark.parametrize("case", STEPS)
def test_the_isovalue_is_not_within_a_masks_step(case: str) -> None:
    data, low, high = STEPS[case]
    value, reason = isovalue_of(data)
    assert low <= value <= high
    words = {"one even value": "halfway", "two values": "halfway", "no step": "Otsu"}
    assert words.get(case, "beyond the mask's step, 0 to ") in reason


def test_units_do_not_matter() -> None:
    data = STEPS["two classes inside"][0]
    value, _ = isovalue_of(data)
    assert isovalue_of(1024 * data)[0] == pytest.approx(1024 * value)
    assert isovalue_of(-data)[0] == pytest.approx(-value)
    assert isovalue_of(data + 1000)[0] == pytest.approx(value + 1000)


def test_constant_samples() -> None:
    assert isovalue_of(np.full((3, 3, 3), 4.0)) == (4.0, "the only value")
    assert isovalue_of(np.zeros((3, 3, 3), bool))[0] == 0.0


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16])
def test_labels_are_separated_from_their_background(dtype: Any) -> None:
    data = np.where(CORE, 2, np.where(BALL, 1, 0)).astype(dtype)
    assert isovalue_of(Volume(data, labels=True))[0] == 0.5
    assert isovalue_of(Volume(data + dtype(5), labels=True))[0] == 5.5  # without 0 the commonest is the background


def test_clims_are_those_of_ray_maxima() -> None:
    """Maxima of noise around an object are black, and a single bright voxel does not set white."""
    data = np.where(BALL, 100, 20) + 20 * CORE + RNG.normal(0, 3, SHAPE)
    data[12, 12, 12] = 1e5
    clims = clims_of(Volume(data))
    assert 20 < clims["max"][0] < 40
    assert 100 < clims["max"][1] < 150
    assert clims["mean"][1] < clims["max"][1]
    for one in (Volume(np.where(CORE, 1, 0)), Volume(np.where(Z + Y + X == 0, 0, 1)), Volume(np.where(Z + Y + X == 0, 1, 0))):
        assert all(0 <= black < white <= 1 for black, white in clims_of(one).values())
    assert clims_of(Volume(np.ones((3, 3, 3)))) == dict.fromkeys(("max", "min", "mean"), (1.0, 1.0))


@pytest.mark.parametrize(("dtype", "first"), [("int8", -128), ("int64", 2**60 + 129), ("uint64", 2**63 + 3)])
def test_labels_of_any_width_are_counted(dtype: str, first: int) -> None:
    data = np.full((4, 4, 4), first, dtype)
    data[1:3, 1:3] += np.dtype(dtype).type(100)
    background, numbers = label_numbers(Volume(data, labels=True))
    assert background == float(first)
    np.testing.assert_array_equal(np.unique(numbers), np.unique(np.array([first, first + 100], np.float64)))


def test_analysing_a_volume_does_not_copy_it() -> None:
    """Including arrays in Fortran order, as from NIfTI and MATLAB files."""
    samples = np.random.default_rng(0).integers(0, 255, (320, 300, 280), np.uint8)
    peaks = {}
    for layout in (samples, np.asfortranarray(samples)):
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        labels, matter = Volume(layout).is_labels, matter_of(Volume(layout))
        peaks[layout.flags.c_contiguous] = tracemalloc.get_traced_memory()[1] - before, labels, matter
        tracemalloc.stop()
    assert peaks[True][1:] == peaks[False][1:]
    assert peaks[False][0] < peaks[True][0] + samples.nbytes / 4


@pytest.mark.parametrize("dtype", ["uint8", "int16", ">i2", "float16", "float32", ">f8", "longdouble"])
def test_sorting_and_counting_match_numpy(dtype: str) -> None:
    """In the data's own dtype, for signed data and bright backgrounds: `numpy.unique` of float64 is the truth."""
    chance = np.random.default_rng(5)
    data = (50 * chance.random((20, 20, 20))).astype(dtype)
    found = histogram._sorted(histogram._some(Volume(data)))
    assert np.array_equal(found, np.sort(data.astype(np.float64), axis=None))
    distinct = histogram._distinct(found.astype(np.float64))
    for got, expected in zip(distinct, np.unique(data.astype(np.float64), return_counts=True), strict=True):
        assert np.array_equal(got, expected)
    assert [part.size for part in histogram._distinct(np.empty(0))] == [0, 0]
