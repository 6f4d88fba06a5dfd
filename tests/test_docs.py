"""Documentation pages: their Python runs as written, their commands parse, and the API pages list all public names.

Notebooks and the gallery run in `make docs`.
"""

from __future__ import annotations

import doctest
import re
import shlex
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
import skimage.transform

import clvol
from clvol.cli import app
from clvol.device import Device
from clvol.view.events import KEYS
from tests.cases import small_pictures

DOCS = Path(__file__).resolve().parents[1] / "docs"
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
SHELL, INLINE = re.compile(r"```sh\n(.*?)```", re.DOTALL), re.compile(r"`(clvol [a-z][^`]*)`")
PAGES = [page for page in (*sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("how-to/*.md"))) if BLOCK.search(page.read_text("utf-8"))]

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="not in a checkout")


def given(page: str) -> dict[str, object]:
    """The variables that a page assumes."""
    random = np.random.default_rng(0)
    volume = clvol.Volume(random.normal(size=(12, 14, 16)))
    identity = np.eye(4)
    labels = random.integers(0, 3, (6, 7, 8))
    return {
        "scipy": {
            "np": np,
            "clvol": clvol,
            "skimage": skimage,
            "ThreadPoolExecutor": ThreadPoolExecutor,
            "volume": volume,
            "image": volume.data,
            "values": labels.astype(float),
            "labels": labels,
            "factors": (2, 2, 2),
            "chosen": np.zeros((12, 14, 16), int),
            "series": [volume.data] * 2,
            "moves": [(np.eye(3), 0.5)] * 2,
            "result": np.zeros((2, *volume.shape)),
        },
        "reduction": {"clvol": clvol, "photograph": random.random((60, 80, 3)), "scan": volume, "array": volume.data},
        "transforms": {
            "clvol": clvol,
            "affine": clvol.AffineTransform(np.eye(3), (0.5, 0, 0)),
            "field": clvol.DisplacementField(random.normal(size=(4, 4, 4, 3)), spacing=(4, 4, 4)),
            "grid": identity,
            "moving": volume,
            "fixed": volume,
            "bold": random.normal(size=(2, 6, 7, 8)),
            "motion": [identity, identity],
        },
    }.get(page, {})


@pytest.mark.one_in(2)
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(DOCS).with_suffix("").as_posix())
def test_the_python_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    monkeypatch.chdir(tmp_path)
    small_pictures(monkeypatch)
    here = given(page.stem)
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        exec(block, here)  # one after the other, as a reader would
    assert device is not None


PARTS = {"": clvol, "analysis.": clvol.analysis, "images.": clvol.images, "ndimage.": clvol.ndimage}
EXAMPLES = {
    f"{part}{name}": getattr(module, name)
    for part, module in PARTS.items()
    for name in module.__all__
    if ">>> " in (getattr(module, name).__doc__ or "")
}
ALONE = {
    name: thing for name, thing in EXAMPLES.items() if re.search(">>> (import|from) ", thing.__doc__)
}  # others need the reader's files


@pytest.mark.one_in(6)
@pytest.mark.parametrize("name", ALONE)
def test_the_example_of_a_docstring_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    monkeypatch.chdir(tmp_path)
    (found,) = doctest.DocTestFinder(recurse=False).find(ALONE[name], name, module=False, globs={})
    assert doctest.DocTestRunner().run(found).failed == 0
    assert device is not None


def test_the_most_used_functions_have_examples() -> None:
    used = (
        "Camera Field Medium Picture Renderer Scene TransferFunction Volume analysis.compare analysis.predict devices "
        "images.resample images.rotate magnify mesh movie ndimage.affine_transform ndimage.map_coordinates ndimage.rotate "
        "ndimage.shift ndimage.spline_filter ndimage.zoom prefilter read render resample sample save slice write"
    )
    assert {*used.split()} <= EXAMPLES.keys()


def test_every_scene_of_the_gallery_has_its_page_or_a_reason() -> None:
    scenes = {script.stem.removeprefix("plot_"): script.read_text("utf-8") for script in DOCS.glob("gallery/plot_*.py")}
    table = re.findall(r"^\| (`.*?) \|", (DOCS / "how-to" / "pages.md").read_text("utf-8"), re.MULTILINE)
    without = {name for row in table for name in re.findall(r"`(\w+)`", row)} & scenes.keys()
    assert {name for name, text in scenes.items() if "save_html(" in text} == scenes.keys() - without


def test_the_api_pages_list_all_public_names() -> None:
    listed = (DOCS / "api" / "index.rst").read_text(encoding="utf-8").split()
    assert [name for name in clvol.__all__ if name not in listed] == []


def test_the_page_of_public_names_lists_them() -> None:
    page = (DOCS / "public.md").read_text(encoding="utf-8")
    here = {name: import_module(f"clvol.{name}") for name in (*clvol._MODULES, *clvol._PARTS) if name != "device"}
    wanted = {f"clvol.{name}": sorted(module.__all__) for name, module in here.items()} | {"clvol": clvol.__all__}
    listed = {
        module: re.findall(r"`(\w+)`", names) for module, names in re.findall(r"^\| `([\w.]+)` \| (.+) \|$", page, re.MULTILINE)
    }
    assert listed.keys() == {*wanted, *(f"clvol.{name}" for name in clvol._OPTIONAL)}
    assert {module: names for module, names in listed.items() if module in wanted} == wanted


def test_the_commands_of_the_pages_parse() -> None:
    pages = [DOCS / "start.md", DOCS / "viewing.md", *(DOCS / "how-to").glob("*.md"), *(DOCS / "tutorials").glob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    found = [line for block in SHELL.findall(text) for line in block.splitlines() if line.startswith("clvol ")]
    found += INLINE.findall(text)
    assert len(found) > 15
    for line in found:
        app.parse_args(shlex.split(line, comments=True)[1:], exit_on_error=False, print_error=False)  # raises what is wrong


RELIABILITY = DOCS / "reliability.md"


@pytest.mark.parametrize(("page", "least"), [(RELIABILITY, 30), (DOCS / "claims.md", 10)], ids=["reliability", "claims"])
def test_the_tests_named_on_a_page_exist(page: Path, least: int) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", page.read_text(encoding="utf-8"))
    assert len(named) > least
    text = {file: (DOCS.parent / file).read_text(encoding="utf-8") for file, _ in named}
    assert [f"{file}::{name}" for file, name in named if name and f"\ndef {name}(" not in text[file]] == []


def test_reliability_marks_thorough_tests() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`( \(thorough\))?", RELIABILITY.read_text(encoding="utf-8"))
    wrong = []
    for file, name, marked in named:
        text = (DOCS.parent / file).read_text(encoding="utf-8")
        marks = text[: text.index(f"\ndef {name}(")].rpartition("\n\n")[2]
        if bool(marked) != ("\n@pytest.mark.thorough" in f"\n{marks}"):
            wrong.append(f"{file}::{name}")
    assert wrong == []


def test_the_tables_of_reliability_match_the_results() -> None:
    spec = spec_from_file_location("_reliability", DOCS / "_reliability.py")
    assert spec is not None
    assert spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    page = RELIABILITY.read_text(encoding="utf-8")
    assert [name for name in made.TABLES if f"<!-- table: {name} -->" not in page] == []
    assert page == made.with_tables(page), "run: python docs/_reliability.py"


def test_the_guide_lists_every_key_of_the_viewer() -> None:
    text = (DOCS / "viewing.md").read_text(encoding="utf-8")
    assert [key for key, what in KEYS.items() if f"| {key} | {what} |" not in text] == []
