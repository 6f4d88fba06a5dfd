"""Omitted slices, and slices rotated in a full circle: compared with SciPy, independently of clvol."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from clvol import Volume
from clvol.analysis import EXACT_SINC, leave_out, rotations
from clvol.base.errors import ClvolError, DataError, OptionError
from tests.cases import BAD_FILTER_LISTS, BAD_FILTERS


def smooth(shape: tuple[int, ...], seed: int = 0, sigma: float = 2.0) -> np.ndarray:
    data = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma, mode="mirror")
    return np.asarray(data / data.std())


# -- left out ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "order"), [("linear", 1), ("bspline2", 2), ("bspline3", 3), ("bspline5", 5)])
def test_predictions_of_omitted_slices_match_scipy(name: str, order: int) -> None:
    data = smooth((24, 26, 30))
    [row] = leave_out(data, [name], sigma=0)
    errors = []
    for first in (0, 1):
        kept = data[first::2]
        places = np.arange(kept.shape[0] - 1) + 0.5
        margin = min(4, (kept.shape[0] - 1) / 4)
        places = places[(places >= margin) & (places <= kept.shape[0] - 1 - margin)]
        at = np.meshgrid(places, np.arange(26), np.arange(30), indexing="ij")
        drawn = ndimage.map_coordinates(kept, at, order=order, mode="mirror")
        errors.append((drawn - data[(first + 2 * places).astype(int)]).ravel())
    assert row.z == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)), rel=1e-6)


def test_noise_keeps_the_order_and_is_subtracted() -> None:
    clean = smooth((40, 40, 40))
    noisy = clean + np.random.default_rng(1).normal(0, 0.3, clean.shape)
    names = ["nearest", "linear", "bspline3", "bspline3(0.05)"]
    truth, seen = leave_out(clean, names, sigma=0), leave_out(noisy, names, sigma=0.3)
    every = leave_out(noisy, names, sigma=0)
    for row, raw in zip(seen, every, strict=True):
        for axis in "xyz":
            assert getattr(row, axis) ** 2 == pytest.approx(getattr(raw, axis) ** 2 - 0.09, rel=1e-9)
    # without noise the interpolating spline is nearest to what was left out, with noise the smoothing one
    assert min(truth, key=lambda row: row.z or 0).filter == "bspline3"
    assert min(seen, key=lambda row: row.z or 0).filter == "bspline3(0.05)"


def test_coarse_slices_raise_the_error_along_their_axis() -> None:
    data = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(40, 40, 40)), (1, 3, 3), mode="mirror")
    [row] = leave_out(Volume(data, (1, 1, 3)), ["bspline3"], sigma=0)
    assert row.z is not None
    assert row.x is not None
    assert row.z > 20 * row.x
    [exact] = leave_out(data, [EXACT_SINC], sigma=0)
    assert exact.z == pytest.approx(row.z, rel=0.2)


def test_no_slices_of_short_axes_are_omitted() -> None:
    data = smooth((7, 8, 20))
    [row] = leave_out(data, ["linear"], sigma=0)
    assert row.z is None
    assert row.y is not None
    [row] = leave_out(data[0], ["linear"], sigma=0)
    assert row.z is None
    assert row.x is not None


# -- turned --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "order"), [("linear", 1), ("bspline3", 3), ("bspline5", 5)])
def test_rotation_matches_scipy(name: str, order: int) -> None:
    image = smooth((41, 41), sigma=1.5)
    [row] = table = rotations(image, [name])
    now = image
    for _ in range(9):
        now = ndimage.rotate(now, 40, reshape=False, order=order, mode="mirror")
    y, x = np.indices(image.shape) - 20.0
    disc = x**2 + y**2 <= (20 - 8) ** 2
    assert (table.turns, table.pixels) == (9, int(disc.sum()))
    assert row.rms == pytest.approx(np.sqrt(np.mean((now - image)[disc] ** 2)), rel=1e-6)
    assert row.maximum == pytest.approx(np.abs(now - image)[disc].max(), rel=1e-6)


def test_the_filter_that_loses_least_rotates_best() -> None:
    table = rotations(smooth((8, 60, 64), sigma=1.2), ["nearest", "linear", "mitchell", "bspline3", "bspline5"])
    errors = [row.rms for row in table]
    assert sorted(errors[1:], reverse=True) == errors[1:]
    assert errors[3] < errors[1] / 3
    assert all(row.ssim is not None for row in table)


def test_the_circle_has_the_requested_number_of_rotations() -> None:
    image = smooth((40, 44))
    few, many = (rotations(image, ["linear"], turns)[0].rms for turns in (3, 18))
    assert many > 1.5 * few
    [quarter] = rotations(smooth((41, 41)), ["bspline3"], 4)  # each pixel falls on a pixel
    assert quarter.maximum < 1e-9


def test_only_the_middle_of_a_large_image_is_rotated() -> None:
    image = smooth((90, 70))
    table = rotations(image, ["linear"], max_pixels=2500)
    assert table.image.data.size <= 2500
    np.testing.assert_array_equal(table.image.data, rotations(np.stack([image] * 3), ["linear"], max_pixels=2500).image.data)


def test_a_slice_is_rotated_with_the_smoothing_along_x_and_y() -> None:
    data = smooth((9, 60, 64))
    whole, plain = rotations(data, ["bspline3(0.1,0.3,5)"]), rotations(data[4], ["bspline3(0.1,0.3)"])
    assert whole[0].filter == "bspline3(0.1,0.3,5)"
    assert (whole[0].rms, whole[0].ssim) == (plain[0].rms, plain[0].ssim)


BAD: list[tuple[Any, dict[str, Any], type[ClvolError], str]] = [
    *(
        (call, {"filters": bad}, OptionError, "filters must be one or more names")
        for call in (leave_out, rotations)
        for bad in BAD_FILTER_LISTS
    ),
    *((call, {"filters": [bad]}, OptionError, "filter") for call in (leave_out, rotations) for bad in BAD_FILTERS),
    *(
        (
            call,
            {"filters": [EXACT_SINC], "boundary": "zero"},
            OptionError,
            "must be mirror, reflect or wrap for 'exact-sinc'; got 'zero'",
        )
        for call in (leave_out, rotations)
    ),
    *((call, {"margin": -1}, OptionError, "margin must be") for call in (leave_out, rotations)),
    (leave_out, {"sigma": -1}, OptionError, "sigma must be"),
    (rotations, {"turns": 1}, OptionError, "turns must be a whole number, at least 2 and at most 360"),
    (rotations, {"margin": 20}, DataError, "wider than twice the margin of 20 pixels; got shape"),
]


@pytest.mark.parametrize(("call", "arguments", "error", "message"), BAD)
def test_bad_input_is_rejected(call: Any, arguments: dict[str, Any], error: type[ClvolError], message: str) -> None:
    with pytest.raises(error, match=message):
        call(
            **{
                "filters": ["linear"],
                **({"volume": smooth((20, 20))} if call is leave_out else {"source": smooth((20, 20))}),
                **arguments,
            }
        )
