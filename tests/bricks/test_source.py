"""Lazy volumes."""

from __future__ import annotations

import itertools
import os
import pickle
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import LazyVolume
from clvol.base.errors import ClvolError, ClvolWarning, DataError, FormatError, OptionError
from clvol.bricks.sliced import MappedFile
from clvol.bricks.source import known_of
from clvol.device import Device


class Counted:
    """An array that counts the samples read."""

    def __init__(
        self, data: np.ndarray[Any, Any], chunks: tuple[int, ...] | None = None, shape: tuple[Any, ...] | None = None
    ) -> None:
        self.data, self.shape, self.dtype, self.chunks, self.read = data, shape or data.shape, data.dtype, chunks, 0

    def __getitem__(self, index: Any) -> np.ndarray[Any, Any]:
        part = self.data[index]
        self.read += part.size
        return part


def noise(*shape: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(0).random(shape).astype(np.float32)


def test_nothing_is_read_until_needed() -> None:
    data = Counted(noise(40, 50, 60))
    volume = LazyVolume(data, (1, 2, 3), (4, 5, 6), units="mm", name="cells")
    assert (volume.size, volume.shape, volume.spacing, volume.units, volume.name) == (
        (60, 50, 40),
        (40, 50, 60),
        (1, 2, 3),
        "mm",
        "cells",
    )
    assert volume.grid.center.tolist() == clvol.Volume(data.data, (1, 2, 3), (4, 5, 6)).center.tolist()
    repr(volume)
    assert data.read == 0
    np.testing.assert_array_equal(volume.read((1, 2, 3), (11, 22, 33)), data.data[3:33, 2:22, 1:11])
    assert data.read == 10 * 20 * 30
    np.testing.assert_array_equal(volume.whole().data, data.data)


@pytest.mark.parametrize("chunks", [None, (32, 32, 32), (7, 300, 11), (1, 1, 1)])
def test_a_preview_covers_the_volume_and_reads_little(chunks: tuple[int, ...] | None) -> None:
    z, y, x = np.ogrid[:300, :280, :320]
    data = Counted((x + 2.0 * y + 3.0 * z).astype(np.float32), chunks)
    volume = LazyVolume(data, (1, 1, 2), (5, 6, 7))
    sketch = volume.preview()
    assert sketch.data.size < 1 << 23
    if chunks == (32, 32, 32):
        assert data.read < 0.3 * data.data.size
    np.testing.assert_allclose(sketch.corners, volume.grid.corners, rtol=1e-12)
    assert volume.preview() is sketch
    assert sketch.data.mean() == pytest.approx(data.data.mean(), rel=0.05)


def test_a_preview_is_a_stored_level_if_there_is_one() -> None:
    fine, coarse = Counted(noise(256, 256, 256)), Counted(noise(128, 128, 128))
    volume = LazyVolume(fine, levels=[LazyVolume(coarse, (2, 2, 2), (0.5, 0.5, 0.5))])
    assert volume.preview().shape == (128, 128, 128)
    assert (fine.read, coarse.read) == (0, 128**3)


def test_limits_are_given_or_computed() -> None:
    data = noise(20, 20, 20)
    assert LazyVolume(data).limits == (data.min(), data.max())
    assert LazyVolume(data, limits=(-1, 2)).limits == (-1.0, 2.0)
    assert known_of(LazyVolume(data, limits=(-1, 2))).value_range == (-1.0, 2.0)
    for wrong in ((1, 0), (0, np.nan), 3, "ab", (1, 2, 3)):
        with pytest.raises(OptionError, match="limits must be the smallest and the largest sample"):
            LazyVolume(data, limits=wrong)  # type: ignore[arg-type]


def test_missing_samples_are_rejected_or_replaced_when_read() -> None:
    data = noise(8, 8, 8)
    data[5, 6, 7] = np.nan
    assert np.isfinite(LazyVolume(data).read((0, 0, 0), (8, 8, 5))).all()
    with pytest.raises(DataError, match=r"1 NaN or infinite of samples \[4:8, 0:8, 0:8\] of scan, the first at index \[5, 6, 7\]"):
        LazyVolume(data, name="scan").read((0, 0, 4), (8, 8, 8))
    assert LazyVolume(data, missing=3.5).read((7, 6, 5), (8, 7, 6)).tolist() == [[[3.5]]]


class Broken(Counted):
    def __init__(self, raised: Exception | None = None, gives: Any = None) -> None:
        super().__init__(noise(9, 9, 9))
        self._raised, self._gives = raised, gives

    def __getitem__(self, index: Any) -> Any:
        if self._raised is not None:
            raise self._raised
        return self._gives


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (Broken(OSError("chunk c/0/0/1 is gone")), "chunk c/0/0/1 is gone"),
        (Broken(ZeroDivisionError()), "ZeroDivisionError"),
        (Broken(gives=np.zeros((3, 3, 3), np.float32)), r"must be float32 of shape \(2, 2, 2\); got float32 of shape \(3, 3, 3\)"),
        (Broken(gives=np.zeros((2, 2, 2), np.uint8)), "must be float32 of shape"),
    ],
)
def test_unreadable_samples_are_named(data: Broken, words: str) -> None:
    with pytest.raises(FormatError, match=rf"cannot read samples \[1:3, 1:3, 1:3\] of the volume.*{words}"):
        LazyVolume(data).read((1, 1, 1), (3, 3, 3))


