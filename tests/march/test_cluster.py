"""Pictures by a cluster equal those of one process, and failures are reported."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol import cli
from clvol.base.errors import ClusterError, DataError, DeviceError, FormatError, OptionError
from clvol.bricks.field import BrickedField
from clvol.dask import cluster as clusters
from clvol.dask.cluster import Cluster, as_cluster, worker_device
from clvol.march import cluster as parts
from clvol.march.cluster import Group, Shared, groups_of, visible
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from tests.march.test_bricks import BUMPY, CAMERAS, GUIDES, MODES, waves

dask = pytest.importorskip("dask")
pytest.importorskip("dask.array")
distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with as_cluster(2) as made:
        yield made


@pytest.fixture(scope="module")
def volume() -> clvol.LazyVolume:
    return clvol.LazyVolume(waves(35, 44, 51), (1, 0.9, 1.2), (3, -2, 5), name="waves", limits=(0, 1), labels=False)


@pytest.fixture(autouse=True)
def small_bricks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.bricks.field.edge_for", lambda *_, **_options: 16)


def both(cluster: Cluster, merge: Any, volume: Any, filter: str, *args: Any, **options: Any) -> tuple[Any, Any]:
    """A picture by bricks of one process, and of several."""
    with (
        BrickedField(volume, filter) as field,
        Renderer(field) as one,
        Renderer(volume, filter, cluster=cluster, merge=merge) as many,
    ):
        return one.render(*args, **options), many.render(*args, **options)


# -- who has what --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [(1, 1, 1), (2, 1, 3), (5, 7, 4), (16, 1, 1)])
@pytest.mark.parametrize("most", [1, 2, 8, 31])
def test_each_brick_is_in_one_group(counts: tuple[int, int, int], most: int) -> None:
    found: list[Group] = []

    def collect(tree: Any) -> None:
        if isinstance(tree, Group):
            found.append(tree)
        else:
            collect(tree.low)
            collect(tree.high)

    collect(groups_of(counts, most))
    assert len(found) <= most
    assert len(found) == min(most, np.prod(counts)) or most > 8
    assert [group.number for group in found] == list(range(len(found)))
    bricks = [at for g in found for at in itertools.product(*(range(a, b) for a, b in zip(g.first, g.stop, strict=True)))]
    assert sorted(bricks) == sorted(itertools.product(*map(range, counts)))


@pytest.mark.parametrize("name", CAMERAS)
def test_groups_are_ordered_front_to_back(volume: clvol.LazyVolume, name: str) -> None:
    """Along each ray, samples lie in groups in rendering order."""
    with BrickedField(volume, "linear", edge=8) as field:
        view = CAMERAS[name].view(volume.grid, 1.0)
        groups = list(visible(groups_of(field.bricks.counts, 12), field, view))
        rng = np.random.default_rng(0)
        size = np.array(volume.size)
        for _ in range(200):
            ends = rng.random((2, 3)) * size - 0.5
            if view.orthographic:
                ends[1] = ends[0] + (volume.grid.world_to_index_matrix @ view.forward) * 30
            else:
                ends[0] = volume.grid.world_to_index(view.eye)
            points = ends[0] + np.linspace(0, 1, 60)[:, None] * (ends[1] - ends[0])
            numbers = []
            for point in points[((points >= -0.5) & (points <= size - 0.5)).all(1)]:
                at = np.clip(np.floor((point - field.bricks.offset) / field.edge), 0, np.array(field.bricks.counts) - 1)
                numbers.append(next(i for i, g in enumerate(groups) if (at >= g.first).all() and (at < g.stop).all()))
            assert numbers == sorted(numbers)


# -- pictures ------------------------------------------------------------------------------------------------------------------


@pytest.mark.one_in(8)
@pytest.mark.parametrize(("mode", "options"), MODES)
def test_merging_in_order_is_bit_identical(cluster: Cluster, volume: clvol.LazyVolume, mode: str, options: dict[str, Any]) -> None:
    options = options | ({"transfer": BUMPY} if mode == "composite" else {})
    one, many = both(cluster, "order", volume, "linear", CAMERAS["aslant"], mode, (70, 50), outputs=GUIDES, **options)
    for name in GUIDES:
        np.testing.assert_array_equal(many[name], one[name], err_msg=name)
    assert one["rgba"].max() > 0


@pytest.mark.one_in(9)
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize(("mode", "options"), [("composite", {"rays": 3}), ("isosurface", {}), ("mip", {})])
def test_from_any_view_with_a_prefilter(
    cluster: Cluster, volume: clvol.LazyVolume, mode: str, options: dict[str, Any], view: str
) -> None:
    one, many = both(cluster, "order", volume, "bspline3", CAMERAS[view], mode, (90, 70), **options)
    np.testing.assert_array_equal(many, one)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("rays", ["auto", 2])
def test_several_media_go_together_in_each_worker(cluster: Cluster, volume: clvol.LazyVolume, rays: Any) -> None:
    look = clvol.TransferFunction([(0, "red"), (1, "white")], [(0.3, 0), (1, 0.2)])
    ball = clvol.Volume(clvol.phantoms.sphere(24).data, (2, 2, 2), (1, 2, 3))
    scene = clvol.Scene([clvol.Medium(volume, look, filter="mitchell"), clvol.Medium(ball, look, filter="linear")])  # type: ignore[arg-type]
    with Renderer(scene) as one, Renderer(scene, cluster=cluster) as many:
        done: list[float] = []
        want = one.render(size=(90, 70), rays=rays, outputs=["rgba", "depth"])
        got = many.render(size=(90, 70), rays=rays, outputs=["rgba", "depth"], progress=done.append)
        assert done[-1] == 1
        for name in want:
            np.testing.assert_array_equal(got[name], want[name])
        surface = {"size": (40, 30), "mode": "isosurface", "isovalue": 0.5}
        np.testing.assert_array_equal(many.render(**surface), one.render(**surface))
        assert len(pickle.dumps(many)) < 1 << 20


def test_workers_know_what_is_left_of_light(cluster: Cluster, volume: clvol.LazyVolume) -> None:
    """Of layers that are computed apart."""
    one, many = both(cluster, "order", volume, "linear", size=(40, 30), rays=1, shadow=1, occlusion=1)
    np.testing.assert_allclose(many, one, atol=1e-6)


def test_regions_of_labels(cluster: Cluster) -> None:
    """In order the same bits, cut open or not; a tree would miss boundaries between two boxes."""
    blocks = np.random.default_rng(3).integers(0, 4, (6, 6, 6)).astype(np.int16)
    labels = clvol.LazyVolume(np.kron(blocks, np.ones((5, 5, 5), np.int16)) - 1, (1, 0.9, 1.2), labels=True)
    look = {"size": (40, 40), "mode": "regions", "outputs": ["rgba", "depth", "normal"]}
    with (
        Renderer(labels.whole()) as one,
        Renderer(labels, cluster=cluster) as many,
        Renderer(labels, cluster=cluster, merge="tree") as tree,
    ):
        for clip in (None, clvol.Plane((1, -0.6, 0.3), labels.center)):
            want, got = (renderer.render(CAMERAS["aslant"], clip=clip, **look) for renderer in (one, many))  # type: ignore[call-overload]
            for name in want:
                np.testing.assert_array_equal(got[name], want[name], err_msg=name)
        assert many.shown.bricks.counts == (2, 2, 2)  # type: ignore[union-attr]
        with pytest.raises(OptionError, match='merge must be "order" for boundaries of regions'):
            tree.render(**look)  # type: ignore[call-overload]


@pytest.mark.one_in(4)
@pytest.mark.parametrize(("mode", "options"), [pair for pair in MODES if "method" not in pair[1]])
def test_merging_by_a_tree(cluster: Cluster, volume: clvol.LazyVolume, mode: str, options: dict[str, Any]) -> None:
    options = options | ({"transfer": BUMPY, "termination": 0.0} if mode == "composite" else {})
    added_up = mode in ("composite", "surfaces", "mean", "integral")
    outputs = ["rgba"] if added_up else list(GUIDES)
    one, many = both(cluster, "tree", volume, "linear", CAMERAS["aslant"], mode, (70, 50), outputs=outputs, rays=1, **options)
    for name in outputs:
        if added_up:
            cover = one[name][..., 3:]
            assert np.abs(many[name] * cover - one[name] * cover).max() <= 1.1e-6  # of colour times opacity
        else:
            np.testing.assert_array_equal(many[name], one[name], err_msg=name)


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("mode", "options"), [("isosurface", {"cap": True}), ("surfaces", {"cap": "tan"}), ("composite", {}), ("mip", {})]
)
def test_cut_open(cluster: Cluster, volume: clvol.LazyVolume, mode: str, options: dict[str, Any]) -> None:
    """A plane and two corners, which leave three parts of some rays; whole at the mode's tolerances."""
    x, y, z = volume.grid.center
    inf = np.inf
    clip = [
        clvol.Plane((1, -0.6, 0.3), (x + 9, y, z)),
        clvol.Corner((x - 9, -inf, -inf), (x - 2, inf, z + 3)),
        clvol.Corner((x + 3, y - 12, -inf), (inf, y + 3, inf)),
    ]
    options = options | ({"termination": 0.0} if mode == "composite" else {})
    for merge in ("order", "tree"):
        one, many = both(cluster, merge, volume, "linear", CAMERAS["aslant"], mode, (60, 44), rays=1, clip=clip, **options)
        np.testing.assert_allclose(many, one, rtol=0, atol=2e-6 if mode in ("composite", "surfaces") and merge == "tree" else 0)
        assert one.max() > 0.2


