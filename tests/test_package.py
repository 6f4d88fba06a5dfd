from __future__ import annotations

import ast
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib import import_module
from importlib.metadata import entry_points, requires, version
from importlib.util import find_spec
from pathlib import Path

import pytest

import clvol
from clvol.base.errors import MissingDependencyError

ROOT = Path(__file__).resolve().parents[1]
KERNELS = sorted(p.relative_to(ROOT / "cl").as_posix() for p in (ROOT / "cl").rglob("*.cl"))
_SOURCE = {".py", ".cl", ".toml", ".md", ".yml", ".yaml", ".cfg", ".txt", ".json", ".sh", ""}
_NOT_OURS = {".git", ".venv", ".hypothesis", ".mypy_cache", ".ruff_cache", ".pytest_cache", "__pycache__", "dist", "build", "out"}

in_a_checkout = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not in a checkout")


def test_the_version_matches_the_metadata() -> None:
    assert clvol.__version__ == version("clvol")


@in_a_checkout
def test_the_citation_and_the_recipe_have_the_version() -> None:
    for file in ("CITATION.cff", "packaging/conda/recipe.yaml"):
        assert re.search(r"^ *version: (.+)$", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)[1] == clvol.__version__  # type: ignore[index]


def test_the_command_is_an_entry_point() -> None:
    (command,) = entry_points(group="console_scripts", name="clvol")
    assert command.value == "clvol.cli:main"
    assert callable(command.load())


def test_the_package_runs_as_the_command() -> None:
    command = [sys.executable, "-m", "clvol", "--version"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=60, check=True)
    assert done.stdout.strip() == clvol.__version__


def test_extras_are_declared() -> None:
    wanted = requires("clvol") or []
    for extra, package in (
        ("pocl", "pocl-binary-distribution"),
        ("medical", "SimpleITK"),
        ("medical", "nibabel"),
        ("microscopy", "tifffile"),
        ("figures", "matplotlib"),
        ("xarray", "xarray"),
        ("torch", "torch"),
        ("jax", "jax"),
        ("nitransforms", "nitransforms"),
        ("dask", "dask"),
        ("dask", "distributed"),
        ("hdf5", "h5py"),
        ("vtk", "vtk"),
        ("bioio", "bioio"),
        ("view", "aiohttp"),
    ):
        line = next(
            row for row in wanted if row.lower().startswith(package.lower()) and f"extra == '{extra}'" in row.replace('"', "'")
        )
        assert ("sys_platform" in line) == (extra == "pocl")  # PoCL's wheels exist for one platform


def test_public_names_are_sorted_and_exist() -> None:
    assert list(clvol.__all__) == sorted(clvol.__all__)
    assert all(hasattr(clvol, name) for name in clvol.__all__)


@pytest.mark.parametrize("module", ["clvol", "clvol.cli"])
def test_importing_is_cheap_and_needs_no_opencl(module: str) -> None:
    heavy = (
        "pyopencl",
        "SimpleITK",
        "scipy.ndimage",
        "imageio",
        "PIL",
        "tifffile",
        "zarr",
        "h5py",
        "vtkmodules",
        "bioio",
        "nibabel",
        "cmap",
        "matplotlib",
        "torch",
        "jax",
        "xarray",
        "dask",
        "aiohttp",
    )
    code = f"import {module}, sys; print(*[m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=60, check=True)
    assert done.stdout.split() == []


def test_importing_is_lazy() -> None:
    code = "import clvol, sys; print('numpy' in sys.modules, [name for name in clvol.__all__ if not hasattr(clvol, name)])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=60, check=True)
    assert done.stdout.strip() == "False []"


def test_lazy_imports_match_the_type_stubs() -> None:
    tree = ast.parse(Path(str(clvol.__file__)).read_text(encoding="utf-8"))
    (seen,) = (node.body for node in tree.body if isinstance(node, ast.If))
    places = {n.name: one.module for one in seen if isinstance(one, ast.ImportFrom) for n in one.names if one.module != "clvol"}
    assert {name: f"clvol.{place}" for name, place in clvol._PLACE.items()} == places
    assert {*clvol.__all__} == {*places, "images", "ndimage", "phantoms"}


def test_only_what_is_public_is_shown() -> None:
    assert {*clvol.__all__, *clvol._PARTS} <= {*dir(clvol)} <= {*clvol.__all__, *clvol._PARTS, *clvol._OPTIONAL, "__version__"}


def test_public_submodules_are_attributes_before_import() -> None:
    code = "import clvol; print([name for name in clvol._PARTS if getattr(clvol, name).__name__ != f'clvol.{name}'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_no_function_shadows_a_module() -> None:
    for found in pkgutil.walk_packages(clvol.__path__, "clvol."):
        if not found.name.endswith("__main__"):
            try:
                module = import_module(found.name)
            except MissingDependencyError:  # a plug-in of another program, without that
                continue
            parent, _, name = found.name.rpartition(".")
            assert getattr(sys.modules[parent], name) is module, found.name