@pytest.mark.parametrize(
    "data",
    [
        3.0,
        None,
        [1, 2, 3],
        "file.zarr",
        noise(3, 3),
        noise(0, 3, 3),
        noise(2, 3, 3, 3),
        np.zeros((2, 2, 2), complex),
        np.zeros((2, 2, 2), object),
        Counted(noise(2, 2, 2), shape=(float("nan"), 2, 2)),
        Counted(noise(2, 2, 2), shape=(1 << 21, 1 << 21, 1 << 19)),
        Counted(noise(2, 2, 2), shape=(3_000_000, 3_000_000, 3_000_000)),
        Counted(noise(2, 2, 2), shape=(10**30, 1, 1)),
        clvol.Volume(noise(3, 3, 3)),
        LazyVolume(noise(3, 3, 3)),
    ],
)
def test_input_that_is_not_a_volume_is_rejected(data: Any) -> None:
    with pytest.raises(DataError, match=r"^(data|every axis of data) must"):
        LazyVolume(data)


def test_a_volume_is_at_most_the_size_of_an_array() -> None:
    shape = (1 << 21, 1 << 21, (1 << 19) - 1)
    volume = LazyVolume(Counted(noise(2, 2, 2), shape=shape))
    assert (volume.shape, volume.grid.shape) == (shape, shape)


def test_every_access_to_a_closed_file_says_so(tmp_path: Path, device: Device) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "v.h5", "w") as file:
        data = file.create_dataset("v", data=noise(9, 9, 9), chunks=(4, 4, 4))
        volume = LazyVolume(data)
    for call in (
        lambda: clvol.BrickedField(volume, "linear", device=device),
        lambda: volume.chunks,
        lambda: volume.limits,
        lambda: LazyVolume(data),
    ):
        with pytest.raises(FormatError, match=r"cannot read .*chunks|cannot read shape and dtype"):
            call()


def test_levels_must_become_smaller() -> None:
    data = noise(8, 8, 8)
    with pytest.raises(DataError, match=r"levels must become smaller; got shapes \(8, 8, 8\) and then \(8, 9, 8\)"):
        LazyVolume(data, levels=[LazyVolume(noise(8, 9, 8))])
    with pytest.raises(DataError, match="levels must be LazyVolumes; got ndarray"):
        LazyVolume(data, levels=[data])  # type: ignore[list-item]
    for low, high in (((0, 0, 0), (9, 8, 8)), ((-1, 0, 0), (8, 8, 8)), ((3, 3, 3), (3, 4, 4))):
        with pytest.raises(OptionError, match=r"read needs 0 <= low < high <= \(8, 8, 8\)"):
            LazyVolume(data).read(low, high)


def test_it_does_not_become_an_array_by_accident() -> None:
    volume = LazyVolume(noise(4, 4, 4))
    with pytest.raises(ClvolError, match="becomes no array by accident"):
        np.asarray(volume)


def test_limits_are_estimated_from_a_subsample(monkeypatch: pytest.MonkeyPatch) -> None:
    data = Counted(noise(20, 20, 20), (10, 10, 10))
    assert not LazyVolume(data).estimated
    monkeypatch.setattr("clvol.bricks.source._PREVIEWED", 1000)
    assert LazyVolume(data).estimated
    assert not LazyVolume(data, limits=(0, 1)).estimated
    assert not LazyVolume(Counted(data.data)).estimated  # without chunks all are read
    assert data.read == 0


