"""Regions of labels with smooth boundaries: against balls, the reference, and what is refused."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import DataError, OptionError
from clvol.device import Device
from clvol.reference.march import march
from tests.march.test_bricks import Known

BALL, MIDDLE = 9.4, (12.1, 11.7, 12.3)  # samples; x, y, z


def _labels() -> clvol.Volume:
    """Blocks of four labels at random, a hidden one among them, with nothing around."""
    blocks = np.kron(np.random.default_rng(3).integers(0, 4, (3, 3, 3)), np.ones((3, 3, 3)))
    return clvol.Volume((5 * np.pad(blocks, 3)).astype(np.int32), spacing=(1, 1.2, 1.7), labels={5: "one", 10: "two", 15: "three"})


def _shown(volume: clvol.Volume) -> clvol.TransferFunction:
    """One label opaque, one translucent, one hidden."""
    own = clvol.TransferFunction.preset("labels", volume)
    return own.with_opacity([(0, 0), (4, 0), (5, 0.4), (9, 0.4), (10, 0), (14, 0), (15, 1)])


@pytest.mark.one_in(2)
@pytest.mark.parametrize("spacing", [(1, 1, 1), (1, 1, 5)])
def test_a_ball_is_where_it_is(device: Device, spacing: tuple[float, float, float]) -> None:
    """A ball in samples, within 0.11 of them (RMS), and normals in the world within 8 degrees (mean); from six sides."""
    z, y, x = np.indices((25, 24, 25))
    inside = (x - MIDDLE[0]) ** 2 + (y - MIDDLE[1]) ** 2 + (z - MIDDLE[2]) ** 2 < BALL**2
    volume = clvol.Volume(np.where(inside, 7, 0).astype(np.uint8), spacing=spacing, labels=True)
    away, turned, ways = [], [], []
    with clvol.Renderer(volume, device=device) as renderer:
        for azimuth, elevation in ((0, 0), (90, 0), (180, 0), (270, 0), (0, 90), (0, -90)):
            camera = clvol.Camera.orbit(azimuth, elevation)
            seen = renderer.render(camera, "regions", (48, 48), outputs=["position", "normal"])
            hit = np.isfinite(seen["position"]).all(-1)
            across = volume.world_to_index(seen["position"][hit]) - MIDDLE
            away.append(np.linalg.norm(across, axis=1) - BALL)
            ways.append(across / np.linalg.norm(across, axis=1)[:, None])
            true = across / spacing
            cosine = (true / np.linalg.norm(true, axis=1)[:, None] * seen["normal"][hit]).sum(1)
            turned.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    k = np.arange(1000)  # even directions in samples, and what was seen nearest to each
    height, turn = (2 * k + 1) / k.size - 1, k * np.pi * (3 - np.sqrt(5))
    even = np.stack([*(np.sqrt(1 - height**2) * (np.cos(turn), np.sin(turn))), height])
    seen_at = np.concatenate(ways)
    nearest = (seen_at @ even).argmax(0)
    off, angle = np.sqrt((np.concatenate(away)[nearest] ** 2).mean()), np.concatenate(turned)[nearest].mean()
    print(f"{spacing}: {off:.4f} samples, {angle:.2f} degrees")
    assert off <= 0.11, f"{off:.4f} samples"
    assert angle <= 8, f"{angle:.2f} degrees"


@pytest.mark.parametrize("cut", [False, True])
def test_as_the_reference_draws_them(device: Device, cut: bool) -> None:
    """Each boundary is enclosed to 1e-4 samples: positions within 2e-4, normals and colours within 2e-3."""
    volume = _labels()
    look = {
        "size": (18, 14),
        "background": None,
        "outputs": ["rgba", "depth", "normal", "position"],
        "transfer": _shown(volume),
        "clip": clvol.Plane((0.3, -1, 0.2), volume.center) if cut else None,
    }
    camera = clvol.Camera.orbit(25, 35, zoom=2)
    want = march.render(volume, camera, "regions", "bspline5-approx", **look)  # type: ignore[arg-type]
    got = clvol.render(volume, camera, "regions", device=device, rays=1, **look)  # type: ignore[call-overload]
    assert isinstance(want, dict)
    assert np.isfinite(want["depth"]).sum() > 50
    for name, most in {"rgba": 2e-3, "depth": 2e-4, "normal": 2e-3, "position": 2e-4}.items():
        np.testing.assert_allclose(got[name], want[name], rtol=0, atol=most, err_msg=name)


def test_skipping_and_labels_change_nothing_else(device: Device) -> None:
    """What is skipped is not seen, with and without hidden labels; `clvol.labels.only` isolates one."""
    volume = _labels()
    look = {"size": (40, 40), "mode": "regions", "outputs": ("rgba", "depth")}  # as above, which compiles nothing anew
    with clvol.Renderer(volume, device=device) as renderer:
        whole = renderer.render(**look)["rgba"]  # type: ignore[call-overload]
        np.testing.assert_array_equal(renderer.render(skipping=False, **look)["rgba"], whole)  # type: ignore[call-overload]
        hidden = renderer.render(transfer=_shown(volume), **look)["rgba"]  # type: ignore[call-overload]
        np.testing.assert_array_equal(renderer.render(transfer=_shown(volume), skipping=False, **look)["rgba"], hidden)  # type: ignore[call-overload]
    alone = clvol.render(clvol.labels.only(volume, [5]), device=device, **look)["rgba"]  # type: ignore[call-overload]
    assert 0 < (alone[..., :3].max(-1) > 0).sum() < (whole[..., :3].max(-1) > 0).sum()


@pytest.mark.parametrize("cut", [False, True])
def test_by_bricks_the_same_bits(device: Device, cut: bool) -> None:
    """In bricks of 8 samples, cut open or not, with and without skipping and hidden labels; big-endian and negative ones."""
    labels = _labels()
    volume = clvol.Volume((labels.data - 5).astype(">i2"), labels.spacing, labels=True)
    lazy = clvol.LazyVolume(volume.data, volume.spacing, labels=True)
    own = clvol.TransferFunction.preset("labels", volume)
    corner = clvol.Corner((-np.inf, 8, -np.inf), (6, np.inf, 13))  # rays of several parts
    clip = [clvol.Plane((0.3, -1, 0.2), volume.center), corner] if cut else None
    look = {"size": (40, 40), "mode": "regions", "outputs": ("rgba", "depth", "normal"), "clip": clip}
    with (
        clvol.Renderer(volume, device=device) as whole,
        clvol.BrickedField(lazy, "bspline5-approx", device=device, edge=8) as field,
        clvol.Renderer(field) as bricked,
    ):
        with clvol.Renderer(lazy, device=device) as other:
            assert other.shown.filter.name == "nearest", "other modes blend no labels either"
        for transfer in (None, own.with_opacity([(-5, 1), (-1, 1), (0, 0.4), (4, 0.4), (5, 0), (9, 0), (10, 1)])):
            want = whole.render(transfer=transfer, **look)  # type: ignore[call-overload]
            assert np.isfinite(want["depth"]).sum() > 200
            for skipping in (True, False):
                got = bricked.render(transfer=transfer, skipping=skipping, **look)  # type: ignore[call-overload]
                for name in want:
                    np.testing.assert_array_equal(got[name], want[name], err_msg=f"{name}, skipping {skipping}")


class _Kept(Known):
    """Bounds of labels, as `clvol.pyramid` keeps them."""

    filter = "nearest"


def test_bricks_in_which_nothing_is_shown_are_not_read(device: Device) -> None:
    """By kept bounds of the samples, which reach as far as the filter; smaller levels have labels too."""
    data = np.zeros((48, 48, 48), np.uint8)
    data[8:16, 8:16, 8:16], data[32:40, 8:16, 8:16] = 7, 3
    level = clvol.LazyVolume(data[::2, ::2, ::2], (2, 2, 2), labels=True)
    volume = clvol.LazyVolume(data, labels=True, limits=(0, 7), bounds=_Kept(data), levels=[level])
    one = clvol.TransferFunction.preset("labels", clvol.Volume(data, labels=True)).with_opacity([(0, 0), (6, 0), (7, 1)])
    look = {
        "camera": clvol.Camera.look_at((90, 60, 80), (24, 12, 12)),
        "size": (40, 40),
        "mode": "regions",
        "outputs": ("rgba", "depth", "normal"),
    }
    with clvol.BrickedField(volume, "bspline5-approx", device=device, edge=8) as field, clvol.Renderer(field) as renderer:
        for bricks, shown in ((27, one), (2 * 27, None)):
            got, want = (
                made(transfer=shown, **look)  # type: ignore[operator]
                for made in (renderer.render, partial(clvol.render, clvol.Volume(data, labels=True), device=device))
            )
            for name in want:
                np.testing.assert_array_equal(got[name], want[name], err_msg=name)
            shown_by = renderer.shown
            assert isinstance(shown_by, clvol.BrickedField)
            assert 0 < shown_by.reads.bricks <= bricks, f"of {len(shown_by.bricks)}: others are hidden"
        coarse = renderer.render(lod=9, **look)  # type: ignore[call-overload]
        assert renderer.shown.grid.shape == level.shape
        np.testing.assert_array_equal(coarse["rgba"], clvol.render(level.whole(), device=device, **look)["rgba"])  # type: ignore[call-overload]


def test_refusals(device: Device) -> None:
    volume, look = _labels(), {"mode": "regions", "size": (8, 8), "device": device}
    with pytest.raises(OptionError, match="takes labels"):
        clvol.render(clvol.phantoms.marschner_lobb(8), **look)  # type: ignore[call-overload]
    with pytest.raises(OptionError, match="without a prefilter"):
        clvol.render(volume, filter="bspline3", **look)  # type: ignore[call-overload]
    with pytest.raises(OptionError, match="a scene of 2 media"):
        clvol.render(clvol.Scene([clvol.Medium(volume), clvol.Medium(volume)]), **look)  # type: ignore[call-overload]
    with pytest.raises(OptionError, match="a medium with color_by"):
        clvol.render(clvol.Medium(volume, color_by=volume), **look)  # type: ignore[call-overload]
    with pytest.raises(DataError, match=r"whole numbers; got 1\.5"):
        clvol.render(clvol.Volume(volume.data / 10.0, labels=True), **look)  # type: ignore[call-overload]
    with pytest.raises(DataError, match="up to 2"):
        clvol.render(clvol.Volume(volume.data + (1 << 24), labels=True), **look)  # type: ignore[call-overload]
    lazy: list[tuple[type[Exception], str, Any, dict[str, Any]]] = [
        (DataError, r"whole numbers; got 1\.5", volume.data / 10.0, {}),
        (DataError, "up to 2.*: renumber", np.full((8, 8, 8), -1, np.int8).astype(np.uint64), {}),
        (OptionError, "lacks samples", np.where(volume.data > 0, volume.data, np.nan), {}),
        (OptionError, "step must be at most 3 for boundaries of regions", volume.data, {"step": 4}),
    ]
    for error, words, data, options in lazy:
        with pytest.raises(error, match=words):
            clvol.render(clvol.LazyVolume(data, labels=True), outputs=["depth"], **look, **options)  # type: ignore[call-overload]
    with pytest.raises(OptionError, match="gradient changes nothing in regions"):
        clvol.render(volume, gradient="central", **look)  # type: ignore[call-overload]
