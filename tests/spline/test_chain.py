"""Chains of transforms in the kernel, compared with the reference and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import clvol
from clvol import AffineTransform, BSplineTransform, DisplacementField, Volume, reference
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.device import Device
from tests.cases import rotation

Array = NDArray[np.float64]
WITHIN = {"single": 4e-6, "double": 1e-12}  # of the data's range


def moving(d: int) -> Volume:
    data = np.random.default_rng(1).normal(size=(17, 19, 23)[:d])
    return Volume(data, (0.7, 1.1, 1.6)[:d], (-3.0, 5.0, 2.0)[:d], rotation(d, 2))


def fixed(d: int) -> Volume:
    """A rotated grid about the moving image's centre that extends past its domain."""
    turn = rotation(d, 3)
    step = np.array([0.8, 0.9, 1.3])[:d]
    size = np.array([22, 21, 17])[:d]
    return Volume(np.zeros(size[::-1]), tuple(step), tuple(moving(d).center - turn @ (step * (size - 1) / 2)), turn)


def affine(d: int, seed: int = 4) -> AffineTransform:
    dice = np.random.default_rng(seed)
    return AffineTransform(np.eye(d) + dice.normal(0, 0.07, (d, d)), dice.normal(0, 0.5, d), moving(d).center)


def lattice(d: int, size: tuple[int, ...], seed: int) -> dict[str, Any]:
    """A smaller, rotated grid over the middle of the fixed image."""
    turn = rotation(d, seed)
    step = 11.0 / np.array(size[:d])
    return {
        "spacing": tuple(step),
        "origin": tuple(moving(d).center - turn @ (step * (np.array(size[:d]) - 1) / 2)),
        "direction": turn,
    }


def field(d: int, filter: str = "linear", seed: int = 5) -> DisplacementField:
    size = (7, 9, 6)
    values = np.random.default_rng(seed).normal(0, 0.6, (*size[:d][::-1], d))
    return DisplacementField(values, **lattice(d, size, seed), filter=filter)


def grid(d: int, order: int = 3, seed: int = 6) -> BSplineTransform:
    size = (8, 6, 7)
    values = np.random.default_rng(seed).normal(0, 0.8, (*size[:d][::-1], d))
    return BSplineTransform(values, **lattice(d, size, seed), order=order)


def points_of(volume: Volume) -> Array:
    return volume.index_to_world(np.moveaxis(np.indices(volume.shape)[::-1], 0, -1))


CHAINS: dict[str, Any] = {
    "nothing": lambda _: [],
    "affine": lambda d: affine(d),
    "two affine": lambda d: [affine(d), affine(d, 9)],
    "field": lambda d: field(d),
    "cubic field": lambda d: field(d, "bspline3"),
    "fields of 3, 5 and 6 taps": lambda d: [field(d, "bspline2", 7), field(d, "bspline4", 8), field(d, "bspline5", 9)],
    "field through Catmull and Rom's": lambda d: field(d, "catmull-rom"),
    "grid": lambda d: [grid(d)],
    "grids of order 1 and 2": lambda d: [grid(d, 1), grid(d, 2, 8)],
    "all": lambda d: [affine(d), field(d), affine(d, 9), affine(d, 10), grid(d), field(d, "bspline3", 8)],
    "all, backwards": lambda d: [field(d, "bspline3", 8), grid(d), affine(d), field(d)],
}


