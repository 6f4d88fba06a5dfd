"""`clvol.ndimage.patched` and ``python -m clvol.ndimage``."""

from __future__ import annotations

import subprocess
import sys
import threading
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import scipy.ndimage

import clvol
from clvol.base.errors import MissingDependencyError, OptionError, RefusedError, UnsupportedError
from clvol.ndimage import patched
from clvol.ndimage.interpolation import __all__ as names

DATA = np.random.default_rng(0).random((6, 7))
DEEP = np.ones((2, 2, 2, 2))
AT_DEEP = np.zeros((4, 3))
on_a_device = pytest.mark.usefixtures("device")
BEFORE = {name: getattr(scipy.ndimage, name) for name in names}


def unpatched() -> bool:
    return all(getattr(scipy.ndimage, name) is BEFORE[name] for name in names)


@on_a_device
def test_calls_are_replaced_and_counted() -> None:
    exact = scipy.ndimage.zoom(DATA, 2)
    with patched() as report:
        assert not any(getattr(scipy.ndimage, name) is BEFORE[name] for name in names)
        np.testing.assert_allclose(scipy.ndimage.zoom(DATA, 2), exact, atol=1e-12)
        scipy.ndimage.zoom(input=DATA, zoom=3)
        scipy.ndimage.rotate(DATA, 30)
        assert scipy.ndimage.gaussian_filter.__module__.startswith("scipy.")
    assert unpatched()
    assert report.taken == {"zoom": 2, "rotate": 1}
    assert not report.not_taken
    assert str(report).splitlines()[1:] == [f"{'rotate':20}{1:>8}{1:>8}{0:>11}", f"{'zoom':20}{2:>8}{2:>8}{0:>11}"]


@on_a_device
def test_former_namespaces_are_patched() -> None:
    with patched("scipy") as report:
        from scipy.ndimage.interpolation import shift  # type: ignore[attr-defined]  # deprecated

        shift(DATA, 1)
    assert report.taken == {"shift": 1}
    assert "shift" not in vars(sys.modules["scipy.ndimage.interpolation"])


def test_everything_is_restored_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), patched("scipy", "skimage" if "skimage" in sys.modules else "numpy"):
        _ = 1 / 0
    assert unpatched()
    with patched():  # it can be entered again
        pass


@on_a_device
def test_names_imported_in_the_block_are_scipys_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("imports_late")
    monkeypatch.setitem(sys.modules, "imports_late", module)
    kept = []
    with patched() as report:
        exec("from scipy.ndimage import zoom, label", module.__dict__)
        kept.append(module.zoom)
        module.zoom(DATA, 2)
    assert module.zoom is BEFORE["zoom"]
    assert report.taken == {"zoom": 1}
    np.testing.assert_array_equal(kept[0](DATA, 2), scipy.ndimage.zoom(DATA, 2))  # kept elsewhere
    assert report.taken == {"zoom": 1}


@on_a_device
def test_a_package_alone_can_be_patched(monkeypatch: pytest.MonkeyPatch) -> None:
    package, part, other = ModuleType("one"), ModuleType("one.part"), ModuleType("oneother")
    for module in (package, part, other):
        exec("from scipy import ndimage as ndi\nfrom scipy.ndimage import shift as move", module.__dict__)
        monkeypatch.setitem(sys.modules, module.__name__, module)
    with patched("one") as report:
        part.ndi.zoom(DATA, 2)
        package.move(DATA, 1)
        assert part.ndi.label is scipy.ndimage.label
        assert part.ndi is not scipy.ndimage
        assert unpatched()
        assert other.ndi is scipy.ndimage
        assert other.move is BEFORE["shift"]
    assert report.taken == {"zoom": 1, "shift": 1}
    assert part.ndi is scipy.ndimage
    assert package.move is BEFORE["shift"]


