"""The function of a volume read by bricks equals that of the whole volume."""

from __future__ import annotations

import dataclasses
import gc
import pickle
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import DataError, FormatError, OptionError
from clvol.bricks.field import BrickedField, _needs
from clvol.bricks.source import known_of
from clvol.filter.boundary import boundaries
from tests.bricks.test_source import Broken, Counted

FILTERS = ("nearest", "linear", "catmull-rom", "bspline2", "bspline3", "bspline3(0.2)", "bspline5", "hybrid", "omoms3")
BOUND = {"bspline5": 4e-6}  # for a range of 1: float32 rounding of the prefilter, as for the whole volume


@pytest.fixture(scope="module")
def volume() -> clvol.Volume:
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return clvol.Volume(rng.random((37, 41, 52)).astype(np.float32), (1, 2, 3), (5, 6, 7), turn)


def points(volume: clvol.Volume, past: float, n: int = 4000) -> Any:
    at = np.random.default_rng(2).uniform(-past, np.asarray(volume.size) - 1 + past, (n, 3))
    return volume.index_to_world(at)


def needs(field: BrickedField) -> int:
    """Bytes per brick."""
    return _needs(field.volume, field.filter, field.boundary).resident(field.edge)


@pytest.mark.one_in(45)
@pytest.mark.parametrize("boundary", boundaries())
@pytest.mark.parametrize("filter", FILTERS)
def test_values_and_derivatives(volume: clvol.Volume, filter: str, boundary: str) -> None:
    bound = BOUND.get(filter, 1e-6)
    with clvol.Field(volume, filter, boundary) as whole, BrickedField(volume, filter, boundary, edge=16) as bricked:
        assert bricked.bricks.counts == (4, 3, 3)
        for past in (0.5, 70.0):  # within the domain, and far outside
            at = points(volume, past)
            np.testing.assert_allclose(bricked(at), whole(at), rtol=0, atol=bound)
            if whole.filter.has_gradient:
                np.testing.assert_allclose(bricked.gradient(at), whole.gradient(at), rtol=0, atol=4 * bound)
        at = points(volume, 3.0, 500)
        np.testing.assert_allclose(bricked(at, fill=-7.0), whole(at, fill=-7.0), rtol=0, atol=bound)


def test_hessians_and_frames(volume: clvol.Volume) -> None:
    patient = clvol.Volume(volume.data, volume.spacing, volume.origin, volume.direction, space="LPS")
    at = points(volume, 5.0, 500) * (-1, -1, 1)
    with clvol.Field(patient) as whole, BrickedField(patient, edge=16) as bricked:
        np.testing.assert_allclose(bricked.hessian(at, frame="RAS"), whole.hessian(at, frame="RAS"), rtol=0, atol=4e-6)
        np.testing.assert_allclose(bricked.gradient(at, frame="RAS"), whole.gradient(at, frame="RAS"), rtol=0, atol=4e-6)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("filter", ["linear", "catmull-rom", "nearest"])
def test_without_a_prefilter_results_are_identical(volume: clvol.Volume, filter: str) -> None:
    at = points(volume, 0.4)
    with clvol.Field(volume, filter) as whole, BrickedField(volume, filter, edge=16) as bricked:
        np.testing.assert_allclose(bricked(at), whole(at), rtol=0, atol=2e-7)  # positions round differently
        np.testing.assert_array_equal(bricked.resample(shape=(20, 50, 60)).data, whole.resample(shape=(20, 50, 60)).data)


def test_other_grids(volume: clvol.Volume) -> None:
    turned = clvol.Volume(np.zeros((9, 20, 30), np.float32), (2, 1, 3), tuple(volume.center - 20))
    with clvol.Field(volume) as whole, BrickedField(volume, edge=16) as bricked:
        for grid in ({"shape": (50, 20, 60)}, {"spacing": 2.5}, {"like": turned}, {"like": volume}):
            a, b = whole.resample(**grid), bricked.resample(**grid)
            np.testing.assert_allclose(b.data, a.data, rtol=0, atol=1e-6)
            assert (a.spacing, a.origin) == (b.spacing, b.origin)
        out = np.zeros((50, 20, 60), np.float32)
        bricked.resample(shape=(50, 20, 60), out=out)
        np.testing.assert_array_equal(out, bricked.resample(shape=(50, 20, 60)).data)
        assert np.shares_memory(bricked.resample(shape=(50, 20, 60), out=out).data, out)
        with pytest.raises(OptionError, match="out must be of floating type; got uint8"):
            bricked.resample(shape=(50, 20, 60), out=np.zeros((50, 20, 60), np.uint8))
        counts = clvol.Volume((100 * volume.data).astype(np.uint8), volume.spacing)
    with clvol.Field(counts) as whole, BrickedField(counts, edge=16) as bricked:
        a, b = (one.resample(shape=(30, 30, 30), dtype="same").data for one in (whole, bricked))
        assert a.dtype == b.dtype == np.uint8
        assert np.abs(a.astype(int) - b.astype(int)).max() <= 1  # halves may round either way
        assert (a != b).mean() < 1e-3


