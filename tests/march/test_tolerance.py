"""`tolerance` in place of `step`: the pictures it promises, and the step it finds."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import clvol
from bench.tolerance import random_transfer
from clvol.base.errors import ClvolWarning, OptionError
from clvol.device import Device
from clvol.march.tolerance import difference
from tests.cases import examples

SIZE = (24, 24)
FINEST = 1 / 64


def noisy() -> clvol.Volume:
    x, y, z = np.mgrid[-1:1:12j, -1:1:12j, -1:1:12j]
    return clvol.Volume(np.exp(-2 * (x**2 + y**2 + z**2)) + 0.05 * np.random.default_rng(2).random(x.shape))


def test_random_functions_are_within_it(device: Device) -> None:
    rng, volume, errors, steps = np.random.default_rng(3), noisy(), [], []
    with clvol.Renderer(volume, device=device) as renderer:
        for _ in range(examples(150)):
            look: dict[str, Any] = {"transfer": random_transfer(rng, *volume.value_range), "size": SIZE, "rays": 1}
            camera = clvol.Camera.orbit(float(rng.uniform(0, 360)), float(rng.uniform(-80, 80)))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ClvolWarning)  # that nothing is seen
                fine = renderer.render(camera, step=FINEST, **look)
                picture = renderer.render(camera, tolerance=0.01, **look)
            errors.append(difference(picture, fine, picture.recipe.scene.background))
            steps.append(picture.recipe.step)
    assert max(errors) <= 0.01
    assert np.count_nonzero(np.array(steps) < 1) > len(steps) * 2 // 15
    assert np.median(np.array(errors)[np.array(steps) < 1]) > 0.002  # steps are no shorter than they must be


def test_narrow_bands_are_smooth_without_a_warning(device: Device) -> None:
    x, y, z = np.mgrid[-1:1:20j, -1:1:20j, -1:1:20j]
    low, high = 0.0, float(np.sqrt(3))
    edges = ((-0.01, 0.0), (-0.008, 0.7), (0.008, 0.7), (0.01, 0.0))
    bands = [(share * high + e * (high - low), o) for share in (0.2, 0.35, 0.5) for e, o in edges]
    look: dict[str, Any] = {"transfer": clvol.TransferFunction(((0, (1, 1, 1)),), tuple(bands)), "size": SIZE, "rays": 1}
    with clvol.Renderer(clvol.Volume(np.sqrt(x**2 + y**2 + z**2)), device=device) as renderer:
        with pytest.warns(ClvolWarning, match="stippled"):
            usual = renderer.render(virtual=0, **look)
        fine = renderer.render(step=FINEST, **look)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            picture = renderer.render(tolerance=0.01, **look)
        assert difference(picture, fine, (0, 0, 0)) <= 0.01 < difference(usual, fine, (0, 0, 0))
        with pytest.warns(ClvolWarning, match=r"tolerance 1e-09 is not reached: with the shortest step, 1/64 voxel"):
            assert renderer.render(tolerance=1e-9, **look).recipe.step == FINEST


def test_its_step_is_in_the_recipe(device: Device) -> None:
    with clvol.Renderer(noisy(), device=device) as renderer:
        picture = renderer.render(size=SIZE, tolerance=0.002)
        recipe = picture.recipe
        assert recipe is not None
        assert FINEST < recipe.step < 1
        np.testing.assert_array_equal(clvol.render(recipe.scene, recipe.camera, device=device, **recipe.options), picture)
        *_, last = renderer.refine(size=SIZE, tolerance=0.002)
        np.testing.assert_array_equal(last, picture)
        assert last.step == recipe.step
        assert not list(renderer.refine(size=SIZE, tolerance=0.002, cancelled=lambda: True))
        for way in (renderer.render, renderer.refine):
            with pytest.raises(OptionError, match=r"tolerance chooses the step, which must be left out beside it; got 0.01 and"):
                way(size=SIZE, step=0.5, tolerance=0.01)
        with pytest.raises(OptionError, match="tolerance must be a finite number, greater than 0"):
            renderer.render(size=SIZE, tolerance=0)


def test_scenes_and_bricks_have_it_too(device: Device) -> None:
    volume = noisy()
    look: dict[str, Any] = {"size": SIZE, "rays": 1, "device": device}
    for drawn in (
        clvol.Scene([clvol.Medium(volume), clvol.Medium(volume, opacity=0.1)]),
        clvol.LazyVolume(volume.data, limits=volume.value_range, labels=False),
    ):
        fine, picture = (clvol.render(drawn, **how, **look) for how in ({"step": FINEST}, {"tolerance": 0.004}))
        assert picture.recipe.step > FINEST
        assert difference(picture, fine, picture.recipe.scene.background) <= 0.004
    with pytest.raises(OptionError, match="tolerance changes nothing in composite: surfaces"):
        clvol.render(clvol.Medium(volume, surfaces="0.5:red"), tolerance=0.01, **look)
