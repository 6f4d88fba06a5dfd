"""What bricks need of memory, by the length of their edges, and the longest one for a budget; nothing is allocated here."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.bricks.chunks import UNPACKING
from clvol.bricks.grid import ALIGNED

__all__ = ["LEAST", "Needs", "edge_for", "too_small"]

EDGES = (256, 128, 64, 32)  # samples along an edge of a brick that are tried, longest first
LEAST = EDGES[-1]
_SEVERAL = 8  # bricks that should fit into the budget
_KEPT = 4  # unpacked chunks take at most 1 / _KEPT of the budget
_KEPT_LONG = 2  # the same where chunks reach through several bricks


@dataclass(frozen=True)
class Needs:
    """Bytes that bricks of a volume need.

    Attributes
    ----------
    size : tuple of int
        Samples of the volume along x, y and z.
    itemsize : int
        Bytes of a sample.
    margin : int
        Samples around a brick that are read for it.
    wraps : bool
        Whether bricks reach outside the volume's faces.
    coefficients : callable
        Bytes of the coefficients of so many samples along x, y and z.
    lines : sequence of ndarray, optional
        Where chunks begin along z, y and x, and where the last one ends; None where any part is read as fast.
    chunk : int
        Bytes of the largest chunk, which is unpacked as a whole.
    reading : callable, optional
        Bytes that reading so many samples along z, y and x takes, where they are computed from others.
    """

    size: tuple[int, ...]
    itemsize: int
    margin: int
    wraps: bool
    coefficients: Callable[[tuple[int, ...]], int]
    lines: Sequence[NDArray[np.int64]] | None = None
    chunk: int = 0
    reading: Callable[[Sequence[int]], int] | None = None

    def samples(self, edge: int) -> tuple[int, ...]:
        """Samples along the edges of a brick with its margins, at most."""
        around = 2 * self.margin + ALIGNED
        if self.wraps:
            return tuple(min(n, edge) + around for n in self.size)
        return tuple(min(n, edge + around) for n in self.size)

    def buffer(self, edge: int) -> int:
        """Bytes of a brick's coefficients, at most: one buffer."""
        return self.coefficients(self.samples(edge))

    def resident(self, edge: int) -> int:
        """Bytes of a brick with its samples and bounds, at most."""
        return int(self.buffer(edge) * 1.1) + math.prod(self.samples(edge)) * (1 + self.itemsize)

    def read(self, edge: int) -> int:
        """Bytes of a brick while it is read, at most, with all that reading takes."""
        size = self.samples(edge)
        reading = math.prod(size) * self.itemsize + UNPACKING * self.chunk if self.reading is None else self.reading(size[::-1])
        return max(self.resident(edge), reading)

    def long_chunks(self, edge: int) -> tuple[bool, ...]:
        """Along which axes, x first, chunks are longer than bricks."""
        if self.lines is None:
            return False, False, False
        return tuple(int(np.diff(line).max()) > edge for line in self.lines[::-1])

    def layer(self, edge: int) -> int:
        """Bytes of the chunks, at most, that a layer of bricks reaches into: if all are kept, each is unpacked once.

        The layer lies across an axis along which chunks are no longer than bricks.
        """
        if self.lines is None:
            return 0
        lengths = []
        for line in self.lines[::-1]:
            ends = np.arange(0, line[-1], edge)
            low, high = np.maximum(ends - self.margin - ALIGNED, 0), np.minimum(ends + edge + self.margin, line[-1])
            lengths.append(int((line[np.searchsorted(line, high, "left")] - line[np.searchsorted(line, low, "right") - 1]).max()))
        across = [axis for axis, long in enumerate(self.long_chunks(edge)) if not long] or [0, 1, 2]
        return max(self.itemsize * math.prod(self.size) // self.size[axis] * lengths[axis] for axis in across)

    def chunks_kept(self, edge: int, budget: int) -> int:
        """Bytes of unpacked chunks to keep, at most."""
        if any(self.long_chunks(edge)):
            return min(math.prod(self.size) * self.itemsize, budget // _KEPT_LONG)
        return min(self.layer(edge), budget // _KEPT)


def edge_for(
    needs: Needs, budget: int, largest: int, chunks: Sequence[int] | None = None, *, in_memory: bool = False
) -> int | None:
    """The longest edge of bricks of which several fit into a budget, in whole chunks if that can be; None if none fits.

    Parameters
    ----------
    needs : Needs
    budget : int
        Bytes.
    largest : int
        Bytes of the largest buffer that the device allows.
    chunks : sequence of int, optional
        Samples along x, y and z of a chunk.
    in_memory : bool
        Whether one brick may be all of the volume: samples in memory cost nothing to read, and one brick has no margins.
    """
    everything = needs.coefficients(needs.size)
    if in_memory and not needs.wraps and everything <= largest and needs.resident(max(needs.size)) <= budget:
        return max(8, *needs.size)
    # of a volume that does not fit as a whole short ones are read more selectively: measured for shells in 1024³
    edges = EDGES if everything < budget else EDGES[1:]
    for kept, several, edge in itertools.product((True, False), (_SEVERAL, 2, 1), edges):
        beside = needs.layer(edge) if kept and any(needs.long_chunks(edge)) else 0
        taken = (several - 1) * needs.resident(edge) + needs.read(edge) + beside
        if taken <= budget and beside <= budget // _KEPT_LONG and needs.buffer(edge) <= largest:
            common = math.lcm(*(chunks or (1,)))
            return edge // common * common or edge
    return None


def too_small(needs: Needs, edge: int, budget: int) -> OptionError:
    """The error that a budget does not hold a brick."""
    why = f"a brick of {edge}³ samples takes"
    if needs.read(edge) > needs.resident(edge):
        why = f"reading {why}" + (f" with its chunk of {needs.chunk} bytes" if needs.chunk else ", low-passed")
    return OptionError(f"memory must be at least {needs.read(edge)} bytes, which {why}; got {budget}")