def test_a_tree_rejects_unsupported_outputs(cluster: Cluster, volume: clvol.LazyVolume) -> None:
    for name, mode, options in (
        ("linear", "isosurface", {"method": "stepped"}),
        ("nearest", "isosurface", {}),
        ("linear", "composite", {"outputs": ["rgba", "depth"]}),
    ):
        with (
            Renderer(volume, name, cluster=cluster, merge="tree") as renderer,
            pytest.raises(OptionError, match=r'merge must be "order"'),
        ):
            renderer.render(None, mode, (32, 32), **options)
    with pytest.raises(OptionError, match="and no cluster"):
        Renderer(volume, "linear", merge="tree")
    with pytest.raises(OptionError, match="merge must be one of"):
        Renderer(volume, "linear", cluster=cluster, merge="tee")  # type: ignore[arg-type]


def test_bricks_are_read_once_and_hidden_ones_never(cluster: Cluster) -> None:
    data = np.zeros((64, 32, 32), np.float32)
    data[8:56] = 1.0  # a slab, seen along z: nothing behind its front matters
    volume = clvol.LazyVolume(data, limits=(0, 1), labels=False)
    camera = Camera.look_at((15.5, 15.5, -200.0), (15.5, 15.5, 32.0), up=(0, 1, 0), projection="orthographic")
    with Renderer(volume, "linear", cluster=cluster) as renderer:
        field = renderer.field
        assert isinstance(field, BrickedField)
        first = renderer.render(camera, "isosurface", (48, 48), isovalue=0.5, rays=1)
        assert 0 < field.reads.bricks <= 8 < np.prod(field.bricks.counts)
        read = field.reads.bricks
        np.testing.assert_array_equal(renderer.render(camera, "isosurface", (48, 48), isovalue=0.5, rays=1), first)
        assert field.reads.bricks == read  # workers have them resident


