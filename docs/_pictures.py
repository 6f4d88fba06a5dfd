"""Pictures of the gallery: a script's `picture` is shown below it."""

from __future__ import annotations

from typing import Any

from sphinx_gallery.scrapers import figure_rst

import clvol


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:  # noqa: ARG001
    """Save the picture of a block, once, and return the text that shows it."""
    picture = block_vars["example_globals"].pop("picture", None)
    if picture is None:
        return ""
    path = next(block_vars["image_path_iterator"])
    clvol.save(picture, path)
    text: str = figure_rst([path], gallery_conf["src_dir"])
    return text
