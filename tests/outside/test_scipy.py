"""SciPy's own tests of interpolation and of spline filters, on `clvol.ndimage`: see scipy_plugin.py."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from clvol.device import Device, devices

TESTS = ("scipy.ndimage.tests.test_interpolation", "scipy.ndimage.tests.test_splines")
DEPARTURES: dict[str, str] = {}
"""By the test's name, why it does not hold; none is a wrong value."""
AT_LEAST = 900  # of 1,009 in SciPy 1.17; fewer would mean that they were not found


@pytest.mark.parametrize("step", [13, pytest.param(1, marks=pytest.mark.thorough)])
def test_scipys_own_tests_pass(device: Device, tmp_path: Path, step: int) -> None:
    if importlib.util.find_spec("scipy.ndimage.tests") is None:
        pytest.skip("this SciPy was packaged without its tests")
    number = next(i for i, one in enumerate(devices()) if (one.platform, one.name) == (device.platform, device.name))
    paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "CLVOL_DEVICE": str(number), "EVERY": str(step)}
    environment.pop("PYTEST_ADDOPTS", None)
    options = ["-p", "scipy_plugin", "-p", "no:cacheprovider", "--junit-xml", "report.xml"]
    command = [sys.executable, "-m", "pytest", "-q", *options, "--pyargs", *TESTS]
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert (tmp_path / "report.xml").exists(), run.stdout + run.stderr
    cases = ET.parse(tmp_path / "report.xml").findall(".//testcase")
    failed = [case.get("name") for case in cases if case.find("failure") is not None or case.find("error") is not None]
    skipped = [case.get("name") for case in cases if case.find("skipped") is not None]
    assert {str(name).partition("[")[0] for name in failed} == set(DEPARTURES), run.stdout[-4000:]
    assert run.returncode == bool(DEPARTURES), run.stdout + run.stderr
    assert len(cases) - len(skipped) >= AT_LEAST // step, (len(cases), skipped[:9])
