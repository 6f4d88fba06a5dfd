"""`clvol.open`: parts equal what `clvol.read` reads whole, and faults are errors."""

from __future__ import annotations

import dataclasses
import functools
import http.server
import json
import os
import pickle
import shutil
import threading
import time
import urllib.parse
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, LazyVolume
from clvol.base.errors import ClvolError, DataError, FormatError, OptionError
from clvol.bricks.continued import holed
from clvol.device import Device

zarr = pytest.importorskip("zarr")

DATA = np.random.default_rng(1).integers(0, 60000, (2, 3, 20, 30, 40)).astype(np.uint16)  # times, channels, z, y, x
LOW, HIGH = (5, 11, 3), (33, 30, 18)
PART = (slice(3, 18), slice(11, 30), slice(5, 33))


def same(path: Path | str, parts: bool = True, **choice: Any) -> clvol.LazyVolume:
    """Open what `clvol.read` reads, and compare everything."""
    with warnings.catch_warnings(action="ignore"):
        lazy, whole = clvol.open(path, trusted=True, **choice), clvol.read(path, trusted=True, **choice)
    assert (lazy.shape, lazy.spacing, lazy.units, lazy.name) == (whole.shape, whole.spacing, whole.units, whole.name)
    assert (lazy.grid.origin, lazy.grid.space, lazy.grid.clim, lazy.grid.color) == (
        whole.origin,
        whole.space,
        whole.clim,
        whole.color,
    )
    np.testing.assert_array_equal(lazy.grid.direction, whole.direction)
    assert lazy.grid.labels == whole.labels
    np.testing.assert_array_equal(lazy.whole().data, whole.data)
    if parts:
        np.testing.assert_array_equal(lazy.read(LOW, HIGH), whole.data[PART])
    return lazy


