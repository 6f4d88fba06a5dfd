"""Launches of the ray loop's kernels: the fused `draw`, and the same in parts."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.base.progress import part_of
from clvol.base.srgb import as_light, as_shown
from clvol.march.pixels import DEFAULT_PIXEL_FILTER, EDGE_RAYS, as_pixel_filter, on_edges, pixel_rays
from clvol.spline.build import row_reach, row_width
from clvol.spline.coefficients import Coefficients

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.filter.filter import Filter
    from clvol.march.frame import Frame

__all__ = [
    "BEFORE_EDGES",
    "CHANNELS",
    "Drawing",
    "Inputs",
    "Picture",
    "States",
    "draw",
    "drawn",
    "finish_states",
    "launch",
    "launched_over",
    "lent_pictures",
    "march_rays",
    "merge_states",
    "pictures_of",
]

Picture: TypeAlias = NDArray[np.floating[Any]]
"""float32, except positions, which are float64."""

CHANNELS: dict[str, tuple[int, ...]] = {"rgba": (4,), "depth": (), "normal": (3,), "position": (3,), "visited": (), "value": ()}
BEFORE_EDGES = 0.75
"""Share of the progress before the edges, for a picture with more rays on them."""
_ALONE, _BLENDED = 20, 64  # at most one pixel in n has more rays; fewer with blended planes, which such rays do not share
_GROUP = 8  # work-items along an edge of a group
_AREA = 8  # pixels along an edge of the smallest launch
_STEP = 0.005  # seconds
_FASTER = 16  # most rays are this many times faster than the first guess, which is for the slowest
_DEAF = 0.25  # seconds; longest launch by the guess, whatever was measured
_LONG = 0.05  # seconds; shorter waits are not divided into steps
_FORGOTTEN = 0.8  # decay of the time of a slow launch with each further launch
_SCATTERED = 8  # a guess: a ray without near neighbours takes at most this many times as long
_FINDING = 0.2  # share of the progress of edges until they are found
_EDGE_TILE = 16  # pixels along the squares by which pixels on edges are ordered
_SET_UP = 2.0  # samples that a ray takes as long as to be begun
_CELLS = 8  # a guess: cells on a ray for each one that is evaluated
_ROW_SECONDS = 1.5e-9  # a generous guess of the time of a row of taps on a CPU core; corrected as tiles finish
_SHADED, _CENTRAL, _SOFTWARE = 3, 12, 8  # times as long with the gradient, with central differences, from images on a CPU


def draw(
    frame: Frame, rays: int | Literal["auto"] = 1, filter: str | Filter = DEFAULT_PIXEL_FILTER, progress: Progress | None = None
) -> dict[str, Picture]:
    """The picture of a frame with `rays` a pixel, and its guides if the frame has them; each (height, width, ...).

    With "auto" one, and `EDGE_RAYS` in pixels on edges of that picture (`on_edges`).

    Guides are those of the ray through the pixel's middle, which is cast for them if the picture does not need it.
    """
    return drawn(Drawing(frame, rays, filter), rays, progress)


def drawn(drawing: Drawing, rays: int | Literal["auto"], progress: Progress | None = None) -> dict[str, Picture]:
    """The pictures of a drawing with `rays` a pixel, once it is complete."""
    share = 1.0 if rays != "auto" else BEFORE_EDGES
    drawing.cast(drawing.rays, part_of(progress, 0, share))
    if rays == "auto":
        drawing.smooth_edges(part_of(progress, share, 1))
    return _in_world(drawing.frame, drawing.arrays)


class Drawing:
    """A picture in progress: rays are cast in launches, and progress is reported between them.

    A callback that raises ends the drawing. Between calls, only the frame's buffers are on the device. `expected` are the seconds
    that one ray of each pixel should take, if known. Of `rays` a pixel `cast_rays` were cast; until all were, `arrays` are sums,
    which `shown` converts to a picture.
    """

    def __init__(
        self, frame: Frame, rays: int | Literal["auto"] = 1, filter: str | Filter = DEFAULT_PIXEL_FILTER, expected: float = 0.0
    ) -> None:
        self.frame = frame
        self._filter = as_pixel_filter(filter)
        self._pattern = pixel_rays(1 if rays == "auto" else rays, self._filter, middle=frame.guides)
        self._budget = _Budget(frame)
        self._budget.expect(expected / math.prod(frame.size))
        self._areas: Iterator[tuple[int, int, int, int]] | None = None  # of the ray in progress
        self.rays, self.cast_rays = len(self._pattern), 0
        self.arrays = pictures_of(frame)
        self._make_ready()

    @property
    def _beside(self) -> int:
        """Most pixels between a ray and its pixel."""
        return math.ceil(max(float(np.abs(offset - 0.5).max()) for offset, _ in self._pattern))

    def _make_ready(self) -> None:
        """Build the kernel and upload its inputs."""
        frame = self.frame
        self._kernel = frame.program("march/draw.cl").kernel("draw")
        self._inputs: Inputs = frame.once("inputs", lambda: Inputs(frame))

    def cast(self, rays: int, progress: Progress | None = None, until: float = math.inf) -> bool:
        """Cast `rays` more rays for each pixel; returns whether it finished.

        Stops after the launch in which `time.perf_counter` passes `until`; the next call resumes.
        """
        frame, (width, height), kernel = self.frame, self.frame.size, self._kernel
        last = min(self.rays, self.cast_rays + rays)
        with lent_pictures(frame, self.arrays, begun=self.cast_rays > 0 or self._areas is not None) as buffers:
            while self.cast_rays < last:
                i = self.cast_rays
                arguments = *self._of_ray(i), self._inputs.table, *buffers
                if self._areas is None:
                    self._areas = self._budget.tiles(width, height)
                for x, y, w, h in _launched(frame, kernel, self._areas, self._budget, *arguments):
                    if progress:
                        progress((i + min(1.0, ((y + h) * width) / (width * height))) / self.rays)
                    if time.perf_counter() > until and (x + w < width or y + h < height):
                        return False
                self._areas = None
                self.cast_rays += 1
        return True

    def _of_ray(self, i: int) -> tuple[Any, ...]:
        """The first arguments for a ray of each pixel; those of a single one are the frame's, however often it is drawn."""
        frame, ray = self.frame, partial(self.frame.sampled, *self._pattern[i], i, self.rays)
        if self.rays > 1:
            return self._inputs.of_rays(ray())
        return frame.once(("ray", self._filter), lambda: self._inputs.of_rays(ray()))  # type: ignore[no-any-return]

    def shown(self) -> Picture:
        """A copy of the picture by the rays that were cast; at least one."""
        picture: Picture = self.arrays["rgba"].copy()
        if self.cast_rays == self.rays:
            return picture
        picture /= sum(weight for _, weight in self._pattern[: self.cast_rays])
        block, colors, opacity = self.frame.values["picture"], picture[..., :3], picture[..., 3:]
        if block["opaque"]:
            colors += (1 - opacity) * block["behind"]
            opacity[...] = 1
        else:
            np.divide(colors, opacity, out=colors, where=opacity > 0)
        np.clip(picture, 0, 1, out=picture)
        if block["linear"]:
            colors[...] = as_shown(colors)
        return picture

    def smooth_edges(self, progress: Progress | None = None) -> None:
        """Adds rays to those of the pixels on edges of a picture of one ray a pixel, which went through its middle."""
        frame, picture = self.frame, self.arrays["rgba"]
        most = _BLENDED if frame.tile.shared and not frame.mode.stretches else _ALONE
        pixels = on_edges(picture, most, part_of(progress, 0, _FINDING))
        if len(pixels):
            self._smooth(picture, pixels, progress)
        if progress:
            progress(1.0)

    def _smooth(self, picture: Picture, pixels: NDArray[np.intp], progress: Progress | None) -> None:
        frame = self.frame
        (_, share), *more = pixel_rays(EDGE_RAYS, self._filter, middle=True)
        pixels = pixels[np.lexsort((pixels // _EDGE_TILE).T[::-1])]  # neighbours together, which for example cross the same bricks
        offsets, weights = zip(*more, strict=True)
        places = (pixels[:, None, ::-1].astype(np.float32) + np.array(offsets, np.float32)).reshape(-1, 2)
        width = frame.tile.width if frame.tile.shared else _GROUP  # so that neighbours share a tile or a group
        height = -(-len(places) // width)
        rays = frame.once(("listed", width, height), lambda: frame.of_rays(width, height))
        arrays = self._cast_listed(rays, np.resize(places, (width * height, 2)), part_of(progress, _FINDING, 1))
        colors = arrays["rgba"].reshape(-1, 4)[: len(places)].reshape(len(pixels), -1, 4)
        where = tuple(pixels.T)
        first, block = picture[where], frame.values["picture"]
        opaque, linear = bool(block["opaque"]), bool(block["linear"])
        if linear:
            first[:, :3] = as_light(first[:, :3])
        if not opaque:
            first[:, :3] *= first[:, 3:]
        means = np.einsum("prc,r->pc", colors, np.array(weights, np.float32))
        if opaque:
            means[:, :3] += (1 - share - means[:, 3:]) * block["behind"]
            means[:, 3] = 1 - share
        means += share * first
        if not opaque:
            np.divide(means[:, :3], means[:, 3:], out=means[:, :3], where=means[:, 3:] > 0)
        means = np.clip(means, 0, 1)
        if linear:
            means[:, :3] = as_shown(means[:, :3])
        picture[where] = means

    def _cast_listed(self, rays: Frame, places: NDArray[np.float32], progress: Progress | None) -> dict[str, Picture]:
        """Cast a list of rays that cross the picture at these places."""
        budget, device, (width, height) = self._budget, rays.device, rays.size
        listed = device.buffers.upload(places)
        arrays = pictures_of(rays)
        budget.slow_down(_SCATTERED)
        with lent_pictures(rays, arrays) as buffers:
            inputs = rays.once("rays", lambda: self._inputs.of_rays(rays))
            areas, arguments = budget.tiles(width, height), (*inputs, listed, *buffers)
            for _, y, _, h in _launched(rays, self._kernel, areas, budget, *arguments):
                if progress:
                    progress((y + h) / height)
        return arrays


# -- in parts ----------------------------------------------------------------------------------------------


class States:
    """The states of a frame's rays after some of their samples, on the device.

    `buffer` is float32 of shape (fields, height, width): the mode's fields, and the number of gathered samples.
    """

    def __init__(self, frame: Frame) -> None:
        width, height = frame.size
        self.frame = frame
        self.buffer = frame.device.buffers.allocate(4 * (frame.mode.state_fields + 1) * width * height)

    def argument(self, other: Frame) -> Any:
        """The buffer, for kernels of a frame with the same size, mode and volume; else, or once released, `OptionError`."""
        if self.buffer is None:
            raise OptionError("the states were released; march new ones")
        mine, theirs = ((f.size, f.mode, f.coefficients) for f in (self.frame, other))
        if mine != theirs:
            raise OptionError(f"states must be of one picture's size, mode and volume; got {mine[:2]} and {theirs[:2]}")
        return self.buffer

    def release(self) -> None:
        """Free the device's memory."""
        if self.buffer is not None:
            self.buffer.release()
            self.buffer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def march_rays(frame: Frame, first: float = -math.inf, last: float = math.inf, states: States | None = None) -> States:
    """The rays through the middles of the pixels after samples number `first` to `last`.

    Samples count from the first plane that a ray of the picture may cross. `states`, those after the samples before `first`, are
    updated and returned. By default rays start fresh; a mode that compares adjacent samples then also takes those before `first`.
    """
    if states is None and first > -math.inf and "BETWEEN" in frame.defines():
        raise OptionError(f"rays with virtual samples begin with their first sample, or go on from states; got first={first:g}")
    if frame.casts:
        raise OptionError("rays of stretches reach no light: shadow_rays must be left out, or the picture drawn whole")
    kernel, inputs = frame.program("march/split.cl").kernel("march_rays"), Inputs(frame)
    carried, states = states is not None, States(frame) if states is None else states
    buffer = states.argument(frame)
    budget = _Budget(frame)
    arguments = *inputs.of_rays(frame), np.float32(first), np.float32(last), np.int32(carried), buffer
    for _ in _launched(frame, kernel, budget.tiles(*frame.size), budget, *arguments):
        pass
    return states


def merge_states(front: States, back: States) -> States:
    """Merge two stretches of the same rays into the front one.

    The picture is that of one stretch: bit by bit for surfaces and extremes, within 1e-6 for sums of values, and within 1e-6 plus
    the mode's `termination` for light: a stretch does not know the transmittance of the one in front.
    The depth of "composite" is that at which one stretch alone stops half of its light; states that are carried on
    (`march_rays`) give the exact depth.
    """
    frame = front.frame
    buffers = front.argument(frame), back.argument(frame)
    kernel = frame.program("march/split.cl").kernel("merge_states")
    block = frame.device.buffers.upload(frame.values[None])
    launch(frame, kernel, (0, 0, *frame.size), block, *buffers)
    return front


def finish_states(states: States) -> dict[str, Picture]:
    """The picture of rays in these states, and its guides, as from `draw`."""
    frame, buffer = states.frame, states.argument(states.frame)
    kernel, inputs = frame.program("march/split.cl").kernel("finish_states"), Inputs(frame)
    block = frame.device.buffers.upload(frame.values[None])
    arrays = pictures_of(frame)
    with lent_pictures(frame, arrays) as buffers:
        launch(frame, kernel, (0, 0, *frame.size), inputs.source, inputs.extent, block, inputs.table, buffer, *buffers)
    return _in_world(frame, arrays)


# -- launches ----------------------------------------------------------------------------------------------


class Inputs:
    """The inputs of a frame's kernels, on the device."""

    def __init__(self, frame: Frame) -> None:
        held = frame.coefficients
        self.table = frame.uploaded_table()
        self.source = held.argument(frame.evaluator) if isinstance(held, Coefficients) else self.table  # bricks come one at a time
        self.extent = held.extent
        self.minmax = self.table if frame.minmax is None else frame.minmax.buffer  # any buffer: it is not read
        self.sides = self.table if frame.sides is None else frame.sides
        self.missing = self.table if frame.gaps is None else frame.gaps.buffer

    def of_rays(self, frame: Frame) -> tuple[Any, ...]:
        """The first arguments of kernels that march rays, with the parameters of this frame: the same, or one of its rays."""
        block = frame.device.buffers.upload(frame.values[None])
        return self.source, self.extent, self.minmax, self.sides, self.missing, block, self.table


def pictures_of(frame: Frame) -> dict[str, Picture]:
    """Arrays for a frame's pictures."""
    width, height = frame.size
    return {name: np.empty((height, width, *n), np.float32) for name, n in CHANNELS.items() if frame.guides or name == "rgba"}


@contextlib.contextmanager
def lent_pictures(frame: Frame, arrays: dict[str, Picture], *, begun: bool = False) -> Iterator[list[Any]]:
    """Buffers through which kernels write a frame's pictures; `begun` if these already have content."""
    unused = [frame.once("unused", lambda: frame.device.buffers.allocate(4))] * (len(CHANNELS) - len(arrays))  # never written
    with contextlib.ExitStack() as lent:
        yield [lent.enter_context(frame.device.buffers.lent(array, write=True, begun=begun)) for array in arrays.values()] + unused


def _in_world(frame: Frame, arrays: dict[str, Picture]) -> dict[str, Picture]:
    """The pictures in the world: kernels write positions relative to the volume's centre, and values as they are stored."""
    if not frame.guides:
        return arrays
    if frame.moves:
        arrays["pose"] = np.concatenate([arrays["normal"], arrays["position"]], -1)
        arrays["normal"], arrays["position"] = (np.full_like(arrays[name], np.nan) for name in ("normal", "position"))
    arrays["position"] = arrays["position"] + frame.coefficients.volume.center
    stored = frame.coefficients.stored
    if frame.mode.shows != "integral" and not stored.identity:
        arrays["value"] = stored.values(arrays["value"])
    return arrays


def launch(frame: Frame, kernel: Any, area: tuple[int, int, int, int], *arguments: Any, long: bool = False) -> None:
    """Launch over the pixels of an area (x, y, width, height) that begins at a tile, and wait; `long` if it may take long."""
    (x, y, w, h), tile, device = area, frame.tile, frame.device
    shape = (1, 1) if tile.shared or device.kind == "cpu" else (_GROUP, _GROUP)  # PoCL builds loops over a group for long
    tiles = (-(-w // tile.width), -(-h // tile.height))
    items = tuple(-(-n // m) * m for n, m in zip(tiles, shape, strict=True))
    with device.errors:
        event = kernel(device.queue, items, shape, *arguments, global_offset=(x // tile.width, y // tile.height))
        if long:
            device.queue.flush()
            _await(event)
    device.finish()


def _launched(
    frame: Frame, kernel: Any, areas: Iterator[tuple[int, int, int, int]], budget: _Budget, *arguments: Any
) -> Iterator[tuple[int, int, int, int]]:
    """Launch over each area, and yield it when done."""
    for area in areas:
        pixels, started = area[2] * area[3], time.perf_counter()
        launch(frame, kernel, area, *arguments, long=budget.exceeded(pixels))
        budget.spent(pixels, time.perf_counter() - started)
        yield area


def launched_over(
    frame: Frame, kernel: Any, area: tuple[int, int, int, int], *arguments: Any, share: float = 1.0
) -> Iterator[None]:
    """Run a kernel over an area that begins at a tile, in short launches; it takes at most this share of the rays' samples."""
    left, top, width, height = area
    budget = _Budget(frame, share)
    areas = ((left + x, top + y, w, h) for x, y, w, h in budget.tiles(width, height))
    for _ in _launched(frame, kernel, areas, budget, *arguments):
        yield


def _await(event: Any) -> None:
    """Wait for a launch in small steps, in between which signals are handled; the runtime's wait does not handle them."""
    while event.command_execution_status > 0:  # CL_COMPLETE
        time.sleep(_STEP)


class _Budget:
    """Cuts a frame into areas, none of which should take longer than the device's limit for a launch.

    The time of a ray is bounded by its number of planes, or guessed from its number of cells, few of which are evaluated; what
    areas take corrects that, at once where they take longer, and else slowly: the next area may hold what this one did not.
    Most rays take far less than the first guess. Where launches are short so that nobody waits long for the end of what nobody
    wants, what was measured decides, and the guess that none takes longer than `_DEAF`; a limit beyond that holds for the guess.
    `share`: of a ray's samples, those that are taken at most.
    """

    def __init__(self, frame: Frame, share: float = 1.0) -> None:
        device, drawn = frame.device, frame.coefficients.filter
        cores = device.units * (1 if device.kind == "cpu" else 32)
        chunks = row_reach(drawn) // row_width(drawn)
        together = frame.tile.shared and not frame.planes.oblique
        rows = drawn.support * chunks / 2 + 2 if together else drawn.support**2 * chunks + 8
        rows *= _CENTRAL if frame.central else _SHADED if frame.mode.shaded else 1
        count: float = frame.planes.count
        if frame.mode.stretches:  # gradients are of hits alone
            order = drawn.degree + 1
            rows = drawn.support**2 * order * (drawn.support + order) / 32 + 40  # a polynomial, and traversal
            count = float(frame.coefficients.size.sum()) * drawn.scale / _CELLS
        rows *= max(1, len(frame.media))
        count = max(_SET_UP, share * count)
        if frame.evaluator.image and device.kind == "cpu":
            rows *= _SOFTWARE
        self._across, self._down = (-(-_AREA // n) * n for n in frame.tile[:2])
        self._seconds = device.limits.launch_seconds
        self._per_pixel = self._guess = count * rows * _ROW_SECONDS / max(1, cores)
        self._least = self._guess / _FASTER  # rays that meet nothing do not predict others

    def exceeded(self, pixels: int) -> bool:
        """Whether `pixels` may take longer than a launch should: a tile with very many samples cannot be divided."""
        return pixels * self._per_pixel > max(self._seconds, _LONG)

    def spent(self, pixels: int, seconds: float) -> None:
        """Learn from a launch over `pixels` that took `seconds`."""
        self._per_pixel = max(self._least, _FORGOTTEN * self._per_pixel, seconds / pixels)

    def expect(self, seconds: float) -> None:
        """Use a measured average time of a pixel, if not 0: some take three times as long."""
        if seconds:
            self._per_pixel = self._least = 3 * seconds

    def slow_down(self, times: float) -> None:
        """Expect the next areas to take `times` as long, at first."""
        self._per_pixel *= times

    @property
    def least(self) -> tuple[int, int]:
        """Pixels across and down of the smallest area, whole tiles."""
        return self._across, self._down

    @property
    def _pixels(self) -> float:
        """Pixels of the next area."""
        return min(self._seconds / self._per_pixel, max(self._seconds, _DEAF) / self._guess)

    def tiles(self, width: int, height: int) -> Iterator[tuple[int, int, int, int]]:
        """(x, y, width, height) of each area, a multiple of a tile except at the picture's edges."""
        y = 0
        while y < height:
            area = self._pixels
            h = min(height - y, max(1, int(area / width) // self._down) * self._down)
            x = 0
            while x < width:
                w = min(width - x, max(1, int(self._pixels / h) // self._across) * self._across)
                yield x, y, w, h
                x += w
            y += h
