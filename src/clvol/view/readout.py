"""What lies under a client's pointer: told when the pointer or the picture there has changed, but not faster than one reads."""

from __future__ import annotations

import math
import time

from clvol.base.errors import OptionError
from clvol.view.control import Control
from clvol.view.post import Post
from clvol.view.protocol import Message, hovered
from clvol.view.state import PANES

__all__ = ["Readout"]

_EVERY = 0.1  # seconds between two of them


class Readout:
    """Of one client: where its pointer is, and what was told of it."""

    def __init__(self, control: Control, post: Post) -> None:
        self._control, self._post = control, post
        self._told: object = None
        self._at = -math.inf

    def due_in(self) -> float | None:
        """Seconds until there is something to tell; None if nothing has changed."""
        return None if self._wanted() == self._told else max(0.0, self._at + _EVERY - time.monotonic())

    def _wanted(self) -> object:
        """All that it depends on."""
        hover = self._post.hover
        if hover is None:
            return None
        name = hover.get("pane")
        return hover, self._control.key(name) if name in PANES else None

    def tell(self) -> None:
        """Send it; `OptionError` if the pointer is in no pane that there is."""
        hover, self._told, self._at = self._post.hover, self._wanted(), time.monotonic()
        found = None if hover is None else hovered(hover)
        self._post.tell({"type": "readout", "pane": None} if found is None else self._at_place(*found))

    def _at_place(self, name: str, x: float, y: float) -> Message:
        message: Message = {"type": "readout", "pane": name}
        try:
            picked = self._control.pick(name, x, y)
        except OptionError:  # before the coefficients are computed
            return message
        if picked["position"] is None:
            return message
        message |= {key: picked[key] for key in ("position", "units", "values")}
        return message | {"voxel": [math.floor(v + 0.5) for v in picked["index"]]}
