"""`resize`: closed forms, accepted and rejected arguments. tests/outside/ compares it with scikit-image."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import DataError, OptionError, reference
from clvol.device import Device


def test_a_plane_stays_a_plane(device: Device) -> None:
    """Sample j of m lies at (j + 1/2) n / m - 1/2; "wrap" bends a plane near its ends, so only the middle is compared."""
    y, x = np.mgrid[:40, :60]
    got = clvol.resize(3.0 * y - x, (80, 90), order=3, clip=False, device=device)
    wanted = 3 * ((np.arange(80)[:, None] + 0.5) / 2 - 0.5) - ((np.arange(90) + 0.5) * 60 / 90 - 0.5)
    np.testing.assert_allclose(got[30:50, 30:60], wanted[30:50, 30:60], atol=1e-9)


@pytest.mark.parametrize("kind", ["f4", ">f4", "f8", "u1", ">u2", "i4"])
def test_cubic_values_match_the_reference(kind: str, device: Device) -> None:
    data = np.random.default_rng(0).integers(0, 200, (7, 9, 11)).astype(kind)
    data.flags.writeable = False
    got = clvol.resize(data, (10, 9, 23), 3, mode="symmetric", clip=False, preserve_range=True, anti_aliasing=False, device=device)
    axes = [(np.arange(m) + 0.5) * n / m - 0.5 for n, m in zip(data.shape, (10, 9, 23), strict=True)]
    assert got.dtype == ("f4" if kind[-2:] == "f4" else "f8")
    np.testing.assert_allclose(got, reference.lattice(data, axes, "bspline3", "reflect"), atol=4e-4)


def test_least_squares_matches_the_reference(device: Device) -> None:
    data = np.random.default_rng(0).random((20, 33))
    got = clvol.resize(data, (7, 40), 3, mode="symmetric", clip=False, anti_aliasing="least-squares", device=device)
    few = reference.nearest_spline(data, [((20 / 7 - 1) / 2, 20 / 7, 7), None], "bspline3", "reflect")
    wanted = reference.lattice(few, [np.arange(7), (np.arange(40) + 0.5) * 33 / 40 - 0.5], "bspline3", "reflect")
    np.testing.assert_allclose(got, wanted, atol=1e-9)
    clipped = clvol.resize(data, (7, 40), 3, mode="symmetric", anti_aliasing="least-squares", device=device)
    np.testing.assert_allclose(clipped, np.clip(wanted, data.min(), data.max()), atol=1e-9)


@pytest.mark.parametrize("mode", ["edge", "constant", "reflect", "wrap"])
def test_least_squares_extends_samples_by_the_mode(mode: str, device: Device) -> None:
    """The same as in the middle of an array padded by hand."""
    data, m, pad = np.random.default_rng(3).random(24), 8, 120
    options: dict[str, Any] = {"constant_values": 0.5} if mode == "constant" else {}
    long = np.pad(data, pad, mode=mode, **options)  # type: ignore[call-overload]
    took: dict[str, Any] = {"order": 3, "clip": False, "anti_aliasing": "least-squares", "device": device}
    got = clvol.resize(data, (m,), mode=mode, cval=0.5, **took)
    np.testing.assert_allclose(got, clvol.resize(long, (m + 2 * pad // 3,), **took)[pad // 3 : -pad // 3], atol=1e-9)


def test_order_0_with_least_squares_is_the_mean_of_blocks(device: Device) -> None:
    data = np.random.default_rng(0).integers(0, 256, (12, 9)).astype(np.uint8)
    got = clvol.resize(data, (4, 3), order=0, anti_aliasing="least-squares", device=device)
    assert got.dtype == np.uint8
    mean = data.reshape(4, 3, 3, 3).mean((1, 3))
    np.testing.assert_array_equal(got, np.floor(mean + 0.5))


def test_integers_are_rounded_and_kept_within_their_type(device: Device) -> None:
    data = np.zeros((16, 16), np.uint8)
    data[::2] = 255
    for chosen in (False, True, "least-squares"):
        got = clvol.resize(data, (7, 7), order=0, anti_aliasing=chosen, device=device)  # type: ignore[arg-type]
        assert got.dtype == np.uint8
    edge = clvol.resize(np.repeat([0, 255], 12).astype(np.uint8), (8,), 3, clip=False, anti_aliasing="least-squares", device=device)
    assert edge.min() < -0.02  # the spline overshoots, as it does
    assert edge.max() > 1.02


def test_channels_and_batches_are_not_resized(device: Device) -> None:
    data = np.random.default_rng(0).random((6, 5, 4, 3), np.float32)
    for axis in range(4):
        shape = [8, 7, 9]
        got = clvol.resize(data, shape, order=3, channel_axis=axis, device=device)
        assert got.shape == tuple(np.insert(shape, axis, data.shape[axis]))
        one = clvol.resize(np.take(data, 1, axis), shape, order=3, clip=False, device=device)
        every = clvol.resize(data, shape, order=3, clip=False, channel_axis=axis - 4, device=device)
        np.testing.assert_allclose(np.take(every, 1, axis), one, atol=1e-6)


def test_more_than_three_axes_are_resized_in_turn(device: Device) -> None:
    random = np.random.default_rng(0)
    factors = [random.random(n) for n in (3, 4, 5, 6, 2)]
    data = np.einsum("a,b,c,d,e->abcde", *factors)
    got = clvol.resize(data, (5, 3, 6, 7, 4), order=3, mode="symmetric", clip=False, anti_aliasing=False, device=device)
    each = [
        reference.lattice(f, [(np.arange(m) + 0.5) * f.size / m - 0.5], "bspline3", "reflect")
        for f, m in zip(factors, got.shape, strict=True)
    ]
    np.testing.assert_allclose(got, np.einsum("a,b,c,d,e->abcde", *each), atol=1e-12)


@pytest.mark.parametrize("order", range(6))
def test_single_samples_are_constants(order: int, device: Device) -> None:
    np.testing.assert_allclose(clvol.resize([[2.0]], (3, 4), order, device=device), np.full((3, 4), 2.0), atol=1e-12)
    for chosen in (True, "least-squares"):
        got = clvol.resize(np.full((5, 6), 2.0), (1, 1), order, anti_aliasing=chosen, device=device)  # type: ignore[arg-type]
        np.testing.assert_allclose(got, [[2.0]], atol=1e-12)


def test_nan_is_rejected_where_it_would_spread(device: Device) -> None:
    data = np.ones((6, 6))
    data[1, 4] = np.nan
    for order, chosen in ((3, False), (2, True), (0, "least-squares"), (1, "least-squares")):
        with pytest.raises(DataError, match=r"1 NaN or infinite, the first at index \[1, 4\]"):
            clvol.resize(data, (3, 3), order, anti_aliasing=chosen, device=device)  # type: ignore[arg-type]
    got = clvol.resize(data, (12, 12), 1, device=device)
    assert np.isnan(got).sum() == 25  # under "reflect" both edges are made with it too
    assert np.nanmax(got) == np.nanmin(got) == 1


def test_infinities_too(device: Device) -> None:
    with pytest.raises(DataError, match="first at index"):
        clvol.resize([1.0, np.inf, 2.0], (5,), 3, device=device)


def test_progress_ends_with_all(device: Device) -> None:
    told: list[float] = []
    clvol.resize(np.ones((8, 8)), (4, 4), anti_aliasing="least-squares", device=device, progress=told.append)
    assert told[-1] == 1
    assert told == sorted(told)


@pytest.mark.parametrize("chosen", [False, "gaussian", "least-squares"])
def test_integers_are_not_copied_to_float64(chosen: Any, device: Device) -> None:
    """In float64 the image alone would take 64 MB; in float32, which the Gaussian needs, 32."""
    data = np.zeros((200, 200, 200), np.uint8)
    options: dict[str, Any] = {"order": 3, "anti_aliasing": chosen, "device": device}
    clvol.resize(data[:20, :20, :20].copy(), (10, 10, 10), **options)  # kernels and tables
    tracemalloc.start()
    try:
        got = clvol.resize(data, (100, 100, 100), **options)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < got.nbytes + {False: 8, "gaussian": 60, "least-squares": 34}[chosen] * 2**20


IMAGE = np.ones((6, 5))
REFUSED: list[tuple[str, dict[str, Any]]] = [
    ("output_shape must have 2 numbers", {"output_shape": ()}),
    ("whole number, at least 1", {"output_shape": (0, 4)}),
    ("whole number, at least 1", {"output_shape": (2.5, 4)}),
    ("output_shape must be whole numbers", {"output_shape": "ab"}),
    ("output_shape must be whole numbers", {"output_shape": 4}),
    ("order must be a whole number", {"order": 6}),
    ("order must be a whole number", {"order": -1}),
    ("order must be a whole number", {"order": 1.0}),
    ("mode must be one of constant, edge", {"mode": "mirror"}),
    ("precision must be one of", {"precision": "half"}),
    ("anti_aliasing must be one of", {"anti_aliasing": "box"}),
    ("anti_aliasing_sigma must be", {"anti_aliasing_sigma": -1.0, "anti_aliasing": True}),
    ("anti_aliasing_sigma must be", {"anti_aliasing_sigma": (1.0, 2.0, 3.0), "anti_aliasing": True}),
    ("anti_aliasing_sigma is for the Gaussian", {"anti_aliasing_sigma": 1.0, "anti_aliasing": "least-squares"}),
    ("channel_axis must be a whole number", {"channel_axis": 2}),
    ("1 numbers beside a channel axis", {"channel_axis": 1}),
]


@pytest.mark.parametrize(("rule", "options"), REFUSED, ids=[f"{rule}: {options}" for rule, options in REFUSED])
def test_bad_arguments_are_rejected(rule: str, options: dict[str, Any], device: Device) -> None:
    with pytest.raises(OptionError, match=rule):
        clvol.resize(IMAGE, **{"output_shape": (3, 3), "device": device} | options)


@pytest.mark.parametrize("image", [np.empty((0, 3)), 3.0, [["a"]], [1j], np.array([None])], ids=repr)
def test_nonnumeric_input_is_rejected(image: Any, device: Device) -> None:
    with pytest.raises(DataError):
        clvol.resize(image, (3, 3), device=device)


@pytest.mark.parametrize(("option", "wrong"), [("cval", "a"), ("cval", [1, 2]), ("anti_aliasing_sigma", "a"), ("cval", 1j)])
def test_options_of_the_wrong_type(option: str, wrong: object) -> None:
    with pytest.raises(OptionError, match=rf"{option} must be .*; got"):
        clvol.resize(np.ones((4, 4)), (2, 2), anti_aliasing=True, mode="constant", **{option: wrong})  # type: ignore[arg-type]