@in_a_checkout
def test_no_file_names_a_machine() -> None:
    told = []
    here = re.compile(r"""(?<![\w.}])/(?:work|root|home)/(?!runner/)\w""")
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [f for f in folders if f not in _NOT_OURS and not f.endswith(".egg-info")]
        for name in names:
            path = Path(folder) / name
            if name in _NOT_OURS or path.suffix not in _SOURCE or path == Path(__file__).resolve():
                continue
            try:
                text = path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue
            told += [
                f"{path.relative_to(ROOT)}:{i}: {line.strip()}" for i, line in enumerate(text.splitlines(), 1) if here.search(line)
            ]
    assert told == []


# -- what is installed ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The source archive, and the wheel built from it, without network access."""
    if not (ROOT / "pyproject.toml").is_file() or any(find_spec(name) is None for name in ("build", "hatchling")):
        pytest.skip("needs a checkout, build and hatchling")
    return built(tmp_path_factory.mktemp("package"))


def built(folder: Path, **environment: str) -> tuple[Path, Path]:
    """The archives of a copy of the checkout, so that the build neither reads nor leaves files in it."""
    tree = folder / "tree"
    if not tree.exists():
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*_NOT_OURS, "clean"))
    done = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder / "dist"), str(tree)],
        capture_output=True,
        encoding="utf-8",
        env={**os.environ, **environment},
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (source,), (wheel,) = (folder / "dist").glob("*.tar.gz"), (folder / "dist").glob("*.whl")
    return source, wheel


def test_the_wheel_contains_what_runs(archives: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(archives[1]) as wheel:
        names = set(wheel.namelist())
        info = f"clvol-{clvol.__version__}.dist-info"
        assert "clvol = clvol.cli:main" in wheel.read(f"{info}/entry_points.txt").decode()
        metadata = wheel.read(f"{info}/METADATA").decode()
    modules = {f"clvol/{p.relative_to(ROOT / 'src' / 'clvol').as_posix()}" for p in (ROOT / "src" / "clvol").rglob("*.py")}
    assert modules <= names
    assert {f"clvol/cl/{kernel}" for kernel in KERNELS} <= names
    assert KERNELS
    assert {f"clvol/view/hosts/static/{path.name}" for path in (ROOT / "src/clvol/view/hosts/static").iterdir()} <= names
    assert "clvol/py.typed" in names
    assert f"{info}/licenses/LICENSE" in names
    assert all(name.startswith(("clvol/", info)) for name in names)
    assert f"Version: {clvol.__version__}" in metadata
    assert "Requires-Python: >=3.11" in metadata


def test_builds_are_reproducible(archives: tuple[Path, Path], tmp_path: Path) -> None:
    """With other dates, permissions, file order, time zone, language and hash seed."""
    tree = tmp_path / "another place" / "tree"
    tree.mkdir(parents=True)
    for path in sorted((archives[0].parents[1] / "tree").rglob("*"), reverse=True):
        if path.is_file():
            copy = tree / path.relative_to(archives[0].parents[1] / "tree")
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
            copy.chmod(0o600)
            os.utime(copy, (1e9, 1e9))
    again = built(tree.parent, TZ="Asia/Kathmandu", LC_ALL="C", PYTHONHASHSEED="7")
    for first, second in zip(archives, again, strict=True):
        assert (first.name, first.read_bytes()) == (second.name, second.read_bytes())


def test_the_wheel_contains_only_the_package(archives: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(archives[1]) as wheel:
        kinds = {Path(name).suffix for name in wheel.namelist() if name.startswith("clvol/")}
    assert kinds == {".py", ".cl", ".typed", ".html", ".js", ".css", ".glsl", ".yaml"}  # no data, no binary


def test_the_wheel_runs_from_where_it_is_unpacked(archives: tuple[Path, Path], tmp_path: Path) -> None:
    with zipfile.ZipFile(archives[1]) as wheel:
        wheel.extractall(tmp_path)
    code = (
        "import clvol, clvol.device.program as p\n"
        "print(clvol.__file__); print(p.folder()); print(len(p.source('spline/points.cl')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    package, kernels, size = done.stdout.splitlines()
    assert Path(package).resolve() == (tmp_path / "clvol" / "__init__.py").resolve()
    assert Path(kernels).resolve() == (tmp_path / "clvol" / "cl").resolve()
    assert int(size) > 1000


def test_the_source_archive_contains_all_to_build_and_test(archives: tuple[Path, Path]) -> None:
    with tarfile.open(archives[0]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    assert {f"cl/{kernel}" for kernel in KERNELS} <= names
    assert {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
        "changes/README.md",
        "Makefile",
        "src/clvol/py.typed",
        "tests/conftest.py",
    } <= names
    assert {"examples/figure6.py", "bench/__main__.py", "docs/figure6.png", "docs/paper.md"} <= names
    assert not [name for name in names if ".venv" in name or "__pycache__" in name or name.endswith(".pyc")]