def test_memory_stays_within_the_budget(volume: clvol.Volume) -> None:
    """Bricks are evicted for others; each is read once while it fits; reads are counted."""
    data = Counted(volume.data)
    at = points(volume, 0.5)
    with BrickedField(clvol.LazyVolume(data, limits=(0, 1)), "linear", edge=16, memory=1 << 20) as bricked:
        before = data.read
        bricked(at - 0)
        assert bricked.reads.dropped > 10
        assert bricked.nbytes <= 1 << 20
        assert data.read - before == bricked.reads.samples
    with BrickedField(clvol.LazyVolume(data, limits=(0, 1)), "linear", edge=16) as roomy:
        expected = roomy(at)
        reads = roomy.reads.bricks
        np.testing.assert_array_equal(roomy(at), expected)
        assert roomy.reads.bricks == reads <= 4 * 3 * 3
        assert roomy.reads.dropped == 0


def test_a_volume_in_memory_that_fits_is_one_brick(volume: clvol.Volume) -> None:
    """Several bricks have margins that are prefiltered twice; one brick equals the whole volume to the last bit."""
    at = points(volume, 0.4, 500)
    with clvol.Field(volume) as whole, BrickedField(volume) as one:
        assert one.bricks.counts == (1, 1, 1)
        np.testing.assert_allclose(one(at), whole(at), rtol=0, atol=3e-7)  # positions round differently
    lazy = clvol.LazyVolume(Counted(np.zeros((300, 20, 20), np.uint8)), limits=(0, 1))
    with BrickedField(lazy, "linear") as read_by_parts, BrickedField(np.zeros((300, 20, 20), np.uint8), "linear") as one:
        assert (read_by_parts.bricks.counts, one.bricks.counts) == ((1, 1, 2), (1, 1, 1))
        assert BrickedField(np.zeros((300, 20, 20), np.uint8), "linear", "wrap").bricks.counts == (1, 1, 2)


def test_only_bricks_that_contain_points_are_read() -> None:
    data = Counted(np.zeros((256, 256, 256), np.uint8))
    with BrickedField(clvol.LazyVolume(data, limits=(0, 255)), edge=32) as bricked:
        settled = data.read  # the centre block, for the kind of the samples
        bricked([[100.0, 100.0, 100.0], [101.0, 102.0, 103.0]])
        assert bricked.reads.bricks == 1
        assert data.read - settled == bricked.reads.samples < 80**3


@pytest.mark.one_in(3)
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 5, 1), (3, 1, 40), (2, 2, 2), (17, 16, 33)])
@pytest.mark.parametrize("boundary", ["mirror", "wrap", "nearest"])
def test_small_and_thin_volumes(shape: tuple[int, int, int], boundary: str) -> None:
    volume = clvol.Volume(np.random.default_rng(3).random(shape).astype(np.float32))
    at = points(volume, 4.0, 200)
    with clvol.Field(volume, "bspline3", boundary) as whole, BrickedField(volume, "bspline3", boundary, edge=8) as bricked:
        np.testing.assert_allclose(bricked(at), whole(at), rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["u1", "i2", ">u2", "u4", "f8", ">f4", "?"])
def test_every_dtype(kind: str) -> None:
    data = (200 * np.random.default_rng(4).random((20, 20, 20))).astype(kind)
    data.setflags(write=False)
    volume = clvol.Volume(data)
    at = points(volume, 0.4, 500)
    with clvol.Field(volume, "bspline3") as whole, BrickedField(volume, "bspline3", edge=8) as bricked:
        np.testing.assert_allclose(bricked(at), whole(at), rtol=0, atol=2e-4)


def test_values_far_from_zero_are_exact_relative_to_their_range() -> None:
    volume = clvol.Volume(101325.0 + np.random.default_rng(5).random((20, 20, 20)))
    at = points(volume, 0.4, 500)
    with clvol.Field(volume) as whole, BrickedField(volume, edge=8) as bricked:
        assert bricked(at).dtype == np.float64
        np.testing.assert_allclose(bricked(at), whole(at), rtol=0, atol=2e-6)


