"""From events to states, compared with geometry."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clvol import Camera, Volume
from clvol.base.errors import OptionError
from clvol.view import State
from clvol.view.events import Context, Inputs, Reduced, faces, fit, reduce
from clvol.view.panes import Pane3D, PaneSize, SlicePane, camera_of, visible
from clvol.view.state import PANES, CameraState, Wiper
from tests.view.clients import random_changes, random_event

WIDTH, HEIGHT = 400.0, 300.0
LEVEL = CameraState(target=(1.0, 2.0, 3.0), radius=10.0)  # looks along +y, z up


def volume(space: str = "") -> Volume:
    data = np.random.default_rng(0).random((10, 12, 14)).astype(np.float32)
    return Volume(data, spacing=(1.0, 1.5, 2.0), origin=(-5, -6, -7), space=space)


def context(space: str = "", **more: Any) -> Context:
    known = volume(space)
    size = PaneSize(WIDTH, HEIGHT, 1.0)
    return Context(
        volume=known,
        placed=lambda state, _: (
            replace(camera_of(state), target=tuple(known.center)) if state.camera.target is None else camera_of(state)
        ),
        sizes=dict.fromkeys(("3d", "x", "y", "z"), size),
        isovalue=lambda state: state.options.get("isovalue", 0.5),
        window=lambda state, _: state.window or (0.5, 1.0),
        **more,
    )


def drag(
    state: State, *points: tuple[float, float], at: Context | None = None, inputs: Inputs | None = None, **more: Any
) -> Reduced:
    """Press at the first point, move over the others, release at the last."""
    at = at or context()
    kinds = ["pointer_down", *["pointer_move"] * (len(points) - 1), "pointer_up"]
    made = Reduced(state, inputs or Inputs())
    for kind, (x, y) in zip(kinds, (*points, points[-1]), strict=True):
        event = {"event_type": kind, "x": x, "y": y, "button": 1, "modifiers": [], **more}
        made = reduce(made.state, made.inputs, event, at)
    assert made.inputs.drag is None
    return made


def pane(state: State, name: str = "3d", at: Context | None = None) -> Any:
    return (at or context()).pane(state, name)


def forward(state: State) -> NDArray[np.float64]:
    return np.asarray(state.camera.direction)


@pytest.mark.parametrize("style", ["turntable", "trackball"])
def test_half_the_shorter_side_is_a_quarter_turn(style: Any) -> None:
    """The front moves right: the camera that looked along +y now looks along +x."""
    state = State(camera=replace(LEVEL, style=style))
    made = drag(state, (100, 100), (100 + HEIGHT / 2, 100)).state
    assert np.allclose(forward(made), (1, 0, 0), atol=1e-12)
    assert np.allclose(made.camera.up, (0, 0, 1), atol=1e-12)
    assert made.camera.target == LEVEL.target


@pytest.mark.parametrize("style", ["turntable", "trackball"])
def test_the_front_follows_the_pointer(style: Any) -> None:
    """The nearest point of the sphere moves on the screen as far as a surface point would, in that direction."""
    state = State(camera=replace(LEVEL, style=style, projection="orthographic"))
    before = pane(state)
    front = np.asarray(LEVEL.target) - 5 * forward(state)
    for dx, dy in ((60, 0), (-60, 0), (0, 60), (0, -60)):
        angle = math.pi * 60 / HEIGHT
        after = pane(drag(state, (100, 100), (100 + dx, 100 + dy)).state)
        # the volume is turned about the target: the same point of it, seen by the old camera, is the front seen by the new one
        moved = after.project(front)
        assert np.hypot(moved[0] - WIDTH / 2, moved[1] - HEIGHT / 2) == pytest.approx(
            5 * math.sin(angle) / before.pixel(), rel=1e-9
        )
        assert np.sign(np.round([moved[0] - WIDTH / 2, moved[1] - HEIGHT / 2], 6)).tolist() == [np.sign(dx), np.sign(dy)]


def test_a_drag_depends_only_on_its_ends() -> None:
    chance = random.Random(1)
    points = [(chance.uniform(0, 400), chance.uniform(0, 300)) for _ in range(30)]
    for style in ("turntable", "trackball"):
        state = State(camera=replace(LEVEL, style=style))  # type: ignore[arg-type]
        assert drag(state, *points).state == drag(state, points[0], points[-1]).state


def test_a_turntable_stays_level_and_stops_at_the_poles() -> None:
    chance = random.Random(2)
    state, at = State(camera=LEVEL), context()
    for _ in range(50):
        points = [(chance.uniform(-500, 900), chance.uniform(-500, 900)) for _ in range(2)]
        state = drag(state, *points, at=at).state
        view = camera_of(state).view(at.volume)
        assert abs(view.right[2]) < 1e-9
        assert view.up[2] > -1e-9
        assert math.hypot(*state.camera.direction) == pytest.approx(1, abs=1e-12)
    down = drag(State(camera=LEVEL), (100, 0), (100, 5000)).state
    assert np.allclose(forward(down), (0, 0, -1), atol=1e-9)  # from above: its front went down
    again = drag(down, (100, 100), (100, 100 - HEIGHT / 2)).state
    assert np.allclose(forward(again), (0, 1, 0), atol=1e-9)


def test_a_stack_of_images_has_its_vertical_upside_down() -> None:
    at = context("image")
    state = State(camera=replace(LEVEL, direction=(0, -1, 0), up=(0, 0, -1)))
    made = drag(state, (100, 100), (180, 130), at=at).state
    view = camera_of(made).view(at.volume)
    assert view.up[2] < 0
    assert abs(view.right[2]) < 1e-12


def test_dragging_a_fitted_camera_fixes_its_position() -> None:
    at = context()
    made = drag(State(), (100, 100), (100, 150), at=at).state
    assert made.camera.target == pytest.approx(tuple(at.volume.center))
    assert made.camera.radius == at.volume.radius


def test_a_click_does_not_change_a_fitted_camera() -> None:
    pressed = reduce(State(), Inputs(), {"event_type": "pointer_down", "pane": "3d", "x": 9, "y": 9, "button": 1}, context())
    assert pressed.state == State()
    assert (
        reduce(pressed.state, pressed.inputs, {"event_type": "pointer_up", "pane": "3d", "x": 9, "y": 9}, context()).state
        == State()
    )


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("more", [{"button": 2}, {"button": 3}, {"modifiers": ["Shift"]}], ids=str)
def test_pan_moves_the_targets_plane_with_the_pointer(projection: Any, more: dict[str, Any]) -> None:
    state = State(camera=replace(LEVEL, projection=projection, direction=(0.3, 0.8, -0.4)))
    before = pane(state)
    point = before.at_depth(120, 90, before.distance) if projection == "perspective" else before.ray(120, 90)[0]
    after = pane(drag(state, (120, 90), (211, 37), **more).state)
    assert after.project(point) == pytest.approx((211, 37), abs=1e-8)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("depth", [0.7, 1.0, 1.4])
def test_the_point_under_the_cursor_stays_when_the_wheel_zooms(projection: Any, depth: float) -> None:
    state = State(camera=replace(LEVEL, projection=projection, direction=(0.3, 0.8, -0.4), distance=35.0))
    at = context()
    before = pane(state)
    origin, way = before.ray(310, 55)
    point = origin + depth * 35 * way
    at = replace(at, anchor=lambda *_: point)
    inputs = Inputs()
    for dy in (-100, -250, 100, -400):
        made = reduce(state, inputs, {"event_type": "wheel", "x": 310, "y": 55, "dy": dy}, at)
        assert made.state.camera.zoom == pytest.approx(state.camera.zoom * 2 ** (-dy / 400))
        state, inputs = made.state, made.inputs
        assert pane(state).project(point) == pytest.approx((310, 55), abs=1e-7)


def test_zoom_stops_at_its_limits() -> None:
    state = State(camera=LEVEL)
    for dy in (-1e5, 1e5, 1e5):
        for name in ("3d", "x"):
            state = reduce(
                state,
                Inputs(),
                {"event_type": "wheel", "x": 10, "y": 20, "dy": dy, "modifiers": ["Pinch"], "pane": name},
                context(),
            ).state
    assert state.camera.zoom == 0.05
    assert state.slice.zoom == 0.05


def test_roll_rotates_the_picture_with_the_pointer() -> None:
    state = State(camera=replace(LEVEL, direction=(0.3, 0.8, -0.4)))
    before = pane(state)
    point = before.at_depth(WIDTH / 2 + 100, HEIGHT / 2, before.distance)
    after = pane(drag(state, (WIDTH / 2 + 100, HEIGHT / 2), (WIDTH / 2, HEIGHT / 2 + 100), modifiers=["Control"]).state)
    assert after.project(point) == pytest.approx((WIDTH / 2, HEIGHT / 2 + 100), abs=1e-8)


def test_the_rays_of_a_pane_match_its_pictures() -> None:
    """The camera's parameter block, which kernels read, gives the same directions."""
    at = context()
    for projection in ("perspective", "orthographic"):
        camera = Camera(target=(1, 2, 3), direction=(0.3, 0.8, -0.4), up=(0.1, 0, 1), radius=9, zoom=1.7, projection=projection)  # type: ignore[arg-type]
        seen = Pane3D.of(camera, at.volume, PaneSize(WIDTH, HEIGHT))
        x, y = 123.0, 45.0
        origin, way = seen.ray(x + 0.5, y + 0.5)
        block = camera.view(at.volume, WIDTH / HEIGHT).block(at.volume, int(WIDTH), int(HEIGHT))
        pixel = np.array([x + 0.5, y + 0.5])
        start = block["origin"] + np.stack([block["origin_u"], block["origin_v"]], 1) @ pixel
        along = block["direction"] + np.stack([block["direction_u"], block["direction_v"]], 1) @ pixel
        start = at.volume.index_to_world(start)
        along = at.volume.index_to_world_matrix @ along
        assert np.allclose(along / np.linalg.norm(along), way, atol=1e-6)
        assert np.linalg.norm(np.cross(start - origin, way)) < 1e-4
        point = origin + 12.0 * way
        assert seen.project(point) == pytest.approx((x + 0.5, y + 0.5), abs=1e-8)


