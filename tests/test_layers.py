"""Each module imports only from its own layer and from those above it (docs/architecture.md), and no two import each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src"
# top to bottom; a name stands for the module or for all of its package
LAYERS = [
    "interrupted errors moved memory checks rounding uniform files picture display axes units frames interop filter "
    "boundary missing noise volume sliced chunks lazy volumes smoothing stored camera color light scaling histogram palette preset "
    "transfer labels mode look scene fit transform",
    "reference response phantoms formats",
    "device",
    "spline",
    "bricks",
    "ndimage",
    "dask interpolator resizing torch xarray multiscale",
    "march",
    "images batches movies analysis",
    "figures",
    "reports",
    "view",
    "cli __main__",
]


def modules() -> dict[str, Path]:
    return {
        ".".join(file.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): file for file in SOURCE.rglob("*.py")
    }


def imports(file: Path) -> set[str]:
    """Modules of clvol that a file imports, inside functions too."""
    names = modules()
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name for name in full if name in names} or {node.module}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name.split(".")[0] == "clvol"} & names.keys()


def layer(name: str) -> int:
    """The number of a module's layer; the package itself is what the command line stands on."""
    _, _, rest = name.partition(".")
    word = rest.partition(".")[0] or "cli"
    return next(i for i, row in enumerate(LAYERS) if word in row.split())


@pytest.mark.parametrize("name", modules())
def test_imports_go_up(name: str) -> None:
    for other in imports(modules()[name]):
        assert layer(other) <= layer(name), f"{name} imports {other}"


def test_no_circles() -> None:
    graph = {name: {other for other in imports(file) if other not in ("clvol", name)} for name, file in modules().items()}
    state: dict[str, int] = {}

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert state.get(name) != 1, " → ".join((*path, name))
        if name in state:
            return
        state[name] = 1
        for other in graph[name]:
            visit(other, (*path, name))
        state[name] = 2

    for name in graph:
        if name != "clvol":
            visit(name, ())