def test_nonfinite_points(volume: clvol.Volume) -> None:
    with BrickedField(volume, edge=16) as bricked:
        assert np.isnan(bricked([[np.nan, 0, 0], [np.inf, 0, 0]])).all()
        outside = [[np.nan, 0, 0], [np.inf, 0, 0], [1e4, 0, 0]]
        with clvol.Field(volume) as whole:
            np.testing.assert_array_equal(bricked(outside, fill=3.0), whole(outside, fill=3.0))
        np.testing.assert_array_equal(bricked(outside, fill=3.0), [np.nan, np.nan, 3.0])
        assert bricked(np.zeros((0, 3))).shape == (0,)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("boundary", clvol.boundaries())
def test_faces_between_two_samples(boundary: str) -> None:
    """The outer half voxels belong to the outer samples, up to the faces."""
    volume = clvol.Volume(np.random.default_rng(7).random((9, 10, 17), np.float32))
    ends = [[a, b, c] for a in (-0.5, 16.5) for b in (-0.5, 9.5) for c in (-0.5, 8.5)]
    for name in ("nearest", "linear"):
        with clvol.Field(volume, name, boundary) as whole, BrickedField(volume, name, boundary, edge=8) as bricked:
            np.testing.assert_array_equal(bricked(ends), whole(ends))
            np.testing.assert_allclose(bricked.gradient(ends), whole.gradient(ends), rtol=0, atol=1e-6)