@pytest.mark.parametrize("package", ["scipy", "skimage"])
@on_a_device
def test_scikit_image_computes_with_clvol(package: str) -> None:
    transform = pytest.importorskip("skimage.transform")
    measure = pytest.importorskip("skimage.measure")
    volume = np.random.default_rng(1).random((9, 8, 7))

    def compute() -> list[np.ndarray]:
        return [
            transform.resize(volume, (12, 11, 5), order=3, anti_aliasing=False),
            measure.profile_line(DATA, (0, 0), (4, 5), order=2, mode="reflect"),
        ]

    exact = compute()
    with patched(package) as report:
        found = compute()
    assert report.taken == {"zoom": 1, "map_coordinates": 1}
    for ours, theirs in zip(found, exact, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)  # SciPy's "reflect" on few samples
    assert unpatched()
    assert vars(sys.modules["skimage.transform._warps"])["ndi"] is scipy.ndimage


@on_a_device
def test_rejected_calls_raise() -> None:
    with patched() as report:
        with pytest.raises(UnsupportedError, match="at most 3 axes"):
            scipy.ndimage.map_coordinates(DEEP, AT_DEEP)
        with pytest.raises(RuntimeError, match="order must be"):
            scipy.ndimage.zoom(DATA, 2, order=9)
        with pytest.raises(TypeError, match="no_such_argument"):
            scipy.ndimage.zoom(DATA, 2, no_such_argument=1)
    assert report.not_taken == {"map_coordinates": 1, "zoom": 2}
    assert "1 x order must be a whole number from 0 to 5" in str(report)
    assert not report.taken


@on_a_device
def test_rejected_calls_fall_back_on_request_with_one_warning() -> None:
    with warnings.catch_warnings(record=True) as told, patched(fallback=True) as report:
        warnings.simplefilter("always")
        for _ in range(3):
            result = scipy.ndimage.map_coordinates(DEEP, AT_DEEP)
        scipy.ndimage.shift(DATA, np.nan)
        scipy.ndimage.shift(DATA, np.inf)
        with pytest.raises(RuntimeError, match="spline order not supported"):  # SciPy's own
            scipy.ndimage.zoom(DATA, 2, order=9)
    np.testing.assert_allclose(result, 1)
    assert [str(one.message).partition(" was")[0] for one in told] == ["map_coordinates", "shift"]
    assert told[0].filename == __file__
    assert report.not_taken == {"map_coordinates": 3, "shift": 2}
    assert not report.taken


@on_a_device
def test_errors_of_a_mapping_do_not_fall_back() -> None:
    def mapping(_: tuple[int, ...]) -> tuple[int, ...]:
        raise TypeError("mine")

    with patched(fallback=True) as report, pytest.raises(TypeError, match="mine"):
        scipy.ndimage.geometric_transform(DATA, mapping)
    assert not report.not_taken


@on_a_device
def test_patches_do_not_nest() -> None:
    caught: list[BaseException] = []

    def enter() -> None:
        try:
            with patched():
                pass
        except RefusedError as error:
            caught.append(error)

    with patched() as report:
        with pytest.raises(RefusedError, match="must not be within another patched"), patched("numpy"):
            pass
        thread = threading.Thread(target=enter)
        thread.start()
        thread.join()
        assert len(caught) == 1
        scipy.ndimage.shift(DATA, 0.5)  # the first is still in force
    assert report.taken == {"shift": 1}
    assert unpatched()


