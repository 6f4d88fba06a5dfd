from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import Camera, Light, OptionError, Volume, analysis, bspline, phantoms, reference, render
from clvol.analysis import EXACT_SINC
from clvol.device import Device
from clvol.figures import FIGURE_6, SIX, Panel, compare, figure6
from clvol.figures.panels import BACKGROUND, BOX, CAMERA, ISOVALUE, LIGHTS, MATERIAL, PANELS, SURFACE, fixed, shading_gradients
from clvol.filter.table import as_filter
from clvol.reference.march.exact import draw_function
from tests.cases import BAD_COUNTS, BAD_FILTER_LISTS

# of the Marschner-Lobb function at 40³, within 0.8 of the centre
RMS = {"bspline3": 0.0148, "linear": 0.0328, "mitchell": 0.0296, "bspline3-approx": 0.0451, "nearest": 0.0475}
PIXELS = 48


@pytest.fixture(scope="module")
def drawn(device: Device) -> tuple[list[Panel], np.ndarray]:
    return figure6(pixels=PIXELS, rays=1, device=device)


def panel(drawn: tuple[list[Panel], np.ndarray], name: str) -> Panel:
    return next(p for p in drawn[0] if p.filter == name)


def test_panels_are_the_papers_and_the_function_itself(drawn: tuple[list[Panel], np.ndarray]) -> None:
    panels, _ = drawn
    assert [p.filter for p in panels] == [*PANELS, "exact"]
    assert (*FIGURE_6, "sinc") == PANELS
    for p in panels:
        assert p.picture.shape == (PIXELS, PIXELS, 4)
        assert p.picture.dtype == np.float32
        assert np.isfinite(p.picture).all()
        assert p.picture[..., :3].std() > 0.05  # not empty
    assert panels[-1].rms is None
    assert panels[-1].angle is None


@pytest.mark.parametrize("name", RMS)
def test_errors_are_the_known_ones(drawn: tuple[list[Panel], np.ndarray], name: str) -> None:
    assert panel(drawn, name).rms == pytest.approx(RMS[name], rel=0.03)


@pytest.mark.parametrize("name", FIGURE_6)
def test_errors_match_the_reference(drawn: tuple[list[Panel], np.ndarray], name: str) -> None:
    points = np.random.default_rng(5).uniform(-0.8, 0.8, (6_000, 3))
    volume = phantoms.marschner_lobb(40)
    exact_sinc = name == EXACT_SINC
    values = analysis.dirichlet_sample(volume, points, "mirror") if exact_sinc else reference.sample(volume, points, name)
    rms = float(np.sqrt(np.mean((values - phantoms.marschner_lobb_function(points)) ** 2)))
    assert panel(drawn, name).rms == pytest.approx(rms, rel=0.05)  # other points, and not as many


def test_interpolation_has_the_smallest_error_after_the_sinc(drawn: tuple[list[Panel], np.ndarray]) -> None:
    panels, _ = drawn
    ours = panel(drawn, "bspline3")
    for p in panels[:-1]:
        assert p.rms is not None
        assert p.angle is not None
        if p is not ours:
            assert p.angle > ours.angle
            assert (p.rms < ours.rms) == (p.filter == EXACT_SINC)
    exact = panels[-1].picture[..., :3]
    differences = {p.filter: float(np.abs(p.picture[..., :3] - exact).mean()) for p in panels[:-1]}
    assert min(differences, key=lambda name: differences[name]) == "bspline3"


def test_the_exact_sinc_states_its_accuracy(drawn: tuple[list[Panel], np.ndarray]) -> None:
    sinc = panel(drawn, EXACT_SINC)
    assert sinc.residual == pytest.approx(9e-5, rel=0.2)
    assert sinc.label.startswith("a)  sinc, exact to about 9e-05\nRMS error 0.0145")
    assert [p.letter for p in drawn[0]] == [*"abcdefg", ""]
    assert all(p.residual is None for p in drawn[0][1:])


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_fixed_camera_sees_the_same_region_of_another_volume(projection: str) -> None:
    camera = Camera.orbit(40, 30, zoom=1.7, projection=projection, fit="volume")  # type: ignore[arg-type]
    volume, other = phantoms.sphere(9), phantoms.sphere(33).crop((4, 0, 0), (20, 33, 30))
    wanted, got = camera.view(volume), fixed(camera, volume, other).view(other)
    for key in ("eye", "right", "up", "forward", "half_height"):
        np.testing.assert_allclose(getattr(got, key), getattr(wanted, key), atol=1e-12)
    assert got.orthographic == wanted.orthographic


