"""The choice of the next job: without threads, clock or device."""

from __future__ import annotations

from typing import Any

import pytest

from clvol.view.schedule import Draw, FindFacts, Read, Shown, Wait, next_job

LINKED = {"3d": "a", "x": "b", "y": "c"}
DONE = {name: Shown(key, True) for name, key in LINKED.items()}


@pytest.mark.parametrize(
    ("given", "job"),
    [
        ({"shown": DONE}, Wait(None)),
        ({"shown": {}}, Draw("3d", True)),
        ({"wanted": {}, "shown": {}}, Wait(None)),
        ({"shown": DONE | {"y": Shown("old", True)}}, Draw("y", True)),
        ({"shown": DONE | {"3d": Shown("a", False)}}, Draw("3d", False)),
        ({"shown": DONE | {"3d": Shown("a", False), "y": Shown("old", True)}}, Draw("y", True)),  # first pictures come first
        ({"shown": DONE | {"3d": Shown("a", False)}, "rest_in": 0.1}, Wait(0.1)),
        ({"shown": DONE | {"3d": Shown("old", True)}, "rest_in": 0.1}, Draw("3d", True)),
        ({"shown": {}, "room_in": 1.5}, Wait(1.5)),
        ({"shown": DONE, "room_in": 1.5}, Wait(None)),
        ({"shown": DONE, "facts_in": 0.3}, Wait(0.3)),
        ({"shown": DONE, "facts_in": -0.1}, FindFacts()),
        ({"shown": {}, "facts_in": -0.1}, Draw("3d", True)),
        ({"wanted": {}, "shown": {}, "facts_in": 0.0}, FindFacts()),
        ({"shown": {}, "sketching": True}, Draw("3d", True)),
        ({"shown": {"3d": Shown("a", True)}, "sketching": True}, Wait(None)),  # slices wait for the coefficients
        ({"wanted": {"x": "b"}, "shown": {}, "sketching": True}, Draw("x", True)),
        ({"shown": DONE, "read_in": 0.0}, Read()),
        ({"shown": DONE, "read_in": 0.1, "facts_in": 0.3}, Wait(0.1)),
        ({"shown": {}, "read_in": 0.0}, Draw("3d", True)),
        ({"shown": {}, "read_in": 0.0, "room_in": 0.5}, Read()),
        ({"shown": DONE | {"3d": Shown("a", False)}, "rest_in": 0.1, "read_in": 0.05}, Wait(0.05)),
    ],
)
def test_the_next_job(given: dict[str, Any], job: object) -> None:
    found = next_job(**({"wanted": LINKED} | given))
    assert (type(found), found) == (type(job), job)


def test_the_pane_in_focus_comes_first() -> None:
    assert next_job({"y": "c", "3d": "a"}, {}) == Draw("y", True)
