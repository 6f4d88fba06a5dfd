"""No kernel touches a byte outside its buffers."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clvol.device import Device

PROGRAM = Path(__file__).with_name("guarded.py")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is guarded as Linux does it")


def run(device: Device, *arguments: str) -> subprocess.CompletedProcess[str]:
    if not device.is_pocl:
        pytest.skip("other runtimes copy memory that begins where their vectors may not, and other devices all")
    return subprocess.run([sys.executable, PROGRAM, *arguments], capture_output=True, encoding="utf-8", timeout=1800, check=False)


@pytest.mark.parametrize("side", [pytest.param("start", marks=pytest.mark.thorough), "end"])
def test_no_byte_outside_a_buffer_is_touched(device: Device, side: str) -> None:
    done = run(device, side)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-2000:]
    assert done.stdout.split()[-1] == "done"


@pytest.mark.thorough
@pytest.mark.parametrize("side", ["start", "end"])
def test_no_byte_outside_a_buffer_is_touched_by_any_kernel(device: Device, side: str) -> None:
    done = run(device, side, "all")
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-2000:]


@pytest.mark.parametrize("past", [0, 4, 16])
def test_four_bytes_past_a_buffer_are_detected(device: Device, past: int) -> None:
    done = run(device, "past", str(past))
    assert done.returncode == (-signal.SIGSEGV if past else 0), done.stderr
