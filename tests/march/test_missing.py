"""Pictures of volumes with missing samples: against the analytic ball, the reference, and the same by bricks."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.bricks.continued import continued as in_parts
from clvol.bricks.field import BrickedField
from clvol.bricks.source import LazyVolume
from clvol.device import Device
from clvol.march.choose import by_parts
from clvol.march.renderer import Renderer, render
from clvol.march.slices import section
from clvol.reference.march import march as reference
from clvol.reference.march.missing import continued
from clvol.scene.camera import Camera
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import TransferFunction
from clvol.spline.field import Field
from clvol.volume.histogram import clims_of, isovalue_of
from clvol.volume.missing import EXTRAPOLATED, Missing, extrapolated
from clvol.volume.volume import Volume, masked
from tests.cases import MODES
from tests.march.agreement import CAMERA, OPTIONS, SIZE, Allowance, compare
from tests.march.looks import TILES, suited

STEP = 0.53  # no plane of these volumes then lies halfway between samples, where rounding decides what is missing
RADIUS, CENTER = 8.2, (11.67, 11.37, 11.42)  # in samples, x first
FULL = TransferFunction(((10.0, (0.0, 0.0, 1.0)), (20.0, (1.0, 1.0, 0.0))), ((10.0, 0.9), (20.0, 0.9)))


def ball(inside: float = np.nan) -> np.ndarray[Any, np.dtype[np.float32]]:
    """15 + 5 x in a ball with the radius 1, and nothing, or `inside`, outside."""
    z, y, x = np.mgrid[:24, :24, :24]
    away = [axis - at for axis, at in zip((x, y, z), CENTER, strict=True)]
    values = 15 + 5 * away[0] / RADIUS
    return np.where(sum(a**2 for a in away) <= RADIUS**2, values, inside).astype(np.float32)


@lru_cache
def holes() -> Volume:
    """Smooth noise over 0..1 in a ball with a few holes, one of them a single sample, with unequal spacings."""
    noise = Volume(np.random.default_rng(3).random((9, 10, 11))).gaussian(0.8).data
    data = ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)
    z, y, x = np.mgrid[:9, :10, :11]
    data[(x - 5.2) ** 2 + (y - 4.6) ** 2 + (z - 4.1) ** 2 > 17] = np.nan
    data[4, 5, 5], data[2:5, 3:5, 6] = np.inf, np.nan
    return Volume(data, (1.0, 0.8, 1.3), (5, -3, 2))


def analytic(camera: Camera, size: tuple[int, int]) -> tuple[Any, ...]:
    """Which rays hit the true ball, and the values where they enter and leave it, and in between."""
    grid = Volume(np.zeros((24, 24, 24)))
    rays = reference.camera_rays(grid, camera.view(grid, size[0] / size[1]), size)
    to = np.array(CENTER) - rays.origin
    middle = (to * rays.direction).sum(1)
    half = RADIUS**2 - (to**2).sum(1) + middle**2
    hit, root = half > 0, np.sqrt(np.maximum(half, 0))
    near, far = (15 + 5 * (rays.at(t)[:, 0] - CENTER[0]) / RADIUS for t in (middle - root, middle + root))
    return tuple(array.reshape(size[::-1]) for array in (hit, near, far, root))


@pytest.mark.one_in(4)
@pytest.mark.parametrize("mode", ["composite", "mip", "minip", "mean"])
def test_a_ball_without_surroundings_is_that_of_its_closed_form(mode: str, device: Device) -> None:
    camera, size = Camera.orbit(30, 20, fit="volume"), (64, 64)
    hit, near, far, half = analytic(camera, size)
    options: dict[str, Any] = {"shading": False} if mode == "composite" else {}
    transfer = FULL.with_opacity([(10.0, 1.0), (20.0, 1.0)]) if mode == "composite" else FULL
    with Renderer(ball(), "bspline3", device=device) as renderer:
        got = renderer.render(camera, mode, size, background=None, rays=1, transfer=transfer, **options)
    shown = got[..., 3] > 0.5
    assert (shown != hit).mean() < 0.015  # the outline is that of voxels
    assert abs(shown.sum() / hit.sum() - 1) < 0.04
    value = {"composite": near, "mip": np.maximum(near, far), "minip": np.minimum(near, far), "mean": (near + far) / 2}[mode]
    inner = hit & (half > 2)  # rays that graze the ball may stay between two samples
    shade = (value - 10) / 10
    off = np.abs(got[..., :3] - np.stack([shade, shade, 1 - shade], -1)).max(-1)[inner]
    assert off.max() < 0.13  # a voxel of the surface is a 16th of the range
    assert np.sqrt((off**2).mean()) < 0.03


def test_what_was_a_rim_of_filled_samples_is_gone(device: Device) -> None:
    """A ball of 15 + 5x shows no values but its own; filled by -999, its surface shows the lowest."""
    camera, size = Camera.orbit(30, 20, fit="volume"), (48, 48)
    options: dict[str, Any] = {"transfer": FULL, "background": None, "rays": 1, "shading": False}
    blue = {}
    for value in (np.nan, -999.0):
        with Renderer(ball(value), "bspline3", device=device) as renderer:
            picture = renderer.render(camera, "composite", size, **options)
        right = picture[:, 32:][picture[:, 32:, 3] > 0.9]
        blue[value] = float((right[:, 2] > 0.6).mean())
    assert blue[np.nan] == 0
    assert blue[-999.0] > 0.5


@pytest.mark.one_in(2)
@pytest.mark.parametrize("method", ["exact", "stepped"])
def test_a_surface_ends_where_samples_do(method: str, device: Device) -> None:
    """That of 15 is the disc x = 0: all of it, and nothing around the ball."""
    camera = Camera.orbit(30, 20, fit="volume")
    options: dict[str, Any] = {
        "isovalue": 15.0,
        "method": method,
        "background": None,
        "rays": 1,
        "outputs": ("rgba", "position", "normal"),
    }
    with Renderer(ball(), "bspline3", device=device) as renderer:
        got = renderer.render(camera, "isosurface", (64, 64), **options)
    at = got["position"][got["rgba"][..., 3] > 0]
    assert np.abs(at[:, 0] - CENTER[0]).max() < 0.01
    assert np.linalg.norm(at - CENTER, axis=1).max() < RADIUS + 0.75
    assert np.abs(np.abs(got["normal"][got["rgba"][..., 3] > 0][:, 0]) - 1).max() < 0.01
    rays = reference.camera_rays(renderer.volume, camera.view(renderer.volume, 1.0), (64, 64))
    disc = rays.at((CENTER[0] - rays.origin[:, 0]) / rays.direction[:, 0]) - CENTER
    assert abs(len(at) / (np.linalg.norm(disc, axis=1) < RADIUS).sum() - 1) < 0.05


@pytest.mark.one_in(18)
@pytest.mark.parametrize("filter", ["bspline3", "linear", "nearest"])
@pytest.mark.parametrize("mode", [*MODES, "stepped"])
def test_pictures_agree_with_the_reference_and_skipping_changes_no_bit(mode: str, filter: str, device: Device) -> None:
    own: dict[str, Any] = {"method": "stepped"} if mode == "stepped" else {}
    mode = "isosurface" if mode == "stepped" else mode
    options = suited(mode, {**OPTIONS, **own})
    with Renderer(holes(), filter, device=device) as renderer:
        got = renderer.render(CAMERA, mode, SIZE, STEP, **options)
        again = renderer.render(CAMERA, mode, SIZE, STEP, skipping=False, **options)
    want = reference.render(holes(), CAMERA, mode, filter, "mirror", SIZE, STEP, **options)
    assert isinstance(want, dict)
    for name in want:
        np.testing.assert_array_equal(got[name], again[name])
    # where a stretch ends is found to 2**-11 of a step; nearest jumps, so that rounding decides a few pixels
    few = 0.02 if filter == "nearest" else 0.005
    compare(got, want, Allowance(rgba=2e-4, rms=2e-5, depth=1e-3, position=1e-3, normal=5e-3, pixels=few))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "stepped"])
def test_ray_by_ray_they_agree_too(mode: str, device: Device) -> None:
    own: dict[str, Any] = {"method": "stepped"} if mode == "stepped" else {}
    mode = "isosurface" if mode == "stepped" else mode
    options = suited(mode, {**OPTIONS, **own})
    with device.limited(tile=TILES["rays"]), Renderer(holes(), "bspline3", device=device) as renderer:
        got = renderer.render(CAMERA, mode, SIZE, STEP, **options)
    want = reference.render(holes(), CAMERA, mode, "bspline3", "mirror", SIZE, STEP, **options)
    assert isinstance(want, dict)
    compare(got, want, Allowance(rgba=2e-4, rms=2e-5, depth=1e-3, position=1e-3, normal=5e-3, pixels=0.005))


def test_the_extrapolation_is_that_of_the_reference_and_local() -> None:
    data, (low, high) = holes().data, holes().value_range
    missing = ~np.isfinite(data)
    filled = extrapolated(data, missing, low / 2 + high / 2)
    np.testing.assert_array_equal(filled[~missing], data[~missing])
    np.testing.assert_allclose(filled, continued(holes()).data, atol=1e-6)
    some = np.random.default_rng(2).normal(size=(30, 6, 40)).astype(np.float32)
    gone = np.random.default_rng(3).random(some.shape) < 0.3
    gone[5:22, :, 10:] = True
    part = np.s_[4:28, :, 5:38]
    inner = np.s_[EXTRAPOLATED:-EXTRAPOLATED, :, EXTRAPOLATED:-EXTRAPOLATED]
    of_part = extrapolated(some[part], gone[part], 0.1)[inner]
    np.testing.assert_array_equal(extrapolated(some, gone, 0.1)[part][inner], of_part)
    assert extrapolated(some, np.ones_like(gone), 0.25).max() == 0.25


def test_a_linear_function_is_continued_almost_exactly(device: Device) -> None:
    """On the edge of the ball, the slope errs by 4 %; with the fill of sampling by a quarter."""
    ways = np.random.default_rng(0).normal(size=(500, 3))
    at = np.array(CENTER) + (RADIUS - 0.3) * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    errors = {}
    for name, data in (("planes", extrapolated(ball(), np.isnan(ball()), 15.0)), ("smooth", Volume(ball()).filled().data)):
        with Field(data, "bspline3", device=device) as field:
            off = field.gradient(at) - np.array([5 / RADIUS, 0, 0])
        errors[name] = float(np.sqrt((off**2).sum(1).mean())) / (5 / RADIUS)
    assert errors["planes"] < 0.05
    assert errors["smooth"] > 0.15


@pytest.mark.one_in(4)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip", "mean"])
def test_a_mask_is_as_good_as_nan(mode: str, device: Device) -> None:
    whole = np.arange(24 * 24 * 24, dtype=np.uint16).reshape(24, 24, 24) % 997
    mask = np.isnan(ball())
    cut = np.where(mask, np.nan, whole.astype(np.float32))
    want = render(cut, CAMERA, mode, SIZE, device=device)
    np.testing.assert_array_equal(render(whole, CAMERA, mode, SIZE, mask=mask, device=device), want)
    for scene in (Medium(whole), Scene(whole)):
        np.testing.assert_array_equal(render(scene, CAMERA, mode, SIZE, mask=mask, device=device), want)


def test_without_missing_samples_a_mask_changes_nothing(device: Device) -> None:
    data = ball(9.0)
    want = render(data, CAMERA, "composite", SIZE, device=device)
    np.testing.assert_array_equal(render(data, CAMERA, "composite", SIZE, mask=np.zeros(data.shape, bool), device=device), want)


def test_masked_labels_stay_labels_and_show_no_other(device: Device) -> None:
    labels = np.zeros((12, 12, 12), np.int32)
    labels[2:10, 2:10, 2:6], labels[2:10, 2:10, 6:10] = 3, 7
    volume = Volume(labels, labels=True)
    upper = masked(volume, np.indices(labels.shape)[0] > 5)
    assert upper.is_labels
    assert upper.data.dtype == np.float32
    colors = TransferFunction.preset("labels", volume)
    with Renderer(volume, mask=np.indices(labels.shape)[0] > 5, device=device) as renderer:
        assert renderer.filter.name == "nearest"
        got = renderer.render(CAMERA, "mip", SIZE, background=None, rays=1, transfer=colors)
    shown = np.unique(np.round(got[got[..., 3] > 0][:, :3], 4), axis=0)
    own = np.round(colors(np.array([0.0, 3.0, 7.0]))[:, :3], 4)
    assert all(np.abs(own - one).max(1).min() < 2e-4 for one in shown)


@pytest.mark.one_in(15)
@pytest.mark.parametrize("filter", ["catmull-rom", "bspline3", "nearest"])
@pytest.mark.parametrize("mode", ["composite", "isosurface", "stepped", "mip", "mean"])
def test_by_bricks_they_are_those_in_memory(mode: str, filter: str, device: Device) -> None:
    own: dict[str, Any] = {"method": "stepped"} if mode == "stepped" else {}
    mode = "isosurface" if mode == "stepped" else mode
    options = suited(mode, {**OPTIONS, **own, "transfer": FULL, "isovalue": 16.0})
    data = ball()
    data[8:12, 9:13, 12:15] = np.nan
    with (
        Renderer(data, filter, device=device) as renderer,
        BrickedField(by_parts(Volume(data)), filter, device=device, edge=8) as field,
        Renderer(field) as parts,
    ):
        assert len(field.bricks) == 27
        want, got = (one.render(CAMERA, mode, SIZE, 0.8, **options) for one in (renderer, parts))
    assert want["rgba"][..., 3].max() > 0
    for name in want:
        if filter == "bspline3" and name != "visited":
            off = np.abs(got[name] - want[name])
            assert np.nanmax(np.where(np.isinf(want[name]), 0, off), initial=0) < 1e-3
        elif filter != "bspline3":
            np.testing.assert_array_equal(got[name], want[name], err_msg=name)


def test_a_volume_too_large_for_the_device_is_drawn_by_bricks(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    options = suited("mip", {**OPTIONS, "transfer": FULL})
    want = render(ball(), CAMERA, "mip", SIZE, device=device, filter="linear", **options)

    def too_large(*_: Any) -> Field:
        raise OutOfMemoryError("too large")

    monkeypatch.setattr("clvol.march.choose.single", too_large)
    got = render(ball(), CAMERA, "mip", SIZE, device=device, filter="linear", **options)
    np.testing.assert_array_equal(got["rgba"], want["rgba"])


def test_automatic_choices_ignore_what_is_missing() -> None:
    rng = np.random.default_rng(5)
    inner = (rng.normal(100, 5, (20, 20, 20)) + 100 * (np.indices((20, 20, 20))[2] > 9)).astype(np.float32)
    around = np.full((28, 28, 28), np.nan, np.float32)
    around[4:24, 4:24, 4:24] = inner
    plain, padded = Volume(inner), Volume(around)
    assert abs(isovalue_of(padded)[0] - isovalue_of(plain)[0]) < 1
    for name, (low, high) in clims_of(plain).items():
        np.testing.assert_allclose(clims_of(padded)[name], (low, high), atol=0.02 * (high - low) + 1)
    assert abs(padded.noise.sigma / plain.noise.sigma - 1) < 0.15
    assert padded.noise.background is None


def test_the_camera_fits_what_there_is(device: Device) -> None:
    data = np.full((32, 32, 32), np.nan, np.float32)
    data[12:20, 12:20, 12:20] = np.random.default_rng(0).normal(50, 1, (8, 8, 8))
    with Renderer(data, "bspline3", device=device) as renderer:
        picture = renderer.render(Camera.orbit(0, 0), "mip", (64, 64), background=None)
    assert 0.2 < (picture[..., 3] > 0).mean() < 0.8


def test_a_field_with_gaps_is_drawn_as_its_volume_is(device: Device) -> None:
    """But for the fill, which only shows next to the edge."""
    options = suited("mip", {**OPTIONS, "outputs": "rgba"})
    with Field(holes(), "bspline3", device=device, nan="local") as field, Renderer(field) as renderer:
        got = renderer.render(CAMERA, "mip", SIZE, STEP, **options)
    with Renderer(holes(), "bspline3", device=device) as renderer:
        want = renderer.render(CAMERA, "mip", SIZE, STEP, **options)
        values = renderer.field(np.array([[9.0, 1.0, 9.0], [5.0, -3.0, 2.0]]))
    np.testing.assert_array_equal(got[..., 3], want[..., 3])
    assert np.isnan(values).tolist() == [False, True]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
def test_a_lazy_volume_is_drawn_as_in_memory(mode: str, device: Device, tmp_path: Path) -> None:
    """It was refused. Coefficients of bricks differ from those of the whole volume by 1e-6, as without missing samples."""
    zarr = pytest.importorskip("zarr")
    data = ball()
    options = suited(mode, {**OPTIONS, "transfer": FULL, "isovalue": 16.0})
    stored = LazyVolume(zarr.create_array(tmp_path / "v.zarr", data=data, chunks=(8, 8, 8)))
    with (
        Renderer(data, "bspline3", device=device) as renderer,
        Renderer(stored, "bspline3", device=device) as whole,
        BrickedField(in_parts(stored), "bspline3", device=device, edge=8) as field,
        BrickedField(by_parts(Volume(data)), "bspline3", device=device, edge=8) as expected,
        Renderer(field) as parts,
        Renderer(expected) as filled,
    ):
        drawn = (one.render(CAMERA, mode, SIZE, 0.8, **options)["rgba"] for one in (renderer, whole, parts, filled))
        want, got, bricks, same = drawn
        points = np.random.default_rng(0).uniform(-1, 20, (2000, 3))
        values = renderer.field(points)
        for one in (field, expected, whole.field):  # the second gave extrapolated values
            np.testing.assert_array_equal(np.isnan(one(points)), np.isnan(values))
            np.testing.assert_allclose(one(points), values, atol=1e-4)
        grid = clvol.resample(field, shape=(12, 12, 12)).data
        np.testing.assert_array_equal(np.isnan(grid), np.isnan(clvol.resample(renderer.field, shape=(12, 12, 12)).data))
    assert want[..., 3].max() > 0
    assert 0 < np.isnan(values).sum() < len(values)
    np.testing.assert_allclose(bricks, same, atol=1e-6)
    np.testing.assert_allclose(got, want, atol=1e-4)
    np.testing.assert_allclose(bricks, want, atol=1e-3)


def test_each_size_of_a_lazy_volume_knows_where_it_lacks_samples(device: Device) -> None:
    """Truth: each size in memory; automatic isovalue, window, camera and smoothing are those of the finest."""
    data = ball()
    coarse = LazyVolume(data[::2, ::2, ::2], (2, 2, 2))
    lazy = LazyVolume(data, levels=[coarse])
    again = pickle.loads(pickle.dumps(in_parts(lazy)))
    want = render(data, size=(32, 32), device=device)
    for volume in (lazy, again):
        np.testing.assert_allclose(render(volume, size=(32, 32), lod=0, device=device), want, atol=1e-4)
    options: dict[str, Any] = suited("mip", {**OPTIONS, "transfer": FULL, "outputs": "rgba"})
    options |= {"filter": "linear", "device": device}
    camera = Camera(position=(50, 35, 25), target=(11, 11, 11))
    got = render(lazy, camera, "mip", SIZE, 0.1, lod=100, **options)
    want = render(Volume(coarse.data, (2, 2, 2)), camera, "mip", SIZE, 0.1, **options)
    shown, expected = (np.asarray(one)[..., 3] > 0 for one in (got, want))
    assert expected.mean() > 0.1
    assert (shown != expected).mean() < 0.01  # rays are sampled from the finest one's faces on


DRAWN: dict[str, Any] = {**OPTIONS, "transfer": FULL, "isovalue": 16.0, "outputs": "rgba"}


@pytest.mark.one_in(6)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_mask_of_a_lazy_volume_is_that_of_the_volume_in_memory(mode: str, dtype: type, device: Device) -> None:
    """It was refused. What it excludes moves no isovalue, window or camera; only the unit of gradients is another."""
    mask = np.isnan(ball())
    data = np.where(mask, 4000, ball(0)).astype(dtype)
    options = {"filter": "catmull-rom", "device": device}
    lazy = LazyVolume(data)
    for own in (options, options | suited(mode, DRAWN)):
        want = render(data, CAMERA, mode, SIZE, 0.8, mask=mask, **own)
        for one in (mask, mask.tolist(), LazyVolume(mask)):
            np.testing.assert_allclose(render(lazy, CAMERA, mode, SIZE, 0.8, mask=one, **own), want, atol=1e-6)
        np.testing.assert_allclose(render(data, CAMERA, mode, SIZE, 0.8, mask=LazyVolume(mask), **own), want, atol=1e-6)
    with Renderer(lazy, "catmull-rom", device=device, mask=mask) as renderer:
        assert np.isnan(renderer.field(np.array([[1.0, 1.0, 1.0], CENTER]))).tolist() == [True, False]


def test_a_coarser_size_lacks_what_the_mask_excludes_of_any_of_its_samples() -> None:
    data, mask = ball(9.0), np.isnan(ball())
    mask[7] = True
    few = data.reshape(12, 2, 12, 2, 12, 2).mean((1, 3, 5))
    lazy = LazyVolume(data, levels=[LazyVolume(few, (2, 2, 2), (0.5, 0.5, 0.5))])
    for made in (in_parts(lazy, mask), pickle.loads(pickle.dumps(in_parts(lazy, mask))), in_parts(lazy, mask).for_tasks()):
        gone = mask.reshape(12, 2, 12, 2, 12, 2).any((1, 3, 5))
        for level, expected in ((made, mask), (made.levels[0], gone)):
            assert level.where is not None
            np.testing.assert_array_equal(level.where[0 : level.shape[0], 0 : level.shape[1], 0 : level.shape[2]], expected)
            part = np.s_[2:5, 0:7, 3:4]
            np.testing.assert_array_equal(level.where[part], expected[part])


@pytest.mark.parametrize("given", ["volume", "field"])
def test_nan_that_no_look_saw_is_left_out_too(given: str, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended the picture with an error."""
    monkeypatch.setattr("clvol.bricks.source._PREVIEWED", 200)
    monkeypatch.setattr("clvol.bricks.source._PART", 4)
    data = ball(15.0)
    data[3:6, 3:9, 14:21], data[5, 5, 5] = np.nan, np.inf
    options = suited("composite", DRAWN) | {"camera": CAMERA, "mode": "composite", "size": SIZE, "step": 0.8}
    lazy = LazyVolume(data)
    assert np.isfinite(lazy.preview().data).all()
    assert np.isfinite(lazy.part().data).all()
    want = render(data, filter="catmull-rom", device=device, **options)
    with BrickedField(lazy, "catmull-rom", device=device, edge=8) as field, Renderer(lazy, "catmull-rom", device=device) as own:
        renderer = Renderer(field) if given == "field" else own
        for _ in range(2):
            np.testing.assert_array_equal(renderer.render(**options), want)
        final = list(renderer.refine(**{name: value for name, value in options.items() if name != "outputs"}))[-1]
        np.testing.assert_array_equal(final, want)
        with pytest.raises(DataError, match="samples must be finite; got"):
            field(np.array([[17.0, 5.0, 4.0]]))