# -- slices ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("space", "name", "right", "down"),
    [
        ("LPS", "z", (1, 0, 0), (0, 1, 0)),  # a patient's left on the viewer's right, the back below
        ("LPS", "y", (1, 0, 0), (0, 0, -1)),  # the head above
        ("LPS", "x", (0, 1, 0), (0, 0, -1)),  # the face to the left
        ("image", "z", (1, 0, 0), (0, 1, 0)),  # rows run down
        ("", "z", (1, 0, 0), (0, -1, 0)),
    ],
)
def test_slices_are_oriented_by_the_kind_of_data(space: str, name: str, right: Any, down: Any) -> None:
    seen = pane(State(), name, context(space))
    assert isinstance(seen, SlicePane)
    assert np.array_equal(seen.right, right)
    assert np.array_equal(seen.down, down)


@pytest.mark.parametrize(("name", "thick"), [("x", 1.0), ("y", 1.5), ("z", 2.0)])
def test_a_wheel_notch_is_one_slice(name: str, thick: float) -> None:
    axis = "xyz".index(name)
    made = reduce(State(), Inputs(), {"event_type": "wheel", "x": 9, "y": 9, "dy": 100, "pane": name}, context()).state
    assert made.crosshair is not None
    moved = np.asarray(made.crosshair) - volume().center
    assert moved == pytest.approx(np.eye(3)[axis] * thick)
    for _ in range(50):
        made = reduce(made, Inputs(), {"event_type": "wheel", "x": 9, "y": 9, "dy": 100, "pane": name}, context()).state
    assert made.crosshair is not None
    assert made.crosshair[axis] == volume().corners.max(0)[axis]


