"""Pictures of several media, whose extinctions add: the host side of add.cl and mix.cl.

For a batch of successive sample numbers each medium adds its samples to those of the others, by a kernel of its own filter; then
light goes through the sums. An area of the picture is completed before the next.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clvol.march.launch import Drawing, Inputs, launch, launched_over, lent_pictures, pictures_of
from clvol.spline.lease import release

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.filter.filter import Filter
    from clvol.march.bricks import Area
    from clvol.march.frame import Frame
    from clvol.march.launch import Picture

__all__ = ["MediaDrawing", "drawing_of"]

_BATCH = 256  # samples of a ray between two mixings: what one medium hides of another in a batch is computed in vain
_ROOM = {"cpu": 1 << 27, "gpu": 1 << 28}  # bytes of a batch's sums
_SLOT = 16  # bytes of the sums of a sample


def drawing_of(frame: Frame, rays: int | Literal["auto"], filter: str | Filter, expected: float = 0.0) -> Drawing:
    """The picture of a frame in progress, of one medium or of several."""
    return (MediaDrawing if frame.media else Drawing)(frame, rays, filter, expected)


class MediaDrawing(Drawing):
    """A picture in progress, of several media."""

    def _make_ready(self) -> None:
        frame, device = self.frame, self.frame.device
        self._inputs = Inputs(frame)
        self._adding = [(one.program("march/add.cl", added=True).kernel("add_medium"), Inputs(one)) for one in frame.media]
        self._mixing = frame.program("march/mix.cl")
        self._batch = min(_BATCH, frame.planes.most)
        across, down = self._budget.least
        room = _ROOM["cpu" if device.kind == "cpu" else "gpu"] // (_SLOT * self._batch * across * down)
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
        block, table, inputs = own.upload(frame.values[None]), self._inputs.table, self._inputs
        listed = table if places is None else own.upload(places)  # any buffer: it is not read
        going = np.zeros((-(-height // tile.height), -(-width // tile.width)), np.uint8)
        ends = np.zeros((*going.shape, 2), np.float32)
        flags, found = own.allocate(going.nbytes), own.allocate(ends.nbytes)
        launch(frame, self._mixing.kernel("begin_media"), area, block, listed, states, flags, found)
        own.download(flags, going)
        own.download(found, ends)
        mix = self._mixing.kernel("mix_media")
        adding = [
            (one, kernel, given.of_rays(own.upload(one.values[None])))
            for one, (kernel, given) in zip(frame.media, self._adding, strict=True)
        ]
        first, last = float(ends[..., 0].min()), float(ends[..., 1].max())
        while going.any() and first <= last:
            count = int(min(self._batch, last - first + 1))
            span = np.float32(first), np.float32(first + count - 1)
            share = count / frame.planes.most
            for one, kernel, arguments in adding:
                for _ in launched_over(one, kernel, area, *arguments, listed, *span, states, flags, sums, touched, share=share):
                    pass
            launch(frame, mix, area, block, listed, span[0], np.int32(count), states, flags, sums, touched)
            own.download(flags, going)
            first += count
        finish = self._mixing.kernel("finish_media")
        launch(frame, finish, area, inputs.source, inputs.extent, block, table, listed, states, *buffers)
