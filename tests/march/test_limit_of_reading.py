"""Reading stays within the budget: unpacked chunks, sums, and the samples that decide looks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.bricks.chunks import stored_in_one
from tests.bricks.test_source import Counted

MIB = 1 << 20
BESIDE = 16 * MIB
"""As of `test_limit`."""

CHILD = r"""
import gc, json, sys
import numpy as np
import clvol

MIB = 1 << 20


class Formula:
    dtype = np.dtype(np.float32)

    def __init__(self, n):
        self.shape = (n, n, n)

    def __getitem__(self, at):
        z, y, x = (np.arange(s.start, s.stop, dtype=np.float32) for s in at)
        made = np.multiply(np.sin(x / 20), np.cos(y / 25)[:, None])
        return np.add(made, np.sin(z / 30)[:, None, None])


def peak():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) << 10 for line in status if line.startswith("VmHWM"))


def turned(n, count, budget):
    volume = clvol.LazyVolume(Formula(n), limits=(-2, 2), labels=False)
    c, s = np.cos(0.3), np.sin(0.3)
    like = clvol.Volume(np.zeros((count,) * 3, np.float32), (4, 4, 4), (60, 20, 10), [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    with clvol.BrickedField(volume, "bspline3", memory=budget) as field:
        field.resample(like=like, anti_aliasing="gaussian")


def looked(n):
    volume = clvol.LazyVolume(Formula(n))
    assert volume.preview().shape != volume.shape
    assert volume.part() and volume.limits


def packed(path, budget):
    volume = clvol.open(path, trusted=True)
    with clvol.BrickedField(volume, "linear", memory=budget, edge=64) as field, clvol.Renderer(field) as renderer:
        renderer.render(mode="mip", size=(24, 24), rays=1, step=4.0)


what, arguments = sys.argv[1], json.loads(sys.argv[2])
work = {"turned": turned, "looked": looked, "packed": packed}[what]
small = {"turned": (64, 8, 1 << 30), "looked": (200,), "packed": (f"{arguments[0]}.small", 1 << 30)}[what]
work(*small)  # kernels are built, and libraries are there
gc.collect()
with open("/proc/self/clear_refs", "w") as refs:
    refs.write("5")  # the peak is measured from here on
before = peak()
work(*arguments)
print(json.dumps(peak() - before))
"""

linux = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux measures the peak")


def grown(folder: Path, what: str, *arguments: Any) -> int:
    """Bytes by which a process grows during a call."""
    script = folder / "child.py"
    script.write_text(CHILD, encoding="utf-8")
    command = [sys.executable, str(script), what, json.dumps(arguments)]
    # what was freed is the system's again, the pieces of 8 KiB in which gzip unpacks too; an arena keeps those under a later block
    known = os.environ | {"MALLOC_MMAP_THRESHOLD_": "4096"}
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=known)
    assert ran.returncode == 0, ran.stderr
    return int(json.loads(ran.stdout.splitlines()[-1]))


@linux
def test_low_pass_on_a_rotated_grid(tmp_path: Path) -> None:
    """Sums and their samples are part of a brick's memory, and points are part of the result's."""
    found = grown(tmp_path, "turned", 200, 40, 32 * MIB)
    assert found < 32 * MIB + BESIDE / 2, f"{found / MIB:.0f} MiB"


@linux
def test_previews_of_a_volume(tmp_path: Path) -> None:
    """All of 300³ float32, 103 MiB, is read for its range; preview and centre block take 8 MiB each."""
    found = grown(tmp_path, "looked", 300)
    assert found < 32 * MIB, f"{found / MIB:.0f} MiB"


def packed(path: Path, shape: tuple[int, ...]) -> None:
    """An array in one gzip chunk, the Zarr codec that needs most memory."""
    zarr = pytest.importorskip("zarr")
    from zarr.codecs import GzipCodec

    made = zarr.create_array(path, shape=shape, chunks=shape, dtype="u2", compressors=GzipCodec(level=1))
    made[...] = np.random.default_rng(0).integers(0, 1 << 16, shape, np.uint16)


@linux
def test_a_chunk_is_unpacked_within_the_budget_or_not_at_all(tmp_path: Path) -> None:
    """A budget that is rejected comes with the one that would do."""
    packed(tmp_path / "v.zarr", (160, 256, 256))  # 20 MiB
    packed(tmp_path / "v.zarr.small", (80, 80, 80))
    volume = clvol.open(tmp_path / "v.zarr")
    with pytest.raises(OptionError, match=r"memory must be at least \d+ bytes, which a chunk .* clvol\.pyramid") as told:
        clvol.Renderer(volume, "linear", memory=64 * MIB)
    words = re.search(r"at least (\d+) bytes", str(told.value))
    assert words is not None
    least = int(words[1])
    assert least < 6 * volume.nbytes
    found = grown(tmp_path, "packed", str(tmp_path / "v.zarr"), least)
    assert found < least + BESIDE, f"{found / MIB:.0f} MiB"


def test_chunks_that_exceed_the_budget_are_not_read(tmp_path: Path) -> None:
    data = Counted(np.zeros((64, 64, 64), np.float32), (64, 64, 64))
    volume = clvol.LazyVolume(data, labels=False)
    for refused in (
        lambda: clvol.BrickedField(volume, memory=4 * MIB),
        lambda: clvol.render(volume, memory=4 * MIB),
        lambda: clvol.BrickedField(clvol.LazyVolume(np.zeros((64, 64, 64)), levels=[volume]), memory=4 * MIB),
    ):
        with pytest.raises(OptionError, match="memory must be at least 5242880 bytes, which a chunk of the volume takes"):
            refused()
    assert data.read == 0
    with clvol.BrickedField(volume, "linear", memory=5242880) as field:
        assert field([[1, 2, 3]]) == 0
    large = Counted(np.broadcast_to(np.float32(0), (64, 1024, 1024)), (64, 1024, 1024))
    with pytest.raises(OptionError, match="memory must be at least 1342177280 bytes"):
        clvol.pyramid(clvol.LazyVolume(large, labels=False), tmp_path / "v.zarr", memory=1 << 30)
    assert (large.read, list(tmp_path.iterdir())) == (0, [])


def test_a_default_budget_grows_with_a_chunk_up_to_what_is_available(monkeypatch: pytest.MonkeyPatch) -> None:
    from clvol.base import memory
    from clvol.bricks.source import BUDGET, memory_for

    def of(chunk: int) -> clvol.LazyVolume:
        return clvol.LazyVolume(Counted(np.broadcast_to(np.uint8(0), (1, 1, 4 << 30)), (1, 1, chunk)))

    monkeypatch.setattr(memory, "available", lambda: 8 << 30)
    assert memory_for(of(1 << 20), None) == BUDGET
    assert 7 << 30 <= memory_for(of(1 << 30), None) <= 8 << 30
    assert memory_for(of(1 << 20), None, 4) == BUDGET // 4
    with pytest.raises(OptionError, match="must be at least"):
        memory_for(of(2 << 30), None)


@pytest.mark.filterwarnings("ignore:.*taken for slices")
def test_uncompressed_chunks_are_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large chunks of Zarr and HDF5, and separate TIFF pages: both byte orders, and a chunk that is not stored."""
    zarr, h5py, tifffile = (pytest.importorskip(name) for name in ("zarr", "h5py", "tifffile"))
    from clvol.formats import hdf5
    from clvol.formats.zarr import array

    monkeypatch.setattr(array, "_LARGE", 1000)
    monkeypatch.setattr(hdf5, "_CACHED", 1000)
    rng = np.random.default_rng(0)
    data = rng.integers(1, 1 << 16, (40, 50, 60), np.uint16)
    about: dict[str, Any] = {"shape": data.shape, "chunks": (30, 50, 60), "compressors": None, "fill_value": 7}
    for endian in ("little", "big"):
        serializer = zarr.codecs.BytesCodec(endian=endian)
        zarr.create_array(tmp_path / f"3{endian}.zarr", dtype="u2", serializer=serializer, **about)[...] = data
        dtype = "<u2" if endian == "little" else ">u2"
        zarr.create_array(tmp_path / f"2{endian}.zarr", dtype=dtype, zarr_format=2, **about)[...] = data
        with tifffile.TiffWriter(tmp_path / f"{endian}.tif", byteorder=dtype[0]) as file:
            for plane in data:
                file.write(plane, contiguous=False, photometric="minisblack", metadata=None, rowsperstrip=7)
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file.create_dataset("v", data=data, chunks=(30, 50, 60))
    with hdf5.opened(tmp_path / "v.h5") as file:
        assert file["v"].id.get_access_plist().get_chunk_cache()[1] == 1000
    for path in sorted(tmp_path.iterdir()):
        volume = clvol.open(path, trusted=True, spacing=(1, 1, 1))
        assert (volume.chunks, stored_in_one(volume.data)) == (None, 0), path.name
        for _ in range(8):
            low = [int(rng.integers(0, n)) for n in volume.size]
            high = [int(rng.integers(a + 1, n + 1)) for a, n in zip(low, volume.size, strict=True)]
            found = volume.read((low[0], low[1], low[2]), (high[0], high[1], high[2]))
            np.testing.assert_array_equal(found, data[low[2] : high[2], low[1] : high[1], low[0] : high[0]])
    (tmp_path / "3little.zarr" / "c" / "1" / "0" / "0").unlink()
    gone = clvol.open(tmp_path / "3little.zarr", trusted=True)
    assert gone.read((4, 5, 29), (5, 6, 31)).ravel().tolist() == [int(data[29, 5, 4]), 7]
    chunk = tmp_path / "3big.zarr" / "c" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-2])
    with pytest.raises(clvol.base.errors.FormatError, match=r"cannot read chunk c/0/0/0 of 3big\.zarr: it must have 180000 bytes"):
        clvol.open(tmp_path / "3big.zarr", trusted=True).read((0, 0, 0), (2, 2, 2))