@pytest.mark.parametrize("name", ["x", "y", "z"])
def test_a_drag_in_a_slice_moves_the_crosshair(name: str) -> None:
    state = State(layout="linked", crosshair=(-4.0, -3.0, 1.0))
    made = drag(state, (150, 120), (230, 180), pane=name).state
    assert made.crosshair is not None
    axis = "xyz".index(name)
    assert made.crosshair[axis] == state.crosshair[axis]  # type: ignore[index]  # it is given
    assert pane(made, name).project(made.crosshair) == pytest.approx((230, 180), abs=1e-9)
    assert made.active == name


@pytest.mark.parametrize("name", ["x", "y", "z"])
def test_slices_zoom_about_the_cursor_and_pan_with_it(name: str) -> None:
    state = State(layout="linked")
    point = pane(state, name).point(300, 100)
    event = {"event_type": "wheel", "x": 300, "y": 100, "dy": -400, "pane": name, "modifiers": ["Control"]}
    made = reduce(state, Inputs(), event, context()).state
    assert made.slice.zoom == pytest.approx(2)
    assert pane(made, name).project(point) == pytest.approx((300, 100), abs=1e-9)
    made = drag(made, (300, 100), (250, 140), pane=name, modifiers=["Shift"]).state
    assert pane(made, name).project(point) == pytest.approx((250, 140), abs=1e-9)