def test_a_volume_in_memory_and_progress(cluster: Cluster) -> None:
    volume = clvol.Volume(waves(35, 44, 51))
    told: list[float] = []
    with Renderer(volume, "linear") as one, Renderer(volume, "linear", cluster=cluster) as many:
        picture = many.render(CAMERAS["aslant"], "mip", (64, 64), progress=told.append)
        np.testing.assert_array_equal(picture, one.render(CAMERAS["aslant"], "mip", (64, 64)))
        assert told == sorted(told)
        assert told[-1] == 1.0

        def stop(_: float) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            many.render(CAMERAS["aslant"], "mip", (64, 64), progress=stop)
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), picture)


def test_a_pickled_renderer_reconnects_to_its_cluster(cluster: Cluster, volume: clvol.LazyVolume) -> None:
    """By its address; or it starts as many processes."""
    for merge in ("order", "tree"):
        with Renderer(volume, "linear", cluster=cluster, merge=merge) as renderer:
            packed = pickle.dumps(renderer)
            picture = renderer.render(CAMERAS["aslant"], "mip", (48, 48))
            with pickle.loads(packed) as again:
                assert again._source._workers.cluster.address == cluster.address
                assert again._source._workers.cluster is not cluster
                assert again._source._workers.merge == merge
                np.testing.assert_array_equal(again.render(CAMERAS["aslant"], "mip", (48, 48)), picture)
        assert cluster.client.status == "running"  # the copy has disconnected, and stopped no other
    again, _ = Renderer(volume, "linear", cluster=cluster).__reduce__()
    assert again.keywords == {"memory": None, "cluster": cluster.address, "merge": "order"}


def test_a_pickle_stores_the_number_of_processes(monkeypatch: pytest.MonkeyPatch, cluster: Cluster) -> None:
    monkeypatch.setattr("clvol.march.cluster.as_cluster", lambda _: cluster)
    with Renderer(waves(20, 20, 20), "linear", cluster=3) as renderer:
        again, _ = renderer.__reduce__()
        assert again.keywords["cluster"] == 3
        monkeypatch.setattr(clusters, "_close", lambda _: None)
        renderer._lease = type(renderer._lease)("left to the others")  # the cluster is theirs


TERMINATIONS = [{}, {"termination": 0.05}]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("options", TERMINATIONS, ids=str)
@pytest.mark.parametrize("dense", [0.05, 0.4, 1.0])
def test_a_tree_is_exact_within_the_termination(cluster: Cluster, volume: clvol.LazyVolume, dense: float, options: Any) -> None:
    """Boxes behind do not know the remaining transmittance: colour times opacity, and opacity, differ by at most that."""
    transfer = clvol.TransferFunction(((0.1, (0.2, 0.3, 1)), (0.9, (1, 0.8, 0.3))), ((0.2, dense / 3), (0.5, dense), (1.0, dense)))
    bound = {"termination": clvol.modes()["composite"].termination, **options}["termination"] + 1e-6
    one, many = both(
        cluster, "tree", volume, "linear", CAMERAS["aslant"], "composite", (70, 50), rays=1, transfer=transfer, **options
    )
    a, b = (np.concatenate([p[..., :3] * p[..., 3:], p[..., 3:]], -1) for p in (one, many))
    assert np.abs(a - b).max() <= bound
    assert one[..., 3].max() > 1 - bound or dense < 0.3  # some rays are stopped