class _Counting:
    """Samples by chunks, which counts those that are read."""

    def __init__(self, data: Any, chunks: tuple[int, ...]) -> None:
        self._data, self.shape, self.dtype, self.chunks, self.count = data, data.shape, data.dtype, chunks, 0

    def __getitem__(self, place: tuple[slice, ...]) -> Any:
        spans = (-(-one.stop // n) - one.start // n for one, n in zip(place, self.chunks, strict=True))
        self.count += int(np.prod(list(spans)))
        return self._data[place]


def test_what_is_missing_is_read_once(device: Device) -> None:
    """Each frame read every chunk again that it met, beside coefficients that were there."""
    stored = _Counting(ball(), (8, 8, 8))
    options: dict[str, Any] = suited("mip", DRAWN)
    with Renderer(LazyVolume(stored), "linear", device=device) as renderer:
        first = renderer.render(CAMERA, "mip", SIZE, 0.8, **options)
        stored.count = 0
        np.testing.assert_array_equal(renderer.render(CAMERA, "mip", SIZE, 0.8, **options), first)
    assert stored.count == 0


def _stored(kind: str, data: np.ndarray[Any, Any], folder: Path) -> tuple[Path, Path, int]:
    """A volume in chunks of 8³: what to open, and the file and place of the last chunk of the first eight."""
    if kind == "hdf5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(folder / "v.h5", "w") as file:
            at = file.create_dataset("v", data=data, chunks=(8, 8, 8), compression="gzip", fletcher32=True).id
            (info,) = (one for one in map(at.get_chunk_info, range(at.get_num_chunks())) if one.chunk_offset == (8, 8, 8))
        return folder / "v.h5", folder / "v.h5", info.byte_offset
    if kind == "tiff":
        tifffile = pytest.importorskip("tifffile")
        pytest.importorskip("imagecodecs")
        tifffile.imwrite(folder / "v.tif", data, tile=(8, 16, 16), volumetric=True, compression="zlib", photometric="minisblack")
        with tifffile.TiffFile(folder / "v.tif") as opened:
            return folder / "v.tif", folder / "v.tif", opened.pages[0].dataoffsets[0]
    zarr = pytest.importorskip("zarr")
    own: dict[str, Any] = {"shards": (16, 16, 16)} if kind == "sharded" else {}
    zarr.create_array(folder / "v.zarr", data=data, chunks=(8, 8, 8), zarr_format=2 if kind == "zarr2" else 3, **own)
    file = folder / "v.zarr" / {"zarr2": "1.1.1", "zarr3": "c/1/1/1", "sharded": "c/0/0/0"}[kind]
    place = int(np.frombuffer(file.read_bytes()[-20:-12], "<u8")[0]) if kind == "sharded" else 0
    return folder / "v.zarr", file, place


@pytest.mark.one_in(6)
@pytest.mark.parametrize("kind", ["zarr2", "zarr3", "sharded", "hdf5", "tiff"])
def test_a_damaged_chunk_is_left_out_and_named(kind: str, device: Device, tmp_path: Path) -> None:
    """It made every picture of the store an error. Truth: the picture of the other samples in memory."""
    data = ball(12).astype(np.uint16)
    path, file, place = _stored(kind, data, tmp_path)
    content = bytearray(file.read_bytes())
    content[place : place + 12] = bytes(byte ^ 0x5A for byte in content[place : place + 12])
    file.write_bytes(content)
    options: dict[str, Any] = suited("mean", DRAWN) | {"filter": "catmull-rom", "device": device}
    lazy = clvol.open(path)
    with pytest.warns(clvol.ClvolWarning, match="cannot read .*; pictures leave its samples out"):
        got = render(lazy, CAMERA, "mean", SIZE, 0.8, **options)
    gone = np.zeros(data.shape, bool)
    gone[(np.s_[:8, :16, :16] if kind == "tiff" else np.s_[8:16, 8:16, 8:16])] = True
    want = render(replace(lazy.grid, data=data), CAMERA, "mean", SIZE, 0.8, mask=gone, **options)
    np.testing.assert_allclose(got, want, atol=1e-6)
    whole = render(replace(lazy.grid, data=data), CAMERA, "mean", SIZE, 0.8, **options)
    assert np.abs(np.asarray(whole) - want).max() > 0.01


def test_a_chunk_that_fails_only_when_it_is_drawn_is_left_out_too(device: Device) -> None:
    data, bad = ball(12).astype(np.uint8), {"at": 99}

    class Failing(_Counting):
        def __getitem__(self, place: tuple[slice, ...]) -> Any:
            if all(one.start <= bad["at"] < one.stop for one in place):
                raise OSError("bad sector")
            return super().__getitem__(place)

    options: dict[str, Any] = suited("mean", DRAWN)
    with Renderer(LazyVolume(Failing(data, (8, 8, 8))), "catmull-rom", device=device) as renderer:
        whole = renderer.render(CAMERA, "mean", SIZE, 0.8, **options)
        renderer.field.drop()
        bad["at"] = 11
        with pytest.warns(clvol.ClvolWarning, match="bad sector; pictures leave its samples out"):
            got = renderer.render(CAMERA, "mean", SIZE, 0.8, **options)
    mask = np.zeros(data.shape, bool)
    mask[8:16, 8:16, 8:16] = True
    want = render(data, CAMERA, "mean", SIZE, 0.8, mask=mask, filter="catmull-rom", device=device, **options)
    np.testing.assert_allclose(got, want, atol=1e-6)
    assert np.abs(np.asarray(whole) - want).max() > 0.01


def test_slices_leave_missing_samples_out(device: Device) -> None:
    data = ball()
    options: dict[str, Any] = {"filter": "linear", "window": (15, 10), "background": None, "device": device}
    want = section(Volume(data).filled(), CENTER, (1, 0, 0), (0, 1, 0), (0.5, 0.5), (40, 40), **options)
    got = section(data, CENTER, (1, 0, 0), (0, 1, 0), (0.5, 0.5), (40, 40), **options)
    v, u = (np.indices((40, 40)) + 0.5 - 20) * 0.5
    away = np.hypot(u, v)
    assert (got[away < RADIUS - 1, 3] == 1).all()
    assert (got[away > RADIUS + 1, 3] == 0).all()
    assert want[..., 3].min() == 1
    assert np.abs(got[..., 0] - (0.5 + u / (2 * RADIUS)))[away < RADIUS - 1].max() < 1e-3


def test_errors_say_what_is_allowed(device: Device) -> None:
    empty = np.full((6, 6, 6), np.nan, np.float32)
    with pytest.raises(DataError, match="no sample of the volume is finite"):
        Renderer(empty, device=device)
    with pytest.raises(DataError, match="no sample of the volume is finite"):
        Renderer(np.zeros((6, 6, 6), np.uint8), mask=np.ones((6, 6, 6), bool), device=device)
    with pytest.raises(DataError, match="mask must have the shape of the samples"):
        Renderer(np.zeros((6, 6, 6)), mask=np.ones((6, 6), bool), device=device)
    with pytest.raises(DataError, match="mask must be boolean"):
        Renderer(np.zeros((6, 6, 6)), mask=np.ones((6, 6, 6)), device=device)
    lazy = LazyVolume(np.zeros((6, 6, 6)))
    with pytest.raises(DataError, match="mask must have the shape of the samples"):
        Renderer(lazy, mask=np.zeros((6, 6), bool), device=device)
    with pytest.raises(DataError, match="mask must be boolean"):
        Renderer(lazy, mask=LazyVolume(np.ones((6, 6, 6))), device=device)
    with pytest.raises(DataError, match="no sample of the volume is finite"):
        Renderer(lazy, mask=np.ones((6, 6, 6), bool), device=device)
    with pytest.raises(DataError, match=r"missing=value"):
        LazyVolume(np.full((4, 4, 4), np.nan)).whole()
    with Field(holes(), "linear", device=device, nan="propagate") as field, pytest.raises(OptionError, match='nan="local"'):
        Renderer(field)
    with (
        Field(holes(), "linear", device=device, nan=Missing("local")) as field,
        pytest.raises(OptionError, match="mask takes a volume, of"),
    ):
        Renderer(field, mask=np.isnan(holes().data))
