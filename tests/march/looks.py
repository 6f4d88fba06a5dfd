"""Shared by the tests of pictures."""

from __future__ import annotations

from typing import Any

from clvol.device import Tile
from clvol.march.frame import BY_PLANES, BY_RAYS
from clvol.march.options import unheard
from clvol.scene.mode import as_mode, every_option, heard_options, mode_options

TILES = {"planes": BY_PLANES, "eights": Tile(16, 15, 8, shared=True), "rays": BY_RAYS}  # odd: never sixteen at a time


def suited(mode: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of `Renderer.render` that the mode has, and that change something in it."""
    own = heard_options(mode, {name: value for name, value in options.items() if name in mode_options(as_mode(mode))})
    others = {name: value for name, value in options.items() if name not in every_option()}
    left_out = unheard(as_mode(mode, own), others, others.get("outputs", "rgba"))
    return own | {name: value for name, value in others.items() if name not in left_out}