@pytest.mark.parametrize("merge", ["order", "tree"])
def test_levels_and_progressive_pictures(cluster: Cluster, merge: Any) -> None:
    """Each level equals that of one process with the same bricks."""
    levels = [
        clvol.LazyVolume(waves(64, 60, 56)[::step, ::step, ::step].copy(), (step,) * 3, limits=(0, 1), labels=False)
        for step in (1, 2, 4)
    ]
    brain = levels[0].with_levels(levels[1:])
    camera, mode = CAMERAS["aslant"], "mip" if merge == "tree" else "composite"
    with (
        BrickedField(brain, "linear") as field,
        Renderer(field) as one,
        Renderer(brain, "linear", cluster=cluster, merge=merge) as many,
    ):
        shown = set()
        for lod in (0, 1, 2.5):
            for size in ((96, 64), (24, 24)):
                options: dict[str, Any] = {"lod": lod, "rays": 2}
                picture = many.render(camera, mode, size, **options)
                np.testing.assert_array_equal(picture, one.render(camera, mode, size, **options))
                assert many.shown.volume.shape == one.shown.volume.shape
                shown.add(many.shown.volume.shape)
        assert len(shown) == 3
        several = [list(renderer.refine(camera, mode, (96, 64), lod=0)) for renderer in (one, many)]
        assert [picture.final for picture in several[1]] == [False, False, True]
        for a, b in zip(*several, strict=True):
            np.testing.assert_array_equal(b, a)
        np.testing.assert_array_equal(several[1][-1], many.render(camera, mode, (96, 64), lod=0))


# -- samples of arrays of dask ---------------------------------------------------------------------------------------------------


class Asking:
    """Samples whose reading uses the cluster."""

    def __init__(self, array: Any) -> None:
        self.array, self.shape, self.dtype = array, array.shape, array.dtype

    def __getitem__(self, index: Any) -> Any:
        return self.array[index].compute()


@pytest.mark.parametrize("source", [lambda array: array, Asking], ids=["dask", "asking"])
def test_reading_that_uses_the_cluster_does_not_deadlock(cluster: Cluster, source: Any) -> None:
    """No task waits for one that cannot start."""
    data = waves(44, 35, 40)
    array = dask.array.from_array(data, chunks=16).map_blocks(lambda block: block * 1)
    wanted, volume = (clvol.LazyVolume(a, limits=(0, 1), labels=False) for a in (data, source(array)))
    with BrickedField(wanted, "linear") as field, Renderer(field) as one, Renderer(volume, "linear", cluster=cluster) as many:
        expected = one.render(CAMERAS["aslant"], "mip", (64, 64))
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), expected)


def test_a_mapped_file_is_sent_by_name(cluster: Cluster, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", waves(44, 35, 40))
    data = np.load(tmp_path / "a.npy", mmap_mode="r")
    sent: list[int] = []
    scatter = Cluster.scatter
    monkeypatch.setattr(Cluster, "scatter", lambda *a: sent.extend((len(pickle.dumps(a[1])), a[2])) or scatter(*a))
    for volume in (clvol.LazyVolume(data, limits=(0, 1), labels=False), clvol.Volume(data, labels=False)):
        one, many = both(cluster, "order", volume, "linear", CAMERAS["aslant"], "mip", (64, 64))
        np.testing.assert_array_equal(many, one)
    assert max(sent) < 10_000


def test_futures_are_rejected(cluster: Cluster) -> None:
    with cluster.client.as_current():
        array = cluster.client.persist(dask.array.from_array(waves(20, 20, 20), chunks=16)) + 1
        volume = clvol.LazyVolume(array, name="kept", limits=(0, 2), labels=False)
        with Renderer(volume, "linear", cluster=cluster) as renderer, pytest.raises(DataError, match=r"got kept, .* futures"):
            renderer.render(None, "mip", (32, 32))
        with pytest.raises(DataError, match=r"got kept, .* futures"):
            clvol.batch(volume, cluster=cluster)


# -- faults --------------------------------------------------------------------------------------------------------------------


class Slow:
    """Slow samples, so that a process can be killed meanwhile."""

    def __init__(self, data: Any) -> None:
        self.data, self.shape, self.dtype = data, data.shape, data.dtype

    def __getitem__(self, index: Any) -> Any:
        time.sleep(0.02)
        return self.data[index]


class Poison(Slow):
    """Samples, one of which kills each worker that reads it."""

    def __getitem__(self, index: Any) -> Any:
        if _in_a_worker() and all(part.start <= 22 < part.stop for part in index):  # in a brick, and no other's margin
            os.kill(os.getpid(), signal.SIGKILL)
        return self.data[index]


def _in_a_worker() -> bool:
    return multiprocessing.parent_process() is not None


class Damaged(Slow):
    """Samples, some of which cannot be read."""

    def __getitem__(self, index: Any) -> Any:
        if _in_a_worker() and index[0].stop > 40:
            raise OSError("chunk 7/3 is damaged")
        return self.data[index]


def test_a_killed_worker_costs_only_time() -> None:
    volume = clvol.LazyVolume(Slow(waves(60, 50, 40)), limits=(0, 1), labels=False)
    with as_cluster(2) as own:
        processes = list(own.client.run(os.getpid).values())
        killed: list[int] = []

        def kill(_: float) -> None:
            if not killed:
                killed.append(processes[0])
                os.kill(processes[0], signal.SIGKILL)

        with Renderer(volume, "linear", cluster=own) as many, BrickedField(volume, "linear") as field, Renderer(field) as one:
            picture = many.render(CAMERAS["aslant"], "mip", (96, 96), progress=kill)
            assert killed
            np.testing.assert_array_equal(picture, one.render(CAMERAS["aslant"], "mip", (96, 96)))


def test_data_lost_with_the_only_worker_are_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "_LARGE", 1 << 10)  # so that it is no part of what the scheduler keeps
    volume = clvol.Volume(waves(40, 40, 40))
    with as_cluster(1) as own, Renderer(volume, "linear", cluster=own) as many, Renderer(volume, "linear") as one:
        wanted = one.render(CAMERAS["aslant"], "mip", (64, 64))
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), wanted)
        (process,) = own.client.run(os.getpid).values()
        os.kill(process, signal.SIGKILL)
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), wanted)


