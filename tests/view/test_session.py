"""Sessions: pictures match copied programs, the newest state wins, and nothing is left behind."""

from __future__ import annotations

import ast
import gc
import math
import os
import random
import shutil
import subprocess
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import clvol
from clvol import Light, Material, TransferFunction, TransferFunction2D, Volume
from clvol.base.errors import DataError, OptionError
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import State, View, code, from_toml, from_url
from clvol.view.drawing import Drawer, Order, Shot
from clvol.view.panes import PaneSize
from clvol.view.session import Session
from tests import cases
from tests.view.clients import Client, decoded, random_event

SIZE = 96, 72


@pytest.fixture(scope="module")
def volume() -> Volume:
    """A ball in a gradient, in a patient's world, with unequal spacings."""
    z, y, x = np.mgrid[0:20, 0:24, 0:28].astype(np.float32)
    ball = 900 * np.exp(-(((x - 14) / 7) ** 2 + ((y - 12) / 6) ** 2 + ((z - 9) / 5) ** 2))
    return Volume((ball + 3 * x).astype(np.int16), spacing=(1.0, 1.1, 1.4), origin=(-13, 5, 40), space="LPS", units="mm")


@pytest.fixture(scope="module")
def view(volume: Volume, device: Device) -> Iterator[View]:
    made = View(volume, device=device, layout="3d")
    yield made
    made.close()


