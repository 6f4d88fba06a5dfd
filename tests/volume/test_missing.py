"""Missing samples: their replacements, and the results that they affect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

import clvol
from clvol import reference
from clvol.base.errors import DataError, OptionError
from clvol.device import Device
from clvol.filter.boundary import boundaries
from clvol.filter.table import as_filter
from clvol.volume.missing import Missing, filled_smoothly, touching
from clvol.volume.volume import Volume

ROWS = ("nearest", "linear", "bspline2", "bspline3", "bspline3-approx", "bspline5", "catmull-rom", "lanczos3", "hybrid")


def noise(shape: tuple[int, ...], seed: int = 0, kind: type = np.float32) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(kind)


def holes(shape: tuple[int, ...], share: float, seed: int = 0) -> np.ndarray:
    return np.asarray(np.random.default_rng(seed).random(shape) < share)


# -- the fill ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(30,), (9, 12), (8, 9, 10)])
def test_the_fill_continues_linear_functions(shape: tuple[int, ...]) -> None:
    """A function without second differences has the least bending, at corners too."""
    ramp = 3.0 + sum((a + 2) * x for a, x in enumerate(np.indices(shape)))
    missing = holes(shape, 0.2)
    missing[(0,) * len(shape)] = missing[(-1,) * len(shape)] = True
    got = filled_smoothly(np.where(missing, np.nan, ramp), missing)
    np.testing.assert_allclose(got, ramp, atol=2e-3 * np.ptp(ramp))
    np.testing.assert_array_equal(got[~missing], ramp[~missing])


def test_one_missing_sample_minimises_bending() -> None:
    """In closed form: (-1 4 4 -1)/6 of the four neighbours along each axis, averaged over the axes."""
    data = noise((7, 8, 9), kind=np.float64)
    missing = np.zeros(data.shape, bool)
    missing[3, 4, 4] = True
    wanted = sum(
        np.dot([-1, 4, 4, -1], np.take(line, [at - 2, at - 1, at + 1, at + 2])) / 18
        for line, at in ((data[:, 4, 4], 3), (data[3, :, 4], 4), (data[3, 4], 4))
    )
    assert filled_smoothly(data, missing)[3, 4, 4] == pytest.approx(wanted, abs=1e-12)


def test_the_fill_with_few_or_no_known_samples() -> None:
    nothing = np.ones((3, 4, 5), bool)
    np.testing.assert_array_equal(filled_smoothly(np.full(nothing.shape, np.nan), nothing), 0)
    for shape in ((2,), (1, 1, 2), (2, 2), (40, 41)):  # one sample alone
        missing = np.ones(shape, bool)
        missing.flat[0] = False
        np.testing.assert_allclose(filled_smoothly(np.full(shape, 7.0), missing), 7, rtol=1e-12)


@pytest.mark.parametrize(("kind", "wanted"), [("u1", "f4"), ("i2", "f4"), ("i4", "f8"), ("u8", "f8"), ("f4", "f4"), ("f8", "f8")])
def test_the_type_and_size_of_samples(kind: str, wanted: str) -> None:
    data = np.arange(60).reshape(3, 4, 5).astype(kind)
    missing = holes(data.shape, 0.1)
    got = filled_smoothly(data, missing)
    assert got.dtype == np.dtype(wanted)
    np.testing.assert_array_equal(got[~missing], data[~missing])


@pytest.mark.parametrize("scale", [1e300, 1e-300])
def test_scale_changes_nothing(scale: float) -> None:
    scale = 2.0 ** np.round(np.log2(scale))
    data, missing = noise((8, 9, 10), kind=np.float64), holes((8, 9, 10), 0.2)
    np.testing.assert_allclose(filled_smoothly(data * scale, missing), filled_smoothly(data, missing) * scale, rtol=1e-9)


@pytest.mark.parametrize(("hole", "bound"), [(1, 1e-6), (3, 1e-5), (9, 1e-4)])
def test_beside_a_hole_a_smooth_function_is_nearly_exact(hole: int, bound: float) -> None:
    """The increase of a cubic spline's error next to the hole: RMS, relative to the range."""
    n, rng = 40, np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).astype(float)
    data = np.zeros((n,) * 3)
    for middle, width, height in zip(rng.uniform(0, n, (20, 3)), rng.uniform(3, 8, 20), rng.normal(size=20), strict=True):
        data += height * np.exp(-((grid - middle) ** 2).sum(-1) / 2 / width**2)
    missing = np.zeros(data.shape, bool)
    missing[15 : 15 + hole, 17 : 17 + hole, 14 : 14 + hole] = True
    points = rng.uniform(10, 30, (60_000, 3))
    inside = ndimage.map_coordinates(missing.astype(float), points.T, order=3, mode="mirror", prefilter=False)
    near = ndimage.binary_dilation(missing, iterations=4)[tuple(np.round(points).astype(int).T)]
    points = points[near & (inside < 1e-12)]
    values = [
        ndimage.map_coordinates(d, points.T, order=3, mode="mirror")
        for d in (data, filled_smoothly(np.where(missing, 0, data), missing))
    ]
    assert np.sqrt(np.mean((values[1] - values[0]) ** 2)) < bound * np.ptp(data)


