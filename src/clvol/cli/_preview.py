"""A small picture above the progress bar, in terminals with enough colours."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.color import Color
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import Progress
from rich.segment import Segment
from rich.style import Style

from clvol.show.picture import over_black, to_bytes

__all__ = ["Preview", "Screen", "console"]

_WORTH = 2.0  # seconds: a shorter wait needs no preview
_SURE = 0.25  # seconds of work, after which the rest can be estimated
_NARROWEST, _LOWEST, _HIGHEST = 24, 6, 24  # characters, lines
_BESIDE = 4  # lines left for the command, the bar and the prompt
_COLORS = ("truecolor", "256")
_HALF = "▀"  # the foreground is a pixel, the background the one below


def console() -> Console | None:
    """Standard error, if it is a terminal that can show pictures: at least 256 colours, Unicode, and large enough."""
    found = Console(stderr=True)
    if not found.is_terminal or found.is_dumb_terminal or found.no_color or found.color_system not in _COLORS:
        return None
    wide, high = _room(found)
    return found if found.encoding.startswith("utf") and wide >= _NARROWEST and high >= _LOWEST else None


def _room(console: Console) -> tuple[int, int]:
    """The largest size of a picture, in characters and lines."""
    return console.width - 1, min(_HIGHEST, console.height - _BESIDE)


class Preview:
    """A progress bar with a preview of the picture, shown once the final picture is known to take long.

    Call it with the fraction of the final picture that is done.
    """

    def __init__(self, what: str, console: Console) -> None:
        self._bar = _Bar(console=console, transient=True)
        self._task = self._bar.add_task(what, total=1.0)
        self._first: float | None = None  # time of the first picture
        self._begun: float | None = None  # start of the final picture
        self._newest: Screen | None = None

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.picture = None
        self._bar.stop()

    def show(self, picture: ArrayLike) -> None:
        """Set the newest picture; it is shown once the wait is worth it."""
        now = time.perf_counter()
        self._first = now if self._first is None else self._first
        self._newest = Screen(picture)
        if self._bar.picture is not None or now - self._first > _WORTH:
            self._put()

    def __call__(self, done: float) -> None:
        """Report the fraction of the final picture that is done."""
        self._bar.update(self._task, completed=done)
        if self._newest is None or self._bar.picture is not None:
            return
        now = time.perf_counter()
        self._begun = now if self._begun is None else self._begun
        worked = now - self._begun
        if worked > _SURE and worked * (1 - done) > _WORTH * done:
            self._put()

    def _put(self) -> None:
        self._bar.picture = self._newest
        self._bar.refresh()


class _Bar(Progress):
    """The bar, and the picture above it."""

    picture: Screen | None = None

    def get_renderables(self) -> Iterable[RenderableType]:
        if self.picture is not None:
            yield self.picture
        yield self.make_tasks_table(self.tasks)


class Screen:
    """A picture as a console draws it: two pixels per character, as large as fits, transparent pixels black."""

    def __init__(self, picture: ArrayLike) -> None:
        self._pixels: NDArray[np.uint8] = over_black(to_bytes(picture))
        self._made: tuple[tuple[int, int], list[Segment]] = ((0, 0), [])

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        wide, high = _room(console)
        wide = min(wide, options.max_width)
        if min(wide, high) > 0:
            size = self._size(wide, 2 * high)
            if self._made[0] != size:  # rich draws it several times a second
                self._made = size, list(_segments(self._scaled(size)))
            yield from self._made[1]

    def _size(self, wide: int, high: int) -> tuple[int, int]:
        """The size of the largest picture with these proportions, an even number of pixels high."""
        height, width = self._pixels.shape[:2]
        scale = min(wide / width, high / height)
        return max(1, int(scale * width)), max(2, int(scale * height) // 2 * 2)

    def _scaled(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        from PIL import Image

        return np.asarray(Image.fromarray(self._pixels).resize(size, Image.Resampling.BILINEAR))


def _segments(pixels: NDArray[np.uint8]) -> Iterator[Segment]:
    """Lines of text; equal neighbours share a segment."""
    both = np.concatenate([pixels[::2], pixels[1::2]], -1)
    for line in both:
        starts = [0, *(np.flatnonzero((line[1:] != line[:-1]).any(-1)) + 1).tolist(), len(line)]
        for first, end in itertools.pairwise(starts):
            front, back = (Color.from_rgb(*map(int, part)) for part in (line[first, :3], line[first, 3:]))
            yield Segment(_HALF * (end - first), Style(color=front, bgcolor=back))
        yield Segment.line()
