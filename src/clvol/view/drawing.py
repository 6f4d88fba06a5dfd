"""The pictures of a pane: of the volume, of a slice, of two filters side by side, and the heat map of samples looked at."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from contextlib import closing, suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolError
from clvol.march.renderer import Renderer
from clvol.show.picture import Picture, heat, to_bytes
from clvol.view.events import Place
from clvol.view.finer import Stopped, Wanted, asking
from clvol.view.panes import SlicePane
from clvol.view.resident import Resident
from clvol.view.sketch import Sketch
from clvol.view.slices import plane_points, shaded
from clvol.view.state import State
from clvol.view.wiper import joined

__all__ = ["WHOLE", "Drawer", "Shot", "share_visited", "sketched"]

_COARSE = 3  # pixels of a heat map that is dragged, along each edge
_TOUR = 96  # pixels of the picture whose share of samples looked at is reported, along its longer edge
WHOLE = 3600.0  # seconds: a budget in which any picture comes whole at once
_TICK = 0.01  # seconds between looks at whether a picture of few samples is still wanted
_KEPT = 2  # still pictures of the wiper's two filters


class Shot(NamedTuple):
    """A picture that was drawn.

    Attributes
    ----------
    pixels : ndarray of uint8, shape (height, width, 3 or 4)
    final : bool
        Whether it is the still picture.
    step : float or None
        In voxels; None for slices.
    visited : float or None
        The mean share of samples that was looked at, where that is shown.
    few : bool
        Whether it shows few of the volume's samples, since the coefficients of all are not there yet.
    coarser : bool
        Whether one follows of finer samples, which are read from where the volume is stored.
    """

    pixels: NDArray[np.uint8]
    final: bool
    step: float | None = None
    visited: float | None = None
    few: bool = False
    coarser: bool = False


class _Reading(NamedTuple):
    """A picture by bricks that another thread draws, and what it is of."""

    key: object
    made: Future[Picture | None]
    given_up: threading.Event


class Drawer:
    """Draws what states say; of one session, in its thread."""

    def __init__(self, resident: Resident) -> None:
        self.resident = resident
        self._stills: dict[object, Shot] = {}
        self._sketch: Sketch | None = None
        self._sketched_of: tuple[State, tuple[int, int]] | None = None
        self._slice_rate = 0.0  # seconds a pixel, of the last slice
        self._reading: _Reading | None = None

    def _of_slice(self, size: tuple[int, int], budget: float) -> tuple[int, int]:
        """The size of a slice that takes no longer than a budget, no less than a quarter along each edge."""
        pixels = size[0] * size[1]
        scale = min(1.0, max(0.25, math.sqrt(budget / max(self._slice_rate * pixels, 1e-9))))
        return max(1, round(scale * size[0])), max(1, round(scale * size[1]))

    def still(
        self, place: Place, state: State, name: str, size: tuple[int, int], stop: Callable[[], bool] = lambda: False
    ) -> NDArray[np.uint8] | None:
        """The still picture, in one go; None if it was stopped."""
        last = None
        for shot in self.shots(place, state, name, size, math.inf, stop):
            last = shot
        return None if last is None else last.pixels

    def shots(
        self,
        place: Place,
        state: State,
        name: str,
        size: tuple[int, int],
        budget: float,
        stop: Callable[[], bool],
        *,
        coarse: bool = False,
        elsewhere: Callable[[], object] = lambda: False,
    ) -> Generator[Shot, None, None]:
        """Pictures of a pane, each better than the one before; the last one is final unless `stop` said so or it is `coarse`.

        Parameters
        ----------
        place : Place
        state : State
        name : str
            The pane.
        size : (width, height)
            Of the still picture, in pixels.
        budget : float
            Seconds, for the first picture.
        stop : callable
            Asked while pictures of the volume are drawn.
        coarse : bool
            The first picture alone: something is dragged.
        elsewhere : callable
            Asked while there is nothing to draw: whether the thread is needed for something else, to come back to this.
        """
        if state.wiper is None:
            self._stills.clear()
            if name == "3d" and sketched(state) and math.isfinite(budget):
                waiting = yield from self._sketched(state, size, lambda: stop() or bool(elsewhere()))
                if waiting:
                    return
            yield from self._with_finer(place, state, name, size, budget, stop, coarse, elsewhere)
            return
        at, edge = state.wiper.at, round(state.wiper.at * size[0])
        sides = [(state.filter, edge > 0), (state.wiper.filter, edge < size[0])]
        plain = replace(state, wiper=None, layout="3d", active="3d", tool=None)
        for first in (True, False) if math.isfinite(budget) else (False,):
            parts: list[Shot | None] = []
            seconds = budget / 2 if first else max(budget, WHOLE)
            for chosen, seen in sides:
                part = self._side(place, plain, chosen, name, size, seconds, stop, coarse, first) if seen else None
                if seen and part is None:
                    return  # it was stopped
                parts.append(part)
            left, right = parts
            shown = [shot for shot in parts if shot is not None]
            pixels = joined(None if left is None else left.pixels, None if right is None else right.pixels, at)
            final = all(shot.final for shot in shown)
            yield Shot(pixels, final, shown[0].step, shown[0].visited)
            if final or coarse:
                return

    def _with_finer(
        self,
        place: Place,
        state: State,
        name: str,
        size: tuple[int, int],
        budget: float,
        stop: Callable[[], bool],
        coarse: bool,
        elsewhere: Callable[[], object],
    ) -> Generator[Shot, None, None]:
        """Pictures of the samples at hand, and the last one of finer ones where these are stored and the pane shows more."""
        if coarse:
            self.give_up()
        wanted = None if coarse else self.resident.finer_than_at_hand(state, place.size(name), name, size)
        key = state, name, size
        going_on = self._reading is not None and self._reading.key == key
        if wanted is None or (math.isfinite(budget) and not going_on):
            for shot in self._of(place, state, state.filter, name, size, budget, stop, coarse):
                yield shot if wanted is None else shot._replace(final=False, coarser=True)
        if wanted is not None and not stop():
            picture = self._read_beside(key, wanted, lambda: stop() or bool(elsewhere()))
            if picture is not None:
                yield Shot(to_bytes(picture), True, state.step if name == "3d" else None)

    def _read_beside(self, key: object, wanted: Wanted, stop: Callable[[], bool]) -> Picture | None:
        """A picture by bricks, which another thread draws; None once `stop` said so, and what asks for the same goes on with it."""
        if self._reading is None or self._reading.key != key:
            self.give_up()
            finer = self.resident.finer
            assert finer is not None  # or nothing would be wanted of it
            made: Future[Picture | None] = Future()
            given_up = threading.Event()

            def work() -> None:
                try:
                    made.set_result(finer.drawn(wanted, self.resident.volume, given_up.is_set))
                except BaseException as error:
                    made.set_exception(error)

            self._reading = _Reading(key, made, given_up)
            threading.Thread(target=work, name="clvol view: bricks", daemon=True).start()
        reading = self._reading
        while not reading.made.done():
            if stop():
                return None
            wait([reading.made], _TICK)
        self._reading = None
        return reading.made.result()

    def give_up(self) -> None:
        """What is read by bricks is not wanted any more; its thread ends after the brick that it is at."""
        if self._reading is not None:
            self._reading.given_up.set()
            self._reading = None

    def _sketched(self, state: State, size: tuple[int, int], stop: Callable[[], bool]) -> Generator[Shot, None, bool]:
        """A picture of few samples, while the coefficients of all of them are made; whether `stop` said so before they were."""
        which = self.resident.which(state)
        if self.resident.soon(state.filter, state.boundary, which):
            self._sketch = self._sketched_of = None
            return False
        if self._sketched_of != (state, size):
            with suppress(ClvolError):  # what is wrong is told of the whole volume
                if self._sketch is None or self._sketch.which != which:
                    self._sketch = Sketch(self.resident, which)
                picture = self._sketch.picture(state, size)
                self._sketched_of = state, size
                yield Shot(to_bytes(picture), False, state.step, few=True)
        maker = self.resident.maker(state.filter, state.boundary, which)  # not before: it takes all processors
        while maker.is_alive():
            if stop():
                return True
            maker.join(_TICK)
        return False

    def forget_sketch(self) -> None:
        """The last one was not seen."""
        self._sketched_of = None

    def _side(
        self,
        place: Place,
        state: State,
        chosen: str | None,
        name: str,
        size: tuple[int, int],
        budget: float,
        stop: Callable[[], bool],
        coarse: bool,
        first: bool,
    ) -> Shot | None:
        """The first picture of one filter, or its last, which is kept; None if it was stopped."""
        key = state, chosen, name, size, tuple(place.size(name))
        if key in self._stills:
            return self._stills[key]
        made = None
        with closing(self._of(place, state, chosen, name, size, budget, stop, coarse)) as shots:
            for made in shots:  # noqa: B007  # the last is wanted
                if first:
                    break
        if made is not None and made.final:
            self._stills[key] = made
            for old in list(self._stills)[: -2 * _KEPT]:
                del self._stills[old]
        return made if made is None or made.final or first else None

    def _of(
        self,
        place: Place,
        state: State,
        chosen: str | None,
        name: str,
        size: tuple[int, int],
        budget: float,
        stop: Callable[[], bool],
        coarse: bool,
    ) -> Generator[Shot, None, None]:
        """Pictures by one filter."""
        with self.resident.renderer(chosen, state.boundary, self.resident.which(state)) as renderer:
            if name != "3d":
                shape = self._of_slice(size, budget) if coarse else size
                began = time.perf_counter()
                pixels = to_bytes(_slice(renderer, place, state, name, shape))
                self._slice_rate = (time.perf_counter() - began) / (shape[0] * shape[1])
                yield Shot(pixels, not coarse)
            elif state.heat:
                shape = (max(1, size[0] // _COARSE), max(1, size[1] // _COARSE)) if coarse else size
                share = np.asarray(renderer.render(size=shape, outputs="visited", **self.resident.arguments(state)))
                yield Shot(to_bytes(heat(share)), not coarse, state.step, _mean(share))
            else:
                yield from _refined(renderer, size, budget, stop, coarse, self.resident.arguments(state))


def sketched(state: State) -> bool:
    """Whether a sketch is shown of the volume while coefficients are made."""
    return state.wiper is None and not state.heat


def _slice(renderer: Renderer, place: Place, state: State, name: str, size: tuple[int, int]) -> NDArray[Any]:
    pane = place.pane(state, name)
    assert isinstance(pane, SlicePane)  # by its name
    values = renderer.field(plane_points(pane.middle, pane.right, pane.down, pane.pixel(size), size), fill=np.nan)
    return shaded(values, renderer.volume, state.window, state.cmap, state.background)


def _refined(
    renderer: Renderer, size: tuple[int, int], budget: float, stop: Callable[[], bool], coarse: bool, given: dict[str, Any]
) -> Generator[Shot, None, None]:
    if not math.isfinite(budget):
        with suppress(Stopped):
            yield Shot(to_bytes(renderer.render(size=size, progress=asking(stop), **given)), True, given["step"])
        return
    camera, mode, step = (given.pop(name) for name in ("camera", "mode", "step"))
    for picture in renderer.refine(camera, mode, size, step, budget=budget, cancelled=stop, **given):
        yield Shot(to_bytes(picture), picture.final and not coarse, picture.step)
        if coarse:
            return


def share_visited(resident: Resident, state: State, shape: tuple[float, float]) -> float | None:
    """The mean share of samples that a picture of this shape looks at, from a small one."""
    edge = _TOUR / max(shape)
    size = max(1, round(shape[0] * edge)), max(1, round(shape[1] * edge))
    with resident.renderer(state.filter, state.boundary, resident.which(state)) as renderer:
        given = resident.arguments(state) | {"samples": 1}
        return _mean(np.asarray(renderer.render(size=size, outputs="visited", **given)))


def _mean(share: NDArray[Any]) -> float | None:
    met = np.isfinite(share)
    return round(float(share[met].mean()), 4) if met.any() else None
