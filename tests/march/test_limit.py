"""Measured memory of the process stays within the budget plus a small constant."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BUDGET = 12 << 20
BESIDE = 16 << 20
"""What pictures, rays, results, and samples that are made from a formula take beside the bricks."""

CHILD = r"""
import gc, json, sys
import numpy as np
import clvol

budget, edge, stored = int(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])


class Formula:
    dtype = np.dtype(np.float32)

    def __init__(self, n, chunks=None, step=1):
        self.shape, self.chunks, self.step = (n, n, n), chunks, step

    def __getitem__(self, at):
        if self.chunks is not None:  # whole chunks are made, as by what unpacks them
            whole = tuple(slice(s.start // c * c, min(-(-s.stop // c) * c, n)) for s, c, n in zip(at, self.chunks, self.shape))
        else:
            whole = at
        z, y, x = (np.arange(s.start, s.stop, dtype=np.float32) * self.step for s in whole)
        made = np.sin(x / 20) * np.cos(y / 25)[:, None] + np.sin(z / 30)[:, None, None]
        return made[tuple(slice(s.start - w.start, s.stop - w.start) for s, w in zip(at, whole))]


def peak():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) << 10 for line in status if line.startswith("VmHWM"))


def work(n, chunks):
    few = clvol.LazyVolume(Formula(n // 8, step=8), (8, 8, 8), limits=(-2, 2), labels=False)  # of which looks are decided
    volume = clvol.LazyVolume(Formula(n, chunks), limits=(-2, 2), labels=False, levels=[few])
    matter = clvol.TransferFunction(((-2, (1, 1, 1)), (2, (1, 0, 0))), ((-2, 0.0), (2, 0.01)))
    with clvol.BrickedField(volume, "linear", memory=budget, edge=edge) as field, clvol.Renderer(field) as renderer:
        look = {"size": (48, 48), "rays": 1, "step": 2.0, "lod": 0}
        renderer.render(mode="isosurface", isovalue=1.2, **look)
        renderer.render(mode="composite", transfer=matter, **look)
        field.resample((24, 24, 24))
        return field.reads.bricks * edge**3 * 4, field.reads.dropped


work(2 * edge, stored and [min(c, 2 * edge) for c in stored])  # kernels are built, and libraries are there
gc.collect()
with open("/proc/self/clear_refs", "w") as refs:
    refs.write("5")  # the peak is measured from here on
before = peak()
read, dropped = work(4 * edge, stored)
print(json.dumps({"grown": peak() - before, "read": read, "dropped": dropped}))
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux measures the peak")
@pytest.mark.parametrize(
    "stored", [pytest.param(None, marks=pytest.mark.thorough, id="parts"), pytest.param((1, 256, 256), id="planes")]
)
def test_pictures_and_grids_of_a_volume_many_times_the_budget(stored: tuple[int, ...] | None, tmp_path: Path) -> None:
    """256³ of float32 are 64 MiB; bricks take more with margins, and are read again for each of three results."""
    script = tmp_path / "child.py"
    script.write_text(CHILD, encoding="utf-8")
    command = [sys.executable, str(script), str(BUDGET), "64", json.dumps(stored)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout.splitlines()[-1])
    assert found["read"] > 12 * BUDGET
    assert found["dropped"] > 50
    assert found["grown"] < BUDGET + BESIDE, f"{found['grown'] >> 20} MiB"
