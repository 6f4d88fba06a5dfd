"""Views that share a part of what they show: turn one, and the others turn."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from clvol.base.checks import one_of
from clvol.base.errors import OptionError
from clvol.view.state import State
from clvol.view.watched import require

if TYPE_CHECKING:
    from clvol.view import View
    from clvol.view.audience import Shows

__all__ = ["link"]

_SHARED = ("camera", "crosshair", "slice")
_PAUSE = 1.0  # seconds without a change after which the next one is another step of undo


def link(*views: View, what: str | Iterable[str] = _SHARED) -> Callable[[], None]:
    """Link views: what changes in one of them is shown in all.

    The others first take over what the first one shows. Sessions that begin later follow, too. Views may be linked in chains and
    rings, and in several ways; what comes back to a view changes nothing there.

    Parameters
    ----------
    *views : View
        Two or more.
    what : str or sequence of str
        Fields of `State` that are shared; by default the camera, the crosshair, and magnification and middle of slices. "index"
        is the step along time, "window" and "cmap" the greys and colours of slices.

    Returns
    -------
    callable
        Without arguments: ends the link.

    Raises
    ------
    OptionError
        Fewer than two views, one of them twice, or no such field; or what the first view shows is not allowed in another.

    Examples
    --------
    >>> before, after = clvol.view.View(first), clvol.view.View(second)
    >>> unlink = clvol.view.link(before, after, what=("camera", "crosshair", "clip"))
    """
    audiences = {view.resident.audience.number for view in views}
    if len(views) < 2 or len(audiences) < len(views):
        raise OptionError(
            f"views that are linked must be two or more, each once; got {len(views)} of which {len(audiences)} differ"
        )
    names = (what,) if isinstance(what, str) else tuple(what)
    allowed = [each.name for each in fields(State)]
    for name in names:
        if name not in allowed:
            raise one_of("what", name, allowed)
    first, *others = views
    shared = _part(first.state, names)
    states = [other.state.changed(shared) for other in others]
    for other, state in zip(others, states, strict=True):
        require(other.resident, state)
    for other, state in zip(others, states, strict=True):  # in all of them, or in none
        other.state = state
    made = _Link(views, names)
    ends = [end for view in views for end in made.listen(view)]
    return lambda: [end() for end in ends].clear()


def _part(state: State, names: Iterable[str]) -> dict[str, Any]:
    whole = state.json()
    return {name: whole[name] for name in names}


class _Link:
    def __init__(self, views: tuple[View, ...], names: tuple[str, ...]) -> None:
        self._views, self._names = views, names
        self._gesture, self._at = 0, 0.0

    def listen(self, view: View) -> tuple[Callable[[], None], ...]:
        audience = view.resident.audience
        return (
            audience.listen("change", lambda state, before, via: self._pass_on(view, state, before, via)),
            audience.listen("join", lambda session: self._join(view, session)),
        )

    def _join(self, view: View, session: Shows) -> None:
        """Show in a new session what others show."""
        other = self._views[1] if view is self._views[0] else self._views[0]
        session.receive({**self._message(other.state), "live": False, "via": frozenset((other.resident.audience.number,))})

    def _pass_on(self, view: View, state: State, before: State, via: frozenset[int]) -> None:
        if all(getattr(state, name) == getattr(before, name) for name in self._names):
            return
        message, passed = self._message(state), via | {view.resident.audience.number}
        for other in self._views:
            if other.resident.audience.number not in passed:
                other.resident.audience.change(message, passed)

    def _message(self, state: State) -> dict[str, Any]:
        now = time.monotonic()
        self._gesture += now - self._at > _PAUSE
        self._at = now
        return {"type": "set", "changes": _part(state, self._names), "live": True, "gesture": f"link {self._gesture}"}