def test_the_second_button_sets_the_window_of_slices() -> None:
    state = State(layout="slice", active="z")
    made = drag(state, (100, 100), (100, 100 + HEIGHT / 2), button=2).state
    assert made.slice.window == pytest.approx((0.5 + 0.5, 1.0))  # down raises the centre
    made = drag(state, (100, 100), (100 + WIDTH / 2, 100), button=2).state
    assert made.slice.window == pytest.approx((0.5, 4.0))  # to the right widens
    assert made.window is None  # that of the volume's picture
    moved = drag(made, (100, 100), (50, 50), button=3).state
    assert fit(moved, context()).slice.window == made.slice.window
    assert drag(made, (100, 100), (100 + WIDTH / 2, 100), pane="3d", inputs=held("w")).state.window == pytest.approx((0.5, 4.0))


# -- what is dragged with a key ----------------------------------------------------------------------------------


def held(key: str) -> Inputs:
    return reduce(State(), Inputs(), {"event_type": "key_down", "key": key}, context()).inputs


def test_the_isovalue_is_dragged_over_the_range_of_values() -> None:
    state = State(mode="isosurface", options={"isovalue": 0.5}, camera=LEVEL)
    made = drag(state, (100, 200), (100, 200 - HEIGHT / 4), inputs=held("i")).state
    low, high = volume().value_range
    assert made.options["isovalue"] == pytest.approx(0.5 + (high - low) / 4)
    assert made.camera == state.camera
    assert drag(state, (100, 200), (100, -9000), inputs=held("i")).state.options["isovalue"] == high
    assert drag(State(camera=LEVEL), (100, 200), (100, 100), inputs=held("i")).state == State(camera=LEVEL)


@pytest.mark.parametrize("by", ["key", "tool"])
def test_a_face_of_the_crop_box_follows_the_pointer(by: str) -> None:
    at = context()
    low, high = at.volume.corners.min(0), at.volume.corners.max(0)
    target = tuple(at.volume.center)
    state = State(camera=replace(LEVEL, target=target, projection="orthographic"), tool="crop" if by == "tool" else None)
    face = np.array([high[0], target[1], target[2]])  # of +x, to the right
    seen = pane(state)
    x, y = seen.project(face)
    made = drag(state, (x + 3, y - 2), (x + 3 - 50, y - 2), at=at, inputs=held("c") if by == "key" else None).state
    assert made.clip is not None
    assert made.clip[0] == pytest.approx(tuple(low))
    assert made.clip[1] == pytest.approx((high[0] - 50 * seen.pixel(), high[1], high[2]))
    far = drag(made, (x - 50, y), (-5000, y), at=at, inputs=held("c")).state
    assert far.clip is not None
    assert 0 < far.clip[1][0] - far.clip[0][0] < 0.01 * (high - low)[0]
    assert reduce(far, Inputs(), {"event_type": "key_down", "key": "Escape"}, at).state.clip is None


