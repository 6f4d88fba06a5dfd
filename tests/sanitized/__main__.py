"""Runs kernels at the limits of memory and numbers, sanitized: `python -m tests.sanitized few|all|far|fault NAME`.

test_sanitized.py runs this, in an environment that loads the sanitizer (runtime.environment).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.sanitized import runtime

_FAULTS = """
kernel void overrun(global float *given, const int at) { given[at] = 1.0f; }
kernel void overflow(global int *given, const int by) { given[0] = by * 65536; }
kernel void convert(global int *given, const float from) { given[0] = (int)from; }
"""
FAULTS: dict[str, tuple[Any, ...]] = {"overrun": (np.int32(5),), "overflow": (np.int32(65536),), "convert": (np.float32(3e9),)}


def fault(name: str) -> None:
    """Faults that sanitizers must detect: four bytes past a buffer of five numbers; an overflowing product and conversion."""
    kernel = runtime.Kernel(runtime.Program(None, _FAULTS).build(), name)
    kernel(None, (1,), None, runtime.Buffer(None, 0, 20), *FAULTS[name])


# -- volumes of more than 2**31 voxels -------------------------------------------------------------------------------

LONG = 262_144, 80, 90  # 7.5 GB, of which only the last slices are touched
SHORT = 48, 80, 90
LAST = 40  # slices of them


def last_slices(runs: Callable[..., None]) -> Callable[..., None]:
    """Launches along the slices of the long volume take only the last."""

    def run(self: runtime.Kernel, queue: Any, sizes: Any, local: Any, *given: Any, global_offset: Any = None) -> None:
        first = [*(global_offset or [0] * len(sizes))]
        last = [*sizes]
        if len(last) > 1 and last[-1] > 8 * LAST:
            first[-1], last[-1] = last[-1] - LAST, LAST
        runs(self, queue, last, local, *given, global_offset=first)

    return run


def far() -> None:
    """The far corner of a volume whose voxels overflow int, and whose bytes overflow 32 bits, equals that of a short one."""
    from tests import edges

    runtime.Kernel.__call__ = last_slices(runtime.Kernel.__call__)  # type: ignore[method-assign]
    import clvol

    plane = edges.noise(*LONG[1:])
    long, short = (np.broadcast_to(plane, shape) for shape in (LONG, SHORT))
    shift = np.array([0, 0, LONG[0] - SHORT[0]])
    points: NDArray[np.float64] = np.random.default_rng(0).uniform((0, 0, SHORT[0] - 12), (89, 79, SHORT[0] + 3), (200, 3))
    for name in ("linear", "bspline3-approx"):
        with clvol.Field(long, name, "nearest") as far, clvol.Field(short, name, "nearest") as near:
            assert far.coefficients.buffer.size > 1 << 33
            for derivative in (0, 1):
                got = far(points + shift) if derivative == 0 else far.gradient(points + shift)
                want = near(points) if derivative == 0 else near.gradient(points)
                np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)


def main(what: str, *more: str) -> None:
    runtime.install()
    from tests import edges

    if what == "fault":
        fault(more[0])
    elif what == "far":
        far()
    else:
        edges.run({"few": edges.FEW, "all": edges.ALL}[what])
    print("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