def test_a_poison_brick_is_named() -> None:
    volume = clvol.LazyVolume(Poison(waves(48, 48, 48)), name="poison", limits=(0, 1), labels=False)
    with as_cluster(2) as own, Renderer(volume, "linear", cluster=own) as renderer:
        with pytest.raises(ClusterError, match=r"brick \(1, 1, 1\) \(x, y, z\), samples \[.*\] of poison, ends each worker"):
            renderer.render(CAMERAS["aslant"], "mean", (32, 32))
        assert own.client.status == "running"


def _said(monkeypatch: pytest.MonkeyPatch, field: BrickedField, killer: Any) -> tuple[str, list[list[Any]]]:
    """The message for a box of 2 × 2 × 2 bricks, and the bricks read for it."""
    read: list[list[Any]] = []
    monkeypatch.setattr(parts._Work, "_killer", lambda _, bricks: read.append(list(bricks)) or killer(read[-1]))
    work = parts._Work(Shared.__new__(Shared), None, [Group(7, (0, 0, 0), (2, 2, 2))])
    monkeypatch.setattr(work._shared, "field", field, raising=False)
    monkeypatch.setattr(work, "cancel", lambda: None)
    return str(work._named(clusters.PoisonError("a worker died", f"{work._name}-7-0"))), read


@pytest.mark.parametrize("guilty", [*itertools.product((0, 1), repeat=3)])
def test_the_named_brick_was_read_alone(monkeypatch: pytest.MonkeyPatch, guilty: Any) -> None:
    with BrickedField(waves(32, 32, 32), "linear", edge=16) as field:
        said, read = _said(monkeypatch, field, lambda bricks: guilty if guilty in bricks else None)
    assert said.startswith(f"brick {guilty} (x, y, z), samples [")
    assert read == [[*itertools.product((0, 1), repeat=3)], [guilty]]


def test_no_brick_is_named_without_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    with BrickedField(waves(32, 32, 32), "linear", edge=16) as field:
        said, read = _said(monkeypatch, field, lambda bricks: bricks[3] if len(bricks) > 1 else None)  # together they are too much
        assert said.startswith("bricks (0, 0, 0) to (1, 1, 1) (x, y, z) of the volume end each worker that reads all of them")
        assert len(read) == 2
        said, read = _said(monkeypatch, field, lambda _: None)
        assert "though they can be read" in said
        assert len(read) == 1


