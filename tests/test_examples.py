from __future__ import annotations

import contextlib
import io
import runpy
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol.device import Device
from clvol.figures import FIGURES

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
TOOTH = ROOT.parent / "shared" / "data" / "tooth.nhdr"

pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="examples are not beside the tests")


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def run(name: str, *arguments: object, folder: Path) -> Done:
    """Run a script in this process, which avoids repeated imports."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    before = sys.argv, sys.path[:]
    sys.argv, sys.path[0:0] = [str(EXAMPLES / name), *map(str, arguments)], [str(EXAMPLES)]
    try:
        with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            runpy.run_path(sys.argv[0], run_name="__main__")
    except SystemExit as stop:  # what Python makes of it
        code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
        if isinstance(stop.code, str):
            err.write(f"{stop.code}\n")
    finally:
        sys.argv, sys.path[:] = before
        for module in ("_script", "_scipy"):
            sys.modules.pop(module, None)
    return Done(code, out.getvalue(), err.getvalue())


def test_a_script_runs_in_its_own_process(tmp_path: Path, device: Device) -> None:
    command = [sys.executable, str(EXAMPLES / "real_scan.py"), "missing.npy"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=120, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "FormatError: cannot read missing.npy: there is no such file or folder\n"
    assert device is not None


def test_figure6_draws_the_figure_and_prints_its_errors(tmp_path: Path, device: Device) -> None:
    done = run("figure6.py", "--pixels", 24, "--samples", 16, "--output", "sheet.png", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert len(lines) == 8
    assert all("RMS error 0." in line and line.endswith("°") for line in lines[:7])
    assert lines[7].startswith("sheet.png in ")
    sheet = iio.imread(tmp_path / "sheet.png")
    assert sheet.shape[1:] == (4 * 24 + 3 * 4, 3)
    assert sheet.std() > 20
    assert device is not None


@pytest.mark.parametrize("arguments", [("--pixels", 0), ("--samples", 1), ("--output", "a.gif", "--pixels", 8, "--samples", 4)])
def test_figure6_reports_errors(tmp_path: Path, device: Device, arguments: tuple[object, ...]) -> None:
    done = run("figure6.py", *arguments, folder=tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "Error: " in done.stderr
    assert list(tmp_path.iterdir()) == []
    assert device is not None


@pytest.mark.one_in(6)
@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("figure1", ("--samples", 9, "--pixels", 30), "samples along the ray of pixel"),
        ("figure2", (), "hybrid, ×2 then linear: error up to 0.064"),
        ("figure3", ("--samples", 9, "--pixels", 24), "ms a frame"),
        ("figure4", ("--samples", 9), "Marschner–Lobb, 3-D: smallest with"),
        ("figure5", ("--samples", 17), "zone plate, B-spline interpolation: RMS error 0."),
        ("impulse", (), "B-spline interpolation: 1.000 at its own sample, smallest value -0.137"),
        ("gradients", ("--samples", 9, "--pixels", 24), "B-spline interpolation: mean error of the normals"),
        ("convergence", ("--points", 200), "bspline3: the error falls with power "),
        ("noise", ("--samples", 9, "--points", 100), "linear: keeps 0.667 of the noise's variance along an axis"),
        ("slices", ("--samples", 7), "slices 2 pixels apart: smallest RMS error with "),
        ("edges", ("--samples", 12, "--pixels", 24), "ideal low-pass, nearest neighbour: values rise again by 0."),
        ("reduction", ("--samples", 16), "zone plate, 2 times fewer samples: RMS error decimated 0."),
        ("cost", ("--samples", 9, "--points", 200), "* nothing is both faster and better"),
    ],
)
def test_every_figure_has_an_example(tmp_path: Path, device: Device, name: str, arguments: tuple[object, ...], words: str) -> None:
    pytest.importorskip("matplotlib")
    done = run(f"{name}.py", *arguments, "--output", "a.png", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert words in done.stdout
    assert done.stdout.endswith("\na.png\n")
    assert iio.imread(tmp_path / "a.png").std() > 5
    if name in ("figure2", "impulse"):
        failed = run(f"{name}.py", *arguments, "--output", "none/a.png", folder=tmp_path)
        assert failed.returncode == 1
        assert failed.stderr.startswith("FormatError: cannot write ")
    assert device is not None


def test_examples_and_figures_correspond() -> None:
    there = {path.stem.removeprefix("figure") for path in EXAMPLES.glob("*.py")}
    assert set(FIGURES) <= there


def test_the_contact_sheet_contains_every_volume(tmp_path: Path, device: Device) -> None:
    (tmp_path / "scans").mkdir()
    np.save(tmp_path / "scans" / "scan.npy", np.pad(np.ones((4, 4, 4)), 3))
    (tmp_path / "scans" / "notes.txt").write_text("no volume")
    done = run("contact_sheet.py", "scans", "--no-peers", "--pixels", 24, "--output", "a.png", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("left out notes.txt: ")
    assert done.stdout.endswith("a.png\n")
    sheet = iio.imread(tmp_path / "a.png")
    rows = 1 + len(clvol.phantoms.names())
    assert sheet.shape[1] == 3 * 24 + 2 * 4
    height = (sheet.shape[0] + 4) // rows
    assert all(sheet[row * height : row * height + 24].max() > 100 for row in range(rows))
    assert run("contact_sheet.py", "none", folder=tmp_path).returncode == 2
    assert device is not None


def test_real_scan_draws_any_volume(tmp_path: Path, device: Device) -> None:
    ramp = np.linspace(-1, 1, 10)
    np.save(tmp_path / "scan.npy", (ramp**2 + ramp[:, None] ** 2 + ramp[:, None, None] ** 2).astype(np.float32))
    done = run("real_scan.py", "scan.npy", "--pixels", 12, "--isovalue", 0.7, "--output", "a.png", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "a.png\na-default.png\n"
    assert iio.imread(tmp_path / "a.png").shape[1] == 3 * 12 + 2 * 4
    assert iio.imread(tmp_path / "a-default.png").shape == (512, 512, 3)
    failed = run("real_scan.py", "missing.npy", folder=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr == "FormatError: cannot read missing.npy: there is no such file or folder\n"
    assert device is not None


def test_smoothing_draws_a_volume_before_and_after(tmp_path: Path, device: Device) -> None:
    ramp = np.linspace(-1, 1, 24)
    ball = ramp**2 + ramp[:, None] ** 2 + ramp[:, None, None] ** 2
    np.save(tmp_path / "scan.npy", (ball + np.random.default_rng(0).normal(0, 0.1, ball.shape)).astype(np.float32))
    done = run("smoothing.py", "scan.npy", "--pixels", 24, "--isovalue", 0.7, "--output", "a.png", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    linear, interpolating, smoothing, output = done.stdout.splitlines()
    assert (linear, interpolating, output) == ("linear", "bspline3", "a.png")
    assert smoothing.startswith("bspline3(0.") or float(smoothing[9:-1]) >= 1
    assert iio.imread(tmp_path / "a.png").shape[1] == 3 * 24 + 2 * 4
    failed = run("smoothing.py", "missing.npy", folder=tmp_path)
    assert failed.returncode == 1
    assert failed.stderr == "FormatError: cannot read missing.npy: there is no such file or folder\n"
    assert device is not None


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("resampling", ("--pixels", 32), "14 × 32 × 32 samples of 13.6 × 5.9 × 5.9 mm to 5.3 × 5.3 × 5.3 mm"),
        ("series", ("--pixels", 48, "--frames", 4), "4 images of 48 × 48 × 48"),
        ("photograph", ("--height", 60), "(60, 90, 3), uint8, turned by 4°"),
    ],
)
def test_scripts_give_the_same_with_scipy_and_clvol(
    tmp_path: Path, device: Device, name: str, arguments: tuple[object, ...], words: str
) -> None:
    pictures = []
    for module in ("scipy", "clvol"):
        done = run(f"scipy_{name}.py", "--with", module, *arguments, "--output", f"{module}.png", folder=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        lines = done.stdout.splitlines()
        assert lines[0] == words
        assert lines[1].startswith("scipy.ndimage: ")
        assert lines[-1] == f"{module}.png"
        pictures.append(iio.imread(tmp_path / f"{module}.png").astype(int))
    assert lines[2].startswith("clvol.ndimage: ")
    for line in lines:
        what, _, difference = line.partition(": differ by at most ")
        if what in ("values", "series"):
            assert float(difference.split()[0]) < 2e-6
        elif what == "photograph":
            assert int(difference.split(",")[0]) <= 1
    assert sum(": differ by at most " in line for line in lines) == (2 if name == "resampling" else 1)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1 or name == "resampling"  # a label may change where two are as near
    assert pictures[0].std() > 20
    if name == "series":
        before, after, _ = (float(word) for word in lines[-2].split() if word.startswith("0."))
        assert after < 0.7 * before
    assert device is not None


@pytest.mark.skipif(not TOOTH.is_file(), reason="the scan of a tooth is not here")
def test_real_scan_draws_a_tooth(tmp_path: Path, device: Device) -> None:
    pytest.importorskip("SimpleITK")
    done = run("real_scan.py", TOOTH, "--pixels", 24, "--output", "tooth.png", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert iio.imread(tmp_path / "tooth.png").std() > 15
    assert iio.imread(tmp_path / "tooth-default.png").std() > 5
    assert device is not None
