"""Runs kernels in Oclgrind: `python simulated.py [race|past]`, in the environment that test_oclgrind.py makes."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pyopencl as cl

import clvol
from clvol.device import as_device

sys.path.append(str(Path(__file__).parents[1]))
from tests import edges

_FAULTS = """
kernel void race(global int *to) { to[0] = get_global_id(0); }
kernel void past(global int *to) { to[2 + get_global_id(0)] = 1; }
"""


def fault(name: str) -> None:
    device = as_device()
    kernel = cl.Kernel(cl.Program(device.context, _FAULTS).build(), name)
    kernel(device.queue, (2,), (1,), device.buffers.allocate(8))
    device.finish()


def kinds() -> None:
    """A kernel of each kind, at the smallest sizes: Oclgrind takes a second for what PoCL does in a millisecond."""
    data = edges.noise(3, 5, 6)
    at = np.random.default_rng(0).uniform(-1, 5, (9, 3))
    for name in ("linear", "bspline3"):
        for derivative in (0, 1):
            clvol.sample(data, at, name, derivative=derivative)
        clvol.resample(data, (4, 6, 7), filter=name)
        for mode in ("mip", "composite", "isosurface"):
            clvol.render(data, mode=mode, size=(5, 4), filter=name)


def main(name: str = "") -> None:
    if name:
        fault(name)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", clvol.ClvolWarning)  # of noise that looks empty
            kinds()
    print("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