def test_a_warm_up_builds_the_kernels_of_another_volume(volume: Volume, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []
    build = device.build
    View(clvol.phantoms.marschner_lobb(32), device=device, mode="attenuated").rehearse()
    known = set(device.programs._built)
    monkeypatch.setattr(device, "build", lambda *given, **more: built.append(given[0]) or build(*given, **more))
    made = View(volume, device=device, mode="attenuated")
    made.prepare()
    new = {key[0] for key in device.programs._built if key not in known}
    assert "march/draw.cl" in built
    assert not {"march/draw.cl", "spline/minmax.cl"} & new
    assert made.resident._descriptions
    made.close()


def drawn(text: str, volume: Volume) -> NDArray[np.uint8]:
    """The PNG of a copied program."""
    space: dict[str, Any] = {"volume": volume}
    exec(text, space)
    pixels = to_bytes(space["picture"])
    return pixels[..., :3] if pixels.shape[2] == 4 and pixels[..., 3].min() == 255 else pixels


LOOKS: dict[str, dict[str, Any]] = {
    "default": {},
    "around": {"furniture": dict.fromkeys(("color_bar", "axes", "cube"), True) | {"title": "a head", "time_stamp": 0.0}},
    "surface": {
        "furniture.color_bar": True,
        "mode": "isosurface",
        "options.isovalue": 400.5,
        "options.color": [0.2, 0.5, 0.9],
        "filter": "bspline3",
    },
    "moved": {
        "mode": "isosurface",
        "camera.target": [0, 20, 52],
        "camera.radius": 11,
        "camera.up": [0.3, 0.1, 0.9],
        "camera.zoom": 1.3,
        "camera.projection": "orthographic",
        "clip": {"low": [-8, 8, 45], "high": [8, 30, 60.5]},
        "lights": [
            {"direction": [1, -2, 0.5], "color": [1, 0.9, 0.8], "frame": "camera"},
            {"direction": None, "color": [0.2, 0.2, 0.2]},
        ],
        "material": {"ambient": 0.1, "diffuse": 0.8, "specular": 0.4, "shininess": 12.5},
        "shadow": 0.7,
        "shadow_rays": True,
        "linear_light": True,
        "occlusion": 0.5,
        "background": None,
    },
    "transfer": {"transfer.points": [[100, [0.1, 0, 0], 0], [400, [1, 0.5, 0], 0.3], [400, [0, 0.5, 1], 0.6], [950, [1, 1, 1], 1]]},
    "shapes": {
        "transfer": {
            "boxes": [[[100, 900], [20, None], [1, 0.5, 0], 0.4]],
            "arches": [[[300, 950], 90.5, [0, 0.5, 1], 0.3]],
            "unit_distance": 2,
        }
    },
    "words": {"mode": "mip", "window": [500, 800], "cmap": "viridis", "background": [0.1, 0.2, 0.3]},
    "heat": {"heat": True, "furniture.box": True},
    "wiper": {"mode": "isosurface", "filter": "bspline3", "wiper": {"filter": "nearest", "at": 0.4}},
    "axial": {"layout": "slice", "active": "z", "crosshair": [0, 18, 51.3], "slice.zoom": 1.4},
    "sagittal": {"layout": "slice", "active": "x", "filter": "linear", "window": [450, 700], "cmap": "bone", "background": None},
    "own window": {"layout": "slice", "active": "y", "window": [450, 700], "slice.window": [300, 900]},
    "oblique slab": {"layout": "slice", "active": "y", "slice.turn": [0.3, -0.2, 0.5], "slice.thickness": 4.5, "slice.alike": True},
    "cut wiper": {"layout": "slice", "active": "y", "filter": "bspline3", "wiper": {"filter": "nearest", "at": 0.5}},
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("look", LOOKS)
def test_the_still_picture_matches_the_copied_program(client: Client, volume: Volume, look: str) -> None:
    client.set(**LOOKS[look])
    client.resize(*SIZE)
    shown = client.session.state.active if client.session.state.layout == "slice" else None
    message, pixels = client.wait(lambda m: m["type"] == "frame" and m["final"])
    shown = message["pane"]
    assert (message["format"], message["width"], message["height"]) == ("png", *SIZE)
    assert client.session.state.layout != "slice" or shown == client.session.state.active
    assert np.array_equal(decoded(pixels), drawn(client.session.python(), volume))
    assert from_url(client.session.url()) == client.session.state
    assert from_toml(client.session.toml()) == client.session.state
    assert not client.of("status")


def test_no_name_leaves_a_comment_or_a_text_of_what_is_copied(volume: Volume, device: Device) -> None:
    """A file's name with a newline ended the comment; TOML has neither JSON's halves of characters nor a bare DEL."""
    name, channel = "a\n[view]\nb = 1 \x1b[31m\u2028.nii", "\U0001f9e0 \x7f\n[render]"
    view = View(volume, device=device, source=f"clvol.read({name!r}, channel={channel!r})")
    client = Client(view)
    text, program = client.session.toml(), client.session.python()
    client.close()
    view.close()
    found = tomllib.loads(text)
    assert set(found) == {"render", "view"}
    assert found["render"]["channel"] == channel
    assert from_toml(text) == view.state
    assert text.replace("\n", "").isprintable()
    tree = ast.parse(program)
    assert [word.value for word in ast.walk(tree) if isinstance(word, ast.Constant) and word.value in (name, channel)] == [
        name,
        channel,
    ]


@pytest.fixture(scope="module")
def copied(volume: Volume, device: Device) -> Iterator[Callable[[str], tuple[str, str]]]:
    """Python and TOML of a view of a file, by its name; the channel may have one, too."""
    view = View(volume, device=device)
    size = PaneSize(*SIZE)

    def texts(path: str, **more: str) -> tuple[str, str]:
        view.resident.source = f"clvol.read({path!r}{''.join(f', {key}={value!r}' for key, value in more.items())})"
        given = view.resident, view.state, "3d", size, SIZE
        return code.python(*given), code.toml(*given)

    yield texts
    view.close()


@settings(max_examples=cases.examples(300), deadline=None)
@given(name=st.binary(min_size=1, max_size=12).map(os.fsdecode) | st.text(st.characters(exclude_categories=["Cs"]), min_size=1))
def test_what_is_copied_can_be_read_whatever_a_file_is_called(copied: Any, name: str) -> None:
    program, text = copied(name)
    (read,) = (one for one in ast.walk(ast.parse(program)) if isinstance(one, ast.Call) and ast.unparse(one.func) == "clvol.read")
    assert ast.literal_eval(read.args[0]) == name
    assert tomllib.loads(text.encode().decode())["render"]["mode"] == "composite"  # which a file can hold
    assert len(text.partition("\n")[0].splitlines()) == 1


@pytest.mark.skipif(os.name != "posix" or not shutil.which("bash"), reason="needs Bash")
def test_the_copied_command_names_the_file(copied: Any) -> None:
    names = [
        "a b.nii",
        "it's.nii",
        'say "no".nii',
        "a\\x41.nii",
        "a\nb'.nii",
        "\\\t'\x1b[31m",
        os.fsdecode(b"\xff\xe9.nii"),
        "\u2028ä.nii",
    ]
    for name in names:
        command = copied(name)[1].partition("\n")[0].removeprefix("# clvol render ")
        said = subprocess.run(["bash", "-c", f"printf '%s\\0' {command}"], stdout=subprocess.PIPE, check=True).stdout
        assert os.fsdecode(said.partition(b"\0")[0]) == name


def test_toml_refuses_what_is_no_unicode(copied: Any) -> None:
    name = os.fsdecode(b"\xff")
    assert tomllib.loads(copied("a.nii", channel='\x7f\x00\u2028"\\')[1])["render"]["channel"] == '\x7f\x00\u2028"\\'
    with pytest.raises(OptionError, match="TOML holds only texts of Unicode"):
        copied("a.nii", channel=name)


def test_a_view_starts_as_render_draws(volume: Volume, device: Device) -> None:
    options: dict[str, Any] = {
        "camera": clvol.Camera.orbit(40, 25, zoom=1.2),
        "mode": "isosurface",
        "isovalue": 500,
        "filter": "catmull-rom",
        "lights": Light(),
        "material": Material(0.3, 0.6),
        "theme": "print",
        "box": True,
        "gradient": "central",
        "rays": 2,
    }
    view = View(volume, device=device, **options)
    picture = view.picture(SIZE)
    assert np.array_equal(to_bytes(picture), to_bytes(clvol.render(volume, size=SIZE, device=device, **options)))
    space: dict[str, Any] = {"volume": volume}
    exec(view.python(SIZE), space)
    assert np.array_equal(space["picture"], picture)
    view.close()


def test_a_view_applies_its_limits_and_so_does_its_program(volume: Volume) -> None:
    limits = {"evaluator": "paired", "fetch": "buffer"}
    view = View(volume, limits=limits, filter="bspline3")
    picture = view.picture(SIZE)
    with clvol.device.as_device().limited(**limits):
        assert np.array_equal(picture, clvol.render(volume, filter="bspline3", size=SIZE))
    text = view.python(SIZE)
    assert "with as_device().limited(evaluator='paired', fetch='buffer'):" in text
    space: dict[str, Any] = {"volume": volume}
    exec(text, space)
    assert np.array_equal(space["picture"], picture)
    view.close()


def test_a_scene_sets_the_initial_state(volume: Volume, device: Device) -> None:
    transfer = TransferFunction(((0, "black"), (900, "red")), ((100, 0.0), (500, 1.0)))
    medium = clvol.Medium(volume, transfer=transfer, material=Material(0.4), filter="linear")  # type: ignore[arg-type]  # converted
    scene = clvol.Scene((medium,), lights=(Light(),), background=None, clip=((-9, 6, 41), (9, 28, 60)))
    view = View(scene, device=device)
    assert view.state.transfer is not None
    assert [view.state.filter, view.state.background, view.state.lights] == ["linear", None, (Light(),)]
    with clvol.Renderer(scene, device=device) as renderer:
        there = np.asarray(renderer.render(size=SIZE), np.float64)
    assert np.abs(view.picture(SIZE) - there).max() < 2e-3  # points of colour and opacity are merged
    view.close()
    with clvol.Field(volume, "bspline3", device=device, precision="single") as field:
        view = View(field)
        assert np.array_equal(view.picture(SIZE), clvol.render(volume, filter="bspline3", size=SIZE, device=device))
        view.close()
        assert not field.closed


def test_planes_and_corners_cut_a_view_open(volume: Volume, device: Device) -> None:
    """As in `render`, and in the program and the command that are copied."""
    x, y, z = map(float, volume.center)
    inf = float("inf")
    clip = [clvol.Plane((1, -0.5, 0.2), (x, y, z)), clvol.Corner((-inf, -inf, z), (inf, y, inf))]
    view = View(volume, clip=clip, mode="isosurface", cap=True, device=device)
    want = clvol.render(volume, clip=clip, mode="isosurface", cap=True, size=SIZE, device=device)
    assert np.array_equal(view.picture(SIZE), want)
    space: dict[str, Any] = {"volume": volume}
    exec(view.python(SIZE), space)
    assert np.array_equal(space["picture"], want)
    client = Client(view)
    command = client.session.toml().splitlines()[0]
    client.close()
    assert f"--clip-plane {' '.join(map(repr, (*clip[0].normal, *clip[0].point)))} --clip-corner -inf -inf" in command
    view.close()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"isovalue": 3}, "isovalue is no option of composite"),
        ({"modus": "mip"}, "modus is no option"),
        ({"mode": "iso"}, "mode must be one of"),
        ({"filter": "cubik"}, "filter must be one of"),
        ({"step": -1}, "step must be"),
        ({"size": (3, 3)}, "size is no option of a view"),
        ({"camera": 3}, "camera must be a Camera"),
        ({"clip": ((1, 1, 1), (0, 2, 2))}, "clip must be two corners"),
        ({"preset": "labels", "window": (0, 1)}, "window"),
        ({"theme": "dark"}, "theme must be one of screen, print"),
        ({"tolerance": 0.01, "step": 0.5}, "tolerance chooses the step"),
        ({"shadow_rays": True}, "shadow_rays changes nothing without shadow"),
        ({"shadow": 1.0, "occlusion": 0.5, "gradient_opacity": 0.5}, "shadow and occlusion must be left out beside opacity by"),
        ({"shadow": 1.0, "transfer": TransferFunction2D([((0, 1), (0, None), "red", 1)])}, "shadow must be left out beside"),
    ],
    ids=str,
)
def test_a_view_rejects_errors_at_once(volume: Volume, options: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        View(volume, **options)


def test_a_view_accepts_only_volumes() -> None:
    with pytest.raises(DataError, match="3 axes"):
        View(np.zeros((4, 5)))


# -- what comes and goes -----------------------------------------------------------------------------------------


def test_the_first_messages_to_a_client(client: Client, volume: Volume) -> None:
    state, _ = client.wait(lambda m: m["type"] == "state" and "effective" in m)
    info = client.of("info")[0]
    assert client.got[0][0] is info
    assert info["volume"]["shape"] == [20, 24, 28]
    assert sum(info["histogram"]["counts"]) == volume.data.size
    assert len(info["histogram"]["edges"]) == len(info["histogram"]["counts"]) + 1
    assert info["modes"]["isosurface"]["isovalue"]["kind"] == "number"
    assert info["modes"]["isosurface"]["method"] | {"help": ""} == {
        "kind": "choice",
        "default": "exact",
        "choices": ["exact", "stepped"],
        "help": "",
    }
    composite = info["modes"]["composite"]
    assert [composite[name].get(part) for name, part in (("virtual", "step"), ("tolerance", "scale"))] == [1, "log"]
    assert "bspline3(auto)" in info["filters"]
    assert state["effective"]["transfer"]["points"]
    assert [state["can_undo"], state["can_redo"]] == [False, False]
    assert clvol.view.State.from_json(state["state"]) == client.session.state


def test_a_drag_shows_previews_then_the_still_picture_in_one_undo_step(client: Client) -> None:
    client.set(mode="isosurface")
    client.resize(*SIZE)
    client.still()
    client.wait(lambda m: m["type"] == "stats")
    client.forget()
    client.event("pointer_down", x=20, y=20, button=1)
    for i in range(12):
        client.event("pointer_move", x=20 + 4 * i, y=20, button=1)
        time.sleep(0.02)
    client.event("pointer_up", x=66, y=20, button=1)
    client.still()
    kinds = [(m["format"], m["final"]) for m in client.of("frame")]
    assert kinds.count(("png", True)) == 1
    assert kinds[-1] == ("png", True)
    assert ("jpeg", False) in kinds
    states = client.of("state")
    assert len(states) == 1  # after the drag
    assert states[0]["can_undo"]
    client.forget()
    client.session.receive({"type": "do", "what": "undo", "id": 7})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 7)
    assert client.session.state.camera.direction == pytest.approx(client.session._resident.initial.camera.direction)
    assert client.session.state.mode == "isosurface"


