"""`clvol.dask` beside dask-image, on a local Zarr array larger than its chunks, with the disk's own rates.

    python -m bench.dask [--side N] [--dtype KIND] [--workers N] [--chunk N] [--repeats N] [--folder DIR]

Prefilters a volume (`clvol.prefilter`; `dask_image.ndinterp.spline_filter`) and halves it (`clvol.resample`, cubic and by least
squares; `dask_image.ndinterp.affine_transform`, which takes no low-pass), from Zarr to Zarr, in worker processes with one thread
each. Calls take turns (ours, theirs, ours, ...), after one of each that is not counted; medians are compared. MB/s are those of
the input's bytes. The volume is made by a formula, a chunk at a time, and what is written is deleted.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import clvol

__all__ = ["waves"]


def waves(block_info: Any = None) -> NDArray[Any]:
    """A chunk of the volume: waves of several lengths, in 0 to 4000."""
    where = block_info[None]
    z, y, x = (np.arange(low, high, dtype=np.float32) for low, high in where["array-location"])
    rays = np.sin(0.11 * z)[:, None, None] * np.sin(0.07 * y)[:, None] * np.sin(0.05 * x)
    fine = np.sin(0.9 * z)[:, None, None] + np.sin(1.1 * y)[:, None] + np.sin(1.3 * x)
    return np.asarray(2000 + 1500 * rays + 160 * fine).astype(where["dtype"])


def disk(folder: Path, size: int) -> tuple[float, float]:
    """Seconds in which a file of so many bytes is written, to the disk, and read again, from its cache if it is held there."""
    file, part = folder / "plain", np.random.default_rng(0).bytes(16 << 20)
    start = time.perf_counter()
    with file.open("wb") as stream:
        for first in range(0, size, len(part)):
            stream.write(part[: size - first])
        stream.flush()
        os.fsync(stream.fileno())
    written = time.perf_counter()
    with file.open("rb", buffering=0) as stream:
        while stream.read(len(part)):
            pass
    read = time.perf_counter()
    file.unlink()
    return written - start, read - written


def calls(source: Any, side: int, chunk: int) -> dict[str, dict[str, Callable[[], Any]]]:
    """What is measured: lazy arrays by work and by library."""
    half = (side // 2,) * 3
    floating = source.astype(np.float32)
    found: dict[str, dict[str, Callable[[], Any]]] = {
        "prefilter, cubic": {"clvol": partial(clvol.prefilter, source)},
        "halve, cubic": {"clvol": lambda: clvol.resample(source, half, boundary="nearest", dtype="same")},
        "halve, least squares": {"clvol": lambda: clvol.resample(source, half, anti_aliasing="least-squares", dtype="same")},
        "copy": {"dask": lambda: source},
    }
    if find_spec("dask_image"):
        from dask_image import ndinterp

        found["prefilter, cubic"]["dask-image"] = lambda: ndinterp.spline_filter(floating, output=np.float32, mode="mirror")
        found["halve, cubic"]["dask-image"] = lambda: ndinterp.affine_transform(
            source, np.full(3, 2.0), np.full(3, 0.5), output_shape=half, output_chunks=(chunk,) * 3, order=3, mode="nearest"
        )
    return found


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--side", type=int, default=512, help="samples along each axis")
    options.add_argument("--dtype", default="uint16")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--chunk", type=int, default=128)
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--folder", type=Path, help="where arrays are written; by default a temporary folder")
    given = options.parse_args()
    import dask.array as da
    import distributed

    console = Console(width=130)
    folder = Path(tempfile.mkdtemp(dir=given.folder))
    cores = os.cpu_count() or 1
    threads = str(max(1, cores // given.workers))  # of a worker's OpenCL, so that all of them use each core once
    try:
        size = given.side**3 * np.dtype(given.dtype).itemsize
        write, read = disk(folder, size)
        chunks = da.core.normalize_chunks(given.chunk, (given.side,) * 3)
        made = da.map_blocks(waves, chunks=chunks, dtype=given.dtype, meta=np.empty((0,) * 3, given.dtype))
        made.to_zarr(str(folder / "volume.zarr"), compute=True)
        source = da.from_zarr(str(folder / "volume.zarr"))
        with (
            distributed.LocalCluster(
                n_workers=given.workers, threads_per_worker=1, dashboard_address=None, env={"POCL_MAX_PTHREAD_COUNT": threads}
            ) as cluster,
            distributed.Client(cluster),
        ):
            table = Table(title=f"{given.side}³ {given.dtype}, chunks of {given.chunk}³, {given.workers} workers, {cores} cores")
            for column in ("", "library", "seconds", "MB/s", "times clvol's"):
                table.add_column(column)
            for name, row in calls(source, given.side, given.chunk).items():
                times: dict[str, list[float]] = {library: [] for library in row}
                for turn in range(given.repeats + 1):
                    for library, call in row.items():
                        start = time.perf_counter()
                        call().to_zarr(str(folder / "result.zarr"), compute=True, overwrite=True)
                        if turn:
                            times[library].append(time.perf_counter() - start)
                medians = {library: statistics.median(taken) for library, taken in times.items()}
                for library, seconds in medians.items():
                    ratio = seconds / medians["clvol"] if "clvol" in medians else float("nan")
                    table.add_row(name, library, f"{seconds:.2f}", f"{size / seconds / 1e6:.0f}", f"{ratio:.2f}")
            for name, seconds in (("write, one file", write), ("read, one file", read)):
                table.add_row(name, "disk", f"{seconds:.2f}", f"{size / seconds / 1e6:.0f}", "")
            console.print(table)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
