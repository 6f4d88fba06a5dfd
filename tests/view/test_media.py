"""A view of several media: the first is what is edited, sliced and picked, and the others are drawn with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import clvol
from clvol.base.errors import ClvolError, OptionError
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import View
from clvol.view.panes import camera_of
from tests.view.clients import at_rest

Z, Y, X = np.mgrid[-1:1:20j, -1:1:20j, -1:1:20j]
SHELL = clvol.Volume((1 - np.sqrt(X**2 + Y**2 + Z**2)).astype(np.float32))
CORE = clvol.Volume(
    np.exp(-8 * ((X - 0.3) ** 2 + Y**2 + Z**2)).astype(np.float32)[::2, ::2, ::2], spacing=(2, 2, 2), origin=(0.5, 0.5, 0.5)
)
TISSUE = clvol.TransferFunction([(0, "bisque")], [(0.2, 0), (0.4, 0.03)])
SCENE = clvol.Scene([clvol.Medium(SHELL, TISSUE), clvol.Medium(CORE, cmap="hot", opacity=0.5)], background=(0.1, 0.2, 0.3))
SIZE = (32, 28)


@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
def test_it_shows_the_scene_and_copies_it(mode: str, device: Device) -> None:  # noqa: ARG001
    view = View(SCENE, mode=mode)
    want = clvol.render(SCENE, camera_of(view.state), mode, SIZE)
    assert_array_equal(view.picture(SIZE), want)
    text = view.python(SIZE)
    assert "# others: the 1 other media of the scene" in text
    names: dict[str, Any] = {"clvol": clvol, "volume": SHELL, "others": list(SCENE.media[1:])}
    exec(text, names)  # what was copied
    assert_array_equal(names["picture"], want)


def test_functions_of_gradients_are_left_out_where_there_is_no_matter(device: Device) -> None:  # noqa: ARG001
    graded = clvol.TransferFunction2D([((0.1, 0.5), (0.01, None), "tan", 0.5)])
    view = View(clvol.Scene([clvol.Medium(SHELL, graded), clvol.Medium(CORE, graded)]), mode="mip")
    want = clvol.render(clvol.Scene([clvol.Medium(SHELL), clvol.Medium(CORE)]), camera_of(view.state), "mip", SIZE)
    assert_array_equal(view.picture(SIZE), want)


ALONE: dict[str, dict[str, Any]] = {
    "clip": {"clip": clvol.Corner((0, 0, 0), SHELL.center), "transfer": TISSUE},
    "surfaces": {"surfaces": [(0.2, "tan", 0.5)]},
    "color_by": {"color_by": CORE},
    "smooth": {"volume": replace(SHELL, data=np.digitize(SHELL.data, [0.2, 0.5]), labels=True), "smooth": True},
}


@pytest.mark.parametrize("case", ALONE)
def test_one_medium_has_all_of_its_look(case: str, device: Device) -> None:  # noqa: ARG001
    medium = clvol.Medium(**{"volume": SHELL} | ALONE[case])
    view = View(medium)
    want = clvol.render(medium, camera_of(view.state), size=SIZE)
    assert_array_equal(view.picture(SIZE), want)
    names: dict[str, Any] = {"clvol": clvol, "volume": medium.volume, "first": medium}
    exec(view.python(SIZE), names)  # what was copied
    assert_array_equal(names["picture"], want)


def test_the_first_is_edited(device: Device) -> None:  # noqa: ARG001
    view = View(SCENE)
    blue = clvol.TransferFunction([(0, "blue")], [(0.2, 0), (0.4, 0.3)])
    cut = clvol.Plane((0, -1, 0), SHELL.center)
    view.state = replace(view.state, transfer=blue, cuts=(cut,), filter="linear")
    changed = replace(SCENE, media=(clvol.Medium(SHELL, blue, filter="linear"), SCENE.media[1]), clip=cut)
    assert_array_equal(view.picture(SIZE), clvol.render(changed, camera_of(view.state), size=SIZE))


@pytest.mark.parametrize("hidden", [0, 1])
def test_each_medium_has_an_eye_and_the_others_colors(hidden: int, device: Device) -> None:  # noqa: ARG001
    """Also where a medium has a transfer function."""
    scene = replace(SCENE, media=SCENE.media[::-1] if hidden else SCENE.media)
    view = View(scene)
    seen = view.state.changed({"media": [{}, {"cmap": "green", "opacity": 0.3}]})
    view.state = seen
    first, second = scene.media
    if second.transfer is None:
        green = replace(second, cmap="green", opacity=0.3)
    else:
        colors = clvol.TransferFunction.from_cmap("green", second.transfer.value_range)
        green = second.with_transfer(colors.with_opacity([(value, 0.3 * one) for value, one in TISSUE.opacities]))
    want = clvol.render(replace(scene, media=(first, green)), camera_of(view.state), size=SIZE)
    assert_array_equal(view.picture(SIZE), want)
    names: dict[str, Any] = {"clvol": clvol, "volume": first.volume, "others": [second]}
    exec(view.python(SIZE), names)  # what was copied
    assert_array_equal(names["picture"], want)
    view.state = view.state.changed({"media": [{"visible": hidden != 0}, {"visible": hidden != 1}]})
    alone = replace(scene, media=tuple(replace(one, visible=k != hidden) for k, one in enumerate(scene.media)))
    assert_array_equal(view.picture(SIZE), clvol.render(alone, camera_of(view.state), size=SIZE))
    exec(view.python(SIZE), names)
    assert_array_equal(names["picture"], view.picture(SIZE))
    for wrong, says in (
        ([{}], "one for each of the scene's 2"),
        ([{"cmap": "gray"}, {}], "must have no cmap"),
        ([{"eye": 1}] * 2, "no field"),
    ):
        with pytest.raises(OptionError, match=says):
            view.state = view.state.changed({"media": wrong})


def test_a_renderer_takes_other_looks_of_its_media(device: Device) -> None:
    with clvol.Renderer(SCENE, device=device) as renderer:
        first, second = renderer.scene.media
        for media in ([first, replace(second, visible=False)], [first.with_transfer(None), replace(second, cmap="viridis")]):
            got = renderer.render(size=SIZE, media=media)
            assert_array_equal(got, clvol.render(replace(SCENE, media=tuple(media)), size=SIZE, device=device))
        for wrong in ([first], [second, first], [first, replace(second, filter="linear")], [first, CORE], "both"):
            with pytest.raises(OptionError, match=r"media must be|each of media must be a Medium"):
                renderer.render(size=SIZE, media=wrong)


LABELS = clvol.Volume((SHELL.data > 0.5).astype(np.uint8), labels={1: "inside"}, name="inside")
LAYERED = clvol.Scene([SHELL, clvol.Medium(CORE, cmap="hot"), clvol.Medium(LABELS, opacity=0.4)])


GREEN = {"cmap": "green", "opacity": 0.3, "window": [0.5, 0.2]}
SLAB = {"slice__thickness": 2.0, "slice__project": "mean"}


@pytest.mark.parametrize(("change", "more"), [([], {}), ([{"visible": False}, {}, {}], {}), ([{}, GREEN, {}], {}), ([], SLAB)])
def test_slices_show_all_layers_and_copy_them(change: list[dict[str, Any]], more: dict[str, Any], device: Device) -> None:
    view = View(LAYERED, device=device)
    with at_rest(view, (48, 40)) as client:
        client.set(layout="slice", active="z", media=change, crosshair=[9, 9, 12], **more)
        _, shown = client.still("z")
        text = client.session.python()
    names: dict[str, Any] = {"clvol": clvol, "volume": SHELL, "others": list(LAYERED.media[1:])}
    exec(text, names)  # what was copied
    assert_array_equal(to_bytes(names["picture"])[..., :3], shown)
    alone = clvol.view.section(SHELL, (9, 9, 12), (1, 0, 0), (0, -1, 0), (0.5, 0.5), (48, 40), device=device)
    assert (to_bytes(alone)[..., :3] != shown).any()


def test_the_order_of_layers_changes_no_bit(device: Device) -> None:
    """Three that meet; and one alone covers as far as it is opaque."""
    third = clvol.Medium(clvol.Volume((SHELL.data - 0.3) ** 2), cmap="cool", opacity=0.7)
    place = (SHELL.center, (1, 0, 0), (0, -1, 0), (0.5, 0.5), (40, 40))
    over = [*LAYERED.media[1:], third]
    first = clvol.view.section(SHELL, *place, over=over, device=device)
    for order in ([2, 0, 1], [1, 2, 0], [2, 1, 0]):
        assert_array_equal(clvol.view.section(SHELL, *place, over=[over[k] for k in order], device=device), first)
    hidden = [over[0], replace(over[1], visible=False), replace(third, visible=False)]
    assert_array_equal(
        clvol.view.section(SHELL, *place, over=hidden, device=device),
        clvol.view.section(SHELL, *place, over=over[:1], device=device),
    )
    plain = clvol.view.section(SHELL, *place, device=device)
    covered = clvol.view.section(SHELL, *place, over=[clvol.Medium(LABELS, opacity=0.25)], device=device)
    inside = (covered != plain).any(-1)
    blue = (covered - 0.75 * plain)[inside][:, :3] / 0.25
    assert np.ptp(blue, axis=0).max() < 1e-5
    for wrong, says in (("all", "over must be a list"), ([replace(SHELL, units="mm"), replace(SHELL, units="m")], "in one unit")):
        with pytest.raises(ClvolError, match=says):
            clvol.view.section(SHELL, *place, over=wrong, device=device)
