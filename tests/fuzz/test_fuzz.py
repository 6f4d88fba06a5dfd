"""Mutants of every format, the same in every run; ``make fuzz`` continues with others."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError
from tests.cases import examples
from tests.fuzz.found import FOUND

ROOT = Path(__file__).resolve().parents[2]
FEW = examples(60)  # mutants of a format that a child process reads, or whose reader is slow
MANY = examples(360)  # of the others
CALLS = examples(3000)
QUICK = ("npy", "npz", "nii", "nii.gz", "hdr", "mgh", "mgz", "raw", "mrc", "vtk", "nc3")
OTHERS = (
    "nrrd",
    "nhdr",
    "mha",
    "mhd",
    "dcm",
    "tiff",
    "tiff-packed",
    "png",
    "jpg",
    "bmp",
    "h5",
    "nc",
    "ims",
    "vti",
    "zarr",
    "zarr.zip",
    "mnc",
    "img",
)

forks = pytest.mark.skipif(not hasattr(os, "fork") or sys.platform == "darwin", reason="limits are set, and kept, as Linux does it")


@forks
@pytest.mark.parametrize(
    ("formats", "count"), [(QUICK, MANY), (OTHERS, FEW), (("calls",), CALLS)], ids=["quick", "others", "calls"]
)
def test_no_promise_is_broken(tmp_path: Path, formats: tuple[str, ...], count: int) -> None:
    results = tmp_path / "results.json"
    command = [sys.executable, "-m", "tests.fuzz", *formats, "--count", str(count), "--results", str(results)]
    paths = os.pathsep.join([str(ROOT), *sys.path])
    run = subprocess.run(
        [*command, "--keep", str(tmp_path / "kept")],
        capture_output=True,
        encoding="utf-8",
        check=False,
        timeout=600,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": paths},
    )
    assert run.returncode == 0, run.stdout + run.stderr
    rows = json.loads(results.read_text())
    assert sum(row["tried"] for row in rows) == count * len(rows) > 0
    assert all(row["refused"] > 0 for row in rows), run.stdout
    # of a format whose checksums cover all of a file, every mutant of a few may be rejected
    assert np.mean([row["accepted"] > 0 for row in rows]) >= 0.8, run.stdout


@pytest.mark.parametrize(("name", "harm", "content"), FOUND, ids=[f"{n}: {harm}" for n, harm, _ in FOUND])
def test_files_found_before_are_rejected(tmp_path: Path, name: str, harm: str, content: str) -> None:  # noqa: ARG001  # it is in the id
    if not name.endswith((".npy", ".npz", ".png", ".jpg", ".bmp")):
        need = {".vti": "xml", ".h5": "h5py", ".nc": "h5py", ".tif": "tifffile", ".mha": "SimpleITK", ".nrrd": "SimpleITK"}
        pytest.importorskip(next((module for suffix, module in need.items() if name.endswith(suffix)), "SimpleITK"))
    if name.endswith(".zip"):
        pytest.importorskip("zarr")
    (tmp_path / name).write_bytes(zlib.decompress(base64.b85decode(content)))
    with pytest.raises(FormatError):
        clvol.read_all(tmp_path / name)
