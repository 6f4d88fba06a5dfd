"""`clvol.nnunet` beside nnU-Net's own functions, and beside the formulas that they follow where it is not installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import DataError, OptionError
from clvol.device import Device
from clvol.nnunet import install, labels_from_logits, resample_to_shape

GRIDS = [  # new shape, spacing before and after, whether an axis is separate
    ((20, 30, 26), (2, 2, 2), (1, 1, 1), None),
    ((10, 24, 19), (5, 1, 1), (5, 0.7, 0.8), None),
    ((17, 11, 16), (1, 1, 1), (0.6, 1.3, 0.8), True),
]
ORDERS = [(1, 0), (3, 0), (3, 1)]


def _logits(dtype: str = "f4") -> Any:
    x = np.random.default_rng(3).standard_normal((5, 10, 15, 13))
    return sum(np.roll(x, shift, axis) for shift in range(3) for axis in (1, 2, 3)).astype(dtype)


def test_values_are_scikit_images(device: Device) -> None:
    transform = pytest.importorskip("skimage.transform")
    logits = _logits()
    got = resample_to_shape(logits, (17, 20, 26), (1, 1, 1), (1, 1, 1), device=device)
    wanted = [transform.resize(one.astype("f8"), (17, 20, 26), 3, "edge", anti_aliasing=False) for one in logits]
    np.testing.assert_allclose(got, wanted, atol=1e-6 * np.ptp(logits))
    planes = resample_to_shape(logits, (20, 20, 26), (9, 1, 1), (4, 1, 1), force_separate_z=None, device=device)
    wanted = [[transform.resize(s.astype("f8"), (20, 26), 3, "edge", anti_aliasing=False) for s in one] for one in logits]
    np.testing.assert_allclose(planes, np.repeat(wanted, 2, axis=1), atol=1e-6 * np.ptp(logits))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("grid", GRIDS)
def test_labels_of_logits_are_the_largest(grid: Any, order: tuple[int, int], device: Device) -> None:
    """Ties aside, for which the logits are in double precision."""
    shape, before, after, separate = grid
    logits, how = _logits("f8"), (*order, separate)
    labels = labels_from_logits(logits, shape, before, after, *how, device=device)
    assert labels.dtype == np.uint8
    np.testing.assert_array_equal(labels, resample_to_shape(logits, shape, before, after, False, *how, device=device).argmax(0))


def test_classes_far_below_the_largest_are_left_out_and_change_nothing(device: Device) -> None:
    """A ball in a background: most rows are not evaluated, for float16, too; the first of equal classes wins."""
    z, y, x = np.ogrid[:16, :20, :24]
    ball = 5.0 - np.sqrt((z - 6.0) ** 2 + (y - 9.0) ** 2 + (x - 11.0) ** 2)
    logits = np.stack([np.zeros_like(ball), ball, ball - 20, ball]).astype("f2")
    spacings = (1, 1, 1), (0.5, 0.5, 0.5)
    got = labels_from_logits(logits, (32, 40, 48), *spacings, 3, device=device)
    wanted = resample_to_shape(logits.astype("f4"), (32, 40, 48), *spacings, device=device).argmax(0)
    np.testing.assert_array_equal(got, wanted)
    assert np.unique(got).tolist() == [0, 1]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("grid", GRIDS)
def test_results_are_nnunets(grid: Any, order: tuple[int, int], device: Device) -> None:
    theirs = pytest.importorskip("nnunetv2.preprocessing.resampling.default_resampling").resample_data_or_seg_to_shape
    shape, before, after, separate = grid
    logits, how = _logits(), {"order": order[0], "order_z": order[1], "force_separate_z": separate}
    wanted = theirs(logits, shape, before, after, **how)
    got = resample_to_shape(logits, shape, before, after, **how, device=device)
    assert got.dtype == wanted.dtype
    np.testing.assert_allclose(got, wanted, atol=1e-6 * np.ptp(logits))
    assert (labels_from_logits(logits, shape, before, after, **how, device=device) != wanted.argmax(0)).mean() < 1e-4
    segmentation = logits.argmax(0)[None].astype(np.int8) - 1
    wanted = theirs(segmentation, shape, before, after, is_seg=True, **how)
    got = resample_to_shape(segmentation, shape, before, after, is_seg=True, **how, device=device)
    assert got.dtype == np.int8
    assert (got != wanted).mean() < 2e-3  # where indicators are equal up to rounding


def test_a_plans_file_finds_it_once_installed() -> None:
    utils = pytest.importorskip("nnunetv2.preprocessing.resampling.utils")
    path = install()
    try:
        assert utils.recursive_find_resampling_fn_by_name("clvol_resample_to_shape") is resample_to_shape
    finally:
        path.unlink()


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(DataError, match=r"four axes, \(c, x, y, z\), none empty; got float64 of shape \(2, 3\)"):
        resample_to_shape(np.zeros((2, 3)), (1, 2, 3), (1, 1, 1), (1, 1, 1))
    with pytest.raises(OptionError, match="new_shape must be three whole numbers"):
        resample_to_shape(np.zeros((1, 2, 3, 4)), (2, 3), (1, 1, 1), (1, 1, 1))
    with pytest.raises(OptionError, match="order"):
        labels_from_logits(np.zeros((1, 2, 3, 4)), (2, 3, 5), (1, 1, 1), (1, 1, 1), order=6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"current_spacing": (0, 1, 1)}, "each number of current_spacing must be a finite number, greater than 0; got 0"),
        ({"new_spacing": (1, 1)}, r"new_spacing must be three numbers; got \(1, 1\)"),
        ({"force_separate_z": "x"}, "force_separate_z must be"),
        ({"order_z": 7}, "order_z must be a whole number"),
        ({"new_shape": None}, "new_shape must be three whole numbers; got None"),
    ],
)
def test_wrong_options_are_named(options: dict[str, object], message: str) -> None:
    given = {"new_shape": (4, 4, 4), "current_spacing": (1, 1, 1), "new_spacing": (1, 1, 1)} | options
    for function in (resample_to_shape, labels_from_logits):
        with pytest.raises(OptionError, match=message):
            function(np.ones((2, 3, 3, 3), np.float32), **given)  # type: ignore[operator]
    with pytest.raises(DataError, match="none empty"):
        labels_from_logits(np.ones((0, 3, 3, 3)), (4, 4, 4), (1, 1, 1), (1, 1, 1))
