"""The pictures of a pane: of the volume, of a slice, of two filters side by side, and the heat map of samples per ray."""

from __future__ import annotations

import io
import math
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolError
from clvol.base.progress import Progress
from clvol.march.empty import warn_of_refined
from clvol.march.renderer import Renderer
from clvol.march.slices import lay, shaded
from clvol.scene.mode import as_mode, tolerance_of
from clvol.show.picture import Picture, heat, to_bytes
from clvol.view import media
from clvol.view.background import started
from clvol.view.catalog import labelled
from clvol.view.events import Context
from clvol.view.finer import Stopped, Wanted, asking
from clvol.view.pace import Pace
from clvol.view.panes import SlicePane
from clvol.view.renderers import on_slices, own_arguments
from clvol.view.resident import Resident
from clvol.view.sketch import Sketch
from clvol.view.state import State
from clvol.view.wiper import joined

__all__ = ["WHOLE", "Drawer", "Order", "Shot", "has_sketch", "jpeg", "opaque", "png", "share_visited"]

_COARSE = 3  # pixels of a heat map that is dragged, along each edge
_TOUR = 96  # pixels along the longer edge of the picture that measures the share of visited samples
WHOLE = 3600.0  # seconds: a budget in which every picture is drawn in one go
_TICK = 0.01  # seconds between checks whether a picture is still wanted
_LONGEST = 8.0, 4.0  # voxels; the longest step while something is dragged, without and with light, which shows gaps
_QUICK = 1  # of zlib: twice as fast as its default, with a fifth more bytes
_SMALL = 640 * 480  # pixels of a JPEG whose colours are not halved
_KEPT = 2  # final pictures of the wiper's two filters


class Order(NamedTuple):
    """A picture that is to be drawn, better and better until it is final."""

    context: Context
    state: State
    name: str  # of the pane
    size: tuple[int, int]  # of the final picture, in pixels
    budget: float = math.inf  # seconds for the first picture; infinity asks for the final one in one go
    stop: Callable[[], bool] = lambda: False  # asked while pictures are drawn; once it says so, no more come
    coarse: bool = False  # only the first picture: something is dragged
    elsewhere: Callable[[], object] = lambda: False
    """Asked while there is nothing to draw: whether the thread is needed for something else, and comes back to this order."""
    progress: Progress | None = None  # of a final picture in one go; it may raise

    def interrupted(self) -> bool:
        """Whether to wait no longer."""
        return self.stop() or bool(self.elsewhere())


class Shot(NamedTuple):
    """A picture that was drawn."""

    pixels: NDArray[np.uint8]  # (height, width, 3 or 4)
    final: bool
    step: float | None = None  # in voxels; None for slices
    visited: float | None = None  # the mean share of samples that were visited, where that is shown
    few: bool = False  # whether it shows few of the volume's samples: the coefficients are still being computed
    coarser: bool = False  # whether a picture of finer samples follows, which are being read


class _Reading(NamedTuple):
    """A picture by bricks that another thread draws, and what it shows."""

    key: object
    future: Future[Picture | None]
    given_up: threading.Event