@pytest.mark.thorough
def test_a_second_picture_after_workers_restarted_at_their_ports() -> None:
    """A replacement has the address of the killed worker, and none of its bricks."""
    ports = [_free_port() for _ in range(2)]
    spec = {
        i: {
            "cls": distributed.Nanny,
            "options": {"nthreads": 1, "worker_port": port, "memory_limit": 0, "env": {"POCL_MAX_PTHREAD_COUNT": "1"}},
        }
        for i, port in enumerate(ports)
    }
    volume = clvol.LazyVolume(waves(35, 44, 51), limits=(0, 1), labels=False)
    scheduler = {"cls": distributed.Scheduler, "options": {"dashboard": False}}
    with (
        distributed.SpecCluster(workers=spec, scheduler=scheduler, silence_logs=50) as local,
        distributed.Client(local, set_as_default=False) as client,
        BrickedField(volume, "linear") as field,
        Renderer(field) as one,
        as_cluster(client) as own,
        Renderer(volume, "linear", cluster=own) as many,
    ):
        client.wait_for_workers(2, timeout=60)
        wanted = one.render(CAMERAS["aslant"], "mip", (64, 64))
        before = own.workers
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), wanted)
        killed = client.run(os.getpid)[before[0]]
        os.kill(killed, signal.SIGKILL)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and (
            len(own.workers) < 2
            or any(not isinstance(pid, int) or pid == killed for pid in client.run(os.getpid, on_error="return").values())
        ):
            time.sleep(0.1)
        assert own.workers == before
        np.testing.assert_array_equal(many.render(CAMERAS["aslant"], "mip", (64, 64)), wanted)


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def test_unreadable_samples_are_named(cluster: Cluster) -> None:
    volume = clvol.LazyVolume(Damaged(waves(48, 30, 30)), name="damaged", limits=(0, 1), labels=False)
    with (
        Renderer(volume, "linear", cluster=cluster) as renderer,
        pytest.raises(FormatError, match=r"cannot read samples .* of damaged: chunk 7/3 is damaged"),
    ):
        renderer.render(CAMERAS["aslant"], "mean", (32, 32))


def test_a_scheduler_that_is_gone(monkeypatch: pytest.MonkeyPatch, volume: clvol.LazyVolume) -> None:
    monkeypatch.setattr(clusters, "WAIT", 2.0)
    with pytest.raises(ClusterError, match=r"no scheduler answers at tcp://127.0.0.1:9: .*refused"):
        as_cluster("tcp://127.0.0.1:9")
    monkeypatch.setattr(clusters, "WAIT", 10.0)
    monkeypatch.setattr(clusters, "_CENSUS", 0.2)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as local:
        renderer = Renderer(volume, "linear", cluster=local.scheduler_address)
    begun = time.monotonic()
    with pytest.raises(ClusterError, match=r"gone|no scheduler"):
        renderer.render(CAMERAS["aslant"], "mean", (32, 32))
    assert time.monotonic() - begun < 30
    renderer.close()


def failing(path: Any, error: Exception) -> None:
    """Leave a mark for each call."""
    with path.open("a") as file:
        file.write("called\n")
    raise error


@pytest.mark.parametrize(
    ("error", "times"),
    [(FormatError("no chunk"), 3), (OSError("no disk"), 3), (DataError("NaN"), 1), (OptionError("no"), 1)],
    ids=repr,
)
def test_only_transient_errors_are_retried(cluster: Cluster, tmp_path: Any, error: Exception, times: int) -> None:
    expected = type(error) if isinstance(error, clvol.ClvolError) else ClusterError
    with pytest.raises(expected, match=str(error)):
        list(cluster.as_completed([cluster.submit(failing, tmp_path / "calls", error)]))
    assert (tmp_path / "calls").read_text().count("called") == times


class Endless:
    """A future whose result arrives only after the given timeout."""

    def __init__(self, comes: float) -> None:
        self.comes, self.asked = comes, list[float]()

    def done(self) -> bool:
        return True

    def result(self, timeout: float) -> str:
        self.asked.append(timeout)
        if timeout < self.comes:
            raise TimeoutError
        return "there"

    def release(self) -> None:
        pass


def test_a_slow_result(cluster: Cluster) -> None:
    """It is requested with growing timeouts, then abandoned."""
    slow = Endless(3 * clusters.WAIT)
    assert cluster._result(slow) == "there"
    assert slow.asked == [clusters.WAIT, 2 * clusters.WAIT, 4 * clusters.WAIT]
    never = Endless(np.inf)
    with pytest.raises(
        ClusterError, match=r"results must come from the workers at tcp://.*; one did not within 320 s, though it is"
    ):
        cluster._result(never)
    assert sum(never.asked) < 2 * clusters.SLOWEST


def test_a_scheduler_without_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "WAIT", 1.0)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=50) as local,
        distributed.Client(local, set_as_default=False) as client,
        pytest.raises(ClusterError, match="must have workers; got none within 1 s"),
    ):
        as_cluster(client)


def test_workers_of_another_version(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clvol, "__version__", "0.0.7")
    with pytest.raises(ClusterError, match=r"workers must have clvol 0.0.7, as this process has; tcp://.* has \d"):
        as_cluster(cluster.client)


