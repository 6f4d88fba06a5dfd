"""Several volumes on one grid: one is shown at a time, the camera persists, and copied programs name the volume."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import Volume, Volumes
from clvol.base import memory
from clvol.base.errors import OptionError
from clvol.cli.options import Input, Look
from clvol.cli.view import _made, _read
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import State, View, from_toml, from_url
from clvol.view.catalog import Which
from clvol.view.resident import Resident
from clvol.volume.volumes import Leading
from tests.view.clients import Client, decoded

AT_REST = SIZE = 96, 72
TIMES = 4


def samples() -> NDArray[np.float32]:
    """A ball that moves along x with time; the second channel is wider, elsewhere, and ten times brighter."""
    z, y, x = np.mgrid[:20, :22, :40].astype(np.float32)
    made = np.empty((TIMES, 2, *z.shape), np.float32)
    for t in range(TIMES):
        for c in range(2):
            far = ((x - 10 - 5 * t) ** 2 + (y - 8 - 5 * c) ** 2 + (z - 10) ** 2) / (9 + 12 * c)
            made[t, c] = 100 * 10**c * np.exp(-far)
    return made


@pytest.fixture(scope="module")
def volumes() -> Volumes:
    leading = Leading(("time", "channel"), (TIMES, 2), {"channel": ("DAPI", "GFP")}, colors=("blue", "green"))
    return Volumes(samples(), leading=leading, spacing=(1, 1.1, 1.2))


@pytest.fixture(scope="module")
def view(volumes: Volumes, device: Device) -> Iterator[View]:
    made = View(volumes, device=device)
    yield made
    made.close()


def ask(client: Client, what: str, **more: Any) -> dict[str, Any]:
    client.session.receive({"type": "do", "what": what, "id": what, **more})
    return client.wait(lambda m: m["type"] == "reply" and m["id"] == what)[0]


def test_the_panel_gets_the_axes(view: View, client: Client) -> None:
    info = view.resident.info()
    assert info["axes"] == [
        {"axis": "time", "count": 4, "names": [], "first": 0, "plays": True},
        {"axis": "channel", "count": 2, "names": ["DAPI", "GFP"], "first": 0, "plays": False},
    ]
    assert info["labels"] is None
    timed = Volumes(np.zeros((3, 4, 4, 4)), leading=Leading(("time",), (3,)), header={"time_step": 720.0, "time_unit": "msec"})
    assert [one.get("seconds") for one in View(timed, device=view.resident.device).resident.catalog.axes()] == [0.72]
    client.set(index__channel=1)
    again, _ = client.wait(lambda m: m["type"] == "info")
    assert info["volume"]["range"][1] == pytest.approx(100, rel=0.02)
    assert again["volume"]["range"][1] == pytest.approx(1000, rel=0.02)
    client.set(index__time=2)
    client.still()
    told, _ = client.wait(lambda m: m["type"] == "state" and m["state"]["index"] == {"time": 2, "channel": 1} and "effective" in m)
    assert max(point[0] for point in told["effective"]["transfer"]["points"]) > 500


@pytest.mark.parametrize("look", [{}, {"mode": "isosurface"}, {"mode": "mip"}, {"layout": "slice", "active": "z"}])
def test_each_is_shown_as_if_alone(client: Client, volumes: Volumes, device: Device, look: dict[str, Any]) -> None:
    pane = look.get("active", "3d")
    client.set(**look, **{"camera.fit": "volume", "index": {"channel": 1, "time": 3}})
    _, shown = client.still(pane)
    state = client.session.state
    alone = View(Volume(samples()[3, 1], spacing=(1, 1.1, 1.2), color="green", name="GFP"), device=device)
    alone.state = State.from_json(state.json() | {"index": {}})
    other = Client(alone)
    other.resize(*SIZE)
    assert np.array_equal(shown, other.still(pane)[1])
    assert shown.any()
    other.close()
    alone.close()
    program = client.session.python()
    assert "volume = volumes.pick(time=3, channel=1)" in program
    space: dict[str, Any] = {"volumes": volumes}
    exec(program, space)
    assert np.array_equal(shown[..., :3], to_bytes(space["picture"])[..., :3])
    assert from_url(client.session.url()) == state
    assert from_toml(client.session.toml()) == state


def test_camera_and_clip_persist_and_colours_follow_unless_edited(view: View, client: Client) -> None:
    client.set(clip={"low": [0, 0, 0], "high": [30, 20, 20]})
    client.still()
    client.forget()
    before = client.session.state
    seen = view.resident.placed(before, SIZE[0] / SIZE[1])
    client.set(index__channel=1)
    client.still()
    after = client.session.state
    now = view.resident.placed(after, SIZE[0] / SIZE[1])
    assert (now.target, now.radius, now.direction, after.clip) == (seen.target, seen.radius, seen.direction, before.clip)
    assert view.resident.transfer(after).value_range[1] > 5 * view.resident.transfer(before).value_range[1]
    edited = {"points": [[10, [1, 0, 0], 0], [90, [1, 1, 0], 1]]}
    client.set(transfer=edited)
    client.set(index__channel=0)
    client.still()
    client.event("key_down", key=".", pane="3d")
    client.wait(lambda m: m["type"] == "state" and m["state"]["index"].get("time") == 1)
    assert view.resident.transfer(client.session.state).value_range == (10, 90)


def test_many_steps_send_the_volume_once(view: View, client: Client) -> None:
    session, infos = client.session, []
    info = view.resident.info

    def slow(state: State | None = None) -> dict[str, Any]:  # meanwhile the others come
        infos.append(state)
        time.sleep(0.3)
        return info(state)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view.resident, "info", slow)
        for at in (1, 2, 3, 2, 1, 2, 3, 2, 1, 3):
            session.receive({"type": "set", "changes": {"index.time": at}, "live": True})
        client.wait(lambda m: m["type"] == "state" and m["state"]["index"] == {"time": 3})
        ask(client, "copy_url")
        client.set(camera__zoom=2.0)  # the same volume
        client.wait(lambda m: m["type"] == "state" and m["state"]["camera"]["zoom"] == 2)
        client.still()
    assert 1 <= len(client.of("info")) == len(infos) <= 3


def test_keys_step_through_times_and_undo_reverts(client: Client) -> None:
    first = client.session.state
    for key, at in ((".", 1), (".", 2), (",", 1), (".", 2), (".", 3), (".", 3)):
        client.event("key_down", key=key, pane="3d")
        client.event("key_up", key=key, pane="3d")
        ask(client, "copy_url")
        assert client.session.state.index["time"] == at
        client.forget()
    for _ in range(5):  # steps that follow each other at once are one
        ask(client, "undo")
        client.forget()
    assert client.session.state == first


def test_without_times_keys_step_along_the_first_axis(device: Device) -> None:
    few = Resident(Volumes(samples()[0]), device=device)
    assert few.catalog.stepped(State(), 1).index == {"volume": 1}
    assert few.catalog.stepped(State(index={"volume": 1}), 1).index == {"volume": 1}
    assert Resident(samples()[0, 0], device=device).catalog.stepped(State(), 1) == State()


def test_keys_step_from_a_channel_named_like_a_computed_one(device: Device) -> None:
    few = Resident(Volumes(samples()[0], leading=Leading(("channel",), (2,), {"channel": ("magnitude", "phase")})), device=device)
    assert few.catalog.stepped(State(index={"channel": "magnitude"}), 1).index == {"channel": 1}
    with pytest.raises(OptionError, match="channel must be 0 to 1"):
        few.catalog.stepped(State(index={"channel": "luminance"}), 1)
    colors = Resident(Volumes(samples()[0, :1].repeat(3, 0), leading=Leading(("channel",), (3,), rgb=True)), device=device)
    assert colors.catalog.stepped(State(), 1).index == {"channel": 0}
    assert colors.catalog.stepped(State(index={"channel": 0}), -1).index == {"channel": "luminance"}


@pytest.mark.parametrize(
    ("index", "says"),
    [
        ({"time": 4}, "time must be 0 to 3, because the volume holds 4 times; got 4"),
        ({"channel": 2}, "channel must be 0 to 1, of 0 (DAPI), 1 (GFP)"),
        ({"channel": "luminance"}, "channel must be 0 to 1"),
        ({"position": 0}, "index must be of time, channel; got position"),
        ({"time": -1}, "index.time must be a whole number"),
        ({"time": 10**30}, "index.time must be a whole number"),
    ],
)
def test_unknown_indices_are_rejected(view: View, client: Client, index: Any, says: str) -> None:
    before = client.session.state
    client.set(index=index)
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert says in told["text"]
    assert client.session.state == before
    with pytest.raises(OptionError):
        view.session(lambda *_: None, State().changed({"index": index}))


def test_one_volume_has_no_axes(device: Device) -> None:
    view = View(clvol.phantoms.sphere(16), device=device)
    assert view.resident.info()["axes"] == []
    client = Client(view)
    client.set(index={"time": 0})
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert "index must be left out, for there is one volume" in told["text"]
    client.close()
    view.close()


def test_colours_begin_with_their_luminance(device: Device) -> None:
    data = (samples()[0, :1].repeat(3, 0) * np.array([1, 0.5, 0.2]).reshape(3, 1, 1, 1)).astype(np.uint8)
    volumes = Volumes(data, leading=Leading(("channel",), (3,), rgb=True))
    resident = Resident(volumes, device=device)
    assert np.array_equal(resident.volume.data, volumes.pick(channel="luminance").data)
    assert resident.info()["axes"][0]["first"] == "luminance"
    assert np.array_equal(resident.catalog.volume_of(State(index={"channel": 2})).data, data[2])
    assert resident.catalog.volume_of(State(index={"channel": "luminance"})) is resident.volume


def test_labels_beside_an_image_are_hidden_independently(device: Device) -> None:
    data = np.zeros((2, 16, 16, 16), np.uint8)
    data[0, 4:12, 4:12, 4:12] = np.random.default_rng(0).integers(50, 250, (8, 8, 8))
    data[1, 4:8], data[1, 9:13] = 1, 5
    resident = Resident(Volumes(data, leading=Leading(("channel",), (2,))), device=device)
    hidden = State().changed({"labels": {"hidden": [5]}})
    resident.catalog.require(hidden)
    assert resident.catalog.volume_of(hidden) is resident.volume
    there = resident.catalog.volume_of(hidden.changed({"index.channel": 1}))
    assert set(np.unique(there.data)) == {0, 1}


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("clvol.read_all('x')", "clvol.read('x', time=2, channel=1)"),
        ("(clvol.read_all('x', axes='tc',))", "clvol.read('x', axes='tc', time=2, channel=1)"),
        (
            "clvol.read_all('x')[:2] + clvol.read_all('y')",
            "(clvol.read_all('x')[:2] + clvol.read_all('y')).pick(time=2, channel=1)",
        ),
        ("clvol.read_all('x').filled(0)", "clvol.read_all('x').filled(0).pick(time=2, channel=1)"),
        ("volumes  # clvol.read_all()", "volumes.pick(time=2, channel=1)"),
        ("load(clvol.read_all)('x')", "load(clvol.read_all)('x').pick(time=2, channel=1)"),
        ("lambda: 1", "(lambda: 1).pick(time=2, channel=1)"),
        ("what I opened", "(what I opened).pick(time=2, channel=1)"),
    ],
)
def test_a_copied_program_reads_a_single_volume_of_a_file(volumes: Volumes, source: str, text: str) -> None:
    view = View(volumes, source=source)
    view.state = view.state.changed({"index": {"channel": 1, "time": 2}})
    assert f"volume = {text}\n" in view.python()


def test_renderers_are_cached_while_they_fit(volumes: Volumes, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    resident = Resident(volumes, device=device)

    def tour() -> list[int]:
        for time_ in range(TIMES):
            state = State(index={"time": time_})
            with resident.renderers.renderer(None, "mirror", resident.catalog.which(state)) as renderer:
                assert np.array_equal(renderer.volume.data, samples()[time_, 0])
                size = renderer.field.nbytes
        return [size, len(resident.renderers._entries)]

    size, kept = tour()
    assert kept == TIMES
    monkeypatch.setattr(memory, "available", lambda: 4 * 3 * size)
    assert tour()[1] == 3
    monkeypatch.setattr(memory, "available", lambda: 0)
    assert tour()[1] == 2  # to come back to
    resident.close()
    assert not resident.renderers._entries


def test_a_preview_precedes_a_large_volume(device: Device) -> None:
    z, y, x = np.ogrid[:90, :200, :240]
    data = np.empty((2, 90, 200, 240), np.uint8)
    for i, middle in enumerate((80, 150)):
        data[i] = 200 * (((x - middle) / 60) ** 2 + ((y - 80) / 55) ** 2 + ((z - 45) / 25) ** 2 < 1)
    view = View(Volumes(data), device=device, mode="isosurface")
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    _, first = client.still()
    client.forget()
    client.set(index__volume=1)
    message, second = client.still()
    frames = client.of("frame")
    assert frames[0].get("few")
    assert not message.get("few")
    middle = [np.argwhere(picture[..., :3].any(-1)).mean(0)[1] for picture in (first, second)]
    assert middle[1] > middle[0] + 5  # +x is on the right, and the camera stayed
    sketch, data_ = next((m, d) for m, d in client.got if m["type"] == "frame")
    few = decoded(data_)[..., :3].max(-1) > 60
    assert np.argwhere(few).mean(0)[1] * SIZE[0] / sketch["width"] == pytest.approx(middle[1], abs=3)
    client.close()
    view.close()


def test_coefficients_of_another_volume_are_separate(volumes: Volumes, device: Device) -> None:
    resident = Resident(volumes, device=device)
    other = Which((2, 1))
    resident.renderers.prepare(None, "mirror", other).join(60)
    assert resident.renderers._entries[None, "mirror", other].renderer is not None
    assert (None, "mirror", Which((0, 0))) not in resident.renderers._entries
    resident.close()


# -- the command ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("device")
def test_the_command_reads_all_volumes_and_copies_one(volumes: Volumes, tmp_path: Path) -> None:
    file = tmp_path / "cells.ome.tif"
    clvol.write(volumes, file)
    found = _read(Input(), str(file))
    assert isinstance(found[0], Volumes)
    assert found[0].axes == ("time", "channel")
    view = _made(found, str(file), None, None, Look(), {})
    assert view.resident.name == "cells.ome.tif"
    view.state = view.state.changed({"index": {"channel": 1, "time": 2}})
    program = view.python(SIZE)
    assert f"volume = clvol.read({str(file)!r}, time=2, channel=1)" in program
    space: dict[str, Any] = {}
    exec(program, space)
    assert np.array_equal(space["picture"], view.picture(SIZE))
    with_client = Client(view)
    with_client.resize(*SIZE)
    copied = ask(with_client, "copy_toml")["text"]
    assert f"{file} -o picture.png" in copied
    assert "--time 2 --channel 1" in copied
    with_client.close()
    view.close()


@pytest.mark.parametrize(
    ("reader", "axes"), [(Input(channel="GFP"), ("time",)), (Input(time=1), ("channel",)), (Input(time=1, channel="1"), None)]
)
def test_only_the_chosen_volume_is_read(volumes: Volumes, tmp_path: Path, reader: Input, axes: tuple[str, ...] | None) -> None:
    file = tmp_path / "cells.ome.tif"
    clvol.write(volumes, file)
    scene, source, _ = _read(reader, str(file))
    assert source is not None
    if axes is None:
        assert isinstance(scene, Volume)
        assert np.array_equal(scene.data, samples()[1, 1])
        assert source.startswith("clvol.read(")
        return
    assert isinstance(scene, Volumes)
    assert scene.axes == axes
    resident = Resident(scene, source=source)
    program = View(scene, source=source).python()
    space: dict[str, Any] = {}
    exec(program.partition("picture =")[0], space)
    assert np.array_equal(space["volume"].data, resident.volume.data)
    resident.close()


def test_one_volume_of_a_large_file_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "cells.npy"
    np.save(file, samples())
    with pytest.warns(clvol.ClvolWarning, match="its axes were taken for"):
        assert isinstance(_read(Input(), str(file))[0], Volumes)
    monkeypatch.setattr("clvol.cli.view._is_small", lambda name: False)  # noqa: ARG005
    with pytest.warns(clvol.ClvolWarning, match="choose by"):
        scene, source, _ = _read(Input(), str(file))
    assert isinstance(scene, Volume)
    assert source == f"clvol.read({str(file)!r})"
