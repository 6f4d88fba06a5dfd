"""Misspelt keywords get the one that was meant, by us or, from 3.13 on, by Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clvol

BALL = clvol.Volume(np.ones((4, 4, 4)))


@pytest.mark.parametrize(
    ("function", "given", "meant"),
    [
        (lambda **o: clvol.Renderer(BALL, **o), "fliter", "filter"),
        (lambda **o: clvol.Medium(BALL, **o), "transfr", "transfer"),
        (lambda **o: clvol.Scene(BALL, **o), "light", "lights"),
        (lambda **o: clvol.Volume(BALL, **o), "spacng", "spacing"),
        (lambda **o: clvol.Volume(BALL, **o), "voxel_size", "spacing"),
        (lambda **o: clvol.LazyVolume(BALL.data, **o), "spcing", "spacing"),
        (lambda **o: clvol.BrickedField(clvol.LazyVolume(BALL.data), **o), "ram", "memory"),
        (lambda **o: clvol.Field(BALL, **o), "bondary", "boundary"),
        (lambda **o: clvol.resample(BALL, **o), "shap", "shape"),
        (lambda **o: clvol.warp(BALL, np.eye(4), **o), "filer", "filter"),
        (clvol.Camera, "zom", "zoom"),
        (lambda **o: clvol.TransferFunction([(0, "red")], [(0, 1)], **o), "unit_dist", "unit_distance"),
        (clvol.Light, "colour", "color"),
        (clvol.Material, "difuse", "diffuse"),
        (clvol.Missing, "mos", "most"),
        (lambda **o: clvol.open("a.zarr", **o), "chanel", "channel"),
        (lambda **o: clvol.read("a.nii", **o), "chanel", "channel"),
        (lambda **o: clvol.pyramid(BALL, "a.zarr", **o), "chunk", "chunks"),
        (lambda **o: clvol.resize(BALL.data, (2, 2, 2), **o), "ordr", "order"),
    ],
)
def test_a_misspelt_keyword_gets_the_one_that_was_meant(function: Callable[..., Any], given: str, meant: str) -> None:
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{given}'\W+[Dd]id you mean '?{meant}\b"):
        function(**{given: 1})


def test_errors_of_other_calls_are_left_alone() -> None:
    def fails(**_: Any) -> None:
        {"a": 1}.pop(b=2)  # type: ignore[call-overload]  # what is tested

    for function in (fails, clvol.base.checks.suggests_options(fails)):
        with pytest.raises(TypeError, match=r"^dict.pop\(\) takes no keyword arguments$"):
            function(b=1)


def test_options_of_a_renderer_are_not_those_of_its_pictures() -> None:
    with clvol.Renderer(BALL, "linear") as renderer, pytest.raises(clvol.OptionError, match="filter must be left to what draws"):
        renderer.render(filter="linear")
    with pytest.raises(clvol.OptionError, match=r"fames is no option of composite \(did you mean frames\?\)"):
        clvol.movie(BALL, "a.gif", fames=3)
    with pytest.raises(clvol.OptionError, match="frames must be left out, or be seconds times fps, 20; got 3"):
        clvol.movie(BALL, "a.gif", frames=3, seconds=2, fps=10)
    with pytest.raises(clvol.OptionError, match=r"mod is no option of composite \(did you mean mode\?\)"):
        clvol.batch(BALL, output="a.png", mod="mip")
