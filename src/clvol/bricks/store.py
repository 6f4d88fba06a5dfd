"""The bricks of a volume: their samples are read, and their coefficients kept on the device, within a budget."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, OutOfMemoryError
from clvol.bricks.chunks import Chunks
from clvol.bricks.reduced import Reduced
from clvol.bricks.residents import Reads, Resident, Residents
from clvol.bricks.source import known_of, may_be_read_ahead
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.spline.coefficients import Coefficients, bytes_of
from clvol.spline.levels import gathered
from clvol.spline.minmax import bytes_beside
from clvol.spline.regions import require_labels
from clvol.spline.resample import filled
from clvol.volume.stored import names_beyond, too_large_names

if TYPE_CHECKING:
    from clvol.bricks.budget import Needs
    from clvol.bricks.grid import Brick, BrickGrid
    from clvol.bricks.residents import Account
    from clvol.bricks.source import Box, LazyVolume
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.reduce import Sums
    from clvol.volume.stored import Stored
    from clvol.volume.volume import Volume

__all__ = ["Part", "Store", "require_distinct_labels"]

Part: TypeAlias = tuple[tuple[slice, ...], NDArray[Any], float]
"""Where values of a grid belong, the values, and the fraction done with them."""


class Store:
    """The bricks of a volume, read when they are needed and evicted when others need their room.

    Parameters
    ----------
    volume : LazyVolume
        What is read.
    filter, boundary, device, stored
        Of the coefficients.
    grid : BrickGrid
    needs : Needs
        What bricks take.
    account : Account
        The budget, which stores may share.
    names : bool
        Whether samples are labels that kernels distinguish, whatever the filter: others are refused when they are read.

    Attributes
    ----------
    account : Account
    reads : Reads
        What was read until now.
    """

    def __init__(
        self,
        volume: LazyVolume,
        filter: Filter,
        boundary: Boundary,
        device: Device,
        stored: Stored,
        grid: BrickGrid,
        needs: Needs,
        account: Account,
        *,
        names: bool = False,
    ) -> None:
        self._names = names
        self._volume, self._filter, self._device, self._stored, self._grid = volume, filter, device, stored, grid
        # bricks that reach outside the volume's faces hold the samples there
        self._boundary = as_boundary(DEFAULT_BOUNDARY) if grid.wraps else boundary
        self.account, self.reads = account, Reads()
        self._chunks = None if needs.lines is None else _chunks_of(volume, needs, grid.edge, account)
        everything = len(grid) * needs.resident(grid.edge)
        self._residents = Residents(account, self.reads, self._chunks, chunks_first=everything <= account.budget)

    @property
    def nbytes(self) -> int:
        """Bytes of resident bricks, of bricks that are being read, of samples read ahead, and of chunks."""
        return self._residents.nbytes

    # -- bricks ------------------------------------------------------------------------------------------------------------

    def resident(self, brick: Brick) -> AbstractContextManager[Resident]:
        """A context in which a brick's coefficients are on the device; they stay longer if there is room.

        Threads read different bricks side by side; one that finds no room waits until another has done with a brick.
        """
        made = bytes_of(brick.size, self._filter, self._boundary, np.float32)
        stored = made // np.dtype(np.float32).itemsize  # cells, and some more
        samples = brick.samples * self._volume.dtype.itemsize
        nbytes = max(made + max(samples, bytes_beside((stored,))), samples + self._unpacking(brick))
        return self._residents.held(brick.at, nbytes, partial(self._samples, brick), partial(self._made, brick))

    def has(self, brick: Brick) -> bool:
        """Whether a brick's coefficients are on the device."""
        return self._residents.has(brick.at)

    def expect(self, order: Sequence[Brick]) -> None:
        """Set the access order: bricks will be asked for like this, and perhaps once more from the first on."""
        self._residents.expect([brick.at for brick in order])

    def read_ahead(self, brick: Brick) -> None:
        """Read the samples of a brick in another thread, if it is not resident and there is room for them."""
        if may_be_read_ahead(self._volume):
            nbytes = brick.samples * self._volume.dtype.itemsize + self._unpacking(brick)
            self._residents.read_ahead(brick.at, nbytes, partial(self._samples, brick))

    def forget_ahead(self) -> None:
        """Drop what was read ahead for this thread."""
        self._residents.forget_ahead()

    def drop(self) -> None:
        """Evict all bricks and chunks that nobody uses."""
        self._residents.drop()

    def release(self) -> None:
        """Free everything: the last use has ended."""
        self._residents.release()

    def _made(self, brick: Brick, samples: NDArray[Any]) -> Resident:
        grid = replace(self._volume.grid, data=np.broadcast_to(np.zeros((), self._volume.dtype), samples.shape))
        try:
            made = Coefficients(grid, self._filter, self._boundary, self._device, self._stored)
        except OutOfMemoryError:  # other programs take what the budget allows
            self._residents.make_room()
            made = Coefficients(grid, self._filter, self._boundary, self._device, self._stored)
        return Resident(brick.at, filled(made, samples))

    # -- samples -----------------------------------------------------------------------------------------------------------

    def _samples(self, brick: Brick) -> NDArray[Any]:
        """The samples that a brick's coefficients are computed from, [z, y, x].

        Raises
        ------
        FormatError, DataError
            As by `LazyVolume.read`.
        """
        self._count(brick.samples)
        samples = gathered(self._read, self._grid.runs(brick))
        if self._names:
            require_labels(replace(known_of(self._volume), data=samples))
        require_distinct_labels(self._filter, self._volume, lambda: replace(known_of(self._volume), data=samples))
        return samples

    def _read(self, place: Box) -> NDArray[Any]:
        """As `LazyVolume.at`, by way of the chunks that are kept."""
        return self._volume.at(place) if self._chunks is None else self._chunks[place]

    def _count(self, samples: int) -> None:
        with self._residents.lock:
            self.reads.samples += samples

    def _counted(self, place: Box) -> NDArray[Any]:
        """As `_read`, and counted."""
        self._count(math.prod(one.stop - one.start for one in place))
        return self._read(place)

    def _unpacking(self, brick: Brick) -> int:
        """Bytes that reading a brick takes beside its samples: whole chunks, and what samples are computed from."""
        data = self._volume.data
        if isinstance(data, Reduced):
            return data.taken(brick.size[::-1]) - brick.samples * data.dtype.itemsize
        if self._chunks is None:
            return 0
        inside = [slice(max(a, 0), min(b, n)) for a, b, n in zip(brick.first, brick.last, self._volume.size, strict=True)]
        return self._chunks.unpacking(inside[::-1])

    # -- fewer samples -----------------------------------------------------------------------------------------------------

    def summed(self, sums: Mapping[int, Sums], kind: type[np.generic], outside: float) -> Reduced:
        """Sums along the axes of the samples, computed where they are read: see `Reduced`."""
        beside = 0 if self._chunks is None else self._chunks.unpacking_most
        return Reduced(self._volume, sums, kind, self._device, outside, self._counted, beside)

    def blocks(self, sums: Mapping[int, Sums], kind: type[np.generic], outside: float) -> Iterator[Part]:
        """All of these sums, block by block, within the budget.

        Raises
        ------
        OptionError
            It does not hold the least block.
        """
        made = self.summed(sums, kind, outside)
        for block, nbytes, done in made.blocks(self.account.budget, 0 if self._chunks is None else self._chunks.most):
            with self.set_aside(nbytes):
                values = made[block]
            yield block, values, done

    def set_aside(self, nbytes: int) -> AbstractContextManager[None]:
        """A context that takes bytes of the budget for what is neither brick nor chunk."""
        return self.account.set_aside(nbytes, self._residents)


def _chunks_of(volume: LazyVolume, needs: Needs, edge: int, account: Account) -> Chunks:
    """Unpacked chunks, kept for other bricks that reach into them."""
    assert needs.lines is not None
    return Chunks(volume.at, needs.lines, volume.dtype, needs.chunks_kept(edge, account.budget), account, one=needs.chunk)


def require_distinct_labels(filter: Filter, volume: LazyVolume, known: Callable[[], Volume]) -> None:
    """Refuse labels that float32 does not tell apart, in what is `known` of a volume: its limits may be those of a few samples."""
    if filter.support == 1 and volume.dtype.itemsize > 2 and names_beyond(24, found := known(), filter):
        raise DataError(too_large_names(*map(int, found.limits)))
