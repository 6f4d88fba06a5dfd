"""The preview shown while coefficients are computed: few samples, with the placement and look of all."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Volume
from clvol.device import Device
from clvol.view import View
from clvol.view.renderers import Renderers
from clvol.view.resident import Resident
from clvol.view.sketch import Sketch, thinned
from tests.view.clients import Client

SIZE = 96, 80


@pytest.fixture(scope="module")
def volume() -> Volume:
    """An off-centre ball, with unequal spacings, rotated; large enough for a preview."""
    z, y, x = np.ogrid[:90, :200, :240]
    ball = ((x - 150) / 60) ** 2 + ((y - 80) / 55) ** 2 + ((z - 50) / 25) ** 2
    turned = ((0.8, -0.6, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0))
    data = (1000 / (1 + np.exp(8 * (ball - 1)))).astype(np.int16)
    return Volume(data, spacing=(1.0, 1.1, 2.4), origin=(-13, 5, 40), direction=turned)


@pytest.fixture
def view(volume: Volume, device: Device) -> Iterator[View]:
    made = View(volume, device=device, mode="isosurface")
    yield made
    made.close()


def test_a_preview_comes_first_and_facts_after_it(client: Client) -> None:
    client.resize(*SIZE)
    still, _ = client.wait(lambda m: m["type"] == "frame" and m["final"])
    frames, states = client.of("frame"), client.of("state")
    assert frames[0]["few"]
    assert not frames[0]["final"]
    said = [message["text"] for message in client.of("status")]
    assert "few samples" in said[0]
    assert said[-1] == ""
    assert not any(frame.get("few") for frame in frames[1:])
    assert "few" not in still
    assert "effective" not in states[0]
    told, _ = client.wait(lambda m: m["type"] == "state" and "effective" in m)
    assert told["state"] == states[0]["state"]
    kinds = [(message["type"], "effective" in message) for message, _ in client.got]
    assert kinds.index(("frame", False)) < kinds.index(("state", True))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("mode", ["isosurface", "composite", "mip"])
def test_a_preview_has_the_placement_and_look_of_the_volume(volume: Volume, device: Device, mode: str) -> None:
    resident = Resident(volume, device=device, mode=mode)
    few = np.asarray(Sketch(resident, resident.catalog.which(resident.initial)).picture(resident.initial, SIZE))[..., :3]
    with clvol.Renderer(volume, device=device) as renderer:
        whole = renderer.render(size=SIZE, **resident.arguments(resident.initial))[..., :3]
    height, width = few.shape[:2]
    down, across = (np.arange(n) * m // n for n, m in ((height, SIZE[1]), (width, SIZE[0])))
    seen = whole[down][:, across]
    lit, expected = few.max(-1) > 0.1, seen.max(-1) > 0.1
    assert 0.05 < expected.mean() < 0.9
    assert (lit & expected).sum() >= 0.9 * (lit | expected).sum()
    assert np.abs(few - seen)[lit & expected].mean() < 0.1


@pytest.fixture
def made_late(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Coefficients are computed once this is set."""
    go, made = threading.Event(), Renderers._made

    def slowly(self: Renderers, key: Any) -> clvol.Renderer:
        assert go.wait(60)
        return made(self, key)

    monkeypatch.setattr(Renderers, "_made", slowly)
    yield go
    go.set()


def next_frame(client: Client, after: dict[str, Any]) -> dict[str, Any]:
    return client.wait(lambda m: m["type"] == "frame" and m["number"] > after["number"])[0]


def test_changes_before_coefficients_are_shown_at_once(client: Client, made_late: threading.Event) -> None:
    client.resize(*SIZE)
    first, _ = client.wait(lambda m: m["type"] == "frame")
    client.set(**{"camera.zoom": 1.5})
    second = next_frame(client, first)
    assert first["few"]
    assert second["few"]
    made_late.set()
    still, _ = client.wait(lambda m: m["type"] == "frame" and m["final"])
    assert still["number"] > second["number"]
    assert client.session.state.camera.zoom == 1.5