@pytest.mark.one_in(27)
@pytest.mark.parametrize(
    ("precision", "name", "d"),
    [
        *(("double", name, d) for name in CHAINS for d in (2, 3)),
        *(("single", name, 3) for name in ("nothing", "field", "all")),  # of the same text; each chain is four new kernels
    ],
)
def test_values_gradients_and_jacobians_match_the_reference(device: Device, precision: Any, name: str, d: int) -> None:
    if precision == "double" and not device.has_double:
        pytest.skip("the device has no float64")
    within, options = WITHIN[precision], {"precision": precision, "device": device}
    volume, like, chain = moving(d), fixed(d), CHAINS[name](d)
    places, jacobian = reference.map_points(points_of(like), chain)
    values = reference.sample(volume, places)
    gradient = reference.sample(volume, places, derivative=1)
    got = clvol.warp(volume, like, chain, derivative=1, jacobian=True, **options)
    assert got.gradient is not None
    assert got.jacobian is not None
    extent, slope = np.ptp(volume.data), np.abs(gradient).max()
    np.testing.assert_allclose(got.values.data, values, rtol=0, atol=within * extent)
    alone = clvol.resample(volume, like=like, transform=chain, **options)
    np.testing.assert_allclose(alone.data, got.values.data, rtol=0, atol=within * extent)
    np.testing.assert_allclose(got.gradient, gradient, rtol=0, atol=2 * within * slope)
    determinants = np.linalg.det(jacobian)
    np.testing.assert_allclose(got.jacobian.data, determinants, rtol=0, atol=within * max(1, np.abs(determinants).max()))
    pulled = clvol.warp(volume, like, chain, derivative=1, wrt="fixed", **options)
    total = np.einsum("...ij,...i->...j", jacobian, gradient)
    # both factors are rounded: with Intel's compiler the error is 2.6 times that of values
    np.testing.assert_allclose(pulled.gradient, total, rtol=0, atol=4 * within * np.abs(total).max())
    for made in (got.values, got.jacobian):
        assert (made.spacing, made.origin) == (like.spacing, like.origin)
        np.testing.assert_array_equal(made.direction, like.direction)


@pytest.mark.one_in(6)
@pytest.mark.parametrize("fill", [0.0, 7.5, np.nan])
@pytest.mark.parametrize("d", [2, 3])
def test_points_that_leave_the_moving_image_are_filled(device: Device, d: int, fill: float) -> None:
    volume, like, chain = moving(d), fixed(d), CHAINS["all"](d)
    places, _ = reference.map_points(points_of(like), chain)
    index = volume.world_to_index(places)
    outside = ((index < -0.5) | (index > np.array(volume.size) - 0.5)).any(axis=-1)
    assert 0.02 < outside.mean() < 0.98
    whole = clvol.warp(volume, like, chain, derivative=1, device=device)
    got = clvol.warp(volume, like, chain, derivative=1, wrt="fixed", fill=fill, device=device)
    np.testing.assert_array_equal(got.values.data, np.where(outside, np.float32(fill), whole.values.data))
    assert got.gradient is not None
    np.testing.assert_array_equal(got.gradient[outside], 0)
    assert np.abs(got.gradient[~outside]).min(axis=-1).max() > 0.1


@pytest.mark.parametrize("factor", [1.0, 2.0**100])
def test_data_far_from_one(device: Device, factor: float) -> None:
    """Stored values are scaled by a power of two: results and fill values are in units of the data."""
    volume, like, chain = moving(3), fixed(3), CHAINS["all"](3)
    plain = clvol.warp(volume, like, chain, derivative=1, wrt="fixed", fill=0, device=device)
    scaled = Volume(volume.data * factor, volume.spacing, volume.origin, volume.direction)
    got = clvol.warp(scaled, like, chain, derivative=1, wrt="fixed", fill=0, device=device)
    np.testing.assert_allclose(got.values.data / factor, plain.values.data, rtol=0, atol=1e-5)
    assert got.gradient is not None
    assert plain.gradient is not None
    np.testing.assert_allclose(got.gradient / factor, plain.gradient, rtol=0, atol=1e-4)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("rule", ["local", "propagate"])
def test_missing_samples_affect_results_that_touch_them(device: Device, rule: str) -> None:
    volume, like, chain = moving(3), fixed(3), CHAINS["all"](3)
    data = volume.data.copy()
    data[8, 9, 10] = np.nan
    holed = Volume(data, volume.spacing, volume.origin, volume.direction)
    places, _ = reference.map_points(points_of(like), chain)
    index = holed.world_to_index(places)
    reached = (np.abs(index - (10, 9, 8)) < 2).all(axis=-1)
    within = ((index >= -0.5) & (index <= np.array(volume.size) - 0.5)).all(axis=-1)
    expected = reached if rule == "local" else within
    assert 10 < reached.sum() < 0.2 * reached.size
    got = clvol.warp(holed, like, chain, derivative=1, fill=0, nan=rule, device=device)
    np.testing.assert_array_equal(np.isnan(got.values.data), expected)
    np.testing.assert_array_equal(np.isnan(got.gradient), expected[..., None].repeat(3, axis=-1))
    alone = clvol.resample(holed, like=like, transform=chain, fill=0, nan=rule, device=device)
    np.testing.assert_array_equal(np.isnan(alone.data), expected)


