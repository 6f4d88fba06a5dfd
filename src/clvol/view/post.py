"""What passes between a session and its client: messages that came, frames that are on their way, and whether either has gone."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from clvol.view.background import Background
from clvol.view.jobs import Jobs
from clvol.view.protocol import Message, Send, ends_drag
from clvol.view.throttle import Inbox, Throttle

__all__ = ["Gone", "Post"]

_PATIENCE = 2.0  # seconds that a finished picture waits for acknowledgements


class Gone(Exception):  # nothing went wrong
    """The client is no longer there, or the session was closed."""


class Pulse:
    """Whether a thread gets on with its work."""

    def __init__(self) -> None:
        self._beat_at: float | None = time.monotonic()  # None while it rests

    def beat(self) -> None:
        """It gets on."""
        self._beat_at = time.monotonic()

    @contextmanager
    def resting(self) -> Iterator[None]:
        """It has nothing to do in the block, and waits."""
        self._beat_at = None
        try:
            yield
        finally:
            self.beat()

    @property
    def pause(self) -> float:
        """Seconds for which it has worked and shown no progress."""
        since = self._beat_at
        return 0.0 if since is None else time.monotonic() - since


class Post:
    """Guarded by its condition, which says that something came."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self.condition = threading.Condition()
        self.inbox, self.throttle, self.background = Inbox(), Throttle(), Background(self.condition)
        self.jobs = Jobs(self.condition)
        self.closed = False
        self.woken = False
        """Whether what is viewed has changed, which no message says."""
        self.hover: Mapping[str, Any] | None = None
        """The last message that says where the pointer is."""
        self.pulse = Pulse()
        """That of the session's thread."""

    def put(self, message: Mapping[str, Any]) -> None:
        """Take a client's message."""
        with self.condition:
            if self.closed:
                return
            kind = message.get("type") if isinstance(message, Mapping) else None
            if kind == "ack":
                self.throttle.acknowledge(message.get("frame"), time.monotonic())
            elif kind == "hover":  # not among the others, which interrupt pictures
                self.hover = message
            else:
                self.inbox.put(message)
            self.condition.notify_all()

    def wake(self) -> None:
        """Have the session look at what is viewed."""
        with self.condition:
            self.woken = True
            self.condition.notify_all()

    def tell(self, message: Message, data: bytes | None = None) -> None:
        """Send a message to the client; `Gone` if it is not there."""
        if self.closed:
            raise Gone
        try:
            self._send(message, data)
        except Exception as error:
            raise Gone from error

    def close(self) -> None:
        """Take and send nothing more."""
        with self.condition:
            self.closed = True
            self.background.close()
            self.jobs.close()
            self.inbox.clear()
            self.condition.notify_all()

    def is_closed(self) -> bool:
        """Whether the session has ended."""
        return self.closed

    def busy(self) -> bool:
        """Whether a message came, what is viewed has changed, or the session ends."""
        return self.closed or self.woken or len(self.inbox) > 0

    def came(self) -> bool:
        """Whether there is anything to take."""
        return self.busy() or self.has_results()

    def has_results(self) -> bool:
        """Whether anything is ready that other threads have made."""
        return len(self.background) + len(self.jobs) > 0

    def drag_ends(self) -> bool:
        """Whether a message came that ends a drag."""
        with self.condition:
            return any(map(ends_drag, self.inbox))

    def room_in(self) -> float:
        """Seconds until the client has room for a frame, if it acknowledges none."""
        with self.condition:
            return self.throttle.room_in(time.monotonic())

    def may_send(self) -> bool:
        """Whether the client has room for a frame; waits for it, until something else comes."""
        with self.condition:
            with self.pulse.resting():
                self.condition.wait_for(lambda: self.busy() or not self.throttle.full, _PATIENCE)
            if self.throttle.full and not self.busy():
                self.throttle.give_up()
            return not self.throttle.full
