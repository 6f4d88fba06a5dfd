"""Measurements that need a new process: time to the first frame, and peak memory.

    python -m bench.fresh FILE
    python -m bench.fresh WHO N

FILE is a volume as a .npy file. Prints a JSON object: `seconds` from `Renderer` to the first frame, `bytes` by which the peak
rose since the imports. With WHO (see `LARGE`) and N it measures one cubic zoom from N³ to (2 N)³: its seconds, and the bytes by
which the peak rose above the memory with the input.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.device import as_device

__all__ = ["LARGE", "large", "run"]

Array = NDArray[np.float32]


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


def large(who: str, n: int) -> dict[str, float]:
    """A cubic zoom from n³ to (2 n)³ samples by one of `LARGE`, in a new process."""
    command = [sys.executable, "-m", "bench.fresh", who, str(n)]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return result


def _torch_trilinear(data: Array) -> object:
    torch = import_module("torch")
    interpolate = import_module("torch.nn.functional").interpolate
    return interpolate(torch.from_numpy(data)[None, None], scale_factor=2, mode="trilinear")


def _by_zoom(module: str) -> Callable[[Array], object]:
    zoom = import_module(module).zoom
    return lambda data: zoom(data, 2, order=3, mode="nearest", grid_mode=True)


def _by_resize() -> Callable[[Array], object]:
    """nnU-Net's call, which first converts its input to float64."""
    resize = import_module("skimage.transform").resize
    return lambda data: resize(data.astype(float), tuple(2 * n for n in data.shape), 3, mode="edge", anti_aliasing=False, clip=True)


LARGE: dict[str, Callable[[], Callable[[Array], object]]] = {
    "clvol": lambda: _by_zoom("clvol.ndimage"),
    "SciPy": lambda: _by_zoom("scipy.ndimage"),
    "scikit-image": _by_resize,
    "torch, trilinear": lambda: _torch_trilinear,
}


def _measure_large(who: str, n: int) -> dict[str, float]:
    run = LARGE[who]()
    run(np.zeros((8, 8, 8), np.float32))  # imports, and kernels built
    data = np.random.default_rng(0).standard_normal((n, n, n), np.float32)
    before = _peak("VmRSS")
    started = time.perf_counter()
    result = run(data)
    seconds = time.perf_counter() - started
    del result
    return {"seconds": seconds, "bytes": _peak() - before}


def _peak(what: str = "VmHWM") -> int:
    """The peak resident bytes; `ru_maxrss` only as a fallback, since it includes the parent before exec."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith(what))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _measure(file: str) -> dict[str, Any]:
    as_device().require_usable()  # PoCL's linker is tried once an installation
    before = _peak()
    data = np.load(file)
    started = time.perf_counter()
    clvol.Renderer(data).render(mode="isosurface", size=(512, 512), step=1.0, rays=1)
    seconds = time.perf_counter() - started
    return {"seconds": seconds, "bytes": _peak() - before, "volume": data.nbytes}


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1]) if len(sys.argv) == 2 else _measure_large(sys.argv[1], int(sys.argv[2]))))
