"""No kernel touches what lies before or after its buffers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from clvol.device import Device


@pytest.mark.skipif(sys.platform != "linux", reason="memory is guarded as Linux does it")
@pytest.mark.parametrize("side", ["start", "end"])
def test_nothing_past_a_buffer_is_touched(device: Device, side: str) -> None:
    if device.kind != "cpu":
        pytest.skip("memory of other devices is not guarded")
    program = Path(__file__).with_name("guarded.py")
    done = subprocess.run([sys.executable, program, side], capture_output=True, encoding="utf-8", timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == ["done"]