@contextlib.contextmanager
def processes(folder: Any, **environment: str) -> Iterator[tuple[str, list[Any]]]:
    """A scheduler and a worker started by hand, with extra environment for the worker; the address and both."""
    port, started = _free_port(), list[Any]()
    quiet: dict[str, Any] = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    address = f"tcp://127.0.0.1:{port}"
    module = [sys.executable, "-m", "distributed.cli.dask_"]
    try:
        command = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
        started.append(subprocess.Popen([*module[:2], module[2] + command[0], *command[1:]], **quiet))
        command = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        more = os.environ | {"POCL_MAX_PTHREAD_COUNT": "1"} | environment
        started.append(subprocess.Popen([*module[:2], module[2] + command[0], *command[1:]], env=more, **quiet))
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
                break
            time.sleep(0.1)
        yield address, started
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.thorough
def test_a_worker_with_another_clvol(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has only the name."""
    monkeypatch.setattr(clusters, "WAIT", 60.0)
    (tmp_path / "clvol").mkdir()
    (tmp_path / "clvol" / "__init__.py").write_text('__version__ = "0.0.1"\n')
    with (
        processes(tmp_path, PYTHONPATH=str(tmp_path)) as (address, _),
        pytest.raises(ClusterError, match=r"workers must have clvol .*; tcp://.* has none, or another .*pip install clvol=="),
    ):
        as_cluster(address)


@pytest.mark.thorough
def test_a_worker_environment_without_opencl(tmp_path: Any, volume: clvol.LazyVolume, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "WAIT", 60.0)
    (tmp_path / "none").mkdir()
    with (
        processes(tmp_path, OCL_ICD_VENDORS=str(tmp_path / "none")) as (address, _),
        Renderer(volume, "linear", cluster=address) as renderer,
        pytest.raises(ClusterError, match=r"workers must have an OpenCL device; tcp://.* has none: "),
    ):
        renderer.render(None, "mip", (32, 32))


@pytest.mark.thorough
@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize("how", ["SIGSTOP", "SIGKILL"])
def test_a_scheduler_that_stops_during_a_picture(tmp_path: Any, how: str, volume: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most two timeouts and a check of the workers."""
    monkeypatch.setattr(clusters, "WAIT", 60.0)
    with (
        processes(tmp_path) as (address, (scheduler, _)),
        as_cluster(address) as own,
        Renderer(volume, "linear", cluster=own) as renderer,
    ):
        monkeypatch.setattr(clusters, "WAIT", 3.0)
        stopped = 0.0

        def stop(_: float) -> None:
            nonlocal stopped
            if not stopped:
                stopped = time.monotonic()
                scheduler.send_signal(getattr(signal, how))

        with pytest.raises(ClusterError, match=r"is gone, or has dropped this work|workers that had what this takes are gone"):
            renderer.render(CAMERAS["aslant"], "mean", (96, 96), progress=stop)
        assert 0 < time.monotonic() - stopped < 2 * clusters.WAIT + clusters._CENSUS + 5
        scheduler.kill()  # so that leaving waits for nobody


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_a_scheduler_killed_between_pictures_is_one_error(tmp_path: Any, volume: Any, caplog: pytest.LogCaptureFixture) -> None:
    with processes(tmp_path) as (address, (scheduler, _)), Renderer(volume, "linear", cluster=address) as renderer:
        renderer.render(None, "mip", (16, 16))
        scheduler.kill()
        scheduler.wait()
        with pytest.raises(ClusterError, match="is gone, or has dropped this work"):
            renderer.render(None, "mip", (16, 16))
    assert not [record for record in caplog.records if record.name == "distributed.client" and record.exc_info]


def test_the_command_renders_by_a_cluster(cluster: Cluster, tmp_path: Any) -> None:
    command = ["render", "phantom:marschner-lobb:24", "--size", "48", "40", "--mode", "mip"]
    for name, options in (("a", ["--by-bricks"]), ("b", ["--scheduler", cluster.address])):
        with pytest.raises(SystemExit) as end:
            cli.main([*command, "-o", str(tmp_path / f"{name}.png"), *options])
        assert end.value.code == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.thorough
def test_the_command_starts_workers(tmp_path: Any) -> None:
    command = [sys.executable, "-m", "clvol", "render", "phantom:marschner-lobb:24", "--size", "48", "40"]
    for name, options in (("a", ["--by-bricks"]), ("b", ["--workers", "2"])):
        subprocess.run([*command, "-o", str(tmp_path / f"{name}.png"), *options], check=True, capture_output=True)
    pictures = [np.asarray(iio.imread(tmp_path / f"{name}.png"), int) for name in "ab"]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1  # bricks of another size


INTERRUPTED = """
import signal
import sys
import distributed
from clvol import cli
from clvol.dask.cluster import Cluster
done, local = Cluster.as_completed, distributed.LocalCluster
def told(self, *args, **options):
    for one in done(self, *args, **options):
        print("drawing", flush=True)
        yield one
def begun(**options):
    print("starting", flush=True)
    return local(**options)
Cluster.as_completed, distributed.LocalCluster = told, begun
signal.signal(signal.SIGINT, signal.default_int_handler)  # who starts tests in the background has it ignored
cli.main(sys.argv[1:])
"""
LONG = {
    "movie": ["movie", "phantom:marschner-lobb:24", "-o", "a.mp4", "--frames", "5000", "--size", "64", "64"],
    "render": ["render", "phantom:marschner-lobb:64", "-o", "a.png", "--size", "600", "600", "--rays", "2048"],
    "batch": ["batch", "phantom:marschner-lobb:24", "-o", "{frame}.png", "--turn", "5000", "--size", "64", "64"],
}


def interrupted(command: list[str], when: str, later: float, folder: Any) -> list[str]:
    """Ctrl-C to a command and its processes, as terminals send it; returns the pictures left."""
    import psutil

    process: subprocess.Popen[str] = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, *command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        start_new_session=True,
    )

    def left() -> list[psutil.Process]:
        found = []
        for one in psutil.process_iter(["status"]):
            with contextlib.suppress(OSError):
                if os.getsid(one.pid) == process.pid and one.info["status"] != psutil.STATUS_ZOMBIE:
                    found.append(one)
        return found

    try:
        assert process.stdout is not None
        while (line := process.stdout.readline()) != f"{when}\n":
            assert line, process.communicate()
        time.sleep(later)
        started = time.perf_counter()
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
        waited = time.perf_counter() - started
        assert (process.returncode, err) == (130, "clvol: interrupted\n")
        assert waited < 10
        while left() and time.perf_counter() - started < 10:
            time.sleep(0.1)
        assert left() == []
    finally:
        for one in left():
            one.kill()
        process.wait()
    return sorted(path.suffix for path in folder.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(
    ("name", "when", "later"),
    [
        ("movie", "starting", 0.7),
        pytest.param("render", "drawing", 0.1, marks=pytest.mark.thorough),
        ("movie", "drawing", 0.1),
        pytest.param("batch", "drawing", 0.1, marks=pytest.mark.thorough),
    ],
)
def test_an_interrupt_stops_the_workers_that_a_command_started(name: str, when: str, later: float, tmp_path: Any) -> None:
    """One line, no output of the workers, and no incomplete picture."""
    if name == "movie":
        pytest.importorskip("imageio_ffmpeg")
    found = interrupted([*LONG[name], "--workers", "1"], when, later, tmp_path)
    assert set(found) <= ({".png"} if name == "batch" else set())
    for path in tmp_path.iterdir():
        assert iio.imread(path).shape == (64, 64, 4)


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_cancels_the_work_of_other_workers(cluster: Cluster, tmp_path: Any) -> None:
    command = [*LONG["movie"][:3], "a.gif", *LONG["movie"][4:], "--scheduler", cluster.address]
    assert interrupted(command, "drawing", 0.1, tmp_path) == []
    until = time.monotonic() + 10
    while any(cluster.client.processing().values()) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(cluster.client.processing().values())
    assert len(cluster.workers) == 2


def test_no_cluster_at_all(volume: clvol.LazyVolume) -> None:
    for wrong in (True, 0, 2.5, None.__class__, "nowhere"):
        with pytest.raises(OptionError, match="cluster must be"):
            as_cluster(wrong)  # type: ignore[arg-type]
    with BrickedField(volume, "linear") as field, pytest.raises(OptionError, match="cluster"):
        Renderer(field, cluster=2)


def test_tls_without_certificates() -> None:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        with pytest.raises(ClusterError, match=r"no scheduler answers at tls://.*ssl_context"):
            as_cluster(f"tls://127.0.0.1:{listening.getsockname()[1]}")


def test_a_worker_without_opencl(monkeypatch: pytest.MonkeyPatch, volume: clvol.LazyVolume) -> None:
    def none(*_: object) -> Any:
        raise DeviceError('no OpenCL device: pip install "clvol[pocl]"')

    monkeypatch.setattr(parts, "worker_device", none)
    recipe = parts._Recipe(
        "t", BrickedField, volume, (0, 1), False, clvol.filters()["linear"], clvol.boundaries()["mirror"], None, 1 << 28, 16, {}
    )
    with pytest.raises(ClusterError, match=r"workers must have an OpenCL device; .* has none: no OpenCL device"):
        parts._field_of(recipe)


def test_each_worker_of_a_host_has_its_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    class Fake:
        def __init__(self, kind: str, name: str) -> None:
            self.kind, self.name = kind, name

    gpus = [Fake("gpu", "a"), Fake("gpu", "b")]
    monkeypatch.setattr(clusters, "devices", lambda: [*gpus, Fake("cpu", "c")])
    monkeypatch.setattr(clusters, "as_device", lambda choice: gpus[0] if choice is None else gpus[1])
    assert [worker_device(None, place).name for place in range(4)] == ["a", "b", "a", "b"]
    assert worker_device("b", 0).name == "b"  # asked for