def test_a_clip_plane_is_dragged_by_its_handle() -> None:
    """With the box shown, a drag from a handle moves that plane only; any other drag rotates."""
    at = context()
    low, high = (tuple(map(float, corner(0))) for corner in (at.volume.corners.min, at.volume.corners.max))
    camera = replace(LEVEL, target=tuple(at.volume.center), direction=(0.5, 1, -0.4), projection="orthographic")
    state = State(camera=camera, clip=(low, high))
    dots = faces(state, at, "3d")
    assert {(axis, side) for axis, side, _, _ in dots} == {(axis, side) for axis in range(3) for side in (0, 1)}
    for axis, side, x, y in dots:
        middle = (np.array(low) + high) / 2
        middle[axis] += (-1 if side else 1) * 1.5
        inwards = np.subtract(pane(state).project(middle), pane(state).project((np.array(low) + high) / 2))
        made = drag(state, (x + 2, y - 3), (x + 2 + inwards[0], y - 3 + inwards[1])).state
        wanted = [list(low), list(high)]
        wanted[side][axis] += -1.5 if side else 1.5
        assert made.clip is not None
        assert np.allclose(made.clip, wanted)
        assert made.camera == camera
    _, _, x, y = dots[0]
    aside = drag(state, (x + 2, y + 40), (x + 60, y + 40)).state
    assert aside.clip == state.clip
    assert aside.camera != camera
    assert drag(State(camera=camera), (x, y), (x + 50, y)).state.clip is None  # no box, no dots
    panned = drag(state, (x, y), (x + 50, y), modifiers=["Shift"]).state
    assert (panned.clip, panned.camera.direction) == (state.clip, camera.direction)


def test_a_clip_plane_facing_the_viewer_has_no_handle() -> None:
    at = context()
    state = State(camera=replace(LEVEL, projection="orthographic"), tool="crop")  # looks along +y
    assert {axis for axis, *_ in faces(state, at, "3d")} == {0, 2}
    assert {axis for axis, *_ in faces(replace(state, layout="slice", active="z"), at, "z")} == {0, 1}


def test_the_line_of_the_wiper_is_dragged() -> None:
    state = State(camera=LEVEL, wiper=Wiper("linear", 0.5))
    made = drag(state, (WIDTH / 2 + 5, 40), (WIDTH * 0.8, 90)).state
    assert made.wiper == Wiper("linear", 0.8)
    assert made.camera == state.camera
    assert drag(state, (WIDTH * 0.7, 40), (WIDTH * 0.8, 90)).state.wiper == state.wiper


# -- keys --------------------------------------------------------------------------------------------------------


def pressed(state: State, key: str, *modifiers: str, at: Context | None = None, **more: Any) -> Reduced:
    return reduce(state, Inputs(), {"event_type": "key_down", "key": key, "modifiers": list(modifiers), **more}, at or context())


def test_six_arrows_are_a_quarter_turn() -> None:
    state = State(camera=LEVEL)
    for _ in range(6):
        state = pressed(state, "ArrowRight").state
    assert np.allclose(forward(state), (1, 0, 0), atol=1e-12)
    for _ in range(6):
        state = pressed(state, "ArrowDown").state
    assert np.allclose(forward(state), (0, 0, -1), atol=1e-12)


def test_keys_do_what_is_documented() -> None:
    state = State(camera=LEVEL)
    first = state.changed({"mode": "mip"})
    assert pressed(state, "2").state.mode == "isosurface"
    assert pressed(state, "p").state.camera.projection == "orthographic"
    assert pressed(state, "t").state.camera.style == "trackball"
    assert [pressed(replace(state, layout=name), "l").state.layout for name in ("3d", "slice", "linked")] == [
        "slice",
        "linked",
        "3d",
    ]  # type: ignore[arg-type]
    assert pressed(state, "h").state.heat
    assert pressed(state, "r", at=context(initial=first)).state == first
    assert pressed(state, "f").state.camera.target is None
    assert pressed(state, "z", "Control").effects == (("undo",),)
    assert pressed(state, "Z", "Control", "Shift").effects == (("redo",),)
    assert pressed(state, "PageUp", pane="z").state.crosshair is not None
    assert pressed(replace(state, layout="slice", active="z"), "x").state.active == "x"
    assert pressed(state, "F13").state == state
    rolled = pressed(state, "]").state
    assert pane(rolled).view.up == pytest.approx((-math.sin(math.radians(15)), 0, math.cos(math.radians(15))))


@pytest.mark.parametrize("space", ["", "LPS", "image"])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_view_along_an_axis_is_along_it(space: str, axis: str) -> None:
    at = context(space)
    made = pressed(State(camera=LEVEL), axis, at=at).state
    assert np.abs(forward(made)).tolist() == np.eye(3)["xyz".index(axis)].tolist()
    seen, cut = at.pane(made, "3d"), at.pane(made, axis)
    if axis == "z":  # as its slices are turned
        assert np.allclose(seen.right, cut.right)
    assert np.allclose(np.abs(seen.down), np.abs(cut.down))
    assert np.allclose(seen.down, cut.down)


