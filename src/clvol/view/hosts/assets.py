"""The page's files, as hosts give them to browsers."""

from __future__ import annotations

from clvol.base.html import static

__all__ = ["asset"]

# parts of one module: notebooks take a single file. What is used while a part is read stands in one before it
_PARTS = (
    *("controls", "keys", "pane", "transfer", "joint", "readout", "wiper", "cube", "series", "measures", "files", "opening"),
    *("layers", "panel", "viewer", "address", "socket", "mount"),
)


def asset(name: str) -> str:
    """The text of a file of the page: ``index.html``, ``clvol.css``, or ``clvol.js``, which its parts are joined to."""
    return static("clvol.view.hosts", *([f"{part}.js" for part in _PARTS] if name == "clvol.js" else [name]))
