"""Every function with large results rejects what does not fit, before any allocation."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

MIB = 1 << 20
ROOM = 1024  # MiB of the simulated container
GROWS = 64  # MiB by which a rejected call may grow the process: drivers, kernels and remains of previous calls

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits are read from /proc and /sys")

SET_UP = f"""
import json, resource, sys, time
from pathlib import Path
import numpy as np
import clvol
from clvol import images, ndimage, phantoms; from clvol.base import memory; from clvol.show import picture
from clvol.march.renderer import OUTPUTS

memory.ROOT = Path(sys.argv[1])  # a container of {ROOM} MiB
resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))  # should that fail, nothing else is hurt

def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024

small = clvol.Volume(np.random.default_rng(0).random((6, 7, 8), dtype=np.float32))
image = small.data[0]
huge = np.broadcast_to(np.float32(1), (1024, 1024, 1024))  # of no memory
points = np.broadcast_to(np.zeros(3, np.float32), (1 << 28, 3))
field = clvol.Field(small)
renderer = clvol.Renderer(small, "bspline3")
line = clvol.Interpolator((np.arange(8.0),), np.arange(8.0))
like = clvol.Volume(np.broadcast_to(np.float32(0), (1024, 1024, 1024)))
"""

CALLS = [
    "clvol.resample(small, (1, 1, 2**31 - 1))",
    "clvol.resample(small, (1, 1, 2**31))",
    "clvol.resample(small, (2**31 - 1,) * 3)",
    "clvol.resample(small, (2**40,) * 3)",
    "clvol.resample(small, (1024,) * 3)",
    "clvol.resample(small, spacing=0.005)",
    "clvol.resample(small, like=like)",
    "clvol.resample(small, like=like, transform=np.diag([1, 1, 1.01, 1]))",
    "clvol.resample(small, like=like, anti_aliasing='least-squares')",
    "clvol.resample(small, (1024,) * 3, precision='double')",
    "clvol.resample(huge, (8, 8, 8), precision='double')",  # bricks are of single precision
    "clvol.resample(huge, (8, 8, 8), precision='double', anti_aliasing=True)",
    "clvol.resample(np.broadcast_to(np.float32(1), (1, 2**27)), (1, 2**20), anti_aliasing=True)",
    "clvol.magnify(small, 200)",
    "clvol.magnify(small, 10**6)",
    "clvol.magnify(small, 2**40)",
    "field.magnify(200)",
    "field.resample((1024,) * 3)",
    "field(points)",
    "field.gradient(points)",
    "field.hessian(points)",
    "clvol.sample(small, points, derivative=2)",
    "clvol.sample(huge, np.zeros((1, 3)), precision='double')",
    "clvol.prefilter(huge)",
    "clvol.prefilter(np.broadcast_to(np.float32(1), 2**28))",
    "clvol.prefilter(np.broadcast_to(np.float32(1), 2**30 + 1))",
    "clvol.Field(huge)",
    "clvol.Field(huge, 'hybrid')",
    "clvol.Field(huge[:200, :200, :800], 'hybrid')",  # 128 MB of samples, eight times as many coefficients
    "clvol.Field(np.broadcast_to(np.float32(1), (1, 2**30 + 1)))",
    "clvol.warp(small, like)",
    "clvol.warp(small, clvol.Volume(like.data[:500, :500, :500]), derivative=1, jacobian=True)",
    "clvol.resample_series([small, small], [None, None], like)",
    "clvol.adjoint(np.zeros(1), np.zeros((1, 3)), (1024,) * 3)",
    "clvol.adjoint(points[:, 0], points, (4, 4, 4))",
    "clvol.resize(image, (2**16, 2**16))",
    "clvol.resize(image, (2**31 - 1, 2**31 - 1))",
    "images.resample(image, (2**16, 2**16))",
    "images.zoom(image, 5000)",
    "images.rotate(image, 10, shape=(2**16, 2**16))",
    "ndimage.zoom(small.data, 200)",
    "ndimage.zoom(image, (1, 2**28))",
    "ndimage.affine_transform(image, np.eye(2), output_shape=(2**16, 2**16))",
    "ndimage.affine_transform(image, np.eye(2), output_shape=(2**29, 2**29))",
    "ndimage.geometric_transform(image, lambda i: i, output_shape=(2**16, 2**16))",
    "ndimage.map_coordinates(small.data, points.T)",
    "ndimage.rotate(huge, 10)",
    "ndimage.shift(huge, 0.5)",
    "ndimage.spline_filter(huge)",
    "ndimage.spline_filter1d(huge)",
    "line(points[:, 0])",
    "clvol.Interpolator((np.arange(2.0**14), np.arange(2.0**14)), np.broadcast_to(1.0, (2**14, 2**14)))",
    "clvol.render(small, size=(32768, 32768))",
    "clvol.render(small, size=(32768, 32768), outputs=OUTPUTS)",
    "renderer.render(size=(32768, 32768))",
    "renderer.render(size=(8000, 8000), outputs=OUTPUTS)",
    "renderer.render(mode='isosurface', size=(8000, 8000), outputs='uncertainty')",
    "clvol.Volume(huge).filled(0)",
    "clvol.Volume(huge).indicator(1)",
    "clvol.Volume(huge).gaussian(1)",
    "clvol.Volumes([clvol.Volume(huge)] * 2)",
    "phantoms.marschner_lobb(1024)",
    "phantoms.sphere((2, 2**15, 2**15))",
    "phantoms.checker(1024)",
    "phantoms.by_name('box:1024')",
    "picture.grid([np.broadcast_to(np.uint8(0), (2**14, 2**14, 3))] * 4, 2)",
]

BY_BRICKS = [  # larger than the container, with coefficients or without
    "clvol.render(huge[:260], mode='isosurface', isovalue=2, size=(32, 32), boundary='zero')",
    "clvol.sample(huge, np.zeros((1, 3)))",
    "clvol.resample(huge[:300], (8, 8, 8), anti_aliasing=True)",
    "clvol.resample(huge[:300], (8, 8, 8), anti_aliasing='least-squares')",
]

RUN = """
answers = {}
for call in json.loads(sys.stdin.read()):
    before, begun = peak(), time.perf_counter()
    try:
        eval(call)
        said = "done"
    except Exception as error:
        said = f"{'OutOfMemoryError' if isinstance(error, clvol.base.errors.OutOfMemoryError) else type(error)}: {error}"
    answers[call] = said, peak() - before, time.perf_counter() - begun
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, float, float]]:
    import json

    root = tmp_path_factory.mktemp("container")
    for name, text in {
        "proc/meminfo": f"MemAvailable: {64 << 20} kB\n",
        "proc/self/cgroup": "0::/box\n",
        "proc/self/mountinfo": "30 23 0:28 / /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n",
        "sys/fs/cgroup/box/memory.max": f"{ROOM * MIB}\n",
        "sys/fs/cgroup/box/memory.current": "0\n",
    }.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", SET_UP + RUN, str(root)],
        input=json.dumps([*CALLS, *BY_BRICKS]),
        capture_output=True,
        encoding="utf-8",
        timeout=600,
        check=False,
        env={**os.environ, "POCL_EXTRA_BUILD_FLAGS": "", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, tuple[str, float, float]] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.parametrize("call", CALLS)
def test_results_that_do_not_fit_are_rejected_before_allocation(call: str, answers: dict[str, tuple[str, float, float]]) -> None:
    said, grown, seconds = answers[call]
    assert said.startswith("OutOfMemoryError: "), said
    assert grown < GROWS, f"{grown:.0f} MiB"
    assert seconds < 5


@pytest.mark.parametrize("call", BY_BRICKS)
def test_volumes_that_do_not_fit_go_by_bricks(call: str, answers: dict[str, tuple[str, float, float]]) -> None:
    said, grown, _ = answers[call]
    assert said == "done"
    assert grown < ROOM // 2 + 2 * GROWS, f"{grown:.0f} MiB"
