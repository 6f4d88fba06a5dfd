"""Pictures of the gallery: a script's `picture` is shown below it, and its `page`, a file of `clvol.save_html`, in a frame."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

import clvol

PAGES = Path(__file__).parent / "_static" / "gallery"
_FRAME = """
.. raw:: html

   <iframe class="clvol-page" src="../_static/gallery/{name}" title="the same scene, drawn by this browser" loading="lazy"></iframe>
"""


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:  # noqa: ARG001
    """Save the picture and the page of a block, once, and return the text that shows them."""
    picture, page = (block_vars["example_globals"].pop(name, None) for name in ("picture", "page"))
    text = ""
    if picture is not None:
        path = next(block_vars["image_path_iterator"])
        clvol.save(picture, path)
        text += figure_rst([path], gallery_conf["src_dir"])
    if page is not None:
        PAGES.mkdir(parents=True, exist_ok=True)
        shutil.move(Path(block_vars["src_file"]).parent / page, PAGES / page.name)
        text += _FRAME.format(name=page.name)
    return text
