"""What waits for a client of the server: bounded, whatever the client and the event loop do; and how fast it may send."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from clvol.base.checks import number, whole
from clvol.base.errors import ClvolError
from clvol.view.protocol import Message

__all__ = ["Limits", "Outbox", "Rate"]

_NEWEST_WINS = ("curve", "frame", "info", "job", "overlay", "state", "stats", "status")  # a slow client gets only the last ...
_ABOUT = "type", "pane", "id"  # ... of those with the same of these


@dataclass(frozen=True)
class Limits:
    """What one client, and all of them together, may cost.

    Parameters
    ----------
    clients : int
        Pages that may be open at once.
    message : int
        Bytes of the longest message from a client.
    rate, burst : float
        Messages per second that are read from one client, and how many at once; more wait in its connection.
    flood : float
        Seconds for which it may send more than that before it is disconnected.
    upload : int
        Bytes of the longest file that a page may send.
    waiting : int
        Bytes that may wait for one client, pictures that it asked for included.
    messages : int
        Messages that may wait for one client.
    idle : float
        Seconds without a message from a client after which it is disconnected; without clients the device is freed then.
    stuck : float
        Seconds within which a client must receive a message.
    """

    clients: int = 8
    message: int = 64 << 10
    rate: float = 500.0
    burst: float = 1000.0
    flood: float = 10.0
    upload: int = 1 << 30
    waiting: int = 64 << 20
    messages: int = 256
    idle: float = 1800.0
    stuck: float = 30.0

    def __post_init__(self) -> None:
        for name in ("clients", "message", "upload", "waiting", "messages"):
            whole(name, getattr(self, name), minimum=1)
        for name in ("rate", "burst", "flood", "idle", "stuck"):
            number(name, getattr(self, name), above=0)


class Outbox:
    """Messages on their way to one client, from any thread.

    Bytes that take more than half of what may wait are not sent: `keep` takes them, and returns the name by which they are fetched.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, limits: Limits, keep: Callable[[bytes], str]) -> None:
        self._loop, self._limits, self._keep = loop, limits, keep
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Message, bytes | None]] = deque()
        self._bytes = 0
        self._woken = False
        self._filled = asyncio.Event()
        self.closed = False
        self.overflowed = False
        self._dropped: list[int] = []  # numbers of frames

    def put(self, message: Message, data: bytes | None = None) -> None:
        """Append a message; of two of a kind that show the same the older is dropped."""
        kind = message.get("type")
        if data is not None and kind not in _NEWEST_WINS and len(data) > self._limits.waiting // 2 and not self.closed:
            try:
                message, data = {**message, "download": self._keep(data)}, None
            except (ClvolError, OSError) as error:
                message, data = {**message, "error": f"the file cannot be sent: {error}"}, None
        with self._lock:
            if self.closed:
                return
            if kind in _NEWEST_WINS:
                self._drop(lambda other: all(other.get(word) == message.get(word) for word in _ABOUT))
            self._waiting.append((message, data))
            self._bytes += _size(message, data)
            if self._full():
                self._drop(lambda other: other.get("type") == "frame")
            self.overflowed |= self._full()  # with what must not be dropped
            wake = not self._woken
            self._woken = True
        if wake:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._filled.set)

    def _full(self) -> bool:
        return self._bytes > self._limits.waiting or len(self._waiting) > self._limits.messages

    def _drop(self, unwanted: Callable[[Message], bool]) -> None:
        kept = deque[tuple[Message, bytes | None]]()
        for message, data in self._waiting:
            if not unwanted(message):
                kept.append((message, data))
                continue
            self._bytes -= _size(message, data)
            if message.get("type") == "frame" and "number" in message:
                self._dropped.append(message["number"])
        self._waiting = kept

    async def take(self) -> tuple[Message, bytes | None] | None:
        """The next message; None once the outbox is closed or has overflowed."""
        while True:
            with self._lock:
                if self.closed or self.overflowed:
                    return None
                if self._waiting:
                    message, data = self._waiting.popleft()
                    self._bytes -= _size(message, data)
                    return message, data
                self._woken = False
                self._filled.clear()
            await self._filled.wait()

    def take_dropped(self) -> list[int]:
        """Numbers of frames that the client will never see, since the last call."""
        with self._lock:
            dropped, self._dropped = self._dropped, []
        return dropped

    def close(self) -> None:
        """Drop all messages and take no more."""
        with self._lock:
            self.closed = True
            self._waiting.clear()
            self._bytes = 0
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._filled.set)


def _size(message: Message, data: bytes | None) -> int:
    return 256 + (len(data) if data is not None else 0) + (0 if message.get("type") == "frame" else 8 * len(message))


class Rate:
    """A token bucket."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._tokens, self._last = burst, time.monotonic()

    def take(self) -> float:
        """Spend a token; returns how many seconds to wait for it."""
        now = time.monotonic()
        self._tokens = min(self._burst, self._tokens + (now - self._last) * self._rate) - 1
        self._last = now
        return max(0.0, -self._tokens / self._rate)

    @property
    def calm(self) -> bool:
        """Whether half of the tokens are back: a sleep that was a little too long does not count."""
        return 2 * self._tokens > self._burst
