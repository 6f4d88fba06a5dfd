"""Pictures of several media, whose extinctions add: the host side of together.cl, add.cl and mix.cl.

Media in memory whose functions are of one kind are drawn by one kernel. Otherwise each medium adds, for a batch of successive
sample numbers, its samples to those of the others, by a kernel of its own filter; then light goes through the sums. An area of the
picture is completed before the next. Of a medium that is read by bricks those are resident, one after the other, which have samples
of the batch: each sample is in one of them.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import copied
from clvol.march.launch import Drawing, Inputs, launch, launched_over, lent_pictures, pictures_of
from clvol.march.window import boxes_of, brick_inputs, front_to_back, may_matter, pixels_of, pyramid_of, set_ends, share_of
from clvol.spline.lease import release

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.bricks.field import BrickedField
    from clvol.bricks.grid import Brick
    from clvol.filter.filter import Filter
    from clvol.march.frame import Frame
    from clvol.march.launch import Picture
    from clvol.march.window import Area
    from clvol.scene.camera import Viewpoint

__all__ = ["Bricked", "MediaDrawing", "drawing_of"]

_BATCH = 256  # samples of a ray between two mixings: what one medium hides of another in a batch is computed in vain
_ROOM = {"cpu": 1 << 27, "gpu": 1 << 28}  # bytes of a batch's sums; twice as many where each area reads bricks
_SLOT = 16  # bytes of the sums of a sample


def drawing_of(
    frame: Frame, rays: int | Literal["auto"], filter: str | Filter, expected: float = 0.0, *, bricked: Bricked | None = None
) -> Drawing:
    """The picture of a frame in progress, of one medium or of several."""
    if not frame.media:
        return Drawing(frame, rays, filter, expected)
    if bricked is None and frame.together:
        return _TogetherDrawing(frame, rays, filter, expected)
    return MediaDrawing(frame, rays, filter, expected, bricked=bricked)


class Bricked(NamedTuple):
    """What a picture of several media is read from: for each the function whose bricks are, or None where all is resident."""

    fields: tuple[BrickedField | None, ...]
    view: Viewpoint
    skipping: bool


class _Rays(NamedTuple):
    """The rays of an area on their way, on the device but for `frame` and `area`."""

    frame: Frame
    area: Area
    places: NDArray[np.float32] | None
    listed: Any
    states: Any
    fields: int  # numbers of each
    flags: Any
    sums: Any
    touched: Any


_Adding: TypeAlias = Callable[[float, int, NDArray[np.uint8]], None]
"""Adds a medium's samples from a number on, so many of them, to the tiles that are going."""


class _TogetherDrawing(Drawing):
    """A picture in progress, of several media in memory whose functions are of one kind: by together.cl."""

    def _make_ready(self) -> None:
        frame, count = self.frame, len(self.frame.media)
        self._kernel = frame.media[0].program("march/together.cl", added=True, media=count).kernel("draw_together")
        self._inputs = _InputsOfAll(frame)


class _InputsOfAll(Inputs):
    """Those of all media of a frame, and of the frame."""

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self._each = [Inputs(one) for one in frame.media]

    def of_rays(self, frame: Frame) -> tuple[Any, ...]:
        each = [inputs.of_rays(one) for inputs, one in zip(self._each, frame.media, strict=True)]
        return (*itertools.chain.from_iterable(each), frame.device.buffers.upload(frame.values[None]))


