"""The speed and memory of `clvol.pyramid`, beside the disk, and ome-zarr's and dask's downscaling.

    python -m bench.pyramid [--size 1024] [--memory 2G] [--folder DIR] [--output FILE]

A uint16 volume from a formula, with a little noise, is written plane by plane as a Zarr store, compressed like ours. Then each
case makes a copy with half the samples along each axis from that store, in its own process: megabytes are those of the source,
seconds exclude imports, memory is the peak beyond that after the imports. The disk's rates are those of one file of the same
size, written and synced, then read.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_CHUNK = 64
_MIB = 1 << 20


def planes(size: int, first: int, count: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """Some slices of the volume: waves of several lengths, and noise of 0.1 % of the range."""
    z, y, x = np.ogrid[first : first + count, :size, :size]
    wave = np.sin(0.05 * x).astype(np.float32) * np.cos(0.04 * y).astype(np.float32) + np.sin(0.03 * z + 0.02 * x).astype(
        np.float32
    )
    noise = np.random.default_rng(first).integers(0, 60, wave.shape, dtype=np.uint16)
    made: np.ndarray[Any, np.dtype[np.uint16]] = ((wave + 2) * 12000).astype(np.uint16) + noise
    return made


def make(path: Path, size: int) -> None:
    """Write the source."""
    import zarr
    from zarr.codecs import BloscCodec

    codec = BloscCodec(cname="lz4", clevel=5, shuffle="bitshuffle", typesize=2)
    group = zarr.create_group(path)
    axes = [{"name": axis, "type": "space"} for axis in "zyx"]
    scale = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1.0, 1.0, 1.0]}]}]
    about: Any = {"version": "0.5", "multiscales": [{"name": "waves", "axes": axes, "datasets": scale}]}
    group.attrs["ome"] = about
    array = group.create_array("0", shape=(size,) * 3, chunks=(_CHUNK,) * 3, dtype="u2", compressors=codec)
    for first in range(0, size, _CHUNK):
        array[first : first + _CHUNK] = planes(size, first, min(_CHUNK, size - first))


# -- what is timed, each in a process of its own -----------------------------------------------------------------------


def clvol_all(source: Path, target: Path, memory: int) -> None:
    import clvol

    clvol.pyramid(clvol.open(source, trusted=True), target, levels=2, memory=memory, filter="bspline3")


def clvol_reduced(source: Path, target: Path, memory: int) -> None:
    import clvol

    clvol.pyramid(clvol.open(source, trusted=True), target, levels=2, memory=memory, filter="bspline3", bounds=False)


def clvol_average(source: Path, target: Path, memory: int) -> None:
    import clvol

    clvol.pyramid(
        clvol.open(source, trusted=True), target, levels=2, memory=memory, bounds=False, method="average", filter="linear"
    )


def ome_zarr(source: Path, target: Path, memory: int) -> None:  # noqa: ARG001  # it has no limit
    """Its writer of dask arrays, which copies and halves them (skimage's resize, by blocks)."""
    da: Any = importlib.import_module("dask.array")
    from ome_zarr.writer import write_image

    write_image(da.from_zarr(str(source), "0"), str(target), axes="zyx", scale_factors=[{"z": 2, "y": 2, "x": 2}])


def dask_mean(source: Path, target: Path, memory: int) -> None:  # noqa: ARG001
    """Means of blocks, and a copy."""
    da: Any = importlib.import_module("dask.array")
    array = da.from_zarr(str(source), "0")
    small = da.coarsen(np.mean, array, {0: 2, 1: 2, 2: 2}).round().astype("u2").rechunk((_CHUNK,) * 3)
    da.store([array, small], _arrays(target, array.shape, small.shape), lock=False)


def _arrays(target: Path, *shapes: tuple[int, ...]) -> list[Any]:
    import zarr

    group = zarr.create_group(target)
    return [group.create_array(str(i), shape=shape, chunks=(_CHUNK,) * 3, dtype="u2") for i, shape in enumerate(shapes)]


CASES: dict[str, Callable[[Path, Path, int], None]] = {
    "clvol: least squares, bounds": clvol_all,
    "clvol: least squares": clvol_reduced,
    "clvol: average": clvol_average,
    "ome-zarr: write_image": ome_zarr,
    "dask: coarsen, mean": dask_mean,
}


def child(name: str, source: Path, target: Path, memory: int) -> None:
    """Run one case; print seconds and peak memory as JSON."""
    import resource

    import dask.array as _dask
    import zarr as _zarr

    import clvol
    from clvol.device import as_device

    del _dask, _zarr  # imported here, so that no case pays for it
    as_device(None)
    small = np.zeros((80, 80, 80), np.uint16)
    if name.startswith("clvol"):  # kernels are built
        clvol.pyramid(small, target.with_name("small.zarr"), levels=2, filter="bspline3", overwrite=True)
    before = _resident()
    start = time.perf_counter()
    CASES[name](source, target, memory)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"seconds": seconds, "peak": peak - before}))


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def disk(folder: Path, nbytes: int) -> dict[str, float]:
    """Megabytes per second written (synced) and read by the disk, from a dropped cache where permitted."""
    block, path = np.random.default_rng(0).bytes(16 * _MIB), folder / "disk"
    start = time.perf_counter()
    with path.open("wb", buffering=0) as file:
        for _ in range(nbytes // len(block)):
            file.write(block)
        os.fsync(file.fileno())
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    wrote = time.perf_counter() - start
    start = time.perf_counter()
    with path.open("rb", buffering=0) as file:
        while file.read(16 * _MIB):
            pass
    read = time.perf_counter() - start
    path.unlink()
    return {"write": nbytes / 1e6 / wrote, "read": nbytes / 1e6 / read}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--size", type=int, default=1024)
    arguments.add_argument("--memory", type=int, default=2048, help="MiB")
    arguments.add_argument("--folder", type=Path)
    arguments.add_argument("--only", default="", help="part of the names of cases")
    arguments.add_argument("--output", type=Path)
    arguments.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.child:
        name, source, target, memory = given.child
        child(name, Path(source), Path(target), int(memory))
        return
    nbytes = 2 * given.size**3
    with tempfile.TemporaryDirectory(dir=given.folder) as made:
        folder = Path(made)
        make(folder / "source.zarr", given.size)
        rates = disk(folder, min(nbytes, 2 << 30))
        print(f"{given.size}³ uint16, {nbytes / 1e6:.0f} MB; disk: writes {rates['write']:.0f}, reads {rates['read']:.0f} MB/s")
        rows: dict[str, Any] = {}
        for name in (one for one in CASES if given.only in one):
            target = folder / "target.zarr"
            command = [
                sys.executable,
                "-m",
                "bench.pyramid",
                "--child",
                name,
                folder / "source.zarr",
                target,
                str(given.memory * _MIB),
            ]
            done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
            shutil.rmtree(target, ignore_errors=True)
            if done.returncode:
                print(f"{name}: {done.stderr.strip().splitlines()[-1:]}")
                continue
            found = json.loads(done.stdout.splitlines()[-1])
            rate = nbytes / 1e6 / found["seconds"]
            rows[name] = found | {"rate": rate}
            print(
                f"{name}: {found['seconds']:.1f} s, {rate:.0f} MB/s, {rate / rates['write']:.2f} of the disk's writing, "
                f"{found['peak'] / _MIB:.0f} MiB",
                flush=True,
            )
    if given.output:
        given.output.write_text(
            json.dumps({"size": given.size, "memory": given.memory, "disk": rates, "cases": rows}, indent=2), encoding="utf-8"
        )


if __name__ == "__main__":
    main()
