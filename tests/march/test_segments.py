"""Skipping changes no bit of any picture: random volumes, filters, modes, cameras and steps."""

from __future__ import annotations

import gc
import math
import weakref
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from clvol.base.errors import DeviceError
from clvol.device import Device, Tile
from clvol.filter.filter import Filter
from clvol.filter.make import from_callable
from clvol.filter.table import filters
from clvol.march.renderer import OUTPUTS, Renderer
from clvol.phantoms import marschner_lobb
from clvol.scene.camera import Camera
from clvol.scene.joint import TransferFunction2D
from clvol.scene.mode import modes
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume
from tests import cases
from tests.cases import RULES, SMOOTHED, examples
from tests.march.looks import TILES, suited

MODES = [name for name in cases.MODES if modes()[name].skips]


@st.composite
def volumes(draw: st.DrawFn) -> Volume:
    """Mostly empty, thin, noisy, constant or stepped: where skipping begins, ends and never happens."""
    shape = draw(st.tuples(*[st.integers(1, 21)] * 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["sparse", "noise", "constant", "steps", "small"]))
    data = rng.random(shape)
    if kind == "sparse":
        data *= rng.random(shape) > 0.98
    elif kind == "constant":
        data[:] = 0.5
    elif kind == "steps":
        data = np.round(data)
    elif kind == "small":
        data *= 1e-6
    return Volume(data.astype(np.float32), tuple(rng.uniform(0.5, 2, 3)))


@st.composite
def graded(draw: st.DrawFn, transfer: TransferFunction) -> TransferFunction:
    """A function of the gradient, too: with factors that are often 0, or two boxes, one of them of the steepest."""
    steep = sorted(draw(st.lists(st.floats(0, 1.5), min_size=2, max_size=4, unique=True)))
    unit = draw(st.sampled_from([1.0, 1e-6]))
    steep = [unit * slope for slope in steep]
    if draw(st.booleans()):
        factors = draw(st.lists(st.sampled_from([0.0, 0.0, 0.4, 1.0]), min_size=len(steep), max_size=len(steep)))
        return replace(transfer, gradient_opacity=tuple(zip(steep, factors, strict=True)))
    low, high = transfer.value_range
    boxes = (((low, high), (steep[-1], math.inf), "red", 0.3), ((low - 1, high), (0.0, steep[0] + 1e-7), "white", 1.0))
    return TransferFunction2D(boxes=boxes[: draw(st.integers(1, 2))])


@st.composite
def views(draw: st.DrawFn) -> dict[str, Any]:
    """A camera from near to far, a step, sometimes a clip box, and the mode's target."""
    camera = Camera.orbit(
        draw(st.floats(-180, 180)),
        draw(st.floats(-89, 89)),
        zoom=draw(st.sampled_from([0.3, 1.0, 4.0])),
        projection=draw(st.sampled_from(["perspective", "orthographic"])),
        fit="volume",
    )
    points = sorted(draw(st.lists(st.floats(-0.5, 1.5), min_size=2, max_size=4, unique=True)))
    opacities = draw(st.lists(st.sampled_from([0.0, 0.0, 0.02, 1.0]), min_size=len(points), max_size=len(points)))
    transfer = TransferFunction(((0.0, "red"), (1.0, "white")), tuple(zip(points, opacities, strict=True)))
    return {
        "graded": draw(st.just(transfer) | graded(transfer)),
        "camera": camera,
        "step": draw(st.sampled_from([0.3, 0.5, 1.0, 2.3, 40.0])),
        "isovalue": draw(st.sampled_from([0.0, 0.2, 0.5, 0.7, 1e-7, 5.0, -3.0])),
        "clip": draw(st.sampled_from([None, None, ((1.0, 1.0, 1.0), (9.0, 12.0, 4.0))])),
        "transfer": transfer,
    }


def same(
    device: Device, volume: Volume, filter: str | Filter, mode: str, view: dict[str, Any], boundary: str = "mirror", **options: Any
) -> None:
    look = view | {"transfer": view["graded"]} if mode == "composite" else view
    look = {name: value for name, value in look.items() if name != "graded"}
    with Renderer(volume, filter, boundary, device) as renderer:
        with_, without = (
            renderer.render(mode=mode, size=(23, 19), outputs=OUTPUTS, skipping=skipping, **suited(mode, {**look, **options}))
            for skipping in (True, False)
        )
    for name in OUTPUTS[:-1]:
        assert_array_equal(with_[name], without[name], err_msg=name)
    seen = np.isfinite(without["visited"])
    assert_array_equal(np.isfinite(with_["visited"]), seen)
    assert (with_["visited"][seen] <= without["visited"][seen]).all()


UNHURRIED = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]


@pytest.mark.one_in(12)
@pytest.mark.parametrize(("mode", "tile"), [*product(MODES, TILES)])
@settings(deadline=None, max_examples=examples(60), suppress_health_check=UNHURRIED)
@given(volume=volumes(), view=views(), boundary=st.sampled_from(RULES), shading=st.booleans())
def test_skipping_changes_no_bit(
    device: Device, mode: str, tile: str, volume: Volume, view: dict[str, Any], boundary: str, shading: bool
) -> None:
    view |= {} if tile == "planes" else {"graded": view["transfer"]}  # fewer kernels
    with device.limited(tile=TILES[tile]):
        same(device, volume, "bspline3", mode, view, boundary, shading=shading)


