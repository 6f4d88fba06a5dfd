"""The benchmarks: commands run, and derived numbers are correct. No speed is tested."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import clvol
from bench import cases, drags, machine, ndimage, parity, runtimes, scene, soak
from bench.deeds import DEEDS, NOT_DONE
from clvol.base.errors import DeviceError
from clvol.device import as_device
from clvol.march.planes import Planes

ROOT = Path(__file__).parents[1]

OLD = {
    "date": "2026-01-01",
    "machine": {"processor": "one", "cores": 2},
    "results": [
        {"name": "prefilter and upload", "seconds": {"clvol": 0.4}},
        {"name": "prefilter 256³, array to array", "seconds": {"clvol": 0.2, "scipy spline_filter": 0.6}},
        {"name": "frame of old", "seconds": {"clvol": 1.0}},
    ],
}
NEW = {
    "format": 2,
    "date": "2026-01-02",
    "machine": {"processor": "one", "cores": 2},
    "results": [
        {"name": "prefilter 256³ and upload", "seconds": {"clvol": 0.1}},
        {"name": "prefilter 256³, array to array", "seconds": {"clvol": 0.1, "scipy": 1.2, "numba": 0.3}},
        {"name": "peak memory", "value": 3.0, "unit": "× the volume"},
        {"name": "too large", "skipped": "no room"},
    ],
}


def command(*arguments: str, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        encoding="utf-8",
    )


def written(folder: Path, name: str, report: Any) -> str:
    file = folder / name
    file.write_text(json.dumps(report), encoding="utf-8")
    return str(file)


def test_compare_reads_both_formats(tmp_path: Path) -> None:
    done = command("bench.compare", written(tmp_path, "old.json", OLD), written(tmp_path, "new.json", NEW))
    assert done.returncode == 0, done.stderr
    lines = {line.split("  ")[0].strip(): line for line in done.stdout.splitlines()}
    assert "4.00×" in lines["prefilter 256³ and upload"]
    # twice as fast, on a machine that is half as fast by scipy's time
    assert "2.00×" in lines["prefilter 256³, array to array"]
    assert "scipy 4.00×" in lines["prefilter 256³, array to array"]
    assert "only in old: frame of old" in done.stdout
    assert "only in new: peak memory; too large" in done.stdout


def test_compare_reads_the_results_of_the_repository() -> None:
    results = sorted(str(file) for file in (ROOT / "bench/results").glob("*.json"))
    done = command("bench.compare", results[0], results[-1])
    assert done.returncode == 0, done.stderr
    assert "geometric mean" in done.stdout


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"format": 99, "results": []}'])
def test_compare_rejects_invalid_reports(tmp_path: Path, content: str) -> None:
    file = tmp_path / "report.json"
    file.write_text(content)
    done = command("bench.compare", str(file), str(file))
    assert done.returncode == 2
    assert "report.json" in done.stderr
    assert "Traceback" not in done.stderr


def test_quick_run_writes_a_report(tmp_path: Path) -> None:
    output = tmp_path / "report.json"
    done = command("bench", "--quick", "--alone", "--only", "against size, isosurface", "--output", str(output))
    assert done.returncode == 0, done.stderr
    report = json.loads(output.read_text(encoding="utf-8"))
    assert {"processor", "cores", "load", "limits", "versions"} <= set(report["machine"])
    names = [row["name"] for row in report["results"]]
    assert names
    assert all("isosurface" in name for name in names)
    assert all(row["seconds"]["clvol"] > 0 for row in report["results"])
    assert "128³/64³" in done.stdout


@pytest.mark.thorough
def test_errors_against_functions_that_are_known_are_those_of_scipy() -> None:
    done = command("bench.truth", "--quick", "--markdown")
    assert done.returncode == 0, done.stderr
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines()[2:]]
    errors = {(work, program): row[-1] for work, program, *row in rows}
    works = {work for work, _ in errors}
    assert len(works) == 4
    assert all(errors[work, "clvol"] == errors[work, "SciPy"] for work in works)


@pytest.mark.thorough
def test_ndimage_is_measured_beside_scipy_which_agrees(tmp_path: Path) -> None:
    output = tmp_path / "report.json"
    done = command("bench.ndimage", "--quick", "--only", "affine_transform", "--markdown", "--output", str(output))
    assert done.returncode == 0, done.stderr
    rows = json.loads(output.read_text(encoding="utf-8"))["results"]
    lines = done.stdout.splitlines()
    assert len(lines) == 2 + len(rows) == 2 + 7
    for line, row in zip(lines[2:], rows, strict=True):
        assert line.startswith(f"| {row['name']} | ")
        theirs, difference = next(iter(row["differs_by"].items()))
        assert row["times_as_fast_as"][theirs] == pytest.approx(row["seconds"][theirs] / row["seconds"]["clvol"])
        assert difference < (1e-12 if "float64" in row["name"] else 1e-5)


def test_small_calls_are_measured_beside_scipy() -> None:
    done = command("bench.small", "--quick", "--only", "shift", "--markdown")
    assert done.returncode == 0, done.stderr
    *table, last = done.stdout.splitlines()
    rows = [line.strip("| ").split(" | ") for line in table[2:]]
    assert len({row[1] for row in rows}) == len(rows) == 9
    assert all(row[0] == "shift" and float(row[2]) > 0 for row in rows)
    assert re.match(r"\d+ calls below 0.9; the lowest: ", last)


def test_drags_of_a_session_are_measured(tmp_path: Path) -> None:
    file = tmp_path / "volume.nrrd"
    clvol.write(clvol.phantoms.marschner_lobb(12), file)
    done = command("bench.drags", str(file), "--size", "64x48", "--seconds", "1", "--modes", "mip")
    assert done.returncode == 0, done.stderr
    _, head, row = done.stdout.splitlines()
    assert head.split()[:4] == ["mode", "width", "least", "step"]
    assert row.startswith("mip ")  # a busy machine may show too few pictures


def test_the_first_half_second_of_a_drag_does_not_count(capsys: pytest.CaptureFixture[str]) -> None:
    frames = [(0.1 * i, {"width": 64 if i > 5 else 32, "step": 2, "seconds": 0.01, "final": i == 20}, 2048) for i in range(21)]
    drags.report("mip", frames, (0.004, 0.005))
    drags.report("mean", frames[:6], (0.004, 0.005))
    counted, few = capsys.readouterr().out.splitlines()
    assert counted.split() == ["mip", "64", "64", "2", "10.0", "10.0", "2", "4", "5"]
    assert "0 of 6 pictures count" in few


@pytest.mark.parametrize(
    ("aim", "reached", "text"),
    [
        (ndimage.Aim(8), True, "≥ 8 ×"),
        (ndimage.Aim(12), False, "≥ 12 ×"),
        (ndimage.Aim(8, 0.2), True, "≥ 8 ×, ≤ 200 ms"),
        (ndimage.Aim(seconds=0.05), False, "≤ 50 ms"),
    ],
)
def test_goals_are_compared_with_measurements(aim: ndimage.Aim, reached: bool, text: str) -> None:
    row = {"seconds": {"clvol": 0.1, "SciPy": 1.0}, "times_as_fast_as": {"SciPy": 10.0}}
    assert aim.reached(row) is reached
    assert str(aim) == text


def test_samples_on_a_lattice_are_counted() -> None:
    volume = clvol.Volume(np.zeros((32, 32, 32), np.float32))
    straight = clvol.Camera.orbit(
        0, 0, projection="orthographic", zoom=4, fit="volume"
    )  # all rays hit, 64 samples each at a step of 1/2
    assert cases.samples_on_lattice(volume, straight, (16, 16), 0.5) == pytest.approx(16 * 16 * 64)
    # of as many as the volume holds: parallel rays, one a unit square
    oblique = clvol.Camera.orbit(20, 10, projection="orthographic", fit="volume")
    radius = np.linalg.norm(volume.corners[0] - volume.center)
    pixels = 256
    planes = Planes(volume, oblique.view(volume), 1.0, 1.0)
    along = abs(oblique.view(volume).forward[planes.axis])
    per_voxel = (pixels / (2 * radius)) ** 2 * along / planes.spacing
    assert cases.samples_on_lattice(volume, oblique, (pixels, pixels), 1.0) == pytest.approx(32**3 * per_voxel, rel=1e-2)


def test_scene_is_the_same_object_at_every_size() -> None:
    small, large = scene.head(32, as_device()), scene.head(64, as_device())
    halved = large.reshape(32, 2, 32, 2, 32, 2).mean((1, 3, 5))
    assert np.corrcoef(small.ravel(), halved.ravel())[0, 1] > 0.98
    assert scene.head(32, as_device(), "uint8").dtype == np.uint8


def test_roofline_names_the_limit_that_binds() -> None:
    limits = machine.Limits(copy=10.0, update=20.0, loads=100.0, multiply_adds=1000.0)
    assert limits.share(machine.Cost(bytes=2, loads=1, multiply_adds=10), 5.0) == (0.5, "bandwidth")
    assert limits.share(machine.Cost(bytes=1, loads=50), 1.0) == (0.5, "loads")


def test_parity_names_the_worst_filter_and_what_fails() -> None:
    def refused() -> Any:
        raise DeviceError("no images")

    row = parity.Row("taps", "value")
    row.add("a", lambda: (np.array([3e-6, 1e-6]), 1e-5))
    row.add("b", lambda: (np.array([4e-6]), 1e-4))
    assert (row.count, row.worst, row.most, row.tolerance, row.failed) == (2, "a", 3e-6, 1e-5, [])
    assert row.rms == pytest.approx(5**0.5 * 1e-6)
    row.add("c", lambda: (np.array([2e-5]), 1e-5))
    row.add("d", lambda: (np.array([np.nan, 0]), 1e-5))
    row.add("e", refused)
    assert row.count == 5
    assert row.failed == ["c: 2e-05", "d: nan", "e: no images"]


def test_parity_meets_every_filter_in_every_work() -> None:
    """By the route that a device takes; points by both routes that they have."""
    device: Any = SimpleNamespace(kind="cpu", has_images=True, sampler_bits=24.0)
    plan = [*parity.planned(device)]
    assert {work for route, work in plan if route == "planes"} == set(parity.MODES)
    assert {route for route, work in plan if work == "curvature"} == {"taps", "paired, images"}
    assert len(plan) == len(set(plan)) == 3 * len(parity.MODES) + 2 * len(parity.DERIVATIVES)
    device.has_images = False
    assert {route for route, _ in parity.planned(device)} == {"taps", "planes"}


def test_runtimes_of_another_system_are_found(tmp_path: Path) -> None:
    vendors = tmp_path / "etc/OpenCL/vendors"
    vendors.mkdir(parents=True)
    (tmp_path / "etc/os-release").write_text('NAME="x"\nPRETTY_NAME="Debian 99"\n')
    for name in ("mesa", "pocl", "rusticl"):
        (vendors / f"{name}.icd").write_text(f"lib{name}.so\n")
    found = [one for one in runtimes.found([tmp_path]) if one.root == tmp_path]
    assert [(one.name, one.library) for one in found] == [
        ("pocl, Debian 99", "libpocl.so"),
        ("rusticl, Debian 99", "librusticl.so"),
    ]
    found[0].lines = [{}, {"work": "mip", "count": 4, "failed": ["a"], "most": 2.0, "tolerance": 4.0}]
    assert found[0].result(("mip",)) == "3 of 4 (1 of 3 parts), 0.50"
    assert found[0].result(("mean",)) == "not reached"


def test_a_runtime_is_tried_without_pips_pocl(tmp_path: Path) -> None:
    """That is loaded whatever the environment says, and would be the device that is compared."""
    runtimes._without_pocl(tmp_path)
    code = "import pyopencl as cl; print(cl.__file__); cl.get_platforms()"
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "OCL_ICD_VENDORS": str(tmp_path), "OPENCL_VENDOR_PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.startswith(str(tmp_path))
    assert "PLATFORM_NOT_FOUND" in done.stderr, done.stdout + done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize("module", ["gpu", "runtimes"])
def test_kernels_are_compared_and_told_in_a_table(module: str) -> None:
    """On whatever device there is."""
    options = {"gpu": ["--only-parity"], "runtimes": ["--only", "pip"]}[module]
    done = command(f"bench.{module}", *options, timeout=3000)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "isosurface" in done.stdout


@pytest.mark.thorough
def test_a_short_soak_passes_and_detects_planted_faults(tmp_path: Path) -> None:
    output = tmp_path / "soak.json"
    done = command("bench.soak", "--minutes", "0.1", "--quick", "--output", str(output))
    report = json.loads(output.read_text(encoding="utf-8"))
    assert report["faults"] == [], done.stderr
    assert report["draws"] > report["catalogue"] > 30
    assert set(report["by_deed"]) <= set(DEEDS)
    assert {"buffers", "files"} <= {name for name, row in report["held"].items() if row["first"] > 0}
    # in so short a time caches still fill
    assert [name for name in ("descriptors", "threads", "files") if report["held"][name]["grew"]] == []


@pytest.mark.thorough
def test_a_short_soak_of_the_viewer_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("aiohttp")
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    output = tmp_path / "soak.json"
    done = command("bench.view_soak", "--minutes", "0.01", "--samples", "12", "--output", str(output))
    report = json.loads(output.read_text(encoding="utf-8"))
    assert report["faults"] == [], done.stderr
    assert report["counts"]["sent"] > 20
    assert report["counts"]["info"] == report["clients"] * report["rounds"]


@pytest.mark.parametrize(
    ("name", "step", "grew"), [("buffers", 0, False), ("buffers", 1, True), ("resident", 1e5, False), ("resident", 1e6, True)]
)
def test_growth_in_a_soak_is_reported(name: str, step: float, grew: bool) -> None:
    after_a_jump = [{name: 0.0}] * 15 + [{name: 1e8 + step * i} for i in range(45)]
    assert soak.grown(after_a_jump)[name]["grew"] is grew


class _Answers:
    """The reference process, which agrees."""

    def ask(self, *_: Any) -> tuple[str, bool]:
        return "done", False


@pytest.mark.parametrize(("seconds", "stuck"), [(1.2, False), (30.0, True)])
def test_a_soak_waits_for_finishing_work_and_reports_hangs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, seconds: float, stuck: bool
) -> None:
    """Work of 1.2 s begins before the last measurement, and ends after the time is over."""
    released = threading.Event()
    slow: list[int] = []  # the first thread

    def do(*_: Any) -> tuple[str, bool]:
        slow.append(threading.get_ident())
        if slow[0] == threading.get_ident():
            released.wait(seconds)
        return "done", False

    monkeypatch.setattr("bench.deeds.do", do)
    monkeypatch.setattr(soak, "_STUCK", 3)
    work = soak.Soak(SimpleNamespace(folder=tmp_path), _Answers(), {("deed", 0): "done"}, 0, 0.0)  # type: ignore[arg-type]
    samples = work.run(0.99, 2, soak.Buffers())
    released.set()
    assert (work.stuck, len(work.faults), len(samples)) == (stuck, int(stuck), int(not stuck))


def test_a_soak_covers_the_public_api() -> None:
    text = (ROOT / "bench/deeds.py").read_text(encoding="utf-8")
    assert [name for name in clvol.__all__ if not re.search(rf"\b(clvol\.{name}|{name}\.\w)", text) and name not in NOT_DONE] == []


@pytest.mark.thorough
def test_render_times_against_their_limit_are_measured(tmp_path: Path) -> None:
    done = command("bench.refine", "--quick", "--output", str(tmp_path / "report.json"))
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert all(0 <= row["kept"] <= 1 and 0 < row["median"] <= row["worst"] for row in report["kept"].values())
    assert all(0 < row["between_99"] <= row["between"] for row in report["asked"].values())
    assert len(report["asked"]) == 6