class MediaDrawing(Drawing):
    """A picture in progress, of several media; each adds its samples by a kernel of its own."""

    def __init__(
        self,
        frame: Frame,
        rays: int | Literal["auto"],
        filter: str | Filter,
        expected: float = 0.0,
        *,
        bricked: Bricked | None = None,
    ) -> None:
        self._bricked = bricked
        super().__init__(frame, rays, filter, expected)

    def _make_ready(self) -> None:
        frame, device, bricked = self.frame, self.frame.device, self._bricked
        self._inputs = Inputs(frame)
        fields = bricked.fields if bricked else (None,) * len(frame.media)
        self._media = [
            _Resident(one) if field is None or bricked is None else _ByBricks(one, field, bricked, frame.size, self._beside)
            for one, field in zip(frame.media, fields, strict=True)
        ]
        self._mixing = frame.program("march/mix.cl")
        self._batch = min(_BATCH, frame.planes.most)
        across, down = self._budget.least
        room = (
            _ROOM["cpu" if device.kind == "cpu" else "gpu"] * (1 if bricked is None else 2) // (_SLOT * self._batch * across * down)
        )
        self._pixels = max(1, room) * across * down

    def cast(self, rays: int, progress: Progress | None = None, until: float = math.inf) -> bool:
        frame, (width, height) = self.frame, self.frame.size
        last = min(self.rays, self.cast_rays + rays)
        begun = self.cast_rays > 0 or self._areas is not None
        with lent_pictures(frame, self.arrays, begun=begun) as buffers, self._room() as room:
            while self.cast_rays < last:
                i = self.cast_rays
                one = frame.sampled(*self._pattern[i], i, self.rays)
                if self._areas is None:
                    self._areas = self._tiles(width, height)
                for x, y, w, h in self._areas:
                    self._draw(one, (x, y, w, h), None, room, buffers)
                    if progress:
                        progress((i + min(1.0, ((y + h) * width) / (width * height))) / self.rays)
                    if time.perf_counter() > until and (x + w < width or y + h < height):
                        return False
                self._areas = None
                self.cast_rays += 1
        return True

    def of_area(self, frames: Sequence[Frame], area: Area, places: NDArray[np.float32] | None) -> dict[str, Picture]:
        """The pictures of an area that begins at a tile, by rays of these frames one after the other."""
        arrays, (x, y, width, height) = pictures_of(frames[0]), area
        for number, frame in enumerate(frames):
            with lent_pictures(frame, arrays, begun=number > 0) as buffers, self._room() as room:
                for left, top, w, h in self._tiles(width, height):
                    rows = None if places is None else places[top * width : (top + h) * width]
                    self._draw(frame, (x + left, y + top, w, h), rows, room, buffers)
        return {name: array[y : y + height, x : x + width].copy() for name, array in arrays.items()}

    def _cast_listed(self, rays: Frame, places: NDArray[np.float32], progress: Progress | None) -> dict[str, Picture]:
        arrays, (width, height) = pictures_of(rays), rays.size
        down = max(1, self._pixels // (width * rays.tile.height)) * rays.tile.height
        with lent_pictures(rays, arrays) as buffers, self._room() as room:
            for y in range(0, height, down):
                h = min(down, height - y)
                self._draw(rays, (0, y, width, h), places[y * width : (y + h) * width], room, buffers)
                if progress:
                    progress((y + h) / height)
        return arrays

    @contextmanager
    def _room(self) -> Iterator[tuple[Any, Any, Any]]:
        """Buffers for the states of an area's rays, the sums of a batch, and what of these is touched: nothing yet."""
        own, fields, pixels = self.frame.device.buffers, self.frame.mode.state_fields + 1, self._pixels
        flags = self._batch * pixels // (self.frame.tile.width * self.frame.tile.height)
        room = own.allocate(4 * fields * pixels), own.allocate(_SLOT * self._batch * pixels), own.allocate(4 * flags)
        try:
            own.clear(room[-1], 0, flags)
            yield room
        finally:
            release(self.frame.device, *room)

    def _tiles(self, width: int, height: int) -> Iterator[Area]:
        """Areas of whole tiles whose sums have room."""
        across, down = self._budget.least
        columns = min(-(-width // across), self._pixels // (across * down))
        w, h = columns * across, self._pixels // (columns * across * down) * down
        for y in range(0, height, h):
            for x in range(0, width, w):
                yield x, y, min(w, width - x), min(h, height - y)

    def _draw(
        self, frame: Frame, area: Area, places: NDArray[np.float32] | None, room: tuple[Any, Any, Any], buffers: list[Any]
    ) -> None:
        """The pixels of an area, from the first sample of their rays to their colours."""
        (x, y, width, height), tile, own = area, frame.tile, frame.device.buffers
        frame, (states, sums, touched) = frame.kept(x, y, width, height), room
        block, table = own.upload(frame.values[None]), self._inputs.table
        listed = table if places is None else own.upload(places)  # any buffer: it is not read
        going = np.zeros((-(-height // tile.height), -(-width // tile.width)), np.uint8)
        ends = np.zeros((*going.shape, 2), np.float32)
        flags, found = own.allocate(going.nbytes), own.allocate(ends.nbytes)
        launch(frame, self._mixing.kernel("begin_media"), area, block, listed, states, flags, found)
        own.download(flags, going)
        own.download(found, ends)
        mix, fields = self._mixing.kernel("mix_media"), frame.mode.state_fields + 1
        rays = area, places, listed, states, fields, flags, sums, touched
        first, last = float(ends[..., 0].min()), float(ends[..., 1].max())
        with ExitStack() as read:
            adding = [
                read.enter_context(medium.over(_Rays(one, *rays), going))
                for one, medium in zip(frame.media, self._media, strict=True)
            ]
            while going.any() and first <= last:
                count = int(min(self._batch, last - first + 1))
                for add in adding:
                    add(first, count, going)
                launch(frame, mix, area, block, listed, np.float32(first), np.int32(count), states, flags, sums, touched)
                own.download(flags, going)
                first += count
        finish = self._mixing.kernel("finish_media")
        launch(frame, finish, area, block, listed, states, *buffers)


class _Resident:
    """A medium whose coefficients are all on the device."""

    def __init__(self, frame: Frame) -> None:
        self._kernel, self._inputs = frame.program("march/add.cl", added=True).kernel("add_medium"), Inputs(frame)

    @contextmanager
    def over(self, rays: _Rays, going: NDArray[np.uint8]) -> Iterator[_Adding]:  # noqa: ARG002  # the kernel reads its own
        """What adds its samples to those of rays."""
        inputs = self._inputs.of_rays(rays.frame)

        def add(first: float, count: int, going: NDArray[np.uint8]) -> None:  # noqa: ARG001
            _add(rays, self._kernel, rays.area, inputs, (first, count), rays.states)

        yield add


class _ByBricks:
    """A medium of which bricks are resident, one at a time."""

    def __init__(self, frame: Frame, field: BrickedField, bricked: Bricked, size: tuple[int, int], beside: int) -> None:
        self._program, self._table = frame.program("march/add.cl", windowed=True, added=True), Inputs(frame).table
        self._field, self._view, self._skipping, self._whole, self._beside = field, bricked.view, bricked.skipping, size, beside

    @contextmanager
    def over(self, rays: _Rays, going: NDArray[np.uint8]) -> Iterator[_Adding]:
        """What adds its samples to those of rays."""
        field, store, skipping = self._field, self._field.store, self._skipping
        spans = [(brick, span) for brick in self._near(rays) if np.isfinite((span := self._span(rays, brick, going))[..., 0]).any()]
        kernel, own = self._program.kernel("add_medium"), rays.frame.device.buffers
        size = 4 * math.prod(rays.area[2:])
        states = own.allocate(size * rays.fields)

        def wanted(first: float, count: int, going: NDArray[np.uint8]) -> list[tuple[Brick, NDArray[np.bool_]]]:
            found = [(brick, (going > 0) & (span[..., 0] < first + count) & (span[..., 1] >= first)) for brick, span in spans]
            return [
                (brick, tiles) for brick, tiles in found if tiles.any() and may_matter(rays.frame, field, brick, skipping=skipping)
            ]

        def add(first: float, count: int, going: NDArray[np.uint8]) -> None:
            bricks = wanted(first, count, going)
            if bricks:
                own.copy(rays.states, states, size * rays.fields)
                own.clear(states, 0, size // 4)  # nothing is known of what lies before
            for number, (brick, tiles) in enumerate(bricks):
                with store.resident(brick) as part:
                    if number + 1 < len(bricks):
                        store.read_ahead(bricks[number + 1][0])
                    minmax = pyramid_of(rays.frame, field, part, skipping=skipping)
                    if may_matter(rays.frame, field, brick, skipping=skipping):  # again, with the bounds of the brick just read
                        inputs = brick_inputs(rays.frame, part, minmax, brick, field, self._table)
                        _add(rays, kernel, _box_of(tiles, rays), inputs, (first, count), states, share_of(field))

        store.expect([brick for brick, _ in spans])
        try:
            yield add
        finally:
            store.forget_ahead()
            release(rays.frame.device, states)

    def _near(self, rays: _Rays) -> Iterator[Brick]:
        """The bricks in which rays may have samples that are seen."""
        (x, y, width, height), places = rays.area, rays.places
        box = (x, y, x + width, y + height) if places is None else boxes_of(places.reshape(height, width, 2), height, width)[0, 0]
        for brick in front_to_back(self._field, self._view):
            if may_matter(rays.frame, self._field, brick, skipping=self._skipping):
                left, top, right, bottom = pixels_of(brick, self._view, self._field.volume.grid, *self._whole, self._beside)
                if box[0] <= right and box[1] <= bottom and box[2] >= left and box[3] >= top:
                    yield brick

    def _span(self, rays: _Rays, brick: Brick, going: NDArray[np.uint8]) -> NDArray[np.float32]:
        """For each tile the numbers of the first and the last sample that its rays may have in a brick."""
        frame, own = rays.frame, rays.frame.device.buffers
        values, span = copied(frame.values), np.empty((*going.shape, 2), np.float32)
        span[..., 0], span[..., 1] = math.inf, -math.inf
        set_ends(values, brick, frame)
        found = own.upload(span)
        launch(frame, self._program.kernel("span_of_brick"), rays.area, own.upload(values[None]), rays.listed, rays.flags, found)
        own.download(found, span)
        return span


def _add(
    rays: _Rays, kernel: Any, area: Area, inputs: tuple[Any, ...], batch: tuple[float, int], states: Any, share: float = 1.0
) -> None:
    """Add the samples of a medium, or of a brick of it, in which no more than this share of a ray's samples lies."""
    first, count = batch
    ends, share = (np.float32(first), np.float32(first + count - 1)), min(share, count / rays.frame.planes.most)
    sums = states, rays.flags, rays.sums, rays.touched
    for _ in launched_over(rays.frame, kernel, area, *inputs, rays.listed, *ends, *sums, share=share):
        pass


def _box_of(tiles: NDArray[np.bool_], rays: _Rays) -> Area:
    """The pixels of an area in which these tiles are."""
    (x, y, width, height), tile = rays.area, rays.frame.tile
    rows, columns = np.flatnonzero(tiles.any(1)), np.flatnonzero(tiles.any(0))
    left, top = int(columns[0]) * tile.width, int(rows[0]) * tile.height
    right, bottom = min(width, (int(columns[-1]) + 1) * tile.width), min(height, (int(rows[-1]) + 1) * tile.height)
    return x + left, y + top, right - left, bottom - top
