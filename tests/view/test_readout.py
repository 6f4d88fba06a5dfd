"""What lies under the pointer: read from the functions that are drawn, told again when either changes, and never in a pile."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.device import Device
from clvol.view import View
from clvol.view.drawing import Drawer
from tests.view.clients import Client

Z, Y, X = np.mgrid[0:16, 0:20, 0:24].astype(np.float32)
RAMP = clvol.Volume(X + 100 * Y, spacing=(1.0, 1.5, 2.0), origin=(-3, 4, 5), units="mm", name="ramp")
PARTS = clvol.Volume(
    (X[::2, ::2, ::2] > 10).astype(np.uint8),
    spacing=(2, 3, 4),
    origin=(-2.5, 4.75, 6),
    units="mm",
    labels={1: "right"},
    name="parts",
)
SIZE = 64, 48


@pytest.fixture(scope="module")
def view(device: Device) -> Iterator[View]:
    made = View(clvol.Scene([RAMP, PARTS]), device=device, filter="bspline3")
    made.state = made.state.changed({"layout": "linked"})
    yield made
    made.close()


def at(client: Client, pane: str, x: float, y: float) -> dict[str, Any]:
    """What is told of a place."""
    client.forget()
    client.session.receive({"type": "hover", "pane": pane, "x": x, "y": y})
    return client.wait(lambda m: m["type"] == "readout" and m["pane"] == pane)[0]


def at_rest(client: Client) -> None:
    for name in ("3d", "x", "y", "z"):
        client.resize(*SIZE, pane=name)
    for name in ("3d", "x", "y", "z"):
        client.still(name)


def test_slices_tell_place_voxel_and_all_values(client: Client, device: Device) -> None:
    at_rest(client)
    found = at(client, "z", 45.5, 20.5)
    pane = client.session._control.context().pane(client.session.state, "z")
    place = pane.point(45.5, 20.5)
    assert found["position"] == pytest.approx(place.tolist())
    assert found["voxel"] == np.floor(RAMP.world_to_index(place) + 0.5).tolist()
    ramp, parts = found["values"]
    assert ramp == {"name": "ramp", "value": pytest.approx(float(clvol.sample(RAMP, place, filter="bspline3", device=device)))}
    assert parts == {"name": "parts", "value": 1.0, "label": "right"}
    assert at(client, "z", 0.5, 0.5) == {"type": "readout", "pane": "z"}


def test_it_follows_the_slice_under_a_resting_pointer_and_the_pointer_that_leaves(client: Client) -> None:
    at_rest(client)
    before = at(client, "x", 32, 24)
    client.forget()
    client.event("wheel", pane="x", x=32, y=24, dy=300)
    after = client.wait(lambda m: m["type"] == "readout")[0]
    assert after["position"][0] == pytest.approx(before["position"][0] + 3)
    assert after["values"][0]["value"] == pytest.approx(before["values"][0]["value"] + 3, abs=1e-3)
    client.forget()
    client.session.receive({"type": "hover"})
    assert client.wait(lambda m: m["type"] == "readout")[0] == {"type": "readout", "pane": None}


@pytest.mark.parametrize("mode", ["isosurface", "mip"])
def test_the_volume_tells_of_the_place_that_is_picked(client: Client, mode: str) -> None:
    client.set(mode=mode, filter="bspline3")
    at_rest(client)
    found = at(client, "3d", 32, 24)
    picked = client.session._control.pick("3d", 32, 24)
    assert found["position"] == picked["position"]
    assert found["values"] == picked["values"]
    assert found["values"][0]["value"] == pytest.approx(picked["value"])


def test_a_thousand_places_are_a_few_answers_and_a_wrong_one_an_error(client: Client) -> None:
    at_rest(client)
    client.forget()
    began = time.monotonic()
    for n in range(1000):
        client.session.receive({"type": "hover", "pane": "z", "x": 20 + n / 100, "y": 24})
    last = client.session._control.context().pane(client.session.state, "z").point(29.99, 24)
    client.wait(lambda m: m["type"] == "readout" and m["position"] == pytest.approx(last.tolist()))
    assert len(client.of("readout")) <= 2 + 10 * (time.monotonic() - began)
    client.session.receive({"type": "hover", "pane": "w", "x": 1, "y": 1})
    assert "pane must be" in client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")[0]["text"]


def test_it_interrupts_no_picture(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """A long picture is drawn once, however often the pointer moves meanwhile."""
    at_rest(client)
    begun, go_on = threading.Event(), threading.Event()
    shots, drawn = Drawer.shots, []

    def slow(self: Drawer, order: Any) -> Any:
        drawn.append(order.name)
        begun.set()
        while not go_on.is_set() and not order.stop():
            time.sleep(0.005)
        yield from shots(self, order)

    monkeypatch.setattr(Drawer, "shots", slow)
    client.set(camera__zoom=1.5)
    assert begun.wait(20)
    for n in range(5):
        client.session.receive({"type": "hover", "pane": "z", "x": 20 + n, "y": 24})
        time.sleep(0.02)
    assert drawn == ["3d"]
    go_on.set()
    client.forget()
    client.still()
    client.wait(lambda m: m["type"] == "readout")
    assert set(drawn) == {"3d"}
