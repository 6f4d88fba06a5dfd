"""Pictures by the workers of a cluster: each reads some of the bricks, and rays are passed from worker to worker, or merged.

A kd-tree divides the bricks into boxes, so that they have a visibility order from every view, and the picture is divided into
areas. "order": the states of an area's rays go from box to box, front to back, while other boxes work on other areas; the picture
equals that of a single process to the last bit, and hidden boxes are not read. "tree": rays go through all boxes at once, and
their states are merged in pairs; no box waits for another, but hidden boxes are read.

Of several media each worker draws areas of the picture, and reads what it sees: samples of all media go together before light goes
through them, so that rays stay where they are. The picture is that of one process, to the last bit.
"""

from __future__ import annotations

import itertools
import math
import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClusterError, DeviceError, OptionError, OutOfMemoryError
from clvol.bricks.field import BrickedField
from clvol.bricks.grid import Brick
from clvol.bricks.source import memory_for
from clvol.dask.cluster import (
    LostError,
    PoisonError,
    WorkerLock,
    as_cluster,
    local_rank,
    local_size,
    version,
    worker_address,
    worker_device,
)
from clvol.device import Device
from clvol.march.bricks import BrickedDrawing
from clvol.march.frame import tile_of
from clvol.march.gaps import Gaps
from clvol.march.launch import pictures_of
from clvol.march.media import Bricked, MediaDrawing
from clvol.march.window import boxes_of, front_to_back, pixels_of
from clvol.scene.clip import triple

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.bricks.source import Index, LazyVolume
    from clvol.dask.cluster import Cluster, ClusterLike
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.march.bricks import Carried, Pass
    from clvol.march.frame import Frame
    from clvol.march.launch import Picture
    from clvol.march.options import Merge
    from clvol.march.window import Area
    from clvol.scene.camera import Viewpoint
    from clvol.volume.volume import Volume

__all__ = ["ClusterDrawing", "ClusterMediaDrawing", "Group", "Shared", "Workers", "groups_of", "visible"]

_GROUPS = 4  # boxes for each worker
_AREAS = 4  # areas of a picture for each worker
_AREAS_OF_MEDIA = 2  # the same of several media: what areas share is read by several workers
_SMALLEST = 32  # pixels; the edges of areas are multiples of it
_LEAST = 32  # samples along the smallest edge of a brick: margins are as wide as that
_FIELDS = 4  # fields that a worker keeps
_T = TypeVar("_T")


# -- groups of bricks ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """A box of bricks: `first <= at < stop` along x, y and z."""

    number: int
    first: Index
    stop: Index

    def box(self, field: BrickedField) -> Brick:
        """The group's domain, as that of a single brick."""
        x, y, z = (n - 1 for n in self.stop)
        one, other = field.bricks[self.first], field.bricks[x, y, z]
        return Brick(self.first, one.low, other.high, one.first, other.last)

    def bricks(self, field: BrickedField, view: Viewpoint) -> list[Brick]:
        """The group's bricks, front to back."""
        return front_to_back(field, view, (self.first, self.stop))


@dataclass(frozen=True)
class _Halves:
    """A box divided along an axis, before brick number `at`."""

    axis: int
    at: int
    low: _Tree
    high: _Tree


_Tree: TypeAlias = "Group | _Halves"