def test_threads_get_the_single_threaded_result(volume: clvol.Volume) -> None:
    at = points(volume, 0.4, 20000)
    with BrickedField(volume, edge=16, memory=1 << 21) as bricked:
        expected, found = bricked(at), {}
        threads = [threading.Thread(target=lambda i=i: found.update({i: bricked(at)})) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for one in found.values():
        np.testing.assert_array_equal(one, expected)
    assert len(found) == 4


class Together(Counted):
    """Samples that wait until the given number of readers has arrived, or until a timeout."""

    def __init__(self, data: Any, readers: int) -> None:
        super().__init__(data)
        self.gate = threading.Barrier(readers)
        self.on = False

    def __getitem__(self, index: Any) -> Any:
        if self.on:
            self.gate.wait(timeout=60)
        return super().__getitem__(index)


def in_threads(*work: Any) -> list[Any]:
    """The result, or the error, of each call in its own thread."""
    with ThreadPoolExecutor(len(work)) as pool:
        futures = [pool.submit(one) for one in work]
        return [future.exception(timeout=120) or future.result() for future in futures]


def test_threads_read_different_bricks_concurrently(volume: clvol.Volume) -> None:
    data = Together(volume.data, 3)  # none arrives before three are requested
    corners = volume.index_to_world([[2.0, 2.0, 2.0], [25.0, 20.0, 20.0], [50.0, 38.0, 35.0]])
    with BrickedField(clvol.LazyVolume(data, limits=(0, 1), labels=False), "linear", edge=16) as field:
        truth = BrickedField(volume.data, "linear", edge=16)(volume.world_to_index(corners))
        data.on = True
        found = in_threads(*(partial(field, [at]) for at in volume.world_to_index(corners)))
        np.testing.assert_array_equal(np.concatenate(found), truth)
        assert field.reads.bricks == 3


def test_a_brick_requested_by_several_threads_is_read_once_and_its_error_reaches_all() -> None:
    asked, go = threading.Event(), threading.Event()

    class Held(Counted):
        error: Exception | None = None

        def __getitem__(self, index: Any) -> Any:
            asked.set()
            assert go.wait(60)
            if self.error is not None:
                raise self.error
            return super().__getitem__(index)

    data = Held(np.random.default_rng(6).random((40, 40, 40)).astype(np.float32))
    at = [[5.0, 6.0, 7.0]]
    with BrickedField(clvol.LazyVolume(data, limits=(0, 1), labels=False), "linear", edge=16) as field:
        for error in (OSError("disk on fire"), None):
            data.error, data.read = error, 0
            asked.clear()
            go.clear()

            def release() -> None:
                assert asked.wait(60)
                residents = field.store._residents
                while sum(len(one.waiting) for one in residents._coming) < 3:
                    time.sleep(0.001)
                go.set()

            *found, _ = in_threads(*(partial(field, at) for _ in range(4)), release)
            if error is not None:
                assert len(found) == 4
                assert all(isinstance(one, FormatError) for one in found)
                assert all("disk on fire" in str(one) for one in found)
                assert field.nbytes == 0  # it is not cached
            else:
                assert found == [found[0]] * 4
                assert field.reads.bricks == 1
                assert field.reads.samples == data.read * 2  # the read that failed is counted
                assert all(not one.users for one in field.store._residents._there.values())


@pytest.mark.parametrize("room", [1, 2, 3])
def test_threads_stay_within_a_budget_of_fewer_bricks_than_threads(room: int) -> None:
    rng = np.random.default_rng(7)
    samples, most = rng.random((48, 48, 48)).astype(np.float32), [0]

    class Watched(Counted):
        def __getitem__(self, index: Any) -> Any:
            look()
            return super().__getitem__(index)

    def look() -> None:
        residents = field.store._residents
        with residents.lock:
            held = sum(one.coefficients.nbytes for one in residents._there.values())
            assert held <= field.nbytes
            most[0] = max(most[0], field.nbytes)

    at = rng.uniform(0, 47, (300, 3))
    with BrickedField(samples, "linear", edge=16) as roomy:
        truth = roomy(at)
        each = needs(roomy)
    field = BrickedField(
        clvol.LazyVolume(Watched(samples), limits=(0, 1), labels=False), "linear", edge=16, memory=int((room + 0.2) * each)
    )
    with field:
        for found in in_threads(*(partial(field, at, progress=lambda _: look()) for _ in range(5))):
            np.testing.assert_array_equal(found, truth)
        assert 0 < most[0] <= field.memory
        assert not field.store._residents._coming
        assert field.store._residents.account._sleeping == []


def test_a_thread_that_holds_a_brick_does_not_wait_for_memory() -> None:
    """Two threads that each hold one brick and need another continue, beyond the budget."""
    data = np.random.default_rng(8).random((16, 16, 64)).astype(np.float32)
    with BrickedField(data, "linear", edge=16) as other:
        each = needs(other)
    both = threading.Barrier(2)
    with BrickedField(
        clvol.LazyVolume(Counted(data), limits=(0, 1), labels=False), "linear", edge=16, memory=int(2.1 * each)
    ) as field:

        def two(first: int, second: int) -> bool:
            with field.store.resident(field.bricks[first, 0, 0]):
                both.wait(60)
                with field.store.resident(field.bricks[second, 0, 0]) as own:
                    return own.at == (second, 0, 0)

        assert in_threads(partial(two, 0, 1), partial(two, 2, 3)) == [True, True]
        assert field.nbytes <= field.memory  # after they finish


def test_an_interrupted_reader_hands_the_brick_to_a_waiting_thread() -> None:
    asked, calls = threading.Event(), []

    class Interrupted(Counted):
        def __getitem__(self, index: Any) -> Any:
            calls.append(index)
            if len(calls) == 1:
                asked.set()
                while not any(one.waiting for one in field.store._residents._coming):
                    time.sleep(0.001)
                raise KeyboardInterrupt
            return super().__getitem__(index)

    def later() -> Any:
        assert asked.wait(60)
        return field([[1.0, 2.0, 3.0]])

    volume = clvol.LazyVolume(Interrupted(np.ones((16, 16, 16), np.float32)), limits=(0, 1), labels=False)
    with BrickedField(volume, "linear", edge=16) as field:
        first, second = in_threads(partial(field, [[1.0, 2.0, 3.0]]), later)
        assert isinstance(first, KeyboardInterrupt)
        assert second.tolist() == [1.0]
        assert len(calls) == 2


def test_an_unreferenced_field_is_freed(volume: clvol.Volume) -> None:
    bricked = BrickedField(volume, "linear", edge=16)
    bricked(points(volume, 0.4, 50))
    gone = weakref.ref(bricked)
    gc.disable()
    try:
        del bricked
        assert gone() is None  # without the garbage collector
    finally:
        gc.enable()


def test_close_and_pickle(volume: clvol.Volume) -> None:
    with BrickedField(volume, "linear", edge=16) as bricked:
        again = pickle.loads(pickle.dumps(bricked))
        at = points(volume, 0.4, 50)
        np.testing.assert_array_equal(again(at), bricked(at))
        assert (again.edge, again.memory) == (bricked.edge, bricked.memory)
        again.close()
    assert bricked.closed
    assert "closed" in repr(bricked)
    with pytest.raises(OptionError, match="the field was closed"):
        bricked(at)


def test_bad_input(volume: clvol.Volume) -> None:
    with pytest.raises(OptionError, match=r"memory must be at least \d+ bytes, which a brick of 32³ samples takes; got 100000"):
        BrickedField(volume, memory=100_000)
    with pytest.raises(OptionError, match=r"memory must be at least \d+ bytes, which a brick of 64³ samples takes"):
        BrickedField(volume, edge=64, memory=1000)
    with pytest.raises(OptionError, match="edge must be a whole number"):
        BrickedField(volume, edge=7)
    with pytest.raises(OptionError, match="filter must be"):
        BrickedField(volume, "cubik")
    with pytest.raises(DataError, match="bricks are of a volume with 3 axes"):
        BrickedField(clvol.Volume(np.zeros((3, 3))))
    with BrickedField(volume, edge=16) as bricked:
        for wrong in ({}, {"shape": (3, 3)}, {"shape": (3, 3, 3), "spacing": 1}):
            with pytest.raises(OptionError):
                bricked.resample(**wrong)
        with pytest.raises(OptionError, match="out must have the shape"):
            bricked.resample(shape=(3, 3, 3), out=np.zeros((3, 3, 4)))


def test_an_unreadable_brick_is_an_error_and_the_field_stays_usable() -> None:
    with (
        BrickedField(clvol.LazyVolume(Broken(OSError("disk on fire")), limits=(0, 1)), "linear") as bricked,
        pytest.raises(FormatError, match="disk on fire"),
    ):
        bricked([[1.0, 1.0, 1.0]])


def test_a_brick_with_missing_samples_is_named() -> None:
    data = np.zeros((64, 64, 64), np.float32)
    data[60, 61, 62] = np.nan
    with BrickedField(clvol.LazyVolume(data, limits=(0, 1)), "linear", edge=16) as bricked:
        assert bricked([[5.0, 5.0, 5.0]]).tolist() == [0.0]
        with pytest.raises(DataError, match=r"the first at index \[60, 61, 62\]"):
            bricked([[60.0, 60.0, 60.0]])
        assert bricked([[6.0, 5.0, 5.0]]).tolist() == [0.0]


SAID: dict[str, Any] = {
    "spacing": (1.0, 2.0, 3.0),
    "origin": (5.0, 6.0, 7.0),
    "direction": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "units": "mm",
    "space": "LPS",
    "name": "cells",
    "color": (1.0, 0.5, 0.0),
    "clim": (0.1, 0.9),
    "labels": {1: "liver"},
    "header": {"made by": "us"},
}


def test_all_metadata_of_a_volume_are_kept() -> None:
    """Including any field added later."""
    data = np.ones((3, 4, 5), np.uint8)
    assert set(SAID) == {one.name for one in dataclasses.fields(clvol.Volume)} - {"data"}, "say here what the new field may be"
    volume, plain = clvol.Volume(data, **SAID), clvol.Volume(data)
    with BrickedField(volume, "nearest") as field:
        for grid in (field.volume.grid, known_of(field.volume), pickle.loads(pickle.dumps(field.volume)).grid):
            for name in SAID:
                assert not np.array_equal(getattr(volume, name), getattr(plain, name))
                np.testing.assert_equal(getattr(grid, name), getattr(volume, name))
        assert field.volume.limits == (1, 1)


@pytest.mark.parametrize("kind", ["uint32", "int64"])
def test_labels_beyond_float32_are_found_when_they_are_read(kind: str) -> None:
    """Limits may come from a few samples."""
    data = np.zeros((48, 48, 48), kind)
    data[40:, 40:, 40:] = 2**24 + 1
    limits = [(0, 5), (0, 2**24 + 1)]
    some, all_of_them = (clvol.LazyVolume(Counted(data), limits=one, labels=True) for one in limits)
    with BrickedField(some, "nearest", edge=16) as field:
        assert field([[3.0, 3.0, 3.0]]).tolist() == [0]
        with pytest.raises(DataError, match=r"up to 2\*\*24; got 0 to 16777217: renumber them"):
            field([[45.0, 45.0, 45.0]])
        with clvol.Renderer(field) as renderer, pytest.raises(DataError, match=r"up to 2\*\*24; got 0 to 16777217"):
            renderer.render(mode="mip", size=(16, 16))
    with pytest.raises(DataError, match=r"up to 2\*\*24; got 0 to 16777217"):
        BrickedField(all_of_them, "nearest")
    with BrickedField(clvol.LazyVolume(data, limits=(0, 5), labels=False), "nearest", edge=16) as field:  # no names
        field([[45.0, 45.0, 45.0]])