# -- local -------------------------------------------------------------------------------------------------------------


def touched(missing: np.ndarray, index: np.ndarray, name: str, rule: str) -> np.ndarray:
    """Whether a missing sample, or its image, lies within half the kernel's width of a position, except at its very end."""
    row = as_filter(name)
    by = row.magnified_by
    reach = row.support / 2 if by is None else by.support / 2 + row.support / 2 / row.scale
    pad = int(np.ceil(reach)) + 1
    near = reference.extend(missing.astype(float), pad, rule.partition("(")[0]) > 0.5
    offsets = np.stack(np.meshgrid(*[np.arange(-pad, pad + 1)] * missing.ndim, indexing="ij"), -1).reshape(-1, missing.ndim)
    samples = np.floor(index)[:, None] + offsets[None]
    close = (np.abs(samples - index[:, None]) < reach).all(-1)
    place = np.clip(samples.astype(int)[..., ::-1] + pad, 0, np.array(near.shape) - 1)
    return np.asarray((close & near[tuple(np.moveaxis(place, -1, 0))]).any(-1))


@pytest.mark.one_in(30)
@pytest.mark.parametrize(
    ("name", "rule"),
    [
        *(("bspline3", rule) for rule in boundaries()),
        *((name, "reflect") for name in ROWS if name != "bspline3"),  # each pair is new kernels
        ("hybrid", "nearest"),
        ("bspline2", "overlap"),
        ("linear", "constant"),
        ("bspline3-approx", "grid-constant"),
    ],
)
def test_local_is_nan_where_the_kernel_touches_and_filled_elsewhere(device: Device, name: str, rule: str) -> None:
    data = noise((12, 13, 14))
    missing = np.zeros(data.shape, bool)
    missing[5, 6, 7] = missing[0, 0, 0] = missing[-1, -1, -1] = True
    gaps = np.where(missing, np.nan, data)
    gaps[-1, -1, -1] = -np.inf
    size = np.array(data.shape[::-1])
    edge = 0.0 if rule in ("constant", "overlap") else 0.5
    points = np.random.default_rng(1).uniform(-edge, size - 1 + edge, (3000, 3))
    filled = filled_smoothly(gaps, missing)
    wanted = touched(missing, points, name, rule)
    assert 0 < wanted.sum() < len(points)
    with clvol.Field(gaps, name, rule, device, nan="local") as field, clvol.Field(filled, name, rule, device) as whole:
        assert field.gaps is not None
        assert field.nbytes > whole.nbytes
        got, all_of_them = field(points), whole(points)
        np.testing.assert_array_equal(np.isnan(got), wanted)
        np.testing.assert_array_equal(got[~wanted], all_of_them[~wanted])
        gradient = field.gradient(points)
        np.testing.assert_array_equal(np.isnan(gradient).any(-1), wanted)
        np.testing.assert_array_equal(gradient[~wanted], whole.gradient(points)[~wanted])
    assert field.closed