def test_facts_do_not_wait_for_coefficients(client: Client, made_late: threading.Event) -> None:
    client.resize(*SIZE)
    client.wait(lambda m: m["type"] == "frame" and m["few"])
    client.wait(lambda m: m["type"] == "state" and "effective" in m)
    client.wait(lambda m: m["type"] == "overlay")
    assert not made_late.is_set()
    assert len(client.of("frame")) == 1  # and the preview is sent once


def test_a_wheel_and_a_pick_do_not_wait_for_coefficients(client: Client, made_late: threading.Event) -> None:
    client.resize(*SIZE)
    first, _ = client.wait(lambda m: m["type"] == "frame")
    client.event("wheel", pane="3d", x=40, y=30, dx=0, dy=-200)
    assert next_frame(client, first)["few"]
    client.session.receive({"type": "do", "what": "pick", "id": 7, "x": 40, "y": 30})
    reply, _ = client.wait(lambda m: m["type"] == "reply")
    assert "before the coefficients are computed" in reply["error"]
    assert not made_late.is_set()


def test_it_rotates_beside_slices_too(client: Client, made_late: threading.Event) -> None:
    client.resize(*SIZE)
    client.set(layout="linked")
    first, _ = client.wait(lambda m: m["type"] == "frame" and m["pane"] == "3d")
    client.event("pointer_down", pane="3d", x=40, y=30, button=1, buttons=[1])
    client.event("pointer_move", pane="3d", x=60, y=35, buttons=[1])
    assert next_frame(client, first)["few"]
    client.event("pointer_up", pane="3d", x=60, y=35, button=1, buttons=[])
    made_late.set()
    for pane in ("3d", "x", "y", "z"):
        client.wait(lambda m, pane=pane: m["type"] == "frame" and m["pane"] == pane and m["final"])  # type: ignore[misc]


def test_coefficients_are_computed_once_and_not_after_closing(view: View, made_late: threading.Event) -> None:
    view.resident.renderers.prepare(None, "mirror")
    unwanted = view.resident.renderers.prepare("bspline5", "mirror")
    last = view.resident.renderers.prepare("linear", "mirror")
    view.close()
    made_late.set()
    for thread in (unwanted, last):
        thread.join(60)
        assert not thread.is_alive()
    assert not [key for key in view.resident.renderers._entries if key[0] == "bspline5"]
    assert not [entry for entry in view.resident.renderers._entries.values() if entry.renderer is not None]


def test_small_volumes_and_slices_have_no_preview(device: Device, view: View) -> None:
    with_few = Client(View(clvol.phantoms.marschner_lobb(24), device=device))
    with_few.resize(*SIZE)
    with_few.wait(lambda m: m["type"] == "frame" and m["final"])
    assert not any(frame.get("few") for frame in with_few.of("frame"))
    with_few.close()
    sliced = Client(view)
    sliced.set(layout="slice", active="z")
    sliced.resize(*SIZE)
    sliced.wait(lambda m: m["type"] == "frame" and m["final"])
    assert not any(frame.get("few") for frame in sliced.of("frame"))
    sliced.close()


def test_a_subsample_keeps_its_placement(volume: Volume) -> None:
    few = thinned(volume)
    assert max(few.size) <= 64
    corner = few.index_to_world((0, 0, 0))
    place = volume.world_to_index(corner)
    np.testing.assert_allclose(place, np.round(place), atol=1e-9)
    np.testing.assert_array_equal(few.data[0, 0, 0], volume.data[tuple(np.round(place).astype(int)[::-1])])
    np.testing.assert_allclose(few.center, volume.center, atol=max(few.spacing) / 2)
    last = np.array(few.size) - 1
    place = volume.world_to_index(few.index_to_world(last))
    np.testing.assert_array_equal(few.data[-1, -1, -1], volume.data[tuple(np.round(place).astype(int)[::-1])])
    one = thinned(Volume(np.ones((1, 1, 300), ">f4")))
    assert one.size == (60, 1, 1)
