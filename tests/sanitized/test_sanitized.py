"""Kernels compiled with clang's address and undefined-behaviour sanitizers run without a report."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.sanitized import runtime

ROOT = Path(__file__).parents[2]


def run(*what: str, seconds: float = 600) -> tuple[int, str]:
    """Exit status and output of a process that runs sanitized kernels."""
    compiler = runtime.clang()
    if compiler is None:
        message = "clang 14 or later with its sanitizers is not installed (Debian: apt install clang-14 libclang-rt-14-dev)"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    environment = runtime.environment(compiler)
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "src"), environment.get("PYTHONPATH", "")])
    # to a file: after a report the sanitizer's own helper may outlive the process, and would keep a pipe open
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.sanitized", *what],
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            cwd=ROOT,
            start_new_session=True,
        )
        try:
            status = process.wait(seconds)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        output.seek(0)
        return status, output.read()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("overrun", ["heap-buffer-overflow", "overrun"]),
        ("overflow", ["signed integer overflow: 65536 * 65536"]),
        ("convert", ["outside the range of representable values of type 'int'"]),
    ],
)
def test_faults_are_detected(fault: str, words: Sequence[str]) -> None:
    status, output = run("fault", fault, seconds=120)
    assert status != 0
    for each in words:
        assert each in output


def test_kernels_are_clean_at_the_edges() -> None:
    status, output = run("few")
    assert status == 0, output[-4000:]
    assert output.splitlines()[-1] == "done"


@pytest.mark.thorough
def test_all_kernels_are_clean_at_the_edges() -> None:
    status, output = run("all", seconds=3000)
    assert status == 0, output[-4000:]


@pytest.mark.thorough
def test_the_far_corner_of_a_volume_of_more_than_2_31_voxels() -> None:
    status, output = run("far", seconds=1200)
    assert status == 0, output[-4000:]
