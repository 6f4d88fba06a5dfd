"""Pictures by the processes of a cluster: each has some of the bricks, and rays go from one to the other, or are merged.

The bricks are shared out in boxes, which halve the volume again and again, so that from wherever it is seen they lie one behind
the other (a kd-tree). A picture is cut into areas. "order": in each, rays carry their states from box to box, front to back, while
other boxes work on other areas; the picture is the one that a single process makes, to the last bit, and boxes that are hidden are
not read. "tree": rays go through all boxes at once, and their states are merged two by two; that waits for nobody, but does not
know what is hidden.
"""

from __future__ import annotations

import itertools
import math
import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import ClusterError, DeviceError, OptionError, OutOfMemoryError
from clvol.bricks.source import Index, LazyVolume, budget_for
from clvol.cluster import Cluster, LostError, PoisonError, Turn, neighbours, own_address, own_place, version, worker_device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.march.bricks import Area, BrickedDrawing, Carried, Pass, boxes_of, front_to_back, pixels_of
from clvol.march.frame import Frame, tile_of
from clvol.march.launch import Progress
from clvol.scene.camera import View
from clvol.scene.mode import Composite, Isosurface, Mode
from clvol.spline.bricked import Brick, BrickedField

__all__ = ["MERGES", "ClusterDrawing", "Group", "Merge", "Shared", "groups_of", "shared_out", "visible"]

Merge: TypeAlias = Literal["order", "tree"]
MERGES = ("order", "tree")
_GROUPS = 4  # boxes for each worker
_AREAS = 4  # of a picture for each worker
_SMALLEST = 32  # pixels along an edge of an area, of which it is a multiple
_LEAST = 32  # samples along an edge of a brick: margins are as wide as that
_FIELDS = 4  # that a worker keeps
_SEARCHES = 2  # for a brick that ends workers: each costs the lives of some


