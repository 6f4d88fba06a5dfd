"""A view from a program: what is shown now, by reading and by assignment, and functions that are called when something happens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clvol.view.audience import Pick
from clvol.view.resident import Resident
from clvol.view.state import State

__all__ = ["Watched", "require"]


def require(resident: Resident, state: State) -> None:
    """Raise `OptionError` for a state that cannot be shown there."""
    resident.catalog.require(state)
    resident.transfer(state)


class Watched:
    """What a `View` has of its sessions: what is shown now, and who is told.

    >>> view = clvol.view.View(volume)
    >>> end = view.on_pick(lambda pick: print(pick.position, pick.value))
    """

    resident: Resident

    @property
    def state(self) -> State:
        """What is shown in the session that was used last; without one, what new sessions show first.

        An assignment shows a state in all sessions, where undo leads back, and is what new ones show first.

        >>> view.state = replace(view.state, mode="mip")    # dataclasses.replace; or view.state.changed({"camera.zoom": 2})
        """
        return self.resident.audience.state

    @state.setter
    def state(self, state: State) -> None:
        require(self.resident, state)
        self.resident.initial = state
        self.resident.audience.show(state)

    def on_change(self, callback: Callable[[State], Any]) -> Callable[[], None]:
        """Have a function called whenever something else is shown, many times in a drag.

        Parameters
        ----------
        callback : callable
            Takes a `State`. It is called in the thread that draws, which goes on when it has returned; its errors are logged.

        Returns
        -------
        callable
            Without arguments: ends this.
        """
        return self.resident.audience.listen("change", lambda state, before, via: callback(state))  # noqa: ARG005

    def on_pick(self, callback: Callable[[Pick], Any]) -> Callable[[], None]:
        """Have a function called at double clicks on what is shown, with position and values there.

        Parameters
        ----------
        callback : callable
            Takes a `Pick`; otherwise as of `on_change`.

        Returns
        -------
        callable
            Without arguments: ends this.
        """
        return self.resident.audience.listen("pick", callback)
