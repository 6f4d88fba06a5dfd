"""Images in grey and colour: resampled, zoomed and rotated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import images, reference
from clvol.base.errors import ClvolError
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.volume.volume import Volume
from tests.cases import BAD_COUNTS, BAD_DATA, BAD_FILTERS, BAD_NUMBERS, every

RNG = np.random.default_rng(0)
COLOUR = RNG.integers(0, 256, (9, 12, 3)).astype(np.uint8)
GREY = RNG.normal(size=(9, 12)).astype(np.float32)


@pytest.mark.parametrize("name", ["bspline3", "linear", "hybrid", "catmull-rom"])
def test_channels_are_resampled_independently(device: Device, name: str) -> None:
    got = images.resample(COLOUR, (5, 30), name, "reflect", device=device)
    assert (got.shape, got.dtype) == ((5, 30, 3), np.uint8)
    for channel in range(3):
        wanted = reference.resample(COLOUR[..., channel], (5, 30), filter=name, boundary="reflect").data
        assert np.abs(got[..., channel] - np.clip(wanted, 0, 255)).max() < 0.5 + 1e-3
    alone = images.resample(GREY, (5, 30), name, device=device)
    np.testing.assert_array_equal(alone, clvol.resample(GREY, (5, 30), filter=name, device=device).data)
    np.testing.assert_array_equal(images.resample(GREY[..., None], (5, 30), name, device=device)[..., 0], alone)


def test_zoom_keeps_the_edges_where_they_are(device: Device) -> None:
    np.testing.assert_array_equal(images.zoom(COLOUR, 2, "nearest", device=device), COLOUR.repeat(2, 0).repeat(2, 1))
    assert images.zoom(GREY, (0.5, 1.5), device=device).shape == (4, 18)
    assert images.zoom(GREY, 0.01, device=device).shape == (1, 1)
    np.testing.assert_allclose(images.zoom(GREY, 3, device=device)[1::3, 1::3], GREY, atol=1e-5)


@pytest.mark.parametrize("turns", range(-4, 5))
def test_quarter_turns_match_numpy(device: Device, turns: int) -> None:
    wanted = np.rot90(COLOUR, turns)
    got = images.rotate(COLOUR, 90 * turns, shape=wanted.shape[:2], device=device)
    np.testing.assert_array_equal(got, wanted)


def test_rotation_is_counter_clockwise_about_the_centre(device: Device) -> None:
    y, x = np.meshgrid(np.arange(41) - 20.0, np.arange(51) - 25.0, indexing="ij")

    def blob(at: tuple[float, float]) -> np.ndarray:
        return np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 18).astype(np.float32)

    angle = np.radians(30)
    turned = (10 * np.cos(angle), -10 * np.sin(angle))  # up is where rows are fewer
    np.testing.assert_allclose(images.rotate(blob((10, 0)), 30, device=device), blob(turned), atol=2e-3)
    # twice as large, cut to a smaller picture
    got = images.rotate(blob((5, 0)), 30, zoom=2, shape=(21, 31), device=device)
    larger = np.exp(-((x - turned[0]) ** 2 + (y - turned[1]) ** 2) / 72)[10:31, 10:41]
    np.testing.assert_allclose(got, larger, atol=2e-3)


def test_outside_is_filled_or_extended(device: Device) -> None:
    ones = np.ones((5, 5, 4), np.uint8)
    assert images.rotate(ones, 45, device=device)[0, 0].tolist() == [0, 0, 0, 0]
    assert images.rotate(ones, 45, fill=7, device=device)[0, 0].tolist() == [7, 7, 7, 7]
    assert (images.rotate(ones, 45, fill=None, device=device) == 1).all()
    assert np.isnan(images.rotate(GREY, 45, fill=np.nan, device=device)[0, 0])


def test_integers_are_rounded_and_do_not_wrap(device: Device) -> None:
    step = np.repeat([[0, 0, 0, 255, 255, 255]], 6, 0)
    for kind in (np.uint8, np.int16, np.float64, bool):
        image = (step > 0) if kind is bool else step.astype(kind)
        got = images.zoom(image, 4, device=device)
        assert got.dtype == kind
        if kind is np.int16:
            assert got.min() < 0 < 255 < got.max()  # the overshoot of an interpolating spline
        elif kind is not np.float64:
            assert (got.min(), got.max()) == (0, image.max())
            assert np.abs(np.diff(got[0].astype(int))).max() < 100  # overshoot past 0 or 255 is clipped
    least = np.array([[-128, -128, 127, 127]], np.int8)
    assert images.zoom(least, 8, device=device).min() == -128
    for wide in (np.int64, np.uint64):
        most = np.full((3, 3), np.iinfo(wide).max, wide)
        assert images.zoom(most, 2, device=device).min() > 2**62


def test_small_images(device: Device) -> None:
    assert images.rotate([[3.0]], 33, device=device).tolist() == [[3.0]]
    assert images.resample([[1, 1]], (3, 3), "bspline5", device=device).tolist() == [[1] * 3] * 3


@pytest.mark.parametrize(
    "call",
    [
        lambda: images.resample(np.ones((3, 3, 5)), (2, 2)),
        lambda: images.resample(np.ones((0, 3)), (2, 2)),
        lambda: images.resample([[np.nan]], (2, 2)),
        lambda: images.resample(GREY, (2, 2, 2)),
        lambda: images.resample(GREY, 2),
        lambda: images.resample(GREY, (0, 2)),
        lambda: images.resample(GREY, (2.5, 2)),
        lambda: images.zoom(GREY, 1e9),
        lambda: images.zoom(GREY, 1e308),
        lambda: images.zoom(GREY, (1e9, 1.0)),
        lambda: images.resample(GREY, (10**9, 10**9)),
        lambda: images.resample(GREY, (10**30, 1)),
        lambda: images.zoom(GREY, 0),
        lambda: images.zoom(GREY, (1, 2, 3)),
        lambda: images.rotate(GREY, 1, zoom=0),
        lambda: images.rotate(COLOUR, 1, fill=np.nan),
        lambda: images.rotate(GREY, 1, shape=3),
        lambda: images.resample(Volume(np.ones((5, 5, 5))), (2, 2)),
    ],
)
def test_bad_input_is_rejected(call: Any) -> None:
    with pytest.raises(ClvolError):
        call()


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        image=(lambda v: images.resample(v, (2, 2)), BAD_DATA),
        filter=(lambda v: images.resample(GREY, (2, 2), v), BAD_FILTERS),
        height=(lambda v: images.resample(GREY, (v, 2)), BAD_COUNTS),
        zoom=(lambda v: images.zoom(GREY, v), (0, -1, *(v for v in BAD_NUMBERS if np.ndim(v) == 0))),
        angle=(lambda v: images.rotate(GREY, v), BAD_NUMBERS),
        rotated=(lambda v: images.rotate(GREY, 1, zoom=v), (0, -1, *BAD_NUMBERS)),
        fill=(lambda v: images.rotate(COLOUR, 1, fill=v), [v for v in BAD_NUMBERS if v is not None and np.ndim(v) == 0]),
    ),
)
def test_bad_values_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(ClvolError):
        call(bad)


@pytest.mark.parametrize("kind", [np.uint8, np.int64, np.float32])
@pytest.mark.parametrize("rule", ["nearest", "constant(9)", "grid-constant(100)", "overlap"])
def test_every_rule_of_scipy_for_every_type(device: Device, rule: str, kind: type) -> None:
    """Including wide integers, which are computed in double precision about their mean."""
    offset = 10**12 if kind is np.int64 else 0
    image = RNG.integers(0, 255, (9, 12)).astype(kind)
    moved = as_boundary(rule)
    moved = replace(moved, cval=moved.cval + offset)
    got = images.rotate(image + kind(offset), 30, boundary=moved, fill=None, device=device) - kind(offset)
    turn = np.radians(30)
    y, x = np.indices(image.shape)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    at = (np.stack([x, y], -1) - (5.5, 4)) @ matrix.T + (5.5, 4)
    wanted = reference.sample(image.astype(float), at, boundary=rule)
    low, high = (0, 255) if kind is np.uint8 else (-np.inf, np.inf)
    assert np.abs(got - np.clip(wanted, low, high)).max() < (1e-3 if kind is np.float32 else 0.5 + 1e-3)


def test_the_value_outside_is_finite_for_integers() -> None:
    with pytest.raises(ClvolError, match="value of the boundary"):
        images.zoom(COLOUR, 2, boundary="constant(nan)")
