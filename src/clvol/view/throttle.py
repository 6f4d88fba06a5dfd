"""Backpressure in both directions: what a client may send ahead, and how much a session sends to it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

from clvol.view.protocol import replaces

__all__ = ["Inbox", "Throttle"]

_MOST_WAITING = 4096  # messages
_UNACKNOWLEDGED = 2  # frames at most
_LOST = 2.0  # seconds after which an acknowledgement is no longer expected
_SLOW, _FAST = 0.15, 0.05  # seconds of a round trip
_LOWEST_QUALITY, _QUALITY, _HIGHEST_QUALITY = 60, 85, 90  # of JPEG
_FPS_OVER = 2.0  # seconds


class Inbox:
    """Messages that were received and not yet handled: bounded, and only the latest of consecutive pointer moves or resizes.

    It has no lock: the session guards it.
    """

    def __init__(self) -> None:
        self._messages: deque[Mapping[str, Any]] = deque()
        self._overflowed = False

    def put(self, message: Mapping[str, Any]) -> None:
        """Append a message, or drop it if too many wait."""
        if len(self._messages) >= _MOST_WAITING:
            self._overflowed = True
            return
        if self._messages and replaces(message, self._messages[-1]):
            self._messages.pop()
        self._messages.append(message)

    def take_all(self) -> tuple[list[Mapping[str, Any]], str | None]:
        """All messages, and a warning if some were dropped."""
        taken, overflowed = list(self._messages), self._overflowed
        self.clear()
        return taken, f"more than {_MOST_WAITING} messages waited; some were dropped" if overflowed else None

    def clear(self) -> None:
        """Forget all messages."""
        self._messages.clear()
        self._overflowed = False

    def __len__(self) -> int:
        return len(self._messages)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self._messages)


class Throttle:
    """Counts frames that are not acknowledged, and adapts quality and size to the round trip.

    Times are given in seconds of one clock, so that it can be tested without waiting.
    """

    def __init__(self) -> None:
        self.quality = _QUALITY
        """Of JPEG."""
        self.scale = 1.0
        """Of the number of pixels while something moves."""
        self.latency = 0.0
        """Seconds of a round trip, smoothed."""
        self._number = 0
        self._sent: dict[int, float] = {}
        self._times: deque[float] = deque(maxlen=16)

    @property
    def full(self) -> bool:
        """Whether the client must acknowledge a frame before the next is sent."""
        return len(self._sent) >= _UNACKNOWLEDGED

    def room_in(self, now: float) -> float:
        """Seconds until there is room for a frame, if nothing is acknowledged; 0 if there is."""
        for number in [n for n, sent in self._sent.items() if now - sent > _LOST]:
            del self._sent[number]
        return max(0.001, _LOST - (now - min(self._sent.values()))) if self.full else 0.0

    def give_up(self) -> None:
        """No longer expect any acknowledgement."""
        self._sent.clear()

    def send(self, now: float) -> int:
        """Count a frame as sent; returns its number."""
        self._number += 1
        self._sent[self._number] = now
        self._times.append(now)
        return self._number

    def acknowledge(self, frame: object, now: float) -> None:
        """A client has shown a frame; other numbers are ignored."""
        sent = self._sent.pop(frame, None) if isinstance(frame, int) and not isinstance(frame, bool) else None
        if sent is None:
            return
        took = now - sent
        self.latency = 0.7 * self.latency + 0.3 * took if self.latency else took
        if self.latency > _SLOW:
            self.quality, self.scale = max(_LOWEST_QUALITY, self.quality - 5), max(0.1, 0.85 * self.scale)
        elif self.latency < _FAST:
            self.quality, self.scale = min(_HIGHEST_QUALITY, self.quality + 1), min(1.0, 1.05 * self.scale)

    def fps(self, now: float) -> float:
        """Frames per second that were sent of late."""
        recent = [at for at in self._times if now - at < _FPS_OVER]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0
