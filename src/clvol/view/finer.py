"""What a view shows of a volume that does not fit into memory: stored samples, where pixels are finer than those at hand.

A size of the volume that fits is in memory, and is what is turned, dragged and picked. At rest, once a picture's pixels are
finer than its voxels, the picture is drawn again by bricks, of the size that `clvol.render` would take.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from clvol import memory
from clvol.boundary import Boundary
from clvol.device import Device
from clvol.errors import ClvolError, OutOfMemoryError
from clvol.filter import Filter
from clvol.lazy import LazyVolume, needed_by
from clvol.march.bricks import STEPPED_AT_MOST, level_of, nearest_to
from clvol.march.renderer import Renderer
from clvol.picture import Picture
from clvol.view.panes import SlicePane
from clvol.view.slices import level_for, plane_points, shaded, window_of_slices
from clvol.view.state import State
from clvol.volume import Volume

__all__ = ["Finer", "at_hand"]

_ROOM = 0.5  # of the memory that is available: what samples and coefficients at hand may take


class Finer:
    """All sizes of a volume of which one is at hand; its bricks are read when they are first seen.

    Parameters
    ----------
    stored : LazyVolume
    level : int
        Which of its sizes is at hand; 0 is the finest.
    source : str, optional
        Python text by which copied programs get it, such as ``clvol.open("brain.zarr")``.

    Attributes
    ----------
    device : Device, str or int, optional
        On which pictures are drawn: that of the view.
    """

    def __init__(self, stored: LazyVolume, level: int, source: str | None = None) -> None:
        self.stored, self.level, self.source = stored, level, source
        self.device: Device | str | int | None = None
        self._lock = threading.Lock()
        self._renderer: Renderer | None = None
        self._key: tuple[str | Filter | None, str | Boundary] | None = None

    def arguments(self, given: dict[str, Any], state: State, size: tuple[int, int]) -> dict[str, Any] | None:
        """Arguments of `Renderer.render` for the volume's picture in a state; None if what is at hand shows as much.

        Voxels are no longer than a pixel where the camera's target is, which is what is looked at; its nearest corner may be much
        nearer. `given` are those by which what is at hand shows the same matter in the same place (`Resident.seen`).
        """
        if state.wiper is not None or state.heat or state.step > STEPPED_AT_MOST:
            return None
        view = given["camera"].view(self.stored.grid, size[0] / size[1])
        away = float((np.asarray(given["camera"].target) - view.eye) @ view.forward)
        lod = 1.0 if view.orthographic else max(1.0, away / nearest_to(self.stored, view))
        return given | {"lod": lod} if level_of(self.stored, view, size, lod) < self.level else None

    def picture(self, state: State, size: tuple[int, int], given: dict[str, Any], stop: Callable[[], bool]) -> Picture | None:
        """The picture by bricks; None if it was stopped."""
        with suppress(_Stopped):
            drawn: Picture = self._drawn_by(state).render(size=size, progress=_asking(stop), **given)
            return drawn
        return None

    def slice_level(self, state: State, pixel: tuple[float, float]) -> int | None:
        """Of which size a slice is to be whose pixels are so large; None if what is at hand shows as much."""
        if state.wiper is not None:
            return None
        level = level_for(self.stored, pixel)
        return level if level < self.level else None

    def slice(
        self,
        state: State,
        pane: SlicePane,
        pixel: tuple[float, float],
        size: tuple[int, int],
        at_hand: Volume,
        stop: Callable[[], bool],
    ) -> Picture | None:
        """A slice by bricks, in the colours of what is at hand; None if it was stopped."""
        points = plane_points(pane.middle, pane.right, pane.down, pixel, size)
        field = self._drawn_by(state).field_of_level(level_for(self.stored, pixel))
        with suppress(_Stopped):
            values = field(points, fill=np.nan, progress=_asking(stop))
            return shaded(values, at_hand, state.window or window_of_slices(at_hand), state.cmap, state.background)
        return None

    def _drawn_by(self, state: State) -> Renderer:
        """One renderer is kept: bricks take memory."""
        key = state.filter, state.boundary
        with self._lock:
            if self._renderer is None or self._key != key:
                if self._renderer is not None:
                    self._renderer.close()  # pictures that others are making of it are made to their end
                self._renderer, self._key = Renderer(self.stored, state.filter, state.boundary, self.device), key
            return self._renderer

    def close(self) -> None:
        """Free the device's memory; a later picture takes it again."""
        with self._lock:
            gone, self._renderer = self._renderer, None
        if gone is not None:
            with suppress(ClvolError):  # of a device that failed
                gone.close()


class _Stopped(Exception):  # nothing went wrong
    """The picture is no longer wanted."""


def _asking(stop: Callable[[], bool]) -> Callable[[float], None]:
    """What is told of progress, and ends the work if it was stopped."""

    def on(_: float) -> None:
        if stop():
            raise _Stopped

    return on


def at_hand(stored: LazyVolume) -> int:
    """Which size of a volume is looked at: the largest that fits, with its coefficients, into half of the memory that is available.

    Raises
    ------
    OutOfMemoryError
        The smallest one does not fit into all of it.
    """
    sizes, available = (stored, *stored.levels), memory.available()
    for level, size in enumerate(sizes):
        if needed_by(size) <= _ROOM * available:
            return level
    if needed_by(sizes[-1]) > available:
        raise OutOfMemoryError(
            f"out of memory: a volume that is looked at must fit into the {available >> 20} MiB that are available, with its "
            f"coefficients; its smallest size, {sizes[-1].shape}, takes {-(-needed_by(sizes[-1]) >> 20)} MiB: clvol.pyramid makes "
            "smaller ones, and clvol.render draws it by bricks"
        )
    return len(sizes) - 1
