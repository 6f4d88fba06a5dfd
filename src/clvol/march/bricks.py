"""Pictures of volumes whose bricks are resident one at a time: the host side of bricks.cl.

Rays traverse the bricks front to back and carry their states on, so the picture is the same as without bricks. Bricks are skipped,
and never read, if no unfinished ray reaches them, or if none of their values is visible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.progress import part_of
from clvol.base.uniform import copied
from clvol.march.launch import Drawing, launched_over, lent_pictures, pictures_of
from clvol.march.window import Area, boxes_of, brick_inputs, front_to_back, may_matter, pixels_of, pyramid_of, set_ends, share_of
from clvol.spline.lease import release

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.bricks.field import BrickedField
    from clvol.bricks.grid import Brick
    from clvol.bricks.residents import Resident
    from clvol.bricks.source import LazyVolume
    from clvol.device.program import Program
    from clvol.filter.filter import Filter
    from clvol.march.frame import Frame
    from clvol.march.launch import Picture
    from clvol.scene.camera import Viewpoint
    from clvol.spline.minmax import MinMax
    from clvol.volume.volume import Volume

__all__ = ["STEPPED_AT_MOST", "BrickedDrawing", "Carried", "Pass", "fields_of", "level_of", "level_within", "nearest_to"]

STEPPED_AT_MOST = 3.0
"""Most voxels between two samples of a ray, if a picture depends on the function between them: the width of a brick's rim."""
_READ_AHEAD = 32  # bricks searched for the next one to read during a march
_ANY = 3e38  # bound of unknown values
_SHARE = 8  # of the budget, what states may take at a time