@pytest.fixture(scope="module", params=["0.4", "0.5"])
def cells(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An image at three resolutions with labels, written by ome-zarr."""
    with warnings.catch_warnings(action="ignore"):
        pytest.importorskip("ome_zarr")
        from ome_zarr.format import FormatV04, FormatV05
        from ome_zarr.writer import write_image, write_labels

        path = tmp_path_factory.mktemp(f"ome{request.param}") / "cells.zarr"
        about: dict[str, Any] = {"fmt": {"0.4": FormatV04, "0.5": FormatV05}[request.param](), "scale_factors": [2, 4]}
        channels = [
            {"label": name, "color": color, "window": {"start": 0, "end": end, "min": 0, "max": 65535}, "active": True}
            for name, color, end in (("DAPI", "0000FF", 100), ("GFP", "00FF00", 200), ("Cy5", "FF00FF", 300))
        ]
        write_image(
            DATA,
            str(path),
            axes="tczyx",
            name="cells",
            scale={"z": 2.0, "y": 0.5, "x": 0.25},
            axes_units=dict.fromkeys("zyx", "micrometer"),
            omero={"channels": channels},
            storage_options={"chunks": (1, 1, 8, 8, 8)},
            **about,
        )
        write_labels(DATA[0, 0] // 20000, str(path), "nuclei", axes="zyx", **about)
    return path


def test_ome_zarr_with_all_levels(cells: Path) -> None:
    lazy = same(cells, time=1, channel="GFP")
    assert lazy.chunks is not None
    assert len(lazy.levels) == 2
    for number, level in enumerate(lazy.levels, 1):
        whole = clvol.read(cells, time=1, channel="GFP", level=number, trusted=True)
        assert (level.spacing, level.grid.origin) == (whole.spacing, whole.origin)
        np.testing.assert_array_equal(level.whole().data, whole.data)
    assert len(clvol.open(cells, time=1, channel=1, level=1).levels) == 1
    assert same(cells, series="labels/nuclei").is_labels
    with pytest.warns(ClvolWarning, match="2 times × 3 channels") as told:
        clvol.open(cells)
    assert [one.category for one in told].count(ClvolWarning) == 1
    with pytest.raises(OptionError, match="level must be 0 to 2"):
        clvol.open(cells, level=3)


def test_a_pickle_reopens_the_store(cells: Path) -> None:
    """With its arguments, each level separately; it contains no samples."""
    volume = clvol.open(cells, channel=1, spacing=(2, 2, 3))
    packed = pickle.dumps(volume)
    again = pickle.loads(packed)
    assert len(packed) < 2000
    high = volume.size
    np.testing.assert_array_equal(again.read((0, 0, 0), high), volume.read((0, 0, 0), high))
    assert again.spacing == volume.spacing
    assert [level.shape for level in again.levels] == [level.shape for level in volume.levels]
    level = pickle.loads(pickle.dumps(volume.levels[0]))
    np.testing.assert_array_equal(level.whole().data, volume.levels[0].whole().data)
    assert level.spacing == volume.levels[0].spacing


def test_a_given_geometry_applies_to_all_levels(cells: Path) -> None:
    moved = clvol.open(cells, time=0, channel=0, spacing=(1, 1, 4), origin=(10, 20, 30), trusted=True)
    assert moved.spacing == (1, 1, 4)
    np.testing.assert_allclose(moved.levels[0].spacing, (2, 2, 4))
    np.testing.assert_allclose(moved.levels[0].grid.origin, (10.5, 20.5, 30))


@pytest.mark.parametrize("version", [2, 3])
def test_plain_arrays_of_any_order_and_chunks(tmp_path: Path, version: int) -> None:
    for name, options in {
        "chunks": {"chunks": (7, 9, 11)},
        "big": {"chunks": (20, 30, 40)},
        "shards": {"chunks": (5, 5, 10), "shards": (10, 15, 40)},
    }.items():
        if "shards" in options and version == 2:
            continue
        array = zarr.create_array(tmp_path / f"{name}.zarr", shape=(20, 30, 40), dtype=">i2", zarr_format=version, **options)
        array[:] = DATA[0, 0].astype("i2")
        assert same(tmp_path / f"{name}.zarr").chunks == options["chunks"][::-1]
    zarr.create_array(tmp_path / "rgb.zarr", data=np.moveaxis(DATA[0], 0, -1).astype("u1"), zarr_format=version)
    same(tmp_path / "rgb.zarr")  # the luminance
    same(tmp_path / "rgb.zarr", channel=1)
    store = zarr.storage.ZipStore(tmp_path / "v.zarr.zip", mode="w")
    zarr.create_array(store, data=DATA[0, 0], zarr_format=version)
    store.close()
    same(tmp_path / "v.zarr.zip")


def test_scaled_and_missing_samples(tmp_path: Path) -> None:
    array = zarr.create_array(tmp_path / "v.zarr", data=DATA[0, 0])
    array.attrs.update({"scale_factor": 0.5, "add_offset": 3, "_FillValue": int(DATA[0, 0, 4, 12, 6])})
    with warnings.catch_warnings(action="ignore"):
        whole = clvol.read(tmp_path / "v.zarr", trusted=True)
    lazy = clvol.open(tmp_path / "v.zarr")
    assert lazy.dtype == whole.data.dtype
    with pytest.raises(DataError, match=r"NaN or infinite.*missing=value"):
        lazy.read(LOW, HIGH)
    filled = clvol.open(tmp_path / "v.zarr", missing=-1)
    np.testing.assert_array_equal(filled.read(LOW, HIGH), np.nan_to_num(whole.data[PART], nan=-1))


def stored(path: Any, **options: Any) -> Any:
    array = zarr.create_array(path, shape=(20, 30, 40), chunks=(10, 10, 10), dtype="u2", **options)
    array[:] = DATA[0, 0]
    return array


@pytest.mark.parametrize("compressors", ["auto", None])
@pytest.mark.parametrize("content", [b"", b"damaged", None], ids=["empty", "damaged", "truncated"])
def test_a_damaged_chunk_is_named(tmp_path: Path, compressors: str | None, content: bytes | None) -> None:
    stored(tmp_path / "v.zarr", compressors=compressors)
    chunk = tmp_path / "v.zarr" / "c" / "1" / "2" / "3"
    chunk.write_bytes(chunk.read_bytes()[:100] if content is None else content)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    np.testing.assert_array_equal(lazy.read((0, 0, 0), (30, 30, 20)), DATA[0, 0, :, :, :30])
    with pytest.raises(FormatError, match=r"samples \[0:20, 0:30, 0:40\].*c/1/2/3"):
        lazy.whole()


def test_a_damaged_shard_is_named(tmp_path: Path) -> None:
    array = zarr.create_array(tmp_path / "v.zarr", shape=(20, 30, 40), chunks=(5, 5, 5), shards=(10, 10, 10), dtype="u2")
    array[:] = DATA[0, 0]
    shard = tmp_path / "v.zarr" / "c" / "1" / "2" / "3"
    whole = shard.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:-4] + b"\0\0\0\0", bytes(8) + whole[8:]):
        shard.write_bytes(content)
        lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
        with pytest.raises(FormatError, match=r"c/1/2/3"):
            lazy.whole()


def test_a_missing_chunk_has_the_fill_value_if_there_is_one(tmp_path: Path) -> None:
    stored(tmp_path / "v.zarr", fill_value=7)
    (tmp_path / "v.zarr" / "c" / "1" / "2" / "3").unlink()
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    assert (lazy.read((30, 20, 10), (40, 30, 20)) == 7).all()
    stored(tmp_path / "w.zarr", zarr_format=2, fill_value=None)
    (tmp_path / "w.zarr" / "1.2.3").unlink()
    for read in (lambda: clvol.open(tmp_path / "w.zarr", trusted=True).whole(), lambda: clvol.read(tmp_path / "w.zarr")):
        with pytest.raises(FormatError, match=r"1\.2\.3 is missing"):
            read()


def test_a_changed_store_is_detected(tmp_path: Path) -> None:
    array = stored(tmp_path / "v.zarr")
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    lazy.read((0, 0, 0), (10, 10, 10))
    array[0, 0, 0] = 1
    with pytest.raises(FormatError, match=r"c/0/0/0.*open it again"):
        lazy.read((0, 0, 0), (5, 5, 5))
    lazy.read((10, 10, 10), (20, 20, 20))  # not the others
    array.attrs["resized"] = True
    with pytest.raises(FormatError, match=r"zarr\.json.*open it again"):
        lazy.read((10, 10, 10), (20, 20, 20))


LAYOUTS: dict[str, dict[str, Any]] = {
    "Zarr 2, flat": {"zarr_format": 2},
    "Zarr 2, nested": {"zarr_format": 2, "chunk_key_encoding": {"name": "v2", "separator": "/"}},
    "Zarr 3": {"zarr_format": 3},
    "Zarr 3, flat": {"zarr_format": 3, "chunk_key_encoding": {"name": "default", "separator": "."}},
}


@pytest.fixture(params=LAYOUTS)
def layout(request: pytest.FixtureRequest) -> dict[str, Any]:
    return LAYOUTS[request.param]


def later() -> None:
    """Wait until files get a later time."""
    time.sleep(0.02)


def no_zeros(lazy: clvol.LazyVolume, match: str = r"has changed since it was opened \(.*open it again") -> None:
    """Samples that were not read so far are now an error."""
    with pytest.raises(FormatError, match=match):
        lazy.read((10, 10, 10), (20, 20, 20))


@pytest.mark.parametrize("is_read", [False, True])
def test_a_vanished_folder_is_detected(tmp_path: Path, layout: dict[str, Any], is_read: bool) -> None:
    stored(tmp_path / "v.zarr", **layout)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    if is_read:
        lazy.read((0, 0, 0), (10, 10, 10))
    (tmp_path / "v.zarr").rename(tmp_path / "w.zarr")
    no_zeros(lazy, r"v\.zarr has changed since it was opened \(\S+ is gone\)")
    (tmp_path / "v.zarr").mkdir()  # as where a disk was mounted
    no_zeros(lazy, "is gone")
    (tmp_path / "v.zarr").rmdir()
    (tmp_path / "w.zarr").rename(tmp_path / "v.zarr")
    np.testing.assert_array_equal(lazy.whole().data, DATA[0, 0])


def test_a_vanished_archive_is_detected(tmp_path: Path) -> None:
    store = zarr.storage.ZipStore(tmp_path / "v.zarr.zip", mode="w")
    stored(store)
    store.close()
    lazy = clvol.open(tmp_path / "v.zarr.zip", trusted=True)
    (tmp_path / "v.zarr.zip").unlink()
    no_zeros(lazy, "the archive is gone")
    stored(tmp_path / "v.zarr.zip")
    no_zeros(lazy)


def test_the_working_folder_may_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored(tmp_path / "v.zarr")
    monkeypatch.chdir(tmp_path)
    lazy = clvol.open("v.zarr", trusted=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    np.testing.assert_array_equal(lazy.whole().data, DATA[0, 0])


@pytest.mark.parametrize("most", [1 << 11, 2])
def test_vanished_chunks_are_detected(tmp_path: Path, layout: dict[str, Any], most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them, and single ones of a watched folder; but not chunks that never existed."""
    monkeypatch.setattr("clvol.formats.zarr.files._FOLDERS", most)
    for all_of_them in (True, False):
        array = stored(tmp_path / "v.zarr", overwrite=True, fill_value=7, **layout)
        for hole in (slice(0, 10), slice(20, 30)):
            array[hole, hole, hole] = 7
            (tmp_path / "v.zarr" / array.metadata.encode_chunk_key((hole.start // 10,) * 3)).unlink(missing_ok=True)
        later()
        lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
        assert (lazy.read((0, 0, 0), (10, 10, 10)) == 7).all()
        lazy.read((0, 10, 10), (10, 20, 20))
        later()
        for chunk in [one for one in (tmp_path / "v.zarr").rglob("*") if one.is_file() and not one.name.startswith((".", "zarr"))]:
            if all_of_them or str(chunk.relative_to(tmp_path / "v.zarr")) == array.metadata.encode_chunk_key((1, 1, 1)):
                chunk.unlink()
        no_zeros(lazy)


def test_vanished_folders_of_chunks_are_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for most, gone in ((1 << 11, "c"), (1 << 11, "c/1"), (1 << 11, "c/1/1"), (2, "c"), (2, "c/1")):
        monkeypatch.setattr("clvol.formats.zarr.files._FOLDERS", most)
        stored(tmp_path / "v.zarr", overwrite=True)
        lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
        later()
        shutil.rmtree(tmp_path / "v.zarr" / gone)
        no_zeros(lazy)


def test_a_rewritten_array_is_detected(tmp_path: Path, layout: dict[str, Any]) -> None:
    """Also at chunks that were not read before; unchanged ones are read."""
    array = stored(tmp_path / "v.zarr", **layout)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    lazy.read((0, 0, 0), (10, 10, 10))
    later()
    array[10:20, 10:20, 10:20] = 1
    no_zeros(lazy, r"changed since it was opened \(.*1.1.1\); open it again")
    lazy.read((20, 10, 10), (30, 20, 20))
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    assert (lazy.read((10, 10, 10), (20, 20, 20)) == 1).all()


def test_an_unchanged_store_is_read_whatever_its_times(tmp_path: Path, layout: dict[str, Any]) -> None:
    """Wrong clocks, copies with preserved times, chunks written in place just before, and neighbours that change."""
    array = stored(tmp_path / "v.zarr", fill_value=7, **layout)
    array[:10, :10, :10] = 7
    (tmp_path / "v.zarr" / array.metadata.encode_chunk_key((0, 0, 0))).unlink(missing_ok=True)
    expected = np.asarray(array[:])
    files = [one for one in (tmp_path / "v.zarr").rglob("*") if one.is_file()]
    for seconds in (-1e9, 0, 1.0, 1e6):
        for file in files:
            os.utime(file, (time.time() + seconds,) * 2)
        lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
        if (tmp_path / "v.zarr" / "c").is_dir():
            (tmp_path / "v.zarr" / f"beside{seconds}").mkdir()
        np.testing.assert_array_equal(lazy.whole().data, expected)


def test_folders_without_times_are_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a mounted object store: a missing chunk is then an error."""
    monkeypatch.setattr("clvol.formats.zarr.files._keeps_times", lambda _: False)
    stored(tmp_path / "v.zarr", fill_value=7)
    (tmp_path / "v.zarr" / "c" / "1" / "1" / "1").unlink()
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    os.utime(tmp_path / "v.zarr" / "c" / "1" / "1")
    assert (lazy.read((10, 10, 10), (20, 20, 20)) == 7).all()
    shutil.copy2(tmp_path / "v.zarr" / "c" / "0" / "0" / "0", tmp_path / "again")
    before = lazy.read((0, 0, 0), (10, 10, 10))
    (tmp_path / "again").rename(tmp_path / "v.zarr" / "c" / "0" / "0" / "0")  # files may have another inode at each stat
    np.testing.assert_array_equal(lazy.read((0, 0, 0), (10, 10, 10)), before)


def test_the_last_of_very_many_chunks_are_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the metadata, however many chunks follow."""
    monkeypatch.setattr("clvol.formats.zarr.files._WATCHED", 4)
    stored(tmp_path / "v.zarr")
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    for _ in range(2):
        np.testing.assert_array_equal(lazy.whole().data, DATA[0, 0])
    lazy.read((10, 10, 10), (20, 20, 20))
    chunk = tmp_path / "v.zarr" / "c" / "1" / "1" / "1"
    chunk.write_bytes(chunk.read_bytes() + b"more")
    no_zeros(lazy)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    lazy.read((0, 0, 0), (40, 30, 10))
    about = tmp_path / "v.zarr" / "zarr.json"
    about.write_text(about.read_text() + " ")
    no_zeros(lazy)


def test_large_chunks_of_a_vanished_folder_without_times_are_no_zeros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It vanishes during the read; uncompressed chunks are read without zarr."""
    from clvol.formats.zarr import array, files

    monkeypatch.setattr(files, "_keeps_times", lambda _: False)
    monkeypatch.setattr(array, "_LARGE", 100)
    stored(tmp_path / "v.zarr", compressors=None)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    of_chunk = array._Uncompressed._of_chunk

    def going(self: Any, chunk: tuple[int, ...], inside: Any) -> Any:
        shutil.rmtree(tmp_path / "v.zarr")
        return of_chunk(self, chunk, inside)

    monkeypatch.setattr(array._Uncompressed, "_of_chunk", going)
    no_zeros(lazy, "is gone")


def test_a_vanished_folder_with_consolidated_metadata_is_detected(tmp_path: Path) -> None:
    group = zarr.create_group(tmp_path / "v.zarr", zarr_format=2)
    group.create_array("a", data=DATA[0, 0], chunks=(10, 10, 10))
    zarr.consolidate_metadata(tmp_path / "v.zarr", zarr_format=2)
    lazy = clvol.open(tmp_path / "v.zarr", trusted=True)
    shutil.rmtree(tmp_path / "v.zarr" / "a")
    no_zeros(lazy, "is gone")


def ome(path: Path, shapes: list[tuple[int, ...]], scales: list[Any], **about: Any) -> Path:
    """An image of these sizes, with the given metadata."""
    datasets = [
        {"path": str(i)} | ({"coordinateTransformations": [{"type": "scale", "scale": scale}]} if scale is not None else {})
        for i, scale in enumerate(scales)
    ]
    multiscales = {"axes": [{"name": axis, "type": "space"} for axis in "zyx"], "datasets": datasets} | about
    group = zarr.create_group(path, zarr_format=2, attributes={"multiscales": [multiscales]}, overwrite=True)
    for i, shape in enumerate(shapes):
        group.create_array(str(i), data=np.ones(shape, np.uint8))
    return path


@pytest.mark.parametrize(
    ("shapes", "scales", "match"),
    [
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [4, 4, 4]], "sizes in one place"),
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [1, 1, 1]], "sizes in one place"),
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [-2, 2, 2]], "positive"),
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [0, 2, 2]], "spacing must be positive"),
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [float("nan"), 2, 2]], "positive|finite|spacing"),
        ([(8, 8, 8), (4, 4, 4)], [[1, 1, 1], [2, 2]], "3 numbers"),
        ([(8, 8, 8), (9, 4, 4)], [[1, 1, 1], [1, 2, 2]], "become smaller"),
        ([(8, 8, 8), (4, 4)], [[1, 1, 1], [2, 2, 2]], "must hold"),
        ([(2, 8, 8, 8)], [[1, 1, 1]], "must hold"),
        ([(8, 8, 8)], [[1, 1, 1], [2, 2, 2]], r"v\.zarr must hold an array for each of its sizes; that of size 1 has the path '1'"),
        ([(8, 8, 8)], [["a", 1, 1]], "by a scale and a translation of 3 numbers"),
        ([(8, 8, 8)], [[None, 1, 1]], "by a scale and a translation of 3 numbers"),
        ([(8, 8, 8)], ["abc"], "by a scale and a translation of 3 numbers"),
        ([], [], "must hold an array for each of its sizes"),
    ],
)
def test_inconsistent_metadata(tmp_path: Path, shapes: list[Any], scales: list[Any], match: str) -> None:
    path = ome(tmp_path / "v.zarr", shapes, scales)
    for trusted in (False, True):
        with pytest.raises(ClvolError, match=match):
            clvol.open(path, trusted=trusted)


@pytest.mark.parametrize("axis", [3_000_000, 10**9, 10**30])
def test_impossible_shapes(tmp_path: Path, axis: int) -> None:
    stored(tmp_path / "v.zarr")
    about = json.loads((tmp_path / "v.zarr" / "zarr.json").read_text()) | {"shape": [axis] * 3}
    (tmp_path / "v.zarr" / "zarr.json").write_text(json.dumps(about))
    for trusted in (False, True):
        with pytest.raises(DataError, match=rf"v\.zarr: data must take less than 2⁶³ bytes; got shape \({axis}, "):
            clvol.open(tmp_path / "v.zarr", trusted=trusted)


def test_before_0_4_shapes_give_the_placement_of_levels(tmp_path: Path) -> None:
    lazy = clvol.open(ome(tmp_path / "v.zarr", [(8, 8, 8), (8, 4, 4)], [None, None]), trusted=True)
    assert (lazy.levels[0].spacing, lazy.levels[0].grid.origin) == ((2, 2, 1), (0.5, 0.5, 0))


def test_stores_without_samples(tmp_path: Path) -> None:
    zarr.create_array(tmp_path / "v.zarr", shape=(20, 30, 40), chunks=(10, 10, 10), dtype="u2")
    with pytest.raises(FormatError, match="none of its chunks"):
        clvol.open(tmp_path / "v.zarr")
    (tmp_path / "v.zarr" / "c" / "0" / "1").mkdir(parents=True)  # a copy that was interrupted has folders before it has chunks
    with pytest.raises(FormatError, match="none of its chunks"):
        clvol.open(tmp_path / "v.zarr")
    for changes in ({"chunks": [0, 10, 10]}, {"chunks": [10, 10]}, {"shape": [0, 30, 40]}, {"chunks": [10, -10, 10]}):
        stored(tmp_path / "w.zarr", zarr_format=2, overwrite=True)
        about = json.loads((tmp_path / "w.zarr" / ".zarray").read_text()) | changes
        (tmp_path / "w.zarr" / ".zarray").write_text(json.dumps(about))
        with pytest.raises(ClvolError, match=r"w\.zarr"):
            clvol.open(tmp_path / "w.zarr").whole()
    with pytest.raises(FormatError, match="no such file"):
        clvol.open(tmp_path / "gone.zarr")
    zarr.create_array(tmp_path / "flat.zarr", data=DATA[0, 0, 0])
    with pytest.raises(DataError, match=r"clvol\.read reads images"):
        clvol.open(tmp_path / "flat.zarr")


# -- far away ----------------------------------------------------------------------------------------------------------


class Slow(http.server.SimpleHTTPRequestHandler):
    """Serves files of a folder with a delay; failing paths, or a missing query, get an error."""

    delay, failing, query, asked, now, most = 0.02, "", "", 0, 0, 0

    def do_GET(self) -> None:
        own = type(self)
        own.asked, own.now = own.asked + 1, own.now + 1
        own.most = max(own.most, own.now)
        time.sleep(self.delay)
        own.now -= 1
        if self.failing and self.path.endswith(self.failing):
            self.send_error(500)
        elif self.query and urllib.parse.parse_qs(self.path.partition("?")[2]) != urllib.parse.parse_qs(self.query):
            self.send_error(403)
        else:
            super().do_GET()

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, Path, type[Slow]]]:
    """The address of a folder, the folder, and the server."""
    pytest.importorskip("aiohttp")
    handler = type("Own", (Slow,), {})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(handler, directory=tmp_path))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", tmp_path, handler
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_store_over_http(served: tuple[str, Path, type[Slow]], cells: Path) -> None:
    """The same code and the same samples; only the chunks that contain them are requested."""
    address, folder, handler = served
    shutil.copytree(cells, folder / "cells.zarr")
    near, far = (clvol.open(path, time=1, channel=2) for path in (cells, f"{address}/cells.zarr"))
    assert (far.spacing, far.name, len(far.levels)) == (near.spacing, near.name, 2)
    handler.asked = 0
    np.testing.assert_array_equal(far.read((0, 0, 0), (9, 8, 8)), near.read((0, 0, 0), (9, 8, 8)))
    assert handler.asked == 2
    np.testing.assert_array_equal(far.whole().data, DATA[1, 2])
    assert handler.most > 2, "chunks should not wait for each other"


def test_shards_on_a_server_without_ranges(served: tuple[str, Path, type[Slow]]) -> None:
    """It answers requests for parts with the whole: shards are valid, and a wrong checksum reports this."""
    address, folder, _ = served
    zarr.create_array(folder / "s.zarr", data=DATA[0, 0], chunks=(2, 2, 2), shards=(4, 4, 4))
    far = clvol.open(f"{address}/s.zarr")
    with pytest.raises(FormatError, match=r"a part of chunk c/\d/\d/\d of s\.zarr: the server answers with all of it"):
        far.whole()


def test_faults_over_http(served: tuple[str, Path, type[Slow]], monkeypatch: pytest.MonkeyPatch) -> None:
    address, folder, handler = served
    stored(folder / "v.zarr", fill_value=7)
    (folder / "v.zarr" / "c" / "1" / "2" / "2").unlink()
    (folder / "v.zarr" / "c" / "1" / "1" / "1").write_bytes(b"")
    handler.failing = "c/0/0/0"
    far = clvol.open(f"{address}/v.zarr")
    assert (far.read((20, 20, 10), (30, 30, 20)) == 7).all()
    for place, named in (((10, 10, 10), "c/1/1/1 is empty"), ((0, 0, 0), "chunk c/0/0/0 of v.zarr.*500")):
        with pytest.raises(FormatError, match=named):
            far.read(place, tuple(n + 10 for n in place))  # type: ignore[arg-type]  # three of them
    monkeypatch.setattr("clvol.formats.zarr.array._SECONDS", 0.0)
    far.read((30, 0, 0), (40, 10, 10))
    stored(folder / "v.zarr", fill_value=8, overwrite=True)
    with pytest.raises(FormatError, match=r"changed since it was opened"):
        far.read((30, 0, 0), (40, 10, 10))
    with pytest.raises(ClvolError, match=r"gone\.zarr"):
        clvol.open(f"{address}/gone.zarr")
    with pytest.raises(ClvolError, match="nowhere"):
        clvol.open("nowhere://v.zarr")
    with pytest.raises(OptionError, match="storage_options are for addresses"):
        clvol.open(folder / "v.zarr", storage_options={})


@pytest.mark.parametrize(("query", "about"), [("sv=2020&sig=a%2Bb%2Fc%3D&se=", {}), ("sv=1&sig=a%2Bb", {"params": {"sig": "a+b"}})])
def test_a_query_is_sent_with_each_key(served: tuple[str, Path, type[Slow]], query: str, about: dict[str, Any]) -> None:
    """As in signed URLs of whole containers; no message contains it."""
    address, folder, handler = served
    stored(folder / "v.zarr")
    handler.query = query
    asked = query if not about else query.partition("&")[0]
    far = clvol.open(f"{address}/v.zarr?{asked}", storage_options=about)
    np.testing.assert_array_equal(far.read(LOW, HIGH), DATA[0, 0][PART])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(far)).read(LOW, HIGH), DATA[0, 0][PART])
    handler.query = "sig=another"
    with pytest.raises(FormatError, match=r"chunk c/0/0/0 of v\.zarr.*403") as caught:
        far.read((0, 0, 0), (5, 5, 5))
    assert "sig" not in str(caught.value)


def test_only_zarr_accepts_addresses() -> None:
    for name in ("v.tif", "v.NRRD", "v.nii.gz?token=abc"):
        with pytest.raises(FormatError, match=r"https://a\.org/v\.\S+ must be a Zarr store.*download"):
            clvol.open(f"https://a.org/{name}")


def test_a_store_in_fsspecs_memory() -> None:
    stored(zarr.storage.FsspecStore.from_url("memory://clvol/v.zarr", read_only=False))
    np.testing.assert_array_equal(clvol.open("memory://clvol/v.zarr").read(LOW, HIGH), DATA[0, 0][PART])


@pytest.mark.parametrize("version", [2, 3])
def test_a_store_vanished_from_fsspecs_memory_is_detected(version: Any) -> None:
    import fsspec

    address = f"memory://clvol/gone{version}.zarr"
    stored(zarr.storage.FsspecStore.from_url(address, read_only=False), zarr_format=version)
    lazy = clvol.open(address)
    lazy.read((0, 0, 0), (10, 10, 10))
    fsspec.filesystem("memory").rm(f"/clvol/gone{version}.zarr", recursive=True)
    for _ in range(2):
        no_zeros(lazy, r"cannot read gone\d\.zarr any more")


@pytest.mark.parametrize("version", [2, 3])
def test_a_store_vanished_over_http_is_detected(served: tuple[str, Path, type[Slow]], version: Any) -> None:
    """Each read with missing chunks requests the metadata once more, however many are missing."""
    address, folder, handler = served
    handler.delay = 0.0
    array = zarr.create_array(folder / "v.zarr", shape=(40, 40, 40), chunks=(8, 8, 8), dtype="u2", zarr_format=version)
    array[:8] = 3
    lazy = clvol.open(f"{address}/v.zarr")
    handler.asked = 0
    assert lazy.whole().data.sum() == 3 * 8 * 40 * 40
    assert handler.asked == 125 + {2: 2, 3: 1}[version]
    handler.asked = 0
    lazy.read((0, 0, 0), (40, 40, 8))
    assert handler.asked == 25
    shutil.rmtree(folder / "v.zarr")
    no_zeros(lazy, r"cannot read v\.zarr any more")


# -- other formats -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["uint16", ">f4", "bool"])
def test_flat_samples(tmp_path: Path, order: Any, dtype: str) -> None:
    """NumPy and raw files, in boxes of any size: whole planes, whole rows, and narrow ones."""
    data = DATA[0, 0].astype(dtype) if dtype != "bool" else DATA[0, 0] > 30000
    np.save(tmp_path / "v.npy", np.asarray(data, order=order))
    same(tmp_path / "v.npy")
    lazy = clvol.open(tmp_path / "v.npy")
    for part in (
        (slice(2, 4), slice(0, 30), slice(0, 40)),
        (slice(2, 9), slice(3, 4), slice(1, 40)),
        (slice(7, 8), slice(0, 30), slice(39, 40)),
    ):
        np.testing.assert_array_equal(lazy.data[part], data[part])
    data.tofile(tmp_path / "v.raw")
    about: dict[str, Any] = {"shape": data.shape, "dtype": data.dtype}
    same(tmp_path / "v.raw", **about)
    np.save(tmp_path / "several.npy", DATA[0].astype("u2"))
    same(tmp_path / "several.npy", volume=1)
    with (tmp_path / "v.npy").open("r+b") as file:
        file.truncate(3000)
    with pytest.raises(FormatError, match=r"samples .*v\.npy has changed since it was opened"):
        lazy.whole()
    with pytest.raises(FormatError, match="must hold"):
        clvol.open(tmp_path / "v.npy")


TIFFS: dict[str, dict[str, Any]] = {
    "plain": {},
    "OME": {
        "ome": True,
        "metadata": {
            "axes": "TCZYX",
            "PhysicalSizeX": 0.25,
            "PhysicalSizeY": 0.5,
            "PhysicalSizeZ": 2.0,
            "Channel": {"Name": ["a", "b", "c"]},
        },
    },
    "ImageJ": {"imagej": True, "metadata": {"axes": "TZCYX", "spacing": 3.0, "unit": "um"}},
    "deflate": {"compression": "zlib"},
    "tiles": {"tile": (16, 16), "ome": True, "metadata": {"axes": "TCZYX"}},
    "big-endian": {"byteorder": ">"},
}


@pytest.mark.parametrize("kind", TIFFS)
def test_tiff(tmp_path: Path, kind: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / ("v.ome.tif" if TIFFS[kind].get("ome") else "v.tif")
    options = {"photometric": "minisblack"} | TIFFS[kind]
    several = "metadata" in options
    data = DATA[0, 0] if not several else DATA.swapaxes(1, 2) if kind == "ImageJ" else DATA
    tifffile.imwrite(path, np.ascontiguousarray(data), **options)
    same(path, **({"time": 1, "channel": 2} if several else {}))


@pytest.mark.parametrize(("layout", "said"), [({"tile": (16, 16)}, "tile 4"), ({"rowsperstrip": 8}, "strip 3")])
@pytest.mark.parametrize("several", [False, True])
def test_a_damaged_page_of_a_tiff_is_named(tmp_path: Path, layout: dict[str, Any], said: str, several: bool) -> None:
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "v.ome.tif"
    data = DATA if several else DATA[0, 0]
    about = {"axes": "TCZYX" if several else "ZYX"}
    tifffile.imwrite(path, data, compression="deflate", photometric="minisblack", metadata=about, **layout)
    number = 87 if several else 7  # that at time 1, channel 1 and slice 7
    with tifffile.TiffFile(path) as file:
        place = file.pages[number].dataoffsets[int(said[-1])]
    with path.open("r+b") as stream:
        stream.seek(place + 20)
        stream.write(b"damaged")
    lazy = clvol.open(path, trusted=True, **({"time": 1, "channel": 1} if several else {}))
    np.testing.assert_array_equal(lazy.read((0, 0, 8), (40, 30, 20)), DATA[1 if several else 0, 1 if several else 0, 8:])
    with pytest.raises(FormatError, match=rf"samples \[0:20, 0:30, 0:40\].*{said} of page {number} of v\.ome\.tif"):
        lazy.whole()


def test_levels_of_a_tiff(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(tmp_path / "v.ome.tif", ome=True) as file:
        about = {"axes": "ZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 1.5}
        file.write(DATA[0, 0][:, :28], subifds=1, tile=(16, 16), metadata=about, photometric="minisblack")
        file.write(DATA[0, 0][:, :28:2, ::2], subfiletype=1, tile=(16, 16), photometric="minisblack")
    with warnings.catch_warnings(action="ignore"):
        lazy = same(tmp_path / "v.ome.tif", parts=False)
        small = clvol.read(tmp_path / "v.ome.tif", level=1, trusted=True)
    assert len(lazy.levels) == 1
    np.testing.assert_array_equal(lazy.levels[0].whole().data, small.data)
    assert (lazy.levels[0].spacing, lazy.levels[0].grid.origin) == (small.spacing, small.origin)
    blob = (tmp_path / "v.ome.tif").read_bytes()
    (tmp_path / "v.ome.tif").write_bytes(blob[:-50000])
    with pytest.raises(ClvolError, match=r"v\.ome\.tif"):
        clvol.open(tmp_path / "v.ome.tif")
    with pytest.raises(FormatError, match="changed since it was opened"):
        lazy.whole()


def test_hdf5_and_netcdf(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file.create_dataset("flat", data=DATA[0, 0])
        packed = file.create_dataset("packed", data=DATA[0, 0], chunks=(10, 10, 10), compression="gzip", fletcher32=True)
        packed.attrs["element_size_um"] = (3, 2, 1)
        file.create_dataset("never", shape=(4, 5, 6), chunks=(2, 2, 2), dtype="u2")
        place = packed.id.get_chunk_info_by_coord((10, 20, 30)).byte_offset
    assert same(tmp_path / "v.h5", series="packed").chunks == (10, 10, 10)
    same(tmp_path / "v.h5", series="flat")
    with pytest.raises(FormatError, match="none were ever written"):
        clvol.open(tmp_path / "v.h5", series="never")
    before = clvol.open(tmp_path / "v.h5", series="packed", trusted=True)
    with (tmp_path / "v.h5").open("r+b") as stream:
        stream.seek(place + 20)
        stream.write(b"damaged")
    os.utime(tmp_path / "v.h5", ns=(1, 1))
    with pytest.raises(FormatError, match="changed since it was opened"):
        before.whole()
    with pytest.raises(FormatError, match=r"samples \[0:20, 0:30, 0:40\].*chunk \(1, 2, 3\) of /packed in v\.h5"):
        clvol.open(tmp_path / "v.h5", series="packed", trusted=True).whole()


def test_levels_of_imaris(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")

    def text(word: str) -> Any:
        return np.array(list(word), "S1")

    with h5py.File(tmp_path / "v.ims", "w") as file:
        for number, size in enumerate([(20, 30, 40), (10, 15, 20)]):
            for channel in (0, 1):
                group = file.create_group(f"DataSet/ResolutionLevel {number}/TimePoint 0/Channel {channel}")
                stored = np.zeros((32, 32, 64), np.uint16)
                stored[: size[0], : size[1], : size[2]] = DATA[0, channel, : size[0], : size[1], : size[2]]
                group.create_dataset("Data", data=stored, chunks=(8, 16, 16))
                group.attrs.update({f"ImageSize{axis}": text(str(n)) for axis, n in zip("ZYX", size, strict=True)})
        image = file.create_group("DataSetInfo/Image")
        image.attrs.update(
            {f"ExtMin{i}": text("0") for i in range(3)} | {f"ExtMax{i}": text(str(n)) for i, n in enumerate((40, 30, 20))}
        )
    lazy = same(tmp_path / "v.ims", channel=1)
    assert lazy.chunks == (16, 16, 8)
    assert [level.shape for level in lazy.levels] == [(10, 15, 20)]
    np.testing.assert_array_equal(lazy.levels[0].whole().data, DATA[0, 1, :10, :15, :20])


OBLIQUE = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", ["u1", "i2", "u2", "i4", "f4", "f8", "i8"])
def test_nifti(tmp_path: Path, dtype: str, order: str) -> None:
    """As in nibabel: in one file and in two, scaled and unscaled, and the chosen volume of a series."""
    nibabel = pytest.importorskip("nibabel")
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = OBLIQUE * [0.5, 1.5, 2.0], (10, -20, 30)
    data = (DATA[:, 0] % 100).astype(dtype).T  # x, y, z, t
    for suffix, kind, scaling in (
        (".nii", nibabel.Nifti1Image, None),
        (".nii", nibabel.Nifti2Image, (0.5, 3)),
        (".img", nibabel.Nifti1Pair, None),
    ):
        header = kind.header_class(endianness=order)
        header.set_data_dtype(np.dtype(dtype))
        header["xyzt_units"] = 2 | 8
        image = kind(data, affine, header)
        image.header.set_slope_inter(*(scaling or (None, None)))
        nibabel.save(image, tmp_path / f"v{suffix}")
        lazy = same(tmp_path / f"v{suffix}", time=1)
        truth = np.asanyarray(nibabel.load(tmp_path / f"v{suffix}").dataobj)[..., 1].T
        np.testing.assert_array_equal(lazy.whole().data, truth)
        assert lazy.dtype == truth.dtype.newbyteorder("=")
    same(tmp_path / "v.hdr", time=0)


def test_nifti_of_colours_and_vectors(tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    colours = (
        np.ascontiguousarray(np.moveaxis(DATA[0], 0, -1) % 256).astype("u1").view([("R", "u1"), ("G", "u1"), ("B", "u1")])[..., 0].T
    )
    nibabel.save(nibabel.Nifti1Image(colours, np.eye(4)), tmp_path / "colours.nii")
    for choice in ({}, {"channel": "green"}):
        same(tmp_path / "colours.nii", **choice)  # without a choice the luminance
    image = nibabel.Nifti1Image(DATA[0].astype("f4").T[:, :, :, None], np.eye(4))
    image.header.set_intent("vector")
    nibabel.save(image, tmp_path / "vectors.nii")
    for choice in ({}, {"channel": "z"}):
        same(tmp_path / "vectors.nii", **choice)


def faulty(path: Path, packed: Path) -> None:
    """Truncated and compressed files are rejected; later changes are detected, and pickles reopen the file."""
    lazy = clvol.open(path)
    assert pickle.loads(pickle.dumps(lazy)).read(LOW, HIGH).sum() == lazy.read(LOW, HIGH).sum()
    blob = path.read_bytes()
    path.write_bytes(blob[:-100])
    with pytest.raises(FormatError, match=rf"{path.name} has changed since it was opened"):
        lazy.whole()
    with pytest.raises(FormatError, match=r"must hold .* bytes of samples"):
        clvol.open(path)
    with pytest.raises(FormatError, match=r"packed as a whole.*clvol\.read reads it whole, clvol\.pyramid makes a Zarr store"):
        clvol.open(packed)


def test_faults_of_nifti(tmp_path: Path) -> None:
    pytest.importorskip("nibabel")
    for suffix in (".nii", ".nii.gz"):
        clvol.write(clvol.Volume(DATA[0, 0]), tmp_path / f"v{suffix}")
    faulty(tmp_path / "v.nii", tmp_path / "v.nii.gz")


NRRD_TYPES = {
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "i8": "longlong",
    "f4": "float",
    "f8": "double",
}
META_TYPES = {
    "u1": "UCHAR",
    "i2": "SHORT",
    "u2": "USHORT",
    "i4": "INT",
    "u4": "UINT",
    "i8": "LONG_LONG",
    "f4": "FLOAT",
    "f8": "DOUBLE",
}


def nrrd(path: Path, data: np.ndarray[Any, Any], kinds: str = "domain domain domain", more: str = "", skipped: bytes = b"") -> Path:
    """Samples behind the header, or (.nhdr) in a separate file."""
    domain = ["(0.18,-0.4,0.24)", "(0.72,0.9,0.96)", "(-1.6,0,1.2)"]
    directions = " ".join(
        "none" if kind not in ("domain", "time") else domain.pop(0) if domain else "none" for kind in kinds.split()
    )
    head = (
        f"NRRD0005\ntype: {NRRD_TYPES[data.dtype.str[1:]]}\ndimension: {data.ndim}\nspace: right-anterior-superior\n"
        f"sizes: {' '.join(map(str, data.shape[::-1]))}\nspace directions: {directions}\nkinds: {kinds}\nencoding: raw\n"
        f"endian: {'big' if data.dtype.str[0] == '>' else 'little'}\nspace origin: (1,-2,3)\n{more}"
    )
    apart = path.suffix == ".nhdr"
    head += "data file: v.dat\n" if apart else ""
    path.write_bytes(f"{head}\n".encode() + (b"" if apart else skipped + data.tobytes()))
    if apart:
        path.with_name("v.dat").write_bytes(skipped + data.tobytes())
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", NRRD_TYPES)
def test_nrrd_and_metaimage(tmp_path: Path, dtype: str, order: str) -> None:
    """As in SimpleITK: attached and detached, in both byte orders, with bytes before the samples."""
    sitk = pytest.importorskip("SimpleITK")
    data = (DATA[0, 0] % 100).astype(order + dtype)
    files = [nrrd(tmp_path / "v.nrrd", data), nrrd(tmp_path / "v.nhdr", data, "domain domain domain", "byte skip: 3\n", b"abc")]
    matrix = " ".join(f"{v:g}" for v in OBLIQUE.T.ravel())
    for name, element in (("v.mha", "LOCAL"), ("v.mhd", "m.raw")):
        skip, before = ("HeaderSize = 5\n", b"abcde") if name == "v.mhd" else ("", b"")
        head = (
            f"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {order == '>'}\n{skip}"
            f"TransformMatrix = {matrix}\nOffset = 1 -2 3\nElementSpacing = 0.5 1.5 2\nDimSize = 40 30 20\n"
            f"ElementType = MET_{META_TYPES[dtype]}\nElementDataFile = {element}\n"
        )
        (tmp_path / name).write_bytes(head.encode() + (data.tobytes() if element == "LOCAL" else b""))
        if element != "LOCAL":
            (tmp_path / element).write_bytes(before + data.tobytes())
        files.append(tmp_path / name)
    for path in files:
        lazy = same(path)
        truth = sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
        np.testing.assert_array_equal(lazy.whole().data, truth)
        assert lazy.dtype == truth.dtype


def test_several_values_per_voxel_and_scaled_ones(tmp_path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    interleaved = np.ascontiguousarray(np.moveaxis(DATA[0], 0, -1)).astype("f4")
    image = sitk.GetImageFromArray(interleaved, isVector=True)
    for suffix in (".mha", ".nrrd"):
        sitk.WriteImage(image, str(tmp_path / f"v{suffix}"))
        for choice in ({}, {"channel": 2}):
            same(tmp_path / f"v{suffix}", **choice)
    nrrd(tmp_path / "last.nrrd", DATA[0], "domain domain domain list")
    same(tmp_path / "last.nrrd", volume=1)
    for suffix in (".mha", ".nrrd"):
        sitk.WriteImage(sitk.GetImageFromArray(DATA[:, 0], isVector=False), str(tmp_path / f"series{suffix}"))
        same(tmp_path / f"series{suffix}", volume=1)
    blob = (tmp_path / "v.mha").read_bytes()
    field = b"ElementToIntensityFunctionSlope = 0.5\nElementToIntensityFunctionOffset = -3\nElementDataFile"
    (tmp_path / "scaled.mha").write_bytes(blob.replace(b"ElementDataFile", field))
    assert same(tmp_path / "scaled.mha", channel=1).dtype == np.float64


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_faults_of_nrrd_and_metaimage(tmp_path: Path, suffix: str) -> None:
    sitk = pytest.importorskip("SimpleITK")
    for name, packed in (("v", False), ("packed", True)):
        sitk.WriteImage(sitk.GetImageFromArray(DATA[0, 0]), str(tmp_path / f"{name}{suffix}"), useCompression=packed)
    faulty(tmp_path / f"v{suffix}", tmp_path / f"packed{suffix}")


def test_formats_without_parts_say_so(tmp_path: Path) -> None:
    clvol.write(clvol.Volume(DATA[0, 0]), tmp_path / "v.npz")
    with pytest.raises(FormatError, match=r"part by part.*NumPy archive: clvol\.read reads it whole, clvol\.pyramid makes a Zarr"):
        clvol.open(tmp_path / "v.npz")


DAMAGED = np.fromfunction(lambda z, y, x: 1000 * np.exp(-((z - 48) ** 2 + (y - 48) ** 2 + (x - 48) ** 2) / 800), (96, 96, 96))


def damaged_zarr(path: Path) -> tuple[LazyVolume, str]:
    array = zarr.create_array(path / "v.zarr", shape=DAMAGED.shape, chunks=(32, 32, 32), dtype="u2")
    array[:] = DAMAGED.astype("u2")
    (path / "v.zarr" / "c" / "0" / "0" / "1").write_bytes(b"damaged")
    return clvol.open(path / "v.zarr"), "c/0/0/1"


def damaged_foreign(path: Path) -> tuple[LazyVolume, str]:
    damaged_zarr(path)
    return LazyVolume(zarr.open_array(path / "v.zarr", mode="r")), r"\[0:32, 0:32, 32:64\]"


def damaged_hdf5(path: Path) -> tuple[LazyVolume, str]:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path / "v.h5", "w") as file:
        made = file.create_dataset("v", data=DAMAGED.astype("u2"), chunks=(32, 32, 32), compression="gzip")
        place = made.id.get_chunk_info_by_coord((0, 0, 32)).byte_offset
    with (path / "v.h5").open("rb+") as stream:
        stream.seek(place)
        stream.write(b"damaged")
    return clvol.open(path / "v.h5"), r"chunk \(0, 0, 1\)"


def damaged_tiff(path: Path) -> tuple[LazyVolume, str]:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(path / "v.tif", DAMAGED.astype("u2"), compression="zlib", rowsperstrip=96, metadata={"axes": "ZYX"})
    with tifffile.TiffFile(path / "v.tif") as file:
        place = file.pages[2].dataoffsets[0]
    with (path / "v.tif").open("rb+") as stream:
        stream.seek(place)
        stream.write(b"damaged")
    return clvol.open(path / "v.tif"), "page 2 "


@pytest.mark.one_in(4)
@pytest.mark.parametrize("make", [damaged_zarr, damaged_foreign, damaged_hdf5, damaged_tiff])
def test_the_intact_part_of_a_store_with_a_damaged_chunk_is_usable(
    make: Callable[[Path], tuple[LazyVolume, str]], tmp_path: Path, device: Device
) -> None:
    """One damaged chunk made every look at the volume, and thus everything, an error."""
    lazy, name = make(tmp_path)
    points = np.random.default_rng(0).uniform(66, 90, (50, 3))
    with pytest.warns(ClvolWarning, match=name):
        field = clvol.BrickedField(lazy, device=device)
    values = field(points)
    with pytest.raises(FormatError, match=name):
        field([[40.0, 5.0, 2.0]])
    field.close()
    np.testing.assert_allclose(values, clvol.sample(clvol.Volume(DAMAGED.astype("u2")), points, device=device), atol=1e-3)
    assert lazy.limits == (0, 1000)
    assert lazy.damaged
    seen = clvol.render(lazy, size=(24, 24), clip=((70, 70, 70), (95, 95, 95)), mode="mip", device=device)
    whole = clvol.Volume(DAMAGED.astype("u2"))
    assert np.asarray(seen).max() > 0
    camera = clvol.Camera.orbit(30, 20, fit="volume")
    options: dict[str, Any] = {"size": (24, 24), "mode": "mip", "window": (500, 1000), "device": device}
    drawn = clvol.render(lazy, camera, filter="linear", **options)
    gone = ~np.isfinite(holed(lazy).whole().data)
    assert 0 < gone.sum() <= 32**3
    masked = clvol.Medium(dataclasses.replace(lazy.grid, data=whole.data), filter="linear")
    np.testing.assert_allclose(drawn, clvol.render(masked, camera, mask=gone, **options), atol=1e-6)
    if make is not damaged_foreign:
        path = next(one for one in tmp_path.iterdir() if one.name.startswith("v."))
        with pytest.warns(ClvolWarning, match=f"{name}.*7 stands for"):
            filled = clvol.open(path, missing=7).whole().data
        wrong = filled != whole.data
        assert (filled[wrong] == 7).all()
        assert 0 < wrong.sum() <= 32**3
        with pytest.warns(ClvolWarning, match=name):
            picture = clvol.render(clvol.open(path, missing=7), size=(24, 24), mode="mip", device=device)
        assert np.asarray(picture).max() > 0


def test_a_store_without_an_intact_chunk_is_an_error(tmp_path: Path) -> None:
    stored(tmp_path / "v.zarr")
    for chunk in (tmp_path / "v.zarr" / "c").glob("*/*/*"):
        chunk.write_bytes(b"damaged")
    lazy = clvol.open(tmp_path / "v.zarr")
    for look in (lazy.preview, lazy.part, lambda: lazy.limits):
        with pytest.raises(FormatError, match="c/0/0/0"):
            look()