def test_the_exact_panel_matches_a_much_finer_volume(drawn: tuple[list[Panel], np.ndarray], device: Device) -> None:
    # the same box and camera; the domain of 161³ samples ends elsewhere, so the camera gets its place
    coarse, fine = phantoms.marschner_lobb(40), phantoms.marschner_lobb(161)
    view = CAMERA.view(coarse)
    camera = Camera(
        tuple(view.eye), tuple(view.eye + view.forward), tuple(view.up), fov=2 * np.degrees(np.arctan(view.half_height))
    )
    picture = render(
        fine,
        camera,
        "isosurface",
        filter="bspline5",
        size=(PIXELS, PIXELS),
        step=0.5,
        isovalue=ISOVALUE,
        color=SURFACE,
        lights=LIGHTS,
        material=MATERIAL,
        background=BACKGROUND,
        clip=((-1, -1, -1), (1, 1, 1)),
        device=device,
    )
    difference = np.abs(picture - drawn[0][-1].picture)[..., :3].max(-1)
    # silhouettes fall to one side or the other: pixels where the picture is smooth are compared
    shade = drawn[0][-1].picture[..., 0]
    steep = np.maximum(np.abs(np.gradient(shade, axis=0)), np.abs(np.gradient(shade, axis=1))) > 0.15
    assert steep.mean() < 0.5
    assert np.quantile(difference[~steep], 0.98) < 0.02
    assert np.median(difference) < 0.002


def test_the_sheet_shows_every_panel_with_its_label(drawn: tuple[list[Panel], np.ndarray]) -> None:
    panels, sheet = drawn
    assert sheet.dtype == np.uint8
    height = (sheet.shape[0] - 4) // 2  # of a tile: two rows, a gap of 4
    assert height > 2 * PIXELS
    assert sheet.shape == (2 * height + 4, 4 * PIXELS + 3 * 4, 3)
    for i, p in enumerate(panels):
        y, x = i // 4 * (height + 4), i % 4 * (PIXELS + 4)
        tile = sheet[y : y + PIXELS, x : x + PIXELS]
        assert np.abs(tile - p.picture[..., :3] * 255).max() <= 0.51
        below = sheet[y + PIXELS : y + 2 * PIXELS, x : x + PIXELS].astype(float)
        if p.error is not None:  # black where it equals the truth, brighter with increasing error
            np.testing.assert_allclose(p.error, np.abs(p.picture - panels[-1].picture)[..., :3].mean(-1))
            assert below[p.error == 0].max() < 5
            assert below[p.error > 0.4].mean() > 150


@pytest.mark.parametrize("number", [0, 1])
def test_no_half_of_a_panel_is_black(drawn: tuple[list[Panel], np.ndarray], number: int) -> None:
    """Each light reaches what the other does not: hardly any visible surface is as dark as without lights."""
    exact = drawn[0][-1].picture[..., :3]
    surface = (exact != np.float32(BACKGROUND)).any(-1)
    dark = exact.max(-1) < 1.2 * MATERIAL.ambient * max(SURFACE)
    assert (dark & surface).sum() < 0.05 * surface.sum()
    assert len(LIGHTS) == 2
    alone = shade_of(LIGHTS[number])
    assert (alone.max(-1) < 1.2 * MATERIAL.ambient * max(SURFACE))[surface].mean() > 0.1


def shade_of(light: Light) -> np.ndarray:
    """The function itself, lit by one of the lights."""
    volume = phantoms.marschner_lobb(40)
    _, picture = draw_function(
        phantoms.marschner_lobb_function,
        phantoms.marschner_lobb_gradient,
        volume,
        CAMERA.view(volume),
        (PIXELS, PIXELS),
        isovalue=ISOVALUE,
        color=SURFACE,
        lights=(light,),
        material=MATERIAL,
        background=BACKGROUND,
        clip=BOX,
    )
    return picture[..., :3]


