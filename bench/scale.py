"""The cost of a picture by a cluster: a simulation, checked against runs, and extrapolated.

    python -m bench.scale [--size 256] [--workers 1 2 4 8] [--json FILE]

The simulation uses clvol's own plan (boxes of bricks, areas of the picture, dependencies) and constants: seconds to read a
brick, to cast a sample, to send a byte, per task, per worker that opens a volume, and per task in the scheduler, which needs a
core too. They are measured with one worker, and the simulation is compared with runs of more. Then it predicts volumes of up to
10¹³ voxels and 1,000 workers, with constants that are assumed for such machines and stated.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import itertools
import json
import math
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import clvol
from bench.bricks import Shells
from clvol.bricks.field import BrickedField
from clvol.dask.cluster import Cluster, as_cluster
from clvol.march import cluster as parts
from clvol.march.window import pixels_of

_CAMERA = clvol.Camera.orbit(30, 20, fit="volume")
_PIXELS = 512
_FEW = 64  # pixels of a picture that costs little more than its tasks
_REPEATS = 3
_NOTHINGS = 200  # tasks that do nothing


@dataclass(frozen=True)
class Costs:
    """Of a worker, in seconds.

    Attributes
    ----------
    brick : float
        To read one, and make its coefficients.
    sample : float
        Of a ray.
    byte : float
        That is passed from worker to worker.
    task : float
        Whatever it does.
    begin : float
        Of a picture, in the process that asks for it.
    join : float
        Of a worker's first task of a volume: it opens that.
    dispatch : float
        Of a task, in the process of the scheduler: one at a time.
    """

    brick: float
    sample: float
    byte: float
    task: float
    begin: float
    join: float
    dispatch: float


@dataclass(frozen=True)
class Task:
    """The rays of an area through a box of bricks, or the merging of two boxes' rays.

    Attributes
    ----------
    before : tuple of int
        The tasks that it waits for.
    worker : int
        Who has the bricks.
    bricks : tuple
        Those that it takes.
    samples, nbytes : float
        Of its rays in the box; of their states.
    """

    before: tuple[int, ...]
    worker: int
    bricks: tuple[Any, ...]
    samples: float
    nbytes: float


def simulated(
    tasks: Sequence[Task],
    costs: Costs,
    workers: int,
    *,
    alone: float = 1.0,
    together: float = math.inf,
    spread: float = 0.0,
    slow: int = 0,
    joined: bool = False,
) -> float:
    """Seconds until the last task is done.

    Each worker does one task at a time, in list order, at the rate `alone`, and all of them together at most at the rate
    `together`. The scheduler is one of them: a task without dependencies starts once it has been sent. `joined`: workers have
    opened the volume. `spread` is the standard deviation of the logarithm of a task's time, and `slow` workers take twice as
    long for everything.
    """
    rng = np.random.default_rng(0)
    factor = np.exp(rng.normal(0, spread, len(tasks))) if spread else np.ones(len(tasks))
    pace = np.where(np.arange(workers) < slow, 2.0, 1.0)
    after: dict[int, list[int]] = defaultdict(list)
    waiting = [len(task.before) for task in tasks]
    for number, task in enumerate(tasks):
        for other in task.before:
            after[other].append(number)
    ready: list[list[int]] = [[] for _ in range(workers + 1)]
    scheduler = workers  # ready tasks wait to be sent
    for number, task in enumerate(tasks):
        if not task.before:
            heapq.heappush(ready[scheduler], number)
    held: set[Any] = set()
    known = set(range(workers)) if joined else set()
    active: dict[int, tuple[int, float]] = {}  # by worker: the task, and its remaining core seconds
    now, done = 0.0, 0
    idle = set(range(workers + 1))
    while done < len(tasks):
        for worker in [w for w in idle if ready[w]]:
            number = heapq.heappop(ready[worker])
            idle.discard(worker)
            if worker == scheduler:
                active[worker] = number, costs.dispatch
                continue
            task = tasks[number]
            fresh = [brick for brick in task.bricks if brick not in held]
            held.update(fresh)
            work = costs.task + len(fresh) * costs.brick + task.samples * costs.sample + task.nbytes * costs.byte
            work += costs.join if worker not in known else 0.0
            known.add(worker)
            active[worker] = number, work * factor[number] * pace[worker]
        share = min(alone, together / len(active))
        step = min(left for _, left in active.values())
        now += step / share
        for worker, (number, left) in list(active.items()):
            if left - step > 1e-12:
                active[worker] = number, left - step
                continue
            del active[worker]
            idle.add(worker)
            if worker == scheduler:
                heapq.heappush(ready[tasks[number].worker], number)
                continue
            done += 1
            for other in after[number]:
                waiting[other] -= 1
                if not waiting[other]:
                    heapq.heappush(ready[scheduler], other)
    return costs.begin + now


def plan(
    field: Any, view: Any, size: tuple[int, int], workers: int, areas: int, *, seen: Any = None, step: float = 0.5
) -> list[Task]:
    """The tasks of a picture as in `ClusterDrawing`; `seen` tells whether a brick may matter."""
    tree = parts.groups_of(field.bricks.counts, parts._GROUPS * workers)
    groups = list(parts.visible(tree, field, view))
    grid, (width, height) = field.volume.grid, size
    edge = max(parts._SMALLEST, -(-math.isqrt(width * height // areas) // parts._SMALLEST) * parts._SMALLEST)
    spans = [pixels_of(group.box(field), view, grid, width, height, 0) for group in groups]
    bricks = {
        g.number: tuple(b for b in itertools.product(*map(range, g.first, g.stop)) if seen is None or seen(b)) for g in groups
    }
    depth = field.edge * 1.5 / step  # approximate samples of a ray through a brick
    tasks: list[Task] = []
    for y, x in itertools.product(range(0, height, edge), range(0, width, edge)):
        before: tuple[int, ...] = ()
        for group, (left, top, right, bottom) in zip(groups, spans, strict=True):
            w, h = min(right, x + edge, width) - max(left, x), min(bottom, y + edge, height) - max(top, y)
            if w < 0 or h < 0 or not bricks[group.number]:
                continue
            across = max(b - a for a, b in zip(group.first, group.stop, strict=True))
            own = [b for b in bricks[group.number] if _meets(field.brick(b), view, grid, size, (x, y, edge, edge))]
            share = len(own) / max(1, len(bricks[group.number]))
            tasks.append(Task(before, group.number % workers, tuple(own), w * h * depth * across * share, 20.0 * edge * edge))
            before = (len(tasks) - 1,)
    return tasks


def as_tree(tasks: Sequence[Task]) -> list[Task]:
    """Convert a plan in order to one in which rays traverse all boxes at once (`merge="tree"`)."""
    areas: dict[int, list[int]] = {}
    first: dict[int, int] = {}
    for number, task in enumerate(tasks):
        first[number] = first[task.before[0]] if task.before else number
        areas.setdefault(first[number], []).append(number)
    made: list[Task] = []
    for area in areas.values():
        parts = [*range(len(made), len(made) + len(area))]
        made += [replace(tasks[number], before=()) for number in area]
        while len(parts) > 1:
            pairs = [tuple(parts[i : i + 2]) for i in range(0, len(parts), 2)]
            merged = range(len(made), len(made) + len(parts) // 2)
            made += [Task(pair, made[pair[0]].worker, (), 0.0, made[pair[0]].nbytes) for pair in pairs if len(pair) > 1]
            parts = [*merged, *(pair[0] for pair in pairs if len(pair) == 1)]
    return made


def _meets(brick: Any, view: Any, grid: Any, size: tuple[int, int], area: tuple[int, int, int, int]) -> bool:
    left, top, right, bottom = pixels_of(brick, view, grid, *size, 0)
    x, y, w, h = area
    return left <= x + w and top <= y + h and right >= x and bottom >= y


# -- runs ----------------------------------------------------------------------------------------------------------------------


def measured(cluster: Cluster, store: Path, edge: int) -> dict[str, float]:
    """Medians of a first picture, of a second one and of one with few pixels."""
    times: dict[str, list[float]] = {"first": [], "second": [], "small": []}
    bricks = 0
    with _edge(edge):
        for _ in range(_REPEATS + 1):  # kernels are built in the first
            volume = clvol.open(store, trusted=True)
            with clvol.Renderer(volume, "linear", cluster=cluster) as renderer:
                for name, pixels in (("first", _PIXELS), ("second", _PIXELS), ("small", _FEW)):
                    start = time.perf_counter()
                    renderer.render(_CAMERA, "mean", (pixels, pixels), lod=0)
                    times[name].append(time.perf_counter() - start)
                assert isinstance(renderer.field, BrickedField)
                bricks = renderer.field.reads.bricks
    return {name: float(np.median(some[1:])) for name, some in times.items()} | {"bricks": bricks}


def dispatched(cluster: Cluster) -> float:
    """Processor seconds of this process, which runs the scheduler, for a task that does nothing."""
    rounds = []
    for _ in range(_REPEATS):
        start, before = time.process_time(), None
        for _ in range(_NOTHINGS):
            before = cluster.submit(_nothing, before)
        for _ in cluster.as_completed([before]):
            pass
        rounds.append((time.process_time() - start) / _NOTHINGS)
    return float(np.median(rounds))


def _nothing(_: object) -> None:
    return None


@contextlib.contextmanager
def _of_single_threads(workers: int) -> Iterator[Cluster]:
    """Start n processes on this machine, each limited to one core."""
    import distributed

    env = {"POCL_MAX_PTHREAD_COUNT": "1", "CL_CONFIG_CPU_FORCE_MAX_COMPUTE_UNITS": "1"}
    with (
        distributed.LocalCluster(  # type: ignore[no-untyped-call]  # as distributed has it
            n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0, silence_logs=50, env=env
        ) as local,
        distributed.Client(local, set_as_default=False) as client,  # type: ignore[no-untyped-call]
        as_cluster(client) as cluster,
    ):
        yield cluster


@contextlib.contextmanager
def _edge(edge: int) -> Iterator[None]:
    """One brick size for all configurations."""
    with mock.patch("clvol.bricks.field.edge_for", return_value=edge):
        yield


def store_of(size: int, folder: Path) -> Path:
    """The volume of shells, as a Zarr array."""
    import zarr

    store, edge = folder / f"scale-{size}.zarr", 64
    if not store.exists():
        shells = Shells(size)
        array = zarr.create_array(store, shape=shells.shape, chunks=(edge,) * 3, dtype="uint16")
        for z in range(0, size, edge):
            array[z : z + edge] = shells[z : z + edge, 0:size, 0:size]
    return store


def checked(size: int, counts: Sequence[int], folder: Path) -> list[dict[str, Any]]:
    """Runs by one process and by several on this machine, and the simulation of the latter."""
    store, tiny, edge, cores = store_of(size, folder), store_of(64, folder), 64, len(os.sched_getaffinity(0))
    with _edge(edge), BrickedField(clvol.open(store, trusted=True), "linear") as field:
        view = _CAMERA.view(field.volume.grid, 1.0)
        plans = {n: plan(field, view, (_PIXELS, _PIXELS), n, parts._AREAS * n) for n in {1, *counts}}
        few = len(plan(field, view, (_FEW, _FEW), 1, parts._AREAS))
        bricks = len(field.bricks)
    with _of_single_threads(1) as cluster:
        costs = fitted(measured(cluster, store, edge), measured(cluster, tiny, edge), dispatched(cluster), plans[1], few, bricks)
    print(costs, flush=True)
    rows = []
    for n in counts:
        with _of_single_threads(n) as cluster:
            run = measured(cluster, store, edge)
        again = [replace(task, bricks=()) for task in plans[n]]
        rows.append(
            {
                "workers": n,
                "tasks": len(plans[n]),
                "bricks": run["bricks"],
                "first": run["first"],
                "first simulated": simulated(plans[n], costs, n, together=cores),
                "second": run["second"],
                "second simulated": simulated(again, costs, n, together=cores, joined=True),
            }
        )
        print(row_text(rows[-1]), flush=True)
    return rows


def fitted(run: dict[str, float], tiny: dict[str, float], dispatch: float, tasks: Sequence[Task], few: int, bricks: int) -> Costs:
    """Constants that reproduce the runs of one worker, and those of a one-brick volume; a byte counts as 1 ns.

    A first picture takes longer than a second one by joining and by the bricks.
    """
    byte, more, one = 1e-9, run["first"] - run["second"], tiny["first"] - tiny["second"]
    brick = (more - one) / (bricks - 1)
    begin = 0.02  # seconds of the asking process
    task = max(0.0, run["small"] - begin - few * dispatch) / few
    rest = run["second"] - begin - len(tasks) * (task + dispatch) - byte * sum(t.nbytes for t in tasks)
    sample = max(rest, 1e-6) / sum(t.samples for t in tasks)
    return Costs(brick, sample, byte, task, begin, max(0.0, one - brick), dispatch)


def row_text(row: dict[str, Any]) -> str:
    return "  ".join(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items())


# -- what no one has -----------------------------------------------------------------------------------------------------------

LARGE = Costs(
    brick=128**3 * 2 / 400e6 + 128**3 * 1.4 / 2e8, sample=1 / 4e8, byte=1 / 1e9, task=0.003, begin=0.1, join=0.2, dispatch=0.001
)
"""Of a worker with 16 cores: bricks of 128³ uint16 at 400 MB/s unpacked, and 2·10⁸ coefficients a second, margins included;
4·10⁸ samples a second; a network of 1 GB/s; a scheduler that sends 1,000 tasks a second; 0.2 s to open the volume."""
_STORE = 20e9  # bytes per second that a store delivers to all workers together


def large(edge_of_volume: int, workers: int, pixels: int, share: float) -> dict[str, Any]:
    """A picture of a volume of which the given fraction of bricks matters, by workers that have read nothing yet."""
    volume = clvol.LazyVolume(np.broadcast_to(np.uint16(0), (edge_of_volume,) * 3), limits=(0, 1), labels=False)
    with _edge(128), BrickedField(volume, "linear") as field:
        view = _CAMERA.view(field.volume.grid, 1.0)
        radius = field.bricks.counts[0] / 2

        def seen(at: tuple[int, ...]) -> bool:  # a shell, as thick as the fraction requires
            r = math.dist(at, (radius,) * 3) / radius
            return abs(r - 0.62) < share / (4 * math.pi * 0.62**2) * 8 / 2

        groups = parts._GROUPS * workers
        coarse = field if len(field.bricks) <= 60_000 else None
        begun = time.perf_counter()
        if coarse is None:  # boxes instead of bricks: the plan is the same, and the bricks of a box are counted together
            tasks, wanted = _by_boxes(field, view, pixels, workers, share)
        else:
            tasks = plan(field, view, (pixels, pixels), workers, parts._AREAS * workers, seen=seen)
            wanted = len({brick for task in tasks for brick in task.bricks})
        planned = time.perf_counter() - begun
    nbytes = wanted * 128**3 * 2.0
    costs = LARGE
    if nbytes / _STORE > wanted * costs.brick / workers:  # the store is the bottleneck
        costs = replace(costs, brick=nbytes / _STORE / wanted * workers)
    even = simulated(tasks, costs, workers)
    ragged = simulated(tasks, costs, workers, spread=0.5, slow=max(1, workers // 100))
    return {
        "voxels": float(edge_of_volume) ** 3,
        "workers": workers,
        "pixels": pixels,
        "bricks": wanted,
        "GB read": nbytes / 1e9,
        "GB passed on": sum(t.nbytes for t in tasks) / 1e9,
        "tasks": len(tasks),
        "boxes": groups,
        "seconds": even,
        "with stragglers": ragged,
        "by a tree": simulated(as_tree(tasks), costs, workers),
        "planning": planned,
    }


def _by_boxes(field: Any, view: Any, pixels: int, workers: int, share: float) -> tuple[list[Task], int]:
    """Like `plan`, but counting bricks by boxes."""
    tree = parts.groups_of(field.bricks.counts, parts._GROUPS * workers)
    groups = list(parts.visible(tree, field, view))
    grid = field.volume.grid
    areas = parts._AREAS * workers
    edge = max(parts._SMALLEST, -(-math.isqrt(pixels * pixels // areas) // parts._SMALLEST) * parts._SMALLEST)
    spans = [pixels_of(group.box(field), view, grid, pixels, pixels, 0) for group in groups]
    met: dict[int, list[tuple[int, int]]] = {}
    for number, (left, top, right, bottom) in enumerate(spans):
        met[number] = [
            (y, x)
            for y in range(top // edge * edge, min(bottom + 1, pixels), edge)
            for x in range(left // edge * edge, min(right + 1, pixels), edge)
        ]
    count = {g.number: math.prod(b - a for a, b in zip(g.first, g.stop, strict=True)) * share for g in groups}
    last: dict[tuple[int, int], int] = {}
    rest = 0.0
    tasks: list[Task] = []
    for number, group in enumerate(groups):
        across = max(b - a for a, b in zip(group.first, group.stop, strict=True))
        for place in met[number]:
            some = count[group.number] / len(met[number])
            first, rest = math.floor(rest), rest + some  # whole bricks, none lost
            names = tuple((group.number, place, i) for i in range(math.floor(rest) - first))
            samples = edge * edge * across * 128 * 1.5 / 0.5 * share
            before = (last[place],) if place in last else ()
            tasks.append(Task(before, group.number % workers, names, samples, 20.0 * edge * edge))
            last[place] = len(tasks) - 1
    return tasks, sum(len(task.bricks) for task in tasks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        runs = checked(given.size, given.workers, given.folder or Path(temporary))
    beyond = []
    for edge, workers in ((2154, 1), (2154, 10), (4642, 10), (4642, 100), (10000, 100), (10000, 1000), (21544, 1000)):
        beyond.append(large(edge, workers, 2048, 0.1))
        print(row_text(beyond[-1]), flush=True)
    if given.json:
        given.json.write_text(json.dumps({"runs": runs, "beyond": beyond}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
