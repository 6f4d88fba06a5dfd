"""The code's structure: layers by import-linter's contracts (pyproject.toml), and sizes that may only shrink.

python -m tests.test_house    # prints the figures
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "clvol"
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_MODES = "Isosurface|Composite|Mip|Minip|Mean|Attenuated"


class Figure(NamedTuple):
    """A measured number and its maximum."""

    found: int
    most: int


@cache
def modules() -> dict[str, ast.Module]:
    """The syntax trees of all modules, by dotted name."""
    found = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(("clvol", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        found[name] = ast.parse(file.read_text(encoding="utf-8"))
    return found


def imports(tree: ast.AST) -> Iterator[str]:
    """Run-time imports, including those in functions, without those for type checkers."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.expr):
            continue  # most of the nodes, and none has an import
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            yield from names & modules().keys() or {node.module}
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        yield from imports(node)


@cache
def depth(name: str) -> int:
    """The number of modules in the longest chain of imports from this one."""
    below = {other for other in imports(modules()[name]) if other in modules()} - {name, "clvol"}
    return 1 + max(map(depth, below), default=0)


def matching(pattern: str, *, without: str = "") -> int:
    """The number of lines that match."""
    files = (file for file in PACKAGE.rglob("*.py") if not without or not file.as_posix().endswith(without))
    return sum(bool(re.search(pattern, line)) for file in files for line in file.read_text(encoding="utf-8").splitlines())


def classes() -> dict[str, ast.ClassDef]:
    return {
        f"{name}.{node.name}": node for name, tree in modules().items() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
    }


def functions() -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    return [
        node for tree in modules().values() for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = node.args
    names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def lines_of(node: ast.Module | ast.ClassDef) -> int:
    """Lines of a module or class without docstrings, for an example costs nothing."""
    documented = (one for one in ast.walk(node) if isinstance(one, _DOCUMENTED))
    texts = [one.body[0] for one in documented if ast.get_docstring(one, clean=False) is not None]
    whole = (node.body[-1].end_lineno or 0) - getattr(node, "lineno", 1) + 1
    return whole - sum((text.end_lineno or 0) - text.lineno + 1 for text in texts)


def public_members(node: ast.ClassDef) -> int:
    """Public methods and properties of a class; fields of a dataclass are its data."""
    names = {child.name for child in node.body if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))}
    return len([name for name in names if not name.startswith("_")])


def figures() -> dict[str, Figure]:
    """Each figure with its limit."""
    longest = {name: lines_of(node) for name, node in classes().items()}
    members = {name: public_members(node) for name, node in classes().items()}
    return {
        "files at the top of the package": Figure(len(list(PACKAGE.glob("*.py"))), 11),
        "isinstance of lazy or bricked": Figure(matching(r"isinstance\([^)]*\b(BrickedField|LazyVolume)\b"), 6),
        "isinstance of a mode outside mode.py": Figure(matching(rf"isinstance\([^)]*\b({_MODES})\b", without="scene/mode.py"), 0),
        "lines of march/renderer.py": Figure(lines_of(modules()["clvol.march.renderer"]), 209),
        "lines of the longest class": Figure(max(longest.values()), 269),
        "classes of more than 12 public members": Figure(sum(n > 12 for n in members.values()), 3),
        "functions with eight parameters or more": Figure(sum(parameters(node) >= 8 for node in functions()), 67),
        "depth of the filter": Figure(depth("clvol.filter.filter"), 4),
        "depth of Field": Figure(depth("clvol.spline.field"), 10),
        "depth of Renderer": Figure(depth("clvol.march.renderer"), 15),
    }


def test_it_does_not_grow() -> None:
    assert not {name: figure for name, figure in figures().items() if figure.found > figure.most}


def test_imports_go_down_and_never_in_circles() -> None:
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=120, check=False, cwd=ROOT, env=None
    )
    assert done.returncode == 0, done.stdout + done.stderr


def main() -> None:
    for name, (found, most) in figures().items():
        print(f"{found:6} of at most {most:4}  {name}")
    for name, node in sorted(classes().items()):
        size, members = (node.end_lineno or 0) - node.lineno + 1, public_members(node)
        if size > 300 or members > 12:
            print(f"{size:6} lines, {members:3} public members: {name}")
    print(f"{sum(len(file.read_text(encoding='utf-8').splitlines()) for file in PACKAGE.rglob('*.py')):6} lines in all")


if __name__ == "__main__":
    main()