def test_gradients_that_shade_the_hybrid_are_differences_of_the_magnified_grid() -> None:
    """For a wave, the central difference over ±h is its slope times sin(ωh) / ωh."""
    omega = 4 * np.pi / 21  # a wave that goes on beyond its mirrored ends
    volume = Volume(np.broadcast_to(np.cos(omega * np.arange(22)), (5, 6, 22)))
    points = np.array([[6.0, 2.0, 3.0], [9.5, 3.0, 2.0], [13.0, 2.5, 1.5]])
    slope = -omega * np.sin(omega * points[:, 0])
    for name, step in (("bspline5", 1.0), ("hybrid", 0.5)):
        got = shading_gradients(volume, points, as_filter(name), gradient="central")
        expected = slope * np.sin(omega * step) / (omega * step)
        np.testing.assert_allclose(got, np.stack([expected, 0 * slope, 0 * slope], -1), atol=1e-3)


def test_labels_state_the_measurements() -> None:
    picture = np.zeros((2, 2, 4), np.float32)
    assert Panel("linear", picture, 0.03281, 12.345).label == "linear\nRMS error 0.0328   normals 12.3°"
    assert Panel("linear", picture, 0.03281, letter="d").label == "d)  linear\nRMS error 0.0328"
    assert Panel("linear", picture, 0.03281).label == "linear\nRMS error 0.0328"
    assert Panel("exact", picture).label == "the function itself\n"
    assert Panel("bspline2", picture).label == "bspline2\n"
    assert Panel("linear", picture, 0.5, 1.5).numbers() == {"filter": "linear", "rms": 0.5, "angle": 1.5, "residual": None}


def test_progress_goes_up_to_one(device: Device) -> None:
    reported: list[float] = []
    figure6(8, 8, ("linear", "nearest"), rays=1, device=device, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1)
    reported.clear()
    compare(phantoms.sphere(8), ("linear", "nearest"), 8, device=device, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1)


def test_a_figure_without_a_visible_surface_has_no_normal_error(device: Device) -> None:
    away = Camera.look_at((0, 0, 9), (0, 0, 20), (0, 1, 0))
    panels, _ = figure6(8, 8, ("linear",), camera=away, rays=1, device=device)
    assert panels[0].angle is None
    assert panels[0].rms is not None


@pytest.mark.one_in(7)
@pytest.mark.parametrize(("count", "across", "down"), [(1, 1, 1), (2, 2, 1), (3, 3, 1), (4, 4, 1), (5, 4, 2), (6, 3, 2), (7, 4, 2)])
def test_compare_puts_panels_in_rows(device: Device, count: int, across: int, down: int) -> None:
    names = ("linear", "nearest", "bspline3", "mitchell", "bspline2", "catmull-rom", "bspline")[:count]
    panels, sheet = compare(phantoms.sphere(8), names, 12, device=device, mode="mip")
    assert [p.filter for p in panels] == [{"bspline": "bspline3"}.get(name, name) for name in names]
    assert all(p.rms is None and p.angle is None for p in panels)
    assert sheet.shape[1:] == (12 * across + 4 * (across - 1), 3)
    assert sheet.shape[0] == (12 + 18) * down + 4 * (down - 1)  # a line of 9 pixels beneath each


def test_compare_matches_render(device: Device) -> None:
    volume, camera = phantoms.marschner_lobb(12), Camera.orbit(10, 40, fit="volume")
    for options in ({}, {"mode": "mean"}, {"mode": "composite", "background": "white"}):
        panels, _ = compare(volume, ("mitchell", bspline(4)), 16, "wrap", camera=camera, device=device, **options)  # type: ignore[arg-type]
        for p in panels:
            alone = render(
                volume, camera, filter=p.filter, boundary="wrap", size=(16, 16), device=device, **{"mode": "isosurface", **options}
            )
            np.testing.assert_array_equal(p.picture, alone)


