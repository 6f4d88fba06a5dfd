"""Modes: a class, a kernel file and a reference each; options are fields, and options of other modes are rejected by name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import phantoms
from clvol.base.errors import OptionError
from clvol.base.uniform import FLOAT, Block
from clvol.device import Device, program
from clvol.reference.march import march
from clvol.scene.mode import DEFAULT_MODE, Composite, Isosurface, Mip, Mode, as_mode, every_option, mode_options, modes
from clvol.volume.histogram import isovalue_of
from clvol.volume.volume import Volume

KERNEL = ("state_t", "begin", "gather", "matters", "merge", "finish", "finished", "REACH", "ANY_ORDER", "PROMISE")


@pytest.mark.parametrize("name", modes())
def test_each_mode_has_a_kernel_file_and_a_reference(name: str) -> None:
    mode = as_mode(name)
    assert mode.name == name
    assert as_mode(mode) == mode
    assert mode.description
    text = (program.folder() / mode.file).read_text(encoding="utf-8")
    for shared in ("modes/extreme.cl", "modes/sums.cl"):
        if f'"{shared}"' in text:
            text += (program.folder() / shared).read_text(encoding="utf-8")
    stretches = "#define STRETCHES 1" in text
    assert stretches == mode.stretches
    for word in KERNEL:
        looked_for = "SOUGHT" if word == "gather" and stretches else word
        assert re.search(rf"\b{looked_for}\b", text), looked_for
    assert "for (" not in text  # the ray loop is march.cl's
    assert name in march.MODES


def test_the_table_is_a_copy() -> None:
    modes().clear()
    assert DEFAULT_MODE in modes()
    assert set(march.MODES) == set(modes())


@pytest.mark.parametrize("name", modes())
def test_every_option_is_a_documented_field(name: str) -> None:
    for option, says in mode_options(modes()[name]).items():
        assert option in every_option()
        assert len(says) > 10, option
        assert says.endswith("."), option


@pytest.mark.parametrize("wrong", ["MIP", "", None, 3, Volume])
def test_unknown_modes(wrong: Any) -> None:
    with pytest.raises(OptionError, match=r"mode must be one of composite, isosurface, surfaces, regions, mip, .*, integral; got "):
        as_mode(wrong)


def test_options_of_other_modes_are_rejected_by_name() -> None:
    with pytest.raises(OptionError, match="isovalue is no option of mip, but of isosurface; mip has none"):
        as_mode("mip", {"isovalue": 0.5})
    with pytest.raises(OptionError, match="of mean, but of composite, isosurface, surfaces and regions; mean has none"):
        as_mode("mean", {"shading": True})
    with pytest.raises(OptionError, match="speed is no option of composite; composite has shading, termination"):
        as_mode("composite", {"speed": 1})
    with pytest.raises(OptionError, match="termination is no option of isosurface, but of composite"):
        as_mode(Isosurface(), {"termination": 0.1})


BAD: dict[str, tuple[str, dict[str, Any], str]] = {
    "isovalue NaN": ("isosurface", {"isovalue": float("nan")}, "isovalue must be a finite number; got nan"),
    "isovalue text": (
        "isosurface",
        {"isovalue": "high"},
        "isovalue must be a number, or standard deviations above the mean as '3sigma'; got 'high'",
    ),
    "isovalue number as text": ("isosurface", {"isovalue": "3"}, "as '3sigma'; got '3'"),
    "isovalue of NaN": ("isosurface", {"isovalue": "nan sigma"}, "as '3sigma'; got 'nan sigma'"),
    "color": ("isosurface", {"color": "no colour"}, "color must be three numbers, or the name"),
    "two colours": ("isosurface", {"color": (1, 2)}, "color must be three numbers"),
    "tolerance": ("isosurface", {"tolerance": -1}, "tolerance must be a finite number, at least 0 and at most 1; got -1"),
    "shading": ("isosurface", {"shading": "yes"}, "shading must be True or False; got 'yes'"),
    "shading as a number": ("composite", {"shading": 1}, "shading must be True or False; got 1"),
    "termination": ("composite", {"termination": 1}, "termination must be a finite number, at least 0 and less than 1; got 1"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_values_of_options(case: str) -> None:
    mode, options, message = BAD[case]
    with pytest.raises(OptionError, match=message):
        as_mode(mode, options)


def test_options_change_only_what_they_name() -> None:
    mode = as_mode(Isosurface(0.5, color="red"), {"shading": np.bool_(False)})
    assert mode == Isosurface(0.5, (1.0, 0.0, 0.0), shading=False)
    assert not mode.shaded
    assert as_mode("composite").shaded
    assert not as_mode("mip").shaded


def test_automatic_options_are_settled_for_a_volume() -> None:
    volume = phantoms.marschner_lobb(11)
    assert as_mode("isosurface").settled(volume) == Isosurface(isovalue_of(volume)[0])
    assert Isosurface(0.2).settled(volume) == Isosurface(0.2)
    assert Composite().settled(volume) == Composite()


@pytest.mark.parametrize(("text", "sigmas"), [("3sigma", 3), (" -1.5 Sigma ", -1.5), (".5σ", 0.5), ("+2e0 sigma", 2)])
def test_levels_in_standard_deviations(text: str, sigmas: float) -> None:
    """Of all finite samples about their mean, whatever their type and size."""
    data = np.random.default_rng(0).normal(5, 2, (9, 8, 7))
    for samples in (data, (data * 100).astype(np.int16), data * 1e300, np.where(data > 8, np.nan, data).astype(np.float32)):
        seen = np.asarray(samples, np.float64)[np.isfinite(samples)]
        unit = max(1.0, float(np.abs(seen).max()))
        expected = ((seen / unit).mean() + sigmas * (seen / unit).std()) * unit
        assert as_mode("isosurface", {"isovalue": text}).settled(Volume(samples)).isovalues == pytest.approx((expected,), rel=1e-12)


def test_the_default_look_of_each_mode() -> None:
    volume = phantoms.marschner_lobb(11)
    low, high = volume.value_range
    bounds = {name: as_mode(name).transfer(volume).value_range for name in ("mip", "attenuated", "minip", "mean")}
    assert all(low <= black < white <= high for black, white in bounds.values())
    black, white = bounds["mip"]
    assert bounds["attenuated"] == (black, black + 0.5 * (white - black))  # even the nearest values have faded
    assert bounds["minip"][1] < white
    assert bounds["mean"][1] < white  # means seldom reach the largest
    assert len(as_mode("composite").transfer(volume).opacities) > 1


def test_a_mode_is_a_class() -> None:
    class Fog(Mode):
        name = "fog"

    assert Fog().file == "modes/fog.cl"
    assert as_mode(Composite, {"termination": 0.5}) == Composite(termination=0.5)
    with pytest.raises(OptionError, match="a mode must have a name and state_fields; Fog has no state_fields"):
        as_mode(Fog)
    with pytest.raises(OptionError, match="a mode must have a name and state_fields; Mode has no name"):
        as_mode(Mode())


def test_a_custom_mode_renders_with_its_own_look(device: Device) -> None:
    """Looks are per instance, not cached per class."""

    @dataclass(frozen=True)
    class Window(Mip):
        top: float = 1.0

        def transfer(self, volume: Volume) -> clvol.TransferFunction:  # noqa: ARG002
            return clvol.TransferFunction.ramp((0, self.top))

    volume = phantoms.marschner_lobb(9)
    with clvol.Renderer(volume, device=device) as renderer:
        camera = clvol.Camera.orbit(fit="volume")
        bright, dark = (renderer.render(camera, mode=Window(top), size=(20, 20))[..., 0].mean() for top in (1.0, 4.0))
    assert dark == pytest.approx(bright / 4, rel=0.05)


def test_a_misspelt_keyword_gets_a_hint() -> None:
    with pytest.raises(OptionError, match=r"skiping is no option of mip \(did you mean skipping\?\); mip has none"):
        clvol.render(np.ones((3, 3, 3)), mode="mip", skiping=False)


def test_attenuation_of_nothing_is_the_maximum(device: Device) -> None:
    volume = phantoms.marschner_lobb(16)
    ramp = clvol.TransferFunction.ramp(volume.value_range)
    options: dict[str, Any] = {"size": (40, 40), "device": device, "outputs": ("rgba", "depth"), "transfer": ramp}
    plain = clvol.render(volume, mode="mip", **options)
    same = clvol.render(volume, mode="attenuated", attenuation=0.0, **options)
    np.testing.assert_allclose(same["rgba"], plain["rgba"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(same["depth"], plain["depth"])


def test_near_matter_is_brighter(device: Device) -> None:
    """Two equal balls, one behind the other: the farther one is exp(-attenuation d) as bright, d in sphere diameters."""
    data = np.zeros((41, 41, 41), np.float32)
    z, y, x = np.indices(data.shape)
    for center in ((10, 20, 8), (30, 20, 32)):
        data += np.exp(-(((x - center[0]) ** 2 + (y - center[1]) ** 2 + (z - center[2]) ** 2) / 8.0))
    camera = clvol.Camera(direction=(0, 0, 1), up=(0, -1, 0), projection="orthographic", fit="volume")
    ramp = clvol.TransferFunction.ramp((0, 1))
    got = clvol.render(data, camera, clvol.Attenuated(1.5), size=(90, 90), transfer=ramp, device=device)[..., 0]
    near, far = got[:, :45].max(), got[:, 45:].max()
    assert far / near == pytest.approx(np.exp(-1.5 * 24 / (41 * np.sqrt(3))), rel=0.02)
    front = 0.5 + (8 - 20) / (41 * np.sqrt(3))
    assert near == pytest.approx(np.exp(-1.5 * front), rel=0.04)  # no ray meets the middle of a ball


@pytest.mark.parametrize("bad", [-1, 41, float("nan"), "strong"])
def test_bad_attenuation(bad: Any) -> None:
    with pytest.raises(OptionError, match="attenuation must be a finite number, at least 0"):
        as_mode("attenuated", {"attenuation": bad})


@pytest.mark.parametrize(
    ("what", "wrong", "message"),
    [
        ("name", "../base/math", "name must be lowercase letters"),
        ("name", 'mip"\n#error', "name must be lowercase letters"),
        ("name", "mip\0", "name must be lowercase letters"),
        ("name", "m" * 5000, "name must be lowercase letters"),
        ("name", 5, "name must be lowercase letters"),
        ("name", "composite", "named 'composite' must be a Composite"),
        ("file", "../../secret.cl", "file must be lowercase letters"),
        ("state_fields", "2\n#error", "state_fields must be a whole number"),
        ("state_fields", -1, "state_fields must be a whole number"),
        ("endpoints", "yes", "endpoints must be True or False"),
        ("skips", None, "skips must be True or False"),
        ("picture_filter", "nonesuch", "filter must be one of"),
        ("shows", "everything", "what a mode shows must be one of"),
        ("ramp", "steep", "ramp must be a finite number"),
        ("BLOCK", Block("mode_block", **{"a; evil": FLOAT}), "fields have names of C"),
        ("BLOCK", Block("evil", a=FLOAT), "BLOCK must be a 'mode_block'"),
    ],
)
def test_custom_modes_are_checked_before_compilation(what: str, wrong: object, message: str) -> None:
    made = type("Made", (Mip,), {what: wrong})
    for one in (made, made()):
        with pytest.raises(OptionError, match=re.escape(message)):
            as_mode(one)


def test_a_renamed_mode_is_rejected() -> None:
    mode = Mip()
    object.__setattr__(mode, "name", "#include <evil>")
    with pytest.raises(OptionError, match="name must be lowercase letters"):
        as_mode(mode)


def test_every_mode_of_the_table_is_valid() -> None:
    for mode in modes().values():
        assert as_mode(mode) == mode
        assert as_mode(type(mode)) == mode