def test_a_change_undone_before_it_was_sent_can_be_redone(client: Client) -> None:
    client.resize(*SIZE)
    client.still()
    client.wait(lambda m: m["type"] == "state" and "effective" in m)  # this state has nothing left to send
    client.forget()
    first = client.session.state
    client.event("wheel", x=40, y=30, dx=0, dy=-100)  # sent when it rests
    client.session.receive({"type": "do", "what": "undo", "id": 7})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 7)
    client.wait(lambda m: m["type"] == "state" and m["can_redo"] and not m["can_undo"])
    assert client.session.state == first


def test_states_acknowledge_changes(client: Client) -> None:
    """Including rejected and void ones."""
    client.wait(lambda m: m["type"] == "state")
    for number, changes in enumerate(({"mode": "mip"}, {"mode": "mip"}, {"mode": "none"}, {"index.time": "never"}, {}), 1):
        client.session.receive({"type": "set", "changes": changes, "number": number})
        message, _ = client.wait(lambda m, number=number: m["type"] == "state" and m["heard"] == number)
        assert message["state"]["mode"] == "mip"
    client.session.receive({"type": "set", "changes": {"mode": "minip"}, "number": "a text"})
    message, _ = client.wait(lambda m: m["type"] == "state" and m["state"]["mode"] == "minip")
    assert message["heard"] == 5


