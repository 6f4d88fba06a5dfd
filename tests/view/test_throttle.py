"""Backpressure: bounded queues, at most two frames in flight, and quality that follows the round trip."""

from __future__ import annotations

from typing import Any

import pytest

from clvol.view.throttle import Inbox, Throttle


def event(kind: str, **more: Any) -> dict[str, Any]:
    return {"type": "event", "event": {"event_type": kind, **more}}


def test_only_the_last_of_consecutive_moves_is_kept() -> None:
    inbox = Inbox()
    for x in range(5):
        inbox.put(event("pointer_move", x=x))
    inbox.put(event("pointer_move", x=9, pane="z"))
    inbox.put(event("pointer_up"))
    inbox.put(event("pointer_up"))
    assert [message["event"].get("x") for message in inbox] == [4, 9, None, None]


def test_an_inbox_is_bounded_and_warns_once() -> None:
    inbox = Inbox()
    for _ in range(5000):
        inbox.put({"type": "set"})
    messages, warning = inbox.take_all()
    assert len(messages) == 4096
    assert warning is not None
    assert "some were dropped" in warning
    assert inbox.take_all() == ([], None)


def test_two_frames_are_in_flight_until_acknowledged_or_lost() -> None:
    throttle = Throttle()
    assert throttle.room_in(0.0) == 0
    assert [throttle.send(0.0), throttle.send(0.5)] == [1, 2]
    assert throttle.full
    assert throttle.room_in(0.5) == pytest.approx(1.5)
    for wrong in (True, "1", 7, None):
        throttle.acknowledge(wrong, 0.6)
    assert throttle.full
    assert throttle.room_in(2.1) == 0  # the first is lost
    throttle.send(2.2)
    throttle.acknowledge(2, 2.3)
    assert not throttle.full


def test_quality_and_size_follow_the_round_trip() -> None:
    throttle = Throttle()
    for i in range(30):
        throttle.acknowledge(throttle.send(i), i + 1.0)
    assert throttle.latency == pytest.approx(1.0)
    assert (throttle.quality, throttle.scale) == (60, 0.1)
    for i in range(30, 130):
        throttle.acknowledge(throttle.send(i), i + 0.01)
    assert (throttle.quality, throttle.scale) == (90, 1.0)


def test_frames_per_second_use_the_last_two() -> None:
    throttle = Throttle()
    assert throttle.fps(0.0) == 0
    for i in range(10):
        throttle.send(i / 4)
    assert throttle.fps(2.25) == pytest.approx(4.0)
    assert throttle.fps(60.0) == 0
