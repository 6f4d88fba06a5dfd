"""Results do not depend on the number of cores or on how work is split."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import clvol
from clvol.device import Device
from clvol.march.frame import BY_PLANES, BY_RAYS

_HASHES = """
import hashlib, numpy as np, clvol
data = np.random.default_rng(0).standard_normal((9, 40, 21)).astype(np.float32)
points = np.random.default_rng(1).uniform(-3, 45, (3000, 3))
device = clvol.device.as_device()
made = clvol.sample(data, points), clvol.prefilter(data), clvol.render(data, size=(40, 33))
print(device.units, *(hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest() for a in made))
"""


def test_results_do_not_depend_on_the_number_of_cores(device: Device) -> None:
    if not device.is_pocl:
        pytest.skip("how many cores it takes is told to PoCL")
    seen = {}
    for cores in ("1", "3"):
        environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": cores, "CLVOL_DEVICE": "portable"}
        done = subprocess.run(
            [sys.executable, "-c", _HASHES], env=environment, capture_output=True, encoding="utf-8", timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
        units, *hashes = done.stdout.split()
        seen[units] = hashes
    assert len(seen) == 2  # the number of cores
    assert len({tuple(hashes) for hashes in seen.values()}) == 1


def test_results_do_not_depend_on_how_work_is_split(device: Device) -> None:
    data = np.random.default_rng(0).standard_normal((9, 40, 21)).astype(np.float32)
    points = np.random.default_rng(1).uniform(-3, 45, (3000, 3))
    made = []
    for limits in ({}, {"launch_seconds": 1e-6, "launch_voxels": 1, "launch_taps": 1, "sorted_bytes": 1}):
        with device.limited(**limits):
            made.append((clvol.sample(data, points, device=device), clvol.prefilter(data, device=device),
                         clvol.magnify(data, 2, device=device).data, clvol.render(data, size=(40, 33), device=device)))  # fmt: skip
    for got, want in zip(*made, strict=True):
        np.testing.assert_array_equal(got, want)


def test_tiles_of_rays_agree(device: Device) -> None:
    """Within rounding: a plane is blended where it fits a tile, otherwise samples are read one by one."""
    data = np.random.default_rng(0).standard_normal((9, 40, 21)).astype(np.float32)
    made = []
    for tile in (BY_PLANES, BY_PLANES._replace(width=8, height=8), BY_RAYS):
        with device.limited(tile=tile):
            made.append(clvol.render(data, mode="mip", size=(40, 33), device=device))
    for other in made[1:]:
        np.testing.assert_allclose(other, made[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_constants_are_reproduced_up_to_the_limits_of_every_type(device: Device, kind: str) -> None:
    """Interpolating splines reproduce them within one rounding of float32 (or float64, where samples need it)."""
    type_ = np.dtype(kind)
    ends = [np.finfo(type_).max, np.finfo(type_).min] if type_.kind == "f" else [np.iinfo(type_).max, np.iinfo(type_).min]
    points = np.random.default_rng(2).uniform(0, 4, (20, 3))
    for end in ends:
        got = clvol.sample(np.full((5, 6, 7), end, type_), points, device=device)
        np.testing.assert_allclose(got, float(end), rtol=1e-6)