@pytest.mark.parametrize("options", [{"filter": "linear"}, {"memory": 64 << 20}])
def test_a_renderer_is_pickled_with_its_samples_and_budget(device: Device, options: dict[str, Any]) -> None:
    volume = LazyVolume(clvol.phantoms.sphere(16).data)
    with clvol.Renderer(volume, device=device, **options) as renderer, pickle.loads(pickle.dumps(renderer)) as again:
        assert isinstance(again.field, clvol.BrickedField)
        assert again.field.memory == options.get("memory", again.field.memory) == renderer.field.memory  # type: ignore[union-attr]
        np.testing.assert_array_equal(again.render(size=(16, 12)), renderer.render(size=(16, 12)))


def test_a_renderer_reports_the_level_of_its_last_picture(device: Device) -> None:
    coarse = LazyVolume(clvol.phantoms.sphere(12).data, (2, 2, 2), (0.5, 0.5, 0.5))
    volume = LazyVolume(clvol.phantoms.sphere(24).data, levels=[coarse])
    with clvol.Renderer(volume, "linear", device=device) as renderer:
        assert renderer.shown is renderer.field
        renderer.render(size=(16, 12), lod=100)
        assert renderer.shown.volume is coarse
        renderer.render(size=(16, 12), lod=0)
        assert renderer.shown is renderer.field
    with (
        clvol.BrickedField(volume, "linear", device=device) as field,
        pytest.raises(OptionError, match="memory must be left to the"),
    ):
        clvol.Renderer(field, memory=1 << 30)


# -- mapped files ----------------------------------------------------------------------------------------------------------------


PARTS = [
    "whole",
    "a box",
    "its end",
    "a sample",
    "turned",
    "every second",
    "Fortran's order",
    "other bytes",
    "plain",
    "another shape",
]


