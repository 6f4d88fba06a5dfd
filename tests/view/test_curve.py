"""Values at one place along a series of volumes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.view import State, View
from clvol.view.curve import curve, what_curve
from clvol.volume.volumes import Leading
from tests.view.clients import Client

LEADING = Leading(("time", "channel"), (4, 2), vector=True)


@pytest.fixture(scope="module")
def view(device: Device) -> View:
    data = np.random.default_rng(3).random((4, 2, 20, 21, 52), np.float32)
    return View(clvol.Volumes(data, leading=LEADING, spacing=(1, 2, 3)), device=device)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"index": {"channel": 1}, "filter": "catmull-rom", "boundary": "constant(5)"},
        {"filter": "linear", "crosshair": (0.2, 40, 3)},
        {"filter": "bspline5", "boundary": "reflect", "crosshair": (-0.3, -0.1, 3)},
        {"filter": "bspline3", "boundary": "wrap", "crosshair": (25.0, 0.1, 3)},
    ],
    ids=["magnitude", "inside", "at an edge", "in a corner", "around"],
)
def test_it_is_the_function_of_each_volume(view: View, given: dict[str, Any], device: Device) -> None:
    state = State(**given)
    found = curve(view.resident, state, lambda: False)
    assert found is not None
    row = view.resident.filter_name(state, state.filter)
    for time, value in enumerate(found["values"]):
        volume = view.resident.catalog.volume_of(state.changed({"index.time": time}))
        wanted = clvol.sample(volume, [found["position"]], row, state.boundary, device=device)[0]
        assert value == pytest.approx(wanted, abs=1e-5)


def test_it_stops_and_says_what_it_cannot(view: View) -> None:
    assert curve(view.resident, State(), lambda: True) is None
    with pytest.raises(OptionError, match="outside the volume"):
        curve(view.resident, State(crosshair=(-9.0, 0.0, 0.0)), lambda: False)
    times = [what_curve(view.resident, State(index={"time": time})) for time in (0, 3)]
    assert times[0] == times[1] != what_curve(view.resident, State(index={"channel": 0}))
    assert what_curve(View(clvol.phantoms.sphere(8)).resident, State()) is None


def test_it_is_sent_to_clients_that_want_it(view: View) -> None:
    client = Client(view)
    client.set(crosshair=[1.0, 2.0, 3.0])
    client.session.receive({"type": "do", "what": "curve", "id": 1, "on": True})
    sent, _ = client.wait(lambda m: m["type"] == "curve")
    assert len(sent["values"]) == 4
    client.set(crosshair=[-99.0, 2.0, 3.0])
    client.wait(lambda m: m["type"] == "curve" and "outside" in m.get("problem", ""))
    assert len(client.of("curve")) == 2  # not of the centre, before it was wanted
    client.close()
