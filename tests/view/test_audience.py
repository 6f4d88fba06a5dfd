"""A view from a program: the state that is shown, callbacks, and linked views."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.view import Pick, State, View, link, throttle
from tests.view.clients import Client

SIZE = 24


class Opened:
    """Views that share a volume, and their clients."""

    def __init__(self) -> None:
        self._clients: list[Client] = []

    def view(self, **options: Any) -> View:
        return View(clvol.phantoms.sphere(12), mode="mip", **options)

    def client(self, view: View) -> Client:
        made = Client(view)
        made.resize(SIZE, SIZE)
        self._clients.append(made)
        return made

    def close(self) -> None:
        for one in self._clients:
            one.close()


@pytest.fixture
def opened() -> Iterator[Opened]:
    made = Opened()
    yield made
    made.close()


class Heard(list[Any]):
    """What a callback was called with."""

    def __init__(self) -> None:
        super().__init__()
        self._came = threading.Condition()

    def __call__(self, one: Any) -> None:
        with self._came:
            self.append(one)
            self._came.notify_all()

    def wait(self, wanted: Callable[[Any], bool]) -> Any:
        with self._came:
            assert self._came.wait_for(lambda: any(map(wanted, self)), 20), self
            return next(filter(wanted, self))


def drag(client: Client, steps: int) -> None:
    client.event("pointer_down", x=10, y=10, button=1)
    for n in range(1, steps + 1):
        client.event("pointer_move", x=10 + 2 * n, y=10, button=1)
        time.sleep(0.01)  # so that each is handled by itself
    client.event("pointer_up", x=10 + 2 * steps, y=10, button=1)


def test_the_state_is_that_of_the_session_that_was_used_last(opened: Opened) -> None:
    view = opened.view()
    first, second = opened.client(view), opened.client(view)
    heard = Heard()
    view.on_change(heard)
    first.set(mode="mean")
    heard.wait(lambda state: state.mode == "mean")
    assert view.state.mode == "mean"
    second.set(step=0.7)
    heard.wait(lambda state: state.step == 0.7)
    assert (view.state.mode, view.state.step) == ("mip", 0.7)
    second.close()
    assert view.state.mode == "mean"
    first.close()
    assert view.state.mode == "mean"  # also when all have ended
    assert opened.client(view).session.state.mode == "mip"  # new ones show what was given


def test_an_assigned_state_is_shown_at_once_and_can_be_undone(opened: Opened) -> None:
    view = opened.view()
    clients = [opened.client(view), opened.client(view)]
    wanted = view.state.changed({"mode": "minip", "camera.zoom": 2.0})
    view.state = wanted
    assert view.state == wanted
    for client in (*clients, opened.client(view)):
        client.wait(lambda m: m["type"] == "state" and m["state"]["mode"] == "minip")
        assert client.session.state == wanted
    clients[0].forget()
    clients[0].session.receive({"type": "do", "what": "undo", "id": 1})
    clients[0].wait(lambda m: m["type"] == "state" and m["state"]["mode"] == "mip")
    with pytest.raises(OptionError, match="index must be left out"):
        view.state = State(index={"time": 1})
    assert view.state.mode == "mip"


def test_an_assigned_state_is_shown_also_if_too_many_messages_wait(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    view = opened.view()
    client = opened.client(view)
    client.still()
    monkeypatch.setattr(throttle, "_MOST_WAITING", 2)
    busy, enough = threading.Event(), threading.Event()
    end = view.on_change(lambda _: (busy.set(), enough.wait(20)))
    client.set(step=0.7)
    assert busy.wait(20)
    for zoom in (1.1, 1.2):
        client.set(camera__zoom=zoom)
    wanted = view.state.changed({"mode": "minip"})
    view.state = wanted
    end()
    time.sleep(0.1)
    assert 0.1 <= client.session.working < 20  # it does not get on
    enough.set()
    client.wait(lambda m: m["type"] == "state" and m["state"]["mode"] == "minip")
    client.set(step=0.9)
    client.wait(lambda m: m["type"] == "state" and m["state"]["step"] == 0.9)
    assert view.state == wanted.changed({"step": 0.9})
    client.still()
    assert client.session.working < 0.1


def test_a_double_click_calls_back_with_position_and_value(opened: Opened) -> None:
    view = opened.view()
    heard = Heard()
    end = view.on_pick(heard)
    client = opened.client(view)
    client.still()
    click = {"x": SIZE / 2, "y": SIZE / 2, "button": 1}
    client.event("double_click", **click)
    pick = heard.wait(lambda pick: pick is not None)
    assert isinstance(pick, Pick)
    assert pick.pane == "3d"
    assert pick.value == pytest.approx(view.volume.data.max(), rel=0.1)
    np.testing.assert_allclose(view.volume.world_to_index(pick.position), pick.index, atol=1e-9)
    assert np.linalg.norm(np.subtract(pick.position, view.volume.center)) < view.volume.radius
    end()
    client.forget()
    client.event("double_click", **click)
    client.wait(lambda m: m["type"] == "reply")
    assert len(heard) == 1


def test_errors_of_a_callback_are_logged_and_end_nothing(opened: Opened, caplog: pytest.LogCaptureFixture) -> None:
    def broken(_: State) -> None:
        raise ZeroDivisionError("of the program")

    view = opened.view()
    view.on_change(broken)
    heard = Heard()
    view.on_change(heard)
    client = opened.client(view)
    with caplog.at_level(logging.ERROR, "clvol.view"):
        client.set(mode="mean")
        heard.wait(lambda state: state.mode == "mean")
    assert "a callback of a view failed at a change" in caplog.text
    assert "ZeroDivisionError: of the program" in caplog.text
    client.still()
    assert not [m for m in client.of("status") if m["kind"] == "error"]


def test_linked_views_turn_together(opened: Opened) -> None:
    """In a ring of three, while one is dragged, which is one step of undo elsewhere."""
    views = [opened.view() for _ in range(3)]
    links = [link(views[i], views[j], what=("camera", "crosshair")) for i, j in ((0, 1), (1, 2), (2, 0))]
    clients = [opened.client(view) for view in views]
    for client in clients:
        client.still()
    changes = [Heard() for _ in views]
    for view, heard in zip(views, changes, strict=True):
        view.on_change(heard)
    clients[0].set(mode="minip")
    drag(clients[0], 12)
    clients[0].wait(
        lambda m: m["type"] == "state" and m["state"]["camera"]["direction"] != list(views[0].resident.initial.camera.direction)
    )
    wanted = views[0].state.camera
    for heard in changes[1:]:
        heard.wait(lambda state: state.camera == wanted)
    for client in clients:
        client.still()
    until = time.monotonic() + 20  # what comes the longer way round the ring comes later
    while [view.state.camera for view in views] != [wanted] * 3 and time.monotonic() < until:
        time.sleep(0.02)
    assert [view.state.camera for view in views] == [wanted] * 3
    assert [view.state.mode for view in views] == ["minip", "mip", "mip"]
    clients[1].session.receive({"type": "do", "what": "undo", "id": 1})
    changes[0].wait(lambda state: state.camera == views[0].resident.initial.camera)  # one step, and it is linked, too
    for end in links:
        end()
    clients[0].set(camera__zoom=3.0)
    changes[0].wait(lambda state: state.camera.zoom == 3.0)
    assert [view.state.camera.zoom for view in views[1:]] == [1.0, 1.0]


class Recorded:
    """A session that does nothing."""

    def __init__(self, view: View) -> None:
        self.state, self.got = view.state, list[frozenset[int]]()
        view.resident.audience.join(self)

    def show(self, state: State) -> None: ...

    def receive(self, message: Mapping[str, Any]) -> None:
        self.got.append(message["via"])


def test_a_change_never_comes_back_to_a_view_that_it_passed(opened: Opened) -> None:
    """Late, it would turn back what is dragged there."""
    views = [opened.view() for _ in range(3)]
    sessions = [Recorded(view) for view in views]
    for one, other in ((0, 1), (1, 2), (2, 0)):
        link(views[one], views[other], what=("camera", "crosshair"))
    a, b, c = (view.resident.audience for view in views)
    before = views[0].state
    after = replace(before, crosshair=(1.0, 2.0, 3.0))
    a.tell("change", after, before, frozenset())
    b.tell("change", after, before, frozenset({a.number}))
    c.tell("change", after, before, frozenset({a.number, b.number}))
    a.tell("change", replace(before, mode="mean"), before, frozenset())  # which is not linked
    assert [session.got for session in sessions] == [[], [{a.number}], [{a.number}, {a.number, b.number}]]


def test_views_are_linked_before_and_after_they_are_shown(opened: Opened) -> None:
    first, second = opened.view(), opened.view()
    first.state = replace(first.state, crosshair=(1.0, 2.0, 3.0))
    link(first, second, what="crosshair")
    assert second.state.crosshair == (1.0, 2.0, 3.0)
    opened.client(first).set(crosshair=[4.0, 5.0, 6.0])
    late = opened.client(second)
    late.wait(lambda m: m["type"] == "state" and m["state"]["crosshair"] == [4.0, 5.0, 6.0])
    for wrong in ((first,), (first, first)):
        with pytest.raises(OptionError, match="two or more"):
            link(*wrong)
    with pytest.raises(OptionError, match="what must be one of"):
        link(first, second, what="position")


def test_a_link_that_one_view_refuses_changes_none(opened: Opened) -> None:
    parts = clvol.Volume((np.indices((8, 8, 8))[2] > 3).astype(np.uint8), labels={1: "right"})
    first, second, third = View(parts), View(parts), opened.view()
    first.state = first.state.changed({"slice.contour": 2})
    with pytest.raises(OptionError, match=r"slice\.contour must be 0"):
        link(first, second, third, what="slice")
    assert (second.state.slice.contour, third.state.slice.contour) == (0, 0)