def test_results_do_not_depend_on_launches_or_neighbours(device: Device) -> None:
    volume, like, chain = moving(3), fixed(3), CHAINS["all"](3)
    whole = clvol.warp(volume, like, chain, derivative=1, jacobian=True, device=device)
    told: list[float] = []
    with device.limited(launch_taps=1):
        parts = clvol.warp(volume, like, chain, derivative=1, jacobian=True, device=device, progress=told.append)
    np.testing.assert_array_equal(parts.values.data, whole.values.data)
    np.testing.assert_array_equal(parts.gradient, whole.gradient)
    assert told == sorted(told)
    assert told[-1] == 1
    row = Volume(np.zeros((1, 1, 5)), like.spacing, tuple(like.index_to_world((7, 8, 9))), like.direction)
    np.testing.assert_array_equal(
        clvol.resample(volume, like=row, transform=chain, device=device).data[0, 0], whole.values.data[9, 8, 7:12]
    )


# -- closed forms --------------------------------------------------------------------------------------------------------


def test_the_last_transform_is_applied_first(device: Device) -> None:
    """A ramp along x, a shift and a doubling: 2 (x + 3), not 2 x + 3."""
    ramp = Volume(np.tile(np.arange(40.0), (4, 1)))
    line = Volume(np.zeros((1, 9)), origin=(0.0, 1.0))
    shift, double = AffineTransform(np.eye(2), (3, 0)), AffineTransform(np.diag([2.0, 1.0]))
    got = clvol.resample(ramp, like=line, transform=[double, shift], filter="linear", device=device)
    np.testing.assert_allclose(got.data[0], 2 * (np.arange(9.0) + 3), rtol=0, atol=1e-5)


def test_a_quadratic_displacement_has_a_linear_jacobian(device: Device) -> None:
    """u = (x y / 20, x² / 30, 0): exact for a cubic B-spline except near the ends; the determinant by hand."""
    n = 41
    like = Volume(np.zeros((9, 9, 9)), origin=(16.0, 16.0, 16.0))
    z, y, x = np.indices((n, n, n), dtype=float)
    values = np.stack([x * y / 20, x * x / 30, 0 * z], axis=-1)
    chain = [DisplacementField(values, filter="bspline3")]
    got = clvol.warp(np.zeros((4, 4, 4)), like, chain, jacobian=True, device=device).jacobian
    assert got is not None
    px, py, _ = np.moveaxis(points_of(like), -1, 0)
    np.testing.assert_allclose(got.data, (1 + py / 20) - (px / 20) * (2 * px / 30), rtol=0, atol=2e-5)


def test_a_similarity_scales_volumes(device: Device) -> None:
    matrix = 1.2 * Rotation.from_rotvec([0.1, 0.4, -0.2]).as_matrix()
    got = clvol.warp(moving(3), fixed(3), AffineTransform(matrix), jacobian=True, device=device).jacobian
    assert got is not None
    np.testing.assert_allclose(got.data, 1.2**3, rtol=1e-6)


