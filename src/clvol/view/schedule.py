"""Which job a session does next: a pure function of what its panes should show, what they show, and what to wait for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

__all__ = ["Draw", "FindFacts", "Job", "Shown", "Situation", "Wait", "next_job"]


class Draw(NamedTuple):
    """Draw a pane; `first` if it does not yet show any picture of what it should show."""

    pane: str
    first: bool


class FindFacts(NamedTuple):
    """Compute in the background what follows from the volume."""


class Wait(NamedTuple):
    """Nothing to do for `seconds`, or, if None, until a message arrives."""

    seconds: float | None


Job: TypeAlias = Draw | FindFacts | Wait


class Shown(NamedTuple):
    """What a pane shows, and whether that is its final picture."""

    key: object = None
    final: bool = False


@dataclass(frozen=True)
class Situation:
    """What the next job depends on.

    Parameters
    ----------
    wanted : mapping
        By pane, in order of priority: everything that its picture depends on.
    shown : mapping
        By pane.
    sketching : bool
        Whether coefficients are still being computed. Slices then wait: they would make the volume's sketch wait too.
    rest_in : float
        Seconds until pointer and wheel count as being at rest; 0 or less if they are.
    room_in : float
        Seconds until the client has room for another frame; 0 if it has.
    facts_in : float or None
        Seconds until the client gets the volume's facts even if nothing is drawn; None if they are known or under way.
    """

    wanted: Mapping[str, object]
    shown: Mapping[str, Shown]
    sketching: bool = False
    rest_in: float = 0.0
    room_in: float = 0.0
    facts_in: float | None = None


def next_job(now: Situation) -> Job:
    """The next job: first pictures of all panes before refined ones, and refined ones only at rest."""
    panes = ["3d"] if now.sketching and "3d" in now.wanted else list(now.wanted)
    outdated = [name for name in panes if now.shown.get(name, Shown()).key != now.wanted[name]]
    unfinished = outdated or [name for name in panes if not now.shown[name].final]
    if not unfinished:
        if now.facts_in is None:
            return Wait(None)
        return FindFacts() if now.facts_in <= 0 else Wait(now.facts_in)
    if now.room_in > 0:
        return Wait(now.room_in)
    if not outdated and now.rest_in > 0:
        return Wait(now.rest_in)
    return Draw(unfinished[0], bool(outdated))
