"""No option is accepted and ignored: for each mode and each option, some value changes the picture, or it is refused by name."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.cli import main
from clvol.device import Device
from clvol.march.options import ModeOptions, PictureOptions
from clvol.scene.mode import as_mode, mode_options
from tests import cases

VALUES: dict[str, tuple[Any, ...]] = {
    "transfer": (clvol.TransferFunction.from_cmap("viridis", (0.0, 0.8), 0.3),),
    "preset": ("mr-default", "ct-bone"),
    "window": ((0.3, 0.2),),
    "cmap": ("viridis",),
    "opacity": (0.2, ((0.2, 0.0), (0.9, 0.9))),
    "gradient_opacity": (0.9, ((0.1, 0.0), (0.5, 1.0))),
    "curvature_opacity": (((0.1, 0.0), (0.5, 1.0)),),
    "material": (clvol.Material(0.9, 0.1, 0.0),),
    "lights": (clvol.Light((1, 0, 0)),),
    "shadow": (1.0,),
    "linear_light": (True,),
    "background": ("red",),
    "clip": (((-9.0, -9.0, -9.0), (6.0, 6.0, 6.0)),),
    "gradient": ("central",),
    "rays": (5,),
    "pixel_filter": ("mitchell", "nearest"),
    "lod": (0, 4.0),
    "sigma": (0.1,),
    "color_bar": (True,),
    "scale_bar": (True,),
    "axes": (True,),
    "box": (True,),
    "letters": (True,),
    "cube": (True,),
    "title": ("a title",),
    "time_stamp": ("now", 2.5),
    "theme": ("print",),
    "shading": (False,),
    "termination": (0.5,),
    "isovalue": (0.3,),
    "color": ("red",),
    "surfaces": ([(0.3, "red", 0.5)],),
    "color_by": ("k1", "k2", "mean curvature", "gaussian curvature"),
    "outline": (2.0,),
    "method": ("stepped",),
    "tolerance": (0.5,),
    "attenuation": (9.0,),
    "mu_water": (0.02,),
    "virtual": (2,),
    "cap": (True, False),
}
CHANGES_NO_BIT = {"skipping"}  # as it says
OF_A_SCENE = {
    "media",
    "occlusion",
    "shadow_rays",
}  # in tests/view/test_media.py; of other matter, in test_shadow.py and test_shadow_rays.py
OWN: tuple[dict[str, Any], ...] = ({}, {"shading": False}, {"method": "stepped"}, {"preset": "mr-default", "window": (0.4, 0.3)})
BESIDE: dict[str, dict[str, Any]] = {"pixel_filter": {"rays": 4}, "cap": {"clip": VALUES["clip"][0]}}
SIZE = (24, 18)
COARSE = 2.5  # voxels: long enough for a stepped surface to miss something


@pytest.fixture(scope="module")
def renderer(device: Device) -> Iterator[clvol.Renderer]:
    with clvol.Renderer(clvol.Volume(clvol.phantoms.marschner_lobb(12).data), device=device) as made:
        yield made


def test_every_option_has_values() -> None:
    assert VALUES.keys() | CHANGES_NO_BIT | OF_A_SCENE == PictureOptions.__annotations__.keys() | ModeOptions.__annotations__.keys()


@pytest.mark.one_in(12)
@pytest.mark.filterwarnings("ignore:preset 'ct-bone' is in Hounsfield")
@pytest.mark.parametrize("own", OWN, ids=str)
@pytest.mark.parametrize("mode", cases.MODES)
def test_an_option_changes_the_picture_or_is_refused(renderer: clvol.Renderer, mode: str, own: dict[str, Any]) -> None:
    try:
        plain = renderer.render(None, mode, SIZE, COARSE, **own)
    except OptionError:  # the mode has no such option
        return
    heard, refused = [], {}
    for name in VALUES.keys() - own.keys():
        beside = BESIDE.get(name, {})
        before = renderer.render(None, mode, SIZE, COARSE, **own, **beside) if beside else plain
        try:
            pictures = [renderer.render(None, mode, SIZE, COARSE, **own, **beside, **{name: value}) for value in VALUES[name]]
        except OptionError as error:
            refused[name] = str(error)
            continue
        heard.append(name)
        assert any((picture != before).any() for picture in pictures), name
    for name, words in refused.items():
        assert words.startswith(name), words
        both = (name == "transfer" and "preset" in own) or (name == "tolerance" and "step" in words)
        assert (
            both or "changes nothing" in words or (name in ModeOptions.__annotations__ and name not in mode_options(as_mode(mode)))
        )
    assert {"background", "clip", "rays", "pixel_filter"} <= {*heard}
    assert ("cmap" in heard) == (mode not in ("isosurface", "surfaces"))
    assert ("opacity" in heard) == (mode == "composite")
    assert ("lights" in heard) == (mode in ("composite", "isosurface", "surfaces") and own.get("shading", True))


def test_outputs_hear_what_they_show(renderer: clvol.Renderer) -> None:
    normals = [renderer.render(mode="mip", size=SIZE, outputs="normal", gradient=gradient) for gradient in ("analytic", "central")]
    assert np.nanmax(np.abs(normals[0] - normals[1])) > 0
    with pytest.raises(OptionError, match="gradient changes nothing in mip"):
        renderer.render(mode="mip", size=SIZE, outputs="depth", gradient="central")
    with pytest.raises(OptionError, match="gradient changes nothing in mip"):
        renderer.refine(mode="mip", size=SIZE, gradient="central")


def test_a_filter_without_slopes_has_no_choice_of_gradient(device: Device) -> None:
    volume = clvol.phantoms.marschner_lobb(8)
    for gradient in ("analytic", "central"):
        with pytest.raises(OptionError, match="gradient changes nothing with nearest"):
            clvol.render(volume, size=SIZE, filter="nearest", gradient=gradient, device=device)


def test_a_volume_of_one_size_has_no_choice_of_it(renderer: clvol.Renderer) -> None:
    with pytest.raises(OptionError, match="lod changes nothing for a volume of one size"):
        renderer.render(size=SIZE, lod=0)
    renderer.render(size=SIZE, lod="auto")


def test_modes_as_classes_are_held_to_it_too(renderer: clvol.Renderer) -> None:
    with pytest.raises(OptionError, match="tolerance changes nothing in isosurface"):
        renderer.render(mode=clvol.Isosurface(tolerance=0.1), size=SIZE)
    renderer.render(mode=clvol.Isosurface(tolerance=0.1, method="stepped"), size=SIZE)


def test_cameras_and_lights_take_nothing_in_vain() -> None:
    for more in ({"distance": 9.0}, {"direction": (1, 0, 0)}, {"fit": "volume"}):
        with pytest.raises(OptionError, match=r"(distance|direction|fit) changes nothing in a camera with a position"):
            clvol.Camera((9.0, 0.0, 0.0), **more)  # type: ignore[arg-type]  # each has its own
    with pytest.raises(OptionError, match="frame changes nothing without a direction"):
        clvol.Light(frame="camera")


def test_a_comparison_takes_the_words_of_a_picture(device: Device) -> None:
    volume = clvol.phantoms.marschner_lobb(10)
    words: dict[str, Any] = {"mode": "composite", "preset": "mr-default", "opacity": 0.5, "gradient": "central"}
    (panel, other), _ = clvol.figures.compare(volume, ["bspline3", "nearest"], 24, device=device, **words)
    expected = clvol.render(volume, size=(24, 24), filter="bspline3", device=device, **words)
    np.testing.assert_allclose(panel.picture, expected, atol=1e-6)
    assert (other.picture != panel.picture).any()
    with pytest.raises(OptionError, match="cmap changes nothing in isosurface"):
        clvol.figures.compare(volume, ["linear"], 24, device=device, cmap="viridis")


@pytest.mark.parametrize(
    ("mode", "flags", "named"),
    [
        ("isosurface", "--cmap viridis", "--cmap"),
        ("isosurface", "--opacity 0.5", "--opacity"),
        ("isosurface", "--window 0.5 0.1", "--window"),
        ("isosurface", "--value-range 0 1", "--value-range"),
        ("isosurface", "--preset ct-bone", "--preset"),
        ("isosurface", "--tolerance 0.1", "--tolerance"),
        ("mip", "--opacity 0.5", "--opacity"),
        ("mip", "--gradient analytic", "--gradient"),
        ("mip", "--pixel-filter mitchell", "--pixel-filter"),
        ("mip", "--value-range 0 1 --window 0.5 0.1", "--window"),
        ("composite", "--rays 1 --pixel-filter mitchell", "--pixel-filter"),
    ],
)
@pytest.mark.parametrize(
    ("command", "output"), [("render", "a.png"), ("batch", "{frame}.png"), ("movie", "a.gif"), ("compare", "a.png")]
)
def test_in_the_shell(
    command: str,
    output: str,
    mode: str,
    flags: str,
    named: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main([command, "phantom:sphere:8", "-o", output, "--mode", mode, *flags.split()])
    assert f"{named} changes nothing in {mode}" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_a_viewer_keeps_for_other_modes_what_this_one_does_not_show(device: Device) -> None:
    from clvol.view.resident import Resident

    volume = clvol.phantoms.marschner_lobb(8)
    options: dict[str, Any] = {"mode": "isosurface", "cmap": "viridis", "gradient": "central", "filter": "nearest"}
    resident = Resident(volume, device=device, **options)
    try:
        given = resident.arguments(resident.initial)
        assert not {"cmap", "gradient"} & given.keys()
        for mode, chosen in itertools.product(cases.MODES, (None, "nearest", "bspline3")):
            state = replace(resident.initial, mode=mode, filter=chosen)
            with clvol.Renderer(volume, chosen, device=device) as renderer:
                renderer.refine(size=(8, 6), **resident.arguments(state))  # refuses what it takes in vain, and draws nothing yet
            assert ("cmap" in resident.arguments(state)) == (mode not in ("isosurface", "surfaces"))
    finally:
        resident.close()
