"""`zoom` to fewer samples: after a Gaussian, and by least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage as scipy_ndimage

from clvol import OptionError, ndimage, reference
from clvol.device import Device


def sigma(old: tuple[int, ...], new: tuple[int, ...]) -> list[float]:
    return [max(0.0, (n / m - 1) / 2) for n, m in zip(old, new, strict=True)]


@pytest.mark.parametrize("mode", ["mirror", "reflect", "grid-wrap", "nearest", "grid-constant"])
@pytest.mark.parametrize("chosen", [True, "gaussian"])
def test_the_gaussian_matches_scipy(chosen: Any, mode: str, device: Device) -> None:
    data = np.random.default_rng(0).random((24, 15, 20))
    factors = (1 / 4, 1, 1.5)
    soft = scipy_ndimage.gaussian_filter(data, sigma(data.shape, (6, 15, 30)), mode=mode, cval=0.5)
    wanted = scipy_ndimage.zoom(soft, factors, order=3, mode=mode, cval=0.5, grid_mode=True)
    got = ndimage.zoom(data, factors, order=3, mode=mode, cval=0.5, grid_mode=True, anti_aliasing=chosen, device=device)
    np.testing.assert_allclose(got, wanted, atol=2e-7 if mode in ("nearest", "grid-constant") else 1e-9)  # SciPy pads by 12 samples


@pytest.mark.one_in(3)
@pytest.mark.parametrize("order", [0, 1, 3, 5])
@pytest.mark.parametrize(
    ("mode", "boundary", "grid"), [("mirror", "mirror", False), ("reflect", "reflect", True), ("grid-wrap", "wrap", True)]
)
def test_least_squares_matches_the_reference(order: int, mode: str, boundary: str, grid: bool, device: Device) -> None:
    data = np.random.default_rng(0).random((18, 13))
    got = ndimage.zoom(data, (0.4, 0.55), order=order, mode=mode, grid_mode=grid, anti_aliasing="least-squares", device=device)
    assert got.shape == (7, 7)
    name = {0: "nearest", 1: "linear"}.get(order, f"bspline{order}")
    places = [((n / 7 - 1) / 2, n / 7, 7) if grid else (0.0, (n - 1) / 6, 7) for n in data.shape]
    np.testing.assert_allclose(got, reference.nearest_spline(data, places, name, boundary), atol=1e-7 if order == 5 else 1e-9)


def test_complex_samples_are_processed_by_parts(device: Device) -> None:
    random = np.random.default_rng(0)
    data = random.random((12, 10)) + 1j * random.random((12, 10))
    for chosen in ("gaussian", "least-squares"):
        options: dict[str, Any] = {"mode": "reflect", "anti_aliasing": chosen, "device": device}
        got = ndimage.zoom(data, 0.5, **options)
        wanted = ndimage.zoom(data.real, 0.5, **options) + 1j * ndimage.zoom(data.imag, 0.5, **options)
        np.testing.assert_allclose(got, wanted, atol=1e-14)


def test_any_number_of_axes_and_any_type(device: Device) -> None:
    data = np.random.default_rng(0).integers(0, 256, (6, 4, 6, 2, 8)).astype(np.uint8)
    got = ndimage.zoom(data, 0.5, order=0, mode="reflect", grid_mode=True, anti_aliasing="least-squares", device=device)
    means = data.reshape(3, 2, 2, 2, 3, 2, 1, 2, 4, 2).mean((1, 3, 5, 7, 9))
    np.testing.assert_array_equal(got, np.floor(means + 0.5))
    given = np.empty((3, 4), ">i2")
    made = ndimage.zoom(np.full((6, 8), 7.4), 0.5, given, mode="nearest", anti_aliasing=True, device=device)
    assert made is given
    assert (given == 7).all()


def test_without_reduction_it_has_no_effect(device: Device) -> None:
    data = np.random.default_rng(0).random((9, 8))
    plain = ndimage.zoom(data, (2, 1), mode="reflect", device=device)
    np.testing.assert_array_equal(ndimage.zoom(data, (2, 1), mode="reflect", anti_aliasing=True, device=device), plain)
    nearest = ndimage.zoom(data, (2, 1), mode="reflect", anti_aliasing="least-squares", device=device)
    np.testing.assert_allclose(nearest, plain, atol=1e-12)


def test_other_values_are_rejected(device: Device) -> None:
    with pytest.raises(OptionError, match="anti_aliasing must be one of"):
        ndimage.zoom(np.ones((4, 4)), 0.5, anti_aliasing="box", device=device)  # type: ignore[arg-type]


def test_missing_samples_are_not_local_under_least_squares(device: Device) -> None:
    data, output = np.ones((6, 6)), np.full((3, 3), 77.0)
    data[2, 3] = np.nan
    with pytest.raises(OptionError, match=r'nan must be "propagate" or "error" with least squares.*; got "local"'):
        ndimage.zoom(data, 0.5, output, anti_aliasing="least-squares", nan="local", device=device)
    for factor in (1, 0.5):
        with pytest.raises(OptionError, match="anti_aliasing must be one of"):
            ndimage.zoom(np.ones((6, 6)), factor, anti_aliasing="box", device=device)  # type: ignore[arg-type]
    assert (output == 77).all()
