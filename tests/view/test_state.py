"""States: their text, invalid values, and undo."""

from __future__ import annotations

import json
import random
import time
from typing import Any

import numpy as np
import pytest

from clvol import Light, TransferFunction
from clvol.base.errors import OptionError
from clvol.view import State, from_url
from clvol.view.code import _input, to_url
from clvol.view.state import History
from tests.view.clients import random_changes


@pytest.mark.parametrize("seed", range(60))
def test_any_state_round_trips_through_its_text(seed: int) -> None:
    chance = random.Random(seed)
    which = {
        "cuts": chance.choice([[], [{"normal": [1, -2, 0.3], "point": [5, 6, 7]}, {"low": [1, None, 3], "high": [None, None, 4]}]]),
        "labels": chance.choice([None, {"hidden": chance.sample(range(-9, 99), 3)}, {"shown": chance.sample(range(99), 2)}]),
        "label_colors": chance.choice([{}, {"7": [0, 0.5, 1], "-3": [1, 1, 1]}]),
        "label_opacities": chance.choice([{}, {"12": 0.25}]),
        "furniture": chance.choice([{}, {"color_bar": True, "title": "µ"}, {"time_stamp": 0.0, "axes": True}]),
        "index": chance.choice([{}, {"time": chance.randrange(9), "channel": chance.choice([1, "luminance"])}]),
    }
    state = State().changed(random_changes(chance) | which)
    assert State.from_text(state.text()) == state
    assert json.loads(json.dumps(state.json())) == state.json()
    assert from_url("http://localhost:8000/" + to_url(state)) == state
    assert hash(State.from_text(state.text())) == hash(state)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"camera.zom": 2}, "camera.zom is no field"),
        ({"nothing": 2}, "'?nothing'? is no field"),
        ({"mode.x": 2}, "no parts"),
        ({"camera.zoom": "2"}, "camera.zoom must be a finite number"),
        ({"camera.zoom": -1}, "camera.zoom"),
        ({"camera.direction": [0, 0, 0]}, "camera.direction must not have zero length"),
        ({"camera.target": [0, 0]}, "camera.target must be three"),
        ({"camera.target": [0, 0, 1e300]}, "camera.target must be three"),
        ({"camera": None}, "camera must be an object"),
        ({"mode": "iso"}, "mode must be one of"),
        ({"mode": "mip", "options.isovalue": 3}, "isovalue is no option of mip"),
        ({"mode": "isosurface", "options.isovalue": "a"}, "isovalue must be a number, or standard deviations"),
        ({"filter": "cubik"}, "filter must be one of"),
        ({"boundary": 3}, "boundary must be a name"),
        ({"step": 0}, "step must be a finite number"),
        ({"step": float("nan")}, "step must be a finite number"),
        ({"transfer.points": [[0, [0, 0, 0], 2]]}, "opacity of transfer.points"),
        ({"transfer.points": [[1, [0, 0, 0], 1], [0, [0, 0, 0], 1]]}, "ascending"),
        ({"transfer.points": []}, "transfer.points must be"),
        ({"transfer.points": [[0, [0, 0, 0], 0]] * 5000}, "transfer.points must be"),
        ({"window": [1, 0]}, "window must be"),
        ({"cmap": "nonsense"}, "colour map"),
        ({"preset": "nonsense"}, "preset"),
        ({"lights": [{"direction": None}] * 5}, "lights must be up to 4"),
        ({"lights": {}}, "lights must be a list"),
        ({"background": [2, 0, 0]}, "background must be three numbers in 0..1"),
        ({"clip": {"low": [0, 0, 0], "high": [1, 0, 1]}}, "clip must be two corners"),
        ({"cuts": {}}, "cuts must be a list of planes and corners"),
        ({"cuts": [{"normal": [0, 0, 0], "point": [1, 2, 3]}]}, "cuts: a plane's normal must have a direction"),
        ({"cuts": [{"normal": [0, 0, 1]}]}, "cuts: a plane's point must be three finite numbers"),
        ({"cuts": [{"low": [0, 0, None], "high": [1, 0, None]}]}, "cuts: a corner must be two corners"),
        ({"cuts": [{"middle": 3}]}, "cuts.middle is no field"),
        ({"cuts": [{"low": [0, 0, 0], "high": [1, 1, 1]}] * 9}, "cuts: clip may have up to 64 planes and 8 corners"),
        ({"labels": 3}, "labels must be an object"),
        ({"furniture.theme": "print"}, "furniture.theme must be left out"),
        ({"furniture.title": "a" * 999}, "furniture.title must have at most 200 characters; got 999"),
        ({"furniture.legend": True}, "furniture.legend is no field"),
        ({"label_colors": {"x": [0, 0, 1]}}, "each of the labels of label_colors must be a whole number"),
        ({"label_colors": {"1": [0, 0, 2]}}, "label_colors.1 must be three numbers in 0..1"),
        ({"label_opacities.1": 2}, "label_opacities.1 must be"),
        ({"labels": {}}, "labels must have one of hidden and shown; got neither"),
        ({"labels": {"hidden": [1], "shown": [2]}}, "hidden and shown; got both"),
        ({"labels": {"hiden": [1]}}, "labels.hiden is no field"),
        ({"labels.hidden": 3}, "labels.hidden must be a list of up to 2048 whole numbers; got 3"),
        ({"labels.hidden": [1, 2.5]}, "each of labels.hidden must be a whole number"),
        ({"labels.shown": [True]}, "each of labels.shown must be a whole number"),
        ({"labels.shown": [1 << 60]}, "each of labels.shown must be a whole number"),
        ({"labels.shown": list(range(1_000_000))}, "labels.shown must be a list of up to 2048 whole numbers; got 1000000 of them"),
        ({"index": 3}, "index must be an object"),
        ({"index": None}, "index must be an object"),
        ({"index.depth": 3}, "index.depth is no field"),
        ({"index.time": -1}, "index.time must be a whole number"),
        ({"index.time": "luminance"}, "index.time must be a whole number"),
        ({"index.channel": "red"}, "index.channel must be one of"),
        ({"wiper.filter": "cubik"}, "filter must be one of"),
        ({"wiper": {"filter": "linear", "at": 2}}, "wiper.at"),
        ({"wiper": {"at": 0.5}}, "wiper"),
        ({"heat": 1}, "heat must be true or false"),
        ({"layout": "4d"}, "layout must be one of"),
        ({"active": None}, "active must be one of"),
        ({"version": 2}, "is no field"),
        *(({name: 1}, f"{name} is no field") for name in ("camera.__class__.x", "index.__dict__.time", "camera..zoom", "a.b")),
        ([], "changes must be an object"),
    ],
    ids=str,
)
def test_errors_name_the_field(changes: Any, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        State().changed(changes)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version":2}', '{"a":1}', "[" * 100000, "nul", '{"version":true}'])
def test_invalid_states_are_rejected(text: str) -> None:
    with pytest.raises(OptionError):
        State.from_text(text)


@pytest.mark.parametrize("text", ["", "#s=", "#s=****", "#s=AAAA", "x" * 400000, "#t=e30"])
def test_invalid_urls_are_rejected(text: str) -> None:
    with pytest.raises(OptionError):
        from_url(text)


def test_options_of_the_old_mode_are_dropped() -> None:
    surface = State().changed({"mode": "isosurface", "options.isovalue": 3})
    assert surface.changed({"options.isovalue": None}).options == {}  # left open again
    state = surface.changed({"mode": "mip"})
    assert state.options == {}
    assert state.changed({"mode": "mip"}) == state


def test_points_are_the_transfer_function() -> None:
    """Different nodes for colours and opacities, and a jump in each."""
    transfer = TransferFunction(
        ((0.0, "black"), (1.0, "red"), (1.0, "blue"), (3.0, "white")), ((0.5, 0.0), (2.0, 0.25), (2.0, 0.75), (4.0, 1.0))
    )
    points = transfer.json()["points"]
    again = State().changed({"transfer": {"points": points}}).transfer
    assert again is not None
    values = np.array([-1, 0, 0.2, 0.5, 0.9, 1, 1.1, 1.9999, 2, 2.5, 3, 3.5, 4, 9])
    assert np.allclose(again(values), transfer(values), rtol=0, atol=1e-15)
    assert again.json()["points"] == points


def test_a_light_keeps_its_direction_to_the_last_bit() -> None:
    chance = random.Random(3)
    for _ in range(300):
        light = Light(tuple(chance.uniform(-1, 1) for _ in range(3)))  # type: ignore[arg-type]  # three
        state = State(lights=(light,))
        assert State.from_text(state.text()) == state


def test_a_gesture_is_one_step_of_undo() -> None:
    first = State()
    history = History(first)
    for zoom in (1.5, 2.0, 2.5):
        history = history.with_state(first.changed({"camera.zoom": zoom}), "drag")
    history = history.ended().with_state(first.changed({"camera.zoom": 3}), "drag").ended()
    assert [len(history.past), history.present.camera.zoom] == [2, 3]
    history = history.undone()
    assert history.present.camera.zoom == 2.5
    assert history.undone().present == first
    assert history.undone().undone().present == first
    assert history.redone().present.camera.zoom == 3
    assert history.redone().redone().present.camera.zoom == 3
    assert history.with_state(first, None).future == ()


def test_undo_keeps_a_bounded_number_of_states() -> None:
    history = History(State())
    for i in range(500):
        history = history.with_state(State().changed({"camera.zoom": 1 + i / 100}))
    assert len(history.past) == History.MOST


def test_points_of_many_labels_are_fast_and_match_the_function() -> None:
    values = np.arange(20_000.0)
    colors = tuple((float(v), (v % 7 / 7, v % 5 / 5, 0.5)) for v in values for _ in range(2))
    opacities = tuple((float(v), v % 3 / 3) for v in values[::2])
    transfer = TransferFunction(colors, opacities)
    began = time.process_time()
    points = transfer.json()["points"]
    assert time.process_time() - began < 2
    assert [point[0] for point in points] == list(values)
    at = np.array([0.0, 1, 2, 777, 19_999])
    told = [[*points[int(v)][1], points[int(v)][2]] for v in at]
    np.testing.assert_allclose(told, transfer(at + 1e-9), atol=1e-6)


@pytest.mark.parametrize(
    ("source", "path", "options"),
    [
        ("clvol.read('a b.nrrd', channel=1, trusted=True)", "a b.nrrd", {"channel": 1, "trusted": True}),
        ("clvol.read('a.raw', spacing=(1.0, 2.0, 3.0)).filled(-1.0)", "a.raw", {"spacing": (1.0, 2.0, 3.0), "fill_nan": -1.0}),
        ("clvol.read('a.nii').filled()", "a.nii", {"fill_nan": "smoothly"}),
        ("clvol.phantoms.by_name('sphere:9')", "phantom:sphere:9", {}),
        ("my.volume(3)", "INPUT", {}),
        ("clvol.read({[]: 1})", "INPUT", {}),
        ("clvol.read(path)", "INPUT", {}),
        ("volume", "INPUT", {}),
        ("a b", "INPUT", {}),
        (None, "INPUT", {}),
    ],
)
def test_a_copied_command_reads_the_file_with_the_same_options(source: str | None, path: str, options: dict[str, Any]) -> None:
    assert _input(source) == (path, options)
