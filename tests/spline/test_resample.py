"""Grids along the volume's axes, computed one axis at a time, compared with the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import reference
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import filters
from clvol.spline.field import magnify, resample
from clvol.volume.volume import Volume
from tests.cases import RULES, SMOOTHED

TOLERANCE = 2e-6  # of the greatest coefficient, those outside included; measured on PoCL: 5.4e-7
SHAPES = ((3, 4, 5), (1, 2, 9), (9, 1, 1), (1, 1, 1), (6, 19), (1, 5), (1, 1))
# Finer, coarser and wholly or partly outside, more than a block of rows; steps that fall between knots.
GRIDS = [
    ((4, 3, 5), (1.1, 0.9, 7.7), (2.0137, -40.0071, 8.0193)),
    ((2, 37, 19), (0.31, 0.37, 0.5), (2.0137, -6.0071, 5.0193)),
    ((1, 1, 2), (50.0, 3.0, 1.0), (-200.07, 12.03, 7.01)),
]


@pytest.fixture
def only_separable(monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    """Make the point kernel unavailable."""
    if device.kind != "cpu":
        pytest.skip("other devices take a grid point by point")

    def refuse(*_: object) -> None:
        raise AssertionError("point by point")

    monkeypatch.setattr("clvol.spline.resample.sample_grid", refuse)


def volume_of(shape: tuple[int, ...]) -> Volume:
    d = len(shape)
    data = np.random.default_rng(sum(shape)).normal(size=shape).astype(np.float32)
    return Volume(data, (0.7, 1.3, 2.1)[:d], (3.0, -5.0, 7.0)[:d])


def agree(got: Volume, wanted: Volume, volume: Volume, name: str, rule: str) -> None:
    largest = max(np.abs(reference.prefilter(volume.data, name, rule)).max(), abs(as_boundary(rule).cval))
    np.testing.assert_allclose(got.data, wanted.data, rtol=0, atol=TOLERANCE * largest, err_msg=f"{volume.shape} {wanted.shape}")


@pytest.mark.one_in(60)
@pytest.mark.usefixtures("only_separable")
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", [*filters(), "sinc(8)", *SMOOTHED])
def test_separable(device: Device, name: str, rule: str) -> None:
    for shape in SHAPES:
        volume, d = volume_of(shape), len(shape)
        factor = 5 if max(shape) < 6 else 3
        agree(magnify(volume, factor, name, rule, device=device), reference.magnify(volume, factor, name, rule), volume, name, rule)
        for size, spacing, origin in GRIDS:
            like = Volume(np.zeros(size[-d:]), spacing[:d], origin[:d])
            got = resample(volume, like=like, filter=name, boundary=rule, device=device)
            agree(got, reference.resample(volume, like=like, filter=name, boundary=rule), volume, name, rule)


@pytest.mark.usefixtures("only_separable")
def test_a_rotated_volume_has_its_own_axes(device: Device) -> None:
    """Grids along its axes are separable, despite rounding of its direction."""
    turned = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    data = np.random.default_rng(0).normal(size=(5, 6, 7)).astype(np.float32)
    volume = Volume(data, (0.7, 1.3, 2.1), (3.0, -5.0, 7.0), turned)
    got, wanted = (f(volume, (9, 11, 13)) for f in (resample, reference.resample))
    agree(got, wanted, volume, "bspline3", "mirror")
    assert device is not None


def test_a_sheared_grid_is_not_separable(device: Device) -> None:
    """A shear of 10⁻³ sample over the whole grid is detected."""
    volume = volume_of((3, 4, 5))
    shear = np.eye(3)
    shear[0, 1] = 1e-3
    shear /= np.linalg.norm(shear, axis=0)
    like = Volume(np.zeros((3, 4, 5)), (0.7, 1.3, 2.1), (3.0, -5.0, 7.0), shear)
    agree(resample(volume, like=like, device=device), reference.resample(volume, like=like), volume, "bspline3", "mirror")


@pytest.mark.parametrize("fill", [-3.0, np.nan])
def test_fill_matches_single_points(device: Device, fill: float) -> None:
    volume = volume_of((3, 4, 5))
    for size, spacing, origin in GRIDS:
        like = Volume(np.zeros(size), spacing, origin)
        both = []
        for evaluator in ("taps", "eight-fetch"):
            with device.limited(evaluator=evaluator):
                both.append(resample(volume, like=like, fill=fill, device=device).data)
        got, single = both
        np.testing.assert_array_equal(got == fill, single == fill)
        np.testing.assert_allclose(got, single, atol=2e-5)
    assert device is not None