def test_a_homogeneous_matrix_is_an_affine_map(device: Device) -> None:
    one = affine(3)
    matrix = np.block([[one.matrix, one.offset[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    wanted = clvol.resample(moving(3), like=fixed(3), transform=one, device=device)
    got = clvol.resample(moving(3), like=fixed(3), transform=matrix, device=device)
    np.testing.assert_array_equal(got.data, wanted.data)


def test_points_at_the_edge_of_a_grid_are_inside_and_beyond_are_unmoved(device: Device) -> None:
    """A constant displacement: B-spline grids end with their coefficients, fields half a voxel past their samples."""
    ramp = Volume(np.tile(np.arange(60.0), (5, 1)))
    shift = np.zeros((8, 10, 2))
    shift[..., 0] = 0.25
    line = Volume(np.zeros((1, 81)), (0.1, 1.0), (3.0, 2.0))  # x from 3 to 11
    x = 3 + 0.1 * np.arange(81)
    for one, low, high in (
        (BSplineTransform(shift, origin=(2.0, -2.0)), 3.0, 10.0),
        (BSplineTransform(shift, origin=(2.0, -2.0), order=1), 2.0, 11.0),
        (DisplacementField(shift[:, :6], origin=(4.0, -2.0)), 3.5, 9.5),
        (DisplacementField(shift[:, :6], origin=(4.0, -2.0), filter="bspline3"), 3.5, 9.5),
    ):
        got = clvol.resample(ramp, like=line, transform=one, filter="linear", device=device).data[0]
        inside = (x > low - 1e-6) & (x < high + 1e-6)
        np.testing.assert_allclose(got, x + np.where(inside, 0.25, 0), rtol=0, atol=1e-5)


# -- series --------------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize("d", [2, 3])
def test_a_series_equals_its_frames(device: Device, d: int) -> None:
    frames = np.random.default_rng(0).normal(size=(4, *moving(d).shape)).astype(np.float32)
    place = {"spacing": moving(d).spacing, "origin": moving(d).origin, "direction": moving(d).direction}
    chains = [None, affine(d), [affine(d), field(d)], grid(d)]
    told: list[float] = []
    got = clvol.resample_series(frames, chains, fixed(d), **place, fill=0, device=device, progress=told.append)
    wanted = [
        clvol.resample(Volume(frame, **place), like=fixed(d), transform=chain, fill=0, device=device).data
        for frame, chain in zip(frames, chains, strict=True)
    ]
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, wanted)
    assert told == sorted(told)
    assert told[-1] == 1
    volumes = [Volume(frame, **place) for frame in frames]
    np.testing.assert_array_equal(clvol.resample_series(volumes, chains, fixed(d), fill=0, device=device), got)
    own = clvol.resample_series(volumes, [None] * 4, device=device)
    np.testing.assert_allclose(own, frames, rtol=0, atol=WITHIN["single"] * np.ptp(frames))


def test_a_series_with_a_frame_far_from_zero(device: Device) -> None:
    frames = np.random.default_rng(0).normal(size=(2, 6, 7, 8))
    frames[1] += 1e6
    got = clvol.resample_series(frames, [None, None], device=device)
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, frames, rtol=0, atol=1e-5)


def test_a_series_can_be_interrupted_between_frames(device: Device) -> None:
    def stop(done: float) -> None:
        if done > 0.4:
            raise KeyboardInterrupt

    frames = np.zeros((5, 6, 7, 8))
    with pytest.raises(KeyboardInterrupt):
        clvol.resample_series(frames, [affine(3)] * 5, device=device, progress=stop)
    assert clvol.resample_series(frames, [None] * 5, device=device).shape == frames.shape


# -- bad input -----------------------------------------------------------------------------------------------------------

VECTORS = np.zeros((4, 5, 6, 3))
WITH_NAN = VECTORS.copy()
WITH_NAN[1, 2, 3, 0] = np.nan

BAD: dict[str, tuple[type[Exception], str, Any]] = {
    "singular": (GeometryError, "matrix must not be singular", lambda: AffineTransform(np.ones((3, 3)))),
    "zero": (GeometryError, "matrix must not be singular", lambda: AffineTransform(np.diag([1.0, 0.0]))),
    "4 x 4": (GeometryError, "2 × 2 or 3 × 3", lambda: AffineTransform(np.eye(4))),
    "NaN": (GeometryError, "finite", lambda: AffineTransform([[np.nan, 0], [0, 1]])),
    "text": (GeometryError, "matrix must be", lambda: AffineTransform("abc")),
    "translation": (GeometryError, "translation must be 3 finite numbers", lambda: AffineTransform(np.eye(3), (1, 2))),
    "center": (GeometryError, "center must be 2 finite numbers", lambda: AffineTransform(np.eye(2), (1, 2), (np.inf, 0))),
    "last row": (GeometryError, "last row", lambda: AffineTransform.from_homogeneous(np.ones((4, 4)))),
    "5 x 5": (GeometryError, "4 × 4", lambda: AffineTransform.from_homogeneous(np.eye(5))),
    "components": (DataError, r"shape \(nz, ny, nx, 3\)", lambda: DisplacementField(np.zeros((4, 5, 6, 2)))),
    "flat": (DataError, r"shape \(nz, ny, nx, 3\)", lambda: BSplineTransform(np.zeros((4, 5)))),
    "nan": (DataError, r"finite; got nan at index \[1, 2, 3, 0\]", lambda: DisplacementField(WITH_NAN)),
    "complex": (DataError, "real numbers", lambda: DisplacementField(VECTORS + 1j)),
    "empty": (DataError, "at least one sample", lambda: DisplacementField(np.zeros((0, 5, 6, 3)))),
    "spacing": (GeometryError, "spacing", lambda: DisplacementField(VECTORS, (1, 0, 1))),
    "direction": (GeometryError, "direction", lambda: DisplacementField(VECTORS, direction=np.ones((3, 3)))),
    "small": (GeometryError, "at least 4 coefficients", lambda: BSplineTransform(np.zeros((3, 5, 6, 3)))),
    "order": (OptionError, "order must be 1, 2 or 3", lambda: BSplineTransform(VECTORS, order=4)),
    "filter": (OptionError, "2 to 6 taps", lambda: DisplacementField(VECTORS, filter="nearest")),
    "hybrid": (OptionError, "2 to 6 taps", lambda: DisplacementField(VECTORS, filter="hybrid")),
    "smoothing": (OptionError, "2 to 6 taps", lambda: DisplacementField(VECTORS, filter="bspline3(0.1)")),
    "unknown filter": (OptionError, "filter", lambda: DisplacementField(VECTORS, filter="tricubik")),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_transforms_are_rejected(name: str) -> None:
    error, message, make = BAD[name]
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize(
    ("transform", "error", "message"),
    [
        ("affine", OptionError, "transform must be"),
        ([affine(3), 5], OptionError, "transform must be"),
        ([[1, 0], [0, 1]], OptionError, "transform must be"),
        (affine(2), GeometryError, "3 dimensions"),
        ([affine(3), field(2)], GeometryError, "3 dimensions"),
        (np.eye(3), GeometryError, "3 dimensions"),
        (np.zeros((4, 4)), GeometryError, "last row"),
    ],
)
def test_invalid_chains_are_rejected_before_any_computation(transform: Any, error: type[Exception], message: str) -> None:
    for call in (clvol.resample, clvol.warp):
        with pytest.raises(error, match=message):
            call(moving(3), like=fixed(3), transform=transform, device="no such device")
    with pytest.raises(error, match=message):
        clvol.resample_series(np.zeros((1, 4, 4, 4)), [transform], device="no such device")


def test_options_are_checked() -> None:
    volume, like = moving(3), fixed(3)
    for options, message in (
        ({"derivative": 2}, "derivative must be a whole number, at least 0 and at most 1"),
        ({"wrt": "both"}, "wrt must be one of moving, fixed"),
        ({"jacobian": "yes"}, "jacobian must be a bool"),
        ({"fill": "0"}, "fill must be a number"),
    ):
        with pytest.raises(OptionError, match=message):
            clvol.warp(volume, like, **options, device="no such device")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="like must have 3 axes"):
        clvol.warp(volume, fixed(2), device="no such device")


@pytest.mark.parametrize(
    ("series", "transforms", "options", "error", "message"),
    [
        (np.zeros((3, 4, 4, 4)), [None, None], {}, OptionError, "as many as there are frames, 3; got 2"),
        (np.zeros((3, 4, 4, 4)), None, {}, OptionError, "transforms must be"),
        (np.zeros((4, 4)), [None], {}, DataError, r"\(t, nz, ny, nx\)"),
        (np.zeros((0, 4, 4, 4)), [], {}, DataError, "at least one frame"),
        ([moving(3)], [None], {"spacing": (1, 1, 1)}, OptionError, "Volumes have a geometry"),
        ([moving(3), moving(2)], [None, None], {}, OptionError, "like must have 2 axes"),
    ],
)
def test_invalid_series_are_rejected(series: Any, transforms: Any, options: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        clvol.resample_series(series, transforms, **options)


def test_a_closed_field_is_an_error(device: Device) -> None:
    volume = clvol.Field(moving(3), device=device)
    volume.close()
    with pytest.raises(OptionError, match="released"):
        clvol.warp(volume, fixed(3), field(3))
