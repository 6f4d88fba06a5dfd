"""Which job a session does next: a pure function of what its panes should show, what they show, and what to wait for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

__all__ = ["Draw", "FindFacts", "Job", "Read", "Shown", "Wait", "next_job"]


class Draw(NamedTuple):
    """Draw a pane; `first` if it does not yet show any picture of what it should show."""

    pane: str
    first: bool


class FindFacts(NamedTuple):
    """Compute in the background what follows from the volume."""


class Read(NamedTuple):
    """Tell what lies under the pointer."""


class Wait(NamedTuple):
    """Nothing to do for `seconds`, or, if None, until a message arrives."""

    seconds: float | None


Job: TypeAlias = Draw | FindFacts | Read | Wait


class Shown(NamedTuple):
    """What a pane shows, and whether that is its final picture."""

    key: object = None
    final: bool = False


def next_job(
    wanted: Mapping[str, object],
    shown: Mapping[str, Shown],
    *,
    sketching: bool = False,
    rest_in: float = 0.0,
    room_in: float = 0.0,
    facts_in: float | None = None,
    read_in: float | None = None,
) -> Job:
    """The next job: first pictures of all panes before refined ones, and refined ones only at rest.

    By pane, in order of priority, `wanted` is everything that its picture depends on. While coefficients are still being
    computed (`sketching`) slices wait: they would make the volume's sketch wait too. The others are seconds: until pointer and
    wheel count as being at rest, until the client has room for another frame, and until it gets the volume's facts even if nothing
    is drawn (None if they are known or under way), and until what lies under the pointer may be told again (None if it was told):
    as soon as no picture is to be drawn right now.
    """
    panes = ["3d"] if sketching and "3d" in wanted else list(wanted)
    outdated = [name for name in panes if shown.get(name, Shown()).key != wanted[name]]
    unfinished = outdated or [name for name in panes if not shown[name].final]
    if unfinished:
        pause = room_in if room_in > 0 else 0.0 if outdated else rest_in
        draw_in: float | None = max(0.0, pause)
        if not draw_in:
            return Draw(unfinished[0], bool(outdated))
        facts_in = None
    else:
        draw_in = None
        if facts_in is not None and facts_in <= 0:
            return FindFacts()
    if read_in is not None and read_in <= 0:
        return Read()
    return Wait(min((seconds for seconds in (draw_in, facts_in, read_in) if seconds is not None), default=None))
