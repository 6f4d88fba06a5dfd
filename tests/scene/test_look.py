"""Look options and presets: each keyword changes what it names, and nothing else."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolWarning, OptionError
from clvol.device import Device
from clvol.reference.march.march import render as render_reference
from clvol.scene.camera import Camera
from clvol.scene.fit import usual_camera
from clvol.scene.look import look
from clvol.scene.mode import modes
from clvol.scene.preset import label_color
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume

Z, Y, X = np.indices((20, 20, 20))
FAR = np.hypot(np.hypot(X - 9.5, Y - 9.5), Z - 9.5)
NOISE = np.random.default_rng(3).normal(0, 1, FAR.shape)
SCAN = Volume(np.where(FAR < 8, 100 + 40 * (FAR < 4), 10) + 3 * NOISE)
CT = Volume(np.where(FAR < 8, np.where(FAR < 4, 900, 40), -1000) + 20 * NOISE)
LABELS = Volume(np.where(FAR < 4, 7, np.where(FAR < 8, 2, 0)).astype(np.uint16), labels={2: "a", 7: "b"})


@pytest.mark.parametrize("mode", modes())
@pytest.mark.parametrize("volume", [SCAN, LABELS], ids=["scan", "labels"])
def test_without_options_the_mode_decides(volume: Volume, mode: str) -> None:
    assert look(volume, mode) == modes()[mode].transfer(volume)


def test_each_keyword_changes_what_it_names() -> None:
    own = look(SCAN, "composite")
    colored = look(SCAN, "composite", cmap="viridis")
    assert colored.opacities == own.opacities
    assert colored.value_range == own.value_range
    np.testing.assert_allclose(colored(own.value_range[0])[:3], [0.267, 0.005, 0.329], atol=5e-3)
    thinner = look(SCAN, "composite", opacity=0.5)
    assert thinner.colors == own.colors
    at = np.linspace(*SCAN.value_range, 50)
    np.testing.assert_allclose(thinner(at)[:, 3], 0.5 * own(at)[:, 3])
    assert look(SCAN, "composite", opacity=100.0)(150)[3] == 1
    points = ((50.0, 0.0), (150.0, 1.0))
    assert look(SCAN, "composite", opacity=points) == own.with_opacity(points)
    both = look(SCAN, "composite", cmap="viridis", opacity=points)
    assert (both.colors, both.opacities) == (colored.colors, points)


@pytest.mark.parametrize("mode", ["composite", "mip", "minip", "mean"])
def test_a_window_is_a_center_and_a_width(mode: str) -> None:
    assert look(SCAN, mode, window=(80, 100)).value_range == (30, 130)


def test_the_volumes_clim_is_used() -> None:
    wanted = replace(SCAN, clim=(-50.0, 120.0))
    assert look(wanted, "mip").value_range == (-50, 120)
    assert look(wanted, "mip", window=(80, 100)).value_range == (30, 130)
    own, windowed = look(SCAN, "composite"), look(wanted, "composite")
    assert windowed.value_range == (own.value_range[0], 120)  # background is not seen
    assert look(replace(SCAN, clim=(200.0, 300.0)), "composite") == own  # nothing lies there
    signed = np.where(np.abs(NOISE) > 1, 3 * NOISE, 0)
    assert look(Volume(signed, clim=(4.0, 6.0)), "composite")([-6, -3.5, 0, 3.5, 6])[:, 3] == pytest.approx(
        [0.9, *look(Volume(signed, clim=(4.0, 6.0)), "composite")([-3.5, 0])[:, 3], 0.09, 0.9], abs=0.05
    )


def test_a_channel_has_the_colour_of_its_light() -> None:
    green = replace(SCAN, color="lime")
    brightest = look(green, "mip")(1e6)[:3]
    np.testing.assert_array_equal(brightest, (0, 1, 0))
    shade = look(green, "composite")(120)[:3]
    assert shade[1] > shade[0] == shade[2]


def test_few_samples_are_visible() -> None:
    fine, coarse = (Volume(np.arange(n**3).reshape(n, n, n) % 7.0, spacing=(64 / n,) * 3) for n in (64, 16))
    assert look(fine, "composite").unit_distance is None
    assert look(coarse, "composite").unit_distance == pytest.approx(1, rel=0.02)


def test_each_label_has_one_colour() -> None:
    for mode in ("composite", "mip", "minip"):
        chosen = look(LABELS, mode)
        for number in (2, 7):
            within = chosen(np.linspace(number - 0.49, number + 0.49, 9))
            np.testing.assert_allclose(within, [(*label_color(number), 1.0)] * 9)
        assert (chosen([-1, 0, 0.4])[:, 3] == 0).all()
    # thousands are no less exact
    many = Volume(np.arange(27_000).reshape(30, 30, 30) % 5000, labels=True)
    assert look(many, "composite").block(1.0)["pieces"] > 4900
    colors = np.array([label_color(n) for n in range(1, 64)])
    apart = np.abs(colors[:, None] - colors).max(-1) + np.eye(63)
    assert apart.min() > 0.02
    assert np.abs(np.diff(colors, axis=0)).max(1).min() > 0.25  # neighbours differ clearly


def test_labels_of_any_dtype_have_colours() -> None:
    for data in (LABELS.data.astype(">i4"), LABELS.data.astype(np.float64), LABELS.data.astype(np.uint64) * 2**30):
        numbers = np.unique(data).astype(np.float64)
        chosen = look(Volume(data, labels=True), "composite")
        np.testing.assert_allclose(chosen(numbers)[1:], [(*label_color(int(n)), 1) for n in numbers[1:]])
        assert chosen(0)[3] == 0
    gaps = np.where(FAR < 2, np.nan, LABELS.data)
    assert look(Volume(gaps, labels=True), "composite") == look(LABELS, "composite")


def test_labels_are_not_blended_in_pictures(device: Device) -> None:
    picture = clvol.render(LABELS, size=(40, 40), shading=False, device=device)[..., :3]
    shown = {tuple(color) for color in picture.reshape(-1, 3).round(3).tolist()}
    assert shown == {tuple(np.float32(color).round(3).tolist()) for color in ((0, 0, 0), label_color(2))}


@pytest.mark.parametrize("name", clvol.presets())
@pytest.mark.parametrize("mode", ["composite", "mip", "mean"])
def test_presets_show_matter_and_hide_air(name: str, mode: str) -> None:
    row, volume = clvol.presets()[name], LABELS if name == "labels" else CT
    assert row.name == name
    assert row.description
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = look(volume, mode, preset=name)
    if mode == "composite":
        assert chosen == clvol.TransferFunction.preset(name, volume)
        seen = chosen(np.linspace(*volume.value_range, 500))
        assert seen[0, 3] == 0 or name == "stat-map"  # which shows what is far below 0
        assert seen[:, 3].max() > 0.05


def test_presets_of_computed_tomography_are_in_hounsfield_units() -> None:
    bone = look(CT, "composite", preset="ct-bone")
    assert bone([-1000, 40, 100])[:, 3].max() == 0
    assert bone(900)[3] > 0.5
    assert look(CT, "mip", preset="ct-soft-tissue").value_range == (-160, 240)
    moved = look(CT, "composite", preset="ct-bone", window=(1000, 200))
    assert moved.value_range == (900, 1100)
    with pytest.warns(ClvolWarning, match="preset 'ct-bone' is in Hounsfield units, .* samples from .* are not"):
        spread = look(SCAN, "composite", preset="ct-bone")
    assert spread(10)[3] == 0
    assert spread(140)[3] > 0.5


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "preset": ({"preset": "ct-bones"}, "preset must be one of ct-bone, ct-soft-tissue, .*, labels; got 'ct-bones'"),
    "no name": ({"preset": 3}, "preset must be one of"),
    "window": ({"window": (100, 0)}, r"window must be two finite numbers, \(center, width\), the width positive; got \(100, 0\)"),
    "one number": ({"window": 5}, "window must be two finite numbers"),
    "too narrow": ({"window": (1e300, 1.0)}, "wide enough"),
    "cmap": ({"cmap": "nomap"}, "colour map 'nomap' is not known"),
    "opacity": ({"opacity": -1}, "opacity must be a finite number, at least 0; got -1"),
    "points": ({"opacity": [(0, 2)]}, r"opacities must be in 0..1; got \[2.0\]"),
    "a window of labels": ({"preset": "labels", "window": (1, 2)}, "window must not be given for the preset 'labels'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors(case: str) -> None:
    options, message = WRONG[case]
    with pytest.raises(OptionError, match=message):
        look(SCAN, "composite", **options)


def test_a_preset_that_shows_nothing_of_a_volume_says_so() -> None:
    """A soft scan in the preset of bone was black without a word; other samples than labels became labels."""
    soft = Volume(np.linspace(-1000, 120, 1000).reshape(10, 10, 10).astype(np.int16))
    with pytest.warns(ClvolWarning, match=r"preset 'ct-bone' shows values from about 300 on, .* -1000 to 120: nothing is seen"):
        transfer = TransferFunction.preset("ct-bone", soft)
    assert transfer.opacity_within(-1000, 120) == 0
    with pytest.warns(ClvolWarning, match="preset 'labels' is for labels, and the samples look like none"):
        TransferFunction.preset("labels", Volume(np.random.default_rng(0).random((8, 8, 8))))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        TransferFunction.preset("ct-skin", soft)
        TransferFunction.preset("mr-default", Volume(np.random.default_rng(0).random((8, 8, 8))))
        TransferFunction.preset("labels", Volume(np.arange(8).reshape(2, 2, 2), labels=True))


def test_a_statistical_map_shows_what_is_significant() -> None:
    """Beyond 3 on both sides, in warm and cold colours, whatever else the values are; less is no warning of its own."""
    t = Volume(np.linspace(-9, 12, 512).reshape(8, 8, 8))
    found = look(t, "composite", preset="stat-map")
    values = np.array([-8.0, -4.0, -3.0, -2.9, 0.0, 2.9, 3.0, 4.0, 8.0])
    red, _, blue, opacity = found(values).T
    assert opacity.tolist() == pytest.approx([0.9, 0.2467, 0, 0, 0, 0, 0, 0.2467, 0.9], abs=1e-3)
    assert (red > blue).tolist()[-2:] == [True, True]
    assert (red < blue).tolist()[:2] == [True, True]
    assert look(t, "mip", preset="stat-map").value_range == (0, 8)
    with pytest.warns(ClvolWarning, match="about -3.5 and 3.5 on, and samples are from -1 to 1: nothing is seen"):
        look(Volume(np.linspace(-1, 1, 64).reshape(4, 4, 4)), "composite", preset="stat-map")


def viridis(transfer: TransferFunction) -> bool:
    """Whether colours are those of the perceptual map, and half transparent."""
    (_, first), *_, (_, last) = transfer.colors
    return bool(np.abs(np.subtract(first, (0.27, 0, 0.33))).max() < 0.02 and transfer.opacities[-1][1] < 0.2 and last[0] > 0.9)


def test_simulations_show_their_values() -> None:
    speed = np.hypot(np.sin(X / 3) + np.cos(Y / 4), np.cos(Z / 5) + 0.3 * np.sin(X / 5))
    for spacing in ((1, 1, 1), (1, 1, 3)):
        assert viridis(TransferFunction.automatic(Volume(speed, spacing=spacing)))
    assert viridis(TransferFunction.automatic(Volume(np.where(FAR < 8, 1 + speed, 0.0))))  # in a vacuum
    measured: dict[str, Volume] = {
        "noise": SCAN,
        "whole numbers": Volume(np.round(1000 * speed).astype(np.int16)),
        "a patient": Volume(speed, space="LPS"),
        "a stack": Volume(speed, space="image"),
        "a channel": Volume(speed, color="red"),  # type: ignore[arg-type]  # a name
        "a masked scan": Volume(np.where(FAR < 8, SCAN.data, 0.0)),
        "a mask": Volume((FAR < 8).astype(float) + 0.5 * (FAR < 4)),
        "both signs": Volume(np.sin(X / 3) * np.sin(Y / 3) * np.sin(Z / 3)),
    }
    assert not [name for name, volume in measured.items() if viridis(TransferFunction.automatic(volume))]


def test_thin_stacks_are_seen_from_above_and_glow() -> None:
    spots = np.maximum(0, 200 - 60 * FAR[8:12]) + 3 * np.abs(NOISE[8:12])
    stack = Volume(spots, space="image")
    for depth, elevation in ((0.01, 90), (1.0, 62), (1.25, 55)):
        camera = usual_camera(replace(stack, spacing=(1, 1, depth)))
        assert np.degrees(np.arcsin(-camera.direction[2])) == pytest.approx(elevation, abs=0.5)
    assert usual_camera(replace(stack, spacing=(1, 1, 2))) == usual_camera(replace(stack, space="")) == Camera.orbit()
    green = [color for _, color in TransferFunction.automatic(stack).colors]
    assert all(g > max(r, b) for r, g, b in green)
    for other in (replace(stack, data=250 - spots), replace(stack, space=""), replace(stack, color="red")):  # type: ignore[arg-type]
        assert [color for _, color in TransferFunction.automatic(other).colors] != green


def test_surfaces_of_labels_have_their_colors(device: Device) -> None:
    for method in ("exact", "stepped"):
        got = clvol.render(LABELS, mode="isosurface", method=method, size=(40, 40), shading=False, device=device, rays=1)
        lit = {tuple(np.round(pixel, 3)) for pixel in got[got[..., 3] > 0][:, :3].tolist()} - {(0, 0, 0)}
        assert lit == {tuple(np.round(label_color(2), 3))}
    want = render_reference(LABELS, None, "isosurface", "nearest", size=(40, 40), outputs="rgba")
    shaded = clvol.render(LABELS, mode="isosurface", size=(40, 40), device=device, rays=1)
    assert np.abs(shaded - want).max() < 1e-5
    red = clvol.render(LABELS, mode="isosurface", color="red", shading=False, size=(8, 8), device=device)
    np.testing.assert_array_equal(red[4, 4, :3], [1, 0, 0])
    with pytest.raises(OptionError, match="takes a volume of labels"):
        clvol.render(SCAN, mode="isosurface", color_by="label", device=device)
    with pytest.raises(OptionError, match="color_by must be one of"):
        clvol.Surfaces(color_by="label")  # type: ignore[arg-type]
