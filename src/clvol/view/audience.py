"""The sessions of a view seen from outside: what the active one shows, what all are told to show, and who hears what happens."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from clvol.view.panes import triple
from clvol.view.state import State, Triple

__all__ = ["Audience", "Pick", "Shows"]

_LOG = logging.getLogger("clvol.view")
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Pick:
    """What lies where somebody clicked twice.

    Parameters
    ----------
    pane : str
        "3d", or the axis across which the slice lies.
    position, index : three numbers
        In the world, and in samples, as (x, y, z).
    value : float
    gradient : three numbers, or None
        None of a function that has none.
    label : str, optional
        The label's name, of a label map.
    units : str, optional
        Of the position.
    """

    pane: str
    position: Triple
    index: Triple
    value: float
    gradient: Triple | None = None
    label: str | None = None
    units: str | None = None

    @classmethod
    def of(cls, found: Mapping[str, Any]) -> Pick:
        """Of what `clvol.view.control.Control.pick` found somewhere."""
        gradient = found.get("gradient")
        return cls(
            found["pane"],
            triple(found["position"]),
            triple(found["index"]),
            found["value"],
            None if gradient is None else triple(gradient),
            found.get("label"),
            found.get("units"),
        )


class Shows(Protocol):
    """A session."""

    @property
    def state(self) -> State: ...
    def show(self, state: State) -> None: ...
    def receive(self, message: Mapping[str, Any]) -> None: ...


class Audience:
    """The sessions of one view; `first` gives what they begin with.

    Events are "join" (of a session), "change" (its state, the one before, and the `number` of views from which the change came by
    links) and "pick" (a `Pick`). Who listens is called in the thread in which it happens.
    """

    def __init__(self, first: Callable[[], State]) -> None:
        self.number, self._first = next(_numbers), first
        self._lock = threading.Lock()
        self._sessions: list[Shows] = []  # the one that was used last is at the end
        self._last: State | None = None
        self._listeners: list[tuple[str, Callable[..., Any]]] = []

    @property
    def state(self) -> State:
        """What is shown in the session that was used last, also when all have ended."""
        with self._lock:
            return self._sessions[-1].state if self._sessions else self._last or self._first()

    def join(self, session: Shows) -> None:
        """Add a session, which is not the active one before it is used."""
        with self._lock:
            self._sessions.insert(0, session)
        self.tell("join", session)

    def leave(self, session: Shows) -> None:
        """Remove one that has ended."""
        with self._lock:
            if session in self._sessions[-1:]:
                self._last = session.state
            if session in self._sessions:
                self._sessions.remove(session)

    def use(self, session: Shows) -> None:
        """Make the session the active one: its client did something."""
        with self._lock:
            if session in self._sessions[:-1]:
                self._sessions.remove(session)
                self._sessions.append(session)

    def show(self, state: State) -> None:
        """Show a state in all sessions; if there is none, those who listen hear of it from here."""
        before = self.state
        for session in self._all():
            session.show(state)
        if not self._sessions:
            self._keep(state, before, frozenset())

    def change(self, message: Mapping[str, Any], via: frozenset[int]) -> None:
        """Pass a change that came from other views to all sessions."""
        for session in self._all():
            session.receive({**message, "via": via})
        if not self._sessions:
            before = self.state
            self._keep(before.changed(message["changes"]), before, via)

    def _all(self) -> list[Shows]:
        with self._lock:
            return list(self._sessions)

    def _keep(self, state: State, before: State, via: frozenset[int]) -> None:
        """What is shown without a session."""
        self._last = state
        if state != before:
            self.tell("change", state, before, via)

    def listen(self, event: str, callback: Callable[..., Any]) -> Callable[[], None]:
        """Have a function called at an event; returns one that ends this."""
        entry = event, callback
        with self._lock:
            self._listeners.append(entry)

        def end() -> None:
            with self._lock:
                self._listeners = [one for one in self._listeners if one is not entry]

        return end

    def tell(self, event: str, *about: Any) -> None:
        """Call those who listen; their errors are logged, for pictures do not depend on them."""
        with self._lock:
            found = [callback for kind, callback in self._listeners if kind == event]
        for callback in found:
            try:
                callback(*about)
            except Exception:
                _LOG.exception("a callback of a view failed at a %s", event)
