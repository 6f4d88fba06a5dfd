"""Kernels in Oclgrind, which watches every access of every work-item; skipped where it or the system's loader is missing."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = Path(__file__).with_name("simulated.py")
_RUNTIME = Path("/usr/lib/oclgrind/liboclgrind-rt-icd.so")  # of Debian's package
_LOADER = ctypes.util.find_library("OpenCL")  # pip's loader would bring its PoCL along
_REPORTS = "data race", "Invalid ", "FATAL"

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(not (_RUNTIME.is_file() and _LOADER), reason="Oclgrind is not installed")]


def run(*arguments: str) -> str:
    environment = {**os.environ, "LD_PRELOAD": str(_LOADER), "OCL_ICD_VENDORS": str(_RUNTIME), "OCLGRIND_DATA_RACES": "1"}
    command = [sys.executable, str(_PROGRAM), *arguments]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=1800, check=False, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split()[-1] == "done"
    return done.stdout + done.stderr


def test_no_kernel_races_or_leaves_its_buffers() -> None:
    said = run()
    assert not [line for line in said.splitlines() if any(report in line for report in _REPORTS)]


@pytest.mark.parametrize(("fault", "report"), [("race", "data race"), ("past", "Invalid write")])
def test_a_race_and_a_write_past_a_buffer_are_reported(fault: str, report: str) -> None:
    assert report in run(fault)
