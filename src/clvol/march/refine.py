"""Pictures that become finer, the first within a budget of time.

How long a picture takes grows with its pixels by a power, 0.4 to 1, that depends on what is drawn: rays that lie far apart share
less. It is measured, with the time of the last first picture; from both follows how many pixels the next one may have. Another
view, or another transfer function, may take several times as long: then a quarter of the budget goes into a coarser picture,
which says how long this one takes, and which is shown where a finer one would come too late.

The last pictures are one that is drawn on: first with one ray a pixel, then with the others, or those on edges.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.progress import part_of
from clvol.march.launch import BEFORE_EDGES
from clvol.march.media import drawing_of
from clvol.scene.clip import cuts_of
from clvol.show.picture import Picture

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.filter.filter import Filter
    from clvol.march.frame import Frame, Subject

__all__ = ["Asked", "Cancelled", "Rate", "Refined", "Refinement", "Wanted", "refined_by_levels"]

_LAUNCH = 0.008  # seconds; `cancelled` is called between launches
_KEPT = 0.75  # share of the budget that is planned for: the rest is for what cannot be known
_LATE = 0.95  # share of the budget after which a finer picture than the last is given up
_COARSE = 0.25  # share of the budget that goes into a coarser picture, where it is not known how long one takes
_WORTH = 2.0  # a finer picture must have this many times as many pixels
_SMALLEST = 256  # pixels of a tile, which take as long as one
_TRIAL = 1024  # pixels of the very first picture
_FEW = 96  # pixels along the shorter side, below which steps become longer
_LONGEST = 2.0  # voxels; the longest such step
_SHORTER = 0.8  # the power of the number of samples on a ray by which its time grows
_POWERS = 0.4, 1.0
_APART = 3.0  # least ratio of pixels of two pictures from which the power is measured
_BETWEEN = 8.0  # largest ratio of the times of successive pictures, without one in between
_NEAR = 0.1  # largest move of rays, relative to their length, between views that take about as long


class Refined(Picture):
    """A picture of `Renderer.refine`: a `Picture` with its state of refinement.

    Parameters
    ----------
    array : array-like, shape (height, width, 4)
        Viewed, not copied.
    final : bool
        Whether it is the last one, that of `render`.
    step : float
        The most that its rays advanced between samples, in voxels.
    seconds : float
        Working time of the iterator until it was ready; the time between requests for pictures does not count.

    Attributes
    ----------
    kind : str
        "rgba".
    final, step, seconds
        The same.
    """

    final: bool = False
    step: float = math.nan
    seconds: float = math.nan

    def __new__(cls, array: ArrayLike, final: bool = False, step: float = math.nan, seconds: float = math.nan) -> Self:
        result = super().__new__(cls, array)
        result.final, result.step, result.seconds = final, step, seconds
        return result


@dataclass(frozen=True)
class Wanted:
    """A requested picture."""

    subject: Subject
    size: tuple[int, int]
    step: float
    rays: int | Literal["auto"]
    filter: Filter

    @property
    def kind(self) -> tuple[Any, ...]:
        """A key that pictures with comparable times share: how they are drawn."""
        subject, drawn = self.subject, self.subject.coefficients
        mode, tile = subject.mode, drawn.device.limits.tile
        return (
            mode.file,
            mode.shaded,
            drawn.filter,
            subject.evaluator,
            subject.central,
            subject.minmax is None,
            tile,
            len(subject.others),
        )

    @property
    def shown(self) -> tuple[Any, ...]:
        """A further key of pictures that take about as long from the same view."""
        looks = [one.look for one in (self.subject, *self.subject.others)]
        return looks[0].mode, *((look.transfer, cuts_of(look.clip)) for look in looks)  # arrays compare by element

    @property
    def long_steps(self) -> list[float]:
        """Steps that a first picture may have; longer ones only where all samples count, and where there are steps."""
        mode, steps = self.subject.mode, [self.step]
        if mode.shows in ("matter", "mean", "integral") and not mode.stretches:
            while 2 * steps[-1] <= _LONGEST:
                steps.append(2 * steps[-1])
        return steps

    def size_of(self, pixels: float) -> tuple[int, int]:
        """The size of a picture with about `pixels` pixels and about the same aspect, no larger than this."""
        width, height = self.size
        scale = math.sqrt(min(1.0, max(pixels, min(_SMALLEST, width * height)) / (width * height)))
        return max(1, round(scale * width)), max(1, round(scale * height))


@dataclass(frozen=True)
class Rate:
    """How long pictures of a kind take, from the last first picture."""

    pixels: float
    step: float
    seconds: float
    view: NDArray[np.float64]  # `_view_of` it
    shown: tuple[Any, ...]  # its `Wanted.shown`
    power: float = 1.0  # of the number of pixels, by which seconds grow
    edges: float = 1.0  # time of edges, relative to the picture without

    def seconds_of(self, pixels: float, step: float) -> float:
        """The expected time of a picture with n pixels."""
        return float(self.seconds * (self.step / step) ** _SHORTER * (pixels / self.pixels) ** self.power)

    def pixels_in(self, seconds: float, step: float) -> float:
        """The number of pixels of a picture that takes about `seconds`."""
        share = max(seconds, 0.0) / (self.seconds * (self.step / step) ** _SHORTER)
        return float(min(self.pixels * min(share, 1e6) ** (1 / self.power), 1e12))

    def sees(self, view: NDArray[np.float64], shown: tuple[Any, ...]) -> bool:
        """Whether a picture should take about as long as this one."""
        near = bool(np.linalg.norm(view - self.view) <= _NEAR * np.linalg.norm(self.view))
        return near and bool(self.shown == shown)

    def grown(self, pixels: float, step: float, seconds: float) -> Rate:
        """The rate with its power updated by another picture of the same view and step."""
        if step != self.step or not max(pixels / self.pixels, self.pixels / pixels) > _APART:
            return self
        measured = math.log(seconds / self.seconds) / math.log(pixels / self.pixels)
        low, high = _POWERS
        return replace(self, power=(self.power + min(max(measured, low), high)) / 2)


class Cancelled(Exception):
    """The pictures are no longer wanted."""


@dataclass(frozen=True)
class Asked:
    """A request for pictures."""

    budget: float  # seconds until the first one
    cancelled: Callable[[], bool] | None  # whether they are no longer wanted
    progress: Progress | None  # called with the fraction of the last picture that is done
    began: float  # time of the request, by `time.perf_counter`

    def require_wanted(self, _: float = 0.0) -> None:
        """Raise if the pictures are no longer wanted."""
        if self.cancelled is not None and self.cancelled():
            raise Cancelled

    def reporting(self, start: float = 0, end: float = 1) -> Progress:
        """A callback for the progress of a part of the last picture, which raises if it is no longer wanted."""
        part = part_of(self.progress, start, end)

        def report(done: float) -> None:
            self.require_wanted()
            if part is not None:
                part(done)

        return report


def refined_by_levels(
    draw: Callable[[int, Progress], NDArray[Any]],
    levels: range,
    step: float,
    asked: Asked,
    drawing: Callable[[], AbstractContextManager[None]],
) -> Iterator[Refined]:
    """The pictures of `Renderer.refine` of a volume that is read by bricks: of its `levels`, the coarsest first.

    `draw` draws a level and calls a progress callback, which may raise; `drawing` is as for `Refinement.pictures`.
    """
    for level in levels:
        with drawing():
            try:
                asked.require_wanted()
                picture = draw(level, asked.reporting() if level == levels[-1] else asked.require_wanted)
            except Cancelled:
                return
        yield Refined(picture, level == levels[-1], step, time.perf_counter() - asked.began)


class Refinement:
    """One call of `Renderer.refine`: its stages in order, and the state between them.

    `rates` are those of a renderer by kind of picture, and are updated; any thread may read and write them: the last write wins.
    """

    def __init__(self, wanted: Wanted, asked: Asked, rates: dict[tuple[Any, ...], Rate]) -> None:
        self._wanted, self._asked, self._rates, self._budget = wanted, asked, rates, asked.budget
        width, height = wanted.size
        self._aspect, self._pixels = width / height, width * height
        self._worked, self._began = time.perf_counter() - asked.began, 0.0  # time before this picture; its start
        self._shown, self._shown_at = 0.0, 0.0  # pixels of the last picture, and when it was ready
        self._casting = 0.0  # seconds of the full picture's first ray

    def pictures(self, drawing: Callable[[], AbstractContextManager[None]]) -> Iterator[Refined]:
        """The pictures; `drawing` makes a context that is entered for drawing, and left when a picture is ready."""
        stages, device = self._stages(), self._wanted.subject.coefficients.device
        while True:
            self._began = time.perf_counter()
            with drawing(), device.limited(launch_seconds=min(_LAUNCH, device.limits.launch_seconds)):
                try:
                    self._asked.require_wanted()
                    picture = next(stages)
                except (StopIteration, Cancelled):
                    return
            self._worked = self._seconds
            yield picture
            if picture.final:
                return

    @property
    def _seconds(self) -> float:
        """Working time until now."""
        return self._worked + time.perf_counter() - self._began

    def _stages(self) -> Iterator[Refined]:
        self._wanted = wanted = replace(self._wanted, subject=self._wanted.subject.placed(self._aspect))
        self._asked.require_wanted()
        full = wanted.subject.frame(wanted.size, wanted.step, progress=self._asked.require_wanted)
        self._asked.require_wanted()
        self._view, self._rate = _view_of(full), self._rates.get(wanted.kind)
        self._whole = drawing_of(full, wanted.rays, wanted.filter, self._expected(self._pixels, wanted.step))
        yield from self._first()
        yield from self._between()
        yield from self._last()

    # -- the first picture, unless the full one is in time ----------------------------------------------------------

    def _first(self) -> Iterator[Refined]:
        coarse = self._coarse()
        size, step = self._best()
        until = math.inf if coarse is None else time.perf_counter() + _LATE * self._budget - self._seconds
        if (size, step) == (self._wanted.size, self._wanted.step):
            if self._cast(until):
                return
        elif coarse is None or step != coarse.step or size[0] * size[1] >= _WORTH * coarse[..., 0].size:
            finer = self._small(size, step, until)
            coarse = coarse if finer is None else finer
        assert coarse is not None  # only a finer picture can be late
        yield self._shows(coarse, coarse.step)

    def _coarse(self) -> Refined | None:
        """A coarse picture, if the time of this view is unknown and the full picture is finer."""
        wanted, rate = self._wanted, self._rate
        if rate is not None and rate.sees(self._view, wanted.shown):
            return None
        count = _TRIAL if rate is None else rate.pixels_in(_COARSE * (self._budget - self._seconds), wanted.step)
        size = wanted.size_of(count)
        if size == wanted.size:
            return None
        if rate is None:  # warm-up: the runtime compiles kernels on first use
            self._small(wanted.size_of(_SMALLEST), wanted.step)
        return self._small(size, wanted.step)

    def _best(self) -> tuple[tuple[int, int], float]:
        """Size and step of the finest picture in time; few pixels are worse than long steps."""
        wanted, rate = self._wanted, self._rate
        if rate is None:
            return wanted.size, wanted.step
        left = _KEPT * self._budget - self._seconds
        size, step = wanted.size, wanted.step
        for step in wanted.long_steps:
            size = wanted.size_of(rate.pixels_in(left, step))
            if min(size) >= min(_FEW, *wanted.size):
                break
        return size, step

    # -- pictures between it and the full one -----------------------------------------------------------------------

    def _between(self) -> Iterator[Refined]:
        rate, step = self._rate, self._wanted.step
        if not self._shown or self._casting or rate is None:
            return  # the full one is next, or has begun
        whole = rate.seconds_of(self._pixels, step)
        times = whole / rate.seconds
        count = math.ceil(math.log(max(times, 1.0), _BETWEEN)) - 1
        for i in range(1, count + 1):
            pixels = rate.pixels_in(rate.seconds * times ** (i / (count + 1)), step)
            if _WORTH * self._shown <= pixels <= self._pixels / _WORTH:
                picture = self._small(self._wanted.size_of(pixels), step)
                assert picture is not None  # it cannot be late
                yield self._shows(picture, step)

    # -- the full picture -------------------------------------------------------------------------------------------

    def _last(self) -> Iterator[Refined]:
        whole, wanted = self._whole, self._wanted
        self._cast()
        self._learn(self._pixels, wanted.step, self._casting, first=not self._shown)
        smoothed = wanted.rays == "auto"
        if smoothed or whole.rays > 1:
            more = self._casting * (whole.rays - 1 if not smoothed or self._rate is None else self._rate.edges)
            if self._shown or self._seconds + more > self._budget:
                yield self._shows(whole.shown(), wanted.step)
        if smoothed:
            begun = time.perf_counter()
            whole.smooth_edges(self._asked.reporting(BEFORE_EDGES, 1))
            if self._rate is not None:
                self._rate = replace(self._rate, edges=(time.perf_counter() - begun) / self._casting)
                self._rates[wanted.kind] = self._rate
        while whole.cast_rays < whole.rays:
            whole.cast(whole.cast_rays, self._asked.reporting())
            if whole.cast_rays < whole.rays and self._seconds - self._shown_at > self._budget:
                yield self._shows(whole.shown(), wanted.step)
        yield self._shows(whole.arrays["rgba"], wanted.step, final=True)

    def _cast(self, until: float = math.inf) -> bool:
        """Cast the rest of the full picture's first ray; returns whether it was in time."""
        begun = time.perf_counter()
        progress = self._asked.reporting(0, BEFORE_EDGES if self._wanted.rays == "auto" else 1)
        done = self._whole.cast_rays > 0 or self._whole.cast(1, progress, until)
        self._casting += time.perf_counter() - begun
        return done

    # -- shared by all stages ---------------------------------------------------------------------------------------

    def _small(self, size: tuple[int, int], step: float, until: float = math.inf) -> Refined | None:
        """A picture with fewer pixels, which also updates the rate; None if it was not in time."""
        begun = time.perf_counter()
        frame = self._wanted.subject.frame(size, step, aspect=self._aspect, progress=self._asked.require_wanted)
        drawing = drawing_of(frame, 1, self._wanted.filter, self._expected(size[0] * size[1], step))
        if not drawing.cast(1, self._asked.require_wanted, until):
            return None
        self._learn(size[0] * size[1], step, time.perf_counter() - begun, first=not self._shown)
        return Refined(drawing.arrays["rgba"], step=step)

    def _expected(self, pixels: int, step: float) -> float:
        """Expected seconds for a picture; 0 if unknown."""
        return 0.0 if self._rate is None else self._rate.seconds_of(pixels, step)

    def _learn(self, pixels: int, step: float, seconds: float, *, first: bool) -> None:
        """Update the rate by a picture: first ones give the time of this view, further ones its growth."""
        wanted, rate = self._wanted, self._rate
        if rate is not None and rate.sees(self._view, wanted.shown):
            rate = rate.grown(pixels, step, seconds)
        if first or rate is None:
            known = {} if rate is None else {"power": rate.power, "edges": rate.edges}
            rate = Rate(pixels, step, seconds, self._view, wanted.shown, **known)
        self._rate = rate
        self._rates[wanted.kind] = rate

    def _shows(self, array: NDArray[Any], step: float, *, final: bool = False) -> Refined:
        self._shown, self._shown_at = float(array[..., 0].size), self._seconds
        return Refined(array, final, step, self._shown_at)


def _view_of(frame: Frame) -> NDArray[np.float64]:
    """The view of a picture, in voxels: where its rays start, and where they are after crossing the volume."""
    camera, (width, height), far = frame.values["camera"], frame.size, max(frame.coefficients.volume.size)
    start, way = (
        np.array([camera[what], width * camera[f"{what}_u"], height * camera[f"{what}_v"]]) for what in ("origin", "direction")
    )
    return np.concatenate([start, start + far * way]).astype(np.float64)
