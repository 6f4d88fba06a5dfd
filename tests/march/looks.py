"""Shared by the tests of pictures."""

from __future__ import annotations

from typing import Any

from clvol.device import Tile
from clvol.march.frame import BY_PLANES, BY_RAYS
from clvol.scene.mode import as_mode, every_option, mode_options

TILES = {"planes": BY_PLANES, "eights": Tile(16, 15, 8, shared=True), "rays": BY_RAYS}  # odd: never sixteen at a time


def suited(mode: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of `Renderer.render` that the mode has."""
    own = mode_options(as_mode(mode))
    return {name: value for name, value in options.items() if name in own or name not in every_option()}
