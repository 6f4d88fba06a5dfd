"""Several rays per pixel: the picture stays in place, under the requested filter. Truth: Fourier transforms, here."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Renderer, TransferFunction, Volume
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.filter.table import as_filter, filters
from clvol.march.pixels import EDGE_RAYS, on_edges, pixel_rays

SIZE = (32, 24)
FRONT = Camera(direction=(0.0, 1.0, 0.0), projection="orthographic", fit="volume")
PIXEL_FILTERS = [row.name for row in filters().values() if not row.prefilter and not row.magnified_by]


def waves(per_pixel: float, size: tuple[int, int] = SIZE, voxels: int = 4) -> tuple[Volume, Camera]:
    """A cosine with the given waves per pixel along x, seen with pixels `voxels` wide; its crest at the centre."""
    n = voxels * (size[0] + 12)
    x = np.arange(n) - (n - 1) / 2
    volume = Volume(np.broadcast_to(0.5 + 0.5 * np.cos(2 * np.pi * per_pixel * x / voxels), (n, 2, n)).astype(np.float32))
    height = FRONT.view(volume, size[0] / size[1]).half_height
    return volume, Camera(direction=FRONT.direction, projection="orthographic", zoom=height / (size[1] * voxels / 2), fit="volume")


def drawn(volume: Volume, camera: Camera, device: Device, **options: Any) -> np.ndarray[Any, Any]:
    look: dict[str, Any] = {"transfer": TransferFunction.ramp((0, 1)), "size": SIZE, "device": device}
    return np.asarray(clvol.render(volume, camera, "mean", **{**look, **options})[..., 0], np.float64)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 9, 16, 64])
def test_several_rays_do_not_shift_the_picture(device: Device, count: int) -> None:
    """A linear picture is unchanged. (It was shifted by up to 0.22 pixel, here 0.7 %.)"""
    n = 64
    z, _, x = np.meshgrid(np.arange(n), np.arange(2), np.arange(n), indexing="ij")
    volume = Volume(((x + 2 * z) / (3 * n)).astype(np.float32))
    camera = Camera(direction=(0.0, 1.0, 0.0), projection="orthographic", zoom=3.0, fit="volume")
    one = drawn(volume, camera, device)
    got = drawn(volume, camera, device, rays=count)
    assert one.std() > 0.05
    np.testing.assert_allclose(got, one, atol=2e-6)


def response(name: str, f: float) -> float:
    """The Fourier transform of a kernel, by the midpoint rule, or in closed form where it has one."""
    degree = {"nearest": 1, "linear": 2, "bspline2-approx": 3, "bspline3-approx": 4}.get(name)
    if degree is not None:
        return float(np.sinc(f) ** degree)
    half = as_filter(name).support / 2
    x = (np.arange(20_000) + 0.5) / 20_000 * 2 * half - half
    k = as_filter(name)(x)
    return float((k * np.cos(2 * np.pi * f * x)).sum() / k.sum())


@pytest.mark.one_in(15)
@pytest.mark.parametrize("f", [0.1, 0.25, 0.4, 0.8])
@pytest.mark.parametrize("name", ["nearest", "linear", "bspline2-approx", "bspline3-approx", "mitchell", "catmull-rom", "lanczos3"])
def test_waves_are_damped_by_the_filters_response(device: Device, name: str, f: float) -> None:
    volume, camera = waves(f, voxels=8)
    got = drawn(volume, camera, device, rays=512, pixel_filter=name)
    x = np.arange(SIZE[0]) + 0.5 - SIZE[0] / 2
    want = 0.5 + 0.5 * response(name, f) * np.cos(2 * np.pi * f * x)
    want = np.clip(want, 0, 1)
    loose = 0.02 if name == "lanczos3" else 6e-3  # lobes are sums of rays that count for and against
    np.testing.assert_allclose(got, np.broadcast_to(want, got.shape), atol=loose)


def zone_plate(count: int, name: str) -> tuple[float, float]:
    """RMS of the aliasing above half a wave per pixel, and of the loss below it, for rings up to 0.75 waves per pixel."""
    n = 192
    y, x = (np.mgrid[:n, :n] + 0.5 - n / 2).astype(float)

    def plate(dx: float, dy: float) -> np.ndarray[Any, Any]:
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * 1.5 / n * ((x + dx) ** 2 + (y + dy) ** 2)))

    rays = pixel_rays(count, as_filter(name), middle=False)
    picture = sum(weight * plate(*(offset - 0.5)) for offset, weight in rays)
    past = np.maximum(np.abs(x), np.abs(y)) * 1.5 / n > 0.5
    return float(np.sqrt(np.mean((picture[past] - 0.5) ** 2))), float(np.sqrt(np.mean((picture[~past] - plate(0, 0)[~past]) ** 2)))


@pytest.mark.parametrize("count", [4, 9, 16, 64])
def test_the_default_leaves_less_aliasing_than_the_pixels_square(count: int) -> None:
    square, tent = zone_plate(count, "nearest"), zone_plate(count, "linear")
    assert tent[0] < (0.5 if count >= 16 else 0.67) * square[0]
    assert tent[1] < 1.7 * square[1]


@pytest.mark.parametrize("count", [16, 32, 64, 256])
def test_lobes_need_about_64_rays(count: int) -> None:
    tent, lobed = zone_plate(count, "linear"), zone_plate(count, "mitchell")
    for mine, other in zip(lobed, tent, strict=True):
        assert mine < (1 if count >= 64 else 1.1) * other


@pytest.mark.parametrize("name", PIXEL_FILTERS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16, 33, 256])
def test_ray_patterns_are_even_and_within_the_filter(count: int, name: str) -> None:
    row = as_filter(name)
    rays = pixel_rays(count, row, middle=False)
    offsets, weights = np.array([offset for offset, _ in rays]), np.array([weight for _, weight in rays])
    np.testing.assert_allclose(weights.sum(), 1, atol=1e-12)
    np.testing.assert_allclose(weights @ offsets, [0.5, 0.5], atol=1e-12)
    assert np.abs(offsets - 0.5).max() <= row.support / 2
    for axis in (0, 1):  # no two rays share a row or a column
        assert np.unique(offsets[:, axis].round(9)).size == count
    turned = {tuple(np.round(1 - offset, 9)) for offset in offsets}
    assert turned == {tuple(np.round(offset, 9)) for offset in offsets}
    x = np.linspace(-row.support / 2, row.support / 2, 40_001)
    if count >= 16 and row(x).min() >= 0:
        wanted = (row(x) * x**2).sum() / row(x).sum()
        np.testing.assert_allclose(weights @ (offsets - 0.5) ** 2, wanted, rtol=0.08)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("count", [2, 3, 4, 16])
def test_guides_belong_to_the_ray_through_the_centre(device: Device, count: int) -> None:
    volume = clvol.phantoms.sphere(20)
    with Renderer(volume, device=device) as renderer:
        guides: Any = ("depth", "normal", "position", "visited")
        want = renderer.render(None, "isosurface", SIZE, outputs=guides)
        got = renderer.render(None, "isosurface", SIZE, rays=count, outputs=guides)
        alone = renderer.render(None, "isosurface", SIZE, rays=count)
        beside = renderer.render(None, "isosurface", SIZE, rays=count, outputs=("rgba", "depth"))["rgba"]
    for name in guides:
        np.testing.assert_array_equal(got[name], want[name])
    np.testing.assert_array_equal(alone, beside)


def test_a_single_ray_has_no_filter(device: Device) -> None:
    volume = clvol.phantoms.sphere(20)
    for options in ({"rays": 1}, {"mode": "mip"}):
        with pytest.raises(clvol.OptionError, match=r"pixel_filter changes nothing in \w+: there is one ray a pixel"):
            clvol.render(volume, size=SIZE, pixel_filter="lanczos3", device=device, **options)  # type: ignore[arg-type]


def test_invalid_pixel_filters_are_rejected(device: Device) -> None:
    lopsided = clvol.Filter("lopsided", ((0.75,), (0.25,)))
    for choice, message in (
        ("bspline3", "pixel_filter must be a filter without a prefilter"),
        ("hybrid", "pixel_filter must be a filter without a prefilter"),
        (lopsided, "pixel_filter must be an even kernel"),
        ("gauss", "filter must be one of"),
    ):
        with pytest.raises(OptionError, match=message):
            clvol.render(np.ones((3, 3, 3)), size=(4, 4), rays=4, pixel_filter=choice, device=device)


def test_invalid_pixel_filters_are_rejected_before_any_work() -> None:
    """(It was rejected after the upload, which here finds a NaN.)"""
    data = np.full((3, 3, 3), np.nan)
    with pytest.raises(OptionError, match="pixel_filter must be a filter without a prefilter"):
        clvol.render(data, pixel_filter="bspline3")


def test_only_pixels_on_edges_get_more_rays(device: Device) -> None:
    volume = clvol.phantoms.sphere(20)
    with Renderer(volume, device=device) as renderer:
        for background in ("white", None):
            matte = clvol.Material(specular=0.0)  # nothing is brighter than white, which would be cut off
            look: dict[str, Any] = {"mode": "isosurface", "size": (61, 47), "background": background, "material": matte}
            one, more, many = (renderer.render(**look, rays=n) for n in (1, EDGE_RAYS, 64))
            auto = renderer.render(**look)
            edges = np.zeros(one.shape[:2], bool)
            edges[tuple(on_edges(one).T)] = True
            assert 50 < edges.sum() <= edges.size / 20
            np.testing.assert_array_equal(auto[~edges], one[~edges])
            np.testing.assert_allclose(auto[edges], more[edges], rtol=0, atol=1e-5)
            cover, wanted, roughly = (picture[edges][:, :1] * picture[edges][:, 3:] for picture in (auto, many, one))
            assert np.linalg.norm(cover - wanted) < 0.6 * np.linalg.norm(roughly - wanted)  # three rays, not one
            np.testing.assert_array_equal(renderer.render(**look, skipping=False), auto)
            with renderer.device.limited(launch_seconds=1e-9):
                np.testing.assert_array_equal(renderer.render(**look), auto)
            assert np.isinf(renderer.render(**look, outputs="depth")[0, 0])


def test_edges_are_jumps_of_luminance_or_opacity() -> None:
    picture = np.ones((30, 40, 4), np.float32)
    picture[..., :3] = 0.5
    assert len(on_edges(picture)) == 0
    picture[:, 20:, :3] = 0.7
    found = on_edges(picture, 1)
    assert set(found[:, 1]) == {19, 20}
    assert len(found) == 60
    picture[..., :3], picture[:15, :, 3] = 0.5, 0.0
    assert set(on_edges(picture, 1)[:, 0]) == {14, 15}
    picture[...] = 0.5
    picture[::2, ::2, :3] = 0.8
    picture[10, 10, :3] = 1.0
    strongest = on_edges(picture, 100)  # of 1200 pixels that differ
    assert {(10, 10), (9, 10), (11, 10), (10, 9), (10, 11)} == {tuple(p) for p in strongest.tolist()}