def groups_of(counts: Index, most: int) -> _Tree:
    """`counts` bricks along x, y and z, halved along the longest axis until there are `most` boxes."""
    numbers = itertools.count()

    def cut(first: Index, stop: Index, share: int) -> _Tree:
        size = [b - a for a, b in zip(first, stop, strict=True)]
        axis = max(range(3), key=lambda i: size[i])
        if share < 2 or size[axis] < 2:
            return Group(next(numbers), first, stop)
        at = first[axis] + size[axis] // 2
        end, begin = list(stop), list(first)
        end[axis] = begin[axis] = at
        return _Halves(
            axis,
            at,
            cut(first, (end[0], end[1], end[2]), share // 2),
            cut((begin[0], begin[1], begin[2]), stop, share - share // 2),
        )

    return cut((0, 0, 0), counts, most)


def visible(tree: _Tree, field: BrickedField, view: Viewpoint) -> Iterator[Group]:
    """The groups in order of visibility: none hides an earlier one."""
    if isinstance(tree, Group):
        yield tree
        return
    grid = field.volume.grid
    if view.orthographic:
        low_first = float((grid.world_to_index_matrix @ view.forward)[tree.axis]) >= 0
    else:
        low_first = float(view.eye_in(grid)[tree.axis]) < field.bricks.plane(tree.at)
    for part in (tree.low, tree.high) if low_first else (tree.high, tree.low):
        yield from visible(part, field, view)


@dataclass(frozen=True)
class _Recipe:
    """The arguments of the field that each worker makes once."""

    token: str
    kind: type[BrickedField]
    volume: LazyVolume
    limits: tuple[float, float]
    labels: bool
    filter: Filter
    boundary: Boundary
    device: str | int | None
    memory: int | None
    edge: int
    ranks: dict[str, int]
    sharing: int = 1
    version: str = field(default_factory=version)


@dataclass(frozen=True)
class _Job:
    """A picture: its frames without coefficients, each with where its rays cross the picture if these are listed."""

    whole: Frame
    frames: tuple[tuple[Frame, NDArray[np.float32] | None], ...]
    rays: int | Literal["auto"]
    filter: Filter
    view: Viewpoint
    skipping: bool


@dataclass(frozen=True)
class _MediaJob:
    """A picture: its frames without coefficients, one for each ray of a pixel, and the media of each in it."""

    whole: Frame
    frames: tuple[Frame, ...]
    rays: int | Literal["auto"]
    filter: Filter
    view: Viewpoint
    skipping: bool


@dataclass(frozen=True)
class _Marched:
    """The states of rays behind some boxes, and the number of bricks and samples that were read for them."""

    carried: Carried
    bricks: int = 0
    samples: int = 0


class Shared:
    """A field whose bricks are distributed over the workers of a cluster; this process reads none of them.

    Without a `device` the workers of a host that has several GPUs take turns at them; without `memory`, bytes for the bricks of
    each, they share what one process would have. Of these `sharing` fields of a picture have equal parts.
    """

    def __init__(
        self, cluster: Cluster, field: BrickedField, device: str | int | None, memory: int | None, sharing: int = 1
    ) -> None:
        self.cluster, self.field = cluster, field
        self._device, self._memory, self._sharing = device, memory, sharing
        self.token = uuid.uuid4().hex
        self.share()

    def share(self) -> None:
        """Distribute the bricks over the present workers, and send them the recipe of the field."""
        field, volume = self.field, self.field.volume.for_tasks()
        recipe = _Recipe(
            self.token,
            type(field),
            volume,
            volume.limits,
            volume.is_labels,
            field.filter,
            field.boundary,
            self._device,
            self._memory,
            field.edge,
            self.cluster.local_ranks(),
            self._sharing,
        )
        self.workers = self.cluster.workers
        self.tree = groups_of(field.bricks.counts, _GROUPS * max(1, len(self.workers)))
        self.recipe = self.cluster.scatter(recipe, volume.nbytes if volume.in_memory else 0)

    def owner(self, group: Group) -> str | None:
        """The worker that reads a group's bricks."""
        return self.workers[group.number % len(self.workers)] if self.workers else None

    def forget(self) -> None:
        """Free the field on the workers."""
        self.cluster.run_on_all(_forget, self.token)


# -- in this process -------------------------------------------------------------------------------------------------------------


class ClusterDrawing(BrickedDrawing):
    """A picture in progress, as a `BrickedDrawing`, whose rays the workers of a cluster cast."""

    def __init__(self, workers: Workers, frame: Frame, rays: int | Literal["auto"], *arguments: Any, **options: Any) -> None:
        super().__init__(frame, rays, *arguments, **options)
        smooth = frame.coefficients.filter.support > 1
        if workers.merge == "tree" and (why := frame.mode.unmergeable(guides=frame.guides, smooth=smooth)):
            raise OptionError(f'merge must be "order" for {why}')
        self._asked, self._shared, self._merge = rays, workers.share(self._field), workers.merge

    def _go_through(
        self, passes: list[Pass], frames: list[tuple[Frame, NDArray[np.float32] | None]], progress: Progress | None
    ) -> None:
        try:
            self._by_workers(passes, frames, progress)
        except LostError:  # other work may have killed workers
            self._shared.share()
            self._by_workers(passes, frames, progress)

    def _by_workers(
        self, passes: list[Pass], frames: list[tuple[Frame, NDArray[np.float32] | None]], progress: Progress | None
    ) -> None:
        sent = tuple((_bare(frame), places) for frame, places in frames)
        job = _Job(_bare(self.frame), sent, self._asked, self._filter, self._view, self._skipping)
        groups = [
            group
            for group in visible(self._shared.tree, self._field, self._view)
            if any(self._may_matter(brick) for brick in group.bricks(self._field, self._view))
        ]
        work = _Work(self._shared, self._shared.cluster.submit(_same_job, job), groups)
        put = work.in_order if self._merge == "order" else work.by_tree
        try:
            for number, (frame, places) in enumerate(frames):
                for area, met in self._cut(frame, places, groups):
                    put(number, area, met)
            for done, (number, marched) in enumerate(work.results(), 1):
                passes[number].take(marched.carried)
                self._field.reads.bricks += marched.bricks
                self._field.reads.samples += marched.samples
                if progress:
                    progress(done / work.count)
        except BaseException:
            work.cancel()
            raise

    def _cut(self, frame: Frame, places: NDArray[np.float32] | None, groups: Sequence[Group]) -> Iterator[tuple[Area, list[Group]]]:
        """The areas of a frame, each with the groups that its rays may meet, front to back."""
        (width, height), grid = frame.size, self._field.volume.grid
        wanted = _AREAS * max(1, len(self._shared.workers))
        seen = self.frame.size  # listed places are in its pixels
        spans = [pixels_of(group.box(self._field), self._view, grid, *seen, self._beside) for group in groups]
        edge = max(_SMALLEST, -(-math.isqrt(width * height // wanted) // _SMALLEST) * _SMALLEST)
        across, down = (edge, edge) if places is None else (width, max(_SMALLEST, -(-height // wanted // _SMALLEST) * _SMALLEST))
        for y, x in itertools.product(range(0, height, down), range(0, width, across)):
            area = x, y, min(across, width - x), min(down, height - y)
            box: Sequence[float] = (x, y, x + area[2], y + area[3])
            if places is not None:
                rows = places.reshape(height, width, 2)[y : y + area[3]]
                box = boxes_of(rows, area[3], width)[0, 0].tolist()
            met = [
                group
                for group, (left, top, right, bottom) in zip(groups, spans, strict=True)
                if box[0] <= right and box[1] <= bottom and box[2] >= left and box[3] >= top
            ]
            if met:
                yield area, met


class _Work:
    """The tasks of a picture."""

    def __init__(self, shared: Shared, job: Any, groups: Sequence[Group]) -> None:
        self._shared, self._job = shared, job
        self._groups = {group.number: group for group in groups}
        self._name = f"clvol-rays-{uuid.uuid4().hex}"
        self._last: list[tuple[int, Any]] = []  # a frame's number, and the future of an area of it
        self._numbers = itertools.count()

    @property
    def count(self) -> int:
        """The number of results."""
        return len(self._last)

    def _march(self, number: int, area: Area, group: Group, before: Any) -> Any:
        shared = self._shared
        key = f"{self._name}-{group.number}-{next(self._numbers)}"
        return shared.cluster.submit(
            march_group, shared.recipe, self._job, number, group, area, before, worker=shared.owner(group), key=key
        )

    def in_order(self, number: int, area: Area, groups: Sequence[Group]) -> None:
        """Submit the rays of an area, through one group after the other."""
        before = None
        for group in groups:
            before = self._march(number, area, group, before)
        self._last.append((number, before))

    def by_tree(self, number: int, area: Area, groups: Sequence[Group]) -> None:
        """Submit the rays of an area through all groups at once, and the merging in pairs."""
        shared = self._shared
        parts = [self._march(number, area, group, None) for group in groups]
        while len(parts) > 1:
            parts = [
                shared.cluster.submit(
                    merge_groups, shared.recipe, self._job, number, *pair, key=f"{self._name}-merge-{next(self._numbers)}"
                )
                if len(pair := parts[i : i + 2]) > 1
                else pair[0]
                for i in range(0, len(parts), 2)
            ]
        self._last.append((number, parts[0]))

    def results(self) -> Iterator[tuple[int, _Marched]]:
        """A frame's number and the states of an area's rays, as they finish."""
        try:
            for i, result in self._shared.cluster.as_completed([future for _, future in self._last]):
                number, _ = self._last[i]
                self._last[i] = number, None  # so that the worker frees it
                yield number, result
        except PoisonError as error:
            raise self._named(error) from error

    def _named(self, error: PoisonError) -> ClusterError:
        """The error with the name of the brick that kills workers: the last one announced, if it alone kills them too."""
        word = error.key.removeprefix(self._name).split("-")[1:2]
        group = self._groups.get(int(word[0])) if word and word[0].isdigit() else None
        if group is None:
            return ClusterError(f"each worker dies that draws this picture: {error}")
        self.cancel()
        bricks = [(x, y, z) for x, y, z in itertools.product(*map(range, group.first, group.stop))]
        last = self._killer(bricks)
        if last is None:
            return LostError(
                f"rays through bricks {bricks[0]} to {bricks[-1]} (x, y, z) end each worker that casts them, though they can be "
                f"read: {error}"
            )
        name = self._shared.field.volume.name or "the volume"
        if self._killer([last]) is None:
            return ClusterError(
                f"bricks {bricks[0]} to {bricks[-1]} (x, y, z) of {name} end each worker that reads all of them, but no single one "
                "does for certain: out of memory, or a fault of what reads"
            )
        brick = self._shared.field.bricks[last]
        x, y, z = (f"{a}:{b}" for a, b in zip(brick.first, brick.last, strict=True))
        return ClusterError(
            f"brick {last} (x, y, z), samples [{z}, {y}, {x}] of {name}, ends each worker that reads it: out of memory, or a fault "
            "of what reads"
        )

    def _killer(self, bricks: Sequence[Index]) -> Index | None:
        """The brick at which workers die that read these in order; None if a worker can read them all."""
        cluster, key = self._shared.cluster, f"{self._name}-read-{uuid.uuid4().hex}"
        try:
            for _ in cluster.as_completed([cluster.submit(read_bricks, self._shared.recipe, bricks, key, key=key)]):
                pass
        except PoisonError as error:
            client: Any = cluster.client
            number = client.get_metadata([key], None)
            if number is None:
                raise ClusterError(f"each worker dies that opens this volume: {error}") from error
            return bricks[int(number)]
        return None

    def cancel(self) -> None:
        """Cancel unfinished tasks."""
        self._shared.cluster.cancel([future for _, future in self._last if future is not None])


def _bare(frame: Frame) -> Frame:
    """A frame without device objects."""
    media = tuple(map(_bare, frame.media))
    return replace(frame, coefficients=None, minmax=None, gaps=None, sides=None, media=media)  # type: ignore[arg-type]  # see `_with_own`


def _same_job(job: _T) -> _T:
    """A task that returns its argument, so that the scheduler keeps it and can send it again."""
    return job


class ClusterMediaDrawing(MediaDrawing):
    """A picture in progress, as a `MediaDrawing`, whose areas the workers of a cluster draw."""

    def __init__(
        self, workers: Workers, frame: Frame, rays: int | Literal["auto"], filter: str | Filter, *, bricked: Bricked
    ) -> None:
        self._asked, self._workers, self._read = rays, workers, bricked
        super().__init__(frame, rays, filter, bricked=bricked)

    def _make_ready(self) -> None:
        """Nothing is drawn here."""

    def cast(self, rays: int, progress: Progress | None = None, until: float = math.inf) -> bool:  # noqa: ARG002  # all or nothing
        frame, last = self.frame, min(self.rays, self.cast_rays + rays)
        frames = tuple(frame.sampled(*self._pattern[i], i, self.rays) for i in range(self.cast_rays, last))
        self._by_workers(frames, None, self.arrays, progress)
        self.cast_rays = last
        return True

    def _cast_listed(self, rays: Frame, places: NDArray[np.float32], progress: Progress | None) -> dict[str, Picture]:
        arrays = pictures_of(rays)
        self._by_workers((rays,), places, arrays, progress)
        return arrays

    def _by_workers(
        self, frames: tuple[Frame, ...], places: NDArray[np.float32] | None, arrays: dict[str, Picture], progress: Progress | None
    ) -> None:
        try:
            self._draw_areas(frames, places, arrays, progress)
        except LostError:  # other work may have killed workers
            for shared in self._shared:
                shared.share()
            self._draw_areas(frames, places, arrays, progress)

    @property
    def _shared(self) -> list[Shared]:
        return [self._workers.share(field) for field in self._read.fields if field is not None]  # all are by bricks

    def _draw_areas(
        self, frames: tuple[Frame, ...], places: NDArray[np.float32] | None, arrays: dict[str, Picture], progress: Progress | None
    ) -> None:
        cluster, recipes, (width, height) = self._workers.cluster, [shared.recipe for shared in self._shared], frames[0].size
        read = self._read
        job = _MediaJob(_bare(self.frame), tuple(map(_bare, frames)), self._asked, self._filter, read.view, read.skipping)
        sent = cluster.submit(_same_job, job)
        areas = _areas((width, height), _AREAS_OF_MEDIA * max(1, len(cluster.workers)), listed=places is not None)
        listed = [None if places is None else places[y * width : (y + h) * width] for _, y, _, h in areas]
        futures = [cluster.submit(draw_area, recipes, sent, area, rows) for area, rows in zip(areas, listed, strict=True)]
        try:
            for done, (i, drawn) in enumerate(cluster.as_completed(futures), 1):
                x, y, w, h = areas[i]
                for name, part in drawn.items():
                    arrays[name][y : y + h, x : x + w] = part
                if progress:
                    progress(done / len(areas))
        except PoisonError as error:
            raise ClusterError(f"each worker dies that draws this picture: {error}") from error
        finally:
            cluster.cancel(futures)


def _areas(size: tuple[int, int], wanted: int, *, listed: bool) -> list[Area]:
    """Areas of a picture, or of a list of rays whole rows, which begin at tiles."""
    width, height = size
    across = width
    if not listed:
        across = max(_SMALLEST, -(-math.isqrt(width * height // wanted) // _SMALLEST) * _SMALLEST)
    down = max(_SMALLEST, -(-(width * height // wanted) // across // _SMALLEST) * _SMALLEST)
    return [(x, y, min(across, width - x), min(down, height - y)) for y in range(0, height, down) for x in range(0, width, across)]


class Workers:
    """The workers of a cluster that draw a renderer's pictures; `device` and `memory` are each worker's, as they were given.

    `sharing` media of each picture share the memory.
    """

    def __init__(
        self, cluster: ClusterLike, merge: Merge, device: Device | str | int | None, memory: int | None, sharing: int = 1
    ) -> None:
        self.cluster, self.merge, self.device = as_cluster(cluster), merge, device
        self._given, self._memory, self._sharing = cluster, memory, sharing
        self._shared: dict[int, Shared] = {}
        self._lock = threading.RLock()  # a signal handler may re-enter

    @property
    def keywords(self) -> dict[str, Any]:
        """Those of a renderer in another process."""
        cluster = self._given if isinstance(self._given, int) else self.cluster.address
        return {"memory": self._memory, "cluster": cluster, "merge": self.merge}

    def shared_out(self, field: BrickedField) -> BrickedField:
        """The field, or one of smaller bricks where there are fewer bricks than groups."""
        edge, wanted = field.edge, _GROUPS * len(self.cluster.workers)
        while math.prod(-(-n // edge) for n in field.volume.size) < wanted and edge >= 2 * _LEAST:
            edge //= 2
        if edge == field.edge:
            return field
        return type(field)(field.volume, field.filter, field.boundary, field.device, memory=field.memory, edge=edge)

    def share(self, field: BrickedField) -> Shared:
        """The distribution of a field's bricks over the workers; renewed when the workers change."""
        with self._lock:
            found = self._shared.get(id(field))
            if found is None:
                device = self.device.name if isinstance(self.device, Device) else self.device
                found = self._shared[id(field)] = Shared(self.cluster, field, device, self._memory, self._sharing)
            elif found.workers != self.cluster.workers:
                found.share()
            return found

    def on(self, field: BrickedField, grid: Volume) -> NDArray[np.float32]:
        """A field's values on a grid, of which workers compute layers."""
        shared, values = self.share(field), np.empty(grid.shape, np.float32)
        corner, (nz, ny, nx) = replace(grid, data=np.zeros((1, 1, 1), np.float32)), grid.shape
        layers = np.linspace(0, nz, min(nz, _GROUPS * max(1, len(self.cluster.workers))) + 1).astype(int)
        spans = list(itertools.pairwise(layers.tolist()))

        def gathered() -> None:
            futures = [
                self.cluster.submit(
                    values_on, shared.recipe, replace(corner, origin=triple(grid.index_to_world([0, 0, low]))), (high - low, ny, nx)
                )
                for low, high in spans
            ]
            try:
                for i, found in self.cluster.as_completed(futures):
                    values[slice(*spans[i])] = found
            except PoisonError as error:
                raise ClusterError(f"each worker dies that samples this volume: {error}") from error
            finally:
                self.cluster.cancel(futures)

        try:
            gathered()
        except LostError:  # other work may have killed workers
            shared.share()
            gathered()
        return values

    def drawing(self, *arguments: Any, **options: Any) -> ClusterDrawing:
        """A picture in progress: the arguments are those of `BrickedDrawing`."""
        return ClusterDrawing(self, *arguments, **options)

    def close(self) -> None:
        """Free the fields of the workers, and leave the cluster."""
        for one in self._shared.values():
            one.forget()
        if self.cluster is not self._given:
            self.cluster.close()


# -- in a worker -----------------------------------------------------------------------------------------------------------------

_fields: OrderedDict[str, BrickedField] = OrderedDict()
_lock = WorkerLock()  # kernels use all cores, and memory holds one field's bricks


def _field_of(recipe: _Recipe) -> BrickedField:
    """The field of a recipe."""
    if recipe.version != version():
        raise ClusterError(f"workers must have clvol {recipe.version}; {worker_address()} has {version()}")
    if recipe.token not in _fields:
        try:
            device = worker_device(recipe.device, local_rank(recipe.ranks))
        except OutOfMemoryError:
            raise
        except DeviceError as error:
            raise ClusterError(f"workers must have an OpenCL device; {worker_address()} has none: {error}") from error
        volume = recipe.volume.as_known(recipe.limits, recipe.labels)
        memory = (recipe.memory or memory_for(volume, None, local_size(recipe.ranks))) // recipe.sharing
        _fields[recipe.token] = recipe.kind(volume, recipe.filter, recipe.boundary, device, memory=memory, edge=recipe.edge)
    field = _fields[recipe.token]
    _fields.move_to_end(recipe.token)
    return field


@contextmanager
def _locked(*recipes: _Recipe) -> Iterator[list[BrickedField]]:
    """The fields of recipes, exclusively for this task; others free their bricks for them."""
    with _lock, ExitStack() as held:
        fields = [_field_of(recipe) for recipe in recipes]
        for other in _fields.values():
            if other not in fields:
                other.drop()
        while len(_fields) > max(_FIELDS, len(fields)):
            _fields.popitem(last=False)[1].close()
        for field in fields:
            held.enter_context(field.in_use())
        yield fields


def _with_own(frame: Frame, fields: Sequence[BrickedField]) -> Frame:
    """A frame with this process's own objects of a device; of several media each with those of its field."""
    first = fields[0]
    gaps = None if first.volume.where is None else Gaps(first.volume.where, first.device)
    tile = tile_of(first.device, frame.evaluator)
    media = tuple(_with_own(one, [field]) for one, field in zip(frame.media, fields, strict=True)) if frame.media else ()
    return replace(frame, coefficients=first.coefficients, tile=tile, gaps=gaps, media=media)


def _forget(token: str) -> None:
    with _lock:
        field = _fields.pop(token, None)
    if field is not None:
        field.close()


def _begun(field: BrickedField, job: _Job, number: int, area: Area) -> tuple[BrickedDrawing, Pass]:
    """The rays of an area of frame `number`."""
    frame, places = job.frames[number]
    drawing = BrickedDrawing(_with_own(job.whole, [field]), job.rays, job.filter, field, job.view, skipping=job.skipping)
    return drawing, drawing.begun(_with_own(frame, [field]), places, area)


def march_group(recipe: _Recipe, job: _Job, number: int, group: Group, area: Area, before: _Marched | None) -> _Marched:
    """March the rays of an area of frame `number` through a group, from their start or with the states after other groups."""
    with _locked(recipe) as (field,):
        drawing, rays = _begun(field, job, number, area)
        try:
            if before is not None:
                rays.resume(before.carried)
                if not rays.going:
                    return before
            read = replace(field.reads)
            drawing.march([rays], group.bricks(field, job.view))
            bricks, samples = field.reads.bricks - read.bricks, field.reads.samples - read.samples
            if before is not None:
                bricks, samples = bricks + before.bricks, samples + before.samples
            return _Marched(rays.carried(), bricks, samples)
        finally:
            rays.release()


def draw_area(recipes: Sequence[Any], job: _MediaJob, area: Area, places: NDArray[np.float32] | None) -> dict[str, Picture]:
    """An area of a picture, by all of its rays; of a list those that cross it at these places."""
    with _locked(*recipes) as fields:
        whole, *frames = (_with_own(frame, fields) for frame in (job.whole, *job.frames))
        drawing = MediaDrawing(whole, job.rays, job.filter, bricked=Bricked(tuple(fields), job.view, job.skipping))
        return drawing.of_area(frames, area, places)


def values_on(recipe: _Recipe, corner: Volume, shape: tuple[int, int, int]) -> NDArray[np.float32]:
    """Values on a grid of this shape that begins at a grid of one sample."""
    with _locked(recipe) as (field,):
        grid = replace(corner, data=np.broadcast_to(corner.data, shape))
        return field.resample(like=grid, dtype=np.float32).data


def merge_groups(recipe: _Recipe, job: _Job, number: int, front: _Marched, back: _Marched) -> _Marched:
    """Merge the states of rays that were marched through groups separately, `back` behind `front`."""
    with _locked(recipe) as (field,):
        _, rays = _begun(field, job, number, front.carried.area)
        _, behind = _begun(field, job, number, front.carried.area)
        try:
            rays.take(front.carried)
            behind.take(back.carried)
            rays.merge(behind)
            return _Marched(rays.carried(), front.bricks + back.bricks, front.samples + back.samples)
        finally:
            rays.release()
            behind.release()


def read_bricks(recipe: _Recipe, bricks: Sequence[Index], key: str) -> None:
    """Read bricks in order, and announce each to the scheduler first, so that its number outlives this process."""
    import distributed

    client: Any = distributed.get_client()
    with _locked(recipe) as (field,):
        for number, at in enumerate(bricks):
            client.set_metadata([key], number)
            with field.store.resident(field.bricks[at]):
                pass