def test_compare_reports_the_automatic_smoothing(device: Device) -> None:
    noisy = phantoms.sphere(24).data + np.random.default_rng(0).normal(0, 0.1, (24, 24, 24))
    names = ("bspline3", "bspline3(0.25)", "bspline3(auto)")
    look: dict[str, Any] = {"camera": Camera.orbit(fit="volume"), "mode": "isosurface", "isovalue": 0.5}
    panels, sheet = compare(noisy, names, 40, device=device, **look)
    assert [p.filter for p in panels[:2]] == ["bspline3", "bspline3(0.25)"]
    assert panels[1].label == "B-spline, lambda = 0.25\n"
    decided = as_filter(panels[2].filter).smoothing
    assert isinstance(decided, float)
    assert decided > 0.1
    assert sheet.shape[1] == 3 * 40 + 2 * 4
    # a smooth ball: the smoother one is nearer to what is drawn without noise
    clean = compare(phantoms.sphere(24), names[:1], 40, device=device, **look)[0][0].picture
    far = [np.abs(p.picture - clean).mean() for p in panels]
    assert max(far[1:]) < 0.7 * far[0]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("rule", ["mirror", "reflect", "wrap"])
@pytest.mark.parametrize("mode", ["isosurface", "composite"])
def test_compare_draws_the_exact_sinc(device: Device, rule: str, mode: str) -> None:
    """Of a ball that a quintic spline renders nearly as well, so that one substitutes for the other."""
    n = 24
    x = (np.arange(n) + (0.5 if rule == "reflect" else 0)) / (n - 1 if rule == "mirror" else n)
    wave = 0.5 - 0.5 * np.cos(2 * np.pi * x)  # nothing is at the faces, where the magnified volume ends sooner
    data = wave * wave[:, None] * wave[:, None, None]
    panels, sheet = compare(data, (EXACT_SINC, "bspline5", "nearest"), 40, rule, device=device, mode=mode)
    assert [p.filter for p in panels] == [EXACT_SINC, "bspline5", "nearest"]
    assert panels[0].residual is not None
    assert panels[0].residual < 1e-3
    assert panels[0].label.startswith("sinc, exact to about ")
    assert sheet.shape[1] == 3 * 40 + 2 * 4
    sinc, spline, nearest = (p.picture[..., :3] for p in panels)
    assert sinc.std() > 0.05
    assert np.median(np.abs(sinc - spline)) < 1e-3
    assert np.abs(sinc - spline).mean() < 0.3 * np.abs(nearest - spline).mean()


@pytest.mark.parametrize("pixels", BAD_COUNTS, ids=repr)
def test_pixels_are_checked_first(pixels: object) -> None:
    for make in (lambda: figure6(8, pixels), lambda: compare(phantoms.sphere(8), ("linear",), pixels)):  # type: ignore[arg-type]
        with pytest.raises(OptionError, match=r"pixels must be a whole number, at least 1"):
            make()


def test_filters_are_checked_first() -> None:
    nowhere = "no such device"  # rendering before the check would raise a DeviceError
    for filters in BAD_FILTER_LISTS:
        with pytest.raises(OptionError, match=r"filters must be one or more names"):
            figure6(8, 8, filters, device=nowhere)
        with pytest.raises(OptionError, match=r"filters must be one or more names"):
            compare(phantoms.sphere(8), filters, 8, device=nowhere)
    with pytest.raises(OptionError, match=r"filters must be one or more names, at most 26; got 27"):
        figure6(8, 8, ("linear",) * 27, device=nowhere)
    with pytest.raises(OptionError, match=r"'exact-sinc' is drawn of at most 511 samples; got 512"):
        compare(phantoms.sphere(8), ("linear", EXACT_SINC), 8, max_samples=511, device=nowhere)
    with pytest.raises(OptionError, match=r"boundary must be mirror, reflect or wrap, which have a period; got 'zero'"):
        compare(phantoms.sphere(7), ("linear", EXACT_SINC), 8, "zero", device=nowhere)
    assert SIX[1:] == FIGURE_6[1:]
    for make in (
        lambda: figure6(8, 8, ("linear", "bogus"), device=nowhere),
        lambda: compare(phantoms.sphere(8), ("linear", "bogus"), 8, device=nowhere),
    ):
        with pytest.raises(OptionError, match=r"bspline3.*'bogus'"):
            make()


def test_figure_6_names_the_settled_smoothing(device: Device) -> None:
    panels, _ = figure6(12, 8, ("bspline3(length=0.1)",), rays=1, device=device)
    spacing = 2 / 11
    assert panels[0].filter == f"bspline3({(0.1 / spacing) ** 4:.6g})"
