"""The cache of unpacked chunks."""

from __future__ import annotations

import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError
from clvol.bricks.chunks import Chunks, lines_of
from clvol.bricks.field import _needs
from clvol.device import Device
from clvol.march.window import front_to_back
from tests.bricks.test_source import Counted

DATA = np.random.default_rng(0).integers(0, 4000, (40, 50, 60), np.uint16)


class Stored:
    """A chunked array that unpacks whole chunks and counts them."""

    def __init__(self, data: Any, chunks: tuple[int, ...]) -> None:
        self.data, self.shape, self.dtype, self.chunks = data, data.shape, data.dtype, chunks
        self.unpacked = 0
        self._lock = threading.Lock()

    @property
    def stored(self) -> int:
        return int(np.prod([-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True)]))

    def __getitem__(self, at: Any) -> Any:
        with self._lock:
            self.unpacked += int(np.prod([-(-s.stop // c) - s.start // c for s, c in zip(at, self.chunks, strict=True)]))
        return self.data[at]


def kept(source: Stored, most: int) -> Chunks:
    lines = lines_of(source)
    assert lines is not None
    return Chunks(source.__getitem__, lines, source.dtype, most)


@pytest.mark.parametrize("chunks", [(1, 50, 60), (40, 50, 60), (7, 11, 13), (16, 16, 16), (1, 1, 60)])
@pytest.mark.parametrize("most", [0, 30_000, 1 << 30])
def test_parts_match_the_array(chunks: tuple[int, ...], most: int) -> None:
    source = Stored(DATA, chunks)
    read, rng = kept(source, most), np.random.default_rng(1)
    for _ in range(20):
        low = [int(rng.integers(0, n)) for n in DATA.shape]
        high = [int(rng.integers(a + 1, n + 1)) for a, n in zip(low, DATA.shape, strict=True)]
        at = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        np.testing.assert_array_equal(read[at], DATA[at])  # type: ignore[arg-type]  # three
        assert read.nbytes <= most
    if most > DATA.nbytes:
        assert source.unpacked <= source.stored
        before = read.nbytes
        assert (read.evict(), read.nbytes, read.idle) == (before, 0, 0)


@pytest.mark.parametrize("chunks", [(1, 1, 60), (1, 1, 4), (4, 4, 4), (2, 50, 1)])
def test_small_chunks_are_cached_in_groups(chunks: tuple[int, ...]) -> None:
    """Caching a chunk costs as much as unpacking some thousand samples."""
    source = Stored(DATA, chunks)
    read = kept(source, 1 << 30)
    at = slice(0, 40), slice(0, 50), slice(0, 60)
    np.testing.assert_array_equal(read[at], DATA[at])
    assert source.unpacked == source.stored
    assert len(read._kept) <= 8


def test_dask_chunks_may_be_irregular() -> None:
    da = pytest.importorskip("dask.array")
    array = da.from_array(DATA, chunks=((3, 30, 7), (50,), (1, 59)))
    lines = lines_of(array)
    assert lines is not None
    assert [line.tolist() for line in lines] == [[0, 3, 33, 40], [0, 50], [0, 1, 60]]
    assert lines_of(np.zeros((2, 2, 2))) is None
    read = Chunks(lambda at: np.asarray(array[at]), lines, DATA.dtype, 1 << 20)
    at = slice(2, 35), slice(5, 9), slice(0, 60)
    np.testing.assert_array_equal(read[at], DATA[at])


def test_threads_wait_for_a_chunk_being_unpacked() -> None:
    go, asked = threading.Event(), threading.Event()

    class Held(Stored):
        def __getitem__(self, at: Any) -> Any:
            asked.set()
            assert go.wait(60)
            return super().__getitem__(at)

    source = Held(DATA, (1, 50, 60))
    read = kept(source, 1 << 30)
    at = slice(3, 9), slice(0, 20), slice(0, 20)
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(read.__getitem__, at) for _ in range(4)]
        assert asked.wait(60)
        until = time.monotonic() + 60
        while sum(one.users for one in read._kept.values()) < 4 * len(read._kept):  # all are there
            assert time.monotonic() < until
            time.sleep(0.01)
        go.set()
        for one in found:
            np.testing.assert_array_equal(one.result(60), DATA[at])
    assert source.unpacked == 16, "planes that are kept together, once"


def test_a_failed_chunk_is_read_again() -> None:
    class Broken(Stored):
        broken = True

        def __getitem__(self, at: Any) -> Any:
            if self.broken:
                raise FormatError("disk on fire")
            return super().__getitem__(at)

    source = Broken(DATA, (1, 50, 60))
    read = kept(source, 1 << 30)
    at = slice(3, 9), slice(0, 20), slice(0, 20)
    with pytest.raises(FormatError, match="disk on fire"):
        read[at]
    assert read.nbytes == 0
    source.broken = False
    np.testing.assert_array_equal(read[at], DATA[at])


@pytest.mark.one_in(10)
@pytest.mark.parametrize("view", [(0, 0), (90, 0), (0, 90), (40, 20), (220, -20)])
@pytest.mark.parametrize("chunks", [(1, 96, 96), (48, 4, 96)])
def test_long_chunks_are_unpacked_once_per_picture(chunks: tuple[int, ...], view: tuple[float, float], device: Device) -> None:
    """For every view: bricks that share chunks are visited in succession; the picture is unchanged."""
    z, y, x = np.ogrid[:48, :96, :96]
    data = (100 + 60 * np.sin(z / 5) * np.cos(y / 7) * np.sin(x / 9)).astype(np.uint8)
    source, budget = Stored(data, chunks), 4 << 20
    camera = clvol.Camera.orbit(*view)
    volume = clvol.LazyVolume(source, limits=(40, 160), labels=False)
    with (
        clvol.BrickedField(volume, "linear", device=device, edge=16, memory=budget) as field,
        clvol.BrickedField(data, "linear", device=device, edge=16) as memory,
        clvol.Renderer(field) as renderer,
        clvol.Renderer(memory) as truth,
    ):
        order = front_to_back(field, camera.view(volume.grid))
        across = 2 if chunks[0] == 1 else 1
        assert len(list(itertools.groupby(brick.at[across] for brick in order))) == field.bricks.counts[across]
        source.unpacked = 0
        picture = renderer.render(camera, "mean", (32, 32), rays=1)
        assert field.reads.bricks > 80  # of 108; the others lie beside the picture
        assert source.unpacked == source.stored
        assert field.nbytes <= budget
        np.testing.assert_array_equal(picture, truth.render(camera, "mean", (32, 32), rays=1))


def test_brick_size_leaves_room_for_long_chunks() -> None:
    """Bricks shrink if the budget would not hold the planes of a layer of larger ones; chunks make room for bricks."""
    planes = Stored(np.zeros((256, 256, 256), np.uint8), (1, 256, 256))
    chunks = Stored(planes.data, (64, 64, 64))
    with (
        clvol.BrickedField(clvol.LazyVolume(planes, limits=(0, 1), labels=False), "linear", memory=12 << 20) as one,
        clvol.BrickedField(clvol.LazyVolume(chunks, limits=(0, 1), labels=False), "linear", memory=12 << 20) as other,
    ):
        kept, needs = one.store._chunks, _needs(one.volume, one.filter, one.boundary)
        assert kept is not None
        assert needs.layer(one.edge) <= kept.most <= 6 << 20
        assert one.edge <= other.edge
    with clvol.BrickedField(clvol.LazyVolume(planes, limits=(0, 1), labels=False), "linear", edge=32, memory=1 << 20) as field:
        field([[10.0, 10.0, 10.0], [250.0, 10.0, 10.0], [128.0, 10.0, 100.0]])
        assert field.nbytes <= 1 << 20


def test_unchunked_arrays_bypass_the_cache() -> None:
    data = Counted(DATA)
    with clvol.BrickedField(clvol.LazyVolume(data, limits=(0, 4000), labels=False), "linear", edge=16) as field:
        field([[1.0, 1.0, 1.0]])
        assert data.read == field.reads.samples < 25**3
