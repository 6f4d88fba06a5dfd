"""What only a new process shows: how long the first frame takes, and the most memory ever held.

    python -m bench.fresh FILE

FILE is a volume as a .npy file. Prints a JSON object: `seconds` from `Renderer` to the first frame, `bytes` that the peak
rose by, from after the imports.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import clvol
from clvol.device import as_device

__all__ = ["run"]


def run(volume: Path, cache: Path) -> dict[str, float]:
    """Measure in a new process, with all kernel caches in the folder `cache`."""
    environment = {
        **os.environ,
        "XDG_CACHE_HOME": str(cache),
        "POCL_CACHE_DIR": str(cache / "pocl"),
        "CUDA_CACHE_PATH": str(cache / "cuda"),
    }
    (cache / "pocl").mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "bench.fresh", str(volume)]
    here = Path(__file__).parents[1]
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, timeout=300, check=True)
    result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return result


def _peak() -> int:
    """The most bytes ever resident; not `ru_maxrss` where it can be had otherwise: that counts the parent before exec."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _measure(file: str) -> dict[str, Any]:
    as_device().require_usable()  # PoCL's linker is tried once an installation
    before = _peak()
    data = np.load(file)
    started = time.perf_counter()
    clvol.Renderer(data).render(mode="isosurface", size=(512, 512), step=1.0)
    seconds = time.perf_counter() - started
    return {"seconds": seconds, "bytes": _peak() - before, "volume": data.nbytes}


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1])))
