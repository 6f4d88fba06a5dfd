"""No picture is empty without a word: what is outside the samples or the volume is warned of, with its range."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import clvol
from clvol.base.errors import ClvolWarning
from clvol.cli import main
from clvol.device import Device
from tests import cases

SIZE = (40, 30)
RAMP = np.linspace(2, 6, 512, dtype=np.float32).reshape(8, 8, 8)
BOX = ((20.0, 20.0, 20.0), (30.0, 30.0, 30.0))
AWAY = clvol.Camera.look_at((50, 50, 50), (100, 100, 100))
CASES: dict[str, tuple[dict[str, Any], str]] = {
    "isovalue": (
        {"mode": "isosurface", "isovalue": 9},
        "nothing is seen: isovalue 9 is outside the samples, which are from 2 to 6",
    ),
    "window above": (
        {"window": (20, 4)},
        "nothing is seen: all samples, from 2 to 6, are transparent; opacity changes from 18 to 22",
    ),
    "window below": (
        {"window": (-20, 4)},
        "all samples, from 2 to 6, are of one colour: the transfer function changes from -22 to -18",
    ),
    "black": ({"mode": "mip", "window": (20, 4)}, "all samples, from 2 to 6, are of one colour: .* from 18 to 22"),
    "white": ({"mode": "minip", "window": (-20, 4)}, "all samples, from 2 to 6, are of one colour: .* from -22 to -18"),
    "x-ray": ({"mode": "mean", "window": (20, 4)}, "all samples, from 2 to 6, are of one colour"),
    "faded": ({"mode": "attenuated", "window": (20, 4)}, "all samples, from 2 to 6, are of one colour"),
    "points": ({"opacity": ((7.0, 0.0), (8.0, 1.0))}, "nothing is seen: all samples, from 2 to 6, are transparent"),
    "clip": (
        {"clip": BOX},
        r"nothing is seen: clip lies outside the volume, which spans \(-0.5, -0.5, -0.5\) to \(7.5, 7.5, 7.5\)",
    ),
    "camera": ({"camera": AWAY}, "nothing is seen of the volume, whose samples are from 2 to 6"),
    "background": ({"camera": AWAY, "background": None}, "nothing is seen of the volume"),
}


def said(volume: Any, device: Device, **options: Any) -> list[str]:
    """The warnings of a picture."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        clvol.render(volume, size=SIZE, device=device, **options)
    assert all(issubclass(one.category, ClvolWarning) and one.filename == __file__ for one in found)
    return [str(one.message) for one in found]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("case", CASES)
def test_what_is_not_seen_is_said_with_the_range(device: Device, case: str) -> None:
    options, expected = CASES[case]
    lazy = clvol.LazyVolume(RAMP)
    for volume in (RAMP, lazy):
        (words,) = said(volume, device, **options)
        assert re.match(expected, words), words


def test_a_surface_that_is_not_there_is_said(device: Device) -> None:
    shown: dict[str, Any] = {"mode": "surfaces", "surfaces": [(4, "tan", 0.5), (99, "red", 1)]}
    assert said(RAMP, device, **shown) == ["no surface is seen of 99: samples are from 2 to 6"]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", cases.MODES)
def test_constant_samples(device: Device, mode: str) -> None:
    for value in (0, 5):
        heard = said(np.full((6, 6, 6), value), device, mode=mode)
        if mode == "integral":  # which shows how long rays are
            assert [text[:15] for text in heard] == ([] if value else ["nothing is seen"])
        else:
            assert heard == [f"the picture shows no structure: all samples are {value}"]
    transfer = clvol.TransferFunction(((0, "red"), (5, "white")))
    if not clvol.modes()[mode].stretches:
        assert not said(np.full((6, 6, 6), 5), device, mode=mode, transfer=transfer)


@pytest.mark.one_in(5)
@pytest.mark.parametrize("mode", cases.MODES)
def test_pictures_that_show_something_are_silent(device: Device, mode: str) -> None:
    ball = clvol.phantoms.sphere(12)
    turned = clvol.Volume(ball.data, ball.spacing, ball.origin, np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]]))
    for volume in (RAMP, turned, clvol.LazyVolume(RAMP), clvol.Volume((RAMP > 4).astype(np.uint8), labels=True)):
        if mode == "surfaces" and getattr(volume, "is_labels", False):
            continue
        assert not said(volume, device, mode=mode)
    assert not said(turned, device, mode=mode, clip=((-0.9, -np.inf, -0.9), (0.9, 0.9, np.inf)))


def test_an_estimated_range_is_not_named(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clvol.LazyVolume, "estimated", property(lambda _: True))
    lazy = clvol.LazyVolume(RAMP)
    (words,) = said(lazy, device, mode="isosurface", isovalue=9)
    assert "samples" not in words
    assert not said(lazy, device, mode="mip", window=(20, 4), background="red")


def test_a_movie_says_it_once(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    clvol.write(clvol.Volume(RAMP), "a.nrrd")
    with pytest.raises(SystemExit, match="0"):
        main(["movie", "a.nrrd", "-o", "a.gif", "--frames", "3", "--size", "16", "16", "--mode", "isosurface", "--isovalue", "9"])
    assert capsys.readouterr().err.count("isovalue 9 is outside the samples, which are from 2 to 6") == 1


def test_all_channels_are_no_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    tifffile.imwrite("a.ome.tiff", np.stack([RAMP, RAMP + 1]), ome=True, metadata={"axes": "CZYX"})
    with pytest.raises(SystemExit):
        main(["render", "a.ome.tiff", "-o", "a.png", "--channel", "all"])
    assert "channel must be" in capsys.readouterr().err
    assert not Path("a.png").exists()


def test_a_band_that_samples_miss_is_said_with_the_step_that_shows_it(device: Device) -> None:
    """Truth: the picture at a fortieth of the step."""
    z, y, x = np.mgrid[-1:1:32j, -1:1:32j, -1:1:32j]
    ball = clvol.Volume((1 - np.sqrt(x**2 + y**2 + z**2)).astype(np.float32))
    given: dict[str, Any] = {"size": (48, 48), "rays": 1, "device": device}

    def shell(width: float) -> clvol.TransferFunction:
        return clvol.TransferFunction([(0, "white")], [(0.5 - width, 0), (0.5, 0.9), (0.5 + width, 0)])

    for width, said, finer in ((0.06, "", 0.09), (0.008, "step=0.09", 0.09), (0.004, "step=0.05", 0.05)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            pictures = [clvol.render(ball, transfer=shell(width), step=step, **given) for step in (0.5, finer)]
        messages = [str(one.message) for one in caught]
        assert len(messages) == bool(said)
        assert said in "".join(messages)
        true = clvol.render(ball, transfer=shell(width), step=0.0125, **given)
        off, better = (float(np.sqrt(np.square(np.asarray(one) - true).mean())) for one in pictures)
        assert better < 0.01
        assert (off > 0.015) == bool(said)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            smooth = clvol.render(ball, transfer=shell(width), **given)  # with virtual samples where the step is left open
        assert np.array_equal(smooth, pictures[0]) == (not said)
        assert float(np.sqrt(np.square(np.asarray(smooth) - true).mean())) < (0.01 if said else 0.015)
