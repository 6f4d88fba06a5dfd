"""The measured scene: a head as in a scan, the same object at any number of samples, computed by scene.cl."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.device import Device

__all__ = ["BONE", "OPAQUE", "TRANSLUCENT", "head"]

BONE = 1500.0  # the isovalue between soft matter and bone
SCALE = {"float32": 1.0, "uint16": 16.0, "uint8": 0.1}  # stored values per unit of the scene
_C_TYPES = {"float32": "float", "uint16": "ushort", "uint8": "uchar"}
_SLICES = 32  # a launch

# opacities of matter one voxel of a 256³ volume thick; colours of flesh and bone
_COLORS = ((0.0, (0.5, 0.2, 0.15)), (900.0, (0.85, 0.5, 0.38)), (1150.0, (0.9, 0.6, 0.45)), (1600.0, (0.98, 0.95, 0.85)))
OPAQUE = clvol.TransferFunction(_COLORS, ((300.0, 0.0), (700.0, 0.95)), 1.0)
TRANSLUCENT = clvol.TransferFunction(
    _COLORS, ((250.0, 0.0), (600.0, 0.025), (980.0, 0.012), (1150.0, 0.012), (1500.0, 0.20), (2200.0, 0.35)), 1.0
)


def head(n: int, device: Device, kind: str = "float32") -> NDArray[Any]:
    """The scene as an array of shape (n, n, n) of "float32", "uint16" or "uint8"."""
    import pyopencl as cl

    text = f"#define VALUE {_C_TYPES[kind]}\n" + (Path(__file__).parent / "scene.cl").read_text(encoding="utf-8")
    kernel = cl.Kernel(cl.Program(device.context, text).build(options=["-cl-std=CL1.2"]), "scene")
    data = np.empty((n, n, n), kind)
    least, most = (-1e6, 1e6) if kind == "float32" else (0, np.iinfo(kind).max)
    slices = min(n, _SLICES)
    buffer = device.buffers.allocate(data[:slices].nbytes)
    for first in range(0, n, slices):
        part = data[first : first + slices]
        scale, low, high = (np.float32(v) for v in (SCALE[kind], least, most))
        kernel(device.queue, (n, n, part.shape[0]), (math.gcd(n, 64), 1, 1), buffer, np.int32(n), np.int32(first), scale, low, high)
        device.buffers.download(buffer, part)
    buffer.release()
    return data