def parts_of(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Maps of a file, and views of them."""
    samples = noise(40, 40)
    samples.tofile(path)
    c = np.memmap(path, np.float32, "r", offset=64, shape=(7, 8, 15))
    return {
        "whole": c,
        "a box": c[2:5, 1:7, 3:9],
        "its end": c[5:, 4:, 13:],
        "a sample": c[3:4, 2:3, 5:6],
        "turned": c.transpose(1, 2, 0)[1:],
        "every second": c[::2],
        "Fortran's order": np.memmap(path, np.float32, "r", shape=(7, 8, 15), order="F")[1:, 2:, 3:],
        "other bytes": np.memmap(path, ">i4", "r+", shape=(2, 7, 8, 9))[1],
        "plain": np.asarray(c)[:, :, 1:],
        "another shape": np.memmap(path, np.float32, "r").reshape(10, 16, 10)[:, 4:],
    }


@pytest.mark.parametrize("name", PARTS)
def test_a_mapped_file_is_pickled_by_name(name: str, tmp_path: Path) -> None:
    data = parts_of(tmp_path / "a")[name]
    volume = LazyVolume(data)
    assert not volume.in_memory
    other = pickle.loads(pickle.dumps(volume))
    assert isinstance(other.data, MappedFile)
    for low in itertools.product((0, 1), repeat=3):
        low = tuple(min(a, n - 1) for a, n in zip(low, volume.size, strict=True))
        for high in (volume.size, tuple(a + 1 for a in low)):
            np.testing.assert_array_equal(other.read(low, high), volume.read(low, high))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(other)).whole().data, data)


def test_mapped_samples_that_differ_from_the_file_are_pickled(tmp_path: Path) -> None:
    noise(10, 10, 10).tofile(tmp_path / "a")
    changed = np.memmap(tmp_path / "a", np.float32, "c", shape=(10, 10, 10))
    changed[3] = 5
    plain = np.memmap(tmp_path / "a", np.float32, "r", shape=(10, 10, 10))
    for data in (changed, plain[:, :, ::2], plain[::-1], plain + 1):
        volume = LazyVolume(data)
        assert volume.in_memory
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(volume)).whole().data, data)
    (tmp_path / "a").unlink()
    assert LazyVolume(plain).in_memory
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(LazyVolume(plain))).whole().data, plain)


def test_writes_to_a_map_are_read_in_other_processes(tmp_path: Path) -> None:
    data = np.memmap(tmp_path / "a", np.int16, "w+", shape=(4, 5, 6))
    data[...] = 7
    assert (pickle.loads(pickle.dumps(LazyVolume(data))).whole().data == 7).all()


def test_a_replaced_mapped_file_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a"
    noise(10, 10, 10).tofile(path)
    packed = pickle.dumps(LazyVolume(np.memmap(path, np.float32, "r", shape=(10, 10, 10))))
    opened = pickle.loads(packed)
    opened.read((0, 0, 0), (2, 2, 2))
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(FormatError, match="has changed since it was opened"):
        opened.read((0, 0, 0), (2, 2, 2))
    with pytest.raises(FormatError, match=r"cannot read samples .*: .*, which was mapped, must be here as well, with its 4000"):
        pickle.loads(packed).whole()
    path.unlink()
    with pytest.raises(FormatError, match=r"with its 4000 bytes; there is none"):
        pickle.loads(packed).whole()


def test_a_changed_mapped_file_of_the_same_size_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a"
    noise(10, 10, 10).tofile(path)
    data = np.memmap(path, np.float32, "r+", shape=(10, 10, 10))
    packed, seen = pickle.dumps(LazyVolume(data)), path.stat()
    pickle.loads(packed).whole()

    os.utime(path, ns=(seen.st_atime_ns, seen.st_mtime_ns + 4_000_000))  # the next tick of a clock
    with pytest.raises(FormatError, match=r"a, which was mapped, has changed since it was opened; open it again"):
        pickle.loads(packed).whole()
    os.utime(path, ns=(seen.st_atime_ns, seen.st_mtime_ns))
    pickle.loads(packed).whole()

    shutil.copy2(path, tmp_path / "b")  # with its time
    (tmp_path / "b").replace(path)
    with pytest.raises(FormatError, match="has changed since it was opened"):
        pickle.loads(packed).whole()

    data[...] = 5  # of the unlinked file
    data = np.memmap(path, np.float32, "r+", shape=(10, 10, 10))
    data[...] = 3  # is in the file, and its time with it, before it is pickled
    assert (pickle.loads(pickle.dumps(LazyVolume(data))).whole().data == 3).all()


@pytest.mark.parametrize("step", [100, 1000, 10**9, 2 * 10**9])
def test_another_host_may_report_a_coarser_time_and_another_inode(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    noise(10, 10, 10).tofile(path)
    exact = 1_700_000_001_123_456_789
    os.utime(path, ns=(exact, exact))
    packed = pickle.dumps(LazyVolume(np.memmap(path, np.float32, "r", shape=(10, 10, 10))))
    os.utime(path, ns=(exact, exact // step * step))
    shutil.copy2(path, tmp_path / "b")
    (tmp_path / "b").replace(path)
    monkeypatch.setattr("platform.node", lambda: "another")
    pickle.loads(packed).whole()
    os.utime(path, ns=(exact, (exact // step + 1) * step))
    with pytest.raises(FormatError, match="has changed since it was opened"):
        pickle.loads(packed).whole()


def test_empty_chunks_count_as_none() -> None:
    class Odd(Counted):
        chunks = (0, 0, 0)

    data = np.random.default_rng(0).random((9, 9, 9)).astype(np.float32)
    volume = clvol.LazyVolume(Odd(data), limits=(0, 1), labels=False)
    assert volume.chunks is None
    np.testing.assert_array_equal(clvol.resample(volume, (9, 9, 9), filter="linear").data, data)


def test_many_damaged_chunks_are_replaced_and_each_is_named_once(tmp_path: Path) -> None:
    """65 of them were an error despite `missing`, and one that was met in several parts was named in each."""
    zarr = pytest.importorskip("zarr")
    data = np.arange(20**3, dtype=np.uint16).reshape(20, 20, 20) + 1
    zarr.create_array(tmp_path / "v.zarr", data=data, chunks=(4, 4, 4))
    for chunk in (tmp_path / "v.zarr" / "c").glob("[0-3]/*/*"):
        chunk.write_bytes(b"damaged")
    for lazy in (clvol.open(tmp_path / "v.zarr", missing=7), LazyVolume(zarr.open_array(tmp_path / "v.zarr"), missing=7)):
        with pytest.warns(ClvolWarning, match="c/3|cannot read"):
            whole = lazy.whole().data
        assert (whole[:16] == 7).all()
        assert np.array_equal(whole[16:], data[16:])
    with pytest.warns(ClvolWarning, match="99 more chunks"):
        assert clvol.open(tmp_path / "v.zarr").limits == (data[16:].min(), data[16:].max())
    lazy = clvol.open(tmp_path / "v.zarr", missing=7)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        lazy.read((0, 0, 12), (4, 4, 20))
        lazy.read((0, 0, 12), (3, 2, 19))
    assert len(found) == 1
