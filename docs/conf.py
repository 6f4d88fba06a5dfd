"""Builds the site: ``make docs`` runs every notebook and script, and treats warnings as errors."""

from __future__ import annotations

import ast
import re
import sys
from importlib.util import find_spec
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import SphinxError

import clvol

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # _pictures.py

project = "clvol"
author = "The clvol authors"
copyright = author  # noqa: A001  # Sphinx's word
version = release = clvol.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_build", "gallery", "auto_gallery/*.ipynb"]
templates_path = ["_templates"]

smartquotes = False  # quotes in docstrings are code
default_role = "autolink"  # `Volume` in a docstring is a link if the name exists, and italic otherwise
autosummary_imported_members = True
autosummary_ignore_module_all = False  # __all__ defines the public names
autodoc_typehints = "none"  # docstrings describe them
# modules whose packages are too large to install for their docstrings
autodoc_mock_imports = [name for name in ("jax", "monai", "nitransforms", "torch", "torchio") if find_spec(name) is None]
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
numpydoc_show_class_members = False  # autodoc does

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_in_temp = True  # notebooks write files
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_gallery",
    "filename_pattern": r"\.py$",
    "image_scrapers": ("_pictures.scraper",),
    "reset_modules": (),
    "capture_repr": (),
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "thumbnail_size": (320, 320),
    "write_computation_times": False,
    "min_reported_time": 60,
}

html_theme = "pydata_sphinx_theme"
html_title = "clvol"
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["clvol.css"]
html_theme_options = {
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "header_links_before_dropdown": 7,
}
html_sidebars: dict[str, list[str]] = {"start": []}


def _write_modules(_: Sphinx) -> None:
    """Write the page of modules: the first sentence of each module's docstring, by package."""
    root, lines = HERE.parent / "src" / "clvol", ["# Modules", "", "What each file holds, as its docstring says."]
    for folder in sorted({file.parent for file in root.rglob("*.py")}):
        lines += ["", f"## {'.'.join(('clvol', *folder.relative_to(root).parts))}", "", "| module | content |", "|---|---|"]
        for file in sorted(folder.glob("*.py")):
            said = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
            first = re.split(r"(?<=\.)\s|\n\n", said, maxsplit=1)[0]
            name, text = f"`{file.stem}`" if file.stem != "__init__" else "the package", " ".join(first.split())
            lines.append(f"| {name} | {text} |")
    page = HERE / "api" / "generated" / "modules.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _require_no_requests(app: Sphinx, error: Exception | None) -> None:
    """Require that pages work offline: none loads a script, style, font or picture from elsewhere."""
    if error is not None or app.builder.format != "html":
        return
    asks = re.compile(
        r"""<(?:script|img|iframe|source|link(?![^>]*rel="(?:canonical|license)"))\b[^>]*(?:src|href)=["']https?://"""
    )
    found = [page.name for page in Path(app.outdir).rglob("*.html") if asks.search(page.read_text(encoding="utf-8"))]
    if found:
        raise SphinxError(f"pages must not load anything from the network; these do: {', '.join(found)}")


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx calls it."""
    app.connect("builder-inited", _write_modules)
    app.connect("build-finished", _require_no_requests)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