def test_a_sample_just_outside_the_kernel_does_not_count(device: Device) -> None:
    """At integer positions a cubic's outer tap has weight zero, and a linear filter uses one sample."""
    data = np.ones((9, 9, 9), np.float32)
    data[4, 4, 4] = np.nan
    at = np.stack(np.meshgrid(*[np.arange(9.0)] * 3, indexing="ij")[::-1], -1)
    for name, reach in (("linear", 0), ("bspline3", 1), ("bspline5", 2), ("catmull-rom", 1)):
        got = clvol.sample(data, at, name, nan="local", device=device)
        wanted = np.zeros(data.shape, bool)
        wanted[(slice(4 - reach, 5 + reach),) * 3] = True
        np.testing.assert_array_equal(np.isnan(got), wanted, err_msg=name)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_grids_match_points(device: Device, kind: type) -> None:
    data = np.where(holes((8, 9, 10), 0.01), np.nan, noise((8, 9, 10), kind=kind))
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for grid in (
        Volume(np.zeros((9, 7, 5)), (1.3, 1.1, 0.9), (0.2, 0.3, 0.1)),
        Volume(np.zeros((6, 5, 4)), 3 * (1.2,), (4, 4, 4), turned),
    ):
        got = clvol.resample(data, like=grid, nan="local", device=device).data
        index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")[::-1], -1)
        wanted = clvol.sample(data, grid.index_to_world(index), nan="local", device=device)
        np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
        assert 0 < np.isnan(got).sum() < got.size
        np.testing.assert_allclose(got, wanted, atol=1e-5)
    twice = clvol.magnify(data, 2, "linear", nan="local", device=device).data
    np.testing.assert_array_equal(np.isnan(twice[::2, ::2, ::2]), np.isnan(data))


def test_the_fraction_that_may_be_missing(device: Device) -> None:
    """Half of the volume is missing: along its face the fraction is one half, and falls to zero over a kernel's reach."""
    data = np.ones((9, 9, 20), np.float32)
    data[..., 10:] = np.nan
    x = np.linspace(6, 13, 141)
    points = np.stack([x, np.full_like(x, 4.3), np.full_like(x, 3.9)], -1)
    for most, last in ((0.0, 8.0), (0.25, 8.75), (0.5, 9.5), (0.75, 10.25)):
        got = clvol.sample(data, points, nan=Missing("local", most=most), device=device)
        np.testing.assert_array_equal(np.isnan(got), x > last + 1e-3, err_msg=str(most))
        np.testing.assert_allclose(got[~np.isnan(got)], 1, atol=1e-5)
    with clvol.Field(data, nan=Missing("local", most=1), device=device) as field:
        assert field.gaps is None
        assert np.isfinite(field(points)).all()


def test_one_sample_is_a_27th_of_a_cubics_taps() -> None:
    weights = touching(as_filter("bspline3"), "local").weights(np.array([0.0, 0.5]))
    np.testing.assert_allclose(weights.T, [[1 / 3, 1 / 3, 1 / 3, 0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]])
    np.testing.assert_allclose(touching(as_filter("bspline3"), "propagate").weights(0.3), 1 / 4)


# -- propagate ---------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("rule", "mode"), [("mirror", "mirror"), ("wrap", "grid-wrap"), ("nearest", "nearest"), ("overlap", "wrap")]
)
@pytest.mark.parametrize(("name", "order"), [("linear", 1), ("bspline3", 3), ("bspline3-approx", 3)])
def test_nan_propagates_as_in_scipy(device: Device, name: str, order: int, rule: str, mode: str) -> None:
    """NaN times zero is NaN: taps of weight zero count."""
    data = noise((7, 8, 9), kind=np.float64)
    data[2, 3, 4] = data[6, 7, 8] = data[0, 0, 5] = np.nan
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in data.shape), indexing="ij")[::-1], -1).reshape(-1, 3)
    points = np.concatenate([np.random.default_rng(2).uniform(0, [8, 7, 6], (500, 3)), lattice])
    if rule == "overlap":
        points = points[(points < [8, 7, 6]).all(-1)]
    with np.errstate(invalid="ignore"):
        wanted = ndimage.map_coordinates(data, points.T[::-1], order=order, mode=mode, prefilter=name == "bspline3")
    got = clvol.sample(data, points, name, rule, nan="propagate", device=device)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
    np.testing.assert_allclose(got, wanted, atol=1e-5)


