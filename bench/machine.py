"""The machine: its description, and its limits, measured by the loops of limits.cl."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from clvol.device import Device

__all__ = ["Cost", "Limits", "available_memory", "describe", "measure_limits"]

_PACKAGES = ("clvol", "numpy", "scipy", "pyopencl", "vtk", "drjit", "SimpleITK", "numba")
_LANES = 8  # of the vectors of limits.cl


@dataclass(frozen=True)
class Cost:
    """What one item of work takes at the least, whoever does it.

    Attributes
    ----------
    bytes : float
        To and from memory, every array once.
    loads : float
        Of vectors of up to four neighbouring floats, from the nearest cache.
    multiply_adds : float
        Of single floats.
    """

    bytes: float = 0.0
    loads: float = 0.0
    multiply_adds: float = 0.0


@dataclass(frozen=True)
class Limits:
    """Rates per second of all cores together."""

    copy: float  # bytes read and written, from one array to another
    update: float  # the same in place: the written memory needs no separate read
    loads: float  # vectors of four floats from the nearest cache
    multiply_adds: float  # single floats

    def best(self, other: Limits) -> Limits:
        """The elementwise maximum."""
        return Limits(*(max(a, b) for a, b in zip(astuple(self), astuple(other), strict=True)))

    def share(self, cost: Cost, items_per_second: float) -> tuple[float, str]:
        """The rate as a fraction of the binding limit, and the name of that limit: the roofline."""
        bounds = {
            "bandwidth": cost.bytes / max(self.copy, self.update),
            "loads": cost.loads / self.loads,
            "multiply-adds": cost.multiply_adds / self.multiply_adds,
        }
        name = max(bounds, key=bounds.__getitem__)
        return items_per_second * bounds[name], name


def measure_limits(device: Device) -> Limits:
    """The best of several runs of each loop; about two seconds."""
    import pyopencl as cl

    text = (Path(__file__).parent / "limits.cl").read_text(encoding="utf-8")
    built = cl.Program(device.context, text).build(options=["-cl-std=CL1.2"])
    cpu = device.kind == "cpu"
    local = (1,) if cpu else (64,)  # PoCL keeps variables of several work-items in memory, not in registers
    workers = int(device.handle.max_compute_units) * (8 if cpu else 2048)

    def best(work: Callable[[], Any]) -> float:
        times = []
        for _ in range(7):
            started = time.perf_counter()
            work()
            device.finish()
            times.append(time.perf_counter() - started)
        return min(times[1:])

    length = 1024 if cpu else 1
    blocks = (1 << 28) // (4 * _LANES * length)  # 256 MiB, far more than any cache
    size = 4 * _LANES * length * blocks
    source, target = device.buffers.allocate(size), device.buffers.allocate(size)
    move = cl.Kernel(built, "move")
    copied = best(lambda: move(device.queue, (blocks,), local, source, target, np.int32(length)))
    updated = best(lambda: move(device.queue, (blocks,), local, source, source, np.int32(length)))
    source.release()
    target.release()

    result, rows = device.buffers.allocate(4 * _LANES * workers), device.buffers.upload(np.zeros(4096, np.int32))
    added, loaded = cl.Kernel(built, "multiply_add"), cl.Kernel(built, "load_rows")
    turns = 200_000 if cpu else 2_000
    fma = best(lambda: added(device.queue, (workers,), local, result, np.int32(turns)))
    passes = 2_000 if cpu else 20
    load = best(lambda: loaded(device.queue, (workers,), local, rows, result, np.int32(passes)))
    result.release()
    return Limits(2 * size / copied, 2 * size / updated, workers * passes * 1024 / load, workers * turns * 12 * _LANES / fma)


def describe(device: Device) -> dict[str, Any]:
    """Processor, cores and versions, for the results."""
    return {
        "processor": device.name,
        "platform": device.platform,
        "kind": device.kind,
        "cores": os.cpu_count(),
        "compute_units": int(device.handle.max_compute_units),
        "memory": available_memory(),
        "opencl": str(device.handle.platform.version),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def available_memory() -> int:
    """Bytes available without swapping; 0 if unknown."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable")), 0)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