@pytest.mark.one_in(27)
@pytest.mark.parametrize("filter", [*filters(), *SMOOTHED])
@settings(deadline=None, max_examples=examples(25), suppress_health_check=UNHURRIED)
@given(volume=volumes(), view=views())
def test_skipping_changes_no_bit_of_any_filter(device: Device, filter: str, volume: Volume, view: dict[str, Any]) -> None:
    mode = MODES[[*filters(), *SMOOTHED].index(filter) % len(MODES)]
    same(device, volume, filter, mode, view)


FITTED = {
    # sums to one within 0.24 %, jumps, is mostly rounding: what a fit to a kernel may be
    "nearly one": (lambda x: np.sinc(x) * np.sinc(x / 4), 4, 2),
    "jumps": (lambda x: np.exp(-x * x / 0.98), 2, 0),
    "a kink": (lambda x: np.where(np.abs(x) < 1.4, 1 - np.abs(x) / 1.4, 0) / 1.4, 2, 20),
}


@pytest.mark.one_in(4)
@pytest.mark.parametrize("name", FITTED)
@settings(deadline=None, max_examples=examples(25), suppress_health_check=UNHURRIED)
@given(volume=volumes(), view=views(), mode=st.sampled_from(["isosurface", "mip"]), constant=st.booleans())
def test_skipping_changes_no_bit_of_a_fitted_filter(
    device: Device, name: str, volume: Volume, view: dict[str, Any], mode: str, constant: bool
) -> None:
    kernel, radius, degree = FITTED[name]
    if constant:
        volume = Volume(np.full((9, 9, 9), 7.0, np.float32))
        view = {**view, "isovalue": 7.02}
    same(device, volume, from_callable(name.replace(" ", "-"), kernel, radius, degree=degree), mode, view)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("evaluator", "fetch"), [("eight-fetch", "buffer"), ("eight-fetch", "image"), ("taps", "image")])
@settings(deadline=None, max_examples=examples(15), suppress_health_check=UNHURRIED)
@given(volume=volumes(), view=views())
def test_skipping_changes_no_bit_on_any_path(
    device: Device, evaluator: Any, fetch: Any, volume: Volume, view: dict[str, Any]
) -> None:
    try:
        with device.limited(evaluator=evaluator, fetch=fetch):
            same(device, volume, "bspline3", "isosurface", view)
    except DeviceError as error:
        pytest.skip(str(error))


def test_even_matter_is_skipped(device: Device) -> None:
    """Where only boundaries are seen, both of what is on their sides; bounds of values alone, which were made before, are left."""
    volume = Volume((np.indices((64, 64, 64))[0] < 32).astype(np.float32))
    transfer = TransferFunction(((0.0, "red"), (1.0, "white")), ((0.0, 0.5),), gradient_opacity=((0.1, 0.0), (0.3, 1.0)))
    with Renderer(volume, device=device) as renderer:
        renderer.render(size=(8, 8), rays=1)
        (plain,) = map(weakref.ref, renderer._source.pyramids.values())
        got = renderer.render(mode="composite", size=(60, 45), transfer=transfer, outputs="visited")
        gc.collect()
        assert plain() is None
    assert np.mean(got[np.isfinite(got)]) < 0.25


@pytest.mark.one_in(9)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("mode", MODES)
def test_most_of_an_empty_volume_is_skipped(device: Device, mode: str, tile: str) -> None:
    data = np.zeros((64, 64, 64), np.float32)
    data[28:36, 28:36, 28:36] = 1.0
    if mode == "minip":
        data = 1 - data
    volume = Volume(data)
    transfer = TransferFunction(((0.0, "red"), (1.0, "white")), ((0.3, 0.0), (1.0, 0.5)))
    with device.limited(tile=TILES[tile]), Renderer(volume, device=device) as renderer:
        options = suited(mode, {"mode": mode, "size": (64, 64), "transfer": transfer, "isovalue": 0.5})
        pictures = renderer.render(outputs=("visited", "rgba"), background=None, **options)
        # rays past the object search the extreme of the prefilter's residue
        bright = pictures["rgba"][..., 1]
        hits = (bright < 0.5 if mode == "minip" else bright > 0.2) & np.isfinite(pictures["visited"])
        share = np.nanmean(pictures["visited"][hits if mode in ("mip", "minip", "attenuated") else ...])
        assert 0 < share < (0.5 if mode == "integral" else 0.4)  # which asks for whole tiles
        assert np.nanmax(renderer.render(outputs="visited", skipping=False, **options)) == 1.0


@pytest.mark.parametrize("isovalue", [-1.0, 2.0])
def test_an_isovalue_outside_the_range_evaluates_no_samples(device: Device, isovalue: float) -> None:
    with Renderer(marschner_lobb(), device=device) as renderer:
        visited = renderer.render(mode="isosurface", size=(40, 40), isovalue=isovalue, outputs="visited")
    assert np.isfinite(visited).any()
    assert np.nanmax(visited) == 0.0


def test_a_transparent_transfer_function_evaluates_no_samples(device: Device) -> None:
    nothing = TransferFunction(((0.0, "red"), (1.0, "white")), ((0.0, 0.0), (1.0, 0.0)))
    with Renderer(marschner_lobb(), device=device) as renderer:
        pictures = renderer.render(mode="composite", size=(40, 40), transfer=nothing, outputs=("rgba", "visited"), background=None)
    assert np.nanmax(pictures["visited"]) == 0.0
    assert (pictures["rgba"] == 0).all()


def test_tiles_of_other_shapes_skip_too(device: Device) -> None:
    view = {"isovalue": 0.5, "step": 0.5, "camera": Camera.orbit(20, 10, fit="volume")}
    with device.limited(tile=Tile(8, 8, 8, shared=True)):
        same(device, marschner_lobb(), "bspline3", "isosurface", view)