# -- all of it -----------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", ["linear", "bspline3", "hybrid"])
@pytest.mark.parametrize("rule", ["local", "propagate"])
def test_nothing_but_missing_samples(device: Device, rule: str, name: str) -> None:
    for shape in ((4, 5, 6), (1, 1, 1), (3, 4)):
        points = np.random.default_rng(0).uniform(0, 1, (20, len(shape))) * (np.array(shape[::-1]) - 1)
        assert np.isnan(clvol.sample(np.full(shape, np.nan), points, name, nan=rule, device=device)).all()


def test_an_empty_mask_has_no_effect(device: Device) -> None:
    data, points = noise((5, 6, 7)), np.random.default_rng(0).uniform(0, 4, (50, 3))
    wanted = clvol.sample(data, points, device=device)
    for nan in ("local", "propagate", Missing("local", mask=np.zeros(data.shape, bool))):
        with clvol.Field(data, nan=nan, device=device) as field:
            assert field.gaps is None
            np.testing.assert_array_equal(field(points), wanted)


def test_a_mask_for_integers(device: Device) -> None:
    data = np.random.default_rng(0).integers(0, 1000, (6, 7, 8)).astype(np.int16)
    mask = holes(data.shape, 0.02)
    points = np.random.default_rng(1).uniform(0, 5, (400, 3))
    got = clvol.sample(data, points, nan=Missing(mask=mask), device=device)
    wanted = clvol.sample(np.where(mask, np.nan, data.astype(np.float32)), points, nan="local", device=device)
    np.testing.assert_array_equal(got, wanted)
    assert 0 < np.isnan(got).sum() < got.size


def test_fill_outside_is_not_missing(device: Device) -> None:
    data = noise((5, 6, 7))
    data[0, 0, 0] = np.nan
    outside = np.array([[-3.0, 0, 0], [0, 0, -0.7]])
    np.testing.assert_array_equal(clvol.sample(data, outside, fill=8, nan="local", device=device), 8)
    assert np.isnan(clvol.sample(data, outside, nan="local", device=device))[1]


def test_progress_goes_from_0_to_1_once(device: Device) -> None:
    data, seen = noise((5, 6, 7)), []
    data[1, 2, 3] = np.nan
    clvol.resample(data, (20, 20, 20), nan="local", device=device, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_pictures_of_fields_show_the_samples_that_are_kept(device: Device) -> None:
    data = np.random.default_rng(0).random((8, 9, 10)).astype(np.float32)
    data[4, 4, 4] = np.nan
    with clvol.Field(data, nan=Missing(most=1), device=device) as field:
        kept = clvol.render(field, size=(8, 8))
    np.testing.assert_array_equal(kept, clvol.render(Volume(data).filled(), filter="bspline3", size=(8, 8), device=device))


def test_invalid_masks_and_options_are_rejected(device: Device) -> None:
    data = noise((5, 6, 7))
    for bad in ("skip", None, 3):
        with pytest.raises(OptionError, match="nan must be one of error, propagate, local"):
            Missing(bad)  # type: ignore[arg-type]
    for most in (-0.1, 1.1, np.nan, "a"):
        with pytest.raises(OptionError, match="most must be"):
            Missing(most=most)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="mask must be boolean"):
        Missing(mask=np.zeros(3))
    wrong: list[tuple[Any, str]] = [(Missing(mask=np.zeros((7, 6, 5), bool)), "mask must have the shape of the samples")]
    wrong += [(Missing("error", np.ones(data.shape, bool)), 'nan="error" does not allow')]
    for nan, message in wrong:
        with pytest.raises(DataError, match=message):
            clvol.Field(data, nan=nan, device=device)
    with clvol.Field(data, device=device) as field:
        with pytest.raises(OptionError, match="made with nan 'error'"):
            clvol.sample(field, np.zeros((1, 3)), nan="local")
        clvol.sample(field, np.zeros((1, 3)), nan="error")
