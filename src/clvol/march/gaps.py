"""Where a volume's samples are missing, for the ray loop: the host side of missing.cl."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.uniform import INT, Block
from clvol.spline.lease import release

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.bricks.continued import Absent
    from clvol.device import Device

__all__ = ["GAPS", "Gaps", "gaps_block"]

GAPS = Block("gaps_block", first=(INT, 3), cubes=(INT, 3))
_RIM = 2  # samples beyond a brick, and beyond those a step away


class Gaps:
    """The missing samples of a 3-D volume, `where`, [z, y, x]; and on the device, once a picture in memory needs them."""

    def __init__(self, where: NDArray[np.bool_] | Absent, device: Device) -> None:
        self.where, self._device = where, device
        self._buffer: Any = None

    @property
    def buffer(self) -> Any:
        """The cubes of the whole volume."""
        if self._buffer is None:
            self._buffer, _ = self.part((0,) * 3, self.where.shape[::-1], 0.0)
        return self._buffer

    def part(self, low: tuple[float, ...], high: tuple[float, ...], step: float) -> tuple[Any, Values]:
        """The cubes around positions between two corners, (x, y, z) in samples, and the block that says which.

        Rays are followed one step further.
        """
        sizes, rim = self.where.shape[::-1], _RIM + step
        first = [int(max(0.0, a - rim)) for a in low]
        past = [int(min(float(n), b + rim + 1)) for b, n in zip(high, sizes, strict=True)]
        cubes = _cubes(self.where, first, past)
        return self._device.buffers.upload(cubes), GAPS(first=first, cubes=cubes.shape[::-1])

    def release(self) -> None:
        """Free the device's memory."""
        buffer, self._buffer = self._buffer, None
        release(self._device, buffer)


def gaps_block(gaps: Gaps | None) -> Values:
    """The ray loop's parameters of a whole volume's missing samples."""
    return GAPS(first=0, cubes=[n + 1 for n in gaps.where.shape[::-1]] if gaps else 0)


def _cubes(where: NDArray[np.bool_] | Absent, first: list[int], past: list[int]) -> NDArray[np.uint8]:
    """A byte for each cube between neighbours of samples from `first` to before `past`, and for those before and after them."""
    memory.require(4 * math.prod(b - a for a, b in zip(first, past, strict=True)), "where samples are missing")
    # samples beyond the part are those of the volume, and beyond its faces those on them
    before = [(1 if a == 0 else 0, 1 if b == n else 0) for a, b, n in zip(first[::-1], past[::-1], where.shape, strict=True)]
    inner = tuple(slice(max(a - 1, 0), min(b + 1, n)) for a, b, n in zip(first[::-1], past[::-1], where.shape, strict=True))
    bits: NDArray[np.uint8] = np.pad(where[inner].view(np.uint8), before, mode="edge")
    for axis, shift in ((2, 1), (1, 2), (0, 4)):
        lines = np.moveaxis(bits, axis, 0)
        bits = np.moveaxis(lines[:-1] | lines[1:] << np.uint8(shift), 0, axis)
    return np.ascontiguousarray(bits)