class BrickedDrawing(Drawing):
    """A picture in progress, of a volume that is read by bricks; its frame is of the whole volume, without a pyramid.

    Bricks in which nothing is visible are skipped with `skipping`.
    """

    def __init__(
        self,
        frame: Frame,
        rays: int | Literal["auto"],
        filter: str | Filter,
        field: BrickedField,
        view: Viewpoint,
        *,
        skipping: bool,
    ) -> None:
        super().__init__(frame, rays, filter)
        self._field, self._view, self._skipping = field, view, skipping

    def _make_ready(self) -> None:
        self._program = self.frame.program("march/bricks.cl", windowed=True)
        self._table = self.frame.uploaded_table()

    def cast(self, rays: int, progress: Progress | None = None, until: float = math.inf) -> bool:  # noqa: ARG002  # all or nothing
        """Cast `rays` more rays for each pixel, in one sweep over the bricks, or several if their states take much memory."""
        frame, (width, height) = self.frame, self.frame.size
        last = min(self.rays, self.cast_rays + rays)
        each = 4 * width * height * fields_of(frame)
        together = max(1, self._field.memory // _SHARE // each)
        while self.cast_rays < last:
            first, past = self.cast_rays, min(last, self.cast_rays + together)
            memory.require((past - first) * each, f"the states of {(past - first) * width * height} rays")
            frames = [frame.sampled(*self._pattern[i], i, self.rays) for i in range(first, past)]
            part = part_of(progress, first / last, past / last)
            self._sweep([(one, None) for one in frames], self.arrays, part, begun=first > 0)
            self.cast_rays = past
        return True

    def _cast_listed(self, rays: Frame, places: NDArray[np.float32], progress: Progress | None) -> dict[str, Picture]:
        arrays = pictures_of(rays)
        self._sweep([(rays, places)], arrays, progress)
        return arrays

    def _sweep(
        self,
        frames: list[tuple[Frame, NDArray[np.float32] | None]],
        arrays: dict[str, Picture],
        progress: Progress | None,
        *,
        begun: bool = False,
    ) -> None:
        """March the rays of each frame through the bricks, and write their results to `arrays`."""
        passes: list[Pass] = []
        try:
            for frame, places in frames:
                passes.append(self.begun(frame, places))
            self._go_through(passes, frames, progress)
            if progress:
                progress(1.0)
            with lent_pictures(frames[0][0], arrays, begun=begun) as buffers:
                for one in passes:
                    one.finish(buffers)
        finally:
            for one in passes:
                one.release()

    def _go_through(
        self,
        passes: list[Pass],
        frames: list[tuple[Frame, NDArray[np.float32] | None]],  # noqa: ARG002  # passes have theirs
        progress: Progress | None,
    ) -> None:
        """March the rays of each frame through all bricks."""
        self.march(passes, front_to_back(self._field, self._view), progress)

    def begun(self, frame: Frame, places: NDArray[np.float32] | None, area: Area | None = None) -> Pass:
        """The rays of a frame of the picture before the first brick: all, or those of an area that begins at a tile."""
        return Pass(frame, places, self._program, self._table, self._beside, self.frame, area)

    def march(self, passes: list[Pass], bricks: list[Brick], progress: Progress | None = None) -> None:
        """March rays through bricks in front-to-back order."""
        field = self._field
        bricks = self._sorted([brick for brick in bricks if self._may_matter(brick)])
        field.store.expect(bricks)
        try:
            for number, brick in enumerate(bricks):
                wanted = self._wanted(passes, brick)
                if wanted:
                    with field.store.resident(brick) as part:
                        for following in bricks[number + 1 : number + 1 + _READ_AHEAD]:
                            if self._wanted(passes, following):
                                field.store.read_ahead(following)
                                break
                        minmax = pyramid_of(self.frame, field, part, skipping=self._skipping)
                        if self._may_matter(brick):  # again, with the bounds of the brick just read
                            for one, area in wanted:
                                one.march(part, minmax, brick, field, area)
                if progress:
                    progress((number + 1) / len(bricks))
        finally:
            field.store.forget_ahead()

    def _sorted(self, bricks: list[Brick]) -> list[Brick]:
        """Bricks in the same order, or for modes that seek extremes, where the order is free, the most promising first."""
        sought = self.frame.mode.seeks
        if not self._skipping or sought == "any":
            return bricks
        ends = {brick.at: self._field.bounds.of(brick) or (-math.inf, math.inf) for brick in bricks}
        if sought == "largest":
            return sorted(bricks, key=lambda brick: -ends[brick.at][1])
        return sorted(bricks, key=lambda brick: ends[brick.at][0])

    def _wanted(self, passes: list[Pass], brick: Brick) -> list[tuple[Pass, Area]]:
        """The passes that may need a brick, each with the pixels that do.

        Before a brick is read, rays are tested against the known bounds of its values.
        """
        field = self._field
        wanted = [(one, area) for one in passes if (area := one.wanted(brick, self._view, field.volume.grid)) is not None]
        if not wanted or field.store.has(brick):
            return wanted
        ends = field.bounds.stored(brick) if self._skipping and self.frame.mode.skips else None
        return wanted if any(one.asks_for(brick, ends, area) for one, area in wanted) else []

    def _may_matter(self, brick: Brick) -> bool:
        """Whether some value in a brick may be visible, by its known bounds."""
        return may_matter(self.frame, self._field, brick, skipping=self._skipping)


@dataclass(frozen=True)
class Carried:
    """The states of the rays of an area of a picture between bricks, as planes [field, y, x]."""

    area: Area  # begins at a tile
    states: NDArray[np.float32]  # the mode's numbers, and how many samples were gathered
    shown: NDArray[np.float32]  # the colour and the normal where rays end, as far as these are kept


class Pass:
    """One ray for each pixel of a frame, or of an area that begins at a tile, or of a list, on its way through the bricks.

    `places`, shape (N, 2), are where the rays of a list cross the picture, in pixels of the frame `whole`. Between a ray and its
    pixel are at most `beside` pixels.
    """

    def __init__(
        self,
        frame: Frame,
        places: NDArray[np.float32] | None,
        program: Program,
        table: Any,
        beside: int,
        whole: Frame,
        area: Area | None = None,
    ) -> None:
        device, tile = frame.device, frame.tile
        self.area = x, y, width, height = (0, 0, *frame.size) if area is None else area
        self.frame = frame = frame.kept(x, y, width, height)
        self._beside = beside
        self._whole_size = whole.size
        self._boxes: NDArray[np.float32] | None = None
        self._program, self._table = program, table
        self._places = table  # any buffer: it is not read
        if places is not None:
            listed = np.ascontiguousarray(places.reshape(*frame.size[::-1], 2)[y : y + height, x : x + width])
            self._boxes, self._places = boxes_of(listed, tile.height, tile.width), device.buffers.upload(listed)
        self._memory = device.buffers.allocate(4 * width * height * (frame.mode.state_fields + 1))
        self._fields = frame.mode.state_fields + 1, fields_of(frame) - frame.mode.state_fields - 1
        self._shown = device.buffers.allocate(4 * max(1, width * height * self._fields[1]))
        self._going = np.zeros((-(-height // tile.height), -(-width // tile.width)), np.uint8)
        self._flags = device.buffers.upload(self._going)
        self._over("begin_states", self.area, self._block(), self._places, self._memory, self._flags)
        device.buffers.download(self._flags, self._going)

    def wanted(self, brick: Brick, view: Viewpoint, grid: Volume) -> Area | None:
        """The pixels whose rays may have samples in a brick, whole tiles; None if no ray of theirs wants any."""
        tile, (x, y, width, height) = self.frame.tile, self.area
        if self._boxes is None:
            left, top, right, bottom = pixels_of(brick, view, grid, *self.frame.size, self._beside)
            left, top = max(0, left - x) // tile.width, max(0, top - y) // tile.height
            right, bottom = -(-min(width, right - x) // tile.width), -(-min(height, bottom - y) // tile.height)
            if left >= right or top >= bottom:
                return None
            going = self._going[top:bottom, left:right]
        else:
            x0, y0, x1, y1 = pixels_of(brick, view, grid, *self._whole_size, self._beside)
            boxes = self._boxes
            meets = (boxes[..., 0] <= x1) & (boxes[..., 1] <= y1) & (boxes[..., 2] >= x0) & (boxes[..., 3] >= y0)
            left, top, going = 0, 0, self._going & meets
        rows, columns = np.flatnonzero(going.any(1)), np.flatnonzero(going.any(0))
        if not len(rows):
            return None
        top, bottom = top + int(rows[0]), top + int(rows[-1]) + 1
        left, right = left + int(columns[0]), left + int(columns[-1]) + 1
        left, top, right, bottom = left * tile.width, top * tile.height, right * tile.width, bottom * tile.height
        return x + left, y + top, min(width, right) - left, min(height, bottom) - top

    def asks_for(self, brick: Brick, ends: tuple[float, float] | None, area: Area) -> bool:
        """Whether any ray of an area meets a brick, and stored values between its `ends` could change the ray's result."""
        device, values, found = self.frame.device, copied(self.frame.values), np.zeros(1, np.int32)
        set_ends(values, brick, self.frame)
        low, high = (-_ANY, _ANY) if ends is None else ends
        wanted = device.buffers.upload(found)
        block = device.buffers.upload(values[None])
        arguments = block, self._table, self._places, self._memory, self._flags, np.float32(low), np.float32(high), wanted
        self._over("ask_brick", area, *arguments)
        device.buffers.download(wanted, found)
        return bool(found[0])

    def march(self, own: Resident, minmax: MinMax | None, brick: Brick, field: BrickedField, area: Area) -> None:
        """March rays through a resident brick."""
        inputs = brick_inputs(self.frame, own, minmax, brick, field, self._table)
        rays = self._places, self._memory, self._shown, self._flags
        self._over("march_brick", area, *inputs, *rays, share=share_of(field))
        self.frame.device.buffers.download(self._flags, self._going)

    @property
    def going(self) -> bool:
        """Whether any ray is unfinished."""
        return bool(self._going.any())

    def carried(self) -> Carried:
        """The states of the area's rays, for another process to resume."""
        planes = []
        for buffer, count in zip((self._memory, self._shown), self._fields, strict=True):
            with self._planes(buffer, count, write=False) as present:
                planes.append(present.copy())
        return Carried(self.area, planes[0], planes[1])

    def take(self, carried: Carried) -> None:
        """Set the states of rays of the area, or of a part of it, after other bricks."""
        for buffer, given in ((self._memory, carried.states), (self._shown, carried.shown)):
            with self._planes(buffer, len(given), write=True, area=carried.area) as present:
                present[...] = given

    def resume(self, carried: Carried) -> None:
        """Resume rays with these states."""
        self.take(carried)
        self._over("resume_states", carried.area, self._block(), self._places, self._memory, self._flags)
        self.frame.device.buffers.download(self._flags, self._going)

    def merge(self, back: Pass) -> None:
        """Merge the states of rays through the bricks behind into these: see `merge_states`."""
        buffers = self._memory, self._shown, back._memory, back._shown
        self._over("merge_bricks", self.area, self._block(), self._places, *buffers)

    @contextmanager
    def _planes(self, buffer: Any, count: int, *, write: bool, area: Area | None = None) -> Iterator[NDArray[np.float32]]:
        """The planes of pixels in a buffer, over an area: [plane, y, x]."""
        (left, top, width, height), (x, y, w, h) = self.area, area or self.area
        if not count:
            yield np.empty((0, h, w), np.float32)
            return
        with self.frame.device.buffers.mapped(buffer, (count, height, width), write=write) as whole:
            yield whole[:, y - top : y - top + h, x - left : x - left + w]

    def finish(self, buffers: list[Any]) -> None:
        """Write the rays' results to pictures."""
        nothing, nowhere = self._table, np.zeros(4, np.int32)  # in place of coefficients, which are not read
        rays = self._table, self._places, self._memory, self._shown
        self._over("finish_bricks", self.area, nothing, nowhere, self._block(), *rays, *buffers)

    def _block(self) -> Any:
        """The frame's parameters on the device."""
        return self.frame.device.buffers.upload(self.frame.values[None])

    def _over(self, kernel: str, area: Area, *arguments: Any, share: float = 0.0) -> None:
        """Run a kernel over an area; it takes at most this share of the rays' samples."""
        for _ in launched_over(self.frame, self._program.kernel(kernel), area, *arguments, share=share):
            pass

    def release(self) -> None:
        """Free the device's memory."""
        release(self.frame.device, self._memory, self._shown)


def level_of(volume: LazyVolume, view: Viewpoint, size: tuple[int, int], pixels: float) -> int:
    """The coarsest level whose voxels span at most `pixels` where the volume is nearest to the viewer; 0 is the finest."""
    nearest = 1.0 if view.orthographic else nearest_to(volume, view)
    return level_within(volume, pixels * 2 * view.half_height * nearest / size[1])


def nearest_to(volume: LazyVolume, view: Viewpoint) -> float:
    """How far ahead of the eye the volume's nearest corner is, along the view; little where that is behind it."""
    return max(float(((volume.grid.corners - view.eye) @ view.forward).min()), 1e-6 * volume.grid.radius)


def level_within(volume: LazyVolume, length: float) -> int:
    """The coarsest level whose voxels are at most `length` long."""
    return max((i for i, level in enumerate((volume, *volume.levels)) if max(level.spacing) <= length), default=0)


def fields_of(frame: Frame) -> int:
    """Numbers stored for each ray."""
    mode = frame.mode
    return mode.state_fields + 1 + 3 * mode.finished_there + 3 * frame.guides
