"""The line of text for people: the most pressing of what there is to say, each until it no longer holds."""

from __future__ import annotations

from collections.abc import Callable

from clvol.view.protocol import Message, status

__all__ = ["Notices"]

_PRESSING = ("info", "busy", "warning", "error")


class Notices:
    """What each of several sources says; the client gets what it should read, whenever that changes."""

    def __init__(self, send: Callable[[Message], None]) -> None:
        self._send = send
        self._said: dict[str, tuple[str, str]] = {}  # by source, the latest last: text and kind
        self._shown = "", "info"

    def put(self, source: str, text: str = "", kind: str = "info") -> None:
        """Have a source say something in place of what it said before; without text it says nothing more.

        An error is sent even if it is shown already: something was tried again.
        """
        self._said.pop(source, None)
        if text:
            self._said[source] = text, kind
        latest = reversed(self._said.values())  # of equally pressing ones `max` takes the first
        shown = max(latest, key=lambda one: _PRESSING.index(one[1]), default=("", "info"))
        if shown != self._shown or (text and kind == "error"):
            self._shown = shown
            self._send(status(*shown))
