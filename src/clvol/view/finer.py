"""Pictures of a volume that does not fit into memory: by bricks of stored samples, where pixels are finer than resident voxels.

A level of the volume that fits is resident, and is what is turned, dragged and picked. At rest, once a picture's pixels are finer
than its voxels, the picture is drawn again by bricks, of the level that `clvol.render` would take. Regions of labels stay those of
the resident level.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.base import memory
from clvol.base.errors import ChunkError, ClvolError, OutOfMemoryError
from clvol.bricks.source import LazyVolume, needed_by
from clvol.device import Device
from clvol.march.bricks import STEPPED_AT_MOST, level_of, level_within, nearest_to
from clvol.march.function import row_for
from clvol.march.renderer import Renderer
from clvol.march.slices import shaded
from clvol.scene.mode import as_mode, virtual_samples
from clvol.show.picture import Picture
from clvol.view.panes import SlicePane
from clvol.view.state import State
from clvol.volume.volume import Volume

__all__ = ["Finer", "Stopped", "Wanted", "asking", "resident_level"]

_ROOM = 0.5  # of the memory that is available: for resident samples and coefficients
_TICK = 0.01  # seconds between checks whether a picture is still wanted


@dataclass(frozen=True, eq=False)
class Wanted:
    """A picture by bricks, and the arguments by which a program draws it."""

    state: State
    size: tuple[int, int]  # (width, height)
    given: dict[str, Any]  # of `clvol.render`, or of `clvol.view.section` without those of the plane
    pane: SlicePane | None = None  # the slice; None for the volume's picture


class Finer:
    """All levels of a volume of which one is resident; bricks are read when they are first seen.

    Parameters
    ----------
    stored : LazyVolume
    level : int
        The resident one; 0 is the finest.
    source : str, optional
        Python text by which copied programs get it, such as ``clvol.open("brain.zarr")``.
    device : Device, str or int, optional
        Draws the pictures.
    """

    def __init__(self, stored: LazyVolume, level: int, source: str | None = None, device: Device | str | int | None = None) -> None:
        self.stored, self.level, self.source, self.device = stored, level, source, device
        row_for(stored, None)  # reads a few samples now, so that sessions do not wait for them
        self._drawing = threading.Lock()  # one picture at a time: each takes the whole budget for bricks
        self._lock = threading.Lock()
        self._renderer: Renderer | None = None
        self._key: tuple[str, str] | None = None

    def wanted(self, state: State, size: tuple[int, int], given: dict[str, Any]) -> Wanted | None:
        """The volume's picture in a state; None if the resident level shows as much.

        Voxels are no longer than a pixel at the camera's target; the volume's nearest corner may be much nearer. `given` are
        arguments by which other samples show the same matter in the same place (`Resident.settled_arguments`).
        """
        mode, dark = as_mode(state.mode, state.options), {"shadow", "occlusion"} & given.keys()
        if state.wiper is not None or state.heat or state.step > STEPPED_AT_MOST or mode.regions or virtual_samples(mode):
            return None
        if (dark and self.stored.where is not None) or "shadow_rays" in given:
            return None
        view = given["camera"].view(self.stored.grid, size[0] / size[1])
        away = float((np.asarray(given["camera"].target) - view.eye) @ view.forward)
        lod = 1.0 if view.orthographic else max(1.0, away / nearest_to(self.stored, view))
        if level_of(self.stored, view, size, lod) >= self.level:
            return None
        return Wanted(state, size, given | self._reconstructed(state, as_mode(state.mode).picture_filter) | {"lod": lod})

    def wanted_slice(self, state: State, pane: SlicePane, size: tuple[int, int], window: tuple[float, float]) -> Wanted | None:
        """A slice in a state; None if the resident level shows as much."""
        if state.wiper is not None or as_mode(state.mode).regions or level_within(self.stored, max(pane.pixel(size))) >= self.level:
            return None
        return Wanted(state, size, self._reconstructed(state) | {"window": window}, pane)

    def _reconstructed(self, state: State, *usual: str) -> dict[str, Any]:
        """Filter and boundary in full: what follows from samples differs between levels."""
        row, bounds = row_for(self.stored, state.filter, *usual), self.stored.bounds
        name = bounds.filter if row is None and bounds is not None else getattr(row, "name", row)
        return {"filter": name, "boundary": state.boundary}

    def drawn(self, wanted: Wanted, resident: Volume, stop: Callable[[], bool]) -> Picture | None:
        """A picture by bricks, slices in the colours of the resident level; None if it was stopped.

        `ChunkError` if a chunk turns out to be damaged: the resident level, which has no hole, is what should be shown.
        """
        progress, known = asking(stop), len(self.stored.damages)
        with suppress(Stopped), self._turn(progress):
            given = dict(wanted.given)
            renderer = self._renderer_of(given.pop("filter"), given.pop("boundary"), progress)
            if wanted.pane is None:
                result: Picture = renderer.render(size=wanted.size, progress=progress, **given)
                if len(self.stored.damages) > known:
                    raise ChunkError(self.stored.damages[known])
                return result
            pane, pixel = wanted.pane, wanted.pane.pixel(wanted.size)
            values = pane.sheet(wanted.size).values(renderer.field_of_level(level_within(self.stored, max(pixel))), progress)
            return shaded(values, resident, given["window"], wanted.state.cmap, wanted.state.background)
        return None

    @contextmanager
    def _turn(self, progress: Callable[[float], None]) -> Iterator[None]:
        while not self._drawing.acquire(timeout=_TICK):
            progress(0.0)
        try:
            progress(0.0)
            yield
        finally:
            self._drawing.release()

    def _renderer_of(self, filter: str, boundary: str, progress: Callable[[float], None]) -> Renderer:
        """The renderer, of which one is kept; but none that is ready only after it was wanted: the view may have been closed."""
        with self._lock:
            if self._renderer is not None and self._key == (filter, boundary):
                return self._renderer
        self.close()
        result = Renderer(self.stored, filter, boundary, self.device)
        try:
            progress(0.0)
        except Stopped:
            result.close()
            raise
        with self._lock:
            self._renderer, self._key = result, (filter, boundary)
        return result

    def close(self) -> None:
        """Free the device's memory, once the picture that is being drawn is ready; a later picture takes it again."""
        with self._lock:
            gone, self._renderer = self._renderer, None
        if gone is not None:
            with suppress(ClvolError):  # of a device that failed
                gone.close()


class Stopped(Exception):  # nothing went wrong
    """The picture is no longer wanted."""


def asking(stop: Callable[[], bool]) -> Callable[[float], None]:
    """A progress callback that raises `Stopped` once `stop` says so."""

    def progress(_: float) -> None:
        if stop():
            raise Stopped

    return progress


def resident_level(stored: LazyVolume) -> int:
    """The largest level that fits, with its coefficients, into half of the memory that is available.

    `OutOfMemoryError` if the smallest does not fit into all of it.
    """
    sizes, available = (stored, *stored.levels), memory.available()
    for level, size in enumerate(sizes):
        if needed_by(size) <= _ROOM * available:
            return level
    if needed_by(sizes[-1]) > available:
        raise OutOfMemoryError(
            f"out of memory: a volume to be viewed must fit into the {available >> 20} MiB that are available, with its "
            f"coefficients; its smallest size, {sizes[-1].shape}, takes {-(-needed_by(sizes[-1]) >> 20)} MiB: clvol.pyramid makes "
            "smaller ones, and clvol.render draws it by bricks"
        )
    return len(sizes) - 1