# -- which bricks go together --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """A box of bricks.

    Attributes
    ----------
    number : int
    first, past : (int, int, int)
        Its bricks: ``first <= at < past`` along x, y and z.
    """

    number: int
    first: Index
    past: Index

    def box(self, field: BrickedField) -> Brick:
        """Where all of it lies, as if it were one brick."""
        x, y, z = (n - 1 for n in self.past)
        one, other = field.brick(self.first), field.brick((x, y, z))
        return Brick(self.first, one.low, other.high, one.first, other.last)

    def bricks(self, field: BrickedField, view: View) -> list[Brick]:
        """Those of the box, front to back."""
        return front_to_back(field, view, (self.first, self.past))


@dataclass(frozen=True)
class _Halves:
    """Bricks before number `at` along an axis, and those from there on."""

    axis: int
    at: int
    low: _Tree
    high: _Tree


_Tree: TypeAlias = "Group | _Halves"


def groups_of(counts: Index, most: int) -> _Tree:
    """So many bricks along x, y and z in at most so many boxes: halves of halves, across where there are most bricks."""
    numbers = itertools.count()

    def cut(first: Index, past: Index, share: int) -> _Tree:
        size = [b - a for a, b in zip(first, past, strict=True)]
        axis = max(range(3), key=lambda i: size[i])
        if share < 2 or size[axis] < 2:
            return Group(next(numbers), first, past)
        at = first[axis] + size[axis] // 2
        end, begin = list(past), list(first)
        end[axis] = begin[axis] = at
        return _Halves(
            axis,
            at,
            cut(first, (end[0], end[1], end[2]), share // 2),
            cut((begin[0], begin[1], begin[2]), past, share - share // 2),
        )

    return cut((0, 0, 0), counts, most)


def visible(tree: _Tree, field: BrickedField, view: View) -> Iterator[Group]:
    """The boxes, in an order in which none is behind one that comes later."""
    if isinstance(tree, Group):
        yield tree
        return
    grid = field.volume.grid
    if view.orthographic:
        low_first = float((grid.world_to_index_matrix @ view.forward)[tree.axis]) >= 0
    else:
        low_first = float(view.eye_in(grid)[tree.axis]) < tree.at * field.edge + field.away
    for part in (tree.low, tree.high) if low_first else (tree.high, tree.low):
        yield from visible(part, field, view)


def shared_out(field: BrickedField, workers: int) -> BrickedField:
    """The field, or one of smaller bricks where there are too few for so many workers."""
    edge = field.edge
    while math.prod(-(-n // edge) for n in field.volume.size) < _GROUPS * workers and edge >= 2 * _LEAST:
        edge //= 2
    if edge == field.edge:
        return field
    return BrickedField(field.volume, field.filter, field.boundary, field.device, budget=field.budget, edge=edge)


# -- what workers are told -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Recipe:
    """A field that each worker makes for itself, once."""

    token: str
    volume: LazyVolume
    limits: tuple[float, float]
    labels: bool
    filter: Filter
    boundary: Boundary
    device: str | int | None
    budget: int | None
    edge: int
    places: dict[str, int]
    version: str = field(default_factory=version)


@dataclass(frozen=True)
class _Job:
    """A picture, or some of its rays: frames, without coefficients, and where rays cross the picture if that is listed."""

    whole: Frame
    frames: tuple[tuple[Frame, NDArray[np.float32] | None], ...]
    samples: int | Literal["auto"]
    filter: Filter
    view: View
    skipping: bool


@dataclass(frozen=True)
class _Marched:
    """What rays carry behind some boxes, and how many bricks and samples were read for it."""

    carried: Carried
    bricks: int = 0
    samples: int = 0


class Shared:
    """A field whose bricks the workers of a cluster share.

    Parameters
    ----------
    cluster : Cluster
    field : BrickedField
        Of which this process reads nothing.
    device : str, int or None
        Of the workers: see `as_device`. None: of several GPUs of a host each worker has another.
    budget : int or None
        Bytes for the bricks of each worker. None: the workers of a host share what one process would have.
    """

    def __init__(self, cluster: Cluster, field: BrickedField, device: str | int | None, budget: int | None) -> None:
        self.cluster, self.field = cluster, field
        self._device, self._budget = device, budget
        self.token = uuid.uuid4().hex
        self.share()

    def share(self) -> None:
        """Share them out among the workers that are there now, and tell these what they make the field of."""
        field, volume = self.field, self.field.volume.for_tasks()
        recipe = _Recipe(
            self.token,
            volume,
            volume.limits,
            volume.is_labels,
            field.filter,
            field.boundary,
            self._device,
            self._budget,
            field.edge,
            self.cluster.places(),
        )
        self.workers = self.cluster.workers
        self.tree = groups_of(field.counts, _GROUPS * max(1, len(self.workers)))
        self.recipe = self.cluster.shared(recipe, volume.nbytes if volume.in_memory else 0)

    def owner(self, group: Group) -> str | None:
        """The worker that reads a box, if it is still there."""
        return self.workers[group.number % len(self.workers)] if self.workers else None

    def forget(self) -> None:
        """Tell workers that the field is not wanted."""
        self.cluster.tell(_forget, self.token)


# -- in this process -------------------------------------------------------------------------------------------------------------


class ClusterDrawing(BrickedDrawing):
    """A picture in the making whose rays the workers of a cluster cast.

    Parameters
    ----------
    frame, samples, filter, view, skipping
        As of `BrickedDrawing`.
    shared : Shared
        Who has which bricks.
    merge : {"order", "tree"}
        How rays go through them.
    """

    def __init__(
        self,
        frame: Frame,
        samples: int | Literal["auto"],
        filter: str | Filter,
        shared: Shared,
        view: View,
        *,
        skipping: bool,
        merge: Merge,
    ) -> None:
        super().__init__(frame, samples, filter, shared.field, view, skipping=skipping)
        self._samples, self._shared, self._merge = samples, shared, require_merge(merge, frame)

    def _go_through(
        self, passes: list[Pass], frames: list[tuple[Frame, NDArray[np.float32] | None]], told: Progress | None
    ) -> None:
        try:
            self._by_workers(passes, frames, told)
        except LostError:  # with workers, of which some may have died for another's sake
            self._shared.share()
            self._by_workers(passes, frames, told)

    def _by_workers(
        self, passes: list[Pass], frames: list[tuple[Frame, NDArray[np.float32] | None]], told: Progress | None
    ) -> None:
        bare = tuple((_bare(frame), places) for frame, places in frames)
        job = _Job(_bare(self.frame), bare, self._samples, self._filter, self._view, self._skipping)
        groups = [g for g in visible(self._shared.tree, self._field, self._view) if self._any_may_matter(g)]
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
                if told:
                    told(done / work.count)
        except BaseException:
            work.cancel()
            raise

    def _any_may_matter(self, group: Group) -> bool:
        return any(self._may_matter(brick) for brick in group.bricks(self._field, self._view))

    def _cut(self, frame: Frame, places: NDArray[np.float32] | None, groups: Sequence[Group]) -> Iterator[tuple[Area, list[Group]]]:
        """Areas of a frame, each with the boxes that its rays may meet, front to back."""
        (width, height), grid = frame.size, self._field.volume.grid
        wanted = _AREAS * max(1, len(self._shared.workers))
        seen = self.frame.size  # by which listed places are counted
        spans = [pixels_of(group.box(self._field), self._view, grid, *seen, self._beside) for group in groups]
        edge = max(_SMALLEST, -(-math.isqrt(width * height // wanted) // _SMALLEST) * _SMALLEST)
        across, down = (edge, edge) if places is None else (width, max(_SMALLEST, -(-height // wanted // _SMALLEST) * _SMALLEST))
        for y, x in itertools.product(range(0, height, down), range(0, width, across)):
            area = x, y, min(across, width - x), min(down, height - y)
            box: Sequence[float] = (x, y, x + area[2], y + area[3])
            if places is not None:
                own = places.reshape(height, width, 2)[y : y + area[3]]
                box = boxes_of(own, area[3], width)[0, 0].tolist()
            met = [
                group
                for group, (left, top, right, bottom) in zip(groups, spans, strict=True)
                if box[0] <= right and box[1] <= bottom and box[2] >= left and box[3] >= top
            ]
            if met:
                yield area, met


class _Work:
    """What workers do for a picture."""

    def __init__(self, shared: Shared, job: Any, groups: Sequence[Group]) -> None:
        self._shared, self._job = shared, job
        self._groups = {group.number: group for group in groups}
        self._name = f"clvol-rays-{uuid.uuid4().hex}"
        self._last: list[tuple[int, Any]] = []
        self._numbers = itertools.count()

    @property
    def count(self) -> int:
        """Results that will come."""
        return len(self._last)

    def _march(self, number: int, area: Area, group: Group, before: Any) -> Any:
        shared = self._shared
        key = f"{self._name}-{group.number}-{next(self._numbers)}"
        return shared.cluster.submit(
            march_group, shared.recipe, self._job, number, group, area, before, worker=shared.owner(group), key=key
        )

    def in_order(self, number: int, area: Area, groups: Sequence[Group]) -> None:
        """Rays of an area of a frame through boxes one after the other."""
        before = None
        for group in groups:
            before = self._march(number, area, group, before)
        self._last.append((number, before))

    def by_tree(self, number: int, area: Area, groups: Sequence[Group]) -> None:
        """Rays of an area through all boxes at once, merged two by two."""
        shared = self._shared
        parts = [self._march(number, area, group, None) for group in groups]
        while len(parts) > 1:
            pairs = itertools.zip_longest(parts[::2], parts[1::2])
            parts = [
                front
                if back is None
                else shared.cluster.submit(
                    merge_groups, shared.recipe, self._job, number, front, back, key=f"{self._name}-merge-{next(self._numbers)}"
                )
                for front, back in pairs
            ]
        self._last.append((number, parts[0]))

    def results(self) -> Iterator[tuple[int, _Marched]]:
        """The frame's number and what its rays carry, area by area, as they come."""
        try:
            for i, result in self._shared.cluster.done([future for _, future in self._last]):
                number, _ = self._last[i]
                self._last[i] = number, None  # the worker may let go of it
                yield number, result
        except PoisonError as error:
            raise self._named(error) from error

    def _named(self, error: PoisonError) -> ClusterError:
        """The error that says which brick it is: halves of a box are read apart until one is left that ends a worker by itself."""
        word = error.key.removeprefix(self._name).split("-")[1:2]
        group = self._groups.get(int(word[0])) if word and word[0].isdigit() else None
        if group is None:
            return ClusterError(f"each worker dies that draws this picture: {error}")
        shared = self._shared
        bricks = [(x, y, z) for x, y, z in itertools.product(*map(range, group.first, group.past))]
        self.cancel()
        sure = self._dies(bricks)
        if not sure:
            return LostError(
                f"rays through bricks {bricks[0]} to {bricks[-1]} (x, y, z) end each worker that casts them, though they can be "
                f"read: {error}"
            )
        name = shared.field.volume.name or "the volume"
        for _ in range(_SEARCHES):
            left = bricks
            while len(left) > 1:
                half = left[: len(left) // 2]
                sure = self._dies(half)
                left = half if sure else left[len(half) :]
            if sure or self._dies(left):
                brick = shared.field.brick(left[0])
                x, y, z = (f"{a}:{b}" for a, b in zip(brick.first, brick.last, strict=True))
                return ClusterError(
                    f"brick {left[0]} (x, y, z), samples [{z}, {y}, {x}] of {name}, ends each worker that reads it: out of memory, "
                    "or a fault of what reads"
                )
        return ClusterError(
            f"bricks {bricks[0]} to {bricks[-1]} (x, y, z) of {name} end each worker that reads all of them, but no single one "
            "does for certain: out of memory, or a fault of what reads"
        )

    def _dies(self, bricks: Sequence[Index]) -> bool:
        shared = self._shared
        future = shared.cluster.submit(read_bricks, shared.recipe, list(bricks), key=f"{self._name}-read-{uuid.uuid4().hex}")
        try:
            for _ in shared.cluster.done([future]):
                pass
        except PoisonError:
            return True
        return False

    def cancel(self) -> None:
        """It is not wanted any more."""
        self._shared.cluster.cancel([future for _, future in self._last if future is not None])


def require_merge(merge: str, frame: Frame) -> Merge:
    """How rays are put together; `OptionError` where a tree would give another picture."""
    if merge == "order":
        return "order"
    if merge != "tree":
        raise one_of("merge", merge, MERGES)
    mode: Mode = frame.mode
    smooth = frame.coefficients.filter.support > 1
    if isinstance(mode, Isosurface) and not (mode.stretches and smooth):
        raise OptionError('merge must be "order" for surfaces that are stepped to, or between labels: they lie between two samples')
    if isinstance(mode, Composite) and frame.guides:
        raise OptionError('merge must be "order" for the depth and normals of matter: they depend on the light that comes through')
    return "tree"


def _bare(frame: Frame) -> Frame:
    """A frame without what belongs to a device."""
    return replace(frame, coefficients=None, minmax=None, sides=None)  # type: ignore[arg-type]  # others are put in its place


def _same_job(job: _Job) -> _Job:
    """As a task: whoever needs it later gets it from there, or has it made again."""
    return job


# -- in a worker -----------------------------------------------------------------------------------------------------------------

_fields: OrderedDict[str, BrickedField] = OrderedDict()
_lock = threading.RLock()
_turn = Turn()  # kernels use all cores, and one budget is enough


def _field_of(recipe: _Recipe) -> BrickedField:
    """The field of a recipe; others keep no bricks meanwhile."""
    if recipe.version != version():
        raise ClusterError(f"workers must have clvol {recipe.version}; {own_address()} has {version()}")
    with _lock:
        if recipe.token not in _fields:
            try:
                device = worker_device(recipe.device, own_place(recipe.places))
            except OutOfMemoryError:
                raise
            except DeviceError as error:
                raise ClusterError(f"workers must have an OpenCL device; {own_address()} has none: {error}") from error
            volume = recipe.volume.as_known(recipe.limits, recipe.labels)
            budget = recipe.budget or budget_for(volume, None, neighbours(recipe.places))
            _fields[recipe.token] = BrickedField(volume, recipe.filter, recipe.boundary, device, budget=budget, edge=recipe.edge)
        field = _fields[recipe.token]
        _fields.move_to_end(recipe.token)
        for other in _fields.values():
            if other is not field:
                other.drop()
        while len(_fields) > _FIELDS:
            _fields.popitem(last=False)[1].close()
        return field


def _forget(token: str) -> None:
    with _lock:
        field = _fields.pop(token, None)
    if field is not None:
        field.close()


def _begun(field: BrickedField, job: _Job, number: int, area: Area) -> tuple[BrickedDrawing, Pass]:
    """The rays of an area of one of the frames."""
    tile = tile_of(field.device, job.whole.evaluator)
    whole = replace(job.whole, coefficients=field.coefficients, tile=tile)
    frame, places = job.frames[number]
    drawing = BrickedDrawing(whole, job.samples, job.filter, field, job.view, skipping=job.skipping)
    return drawing, drawing.begun(replace(frame, coefficients=field.coefficients, tile=tile), places, area)


def march_group(recipe: _Recipe, job: _Job, number: int, group: Group, area: Area, before: _Marched | None) -> _Marched:
    """The rays of an area of frame `number` through a box of bricks, from the beginning or from behind other boxes."""
    with _turn:
        field = _field_of(recipe)
        with field.in_use():
            drawing, one = _begun(field, job, number, area)
            try:
                if before is not None:
                    one.resume(before.carried)
                    if not one.going:
                        return before
                read = replace(field.reads)
                drawing.march([one], group.bricks(field, job.view))
                bricks, samples = field.reads.bricks - read.bricks, field.reads.samples - read.samples
                if before is not None:
                    bricks, samples = bricks + before.bricks, samples + before.samples
                return _Marched(one.carried(), bricks, samples)
            finally:
                one.release()


def merge_groups(recipe: _Recipe, job: _Job, number: int, front: _Marched, back: _Marched) -> _Marched:
    """Rays that went through boxes apart, `back` behind `front`, as one."""
    with _turn:
        field = _field_of(recipe)
        with field.in_use():
            _, one = _begun(field, job, number, front.carried.area)
            _, other = _begun(field, job, number, front.carried.area)
            try:
                one.take(front.carried)
                other.take(back.carried)
                one.merge(other)
                return _Marched(one.carried(), front.bricks + back.bricks, front.samples + back.samples)
            finally:
                one.release()
                other.release()


def read_bricks(recipe: _Recipe, bricks: Sequence[Index]) -> None:
    """Nothing but reading them."""
    with _turn:
        field = _field_of(recipe)
        with field.in_use():
            for at in bricks:
                with field.resident(field.brick(at)):
                    pass