@on_a_device
def test_calls_of_all_threads_are_replaced() -> None:
    with patched() as report:
        threads = [threading.Thread(target=lambda: [scipy.ndimage.shift(DATA, 0.5, order=1) for _ in range(5)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert report.taken == {"shift": 20}


def test_packages_must_be_known() -> None:
    with pytest.raises(MissingDependencyError, match="got 'no_such_package'"), patched("no_such_package"):
        pass
    with pytest.raises(OptionError, match="packages must be names of packages; got 3"), patched(3):  # type: ignore[arg-type]
        pass
    assert unpatched()


@on_a_device
def test_verbose_reports_each_call(capsys: pytest.CaptureFixture[str]) -> None:
    with patched(verbose=True, fallback=True):
        scipy.ndimage.zoom(DATA, 2, order=1)
        with pytest.warns(UserWarning, match="computed by SciPy"):
            scipy.ndimage.map_coordinates(DEEP, coordinates=AT_DEEP)
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("clvol.ndimage: zoom of float64 (6, 7) small, by SciPy, ")
    assert said[1].startswith("clvol.ndimage: map_coordinates of float64 (2, 2, 2, 2) by SciPy: points must have coordinates")
    assert said[2].split() == ["clvol.ndimage", "taken", "small", "not", "taken"]


# -- python -m clvol.ndimage ----------------------------------------------------------------------------------


def run(script: Path, *arguments: str, plain: bool = False) -> subprocess.CompletedProcess[str]:
    """A script run by clvol, or by plain Python."""
    command = [sys.executable, *([] if plain else ["-m", "clvol.ndimage"]), *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", timeout=120, check=False, cwd=script.parent)


@on_a_device
def test_a_script_runs_patched(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("from scipy.ndimage import zoom\n", encoding="utf-8")
    script = tmp_path / "script.py"
    script.write_text(
        """import sys
from beside import zoom
print(__name__, sys.argv, sys.path[0], __file__, zoom.__wrapped__.__module__)
print(sys.modules["__main__"].zoom is zoom, zoom([[1.0, 2], [3, 4]], 2, order=1).shape)
x: "not evaluated" = 1
print(sys.modules["__main__"].__annotations__)
""",
        encoding="utf-8",
    )
    done = run(script, "--verbose", "script.py", "-a", "--verbose")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    arguments = f"['script.py', '-a', '--verbose'] {tmp_path.resolve()} {tmp_path / 'script.py'}"
    assert lines[0] == f"__main__ {arguments} clvol.ndimage.interpolation"
    assert lines[1:] == ["True (4, 4)", "{'x': 'not evaluated'}"]
    assert "zoom" in done.stderr
    assert " small, by SciPy, " in done.stderr


@pytest.mark.one_in(5)
@pytest.mark.parametrize(
    "text",
    [
        "def f():\n    return 1 / 0\n\nf()\n",
        "import sys\nsys.exit(3)\n",
        "raise SystemExit('a message')\n",
        "print('out')\nx = = 1\n",
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nimport time\ntime.sleep(9)\n",
        "import sys\nsys.excepthook = lambda kind, error, trace: print('mine', error, trace.tb_frame.f_code.co_name)\n1 / 0\n",
        "import atexit\natexit.register(print, 'at exit')\nassert False, 'no'\n",
    ],
)
def test_a_script_exits_as_with_python_itself(tmp_path: Path, text: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(text, encoding="utf-8")
    ours, theirs = run(script, "script.py"), run(script, "script.py", plain=True)
    assert (ours.returncode, ours.stdout, ours.stderr) == (theirs.returncode, theirs.stdout, theirs.stderr)


def test_a_script_may_fall_back(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np\nfrom scipy.ndimage import shift\nprint(shift(np.ones(3), np.nan, cval=5))\n", encoding="utf-8"
    )
    done = run(script, "script.py")
    assert done.returncode == 1
    assert done.stderr.splitlines()[0] == "Traceback (most recent call last):"
    assert f'File "{script}", line 3' in done.stderr.splitlines()[1]
    assert "NotFiniteError: shift must be finite; got nan" in done.stderr
    done = run(script, "--fallback", "script.py")
    assert (done.returncode, done.stdout) == (0, "[5. 5. 5.]\n")
    assert done.stderr.count("shift was computed by SciPy, not by clvol: shift must be finite; got nan") == 1


def test_a_missing_script(tmp_path: Path) -> None:
    done = run(tmp_path / "none.py", "none.py")
    assert done.returncode == 2
    assert "script must be a file; got 'none.py'" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_package_is_available_without_an_import() -> None:
    assert clvol.ndimage.patched is patched


def test_a_mapping_is_asked_once_for_each_element() -> None:
    asked: list[tuple[int, ...]] = []

    def mapping(index: tuple[int, ...]) -> list[float]:
        asked.append(index)
        return [index[0] + 0.5]

    found = clvol.ndimage.geometric_transform(np.arange(8.0) ** 2, mapping, output_shape=(4,))
    assert asked == [(0,), (1,), (2,), (3,)]
    np.testing.assert_allclose(found, scipy.ndimage.shift(np.arange(8.0) ** 2, -0.5)[:4], atol=1e-12)
