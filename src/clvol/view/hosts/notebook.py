"""A view in notebooks, wherever anywidget shows widgets: Jupyter, JupyterLab, VS Code, Colab, Marimo.

Pictures come from the session's thread, also while a cell runs. Events are messages to the kernel, which handles them between
cells: a view that is dragged during a long computation follows when that has ended (JupyterLab 4.4 with ipykernel 7 or newer
handles them at once, in a subshell).

A widget may be shown in several places. Each is a client with its own session, which ends when the place is closed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from clvol.base.errors import MissingDependencyError, OptionError
from clvol.view.hosts.assets import asset
from clvol.view.protocol import Receiver, SessionFactory

try:
    import anywidget
except ImportError as missing:
    raise MissingDependencyError(
        'the viewer in notebooks needs anywidget, which is not installed: pip install "clvol[view]"'
    ) from missing

__all__ = ["Widget", "show"]

_MOST_CLIENTS = 8  # places that show one widget: a page that is reloaded does not close its session
_LONGEST_NAME = 64


class Widget(anywidget.AnyWidget):
    """A view as a widget; `close` ends its sessions."""

    _esm = asset("clvol.js")
    _css = asset("clvol.css")

    def __init__(self, view: SessionFactory) -> None:
        super().__init__()
        self.view = view
        self._sessions: dict[str, Receiver] = {}
        self.on_msg(self._receive)

    def _receive(self, _: Any, message: Any, __: Any) -> None:
        """A message from one of the places that show it, with the place's name."""
        if not isinstance(message, Mapping):
            return
        client, kind = message.get("client"), message.get("type")
        if not isinstance(client, str) or len(client) > _LONGEST_NAME:
            return
        if kind == "open":
            self._open(client)
        elif kind == "close":
            self._end(client)
        elif (session := self._sessions.get(client)) is not None:
            session.receive({name: value for name, value in message.items() if name != "client"})

    def _open(self, client: str) -> None:
        self._end(client)
        while len(self._sessions) >= _MOST_CLIENTS:
            self._end(next(iter(self._sessions)))

        def send(message: dict[str, Any], data: bytes | None = None) -> None:
            if self.comm is None:
                raise ConnectionError("the widget was closed")
            self.send({**message, "client": client}, None if data is None else [data])

        self._sessions[client] = self.view.session(send)

    def _end(self, client: str) -> None:
        session = self._sessions.pop(client, None)
        if session is not None:
            session.close(1.0)  # it ends by itself: the notebook does not wait for a long picture

    def close(self) -> None:
        """Remove it from the page, and end its sessions."""
        for client in list(self._sessions):
            self._end(client)
        super().close()


def show(view: SessionFactory) -> None:
    """Show a view below the cell of a notebook.

    Raises
    ------
    OptionError
        The program does not run in a notebook.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None:
        raise OptionError("there is no notebook here to show a view in; view.serve() is a page for any browser")
    from IPython.display import display

    display(Widget(view))  # type: ignore[no-untyped-call]