def test_after_a_click_and_a_change_the_session_still_responds(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    client.resize()
    client.still()
    budgets: list[float] = []
    shots = client.session._drawer.shots
    monkeypatch.setattr(client.session._drawer, "shots", lambda order: budgets.append(order.budget) or shots(order))
    for kind, buttons in (("pointer_down", [1]), ("pointer_up", [])):
        client.event(kind, pane="3d", x=20, y=20, button=1, buttons=buttons)
    client.set(step=0.25)  # takes longer than any previous one
    client.wait(lambda m: m["type"] == "frame" and m["final"] and m["number"] > 1)
    client.forget()
    client.set(step=0.3)
    client.still()
    assert budgets
    assert max(budgets) < 1


def test_an_error_of_one_pane_stays_while_others_are_drawn(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client(view)

    def broken(*_: Any, **__: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(clvol.Renderer, "refine", broken)
    client.set(layout="linked", camera__zoom=1.7)
    client.resize(*SIZE)
    for pane in "xyz":
        client.still(pane)
    client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    client.forget()
    client.set(slice__zoom=1.5)
    for pane in "xyz":
        client.still(pane)
    assert not client.of("status")
    client.close()


def test_the_wiper_shows_previews_and_draws_nothing_twice(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client(view)
    made: list[tuple[str | None, float]] = []
    of = Drawer._of

    def noted(self: Drawer, order: Order, chosen: str | None) -> Any:
        made.append((chosen, order.budget))
        return of(self, order, chosen)

    monkeypatch.setattr(Drawer, "_of", noted)
    client.set(mode="isosurface", filter="bspline3", wiper={"filter": "nearest", "at": 0.5})
    client.resize(*SIZE)
    client.still()
    assert sorted({row for row, _ in made}, key=str) == ["bspline3", "nearest"]
    made.clear()
    client.forget()
    client.set(wiper__at=0.6)
    client.still()
    assert made == []  # both are known
    client.set(step=0.01, filter="linear")
    client.resize(900, 900)
    client.wait(lambda m: m["type"] == "frame" and not m["final"])
    client.close()


def test_unmeasurable_errors_are_reported(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> Any:
        raise clvol.DataError("no such samples")

    monkeypatch.setattr("clvol.view.wiper.measured", broken)
    client = Client(view)
    client.set(mode="isosurface", filter="bspline3", wiper={"filter": "nearest", "at": 0.5})
    client.resize(*SIZE)
    message, _ = client.wait(lambda m: m["type"] == "wiper" and m["errors"])
    assert message["errors"] == {"problem": "no such samples", "filters": []}
    client.close()


def test_saving_a_picture_stops_with_its_session(view: View) -> None:
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    client.set(mode="composite", step=0.02, options__termination=0.0, opacity=0.01)
    client.forget()
    client.session.receive({"type": "do", "what": "save_picture", "width": 3000, "height": 3000, "id": 1})
    client.wait(lambda m: m["type"] == "status" and m["kind"] == "busy")
    began = time.monotonic()
    client.close()
    assert time.monotonic() - began < 2


def test_the_newest_state_wins(view: View) -> None:
    """Of hundreds of states that arrive faster than pictures, few are rendered, and the last one is."""
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    client.forget()
    for i in range(300):
        client.session.receive({"type": "set", "changes": {"camera.zoom": 1 + i / 300}, "live": True})
    client.set(camera__zoom=2.0)
    deadline = time.monotonic() + 30
    while client.session.state.camera.zoom != 2 and time.monotonic() < deadline:
        time.sleep(0.005)
    client.forget()
    client.still()
    assert client.session.state.camera.zoom == 2
    assert len(client.of("frame")) <= 20
    message, data = client.wait(lambda m: m["type"] == "frame" and m["final"])
    assert message["final"]
    assert np.array_equal(decoded(data), drawn(client.session.python(), view.volume))
    client.close()


def test_a_long_picture_is_cancelled_by_a_change(view: View) -> None:
    """A still picture of many seconds; the next change is answered long before it would finish."""
    client = Client(view)
    client.set(mode="composite", step=0.02, options__termination=0.0, opacity=0.01)
    client.resize(1800, 1400)
    client.wait(lambda m: m["type"] == "frame")
    time.sleep(0.3)
    assert not any(m["final"] for m in client.of("frame"))
    began = time.monotonic()
    client.session.receive({"type": "do", "what": "copy_url", "id": 1})
    client.wait(lambda m: m["type"] == "reply")
    assert time.monotonic() - began < 0.5  # 20 ms on an idle machine
    began = time.monotonic()
    client.close()
    assert time.monotonic() - began < 2


def test_at_most_two_frames_are_in_flight(view: View) -> None:
    client = Client(view, acknowledges=False)
    client.resize(*SIZE)
    client.set(mode="isosurface")
    client.wait(lambda m: m["type"] == "frame")
    for i in range(20):
        client.set(camera__zoom=1 + i / 20)
        time.sleep(0.02)
    time.sleep(0.2)
    assert len(client.of("frame")) <= 2
    client.acknowledges = True
    for message in client.of("frame"):
        client.session.receive({"type": "ack", "frame": message["number"]})
    client.wait(lambda m: m["type"] == "frame" and m["final"] and m["number"] > 2)
    client.close()


def test_errors_are_reported_and_the_session_continues(client: Client) -> None:
    client.resize(*SIZE)
    client.still()
    for message, says in [
        ({"type": "set", "changes": {"step": -1}}, "step must be"),
        ({"type": "set", "changes": 3}, "changes must be an object"),
        ({"type": "set", "changes": {"preset": "ct"}}, "preset"),
        ({"type": "nonsense"}, "the type of a message must be one of"),
        ({"type": "event", "event": {"event_type": "resize", "width": "a"}}, "width must be"),
        ({"type": "do", "what": "_close"}, "what to do must be one of"),
        ({"type": "do", "what": "save_picture", "width": 1 << 20}, "width must be"),
        ([], "a message must be an object"),
    ]:
        client.forget()
        client.session.receive(message)  # type: ignore[arg-type]  # what clients send
        status, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
        assert says in status["text"]
        if isinstance(message, dict) and message["type"] == "do":
            assert says in client.of("reply")[0]["error"]
    # what only the picture rejects: one so wide that float32 misses the rays
    client.forget()
    client.set(camera__target=[0, 0, 0], camera__radius=1e9, mode="isosurface")
    client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    client.forget()
    client.set(camera__target=None, camera__radius=None)
    client.still()


def test_what_is_said_goes_once_it_no_longer_holds(client: Client) -> None:
    """Warnings of a picture until the next one without, errors of a request until the next that is granted."""
    client.resize(*SIZE)
    client.set(mode="isosurface", options__isovalue=1e9, furniture__cube=True)  # which is no matter
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "warning")
    assert "nothing is seen: isovalue 1e+09 is outside the samples" in told["text"]
    client.set(step=-1)
    client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    client.forget()
    client.session.receive({"type": "do", "what": "copy_toml", "id": 1})
    again, _ = client.wait(lambda m: m["type"] == "status")
    assert again == told
    client.set(options__isovalue=None)
    told, _ = client.wait(lambda m: m["type"] == "status" and m != again)
    assert (told["text"], told["kind"]) == ("", "info")


def test_a_failing_device_is_reported_and_retried(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    forgotten = []
    resident = view.resident
    refine, forget = clvol.Renderer.refine, resident.forget
    monkeypatch.setattr(resident, "forget", lambda: forgotten.append(forget()))
    fails = [clvol.DeviceError("the device was lost"), MemoryError(), ZeroDivisionError("a fault of ours")]

    def broken(*args: Any, **options: Any) -> Any:
        if fails:
            raise fails[0]
        return refine(*args, **options)

    monkeypatch.setattr(clvol.Renderer, "refine", broken)
    faults = (1.1, "the device was lost", 2), (1.2, "out of memory", 1), (1.3, "ZeroDivisionError: a fault of ours", 1)
    for zoom, says, times in faults:  # a lost device is tried once more
        client.forget()
        client.set(camera__zoom=zoom)
        with client.condition:
            told = client.condition.wait_for(lambda times=times: len(found := client.of("status")) >= times and found, 60)
        assert [says in status["text"] for status in told] == times * [True]
        fails.pop(0)
    assert len(forgotten) == 2
    client.forget()
    client.set(camera__zoom=1.4)
    client.still()
    assert [(m["text"], m["kind"]) for m in client.of("status")] == [("", "info")]  # the error is gone
    client.close()


def test_a_client_that_vanishes_ends_its_session(view: View) -> None:
    def send(message: dict[str, Any], data: bytes | None) -> None:  # noqa: ARG001
        if message["type"] == "frame":
            raise ConnectionResetError

    session = view.session(send)
    session.receive({"type": "event", "event": {"event_type": "resize", "width": 64, "height": 64, "ratio": 1}})
    session._thread.join(60)
    assert session.closed
    assert not session._thread.is_alive()
    session.receive({"type": "do", "what": "fit"})
    session.close()


def test_two_sessions_share_the_coefficients_not_the_state(view: View) -> None:
    one, two = Client(view), Client(view)
    one.set(mode="isosurface", filter="linear")
    two.set(mode="isosurface", filter="linear", camera__zoom=2.0)
    for client in (one, two):
        client.resize(*SIZE)
        client.still()
    assert [client.session.state.camera.zoom for client in (one, two)] == [1, 2]
    assert sum(key[0] == "linear" for key in view.resident.renderers._entries) == 1
    for name in ("nearest", "bspline3"):
        one.forget()
        one.set(filter=name)
        one.still()
    one.close()
    two.close()
    deadline = time.monotonic() + 60  # statistics beside a picture may still build a kernel
    while any(entry.users for entry in view.resident.renderers._entries.values()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(view.resident.renderers._entries) == 2  # the last two, now that no other is in use
    assert not any(entry.users for entry in view.resident.renderers._entries.values())


def test_pictures_at_rest_have_no_fewer_pixels_than_those_before(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """What refines a picture begins with few pixels, which would flash between a drag and its end."""

    def shots(_: Drawer, order: Order) -> Iterator[Shot]:
        for size in (1,) if order.coarse else (8, 2, 1):
            yield Shot(np.zeros((72 // size, 96 // size, 3), np.uint8), size == 1 and not order.coarse)

    client.resize()
    client.still()
    monkeypatch.setattr(Drawer, "shots", shots)
    client.forget()
    client.session.receive({"type": "set", "changes": {"opacity": 0.5}, "live": True})
    client.still()
    assert [m["width"] for m in client.of("frame")] == [96, 96]
    client.forget()
    client.set(mode="mip")
    client.still()
    assert client.of("frame")[0]["width"] == 96  # as good as those of a drag


def test_linked_panes_follow_the_crosshair(client: Client) -> None:
    client.set(layout="linked", mode="isosurface", options__isovalue=500)
    for name in ("3d", "x", "y", "z"):
        client.resize(64, 48, pane=name)
    for name in ("3d", "x", "y", "z"):
        client.still(name)
    client.wait(lambda m: m["type"] == "overlay" and m["pane"] == "z" and m["crosshair"] is not None)
    client.forget()
    client.event("pointer_down", pane="z", x=40, y=20, button=1)
    client.event("pointer_up", pane="z", x=40, y=20, button=1)
    for name in ("x", "y"):
        client.still(name)
    overlay, _ = client.wait(lambda m: m["type"] == "overlay" and m["pane"] == "z")
    assert overlay["crosshair"] == pytest.approx([40, 20])
    assert not any(m["pane"] in ("z", "3d") for m in client.of("frame"))  # these show the same as before
    client.forget()
    client.event("pointer_down", pane="z", x=20, y=20, button=2)
    client.event("pointer_move", pane="z", x=34, y=30, button=2)
    client.event("pointer_up", pane="z", x=34, y=30, button=2)
    for name in ("x", "y", "z"):
        client.still(name)
    assert client.session.state.slice.window is not None
    assert not any(m["pane"] == "3d" for m in client.of("frame"))  # nor does it take the window of slices
    # a click on the surface takes it there
    client.forget()
    client.event("pointer_down", pane="3d", x=32, y=24, button=1)
    client.event("pointer_up", pane="3d", x=32, y=24, button=1)
    found, _ = client.wait(lambda m: m["type"] == "reply" and m["what"] == "pick")
    assert client.session.state.crosshair == pytest.approx(tuple(found["position"]))
    assert found["value"] == pytest.approx(500, abs=0.5)


def test_a_pick_is_exact(client: Client, volume: Volume, device: Device) -> None:
    client.set(mode="isosurface", options__isovalue=500, filter="bspline3")
    client.resize(*SIZE)
    client.still()
    client.session.receive({"type": "do", "what": "pick", "x": 48.5, "y": 36.5, "id": 1})
    found, _ = client.wait(lambda m: m["type"] == "reply")
    camera = client.session._control.context().placed(client.session.state, 4 / 3)
    options: dict[str, Any] = {"isovalue": 500, "filter": "bspline3", "size": SIZE, "device": device}
    at = clvol.render(volume, camera, "isosurface", outputs="position", **options)[36, 48]
    assert np.linalg.norm(np.subtract(found["position"], at)) < 1e-3
    assert found["value"] == pytest.approx(500, abs=0.05)
    slope = clvol.sample(volume, at, filter="bspline3", derivative=1, device=device)
    assert found["gradient"] == pytest.approx(slope.tolist(), rel=1e-3)
    client.forget()
    client.session.receive({"type": "do", "what": "pick", "x": 0.5, "y": 0.5, "id": 2})
    nothing, _ = client.wait(lambda m: m["type"] == "reply")
    assert nothing["position"] is None
    client.forget()
    client.session.receive({"type": "do", "what": "pick", "x": 40, "y": 30, "pane": "y", "id": 3})
    cut, _ = client.wait(lambda m: m["type"] == "reply")
    assert cut["position"][1] == pytest.approx(volume.center[1])
    assert cut["value"] == pytest.approx(float(clvol.sample(volume, cut["position"], filter="bspline3", device=device)), abs=1e-2)


def test_the_point_under_the_cursor_stays_on_a_surface(client: Client) -> None:
    client.set(mode="isosurface", options__isovalue=500)
    client.resize(*SIZE)
    client.still()
    before = client.session._control.pick("3d", 58, 30)["position"]
    client.event("wheel", x=58, y=30, dy=-300)
    client.forget()
    client.wait(lambda m: m["type"] == "frame" and m["final"])
    context = client.session._control.context()
    assert context.pane(client.session.state, "3d").project(before) == pytest.approx((58, 30), abs=1e-3)


def test_the_crop_box_is_dragged_in_the_volume_and_shown(client: Client, volume: Volume) -> None:
    """Several boxes in succession: measured times of one picture are used for the next."""
    client.set(mode="isosurface", tool="crop", camera__direction=[0, 1, 0], camera__projection="orthographic")
    client.resize(*SIZE)
    client.still()
    client.forget()
    high = volume.corners.max(0)
    context = client.session._control.context()
    x, y = context.pane(client.session.state, "3d").project([high[0], volume.center[1], volume.center[2]])
    client.event("pointer_down", x=x, y=y, button=1)
    for i in range(5):
        client.event("pointer_move", x=x - 4 * i, y=y, button=1)
        time.sleep(0.03)
    client.event("pointer_up", x=x - 16, y=y, button=1)
    _, pixels = client.still()
    clip = client.session.state.clip
    assert clip is not None
    assert clip[1][0] == pytest.approx(high[0] - 16 / context.pane(client.session.state, "3d").unit_pixels, rel=1e-6)
    assert np.array_equal(pixels, drawn(client.session.python(), volume))
    overlay, _ = client.wait(lambda m: m["type"] == "overlay" and m["box"] is not None)
    assert len(overlay["box"]) == 8
    assert {tuple(face[:2]) for face in overlay["faces"]} == {(0, 0), (0, 1), (2, 0), (2, 1)}
    client.session.receive({"type": "do", "what": "undo", "id": 1})
    client.wait(lambda m: m["type"] == "reply")
    assert client.session.state.clip is None  # the drag is one step
    assert not client.of("status")


def test_the_wiper_reports_the_error_of_both_filters(view: View) -> None:
    client = Client(view)
    client.set(mode="isosurface", filter="bspline3", wiper={"filter": "nearest", "at": 0.5})
    client.resize(*SIZE)
    message, _ = client.wait(lambda m: m["type"] == "wiper" and m["errors"])
    one, other = message["errors"]["filters"]
    assert [one["filter"], other["filter"]] == ["bspline3", "nearest"]
    assert 0 <= one["rms"] < other["rms"]
    assert one["expected"] < other["expected"]
    expected = clvol.analysis.leave_out(Volume(view.volume.data, view.volume.spacing), ["nearest"], sigma=0)[0]
    noise = view.volume.noise.sigma
    assert math.hypot(other["x"], noise) == pytest.approx(expected.x or 0, rel=1e-3, abs=noise)
    client.forget()
    client.set(wiper={"filter": "linear", "at": 0.5})  # the measurement of another is not shown beside it
    client.wait(lambda m: m["type"] == "wiper" and m["errors"] is None)
    message, _ = client.wait(lambda m: m["type"] == "wiper" and m["errors"])
    assert [row["filter"] for row in message["errors"]["filters"]] == ["bspline3", "linear"]
    client.forget()
    client.set(wiper__at=0.7)
    client.still()
    assert not client.of("wiper")
    client.close()
    assert not any(thread.name == "clvol view: aside" for thread in threading.enumerate())


def test_pictures_and_movies_are_saved(client: Client, volume: Volume) -> None:
    client.set(mode="isosurface", options__isovalue=500)
    client.resize(*SIZE)
    client.session.receive({"type": "do", "what": "save_picture", "width": 50, "height": 70, "id": 1})
    message, data = client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    assert message["format"] == "png"
    state = client.session.state
    assert np.array_equal(decoded(data), to_bytes(clvol.render(volume, mode="isosurface", isovalue=500, size=(50, 70)))[..., :3]), (
        state
    )
    client.session.receive({"type": "do", "what": "movie", "width": 32, "height": 24, "frames": 3, "id": 2})
    _, data = client.wait(lambda m: m["type"] == "reply" and m["id"] == 2)
    assert data is not None
    assert data[:6] == b"GIF89a"
    client.session.receive({"type": "do", "what": "movie", "width": 32, "height": 24, "frames": 2, "format": "zip", "id": 3})
    _, data = client.wait(lambda m: m["type"] == "reply" and m["id"] == 3)
    assert data is not None
    assert data[:2] == b"PK"


def test_random_events_leave_a_working_session(view: View) -> None:
    chance = random.Random(5)
    client = Client(view)
    client.resize(48, 36)
    for i in range(2000):
        client.session.receive({"type": "event", "event": random_event(chance, 48, 36)})
        if i % 100 == 0:
            time.sleep(0.02)
    client.session.receive({"type": "do", "what": "reset", "id": 1})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    client.forget()
    client.session.receive({"type": "event", "event": {"event_type": "blur"}})
    client.set(layout="3d", mode="isosurface", options__isovalue=333)
    client.still()
    assert [m for m in client.of("status") if m["kind"] == "error" and "Error" in m["text"]] == []
    client.close()


def test_a_flood_is_bounded(view: View) -> None:
    client = Client(view)
    for _ in range(20000):
        client.session.receive({"type": "set", "changes": {"camera.zoom": 1.5}})
    assert len(client.session._post.inbox) <= 4096
    client.session.receive({"type": "event", "event": {"event_type": "blur"}})
    began = time.monotonic()
    client.close()
    assert time.monotonic() - began < 2


def test_nothing_is_left_of_sessions(view: View) -> None:
    def one() -> None:
        client = Client(view)
        client.set(mode="isosurface")
        client.resize(32, 24)
        client.still()
        client.close()

    one()
    gc.collect()
    threads, sessions = threading.active_count(), _sessions()
    for _ in range(20):
        one()
    gc.collect()
    assert threading.active_count() <= threads  # one of another test may end meanwhile
    assert _sessions() <= sessions
    assert all(entry.users == 0 for entry in view.resident.renderers._entries.values())


def _sessions() -> int:
    return sum(isinstance(thing, Session) for thing in gc.get_objects())


def test_a_volume_without_finite_samples_is_reported_and_the_session_survives(device: Device) -> None:
    client = Client(View(Volume(np.full((4, 4, 4), np.nan, np.float32)), device=device))
    client.resize()
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert told["text"]
    assert not client.session.closed
    client.close()


def test_editing_a_point_keeps_the_unit_distance(device: Device) -> None:
    view = View(clvol.phantoms.sphere(24), device=device)
    resident = view.session(lambda *_: None)._resident
    transfer = resident.effective(State())["transfer"]
    own = resident.transfer(State())
    assert transfer.get("unit_distance") == own.unit_distance
    edited = State().changed({f"transfer.{name}": value for name, value in transfer.items()})
    assert resident.transfer(edited).unit_distance == own.unit_distance
    view.close()


def test_an_evicted_renderer_is_closed_by_its_last_user(view: View) -> None:
    session = view.session(lambda *_: None)
    resident = session._resident
    with resident.renderers.renderer("linear", "mirror") as mine:
        resident.forget()
        with resident.renderers.renderer("linear", "mirror") as other:
            assert other is not mine
        assert mine.render(size=(8, 8)).shape == (8, 8, 4)
    with pytest.raises(OptionError, match="closed"):
        mine.render(size=(8, 8))
    session.close()