def test_slices_across_one_turn_with_it_and_it_stays() -> None:
    """By a key, and by Alt and a drag about the crosshair."""
    at = context("LPS")
    state = State(layout="linked", crosshair=(1.0, 2.0, 3.0))
    before = [pane(state, name, at) for name in "xyz"]
    one, two = (
        pane(state, "z", at).project(np.add(state.crosshair, step)) for step in ((4, 0, 0), (4, 4 * math.tan(math.pi / 12), 0))
    )
    turned = drag(state, one, two, at=at, pane="z", modifiers=["Alt"]).state
    by_key = reduce(state, Inputs(), {"event_type": "key_down", "key": "]", "pane": "z"}, at).state
    assert np.allclose(turned.slice.turn, by_key.slice.turn)
    after = [pane(by_key, name, at) for name in "xyz"]
    assert np.allclose(after[2].right, before[2].right)
    assert np.allclose(after[2].down, before[2].down)
    normal = np.array([math.cos(math.pi / 12), math.sin(math.pi / 12), 0])  # x turned towards y, which runs down
    assert np.allclose(after[0].normal, normal)
    assert np.allclose(after[0].down, before[0].down)
    for made in after:
        assert abs(np.cross(made.right, made.down) @ made.normal) == pytest.approx(1)
        assert (made.middle - state.crosshair) @ made.normal == pytest.approx(0, abs=1e-12)
    further = reduce(by_key, Inputs(), {"event_type": "wheel", "dy": 100, "x": 5, "y": 6, "pane": "x"}, at).state
    assert np.allclose(np.subtract(further.crosshair, state.crosshair), normal)


# -- clicks ------------------------------------------------------------------------------------------------------


def test_a_click_in_the_volume_picks_if_slices_are_linked() -> None:
    state = State(layout="linked", camera=LEVEL)
    assert drag(state, (100, 90), (102, 91), pane="3d").effects == (("pick", "3d", 100.0, 90.0, True),)
    assert drag(state, (100, 90), (140, 91), pane="3d").effects == ()
    double = {"event_type": "double_click", "x": 5, "y": 6, "pane": "y"}
    assert reduce(replace(state, layout="slice"), Inputs(), double, context()).effects == (("pick", "y", 5.0, 6.0, True),)
    made = reduce(state, Inputs(), double, context())
    assert made.effects == (("pick", "y", 5.0, 6.0, False),)
    larger = made.state
    assert (visible(larger), visible(reduce(larger, Inputs(), double, context()).state)) == (("y",), PANES)


@pytest.mark.parametrize(
    "event",
    [
        None,
        {},
        {"event_type": "nonsense"},
        {"event_type": "pointer_down", "x": "1", "y": 1},
        {"event_type": "pointer_down", "x": float("nan"), "y": 1},
        {"event_type": "pointer_down", "x": 1},
        {"event_type": "wheel", "x": 1, "y": 1, "dy": float("inf")},
        {"event_type": "wheel", "x": 1, "y": 1, "dy": 1, "modifiers": "Shift"},
        {"event_type": "key_down", "key": 3},
        {"event_type": "key_down", "key": "a" * 1000},
        {"event_type": "pointer_down", "x": 1, "y": 1, "pane": "w"},
    ],
    ids=str,
)
def test_invalid_events_are_rejected(event: Any) -> None:
    with pytest.raises(OptionError):
        reduce(State(), Inputs(), event, context())


@pytest.mark.parametrize("seed", range(4))
def test_random_events_give_valid_states(seed: int) -> None:
    """Two thousand in all, from any state; each state round-trips through its text."""
    chance = random.Random(seed)
    at = context(["", "LPS", "image"][seed % 3])
    state, inputs = State().changed(random_changes(chance)), Inputs()
    for i in range(500):
        event = random_event(chance, WIDTH, HEIGHT) | {"pane": chance.choice(["3d", "3d", "x", "y", "z"])}
        made = reduce(state, inputs, event, at)
        state, inputs = made.state, made.inputs
        if i % 25 == 0:
            assert State.from_text(state.text()) == state
    assert State.from_text(state.text()) == state