class Drawer:
    """Draws the pictures of one session, in its thread."""

    def __init__(self, resident: Resident) -> None:
        self._resident = resident
        self._finals: dict[object, Shot] = {}
        self._sketch: Sketch | None = None
        self._sketched: tuple[State, tuple[int, int]] | None = None
        self._pace = Pace()
        self._slice_rate = 0.0  # seconds per pixel of the last slice
        self._reading: _Reading | None = None

    def still(self, order: Order) -> NDArray[np.uint8] | None:
        """The final picture, in one go; None if it was stopped."""
        last = None
        for shot in self.shots(order):
            last = shot
        return None if last is None else last.pixels

    def shots(self, order: Order) -> Generator[Shot, None, None]:
        """Pictures of a pane, each better than the one before; the last is final unless it was stopped, or the order is coarse."""
        if order.state.wiper is not None:
            yield from self._side_by_side(order)
            return
        self._finals.clear()
        sketched = order.name == "3d" and has_sketch(order.state) and math.isfinite(order.budget)
        if sketched and (yield from self._while_prefiltering(order)):
            return
        yield from self._with_finer(order)

    def give_up(self) -> None:
        """Abandon a picture by bricks; its thread ends after the current brick."""
        if self._reading is not None:
            self._reading.given_up.set()
            self._reading = None

    def forget_sketch(self) -> None:
        """The last sketch was not seen."""
        self._sketched = None

    # -- two filters -------------------------------------------------------------------------------------------

    def _side_by_side(self, order: Order) -> Generator[Shot, None, None]:
        state, finite = order.state, math.isfinite(order.budget)
        assert state.wiper is not None  # or there would be one filter
        at, edge = state.wiper.at, round(state.wiper.at * order.size[0])
        sides = [(state.filter, edge > 0), (state.wiper.filter, edge < order.size[0])]
        plain = order._replace(state=replace(state, wiper=None, layout="3d", active="3d", tool=None))
        for first in (True, False) if finite else (False,):
            part = plain._replace(budget=order.budget / 2 if first else max(order.budget, WHOLE))
            parts = []
            for chosen, seen in sides:
                parts.append(self._side(part, chosen, first=first) if seen else None)
                if seen and parts[-1] is None:
                    return  # it was stopped
            shown = [shot for shot in parts if shot is not None]
            left, right = (None if shot is None else shot.pixels for shot in parts)
            final = all(shot.final for shot in shown)
            yield Shot(joined(left, right, at), final, shown[0].step, shown[0].visited)
            if final or order.coarse:
                return

    def _side(self, order: Order, chosen: str | None, *, first: bool) -> Shot | None:
        """The first picture of one filter, or its final one, which is kept; None if it was stopped."""
        key = order.state, chosen, order.name, order.size, tuple(order.context.size(order.name))
        if key in self._finals:
            return self._finals[key]
        shot = None
        with closing(self._of(order, chosen)) as shots:
            for shot in shots:  # noqa: B007  # the last is wanted
                if first:
                    break
        if shot is not None and shot.final:
            self._finals[key] = shot
            for old in list(self._finals)[: -2 * _KEPT]:
                del self._finals[old]
        return shot if shot is None or shot.final or first else None

    # -- what takes other threads ------------------------------------------------------------------------------

    def _while_prefiltering(self, order: Order) -> Generator[Shot, None, bool]:
        """A sketch while coefficients are computed; returns whether it was interrupted before they were resident."""
        state, resident = order.state, self._resident
        key = resident.catalog.key(state)
        which = key[2]
        if resident.renderers.soon(*key):
            self._sketch = self._sketched = None
            return False
        if self._sketched != (state, order.size):
            with suppress(ClvolError):  # the picture of all samples reports it
                if self._sketch is None or self._sketch.which != which:
                    self._sketch = Sketch(resident, which)
                picture = self._sketch.picture(state, order.size)
                self._sketched = state, order.size
                yield Shot(to_bytes(picture), False, state.step, few=True)
        thread = resident.renderers.prepare(*key)  # not before: it takes all cores
        while thread.is_alive():
            if order.interrupted():
                return True
            thread.join(_TICK)
        return False

    def _with_finer(self, order: Order) -> Generator[Shot, None, None]:
        """Pictures of the resident samples, and a final one of finer samples if there are any and the pane shows more."""
        state, name, size = order.state, order.name, order.size
        if order.coarse:
            self.give_up()
        wanted = None if order.coarse else self._resident.finer_picture(state, order.context.size(name), name, size)
        key = state, name, size
        resumed = self._reading is not None and self._reading.key == key
        if wanted is None or (math.isfinite(order.budget) and not resumed):
            for shot in self._of(order, state.filter):
                yield shot if wanted is None else shot._replace(final=False, coarser=True)
        if wanted is not None and not order.stop():
            picture = self._by_bricks(key, wanted, order.interrupted)
            if picture is not None:
                yield Shot(to_bytes(picture), True, state.step if name == "3d" else None)

    def _by_bricks(self, key: object, wanted: Wanted, interrupted: Callable[[], bool]) -> Picture | None:
        """A picture that another thread draws; None once interrupted, and the next call with this key resumes it."""
        if self._reading is None or self._reading.key != key:
            self.give_up()
            finer = self._resident.finer
            assert finer is not None  # or nothing would be wanted of it
            given_up = threading.Event()
            future = started(lambda: finer.drawn(wanted, self._resident.volume, given_up.is_set), "clvol view: bricks")
            self._reading = _Reading(key, future, given_up)
        reading = self._reading
        while not reading.future.done():
            if interrupted():
                return None
            wait([reading.future], _TICK)
        self._reading = None
        return reading.future.result()

    # -- one filter, resident samples --------------------------------------------------------------------------

    def _of(self, order: Order, chosen: str | None) -> Generator[Shot, None, None]:
        state, name, size, coarse = replace(order.state, filter=chosen), order.name, order.size, order.coarse
        with self._resident.renderers.renderer(chosen, state.boundary, self._resident.catalog.which(state)) as renderer:
            if name != "3d":
                shape = self._slice_size(size, order.budget) if coarse else size
                began = time.perf_counter()
                pixels = to_bytes(_slice(self._resident, renderer, order, shape))
                self._slice_rate = (time.perf_counter() - began) / (shape[0] * shape[1])
                yield Shot(pixels, not coarse)
            elif state.heat:
                shape = (max(1, size[0] // _COARSE), max(1, size[1] // _COARSE)) if coarse else size
                given = self._resident.arguments(state, bare=True)
                share = np.asarray(renderer.render(size=shape, outputs="visited", **given))
                yield Shot(to_bytes(heat(share)), not coarse, state.step, _mean(share))
            else:
                given = self._resident.arguments(state, bare=coarse)
                if coarse:  # where it is with what stands around, which is drawn at rest
                    given["camera"] = self._resident.placed(state, size[0] / size[1])
                    yield from self._moving(renderer, order, chosen, given)
                else:
                    yield from _refined(renderer, order, given, partial(self._pace.rested, (chosen, state.mode)))

    def _moving(self, renderer: Renderer, order: Order, chosen: str | None, given: dict[str, Any]) -> Generator[Shot, None, None]:
        """The one picture of something that is dragged: with as many pixels as its time allows."""
        state, mode = order.state, as_mode(order.state.mode, order.state.options)
        kind = chosen, state.mode
        longest = 0.0 if mode.stretches or mode.regions else _LONGEST[mode.shaded]  # surfaces are found whatever the step
        size, step = self._pace.choose(kind, order.size, state.step, longest, order.budget)
        if tolerance_of(mode) is not None:
            given["tolerance"] = None  # probes take longer than the picture
        given |= {"step": step, "rays": 1}
        given.pop("pixel_filter", None)  # of several rays
        began = time.perf_counter()
        for picture in renderer.refine(given.pop("camera"), given.pop("mode"), size, seconds=WHOLE, cancelled=order.stop, **given):
            self._pace.took(kind, size, step, time.perf_counter() - began)
            yield Shot(to_bytes(picture), False, picture.step)

    def _slice_size(self, size: tuple[int, int], budget: float) -> tuple[int, int]:
        """The size of a slice that takes no longer than a budget, but at least a quarter along each edge."""
        pixels = size[0] * size[1]
        scale = min(1.0, max(0.25, math.sqrt(budget / max(self._slice_rate * pixels, 1e-9))))
        return max(1, round(scale * size[0])), max(1, round(scale * size[1]))


def has_sketch(state: State) -> bool:
    """Whether a sketch is shown of the volume while coefficients are computed."""
    return state.wiper is None and not state.heat


def _slice(resident: Resident, renderer: Renderer, order: Order, size: tuple[int, int]) -> NDArray[Any]:
    """A slice of the first medium, with the others over it."""
    state, pane = order.state, order.context.pane(order.state, order.name)
    assert isinstance(pane, SlicePane)  # by its name
    sheet = pane.sheet(size)
    found = sheet.values(on_slices(renderer, state.mode), None)
    window, cmap, transfer = map(media.slice_words(resident.catalog.media, state).get, ("window", "cmap", "transfer"))
    picture = shaded(found, labelled(renderer.volume, state), window, cmap, state.background, transfer)
    others = media.over_slices(resident.catalog.media, state)
    sheets = [sheet.over(renderer.scene.media[k].volume) for k, _ in others]
    shown = [each.values(on_slices(renderer, state.mode, k), None) for (k, _), each in zip(others, sheets, strict=True)]
    lay(picture, [(values, transfer) for values, (_, transfer) in zip(shown, others, strict=True)])
    return picture


def _refined(
    renderer: Renderer, order: Order, given: dict[str, Any], rested: Callable[[tuple[int, int], float, float], None]
) -> Generator[Shot, None, None]:
    """Pictures at rest; `rested` is told the size, the step and the time of the last one."""
    if not math.isfinite(order.budget):
        with suppress(Stopped):
            picture = renderer.render(size=order.size, progress=order.progress or asking(order.stop), **given)
            yield Shot(to_bytes(picture), True, picture.recipe.step)
        return
    camera, mode = given.pop("camera"), given.pop("mode")
    for picture in renderer.refine(camera, mode, order.size, seconds=order.budget, cancelled=order.stop, **given):
        if picture.final:
            warn_of_refined(renderer, picture, camera, mode, **own_arguments(renderer, given))
            rested(order.size, picture.step, picture.seconds)
        yield Shot(to_bytes(picture), picture.final, picture.step)


def share_visited(resident: Resident, state: State, shape: tuple[float, float]) -> float | None:
    """The mean share of samples that a picture of this shape visits, measured by a small one."""
    if resident.catalog.media:
        return None
    edge = _TOUR / max(shape)
    size = max(1, round(shape[0] * edge)), max(1, round(shape[1] * edge))
    with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
        given = resident.arguments(state, bare=True) | {"rays": 1}
        given.pop("pixel_filter", None)  # of several rays
        return _mean(np.asarray(renderer.render(size=size, outputs="visited", **given)))


def _mean(share: NDArray[Any]) -> float | None:
    met = np.isfinite(share)
    return round(float(share[met].mean()), 4) if met.any() else None


# -- as bytes for clients: JPEG while something moves, PNG at rest ---------------------------------------------


def opaque(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Eight-bit colours over black, without opacity; rounded down."""
    if pixels.shape[2] == 3:
        return pixels
    if pixels[..., 3].min() == 255:
        return pixels[..., :3]
    return (pixels[..., :3].astype(np.uint16) * pixels[..., 3:] // 255).astype(np.uint8)


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Eight-bit colours as PNG, lossless; without opacity if all is opaque."""
    if pixels.ndim == 3 and pixels.shape[2] == 4 and pixels[..., 3].min() == 255:
        pixels = pixels[..., :3]
    return _encoded(pixels, "PNG", compress_level=_QUICK)


def jpeg(pixels: NDArray[np.uint8], quality: int) -> bytes:
    """Eight-bit colours as JPEG, over black; small ones with the colours of each pixel, which are enlarged on the screen."""
    small = pixels.shape[0] * pixels.shape[1] <= _SMALL
    return _encoded(opaque(pixels), "JPEG", quality=quality, subsampling=0 if small else 2)


def _encoded(pixels: NDArray[np.uint8], form: str, **options: int) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, form, **options)
    return stream.getvalue()
