"""Measures: exact for what is known, drawn with the pointer, copied and written as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.view import Mark, State, View, measured
from clvol.view.events import Context, Inputs, reduce
from clvol.view.panes import SlicePane
from clvol.view.resident import Resident
from tests.view.clients import Client, decoded

Z, Y, X = np.mgrid[0:12, 0:16, 0:20].astype(np.float32)
RAMP = clvol.Volume(X + 10 * Y, spacing=(1.0, 1.0, 2.0), units="mm", name="ramp")
SQUARE = ((4.0, 4.0, 6.0), (8.0, 4.0, 6.0), (4.0, 8.0, 6.0))


def test_known_sizes_and_values() -> None:
    """Of a function that is linear, whose mean over a symmetric region is its value in the middle."""
    assert measured(Mark("distance", ((0, 0, 0), (3, 0, 4))), RAMP)["length"] == 5
    assert measured(Mark("angle", ((4, 0, 0), (0, 0, 0), (0, 3, 0))), RAMP)["angle"] == pytest.approx(90)
    assert measured(Mark("angle", ((4, 0, 0), (0, 0, 0))), RAMP) == {"kind": "angle"}
    found = measured(Mark("rectangle", SQUARE), RAMP, filter="linear")
    assert (found["area"], found["count"]) == (16, 16)
    values = 4.5 + np.arange(4) + 10 * (4.5 + np.arange(4))[:, None]
    for name in ("mean", "std", "min", "max"):
        assert found[name.replace("std", "sd")] == pytest.approx(getattr(values, name)(), rel=1e-6)
    round_ = measured(Mark("ellipse", SQUARE), RAMP, filter="linear")
    assert round_["area"] == pytest.approx(4 * math.pi)
    assert (round_["count"], round_["mean"]) == (12, pytest.approx(66, rel=1e-6))
    triangle = measured(Mark("area", ((2, 2, 6), (14, 2, 6), (2, 10, 6))), RAMP, filter="linear")
    assert triangle["area"] == pytest.approx(48)
    assert 44 < triangle["count"] < 66  # values are at most as far apart as samples
    assert triangle["mean"] == pytest.approx(6 + 10 * (2 + 8 / 3), abs=2)  # a fifth of a voxel
    outside = measured(Mark("rectangle", ((-9, -9, 6), (-5, -9, 6), (-9, -5, 6))), RAMP)
    assert outside == {"kind": "rectangle", "area": 16.0, "count": 0}


@pytest.mark.parametrize(
    ("kind", "points", "says"),
    [
        ("distance", SQUARE, "points of distance must be 2 to 2; got 3"),
        ("area", ((0, 0, 0),) * 65, "points of area must be 1 to 64; got 65"),
        ("volume", SQUARE, "kind must be one of"),
        ("distance", ((0, 0), (1, 1)), "must be three finite numbers"),
    ],
)
def test_other_marks_are_refused(kind: str, points: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        Mark(kind, points)
    with pytest.raises(OptionError, match=says):
        State().changed({"marks": [{"kind": kind, "points": points}]})


def test_a_mark_without_points_is_refused() -> None:
    with pytest.raises(OptionError, match="marks must each have kind and points"):
        State().changed({"marks": [{"kind": "distance"}]})


class Hand:
    """Draws on a slice."""

    def __init__(self, tool: str) -> None:
        resident = Resident(RAMP)
        self.context = Context(volume=RAMP, placed=resident.placed, sizes={}, isovalue=lambda _: 0.0, window=lambda *_: (0.0, 1.0))
        self.state, self.inputs = State(layout="slice", active="z", tool=tool), Inputs()

    def send(self, kind: str, x: float, y: float, **more: Any) -> None:
        event = {"event_type": kind, "pane": "z", "x": x, "y": y, "button": 1, **more}
        made = reduce(self.state, self.inputs, event, self.context)
        self.state, self.inputs = made.state, made.inputs

    def drag(self, *places: tuple[float, float]) -> None:
        self.send("pointer_down", *places[0])
        for x, y in places[1:]:
            self.send("pointer_move", x, y, buttons=[1])
        self.send("pointer_up", *places[-1])

    def at(self, x: float, y: float) -> Any:
        pane = self.context.pane(self.state, "z")
        assert isinstance(pane, SlicePane)
        return pytest.approx(tuple(pane.point(x, y)))


def test_drags_draw_and_how_many_events_there_were_does_not_matter() -> None:
    for tool in ("distance", "rectangle", "ellipse"):
        one, other = Hand(tool), Hand(tool)
        one.drag((100, 120), (300, 200))
        other.drag((100, 120), (110, 400), (20, 30), (300, 200))
        assert one.state == other.state
        (mark,) = one.state.marks
        assert mark.points[0] == one.at(100, 120)
        ends = [(300, 200)] if tool == "distance" else [(300, 120), (100, 200)]
        assert list(mark.points[1:]) == [one.at(*end) for end in ends]
        one.drag((100, 120))  # a click draws nothing
        assert len(one.state.marks) == 1


def test_angles_and_areas_take_point_after_point() -> None:
    hand = Hand("angle")
    hand.drag((100, 100), (200, 100))
    hand.drag((200, 300))
    assert [mark.points for mark in hand.state.marks] == [(hand.at(100, 100), hand.at(200, 100), hand.at(200, 300))]
    hand.drag((50, 50))  # another one
    assert len(hand.state.marks) == 2
    hand = Hand("area")
    for place in ((100, 100), (200, 100), (200, 200), (100, 200)):
        hand.drag(place)
    hand.drag((103, 98))  # closes it
    assert (len(hand.state.marks), len(hand.state.marks[0].points)) == (1, 4)
    hand.drag((300, 300), (320, 300))
    hand.drag((320, 320))
    hand.drag((320, 320))  # the second click of two
    hand.send("double_click", 320, 320)
    assert [len(mark.points) for mark in hand.state.marks] == [4, 3]
    hand.drag((400, 400))
    hand.state = replace(hand.state, crosshair=(5.0, 5.0, 4.0))  # another slice: a polygon is in one plane
    hand.drag((410, 400))
    assert [len(mark.points) for mark in hand.state.marks] == [4, 3, 1, 1]


@pytest.fixture
def client(device: Device) -> Iterator[Client]:
    view = View(RAMP, device=device, filter="linear")
    view.state = view.state.changed({"layout": "slice", "active": "z", "tool": "rectangle", "crosshair": [9.5, 7.5, 6.0]})
    made = Client(view)
    made.resize(120, 90, pane="z")
    made.still("z")
    yield made
    made.close()
    view.close()


def test_a_session_tells_copies_and_writes_what_is_drawn(client: Client) -> None:
    for kind, x, y in (("pointer_down", 40, 30), ("pointer_move", 70, 55), ("pointer_up", 70, 55)):
        client.event(kind, pane="z", x=x, y=y, button=1)
    told = client.wait(lambda m: m["type"] == "measures" and m["rows"])[0]
    (row,) = told["rows"]
    assert told["units"] == "mm"
    overlay = client.wait(lambda m: m["type"] == "overlay" and m["marks"])[0]
    assert overlay["marks"][0]["points"] == [pytest.approx(p) for p in ((40, 30), (70, 30), (40, 55))]
    held: dict[str, Any] = {"clvol": clvol, "volume": RAMP}
    exec(client.session.python(), held)
    assert held["measures"] == [row]
    client.session.receive({"type": "do", "what": "measures_csv", "id": 3})
    (line,) = csv.DictReader(io.StringIO(client.wait(lambda m: m["type"] == "reply" and m["id"] == 3)[0]["text"]))
    assert (line["kind"], line["units"], line["length"]) == ("rectangle", "mm", "")
    assert float(line["mean"]) == pytest.approx(row["mean"], rel=1e-8)
    frames = len(client.of("frame"))
    client.set(crosshair=[9.5, 7.5, 10.0])
    client.wait(lambda m: m["type"] == "overlay" and not m["marks"])
    client.session.receive({"type": "do", "what": "undo", "id": 4})
    client.session.receive({"type": "do", "what": "undo", "id": 5})
    assert client.wait(lambda m: m["type"] == "measures" and not m["rows"])
    assert len(client.of("frame")) <= frames + 4  # marks are drawn over pictures, which they do not change


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="needs matplotlib")
def test_a_saved_picture_has_them_where_they_are(client: Client) -> None:
    client.set(marks=[{"kind": "rectangle", "points": [[5.0, 5.0, 6.0], [12.0, 5.0, 6.0], [5.0, 10.0, 6.0]]}])
    client.wait(lambda m: m["type"] == "overlay" and m["marks"])
    saved = []
    for number, measures in enumerate((False, True)):
        client.session.receive(
            {"type": "do", "what": "save_picture", "width": 480, "height": 360, "measures": measures, "id": number}
        )
        _, data = client.wait(lambda m, number=number: m["type"] == "reply" and m["id"] == number)
        saved.append(decoded(data).astype(int))
    plain, marked = saved
    assert plain.shape == marked.shape
    differs = np.abs(plain - marked).max(-1) > 0
    overlay = client.of("overlay")[-1]
    left, top = (4 * v for v in overlay["marks"][0]["points"][0])
    right, bottom = 4 * overlay["marks"][0]["points"][1][0], 4 * overlay["marks"][0]["points"][2][1]
    for x, y in (((left + right) / 2, top), ((left + right) / 2, bottom), (left, (top + bottom) / 2), (right, (top + bottom) / 2)):
        assert differs[round(y) - 2 : round(y) + 2, round(x) - 2 : round(x) + 2].any()
    assert not differs[round(top) + 8 : round(bottom) - 8, round(left) + 8 : round(right) - 8].any()
    assert differs.mean() < 0.05
